"""Covariance under coloured residuals, against brute force and closed forms; its warnings."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg, signal

from sysid.estimation.coloured_residuals import (
    Colour,
    autocovariance,
    autoregression,
    colour_warnings,
    coloured_information,
    integral_time,
    ljung_box,
    sandwich_covariance,
)


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
    inverse, other = np.array([[2.0, 0.3], [0.3, 1.0], [2.3, 1.3]]), np.diag([0.0, 5.0])
    np.testing.assert_allclose(
        sandwich_covariance(S, series, inverse, other),
        inverse @ (expected + other) @ inverse.T,
        rtol=1e-8,
    )


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


# Samples that count as one, against first-order processes and the variance of means.


def test_integral_time_of_a_first_order_process_is_known():
    rng = np.random.default_rng(3)
    e = rng.standard_normal(40_000)
    series = e.copy()
    for k in range(1, len(series)):
        series[k] = 0.8 * series[k - 1] + e[k]
    assert integral_time([series]) == pytest.approx(9.0, rel=0.1)  # (1 + 0.8)/(1 - 0.8)
    assert integral_time([e]) == pytest.approx(1.0, abs=0.1)
    assert integral_time([np.zeros(50)]) == 1.0


# The warning on coloured residuals: when it is given, what it suspects, and that it is short.


def find(predictable=0.4, explained=np.nan, p_value=1e-30, outputs=6):
    """A colour alike in all outputs."""
    return Colour(*(np.full(outputs, value) for value in (p_value, predictable, 0.9, explained)))


@pytest.mark.parametrize(
    ("explained", "first"),
    [
        (0.9, "the model's form before"),
        (0.1, "process noise (turbulence) before"),
        (np.nan, "turbulence) or the model"),
    ],
)
def test_colour_warnings_name_the_likelier_cause_first(explained, first):
    (text,) = colour_warnings(
        find(explained=explained), np.full(3, 3.2), np.ones(3), "output error"
    )
    assert first in text
    assert "3.2 times" in text


@pytest.mark.parametrize(
    ("colour", "std"),
    [
        (find(p_value=0.5), 3.2),  # white
        (find(predictable=0.05), 1.1),  # too little colour to matter
        (find(), np.nan),  # no parameter identified
    ],
)
def test_no_warning(colour, std):
    assert colour_warnings(colour, np.full(3, std), np.ones(3), "output error") == []


def test_turbulence_that_another_test_ruled_out_is_not_suspected():
    for explained in (0.9, 0.1, np.nan):
        (text,) = colour_warnings(
            find(explained=explained), np.full(3, 3.2), np.ones(3), "output error", calm_air=True
        )
        assert "turbulence" not in text
        assert "filter error" not in text
        assert "the model's form" in text
