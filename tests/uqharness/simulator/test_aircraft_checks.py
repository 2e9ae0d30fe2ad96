"""Checks of an aircraft: impossible sizes, the trial load, and errors in the XML."""

from __future__ import annotations

import logging
import re
import shutil
from pathlib import Path

import pytest

from tests.helpers import foreign_aircraft
from uqharness.child_process import ProcessResult
from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.malformed_xml import malformed_xml
from uqharness.simulator import aircraft_checks, engine, staging
from uqharness.simulator.aircraft import (
    _findings,
    find_aircraft,
    model_files,
    open_aircraft,
    with_rotor_inertia,
)
from uqharness.simulator.mission import StagedMission
from uqharness.simulator.trim import SteadyCondition, find_trim

XML = """<?xml version="1.0"?>
<fdm_config name="plane" version="2.0">
<metrics>
<wingarea unit="M2">{area}</wingarea>
<wingspan unit="M">{span}</wingspan>
<chord unit="M">{chord}</chord>
</metrics>
<mass_balance>
<ixx unit="KG*M2">{ixx}</ixx>
<iyy unit="KG*M2">{iyy}</iyy>
<izz unit="KG*M2">{izz}</izz>
<ixz unit="KG*M2">{ixz}</ixz>
<emptywt unit="KG">2</emptywt>
</mass_balance>
<ground_reactions/>
<aerodynamics/>
</fdm_config>
"""
SOUND = {
    "area": 0.4,
    "span": 1.8,
    "chord": 0.2,
    "ixx": 0.06,
    "iyy": 0.07,
    "izz": 0.12,
    "ixz": 0.0,
}


def plane(tmp_path, **changes):
    folder = tmp_path / "plane"
    folder.mkdir()
    (folder / "plane.xml").write_text(XML.format(**SOUND | changes), encoding="utf-8")
    return folder


@pytest.fixture(autouse=True)
def _say_again(monkeypatch):
    monkeypatch.setattr(aircraft_checks, "_noted", set())


@pytest.mark.parametrize(
    ("changes", "line", "words"),
    [
        ({"area": 0}, 4, "<wingarea> is 0"),
        ({"span": 0}, 5, "<wingspan> is 0"),
        ({"chord": -0.2}, 6, "<chord> is -0.2"),
        ({"ixx": 0}, 9, "<ixx> is 0"),
        ({"iyy": -0.07}, 10, "<iyy> is -0.07"),
        ({"izz": "nan"}, 11, "<izz> is nan"),
        ({"ixz": 0.2}, 9, "impossible inertia"),
    ],
)
def test_impossible_sizes_and_inertia_are_refused_with_file_and_line(
    tmp_path, changes, line, words
):
    folder = plane(tmp_path, **changes)
    with pytest.raises(BadInputError) as error:
        open_aircraft(find_aircraft(folder))
    assert f"{folder / 'plane.xml'}:{line}: " in str(error.value)
    assert words in str(error.value)


POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"


