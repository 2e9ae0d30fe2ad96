"""Output error: maximum likelihood for measurement noise alone.

    J(theta) = 1/2 sum_i [z(i) - y(i)]' R^-1 [z(i) - y(i)] + N/2 ln det R

with R at its own maximum-likelihood value for every theta (relaxation), so that the cost followed
is the concentrated likelihood and falls at every accepted step. Klein and Morelli, "Aircraft System
Identification" (2006), ch. 6; Jategaonkar, R. V., "Flight Vehicle System Identification", 2nd ed.
(2015), ch. 4."""

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
    is_many,
)
from sysid.estimation.gaps import white_noise
from sysid.estimation.gauss_newton import Linearisation, Minimum, Told, minimise
from sysid.estimation.noise import Noise, concentrated, residual_noise
from sysid.estimation.results import Findings, OutputErrorFit, judge, split, unjudged
from sysid.linalg import Blocks, Index

# Output sensitivities by finite differences of a simulation that may fail.
#
# A step is sized by what it does to the outputs, not by the parameter's magnitude: a small part
# of an output's spread. So parameters of any unit, and starts at zero, need no hint.

# Perturbed simulations that can be one: parameters that move different segments are stepped in
# the same run.
#
# Curtis, A. R., Powell, M. J. D. and Reid, J. K., "On the Estimation of Sparse Jacobian
# Matrices", IMA Journal of Applied Mathematics 13 (1974): columns of a Jacobian without a row
# in common are differenced together. A segment's start state moves that segment alone, so that
# as many runs as it has states serve those of all segments.

Answer = list[FloatArray] | str
"""Outputs (n, m) of each of a parameter's rows, or a sentence that says what failed."""
Run = Callable[[Sequence[FloatArray]], Iterator[FloatArray | str]]
"""Outputs (N, m) at each of some theta, in their order."""


@dataclass(frozen=True)
class Shift:
    """Parameter ``index`` moved ``by``, for the ``position``-th column; ``rows`` of the outputs are
    all that it can move.
    """

    position: int
    index: int
    by: float
    rows: tuple[slice, ...]


def rows_moved(simulate: Any, index: int, edges: Sequence[int]) -> tuple[slice, ...]:
    """Rows (start and end in ``edges``) of the segments that a parameter moves. One slice of all
    rows, unless the simulation has a method ``moved(index)`` that gives numbers of segments; its
    None means all as well."""
    asked = getattr(simulate, "moved", None)
    some = None if asked is None else asked(index)
    if some is None:
        return (slice(edges[0], edges[-1]),)
    every = [slice(a, b) for a, b in pairwise(edges)]
    return tuple(every[number] for number in some)


def grouped(shifts: Sequence[Shift]) -> list[list[Shift]]:
    """Shifts that have no row in common together, each in the first group that has room for it."""
    groups: list[list[Shift]] = []
    taken: list[list[tuple[int, int]]] = []
    for shift in shifts:
        own = [(rows.start, rows.stop) for rows in shift.rows]
        for members, rows in zip(groups, taken, strict=True):
            if not any(a < d and c < b for a, b in own for c, d in rows):
                members.append(shift)
                rows += own
                break
        else:
            groups.append([shift])
            taken.append(own)
    return groups


def answers(
    run: Run, theta: FloatArray, shifts: Sequence[Shift]
) -> Iterator[tuple[Shift, float, Answer]]:
    """Each shift, as the machine has it, and what it gives; those of a group that fails together
    are run again one by one.
    """
    alone: list[Shift] = []
    groups = grouped(shifts)
    for members, found in zip(
        groups, run([_moved(theta, members) for members in groups]), strict=True
    ):
        if isinstance(found, str) and len(members) > 1:
            alone += members
        else:
            yield from _shared_out(theta, members, found)
    for shift, found in zip(
        alone, run([_moved(theta, [shift]) for shift in alone]) if alone else (), strict=True
    ):
        yield from _shared_out(theta, [shift], found)


def _moved(theta: FloatArray, members: Sequence[Shift]) -> FloatArray:
    out = theta.copy()
    for shift in members:
        out[shift.index] += shift.by
    return out


