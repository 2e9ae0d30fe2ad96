"""Aircraft in the styles in which people publish theirs, from nothing to a p-box."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.helpers import foreign_aircraft, gallery
from tests.helpers.few import few
from uqharness.batch.course import fly_many
from uqharness.flight.fly import fly
from uqharness.flight.spec import FlightSpec
from uqharness.plugin.apply import instrument_aircraft, undo
from uqharness.plugin.instrument import Bounds
from uqharness.simulator import (
    SteadyCondition,
    engine,
    find_aircraft,
    find_trim,
    host_properties,
    open_aircraft,
)
from uqharness.simulator.aircraft import with_rotor_inertia
from uqharness.simulator.own_mission import StartSection, write_steady_start
from uqharness.simulator.staging import model_files

# In a process of its own and without this project: the copy is plain JSBSim.
PLAIN = """
import json, sys, jsbsim
folder, name, V, controls = sys.argv[1], sys.argv[2], float(sys.argv[3]), json.loads(sys.argv[4])
fdm = jsbsim.FGFDMExec(None)
fdm.set_debug_level(0)
fdm.set_aircraft_path(folder)
fdm.set_engine_path(folder)
assert fdm.load_model(name)
fdm["ic/h-sl-ft"], fdm["ic/vt-fps"] = 660.0, V / 0.3048
fdm["ic/alpha-rad"] = fdm["ic/theta-rad"] = controls.pop("alpha")
fdm["propulsion/set-running"] = -1
for key, value in controls.items():
    fdm[key] = value
fdm.run_ic()
while fdm.get_sim_time() < 2.0:
    fdm.run()
