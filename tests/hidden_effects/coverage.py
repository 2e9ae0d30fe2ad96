"""What the intervals of `identify` and `refine` cover, and whether they and `compare` say the same
of the same flights.

python -m tests.hidden_effects.coverage --draws 40 --out FOLDER [--light] [--identify-only]
[--rate-hz 100]

A draw is four flights of the nominal form, of the independent equations, every coefficient drawn
anew, commands held between rows; in every second one the servos act at once. They fly in calm air,
or with --light in turbulence of 6 to 20 kt at 20 ft. Three flights are for the estimates, the
fourth is compared with. coverage.csv: a row a draw and parameter; a stopped run goes on. Exit code
0: intervals of both cover 93 to 97 % (in turbulence 90 to 98 %), estimates and tables agree."""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.helpers.sixdof import Airframe
from tests.hidden_effects.airframes import write_aircraft
from tests.hidden_effects.cases import cards, perturbed
from tests.hidden_effects.flights import Flight, fly
from tests.hidden_effects.motion import IDEAL
from tests.hidden_effects.second.folders import state
from tests.hidden_effects.second.wrongs import IDEAL_SERVOS
from uqharness.cli.main import main as uqharness
from uqharness.identification.identify import identify
from uqharness.replay import read_flights
from uqharness.simulator.aircraft import find_aircraft

WIDTH = 1.96
LEAST, MOST = 0.93, 0.97
LIGHT = 0.90, 0.98
"""What intervals are to cover in turbulence."""
SAME_ESTIMATE = 0.1
"""Largest difference of two estimates of one parameter, in standard errors."""
SAME_TABLE = 0.02
"""Largest relative difference of rms over noise between refine's table and `compare` of the model
it wrote.
"""
COLUMNS = ("draw", "parameter", "identify", "refine", "apart")
Row = Mapping[str, Any]


def draw(
    number: int, folder: Path, rate_hz: float = 50.0, light: bool = False
) -> tuple[Airframe, Path, list[Path]]:
    """The truth of a draw, its aircraft folder, and records of its flights: three to train on, one
    to test on.
    """
    airframe = perturbed(Airframe(), np.random.default_rng([24, number]))
    folder = folder / f"draw-{number}"
    folder.mkdir(parents=True, exist_ok=True)
    aircraft = write_aircraft("espaaro", Airframe(), folder)
    at_once = number % 2 == 0
    if at_once:
        state(aircraft, IDEAL_SERVOS)
    paths = []
    w20_kt = float(np.random.default_rng([25, number]).uniform(6.0, 20.0)) if light else 0.0
    given = cards(f"coverage {number}", w20_kt=w20_kt, rate_hz=rate_hz)
    for k, record in enumerate(
        fly([Flight(c, airframe, (), IDEAL if at_once else None) for c in given])
    ):
        paths.append(folder / f"flight-{k + 1}.parquet")
        record.write(paths[-1])
    return airframe, aircraft, paths


def identified(
    aircraft: Path, paths: Sequence[Path], light: bool = False
) -> dict[str, tuple[float, float]]:
    """Parameter -> value and standard error by `identify`: output error in calm air, else what it
    chooses by itself.
    """
    model = find_aircraft(str(aircraft))
    flights, measured = read_flights(paths, model)
    found = identify(
        model, flights, measured, method="auto" if light else "output-error", workers=1
    )
    return {
        n: (float(v), float(s)) for n, v, s in zip(found.names, found.theta, found.std, strict=True)
    }


def refined(
    aircraft: Path, train: Sequence[Path], test: Path, out: Path
) -> tuple[dict[str, tuple[float, float]], float]:
    """Parameter -> value and standard error by `refine`; largest relative difference of its table
    from `compare`'s.

    NaN for every parameter and an infinite difference where refine names something, or fails.
    """
    given = [
        "refine",
        str(aircraft),
        "--train",
        *map(str, train),
        "--test",
        str(test),
        "--out",
        str(out),
    ]
    code = uqharness([*given, "--no-pbox", "--no-figures", "--workers", "1"])
    found = (
        json.loads((out / "refinement.json").read_text(encoding="utf-8")) if code in (0, 1) else {}
    )
    if found.get("verdict") != "no-missing-effect":
        return {}, math.inf
    uqharness(
        [
            "compare",
            str(out / "aircraft" / "espaaro"),
            "--flight",
            str(test),
            "--out",
            str(out / "compare"),
            "--no-figures",
        ]
    )
    other = json.loads((out / "compare" / "compare.json").read_text(encoding="utf-8"))["channels"]
    own = found["gap"]["test"]["channels"]
    apart = max(
        abs(own[c]["rms_after"] / own[c]["noise_rms"] / row["ratio"] - 1.0)
        for c, row in other.items()
        if row["judged"]
    )
    return {n: (p["value"], p["std"]) for n, p in found["parameters"].items()}, apart


