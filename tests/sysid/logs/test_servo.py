"""Deflections from servo outputs, parameters of autopilots, and steps of slowly logged commands."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from sysid.logs.card import parse_card
from sysid.logs.servo import (
    controls,
    deflection,
    functions,
    logged_rows,
    outputs,
    parse_parameters,
    place_steps,
)
from tests.helpers.few import few

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
    result, _ = controls(parse_card(text, Path("airframe.toml")), parameters)
    control = result["elevator_deg"]
    ((_, servo, _),) = control.parts
    return deflection(np.array(pwm), servo).tolist(), control.description, control.conflicts


def test_controls_take_neutral_and_sense_of_the_log() -> None:
    values, _, against = angles(
        TABLE, {**LOG, "SERVO2_TRIM": 1540.0, "SERVO2_REVERSED": 0.0}, [1140.0, 1540.0, 1940.0]
    )
    assert values == pytest.approx([20.0, 0.0, -20.0])
    assert "turns the other way in the card" in against
    assert "1540 us in the log, 1500 us in the card" in against


def test_controls_without_a_table_use_the_cards_limits() -> None:
    for key in ("unit = 'deg'\nlimits = [-25, 15]", "throw_deg = 20"):
        text = f"[inputs.elevator]\nproperty = 'fcs/elevator'\n{key}\n"
        values, reports, _ = angles(text, LOG, [1000.0, 1500.0, 1750.0, 2000.0])
        assert values == pytest.approx(
            [-25.0, 0.0, 7.5, 15.0] if "limits" in key else [-20.0, 0.0, 10.0, 20.0]
        )
        assert "degrees assumed" in reports
    # Neither table nor throw: no angle is made up.
    empty, _ = controls(
        parse_card("[inputs.elevator]\nproperty = 'fcs/elevator'\n", Path("airframe.toml")), LOG
    )
    assert "elevator_deg" not in empty


# Servo outputs by an autopilot's own parameters.

ARDUPLANE = {
    "SERVO1_FUNCTION": 4.0,
    "SERVO1_MIN": 1100.0,
    "SERVO1_MAX": 1900.0,
    "SERVO1_TRIM": 1500.0,
    "SERVO1_REVERSED": 0.0,
    "SERVO5_FUNCTION": 19.0,
    "SERVO5_MIN": 1200.0,
    "SERVO5_MAX": 1900.0,
    "SERVO5_TRIM": 1520.0,
    "SERVO5_REVERSED": 1.0,
    "SERVO6_FUNCTION": 0.0,
}


def test_arduplane() -> None:
    result = outputs(ARDUPLANE)
    assert set(result) == {"aileron", "elevator"}
    (elevator,) = result["elevator"]
    # Reversed, so that more PWM is nose down, which a flight record counts as +.
    assert (elevator.channel, elevator.low, elevator.neutral, elevator.high, elevator.sense) == (
        5,
        1200.0,
        1520.0,
        1900.0,
        1.0,
    )
    assert result["aileron"][0].sense == 1.0
    assert outputs({**ARDUPLANE, "SERVO5_REVERSED": 0.0})["elevator"][0].sense == -1.0
    unsaid = outputs({"SERVO2_FUNCTION": 19.0})["elevator"][0]
    assert unsaid.sense == 0.0
    assert math.isnan(unsaid.neutral)
    assert not unsaid.spans
    assert functions(ARDUPLANE) == {1: 4, 5: 19}


def test_arduplane_before_servo_parameters() -> None:
    old = {
        "RC2_MIN": 1100.0,
        "RC2_MAX": 1900.0,
        "RC2_TRIM": 1490.0,
        "RC2_REV": -1.0,
        "RC1_TRIM": 1500.0,
    }
    result = outputs(old)
    assert set(result) == {"elevator"}  # a trim alone says nothing of the sense
    assert (result["elevator"][0].channel, result["elevator"][0].sense) == (2, 1.0)
    # PX4 calibrates its receiver's inputs by parameters of the same names.
    assert outputs({**old, "RC_MAP_PITCH": 2.0}) == {}
    assert outputs({**old, "SYS_AUTOSTART": 2100.0}) == {}


def test_px4() -> None:
    parameters = {
        "PWM_MAIN_FUNC1": 201.0,
        "PWM_MAIN_FUNC2": 202.0,
        "PWM_MAIN_FUNC3": 203.0,
        "PWM_MAIN_FUNC4": 101.0,
        "PWM_MAIN_REV": 2.0,
        "CA_SV_CS0_TYPE": 1.0,
        "CA_SV_CS0_TRQ_R": -0.5,
        "CA_SV_CS1_TYPE": 2.0,
        "CA_SV_CS1_TRQ_R": 0.5,
        "CA_SV_CS2_TYPE": 3.0,
        "CA_SV_CS2_TRQ_P": 1.0,
        "CA_SV_CS2_TRIM": 0.1,
        "PWM_MAIN_MIN3": 1100.0,
        "PWM_MAIN_MAX3": 1900.0,
    }
    result = outputs(parameters)
    assert [(o.channel, o.sense) for o in result["aileron"]] == [(1, -1.0), (2, -1.0)]
    assert (result["elevator"][0].neutral, result["elevator"][0].sense) == (1540.0, -1.0)
    assert result["throttle"][0].channel == 4
    assert outputs({"PWM_MAIN_FUNC1": 201.0}) == {}


def test_parameter_files() -> None:
    assert parse_parameters(
        "# plane\nSERVO2_TRIM 1500\nRLL2SRV_TCONST,0.5  # s\n1\t1\tTRIM_ARSPD_CM\t2200\t6\n"
    ) == {
        "SERVO2_TRIM": 1500.0,
        "RLL2SRV_TCONST": 0.5,
        "TRIM_ARSPD_CM": 2200.0,
    }
    for invalid in ("SERVO2_TRIM\n", "SERVO2_TRIM fifteen\n", "a-b 1\n", "A nan\n"):
        with pytest.raises(ValueError, match=r"line 1: .* is no parameter"):
            parse_parameters(invalid)
    with pytest.raises(ValueError, match="holds no parameter"):
        parse_parameters("# nothing\n")


# Steps of slowly logged commands: placed where they happened, and left alone where the gyro
# does not say.

DT, STRIDE, NOISE = 0.02, 2, 0.0036


def fly(seed, size=6.0, late_s=0.0, dt=DT, stride=STRIDE):
    """Command as carried out, as logged, and the noisy roll rate of p' = -4 p + 0.25 u seen by a
    gyro that is late.
    """
    rng = np.random.default_rng(seed)
    n, fine = round(12.0 / dt), 20
    acted = np.zeros(n)
    for at in np.arange(30, 570, 40) + rng.integers(0, 9, 14):
        at = round(at * DT / dt) + int(rng.integers(0, stride))
        acted[at:] = size * (acted[at - 1] == 0.0)
    logged = acted[(np.arange(n) // stride) * stride]
    h = dt / fine
    rate = np.zeros(n * fine + 1)
    for k, u in enumerate(np.repeat(acted, fine)):
        rate[k + 1] = rate[k] + h * (-4.0 * rate[k] + 0.25 * u)
    observed = np.interp(np.arange(n) * dt - late_s, np.arange(n * fine + 1) * h, rate)
    return acted, logged, observed + NOISE * rng.standard_normal(n)


@pytest.mark.parametrize(
    ("late_s", "dt", "stride"),
    few([(0.006, 0.02, 2), (0.0, 0.02, 2), (0.011, 0.02, 2), (0.005, 0.005, 8)], 1),
)
def test_place_steps_finds_logged_steps(late_s, dt, stride):
    before = after = 0.0
    for seed in range(6):
        acted, logged, rate = fly(seed, late_s=late_s, dt=dt, stride=stride)
        result = place_steps(logged, logged_rows(logged, stride), rate, NOISE, dt)
        placed, moved = result.command, result.steps
        assert moved > 0
        before += np.abs(logged - acted).sum()
        after += np.abs(placed - acted).sum()
    assert after < 0.3 * before
