"""What the harness costs over JSBSim's bare loop, measured side by side: ``python -m uqharness.benchmark``.

Three loops take turns in one process, each flying the same minutes of the loiter in wind, turbulence and sensor noise:

a  the bare ``while run()`` loop of the aircraft's own XML, plugin, air (JSBSim's turbulence) and sensors on, nothing recorded;
b  the same without the plugin (its system and its functions taken out of a copy of the XML);
c  the harness with a campaign's default air: conditions, levels, recording, scoring and storage of the result.

Processor time is counted, the least of all rounds is quoted, and ratios are what to compare: machines are noisy.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from uqharness import engine
from uqharness.aircraft import Aircraft, find_aircraft, parse_xml
from uqharness.executor import attempt
from uqharness.flight import fly, set_conditions
from uqharness.flight_spec import COEFFICIENTS, DEFAULT_TURBULENCE_SOURCE, FlightSpec, LevelDriver
from uqharness.mission import StagedMission, find_script
from uqharness.store import Store

REFERENCE_HOURS_PER_CORE_HOUR = 890.0
"""Flight hours per core hour at 100 Hz of a hand-written loop with compiled intervals, the figure to beat."""


def without_plugin(aircraft: Aircraft, folder: Path) -> Aircraft:
    """A copy of the aircraft in ``folder`` whose XML has no model-form system and no uq/ function."""
    target = folder / "aircraft" / aircraft.name
    shutil.copytree(aircraft.folder, target)
    path = target / aircraft.card.aircraft.xml
    tree = parse_xml(path)
    for element in list(tree.getroot().iter("system", "function")):
        parent = element.getparent()
        if parent is not None and (element.get("file") == "model-form" or element.get("name", "").startswith("uq/")):
            parent.remove(element)
    tree.write(str(path), encoding="UTF-8", xml_declaration=True)
    return find_aircraft(target)


def bare_loop(aircraft: Aircraft, spec: FlightSpec) -> Callable[[], float]:
    """A function that flies ``spec`` with JSBSim's bare loop and returns processor seconds spent in the loop."""
    mission = StagedMission(aircraft, find_script(spec.script), end_s=spec.duration_s)

    def once() -> float:
        fdm = mission.open()
        set_conditions(fdm, mission, spec)
        engine.run_ic(fdm)
        run = fdm.run
        start = time.process_time()
        while run():
            pass
        spent = time.process_time() - start
        assert fdm.get_sim_time() >= spec.duration_s - fdm.get_delta_t()
        return spent

    return once


def harness_loop(spec: FlightSpec, folder: Path) -> Callable[[], float]:
    """A function that flies ``spec`` as a campaign does, result on the disk, and returns the processor seconds of all of it."""
    store = Store(folder)
    count = iter(range(10**9))

    def once() -> float:
        start = time.process_time()
        outcome = attempt(fly, f"{next(count):016x}", spec)
        store.add([outcome])
        spent = time.process_time() - start
        assert outcome.status == "ok", outcome.reason
        return spent

    return once


def measure(aircraft_name: str, duration_s: float, rounds: int, source: str, levels: str) -> dict[str, float]:
    """Least microseconds per step of a, b and c, their ratios, and flight hours per core hour of c."""
    aircraft = find_aircraft(aircraft_name)
    deltas = {"uq/active": 1.0} | {f"uq/{name}/level": 1.0 for name in COEFFICIENTS}
    spec = FlightSpec(
        aircraft.folder, find_script("loiter"), duration_s, wind_mps=3.0, turbulence="moderate", turbulence_source=source,
        sensor_noise=True, seed_turbulence=11, seed_noise=12, properties=deltas,
    )  # fmt: skip
    flown = spec if levels == "corner" else replace(spec, levels=_driver(levels), properties={"uq/active": 1.0})
    # Without a host JSBSim has only its own turbulence: that is the air of the bare loops, whatever the harness flies.
    bare = replace(spec, turbulence_source="jsbsim")
    with tempfile.TemporaryDirectory(prefix="uqharness-") as name:
        folder = Path(name)
        loops = {
            "a": bare_loop(aircraft, bare),
            "b": bare_loop(without_plugin(aircraft, folder), replace(bare, properties={})),
            "c": harness_loop(flown, folder),
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
    }


def _driver(levels: str) -> LevelDriver | None:
    if levels == "walk":
        return LevelDriver("walk", 1, "walk-000000", COEFFICIENTS, (0.012,) * len(COEFFICIENTS))
    return LevelDriver("white", 1, "white-000000", COEFFICIENTS) if levels == "white" else None


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m uqharness.benchmark", description="Cost of the harness over JSBSim's bare loop."
    )
    parser.add_argument("--aircraft", default="espaaro")
    parser.add_argument("--duration-s", type=float, default=900.0, help="flight per round and loop (default 900)")
    parser.add_argument("--rounds", type=int, default=5, help="rounds; the least time counts (default 5)")
    parser.add_argument("--turbulence-source", choices=("jsbsim", "spec"), default=DEFAULT_TURBULENCE_SOURCE)
    parser.add_argument(
        "--levels",
        choices=("corner", "walk", "white"),
        default="walk",
        help="of the harness's flights (default %(default)s)",
    )
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(argv)
    figures = measure(args.aircraft, args.duration_s, args.rounds, args.turbulence_source, args.levels)
    if args.json:
        print(json.dumps(figures))
        return 0
    print(
        f"{args.aircraft}, loiter, moderate turbulence ({args.turbulence_source}), {args.rounds} rounds of {args.duration_s:g} s"
    )
    print(f"  a  bare loop, plugin, air, sensors  {figures['a_us_per_step']:7.2f} us/step")
    print(
        f"  b  the same without the plugin      {figures['b_us_per_step']:7.2f} us/step   a/b {figures['a_over_b']:.3f}"
    )
    print(
        f"  c  harness with levels, stored      {figures['c_us_per_step']:7.2f} us/step   c/a {figures['c_over_a']:.3f}"
    )
    print(
        f"  flight hours per core hour: {figures['flight_hours_per_core_hour']:.0f}"
        f" (to beat: {REFERENCE_HOURS_PER_CORE_HOUR:.0f})"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
