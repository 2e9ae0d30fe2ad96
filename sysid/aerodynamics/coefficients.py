"""Force and moment coefficients that a flight demanded, and the terms of coefficient models.

Measured accelerations and rates give CX ... Cn:

    CX..CZ = (m a - F_other) / (qbar S)
    Cl, Cm, Cn = (I w' + w x I w - M_other) / (qbar S b, c, b)

with the specific force a moved to the centre of gravity and w' by local polynomials (Klein and
Morelli, "Aircraft System Identification" (2006), ch. 5; dissertation eqs 2.17 ff). The module also
names the regressors of linear models (``Cm_alpha2``) and polynomial terms in flight states
(``V_mps*alpha_rad``). Residuals, model forms and equation error use it.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sysid.arrays import FloatArray

CUTOFF_HZ = 6.0
"""Default half-power frequency of differentiator and smoother [Hz].

Four times the fastest rigid-body mode of a 20 kg aeroplane.
"""


@dataclass(frozen=True)
class MassProperties:
    """Mass properties and reference geometry.

    Attributes
    ----------
    mass : float
        [kg].
    inertia : array (3, 3)
        About the CG in body axes [kg m2]; the off-diagonal element is -Ixz.
    S, b, c : float
        Wing area [m2], span and chord [m].
    """

    mass: float
    inertia: FloatArray
    S: float
    b: float
    c: float

    @property
    def lengths(self) -> FloatArray:
        """Reference lengths b, c, b [m] of Cl, Cm, Cn."""
        return np.array([self.b, self.c, self.b])


def half_width(dt_s: float, cutoff_hz: float = CUTOFF_HZ) -> int:
    """Return the half-width m of the smoother, in samples, that has its half-power at
    ``cutoff_hz``.

    The smoother's weights are a parabola. Its transform 3 (sin x - x cos x)/x^3 is 1/sqrt(2) at
    x = 2 pi f m dt = 1.8.

    Examples
    --------
    >>> half_width(0.02, 6.0)
    2
    """
    return max(1, round(1.8 / (2.0 * np.pi * cutoff_hz * dt_s)))


def smooth(
    values: FloatArray, dt_s: float, cutoff_hz: float = CUTOFF_HZ, derivative: int = 0
) -> FloatArray:
    """Smooth or differentiate values along axis 0 by local straight-line fits.

    The derivative is the slope of a straight line fitted to 2 m + 1 samples (Savitzky and Golay).
    It equals the true derivative averaged with parabolic weights, which are the weights of the
    smoother. So a smoothed moment and a differentiated rate are comparable, even across a step of a
    surface.

    Parameters
    ----------
    values : array (n, ...)
        Samples without a gap.
    dt_s : float
        Step [s].
    cutoff_hz : float
        Half-power frequency [Hz].
    derivative : int
        0 smooths, 1 differentiates.

    Returns
    -------
    array (n, ...)
        In the unit of ``values``, or per second. Fits narrow towards the ends, where noise is
        larger.

    Examples
    --------
    >>> import numpy as np
    >>> t = 0.02 * np.arange(20)
    >>> bool(np.allclose(smooth(3.0 * t, 0.02, derivative=1), 3.0))
    True
    """
    n, widest = len(values), half_width(dt_s, cutoff_hz)
    flat = np.reshape(values, (n, -1))
    if n <= 2 * widest:
        return np.asarray(_narrowing(n, widest, dt_s, derivative) @ flat).reshape(np.shape(values))
    out, inner = np.empty(flat.shape), n - 2 * widest
    out[widest : n - widest] = sum(
        w * flat[k : k + inner] for k, w in enumerate(kernel(widest, dt_s, derivative).tolist())
    )
    # The samples within m of an end have narrower fits, as in a piece of 2 m samples.
    ends = _narrowing(2 * widest, widest, dt_s, derivative)
    out[:widest] = ends[:widest] @ flat[: 2 * widest]
    out[n - widest :] = ends[widest:] @ flat[inner:]
    return out.reshape(np.shape(values))


@lru_cache(64)
def _narrowing(n: int, widest: int, dt_s: float, derivative: int) -> FloatArray:
    """Return weights (n, n) of fits that narrow towards both ends of n samples."""
    out = np.zeros((n, n))
    # Narrow symmetric fits; at the ends of a derivative a difference of two samples.
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
    """Return weights (2 m + 1,) of the smoother, or of the differentiator [1/s]."""
    at = np.arange(-m, m + 1)
    if m == 0:
        return np.ones(1)
    square = float(np.sum(at**2))
    if derivative:
        return at / (square * dt_s)
    distance = np.abs(at)
    # Each pair (j, -j) contributes its slope to all samples between: the weight of sample i is the
    # sum of j over j > |i| and half of |i|, by the trapezoidal rule.
    weight = 0.5 * (m * (m + 1) - distance * (distance + 1)) + 0.5 * distance
    return np.asarray(weight / square)


def at_cg(
    specific_force: FloatArray, rates: FloatArray, rates_dot: FloatArray, arm_m: FloatArray
) -> FloatArray:
    """Move the specific force (n, 3) [m/s2] of a sensor at ``arm_m`` (3,) from the CG to the CG.

    ``rates`` and ``rates_dot`` (n, 3) are the angular rates [rad/s] and accelerations [rad/s2].
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
    *,
    dt_s: float,
    arm_m: FloatArray | None = None,
    cutoff_hz: float = CUTOFF_HZ,
) -> FloatArray:
    """Compute the coefficients that one piece of a flight demanded.

    All inputs pass the same local fits.

    Parameters
    ----------
    specific_force : array (n, 3)
        At the sensor, body axes [m/s2].
    rates : array (n, 3)
        p, q, r [rad/s].
    qbar : array (n,)
        Dynamic pressure [Pa].
    mass : MassProperties
        Mass, inertia and reference lengths.
    other_force, other_moment : array (n, 3)
        Everything but aerodynamics and gravity, thrust above all [N, N m].
    dt_s : float
        Step [s]; the piece has no gap.
    arm_m : array (3,), optional
        Sensor from the CG [m].
    cutoff_hz : float
        Half-power frequency of the fits [Hz].

    Returns
    -------
    array (n, 6)
        CX CY CZ Cl Cm Cn [-], body axes (CZ down), moments about the CG.
    """
    # Angular acceleration, force at the CG, and Euler's equations, all behind the same filter.
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


