"""``instrument``: copies that fly to the last bit like the original, deltas where they belong, a
way back, and what is refused.
"""

from __future__ import annotations

import json
import re
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.helpers.jsbsim_schema import schema_errors
from tests.helpers.model_forms import made_up_form
from tests.helpers.page_checks import problems, words_of
from tests.jsbsim_defects.small_models import SKELETON
from uqharness.cli.main import build_parser, main
from uqharness.cli.request_command import request_of
from uqharness.errors import BadInputError
from uqharness.plugin.apply import check, check_in_child, undo, write
from uqharness.plugin.instrument import Bounds, plan
from uqharness.requests.simulation import InstrumentRequest
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
    good = xml.read_bytes()
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
        assert good.count(old) == 1, old
        xml.write_bytes(good.replace(old, new))
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
    again = instrumented(out, tmp_path / "again" / "small", Bounds(constant={"CX": (-0.01, 0.01)}))
    assert tree(again) != tree(out)
    undo(again, again)
    assert tree(again) == before
    changed = out / "small.xml"
    changed.write_bytes(
        changed.read_bytes().replace(b"<value>90</value>", b"<value>90.125</value>")
    )
    done = dict(undo(out, out))
    assert "kept" in done["small.xml"]
    assert tree(out) == {
        "small.xml": before["small.xml"].replace(b"<value>90</value>", b"<value>90.125</value>")
    }


def test_in_place_and_back(small):
    before = tree(small)
    instrumented(small, small)
    assert set(tree(small)) == {
        "small.xml",
        "Systems/model-form.xml",
        "Systems/scale-bias.xml",
        "uq-instrument.json",
    }
    undo(small, small)
    assert tree(small) == before


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
    spoilt = tree(small)
    with pytest.raises(BadInputError, match=r"small\.xml: changed since.*uq/moment/PITCH.*by hand"):
        undo(small, small)
    assert tree(small) == spoilt
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


def test_a_strangers_folder_is_not_overwritten(small, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    with pytest.raises(BadInputError, match="is no instrumented aircraft"):
        write(find_aircraft(small), plan(find_aircraft(small), Bounds()), tmp_path / "mine")
    write(find_aircraft(small), plan(find_aircraft(small), Bounds()), tmp_path / "no" / "where")
    assert (tmp_path / "no" / "where" / "small.xml").is_file()


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


def test_engines_and_systems_beside_the_folder_go_along(small, tmp_path):
    root = small.parent.parent
    (root / "engine").mkdir()
    (root / "systems").mkdir()
    (root / "engine" / "puller.xml").write_text(
        '<electric_engine name="puller"><power unit="WATTS">500</power></electric_engine>'
    )
    (root / "engine" / "nozzle.xml").write_text('<direct name="Direct"></direct>')
    (root / "systems" / "aside.xml").write_text(
        '<system name="aside"><property value="1">own/aside</property></system>'
    )
    xml = small / "small.xml"
    parts = (
        '<propulsion><engine file="puller"><location'
        ' unit="M"><x>0</x><y>0</y><z>0</z></location><thruster file="nozzle"><location'
        ' unit="M"><x>0</x><y>0</y><z>0</z></location></thruster></engine></propulsion><system'
        ' file="aside"/>'
    )
    xml.write_bytes(
        xml.read_bytes().replace(b"<flight_control", parts.encode() + b"<flight_control")
    )
    out = tmp_path / "far" / "away" / "small"
    instrumented(small, out)
    assert {"Engines/puller.xml", "Engines/nozzle.xml", "Systems/aside.xml"} <= set(tree(out))
    verdict = check(find_aircraft(small), find_aircraft(out), 0.7)
    assert verdict.status == "works", verdict.reason


def test_constant_bounds_on_the_command_line():
    def constant(text):
        words = ["instrument", "c172p", "--out", "o", "--constant", text]
        return request_of(InstrumentRequest, build_parser().parse_args(words)).constant

    assert constant("CX=0.008, CZ=-0.05:0.08") == {"CX": (-0.008, 0.008), "CZ": (-0.05, 0.08)}
    for text in ("CX", "Cq=1", "CX=a", "CX=-0.1", "CX=0.1:0.2", "CX=1,CX=2", "CX=nan"):
        with pytest.raises(BadInputError, match="--constant"):
            constant(text)


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


def test_what_a_host_would_provide_is_written_into_the_copy(small, tmp_path, capsys):
    xml = small / "small.xml"
    xml.write_bytes(
        xml.read_bytes().replace(
            b"<property>own/used</property>", b"<property>host/gives</property>"
        )
    )
    out = tmp_path / "elsewhere"
    assert main(["instrument", str(small), "--out", str(out)]) == 0
    assert "host/gives" in capsys.readouterr().err
    assert find_aircraft(out).card.host == {"host/gives": 0.0}
    assert b'"0">host/gives<' in (out / "Systems" / "flightgear-host.xml").read_bytes()
    assert main(["instrument", str(out), "--out", str(out), "--undo"]) == 0
    assert tree(out) == tree(small)


def test_a_misspelt_property_is_no_property_of_a_host(small, tmp_path, capsys):
    xml = small / "small.xml"
    xml.write_bytes(
        xml.read_bytes().replace(
            b"<property>own/used</property>", b"<property>velocities/vc-knts</property>"
        )
    )
    assert main(["instrument", str(small), "--out", str(tmp_path / "elsewhere")]) == 2
    assert "did you mean velocities/vc-kts" in capsys.readouterr().err


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


def test_an_aircraft_that_ends_the_interpreter_is_a_verdict(small, tmp_path):
    broken = tmp_path / "aircraft" / "broken"
    shutil.copytree(small, broken)
    (broken / "small.xml").rename(broken / "broken.xml")
    xml = broken / "broken.xml"
    xml.write_bytes(
        xml.read_bytes()
        .replace(b"<sum>", b"<smu>")
        .replace(b"<product><property>own/used", b"<prodct><property>own/used")
    )
    verdict = check_in_child(broken, broken, 0.7)
    assert verdict.status == "fails"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["c172x", "F450", "Short_S23", "weather-balloon", "737", "ah1s"])
