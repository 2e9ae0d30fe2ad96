"""Compiled loops that change the state of linear systems along a flight and discretise them.

Matrices of 13 states are multiplied by the vector instructions of `sysid.vector_rows`.
"""

from __future__ import annotations

import numpy as np

from sysid.aerodynamics.flight_equations import NX
from sysid.linalg import compiled
from sysid.vector_rows import row_operations

_, _add_product, _ = row_operations(NX)


@compiled
def _product(X, Y, Z):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Write X Y into Z, all (x, x)."""
    size = len(X)
    Z[:] = 0.0
    if size == NX:
        for i in range(NX):
            _add_product(Z, i, X, i, Y)
        return
    for i in range(size):
        for k in range(size):
            a = X[i, k]
            # A third of the elements of the equations of motion is zero.
            if a != 0.0:
                for c in range(size):
                    Z[i, c] += a * Y[k, c]


@compiled
def replace_state(gain, A, B, H, D):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Turn systems dx/dt = A x + B u, y = H x + D u of n rows into those of z = x + G a, in place.

    ``a`` are the rates 1 and 2 of x, and ``gain`` (n, g, 2) are the first rows of G, whose others
    are zero. With F these rows of A, dz/dx = 1 + G F has the inverse 1 - G (1 + F G)^-1 F
    (Woodbury).
    """
    acting, size, inputs = gain.shape[1], A.shape[2], B.shape[2]
    F, W, by_input = np.empty((2, size)), np.empty((2, size)), np.empty((2, inputs))
    for k in range(len(A)):
        F[:], by_input[:] = A[k, 1:3], B[k, 1:3]
        m00, m01, m10, m11 = 1.0, 0.0, 0.0, 1.0
        for j in range(acting):
            m00 += F[0, j] * gain[k, j, 0]
            m01 += F[0, j] * gain[k, j, 1]
            m10 += F[1, j] * gain[k, j, 0]
            m11 += F[1, j] * gain[k, j, 1]
        per_determinant = 1.0 / (m00 * m11 - m01 * m10)
        for j in range(size):
            W[0, j] = per_determinant * (m11 * F[0, j] - m01 * F[1, j])
            W[1, j] = per_determinant * (m00 * F[1, j] - m10 * F[0, j])
        for X, U in ((A, B), (H, D)):
            for i in range(X.shape[1]):
                first, second = 0.0, 0.0
                for j in range(acting):
                    first += X[k, i, j] * gain[k, j, 0]
                    second += X[k, i, j] * gain[k, j, 1]
                for j in range(size):
                    X[k, i, j] -= first * W[0, j] + second * W[1, j]
                if inputs:
                    first, second = 0.0, 0.0
                    for j in range(acting):
                        first += X[k, i, j] * gain[k, j, 0]
                        second += X[k, i, j] * gain[k, j, 1]
                    for j in range(inputs):
                        U[k, i, j] -= first * by_input[0, j] + second * by_input[1, j]


@compiled
def discretise(  # type: ignore[no-untyped-def]  # pragma: no cover
    A, B, h, phi, half_columns, g0, g1
):
    """Compute transitions (n - 1, x, x) over a step h and over half of it, the latter transposed,
    and input matrices at both ends of a step (n - 1, x, u) of u inputs, which may be none.

    With A the mean of a step's ends, and inputs that are linear over the step. A part H of the step
    of X = A H has, with phi_2 = 1/2! + X/3! + X^2/4! and phi_1 = 1 + X phi_2,

        F = 1 + X + X^2 phi_2,   E1 = H phi_2,   E0 = H (phi_1 - phi_2),

    E0 and E1 for inputs at its ends. Two parts make one of twice the length (scaling and squaring):

        F F,   E0 of both = F (E0 + E1/2) + E0/2,   E1 of both = F E1/2 + E0/2 + E1
    """
    size, inputs = phi.shape[1], B.shape[2]
    X, S, P, Q, F = (
        np.empty((size, size)),
        np.empty((size, size)),
        np.empty((size, size)),
        np.empty((size, size)),
        np.empty((size, size)),
    )
    for k in range(len(phi)):
        fastest = 0.0
        for i in range(size):
            for j in range(size):
                X[i, j] = 0.5 * (A[k, i, j] + A[k + 1, i, j])
            for j in range(i + 1):
                fastest = max(fastest, abs(X[i, j] * X[j, i]))
        # The terms left out are X^5/5!, at most 3e-4.
        doublings = 1
        while doublings < 12 and 0.5**doublings * h * np.sqrt(fastest) > 0.5:
            doublings += 1
        part = 0.5**doublings * h
        for i in range(size):
            for j in range(size):
                X[i, j] *= part
        _product(X, X, S)
        for i in range(size):
            for j in range(size):
                Q[i, j] = S[i, j] / 24.0 + X[i, j] / 6.0
            Q[i, i] += 0.5
        _product(S, Q, F)
        for i in range(size):
            for j in range(size):
                F[i, j] += X[i, j]
            F[i, i] += 1.0
        if inputs:
            _product(X, Q, P)
            for i in range(size):
                P[i, i] += 1.0
                for j in range(size):
                    P[i, j] = part * (P[i, j] - Q[i, j])
                    Q[i, j] *= part
        # From here P is E0 and Q is E1.
        for _ in range(doublings):
            for i in range(size):
                for j in range(size):
                    half_columns[k, j, i] = F[i, j]
            if inputs:
                for i in range(size):
                    for j in range(size):
                        X[i, j] = P[i, j] + 0.5 * Q[i, j]
                _product(F, X, S)
                for i in range(size):
                    for j in range(size):
                        X[i, j] = 0.5 * Q[i, j]
                        Q[i, j] += 0.5 * P[i, j]
                        P[i, j] = S[i, j] + 0.5 * P[i, j]
                _product(F, X, S)
                for i in range(size):
                    for j in range(size):
                        Q[i, j] += S[i, j]
            _product(F, F, S)
            F, S = S, F
        for i in range(size):
            for j in range(size):
                phi[k, i, j] = F[i, j]
            for c in range(inputs):
                g0[k, i, c] = g1[k, i, c] = 0.0
            for j in range(size):
                for c in range(inputs):
                    g0[k, i, c] += P[i, j] * B[k, j, c]
                    g1[k, i, c] += Q[i, j] * B[k + 1, j, c]