print(json.dumps([fdm["velocities/vt-fps"] * 0.3048, fdm["attitude/phi-rad"]]))
"""


@pytest.fixture(scope="module")
def copies(tmp_path_factory):
    parent = tmp_path_factory.mktemp("foreign")
    result = {}

    def copy(style):
        if style not in result:
            folder = foreign_aircraft.write(style, parent)
            result[style] = instrument_aircraft(
                find_aircraft(folder), Bounds(), parent / "aircraft" / style, check=style == "wing"
            )
        return result[style]

    return copy


@pytest.mark.parametrize("style", ["single", pytest.param("twin", marks=pytest.mark.slow)])
def test_the_copy_trims_and_flies_on_in_jsbsim_alone(copies, style):
    aircraft = find_aircraft(copies(style).folder)
    V = foreign_aircraft.SPEEDS_MPS[style]
    trim = find_trim(aircraft, SteadyCondition(V, 200.0))
    assert trim.converged, trim.reason
    assert trim.controls["throttle"] > 0.0
    controls = {aircraft.card.inputs[name].property: v for name, v in trim.controls.items()}
    words = (str(aircraft.folder.parent), style, str(V))
    child = subprocess.run(
        [sys.executable, "-c", PLAIN, *words, json.dumps({"alpha": trim.alpha_rad, **controls})],
        capture_output=True,
        text=True,
        check=True,
    )
    speed, bank = json.loads(child.stdout.splitlines()[-1])
    # The engine spins up from JSBSim's own start; without the host it would stop or dive.
    assert speed == pytest.approx(V, rel=0.05)
    assert abs(bank) < 0.3


def test_a_throttle_of_another_name_is_found_by_its_effect(copies):
    done = copies("wing")
    card = find_aircraft(done.folder).card
    assert card.inputs["throttle"].property == "uav/motor-command"
    assert done.verdict.status == "works", done.verdict.reason
    assert any("uav/motor-command" in note for note in done.notes)
    # Elevons: both axes are measured, and no rudder is invented.
    text = (done.folder / "airframe.toml").read_text()
    dead = [line for line in text.splitlines() if "moves nothing" in line]
    assert [line.split("]")[0] for line in dead] == ["[inputs.rudder"]


def test_throttles_of_other_names_that_pull_alike_are_one_control(tmp_path):
    folder = foreign_aircraft.write("wing", tmp_path)
    xml = folder / "wing.xml"
    # Two motors without a propeller of their own, at half the wing's thrust each.
    force = """<force name="{0}" frame="BODY"><function><product><value>2</value>
    <property>uav/{0}</property></product></function><location unit="M"><x>0</x><y>{1}</y><z>0</z>
    </location><direction><x>1</x><y>0</y><z>0</z></direction></force>
    <moment name="{0}-torque" frame="BODY"><function><product><value>0.01</value>
    <property>uav/{0}</property></product></function><location unit="M"><x>9</x><y>9</y><z>9</z>
    </location><direction><x>1</x><y>0</y><z>0</z></direction></moment>"""
    text = re.sub("<propulsion>.*</propulsion>", "<propulsion/>", xml.read_text(), flags=re.DOTALL)
    text = re.sub('<channel name="Motor">.*?</channel>', "", text, flags=re.DOTALL)
    declared = "<property>uav/motor-left</property><property>uav/motor-right</property>"
    forces = declared + force.format("motor-left", -0.3) + force.format("motor-right", 0.3)
    reactions = f"<external_reactions>{forces}</external_reactions>"
    text = text.replace("<aerodynamics>", f"{reactions}<aerodynamics>")
    xml.write_text(text)
    done = instrument_aircraft(find_aircraft(folder), Bounds(), tmp_path / "mine", check=False)
    card = find_aircraft(done.folder).card
    first = card.inputs["throttle"].property
    (second,) = {"uav/motor-left", "uav/motor-right"} - {first}
    assert card.host[second] == first
    trim = find_trim(find_aircraft(done.folder), SteadyCondition(15.0, 200.0))
    assert trim.converged, trim.reason
    assert abs(trim.controls["aileron"]) < 0.05


def test_without_ailerons_the_rudder_holds_the_wings(tmp_path):
    folder = foreign_aircraft.write("wing", tmp_path)
    xml = folder / "wing.xml"
    rudder = (
        '<aerosurface_scale name="yaw"><input>fcs/rudder-cmd-norm</input>'
        "<range><min>-0.35</min><max>0.35</max></range><output>uav/fin-angle</output>"
        "</aerosurface_scale>"
    )
    text = xml.read_text().replace("uav/motor-command", "fcs/throttle-cmd-norm")
    # The torque of the propeller rolls, and nothing but the rudder acts sideways.
    text = text.replace('<channel name="Motor">', f'<channel name="Motor">{rudder}')
    xml.write_text(text.replace("<property>elevon/roll</property>", "<value>0</value>"))
    trim = find_trim(find_aircraft(folder), SteadyCondition(15.0, 200.0))
    assert trim.converged, trim.reason
    assert abs(trim.controls["rudder"]) > 0.01
    assert 0.0 < abs(trim.condition.bank_rad) < math.radians(5.0)


def test_an_edited_host_is_flown_and_written_again(copies, tmp_path, capsys):
    folder = foreign_aircraft.write("single", tmp_path)
    out = tmp_path / "copy" / "single"
    instrument_aircraft(find_aircraft(folder), Bounds(), out, check=False)
    card = out / "airframe.toml"
    entry = '"/controls/electric/battery-switch" = '
    assert f"{entry}1.0" in card.read_text()
    card.write_text(card.read_text().replace(f"{entry}1.0", f"{entry}0.0"))
    # Without the battery the magnetos are off and the engine stops.
    trim = find_trim(find_aircraft(out), SteadyCondition(50.0, 200.0))
    assert not trim.converged
    system = out / "Systems" / "flightgear-host.xml"
    assert b'"1">/controls/electric/battery-switch' in system.read_bytes()
    instrument_aircraft(find_aircraft(out), Bounds(), out, check=False)
    assert b'"0">/controls/electric/battery-switch' in system.read_bytes()
    # A number in place of a copy is not copied over again.
    text = card.read_text().replace('elevator" = "fcs/elevator-cmd-norm"', 'elevator" = 0.125')
    card.write_text(text)
    for write in (False, True):
        if write:
            instrument_aircraft(find_aircraft(out), Bounds(), out, check=False)
        assert host_properties(find_aircraft(out)) == ()
        fdm = open_aircraft(find_aircraft(out))
        engine.run_ic(fdm)
        assert fdm["/controls/flight/elevator"] == 0.125


def test_an_author_s_card_gets_the_host_and_undo_takes_it_out(tmp_path):
    folder = foreign_aircraft.write("glider", tmp_path)
    card = folder / "airframe.toml"
    card.write_text('[aircraft]\nname = "glider"\nxml = "glider.xml"')
    author = card.read_bytes()
    out = tmp_path / "copy" / "glider"
    instrument_aircraft(find_aircraft(folder), Bounds(), out, check=False)
    host = find_aircraft(out).card.host
    assert host["/position/altitude-agl-ft"] == "position/h-agl-ft"
    assert host["/sim/hitches/aerotow/open"] == 1.0
    undo(out, out)
    assert (out / "airframe.toml").read_bytes() == author
    assert (out / "glider.xml").read_bytes() == (folder / "glider.xml").read_bytes()


@pytest.mark.slow
def test_a_light_propeller_gets_a_step_at_which_it_is_stable(tmp_path):
    folder = foreign_aircraft.write("vtail", tmp_path)
    screw = folder / "Engines" / "small_airscrew.xml"
    screw.write_text(screw.read_text().replace("0.0004", "0.00002"))
    done = instrument_aircraft(
        find_aircraft(folder), Bounds(), tmp_path / "copy" / "vtail", check=False
    )
    aircraft = find_aircraft(done.folder)
    assert aircraft.dt_s < 0.01
    assert any("unstable at a step of 0.01 s" in note for note in done.notes)
    assert find_trim(aircraft, SteadyCondition(15.0, 200.0)).converged


@pytest.mark.slow
@pytest.mark.parametrize("style", list(gallery.SPEEDS_MPS))
def test_three_commands_lead_to_a_p_box(style, tmp_path):
    row = gallery.take(style, tmp_path, duration_s=2.0)
    assert (tmp_path / "results" / "pbox.parquet").is_file()
    assert row.flights >= 64
    low, high = row.altitude_m
    assert 0.0 <= low < high < 50.0
    if style != "glider":
        assert 0.0 < row.throttle_pct < 100.0
    assert row.engine == "batch" or row.reason


def test_the_gallery_has_a_row_for_each_aircraft():
    rows = [line.split("|") for line in gallery.PAGE.read_text().splitlines() if "m/s |" in line]
    assert [row[1].strip() for row in rows] == list(gallery.SPEEDS_MPS)
    for row in rows:
        style = row[1].strip()
        assert row[2].strip() == gallery.DESCRIPTIONS[style]
        assert float(row[3].split()[0]) == gallery.SPEEDS_MPS[style]
        assert row[7].split(":")[0].strip() in ("", "batch", "jsbsim")


@pytest.fixture
def foam(tmp_path):
    """Return an electric foam wing with JSBSim's throttle, whose moments feel rates of incidence."""
    folder = foreign_aircraft.write("wing", tmp_path)
    xml = folder / "wing.xml"
    text = xml.read_text().replace("uav/motor-command", "fcs/throttle-cmd-norm")
    lag = foreign_aircraft.product(
        "aero/qbar-psf",
        "metrics/Sw-sqft",
        "metrics/cbarw-ft",
        "aero/ci2vel",
        "aero/alphadot-rad_sec",
        -6.0,
    )
    axis = '<axis name="PITCH">'
    assert axis in text
    xml.write_text(
        text.replace(axis, f'{axis}<function name="aero/pitch/alphadot">{lag}</function>')
    )
    return folder


