"""What a host provides: sources by name, the system in XML, commands, switches, and its limits."""

from __future__ import annotations

import math

import pytest

from tests.helpers import foreign_aircraft
from uqharness.errors import BadInputError
from uqharness.simulator import engine, facts, find_aircraft, host, open_aircraft, staged
from uqharness.simulator.aircraft import host_properties

STATES = (
    ("/velocities/airspeed-kt", "velocities/vc-kts", 1.0, 0.0),
    ("/velocities/groundspeed-kt", "velocities/vg-fps", 0.5924838, 0.0),
    ("/position/altitude-agl-ft", "position/h-agl-ft", 1.0, 0.0),
    ("/orientation/pitch-deg", "attitude/theta-rad", 180.0 / math.pi, 0.0),
    ("/orientation/heading-magnetic-deg", "attitude/psi-deg", 1.0, 0.0),
    ("/environment/temperature-degc", "atmosphere/T-R", 5.0 / 9.0, -273.15),
    ("/engines/engine[0]/thruster/rpm", "propulsion/engine/propeller-rpm", 1.0, 0.0),
    ("/engines/engine/running", "propulsion/engine/set-running", 1.0, 0.0),
    ("/consumables/fuel/tank[0]/level-lbs", "propulsion/tank/contents-lbs", 1.0, 0.0),
    ("/gear/gear[0]/rollspeed-ms", "gear/unit/wheel-speed-fps", 0.3048, 0.0),
    ("/sim/time/elapsed-sec", "simulation/sim-time-sec", 1.0, 0.0),
)


def reads(names, computed=(), declared=None):
    return host.Names(dict.fromkeys(names, "x.xml:1"), set(computed), dict(declared or {}))


def sources(names, **others):
    listed = reads(names, **others)
    rows = host.resolve(listed, dict.fromkeys(names, ""), lambda name: True)
    return {row.name: (row.source, row.kind) for row in rows}


def with_readings(folder, names):
    """Let a function of the aircraft read properties."""
    xml = next(folder.glob("*.xml"))
    read = "".join(f"<property>{name}</property>" for name in names)
    function = f'<function name="test/read"><sum>{read}<value>0</value></sum></function>'
    text = xml.read_text().replace("<aerodynamics>", f"<aerodynamics>{function}")
    xml.write_text(text)
    return find_aircraft(folder)


def test_every_source_is_an_expression_of_legal_names():
    for patterns in (host._STATES.values(), ((source,) for source, _ in host._CONTROLS.values())):
        for source in (source for row in patterns for source in row):
            for _, name in host.parse_source(source.replace("{n}", "[1]")).terms:
                assert engine.is_legal_name(name), source


@pytest.mark.parametrize("text", ["a b", "2 *", "fcs/x * 2", "", "1 + + 2"])
def test_other_texts_are_no_source(text):
    with pytest.raises(ValueError):
        host.parse_source(text)


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
    ],
)
def test_a_name_has_the_source_that_flightgear_would_write(name, source, kind):
    found = sources([host.canonical(name)])[host.canonical(name)]
    if kind is None:  # a bus without "volts" in its name is merely on
        assert found == ("1", "system")
    else:
        assert found == (source, kind)


def test_a_command_that_the_model_computes_from_a_control_is_no_copy():
    name = "/controls/flight/elevator"
    assert sources([name])[name] == ("fcs/elevator-cmd-norm", "control")
    computed = sources([name], computed=["fcs/elevator-cmd-norm"])
    assert computed[name] == ("0", "command")
    assert host.commands(reads([name], ["fcs/elevator-cmd-norm"])) == {"elevator": name}
    assert host.commands(reads([name])) == {}


def test_what_the_author_declares_with_a_value_stays_the_author_s():
    name = "/systems/electrical/battery-switch"
    assert host.resolve(reads([name], declared={name: 0.0}), {}, lambda _: True) == ()
    (row,) = host.resolve(reads([name], declared={name: None}), {}, lambda _: True)
    assert row.source == "1"
    # FlightGear overwrites a state whatever the model declares.
    speed = "/velocities/airspeed-kt"
    (row,) = host.resolve(reads([speed], declared={speed: 5.0}), {}, lambda _: True)
    assert row.source == "velocities/vc-kts"


