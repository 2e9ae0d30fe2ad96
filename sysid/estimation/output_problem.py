"""Output error's cost over the free parameters, with the sensitivities its steps need: differenced anew, or carried on."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from sysid.arrays import FloatArray
from sysid.estimation.gauss_newton import Linearisation, Told
from sysid.estimation.noise import Noise, concentrated, residual_noise
from sysid.estimation.sensitivities import (
    TARGET,
    MapLike,
    SafeSimulation,
    roughness,
    sensitivities,
    target_for,
)
from sysid.linalg.blocks import Blocks, Index

CARRIED = 8  # secant updates before sensitivities are differenced anew
NEARBY = 0.5  # standard errors within which sensitivities need no renewal


@dataclass
class OutputErrorProblem:
    """The cost over the free parameters; counts simulations and keeps the adapted difference steps."""

    simulation: SafeSimulation
    measured: FloatArray
    full_theta: FloatArray
    columns: list[int]
    limits: tuple[FloatArray, FloatArray]
    spread: FloatArray
    full: bool
    map_: MapLike | None
    step: FloatArray
    secant: bool = False
    told: Told | None = None
    runs: int = 0
    last_failure: str = ""
    sensitivity: Blocks = field(default_factory=lambda: Blocks((), (), 0))
    _last: tuple[FloatArray, FloatArray] | None = None
    _fresh: tuple[FloatArray, Blocks, FloatArray] | None = None
    _metric: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    _updates: int = 0
    _target: float | None = None
    _begun: bool = False

    @property
    def edges(self) -> list[int]:
        """Rows at which segments begin, and the number of rows at the end."""
        return [0, *np.cumsum(self.simulation.lengths).tolist()]

    @property
    def floor(self) -> FloatArray:
        """Least noise (ny,) an output may have: rounding of its own spread."""
        return 1e-9 * self.spread

    def whole(self, theta: FloatArray) -> FloatArray:
        """All parameters, with the free ones at ``theta`` and the fixed ones at their given values."""
        out = self.full_theta.copy()
        out[self.columns] = theta
        return out

    def noise(self, outputs: FloatArray) -> Noise:
        """Measurement noise at its maximum-likelihood value for these outputs (n, ny)."""
        return residual_noise(self.measured - outputs, self.floor, self.full)

    def evaluate(self, theta: FloatArray) -> tuple[float, FloatArray] | None:
        """Concentrated cost at ``theta`` and the outputs (n, ny); None where the simulation failed."""
        self.runs += 1
        outputs = self.simulation(self.whole(theta))
        if isinstance(outputs, str):
            self.last_failure = outputs
            return None
        return concentrated(self.measured - outputs, self.noise(outputs)), outputs

    def linearise(self, theta: FloatArray, outputs: FloatArray, central: bool) -> Linearisation:
        """Gradient and information at theta (k,), whose outputs (N, m) are given.

        With ``secant`` the sensitivities of the last point are carried on by Broyden's update (Math. Comp. 19, 1965)

            S += (dy - S d) (W d)' / (d' W d),    W = diag M

        (segment by segment, where S is not zero: Schubert, Math. Comp. 24, 1970), which costs no simulation; they are differenced
        anew, forwards, when that has been done CARRIED times, when the search nears its end, and at a point asked for twice.
        """
        carried = self._carry(theta, outputs, central) if self.secant else None
        if carried is None:
            self._difference(theta, outputs, central and not self.secant)
        line = self._line(outputs)
        self._metric, self._last = line.information, (theta.copy(), outputs)
        if carried is None:
            self._fresh = (theta.copy(), self.sensitivity, line.information)
            return replace(line, exact=central or self.secant)
        return replace(line, exact=carried, fresh=False)

    def settle(self, theta: FloatArray, outputs: FloatArray) -> Linearisation:
        """The linearisation that bounds are computed from: differences at theta itself, or a small part of a bound away."""
        if self.secant and self._fresh is not None and self._distance(theta) < NEARBY:
            self.sensitivity = self._fresh[1]
        else:
            self._difference(theta, outputs, not self.secant)
        return self._line(outputs)

    def _distance(self, theta: FloatArray) -> float:
        """Standard errors from where sensitivities were last differenced."""
        assert self._fresh is not None
        away = theta - self._fresh[0]
        return float(np.sqrt(np.maximum(away @ self._fresh[2] @ away, 0.0)))

    def _carry(self, theta: FloatArray, outputs: FloatArray, central: bool) -> bool | None:
        """Sensitivities carried on to theta: True near where they were differenced, False far from there, None: not possible."""
        if self._last is None or self._updates >= CARRIED:
            return None
        step = theta - self._last[0]
        along = np.diagonal(self._metric) * step
        near = self._distance(theta) < NEARBY
        if not float(step @ along) > 0.0 or (central and not near):
            return None
        change = outputs - self._last[1] - self.sensitivity.times(step)

        def updated(part: FloatArray, columns: Index, rows: slice) -> FloatArray:
            size = float(step[columns] @ along[columns])
            return part + change[rows, :, None] * (along[columns] / size) if size > 0.0 else part

        self.sensitivity = self.sensitivity.each(updated)
        self._updates += 1
        return near

    def _difference(self, theta: FloatArray, outputs: FloatArray, central: bool) -> None:
        """Sensitivities by differences; the second time, how small their steps may be as well: a fit that begins where it ends asks
        once."""
        if self._begun and self._target is None:
            small = np.zeros_like(self.step)
            small[self.columns] = 1e-3 * self.step[self.columns]
            rough, runs = roughness(
                self.simulation,
                self.whole(theta),
                outputs,
                small,
                self.limits,
                self.spread,
                self.map_,
            )
            self._target, self.runs = target_for(rough), self.runs + runs
        found = sensitivities(
            self.simulation,
            self.whole(theta),
            outputs,
            self.step,
            self.columns,
            self.limits,
            self.spread,
            central=central,
            map_=self.map_,
            target=self._target or TARGET,
        )
        self.step, self.runs, self._begun = found.step, self.runs + found.runs, True
        self.sensitivity, self._updates = found.sensitivity, 0

    def _line(self, outputs: FloatArray) -> Linearisation:
        sensitivity, residual, noise = (
            self.sensitivity,
            self.measured - outputs,
            self.noise(outputs),
        )
        k = len(self.columns)
        gradient, information = np.zeros(k), np.zeros((k, k))
        for (a, b), (part, columns) in zip(pairwise(self.edges), sensitivity, strict=True):
            white, scaled = noise.whiten(residual[a:b], part)
            assert scaled is not None
            flat = scaled.reshape(-1, columns.size)
            gradient[columns] += flat.T @ white.ravel()
            information[np.ix_(columns, columns)] += flat.T @ flat

        def predict(delta: FloatArray) -> float:
            expected = residual - sensitivity.times(delta)
            return concentrated(expected, residual_noise(expected, self.floor, self.full))

        # M = sum S' R^-1 S,  g = sum S' R^-1 v: one Gauss-Newton step is M^-1 g
        return Linearisation(gradient, information, predict)
