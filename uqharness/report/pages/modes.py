"""Build the page of an aircraft's modes: eigenvalues, Levels of MIL-F-8785C, root locus over
airspeed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from uqharness.flight import (
    OSCILLATORY,
    Assessment,
    Locus,
    LocusPoint,
    cap_limits,
    level_edges,
    root_limits,
)
from uqharness.report.parts import (
    Block,
    Cell,
    Facts,
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
from uqharness.report.svg import Chart, Scale, log_scale, scale

NAMES = {
    "short_period": "short period",
    "phugoid": "phugoid",
    "third": "third mode",
    "dutch_roll": "Dutch roll",
    "roll": "roll",
    "spiral": "spiral",
    "other": "coupled roll-spiral",
}
_PARAGRAPHS = {
    "phugoid": "3.2.1.2",
    "dutch_roll": "3.3.1.1",
    "roll": "3.3.1.2",
    "spiral": "3.3.1.3",
}
"""Paragraphs of MIL-F-8785C by mode."""
_LEVELS: Mapping[int, Level] = {1: "good", 2: "warn", 3: "warn", 4: "bad"}
_EDGES = ("level1", "level2", "level3")
_TALL = 250


@dataclass(frozen=True)
class ModesFacts:
    """The analysis: aircraft, flight-phase category, class, trim and command line."""

    aircraft: str
    category: str
    aircraft_class: str
    trim: tuple[tuple[str, str], ...]
    command: str


def modes_page(request: ModesFacts, point: LocusPoint, locus: Locus) -> Page:
    """Return the page of the modes at one speed.

    Parameters
    ----------
    request : ModesFacts
        What was analysed.
    point : LocusPoint
        Modes at the requested speed.
    locus : Locus
        Root locus over airspeed; it contains ``point``.
    """
    category_text = f"category {request.category}, class {request.aircraft_class}"
    question = (
        f"Which Levels of MIL-F-8785C do the modes of {request.aircraft} reach ({category_text}),"
        " and how do they move with airspeed?"
    )
    sections = [
        _eigenvalues(point),
        _maps(request, point, locus),
        _by_speed(locus),
        *_refused(locus),
    ]
    sections.append(Section("Trim", (Facts(request.trim),)))
    text = (
        "Actuators are outside the linear model, and thrust follows its map at fixed throttle."
        " MIL-F-8785C was written for piloted aircraft; for a small unmanned one its Levels are a"
        " yardstick, not a requirement."
    )
    sections.append(Section("Assumptions", (Words(text),)))
    title = f"Modes of {request.aircraft} at {point.V_mps:g} m/s"
    return Page(
        title,
        question,
        _verdict(request, point, locus),
        (*sections, provenance(("Command", request.command))),
    )


def _verdict(request: ModesFacts, point: LocusPoint, locus: Locus) -> tuple[Sentence, ...]:
    """Return the Levels reached at the requested speed, and the range of trimmed speeds."""
    # The worst Level of any mode decides.
    worst = max(a.level for a in point.levels)
    reached = "a mode is worse than Level 3" if worst == 4 else f"all modes reach Level {worst}"
    or_better = " or better" if 1 < worst < 4 else ""
    sentences = [Sentence(f"At {point.V_mps:g} m/s {reached}{or_better}.", _LEVELS[worst])]
    # Criteria of each mode with their Levels.
    for mode, name in NAMES.items():
        assessments = [a for a in point.levels if a.mode == mode]
        if not assessments:
            continue
        criteria_text = "; ".join(
            f"{criterion_words(a)}, {_level_words(a.level)}" for a in assessments
        )
        sentences.append(
            Sentence(
                f"{name[0].upper()}{name[1:]}: {criteria_text}.",
                _LEVELS[max(a.level for a in assessments)],
            )
        )
    speeds = [p.V_mps for p in locus.points]
    text = f"Trimmed at {len(speeds)} speeds from {speeds[0]:.4g} to {speeds[-1]:.4g} m/s"
    lacking = (
        f"; {len(locus.refused)} further speeds have no trim, or were not tried."
        if locus.refused
        else "."
    )
    return (*sentences, Sentence(text + lacking))


def criterion_words(assessment: Assessment) -> str:
    """Return a criterion with its value and unit."""
    if math.isinf(assessment.value):
        return "stable"
    if math.isnan(assessment.value):
        return f"{assessment.criterion} undefined"
    return (
        f"{assessment.criterion} {assessment.value:.3g}"
        f" {'' if assessment.unit == '1' else assessment.unit}".rstrip()
    )


def _level_words(level: int) -> str:
    """Return a Level as text; 4 means worse than Level 3."""
    return "worse than Level 3" if level == 4 else f"Level {level}"


def _eigenvalues(point: LocusPoint) -> Section:
    """Return the table of eigenvalues."""
    rows = []
    for m in point.modes:
        # Undamped or real roots have no finite period.
        period = 2.0 * math.pi / m.imag if m.imag else math.inf
        # Time to half the amplitude, or to twice of it where the mode grows.
        time = math.log(2.0) / abs(m.real) if m.real else math.inf
        end = "doubles" if m.real > 0.0 else "halves"
        rows.append(
            (
                NAMES[m.name],
                f"{m.real:.4f}",
                f"{m.imag:.4f}",
                f"{m.wn_radps:.4f}",
                format_value(m.zeta, ".3f"),
                format_value(period, ".3g") if m.imag else "none",
                f"{end} in {format_value(time, '.3g')} s" if m.real else "neither",
            )
        )
    head = (
        "Mode",
        "Real [1/s]",
        "Imaginary [rad/s]",
        "Natural frequency [rad/s]",
        "Damping [-]",
        "Period [s]",
        "Amplitude",
    )
    return Section(
        "Eigenvalues", (Table(f"Eigenvalues at {point.V_mps:g} m/s.", head, tuple(rows), key=True),)
    )


def _maps(request: ModesFacts, point: LocusPoint, locus: Locus) -> Section:
    """Return the charts of the root locus."""
    figures = [_all(point, locus), *_cap(request, point, locus)]
    mode_names = {m.name for p in locus.points for m in p.modes}
    figures += [_pair(mode, request, point, locus) for mode in OSCILLATORY if mode in mode_names]
    figures += [
        _root(mode, request, point, locus) for mode in ("roll", "spiral") if mode in mode_names
    ]
    text = (
        "Each line joins the roots of one mode by rising speed, a dot at each speed. Areas and"
        " limits are those of the category and class above; of two real roots in place of a pair"
        " both are drawn."
    )
    return Section(
        "Root locus over airspeed",
        (Words(text, note=True), Figures(tuple(figures), file="root-locus")),
    )


def _branches(locus: Locus, mode: str) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Return speed, real and imaginary part of each root of a mode along the speeds; NaN where
    absent.
    """
    mode_roots = [
        sorted((m for m in p.modes if m.name == mode), key=lambda m: m.real) for p in locus.points
    ]
    speeds = np.array([p.V_mps for p in locus.points])
    out = []
    for k in range(max(map(len, mode_roots), default=0)):
        values = [
            (f[k].real, f[k].imag) if k < len(f) else (math.nan, math.nan) for f in mode_roots
        ]
        out.append((speeds, np.array([v[0] for v in values]), np.array([v[1] for v in values])))
    return out


