"""Payload varied: the corners at 3 m/s and severe turbulence with another mass in every flight,
beside the same flights without.

    python -m campaigns.payload.full_size fly  # also resumes an interrupted run
    python -m campaigns.payload.full_size status
    python -m campaigns.payload.full_size tables  # beside campaigns/excursions
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
from campaigns.library.command import Study, main
from campaigns.library.plan import Plan
from campaigns.library.store import cell_table
from campaigns.library.study import cells, write_csv
from campaigns.library.tables import (
    MEDIANS,
    PICTURE,
    common_airs,
    hours_per_sample,
    pbox_drawing,
    write_cost,
    write_rates,
)
from sysid.units import SLUG_KG
from uqharness.campaign.conditions import samples
from uqharness.errors import BadInputError
from uqharness.files import write_text
from uqharness.statistics.pbox import containment

HOME = Path(__file__).parent
FLIGHTS, AIRS = 500, 25
"""Flights of an hour per corner, and airs of a shard: 1600 hours."""
MASS = "variable_inertia/mass-slugs"
_COLUMNS = """metric airs slope_per_kg:.4g slope_error:.2g best:.4g worst:.4g constant_best:.4g
    constant_worst:.4g area_ratio:.4g spread:.3g constant_spread:.3g"""


def plan() -> Plan:
    """Plan all corners at the published size."""
    return Plan.read(HOME / "campaign.toml", AIRS).with_flights(FLIGHTS)


@dataclass(frozen=True)
class Effect:
    """What the mass does to a metric [its unit].

    ``slope_per_kg`` with its standard error: change of a flight's metric per kg of payload, from
    the same corner in the same air without it; the mean over the corners is one observation an air,
    and the line is free at 0 kg. ``best`` and ``worst`` corner's medians: the p-box at probability
    0.5 with the payload, ``constant_`` without; ``area_ratio`` area over area. ``spread`` is the
    standard deviation of a corner's flights, in the mean over the corners.
    """

    metric: str
    airs: int
    slope_per_kg: float
    slope_error: float
    best: float
    worst: float
    constant_best: float
    constant_worst: float
    area_ratio: float
    spread: float
    constant_spread: float


def effect(
    varied: pd.DataFrame, constant: pd.DataFrame, metric: str, nominal_slugs: float
) -> Effect:
    """Estimate the effect of the mass from two case tables of the same corners and airs. Raises
    BadInputError below three airs."""
    keys = ["epistemic_id", "aleatory_id"]
    pairs = varied[[*keys, metric, MASS]].merge(
        constant[[*keys, metric]], on=keys, suffixes=("", "_constant"), validate="1:1"
    )
    pairs["change"] = pairs[metric] - pairs[f"{metric}_constant"]
    by_air = pairs.groupby("aleatory_id")[[MASS, "change"]].mean().dropna()
    if len(by_air) < 3:
        raise BadInputError(
            f"{metric}: {len(by_air)} airs have a value with and without the payload; "
            "a slope needs three at least"
        )
    payload_kg = SLUG_KG * (by_air[MASS].to_numpy() - nominal_slugs)
    slope, error = _line(payload_kg, by_air["change"].to_numpy())
    frames = (varied, constant)
    medians = [f.groupby("epistemic_id")[metric].median() for f in frames]
    boxes = [float(end) for part in medians for end in (part.min(), part.max())]
    ratio = containment(*(samples(frame, metric) for frame in frames)).area_ratio
    spreads = [float(f.groupby("epistemic_id")[metric].std().mean()) for f in frames]
    return Effect(metric, len(by_air), slope, error, *boxes, ratio, *spreads)


def _line(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Fit a line to points (n,) and return its slope with the standard error."""
    design = np.column_stack([np.ones_like(x), x])
    line, *_ = np.linalg.lstsq(design, y, rcond=None)
    variance = float(np.sum((y - design @ line) ** 2)) / (x.size - 2)
    return float(line[1]), float(np.sqrt(variance / np.sum((x - x.mean()) ** 2)))


def tables(
    plan: Plan, shards: Path, out: Path, constant_shards: Path = EXCURSIONS / "shards"
) -> Sequence[str]:
    """Write effects.csv, rates.csv, pboxes.svg and cost.csv of the airs that were flown with and
    without the payload.

    Raises BadInputError where nothing was flown, or the flights without lack these airs.
    """
    other = constant_plan()
    varied, constant = common_airs(
        cell_table(plan, shards, plan.conditions[0])[0],
        cell_table(other, constant_shards, other.condition("severe-3"))[0],
    )
    nominal = plan.spec.aleatory.variables[MASS.removeprefix("variable_")].value(0.0, 0.5)
    effects = [effect(varied, constant, metric, nominal) for metric in MEDIANS]
    write_csv(out / "effects.csv", (cells(item, _COLUMNS) for item in effects))
    kinds = {"payload varied": varied, "constant": constant}
    write_rates(out, kinds)
    title = f"64 corners, {hours_per_sample(varied):g} h each, 3 m/s, severe turbulence"
    write_text(out / PICTURE, pbox_drawing(kinds, MEDIANS, title, {}, columns=3))
    write_cost(plan, shards, out)
    return [
        f"{e.metric}: {e.slope_per_kg:.3g} +/- {e.slope_error:.2g} per kg; p-box's middle "
        f"{e.best:.4g} to {e.worst:.4g}, constant {e.constant_best:.4g} to "
        f"{e.constant_worst:.4g}; area {e.area_ratio:.3g} times"
        for e in effects
    ]


STUDY = Study(
    "campaigns.payload.full_size",
    "The loiter with a payload that differs from flight to flight",
    plan,
    HOME,
    tables,
)

if __name__ == "__main__":
    sys.exit(main(STUDY, sys.argv[1:]))
