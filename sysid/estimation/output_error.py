"""Output error: maximum likelihood for measurement noise alone.

    J(theta) = 1/2 sum_i [z(i) - y(i)]' R^-1 [z(i) - y(i)] + N/2 ln det R

R takes its maximum-likelihood value at every theta (relaxation), so that the cost is the
concentrated likelihood and falls at every accepted step. `output_error` is the estimator for calm
air. The module also holds the finite differences of simulations that may fail, adapted to their
roughness. Klein and Morelli, "Aircraft System Identification" (2006), ch. 6; Jategaonkar, R. V.,
"Flight Vehicle System Identification", 2nd ed. (2015), ch. 4.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.arrays import (
    FloatArray,
    as_bounds,
    as_free,
    as_names,
    as_parameters,
    as_segments,
    is_segment_list,
)
from sysid.estimation.gauss_newton import IterationCallback, Linearisation, Minimum, minimise
from sysid.estimation.goodness_of_fit import white_noise
from sysid.estimation.noise import Noise, concentrated_cost, residual_noise
from sysid.estimation.results import Findings, OutputErrorFit, assess_fit, split, unassessed_fit
from sysid.linalg import Blocks, Index

# Output sensitivities by finite differences of a simulation that may fail.
#
# A step is sized by its effect on the outputs, not by the parameter's magnitude: a small part of
# an output's standard deviation. So parameters of any unit, and starts at zero, need no hint.

# Parameters that move different segments are perturbed in the same simulation.
#
# Curtis, A. R., Powell, M. J. D. and Reid, J. K., "On the Estimation of Sparse Jacobian
# Matrices", IMA Journal of Applied Mathematics 13 (1974): columns of a Jacobian without a common
# row are differenced together. A segment's start state moves that segment alone, so that as many
# runs as it has states serve all segments.

Answer = list[FloatArray] | str
"""Outputs (n, m) of each of a parameter's rows, or a sentence that says what failed."""
Run = Callable[[Sequence[FloatArray]], Iterator[FloatArray | str]]
"""Maps some theta to their outputs (N, m), in order."""


@dataclass(frozen=True)
class Shift:
    """A step ``by`` of parameter ``index``, for column ``position``.

    ``rows`` are all output rows that the parameter can move.
    """

    position: int
    index: int
    by: float
    rows: tuple[slice, ...]


def rows_affected(simulate: Any, index: int, edges: Sequence[int]) -> tuple[slice, ...]:
    """Return the rows of the segments that a parameter moves, with segments between ``edges``.

    A simulation may have a method ``moved(index)`` that returns segment numbers, or None for all.
    Without it all rows count as moved.
    """
    moved_segments = getattr(simulate, "moved", None)
    numbers = None if moved_segments is None else moved_segments(index)
    if numbers is None:
        return (slice(edges[0], edges[-1]),)
    every = [slice(a, b) for a, b in pairwise(edges)]
    return tuple(every[number] for number in numbers)


def group_shifts(shifts: Sequence[Shift]) -> list[list[Shift]]:
    """Group shifts without a common row, each in the first group that has room."""
    groups: list[list[Shift]] = []
    occupied: list[list[tuple[int, int]]] = []
    for shift in shifts:
        intervals = [(rows.start, rows.stop) for rows in shift.rows]
        for members, rows in zip(groups, occupied, strict=True):
            if not any(a < d and c < b for a, b in intervals for c, d in rows):
                members.append(shift)
                rows += intervals
                break
        else:
            groups.append([shift])
            occupied.append(intervals)
    return groups


def simulate_shifts(
    run: Run, theta: FloatArray, shifts: Sequence[Shift]
) -> Iterator[tuple[Shift, float, Answer]]:
    """Yield each shift with its step in floating point and its outputs.

    The shifts of a group that fails are run again one by one.
    """
    retries: list[Shift] = []
    groups = group_shifts(shifts)
    for members, outputs in zip(
        groups, run([_shifted_theta(theta, members) for members in groups]), strict=True
    ):
        if isinstance(outputs, str) and len(members) > 1:
            retries += members
        else:
            yield from _split_outputs(theta, members, outputs)
    for shift, outputs in zip(
        retries,
        run([_shifted_theta(theta, [shift]) for shift in retries]) if retries else (),
        strict=True,
    ):
        yield from _split_outputs(theta, [shift], outputs)


def _shifted_theta(theta: FloatArray, members: Sequence[Shift]) -> FloatArray:
    """Add the steps of a group's shifts to theta."""
    out = theta.copy()
    for shift in members:
        out[shift.index] += shift.by
    return out


