"""How gusty the air was: process noise of the linearised flight by maximum likelihood.

Gusts enter V, alpha and beta as white rates. The air's rotation goes with them: what changes alpha in time is a slope of
the vertical
gust along the flight, q = -dw/dx = -w'/V, smoothed over the span; and r = +dv/dx likewise (MIL-F-8785C 3.7.5):

    alpha' = ... + n_a,   T_q q' = -q + k n_a        beta' = ... + n_b,   T_r r' = -r - k n_b        T_p p' = -p + n_p

with k one, or none where the air was made without rotation.
Left out, that tie would pass for stability: gusts that pitch the air and change alpha at once made Cm_alpha a third of its size.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sysid.prediction import Columns, whiten
from sysid.rigid_steps import GUST_LENGTHS, NX, Steps

FloatArray = NDArray[np.float64]
_START = np.array([0.25, 5e-4, 5e-4, 5e-2, 1.0, 1e-4])
"""Intensities of V [m2/s3], alpha and beta [rad2/s], the air's roll [rad2/s3]; k; what the air's pitch and yaw have
besides [rad2/s3].
Light air at 20 m/s, to begin with."""
_TIE = 4
_FACTORS = (1e-4, 1e-2, 0.1, 0.5, 1.0, 2.0, 5.0)
_FINER = ((0.03, 0.2, 5.0, 30.0), (0.4, 0.7, 1.4, 2.5), (0.75, 0.87, 1.15, 1.33))
_TIES = ((0.0,), (0.0,), (0.0,))
_MOST_SEGMENTS = 10


def process_of(values: FloatArray, V: float, b: float) -> FloatArray:
    """(11, 11) covariance per second of the states' noise, from the six values of _START."""
    out = np.zeros((NX, NX))
    out[0, 0], out[8, 8] = values[0], values[3]
    out[9, 9] = out[10, 10] = values[5]
    for state, rate, intensity, sign, length in (
        (1, 9, values[1], 1.0, GUST_LENGTHS[1]),
        (2, 10, values[2], -1.0, GUST_LENGTHS[2]),
    ):
        gain = np.zeros(NX)
        gain[state], gain[rate] = 1.0, sign * values[_TIE] * V / (length * b)
        out += intensity * np.outer(gain, gain)
    return out


def gust_intensity(
    steps: Sequence[Steps],
    measured: Sequence[FloatArray],
    which: Sequence[int],
    noise: FloatArray,
    V: Sequence[float],
    b: float,
    coarse: bool = False,
) -> tuple[FloatArray, FloatArray, float]:
    """The six values, the process noise (S, 11, 11) they make at each segment's airspeed V, and twice the log likelihood
    gained over
    calm air; found on at most ten of the segments. coarse: one strength for all of it, to begin with."""
    some = np.unique(np.linspace(0, len(steps) - 1, min(len(steps), _MOST_SEGMENTS)).astype(int))
    few, data = [steps[k] for k in some], [measured[k] for k in some]

    def costs(points: Sequence[FloatArray]) -> FloatArray:
        process = np.concatenate([np.stack([process_of(p, V[k], b) for k in some]) for p in points])
        many = len(points)
        found = whiten(few * many, data * many, [Columns((), {}, {})] * (len(few) * many), which, noise, process)
        each = np.array([float(np.sum(w.residual**2)) + 2.0 * w.logdet for w in found])
        return each.reshape(many, len(few)).sum(axis=1)

    first = [np.where(np.arange(len(_START)) == _TIE, _START, f * _START) for f in _FACTORS]
    found = costs(first)
    best, low = first[int(np.argmin(found))], float(found.min())
    for factors, ties in () if coarse else zip(_FINER, _TIES, strict=True):
        for k in range(len(_START)):
            trial = []
            for f in ties if k == _TIE else factors:
                point = best.copy()
                point[k] *= f
                trial.append(point)
            found = costs(trial)
            if found.min() < low:
                best, low = trial[int(np.argmin(found))], float(found.min())
    calm = whiten(few, data, [Columns((), {}, {})] * len(few), which, noise)
    still = sum(float(np.sum(w.residual**2)) + 2.0 * w.logdet for w in calm)
    return best, np.stack([process_of(best, v, b) for v in V]), still - low
