"""Shards of full-size campaigns flown by a function instead of an engine."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from campaigns.library.flying import fly
from campaigns.library.plan import Plan, Shard
from tests.helpers import campaign_fakes as fakes
from uqharness.campaign.processes import SerialExecutor
from uqharness.flight import FlightResult, FlightSpec


def with_medians(
    change: Callable[[FlightSpec], float],
) -> Callable[[str, Sequence[FlightSpec]], list[FlightResult]]:
    """An engine whose flights are those of ``fakes.steady`` but for the medians, each of which is
    ``change`` of the flight.
    """

    def fly_flights(engine: str, flights: Sequence[FlightSpec]) -> list[FlightResult]:
        found = []
        for flight in flights:
            result = fakes.steady(flight)
            medians = {name: change(flight) for name in result.metrics if "_median_" in name}
            found.append(replace(result, metrics={**result.metrics, **medians}))
        return found

    return fly_flights


def flown(
    plan: Plan,
    folder: Path,
    change: Callable[[FlightSpec], float],
    shards: Iterable[Shard] | None = None,
) -> Path:
    """Fly shards of a plan, all unless told, into ``folder``; it is returned."""
    fly(
        plan,
        folder,
        plan.shards() if shards is None else shards,
        SerialExecutor(),
        with_medians(change),
    )
    return folder
