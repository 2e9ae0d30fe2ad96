"""Servo outputs by an autopilot's own parameters."""

from __future__ import annotations

import math

import pytest

from sysid.logs.servo import functions, outputs, parse_parameters

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
    found = outputs(ARDUPLANE)
    assert set(found) == {"aileron", "elevator"}
    (elevator,) = found["elevator"]
    # Reversed, so that more PWM is nose down, which a flight record counts as +.
    assert (elevator.channel, elevator.low, elevator.neutral, elevator.high, elevator.sense) == (
        5,
        1200.0,
        1520.0,
        1900.0,
        1.0,
    )
    assert found["aileron"][0].sense == 1.0
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
    found = outputs(old)
    assert set(found) == {"elevator"}  # a trim alone says nothing of the sense
    assert (found["elevator"][0].channel, found["elevator"][0].sense) == (2, 1.0)
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
    found = outputs(parameters)
    assert [(o.channel, o.sense) for o in found["aileron"]] == [(1, -1.0), (2, -1.0)]
    assert (found["elevator"][0].neutral, found["elevator"][0].sense) == (1540.0, -1.0)
    assert found["throttle"][0].channel == 4
    assert outputs({"PWM_MAIN_FUNC1": 201.0}) == {}


def test_parameter_files() -> None:
    assert parse_parameters(
        "# plane\nSERVO2_TRIM 1500\nRLL2SRV_TCONST,0.5  # s\n1\t1\tTRIM_ARSPD_CM\t2200\t6\n"
    ) == {
        "SERVO2_TRIM": 1500.0,
        "RLL2SRV_TCONST": 0.5,
        "TRIM_ARSPD_CM": 2200.0,
    }
    for bad in ("SERVO2_TRIM\n", "SERVO2_TRIM fifteen\n", "a-b 1\n", "A nan\n"):
        with pytest.raises(ValueError, match=r"line 1: .* is no parameter"):
            parse_parameters(bad)
    with pytest.raises(ValueError, match="holds no parameter"):
        parse_parameters("# nothing\n")


def test_functions_of_a_damaged_log():
    parameters = {
        "SERVO1_FUNCTION": float("inf"),
        "SERVO2_FUNCTION": float("nan"),
        "SERVO4_FUNCTION": 19.0,
    }
    assert functions(parameters) == {4: 19}
    broken = dict.fromkeys(
        ("SERVO1_FUNCTION", "PWM_MAIN_FUNC1", "PWM_MAIN_REV", "CA_SV_CS0_TYPE"), math.inf
    )
    assert outputs(broken) == {}
    assert (
        outputs({"PWM_MAIN_FUNC1": 201.0} | {"PWM_MAIN_REV": math.nan, "CA_SV_CS0_TYPE": math.inf})
        == {}
    )
