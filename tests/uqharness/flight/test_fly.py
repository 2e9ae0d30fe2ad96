"""Flights: determinism, scores, ground contact, and inputs that are refused."""

from __future__ import annotations

import math
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sysid.units import FT_M
from tests.helpers.few import few
from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.flight.dryden import dryden_gusts
from uqharness.flight.fly import (
    GroundWatch,
    RecordedFlight,
    absolute_statistics,
    count_excursions,
    fly,
    lost_control,
    record_mission,
    score_from_start,
)
from uqharness.flight.spec import FlightResult, FlightSpec
from uqharness.simulator import engine, stage
from uqharness.simulator.aircraft import PROJECT_ROOT, STANDARD, Source, find_aircraft
from uqharness.simulator.mission import StagedMission, find_script

SPEC = FlightSpec(
    Path("espaaro"),
    Path("loiter"),
    duration_s=20.0,
    burn_in_s=5.0,
    wind_mps=3.0,
    turbulence="moderate",
    sensor_noise=True,
    seed_turbulence=5,
    seed_noise=6,
)
RECORD = {
    "time_s",
    "V_mps",
    "alpha_rad",
    "beta_rad",
    "phi_rad",
    "theta_rad",
    "psi_rad",
    "p_radps",
    "q_radps",
    "r_radps",
    "ax_mps2",
    "ay_mps2",
    "az_mps2",
    "h_m",
    "elevator_deg",
    "aileron_deg",
    "rudder_deg",
    "throttle_pct",
}


def command(out: Path, *extra: str) -> list[str]:
    base = shlex.split(
        "fly espaaro --duration-s 4 --wind-mps 3 --turbulence severe --noise --seed 7"
    )
    return [*base, *extra, "--out", str(out)]


@pytest.mark.parametrize("ending", few(["csv", "parquet"], 1))
@pytest.mark.parametrize("source", few(["spec", "jsbsim"], 1))
def test_the_same_seed_gives_the_same_bytes_in_a_fresh_process(tmp_path, ending, source):
    local, present, other = (tmp_path / f"{name}.{ending}" for name in ("here", "there", "other"))
    assert main(command(local, "--turbulence-source", source)) == 0
    subprocess.run(
        [
            sys.executable,
            "-m",
            "uqharness.cli.main",
            *command(present, "--turbulence-source", source),
        ],
        check=True,
        cwd=PROJECT_ROOT,
    )
    assert main([*command(other, "--turbulence-source", source), "--seed", "8"]) == 0
    assert local.read_bytes() == present.read_bytes()
    assert local.read_bytes() != other.read_bytes()


def test_record_is_a_flight_record(tmp_path):
    out = tmp_path / "flight.csv"
    assert (
        main(
            [
                *shlex.split(
                    "fly espaaro --script doublet-elevator --duration-s 5 --rate-hz 100 --out"
                ),
                str(out),
            ]
        )
        == 0
    )
    record = pd.read_csv(out)
    assert set(record.columns) >= RECORD
    assert record["time_s"].diff().dropna().to_numpy() == pytest.approx(0.01)
    assert record["h_m"][0] == 0.0
    # Steady before the doublet: one g, straight ahead, and rotation only after the command.
    calm = record[record["time_s"] < 0.5]
    assert calm["az_mps2"].to_numpy() == pytest.approx(-9.8, abs=0.05)
    assert np.hypot(record["ve_mps"], record["vn_mps"]).iloc[0] == pytest.approx(
        record["V_mps"].iloc[0], abs=0.05
    )
    moved = record["elevator_deg"].diff().abs() > 0.1
    first = int(np.argmax(moved.to_numpy()))
    assert record["elevator_pos_deg"].diff().abs().iloc[: first - 1].max() < 1e-6


def test_specific_force_follows_the_rates_of_change(tmp_path):
    # Independent of JSBSim's own accelerometer: d(velocity)/dt + rates x velocity - gravity, by
    # central differences.
    out = tmp_path / "flight.csv"
    arguments = [
        *shlex.split("fly espaaro --script doublet-elevator --duration-s 8 --rate-hz 100 --out"),
        str(out),
    ]
    assert main(arguments) == 0
    r = pd.read_csv(out)
    u = r.V_mps * np.cos(r.alpha_rad) * np.cos(r.beta_rad)
    w = r.V_mps * np.sin(r.alpha_rad) * np.cos(r.beta_rad)
    v = r.V_mps * np.sin(r.beta_rad)
    az = (
        np.gradient(w, 0.01)
        + r.p_radps * v
        - r.q_radps * u
        - 9.806 * np.cos(r.theta_rad) * np.cos(r.phi_rad)
    )
    ax = np.gradient(u, 0.01) + r.q_radps * w - r.r_radps * v + 9.806 * np.sin(r.theta_rad)
    inner = slice(20, -20)
    assert np.std(az[inner] - r.az_mps2[inner]) < 0.05 * np.std(r.az_mps2[inner])
    assert np.std(ax[inner] - r.ax_mps2[inner]) < 0.05 * np.std(r.ax_mps2[inner])
    assert np.corrcoef(az[inner], -r.az_mps2[inner])[0, 1] < 0


