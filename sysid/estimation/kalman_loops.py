"""Compiled loops of the Kalman filter along one linearised flight, with P = U D U'.

`sysid.estimation.kalman` calls them. The channels of a sample are processed one after the other:
with independent noise that equals the joint update, and the whitened innovations are those of a
Cholesky root (Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, section
V.3). Between samples P is multiplied out, process noise is added, and P is factored again (section
III.4 there). A variance that rounding makes negative is zero.

Rows of all states are added by the vector instructions of `sysid.vector_rows`.
"""

from __future__ import annotations

import numpy as np

from sysid.aerodynamics import NX
from sysid.linalg import compiled
from sysid.vector_rows import row_operations

_add_row, _add_product, _exchange_rows = row_operations(NX)


@compiled
def filter_gains(  # type: ignore[no-untyped-def]  # pragma: no cover
    system, r, q, begin, with_prior_variance
):
    """Compute the gains along a segment, in the order of the fields of `Gains`.

    ``r`` (m,) are the sensors' variances, ``q`` (13,) those of the states' noise per second,
    ``begin`` (13,) those of the start.
    """
    n, m = system.is_measured.shape
    gain, variance, prior_variance = np.zeros((n, m, NX)), np.ones((n, m)), np.ones((n, m))
    state_variance = np.zeros((n, NX))
    # Rows of V are columns of U.
    V, D, f = np.eye(NX), begin.copy(), np.empty(NX)
    W, P = np.empty((NX, NX)), np.empty((NX, NX))
    turned, work = np.empty((NX, NX)), np.empty((NX, NX))
    for k in range(n):
        if with_prior_variance:
            for j in range(m):
                if system.is_measured[k, j]:
                    _project(V, system.H[k, j], f)
                    prior_variance[k, j] = r[j]
                    for i in range(NX):
                        prior_variance[k, j] += D[i] * f[i] * f[i]
            for c in range(NX):
                for i in range(NX):
                    state_variance[k, i] += D[c] * V[c, i] * V[c, i]
        for j in range(m):
            if system.is_measured[k, j]:
                _project(V, system.H[k, j], f)
                variance[k, j] = _measurement_update(V, D, f, r[j], work, gain[k, j])
        if k < n - 1:
            _transpose(system.phi[k], turned)
            # Rows of W are columns of Phi U.
            W[:] = 0.0
            P[:] = 0.0
            for c in range(NX):
                _add_product(W, c, V, c, turned)
            _add_square(W, D, work, P)
            _add_process_noise(turned, system.half_columns[k], q, system.dt_s, work, P)
            _factor(P, V, D)
    return gain, variance, prior_variance, state_variance


@compiled
def _project(V, h, f):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Compute U'h into ``f``; most channels depend on few states."""
    f[:] = 0.0
    for e in range(NX):
        if h[e] != 0.0:
            for i in range(e, NX):
                f[i] += V[i, e] * h[e]


@compiled
def _measurement_update(  # type: ignore[no-untyped-def]  # pragma: no cover
    V, D, f, variance, work, gain
):
    """Update U and D by one channel with f = U'h (Bierman).

    Adds the gain (13,) to ``gain``, which is zero, and returns the variance of the innovation. The
    first rows of ``work`` are overwritten.
    """
    alpha = variance
    back, v = work[0], work[1]
    inverse = 1.0 / alpha
    for i in range(NX):
        v[i] = D[i] * f[i]
        back[i] = -f[i] * inverse
        D[i] *= alpha
        alpha += v[i] * f[i]
        inverse = 1.0 / alpha
        D[i] *= inverse
    # Before row i, the gain's elements from i on are zero: U stays triangular.
    _exchange_rows(V, back, v, gain)
    for i in range(NX):
        gain[i] *= inverse
    return alpha


@compiled
def _transpose(phi, turned):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Write the transpose of ``phi`` into ``turned``."""
    for i in range(NX):
        for c in range(NX):
            turned[c, i] = phi[i, c]


@compiled
def _add_square(W, weights, work, P):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Add W' diag(``weights``) W to P. Overwrites ``work``."""
    for c in range(NX):
        for i in range(NX):
            work[i, c] = weights[c] * W[c, i]
    for i in range(NX):
        _add_product(P, i, work, i, W)


