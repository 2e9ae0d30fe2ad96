"""Manoeuvres of a flight, found in its commands: doublets, 3-2-1-1 and single pulses of one control. Pure numerics on a record.

A manoeuvre is a row of pulses: the command leaves its place quickly, keeps another one, and comes back. What an autopilot or a
pilot does to hold an attitude begins quickly too but dies out, and keeps no place.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from sysid.errors import LogError
from sysid.logs.manoeuvres import label_manoeuvres
from sysid.record import FlightRecord

FOUND = "found"
"""In place of a table of manoeuvres."""
AXES = {
    "elevator_deg": "pitch",
    "aileron_deg": "roll",
    "rudder_deg": "yaw",
    "throttle_pct": "throttle",
}
_LEAST = {"elevator_deg": 0.8, "aileron_deg": 0.8, "rudder_deg": 0.8, "throttle_pct": 5.0}
"""Smallest pulse, in the command's unit: sixteen steps of a servo pulse of 1 us."""
_BASE_S = 14.0  # the median over so long is the command without the manoeuvre
_LONGEST_S, _SHORTEST_S = 12.0, 0.12  # of a manoeuvre, of a pulse
_PAUSE_S = 0.35  # between pulses that follow one another at once
_LEAST_HZ = 15.0  # of a command: logged more slowly it shows no edges, and corrections in gusts pass for pulses
_SINGLE_S = 0.3  # shortest single pulse: less is a spike of a mode's change
_FLAT = 0.8  # mean of a pulse over its largest value; of what dies out exponentially 0.4, of half a sine 0.64
_EDGE = 0.5  # of a pulse's largest value, where it begins and ends
_REST_S, _REST = (
    0.5,
    0.2,
)  # the command before a manoeuvre moves by less than this share of the first pulse
_EDGE_S = 0.1  # in which it then reaches half of the pulse: a servo's, or a hand's
_ALIKE = 1.7  # factor between the durations, and the sizes, of the pulses of a doublet
_THREE_TWO_ONE_ONE = np.array([3.0, 2.0, 1.0, 1.0])
_BEFORE_S, _AFTER_S = (
    1.0,
    3.0,
)  # of a labelled manoeuvre: the state that it begins from, and the answer


@dataclass(frozen=True)
class Manoeuvre:
    """A manoeuvre of one control.

    kind     doublet | 3-2-1-1 | pulse | pulses          axis   pitch | roll | yaw | throttle
    start_s  when the command left its place              end_s  when it was back; the aircraft's answer goes on
    size     largest deviation of the command, with the sign of the first pulse, in ``unit``
    """

    kind: str
    axis: str
    start_s: float
    end_s: float
    size: float
    unit: str

    @property
    def name(self) -> str:
        """Axis and kind, such as "pitch doublet"."""
        return f"{self.axis} {self.kind}"

    def as_dict(self) -> dict[str, Any]:
        """For --json."""
        return {
            "kind": self.kind,
            "axis": self.axis,
            "start_s": self.start_s,
            "end_s": self.end_s,
            "size": self.size,
            "unit": self.unit,
        }


@dataclass(frozen=True)
class _Pulse:
    first: int
    last: int
    size: float


def found_manoeuvres(record: FlightRecord) -> tuple[Manoeuvre, ...]:
    """Manoeuvres in order of time, of each control that is logged. A control that never rests shows none."""
    out = []
    for name in AXES:
        native = record.metadata.native_hz.get(name, 1.0 / record.dt_s)
        if name in record and len(record) > 2 and native >= _LEAST_HZ:
            out += _of_command(record, name)
    return tuple(sorted(out, key=lambda m: (m.start_s, m.axis)))


def label_found(record: FlightRecord) -> FlightRecord:
    """The record with the column ``manoeuvre`` from what `found_manoeuvres` finds in free flight.

    A label begins a second before the input and ends three after it, or where the next one begins.

    Raises LogError where none is found.
    """
    free = record.metadata.free_flight_s
    found = found_manoeuvres(record.between(*free[0]) if free else record)
    time = record["time_s"]
    if not found:
        raise LogError(
            "no manoeuvre was found in the commands; give a table of times with --manoeuvres FILE.csv"
        )
    labels = np.full(len(record), "", dtype=object)
    for k, m in enumerate(found):
        until = found[k + 1].start_s - _BEFORE_S if k + 1 < len(found) else np.inf
        labels[
            (time >= m.start_s - _BEFORE_S) & (time <= max(m.end_s, min(m.end_s + _AFTER_S, until)))
        ] = m.name
    return record.with_columns({"manoeuvre": labels})


def labelled(record: FlightRecord, manoeuvres: Path, flight: str) -> FlightRecord:
    """The record with the column ``manoeuvre`` of a table, or for FOUND of its own commands. Raises LogError."""
    if str(manoeuvres) == FOUND:
        return label_found(record)
    return label_manoeuvres(record, manoeuvres, flight)


