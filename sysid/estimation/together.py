"""Perturbed simulations that can be one: parameters that move different segments are stepped in the same run.

Curtis, A. R., Powell, M. J. D. and Reid, J. K., "On the Estimation of Sparse Jacobian Matrices", IMA Journal of Applied Mathematics
13 (1974): columns of a Jacobian without a row in common are differenced together. A segment's start state moves that segment
alone, so that as many runs as it has states serve those of all segments.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from sysid.arrays import FloatArray

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