@pytest.mark.parametrize(
    "words",
    [
        ["modes", "{}", "--speed-mps", "15"],
        ["instrument", "{}", "--out", "out"],
        ["fly", "{}", "--mission", "steady", "--speed-mps", "15", "--out", "x.csv"],
    ],
)
def test_commands_name_a_git_lfs_pointer(tmp_path, monkeypatch, capsys, words):
    folder = plane(tmp_path)
    (folder / "plane.xml").write_text(POINTER, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert main([word.format(folder) for word in words]) == 2
    assert f"{folder / 'plane.xml'}:1: is a Git LFS pointer" in capsys.readouterr().err


def test_a_rotorcraft_is_named_and_not_trimmed(tmp_path, caplog):
    source = engine.default_root() / "aircraft" / "ah1s"
    folder = shutil.copytree(source, tmp_path / "ah1s")
    aircraft = find_aircraft(folder)
    with caplog.at_level(logging.WARNING, "uqharness"):
        open_aircraft(aircraft)
    assert "this is a rotorcraft" in caplog.text
    with pytest.raises(BadInputError, match=r"ah1s\.xml:\d+: .* rotorcraft"):
        find_trim(aircraft, SteadyCondition(30.0))
    assert aircraft_checks.rotor_place(find_aircraft("c172x")) == ""


# A model is loaded in a process of its own before it is loaded here, once for each content.


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(aircraft_checks, "_checked", {})
    return tmp_path / "uqharness" / "loadable"


PLANE = """<?xml version="1.0"?>
<fdm_config name="plane" version="2.0" release="ALPHA">
 <metrics>
  <wingarea unit="M2">0.4</wingarea><wingspan unit="M">1.8</wingspan><chord unit="M">0.22</chord>
  <location name="AERORP" unit="M"><x>0</x><y>0</y><z>0</z></location>
 </metrics>
 <mass_balance>
  <ixx unit="KG*M2">0.06</ixx><iyy unit="KG*M2">0.07</iyy><izz unit="KG*M2">0.12</izz>
  <emptywt unit="KG">2.0</emptywt>
  <location name="CG" unit="M"><x>0</x><y>0</y><z>0</z></location>
 </mass_balance>
 <ground_reactions/>
 {propulsion}
 {systems}
 <aerodynamics>
  <axis name="LIFT">{lift}</axis>
 </aerodynamics>
 {reactions}
</fdm_config>
"""
ENGINE = """<turbine_engine name="jet"><milthrust unit="N">10</milthrust>
 <function name="IdleThrust"><value>0.1</value></function>
 <function name="MilThrust">
  <product><property>velocities/misspelt</property><property>propulsion/engine[#]/n1</property></product>
 </function>
</turbine_engine>"""
MOUNT = """<propulsion><engine file="jet"><thruster file="pipe"/><feed>0</feed></engine>
 <tank type="FUEL"><location unit="M"><x>0</x><y>0</y><z>0</z></location>
  <capacity unit="KG">1</capacity><contents unit="KG">1</contents></tank></propulsion>"""
READS = "<property>velocities/misspelt</property>"
PLACES = {
    "aerodynamics": {"lift": f'<function name="f">{READS}</function>'},
    "branch never taken": {
        "lift": (
            "<function"
            f' name="f"><ifthen><lt><value>1</value><value>0</value></lt>{READS}<value>1</value></ifthen></function>'
        )
    },
    "table": {
        "lift": (
            '<function name="f"><table><independentVar>velocities/misspelt</independentVar>'
            "<tableData>0 1\n 1 2</tableData></table></function>"
        )
    },
    "external reactions": {
        "reactions": (
            f'<external_reactions><force name="hook" frame="BODY"><function>{READS}</function>'
            "<location"
            ' unit="M"><x>0</x><y>0</y><z>0</z></location><direction><x>1</x><y>0</y><z>0</z></direction>'
            "</force></external_reactions>"
        )
    },
    "system": {
        "systems": (
            '<system name="s"><channel name="c"><fcs_function'
            f' name="s/f"><function>{READS}</function></fcs_function></channel></system>'
        )
    },
    "engine": {"propulsion": MOUNT},
}


def plane_preflight(folder: Path, **parts: str) -> Path:
    (folder / "plane" / "Engines").mkdir(parents=True)
    texts = {"propulsion": "", "systems": "", "reactions": "", "lift": ""} | parts
    (folder / "plane" / "plane.xml").write_text(PLANE.format(**texts))
    (folder / "plane" / "Engines" / "jet.xml").write_text(ENGINE)
    (folder / "plane" / "Engines" / "pipe.xml").write_text('<direct name="pipe"/>')
    return folder / "plane"


@pytest.mark.parametrize("place", PLACES)
def test_a_property_that_nothing_defines_is_named_with_its_line(
    place: str, tmp_path: Path, cache: Path
):
    folder = plane_preflight(tmp_path, **PLACES[place])
    file = folder / ("Engines/jet.xml" if place == "engine" else "plane.xml")
    line = next(k for k, t in enumerate(file.read_text().splitlines(), 1) if "misspelt" in t)
    where = rf"{file.relative_to(folder)}:{line}\)"
    with pytest.raises(
        BadInputError,
        match=rf"reads a property that nothing defines: velocities/misspelt \({where}",
    ):
        open_aircraft(find_aircraft(folder))


def test_a_run_script_may_define_what_the_aircraft_reads(tmp_path: Path, cache: Path):
    folder = plane_preflight(tmp_path, **PLACES["aerodynamics"])
    (folder / "start.xml").write_text(
        '<initialize name="start"><ubody unit="M/SEC">15</ubody></initialize>'
    )
    script = tmp_path / "script.xml"
    text = """<runscript name="s"><use aircraft="plane" initialize="start"/>
     <run start="0" end="1" dt="0.01"><property value="1">{}</property></run></runscript>"""
    script.write_text(text.format("velocities/misspelt"))
    with StagedMission(find_aircraft(folder), script) as mission:
        fdm = mission.open()
        assert fdm.run_ic()
        assert abs(fdm["forces/fwz-aero-lbs"]) == 1.0
    script.write_text(text.format("velocities/other"))
    with pytest.raises(BadInputError, match="velocities/misspelt"):
        StagedMission(find_aircraft(folder), script)


# Errors of the author's XML: named with file, line and mend, all at once, and only if refused.

TABLE = (
    '<function name="aero/extra"><table>\n<independentVar lookup="row">aero/alpha-rad'
    "</independentVar>{}<tableData>\n{}\n</tableData></table></function>"
)
COLUMN = '<independentVar lookup="column">aero/beta-rad</independentVar>'
THIRD = '<independentVar lookup="table">velocities/mach</independentVar>'


def table(axes, data):
    return "<aerodynamics>", "<aerodynamics>" + TABLE.format(axes, data)


INPUT = "<input>fcs/elevator-cmd-norm</input>"


def component(tag, inside):
    return "</channel>", f"<{tag} name='t/x'>{inside}</{tag}></channel>"


CASES = {
    "number": (("<x>45</x>", "<x>-32.5.0</x>"), r"single\.xml:\d+: <x> is '-32\.5\.0', no number"),
    "comma": (("<max>0.35</max>", "<max>0,35</max>"), r"'0,35', no number; .* such as 0\.35"),
    "value": (("<value>4.8</value>", "<value>4.8.1</value>"), r"<value> is '4\.8\.1'"),
    "axes": (table(COLUMN, "0 1\n0.1 2\n0.2 3"), r'remove the axis with lookup="column"'),
    "third axis": (table(COLUMN + THIRD, "0 1\n0.1 2 3\n0.2 4 5"), "no breakPoint"),
    "row": (table("", "0 1\n0.1 2 7\n0.2 3"), r"has 3 numbers; 2 are needed"),
    "no axis": (
        (
            "<aerodynamics>",
            "<aerodynamics><function><t><tableData>\n 0 1\n0 1 2\n1 2\n2 1 2\n</tableData></t></function>",
        ),
        "has 2 numbers; 3 are needed",
    ),
    "joined": (table("", "0 1 0.1 2 0.2 3"), r"has 6 numbers; 2 are needed; begin a line after"),
    "order": (table("", "0 1\n0.3 2\n0.2 3"), r"the row of 0\.2 follows that of 0\.3"),
    "entry": (table("", "0 1\n0.3 2.0.1"), r"'2\.0\.1' in <tableData> is no number"),
    "double": (
        (
            "<aerodynamics>",
            "<aerodynamics>" + '<function name="a/b"><value>1</value></function>\n' * 2,
        ),
        r'<function name="a/b"> is there already \(line \d+\)',
    ),
    "system": (('file="switchboard"', 'file="swichboard"'), r"no such file; put swichboard\.xml"),
    "engine": (('file="flat_four"', 'file="flat_for"'), r"did you mean flat_four\?"),
    "unit": (('unit="FT2"', 'unit="FT^2"'), r'unit="FT\^2">: no unit of JSBSim; did you mean FT2'),
    "case": (('unit="FT2"', 'unit="ft2"'), r'unit="ft2">: no unit of JSBSim; did you mean FT2'),
    "length": (('unit="FT"', 'unit="CM"'), r'unit="CM">: no unit of JSBSim; write the length in M'),
    "two signs": (("<value>4.8</value>", "<value>--4.8</value>"), r"'--4.8', no number.* as -4.8"),
    "no rows": (table("", ""), "<tableData> is empty; write its rows"),
    "place": (('name="AERORP"', 'name="AEROREF"'), 'at 0, 0, 0; rename "AEROREF"'),
    "letter": (("<value>4.8</value>", "<value>4.B</value>"), r"<value> is '4\.B', no number"),
    "empty": (("<value>4.8</value>", "<value/>"), "<value> is empty"),
    "lookup": (table(COLUMN.replace("column", "col"), "0 1\n1 2 3"), 'lookup="col": allowed'),
    "no data": (table("", "X"), "'X' in <tableData> is no number"),
    "axis": (('<axis name="LIFT">', '<axis name="LIFTT">'), "did you mean LIFT"),
    "coefficient": (component("lag_filter", INPUT), "<lag_filter> has no <c1>"),
    "input": (component("lag_filter", "<c1>1</c1>"), "<lag_filter> has no <input>"),
    "component": (component("lagg_filter", INPUT), "did you mean <lag_filter>"),
    "weight": (("<emptywt.*?</emptywt>", ""), "has no <emptywt>, which JSBSim takes for 0; add"),
    "inertia": (
        ("(<ixx.*?</izz>)", r"<inertia>\1</inertia>"),
        r"<ixx> is inside <inertia>, where JSBSim ignores it; move it into <mass_balance>",
    ),
    "no engine": (('<engine file="flat_four">', "<engine>"), "<engine> names no file; write"),
    "thruster": (
        ("(<thruster.*?</thruster>)(.*?</engine>)", r"\2\1"),
        "<thruster> is outside of an <engine>; move it into its engine",
    ),
    "word": (
        ('<chord unit="FT">[^<]*', '<chord unit="FT">wide'),
        "<chord> is 'wide'; write a number",
    ),
    "part": (
        ("<aerodynamics>", '<aerodynamics file="Systems/switchboard.xml"/><aerodynamics>'),
        r"<aerodynamics file=.*>: this file is a <system>; write <system file=\.\.\.>",
    ),
    "feed": (("<feed>0</feed>", "<feed>4</feed>"), "<feed> is 4, of 1 tank, counted from 0"),
}


def broken(tmp_path, *changes):
    folder = foreign_aircraft.write("single", tmp_path)
    xml = folder / "single.xml"
    text = xml.read_text()
    for old, new in changes:
        text, number = re.subn(old, new, text, count=1, flags=re.DOTALL)
        assert number
    xml.write_text(text)
    return find_aircraft(folder)


@pytest.mark.parametrize("case", CASES)
def test_an_error_is_named_with_its_place_and_its_mend(tmp_path, case):
    change, message = CASES[case]
    texts = _findings(broken(tmp_path, change), refused=True)
    assert any(re.search(message, text) for text in texts), texts
    assert all(re.match(r"/.*\.xml:\d+: ", text) for text in texts)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "</function>",
            "",
            r"</axis> stands before the end of <function> \(line 4\); write </funct",
        ),
        ("</fdm>", "", r"the file ends before <fdm> \(line 1\) does; write </fdm>"),
        ("and", "&", "x.xml:2: .* unexpected character .*; write &amp; for &"),
        ("le 0", "<= 0", "x.xml:3: .*; write &lt; for <, or lt and le in a condition"),
        ('"LIFT"', "LIFT", "x.xml:4: .*; write the value of an attribute in quotes"),
    ],
)
def test_malformed_xml_is_told_with_its_mend(old, new, message):
    text = """<fdm>
<note>gear and flaps</note>
<test>gear le 0</test>
<axis name="LIFT"><function>
</function></axis>
</fdm>"""
    assert old in text
    error = malformed_xml(text.replace(old, new).encode(), "x.xml")
    assert re.search(message, str(error)), error


