"""A model is loaded in a process of its own before it is loaded here, once for each content."""

from __future__ import annotations

from pathlib import Path

import pytest

from uqharness.child_process import ProcessResult, run_module
from uqharness.errors import BadInputError
from uqharness.simulator import aircraft_checks
from uqharness.simulator.aircraft import check_loadable, find_aircraft, open_aircraft
from uqharness.simulator.mission import StagedMission

AIRCRAFT = find_aircraft("espaaro")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(aircraft_checks, "_checked", {})
    return tmp_path / "uqharness" / "loadable"


def ends(monkeypatch: pytest.MonkeyPatch, ended: ProcessResult) -> list[tuple[object, ...]]:
    asked: list[tuple[object, ...]] = []

    def run_module(module: str, *arguments: object, timeout_s: float) -> ProcessResult:
        asked.append(arguments)
        assert module == "uqharness.simulator.aircraft_checks"
        return ended

    monkeypatch.setattr(aircraft_checks, "run_module", run_module)
    return asked


def test_a_model_that_loads_is_loaded_once_and_remembered(
    cache: Path, monkeypatch: pytest.MonkeyPatch
):
    asked = ends(monkeypatch, ProcessResult(0, {}, "", ""))
    aircraft_checks.ensure_loadable(AIRCRAFT, "content")
    aircraft_checks.ensure_loadable(AIRCRAFT, "content")
    monkeypatch.setattr(aircraft_checks, "_checked", {})  # another process
    aircraft_checks.ensure_loadable(AIRCRAFT, "content")
    assert len(asked) == 1
    assert [path.name.partition("-")[0] for path in cache.iterdir()] == ["content"]
    aircraft_checks.ensure_loadable(AIRCRAFT, "other")
    assert len(asked) == 2


@pytest.mark.parametrize(
    ("ended", "said"),
    [
        (ProcessResult(None, {}, "", ""), "JSBSim did not finish loading it within 20 s"),
        (
            ProcessResult(-11, {}, "Unknown function", ""),
            r"ends JSBSim's process \(signal 11 \(SIGSEGV\)\); its last words: Unknown function;",
        ),
        (ProcessResult(-6, {}, "", ""), "its last words: no message;"),
        (ProcessResult(0, {"refused": "no <mass_balance>"}, "", ""), "espaaro: no <mass_balance>"),
    ],
)
def test_one_that_does_not_is_named_and_not_remembered(
    cache: Path, monkeypatch: pytest.MonkeyPatch, ended: ProcessResult, said: str
):
    asked = ends(monkeypatch, ended)
    for _ in range(2):
        with pytest.raises(BadInputError, match=said):
            aircraft_checks.ensure_loadable(AIRCRAFT, "content")
    assert len(asked) == 2
    assert not cache.exists()


def test_the_child_loads_the_real_thing_and_refuses_what_is_none(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(aircraft_checks, "run_module", run_module)
    aircraft_checks.ensure_loadable(AIRCRAFT, "content")
    folder = tmp_path / "empty"
    folder.mkdir()
    (folder / "empty.xml").write_text("<fdm_config name='empty' version='2.0'/>")
    empty = aircraft_checks._AircraftPaths(
        folder, folder / "empty.xml", AIRCRAFT.engine_path, AIRCRAFT.systems_path
    )
    with pytest.raises(BadInputError, match="empty"):
        aircraft_checks.ensure_loadable(empty, "empty")


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


def plane(folder: Path, **parts: str) -> Path:
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
    folder = plane(tmp_path, **PLACES[place])
    file = folder / ("Engines/jet.xml" if place == "engine" else "plane.xml")
    line = next(k for k, t in enumerate(file.read_text().splitlines(), 1) if "misspelt" in t)
    where = rf"{file.relative_to(folder)}:{line}\)"
    with pytest.raises(
        BadInputError,
        match=rf"reads a property that nothing defines: velocities/misspelt \({where}",
    ):
        open_aircraft(find_aircraft(folder))


def test_all_of_them_are_named_at_once_and_the_verdict_is_remembered(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
):
    lift = "".join(
        f'<function name="f{k}"><property>{name}</property></function>\n'
        for k, name in enumerate(("aero/alpha-radd", "aero/two", "inertia/three"))
    )
    aircraft = find_aircraft(plane(tmp_path, lift=lift))
    message = (
        r"reads 3 properties that nothing defines: aero/alpha-radd \(plane.xml:16\), aero/two"
        r" \(plane.xml:17\), "
        r"inertia/three \(plane.xml:18\); did you mean aero/alpha-radd -> aero/alpha-rad\?"
    )
    with pytest.raises(BadInputError, match=message):
        check_loadable(aircraft)
    monkeypatch.setattr(aircraft_checks, "_checked", {})
    monkeypatch.setattr(aircraft_checks, "run_module", lambda *a, **k: pytest.fail("loaded again"))
    check_loadable(aircraft, defined=("aero/alpha-radd", "aero/two", "inertia/three"))


def test_a_run_script_may_define_what_the_aircraft_reads(tmp_path: Path, cache: Path):
    folder = plane(tmp_path, **PLACES["aerodynamics"])
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
