"""Usual slips in sources of derivatives: axes, signs, units, references, surfaces.

Each check compares numbers of the file with each other or with slender-wing and tail-volume
formulas of conventional aeroplanes, and says which line, what is expected, and what the slip would
do to the flight. Bands are wide: a check speaks where a number is off by its sign, by a factor of
57.3, by a wrong reference or a wrong surface. Tailless aeroplanes lie within them too.

References: B. Etkin, L. D. Reid, Dynamics of Flight, 3rd ed., chapters 2, 3 and 5; Helmbold's
formula of the lift slope.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from uqharness.authoring import vspaero
from uqharness.authoring.avl_input import Geometry, Masses
from uqharness.authoring.model import AeroModel, control_weights, controls_of
from uqharness.authoring.read import Sources
from uqharness.authoring.source import (
    STABILITY,
    TOTAL,
    Entry,
    Point,
    Source,
    rotate_forces,
)
from uqharness.authoring.xflr5 import inconsistent_pairs, is_xflr5

_DEGREES = math.degrees(1.0)


@dataclass(frozen=True)
class Slip:
    """A finding: kind, file and line, what was received and is expected, and its effect."""

    kind: str
    place: str
    message: str
    effect: str

    def __str__(self) -> str:
        return f"{self.place}: {self.kind}: {self.message}. {self.effect}"


def find_slips(
    sources: Sources, controls: Mapping[str, Mapping[str, float]] | None = None
) -> list[Slip]:
    """Return the slips of a set of files, each once, in order of the line.

    Parameters
    ----------
    sources : Sources
        As `read_sources` returns them.
    controls : mapping, optional
        Surfaces of the controls where they are stated, as for `control_weights`.

    Returns
    -------
    list of Slip
        Empty for clean files.
    """
    source = sources.derivatives
    parts = sources.parts or (source,)
    out: list[Slip] = []
    for part in parts:
        text = sources.texts.get(part.path, "")
        certain = _certain_lengths(part.path, text) if vspaero.is_stab(text) else set()
        out += _references(part, sources.geometry, sources.masses, certain)
        for point in part.points:
            if len(part.points) == 1 or abs(point.alpha.value) < math.radians(8.0):
                out += _point(part, _stability(point))
    out += _surfaces(source, sources.geometry, controls)
    out += _alphas(source)
    for path, text in sources.texts.items():
        if vspaero.is_stab(text):
            out += _stab_cases(path, text)
        elif is_xflr5(text):
            out += [
                _slip(
                    entry,
                    "reference length",
                    f"{entry.value:.4g}: the dimensional derivative is {ratio:.4g} times it, but"
                    f" {expected:.4g} times by the reference lengths of the others",
                    "One of the two numbers, or its sign, is not the program's",
                )
                for entry, ratio, expected in inconsistent_pairs(path, text)
            ]
    if sources.geometry is not None:
        out += _geometry(sources.geometry)
        if source.path == sources.geometry.path:
            out += _airfoils(sources.geometry)
    if sources.masses is not None:
        out += _masses(sources.masses, source)
    elif "mass_kg" in source.facts:
        inertia = [source.facts[key] for key in ("Ixx", "Iyy", "Izz") if key in source.facts]
        out += mass_slips(source, source.facts["mass_kg"], inertia if len(inertia) == 3 else [])
    unique_slips = {(slip.kind, slip.place): slip for slip in reversed(out)}
    return sorted(
        unique_slips.values(), key=lambda slip: (slip.place.rpartition(":")[0], _line(slip))
    )


def _line(slip: Slip) -> int:
    """Return the line of a finding, 0 without one."""
    word = slip.place.rpartition(":")[2]
    return int(word) if word.isdigit() else 0


def _stability(point: Point) -> Point:
    """Return a point with lift and drag; moments stay in the file's axes."""
    if point.axes == "stability":
        return point
    alpha = point.alpha.value
    sine, cosine = math.sin(alpha), math.cos(alpha)
    entries = dict(point.entries)
    for variable in {variable for _, variable in point.entries}:
        cx, cz = point.value("CX", variable), point.value("CZ", variable)
        lift, drag = cx * sine - cz * cosine, -cx * cosine - cz * sine
        if variable == "alpha":
            cx0, cz0 = point.value("CX", TOTAL), point.value("CZ", TOTAL)
            lift += cx0 * cosine + cz0 * sine
            drag += cx0 * sine - cz0 * cosine
        line = entries.get(("CZ", variable)) or entries.get(("CX", variable))
        if line is not None:
            entries["CL", variable] = Entry(lift, line.path, line.line)
            entries["CD", variable] = Entry(drag, line.path, line.line)
    return replace(point, axes="stability", entries=entries)


def _slip(entry: Entry, kind: str, message: str, effect: str) -> Slip:
    """Return a finding at an entry."""
    return Slip(kind, entry.place, message, effect)


def _in_line(entry: Entry) -> str:
    """Return the line of a number that may be the wrong one as well."""
    return f" (line {entry.line})" if entry.line else ""


def _unit_remark(ratio: float) -> str:
    """Return what a factor of about 57.3 means."""
    if 30.0 < ratio < 110.0:
        return "; 57.3 times as much: per radian read as per degree"
    if 1.0 / 110.0 < ratio < 1.0 / 30.0:
        return "; 57.3 times less: per degree read as per radian"
    return ""


