"""A campaign's worker: takes cases, flies them, sends what is kept of them.

Imports little, for it starts often.
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
"""Flies flights in the engine of that name; results in the order given."""


@dataclass(frozen=True)
class Group:
    """Cases (id, flight) that one worker flies together in the engine of that name."""

    engine: str
    cases: tuple[tuple[str, FlightSpec], ...]

    def parts(self, number: int) -> list[Group]:
        """At most that many groups of the same cases in the same order, sizes as even as can be."""
        share = -(-len(self.cases) // number)
        return [
            Group(self.engine, self.cases[first : first + share])
            for first in range(0, len(self.cases), share)
        ]


@dataclass(frozen=True)
class OneByOne:
    """A flight function as a group function: one flight after the other, whatever the engine is
    called.
    """

    fly: FlightFunction

    def __call__(self, engine: str, flights: Sequence[FlightSpec]) -> list[FlightResult]:
        """Fly them."""
        return [self.fly(flight) for flight in flights]


@dataclass(frozen=True)
class CaseOutcome:
    """What is kept of one flight: its result without the signals.

    ``bad_input``: refused as input, not flown.
    """

    case_id: str
    status: str
    reason: str
    flown_s: float
    metrics: Mapping[str, float] = field(default_factory=dict)
    undefined: Mapping[str, str] = field(default_factory=dict)
    bad_input: bool = False


def attempt(fly: FlightFunction, case_id: str, flight: FlightSpec) -> CaseOutcome:
    """Fly one case; whatever it raises becomes a crashed outcome with its reason."""
    return attempt_group(OneByOne(fly), Group("", ((case_id, flight),)))[0]


def attempt_group(fly: GroupFunction, group: Group) -> list[CaseOutcome]:
    """Fly a group; of a case that raises, flown by itself, that becomes a crashed outcome with its
    reason.
    """
    try:
        results = fly(group.engine, [flight for _, flight in group.cases])
        return [
            _outcome(case_id, result)
            for (case_id, _), result in zip(group.cases, results, strict=True)
        ]
    except Exception as error:
        if len(group.cases) > 1:
            return [outcome for part in group.parts(2) for outcome in attempt_group(fly, part)]
        ((case_id, _),) = group.cases
        if isinstance(error, BadInputError):
            return [CaseOutcome(case_id, "crashed", _one_line(str(error)), 0.0, bad_input=True)]
        return [CaseOutcome(case_id, "crashed", _one_line(f"{type(error).__name__}: {error}"), 0.0)]


def _outcome(case_id: str, result: FlightResult) -> CaseOutcome:
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
    return " ".join(text.split())


def work(pipe: Connection, fly: GroupFunction) -> None:
    """A worker's life: take a group, fly it, send the outcomes; end with the parent, or when it is
    sent None.
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


# What a worker flies with: JSBSim, one flight after the other, or the batch engine, many at
# once. Imports little.

BATCH, JSBSIM = "batch", "jsbsim"
JUDGE, ONE_ULP_OFF = "jsbsim as judge", "jsbsim one ulp off"
"""JSBSim once more for the sake of comparison: with distances from each radius, and from a start
moved by rounding alone.
"""
NEAREST = "nearest_"
"""Before the name of a count: how near the flight came to a radius at which it counts [m]."""


class Batch(Protocol):
    """What a campaign asks of the batch engine before it flies."""

    def available(self) -> str | None:
        """None if it can fly on this machine, else the sentence that says why not."""
        ...

    def refusals(self, spec: FlightSpec, varying: Collection[str]) -> tuple[str, ...]:
        """What of aircraft and mission it does not understand, with file and line; ``varying``:
        properties that differ by case.
        """
        ...


class LocalBatch:
    """This program's batch engine."""

    def available(self) -> str | None:
        """None if it can fly on this machine, else the sentence that says why not."""
        return unavailable_reason(BATCH)

    def refusals(self, spec: FlightSpec, varying: Collection[str]) -> tuple[str, ...]:
        """See :class:`Batch`."""
        from uqharness.batch import refusals

        return refusals(spec, varying)


def unavailable_reason(engine: str) -> str | None:
    """None if this machine can fly in the engine of that name, else the sentence that says
    why not.
    """
    # Imported here, as below: a worker of JSBSim needs no compiler, one of the batch engine no
    # JSBSim.
    from uqharness.batch import available

    return available() if engine == BATCH else None


def fly_group(engine: str, flights: Sequence[FlightSpec]) -> Sequence[FlightResult]:
    """Fly flights in the engine of that name; results in the order given."""
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
    """The result with, for each count of excursions, how near the record came to a distance at
    which it counts or re-arms [m].
    """
    distances: dict[str, float] = {}
    for radius in flight.excursion_radius_m:
        for distance_name, suffix in (("cross_track", ""), ("distance_3d", "_3d")):
            distance = np.abs(result.signals.get(distance_name, np.zeros(0)))
            gaps = [
                np.min(np.abs(distance - limit))
                for limit in (radius, radius - flight.rearm_m)
                if distance.size
            ]
            distances[f"{NEAREST}excursions_{radius:g}m{suffix}"] = float(min(gaps, default=np.nan))
    return replace(result, metrics={**result.metrics, **distances})
