"""Manoeuvres without a script: sized by the linear model, flown by JSBSim, for aircraft of several
kinds.
"""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.simulator import (
    StartSection,
    copy_folder,
    find_aircraft,
    own_mission,
    write_own_mission,
)
from uqharness.simulator.forced_state import ControlEquilibrium
from uqharness.simulator.own_mission import EXCURSION_DEG


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


def test_steady_stays_and_3211_has_four_steps(tmp_path):
    folder = tmp_path / "aircraft" / "c172p"
    copy_folder(find_aircraft("c172p").folder, folder)
    aircraft = find_aircraft(folder)
    _, none = write_own_mission(aircraft, StartSection(V_mps=50, altitude_m=200), "steady")
    assert none == []
    _, steps = write_own_mission(aircraft, StartSection(V_mps=50, altitude_m=200), "3-2-1-1")
    assert [step.name for step in steps] == ["3-2-1-1", "roll doublet", "yaw doublet"]
    assert sum(units for units, _ in steps[0].pattern) == 7
    with pytest.raises(BadInputError, match="allowed are"):
        write_own_mission(aircraft, StartSection(V_mps=50, altitude_m=200), "loop")


def test_an_aircraft_whose_commands_are_rates_is_refused_in_words(tmp_path, monkeypatch):
    folder = tmp_path / "aircraft" / "x24b"
    copy_folder(find_aircraft("x24b").folder, folder)
    aircraft, start, trimmed = (
        find_aircraft(folder),
        StartSection(V_mps=196.1, altitude_m=3000),
        own_mission.write_steady_start,
    )
    assert write_own_mission(aircraft, start, "doublets")[1]
    monkeypatch.setattr(
        own_mission,
        "write_steady_start",
        lambda *asked: replace(trimmed(*asked), equilibrium=ControlEquilibrium((), free=True)),
    )
    with pytest.raises(BadInputError, match="answer a command with a body rate"):
        write_own_mission(aircraft, start, "doublets")
    assert write_own_mission(aircraft, start, "steady")[1] == []


@pytest.mark.slow
def test_noise_and_dataflash_for_an_aircraft_that_instrument_gave_a_card(tmp_path, capsys):
    mine = tmp_path / "mine"
    assert main(["instrument", "c172p", "--out", str(mine), "--no-check"]) == 0
    out = tmp_path / "flight.bin"
    words = [
        "fly",
        str(mine),
        "--mission",
        "doublets",
        "--speed-mps",
        "50",
        "--noise",
        "--seed",
        "3",
        "--out",
        str(out),
    ]
    assert main(words) == 0
    assert out.stat().st_size > 10_000
    quiet, noisy = tmp_path / "quiet.csv", tmp_path / "noisy.csv"
    assert main([*words[:6], "--out", str(quiet)]) == 0
    assert main([*words[:6], "--noise", "--seed", "3", "--out", str(noisy)]) == 0
    difference = pd.read_csv(noisy)["q_radps"] - pd.read_csv(quiet)["q_radps"]
    assert difference.std() == pytest.approx(0.003, rel=0.2)


def test_a_mission_without_a_speed_is_refused(tmp_path, capsys):
    assert main(["fly", "c172p", "--mission", "steady", "--out", str(tmp_path / "x.csv")]) == 2
    assert "--speed-mps" in capsys.readouterr().err
    assert main(["fly", "espaaro", "--speed-mps", "22", "--out", str(tmp_path / "x.csv")]) == 2
