"""A forced state is the state that was asked for, and its accelerations are those JSBSim flies on
with.
"""

from __future__ import annotations

import re

import numpy as np
import pytest

from sysid.units import FT_M
from tests.helpers import foreign_aircraft
from uqharness.simulator import engine, forced_state
from uqharness.simulator.aircraft import find_aircraft, open_aircraft
from uqharness.simulator.forced_state import (
    BodyState,
    body_velocity,
    force_state,
    open_forced,
)

STATE = BodyState(*body_velocity(50.0, 0.06, 0.02), 0.1, 0.08, 0.5, 0.02, -0.01, 0.03)


def test_the_model_stands_where_it_was_put():
    fdm, unsettled = open_forced(
        find_aircraft("c172p"), STATE, {"elevator": -0.1, "throttle": 0.7}, 300.0, None
    )
    assert unsettled == ""
    assert fdm["velocities/vt-fps"] * FT_M == pytest.approx(50.0, rel=1e-9)
    assert fdm["aero/alpha-rad"] == pytest.approx(0.06, abs=1e-9)
    assert fdm["aero/beta-rad"] == pytest.approx(0.02, abs=1e-9)
    assert (fdm["attitude/phi-rad"], fdm["attitude/theta-rad"]) == pytest.approx(
        (0.1, 0.08), abs=1e-9
    )
    assert fdm["velocities/q-rad_sec"] == pytest.approx(-0.01, abs=1e-12)
    assert fdm["fcs/throttle-cmd-norm"] == 0.7


def test_with_the_control_system_at_rest_the_thrust_is_that_of_the_throttle_and_not_of_its_filter():
    aircraft = find_aircraft("f22")
    state, thrust = (
        BodyState(*body_velocity(129.2, 0.08, 0.0), 0.0, 0.08, 0.0),
        "propulsion/engine/thrust-lbs",
    )
    fdm, _ = open_forced(aircraft, state, {"throttle": 0.5}, 300.0, None)
    remainder = forced_state.control_equilibrium(aircraft, fdm)
    rested = force_state(
        aircraft, state, {"throttle": 0.5}, 300.0, None, (thrust,), equilibrium=remainder
    )
    first = force_state(aircraft, state, {"throttle": 0.5}, 300.0, None, (thrust,))
    assert rested[1][thrust] > 10.0 * first[1][thrust]
    # Both engines; the flaps that go down meanwhile brake a little.
    mass = fdm["inertia/mass-slugs"]
    assert (rested[0][0] - first[0][0]) == pytest.approx(
        2.0 * (rested[1][thrust] - first[1][thrust]) / mass * FT_M, rel=0.15
    )


def _evaluations(name, seed):
    """Return evaluations of random states on the shared instance and on new ones."""
    aircraft = find_aircraft(name)
    rng = np.random.default_rng(seed)
    forced_state._shared.clear()
    pairs = []
    for _ in range(12):
        V, alpha, beta, *remainder = rng.uniform(-1.0, 1.0, 8)
        uvw = body_velocity(60.0 + 10.0 * V, 0.05 + 0.05 * alpha, 0.05 * beta)
        state = BodyState(*uvw, *(0.1 * x for x in remainder), 0.01)
        controls = {
            key: float(rng.uniform(*card.limits))
            for key, card in aircraft.card.inputs.items()
            if key in ("elevator", "aileron", "rudder", "throttle")
        }
        where = (aircraft, state, controls, 500.0)
        shared = force_state(*where)[0]
        fdm, _ = open_forced(*where, None)
        pairs.append((shared, forced_state.read_accelerations(fdm, ())[0]))
    return pairs


@pytest.mark.parametrize("name", ["espaaro", "c172x"])
def test_a_reset_instance_gives_the_bits_of_a_new_one(name):
    # An actuator's memory is rearmed (espaaro); a control law's is not, and its XML is loaded anew.
    for shared, fresh in _evaluations(name, 1):
        assert shared.tobytes() == fresh.tobytes()


def test_the_throttle_drives_the_engines_that_pull(tmp_path):
    folder = foreign_aircraft.write("vtail", tmp_path)
    xml = folder / "vtail.xml"
    text = xml.read_text()
    motor = re.search(r"<engine.*?</engine>", text, re.DOTALL).group(0)
    up = '<orient unit="DEG"><pitch>90</pitch></orient></thruster>'
    lift = motor.replace("</thruster>", up)
    xml.write_text(text.replace(motor, lift + motor + lift + motor))
    fdm = open_aircraft(find_aircraft(folder))
    engine.start_engines(fdm)
    forced_state.set_command(fdm, "fcs/throttle-cmd-norm", 0.4)
    assert [fdm[f"fcs/throttle-cmd-norm[{k}]"] for k in range(4)] == [0.0, 0.4, 0.0, 0.4]
