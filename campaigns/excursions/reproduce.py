"""Excursions over wind and turbulence beside the published Tables 3.1 and 3.2: where do they agree,
within the limits of both?

    python -m campaigns.excursions.reproduce RESULTS --out DIR

RESULTS is a complete campaign folder (campaigns/excursions). Writes DIR/beside-published.csv, a row
per radius, wind and turbulence. The print gives rates alone; their limits here are exact Poisson
ones of that rate in 500 h (Garwood 1936), simultaneous over the 64 corners among which best and
worst were picked. Exit code 0: nowhere beyond both limits; 1: somewhere; 2: bad input.
"""

from __future__ import annotations

import argparse
import io
import json
import math
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from campaigns.library.study import exit_code, published_table, study_parser, write_csv
from uqharness.campaign.conditions import CONFIDENCE
from uqharness.campaign.manifest import read_complete
from uqharness.campaign.statements import STATEMENTS
from uqharness.campaign.tables import EXCURSIONS, read_checked
from uqharness.errors import BadInputError
from uqharness.statistics.pbox import poisson_limits

PUBLISHED = {25.0: "3.1", 15.0: "3.2"}
"""Radius [m] -> table of the print."""
HOURS, CORNERS = 500.0, 64
"""Flight hours behind a published rate, and corners among which best and worst were picked (section
3.8)."""
TABLE = "beside-published.csv"
VERDICTS = ("as published", "more", "fewer")


@dataclass(frozen=True)
class Range:
    """A rate per hour within limits."""

    rate: float
    lower: float
    upper: float

    def beside(self, other: Range) -> str:
        """Return ``as published`` where the limits overlap; else ``more`` or ``fewer`` than in
        ``other``."""
        if self.lower > other.upper:
            return "more"
        return "fewer" if self.upper < other.lower else "as published"

    @classmethod
    def published(cls, rate: float) -> Range:
        """Return a printed rate within the limits of its count."""
        level = 1.0 - (1.0 - CONFIDENCE) / CORNERS
        return cls(rate, *poisson_limits(round(rate * HOURS), HOURS, level))


@dataclass(frozen=True)
class Cell:
    """One condition and radius, flown (``hours`` over all corners) and published.

    worst_poisson: with limits that hold if excursions do not cluster within a flight; those of the
    others hold in any case. Answers are to "at most 0.1 per hour?"; the print's goes by its rates
    alone.
    """

    radius_m: float
    turbulence: str
    wind_mps: float
    hours: float
    best: Range
    worst: Range
    worst_poisson: Range
    published_best: Range
    published_worst: Range
    answer: str
    published_answer: str

    @property
    def verdicts(self) -> tuple[str, str, str]:
        """Comparison with the print: the best corner, the worst, the worst if excursions do not
        cluster."""
        worst = self.published_worst
        return (
            self.best.beside(self.published_best),
            self.worst.beside(worst),
            self.worst_poisson.beside(worst),
        )

    @property
    def words(self) -> str:
        """A line for the terminal."""
        limits = f"worst within [{self.worst.lower:.3g}, {self.worst.upper:.3g}]"
        ours = f"[{self.best.rate:.3g}, {self.worst.rate:.3g}] per h, {limits}"
        print_ = f"published [{self.published_best.rate:g}, {self.published_worst.rate:g}]"
        _, worst, poisson = self.verdicts
        beside = worst if worst == poisson else f"{worst}; {poisson} if excursions do not cluster"
        air = f"{self.wind_mps:g} m/s {self.turbulence}"
        return f"{self.radius_m:g} m, {air}: {ours}; {print_}: {beside}"

    def row(self) -> dict[str, str]:
        """Return the row of beside-published.csv."""
        row = {"radius_m": f"{self.radius_m:g}", "turbulence": self.turbulence}
        row |= {"wind_mps": f"{self.wind_mps:g}", "hours": f"{self.hours:g}"}
        for name in ("best", "worst", "worst_poisson", "published_best", "published_worst"):
            for end in ("rate", "lower", "upper"):
                column = f"{name}{'' if end == 'rate' else '_' + end}_per_h"
                value = getattr(getattr(self, name), end)
                row[column] = "" if math.isnan(value) else f"{value:.6g}"
        # The first repeats the worst corner's rate, the others are never compared alone.
        for column in (
            "worst_poisson_per_h",
            "published_best_lower_per_h",
            "published_best_upper_per_h",
        ):
            del row[column]
        row |= dict(zip(("best", "worst", "worst_if_poisson"), self.verdicts, strict=True))
        return row | {"answer": self.answer, "published_answer": self.published_answer}