def _ends(
    chart: Chart,
    point: LocusPoint,
    locus: Locus,
    place: Mapping[float, Sequence[tuple[float, float]]],
) -> None:
    """Mark the slowest, fastest and requested speed; ``place`` holds the roots by speed."""
    # Ring: slowest, square: fastest, disc: requested speed.
    slow, fast = locus.points[0].V_mps, locus.points[-1].V_mps
    for V, shape, kind, words in (
        (slow, "ring", "first", f"{slow:.4g} m/s"),
        (fast, "square", "first", f"{fast:.4g} m/s"),
        (point.V_mps, "disc", "second", f"{point.V_mps:.4g} m/s"),
    ):
        if point.V_mps == V and shape != "disc":
            continue
        for x, y in place.get(V, ()):
            chart.marker(x, y, kind, shape, words)


def _roots(locus: Locus, mode: str) -> dict[float, list[tuple[float, float]]]:
    """Return the roots of a mode by speed."""
    return {p.V_mps: [(m.real, m.imag) for m in p.modes if m.name == mode] for p in locus.points}


def _plane(
    name: str, label: str, roots: Sequence[tuple[float, float]], height: int = _TALL
) -> Chart:
    """Return a chart of the upper half plane that contains the roots and the origin."""
    # The origin belongs to the picture.
    real, imag = (np.array([r[k] for r in roots]) for k in (0, 1))
    x = scale("real part [1/s]", [real, np.zeros(1)], margin=0.12)
    top = 1.15 * max(float(imag.max()), 1e-3)
    return Chart(name, label, x, Scale("imaginary part [rad/s]", -0.04 * top, top), height)


