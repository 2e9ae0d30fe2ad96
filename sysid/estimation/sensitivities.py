"""Output sensitivities by finite differences of a simulation that may fail.

A step is sized by what it does to the outputs, not by the parameter's magnitude: a small part of an output's spread.
So parameters of any unit, and starts at zero, need no hint.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray, is_many
from sysid.linalg.blocks import Blocks

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
    """Parameter ``index`` moved ``by``, for the ``position``-th column; ``rows`` of the outputs are all that it can move."""

    position: int
    index: int
    by: float
    rows: tuple[slice, ...]


def rows_moved(simulate: Any, index: int, edges: Sequence[int]) -> tuple[slice, ...]:
    """Rows (start and end in ``edges``) of the segments that a parameter moves. One slice of all rows, unless the simulation has a
    method ``moved(index)`` that gives numbers of segments; its None means all as well."""
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
    """Each shift, as the machine has it, and what it gives; those of a group that fails together are run again one by one."""
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


TARGET = 3e-4  # first wanted change of the most affected output, in its spread; then `target_for` its roughness
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
            except Exception as error:  # a model's own failure at a trial point is a rejected step, whatever its type
                return f"simulate raised {type(error).__name__}: {error}"
        return self.stacked(value)

    def stacked(self, value: Any) -> FloatArray | str:
        """Outputs of any permitted form as one (N, m) array; a sentence if the form is wrong or values not finite."""
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
            return f"simulate returned shapes {shapes}, measured has {wanted}; return the outputs at the measured samples"
        out = np.concatenate(parts)
        sound = np.abs(out) < HUGE  # False for NaN too
        if not sound.all():
            row = int(np.argwhere(~sound)[0][0])
            return f"simulate returned values that are not finite, or beyond {HUGE:g}, from stacked sample {row} on"
        return out


def run_all(
    simulation: SafeSimulation, thetas: Sequence[FloatArray], map_: MapLike | None
) -> Iterator[FloatArray | str]:
    """Every theta simulated, in order, through the injected map if there is one; one after the other, where that is how it gives
    them."""
    yield from (map_ or map)(simulation, thetas)


@dataclass(frozen=True)
class Differences:
    """sensitivity (N, m, len(columns)) in blocks; step (k,) as adapted; effect (len(columns),) bool; runs: simulations spent."""

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

    Central differences, or forward ones; one-sided at a bound or where one side fails. spread (m,) scales the outputs.
    target: wanted change of the most affected output, in its spread. Parameters of which the simulation says, by a method
    ``moved``, that they move different segments are perturbed together (together.py).
    A parameter whose every perturbed run fails gets effect False.
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
        # Below this a step is lost in the parameter's own rounding, and shrinking it further would never find an effect again.
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
    """d(outputs)/d(theta) (N, m, k) by one step of each parameter, ``steps`` (k,); None where a simulation fails.

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
    """How far the outputs are from smooth in theta, in their spread (rms), and the simulations it took to find out.

    Six points along small (k,) steps away from theta: a smooth function leaves nothing in high differences, rounding,
    iterated trims and printed decimals do. More, J. J. and Wild, S. M., SIAM J. Sci. Comput. 33 (2011), eq. (2.4).
    """
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
    """The output change at which a central difference's truncation and rounding balance, about roughness^(1/3)."""
    return float(np.clip(np.cbrt(rough), *TARGETS))