@compiled
def _add_process_noise(  # type: ignore[no-untyped-def]  # pragma: no cover
    turned, halves, q, dt_s, work, P
):
    """Add the noise of one step, of variances ``q`` per second, to P. Overwrites ``work``.

    The noise acts throughout the step: the integral of exp(A s) Q exp(A's) by Simpson's rule. If it
    were added at the step's end alone, it would come half a step late and sensors would look early.
    """
    sixth = dt_s / 6.0 * q
    _add_square(halves, 4.0 * sixth, work, P)
    _add_square(turned, sixth, work, P)
    for i in range(NX):
        P[i, i] += sixth[i]


@compiled
def _factor(P, V, D):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Factor P into U and D, the last state first. Overwrites P."""
    for i in range(NX - 1, -1, -1):
        D[i] = max(P[i, i], 0.0)
        inverse = 1.0 / D[i] if D[i] > 0.0 else 0.0
        for e in range(i):
            V[i, e] = P[i, e] * inverse
        for e in range(i):
            _add_row(P, e, -P[i, e], V, i)


@compiled
def noise_columns(  # type: ignore[no-untyped-def]  # pragma: no cover
    system, gains, start, q, noisy, out
):
    """Differentiate whitened innovations with the logarithms of the states' noise.

    The tangent of the filter: with the derivatives F of P and d of the state, for each channel

        dK = (F h' - K h F h')/s,   d+ = d + dK e - K h d,   F+ = (1 - K h) F (1 - K h)'

    ``start`` (13,) is the state less the reference at the start, ``noisy`` are the A states whose
    noise ``q`` (13,) is not zero. Writes the changes of the innovations over their deviations into
    ``out`` (n, m, A).
    """
    n, m = system.is_measured.shape
    A = len(noisy)
    x, moved, f = start.copy(), np.empty(NX), np.empty(NX)
    d, F = np.zeros((A, NX)), np.zeros((A, NX, NX))
    T, turned = np.empty((NX, NX)), np.empty((NX, NX))
    for k in range(n):
        for j in range(m):
            if not system.is_measured[k, j]:
                continue
            h, gain, s = system.H[k, j], gains.gain[k, j], gains.variance[k, j]
            innovation = system.z[k, j]
            for i in range(NX):
                innovation -= h[i] * x[i]
            for c in range(A):
                by_noise = F[c]
                f[:] = 0.0
                change = 0.0
                for i in range(NX):
                    change -= h[i] * d[c, i]
                _add_product(f, 0, h, 0, by_noise)
                by_variance = 0.0
                for i in range(NX):
                    by_variance += h[i] * f[i]
                scale = innovation / s
                for i in range(NX):
                    d[c, i] += (f[i] - gain[i] * by_variance) * scale + gain[i] * change
                    # F - K f' - f K' + K K' h f, symmetric.
                    _add_row(by_noise, i, gain[i] * by_variance - f[i], gain, 0)
                    _add_row(by_noise, i, -gain[i], f, 0)
                out[k, j, c] = change / np.sqrt(s)
            for i in range(NX):
                x[i] += gain[i] * innovation
        if k < n - 1:
            phi, halves = system.phi[k], system.half_columns[k]
            _transpose(phi, turned)
            moved[:] = system.defect[k]
            _add_product(moved, 0, x, 0, turned)
            x[:] = moved
            for c in range(A):
                by_noise = F[c]
                moved[:] = 0.0
                _add_product(moved, 0, d[c], 0, turned)
                d[c] = moved
                T[:] = 0.0
                for i in range(NX):
                    _add_product(T, i, phi, i, by_noise)
                by_noise[:] = 0.0
                for i in range(NX):
                    _add_product(by_noise, i, T, i, turned)
                # The noise of state ``at`` as in `_add_process_noise`.
                at = noisy[c]
                sixth = system.dt_s / 6.0 * q[at]
                for i in range(NX):
                    _add_row(by_noise, i, 4.0 * sixth * halves[at, i], halves, at)
                    _add_row(by_noise, i, sixth * turned[at, i], turned, at)
                by_noise[at, at] += sixth


@compiled
def whiten_states(  # type: ignore[no-untyped-def]  # pragma: no cover
    system, gain, scale, X, out, path
):
    """Compute the innovations of a segment and their sensitivities to states at the start.

    As `whiten_columns` without inputs, but with NX states in each row of ``X`` (c, x).
    """
    n, m = system.is_measured.shape
    row, Y, turned = np.empty(len(X)), np.empty_like(X), np.empty((NX, NX))
    for k in range(n):
        for i in range(NX):
            path[k, i] = -X[0, i]
        for j in range(m):
            if system.is_measured[k, j]:
                row[:] = 0.0
                row[0] = system.z[k, j]
                for i in range(NX):
                    h = system.H[k, j, i]
                    if h != 0.0:
                        for c in range(len(row)):
                            row[c] += h * X[c, i]
                for c in range(len(row)):
                    out[k, j, c] = row[c] * scale[k, j]
                    _add_row(X, c, -row[c], gain, k * m + j)
        if k < n - 1:
            _transpose(system.phi[k], turned)
            Y[:] = 0.0
            for i in range(NX):
                Y[0, i] = -system.defect[k, i]
            for c in range(len(row)):
                _add_product(Y, c, X, c, turned)
            X, Y = Y, X


@compiled
def whiten_columns(  # type: ignore[no-untyped-def]  # pragma: no cover
    system, gain, scale, X, column_inputs, out, path
):
    """Compute the innovations of a segment and their sensitivities, through given gains (n, m, x).

    ``X`` (x, c) is minus the state at the start, then the columns; it is overwritten. ``scale`` (n,
    m) multiplies the innovations. Fills ``out`` (n, m, c) and the predicted state ``path`` (n, x).
    """
    n, m = system.is_measured.shape
    row, Y = np.empty(X.shape[1]), np.empty_like(X)
    for k in range(n):
        for i in range(len(X)):
            path[k, i] = -X[i, 0]
        for j in range(m):
            if system.is_measured[k, j]:
                _innovation_row(system, column_inputs, k, j, X, row)
                for c in range(len(row)):
                    out[k, j, c] = row[c] * scale[k, j]
                for i in range(len(X)):
                    g = gain[k, j, i]
                    if g != 0.0:
                        for c in range(len(row)):
                            X[i, c] -= g * row[c]
        if k < n - 1:
            _propagate_columns(system, column_inputs, k, X, Y)
            X, Y = Y, X


@compiled
def _innovation_row(  # type: ignore[no-untyped-def]  # pragma: no cover
    system, column_inputs, k, j, X, row
):
    """Write the innovation of channel j of sample k and its sensitivities into ``row``."""
    row[:] = 0.0
    row[0] = system.z[k, j]
    for i in range(len(X)):
        h = system.H[k, j, i]
        if h != 0.0:
            for c in range(len(row)):
                row[c] += h * X[i, c]
    if system.D[k, j].any():
        for e in range(len(column_inputs.column)):
            row[column_inputs.column[e]] += (
                system.D[k, j, column_inputs.coefficient[e]] * column_inputs.feedthrough[k, e]
            )
    for e in range(len(column_inputs.direct)):
        row[column_inputs.direct[e]] += column_inputs.added[k, j, e]


@compiled
def _propagate_columns(  # type: ignore[no-untyped-def]  # pragma: no cover
    system, column_inputs, k, X, Y
):
    """Propagate the states and columns from sample k to k + 1, into ``Y``.

    Four states are summed at a time, because memory access to ``Y`` takes longer than its sums.
    """
    size, phi = len(X), system.phi[k]
    for i in range(size):
        Y[i, :] = 0.0
        Y[i, 0] = -system.defect[k, i]
        e = 0
        while e + 3 < size:
            p, q, r, s = phi[i, e], phi[i, e + 1], phi[i, e + 2], phi[i, e + 3]
            # Rows of the air states have few elements: skip zeros.
            if p != 0.0 or q != 0.0 or r != 0.0 or s != 0.0:
                for c in range(X.shape[1]):
                    Y[i, c] = (
                        Y[i, c] + p * X[e, c] + q * X[e + 1, c] + r * X[e + 2, c] + s * X[e + 3, c]
                    )
            e += 4
        while e < size:
            for c in range(X.shape[1]):
                Y[i, c] += phi[i, e] * X[e, c]
            e += 1
    for e in range(len(column_inputs.column)):
        a, column = column_inputs.coefficient[e], column_inputs.column[e]
        at_start, at_end = column_inputs.values[k, e], column_inputs.ends[k + 1, e]
        for i in range(size):
            Y[i, column] += system.g0[k, i, a] * at_start + system.g1[k, i, a] * at_end


@compiled
def backward(system, gains, innovation, q):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Differentiate minus twice the log likelihood with the variances, by a backward pass.

    ``innovation`` (n, m) with the start fitted, ``gains`` of the same pass, ``q`` (13,) as in
    `filter_gains`. Returns for the sensors (2, m), the states' noise per second (2, 13; zero where
    q is) and the start (2, 13) the derivative of the log determinant and of the sum of squares.
    Equations (2) and (3) of `sysid.effects.turbulence`.
    """
    n, m = system.is_measured.shape
    by_noise, by_process, by_start = np.zeros((2, m)), np.zeros((2, NX)), np.zeros((2, NX))
    noisy = np.flatnonzero(q)
    r, N, a = np.zeros(NX), np.zeros((NX, NX)), np.empty(NX)
    turned, work = np.empty((NX, NX)), np.empty((NX, NX))
    sixth = system.dt_s / 6.0
    for k in range(n - 1, -1, -1):
        if k < n - 1:
            # Process noise as in `filter_gains`: Simpson's rule over end, middle and beginning.
            _transpose(system.phi[k], turned)
            _add_end_point(r, N, noisy, sixth, by_process)
            _add_midpoint(r, N, noisy, system.half_columns[k], 4.0 * sixth, a, by_process)
            _propagate_back(system.phi[k], turned, work, r, N)
            _add_end_point(r, N, noisy, sixth, by_process)
        for j in range(m - 1, -1, -1):
            if not system.is_measured[k, j]:
                continue
            h, g = system.H[k, j], gains.gain[k, j]
            a[:] = 0.0
            _add_product(a, 0, g, 0, N)
            u, slope = innovation[k, j] / gains.variance[k, j], 1.0 / gains.variance[k, j]
            for i in range(NX):
                u -= g[i] * r[i]
                slope += g[i] * a[i]  # (2)
            by_noise[0, j] += slope
            by_noise[1, j] += u * u  # (3)
            _update_back(h, a, u, slope, r, N)
    for i in range(NX):
        by_start[0, i], by_start[1, i] = N[i, i], r[i] ** 2
    return by_noise, by_process, by_start


