"""One corner in one air: flights that are split, flights that are not, and what came of them. No file is read or written here."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from campaigns.full_size.plan import Plan, cell_name, identity
from uqharness.batch import ready
from uqharness.campaign.cases import Case, Part, build_cases
from uqharness.campaign.conditions import Condition
from uqharness.campaign.execution.flying import BATCH, fly_group
from uqharness.campaign.folder.digests import digest_of_rows
from uqharness.campaign.rare.lookahead import best_lookahead
from uqharness.campaign.rare.paths import DISTANCE, Hit, LoiterPaths, Watch
from uqharness.errors import BadInputError
from uqharness.flight import OPTIONAL_SIGNALS, FlightSpec, record_mission, scored_signals, staged_mission
from uqharness.statistics import Levels, Occupancy, more_levels, run

FIRST_ROOT, FIRST_PILOT = 1_000_000, 2_000_000
"""Aleatory ids of replicates and of the pilot; plain flights begin at 0, so that no air is met twice."""
GRID_M = 0.1
"""Scores between which the pilot interpolates: a level is some ten of them above the last."""


@dataclass(frozen=True)
class Size:
    """How much is flown in one piece: flights of a replicate, of the pilot (split or plain, and their length [s]), and plain ones.

    A checkpoint is ``step_s`` from the next: 3 s jump over levels. Of each replicate ``noted`` excursions beyond each radius are
    kept with their path.
    """

    roots: int = 4
    pilot_roots: int = 4
    pilot_plain: int = 64
    pilot_s: float = 1800.0
    step_s: float = 1.0
    plain: int = 125
    noted: int = 3


@dataclass(frozen=True)
class Tuned:
    """Levels and lookahead [s] that the pilot chose, and the seconds of a core that it took."""

    levels: Levels
    lookahead_s: float
    core_s: float = 0.0


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
            raise BadInputError(f"--corner {self.corner}: not one of {known[0]} to {known[-1]} ({len(known)} corners)")

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
        return build_cases(self.plan.spec, self.plan.mission, Part(range(first, first + count), air, range(place, place + 1)))

    def replicate_cases(self, number: int) -> tuple[Case, ...]:
        """The flights with which a replicate begins."""
        return self.cases(FIRST_ROOT + number * self.size.roots, self.size.roots)

    def plain_cases(self, number: int) -> tuple[Case, ...]:
        """The flights of a piece that is not split."""
        return self.cases(number * self.size.plain, self.size.plain)

    def tuned_by(self, cases: Sequence[Case], tuned: Tuned) -> str:
        """One digest of what decides a replicate: its flights, levels and checkpoints."""
        return digest_of_rows([identity(tuple(cases)), repr((tuned.levels, tuned.lookahead_s, self.size.step_s))])

    def tune(self) -> Tuned:
        """Lookahead and first levels from flights that are not split; from one round with these, all levels. None is counted."""
        begun, size, radii = time.process_time(), self.size, self.radii_m
        flights = self._pilot_flights(0, size.pilot_plain)
        distance = np.abs([flown.signals[DISTANCE] for flown in fly_group(BATCH, flights)])
        row_s = 1.0 / flights[0].record_rate_hz
        lookahead_s = best_lookahead(distance, row_s)
        score = (distance[:, 1:] + lookahead_s * np.diff(distance, axis=1) / row_s)[:, :: round(size.step_s / row_s)]
        grid = np.arange(0.0, max(radii) + 2.0 * GRID_M, GRID_M)
        above = score[:, :, None] >= grid
        levels = levels_to(Occupancy(grid, above.mean(axis=(0, 1)), above.sum(axis=(0, 1))), max(radii))
        flights = self._pilot_flights(size.pilot_plain, size.pilot_roots)
        ids = range(FIRST_PILOT + size.pilot_plain, FIRST_PILOT + size.pilot_plain + size.pilot_roots)
        paths = LoiterPaths(flights, ids, self._seed, Watch(size.step_s, lookahead_s))
        seen = run(paths, size.pilot_roots, levels, len(radii), grid).occupancy
        return Tuned(levels_to(seen, max(radii)), lookahead_s, time.process_time() - begun)

    def _pilot_flights(self, first: int, count: int) -> list[FlightSpec]:
        cases = self.cases(FIRST_PILOT + first, count)
        return [replace(case.flight, duration_s=min(self.size.pilot_s, case.flight.duration_s)) for case in cases]

    @property
    def _seed(self) -> int:
        return int(self.plan.spec.campaign.seed)

    def replicate(self, number: int, tuned: Tuned) -> tuple[Counted, list[Hit]]:
        """Fly one replicate: what it counted, and the excursions that are kept with their path."""
        begun, cases, size = time.process_time(), self.replicate_cases(number), self.size
        watch = Watch(size.step_s, tuned.lookahead_s, size.noted)
        paths = LoiterPaths([case.flight for case in cases], [case.aleatory_id for case in cases], self._seed, watch)
        found = run(paths, size.roots, tuned.levels, len(self.radii_m))
        nothing = (float("nan"),) * len(self.radii_m)
        probability, events = (tuple(map(float, each)) for each in (found.probability, found.events))
        core_s = time.process_time() - begun
        flown_s = found.steps * size.step_s
        return Counted(size.roots, probability, events, nothing, found.ended, flown_s, found.most, core_s), paths.hits

    def plain(self, number: int) -> Counted:
        """Fly one piece of flights that are not split. One that ends early counts one excursion at least, as in ``run``."""
        begun, cases = time.process_time(), self.plain_cases(number)
        flown = fly_group(BATCH, [case.flight for case in cases])
        counts = np.array([[one.metrics[f"excursions_{radius:g}m"] for radius in self.radii_m] for one in flown])
        failed = np.array([one.status != "ok" for one in flown])
        counts = np.maximum(np.nan_to_num(counts), failed[:, None])
        share, mean, square = ((counts > 0).mean(axis=0), counts.mean(axis=0), (counts**2).mean(axis=0))
        found = (tuple(map(float, each)) for each in (share, mean, square))
        flown_s = 3600.0 * self.hours * len(cases)
        return Counted(len(cases), *found, float(failed.mean()), flown_s, len(cases), time.process_time() - begun)

    def reflown(self, hit: Hit) -> tuple[float, int]:
        """The path of an excursion in JSBSim: its distance in that row [m], and rows beyond the radius by then (1: as here)."""
        case = self.cases(hit.aleatory_id, 1)[0]
        flight = replace(case.flight, duration_s=hit.frame * self.dt_s - case.flight.burn_in_s)
        mission = staged_mission(flight)
        flown = record_mission(mission, flight, scored_signals(mission), OPTIONAL_SIGNALS, splits=hit.splits)
        distance = np.abs(flown.signals[DISTANCE])
        return float(distance[-1]), int((distance > self.radii_m[hit.kind]).sum())


def levels_to(occupancy: Occupancy, top: float) -> Levels:
    """Levels of an occupancy as far as enough was seen, then as far apart as the last two, up to ``top``.

    Levels too far apart or too close cost paths, and leave the mean of an estimate as it is. Raises BadInputError for less than
    two levels.
    """
    found, _ = more_levels(occupancy, Levels(()), top)
    scores = list(found.scores)
    if len(scores) < 2:
        raise BadInputError(f"the pilot found {len(scores)} levels below {top:g} m: fly more or longer flights in it")
    while 2.0 * scores[-1] - scores[-2] <= top:
        scores.append(2.0 * scores[-1] - scores[-2])
    return Levels(tuple(scores))


def chosen_hits(hits: Sequence[Hit], count: int) -> list[Hit]:
    """Excursions of branched paths to fly again: the farthest radius first, a root once before any comes a second time."""
    left = sorted((hit for hit in hits if hit.splits), key=lambda hit: (-hit.kind, hit.aleatory_id, hit.frame))
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
