"""Properties that a host such as FlightGear provides."""

from __future__ import annotations

import re
import shutil

import pytest

from tests.helpers import foreign_aircraft
from uqharness.errors import BadInputError
from uqharness.simulator import engine, find_aircraft, host, open_aircraft, staged
from uqharness.simulator.aircraft import content_hash, fuel_levels, host_properties


def reads(names, computed=(), declared=None):
    return host.Names(dict.fromkeys(names, "x.xml:1"), set(computed), dict(declared or {}))


def sources_of(listed, missing=()):
    rows = host.resolve(listed, dict.fromkeys(missing, ""), lambda name: True)
    return {row.name: (row.source, row.kind) for row in rows}


def sources(names, **remaining):
    return sources_of(reads(names, **remaining), names)


def with_readings(folder, names):
    """Let a function of the aircraft read properties."""
    xml = next(folder.glob("*.xml"))
    read = "".join(f"<property>{name}</property>" for name in names)
    function = f'<function name="test/read"><sum>{read}<value>0</value></sum></function>'
    text = xml.read_text().replace("<aerodynamics>", f"<aerodynamics>{function}")
    xml.write_text(text)
    return find_aircraft(folder)


@pytest.mark.parametrize(
    ("name", "source", "kind"),
    [
        ("/controls/flight/rudder", "-1 * fcs/rudder-cmd-norm", "control"),
        ("controls/flight/flaps", "fcs/flap-cmd-norm", "control"),
        ("/controls/engines/engine/throttle", "fcs/throttle-cmd-norm", "control"),
        ("/controls/engines/engine[1]/throttle", "fcs/throttle-cmd-norm[1]", "control"),
        ("/controls/engines/engine[2]/throttle-fdm", "fcs/throttle-cmd-norm[2]", "control"),
        ("/engines/engine[3]/thruster/rpm", "propulsion/engine[3]/propeller-rpm", "state"),
        ("/gear/gear[2]/wow", "gear/unit[2]/WOW", "state"),
        ("/gear/gear/compression-norm", "gear/unit/compression-ft", "state"),
        ("/controls/engines/engine[0]/magnetos", "3", "system"),
        ("/systems/hydraulic/pressure-psi", "3000", "system"),
        ("/systems/electrical/outputs/fuel-pump", "28", None),
        ("systems/electrical/battery-switch", "1", "system"),
        ("/controls/fuel/tank[1]/fuel_selector", "1", "system"),
        ("/sim/failure-manager/controls/flight/elevator/serviceable", "1", "system"),
        ("/sim/model/pushback/enabled", "0", "unknown"),
        ("/sim/hitches/aerotow/open", "1", "system"),
        ("/controls/gear/brake-parking", "0", "unknown"),
        ("/systems/electrical/external-power-switch", "0", "unknown"),
        ("/sim/model/door-positions/left/position-norm", "0", "unknown"),
        ("/systems/electrical/outputs/flaps", "28", "system"),
        ("/engines/engine/manual-power-reduction-pct", "0", "unknown"),
        ("/controls/engines/engine/boost-cutout", "0", "unknown"),
        ("/test-factor", "1", "system"),
    ],
)
def test_a_name_has_the_source_that_flightgear_would_write(name, source, kind):
    result = sources([host.canonical(name)])[host.canonical(name)]
    if kind is None:  # a bus without "volts" in its name is merely on
        assert result == ("1", "system")
    else:
        assert result == (source, kind)


def test_a_brake_that_the_author_set_for_the_start_is_released():
    brake, switch = "/controls/engines/engine/propeller-brake", "/controls/electric/master-switch"
    declared = {brake: 1.0, switch: 1.0, "/controls/engines/engine/friction": 0.0}
    assert sources_of(reads(declared, declared=declared)) == {brake: ("0", "unknown")}


def test_a_switch_that_is_off_before_the_engines_start_is_on():
    selector, door = "/controls/fuel/tank-selector", "/sim/model/door-positions/left"
    declared = {selector: 0.0, door: 0.0, "/controls/fuel/pump": 2.0}
    assert sources_of(reads(declared, declared=declared)) == {selector: ("1", "system")}
    rows = host.with_initial_values([host.HostProperty(selector, "1", "system")], {selector: 2.0})
    assert rows[0].source == "2"


def test_a_switch_has_the_position_that_conditions_ask_for():
    condition = "<system><channel name='c'><switch name='t/s'><test value='1'>{}</test></switch>"
    names_read = ["/engines/magneto-left", "/engines/magnetos"]
    text = condition.format("{} == 1\n{} eq 3".format(*names_read)) + "</channel></system>"
    result = sources_of(host.scan([("x.xml", text.encode())]), names_read)
    assert result == {
        "/engines/magneto-left": ("1", "system"),
        "/engines/magnetos": ("3", "system"),
    }


def test_switches_of_an_engine_that_the_aircraft_lacks_stay_off():
    names = ["/controls/engines/engine/magnetos", "/controls/engines/engine[1]/magnetos"]
    one_engine = re.compile(r"(?!propulsion/engine\[1\])")
    rows = host.resolve(reads(names), dict.fromkeys(names, ""), lambda name: one_engine.match(name))
    assert [row.source for row in rows] == ["3", "0"]


