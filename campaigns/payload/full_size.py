"""Payload varied: the corners at 3 m/s and severe turbulence with another mass in every flight, beside the same flights without.

python -m campaigns.payload.full_size fly            # goes on where it was ended
python -m campaigns.payload.full_size status
python -m campaigns.payload.full_size tables         # beside the flights of campaigns/excursions in the same airs
python -m campaigns.payload.full_size rerun --cell severe-3 --shard 0
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from campaigns.excursions.full_size import HOME as EXCURSIONS
from campaigns.excursions.full_size import plan as constant_plan
from campaigns.full_size.cells import common_airs, hours_each
from campaigns.full_size.command import Study, main
from campaigns.full_size.figures import MEDIANS, drawn_pboxes
from campaigns.full_size.folder import cell_table
from campaigns.full_size.plan import Plan
from campaigns.full_size.tables import COST, RATES, cost_table, rate_rows
from sysid.units import SLUG_KG
from uqharness.campaign.conditions import samples
from uqharness.errors import BadInputError
from uqharness.files import write_bytes, write_text
from uqharness.statistics.pbox import containment
from uqharness.text_tables import csv_text

HOME = Path(__file__).parent
FLIGHTS, AIRS = 500, 25
"""Flights of an hour per corner, and airs of a shard: 1600 hours."""
MASS = "variable_inertia/mass-slugs"
EFFECTS, PICTURE = "effects.csv", "pboxes.svg"


def plan() -> Plan:
    """All corners at the published size."""
    return Plan.read(HOME / "campaign.toml", AIRS).with_flights(FLIGHTS)


@dataclass(frozen=True)
class Effect:
    """What the mass does to a metric [its unit].

    ``slope_per_kg`` with its standard error: change of a flight's metric per kg of payload, from the same corner in the same air
    without it; the mean over the corners is one observation an air, and the line is free at 0 kg. ``box`` and ``constant_box``
    [best, worst corner's median]: the p-box at probability 0.5 with and without; ``area_ratio`` area over area. ``spread`` is the
    standard deviation of a corner's flights, in the mean over the corners.
    """

    metric: str
    airs: int
    slope_per_kg: float
    slope_error: float
    box: tuple[float, float]
    constant_box: tuple[float, float]
    area_ratio: float
    spread: float
    constant_spread: float


def effect(
    varied: pd.DataFrame, constant: pd.DataFrame, metric: str, nominal_slugs: float
) -> Effect:
    """The effect of the mass between two case tables of the same corners and airs. Raises BadInputError below three airs."""
    keys = ["epistemic_id", "aleatory_id"]
    pairs = varied[[*keys, metric, MASS]].merge(
        constant[[*keys, metric]], on=keys, suffixes=("", "_constant"), validate="1:1"
    )
    pairs["change"] = pairs[metric] - pairs[f"{metric}_constant"]
    by_air = pairs.groupby("aleatory_id")[[MASS, "change"]].mean().dropna()
    if len(by_air) < 3:
        raise BadInputError(
            f"{metric}: {len(by_air)} airs have a value with and without the payload; a slope needs three at least"
        )
    payload_kg = SLUG_KG * (by_air[MASS].to_numpy() - nominal_slugs)
    slope, error = _line(payload_kg, by_air["change"].to_numpy())
    known = [samples(frame, metric) for frame in (varied, constant)]
    boxes = [_medians(frame, metric) for frame in (varied, constant)]
    spreads = [
        float(frame.groupby("epistemic_id")[metric].std().mean()) for frame in (varied, constant)
    ]
    ratio = containment(known[0], known[1]).area_ratio
    return Effect(
        metric, len(by_air), slope, error, boxes[0], boxes[1], ratio, spreads[0], spreads[1]
    )


def _line(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Slope of a line through points (n,) and its standard error."""
    design = np.column_stack([np.ones_like(x), x])
    found, *_ = np.linalg.lstsq(design, y, rcond=None)
    spread = float(np.sum((y - design @ found) ** 2)) / (x.size - 2)
    return float(found[1]), float(np.sqrt(spread / np.sum((x - x.mean()) ** 2)))


def _medians(frame: pd.DataFrame, metric: str) -> tuple[float, float]:
    middle = frame.groupby("epistemic_id")[metric].median()
    return float(middle.min()), float(middle.max())


def tables(
    plan: Plan, shards: Path, out: Path, constant_shards: Path = EXCURSIONS / "shards"
) -> Sequence[str]:
    """effects.csv, rates.csv, pboxes.svg and cost.csv of the airs that were flown with and without the payload.

    Raises BadInputError where nothing was flown, or the flights without lack these airs.
    """
    out.mkdir(parents=True, exist_ok=True)
    (condition,) = plan.conditions
    other = constant_plan()
    varied, constant = common_airs(
        cell_table(plan, shards, condition)[0],
        cell_table(other, constant_shards, other.condition("severe-3"))[0],
    )
    nominal = plan.spec.aleatory.variables[MASS.removeprefix("variable_")].value(0.0, 0.5)
    found = [effect(varied, constant, metric, nominal) for metric in MEDIANS]
    write_bytes(out / EFFECTS, csv_text([_row(item) for item in found]).encode())
    write_bytes(
        out / RATES,
        csv_text([*rate_rows("payload varied", varied), *rate_rows("constant", constant)]).encode(),
    )
    title = f"64 corners, {hours_each(varied):g} h each, 3 m/s, severe turbulence"
    write_text(
        out / PICTURE,
        drawn_pboxes(
            {"payload varied": varied, "constant": constant}, MEDIANS, title, {}, columns=3
        ),
    )
    write_bytes(out / COST, cost_table(plan, shards))
    return [
        f"{e.metric}: {e.slope_per_kg:.3g} +/- {e.slope_error:.2g} per kg; p-box's middle {e.box[0]:.4g} to {e.box[1]:.4g}, "
        f"constant {e.constant_box[0]:.4g} to {e.constant_box[1]:.4g}; area {e.area_ratio:.3g} times"
        for e in found
    ]


def _row(item: Effect) -> dict[str, str]:
    return {
        "metric": item.metric,
        "airs": str(item.airs),
        "slope_per_kg": f"{item.slope_per_kg:.4g}",
        "slope_error": f"{item.slope_error:.2g}",
        "best": f"{item.box[0]:.4g}",
        "worst": f"{item.box[1]:.4g}",
        "constant_best": f"{item.constant_box[0]:.4g}",
        "constant_worst": f"{item.constant_box[1]:.4g}",
        "area_ratio": f"{item.area_ratio:.4g}",
        "spread": f"{item.spread:.3g}",
        "constant_spread": f"{item.constant_spread:.3g}",
    }


STUDY = Study(
    "campaigns.payload.full_size",
    "The loiter with a payload that differs from flight to flight",
    plan,
    HOME,
    tables,
)

if __name__ == "__main__":
    sys.exit(main(STUDY, sys.argv[1:]))
