"""Slips between two models of one aircraft: signs, units, halves, reference lengths, moment centre.

Both models are evaluated at the same states, in one reference, and their slopes are compared. A
slope that is opposite, 57.3 or 2 times the other, or in the ratio of span and chord has a usual
cause, which is named; slopes that differ together point to one slip behind them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.units import FT_M, IN_M, LB_KG, SLUG_FT2_KGM2, SLUG_KG
from uqharness.exchange.states import (
    VARIABLES,
    FlightStates,
    Reference,
    air_velocity,
    lift_and_drag,
    polynomial,
)

_WORDS: Mapping[str, str] = {
    "alpha": "angle of attack",
    "beta": "sideslip",
    "p": "roll rate",
    "q": "pitch rate",
    "r": "yaw rate",
    "de": "elevator",
    "da": "aileron",
    "dr": "rudder",
}
_TOLERANCE = 0.1
"""Relative width around a usual ratio; fits of two programs differ by less."""
_ABSENT = 1e-3
"""Relative size of a slope that is none."""
_AGREE = 0.1
"""Relative difference of a slope that is no finding."""
_RELEVANT = 0.02
"""Share of a coefficient's variation below which a slope is not judged."""
_RELEVANT_EXACT = 5e-4
"""The same for a usual slip between models that the polynomials hold exactly."""
_ABSENCE = "one of the models lacks the term, or its parts cancel"
_BODY_TO_WIND = {"CZ": "CL", "CX": "CD"}
_UNITS: Mapping[str, Sequence[tuple[float, str]]] = {
    "m": ((FT_M, "feet and metres"), (IN_M, "inches and metres")),
    "m2": ((FT_M**2, "square feet and square metres"),),
    "kg": ((LB_KG, "pounds and kilograms"), (SLUG_KG, "slugs and kilograms")),
    "kg m2": ((SLUG_FT2_KGM2, "slug ft2 and kg m2"), (LB_KG * FT_M**2, "lb ft2 and kg m2")),
}


@dataclass(frozen=True)
class ComparedModel:
    """A model in one common reference.

    Attributes
    ----------
    name : str
        What messages call it.
    coefficients : callable
        States to CX CY CZ Cl Cm Cn (n, 6), of the common reference.
    reference : Reference or None
        Its own geometry, mass and inertia; None where the format does not hold them.
    parts : Mapping
        Coefficient and variable to what each surface of a model with several adds.
    axes : ndarray, optional
        (3, 3) its axes in those of the body, where the format holds them.
    terms : frozenset, optional
        Coefficient and variable of the slopes that its format has; None for all. Others are a loss
        of the format and no slip.
    """

    name: str
    coefficients: Callable[[FlightStates], FloatArray]
    reference: Reference | None = None
    parts: Mapping[tuple[str, str], Sequence[float]] = field(default_factory=dict)
    axes: FloatArray | None = None
    terms: frozenset[tuple[str, str]] | None = None


@dataclass(frozen=True)
class Slip:
    """A difference between two models, and its usual cause.

    Attributes
    ----------
    where : str
        Coefficient and variable, such as "Cm over alpha", or a quantity.
    first, second : float
        Value in each model.
    cause : str
        What usually makes it; "" where nothing usual fits.
    """

    where: str
    first: float
    second: float
    cause: str

    def text(self, a: str, b: str) -> str:
        """Return the finding as a sentence."""
        values = f"{self.where}: {self.first:.4g} in {a}, {self.second:.4g} in {b}"
        return f"{values}: {self.cause}" if self.cause else f"{values}: they differ"


def slips(
    a: ComparedModel, b: ComparedModel, states: FlightStates, middle: Mapping[str, float]
) -> list[Slip]:
    """Compare two models' slopes at the middle of the states, and their geometry and mass."""
    slopes, effects, least_change = _slopes(a, b, states, middle)
    findings = _of_reference(a, b)
    exchanged, centre = _exchanged(slopes, effects), None
    if exchanged is None:
        floor = max(least_change[moment] for moment in ("Cl", "Cm", "Cn"))
        centre = _moment_centre(slopes, effects, floor, states)
    if exchanged is not None:
        findings.append(exchanged[0])
    elif centre is not None:
        findings.append(centre[0])
        # What remains is judged about the second model's centre; its program may take the
        # velocity of the air there, too.
        moved = [
            _slopes(_moved(a, centre[1], has_air), b, states, middle) for has_air in (False, True)
        ]
        slopes, effects, least_change = min(
            moved,
            key=lambda rows: sum(((x - y) * rows[1][key]) ** 2 for key, (x, y) in rows[0].items()),
        )
    for key, (first, second) in slopes.items():
        size = max(abs(first), abs(second))
        if key[0] in ("CL", "CD") or abs(first - second) <= _AGREE * size:
            continue
        if exchanged is not None and key in exchanged[1]:
            continue
        if any(model.terms is not None and key not in model.terms for model in (a, b)):
            continue
        cause = _cause(*key, first, second, states)
        share = size * effects[key]
        # A usual slip counts if it is small, but larger than the errors of the fits.
        if share <= (_RELEVANT if cause in ("", _ABSENCE) else least_change[key[0]]):
            continue
        if not cause and key[0] in _BODY_TO_WIND:
            wind = _BODY_TO_WIND[key[0]], key[1]
            cause = _cause(*wind, *slopes[wind], states)
        findings.append(Slip(_where(key), first, second, _of_parts(key, a, b) or cause))
    if findings:
        findings += _turned(a, b)
    return findings


