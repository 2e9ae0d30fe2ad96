"""Facts about an unknown aircraft: a flight in mid-envelope, and what its controls do.

`open_mid_envelope` starts any aircraft in level flight with all axes in motion. `measure_facts`
measures the sense and throw of each control and the thrust, for an aircraft without a card. It runs
in a child process (`measure_facts_in_child`), because an unknown aircraft may crash the
interpreter.
"""

from __future__ import annotations

import functools
import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from sysid.units import FT_M, LBF_N, RAD_DEG
from uqharness.child_process import give_answer, run_module
from uqharness.errors import BadInputError
from uqharness.simulator import engine
from uqharness.simulator.aircraft import (
    Aircraft,
    find_aircraft,
    host_properties,
    model_files,
    open_aircraft,
    staged,
    with_step,
)
from uqharness.simulator.aircraft_checks import function_properties
from uqharness.simulator.forced_state import (
    TRIM_LATITUDE_DEG,
    BodyState,
    body_velocity,
    bring_to_rest,
    control_equilibrium,
    open_forced,
    set_control,
    still_moving,
)
from uqharness.simulator.host import HostProperty, scan

DT_S = 0.01
"""Integration step of an aircraft without a card [s]."""
_SHORTER_S = (0.005, 0.002, 0.001, 0.0005)
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
    """Return an initialised instance in the middle of the envelope, and a function that flies frame
    k.

    Level at 5000 ft, at the speed where a lift coefficient of 0.5 carries the weight (limited to 12
    to 274 m/s), with small incidence, sideslip and rates. Engines are settled at 60 % throttle and
    controls move, so that no axis is idle.

    Parameters
    ----------
    aircraft : Aircraft
        Any aircraft that loads.
    dt_s : float, optional
        Integration step [s].

    Raises
    ------
    BadInputError
        If it does not load or initialise.
    """
    state = mid_envelope_state(aircraft)
    speed_fps = math.hypot(state.u, state.v, state.w) / FT_M
    fdm = _open(aircraft, dt_s)
    _initial(fdm, speed_fps)
    engines = fdm.get_propulsion().get_num_engines()
    if engines:
        # Released at rest, some electric propellers give a torque that ends the flight at once.
        engine.start_engines(fdm)
        for name in engine.throttles(fdm)[0]:
            fdm[name] = THROTTLE
        throttle = aircraft.card.inputs.get("throttle")
        if throttle is not None and fdm.get_property_manager().hasNode(throttle.property):
            low, high = throttle.limits
            set_control(fdm, aircraft, "throttle", low + THROTTLE * (high - low))
    engine.run_ic(fdm)
    if engines:
        engine.settle_engines(fdm)
    dt = fdm.get_delta_t()
    # Different frequencies, so that axes move independently.
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
    """Return the state of `open_mid_envelope`. Raises BadInputError."""
    fdm = _open(aircraft, None)
    _initial(fdm, 150.0)
    engine.run_ic(fdm)
    weight, area, rho = (
        fdm[n] for n in ("inertia/weight-lbs", "metrics/Sw-sqft", "atmosphere/rho-slugs_ft3")
    )
    # W = rho/2 V^2 S CL.
    speed_fps = math.sqrt(2.0 * weight / (rho * max(area, 1e-3) * _LIFT_COEFFICIENT))
    V_mps = min(max(speed_fps, _SPEEDS_FPS[0]), _SPEEDS_FPS[1]) * FT_M
    return BodyState(*body_velocity(V_mps, _ALPHA, _BETA), _PHI, _THETA, 0.0, *_RATES_RADPS)


def _open(aircraft: Aircraft, dt_s: float | None) -> Any:
    """Return a new instance of the aircraft."""
    return engine.open_fdm(staged(aircraft), dt_s or aircraft.dt_s)


def _initial(fdm: Any, speed_fps: float) -> None:
    """Set the initial conditions in mid-envelope at an airspeed [ft/s]."""
    fdm["ic/lat-geod-deg"], fdm["ic/h-sl-ft"] = TRIM_LATITUDE_DEG, _ALTITUDE_FT
    fdm["ic/theta-rad"], fdm["ic/phi-rad"] = _THETA, _PHI
    for name, value in zip("uvw", body_velocity(speed_fps, _ALPHA, _BETA), strict=True):
        fdm[f"ic/{name}-fps"] = value
    for name, value in zip("pqr", _RATES_RADPS, strict=True):
        fdm[f"ic/{name}-rad_sec"] = value


