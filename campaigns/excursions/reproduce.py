"""Excursions over wind and turbulence beside the published Tables 3.1 and 3.2: where do they agree, within both countings' limits?

    python -m campaigns.excursions.reproduce RESULTS --out DIR

RESULTS is a complete campaign folder (campaigns/excursions). Writes DIR/beside-published.csv, a row per radius, wind and
turbulence. The print gives rates alone; their limits here are exact Poisson ones of that rate in 500 h (Garwood 1936),
simultaneous over the 64 corners among which best and worst were picked.
Exit code 0: nowhere beyond both limits; 1: somewhere; 2: bad input.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from uqharness.campaign.conditions import CONFIDENCE
from uqharness.campaign.folder.manifest import read_complete
from uqharness.campaign.folder.tables import EXCURSIONS, read_checked
from uqharness.campaign.statements import STATEMENTS
from uqharness.errors import BadInputError
from uqharness.files import PROJECT_ROOT, write_bytes
from uqharness.statistics.pbox import poisson_limits

PUBLISHED = {25.0: "table_3_1.csv", 15.0: "table_3_2.csv"}
"""Radius [m] -> table of the print."""
HOURS, CORNERS = 500.0, 64
"""Flight hours behind a published rate, and corners among which best and worst were picked (section 3.8)."""
_COLUMNS = (
    "radius_m",
    "turbulence",
    "wind_mps",
    "hours",
    "best_per_h",
    "best_lower_per_h",
    "best_upper_per_h",
    "worst_per_h",
    "worst_lower_per_h",
    "worst_upper_per_h",
    "worst_poisson_lower_per_h",
    "worst_poisson_upper_per_h",
    "published_best_per_h",
    "published_worst_per_h",
    "published_worst_lower_per_h",
    "published_worst_upper_per_h",
    "best",
    "worst",
    "worst_if_poisson",
    "answer",
    "published_answer",
)


@dataclass(frozen=True)
class Range:
    """A rate per hour within limits."""

    rate: float
    lower: float
    upper: float

    def beside(self, other: Range) -> str:
        """``as published`` where the limits overlap; else ``more`` or ``fewer`` than in ``other``."""
        if self.lower > other.upper:
            return "more"
        return "fewer" if self.upper < other.lower else "as published"


@dataclass(frozen=True)
class Cell:
    """One condition and radius, flown (``hours`` over all corners) and published.

    worst_poisson: with limits that hold if excursions do not cluster within a flight; those of the others hold in any case.
    Answers are to "at most 0.1 per hour?"; the print's goes by its rates alone.
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
        """Beside the print: the best corner, the worst, the worst if excursions do not cluster."""
        worst = self.published_worst
        return (
            self.best.beside(self.published_best),
            self.worst.beside(worst),
            self.worst_poisson.beside(worst),
        )

    @property
    def words(self) -> str:
        """A line for the terminal."""
        said = f"[{self.best.rate:.3g}, {self.worst.rate:.3g}] per h, worst within [{self.worst.lower:.3g}, {self.worst.upper:.3g}]"
        told = f"published [{self.published_best.rate:g}, {self.published_worst.rate:g}]"
        _, worst, alone = self.verdicts
        beside = worst if worst == alone else f"{worst}; {alone} if excursions do not cluster"
        return f"{self.radius_m:g} m, {self.wind_mps:g} m/s {self.turbulence}: {said}; {told}: {beside}"


def published(radius_m: float) -> pd.DataFrame:
    """The print's table for a radius. Raises BadInputError where there is none."""
    if radius_m not in PUBLISHED:
        allowed = " and ".join(f"{r:g}" for r in sorted(PUBLISHED))
        raise BadInputError(
            f"no table was published for a radius of {radius_m:g} m; those for {allowed} m were"
        )
    path = PROJECT_ROOT / "tests" / "reference" / PUBLISHED[radius_m]
    return pd.read_csv(path, comment="#").set_index("wind_mps")


