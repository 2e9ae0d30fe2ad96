"""Throws, signs and thrust of an aircraft without a card, against JSBSim's response."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from sysid.record import FlightRecord
from sysid.units import FT_M, LBF_N, RAD_DEG
from uqharness.cli.main import main
from uqharness.plugin import Bounds, instrument_aircraft
from uqharness.simulator import engine, find_aircraft
from uqharness.simulator import facts as aircraft_facts
from uqharness.simulator.facts import (
    ALTITUDE_M,
)
from uqharness.simulator.staging import staged

PLANE = """<?xml version="1.0"?>
<fdm_config name="glow" version="2.0" release="ALPHA">
 <metrics>
  <wingarea unit="M2">0.5</wingarea><wingspan unit="M">2.0</wingspan><chord unit="M">0.25</chord>
  <location name="AERORP" unit="M"><x>0</x><y>0</y><z>0</z></location>
 </metrics>
 <mass_balance negated_crossproduct_inertia="false">
  <ixx unit="KG*M2">0.08</ixx><iyy unit="KG*M2">0.1</iyy><izz unit="KG*M2">0.16</izz>
  <emptywt unit="KG">2.4</emptywt>
  <location name="CG" unit="M"><x>0</x><y>0</y><z>0</z></location>
 </mass_balance>
 <ground_reactions/>
 <propulsion>
  <engine file="motor"><thruster file="prop">
   <location unit="M"><x>-0.3</x><y>0</y><z>0</z></location>
  </thruster></engine>
 </propulsion>
 <flight_control name="fcs"><channel name="surfaces">
  <aerosurface_scale name="elevator"><input>fcs/elevator-cmd-norm</input>
   <range><min>-0.3</min><max>0.3</max></range><output>fcs/elevator-pos-rad</output></aerosurface_scale>
  <aerosurface_scale name="aileron"><input>-fcs/aileron-cmd-norm</input>
   <range><min>-0.25</min><max>0.25</max></range><output>fcs/left-aileron-pos-rad</output></aerosurface_scale>
  <aerosurface_scale name="rudder"><input>fcs/rudder-cmd-norm</input>
   <range><min>-0.4</min><max>0.4</max></range><output>fcs/rudder-pos-rad</output></aerosurface_scale>
 </channel></flight_control>
 <aerodynamics>
  {lift}{drag}{side}{roll}{pitch}{yaw}
 </aerodynamics>
</fdm_config>
"""
MOTOR = '<electric_engine name="motor"><power unit="WATTS"> 400 </power></electric_engine>'
PROP = """<propeller name="prop">
 <ixx unit="KG*M2"> 0.0003 </ixx><diameter unit="IN"> 11 </diameter><numblades> 2 </numblades>
 <table name="C_THRUST" type="internal"><tableData>
  0.0 0.11
  0.8 0.01
  1.2 -0.05
 </tableData></table>
 <table name="C_POWER" type="internal"><tableData>
  0.0 0.045
  0.8 0.020
  1.2 -0.010
 </tableData></table>
</propeller>"""


def axis(name: str, length: str, *terms: tuple[float, str]) -> str:
    """One axis: q S (length) times the sum of the terms."""
    summed = "".join(
        f"<product><value>{k}</value>"
        + "".join(f"<property>{p}</property>" for p in names.split())
        + "</product>"
        for k, names in terms
    )
    scale = f"<property>{length}</property>" if length else ""
    return (
        f'<axis name="{name}"><function'
        f' name="aero/{name}"><product><property>aero/qbar-psf</property>'
        f"<property>metrics/Sw-sqft</property>{scale}<sum>{summed}</sum></product></function></axis>"
    )


AXES = {
    "lift": axis("LIFT", "", (0.35, "aero/one"), (4.6, "aero/alpha-rad")),
    "drag": axis("DRAG", "", (0.05, "aero/one")),
    "side": axis("SIDE", "", (-0.4, "aero/beta-rad")),
    "roll": axis(
        "ROLL",
        "metrics/bw-ft",
        (-0.5, "aero/bi2vel velocities/p-aero-rad_sec"),
        (0.2, "fcs/left-aileron-pos-rad"),
    ),
    "pitch": axis(
        "PITCH",
        "metrics/cbarw-ft",
        (-0.7, "aero/alpha-rad"),
        (-10.0, "aero/ci2vel velocities/q-aero-rad_sec"),
        (-1.1, "fcs/elevator-pos-rad"),
    ),
    "yaw": axis(
        "YAW",
        "metrics/bw-ft",
        (0.08, "aero/beta-rad"),
        (-0.1, "aero/bi2vel velocities/r-aero-rad_sec"),
        (-0.07, "fcs/rudder-pos-rad"),
    ),
}


@pytest.fixture(scope="module")
def electric(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An electric model aircraft whose aileron counts the other way."""
    folder = tmp_path_factory.mktemp("electric") / "glow"
    (folder / "Engines").mkdir(parents=True)
    axes = {k: v.replace("<property>aero/one</property>", "") for k, v in AXES.items()}
    (folder / "glow.xml").write_text(PLANE.format(**axes))
    (folder / "Engines" / "motor.xml").write_text(MOTOR)
    (folder / "Engines" / "prop.xml").write_text(PROP)
    return folder


