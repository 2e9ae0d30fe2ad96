"""Charts of one flight: the track, errors against their limits, the state, controls and levels over time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from sysid.units import RAD_DEG
from uqharness.campaign.folder import Rerun
from uqharness.files import write_text
from uqharness.flight import COEFFICIENTS, FlightSpec
from uqharness.report.ground_track import equal_scales
from uqharness.report.parts import Figure
from uqharness.report.svg import Chart, Scale, scale, standalone

_KINDS = ("first", "second", "third", "plain thin", "limit2", "mark")
_ANGLES = ("phi_rad", "theta_rad", "alpha_rad", "beta_rad")
_SURFACES = ("elevator", "aileron", "rudder")


def draw_rerun(found: Rerun) -> list[Path]:
    """Draw a case that was flown again beside its record; none where it left no record."""
    record = next((path for path in found.files if path.suffix == ".parquet"), None)
    if record is None:
        return []
    case = found.case
    where = f"flight {case.aleatory_id}, {case.wind_mps:g} m/s {case.turbulence}"
    title = f"case {case.case_id}: {case.epistemic_id}, {where}; {found.outcome.status}"
    path = found.folder / "flight.svg"
    charts = [
        (figure.svg, figure.caption)
        for figure in flight_figures(pd.read_parquet(record), case.flight)
    ]
    write_text(path, standalone(charts, title, columns=2))
    return [path]


def flight_figures(record: pd.DataFrame, flight: FlightSpec) -> list[Figure]:
    """Charts of a flight's record. What was flown and not scored is shaded; what the aircraft lacks is left out."""
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
    """Name, axis, columns with their words, and factor of each chart over time that the record has something for."""
    errors = {f"error_{n}": n.replace("_", "-") for n in ("cross_track", "altitude", "speed")}
    surfaces, throttle = (
        {c: c for s in _SURFACES for c in _control(record, s)},
        {c: c for c in _control(record, "throttle")},
    )
    # A coefficient whose delta is 0 throughout is certain in this flight, whatever its level says.
    acting = [
        name for name in COEFFICIENTS if f"delta_{name}" in record and record[f"delta_{name}"].any()
    ]
    for name, axis, lines, factor in (
        ("errors", "errors [m], [m/s]", errors, 1.0),
        ("angles", "angles [deg]", {a: a.removesuffix("_rad") for a in _ANGLES}, RAD_DEG),
        ("speed", "airspeed [m/s]", {"V_mps": ""}, 1.0),
        ("height", "height above sea level [m]", {"h_m": ""}, 1.0),
        ("surfaces", "surfaces [deg], [-]", surfaces, 1.0),
        ("throttle", "throttle [%], [-]", throttle, 1.0),
        ("levels", "level between the bounds [-]", {f"level_{c}": c for c in acting}, 1.0),
    ):
        known = {column: words for column, words in lines.items() if column in record}
        if known:
            yield name, axis, known, factor


def _control(record: pd.DataFrame, control: str) -> list[str]:
    """The column of a control that says most of it: its position before its command."""
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
    cross_track = series.get("cross-track", np.zeros(1))
    reach = 2.0 * max(5.0, float(np.nanmax(np.abs(cross_track), initial=0.0)))
    shown = [radius for radius in radii if "cross-track" in series and radius <= reach]
    y = scale(
        axis, [*series.values(), np.array([side for radius in shown for side in (-radius, radius)])]
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
    if burn_in_s:
        ends = np.array([time_s[0], min(burn_in_s, time_s[-1])])
        chart.band(ends, np.full(2, y.low), np.full(2, y.high), "fillrange", "not scored")
    for (words, values), kind in zip(series.items(), _KINDS, strict=False):
        chart.line(time_s, values, f"{kind} thin", words)
    for radius in shown:
        chart.level(radius, "limit", "excursion radius")
        chart.level(-radius, "limit")
    return Figure(chart.name, chart.svg(), "")


def _track(record: pd.DataFrame) -> Figure:
    if {"north_m", "east_m"} <= set(record.columns):
        east, north = (record[n].to_numpy(dtype=float) for n in ("east_m", "north_m"))
    else:
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
