"""Distribution functions of the errors within one flight of an hour, after Fig 3.6, whose own log is not public.

    python -m campaigns.loiter.one_flight --out DIR

JSBSim flies an hour in 3 m/s of wind: the nominal model in moderate and severe turbulence, and in severe turbulence the corners
with the smallest and the largest median cross-track error. Writes DIR/one-flight.csv (quantiles of |error|, true and as the
sensors saw it) and DIR/one-flight.svg (as the sensors saw it, beside the medians of the published flight).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from campaigns.excursions.full_size import plan
from campaigns.loiter.full_size import CELL, PUBLISHED_FLIGHT
from sysid.arrays import FloatArray
from uqharness.errors import BadInputError
from uqharness.files import write_bytes, write_text
from uqharness.flight import FlightResult, FlightSpec
from uqharness.flight.fly import fly
from uqharness.report.pbox import PROBABILITY
from uqharness.report.svg import Chart, Scale, scale, standalone
from uqharness.text_tables import csv_text

HOME = Path(__file__).parent
TABLE, PICTURE = "one-flight.csv", "one-flight.svg"
BEST, WORST = "011010", "100100"
"""Corners with the smallest and the largest median cross-track error at probability 0.5 (pboxes.csv)."""
SIGNALS = {"cross_track": "m", "altitude": "m", "speed": "m/s"}
PROBABILITIES = (0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
LINES = ("first", "second", "third", "limit")


def flights() -> dict[str, FlightSpec]:
    """What is flown, by its words: the first air of Tables 3.1 and 3.2 each time."""
    planned = plan()
    first = next(iter(planned.only([CELL])))
    corners = {case.epistemic_id: case.flight for case in planned.cases(first)[:64]}
    nominal = replace(corners[BEST], properties={})
    return {
        "nominal, moderate": replace(nominal, turbulence="moderate"),
        "nominal, severe": nominal,
        f"best corner {BEST}, severe": corners[BEST],
        f"worst corner {WORST}, severe": corners[WORST],
    }


def errors(result: FlightResult) -> dict[str, FloatArray]:
    """|error| (n,) of a flight, sorted, by signal, true and ``_measured``. Raises BadInputError for one that did not end well."""
    if result.status != "ok":
        raise BadInputError(
            f"a flight ended {result.status}: {result.reason}; no distribution of an hour's errors"
        )
    names = [f"{name}{suffix}" for name in SIGNALS for suffix in ("", "_measured")]
    return {name: np.sort(np.abs(result.signals[name])) for name in names}


def table(found: Mapping[str, Mapping[str, FloatArray]]) -> bytes:
    """one-flight.csv: a row per flight and signal."""
    rows = []
    for words, signals in found.items():
        for name, values in signals.items():
            quantiles = {
                f"q{100.0 * p:g}": f"{float(np.quantile(values, p)):.4g}" for p in PROBABILITIES
            }
            rows.append(
                {
                    "flight": words,
                    "error": name,
                    "unit": SIGNALS[name.removesuffix("_measured")],
                    **quantiles,
                }
            )
    return csv_text(rows).encode()


def drawing(found: Mapping[str, Mapping[str, FloatArray]]) -> str:
    """one-flight.svg: a chart per signal, a line per flight."""
    charts = []
    share = np.linspace(0.0, 1.0, 201)
    for name, unit in SIGNALS.items():
        curves = {
            words: np.quantile(signals[f"{name}_measured"], share)
            for words, signals in found.items()
        }
        words = name.replace("_", " ")
        mark = next(value for metric, value in PUBLISHED_FLIGHT.items() if metric.startswith(name))
        x = scale(
            f"|{words} error|, measured [{unit}]",
            [*curves.values(), np.array([0.0, mark])],
            minimum=0.0,
        )
        chart = Chart(
            f"one-{name}",
            f"Distribution functions of |{words} error| within an hour.",
            x,
            Scale(PROBABILITY, -0.01, 1.01),
        )
        for line, (flight, values) in zip(LINES, curves.items(), strict=True):
            chart.line(values, share, line, flight)
        chart.upright(mark, "mark", "median, published flight")
        charts.append((chart.svg(), ""))
    return standalone(charts, "Errors within one flight of an hour, 3 m/s of wind", columns=3)


def run(out: Path, fly_one: Callable[[FlightSpec], FlightResult] = fly) -> list[str]:
    """Fly, write, and say the medians."""
    found = {words: errors(fly_one(spec)) for words, spec in flights().items()}
    out.mkdir(parents=True, exist_ok=True)
    write_bytes(out / TABLE, table(found))
    write_text(out / PICTURE, drawing(found))
    return [
        f"{words}: "
        + ", ".join(
            f"{name} {float(np.median(signals[name])):.3g} {SIGNALS[name]}" for name in SIGNALS
        )
        for words, signals in found.items()
    ]


def main(argv: Sequence[str] | None = None) -> int:
    """Run it; exit code 0, or 2 for bad input."""
    parser = argparse.ArgumentParser(
        prog="python -m campaigns.loiter.one_flight",
        description="Errors within one flight (Fig 3.6)",
    )
    parser.add_argument("--out", type=Path, default=HOME, metavar="DIR")
    args = parser.parse_args(argv)
    try:
        print("\n".join(run(args.out)))
    except BadInputError as error:
        print(f"one_flight: error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
