"""[start]: the trimmed flight of a mission without a script."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from uqharness.simulator.own_mission import StartSection


def test_a_start_heads_north_unless_told():
    assert StartSection(V_mps=22.0, altitude_m=100.0).heading_deg == 0.0


@pytest.mark.parametrize(
    "section",
    [
        {"V_mps": 0.0, "altitude_m": 100.0},
        {"V_mps": 22.0, "altitude_m": 0.0},
        {"V_mps": 22.0},
        {"V_mps": "22", "altitude_m": 1.0},
        {"V_mps": float("nan"), "altitude_m": 100.0},
        {"V_mps": 22.0, "altitude_m": 100.0, "heading_deg": 361.0},
        {"V_mps": 22.0, "altitude_m": 100.0, "climb_deg": -46.0},
        {"V_mps": 22.0, "altitude_m": 100.0, "bank_deg": 0.0},
        {"V_mps": True, "altitude_m": 100.0},
    ],
    ids=str,
)
def test_what_is_no_start_is_refused(section):
    with pytest.raises(ValidationError):
        StartSection.model_validate(section)


def test_a_start_does_not_change():
    start = StartSection(V_mps=22.0, altitude_m=100.0)
    with pytest.raises(ValidationError, match="frozen"):
        start.V_mps = 23.0