def test_electric_motors_start_settled_in_the_batch_engine_as_in_jsbsim(foam):
    script = foam.parent / "steady.xml"
    trim = write_steady_start(
        find_aircraft(foam), StartSection(V_mps=15.0, altitude_m=200.0), script, ""
    )
    # A flying wing has no rudder: the search leaves it where it is.
    assert trim.controls["rudder"] == 0.0
    spec = FlightSpec(foam, script, 1.0, wind_mps=3.0, record_rate_hz=50.0)
    theirs, (ours,) = fly(spec), fly_many([spec])
    for name in ("V_mps", "alpha_rad", "theta_rad", "height_m"):
        if name in theirs.signals:
            error = np.max(np.abs(theirs.signals[name] - ours.signals[name]))
            assert error < 1e-8 * np.max(np.abs(theirs.signals[name])), name


# Efficiency by the manifold's pressure, and a header tank that a valve fills to 90 % and leaves.
FEEDBACK = """
<system name="feedback"><channel name="engine">
<fcs_function name="feedback/efficiency"><function><table>
<independentVar lookup="row">propulsion/engine/map-inhg</independentVar>
<independentVar lookup="column">atmosphere/density-altitude</independentVar>
<tableData breakPoint="0">
      0  9000
  10  0.5  0.4
  30  0.9  0.8
</tableData></table></function><output>propulsion/engine/volumetric-efficiency</output></fcs_function>
<switch name="feedback/valve"><default value="0"/>
<test logic="AND" value="0.5">
<test logic="OR">
/controls/fuel/selector EQ 3
/controls/fuel/selector EQ 1
</test>
propulsion/tank[1]/pct-full LT 90
</test></switch>
<pure_gain name="feedback/fill"><input>feedback/valve</input><gain>1</gain>
<output>propulsion/tank[1]/external-flow-rate-pps</output></pure_gain>
<pure_gain name="feedback/drain"><input>-feedback/valve</input><gain>1</gain>
<output>propulsion/tank/external-flow-rate-pps</output></pure_gain>
</channel></system>
"""
HEADER_TANK = """
<tank type="FUEL"><location unit="IN"><x>9</x><y>30</y><z>0</z></location>
<capacity unit="LBS">0.05</capacity><contents unit="LBS">0</contents></tank>
"""


