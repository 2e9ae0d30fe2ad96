"""Noise of outputs with dropouts, against normal densities; noise sizes from spectra."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from sysid.estimation.noise import PRIOR_STD, concentrated_cost, noise_size, residual_noise

COV = np.array([[4.0, 1.5, 0.0], [1.5, 1.0, -0.3], [0.0, -0.3, 0.25]])


def residuals(n: int = 400) -> np.ndarray:
    """(n, 3) of covariance COV; every seventh sample lacks the second output, every
    eleventh all.
    """
    v = np.random.default_rng(0).multivariate_normal(np.zeros(3), COV, n)
    v[::7, 1] = np.nan
    v[::11] = np.nan
    return v


def log_likelihood(v: np.ndarray, cov: np.ndarray) -> float:
    """Sample by sample over what is there, with the constant."""
    total = 0.0
    for row in v:
        observed = np.flatnonzero(np.isfinite(row))
        if observed.size:
            total += stats.multivariate_normal(
                np.zeros(observed.size), cov[np.ix_(observed, observed)]
            ).logpdf(row[observed])
    return total


@pytest.mark.parametrize("full", [False, True])
def test_the_cost_is_the_normal_likelihood(full):
    v = residuals()
    noise = residual_noise(v, np.full(3, 1e-9), full)
    present = np.isfinite(v).sum()
    expected = -log_likelihood(v, noise.cov) - 0.5 * present * (1.0 + np.log(2.0 * np.pi))
    assert concentrated_cost(v, noise) == pytest.approx(expected, rel=1e-9)


def test_the_diagonal_noise_is_the_likeliest():
    v = residuals()
    best = residual_noise(v, np.full(3, 1e-9), False)
    assert np.diagonal(best.cov) == pytest.approx(np.nanmean(v**2, axis=0))
    for change in (0.9, 1.1):
        assert log_likelihood(v, change * best.cov) < log_likelihood(v, best.cov)
    # Degrees of freedom spent make it larger; an exact fit is believed down to the floor.
    spent = residual_noise(v, np.full(3, 1e-9), False, np.array([100.0, 0.0, 0.0]))
    count = np.isfinite(v[:, 0]).sum()
    assert spent.cov[0, 0] == pytest.approx(best.cov[0, 0] * count / (count - 100.0))
    assert np.diagonal(
        residual_noise(np.zeros((9, 3)), np.full(3, 0.1), False).cov
    ) == pytest.approx(0.01)


# White noise found beneath a signal, whatever the card says.

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
def test_noise_size_follows_the_samples_not_the_card(card):
    result = [noise_size(channel(seed, 0.05), DT, FROM, card) for seed in range(8)]
    assert np.mean([f.std for f in result]) == pytest.approx(0.05, rel=0.03)
    assert np.std([f.std for f in result]) < 2.0 * 0.05 * np.mean([f.relative_std for f in result])
    assert all(f.relative_std < 0.06 for f in result)


def test_noise_size_spread_is_its_error():
    """Where gusts hide the noise the spread says so, within a factor of three: the gusts' spectrum
    is a model too.
    """
    result = [noise_size(channel(seed, 0.02, gusts=0.3), DT, FROM, 0.02) for seed in range(12)]
    off = np.array([np.log(f.std / 0.02) / f.relative_std for f in result])
    assert np.sqrt(np.mean(off**2)) < 3.0
    steady = noise_size(channel(1, 0.02), DT, FROM, 0.02)
    assert np.mean([f.relative_std for f in result]) > 2.0 * steady.relative_std


def test_gusts_far_above_the_noise_leave_the_cards_figure():
    result = noise_size(channel(3, 0.0005, gusts=0.5), DT, FROM, 0.0005)
    assert result.std == pytest.approx(0.0005, rel=1.5)
    assert result.relative_std > 0.3


def test_noise_size_of_samples_that_tell_nothing():
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
