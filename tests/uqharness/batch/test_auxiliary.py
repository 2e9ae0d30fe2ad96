"""Properties derived from the motion, places of sensors, contact with the ground, against JSBSim."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers import batch_flights as flights
from tests.helpers.batch_flights import (
    DT_S,
    METRICS,
    START,
    aircraft,
    compared,
    craft,
    flown,
    started,
    worst,
)
from tests.helpers.few import few
from uqharness.batch import auxiliary
from uqharness.batch.auxiliary import POINT, TOUCHED
from uqharness.batch.mission import initial_values
from uqharness.batch.motion import CONDITIONS
from uqharness.batch.translate.flight import TraceRequest, trace_flight
from uqharness.batch.translate.frame import Values, is_constant
from uqharness.flight.fly import contact_points
from uqharness.simulator import engine
from uqharness.simulator.aircraft import find_aircraft

RECORDS = (
    *(f"velocities/{a}-aero-fps" for a in "uvw"),
    *(f"velocities/{a}-aero-rad_sec" for a in "pqr"),
    "velocities/machU",
    "aero/qbarUW-psf",
    "aero/qbarUV-psf",
    "aero/alpha-deg",
    "aero/beta-deg",
    "aero/mag-beta-deg",
    "aero/mag-beta-rad",
    "aero/alphadot-deg_sec",
    "aero/betadot-deg_sec",
    "aero/h_b-cg-ft",
    "aero/h_b-mac-ft",
    "flight-path/gamma-deg",
    *(f"accelerations/n-pilot-{a}-norm" for a in "xyz"),
    *(f"velocities/{n}-velocity-mag-fps" for n in ("eci", "ned")),
    *(f"position/from-start-neu-{a}-ft" for a in "neu"),
    *(f"attitude/{n}-rad" for n in ("roll", "pitch", "heading-true")),
    *(f"attitude/{n}-deg" for n in ("phi", "theta", "psi")),
    "position/lat-geod-deg",
    "position/long-gc-deg",
    "position/h-sl-meters",
)


BODY = """<system name='s'><property>i/a</property><channel name='c'><pure_gain name='s/north'>
<input>position/from-start-neu-n-ft</input>
<gain>1</gain></pure_gain><pure_gain name='s/alpha'><input>aero/alpha-rad</input><gain>1</gain></pure_gain></channel></system>
<aerodynamics><axis name='Z'>
<function name='f/z'><sum><p>i/a</p><product><p>aero/alpha-rad</p><v>-30</v></product></sum></function></axis>
<axis name='PITCH'><function name='f/m'><p>i/a</p></function></axis></aerodynamics>"""


DRIVEN = {
    "i/a": np.random.default_rng(2).normal(size=31) * 4.0,
    "atmosphere/wind-north-fps": np.linspace(0.0, 20.0, 31),
}


@pytest.mark.parametrize(
    "start",
    [
        {},
        {"ic/u-fps": -40.0},
        {"ic/u-fps": 0.0, "ic/v-fps": 0.0, "ic/w-fps": 0.0},
        {"ic/lat-geod-rad": -1.2, "ic/theta-rad": -1.4},
    ],
)
def test_auxiliary_properties_are_jsbsims(start):
    result = compared(
        aircraft(BODY), (*RECORDS, "s/north", "s/alpha"), DRIVEN, 30, {**START, **start}, floor=0.1
    )
    # A place is a difference of lengths of 2e7 ft.
    places = {
        name: result.pop(name)
        for name in (*RECORDS, "s/north")
        if name in result and ("neu" in name or name == "s/north")
    }
    assert worst(result) < 1e-10
    assert worst(places) < 3e-8


def test_the_span_and_the_limit_of_speed_are_noticed(monkeypatch):
    changed = aircraft(BODY, METRICS.replace(">10</wingspan>", ">10.00001</wingspan>"))
    assert worst(compared(aircraft(BODY), RECORDS, DRIVEN, 5, changed=changed)) > 1e-8
    monkeypatch.setattr(auxiliary, "_MIN_SPEED", 1e6)
    assert worst(compared(aircraft(BODY), RECORDS, DRIVEN, 5)) > 1e-3


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


def ground_aircraft(systems: str = "", shift: str = "") -> str:
    return flights.aircraft(systems + AERODYNAMICS.replace("SHIFT", shift), ground=GROUND)


def test_derived_properties_are_jsbsims() -> None:
    """Each is copied by a system, which reads it a frame late where JSBSim's does."""
    copies = [f"i/copy-{k}" for k in range(len(DERIVED))]
    system = "".join(
        f"<fcs_function name='{copy}'><function><p>{name}</p></function></fcs_function>"
        for copy, name in zip(copies, DERIVED, strict=True)
    )
    text = ground_aircraft(f"<system name='s'><channel>{system}</channel></system>")
    records = [*DERIVED, *copies]
    assert flights.worst(flights.compared(text, records, frames=60, floor=1e-2)) < 1e-8
    plain, changed = ground_aircraft(), ground_aircraft().replace("<v>3</v>", "<v>3.001</v>")
    gaps = flights.compared(plain, DERIVED[:1], frames=20, changed=changed, floor=1e-2)
    assert gaps["forces/load-factor"] > 1e-7