def _all(point: LocusPoint, locus: Locus) -> Figure:
    """Draw all modes in the complex plane."""
    roots = [root for mode in NAMES for pairs in _roots(locus, mode).values() for root in pairs]
    eigenvalue_text = ", ".join(
        f"{NAMES[m.name]} {m.real:.3g} + {m.imag:.3g}i" for m in point.modes
    )
    chart = _plane(
        "locus-all",
        "Eigenvalues in the complex plane, real [1/s] and imaginary part [rad/s]:"
        f" {eigenvalue_text}.",
        roots,
    )
    chart.upright(0.0, "zero")
    for mode in NAMES:
        for _, real, imag in _branches(locus, mode):
            chart.line(real, imag, "first thin")
            chart.dots(real, imag, "dotfirst")
    for m in point.modes:
        chart.marker(m.real, m.imag, "second", "disc", f"{point.V_mps:.4g} m/s")
    for mode, (x, y), shift, anchor in _labels(chart, point):
        chart.text(x, y, NAMES[mode], anchor, shift)
    return Figure(
        chart.name,
        chart.svg(),
        f"All modes, upper half of the complex plane; at {point.V_mps:g} m/s named.",
    )


def _labels(
    chart: Chart, point: LocusPoint
) -> list[tuple[str, tuple[float, float], tuple[float, float], str]]:
    """Place the names of modes next to their markers, inside the frame and without overlap."""
    x_left, top, width, height = chart.plot
    occupied: list[tuple[float, float, float, float]] = []
    out: list[tuple[str, tuple[float, float], tuple[float, float], str]] = []
    # Place labels from top to bottom; try positions until one is free.
    for m in sorted(point.modes, key=lambda m: -m.imag):
        if any(mode == m.name for mode, *_ in out):
            continue
        (u,), (v,) = (np.atleast_1d(w) for w in chart.at(m.real, m.imag))
        # Approximate width of the label.
        wide = 6.2 * len(NAMES[m.name])
        sides = ((6.0, "start"), (-6.0, "end"), (0.0, "middle"))
        for dx, dy, anchor in [
            (dx, dy, a) for dy in (-7.0, 14.0, -20.0, -33.0, -46.0) for dx, a in sides
        ]:
            x0 = u + dx - {"start": 0.0, "end": wide, "middle": 0.5 * wide}[anchor]
            box = (x0, v + dy - 10.0, x0 + wide, v + dy + 2.0)
            # No overlap with labels placed before.
            free = all(
                box[2] < t[0] or box[0] > t[2] or box[3] < t[1] or box[1] > t[3] for t in occupied
            )
            if (
                free
                and box[0] >= x_left
                and box[2] <= x_left + width
                and box[1] >= top
                and box[3] <= top + height
            ):
                occupied.append(box)
                out.append((m.name, (m.real, m.imag), (dx, dy), anchor))
                break
    return out


