"""Do the answers of statements keep their level, from flights to yes or no? Simulated campaigns of
four corners in common air.

    python -m campaigns.levels.answers --out campaigns/levels [--repeats 400]

A flight of an hour is aborted with probability q, at a moment that is uniform in it, in all corners
alike. Clusters of k excursions arrive beyond a small radius at one rate; the strongest of them go
on to the radius asked about, in a harder corner more of them. An aborted flight counts as one
excursion, so that the worst corner has a + q/(1 - q/2) excursions per hour flown
(levels/reproduce.py).

Each campaign is asked four questions: whether excursions are at most a little less frequent than at
the worst corner (a yes is wrong), whether aborted flights are (a yes is wrong), whether excursions
are at most a little more frequent (a no is wrong), and whether both are at most four times as
frequent, which is true: so often a yes is given. 5 in 100 may be wrong. Writes DIR/answers.csv.
Exit code 0: every level is kept, and is not where the small radius is hidden; 1: otherwise; 2: bad
input.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from campaigns.levels.study import LevelStudy, Results, allowed
from uqharness.campaign.statements import statements
from uqharness.statistics import NO, YES

ERROR, SEED = 0.05, 20161225
NEAR_M, ASKED_M = 10.0, 15.0
REACH = (0.25, 0.5, 0.75, 1.0)
"""Of each corner: the share of the worst corner's clusters that it has."""
LITTLE, AMPLE = 1e-6, 4.0
ASSUMED = 2.0
_COLUMNS = """campaign flights worst_per_h:.4g wrong_yes:.4f wrong_yes_losses:.4f wrong_no:.4f
    missed_share:.4f yes_to_four_times:.3f silent:.3f infinite_limits:.4f
    median_limit_over_truth:.3g kept"""


@dataclass(frozen=True)
class Truth:
    """A campaign's truth: clusters of ``cluster``; excursions per hour flown [1/h] beyond the small
    radius and, at the worst corner, beyond the one asked about; chance ``abort``;
    ``counts_near``: whether the campaign counts beyond the small radius."""

    campaign: str
    flights: int
    cluster: int
    near_per_h: float
    rate: float
    abort: float = 0.0
    counts_near: bool = True

    @property
    def loss_per_h(self) -> float:
        """Aborted flights per hour flown."""
        return self.abort / (1.0 - self.abort / 2.0)

    @property
    def worst_per_h(self) -> float:
        """Excursions per hour flown at the worst corner, an aborted flight counted as one."""
        return self.rate + self.loss_per_h

    @property
    def flight_share(self) -> float:
        """Share of the worst corner's flights with an excursion."""
        return 1.0 - (1.0 - self.abort) * float(np.exp(-self.rate / self.cluster))


TRUTHS = (
    Truth("single excursions", 80, 1, 0.6, 0.1),
    Truth("single excursions, most campaigns silent", 300, 1, 0.2, 0.001),
    Truth("clusters of 2", 80, 2, 0.6, 0.1),
    Truth("clusters of 4", 150, 4, 0.8, 0.1),
    Truth("clusters of 8", 300, 8, 0.8, 0.06),
    Truth("aborted flights alone", 150, 1, 0.0, 0.0, 0.04),
    Truth("single excursions and aborted flights", 200, 1, 0.6, 0.1, 0.03),
    Truth("clusters of 4 and aborted flights", 200, 4, 0.8, 0.06, 0.02),
    Truth("half of the flights aborted", 60, 1, 0.0, 0.0, 0.5),
    Truth("clusters of 4, of which the campaign knows nothing", 80, 4, 0.8, 0.1, counts_near=False),
)


