"""Measure the turbulence that reaches the aerodynamics, against MIL-F-8785C.

A vehicle without aerodynamics is held on a fixed heading and airspeed by a stiff feedback, in the air of
``aircraft/espaaro/Systems/air.xml``, and what its aerodynamics would see is recorded: total wind less steady wind, and
the rotation of the air, both in heading axes. Each source flies several headings to the wind; plain JSBSim, without
that system, flies beside them.

    python -m campaigns.air.reproduce --out results/air
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy import stats
from scipy.signal import welch

from campaigns.air.pinned import Condition, Seen, Source, measure
from sysid.arrays import FloatArray
from uqharness.errors import BadInputError
from uqharness.flight.dryden import COMPONENTS, Component, dryden_psd, dryden_sigma

BANDS_HZ = ((0.02, 0.1), (0.1, 0.3), (0.3, 1.0), (1.0, 3.0), (3.0, 10.0))


@dataclass(frozen=True)
class Row:
    """One component of one flight against the specification. Ratios are measured over specified."""

    source: str
    heading_deg: float
    component: str
    sd_spec: float
    sd_measured: float
    sd_ratio: float
    sd_ratio_error: float
    """One standard deviation of sd_ratio by counting, 1/sqrt(2 dof), if the spectrum is as specified."""
    band_ratios: tuple[float, ...]
    band_errors: tuple[float, ...]
    """One standard deviation of each band's mean density ratio."""

    def within(self, tolerance: float, confidence: float = 0.9999) -> bool:
        """Whether all ratios are 1, to ``tolerance`` (of amplitude; twice that of density) on top of counting statistics."""
        sigmas = float(stats.norm.isf((1.0 - confidence) / 2.0))
        good = abs(self.sd_ratio - 1.0) <= tolerance + sigmas * self.sd_ratio_error
        return good and all(
            abs(ratio - 1.0) <= 2.0 * tolerance + sigmas * error
            for ratio, error in zip(self.band_ratios, self.band_errors, strict=True)
        )


def spectrum(series: FloatArray, dt_s: float) -> tuple[FloatArray, FloatArray]:
    """Welch estimate, one-sided: frequency in Hz and density per Hz (16384 samples a segment, Hann, half overlap)."""
    frequency, density = welch(
        series, fs=1.0 / dt_s, nperseg=min(16384, len(series)), detrend=False
    )
    return frequency[1:], density[1:]


def specified_density(
    component: Component, frequency_hz: FloatArray, condition: Condition
) -> FloatArray:
    """The specification's density per Hz."""
    args = (condition.V_mps, condition.h_m, condition.W20_kt, condition.b_m)
    return 2.0 * np.pi * dryden_psd(component, 2.0 * np.pi * frequency_hz, *args)


def compare(seen: Seen) -> list[Row]:
    """Standard deviation and band means of all six components, with their counting errors."""
    condition = seen.condition
    rows = []
    for component in COMPONENTS:
        series = seen.series[component]
        sigma = dryden_sigma(
            component, condition.V_mps, condition.h_m, condition.W20_kt, condition.b_m
        )
        measured = float(np.sqrt(np.mean(series**2)))
        record_s = len(series) * condition.dt_s
        frequency, density = spectrum(series, condition.dt_s)
        ratio = density / specified_density(component, frequency, condition)
        inside = [(frequency >= low) & (frequency < high) for low, high in BANDS_HZ]
        rows.append(
            Row(
                source=seen.source,
                heading_deg=condition.heading_deg,
                component=component,
                sd_spec=sigma,
                sd_measured=measured,
                sd_ratio=measured / sigma,
                sd_ratio_error=1.0 / np.sqrt(2.0 * variance_dof(component, condition, record_s)),
                band_ratios=tuple(float(np.mean(ratio[band])) for band in inside),
                # A band of width B in a record of length T has 2 B T degrees of freedom; 0.95 survive the window.
                band_errors=tuple(
                    float(np.sqrt(1.0 / (0.95 * (high - low) * record_s))) for low, high in BANDS_HZ
                ),
            )
        )
    return rows


def variance_dof(component: Component, condition: Condition, record_s: float) -> float:
    """Degrees of freedom of a variance: 2 T (integral of S)^2 / integral of S^2, S the specified density per Hz."""
    frequency = np.geomspace(1e-5, 50.0, 4000)
    density = specified_density(component, frequency, condition)
    return float(
        2.0 * record_s * np.trapezoid(density, frequency) ** 2 / np.trapezoid(density**2, frequency)
    )


