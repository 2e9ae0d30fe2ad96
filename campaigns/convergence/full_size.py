"""Fig 3.5 at the published size: the nominal model in light turbulence, ten repeats of 500 flights of an hour.

python -m campaigns.convergence.full_size fly            # goes on where it was ended; a shard is a repeat
python -m campaigns.convergence.full_size status
python -m campaigns.convergence.full_size tables
python -m campaigns.convergence.full_size rerun --cell light-0 --shard 3
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from campaigns.full_size.command import Study, main
from campaigns.full_size.figures import MEDIANS
from campaigns.full_size.folder import cell_table
from campaigns.full_size.plan import Plan
from campaigns.full_size.sketch import FINE
from campaigns.full_size.tables import COST, cost_table
from uqharness.campaign.conditions import CONFIDENCE
from uqharness.campaign.convergence import (
    CONVERGENCE,
    MetricConvergence,
    convergence_table,
    metric_convergence,
    sentences,
)
from uqharness.errors import BadInputError
from uqharness.files import write_bytes, write_text
from uqharness.report.parts import Figures
from uqharness.report.pbox import convergence_section
from uqharness.report.svg import standalone
from uqharness.statistics.pbox import band_half_width
from uqharness.text_tables import csv_text

HOME = Path(__file__).parent
FLIGHTS, LANES = 500, 250
"""Flights of a repeat, which is a shard, and those flown side by side."""
ENOUGH, CURVES = "flights-enough.csv", "curves.svg"


def plan() -> Plan:
    """Ten repeats, kept on a grid of 0.1 %, for their curves lie close together."""
    return replace(Plan.read(HOME / "campaign.toml", FLIGHTS, resolution=FINE), lanes=LANES)


@dataclass(frozen=True)
class Enough:
    """How well so many flights give a distribution function: distances are in probability, medians in the metric's unit.

    ``distance`` is the largest of any part of ``flights`` from all flights, ``bound`` what a band at 95 % over all ``parts`` parts
    allows for; the median of a part lies within ``median_off`` of that of all.
    """

    metric: str
    flights: int
    parts: int
    distance: float
    bound: float
    median_off: float


def enough(frame: pd.DataFrame, metric: str) -> list[Enough]:
    """Parts of 10, 20, 50, ... flights, one after the other, against all. Raises BadInputError where a flight has no value."""
    values = frame.sort_values("aleatory_id")[metric].to_numpy(dtype=float)
    if not np.isfinite(values).all():
        raise BadInputError(
            f"{metric}: a flight has no value; parts of flights that failed cannot be compared"
        )
    whole, found = np.sort(values), []
    for size in (10, 20, 50, 100, 200, 500):
        parts = values[: values.size // size * size].reshape(-1, size)
        if len(parts) < 2:
            break
        off = [_distance(np.sort(part), whole) for part in parts]
        medians = np.abs(np.median(parts, axis=1) - np.median(whole))
        found.append(
            Enough(
                metric,
                size,
                len(parts),
                max(off),
                band_half_width(size, len(parts), CONFIDENCE),
                float(medians.max()),
            )
        )
    return found


def _distance(part: np.ndarray, whole: np.ndarray) -> float:
    shares = [
        np.searchsorted(values, whole, side="right") / values.size for values in (part, whole)
    ]
    return float(np.abs(shares[0] - shares[1]).max())


def tables(plan: Plan, shards: Path, out: Path) -> Sequence[str]:
    """convergence.csv, flights-enough.csv, curves.svg and cost.csv of the repeats that are there, two at least."""
    out.mkdir(parents=True, exist_ok=True)
    (condition,) = plan.conditions
    frame, used = cell_table(plan, shards, condition)
    if len(used) < 2:
        raise BadInputError(
            f"{shards}: {len(used)} repeat was flown and two are needed to compare; run the command fly"
        )
    found: list[MetricConvergence] = []
    for metric in MEDIANS:
        found += metric_convergence(frame, metric, len(used), False, plan.spec.campaign.seed)
    write_bytes(out / CONVERGENCE, convergence_table(found))
    rows = [row for metric in MEDIANS for row in enough(frame, metric)]
    names = ("metric", "flights", "parts", "distance", "bound", "median_off")
    write_bytes(
        out / ENOUGH,
        csv_text([{n: _shown(getattr(row, n)) for n in names} for row in rows]).encode(),
    )
    write_text(out / CURVES, drawing(found))
    write_bytes(out / COST, cost_table(plan, shards))
    return sentences(found)


def drawing(found: Sequence[MetricConvergence]) -> str:
    """The repeats' distribution functions, metric by metric, as the text of an SVG file."""
    figures = [
        f
        for item in found
        for block in convergence_section(item).blocks
        if isinstance(block, Figures)
        for f in block.items
    ]
    return standalone(
        [(figure.svg, figure.caption) for figure in figures],
        "Repeats of the nominal model's flights",
        columns=3,
    )


def _shown(value: str | float) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


STUDY = Study(
    "campaigns.convergence.full_size", "Fig 3.5 at the published size", plan, HOME, tables
)

if __name__ == "__main__":
    sys.exit(main(STUDY, sys.argv[1:]))
