"""A batch engine that flies what JSBSim's stand-in flies, or almost, or not, importable by worker
processes.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from tests.helpers import campaign_fakes as fakes
from uqharness.campaign.engines import Engines
from uqharness.campaign.processes import BATCH, ONE_ULP_OFF
from uqharness.flight.spec import FlightResult, FlightSpec


@dataclass(frozen=True)
class Understanding:
    """The face of a batch engine: there or not, and what it does not understand."""

    missing: str | None = None
    refused: tuple[str, ...] = ()
    ignored: tuple[str, ...] = ()

    def available(self) -> str | None:
        return self.missing

    def refusals(self, spec: FlightSpec, varying: Collection[str]) -> tuple[str, ...]:
        return self.refused

    def left_out(self, spec: FlightSpec, varying: Collection[str]) -> tuple[str, ...]:
        return self.ignored


@dataclass(frozen=True)
class Flown:
    """Flies groups: the batch engine's flights have ``metric`` moved by ``offset``, only whole ones
    if ``late``.

    ``sleep_s`` a flight; JSBSim's own from one ulp off has the metric moved by ``rounding``.
    """

    metric: str = "cross_track_median_m"
    offset: float = 0.0
    late: bool = False
    sleep_s: float = 0.0
    rounding: float = 0.0

    def __call__(self, engine: str, flights: Sequence[FlightSpec]) -> list[FlightResult]:
        return [self.flight(engine, flight) for flight in flights]

    def flight(self, engine: str, flight: FlightSpec) -> FlightResult:
        time.sleep(self.sleep_s if engine == BATCH else 0.0)
        result = fakes.steady(flight)
        moved = (
            self.offset if engine == BATCH and (flight.duration_s > 10.0 or not self.late) else 0.0
        )
        moved += self.rounding if engine == ONE_ULP_OFF else 0.0
        return replace(
            result, metrics={**result.metrics, self.metric: result.metrics[self.metric] + moved}
        )


@dataclass(frozen=True)
class Deadly(Flown):
    """One case of the campaign, at all upper bounds in one of its airs, ends the process that flies
    it in the batch engine.
    """

    seed: int = 0

    def flight(self, engine: str, flight: FlightSpec) -> FlightResult:
        if (
            engine == BATCH
            and fakes.level_sum(flight) == 6.0
            and flight.seed_turbulence == self.seed
        ):
            os.kill(os.getpid(), signal.SIGSEGV)
        return super().flight(engine, flight)


def engines(flight: Flown, understanding: Understanding = Understanding()) -> Engines:
    return Engines(fakes.steady, flight, understanding)