def test_systems_may_set_gear_positions_and_friction() -> None:
    system = """<system name='s'><channel><summer name='i/g'><bias>.5</bias>
<output>gear/unit/pos-norm</output><output>gear/unit/static_friction_coeff</output>
<output>fcs/steer-cmd-norm</output><output>gear/unit/broken</output>
<output>ground/snow-possible</output><output>contact/unit[1]/x-position</output></summer>
</channel></system>"""
    # Authors name properties of their own as JSBSim names its.
    text = ["pos-norm", "static_friction_coeff", "broken"]
    records = [*(f"gear/unit/{name}" for name in text), "ground/snow-possible"]
    records += ["contact/unit[1]/x-position", "velocities/u-fps"]
    assert flights.worst(flights.compared(ground_aircraft(system), records, frames=20)) < 1e-9


def test_the_aerodynamic_centre_shifts_as_in_jsbsim() -> None:
    text = ground_aircraft(shift=SHIFT)
    records = ["moments/m-aero-lbsft", "velocities/q-rad_sec"]
    assert flights.worst(flights.compared(text, records, frames=60)) < 1e-9
    changed = text.replace("<v>.1</v>", "<v>.1001</v>")
    assert flights.worst(flights.compared(text, records, frames=60, changed=changed)) > 1e-7


def test_a_changed_integrator_ends_the_flight() -> None:
    """As systems that detect a crash do."""
    system = """<system name='s'><channel><switch name='i/freeze'><default
 value='simulation/integrator/rate/rotational'/><test value='0'>simulation/sim-time-sec gt .1</test>
<output>simulation/integrator/rate/rotational</output></switch></channel></system>"""
    with flights.craft(ground_aircraft(system)) as output:
        result = flights.by_batch(output, {}, ["#beyond"], 20)["#beyond"]
    assert not result[:10].any()
    assert result[13:].all()


POINTS = {
    "TAIL": ("STRUCTURE", 60, 0, -12, 0),
    "LEFT": ("BOGEY", -5, -20, -30, 1),
    "RIGHT": ("BOGEY", -5, 20, -30, 0),
    "NOSE": ("STRUCTURE", -50, 0, 6, 0),
}


GROUND_GROUND = (
    "<ground_reactions>"
    + "".join(
        f"""<contact type="{kind}" name="{name}"><location unit="IN"><x>{x}</x><y>{y}</y><z>{z}</z></location>
<static_friction>0.8</static_friction><dynamic_friction>0.5</dynamic_friction><rolling_friction>0.02</rolling_friction>
<spring_coeff unit="LBS/FT">100</spring_coeff><damping_coeff unit="LBS/FT/SEC">10</damping_coeff>
<max_steer unit="DEG">0</max_steer><brake_group>NONE</brake_group><retractable>{retracts}</retractable></contact>"""
        for name, (kind, x, y, z, retracts) in POINTS.items()
    )
    + "</ground_reactions>"
)


