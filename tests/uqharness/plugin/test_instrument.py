"""The `instrument` command: unchanged flights, deltas, undo, and refusals."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.jsbsim_schema import schema_errors
from tests.helpers.model_forms import made_up_form
from tests.jsbsim_defects.small_models import SKELETON
from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.plugin.apply import check, undo, write
from uqharness.plugin.instrument import FILE_NAME, Bounds, plan, read_record
from uqharness.simulator import engine
from uqharness.simulator.aircraft import PROJECT_ROOT, content_hash, find_aircraft, open_aircraft
from uqharness.simulator.facts import open_mid_envelope

OWN = """
  <property value="0.3">own/gain</property>
  <function name="own/used"><product><property>own/gain</property><property>aero/qbar-psf</property></product></function>
  <axis name="LIFT">
    <function name="aero/force/lift alpha">  <!-- lbf -->
      <product> <property>aero/qbar-psf</property> <value>90</value> <property>aero/alpha-rad</property> </product>
    </function>
    <function><product><property>own/used</property><value>9</value></product></function>
  </axis>
  <axis name="PITCH">
    <function name="aero/moment/alpha"><product><property>aero/qbar-psf</property><value>-20</value>
      <property>aero/alpha-rad</property></product></function>
    <function name="aero/moment/q"><product><property>aero/qbar-psf</property><value>-9</value>
      <property>velocities/q-rad_sec</property></product></function>
  </axis>
