"""Fig 3.5 at the published size: the nominal model in light turbulence, ten repeats of 500 flights
of an hour.

    python -m campaigns.convergence.full_size fly  # resumes too; a shard is a repeat
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

from campaigns.library.command import Study, main
from campaigns.library.grid import FINE
from campaigns.library.plan import Plan
from campaigns.library.store import cell_table
from campaigns.library.study import cells, write_csv
from campaigns.library.tables import MEDIANS, write_cost
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

HOME = Path(__file__).parent
FLIGHTS, LANES = 500, 250
"""Flights of a repeat, which is a shard, and those flown side by side."""
PART_SIZES = (10, 20, 50, 100, 200, 500)
_COLUMNS = "metric flights parts distance:.6g bound:.6g median_off:.6g"


def plan() -> Plan:
    """Plan ten repeats, kept on a grid of 0.1 % because their curves lie close together."""
    return replace(Plan.read(HOME / "campaign.toml", FLIGHTS, resolution=FINE), lanes=LANES)


@dataclass(frozen=True)
class Enough:
    """How well so many flights give a distribution function: distances are in probability, medians
    in the metric's unit.

    ``distance`` is the largest of any part of ``flights`` from all flights, ``bound`` what a band
    at 95 % over all ``parts`` parts allows for; the median of a part lies within ``median_off`` of
    that of all.
    """

    metric: str
    flights: int
    parts: int
    distance: float
    bound: float
    median_off: float


def enough(frame: pd.DataFrame, metric: str) -> list[Enough]:
    """Compare consecutive parts of 10, 20, 50, ... flights with all. Raises BadInputError where a
    flight has no value."""
    values = frame.sort_values("aleatory_id")[metric].to_numpy(dtype=float)
    if not np.isfinite(values).all():
        raise BadInputError(
            f"{metric}: a flight has no value; parts of flights that failed cannot be compared"
        )
    ordered, rows = np.sort(values), []
    for size in PART_SIZES:
        parts = values[: values.size // size * size].reshape(-1, size)
        if len(parts) < 2:
            break
        distance = max(_distance(np.sort(part), ordered) for part in parts)
        medians = np.abs(np.median(parts, axis=1) - np.median(ordered))
        bound = band_half_width(size, len(parts), CONFIDENCE)
        rows.append(Enough(metric, size, len(parts), distance, bound, float(medians.max())))
    return rows


def _distance(part: np.ndarray, ordered: np.ndarray) -> float:
    shares = [np.searchsorted(v, ordered, side="right") / v.size for v in (part, ordered)]
    return float(np.abs(shares[0] - shares[1]).max())


def tables(plan: Plan, shards: Path, out: Path) -> Sequence[str]:
    """Write convergence.csv, flights-enough.csv, curves.svg and cost.csv of the repeats flown so
    far, two at least."""
    frame, repeats = cell_table(plan, shards, plan.conditions[0])
    if len(repeats) < 2:
        raise BadInputError(
            f"{shards}: {len(repeats)} repeat was flown and two are needed to compare; "
            "run the command fly"
        )
    results = [
        item
        for metric in MEDIANS
        for item in metric_convergence(frame, metric, len(repeats), False, plan.spec.campaign.seed)
    ]
    rows = [cells(row, _COLUMNS) for metric in MEDIANS for row in enough(frame, metric)]
    write_csv(out / "flights-enough.csv", rows)
    write_bytes(out / CONVERGENCE, convergence_table(results))
    write_text(out / "curves.svg", drawing(results))
    write_cost(plan, shards, out)
    return sentences(results)


def drawing(results: Sequence[MetricConvergence]) -> str:
    """Draw the repeats' distribution functions, metric by metric, as the text of an SVG file."""
    charts = [
        (figure.svg, figure.caption)
        for item in results
        for block in convergence_section(item).blocks
        if isinstance(block, Figures)
        for figure in block.items
    ]
    return standalone(charts, "Repeats of the nominal model's flights", columns=3)


STUDY = Study(
    "campaigns.convergence.full_size", "Fig 3.5 at the published size", plan, HOME, tables
)

if __name__ == "__main__":
    sys.exit(main(STUDY, sys.argv[1:]))