Slopes = dict[tuple[str, str], tuple[float, float]]


def _slopes(
    a: ComparedModel, b: ComparedModel, states: FlightStates, middle: Mapping[str, float]
) -> tuple[Slopes, dict[tuple[str, str], float], dict[str, float]]:
    """Return both models' slopes, their reach, and each coefficient's least change that counts.

    Keys are coefficient and variable. The reach of a slope of 1 is a share of the coefficient's
    variation.
    """
    # Lift and drag are what files hold; a slip in them is seen through both body axes.
    rows = [model.coefficients(states) for model in (a, b)]
    alpha = states.values["alpha"]
    rows = [np.column_stack([row, *lift_and_drag(row, alpha)]) for row in rows]
    slopes: Slopes = {}
    effects: dict[tuple[str, str], float] = {}
    least_change: dict[str, float] = {}
    for k, coefficient in enumerate((*COEFFICIENTS, "CL", "CD")):
        fits = [polynomial(states, row[:, k]) for row in rows]
        of_first, of_second = (fit.tangent(middle) for fit in fits)
        scatter = max(float(row[:, k].std()) for row in rows)
        for variable in VARIABLES:
            slopes[coefficient, variable] = of_first[variable], of_second[variable]
            reach = float(states.values[variable].std())
            effects[coefficient, variable] = reach / scatter if scatter > 0.0 else 0.0
        # A slope's standard error, as a share of the variation, is what the fits leave over sqrt n.
        misfit = max(
            float((r[:, k] - f.over(states)).std()) for r, f in zip(rows, fits, strict=True)
        )
        error = misfit / max(scatter, 1e-30) / math.sqrt(len(states))
        least_change[coefficient] = min(max(_RELEVANT_EXACT, 10.0 * error), _RELEVANT)
    return slopes, effects, least_change


def _moved(model: ComparedModel, shift: FloatArray, has_air: bool) -> ComparedModel:
    """Return a model whose moments are taken about a point that lies ``shift`` chords away.

    ``has_air``: angles and speed are those of the air at the opposite point, where the forces of
    the other model act.
    """

    def coefficients(states: FlightStates) -> FloatArray:
        distance = np.asarray(shift) * states.c_m
        lengths = np.array([states.b_m, states.c_m, states.b_m])
        local, pressure = states, np.ones(len(states))
        if has_air:
            u, v, w = air_velocity(states, -distance)
            speed = np.sqrt(u**2 + v**2 + w**2)
            angles = {"alpha": np.arctan2(w, u), "beta": np.arcsin(v / speed)}
            rates = {name: states.values[name] / speed for name in "pqr"}
            values = {**states.values, **angles, **rates}
            local, pressure = replace(states, V_mps=states.V_mps * speed, values=values), speed**2
        rows = model.coefficients(local) * pressure[:, None]
        return np.hstack([rows[:, :3], rows[:, 3:] - np.cross(distance, rows[:, :3]) / lengths])

    return replace(model, coefficients=coefficients)


def _where(key: tuple[str, str]) -> str:
    """Return coefficient and variable as text."""
    return f"{key[0]} over {_WORDS[key[1]]}"


def _of_parts(key: tuple[str, str], a: ComparedModel, b: ComparedModel) -> str:
    """Return the cause that two surfaces of one model show; "" for none."""
    for parts in (model.parts.get(key, ()) for model in (b, a)):
        sizes = sorted(map(abs, parts))
        if len(parts) < 2 or not sizes[0] > 0.0:
            continue
        if min(parts) * max(parts) < 0.0:
            return "the sign of one surface is opposite, its part cancels the other's"
        if sizes[-1] / sizes[0] > 1.5:
            return "per surface and for both surfaces together are mixed in one of the surfaces"
    return ""


