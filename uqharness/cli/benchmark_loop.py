"""Cost of the harness over JSBSim's bare loop: ``python -m uqharness.cli.benchmark_loop``.

Three loops take turns in one process, each flying the same minutes of the loiter in wind,
turbulence and sensor noise:

- a: the bare ``while run()`` loop of the aircraft's XML with plugin, air (JSBSim's turbulence) and
  sensors, nothing recorded;
- b: the same without the plugin, whose system and functions are removed from a copy of the XML;
- c: the harness with a campaign's default air: conditions, levels, recording, scoring and storage.

With ``--model-form`` the aircraft has bounds that depend on its state. With ``--side-by-side`` two
processes fly a at the same time, then two workers fly c, by the wall clock, and again with workers
in JSBSim's turbulence at a corner; this needs two idle cores.

The shortest processor time of all rounds is reported. Machines are noisy: compare ratios.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from uqharness.campaign import (
    CaseOutcome,
    FlightFunction,
    ProcessExecutor,
    Store,
    attempt,
    put_bounds,
)
from uqharness.files import scratch_folder
from uqharness.flight import (
    COEFFICIENTS,
    DEFAULT_TURBULENCE_SOURCE,
    FlightResult,
    FlightSpec,
    LevelDriver,
    set_conditions,
)
from uqharness.flight.fly import fly
from uqharness.simulator import (
    Aircraft,
    StagedMission,
    copy_folder,
    engine,
    find_aircraft,
    find_script,
    parse_xml,
)

REFERENCE_HOURS_PER_CORE_HOUR = 890.0
"""Flight hours per core hour at 100 Hz of a hand-written loop with compiled intervals: the
target.
"""


def without_plugin(aircraft: Aircraft, folder: Path) -> Aircraft:
    """Copy the aircraft into ``folder`` without the model-form system and uq/ functions."""
    target = folder / "aircraft" / aircraft.name
    copy_folder(aircraft.folder, target)
    path = target / aircraft.card.aircraft.xml
    tree = parse_xml(path)
    for element in list(tree.getroot().iter("system", "function")):
        parent = element.getparent()
        if parent is not None and (
            element.get("file") == "model-form" or element.get("name", "").startswith("uq/")
        ):
            parent.remove(element)
    tree.write(str(path), encoding="UTF-8", xml_declaration=True)
    return find_aircraft(target)


def bare_loop(
    aircraft: Aircraft, spec: FlightSpec, clock: Callable[[], float] = time.process_time
) -> Callable[[], float]:
    """Return a function that flies ``spec`` with JSBSim's bare loop and returns its duration by
    ``clock`` [s].
    """
    mission = StagedMission(aircraft, find_script(spec.script), end_s=spec.duration_s)

    def fly_once() -> float:
        fdm = mission.open()
        set_conditions(fdm, mission, spec)
        engine.run_ic(fdm)
        run = fdm.run
        start = clock()
        while run():
            pass
        spent = clock() - start
        assert fdm.get_sim_time() >= spec.duration_s - fdm.get_delta_t()
        return spent

    return fly_once


def harness_loop(spec: FlightSpec, folder: Path) -> Callable[[], float]:
    """Return a function that flies ``spec`` as a campaign does and returns its processor
    time [s].
    """
    store = Store(folder)
    # Every flight needs a new id in the store.
    count = iter(range(10**9))

    def fly_once() -> float:
        start = time.process_time()
        outcome = attempt(fly, f"{next(count):016x}", spec)
        store.add([outcome])
        spent = time.process_time() - start
        assert outcome.status == "ok", outcome.reason
        return spent

    return fly_once


def with_model_form(aircraft: Aircraft, model_form: Path, folder: Path) -> Aircraft:
    """Copy the aircraft into ``folder`` with the bounds of a model-form.json."""
    target = folder / "aircraft" / aircraft.name
    copy_folder(aircraft.folder, target)
    put_bounds(target, aircraft, model_form)
    return find_aircraft(target)


def bare_flight(spec: FlightSpec) -> FlightResult:
    """Fly the bare loop alone, as the flight function of a worker; the metric ``loop_s`` is its
    duration.
    """
    loop_s = bare_loop(find_aircraft(spec.aircraft), spec, time.monotonic)()
    return FlightResult("ok", "", spec.duration_s, {"loop_s": loop_s}, {}, {})


def side_by_side(
    bare_spec: FlightSpec, harness_spec: FlightSpec, rounds: int, workers: int = 2
) -> dict[str, float]:
    """Measure flight seconds per wall-clock second of parallel bare loops, and of as many
    workers.
    """

    def fly_all(
        executor: ProcessExecutor, function: FlightFunction, spec: FlightSpec, count: int
    ) -> list[CaseOutcome]:
        outcomes = [
            item
            for batch in executor.run(function, [(f"{n:016x}", spec) for n in range(count)])
            for item in batch
        ]
        assert all(item.status == "ok" for item in outcomes), outcomes
        return outcomes

    rates = {}
    for name, function, spec in (("bare", bare_flight, bare_spec), ("workers", fly, harness_spec)):
        executor = ProcessExecutor(workers, keep=True)
        try:
            # Let all workers start and load everything before timing.
            fly_all(executor, function, replace(spec, duration_s=10.0), 2 * workers)
            start = time.monotonic()
            timed = fly_all(executor, function, spec, rounds * workers)
            elapsed = time.monotonic() - start
        finally:
            executor.close()
        # Bare loops time themselves, without the start of the worker; the harness is timed as a
        # whole.
        clocks = (
            [item.metrics["loop_s"] for item in timed] if name == "bare" else [elapsed / rounds]
        )
        rates[name] = workers * spec.duration_s * len(clocks) / sum(clocks)
    return {
        f"bare_{workers}_flight_s_per_s": rates["bare"],
        f"workers_{workers}_flight_s_per_s": rates["workers"],
        f"workers_{workers}_over_bare_{workers}": rates["workers"] / rates["bare"],
    }


def measure(
    aircraft_name: str,
    duration_s: float,
    rounds: int,
    source: str,
    levels: str,
    model_form: Path | None = None,
    *,
    in_parallel: bool = False,
) -> dict[str, float]:
    """Measure microseconds per step of a, b and c, their ratios, and flight hours per core hour of
    c.
    """
    with scratch_folder() as scratch:
        aircraft = find_aircraft(aircraft_name)
        if model_form is not None:
            aircraft = with_model_form(aircraft, model_form, scratch.path)
        return _measure(aircraft, duration_s, rounds, source, levels, in_parallel)


def _measure(
    aircraft: Aircraft, duration_s: float, rounds: int, source: str, levels: str, in_parallel: bool
) -> dict[str, float]:
    """Measure with a given aircraft."""
    deltas = {"uq/active": 1.0} | {f"uq/{name}/level": 1.0 for name in COEFFICIENTS}
    spec = FlightSpec(
        aircraft.folder,
        find_script("loiter"),
        duration_s,
        wind_mps=3.0,
        turbulence="moderate",
        turbulence_source=source,
        sensor_noise=True,
        seed_turbulence=11,
        seed_noise=12,
        properties=deltas,
    )
    harness_spec = (
        spec
        if levels == "corner"
        else replace(spec, levels=_driver(levels), properties={"uq/active": 1.0})
    )
    # The bare loops have JSBSim's own turbulence, whatever the harness flies.
    bare_spec = replace(spec, turbulence_source="jsbsim")
    with scratch_folder() as scratch:
        folder = scratch.path
        loops = {
            "a": bare_loop(aircraft, bare_spec),
            "b": bare_loop(without_plugin(aircraft, folder), replace(bare_spec, properties={})),
            "c": harness_loop(harness_spec, folder),
        }
        best = dict.fromkeys(loops, float("inf"))
        for _ in range(rounds):
            for key, loop in loops.items():
                best[key] = min(best[key], loop())
    steps = duration_s / aircraft.dt_s
    per_step = {key: 1e6 * seconds / steps for key, seconds in best.items()}
    return {
        "a_us_per_step": per_step["a"],
        "b_us_per_step": per_step["b"],
        "c_us_per_step": per_step["c"],
        "c_over_a": per_step["c"] / per_step["a"],
        "a_over_b": per_step["a"] / per_step["b"],
        "flight_hours_per_core_hour": duration_s / best["c"],
    } | (_both_airs(bare_spec, harness_spec, rounds) if in_parallel else {})


def _both_airs(bare_spec: FlightSpec, harness_spec: FlightSpec, rounds: int) -> dict[str, float]:
    """Measure `side_by_side`, and workers in the air of the bare loops with levels at a corner."""
    same = side_by_side(bare_spec, bare_spec, rounds)["workers_2_over_bare_2"]
    return side_by_side(bare_spec, harness_spec, rounds) | {
        "workers_2_in_the_same_air_over_bare_2": same
    }


def _driver(levels: str) -> LevelDriver | None:
    """Return the driver of varying levels; None for a corner."""
    if levels == "walk":
        return LevelDriver("walk", 1, "walk-000000", COEFFICIENTS, (0.012,) * len(COEFFICIENTS))
    return LevelDriver("white", 1, "white-000000", COEFFICIENTS) if levels == "white" else None


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print; return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m uqharness.cli.benchmark_loop",
        description="Cost of the harness over JSBSim's bare loop.",
    )
    parser.add_argument("--aircraft", default="espaaro")
    parser.add_argument(
        "--duration-s", type=float, default=900.0, help="flight per round and loop (default 900)"
    )
    parser.add_argument(
        "--rounds", type=int, default=5, help="rounds; the least time counts (default 5)"
    )
    parser.add_argument(
        "--turbulence-source", choices=("jsbsim", "spec"), default=DEFAULT_TURBULENCE_SOURCE
    )
    parser.add_argument(
        "--levels",
        choices=("corner", "walk", "white"),
        default="walk",
        help="of the harness's flights (default %(default)s)",
    )
    parser.add_argument(
        "--model-form", type=Path, metavar="model-form.json", help="bounds that depend on the state"
    )
    parser.add_argument(
        "--side-by-side", action="store_true", help="two workers against two bare loops as well"
    )
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(argv)
    figures = measure(
        args.aircraft,
        args.duration_s,
        args.rounds,
        args.turbulence_source,
        args.levels,
        args.model_form,
        in_parallel=args.side_by_side,
    )
    if args.json:
        print(json.dumps(figures))
        return 0
    print(
        f"{args.aircraft}, loiter, moderate turbulence ({args.turbulence_source}), {args.rounds}"
        f" rounds of {args.duration_s:g} s"
    )
    print(f"  a  bare loop, plugin, air, sensors  {figures['a_us_per_step']:7.2f} us/step")
    print(
        f"  b  the same without the plugin      {figures['b_us_per_step']:7.2f} us/step   a/b"
        f" {figures['a_over_b']:.3f}"
    )
    print(
        f"  c  harness with levels, stored      {figures['c_us_per_step']:7.2f} us/step   c/a"
        f" {figures['c_over_a']:.3f}"
    )
    print(
        f"  flight hours per core hour: {figures['flight_hours_per_core_hour']:.0f} (to beat:"
        f" {REFERENCE_HOURS_PER_CORE_HOUR:.0f})"
    )
    # Two workers side by side, as a campaign runs them.
    if args.side_by_side:
        print(
            f"  two workers {figures['workers_2_flight_s_per_s']:.0f}, two bare loops"
            f" {figures['bare_2_flight_s_per_s']:.0f} flight s per s by the clock:"
            f" {figures['workers_2_over_bare_2']:.3f} (in the same air, corners:"
            f" {figures['workers_2_in_the_same_air_over_bare_2']:.3f})"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
