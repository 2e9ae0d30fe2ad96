"""The air system (aircraft/espaaro/Systems/air.xml) as the aerodynamics meet it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from campaigns.air.pinned import (
    AIR_XML,
    Condition,
    Gusts,
    Source,
    measure,
    open_pinned,
    write_vehicle,
)
from campaigns.air.reproduce import compare, main
from sysid.units import FT_M
from uqharness.flight.dryden import COMPONENTS, dryden_sigma
from uqharness.simulator import engine
from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.staging import staged

SHORT = Condition(heading_deg=0.0, duration_s=900.0)
Open = Callable[..., Any]


@pytest.fixture
def pinned(tmp_path: Path) -> Open:
    """Opens the pinned vehicle in the air system, with settings (property: value) made before
    initialising.
    """
    folder = write_vehicle(tmp_path, SHORT.b_m, AIR_XML)

    def opened(settings: dict[str, float] | None = None, condition: Condition = SHORT) -> Any:
        return open_pinned(folder, condition, settings or {})

    return opened


def steps(fdm: Any, n: int) -> None:
    for _ in range(n):
        fdm.run()


def total_wind_mps(fdm: Any) -> np.ndarray:
    return (
        np.array([fdm[f"atmosphere/total-wind-{axis}-fps"] for axis in ("north", "east", "down")])
        * FT_M
    )


def rotation(fdm: Any) -> np.ndarray:
    return np.array([fdm[f"air/{axis}-gust-rad_sec"] for axis in "pqr"])


def isa(height_m: float) -> tuple[float, float, float]:
    """Temperature K, pressure Pa, density kg/m3 of the standard atmosphere (1976), troposphere."""
    geopotential = 6356766.0 * height_m / (6356766.0 + height_m)
    temperature = 288.15 - 0.0065 * geopotential
    pressure = 101325.0 * (temperature / 288.15) ** (9.80665 * 28.9644e-3 / (8.31432 * 0.0065))
    return temperature, pressure, pressure / (287.053 * temperature)


# Both sources as specified. Tolerance: 3 % of amplitude (6 % of density) and, on top, 99.99 % of
# counting statistics.


@pytest.mark.parametrize(
    "heading_deg",
    [90.0, *(pytest.param(heading, marks=pytest.mark.slow) for heading in (0.0, 180.0, 270.0))],
)
@pytest.mark.parametrize("source", ["jsbsim", "host"])
def test_six_components_are_as_specified_at_every_heading(
    source: Source, heading_deg: float
) -> None:
    seen = measure(source, replace(SHORT, heading_deg=heading_deg, seed=100 + int(heading_deg)))
    assert [row for row in compare(seen) if not row.within(0.03)] == []
    assert seen.q_slope_correlation() < -0.12
    assert seen.r_slope_correlation() > 0.12


@pytest.mark.parametrize("source", ["jsbsim", "host"])
def test_as_specified_in_a_climbing_turn_attitude(source: Source) -> None:
    seen = measure(source, replace(SHORT, heading_deg=45.0, phi_deg=35.0, theta_deg=12.0, seed=7))
    assert [row for row in compare(seen) if not row.within(0.03)] == []
    assert seen.q_slope_correlation() < -0.12


@pytest.mark.parametrize(("h_m", "W20_kt", "dt_s"), [(30.0, 15.0, 0.01), (250.0, 45.0, 0.02)])
def test_as_specified_at_other_heights_intensities_and_steps(
    h_m: float, W20_kt: float, dt_s: float
) -> None:
    seen = measure(
        "jsbsim", replace(SHORT, h_m=h_m, W20_kt=W20_kt, dt_s=dt_s, duration_s=1200.0, seed=8)
    )
    assert [row for row in compare(seen) if not row.within(0.05)] == []


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 180.0])
def test_plain_jsbsim_is_not(heading_deg: float) -> None:
    # Counter-case: wind from the south; the gust axes of plain JSBSim stay on the wind, x downwind.
    seen = measure(
        "plain-tustin", replace(SHORT, heading_deg=heading_deg, wind_from_deg=180.0, seed=100)
    )
    failed = {row.component: row.sd_ratio for row in compare(seen) if not row.within(0.03)}
    if heading_deg == 90.0:  # across: p and q have changed places
        assert failed["p"] < 0.75
        assert failed["q"] > 1.6
    else:
        assert failed["p"] > 1.08
    if heading_deg == 0.0:  # against the wind: u, v, p and q are turned about, r is not
        assert seen.r_slope_correlation() < -0.12
    if heading_deg == 180.0:  # with the wind: q itself has the wrong sign
        assert seen.q_slope_correlation() > 0.12


def test_ten_percent_more_wind_is_noticed() -> None:
    seen = measure("host", replace(SHORT, W20_kt=33.0))
    judged = compare(Gusts("host", SHORT, seen.series))
    assert {row.component for row in judged if not row.within(0.03)} >= {"p", "q", "r"}


def test_headings_differ_in_nothing_when_the_seed_is_the_same() -> None:
    first, second = (
        measure("jsbsim", replace(SHORT, heading_deg=h, duration_s=20.0)) for h in (0.0, 137.0)
    )
    for name in COMPONENTS:
        sigma = dryden_sigma(name, SHORT.V_mps, SHORT.h_m, SHORT.W20_kt, SHORT.b_m)
        np.testing.assert_allclose(first.series[name], second.series[name], atol=1e-4 * sigma)


# Steady wind.


@pytest.mark.parametrize("from_deg", [0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0])
def test_steady_wind_blows_from_where_it_is_said_to(pinned: Open, from_deg: float) -> None:
    fdm = pinned({"air/wind-mps": 7.0, "air/wind-from-deg": from_deg})
    expected = [-7.0 * np.cos(np.radians(from_deg)), -7.0 * np.sin(np.radians(from_deg)), 0.0]
    for _ in range(300):
        np.testing.assert_allclose(total_wind_mps(fdm), expected, atol=1e-9)
        assert not rotation(fdm).any()
        fdm.run()


def test_west_wind_carries_the_aircraft_east() -> None:
    drift = {}
    for wind in (0.0, 5.0):
        fdm = engine.open_fdm(staged(find_aircraft("espaaro")), 0.01)
        for name, value in {
            "ic/lat-geod-deg": 45.0,
            "ic/h-sl-ft": 500.0,
            "ic/u-fps": 72.8,
            "ic/theta-deg": 0.8,
        }.items():
            fdm[name] = value
        fdm["air/wind-mps"], fdm["air/wind-from-deg"] = wind, 270.0
        engine.run_ic(fdm)
        steps(fdm, 600)
        drift[wind] = (
            fdm["position/long-gc-deg"] * np.radians(1.0) * 6378137.0 * np.cos(np.radians(45.0))
        )
    assert drift[5.0] - drift[0.0] > 2.0


def test_settings_count_when_changed_in_flight(pinned: Open) -> None:
    fdm = pinned()
    steps(fdm, 17)
    fdm["air/wind-mps"], fdm["air/wind-from-deg"] = 4.0, 90.0
    steps(fdm, 11)
    np.testing.assert_allclose(total_wind_mps(fdm), [0.0, -4.0, 0.0], atol=1e-9)


# Switching.


@pytest.mark.parametrize("before", [True, False])
def test_activation_never_makes_a_nan(pinned: Open, before: bool) -> None:
    fdm = pinned({"air/turbulence-w20-kt": 45.0} if before else {})
    assert fdm["atmosphere/turb-type"] == 0.0
    fdm["air/turbulence-w20-kt"] = 45.0
    for _ in range(100):
        fdm.run()
        assert np.isfinite([*total_wind_mps(fdm), *rotation(fdm)]).all()
    assert fdm["atmosphere/turb-type"] == 4.0
    assert rotation(fdm).all()


def test_switching_off_leaves_the_steady_wind(pinned: Open) -> None:
    fdm = pinned({"air/turbulence-w20-kt": 30.0, "air/wind-mps": 3.0, "air/wind-from-deg": 180.0})
    steps(fdm, 200)
    assert np.abs(total_wind_mps(fdm) - [3.0, 0.0, 0.0]).max() > 0.01
    fdm["air/turbulence-w20-kt"] = 0.0
    steps(fdm, 12)
    np.testing.assert_allclose(total_wind_mps(fdm), [3.0, 0.0, 0.0], atol=1e-8)
    assert not rotation(fdm).any()


def test_a_used_instance_starts_again_when_told_to_stop_first(pinned: Open) -> None:
    fdm = pinned({"air/turbulence-w20-kt": 30.0})
    steps(fdm, 100)
    fdm["atmosphere/turb-type"] = 0.0
    engine.run_ic(fdm)
    steps(fdm, 100)
    assert np.isfinite(total_wind_mps(fdm)).all()


@pytest.mark.parametrize("heading_deg", [20.0, 110.0, 200.0, 290.0])
def test_headings_with_a_zero_cosine_or_sine_turn_the_axes(
    pinned: Open, heading_deg: float
) -> None:
    # wind from 250: true headings 270, 0, 90, 180.
    condition = replace(SHORT, heading_deg=heading_deg)
    fdm = pinned({"air/turbulence-w20-kt": 30.0}, condition)
    steps(fdm, 50)
    assert np.cos(fdm["atmosphere/psiw-rad"] + fdm["attitude/psi-rad"]) == pytest.approx(
        1.0, abs=1e-9
    )


def test_same_seed_same_bytes(pinned: Open) -> None:
    def flight(seed: int) -> bytes:
        fdm = pinned({"air/turbulence-w20-kt": 30.0}, replace(SHORT, seed=seed))
        rows = []
        for _ in range(300):
            fdm.run()
            rows.append([*total_wind_mps(fdm), *rotation(fdm)])
        return np.array(rows).tobytes()

    assert flight(11) == flight(11)
    assert flight(11) != flight(12)


# Gusts from the host.


def test_host_with_nothing_to_say_is_calm(pinned: Open) -> None:
    fdm = pinned({"air/turbulence-source": 1.0, "air/turbulence-w20-kt": 45.0, "air/wind-mps": 2.0})
    for _ in range(100):
        fdm.run()
        np.testing.assert_allclose(total_wind_mps(fdm), [0.0, 2.0, 0.0], atol=1e-9)
        assert not rotation(fdm).any()


def test_host_gusts_arrive_one_frame_later_in_the_right_axes(pinned: Open) -> None:
    condition = replace(SHORT, heading_deg=80.0, wind_mps=0.0, phi_deg=25.0, theta_deg=10.0)
    fdm = pinned({"air/turbulence-source": 1.0}, condition)
    steps(fdm, 500)
    gust, turn = np.array([1.0, 2.0, -3.0]), np.array([0.1, -0.2, 0.3])
    for name, value in zip("uvw", gust, strict=True):
        fdm[f"air/host/{name}-mps"] = value
    for name, value in zip("pqr", turn, strict=True):
        fdm[f"air/host/{name}-rad_sec"] = value
    fdm.run()
    assert not rotation(fdm).any()
    np.testing.assert_allclose(total_wind_mps(fdm), 0.0, atol=1e-12)
    fdm.run()
    psi, phi, theta = (fdm[f"attitude/{angle}-rad"] for angle in ("psi", "phi", "theta"))
    heading_to_ned = np.array(
        [[np.cos(psi), -np.sin(psi), 0], [np.sin(psi), np.cos(psi), 0], [0, 0, 1]]
    )
    pitch = np.array(
        [[np.cos(theta), 0, -np.sin(theta)], [0, 1, 0], [np.sin(theta), 0, np.cos(theta)]]
    )
    roll = np.array([[1, 0, 0], [0, np.cos(phi), np.sin(phi)], [0, -np.sin(phi), np.cos(phi)]])
    np.testing.assert_allclose(total_wind_mps(fdm), heading_to_ned @ gust, atol=1e-6)
    np.testing.assert_allclose(rotation(fdm), roll @ pitch @ turn, atol=1e-6)


# Height.


@pytest.mark.parametrize("elevation_m", [250.0, 1000.0, 2000.0, -300.0])
@pytest.mark.parametrize("h_m", [0.0, 100.0, 500.0])
def test_field_elevation_is_the_standard_atmosphere_higher_up(
    pinned: Open, elevation_m: float, h_m: float
) -> None:
    fdm = pinned({"air/field-elevation-m": elevation_m}, replace(SHORT, h_m=h_m))
    temperature, pressure, density = isa(elevation_m + h_m)
    for _ in range(2):  # as soon as it is initialised, and later
        assert fdm["atmosphere/T-R"] / 1.8 == pytest.approx(temperature, rel=1e-4)
        assert fdm["atmosphere/P-psf"] * 47.880259 == pytest.approx(pressure, rel=1e-3)
        assert fdm["atmosphere/rho-slugs_ft3"] * 515.378818 == pytest.approx(density, rel=1e-3)
        steps(fdm, 300)


def test_field_elevation_changed_in_flight_and_back(pinned: Open) -> None:
    fdm = pinned()
    before = fdm["atmosphere/rho-slugs_ft3"]
    for elevation_m, expected in ((1500.0, isa(1600.0)[2]), (0.0, isa(100.0)[2])):
        fdm["air/field-elevation-m"] = elevation_m
        steps(fdm, 12)
        assert fdm["atmosphere/rho-slugs_ft3"] * 515.378818 == pytest.approx(expected, rel=1e-3)
    assert fdm["atmosphere/rho-slugs_ft3"] == pytest.approx(before, rel=1e-6)


def test_field_at_sea_level_leaves_the_atmosphere_alone(pinned: Open, tmp_path: Path) -> None:
    with_air = pinned()
    without = open_pinned(write_vehicle(tmp_path / "bare", SHORT.b_m, None), SHORT, {})
    for fdm in (with_air, without):
        steps(fdm, 200)
    for name in ("T-R", "P-psf", "rho-slugs_ft3", "P-sl-psf", "delta-T"):
        assert with_air[f"atmosphere/{name}"] == without[f"atmosphere/{name}"]


def test_turbulence_at_a_high_field_is_that_of_the_height_above_it(pinned: Open) -> None:
    high, low = (
        pinned({"air/turbulence-w20-kt": 30.0, "air/field-elevation-m": e}) for e in (1800.0, 0.0)
    )
    for _ in range(500):
        high.run()
        low.run()
    np.testing.assert_allclose(total_wind_mps(high), total_wind_mps(low), rtol=1e-6)


def test_terrain_above_sea_level_is_reported(pinned: Open) -> None:
    fdm = pinned()
    steps(fdm, 200)
    assert fdm["air/height-wrong"] == 0.0
    assert pinned({"ic/terrain-elevation-ft": 300.0})["air/height-wrong"] == 1.0


def test_wind_set_elsewhere_is_removed_and_reported(pinned: Open) -> None:
    fdm = pinned({"air/turbulence-w20-kt": 15.0})
    steps(fdm, 100)
    assert fdm["air/wind-misplaced"] == 0.0
    fdm["atmosphere/wind-east-fps"] = 20.0
    steps(fdm, 12)
    assert fdm["air/wind-misplaced"] == 1.0
    assert fdm["atmosphere/wind-mag-fps"] < 1e-6


# The command.


@pytest.mark.slow
def test_command_writes_tables_and_figure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "air"
    assert main(["--out", str(out), "--hours", "0.05", "--headings-deg", "90"]) in (0, 1)
    assert (out / "air.csv").read_text().count("\n") == 1 + 4 * 6
    assert (out / "air.svg").stat().st_size > 10_000
    assert "plain-milspec" in capsys.readouterr().out
    assert main(["--out", str(out), "--hours", "-1"]) == 2
