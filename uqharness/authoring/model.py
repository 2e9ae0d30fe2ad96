"""The model that is written: body axes about the centre of gravity, one number a term.

`build` takes a `Source`, the mass properties and what each surface is, and returns an `AeroModel`.
Terms are those of `aircraft/espaaro`: CX is a parabola in alpha, the others are linear, surfaces
count per degree with elevator positive nose down, aileron right wing down, rudder nose left. What a
source with several alphas has beyond that is a table over alpha, which adds to the terms.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sysid.arrays import FloatArray
from uqharness.authoring.source import (
    BODY,
    STATES,
    TOTAL,
    Entry,
    Point,
    Source,
    about,
    body_coefficients,
    rotate_forces,
)
from uqharness.errors import BadInputError

CONTROLS = {"elevator": "de", "aileron": "da", "rudder": "dr"}
_MOMENT_OF = {"elevator": ("Cm", -1.0), "aileron": ("Cl", 1.0), "rudder": ("Cn", -1.0)}
_LONGITUDINAL = ("CX", "CZ", "Cm")
TERMS: Mapping[str, tuple[str, ...]] = {
    "CX": ("0", "alpha", "alpha2"),
    "CY": ("0", "beta", "p", "r", "da", "dr"),
    "CZ": ("0", "alpha", "q", "de"),
    "Cl": ("0", "beta", "p", "r", "da", "dr"),
    "Cm": ("0", "alpha", "q", "de"),
    "Cn": ("0", "beta", "p", "r", "da", "dr"),
}
_FIT_DEG = np.arange(-4.0, 12.1, 0.5)
"""Angles over which one point's parabola of drag is written in body axes."""


@dataclass(frozen=True)
class MassProperties:
    """Mass [kg], centre of gravity (x aft, y right, z up) [m], inertia about it [kg m2].

    ``source`` says where they come from.
    """

    mass_kg: float
    centre_m: tuple[float, float, float]
    Ixx: float
    Iyy: float
    Izz: float
    Ixz: float
    source: str


@dataclass(frozen=True)
class TermValue:
    """A number of the model with its unit and source."""

    value: float
    unit: str
    source: str


@dataclass(frozen=True)
class AeroModel:
    """Body-axis model about the centre of gravity.

    Attributes
    ----------
    name, tool : str
        Aircraft, and program of the source.
    S, b, c : float
        Reference area [m2], span and chord [m].
    alpha : float
        Angle of attack of the source's middle point [rad].
    terms : mapping of str to TermValue
        Keys such as ``CZ_alpha``; surfaces per degree.
    tables : mapping of str to (array (n,), array (n,))
        Alpha [rad] and what the source has beyond the terms, by term (``Cm_0``, ``Cl_beta``).
    mixing : mapping of str to str
        How the source's surfaces make up each control.
    alphas : tuple of float
        Angles of attack of the source [rad].
    notes : tuple of str
        Assumptions.
    increments : mapping of str to TermValue
        Of flaps, per degree (``CZ_df``), and of the gear, down (``CX_gear``).
    ground : (array (n,), array (n,)) or None
        Factor of the normal force over height above ground in spans.
    """

    name: str
    tool: str
    S: float
    b: float
    c: float
    alpha: float
    mass: MassProperties
    terms: Mapping[str, TermValue]
    tables: Mapping[str, tuple[FloatArray, FloatArray]]
    mixing: Mapping[str, str]
    alphas: tuple[float, ...]
    notes: tuple[str, ...] = field(default=())
    increments: Mapping[str, TermValue] = field(default_factory=dict)
    ground: tuple[FloatArray, FloatArray] | None = None

    @property
    def static_margin(self) -> float:
        """Return the distance from the centre of gravity to the neutral point over the chord."""
        return self.terms["Cm_alpha"].value / self.terms["CZ_alpha"].value

    def coefficient(self, name: str, alpha: float, **others: float) -> float:
        """Return a coefficient at alpha [rad] and other variables (beta, p, q, r, de, da, dr)."""
        values = {"0": 1.0, "alpha": alpha, "alpha2": alpha**2, **others}
        total = 0.0
        for term in TERMS[name]:
            key = f"{name}_{term}"
            slope = self.terms[key].value if key in self.terms else 0.0
            if key in self.tables:
                slope += float(np.interp(alpha, *self.tables[key]))
            total += slope * values.get(term, 0.0)
        return total