@pytest.mark.parametrize("style", few(["single", "contra", "turboprop"], 1))
def test_engines_that_long_steps_stop_start_settled_in_the_batch_engine(style, tmp_path):
    folder = foreign_aircraft.write(style, tmp_path)
    if style == "single":
        xml = folder / "single.xml"
        system = f"{HEADER_TANK}</propulsion>{FEEDBACK}"
        xml.write_text(xml.read_text().replace("</propulsion>", system))
    start = StartSection(V_mps=gallery.SPEEDS_MPS[style], altitude_m=200.0)
    script = tmp_path / "steady.xml"
    write_steady_start(find_aircraft(folder), start, script, "test")
    spec = FlightSpec(folder, script, 1.0, wind_mps=3.0, record_rate_hz=50.0)
    theirs, (ours,) = fly(spec), fly_many([spec])
    assert ours.status == theirs.status == "ok"
    assert "alpha_rad" in theirs.signals
    for name, signal in theirs.signals.items():
        error = np.max(np.abs(signal - ours.signals[name]))
        assert error <= 1e-7 * max(np.max(np.abs(signal)), 1e-3), (name, error)


def test_turbines_start_with_steady_fuel_flow_in_both_engines(copies, tmp_path):
    # Levers that move slowly bring the control system to rest; the author adds an oil gauge.
    slow = """<pure_gain name="slow/degrees-{0}"><input>fcs/throttle-cmd-norm[{0}]</input>
    <gain>120</gain></pure_gain>
    <kinematic name="slow/lever-{0}"><input>slow/degrees-{0}</input><noscale/><traverse>
    <setting><position>0</position><time>0</time></setting>
    <setting><position>120</position><time>0.5</time></setting></traverse></kinematic>
    <pure_gain name="slow/norm-{0}"><input>slow/lever-{0}</input><gain>0.008333333333333333</gain>
    <output>fcs/throttle-pos-norm[{0}]</output></pure_gain>
    <pure_gain name="propulsion/engine[{0}]/oil-pressure-psi"><input>propulsion/engine[{0}]/n2</input>
    <gain>0.5</gain></pure_gain>"""
    folder = Path(shutil.copytree(copies("jet").folder, tmp_path / "jet"))
    file = folder / "Systems" / "hydraulics.xml"
    channel = f'<channel name="slow">{slow.format(0)}{slow.format(1)}</channel>'
    file.write_text(file.read_text().replace("</system>", f"{channel}</system>"))
    engines = folder / "Engines" / "turbofan.xml"
    engines.write_text(re.sub("<tsfc>.*?</tsfc>", "<tsfc>9</tsfc>", engines.read_text()))
    script = tmp_path / "steady.xml"
    start = StartSection(V_mps=gallery.SPEEDS_MPS["jet"], altitude_m=200.0)
    write_steady_start(find_aircraft(folder), start, script, "test")
    spec = FlightSpec(folder, script, 1.0, wind_mps=3.0, record_rate_hz=50.0)
    theirs, (ours,) = fly(spec), fly_many([spec])
    assert ours.status == theirs.status == "ok"
    for name, signal in theirs.signals.items():
        error = np.max(np.abs(signal - ours.signals[name]))
        assert error <= 1e-7 * max(np.max(np.abs(signal)), 1e-3), (name, error)