def test_stock_aircraft(tmp_path, name):
    aircraft = find_aircraft(engine.default_root() / "aircraft" / name)
    planned = plan(aircraft, Bounds())
    write(aircraft, planned, tmp_path / name)
    verdict = check_in_child(aircraft.folder, tmp_path / name)
    assert verdict.status == "works", verdict.reason
    assert verdict.worst < 1e-9
    assert planned.scaled


GLIDE = """<?xml version="1.0"?>
<initialize name="glide">
  <vt unit="KTS">50</vt> <altitude unit="FT">3000</altitude> <gamma unit="DEG">-2.5</gamma>
  <latitude unit="DEG" type="geodetic">45</latitude> <longitude unit="DEG">0</longitude> <psi unit="DEG">0</psi>
</initialize>
"""
STEPS = (
    (3, "elevator", 0.0),
    (4, "elevator", -0.2),
    (5, "elevator", -0.1),
    (9, "aileron", 0.1),
    (10, "aileron", 0.0),
    (13, "elevator", 0.0),
    (13.5, "elevator", -0.1),
)


@pytest.mark.slow
def test_a_glider_nobody_prepared_is_identified_by_its_scales(tmp_path, capsys):
    out = tmp_path / "sgs233"
    assert main(["instrument", "sgs233", "--out", str(out), "--no-check"]) == 0
    (out / "glide.xml").write_text(GLIDE)
    events = "".join(
        f'<event name="{k}"><condition>simulation/sim-time-sec gt {t - 0.005}</condition>'
        f'<set name="fcs/{name}-cmd-norm" value="{value}"/></event>'
        for k, (t, name, value) in enumerate(STEPS)
    )
    script = tmp_path / "glide.xml"
    script.write_text(
        '<?xml version="1.0"?><runscript name="glide"><use aircraft="sgs233"'
        ' initialize="glide"/><run start="0" end="16" dt="0.01"><property'
        f' value="-0.1">fcs/elevator-cmd-norm</property>{events}</run></runscript>'
    )
    truth = {"uq/scale/Cmalpha": 1.2, "uq/scale/Cmde": 0.9, "uq/scale/Cmq": 1.0}
    settings = [part for name, value in truth.items() for part in ("--set", f"{name}={value}")]
    flight = str(tmp_path / "flight.csv")
    assert main(["fly", str(out), "--script", str(script), *settings, "--out", flight]) == 0
    arguments = [
        "--params",
        ",".join(truth),
        "--biases",
        "none",
        "--workers",
        "1",
        "--no-figures",
        "--json",
    ]
    capsys.readouterr()
    main(["identify", str(out), "--flight", flight, "--out", str(tmp_path / "fit"), *arguments])
    found = json.loads(capsys.readouterr().out)["parameters"]
    assert {name: found[name]["value"] for name in truth} == pytest.approx(truth, rel=0.03)