def _split_outputs(
    theta: FloatArray, members: Sequence[Shift], outputs: FloatArray | str
) -> Iterator[tuple[Shift, float, Answer]]:
    """Yield each shift of a group with its part of the outputs."""
    for shift in members:
        # The step in floating point: (theta + h) - theta.
        by = float((theta[shift.index] + shift.by) - theta[shift.index])
        if isinstance(outputs, str):
            yield shift, by, outputs
        else:
            # Copy if several shifts share the run: a view would keep all rows in memory.
            yield (
                shift,
                by,
                [
                    outputs[rows] if len(members) == 1 else outputs[rows].copy()
                    for rows in shift.rows
                ],
            )


TARGET = 3e-4
"""First target change of the most affected output, in its scale; `target_for` adapts it."""
TARGETS = (
    3e-5,
    3e-2,
)
"""Range of target changes: truncation ~ target^2, rounding ~ roughness / target."""
ACCEPTED_RATIO = (
    3e-3,
    30.0,
)
"""Changes outside this range of the target are repeated with another step."""
NO_EFFECT = 1e-11
"""A smaller change at the largest step is rounding, not an effect."""
SMALLEST = 1e-12
"""Shortest step, relative to the parameter."""
HUGE = 1e100
"""Outputs beyond this are a diverged simulation; their squares must not overflow."""

MapLike = Callable[[Callable[[FloatArray], Any], Iterable[FloatArray]], Iterable[Any]]


@dataclass(frozen=True)
class SafeSimulation:
    """A simulation that returns the stacked outputs (N, m), or a sentence that says what went
    wrong.

    A class at module level, so that process pools can pickle it whenever ``simulate`` can be
    pickled.
    """

    simulate: Callable[[FloatArray], Any]
    lengths: tuple[int, ...]
    outputs: int

    def __call__(self, theta: FloatArray) -> FloatArray | str:
        """Simulate at ``theta`` (p,)."""
        with np.errstate(all="ignore"):
            try:
                value = self.simulate(theta.copy())
            # Any exception of the model at a trial point rejects the step.
            except Exception as error:
                return f"simulate raised {type(error).__name__}: {error}"
        return self.stacked(value)

    def stacked(self, value: Any) -> FloatArray | str:
        """Stack outputs of any permitted form into (N, m).

        Returns a sentence if the form is wrong or values are not finite.
        """
        try:
            parts = [
                np.asarray(part, dtype=float)
                for part in (value if is_segment_list(value) else [value])
            ]
        except (TypeError, ValueError) as error:
            return f"simulate returned something not numeric: {error}"
        parts = [part[:, None] if part.ndim == 1 else part for part in parts]
        shapes, expected_shapes = (
            [part.shape for part in parts],
            [(length, self.outputs) for length in self.lengths],
        )
        if shapes != expected_shapes:
            return (
                f"simulate returned shapes {shapes}, measured has {expected_shapes}; return the"
                " outputs at the measured samples"
            )
        out = np.concatenate(parts)
        is_valid = np.abs(out) < HUGE  # False for NaN too
        if not is_valid.all():
            row = int(np.argwhere(~is_valid)[0][0])
            return (
                f"simulate returned values that are not finite, or beyond {HUGE:g}, from stacked"
                f" sample {row} on"
            )
        return out


def run_all(
    simulation: SafeSimulation, thetas: Sequence[FloatArray], map_fn: MapLike | None
) -> Iterator[FloatArray | str]:
    """Simulate all points in order, through ``map_fn`` if there is one; lazily if it is lazy."""
    yield from (map_fn or map)(simulation, thetas)


@dataclass(frozen=True)
class Differences:
    """Result of `sensitivities`.

    Attributes
    ----------
    sensitivity : Blocks
        (N, m, len(columns)) in blocks.
    step : array (k,)
        Adapted difference steps.
    effect : array (len(columns),) of bool
        Whether the parameter moves any output.
    runs : int
        Simulations used.
    """

    sensitivity: Blocks
    step: FloatArray
    effect: NDArray[np.bool_]
    runs: int