def _references(
    source: Source, geometry: Geometry | None, masses: Masses | None, certain: set[str]
) -> Iterator[Slip]:
    """Check reference lengths and area among each other, with the geometry and the CG.

    ``certain`` are lengths that other numbers of the file confirm.
    """
    reference = source.reference
    if not all(key in reference and reference[key].value > 1e-6 for key in "Sbc"):
        return
    area, span, chord = (reference[key].value for key in "Sbc")
    aspect_ratio = span**2 / area
    mean = area / span
    effect = "Every moment and rate derivative is scaled by it"
    ratio = chord / mean
    # Geometrically at least 1; some authors take the chord of the panels outside the body.
    if not 0.85 <= ratio <= 1.45:
        key = _wrong_reference(source, ratio / 1.05, certain)
        expected = {"S": area * ratio, "b": span / ratio, "c": mean}[key]
        names = {"c": "chord", "S": "area", "b": "span"}
        yield _slip(
            reference[key],
            "reference area" if key == "S" else "reference length",
            f"{names[key]} {reference[key].value:.4g}: the mean chord S/b is {mean:.4g} with a"
            f" chord of {chord:.4g} and an aspect ratio of {aspect_ratio:.3g}; {names[key]} of"
            f" about {expected:.4g} is expected",
            effect,
        )
    elif not 2.0 <= aspect_ratio <= 45.0:
        yield _slip(
            reference["b"],
            "reference length",
            f"span {span:.4g} with area {area:.4g} gives aspect ratio {aspect_ratio:.3g}; 2 to 45"
            " is expected",
            effect,
        )
    margin = source.facts.get("x_np")
    entries = source.points[0].entries if source.points else {}
    lift, pitch = entries.get(("CL", "alpha")), entries.get(("Cm", "alpha"))
    if (
        margin is not None
        and lift is not None
        and pitch is not None
        and "x" in reference
        and lift.value > 0.5
    ):
        expected = -lift.value * (margin.value - reference["x"].value) / chord
        if abs(pitch.value - expected) > 0.05 * abs(expected) + 0.02 * lift.value:
            opposite = abs(pitch.value + expected) < 0.1 * abs(expected) + 0.02
            ratio = pitch.value / expected if expected else 0.0
            entry = pitch if opposite or _unit_remark(ratio) else reference["x"]
            yield _slip(
                entry,
                "sign" if opposite else "moment centre",
                f"Cm_alpha {pitch.value:.4g} with CL_alpha {lift.value:.4g} puts the neutral point"
                f" at x = {reference['x'].value - pitch.value / lift.value * chord:.4g}; the file"
                f" says {margin.value:.4g}{_in_line(margin)}, which needs Cm_alpha {expected:.4g}"
                f" about x = {reference['x'].value:.4g}" + _unit_remark(ratio),
                "The static margin is wrong: the aeroplane may diverge in pitch",
            )
    if masses is not None:
        distance = masses.centre_m[0] - (reference["x"].value if "x" in reference else 0.0)
        # A moment centre at the origin is a datum on purpose.
        at_datum = all(reference[key].value == 0.0 for key in "xyz" if key in reference)
        if "x" in reference and not at_datum and abs(distance) > 0.5 * chord:
            yield _slip(
                reference["x"],
                "moment centre",
                f"moments are about x = {reference['x'].value:.4g} m, {abs(distance) / chord:.2g}"
                f" chords from the centre of gravity at {masses.centre_m[0]:.4g} m",
                "They are moved to the centre of gravity; where one of the two is wrong, the"
                " aeroplane is stable or unstable by that much",
            )
        # A .stab states its centre of gravity, which `author` takes where the two differ.
        if margin is not None and source.tool != "VSPAERO":
            stability = (margin.value - masses.centre_m[0]) / chord
            if not -0.1 <= stability <= 1.0:
                yield _slip(
                    masses.mass_kg,
                    "moment centre",
                    f"the centre of gravity at x = {masses.centre_m[0]:.4g} m is"
                    f" {abs(stability):.3g} chords {_side(stability)} the neutral point at"
                    f" {margin.value:.4g} m; 0 to 0.4 ahead is expected: check Lunit, the items' x"
                    " and the file's origin",
                    "The aeroplane diverges in pitch, or the elevator cannot trim it",
                )
    if geometry is not None:
        yield from _reference_of_geometry(source, geometry)


def _wrong_reference(source: Source, factor: float, certain: set[str]) -> str:
    """Return which of S, b and c is wrong where c is ``factor`` times what S and b give.

    A correction of one changes the aspect ratio: that of the induced drag where the file has it,
    else of the lift slope, to which a tail adds some 5 %, is the true one.
    """
    aspect_ratio = source.length("b") ** 2 / source.length("S")
    corrected = {
        "c": aspect_ratio,
        "S": aspect_ratio / factor,
        "b": aspect_ratio / factor**2,
    }
    uncertain = {key: value for key, value in corrected.items() if key not in certain} or corrected
    plausible = {k: value for k, value in uncertain.items() if 1.5 <= value <= 50.0} or uncertain
    true = _induced_aspect_ratio(source)
    if true is not None:
        return min(plausible, key=lambda key: abs(math.log(plausible[key] / true)))
    point = source.points[0] if source.points else None
    slope = 0.0 if point is None else point.value("CL", "alpha") - point.value("CZ", "alpha")
    if slope <= 0.0:
        return next(iter(plausible))
    return min(plausible, key=lambda key: abs(math.log(slope / (1.05 * _helmbold(plausible[key])))))


def _induced_aspect_ratio(source: Source) -> float | None:
    """Return the aspect ratio of the induced drag and the span efficiency beside it."""
    facts = source.facts
    drag, lift = facts.get("CDff"), facts.get("CLff") or facts.get("CL")
    efficiency = facts.get("e")
    if drag is None or lift is None or efficiency is None or abs(lift.value) < 0.05:
        return None
    if not (drag.value > 1e-5 and efficiency.value > 0.0):
        return None
    return lift.value**2 / (math.pi * efficiency.value * drag.value)


def _reference_of_geometry(source: Source, geometry: Geometry) -> Iterator[Slip]:
    """Compare the reference values with the wing of the geometry."""
    wings = geometry.wings()
    area = sum(wing.area() for wing in wings)
    points = np.vstack([wing.points() for wing in wings])
    span = 2.0 * float(np.max(np.abs(points[:, 1])))
    chord = wings[0].mean_chord()
    effect = "Every coefficient is scaled by it, so lift, damping and speed are wrong"
    # A wing that begins at the fuselage's side has its reference area through the fuselage.
    inner = int(np.argmin(np.abs(points[:, 1])))
    carry_over = (
        2.0 * float(abs(points[inner, 1]) * points[inner, 3]) if wings[0].duplicated else 0.0
    )
    for key, value, largest, name in (
        ("S", area, area + carry_over, "area"),
        ("b", span, span, "span"),
        ("c", chord, chord, "chord"),
    ):
        entry = geometry.reference[key]
        if not 0.85 * value <= entry.value <= 1.18 * largest:
            yield _slip(
                entry,
                "reference area" if key == "S" else "reference length",
                f"{name} {entry.value:.4g}; the surface {wings[0].name} has {value:.4g}",
                effect,
            )


def _helmbold(aspect_ratio: float) -> float:
    """Return Helmbold's lift slope of a straight wing [1/rad]."""
    return 2.0 * math.pi * aspect_ratio / (2.0 + math.sqrt(4.0 + aspect_ratio**2))


def _point(source: Source, point: Point) -> Iterator[Slip]:
    """Check the derivatives of one point among each other."""
    area, span, chord = (source.length(key) for key in "Sbc")
    aspect_ratio = span**2 / area
    yield from _alpha_slip(source, point)
    yield from _longitudinal(source, point, aspect_ratio, chord)
    yield from _lateral(point, span, aspect_ratio)
    yield from _symmetry(point)


