"""Fig 3.10 at the published number of walks: 2,000 walks of the model's error, 50 flights of an
hour each, in the corners' air.

    python -m campaigns.time-varying.full_size fly  # also resumes an interrupted run
    python -m campaigns.time-varying.full_size status
    python -m campaigns.time-varying.full_size tables  # beside the corners of campaigns/excursions
    python -m campaigns.time-varying.full_size rerun --cell severe-3 --shard 0

The corners are those of Tables 3.1 and 3.2 in 3 m/s of wind and severe turbulence: the same seed,
so the same airs.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from campaigns.excursions.full_size import HOME as EXCURSIONS
from campaigns.excursions.full_size import plan as corners_plan
from campaigns.library.command import Study, main
from campaigns.library.plan import Plan
from campaigns.library.store import cell_table
from campaigns.library.tables import (
    MEDIANS,
    PICTURE,
    common_airs,
    hours_per_sample,
    pbox_drawing,
    write_cost,
    write_rates,
)
from uqharness.campaign.convergence import convergence_table, metric_convergence
from uqharness.files import write_bytes, write_text

from .reproduce import comparisons, write_table

HOME = Path(__file__).parent
WALKS, FLIGHTS = 2000, 50
"""Walks of the print, and a tenth of its flights of an hour a walk."""
AIRS, BLOCK = 5, 250
"""Airs and walks of a shard: 1250 hours. All walks fly the first airs before any flies the next."""
_ALL = 10**9


def plan() -> Plan:
    """Plan all walks, 50 airs each."""
    return Plan.read(HOME / "walks.toml", AIRS, BLOCK).with_samples(WALKS).with_flights(FLIGHTS)


def tables(
    plan: Plan, shards: Path, out: Path, corner_shards: Path = EXCURSIONS / "shards"
) -> Sequence[str]:
    """Write containment.csv, walks-enough.csv, rates.csv, pboxes.svg and cost.csv of the walks in
    the airs that all flew.

    Raises BadInputError where nothing was flown, or the corners lack these airs.
    """
    corners, seed = corners_plan(), plan.spec.campaign.seed
    outer, inner = common_airs(
        cell_table(corners, corner_shards, corners.condition("severe-3"))[0],
        cell_table(plan, shards, plan.conditions[0])[0],
    )
    results = list(comparisons(outer, inner))
    growth = [item for m in MEDIANS for item in metric_convergence(inner, m, _ALL, True, seed)]
    write_table(results, out)
    write_bytes(out / "walks-enough.csv", convergence_table(growth))
    kinds = {"corners": outer, "walks": inner}
    write_rates(out, kinds)
    counts = (frame["epistemic_id"].nunique() for frame in (outer, inner))
    title = "{} corners and {} walks, {:g} h each".format(*counts, hours_per_sample(inner))
    write_text(out / PICTURE, pbox_drawing(kinds, MEDIANS, title, {}, columns=3))
    write_cost(plan, shards, out)
    lines = [
        f"{item.metric}: {item.result.verdict}, area {item.result.area_ratio:.3g} of the corners'"
        for item in results
        if item.metric in MEDIANS
    ]
    for item in growth:
        total = item.growth[-1].area
        sizes = [f"{100.0 * part.area / total:.3g} % with {part.samples}" for part in item.growth]
        lines.append(f"{item.metric}: share of the p-box of all walks: {', '.join(sizes)}")
    return lines


STUDY = Study(
    "campaigns.time-varying.full_size",
    "Fig 3.10 at the published number of walks",
    plan,
    HOME,
    tables,
)

if __name__ == "__main__":
    sys.exit(main(STUDY, sys.argv[1:]))