def first_steps(theta: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return starting steps (k,): a small part of the value, of the bounds' width, or of one."""
    width = np.where(np.isfinite(upper - lower), upper - lower, 1.0)
    return np.asarray(1e-4 * np.where(theta != 0.0, np.abs(theta), width))


def sensitivities(
    simulation: SafeSimulation,
    theta: FloatArray,
    base: FloatArray,
    step: FloatArray,
    columns: Sequence[int],
    limits: tuple[FloatArray, FloatArray],
    output_scale: FloatArray,
    *,
    central: bool,
    map_fn: MapLike | None,
    target: float = TARGET,
) -> Differences:
    """Difference the outputs with the free parameters.

    Differences are one-sided at a bound or where one side fails. Parameters that move different
    segments are perturbed together. A parameter whose perturbed runs all fail gets effect False.

    Parameters
    ----------
    simulation : SafeSimulation
        The model.
    theta : array (k,)
        Point.
    base : array (N, m)
        Outputs there.
    step : array (k,)
        Difference steps to begin with.
    columns : sequence of int
        Free parameters.
    limits : tuple of two arrays (k,)
        Bounds.
    output_scale : array (m,)
        Size of each output.
    central : bool
        Central or forward differences.
    map_fn : callable, optional
        Parallel map.
    target : float
        Change of the most affected output to aim at, in its scale.
    """
    step = step.copy()
    lower, upper = limits
    edges = [0, *np.cumsum(simulation.lengths).tolist()]
    out: list[list[FloatArray | None]] = [[None] * (len(edges) - 1) for _ in columns]
    effect = np.zeros(len(columns), dtype=bool)
    pending, runs = list(range(len(columns))), 0
    rows = [rows_affected(simulation.simulate, j, edges) for j in columns]

    def run(points: Sequence[FloatArray]) -> Iterator[FloatArray | str]:
        nonlocal runs
        runs += len(points)
        return run_all(simulation, points, map_fn)

    for attempt in range(6):
        # A shorter step would vanish in the parameter's rounding.
        step = np.maximum(step, SMALLEST * np.abs(theta))
        shifts = [
            s
            for k in pending
            for s in _shifts(k, columns[k], theta, step, limits, central, rows=rows[k])
        ]
        repeated_positions = []
        for position, sides in _by_position(simulate_shifts(run, theta, shifts), shifts):
            j = columns[position]
            valid_sides = [
                (by, answer) for by, answer in sides if not isinstance(answer, str) and by != 0.0
            ]
            # Every side failed: try a much shorter step.
            if not valid_sides:
                step[j] *= 0.03
                repeated_positions.append(position)
                continue
            column = _column(valid_sides, base, rows[position])
            used = max(abs(by) for by, _ in valid_sides)
            with np.errstate(over="ignore", invalid="ignore"):
                square = sum(np.sum(part**2, axis=0) for part in column) / len(base)
                change = float(np.max(np.sqrt(square) * used / output_scale))
            # The square overflowed: the step is far too long.
            if not np.isfinite(change):
                step[j] *= 1e-4
                repeated_positions.append(position)
                continue
            effect[position] = change > NO_EFFECT
            out[position] = (
                _by_segment(column, rows[position], edges)
                if effect[position]
                else [None] * (len(edges) - 1)
            )
            step[j], repeated = _next_step(
                step[j], change, target, max(abs(theta[j]), 1.0), upper[j] - lower[j], attempt == 5
            )
            if repeated:
                repeated_positions.append(position)
        pending = sorted(repeated_positions)
        if not pending:
            break
    return Differences(Blocks.from_columns(out, base.shape[1], edges), step, effect, runs)


def forward_differences(
    simulate: Callable[[FloatArray], Any],
    theta: FloatArray,
    steps: FloatArray,
    shape: tuple[Sequence[int], int],
    map_fn: MapLike | None = None,
) -> Blocks | None:
    """Difference the outputs with one step of each parameter.

    Parameters
    ----------
    simulate : callable
        theta (k,) to outputs, as in `output_error`.
    theta, steps : array (k,)
        Point and steps.
    shape : tuple
        Rows of each segment, and the number of outputs m.
    map_fn : callable, optional
        Parallel map.

    Returns
    -------
    Blocks or None
        d(outputs)/d(theta) (N, m, k); None where a simulation fails.
    """
    lengths, outputs = tuple(shape[0]), shape[1]
    simulation = SafeSimulation(simulate, lengths, outputs)
    base = simulation(theta)
    if isinstance(base, str):
        return None
    edges = [0, *np.cumsum(lengths).tolist()]
    out: list[list[FloatArray | None]] = [[None] * len(lengths) for _ in theta]
    shifts = [
        Shift(k, k, float(step), rows_affected(simulate, k, edges)) for k, step in enumerate(steps)
    ]
    for shift, _, answer in simulate_shifts(
        lambda points: run_all(simulation, points, map_fn), theta, shifts
    ):
        if isinstance(answer, str):
            return None
        out[shift.position] = _by_segment(
            _column([(shift.by, answer)], base, shift.rows), shift.rows, edges
        )
    return Blocks.from_columns(out, outputs, edges)


def _shifts(
    position: int,
    j: int,
    theta: FloatArray,
    step: FloatArray,
    limits: tuple[FloatArray, FloatArray],
    central: bool,
    *,
    rows: tuple[slice, ...],
) -> Iterator[Shift]:
    """Yield a step up, and a step down if ``central`` or if there is no room above."""
    lower, upper = limits
    up, down = min(step[j], upper[j] - theta[j]), min(step[j], theta[j] - lower[j])
    floor = 0.5 * step[j]
    forward = up >= floor or up >= down
    if forward:
        yield Shift(position, j, up, rows)
    if (central and down >= floor) or not forward:
        yield Shift(position, j, -down, rows)


def _by_position(
    results: Iterable[tuple[Shift, float, Answer]], shifts: Sequence[Shift]
) -> Iterator[tuple[int, list[tuple[float, Answer]]]]:
    """Yield columns once all their sides are complete, upper side first."""
    side_counts = Counter(shift.position for shift in shifts)
    sides: dict[int, list[tuple[float, Answer]]] = {}
    for shift, by, answer in results:
        column_sides = sides.setdefault(shift.position, [])
        column_sides.append((by, answer))
        if len(column_sides) == side_counts[shift.position]:
            yield shift.position, sorted(sides.pop(shift.position), key=lambda side: -side[0])


def _column(
    sides: Sequence[tuple[float, Any]], base: FloatArray, rows: tuple[slice, ...]
) -> list[FloatArray]:
    """Return the difference quotients (n, m) over one step or two, for each of the rows."""
    (by, first), *other_sides = sides
    if other_sides:
        other_by, other = other_sides[0]
        return [(a - b) / (by - other_by) for a, b in zip(first, other, strict=True)]
    return [(part - base[row_slice]) / by for part, row_slice in zip(first, rows, strict=True)]


def _by_segment(
    column: Sequence[FloatArray], rows: tuple[slice, ...], edges: Sequence[int]
) -> list[FloatArray | None]:
    """Split a column by segments; None where it is zero."""
    segment_parts = {
        row_slice.start + a: part[a:b]
        for part, row_slice in zip(column, rows, strict=True)
        for a, b in _segments_within(row_slice, edges)
    }
    return [
        part.copy() if (part := segment_parts.get(a)) is not None and part.any() else None
        for a in edges[:-1]
    ]


def _segments_within(rows: slice, edges: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Yield first and last row of the segments within ``rows``, counted from the first of them."""
    return (
        (a - rows.start, b - rows.start)
        for a, b in pairwise(edges)
        if rows.start <= a and b <= rows.stop
    )


def _next_step(
    step: float, change: float, target: float, unit: float, width: float, last: bool
) -> tuple[float, bool]:
    """Return the step for the next difference, and whether this difference is repeated with it."""
    if change <= NO_EFFECT:
        if step < 99.0 * unit and not last:
            return (unit if step < 0.5 * unit else 100.0 * unit), True
        return 1e-4 * unit, False
    if not ACCEPTED_RATIO[0] <= change / target <= ACCEPTED_RATIO[1] and not last:
        new_step = step * target / change
        new_step = min(new_step, 0.01 * width) if np.isfinite(width) else new_step
        return (step, False) if 0.5 < new_step / step < 2.0 else (new_step, True)
    return step * float(np.clip(target / change, 0.1, 10.0)), False


def roughness(
    simulation: SafeSimulation,
    theta: FloatArray,
    base: FloatArray,
    steps: FloatArray,
    limits: tuple[FloatArray, FloatArray],
    output_scale: FloatArray,
    *,
    map_fn: MapLike | None,
) -> tuple[float, int]:
    """Estimate the rms roughness of the outputs in theta, in their scale, and the simulations used.

    Six points along ``steps`` (k,) away from theta: high differences vanish for smooth functions
    and show rounding, iterated trims and printed decimals. More, J. J. and Wild, S. M., SIAM J.
    Sci. Comput. 33 (2011), eq. (2.4).
    """
    lower, upper = limits
    # Step away from the bounds.
    inward = np.where(theta + 7.0 * steps > upper, -steps, steps)
    points = [theta + count * inward for count in range(1, 7)]
    points = [np.clip(point, lower, upper) for point in points]
    answers = list(run_all(simulation, points, map_fn))
    if any(isinstance(answer, str) for answer in answers):
        return 0.0, len(points)
    table = np.stack([base, *(answer for answer in answers if not isinstance(answer, str))])
    noise_levels = []
    # Fourth and fifth differences remove smooth functions (eq. 2.4).
    for order in range(1, 6):
        table = np.diff(table, axis=0)
        if order >= 4:
            factor = math.factorial(order) ** 2 / math.factorial(2 * order)
            noise_levels.append(np.sqrt(factor * np.mean(table**2, axis=(0, 1))) / output_scale)
    return float(np.min(noise_levels, axis=0).max()), len(points)


def target_for(rms_roughness: float) -> float:
    """Return the output change that balances truncation and rounding of central differences.

    It is about roughness^(1/3), within TARGETS.
    """
    return float(np.clip(np.cbrt(rms_roughness), *TARGETS))


# Output error's cost over the free parameters, with sensitivities by differences or secants.

MAX_SECANT_UPDATES = 8
"""Secant updates before sensitivities are differenced again."""
NEARBY = 0.5
"""Distance in standard errors within which sensitivities need no renewal."""


@dataclass
class OutputErrorProblem:
    """The cost over the free parameters; counts simulations and keeps difference steps."""

    simulation: SafeSimulation
    measured: FloatArray
    full_theta: FloatArray
    columns: list[int]
    limits: tuple[FloatArray, FloatArray]
    output_scale: FloatArray
    full: bool
    map_fn: MapLike | None
    step: FloatArray
    secant: bool = False
    runs: int = 0
    last_failure: str = ""
    sensitivity: Blocks = field(default_factory=lambda: Blocks((), (), 0))
    _last: tuple[FloatArray, FloatArray] | None = None
    _fresh: tuple[FloatArray, Blocks, FloatArray] | None = None
    _metric: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    _updates: int = 0
    _target: float | None = None
    _differenced_before: bool = False

    @property
    def edges(self) -> list[int]:
        """First row of each segment, and the number of rows at the end."""
        return [0, *np.cumsum(self.simulation.lengths).tolist()]

    @property
    def floor(self) -> FloatArray:
        """Smallest noise (m,) of an output: rounding of its scale."""
        return 1e-9 * self.output_scale

    def full_vector(self, theta: FloatArray) -> FloatArray:
        """Return all parameters, the free ones at ``theta`` and the fixed ones at their start."""
        out = self.full_theta.copy()
        out[self.columns] = theta
        return out

    def noise(self, outputs: FloatArray) -> Noise:
        """Estimate the measurement noise for outputs (N, m) by maximum likelihood."""
        return residual_noise(self.measured - outputs, self.floor, self.full)

    def evaluate(self, theta: FloatArray) -> tuple[float, FloatArray] | None:
        """Return the concentrated cost and the outputs (N, m); None where the simulation failed."""
        self.runs += 1
        outputs = self.simulation(self.full_vector(theta))
        if isinstance(outputs, str):
            self.last_failure = outputs
            return None
        return concentrated_cost(self.measured - outputs, self.noise(outputs)), outputs

    def linearise(self, theta: FloatArray, outputs: FloatArray, central: bool) -> Linearisation:
        """Compute gradient and information at theta (k,) with known outputs.

        With ``secant`` the sensitivities of the last point are updated by Broyden's formula (Math.
        Comp. 19, 1965)

            S += (dy - S d) (W d)' / (d' W d),    W = diag M

        (segment by segment, where S is not zero: Schubert, Math. Comp. 24, 1970), which needs no
        simulation. They are differenced again, forwards, after MAX_SECANT_UPDATES updates, near the
        end of the search, and at a point that is linearised twice.
        """
        secant_is_exact = self._secant_update(theta, outputs, central) if self.secant else None
        if secant_is_exact is None:
            self._difference(theta, outputs, central and not self.secant)
        linearisation = self._linearisation(outputs)
        self._metric, self._last = linearisation.information, (theta.copy(), outputs)
        if secant_is_exact is None:
            self._fresh = (theta.copy(), self.sensitivity, linearisation.information)
            return replace(linearisation, exact=central or self.secant)
        return replace(linearisation, exact=secant_is_exact, fresh=False)

    def settle(self, theta: FloatArray, outputs: FloatArray) -> Linearisation:
        """Compute the linearisation for standard errors.

        Sensitivities are differenced at theta, or within NEARBY standard errors of it in secant
        mode.
        """
        if self.secant and self._fresh is not None and self._distance(theta) < NEARBY:
            self.sensitivity = self._fresh[1]
        else:
            self._difference(theta, outputs, not self.secant)
        return self._linearisation(outputs)

    def _distance(self, theta: FloatArray) -> float:
        """Return the distance from the last differenced point, in standard errors."""
        assert self._fresh is not None
        displacement = theta - self._fresh[0]
        return float(np.sqrt(np.maximum(displacement @ self._fresh[2] @ displacement, 0.0)))

    def _secant_update(self, theta: FloatArray, outputs: FloatArray, central: bool) -> bool | None:
        """Update the sensitivities to theta.

        Returns True near the point where they were differenced, False far from it, None if an
        update is not possible.
        """
        if self._last is None or self._updates >= MAX_SECANT_UPDATES:
            return None
        # Broyden's update, segment by segment.
        step = theta - self._last[0]
        metric_step = np.diagonal(self._metric) * step
        is_near = self._distance(theta) < NEARBY
        if not float(step @ metric_step) > 0.0 or (central and not is_near):
            return None
        change = outputs - self._last[1] - self.sensitivity.matvec(step)

        def updated(part: FloatArray, columns: Index, rows: slice) -> FloatArray:
            size = float(step[columns] @ metric_step[columns])
            return (
                part + change[rows, :, None] * (metric_step[columns] / size) if size > 0.0 else part
            )

        self.sensitivity = self.sensitivity.map_parts(updated)
        self._updates += 1
        return is_near

    def _difference(self, theta: FloatArray, outputs: FloatArray, central: bool) -> None:
        """Difference the outputs; from the second time on with steps that suit the roughness.

        A fit that starts at its optimum differences once and does not need the roughness.
        """
        # Roughness of the simulated outputs limits how small a step may be.
        if self._differenced_before and self._target is None:
            small_steps = np.zeros_like(self.step)
            small_steps[self.columns] = 1e-3 * self.step[self.columns]
            rms_roughness, runs = roughness(
                self.simulation,
                self.full_vector(theta),
                outputs,
                small_steps,
                self.limits,
                self.output_scale,
                map_fn=self.map_fn,
            )
            self._target, self.runs = target_for(rms_roughness), self.runs + runs
        # Keep the chosen steps for the next iteration.
        differences = sensitivities(
            self.simulation,
            self.full_vector(theta),
            outputs,
            self.step,
            self.columns,
            self.limits,
            self.output_scale,
            central=central,
            map_fn=self.map_fn,
            target=self._target or TARGET,
        )
        self.step, self.runs, self._differenced_before = (
            differences.step,
            self.runs + differences.runs,
            True,
        )
        self.sensitivity, self._updates = differences.sensitivity, 0

    def _linearisation(self, outputs: FloatArray) -> Linearisation:
        """Build gradient and information from the sensitivities."""
        sensitivity, residual, noise = (
            self.sensitivity,
            self.measured - outputs,
            self.noise(outputs),
        )
        k = len(self.columns)
        gradient, information = np.zeros(k), np.zeros((k, k))
        for (a, b), (part, columns) in zip(pairwise(self.edges), sensitivity, strict=True):
            # Sum the segments' contributions.
            white, scaled = noise.whiten(residual[a:b], part)
            assert scaled is not None
            flat = scaled.reshape(-1, columns.size)
            gradient[columns] += flat.T @ white.ravel()
            information[np.ix_(columns, columns)] += flat.T @ flat

        def predict(delta: FloatArray) -> float:
            expected = residual - sensitivity.matvec(delta)
            return concentrated_cost(expected, residual_noise(expected, self.floor, self.full))

        # M = sum S' R^-1 S,  g = sum S' R^-1 v: one Gauss-Newton step is M^-1 g
        return Linearisation(gradient, information, predict)


UNEXPLAINED_SHARE = 0.3
"""Residual share of an output's variance above which nothing is explained."""
LARGE_RESIDUAL, RELEVANT_SHARE = (
    5.0,
    0.01,
)
"""Multiple of the noise, and share of the variance, of a residual that justifies another start."""
HORIZONS = (0.1, 0.2, 0.4)
"""Shares of each segment that are fitted first when the full fit fails."""


