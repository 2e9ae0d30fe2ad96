"""Actuators against a discretisation by scipy, limits by hand, and an aircraft's own servos."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import signal

from uqharness.errors import BadInputError
from uqharness.simulator.actuators import Actuator, actuators
from uqharness.simulator.aircraft import find_aircraft

STEP = 0.01
COMMAND = np.repeat([0.0, 1.0, -2.0, 0.5], 25)


def test_a_lag_is_tustins_rule():
    lag = 20.0
    b, a, _ = signal.cont2discrete(([lag], [1.0, lag]), STEP, "bilinear")
    start = signal.lfilter_zi(b.ravel(), a) * COMMAND[0]
    expected, _ = signal.lfilter(b.ravel(), a, COMMAND, zi=start)
    np.testing.assert_allclose(Actuator(lag).follow(COMMAND, STEP, STEP), expected, atol=1e-12)
    assert not np.allclose(Actuator(1.1 * lag).follow(COMMAND, STEP, STEP), expected, atol=1e-3)


def test_a_rate_limit_and_stops_by_hand():
    ramp = Actuator(None, rate=10.0).follow(np.array([0.0, *[1.0] * 12]), STEP, STEP)
    assert ramp == pytest.approx(np.minimum(0.1 * np.arange(13), 1.0))
    stopped = Actuator(None, low=-0.5, high=0.7).follow(np.array([0.0, 2.0, -2.0]), STEP, STEP)
    assert stopped.tolist() == [0.0, 0.7, -0.5]
    assert Actuator(None).follow(COMMAND, STEP, STEP).tolist() == COMMAND.tolist()


def test_a_command_is_held_until_its_own_row():
    """Rows four steps apart: only the last step before a row has seen its command."""
    rows = Actuator(None, rate=100.0).follow(np.array([0.0, 4.0, 4.0]), 4 * STEP, STEP)
    assert rows.tolist() == [0.0, 1.0, 4.0]
    _, middle = Actuator(None, rate=100.0).follow_with_midpoints(
        np.array([0.0, 4.0, 4.0]), 4 * STEP, STEP
    )
    assert middle.tolist() == [0.0, 3.0]
    _, odd = Actuator(None, rate=100.0).follow_with_midpoints(
        np.array([0.0, 3.0, 3.0]), 3 * STEP, STEP
    )
    assert odd.tolist() == [0.0, 2.5]


def test_actuators_of_an_aircraft():
    aircraft = find_aircraft("espaaro")
    result = actuators(aircraft, ("elevator", "aileron"))
    assert set(result) == {"elevator", "aileron"}
    assert all(a.lag is not None and a.lag > 0.0 and math.isfinite(a.rate) for a in result.values())
    with pytest.raises(BadInputError, match=r"no <actuator> has the name of \[inputs\.elevator\]"):
        actuators(find_aircraft("c172x"), ("elevator",))
