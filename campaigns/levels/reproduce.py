"""Do the upper limits of statements keep their level? Simulated campaigns whose rates per hour flown are known in closed form.

    python -m campaigns.levels.reproduce --out campaigns/levels [--repeats 20000]

A flight of an hour is aborted with probability q, at a moment that is uniform in it: E T = 1 - q/2 hours are flown, and q / E T
flights are aborted per hour flown. Excursions come in clusters of k, Poisson at rate a/k per hour flown, and an aborted flight
counts as one: a + q / E T per hour flown. 1 - (1 - q) exp(-a/k) of flights have an excursion. Each campaign asks whether a rate
is at most the true one; an upper limit below that is a false yes, of which 2.5 in 100 are allowed. Writes DIR/levels.csv. Exit
code 0: every level is kept, and the two limits beside them, which charge nothing for time not flown or take excursions as
independent, do not keep theirs; 1: otherwise; 2: bad input.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import stats

from uqharness.files import write_bytes
from uqharness.statistics import observed_dispersion, share_upper, upper_limits
from uqharness.text_tables import csv_text, text_table

ERROR, SEED = 0.025, 20161224


@dataclass(frozen=True)
class Truth:
    """A campaign's truth: clusters of ``cluster``, ``rate`` of excursions beside aborted flights [1/h flown], chance ``abort``."""

    name: str
    flights: int
    cluster: int
    rate: float
    abort: float
    dispersion: float

    @property
    def flown_h(self) -> float:
        """Mean hours flown of a flight."""
        return 1.0 - self.abort / 2.0

    @property
    def loss_per_h(self) -> float:
        """Aborted flights per hour flown."""
        return self.abort / self.flown_h

    @property
    def excursions_per_h(self) -> float:
        """Excursions per hour flown, an aborted flight counted as one."""
        return self.rate + self.loss_per_h

    @property
    def flight_share(self) -> float:
        """Share of flights with an excursion: those that are not aborted and see no cluster have none."""
        return 1.0 - (1.0 - self.abort) * math.exp(-self.rate / self.cluster)


TRUTHS = (
    Truth("single excursions", 100, 1, 0.1, 0.0, 2.0),
    Truth("clusters at the carried limit of 2, rare", 60, 2, 0.08, 0.0, 2.0),
    Truth("clusters at the carried limit of 4, rare", 120, 4, 0.05, 0.0, 4.0),
    Truth("excursions and aborted flights", 200, 1, 0.3, 0.05, 2.0),
    Truth("aborted flights alone, rare", 150, 1, 0.0, 0.03, 1.0),
    Truth("aborted flights alone, frequent", 100, 1, 0.0, 0.6, 1.0),
    Truth("every flight but one in ten aborted", 100, 1, 0.0, 0.9, 1.0),
)


@dataclass(frozen=True)
class Level:
    """Shares of repeats in which a limit lay below the truth: of excursions, of aborted flights, of the share of flights with an
    excursion; ``infinite`` limits of excursions, ``over_truth`` their median over the truth; ``as_scheduled`` per scheduled hour
    with nothing charged for what was not flown, ``unclustered`` by Poisson's limits.
    """

    excursions: float
    losses: float
    share: float
    infinite: float
    over_truth: float
    as_scheduled: float
    unclustered: float


def measured(truth: Truth, repeats: int, seed: int = SEED) -> Level:
    """Simulate ``repeats`` campaigns."""
    generator = np.random.default_rng(
        [seed, truth.flights, truth.cluster, round(1e6 * truth.rate), round(1e6 * truth.abort)]
    )
    shape = (repeats, truth.flights)
    lost = (generator.random(shape) < truth.abort).astype(float)
    missing = lost * generator.random(shape)
    counts = truth.cluster * generator.poisson(truth.rate / truth.cluster * (1.0 - missing)) + lost
    flights = np.full(repeats, float(truth.flights))
    total, absent = counts.sum(axis=1), missing.sum(axis=1)
    ended = np.where(missing > 0.0, counts, 0.0).max(axis=1)
    allowed = np.maximum(np.maximum(observed_dispersion(counts), truth.dispersion), ended)
    single = np.ones(repeats)
    limits = upper_limits(flights, total, allowed, ERROR, None, absent)
    losses = upper_limits(flights, lost.sum(axis=1), single, ERROR, None, absent)
    # Per scheduled hour, as if the rest of an aborted flight had been flown without an event.
    scheduled = upper_limits(flights, lost.sum(axis=1), single, ERROR)
    shares = share_upper((counts > 0).sum(axis=1), flights, ERROR)
    hours = np.maximum(flights - absent, 1e-9)
    poisson = stats.chi2.isf(ERROR, 2.0 * total + 2.0) / (2.0 * hours)
    return Level(
        float(np.mean(limits < truth.excursions_per_h)),
        float(np.mean(losses < truth.loss_per_h)),
        float(np.mean(shares < truth.flight_share)),
        float(np.mean(np.isinf(limits))),
        float(np.median(limits) / truth.excursions_per_h),
        float(np.mean(scheduled < truth.loss_per_h)),
        float(np.mean(poisson < truth.excursions_per_h)),
    )


def allowed(error: float, repeats: int) -> float:
    """Share of repeats that may be wrong where ``error`` is the chance of each: three standard deviations above it."""
    return error + 3.0 * math.sqrt(error * (1.0 - error) / repeats)


def kept(level: Level, repeats: int) -> bool:
    """Whether no limit was missed more often than allowed, chance in so many repeats (three standard deviations) granted, and
    limits are mostly finite: an infinite one is never wrong."""
    return (
        max(level.excursions, level.losses, level.share) <= allowed(ERROR, repeats)
        and level.infinite <= 0.5
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; the process's exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m campaigns.levels.reproduce", description="Do statements keep their level?"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--repeats", type=int, default=20_000)
    args = parser.parse_args(argv)
    if args.repeats < 1000:
        print("reproduce: error: --repeats: 1000 at least, or nothing is shown", file=sys.stderr)
        return 2
    found = [(truth, measured(truth, args.repeats)) for truth in TRUTHS]
    rows = [
        {
            "campaign": truth.name,
            "flights": str(truth.flights),
            "excursions_per_h": f"{truth.excursions_per_h:.4g}",
            "losses_per_h": f"{truth.loss_per_h:.4g}",
            "missed_excursions": f"{level.excursions:.4f}",
            "missed_losses": f"{level.losses:.4f}",
            "missed_share": f"{level.share:.4f}",
            "infinite_limits": f"{level.infinite:.4f}",
            "median_limit_over_truth": f"{level.over_truth:.3g}",
            "losses_as_scheduled": f"{level.as_scheduled:.4f}",
            "excursions_if_poisson": f"{level.unclustered:.4f}",
            "kept": "yes" if kept(level, args.repeats) else "no",
        }
        for truth, level in found
    ]
    args.out.mkdir(parents=True, exist_ok=True)
    write_bytes(args.out / "levels.csv", csv_text(rows).encode())
    print("\n".join(text_table(rows)))
    seen = (
        max(level.as_scheduled for _, level in found) > 2.0 * ERROR
        and max(level.unclustered for _, level in found) > 2.0 * ERROR
    )
    return 0 if seen and all(kept(level, args.repeats) for _, level in found) else 1


if __name__ == "__main__":
    sys.exit(main())