"""


def tree(folder: Path) -> dict[str, bytes]:
    return {
        p.relative_to(folder).as_posix(): p.read_bytes()
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


@pytest.fixture
def small(tmp_path) -> Path:
    folder = tmp_path / "aircraft" / "small"
    folder.mkdir(parents=True)
    gain = (
        "<pure_gain"
        " name='own/servo'><input>fcs/elevator-cmd-norm</input><gain>20</gain></pure_gain>"
    )
    fcs = f"<channel name='c'>{gain}</channel>"
    text = SKELETON.format(fcs=fcs, aero=OWN, ixz="", mass_attributes="", aerorp=0.2).replace(
        "\n", "\r\n"
    )
    (folder / "small.xml").write_bytes(
        text.replace("<fdm_config", "<!-- \xe4 --><fdm_config").encode("utf-8")
    )
    return folder


def instrumented(folder: Path, out: Path, bounds: Bounds | None = None) -> Path:
    out.parent.mkdir(parents=True, exist_ok=True)
    aircraft = find_aircraft(folder)
    write(aircraft, plan(aircraft, bounds or Bounds()), out)
    return out


def test_own_functions_units_and_unnamed_ones_fly_on_to_the_last_bit(small, tmp_path):
    out = instrumented(small, tmp_path / "out" / "small")
    verdict = check(find_aircraft(small), find_aircraft(out), 2.0)
    assert verdict.status == "works", verdict.reason
    assert verdict.worst < 1e-9
    assert verdict.properties > 300


def test_the_check_sees_a_plugin_that_is_wrong(small, tmp_path):
    out = instrumented(small, tmp_path / "out" / "small")
    xml = out / "small.xml"
    valid = xml.read_bytes()
    # A drag that the idle plugin adds; a moment a millionth too large; a force that acts at AERORP.
    faults = (
        (
            b'<property value="0.3">own/gain',
            b'<property value="0.3000001">own/gain',
            "with uq/active 0",
        ),
        (
            b"<property>uq/Cm/delta</property>",
            b"<property>uq/Cm/delta</property><value>1.000001</value>",
            "Cm",
        ),
        (
            b'<function name="uq/force/DRAG" apply_at_cg="true">',
            b'<function name="uq/force/DRAG">',
            "CX|CZ",
        ),
    )
    for old, new, words in faults:
        assert valid.count(old) == 1, old
        xml.write_bytes(valid.replace(old, new))
        verdict = check(find_aircraft(small), find_aircraft(out), 0.7)
        assert verdict.status == "wrong"
        assert any(word in verdict.reason for word in words.split("|")), verdict.reason


def test_scales_multiply_each_function_and_biases_add_a_coefficient(small, tmp_path):
    aircraft = find_aircraft(instrumented(small, tmp_path / "out" / "small"))

    def moments(**settings: float) -> dict[str, float]:
        fdm, step = open_mid_envelope(aircraft)
        for name, value in settings.items():
            engine.set_property(fdm, f"uq/{name.replace('__', '/')}", value)
        step(0)
        names = [
            "aero/moment/alpha",
            "aero/moment/q",
            "moments/m-aero-lbsft",
            "forces/fwz-aero-lbs",
            "aero/force/lift-alpha",
            "aero/qbar-psf",
            "metrics/Sw-sqft",
            "metrics/cbarw-ft",
        ]
        return {name: fdm[name] for name in names}

    plain, m = moments(), "moments/m-aero-lbsft"
    for short, name in (("scale__alpha", "aero/moment/alpha"), ("scale__q", "aero/moment/q")):
        assert moments(**{short: 1.5})[m] - plain[m] == pytest.approx(0.5 * plain[name], rel=1e-9)
    qSc = plain["aero/qbar-psf"] * plain["metrics/Sw-sqft"] * plain["metrics/cbarw-ft"]
    assert moments(bias__q=0.01)[m] - plain[m] == pytest.approx(0.01 * qSc, rel=1e-9)
    lifted = moments(**{"scale__lift-alpha": 2.0})
    assert lifted["forces/fwz-aero-lbs"] - plain["forces/fwz-aero-lbs"] == pytest.approx(
        plain["aero/force/lift-alpha"], rel=1e-9
    )


def test_undo_restores_the_bytes_and_keeps_what_an_author_changed_since(small, tmp_path):
    before = tree(small)
    out = instrumented(small, tmp_path / "out" / "small")
    assert (
        b'\r\n    <function name="uq/force/LIFT" apply_at_cg="true">\r\n'
        in (out / "small.xml").read_bytes()
    )
    repeat = instrumented(out, tmp_path / "again" / "small", Bounds(constant={"CX": (-0.01, 0.01)}))
    assert tree(repeat) != tree(out)
    undo(repeat, repeat)
    assert tree(repeat) == before
    changed = out / "small.xml"
    changed.write_bytes(
        changed.read_bytes().replace(b"<value>90</value>", b"<value>90.125</value>")
    )
    done = dict(undo(out, out))
    assert "kept" in done["small.xml"]
    assert tree(out) == {
        "small.xml": before["small.xml"].replace(b"<value>90</value>", b"<value>90.125</value>")
    }


def test_a_link_to_another_aircrafts_file_is_not_written_through(small):
    shared = small.parent / "other" / "shared.xml"
    shared.parent.mkdir()
    shutil.copyfile(PROJECT_ROOT / "aircraft" / "espaaro" / "Systems" / "model-form.xml", shared)
    before = shared.read_bytes()
    instrumented(small, small)
    system = small / "Systems" / "model-form.xml"
    system.unlink()
    system.symlink_to(shared)
    instrumented(small, small, Bounds(constant={"CX": (-0.5, 0.5)}))
    assert b"-0.5" in system.read_bytes()
    assert shared.read_bytes() == before


def test_undo_refuses_what_it_cannot_take_out_cleanly(small):
    instrumented(small, small)
    xml = small / "small.xml"
    xml.write_bytes(
        xml.read_bytes().replace(
            b"<property>uq/Cm/delta</property>", b"<property>uq/Cm/delta</property> "
        )
    )
    damaged = tree(small)
    with pytest.raises(BadInputError, match=r"small\.xml: changed since.*uq/moment/PITCH.*by hand"):
        undo(small, small)
    assert tree(small) == damaged
    with pytest.raises(BadInputError, match="nothing here was instrumented"):
        undo(PROJECT_ROOT / "aircraft" / "espaaro", small.parent / "elsewhere")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('<axis name="PITCH">', '<axis name="X">', r"small\.xml:\d+: force axes are mixed"),
        (">2</wingarea>", ">0</wingarea>", r"small\.xml:\d+: <wingarea> is 0"),
        ("own/gain", "uq/gain", r"small\.xml:\d+: 'uq/gain' is a name of the plugin"),
        (
            "<ground_reactions/>",
            "<ground_reactions file='../gear'/>",
            r"small\.xml:\d+: <ground_reactions.*lies outside",
        ),
        (
            "<property>aero/alpha-rad</property>",
            "<property>uq/CX/delta</property>",
            r"reads? .*uq/CX/delta but not uq/CY/delta",
        ),
        (
            "<aerodynamics>",
            "<aerodynamics file='none'>",
            r"small\.xml:\d+: file=\"none\": there is no",
        ),
    ],
)
def test_refusals_name_file_and_line_and_write_nothing(small, tmp_path, old, new, message):
    xml = small / "small.xml"
    xml.write_bytes(xml.read_bytes().replace(old.encode(), new.encode()))
    with pytest.raises(BadInputError, match=message):
        instrumented(small, tmp_path / "out" / "small")
    assert not (tmp_path / "out" / "small").exists()


def test_an_aircraft_with_coefficient_properties_and_plugin_gets_new_bounds_only(tmp_path):
    source = PROJECT_ROOT / "aircraft" / "espaaro"
    aircraft = find_aircraft(source)
    planned = plan(aircraft, Bounds(made_up_form()))
    assert planned.had_plugin
    assert set(planned.files) == {"Systems/model-form.xml"}
    assert not planned.scaled
    assert "other files" in planned.notes[0]
    write(aircraft, planned, tmp_path / "out")
    fdm = open_aircraft(find_aircraft(tmp_path / "out"))
    fdm["ic/u-fps"], fdm["ic/h-sl-ft"] = 72.0, 1000.0
    engine.run_ic(fdm)
    assert fdm["uq/CX/upper"] > 0.0
    undo(tmp_path / "out", tmp_path / "out")
    assert tree(tmp_path / "out") == tree(source)
    assert content_hash(find_aircraft(tmp_path / "out")) == content_hash(aircraft)


def test_the_command_writes_card_table_and_record(small, tmp_path, capsys):
    out = tmp_path / "out"
    arguments = ["instrument", str(small), "--out", str(out), "--constant", "CX=0.01", "--json"]
    assert main([*arguments, "--dry-run"]) == 0
    assert not out.exists()
    capsys.readouterr()
    assert main(arguments) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["check"]["status"] == "works"
    assert [row["coefficient"] for row in report["coefficients"]] == [
        "CX",
        "CY",
        "CZ",
        "Cl",
        "Cm",
        "Cn",
    ]
    assert {row["file"]: row["change"] for row in report["files"]} == {
        "Systems/model-form.xml": "added",
        "Systems/path-errors.xml": "added",
        "Systems/scale-bias.xml": "added",
        "Systems/idle-throttle.xml": "added",
        "airframe.toml": "added",
        "small.xml": "edited",
    }
    card = tomllib.loads((out / "airframe.toml").read_text())
    assert card["reference"]["S_m2"] == pytest.approx(2.0, rel=1e-7)
    assert list(card["inputs"]) == ["elevator", "aileron", "rudder", "throttle"]
    assert re.search(r"\[inputs\.aileron\] +# moves nothing", (out / "airframe.toml").read_text())
    assert [error for path in (out / "Systems").iterdir() for error in schema_errors(path)] == []
    assert set(card["parameters"]) == {row["scale"] for row in report["scaled"]}
    aircraft = find_aircraft(out)
    fdm, step = open_mid_envelope(aircraft)
    for k in range(200):
        step(k)
    north, east = (fdm[f"position/from-start-neu-{axis}-ft"] for axis in "ne")
    course = np.arctan2(fdm["ic/ve-fps"], fdm["ic/vn-fps"])
    # The errors are read every tenth frame, and this is one.
    assert fdm["nav/cross-track-m"] == pytest.approx(
        0.3048 * (east * np.cos(course) - north * np.sin(course)), abs=0.05
    )
    assert fdm["nav/altitude-error-m"] == pytest.approx(
        0.3048 * (fdm["position/h-sl-ft"] - 5000.0), abs=0.05
    )
    assert main(["instrument", str(small), "--out", str(out), "--undo"]) == 0
    assert tree(out) == tree(small)


def test_bad_input_is_one_line_and_exit_code_two(small, tmp_path, capsys):
    (tmp_path / "bounds.json").write_text("{}")
    assert (
        main(
            [
                "instrument",
                str(small),
                "--out",
                str(tmp_path / "o"),
                "--bounds",
                str(tmp_path / "bounds.json"),
            ]
        )
        == 2
    )
    error = capsys.readouterr().err
    assert "bounds.json" in error
    assert "Traceback" not in error


# What an instrumentation did, written, read and taken back to the byte.


@pytest.mark.parametrize(
    ("document", "output"),
    [
        ({"format": "instrument 9", "files": {}}, "format is 'instrument 9'"),
        ([], "is no record"),
        ({"files": {}}, "is no record"),
        *(
            (
                {"format": "instrument 1", "files": {name: {"before": "", "after": ""}}},
                "no file that an instrumentation makes",
            )
            for name in ("../a.xml", "/a.xml", "C:a.xml", ".hidden", "a//b", "a\\b", FILE_NAME)
        ),
        (
            {
                "format": "instrument 1",
                "files": {"a": {"before": "", "after": "", "insertions": [[-1, "x", ""]]}},
            },
            "before its file",
        ),
        (
            {"format": "instrument 1", "files": {"a": {"before": 3, "after": ""}}},
            "a hash is no text",
        ),
    ],
    ids=str,
)
def test_a_strangers_record_is_refused(tmp_path, document, output):
    (tmp_path / FILE_NAME).write_text(json.dumps(document))
    with pytest.raises(BadInputError, match=output):
        read_record(tmp_path)