# Measurement of the controls of an aircraft without a card. Each normalised command is held at -1,
# -0.5, 0, 0.5 and 1 with the motion frozen in mid-envelope, engines and control system settled.
# Angular accelerations give the sense, positions at rest the throw, settled engines the thrust.
# None of this depends on the aircraft's stability. A control without effect is tried in a short
# flight.

_COMMANDS = (-1.0, -0.5, 0.0, 0.5, 1.0, -1.0)  # the first once more: what then differs is drift
_LINEAR_SHARE = 0.01  # of the throw: how far the middle may lie from halfway between the ends
_MIN_ANSWER = (
    1e-6  # rad/s2, lbf; smaller answers may be engines that still settle, and a flight decides
)
_MIN_RATE_CHANGE = 1e-9  # rad/s, ft/s: a control that moves nothing leaves a flight bit-identical
_MIN_TRAVEL = 1e-6  # deg or rad
_LIKE_THROW_SHARE = 0.25  # by which a mean of surfaces may travel more or less than one of them
_FCS = re.compile(r"fcs/(?!.*(cmd|command))")
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
# Acceleration caused by a control, and its sign for a positive command of the record.
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
    """One normalised command.

    Attributes
    ----------
    sense : int
        +1 as in a record (nose down, right wing down, nose left), -1 opposite, 0 without effect.
    throw_deg : float or None
        Degrees per unit, mean of both ends, positive; None if no position property follows.
    position : str or None
        The property that follows in proportion.
    position_unit : str or None
        Its unit, "deg" or "rad", where its name has none.
    thrust_N : tuple of float or None
        Settled thrust of all engines [N], throttle closed and open; None without a value.
    unmeasured : str
        Why the control could not be measured, in which case `sense` is assumed; else empty.
    property : str
        The command; empty for JSBSim's.
    unit : str
        "norm", "pct" for a throttle in percent, or "deg" or "rad" for a surface's angle.
    """

    sense: int
    throw_deg: float | None = None
    position: str | None = None
    position_unit: str | None = None
    thrust_N: tuple[float, float] | None = None
    unmeasured: str = ""
    property: str = ""
    unit: str = "norm"


@dataclass(frozen=True)
class AircraftFacts:
    """Reference values, engines and controls of an aircraft.

    Attributes
    ----------
    S_m2, b_m, c_m : float
        Wing area [m2], span and chord [m] by JSBSim's metrics.
    engines : int
        Number of engines.
    controls : mapping
        Control to its facts.
    host : tuple of HostProperty
        What the aircraft reads and only a host, such as FlightGear, provides.
    V_mps : float
        Airspeed of the measurement [m/s] at ALTITUDE_M; NaN if nothing was measured.
    dt_s : float
        Integration step at which the engines settle [s].
    """

    S_m2: float
    b_m: float
    c_m: float
    engines: int
    controls: Mapping[str, ControlFacts] = field(default_factory=dict)
    host: tuple[HostProperty, ...] = ()
    V_mps: float = math.nan
    dt_s: float = DT_S


def assumed_facts(S_m2: float, b_m: float, c_m: float) -> AircraftFacts:
    """Return assumed facts of an aircraft that does not fly alone: usual senses, no throws."""
    return AircraftFacts(
        S_m2, b_m, c_m, 1, {name: ControlFacts(1) for name in (*_RESPONSE, "throttle")}
    )


def measure_facts(folder: Path) -> AircraftFacts:
    """Measure the aircraft in a folder, in this process. Raises BadInputError."""
    aircraft = _at_stable_step(find_aircraft(folder))
    held = {
        name: (
            _hold_commands(aircraft, name, commands),
            functools.partial(_hold_commands, aircraft, name, commands, _TURNING_RADPS),
        )
        for name in _RESPONSE
        for reach in (aircraft.card.inputs[name].limits[1],)
        for commands in ([reach * command for command in _COMMANDS],)
    }
    controls = {name: _control_facts(name, *rows, _POSITIONS[name]) for name, rows in held.items()}
    # Without ailerons their command may drive the rudder, which then has no other one.
    free = [p for name in controls if not controls[name].sense for p in _POSITIONS[name]]
    for name, control in controls.items():
        if control.sense and control.throw_deg is None and not control.unmeasured:
            controls[name] = _control_facts(name, *held[name], free)
    closed, opened = (
        _hold_commands(aircraft, "throttle", (value,))[0]
        for value in aircraft.card.inputs["throttle"].limits
    )
    controls["throttle"] = _throttle_facts(closed, opened)
    # At rest a control law may be at its limit whatever the command; a flight decides.
    controls |= {
        name: _in_flight(aircraft, name) for name, facts in controls.items() if not facts.sense
    }
    S, b, c = (opened.values[name] for name in _METRICS)
    return AircraftFacts(
        S * FT_M**2,
        b * FT_M,
        c * FT_M,
        opened.engines,
        {
            name: replace(facts, property=card.property, unit=card.unit)
            for name, facts in controls.items()
            for card in (aircraft.card.inputs[name],)
        },
        tuple(
            # Entries of an aircraft without a card were found by their effect.
            replace(row, kind="system") if row.name in aircraft.card.host else row
            for row in host_properties(aircraft)
        ),
        opened.values["velocities/vt-fps"] * FT_M,
        aircraft.dt_s,
    )


