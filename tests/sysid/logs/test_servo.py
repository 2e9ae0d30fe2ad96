"""Tables of servo outputs: the log's parameters before the card, degrees by the card, each said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sysid.logs.card import parse_card
from sysid.logs.servo import controls, deflection

TABLE = (
    "[inputs.elevator]\nproperty = 'fcs/elevator'\nlimits = [-25, 25]\nservo_pwm = [[1100, -20],"
    " [1500, 0], [1900, 20]]\n"
)
LOG = {
    "SERVO2_FUNCTION": 19.0,
    "SERVO2_MIN": 1000.0,
    "SERVO2_MAX": 2000.0,
    "SERVO2_TRIM": 1500.0,
    "SERVO2_REVERSED": 1.0,
}


def angles(
    text: str, parameters: dict[str, float], pwm: list[float]
) -> tuple[list[float], str, str]:
    found, _ = controls(parse_card(text, Path("airframe.toml")), parameters)
    control = found["elevator_deg"]
    ((_, servo, _),) = control.parts
    return deflection(np.array(pwm), servo).tolist(), control.description, control.conflicts


def test_a_log_that_agrees_with_the_card_changes_nothing() -> None:
    values, told, against = angles(TABLE, LOG, [1100.0, 1500.0, 1900.0])
    assert values == pytest.approx([-20.0, 0.0, 20.0])
    assert "SERVO2_FUNCTION" in told
    assert "degrees a us by the card's servo_pwm" in told
    assert against == ""


def test_neutral_and_sense_are_the_logs_and_the_conflict_is_told() -> None:
    values, _, against = angles(
        TABLE, {**LOG, "SERVO2_TRIM": 1540.0, "SERVO2_REVERSED": 0.0}, [1140.0, 1540.0, 1940.0]
    )
    assert values == pytest.approx([20.0, 0.0, -20.0])
    assert "turns the other way in the card" in against
    assert "1540 us in the log, 1500 us in the card" in against


def test_without_a_table_the_ends_of_travel_are_the_cards_limits_and_it_says_so() -> None:
    for key in ("unit = 'deg'\nlimits = [-25, 15]", "throw_deg = 20"):
        text = f"[inputs.elevator]\nproperty = 'fcs/elevator'\n{key}\n"
        values, told, _ = angles(text, LOG, [1000.0, 1500.0, 1750.0, 2000.0])
        assert values == pytest.approx(
            [-25.0, 0.0, 7.5, 15.0] if "limits" in key else [-20.0, 0.0, 10.0, 20.0]
        )
        assert "degrees assumed" in told
    # Neither table nor throw: no angle is made up.
    nothing, _ = controls(
        parse_card("[inputs.elevator]\nproperty = 'fcs/elevator'\n", Path("airframe.toml")), LOG
    )
    assert "elevator_deg" not in nothing


def test_limits_of_a_normalised_command_are_no_degrees() -> None:
    text = TABLE.replace("limits = [-25, 25]", "unit = 'norm'\nlimits = [-1, 1]")
    assert angles(text, {}, [1900.0])[0] == [20.0]
    assert angles(TABLE.replace("[-25, 25]", "[-15, 15]"), {}, [1900.0])[0] == [15.0]


def test_without_parameters_the_card_and_the_usual_order_count() -> None:
    values, told, against = angles(TABLE, {}, [1900.0])
    assert (values, against) == ([20.0], "")
    assert told == "elevator is servo 2, 1100/1500/1900 us = -20/0/20 deg by the card's servo_pwm"
    assert controls(None, {})[0] == {}
