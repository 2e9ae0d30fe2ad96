"""The linear Kalman filter along a linearised flight, and what extra coefficients and the start do to its innovations.

Samples of independent channels are taken one after the other (Astrom, Automatica 16, 1980; Bierman, Factorization Methods, 1977):

    e = z - h d,   s = h P h' + r,   K = P h'/s,   d+ = d + K e,   X+ = X - K (h X + D u),   P+ = P - K s K'
    d' = Phi d+ + defect,   X' = Phi X+ + G0 u(k) + G1 u(k+1-),   P' = Phi P+ Phi' + process noise

X holds what the state does per unit of some extra coefficients u, and of the start state, which is unknown: its eight columns
come first. u(k+1-) is u just before it jumps at the row k+1, if it does. e and h X + D u over sqrt(s) are the whitened
innovations and their sensitivities. The gains do not depend on what was measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.estimation.kalman_loops import STARTS, Acting, Gains, Seen

_AT_ONCE = 96
"""Columns that go through the gains together: what stays in a processor's first cache."""


@dataclass(frozen=True)
class Process:
    """Process noise of S segments: noise (S, 13) variances per second of the states, begin (S, 13) of those of the air at the
    start."""

    noise: FloatArray
    begin: FloatArray

    def of(self, segments: Sequence[int]) -> Process:
        """That of some segments."""
        return Process(self.noise[list(segments)], self.begin[list(segments)])


def gains(
    seen: Seen, noise: FloatArray, air: tuple[FloatArray, FloatArray] | None, every: bool = True
) -> Gains:
    """Gains of a flight in an air.

    noise (m,) standard deviations of the sensors; air: variances (13,) per second of the states' noise, and (13,) of the air at the
    start; None for calm air, in which the state is not corrected: output error. Without ``every`` the whole variances are left out.
    Raises LinAlgError where a variance is below zero or an unstable flight outgrows numbers.
    """
    if air is None:
        spread = np.where(seen.there, noise**2, 1.0)
        return Gains(np.zeros(seen.H.shape), spread, spread)
    variances, begin = air
    if min(variances.min(), begin.min()) < 0.0:
        raise np.linalg.LinAlgError("a variance below zero")
    found = Gains(*_loops().follow(seen, noise**2, variances, begin, every))
    if not np.isfinite(found.spread).all():
        raise np.linalg.LinAlgError("the covariance of the states is no number")
    return found


def slopes(
    seen: Seen, by: Gains, innovations: FloatArray, variances: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Slopes of minus twice the log likelihood with variances: of the sensors (2, m), of the states' noise per second (2, 13), zero
    where there is none, and of the start (2, 13); first those of its logarithm, then what its sum of squares takes away.

    innovations (n, m), whitened, the start fitted; by and variances (13,) of `gains`.
    """
    found: tuple[FloatArray, FloatArray, FloatArray] = _loops().backward(
        seen, by, innovations * np.sqrt(by.spread), variances
    )
    return found


def _loops() -> ModuleType:
    # numba takes a third of a second to load.
    from sysid.estimation import kalman_loops

    return kalman_loops


@dataclass(frozen=True)
class Whitened:
    """innovations (n, m) and starts (n, m, 8) of the start states, columns (n, m, K) in single precision, each over the
    innovations' deviations and zero where nothing was measured; path (n, x) predicted state less the reference, from what was
    measured before."""

    innovations: FloatArray
    starts: FloatArray
    columns: NDArray[np.float32]
    path: FloatArray


def carried(
    seen: Seen,
    by: Gains,
    names: Sequence[str] = (),
    inputs: Mapping[str, tuple[int, FloatArray]] | None = None,
    outputs: Mapping[str, FloatArray] | None = None,
    ends: Mapping[str, FloatArray] | None = None,
    felt: Mapping[str, FloatArray] | None = None,
    alone: Whitened | None = None,
) -> Whitened:
    """What was measured, and the columns ``names``, through the gains.

    inputs, outputs, ends, felt: of `Acting.of`; alone: the same without columns, where it is known.
    """
    n, m, size = seen.H.shape
    if alone is None:
        path, first = np.zeros((n, size)), np.zeros((n, m, 1 + STARTS))
        _through(
            seen,
            by,
            np.hstack([np.zeros((size, 1)), seen.start]),
            Acting.of((), {}, {}, n, m),
            first,
            path,
        )
        alone = Whitened(first[..., 0], first[..., 1:], np.zeros((n, m, 0), dtype=np.float32), path)
    if not names:
        return alone
    columns, again = np.zeros((n, m, len(names)), dtype=np.float32), np.empty_like(alone.path)
    for begin in range(0, len(names), _AT_ONCE):
        some = names[begin : begin + _AT_ONCE]
        acting = Acting.of(some, inputs or {}, outputs or {}, n, m, ends, felt)
        out = np.zeros((n, m, 1 + len(some)), dtype=np.float32)
        _through(seen, by, np.zeros((size, 1 + len(some))), acting, out, again)
        columns[:, :, begin : begin + len(some)] = out[:, :, 1:]
    return replace(alone, columns=columns)


def path_from(seen: Seen, by: Gains, begin: FloatArray) -> FloatArray:
    """(n, x) predicted states less the reference, from what was measured before, of a flight that begins at ``begin`` (x,)."""
    n, m, size = seen.H.shape
    path, left = np.zeros((n, size)), np.zeros((n, m, 1))
    # The state goes through the gains less itself.
    _through(seen, by, -np.reshape(begin, (size, 1)), Acting.of((), {}, {}, n, m), left, path)
    return path


def _through(
    seen: Seen,
    by: Gains,
    X: FloatArray,
    acting: Acting,
    out: NDArray[np.floating],
    path: FloatArray,
) -> None:
    _loops().carry(seen, by.gain, 1.0 / np.sqrt(by.spread), X, acting, out, path)