def contact(start, steps=120, system=""):
    """Step and number of the first contact by JSBSim, and time and number by the translation."""
    inputs = {
        **START,
        "ic/h-sl-ft": 12.0,
        "ic/u-fps": 0.0,
        "ic/v-fps": 0.0,
        "ic/w-fps": 0.0,
        "ic/q-rad_sec": 0.0,
        **start,
    }
    with craft(aircraft(f"{system}<aerodynamics/>", ground=GROUND_GROUND), inputs) as result:
        fdm, sources = result.open(), result.sources()
        points = contact_points(fdm, find_aircraft(result.root / "aircraft" / "point"))
        conditions = {name: float(fdm[name]) for name in CONDITIONS}
        values = Values(initial_values(result.open), is_constant)
        flight = trace_flight(sources, DT_S, values, TraceRequest((), [], [TOUCHED, POINT], points))
        engine.run_ic(fdm)
        present = fdm.get_property_manager().hasNode
        units = [[f"gear/unit[{k}]/WOW", f"contact/unit[{k}]/WOW"] for k in range(len(POINTS))]
        wow = [engine.handle(fdm, next(name for name in names if present(name))) for names in units]
        first = None
        for step in range(1, steps + 1):
            fdm.run()
            touching = [k for k, node in enumerate(wow) if node.get_double_value()]
            if touching:
                first = (step, touching[0])
                break
    state = started(flight, conditions)
    _, records = flown(flight.frame, state, steps)
    return first, records


@pytest.mark.parametrize(
    ("start", "name"),
    few(
        [
            ({"ic/theta-rad": 0.5, "ic/phi-rad": 0.0}, "TAIL"),
            ({"ic/theta-rad": -0.9, "ic/phi-rad": 0.0}, "NOSE"),
            ({"ic/theta-rad": 0.0, "ic/phi-rad": -0.5}, "LEFT"),
            ({"ic/theta-rad": 0.0, "ic/phi-rad": 0.5, "ic/lat-geod-rad": -0.7}, "RIGHT"),
            ({"ic/theta-rad": 0.0, "ic/phi-rad": 3.0, "ic/h-sl-ft": 5.0}, "NOSE"),
        ],
        2,
    ),
)
def test_first_ground_contact_has_its_point_and_step(start, name):
    first, records = contact(start)
    assert first is not None
    step, number = first
    assert list(POINTS)[number] == name
    assert (records[0, : step - 1] == -1.0).all()
    assert records[0, step - 1 :] == pytest.approx(step * DT_S, abs=1e-12)
    assert (records[1, step - 1 :] == number).all()


def test_contact_point_moved_by_a_system():
    start = {"ic/theta-rad": 0.5, "ic/phi-rad": 0.0}
    system = """<system name="s"><channel><summer name="i/z"><bias>60</bias>
<output>contact/unit/z-position</output></summer></channel></system>"""
    first, records = contact(start, system=system)
    assert first is not None
    step, number = first
    assert list(POINTS)[number] != "TAIL"
    assert (records[1, : step - 1] == -1.0).all()
    assert (records[1, step - 1 :] == number).all()


def test_raised_gear_makes_no_contact():
    start = {"ic/theta-rad": 0.0, "ic/phi-rad": -0.5}
    down, _ = contact(start)
    up, records = contact({**start, "gear/gear-cmd-norm": 0.0, "gear/gear-pos-norm": 0.0})
    assert down is not None
    assert up is not None
    assert (down[1], up[0] > down[0]) == (1, True)
    assert records[0, -1] == pytest.approx(up[0] * DT_S, abs=1e-12)
