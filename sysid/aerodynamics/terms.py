"""Coefficient terms by name: ``Cm_alpha2`` is alpha^2 in the pitching moment. The variables of a linear-in-parameters model."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sysid.arrays import FloatArray

COEFFICIENTS = ("CX", "CY", "CZ", "Cl", "Cm", "Cn")
_POWERS = {
    "alpha2": ("alpha", 2),
    "beta2": ("beta", 2),
    "alpha3": ("alpha", 3),
    "beta3": ("beta", 3),
}
_VARIABLES = {
    "alpha": "alpha",
    "beta": "beta",
    "p": "p_hat",
    "q": "q_hat",
    "r": "r_hat",
    "de": "de",
    "da": "da",
    "dr": "dr",
}


def split_name(name: str) -> tuple[str, str] | None:
    """('Cm', 'alpha2') of ``aero/Cm_alpha2`` or ``Cm_alpha2``; None when it is no coefficient term with a known variable."""
    coefficient, underscore, term = name.removeprefix("aero/").partition("_")
    if not underscore or coefficient not in COEFFICIENTS:
        return None
    return (coefficient, term) if term == "0" or term in _POWERS or term in _VARIABLES else None


def regressor(term: str, variables: Mapping[str, FloatArray]) -> FloatArray:
    """(n,) values of a term; ``variables`` alpha, beta [rad], p_hat, q_hat, r_hat, de, da, dr [deg], each (n,).

    Raises KeyError for a term that `split_name` does not know.
    """
    if term == "0":
        return np.ones_like(variables["alpha"])
    if term in _POWERS:
        name, power = _POWERS[term]
        return np.asarray(variables[name] ** power)
    return variables[_VARIABLES[term]]


def variables(
    V: FloatArray,
    alpha: FloatArray,
    beta: FloatArray,
    p: FloatArray,
    q: FloatArray,
    r: FloatArray,
    de: FloatArray,
    da: FloatArray,
    dr: FloatArray,
    b: float,
    c: float,
) -> dict[str, FloatArray]:
    """The variables of `regressor` from V [m/s], angles [rad], rates [rad/s], deflections [deg], span and chord [m]."""
    half = 0.5 / V
    return {
        "alpha": alpha,
        "beta": beta,
        "p_hat": p * b * half,
        "q_hat": q * c * half,
        "r_hat": r * b * half,
        "de": de,
        "da": da,
        "dr": dr,
    }
