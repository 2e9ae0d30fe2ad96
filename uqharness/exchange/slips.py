"""Slips between two models of one aircraft: signs, units, halves, reference lengths, moment centre.

Both models are evaluated at the same states, in one reference, and their slopes are compared. A
slope that is opposite, 57.3 or 2 times the other, or in the ratio of span and chord has a usual
cause, which is named; slopes that differ together point to one slip behind them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from uqharness.exchange.states import VARIABLES, FlightStates, Reference, polynomial

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
_TOLERANCE = 0.03
"""Relative width around a usual ratio; fits of two programs differ by less."""
_ABSENT = 1e-3
"""Relative size of a slope that is none."""
_AGREE = 0.1
"""Relative difference of a slope that is no finding."""
_RELEVANT = 0.02
"""Share of a coefficient's variation below which a slope is not judged."""


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
    """

    name: str
    coefficients: Callable[[FlightStates], FloatArray]
    reference: Reference | None = None


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
    rows = [model.coefficients(states) for model in (a, b)]
    findings = _of_reference(a, b)
    slopes: dict[tuple[str, str], tuple[float, float]] = {}
    effects: dict[tuple[str, str], float] = {}
    for k, coefficient in enumerate(COEFFICIENTS):
        of_first, of_second = (polynomial(states, row[:, k]).tangent(middle) for row in rows)
        spread = max(float(row[:, k].std()) for row in rows)
        for variable in VARIABLES:
            slopes[coefficient, variable] = of_first[variable], of_second[variable]
            reach = float(states.values[variable].std())
            effects[coefficient, variable] = reach / spread if spread > 0.0 else 0.0
    centre = _moment_centre(slopes, effects, states)
    if centre is not None:
        findings.append(centre[0])
    for (coefficient, variable), (first, second) in slopes.items():
        size = max(abs(first), abs(second))
        if size * effects[coefficient, variable] <= _RELEVANT:
            continue
        if centre is not None and (coefficient, variable) in centre[1]:
            continue
        if abs(first - second) <= _AGREE * size:
            continue
        cause = _cause(coefficient, variable, first, second, states)
        findings.append(Slip(f"{coefficient} over {_WORDS[variable]}", first, second, cause))
    return findings


def _cause(
    coefficient: str, variable: str, first: float, second: float, states: FlightStates
) -> str:
    """Return the usual cause of a ratio; "" for none."""
    if min(abs(first), abs(second)) < _ABSENT * max(abs(first), abs(second)):
        return "one of the models lacks the term, or its parts cancel"
    ratio = second / first
    span_chord = states.b_m / states.c_m
    degrees = 180.0 / math.pi
    usual: list[tuple[float, str]] = [
        (degrees, "per radian and per degree are mixed"),
        (1.0 / degrees, "per radian and per degree are mixed"),
        (2.0, _twice(variable)),
        (0.5, _twice(variable)),
    ]
    if coefficient in ("Cl", "Cm", "Cn") or variable in ("p", "q", "r"):
        usual += [
            (span_chord, "span and chord are mixed as the reference length"),
            (1.0 / span_chord, "span and chord are mixed as the reference length"),
        ]
    if variable in ("p", "q", "r"):
        usual += [
            (x, "span and chord are mixed in moment and rate")
            for x in (span_chord**2, 1.0 / span_chord**2)
        ]
    for value, cause in usual:
        if abs(abs(ratio) / value - 1.0) < _TOLERANCE:
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
    states: FlightStates,
) -> tuple[Slip, set[tuple[str, str]]] | None:
    """Return the slip of a shifted moment centre, and the slopes that it explains.

    About a point that lies x further forward Cm grows by CZ x/c and Cn falls by CY x/b, for all
    variables alike: one x, by least squares, must give each change that it makes visible.
    """
    rows = []
    for moment, force, factor in (("Cm", "CZ", 1.0), ("Cn", "CY", -states.c_m / states.b_m)):
        for variable in VARIABLES:
            key = moment, variable
            first, second = slopes[key]
            lever = factor * 0.5 * sum(slopes[force, variable])
            rows.append((key, lever * effects[key], (second - first) * effects[key]))
    levers, changes = (np.array([row[k] for row in rows]) for k in (1, 2))
    if not float(levers @ levers) > 0.0:
        return None
    shift = float(levers @ changes) / float(levers @ levers)
    visible = np.abs(shift * levers) > _RELEVANT
    agree = np.abs(changes - shift * levers) < 0.25 * np.abs(shift * levers)
    if abs(shift) < 0.02 or visible.sum() < 2 or not agree[visible].all():
        return None
    first, second = slopes["Cm", "alpha"]
    cause = (
        f"the moment centre is {abs(shift) * states.c_m:.3g} m further"
        f" {'forward' if shift > 0.0 else 'aft'} in the second"
    )
    explained = {
        key
        for (key, lever, change) in rows
        if abs(change - shift * lever) <= 0.25 * max(abs(shift * lever), _RELEVANT)
    }
    return Slip("Cm over angle of attack", first, second, cause), explained


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
        cause = "the sign is opposite" if abs(x + y) < 0.01 * abs(x) else ""
        others = [
            other
            for other in first
            if other != name
            and other.split("[")[1] == name.split("[")[1]
            and abs(first[other] - y) < 1e-3 * abs(y)
        ]
        if not cause and others and y != 0.0:
            cause = f"that is the first model's {others[0]}"
        findings.append(Slip(name, x, y, cause))
    return findings


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


def in_reference(coefficients: FloatArray, own: Reference, common: Reference) -> FloatArray:
    """Return coefficients of a model's own area and lengths in a common reference."""
    area = own.S_m2 / common.S_m2
    lengths = np.array([own.b_m / common.b_m, own.c_m / common.c_m, own.b_m / common.b_m])
    return np.hstack([coefficients[:, :3] * area, coefficients[:, 3:] * (area * lengths)])
