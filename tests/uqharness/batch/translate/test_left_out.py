"""What is not supported is left out where the flight does not read it, and refused where it does."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers import batch_flights as flights

MAGNETOMETER = """<magnetometer name="i/compass"><axis>X</axis><location unit="M"><x>0</x><y>0</y>
<z>0</z></location>{noise}</magnetometer>"""
LIGHTS = """<system name="lights"><property value="1">i/switch</property><channel name="lights">
{magnetometer}<summer name="i/needle"><input>i/compass</input><bias>1</bias></summer>
<switch name="i/lamp"><default value="0"/><test value="1">i/needle gt 0</test></switch>
<sensor name="i/other"><input>i/switch</input><noise variation="ABSOLUTE"
 distribution="GAUSSIAN">.1</noise></sensor></channel></system>"""
FORCE = """<aerodynamics><function name="aero/shown"><p>i/lamp</p></function><axis name="X">
<function name="aero/x"><product><p>{reads}</p><v>9</v></product></function></axis></aerodynamics>"""
NOISE = '<noise variation="PERCENT" distribution="{kind}">.1</noise>'


def aircraft(reads: str, noise: str = "") -> str:
    lights = LIGHTS.replace("{magnetometer}", MAGNETOMETER.replace("{noise}", noise))
    return flights.aircraft(lights + FORCE.replace("{reads}", reads))


def test_a_chain_of_instruments_is_left_out_with_its_reasons() -> None:
    with flights.craft(aircraft("i/switch")) as made:
        flight = flights.translated(made, ["velocities/u-fps"])
    assert len(flight.left_out) == 4
    assert all("point.xml:" in reason for reason in flight.left_out)
    assert all("<magnetometer> takes the field of the day" in why for why in flight.left_out)


@pytest.mark.parametrize("reads", ["i/compass", "i/needle", "i/lamp", "aero/shown"])
def test_what_the_flight_reads_is_refused_with_the_reason_at_its_root(reads: str) -> None:
    said = flights.refused(aircraft(reads))
    assert "point.xml:" in said
    assert "<magnetometer> takes the field of the day" in said


def test_a_record_of_what_was_left_out_is_refused() -> None:
    with (
        flights.craft(aircraft("i/switch")) as made,
        pytest.raises(flights.BadInputError, match="<magnetometer>"),
    ):
        flights.translated(made, ["i/needle"])


def test_what_jsbsims_models_read_is_never_left_out() -> None:
    text = flights.aircraft(
        "<system name='s'><channel><magnetometer name='m'><location/><output>"
        "atmosphere/wind-north-fps</output></magnetometer></channel></system><aerodynamics/>"
    )
    assert "<magnetometer>" in flights.refused(text)


@pytest.mark.parametrize("kind", ["GAUSSIAN", "UNIFORM"])
def test_noise_of_what_was_left_out_is_drawn_all_the_same(kind: str) -> None:
    with flights.craft(aircraft("i/other", NOISE.replace("{kind}", kind))) as made:
        flight = flights.translated(made, ["i/other"])
    assert [name.endswith("/uniform") for name, _ in flight.draws] == [kind == "UNIFORM", False]


def test_ground_functions_are_not_taken_for_constants() -> None:
    ground = """<ground_reactions><function name="gear/load"><p>position/h-agl-ft</p></function>
</ground_reactions>"""
    text = flights.aircraft(
        FORCE.replace("{reads}", "gear/load").replace("i/lamp", "aero/qbar-psf")
    )
    said = flights.refused(text.replace("<ground_reactions/>", ground))
    assert "<function> of <ground_reactions> is not understood" in said


def test_a_flight_with_instruments_is_jsbsims() -> None:
    text = aircraft("i/switch")
    records = ["velocities/u-fps", "attitude/theta-rad", "forces/fbx-aero-lbs"]
    assert flights.worst(flights.compared(text, records, frames=50)) < 1e-9
    changed = text.replace("<v>9</v>", "<v>9.001</v>")
    assert flights.worst(flights.compared(text, records, frames=50, changed=changed)) > 1e-8


def test_host_properties_are_constants_and_inputs() -> None:
    """A property outside JSBSim's tree that the XML declares, or that the host feeds."""
    text = flights.aircraft(
        "<system name='s'><property value='.3'>/mine/flaps</property>"
        "<property value='0'>/mine/elevator</property><channel><summer name='fcs/e'>"
        "<input>/mine/elevator</input><input>/mine/flaps</input>"
        "<output>/mine/flap-position</output></summer></channel></system>"
        + FORCE.replace("{reads}", "/mine/flap-position").replace("i/lamp", "fcs/e")
    )
    elevator = {"/mine/elevator": np.sin(np.arange(61) / 7.0)}
    records = ["fcs/e", "/mine/flap-position", "velocities/u-fps"]
    assert flights.worst(flights.compared(text, records, elevator, frames=60)) < 1e-9
    changed = text.replace("value='.3'", "value='.301'").replace("<v>9</v>", "<v>9.01</v>")
    gap = flights.compared(text, records, elevator, frames=60, changed=changed)
    assert flights.worst(gap) > 1e-6