def _turned(a: ComparedModel, b: ComparedModel) -> list[Slip]:
    """Return axes that differ from those of the other model, or of the body."""
    first, second = (np.eye(3) if model.axes is None else model.axes for model in (a, b))
    names = ("forward", "right", "down")
    cosines = np.sum(first * second, axis=1)
    return [
        Slip(f"axis {name}", 1.0, float(cosine), "the axes are turned against each other")
        for name, cosine in zip(names, cosines, strict=True)
        if cosine < 0.99
    ]


def _exchanged(
    slopes: Mapping[tuple[str, str], tuple[float, float]],
    effects: Mapping[tuple[str, str], float],
) -> tuple[Slip, set[tuple[str, str]]] | None:
    """Return the slip of rolling and yawing moments that changed places."""
    pairs = [
        (variable, slopes[x, variable][0], slopes[y, variable][1], effects[x, variable])
        for x, y in (("Cl", "Cn"), ("Cn", "Cl"))
        for variable in VARIABLES
    ]
    visible = [row for row in pairs if abs(row[1]) * row[3] > _RELEVANT]
    first, second = slopes["Cl", "p"]
    if not visible or abs(first - second) < _AGREE * abs(first):
        return None
    if any(abs(x - y) > _AGREE * abs(x) for _, x, y, _ in visible):
        return None
    slip = Slip("Cl over roll rate", first, second, "rolling and yawing moment are exchanged")
    return slip, {(name, v) for name in ("Cl", "Cn") for v in VARIABLES}


def _cause(
    coefficient: str, variable: str, first: float, second: float, states: FlightStates
) -> str:
    """Return the usual cause of a ratio; "" for none."""
    if min(abs(first), abs(second)) < _ABSENT * max(abs(first), abs(second)):
        return _ABSENCE
    ratio = second / first
    span_chord = states.b_m / states.c_m
    usual: list[tuple[float, str]] = [
        (180.0 / math.pi, "per radian and per degree are mixed"),
        (2.0, _twice(variable)),
    ]
    if coefficient in ("Cl", "Cm", "Cn") or variable in ("p", "q", "r"):
        usual.append((span_chord, "span and chord are mixed as the reference length"))
    if variable in ("p", "q", "r"):
        usual.append((span_chord**2, "span and chord are mixed in moment and rate"))
    # The nearest usual ratio counts. A slope that is 57 times smaller is bent by other terms.
    size = abs(math.log(abs(ratio)))
    distance, cause = min(
        (abs(size - abs(math.log(value))) / max(0.12 * abs(math.log(value)), _TOLERANCE), text)
        for value, text in usual
    )
    if distance < 1.0:
        return f"{cause}, with the opposite sign" if ratio < 0.0 else cause
    if abs(ratio + 1.0) < 2.0 * _AGREE:
        return "the sign is opposite"
    return "the sign is opposite, and the size differs" if ratio < 0.0 else ""


def _twice(variable: str) -> str:
    """Return the usual cause of a factor of two."""
    if variable in ("de", "da", "dr"):
        return "per surface and for both surfaces together are mixed"
    if variable in ("p", "q", "r"):
        return "rates reduced by 2V and by V are mixed"
    return "one of the models has it twice"


