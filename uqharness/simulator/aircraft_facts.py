"""What an aircraft without a card answers when it is asked: reference, which controls act, in which sense, and their throws.

Each of JSBSim's normalised commands is held at -1, 0 and 1 in the same flight: after half a second the sense is read from body
rates and speed, after three the throw from a surface that has come to rest. Runs in a process of its own, because an aircraft from
anywhere may end its interpreter.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from sysid.units import FT_M, RAD_DEG
from uqharness.child_process import give_answer, run_module
from uqharness.errors import BadInputError
from uqharness.simulator import engine
from uqharness.simulator.aircraft import Aircraft, find_aircraft, open_aircraft
from uqharness.simulator.control_system import written_by_components
from uqharness.simulator.mid_envelope import open_mid_envelope

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
# What FlightGear passes to JSBSim's engines before a frame and takes from them after it (its src/FDM/JSBSim/JSBSim.cxx).
_FLIGHTGEAR = (
    ("/controls/engines/engine{}/throttle", "fcs/throttle-cmd-norm{}"),
    ("/controls/engines/engine{}/mixture", "fcs/mixture-cmd-norm{}"),
    ("/controls/engines/engine{}/propeller-pitch", "fcs/advance-cmd-norm{}"),
    ("/engines/engine{}/mp-inhg", "propulsion/engine{}/map-inhg"),
    ("/engines/engine{}/rpm", "propulsion/engine{}/engine-rpm"),
    ("/engines/engine{}/n1", "propulsion/engine{}/n1"),
    ("/engines/engine{}/n2", "propulsion/engine{}/n2"),
    ("/engines/engine{}/cht-degf", "propulsion/engine{}/cht-degF"),
    ("/engines/engine{}/oil-temperature-degf", "propulsion/engine{}/oil-temperature-degF"),
    ("/engines/engine{}/oil-pressure-psi", "propulsion/engine{}/oil-pressure-psi"),
)
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
    """Reference lengths by JSBSim's metrics, number of engines, and the controls.

    host  (FlightGear's property, JSBSim's own) of what the aircraft reads of FlightGear and nothing in JSBSim alone writes
    """

    S_m2: float
    b_m: float
    c_m: float
    engines: int
    controls: Mapping[str, ControlFacts] = field(default_factory=dict)
    host: tuple[tuple[str, str], ...] = ()


def assumed(S_m2: float, b_m: float, c_m: float) -> AircraftFacts:
    """What is taken for granted of an aircraft that does not fly by itself: JSBSim's commands in the usual sense, no throws."""
    return AircraftFacts(
        S_m2, b_m, c_m, 1, {name: ControlFacts(1) for name in (*_ANSWER, "throttle")}
    )


def ask(folder: Path) -> AircraftFacts:
    """The facts, asked for in this process. Raises BadInputError."""
    aircraft = find_aircraft(folder)
    held = {}
    for control in _ANSWER:
        held[control] = [_held(aircraft, control, value) for value in (-1.0, 0.0, 1.0)]
    throttle = [_held(aircraft, "throttle", value)["velocities/vt-fps"] for value in (0.0, 1.0)]
    any_flight = held["elevator"][1]
    controls = {name: _facts(name, rows) for name, rows in held.items()}
    host = _of_host(aircraft)
    moves = throttle[1] > throttle[0] or any(own == "fcs/throttle-cmd-norm" for _, own in host)
    controls["throttle"] = ControlFacts(int(moves))
    S, b, c = (any_flight[name] for name in _METRICS)
    return AircraftFacts(
        S * FT_M**2, b * FT_M, c * FT_M, int(any_flight["engines"]), controls, host
    )


def _of_host(aircraft: Aircraft) -> tuple[tuple[str, str], ...]:
    fdm = open_aircraft(aircraft)
    exists, written = fdm.get_property_manager().hasNode, written_by_components(aircraft)
    found = []
    for k in range(fdm.get_propulsion().get_num_engines()):
        index = f"[{k}]" if k else ""
        for theirs, own in _FLIGHTGEAR:
            pair = theirs.format(index), own.format(index)
            if all(map(exists, pair)) and pair[0] not in written:
                found.append(pair)
    return tuple(found)


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
    # A control that moves nothing leaves the flight bit-identical.
    if not abs(high - low) > 1e-9:
        return ControlFacts(0)
    sense = sign if high > low else -sign
    for name in _POSITIONS[control]:
        ends = [
            row[name] * (RAD_DEG if name.endswith("rad") else 1.0) for row in rows if name in row
        ]
        if len(ends) == 3 and abs(ends[2] - ends[0]) > 1e-6:
            throw = 0.5 * abs(ends[2] - ends[0])
            straight = abs(ends[1] - 0.5 * (ends[0] + ends[2])) <= _LINEAR * throw
            return ControlFacts(
                sense, round(throw, 6), name if straight and ends[2] > ends[0] else None
            )
    return ControlFacts(sense)


def ask_in_child(folder: Path, timeout_s: float = 120.0) -> AircraftFacts:
    """The same in a process of its own. Raises BadInputError with its last words."""
    ended = run_module(__name__, folder, timeout_s=timeout_s)
    if ended.code is None:
        raise BadInputError(f"aircraft {folder}: did not fly half a second within {timeout_s:g} s")
    if ended.code or not ended.answer:
        words = ended.errors or "no message"
        raise BadInputError(
            f"aircraft {folder}: does not fly in JSBSim as it is ({words}); mend that first"
        )
    if "error" in ended.answer:
        raise BadInputError(
            f"aircraft {folder}: does not fly in JSBSim as it is: {ended.answer['error']}"
        )
    controls = {name: ControlFacts(**facts) for name, facts in ended.answer["controls"].items()}
    host = tuple((theirs, own) for theirs, own in ended.answer["host"])
    return AircraftFacts(**{**ended.answer, "controls": controls, "host": host})


def _main(folder: str) -> None:
    try:
        give_answer(asdict(ask(Path(folder))))
    except (BadInputError, engine.RuntimeFailure) as error:
        give_answer({"error": " ".join(str(error).split())})


if __name__ == "__main__":
    _main(sys.argv[1])
