"""Force and moment coefficients that a flight demanded: accelerations and rates turned into CX ... Cn.

    CX..CZ = (m a - F_other) / (qbar S)
    Cl, Cm, Cn = (I w' + w x I w - M_other) / (qbar S b, c, b)

with the specific force a moved to the centre of gravity and w' by local polynomials (Klein and Morelli, "Aircraft System
Identification" (2006), ch. 5; dissertation eqs 2.17 ff).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sysid.arrays import FloatArray

CUTOFF_HZ = 6.0
"""Default cut-off of differentiator and smoother: four times the fastest rigid-body mode of a 20 kg aeroplane."""


@dataclass(frozen=True)
class MassProperties:
    """Mass [kg], inertia (3, 3) [kg m2] about the CG in body axes (off-diagonal -Ixz), S [m2], b, c [m]."""

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
    """Samples m on either side of a local fit whose smoother has lost half of a wave's power at ``cutoff_hz``.

    The smoother's weights are a parabola; its transform 3 (sin x - x cos x)/x^3 is 1/sqrt(2) at x = 2 pi f m dt = 1.8.
    """
    return max(1, round(1.8 / (2.0 * np.pi * cutoff_hz * dt_s)))


def smooth(
    values: FloatArray, dt_s: float, cutoff_hz: float = CUTOFF_HZ, derivative: int = 0
) -> FloatArray:
    """(n, ...) smoothed values, or their time derivative, along axis 0; narrower fits towards the ends.

    The derivative is the slope of a straight line fitted to 2 m + 1 samples (Savitzky and Golay). It equals the true derivative
    averaged with parabolic weights, and those are the weights of the smoother: so a smoothed moment and a differentiated rate
    can be compared, even across a step of a surface.
    """
    n, widest = len(values), half_width(dt_s, cutoff_hz)
    flat = np.reshape(values, (n, -1))
    if n <= 2 * widest:
        return np.asarray(_narrowing(n, widest, dt_s, derivative) @ flat).reshape(np.shape(values))
    out, inner = np.empty(flat.shape), n - 2 * widest
    out[widest : n - widest] = sum(
        w * flat[k : k + inner] for k, w in enumerate(kernel(widest, dt_s, derivative).tolist())
    )
    # What is nearer to an end than the fit is wide: as in a stretch of which the fits narrow from both ends.
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
    """(2 m + 1,) weights of the smoother, or of the differentiator [1/s], over m samples to either side."""
    at = np.arange(-m, m + 1)
    if m == 0:
        return np.ones(1)
    square = float(np.sum(at**2))
    if derivative:
        return at / (square * dt_s)
    far = np.abs(at)
    # Sum of j over j > |i|, and half of |i|: what the pairs (j, -j) give sample i when the derivative is summed by trapezia.
    weight = 0.5 * (m * (m + 1) - far * (far + 1)) + 0.5 * far
    return np.asarray(weight / square)


def at_cg(
    specific_force: FloatArray, rates: FloatArray, rates_dot: FloatArray, arm_m: FloatArray
) -> FloatArray:
    """Specific force (n, 3) at the CG from that felt by a sensor ``arm_m`` (3,) away from it, rates (n, 3)."""
    if not np.any(arm_m):
        return specific_force
    felt = np.cross(rates_dot, arm_m) + np.cross(rates, np.cross(rates, arm_m))
    return np.asarray(specific_force - felt)


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

    specific_force (n, 3) m/s2 at the sensor, rates (n, 3) rad/s, qbar (n,) Pa; other_force (n, 3) N, other_moment (n, 3) N m:
    everything but aerodynamics (thrust), without gravity. Everything is smoothed by the same local fits.
    """
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