def _of_command(record: FlightRecord, name: str) -> list[Manoeuvre]:
    time, unit = record["time_s"], "%" if name.endswith("_pct") else "deg"
    out = []
    for rows in record.segments((name,), _BASE_S / 4.0):
        values = np.asarray(record[name][rows], dtype=np.float64)
        away = values - _base(values, record.dt_s)
        for group in _groups(_pulses(away, _LEAST[name], record.dt_s), record.dt_s):
            first, last = group[0].first, group[-1].last
            size = max((p.size for p in group), key=abs)
            if len(group) == 1 and not _alone(record, name, rows.start + first, rows.start + last):
                continue
            if (last - first) * record.dt_s > _LONGEST_S or not _rested(
                values, first, abs(group[0].size), record.dt_s
            ):
                continue
            start, end = (
                float(time[rows.start + first]),
                float(time[min(rows.start + last + 1, len(time) - 1)]),
            )
            out.append(
                Manoeuvre(
                    _kind(group),
                    AXES[name],
                    start,
                    end,
                    float(np.copysign(abs(size), group[0].size)),
                    unit,
                )
            )
    return out


def _base(values: FloatArray, dt_s: float) -> FloatArray:
    from scipy.ndimage import median_filter

    few = max(
        1, round(0.1 / dt_s)
    )  # a tenth of a second apart is close enough for a median over many
    slow = values[::few]
    width = min(max(3, round(_BASE_S / (few * dt_s))), slow.size) | 1
    return np.interp(
        np.arange(values.size),
        np.arange(slow.size) * few,
        median_filter(slow, size=width, mode="nearest"),
    )


def _pulses(away: FloatArray, least: float, dt_s: float) -> list[_Pulse]:
    """Stretches of one sign that keep a place, each from half of its largest value to half of it."""
    sign = np.where(np.abs(away) > 0.5 * least, np.sign(away), 0.0)
    edges = np.flatnonzero(np.diff(sign)) + 1
    out = []
    for first, stop in zip([0, *edges.tolist()], [*edges.tolist(), away.size], strict=True):
        if sign[first] == 0.0:
            continue
        part = np.abs(away[first:stop])
        peak = float(part.max())
        inside = np.flatnonzero(part > _EDGE * peak)
        begin, end = first + int(inside[0]), first + int(inside[-1])
        flat = float(np.abs(away[begin : end + 1]).mean()) > _FLAT * peak
        if peak > least and flat and (end - begin + 1) * dt_s >= _SHORTEST_S:
            out.append(_Pulse(begin, end, float(sign[first]) * peak))
    return out


def _groups(pulses: list[_Pulse], dt_s: float) -> list[list[_Pulse]]:
    """Pulses that follow one another at once."""
    out: list[list[_Pulse]] = []
    for pulse in pulses:
        if out and (pulse.first - out[-1][-1].last - 1) * dt_s <= _PAUSE_S:
            out[-1].append(pulse)
        else:
            out.append([pulse])
    return out


def _rested(values: FloatArray, first: int, size: float, dt_s: float) -> bool:
    """Whether the command stayed in its place before, and left it quickly."""
    edge, rest = round(_EDGE_S / dt_s) + 1, round(_REST_S / dt_s)
    before = values[max(0, first - edge - rest) : max(0, first - edge)]
    return before.size * dt_s > 0.5 * _REST_S and float(np.ptp(before)) < _REST * size


def _alone(record: FlightRecord, name: str, first: int, last: int) -> bool:
    """Whether a single pulse is the only command that moves: an autopilot's corrections move several at once, or are short."""
    rest = round(_REST_S / record.dt_s)
    span = slice(max(0, first - rest), last + 1 + rest)
    others = [record[n][span] for n in AXES if n != name and n in record]
    limits = [_LEAST[n] for n in AXES if n != name and n in record]
    still = all(
        float(np.ptp(v[np.isfinite(v)])) < limit
        for v, limit in zip(others, limits, strict=True)
        if np.isfinite(v).any()
    )
    return still and (last - first) * record.dt_s > _SINGLE_S


def _kind(group: list[_Pulse]) -> str:
    lengths = np.array([p.last - p.first + 1.0 for p in group])
    sizes = np.array([p.size for p in group])
    turns = bool(np.all(np.sign(sizes[1:]) == -np.sign(sizes[:-1])))
    if len(group) == 1:
        return "pulse"
    alike = np.abs(sizes).max() < _ALIKE * np.abs(sizes).min()
    if len(group) == 2 and turns and alike and lengths.max() < _ALIKE * lengths.min():
        return "doublet"
    if len(group) == 4 and turns and alike:
        ratio = lengths / (lengths.sum() / _THREE_TWO_ONE_ONE.sum()) / _THREE_TWO_ONE_ONE
        return "3-2-1-1" if ratio.max() < _ALIKE * ratio.min() else "pulses"
    return "pulses"
