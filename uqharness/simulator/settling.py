"""Engines brought to the steady state of their levers while the aircraft stands still.

JSBSim's own method (FGPropulsion::GetSteadyState) steps engines by 0.5 s. That is longer than the
time constant of a propeller, so that many piston engines and turboprops oscillate and stop.
`settle` instead runs frames of the whole model with the motion's integrators switched off. A steady
state does not depend on the step, so that steps start long and are shortened while the engines do
not settle.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

_MOTION_INTEGRATORS = (
    "rate/rotational",
    "rate/translational",
    "position/rotational",
    "position/translational",
)
INTEGRATORS = tuple(f"simulation/integrator/{name}" for name in _MOTION_INTEGRATORS)
STEPS_S = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002)
"""Steps [s] that are tried in turn, down to the aircraft's own."""
BLOCK_FRAMES, MAX_BLOCKS = 25, 40
CRANK_S = 3.0
STEADY_TOLERANCE = 1e-9
"""Relative change over a block at which an engine has settled."""
# Relative difference of engine power and propeller power that counts as balanced.
_POWER_TOLERANCE = 1e-3
_ALTERNATES = 0.01  # of the speed: a change from frame to frame that is no rounding
FTLBF_PER_S_HP = 550.0
_WIND = tuple(f"atmosphere/wind-{axis}-fps" for axis in ("north", "east", "down"))
_WATCHED = ("thrust-lbs", "propeller-rpm", "n1", "blade-angle")


def power_is_balanced(absorbed: Any, delivered: Any) -> Any:
    """Return whether a propeller absorbs what its engine delivers [ft lbf/s], elementwise."""
    size = np.maximum(np.abs(absorbed), FTLBF_PER_S_HP)
    return np.abs(delivered - absorbed) <= _POWER_TOLERANCE * size


def is_balanced(fdm: Any) -> bool:
    """Return whether every engine delivers its propeller's power after JSBSim's own method.

    False for a turboprop, whose power is unknown in a frame without integration, and for a turbine
    with a propeller, which reports no power.
    """
    if has_turboprop(fdm):
        return False
    exists = fdm.get_property_manager().hasNode
    for name in _engines(fdm):
        if exists(f"{name}/propeller-power-ftlbps"):
            if not exists(f"{name}/power-hp"):
                return False
            absorbed_power, engine_power = (
                fdm[f"{name}/propeller-power-ftlbps"],
                fdm[f"{name}/power-hp"] * FTLBF_PER_S_HP,
            )
            if not power_is_balanced(absorbed_power, engine_power):
                return False
            if not fdm[f"{name}/set-running"]:
                return False
    return True


def settle(fdm: Any) -> str:
    """Run frames with frozen motion until the engines are steady.

    Clock and fuel are unchanged. Returns an empty text, or which engine still changes.
    """
    manager = fdm.get_property_manager()
    saved = {name: fdm[name] for name in INTEGRATORS}
    # The aircraft's systems pump fuel between tanks in these frames, too.
    tanks = (f"propulsion/tank[{k}]/contents-lbs" for k in itertools.count())
    contents = {name: fdm[name] for name in itertools.takewhile(manager.hasNode, tanks)}
    time_s, dt_s, trimming = fdm.get_sim_time(), fdm.get_delta_t(), fdm.get_trim_status()
    watched = {
        (number, reading): manager.get_node(f"{name}/{reading}").get_double_value
        for number, name in enumerate(_engines(fdm), start=1)
        for reading in _WATCHED
        if manager.hasNode(f"{name}/{reading}")
    }
    moved, number, quantity = 0.0, 1, ""
    pistons = manager.hasNode("propulsion/magneto_cmd")
    earth_rad = fdm["position/epa-rad"]
    for name in INTEGRATORS:
        fdm[name] = 0.0
    # In trim mode engines draw no fuel.
    fdm.set_trim_status(True)
    try:
        # Never shorter than the flight's step: an engine must settle at that one.
        # Start with long steps, which settle fastest.
        for step_s in (*(step_s for step_s in STEPS_S if step_s > dt_s), dt_s):
            fdm.set_dt(step_s)
            if pistons:
                _crank(fdm, time_s)
            moved, number, quantity = _run_blocks(fdm, watched, time_s)
            if moved < STEADY_TOLERANCE:
                break
        in_turn = "" if moved < _POWER_TOLERANCE else _alternation(fdm, number, time_s)
    finally:
        fdm.set_dt(dt_s)
        fdm.set_trim_status(trimming)
        fdm.set_sim_time(time_s)
        for name, value in (saved | contents).items():
            fdm[name] = value
        # Restore the initial position, because the Earth turned meanwhile. Initialisation would
        # set a turboprop to idle.
        if has_turboprop(fdm):
            for name in INTEGRATORS:
                fdm[name] = 0.0
            _turn_earth_back(fdm, earth_rad, time_s)
            fdm.set_dt(dt_s)
            for name, value in saved.items():
                fdm[name] = value
        else:
            wind = {name: fdm[name] for name in _WIND}
            fdm.run_ic()
            for name, value in wind.items():
                fdm[name] = value
    if moved < _POWER_TOLERANCE:
        return ""
    changing = f"{quantity} still changes by {moved:.2g} of its value in {BLOCK_FRAMES} frames"
    return f"engine {number} does not settle at a step of {dt_s:g} s: {in_turn or changing}"


