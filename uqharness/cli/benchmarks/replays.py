"""How fast replays are, for ``uqharness.cli.benchmarks.batch``: of a whole flight with many parameters, and in ``identify``.

f  400 replays of the first 90 s of a flight, each with parameters of its own, by one core;
g  an aircraft's replays translated, compiled and checked against JSBSim;
h  ``identify`` of all parameters of the card, nothing written, g included: what a process has loaded before does not count.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from sysid.aerodynamics import Piece
from uqharness.errors import BadInputError
from uqharness.identification.identify import identify
from uqharness.replay import (
    Flight,
    ReplayFolder,
    ReplayJob,
    Segment,
    fly_all,
    forget_programs,
    read_flights,
)
from uqharness.replay.flights import segments
from uqharness.simulator import Aircraft

_FLIGHT_S = 90.0
_SPREAD = 0.02
"""Standard deviation of a lane's parameters, in their values."""


def measure_replays(
    aircraft: Aircraft, flight: Path, rounds: int, replays: int = 400
) -> dict[str, float]:
    """Figures of f, g and h, the least processor time of all rounds. Raises BadInputError for a flight shorter than 90 s."""
    flights, measured = read_flights([flight], aircraft)
    best: dict[str, float] = {}
    for _ in range(rounds):
        for key, seconds in (
            _replays(aircraft, flights[0], measured, replays)
            | _identify(aircraft, flights, measured)
        ).items():
            best[key] = min(best.get(key, float("inf")), seconds)
    return {
        "f_replays_per_s": replays / best["f_s"],
        "g_compile_s": best["g_s"],
        "h_identify_s": best["h_s"],
    }


def _replays(
    aircraft: Aircraft, flight: Flight, measured: tuple[str, ...], count: int
) -> dict[str, float]:
    whole = _whole(aircraft, flight, measured)
    rng = np.random.default_rng(1)
    forget_programs()
    with ReplayFolder(aircraft, measured=measured) as model:
        fdm = model.open(aircraft.dt_s)
        values = {name: float(fdm[name]) for name in aircraft.card.parameters}
        lanes = rng.normal(1.0, _SPREAD, (count, len(values)))
        jobs = [
            ReplayJob(
                model, whole, dict(zip(values, row * [*values.values()], strict=True)), whole.start
            )
            for row in lanes
        ]
        begun = time.process_time()
        fly_all(jobs[:1])
        compiled = time.process_time()
        fly_all(jobs)
        ended = time.process_time()
        return {"g_s": compiled - begun, "f_s": ended - compiled}


def _identify(
    aircraft: Aircraft, flights: list[Flight], measured: tuple[str, ...]
) -> dict[str, float]:
    forget_programs()
    begun = time.process_time()
    identify(aircraft, flights, measured, workers=1)
    return {"h_s": time.process_time() - begun}


def _whole(aircraft: Aircraft, flight: Flight, measured: tuple[str, ...]) -> Segment:
    rows = round(_FLIGHT_S / flight.record.dt_s) + 1
    if len(flight.record) < rows:
        raise BadInputError(
            f"{flight.name}: {_FLIGHT_S:g} s of flight are needed, it has {len(flight.record)} rows of {rows}"
        )
    pieces = (Piece("whole", slice(0, rows), 0.0, _FLIGHT_S),)
    return segments(replace(flight, pieces=pieces), measured, aircraft.accelerometer_m)[0]


def said_of_replays(found: Mapping[str, float]) -> list[str]:
    """The figures for a reader."""
    rate = found["f_replays_per_s"]
    return [
        f"  f  replays of {_FLIGHT_S:.0f} s, one core               {rate:8.0f} a second   400 take {400.0 / rate:.2f} s",
        f"  g  replays translated, compiled, checked   {found['g_compile_s']:8.2f} s of one core",
        f"  h  identify, all parameters, with g        {found['h_identify_s']:8.2f} s of one core",
    ]
