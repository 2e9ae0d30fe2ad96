"""Speed of the batch engine relative to JSBSim's bare loop: ``python -m
uqharness.cli.benchmark_batch``.

One flight is the expensive case: loiter in wind, turbulence, sensor noise, autopilot, and with
``--model-form`` bounds that depend on the state. Loops take turns in one process, and the shortest
processor time of all rounds counts:

- a: JSBSim's bare loop, one flight;
- c: the product through JSBSim: a campaign's default air, recorded and scored, one flight;
- d: the batch engine alone: 64 corners in two airs, streams included, recorded, not scored; for
  each vector width of this machine;
- e: a corner campaign from end to end by the wall clock: engine check, flights, scores, journal,
  tables; in one process and in two;
- f, g, h: with ``--flight``, replays of that flight.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from sysid.aerodynamics import Piece
from uqharness.batch import VECTORS, forget, record_many, target_names
from uqharness.campaign import campaign_from, find_mission, run_campaign
from uqharness.cli.benchmark_loop import bare_loop, with_model_form
from uqharness.errors import BadInputError
from uqharness.files import scratch_folder
from uqharness.flight import COEFFICIENTS, FlightSpec
from uqharness.flight.fly import fly
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
from uqharness.simulator import Aircraft, find_aircraft, find_script

# Speed of replays, on one core: f, 400 replays of the first 90 s of a flight with different
# parameters; g, translation, compilation and check of an aircraft's replays; h, ``identify`` of all
# parameters of the card, g included, nothing written.

_FLIGHT_S = 90.0
_PARAMETER_STD = 0.02
"""Relative standard deviation of the parameters of a lane."""


def measure_replays(
    aircraft: Aircraft, flight: Path, rounds: int, replays: int = 400
) -> dict[str, float]:
    """Measure f, g and h: the shortest processor time of all rounds.

    Raises BadInputError for a flight shorter than 90 s.
    """
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
    """Time the first replay, which compiles, and then all of them [s]."""
    segment = _long_segment(aircraft, flight, measured)
    rng = np.random.default_rng(1)
    # Compilation is part of g, so no earlier program may be used.
    forget_programs()
    with ReplayFolder(aircraft, measured=measured) as model:
        fdm = model.open(aircraft.dt_s)
        values = {name: float(fdm[name]) for name in aircraft.card.parameters}
        lanes = rng.normal(1.0, _PARAMETER_STD, (count, len(values)))
        jobs = [
            ReplayJob(
                model,
                segment,
                dict(zip(values, row * [*values.values()], strict=True)),
                segment.start,
            )
            for row in lanes
        ]
        start_s = time.process_time()
        fly_all(jobs[:1])
        compiled = time.process_time()
        fly_all(jobs)
        ended = time.process_time()
        return {"g_s": compiled - start_s, "f_s": ended - compiled}


def _identify(
    aircraft: Aircraft, flights: list[Flight], measured: tuple[str, ...]
) -> dict[str, float]:
    """Time `identify` without compiled programs [s]."""
    forget_programs()
    start_s = time.process_time()
    identify(aircraft, flights, measured, workers=1)
    return {"h_s": time.process_time() - start_s}


def _long_segment(aircraft: Aircraft, flight: Flight, measured: tuple[str, ...]) -> Segment:
    """Return the first 90 s of a flight as one segment. Raises BadInputError for a shorter
    flight.
    """
    rows = round(_FLIGHT_S / flight.record.dt_s) + 1
    if len(flight.record) < rows:
        raise BadInputError(
            f"{flight.name}: {_FLIGHT_S:g} s of flight are needed, it has {len(flight.record)} rows"
            f" of {rows}"
        )
    pieces = (Piece("whole", slice(0, rows), 0.0, _FLIGHT_S),)
    return segments(replace(flight, pieces=pieces), measured, aircraft.accelerometer_m)[0]


def replay_lines(figures: Mapping[str, float]) -> list[str]:
    """Return the figures of replays as text."""
    rate = figures["f_replays_per_s"]
    return [
        (
            f"  f  replays of {_FLIGHT_S:.0f} s, one core               {rate:8.0f} a second   400"
            f" take {400.0 / rate:.2f} s"
        ),
        f"  g  replays translated, compiled, checked   {figures['g_compile_s']:8.2f} s of one core",
        (
            f"  h  identify, all parameters, with g        {figures['h_identify_s']:8.2f} s of one"
            " core"
        ),
    ]


_AIRS = 2
CAMPAIGN_AIRS = 48
"""Realisations of turbulence in the campaigns, each flown by 64 corners."""
_BURN_IN_S = 60.0


def measure_batch(
    aircraft_name: str,
    duration_s: float,
    rounds: int,
    model_form: Path | None = None,
    campaign_airs: int = CAMPAIGN_AIRS,
) -> dict[str, float]:
    """Measure a, c, d and e: microseconds per step and flight, flight hours per core hour,
    ratios.
    """
    with scratch_folder() as scratch:
        aircraft = find_aircraft(aircraft_name)
        bounded_aircraft = (
            aircraft if model_form is None else with_model_form(aircraft, model_form, scratch.path)
        )
        figures = _alternate(bounded_aircraft, duration_s, rounds)
        return figures | _campaigns(aircraft, duration_s, scratch.path, model_form, campaign_airs)


def _alternate(aircraft: Aircraft, duration_s: float, rounds: int) -> dict[str, float]:
    """Measure a, c and d in turns."""
    one = FlightSpec(
        aircraft.folder,
        find_script("loiter"),
        duration_s,
        wind_mps=3.0,
        turbulence="moderate",
        sensor_noise=True,
        seed_turbulence=11,
        seed_noise=12,
        properties=_corner((1.0,) * 6),
    )
    corners = [
        replace(one, seed_turbulence=11 + air, seed_noise=30 + air, properties=_corner(levels))
        for air in range(_AIRS)
        for levels in itertools.product((0.0, 1.0), repeat=6)
    ]
    run_bare_loop = bare_loop(aircraft, replace(one, turbulence_source="jsbsim"))
    best: dict[str, float] = {}

    # The shortest time of all rounds is least affected by other processes.
    def timed(key: str, seconds: float, flights: int) -> None:
        per_step = 1e6 * seconds / (flights * duration_s / aircraft.dt_s)
        best[key] = min(best.get(key, float("inf")), per_step)

    for _ in range(rounds):
        timed("a_us_per_step", run_bare_loop(), 1)
        start_s = time.process_time()
        fly(one)
        timed("c_us_per_step", time.process_time() - start_s, 1)
        for name in target_names():
            with _compiled_for(name):
                for source in ("spec", "jsbsim"):
                    flights = [replace(spec, turbulence_source=source) for spec in corners]
                    # Compile outside the timed part: a campaign does so once a condition.
                    record_many(flights[:8])
                    start_s = time.process_time()
                    record_many(flights)
                    timed(
                        f"d_{name}_{source}_us_per_step",
                        time.process_time() - start_s,
                        len(flights),
                    )
    ratios = {
        key.replace("us_per_step", "over_a"): best["a_us_per_step"] / value
        for key, value in best.items()
        if key[0] == "d"
    }
    return best | ratios


def _corner(levels: tuple[float, ...]) -> dict[str, float]:
    """Return the properties of a corner of the model-form bounds."""
    return {"uq/active": 1.0} | {
        f"uq/{name}/level": level for name, level in zip(COEFFICIENTS, levels, strict=True)
    }


@contextmanager
def _compiled_for(name: str) -> Iterator[None]:
    """Context in which the batch engine compiles for one vector width."""
    # The width of vectors is chosen when a program is compiled.
    before = os.environ.get(VECTORS)
    os.environ[VECTORS] = name
    forget()
    try:
        yield
    finally:
        os.environ.pop(VECTORS)
        if before is not None:
            os.environ[VECTORS] = before
        forget()


def _campaigns(
    aircraft: Aircraft, duration_s: float, folder: Path, model_form: Path | None, airs: int
) -> dict[str, float]:
    """Measure flight hours per wall-clock hour of complete campaigns.

    Processor time of the workers would leave out the work of the parent.
    """
    figures: dict[str, float] = {}
    bounds = dict.fromkeys(COEFFICIENTS, 0.001) if model_form is None else str(model_form.resolve())
    for workers in (1, 2):
        spec = campaign_from(
            {
                "campaign": {
                    "aircraft": str(aircraft.folder),
                    "mission": str(find_script("loiter")),
                    "seed": 1,
                    "engine": "batch",
                },
                "aleatory": {
                    "flights": airs,
                    "duration_s": duration_s,
                    "burn_in_s": _BURN_IN_S,
                    "wind_mps": [3],
                    "turbulence": ["moderate"],
                    "sensor_noise": True,
                },
                "epistemic": {
                    "method": "corners",
                    "coefficients": list(COEFFICIENTS),
                    "bounds": bounds,
                },
                "metrics": {"excursion_radius_m": [15, 25], "rearm_m": 2},
            },
            folder / "campaign.toml",
        )
        # The parent's clock includes start-up, storing and tables.
        start_s = time.monotonic()
        summary = run_campaign(
            spec,
            folder / f"campaign-{workers}",
            workers=workers,
            mission=find_mission(spec, folder),
        )
        assert summary.failed == 0, summary
        hours = summary.cases * (duration_s + _BURN_IN_S) / 3600.0
        figures[f"e_{workers}_flight_hours_per_hour"] = hours / (
            (time.monotonic() - start_s) / 3600.0
        )
    figures["e_2_over_1"] = (
        figures["e_2_flight_hours_per_hour"] / figures["e_1_flight_hours_per_hour"]
    )
    return figures


def as_text(figures: Mapping[str, float]) -> str:
    """Return the figures as text."""
    lines = [f"  a  JSBSim's bare loop                     {figures['a_us_per_step']:8.3f} us/step"]
    lines.append(
        f"  c  the product through JSBSim             {figures['c_us_per_step']:8.3f} us/step"
    )
    for key, value in figures.items():
        if key.startswith("d_") and key.endswith("us_per_step"):
            _, name, source, *_ = key.split("_")
            ratio = figures[key.replace("us_per_step", "over_a")]
            lines.append(
                f"  d  batch, {name:7s} air from {source:7s}          {value:8.3f} us/step and"
                f" flight   a/d {ratio:5.1f}"
            )
    for workers in (1, 2):
        hours = figures[f"e_{workers}_flight_hours_per_hour"]
        lines.append(
            f"  e  corner campaign, {workers} process(es), by the clock  {hours:8.0f} flight h"
            " per h"
        )
    lines.append(f"     two processes over one                {figures['e_2_over_1']:8.2f}")
    if "f_replays_per_s" in figures:
        lines += replay_lines(figures)
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print; return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m uqharness.cli.benchmark_batch",
        description="Speed of the batch engine relative to JSBSim's bare loop.",
    )
    parser.add_argument("--aircraft", default="espaaro")
    parser.add_argument(
        "--duration-s", type=float, default=900.0, help="flight per round and loop (default 900)"
    )
    parser.add_argument(
        "--rounds", type=int, default=3, help="rounds; the least time counts (default 3)"
    )
    parser.add_argument(
        "--model-form", type=Path, metavar="model-form.json", help="bounds that depend on the state"
    )
    parser.add_argument(
        "--flight",
        type=Path,
        metavar="flight.parquet",
        help="a flight of 90 s with manoeuvres: replays of it",
    )
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(argv)
    figures = measure_batch(args.aircraft, args.duration_s, args.rounds, args.model_form)
    if args.flight is not None:
        figures |= measure_replays(find_aircraft(args.aircraft), args.flight, args.rounds)
    print(json.dumps(figures) if args.json else as_text(figures))
    return 0


if __name__ == "__main__":
    sys.exit(main())