def _alpha_slip(source: Source, point: Point) -> Iterator[Slip]:
    """Check that lift, drag and the body forces of a point belong to its alpha."""
    facts = source.facts
    if {"CX", "CZ", "CL", "CD"} <= facts.keys() and len(source.points) == 1:
        cx, cz = rotate_forces(facts["CL"].value, facts["CD"].value, point.alpha.value)
        size = max(abs(facts["CL"].value), 0.1)
        if abs(facts["CZ"].value - cz) > 0.02 * size:
            culprit = facts["CZ"]
            expected_lift = -facts["CZ"].value * math.cos(point.alpha.value)
            if abs(expected_lift - facts["CL"].value) > 0.02 * size:
                ff = facts.get("CLff")
                if ff is not None and abs(ff.value - facts["CL"].value) > 0.1 * size:
                    culprit = facts["CL"]
            yield _slip(
                culprit,
                "axes",
                f"CZ {facts['CZ'].value:.4g}; CL {facts['CL'].value:.4g} and CD"
                f" {facts['CD'].value:.4g} at alpha {math.degrees(point.alpha.value):.4g} deg give"
                f" {cz:.4g} in body axes (z down)",
                "Lift acts downwards or along other axes",
            )
        elif abs(facts["CX"].value - cx) > (0.004 if point.beta == 0.0 else 0.02) * size:
            # CX = CL sin(alpha) - CD cos(alpha) shows a wrong alpha first.
            fitted = (facts["CX"].value + facts["CD"].value) / size
            # Reversed, the two agree to the digits printed; near zero they nearly do anyway.
            sign = abs(facts["CX"].value + cx) < 0.05 * abs(facts["CX"].value - cx)
            culprit = facts["CX"] if sign else point.alpha
            yield _slip(
                culprit,
                "axes" if sign else "deg/rad",
                f"CX {facts['CX'].value:.4g}; CL and CD give {cx:.4g} at alpha"
                f" {math.degrees(point.alpha.value):.4g} deg; alpha of"
                f" {math.degrees(math.asin(max(-1.0, min(1.0, fitted)))):.3g} deg would fit",
                "Drag and lift are turned by the wrong angle: thrust and glide are wrong",
            )
    drag = facts.get("CDind") or facts.get("CDff")
    if drag is not None and "CL" in facts and "e" in facts and facts["e"].value > 0.0:
        aspect_ratio = source.length("b") ** 2 / source.length("S")
        lift = facts["CLff"] if "CLff" in facts else facts["CL"]
        expected = lift.value**2 / (math.pi * aspect_ratio * facts["e"].value)
        trefftz = facts.get("CDff", drag)
        if abs(trefftz.value - expected) > 0.03 * expected + 2e-4:
            implied = lift.value**2 / (math.pi * aspect_ratio * max(trefftz.value, 1e-9))
            culprit = facts["e"]
            key = ""
            if 0.6 < facts["e"].value < 1.1:
                key = "S" if not _area_fits(source) else "b"
            if key:
                culprit = source.reference[key]
            yield _slip(
                culprit,
                "reference area" if key == "S" else "reference length" if key else "drag",
                f"induced drag {trefftz.value:.4g} at CL {lift.value:.4g} and e"
                f" {facts['e'].value:.4g} does not fit aspect ratio {aspect_ratio:.4g}:"
                f" {expected:.4g} is expected, or e = {implied:.3g}",
                "Glide ratio and climb are wrong",
            )


def _area_fits(source: Source) -> bool:
    """Return whether the reference area is that of span and chord."""
    ratio = source.length("c") * source.length("b") / source.length("S")
    return 0.93 <= ratio <= 1.2


def _longitudinal(
    source: Source, point: Point, aspect_ratio: float, chord: float
) -> Iterator[Slip]:
    """Check lift slope, pitch stiffness and damping."""
    lift, pitch = point.entries.get(("CL", "alpha")), point.entries.get(("Cm", "alpha"))
    if lift is None:
        return
    theory = _helmbold(aspect_ratio)
    ratio = lift.value / theory
    if not 0.6 <= ratio <= 1.6:
        kind = "sign" if ratio < 0.0 else "deg/rad" if _unit_remark(abs(ratio)) else "lift slope"
        yield _slip(
            lift,
            kind,
            f"CL_alpha {lift.value:.4g} per rad; a wing of aspect ratio {aspect_ratio:.3g} has"
            f" about {theory:.3g}" + _unit_remark(ratio),
            "The aeroplane needs the wrong alpha to carry its weight",
        )
        return
    yield from _polar(point, lift.value, aspect_ratio)
    if pitch is not None:
        margin = -pitch.value / lift.value
        if margin < -0.02 and source.facts.get("x_np") is None:
            centre = source.reference.get("x")
            about = "" if centre is None else f" about x = {centre.value:.4g}"
            yield _slip(
                pitch,
                "sign",
                f"Cm_alpha {pitch.value:.4g} per rad{about}: a static margin of"
                f" {100 * margin:.3g} % of the chord; below 0 is expected with the CG ahead of the"
                " neutral point",
                "The aeroplane diverges in pitch",
            )
        elif abs(margin) > 1.5:
            # No moment centre is four chords from the wing.
            kind = "deg/rad" if abs(margin) > 4.0 else "moment centre"
            yield _slip(
                pitch if kind == "deg/rad" else source.reference.get("x", pitch),
                kind,
                f"Cm_alpha {pitch.value:.4g} per rad is a static margin of {100 * margin:.4g} % of"
                " the chord; 0 to 60 % is expected" + _unit_remark(abs(margin) / 0.3),
                "The aeroplane is far too stiff in pitch, the elevator cannot trim it",
            )
    damping = point.entries.get(("Cm", "q"))
    if damping is not None:
        if damping.value > 0.0:
            yield _slip(
                damping,
                "sign",
                f"Cm_q {damping.value:.4g}; a value below 0 is expected (q nose up, Cm nose up)",
                "Pitch oscillations grow",
            )
        else:
            # Cm_q over CL_q is an arm of the tail in chords, less than the span.
            size = abs(point.value("CL", "q"))
            largest = max(90.0, size * aspect_ratio)
            if not max(0.3, 0.08 * size) <= -damping.value <= largest:
                yield _slip(
                    damping,
                    "deg/rad",
                    f"Cm_q {damping.value:.4g} per qc/2V; -0.3 to {-largest:.3g} is expected"
                    + _unit_remark(-damping.value / 10.0),
                    "Pitch damping is off by the same factor",
                )
    lift_q = point.entries.get(("CL", "q"))
    if lift_q is not None and not -6.0 <= lift_q.value <= 40.0:
        yield _slip(
            lift_q,
            "deg/rad" if lift_q.value > 0.0 else "sign",
            f"CL_q {lift_q.value:.4g} per qc/2V; 2 to 20 is expected",
            "Lift follows the pitch rate wrongly",
        )
    elif (
        # Quasi-steady lift acts at the three-quarter chord, the tail's behind it: CL_q is near
        # CL_alpha (1 + 2 static margin).
        lift_q is not None
        and lift_q.value < 0.0
        and damping is not None
        and (damping.value < -4.0 or lift_q.value < -2.0 * point.value("Cm", "alpha") - lift.value)
    ):
        yield _slip(
            lift_q,
            "sign",
            f"CL_q {lift_q.value:.4g} with Cm_q {damping.value:.4g}; a tail behind the CG gives a"
            " positive CL_q",
            "Lift falls with the pitch rate",
        )


def _polar(point: Point, lift_slope: float, aspect_ratio: float) -> Iterator[Slip]:
    """Check that drag and its slope leave a drag at zero lift: CD = CD_0 + k CL^2."""
    lift = point.value("CL", TOTAL)
    drag, slope = (point.entries.get(("CD", variable)) for variable in (TOTAL, "alpha"))
    if drag is None or slope is None or abs(lift) < 0.1:
        return
    curvature = slope.value / (2.0 * lift * lift_slope)
    least_drag = drag.value - curvature * lift**2
    if least_drag < -0.005:
        efficiency = 1.0 / (math.pi * aspect_ratio * curvature)
        yield _slip(
            slope,
            "drag",
            f"CD_alpha {slope.value:.4g} per rad with CD {drag.value:.4g} at CL {lift:.4g} gives a"
            f" drag of {least_drag:.3g} at zero lift and e = {efficiency:.2g}; above 0 and about"
            f" 0.8 are expected (CL_0 is the lift at zero alpha){_unit_remark(0.8 / efficiency)}",
            "Drag is negative at low lift: there is no trim",
        )