def _pair(mode: str, request: ModesFacts, point: LocusPoint, locus: Locus) -> Figure:
    """Draw the root locus of an oscillatory mode with the limits of the Levels."""
    place = _roots(locus, mode)
    roots = [root for pairs in place.values() for root in pairs]
    criteria = ", ".join(
        f"{a.criterion} {format_value(a.value)}" for a in point.levels if a.mode == mode
    )
    label = (
        f"Root locus of the {NAMES[mode]}, real [1/s] and imaginary part [rad/s]; at"
        f" {point.V_mps:g} m/s {criteria}."
    )
    chart = _plane(f"locus-{mode}", label, roots)
    imag = np.linspace(0.0, chart.y.high, 121)
    # Limits of Levels 1 to 3 as real part over imaginary part.
    edges = level_edges(mode, request.category, request.aircraft_class, imag)
    inside = np.clip(edges[0], chart.x.low, None)
    outline = (
        np.concatenate([[chart.x.low], inside, [chart.x.low]]),
        np.concatenate([[0.0], imag, [chart.y.high]]),
    )
    chart.area(*outline, "fillgood", "Level 1")
    chart.upright(0.0, "zero")
    for k, (edge, kind) in enumerate(zip(edges, _EDGES, strict=True), start=1):
        chart.path(edge, imag, kind, f"limit of Level {k}" if k > 1 else "")
    for _, real, up in _branches(locus, mode):
        chart.line(real, up, "first")
        chart.dots(real, up, "dotfirst", radius=2.0)
    _ends(chart, point, locus, place)
    basis = (
        "damping alone; CAP has its own figure"
        if mode == "short_period"
        else "MIL-F-8785C " + _PARAGRAPHS[mode]
    )
    return Figure(
        chart.name, chart.svg(), f"{NAMES[mode][0].upper()}{NAMES[mode][1:]}: Levels by {basis}."
    )


def _cap(request: ModesFacts, point: LocusPoint, locus: Locus) -> list[Figure]:
    """Draw natural frequency over n/alpha with lines of equal CAP (figures 1 to 3 of the
    specification).

    Empty if CAP is undefined at all speeds, as for a statically unstable aircraft.
    """
    place: dict[float, list[tuple[float, float]]] = {}
    for p in locus.points:
        # CAP = natural frequency squared over n/alpha.
        cap = next((a.value for a in p.levels if a.criterion == "CAP"), math.nan)
        if math.isfinite(cap) and cap > 0.0 and p.n_alpha > 0.0:
            place[p.V_mps] = [(p.n_alpha, math.sqrt(cap * p.n_alpha))]
    if not place:
        return []
    n, wn = (np.array([roots[0][k] for roots in place.values()]) for k in (0, 1))
    (one_low, one_high), (two_low, two_high) = cap_limits(request.category)
    x = log_scale("n/alpha [g/rad]", [n], margin=0.25)
    ends = np.array([x.low, x.high])
    # Limits of CAP are parallel lines in logarithmic axes.
    lines = [
        (two_low, "level2", 2),
        (two_high, "level2", 2),
        (one_low, "level1", 1),
        (one_high, "level1", 1),
    ]
    y = log_scale(
        "short-period natural frequency [rad/s]", [wn, *(np.sqrt(cap * n) for cap, _, _ in lines)]
    )
    cap_text = ", ".join(
        f"CAP {format_value(a.value)}" for a in point.levels if a.criterion == "CAP"
    )
    chart = Chart(
        "locus-cap",
        f"Natural frequency of the short period [rad/s] over n/alpha [g/rad]; at {point.V_mps:g}"
        f" m/s {cap_text}.",
        x,
        y,
        _TALL,
    )
    low, high = np.sqrt(one_low * ends), np.sqrt(one_high * ends)
    chart.band(ends, low, high, "fillgood", "Level 1")
    for cap, kind, level in lines:
        chart.path(ends, np.sqrt(cap * ends), kind, f"limits of Level {level}" if level > 1 else "")
    chart.line(n, wn, "first")
    chart.dots(n, wn, "dotfirst", radius=2.0)
    _ends(chart, point, locus, place)
    caption = (
        f"Control anticipation parameter: Level 1 from {one_low:g} to {one_high:g}, Level 2 from"
        f" {two_low:g} to {two_high:g} 1/(g s²), MIL-F-8785C 3.2.2.1.1."
    )
    return [Figure(chart.name, chart.svg(), caption)]


