"""Coefficient terms by name: ``Cm_alpha2`` is alpha^2 in the pitching moment. The variables of a linear-in-parameters model."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence

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


# Polynomial terms of flight states by name: ``V_mps*alpha_rad``, ``alpha_rad^2``, ``1``.
#
# A term is a product of powers of *normalised* states z = (x - centre)/scale. A full polynomial
# spans the same functions either way, so its intervals are the same; its (X'X)^-1 is well
# conditioned only in z (a fourth power of 22 m/s beside one of 0.02 rad).

STATES = (
    "V_mps",
    "alpha_rad",
    "beta_rad",
    "phi_rad",
    "theta_rad",
    "p_radps",
    "q_radps",
    "r_radps",
    "elevator_pos_deg",
    "aileron_pos_deg",
    "rudder_pos_deg",
    "throttle_pct",
)
"""Flight states that a model form may depend on: measured in flight, known to a simulation at every step."""
MAX_POWER = 4
_FACTOR = re.compile(r"([A-Za-z_]+)(?:\^([1-9]))?")
Term = tuple[int, ...]


def term_name(term: Term, states: Sequence[str]) -> str:
    """``alpha_rad^2`` of (0, 2, 0, 0) over V, alpha, q, theta; ``1`` of all zeros."""
    factors = [s if n == 1 else f"{s}^{n}" for s, n in zip(states, term, strict=True) if n]
    return "*".join(factors) or "1"


def parse_term(name: str, states: Sequence[str]) -> Term:
    """The powers of each state in a term. Raises ValueError for an unknown state, a bad power or bad writing."""
    powers = dict.fromkeys(states, 0)
    if name.strip() == "1":
        return tuple(powers.values())
    for factor in name.split("*"):
        match = _FACTOR.fullmatch(factor.strip())
        if match is None:
            raise ValueError(
                f"term '{name}': '{factor.strip()}' is no state with a power, such as alpha_rad^2"
            )
        state, power = match.group(1), int(match.group(2) or 1)
        if state not in powers:
            raise ValueError(
                f"term '{name}': '{state}' is not among the states {', '.join(states)}"
            )
        powers[state] += power
        if powers[state] > MAX_POWER:
            raise ValueError(f"term '{name}': powers up to {MAX_POWER} are allowed")
    return tuple(powers.values())


def full_polynomial(count: int, order: int = 2) -> tuple[Term, ...]:
    """All terms up to total ``order`` in ``count`` states: constant, linear, then quadratic ones (15 for four states)."""
    out: list[Term] = []
    for degree in range(order + 1):
        for factors in itertools.combinations_with_replacement(range(count), degree):
            out.append(tuple(factors.count(k) for k in range(count)))
    return tuple(out)


def regressors(normalised: FloatArray, terms: Sequence[Term]) -> FloatArray:
    """(n, m) values of m terms at normalised states (n, k)."""
    states = np.ascontiguousarray(normalised.T)
    columns = np.ones((len(terms), len(normalised)))
    for column, term in zip(columns, terms, strict=True):
        for state, power in zip(states, term, strict=True):
            if power:
                column *= state**power
    return np.ascontiguousarray(columns.T)


def stack(states: Mapping[str, FloatArray], names: Sequence[str]) -> FloatArray:
    """(n, k) the named states side by side; scalars count as one row. Raises KeyError for one that is not there."""
    return np.column_stack([np.atleast_1d(np.asarray(states[name], dtype=float)) for name in names])