def _lateral(point: Point, span: float, aspect_ratio: float) -> Iterator[Slip]:
    """Check signs and sizes of the lateral derivatives."""

    def entry(name: str, variable: str) -> Entry | None:
        result = point.entries.get((name, variable))
        return result if result is not None and abs(result.value) > 1e-12 else None

    lift = max(point.value("CL", TOTAL), 0.0)
    # Dihedral tilts the lift of the wing that meets the wind: its part of Cn_beta is Cl_beta CL
    # over CL_alpha, against the fin's, which a large span at a high lift nearly cancels.
    slope = max(point.value("CL", "alpha"), 1.0)
    wing_yaw = min(point.value("Cl", "beta"), 0.0) * lift / slope
    side, yaw, roll = entry("CY", "beta"), entry("Cn", "beta"), entry("Cl", "beta")
    outlier = _fin_outlier(point, wing_yaw)
    if outlier is not None:
        name, ratio = outlier
        yield _slip(
            point.entries[name],
            "deg/rad" if _unit_remark(ratio) else "reference length",
            f"{'_'.join(name)} {point.entries[name].value:.4g} per rad is {ratio:.3g} times what"
            " the fin's side force and arm give, which the others of CY_beta, Cn_beta, CY_r and"
            " Cn_r share" + _unit_remark(ratio),
            "The dutch roll is wrong by that factor or its root",
        )
    if side is not None and side.value > 0.0:
        yield _slip(
            side,
            "sign",
            f"CY_beta {side.value:.4g} per rad; below 0 is expected (wind from the right pushes to"
            " the left)",
            "The aeroplane slides into its sideslip",
        )
    elif side is not None and not 0.005 <= -side.value <= 3.0:
        yield _slip(
            side,
            "deg/rad",
            f"CY_beta {side.value:.4g} per rad; -0.05 to -1.5 is expected"
            + _unit_remark(-side.value / 0.3),
            "Side force is off by the same factor",
        )
    if yaw is not None and yaw.value < 0.0:
        yield _slip(
            yaw,
            "sign",
            f"Cn_beta {yaw.value:.4g} per rad; above 0 is expected (the nose turns into the wind)",
            "The aeroplane swaps ends in a sideslip",
        )
    elif yaw is not None and not 0.002 <= yaw.value <= 0.6:
        yield _slip(
            yaw,
            "deg/rad",
            f"Cn_beta {yaw.value:.4g} per rad; 0.02 to 0.3 is expected"
            + _unit_remark(yaw.value / 0.08),
            "The dutch roll is too fast or too slow by the root of that factor",
        )
    elif outlier is None and yaw is not None and side is not None and side.value < 0.0:
        arm = -(yaw.value - wing_yaw) / side.value
        if not 0.02 <= arm <= 1.3:
            yield _slip(
                yaw,
                "reference length",
                f"Cn_beta over CY_beta puts the fin {arm:.3g} spans behind the moment centre; 0.1"
                " to 0.8 is expected",
                "Weathercock stability is off by that factor",
            )
    if roll is not None and roll.value > 0.03 + 0.25 * max(-point.value("CL", TOTAL), 0.0):
        yield _slip(
            roll,
            "sign",
            f"Cl_beta {roll.value:.4g} per rad; below 0 is expected with dihedral or sweep (wind"
            " from the right rolls to the left)",
            "The spiral diverges fast, and rudder rolls the wrong way",
        )
    elif roll is not None and roll.value < -0.6:
        yield _slip(
            roll,
            "deg/rad",
            f"Cl_beta {roll.value:.4g} per rad; -0.3 to 0 is expected"
            + _unit_remark(-roll.value / 0.08),
            "The dutch roll is dominated by roll",
        )
    damping = entry("Cl", "p")
    if damping is not None:
        # Strip theory: a rectangular wing's Cl_p is a sixth of its lift slope, a tapered one's an
        # eighth to a twelfth.
        theory = _helmbold(aspect_ratio) / 11.0
        if damping.value > 0.0:
            yield _slip(
                damping,
                "sign",
                f"Cl_p {damping.value:.4g}; below 0 is expected",
                "Roll diverges within a fraction of a second",
            )
        elif not 0.35 <= -damping.value / theory <= 2.2:
            yield _slip(
                damping,
                "deg/rad" if _unit_remark(-damping.value / theory) else "reference length",
                f"Cl_p {damping.value:.4g} per pb/2V; about {-theory:.2g} is expected for aspect"
                f" ratio {aspect_ratio:.3g}" + _unit_remark(-damping.value / theory),
                "Roll rate at full aileron is off by the same factor",
            )
    yaw_damping = entry("Cn", "r")
    if yaw_damping is not None:
        fin = 0.08 if yaw is None or yaw.value <= 0.0 else yaw.value - wing_yaw
        arm = 0.4
        if yaw is not None and side is not None and yaw.value > 0.0 > side.value:
            arm = -fin / side.value
        expected = 2.0 * fin * arm
        # Without a fin only drag damps, and a vortex lattice may give a little above zero.
        if yaw_damping.value > 0.012:
            yield _slip(
                yaw_damping,
                "sign",
                f"Cn_r {yaw_damping.value:.4g}; below 0 is expected",
                "The dutch roll grows",
            )
        elif (
            outlier is None
            and yaw_damping.value < 0.0
            and not 0.15 <= -yaw_damping.value / expected <= 8.0
        ):
            yield _slip(
                yaw_damping,
                "deg/rad" if _unit_remark(-yaw_damping.value / expected) else "reference length",
                f"Cn_r {yaw_damping.value:.4g} per rb/2V; about {-expected:.2g} is expected from"
                " Cn_beta and the fin's arm" + _unit_remark(-yaw_damping.value / expected),
                "Dutch roll damping is off by the same factor",
            )
    side_r = entry("CY", "r")
    if outlier is None and side_r is not None and yaw is not None and yaw.value > 0.01:
        ratio = side_r.value / (2.0 * yaw.value)
        if not -0.3 <= ratio <= 5.0:
            yield _slip(
                side_r,
                "sign" if ratio < 0.0 else "deg/rad",
                f"CY_r {side_r.value:.4g} per rb/2V; about {2.0 * yaw.value:.2g} (twice Cn_beta) is"
                " expected",
                "Turns slip",
            )
    roll_r = entry("Cl", "r")
    if roll_r is not None and lift > 0.15 and not -0.1 * lift - 0.02 <= roll_r.value <= lift + 0.25:
        yield _slip(
            roll_r,
            "sign" if roll_r.value < 0.0 else "deg/rad",
            f"Cl_r {roll_r.value:.4g} per rb/2V; about CL/4 = {lift / 4.0:.2g} is expected",
            "The spiral mode is wrong",
        )
    yaw_p = entry("Cn", "p")
    if yaw_p is not None and lift > 0.15 and not -0.6 * lift - 0.2 <= yaw_p.value <= 0.15:
        yield _slip(
            yaw_p,
            "sign" if yaw_p.value > 0.0 else "deg/rad",
            f"Cn_p {yaw_p.value:.4g} per pb/2V; about -CL/8 = {-lift / 8.0:.2g} is expected",
            "Rolling yaws the wrong way",
        )


