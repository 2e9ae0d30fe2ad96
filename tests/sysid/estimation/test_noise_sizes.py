"""White noise found beneath a signal, whatever the card says."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.estimation.noise import _SIGNALS, PRIOR_STD, _whittle_cost, noise_size

DT, FROM = 0.02, 6.0


def channel(seed, std, gusts=0.0, n=300, pieces=9):
    """Manoeuvres: a slow motion and a step now and then, gusts as a first-order process of 1 s, and
    white noise.
    """
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(pieces):
        t = DT * np.arange(n)
        x = np.sin(2 * t + 6 * rng.random()) + 0.3 * (t > 3.0) * (1 - np.exp(-(t - 3.0) / 0.2))
        gust = np.zeros(n)
        for k in range(1, n):
            gust[k] = 0.98 * gust[k - 1] + gusts * np.sqrt(1 - 0.98**2) * rng.standard_normal()
        out.append(x + gust + std * rng.standard_normal(n))
    return out


@pytest.mark.parametrize("card", [0.05, 0.1, 0.025, None])
def test_the_samples_decide_whatever_the_card_says(card):
    found = [noise_size(channel(seed, 0.05), DT, FROM, card) for seed in range(8)]
    assert np.mean([f.std for f in found]) == pytest.approx(0.05, rel=0.03)
    assert np.std([f.std for f in found]) < 2.0 * 0.05 * np.mean([f.relative_std for f in found])
    assert all(f.relative_std < 0.06 for f in found)


def test_the_spread_is_as_large_as_the_error():
    """Where gusts hide the noise the spread says so, within a factor of three: the gusts' spectrum
    is a model too.
    """
    found = [noise_size(channel(seed, 0.02, gusts=0.3), DT, FROM, 0.02) for seed in range(12)]
    off = np.array([np.log(f.std / 0.02) / f.relative_std for f in found])
    assert np.sqrt(np.mean(off**2)) < 3.0
    still = noise_size(channel(1, 0.02), DT, FROM, 0.02)
    assert np.mean([f.relative_std for f in found]) > 2.0 * still.relative_std


def test_gusts_far_above_the_noise_leave_the_cards_figure():
    found = noise_size(channel(3, 0.0005, gusts=0.5), DT, FROM, 0.0005)
    assert found.std == pytest.approx(0.0005, rel=1.5)
    assert found.relative_std > 0.3


def test_what_tells_nothing():
    short = [np.random.default_rng(1).standard_normal(20)]
    assert noise_size(short, DT, FROM) is None
    assert noise_size(short, DT, FROM, 0.3) is not None
    assert (
        noise_size(short, DT, FROM, 0.3).std,
        noise_size(short, DT, FROM, 0.3).relative_std,
    ) == (
        0.3,
        PRIOR_STD,
    )
    # A channel that stands still, or is logged without noise, shows none; the card may know of a
    # sensor behind it.
    assert noise_size([np.ones(500)], DT, FROM) is None
    assert noise_size([np.ones(500)], DT, FROM, float("nan")) is None
    # A sampling rate that reaches no frequency above the signal's.
    assert noise_size(channel(1, 0.05), 0.1, FROM) is None


@pytest.mark.parametrize("scale", [1e-20, 1.0, 1e20])
@pytest.mark.parametrize("n", [1, 8, 150])
def test_logarithms_of_products_are_those_of_each_variance(scale, n):
    rng = np.random.default_rng(n)
    power, shape, square = (
        scale * rng.exponential(size=n),
        1.0 + rng.random(n),
        scale * np.logspace(-4, 1, 30),
    )
    for some in (power, np.zeros(n)):
        variance = (_SIGNALS * some.mean())[None, :, None] + square[:, None, None] * shape
        written_out = np.sum(np.log(variance) + some / variance, axis=2)
        np.testing.assert_allclose(
            _whittle_cost(some, shape, square, scale), written_out, rtol=1e-12, atol=1e-9
        )
    assert not np.allclose(
        _whittle_cost(power, shape, 1.01 * square, scale),
        _whittle_cost(power, shape, square, scale),
        rtol=1e-12,
        atol=1e-9,
    )


def test_a_piece_that_stands_still_among_others_says_that_there_is_no_noise():
    noisy = channel(4, 0.05)
    assert noise_size([*noisy, np.ones(300)], DT, FROM).std < 0.1 * noise_size(noisy, DT, FROM).std
