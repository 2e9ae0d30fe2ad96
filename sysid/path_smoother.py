"""A Kalman filter and Rauch-Tung-Striebel smoother for the flight path, linearised about a given path. Pure numerics.

Repeating it about the smoothed path is Gauss-Newton on the posterior: noise of the inertial sensors (process noise) and
of the compared channels (measurement noise) are both allowed for, which plain output error does not do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.path_kinematics import NAMES, OUTPUTS, STATES, advance, outputs, slopes

FloatArray = NDArray[np.float64]
_D = len(STATES)
_ANGLES = (OUTPUTS.index("phi_rad"), OUTPUTS.index("psi_rad"))


@dataclass(frozen=True)
class Stretch:
    """drive (6, n) inputs at the CG; measured (12, n), NaN where nothing was logged; rows of the record it covers."""

    rows: slice
    drive: FloatArray
    measured: FloatArray


@dataclass(frozen=True)
class Noise:
    """Standard deviations. inputs (6,) per step; outputs (12,); wind_walk (m/s), gyro_walk (rad/s) per root second."""

    inputs: FloatArray
    outputs: FloatArray
    wind_walk: float = 0.0
    gyro_walk: float = 0.0


@dataclass(frozen=True)
class Pass:
    """Result over one stretch.

    path        (24, n) smoothed augmented vectors
    mean, cov   at the end of the stretch, (24,) and (24, 24)
    innovation  (12, n) innovation over its standard deviation, NaN where nothing was compared
    residual2   (12, n) squared smoothed residual plus its own variance: what the noise estimate needs
    loglik      log likelihood of the innovations
    """

    path: FloatArray
    mean: FloatArray
    cov: FloatArray
    innovation: FloatArray
    residual2: FloatArray
    loglik: float


def run(
    stretch: Stretch,
    nominal: FloatArray,
    mean: FloatArray,
    cov: FloatArray,
    noise: Noise,
    dt_s: float,
    smooth: bool = True,
) -> Pass:
    """Filter (and smooth) one stretch.

    nominal    (24, n) path about which everything is linearised
    mean, cov  prior at the stretch's first sample
    """
    n = nominal.shape[1]
    now, after = stretch.drive[:, :-1], stretch.drive[:, 1:]
    at = nominal[:, :-1]
    reached = advance(at, now, after, dt_s)
    transition = slopes(lambda z: advance(z, now, after, dt_s), at)
    # An input's noise acts like a bias that lasts one step.
    gain = transition[:, :, 12:18] * noise.inputs
    process = gain @ gain.transpose(0, 2, 1)
    expected = outputs(nominal)
    sensing = slopes(outputs, nominal)
    gap = stretch.measured - expected
    for k in _ANGLES:
        gap[k] = np.mod(gap[k] + np.pi, 2 * np.pi) - np.pi
    size = len(NAMES)
    means, covs = np.empty((n, size)), np.empty((n, size, size))
    ahead_means, ahead_covs = np.empty((n, size)), np.empty((n, size, size))
    innovation = np.full_like(gap, np.nan)
    present = np.isfinite(gap)
    variance = noise.outputs**2
    # Where a walk would set something free that stands fixed, it stays fixed.
    walk = np.zeros(size)
    walk[9:12], walk[15:18] = noise.wind_walk**2 * dt_s, noise.gyro_walk**2 * dt_s
    walk = np.where(np.diag(cov) > 0, walk, 0.0)
    loglik = 0.0
    m, p = mean.copy(), cov.copy()
    for k in range(n):
        ahead_means[k], ahead_covs[k] = m, p
        for c in np.flatnonzero(present[:, k]):
            h = sensing[k, c]
            ph = p @ h
            s = h @ ph + variance[c]
            nu = gap[c, k] - h @ (m - nominal[:, k])
            m = m + ph * (nu / s)
            p = p - ph[:, None] * (ph / s)
            innovation[c, k] = nu / np.sqrt(s)
            loglik -= 0.5 * (nu * nu / s + np.log(s))
        means[k], covs[k] = m, p
        if k < n - 1:
            f = transition[k]
            fp = f @ p
            ahead = m.copy()
            ahead[:_D] = reached[:, k] + f @ (m - at[:, k])
            q = p.copy()
            q[:_D, :_D] = fp @ f.T + process[k]
            q[:_D, _D:] = fp[:, _D:]
            q[_D:, :_D] = q[:_D, _D:].T
            q[np.arange(size), np.arange(size)] += walk
            m, p = ahead, q
    if not smooth:
        return Pass(means.T, m, p, innovation, np.full_like(gap, np.nan), loglik)
    path, spread = _smooth(means, covs, ahead_means, ahead_covs, transition)
    left = gap - np.einsum("kcz,kz->ck", sensing, path - nominal.T)
    own = np.einsum("kcz,kzy,kcy->ck", sensing, spread, sensing)
    return Pass(path.T, m, p, innovation, left**2 + own, loglik)


def _smooth(
    means: FloatArray, covs: FloatArray, ahead_means: FloatArray, ahead_covs: FloatArray, transition: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Backward pass over the whole augmented vector; returns (n, 24) means and (n, 24, 24) covariances."""
    path, spread = means.copy(), covs.copy()
    full = np.eye(means.shape[1])
    for k in range(len(means) - 2, -1, -1):
        full[:_D] = transition[k]
        # Parameters that stand fixed have no variance: a pseudo-inverse would be slow, a tiny ridge does the same.
        ahead = ahead_covs[k + 1] + 1e-18 * np.eye(len(full))
        back = np.linalg.solve(ahead, full @ covs[k]).T
        path[k] += back @ (path[k + 1] - ahead_means[k + 1])
        spread[k] += back @ (spread[k + 1] - ahead_covs[k + 1]) @ back.T
    return path, spread