@pytest.mark.parametrize(
    ("head", "message"),
    [
        (b"", "x.xml:2: .* 0xFC is no UTF-8; save the file as UTF-8, or begin it with .*8859-1"),
        (b'<?xml version="1.0" encoding="UTF-88"?>', 'x.xml:1: .*UTF-88; write encoding="UTF-8"'),
    ],
)
def test_an_encoding_is_named_with_its_mend(head, message):
    error = malformed_xml(head + b"\n<author>M\xfcller</author>", "x.xml")
    assert re.search(message, str(error)), error


def test_operations_that_jsbsim_would_ignore_are_refused_together(tmp_path):
    name = '<aerodynamics><function name="a/b"><plus><value>1</value></plus></function>'
    more = '<function name="a/c"><times><value>1</value></times></function>'
    with pytest.raises(BadInputError, match=r"^2 errors .*<plus> is no op.*<times> is no op"):
        open_aircraft(broken(tmp_path, ("<aerodynamics>", name + more)))


@pytest.mark.parametrize("error", ["<value>4.8.1</value>", "<plus><value>4.8</value></plus>"])
def test_a_misspelt_property_is_named_with_the_other_errors(tmp_path, error):
    read = "<aerodynamics><function name='a/b'><property>velocities/vc-knts</property></function>"
    aircraft = broken(tmp_path, ("<value>4.8</value>", error), ("<aerodynamics>", read))
    with pytest.raises(BadInputError, match=r"^2 errors .*single\.xml:\d+.*velocities/vc-kts"):
        open_aircraft(aircraft)