def _fin_outlier(point: Point, wing_yaw: float) -> tuple[tuple[str, str], float] | None:
    """Return the derivative that the others of the fin contradict, and its ratio to theirs.

    A fin of side force k at an arm of a spans makes CY_beta = -k, Cn_beta = k a, CY_r = 2 k a and
    Cn_r = -2 k a^2. Those that agree, at an arm near 0.4, show the one that is off by ten.
    """
    rows = {
        ("CY", "beta"): (-1.0, 0.0),
        ("Cn", "beta"): (1.0, 1.0),
        ("CY", "r"): (0.5, 1.0),
        ("Cn", "r"): (-0.5, 2.0),
    }
    keys = [key for key in rows if key in point.entries]
    values = np.array([rows[key][0] * point.value(*key) for key in keys])
    if ("Cn", "beta") in keys:
        values[keys.index(("Cn", "beta"))] -= wing_yaw
    if len(keys) < 3 or not np.all(values > 1e-9):
        return None
    powers = np.array([[1.0, rows[key][1]] for key in keys])
    logs = np.log(values)
    candidates = []
    for i in range(len(keys)):
        remaining = [j for j in range(len(keys)) if j != i]
        fin = np.linalg.lstsq(powers[remaining], logs[remaining], rcond=None)[0]
        scatter = float(np.max(np.abs(logs[remaining] - powers[remaining] @ fin)))
        arm = math.exp(fin[1])
        if 0.05 < arm < 1.3 and scatter < 0.5 * math.log(3.0):
            badness = scatter + 0.25 * abs(math.log(arm / 0.4))
            candidates.append((badness, i, float(logs[i] - powers[i] @ fin)))
    _, i, deviation = min(candidates, default=(0.0, 0, 0.0))
    # Bodies add side force, so that less than the fin's is less likely than more.
    least = math.log(5.0 if candidates and keys[i] == ("CY", "beta") else 10.0)
    if -least < deviation < math.log(10.0):
        return None
    return keys[i], math.exp(deviation)


_EVEN = ("CL", "CD", "Cm")
_ODD = ("CY", "Cl", "Cn")


def _symmetry(point: Point) -> Iterator[Slip]:
    """Check that a symmetric flight condition couples nothing sideways."""
    if abs(point.beta) > 1e-6:
        return
    sizes = {
        name: max(abs(point.value(name, v)) for v in ("alpha", "beta", "p", "q", "r"))
        for name in STABILITY
    }
    pairs = [(name, v) for name in _EVEN for v in ("beta", "p", "r")]
    pairs += [(name, v) for name in _ODD for v in ("alpha", "q")]
    for name, variable in pairs:
        entry = point.entries.get((name, variable))
        # A difference to one side has half of the second derivative times its step.
        even = sizes["CL"] * abs(point.steps.get(variable, 0.0)) if name in _EVEN else 0.0
        if entry is None or abs(entry.value) <= max(0.12 * sizes[name], 0.03) + even:
            continue
        yield _slip(
            entry,
            "axes",
            f"{name}_{variable} {entry.value:.4g}; 0 is expected of a symmetric aeroplane in"
            " straight flight",
            "Columns or axes are mixed: pitch couples into roll and yaw",
        )


def _surfaces(
    source: Source,
    geometry: Geometry | None,
    controls: Mapping[str, Mapping[str, float]] | None,
) -> Iterator[Slip]:
    """Check the derivatives of control surfaces."""
    if not source.surfaces or not source.points:
        return
    point = _stability(min(source.points, key=lambda p: abs(p.alpha.value)))
    weights = control_weights(source, controls)
    forward = set((controls or {}).get("elevator", {}))
    forward |= {s for s in source.surfaces if re.search("canard|foreplane", s.lower())}
    if geometry is not None:
        forward |= _ahead_of_centre(source, geometry)
    for control, row in weights.items():
        for surface in row:
            yield from _surface(point, control, surface, weights, forward)
        if len(row) == 1:
            yield from _one_sided(point, control, next(iter(row)), weights)
    names = {name for row in weights.values() for name in row}
    for surface in source.surfaces:
        meanings = controls_of(surface)
        if surface not in names and len(meanings) == 1:
            yield from _powerless(point, meanings[0], surface)


def _powerless(point: Point, control: str, surface: str) -> Iterator[Slip]:
    """Name a surface that makes no moment of the control that its name states."""
    coefficient, _, _, expected = _SIZES[control]
    moment = point.entries.get((coefficient, surface))
    forces = {name: point.entries.get((name, surface)) for name in ("CL", "CY")}
    largest = max(forces.values(), key=lambda entry: 0.0 if entry is None else abs(entry.value))
    if largest is None and moment is None:
        return
    amount = 0.0 if moment is None else moment.value
    force = 0.0 if largest is None else abs(largest.value)
    text = f"{surface}: {coefficient} {amount:.4g} per rad; {expected} is expected"
    if largest is not None and force > 1.3 * max(point.value("CL", "alpha"), 0.5):
        yield _slip(
            largest,
            "deg/rad",
            f"{surface}: a force of {largest.value:.4g} per rad with CL_alpha"
            f" {point.value('CL', 'alpha'):.4g}; less than that is expected"
            + _unit_remark(force / (0.1 * max(point.value("CL", "alpha"), 0.5))),
            "The surface lifts too much by that factor",
        )
    elif control == "aileron" and force > 0.02:
        yield _slip(
            moment or largest or Entry(0.0),
            "control sign",
            f"{text}: beside a force of {force:.4g} both sides move the same way (AVL's SgnDup 1,"
            " or two surfaces of one sense; ailerons need -1)",
            "Ailerons work as flaps: no roll control",
        )
    else:
        yield _slip(
            moment or largest or Entry(0.0),
            "control",
            f"{text}; AVL needs its CONTROL in both sections at the ends of the surface",
            "The aeroplane cannot be steered with it",
        )


_SIZES = {
    "elevator": ("Cm", 0.08, 6.0, "Cm_de -0.3 to -3 per rad"),
    "aileron": ("Cl", 0.02, 0.8, "Cl_da 0.05 to 0.4 per rad"),
    "rudder": ("Cn", 0.008, 0.5, "Cn_dr -0.02 to -0.2 per rad"),
}


def _ahead_of_centre(source: Source, geometry: Geometry) -> set[str]:
    """Return the controls of the geometry whose surface lies ahead of the moment centre."""
    centre = geometry.reference["x"].value
    out = set()
    for surface in geometry.surfaces:
        points = surface.points()
        if float(np.mean(points[:, 0] + 0.5 * points[:, 3])) < centre:
            out |= surface.controls.keys() & set(source.surfaces)
    return out


