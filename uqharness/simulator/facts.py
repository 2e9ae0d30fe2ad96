"""An aircraft in the middle of its envelope, with every axis in motion: what checks fly that know
nothing of the aircraft.
"""

from __future__ import annotations

import functools
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from sysid.units import FT_M, LBF_N, RAD_DEG
from uqharness.child_process import give_answer, run_module
from uqharness.errors import BadInputError
from uqharness.simulator import engine
from uqharness.simulator.aircraft import Aircraft, find_aircraft, open_aircraft
from uqharness.simulator.forced_state import (
    TRIM_LATITUDE_DEG,
    BodyState,
    body_velocity,
    control_equilibrium,
    open_forced,
    set_control,
    still_moving,
    written_by_components,
)
from uqharness.simulator.staging import staged

_LIFT_COEFFICIENT = 0.5
_SPEEDS_FPS = (40.0, 900.0)
_ALTITUDE_FT = 5000.0
ALTITUDE_M = _ALTITUDE_FT * FT_M
THROTTLE = 0.6
_ALPHA, _BETA, _PHI, _THETA = (math.radians(angle) for angle in (4.0, 2.0, 5.0, 3.0))
_RATES_RADPS = (0.03, 0.02, -0.02)


def open_mid_envelope(
    aircraft: Aircraft, dt_s: float | None = None
) -> tuple[Any, Callable[[int], None]]:
    """An initialised instance in the middle of the aircraft's envelope, and a function that flies
    frame k.

    Level at 5000 ft above the sea, at the speed where a lift coefficient of 0.5 carries the weight
    (12 to 274 m/s), with a little incidence, sideslip and rotation; engines run settled at 60 % and
    the controls move, so that no axis is idle. Raises BadInputError."""
    state = mid_envelope_state(aircraft)
    speed_fps = math.hypot(state.u, state.v, state.w) / FT_M
    fdm = _open(aircraft, dt_s)
    _initial(fdm, speed_fps)
    engines = fdm.get_propulsion().get_num_engines()
    if engines:
        # A propeller that is let go at rest gives some electric aircraft a torque in the first
        # frames that ends the flight.
        engine.start_engines(fdm)
        for k in range(engines):
            fdm["fcs/throttle-cmd-norm" + (f"[{k}]" if k else "")] = THROTTLE
    engine.run_ic(fdm)
    if engines:
        engine.settle_engines(fdm)
    dt = fdm.get_delta_t()
    surfaces = [
        (engine.handle(fdm, f"fcs/{name}-cmd-norm").set_double_value, 2.0 * math.pi * rate * dt)
        for name, rate in (("elevator", 0.5), ("aileron", 0.7), ("rudder", 0.3))
    ]

    def step(k: int) -> None:
        for set_command, phase in surfaces:
            set_command(0.05 * math.sin(phase * k))
        fdm.run()

    return fdm, step


def mid_envelope_state(aircraft: Aircraft) -> BodyState:
    """The state of `open_mid_envelope`. Raises BadInputError."""
    fdm = _open(aircraft, None)
    _initial(fdm, 150.0)
    engine.run_ic(fdm)
    weight, area, rho = (
        fdm[n] for n in ("inertia/weight-lbs", "metrics/Sw-sqft", "atmosphere/rho-slugs_ft3")
    )
    speed_fps = math.sqrt(2.0 * weight / (rho * max(area, 1e-3) * _LIFT_COEFFICIENT))
    V_mps = min(max(speed_fps, _SPEEDS_FPS[0]), _SPEEDS_FPS[1]) * FT_M
    return BodyState(*body_velocity(V_mps, _ALPHA, _BETA), _PHI, _THETA, 0.0, *_RATES_RADPS)


def _open(aircraft: Aircraft, dt_s: float | None) -> Any:
    return engine.open_fdm(staged(aircraft), dt_s or aircraft.dt_s)


def _initial(fdm: Any, speed_fps: float) -> None:
    fdm["ic/lat-geod-deg"], fdm["ic/h-sl-ft"] = TRIM_LATITUDE_DEG, _ALTITUDE_FT
    fdm["ic/theta-rad"], fdm["ic/phi-rad"] = _THETA, _PHI
    for name, value in zip("uvw", body_velocity(speed_fps, _ALPHA, _BETA), strict=True):
        fdm[f"ic/{name}-fps"] = value
    for name, value in zip("pqr", _RATES_RADPS, strict=True):
        fdm[f"ic/{name}-rad_sec"] = value