# Commands and switches found by their effect, for aircraft whose usual commands move nothing: the
# throttle may have a name of the author's, and a system may have to be on.

_COMMAND_WORDS = {
    "elevator": re.compile(r"elev|pitch|stab|canard"),
    "aileron": re.compile(r"ail|roll"),
    "rudder": re.compile(r"rud|yaw"),
    "throttle": re.compile(r"throttle|thrust|power|motor|pwr|esc\b|engine|gas|rpm"),
}
_NO_COMMAND = re.compile(r"trim|flap|brake|gear|spoiler|mixture|advance|starter|magneto|cutoff")
_UNITS = {
    "pct": re.compile(r"pct|percent"),
    "deg": re.compile(r"[-_]deg\b"),
    "rad": re.compile(r"[-_]rad\b"),
}
_ASSUMED_REACH = {"deg": 20.0, "rad": 0.35}  # of a surface commanded by its angle
_MAX_CANDIDATES, _MAX_SWITCHES = 60, 20
_MIN_SHARE = 1e-4  # of the weight, or rad/s2: the smallest answer of a command that is worth a name
_EQUAL_SHARE = 0.5  # of the strongest throttle's thrust, from where an input is a throttle as well
_MIDDLE_SHARE = 0.02  # of the answer, by which half a command must differ from both ends


def _at_stable_step(aircraft: Aircraft) -> Aircraft:
    """Return the aircraft with live controls, at a step at which its propellers are stable.

    A light propeller alternates between two speeds from frame to frame at a longer step.
    """
    live = with_live_controls(aircraft)
    if _propellers_settle(live):
        return live
    for dt_s in _SHORTER_S:
        shorter = with_live_controls(with_step(aircraft, dt_s))
        if _propellers_settle(shorter):
            return shorter
    return live


def _propellers_settle(aircraft: Aircraft) -> bool:
    """Return whether engines with propellers settle at full throttle, which moves their thrust."""
    bench = _Bench(aircraft)
    if not bench.has_propeller:
        return True
    state = mid_envelope_state(aircraft)
    full = {"throttle": aircraft.card.inputs["throttle"].limits[1]}
    unsettled = open_forced(aircraft, state, full, ALTITUDE_M, None)[1]
    return "does not settle" not in unsettled and bench.answers("throttle")


def with_live_controls(aircraft: Aircraft) -> Aircraft:
    """Return the aircraft with other commands, and systems on, where its controls move nothing.

    A command is an input of the XML that nothing computes and whose answer is graded: thrust for a
    throttle, angular acceleration for a surface. Systems are what a host would provide and is 0.
    Without effect of either the aircraft is unchanged. Raises BadInputError.
    """
    # Engine 0 of a quadplane may lift.
    pulling = _Bench(aircraft).pulling
    if pulling and aircraft.card.inputs["throttle"].property == engine.THROTTLE != pulling[0]:
        aircraft = _with_input(aircraft, "throttle", pulling)
    dead = [control for control in _COMMAND_WORDS if not _Bench(aircraft).answers(control)]
    for control in dead:
        switched = _with_systems_on(aircraft, control)
        if switched is not None:
            aircraft = switched
        elif names := _Bench(aircraft).commands(control):
            aircraft = _with_input(aircraft, control, names)
            if not _Bench(aircraft).answers(control):
                aircraft = _with_systems_on(aircraft, control) or aircraft
    return aircraft


