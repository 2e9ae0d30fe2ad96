"""One corner in one air: flights that are split, flights that are not, and what came of them. No file is read or written here."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from campaigns.full_size.plan import Plan, cell_name, identity
from campaigns.rare_events.states import LoiterScore, Recorder, regressors
from uqharness.batch import ready
from uqharness.campaign.cases import Case, Part, build_cases
from uqharness.campaign.conditions import Condition
from uqharness.campaign.execution.worker import BATCH, fly_group
from uqharness.campaign.folder.manifest import digest_of_rows
from uqharness.campaign.rare_events import DISTANCE, Hit, LoiterPaths, Predicted, Watch, fit
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
"""Aleatory ids of replicates and of the pilot; plain flights begin at 0, so that no air is met twice."""
GRID = np.arange(-12.0, 0.001, 0.05)
"""Scores between which the pilot interpolates, in standard deviations to the radius."""
TOP = -0.5
"""No level lies above: half a standard deviation short of the radius one path in three goes on beyond it."""
SHARE = 0.004
"""Share of its time that a path spends above the first level. A branch costs as much as half a minute of plain flight, because
its air is made for it: few branches from many roots cost less than many from few."""


@dataclass(frozen=True)
class Size:
    """How much is flown in one piece: flights of a replicate, of the pilot (and their length [s]), and plain ones.

    A checkpoint is ``step_s`` from the next: 3 s jump over levels. Scores aim at the radius ``aim_m``, the largest at most. Of each
    replicate ``noted`` excursions beyond each radius are
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
class Tuned:
    """Levels and predictions that the pilot chose, the seconds of a core that it took, and the hours that it flew unsplit."""

    levels: Levels
    predicted: Predicted
    core_s: float = 0.0
    plain_h: float = 0.0


