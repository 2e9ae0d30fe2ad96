"""Steps of slowly logged commands: placed where they happened, and left alone where the gyro does
not say.
"""

import numpy as np
import pytest

from sysid.logs.servo import logged_rows, place_steps
from tests.helpers.few import few

DT, STRIDE, NOISE = 0.02, 2, 0.0036


def flown(seed, size=6.0, late_s=0.0, dt=DT, stride=STRIDE):
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
    seen = np.interp(np.arange(n) * dt - late_s, np.arange(n * fine + 1) * h, rate)
    return acted, logged, seen + NOISE * rng.standard_normal(n)


@pytest.mark.parametrize(
    ("late_s", "dt", "stride"),
    few([(0.0, 0.02, 2), (0.006, 0.02, 2), (0.011, 0.02, 2), (0.005, 0.005, 8)], 2),
)
def test_steps_are_found_where_they_happened(late_s, dt, stride):
    before = after = 0.0
    for seed in range(6):
        acted, logged, rate = flown(seed, late_s=late_s, dt=dt, stride=stride)
        found = place_steps(logged, logged_rows(logged, stride), rate, NOISE, dt)
        placed, moved = found.command, found.steps
        assert moved > 0
        before += np.abs(logged - acted).sum()
        after += np.abs(placed - acted).sum()
    assert after < 0.3 * before


def test_a_gyro_that_is_late_by_half_a_row_puts_no_step_on_the_wrong_side():
    acted, _, rate = flown(3, size=20.0, late_s=0.01)
    logged = acted[(np.arange(600) // STRIDE) * STRIDE]
    found = place_steps(logged, logged_rows(logged, STRIDE), rate, NOISE, DT)
    placed, _ = found.command, found.steps
    np.testing.assert_allclose(placed, acted, atol=1e-3)


def test_without_a_kink_a_step_is_where_it_is_expected():
    """Half-way, if nothing says in which of two rows it happened: the error of a guess is larger by
    the square root of two.
    """
    for seed in range(6):
        _, logged, _ = flown(seed)
        still = NOISE * np.random.default_rng(seed).standard_normal(600)
        found = place_steps(logged, logged_rows(logged, STRIDE), still, NOISE, DT)
        placed, sure = found.command, found.steps
        assert sure <= 2
        steps = np.flatnonzero(np.diff(logged)) + 1
        assert (
            abs(
                np.mean(
                    [placed[k - 1] - logged[k - 1] for k in steps]
                    / (logged[steps] - logged[steps - 1])
                )
                - 0.5
            )
            < 0.15
        )
        others = np.setdiff1d(np.arange(600), steps - 1)
        np.testing.assert_allclose(placed[others], logged[others], atol=1e-9)


def test_a_command_that_moves_all_the_time_goes_straight_between_logged_samples():
    acted = 8.0 * np.sin(0.08 * np.arange(601))
    logged = acted[(np.arange(601) // STRIDE) * STRIDE]
    rate = NOISE * np.random.default_rng(0).standard_normal(601)
    found = place_steps(logged, logged_rows(logged, STRIDE), rate, NOISE, DT)
    placed, sure = found.command, found.steps
    assert sure == 0
    assert np.abs(placed - acted).max() < 0.05 * np.abs(logged - acted).max()


def test_the_logger_need_not_be_regular():
    """Every other or every third row, by chance: what moves all the time is followed as well as its
    logged samples allow.
    """
    rng = np.random.default_rng(4)
    rows = np.cumsum(rng.integers(2, 4, 300))
    rows = np.concatenate([[0], rows[rows < 600], [600]])
    acted = 8.0 * np.sin(0.08 * np.arange(601))
    logged = acted[rows[np.searchsorted(rows, np.arange(601), side="right") - 1]]
    found = place_steps(logged, logged_rows(logged, 3), NOISE * rng.standard_normal(601), NOISE, DT)
    placed, _ = found.command, found.steps
    assert np.abs(placed - acted).max() < 0.05 * np.abs(logged - acted).max()


def test_a_command_logged_at_every_row_stays_and_small_steps_are_not_looked_for():
    acted, logged, rate = flown(3)
    found = place_steps(acted, np.ones(600, dtype=bool), rate, NOISE, DT)
    same, sure = found.command, found.steps
    assert sure == 0
    np.testing.assert_array_equal(same, acted)
    assert place_steps(logged / 10.0, logged_rows(logged, STRIDE), rate, NOISE, DT).steps == 0
