"""The XML files of the project fit JSBSim's schema, and the grammar refuses what that schema
refuses.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from lxml import etree

from tests.helpers.jsbsim_schema import schema_errors
from tests.helpers.places import ROOT

FILES = sorted(
    path for folder in ("aircraft", "scripts") for path in (ROOT / folder).rglob("*.xml")
)

AIRCRAFT = """<?xml version="1.0"?>
<fdm_config name="test" version="2.0" release="ALPHA">
  <fileheader><author>nobody</author><filecreationdate>2024-01-31</filecreationdate></fileheader>
  <metrics>
    <wingarea unit="M2">1.5</wingarea>
    <wingspan unit="M">3</wingspan>
    <chord unit="M">.5</chord>
    <location name="AERORP" unit="M"><x>0</x><y>0</y><z>0</z></location>
  </metrics>
  <mass_balance negated_crossproduct_inertia="false">
    <ixx unit="KG*M2">1</ixx><iyy unit="KG*M2">1</iyy><izz unit="KG*M2">2e0</izz>
    <emptywt unit="KG">10</emptywt>
    <location name="CG" unit="M"><x>0</x><y>0</y><z>0</z></location>
  </mass_balance>
  <external_reactions>
    <property value="1">model/thrust-scale</property>
    <force name="pull" frame="BODY">
      <function><product><p>model/thrust-scale</p><v>2</v></product></function>
      <location unit="M"><x>0</x><y>0</y><z>0</z></location>
      <direction><x>1</x><y>0</y><z>0</z></direction>
    </force>
  </external_reactions>
  <system file="sensors"><property value="0">model/bias</property></system>
  <flight_control name="control"/>
  <aerodynamics>
    <property value="0.1">model/CL0</property>
    <function name="aero/qS"><product><p>aero/qbar-psf</p><p>metrics/Sw-sqft</p></product></function>
    <axis name="LIFT">
      <function name="aero/lift">
        <description>all of it</description>
        <product>
          <p>aero/qS</p>
          <table>
            <independentVar lookup="row">aero/alpha-rad</independentVar>
            <tableData> -0.1 -0.4 <!-- linear --> 0.1 0.6 </tableData>
          </table>
        </product>
      </function>
    </axis>
    <axis name="PITCH" frame="STABILITY">
      <function apply_at_cg="true"><v>0</v></function>
    </axis>
  </aerodynamics>
  <output name="out.csv" type="CSV" rate="10"><rates>ON</rates><property caption="q">aero/qbar-psf</property></output>
</fdm_config>
"""

SYSTEM = """<?xml version="1.0"?>
<system name="test">
  <description>one of each</description>
  <property value="0.02">test/noise-sd</property>
  <function name="test/noise"><random stddev="1" seed="7"/></function>
  <channel name="control" execrate="2">
    <pure_gain name="test/gain"><input>-test/in</input><gain>test/k</gain><output>test/a</output></pure_gain>
    <summer name="test/sum"><input>test/a</input><input>-test/b</input><bias>0.1</bias></summer>
    <lag_filter name="test/lag"><c1>5</c1><input>test/sum</input></lag_filter>
    <second_order_filter name="test/second">
      <input>test/sum</input><c1>0</c1><c2>0</c2><c3>9</c3><c4>1</c4><c5>3</c5><c6>9</c6>
    </second_order_filter>
    <pid name="test/pid"><input>test/e</input><kp>test/kp</kp><ki type="trap">0.1</ki><trigger>test/hold</trigger></pid>
    <switch name="test/switch">
      <default value="0"/>
      <test logic="AND" value="test/pid">test/on eq 1
        test/height gt 10</test>
    </switch>
    <actuator name="test/servo">
      <input>test/switch</input><lag>20</lag><rate_limit>test/rate</rate_limit>
      <clipto><min>-1</min><max>test/limit</max></clipto>
    </actuator>
    <sensor name="test/sensor">
      <input>test/servo</input><lag>10</lag><noise variation="ABSOLUTE" distribution="GAUSSIAN">0.1</noise>
      <quantization name="test/q"><bits>12</bits><min>-1</min><max>1</max></quantization><delay type="frames">2</delay>
    </sensor>
    <fcs_function name="test/function">
      <function><ifthen><lt><p>test/a</p><v>1</v></lt><abs><p>test/a</p></abs><pi/></ifthen></function>
      <output>test/out</output>
    </fcs_function>
  </channel>
</system>
"""

SCRIPT = """<?xml version="1.0"?>
<runscript name="test">
  <use aircraft="test" initialize="reset"/>
  <run start="0" end="10" dt="0.01">
    <property value="1" persistent="true">test/mark</property>
    <event name="step" continuous="true">
      <condition logic="OR">simulation/sim-time-sec ge 1
        test/mark eq 2</condition>
      <set name="test/in" value="1" action="FG_RAMP" tc="0.5"/>
      <set name="test/k"><function><v>2</v></function></set>
      <notify><property>test/in</property></notify>
      <delay>0.5</delay>
    </event>
  </run>
</runscript>
"""

INITIAL = """<?xml version="1.0"?>
<initialize name="test">
  <latitude type="geodetic" unit="DEG">47</latitude>
  <altitude unit="M">100</altitude>
  <ubody unit="M/SEC">20</ubody>
  <running>-1</running>
