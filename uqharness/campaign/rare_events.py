"""Provide the paths that multilevel splitting needs to estimate rates of rare excursions.

`LoiterPaths` flies many paths side by side in the batch engine, scores their states at checkpoints
and branches the paths that `uqharness.statistics.run` selects. Every path begins with the burn-in
of the campaign, so it starts from a state of the loiter itself. A branch repeats its parent to the
checkpoint; from there its gusts and sensor noise come from streams of (root seed, aleatory id,
level, branch, kind). `DistancePredictor` scores states by linear predictions of the distance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from uqharness.batch import Branch, Course, compiled_mission
from uqharness.errors import BadInputError
from uqharness.flight import FlightSpec, Split, record_stride, row_counts
from uqharness.statistics import Checkpoint

DISTANCE = "cross_track"
"""Channel of the distance from the commanded path."""


@dataclass(frozen=True)
class FirstExcursion:
    """First excursion of a path beyond a radius.

    Attributes
    ----------
    aleatory_id : int
        Flight that the path descends from.
    kind : int
        Place of the radius in the list of radii.
    frame : int
        Simulation frame of the excursion.
    distance_m : float
        Distance there [m].
    splits : tuple of Split
        Branchings of the path; with them the path can be flown again.
    """

    aleatory_id: int
    kind: int
    frame: int
    distance_m: float
    splits: tuple[Split, ...]


class Score(Protocol):
    """Rate how close a state is to an excursion.

    The score affects the variance of a splitting estimate, not its mean.
    """

    @property
    def properties(self) -> tuple[str, ...]:
        """JSBSim properties that are read at a checkpoint."""

    def of(
        self, values: Mapping[str, FloatArray], distance_m: FloatArray, closing_mps: FloatArray
    ) -> FloatArray:
        """Return the score (paths,).

        Parameters
        ----------
        values : mapping of str to array
            Properties (paths,) at the checkpoint.
        distance_m : array
            Distance (paths,) from the commanded path [m].
        closing_mps : array
            Its rate of change (paths,) [m/s].
        """


@dataclass(frozen=True)
class CheckpointPlan:
    """Times and method of the scoring of paths.

    Attributes
    ----------
    step_s : float
        Time between checkpoints [s], a multiple of the record interval.
    score : Score
        Score of the states.
    max_noted : int
        Number of first excursions per radius that are recorded with their path.
    """

    step_s: float
    score: Score
    max_noted: int = 0


class LoiterPaths:
    """Paths that differ in their gusts and noise only, with branching at checkpoints.

    Excursions are counted as in the tables of a campaign, from the rows recorded between two
    checkpoints.

    Parameters
    ----------
    specs : sequence of FlightSpec
        One flight per path.
    aleatory_ids : sequence of int
        Their aleatory ids, in the same order.
    root : int
        Root seed of the campaign.
    watch : CheckpointPlan
        Checkpoints and score.

    Raises
    ------
    BadInputError
        If the batch engine cannot fly the aircraft, the aircraft has no commanded path, or the step
        is
        not a multiple of the record interval.
    """

    def __init__(
        self,
        specs: Sequence[FlightSpec],
        aleatory_ids: Sequence[int],
        root: int,
        watch: CheckpointPlan,
    ) -> None:
        """Compile the flight, fly the burn-in and discard its record."""
        first = specs[0]
        prepared = compiled_mission(first)
        if DISTANCE not in prepared.table:
            raise BadInputError(
                f"the card of {first.aircraft.name} names no {DISTANCE} under [metrics], so"
                " excursions are undefined"
            )
        # Checkpoints are at whole recorded rows.
        source, dt_s = prepared.table[DISTANCE], prepared.lanes.dt_s
        self._stride = record_stride(first, dt_s)
        self._row_s = self._stride * dt_s
        rows = round(watch.step_s / self._row_s)
        if rows < 2 or abs(rows * self._row_s - watch.step_s) > 1e-9:
            raise BadInputError(
                f"step_s = {watch.step_s:g}: a multiple of the recorded {self._row_s:g} s, two of"
                " them at least"
            )
        self._step, self._watch, self._root = rows * self._stride, watch, root
        # Where the distance is among the records, and its unit.
        self._channel, self._factor = (
            list(prepared.lanes.program.records).index(source.property),
            source.factor,
        )
        self._course = Course.start(prepared, specs)
        # Burn in, and discard its rows.
        self._course.fly(row_counts(first, self._row_s)[0] * self._stride)
        self._course.take_rows()
        # Which radii each path is outside of, and which it has been outside of.
        self._ids = np.asarray(aleatory_ids)
        self._radii, self._rearm = np.asarray(first.excursion_radius_m, dtype=float), first.rearm_m
        self._outside = np.zeros((len(specs), self._radii.size), dtype=bool)
        self._had = np.zeros_like(self._outside)
        self._numbers: dict[tuple[int, int], int] = {}
        self.hits: list[FirstExcursion] = []

    def advance(self) -> Checkpoint | None:
        """Fly to the next checkpoint; return None after the last one.

        The result holds scores (paths,), -inf for ended paths, and the excursions (paths, radii)
        since the previous checkpoint.
        """
        course = self._course
        if course.frame >= course.last:
            return None
        start_frame = course.frame
        course.fly(min(start_frame + self._step, course.last))
        # Paths that ended early get the score -inf and are never selected.
        ended = np.array([end.status != "ok" for end in course.ends])
        distance = self._distances(course.take_rows())
        events = np.zeros(self._outside.shape, dtype=np.int64)
        # Count excursions row by row with hysteresis, as the campaign's tables do.
        for row in range(distance.shape[1]):
            row_distance = distance[:, row, None]
            is_outside = row_distance > self._radii
            events += is_outside & ~self._outside
            self._note(
                is_outside & ~self._had, start_frame + (row + 1) * self._stride, distance[:, row]
            )
            # A path counts again only after it has come back inside radius - rearm.
            self._had |= is_outside
            self._outside = is_outside | (
                self._outside & ~(row_distance < self._radii - self._rearm)
            )
        # Rate of change of the distance from the last two rows.
        closing_mps = (distance[:, -1] - distance[:, -2]) / self._row_s
        score_inputs = {name: course.slot_values(name) for name in self._watch.score.properties}
        score = self._watch.score.of(score_inputs, distance[:, -1], closing_mps)
        return Checkpoint(np.where(ended, -np.inf, score), events, ended)

    def follow(self, parents: Sequence[int], levels: Sequence[int]) -> None:
        """Continue with the given paths in the given order.

        ``levels`` (paths,) is 0 for a path that continues unchanged, else the level at which it
        branches.
        """
        keys = [
            None if level == 0 else self._key(int(self._ids[parent]), level)
            for parent, level in zip(parents, levels, strict=True)
        ]
        self._course.follow(parents, keys)
        chosen = list(parents)
        # Bookkeeping follows the paths.
        self._ids, self._outside, self._had = (
            self._ids[chosen],
            self._outside[chosen],
            self._had[chosen],
        )

    def _key(self, aleatory_id: int, level: int) -> Branch:
        """Return the key of the next branch of a flight at a level."""
        # Branches of the same flight and level are numbered, so each has its own streams.
        number = self._numbers.get((aleatory_id, level), 0)
        self._numbers[aleatory_id, level] = number + 1
        return Branch(self._root, aleatory_id, level, number)

    def _distances(self, rows: Sequence[FloatArray]) -> FloatArray:
        """Return the distance (paths, rows) [m] without sign; NaN after the end of a path."""
        channel = np.full((len(rows), max(2, *(each.shape[1] for each in rows))), np.nan)
        for place, each in enumerate(rows):
            channel[place, : each.shape[1]] = each[self._channel]
        return np.abs(channel * self._factor)

    def _note(self, first: NDArray[np.bool_], frame: int, distance: FloatArray) -> None:
        """Record first excursions, at most ``max_noted`` per radius."""
        if not self._watch.max_noted:
            return
        for path, kind in np.argwhere(first):
            if sum(hit.kind == kind for hit in self.hits) < self._watch.max_noted:
                splits = self._course.splits[path]
                self.hits.append(
                    FirstExcursion(
                        int(self._ids[path]), int(kind), frame, float(distance[path]), splits
                    )
                )


# Score by linear predictions of the distance. A path with regressors x is expected at the distance
# m_h(x) after h seconds, with residual standard deviation s_h. Its score is the maximum of (m_h -
# radius) / s_h over the horizons. For a linear system in Gaussian noise minus half the square of
# the score is, to leading order, the logarithm of the probability of an excursion, so the score
# orders states by that probability, as a good importance function does (Garvels 2000, chapter 3).

HORIZONS_S = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0)
"""Prediction horizons [s]. After ten seconds the state of a loiter is forgotten and the prediction
is the mean distance at that place of the circle.
"""
CURRENT_SIGMA_M = 0.05
"""Standard deviation [m] assigned to the current distance, so that a path beyond the radius has a
score above 0.
"""
RIDGE = 1e-4
"""Ridge penalty as a share of each regressor's variance. It prevents large coefficients of opposite
sign for nearly collinear regressors.
"""


@dataclass(frozen=True)
class DistancePredictor:
    """Predictor of the distance from the commanded path at several horizons.

    Attributes
    ----------
    radius_m : float
        Radius of an excursion [m].
    horizons_s : tuple of float
        Horizons (h,) [s].
    coefficients : tuple of tuple of float
        Regression coefficients (h, k).
    constants : tuple of float
        Intercepts (h,) [m].
    sigmas : tuple of float
        Standard deviation of the regression residuals (h,) [m].
    """

    radius_m: float
    horizons_s: tuple[float, ...]
    coefficients: tuple[tuple[float, ...], ...]
    constants: tuple[float, ...]
    sigmas: tuple[float, ...]

    def score(self, regressors: FloatArray, distance_m: FloatArray) -> FloatArray:
        """Return the number of standard deviations to the radius, negative inside it.

        Parameters
        ----------
        regressors : array
            Regressors (..., k).
        distance_m : array
            Current distance (...) [m].

        Returns
        -------
        array
            Score (...): the largest over the horizons.
        """
        # Sum regressor by regressor: the rounding of a matrix product depends on the number of
        # paths.
        slopes, expected = (
            np.array(self.coefficients),
            np.zeros((*distance_m.shape, len(self.constants))) + self.constants,
        )
        for place in range(slopes.shape[1]):
            expected += regressors[..., place, None] * slopes[:, place]
        ahead = ((expected - self.radius_m) / np.array(self.sigmas)).max(axis=-1)
        return np.asarray(np.maximum(ahead, (distance_m - self.radius_m) / CURRENT_SIGMA_M))


def fit_predictors(
    regressors: FloatArray,
    distance_m: FloatArray,
    row_s: float,
    radius_m: float,
    horizons_s: Sequence[float] = HORIZONS_S,
) -> DistancePredictor:
    """Fit a predictor at each horizon by least squares with a small ridge penalty.

    Parameters
    ----------
    regressors : array
        States (flights, rows, k) of flights that are not split.
    distance_m : array
        Distance (flights, rows) [m].
    row_s : float
        Time between rows [s].
    radius_m : float
        Radius of an excursion [m].
    horizons_s : sequence of float
        Horizons [s]; those that are not a multiple of ``row_s`` are skipped.

    Raises
    ------
    ValueError
        If the flights are shorter than the last horizon, or no horizon is a multiple of ``row_s``.
    """
    rows_ahead = {
        h: round(h / row_s)
        for h in horizons_s
        if round(h / row_s) > 0 and abs(round(h / row_s) * row_s - h) < 1e-9
    }
    if not rows_ahead or max(rows_ahead.values()) >= distance_m.shape[1]:
        raise ValueError(
            f"{distance_m.shape[1]} rows {row_s:g} s apart: more than {max(horizons_s):g} s of rows"
            " are needed, and horizons that are whole numbers of them; received"
            f" {tuple(horizons_s)}"
        )
    coefficients, constants, sigmas = [], [], []
    # One regression per horizon: the regressors now, the distance ``rows`` later.
    for rows in rows_ahead.values():
        x = regressors[:, :-rows].reshape(-1, regressors.shape[2])
        y = distance_m[:, rows:].ravel()
        centre, standard_deviation = x.mean(axis=0), x.std(axis=0)
        scale = np.where(standard_deviation > 0.0, standard_deviation, 1.0)
        # Standardised regressors make the ridge penalty independent of units.
        z = (x - centre) / scale
        slopes = (
            np.linalg.solve(z.T @ z + RIDGE * len(z) * np.eye(z.shape[1]), z.T @ (y - y.mean()))
            / scale
        )
        # Back to the units of the regressors.
        constants.append(float(y.mean() - centre @ slopes))
        coefficients.append(tuple(map(float, slopes)))
        sigmas.append(float((y - x @ slopes - constants[-1]).std()))
    return DistancePredictor(
        radius_m, tuple(rows_ahead), tuple(coefficients), tuple(constants), tuple(sigmas)
    )
