"""Flights of the batch engine as paths of a multilevel splitting: side by side, scored, and copied.

Flights begin with the campaign's own burn-in, so that a path starts from a state of the loiter itself. At each checkpoint a path
has a score of its state. A copy is the same flight to the checkpoint; from there its gusts and noise come from streams of (root
seed, aleatory id, level, branch, kind).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from uqharness.batch import Branch, Course, ready
from uqharness.errors import BadInputError
from uqharness.flight import FlightSpec, Split, record_stride, row_counts
from uqharness.statistics import Checkpoint

DISTANCE = "cross_track"


@dataclass(frozen=True)
class Hit:
    """A path's first excursion beyond the radius of that place: which flight, where it branched, in which frame, how far out."""

    aleatory_id: int
    kind: int
    frame: int
    distance_m: float
    splits: tuple[Split, ...]


class Score(Protocol):
    """How near a state is to an excursion. It decides the spread of an estimate, not its mean."""

    @property
    def properties(self) -> tuple[str, ...]:
        """Properties of the aircraft that are read at a checkpoint."""

    def of(
        self, values: Mapping[str, FloatArray], distance_m: FloatArray, closing_mps: FloatArray
    ) -> FloatArray:
        """(paths,) score of those properties (paths,), the distance from the commanded path and its rate (paths,)."""


@dataclass(frozen=True)
class Lookahead:
    """The distance that a path will have after ``lookahead_s`` of closing as it does now."""

    lookahead_s: float
    properties: tuple[str, ...] = ()

    def of(
        self, values: Mapping[str, FloatArray], distance_m: FloatArray, closing_mps: FloatArray
    ) -> FloatArray:
        """(paths,) [m]."""
        return distance_m + self.lookahead_s * closing_mps


@dataclass(frozen=True)
class Watch:
    """How paths are looked at: a checkpoint every ``step_s`` seconds, and their score there; so many first excursions beyond each
    radius are noted with their path."""

    step_s: float
    score: Score
    noted: int = 0


class LoiterPaths:
    """Flights that differ in their air alone. ``specs`` and ``aleatory_ids`` belong together; ``root`` is the campaign's seed.

    Excursions are those of the campaign's tables, from the recorded rows between two checkpoints.
    """

    def __init__(
        self, specs: Sequence[FlightSpec], aleatory_ids: Sequence[int], root: int, watch: Watch
    ) -> None:
        """Raises BadInputError for what the batch engine cannot fly, an aircraft without a commanded path, and a step that is no
        whole number of recorded rows."""
        first = specs[0]
        made = ready(first)
        if DISTANCE not in made.table:
            raise BadInputError(
                f"the card of {first.aircraft.name} names no {DISTANCE} under [metrics]: nothing to leave"
            )
        source, dt_s = made.table[DISTANCE], made.lanes.dt_s
        self._stride = record_stride(first, dt_s)
        self._row_s = self._stride * dt_s
        rows = round(watch.step_s / self._row_s)
        if rows < 2 or abs(rows * self._row_s - watch.step_s) > 1e-9:
            raise BadInputError(
                f"step_s = {watch.step_s:g}: a multiple of the recorded {self._row_s:g} s, two of them at least"
            )
        self._step, self._watch, self._root = rows * self._stride, watch, root
        self._channel, self._factor = (
            list(made.lanes.program.records).index(source.property),
            source.factor,
        )
        self._course = Course.begun(made, specs)
        self._course.fly(row_counts(first, self._row_s)[0] * self._stride)
        self._course.taken()
        self._ids = np.asarray(aleatory_ids)
        self._radii, self._rearm = np.asarray(first.excursion_radius_m, dtype=float), first.rearm_m
        self._outside = np.zeros((len(specs), self._radii.size), dtype=bool)
        self._had = np.zeros_like(self._outside)
        self._numbers: dict[tuple[int, int], int] = {}
        self.hits: list[Hit] = []

    def advance(self) -> Checkpoint | None:
        """Fly to the next checkpoint; None behind the last."""
        course = self._course
        if course.frame >= course.last:
            return None
        begun = course.frame
        course.fly(min(begun + self._step, course.last))
        ended = np.array([end.status != "ok" for end in course.ends])
        distance = self._distances(course.taken())
        events = np.zeros(self._outside.shape, dtype=np.int64)
        for row in range(distance.shape[1]):
            here = distance[:, row, None]
            beyond = here > self._radii
            events += beyond & ~self._outside
            self._note(beyond & ~self._had, begun + (row + 1) * self._stride, distance[:, row])
            self._had |= beyond
            self._outside = beyond | (self._outside & ~(here < self._radii - self._rearm))
        closing = (distance[:, -1] - distance[:, -2]) / self._row_s
        watched = {name: course.watched(name) for name in self._watch.score.properties}
        score = self._watch.score.of(watched, distance[:, -1], closing)
        return Checkpoint(np.where(ended, -np.inf, score), events, ended)

    def follow(self, parents: Sequence[int], levels: Sequence[int]) -> None:
        """Go on with these paths in that order; those with a level branch here."""
        keys = [
            None if level == 0 else self._key(int(self._ids[parent]), level)
            for parent, level in zip(parents, levels, strict=True)
        ]
        self._course.follow(parents, keys)
        chosen = list(parents)
        self._ids, self._outside, self._had = (
            self._ids[chosen],
            self._outside[chosen],
            self._had[chosen],
        )

    def _key(self, aleatory_id: int, level: int) -> Branch:
        number = self._numbers.get((aleatory_id, level), 0)
        self._numbers[aleatory_id, level] = number + 1
        return Branch(self._root, aleatory_id, level, number)

    def _distances(self, rows: Sequence[FloatArray]) -> FloatArray:
        """(paths, rows) [m] without sign; NaN behind a flight's end."""
        found = np.full((len(rows), max(2, *(each.shape[1] for each in rows))), np.nan)
        for place, each in enumerate(rows):
            found[place, : each.shape[1]] = each[self._channel]
        return np.abs(found * self._factor)

    def _note(self, first: NDArray[np.bool_], frame: int, distance: FloatArray) -> None:
        if not self._watch.noted:
            return
        for path, kind in np.argwhere(first):
            if sum(hit.kind == kind for hit in self.hits) < self._watch.noted:
                splits = self._course.splits[path]
                self.hits.append(
                    Hit(int(self._ids[path]), int(kind), frame, float(distance[path]), splits)
                )


# How near a state is to an excursion, by linear predictions of the distance to come, fitted to
# flights that are not split.
#
# A path with regressors x is expected at the distance m_h(x) after h seconds, within s_h
# (standard deviation of what the regression leaves). Its score is the largest (m_h - radius) /
# s_h over the horizons: the distance to the radius in standard deviations. For a linear system
# in Gaussian noise minus half its square is the logarithm of the probability of an excursion,
# up to smaller terms, so that states are in the order of that probability, as a good importance
# function has them (Garvels 2000, chapter 3). Pure: no file, no clock.

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
