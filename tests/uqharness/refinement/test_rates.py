"""Rate limits of servos: which are tried, and where one more does nothing."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sysid.effects import Effect, SelectedEffect, Selection
from tests.helpers.whitened import information_of
from uqharness.identification.linearised import (
    LOCAL_SLOPE,
    dead_zone_change,
    local_rate_limits,
    rate_limit_pair,
    servo_change,
)
from uqharness.refinement.candidate_model import with_local_rate_limits
from uqharness.refinement.servos import (
    SLOWER_SHARES,
    WIDTHS_DEG,
    _trial_rates,
    clip_to_active_range,
    is_fastest,
    limit_of_unit_gain,
)
from uqharness.replay import Segment, runs_per_row
from uqharness.simulator import Actuator

DT = 0.02
KEY = "effect/actuator.elevator/rate_limit"


def data_with(rate: float):
    """Doublets of 10 deg of an elevator whose lag makes its fastest motion some 110 deg/s."""
    controls = np.zeros((200, 4))
    controls[20:60, 0], controls[60:100, 0] = 10.0, -10.0
    segment = Segment("m", "f", DT * np.arange(200), controls, np.zeros(9), 100.0, 0.0)
    return SimpleNamespace(segments=[segment], servos={"elevator": Actuator(25.0, rate)})


def fastest(data) -> float:
    moved = Actuator(25.0).follow(data.segments[0].controls[:, 0], DT, DT / runs_per_row(DT))
    return float(np.abs(np.diff(moved)).max() / DT)


def test_a_limit_that_is_felt_may_be_too_low_as_well_as_too_high():
    limited = data_with(40.0)
    request = _trial_rates(limited, "elevator", limited.servos["elevator"])
    assert min(request) < 40.0 < max(request) == pytest.approx(fastest(limited))
    free = data_with(1000.0)
    assert max(_trial_rates(free, "elevator", free.servos["elevator"])) < fastest(free)


@pytest.mark.parametrize(("limit", "share"), [(80.0, 0.02), (25.0, 0.02)])
def test_the_limit_that_does_just_what_is_missing_is_found_on_either_side(limit, share):
    data = data_with(40.0)
    servo, command = data.servos["elevator"], data.segments[0].controls[:, 0]
    missing = Actuator(25.0, limit).follow(command, DT, DT / runs_per_row(DT)) - servo.follow(
        command, DT, DT / runs_per_row(DT)
    )
    speeds = np.array(
        [s for s in _trial_rates(data, "elevator", servo) if (s > 40.0) == (limit > 40.0)]
    )
    expected = []
    for speed in speeds:
        column = servo_change("rate_limit", servo, command, DT, (40.0, speed))
        expected.append(column @ missing / (column @ column) / (1.0 / speed - 1.0 / 40.0))
    assert limit_of_unit_gain(speeds, np.array(expected), np.ones(len(speeds))) == pytest.approx(
        limit, rel=0.1
    )
    assert limit_of_unit_gain(speeds, -np.array(expected), np.ones(len(speeds))) is None


def test_above_the_fastest_motion_every_limit_is_the_same():
    limited = data_with(40.0)
    outside = SelectedEffect(KEY, 1.0 / 500.0 - 1.0 / 40.0, 1e-4, -230.0, 1.0, 1.0, 0.0)
    (inside,) = clip_to_active_range(Selection((outside,)), limited).chosen
    # Where the command jumps a servo is faster than on the way from row to row.
    rows = limited.servos["elevator"].lag * limited.segments[0].at_commands().dt_s
    assert 1.0 / (inside.value + 1.0 / 40.0) == pytest.approx(
        fastest(limited) * rows / (1.0 - np.exp(-rows))
    )
    assert inside.t == pytest.approx(inside.value / 1e-4)
    below = SelectedEffect(KEY, 1.0 / 60.0 - 1.0 / 40.0, 1e-4, -80.0, 1.0, 1.0, 0.0)
    lag = SelectedEffect("effect/actuator.elevator/lag", -5.0, 1.0, -5.0, 1.0, 1.0, 0.0)
    assert clip_to_active_range(Selection((below, lag)), limited).chosen == (below, lag)


def test_a_limit_above_the_servos_own_is_known_by_its_slope_where_it_flies():
    rng = np.random.default_rng(4)
    complete, local, other = rng.standard_normal((3, 400, 1))
    value, noise = 1.0 / 80.0 - 1.0 / 40.0, rng.standard_normal((400, 1))

    def result(local: np.ndarray) -> SimpleNamespace:
        columns = {"other": 10.0 * other, KEY: 1e5 * complete, KEY + LOCAL_SLOPE: local}
        stacked = np.stack(list(columns.values()), axis=2)
        information = information_of(noise, stacked, tuple(columns)).without_values({KEY: value})
        return SimpleNamespace(
            information=information, free=("other", KEY), data=data_with(40.0), values={KEY: value}
        )

    choice = SelectedEffect(KEY, value, 1e-5, value / 1e-5, 1.0, 1.0, 0.0)
    (reference,) = with_local_rate_limits(Selection((choice,)), result(1e4 * local)).chosen
    A = np.column_stack([10.0 * other, 1e4 * local])
    step = np.linalg.lstsq(A, noise[:, 0], rcond=None)[0][1]
    assert reference.value == pytest.approx(value + step, rel=1e-4)
    assert reference.std == pytest.approx(np.sqrt(np.linalg.inv(A.T @ A)[1, 1]), rel=0.2)
    assert reference.t == choice.t
    assert not is_fastest(reference, data_with(40.0))
    # A limit of which the flights say nothing may be any number above.
    (silent,) = with_local_rate_limits(Selection((choice,)), result(0.0 * local)).chosen
    assert is_fastest(silent, data_with(40.0))


def test_only_limits_above_the_servos_own_have_a_slope_of_their_own():
    limit = Effect(None, "actuator.elevator", "rate_limit", "", "", unit="s/deg")
    lag = Effect(None, "actuator.elevator", "lag", "", "", unit="s")
    faster, slower = (SimpleNamespace(effects={limit.key: v, lag.key: -0.1}) for v in (-0.01, 0.01))
    assert [e.key for e in local_rate_limits([limit, lag], faster)] == [KEY + LOCAL_SLOPE]
    assert local_rate_limits([limit, lag], slower) == []


@pytest.mark.parametrize("width", [0.06, 0.3, 1.2])
def test_a_dead_zone_is_read_by_one_as_wide_as_it_is(width):
    request = 4.0 * np.sin(0.05 * np.arange(2000)) * np.linspace(0.0, 1.0, 2000)
    static = np.sign(request) * np.maximum(np.abs(request) - 0.5 * width, 0.0)
    missing = static - request
    estimates = []
    for one in WIDTHS_DEG:
        column = dead_zone_change(request, one)
        estimates.append(column @ missing / (column @ column))
    widths = np.array(WIDTHS_DEG)
    assert limit_of_unit_gain(
        widths, np.array(estimates) / widths, np.ones(len(widths))
    ) == pytest.approx(width, rel=0.1)
    # A column of one width for all makes another width of it.
    assert np.abs(np.array(estimates) / width - 1.0).max() > 0.08
    # One that stands in it already is short by half of what it is wider.
    wider = np.sign(request) * np.maximum(np.abs(request) - 0.5 * (width + 1e-3), 0.0)
    outside = np.abs(request) > 0.5 * (width + 1e-3)
    assert (1e-3 * dead_zone_change(static, 0.4, in_model=True))[outside] == pytest.approx(
        (wider - static)[outside], abs=1e-12
    )


def test_the_limit_is_the_one_of_which_the_flights_want_just_what_it_does():
    servo, h = Actuator(lag=25.0, rate=240.0), 0.02
    ramp = np.concatenate(
        [
            np.zeros(20),
            np.linspace(0.0, 9.6, 5),
            np.full(30, 9.6),
            np.linspace(9.6, -9.6, 9),
            np.full(30, -9.6),
        ]
    )
    before = servo.follow(ramp, h, 0.01)
    fastest = float(np.abs(np.diff(before)).max()) / h
    limits = np.array(SLOWER_SHARES) * fastest
    for true in (0.9 * fastest, 0.7 * fastest, 0.4 * fastest):
        hidden = Actuator(lag=25.0, rate=true).follow(ramp, h, 0.01) - before
        per_unit = [servo_change("rate_limit", servo, ramp, h, (240.0, x)) for x in limits]
        estimate = np.array([c @ hidden / (c @ c) for c in per_unit])
        t = np.array([c @ hidden / np.sqrt(c @ c) for c in per_unit])
        result = limit_of_unit_gain(limits, estimate / (1.0 / limits - 1.0 / 240.0), t)
        assert result == pytest.approx(true, rel=0.03)
    # One slope for all limits makes something else of a servo that is a little slow.
    hidden = Actuator(lag=25.0, rate=0.9 * fastest).follow(ramp, h, 0.01) - before
    clip_to_active_range = servo_change("rate_limit", servo, ramp, h)
    assert (
        abs(
            1.0
            / (
                clip_to_active_range @ hidden / (clip_to_active_range @ clip_to_active_range)
                + 1.0 / 240.0
            )
            / (0.9 * fastest)
            - 1.0
        )
        > 0.1
    )
    assert limit_of_unit_gain(limits, -np.ones(len(limits)), -np.ones(len(limits))) is None
    assert (
        limit_of_unit_gain(limits, np.full(len(limits), 0.1), np.arange(len(limits), 0.0, -1.0))
        == limits[0]
    )
    assert rate_limit_pair(servo, 1.0 / 80.0 - 1.0 / 240.0) == pytest.approx((80.0, 77.6))
    # Faster than the servo's own, where it may hardly be reached: back to the servo's own.
    assert rate_limit_pair(servo, 1.0 / 480.0 - 1.0 / 240.0) == pytest.approx((480.0, 240.0))


def test_a_servo_without_its_limit_is_seen_where_the_limit_acts_within_rows():
    """A jump of 16 deg: by the end of its row the surface has nearly caught up with a limit halfway
    between the servo's own and the fastest motion, so that halfway a third of the change is seen.
    """
    servo, h = Actuator(25.0, 240.0), 0.02
    command = np.repeat([0.0, 8.0, -8.0, 0.0], 30)
    slowness = 1.0 / 361.0 - 1.0 / 240.0
    flown, other = rate_limit_pair(servo, slowness)
    column = servo_change("rate_limit", servo, command, h, (flown, other))
    step = h / runs_per_row(h)
    free = replace(servo, rate=np.inf).follow(command, h, step)
    np.testing.assert_allclose(slowness * column, free - servo.follow(command, h, step), atol=1e-9)
    assert np.abs(slowness * column).max() > 0.1
