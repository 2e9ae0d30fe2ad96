"""Dryden turbulence after MIL-F-8785C at low altitude, written for these flights: shaping filters
in series, sampled exactly.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm, solve_continuous_lyapunov

from sysid.arrays import FloatArray

NODE_S = 0.01
FT = 0.3048
KNOT = 1852.0 / 3600.0


def _sampled(
    A: FloatArray,
    B: FloatArray,
    C: FloatArray,
    n: int,
    dt: float,
    rng: np.random.Generator,
    *,
    is_from_rest: bool = False,
) -> FloatArray:
    """(n, outputs) samples of dx = A x dt + B dW, y = C x, started in its stationary
    distribution or at 0.
    """
    size = len(A)
    cover = solve_continuous_lyapunov(A, -B @ B.T)
    step = expm(A * dt)
    each = np.linalg.cholesky(
        cover - step @ cover @ step.T + 1e-15 * np.trace(cover) * np.eye(size)
    )
    x = np.linalg.cholesky(cover + 1e-15 * np.trace(cover) * np.eye(size)) @ rng.standard_normal(
        size
    )
    if is_from_rest:
        x = np.zeros(size)
    noise = rng.standard_normal((n, size)) @ each.T
    out = np.empty((n, len(C)))
    for k in range(n):
        out[k] = C @ x
        x = step @ x + noise[k]
    return out


def turbulence(
    V: float,
    h: float,
    w20_kt: float,
    b: float,
    seconds: float,
    rng: np.random.Generator,
    *,
    is_from_rest: bool = False,
) -> FloatArray:
    """(n, 6) air velocity u v w [m/s] and rotation p q r [rad/s] in heading axes every NODE_S;
    scales of V, h [m], b [m].

    Paragraphs 3.7.1 to 3.7.5 of MIL-F-8785C; q = -dw/dx and r = dv/dx through the span's own lag.
    """
    n = round(seconds / NODE_S) + 3
    feet = max(h / FT, 10.0)
    profile = 0.177 + 0.000823 * feet
    Lw, Lu = feet * FT, feet / profile**1.2 * FT
    sw = 0.1 * w20_kt * KNOT
    su = sw / profile**0.4
    Tu, Tw = Lu / V, Lw / V
    one = np.ones((1, 1))
    u = _sampled(
        -one / Tu, su * np.sqrt(2.0 / Tu) * one, one, n, NODE_S, rng, is_from_rest=is_from_rest
    )[:, 0]

    def transverse(sigma: float, T: float, lag: float, sign: float) -> FloatArray:
        # y = sigma sqrt(T) (1 + sqrt(3) T s) / (1 + T s)^2 white; rotation = sign s y / V / (1 +
        # lag s)
        A = np.array([[-1.0 / T, 1.0 / T, 0.0], [0.0, -1.0 / T, 0.0], [0.0, 0.0, -1.0 / lag]])
        root = np.sqrt(3.0)
        y = np.array([1.0 - root, root, 0.0])
        B = np.array([[0.0], [sigma / np.sqrt(T)], [0.0]])
        A[2, :2] = y[:2] / lag
        C = np.vstack([y, sign / (V * lag) * (y - np.array([0.0, 0.0, 1.0]))])
        return _sampled(A, B, C, n, NODE_S, rng, is_from_rest=is_from_rest)

    w, q = transverse(sw, Tw, 4.0 * b / (np.pi * V), -1.0).T
    v, r = transverse(su, Tu, 3.0 * b / (np.pi * V), 1.0).T
    Tp = 4.0 * b / (np.pi * V)
    sp = sw * np.sqrt(0.8 * (np.pi * Lw / (4.0 * b)) ** (1.0 / 3.0) * np.pi / (2.0 * Tp * V * Lw))
    p = _sampled(
        -one / Tp, sp * np.sqrt(2.0 / Tp) * one, one, n, NODE_S, rng, is_from_rest=is_from_rest
    )[:, 0]
    return np.column_stack([u, v, w, p, q, r])