# What an aircraft without a card answers when it is asked: reference, which controls act, in
# which sense, throws and thrust.
#
# Each of JSBSim's normalised commands is held at -1, -0.5, 0, 0.5 and 1 with the aircraft's
# motion frozen in the middle of its envelope, as a trim does: engines are started and settled,
# the control system is brought to rest. The sense is read from angular accelerations, the throw
# from a surface that has come to rest, the thrust from engines that have settled. No answer
# depends on whether the aircraft is stable. A control that shows no effect there is held in a
# short flight. All this runs in a process of its own, because an aircraft from anywhere may end
# its interpreter.

_COMMANDS = (-1.0, -0.5, 0.0, 0.5, 1.0, -1.0)  # the first once more: what then differs is drift
_LINEAR_SHARE = 0.01  # of the throw: how far the middle may lie from halfway between the ends
_MIN_ANSWER = (
    1e-6  # rad/s2, lbf; smaller answers may be engines that still settle, and a flight decides
)
_MIN_RATE_CHANGE = 1e-9  # rad/s, ft/s: a control that moves nothing leaves a flight bit-identical
_MIN_TRAVEL = 1e-6  # deg or rad
_TURNING_RADPS = 0.1
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
# What FlightGear passes to JSBSim's engines before a frame and takes from them after it (its
# src/FDM/JSBSim/JSBSim.cxx).
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
# Acceleration that answers to a control, and whether the positive command of the record's
# convention makes it positive.
_RESPONSE = {
    "elevator": ("accelerations/qdot-rad_sec2", -1),
    "aileron": ("accelerations/pdot-rad_sec2", 1),
    "rudder": ("accelerations/rdot-rad_sec2", -1),
}
_RATE = {
    "elevator": ("velocities/q-rad_sec", -1),
    "aileron": ("velocities/p-rad_sec", 1),
    "rudder": ("velocities/r-rad_sec", -1),
}
_SURFACE_HELD_S, _THROTTLE_HELD_S = 0.5, 3.5
_FORWARD = "forces/fbx-total-lbs"
_THRUST = "thrust-lbs"


@dataclass(frozen=True)
class ControlFacts:
    """One normalised command. sense: +1 as the record counts (nose down, right wing down, nose
    left), -1 opposite, 0 no answer.

    throw_deg    degrees per norm, mean of both ends, positive; None where no position property
    follows
    position     the property that follows, None where its travel is not in proportion to the
    command
    thrust_N     of all engines, settled, throttle closed and open; None where there is no engine or
    it does not settle unmeasured   why the control could not be measured: ``sense`` is then
    assumed; empty where it was"""

    sense: int
    throw_deg: float | None = None
    position: str | None = None
    thrust_N: tuple[float, float] | None = None
    unmeasured: str = ""


@dataclass(frozen=True)
class AircraftFacts:
    """Reference lengths by JSBSim's metrics, number of engines, and the controls.

    host       (FlightGear's property, JSBSim's own) of what the aircraft reads of FlightGear and
    nothing in JSBSim alone writes
    V_mps      airspeed at which the controls were measured, at ALTITUDE_M above the sea; NaN where
    nothing was"""

    S_m2: float
    b_m: float
    c_m: float
    engines: int
    controls: Mapping[str, ControlFacts] = field(default_factory=dict)
    host: tuple[tuple[str, str], ...] = ()
    V_mps: float = math.nan


def assumed_facts(S_m2: float, b_m: float, c_m: float) -> AircraftFacts:
    """What is taken for granted of an aircraft that does not fly by itself: JSBSim's commands in
    the usual sense, no throws.
    """
    return AircraftFacts(
        S_m2, b_m, c_m, 1, {name: ControlFacts(1) for name in (*_RESPONSE, "throttle")}
    )