def _moment_centre(
    slopes: Mapping[tuple[str, str], tuple[float, float]],
    effects: Mapping[tuple[str, str], float],
    floor: float,
    states: FlightStates,
) -> tuple[Slip, FloatArray] | None:
    """Return the slip of a shifted moment centre, and the shift in chords.

    About a point that lies d away moments change by -d x F, for all variables alike: one d, by
    least squares, must give each change that it makes visible; ``floor`` is the share of the
    variation that counts. Rates are left out: they also move the point through the air.
    """
    static = [v for v in VARIABLES if v not in ("p", "q", "r")]
    keys = [(moment, v) for moment in ("Cl", "Cm", "Cn") for v in static]
    span, weights = states.b_m / states.c_m, np.array([effects[key] for key in keys])
    levers = []
    for moment, variable in keys:
        x, y, z = (slopes[force, variable][1] for force in ("CX", "CY", "CZ"))
        levers.append(
            {
                "Cl": (0.0, -z / span, y / span),
                "Cm": (z, 0.0, -x),
                "Cn": (-y / span, x / span, 0.0),
            }[moment]
        )
    # Chords forward, right and down.
    matrix = np.array(levers) * weights[:, None]
    changes = np.array([slopes[key][1] - slopes[key][0] for key in keys]) * weights
    changed = np.abs(changes) > _RELEVANT
    if changed.sum() == 1:
        key = keys[int(np.argmax(changed))]
        if _cause(*key, *slopes[key], states) not in ("", _ABSENCE):
            return None
    observed = np.zeros(3, dtype=bool)
    shift = np.zeros(3)
    norms = np.maximum(np.linalg.norm(matrix, axis=0), 1e-12)
    # Directions one after the other, so that none takes what another explains.
    for _ in range(3):
        gains = np.abs(matrix.T @ (changes - matrix @ shift)) / norms
        gains[observed] = -1.0
        trial = observed.copy()
        trial[int(np.argmax(gains))] = True
        solution = np.zeros(3)
        solution[trial] = np.linalg.lstsq(matrix[:, trial], changes, rcond=None)[0]
        before = float(np.sum((changes - matrix @ shift) ** 2))
        after = float(np.sum((changes - matrix @ solution) ** 2))
        if after > 0.5 * before:
            break
        observed, shift = trial, solution
        # What is left is the difference of two sound fits.
        if after < 1e-3 * float(changes @ changes):
            break
    predicted = matrix @ shift
    visible = np.abs(predicted) > 0.5 * floor
    tolerance = np.maximum(0.25 * np.abs(predicted), 0.5 * floor)
    agree = np.abs(changes - predicted) < tolerance
    if not (np.abs(predicted) > 4.0 * floor).any() or visible.sum() < 2 or not agree[visible].all():
        return None
    words = [
        f"{abs(distance) * states.c_m:.3g} m further {forward if distance > 0.0 else aft}"
        for distance, (forward, aft) in zip(
            shift, (("forward", "aft"), ("right", "left"), ("down", "up")), strict=True
        )
        if abs(distance) > 0.05 * float(np.abs(shift).max())
    ]
    key = keys[int(np.argmax(np.abs(predicted)))]
    if abs(shift[0]) == np.abs(shift).max():
        key = ("Cm", "alpha")
    cause = f"the moment centre is {' and '.join(words)} in the second"
    return Slip(_where(key), *slopes[key], cause), shift


def _of_reference(a: ComparedModel, b: ComparedModel) -> list[Slip]:
    """Compare geometry, mass and inertia where both models hold them."""
    if a.reference is None or b.reference is None:
        return []
    first, second = _quantities(a.reference), _quantities(b.reference)
    findings = []
    for name in first:
        x, y = first[name], second[name]
        if not (math.isfinite(x) and math.isfinite(y)) or abs(x - y) <= 0.01 * max(abs(x), abs(y)):
            continue
        same_variable = [
            other
            for other in first
            if other != name
            and other.split("[")[1] == name.split("[")[1]
            and y != 0.0
            and abs(first[other] - y) < 1e-3 * abs(y)
        ]
        # Two that changed places are no matter of units.
        exchanged = [other for other in same_variable if abs(second[other] - x) < 1e-3 * abs(x)]
        if abs(x + y) < 0.01 * abs(x):
            cause = "the sign is opposite"
        elif exchanged or (same_variable and not _unit(name, x, y)):
            cause = f"that is the first model's {(exchanged or same_variable)[0]}"
        else:
            cause = _unit(name, x, y)
        findings.append(Slip(name, x, y, cause))
    return findings


def _unit(name: str, first: float, second: float) -> str:
    """Return the units that a ratio of two quantities mixes; "" for none."""
    if first == 0.0 or second == 0.0:
        return ""
    ratio = abs(second / first)
    for factor, words in _UNITS[name.split("[")[1].rstrip("]")]:
        if any(abs(ratio * f - 1.0) < 0.01 for f in (factor, 1.0 / factor)):
            return f"{words} are mixed"
    return ""


def _quantities(reference: Reference) -> dict[str, float]:
    """Return geometry, mass and inertia by name; NaN where a format does not hold them."""
    matrix = np.asarray(reference.inertia_kgm2)
    return {
        "wing area [m2]": reference.S_m2,
        "span [m]": reference.b_m,
        "chord [m]": reference.c_m,
        "mass [kg]": reference.mass_kg,
        "Ixx [kg m2]": float(matrix[0, 0]),
        "Iyy [kg m2]": float(matrix[1, 1]),
        "Izz [kg m2]": float(matrix[2, 2]),
        "Ixz [kg m2]": float(-matrix[0, 2]),
    }


def in_reference(coefficients: FloatArray, reference: Reference, common: Reference) -> FloatArray:
    """Return coefficients of a model's own area and lengths in a common reference."""
    area = reference.S_m2 / common.S_m2
    lengths = np.array(
        [reference.b_m / common.b_m, reference.c_m / common.c_m, reference.b_m / common.b_m]
    )
    return np.hstack([coefficients[:, :3] * area, coefficients[:, 3:] * (area * lengths)])
