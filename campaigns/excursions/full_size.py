"""Tables 3.1 and 3.2 at the published size: 24 cells of wind and turbulence, 64 corners, 500 flights of an hour each.

python -m campaigns.excursions.full_size fly                        # goes on where it was ended, whenever that was
python -m campaigns.excursions.full_size status
python -m campaigns.excursions.full_size tables
python -m campaigns.excursions.full_size rerun --cell severe-3      # one cell once more, against its digests
"""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from campaigns.excursions.reproduce import Cell, cells_of, table
from campaigns.full_size.command import Study, main
from campaigns.full_size.folder import cell_table, lines
from campaigns.full_size.plan import Plan
from campaigns.full_size.tables import COST, cost_table
from uqharness.campaign.statements import STATEMENTS, Statement, statements, statements_csv
from uqharness.files import write_bytes
from uqharness.statistics import best_and_worst

HOME = Path(__file__).parent
FLIGHTS, AIRS = 500, 25
"""Flights of an hour per corner and cell, and those of a shard: 1600 hours, some 70 s of a core."""


def plan() -> Plan:
    """All cells at the published size."""
    return Plan.read(HOME / "campaign.toml", AIRS).with_flights(FLIGHTS)


def tables(plan: Plan, shards: Path, out: Path) -> Sequence[str]:
    """beside-published.csv, statements.csv and cost.csv of the cells of which anything was flown; one cell in memory at a time."""
    out.mkdir(parents=True, exist_ok=True)
    campaign, found = plan.spec.as_dict(), []
    for condition in plan.conditions:
        if lines(shards, condition):
            found += statements(cell_table(plan, shards, condition)[0], campaign)
    cells = beside_published(found, campaign["metrics"]["acceptable_per_h"])
    write_bytes(out / "beside-published.csv", table(cells))
    write_bytes(out / STATEMENTS, statements_csv(found))
    write_bytes(out / COST, cost_table(plan, shards))
    return [cell.words for cell in cells]


def beside_published(found: Sequence[Statement], acceptable_per_h: float) -> list[Cell]:
    """Cells of the print, each beside what was flown."""
    rows = pd.read_csv(io.BytesIO(statements_csv(found)))
    worst = [best_and_worst(item.cell.rates)[1].simultaneous for item in found]
    rows["simultaneous_lower_per_h"], rows["simultaneous_upper_per_h"] = zip(*worst, strict=True)
    return list(cells_of(rows[rows["distance"] == "horizontal"], acceptable_per_h))


STUDY = Study(
    "campaigns.excursions.full_size", "Tables 3.1 and 3.2 at the published size", plan, HOME, tables
)

if __name__ == "__main__":
    sys.exit(main(STUDY, sys.argv[1:]))
