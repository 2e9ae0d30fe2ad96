"""Air data against JSBSim, from standstill to beyond the speed of sound."""

from __future__ import annotations

import pytest

from tests.helpers.batch_flights import START, aircraft, compared, worst
from uqharness.batch.models import atmosphere

RECORDS = (
    *(f"velocities/{name}" for name in ("vc-fps", "vc-kts", "ve-kts", "vtrue-kts")),
    "aero/Re",
    *(f"propulsion/{name}" for name in ("pt-lbs_sqft", "tat-r", "tat-c")),
    *(f"atmosphere/{name}" for name in ("theta", "delta", "sigma", "a-ratio")),
)
FAST = {**START, "ic/h-sl-ft": 35000.0, "ic/u-fps": 1800.0}


@pytest.mark.parametrize("speed_fps", [0.0, 5.0, 70.0, 900.0, 1100.0, 1200.0, 3000.0])
@pytest.mark.parametrize("height_ft", [0.0, 35000.0])
def test_as_in_jsbsim(speed_fps, height_ft):
    start = {
        **START,
        "ic/h-sl-ft": height_ft,
        "ic/u-fps": speed_fps,
        "ic/v-fps": 0.0,
        "ic/w-fps": 0.0,
    }
    assert worst(
        compared(aircraft("<aerodynamics/>"), RECORDS, frames=3, start=start)
    ) < 1e-11 * max(1.0, 70.0 / max(speed_fps, 1.0))  # impact pressure is a small difference


def test_on_another_day():
    names = [
        *RECORDS,
        "velocities/ve-fps",
        "atmosphere/density-altitude",
        "atmosphere/pressure-altitude",
    ]
    for height, warmer in ((3000.0, 30.0), (45000.0, -20.0), (170000.0, 10.0)):
        start = {**FAST, "ic/h-sl-ft": height, "atmosphere/delta-T": warmer}
        assert worst(compared(aircraft("<aerodynamics/>"), names, frames=2, start=start)) < 1e-9


@pytest.mark.parametrize(
    "name", ["_RAYLEIGH", "_SUPERSONIC", "_A0_FPS", "_VISCOSITY", "_SUTHERLAND_R"]
)
def test_a_constant_a_little_off_is_noticed(monkeypatch, name):
    monkeypatch.setattr(atmosphere, name, getattr(atmosphere, name) * (1.0 + 1e-9))
    assert worst(compared(aircraft("<aerodynamics/>"), RECORDS, frames=2, start=FAST)) > 5e-11
