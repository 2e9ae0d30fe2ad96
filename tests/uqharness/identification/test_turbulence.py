"""Identification in turbulence: filter error takes over, and only where the air moves."""

from __future__ import annotations

from pathlib import Path

import pytest

import uqharness as uq


@pytest.mark.parametrize(
    ("turbulence", "method"), [pytest.param("light", "filter error", marks=pytest.mark.slow), ("none", "output error")]
)
def test_the_method_follows_the_air(tmp_path: Path, turbulence: str, method: str):
    flight = uq.fly("espaaro", "flight-ident", duration_s=24, turbulence=turbulence, noise=True, seed=3)
    flight.write(tmp_path / "flight.parquet")
    found = uq.identify("espaaro", tmp_path / "flight.parquet", parameters=["aero/Cm_q"], workers=1)
    assert found.method == method
    # Flown by the model itself: its value is the truth.
    assert abs(found.theta[0] - found.initial[0]) < 3.5 * found.std[0]
    assert found.std[0] < 0.1 * abs(found.theta[0])