def _with_systems_on(aircraft: Aircraft, control: str) -> Aircraft | None:
    """Return the aircraft with the fewest systems on with which a control answers; None if none
    help.
    """
    off = [
        row.name for row in host_properties(aircraft) if row.kind == "unknown" and row.source == "0"
    ]
    # All at once, else one of them: some are brakes, locks or failures.
    attempts = [dict.fromkeys(off, 1.0)] if off else []
    attempts += [{name: 1.0} for name in off] if 1 < len(off) <= _MAX_SWITCHES else []
    on = next((each for each in attempts if _Bench(aircraft, each).answers(control)), None)
    if on is None:
        return None
    # Switch off again what the control does not need.
    for name in off if len(on) > 1 else ():
        fewer = {key: value for key, value in on.items() if key != name}
        if _Bench(aircraft, fewer).answers(control):
            on = fewer
    card = aircraft.card.model_copy(update={"host": {**aircraft.card.host, **on}})
    return replace(aircraft, card=card)


def _with_input(aircraft: Aircraft, control: str, names: Sequence[str]) -> Aircraft:
    """Return the aircraft with another command of a control; the host copies it to others."""
    name = names[0]
    change: dict[str, object] = {"property": name}
    unit = next((unit for unit, words in _UNITS.items() if words.search(name)), "")
    if control == "throttle":
        change |= {"unit": "pct", "limits": (0.0, 100.0)} if unit == "pct" else {}
    elif unit in _ASSUMED_REACH:
        reach = _ASSUMED_REACH[unit]
        change |= {"unit": unit, "limits": (-reach, reach)}
    row = aircraft.card.inputs[control].model_copy(update=change)
    inputs = {**aircraft.card.inputs, control: row}
    host = {**aircraft.card.host, **dict.fromkeys(names[1:], name)}
    card = aircraft.card.model_copy(update={"inputs": inputs, "host": host})
    return replace(aircraft, card=card)


class _Bench:
    """An aircraft held in mid-envelope, whose answers to single properties are measured.

    ``settings`` are properties that are set before.
    """

    def __init__(self, aircraft: Aircraft, settings: Mapping[str, float] | None = None) -> None:
        flying = mid_envelope_state(aircraft)
        self._aircraft = aircraft
        state = BodyState(flying.u, 0.0, flying.w, 0.0, flying.theta, flying.psi)
        self._fdm, _ = open_forced(aircraft, state, {}, ALTITUDE_M, settings)
        self._equilibrium = control_equilibrium(aircraft, self._fdm)
        self._engines = self._fdm.get_propulsion().get_num_engines()
        self._exists = self._fdm.get_property_manager().hasNode

    @property
    def pulling(self) -> list[str]:
        """Return the throttle commands of the engines that pull."""
        return engine.throttles(self._fdm)[0]

    @property
    def has_propeller(self) -> bool:
        """Return whether an engine turns a propeller."""
        engines = range(self._engines)
        return any(self._exists(f"propulsion/engine[{k}]/propeller-rpm") for k in engines)

    def answers(self, control: str) -> bool:
        """Return whether the command of a control changes thrust or angular acceleration."""
        card = self._aircraft.card.inputs[control]
        if not self._exists(card.property):
            return False
        low, high = card.limits
        first, last = (self._answer(control, card.property, value) for value in (low, high))
        return bool(abs(last - first) > self._smallest(control))

    def commands(self, control: str) -> list[str]:
        """Return the inputs of the model that command a control, the strongest first.

        Only a throttle has several, such as one for each motor.
        """
        words = _COMMAND_WORDS[control]
        names = scan(model_files(self._aircraft).contents(), self._engines)
        candidates = [
            name
            for name in names.read
            if name not in names.computed
            and not _NO_COMMAND.search(name.lower())
            and (name in names.declared or name.startswith("/") or name.endswith("-cmd-norm"))
            and self._exists(name)
        ]
        # Names that say so come first; only engines tell a throttle from other inputs.
        matching = [name for name in candidates if words.search(name.lower())]
        other_names = [name for name in candidates if name not in matching]
        groups = [matching, other_names] if control == "throttle" and self._engines else [matching]
        for group in groups:
            strengths = {name: self._strength(control, name) for name in group[:_MAX_CANDIDATES]}
            best = max(strengths, key=lambda name: strengths[name], default="")
            if best and strengths[best] > self._smallest(control):
                equals = [
                    name
                    for name, strength in strengths.items()
                    if strength > _EQUAL_SHARE * strengths[best] and name != best
                ]
                return [best, *equals] if control == "throttle" else [best]
        return []

    def _strength(self, control: str, name: str) -> float:
        """Return the size of a graded answer to a property; 0 for a switch."""
        scale = 100.0 if _UNITS["pct"].search(name) else 1.0
        start = self._fdm[name]
        low, middle, high = (self._answer(control, name, v * scale) for v in (0.0, 0.5, 1.0))
        self._fdm[name] = start
        size = abs(high - low)
        graded = min(abs(middle - low), abs(high - middle)) > _MIDDLE_SHARE * size
        rises = control != "throttle" or high > low
        return size if graded and rises and math.isfinite(size) else 0.0

    def _answer(self, control: str, name: str, value: float) -> float:
        """Return thrust (without engines the force forward) [lbf], or acceleration [rad/s2]."""
        self._fdm[name] = value
        bring_to_rest(self._fdm, self._equilibrium)
        if control in _RESPONSE:
            return float(self._fdm[_RESPONSE[control][0]])
        if not self._engines:
            return float(self._fdm[_FORWARD])
        engines = range(self._engines)
        return float(sum(self._fdm[f"propulsion/engine[{k}]/{_THRUST}"] for k in engines))

    def _smallest(self, control: str) -> float:
        """Return the smallest answer that counts."""
        weight = self._fdm["inertia/weight-lbs"] if control == "throttle" else 1.0
        return _MIN_SHARE * float(weight)