def _shared_out(
    theta: FloatArray, members: Sequence[Shift], found: FloatArray | str
) -> Iterator[tuple[Shift, float, Answer]]:
    for shift in members:
        # The step as the machine sees it: (theta + h) - theta.
        by = float((theta[shift.index] + shift.by) - theta[shift.index])
        if isinstance(found, str):
            yield shift, by, found
        else:
            # Copies where several share: a view would keep all rows in memory.
            yield (
                shift,
                by,
                [found[rows] if len(members) == 1 else found[rows].copy() for rows in shift.rows],
            )


# first wanted change of the most affected output, in its spread; then `target_for` its roughness
TARGET = 3e-4
TARGETS = (
    3e-5,
    3e-2,
)  # range of wanted changes: truncation ~ target^2, rounding ~ roughness / target
WITHIN = (3e-3, 30.0)  # a change outside this range of the wanted one is repeated with another step
NO_EFFECT = 1e-11  # a smaller change at the largest step tried is rounding, not an effect
SMALLEST = 1e-12  # of a parameter's value: the shortest step
HUGE = 1e100  # outputs beyond this are a diverged simulation; their squares must not overflow

MapLike = Callable[[Callable[[FloatArray], Any], Iterable[FloatArray]], Iterable[Any]]


@dataclass(frozen=True)
class SafeSimulation:
    """simulate(theta) made total: the stacked outputs (N, m), or a sentence saying what went wrong.

    A module-level class, so that a process pool can receive it whenever it can receive `simulate`.
    """

    simulate: Callable[[FloatArray], Any]
    lengths: tuple[int, ...]
    outputs: int

    def __call__(self, theta: FloatArray) -> FloatArray | str:
        with np.errstate(all="ignore"):
            try:
                value = self.simulate(theta.copy())
            # a model's own failure at a trial point is a rejected step, whatever its type
            except Exception as error:
                return f"simulate raised {type(error).__name__}: {error}"
        return self.stacked(value)

    def stacked(self, value: Any) -> FloatArray | str:
        """Outputs of any permitted form as one (N, m) array; a sentence if the form is wrong or
        values not finite.
        """
        try:
            parts = [
                np.asarray(part, dtype=float) for part in (value if is_many(value) else [value])
            ]
        except (TypeError, ValueError) as error:
            return f"simulate returned something not numeric: {error}"
        parts = [part[:, None] if part.ndim == 1 else part for part in parts]
        shapes, wanted = (
            [part.shape for part in parts],
            [(length, self.outputs) for length in self.lengths],
        )
        if shapes != wanted:
            return (
                f"simulate returned shapes {shapes}, measured has {wanted}; return the outputs at"
                " the measured samples"
            )
        out = np.concatenate(parts)
        sound = np.abs(out) < HUGE  # False for NaN too
        if not sound.all():
            row = int(np.argwhere(~sound)[0][0])
            return (
                f"simulate returned values that are not finite, or beyond {HUGE:g}, from stacked"
                f" sample {row} on"
            )
        return out


def run_all(
    simulation: SafeSimulation, thetas: Sequence[FloatArray], map_: MapLike | None
) -> Iterator[FloatArray | str]:
    """Every theta simulated, in order, through the injected map if there is one; one after the
    other, where that is how it gives them."""
    yield from (map_ or map)(simulation, thetas)


@dataclass(frozen=True)
class Differences:
    """sensitivity (N, m, len(columns)) in blocks; step (k,) as adapted; effect (len(columns),)
    bool; runs: simulations spent.
    """

    sensitivity: Blocks
    step: FloatArray
    effect: NDArray[np.bool_]
    runs: int


