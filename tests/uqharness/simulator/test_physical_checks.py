"""What no aircraft has is named with file and line, by every command that loads the aircraft."""

from __future__ import annotations

import logging
import shutil

import pytest

from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.simulator import aircraft_checks, engine, staging
from uqharness.simulator.aircraft import (
    find_aircraft,
    model_files,
    open_aircraft,
    with_rotor_inertia,
)
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


def test_a_sound_aircraft_passes_without_a_word(tmp_path, caplog):
    aircraft_checks.check_physical(find_aircraft(plane(tmp_path)))
    assert caplog.records == []


def test_an_inertia_that_no_body_has_is_noted_once(tmp_path, caplog):
    aircraft = find_aircraft(plane(tmp_path, izz=0.26))
    with caplog.at_level(logging.WARNING, "uqharness"):
        aircraft_checks.check_physical(aircraft)
        aircraft_checks.check_physical(aircraft)
        copy = shutil.copytree(aircraft.folder, tmp_path / "copy" / aircraft.folder.name)
        aircraft_checks.check_physical(find_aircraft(copy))
    (record,) = caplog.records
    assert f"{aircraft.xml}:9: impossible inertia" in record.getMessage()
    assert "exceeds the sum of the others by 100 %" in record.getMessage()


def test_a_section_in_a_file_of_its_own_is_checked_there(tmp_path):
    folder = plane(tmp_path)
    text = (folder / "plane.xml").read_text(encoding="utf-8")
    start, end = text.index("<metrics>"), text.index("</metrics>") + len("</metrics>")
    section = text[start:end].replace("1.8", "0")
    (folder / "Metrics.xml").write_text(section, encoding="utf-8")
    (folder / "plane.xml").write_text(
        text[:start] + '<metrics file="Metrics.xml"/>' + text[end:], encoding="utf-8"
    )
    with pytest.raises(BadInputError, match=r"Metrics\.xml:3: <wingspan> is 0"):
        open_aircraft(find_aircraft(folder))


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


def test_a_pointer_in_place_of_an_engine_is_named(tmp_path):
    folder = plane(tmp_path)
    text = (folder / "plane.xml").read_text(encoding="utf-8")
    engine_xml = '<propulsion><engine file="motor"/></propulsion><aerodynamics/>'
    (folder / "plane.xml").write_text(text.replace("<aerodynamics/>", engine_xml), encoding="utf-8")
    (folder / "Engines").mkdir()
    (folder / "Engines" / "motor.xml").write_text(POINTER, encoding="utf-8")
    with pytest.raises(BadInputError, match=r"motor\.xml:1: is a Git LFS pointer"):
        open_aircraft(find_aircraft(folder))


def test_a_folder_named_otherwise_than_its_xml_has_only_one_or_a_card(tmp_path):
    folder = plane(tmp_path).rename(tmp_path / "download")
    (folder / "plane-set.xml").write_text("<PropertyList/>", encoding="utf-8")
    aircraft = find_aircraft(folder)
    assert aircraft.name == "plane"
    assert open_aircraft(aircraft)["metrics/Sw-sqft"] > 0.0
    shutil.copy(folder / "plane.xml", folder / "second.xml")
    with pytest.raises(BadInputError, match=r"but plane\.xml and second\.xml; put an airframe"):
        find_aircraft(folder)
    (folder / "airframe.toml").write_text(
        '[aircraft]\nname = "plane"\nxml = "plane.xml"\n', encoding="utf-8"
    )
    assert find_aircraft(folder).name == "plane"
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(BadInputError, match="not a JSBSim aircraft folder"):
        find_aircraft(empty)


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