def control_weights(
    source: Source, stated: Mapping[str, Mapping[str, float]] | None = None
) -> dict[str, dict[str, float]]:
    """Return, for each control, the weight of each of the source's surfaces.

    Parameters
    ----------
    source : Source
        Its surfaces' names tell what they are: elev, ail, rud, elevon, vtail or ruddervator, with R
        or L for the panels of one side.
    stated : mapping, optional
        Weights by control and surface, which replace the names' meaning of these controls.

    Returns
    -------
    dict
        Signs make +1 degree of elevator nose down, of aileron right wing down, of rudder nose left;
        two panels of an aileron count as (left - right)/2 with both trailing edges down positive.
    """
    if stated:
        for control, weights in stated.items():
            unknown = [name for name in weights if name not in source.surfaces]
            if unknown or control not in CONTROLS:
                raise BadInputError(
                    f"{source.path}: control {control}: {', '.join(unknown) or control} is"
                    f" unknown; surfaces are {', '.join(source.surfaces) or 'none'}, controls"
                    f" {', '.join(CONTROLS)}"
                )
        values = body_coefficients(_middle(source), source.surfaces)
        turned = {}
        for control, weights in stated.items():
            # The statement says which panels go together; the moment says which way is positive.
            coefficient, sign = _MOMENT_OF[control]
            moment = sum(w * values[coefficient, name] for name, w in weights.items())
            turn = -1.0 if sign * moment < 0.0 else 1.0
            turned[control] = {name: turn * w for name, w in weights.items()}
        return control_weights(source) | turned
    values = body_coefficients(_middle(source), source.surfaces)
    kinds: dict[str, list[str]] = {control: [] for control in CONTROLS}
    for name in source.surfaces:
        for control in controls_of(name):
            kinds[control].append(name)
    out: dict[str, dict[str, float]] = {}
    for control, names in kinds.items():
        coefficient, sign = _MOMENT_OF[control]
        # The symmetric and the differential part of elevons both bear the name: each makes one
        # moment, and the last printed digit of the other. Ailerons that move the same way have
        # lift, and no roll.
        largest = max((abs(values[coefficient, name]) for name in names), default=0.0)
        live = [
            name
            for name in names
            if abs(values[coefficient, name])
            > 0.02 * max(largest, abs(values["CZ", name]), abs(values["CY", name])) + 1e-9
        ]
        if live:
            out[control] = {
                name: math.copysign(1.0, sign * values[coefficient, name]) for name in live
            }
    return out


def controls_of(name: str) -> tuple[str, ...]:
    """Return the controls that a surface's name speaks of.

    >>> controls_of("R_elevon"), controls_of("vtail_sym"), controls_of("flap")
    (('elevator', 'aileron'), ('elevator', 'rudder'), ())
    """
    word = name.lower()
    if re.search(r"v-?_?tail|ruddervator", word):
        return ("elevator", "rudder")
    if "elevon" in word:
        return ("elevator", "aileron")
    if re.search(r"elev|stab|h-?_?tail|tailplane|^de$|canard|foreplane|profundor", word):
        return ("elevator",)
    if re.search(r"(?<!t)ail|^da$|querruder", word):
        return ("aileron",)
    if re.search(r"rud|fin|^dr$|leme", word):
        return ("rudder",)
    return ()


def _middle(source: Source) -> Point:
    """Return the point nearest to 3 degrees of alpha, where wings of aeroplanes usually fly."""
    return min(source.points, key=lambda p: abs(p.alpha.value - math.radians(3.0)))


