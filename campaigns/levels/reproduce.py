"""Do the upper limits of statements keep their level? Simulated campaigns whose rates per hour
flown are known in closed form.

    python -m campaigns.levels.reproduce --out campaigns/levels [--repeats 20000]

A flight of an hour is aborted with probability q, at a moment that is uniform in it: E T = 1 - q/2
hours are flown, and q / E T flights are aborted per hour flown. Excursions come in clusters of k,
Poisson at rate a/k per hour flown, and an aborted flight counts as one: a + q / E T per hour flown.
1 - (1 - q) exp(-a/k) of flights have an excursion. Each campaign asks whether a rate is at most the
true one; an upper limit below that is a false yes, of which 2.5 in 100 are allowed. Writes
DIR/levels.csv. Exit code 0: every level is kept, and the two limits beside them, which charge
nothing for time not flown or take excursions as independent, do not keep theirs; 1: otherwise; 2:
bad input.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

from campaigns.levels.study import LevelStudy, Results, allowed
from uqharness.statistics import observed_dispersion, share_upper, upper_limits

ERROR, SEED = 0.025, 20161224
_COLUMNS = """campaign flights excursions_per_h:.4g losses_per_h:.4g missed_excursions:.4f
    missed_losses:.4f missed_share:.4f infinite_limits:.4f median_limit_over_truth:.3g
    losses_as_scheduled:.4f excursions_if_poisson:.4f kept"""


@dataclass(frozen=True)
class Truth:
    """A campaign's truth: clusters of ``cluster``, ``rate`` of excursions beside aborted flights
    [1/h flown], chance ``abort``."""

    campaign: str
    flights: int
    cluster: int
    rate: float
    abort: float = 0.0
    dispersion: float = 1.0

    @property
    def losses_per_h(self) -> float:
        """Aborted flights per hour flown."""
        return self.abort / (1.0 - self.abort / 2.0)

    @property
    def excursions_per_h(self) -> float:
        """Excursions per hour flown, an aborted flight counted as one."""
        return self.rate + self.losses_per_h

    @property
    def flight_share(self) -> float:
        """Share of flights with an excursion: those that are not aborted and see no cluster have
        none."""
        return 1.0 - (1.0 - self.abort) * math.exp(-self.rate / self.cluster)


TRUTHS = (
    Truth("single excursions", 100, 1, 0.1, 0.0, 2.0),
    Truth("clusters at the carried limit of 2, rare", 60, 2, 0.08, 0.0, 2.0),
    Truth("clusters at the carried limit of 4, rare", 120, 4, 0.05, 0.0, 4.0),
    Truth("excursions and aborted flights", 200, 1, 0.3, 0.05, 2.0),
    Truth("aborted flights alone, rare", 150, 1, 0.0, 0.03),
    Truth("aborted flights alone, frequent", 100, 1, 0.0, 0.6),
    Truth("every flight but one in ten aborted", 100, 1, 0.0, 0.9),
)


def measured(truth: Truth, repeats: int, seed: int = SEED) -> dict[str, float]:
    """Simulate ``repeats`` campaigns; return shares of them in which a limit lay below the truth.

    ``missed_...``: limits of excursions, of aborted flights, of the share of flights with an
    excursion; ``infinite_limits`` of excursions, and their median over the truth;
    ``losses_as_scheduled`` per scheduled hour with nothing charged for what was not flown,
    ``excursions_if_poisson`` by Poisson's limits.
    """
    key = [truth.flights, truth.cluster, round(1e6 * truth.rate), round(1e6 * truth.abort)]
    generator = np.random.default_rng([seed, *key])
    shape = (repeats, truth.flights)
    is_lost = (generator.random(shape) < truth.abort).astype(float)
    missing = is_lost * generator.random(shape)
    counts = (
        truth.cluster * generator.poisson(truth.rate / truth.cluster * (1.0 - missing)) + is_lost
    )
    flights = np.full(repeats, float(truth.flights))
    total, absent = counts.sum(axis=1), missing.sum(axis=1)
    ended = np.where(missing > 0.0, counts, 0.0).max(axis=1)
    dispersion = np.maximum(np.maximum(observed_dispersion(counts), truth.dispersion), ended)
    single = np.ones(repeats)
    limits = upper_limits(flights, total, dispersion, ERROR, None, absent)
    losses = upper_limits(flights, is_lost.sum(axis=1), single, ERROR, None, absent)
    # Per scheduled hour, as if the remainder of an aborted flight had been flown without an event.
    scheduled = upper_limits(flights, is_lost.sum(axis=1), single, ERROR)
    shares = share_upper((counts > 0).sum(axis=1), flights, ERROR)
    hours = np.maximum(flights - absent, 1e-9)
    poisson = stats.chi2.isf(ERROR, 2.0 * total + 2.0) / (2.0 * hours)
    missed = {
        "missed_excursions": limits < truth.excursions_per_h,
        "missed_losses": losses < truth.losses_per_h,
        "missed_share": shares < truth.flight_share,
        "infinite_limits": np.isinf(limits),
        "losses_as_scheduled": scheduled < truth.losses_per_h,
        "excursions_if_poisson": poisson < truth.excursions_per_h,
    }
    level = {name: float(np.mean(values)) for name, values in missed.items()}
    return level | {"median_limit_over_truth": float(np.median(limits) / truth.excursions_per_h)}


def keeps_level(level: Mapping[str, float], repeats: int) -> bool:
    """Return whether no limit was missed more often than allowed, and limits are mostly finite: an
    infinite one is never wrong."""
    missed = max(value for name, value in level.items() if name.startswith("missed"))
    return missed <= allowed(ERROR, repeats) and level["infinite_limits"] <= 0.5


def passes(results: Results, repeats: int) -> bool:
    """Return whether every level is kept, and is not by the two limits beside them."""
    levels = [level for _, level in results]
    controls = ("losses_as_scheduled", "excursions_if_poisson")
    minimum = min(max(level[name] for level in levels) for name in controls)
    return minimum > 2.0 * ERROR and all(keeps_level(level, repeats) for level in levels)


STUDY = LevelStudy(
    __doc__, "levels.csv", 20_000, 1000, _COLUMNS, TRUTHS, measured, keeps_level, passes
)
main = STUDY.main

if __name__ == "__main__":
    sys.exit(main())
