"""Tables 3.1 and 3.2: excursions over wind and turbulence compared with the published rates, within
the limits of both.

    python -m campaigns.excursions.reproduce  # of flights.parquet
    python -m campaigns.excursions.reproduce SOURCE --out DIR

SOURCE is a flights.parquet beside its campaign.toml, or a complete campaign folder. Writes
beside-published.csv (a row per radius, wind and turbulence), statements.csv and cost.csv. The print
gives rates alone; their limits here are exact Poisson ones of that rate in 500 h (Garwood 1936),
simultaneous over the 64 corners among which best and worst were picked. Exit code 0: nowhere beyond
both limits; 1: somewhere; 2: bad input.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from campaigns.library.flights import FLIGHTS, case_tables, settings
from campaigns.library.study import exit_code, published_table, study_parser, write_csv
from campaigns.library.tables import write_cost
from uqharness.campaign.conditions import CONFIDENCE
from uqharness.campaign.statements import STATEMENTS, Statement, statements, statements_csv
from uqharness.errors import BadInputError
from uqharness.files import write_bytes
from uqharness.statistics import best_and_worst
from uqharness.statistics.pbox import poisson_limits

HOME = Path(__file__).parent
TABLE = "beside-published.csv"
PUBLISHED = {25.0: "3.1", 15.0: "3.2"}
"""Radius [m] -> table of the print."""
HOURS, CORNERS = 500.0, 64
"""Flight hours behind a published rate, and corners among which best and worst were picked (section
3.8)."""
Range = tuple[float, float, float]
"""A rate per hour, its lower and its upper limit."""


def verdict(ours: Range, other: Range) -> str:
    """Return ``as published`` where the limits overlap; else ``more`` or ``fewer`` than in
    ``other``."""
    if ours[1] > other[2]:
        return "more"
    return "fewer" if ours[2] < other[1] else "as published"


def published(rate: float) -> Range:
    """Return a printed rate within the limits of its count."""
    level = 1.0 - (1.0 - CONFIDENCE) / CORNERS
    return rate, *poisson_limits(round(rate * HOURS), HOURS, level)


def compare(answers: Sequence[Statement], acceptable_per_h: float) -> Iterator[dict[str, str]]:
    """Yield the rows of beside-published.csv; conditions and radii that are not in print are left
    out.

    Limits hold in any case; those of ``worst_poisson`` only if excursions do not cluster within a
    flight. The published answer goes by the printed rate alone.
    """
    tables = {r: published_table(number).set_index("wind_mps") for r, number in PUBLISHED.items()}
    for item in answers:
        cell, condition = item.cell, item.cell.condition
        table = tables.get(cell.radius_m)
        if cell.distance != "horizontal" or table is None:
            continue
        if condition.wind_mps not in table.index or f"{condition.turbulence}_best" not in table:
            continue
        best, worst = ((r.rate, r.lower, r.upper) for r in (item.best, item.worst))
        poisson = (worst[0], *best_and_worst(cell.rates)[1].simultaneous)
        print_best, print_worst = (
            published(float(table[f"{condition.turbulence}_{end}"][condition.wind_mps]))
            for end in ("best", "worst")
        )
        row = {"radius_m": f"{cell.radius_m:g}", "turbulence": condition.turbulence}
        row |= {"wind_mps": f"{condition.wind_mps:g}"}
        row |= {"hours": f"{round(sum(rate.hours for rate in cell.rates), 6):g}"}
        row |= _columns("best", best) | _columns("worst", worst)
        row |= _columns("worst_poisson", poisson, first=1)
        row["published_best_per_h"] = f"{print_best[0]:.6g}"
        row |= _columns("published_worst", print_worst)
        row |= {"best": verdict(best, print_best), "worst": verdict(worst, print_worst)}
        row |= {"worst_if_poisson": verdict(poisson, print_worst), "answer": item.answer}
        yield row | {"published_answer": "yes" if print_worst[0] <= acceptable_per_h else "no"}


def _columns(name: str, values: Range, first: int = 0) -> dict[str, str]:
    names = [f"{name}{end}_per_h" for end in ("", "_lower", "_upper")]
    texts = ["" if math.isnan(value) else f"{value:.6g}" for value in values]
    return dict(list(zip(names, texts, strict=True))[first:])


def main(argv: Sequence[str] | None = None) -> int:
    """Write the tables and return the process's exit code."""
    parser = study_parser(__doc__)
    parser.add_argument("source", type=Path, nargs="?", default=HOME / FLIGHTS, metavar="SOURCE")
    parser.add_argument("--out", type=Path, metavar="DIR", help="default: beside SOURCE")
    args = parser.parse_args(argv)
    return exit_code(lambda: _run(args.source, args.out or args.source.parent))


def _run(source: Path, out: Path) -> int:
    campaign = settings(source)
    answers = [item for frame in case_tables(source) for item in statements(frame, campaign)]
    rows = list(compare(answers, campaign["metrics"]["acceptable_per_h"]))
    if not rows:
        raise BadInputError(
            f"{source}: no wind (0 to 7 m/s), turbulence and radius (15 or 25 m) of Tables 3.1 and "
            "3.2"
        )
    write_csv(out / TABLE, rows)
    write_bytes(out / STATEMENTS, statements_csv(answers))
    write_cost(source, out)
    for row in rows:
        place = f"{row['radius_m']} m, {row['wind_mps']} m/s {row['turbulence']}"
        ours, print_ = (
            f"[{row[n + 'best_per_h']}, {row[n + 'worst_per_h']}]" for n in ("", "published_")
        )
        limits = f"[{row['worst_lower_per_h']}, {row['worst_upper_per_h']}]"
        print(f"{place}: {ours} per h, worst within {limits}; published {print_}: {row['worst']}")
    for name in ("worst", "best", "worst_if_poisson"):
        counts = Counter(row[name] for row in rows)
        print(f"{name}: {', '.join(f'{n} cells {word}' for word, n in counts.items())}")
    return 0 if {row[n] for row in rows for n in ("best", "worst")} == {"as published"} else 1


if __name__ == "__main__":
    sys.exit(main())