def build(
    source: Source,
    mass: MassProperties,
    *,
    name: str = "",
    profile_drag: float | None = None,
    controls: Mapping[str, Mapping[str, float]] | None = None,
) -> AeroModel:
    """Build the model of a source.

    Parameters
    ----------
    source : Source
        Lengths in metres.
    mass : MassProperties
        Its centre of gravity is where moments are taken.
    name : str, optional
        Of the aircraft.
    profile_drag : float, optional
        CD at zero lift, added where the source has induced drag alone. By default 0.03 is added
        where the source's drag at its smallest lift is below 0.005 (a note says so).
    controls : mapping, optional
        As for `control_weights`.

    Raises
    ------
    BadInputError
        Without derivatives, reference lengths, or a lift slope.
    """
    # Vector from the centre of gravity to the source's moment centre, in body axes: the source's x
    # points aft and its z up.
    span, chord, area = source.length("b"), source.length("c"), source.length("S")
    centre = [source.reference[key].value if key in source.reference else 0.0 for key in "xyz"]
    x, y, z = (a - b for a, b in zip(centre, mass.centre_m, strict=True))
    offset = (-x, y, -z)
    notes = list(source.notes)
    if not source.points:
        raise BadInputError(
            f"{source.path}: running AVL needs the package optvl (pip install uqharness[avl]);"
            " without it, give AVL's own output (ST) too"
        )
    # Surfaces of the source become the controls of the aircraft.
    weights = control_weights(source, controls)
    absent = [control for control in CONTROLS if control not in weights]
    if absent:
        notes.append(
            f"the source has no {', '.join(absent)}: zero; name surfaces with --control"
            if source.surfaces
            else f"the source has no control surfaces: {', '.join(absent)} are zero"
        )
    added_drag = _added_drag(source, profile_drag, notes)
    # Body axes about the centre of gravity at every alpha of the source.
    rows = []
    for point in source.points:
        values = body_coefficients(point, source.surfaces)
        drag_x, drag_z = rotate_forces(0.0, added_drag, point.alpha.value)
        values["CX", TOTAL] += drag_x
        values["CZ", TOTAL] += drag_z
        sine, cosine = math.sin(point.alpha.value), math.cos(point.alpha.value)
        values["CX", "alpha"] += added_drag * sine
        values["CZ", "alpha"] -= added_drag * cosine
        rows.append(about(values, offset, span, chord, point.alpha.value))
    alphas = np.array([point.alpha.value for point in source.points])
    # Derivatives are those nearest to 3 deg, where such aircraft fly; the others become tables.
    middle = int(np.argmin(np.abs(alphas - math.radians(3.0))))
    if abs(rows[middle]["CZ", "alpha"]) < 1e-6:
        raise BadInputError(
            f"{source.path}: no lift slope at alpha {math.degrees(alphas[middle]):g} deg; a file"
            " with derivatives (ST, SB, .stab, a table) is needed"
        )
    terms: dict[str, TermValue] = {}
    tables: dict[str, tuple[FloatArray, FloatArray]] = {}
    point = source.points[middle]
    where = f"{source.tool}, alpha {math.degrees(alphas[middle]):.3g} deg"
    _longitudinal(
        terms,
        tables,
        source,
        rows,
        alphas,
        middle,
        offset=offset,
        added_drag=added_drag,
        where=where,
    )
    for coefficient in BODY:
        for variable in STATES:
            # Derivatives by states, other than those of the longitudinal polar.
            key = f"{coefficient}_{variable}"
            if key in terms or variable == "alpha" or variable not in TERMS[coefficient]:
                continue
            unit = "1/rad" if variable == "beta" else "1"
            terms[key] = TermValue(
                rows[middle][coefficient, variable],
                unit,
                f"{where}{_line(point.entries.get((_twin(coefficient), variable)))}",
            )
            _table(tables, key, alphas, [row[coefficient, variable] for row in rows], middle)
        # Controls, as sums over their surfaces, per degree.
        for control, short in CONTROLS.items():
            if short in TERMS[coefficient]:
                value = sum(
                    weight * rows[middle][coefficient, surface]
                    for surface, weight in weights.get(control, {}).items()
                )
                terms[f"{coefficient}_{short}"] = TermValue(
                    math.radians(value), "1/deg", where if control in weights else "none"
                )
    # Asymmetries in a source are those of its panels.
    for coefficient in ("CY", "Cl", "Cn"):
        terms[f"{coefficient}_0"] = TermValue(0.0, "1", "symmetric aeroplane")
    increments = _increments(source, rows[middle], where, notes)
    if source.ground is not None:
        notes.append("the ground's effect is that of its lift alone")
    return AeroModel(
        name=name or source.name or source.path.stem,
        tool=source.tool,
        S=area,
        b=span,
        c=chord,
        alpha=float(alphas[middle]),
        mass=mass,
        terms={
            f"{coefficient}_{term}": terms[f"{coefficient}_{term}"]
            for coefficient, names in TERMS.items()
            for term in names
        },
        tables=tables,
        mixing={
            control: " ".join(f"{weight:+g}*{surface}" for surface, weight in row.items())
            for control, row in weights.items()
        },
        alphas=tuple(float(a) for a in alphas),
        notes=tuple(notes),
        increments=increments,
        ground=None
        if source.ground is None
        else (np.array([h for h, _ in source.ground]), np.array([k for _, k in source.ground])),
    )


