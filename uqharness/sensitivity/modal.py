"""The dissertation's modal example: the linear longitudinal model of the E-SPAARO and its study.

Hale 2016, section 4.7.1, in two readings. ``as_corrected`` is physics: the trim's sign is repaired
and CZ at trim is CZ_0 + CZ_alpha alpha + CZ_de de. ``as_published`` reproduces the printed tables:
CZ at trim begins with CX_0 in place of CZ_0, and "natural frequency" is zeta / sqrt(1 - zeta^2) of
the short period. In both the intervals are +-5 % about Table 2.6, because Table 4.3's are
misprinted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np

from sysid.arrays import FloatArray
from uqharness.sensitivity.analysis import Sensitivity, analyse, average
from uqharness.sensitivity.study import Study, run_study

Reading = Literal["as_corrected", "as_published"]
READINGS: tuple[Reading, ...] = ("as_corrected", "as_published")
OUTPUTS = ("phugoid_damping", "short_period_damping", "short_period_frequency")

V_MPS, RHO_KGPM3, G_MPS2 = 20.0, 1.225, 9.81
QBAR_PA = 0.5 * RHO_KGPM3 * V_MPS**2

# Table 2.6; per rad, CZ_de and Cm_de per degree, Cm_q per q c / 2V.
NOMINAL = {
    "CZ_0": -0.312,
    "CZ_alpha": -3.34,
    "CZ_de": 0.036,
    "CX_0": -0.038,
    "CX_alpha": 0.264,
    "CX_alpha2": 1.86,
    "Cm_0": 0.0104,
    "Cm_alpha": -0.487,
    "Cm_q": -13.8,
    "Cm_de": -0.014,
}
HALF_WIDTH = 0.05
# Table 4.2: mean and variance, normal.
ALEATORY = {
    "M_kg": (21.34, 0.2846),
    "S_m2": (1.97, 0.0024),
    "c_m": (0.53, 0.0002),
    "Iyy_kgm2": (8.26, 0.0426),
}


def intervals() -> dict[str, tuple[float, float]]:
    """Return the intervals +-5 % about the nominal values, in order."""
    return {
        name: (value - HALF_WIDTH * abs(value), value + HALF_WIDTH * abs(value))
        for name, value in NOMINAL.items()
    }


def trim(values: Mapping[str, Any]) -> tuple[FloatArray, FloatArray]:
    """Compute alpha [rad] and elevator [deg] of level flight by eqs 4.14 (repaired) and 4.15."""
    # Two linear equations in alpha and elevator.
    lift = -values["M_kg"] * G_MPS2 / (QBAR_PA * values["S_m2"]) - values["CZ_0"]
    det = values["CZ_alpha"] * values["Cm_de"] - values["CZ_de"] * values["Cm_alpha"]
    alpha = (lift * values["Cm_de"] + values["CZ_de"] * values["Cm_0"]) / det
    elevator = (-values["CZ_alpha"] * values["Cm_0"] - values["Cm_alpha"] * lift) / det
    return alpha, elevator


@dataclass(frozen=True)
class SystemMatrix:
    """Elements of eq. 4.9 that are not 0, 1 or -g, over (u, w, q, theta).

    Names are row and column from 1; each is an array.
    """

    a11: FloatArray
    a12: FloatArray
    a21: FloatArray
    a22: FloatArray
    a23: float
    a32: FloatArray
    a33: FloatArray

    def dense(self) -> FloatArray:
        """Return A (..., 4, 4)."""
        A = np.zeros((*np.broadcast(self.a11, self.a22, self.a32, self.a33).shape, 4, 4))
        A[..., 0, 0], A[..., 0, 1], A[..., 0, 3] = self.a11, self.a12, -G_MPS2
        A[..., 1, 0], A[..., 1, 1], A[..., 1, 2] = self.a21, self.a22, self.a23
        A[..., 2, 1], A[..., 2, 2], A[..., 3, 2] = self.a32, self.a33, 1.0
        return A


def system_matrix(reading: Reading, values: Mapping[str, Any]) -> SystemMatrix:
    """Compute eq. 4.9 for values that broadcast together."""
    alpha, elevator = trim(values)
    k = QBAR_PA * values["S_m2"] / (values["M_kg"] * V_MPS)
    pitch = QBAR_PA * values["S_m2"] * values["c_m"] / (values["Iyy_kgm2"] * V_MPS)
    CX = values["CX_0"] + values["CX_alpha"] * alpha + values["CX_alpha2"] * alpha**2  # (4.11)
    CX_alpha = values["CX_alpha"] + 2.0 * values["CX_alpha2"] * alpha  # (4.12)
    CZ_at_zero = values["CX_0"] if reading == "as_published" else values["CZ_0"]
    CZ = CZ_at_zero + values["CZ_alpha"] * alpha + values["CZ_de"] * elevator  # (4.13)
    return SystemMatrix(
        a11=2.0 * k * CX,
        a12=k * CX_alpha,
        a21=2.0 * k * CZ,
        a22=k * values["CZ_alpha"],
        a23=V_MPS,
        a32=pitch * values["Cm_alpha"],
        a33=0.5 * pitch * values["c_m"] * values["Cm_q"],
    )


def longitudinal_modes(A: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Compute damping [-] and frequency [rad/s] of phugoid and short period from A (..., 4, 4).

    The two slower eigenvalues are the phugoid. wn = sqrt(l1 l2) and zeta = -(l1 + l2) / 2 wn also
    hold for a pair that has split into two real roots. NaN without such a mode: real roots of
    opposite sign, and all four where a conjugate pair lies between two real roots (the third
    oscillatory mode of a statically unstable aircraft).
    """
    unsorted = np.linalg.eigvals(A)
    values = np.take_along_axis(unsorted, np.argsort(np.abs(unsorted), axis=-1), axis=-1)
    # Conjugates have equal moduli up to rounding, so a pair that was split shows on both sides.
    is_split = (values[..., 0].imag == 0) & (values[..., 1].imag != 0)
    values = np.where(is_split[..., None], np.nan, values)
    slow, fast = values[..., :2], values[..., 2:]
    return *_damping(-slow.sum(axis=-1).real, slow.prod(axis=-1).real), *_damping(
        -fast.sum(axis=-1).real, fast.prod(axis=-1).real
    )


