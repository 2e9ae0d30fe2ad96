"""The innovations' likelihood as a function of one parameter vector: packing, cost, gradient, Fisher information."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from sysid.arrays import FloatArray
from sysid.estimation.ekf import Innovations, Model, Record, run_filter
from sysid.estimation.filter_layout import Layout
from sysid.estimation.gauss_newton import Linearisation, Told

LANES = 600  # points x segments filtered side by side, bounded for memory
CARRIED = 8  # secant updates before derivatives are differenced anew
NEARBY = 0.1  # standard errors within which they need no renewal
TARGET = 1e-3  # wanted rms change of the whitened innovations under a difference step
ROUGHLY = (
    1e-7,
    0.1,
)  # a change outside this range is repeated with another step: a filter pass is dear
LOG_STEP = 1e-3


@dataclass
class State:
    """Innovations at a point; e, s and e/sqrt(s) (N, m) by rows, N = n x segments, segment-major; and, once linearised, the
    whitened derivatives of e (N, m, K)."""

    base: Innovations
    e: FloatArray
    s: FloatArray
    white: FloatArray
    sensitivity: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 0)))


@dataclass
class Sensitivities:
    """Derivatives of e and s, dE and dS (N, m, K), at a point with its e and s; what the secant updates hold on to."""

    vector: FloatArray
    e: FloatArray
    s: FloatArray
    dE: FloatArray
    dS: FloatArray
    metric: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))


def _cost(white: FloatArray, s: FloatArray) -> float:
    """1/2 sum [e^2/s + ln s] from e/sqrt(s) and s."""
    return 0.5 * float(np.sum(white**2)) + 0.5 * float(np.sum(np.log(s)))


@dataclass
class FilterProblem:
    """The cost over the packed vector; keeps the adapted difference steps and counts the filter runs."""

    model: Model
    record: Record
    layout: Layout
    initial: FloatArray
    p0: FloatArray
    difference: FloatArray
    every: int
    state_scale: FloatArray
    step: FloatArray | None = None
    told: Told | None = None
    runs: int = 0
    _last: Sensitivities | None = None
    _fresh: tuple[FloatArray, FloatArray] | None = None
    _updates: int = 0

    def _filter(self, vectors: list[FloatArray]) -> Innovations | None:
        parts = [self.layout.unpack(vector, self.initial) for vector in vectors]
        self.runs += len(vectors)
        return run_filter(
            self.model,
            self.record,
            np.column_stack([part[0] for part in parts]),
            np.column_stack([part[1] for part in parts]),
            np.column_stack([part[2] for part in parts]),
            np.stack([part[3] for part in parts], axis=1),
            self.p0,
            self.difference,
            self.every,
        )

    def best_process_noise(
        self, theta: FloatArray, candidates: list[FloatArray], r: FloatArray
    ) -> FloatArray:
        """Of the candidate Q (nx,), all filtered side by side, the one with the lowest cost."""
        found = self._filter([self.layout.pack(theta, q, r, self.initial) for q in candidates])
        if found is None:
            return candidates[-1]  # the most noise: the filter that trusts the model least
        costs = []
        for point in range(len(candidates)):
            s = self._rows(found.s, point)
            costs.append(_cost(self._rows(found.e, point) / np.sqrt(s), s))
        return candidates[int(np.argmin(costs))]

    def _rows(self, values: FloatArray, point: int) -> FloatArray:
        """One point's lanes of e or s (n, m, W) as (N, m), segment-major."""
        n, m, segments = self.record.z.shape
        return (
            values[:, :, point * segments : (point + 1) * segments]
            .transpose(2, 0, 1)
            .reshape(n * segments, m)
        )

    def evaluate(self, vector: FloatArray) -> tuple[float, State] | None:
        """J of filtererror.py, None where the filter fails."""
        found = self._filter([vector])
        if found is None:
            return None
        e, s = self._rows(found.e, 0), self._rows(found.s, 0)
        white = e / np.sqrt(s)
        return _cost(white, s), State(found, e, s, white)

    def _points(self, vector: FloatArray, some: Iterable[int], central: bool) -> list[FloatArray]:
        """Points a step up for each of `some`, in turn, and with ``central`` a step down."""
        points = []
        for index in some:
            for shift in self._shifts(vector, index)[: 2 if central else 1]:
                point = vector.copy()
                point[index] += shift
                points.append(point)
        return points

    def _shifts(self, vector: FloatArray, index: int) -> tuple[float, float]:
        """Up and down a step; no variance is taken below zero."""
        assert self.step is not None
        step = float(self.step[index])
        process = self.layout.process
        down = min(step, float(vector[index])) if process.start <= index < process.stop else step
        return step, -down

    def _first_steps(self, vector: FloatArray) -> FloatArray:
        step = 1e-4 * np.where(vector != 0.0, np.abs(vector), 1.0)
        step[self.layout.process] = 1e-3 * np.maximum(
            vector[self.layout.process], 1e-6 * self.state_scale[self.layout.noisy] ** 2
        )
        step[self.layout.logs] = LOG_STEP
        if self.layout.with_x0:
            step[self.layout.logs.stop :] = 1e-3 * np.tile(self.state_scale, self.layout.segments)
        return step

    def linearise(self, vector: FloatArray, state: State, central: bool) -> Linearisation:
        """Gradient and information of the module's equations at a point whose innovations are given.

        The derivatives of e and s are those of the last point, carried on by Broyden's update (Math. Comp. 19, 1965)

            D += (dy - D d) (M d)' / (d' M d)

        which costs no filter run; they are differenced anew, forwards, when that has been done CARRIED times, when the search
        nears its end and at a point asked for twice.
        """
        near = self._carry(vector, state, central)
        if near is None:
            return self._anew(vector, state, False)
        assert self._last is not None
        line = self._line(state)
        self._last.metric = line.information
        return replace(line, exact=near, fresh=False)

    def settle(self, vector: FloatArray, state: State) -> Linearisation:
        """The linearisation that bounds are computed from, by central differences."""
        return self._anew(vector, state, True)

    def _anew(self, vector: FloatArray, state: State, central: bool) -> Linearisation:
        self._difference(vector, state, central)
        assert self._last is not None
        line = self._line(state)
        self._last.metric, self._fresh = line.information, (vector.copy(), line.information)
        return line

    def _line(self, state: State) -> Linearisation:
        assert self._last is not None
        size = self._last.vector.size
        state.sensitivity = self._last.dE / np.sqrt(state.s)[:, :, None]
        e, flat = state.white.ravel(), state.sensitivity.reshape(-1, size)
        trace = (self._last.dS / state.s[:, :, None]).reshape(-1, size)
        gradient = -(e @ flat + 0.5 * trace.sum(axis=0) - 0.5 * (e**2) @ trace)
        information = flat.T @ flat + 0.5 * trace.T @ trace
        cost = _cost(state.white, state.s)

        def predict(delta: FloatArray) -> float:
            return cost - float(gradient @ delta) + 0.5 * float(delta @ information @ delta)

        return Linearisation(gradient, information, predict)

    def _carry(self, vector: FloatArray, state: State, central: bool) -> bool | None:
        """Derivatives carried on: True near where they were differenced, False far from there, None: not possible."""
        last = self._last
        if last is None or self._fresh is None or self._updates >= CARRIED:
            return None
        step = vector - last.vector
        along = last.metric @ step
        size = float(step @ along)
        away = vector - self._fresh[0]
        near = float(away @ self._fresh[1] @ away) < NEARBY**2
        if not size > 0.0 or (central and not near):
            return None
        for derivative, change in ((last.dE, state.e - last.e), (last.dS, state.s - last.s)):
            derivative += (change - derivative @ step)[:, :, None] * (along / size)
        last.vector, last.e, last.s = vector.copy(), state.e, state.s
        self._updates += 1
        return near

    def _difference(self, vector: FloatArray, state: State, central: bool) -> None:
        """Derivatives by differences of the filter, in blocks of lanes."""
        if self.step is None:
            self.step = self._first_steps(vector)
        size = vector.size
        new = Sensitivities(
            vector.copy(),
            state.e,
            state.s,
            np.zeros((*state.e.shape, size)),
            np.zeros((*state.e.shape, size)),
        )
        pending = list(range(size))
        for attempt in range(4):
            again: list[int] = []
            block = max(1, LANES // ((2 if central else 1) * self.record.z.shape[2]))
            for first in range(0, len(pending), block):
                some = pending[first : first + block]
                again += self._differences(new, some, central, attempt == 3)
            pending = again
            if not pending:
                break
        self._last, self._updates = new, 0

    def _differences(
        self, new: Sensitivities, some: list[int], central: bool, last: bool
    ) -> list[int]:
        """Fill the derivatives by the parameters `some`; return those whose step was bad."""
        assert self.step is not None
        found = self._filter(self._points(new.vector, some, central))
        if found is None:
            if len(some) > 1:  # one bad point spoils the batch: find it
                half = len(some) // 2
                return [
                    index
                    for part in (some[:half], some[half:])
                    for index in self._differences(new, part, central, last)
                ]
            self.step[some[0]] *= 0.03
            return list(some)
        again = []
        logs = range(*self.layout.logs.indices(new.vector.size))
        deviation = np.sqrt(new.s)
        for place, index in enumerate(some):
            up, down = self._shifts(new.vector, index)
            if central:
                above, below = (
                    tuple(self._rows(v, 2 * place + k) for v in (found.e, found.s)) for k in (0, 1)
                )
            else:
                above, below, down = (
                    (self._rows(found.e, place), self._rows(found.s, place)),
                    (new.e, new.s),
                    0.0,
                )
            new.dE[:, :, index] = (above[0] - below[0]) / (up - down)
            new.dS[:, :, index] = (above[1] - below[1]) / (up - down)
            if index in logs:
                continue
            change = self.step[index] * float(
                np.sqrt(
                    np.mean((new.dE[:, :, index] / deviation) ** 2)
                    + np.mean((new.dS[:, :, index] / new.s) ** 2)
                )
            )
            if change <= 1e-11:
                limit = 1e2 * max(abs(new.vector[index]), 1.0)
                if self.step[index] < limit and not last:
                    self.step[index] = min(1e3 * self.step[index], limit)
                    again.append(index)
                else:
                    new.dE[:, :, index], new.dS[:, :, index] = 0.0, 0.0
            elif not ROUGHLY[0] < change < ROUGHLY[1] and not last:
                self.step[index] *= TARGET / change
                again.append(index)
            else:
                self.step[index] *= float(np.clip(TARGET / change, 0.1, 10.0))
        return again

    def whitened(self, state: State) -> tuple[list[FloatArray], list[FloatArray]]:
        """Per segment: sensitivities of the innovations (n, m, K), zero where missing; white innovations, NaN there.

        The sign is that of a model output's sensitivity, minus the innovation's.
        """
        n, m, segments = self.record.z.shape
        sensitivity = -state.sensitivity.reshape(segments, n, m, -1)
        white = state.white.reshape(segments, n, m)
        pieces, whites = [], []
        for index, length in enumerate(self.record.lengths):
            there = np.isfinite(self.record.z[:length, :, index])
            pieces.append(np.where(there[:, :, None], sensitivity[index, :length], 0.0))
            whites.append(np.where(there, white[index, :length], np.nan))
        return pieces, whites
