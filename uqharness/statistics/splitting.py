"""Multilevel splitting: the probability of a rare event from paths that are copied near it.

All paths advance from one checkpoint to the next together. A score measures the distance to the
event; levels are scores s1 < s2 < ... A path that rises to level k continues as ``copies`` paths
for each level that it rises, each of weight copies^-k. Copies made at a level end when they fall
below it; the path that was copied continues with the weight of the level to which it falls. A
weighted count of events is unbiased whatever the levels and the score (RESTART: Villen-Altamirano
1991; Garvels 2000, chapter 2), which decide its variance alone. Levels come from a pilot, whose
paths are not counted. A path keeps its level until it falls below the level beneath, so that paths
that oscillate about a level are not copied repeatedly.

An event is a first excursion, or one that follows it on the same path. P is the probability that a
path of fixed length has an event, N the mean number of events of a path, N/P the events of a path
that has any. Intervals come from independent replicates: Student's t on the logarithm of their
mean. `uqharness.campaign.rare_events` supplies the paths.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.distributions import student_quantile

COPIES = 3
"""Paths that continue for one that rises a level.

Between 2 and 4 the cost differs by some per cent.
"""
SHARE = 0.1
"""Share of its time that a path spends above the first level.

The time above a level is flown ``COPIES * SHARE`` times.
"""
MIN_CHECKPOINTS = 200
"""Checkpoints of paths above a score that the pilot needs to place a level there."""
MAX_PATHS = 50_000
_ROUNDS, _PATIENCE = 30, 4


@dataclass(frozen=True)
class Levels:
    """Scores of the levels (k,), ascending; a path at level k has the weight ``copies``^-k."""

    scores: tuple[float, ...]
    copies: int = COPIES

    @property
    def floors(self) -> tuple[float, ...]:
        """Score (k,) below which a path loses each level: the level beneath.

        For the first level as far below as the second is above.
        """
        if len(self.scores) < 2:
            return self.scores
        return (2.0 * self.scores[0] - self.scores[1], *self.scores[:-1])

    def __post_init__(self) -> None:
        """Raise ValueError for scores that do not rise, and for less than 2 copies."""
        if self.copies < 2 or any(not a < b for a, b in itertools.pairwise(self.scores)):
            raise ValueError(
                f"levels rise and have 2 copies or more; received {self.scores} and {self.copies}"
            )


@dataclass(frozen=True)
class Checkpoint:
    """Paths at a checkpoint.

    Attributes
    ----------
    score : array (n,)
        Of each path.
    events : array (n, kinds)
        Events since the last checkpoint.
    ended : array (n,) of bool
        Whether the path has ended.
    """

    score: FloatArray
    events: NDArray[np.int64]
    ended: NDArray[np.bool_]


class Paths(Protocol):
    """Paths that advance together and can be copied at a checkpoint.

    ``follow`` is not called when all paths continue and none is copied.
    """

    def advance(self) -> Checkpoint | None:
        """Advance to the next checkpoint; None behind the last."""

    def follow(self, parents: Sequence[int], levels: Sequence[int]) -> None:
        """Continue with these paths, in this order.

        Level 0 is the path itself; others are copies made at that level.
        """


@dataclass(frozen=True)
class Occupancy:
    """Time above each score of a grid (g,).

    Attributes
    ----------
    grid : array (g,)
        Scores.
    share : array (g,)
        Weighted share of time above each.
    count : array (g,)
        Checkpoints of paths above each.
    """

    grid: FloatArray
    share: FloatArray
    count: FloatArray


@dataclass(frozen=True)
class Replicate:
    """One run of ``roots`` paths.

    Attributes
    ----------
    roots : int
        Independent paths at the start.
    probability, events : array (kinds,)
        Probability of an event and mean number of events of a path, weighted.
    ended : float
        Weighted share of paths that ended early.
    steps : int
        Checkpoints of paths that were flown.
    max_paths, highest : int
        Largest number of paths, and highest level.
    occupancy : Occupancy
        Time above scores.
    probability_by_root, events_by_root : array (roots, kinds)
        The same of each root and its copies; roots are independent.
    """

    roots: int
    probability: FloatArray
    events: FloatArray
    ended: float
    steps: int
    max_paths: int
    highest: int
    occupancy: Occupancy
    probability_by_root: FloatArray
    events_by_root: FloatArray


def run(
    paths: Paths, roots: int, levels: Levels, kinds: int, grid: FloatArray | None = None
) -> Replicate:
    """Run ``roots`` paths to their end.

    An ended path counts one event of each kind that it has not had.

    Parameters
    ----------
    paths : Paths
        At their start.
    roots : int
        Number of paths.
    levels : Levels
        Splitting levels.
    kinds : int
        Kinds of events.
    grid : array (g,), optional
        Scores of the occupancy.

    Returns
    -------
    Replicate
        Weighted counts.

    Raises
    ------
    ValueError
        If more than MAX_PATHS would run side by side: the levels lie too close.
    """
    grid = np.zeros(0) if grid is None else grid
    thresholds, floors = np.array(levels.scores), np.array(levels.floors)
    # Weight of a path by its level.
    weights = float(levels.copies) ** -np.arange(len(levels.scores) + 1)
    level, birth_level, had_event = (
        np.zeros(roots, np.intp),
        np.zeros(roots, np.intp),
        np.zeros((roots, kinds), bool),
    )
    root, probability, events, ended = (
        np.arange(roots),
        np.zeros((roots, kinds)),
        np.zeros((roots, kinds)),
        0.0,
    )
    share, seen_above, checkpoints = np.zeros(grid.size), np.zeros(grid.size), 0
    steps, max_paths, highest = 0, roots, 0
    while (checkpoint := paths.advance()) is not None:
        weight = weights[level]
        # A path that ends without an event counts as one with an event.
        counts = np.where(
            checkpoint.ended[:, None] & ~had_event & (checkpoint.events == 0), 1, checkpoint.events
        )
        first = ~had_event & (counts > 0)
        happened = np.flatnonzero(counts.any(axis=1))
        # Weighted counts by root: first events, and all events.
        np.add.at(probability, root[happened], weight[happened, None] * first[happened])
        np.add.at(events, root[happened], weight[happened, None] * counts[happened])
        ended += float(weight @ checkpoint.ended)
        had_event |= first
        steps, checkpoints = steps + level.size, checkpoints + 1
        if grid.size:
            # Occupancy of the grid of scores.
            above = checkpoint.score[:, None] >= grid
            share += weight @ above
            seen_above += above.sum(axis=0)
        # New level: up to the score reached, down only below the floor of the level.
        reached = np.searchsorted(thresholds, checkpoint.score, side="right")
        new_level = np.maximum(
            reached, np.minimum(level, np.searchsorted(floors, checkpoint.score, side="right"))
        )
        # Copies end below the level at which they were made.
        goes_on = ~checkpoint.ended & (new_level >= birth_level)
        # Continue with the remaining paths and their copies.
        parents, branch_level = _descendants(level, new_level, goes_on, levels.copies)
        if parents.size > MAX_PATHS:
            raise ValueError(
                f"{parents.size} paths would go on side by side, {MAX_PATHS} at most can: the"
                " levels lie too close"
            )
        # Copies inherit the history of their parent.
        level, had_event, root = new_level[parents], had_event[parents], root[parents]
        birth_level = np.where(branch_level > 0, branch_level, birth_level[parents])
        max_paths, highest = max(max_paths, parents.size), max(highest, int(new_level.max()))
        if not parents.size:
            break
        if parents.size != checkpoint.score.size or branch_level.any():
            paths.follow(parents.tolist(), branch_level.tolist())
    occupancy = Occupancy(grid, share / max(roots * checkpoints, 1), seen_above)
    means = (probability.mean(axis=0), events.mean(axis=0), ended / roots)
    return Replicate(roots, *means, steps, max_paths, highest, occupancy, probability, events)


def _descendants(
    level: NDArray[np.intp], new_level: NDArray[np.intp], goes_on: NDArray[np.bool_], copies: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the parent of each path that continues, and the level of the copy (0: the parent
    itself).
    """
    parents, branch_level = [np.flatnonzero(goes_on)], [np.zeros(int(goes_on.sum()), np.intp)]
    for path in np.flatnonzero(goes_on & (new_level > level)):
        number = copies - 1
        for step in range(level[path] + 1, new_level[path] + 1):
            parents.append(np.full(number, path))
            branch_level.append(np.full(number, step))
            number *= copies
    return np.concatenate(parents), np.concatenate(branch_level)


