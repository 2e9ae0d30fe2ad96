"""Steady flight as a mission of an aircraft that has neither autopilot nor card: it begins in trim,
and deviations are scored.
"""

from __future__ import annotations

import json
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import tomlkit

import uqharness as uq
from tests.helpers.few import few
from tests.helpers.page_checks import problems
from uqharness.campaign.cases import build_cases
from uqharness.campaign.conditions import OPTIONAL_METRICS
from uqharness.campaign.engines import make_copy
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import find_mission, run_campaign
from uqharness.campaign.tables import CASES
from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.flight.fly import fly
from uqharness.parquet_files import read_table
from uqharness.report.write import write_report

pytestmark = pytest.mark.usefixtures("flights_here")

CAMPAIGN = """
[campaign]
aircraft = "c172p"
mission = "steady"
seed = 1

[start]
V_mps = 55
altitude_m = 200
heading_deg = 30

[aleatory]
flights = 2
duration_s = 4
burn_in_s = 0
wind_mps = [0, 4]
turbulence = "light"
sensor_noise = false

[epistemic]
method = "none"
"""


def write(folder, text=CAMPAIGN):
    path = folder / "campaign.toml"
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("steady")
    spec = read_campaign(write(folder))
    run_campaign(spec, folder / "out", executor=SerialExecutor())
    return folder, spec


def test_a_stock_aircraft_goes_through_a_campaign_to_a_pbox(flown):
    folder, _ = flown
    frame = read_table(folder / "out" / CASES).to_pandas()
    assert (frame["status"] == "ok").all()
    assert list(frame.columns[-4:]) == list(OPTIONAL_METRICS)
    assert frame[["altitude_max_m", "speed_max_mps", "heading_max_deg"]].gt(0.0).all().all()
    assert frame["load_factor_max"].between(1.0, 2.0).all()
    # The path is the straight line it began on.
    assert frame["cross_track_max_m"].gt(0.01).all()
    assert (frame["excursions_15m"] == 0).all()
    metrics = set(read_table(folder / "out" / "pbox.parquet").to_pandas()["metric"])
    assert {
        "heading_median_deg",
        "load_factor_max",
        "altitude_max_m",
        "cross_track_max_m",
    } <= metrics
    report = write_report(folder / "out")
    assert problems(report.path.read_text(encoding="utf-8")) == []
    assert (
        "No path was commanded: errors are deviations from the state in which scoring began."
        in report.verdict
    )
    assert any("heading" in path.name for path in report.figures)


@pytest.mark.parametrize("wind_mps", [0.0, 4.0])
def test_it_begins_in_trim_and_stays_there_in_still_air(flown, wind_mps):
    _, spec = flown
    calm = spec.aleatory.model_copy(
        update={"turbulence": ("none",), "wind_mps": (wind_mps,), "flights": 1}
    )
    mission = find_mission(spec, flown[0] / "out")
    (case,) = build_cases(replace(spec, aleatory=calm), mission)
    result = fly(replace(case.flight, duration_s=10.0))
    assert result.metrics["altitude_max_m"] < 0.2
    assert result.metrics["cross_track_max_m"] < 0.2
    assert result.metrics["speed_max_mps"] < 0.02
    assert result.metrics["heading_max_deg"] < 0.05
    assert result.metrics["load_factor_max"] == pytest.approx(1.0, abs=0.02)
    assert result.signals["V_mps"][1:] == pytest.approx(55.0, abs=0.05)
    assert np.rad2deg(result.signals["psi_rad"]) == pytest.approx(30.0, abs=0.05)


