"""How gusty the air was: process noise of the linearised flight by maximum likelihood.

Gusts enter V, alpha and beta as white rates. The air's rotation goes with them: what changes alpha in time is a slope of
the vertical
gust along the flight, q = -dw/dx = -w'/V, smoothed over the span; and r = +dv/dx likewise (MIL-F-8785C 3.7.5):

    alpha' = ... + n_a,   T_q q' = -q + k n_a        beta' = ... + n_b,   T_r r' = -r - k n_b        T_p p' = -p + n_p

with k one, or none where the air was made without rotation. The spectra go with the airspeed V and with the air of the day
(in MIL-F-8785C with height, too): n_V and n_p as V, n_a and n_b as 1/V, and each flight has intensities of its own.
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
besides [rad2/s3]; all at V_REFERENCE. Light air, to begin with."""
V_REFERENCE = 20.0
_TIE = 4
_FACTORS = (1e-4, 1e-2, 0.1, 0.5, 1.0, 2.0, 5.0)
_FINER = ((0.03, 0.2, 5.0, 30.0), (0.4, 0.7, 1.4, 2.5), (0.75, 0.87, 1.15, 1.33))
_MOST_SEGMENTS = 10
_OF_A_FLIGHT = 6
_WHOLE = (0.1, 0.2, 0.4, 0.65, 1.5, 2.5, 5.0)
_NOISIER = ((0.4, 0.6, 0.8, 1.3, 1.8, 2.6), (0.88, 1.14))
_OWN = ((0.3, 0.55, 1.8, 3.3), (0.75, 1.33))


def process_of(values: FloatArray, V: float, b: float) -> FloatArray:
    """(11, 11) covariance per second of the states' noise at airspeed V, from the six values of _START."""
    faster = V / V_REFERENCE
    out = np.zeros((NX, NX))
    # Dryden far above its corner: PSD of u' is 2 sigma^2 V/L, of alpha' = w'/V 3 sigma^2/(L V).
    out[0, 0], out[8, 8] = values[0] * faster, values[3] * faster
    out[9, 9] = out[10, 10] = values[5]
    for state, rate, intensity, sign, length in (
        (1, 9, values[1], 1.0, GUST_LENGTHS[1]),
        (2, 10, values[2], -1.0, GUST_LENGTHS[2]),
    ):
        gain = np.zeros(NX)
        gain[state], gain[rate] = 1.0, sign * values[_TIE] * V / (length * b)
        out += intensity / faster * np.outer(gain, gain)
    return out


def gust_intensity(
    steps: Sequence[Steps],
    measured: Sequence[FloatArray],
    which: Sequence[int],
    noise: FloatArray,
    V: Sequence[float],
    b: float,
    flights: Sequence[str] | None = None,
) -> tuple[FloatArray, FloatArray, float]:
    """The six values, the process noise (S, 11, 11) they make at each segment's airspeed V, twice the log likelihood gained over
    calm air; found on at most ten of the segments.

    flights: of each segment; then every flight's values are found besides, on at most six segments, and the noise is made of them.
    """

    def costs_on(some: Sequence[int], points: Sequence[FloatArray]) -> FloatArray:
        process = np.concatenate([np.stack([process_of(p, V[k], b) for k in some]) for p in points])
        few, data, many = [steps[k] for k in some], [measured[k] for k in some], len(points)
        found = whiten(few * many, data * many, [Columns((), {}, {})] * (len(few) * many), which, noise, process)
        each = np.array([float(np.sum(w.residual**2)) + 2.0 * w.logdet for w in found])
        return np.asarray(each.reshape(many, len(few)).sum(axis=1))

    def best_of(
        some: Sequence[int], points: Sequence[FloatArray], best: FloatArray, low: float
    ) -> tuple[FloatArray, float]:
        found = costs_on(some, points)
        return (points[int(np.argmin(found))], float(found.min())) if found.min() < low else (best, low)

    def finer(
        some: Sequence[int], best: FloatArray, low: float, rounds: Sequence[Sequence[float]], ties: Sequence[float]
    ) -> tuple[FloatArray, float]:
        for factors in rounds:
            for k in range(len(_START)):
                trial = [
                    np.where(np.arange(len(_START)) == k, f * best, best) for f in (ties if k == _TIE else factors)
                ]
                if trial:
                    best, low = best_of(some, trial, best, low)
        return best, low

    some = _spread(range(len(steps)), _MOST_SEGMENTS)
    first = [_scaled(_START, f) for f in _FACTORS]
    best, low = best_of(some, first, first[0], np.inf)
    best, low = finer(some, best, low, _FINER, (0.0,))
    calm = whiten(
        [steps[k] for k in some], [measured[k] for k in some], [Columns((), {}, {})] * len(some), which, noise
    )
    gain = sum(float(np.sum(w.residual**2)) + 2.0 * w.logdet for w in calm) - low
    own = dict.fromkeys(flights or (), best)
    for flight in own if len(own) > 1 else ():
        part = _spread([k for k, f in enumerate(flights or ()) if f == flight], _OF_A_FLIGHT)
        here = float(costs_on(part, [best])[0])
        values, here = best_of(part, [_scaled(best, f) for f in _WHOLE], best, here)
        own[flight], _ = finer(part, values, here, _OWN, ())
    each = [own[f] for f in flights] if flights else [best] * len(steps)
    return best, np.stack([process_of(values, v, b) for values, v in zip(each, V, strict=True)]), gain


def noise_factors(
    steps: Sequence[Steps], measured: Sequence[FloatArray], which: Sequence[int], noise: FloatArray, process: FloatArray,
    kinds: Sequence[str],
) -> FloatArray:  # fmt: skip
    """(m,) factors on the sensors' noise (m,) that make the flights likeliest beside the process noise (S, 11, 11), one for each
    kind of channel; found on at most ten of the segments.

    In gusts the samples of a channel do not tell its noise by themselves, and a filter that takes sensors for twice as noisy as
    they are follows them late: that looks like a servo's lag.
    """
    some = _spread(range(len(steps)), _MOST_SEGMENTS)
    few, data = [steps[k] for k in some], [measured[k] for k in some]

    def cost(factors: FloatArray) -> float:
        found = whiten(few, data, [Columns((), {}, {})] * len(few), which, factors * noise, process[some])
        return sum(float(np.sum(w.residual**2)) + 2.0 * w.logdet for w in found)

    best = np.ones(len(noise))
    low = cost(best)
    for trial_factors in _NOISIER:
        for kind in dict.fromkeys(kinds):
            own = np.array([k == kind for k in kinds])
            trials = [np.where(own, f * best, best) for f in trial_factors]
            found = [cost(t) for t in trials]
            if min(found) < low:
                best, low = trials[int(np.argmin(found))], min(found)
    return best


def _scaled(values: FloatArray, factor: float) -> FloatArray:
    """All intensities times a factor, the tie as it is."""
    return np.where(np.arange(len(values)) == _TIE, values, factor * values)


def _spread(members: Sequence[int], most: int) -> list[int]:
    """At most so many of them, from the first to the last."""
    return [
        members[k] for k in np.unique(np.linspace(0, len(members) - 1, min(len(members), most)).astype(int)).tolist()
    ]