def pilot(
    start: Callable[[int], Paths],
    roots: int,
    kinds: int,
    grid: FloatArray,
    top: float,
    *,
    share: float = SHARE,
    plain: Occupancy | None = None,
) -> Levels:
    """Find levels up to the score ``top``.

    A path is above the first level a ``share`` of its time, above each further one a COPIES-th of
    that. Rounds with the same levels are pooled and add levels as far as they have enough
    checkpoints.

    Parameters
    ----------
    start : callable
        Number of a round to its `Paths`.
    roots, kinds : int
        As in `run`.
    grid : array (g,)
        Scores.
    top : float
        Score of the event.
    share : float
        Time above the first level.
    plain : Occupancy, optional
        Of paths without splitting, for the first levels.

    Returns
    -------
    Levels
        Up to ``top``.

    Raises
    ------
    ValueError
        If four rounds add no level: longer or more paths are needed.
    """
    levels, occupancies = Levels(()), list[Occupancy]()
    if plain is not None:
        levels, is_complete = more_levels(plain, levels, top, share)
        if is_complete:
            return levels
    for number in range(_ROUNDS):
        occupancies.append(run(start(number), roots, levels, kinds, grid).occupancy)
        # Rounds with the same levels are averaged.
        pooled = Occupancy(
            grid,
            np.mean([one.share for one in occupancies], axis=0),
            np.sum([one.count for one in occupancies], axis=0),
        )
        new_levels, is_complete = more_levels(pooled, levels, top, share)
        if is_complete:
            return new_levels
        if len(new_levels.scores) > len(levels.scores):
            levels, occupancies = new_levels, []
        elif len(occupancies) == _PATIENCE:
            raise ValueError(
                f"{_PATIENCE} rounds of the pilot found no level above"
                f" {levels.scores[-1] if levels.scores else 0:g}, {top:g} is needed: use more or"
                f" longer paths than {roots} in the pilot"
            )
    raise ValueError(
        f"the pilot has not reached the score {top:g} in {_ROUNDS} rounds: use more paths than"
        f" {roots} in it"
    )