def _damping(r: FloatArray, s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return zeta and wn of l^2 + r l + s."""
    wn = np.sqrt(np.where(s > 0.0, s, np.nan))
    return r / (2.0 * wn), wn


def modes_of(matrix: SystemMatrix) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Compute `longitudinal_modes` of a system matrix, twenty times as fast.

    The characteristic polynomial is split into a slow and a fast quadratic by Lin's iteration,
    which gains two digits per iteration for an aeroplane's modes; without convergence eigenvalues
    are used.
    """
    a11, a12, a21, a22, a23, a32, a33 = (getattr(matrix, field.name) for field in fields(matrix))
    # |l I - A| = l^4 + c3 l^3 + c2 l^2 + c1 l + c0
    force = a11 * a22 - a12 * a21
    c3 = -(a11 + a22 + a33)
    c2 = force + a33 * (a11 + a22) - a32 * a23
    c1 = -a33 * force + a32 * a23 * a11
    c0 = G_MPS2 * a21 * a32
    with np.errstate(all="ignore"):
        # Lin's iteration from the slow quadratic's leading coefficients.
        r, s = c1 / c2, c0 / c2
        for _ in range(12):
            previous_r = r
            m = c3 - r
            n = c2 - s - r * m
            s = c0 / n
            r = (c1 - s * m) / n
        m = c3 - r
        n = c2 - s - r * m
        has_converged = (np.abs(r - previous_r) <= 1e-13 * np.abs(m)) & (np.abs(s) < np.abs(n))
    modes = np.array([*_damping(r, s), *_damping(m, n)])
    if not np.all(has_converged):
        modes[:, ~has_converged] = np.array(longitudinal_modes(matrix.dense()))[:, ~has_converged]
    return modes[0], modes[1], modes[2], modes[3]


def modal_model(reading: Reading) -> Callable[..., dict[str, FloatArray]]:
    """Return the model as a function of its fourteen values by name, with three outputs."""

    def outputs(**values: FloatArray) -> dict[str, FloatArray]:
        """Compute damping of the phugoid, damping and frequency of the short period."""
        phugoid_zeta, _, zeta, wn = modes_of(system_matrix(reading, values))
        if reading == "as_published":
            wn = zeta / np.sqrt(np.where(zeta < 1.0, 1.0 - zeta**2, np.nan))
        return dict(zip(OUTPUTS, (phugoid_zeta, zeta, wn), strict=True))

    return outputs


def run_modal_study(
    reading: Reading,
    samples: int = 1024,
    draws: int = 100,
    seed: int = 0,
    on_progress: Callable[[int, int], None] | None = None,
) -> Study:
    """Run the chapter's study: ten intervals, four normal variables.

    Finite differences take 1 % of the nominal value.
    """
    from scipy import stats

    return run_study(
        modal_model(reading),
        intervals(),
        {name: stats.norm(mean, variance**0.5) for name, (mean, variance) in ALEATORY.items()},
        nominal=NOMINAL,
        step={name: 0.01 * value for name, value in NOMINAL.items()},
        samples=samples,
        draws=draws,
        seed=seed,
        on_progress=on_progress,
    )


def modal_sensitivity(
    reading: Reading,
    repeats: int,
    seed: int = 0,
    on_progress: Callable[[int, int], None] | None = None,
) -> Sensitivity:
    """Average independent repeats of the chapter's study, indices with the interval of the mean."""
    results = []
    for k, stream in enumerate(np.random.SeedSequence(seed).spawn(repeats)):
        number = int(stream.generate_state(1)[0])
        results.append(analyse(run_modal_study(reading, seed=number), intervals=False))
        if on_progress is not None:
            on_progress(k + 1, repeats)
    return average(results)