def _increments(
    source: Source, row: Mapping[tuple[str, str], float], where: str, notes: list[str]
) -> dict[str, TermValue]:
    """Return what flaps add per degree, and the gear when it is down.

    Flaps are the surfaces of that name, trailing edge down: the sign is that of more lift.
    """
    flaps = [name for name in source.surfaces if "flap" in name.lower()]
    out = {}
    for kind, unit, names in (
        ("df", "1/deg", flaps),
        ("gear", "1", [name for name in source.surfaces if name.lower() == "gear"]),
    ):
        for coefficient in _LONGITUDINAL if names else ():
            value = 0.0
            for name in names:
                sign = math.copysign(1.0, -row["CZ", name]) if kind == "df" else 1.0
                value += sign * row[coefficient, name]
            out[f"{coefficient}_{kind}"] = TermValue(
                math.radians(value) if kind == "df" else value, unit, where
            )
    if out:
        notes.append("flaps and gear have no prior and are not in the bounds")
    return out


def _twin(coefficient: str) -> str:
    """Return the stability-axis coefficient that a body-axis one mostly comes from."""
    return {"CX": "CD", "CZ": "CL"}.get(coefficient, coefficient)


def _line(entry: Entry | None) -> str:
    """Return the line of a number for a comment."""
    return f", line {entry.line}" if entry is not None and entry.line else ""


def _added_drag(source: Source, profile_drag: float | None, notes: list[str]) -> float:
    """Return the profile drag to add to the source's."""
    if profile_drag is not None:
        return profile_drag
    point = min(source.points, key=lambda p: abs(p.value("CL", TOTAL) + p.value("CZ", TOTAL)))
    values = body_coefficients(point, ())
    sine, cosine = math.sin(point.alpha.value), math.cos(point.alpha.value)
    drag = -values["CX", TOTAL] * cosine - values["CZ", TOTAL] * sine
    lift = -values["CZ", TOTAL] * cosine + values["CX", TOTAL] * sine
    aspect_ratio = source.length("b") ** 2 / source.length("S")
    parasite_drag = drag - lift**2 / (math.pi * aspect_ratio)
    if parasite_drag < 0.015:
        notes.append(
            f"drag at zero lift is {parasite_drag:.2g} in the source: 0.03 is added for skin"
            " friction and fuselage (assumed; --cd0 sets it)"
        )
        return 0.03
    return 0.0