@pytest.mark.slow
def test_a_stock_aeroplane_is_replayed_with_its_engine_running_and_its_linkage_as_it_is(tmp_path):
    """Elevator with hysteresis, bias, lag and two unequal ends of travel; a piston engine that
    wants mixture.
    """
    folder = tmp_path / "c172x"
    assert main(["instrument", "c172x", "--out", str(folder), "--no-check"]) == 0
    script = tmp_path / "doublet.xml"
    events = "".join(
        f"<event name='{t}'><condition>simulation/sim-time-sec ge {t}</condition>"
        f"<set name='fcs/elevator-cmd-norm' value='{v}'/></event>"
        for t, v in ((4.995, -0.15), (5.495, 0.15), (5.995, 0.0))
    )
    script.write_text(
        "<runscript name='doublet'><use aircraft='c172x' initialize='elevator_doublet_init'/><run"
        " start='0' end='20' dt='0.01'><property"
        " value='1'>fcs/mixture-cmd-norm</property><property"
        " value='0.65'>fcs/throttle-cmd-norm</property><event"
        " name='engine'><condition>simulation/sim-time-sec gt 0.005</condition><set"
        " name='propulsion/set-running' value='-1'/><set name='fcs/throttle-cmd-norm'"
        f" value='0.65'/></event>{events}</run></runscript>"
    )
    flight = tmp_path / "flight.parquet"
    assert (
        main(
            [
                "fly",
                str(folder),
                "--script",
                str(script),
                "--duration-s",
                "10",
                "--out",
                str(flight),
            ]
        )
        == 0
    )
    # Three seconds into the flight the propeller has come to its speed; the surfaces' positions are
    # left to the model.
    record = pd.read_parquet(flight)
    record[record.time_s >= 3.0].drop(columns=["elevator_pos_deg", "rudder_pos_deg"]).to_parquet(
        flight
    )
    main(
        [
            "compare",
            str(folder),
            "--flight",
            str(flight),
            "--out",
            str(tmp_path / "gap"),
            "--no-figures",
        ]
    )
    gaps = json.loads((tmp_path / "gap" / "compare.json").read_text())
    found = {
        name: gap["rms"]
        for kind in ("channels", "coefficients")
        for name, gap in gaps[kind].items()
    }
    # Without mixture CX was .08 off; with one factor for both ends of the elevator's travel Cm was
    # .03, and .34 before.
    limits = {
        "V_mps": 0.05,
        "q_radps": 1e-3,
        "az_mps2": 0.05,
        "Cm": 0.002,
        "CZ": 0.005,
        "CX": 0.005,
    }
    assert {name: found[name] for name, limit in limits.items() if not found[name] < limit} == {}


def test_a_page_is_written_when_asked_and_json_stays_as_it_is(tmp_path, capsys):
    words = [
        "instrument",
        "c172p",
        "--constant",
        "CX=0.01,Cm=-0.02:0.03",
        "--no-check",
        "--json",
        "--out",
        str(tmp_path / "made"),
    ]
    assert main(words) == 0
    plain = capsys.readouterr().out
    shutil.rmtree(tmp_path / "made")
    page = tmp_path / "bounds.html"
    assert main([*words, "--page", str(page)]) == 0
    assert capsys.readouterr().out == plain
    text = page.read_text(encoding="utf-8")
    assert problems(text) == []
    assert "Constant bounds of 2 coefficients." in words_of(text)


@pytest.mark.parametrize(
    "words",
    [["--page", "b.txt"], ["--page", "b.html", "--dry-run"], ["--page", "b.html", "--undo"]],
)
def test_a_page_that_cannot_be_is_refused(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["instrument", "c172p", "--out", "made", *words]) == 2
    assert "--page" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
