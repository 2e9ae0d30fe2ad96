"""What every campaign of full size tells beside its own tables: hours, time of the machine, and what JSBSim said."""

from __future__ import annotations

from pathlib import Path

from campaigns.full_size.folder import lines
from campaigns.full_size.plan import Plan
from uqharness.text_tables import csv_text

COST = "cost.csv"


def cost_table(plan: Plan, shards: Path) -> bytes:
    """cost.csv: a row per condition, and one for all."""
    rows = []
    everything = [line for condition in plan.conditions for line in lines(shards, condition).values()]
    parts = [(condition.label, list(lines(shards, condition).values())) for condition in plan.conditions]
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