</initialize>
"""

DOCUMENTS = {"aircraft": AIRCRAFT, "system": SYSTEM, "script": SCRIPT, "initial": INITIAL}

CHORD = '<chord unit="M">.5</chord>'
PLACE = '<location unit="M"><x>0</x><y>0</y><z>0</z></location>'
DIRECTION = "<direction><x>1</x><y>0</y><z>0</z></direction>"
GAIN = "<gain>test/k</gain>"

# What it is, the document, the text to change, what it becomes.
REFUSED = [
    ("unknown root", "system", "system", "systems"),
    # the aircraft file and its sections
    ("version of two digits", "aircraft", 'version="2.0"', 'version="2.10"'),
    (
        "no metrics",
        "aircraft",
        AIRCRAFT[AIRCRAFT.index("<metrics>") : AIRCRAFT.index("<mass_balance")],
        "",
    ),
    ("metrics not all there", "aircraft", CHORD, ""),
    ("negative area", "aircraft", ">1.5<", ">-1.5<"),
    ("unknown reference point", "aircraft", "AERORP", "AERO"),
    ("property outside a section", "aircraft", "<system ", "<property>test/x</property><system "),
    ("place after the direction", "aircraft", PLACE + "\n      " + DIRECTION, DIRECTION + PLACE),
    ("persistent outside a script", "aircraft", 'value="1"', 'value="1" persistent="true"'),
    (
        "property within an axis",
        "aircraft",
        '<axis name="LIFT">',
        '<axis name="LIFT"><property>test/x</property>',
    ),
    (
        "apply_at_cg outside an axis",
        "aircraft",
        'name="aero/qS"',
        'name="aero/qS" apply_at_cg="true"',
    ),
    ("word in a table", "aircraft", "0.1 0.6", "0.1 six"),
    # systems
    ("note in a system", "system", "<property value", "<note>about it</note><property value"),
    (
        "component outside a channel",
        "system",
        "<channel",
        '<summer name="x"><input>a/b</input></summer><channel',
    ),
    ("unknown component", "system", "lag_filter", "low_pass"),
    ("gain without a gain", "system", GAIN, ""),
    ("dot in a property name", "system", "-test/in", "-test/in.a"),
    ("property for a filter coefficient", "system", "<c1>5</c1>", "<c1>test/c1</c1>"),
    (
        "two outputs of an actuator",
        "system",
        "<lag>20</lag>",
        "<output>test/x</output><output>test/y</output>",
    ),
    ("test without a value", "system", ' value="test/pid"', ""),
    ("misspelt attribute", "system", "logic=", "login="),
    ("bits not whole", "system", "<bits>12</bits>", "<bits>12.5</bits>"),
    # functions
    ("operation upstream left out", "system", "abs", "sign"),
    (
        "one operand too many",
        "system",
        "<abs><p>test/a</p></abs>",
        "<abs><p>test/a</p><v>1</v></abs>",
    ),
    ("word for a value", "system", "<v>1</v>", "<v>one</v>"),
    (
        "copy of a function",
        "system",
        '<function name="test/noise"',
        '<function name="test/noise" copyto="test/x"',
    ),
    # scripts and initial conditions
    ("run without an end", "script", ' end="10"', ""),
    ("unknown action", "script", "FG_RAMP", "FG_JUMP"),
    ("property after the events", "script", "</run>", "<property>test/x</property></run>"),
    ("unknown state", "initial", "ubody", "u-body"),
    ("unknown format", "initial", 'name="test"', 'version="3.0"'),
]


def errors_of(text: str, folder: Path) -> list[str]:
    path = folder / "case.xml"
    path.write_text(text)
    return schema_errors(path)


def test_there_are_files() -> None:
    # An empty list of files would pass the test below without a word.
    assert any(path.is_relative_to(ROOT / "aircraft") for path in FILES)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_file_fits(path: Path) -> None:
    errors = schema_errors(path)
    assert not errors, "\n".join(errors)


@pytest.mark.parametrize("name", DOCUMENTS)
def test_sound_document_is_accepted(name: str, tmp_path: Path) -> None:
    errors = errors_of(DOCUMENTS[name], tmp_path)
    assert not errors, "\n".join(errors)


@pytest.mark.parametrize(
    ("name", "old", "new"), [case[1:] for case in REFUSED], ids=[case[0] for case in REFUSED]
)
def test_faulty_document_is_refused(name: str, old: str, new: str, tmp_path: Path) -> None:
    assert old in DOCUMENTS[name]
    text = DOCUMENTS[name].replace(old, new)
    etree.fromstring(text.encode())  # the fault is not one of plain XML
    assert errors_of(text, tmp_path)


def test_broken_xml_is_reported(tmp_path: Path) -> None:
    (error,) = errors_of(SYSTEM.replace("</channel>", "</chanel>"), tmp_path)
    assert "case.xml:" in error


def test_error_names_file_and_line(tmp_path: Path) -> None:
    text = SYSTEM.replace("  <channel", "  <note/>\n  <channel")
    line = text[: text.index("<note/>")].count("\n") + 1
    assert f"{tmp_path / 'case.xml'}:{line}: Did not expect element note there" in errors_of(
        text, tmp_path
    )
