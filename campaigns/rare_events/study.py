"""One corner in one air: flights with and without splitting, and their counts. No file is read or
written here."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from campaigns.library.plan import Plan, cell_name, identity
from campaigns.rare_events.states import LoiterScore, Recorder, regressors
from uqharness.batch import compiled_mission
from uqharness.campaign.cases import Case, Part, build_cases
from uqharness.campaign.conditions import Condition
from uqharness.campaign.manifest import digest_of_rows
from uqharness.campaign.rare_events import (
    DISTANCE,
    CheckpointPlan,
    DistancePredictor,
    FirstExcursion,
    LoiterPaths,
    fit_predictors,
)
from uqharness.campaign.worker import BATCH, fly_group
from uqharness.errors import BadInputError
from uqharness.flight import (
    OPTIONAL_SIGNALS,
    FlightSpec,
    record_mission,
    scored_signals,
    staged_mission,
)
from uqharness.statistics import Levels, Occupancy, pilot, run

FIRST_ROOT, FIRST_PILOT = 1_000_000, 2_000_000
"""Aleatory ids of replicates and of the pilot; plain flights begin at 0, so that no air is met
twice."""
GRID = np.arange(-12.0, 0.001, 0.05)
"""Scores between which the pilot interpolates, in standard deviations to the radius."""
TOP = -0.5
"""No level lies above: half a standard deviation short of the radius one path in three goes on
beyond it."""
SHARE = 0.004
"""Share of its time that a path spends above the first level. A branch costs as much as half a
minute of plain flight, because its air is made for it: few branches from many roots cost less than
many from few."""


@dataclass(frozen=True)
class Size:
    """Flights of one piece: of a replicate, of the pilot (and their length [s]), and plain ones.

    A checkpoint is ``step_s`` from the next: 3 s jump over levels. Scores aim at the radius
    ``aim_m``, the largest at most. Of each replicate ``noted`` excursions beyond each radius are
    kept with their path.
    """

    roots: int = 64
    pilot_roots: int = 64
    pilot_s: float = 3600.0
    step_s: float = 1.0
    plain: int = 125
    noted: int = 3
    share: float = SHARE
    aim_m: float = math.inf


@dataclass(frozen=True)
class Tuning:
    """Levels and predictions that the pilot chose, the seconds of a core that it took, and the
    hours that it flew unsplit."""

    levels: Levels
    predicted: DistancePredictor
    core_s: float = 0.0
    plain_h: float = 0.0


@dataclass(frozen=True)
class Counts:
    """The result of a piece, by radius: ``probability`` of a first excursion per flight, ``events``
    per flight, their mean square (plain flights alone, else NaN). ``path_s`` were flown between
    checkpoints by ``most`` paths side by side at most."""

    flights: int
    probability: tuple[float, ...]
    events: tuple[float, ...]
    squares: tuple[float, ...]
    ended: float
    path_s: float
    most: int
    core_s: float


@dataclass(frozen=True)
class Study:
    """A corner of a campaign in one of its airs."""

    plan: Plan
    condition: Condition
    corner: str
    size: Size = Size()

    def __post_init__(self) -> None:
        """Raises BadInputError for a corner that the campaign lacks."""
        corners = self.plan.epistemic_ids
        if self.corner not in corners:
            raise BadInputError(
                f"--corner {self.corner}: not one of {corners[0]} to {corners[-1]} "
                f"({len(corners)} corners)"
            )

    @property
    def name(self) -> str:
        """Its folder: ``moderate-4-100100``."""
        return f"{cell_name(self.condition)}-{self.corner}"

    @property
    def radii_m(self) -> tuple[float, ...]:
        """Radii at which excursions are counted."""
        return tuple(float(radius) for radius in self._one.excursion_radius_m)

    @property
    def hours(self) -> float:
        """Scored hours of a flight."""
        return self._one.duration_s / 3600.0

    @cached_property
    def _one(self) -> FlightSpec:
        return self.cases(0, 1)[0].flight

    @cached_property
    def dt_s(self) -> float:
        """A frame of the flights."""
        return float(compiled_mission(self._one).lanes.dt_s)

    def cases(self, first: int, count: int) -> tuple[Case, ...]:
        """Build the flights of so many aleatory ids."""
        place = self.plan.epistemic_ids.index(self.corner)
        air = ((self.condition.wind_mps, self.condition.turbulence),)
        return build_cases(
            self.plan.spec,
            self.plan.mission,
            Part(range(first, first + count), air, range(place, place + 1)),
        )

    def replicate_cases(self, number: int) -> tuple[Case, ...]:
        """Build the flights with which a replicate begins."""
        return self.cases(FIRST_ROOT + number * self.size.roots, self.size.roots)

    def plain_cases(self, number: int) -> tuple[Case, ...]:
        """Build the flights of a piece that is not split."""
        return self.cases(number * self.size.plain, self.size.plain)

    def tuned_identity(self, cases: Sequence[Case], tuning: Tuning) -> str:
        """Digest what decides a replicate: its flights, levels and checkpoints."""
        settings = repr((tuning.levels, tuning.predicted, self.size.step_s))
        return digest_of_rows([identity(tuple(cases)), settings])

    def tune(self) -> Tuning:
        """Fit predictions and first levels to flights that are not split; further ones from rounds
        with these. None is counted.

        Raises BadInputError where the rounds find no level up to TOP.
        """
        started, size, kinds = time.process_time(), self.size, len(self.radii_m)
        recorder = Recorder()
        paths = self._pilot_paths(0, CheckpointPlan(size.step_s, recorder))
        unsplit = run(paths, size.pilot_roots, Levels(()), kinds)
        distance = recorder.distances()
        states = regressors(recorder.values(), distance)
        predicted = fit_predictors(
            states, distance, size.step_s, min(size.aim_m, max(self.radii_m))
        )
        score = np.sort(predicted.score(states, distance).ravel())
        above = score.size - np.searchsorted(score, GRID)
        plain = Occupancy(GRID, above / score.size, above.astype(float))
        watch = CheckpointPlan(size.step_s, LoiterScore(predicted))
        try:
            start = lambda number: self._pilot_paths(1 + number, watch)  # noqa: E731
            levels = pilot(start, size.pilot_roots, kinds, GRID, TOP, share=size.share, plain=plain)
        except ValueError as error:
            raise BadInputError(f"{self.name}: {error}") from error
        plain_h = unsplit.steps * size.step_s / 3600.0
        return Tuning(levels, predicted, time.process_time() - started, plain_h)

    def _pilot_paths(self, number: int, watch: CheckpointPlan) -> LoiterPaths:
        count = self.size.pilot_roots
        cases = self.cases(FIRST_PILOT + number * count, count)
        flights = [
            replace(case.flight, duration_s=min(self.size.pilot_s, case.flight.duration_s))
            for case in cases
        ]
        return LoiterPaths(flights, [case.aleatory_id for case in cases], self._seed, watch)

    @property
    def _seed(self) -> int:
        return int(self.plan.spec.campaign.seed)

    def replicate(self, number: int, tuning: Tuning) -> tuple[Counts, list[FirstExcursion]]:
        """Fly one replicate and return its counts, and the excursions that are kept with their
        path."""
        started, cases, size = time.process_time(), self.replicate_cases(number), self.size
        watch = CheckpointPlan(size.step_s, LoiterScore(tuning.predicted), size.noted)
        flights, ids = [case.flight for case in cases], [case.aleatory_id for case in cases]
        paths = LoiterPaths(flights, ids, self._seed, watch)
        result = run(paths, size.roots, tuning.levels, len(self.radii_m))
        by_radius = (result.probability, result.events, [math.nan] * len(self.radii_m))
        probability, events, squares = (tuple(map(float, each)) for each in by_radius)
        path_s, core_s = result.steps * size.step_s, time.process_time() - started
        counts = (size.roots, probability, events, squares, result.ended, path_s, result.max_paths)
        return Counts(*counts, core_s), paths.hits

    def plain(self, number: int) -> Counts:
        """Fly one piece of flights that are not split. One that ends early counts one excursion at
        least, as in ``run``."""
        started, cases = time.process_time(), self.plain_cases(number)
        results = fly_group(BATCH, [case.flight for case in cases])
        names = [f"excursions_{radius:g}m" for radius in self.radii_m]
        counts = np.array([[one.metrics[name] for name in names] for one in results])
        failed = np.array([one.status != "ok" for one in results])
        counts = np.maximum(np.nan_to_num(counts), failed[:, None])
        means = (np.mean(each, axis=0) for each in (counts > 0, counts, counts**2))
        by_radius = (tuple(map(float, each)) for each in means)
        cost = (3600.0 * self.hours * len(cases), len(cases), time.process_time() - started)
        return Counts(len(cases), *by_radius, float(failed.mean()), *cost)

    def reflown(self, hit: FirstExcursion) -> tuple[float, int]:
        """Fly the path of an excursion in JSBSim.

        Returns its distance in the excursion's row [m], and how many rows lie beyond the radius by
        then (1: as here).
        """
        case = self.cases(hit.aleatory_id, 1)[0]
        flight = replace(case.flight, duration_s=hit.frame * self.dt_s - case.flight.burn_in_s)
        mission = staged_mission(flight)
        signals = scored_signals(mission)
        record = record_mission(mission, flight, signals, OPTIONAL_SIGNALS, splits=hit.splits)
        distance = np.abs(record.signals[DISTANCE])
        return float(distance[-1]), int((distance > self.radii_m[hit.kind]).sum())


def chosen_hits(hits: Sequence[FirstExcursion], count: int) -> list[FirstExcursion]:
    """Choose excursions of branched paths to fly again: the farthest radius first, a root once
    before any a second time."""
    order = sorted((h for h in hits if h.splits), key=lambda h: (-h.kind, h.aleatory_id, h.frame))
    turn: Counter[int] = Counter()
    turns = []
    for hit in order:
        turns.append(turn[hit.aleatory_id])
        turn[hit.aleatory_id] += 1
    ranked = sorted(zip(turns, range(len(order)), strict=True))
    return [order[place] for _, place in ranked[:count]]