@compiled
def _add_end_point(  # type: ignore[no-untyped-def]  # pragma: no cover
    r, N, noisy, weight, by_process
):
    """Add one end point of Simpson's rule to the derivatives with the process noise."""
    for c in range(len(noisy)):
        at = noisy[c]
        by_process[0, at] += weight * N[at, at]
        by_process[1, at] += weight * r[at] ** 2


@compiled
def _add_midpoint(  # type: ignore[no-untyped-def]  # pragma: no cover
    r, N, noisy, halves, weight, rotated, by_process
):
    """Add the midpoint of Simpson's rule to the derivatives with the process noise.

    Overwrites ``rotated`` (13,).
    """
    for c in range(len(noisy)):
        at = noisy[c]
        rotated[:] = 0.0
        _add_product(rotated, 0, halves, at, N)
        square, projection = 0.0, 0.0
        for i in range(NX):
            square += rotated[i] * halves[at, i]
            projection += r[i] * halves[at, i]
        by_process[0, at] += weight * square
        by_process[1, at] += weight * projection**2


@compiled
def _propagate_back(phi, turned, work, r, N):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Replace r and N by Phi'r and Phi'N Phi; ``turned`` is Phi'. Overwrites ``work``."""
    work[:] = 0.0
    for e in range(NX):
        _add_product(work, e, N, e, phi)
    N[:] = 0.0
    for i in range(NX):
        _add_product(N, i, turned, i, work)
    work[0] = 0.0
    _add_product(work, 0, r, 0, phi)
    r[:] = work[0]


@compiled
def _update_back(h, a, u, slope, r, N):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Update r and N backwards across one channel, with a = N K."""
    for e in range(NX):
        if h[e] != 0.0:
            r[e] += h[e] * u
            _add_row(N, e, -h[e], a, 0)
            for i in range(NX):
                N[i, e] -= h[e] * a[i]
            _add_row(N, e, slope * h[e], h, 0)