def test_an_electric_aircraft_is_measured_with_its_engine_settled(electric: Path, tmp_path: Path):
    facts = aircraft_facts.measure_facts_in_child(electric)
    result = {name: (c.sense, c.throw_deg) for name, c in facts.controls.items()}
    assert result["elevator"] == (1, pytest.approx(0.3 * RAD_DEG, rel=1e-3))
    assert result["aileron"] == (-1, pytest.approx(0.25 * RAD_DEG, rel=1e-3))
    assert result["rudder"] == (1, pytest.approx(0.4 * RAD_DEG, rel=1e-3))
    closed, opened = facts.controls["throttle"].thrust_N or (math.nan, math.nan)
    assert abs(closed) < 0.1 < 5.0 < opened < 40.0
    done = instrument_aircraft(find_aircraft(electric), Bounds(), tmp_path / "out")
    assert done.verdict is not None
    assert (done.verdict.status, dict(done.unmeasured)) == ("works", {})
    assert "moves nothing" not in (tmp_path / "out" / "airframe.toml").read_text()


def changed(folder: Path, *changes: tuple[str, str]) -> Path:
    """Return the folder with changes in the aircraft's XML."""
    xml = folder / "glow.xml"
    text = xml.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    xml.write_text(text)
    return folder


LIFTS = """<engine file="motor"><thruster file="prop"><orient unit="DEG"><pitch>90</pitch></orient>
 </thruster></engine>"""


def test_the_card_names_the_throttles_of_the_engines_that_pull(electric: Path, tmp_path: Path):
    folder = Path(shutil.copytree(electric, tmp_path / "glow"))
    pulls = "<engine file" + folder.joinpath("glow.xml").read_text().split("<engine file")[1]
    pulls = pulls.split("</engine>")[0] + "</engine>"
    changed(folder, (pulls, LIFTS + pulls * 2))
    done = instrument_aircraft(find_aircraft(folder), Bounds(), tmp_path / "out")
    card = find_aircraft(done.folder).card
    assert card.inputs["throttle"].property == "fcs/throttle-cmd-norm[1]"
    assert card.host == {"fcs/throttle-cmd-norm[2]": "fcs/throttle-cmd-norm[1]"}


def test_ailerons_that_move_the_rudder_have_its_throw(electric: Path, tmp_path: Path):
    folder = Path(shutil.copytree(electric, tmp_path / "glow"))
    aileron = '<aerosurface_scale name="aileron">'
    xml = (folder / "glow.xml").read_text()
    component = aileron + xml.split(aileron)[1].split("</aerosurface_scale>")[0]
    changed(
        folder,
        (component + "</aerosurface_scale>", ""),
        ("<input>fcs/rudder-cmd-norm", "<input>fcs/aileron-cmd-norm"),
        ("fcs/left-aileron-pos-rad", "fcs/rudder-pos-rad"),
    )
    facts = aircraft_facts.measure_facts(folder)
    assert facts.controls["rudder"].sense == 0
    assert facts.controls["aileron"].throw_deg == pytest.approx(0.4 * RAD_DEG, rel=1e-3)
    assert facts.controls["aileron"].sense == 1


# J246 and the like are launchers, ball and the like have no controls; what reads a host's
# properties does not fly by itself.
DEFAULT = ("c172p", "F450")
FLYING = """
pa28 sgs126 737 787-8 A320 A4 B17 B747 Boeing314 C130 Camel Concorde DHC6 F4N F80C J3Cub MD11 OV10 SGS T37 T38 X15 XB-70 c172r c172x
c182 c310 f15 f16 f22 global5000 minisgs p51d paraglider pc7 pogo-jsbsim sgs233 t6texan2 L410
"""
STOCK = [*DEFAULT, *(pytest.param(name, marks=pytest.mark.slow) for name in FLYING.split())]
POSITIONS = {
    "elevator": "fcs/elevator-pos-rad",
    "aileron": "fcs/left-aileron-pos-rad",
    "rudder": "fcs/rudder-pos-rad",
}
ACCELERATIONS = {
    "elevator": ("accelerations/qdot-rad_sec2", -1.0),
    "aileron": ("accelerations/pdot-rad_sec2", 1.0),
    "rudder": ("accelerations/rdot-rad_sec2", -1.0),
}


