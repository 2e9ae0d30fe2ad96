"""Measure the turbulence that reaches the aerodynamics, against MIL-F-8785C.

A vehicle without aerodynamics is held on a fixed heading and airspeed by a stiff feedback, in the
air of ``aircraft/espaaro/Systems/air.xml``, and what its aerodynamics would see is recorded: total
wind less steady wind, and the rotation of the air, both in heading axes. Each source flies several
headings to the wind; plain JSBSim, without that system, flies beside them.

    python -m campaigns.air.reproduce --out results/air
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from scipy import stats
from scipy.signal import welch

from campaigns.air.pinned import Condition, Gusts, Source, measure
from campaigns.library.study import cells, exit_code, log_progress, study_parser, write_csv
from sysid.arrays import FloatArray
from uqharness.errors import BadInputError
from uqharness.flight.dryden import COMPONENTS, Component, dryden_psd, dryden_sigma
from uqharness.text_tables import text_table

BANDS_HZ = ((0.02, 0.1), (0.1, 0.3), (0.3, 1.0), (1.0, 3.0), (3.0, 10.0))
SOURCES: tuple[Source, ...] = ("jsbsim", "host", "plain-tustin", "plain-milspec")
_COLUMNS = (
    "source heading_deg component sd_spec:.5g sd_measured:.5g sd_ratio:.5g sd_ratio_error:.5g"
)
_COLOURS = {"jsbsim": "#1b6ca8", "host": "#d1701e", "plain-tustin": "#b0b0b0"}
_LABELS = {
    "jsbsim": "source 0 (JSBSim, corrected)",
    "host": "source 1 (host)",
    "plain-tustin": "plain JSBSim, Tustin",
}


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
    """One standard deviation of sd_ratio by counting, 1/sqrt(2 dof), if the spectrum is as
    specified."""
    band_ratios: tuple[float, ...]
    band_errors: tuple[float, ...]
    """One standard deviation of each band's mean density ratio."""

    def within(self, tolerance: float, confidence: float = 0.9999) -> bool:
        """Return whether all ratios are 1, to ``tolerance`` (of amplitude; twice that of density)
        on top of counting statistics."""
        sigmas = float(stats.norm.isf((1.0 - confidence) / 2.0))
        valid = abs(self.sd_ratio - 1.0) <= tolerance + sigmas * self.sd_ratio_error
        return valid and all(
            abs(ratio - 1.0) <= 2.0 * tolerance + sigmas * error
            for ratio, error in zip(self.band_ratios, self.band_errors, strict=True)
        )


def spectrum(series: FloatArray, dt_s: float) -> tuple[FloatArray, FloatArray]:
    """Estimate a one-sided spectrum by Welch: frequency in Hz, density per Hz (16384 samples a
    segment, Hann, half overlap)."""
    n = min(16384, len(series))
    frequency, density = welch(series, fs=1.0 / dt_s, nperseg=n, detrend=False)
    return frequency[1:], density[1:]


def specified_density(
    component: Component, frequency_hz: FloatArray, condition: Condition
) -> FloatArray:
    """Return the specification's density per Hz."""
    args = (condition.V_mps, condition.h_m, condition.W20_kt, condition.b_m)
    return 2.0 * np.pi * dryden_psd(component, 2.0 * np.pi * frequency_hz, *args)


def compare(gusts: Gusts) -> list[Row]:
    """Compare standard deviation and band means of all six components, with their counting
    errors."""
    c, rows = gusts.condition, []
    for component in COMPONENTS:
        series = gusts.series[component]
        sigma = dryden_sigma(component, c.V_mps, c.h_m, c.W20_kt, c.b_m)
        measured = float(np.sqrt(np.mean(series**2)))
        record_s = len(series) * c.dt_s
        frequency, density = spectrum(series, c.dt_s)
        ratio = density / specified_density(component, frequency, c)
        bands = [(frequency >= low) & (frequency < high) for low, high in BANDS_HZ]
        # A band of width B in a record of length T has 2 B T degrees of freedom, 0.95 of them
        # behind the window.
        errors = [float(np.sqrt(1.0 / (0.95 * (high - low) * record_s))) for low, high in BANDS_HZ]
        rows.append(
            Row(
                source=gusts.source,
                heading_deg=c.heading_deg,
                component=component,
                sd_spec=sigma,
                sd_measured=measured,
                sd_ratio=measured / sigma,
                sd_ratio_error=1.0 / np.sqrt(2.0 * variance_dof(component, c, record_s)),
                band_ratios=tuple(float(np.mean(ratio[band])) for band in bands),
                band_errors=tuple(errors),
            )
        )
    return rows


