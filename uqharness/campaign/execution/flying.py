"""What a worker flies with: JSBSim, one flight after the other, or the batch engine, many at once. Imports little."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from uqharness.flight import FlightResult, FlightSpec

BATCH, JSBSIM = "batch", "jsbsim"
JUDGE, ONE_ULP_OFF = "jsbsim as judge", "jsbsim one ulp off"
"""JSBSim once more for the sake of comparison: with distances from each radius, and from a start moved by rounding alone."""
NEAREST = "nearest_"
"""Before the name of a count: how near the flight came to a radius at which it counts [m]."""


class Batch(Protocol):
    """What a campaign asks of the batch engine before it flies."""

    def available(self) -> str | None:
        """None if it can fly on this machine, else the sentence that says why not."""
        ...

    def refusals(self, spec: FlightSpec, varying: Collection[str]) -> tuple[str, ...]:
        """What of aircraft and mission it does not understand, with file and line; ``varying``: properties that differ by case."""
        ...


class OwnBatch:
    """This program's batch engine."""

    def available(self) -> str | None:
        """None if it can fly on this machine, else the sentence that says why not."""
        return why_not(BATCH)

    def refusals(self, spec: FlightSpec, varying: Collection[str]) -> tuple[str, ...]:
        """See :class:`Batch`."""
        from uqharness.batch import refusals

        return refusals(spec, varying)


def why_not(engine: str) -> str | None:
    """None if this machine can fly in the engine of that name, else the sentence that says why not."""
    # Imported here, as below: a worker of JSBSim needs no compiler, one of the batch engine no JSBSim.
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
    """The result with, for each count of excursions, how near the record came to a distance at which it counts or re-arms [m]."""
    found: dict[str, float] = {}
    for radius in flight.excursion_radius_m:
        for signal, suffix in (("cross_track", ""), ("distance_3d", "_3d")):
            distance = np.abs(result.signals.get(signal, np.zeros(0)))
            gaps = [
                np.min(np.abs(distance - limit))
                for limit in (radius, radius - flight.rearm_m)
                if distance.size
            ]
            found[f"{NEAREST}excursions_{radius:g}m{suffix}"] = float(min(gaps, default=np.nan))
    return replace(result, metrics={**result.metrics, **found})