def _root(mode: str, request: ModesFacts, point: LocusPoint, locus: Locus) -> Figure:
    """Draw a real root over airspeed with the limits of the Levels."""
    # Limits of the Levels as real roots.
    limits = root_limits(mode, request.category, request.aircraft_class)
    branches = _branches(locus, mode)
    speeds, values = np.array([p.V_mps for p in locus.points]), [real for _, real, _ in branches]
    y = scale(f"real root of {mode} [1/s]", [*values, np.zeros(1), np.array(limits)], margin=0.1)
    x = scale("true airspeed [m/s]", [speeds], margin=0.04)
    criteria_text = ", ".join(criterion_words(a) for a in point.levels if a.mode == mode)
    chart = Chart(
        f"locus-{mode}",
        f"Real root of the {mode} mode [1/s] over airspeed [m/s]; at {point.V_mps:g} m/s"
        f" {criteria_text}.",
        x,
        y,
        220,
    )
    ends = np.array([x.low, x.high])
    chart.band(ends, np.full(2, y.low), np.full(2, limits[0]), "fillgood", "Level 1")
    chart.level(0.0, "zero")
    for k, (limit, kind) in enumerate(zip(limits, _EDGES, strict=True), start=1):
        chart.level(limit, kind, f"limit of Level {k}" if k > 1 else "")
    for real in values:
        chart.line(speeds, real, "first")
        chart.dots(speeds, real, "dotfirst", radius=2.0)
    for m in point.modes:
        if m.name == mode:
            chart.marker(point.V_mps, m.real, "second", "disc", f"{point.V_mps:.4g} m/s")
    criterion = (
        "time constant, -1/root" if mode == "roll" else "time to double amplitude, ln 2/root"
    )
    return Figure(
        chart.name,
        chart.svg(),
        f"{mode.capitalize()}: Levels by {criterion}, MIL-F-8785C {_PARAGRAPHS[mode]}.",
    )


def _by_speed(locus: Locus) -> Section:
    """Return the table of criteria and Levels by airspeed."""
    units = {
        (a.mode, a.criterion): "-" if a.unit == "1" else a.unit
        for p in locus.points
        for a in p.levels
    }
    # Columns in the order of the modes.
    keys = sorted(units, key=lambda key: list(NAMES).index(key[0]))
    rows: list[tuple[str | Cell, ...]] = []
    for p in locus.points:
        assessments = {(a.mode, a.criterion): a for a in p.levels}
        rows.append(
            (
                f"{p.V_mps:.4g}",
                *(
                    _cell(assessments[key]) if key in assessments else Cell("no such mode")
                    for key in keys
                ),
            )
        )
    head = (
        "Speed [m/s]",
        *(f"{NAMES[m][0].upper()}{NAMES[m][1:]}, {c} [{units[m, c]}]" for m, c in keys),
    )
    return Section(
        "Levels by airspeed", (Table("Criteria and Levels by true airspeed.", head, tuple(rows)),)
    )


def _cell(assessment: Assessment) -> Cell:
    """Return a criterion with its Level."""
    text = "stable" if math.isinf(assessment.value) else format_value(assessment.value)
    return Cell(text, _LEVELS[assessment.level], small=_level_words(assessment.level))


def _refused(locus: Locus) -> tuple[Section, ...]:
    """Return the speeds without a trim; empty if there are none."""
    if not locus.refused:
        return ()
    rows = tuple((f"{V:.4g}", reason) for V, reason in locus.refused)
    blocks: tuple[Block, ...] = (Table("Speeds without a trim.", ("Speed [m/s]", "Reason"), rows),)
    return (Section("Speeds without a trim", blocks),)