def simulated(truth: Truth, generator: np.random.Generator) -> pd.DataFrame:
    """Simulate the case table of one campaign."""
    n, corners = truth.flights, len(REACH)
    is_lost = generator.random(n) < truth.abort
    hours = np.where(is_lost, generator.random(n), 1.0)
    clusters_near = generator.poisson(truth.near_per_h / truth.cluster * hours)
    additional = truth.rate / truth.near_per_h if truth.near_per_h else 0.0
    # A cluster that a corner has, every harder corner has.
    reach = [*np.diff([0.0, *REACH]) * additional, 1.0 - additional]
    clusters = generator.multinomial(clusters_near, reach)[:, :-1].cumsum(axis=1).T
    return pd.DataFrame(
        {
            "wind_mps": 3.0,
            "turbulence": "severe",
            "epistemic_id": np.repeat([f"{k}" for k in range(corners)], n),
            "status": np.tile(np.where(is_lost, "diverged", "ok"), corners),
            "duration_s": np.tile(3600.0 * hours, corners),
            f"excursions_{NEAR_M:g}m": np.tile(1.0 * truth.cluster * clusters_near, corners),
            f"excursions_{ASKED_M:g}m": 1.0 * truth.cluster * clusters.ravel(),
            f"excursions_{ASKED_M:g}m_3d": np.nan,
            "extrapolated_share": 0.0,
            "loss_of_control": 0.0,
        }
    )


def settings(truth: Truth, per_h: float, loss_per_h: float) -> Mapping[str, Any]:
    """Return a campaign's settings, as its file has them, with these acceptable rates."""
    air = {"duration_s": 3600.0, "flights": truth.flights}
    metrics = {"excursion_radius_m": [ASKED_M], "dispersion": ASSUMED}
    metrics |= {"acceptable_per_h": per_h, "acceptable_loss_per_h": loss_per_h}
    return {
        "stop": {"rule": "flights"},
        "aleatory": air | {"wind_mps": [3.0], "turbulence": ["severe"]},
        "metrics": metrics | ({"dispersion_radius_m": [NEAR_M]} if truth.counts_near else {}),
    }


def measured(truth: Truth, repeats: int, seed: int = SEED) -> dict[str, float]:
    """Simulate ``repeats`` campaigns and answer their questions; return shares of repeats.

    A wrong yes to excursions and to aborted flights, a wrong no, a share of flights with an
    excursion above its limit, a yes to four times the rate, no excursion at the worst corner,
    infinite upper limits; and the median upper limit over the truth.
    """
    key = [truth.flights, truth.cluster, round(1e6 * truth.rate), round(1e6 * truth.abort)]
    generator = np.random.default_rng([seed, *key])
    worst, loss = truth.worst_per_h, truth.loss_per_h
    # A yes needs both rates: the one that is not tested is asked with room.
    room = 100.0
    less, more = 1.0 - LITTLE, 1.0 + LITTLE
    questions = ((less * worst, room), (room, less * loss), (more * worst, room))
    rows = []
    for _ in range(repeats):
        frame = simulated(truth, generator)
        below, losses, above, ample = (
            statements(frame, settings(truth, *question))[0]
            for question in (*questions, (AMPLE * worst, AMPLE * worst))
        )
        upper = above.worst.upper
        row = {"wrong_yes": below.answer == YES}
        row |= {"wrong_yes_losses": truth.abort > 0.0 and losses.answer == YES}
        row |= {"wrong_no": above.answer == NO}
        row |= {"missed_share": above.flight_share_upper < truth.flight_share}
        row |= {"yes_to_four_times": ample.answer == YES, "silent": above.worst.rate == 0.0}
        rows.append(row | {"infinite_limits": np.isinf(upper), "over_truth": upper / worst})
    table = pd.DataFrame(rows).astype(float)
    level = table.drop(columns="over_truth").mean().to_dict()
    return level | {"median_limit_over_truth": float(table["over_truth"].median())}


def keeps_level(level: Mapping[str, float], repeats: int) -> bool:
    """Return whether no answer was wrong more often than allowed, and limits are mostly finite: an
    infinite one is never wrong."""
    invalid = max(level[n] for n in ("wrong_yes", "wrong_yes_losses", "wrong_no", "missed_share"))
    return invalid <= allowed(ERROR, repeats) and level["infinite_limits"] <= 0.5


def passes(results: Results, repeats: int) -> bool:
    """Return whether every level is kept, and is not where the small radius is hidden."""
    return all(keeps_level(level, repeats) == truth.counts_near for truth, level in results)


STUDY = LevelStudy(
    __doc__, "answers.csv", 400, 100, _COLUMNS, TRUTHS, measured, keeps_level, passes
)
main = STUDY.main

if __name__ == "__main__":
    sys.exit(main())
