"""Figure of one flight: the track, errors against their limits, the state, controls and levels over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uqharness.campaign.folder.rerun import Rerun
from uqharness.files import write_whole
from uqharness.flight.spec import COEFFICIENTS, FlightSpec

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_ANGLES = ("phi_rad", "theta_rad", "alpha_rad", "beta_rad")
_CONTROLS = ("elevator", "aileron", "rudder", "throttle")
_POINTS = 4000


def draw_rerun(found: Rerun) -> list[Path]:
    """Draw a case that was flown again beside its record; none where it left no record."""
    record = next((path for path in found.files if path.suffix == ".parquet"), None)
    if record is None:
        return []
    case = found.case
    where = f"flight {case.aleatory_id}, {case.wind_mps:g} m/s {case.turbulence}"
    path = found.folder / "flight.svg"
    title = f"case {case.case_id}: {case.epistemic_id}, {where}; {found.outcome.status}"
    draw_flight(pd.read_parquet(record), case.flight, title, path)
    return [path]


def draw_flight(record: pd.DataFrame, flight: FlightSpec, title: str, path: Path) -> None:
    """Draw the record of one flight as SVG. Same record, same bytes. What was flown and not scored is shaded."""
    shown = record.iloc[:: max(1, len(record) // _POINTS)]
    with matplotlib.rc_context({"svg.hashsalt": "uqharness", "font.size": 8, "axes.grid": True, "grid.color": "#dddddd"}):
        figure = Figure(figsize=(11, 7.5), layout="constrained")
        grid = figure.add_gridspec(4, 3)
        _track(figure.add_subplot(grid[:2, 0]), shown)
        _errors(figure.add_subplot(grid[0, 1:]), shown, flight)
        panels = [
            (_angles, grid[1, 1:]),
            (_speed_and_height, grid[2, 1:]),
            (_controls, grid[3, 1:]),
            (_levels, grid[2:, 0]),
        ]
        over_time = [figure.axes[1]]
        for draw, place in panels:
            over_time.append(figure.add_subplot(place))
            draw(over_time[-1], shown)
        for axes in over_time:
            if flight.burn_in_s:
                end_s = min(flight.burn_in_s, float(shown["time_s"].iloc[-1]))
                axes.axvspan(shown["time_s"].iloc[0], end_s, color="#000000", alpha=0.06)
            axes.set_xlabel("time [s]")
            axes.margins(x=0)
        figure.suptitle(title, fontsize=10)
        nothing = {"Date": None, "Creator": None}
        write_whole(path, lambda target: figure.savefig(target, format="svg", metadata=nothing))


def _lines(axes: Axes, record: pd.DataFrame, names: Sequence[str], labels: Sequence[str], factor: float = 1.0) -> None:
    for name, label, colour in zip(names, labels, _COLOURS, strict=False):
        axes.plot(record["time_s"], factor * record[name], color=colour, linewidth=0.9, label=label)
    if names:
        axes.legend(loc="upper right", ncols=6, fontsize=7, framealpha=0.8)
    else:
        axes.text(0.5, 0.5, "not in this aircraft", ha="center", transform=axes.transAxes, color="#777777")


def _track(axes: Axes, record: pd.DataFrame) -> None:
    if {"north_m", "east_m"} <= set(record.columns):
        east, north = record["east_m"].to_numpy(), record["north_m"].to_numpy()
    else:
        step = np.diff(record["time_s"], append=record["time_s"].iloc[-1])
        east, north = np.cumsum(record["ve_mps"] * step), np.cumsum(record["vn_mps"] * step)
    axes.plot(east, north, color=_COLOURS[0], linewidth=0.7)
    axes.plot(east[:1], north[:1], "o", color=_COLOURS[1], markersize=4)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("east [m]")
    axes.set_ylabel("north [m], o start")


def _errors(axes: Axes, record: pd.DataFrame, flight: FlightSpec) -> None:
    names = [name for name in ("error_cross_track", "error_altitude", "error_speed") if name in record]
    _lines(axes, record, names, [name.removeprefix("error_").replace("_", "-") for name in names])
    if "error_cross_track" in names:
        for radius in flight.excursion_radius_m:
            if radius <= 2.0 * max(5.0, float(np.nanmax(np.abs(record["error_cross_track"])))):
                for side in (-radius, radius):
                    axes.axhline(side, color="#777777", linewidth=0.7, linestyle=(0, (4, 2)))
    axes.set_ylabel("errors [m], [m/s]")


def _angles(axes: Axes, record: pd.DataFrame) -> None:
    names = [name for name in _ANGLES if name in record]
    _lines(axes, record, names, [name.removesuffix("_rad") for name in names], 180.0 / np.pi)
    axes.set_ylabel("angles [deg]")


def _speed_and_height(axes: Axes, record: pd.DataFrame) -> None:
    _lines(axes, record, ["V_mps"], ["V"])
    axes.set_ylabel("airspeed [m/s]")
    axes.legend(loc="upper left", fontsize=7)
    height = axes.twinx()
    height.plot(record["time_s"], record["h_m"], color=_COLOURS[1], linewidth=0.9, label="height")
    height.set_ylabel("height above sea level [m]")
    height.legend(loc="upper right", fontsize=7)
    height.grid(False)


def _controls(axes: Axes, record: pd.DataFrame) -> None:
    names = [
        name
        for control in _CONTROLS
        for name in (f"{control}_pos_deg", f"{control}_deg", f"{control}_norm", f"{control}_pct")
        if name in record
    ]
    first: dict[str, str] = {}
    for name in names:
        first.setdefault(name.partition("_")[0], name)
    throttle = first.pop("throttle", None)
    _lines(axes, record, list(first.values()), list(first.values()))
    axes.set_ylabel("surfaces [deg], [1]")
    if throttle is not None:
        axes.legend(loc="upper left", ncols=3, fontsize=7)
        motor = axes.twinx()
        motor.plot(record["time_s"], record[throttle], color=_COLOURS[3], linewidth=0.9, label=throttle)
        motor.set_ylabel("throttle [%], [1]")
        motor.legend(loc="upper right", fontsize=7)
        motor.grid(False)


def _levels(axes: Axes, record: pd.DataFrame) -> None:
    # A coefficient whose delta is 0 throughout is certain in this flight, whatever its level says.
    acting = [name for name in COEFFICIENTS if f"delta_{name}" in record and record[f"delta_{name}"].any()]
    names = [f"level_{name}" for name in acting]
    _lines(axes, record, names, [name.removeprefix("level_") for name in names])
    axes.set_ylim(-0.02, 1.15)
    axes.set_ylabel("level between the bounds")
