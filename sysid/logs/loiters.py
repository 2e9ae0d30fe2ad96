"""Circles that an autopilot was told to fly: centre, radius and sense, from what the log says of its commands. Pure numerics.

ArduPlane circles in the mode LOITER about the target of its navigation (NTUN.TLat, TLng), and in AUTO about the place of a loiter
command (CMD), both with WP_LOITER_RAD unless the command has a radius of its own; a negative radius is flown anticlockwise. A log
without the target still has the signed distance from the circle: with positions it gives the centre.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.foreign.raw import MessageTable, RawLog
from sysid.logs.channels import local
from sysid.record import Loiter

_LOITER_COMMANDS = (17.0, 18.0, 19.0)  # MAV_CMD_NAV_LOITER_UNLIM, _TURNS, _TIME
_LEAST_S = 10.0
_MOVES_M = 1.0  # a target that moves by more is another one
_LEAST_ROWS = 50
_AGREES = 0.1  # of the radius, by which the distances may miss the circle that they are to be measured from


@dataclass(frozen=True)
class Commands:
    """What a log says of loiters: targets and loiter commands, each (n,) times with places north and east [m] of the start.

    command_radius_m  signed, 0 where the command has none
    radius_m          WP_LOITER_RAD, signed; NaN where the log has no such parameter
    """

    target_s: FloatArray
    target_m: FloatArray
    command_s: FloatArray
    command_m: FloatArray
    command_id: FloatArray
    command_radius_m: FloatArray
    radius_m: float


def loiter_commands(raw: RawLog, start: Mapping[str, float]) -> Commands | None:
    """Targets and commands of a DataFlash log; None where it says no radius, or nothing of where it began."""
    radius = float(raw.parameters.get("WP_LOITER_RAD", np.nan))
    if not np.isfinite(radius) or "lat_deg" not in start:
        return None
    target_s, target_m, _ = _places(raw.messages.get(("NTUN", 0)), "TLat", "TLng", start)
    command = raw.messages.get(("CMD", 0))
    command_s, command_m, kept = _places(command, "Lat", "Lng", start)
    number, own = (
        np.zeros(kept.size)
        if command is None or field not in command.fields
        else command.fields[field][kept].astype(np.float64)
        for field in ("CId", "Prm3")
    )
    return Commands(target_s, target_m, command_s, command_m, number, own, radius)


def _places(
    table: MessageTable | None, lat: str, lng: str, start: Mapping[str, float]
) -> tuple[FloatArray, FloatArray, NDArray[Any]]:
    """Times (n,), places (2, n) and the rows of a message that have a place."""
    if table is None or lat not in table.fields or lng not in table.fields:
        return np.zeros(0), np.zeros((2, 0)), np.zeros(0, dtype=np.int64)
    lats, lngs = (np.asarray(table.fields[field], dtype=np.float64) for field in (lat, lng))
    kept = np.flatnonzero(
        np.isfinite(lats) & np.isfinite(lngs) & ((np.abs(lats) > 1e-6) | (np.abs(lngs) > 1e-6))
    )
    placed = local(np.append(start["lat_deg"], lats[kept]), np.append(start["lon_deg"], lngs[kept]))
    return table.time_s[kept], np.stack(placed)[:, 1:], kept


def found_loiters(
    columns: Mapping[str, NDArray[Any]], commands: Commands | None
) -> tuple[Loiter, ...]:
    """Loiters in order of time; those whose centre nothing tells are left out.

    columns  a record's, of which time_s, mode, north_m, east_m and cross_track_m are used
    """
    if commands is None or "mode" not in columns:
        return ()
    time, modes = columns["time_s"], columns["mode"]
    edges = [0, *(np.flatnonzero(modes[1:] != modes[:-1]) + 1).tolist(), len(modes)]
    out: list[Loiter] = []
    for first, stop in itertools.pairwise(edges):
        span = float(time[first]), float(time[stop - 1])
        if modes[first] == "LOITER":
            out += _about_targets(commands, span) or _about_distances(
                columns, slice(first, stop), commands.radius_m
            )
        elif modes[first] == "AUTO":
            out += _about_commands(commands, span)
    return tuple(loiter for loiter in out if loiter.end_s - loiter.start_s >= _LEAST_S)


def _about_targets(commands: Commands, span_s: tuple[float, float]) -> list[Loiter]:
    """A loiter for each place that the target kept. At the change of mode the target may still be the one before."""
    inside = np.flatnonzero((commands.target_s >= span_s[0]) & (commands.target_s <= span_s[1]))
    if not inside.size:
        return []
    places = commands.target_m[:, inside]
    breaks = np.flatnonzero(np.hypot(*np.diff(places, axis=1)) > _MOVES_M) + 1
    out = []
    for group in np.split(inside, breaks):
        north, east = (float(np.median(axis)) for axis in commands.target_m[:, group])
        start, end = (float(commands.target_s[k]) for k in (group[0], group[-1]))
        out.append(
            _loiter((start, end), north, east, commands.radius_m, "NTUN.TLat, TLng; WP_LOITER_RAD")
        )
    return out


def _about_commands(commands: Commands, span_s: tuple[float, float]) -> Iterator[Loiter]:
    """Loiter commands of a mission, each until the next command."""
    inside = np.flatnonzero((commands.command_s >= span_s[0]) & (commands.command_s <= span_s[1]))
    for k, at in enumerate(inside.tolist()):
        if commands.command_id[at] not in _LOITER_COMMANDS:
            continue
        end = float(commands.command_s[inside[k + 1]]) if k + 1 < inside.size else span_s[1]
        own = float(commands.command_radius_m[at])
        radius, source = (own, "CMD") if own != 0.0 else (commands.radius_m, "CMD; WP_LOITER_RAD")
        north, east = (float(v) for v in commands.command_m[:, at])
        yield _loiter((float(commands.command_s[at]), end), north, east, radius, source)


def _about_distances(
    columns: Mapping[str, NDArray[Any]], rows: slice, radius_m: float
) -> list[Loiter]:
    """The centre from positions and signed distances d from a circle of known radius R, by least squares.

    n^2 + e^2 - (R + d)^2 = 2 c.(n, e) - c^2 is linear in the centre c and in c^2; nothing where the rest is large.
    """
    names = ("north_m", "east_m", "cross_track_m")
    if not all(n in columns for n in names):
        return []
    north, east, distance = (np.asarray(columns[n][rows], dtype=np.float64) for n in names)
    # The distance is positive outside the circle whichever way round; while the aircraft flies there it is large.
    known = np.isfinite(north) & np.isfinite(east) & (np.abs(distance) < 0.5 * abs(radius_m))
    n, e, d = north[known], east[known], distance[known]
    if n.size < _LEAST_ROWS:
        return []
    design = np.column_stack([2.0 * n, 2.0 * e, -np.ones(n.size)])
    centre, _, rank, _ = np.linalg.lstsq(
        design, n**2 + e**2 - (abs(radius_m) + d) ** 2, rcond=1e-10
    )
    miss = np.hypot(n - centre[0], e - centre[1]) - abs(radius_m) - d
    if rank < 3 or float(np.sqrt(np.mean(miss**2))) > _AGREES * abs(radius_m):
        return []
    time = columns["time_s"][rows]
    ends = float(time[0]), float(time[-1])
    return [
        _loiter(
            ends,
            float(centre[0]),
            float(centre[1]),
            radius_m,
            "positions and cross-track errors; WP_LOITER_RAD",
        )
    ]


def _loiter(
    span_s: tuple[float, float], north_m: float, east_m: float, radius_m: float, source: str
) -> Loiter:
    return Loiter(*span_s, north_m, east_m, abs(radius_m), radius_m >= 0.0, source)
