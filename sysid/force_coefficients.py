"""Force and moment coefficients that a flight demanded: accelerations and rates turned into CX ... Cn.

    CX..CZ = (m a - F_other) / (qbar S)
    Cl, Cm, Cn = (I w' + w x I w - M_other) / (qbar S b, c, b)

with the specific force a moved to the centre of gravity and w' by local polynomials (Klein and Morelli, "Aircraft System
Identification" (2006), ch. 5; dissertation eqs 2.17 ff).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

FloatArray = NDArray[np.float64]
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


def window(dt_s: float, cutoff_hz: float = CUTOFF_HZ) -> int:
    """Odd number of samples of a quadratic local fit with that cut-off at -3 dB (Schafer, IEEE Sig. Proc. Mag. 28, 2011)."""
    half = (3.0 * 0.5 / (dt_s * cutoff_hz) + 4.6) / 3.2
    return 2 * max(2, round(half)) + 1


def smooth(values: FloatArray, dt_s: float, cutoff_hz: float = CUTOFF_HZ, derivative: int = 0) -> FloatArray:
    """(n, ...) values or their time derivative by quadratic local fits along axis 0; shorter windows where n is small."""
    size = window(dt_s, cutoff_hz)
    if len(values) < size:
        size = len(values) - 1 + len(values) % 2
    if size < 3:
        return np.zeros_like(values) if derivative else values
    return np.asarray(savgol_filter(values, size, min(2, size - 1), deriv=derivative, delta=dt_s, axis=0))


def at_cg(specific_force: FloatArray, rates: FloatArray, rates_dot: FloatArray, arm_m: FloatArray) -> FloatArray:
    """Specific force (n, 3) at the CG from that felt by a sensor ``arm_m`` (3,) away from it, rates (n, 3)."""
    if not np.any(arm_m):
        return specific_force
    felt = np.cross(rates_dot, arm_m) + np.cross(rates, np.cross(rates, arm_m))
    return np.asarray(specific_force - felt)


def demanded(
    specific_force: FloatArray, rates: FloatArray, qbar: FloatArray, mass: MassProperties,
    other_force: FloatArray, other_moment: FloatArray, dt_s: float,
    arm_m: FloatArray | None = None, cutoff_hz: float = CUTOFF_HZ,
) -> FloatArray:  # fmt: skip
    """(n, 6) CX CY CZ Cl Cm Cn of one piece without a gap.

    specific_force (n, 3) m/s2 at the sensor, rates (n, 3) rad/s, qbar (n,) Pa; other_force (n, 3) N, other_moment (n, 3) N m:
    everything but aerodynamics (thrust), without gravity. Everything is smoothed by the same local fits.
    """
    rates_dot = smooth(rates, dt_s, cutoff_hz, derivative=1)
    omega = smooth(rates, dt_s, cutoff_hz)
    force = at_cg(specific_force, omega, rates_dot, np.zeros(3) if arm_m is None else arm_m)
    force = smooth(mass.mass * force - other_force, dt_s, cutoff_hz)
    angular = omega @ mass.inertia.T
    moment = rates_dot @ mass.inertia.T + np.cross(omega, angular) - smooth(other_moment, dt_s, cutoff_hz)
    pressure = smooth(qbar, dt_s, cutoff_hz)[:, None] * mass.S
    return np.hstack([force / pressure, moment / (pressure * mass.lengths)])
