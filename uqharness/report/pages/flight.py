"""Build the pages of a recorded flight and of a log.

A flight has its ground track, every channel over time and manoeuvres; a log also has its purposes,
findings in their channels and phases.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.errors import Finding
from sysid.logs import LogInfo
from sysid.record import FlightRecord
from uqharness.report.channels import (
    Shade,
    channel_sections,
    channels_of,
    flags_of,
    named_stretches,
    shown_signal,
    spans_of,
)
from uqharness.report.ground_track import Circle, flight_track
from uqharness.report.parts import (
    Cell,
    Code,
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

Columns = Mapping[str, NDArray[Any]]
MAX_LISTED = 60
"""Number of manoeuvres in the table; all are shaded."""


@dataclass(frozen=True)
class FlightFacts:
    """Describe a flight: aircraft, script, conditions, record file, and the command that repeats
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
    question = f"What does {info.source} hold, what is wrong with it, and what does it serve?"
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
        "In the charts below a finding is in the caption of its channel; where the log tells"
        " when, the time is shaded."
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
    words = Words("Lines of a signal map (--map MAP.toml) that mend the findings:")
    return (Section("Lines that mend", (words, Code("Lines of a signal map", text))),)


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
