"""Fig 3.5: the nominal model in light turbulence, ten repeats of 500 flights of an hour.

    python -m campaigns.convergence.reproduce  # of flights.parquet
    python -m campaigns.convergence.reproduce SOURCE --repeats 10 --out DIR

SOURCE is a flights.parquet or a complete campaign folder. Writes convergence.csv,
flights-enough.csv, curves.svg and cost.csv.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from campaigns.library.flights import FLIGHTS, case_tables, settings
from campaigns.library.study import cells, exit_code, study_parser, write_csv
from campaigns.library.tables import MEDIANS, write_cost
from uqharness.campaign.conditions import CONFIDENCE
from uqharness.campaign.convergence import (
    CONVERGENCE,
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
REPEATS = 10
PART_SIZES = (10, 20, 50, 100, 200, 500)
_COLUMNS = "metric flights parts distance:.6g bound:.6g median_off:.6g"


def enough(frame: pd.DataFrame, metric: str) -> list[dict[str, Any]]:
    """Compare consecutive parts of 10, 20, 50, ... flights with all.

    ``distance`` [probability] is the largest of any part of ``flights`` from all flights, ``bound``
    what a band at 95 % over all ``parts`` parts allows for; the median of a part lies within
    ``median_off`` [the metric's unit] of that of all. Raises BadInputError where a flight has no
    value.
    """
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
        row = {"metric": metric, "flights": size, "parts": len(parts)}
        row["distance"] = max(stats.ks_2samp(part, ordered).statistic for part in parts)
        row["bound"] = band_half_width(size, len(parts), CONFIDENCE)
        medians = np.abs(np.median(parts, axis=1) - np.median(ordered))
        rows.append(row | {"median_off": float(medians.max())})
    return rows


def tables(source: Path, repeats: int, out: Path) -> None:
    """Write the tables of a source's flights, cut into so many repeats. Raises BadInputError."""
    frame, seed = next(case_tables(source)), int(settings(source)["campaign"]["seed"])
    results = [item for m in MEDIANS for item in metric_convergence(frame, m, repeats, False, seed)]
    rows = [cells(row, _COLUMNS) for metric in MEDIANS for row in enough(frame, metric)]
    write_csv(out / "flights-enough.csv", rows)
    write_bytes(out / CONVERGENCE, convergence_table(results))
    charts = [
        (figure.svg, figure.caption)
        for item in results
        for block in convergence_section(item).blocks
        if isinstance(block, Figures)
        for figure in block.items
    ]
    title = "Repeats of the nominal model's flights"
    write_text(out / "curves.svg", standalone(charts, title, columns=3))
    write_cost(source, out)
    print("\n".join(sentences(results)))


def main(argv: Sequence[str] | None = None) -> int:
    """Make the tables; exit code 0, or 2 for bad input."""
    parser = study_parser(__doc__, out=HOME)
    parser.add_argument("source", type=Path, nargs="?", default=HOME / FLIGHTS, metavar="SOURCE")
    parser.add_argument("--repeats", type=int, default=REPEATS, metavar="N", help="default 10")
    args = parser.parse_args(argv)
    return exit_code(lambda: tables(args.source, args.repeats, args.out))


if __name__ == "__main__":
    sys.exit(main())