def test_a_misspelt_name_of_jsbsim_is_told_from_a_name_of_the_host(tmp_path):
    folder = foreign_aircraft.write("glider", tmp_path)
    aircraft = with_readings(folder, ["velocities/vc-knts"])
    with pytest.raises(BadInputError, match=r"glider.xml:\d+.*did you mean velocities/vc-kts"):
        open_aircraft(aircraft)
    (folder / "airframe.toml").write_text(
        '[aircraft]\nname = "glider"\nxml = "glider.xml"\n[host]\n"velocities/vc-knts" = 2.5\n'
    )
    assert open_aircraft(find_aircraft(folder))["velocities/vc-knts"] == 2.5


def test_states_are_jsbsim_s_in_flightgear_s_units(tmp_path):
    folder = foreign_aircraft.write("single", tmp_path)
    aircraft = with_readings(folder, [name for name, *_ in STATES])
    fdm, step = facts.open_mid_envelope(aircraft)
    for k in range(5):
        step(k)
    before = {source: fdm[source] for _, source, *_ in STATES}
    step(5)
    for name, source, factor, offset in STATES:
        # JSBSim updates positions before systems, and speeds and engines after them.
        frames = [factor * value + offset for value in (before[source], fdm[source])]
        assert any(fdm[name] == pytest.approx(value, rel=1e-6) for value in frames), name


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


def test_a_wrong_entry_of_the_card_is_one_line(tmp_path):
    folder = foreign_aircraft.write("glider", tmp_path)
    (folder / "airframe.toml").write_text(
        '[aircraft]\nname = "glider"\nxml = "glider.xml"\n[host]\n"/a/b" = "fcs/x times 2"\n'
    )
    with pytest.raises(BadInputError, match="neither a number nor"):
        find_aircraft(folder)


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
    found = {row.name: row.source for row in host_properties(aircraft)}
    assert [found[name] for name in names] == ["7.5", "1", "0", "3"]
    assert found["/velocities/mach"] == "velocities/mach"


def test_a_system_that_a_control_needs_is_switched_on_by_its_effect(tmp_path):
    folder = foreign_aircraft.write("vtail", tmp_path)
    xml = folder / "vtail.xml"
    text = xml.read_text().replace('<property value="1">systems/esc/armed</property>', "")
    xml.write_text(text.replace("systems/esc/armed", "systems/esc/go"))
    author = find_aircraft(folder)
    (row,) = host_properties(author)
    assert (row.name, row.source) == ("systems/esc/go", "0")
    live = facts.with_live_controls(author)
    assert live.card.host == {"systems/esc/go": 1.0}
    # The switch is no throttle, although more of it is more thrust at an open throttle.
    assert live.card.inputs["throttle"].property == "fcs/throttle-cmd-norm"


def test_an_aircraft_whose_controls_answer_is_left_as_it_is(tmp_path):
    author = find_aircraft(foreign_aircraft.write("single", tmp_path))
    assert facts.with_live_controls(author) is author


@pytest.mark.parametrize(
    ("command", "unit", "limits"),
    [("uav/motor-command", "norm", (0.0, 1.0)), ("uav/motor-pct", "pct", (0.0, 100.0))],
)
def test_a_throttle_in_percent_has_its_range(tmp_path, command, unit, limits):
    folder = foreign_aircraft.write("wing", tmp_path)
    xml = folder / "wing.xml"
    text = xml.read_text().replace("uav/motor-command", command)
    if unit == "pct":
        text = text.replace(f"<input>{command}</input>", "<input>motor/share</input>").replace(
            '<channel name="Motor">',
            f'<channel name="Motor"><pure_gain name="motor/share"><input>{command}</input>'
            "<gain>0.01</gain></pure_gain>",
        )
    xml.write_text(text)
    throttle = facts.with_live_controls(find_aircraft(folder)).card.inputs["throttle"]
    assert (throttle.property, throttle.unit, throttle.limits) == (command, unit, limits)