# Terms of linear coefficient models by name: ``Cm_alpha2`` is alpha^2 in the pitching moment.

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
    """Split ``aero/Cm_alpha2`` or ``Cm_alpha2`` into ('Cm', 'alpha2').

    Returns None for names that are no coefficient term.

    Examples
    --------
    >>> split_name("aero/Cm_alpha2")
    ('Cm', 'alpha2')
    """
    coefficient, underscore, term = name.removeprefix("aero/").partition("_")
    if not underscore or coefficient not in COEFFICIENTS:
        return None
    return (coefficient, term) if term == "0" or term in _POWERS or term in _VARIABLES else None


def regressor(term: str, variables: Mapping[str, FloatArray]) -> FloatArray:
    """Evaluate a term (n,) from ``variables``, each (n,).

    The variables are alpha, beta [rad], p_hat, q_hat, r_hat [-], de, da, dr [deg]. Raises KeyError
    for a term that `split_name` does not accept.
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
    *,
    b: float,
    c: float,
) -> dict[str, FloatArray]:
    """Compute the variables of `regressor`.

    Parameters
    ----------
    V : array (n,)
        Airspeed [m/s].
    alpha, beta : array (n,)
        [rad].
    p, q, r : array (n,)
        [rad/s].
    de, da, dr : array (n,)
        Deflections [deg].
    b, c : float
        Span and chord [m].

    Returns
    -------
    dict of str to array (n,)
        alpha, beta [rad], p_hat = p b/2V, q_hat = q c/2V, r_hat = r b/2V [-], de, da, dr [deg].
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
# conditioned only in z (a fourth power of 22 m/s next to one of 0.02 rad).

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
"""Flight states on which a model form may depend: measured in flight, available in a simulation."""
MAX_POWER = 4
"""Largest power of a state in a term."""
_FACTOR = re.compile(r"([A-Za-z_]+)(?:\^([1-9]))?")
Term = tuple[int, ...]


def term_name(term: Term, states: Sequence[str]) -> str:
    """Return the name of a term, ``alpha_rad^2`` for (0, 2, 0, 0) over V, alpha, q, theta.

    Examples
    --------
    >>> term_name((1, 2), ("V_mps", "alpha_rad"))
    'V_mps*alpha_rad^2'
    >>> term_name((0, 0), ("V_mps", "alpha_rad"))
    '1'
    """
    factors = [s if n == 1 else f"{s}^{n}" for s, n in zip(states, term, strict=True) if n]
    return "*".join(factors) or "1"


def parse_term(name: str, states: Sequence[str]) -> Term:
    """Return the power of each state in a named term, the inverse of `term_name`.

    Raises ValueError for an unknown state, a power out of range or a malformed name.

    Examples
    --------
    >>> parse_term("V_mps*alpha_rad^2", ("V_mps", "alpha_rad"))
    (1, 2)
    """
    powers = dict.fromkeys(states, 0)
    if name.strip() == "1":
        return tuple(powers.values())
    # Powers of repeated states add up.
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
    """Return all terms of ``count`` states up to total ``order``: constant, linear, quadratic ...

    Examples
    --------
    >>> full_polynomial(2, 1)
    ((0, 0), (1, 0), (0, 1))
    """
    out: list[Term] = []
    for degree in range(order + 1):
        for factors in itertools.combinations_with_replacement(range(count), degree):
            out.append(tuple(factors.count(k) for k in range(count)))
    return tuple(out)


def regressors(normalised: FloatArray, terms: Sequence[Term]) -> FloatArray:
    """Evaluate m terms at normalised states (n, k), giving (n, m)."""
    states = np.ascontiguousarray(normalised.T)
    columns = np.ones((len(terms), len(normalised)))
    for column, term in zip(columns, terms, strict=True):
        for state, power in zip(states, term, strict=True):
            if power:
                column *= state**power
    return np.ascontiguousarray(columns.T)


def stack(states: Mapping[str, FloatArray], names: Sequence[str]) -> FloatArray:
    """Stack the named states as columns (n, k); scalars count as one row.

    Raises KeyError for a missing state.
    """
    return np.column_stack([np.atleast_1d(np.asarray(states[name], dtype=float)) for name in names])
