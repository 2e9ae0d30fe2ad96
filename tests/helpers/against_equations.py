"""Open-loop flights of JSBSim from a trim, and how far independent equations are from them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from tests.helpers import sixdof
from uqharness.simulator import engine
from uqharness.simulator.aircraft import find_aircraft, open_aircraft
from uqharness.simulator.forced_state import apply_controls, body_velocity
from uqharness.simulator.trim import Trim

FT = 0.3048
STATES = {
    "u": "velocities/u-fps",
    "v": "velocities/v-fps",
    "w": "velocities/w-fps",
    "p": "velocities/p-rad_sec",
    "q": "velocities/q-rad_sec",
    "r": "velocities/r-rad_sec",
    "phi": "attitude/phi-rad",
    "theta": "attitude/theta-rad",
    "psi": "attitude/psi-rad",
    "h": "position/h-sl-ft",
}
POSITIONS = (
    "fcs/elevator-pos-deg",
    "fcs/aileron-pos-deg",
    "fcs/rudder-pos-deg",
    "fcs/throttle-pos-pct",
)
# What the two may differ by where a state hardly moves: JSBSim's earth is round and turns (5e-5
# rad/s), the other one is flat.
FLOOR = np.array([2e-3, 2e-3, 2e-3, 2.5e-4, 2.5e-4, 2.5e-4, 3e-4, 3e-4, 1.5e-3, 1e-2])


def fly(
    name: str,
    trim: Trim,
    V: float,
    height: float,
    duration: float,
    dt: float,
    control: str,
    steps: Sequence[tuple[float, float]],
    changes: Iterable[tuple[str, float]] = (),
) -> tuple[FloatArray, FloatArray]:
    """States (n + 1, 10) and surface positions (n + 1, 4) from a trim; ``steps``: time and the
    control's deflection from its trim from then on.
    """
    aircraft = find_aircraft(name)
    fdm = open_aircraft(aircraft, dt)
    apply_controls(fdm, aircraft, trim.controls)
    for prop, value in changes:
        engine.set_property(fdm, prop, value)
    u, v, w = body_velocity(V, trim.alpha_rad, trim.beta_rad)
    fdm["ic/lat-geod-deg"], fdm["ic/h-sl-ft"] = 45.0, height / FT
    fdm["ic/phi-rad"], fdm["ic/theta-rad"], fdm["ic/psi-true-rad"] = 0.0, trim.theta_rad, 0.0
    fdm["ic/u-fps"], fdm["ic/v-fps"], fdm["ic/w-fps"] = u / FT, v / FT, w / FT
    engine.run_ic(fdm)
    command = engine.handle(fdm, aircraft.card.inputs[control].property).set_double_value
    reads = [engine.handle(fdm, p).get_double_value for p in (*STATES.values(), *POSITIONS)]
    rows = [[read() for read in reads]]
    for k in range(1, round(duration / dt) + 1):
        offset = next((d for t, d in reversed(steps) if k * dt >= t), 0.0)
        command(trim.controls[control] + offset)
        fdm.run()
        rows.append([read() for read in reads])
    table = np.array(rows)
    states = table[:, :10]
    states[:, [0, 1, 2, 9]] *= FT
    states[:, 8] = np.unwrap(states[:, 8])
    return states, table[:, 10:]


def integrate(
    airframe: Any,
    states: FloatArray,
    positions: FloatArray,
    dt: float,
    derivative: Callable[..., FloatArray] = sixdof.derivative,
) -> FloatArray:
    """The independent states (n + 1, 10) from the same start under the same surface positions."""
    start = np.zeros(12)
    start[:9], start[11] = states[0, :9], -states[0, 9]
    solution = sixdof.simulate(airframe, start, positions[:-1], dt, derivative)
    return np.column_stack([solution[:, :9], -solution[:, 11]])


def excess(states: FloatArray, reference: FloatArray) -> Mapping[str, float]:
    """Largest difference of each state over what is allowed: 1 % of its peak excursion, or the
    floor.
    """
    peak = np.max(np.abs(reference - reference[0]), axis=0)
    ratio = np.max(np.abs(states - reference), axis=0) / np.maximum(0.01 * peak, FLOOR)
    return dict(zip(STATES, ratio.tolist(), strict=True))