@dataclass(frozen=True)
class _HeldState:
    """The aircraft at rest with one command held.

    Attributes
    ----------
    values, positions : mapping
        Properties, and positions of surfaces that are at rest.
    engines : int
        Number of engines.
    unsettled : str
        Which engine does not settle; else empty.
    """

    values: Mapping[str, float]
    positions: Mapping[str, float] = field(default_factory=dict)
    engines: int = 0
    unsettled: str = ""


def _hold_commands(
    aircraft: Aircraft, control: str, commands: Sequence[float], rate_radps: float = 0.0
) -> list[_HeldState]:
    """Hold one command after another until control system and engines are at rest.

    Raises BadInputError.
    """
    flying = mid_envelope_state(aircraft)
    # Without rates, which dampers would answer.
    rates = (rate_radps,) * 3
    state = BodyState(flying.u, 0.0, flying.w, 0.0, flying.theta, flying.psi, *rates)
    # The instance must outlive its manager, or absolute names are not found.
    probe = open_aircraft(aircraft)
    exists = probe.get_property_manager().hasNode
    controls = {
        name: setting
        for name, setting in {
            "throttle": THROTTLE * aircraft.card.inputs["throttle"].limits[1],
            control: commands[0],
        }.items()
        if exists(aircraft.card.inputs[name].property)
    }
    # One instance for all commands: engines are settled once.
    fdm, unsettled = open_forced(aircraft, state, controls, ALTITUDE_M, None)
    equilibrium = control_equilibrium(aircraft, fdm)
    engines = fdm.get_propulsion().get_num_engines()
    names = [name for group in _POSITIONS.values() for name in group if exists(name)]
    # What the aerodynamics read of two surfaces of unequal travel may be proportional.
    functions = dict.fromkeys(name for name, _, _ in function_properties(staged(aircraft)))
    names += [n for n in functions if _FCS.match(n) and n not in names and exists(n)]
    values = [*_METRICS, "velocities/vt-fps", _FORWARD, *(name for name, _ in _RESPONSE.values())]
    rows = []
    for command in commands:
        if control in controls:
            set_control(fdm, aircraft, control, command)
        moving = still_moving(fdm, equilibrium, names)
        # A surface that keeps moving is driven by a control law or an autopilot as well.
        positions = {name: float(fdm[name]) for name in names if name not in moving}
        thrust = sum(fdm[f"propulsion/engine[{k}]/{_THRUST}"] for k in range(engines))
        read = {name: float(fdm[name]) for name in values} | {_THRUST: float(thrust)}
        rows.append(_HeldState(read, positions, engines, unsettled))
    return rows


