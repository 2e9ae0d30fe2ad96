"""Defects of JSBSim 1.3.3's turbulence and wind, shown without the project's air system.

Each test asserts that the defect is THERE, with its size. One that fails after an upgrade means
good news and work: the cure in aircraft/espaaro/Systems/air.xml has to go with the defect.
docs/air.md lists them under the same letters."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from campaigns.air.pinned import Condition, measure, open_pinned, write_vehicle
from campaigns.air.reproduce import compare
from sysid.units import FT_M
from uqharness.flight.dryden import dryden_sigma
from uqharness.simulator import engine

CALM = Condition(heading_deg=0.0, wind_mps=0.0, wind_from_deg=0.0)
W20_FPS = 50.0


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_vehicle(tmp_path, CALM.b_m, None)


def turbulent(
    folder: Path, settings: dict[str, float], condition: Condition = CALM, turb_type: float = 4.0
) -> Any:
    fdm = open_pinned(folder, condition, settings)
    fdm["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = W20_FPS
    fdm["atmosphere/turbulence/milspec/severity"] = settings.get(
        "atmosphere/turbulence/milspec/severity", 3.0
    )
    fdm["atmosphere/turb-type"] = turb_type
    return fdm


def record(fdm: Any, names: list[str], n: int) -> np.ndarray:
    rows = np.empty((n, len(names)))
    for k in range(n):
        fdm.run()
        rows[k] = [fdm[name] for name in names]
    return rows


@pytest.mark.parametrize(("severity", "sd_fps"), [(3.0, 7.0), (6.0, 18.6)])
def test_a_height_is_taken_above_sea_level(folder: Path, severity: float, sd_fps: float) -> None:
    # 330 ft above a field at 1790 ft. Specified: sd of w = 0.1 W20 = 5 ft/s whatever the
    # "severity".
    condition = replace(
        CALM, h_m=(1790.0 + 330.0) * FT_M, V_mps=100.0, dt_s=0.02
    )  # fast, for many scale lengths
    fdm = turbulent(
        folder,
        {"ic/terrain-elevation-ft": 1790.0, "atmosphere/turbulence/milspec/severity": severity},
        condition,
    )
    assert fdm["position/h-agl-ft"] == pytest.approx(330.0, abs=1.0)
    w = record(fdm, ["atmosphere/turb-down-fps"], 120_000)[6000:, 0]
    assert np.sqrt(np.mean(w**2)) == pytest.approx(sd_fps, rel=0.15)


def test_b_gust_axes_stay_on_the_wind() -> None:
    # Across the wind p and q trade places: sd of q is 1.8 times the specified one.
    observed = measure(
        "plain-tustin", replace(CALM, heading_deg=90.0, wind_mps=3.0, duration_s=600.0)
    )
    ratio = {row.component: row.sd_ratio for row in compare(observed)}
    assert ratio["p"] == pytest.approx(0.63, abs=0.06)
    assert ratio["q"] == pytest.approx(1.79, abs=0.12)


def test_c_wind_from_the_west_leaves_the_axes_north(folder: Path) -> None:
    fdm = turbulent(folder, {})
    fdm["atmosphere/wind-east-fps"] = 10.0
    for _ in range(5):
        fdm.run()
    assert fdm["atmosphere/psiw-rad"] == 0.0
    fdm["atmosphere/wind-north-fps"] = 1e-9
    fdm.run()
    assert fdm["atmosphere/psiw-rad"] == pytest.approx(np.pi / 2)


def test_d_rotation_to_north_and_east_has_the_wrong_sign(folder: Path) -> None:
    names = ["atmosphere/turb-north-fps", "atmosphere/turb-east-fps"]
    northward = turbulent(folder, {})
    eastward = turbulent(folder, {})
    northward["atmosphere/wind-north-fps"] = 1e-9
    eastward["atmosphere/wind-north-fps"], eastward["atmosphere/wind-east-fps"] = 1e-20, 1e-9
    axial, across = record(northward, names, 200)[5:].T  # x to the north: u, v
    north, east = record(eastward, names, 200)[5:].T  # x to the east: should be -v, u
    scale = np.abs(axial).max()
    np.testing.assert_allclose(north, across, atol=1e-5 * scale)
    np.testing.assert_allclose(east, -axial, atol=1e-5 * scale)


def test_e_pitch_gust_has_the_wrong_sign() -> None:
    # Flying with the wind (gust axes on the heading): q follows +dw/dt, where the air's rotation is
    # -dw/dx.
    tail_wind = replace(
        CALM, heading_deg=180.0, wind_from_deg=180.0, wind_mps=3.0, duration_s=300.0
    )
    observed = measure("plain-tustin", tail_wind)
    assert observed.q_slope_correlation() == pytest.approx(0.22, abs=0.06)
    assert observed.r_slope_correlation() == pytest.approx(0.24, abs=0.06)  # r is right


def test_f_tustin_filters_turn_to_nan_while_initialising(folder: Path) -> None:
    fdm = open_pinned(
        folder,
        CALM,
        {
            "atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps": W20_FPS,
            "atmosphere/turbulence/milspec/severity": 3.0,
            "atmosphere/turb-type": 4.0,
        },
    )
    for _ in range(10):
        assert fdm.run()  # and run() keeps saying that all is well
    assert np.isnan(fdm["atmosphere/turb-down-fps"])


def test_f_tustin_filters_turn_to_nan_when_initialised_again(folder: Path) -> None:
    fdm = turbulent(folder, {})
    record(fdm, ["atmosphere/turb-down-fps"], 50)
    engine.run_ic(fdm)
    fdm.run()
    assert np.isnan(fdm["atmosphere/turb-down-fps"])


def test_g_roll_gust_is_not_that_of_8785c() -> None:
    # Yeager's form: 15 % too strong at 100 m, with twice the density at low and two thirds of it at
    # high frequency.
    tail_wind = replace(
        CALM, heading_deg=180.0, wind_from_deg=180.0, wind_mps=3.0, duration_s=600.0
    )
    (row,) = (row for row in compare(measure("plain-tustin", tail_wind)) if row.component == "p")
    assert row.sd_ratio == pytest.approx(1.14, abs=0.04)
    assert row.band_ratios[0] == pytest.approx(2.0, abs=0.4)
    assert row.band_ratios[-1] == pytest.approx(0.82, abs=0.06)


def test_h_default_milspec_filters_are_a_third_too_strong_where_aircraft_answer() -> None:
    tail_wind = replace(
        CALM, heading_deg=180.0, wind_from_deg=180.0, wind_mps=3.0, duration_s=600.0
    )
    rows = {row.component: row for row in compare(measure("plain-milspec", tail_wind))}
    for component in ("v", "w", "q", "r"):
        assert rows[component].band_ratios[3] == pytest.approx(1.36, abs=0.1), component


def test_i_second_order_filters_drift_when_the_airspeed_answers_to_the_gust(folder: Path) -> None:
    # An aircraft that accelerates with the side gust (here by 0.3 1/s of it, as a banked one does)
    # makes each white-noise sample meet one gain on its way in and another on its way out: v gets a
    # mean, though it is symmetric and V hardly moves.
    mean = {}
    for coupling in (0.3, -0.3):
        fdm = turbulent(folder, {}, replace(CALM, dt_s=0.02))
        v_gust, speed = (
            engine.handle(fdm, name).get_double_value
            for name in ("atmosphere/turb-east-fps", "velocities/v-north-fps")
        )
        command = engine.handle(fdm, "pin/north-fps").set_double_value
        initial, total, n = speed(), 0.0, 25_000
        for _ in range(n):
            fdm.run()
            # The pin's force is 5 (command - speed): acceleration = coupling v - (V - V0)/2 s
            command(speed() + (coupling * v_gust() - 0.5 * (speed() - initial)) / 5.0)
            total += v_gust()
        mean[coupling] = total / n
    assert mean[0.3] - mean[-0.3] < -1.0  # ft/s, of a sigma of 6.9; the same noise in both


def test_specified_sigma_used_above() -> None:
    assert dryden_sigma("w", 22.2, 100.0, W20_FPS * FT_M / 0.514444, 3.66) / FT_M == pytest.approx(
        5.0, rel=1e-4
    )
