"""Draw every channel of a flight over time, one chart per channel.

Phases and manoeuvres are shaded, and findings of the log check are flagged at the times where they
hold. Used by the pages of a log and of a recorded flight.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.errors import Finding
from sysid.record import FlightRecord
from sysid.units import RAD_DEG
from sysid.vocabulary import LABELS, SIGNALS
from uqharness.replay import shown_channel
from uqharness.report.parts import Figure, Figures, Section
from uqharness.report.svg import Chart, Scale, scale

Columns = Mapping[str, NDArray[Any]]
GROUPS: Mapping[str, tuple[str, ...]] = {
    "Air data": ("V_mps", "alpha_rad", "beta_rad", "rho_kgpm3"),
    "Attitude and rates": ("phi_rad", "theta_rad", "psi_rad", "p_radps", "q_radps", "r_radps"),
    "Specific force": ("ax_mps2", "ay_mps2", "az_mps2"),
    "Controls and engine": (
        "elevator_deg",
        "aileron_deg",
        "rudder_deg",
        "throttle_pct",
        "rpm",
        "thrust_N",
    ),
    "Path": ("h_m", "north_m", "east_m", "cross_track_m", "vn_mps", "ve_mps", "vd_mps"),
}
_COMPANIONS: Mapping[str, tuple[str, str]] = {
    "V_mps": ("V_demand_mps", "demand"),
    "h_m": ("h_demand_m", "demand"),
    "elevator_deg": ("elevator_pos_deg", "position"),
    "aileron_deg": ("aileron_pos_deg", "position"),
    "rudder_deg": ("rudder_pos_deg", "position"),
}
"""Channel drawn into the chart of another, and its label."""
_UNITS = {
    "rad": ("deg", RAD_DEG),
    "rad/s": ("deg/s", RAD_DEG),
    "m/s2": ("m/s²", 1.0),
    "kg/m3": ("kg/m³", 1.0),
}
_OTHER = "Other channels"
_MIN_HEIGHT = 1e-3
"""Smallest half-height of an axis as a share of the channel's size, so that rounding of a constant
channel is not magnified.
"""
_NUMBER_WIDTH = 6.5
_MOST_DOTS = 1200


@dataclass(frozen=True)
class Shade:
    """Shade a time interval [s] in every chart, in the class ``kind``.

    ``mark`` is written on top.
    """

    start_s: float
    end_s: float
    kind: str
    mark: str = ""


@dataclass(frozen=True)
class Flag:
    """Describe a finding of a channel and the time intervals [s] where it holds; none means
    everywhere.
    """

    words: str
    spans: tuple[tuple[float, float], ...] = ()


def named_stretches(time_s: FloatArray, labels: NDArray[Any]) -> list[tuple[float, float, str]]:
    """Return the runs of equal labels.

    Parameters
    ----------
    time_s : array
        Time (n,) [s].
    labels : array
        Labels (n,); empty ones are left out.

    Returns
    -------
    list of (float, float, str)
        Start and end [s], and label.
    """
    if not len(time_s):
        return []
    # Places where the label changes.
    edges = [0, *(np.flatnonzero(labels[1:] != labels[:-1]) + 1).tolist(), len(labels)]
    out = []
    for first, last in pairwise(edges):
        if isinstance(labels[first], str) and labels[first]:
            out.append(
                (
                    float(time_s[first]),
                    float(time_s[min(last, len(labels) - 1)]),
                    str(labels[first]),
                )
            )
    return out


def shown_signal(name: str) -> tuple[str, str, float]:
    """Return quantity, unit and factor with which a channel is displayed (angles in degrees)."""
    if name not in SIGNALS:
        return shown_channel(name)
    unit, factor = _UNITS.get(SIGNALS[name].unit, (SIGNALS[name].unit, 1.0))
    return (name if name == "rpm" else name.rpartition("_")[0].replace("_", " ")), unit, factor


def channel_sections(
    columns: Columns,
    shades: Sequence[Shade],
    flags: Mapping[str, Sequence[Flag]],
    legend: Sequence[tuple[str, str]],
) -> list[Section]:
    """Return a section per group of channels.

    Parameters
    ----------
    columns : mapping of str to array
        Channels (n,) by name, ``time_s`` included.
    shades : sequence of Shade
        Shaded intervals.
    flags : mapping of str to sequence of Flag
        Findings by channel.
    legend : sequence of (str, str)
        Class and words of the shades.
    """
    # Numeric channels only; labels and time are not drawn.
    available = [
        n
        for n in columns
        if n != "time_s" and n not in LABELS and np.asarray(columns[n]).dtype.kind in "fiub"
    ]
    grouped = {name for group in GROUPS.values() for name in group} | {
        other for name, (other, _) in _COMPANIONS.items() if name in available
    }
    # Channels without a group come last.
    groups = {**GROUPS, _OTHER: tuple(n for n in available if n not in grouped)}
    sections = []
    for title, names in groups.items():
        figures = tuple(
            _channel(name, columns, shades, flags) for name in names if name in available
        )
        if figures:
            entries = (("first", "as recorded; commands as steps"), *legend)
            sections.append(
                Section(
                    title,
                    (
                        Figures(
                            figures, entries, narrow=True, file=re.sub(r"\W+", "-", title.lower())
                        ),
                    ),
                )
            )
    return sections


def _channel(
    name: str, columns: Columns, shades: Sequence[Shade], flags: Mapping[str, Sequence[Flag]]
) -> Figure:
    """Return the chart of one channel, with its companion and findings."""
    quantity, unit, factor = shown_signal(name)
    time_s = np.asarray(columns["time_s"], dtype=float)
    values = factor * np.asarray(columns[name], dtype=float)
    other, words = _COMPANIONS.get(name, ("", ""))
    companion = factor * np.asarray(columns[other], dtype=float) if other in columns else None
    # One axis for the channel and its companion.
    y = _axis(f"{quantity} [{unit}]", [values, *([] if companion is None else [companion])])
    # The vocabulary gives the meaning; angles are displayed in degrees.
    meaning = SIGNALS[name].meaning.replace("2 pi", "360 deg") if name in SIGNALS else quantity
    channel_flags = flags.get(name, ())
    findings = [f.words for f in channel_flags]
    if companion is not None:
        findings += [f"{f.words} of the {words}" for f in flags.get(other, ())]
    findings_text = f" Findings: {', '.join(findings)}." if findings else ""
    x = Scale("time [s]", float(time_s[0]), float(time_s[-1]))
    chart = Chart(
        f"channel-{name}",
        f"{quantity} [{unit}] over time [s]: {meaning}.{findings_text}",
        x,
        y,
        170,
    )
    # Shades first, so that lines lie on top.
    _shade(chart, shades)
    # Findings with a known time are shaded.
    for flag in channel_flags:
        for start, end in flag.spans:
            # Widen short intervals: a gap of some samples in an hour would be invisible.
            # Half the missing width on either side.
            reach = 0.5 * max(0.0, 0.004 * (x.high - x.low) - (end - start))
            chart.band(
                np.array([start - reach, end + reach]),
                np.full(2, y.low),
                np.full(2, y.high),
                "fillbad",
            )
    # Commands hold between samples, measurements are joined by lines.
    steps = name in SIGNALS and SIGNALS[name].kind == "command"
    line_words = ("command" if steps else "recorded") if companion is not None else ""
    if name in SIGNALS and SIGNALS[name].kind == "heading":
        # Dots, because a line would cross the chart whenever the heading passes north.
        few = np.unique(
            np.linspace(0, values.size - 1, min(values.size, _MOST_DOTS)).round().astype(int)
        )
        chart.dots(time_s[few], values[few], "dotfirst", radius=0.7)
    else:
        chart.line(time_s, values, "first thin", line_words, steps=steps)
    if companion is not None:
        chart.line(
            time_s,
            companion,
            "second thin",
            words,
            steps=other in SIGNALS and SIGNALS[other].kind == "command",
        )
    if not np.isfinite(values).any():
        findings_text = " No finite value." + findings_text
    return Figure(chart.name, chart.svg(), f"{quantity} [{unit}]: {meaning}.{findings_text}")


def _axis(label: str, values: Sequence[FloatArray]) -> Scale:
    """Return a scale that is not narrower than `_MIN_HEIGHT`."""
    # Widen an axis that is too narrow for a constant channel.
    axis = scale(label, values)
    middle, half = 0.5 * (axis.low + axis.high), 0.5 * (axis.high - axis.low)
    min_half = _MIN_HEIGHT * max(abs(middle), 1e-6)
    return axis if half >= min_half else Scale(label, middle - min_half, middle + min_half)


def _shade(chart: Chart, shades: Sequence[Shade]) -> None:
    """Shade intervals of a chart and write their marks where they fit."""
    for shade in shades:
        if shade.kind == "joint":
            chart.upright(shade.start_s, "joint")
            continue
        ends = np.array([shade.start_s, shade.end_s])
        chart.band(ends, np.full(2, chart.y.low), np.full(2, chart.y.high), shade.kind)
        # Write a mark only where it fits inside its interval.
        x0, _, width, _ = chart.plot
        u, v = (float(w) for w in chart.at(ends, np.zeros(2))[0])
        if (
            shade.mark
            and v - u >= _NUMBER_WIDTH * len(shade.mark) + 1
            and x0 <= u
            and v <= x0 + width + 1
        ):
            chart.text(float(ends.mean()), chart.y.high, shade.mark, "middle", (0.0, 10.0))


# Places of findings: channels and time intervals.

MOST_SPANS = 60
"""Maximum number of intervals of one finding that are drawn."""
_GROUPS: Mapping[str, tuple[str, ...]] = {
    "ground velocity": ("vn_mps", "ve_mps", "vd_mps"),
    "attitude": ("phi_rad", "theta_rad", "psi_rad"),
    "position": ("north_m", "east_m", "h_m"),
}
"""Names under which a finding covers several channels."""
_SKIPPED_CODES = ("flight-phase", "slower-than-grid", "time-repeats")
"""Findings that the shading shows already, or that have no place in time."""


def channels_of(finding: Finding, record: FlightRecord) -> tuple[str, ...]:
    """Return the channels of a record that a finding concerns.

    Parameters
    ----------
    finding : Finding
        Its channel is a column, a group of columns, or a message of the log.
    record : FlightRecord
        The log.
    """
    name = finding.channel
    if name in record:
        return (name,)
    if name in _GROUPS:
        return tuple(n for n in _GROUPS[name] if n in record)
    # The finding names the message that channels were made from.
    sources = record.metadata.channels
    return tuple(
        n
        for n in record.columns
        if name and re.split(r"[\W]", sources.get(n, ""), maxsplit=1)[0] == name
    )


def spans_of(
    finding: Finding, channel: str, record: FlightRecord
) -> tuple[tuple[float, float], ...]:
    """Return the time intervals [s] where a finding holds for a channel.

    Parameters
    ----------
    finding : Finding
        Finding of the log check.
    channel : str
        Column of the record.
    record : FlightRecord
        The log.

    Returns
    -------
    tuple of (float, float)
        Empty if it holds everywhere or the log does not tell.
    """
    numbers = finding.numbers
    # The finding itself names the interval.
    if "start_s" in numbers and "end_s" in numbers:
        return ((numbers["start_s"], numbers["end_s"]),)
    time_s = record["time_s"]
    if channel in LABELS:
        return ()
    # Otherwise the interval follows from the data.
    values = record[channel]
    if finding.code in ("gap", "dropouts"):
        return _runs(time_s, ~np.isfinite(values))
    if finding.code == "out-of-range":
        return _runs(time_s, (values < SIGNALS[channel].low) | (values > SIGNALS[channel].high))
    if finding.code == "negative-airspeed":
        return _runs(time_s, values < 0.0)
    return ()


def flags_of(record: FlightRecord) -> dict[str, list[Flag]]:
    """Return the flags of every channel with findings."""
    out: dict[str, list[Flag]] = {}
    for finding in record.metadata.findings:
        if finding.code in _SKIPPED_CODES:
            continue
        for channel in channels_of(finding, record):
            words = (
                finding.code if finding.severity == "info" else f"{finding.severity} {finding.code}"
            )
            channel_flags = out.setdefault(channel, [])
            if words not in [flag.words for flag in channel_flags]:
                channel_flags.append(Flag(words, spans_of(finding, channel, record)))
    return out


def _runs(time_s: NDArray[np.float64], mask: NDArray[np.bool_]) -> tuple[tuple[float, float], ...]:
    """Return start and end of each run of True, merged until there are at most `MOST_SPANS`."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    runs = [(float(time_s[a]), float(time_s[b - 1])) for a, b in edges.reshape(-1, 2)]
    distance_s = 0.0
    # Double the distance over which neighbours are merged until few enough remain.
    while len(runs) > MOST_SPANS:
        distance_s = 2.0 * distance_s or 1e-3 * float(time_s[-1] - time_s[0])
        merged = [runs[0]]
        for start, end in runs[1:]:
            if start - merged[-1][1] <= distance_s:
                merged[-1] = (merged[-1][0], end)
            else:
                merged.append((start, end))
        runs = merged
    return tuple(runs)
