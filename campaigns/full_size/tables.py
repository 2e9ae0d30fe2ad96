"""Tables that campaigns of full size share: hours and time of the machine with what JSBSim said, and rates beside each other."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pandas as pd

from campaigns.full_size.cells import hours_each
from campaigns.full_size.folder import lines
from campaigns.full_size.plan import Plan
from uqharness.campaign.conditions import excursion_cells
from uqharness.statistics import best_and_worst
from uqharness.text_tables import csv_text

COST, RATES = "cost.csv", "rates.csv"
RADII_M = (15.0, 25.0)
"""Of the print."""


def cost_table(plan: Plan, shards: Path) -> bytes:
    """cost.csv: a row per condition, and one for all."""
    rows = []
    everything = [
        line for condition in plan.conditions for line in lines(shards, condition).values()
    ]
    parts = [
        (condition.label, list(lines(shards, condition).values())) for condition in plan.conditions
    ]
    for name, found in [*parts, ("all", everything)]:
        rows.append(
            {
                "condition": name,
                "shards": str(len(found)),
                "flights": str(sum(line.flights for line in found)),
                "hours": f"{sum(line.hours for line in found):.6g}",
                "failed": str(sum(line.failed for line in found)),
                "core_hours": f"{sum(line.core_s for line in found) / 3600.0:.3g}",
                "jsbsim_flights": str(sum(line.jsbsim_flights for line in found)),
                "jsbsim_core_hours": f"{sum(line.jsbsim_core_s for line in found) / 3600.0:.3g}",
                "jsbsim_excused": str(sum(line.jsbsim_excused for line in found)),
                "jsbsim_difference": f"{max((line.jsbsim_difference for line in found), default=0.0):.3g}",
                "engines": str(len({line.engine for line in found})),
            }
        )
    return csv_text(rows).encode()


def rate_rows(kind: str, frame: pd.DataFrame) -> Iterator[dict[str, str]]:
    """Rows of rates.csv: excursions per hour of a case table's samples by radius (horizontal distance).

    Limits of the worst sample hold over all samples at once, for excursions that do not cluster within a flight.
    """
    for cell in excursion_cells(frame, RADII_M):
        if cell.distance != "horizontal":
            continue
        best, worst = best_and_worst(cell.rates)
        yield {
            "kind": kind,
            "samples": str(len(cell.rates)),
            "hours_each": f"{hours_each(frame):g}",
            "radius_m": f"{cell.radius_m:g}",
            "mean_per_h": f"{sum(item.rate for item in cell.rates) / len(cell.rates):.4g}",
            "best_per_h": f"{best.rate:.4g}",
            "worst_per_h": f"{worst.rate:.4g}",
            "worst_lower_per_h": f"{worst.simultaneous[0]:.4g}",
            "worst_upper_per_h": f"{worst.simultaneous[1]:.4g}",
        }
