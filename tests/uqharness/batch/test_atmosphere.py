"""The atmosphere against JSBSim and the standard's own table; air data from standstill to supersonic."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.units import FT_M
from tests.helpers.batch_flights import START, aircraft, by_batch, compared, craft, worst
from tests.helpers.few import few
from uqharness.batch import atmosphere

NAMES = ("T-R", "P-psf", "rho-slugs_ft3", "a-fps", "T-sl-R", "rho-sl-slugs_ft3", "a-sl-fps")


RECORDS = tuple(f"atmosphere/{name}" for name in NAMES)


HEIGHTS = (-1000.0, 0.0, 10.0, 5000.0, 36000.0, 36152.0, 50000.0, 65000.0, 66000.0, 100000.0)


BODY = "<aerodynamics/>"


"""Bias [R] and pressure at sea level [psf]."""


def at(height_ft, bias_R=0.0, sea_level_psf=2116.228):
    return {
        **START,
        "ic/h-sl-ft": height_ft,
        "atmosphere/delta-T": bias_R,
        "atmosphere/P-sl-psf": sea_level_psf,
    }


@pytest.mark.parametrize("height_ft", few(HEIGHTS, 3))
@pytest.mark.parametrize(
    ("bias_R", "sea_level_psf"),
    [
        (0.0, 2116.228),
        (-54.0, 2000.0),
        *(
            pytest.param(*pair, marks=pytest.mark.slow)
            for pair in ((27.0, 2116.228), (9.0, 2200.0))
        ),
    ],
)
def test_atmosphere_is_jsbsims(height_ft, bias_R, sea_level_psf):
    assert (
        worst(
            compared(aircraft(BODY), RECORDS, frames=2, start=at(height_ft, bias_R, sea_level_psf))
        )
        < 1e-12
    )


@pytest.mark.parametrize("bias_R", [27.0])
def test_a_change_in_flight_is_there_in_the_next_frame(bias_R):
    inputs = {
        "atmosphere/delta-T": np.array([0.0, 0.0, bias_R, bias_R]),
        "atmosphere/P-sl-psf": np.array([2116.228] * 3 + [2000.0]),
    }
    assert worst(compared(aircraft(BODY), RECORDS, inputs, 3)) < 2e-13


@pytest.mark.parametrize(
    ("height_km", "pressure_Pa"),
    [(11.0, 22632.06), (20.0, 5474.889), (32.0, 868.0187), (47.0, 110.9063)],
)
def test_pressure_is_that_of_the_1976_tables(height_km, pressure_Pa):
    """U.S. Standard Atmosphere 1976, table 4 and table I: pressures at the geopotential heights
    where layers meet.
    """
    geometric_ft = 6356.766 * height_km / (6356.766 - height_km) * 1000.0 / FT_M
    start = {**START, "ic/lat-geod-rad": 0.0, "ic/h-sl-ft": geometric_ft, "ic/u-fps": 0.0}
    with craft(aircraft(BODY), start) as output:
        result = by_batch(output, {}, RECORDS, 1)["atmosphere/P-psf"]
    assert result[0] / 2116.228 == pytest.approx(pressure_Pa / 101325.0, rel=5e-5)


RECORDS_AIR_DATA = (
    *(f"velocities/{name}" for name in ("vc-fps", "vc-kts", "ve-kts", "vtrue-kts")),
    "aero/Re",
    *(f"propulsion/{name}" for name in ("pt-lbs_sqft", "tat-r", "tat-c")),
    *(f"atmosphere/{name}" for name in ("theta", "delta", "sigma", "a-ratio")),
)


FAST = {**START, "ic/h-sl-ft": 35000.0, "ic/u-fps": 1800.0}


@pytest.mark.parametrize("speed_fps", few([5.0, 70.0, 0.0, 900.0, 1100.0, 1200.0, 3000.0], 3))
@pytest.mark.parametrize("height_ft", few([35000.0, 0.0], 1))
def test_air_data_are_jsbsims(speed_fps, height_ft):
    start = {
        **START,
        "ic/h-sl-ft": height_ft,
        "ic/u-fps": speed_fps,
        "ic/v-fps": 0.0,
        "ic/w-fps": 0.0,
    }
    assert worst(
        compared(aircraft("<aerodynamics/>"), RECORDS_AIR_DATA, frames=3, start=start)
    ) < 1e-11 * max(1.0, 70.0 / max(speed_fps, 1.0))  # impact pressure is a small difference


def test_air_data_on_hot_and_cold_days_are_jsbsims():
    names = [
        *RECORDS_AIR_DATA,
        "velocities/ve-fps",
        "atmosphere/density-altitude",
        "atmosphere/pressure-altitude",
    ]
    for height, warmer in ((3000.0, 30.0), (45000.0, -20.0), (170000.0, 10.0)):
        start = {**FAST, "ic/h-sl-ft": height, "atmosphere/delta-T": warmer}
        assert worst(compared(aircraft("<aerodynamics/>"), names, frames=2, start=start)) < 1e-9


@pytest.mark.parametrize("name", ["_SUPERSONIC", "_SUTHERLAND_R"])
def test_a_constant_a_little_off_is_noticed(monkeypatch, name):
    monkeypatch.setattr(atmosphere, name, getattr(atmosphere, name) * (1.0 + 1e-9))
    assert (
        worst(compared(aircraft("<aerodynamics/>"), RECORDS_AIR_DATA, frames=2, start=FAST)) > 5e-11
    )