def markdown(
    rows: Sequence[Row], correlations: Mapping[tuple[str, float], tuple[float, float]]
) -> str:
    """Two tables: standard deviations (ratio to the specification) and band means of the spectra."""
    lines = [
        "| source | heading to wind, deg | "
        + " | ".join(COMPONENTS)
        + " | corr(q, dw) | corr(r, dv) |",
        "|---" * 10 + "|",
    ]
    keys = list(dict.fromkeys((row.source, row.heading_deg) for row in rows))
    found = {(row.source, row.heading_deg, row.component): row for row in rows}
    for source, heading in keys:
        cells = " | ".join(f"{found[source, heading, name].sd_ratio:.3f}" for name in COMPONENTS)
        q_corr, r_corr = correlations[source, heading]
        lines.append(f"| {source} | {heading:.0f} | {cells} | {q_corr:+.2f} | {r_corr:+.2f} |")
    error = " | ".join(
        f"{max(row.sd_ratio_error for row in rows if row.component == c):.3f}" for c in COMPONENTS
    )
    lines += [f"| counting error (1 sd) | | {error} | | |", ""]
    labels = [f"{low:g}-{high:g} Hz" for low, high in BANDS_HZ]
    lines += [
        "| source | component | " + " | ".join(labels) + " |",
        "|---" * (2 + len(labels)) + "|",
    ]
    for source in dict.fromkeys(row.source for row in rows):
        for name in COMPONENTS:
            bands = np.array(
                [row.band_ratios for row in rows if row.source == source and row.component == name]
            )
            cells = " | ".join(
                f"{low:.2f}..{high:.2f}"
                for low, high in zip(bands.min(0), bands.max(0), strict=True)
            )
            lines.append(f"| {source} | {name} | {cells} |")
    errors = " | ".join(f"{error:.2f}" for error in rows[0].band_errors)
    lines += [f"| counting error (1 sd) | | {errors} |", ""]
    return "\n".join(lines)


def write_csv(rows: Sequence[Row], path: Path) -> None:
    """One line a component and flight."""
    bands = [f"psd_ratio_{low:g}_{high:g}_hz" for low, high in BANDS_HZ]
    with path.open("w", newline="", encoding="utf-8") as handle:
        writer = csv.writer(handle)
        writer.writerow(
            [
                "source",
                "heading_deg",
                "component",
                "sd_spec",
                "sd_measured",
                "sd_ratio",
                "sd_ratio_error",
                *bands,
            ]
        )
        for row in rows:
            values = (
                row.sd_spec,
                row.sd_measured,
                row.sd_ratio,
                row.sd_ratio_error,
                *row.band_ratios,
            )
            writer.writerow(
                [row.source, row.heading_deg, row.component, *(f"{value:.5g}" for value in values)]
            )


def main(argv: Sequence[str] | None = None) -> int:
    """Exit code 0: both sources are as specified; 1: one is not; 2: bad input."""
    parser = argparse.ArgumentParser(
        prog="python -m campaigns.air.reproduce", description=__doc__.split("\n")[0]
    )
    parser.add_argument(
        "--out", type=Path, required=True, help="folder for air.csv, air.md and air.svg"
    )
    parser.add_argument(
        "--hours", type=float, default=1.0, help="flight time per source and heading (default 1)"
    )
    parser.add_argument("--headings-deg", type=float, nargs="+", default=[0.0, 90.0, 180.0, 270.0])
    parser.add_argument(
        "--w20-kt", type=float, default=30.0, help="wind at 20 ft (default 30, moderate)"
    )
    parser.add_argument("--height-m", type=float, default=100.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    args = parser.parse_args(argv)
    try:
        rows, flights = run_all(
            args.headings_deg, args.hours, args.w20_kt, args.height_m, args.seed
        )
        args.out.mkdir(parents=True, exist_ok=True)
    except (BadInputError, OSError) as error:
        print(f"campaigns.air.reproduce: {error}", file=sys.stderr)
        return 2
    correlations: dict[tuple[str, float], tuple[float, float]] = {
        (seen.source, seen.condition.heading_deg): (
            seen.q_slope_correlation(),
            seen.r_slope_correlation(),
        )
        for seen in flights
    }
    table = markdown(rows, correlations)
    write_csv(rows, args.out / "air.csv")
    (args.out / "air.md").write_text(table, encoding="utf-8")
    from campaigns.air.plot import plot_air

    plot_air(flights, args.out / "air.svg")
    good = all(row.within(0.03) for row in rows if row.source in ("jsbsim", "host"))
    if args.json:
        print(json.dumps({"as_specified": good, "rows": [asdict(row) for row in rows]}))
    else:
        print(table)
        print(
            "both sources are as specified"
            if good
            else "NOT as specified (3 % of amplitude beyond counting errors)"
        )
    return 0 if good else 1


def run_all(
    headings_deg: Sequence[float], hours: float, W20_kt: float, h_m: float, seed: int
) -> tuple[list[Row], list[Seen]]:
    """All four airs at all headings; progress on a terminal."""
    if not hours > 0.0:
        raise BadInputError(f"--hours {hours}: must be positive")
    rows: list[Row] = []
    flights: list[Seen] = []
    sources: tuple[Source, ...] = ("jsbsim", "host", "plain-tustin", "plain-milspec")
    for source in sources:
        for index, heading in enumerate(headings_deg):
            if sys.stderr.isatty():
                print(f"{source}, {heading:.0f} deg to the wind", file=sys.stderr)
            condition = Condition(
                heading_deg=heading,
                W20_kt=W20_kt,
                h_m=h_m,
                duration_s=3600.0 * hours,
                seed=seed + index,
            )
            flights.append(measure(source, condition))
            rows += compare(flights[-1])
    return rows, flights


if __name__ == "__main__":
    sys.exit(main())
