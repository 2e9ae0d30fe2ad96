"""What an aircraft without a card answers when it is asked: reference, which controls act, in which sense, and their throws.

Each of JSBSim's normalised commands is held at -1, 0 and 1 in the same flight: after half a second the sense is read from body
rates and speed, after three the throw from a surface that has come to rest. Runs in a process of its own, because an aircraft from
anywhere may end its interpreter.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from uqharness.errors import BadInputError
from uqharness.simulator import engine
from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.mid_envelope import open_mid_envelope
from uqharness.simulator.preflight import child_environment

_FT = 0.3048
_HELD_S, _RESTED_S = 0.5, 3.0
_LINEAR = 0.01  # of the throw: how far the middle may lie from halfway between the ends
_METRICS = ("metrics/Sw-sqft", "metrics/bw-ft", "metrics/cbarw-ft")
_POSITIONS = {
    "elevator": ("fcs/elevator-pos-deg", "fcs/elevator-pos-rad"),
    "aileron": (
        "fcs/left-aileron-pos-deg",
        "fcs/left-aileron-pos-rad",
        "fcs/right-aileron-pos-deg",
        "fcs/aileron-pos-deg",
    ),
    "rudder": ("fcs/rudder-pos-deg", "fcs/rudder-pos-rad"),
}
# Rate that answers to a control, and whether the positive command of the record's convention makes it positive.
_ANSWER = {
    "elevator": ("velocities/q-rad_sec", -1),
    "aileron": ("velocities/p-rad_sec", 1),
    "rudder": ("velocities/r-rad_sec", -1),
}


@dataclass(frozen=True)
class ControlFacts:
    """One normalised command. sense: +1 as the record counts (nose down, right wing down, nose left), -1 opposite, 0 no answer.

    throw_deg    degrees per norm, mean of both ends, positive; None where no position property follows
    position     the property that follows, None where its travel is not in proportion to the command
    """

    sense: int
    throw_deg: float | None = None
    position: str | None = None


@dataclass(frozen=True)
class AircraftFacts:
    """Reference lengths by JSBSim's metrics, number of engines, and the controls."""

    S_m2: float
    b_m: float
    c_m: float
    engines: int
    controls: Mapping[str, ControlFacts] = field(default_factory=dict)


def assumed(S_m2: float, b_m: float, c_m: float) -> AircraftFacts:
    """What is taken for granted of an aircraft that does not fly by itself: JSBSim's commands in the usual sense, no throws."""
    return AircraftFacts(S_m2, b_m, c_m, 1, {name: ControlFacts(1) for name in (*_ANSWER, "throttle")})


def ask(folder: Path) -> AircraftFacts:
    """The facts, asked for in this process. Raises BadInputError."""
    aircraft = find_aircraft(folder)
    held = {}
    for control in _ANSWER:
        held[control] = [_held(aircraft, control, value) for value in (-1.0, 0.0, 1.0)]
    throttle = [_held(aircraft, "throttle", value)["velocities/vt-fps"] for value in (0.0, 1.0)]
    any_flight = held["elevator"][1]
    controls = {name: _facts(name, rows) for name, rows in held.items()}
    controls["throttle"] = ControlFacts(int(throttle[1] > throttle[0]))
    S, b, c = (any_flight[name] for name in _METRICS)
    return AircraftFacts(S * _FT**2, b * _FT, c * _FT, int(any_flight["engines"]), controls)


def _held(aircraft: Any, control: str, value: float) -> dict[str, float]:
    fdm, _ = open_mid_envelope(aircraft)
    engines = fdm.get_propulsion().get_num_engines()
    name = f"fcs/{control}-cmd-norm"
    if fdm.get_property_manager().hasNode(name):
        fdm[name] = value
        for k in range(1, engines if control == "throttle" else 0):
            fdm[f"{name}[{k}]"] = value
    dt = fdm.get_delta_t()
    manager = fdm.get_property_manager()
    _run(fdm, _HELD_S / dt)
    wanted = ["velocities/vt-fps", *_METRICS, *(n for n, _ in _ANSWER.values())]
    out = {"engines": float(engines), **{n: float(fdm[n]) for n in wanted}}
    positions = [n for group in _POSITIONS.values() for n in group if manager.hasNode(n)]
    _run(fdm, (_RESTED_S - _HELD_S) / dt)
    before = {n: fdm[n] for n in positions}
    _run(fdm, _HELD_S / dt)
    # A surface that still moves is led by more than its command: a control law, or an autopilot.
    return out | {n: float(fdm[n]) for n in positions if abs(fdm[n] - before[n]) <= 1e-6}


def _run(fdm: Any, frames: float) -> None:
    for _ in range(round(frames)):
        fdm.run()


def _facts(control: str, rows: list[dict[str, float]]) -> ControlFacts:
    rate, sign = _ANSWER[control]
    low, _, high = (row[rate] for row in rows)
    # A control that moves nothing leaves the flight the same to the last bit.
    if not abs(high - low) > 1e-9:
        return ControlFacts(0)
    sense = sign if high > low else -sign
    for name in _POSITIONS[control]:
        ends = [row[name] * (57.29577951308232 if name.endswith("rad") else 1.0) for row in rows if name in row]
        if len(ends) == 3 and abs(ends[2] - ends[0]) > 1e-6:
            throw = 0.5 * abs(ends[2] - ends[0])
            straight = abs(ends[1] - 0.5 * (ends[0] + ends[2])) <= _LINEAR * throw
            return ControlFacts(sense, round(throw, 6), name if straight and ends[2] > ends[0] else None)
    return ControlFacts(sense)


def ask_in_child(folder: Path, timeout_s: float = 120.0) -> AircraftFacts:
    """The same in a process of its own. Raises BadInputError with its last words."""
    command = [sys.executable, "-m", "uqharness.simulator.aircraft_facts", str(folder)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, env=child_environment(), check=False)
    except subprocess.TimeoutExpired:
        raise BadInputError(f"aircraft {folder}: did not fly half a second within {timeout_s:g} s") from None
    lines = done.stdout.splitlines()
    if done.returncode or not lines:
        words = " ".join(done.stderr.split())[-300:] or "no message"
        raise BadInputError(f"aircraft {folder}: does not fly in JSBSim as it is ({words}); mend that first")
    row = json.loads(lines[-1])
    if "error" in row:
        raise BadInputError(f"aircraft {folder}: does not fly in JSBSim as it is: {row['error']}")
    row["controls"] = {name: ControlFacts(**facts) for name, facts in row["controls"].items()}
    return AircraftFacts(**row)


def _main(folder: str) -> int:
    try:
        print(json.dumps(asdict(ask(Path(folder)))), flush=True)
    except (BadInputError, engine.RuntimeFailure) as error:
        print(json.dumps({"error": " ".join(str(error).split())}), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(_main(sys.argv[1]))
