"""Properties that JSBSim derives from the motion and few models read, against JSBSim; and the
sensors' places in every unit.
"""

from __future__ import annotations

import pytest

from tests.helpers import batch_flights as flights
from tests.helpers.few import few

DERIVED = [
    "forces/load-factor",
    "velocities/vc-kts",
    "velocities/ve-kts",
    "velocities/vtrue-kts",
    "velocities/machU",
    "position/lat-gc-rad",
    "position/lat-gc-deg",
    "position/geod-alt-km",
    "position/h-agl-km",
    "position/epa-rad",
    "position/distance-from-start-lon-mt",
    "position/distance-from-start-lat-mt",
    "position/distance-from-start-mag-mt",
    *(f"velocities/ecef-{axis}-fps" for axis in "xyz"),
    *(f"accelerations/{axis}idot-ft_sec2" for axis in "uvw"),
    *(f"forces/fb{axis}-weight-lbs" for axis in "xyz"),
    *(f"forces/fb{axis}-gear-lbs" for axis in "xyz"),
    *(f"moments/{a}-{of}-aero-lbsft" for a in ("roll", "pitch", "yaw") for of in ("stab", "wind")),
    "gear/wow",
    "gear/num-units",
    "gear/unit/wheel-speed-fps",
    "gear/unit/WOW",
    "contact/unit[1]/compression-ft",
]
GROUND = """<ground_reactions><contact type="BOGEY" name="W"><location unit="M"><x>0</x><y>0</y>
<z>-1</z></location><static_friction>.8</static_friction><retractable>1</retractable></contact>
<contact type="STRUCTURE" name="T"><location unit="FT"><x>3</x><y>0</y><z>0</z></location></contact>
</ground_reactions>"""
AERODYNAMICS = """<aerodynamics>SHIFT<axis name="LIFT"><function name="aero/l"><product>
<p>aero/qbar-area</p><v>3</v><p>aero/alpha-rad</p></product></function></axis><axis name="DRAG">
<function name="aero/d"><product><p>aero/qbar-area</p><v>.2</v></product></function></axis>
<axis name="ROLL"><function name="aero/r"><product><p>aero/qbar-area</p><v>-.2</v>
<p>velocities/p-aero-rad_sec</p></product></function></axis></aerodynamics>"""
SHIFT = """<aero_ref_pt_shift_x><function name="aero/shift"><sum><v>.1</v><p>aero/alpha-rad</p></sum>
</function></aero_ref_pt_shift_x>"""


def aircraft(systems: str = "", shift: str = "") -> str:
    return flights.aircraft(systems + AERODYNAMICS.replace("SHIFT", shift), ground=GROUND)


def test_derived_properties_are_jsbsims() -> None:
    """Each is copied by a system, which reads it a frame late where JSBSim's does."""
    copies = [f"i/copy-{k}" for k in range(len(DERIVED))]
    system = "".join(
        f"<fcs_function name='{copy}'><function><p>{name}</p></function></fcs_function>"
        for copy, name in zip(copies, DERIVED, strict=True)
    )
    text = aircraft(f"<system name='s'><channel>{system}</channel></system>")
    records = [*DERIVED, *copies]
    assert flights.worst(flights.compared(text, records, frames=60, floor=1e-2)) < 1e-8
    changed = text.replace("<v>3</v>", "<v>3.001</v>")
    found = flights.compared(text, records, frames=60, changed=changed, floor=1e-2)
    assert found["forces/load-factor"] > 1e-7


def test_systems_may_set_gear_positions_and_friction() -> None:
    system = """<system name='s'><channel><summer name='i/g'><bias>.5</bias>
<output>gear/unit/pos-norm</output><output>gear/unit/static_friction_coeff</output>
<output>fcs/steer-cmd-norm</output></summer></channel></system>"""
    records = ["gear/unit/pos-norm", "gear/unit/static_friction_coeff", "velocities/u-fps"]
    assert flights.worst(flights.compared(aircraft(system), records, frames=20)) < 1e-9


def test_the_aerodynamic_centre_shifts_as_in_jsbsim() -> None:
    text = aircraft(shift=SHIFT)
    records = ["moments/m-aero-lbsft", "velocities/q-rad_sec"]
    assert flights.worst(flights.compared(text, records, frames=60)) < 1e-9
    changed = text.replace("<v>.1</v>", "<v>.1001</v>")
    assert flights.worst(flights.compared(text, records, frames=60, changed=changed)) > 1e-7


def test_a_property_that_is_computed_where_it_is_read_cannot_be_recorded() -> None:
    with (
        flights.craft(aircraft(shift=SHIFT)) as made,
        pytest.raises(flights.BadInputError, match="aero/shift is computed only where"),
    ):
        flights.translated(made, ["aero/shift"])


@pytest.mark.parametrize("unit", few(["M", "IN", "FT"], 1))
def test_a_sensor_has_its_place_in_any_unit(unit: str) -> None:
    system = f"""<system name='s'><channel><accelerometer name='i/a'><axis>Z</axis>
<location unit="{unit}"><x>1.5</x><y>.2</y><z>.1</z></location></accelerometer></channel></system>"""
    records = ["i/a", "velocities/w-fps"]
    assert flights.worst(flights.compared(aircraft(system), records, frames=40)) < 1e-9
    other = aircraft(system.replace("<x>1.5", "<x>1.501"))
    assert flights.compared(aircraft(system), records, frames=40, changed=other)["i/a"] > 1e-7


def test_a_changed_integrator_ends_the_flight() -> None:
    """As systems that detect a crash do."""
    system = """<system name='s'><channel><switch name='i/freeze'><default
 value='simulation/integrator/rate/rotational'/><test value='0'>simulation/sim-time-sec gt .1</test>
<output>simulation/integrator/rate/rotational</output></switch></channel></system>"""
    with flights.craft(aircraft(system)) as made:
        found = flights.by_batch(made, {}, ["#beyond"], 20)["#beyond"]
    assert not found[:10].any()
    assert found[13:].all()
