"""What bounds computed in JSBSim cost per step, and what holding them between two computations costs in accuracy.

    python -m campaigns.model-form.cost AIRCRAFT --bounds model-form.json [--rounds N] [--minutes M]

The aircraft without a plugin, with constant bounds and with the model form's at several rates take turns; processor time, least of
all rounds. For the hold error one flight in turbulence records the bounds that the system publishes in every step, and the states
of the step, from which sysid computes what they should be: the difference is the age of airspeed and incidence, and the hold.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sysid.model_form.model_form import ModelForm, read_model_form
from uqharness.cli.benchmarks.loop import without_plugin
from uqharness.files import scratch_folder
from uqharness.flight.fly import set_conditions
from uqharness.flight.spec import FlightSpec
from uqharness.plugin.apply import write
from uqharness.plugin.instrument import Bounds, plan
from uqharness.plugin.model_form_xml import model_form_xml, state_source
from uqharness.simulator import engine
from uqharness.simulator.aircraft import Aircraft, find_aircraft
from uqharness.simulator.mission import StagedMission, find_script

RATES_HZ = (100.0, 50.0, 10.0, 1.0)
STEPS = 20_000


def cost(
    aircraft: Aircraft, form: ModelForm, script: str, rounds: int, folder: Path
) -> dict[str, float]:
    """Microseconds of processor time per step by variant."""
    variants = {"no plugin": without_plugin(aircraft, folder / "none")}
    for name, bounds in (
        ("constant bounds", Bounds()),
        *((f"{rate:g} Hz", Bounds(form)) for rate in RATES_HZ),
    ):
        out = folder / name.replace(" ", "-") / aircraft.name
        out.parent.mkdir(parents=True)
        planned = plan(aircraft, bounds)
        write(aircraft, planned, out)
        if bounds.form is not None:
            system = next(file for file in planned.files if file.endswith("model-form.xml"))
            (out / system).write_bytes(model_form_xml(form, aircraft, float(name.split()[0])))
        variants[name] = find_aircraft(out)
    best = dict.fromkeys(variants, math.inf)
    for _ in range(rounds):
        for name, variant in variants.items():
            best[name] = min(best[name], _seconds(variant, script) / STEPS * 1e6)
    return best


def _seconds(aircraft: Aircraft, script: str) -> float:
    with StagedMission(aircraft, find_script(script)) as mission:
        fdm = mission.open()
        engine.run_ic(fdm)
        run = fdm.run
        start = time.process_time()
        for _ in range(STEPS):
            run()
        return time.process_time() - start


def hold_error(
    aircraft: Aircraft, form: ModelForm, script: str, turbulence: str, minutes: float, folder: Path
) -> tuple[NDArray[np.float64], float]:
    """(rates, 6) rms of published minus present upper bound over the mean of the latter; share of time outside the data."""
    out = folder / f"hold-{turbulence}" / aircraft.name
    out.parent.mkdir(parents=True)
    planned = plan(aircraft, Bounds(form))
    write(aircraft, planned, out)
    system = next(file for file in planned.files if file.endswith("model-form.xml"))
    (out / system).write_bytes(model_form_xml(form, aircraft, 1.0 / aircraft.dt_s))
    spec = FlightSpec(
        out,
        Path(script),
        duration_s=60.0 * minutes,
        wind_mps=2.0,
        turbulence=turbulence,
        turbulence_source="jsbsim",
    )
    with StagedMission(find_aircraft(out), find_script(script)) as mission:
        fdm = mission.open()
        set_conditions(fdm, mission, spec)
        engine.run_ic(fdm)
        upper = [engine.handle(fdm, f"uq/{c}/upper").get_double_value for c in form.coefficients]
        sources = [state_source(state, aircraft) for state in form.states]
        state = [engine.handle(fdm, name).get_double_value for name, _ in sources]
        published, seen = [], []
        for _ in range(round(60.0 * minutes / fdm.get_delta_t())):
            fdm.run()
            published.append([get() for get in upper])
            seen.append([get() for get in state])
        step = fdm.get_delta_t()
    start = round(60.0 / step)
    columns = (np.array(seen)[start:] * [factor for _, factor in sources]).T
    states = dict(zip(form.states, columns, strict=True))
    bounds = form.bounds(states)
    present = np.column_stack([bounds[c][1] for c in form.coefficients])
    late = np.array(published)[start:]
    errors = []
    for rate in RATES_HZ:
        every = max(1, round(1.0 / (rate * step)))
        held = np.repeat(late[::every], every, axis=0)[: len(present)]
        errors.append(np.sqrt(np.mean((held - present) ** 2, axis=0)) / present.mean(axis=0))
    return np.array(errors), float(form.extrapolated(states).mean())


def main(argv: list[str] | None = None) -> int:
    """Run the study; the process's exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m campaigns.model-form.cost", description="Cost and hold error of bounds."
    )
    parser.add_argument("aircraft", metavar="AIRCRAFT")
    parser.add_argument(
        "--bounds", type=Path, required=True, metavar="FILE", help="model-form.json"
    )
    parser.add_argument("--script", default="loiter", help="mission flown (default %(default)s)")
    parser.add_argument("--rounds", type=int, default=8, metavar="N", help="default %(default)s")
    parser.add_argument(
        "--minutes",
        type=float,
        default=10.0,
        metavar="M",
        help="of each hold flight (default %(default)s)",
    )
    arguments = parser.parse_args(argv)
    aircraft, form = find_aircraft(arguments.aircraft), read_model_form(arguments.bounds)
    with scratch_folder() as scratch:
        best = cost(aircraft, form, arguments.script, arguments.rounds, scratch.path)
        print(
            "| variant | us per step | more than no plugin | more than constant bounds |\n|---|---|---|---|"
        )
        for name, us in best.items():
            print(
                f"| {name} | {us:.2f} | {us - best['no plugin']:.2f} | {us - best['constant bounds']:.2f} |"
            )
        print(
            f"\n| turbulence | bounds at | {' | '.join(form.coefficients)} |\n|---|---|{'---|' * len(form.coefficients)}",
            flush=True,
        )
        for turbulence in ("light", "moderate", "severe"):
            errors, outside = hold_error(
                aircraft, form, arguments.script, turbulence, arguments.minutes, scratch.path
            )
            for rate, row in zip(RATES_HZ, errors, strict=True):
                print(
                    f"| {turbulence}, {outside:.0%} outside | {rate:g} Hz | {' | '.join(f'{value:.3f}' for value in row)} |",
                    flush=True,
                )
    return 0


if __name__ == "__main__":
    sys.exit(main())