def _in_flight(aircraft: Aircraft, control: str) -> ControlFacts:
    """Return the sense of a control from short flights with the command at either end."""
    rate, sign = _RATE.get(control, ("velocities/vt-fps", 1))
    ends = aircraft.card.inputs[control].limits
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
    control: str,
    rows: Sequence[_HeldState],
    turning: Callable[[], Sequence[_HeldState]],
    positions: Sequence[str],
) -> ControlFacts:
    """Return sense and throw of a surface.

    Parameters
    ----------
    control : str
        The control.
    rows : sequence of _HeldState
        One for each of `_COMMANDS`.
    turning : callable
        Returns the same rows with the aircraft turning.
    positions : sequence of str
        Positions that the control may move; the first one that it does gives the throw.
    """
    name, sign = _RESPONSE[control]
    answers = [row.values[name] for row in rows]
    if not all(map(math.isfinite, answers)):
        return ControlFacts(1, unmeasured=f"{name} is not finite with {control} held")
    low, high, repeated = answers[0], answers[-2], answers[-1]
    # A drift, such as the gas of a balloon, is no effect of the command.
    if not abs(high - low) > max(_MIN_ANSWER, 10.0 * abs(repeated - low)):
        return ControlFacts(0)
    # Compare the accelerations at both ends.
    sense = sign if high > low else -sign
    for name in positions:
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
            # A position is proportional to the command if its middle lies half-way between its
            # ends.
            is_linear = (
                not limited and abs(middle - 0.5 * (lowest + highest)) <= _LINEAR_SHARE * throw
            )
            if is_linear and highest > lowest:
                return ControlFacts(sense, round(throw, 6), name)
            return ControlFacts(sense, round(throw, 6), *_proportional_position(rows, throw))
    return ControlFacts(sense)


def _proportional_position(
    rows: Sequence[_HeldState], throw_deg: float
) -> tuple[str | None, str | None]:
    """Return the property that follows a command in proportion, and its unit if its name has none.

    Of those that aerodynamic functions read, it is the one whose travel is nearest to the throw of
    a surface; (None, None) if there is none.
    """
    standard = {name for group in _POSITIONS.values() for name in group}
    nearest: tuple[str | None, str | None] = None, None
    smallest = _LIKE_THROW_SHARE * throw_deg
    for name in rows[0].positions:
        if name in standard or any(name not in row.positions for row in rows):
            continue
        values = [row.positions[name] for row in rows]
        travel = 0.5 * (values[-2] - values[0])
        if not (all(map(math.isfinite, values)) and travel > _MIN_TRAVEL):
            continue
        middle = 0.5 * (values[0] + values[-2])
        straight = (middle - 0.5 * travel, middle, middle + 0.5 * travel)
        largest = max(abs(v - w) for v, w in zip(values[1:4], straight, strict=True))
        if largest > _LINEAR_SHARE * travel:
            continue
        ending = name.rpartition("-")[2]
        for unit, degrees in (("deg", 1.0), ("rad", RAD_DEG)):
            difference = abs(degrees * travel - throw_deg)
            has_other_unit = ending in {"deg", "rad", "norm"} - {unit}
            if difference < smallest and not has_other_unit:
                nearest, smallest = (name, None if ending == unit else unit), difference
    return nearest


def _depends_on_motion(
    position: str, rows: Sequence[_HeldState], turning: Sequence[_HeldState]
) -> bool:
    """Return whether the motion moves the surface too: the end is then a control law's limit."""
    return any(
        abs(row.positions[position] - other.positions.get(position, math.inf)) > _MIN_TRAVEL
        for row, other in zip(rows, turning, strict=True)
    )


def _throttle_facts(closed: _HeldState, opened: _HeldState) -> ControlFacts:
    """Return sense and thrust of the throttle; without engines, of the force forward."""
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
    """Measure the aircraft in a child process.

    Parameters
    ----------
    folder : Path
        Folder of the aircraft.
    timeout_s : float
        Time limit [s].

    Raises
    ------
    BadInputError
        If it does not fly, with the last message of the child.
    """
    child = run_module(__name__, folder, timeout_s=timeout_s)
    if child.code is None:
        raise BadInputError(f"aircraft {folder}: was not measured within {timeout_s:g} s")
    if child.code or not child.answer:
        words = child.errors or "no message"
        raise BadInputError(
            f"aircraft {folder}: does not run in JSBSim ({words}); correct this first"
        )
    if "error" in child.answer:
        raise BadInputError(f"aircraft {folder}: does not run in JSBSim: {child.answer['error']}")
    controls = {
        name: ControlFacts(**{**facts, "thrust_N": facts["thrust_N"] and tuple(facts["thrust_N"])})
        for name, facts in child.answer["controls"].items()
    }
    host = tuple(HostProperty(**row) for row in child.answer["host"])
    return AircraftFacts(**{**child.answer, "controls": controls, "host": host})


def _main(folder: str) -> None:
    """Measure an aircraft and answer the parent."""
    try:
        give_answer(asdict(measure_facts(Path(folder))))
    except (BadInputError, engine.RuntimeFailure) as error:
        give_answer({"error": " ".join(str(error).split())})


if __name__ == "__main__":
    _main(sys.argv[1])
