"""Force and moment coefficients that a flight demanded: accelerations and rates turned into CX ...
Cn.

    CX..CZ = (m a - F_other) / (qbar S)
    Cl, Cm, Cn = (I w' + w x I w - M_other) / (qbar S b, c, b)

with the specific force a moved to the centre of gravity and w' by local polynomials (Klein and
Morelli, "Aircraft System Identification" (2006), ch. 5; dissertation eqs 2.17 ff)."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sysid.arrays import FloatArray

CUTOFF_HZ = 6.0
"""Default cut-off of differentiator and smoother: four times the fastest rigid-body mode of a 20 kg
aeroplane.
"""


@dataclass(frozen=True)
class MassProperties:
    """Mass [kg], inertia (3, 3) [kg m2] about the CG in body axes (off-diagonal -Ixz), S [m2], b, c
    [m].
    """

    mass: float
    inertia: FloatArray
    S: float
    b: float
    c: float

    @property
    def lengths(self) -> FloatArray:
        """b, c, b: what the moments are made dimensionless by."""
        return np.array([self.b, self.c, self.b])


def half_width(dt_s: float, cutoff_hz: float = CUTOFF_HZ) -> int:
    """Samples m on either side of a local fit whose smoother has lost half of a wave's power at
    ``cutoff_hz``.

    The smoother's weights are a parabola; its transform 3 (sin x - x cos x)/x^3 is 1/sqrt(2) at x =
    2 pi f m dt = 1.8."""
    return max(1, round(1.8 / (2.0 * np.pi * cutoff_hz * dt_s)))


def smooth(
    values: FloatArray, dt_s: float, cutoff_hz: float = CUTOFF_HZ, derivative: int = 0
) -> FloatArray:
    """(n, ...) smoothed values, or their time derivative, along axis 0; narrower fits towards the
    ends.

    The derivative is the slope of a straight line fitted to 2 m + 1 samples (Savitzky and Golay).
    It equals the true derivative averaged with parabolic weights, and those are the weights of the
    smoother: so a smoothed moment and a differentiated rate can be compared, even across a step of
    a surface."""
    n, widest = len(values), half_width(dt_s, cutoff_hz)
    flat = np.reshape(values, (n, -1))
    if n <= 2 * widest:
        return np.asarray(_narrowing(n, widest, dt_s, derivative) @ flat).reshape(np.shape(values))
    out, inner = np.empty(flat.shape), n - 2 * widest
    out[widest : n - widest] = sum(
        w * flat[k : k + inner] for k, w in enumerate(kernel(widest, dt_s, derivative).tolist())
    )
    # What is nearer to an end than the fit is wide: as in a stretch of which the fits narrow from
    # both ends.
    ends = _narrowing(2 * widest, widest, dt_s, derivative)
    out[:widest] = ends[:widest] @ flat[: 2 * widest]
    out[n - widest :] = ends[widest:] @ flat[inner:]
    return out.reshape(np.shape(values))


@lru_cache(64)
def _narrowing(n: int, widest: int, dt_s: float, derivative: int) -> FloatArray:
    """(n, n) weights of fits that narrow towards both ends of n samples."""
    out = np.zeros((n, n))
    for k in range(n):
        m = min(widest, k, n - 1 - k)
        if m == 0 and derivative:
            if n > 1:
                a = 0 if k == 0 else n - 2
                out[k, a : a + 2] = -1.0 / dt_s, 1.0 / dt_s
        else:
            out[k, k - m : k + m + 1] = kernel(m, dt_s, derivative)
    return out


def kernel(m: int, dt_s: float, derivative: int = 0) -> FloatArray:
    """(2 m + 1,) weights of the smoother, or of the differentiator [1/s], over m samples to either
    side.
    """
    at = np.arange(-m, m + 1)
    if m == 0:
        return np.ones(1)
    square = float(np.sum(at**2))
    if derivative:
        return at / (square * dt_s)
    distance = np.abs(at)
    # Sum of j over j > |i|, and half of |i|: what the pairs (j, -j) give sample i when the
    # derivative is summed by trapezia.
    weight = 0.5 * (m * (m + 1) - distance * (distance + 1)) + 0.5 * distance
    return np.asarray(weight / square)


def at_cg(
    specific_force: FloatArray, rates: FloatArray, rates_dot: FloatArray, arm_m: FloatArray
) -> FloatArray:
    """Specific force (n, 3) at the CG from that felt by a sensor ``arm_m`` (3,) away from it, rates
    (n, 3).
    """
    if not np.any(arm_m):
        return specific_force
    lever_acceleration = np.cross(rates_dot, arm_m) + np.cross(rates, np.cross(rates, arm_m))
    return np.asarray(specific_force - lever_acceleration)


def demanded(
    specific_force: FloatArray,
    rates: FloatArray,
    qbar: FloatArray,
    mass: MassProperties,
    other_force: FloatArray,
    other_moment: FloatArray,
    dt_s: float,
    arm_m: FloatArray | None = None,
    cutoff_hz: float = CUTOFF_HZ,
) -> FloatArray:
    """(n, 6) CX CY CZ Cl Cm Cn of one piece without a gap.

    specific_force (n, 3) m/s2 at the sensor, rates (n, 3) rad/s, qbar (n,) Pa; other_force (n, 3)
    N, other_moment (n, 3) N m: everything but aerodynamics (thrust), without gravity. Everything is
    smoothed by the same local fits."""
    rates_dot = smooth(rates, dt_s, cutoff_hz, derivative=1)
    omega = smooth(rates, dt_s, cutoff_hz)
    force = at_cg(specific_force, omega, rates_dot, np.zeros(3) if arm_m is None else arm_m)
    force = smooth(mass.mass * force - other_force, dt_s, cutoff_hz)
    angular = omega @ mass.inertia.T
    moment = (
        rates_dot @ mass.inertia.T
        + np.cross(omega, angular)
        - smooth(other_moment, dt_s, cutoff_hz)
    )
    pressure = smooth(qbar, dt_s, cutoff_hz)[:, None] * mass.S
    return np.hstack([force / pressure, moment / (pressure * mass.lengths)])


# Coefficient terms by name: ``Cm_alpha2`` is alpha^2 in the pitching moment. The variables of a
# linear-in-parameters model.

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
    """('Cm', 'alpha2') of ``aero/Cm_alpha2`` or ``Cm_alpha2``; None when it is no coefficient term
    with a known variable.
    """
    coefficient, underscore, term = name.removeprefix("aero/").partition("_")
    if not underscore or coefficient not in COEFFICIENTS:
        return None
    return (coefficient, term) if term == "0" or term in _POWERS or term in _VARIABLES else None


def regressor(term: str, variables: Mapping[str, FloatArray]) -> FloatArray:
    """(n,) values of a term; ``variables`` alpha, beta [rad], p_hat, q_hat, r_hat, de, da, dr
    [deg], each (n,).

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
    """The variables of `regressor` from V [m/s], angles [rad], rates [rad/s], deflections [deg],
    span and chord [m].
    """
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
"""Flight states that a model form may depend on: measured in flight, known to a simulation at every
step.
"""
MAX_POWER = 4
_FACTOR = re.compile(r"([A-Za-z_]+)(?:\^([1-9]))?")
Term = tuple[int, ...]


def term_name(term: Term, states: Sequence[str]) -> str:
    """``alpha_rad^2`` of (0, 2, 0, 0) over V, alpha, q, theta; ``1`` of all zeros."""
    factors = [s if n == 1 else f"{s}^{n}" for s, n in zip(states, term, strict=True) if n]
    return "*".join(factors) or "1"


def parse_term(name: str, states: Sequence[str]) -> Term:
    """The powers of each state in a term.

    Raises ValueError for an unknown state, a bad power or bad writing.
    """
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
    """All terms up to total ``order`` in ``count`` states: constant, linear, then quadratic ones
    (15 for four states).
    """
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
    """(n, k) the named states side by side; scalars count as one row.

    Raises KeyError for one that is not there.
    """
    return np.column_stack([np.atleast_1d(np.asarray(states[name], dtype=float)) for name in names])
