"""Fig 3.10: does the p-box of model-form errors that change in flight lie within that of the
corners?

    python -m campaigns.time-varying.reproduce  # 2,000 walks of flights.parquet, 50 hours each
    python -m campaigns.time-varying.reproduce CORNERS WALKS --out DIR

CORNERS and WALKS are flights.parquet files or complete campaign folders with the same conditions,
seed and duration; by default the cell severe-3 of campaigns/excursions and the walks beside this
file. The airs that all samples flew are compared. Writes containment.csv, walks-enough.csv,
rates.csv, pboxes.svg and cost.csv. Exit code 0: every p-box lies inside, or outside by no more than
chance explains; 1: one does not; 2: bad input.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from campaigns.excursions.reproduce import HOME as EXCURSIONS
from campaigns.library.flights import FLIGHTS, case_tables, cell_name, settings
from campaigns.library.study import cells, exit_code, study_parser, write_csv
from campaigns.library.tables import (
    MEDIANS,
    PICTURE,
    common_airs,
    hours_per_sample,
    pbox_drawing,
    write_cost,
    write_rates,
)
from uqharness.campaign.conditions import (
    CONFIDENCE,
    ERROR_METRICS,
    OPTIONAL_METRICS,
    Condition,
    conditions,
    samples,
)
from uqharness.campaign.convergence import convergence_table, metric_convergence
from uqharness.errors import BadInputError
from uqharness.files import write_bytes, write_text
from uqharness.statistics.pbox import containment

HOME = Path(__file__).parent
CONTAINMENT = "containment.csv"
_COLUMNS = """metric condition corners walks hours_per_corner:g hours_per_walk:g area_ratio:.6g
    excess_lower:.6g at_lower:.6g excess_upper:.6g at_upper:.6g chance:.6g verdict"""
_SAME = ("duration_s", "burn_in_s", "wind_from_deg", "turbulence_source", "sensor_noise")
_ALL = 10**9


def refuse_unlike(sources: dict[Path, Any]) -> None:
    """Raise BadInputError that names every setting in which two campaigns differ and must not;
    ``sources``: their settings."""
    rows = []
    for campaign in sources.values():
        row = {f"[aleatory] {name}": campaign["aleatory"][name] for name in _SAME}
        row |= {f"[campaign] {name}": campaign["campaign"][name] for name in ("seed", "aircraft")}
        rows.append(row)
    first, second = rows
    unlike = [f"{n} ({first[n]} and {second[n]})" for n in first if first[n] != second[n]]
    if unlike:
        raise BadInputError(
            f"{' and '.join(map(str, sources))} differ in {', '.join(unlike)}: their medians have "
            "another spread or another air and cannot be compared"
        )


def comparisons(
    outer: pd.DataFrame, inner: pd.DataFrame, condition: Condition
) -> Iterator[dict[str, Any]]:
    """Yield by metric how the walks' p-box ``inner`` lies to the corners' ``outer`` in one
    condition, from how many samples and hours."""
    names = (*ERROR_METRICS, *OPTIONAL_METRICS)
    for metric in (name for name in names if name in outer and name in inner):
        curves = [samples(frame, metric) for frame in (outer, inner)]
        if not all(any(sample.values.size for sample in part) for part in curves):
            continue
        row: dict[str, Any] = {"metric": metric, "condition": condition.label}
        row |= {"corners": len(curves[0]), "walks": len(curves[1])}
        row |= {"hours_per_corner": hours_per_sample(outer)}
        row |= {"hours_per_walk": hours_per_sample(inner)}
        result = containment(curves[1], curves[0], CONFIDENCE)
        yield row | asdict(result) | {"verdict": result.verdict}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study and return the process's exit code."""
    parser = study_parser(__doc__, out=HOME)
    option, corners, walks = parser.add_argument, EXCURSIONS / FLIGHTS, HOME / FLIGHTS
    option("corners", type=Path, nargs="?", default=corners, metavar="CORNERS")
    option("walks", type=Path, nargs="?", default=walks, metavar="WALKS")
    args = parser.parse_args(argv)
    return exit_code(lambda: compare(args.corners, args.walks, args.out))


def compare(corners: Path, walks: Path, out: Path) -> int:
    """Write all tables; 1 where a p-box lies outside. Raises BadInputError for campaigns that
    differ in more than their epistemic samples and their size."""
    file = None if walks.is_dir() else HOME / "walks.toml"
    campaign = settings(walks, file)
    refuse_unlike({corners: settings(corners), walks: campaign})
    rows, growth, kinds = [], [], {}
    for frame in case_tables(walks, file):
        (condition,) = conditions(frame)
        outer, inner = common_airs(next(case_tables(corners, cell=cell_name(condition))), frame)
        rows += list(comparisons(outer, inner, condition))
        seed = int(campaign["campaign"]["seed"])
        growth += [x for m in MEDIANS for x in metric_convergence(inner, m, _ALL, True, seed)]
        kinds = {"corners": outer, "walks": inner}
    write_csv(out / CONTAINMENT, [cells(row, _COLUMNS) for row in rows])
    write_bytes(out / "walks-enough.csv", convergence_table(growth))
    write_rates(out, kinds)
    counts = (frame["epistemic_id"].nunique() for frame in kinds.values())
    title = "{} corners and {} walks, {:g} h each".format(*counts, hours_per_sample(inner))
    write_text(out / PICTURE, pbox_drawing(kinds, MEDIANS, title, {}, columns=3))
    write_cost(walks, out)
    for row in rows:
        if row["metric"] in MEDIANS:
            area = f"area {row['area_ratio']:.3g} of the corners'"
            print(f"{row['metric']}, {row['condition']}: {row['verdict']}, {area}")
    for item in growth:
        total = item.growth[-1].area if item.growth else math.nan
        sizes = [f"{100.0 * part.area / total:.3g} % with {part.samples}" for part in item.growth]
        print(f"{item.metric}: share of the p-box of all walks: {', '.join(sizes)}")
    return 1 if any(row["verdict"] == "outside" for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
