"""airframe.toml: what is read, what is refused and where."""

from __future__ import annotations

from pathlib import Path

import pytest

from sysid.errors import LogError
from sysid.logs.card import AirframeCard, Reference, Servo, read_card


def test_a_card_by_file_or_folder(card_path: Path, card: AirframeCard) -> None:
    assert read_card(card_path.parent) == card
    assert card.name == "espaaro"
    assert card.reference == Reference(1.97, 3.66, 0.53)
    assert card.sensors.position_m == {"accelerometer": (0.0, 0.0, 0.0)}
    assert card.sensors.noise_std["V_mps"] == 0.5
    assert card.servos["throttle"] == Servo(((1000.0, 0.0), (2000.0, 100.0)), (0.0, 100.0))
    assert card.document["inputs"]["elevator"]["property"] == "fcs/elevator-cmd-deg"
    with pytest.raises(LogError, match="no such file"):
        read_card(card_path.with_name("none.toml"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[inputs.elevator]\nservo_pwm = [[1500, 0]]", "two or more pairs"),
        (
            "[inputs.elevator]\nlimit = [1, 2]\nservo_pwm = [[1000, 0], [2000, 1]]",
            "did you mean limits",
        ),
        ("[inputs.elevator]\nlimits = [5, -5]\nservo_pwm = [[1000, 0], [2000, 1]]", "low, high"),
        ("[inputs.elevator]\nservo_pwm = { neutral = 1500 }", "linear form"),
        (
            "[inputs.elevator]\nchannel = 0\nservo_pwm = [[1000, 0], [2000, 1]]",
            "servo output from 1",
        ),
        ("[mixing.spoiler]\nleft = 1", "unknown mixing"),
        ("[mixing.vtail]\nleft = { channel = 1 }", "needs channel and servo_pwm"),
        ("[sensors]\nposition_m = { accelerometer = [0, 0] }", "in metres"),
        ("[sensors]\nposition_m = { accelerometer = [0, 0, nan] }", "in metres"),
        ("[sensors]\nnoise_std = { V_mps = inf }", "finite number"),
        ("[sensors]\nnoise = { V_mps = 1 }", "allowed are position_m, noise_std"),
        ("[reference]\nb_m = -1", "must be above 0"),
        ("[inputs.elevator]\nchannel = 40", "servo output from 1"),
        ("inputs = 3", "must be a table"),
    ],
)
def test_bad_cards_are_refused_with_the_place(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "airframe.toml").write_text(text)
    with pytest.raises(LogError, match=message) as error:
        read_card(tmp_path)
    assert "airframe.toml" in str(error.value)


def test_linear_servo_form(tmp_path: Path) -> None:
    (tmp_path / "airframe.toml").write_text(
        "[inputs.rudder]\nservo_pwm = { neutral = 1520, per_us = -0.05 }"
    )
    assert read_card(tmp_path).servos["rudder"].table == ((1520.0, 0.0), (1620.0, -5.0))
