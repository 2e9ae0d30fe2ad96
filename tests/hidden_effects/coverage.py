"""What the intervals of `identify` cover: draws of three calm flights of the nominal form, every coefficient drawn anew.

python -m tests.hidden_effects.coverage --draws 40 --out FOLDER       coverage.csv: one row a draw and parameter

The flights are of the independent equations, commands held between rows.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np

from tests.helpers.sixdof import Airframe
from tests.hidden_effects.cases import cards, perturbed
from tests.hidden_effects.flights import Flight, fly
from uqharness.identification.identify import identify
from uqharness.replay import read_flights
from uqharness.simulator.aircraft import find_aircraft

WIDTH = 1.96


def draw(number: int, folder: Path) -> tuple[Airframe, list[Path]]:
    """The truth of a draw, and records of its flights."""
    airframe = perturbed(Airframe(), np.random.default_rng([24, number]))
    folder = folder / f"draw-{number}"
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for k, record in enumerate(fly([Flight(c, airframe) for c in cards(f"coverage {number}")[:3]])):
        paths.append(folder / f"flight-{k + 1}.parquet")
        record.write(paths[-1])
    return airframe, paths


def errors(number: int, folder: Path) -> dict[str, float]:
    """Parameter -> error of its estimate in its standard errors; NaN where it is not identified."""
    airframe, paths = draw(number, folder)
    aircraft = find_aircraft("espaaro")
    flights, measured = read_flights(paths, aircraft)
    found = identify(aircraft, flights, measured, method="output-error")
    truth = np.array([airframe.coefficients[n.removeprefix("aero/")] for n in found.names])
    return dict(zip(found.names, ((found.theta - truth) / found.std).tolist(), strict=True))


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=40)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args(argv)
    given.out.mkdir(parents=True, exist_ok=True)
    z: list[float] = []
    with (given.out / "coverage.csv").open("w", encoding="utf-8", newline="") as handle:
        out = csv.writer(handle, lineterminator="\n")
        out.writerow(["draw", "parameter", "error_over_std"])
        for number in range(given.first, given.first + given.draws):
            found = errors(number, given.out)
            z += found.values()
            out.writerows([number, name, f"{value:.4g}"] for name, value in found.items())
            covered, rms = np.mean(np.abs(z) < WIDTH), np.sqrt(np.nanmean(np.square(z)))
            print(f"draw {number}: so far {covered:.1%} within {WIDTH} standard errors, rms {rms:.2f}", flush=True)


if __name__ == "__main__":
    main()