def _longitudinal(
    terms: dict[str, TermValue],
    tables: dict[str, tuple[FloatArray, FloatArray]],
    source: Source,
    rows: Sequence[Mapping[tuple[str, str], float]],
    alphas: FloatArray,
    middle: int,
    *,
    offset: tuple[float, float, float],
    added_drag: float,
    where: str,
) -> None:
    """Add the terms of CX, CZ and Cm in alpha.

    With one alpha, lift is linear and drag a parabola of lift through the point, with the slope of
    the source; their turn into body axes is fitted from -4 to 12 degrees. With several, the terms
    are the middle point's and its slopes, and the tables hold the rest.
    """
    if len(alphas) > 1:
        a0 = float(alphas[middle])
        for name in _LONGITUDINAL:
            totals = np.array([row[name, TOTAL] for row in rows])
            degree = 2 if name == "CX" and len(alphas) > 2 else 1
            nearest = np.argsort(np.abs(alphas - a0))[: 4 if degree == 2 else 3]
            fitted = np.polyfit(alphas[nearest], totals[nearest], degree)[::-1]
            for term, value in zip(("0", "alpha", "alpha2"), fitted, strict=False):
                unit = {"0": "1", "alpha": "1/rad", "alpha2": "1/rad^2"}[term]
                terms[f"{name}_{term}"] = TermValue(
                    float(value), unit, f"{source.tool}, fit around {math.degrees(a0):.3g} deg"
                )
            if name == "CX":
                terms.setdefault("CX_alpha2", TermValue(0.0, "1/rad^2", "two alphas: no curvature"))
            _table(
                tables, f"{name}_0", alphas, totals - np.polynomial.Polynomial(fitted)(alphas), None
            )
        return
    point, row = source.points[0], rows[0]
    a0 = point.alpha.value
    sine, cosine = math.sin(a0), math.cos(a0)
    lift = -row["CZ", TOTAL] * cosine + row["CX", TOTAL] * sine
    drag = -row["CX", TOTAL] * cosine - row["CZ", TOTAL] * sine
    # Slopes in stability axes again, which the turn of the axes is taken out of.
    lift_slope = -(row["CZ", "alpha"] + drag * cosine - lift * sine) * cosine
    lift_slope += (row["CX", "alpha"] - lift * cosine - drag * sine) * sine
    drag_slope = -(row["CX", "alpha"] - lift * cosine - drag * sine) * cosine
    drag_slope -= (row["CZ", "alpha"] + drag * cosine - lift * sine) * sine
    curvature = drag_slope / (2.0 * lift * lift_slope) if abs(lift * lift_slope) > 0.02 else 0.0
    aspect_ratio = source.length("b") ** 2 / source.length("S")
    if not curvature > 0.0:
        efficiency = source.facts["e"].value if "e" in source.facts else 0.8
        curvature = 1.0 / (math.pi * aspect_ratio * (efficiency if efficiency > 0.2 else 0.8))
    a = np.radians(_FIT_DEG)
    lifts = lift + lift_slope * (a - a0)
    drags = drag + curvature * (lifts**2 - lift**2)
    cx, cz = lifts * np.sin(a) - drags * np.cos(a), -lifts * np.cos(a) - drags * np.sin(a)
    for name, values, degree in (("CX", cx, 2), ("CZ", cz, 1)):
        fitted = np.polyfit(a, values, degree)[::-1]
        for term, value in zip(("0", "alpha", "alpha2"), fitted, strict=False):
            unit = {"0": "1", "alpha": "1/rad", "alpha2": "1/rad^2"}[term]
            key = "CL" if name == "CZ" else "CD"
            line = _line(point.entries.get((key, "alpha" if term != "0" else TOTAL)))
            terms[f"{name}_{term}"] = TermValue(float(value), unit, f"{where}{line}")
    slope = row["Cm", "alpha"]
    terms["Cm_alpha"] = TermValue(
        slope, "1/rad", f"{where}{_line(point.entries.get(('Cm', 'alpha')))}, about the CG"
    )
    terms["Cm_0"] = TermValue(
        row["Cm", TOTAL] - slope * a0,
        "1",
        f"{where}{_line(point.entries.get(('Cm', TOTAL)))}, about the CG",
    )


def _table(
    tables: dict[str, tuple[FloatArray, FloatArray]],
    key: str,
    alphas: FloatArray,
    values: Sequence[float] | FloatArray,
    middle: int | None,
) -> None:
    """Add what the source has beyond a term, where there are several alphas."""
    if len(alphas) < 2:
        return
    offsets = np.asarray(values) - (0.0 if middle is None else values[middle])
    if np.max(np.abs(offsets)) > 1e-9:
        tables[key] = (alphas, offsets)


def gyration(mass_kg: float, span: float, centre: tuple[float, float, float]) -> MassProperties:
    """Return mass properties from radii of gyration of light single-engine aeroplanes.

    Rx 0.25, Ry 0.38, Rz 0.39 of half span, half length and half their mean (D. P. Raymer, Aircraft
    Design, table 16.1), with a length of 0.75 span.

    >>> round(gyration(2.0, 1.27, (0.0, 0.0, 0.0)).Ixx, 4)
    0.0504
    """
    length = 0.75 * span
    return MassProperties(
        mass_kg,
        centre,
        mass_kg * (0.25 * span / 2.0) ** 2,
        mass_kg * (0.38 * length / 2.0) ** 2,
        mass_kg * (0.39 * (span + length) / 4.0) ** 2,
        0.0,
        "assumed: radii of gyration of light aeroplanes",
    )