def test_scores_follow_the_recorded_signals():
    result = fly(SPEC)
    assert result.status == "ok"
    assert result.signals["cross_track"].size == 200
    for key, unit in (("cross_track", "m"), ("altitude", "m"), ("speed", "mps")):
        magnitude = np.abs(result.signals[key])
        assert result.metrics[f"{key}_median_{unit}"] == np.median(magnitude)
        assert result.metrics[f"{key}_max_{unit}"] == magnitude.max()
        # The noise-laden score is another number, and a worse one on average.
        assert result.metrics[f"{key}_mean_{unit}_measured"] != result.metrics[f"{key}_mean_{unit}"]
    assert result.metrics["excursions_15m"] == 0.0


def test_a_flight_to_nan_is_a_result():
    result = fly(replace(SPEC, properties={"aero/Cm_alpha": 40.0, "aero/Cm_q": 500.0}))
    assert result.status in {"diverged", "ground-contact"}
    assert result.metrics["loss_of_control"] == 1.0


@pytest.mark.parametrize(
    "extra",
    [
        ["--set", "aero/Cm_q"],
        ["--set", "aero/Cm_q=abc"],
        ["--set", "nosuch/thing=1"],
        ["--duration-s", "-1"],
        ["--rate-hz", "7"],
        ["--seed", "-2"],
        ["--wind-mps", "-3"],
        ["--script", "nosuch"],
    ],
)
def test_bad_arguments_are_one_line(tmp_path, capsys, extra):
    assert main(command(tmp_path / "x.csv", *extra)) == 2
    error = capsys.readouterr().err
    assert error.startswith("uqharness: error: ")
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_an_event_that_would_override_the_host_is_refused(tmp_path):
    script = tmp_path / "mission.xml"
    text = (PROJECT_ROOT / "scripts" / "loiter.xml").read_text()
    script.write_text(text.replace("</event>", '<set name="air/wind-mps" value="9"/></event>'))
    with pytest.raises(BadInputError, match=r"mission\.xml:\d+: an event sets air/wind-mps"):
        fly(replace(SPEC, script=script))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not well-formed"),
        ("<fdm_config/>", "begins with <runscript>"),
        ("<runscript><use aircraft='espaaro' initialize='cruise'/></runscript>", "needs <use"),
        (
            (
                "<runscript><use aircraft='a' initialize='cruise'/><run end='soon'"
                " dt='0.01'/></runscript>"
            ),
            "positive number",
        ),
        (
            (
                "<runscript><use aircraft='a' initialize='nowhere'/><run end='5'"
                " dt='0.01'/></runscript>"
            ),
            "could not load|refused",
        ),
    ],
)
def test_a_bad_script_is_refused(tmp_path, text, message):
    script = tmp_path / "bad.xml"
    script.write_text(text)
    with pytest.raises(BadInputError, match=message):
        fly(replace(SPEC, script=script))