def response(name: str, V_mps: float, control: str, value: float, frames: int) -> dict[str, float]:
    """JSBSim alone: state held by its integrators' switches, one command held, frames of 0.01 s."""
    fdm = engine.open_fdm(staged(find_aircraft(name)), 0.01)
    fdm["ic/lat-geod-deg"], fdm["ic/h-sl-ft"] = 45.0, ALTITUDE_M / FT_M
    fdm["ic/theta-deg"] = 3.0
    fdm["ic/u-fps"], fdm["ic/w-fps"] = (
        V_mps / FT_M * math.cos(math.radians(4.0)),
        V_mps / FT_M * math.sin(math.radians(4.0)),
    )
    fdm.run_ic()
    exists = fdm.get_property_manager().hasNode
    engines = fdm.get_propulsion().get_num_engines()
    if engines:
        fdm["propulsion/set-running"] = -1
    for k in range(engines):
        index = f"[{k}]" if k else ""
        for lever, setting in (("throttle", 0.6), ("mixture", 1.0), ("advance", 1.0)):
            if exists(f"fcs/{lever}-cmd-norm{index}"):
                fdm[f"fcs/{lever}-cmd-norm{index}"] = setting
        if control == "throttle":
            fdm[f"fcs/throttle-cmd-norm{index}"] = value
    if control != "throttle":
        fdm[f"fcs/{control}-cmd-norm"] = value
    if exists("propulsion/engine/map-inhg"):
        fdm["propulsion/magneto_cmd"], fdm["propulsion/starter_cmd"] = 3.0, 1.0
    for kind in (
        "rate/rotational",
        "rate/translational",
        "position/rotational",
        "position/translational",
    ):
        fdm[f"simulation/integrator/{kind}"] = 0.0
    for k in range(frames):
        if k == 300 and exists("propulsion/engine/map-inhg"):
            fdm["propulsion/starter_cmd"] = 0.0
        fdm.run()
    read = {n: float(fdm[n]) for n, _ in ACCELERATIONS.values()}
    read |= {n: float(fdm[n]) for n in POSITIONS.values() if exists(n)}
    read["thrust_N"] = LBF_N * sum(
        fdm[f"propulsion/engine[{k}]/thrust-lbs"] for k in range(engines)
    )
    return read


@pytest.mark.parametrize("name", STOCK)
def test_the_cards_throws_signs_and_thrust_are_those_of_jsbsims_response(name: str):
    facts = aircraft_facts.measure_facts_in_child(find_aircraft(name).folder)
    for control, (acceleration, sign) in ACCELERATIONS.items():
        low, high = (response(name, facts.V_mps, control, end, 300) for end in (-1.0, 1.0))
        result = facts.controls[control]
        assert not result.unmeasured
        if result.throw_deg is not None:
            throw = 0.5 * abs(high[POSITIONS[control]] - low[POSITIONS[control]]) * RAD_DEG
            assert result.throw_deg == pytest.approx(throw, rel=0.02)
            change = sign * (high[acceleration] - low[acceleration])
            assert result.sense == math.copysign(1.0, change)
    throttle = facts.controls["throttle"]
    # Concorde's engines give no thrust where they are started after initialising, as `response`
    # does.
    if throttle.thrust_N is not None and name != "Concorde":
        opened = response(name, facts.V_mps, "throttle", 1.0, 6000)["thrust_N"]
        assert throttle.thrust_N[1] == pytest.approx(opened, rel=0.02)


def test_ailerons_of_unequal_travel_are_recorded_by_the_mean_that_moves_the_aircraft(
    tmp_path: Path,
):
    card = tmp_path / "c172x"
    assert main(["instrument", "c172x", "--no-check", "--quiet", "--out", str(card)]) == 0
    aileron = find_aircraft(card).card.inputs["aileron"]
    assert (aileron.position, aileron.position_unit) == ("fcs/effective-aileron-pos", "rad")
    out = tmp_path / "flight.parquet"
    words = ["--mission", "doublets", "--speed-mps", "50", "--altitude-m", "500"]
    assert main(["fly", str(card), *words, "--duration-s", "9", "--out", str(out)]) == 0
    record = FlightRecord.read(out)
    command, position = record["aileron_deg"], record["aileron_pos_deg"]
    steps = np.flatnonzero(np.abs(np.diff(command)) > 3.0) + 1
    assert len(steps) >= 2
    # Each aileron slews by 1.57 rad/s, and hysteresis leaves half of .005 rad.
    assert np.abs(np.diff(position)).max() / record.dt_s <= 1.02 * 1.57 * RAD_DEG
    assert np.abs((position - command)[steps]).min() > 2.0
    settled = np.ptp([command[k : len(command) - 20 + k] for k in range(20)], axis=0) == 0.0
    assert np.abs((position - command)[19:-1][settled]).max() < 1.02 * 0.0025 * RAD_DEG + 0.03