@pytest.mark.slow
def test_a_propeller_without_inertia_gets_a_typical_one_and_undo_takes_it_back(foam, caplog):
    screw = foam / "Engines" / "small_airscrew.xml"
    author = screw.read_bytes()
    assert with_rotor_inertia(find_aircraft(foam), model_files(find_aircraft(foam))) == {}
    screw.write_bytes(re.sub(rb"<ixx[^>]*>[^<]*</ixx>", b"<ixx>   0.00 </ixx>", author))
    author = screw.read_bytes()
    with caplog.at_level("INFO", logger="uqharness"):
        assert find_trim(find_aircraft(foam), SteadyCondition(15.0, 200.0)).converged
    line = 1 + author[: author.index(b"<ixx>")].count(b"\n")
    assert f"small_airscrew.xml:{line}: <ixx> is 0" in caplog.text
    out = foam.parent / "copy" / "wing"
    instrument_aircraft(find_aircraft(foam), Bounds(), out, check=False)
    assert b'<ixx unit="SLUG*FT2">' in (out / "Engines" / screw.name).read_bytes()
    undo(out, out)
    assert (out / "Engines" / screw.name).read_bytes() == author


def test_a_lever_that_moves_air_brakes_is_no_throttle(tmp_path):
    folder = foreign_aircraft.write("glider", tmp_path)
    lever = "/controls/engines/engine/throttle"
    drag = foreign_aircraft.product("aero/qbar-psf", "metrics/Sw-sqft", 0.1, lever).replace(
        f"<property>{lever}</property>",
        f"<difference><value>1</value><property>{lever}</property></difference>",
    )
    xml = folder / "glider.xml"
    axis = '<axis name="DRAG">'
    text = xml.read_text()
    assert axis in text
    xml.write_text(text.replace(axis, f'{axis}<function name="aero/drag/brake">{drag}</function>'))
    (folder / "airframe.toml").write_text(
        '[aircraft]\nname = "glider"\nxml = "glider.xml"\n'
        f'[inputs.throttle]\nproperty = "{lever}"\nunit = "norm"\nlimits = [0, 1]\n'
        + "".join(
            f'[inputs.{name}]\nproperty = "fcs/{name}-cmd-norm"\nunit = "norm"\nlimits = [-1, 1]\n'
            for name in ("elevator", "aileron", "rudder")
        )
    )
    trim = find_trim(find_aircraft(folder), SteadyCondition(28.0, 500.0))
    assert trim.converged, trim.reason
    assert trim.controls["throttle"] == 1.0
    assert -0.1 < trim.condition.climb_rad < -0.01
