"""The proof of match in a dossier: tests, tolerances, segments, and the worst of each test drawn with its band."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from uqharness.dossier import (
    ABSENT,
    FAIL,
    PASS,
    REGULATION,
    TESTS,
    UNSURE,
    Evidence,
    Judged,
    Match,
    Row,
    Step,
    limits,
    prove,
)
from uqharness.dossier import Band as Tolerance
from uqharness.replay import History, axis_label, shown_channel
from uqharness.report.parts import Block, Cell, Figure, Figures, Level, Section, Table, Words, shown
from uqharness.report.svg import Chart, Scale, scale

_LEVELS: dict[str, Level] = {PASS: "good", FAIL: "bad", UNSURE: "warn", ABSENT: ""}
_MOST_ROWS = 60
_MOST_DOTS = 250


@dataclass(frozen=True)
class Compared:
    """Log and model of a step: which model (the ending of its columns), and in words on which flights."""

    step: Step
    segments: Sequence[History]
    suffix: str
    model: str
    match: Match


def compared(found: Evidence) -> Compared | None:
    """What the proof of match is made from: the last refinement's hold-out flights, else a comparison, else the identification."""
    for kind, suffix, model in (
        (
            "refine",
            "_after",
            "the refined model on hold-out flights, which were used neither for choosing nor for fitting",
        ),
        ("compare", "_model", "the model on a flight that it was compared with"),
        (
            "identify",
            "_model",
            "the identified model on the flights that it was identified from: no hold-out flight is here",
        ),
    ):
        for step in reversed(found.of(kind)):
            segments = [
                s for s in found.histories(step) if any(c.endswith(suffix) for c in s.columns)
            ]
            if segments:
                return Compared(
                    step, segments, suffix, model, prove(segments, suffix, _noise(step))
                )
    return None


def _noise(step: Step) -> dict[str, float | None]:
    document = step.document or {}
    if step.kind == "refine":
        return {c: r.get("noise_rms") for c, r in document["gap"]["test"]["channels"].items()}
    rows = document["fit"] if step.kind == "identify" else document["channels"]
    return {c: r.get("noise") for c, r in rows.items()}


def match_section(title: str, source: Compared | None) -> Section:
    """The section: what was compared, a line for each test of the table, a line for each segment, the figures."""
    if source is None:
        text = f"Not in the data: the folder has no time histories of log and model, so none of the tests of {REGULATION} is here."
        return Section(title, (Words(text),))
    match = source.match
    intro = (
        f"Judged is {source.model} ({source.step.kind}, {source.step.place}). Start states, sensor biases and delays of each "
        "segment are estimated from that segment. Nothing is filtered: the sensors' noise is part of what was measured. The "
        "controls are those of the log. A segment counts for a test where the test's control moves and no other does, whatever the "
        "size of the input."
    )
    about = (
        f"Tolerances of {REGULATION}, edition of 1 January 2014, which is written for the evaluation of full flight simulators. "
        "The numbers are used here as a yardstick. Flight conditions, configurations and the other tests of the table are not "
        "looked at. Of two tolerances for one parameter the less restrictive counts."
    )
    blocks: list[Block] = [Words(intro), Words(about, note=True), _summary(match), *_details(match)]
    figures = _figures(source)
    if figures:
        legend = (
            ("dot", "measured"),
            ("fill1", "tolerance about what was measured"),
            ("first", "model"),
        )
        blocks.append(Figures(figures, legend))
    return Section(title, tuple(blocks))


def _summary(match: Match) -> Table:
    rows = []
    for test in TESTS:
        found = match.of(test.entry)
        answers = [j.answer for j in found]
        answer = next((a for a in (FAIL, UNSURE, PASS) if a in answers), ABSENT)
        words = ", ".join(f"{answers.count(a)} {a}" for a in (PASS, FAIL, UNSURE) if a in answers)
        small = words if found else match.missing.get(test.entry, "")
        rows.append(
            (
                f"{test.entry} {test.title}",
                test.tolerance,
                str(len(found)),
                Cell(answer, _LEVELS[answer], small=small),
            )
        )
    head = ("Test", "Tolerance", "Segments", "Answer")
    return Table(
        "Tests that the flights may contain. A test fails where one of its segments does.",
        head,
        tuple(rows),
    )