def rows_of(
    number: int,
    truth: Mapping[str, float],
    one: Mapping[str, tuple[float, float]],
    two: Mapping[str, tuple[float, float]],
    apart: float,
) -> list[dict[str, Any]]:
    """A row a parameter: (estimate - truth) / std by identify and by refine, and how far apart
    their tables are.
    """
    nowhere = (math.nan, math.nan)
    out = []
    for name, (value, std) in one.items():
        own = truth[name.removeprefix("aero/")]
        other, its_std = two.get(name, nowhere)
        row = {
            "draw": number,
            "parameter": name,
            "identify": (value - own) / std,
            "refine": (other - own) / its_std,
        }
        out.append(row | {"apart": apart})
    return out


def marks(rows: Sequence[Row], both: bool = True, light: bool = False) -> tuple[bool, str]:
    """Whether intervals cover and the commands agree, and that in words. both: refine was asked as
    well.
    """
    lines = []
    least, most = LIGHT if light else (LEAST, MOST)
    for name in ("identify", "refine") if both else ("identify",):
        z = np.array([float(r[name]) for r in rows])
        held = float(np.mean(np.abs(z) < WIDTH)) if len(z) else math.nan
        rms = float(np.sqrt(np.nanmean(z**2))) if np.isfinite(z).any() else math.nan
        lines.append(
            (
                least <= held <= most,
                f"{name}: {held:.1%} of {len(z)} within {WIDTH} standard errors, rms z {rms:.2f}",
            )
        )
    if both:
        apart = [abs(float(r["identify"]) - float(r["refine"])) for r in rows]
        same = sum(a <= SAME_ESTIMATE for a in apart)
        lines.append(
            (
                same == len(rows),
                (
                    f"estimates within {SAME_ESTIMATE} standard errors of each other: {same} of"
                    f" {len(rows)}"
                ),
            )
        )
        tables = {int(r["draw"]): float(r["apart"]) for r in rows}
        same = sum(a <= SAME_TABLE for a in tables.values())
        lines.append(
            (
                same == len(tables),
                (
                    f"refine's table within {SAME_TABLE:.0%} of compare's: {same} of {len(tables)}"
                    " draws"
                ),
            )
        )
    text = "\n".join(f"{'reached' if ok else 'MISSED '}  {words}" for ok, words in lines)
    return bool(rows) and all(ok for ok, _ in lines), text


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=40)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument(
        "--rate-hz", type=float, default=50.0, help="rows a second of the records (default 50)"
    )
    parser.add_argument("--light", action="store_true", help="flights in turbulence")
    parser.add_argument("--identify-only", action="store_true", help="leave refine and compare out")
    given = parser.parse_args(argv)
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "coverage.csv"
    rows: list[Row] = []
    if path.is_file():
        with path.open(encoding="utf-8", newline="") as handle:
            rows = list(csv.DictReader(handle))
    done = {int(r["draw"]) for r in rows}
    for number in (n for n in range(given.first, given.first + given.draws) if n not in done):
        airframe, aircraft, paths = draw(number, given.out, given.rate_hz, given.light)
        one = identified(aircraft, paths[:3], given.light)
        two, apart = (
            ({}, math.inf)
            if given.identify_only
            else refined(aircraft, paths[:3], paths[3], given.out / f"draw-{number}" / "refined")
        )
        new = rows_of(number, airframe.coefficients, one, two, apart)
        begun = path.is_file()
        with path.open("a", encoding="utf-8", newline="") as handle:
            out = csv.DictWriter(handle, COLUMNS, lineterminator="\n")
            if not begun:
                out.writeheader()
            out.writerows(
                {k: f"{v:.5g}" if isinstance(v, float) else v for k, v in r.items()} for r in new
            )
        rows += new
        print(
            f"draw {number}: so far\n{marks(rows, not given.identify_only, given.light)[1]}",
            file=sys.stderr,
            flush=True,
        )
    reached, text = marks(rows, not given.identify_only, given.light)
    print(text)
    return 0 if reached else 1


if __name__ == "__main__":
    sys.exit(main())