def _surface(
    point: Point,
    control: str,
    surface: str,
    weights: dict[str, dict[str, float]],
    forward: set[str],
) -> Iterator[Slip]:
    """Check size and signs of one surface as one control; ``forward`` ones may be canards."""
    name, low, high, expected = _SIZES[control]
    entry = point.entries.get((name, surface))
    if entry is None:
        return
    # Size: per degree in place of per radian is a factor of 57.
    size = abs(entry.value)
    shared = sum(surface in row for row in weights.values()) > 1
    # No flap at the trailing edge has more lift per radian than the wing has by alpha.
    lift, slope = point.entries.get(("CL", surface)), point.value("CL", "alpha")
    if lift is not None and slope > 0.5 and abs(lift.value) > 1.3 * slope:
        yield _slip(
            lift,
            "deg/rad",
            f"{surface}: CL {lift.value:.4g} per rad with CL_alpha {slope:.4g}; less than that is"
            " expected" + _unit_remark(abs(lift.value) / (0.1 * slope)),
            "The surface lifts too much by that factor",
        )
    if not low <= size <= high and not shared:
        yield _slip(
            entry,
            "deg/rad",
            f"{name} of {surface} {entry.value:.4g} per rad ({math.radians(entry.value):.3g} per"
            f" deg); {expected} is expected" + _unit_remark(size / math.sqrt(low * high)),
            "The surface is too strong or too weak by that factor",
        )
    yaw = point.entries.get(("Cn", surface))
    if control == "aileron" and not shared and yaw is not None and abs(yaw.value) > max(size, 0.02):
        yield _slip(
            yaw,
            "deg/rad",
            f"{surface}: Cn {yaw.value:.4g} per rad beside Cl {entry.value:.4g}; ailerons roll more"
            " than they yaw" + _unit_remark(abs(yaw.value) / max(0.1 * size, 1e-9)),
            "Ailerons steer as rudders",
        )
    if control == "elevator":
        # The ratio of moment to lift is the tail's arm in chords.
        lift = point.entries.get(("CL", surface))
        is_ahead = lift is not None and lift.value * entry.value > 0.0
        if lift is not None and abs(lift.value) > 1e-6 and is_ahead and surface not in forward:
            arm = entry.value / lift.value
            yield _slip(
                entry,
                "control sign",
                f"{surface}: Cm {entry.value:.4g} and CL {lift.value:.4g}{_in_line(lift)} per rad"
                f" have the same sign, which is a surface {arm:.2g} chords ahead of the CG; behind"
                f" it they are opposite (a canard: --control elevator={surface})",
                "The elevator works the wrong way round, or lift falls as the tail lifts",
            )
        elif lift is not None and abs(lift.value) > 1e-6 and abs(entry.value / lift.value) > 12.0:
            yield _slip(
                lift,
                "deg/rad",
                f"{surface}: Cm {entry.value:.4g} over CL {lift.value:.4g} is a tail"
                f" {abs(entry.value / lift.value):.3g} chords away; 1 to 8 is expected",
                "Lift and moment of the elevator do not belong together",
            )
    if control == "rudder" and not shared:
        # The same for the fin, in spans.
        side = point.entries.get(("CY", surface))
        if side is not None and abs(side.value) > 1e-6 and side.value * entry.value > 0.0:
            yield _slip(
                entry,
                "control sign",
                f"{surface}: Cn {entry.value:.4g} and CY {side.value:.4g}{_in_line(side)} per rad"
                " have the same sign, which is a fin ahead of the CG; behind it they are opposite",
                "The rudder yaws the wrong way",
            )
        # A rudder above the centre of gravity rolls the way it pushes.
        roll = point.entries.get(("Cl", surface))
        if (
            roll is not None
            and side is not None
            and abs(side.value) > 1e-6
            and roll.value / side.value < -0.06
        ):
            yield _slip(
                roll,
                "ventral fin",
                f"{surface}: Cl {roll.value:.4g} over CY {side.value:.4g} puts the rudder"
                f" {-roll.value / side.value:.2g} spans below the CG; above it both have one sign",
                "Rudder rolls against the turn, as with a ventral fin",
            )


def _one_sided(
    point: Point, control: str, surface: str, weights: dict[str, dict[str, float]]
) -> Iterator[Slip]:
    """Check that a control with one name moves both sides."""
    roll = point.value("Cl", surface)
    lift = point.value("CL", surface)
    shared = sum(surface in row for row in weights.values()) > 1
    if control == "aileron" and abs(lift) > 0.5 * abs(roll) and not shared:
        entry = point.entries.get(("CL", surface)) or point.entries["Cl", surface]
        yield _slip(
            entry,
            "per-surface deflection",
            f"{surface}: CL {lift:.4g} beside Cl {roll:.4g} per rad: one panel moves, or both the"
            " same way; 0 is expected of (left - right)/2",
            "A panel of one side counts as the average of both: half the roll power, and aileron"
            " pitches",
        )
    if control == "elevator":
        side = max(("Cl", "CY", "Cn"), key=lambda name: abs(point.value(name, surface)))
        limit = {"Cl": 0.1, "CY": 0.1, "Cn": 0.04}[side] * abs(lift or point.value("Cm", surface))
        if abs(point.value(side, surface)) > max(limit, 0.004):
            yield _slip(
                point.entries[side, surface],
                "v-tail mixing" if side != "Cl" else "per-surface deflection",
                f"{surface}: {side} {point.value(side, surface):.4g} per rad; 0 is expected of an"
                " elevator: it is one panel of two, or of a v-tail",
                "Elevator rolls and yaws; give both panels, or --control elevator=LEFT+RIGHT",
            )
    if control == "rudder":
        pitch = point.value("Cm", surface)
        if abs(pitch) > max(1.0 * abs(point.value("Cn", surface)), 0.02) and not shared:
            yield _slip(
                point.entries["Cm", surface],
                "v-tail mixing",
                f"{surface}: Cm {pitch:.4g} per rad; 0 is expected of a rudder: it is one panel of"
                " a v-tail",
                "Rudder pitches; give both panels, or --control rudder=LEFT-RIGHT",
            )


def _alphas(source: Source) -> Iterator[Slip]:
    """Check that derivatives and totals vary smoothly over several alphas."""
    points = source.points
    if len(points) < 3:
        return
    for before, after in pairwise(points):
        step = after.alpha.value - before.alpha.value
        if abs(after.alpha.value) > math.radians(9.0) or abs(before.alpha.value) > 0.16:
            continue
        for name in ("CZ", "CL"):
            if (name, "alpha") not in before.entries:
                continue
            change = after.value(name, TOTAL) - before.value(name, TOTAL)
            slopes = 0.5 * (before.value(name, "alpha") + after.value(name, "alpha"))
            if abs(change - slopes * step) > 0.25 * abs(slopes * step) + 0.01:
                yield _slip(
                    after.entries[name, TOTAL],
                    "alpha",
                    f"{name} changes by {change:.4g} from alpha"
                    f" {math.degrees(before.alpha.value):.3g} to"
                    f" {math.degrees(after.alpha.value):.3g} deg; its slopes give"
                    f" {slopes * step:.4g}",
                    "A total, its slope or an alpha is wrong",
                )


_CASE_OF = {
    "Alpha": "Alpha",
    "Beta": "Beta",
    "p": "Roll__Rate",
    "q": "Pitch_Rate",
    "r": "Yaw___Rate",
}


def _implied_lengths(block: vspaero.Block) -> dict[str, float]:
    """Return the lengths that a block's rate derivatives were made with, over those it states.

    A derivative is the case's difference over rate times length over 2V.
    """
    speed = block.values["Vinf_"].value if "Vinf_" in block.values else 0.0
    base = block.cases.get("Base_Aero")
    ratios: dict[str, list[float]] = {"b": [], "c": []}
    for key, name, columns in (("b", "Bref_", "pr"), ("c", "Cref_", "q")):
        for column in columns:
            delta, row = block.cases.get(_CASE_OF[column], (0.0, {}))
            for coefficient, values in block.derivatives.items():
                if base is None or delta == 0.0 or not {column} <= values.keys():
                    continue
                if coefficient not in row or coefficient not in base[1]:
                    continue
                difference = row[coefficient].value - base[1][coefficient].value
                received = values[column].value * delta * block.values[name].value
                # Differences of seven decimals tell a ratio to a percent from here.
                if abs(difference) > 5e-5 and abs(received) > 0.0:
                    ratios[key].append(2.0 * speed * difference / received)
    out = {}
    for key, quotients in ratios.items():
        middle = float(np.median(quotients)) if len(quotients) > 2 else math.nan
        if middle > 0.0 and np.mean(np.abs(np.divide(quotients, middle) - 1.0) < 0.02) > 0.7:
            out[key] = middle
    return out


