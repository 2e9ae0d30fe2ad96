"""Fig 3.10 at the published number of walks: 2,000 walks of the model's error, 50 flights of an hour each, in the corners' air.

python -m campaigns.time-varying.full_size fly           # goes on where it was ended
python -m campaigns.time-varying.full_size status
python -m campaigns.time-varying.full_size tables        # beside the corners of campaigns/excursions
python -m campaigns.time-varying.full_size rerun --cell severe-3 --shard 0

The corners are those of Tables 3.1 and 3.2 in 3 m/s of wind and severe turbulence: the same seed, so the same airs.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from campaigns.excursions.full_size import HOME as EXCURSIONS
from campaigns.excursions.full_size import plan as corners_plan
from campaigns.full_size.cells import common_airs, hours_each
from campaigns.full_size.command import Study, main
from campaigns.full_size.figures import MEDIANS, drawn_pboxes
from campaigns.full_size.folder import cell_table
from campaigns.full_size.plan import Plan
from campaigns.full_size.tables import COST, RATES, cost_table, rate_rows
from uqharness.campaign.convergence import MetricConvergence, convergence_table, metric_convergence
from uqharness.files import write_bytes, write_text
from uqharness.text_tables import csv_text

from .reproduce import Compared, compared
from .reproduce import table as containment_table

HOME = Path(__file__).parent
WALKS, FLIGHTS = 2000, 50
"""Walks of the print, and a tenth of its flights of an hour a walk."""
AIRS, BLOCK = 5, 250
"""Airs and walks of a shard: 1250 hours. All walks fly the first airs before any flies the next."""
CONTAINMENT, ENOUGH, PICTURE = "containment.csv", "walks-enough.csv", "pboxes.svg"
_ALL = 10**9


def plan() -> Plan:
    """All walks, 50 airs each."""
    return Plan.read(HOME / "walks.toml", AIRS, BLOCK).with_samples(WALKS).with_flights(FLIGHTS)


def tables(
    plan: Plan, shards: Path, out: Path, corner_shards: Path = EXCURSIONS / "shards"
) -> Sequence[str]:
    """containment.csv, walks-enough.csv, rates.csv, pboxes.svg and cost.csv of the walks in the airs that all of them flew.

    Raises BadInputError where nothing was flown, or the corners lack these airs.
    """
    out.mkdir(parents=True, exist_ok=True)
    (condition,) = plan.conditions
    corners = corners_plan()
    outer, inner = common_airs(
        cell_table(corners, corner_shards, corners.condition("severe-3"))[0],
        cell_table(plan, shards, condition)[0],
    )
    found = list(compared(outer, inner))
    grown = [
        item
        for metric in MEDIANS
        for item in metric_convergence(inner, metric, _ALL, True, plan.spec.campaign.seed)
    ]
    write_bytes(out / CONTAINMENT, containment_table(found))
    write_bytes(out / ENOUGH, convergence_table(grown))
    write_bytes(
        out / RATES, csv_text([*rate_rows("corners", outer), *rate_rows("walks", inner)]).encode()
    )
    title = f"{outer['epistemic_id'].nunique()} corners and {inner['epistemic_id'].nunique()} walks, {hours_each(inner):g} h each"
    write_text(
        out / PICTURE,
        drawn_pboxes({"corners": outer, "walks": inner}, MEDIANS, title, {}, columns=3),
    )
    write_bytes(out / COST, cost_table(plan, shards))
    return [*_contained(found), *_grown(grown)]


def _contained(found: Sequence[Compared]) -> Iterator[str]:
    for item in found:
        if item.metric in MEDIANS:
            yield f"{item.metric}: {item.found.verdict}, area {item.found.area_ratio:.3g} of the corners'"


def _grown(found: Sequence[MetricConvergence]) -> Iterator[str]:
    for item in found:
        sizes = [
            f"{100.0 * part.area / item.growth[-1].area:.3g} % with {part.samples}"
            for part in item.growth
        ]
        yield f"{item.metric}: share of the p-box of all walks: {', '.join(sizes)}"


STUDY = Study(
    "campaigns.time-varying.full_size",
    "Fig 3.10 at the published number of walks",
    plan,
    HOME,
    tables,
)

if __name__ == "__main__":
    sys.exit(main(STUDY, sys.argv[1:]))