def more_levels(
    occupancy: Occupancy, existing: Levels, top: float, share: float = SHARE
) -> tuple[Levels, bool]:
    """Add levels as far as there are enough checkpoints.

    Returns the levels, and whether the next one would lie above ``top``.
    """
    enough = (occupancy.count >= MIN_CHECKPOINTS) & (occupancy.share > 0.0)
    grid, logs = occupancy.grid[enough], -np.log(occupancy.share[enough])
    # Of neighbouring scores with equal shares take the last.
    rising = np.append(np.diff(logs) > 0.0, True)[: grid.size]
    grid, logs = grid[rising], logs[rising]
    scores = list(existing.scores)
    while grid.size > 1:
        # The time above the next level is a COPIES-th of that above the last.
        target = (
            float(np.interp(scores[-1], grid, logs)) + math.log(COPIES)
            if scores
            else -math.log(share)
        )
        if not target <= logs[-1]:
            break
        score = float(np.interp(target, logs, grid))
        if score > top:
            return Levels(tuple(scores)), True
        scores.append(score)
    # The next level lies above the top if a path spends more than a COPIES-th of its time above the
    # last level above the top.
    place = int(np.searchsorted(occupancy.grid, top - 1e-9))
    last_is_reached = (
        bool(scores) and occupancy.count[place] * COPIES >= MIN_CHECKPOINTS and grid.size > 1
    )
    top_is_reached = last_is_reached and -math.log(occupancy.share[place]) < float(
        np.interp(scores[-1], grid, logs)
    ) + math.log(COPIES)
    return Levels(tuple(scores)), top_is_reached


@dataclass(frozen=True)
class Interval:
    """Mean of independent replicates with limits; NaN where undefined, with a ``reason``."""

    estimate: float
    lower: float
    upper: float
    replicates: int
    reason: str = ""


def interval(values: Sequence[float] | FloatArray, confidence: float = 0.95) -> Interval:
    """Compute the mean of positive replicates (n,) and its limits.

    Limits are mean times exp(+-t s / (mean sqrt(n))), t with n - 1 degrees of freedom.

    Parameters
    ----------
    values : array (n,)
        One a replicate.
    confidence : float
        Of the interval.

    Returns
    -------
    Interval
        NaN with a reason if a replicate has no event or there are fewer than two.

    Examples
    --------
    >>> result = interval([1.0, 1.0, 1.0])
    >>> result.estimate, result.lower, result.upper
    (1.0, 1.0, 1.0)
    """
    values = np.asarray(values, dtype=float)
    n_without_event, nan = int((values <= 0.0).sum()), math.nan
    if values.size < 2:
        estimate = float(values[0]) if values.size else nan
        return Interval(
            estimate, nan, nan, values.size, f"{values.size} replicates: 2 at least are needed"
        )
    mean = float(values.mean())
    if n_without_event:
        reason = (
            f"{n_without_event} of {values.size} replicates have no event: use more paths in each"
        )
        return Interval(
            mean if n_without_event < values.size else nan, nan, nan, values.size, reason
        )
    error = float(values.std(ddof=1)) / math.sqrt(values.size) / mean
    factor = math.exp(float(student_quantile(0.5 + 0.5 * confidence, values.size - 1)) * error)
    return Interval(mean, mean / factor, mean * factor, values.size)
