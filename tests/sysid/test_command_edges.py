"""Steps of slowly logged commands: placed where they happened, and left alone where the gyro does not say."""

import numpy as np

from sysid.command_edges import logged_rows, place_steps

DT, STRIDE, NOISE = 0.02, 2, 0.0036


def flown(seed, size=6.0):
    """Command as carried out, as logged at 25 Hz, and a noisy rate that turns by 1.5 rad/s2 for 6 deg."""
    rng = np.random.default_rng(seed)
    acted = np.zeros(600)
    for at in np.arange(30, 570, 40) + rng.integers(0, 9, 14):
        acted[at:] = size * (acted[at - 1] == 0.0)
    logged = acted[(np.arange(600) // STRIDE) * STRIDE]
    rate = np.cumsum(np.concatenate([[0.0], acted[:-1]])) * 0.25 * DT
    rate -= 0.25 * size / 2 * DT * np.arange(600)
    return acted, logged, rate + NOISE * rng.standard_normal(600)


def test_steps_are_found_where_they_happened():
    right = total = 0
    for seed in range(10):
        acted, logged, rate = flown(seed)
        placed, moved = place_steps(logged, logged_rows(logged, STRIDE), rate, NOISE)
        assert moved > 0
        wrong = np.flatnonzero(placed != acted).size
        right, total = (
            right + np.flatnonzero(logged != acted).size - wrong,
            total + np.flatnonzero(logged != acted).size,
        )
    assert right > 0.8 * total


def test_without_a_kink_no_step_moves():
    for seed in range(10):
        _, logged, _ = flown(seed)
        still = NOISE * np.random.default_rng(seed).standard_normal(600)
        placed, moved = place_steps(logged, logged_rows(logged, STRIDE), still, NOISE)
        assert moved <= 1
        assert (placed == logged).mean() > 0.99


def test_a_command_logged_at_every_row_and_small_steps_stay():
    acted, logged, rate = flown(3)
    assert place_steps(acted, np.ones(600, dtype=bool), rate, NOISE)[1] == 0
    assert place_steps(logged / 10.0, logged_rows(logged, STRIDE), rate, NOISE)[1] == 0