def test_what_only_jsbsim_names_has_its_line(tmp_path):
    # A property whose name begins with a digit.
    part = '<channel name="t"><pure_gain name="t/0"><input>fcs/elevator-cmd-norm</input>'
    part += "<gain>1</gain></pure_gain></channel>"
    aircraft = broken(tmp_path, ("<flight_control[^>]*>", rf"\g<0>{part}"))
    with pytest.raises(BadInputError, match=r"single\.xml:\d+: .*correct the XML at the first"):
        open_aircraft(aircraft)


def test_what_jsbsim_takes_otherwise_than_the_author_is_remarked(tmp_path, caplog):
    double = '<property value="1">t/p</property><property value="{}">t/p</property>'
    gains = f'<pure_gain name="t/x">{INPUT}<gain>1</gain></pure_gain>' * 2
    aircraft = broken(
        tmp_path,
        ('type="BOGEY"', 'type="WHEEL"'),
        ("<flight_control[^>]*>", rf'\g<0>{double.format(2)}<channel name="t">{gains}</channel>'),
        ("<aerodynamics>", "<aerodynamics>" + double.format(1).replace("t/p", "t/q")),
        ("<sense>1", '<orient unit="DEG"><pitch>90</pitch></orient><sense>1'),
    )
    with caplog.at_level("INFO", logger="uqharness"):
        open_aircraft(aircraft)
    assert "single.xml:" in caplog.text
    assert '<contact type="WHEEL">: JSBSim takes it for STRUCTURE' in caplog.text
    assert re.search(r"t/p is declared as 2, in line \d+ as 1, which JSBSim keeps", caplog.text)
    assert re.search(r"computes t/x, as another component does \(single.xml:\d+\)", caplog.text)
    assert "<thruster> with a pitch of 90 lifts" in caplog.text
    # The same value twice changes nothing.
    assert "t/q" not in caplog.text