def compare(folder: Path) -> list[Cell]:
    """Every cell of a complete campaign that is in print. Raises BadInputError."""
    manifest = read_complete(folder)
    counted = pd.read_csv(io.BytesIO(read_checked(folder, manifest, EXCURSIONS)))
    keys = ["condition", "radius_m", "distance"]
    poisson = counted.loc[
        counted["worst"] == 1, [*keys, "simultaneous_lower_per_h", "simultaneous_upper_per_h"]
    ]
    rows = pd.read_csv(io.BytesIO(read_checked(folder, manifest, STATEMENTS))).merge(
        poisson, on=keys
    )
    found = list(
        cells_of(
            rows[rows["distance"] == "horizontal"],
            manifest["campaign"]["metrics"]["acceptable_per_h"],
        )
    )
    if not found:
        raise BadInputError(
            f"{folder}: no wind (0 to 7 m/s), turbulence and radius (15 or 25 m) of Tables 3.1 and 3.2"
        )
    return found


def cells_of(rows: pd.DataFrame, acceptable: float) -> Iterator[Cell]:
    """Rows of statements, with Poisson limits of the worst corner, beside the print; what was not printed is left out."""
    tables = {radius: published(radius) for radius in PUBLISHED}
    for row in rows[rows["radius_m"].isin(PUBLISHED)].to_dict("records"):
        radius, wind, turbulence = row["radius_m"], row["wind_mps"], row["turbulence"]
        table = tables[radius]
        if wind not in table.index or f"{turbulence}_best" not in table.columns:
            continue
        ours = [
            Range(*(row[f"{end}{which}_per_h"] for which in ("", "_lower", "_upper")))
            for end in ("best", "worst")
        ]
        theirs = [float(table[f"{turbulence}_{end}"][wind]) for end in ("best", "worst")]
        answer = "yes" if theirs[1] <= acceptable else "no"
        yield Cell(
            radius,
            turbulence,
            wind,
            row["hours"],
            ours[0],
            ours[1],
            Range(ours[1].rate, row["simultaneous_lower_per_h"], row["simultaneous_upper_per_h"]),
            _counted(theirs[0]),
            _counted(theirs[1]),
            row["answer"],
            answer,
        )


def _counted(rate: float) -> Range:
    return Range(
        rate, *poisson_limits(round(rate * HOURS), HOURS, 1.0 - (1.0 - CONFIDENCE) / CORNERS)
    )


def table(cells: Sequence[Cell]) -> bytes:
    """beside-published.csv."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for c in cells:
        rates = [
            c.best.rate,
            c.best.lower,
            c.best.upper,
            c.worst.rate,
            c.worst.lower,
            c.worst.upper,
            c.worst_poisson.lower,
            c.worst_poisson.upper,
            c.published_best.rate,
            c.published_worst.rate,
            c.published_worst.lower,
            c.published_worst.upper,
        ]
        writer.writerow(
            [f"{c.radius_m:g}", c.turbulence, f"{c.wind_mps:g}", f"{c.hours:g}"]
            + ["" if math.isnan(rate) else f"{rate:.6g}" for rate in rates]
            + [*c.verdicts, c.answer, c.published_answer]
        )
    return buffer.getvalue().encode()


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; the process's exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m campaigns.excursions.reproduce",
        description="Excursions per hour beside the published tables",
    )
    parser.add_argument("results", type=Path, metavar="RESULTS")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(argv)
    try:
        cells = compare(args.results)
        args.out.mkdir(parents=True, exist_ok=True)
        write_bytes(args.out / "beside-published.csv", table(cells))
    except BadInputError as error:
        print(f"reproduce: error: {error}", file=sys.stderr)
        return 2
    bests, worsts, singly = zip(*(c.verdicts for c in cells), strict=True)
    counted = {word: worsts.count(word) for word in ("as published", "more", "fewer")}
    if args.json:
        print(
            json.dumps(
                {
                    "cells": len(cells),
                    "worst": counted,
                    "best": {w: bests.count(w) for w in counted},
                }
            )
        )
    else:
        for c in cells:
            print(c.words)
        print(f"worst corner: {', '.join(f'{n} cells {word}' for word, n in counted.items())}")
        if singly != worsts:
            print(
                f"if excursions do not cluster: {', '.join(f'{singly.count(w)} cells {w}' for w in counted)}"
            )
    return 0 if all(v == "as published" for v in (*worsts, *bests)) else 1


if __name__ == "__main__":
    sys.exit(main())