def variance_dof(component: Component, condition: Condition, record_s: float) -> float:
    """Return the degrees of freedom of a variance: 2 T (integral of S)^2 / integral of S^2, S the
    specified density per Hz."""
    frequency = np.geomspace(1e-5, 50.0, 4000)
    density = specified_density(component, frequency, condition)
    power = np.trapezoid(density, frequency) ** 2
    return float(2.0 * record_s * power / np.trapezoid(density**2, frequency))


def table_row(row: Row) -> dict[str, str]:
    """Return the row of air.csv."""
    bands = [f"psd_ratio_{low:g}_{high:g}_hz" for low, high in BANDS_HZ]
    ratios = (f"{ratio:.5g}" for ratio in row.band_ratios)
    return cells(row, _COLUMNS) | dict(zip(bands, ratios, strict=True))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; exit code 0: both sources are as specified; 1: one is not; 2: bad input."""
    parser = study_parser(__doc__, out="air.csv and air.svg")
    option = parser.add_argument
    option("--hours", type=float, default=1.0, help="flight time per source and heading (1)")
    option("--headings-deg", type=float, nargs="+", default=[0.0, 90.0, 180.0, 270.0])
    option("--w20-kt", type=float, default=30.0, help="wind at 20 ft (30, moderate)")
    option("--height-m", type=float, default=100.0)
    option("--seed", type=int, default=1)
    args = parser.parse_args(argv)
    return exit_code(lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    if not args.hours > 0.0:
        raise BadInputError(f"--hours {args.hours}: must be positive")
    air = {"W20_kt": args.w20_kt, "h_m": args.height_m, "duration_s": 3600.0 * args.hours}
    flights = []
    for source in SOURCES:
        for index, heading in enumerate(args.headings_deg):
            log_progress(f"{source}, {heading:.0f} deg to the wind")
            gusts = measure(source, Condition(heading, seed=args.seed + index, **air))
            flights.append(gusts)
            slopes = f"corr(q, dw) {gusts.q_slope_correlation():+.2f}"
            print(f"{source}, {heading:.0f}: {slopes}, {gusts.r_slope_correlation():+.2f} (r, dv)")
    rows = [row for gusts in flights for row in compare(gusts)]
    table = [table_row(row) for row in rows]
    write_csv(args.out / "air.csv", table)
    plot_air(flights, args.out / "air.svg")
    print("\n".join(text_table(table)))
    valid = all(row.within(0.03) for row in rows if row.source in ("jsbsim", "host"))
    invalid = "NOT as specified (3 % of amplitude beyond counting errors)"
    print("both sources are as specified" if valid else invalid)
    return 0 if valid else 1


def plot_air(flights: Sequence[Gusts], path: Path) -> None:
    """Draw six panels of density per Hz times frequency over its maximum as specified; one line a
    heading."""
    matplotlib.rcParams["svg.hashsalt"] = "uqharness"
    figure = Figure(figsize=(11, 6.5), layout="constrained")
    for axes, name in zip(figure.subplots(2, 3, sharex=True).flat, COMPONENTS, strict=True):
        for source in ("plain-tustin", "jsbsim", "host"):
            label = _LABELS[source]
            for gusts in (flight for flight in flights if flight.source == source):
                frequency, density = _smoothed(*spectrum(gusts.series[name], gusts.condition.dt_s))
                axes.loglog(frequency, density, color=_COLOURS[source], linewidth=0.8, label=label)
                label = "_nolegend_"
        frequency = np.geomspace(0.01, 30.0, 300)
        axes.loglog(
            frequency,
            specified_density(name, frequency, flights[0].condition),
            "k--",
            label="MIL-F-8785C",
        )
        axes.set_title(f"{name}, " + ("(m/s)²/Hz" if name in "uvw" else "(rad/s)²/Hz"))
        axes.grid(True, which="major", alpha=0.3)
        axes.set_xlim(0.01, 30.0)
        if name in "pqr":
            axes.set_xlabel("frequency, Hz")
        if name == "u":
            axes.legend(fontsize=8)
    figure.savefig(path, metadata={"Date": None, "Creator": None})


def _smoothed(frequency: np.ndarray, density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    # Means over logarithmic bins, 12 to a decade.
    edges = np.geomspace(0.01, 30.0, 43)
    bins = np.digitize(frequency, edges)
    filled = [index for index in range(1, len(edges)) if np.any(bins == index)]
    means = [[np.mean(each[bins == index]) for index in filled] for each in (frequency, density)]
    return np.array(means[0]), np.array(means[1])


if __name__ == "__main__":
    sys.exit(main())