def measure_facts(folder: Path) -> AircraftFacts:
    """The facts, asked for in this process. Raises BadInputError."""
    aircraft = find_aircraft(folder)
    controls = {
        name: _control_facts(
            name,
            _hold_commands(aircraft, name, _COMMANDS),
            functools.partial(_hold_commands, aircraft, name, _COMMANDS, _TURNING_RADPS),
        )
        for name in _RESPONSE
    }
    closed, opened = (_hold_commands(aircraft, "throttle", (value,))[0] for value in (0.0, 1.0))
    host = _host_properties(aircraft)
    throttle = _throttle_facts(closed, opened)
    if not throttle.sense and any(
        jsbsim_name == "fcs/throttle-cmd-norm" for _, jsbsim_name in host
    ):
        throttle = ControlFacts(1)
    controls["throttle"] = throttle
    # A control law may be at its limit at rest, whatever the command: a flight has the last word on
    # a control without effect.
    controls |= {
        name: _in_flight(aircraft, name) for name, facts in controls.items() if not facts.sense
    }
    S, b, c = (opened.values[name] for name in _METRICS)
    return AircraftFacts(
        S * FT_M**2,
        b * FT_M,
        c * FT_M,
        opened.engines,
        controls,
        host,
        opened.values["velocities/vt-fps"] * FT_M,
    )


def _host_properties(aircraft: Aircraft) -> tuple[tuple[str, str], ...]:
    fdm = open_aircraft(aircraft)
    exists, written_properties = fdm.get_property_manager().hasNode, written_by_components(aircraft)
    pairs = []
    for k in range(fdm.get_propulsion().get_num_engines()):
        index = f"[{k}]" if k else ""
        for host_name, jsbsim_name in _FLIGHTGEAR:
            pair = host_name.format(index), jsbsim_name.format(index)
            if all(map(exists, pair)) and pair[0] not in written_properties:
                pairs.append(pair)
    return tuple(pairs)


@dataclass(frozen=True)
class _HeldState:
    """The aircraft with one command held.

    values     of properties; positions: of the surfaces at rest
    unsettled  what of the engines does not settle
    """

    values: Mapping[str, float]
    positions: Mapping[str, float] = field(default_factory=dict)
    engines: int = 0
    unsettled: str = ""


def _hold_commands(
    aircraft: Aircraft, control: str, commands: Sequence[float], rate_radps: float = 0.0
) -> list[_HeldState]:
    """The aircraft with one command after the other held until all has come to rest.

    Raises BadInputError.
    """
    flying = mid_envelope_state(aircraft)
    # Straight and level: dampers would add to the commands.
    rates = (rate_radps,) * 3
    state = BodyState(flying.u, 0.0, flying.w, 0.0, flying.theta, flying.psi, *rates)
    exists = open_aircraft(aircraft).get_property_manager().hasNode
    controls = {
        name: setting
        for name, setting in {"throttle": THROTTLE, control: commands[0]}.items()
        if exists(aircraft.card.inputs[name].property)
    }
    fdm, unsettled = open_forced(aircraft, state, controls, ALTITUDE_M, None)
    equilibrium = control_equilibrium(aircraft, fdm)
    engines = fdm.get_propulsion().get_num_engines()
    names = [name for group in _POSITIONS.values() for name in group if exists(name)]
    values = [*_METRICS, "velocities/vt-fps", _FORWARD, *(name for name, _ in _RESPONSE.values())]
    rows = []
    for command in commands:
        if control in controls:
            set_control(fdm, aircraft, control, command)
        moving = still_moving(fdm, equilibrium, names)
        # A surface that still moves is led by more than its command: a control law, or an
        # autopilot.
        positions = {name: float(fdm[name]) for name in names if name not in moving}
        thrust = sum(fdm[f"propulsion/engine[{k}]/{_THRUST}"] for k in range(engines))
        read = {name: float(fdm[name]) for name in values} | {_THRUST: float(thrust)}
        rows.append(_HeldState(read, positions, engines, unsettled))
    return rows


def _in_flight(aircraft: Aircraft, control: str) -> ControlFacts:
    """The sense that a short flight shows with the command held at either end; "moves nothing"
    where a finite one shows none.
    """
    rate, sign = _RATE.get(control, ("velocities/vt-fps", 1))
    ends = (0.0, 1.0) if control == "throttle" else (-1.0, 1.0)
    answers = []
    for value in ends:
        fdm, _ = open_mid_envelope(aircraft)
        name = aircraft.card.inputs[control].property
        if fdm.get_property_manager().hasNode(name):
            set_control(fdm, aircraft, control, value)
        held_s = _THROTTLE_HELD_S if control == "throttle" else _SURFACE_HELD_S
        for _ in range(round(held_s / fdm.get_delta_t())):
            fdm.run()
        answers.append(float(fdm[rate]))
    if not all(map(math.isfinite, answers)):
        return ControlFacts(1, unmeasured=f"the flight does not stay finite with {control} held")
    change = answers[1] - answers[0]
    return ControlFacts(
        0 if not abs(change) > _MIN_RATE_CHANGE else sign if change > 0.0 else -sign
    )


