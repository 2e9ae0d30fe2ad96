"""How near a state is to an excursion, by linear predictions of the distance to come, fitted to flights that are not split.

A path with regressors x is expected at the distance m_h(x) after h seconds, within s_h (standard deviation of what the regression
leaves). Its score is the largest (m_h - radius) / s_h over the horizons: the distance to the radius in standard deviations. For a
linear system in Gaussian noise minus half its square is the logarithm of the probability of an excursion, up to smaller terms, so
that states are in the order of that probability, as a good importance function has them (Garvels 2000, chapter 3). Pure: no file,
no clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray

HORIZONS_S = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0)
"""Behind ten seconds a loiter's state is forgotten: the prediction is then the mean of that place on the circle."""
NOW_M = 0.05
"""Standard deviation of the distance that is there: a path beyond the radius has a score above 0."""
RIDGE = 1e-4
"""Share of its variance added to each regressor: two that nearly coincide get no large coefficients of opposite signs."""


@dataclass(frozen=True)
class Predicted:
    """Predictions at horizons [s] (h,): ``coefficients`` (h, k) of the regressors, ``constants`` [m] and ``sigmas`` [m] (h,)."""

    radius_m: float
    horizons_s: tuple[float, ...]
    coefficients: tuple[tuple[float, ...], ...]
    constants: tuple[float, ...]
    sigmas: tuple[float, ...]

    def score(self, regressors: FloatArray, distance_m: FloatArray) -> FloatArray:
        """Standard deviations to the radius (...), negative inside it, of regressors (..., k) and distances (...)."""
        # One regressor after the other: a matrix product would round differently with the number of paths.
        slopes, expected = (
            np.array(self.coefficients),
            np.zeros((*distance_m.shape, len(self.constants))) + self.constants,
        )
        for place in range(slopes.shape[1]):
            expected += regressors[..., place, None] * slopes[:, place]
        ahead = ((expected - self.radius_m) / np.array(self.sigmas)).max(axis=-1)
        return np.asarray(np.maximum(ahead, (distance_m - self.radius_m) / NOW_M))


def fit(
    regressors: FloatArray,
    distance_m: FloatArray,
    row_s: float,
    radius_m: float,
    horizons_s: Sequence[float] = HORIZONS_S,
) -> Predicted:
    """Least squares at each horizon that is a whole number of rows, from flights (flights, rows, k) and (flights, rows).

    Raises ValueError for flights no longer than the last horizon, and where no horizon is a whole number of rows.
    """
    ahead = {
        h: round(h / row_s)
        for h in horizons_s
        if round(h / row_s) > 0 and abs(round(h / row_s) * row_s - h) < 1e-9
    }
    if not ahead or max(ahead.values()) >= distance_m.shape[1]:
        raise ValueError(
            f"{distance_m.shape[1]} rows {row_s:g} s apart: more than {max(horizons_s):g} s of rows are needed, and horizons that "
            f"are whole numbers of them; received {tuple(horizons_s)}"
        )
    coefficients, constants, sigmas = [], [], []
    for rows in ahead.values():
        x = regressors[:, :-rows].reshape(-1, regressors.shape[2])
        y = distance_m[:, rows:].ravel()
        centre, spread = x.mean(axis=0), x.std(axis=0)
        unit = np.where(spread > 0.0, spread, 1.0)
        z = (x - centre) / unit
        slopes = (
            np.linalg.solve(z.T @ z + RIDGE * len(z) * np.eye(z.shape[1]), z.T @ (y - y.mean()))
            / unit
        )
        constants.append(float(y.mean() - centre @ slopes))
        coefficients.append(tuple(map(float, slopes)))
        sigmas.append(float((y - x @ slopes - constants[-1]).std()))
    return Predicted(radius_m, tuple(ahead), tuple(coefficients), tuple(constants), tuple(sigmas))
