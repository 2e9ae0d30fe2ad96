"""Slips seeded into exported files, one at a time: each is found and its cause named."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

import uqharness as uq
from uqharness.commands.exchange import diff_models

SPEED = 22.2


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("exported")
    for name in ("gazebo", "ardupilot-json"):
        uq.export("espaaro", name, out=out / name, speed_mps=SPEED, states=50)
    return out


def find(first: Path, second: Path) -> list[tuple[str, str]]:
    document = diff_models(first, second).document
    return [(f.where, f.cause) for f in document.findings]


DEGREES, CHORD_SPAN = 57.29577951308232, 0.53 / 3.66
OPPOSITE, UNITS = "the sign is opposite", "per radian and per degree are mixed"
BOTH, LENGTHS = "per surface and for both surfaces", "span and chord are mixed"

# Tag, factor, where the finding is, its cause.
GAZEBO = [
    ("Cema", -1.0, "Cm over angle of attack", OPPOSITE),
    ("Cema", 1 / DEGREES, "Cm over angle of attack", UNITS),
    ("Cema", DEGREES, "Cm over angle of attack", UNITS),
    ("CLa", -1.0, "CZ over angle of attack", OPPOSITE),
    ("CLa", 1 / DEGREES, "CZ over angle of attack", UNITS),
    ("Cenb", -1.0, "Cn over sideslip", OPPOSITE),
    ("Cenb", 1 / DEGREES, "Cn over sideslip", UNITS),
    ("Cellb", -1.0, "Cl over sideslip", OPPOSITE),
    ("CYb", -1.0, "CY over sideslip", OPPOSITE),
    ("Cellp", -1.0, "Cl over roll rate", OPPOSITE),
    ("Cellp", 2.0, "Cl over roll rate", "2V and by V"),
    ("Cemq", -1.0, "Cm over pitch rate", OPPOSITE),
    ("Cemq", CHORD_SPAN, "Cm over pitch rate", LENGTHS),
    ("Cemq", 0.5, "Cm over pitch rate", "2V and by V"),
    ("Cenr", -1.0, "Cn over yaw rate", OPPOSITE),
    ("Cenr", CHORD_SPAN**2, "Cn over yaw rate", LENGTHS),
    ("area", 1.2, "wing area", ""),
    ("mac", 3.66 / 0.53, "chord", "span [m]"),
    ("mass", 2.0, "mass", ""),
    ("ixz", -1.0, "Ixz", OPPOSITE),
]
# Joint, tag, factor, where, cause.
SURFACES = [
    ("elevator", "Cem_ctrl", -1.0, "Cm over elevator", OPPOSITE),
    ("elevator", "Cem_ctrl", DEGREES, "Cm over elevator", UNITS),
    ("elevator", "Cem_ctrl", 2.0, "Cm over elevator", BOTH),
    ("elevator", "direction", -1.0, "Cm over elevator", OPPOSITE),
    ("rudder", "Cen_ctrl", -1.0, "Cn over rudder", OPPOSITE),
    ("rudder", "direction", -1.0, "Cn over rudder", OPPOSITE),
    ("rudder", "Cen_ctrl", 0.5, "Cn over rudder", BOTH),
    ("left_aileron", "Cell_ctrl", 3.0, "Cl over aileron", BOTH),
    ("right_aileron", "direction", -1.0, "Cl over aileron", "sign of one surface"),
]
JSON = [
    ("c_m_a", -1.0, "Cm over angle of attack", OPPOSITE),
    ("c_m_a", 1 / DEGREES, "Cm over angle of attack", UNITS),
    ("c_m_deltae", -1.0, "Cm over elevator", OPPOSITE),
    ("c_m_deltae", 1 / DEGREES, "Cm over elevator", UNITS),
    ("c_m_q", CHORD_SPAN, "Cm over pitch rate", LENGTHS),
    ("c_l_deltaa", -1.0, "Cl over aileron", OPPOSITE),
    ("c_l_deltaa", 2.0, "Cl over aileron", BOTH),
    ("c_l_p", -1.0, "Cl over roll rate", OPPOSITE),
    ("c_l_b", -1.0, "Cl over sideslip", OPPOSITE),
    ("c_n_b", -1.0, "Cn over sideslip", OPPOSITE),
    ("c_n_b", DEGREES, "Cn over sideslip", UNITS),
    ("c_n_deltar", -1.0, "Cn over rudder", OPPOSITE),
    ("c_n_r", -1.0, "Cn over yaw rate", OPPOSITE),
    ("c_y_b", -1.0, "CY over sideslip", OPPOSITE),
    ("c_lift_a", -1.0, "CZ over angle of attack", OPPOSITE),
    ("s", 10.0, "wing area", ""),
    ("c", 3.66 / 0.53, "chord", "span [m]"),
]


def check(findings: list[tuple[str, str]], where: str, cause: str) -> None:
    causes = [c for w, c in findings if w.startswith(where)]
    assert causes, (where, findings)
    assert cause in causes[0], findings


@pytest.mark.parametrize(("tag", "factor", "where", "cause"), GAZEBO)
def test_a_slip_in_the_sdf(tag: str, factor: float, where: str, cause: str, folder: Path, tmp_path):
    sound = folder / "gazebo" / "model.sdf"
    text = sound.read_text()
    damaged = tmp_path / "spoilt.sdf"
    damaged.write_text(
        re.sub(f"<{tag}>(.*?)<", lambda m: f"<{tag}>{factor * float(m[1])!r}<", text, count=1)
    )
    check(find(sound, damaged), where, cause)


@pytest.mark.parametrize(("joint", "tag", "factor", "where", "cause"), SURFACES)
def test_a_slip_of_a_surface(joint, tag, factor, where, cause, folder: Path, tmp_path: Path):
    sound = folder / "gazebo" / "model.sdf"
    head, part, remainder = sound.read_text().partition(f"<name>{joint}_joint</name>")
    remainder = re.sub(
        f"<{tag}>(.*?)<", lambda m: f"<{tag}>{factor * float(m[1])!r}<", remainder, count=1
    )
    damaged = tmp_path / "spoilt.sdf"
    damaged.write_text(head + part + remainder)
    check(find(sound, damaged), where, cause)


@pytest.mark.parametrize(("key", "factor", "where", "cause"), JSON)
def test_a_slip_in_the_json(
    key: str, factor: float, where: str, cause: str, folder: Path, tmp_path
):
    sound = folder / "ardupilot-json" / "espaaro.json"
    keys = json.loads(sound.read_text())
    damaged = tmp_path / "spoilt.json"
    damaged.write_text(json.dumps(keys | {key: factor * keys[key]}))
    check(find(sound, damaged), where, cause)


@pytest.mark.parametrize("name", ["ardupilot-json/espaaro.json", "gazebo/model.sdf"])
def test_a_shifted_moment_centre_is_named_with_its_length(name: str, folder: Path, tmp_path: Path):
    sound = folder / name
    damaged = tmp_path / f"spoilt{sound.suffix}"
    # Forces act 0.08 m ahead of the CG: as moments about a point 0.08 m behind it.
    text = sound.read_text().replace("<cp>0 0 0<", "<cp>0.08 0 0<")
    if sound.suffix == ".json":
        text = json.dumps(json.loads(text) | {"CGOffset": [0.08, 0.0, 0.0]})
    damaged.write_text(text)
    (cause,) = [c for w, c in find(sound, damaged) if w == "Cm over angle of attack"]
    assert cause == "the moment centre is 0.08 m further aft in the second"


def test_what_the_program_takes_for_a_missing_key_is_compared(folder: Path, tmp_path: Path):
    sound = folder / "ardupilot-json" / "espaaro.json"
    keys = json.loads(sound.read_text())
    damaged = tmp_path / "spoilt.json"
    retained = {k: v for k, v in keys.items() if k not in ("CGOffset", "aero_moment_inertia")}
    damaged.write_text("# without two keys\n" + json.dumps(retained))
    where = {w for w, _ in find(sound, damaged)}
    assert {"Ixx [kg m2]", "Cm over angle of attack"} <= where


def test_sound_files_have_no_slip(folder: Path):
    """Also of two formats: ArduPilot's file leaves mass and travel open, SDF states both."""
    sdf, classic = (folder / "gazebo" / name for name in ("model.sdf", "model-classic.sdf"))
    keys = folder / "ardupilot-json" / "espaaro.json"
    for pair in ((sdf, classic), (sdf, keys), (keys, sdf)):
        assert find(*pair) == []
    assert uq.diff("espaaro", keys, speed_mps=SPEED).findings == []
    outcome = uq.diff("espaaro", sdf, speed_mps=SPEED)
    assert {f.where for f in outcome.findings} <= {"CX over angle of attack"}


