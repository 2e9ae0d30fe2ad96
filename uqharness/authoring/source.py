"""Derivatives as a file states them, with the line of each number, and their turn to body axes.

Every reader makes a `Source`: points in alpha and Mach with totals and derivatives in the file's
own axes. `body_coefficients` turns a point to body axes, `about` moves moments and rates to another
reference point. Signs are those of flight mechanics: x forward, y right, z down, beta positive with
the wind from the right, moments right wing down, nose up, nose right. Angles are in radians, rates
are made dimensionless by b/2V and c/2V, derivatives of surfaces are per radian.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from uqharness.errors import BadInputError

Axes = Literal["stability", "body"]
BODY = ("CX", "CY", "CZ", "Cl", "Cm", "Cn")
STABILITY = ("CD", "CY", "CL", "Cl", "Cm", "Cn")
STATES = ("alpha", "beta", "p", "q", "r")
LARGEST = 1e12
"""Numbers beyond are no derivative, length or mass: an overflow of the program that wrote them."""
TOTAL = "0"
"""Name of the variable of a total: the coefficient itself at the point."""


@dataclass(frozen=True)
class Entry:
    """A number of a file.

    Attributes
    ----------
    value : float
        Value in SI and radians.
    path, line : Path, int
        Where it stands; line 0 where it was computed or is an option.
    """

    value: float
    path: Path = Path()
    line: int = 0

    @property
    def place(self) -> str:
        """Return file and line for messages."""
        return f"{self.path}:{self.line}" if self.line else str(self.path)


@dataclass(frozen=True)
class Point:
    """Derivatives at one flight condition.

    Attributes
    ----------
    alpha, mach : Entry
        Angle of attack [rad] and Mach number.
    beta : float
        Sideslip [rad].
    taken_out : float
        Largest deflection [rad] or dimensionless rate that the totals were freed of.
    axes : {"stability", "body"}
        Axes of the force and moment coefficients.
    rate_axes : {"stability", "body"}
        Axes of the rates p and r.
    entries : mapping of (coefficient, variable) to Entry
        Totals under the variable `TOTAL`, derivatives under alpha, beta, p, q, r or the name of a
        surface.
    steps : mapping of str to float
        Step [rad, dimensionless rate] of derivatives that are differences to one side.
    """

    alpha: Entry
    mach: Entry
    axes: Axes
    rate_axes: Axes
    entries: Mapping[tuple[str, str], Entry]
    beta: float = 0.0
    taken_out: float = 0.0
    steps: Mapping[str, float] = field(default_factory=dict)

    def value(self, coefficient: str, variable: str) -> float:
        """Return a number, 0 where the file has none."""
        entry = self.entries.get((coefficient, variable))
        return 0.0 if entry is None else entry.value


@dataclass(frozen=True)
class Source:
    """Content of a file of derivatives.

    Attributes
    ----------
    path : Path
        The file.
    tool : str
        Program or kind of source, such as "AVL".
    name : str
        Name of the aircraft in the file; may be empty.
    reference : mapping of str to Entry
        S [m2], b, c [m] and the moment centre x, y, z [m], x aft, y right, z up.
    points : tuple of Point
        In order of alpha.
    surfaces : tuple of str
        Names of the control surfaces in the file.
    facts : mapping of str to Entry
        Other numbers: neutral point ``x_np`` [m], span efficiency ``e``, and those that only checks
        use.
    notes : tuple of str
        What was assumed while reading.
    ground : tuple of (float, float)
        Height above the ground in spans, and the factor of the lift there; None without any.
    """

    path: Path
    tool: str
    name: str
    reference: Mapping[str, Entry]
    points: tuple[Point, ...]
    surfaces: tuple[str, ...] = ()
    facts: Mapping[str, Entry] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    ground: tuple[tuple[float, float], ...] | None = None

    def length(self, key: str) -> float:
        """Return a reference value [m, m2]; BadInputError where the file has none."""
        entry = self.reference.get(key)
        if entry is None or not (key in "xyz" or entry.value > 1e-6):
            raise BadInputError(
                f"{self.path}: no reference {key} above 0 (1e-6 m); give it with"
                f" --{_OPTION.get(key, key)}"
            )
        return entry.value


_OPTION = {"S": "area-m2", "b": "span-m", "c": "chord-m"}


def without_deflections(point: Point, amounts: Mapping[str, float]) -> Point:
    """Return a point whose totals are those with surfaces and rates at zero.

    Programs are often run at a trim: its moment is zero because the elevator is deflected. The
    model adds the surfaces' effects itself, so that its totals are those without.

    Parameters
    ----------
    point : Point
        As printed.
    amounts : mapping of str to float
        Deflections [rad] by surface, and dimensionless rates p, q, r.

    Examples
    --------
    >>> entries = {("Cm", "0"): Entry(0.0), ("Cm", "elevator"): Entry(-1.2)}
    >>> trimmed = Point(Entry(0.05), Entry(0.0), "stability", "stability", entries)
    >>> without_deflections(trimmed, {"elevator": -0.1}).value("Cm", "0")
    -0.12
    """
    entries = dict(point.entries)
    for (name, variable), entry in point.entries.items():
        amount = amounts.get(variable, 0.0)
        if amount and (name, TOTAL) in entries:
            total = entries[name, TOTAL]
            moved = total.value - entry.value * amount
            entries[name, TOTAL] = Entry(moved, total.path, total.line)
    largest = max((abs(amount) for amount in amounts.values()), default=0.0)
    return replace(point, entries=entries, taken_out=largest)


def merge(sources: Sequence[Source]) -> Source:
    """Return one source of several outputs of one aircraft at different alphas.

    Points of the smallest sideslip and, of these, the lowest Mach number are used; of several at
    one alpha the one with the smallest deflections and rates.

    Raises
    ------
    BadInputError
        Where no source has derivatives, or reference values differ.
    """
    if not any(source.points for source in sources):
        return sources[0]
    with_derivatives = [s for s in sources if any(v != "0" for p in s.points for _, v in p.entries)]
    if not with_derivatives:
        raise BadInputError(
            f"{sources[0].path}: totals without derivatives; write ST or SB from AVL's OPER menu"
        )
    first = with_derivatives[0]
    for source in with_derivatives[1:]:
        for key, name in zip(
            "Sbcxyz", ("S", "b", "c", *(f"point {k}" for k in "xyz")), strict=True
        ):
            if key not in source.reference or key not in first.reference:
                continue
            chord = first.reference["c"].value if "c" in first.reference else 1.0
            scale = 0.0 if key in "Sbc" else abs(chord)
            new, old = source.reference[key], first.reference[key]
            if abs(new.value - old.value) > 1e-3 * max(abs(old.value), scale):
                raise BadInputError(
                    f"{new.place}: reference {name} {new.value:g} differs from {old.place}'s"
                    f" {old.value:g}; the files are not of one aircraft about one point"
                )
        if source.surfaces != first.surfaces:
            raise BadInputError(
                f"{source.path}: surfaces {', '.join(source.surfaces) or 'none'} differ from"
                f" {first.path}'s {', '.join(first.surfaces) or 'none'}; give files of one geometry"
            )
    pairs = [(point, source) for source in with_derivatives for point in source.points]
    level = min(abs(point.beta) for point, _ in pairs)
    pairs = [pair for pair in pairs if abs(pair[0].beta) <= level + 1e-9]
    slowest = min(point.mach.value for point, _ in pairs)
    pairs = [pair for pair in pairs if pair[0].mach.value <= slowest + 1e-9]
    chosen: dict[float, tuple[Point, Source]] = {}
    for point, source in sorted(pairs, key=lambda pair: pair[0].taken_out):
        chosen.setdefault(round(point.alpha.value, 6), (point, source))
    ordered = [chosen[alpha] for alpha in sorted(chosen)]
    count = sum(len(source.points) for source in with_derivatives)
    notes = [note for _, source in ordered for note in source.notes]
    if len(ordered) < count:
        notes.append(
            f"{len(ordered)} of {count} cases are used: beta {math.degrees(level):.3g} deg, Mach"
            f" {slowest:.3g}, each alpha once"
        )
    # Facts such as the neutral point are those of the first point.
    return replace(
        ordered[0][1],
        points=tuple(point for point, _ in ordered),
        notes=tuple(dict.fromkeys(notes)),
    )


def rotate_forces(cl: float, cd: float, alpha: float) -> tuple[float, float]:
    """Return CX and CZ of lift and drag.

    >>> [round(c, 3) for c in rotate_forces(1.0, 0.1, 0.1)]
    [0.0, -1.005]
    """
    sine, cosine = math.sin(alpha), math.cos(alpha)
    return cl * sine - cd * cosine, -cl * cosine - cd * sine


def body_coefficients(point: Point, surfaces: tuple[str, ...]) -> dict[tuple[str, str], float]:
    """Return totals and derivatives of a point in body axes, rates in body axes.

    Parameters
    ----------
    point : Point
        In stability or body axes.
    surfaces : tuple of str
        Control surfaces whose derivatives are turned as well.

    Returns
    -------
    dict
        Keys (coefficient of `BODY`, variable). Derivatives with respect to alpha include the turn
        of the axes: d(CX)/d(alpha) holds CL cos(alpha) + CD sin(alpha).

    References
    ----------
    Etkin and Reid, "Dynamics of Flight", 3rd ed., appendix B.12.
    """
    alpha = point.alpha.value
    sine, cosine = math.sin(alpha), math.cos(alpha)
    out: dict[tuple[str, str], float] = {}
    for variable in (TOTAL, *STATES, *surfaces):
        if point.axes == "body":
            values = {name: point.value(name, variable) for name in BODY}
        else:
            cx, cz = rotate_forces(point.value("CL", variable), point.value("CD", variable), alpha)
            if variable == "alpha":
                cl, cd = point.value("CL", TOTAL), point.value("CD", TOTAL)
                cx += cl * cosine + cd * sine
                cz += cl * sine - cd * cosine
            roll, yaw = point.value("Cl", variable), point.value("Cn", variable)
            values = {
                "CX": cx,
                "CY": point.value("CY", variable),
                "CZ": cz,
                "Cl": roll * cosine - yaw * sine,
                "Cm": point.value("Cm", variable),
                "Cn": yaw * cosine + roll * sine,
            }
            if variable == "alpha":
                # The axes turn nose up with alpha, so moments turn the other way.
                total_roll, total_yaw = point.value("Cl", TOTAL), point.value("Cn", TOTAL)
                values["Cl"] -= total_roll * sine + total_yaw * cosine
                values["Cn"] += total_roll * cosine - total_yaw * sine
        out.update({(name, variable): value for name, value in values.items()})
    if point.rate_axes == "stability":
        for name in BODY:
            p, r = out[name, "p"], out[name, "r"]
            out[name, "p"] = p * cosine - r * sine
            out[name, "r"] = p * sine + r * cosine
    return out


def about(
    coefficients: Mapping[tuple[str, str], float],
    offset: tuple[float, float, float],
    span: float,
    chord: float,
    alpha: float = 0.0,
) -> dict[tuple[str, str], float]:
    """Move moments, and the point that the rates turn about, to another reference point.

    Parameters
    ----------
    coefficients : mapping
        Body axes, as `body_coefficients` returns them.
    offset : tuple of float
        Old less new reference point, body axes (forward, right, down) [m].
    span, chord : float
        Reference lengths [m].
    alpha : float
        Angle of attack of the coefficients [rad].

    Returns
    -------
    dict
        The same keys. Rates omega add omega x offset to the velocity (u, v, w) at the old point.
        Forces grow with the square of the speed, so that over V: C_u = 2 C cos(alpha) - C_alpha
        sin(alpha), C_v = C_beta, C_w = 2 C sin(alpha) + C_alpha cos(alpha).

    Examples
    --------
    >>> both = {("CZ", "alpha"): -5.0, ("Cm", "alpha"): 0.0}
    >>> moved = about(both, (-0.1, 0.0, 0.0), 2.0, 0.5)
    >>> round(moved["Cm", "alpha"], 12)  # lift 0.2 chords aft of the point: nose down
    -1.0
    """
    x, y, z = offset
    sine, cosine = math.sin(alpha), math.cos(alpha)
    variables = {variable for _, variable in coefficients}
    values = {
        (name, variable): coefficients.get((name, variable), 0.0)
        for name in BODY
        for variable in variables
    }
    for name in BODY:
        total, slope = values.get((name, TOTAL), 0.0), values.get((name, "alpha"), 0.0)
        along_u = 2.0 * total * cosine - slope * sine
        along_v = values.get((name, "beta"), 0.0)
        along_w = 2.0 * total * sine + slope * cosine
        for rate, change, length in (
            ("p", along_w * y - along_v * z, span),
            ("q", along_u * z - along_w * x, chord),
            ("r", along_v * x - along_u * y, span),
        ):
            if (name, rate) in values:
                values[name, rate] += 2.0 / length * change
    for variable in variables:
        cx, cy, cz = (values[name, variable] for name in ("CX", "CY", "CZ"))
        values["Cl", variable] += (y * cz - z * cy) / span
        values["Cm", variable] += (z * cx - x * cz) / chord
        values["Cn", variable] += (x * cy - y * cx) / span
    return values


def scaled_lengths(source: Source, unit_m: float) -> Source:
    """Return a source whose lengths are in a unit of ``unit_m`` metres, in metres."""
    if unit_m == 1.0:
        return source
    reference = {
        key: replace(entry, value=entry.value * (unit_m**2 if key == "S" else unit_m))
        for key, entry in source.reference.items()
    }
    facts = {
        key: replace(entry, value=entry.value * unit_m) if key.startswith("x_") else entry
        for key, entry in source.facts.items()
    }
    return replace(source, reference=reference, facts=facts)