def test_stock_aircraft_that_jsbsim_loads_have_no_findings():
    # Negative control: the rules do not call ordinary files wrong.
    folder = engine.default_root() / "aircraft"
    verdict = {
        path.name: _findings(find_aircraft(path), refused=True)
        for path in sorted(folder.iterdir())
        if path.is_dir() and path.name != "blank"
    }
    assert len(verdict) > 50
    assert {name: texts for name, texts in verdict.items() if texts} == {}


def test_a_folder_named_otherwise_than_its_xml_has_only_one_or_a_card(tmp_path):
    folder = plane(tmp_path).rename(tmp_path / "download")
    (folder / "plane-set.xml").write_text("<PropertyList/>", encoding="utf-8")
    aircraft = find_aircraft(folder)
    assert aircraft.name == "plane"
    assert open_aircraft(aircraft)["metrics/Sw-sqft"] > 0.0
    shutil.copy(folder / "plane.xml", folder / "second.xml")
    with pytest.raises(BadInputError, match=r"but plane\.xml and second\.xml; give .*plane\.xml"):
        find_aircraft(folder)
    (folder / "airframe.toml").write_text(
        '[aircraft]\nname = "plane"\nxml = "plane.xml"\n', encoding="utf-8"
    )
    assert find_aircraft(folder).name == "plane"
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(BadInputError, match="not a JSBSim aircraft folder"):
        find_aircraft(empty)