def test_inertias_that_changed_places(folder: Path, tmp_path: Path):
    """Ixx over Iyy is 1.36 here, as slug ft2 over kg m2."""
    keys = json.loads((folder / "ardupilot-json" / "espaaro.json").read_text())
    x, y, z = keys["aero_moment_inertia"]
    damaged = tmp_path / "spoilt.json"
    damaged.write_text(json.dumps(keys | {"aero_moment_inertia": [y, x, z]}))
    causes = [c for _, c in find(folder / "ardupilot-json" / "espaaro.json", damaged)]
    assert causes == [f"that is the first model's I{axis} [kg m2]" for axis in ("yy", "xx")]


@pytest.mark.parametrize(
    ("name", "old", "new", "cause"),
    [
        # The forces act 5 cm right of and 10 cm above the centre of gravity.
        ("gazebo/model.sdf", "<cp>0 0 0<", "<cp>0 -0.05 0<", "centre is 0.05 m further left"),
        ("gazebo/model.sdf", "<cp>0 0 0<", "<cp>0 0 0.02<", "centre is 0.02 m further down"),
        ("gazebo/model.sdf", "<cp>0 0 0<", "<cp>0.1 0 0.1<", "0.1 m further aft and 0.1 m"),
        ("gazebo/model.sdf", "<forward>1 0 0", "<forward>-1 0 0", "axes are turned"),
        ("gazebo/model.sdf", "<upward>0 0 1", "<upward>0 0 -1", "axes are turned"),
        ("gazebo/model.sdf", "Cell|Cen", "", "rolling and yawing moment are exchanged"),
        ("ardupilot-json/espaaro.json", "c_l_|c_n_", "", "yawing moment are exchanged"),
        ("gazebo/model.sdf", "<mass>([^<]*)", "2.20462", "pounds and kilograms"),
        ("gazebo/model.sdf", "<mac>([^<]*)", "3.28084", "feet and metres"),
        ("ardupilot-json/espaaro.json", '"s": ([^,]*)', "10.7639", "square feet"),
    ],
)
def test_a_slip_of_many_terms_is_one_finding(name, old, new, cause, folder: Path, tmp_path: Path):
    sound = folder / name
    text = sound.read_text()
    if "|" in old:
        pair = old.split("|")
        swapped = {pair[0]: pair[1], pair[1]: pair[0]}
        text = re.sub(f'(?<=[</"])({old})(?!ift)', lambda m: swapped[m[1]], text)
    elif "(" in old:
        text = re.sub(
            old,
            lambda m: m[0].replace(m[1], repr(float(new) * float(m[1]))),
            text,
            count=1,
        )
    else:
        text = text.replace(old, new)
    damaged = tmp_path / f"spoilt{sound.suffix}"
    damaged.write_text(text)
    assert text != sound.read_text()
    causes = [c for _, c in find(sound, damaged)]
    assert any(cause in c for c in causes), causes
