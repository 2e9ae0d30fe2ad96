"""Dryden turbulence after MIL-F-8785C, low altitude (10 to 1000 ft): spectra, standard deviations and sampled gusts.

Axes: x along the flight path (level: along the heading), y right, z down. ``u, v, w`` is the velocity of the air;
``p, q, r`` the rotation of the AIR: q = -dw/dx and r = +dv/dx, smoothed over the span. An aircraft's aerodynamics see
its own rates less these.

The gusts are samples of the continuous process, exact at any step: the state moves by the matrix exponential, the
noise of a step has the covariance of the integral, and the first sample is drawn from the stationary distribution.
q comes from the noise of w and r from that of v, so that they belong together. Paragraphs: MIL-F-8785C (1980).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.linalg import cholesky, expm, qr, solve_continuous_lyapunov
from scipy.signal import lfilter

from sysid.units import FT_M, KT_MPS
from uqharness.errors import BadInputError

Array = npt.NDArray[np.float64]
Component = Literal["u", "v", "w", "p", "q", "r"]
COMPONENTS: tuple[Component, ...] = ("u", "v", "w", "p", "q", "r")

_STREAMS = {"u": 0, "v": 1, "w": 2, "p": 3}
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


@dataclass(frozen=True)
class GustSeries:
    """Gusts in heading axes at a fixed step, arrays of shape (n,)."""

    dt_s: float
    u_mps: Array
    v_mps: Array
    w_mps: Array
    p_radps: Array
    q_radps: Array
    r_radps: Array

    def component(self, name: Component) -> Array:
        """One of u, v, w, p, q, r by its letter."""
        series: Array = getattr(self, f"{name}_mps" if name in "uvw" else f"{name}_radps")
        return series


@dataclass(frozen=True)
class DrydenParameters:
    """Scales of the turbulence at one height, airspeed and span."""

    V_mps: float
    b_m: float
    L_u_m: float
    L_w_m: float
    sigma_u_mps: float
    sigma_w_mps: float
    sigma_p_radps: float
    T_p_s: float
    T_q_s: float
    T_r_s: float


def dryden_parameters(V_mps: float, h_m: float, W20_kt: float, b_m: float) -> DrydenParameters:
    """Scale lengths, intensities and the span's time constants.

    ``h_m`` is the height above the ground; below 10 ft the values of 10 ft hold. L_v = L_u and sigma_v = sigma_u.
    """
    _positive(V_mps=V_mps, b_m=b_m)
    if not W20_kt >= 0.0:
        raise BadInputError(f"W20_kt = {W20_kt}: the wind at 20 ft is 0 or more knots")
    if not h_m <= 1000.0 * FT_M:
        raise BadInputError(f"h_m = {h_m}: the low-altitude model reaches from the ground to 304.8 m (1000 ft)")
    h_ft = max(h_m / FT_M, 10.0)
    profile = 0.177 + 0.000823 * h_ft
    L_w = h_ft * FT_M  # 3.7.3.4, figure 10: L_w = h
    L_u = h_ft / profile**1.2 * FT_M  # 3.7.3.4, figure 10: L_u = L_v
    sigma_w = 0.1 * W20_kt * KT_MPS  # 3.7.3.4: sigma_w = 0.1 u20
    sigma_u = sigma_w / profile**0.4  # 3.7.3.4, figure 11: sigma_u = sigma_v
    T_p = 4.0 * b_m / (np.pi * V_mps)
    # 3.7.5, Phi_p: sigma_p^2 = integral of sigma_w^2/(V L_w) 0.8 (pi L_w/4b)^(1/3) / (1 + (4 b w/pi V)^2) over w from 0
    sigma_p = sigma_w * np.sqrt(0.8 * (np.pi * L_w / (4.0 * b_m)) ** (1 / 3) * np.pi / (2.0 * T_p) / (V_mps * L_w))
    return DrydenParameters(
        V_mps=V_mps,
        b_m=b_m,
        L_u_m=L_u,
        L_w_m=L_w,
        sigma_u_mps=sigma_u,
        sigma_w_mps=sigma_w,
        sigma_p_radps=float(sigma_p),
        T_p_s=T_p,
        T_q_s=4.0 * b_m / (np.pi * V_mps),  # 3.7.5, Phi_q
        T_r_s=3.0 * b_m / (np.pi * V_mps),  # 3.7.5, Phi_r
    )


def dryden_psd(component: Component, omega_radps: npt.ArrayLike, V_mps: float, h_m: float, W20_kt: float, b_m: float) -> Array:
    """One-sided spectral density over angular frequency; its integral from 0 to infinity is the variance.

    Unit (m/s)^2 s for u, v, w and (rad/s)^2 s for p, q, r.
    """
    par = dryden_parameters(V_mps, h_m, W20_kt, b_m)
    omega = np.asarray(omega_radps, dtype=np.float64)
    if component == "u":
        T = par.L_u_m / V_mps
        return par.sigma_u_mps**2 * 2.0 * T / np.pi / (1.0 + (T * omega) ** 2)  # 3.7.1.2, Phi_u
    if component == "v":
        return _lateral_psd(omega, par.sigma_u_mps, par.L_u_m / V_mps)  # 3.7.1.2, Phi_v
    if component == "w":
        return _lateral_psd(omega, par.sigma_w_mps, par.L_w_m / V_mps)  # 3.7.1.2, Phi_w
    if component == "p":
        return par.sigma_p_radps**2 * 2.0 * par.T_p_s / np.pi / (1.0 + (par.T_p_s * omega) ** 2)  # 3.7.5, Phi_p
    if component == "q":
        w_psd = _lateral_psd(omega, par.sigma_w_mps, par.L_w_m / V_mps)
        return (omega / V_mps) ** 2 / (1.0 + (par.T_q_s * omega) ** 2) * w_psd  # 3.7.5, Phi_q
    if component == "r":
        v_psd = _lateral_psd(omega, par.sigma_u_mps, par.L_u_m / V_mps)
        return (omega / V_mps) ** 2 / (1.0 + (par.T_r_s * omega) ** 2) * v_psd  # 3.7.5, Phi_r
    raise BadInputError(f"component '{component}': expected one of {', '.join(COMPONENTS)}")


def dryden_sigma(component: Component, V_mps: float, h_m: float, W20_kt: float, b_m: float) -> float:
    """Standard deviation: the root of the spectrum's integral, in closed form for all six."""
    par = dryden_parameters(V_mps, h_m, W20_kt, b_m)
    if component in ("u", "v"):
        return par.sigma_u_mps
    if component == "w":
        return par.sigma_w_mps
    if component == "p":
        return par.sigma_p_radps
    if component == "q":
        return _gradient_sigma(par.sigma_w_mps, par.L_w_m, par.T_q_s * V_mps)
    if component == "r":
        return _gradient_sigma(par.sigma_u_mps, par.L_u_m, par.T_r_s * V_mps)
    raise BadInputError(f"component '{component}': expected one of {', '.join(COMPONENTS)}")