def output_error(
    simulate: Callable[[FloatArray], Any],
    theta0: ArrayLike,
    measured: Any,
    *,
    names: Sequence[str] | None = None,
    bounds: Any = None,
    free: Any = None,
    noise: str = "diagonal",
    map: MapLike | None = None,
    differences: str = "auto",
    max_iterations: int = 100,
    tolerance: float = 1e-5,
    errors: bool = True,
    callback: IterationCallback | None = None,
) -> OutputErrorFit:
    """Estimate theta (k,) such that simulate(theta) comes closest to what was measured.

    Parameters
    ----------
    simulate : callable
        theta (k,) -> (n, m) array, or a list of them, one per segment, at the measured samples, in
        the units of `measured`. It may raise or return NaN at a trial point: a shorter step is
        tried. An optional method ``moved(j)`` returns the numbers of the segments that theta[j]
        moves (None: all); parameters that move different segments are perturbed in one simulation.
    theta0 : array_like
        (k,) start; zeros are fine, but simulate(theta0) must be finite.
    measured : array_like
        (n, m) or (n,) array, or a list of them; NaN is not measured (dropout).
    names : sequence of str, optional
        k unique names; by default theta0, theta1, ...
    bounds : optional
        k pairs (lower, upper), None = open; or two vectors; or {name: (lower, upper)}.
    free : optional
        Names, indices or a mask of the parameters to estimate; the others stay at theta0.
    noise : {"diagonal", "full"}
        Independent outputs, or not.
    map : callable, optional
        Like the built-in map(function, points), e.g. a process pool's: runs the perturbed
        simulations.
    differences : {"auto", "central", "secant"}
        "auto" takes forward differences between the first iteration and the last ones; "secant",
        for smooth and expensive simulations, updates sensitivities from iteration to iteration.
    max_iterations, tolerance
        Stop when the next step is shorter than `tolerance` standard errors.
    errors : bool
        False for the estimates alone: standard errors, covariances and variance inflation are then
        NaN, and identifiability is not assessed.
    callback : callable, optional
        Called in each iteration of a descent with its number and the length of the next step in
        standard errors.

    Returns
    -------
    OutputErrorFit
        ``theta`` (k,), ``std`` (k,) corrected for coloured residuals (see `coloured_residuals`),
        ``std_crb`` (k,) the Cramer-Rao bound. Parameters that the data do not determine, or that
        end on a bound, are "not-identified": their std is NaN and fit.reason says why; the others
        are still estimated. ``converged`` and ``warnings`` say whether it converged.

    Raises
    ------
    ValueError
        When inputs disagree, theta0 lies outside the bounds, there are fewer measured values than
        parameters, or the simulation fails at theta0.

    References
    ----------
    L. E. Hale, dissertation, Virginia Tech, 2016, eq. 2.4 to 2.9. V. Klein, E. A. Morelli, Aircraft
    System Identification, 2006.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid
    >>> t = np.linspace(0.0, 5.0, 100)
    >>> measured = 2.0 * np.exp(-0.5 * t) + 0.01 * np.sin(40.0 * t)
    >>> fit = sysid.output_error(
    ...     lambda theta: theta[0] * np.exp(-theta[1] * t), [1.0, 1.0], measured
    ... )
    >>> [round(float(value), 1) for value in fit.theta]
    [2.0, 0.5]
    """
    theta = as_parameters(theta0)
    labels = as_names(names, theta.size, "theta")
    lower, upper = as_bounds(bounds, theta, labels)
    mask = as_free(free, labels)
    # Check the data: every output needs samples, more in all than parameters.
    segments = as_segments(measured, "measured", dropouts=True)
    if noise not in ("diagonal", "full"):
        raise ValueError(f'noise is {noise!r}; allowed are "diagonal" and "full"')
    if differences not in ("auto", "central", "secant"):
        raise ValueError(
            f'differences is {differences!r}; allowed are "auto", "central" and "secant"'
        )
    stacked = np.concatenate(segments)
    counts = np.isfinite(stacked).sum(axis=0)
    if (counts == 0).any():
        raise ValueError(
            f"measured output(s) {np.flatnonzero(counts == 0).tolist()} hold no sample at all;"
            " leave them out"
        )
    columns = [int(index) for index in np.flatnonzero(mask)]
    if counts.sum() <= len(columns):
        raise ValueError(
            f"{int(counts.sum())} measured values for {len(columns)} parameters; measure more or"
            " free fewer"
        )
    with np.errstate(invalid="ignore"):
        # Scale of each output: standard deviation, or its size where it is constant.
        output_scale = np.nanstd(stacked, axis=0)
    size = np.nanmax(np.abs(stacked), axis=0)
    output_scale = np.where(
        output_scale > 1e-12 * size, output_scale, np.where(size > 0.0, size, 1.0)
    )

    simulation = SafeSimulation(
        simulate, tuple(part.shape[0] for part in segments), stacked.shape[1]
    )
    problem = OutputErrorProblem(
        simulation,
        stacked,
        theta,
        columns,
        (lower, upper),
        output_scale,
        noise == "full",
        map,
        first_steps(theta, lower, upper),
        differences == "secant",
    )
    start = problem.evaluate(theta[columns])
    if start is None:
        raise ValueError(
            f"the simulation fails at theta0: {problem.last_failure}; start from values that can be"
            " simulated"
        )
    edges = [0, *np.cumsum([part.shape[0] for part in segments]).tolist()]
    limits = (lower[columns], upper[columns])

    def descend(
        point: FloatArray, state: tuple[float, FloatArray], iterations: int, length: float
    ) -> Minimum:
        return minimise(
            problem,
            point,
            state,
            *limits,
            tolerance=length,
            max_iterations=iterations,
            always_central=differences == "central",
            callback=callback,
        )

    # Descend from theta0; if another minimum may be better, try one by way of short segments.
    best = descend(theta[columns], start, max_iterations, tolerance)
    if _may_be_local_minimum(problem, best, edges):
        other = _from_short_horizons(
            problem, theta[columns], edges, descend, max_iterations, tolerance
        )
        best = other if other is not None and other.cost < best.cost else best

    evaluation = problem.evaluate(best.theta)
    assert evaluation is not None
    residual = stacked - evaluation[1]
    # Estimates alone.
    if not errors:
        unassessed = unassessed_fit(problem.noise(evaluation[1]), len(columns))
        return _assemble(
            theta,
            columns,
            labels,
            best,
            problem,
            findings=unassessed,
            residual=split(residual, edges),
            many=is_segment_list(measured),
        )
    # Standard errors from the sensitivities at the optimum.
    linearisation = problem.settle(best.theta, evaluation[1])
    findings = assess_fit(
        theta=best.theta,
        gradient=linearisation.gradient,
        sensitivity=problem.sensitivity,
        residual=residual,
        motion=evaluation[1],
        edges=edges,
        names=tuple(labels[index] for index in columns),
        bounds=(lower[columns], upper[columns]),
        floor=problem.floor,
        full=problem.full,
        method="output error",
    )
    return _assemble(
        theta,
        columns,
        labels,
        best,
        problem,
        findings=findings,
        residual=split(residual, edges),
        many=is_segment_list(measured),
    )