def _certain_lengths(path: Path, text: str) -> set[str]:
    """Return those of b and c that the differences of a ``.stab`` confirm."""
    blocks = vspaero.blocks(path, text)
    implied = _implied_lengths(blocks[0]) if blocks else {}
    return {key for key, ratio in implied.items() if abs(ratio - 1.0) < 0.02}


def _stab_cases(path: Path, text: str) -> Iterator[Slip]:
    """Check the derivatives of a ``.stab`` against its own finite differences, line by line."""
    blocks = vspaero.blocks(path, text)
    usual = {
        name: float(np.median([block.values[name].value for block in blocks]))
        for name in ("Sref_", "Bref_", "Cref_", "Xcg_", "Zcg_")
    }
    for block in blocks:
        # One run has one set of reference values.
        for name, value in usual.items():
            entry = block.values[name]
            if abs(entry.value - value) > 1e-3 * max(abs(value), usual["Cref_"] * 0.1):
                yield _slip(
                    entry,
                    "moment centre" if name in ("Xcg_", "Zcg_") else "reference length",
                    f"{name} {entry.value:.4g}; most blocks have {value:.4g}",
                    "Every derivative of the block is scaled or moved by it",
                )
        base = block.cases.get("Base_Aero")
        if base is None or not block.derivatives:
            continue
        speed = block.values["Vinf_"].value if "Vinf_" in block.values else math.nan
        span, chord = block.values["Bref_"].value, block.values["Cref_"].value
        # One wrong length shows in a column of every coefficient: it is named once.
        implied = _implied_lengths(block)
        for key, name in (("b", "Bref_"), ("c", "Cref_")):
            ratio = implied.get(key, 1.0)
            if abs(ratio - 1.0) > 0.02:
                entry = block.values[name]
                yield _slip(
                    entry,
                    "reference length",
                    f"{name} {entry.value:.4g}; the derivatives with respect to rates and their"
                    f" cases were made with {entry.value * ratio:.4g}",
                    "Every moment and rate derivative is scaled by it",
                )
        span, chord = span * implied.get("b", 1.0), chord * implied.get("c", 1.0)
        factors = {
            "Alpha": _DEGREES,
            "Beta": _DEGREES,
            "p": 2.0 * speed / span,
            "q": 2.0 * speed / chord,
            "r": 2.0 * speed / span,
        }
        cases = dict(_CASE_OF)
        for number, group in enumerate(block.groups, start=1):
            cases[f"ConGrp_{number}"] = group
            factors[f"ConGrp_{number}"] = _DEGREES
        for coefficient, columns in block.derivatives.items():
            if coefficient not in base[1]:
                continue
            total = columns.get("Total")
            in_case = base[1][coefficient].value
            findings = []
            if total is not None and abs(total.value - in_case) > 2e-6:
                findings.append(f"Total {total.value:.4g} (the cases give {in_case:.4g})")
            for column, case in cases.items():
                if column not in columns or case not in block.cases:
                    continue
                delta, row = block.cases[case]
                if coefficient not in row or delta == 0.0 or not math.isfinite(factors[column]):
                    continue
                expected = (row[coefficient].value - base[1][coefficient].value) / delta
                expected *= factors[column]
                # Seven decimals of the cases, over steps of 1 (versions 3 to 5) or 0.01 (later).
                tolerance = 3e-7 * factors[column] / abs(delta) + 0.02 * abs(expected) + 1e-6
                received = columns[column].value
                if abs(received - expected) > tolerance:
                    findings.append(f"{column} {received:.4g} (the cases give {expected:.4g})")
            for message in findings[:1]:
                entry = next(iter(columns.values()))
                sign = "sign" if _is_reversed(message) else "derivative"
                yield _slip(
                    entry,
                    sign,
                    f"{coefficient} with respect to {message}",
                    "The derivative does not belong to the cases above it in the file",
                )
        yield from _lift_of_stab(block, base[1])
        pairs = (("CMl", "CMx", -1.0), ("CMm", "CMy", 1.0), ("CMn", "CMz", -1.0))
        for first, second, sign_factor in pairs:
            for _, row in block.cases.values():
                if (
                    first in row
                    and second in row
                    and abs(row[first].value - sign_factor * row[second].value) > 2e-7
                ):
                    yield _slip(
                        row[first],
                        "axes",
                        f"{first} {row[first].value:.4g} with {second} {row[second].value:.4g};"
                        f" {sign_factor:+g} times {second} is expected",
                        "Roll or yaw is reversed",
                    )
        margin, neutral = block.values.get("SM"), block.values.get("X_np")
        lift, pitch = (block.derivatives.get(name, {}).get("Alpha") for name in ("CL", "CMm"))
        if margin is not None and lift is not None and pitch is not None and lift.value > 0.5:
            stability = -pitch.value / lift.value
            if abs(margin.value - stability) > 0.02 * abs(stability) + 2e-3:
                yield _slip(
                    margin,
                    "moment centre",
                    f"static margin {margin.value:.4g}; CMm and CL with respect to Alpha give"
                    f" {stability:.4g}",
                    "The static margin is wrong: the aeroplane may diverge in pitch",
                )
                margin = None
        if margin is not None and neutral is not None:
            expected = block.values["Xcg_"].value + margin.value * chord
            centre = block.values["Xcg_"]
            if abs(neutral.value - expected) > 1e-3 * chord + 2e-6:
                is_usual = len(blocks) > 1 and centre.value == usual["Xcg_"]
                yield _slip(
                    neutral if is_usual else centre,
                    "moment centre",
                    f"x of the moment centre {centre.value:.4g} (line {centre.line}) and static"
                    f" margin {margin.value:.4g} of chord {chord:.4g} give a neutral point at"
                    f" {expected:.4g}; line {neutral.line} says {neutral.value:.4g}",
                    "The static margin is wrong: the aeroplane may diverge in pitch",
                )


def _lift_of_stab(block: vspaero.Block, base: Mapping[str, Entry]) -> Iterator[Slip]:
    """Check that CL is CFz cos(alpha) - CFx sin(alpha), as VSPAERO turns it."""
    if not {"CL", "CFx", "CFz"} <= base.keys() or abs(block.values["Beta_"].value) > 1e-6:
        return
    lift, axial, normal = (base[name].value for name in ("CL", "CFx", "CFz"))
    angle = block.values["AoA_"]
    turned = normal * math.cos(math.radians(angle.value))
    turned -= axial * math.sin(math.radians(angle.value))
    if abs(turned - lift) > 2e-3 * max(abs(lift), 0.1):
        candidates = np.radians(np.linspace(-30.0, 30.0, 12001))
        errors = np.abs(normal * np.cos(candidates) - axial * np.sin(candidates) - lift)
        matching_deg = np.degrees(candidates[errors < 1e-3 * max(abs(lift), 0.1)])
        fits = f"; alpha of {matching_deg[0]:.3g} deg would fit" if matching_deg.size else ""
        yield _slip(
            angle if matching_deg.size else base["CL"],
            "deg/rad" if matching_deg.size else "axes",
            f"CFx {axial:.4g} and CFz {normal:.4g} give CL {turned:.4g} at alpha"
            f" {angle.value:.4g} deg; the file says {lift:.4g}{fits}",
            "Drag and lift are turned by the wrong angle: thrust and glide are wrong",
        )