def published(radius_m: float) -> pd.DataFrame:
    """Read the print's table for a radius. Raises BadInputError where there is none."""
    if radius_m not in PUBLISHED:
        allowed = " and ".join(f"{r:g}" for r in sorted(PUBLISHED))
        raise BadInputError(
            f"no table was published for a radius of {radius_m:g} m; those for {allowed} m were"
        )
    return published_table(PUBLISHED[radius_m]).set_index("wind_mps")


def compare(folder: Path) -> list[Cell]:
    """Compare every cell of a complete campaign that is in print. Raises BadInputError."""
    manifest = read_complete(folder)
    counts, rows = (
        pd.read_csv(io.BytesIO(read_checked(folder, manifest, n))) for n in (EXCURSIONS, STATEMENTS)
    )
    keys = ["condition", "radius_m", "distance"]
    limits = [*keys, "simultaneous_lower_per_h", "simultaneous_upper_per_h"]
    rows = rows.merge(counts.loc[counts["worst"] == 1, limits], on=keys)
    acceptable = manifest["campaign"]["metrics"]["acceptable_per_h"]
    cells = list(cells_of(rows[rows["distance"] == "horizontal"], acceptable))
    if not cells:
        raise BadInputError(
            f"{folder}: no wind (0 to 7 m/s), turbulence and radius (15 or 25 m) of Tables 3.1 and "
            "3.2"
        )
    return cells


def cells_of(rows: pd.DataFrame, acceptable: float) -> Iterator[Cell]:
    """Yield rows of statements, with Poisson limits of the worst corner, beside the print; others
    are left out."""
    tables = {radius: published(radius) for radius in PUBLISHED}
    for row in rows[rows["radius_m"].isin(PUBLISHED)].to_dict("records"):
        radius, wind, turbulence = row["radius_m"], row["wind_mps"], row["turbulence"]
        table = tables[radius]
        if wind not in table.index or f"{turbulence}_best" not in table.columns:
            continue
        best, worst = (
            Range(*(row[f"{end}{which}_per_h"] for which in ("", "_lower", "_upper")))
            for end in ("best", "worst")
        )
        poisson = (row["simultaneous_lower_per_h"], row["simultaneous_upper_per_h"])
        printed = [float(table[f"{turbulence}_{end}"][wind]) for end in ("best", "worst")]
        yield Cell(
            radius,
            turbulence,
            wind,
            row["hours"],
            best,
            worst,
            Range(worst.rate, *poisson),
            Range.published(printed[0]),
            Range.published(printed[1]),
            row["answer"],
            "yes" if printed[1] <= acceptable else "no",
        )


def write_table(cells: Sequence[Cell], out: Path) -> None:
    """Write beside-published.csv."""
    write_csv(out / TABLE, [cell.row() for cell in cells])


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study and return the process's exit code."""
    parser = study_parser(__doc__, out=TABLE)
    parser.add_argument("results", type=Path, metavar="RESULTS")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(argv)
    return exit_code(lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    cells = compare(args.results)
    write_table(cells, args.out)
    bests, worsts, poisson = zip(*(cell.verdicts for cell in cells), strict=True)
    counts = {
        name: {word: Counter(part)[word] for word in VERDICTS}
        for name, part in (("worst", worsts), ("best", bests), ("poisson", poisson))
    }
    if args.json:
        print(json.dumps({"cells": len(cells), "worst": counts["worst"], "best": counts["best"]}))
    else:
        print("\n".join(cell.words for cell in cells))
        print(f"worst corner: {', '.join(f'{n} cells {w}' for w, n in counts['worst'].items())}")
        if poisson != worsts:
            words = ", ".join(f"{n} cells {w}" for w, n in counts["poisson"].items())
            print(f"if excursions do not cluster: {words}")
    return 0 if set(worsts) | set(bests) == {"as published"} else 1


if __name__ == "__main__":
    sys.exit(main())