def dryden_gusts(n: int, dt_s: float, V_mps: float, h_m: float, W20_kt: float, b_m: float, seed: int | Sequence[int]) -> GustSeries:
    """``n`` samples of all six gusts at constant airspeed and height.

    ``seed`` is the root seed or a sequence that begins with it, such as (root, aleatory id). u, v with r, w with q, and
    p draw from a Philox stream each; W20 scales the result and nothing else: all intensities share one history.
    """
    return next(gust_blocks(n, dt_s, V_mps, h_m, W20_kt, b_m, seed, max(n, 1)))


def gust_blocks(
    n: int, dt_s: float, V_mps: float, h_m: float, W20_kt: float, b_m: float, seed: int | Sequence[int], block: int
) -> Iterator[GustSeries]:
    """The same ``n`` samples, to the bit, as series of at most ``block``: the memory of a day is that of a block."""
    _positive(dt_s=dt_s)
    if n < 1:
        raise BadInputError(f"n = {n}: at least one sample is needed")
    par = dryden_parameters(V_mps, h_m, W20_kt, b_m)
    u = _FirstOrder(dt_s, par.L_u_m / V_mps, _generator(seed, "u"))
    v = _Lateral(dt_s, par.L_u_m / V_mps, par.T_r_s, _generator(seed, "v"))
    w = _Lateral(dt_s, par.L_w_m / V_mps, par.T_q_s, _generator(seed, "w"))
    p = _FirstOrder(dt_s, par.T_p_s, _generator(seed, "p"))
    for first in range(0, n, block):
        size = min(block, n - first)
        v_unit, v_slope = v.take(size)
        w_unit, w_slope = w.take(size)
        yield GustSeries(
            dt_s=dt_s,
            u_mps=par.sigma_u_mps * u.take(size),
            v_mps=par.sigma_u_mps * v_unit,
            w_mps=par.sigma_w_mps * w_unit,
            p_radps=par.sigma_p_radps * p.take(size),
            q_radps=-par.sigma_w_mps / V_mps * w_slope,  # 3.7.5: q = -dw/dx = -(dw/dt)/V
            r_radps=par.sigma_u_mps / V_mps * v_slope,  # 3.7.5: r = +dv/dx = +(dv/dt)/V
        )


def _lateral_psd(omega: Array, sigma: float, T: float) -> Array:
    square = (T * omega) ** 2
    return sigma**2 * T / np.pi * (1.0 + 3.0 * square) / (1.0 + square) ** 2


def _gradient_sigma(sigma: float, L: float, smoothing: float) -> float:
    # Integral of (w/V)^2/(1 + (smoothing w/V)^2) Phi by partial fractions, rho = smoothing/L.
    rho = smoothing / L
    return float(sigma / L * np.sqrt(0.5 * (3.0 / rho - 5.0 / (1.0 + rho) + (1.0 + 2.0 * rho) / (1.0 + rho) ** 2)))