def test_an_aircraft_without_air_meets_wind_and_gusts_through_jsbsim(tmp_path):
    folder = tmp_path / "aircraft" / "espaaro"
    shutil.copytree(PROJECT_ROOT / "aircraft" / "espaaro", folder)
    (folder / "Systems" / "air.xml").write_text(
        '<system name="air">'
        + "".join(f'<property value="0">air/{axis}-gust-rad_sec</property>' for axis in "pqr")
        + "</system>"
    )
    with pytest.raises(BadInputError, match='turbulence_source = "spec"'):
        fly(replace(SPEC, aircraft=folder, script=Path("trim"), turbulence_source="jsbsim"))
    signals = {
        name: STANDARD[name] for name in ("V_mps", "vn_mps", "ve_mps", "alpha_rad", "psi_rad")
    }
    signals |= {
        axis: Source(f"atmosphere/total-wind-{axis}-fps", FT_M)
        for axis in ("north", "east", "down")
    }
    calm = replace(
        SPEC, aircraft=folder, duration_s=3.0, burn_in_s=0.0, turbulence="none", wind_from_deg=240.0
    )
    with StagedMission(find_aircraft(folder), find_script("trim")) as mission:
        steady = record_mission(mission, calm, signals).signals
        gusty = record_mission(mission, replace(calm, turbulence="severe"), signals).signals
    # 3 m/s from 240 deg blow towards 60 deg; airspeed stays what the script asks for, the ground
    # sees the wind on top.
    assert steady["north"][1:] == pytest.approx(1.5)
    assert steady["east"][1:] == pytest.approx(3.0 * math.sqrt(0.75))
    assert steady["V_mps"][1:] == pytest.approx(22.2, abs=0.15)
    assert steady["ve_mps"] == pytest.approx(3.0 * math.sqrt(0.75), abs=0.1)
    # The gusts in the heading axes of the frame before are those of the spec model, sample by
    # sample.
    gusts = dryden_gusts(
        300, 0.01, V_mps=22.2, h_m=100.0, W20_kt=45.0, b_m=3.66, seed=SPEC.seed_turbulence
    )
    rows = np.arange(1, 31) * 10 - 1
    north, east = gusty["north"][1:] - 1.5, gusty["east"][1:] - 3.0 * math.sqrt(0.75)
    psi = gusty["psi_rad"][1:]
    assert north * np.cos(psi) + east * np.sin(psi) == pytest.approx(gusts.u_mps[rows], abs=0.1)
    assert east * np.cos(psi) - north * np.sin(psi) == pytest.approx(gusts.v_mps[rows], abs=0.1)
    assert gusty["down"][1:] == pytest.approx(gusts.w_mps[rows], abs=0.1)
    assert np.std(gusty["alpha_rad"]) > 5.0 * np.std(steady["alpha_rad"])


def test_excursions_by_hand():
    track = np.array([0.0, 16, 14, 16, 12.9, 15.1, -15.1, 0, -20, 0])
    # Beyond 15, back to 14 (not re-armed), beyond again (same), 12.9 re-arms, 15.1 counts, -15.1 is
    # the same one, -20 counts.
    assert count_excursions(track, 15.0, 2.0) == 3
    assert count_excursions(track, 15.0, 0.5) == 4
    assert count_excursions(np.full(5, 30.0), 15.0, 2.0) == 1
    assert count_excursions(np.zeros(5), 15.0, 2.0) == 0
    assert count_excursions(np.full(5, 14.0), 15.0, 2.0) == 0
    with pytest.raises(ValueError, match="rearm_m"):
        count_excursions(track, 15.0, 15.0)


def test_statistics_and_loss_of_control_by_hand():
    assert absolute_statistics(np.array([-3.0, 1.0, 2.0])) == (2.0, 2.0, 3.0)
    assert all(math.isnan(value) for value in absolute_statistics(np.zeros(0)))
    values = np.random.default_rng(1).standard_normal(1001)
    for n in (1, 2, 3, 1000, 1001):
        assert absolute_statistics(values[:n])[0] == np.median(np.abs(values[:n]))
    for odd in ([np.nan, 1.0, 2.0], [np.inf, np.inf, 1.0, 2.0]):
        medians = absolute_statistics(np.array(odd))[0], np.median(odd)
        np.testing.assert_equal(*medians)
    steady = np.zeros(3)
    assert not lost_control(steady, steady, steady)
    assert lost_control(np.array([0, 1.41, 0]), steady, steady)
    assert lost_control(steady, np.array([0, -0.45, 0]), steady)
    assert lost_control(steady, steady, np.array([0, 61.0, 0]))
    assert lost_control(steady, np.array([0, np.nan, 0]), steady)


# Scores of signals made by hand.

SCORING_SPEC = FlightSpec(Path("plane"), Path("mission.xml"), 3.0)


def test_deviations_by_hand():
    names = ["height_m", "V_mps", "psi_rad", "load_factor", "phi_rad", "alpha_rad"]
    rows = np.array(
        [
            [100.0, 50.0, 6.2, 1.0, 0.0, 0.0],
            [103.0, 49.0, 6.3 - 2 * np.pi, 1.5, 0.1, 0.0],
            [98.0, 52.0, 6.1, 0.7, 0.1, 0.0],
        ]
    )
    result = score_from_start(SCORING_SPEC, RecordedFlight(names, rows, "ok", "", 3.0))
    assert isinstance(result, FlightResult)
    assert [result.metrics[f"altitude_{kind}_m"] for kind in ("median", "mean", "max")] == [
        2.0,
        5.0 / 3.0,
        3.0,
    ]
    assert result.metrics["speed_max_mps"] == 2.0
    # The heading passes north, which is no jump of 360 deg.
    assert result.metrics["heading_max_deg"] == pytest.approx(np.rad2deg(0.1))
    assert result.metrics["load_factor_max"] == 1.5
    assert result.metrics["loss_of_control"] == 0.0
    # Nothing says that this flight is to go straight on.
    assert result.undefined["cross_track"] == "no path is commanded"
    assert "excursions_15m" not in result.metrics
    level = np.column_stack(
        [rows, [0.0, 10.0, 20.0], [0.0, 10.0, 52.0], [5.0, 0.0, 0.0], [5.0, 9.0, 9.0]]
    )
    onwards = score_from_start(
        SCORING_SPEC,
        RecordedFlight([*names, "north_m", "east_m", "vn_mps", "ve_mps"], level, "ok", "", 3.0),
    )
    # Began towards the north-east; 52 m east and 20 m north lies 32/sqrt(2) m to the right of that
    # line.
    assert onwards.metrics["cross_track_max_m"] == pytest.approx(32.0 / np.sqrt(2.0))
    assert (onwards.metrics["excursions_15m"], onwards.metrics["excursions_25m"]) == (1.0, 0.0)
    broken = score_from_start(
        SCORING_SPEC, RecordedFlight(names, rows, "crashed", "hit the ground", 3.0)
    )
    assert np.isnan(broken.metrics["altitude_max_m"])
    assert broken.undefined["altitude"] == "hit the ground"
    assert broken.metrics["loss_of_control"] == 1.0


