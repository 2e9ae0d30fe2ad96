"""Distribution functions of the errors within one flight of an hour, after Fig 3.6, whose own log
is not public.

    python -m campaigns.loiter.one_flight --out DIR

JSBSim flies an hour in 3 m/s of wind: the nominal model in moderate and severe turbulence, and in
severe turbulence the corners with the smallest and the largest median cross-track error. Writes
DIR/one-flight.csv (quantiles of |error|, true and as the sensors saw it) and DIR/one-flight.svg (as
the sensors saw it, beside the medians of the published flight).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from campaigns.excursions.reproduce import HOME as EXCURSIONS
from campaigns.library.flights import cases_of
from campaigns.library.study import exit_code, study_parser, write_csv
from campaigns.loiter.reproduce import CELL, PUBLISHED_FLIGHT
from sysid.arrays import FloatArray
from uqharness.errors import BadInputError
from uqharness.files import write_text
from uqharness.flight import FlightResult, FlightSpec
from uqharness.flight.fly import fly
from uqharness.report.pbox import PROBABILITY
from uqharness.report.svg import Chart, Scale, scale, standalone

HOME = Path(__file__).parent
BEST, WORST = "011010", "100100"
"""Corners with the smallest and the largest median cross-track error at probability 0.5
(pboxes.csv)."""
SIGNALS = {"cross_track": "m", "altitude": "m", "speed": "m/s"}
PROBABILITIES = (0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
LINES = ("first", "second", "third", "limit")
Errors = Mapping[str, Mapping[str, FloatArray]]
"""Sorted |error| by flight and signal."""


def flights() -> dict[str, FlightSpec]:
    """Return the flights by description, each in the first air of Tables 3.1 and 3.2."""
    cases = cases_of(EXCURSIONS / "campaign.toml", CELL, range(1))
    corners = {case.epistemic_id: case.flight for case in cases}
    nominal = replace(corners[BEST], properties={})
    return {
        "nominal, moderate": replace(nominal, turbulence="moderate"),
        "nominal, severe": nominal,
        f"best corner {BEST}, severe": corners[BEST],
        f"worst corner {WORST}, severe": corners[WORST],
    }


def errors(result: FlightResult) -> dict[str, FloatArray]:
    """Return the sorted |error| (n,) by signal, true and ``_measured``. Raises BadInputError for a
    flight that did not end well."""
    if result.status != "ok":
        raise BadInputError(
            f"a flight ended {result.status}: {result.reason}; no distribution of an hour's errors"
        )
    names = [f"{name}{suffix}" for name in SIGNALS for suffix in ("", "_measured")]
    return {name: np.sort(np.abs(result.signals[name])) for name in names}


def rows(by_flight: Errors) -> list[dict[str, str]]:
    """Return the rows of one-flight.csv: one per flight and signal."""
    table = []
    for flight, signals in by_flight.items():
        for name, values in signals.items():
            row = {"flight": flight, "error": name, "unit": SIGNALS[name.removesuffix("_measured")]}
            quantiles = {p: float(np.quantile(values, p)) for p in PROBABILITIES}
            table.append(row | {f"q{100.0 * p:g}": f"{q:.4g}" for p, q in quantiles.items()})
    return table


def drawing(by_flight: Errors) -> str:
    """Draw one-flight.svg: a chart per signal, a line per flight."""
    charts = []
    share = np.linspace(0.0, 1.0, 201)
    for name, unit in SIGNALS.items():
        curves = {f: np.quantile(s[f"{name}_measured"], share) for f, s in by_flight.items()}
        words = name.replace("_", " ")
        mark = next(value for metric, value in PUBLISHED_FLIGHT.items() if metric.startswith(name))
        values = [*curves.values(), np.array([0.0, mark])]
        x = scale(f"|{words} error|, measured [{unit}]", values, minimum=0.0)
        title = f"Distribution functions of |{words} error| within an hour."
        chart = Chart(f"one-{name}", title, x, Scale(PROBABILITY, -0.01, 1.01))
        for line, (flight, curve) in zip(LINES, curves.items(), strict=True):
            chart.line(curve, share, line, flight)
        chart.upright(mark, "mark", "median, published flight")
        charts.append((chart.svg(), ""))
    return standalone(charts, "Errors within one flight of an hour, 3 m/s of wind", columns=3)


def run(out: Path, fly_one: Callable[[FlightSpec], FlightResult] = fly) -> list[str]:
    """Fly, write the table and the chart, and return the medians for the terminal."""
    by_flight = {words: errors(fly_one(spec)) for words, spec in flights().items()}
    write_csv(out / "one-flight.csv", rows(by_flight))
    write_text(out / "one-flight.svg", drawing(by_flight))
    medians = {
        flight: ", ".join(f"{n} {float(np.median(s[n])):.3g} {u}" for n, u in SIGNALS.items())
        for flight, s in by_flight.items()
    }
    return [f"{flight}: {words}" for flight, words in medians.items()]


def main(argv: Sequence[str] | None = None) -> int:
    """Run it; exit code 0, or 2 for bad input."""
    args = study_parser(__doc__, out=HOME).parse_args(argv)
    return exit_code(lambda: print("\n".join(run(args.out))) or 0)


if __name__ == "__main__":
    sys.exit(main())