def _generator(seed: int | Sequence[int], name: str) -> np.random.Generator:
    entropy = [int(seed)] if isinstance(seed, int | np.integer) else [int(part) for part in seed]
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(entropy, spawn_key=(_STREAMS[name],))))


class _FirstOrder:
    """Unit-variance first-order process, a stretch at a time: x' = e^(-dt/T) x + noise."""

    def __init__(self, dt: float, T: float, rng: np.random.Generator) -> None:
        self._rng = rng
        self._keep = np.exp(-dt / T)
        self._spread = np.sqrt(-np.expm1(-2.0 * dt / T))
        self._carried = np.zeros(1)
        self._begun = False

    def take(self, n: int) -> Array:
        noise = self._rng.standard_normal(n)
        noise[0 if self._begun else 1 :] *= self._spread
        self._begun = True
        # The filter's own memory goes on into the next stretch, so that a block's end is no place where rounding differs.
        out, self._carried = lfilter([1.0], [1.0, -self._keep], noise, zi=self._carried)
        return np.asarray(out)


class _Lateral:
    """Unit-variance w of the lateral spectrum, and dw/dt smoothed by 1/(1 + T_span s), a stretch at a time.

    States (z1, z2, y): z1 = 1/(1 + T s) noise, z2 = 1/(1 + T s) z1, y = 1/(1 + T_span s) w, with
    w = sqrt(T) (1 + sqrt(3) T s)/(1 + T s)^2 noise = sqrt(T) (sqrt(3) z1 + (1 - sqrt(3)) z2).
    The transition matrix is lower triangular: three passes of lfilter.
    """

    def __init__(self, dt: float, T: float, T_span: float, rng: np.random.Generator) -> None:
        self._to_w, self._step, self._factor, self._spread = _lateral_matrices(dt, T, T_span)
        self._T_span, self._rng = T_span, rng
        self._carried = [np.zeros(1) for _ in range(3)]
        self._last: Array | None = None

    def take(self, n: int) -> tuple[Array, Array]:
        # A row for each source: columns of the array as drawn would be read with strides.
        noise = np.ascontiguousarray(self._rng.standard_normal((n, 3)).T)
        step, factor, last = self._step, self._factor, self._last
        states = np.empty((3, n))
        # Sums written out: a threaded matrix product may round differently with the number of threads.
        for i in range(3):
            drive = factor[0, i] * noise[0]
            for j in range(1, i + 1):
                drive += factor[j, i] * noise[j]
            if last is None:
                drive[0] = (self._spread @ noise[:, 0])[i]
            for j in range(i):
                drive[1:] += step[i, j] * states[j, :-1]
                if last is not None:
                    drive[0] += step[i, j] * last[j]
            states[i], self._carried[i] = lfilter([1.0], [1.0, -step[i, i]], drive, zi=self._carried[i])
        self._last = states[:, -1].copy()
        w = self._to_w[0] * states[0] + self._to_w[1] * states[1]
        return w, (w - states[2]) / self._T_span


@lru_cache(maxsize=64)
def _lateral_matrices(dt: float, T: float, T_span: float) -> tuple[Array, Array, Array, Array]:
    """Output row of w, transition matrix, factor of the step's noise, factor of the stationary covariance."""
    to_w = np.sqrt(T) * np.array([np.sqrt(3.0), 1.0 - np.sqrt(3.0), 0.0])
    A = np.array([[-1.0 / T, 0.0, 0.0], [1.0 / T, -1.0 / T, 0.0], to_w / T_span])
    A[2, 2] = -1.0 / T_span
    B = np.array([1.0 / T, 0.0, 0.0])
    step, factor = _discretise(A, B, dt)
    return to_w, step, factor, cholesky(solve_continuous_lyapunov(A, -np.outer(B, B)), lower=True)


def _discretise(A: Array, B: Array, dt: float) -> tuple[Array, Array]:
    """Transition matrix and a factor R with R'R = covariance of the noise gathered in one step.

    The integral of e^(A s) B B' e^(A' s) is summed by Gauss and Legendre (12 nodes, exact to rounding for steps up to
    the shortest time constant; longer ones are cut up) and factored by QR without forming it: it is all but singular.
    """
    pieces = max(1, int(np.ceil(dt * np.max(np.abs(A)))))
    half = 0.5 * dt / pieces
    times = (2.0 * half * np.arange(pieces)[:, None] + half * (1.0 + _NODES)).ravel()
    rows = np.sqrt(half * np.tile(_WEIGHTS, pieces))[:, None] * (expm(A * times[:, None, None]) @ B)
    return expm(A * dt), qr(rows, mode="r")[0][: len(B)]


def _positive(**values: float) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0.0):
            raise BadInputError(f"{name} = {value}: must be a positive number")