@pytest.mark.parametrize(
    ("result", "words"),
    [
        (ProcessResult(None, {}, "", ""), "JSBSim did not finish loading it within 60 s"),
        (
            ProcessResult(-11, {}, "Unknown function", ""),
            r"ends JSBSim's process \(signal 11 \(SIGSEGV\)\); last output: Unknown function;",
        ),
        (ProcessResult(-6, {}, "", ""), "last output: no message;"),
        (ProcessResult(0, {"refused": "no <mass_balance>"}, "", ""), "espaaro: no <mass_balance>"),
    ],
)
def test_a_model_that_does_not_load_is_named_and_not_remembered(cache, monkeypatch, result, words):
    monkeypatch.setattr(aircraft_checks, "run_module", lambda *a, **k: result)
    with pytest.raises(BadInputError, match=words):
        aircraft_checks.ensure_loadable(find_aircraft("espaaro"), "content")
    assert not cache.exists()


def test_a_propeller_without_inertia_gets_that_of_its_diameter(tmp_path):
    folder = plane(tmp_path)
    main = folder / "plane.xml"
    main.write_text(
        main.read_text().replace(
            "<aerodynamics/>",
            '<propulsion><engine file="motor"><thruster file="screw"/></engine></propulsion>'
            "<aerodynamics/>",
        )
    )
    (folder / "Engines").mkdir()
    (folder / "Engines" / "motor.xml").write_text('<electric_engine name="m"/>')
    for text, mended in (("0.0004", False), ("0.00", True)):
        (folder / "Engines" / "screw.xml").write_text(
            f'<propeller name="s">\n<ixx> {text} </ixx>\n<diameter unit="IN"> 14 </diameter>\n'
            "</propeller>\n"
        )
        aircraft = find_aircraft(folder)
        content = model_files(aircraft).local["Engines/screw.xml"].content
        assert (b'<ixx unit="SLUG*FT2">' in content) is mended
    # A rod of 50 g, 14 in long, has 3.9e-4 slug ft2; blades taper.
    assert float(content.split(b"SLUG*FT2")[1].split()[1]) == pytest.approx(2.3e-4, rel=0.02)
    ((_, sentence),) = with_rotor_inertia(aircraft, staging.model_files(aircraft)).values()
    assert "screw.xml:2: <ixx> is 0" in sentence


@pytest.mark.parametrize(("pulls", "chord"), [(False, 0), (False, 0.2), (True, 0.2)])
def test_a_multirotor_is_named_whether_it_has_sizes_of_a_wing_or_not(tmp_path, pulls, chord):
    folder = plane(tmp_path, chord=chord)
    main = folder / "plane.xml"
    forces = "".join(
        f'<force name="m{k}" frame="BODY"><location unit="M"><x>{k}</x></location>'
        f"<direction><x>{x}</x><y>0</y><z>{z}</z></direction></force>\n"
        for k, (x, z) in enumerate([(0, -1)] * 4 + [(1, 0)] * pulls)
    )
    main.write_text(
        main.read_text().replace(
            "<aerodynamics/>", f"<external_reactions>\n{forces}</external_reactions><aerodynamics/>"
        )
    )
    if chord:
        # A wing with a propeller in front is none.
        assert (aircraft_checks.rotor_place(find_aircraft(folder)) == "") is pulls
        return
    with pytest.raises(BadInputError, match=r"plane.xml:17: 4 <force> lift .* a multirotor"):
        open_aircraft(find_aircraft(folder))


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("../../engines", ""),
        ("Propellers", r"put flat_four\.xml into .* Engines, from Propellers/flat_four\.xml"),
        (".", r"put flat_four\.xml into .* Engines, from flat_four\.xml"),
    ],
)
def test_an_engine_in_another_folder_is_found_or_its_place_is_named(tmp_path, place, message):
    folder = foreign_aircraft.write("single", tmp_path / "aircraft")
    (folder / place).mkdir(exist_ok=True)
    for file in (folder / "Engines").iterdir():
        file.rename(folder / place / file.name)
    if message:
        with pytest.raises(BadInputError, match=message):
            open_aircraft(find_aircraft(folder))
    else:
        assert open_aircraft(find_aircraft(folder)).get_propulsion().get_num_engines() == 1