def _is_reversed(message: str) -> bool:
    """Return whether a message's two numbers are opposite."""
    words = message.replace(")", "").split()
    try:
        first, second = float(words[1]), float(words[-1])
    except (ValueError, IndexError):
        return False
    return first * second < 0.0 and abs(first + second) < 0.1 * abs(second)


def _airfoils(geometry: Geometry) -> Iterator[Slip]:
    """Check that AVL finds the airfoils of a geometry that it runs."""
    for name, line in geometry.missing_airfoils():
        yield _slip(
            Entry(0.0, geometry.path, line),
            "geometry",
            f"the airfoil {name[:60]} is not beside the geometry; AVL takes a flat plate for it",
            "Lift and pitching moment at zero alpha lack the camber: trim is wrong",
        )


def _geometry(geometry: Geometry) -> Iterator[Slip]:
    """Check controls and sections of an AVL geometry."""
    yield from _flaps_for_ailerons(geometry)
    for surface in geometry.surfaces:
        every = [(name, len(rows), *row) for name, rows in surface.controls.items() for row in rows]
        for name, count, gain, sign, line in every:
            entry = Entry(gain, geometry.path, line)
            is_aileron = controls_of(name) == ("aileron",)
            if surface.duplicated and is_aileron and sign > 0.0:
                yield _slip(
                    entry,
                    "control sign",
                    f"{name}: the duplicate moves the same way (SgnDup {sign:g}); -1 is expected of"
                    " ailerons",
                    "Ailerons work as flaps: no roll control",
                )
            if surface.duplicated and controls_of(name) == ("elevator",) and sign < 0.0:
                yield _slip(
                    entry,
                    "control sign",
                    f"{name}: the duplicate moves the other way (SgnDup {sign:g}); 1 is expected of"
                    " an elevator",
                    "The elevator rolls and does not pitch",
                )
            if count < 2:
                yield _slip(
                    entry,
                    "control",
                    f"{name}: CONTROL stands in one section of {surface.name}; AVL needs it in both"
                    " sections at the ends of the surface",
                    "The surface moves nothing",
                )
            if gain == 0.0 or abs(gain) > 10.0:
                yield _slip(
                    entry,
                    "deg/rad",
                    f"{name}: gain {gain:g} degrees per unit; 1 is expected",
                    "The surface is too strong by that factor",
                )
        if (
            abs(surface.dihedral()) > math.radians(20.0)
            and surface.area() > 0.3 * max(s.area() for s in geometry.surfaces)
            and surface in geometry.wings()
        ):
            yield _slip(
                Entry(0.0, geometry.path, surface.line),
                "geometry",
                f"{surface.name}: dihedral {math.degrees(surface.dihedral()):.3g} deg",
                "The dihedral effect is far too strong",
            )


def _flaps_for_ailerons(geometry: Geometry) -> Iterator[Slip]:
    """Check that ailerons on two separate wings have gains of opposite sign: SgnDup is no such."""
    sides: dict[str, dict[bool, tuple[float, int]]] = {}
    for surface in geometry.surfaces:
        middle = float(np.mean(surface.points()[:, 1]))
        for name, rows in surface.controls.items():
            if controls_of(name) == ("aileron",) and not surface.duplicated and middle:
                gain, _, line = rows[0]
                sides.setdefault(name, {})[middle > 0.0] = (gain, line)
    for name, gains in sides.items():
        if len(gains) == 2 and gains[True][0] * gains[False][0] > 0.0:
            gain, line = max(gains.values(), key=lambda row: row[1])
            yield _slip(
                Entry(gain, geometry.path, line),
                "control sign",
                f"{name}: gain {gain:g} on the left and the right wing; opposite gains are expected"
                " (SgnDup acts on the copy that YDUPLICATE makes only)",
                "Ailerons work as flaps: no roll control",
            )


def _masses(masses: Masses, source: Source) -> Iterator[Slip]:
    """Check mass and inertia of a ``.mass`` file."""
    line = masses.lines.get("Lunit") or masses.lines.get("items", 0)
    mass = masses.mass_kg
    if "Munit" in masses.lines:
        mass = Entry(mass.value, mass.path, masses.lines["Munit"])
    tensor = masses.inertia_kgm2
    inertia = [Entry(float(tensor[i, i]), masses.path, line) for i in range(3)]
    yield from mass_slips(source, mass, inertia)


def _side(margin: float) -> str:
    """Return on which side of the neutral point a centre of gravity of a static margin is."""
    return "ahead of" if margin >= 0.0 else "behind"


def centre_slips(x: Entry, model: AeroModel) -> Iterator[Slip]:
    """Check a stated centre of gravity [m] against the model's neutral point."""
    margin = model.static_margin
    if not -0.3 <= margin <= 1.5:
        neutral = x.value + margin * model.c
        yield _slip(
            x,
            "moment centre",
            f"{x.value:.4g} m is {abs(margin):.3g} chords {_side(margin)} the neutral point at"
            f" {neutral:.4g} m;"
            " 0 to 0.4 is expected: check unit and origin, aft is positive",
            "The aeroplane diverges in pitch, or the elevator cannot trim it",
        )


def mass_slips(source: Source, mass: Entry, inertia: Sequence[Entry]) -> Iterator[Slip]:
    """Check a mass [kg] and moments of inertia [kg m2] against area and span.

    Parameters
    ----------
    source : Source
        Reference lengths.
    mass : Entry
        Of the aircraft.
    inertia : sequence of Entry
        About x, y and z; empty if unknown.
    """
    area, span = source.length("S"), source.length("b")
    if not mass.value > 0.0:
        yield _slip(mass, "mass units", f"a mass of {mass.value:.4g} kg", "Nothing can fly")
        return
    for axis, entry in zip("xyz", inertia, strict=False):
        radius = math.sqrt(max(entry.value, 0.0) / mass.value) / span
        if not 0.02 <= radius <= 0.6:
            yield _slip(
                entry,
                "mass units",
                f"radius of gyration about {axis} is {radius:.3g} spans; 0.05 to 0.3 is expected:"
                " check units of mass, length and inertia (Lunit, Munit and the items)",
                "Every rotation is too fast or too slow",
            )
            break
    if len(inertia) == 3:
        xx, yy, zz = (entry.value for entry in inertia)
        if not (xx + yy > 0.98 * zz and yy + zz > 0.98 * xx and zz + xx > 0.98 * yy):
            yield _slip(
                inertia[0],
                "inertia",
                f"Ixx {xx:.4g}, Iyy {yy:.4g}, Izz {zz:.4g} kg m2: no body has one above the sum of"
                " the other two",
                "JSBSim's rotations are impossible ones",
            )
    # Mass over area and span is, but for a factor, the square of speed over gravity and span: from
    # .1 of a human-powered aircraft over 2 of models and gliders to 40 of a fighter.
    volume = area * span
    if not 0.05 <= mass.value / volume <= 60.0:
        yield _slip(
            mass,
            "mass units",
            f"{mass.value:.4g} kg for an area of {area:.4g} m2 and a span of {span:.4g} m;"
            f" {0.1 * volume:.2g} to {40.0 * volume:.3g} kg is expected",
            "Speed and inertia are wrong by roots of that factor",
        )
