"""Positions in a card changed in place; the author's remarks stay."""

from __future__ import annotations

import tomllib

import pytest

from uqharness.errors import BadInputError
from uqharness.simulator.aircraft import DECIMALS, sensors_from_cg


@pytest.mark.parametrize(
    ("card", "expected"),
    [
        (
            "# mine\n[sensors]\nnoise_std = { q_radps = 0.1 }  # that\n",
            {"accelerometer": [-0.02, 0.0, 0.0]},
        ),
        (
            "[sensors.position_m]\nvane = [1.0, 0.5, 0]\n",
            {"accelerometer": [-0.02, 0.0, 0.0], "vane": [0.98, 0.5, 0.0]},
        ),
        ("a = 1\n", {"accelerometer": [-0.02, 0.0, 0.0]}),
    ],
)
def test_sensors_stay_in_the_airframe_and_remarks_in_the_card(tmp_path, card, expected):
    path = tmp_path / "airframe.toml"
    path.write_text(card, encoding="utf-8")
    sensors_from_cg(path, 0.02, "moved")
    text = path.read_text(encoding="utf-8")
    assert tomllib.loads(text)["sensors"]["position_m"] == expected
    assert all(line in text for line in card.splitlines() if "#" in line)
    path.write_text("a = [", encoding="utf-8")
    with pytest.raises(BadInputError, match=r"airframe\.toml"):
        sensors_from_cg(path, 0.02, "moved")
    sensors_from_cg(tmp_path / "none.toml", 0.02, "moved")
    assert not (tmp_path / "none.toml").exists()


def test_there_and_back_is_the_same_and_rounding_is_to_its_places(tmp_path):
    path = tmp_path / "airframe.toml"
    path.write_text(
        "[sensors]\nposition_m = { accelerometer = [0.1, 0.0, -0.2], gps = [0.3, 0.1, 0.0] }\n"
    )
    before = tomllib.loads(path.read_text())
    sensors_from_cg(path, 0.0123456, "there")
    moved = tomllib.loads(path.read_text())["sensors"]["position_m"]
    assert moved["gps"] == [round(0.3 - 0.0123456, DECIMALS), 0.1, 0.0]
    sensors_from_cg(path, -0.0123456, "back")
    assert tomllib.loads(path.read_text()) == before