def _may_be_local_minimum(problem: OutputErrorProblem, best: Minimum, edges: list[int]) -> bool:
    """Decide whether another descent is worthwhile.

    It is if the fit has not converged, if no output is explained to 70 %, or, for cheap
    simulations, if an output's residual is much larger than its white noise. For expensive
    simulations (secant mode) a descent that has not converged but explains every output to 70 % is
    close enough: another start would end in the same valley. So is one whose next step would stay
    within the confidence region (in turbulence no model explains every output).
    """
    evaluation = problem.evaluate(best.theta)
    if evaluation is None or not (best.converged or problem.secant):
        return True
    residual = problem.measured - evaluation[1]
    mean_square = np.nanmean(residual**2, axis=0)
    if problem.secant:
        share = mean_square / problem.output_scale**2
        is_near = best.converged or best.decrement**2 < best.theta.size
        return bool((share.min() if is_near else share.max()) > UNEXPLAINED_SHARE)
    noise = np.array(
        [
            white_noise([problem.measured[a:b, k] for a, b in pairwise(edges)])
            for k in range(residual.shape[1])
        ]
    )
    with np.errstate(invalid="ignore"):
        is_large = (mean_square > LARGE_RESIDUAL**2 * noise**2) & (
            mean_square > RELEVANT_SHARE * problem.output_scale**2
        )
    return bool((mean_square / problem.output_scale**2).min() > UNEXPLAINED_SHARE or is_large.any())


