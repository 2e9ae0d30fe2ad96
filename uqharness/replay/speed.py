"""How fast replays ran, beside the bare JSBSim loop on the same machine at the same time."""

from __future__ import annotations

import time
from dataclasses import dataclass

from sysid.units import FT_M
from uqharness.replay.model import ReplayModel
from uqharness.replay.replay import runs_per_row
from uqharness.replay.segments import Segment
from uqharness.simulator import engine

_RUNS = 2000


@dataclass(frozen=True)
class Speed:
    """simulations (replays of all segments) and flight seconds a second of wall time, and the processes they ran in;
    bare: flight seconds a second of one process that does nothing but step the same model."""

    simulations_per_s: float
    flight_s_per_s: float
    processes: int
    bare_flight_s_per_s: float

    def text(self) -> str:
        """One line for a report."""
        return (
            f"{self.simulations_per_s:.1f} simulations or {self.flight_s_per_s:.0f} flight seconds per second in {self.processes} "
            f"process{'' if self.processes == 1 else 'es'}; JSBSim's bare loop: {self.bare_flight_s_per_s:.0f}"
        )


def bare_rate(model: ReplayModel, segment: Segment) -> float:
    """Flight seconds a second of wall time when the model is stepped and nothing is set or read. Raises BadInputError."""
    dt_s = segment.dt_s / runs_per_row(segment.dt_s)
    fdm = model.open(dt_s)
    fdm["ic/h-sl-ft"], fdm["ic/u-fps"] = (
        (segment.altitude_m + 500.0) / FT_M,
        float(segment.start[0]) / FT_M,
    )
    engine.run_ic(fdm)
    run = fdm.run
    begun = time.perf_counter()
    for _ in range(_RUNS):
        run()
    return _RUNS * dt_s / (time.perf_counter() - begun)
