"""What bounds computed in JSBSim cost per step, and what holding them between two computations
costs in accuracy.

    python -m campaigns.model-form.cost AIRCRAFT --bounds model-form.json [--rounds N] [--minutes M]

The aircraft without a plugin, with constant bounds and with the model form's at several rates take
turns; processor time, least of all rounds. For the hold error one flight in turbulence records the
bounds that the system publishes in every step, and the states of the step, from which sysid
computes the bounds due: the difference is the age of airspeed and incidence, and the hold.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from campaigns.library.study import study_parser
from sysid.arrays import FloatArray
from sysid.model_form.model_form import ModelForm, read_model_form
from uqharness.cli.benchmark_loop import without_plugin
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


def with_bounds(
    aircraft: Aircraft, form: ModelForm | None, folder: Path, rate_hz: float = 0.0
) -> Aircraft:
    """Write a copy of the aircraft with constant bounds, or with those of a model form at a
    rate."""
    out = folder / aircraft.name
    out.parent.mkdir(parents=True)
    planned = plan(aircraft, Bounds(form))
    write(aircraft, planned, out)
    if form is not None:
        system = next(file for file in planned.files if file.endswith("model-form.xml"))
        (out / system).write_bytes(model_form_xml(form, aircraft, rate_hz))
    return find_aircraft(out)


def cost(
    aircraft: Aircraft, form: ModelForm, script: str, rounds: int, folder: Path
) -> dict[str, float]:
    """Measure microseconds of processor time per step by variant."""
    variants = {"no plugin": without_plugin(aircraft, folder / "none")}
    variants["constant bounds"] = with_bounds(aircraft, None, folder / "constant-bounds")
    for rate in RATES_HZ:
        variants[f"{rate:g} Hz"] = with_bounds(aircraft, form, folder / f"{rate:g}-Hz", rate)
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
) -> tuple[FloatArray, float]:
    """Return (rates, 6) rms of published minus due upper bound over the latter's mean, and the
    share of time outside the data."""
    copy = with_bounds(aircraft, form, folder / f"hold-{turbulence}", 1.0 / aircraft.dt_s)
    spec = FlightSpec(
        copy.folder,
        Path(script),
        duration_s=60.0 * minutes,
        wind_mps=2.0,
        turbulence=turbulence,
        turbulence_source="jsbsim",
    )
    with StagedMission(copy, find_script(script)) as mission:
        fdm = mission.open()
        set_conditions(fdm, mission, spec)
        engine.run_ic(fdm)
        sources = [state_source(state, aircraft) for state in form.states]
        names = [f"uq/{c}/upper" for c in form.coefficients] + [name for name, _ in sources]
        getters = [engine.handle(fdm, name).get_double_value for name in names]
        rows = []
        for _ in range(round(60.0 * minutes / fdm.get_delta_t())):
            fdm.run()
            rows.append([get() for get in getters])
        step = fdm.get_delta_t()
    # The first minute is left out.
    table, n = np.array(rows)[round(60.0 / step) :], len(form.coefficients)
    columns = (table[:, n:] * [factor for _, factor in sources]).T
    states = dict(zip(form.states, columns, strict=True))
    bounds = form.bounds(states)
    due = np.column_stack([bounds[c][1] for c in form.coefficients])
    errors = []
    for rate in RATES_HZ:
        every = max(1, round(1.0 / (rate * step)))
        latched = np.repeat(table[::every, :n], every, axis=0)[: len(due)]
        errors.append(np.sqrt(np.mean((latched - due) ** 2, axis=0)) / due.mean(axis=0))
    return np.array(errors), float(form.extrapolated(states).mean())


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study and return the process's exit code."""
    parser = study_parser(__doc__)
    option = parser.add_argument
    option("aircraft", metavar="AIRCRAFT")
    option("--bounds", type=Path, required=True, metavar="FILE", help="model-form.json")
    option("--script", default="loiter", help="mission flown (default %(default)s)")
    option("--rounds", type=int, default=8, metavar="N", help="default %(default)s")
    option("--minutes", type=float, default=10.0, metavar="M", help="of each hold flight (10)")
    args = parser.parse_args(argv)
    aircraft, form = find_aircraft(args.aircraft), read_model_form(args.bounds)
    with scratch_folder() as scratch:
        best = cost(aircraft, form, args.script, args.rounds, scratch.path)
        print("| variant | us per step | more than no plugin | more than constant bounds |")
        print("|---|---|---|---|")
        for name, us in best.items():
            more = us - best["no plugin"], us - best["constant bounds"]
            print(f"| {name} | {us:.2f} | {more[0]:.2f} | {more[1]:.2f} |")
        print(f"\n| turbulence | bounds at | {' | '.join(form.coefficients)} |")
        print(f"|---|---|{'---|' * len(form.coefficients)}", flush=True)
        flight = (args.minutes, scratch.path)
        for turbulence in ("light", "moderate", "severe"):
            errors, outside = hold_error(aircraft, form, args.script, turbulence, *flight)
            for rate, row in zip(RATES_HZ, errors, strict=True):
                cells = " | ".join(f"{value:.3f}" for value in row)
                place = f"{turbulence}, {outside:.0%} outside"
                print(f"| {place} | {rate:g} Hz | {cells} |", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