# Contact with the ground: the first step in which a contact point touches, in flights that have
# been in the air.

_DT_S, _BLOCK = 0.01, 10
START = """<initialize name="low">
  <latitude unit="DEG"> 45 </latitude> <longitude unit="DEG"> 0 </longitude>
  <altitude unit="FT"> {altitude_ft} </altitude> <vt unit="FT/SEC"> {speed_fps} </vt>
</initialize>
"""
SCRIPT = (
    '<runscript><use aircraft="c172p" initialize="low"/><run start="0" end="60"'
    ' dt="0.01"/></runscript>'
)


@pytest.fixture(scope="module")
def staging(tmp_path_factory):
    return stage(find_aircraft("c172p"), tmp_path_factory.mktemp("staged"))


def opened(staging, height_ft, speed_fps=0.0):
    fdm = engine.open_fdm(staging, _DT_S)
    fdm["ic/h-agl-ft"], fdm["ic/u-fps"] = height_ft, speed_fps
    engine.run_ic(fdm)
    return fdm


def watched(fdm, blocks):
    watch = GroundWatch(fdm, find_aircraft("c172p"), _BLOCK * _DT_S)
    for _ in range(blocks):
        touched = watch.advance(lambda steps: [fdm.run() for _ in range(steps)], _BLOCK)
        if touched:
            return touched, round(fdm.get_sim_time() / _DT_S)
    return "", round(fdm.get_sim_time() / _DT_S)


def first_contact(fdm):
    units = {f"gear/unit[{n}]": name for n, name in enumerate(("NOSE", "LEFT_MAIN", "RIGHT_MAIN"))}
    units |= {
        f"contact/unit[{n + 3}]": name
        for n, name in enumerate(("NOSE_SKID", "TAIL_SKID", "LEFT_TIP", "RIGHT_TIP"))
    }
    while not (
        touching := [name for unit, name in units.items() if fdm[f"{unit}/compression-ft"] > 0.0]
    ):
        fdm.run()
    return f"contact point {touching[0]}", round(fdm.get_sim_time() / _DT_S)


@pytest.mark.parametrize(("height_ft", "speed_fps"), [(6.0, 100.0), (100.0, 100.0), (300.0, 0.0)])
def test_the_first_step_of_contact_is_found_whatever_the_block(staging, height_ft, speed_fps):
    expected = first_contact(opened(staging, height_ft, speed_fps))
    assert watched(opened(staging, height_ft, speed_fps), 200) == expected
    assert expected[1] % _BLOCK, (
        "a contact at the end of a block would be found without looking at each step"
    )


def low(tmp_path: Path, altitude_ft: float, speed_fps: float = 100.0) -> FlightSpec:
    folder = tmp_path / "c172p"
    shutil.copytree(find_aircraft("c172p").folder, folder)
    (folder / "low.xml").write_text(START.format(altitude_ft=altitude_ft, speed_fps=speed_fps))
    script = tmp_path / "low-script.xml"
    script.write_text(SCRIPT)
    return FlightSpec(folder, script, duration_s=20.0)


def test_a_flight_ends_with_the_name_of_what_touched_and_the_time(tmp_path):
    result = fly(low(tmp_path, 60.0))
    assert result.status == "ground-contact"
    assert result.reason == f"contact point NOSE touched the ground at {result.flown_s:.1f} s"
    assert 1.0 < result.flown_s < 5.0
    # Today's bounce would go on from here: without the watch the aircraft is in the air again.
    assert result.signals["height_m"].min() > 0.0
