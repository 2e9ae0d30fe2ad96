"""An aircraft made for FlightGear flies in JSBSim alone with what FlightGear would write."""

from __future__ import annotations

import pytest

from uqharness.plugin.apply import with_card
from uqharness.simulator import HOST_SYSTEM, SteadyCondition, find_aircraft, find_trim
from uqharness.simulator import facts as aircraft_facts
from uqharness.simulator.forced_state import BodyState, body_velocity, open_forced
from uqharness.simulator.host import SWITCH
from uqharness.xml import folder_names

THRUST = "propulsion/engine/thrust-lbs"


@pytest.fixture(scope="module")
def p51d():
    return with_card(find_aircraft("p51d"))


def thrust_lbf(aircraft, throttle, switch=1.0):
    state = BodyState(*body_velocity(90.0, 0.05, 0.0), 0.0, 0.05, 0.0)
    fdm, _ = open_forced(aircraft, state, {"throttle": throttle}, 200.0, {SWITCH: switch})
    return fdm[THRUST]


def test_what_an_aircraft_reads_of_flightgear_is_found_and_nothing_that_it_writes_itself():
    facts = aircraft_facts.measure_facts_in_child(find_aircraft("p51d").folder)
    assert facts.controls["throttle"].thrust_N[1] > facts.controls["throttle"].thrust_N[0]
    found = {row.name: row.source for row in facts.host}
    assert found["/controls/engines/engine/throttle"] == "fcs/throttle-cmd-norm"
    assert found["/engines/engine/mp-inhg"] == "propulsion/engine/map-inhg"
    assert "/controls/engines/engine/feed_tank" not in found
    facts = aircraft_facts.measure_facts_in_child(find_aircraft("c172p").folder)
    assert facts.host == ()
    assert facts.controls["throttle"].sense == 1


def test_the_throttle_moves_the_thrust_and_not_without_the_host(p51d):
    low, high = (thrust_lbf(p51d, throttle) for throttle in (0.3, 0.9))
    assert high > low + 800.0
    # The governor holds the manifold pressure that its table asks of the throttle; nine tenths of
    # it.
    low, high = (thrust_lbf(p51d, throttle, switch=0.0) for throttle in (0.3, 0.9))
    assert low == high


@pytest.mark.slow
def test_it_trims_and_flies_on_at_that_speed(p51d):
    trim = find_trim(p51d, SteadyCondition(90.0, 200.0))
    assert trim.converged, trim.reason
    fdm, _ = open_forced(p51d, trim.state, trim.controls, 200.0, None, trim.equilibrium)
    speed, thrust = fdm["velocities/vt-fps"], fdm[THRUST]
    while fdm.get_sim_time() < 2.0:
        fdm.run()
    assert fdm["velocities/vt-fps"] == pytest.approx(speed, rel=1e-3)
    assert fdm[THRUST] == pytest.approx(thrust, rel=0.01)


def test_the_copy_says_what_is_passed_on(p51d):
    assert p51d.card.host["/controls/engines/engine/throttle"] == "fcs/throttle-cmd-norm"
    assert folder_names(p51d.folder, SWITCH)
    assert (p51d.folder / "Systems" / f"{HOST_SYSTEM}.xml").is_file()
    assert not folder_names(with_card(find_aircraft("J3Cub")).folder, SWITCH)
