"""Tables 3.1 and 3.2 at the published size: 24 cells of wind and turbulence, 64 corners, 500
flights of an hour each.

    python -m campaigns.excursions.full_size fly  # also resumes an interrupted run
    python -m campaigns.excursions.full_size status
    python -m campaigns.excursions.full_size tables
    python -m campaigns.excursions.full_size rerun --cell severe-3  # one cell once more
"""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from campaigns.excursions.reproduce import cells_of, write_table
from campaigns.library.command import Study, main
from campaigns.library.plan import Plan
from campaigns.library.store import cell_table, records
from campaigns.library.tables import write_cost
from uqharness.campaign.statements import STATEMENTS, statements, statements_csv
from uqharness.files import write_bytes
from uqharness.statistics import best_and_worst

HOME = Path(__file__).parent
FLIGHTS, AIRS = 500, 25
"""Flights of an hour per corner and cell, and those of a shard: 1600 hours, some 70 s of a core."""


def plan() -> Plan:
    """Plan all cells at the published size."""
    return Plan.read(HOME / "campaign.toml", AIRS).with_flights(FLIGHTS)


def tables(plan: Plan, shards: Path, out: Path) -> Sequence[str]:
    """Write beside-published.csv, statements.csv and cost.csv of the cells flown so far; one cell
    in memory at a time."""
    campaign, answers = plan.spec.as_dict(), []
    for condition in plan.conditions:
        if records(shards, condition):
            answers += statements(cell_table(plan, shards, condition)[0], campaign)
    rows = pd.read_csv(io.BytesIO(statements_csv(answers)))
    worst = [best_and_worst(item.cell.rates)[1].simultaneous for item in answers]
    rows["simultaneous_lower_per_h"], rows["simultaneous_upper_per_h"] = zip(*worst, strict=True)
    acceptable = campaign["metrics"]["acceptable_per_h"]
    cells = list(cells_of(rows[rows["distance"] == "horizontal"], acceptable))
    write_table(cells, out)
    write_bytes(out / STATEMENTS, statements_csv(answers))
    write_cost(plan, shards, out)
    return [cell.words for cell in cells]


STUDY = Study(
    "campaigns.excursions.full_size", "Tables 3.1 and 3.2 at the published size", plan, HOME, tables
)

if __name__ == "__main__":
    sys.exit(main(STUDY, sys.argv[1:]))
