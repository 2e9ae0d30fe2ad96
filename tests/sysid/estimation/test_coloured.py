"""The coloured covariance against brute force and closed forms."""

import numpy as np
import pytest
from scipy import linalg, signal

from sysid.estimation.coloured_residuals import (
    autocovariance,
    autoregression,
    coloured_information,
    ljung_box,
)


def test_biased_autocovariance_is_the_textbook_sum():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=50), rng.normal(size=30)
    found = autocovariance([a, b], 3)
    for lag in range(4):
        expected = (a[lag:] @ a[: 50 - lag] + b[lag:] @ b[: 30 - lag]) / 80.0
        assert found[lag] == pytest.approx(expected, rel=1e-12)


def test_levinson_finds_the_model_and_leaves_white_noise_alone():
    rng = np.random.default_rng(1)
    series = signal.lfilter([1.0], [1.0, -1.2, 0.5], rng.normal(size=40_000))
    model, variance = autoregression(autocovariance([series], 20), series.size)
    np.testing.assert_allclose(model[:2], [1.2, -0.5], atol=0.02)
    assert variance == pytest.approx(1.0, rel=0.03)
    white, _ = autoregression(autocovariance([rng.normal(size=4000)], 20), 4000)
    assert white.size == 0


def test_white_residuals_return_the_information_itself():
    rng = np.random.default_rng(2)
    S, v = rng.normal(size=(2000, 2, 3)), rng.normal(size=(2000, 2))
    v /= v.std(axis=0)
    flat = S.reshape(-1, 3)
    np.testing.assert_allclose(coloured_information([S], [v]), flat.T @ flat, rtol=2e-2, atol=60.0)


def test_double_sum_over_two_segments_by_brute_force():
    rng = np.random.default_rng(3)
    series = [
        signal.lfilter([1.0], [1.0, -0.8], rng.normal(size=(n, 1)), axis=0) for n in (500, 300)
    ]
    S = [np.cumsum(rng.normal(size=(n, 1, 2)), axis=0) for n in (500, 300)]
    model, variance = autoregression(autocovariance([part[:, 0] for part in series], 29), 800)
    impulse = signal.lfilter([1.0], np.concatenate(([1.0], -model)), np.eye(1, 2000)[0])
    lags = np.array([impulse[: 2000 - lag] @ impulse[lag:] for lag in range(500)]) * variance
    expected = sum(part[:, 0].T @ linalg.toeplitz(lags[: len(part)]) @ part[:, 0] for part in S)
    np.testing.assert_allclose(coloured_information(S, series), expected, rtol=1e-8)


def test_cross_coloured_outputs_by_monte_carlo():
    rng = np.random.default_rng(4)
    n = 1500
    S = np.stack(
        [np.sin(np.arange(n) * 0.02)[:, None], np.sin(np.arange(n) * 0.02 + 0.2)[:, None]], axis=1
    )
    sums, brackets, separate = [], [], []
    for _ in range(80):
        common = signal.lfilter([1.0], [1.0, -0.9], rng.normal(size=n + 100))
        v = np.column_stack([common[100:], common[95:-5]]) + rng.normal(size=(n, 2))
        sums.append(np.einsum("nak,na->k", S, v))
        brackets.append(coloured_information([S], [v])[0, 0])
        separate.append(sum(coloured_information([S[:, [c]]], [v[:, [c]]])[0, 0] for c in range(2)))
    true = np.mean(np.square(sums))
    assert np.mean(brackets) == pytest.approx(true, rel=0.35)
    assert np.mean(separate) < 0.7 * np.mean(brackets)


def test_ljung_box_level_and_power():
    rng = np.random.default_rng(5)
    p = np.array([ljung_box([rng.normal(size=400)], 20) for _ in range(300)])
    assert 0.02 < np.mean(p < 0.05) < 0.09
    assert ljung_box([signal.lfilter([1.0], [1.0, -0.4], rng.normal(size=400))], 20) < 1e-6
