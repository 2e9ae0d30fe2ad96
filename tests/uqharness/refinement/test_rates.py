"""Rate limits of servos: which are tried, and where one more does nothing."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sysid.effects import Choice
from uqharness.refinement.candidates import servo_change
from uqharness.refinement.rates import _asked, felt, just_so
from uqharness.replay import Segment, runs_per_row
from uqharness.simulator import Actuator

DT = 0.02
KEY = "effect/actuator.elevator/rate_limit"


def setup_with(rate: float):
    """Doublets of 10 deg of an elevator whose lag makes its fastest motion some 110 deg/s."""
    controls = np.zeros((200, 4))
    controls[20:60, 0], controls[60:100, 0] = 10.0, -10.0
    segment = Segment("m", "f", DT * np.arange(200), controls, np.zeros(9), 100.0, 0.0)
    return SimpleNamespace(segments=[segment], servos={"elevator": Actuator(25.0, rate)})


def fastest(setup) -> float:
    moved = Actuator(25.0).follow(setup.segments[0].controls[:, 0], DT, DT / runs_per_row(DT))
    return float(np.abs(np.diff(moved)).max() / DT)


def test_a_limit_that_is_felt_may_be_too_low_as_well_as_too_high():
    limited = setup_with(40.0)
    asked = _asked(limited, "elevator", limited.servos["elevator"])
    assert min(asked) < 40.0 < max(asked) == pytest.approx(fastest(limited))
    free = setup_with(1000.0)
    assert max(_asked(free, "elevator", free.servos["elevator"])) < fastest(free)


@pytest.mark.parametrize(("limit", "share"), [(80.0, 0.02), (25.0, 0.02)])
def test_the_limit_that_does_just_what_is_missing_is_found_on_either_side(limit, share):
    setup = setup_with(40.0)
    servo, command = setup.servos["elevator"], setup.segments[0].controls[:, 0]
    missing = Actuator(25.0, limit).follow(command, DT, DT / runs_per_row(DT)) - servo.follow(command, DT, DT / runs_per_row(DT))
    speeds = np.array([s for s in _asked(setup, "elevator", servo) if (s > 40.0) == (limit > 40.0)])
    wanted = []
    for speed in speeds:
        column = servo_change("rate_limit", servo, command, command, DT, (40.0, speed))
        wanted.append(column @ missing / (column @ column) / (1.0 / speed - 1.0 / 40.0))
    assert just_so(speeds, np.array(wanted), np.ones(len(speeds))) == pytest.approx(limit, rel=0.1)
    assert just_so(speeds, -np.array(wanted), np.ones(len(speeds))) is None


def test_above_the_fastest_motion_every_limit_is_the_same():
    limited = setup_with(40.0)
    beyond = Choice(KEY, 1.0 / 500.0 - 1.0 / 40.0, 1e-4, -230.0, 1.0, 1.0, 0.0)
    (within,) = felt([beyond], limited)
    assert 1.0 / (within.value + 1.0 / 40.0) == pytest.approx(fastest(limited))
    assert within.t == pytest.approx(within.value / 1e-4)
    below = Choice(KEY, 1.0 / 60.0 - 1.0 / 40.0, 1e-4, -80.0, 1.0, 1.0, 0.0)
    lag = Choice("effect/actuator.elevator/lag", -5.0, 1.0, -5.0, 1.0, 1.0, 0.0)
    assert felt([below, lag], limited) == (below, lag)