def _from_short_horizons(
    problem: OutputErrorProblem,
    theta: FloatArray,
    edges: list[int],
    descend: Callable[..., Minimum],
    max_iterations: int,
    tolerance: float,
) -> Minimum | None:
    """Minimise from theta (k,) on the first parts of every segment, then on all of it.

    Far from the truth a long simulation diverges or swings out of phase and gives no direction. Its
    beginning is nearly linear in the parameters.
    """
    complete = problem.measured
    try:
        for share in HORIZONS:
            # Hide the later part of every segment.
            problem.measured = complete.copy()
            for first, last in pairwise(edges):
                problem.measured[first + max(int(share * (last - first)), 1) : last] = np.nan
            if not (np.isfinite(problem.measured).sum(axis=0) > theta.size).all():
                continue
            start = problem.evaluate(theta)
            if start is None:
                return None
            theta = descend(theta, start, 20, 0.1).theta
    finally:
        problem.measured = complete
    start = problem.evaluate(theta)
    return None if start is None else descend(theta, start, max_iterations, tolerance)


def _assemble(
    theta: FloatArray,
    columns: list[int],
    labels: tuple[str, ...],
    best: Any,
    problem: OutputErrorProblem,
    *,
    findings: Findings,
    residual: list[FloatArray],
    many: bool,
) -> OutputErrorFit:
    """Expand the findings on the free parameters to all parameters."""
    # Parameters that were held fixed have no covariance: NaN.
    k = theta.size
    out = theta.copy()
    out[columns] = best.theta
    cov, crb, vif = np.full((k, k), np.nan), np.full((k, k), np.nan), np.full(k, np.inf)
    cov[np.ix_(columns, columns)] = findings.cov
    crb[np.ix_(columns, columns)] = findings.cov_crb
    vif[columns] = findings.vif
    # Status and reason of each parameter, fixed ones first.
    status, reason = dict.fromkeys(labels, "fixed"), dict.fromkeys(labels, "held at theta0 (free=)")
    for position, index in enumerate(columns):
        status[labels[index]] = "identified" if findings.identified[position] else "not-identified"
        reason[labels[index]] = findings.reason[position]
    # Convergence to a point where nothing is identified is none.
    warnings = list(findings.warnings)
    converged = best.converged and bool(findings.identified.any())
    if not best.converged:
        warnings.insert(0, f"not converged: {best.message}")
    elif not converged:
        warnings.insert(
            0, "not converged: no parameter is identified at the point reached; try another start"
        )
    if best.failed:
        warnings.append(
            f"{best.failed} trial point(s) could not be simulated and were rejected:"
            f" {problem.last_failure}"
        )
    return OutputErrorFit(
        names=labels,
        theta=out,
        std=np.sqrt(np.diagonal(cov)),
        std_crb=np.sqrt(np.diagonal(crb)),
        cov=cov,
        cov_crb=crb,
        status=status,
        reason=reason,
        vif=vif,
        noise_cov=findings.noise.cov,
        residual=residual if many else residual[0],
        whiteness=findings.colour.p_value,
        converged=converged,
        warnings=warnings,
        iterations=best.iterations,
        n_simulations=problem.runs,
        cost=best.cost,
        cost_history=np.array(best.cost_history),
    )
