"""Engines brought to the steady state of their levers while the aircraft's state stands still.

JSBSim's own way (FGPropulsion::GetSteadyState) steps engines by half a second. That is longer than
a propeller takes to follow its engine, so the speed of many piston engines and turboprops
oscillates instead of settling, and the engine stops. And a frame in which time stands still takes a
turboprop's power away. Here frames of the whole model are run with the integrators of the motion
switched off. A steady state is the same for every length of step, so steps begin long and get
shorter while nothing settles."""

from __future__ import annotations

import itertools
from typing import Any

_MOTION_INTEGRATORS = (
    "rate/rotational",
    "rate/translational",
    "position/rotational",
    "position/translational",
)
INTEGRATORS = tuple(f"simulation/integrator/{name}" for name in _MOTION_INTEGRATORS)
STEPS_S = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002)
"""Lengths of step that are tried one after the other, down to the step that the aircraft flies
with.
"""
BLOCK_FRAMES, MAX_BLOCKS = 25, 40
CRANK_S = 3.0
STEADY_TOLERANCE = 1e-9
"""Change over a block, as a share of the largest thrust or speed, at which an engine has
settled.
"""
# of the power that a propeller takes, at which JSBSim's own way has found its steady state
_POWER_TOLERANCE = 1e-3
_ALTERNATES = 0.01  # of the speed: a change from frame to frame that is no rounding
_FTLBF_PER_S_HP = 550.0
_WIND = tuple(f"atmosphere/wind-{axis}-fps" for axis in ("north", "east", "down"))
_WATCHED = ("thrust-lbs", "propeller-rpm", "n1", "blade-angle")


def is_balanced(fdm: Any) -> bool:
    """Whether each engine gives its propeller the power that it takes, after JSBSim's own way to
    the steady state.

    False for a turboprop, whose power is not known in a frame in which time stands still, and for a
    turbine that turns a propeller, which tells no power."""
    if has_turboprop(fdm):
        return False
    exists = fdm.get_property_manager().hasNode
    for name in _engines(fdm):
        if exists(f"{name}/propeller-power-ftlbps"):
            if not exists(f"{name}/power-hp"):
                return False
            absorbed_power, engine_power = (
                fdm[f"{name}/propeller-power-ftlbps"],
                fdm[f"{name}/power-hp"] * _FTLBF_PER_S_HP,
            )
            if not abs(engine_power - absorbed_power) <= _POWER_TOLERANCE * max(
                abs(absorbed_power), _FTLBF_PER_S_HP
            ):
                return False
            if not fdm[f"{name}/set-running"]:
                return False
    return True


def settle(fdm: Any) -> str:
    """Run frames, the motion frozen, until engines are steady: empty, or what still changes.

    Clock and fuel stay as they are.
    """
    manager = fdm.get_property_manager()
    saved = {name: fdm[name] for name in INTEGRATORS}
    time_s, dt_s, trimming = fdm.get_sim_time(), fdm.get_delta_t(), fdm.get_trim_status()
    watched = {
        (number, reading): manager.get_node(f"{name}/{reading}").get_double_value
        for number, name in enumerate(_engines(fdm), start=1)
        for reading in _WATCHED
        if manager.hasNode(f"{name}/{reading}")
    }
    moved, number, quantity = 0.0, 1, ""
    pistons = manager.hasNode("propulsion/magneto_cmd")
    for name in INTEGRATORS:
        fdm[name] = 0.0
    # No engine draws fuel while JSBSim takes itself to be trimming.
    fdm.set_trim_status(True)
    try:
        # No step is shorter than the flight's: what settles only there does not settle in flight.
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
        for name, value in saved.items():
            fdm[name] = value
        # The Earth has turned beneath a place that stood still, and distances count from the
        # initial one. A turboprop would fall back to idle.
        if not has_turboprop(fdm):
            wind = {name: fdm[name] for name in _WIND}
            fdm.run_ic()
            for name, value in wind.items():
                fdm[name] = value
    if moved < _POWER_TOLERANCE:
        return ""
    changing = f"{quantity} still changes by {moved:.2g} of its value in {BLOCK_FRAMES} frames"
    return f"engine {number} does not settle at a step of {dt_s:g} s: {in_turn or changing}"


def _alternation(fdm: Any, number: int, time_s: float) -> str:
    """Say between which speeds a propeller alternates from frame to frame; empty if it does not."""
    name = f"propulsion/engine[{number - 1}]/propeller-rpm"
    if not fdm.get_property_manager().hasNode(name):
        return ""
    rpm = [fdm[name]]
    for _ in range(4):
        fdm.set_sim_time(time_s)
        fdm.run()
        rpm.append(fdm[name])
    changes = [after - before for before, after in itertools.pairwise(rpm)]
    min_change = _ALTERNATES * max(map(abs, rpm))
    if all(abs(c) > min_change for c in changes) and all(
        a * b < 0.0 for a, b in itertools.pairwise(changes)
    ):
        low, high = sorted(rpm[-2:])
        return f"its propeller turns at {low:.0f} and {high:.0f} rpm in turn"
    return ""


def _crank(fdm: Any, time_s: float) -> None:
    """Turn the starters until the engines run, for at most CRANK_S: a propeller that has come to
    rest stays so in the wind.
    """
    running = [
        fdm.get_property_manager().get_node(f"{name}/set-running").get_double_value
        for name in _engines(fdm)
    ]
    if all(get() for get in running):
        return
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
    """The greatest change of what is watched over the last block, its engine and name: runs until
    that is below SETTLED, at most MOST_BLOCKS, and gives up where ten blocks have brought it no
    nearer."""
    previous = {key: get() for key, get in watched.items()}
    smallest, blocks_without_gain, largest = float("inf"), 0, (0.0, 1, "")
    for _ in range(MAX_BLOCKS):
        for _ in range(BLOCK_FRAMES):
            # A script's events must not take these frames for flight.
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
    """Which of the piston and turbine engines, all of them started, do not run; empty where
    all do.
    """
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
    """Whether every engine is a rocket and none gives thrust, as with empty tanks: the aircraft is
    a glider.
    """
    exists = fdm.get_property_manager().hasNode
    turning = ("n1", "propeller-rpm", "power-hp")
    return all(
        not any(exists(f"{name}/{part}") for part in turning) and fdm[f"{name}/thrust-lbs"] == 0.0
        for name in _engines(fdm)
    )


def has_turboprop(fdm: Any) -> bool:
    """Whether an engine is a turboprop, whose power is gone after a frame in which time stands
    still.
    """
    exists = fdm.get_property_manager().hasNode
    return any(
        exists(f"{name}/itt-c") and exists(f"{name}/propeller-rpm") for name in _engines(fdm)
    )


def _engines(fdm: Any) -> list[str]:
    return [f"propulsion/engine[{k}]" for k in range(fdm.get_propulsion().get_num_engines())]
