"""Draw one repeated flight: track, errors with limits, state, controls and levels."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from sysid.units import RAD_DEG
from uqharness.campaign import RerunResult
from uqharness.files import write_text
from uqharness.flight import COEFFICIENTS, FlightSpec
from uqharness.report.ground_track import equal_scales
from uqharness.report.parts import Figure
from uqharness.report.svg import Chart, Scale, scale, standalone

_KINDS = ("first", "second", "third", "plain thin", "limit2", "mark")
_ANGLES = ("phi_rad", "theta_rad", "alpha_rad", "beta_rad")
_SURFACES = ("elevator", "aileron", "rudder")


def draw_rerun(rerun: RerunResult) -> list[Path]:
    """Draw a repeated case next to its record.

    Parameters
    ----------
    rerun : RerunResult
        Repeated case.

    Returns
    -------
    list of Path
        flight.svg; empty if the flight left no record.
    """
    # The repeated flight left a Parquet record if it flew.
    record = next((path for path in rerun.files if path.suffix == ".parquet"), None)
    if record is None:
        return []
    case = rerun.case
    where = f"flight {case.aleatory_id}, {case.wind_mps:g} m/s {case.turbulence}"
    title = f"case {case.case_id}: {case.epistemic_id}, {where}; {rerun.outcome.status}"
    path = rerun.folder / "flight.svg"
    charts = [
        (figure.svg, figure.caption)
        for figure in flight_figures(pd.read_parquet(record), case.flight)
    ]
    write_text(path, standalone(charts, title, columns=2))
    return [path]


def flight_figures(record: pd.DataFrame, flight: FlightSpec) -> list[Figure]:
    """Return charts of a flight's record.

    Parameters
    ----------
    record : DataFrame
        All signals over time.
    flight : FlightSpec
        Burn-in [s], which is shaded, and excursion radii [m].
    """
    # Track first, then the charts over time.
    figures = [_track(record)]
    for name, axis, lines, factor in _panels(record):
        series = {
            words: factor * record[column].to_numpy(dtype=float) for column, words in lines.items()
        }
        radii = flight.excursion_radius_m if name == "errors" else ()
        figures.append(
            _over_time(
                record["time_s"].to_numpy(dtype=float), name, axis, series, flight.burn_in_s, radii
            )
        )
    return figures


def _panels(record: pd.DataFrame) -> Iterator[tuple[str, str, Mapping[str, str], float]]:
    """Yield name, axis label, columns with labels, and factor of each chart that the record
    supports.
    """
    errors = {f"error_{n}": n.replace("_", "-") for n in ("cross_track", "altitude", "speed")}
    # Positions are preferred to commands.
    surfaces, throttle = (
        {c: c for s in _SURFACES for c in _rerun_control(record, s)},
        {c: c for c in _rerun_control(record, "throttle")},
    )
    # A coefficient without a delta is not varied in this flight, whatever its level.
    # Levels of coefficients with a delta in this flight.
    active = [
        name for name in COEFFICIENTS if f"delta_{name}" in record and record[f"delta_{name}"].any()
    ]
    for name, axis, lines, factor in (
        ("errors", "errors [m], [m/s]", errors, 1.0),
        ("angles", "angles [deg]", {a: a.removesuffix("_rad") for a in _ANGLES}, RAD_DEG),
        ("speed", "airspeed [m/s]", {"V_mps": ""}, 1.0),
        ("height", "height above sea level [m]", {"h_m": ""}, 1.0),
        ("surfaces", "surfaces [deg], [-]", surfaces, 1.0),
        ("throttle", "throttle [%], [-]", throttle, 1.0),
        ("levels", "level between the bounds [-]", {f"level_{c}": c for c in active}, 1.0),
    ):
        recorded = {column: words for column, words in lines.items() if column in record}
        if recorded:
            yield name, axis, recorded, factor


def _rerun_control(record: pd.DataFrame, control: str) -> list[str]:
    """Return the best column of a control: position before command."""
    return [
        n for ending in ("pos_deg", "deg", "norm", "pct") if (n := f"{control}_{ending}") in record
    ][:1]


def _over_time(
    time_s: np.ndarray,
    name: str,
    axis: str,
    series: Mapping[str, np.ndarray],
    burn_in_s: float,
    radii: Sequence[float],
) -> Figure:
    """Draw columns over time, with excursion radii on the error chart."""
    # Radii far beyond the flight would compress the chart.
    cross_track = series.get("cross-track", np.zeros(1))
    reach = 2.0 * max(5.0, float(np.nanmax(np.abs(cross_track), initial=0.0)))
    visible_radii = [radius for radius in radii if "cross-track" in series and radius <= reach]
    y = scale(
        axis,
        [
            *series.values(),
            np.array([side for radius in visible_radii for side in (-radius, radius)]),
        ],
    )
    if name == "levels":
        y = Scale(axis, -0.02, 1.02)
    chart = Chart(
        f"flight-{name}",
        f"{axis} over the flight.",
        Scale("time [s]", float(time_s[0]), float(time_s[-1])),
        y,
        190,
    )
    # Shade the burn-in, which is not scored.
    if burn_in_s:
        ends = np.array([time_s[0], min(burn_in_s, time_s[-1])])
        chart.band(ends, np.full(2, y.low), np.full(2, y.high), "fillrange", "not scored")
    for (words, values), kind in zip(series.items(), _KINDS, strict=False):
        chart.line(time_s, values, f"{kind} thin", words)
    for radius in visible_radii:
        chart.level(radius, "limit", "excursion radius")
        chart.level(-radius, "limit")
    return Figure(chart.name, chart.svg(), "")


def _track(record: pd.DataFrame) -> Figure:
    """Draw the ground track of a record."""
    if {"north_m", "east_m"} <= set(record.columns):
        east, north = (record[n].to_numpy(dtype=float) for n in ("east_m", "north_m"))
    else:
        # Integrate velocities if the record has no position.
        step = np.diff(record["time_s"], append=record["time_s"].iloc[-1])
        east, north = (
            np.cumsum(record[n].to_numpy(dtype=float) * step) for n in ("ve_mps", "vn_mps")
        )
    x, y = equal_scales(east, north, 330)
    chart = Chart("flight-track", "Track over the ground, north [m] over east [m].", x, y, 330)
    few = max(1, math.ceil(len(east) / 4000))
    chart.path(east[::few], north[::few], "first thin")
    chart.marker(float(east[0]), float(north[0]), "second", "disc")
    return Figure(chart.name, chart.svg(), "Track over the ground; the disc is the start.")