def test_a_misspelt_name_of_jsbsim_is_told_from_a_name_of_the_host(tmp_path):
    folder = foreign_aircraft.write("glider", tmp_path)
    aircraft = with_readings(folder, ["velocities/vc-knts"])
    with pytest.raises(BadInputError, match=r"glider.xml:\d+.*did you mean velocities/vc-kts"):
        open_aircraft(aircraft)
    (folder / "airframe.toml").write_text(
        '[aircraft]\nname = "glider"\nxml = "glider.xml"\n[host]\n"velocities/vc-knts" = 2.5\n'
    )
    assert open_aircraft(find_aircraft(folder))["velocities/vc-knts"] == 2.5


@pytest.mark.parametrize(
    ("name", "similar", "misspelt"),
    [
        ("propulsion/engine/cutoff-commanded", "propulsion/engine/cutoff", False),
        ("propulsion/engine/set-runing", "propulsion/engine/set-running", True),
        ("fcs/flap-pos", "fcs/flap-pos-deg", True),
        ("aero/alpha-degrees", "aero/alpha-deg", True),
    ],
)
def test_a_name_that_extends_another_one_by_a_word_is_a_script_s(name, similar, misspelt):
    (row,) = host.resolve(reads([name]), {name: similar}, lambda _: True)
    assert row.misspelt is misspelt


@pytest.mark.parametrize("source", ['"0.5 * fcs/flap-cmd-norm + 0.25"', "0.25"])
def test_an_entry_of_the_card_replaces_a_source(tmp_path, source):
    folder = foreign_aircraft.write("single", tmp_path)
    (folder / "airframe.toml").write_text(
        '[aircraft]\nname = "single"\nxml = "single.xml"\n[host]\n'
        f'"/controls/flight/elevator-trim" = {source}\n'
    )
    fdm = open_aircraft(find_aircraft(folder))
    fdm["fcs/flap-cmd-norm"] = 1.0
    engine.run_ic(fdm)
    trim = fdm["/controls/flight/elevator-trim"]
    assert trim == pytest.approx(0.75 if "flap" in source else 0.25)


def test_two_engines_have_one_throttle_and_lines_keep_their_numbers(tmp_path):
    folder = foreign_aircraft.write("twin", tmp_path)
    aircraft = find_aircraft(folder)
    assert aircraft.card.inputs["throttle"].property == host.THROTTLE
    assert aircraft.card.inputs["elevator"].property == "/controls/flight/elevator"
    assert {row.name for row in host_properties(aircraft)} >= {
        "/controls/engines/engine/throttle",
        "/controls/engines/engine[1]/throttle",
        host.THROTTLE,
    }
    fdm = open_aircraft(aircraft)
    fdm[host.THROTTLE], fdm["/controls/flight/elevator"] = 0.5, -0.5
    engine.run_ic(fdm)
    for _ in range(3):
        fdm.run()
    for name, value in (
        ("fcs/throttle-cmd-norm", 0.475),
        ("fcs/throttle-cmd-norm[1]", 0.475),
        ("fcs/elevator-cmd-norm", -0.4),
    ):
        assert fdm[name] == pytest.approx(value)
    author, hosted = (folder / "twin.xml").read_text(), staged(aircraft).xml.read_text()
    assert author.count("\n") == hosted.count("\n")
    assert "flightgear-host" in hosted
    assert "flightgear-host" not in author


def test_the_author_s_initial_values_are_taken_where_nothing_else_is_known(tmp_path):
    folder = foreign_aircraft.write("glider", tmp_path)
    (folder / "glider-set.xml").write_text(
        "<PropertyList><options><ballast>7.5</ballast><on>true</on></options>"
        "<controls><gear><brake-parking>1</brake-parking></gear></controls>"
        '<fdm><jsbsim><fcs><gust n="1">3</gust></fcs></jsbsim></fdm></PropertyList>'
    )
    names = ["/options/ballast", "/options/on", "/controls/gear/brake-parking", "fcs/gust[1]"]
    aircraft = with_readings(folder, [*names, "/velocities/mach"])
    result = {row.name: row.source for row in host_properties(aircraft)}
    assert [result[name] for name in names] == ["7.5", "1", "0", "3"]
    assert result["/velocities/mach"] == "velocities/mach"