@dataclass(frozen=True)
class Counted:
    """What a piece found, by radius: ``probability`` of a first excursion per flight, ``events`` per flight, their mean square
    (plain flights alone, else NaN). ``path_s`` were flown between checkpoints by ``most`` paths side by side at most."""

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
        known = self.plan.epistemic_ids
        if self.corner not in known:
            raise BadInputError(
                f"--corner {self.corner}: not one of {known[0]} to {known[-1]} ({len(known)} corners)"
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
        return float(ready(self._one).lanes.dt_s)

    def cases(self, first: int, count: int) -> tuple[Case, ...]:
        """Flights of so many aleatory ids."""
        place = self.plan.epistemic_ids.index(self.corner)
        air = ((self.condition.wind_mps, self.condition.turbulence),)
        return build_cases(
            self.plan.spec,
            self.plan.mission,
            Part(range(first, first + count), air, range(place, place + 1)),
        )

    def replicate_cases(self, number: int) -> tuple[Case, ...]:
        """The flights with which a replicate begins."""
        return self.cases(FIRST_ROOT + number * self.size.roots, self.size.roots)

    def plain_cases(self, number: int) -> tuple[Case, ...]:
        """The flights of a piece that is not split."""
        return self.cases(number * self.size.plain, self.size.plain)

    def tuned_by(self, cases: Sequence[Case], tuned: Tuned) -> str:
        """One digest of what decides a replicate: its flights, levels and checkpoints."""
        return digest_of_rows(
            [identity(tuple(cases)), repr((tuned.levels, tuned.predicted, self.size.step_s))]
        )

    def tune(self) -> Tuned:
        """Predictions and first levels from flights that are not split; further ones from rounds with these. None is counted.

        Raises BadInputError where the rounds find no level up to TOP.
        """
        begun, size = time.process_time(), self.size
        recorder = Recorder()
        flown = self._pilot_paths(0, Watch(size.step_s, recorder))
        nothing = run(flown, size.pilot_roots, Levels(()), len(self.radii_m))
        distance = recorder.distances()
        states = regressors(recorder.values(), distance)
        predicted = fit(states, distance, size.step_s, min(size.aim_m, max(self.radii_m)))
        score = np.sort(predicted.score(states, distance).ravel())
        above = score.size - np.searchsorted(score, GRID)
        plain = Occupancy(GRID, above / score.size, above.astype(float))
        watch = Watch(size.step_s, LoiterScore(predicted))
        try:
            levels = pilot(
                lambda number: self._pilot_paths(1 + number, watch),
                size.pilot_roots,
                len(self.radii_m),
                GRID,
                TOP,
                share=size.share,
                plain=plain,
            )
        except ValueError as error:
            raise BadInputError(f"{self.name}: {error}") from error
        plain_h = nothing.steps * size.step_s / 3600.0
        return Tuned(levels, predicted, time.process_time() - begun, plain_h)

    def _pilot_paths(self, number: int, watch: Watch) -> LoiterPaths:
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

    def replicate(self, number: int, tuned: Tuned) -> tuple[Counted, list[Hit]]:
        """Fly one replicate: what it counted, and the excursions that are kept with their path."""
        begun, cases, size = time.process_time(), self.replicate_cases(number), self.size
        watch = Watch(size.step_s, LoiterScore(tuned.predicted), size.noted)
        paths = LoiterPaths(
            [case.flight for case in cases], [case.aleatory_id for case in cases], self._seed, watch
        )
        found = run(paths, size.roots, tuned.levels, len(self.radii_m))
        nothing = (float("nan"),) * len(self.radii_m)
        probability, events = (
            tuple(map(float, each)) for each in (found.probability, found.events)
        )
        core_s = time.process_time() - begun
        flown_s = found.steps * size.step_s
        return Counted(
            size.roots, probability, events, nothing, found.ended, flown_s, found.max_paths, core_s
        ), paths.hits

    def plain(self, number: int) -> Counted:
        """Fly one piece of flights that are not split. One that ends early counts one excursion at least, as in ``run``."""
        begun, cases = time.process_time(), self.plain_cases(number)
        flown = fly_group(BATCH, [case.flight for case in cases])
        counts = np.array(
            [[one.metrics[f"excursions_{radius:g}m"] for radius in self.radii_m] for one in flown]
        )
        failed = np.array([one.status != "ok" for one in flown])
        counts = np.maximum(np.nan_to_num(counts), failed[:, None])
        share, mean, square = (
            (counts > 0).mean(axis=0),
            counts.mean(axis=0),
            (counts**2).mean(axis=0),
        )
        found = (tuple(map(float, each)) for each in (share, mean, square))
        flown_s = 3600.0 * self.hours * len(cases)
        return Counted(
            len(cases),
            *found,
            float(failed.mean()),
            flown_s,
            len(cases),
            time.process_time() - begun,
        )

    def reflown(self, hit: Hit) -> tuple[float, int]:
        """The path of an excursion in JSBSim: its distance in that row [m], and rows beyond the radius by then (1: as here)."""
        case = self.cases(hit.aleatory_id, 1)[0]
        flight = replace(case.flight, duration_s=hit.frame * self.dt_s - case.flight.burn_in_s)
        mission = staged_mission(flight)
        flown = record_mission(
            mission, flight, scored_signals(mission), OPTIONAL_SIGNALS, splits=hit.splits
        )
        distance = np.abs(flown.signals[DISTANCE])
        return float(distance[-1]), int((distance > self.radii_m[hit.kind]).sum())


def chosen_hits(hits: Sequence[Hit], count: int) -> list[Hit]:
    """Excursions of branched paths to fly again: the farthest radius first, a root once before any comes a second time."""
    left = sorted(
        (hit for hit in hits if hit.splits), key=lambda hit: (-hit.kind, hit.aleatory_id, hit.frame)
    )
    chosen: list[Hit] = []
    while left and len(chosen) < count:
        used: set[int] = set()
        rest = []
        for hit in left:
            if hit.aleatory_id in used:
                rest.append(hit)
            else:
                used.add(hit.aleatory_id)
                chosen.append(hit)
        left = rest
    return chosen[:count]