def _control_facts(
    control: str, rows: Sequence[_HeldState], turning: Callable[[], Sequence[_HeldState]]
) -> ControlFacts:
    """Sense and throw by what was held.

    ``turning`` gives the same rows with the aircraft turning.
    """
    name, sign = _RESPONSE[control]
    answers = [row.values[name] for row in rows]
    if not all(map(math.isfinite, answers)):
        return ControlFacts(1, unmeasured=f"{name} is not finite with {control} held")
    low, high, repeated = answers[0], answers[-2], answers[-1]
    # What goes on changing by itself, such as the gas of a balloon, is no answer to the command.
    if not abs(high - low) > max(_MIN_ANSWER, 10.0 * abs(repeated - low)):
        return ControlFacts(0)
    sense = sign if high > low else -sign
    for name in _POSITIONS[control]:
        ends = [
            row.positions[name] * (RAD_DEG if name.endswith("rad") else 1.0)
            for row in rows
            if name in row.positions
        ]
        if len(ends) < len(rows) or not all(map(math.isfinite, ends)):
            continue
        lowest, half_down, middle, half_up, highest, _ = ends
        throw = 0.5 * abs(highest - lowest)
        limited = min(abs(highest - half_up), abs(lowest - half_down)) <= _LINEAR_SHARE * throw
        if throw > _MIN_TRAVEL and not (limited and _depends_on_motion(name, rows, turning())):
            is_linear = (
                not limited and abs(middle - 0.5 * (lowest + highest)) <= _LINEAR_SHARE * throw
            )
            return ControlFacts(
                sense, round(throw, 6), name if is_linear and highest > lowest else None
            )
    return ControlFacts(sense)


def _depends_on_motion(
    position: str, rows: Sequence[_HeldState], turning: Sequence[_HeldState]
) -> bool:
    """Whether the motion moves the surface too: the end of its travel is then a control law's
    limit, not the command's throw.
    """
    return any(
        abs(row.positions[position] - other.positions.get(position, math.inf)) > _MIN_TRAVEL
        for row, other in zip(rows, turning, strict=True)
    )


def _throttle_facts(closed: _HeldState, opened: _HeldState) -> ControlFacts:
    """Sense and thrust of the throttle: of the engines, or of what pulls the aircraft forward where
    it has none.
    """
    name = _THRUST if opened.engines else _FORWARD
    thrust = closed.values[name], opened.values[name]
    if not all(map(math.isfinite, thrust)):
        return ControlFacts(1, unmeasured="the thrust is not finite with the throttle held")
    if opened.unsettled:
        return ControlFacts(1, unmeasured=f"with the throttle open, {opened.unsettled}")
    sense = int(thrust[1] - thrust[0] > _MIN_ANSWER)
    if not sense or not opened.engines or closed.unsettled:
        return ControlFacts(sense)
    return ControlFacts(sense, thrust_N=(thrust[0] * LBF_N, thrust[1] * LBF_N))


def measure_facts_in_child(folder: Path, timeout_s: float = 300.0) -> AircraftFacts:
    """The same in a process of its own. Raises BadInputError with its last words."""
    child = run_module(__name__, folder, timeout_s=timeout_s)
    if child.code is None:
        raise BadInputError(f"aircraft {folder}: was not measured within {timeout_s:g} s")
    if child.code or not child.answer:
        words = child.errors or "no message"
        raise BadInputError(
            f"aircraft {folder}: does not fly in JSBSim as it is ({words}); mend that first"
        )
    if "error" in child.answer:
        raise BadInputError(
            f"aircraft {folder}: does not fly in JSBSim as it is: {child.answer['error']}"
        )
    controls = {
        name: ControlFacts(**{**facts, "thrust_N": facts["thrust_N"] and tuple(facts["thrust_N"])})
        for name, facts in child.answer["controls"].items()
    }
    host = tuple((host_name, jsbsim_name) for host_name, jsbsim_name in child.answer["host"])
    return AircraftFacts(**{**child.answer, "controls": controls, "host": host})


def _main(folder: str) -> None:
    try:
        give_answer(asdict(measure_facts(Path(folder))))
    except (BadInputError, engine.RuntimeFailure) as error:
        give_answer({"error": " ".join(str(error).split())})


if __name__ == "__main__":
    _main(sys.argv[1])
