"""JSBSim's open-loop flight against an independent integration of the same equations, and that each
number matters.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest

from tests.helpers.few import few
from tests.helpers.sixdof import TABLE_2_6, Airframe, simulate
from uqharness.simulator import engine
from uqharness.simulator.aircraft import find_aircraft, open_aircraft
from uqharness.simulator.forced_state import apply_controls, body_velocity
from uqharness.simulator.trim import SteadyCondition, find_trim

FT = 0.3048
V, HEIGHT, DURATION, DT = 22.2, 100.0, 6.0, 0.001
DOUBLETS = {"elevator": 5.0, "aileron": 8.0, "rudder": 8.0}
STATES = ("u", "v", "w", "p", "q", "r", "phi", "theta", "psi", "h")
# What the two may differ by where a state hardly moves: JSBSim's earth is round and turns (5e-5
# rad/s), the other one is flat.
FLOOR = np.array([2e-3, 2e-3, 2e-3, 2.5e-4, 2.5e-4, 2.5e-4, 3e-4, 3e-4, 1.5e-3, 1e-2])
PROPERTIES = (
    "velocities/u-fps",
    "velocities/v-fps",
    "velocities/w-fps",
    "velocities/p-rad_sec",
    "velocities/q-rad_sec",
    "velocities/r-rad_sec",
    "attitude/phi-rad",
    "attitude/theta-rad",
    "attitude/psi-rad",
    "position/h-sl-ft",
)
POSITIONS = (
    "fcs/elevator-pos-deg",
    "fcs/aileron-pos-deg",
    "fcs/rudder-pos-deg",
    "fcs/throttle-pos-pct",
)


@functools.cache
def nominal_trim():
    return find_trim(find_aircraft("espaaro"), SteadyCondition(V, altitude_m=HEIGHT))


def fly_jsbsim(control: str, dt: float = DT, changes: dict[str, float] | None = None):
    """States (n + 1, 10) and surface positions (n + 1, 4) of a doublet from the nominal trim."""
    aircraft, trim = find_aircraft("espaaro"), nominal_trim()
    fdm = open_aircraft(aircraft, dt)
    apply_controls(fdm, aircraft, trim.controls)
    for name, value in (changes or {}).items():
        engine.set_property(fdm, name, value)
    u, v, w = body_velocity(V, trim.alpha_rad, trim.beta_rad)
    fdm["ic/lat-geod-deg"], fdm["ic/h-sl-ft"] = 45.0, HEIGHT / FT
    fdm["ic/phi-rad"], fdm["ic/theta-rad"], fdm["ic/psi-true-rad"] = 0.0, trim.theta_rad, 0.0
    fdm["ic/u-fps"], fdm["ic/v-fps"], fdm["ic/w-fps"] = u / FT, v / FT, w / FT
    engine.run_ic(fdm)
    command = engine.handle(fdm, aircraft.card.inputs[control].property).set_double_value
    reads = [engine.handle(fdm, name).get_double_value for name in PROPERTIES + POSITIONS]
    steps = round(DURATION / dt)
    rows = np.empty((steps + 1, len(reads)))
    rows[0] = [read() for read in reads]
    for k in range(1, steps + 1):
        t = k * dt
        amplitude = DOUBLETS[control] * (1.0 if 1.0 <= t < 1.5 else -1.0 if 1.5 <= t < 2.0 else 0.0)
        command(trim.controls[control] + amplitude)
        fdm.run()
        rows[k] = [read() for read in reads]
    states, positions = rows[:, :10], rows[:, 10:]
    states[:, :3] *= FT
    states[:, 9] *= FT
    states[:, 8] = np.unwrap(states[:, 8])
    return states, positions


def integrate(airframe: Airframe, states, positions, dt: float = DT):
    """The independent states (n + 1, 10) from the same start under the same surface positions."""
    start = np.zeros(12)
    start[:9], start[11] = states[0, :9], -states[0, 9]
    solution = simulate(airframe, start, positions[:-1], dt)
    return np.column_stack([solution[:, :9], -solution[:, 11]])


@functools.cache
def nominal(control: str):
    states, positions = fly_jsbsim(control)
    return states, integrate(Airframe(), states, positions)


def excess(states, reference):
    """Largest difference of each state over what is allowed: 1 % of its peak excursion, or the
    floor.
    """
    peak = np.max(np.abs(reference - reference[0]), axis=0)
    return np.max(np.abs(states - reference), axis=0) / np.maximum(0.01 * peak, FLOOR)


@pytest.mark.parametrize("control", DOUBLETS)
def test_doublet_agrees_to_one_percent(control):
    states, reference = nominal(control)
    ratio = excess(states, reference)
    assert ratio.max() < 1.0, dict(zip(STATES, ratio.round(2), strict=True))


def disagrees(changes: dict[str, float]) -> bool:
    # "not below" rather than "above": a change that makes the flight diverge leaves NaN, and that
    # is seen too.
    return any(
        not excess(fly_jsbsim(control, changes=changes)[0], nominal(control)[1]).max() < 1.0
        for control in DOUBLETS
    )


@pytest.mark.parametrize("name", few([key for key, value in TABLE_2_6.items() if value != 0.0], 3))
def test_a_flipped_coefficient_is_seen(name):
    assert disagrees({f"aero/{name}": -TABLE_2_6[name]})


def test_a_flipped_product_of_inertia_is_seen():
    states, positions = fly_jsbsim("aileron")
    wrong = integrate(Airframe(Ixz=-0.25), states, positions)
    assert excess(states, wrong).max() > 1.0


def test_every_term_counts_the_same_on_both_sides():
    # Also the four that Table 2.6 does not print and the model carries at zero.
    rng = np.random.default_rng(26)
    changed = {key: value * rng.uniform(0.8, 1.2) for key, value in TABLE_2_6.items()}
    changed |= {"CZ_q": -4.0, "Cm_dr": 0.0006, "Cl_de": 0.0003, "Cn_de": -0.0002}
    for control in DOUBLETS:
        states, positions = fly_jsbsim(
            control, changes={f"aero/{key}": value for key, value in changed.items()}
        )
        reference = integrate(Airframe(coefficients=changed), states, positions)
        ratio = excess(states, reference)
        assert ratio.max() < 1.0, (control, dict(zip(STATES, ratio.round(2), strict=True)))
