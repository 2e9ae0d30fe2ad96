"""One corner in one air: flights with and without splitting, and what they counted.

A path's score is the number of standard deviations by which the predicted distance from the circle
falls short of the radius aimed at; ``NAMES`` are the regressors of the prediction.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from campaigns.library.flights import cases_of
from sysid.arrays import FloatArray
from sysid.units import FT_M
from uqharness.batch import compiled_mission
from uqharness.campaign.cases import Case
from uqharness.campaign.manifest import digest_of_rows
from uqharness.campaign.processes import BATCH, fly_group
from uqharness.campaign.rare_events import (
    DISTANCE,
    CheckpointPlan,
    DistancePredictor,
    FirstExcursion,
    LoiterPaths,
    fit_predictors,
)
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.sampling import epistemic_samples
from uqharness.errors import BadInputError
from uqharness.flight import (
    OPTIONAL_SIGNALS,
    FlightSpec,
    record_mission,
    scored_signals,
    staged_mission,
)
from uqharness.statistics import Levels, Occupancy, pilot, run

_PLAIN = {
    "airspeed": "nav/V-mps",
    "height": "nav/altitude-m",
    "bank": "attitude/phi-rad",
    "pitch": "attitude/theta-rad",
    "roll rate": "velocities/p-rad_sec",
    "pitch rate": "velocities/q-rad_sec",
    "sink": "velocities/v-down-fps",
    "gust down": "atmosphere/total-wind-down-fps",
    "bank demanded": "ap/nav-roll-rad",
    "pitch demanded": "ap/nav-pitch-rad",
    "roll integral": "ap/roll-integral-rad",
    "throttle": "ap/throttle-cmd-pct",
    "throttle integral": "ap/TECS-throttle-integral",
}
_VECTORS = {
    "ground speed": ("velocities/v-north-fps", "velocities/v-east-fps"),
    "wind": ("atmosphere/total-wind-north-fps", "atmosphere/total-wind-east-fps"),
}
_PLACE = ("nav/north-m", "nav/east-m")
PROPERTIES = (*_PLAIN.values(), *(name for pair in _VECTORS.values() for name in pair), *_PLACE)
_EACH = ("distance", *_PLAIN, *(f"{n} {way}" for n in _VECTORS for way in ("outward", "along")))
_FACTORS = ("", " x sine", " x cosine")
NAMES = tuple(f"{name}{factor}" for factor in _FACTORS for name in ("one", *_EACH))[1:]
"""The regressors: each state, and its products with sine and cosine of the place on the circle: the
wind has a direction."""
CENTRE_EAST_M = 120.0
"""The circle's centre lies so far east of the start (scripts/loiter.xml); a score may be off, an
estimate is not."""
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


def regressors(values: Mapping[str, FloatArray], distance_m: FloatArray) -> FloatArray:
    """Return (..., len(NAMES)) of PROPERTIES (...) and the distance from the circle (...) [m]; SI
    units and radians."""
    north, east = values[_PLACE[0]], values[_PLACE[1]] - CENTRE_EAST_M
    offset = np.maximum(np.sqrt(north * north + east * east), 1e-6)
    sine, cosine = east / offset, north / offset
    states = [np.ones_like(distance_m), distance_m]
    states += [values[n] * (FT_M if n.endswith("-fps") else 1.0) for n in _PLAIN.values()]
    for to_north, to_east in _VECTORS.values():
        n, e = values[to_north] * FT_M, values[to_east] * FT_M
        states += [n * cosine + e * sine, e * cosine - n * sine]
    each = np.stack(states, axis=-1)
    turned = (each * sine[..., None], each * cosine[..., None])
    return np.concatenate([each[..., 1:], *turned], axis=-1)


@dataclass(frozen=True)
class LoiterScore:
    """Standard deviations to the radius of ``predicted``, whose regressors are NAMES."""

    predicted: DistancePredictor
    properties: tuple[str, ...] = PROPERTIES

    def of(
        self, values: Mapping[str, FloatArray], distance_m: FloatArray, closing_mps: FloatArray
    ) -> FloatArray:
        """Return (paths,) [-]: 0 at the radius, negative inside it."""
        return self.predicted.score(regressors(values, distance_m), distance_m)


@dataclass
class Recorder:
    """A score that records the states it is called with, for ``fit``; paths must not be split."""

    properties: tuple[str, ...] = PROPERTIES
    _states: list[Mapping[str, FloatArray]] = field(default_factory=list)
    _distances: list[FloatArray] = field(default_factory=list)

    def of(
        self, values: Mapping[str, FloatArray], distance_m: FloatArray, closing_mps: FloatArray
    ) -> FloatArray:
        """Return (paths,) [m]: the distance."""
        self._states.append(values)
        self._distances.append(distance_m)
        return distance_m

    def completed(self) -> tuple[dict[str, FloatArray], FloatArray]:
        """Return properties and distances (paths, checkpoints) of the flights that were
        completed."""
        distances = np.stack(self._distances, axis=1)
        complete: NDArray[np.bool_] = np.isfinite(distances).all(axis=1)
        states = {n: np.stack([each[n] for each in self._states], axis=1) for n in self.properties}
        return {n: values[complete] for n, values in states.items()}, distances[complete]


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
class Study:
    """A corner of a campaign file in one of its cells of air."""

    campaign: Path
    cell: str
    corner: str
    size: Size = Size()

    def __post_init__(self) -> None:
        """Raises BadInputError for a corner that the campaign lacks."""
        if self.corner not in self._corners:
            raise BadInputError(
                f"--corner {self.corner}: not one of {self._corners[0]} to {self._corners[-1]} "
                f"({len(self._corners)} corners)"
            )

    @cached_property
    def _corners(self) -> list[str]:
        return [sample.epistemic_id for sample in epistemic_samples(read_campaign(self.campaign))]

    @property
    def name(self) -> str:
        """Its folder: ``moderate-4-100100``."""
        return f"{self.cell}-{self.corner}"

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
        """Build the flights of so many aleatory ids. Raises BadInputError for a cell that the
        campaign lacks."""
        place = self._corners.index(self.corner)
        airs, samples = range(first, first + count), range(place, place + 1)
        return cases_of(self.campaign, self.cell, airs, samples)

    def replicate_cases(self, number: int) -> tuple[Case, ...]:
        """Build the flights with which a replicate begins."""
        return self.cases(FIRST_ROOT + number * self.size.roots, self.size.roots)

    def plain_cases(self, number: int) -> tuple[Case, ...]:
        """Build the flights of a piece that is not split."""
        return self.cases(number * self.size.plain, self.size.plain)

    def identity(self, cases: Sequence[Case], tuning: Tuning | None = None) -> str:
        """Digest what decides a piece: its flights, and of a replicate levels and checkpoints."""
        flights = digest_of_rows(case.case_id for case in cases)
        if tuning is None:
            return flights
        return digest_of_rows([flights, repr((tuning.levels, tuning.predicted, self.size.step_s))])

    def paths(
        self, cases: Sequence[Case], watch: CheckpointPlan, duration_s: float = math.inf
    ) -> LoiterPaths:
        """Return the paths of flights, each ``duration_s`` long at most."""
        flights = [
            replace(case.flight, duration_s=min(duration_s, case.flight.duration_s))
            for case in cases
        ]
        seed = int(read_campaign(self.campaign).campaign.seed)
        return LoiterPaths(flights, [case.aleatory_id for case in cases], seed, watch)

    def tune(self) -> Tuning:
        """Fit predictions and first levels to flights that are not split; further ones from rounds
        with these. None is counted.

        Raises BadInputError where the rounds find no level up to TOP.
        """
        initial, size, kinds = time.process_time(), self.size, len(self.radii_m)

        def start(number: int, score: LoiterScore | Recorder) -> LoiterPaths:
            cases = self.cases(FIRST_PILOT + number * size.pilot_roots, size.pilot_roots)
            return self.paths(cases, CheckpointPlan(size.step_s, score), size.pilot_s)

        recorder = Recorder()
        unsplit = run(start(0, recorder), size.pilot_roots, Levels(()), kinds)
        values, distance = recorder.completed()
        states, aim_m = regressors(values, distance), min(size.aim_m, max(self.radii_m))
        predicted = fit_predictors(states, distance, size.step_s, aim_m)
        score = np.sort(predicted.score(states, distance).ravel())
        above = score.size - np.searchsorted(score, GRID)
        plain = Occupancy(GRID, above / score.size, above.astype(float))
        try:
            levels = pilot(
                lambda number: start(1 + number, LoiterScore(predicted)),
                *(size.pilot_roots, kinds, GRID, TOP),
                share=size.share,
                plain=plain,
            )
        except ValueError as error:
            raise BadInputError(f"{self.name}: {error}") from error
        plain_h = unsplit.steps * size.step_s / 3600.0
        return Tuning(levels, predicted, time.process_time() - initial, plain_h)

    def replicate(self, number: int, tuning: Tuning) -> tuple[dict[str, Any], list[FirstExcursion]]:
        """Fly one replicate and return its row of replicates.csv, and the excursions that are kept
        with their path."""
        start, cases, size = time.process_time(), self.replicate_cases(number), self.size
        watch = CheckpointPlan(size.step_s, LoiterScore(tuning.predicted), size.noted)
        paths = self.paths(cases, watch)
        result = run(paths, size.roots, tuning.levels, len(self.radii_m))
        row = {"number": number, "flights": size.roots}
        row |= self._by_radius("probability", result.probability)
        row |= self._by_radius("events", result.events)
        row |= self._by_radius("squares", [math.nan] * len(self.radii_m))
        row |= {"ended": result.ended, "path_s": result.steps * size.step_s}
        row |= {"most": result.max_paths, "core_s": time.process_time() - start}
        return row | {"flights_id": self.identity(cases, tuning)}, paths.hits

    def plain(self, number: int) -> dict[str, Any]:
        """Fly one piece of flights that are not split and return its row of plain.csv. One that
        ends early counts one excursion at least, as in ``run``."""
        start, cases = time.process_time(), self.plain_cases(number)
        results = fly_group(BATCH, [case.flight for case in cases])
        names = [f"excursions_{radius:g}m" for radius in self.radii_m]
        counts = np.array([[one.metrics[name] for name in names] for one in results])
        failed = np.array([one.status != "ok" for one in results])
        counts = np.maximum(np.nan_to_num(counts), failed[:, None])
        row: dict[str, Any] = {"number": number, "flights": len(cases)}
        for name, values in (
            ("probability", counts > 0),
            ("events", counts),
            ("squares", counts**2),
        ):
            row |= self._by_radius(name, np.mean(values, axis=0))
        row |= {"ended": float(failed.mean()), "path_s": 3600.0 * self.hours * len(cases)}
        row |= {"most": len(cases), "core_s": time.process_time() - start}
        return row | {"flights_id": self.identity(cases)}

    def _by_radius(self, name: str, values: Any) -> dict[str, float]:
        return {f"{name}_{r:g}m": float(v) for r, v in zip(self.radii_m, values, strict=True)}

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
