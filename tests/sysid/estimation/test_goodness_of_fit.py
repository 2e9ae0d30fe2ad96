"""Measures of the distance between model and flight, on series whose values are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from sysid.estimation.goodness_of_fit import (
    channel_noise,
    largest_residuals,
    shows_process_noise,
    theil,
    time_shift,
    white_noise,
)


def test_gap_figures_of_known_series():
    rng = np.random.default_rng(3)
    t = np.arange(1000) * 0.02
    y = np.sin(2.0 * t)
    z = np.sin(2.0 * (t - 0.05)) + 0.02 * rng.standard_normal(t.size)
    shift = time_shift([z], [y], 0.02)
    assert shift.seconds == pytest.approx(0.05, abs=4 * shift.std)
    assert 1e-4 < shift.std < 2e-3
    assert white_noise([z]) == pytest.approx(0.02, rel=0.1)
    # Theil's U of a constant offset is all bias: U = d / (rms z + rms y).
    result = theil(y + 0.5, y)
    assert result.u == pytest.approx(
        0.5 / (np.sqrt(np.mean((y + 0.5) ** 2)) + np.sqrt(np.mean(y**2)))
    )
    assert (result.bias, result.variance, result.covariance) == pytest.approx((1.0, 0.0, 0.0))
    gap = np.zeros(1000)
    gap[[100, 102, 500]] = [3.0, 2.9, -5.0]
    assert largest_residuals(gap, t, 1.0, 2, 0.5) == [(t[500], -5.0), (t[100], 3.0)]


def test_noise_shows_in_third_differences_and_motion_does_not():
    rng = np.random.default_rng(4)
    t = np.arange(4000) * 0.02
    motion = 3.0 * t**2 - t
    assert white_noise([motion]) < 1e-8
    noisy = motion + 0.3 * rng.standard_normal(t.size)
    assert white_noise([noisy[:1500], noisy[1500:]]) == pytest.approx(0.3, rel=0.06)
    # A few steps of a surface are no noise; seven samples tell nothing.
    assert white_noise([noisy + 50.0 * (t > 30.0)]) == pytest.approx(0.3, rel=0.06)
    assert np.isnan(white_noise([noisy[:7]]))


def test_the_cards_noise_counts_where_a_channel_looks_cleaner():
    rng = np.random.default_rng(5)
    block = np.column_stack([0.1 * rng.standard_normal(3000), 0.5 * rng.standard_normal(3000)])
    result = channel_noise([block], ("a", "b"), {"a": 0.3, "b": 0.2})
    assert result["a"] == 0.3
    assert result["b"] == pytest.approx(0.5, rel=0.06)
    empty = channel_noise([np.full((10, 1), np.nan)], ("a",), {})
    assert np.isnan(empty["a"])


def test_theils_shares_of_scale_and_of_a_shift_in_phase():
    rng = np.random.default_rng(6)
    y = rng.standard_normal(20_000)
    y = (y - y.mean()) / y.std()
    # Twice as large: the spreads differ, and nothing else.
    assert theil(2.0 * y, y).variance == pytest.approx(1.0)
    assert theil(y, -y).u == pytest.approx(1.0)
    wave = np.sin(2.0 * np.pi * np.arange(1000) / 100)
    assert theil(np.roll(wave, 25), wave).covariance == pytest.approx(1.0)
    assert theil(y, y).u == 0.0
    assert np.isnan(theil(np.full(3, np.nan), y[:3]).u)


def test_a_model_that_stands_still_shows_no_shift():
    z = np.random.default_rng(7).standard_normal(100)
    assert np.isnan(time_shift([z], [np.ones(100)], 0.02).seconds)
    # No further than asked for.
    t = np.arange(500) * 0.02
    assert time_shift(
        [np.sin(t - 0.5)], [np.sin(t)], 0.02, max_shift_s=0.1
    ).seconds == pytest.approx(0.1)


def residuals_and_motion(gusty, formed, waits):
    """Return residuals and motion, (500, 4) twice, and the sizes of the noise.

    Channels in ``gusty`` have coloured noise, with ``waits`` only while the motion lasts; those in
    ``formed`` have a function of the motion.
    """
    rng = np.random.default_rng(0)
    residual, motion = [], []
    for _ in range(2):
        busy = np.repeat([0.0, 1.0, 0.0, 1.0], 125)[:, None]
        y = lfilter([0.2], [1.0, -0.8], rng.normal(size=(500, 4)), axis=0) * (0.02 + busy)
        e = 0.1 * rng.normal(size=(500, 4))
        gusts = lfilter([0.3], [1.0, -0.9], rng.normal(size=(500, 4)), axis=0)
        e[:, gusty] += (gusts * (busy if waits else 1.0))[:, gusty]
        e[:, formed] += (y**2 + y)[:, formed]
        residual.append(e)
        motion.append(y)
    return residual, motion, np.full(4, 0.1)


@pytest.mark.parametrize(
    ("gusty", "formed", "waits", "turbulent"),
    [
        ([0, 1, 2, 3], [], False, True),
        ([0, 1, 2], [3], False, True),  # a wrong sensor does not hide turbulence
        ([0, 1], [3], False, True),
        ([0], [], False, True),
        ([0], [3], False, False),  # beside a wrong force, half of the channels must be gusty
        ([], [], False, False),
        ([], [0], False, False),
        ([0], [1, 2, 3], False, False),
        ([0, 1, 2, 3], [], True, False),  # what waits for manoeuvres is not the air
    ],
)
def test_turbulence_is_coloured_in_quiet_flight_too(gusty, formed, waits, turbulent):
    assert shows_process_noise(*residuals_and_motion(gusty, formed, waits)) is turbulent
