"""Fly cases in a worker process and return what a campaign keeps of them.

The module is imported by every worker that starts, so it imports little; the simulators are
imported when the first flight needs them.
"""

from __future__ import annotations

import faulthandler
import math
import signal
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from typing import Protocol

import numpy as np

from uqharness.errors import BadInputError
from uqharness.flight import STATUSES, FlightResult, FlightSpec
from uqharness.parallel import end_with_parent

FlightFunction = Callable[[FlightSpec], FlightResult]
GroupFunction = Callable[[str, Sequence[FlightSpec]], Sequence[FlightResult]]
"""Function that flies flights in the engine of a given name; results in the order of the flights.
"""


@dataclass(frozen=True)
class Group:
    """Hold cases (id, flight) that one worker flies together in the engine of that name."""

    engine: str
    cases: tuple[tuple[str, FlightSpec], ...]

    def parts(self, number: int) -> list[Group]:
        """Split into at most ``number`` groups of nearly equal size, in the same order."""
        share = -(-len(self.cases) // number)
        return [
            Group(self.engine, self.cases[first : first + share])
            for first in range(0, len(self.cases), share)
        ]


@dataclass(frozen=True)
class OneByOne:
    """Wrap a flight function as a group function that flies one flight after the other."""

    fly: FlightFunction

    def __call__(self, engine: str, flights: Sequence[FlightSpec]) -> list[FlightResult]:
        """Fly the flights; the name of the engine is ignored."""
        return [self.fly(flight) for flight in flights]


@dataclass(frozen=True)
class CaseOutcome:
    """Hold what a campaign keeps of one flight: the result without its signals.

    Attributes
    ----------
    case_id, status, reason : str
        Case, status (ok, crashed, ...) and the reason of an early end.
    flown_s : float
        Simulated time [s].
    metrics : mapping of str to float
        Metrics by name, NaN if undefined.
    undefined : mapping of str to str
        Why a metric is undefined.
    bad_input : bool
        Whether the flight was refused as input.
    """

    case_id: str
    status: str
    reason: str
    flown_s: float
    metrics: Mapping[str, float] = field(default_factory=dict)
    undefined: Mapping[str, str] = field(default_factory=dict)
    bad_input: bool = False


def attempt(fly: FlightFunction, case_id: str, flight: FlightSpec) -> CaseOutcome:
    """Fly one case; an exception becomes a crashed outcome with its message."""
    return attempt_group(OneByOne(fly), Group("", ((case_id, flight),)))[0]


def attempt_group(fly: GroupFunction, group: Group) -> list[CaseOutcome]:
    """Fly a group; if it raises, fly its halves until the failing case is alone and counts as
    crashed.
    """
    try:
        results = fly(group.engine, [flight for _, flight in group.cases])
        return [
            _outcome(case_id, result)
            for (case_id, _), result in zip(group.cases, results, strict=True)
        ]
    except Exception as error:
        # Bisect the group to find the failing case.
        if len(group.cases) > 1:
            return [outcome for part in group.parts(2) for outcome in attempt_group(fly, part)]
        ((case_id, _),) = group.cases
        if isinstance(error, BadInputError):
            return [CaseOutcome(case_id, "crashed", _one_line(str(error)), 0.0, bad_input=True)]
        return [CaseOutcome(case_id, "crashed", _one_line(f"{type(error).__name__}: {error}"), 0.0)]


def _outcome(case_id: str, result: FlightResult) -> CaseOutcome:
    """Return the outcome of a result. Raises ValueError for an unknown status."""
    if result.status not in STATUSES:
        raise ValueError(
            f"the flight function returned status '{result.status}', not one of"
            f" {', '.join(STATUSES)}"
        )
    return CaseOutcome(
        case_id,
        result.status,
        result.reason,
        float(result.flown_s),
        # Text carries one NaN, so that tables have the same bytes wherever a case was flown.
        {
            name: math.nan if math.isnan(value) else float(value)
            for name, value in result.metrics.items()
        },
        dict(result.undefined),
    )


def _one_line(text: str) -> str:
    """Return text with all white space collapsed."""
    return " ".join(text.split())


def work(pipe: Connection, fly: GroupFunction) -> None:
    """Run a worker: receive groups, fly them and send outcomes until None arrives or the parent
    ends.
    """
    # Ctrl-C reaches the whole group; the parent decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    # Python's own crash report would be noise: the parent records the signal.
    if faulthandler.is_enabled():
        faulthandler.disable()
    try:
        pipe.send(None)
        while (group := pipe.recv()) is not None:
            pipe.send(attempt_group(fly, group))
    except (EOFError, OSError):
        return


# Engines: JSBSim flies one flight after the other, the batch engine many at once.

BATCH, JSBSIM = "batch", "jsbsim"
JUDGE, ONE_ULP_OFF = "jsbsim as judge", "jsbsim one ulp off"
"""Engine names of comparison flights: JSBSim with distances to each radius, and JSBSim from a start
moved by one unit in the last place.
"""
NEAREST = "nearest_"
"""Prefix of the metric that holds the smallest distance to a radius at which a count changes [m].
"""


class Batch(Protocol):
    """Report what the batch engine can fly."""

    def available(self) -> str | None:
        """Return None if it can fly on this machine, else the reason."""
        ...

    def refusals(self, spec: FlightSpec, varying: Collection[str]) -> tuple[str, ...]:
        """Return what it does not understand, with file and line.

        ``varying`` names the properties that differ between cases.
        """
        ...

    def left_out(self, spec: FlightSpec, varying: Collection[str]) -> tuple[str, ...]:
        """Return what it does not understand and leaves out, because nothing in the flight reads
        it.
        """
        ...


class LocalBatch:
    """Report what the batch engine of this program can fly."""

    def available(self) -> str | None:
        """Return None if it can fly on this machine, else the reason."""
        return unavailable_reason(BATCH)

    def refusals(self, spec: FlightSpec, varying: Collection[str]) -> tuple[str, ...]:
        """Return what it does not understand, see `Batch`."""
        from uqharness.batch import refusals

        return refusals(spec, varying)

    def left_out(self, spec: FlightSpec, varying: Collection[str]) -> tuple[str, ...]:
        """Return what it leaves out, see `Batch`."""
        from uqharness.batch import left_out_elements

        return left_out_elements(spec, varying)


def unavailable_reason(engine: str) -> str | None:
    """Return None if this machine can fly in the engine of that name, else the reason."""
    # Imported here, as below: a worker of JSBSim needs no compiler, one of the batch engine no
    # JSBSim.
    from uqharness.batch import available

    return available() if engine == BATCH else None


def fly_group(engine: str, flights: Sequence[FlightSpec]) -> Sequence[FlightResult]:
    """Fly flights in the engine of that name; results in the order of the flights."""
    if engine == BATCH:
        from uqharness.batch import fly_many

        return fly_many(flights)
    from uqharness.flight import fly_one_ulp_off
    from uqharness.flight.fly import fly

    if engine == ONE_ULP_OFF:
        return [fly_one_ulp_off(flight) for flight in flights]
    return [
        with_distances(fly(flight), flight) if engine == JUDGE else fly(flight)
        for flight in flights
    ]


def with_distances(result: FlightResult, flight: FlightSpec) -> FlightResult:
    """Add to the result, for each excursion count, the smallest distance to a radius or re-arm
    limit [m].
    """
    distances: dict[str, float] = {}
    for radius in flight.excursion_radius_m:
        for distance_name, suffix in (("cross_track", ""), ("distance_3d", "_3d")):
            distance = np.abs(result.signals.get(distance_name, np.zeros(0)))
            # Distance of the record to the radius and to the re-arm limit.
            gaps = [
                np.min(np.abs(distance - limit))
                for limit in (radius, radius - flight.rearm_m)
                if distance.size
            ]
            distances[f"{NEAREST}excursions_{radius:g}m{suffix}"] = float(min(gaps, default=np.nan))
    return replace(result, metrics={**result.metrics, **distances})
