"""Missions without a script: manoeuvres for any aircraft, steady flight, and `[start]`."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from pydantic import ValidationError

import uqharness as uq
from tests.helpers.page_checks import problems
from uqharness.campaign.cases import build_cases
from uqharness.campaign.conditions import OPTIONAL_METRICS
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import find_mission, run_campaign
from uqharness.campaign.tables import CASES
from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.flight.fly import fly
from uqharness.parquet_files import read_table
from uqharness.report.write import write_report
from uqharness.simulator.aircraft import PROJECT_ROOT
from uqharness.simulator.own_mission import EXCURSION_DEG, PLANS, StartSection, script


@pytest.mark.parametrize(
    ("name", "speed"),
    [
        ("c172p", 50),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (("SGS", 25), ("c310", 60), ("737", 140))
        ),
    ],
)
def test_any_aircraft_flies_doublets_of_a_few_degrees(name, speed, tmp_path, capsys):
    out = tmp_path / "flight.parquet"
    words = [
        "fly",
        name,
        "--mission",
        "doublets",
        "--speed-mps",
        str(speed),
        "--out",
        str(out),
        "--json",
    ]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["status"] == "ok"
    flight = pd.read_parquet(out)
    assert {"pitch doublet", "roll doublet", "yaw doublet"} <= set(flight["manoeuvre"])
    start = flight.iloc[0]
    angles = flight[["alpha_rad", "beta_rad"]] - start[["alpha_rad", "beta_rad"]].astype(float)
    greatest = np.rad2deg(angles.abs().max())
    assert (greatest < 4 * EXCURSION_DEG).all()
    # A control that moved nothing would leave the trim as it is.
    assert np.rad2deg((flight["phi_rad"] - start["phi_rad"]).abs().max()) > 1.0
    assert greatest["alpha_rad"] > 0.5
    before = flight[flight["time_s"] < 1.9]
    assert np.rad2deg(np.ptp(before["alpha_rad"])) < 0.05


# Run scripts of the identification flights.


@pytest.mark.parametrize("plan", PLANS, ids=lambda plan: plan.name)
def test_scripts_are_as_the_plans_say(plan):
    assert (PROJECT_ROOT / "scripts" / f"{plan.name}.xml").read_text(encoding="utf-8") == script(
        plan
    )


# Steady flight as a mission of an aircraft that has neither autopilot nor card: it begins in
# trim, and deviations are scored.

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
def flights(tmp_path_factory):
    folder = tmp_path_factory.mktemp("steady")
    spec = read_campaign(write(folder))
    run_campaign(spec, folder / "out", executor=SerialExecutor())
    return folder, spec


def test_a_stock_aircraft_goes_through_a_campaign_to_a_pbox(flights):
    folder, _ = flights
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
        "No path was commanded: errors are deviations from the state at the start of scoring."
        in report.verdict
    )
    assert any("heading" in path.name for path in report.figures)


@pytest.mark.parametrize("wind_mps", [0.0, 4.0])
def test_it_begins_in_trim_and_stays_there_in_still_air(flights, wind_mps):
    _, spec = flights
    calm = spec.aleatory.model_copy(
        update={"turbulence": ("none",), "wind_mps": (wind_mps,), "flights": 1}
    )
    mission = find_mission(spec, flights[0] / "out")
    (case,) = build_cases(replace(spec, aleatory=calm), mission)
    result = fly(replace(case.flight, duration_s=10.0))
    assert result.metrics["altitude_max_m"] < 0.2
    assert result.metrics["cross_track_max_m"] < 0.2
    assert result.metrics["speed_max_mps"] < 0.02
    assert result.metrics["heading_max_deg"] < 0.05
    assert result.metrics["load_factor_max"] == pytest.approx(1.0, abs=0.02)
    assert result.signals["V_mps"][1:] == pytest.approx(55.0, abs=0.05)
    assert np.rad2deg(result.signals["psi_rad"]) == pytest.approx(30.0, abs=0.05)


def test_the_mission_is_two_files_that_fly_without_the_harness(flights, tmp_path, capsys):
    folder, _ = flights
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
def test_campaign_of_a_steady_mission_refuses_bad_settings(tmp_path, old, new, message):
    assert CAMPAIGN.count(old) == 1
    with pytest.raises(BadInputError, match=message):
        run_campaign(
            read_campaign(write(tmp_path, CAMPAIGN.replace(old, new))), tmp_path / "out", workers=1
        )


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


# [start]: the trimmed flight of a mission without a script.


@pytest.mark.parametrize(
    "section",
    [
        {"V_mps": 0.0, "altitude_m": 100.0},
        {"V_mps": 22.0, "altitude_m": 0.0},
        {"V_mps": 22.0},
        {"V_mps": 22.0, "altitude_m": 100.0, "heading_deg": 361.0},
        {"V_mps": 22.0, "altitude_m": 100.0, "bank_deg": 0.0},
        {"V_mps": True, "altitude_m": 100.0},
    ],
    ids=str,
)
def test_start_section_refuses_bad_values(section):
    with pytest.raises(ValidationError):
        StartSection.model_validate(section)