def test_the_mission_is_two_files_that_fly_without_the_harness(flown, tmp_path, capsys):
    folder, _ = flown
    out = folder / "out"
    command = [
        "fly",
        str(out / "aircraft" / "c172p"),
        "--script",
        str(out / "steady-mission.xml"),
        "--duration-s",
        "5",
    ]
    assert main([*command, "--out", str(tmp_path / "x.csv"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["status"] == "ok"
    record = pd.read_csv(tmp_path / "x.csv")
    assert record["V_mps"].to_numpy() == pytest.approx(55.0, abs=0.1)
    assert "no airframe.toml" not in (out / "steady-mission.xml").read_text()


def test_the_copy_is_made_once_and_mended_when_it_is_broken(flown):
    folder, spec = flown
    mission = find_mission(spec, folder / "out")
    before = (folder / "out" / "steady-mission.xml").stat().st_mtime_ns
    make_copy(spec, mission, folder / "out")
    assert (folder / "out" / "steady-mission.xml").stat().st_mtime_ns == before
    start = folder / "out" / "aircraft" / "c172p" / "steady-start.xml"
    text = start.read_text()
    start.write_text(text.replace("30", "31"))
    make_copy(spec, mission, folder / "out")
    assert start.read_text() == text


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"steady"', '"scripts/loiter.xml"', "belong together"),
        ("[start]\nV_mps = 55\naltitude_m = 200\nheading_deg = 30\n", "", "belong together"),
        (
            "V_mps = 55",
            "V_mps = -1",
            r"campaign.toml:8: \[start\] V_mps = -1: a number above 0",
        ),
        ("V_mps = 55", "V_kt = 55", r"campaign.toml:8: \[start\] V_kt: unknown key"),
        pytest.param(
            "V_mps = 55",
            "V_mps = 140",
            "no steady flight at 140 m/s.*uqharness modes c172p",
            marks=pytest.mark.slow,
        ),
        ("sensor_noise = false", "sensor_noise = true", "sensor_noise = false"),
        (
            "sensor_noise = false",
            'sensor_noise = false\nturbulence_source = "jsbsim"',
            'turbulence_source = "spec"',
        ),
        ('method = "none"', 'method = "corners"', "add the plugin first: uqharness instrument"),
    ],
)
def test_what_cannot_be_is_refused_in_words(tmp_path, old, new, message):
    assert CAMPAIGN.count(old) == 1
    with pytest.raises(BadInputError, match=message):
        run_campaign(
            read_campaign(write(tmp_path, CAMPAIGN.replace(old, new))), tmp_path / "out", workers=1
        )


def test_the_folder_of_another_start_is_refused(flown):
    folder, _ = flown
    faster = read_campaign(write(folder, CAMPAIGN.replace("V_mps = 55", "V_mps = 56")))
    with pytest.raises(BadInputError, match=r"\[start\] V_mps was 55.0, is 56.0"):
        run_campaign(faster, folder / "out", executor=SerialExecutor())
    assert Path(folder / "out" / CASES).is_file()


@pytest.mark.slow
def test_a_stock_cessna_by_the_documented_commands_alone(tmp_path, capsys):
    mine = tmp_path / "my-c172"
    assert (
        main(
            [
                "instrument",
                "c172p",
                "--out",
                str(mine),
                "--constant",
                "CX=0.01,Cm=0.01",
                "--no-check",
            ]
        )
        == 0
    )
    text = CAMPAIGN.replace('"c172p"', '"my-c172"').replace("flights = 2", "flights = 1")
    text = text.replace("wind_mps = [0, 4]", "wind_mps = 3").replace(
        'method = "none"', 'method = "corners"\ncoefficients = ["CX", "Cm"]'
    )
    campaign, out = write(tmp_path, text), tmp_path / "out"
    assert main(["campaign", "run", str(campaign), "--out", str(out), "--serial"]) == 0
    assert main(["campaign", "report", str(out)]) == 0
    frame = read_table(out / CASES).to_pandas().set_index("epistemic_id")
    assert list(frame.index) == ["0---0-", "0---1-", "1---0-", "1---1-"]
    # More drag (CX low) is slower; a nose-up delta climbs: each corner is another flight, in the
    # same air.
    assert frame["speed_max_mps"].nunique() == frame["altitude_max_m"].nunique() == 4
    assert frame["seed"].nunique() == 1
    pbox = read_table(out / "pbox.parquet").to_pandas()
    width = pbox[pbox["metric"] == "altitude_max_m"]
    assert (width["upper"] - width["lower"]).max() == 1.0
    case = frame["case_id"].iloc[3]
    assert main(["campaign", "rerun", str(out), "--case", case, "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["same_as_stored"] is True


HIGH = CAMPAIGN.replace("altitude_m = 200", "altitude_m = 305").replace(
    'turbulence = "light"', 'turbulence = ["none", "light"]'
)
ABOVE_MODEL = '[start] altitude_m = 305: [aleatory] turbulence = ["light"]'


def test_a_start_above_the_turbulence_model_names_its_key_before_anything_flies(tmp_path, capsys):
    path = write(tmp_path, HIGH)
    for command in (["check", str(path)], ["run", str(path), "--out", str(tmp_path / "out")]):
        assert main(["campaign", *command]) == 2
        error = capsys.readouterr().err
        assert f"{path}:9: {ABOVE_MODEL}" in error
        assert "304.8 m" in error
        assert 'turbulence = "none"' in error
    with pytest.raises(BadInputError) as refusal:
        uq.run_campaign(tomllib.loads(HIGH), tmp_path / "out")
    assert str(refusal.value).startswith(ABOVE_MODEL)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("altitude_m = 305", "altitude_m = 304.8"),
        ('["none", "light"]', '"none"'),
        ('["none", "light"]', '"light"\nturbulence_source = "jsbsim"'),
    ],
)
def test_a_start_within_the_turbulence_model_or_without_it_is_read(tmp_path, old, new):
    assert HIGH.count(old) == 1
    assert read_campaign(write(tmp_path, HIGH.replace(old, new))).start is not None


@pytest.mark.parametrize("engine", few(["jsbsim", "batch"], 1))
def test_a_script_that_starts_above_the_turbulence_model_names_its_key(flown, tmp_path, engine):
    folder, _ = flown
    aircraft = tmp_path / "c172p"
    shutil.copytree(folder / "out" / "aircraft" / "c172p", aircraft)
    start = aircraft / "steady-start.xml"
    text = start.read_text()
    assert text.count('<altitudeMSL unit="M"> 200 ') == 1
    start.write_text(text.replace('unit="M"> 200 ', 'unit="M"> 600 '))
    shutil.copy(folder / "out" / "steady-mission.xml", tmp_path / "high.xml")
    sections = tomllib.loads(HIGH)
    del sections["start"]
    sections["campaign"] |= {"aircraft": "c172p", "mission": "high.xml", "engine": engine}
    path = write(tmp_path, tomlkit.dumps(sections))
    line = path.read_text().splitlines().index('turbulence = ["none", "light"]') + 1
    with pytest.raises(BadInputError) as refusal:
        run_campaign(read_campaign(path), tmp_path / "out", workers=1)
    assert str(refusal.value).startswith(
        f'{path}:{line}: [aleatory] turbulence = "light": the flight begins 600 m above the ground'
    )