def first_steps(theta: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Starting steps (k,): a small part of the value, of the bounds' width, or of one."""
    width = np.where(np.isfinite(upper - lower), upper - lower, 1.0)
    return np.asarray(1e-4 * np.where(theta != 0.0, np.abs(theta), width))


def sensitivities(
    simulation: SafeSimulation,
    theta: FloatArray,
    base: FloatArray,
    step: FloatArray,
    columns: Sequence[int],
    limits: tuple[FloatArray, FloatArray],
    spread: FloatArray,
    *,
    central: bool,
    map_: MapLike | None,
    target: float = TARGET,
) -> Differences:
    """d(outputs)/d(theta) at `theta`, whose outputs are `base` (N, m).

    Central differences, or forward ones; one-sided at a bound or where one side fails. spread (m,)
    scales the outputs. target: wanted change of the most affected output, in its spread. Parameters
    of which the simulation says, by a method ``moved``, that they move different segments are
    perturbed together (together.py). A parameter whose every perturbed run fails gets effect False.
    """
    step = step.copy()
    lower, upper = limits
    edges = [0, *np.cumsum(simulation.lengths).tolist()]
    out: list[list[FloatArray | None]] = [[None] * (len(edges) - 1) for _ in columns]
    effect = np.zeros(len(columns), dtype=bool)
    pending, runs = list(range(len(columns))), 0
    rows = [rows_moved(simulation.simulate, j, edges) for j in columns]

    def run(points: Sequence[FloatArray]) -> Iterator[FloatArray | str]:
        nonlocal runs
        runs += len(points)
        return run_all(simulation, points, map_)

    for attempt in range(6):
        # Below this a step is lost in the parameter's own rounding, and shrinking it further would
        # never find an effect again.
        step = np.maximum(step, SMALLEST * np.abs(theta))
        shifts = [
            s
            for k in pending
            for s in _shifts(k, columns[k], theta, step, limits, central, rows[k])
        ]
        again = []
        for position, sides in _by_position(answers(run, theta, shifts), shifts):
            j = columns[position]
            sound = [
                (by, answer) for by, answer in sides if not isinstance(answer, str) and by != 0.0
            ]
            if not sound:
                step[j] *= 0.03
                again.append(position)
                continue
            column = _column(sound, base, rows[position])
            used = max(abs(by) for by, _ in sound)
            with np.errstate(over="ignore", invalid="ignore"):
                square = sum(np.sum(part**2, axis=0) for part in column) / len(base)
                change = float(np.max(np.sqrt(square) * used / spread))
            if not np.isfinite(change):
                step[j] *= 1e-4
                again.append(position)
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
                again.append(position)
        pending = sorted(again)
        if not pending:
            break
    return Differences(Blocks.gathered(out, base.shape[1], edges), step, effect, runs)


def forward_differences(
    simulate: Callable[[FloatArray], Any],
    theta: FloatArray,
    steps: FloatArray,
    shape: tuple[Sequence[int], int],
    map_: MapLike | None = None,
) -> Blocks | None:
    """d(outputs)/d(theta) (N, m, k) by one step of each parameter, ``steps`` (k,); None where a
    simulation fails.

    shape: rows of each segment, and outputs.
    """
    lengths, outputs = tuple(shape[0]), shape[1]
    simulation = SafeSimulation(simulate, lengths, outputs)
    base = simulation(theta)
    if isinstance(base, str):
        return None
    edges = [0, *np.cumsum(lengths).tolist()]
    out: list[list[FloatArray | None]] = [[None] * len(lengths) for _ in theta]
    shifts = [
        Shift(k, k, float(step), rows_moved(simulate, k, edges)) for k, step in enumerate(steps)
    ]
    for shift, _, answer in answers(
        lambda points: run_all(simulation, points, map_), theta, shifts
    ):
        if isinstance(answer, str):
            return None
        out[shift.position] = _by_segment(
            _column([(shift.by, answer)], base, shift.rows), shift.rows, edges
        )
    return Blocks.gathered(out, outputs, edges)


def _shifts(
    position: int,
    j: int,
    theta: FloatArray,
    step: FloatArray,
    limits: tuple[FloatArray, FloatArray],
    central: bool,
    rows: tuple[slice, ...],
) -> Iterator[Shift]:
    """A step up, and one down where both are asked for or there is no room above."""
    lower, upper = limits
    up, down = min(step[j], upper[j] - theta[j]), min(step[j], theta[j] - lower[j])
    floor = 0.5 * step[j]
    forward = up >= floor or up >= down
    if forward:
        yield Shift(position, j, up, rows)
    if (central and down >= floor) or not forward:
        yield Shift(position, j, -down, rows)


def _by_position(
    found: Iterable[tuple[Shift, float, Answer]], shifts: Sequence[Shift]
) -> Iterator[tuple[int, list[tuple[float, Answer]]]]:
    """Columns as soon as all their sides are there, upwards first: nothing is kept longer."""
    wanted = Counter(shift.position for shift in shifts)
    sides: dict[int, list[tuple[float, Answer]]] = {}
    for shift, by, answer in found:
        own = sides.setdefault(shift.position, [])
        own.append((by, answer))
        if len(own) == wanted[shift.position]:
            yield shift.position, sorted(sides.pop(shift.position), key=lambda side: -side[0])


def _column(
    sides: Sequence[tuple[float, Any]], base: FloatArray, rows: tuple[slice, ...]
) -> list[FloatArray]:
    """Differences (n, m) over one step or two, of each of the rows."""
    (by, first), *others = sides
    if others:
        other_by, other = others[0]
        return [(a - b) / (by - other_by) for a, b in zip(first, other, strict=True)]
    return [(part - base[own]) / by for part, own in zip(first, rows, strict=True)]


def _by_segment(
    column: Sequence[FloatArray], rows: tuple[slice, ...], edges: Sequence[int]
) -> list[FloatArray | None]:
    """Of each segment what moves in it, None where nothing does."""
    cut = {
        own.start + a: part[a:b]
        for part, own in zip(column, rows, strict=True)
        for a, b in _inside(own, edges)
    }
    return [
        part.copy() if (part := cut.get(a)) is not None and part.any() else None for a in edges[:-1]
    ]


def _inside(own: slice, edges: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Where segments begin and end, counted from the first of the rows ``own``."""
    return (
        (a - own.start, b - own.start)
        for a, b in pairwise(edges)
        if own.start <= a and b <= own.stop
    )


def _next_step(
    step: float, change: float, target: float, unit: float, room: float, last: bool
) -> tuple[float, bool]:
    """The step for the next difference, and whether this one is repeated with it."""
    if change <= NO_EFFECT:
        if step < 99.0 * unit and not last:
            return (unit if step < 0.5 * unit else 100.0 * unit), True
        return 1e-4 * unit, False
    if not WITHIN[0] <= change / target <= WITHIN[1] and not last:
        wanted = step * target / change
        wanted = min(wanted, 0.01 * room) if np.isfinite(room) else wanted
        return (step, False) if 0.5 < wanted / step < 2.0 else (wanted, True)
    return step * float(np.clip(target / change, 0.1, 10.0)), False


def roughness(
    simulation: SafeSimulation,
    theta: FloatArray,
    base: FloatArray,
    small: FloatArray,
    limits: tuple[FloatArray, FloatArray],
    spread: FloatArray,
    map_: MapLike | None,
) -> tuple[float, int]:
    """How far the outputs are from smooth in theta, in their spread (rms), and the simulations it
    took to find out.

    Six points along small (k,) steps away from theta: a smooth function leaves nothing in high
    differences, rounding, iterated trims and printed decimals do. More, J. J. and Wild, S. M., SIAM
    J. Sci. Comput. 33 (2011), eq. (2.4)."""
    lower, upper = limits
    inward = np.where(theta + 7.0 * small > upper, -small, small)
    points = [theta + count * inward for count in range(1, 7)]
    points = [np.clip(point, lower, upper) for point in points]
    answers = list(run_all(simulation, points, map_))
    if any(isinstance(answer, str) for answer in answers):
        return 0.0, len(points)
    table = np.stack([base, *(answer for answer in answers if not isinstance(answer, str))])
    found = []
    for order in range(1, 6):
        table = np.diff(table, axis=0)
        if order >= 4:
            factor = math.factorial(order) ** 2 / math.factorial(2 * order)
            found.append(np.sqrt(factor * np.mean(table**2, axis=(0, 1))) / spread)
    return float(np.min(found, axis=0).max()), len(points)


def target_for(rough: float) -> float:
    """The output change at which a central difference's truncation and rounding balance, about
    roughness^(1/3).
    """
    return float(np.clip(np.cbrt(rough), *TARGETS))


# Output error's cost over the free parameters, with the sensitivities its steps need:
# differenced anew, or carried on.

CARRIED = 8  # secant updates before sensitivities are differenced anew
NEARBY = 0.5  # standard errors within which sensitivities need no renewal


@dataclass
class OutputErrorProblem:
    """The cost over the free parameters; counts simulations and keeps the adapted
    difference steps.
    """

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
        """All parameters, with the free ones at ``theta`` and the fixed ones at their given
        values.
        """
        out = self.full_theta.copy()
        out[self.columns] = theta
        return out

    def noise(self, outputs: FloatArray) -> Noise:
        """Measurement noise at its maximum-likelihood value for these outputs (n, ny)."""
        return residual_noise(self.measured - outputs, self.floor, self.full)

    def evaluate(self, theta: FloatArray) -> tuple[float, FloatArray] | None:
        """Concentrated cost at ``theta`` and the outputs (n, ny); None where the simulation
        failed.
        """
        self.runs += 1
        outputs = self.simulation(self.whole(theta))
        if isinstance(outputs, str):
            self.last_failure = outputs
            return None
        return concentrated(self.measured - outputs, self.noise(outputs)), outputs

    def linearise(self, theta: FloatArray, outputs: FloatArray, central: bool) -> Linearisation:
        """Gradient and information at theta (k,), whose outputs (N, m) are given.

        With ``secant`` the sensitivities of the last point are carried on by Broyden's update
        (Math. Comp. 19, 1965)

            S += (dy - S d) (W d)' / (d' W d),    W = diag M

        (segment by segment, where S is not zero: Schubert, Math. Comp. 24, 1970), which costs no
        simulation; they are differenced anew, forwards, when that has been done CARRIED times, when
        the search nears its end, and at a point asked for twice."""
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
        """The linearisation that bounds are computed from: differences at theta itself, or a small
        part of a bound away.
        """
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
        """Sensitivities carried on to theta: True near where they were differenced, False far from
        there, None: not possible.
        """
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
        """Sensitivities by differences; the second time, how small their steps may be as well: a
        fit that begins where it ends asks once."""
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


POORLY = 0.3  # share of an output's variance left over that counts as nothing explained
FAR_OFF, WORTH = (
    5.0,
    0.01,
)  # left over: so many times the noise, such a share of the variance, to look for another minimum
HORIZONS = (0.1, 0.2, 0.4)  # shares of each segment fitted first when the whole leads nowhere


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
    told: Told | None = None,
) -> OutputErrorFit:
    """Estimate theta (k,) such that simulate(theta) comes closest to what was measured.

    Parameters
    ----------
    simulate : callable
        theta (k,) -> (n, m) array, or a list of them, one per segment, at the measured samples, in
        the units of `measured`. It may raise or return NaN at a trial point: a shorter step is
        tried. With a method ``moved(j)`` it says which segments theta[j] moves (their numbers;
        None: all): parameters that move different ones are perturbed in the same simulation.
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
        for smooth simulations that are dear, carries sensitivities on from iteration to iteration.
    max_iterations, tolerance
        Stop when the next step is shorter than `tolerance` standard errors.
    errors : bool
        False for the estimates alone: standard errors, covariances and variance inflation are then
        NaN, nothing is judged.
    told : callable, optional
        Called in each iteration of a descent with its number and the length of the next step in
        standard errors.

    Returns
    -------
    OutputErrorFit
        ``theta`` (k,), ``std`` (k,) corrected for coloured residuals (see coloured.py), ``std_crb``
        (k,) the Cramer-Rao bound. Parameters that the data do not determine, or that end on a
        bound, are "not-identified": their std is NaN and fit.reason says why; the others are still
        estimated. Where it did not converge, ``converged`` and ``warnings`` say so.

    Raises
    ------
    ValueError
        When inputs disagree, theta0 lies outside the bounds, there are fewer measured values than
        parameters, or the simulation fails at theta0.

    References ---------- L. E. Hale, dissertation, Virginia Tech, 2016, eq. 2.4 to 2.9. V. Klein,
    E. A. Morelli, Aircraft System Identification, 2006.

    Examples -------- >>> import numpy as np >>> import sysid >>> t = np.linspace(0.0, 5.0, 100) >>>
    measured = 2.0 * np.exp(-0.5 * t) + 0.01 * np.sin(40.0 * t) >>> fit = sysid.output_error(lambda
    theta: theta[0] * np.exp(-theta[1] * t), [1.0, 1.0], measured) >>> [round(float(value), 1) for
    value in fit.theta] [2.0, 0.5]"""
    theta = as_parameters(theta0)
    labels = as_names(names, theta.size, "theta")
    lower, upper = as_bounds(bounds, theta, labels)
    mask = as_free(free, labels)
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
        spread = np.nanstd(stacked, axis=0)
    size = np.nanmax(np.abs(stacked), axis=0)
    spread = np.where(spread > 1e-12 * size, spread, np.where(size > 0.0, size, 1.0))

    simulation = SafeSimulation(
        simulate, tuple(part.shape[0] for part in segments), stacked.shape[1]
    )
    problem = OutputErrorProblem(
        simulation,
        stacked,
        theta,
        columns,
        (lower, upper),
        spread,
        noise == "full",
        map,
        first_steps(theta, lower, upper),
        differences == "secant",
        told,
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
        )

    best = descend(theta[columns], start, max_iterations, tolerance)
    if _lost(problem, best, edges):
        other = _from_short_horizons(
            problem, theta[columns], edges, descend, max_iterations, tolerance
        )
        best = other if other is not None and other.cost < best.cost else best

    again = problem.evaluate(best.theta)
    assert again is not None
    residual = stacked - again[1]
    if not errors:
        said = unjudged(problem.noise(again[1]), len(columns))
        return _assemble(
            theta, columns, labels, best, problem, said, split(residual, edges), is_many(measured)
        )
    line = problem.settle(best.theta, again[1])
    findings = judge(
        theta=best.theta,
        gradient=line.gradient,
        sensitivity=problem.sensitivity,
        residual=residual,
        motion=again[1],
        edges=edges,
        names=tuple(labels[index] for index in columns),
        bounds=(lower[columns], upper[columns]),
        floor=problem.floor,
        full=problem.full,
        method="output error",
    )
    return _assemble(
        theta, columns, labels, best, problem, findings, split(residual, edges), is_many(measured)
    )


def _lost(problem: OutputErrorProblem, best: Minimum, edges: list[int]) -> bool:
    """Perhaps not the minimum that was meant: no output explained even to 70 %, or not converged,
    or, where simulations are cheap, an output left much further off than its white noise. Where
    they are dear, a descent that has not converged but explains every output to 70 % is no longer
    far off: another start would end in the same valley."""
    found = problem.evaluate(best.theta)
    if found is None or not (best.converged or problem.secant):
        return True
    residual = problem.measured - found[1]
    left = np.nanmean(residual**2, axis=0)
    if problem.secant:
        share = left / problem.spread**2
        return bool((share.min() if best.converged else share.max()) > POORLY)
    noise = np.array(
        [
            white_noise([problem.measured[a:b, k] for a, b in pairwise(edges)])
            for k in range(residual.shape[1])
        ]
    )
    with np.errstate(invalid="ignore"):
        far = (left > FAR_OFF**2 * noise**2) & (left > WORTH * problem.spread**2)
    return bool((left / problem.spread**2).min() > POORLY or far.any())


def _from_short_horizons(
    problem: OutputErrorProblem,
    theta: FloatArray,
    edges: list[int],
    descend: Callable[..., Minimum],
    max_iterations: int,
    tolerance: float,
) -> Minimum | None:
    """The minimum reached from theta (k,) by way of the first tenth, third and whole of every
    segment.

    Far from the truth a long simulation says little about where to go: it diverges, or swings out
    of phase. Its beginning is nearly linear in the parameters."""
    complete = problem.measured
    try:
        for share in HORIZONS:
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
    findings: Findings,
    residual: list[FloatArray],
    many: bool,
) -> OutputErrorFit:
    """The findings over the free parameters, spread over all of them."""
    k = theta.size
    out = theta.copy()
    out[columns] = best.theta
    cov, crb, vif = np.full((k, k), np.nan), np.full((k, k), np.nan), np.full(k, np.inf)
    cov[np.ix_(columns, columns)] = findings.cov
    crb[np.ix_(columns, columns)] = findings.cov_crb
    vif[columns] = findings.vif
    status, reason = dict.fromkeys(labels, "fixed"), dict.fromkeys(labels, "held at theta0 (free=)")
    for position, index in enumerate(columns):
        status[labels[index]] = "identified" if findings.identified[position] else "not-identified"
        reason[labels[index]] = findings.reason[position]
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
