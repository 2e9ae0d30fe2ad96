"""Filter error: maximum likelihood for process and measurement noise.

The cost is that of the innovations e of an extended Kalman filter with covariances S,

    J = 1/2 sum_i [e(i)' S(i)^-1 e(i) + ln det S(i)]

over theta, the process noise Q, the logarithm of the measurement noise and, optionally, the initial
states. It is minimised by Fisher scoring:

    dJ/da = sum e_a' S^-1 e + 1/2 tr(S^-1 S_a) - 1/2 e' S^-1 S_a S^-1 e      (gradient)
    M_ab  = sum e_a' S^-1 e_b + 1/2 tr(S^-1 S_a S^-1 S_b)                    (information)

`filter_error` is the estimator for flights in turbulence. Maine, R. E. and Iliff, K. W.,
NASA RP-1168 (1986), ch. 5-6; Jategaonkar (2015), ch. 5; Astrom, Automatica 16 (1980).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.arrays import (
    FloatArray,
    as_array,
    as_bounds,
    as_free,
    as_names,
    as_parameters,
    as_segments,
    is_segment_list,
)
from sysid.estimation.coloured_residuals import colour, colour_warnings, sandwich_covariance
from sysid.estimation.gauss_newton import IterationCallback, Linearisation, Minimum, minimise
from sysid.estimation.kalman import (
    Innovations,
    Model,
    ModelFunction,
    Record,
    make_model,
    run_filter,
)
from sysid.estimation.results import (
    FilterErrorFit,
    assess,
    at_bound,
    idle_bound,
    masked_covariance,
    outward,
)

# Input of `filter_error`: padded records, and first guesses of noise and scale from the data.


def read_record(
    x0: Any, u: Any, z: Any, t: Any, zero_order_hold: bool, u_middle: Any = None
) -> tuple[Record, FloatArray]:
    """Check the data of `filter_error` and pad segments to one length.

    Returns the padded record and the initial states (nx, s). Raises ValueError where segments
    disagree.
    """
    outputs = as_segments(z, "z", dropouts=True)
    times = [part[:, 0] for part in as_segments(t, "t", dropouts=False)]
    empty = [np.zeros((part.shape[0], 1)) for part in outputs]
    inputs = empty if u is None else as_segments(u, "u", dropouts=False)
    lengths = [part.shape[0] for part in outputs]
    if [part.shape[0] for part in inputs] != lengths or [part.size for part in times] != lengths:
        raise ValueError(
            f"samples per segment differ: z {lengths}, u {[part.shape[0] for part in inputs]}, t "
            f"{[p.size for p in times]}; give u, z and t at the same samples"
        )
    for number, time in enumerate(times):
        if time.size < 2 or not (np.diff(time) > 0.0).all():
            raise ValueError(
                f"t of segment {number} does not increase at every sample (or has fewer than 2);"
                " sort or split it"
            )
    # One vector per segment: a list of vectors or the rows of one array.
    one_per_segment = is_segment_list(x0) or np.ndim(x0) == 2
    starts = [
        as_parameters(part, "x0") for part in (x0 if one_per_segment else [x0] * len(lengths))
    ]
    if len(starts) != len(lengths) or any(part.size != starts[0].size for part in starts):
        raise ValueError(
            f"x0 has {len(starts)} vectors of {[p.size for p in starts]}, z has {len(lengths)}"
            " segments; match them"
        )
    longest, s = max(lengths), len(lengths)
    U = np.zeros((longest, inputs[0].shape[1], s))
    Z = np.full((longest, outputs[0].shape[1], s), np.nan)
    dt = np.empty((longest - 1, s))
    for index, length in enumerate(lengths):
        U[:length, :, index], U[length:, :, index] = inputs[index], inputs[index][-1]
        Z[:length, :, index] = outputs[index]
        step = np.diff(times[index])
        # With dt = 0 in the padding the state stays constant after a segment's end.
        dt[:, index] = np.concatenate([step, np.zeros(longest - length)])
    middle = None if u_middle is None else _middle_inputs(u_middle, inputs, longest)
    return Record(U, Z, dt, tuple(lengths), zero_order_hold, middle), np.column_stack(starts)


def _middle_inputs(u_middle: Any, inputs: list[FloatArray], longest: int) -> FloatArray:
    """Pad the inputs half-way between samples, (longest - 1, nu, s)."""
    parts = as_segments(u_middle, "u_middle", dropouts=False)
    expected_shapes = [(part.shape[0] - 1, part.shape[1]) for part in inputs]
    if [part.shape for part in parts] != expected_shapes:
        raise ValueError(
            f"u_middle has segments of shape {[part.shape for part in parts]}; half-way between the"
            f" samples of u there are {expected_shapes}"
        )
    out = np.zeros((longest - 1, inputs[0].shape[1], len(inputs)))
    for index, part in enumerate(parts):
        out[: len(part), :, index], out[len(part) :, :, index] = part, inputs[index][-1]
    return out


def noisy_states(chosen: Any, nx: int) -> NDArray[np.intp]:
    """Return indices of the states with process noise; None selects all. Raises ValueError."""
    if chosen is None:
        return np.arange(nx)
    try:
        return (
            np.flatnonzero(as_free(list(chosen), tuple(f"x{i}" for i in range(nx))))
            if len(list(chosen))
            else np.arange(0)
        )
    except ValueError as error:
        raise ValueError(f"process_noise: {error}") from None


def positive_vector(value: ArrayLike, size: int, label: str) -> FloatArray:
    """Broadcast ``value`` to a vector (size,) of finite positive numbers.

    Raises ValueError that names the argument ``label``.
    """
    vector = np.broadcast_to(as_array(value, label), (size,)).astype(float)
    if not (np.isfinite(vector).all() and (vector > 0.0).all()):
        raise ValueError(f"{label} is {vector.tolist()}; give {size} positive numbers")
    return vector


def output_scales(record: Record) -> FloatArray:
    """Return the standard deviation (m,) of each output, or its size where it is constant."""
    flat = record.z.transpose(0, 2, 1).reshape(-1, record.z.shape[1])
    deviation, size = np.nanstd(flat, axis=0), np.nanmax(np.abs(flat), axis=0)
    return np.where(deviation > 1e-12 * size, deviation, np.where(size > 0.0, size, 1.0))


def measurement_noise(record: Record) -> FloatArray:
    """Guess the measurement noise (m,) from third differences: their variance is 20 sigma^2.

    Smooth motion hardly contributes to third differences.
    """
    out = np.empty(record.z.shape[1])
    output_scale = output_scales(record)
    for channel in range(out.size):
        third_differences = np.diff(record.z[:, channel, :], n=3, axis=0)
        third_differences = third_differences[np.isfinite(third_differences)]
        out[channel] = (
            np.sqrt(np.mean(third_differences**2) / 20.0)
            if third_differences.size > 10
            else 0.1 * output_scale[channel]
        )
    return np.maximum(out, 1e-4 * output_scale)


def state_scale(
    model: Model, record: Record, theta: FloatArray, initial: FloatArray, output_scale: FloatArray
) -> FloatArray:
    """Estimate how far (nx,) each state may be off.

    It is the change that moves an output by ``output_scale`` (m,); else the state's size, or 1.
    """
    nx = model.states
    scale = np.empty(nx)
    x, u = initial[:, :1], record.u[0, :, :1]
    base = model.output(x, u, theta[:, None])[:, 0]
    for index in range(nx):
        size = max(float(np.abs(initial[index]).max()), 1e-3)
        shifted = x.copy()
        shifted[index] += 1e-4 * size
        slope = np.abs(model.output(shifted, u, theta[:, None])[:, 0] - base) / (1e-4 * size)
        reach = [
            output_scale[c] / slope[c]
            for c in range(base.size)
            if slope[c] * size > 1e-9 * output_scale[c]
        ]
        scale[index] = min(reach) if reach else max(float(np.abs(initial[index]).max()), 1.0)
    return scale


# Order of the unknowns in one vector: parameters, process noise, measurement noise, initial states.


@dataclass(frozen=True)
class Layout:
    """Order of the vector: free theta, Q of noisy states, ln r, initial states segment by segment.

    Q enters as a variance with the bound zero, where its gradient shows whether the data contain
    process noise. A logarithm would drift along a flat valley, and Fisher scoring is nearly exact
    in variances. R has no such bound.

    Attributes
    ----------
    theta0 : array (k,)
        Start, with the values of the fixed parameters.
    columns : array
        Indices of the free parameters.
    noisy : array
        Indices of the states with process noise.
    outputs, states, segments : int
        Numbers m, nx and s.
    with_x0 : bool
        Initial states are estimated.
    """

    theta0: FloatArray
    columns: NDArray[np.intp]
    noisy: NDArray[np.intp]
    outputs: int
    states: int
    segments: int
    with_x0: bool

    @property
    def process(self) -> slice:
        """Elements of the process-noise variances."""
        return slice(self.columns.size, self.columns.size + self.noisy.size)

    @property
    def logs(self) -> slice:
        """Elements of the logarithms of the measurement noise."""
        return slice(self.process.stop, self.process.stop + self.outputs)

    def pack(self, theta: FloatArray, q: FloatArray, r: FloatArray, x0: FloatArray) -> FloatArray:
        """Pack theta (k,), q (nx,) variances, r (m,) standard deviations and x0 (nx, s) into a
        vector.
        """
        parts = [theta[self.columns], q[self.noisy], np.log(r)]
        return np.concatenate([*parts, x0.T.ravel()] if self.with_x0 else parts)

    def unpack(
        self, vector: FloatArray, x0: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Unpack theta (k,), Q (nx,) variances per second, r (m,) standard deviations and x0 (nx,
        s).
        """
        theta, q = self.theta0.copy(), np.zeros(self.states)
        a, b = self.columns.size, self.columns.size + self.noisy.size
        theta[self.columns] = vector[:a]
        q[self.noisy] = vector[a:b]
        r = np.exp(vector[b : b + self.outputs])
        if self.with_x0:
            x0 = vector[b + self.outputs :].reshape(self.segments, self.states).T
        return theta, q, r, x0

    def limits(
        self, lower: FloatArray, upper: FloatArray, scale: FloatArray, output_scale: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the bounds of the vector.

        Q is at most (a thousand state scales)^2, r lies within 1e-5 and 10 times ``output_scale``
        (m,).
        """
        low = [lower[self.columns], np.zeros(self.noisy.size), np.log(1e-5 * output_scale)]
        high = [upper[self.columns], (1e3 * scale[self.noisy]) ** 2, np.log(1e1 * output_scale)]
        extra = [np.full(self.segments * self.states, np.inf)] if self.with_x0 else []
        return np.concatenate(low + [-part for part in extra]), np.concatenate(high + extra)

    def names(self, labels: tuple[str, ...]) -> list[str]:
        """Return the name of every element."""
        out = [labels[i] for i in self.columns] + [f"Q of state {i}" for i in self.noisy]
        out += [f"ln r of output {i}" for i in range(self.outputs)]
        if self.with_x0:
            out += [
                f"x0[{i}] of segment {s}" for s in range(self.segments) for i in range(self.states)
            ]
        return out


# The innovations' likelihood as a function of one vector: cost, gradient, Fisher information.

LANES = 600
"""Points times segments that are filtered side by side, limited by memory."""
MAX_SECANT_UPDATES = 8
"""Secant updates before derivatives are differenced again."""
NEARBY = 0.1
"""Distance in standard errors within which derivatives need no renewal."""
TARGET = 1e-3
"""Target rms change of the whitened innovations by a difference step."""
ACCEPTED_CHANGE = (
    1e-7,
    0.1,
)
"""Changes outside this range are repeated with another step; a filter pass is expensive."""
LOG_STEP = 1e-3


@dataclass
class State:
    """Innovations at a point.

    ``e``, ``s`` and ``white`` = e/sqrt(s) are (N, m) by rows, N = n times segments, segment-major;
    ``sensitivity`` (N, m, K) are the whitened derivatives of e, once linearised.
    """

    base: Innovations
    e: FloatArray
    s: FloatArray
    white: FloatArray
    sensitivity: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 0)))


@dataclass
class Sensitivities:
    """Derivatives dE and dS (N, m, K) of e and s at a point, as the secant updates keep them.

    ``metric`` (K, K) is the information at that point.
    """

    vector: FloatArray
    e: FloatArray
    s: FloatArray
    dE: FloatArray
    dS: FloatArray
    metric: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))


def _cost(white: FloatArray, s: FloatArray) -> float:
    """Compute 1/2 sum [e^2/s + ln s] from e/sqrt(s) and s."""
    return 0.5 * float(np.sum(white**2)) + 0.5 * float(np.sum(np.log(s)))


@dataclass
class FilterProblem:
    """The cost over the packed vector; keeps adapted difference steps and counts filter runs."""

    model: Model
    record: Record
    layout: Layout
    initial: FloatArray
    p0: FloatArray
    difference: FloatArray
    every: int
    state_scale: FloatArray
    step: FloatArray | None = None
    callback: IterationCallback | None = None
    runs: int = 0
    _last: Sensitivities | None = None
    _fresh: tuple[FloatArray, FloatArray] | None = None
    _updates: int = 0

    def _filter(self, vectors: list[FloatArray]) -> Innovations | None:
        """Filter several vectors side by side."""
        parts = [self.layout.unpack(vector, self.initial) for vector in vectors]
        self.runs += len(vectors)
        return run_filter(
            self.model,
            self.record,
            np.column_stack([part[0] for part in parts]),
            np.column_stack([part[1] for part in parts]),
            np.column_stack([part[2] for part in parts]),
            np.stack([part[3] for part in parts], axis=1),
            p0=self.p0,
            difference=self.difference,
            every=self.every,
        )

    def best_process_noise(
        self, theta: FloatArray, candidates: list[FloatArray], r: FloatArray
    ) -> FloatArray:
        """Return the candidate Q (nx,) with the lowest cost; all are filtered side by side."""
        innovations = self._filter(
            [self.layout.pack(theta, q, r, self.initial) for q in candidates]
        )
        if innovations is None:
            # The largest noise depends least on the model.
            return candidates[-1]
        costs = []
        for point in range(len(candidates)):
            s = self._rows(innovations.s, point)
            costs.append(_cost(self._rows(innovations.e, point) / np.sqrt(s), s))
        return candidates[int(np.argmin(costs))]

    def _rows(self, values: FloatArray, point: int) -> FloatArray:
        """Return one point's lanes of e or s (n, m, W) as (N, m), segment-major."""
        n, m, segments = self.record.z.shape
        return (
            values[:, :, point * segments : (point + 1) * segments]
            .transpose(2, 0, 1)
            .reshape(n * segments, m)
        )

    def evaluate(self, vector: FloatArray) -> tuple[float, State] | None:
        """Return the cost and the innovations, None where the filter fails."""
        innovations = self._filter([vector])
        if innovations is None:
            return None
        e, s = self._rows(innovations.e, 0), self._rows(innovations.s, 0)
        white = e / np.sqrt(s)
        return _cost(white, s), State(innovations, e, s, white)

    def _points(
        self, vector: FloatArray, indices: Iterable[int], central: bool
    ) -> list[FloatArray]:
        """Return a point one step up for each index and, if ``central``, one step down."""
        points = []
        for index in indices:
            for shift in self._shifts(vector, index)[: 2 if central else 1]:
                point = vector.copy()
                point[index] += shift
                points.append(point)
        return points

    def _shifts(self, vector: FloatArray, index: int) -> tuple[float, float]:
        """Return the steps up and down; no variance becomes negative."""
        assert self.step is not None
        step = float(self.step[index])
        process = self.layout.process
        down = min(step, float(vector[index])) if process.start <= index < process.stop else step
        return step, -down

    def _first_steps(self, vector: FloatArray) -> FloatArray:
        """Return the first difference steps, by the kind of unknown."""
        # Steps relative to parameters, variances and state scales; a fixed step for logarithms.
        step = 1e-4 * np.where(vector != 0.0, np.abs(vector), 1.0)
        step[self.layout.process] = 1e-3 * np.maximum(
            vector[self.layout.process], 1e-6 * self.state_scale[self.layout.noisy] ** 2
        )
        step[self.layout.logs] = LOG_STEP
        if self.layout.with_x0:
            step[self.layout.logs.stop :] = 1e-3 * np.tile(self.state_scale, self.layout.segments)
        return step

    def linearise(self, vector: FloatArray, state: State, central: bool) -> Linearisation:
        """Compute gradient and information at a point with known innovations.

        The derivatives of e and s are those of the last point, updated by Broyden's formula (Math.
        Comp. 19, 1965)

            D += (dy - D d) (M d)' / (d' M d)

        which needs no filter run. They are differenced again, forwards, after MAX_SECANT_UPDATES
        updates, near the end of the search, and at a point that is linearised twice.
        """
        is_near = self._secant_update(vector, state, central)
        if is_near is None:
            return self._difference_and_linearise(vector, state, False)
        assert self._last is not None
        linearisation = self._linearisation(state)
        self._last.metric = linearisation.information
        return replace(linearisation, exact=is_near, fresh=False)

    def settle(self, vector: FloatArray, state: State) -> Linearisation:
        """Compute the linearisation for standard errors, by central differences."""
        return self._difference_and_linearise(vector, state, True)

    def _difference_and_linearise(
        self, vector: FloatArray, state: State, central: bool
    ) -> Linearisation:
        """Difference the filter at a point and linearise there."""
        self._difference(vector, state, central)
        assert self._last is not None
        linearisation = self._linearisation(state)
        self._last.metric, self._fresh = (
            linearisation.information,
            (vector.copy(), linearisation.information),
        )
        return linearisation

    def _linearisation(self, state: State) -> Linearisation:
        """Build gradient and information of the module's equations from the derivatives."""
        assert self._last is not None
        size = self._last.vector.size
        # Whitened derivatives give the module's gradient and information.
        state.sensitivity = self._last.dE / np.sqrt(state.s)[:, :, None]
        e, flat = state.white.ravel(), state.sensitivity.reshape(-1, size)
        trace = (self._last.dS / state.s[:, :, None]).reshape(-1, size)
        gradient = -(e @ flat + 0.5 * trace.sum(axis=0) - 0.5 * (e**2) @ trace)
        information = flat.T @ flat + 0.5 * trace.T @ trace
        cost = _cost(state.white, state.s)

        def predict(delta: FloatArray) -> float:
            return cost - float(gradient @ delta) + 0.5 * float(delta @ information @ delta)

        return Linearisation(gradient, information, predict)

    def _secant_update(self, vector: FloatArray, state: State, central: bool) -> bool | None:
        """Update the derivatives to a new point.

        Returns True near the point where they were differenced, False far from it, None if an
        update is not possible.
        """
        last = self._last
        if last is None or self._fresh is None or self._updates >= MAX_SECANT_UPDATES:
            return None
        # Broyden's update in the metric of the last information.
        step = vector - last.vector
        metric_step = last.metric @ step
        size = float(step @ metric_step)
        displacement = vector - self._fresh[0]
        is_near = float(displacement @ self._fresh[1] @ displacement) < NEARBY**2
        if not size > 0.0 or (central and not is_near):
            return None
        for derivative, change in ((last.dE, state.e - last.e), (last.dS, state.s - last.s)):
            derivative += (change - derivative @ step)[:, :, None] * (metric_step / size)
        last.vector, last.e, last.s = vector.copy(), state.e, state.s
        self._updates += 1
        return is_near

    def _difference(self, vector: FloatArray, state: State, central: bool) -> None:
        """Difference the filter with every unknown, in blocks of lanes."""
        if self.step is None:
            self.step = self._first_steps(vector)
        size = vector.size
        # Difference all unknowns; repeat those with an unsuitable step, at most three times.
        derivatives = Sensitivities(
            vector.copy(),
            state.e,
            state.s,
            np.zeros((*state.e.shape, size)),
            np.zeros((*state.e.shape, size)),
        )
        pending = list(range(size))
        for attempt in range(4):
            repeated: list[int] = []
            # Blocks of points are filtered side by side.
            block = max(1, LANES // ((2 if central else 1) * self.record.z.shape[2]))
            for first in range(0, len(pending), block):
                block_indices = pending[first : first + block]
                repeated += self._differences(derivatives, block_indices, central, attempt == 3)
            pending = repeated
            if not pending:
                break
        self._last, self._updates = derivatives, 0

    def _differences(
        self, derivatives: Sensitivities, indices: list[int], central: bool, last: bool
    ) -> list[int]:
        """Fill the derivatives with some unknowns and return those whose step was unsuitable."""
        assert self.step is not None
        innovations = self._filter(self._points(derivatives.vector, indices, central))
        if innovations is None:
            if len(indices) > 1:  # one bad point spoils the batch: find it
                half = len(indices) // 2
                return [
                    index
                    for part in (indices[:half], indices[half:])
                    for index in self._differences(derivatives, part, central, last)
                ]
            self.step[indices[0]] *= 0.03
            return list(indices)
        # Central differences, or forward ones from the present point.
        repeated = []
        logs = range(*self.layout.logs.indices(derivatives.vector.size))
        deviation = np.sqrt(derivatives.s)
        for place, index in enumerate(indices):
            up, down = self._shifts(derivatives.vector, index)
            if central:
                above, below = (
                    tuple(self._rows(v, 2 * place + k) for v in (innovations.e, innovations.s))
                    for k in (0, 1)
                )
            else:
                above, below, down = (
                    (self._rows(innovations.e, place), self._rows(innovations.s, place)),
                    (derivatives.e, derivatives.s),
                    0.0,
                )
            derivatives.dE[:, :, index] = (above[0] - below[0]) / (up - down)
            derivatives.dS[:, :, index] = (above[1] - below[1]) / (up - down)
            if index in logs:
                continue
            # A step is suitable if it changes the innovations neither by rounding nor
            # beyond linearity.
            change = self.step[index] * float(
                np.sqrt(
                    np.mean((derivatives.dE[:, :, index] / deviation) ** 2)
                    + np.mean((derivatives.dS[:, :, index] / derivatives.s) ** 2)
                )
            )
            if change <= 1e-11:
                limit = 1e2 * max(abs(derivatives.vector[index]), 1.0)
                if self.step[index] < limit and not last:
                    self.step[index] = min(1e3 * self.step[index], limit)
                    repeated.append(index)
                else:
                    derivatives.dE[:, :, index], derivatives.dS[:, :, index] = 0.0, 0.0
            elif not ACCEPTED_CHANGE[0] < change < ACCEPTED_CHANGE[1] and not last:
                self.step[index] *= TARGET / change
                repeated.append(index)
            else:
                self.step[index] *= float(np.clip(TARGET / change, 0.1, 10.0))
        return repeated

    def whitened(self, state: State) -> tuple[list[FloatArray], list[FloatArray]]:
        """Return sensitivities (n, m, K) and white innovations (n, m) of each segment.

        Sensitivities have the sign of a model output, minus the innovation's, and are zero where
        outputs are missing; innovations are NaN there.
        """
        n, m, segments = self.record.z.shape
        sensitivity = -state.sensitivity.reshape(segments, n, m, -1)
        white = state.white.reshape(segments, n, m)
        pieces, whites = [], []
        for index, length in enumerate(self.record.lengths):
            finite = np.isfinite(self.record.z[:length, :, index])
            pieces.append(np.where(finite[:, :, None], sensitivity[index, :length], 0.0))
            whites.append(np.where(finite, white[index, :length], np.nan))
        return pieces, whites


# From the optimum to a FilterErrorFit: covariances, identifiability, warnings.


def assemble(
    problem: FilterProblem,
    best: Minimum,
    labels: tuple[str, ...],
    low: FloatArray,
    high: FloatArray,
    record: Record,
    *,
    many: bool,
) -> FilterErrorFit:
    """Compute covariances, identifiability and warnings at the optimum."""
    layout = problem.layout
    # Information at the optimum by central differences, without the unknowns at their bounds.
    evaluation = problem.evaluate(best.theta)
    assert evaluation is not None
    linearisation = problem.settle(best.theta, evaluation[1])
    at_limit = outward(best.theta, linearisation.gradient, low, high)
    inside = np.flatnonzero(~at_limit)
    every_name = layout.names(labels)
    identifiability = assess(
        linearisation.information[np.ix_(inside, inside)], tuple(every_name[i] for i in inside)
    )
    # Covariances: that of white innovations, and that corrected for their colour.
    pieces, whites = problem.whitened(evaluation[1])
    # (MK) of `coloured_residuals` corrects the innovations' part of the information; the part of
    # the covariances stays.
    sensitivities = [piece[:, :, inside] for piece in pieces]
    white_information = np.zeros((inside.size, inside.size))
    for piece in sensitivities:
        flat = np.nan_to_num(piece).reshape(-1, inside.size)
        white_information += flat.T @ flat
    coloured = sandwich_covariance(
        sensitivities,
        whites,
        identifiability.inverse,
        linearisation.information[np.ix_(inside, inside)] - white_information,
    )
    total, k_free = best.theta.size, layout.columns.size
    cov, crb, vif = (
        np.full((total, total), np.nan),
        np.full((total, total), np.nan),
        np.full(total, np.inf),
    )
    at = np.ix_(inside, inside)
    cov[at] = masked_covariance(coloured, identifiability.identified)
    crb[at] = masked_covariance(identifiability.inverse, identifiability.identified)
    vif[inside] = identifiability.vif
    # Reasons why an unknown is not identified: collinear, at a bound, or no better than its bounds.
    reason = [""] * total
    for position, index in enumerate(inside.tolist()):
        reason[index] = identifiability.reason[position]
    for index in np.flatnonzero(at_limit).tolist():
        reason[index] = at_bound(best.theta[index], low[index], high[index])
    for index in range(k_free):
        reason[index] = reason[index] or idle_bound(
            float(np.sqrt(cov[index, index])), high[index] - low[index]
        )
    identified = np.array([not text for text in reason])
    cov, crb = masked_covariance(cov, identified), masked_covariance(crb, identified)

    # Expand from the free parameters to all of them.
    theta, q, r, x0 = layout.unpack(best.theta, problem.initial)
    k = theta.size
    full_cov, full_crb, full_vif = (
        np.full((k, k), np.nan),
        np.full((k, k), np.nan),
        np.full(k, np.inf),
    )
    block = np.ix_(layout.columns, layout.columns)
    full_cov[block], full_crb[block] = cov[:k_free, :k_free], crb[:k_free, :k_free]
    full_vif[layout.columns] = vif[:k_free]
    # Each parameter is fixed, identified, or not identified for a reason.
    status, reasons = (
        dict.fromkeys(labels, "fixed"),
        dict.fromkeys(labels, "held at theta0 (free=)"),
    )
    warnings = [note for note in identifiability.notes if any(name in note for name in labels)]
    for position, index in enumerate(layout.columns):
        status[labels[index]] = "not-identified" if reason[position] else "identified"
        reasons[labels[index]] = reason[position]
        if reason[position]:
            warnings.append(f"{labels[index]} not identified: {reason[position]}")
    if not best.converged:
        warnings.insert(0, f"not converged: {best.message}")
    residual_colour = colour(whites)
    ratio = np.sqrt(np.diagonal(cov)[:k_free]), np.sqrt(np.diagonal(crb)[:k_free])
    warnings += colour_warnings(residual_colour, *ratio, "filter error")
    innovation = [evaluation[1].base.raw[:length, :, s] for s, length in enumerate(record.lengths)]
    # Standard errors of the process noise follow those of the free parameters.
    q_std = np.full(q.size, np.nan)
    q_std[layout.noisy] = np.sqrt(np.diagonal(cov)[k_free : k_free + layout.noisy.size])
    return FilterErrorFit(
        names=labels,
        theta=theta,
        std=np.sqrt(np.diagonal(full_cov)),
        std_crb=np.sqrt(np.diagonal(full_crb)),
        cov=full_cov,
        cov_crb=full_crb,
        status=status,
        reason=reasons,
        vif=full_vif,
        noise_cov=np.diag(r**2),
        residual=innovation if many else innovation[0],
        whiteness=residual_colour.p_value,
        converged=best.converged,
        warnings=warnings,
        iterations=best.iterations,
        n_simulations=problem.runs,
        cost=best.cost,
        cost_history=np.array(best.cost_history),
        process_noise_cov=np.diag(q),
        process_noise_std=q_std,
        x0=[x0[:, s] for s in range(x0.shape[1])],
    )


LOG_NOISE_RANGE = 0.1
"""Range of ln r in the first descent, while theta is far off."""
FIRST_NOISE = (
    1e-3,
    1e-2,
    1e-1,
    1.0,
)
"""First guesses of process noise, in state scales per sqrt(s)."""


def filter_error(
    f: ModelFunction,
    g: ModelFunction,
    x0: Any,
    theta0: ArrayLike,
    u: Any,
    z: Any,
    t: Any,
    *,
    names: Sequence[str] | None = None,
    bounds: Any = None,
    free: Any = None,
    process_noise: Any = None,
    process_noise_start: ArrayLike | None = None,
    noise_start: ArrayLike | None = None,
    x0_std: ArrayLike | None = None,
    estimate_x0: bool = False,
    hold: str = "linear",
    u_middle: Any = None,
    jacobian_every: int = 4,
    max_iterations: int = 60,
    tolerance: float = 1e-2,
    callback: IterationCallback | None = None,
) -> FilterErrorFit:
    """Estimate theta (k,) of dx/dt = f(x, u, theta) + w, z = g(x, u, theta) + v in turbulence.

    Parameters
    ----------
    f, g : callable
        Vectors in, vectors out: x (nx,), u (nu,), theta (k,). Written with elementwise operations
        on x[i], u[i], theta[i] (no branching on values) they are evaluated for many parameter sets
        at once: faster.
    x0 : array_like
        (nx,) initial state, or a list, one per segment.
    theta0 : array_like
        (k,) start.
    u, z, t : array_like
        (n, nu), (n, m), (n,) [s], or lists of them, one per segment; NaN in z is a dropout. u may
        be None.
    names, bounds, free
        Of theta, as in `output_error`.
    process_noise : sequence, optional
        Indices or mask of the states that have noise; by default all.
    process_noise_start, noise_start : array_like, optional
        (nx,) and (m,) starting standard deviations [state unit per sqrt(s); output unit].
    x0_std : array_like, optional
        (nx,) uncertainty of x0; by default so large that x0 hardly matters, from the outputs'
        standard deviations.
    estimate_x0 : bool
        Estimate the initial states too (one set a segment); x0_std then defaults to a thousandth.
    hold : {"linear", "zoh"}
        Inputs between samples: interpolated (measured surfaces) or held (commands).
    u_middle : array_like, optional
        (n-1, nu), or a list: inputs half-way between samples, where they are available.
    jacobian_every : int
        Samples between renewals of the filter's Jacobians (4: a tenth of a second at 40 Hz).
    max_iterations, tolerance
        Stop when the next step is shorter than `tolerance` standard errors.
    callback : callable, optional
        Called in each iteration of a descent with its number and the length of the next step in
        standard errors.

    Returns
    -------
    FilterErrorFit
        As `output_error` gives, ``residual`` being the innovations, plus ``process_noise_cov``
        (nx, nx).

    Raises
    ------
    ValueError
        For inputs that disagree, times that do not increase, models that fail at x0, theta0.

    References
    ----------
    R. E. Maine, K. W. Iliff, NASA RP-1168, 1986, chapters 5 and 6.
    R. V. Jategaonkar, Flight Vehicle System Identification, 2015, chapter 5.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid
    >>> rng, t = np.random.default_rng(1), 0.05 * np.arange(400)
    >>> u, x = np.sign(np.sin(t))[:, None], np.zeros((400, 1))
    >>> for k in range(399):
    ...     x[k + 1] = x[k] + 0.05 * (-1.0 * x[k] + 2.0 * u[k]) + 0.02 * rng.standard_normal(1)
    >>> z = x + 0.05 * rng.standard_normal(x.shape)
    >>> fit = sysid.filter_error(
    ...     lambda x, u, p: [p[0] * x[0] + p[1] * u[0]], lambda x, u, p: [x[0]],
    ...     [0.0], [-0.5, 1.0], u, z, t,
    ... )
    >>> bool(np.all(np.abs(fit.theta - [-1.0, 2.0]) < 4.0 * fit.std))
    True
    """
    theta = as_parameters(theta0)
    labels = as_names(names, theta.size, "theta")
    lower, upper = as_bounds(bounds, theta, labels)
    columns = np.flatnonzero(as_free(free, labels))
    if not isinstance(jacobian_every, int) or jacobian_every < 1:
        raise ValueError(
            f"jacobian_every is {jacobian_every!r}; give a whole number of samples, 1 or more"
        )
    if hold not in ("linear", "zoh"):
        raise ValueError(f'hold is {hold!r}; allowed are "linear" and "zoh"')
    # Check and pad the data.
    record, initial = read_record(x0, u, z, t, hold == "zoh", u_middle)
    _n, m, segments = record.z.shape
    nx = initial.shape[0]
    # Every output needs samples, and their number must exceed that of the parameters.
    counts = np.isfinite(record.z).sum(axis=(0, 2))
    if (counts == 0).any():
        raise ValueError(
            f"z output(s) {np.flatnonzero(counts == 0).tolist()} hold no sample at all; leave"
            " them out"
        )
    if counts.sum() <= columns.size:
        raise ValueError(
            f"{int(counts.sum())} measured values for {columns.size} parameters; measure more or"
            " free fewer"
        )
    # Scales and first guesses.
    model = make_model(f, g, initial[:, 0], record.u[0, :, 0], theta, m)
    noisy = noisy_states(process_noise, nx)

    output_scale = output_scales(record)
    measurement = (
        positive_vector(noise_start, m, "noise_start")
        if noise_start is not None
        else measurement_noise(record)
    )
    scale = state_scale(model, record, theta, initial, output_scale)
    deviation = (
        positive_vector(x0_std, nx, "x0_std")
        if x0_std is not None
        else scale * (1e-3 if estimate_x0 else 1.0)
    )
    layout = Layout(theta, columns, noisy, m, nx, segments, estimate_x0)
    problem = FilterProblem(
        model=model,
        record=record,
        layout=layout,
        initial=initial,
        p0=np.diag(deviation**2),
        difference=1e-5 * np.maximum(scale, np.abs(initial).max(axis=1)),
        every=jacobian_every,
        state_scale=scale,
        callback=callback,
    )
    process = (
        positive_vector(process_noise_start, nx, "process_noise_start")
        if process_noise_start is not None
        else None
    )
    # The first process noise is the best of several sizes.
    candidate_noise = [(factor * scale) ** 2 for factor in FIRST_NOISE]
    q = (
        process**2
        if process is not None
        else problem.best_process_noise(theta, candidate_noise, measurement)
    )
    start_point = layout.pack(theta, q, measurement, initial)
    low, high = layout.limits(lower, upper, scale, output_scale)
    start_point = np.clip(start_point, low, high)
    if problem.evaluate(start_point) is None:
        raise ValueError(
            "the filter diverges at theta0; start from other values, or from a larger noise_start"
        )
    # Descend; if the result is doubtful, start again from one-step predictions and keep the better.
    best = _minimise_from(problem, start_point, low, high, tolerance, max_iterations)
    fit = assemble(problem, best, labels, low, high, record, many=is_segment_list(z))
    if best.converged and not any(text.startswith("coloured") for text in fit.warnings):
        return fit
    other = _minimise_from_high_gain(
        problem,
        start_point,
        low,
        high,
        candidate_noise[-1],
        tolerance,
        max_iterations=max_iterations,
    )
    return (
        fit
        if other is None or not other.cost < best.cost
        else assemble(problem, other, labels, low, high, record, many=is_segment_list(z))
    )


def _minimise_from(
    problem: FilterProblem,
    point: FloatArray,
    low: FloatArray,
    high: FloatArray,
    tolerance: float,
    max_iterations: int,
) -> Minimum:
    """Minimise from a packed point at which the filter works.

    Far from the optimum the likelihood gains most by attributing model errors to measurement noise,
    and the search would stall. R is first held near the data's third differences: the filter then
    follows the data, and theta approaches its optimum first.
    """
    logs = problem.layout.logs
    # First descent with narrow bounds on ln r, then the full one.
    narrow_low, narrow_high = low.copy(), high.copy()
    narrow_low[logs] = np.maximum(low[logs], point[logs] - LOG_NOISE_RANGE)
    narrow_high[logs] = np.minimum(high[logs], point[logs] + LOG_NOISE_RANGE)
    first = _descend(problem, point, narrow_low, narrow_high, 0.3, max_iterations)
    best = _descend(problem, first.theta, low, high, tolerance, max_iterations)
    return replace(
        best,
        iterations=first.iterations + best.iterations,
        cost_history=first.cost_history + best.cost_history[1:],
    )


def _minimise_from_high_gain(
    problem: FilterProblem,
    point: FloatArray,
    low: FloatArray,
    high: FloatArray,
    q: FloatArray,
    tolerance: float,
    *,
    max_iterations: int,
) -> Minimum | None:
    """Minimise from the theta of one-step predictions; None where the filter fails.

    With much process noise ``q`` (nx,) every step starts from the data. One-step predictions are
    nearly linear in theta, however far off it is, where the likelihood itself may have other
    valleys.
    """
    layout = problem.layout
    # Fix the process noise at q and the measurement noise at its first guess.
    noisy = point.copy()
    noisy[layout.process] = np.clip(q[layout.noisy], low[layout.process], high[layout.process])
    fixed_low, fixed_high = low.copy(), high.copy()
    for part in (layout.process, layout.logs):
        fixed_low[part] = fixed_high[part] = noisy[part]
    if problem.evaluate(noisy) is None:
        return None
    one_step_optimum = _descend(problem, noisy, fixed_low, fixed_high, 0.3, max_iterations).theta
    return _minimise_from(problem, one_step_optimum, low, high, tolerance, max_iterations)


def _descend(
    problem: FilterProblem,
    point: FloatArray,
    low: FloatArray,
    high: FloatArray,
    tolerance: float,
    max_iterations: int,
) -> Minimum:
    """Minimise within bounds from a packed point."""
    start = problem.evaluate(point)
    assert start is not None
    return minimise(
        problem,
        point,
        start,
        low,
        high,
        tolerance=tolerance,
        max_iterations=max_iterations,
        always_central=False,
        callback=problem.callback,
    )
