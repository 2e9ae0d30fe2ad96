"""How likely flights are in an air, and the score: how that goes with the air's intensities and the sensors' noise.

Minus twice the log likelihood of one-step predictions, start states fitted (Astrom, Automatica 16, 1980), with w = L^-1 e whitened:

    sum |w|^2 + 2 ln det L,   L L' = F = H P H' + R                                                                       (1)

Its slopes come of one pass backwards, channel by channel (Koopman and Shephard, Biometrika 79, 1992; Durbin and Koopman, Time
Series Analysis by State Space Methods, 2012, sections 6.4 and 7.3.3). With the innovation v, its variance s, the gain K and C = 1 -
K h,

    u = v/s - K'r,   D = 1/s + K'N K,   r- = C'r + h'v/s,   N- = C'N C + h'h/s                                           (2)
    d/dR = D - u^2,      d/dQ = N - r r' behind the step,      d/dP(0) = N - r r' before the first sample                  (3)

The start state is where the likelihood is largest, so that its change with the air takes nothing away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.aerodynamics import Steps
from sysid.arrays import FloatArray
from sysid.effects.prediction import start_fitted
from sysid.estimation import Process, Seen, carried, gains, slopes
from sysid.parallel import ALONE, Processes, Shared


@dataclass(frozen=True)
class Score:
    """cost: minus twice the log likelihood; its slopes with the logarithm of each sensor's standard deviation, noise (m,), and with
    the variances of each segment's process noise and begin (S, x). Infinite, its slopes zero, where no filter follows.

    bent   the same slopes without the sum of squares, (m,), (S, x), (S, x): what the logarithm's curvature is at most
    """

    cost: float
    noise: FloatArray
    process: FloatArray
    begin: FloatArray
    bent: tuple[FloatArray, FloatArray, FloatArray]


class AirLikelihood:
    """Segments whose likelihood is asked for in many airs.

    which: rows of OUTPUTS that ``measured`` [(n, m)] holds. Who does the work does not change a bit of it.
    """

    def __init__(
        self,
        steps: Sequence[Steps],
        measured: Sequence[FloatArray],
        which: Sequence[int],
        by: Processes = ALONE,
    ) -> None:
        self._by = by
        order = sorted(range(len(measured)), key=lambda k: -len(measured[k]))
        count = min(by.count, len(order))
        self._groups = [order[k::count] for k in range(count)]
        self._shared = [
            by.share([Seen.of(steps[k], measured[k], which) for k in group])
            for group in self._groups
        ]

    def __call__(self, noise: FloatArray, process: Process, slopes: bool = True) -> Score:
        """noise (m,) standard deviations of the sensors; without ``slopes`` they are zero."""
        jobs = [
            (shared, noise, process.of(group), slopes)
            for shared, group in zip(self._shared, self._groups, strict=True)
        ]
        found = [one for some in self._by(_scored, jobs) for one in some]
        order = np.argsort(np.concatenate(self._groups))
        cost, by_noise, by_process, by_begin = (
            np.stack(part)[order] for part in zip(*found, strict=True)
        )
        followed = float(np.isfinite(cost).all())
        bent, square = (
            (by_noise[:, k].sum(axis=0), by_process[:, k], by_begin[:, k]) for k in (0, 1)
        )
        own, air, begin = (followed * (b - s) for b, s in zip(bent, square, strict=True))
        return Score(float(cost.sum()), own, air, begin, bent)


_Slopes = tuple[float, FloatArray, FloatArray, FloatArray]


def _scored(job: tuple[Shared, FloatArray, Process, bool]) -> list[_Slopes]:
    """Cost of each segment, and its slopes, those of the logarithm and those of the squares (2, m), (2, x) and (2, x); infinite,
    its slopes zero, where no filter follows."""
    shared, noise, process, sloping = job
    return [
        _one(seen, noise, (q, p), sloping)
        for seen, q, p in zip(shared.value, process.noise, process.begin, strict=True)
    ]


def _one(
    seen: Seen, noise: FloatArray, air: tuple[FloatArray, FloatArray], sloping: bool
) -> _Slopes:
    flat = np.zeros((2, len(noise))), np.zeros((2, len(air[0]))), np.zeros((2, len(air[0])))
    try:
        found = gains(seen, noise, air, every=False)
    except np.linalg.LinAlgError:
        return np.inf, *flat
    through = carried(seen, found)
    if not np.isfinite(through.starts).all():
        return np.inf, *flat
    white, _, _ = start_fitted(through.innovations, through.starts)
    cost = float(np.sum(white**2)) + 2.0 * found.logdet  # (1)
    if not sloping:
        return cost, *flat
    own, process, begin = slopes(seen, found, white, air[0])
    return cost, 2.0 * noise**2 * own, process, begin
