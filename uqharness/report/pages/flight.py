"""Build the page of a recorded flight: ground track, every channel over time, manoeuvres."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uqharness.report.channels import Shade, channel_sections, named_stretches, shown_signal
from uqharness.report.ground_track import Circle, flight_track
from uqharness.report.parts import (
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