def _details(match: Match) -> list[Block]:
    judged = sorted(match.judged, key=lambda j: (j.test.entry, -_worst(j)))
    if not judged:
        return []
    rows = []
    for j in judged[:_MOST_ROWS]:
        said = "; ".join(_row_words(r) for r in j.rows)
        segment = f"{j.segment.flight}, {j.segment.manoeuvre}, {j.segment.time_s[0]:.1f} s"
        rows.append((j.test.entry, segment, said, Cell(j.answer, _LEVELS[j.answer], small=j.why)))
    caption = "Segments by test, the largest difference over its tolerance first: greatest difference / tolerance at that time."
    if len(judged) > _MOST_ROWS:
        caption += f" {_MOST_ROWS} of {len(judged)} segments; dossier --json has all."
    return [Table(caption, ("Test", "Segment", "Greatest difference", "Answer"), tuple(rows))]


def _worst(judged: Judged) -> float:
    known = [r.ratio for r in judged.rows if math.isfinite(r.ratio)]
    return max(known, default=math.inf)


def _row_words(row: Row) -> str:
    quantity, unit, factor = shown_channel(row.quantity)
    unit = "" if unit == "-" else f" {unit}"
    if math.isfinite(row.measured):
        values = f"measured {shown(factor * row.measured)}, model {shown(factor * row.model)}"
        return f"{quantity} {values}, tolerance {shown(factor * row.band)}{unit}: {row.answer}"
    share = "" if row.share == 1.0 else f", {100.0 * row.share:.1f} % inside"
    return f"{quantity} {shown(factor * abs(row.worst))} / {shown(factor * row.band)}{unit}{share}"


def _figures(source: Compared) -> tuple[Figure, ...]:
    out = []
    for test in TESTS:
        found = source.match.of(test.entry)
        if not found:
            continue
        worst = max(found, key=_worst)
        bands: list[tuple[str, Tolerance | None]] = [(b.channel, b) for b in test.bands]
        if test.oscillation is not None:
            bands = [(test.oscillation.channel, None)]
        for channel, band in bands:
            if (
                channel in worst.segment.columns
                and f"{channel}{source.suffix}" in worst.segment.columns
            ):
                out += _drawn(worst, channel, band, source.suffix, len(found))
    return tuple(out)


def _drawn(
    judged: Judged, channel: str, band: Tolerance | None, suffix: str, of: int
) -> list[Figure]:
    """Measured and model with the tolerance; beside it their difference, on which the tolerance is large enough to be seen."""
    segment = judged.segment
    quantity, unit, factor = shown_channel(channel)
    measured, model = (factor * segment.columns[c] for c in (channel, f"{channel}{suffix}"))
    name = f"match-{judged.test.entry.replace('.', '-')}-{channel}"
    label = f"{judged.test.entry} {judged.test.title}: {quantity} [{unit}] against time, measured and model, {segment.title}."
    which = f"the worst of {of} segments" if of > 1 else "the only segment"
    caption = f"{judged.test.entry}, {quantity}: {segment.manoeuvre}, {which}"
    if band is None:
        return [
            _chart(
                name,
                label,
                segment,
                [("dot", measured), ("first", model)],
                None,
                axis_label(channel),
                caption,
            )
        ]
    half = factor * limits(band, segment.columns[channel])
    row = next((r for r in judged.rows if r.quantity == channel), None)
    share = (
        "" if row is None else f"; {100.0 * row.share:.1f} % of the samples within the tolerance"
    )
    both: list[tuple[str, FloatArray]] = [("dot", measured), ("first", model)]
    gap = f"{quantity} measured minus model [{unit}]"
    return [
        _chart(
            name,
            label,
            segment,
            both,
            (measured - half, measured + half),
            axis_label(channel),
            caption,
        ),
        _chart(
            f"{name}-gap",
            f"{judged.test.entry}: {gap}, {segment.title}.",
            segment,
            [("dot", measured - model)],
            (-half, half),
            gap,
            f"The same, measured minus model{share}",
        ),
    ]


def _chart(
    name: str,
    label: str,
    segment: History,
    series: Sequence[tuple[str, FloatArray]],
    band: tuple[FloatArray, FloatArray] | None,
    axis: str,
    caption: str,
) -> Figure:
    t = segment.time_s
    seen = [*(y for _, y in series), *(band or ())]
    chart = Chart(
        name,
        label,
        Scale("time of the log [s]", float(t[0]), float(t[-1])),
        scale(axis, seen),
        height=160,
    )
    if band is not None:
        chart.band(t, *band, "fill1")
    for kind, y in series:
        if kind == "dot":
            few = np.unique(np.linspace(0, y.size - 1, min(y.size, _MOST_DOTS)).round().astype(int))
            chart.dots(t[few], y[few], kind)
        else:
            chart.line(t, y, kind)
    if band is not None and len(series) == 1:
        # Few samples are drawn, but none that lies outside is left out.
        out = (series[0][1] < band[0]) | (series[0][1] > band[1])
        chart.dots(t[out], series[0][1][out], "dotout", radius=1.6)
    return Figure(name, chart.svg(), caption)
