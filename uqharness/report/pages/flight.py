"""Build the pages of a recorded flight and of a log.

A flight has its ground track, every channel over time and manoeuvres; a log also has its purposes,
findings in their channels and phases.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray, runs
from sysid.errors import Finding
from sysid.logs import LogInfo
from sysid.record import FlightRecord
from sysid.units import RAD_DEG
from sysid.vocabulary import LABELS, SIGNALS
from uqharness.replay import shown_channel
from uqharness.report.ground_track import Circle, flight_track
from uqharness.report.parts import (
    Cell,
    Code,
    Figure,
    Figures,
    Level,
    Page,
    Section,
    Sentence,
    Table,
    Words,
    format_value,
    provenance,
)
from uqharness.report.svg import Chart, Scale, scale

# Draw every channel of a flight over time, one chart per channel.
#
# Phases and manoeuvres are shaded, and findings of the log check are flagged at the times where
# they hold. Used by the pages of a log and of a recorded flight.

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
_MAX_DOTS = 1200


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
    """A finding of a channel and the time intervals [s] where it holds; none means
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
    out = []
    for run in runs(labels):
        first, last = run.start, run.stop
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
            np.linspace(0, values.size - 1, min(values.size, _MAX_DOTS)).round().astype(int)
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

MAX_SPANS = 60
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
    """Return start and end of each run of True, merged until there are at most `MAX_SPANS`."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    runs = [(float(time_s[a]), float(time_s[b - 1])) for a, b in edges.reshape(-1, 2)]
    distance_s = 0.0
    # Double the distance over which neighbours are merged until few enough remain.
    while len(runs) > MAX_SPANS:
        distance_s = 2.0 * distance_s or 1e-3 * float(time_s[-1] - time_s[0])
        merged = [runs[0]]
        for start, end in runs[1:]:
            if start - merged[-1][1] <= distance_s:
                merged[-1] = (merged[-1][0], end)
            else:
                merged.append((start, end))
        runs = merged
    return tuple(runs)


MAX_LISTED = 60
"""Number of manoeuvres in the table; all are shaded."""


@dataclass(frozen=True)
class FlightFacts:
    """A flight: aircraft, script, conditions, record file, and the command that repeats
    it.
    """

    aircraft: str
    script: str
    conditions: str
    record: str
    command: str


def flight_page(request: FlightFacts, columns: Columns, status: str, reason: str) -> Page:
    """Return the page of a record.

    Parameters
    ----------
    request : FlightFacts
        What was flown.
    columns : mapping of str to array
        Channels (n,) by name, ``time_s`` included.
    status, reason : str
        ok, or what ended the flight and why.
    """
    time_s = np.asarray(columns["time_s"], dtype=float)
    length = float(time_s[-1] - time_s[0]) if len(time_s) else 0.0
    # Manoeuvres of the record; a single one over the whole flight is not worth shading.
    names = (
        named_stretches(time_s, np.asarray(columns["manoeuvre"])) if "manoeuvre" in columns else []
    )
    is_single = len(names) == 1 and names[0][1] - names[0][0] >= 0.99 * length
    stretches = [] if is_single else names
    shades = manoeuvre_shades(stretches)
    legend = (("fill1", "manoeuvre"),) if shades else ()
    sections = [
        *track_section(columns),
        *channel_sections(columns, shades, {}, legend),
        *manoeuvre_section(stretches),
    ]
    sections.append(_ranges(columns))
    question = f"How did {request.aircraft} fly {request.script}? {request.conditions}"
    facts = provenance(("Command", request.command), ("Record", request.record))
    return Page(
        f"Flight of {request.aircraft}: {request.script}",
        question,
        _verdict(length, columns, status, reason),
        (*sections, facts),
    )


def _verdict(length: float, columns: Columns, status: str, reason: str) -> tuple[Sentence, ...]:
    """Return how the flight ended and its distance from the commanded path."""
    level: Level = "good" if status == "ok" else "bad"
    end = (
        "The flight ended as planned"
        if status == "ok"
        else f"The flight ended early, {status}: {reason}"
    )
    sentences = [Sentence(f"{end}; {length:.1f} s, {len(columns['time_s'])} rows.", level)]
    if "cross_track_m" in columns:
        # Median and largest distance from the commanded path, if it was recorded.
        error = np.abs(np.asarray(columns["cross_track_m"], dtype=float))
        if np.isfinite(error).any():
            sentences.append(
                Sentence(
                    f"Distance from the commanded path: median {np.nanmedian(error):.3g} m, largest"
                    f" {np.nanmax(error):.3g} m."
                )
            )
    return tuple(sentences)


def manoeuvre_shades(stretches: Sequence[tuple[float, float, str]]) -> list[Shade]:
    """Return shades of manoeuvres, numbered as in `manoeuvre_section`."""
    return [
        Shade(start, end, "fill1", str(k)) for k, (start, end, _) in enumerate(stretches, start=1)
    ]


def manoeuvre_section(stretches: Sequence[tuple[float, float, str]]) -> tuple[Section, ...]:
    """Return the numbered table of manoeuvres.

    Parameters
    ----------
    stretches : sequence of (float, float, str)
        Start and end [s], and name.

    Returns
    -------
    tuple of Section
        Empty without manoeuvres.
    """
    if not stretches:
        return ()
    rows = tuple(
        (str(k), name, f"{start:.2f}", f"{end:.2f}")
        for k, (start, end, name) in enumerate(stretches[:MAX_LISTED], start=1)
    )
    more = f", the first {MAX_LISTED} of {len(stretches)}" if len(stretches) > MAX_LISTED else ""
    table = Table(
        f"Manoeuvres, by the number above their shading{more}.",
        ("Number", "Manoeuvre", "From [s]", "To [s]"),
        rows,
    )
    return (Section("Manoeuvres", (table,)),)


def track_section(
    columns: Columns, words: str = "", circles: Sequence[Circle] = ()
) -> tuple[Section, ...]:
    """Return the ground track; empty without a recorded position.

    Parameters
    ----------
    columns : mapping of str to array
        Channels (n,) by name.
    words : str
        Addition to the caption.
    circles : sequence of Circle
        Commanded circles, if known.
    """
    figure = flight_track("ground-track", columns, words, circles)
    return () if figure is None else (Section("Ground track", (Figures((figure,), file=""),)),)


def _ranges(columns: Columns) -> Section:
    """Return smallest, median and largest value of each channel."""
    rows = []
    for name, values in columns.items():
        if name == "time_s" or np.asarray(values).dtype.kind not in "fiub":
            continue
        quantity, unit, factor = shown_signal(name)
        # Values in displayed units, without NaN.
        finite = factor * np.asarray(values, dtype=float)
        finite = finite[np.isfinite(finite)]
        low, middle, high = (
            float(f(finite)) if finite.size else math.nan for f in (np.min, np.median, np.max)
        )
        rows.append(
            (name, f"{quantity} [{unit}]", *(format_value(v, ".4g") for v in (low, middle, high)))
        )
    if not rows:
        return Section("Ranges", (Words("The record has no channel."),))
    head = ("Column", "Quantity", "Smallest", "Median", "Largest")
    return Section(
        "Ranges", (Table("Smallest, median and largest value of each channel.", head, tuple(rows)),)
    )


# The page of a log.

_LEVELS: Mapping[str, Level] = {"error": "bad", "warning": "warn", "info": ""}
_ORDER = ("error", "warning", "info")
_MAX_MODES = 12
"""Number of flight modes whose changes are drawn; the table lists more."""
_MAX_CIRCLES = 6
"""Number of commanded circles that are drawn."""
_MAX_CHANNELS = 6
"""Number of channels named for one kind of finding."""


def log_page(info: LogInfo, record: FlightRecord, command: str) -> Page:
    """Return the page of a complete log.

    Parameters
    ----------
    info : LogInfo
        Result of `log_info`.
    record : FlightRecord
        The log as `import_log` returns it.
    command : str
        Command line.
    """
    modes = named_stretches(record["time_s"], record["mode"]) if "mode" in record else []
    names = named_stretches(record["time_s"], record["manoeuvre"]) if "manoeuvre" in record else []
    # Many changes of mode would hide the data.
    changes = (
        [Shade(start, start, "joint") for start, _, _ in modes[1:]]
        if len(modes) <= _MAX_MODES
        else []
    )
    # Times outside free flight, mode changes, manoeuvres.
    shades = [*_phases(record), *changes, *manoeuvre_shades(names)]
    flags = flags_of(record)
    legend = (
        [("fillrange", "not free flight")] if any(s.kind == "fillrange" for s in shades) else []
    )
    legend += [("fill1", "manoeuvre")] if names else []
    legend += [("joint", "change of mode")] if changes else []
    legend += (
        [("fillbad", "finding")]
        if any(flag.spans for channel_flags in flags.values() for flag in channel_flags)
        else []
    )
    sections = [_purposes(info), _findings(record), *_mends(info)]
    # Each commanded circle once.
    circles = list(dict.fromkeys(Circle(x.north_m, x.east_m, x.radius_m) for x in info.loiters))[
        :_MAX_CIRCLES
    ]
    sections += [
        *track_section(record.columns, circles=circles),
        *channel_sections(record.columns, shades, flags, legend),
    ]
    sections += [*manoeuvre_section(names), *_modes(modes), _channels(info)]
    facts = [
        ("Command", command),
        ("Log (SHA-256)", f"{record.metadata.sha256 or 'not computed'} {info.source}"),
    ]
    question = f"What does {info.source} contain, which faults has it, and what can it be used for?"
    return Page(f"Log {info.source}", question, _log_verdict(info), (*sections, provenance(*facts)))


def _log_verdict(info: LogInfo) -> tuple[Sentence, ...]:
    """Return vehicle and length, purposes served, and the number of findings."""
    flight = (
        "no free flight"
        if info.flight_s is None
        else f"free flight from {info.flight_s[0]:.1f} to {info.flight_s[1]:.1f} s"
    )
    vehicle = info.vehicle or "vehicle not said"
    sentences = [
        Sentence(
            f"{vehicle}, {info.dialect}: {info.duration_s:.1f} s on a grid of {info.grid_hz:.4g}"
            f" Hz, {flight}."
        )
    ]
    # Purposes that the log supports, and those that it does not.
    serves, unserved = ([p.name for p in info.purposes if p.serves is yes] for yes in (True, False))
    if serves:
        sentences.append(
            Sentence(
                f"The log serves {', '.join(serves)}."
                + (f" It does not serve {', '.join(unserved)}." if unserved else ""),
                "good",
            )
        )
    else:
        sentences.append(Sentence("The log serves no purpose.", "bad"))
    for severity in ("error", "warning"):
        findings = [f for f in info.findings if f.severity == severity]
        if findings:
            codes = ", ".join(dict.fromkeys(f.code for f in findings))
            count = f"{len(findings)} {severity}{'s' if len(findings) > 1 else ''}"
            sentences.append(Sentence(f"{count}: {codes}.", _LEVELS[severity]))
    return tuple(sentences)


def _phases(record: FlightRecord) -> list[Shade]:
    """Return shades for the times outside free flight."""
    time_s = record["time_s"]
    free = record.metadata.free_flight_s
    if not free:
        return []
    # Complement of the intervals of free flight.
    ends = [float(time_s[0]), *(end for stretch in free for end in stretch), float(time_s[-1])]
    return [Shade(a, b, "fillrange") for a, b in zip(ends[::2], ends[1::2], strict=True) if b > a]


def _purposes(info: LogInfo) -> Section:
    """Return the purposes of the log with reasons."""
    rows = tuple(
        (p.name, Cell("yes" if p.serves else "no", "good" if p.serves else "warn"), p.reason)
        for p in info.purposes
    )
    return Section(
        "What it serves",
        (Table("Purposes, and why.", ("Purpose", "Served", "Reason"), rows, key=True),),
    )


def _findings(record: FlightRecord) -> Section:
    """Return the table of findings, one row per kind."""
    findings = record.metadata.findings
    if not findings:
        return Section("Findings", (Words("None."),))
    # Errors first, one row per kind of finding.
    groups: dict[tuple[str, str], list[Finding]] = {}
    for f in sorted(
        findings, key=lambda f: _ORDER.index(f.severity) if f.severity in _ORDER else len(_ORDER)
    ):
        groups.setdefault((f.severity, f.code), []).append(f)
    rows = []
    for (severity, code), members in groups.items():
        first = members[0]
        further_channels = [f.channel for f in members[1:] if f.channel]
        more = f" Also: {', '.join(further_channels)}." if further_channels else ""
        description = f"{first.message.rstrip('.')}.{more}"
        rows.append(
            (
                code,
                Cell(severity, _LEVELS.get(severity, "")),
                _where(members, record),
                description,
                first.spoils or "-",
            )
        )
    head = ("Finding", "Severity", "Where", "What", "Spoils")
    table = Table("Findings by severity, one row a kind.", head, tuple(rows))
    text = (
        "In the charts below a finding is in the caption of its channel; its time is shaded if"
        " known."
    )
    return Section("Findings", (Words(text, note=True), table))


def _where(members: Sequence[Finding], record: FlightRecord) -> str:
    """Return the channels of findings of one kind and the times where they hold."""
    names = list(
        dict.fromkeys(n for f in members for n in channels_of(f, record) or (f.channel,) if n)
    )
    channels = ", ".join(names[:_MAX_CHANNELS]) + (
        f" and {len(names) - _MAX_CHANNELS} more" if len(names) > _MAX_CHANNELS else ""
    )
    spans = [
        span for f in members for n in channels_of(f, record)[:1] for span in spans_of(f, n, record)
    ]
    if not spans:
        return channels or "whole log"
    # The longest interval.
    start, end = min(spans, key=lambda s: s[0] - s[1])
    longest = "" if len(spans) == 1 else f"{len(spans)} stretches, the longest "
    return f"{channels}: {longest}{start:.2f} to {end:.2f} s"


def _mends(info: LogInfo) -> tuple[Section, ...]:
    """Return lines of a signal map that correct findings; empty if there are none."""
    mends = [f for f in info.findings if f.mend]
    if not mends:
        return ()
    text = "\n".join(f"# {f.code}, {f.channel or 'whole log'}\n{f.mend}" for f in mends)
    words = Words("Lines of a signal map (--map MAP.toml) that correct the findings:")
    return (Section("Corrections", (words, Code("Lines of a signal map", text))),)


def _modes(modes: Sequence[tuple[float, float, str]]) -> tuple[Section, ...]:
    """Return the table of flight modes; empty if they were not logged."""
    if not modes:
        return ()
    rows = tuple((f"{start:.2f}", f"{end:.2f}", name) for start, end, name in modes[:MAX_LISTED])
    more = f", the first {MAX_LISTED} of {len(modes)}" if len(modes) > MAX_LISTED else ""
    return (
        Section(
            "Flight modes",
            (Table(f"Flight modes{more}.", ("From [s]", "To [s]", "Mode"), rows),),
            folded=True,
        ),
    )


def _channels(info: LogInfo) -> Section:
    """Return the source and rate of each channel."""
    rows = tuple(
        (name, f"{info.rates_hz[name]:.4g}" if name in info.rates_hz else "-", label)
        for name, label in info.channels.items()
    )
    return Section(
        "Channels",
        (
            Table(
                "What each channel was made from, and its own rate.",
                ("Channel", "Rate [Hz]", "Source"),
                rows,
            ),
        ),
    )