_EARTH_RADPS = 7.292115e-5
_RENEWALS, _NO_TIME_S = 4, 1e-9  # frames that refill the integrators' history, and their length
_MODELS = (
    "Inertial Atmosphere Winds FCS MassBalance Auxiliary Propulsion Aerodynamics GroundReactions"
    " ExternalReactions BuoyantForces Aircraft Accelerations"
)


def _turn_earth_back(fdm: Any, earth_rad: float, time_s: float) -> None:
    """Turn the Earth back to its angle before; engines and all other models keep their states.

    Position and attitude are frozen in space, so that the aircraft would start west of its place,
    and inclined. Frames without length renew the forces.
    """
    switches = [f"simulation/models/FG{model}/enabled" for model in _MODELS.split()]
    switches = [name for name in switches if fdm.get_property_manager().hasNode(name)]
    for name in switches:
        fdm[name] = 0.0
    turned_s = (fdm["position/epa-rad"] - earth_rad) / _EARTH_RADPS
    fdm.set_dt(-turned_s - _RENEWALS * _NO_TIME_S)
    fdm.run()
    for name in switches:
        fdm[name] = 1.0
    fdm.set_dt(_NO_TIME_S)
    for _ in range(_RENEWALS):
        fdm.set_sim_time(time_s)
        fdm.run()
    fdm.set_sim_time(time_s)


def _alternation(fdm: Any, number: int, time_s: float) -> str:
    """Return the two speeds between which a propeller alternates, as text; empty if it does not."""
    name = f"propulsion/engine[{number - 1}]/propeller-rpm"
    if not fdm.get_property_manager().hasNode(name):
        return ""
    rpm = [fdm[name]]
    for _ in range(4):
        fdm.set_sim_time(time_s)
        fdm.run()
        rpm.append(fdm[name])
    # Alternating: every change is large and of the opposite sign.
    changes = [after - before for before, after in itertools.pairwise(rpm)]
    min_change = _ALTERNATES * max(map(abs, rpm))
    if all(abs(c) > min_change for c in changes) and all(
        a * b < 0.0 for a, b in itertools.pairwise(changes)
    ):
        low, high = sorted(rpm[-2:])
        return f"its propeller turns at {low:.0f} and {high:.0f} rpm in turn"
    return ""


def _crank(fdm: Any, time_s: float) -> None:
    """Turn the starters until the engines run, at most CRANK_S.

    A propeller at rest is not started by the wind.
    """
    running = [
        fdm.get_property_manager().get_node(f"{name}/set-running").get_double_value
        for name in _engines(fdm)
    ]
    if all(get() for get in running):
        return
    # One command turns the starters of all piston engines.
    fdm["propulsion/starter_cmd"] = 1.0
    for _ in range(round(CRANK_S / fdm.get_delta_t())):
        fdm.set_sim_time(time_s)
        fdm.run()
        if all(get() for get in running):
            break
    fdm["propulsion/starter_cmd"] = 0.0


def _run_blocks(
    fdm: Any, watched: dict[tuple[int, str], Any], time_s: float
) -> tuple[float, int, str]:
    """Run blocks of frames until the largest change is below STEADY_TOLERANCE.

    Gives up after MAX_BLOCKS, or ten blocks that did not halve the change. Returns the largest
    relative change over the last block, its engine's number and quantity.
    """
    previous = {key: get() for key, get in watched.items()}
    smallest, blocks_without_gain, largest = float("inf"), 0, (0.0, 1, "")
    for _ in range(MAX_BLOCKS):
        for _ in range(BLOCK_FRAMES):
            # Events of a script must not see time advance.
            fdm.set_sim_time(time_s)
            fdm.run()
        current = {key: get() for key, get in watched.items()}
        largest = max(
            (
                (abs(current[key] - previous[key]) / max(abs(current[key]), 1.0), *key)
                for key in watched
            ),
            default=largest,
        )
        if largest[0] < STEADY_TOLERANCE:
            break
        previous = current
        smallest, blocks_without_gain = (
            (largest[0], 0) if largest[0] < 0.5 * smallest else (smallest, blocks_without_gain + 1)
        )
        if blocks_without_gain == 10:
            break
    return largest


def stopped_engines(fdm: Any) -> str:
    """Return which piston and turbine engines do not run, as text; empty if all do."""
    exists = fdm.get_property_manager().hasNode
    burning = [
        f"{name}/set-running" if exists(f"{name}/map-inhg") or exists(f"{name}/n1") else ""
        for name in _engines(fdm)
    ]
    numbers = [str(k) for k, name in enumerate(burning, start=1) if name and not fdm[name]]
    if not numbers:
        return ""
    many = len(numbers) > 1
    return (
        f"engine{'s' * many} {', '.join(numbers)} {'do' if many else 'does'} not keep running once"
        " started and left to settle"
    )


def spent_rockets(fdm: Any) -> bool:
    """Return whether all engines are rockets without thrust: the aircraft is a glider."""
    exists = fdm.get_property_manager().hasNode
    turning = ("n1", "propeller-rpm", "power-hp")
    return all(
        not any(exists(f"{name}/{part}") for part in turning) and fdm[f"{name}/thrust-lbs"] == 0.0
        for name in _engines(fdm)
    )


def has_turboprop(fdm: Any) -> bool:
    """Return whether an engine is a turboprop, which loses power in a frame without integration."""
    exists = fdm.get_property_manager().hasNode
    return any(
        exists(f"{name}/itt-c") and exists(f"{name}/propeller-rpm") for name in _engines(fdm)
    )


def _engines(fdm: Any) -> list[str]:
    """Return the property folders of the engines."""
    return [f"propulsion/engine[{k}]" for k in range(fdm.get_propulsion().get_num_engines())]