def flightgear_folder(parent, models=("single",)):
    """Return an aircraft in FlightGear's layout: models in Aero, a -set.xml for each, includes."""
    folder = parent / "repository" / "Aircraft" / "Plane"
    foreign_aircraft.write("single", parent)
    folder.parent.mkdir(parents=True)
    (parent / "single").rename(folder)
    (folder / "Aero").mkdir()
    text = (folder / "single.xml").read_text()
    (folder / "single.xml").unlink()
    for name in models:
        (folder / "Aero" / f"{name}.xml").write_text(text)
        (folder / f"{name}-set.xml").write_text(
            f'<PropertyList include="Aircraft/Plane/base.xml"><sim><aero>Aero/{name}</aero></sim>'
            f"<options><variant>{len(name)}</variant></options></PropertyList>"
        )
    (folder / "yasim-set.xml").write_text(
        "<PropertyList><sim><flight-model>yasim</flight-model><aero>y</aero></sim></PropertyList>"
    )
    (folder / "base.xml").write_text(
        "<PropertyList><sim><flight-model>jsb</flight-model><aero>none</aero></sim>"
        '<options include="options.xml"><variant>1</variant></options></PropertyList>'
    )
    (folder / "options.xml").write_text(
        '<PropertyList><ballast>7.5</ballast><same alias="/options/ballast"/></PropertyList>'
    )
    return folder


def test_flightgear_s_layout_is_an_aircraft(tmp_path):
    folder = flightgear_folder(tmp_path)
    names = ["/options/ballast", "/options/same", "/options/variant"]
    with_readings(folder / "Aero", names)
    # The repository has one aircraft; its model lies in a subfolder, beside Engines and Systems.
    for place in (folder, folder.parent, folder / "single-set.xml", folder / "Aero/single.xml"):
        aircraft = find_aircraft(place)
        assert (aircraft.folder, aircraft.name) == (folder, "single")
    sources = {row.name: row.source for row in host_properties(aircraft)}
    assert [sources[name] for name in names] == ["7.5", "7.5", "6"]
    assert engine_count(aircraft) == 1


def engine_count(aircraft):
    """Return the number of engines that JSBSim loads."""
    return open_aircraft(aircraft).get_propulsion().get_num_engines()


def test_variants_of_a_folder_are_told_apart(tmp_path):
    folder = flightgear_folder(tmp_path, ("single", "second"))
    with pytest.raises(BadInputError, match=r"Aero/second\.xml and Aero/single\.xml; give .*-set"):
        find_aircraft(folder)
    first, second = (find_aircraft(folder / f"{name}-set.xml") for name in ("single", "second"))
    assert (first.name, second.name) == ("single", "second")
    assert content_hash(first) != content_hash(second)
    copy = tmp_path / "copies" / second.copy_name
    shutil.copytree(folder, copy)
    assert find_aircraft(copy).name == "second"
    with pytest.raises(BadInputError, match=r"yasim-set\.xml: names no JSBSim model"):
        find_aircraft(folder / "yasim-set.xml")


@pytest.mark.parametrize(
    ("set_file", "level"),
    [
        ("", "60"),
        ("<tank><level-lbs>33</level-lbs></tank>", "33"),
        ("<tank><level-gal_us>10</level-gal_us></tank>", "60"),
    ],
)
def test_tanks_that_flightgear_fills_are_filled(tmp_path, set_file, level):
    folder = foreign_aircraft.write("single", tmp_path)
    xml = folder / "single.xml"
    text = re.sub(r"(<capacity[^>]*>)[^<]*(</capacity>)", r"\g<1>120\g<2>", xml.read_text())
    xml.write_text(text)
    assert fuel_levels(find_aircraft(folder)) == {}
    xml.write_text(re.sub(r"(<contents[^>]*>)[^<]*(</contents>)", r"\g<1>0\g<2>", text))
    (folder / "single-set.xml").write_text(
        f"<PropertyList><consumables><fuel>{set_file}</fuel></consumables></PropertyList>"
    )
    fdm = open_aircraft(find_aircraft(folder))
    assert fdm["propulsion/tank/contents-lbs"] == pytest.approx(float(level))


def test_an_edited_include_of_the_set_file_is_read_again(tmp_path):
    folder = foreign_aircraft.write("single", tmp_path)
    xml = folder / "single.xml"
    xml.write_text(re.sub(r"(<contents[^>]*>)[^<]*(</contents>)", r"\g<1>0\g<2>", xml.read_text()))
    (folder / "single-set.xml").write_text('<PropertyList include="fuel.xml"/>')
    for level in (33.0, 44.0):
        tank = (
            f"<consumables><fuel><tank><level-lbs>{level}</level-lbs></tank></fuel></consumables>"
        )
        (folder / "fuel.xml").write_text(f"<PropertyList>{tank}</PropertyList>")
        assert fuel_levels(find_aircraft(folder)) == {0: level}


def test_an_assumed_level_is_above_what_the_tank_keeps(tmp_path):
    folder = foreign_aircraft.write("single", tmp_path)
    xml = folder / "single.xml"
    retained = (
        '<unusable-volume unit="LTR">4</unusable-volume><density unit="LBS/GAL">6.5</density>'
    )
    text = re.sub(r"(<capacity[^>]*>)[^<]*", r"\g<1>10", xml.read_text())
    xml.write_text(
        re.sub(r"<contents[^>]*>[^<]*</contents>", f"<contents>5</contents>{retained}", text)
    )
    # 4 l keep 6.87 lb of 10 lb.
    assert fuel_levels(find_aircraft(folder))[0] == pytest.approx(8.434, abs=1e-3)
