"""What is named beside something that nothing explains, and what flights leave."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from sysid.effects.selection import SelectedEffect
from uqharness.refinement.estimators import PredictionErrorEstimator, ReplayEstimator
from uqharness.refinement.evaluation import Excess, excess_residuals
from uqharness.refinement.unclear_effects import too_weak

LIMIT = 4.0


def chosen(**t):
    return tuple(SelectedEffect(k, v / 10.0, 0.1, v, v * v, 30.0, 0.0) for k, v in t.items())


@pytest.mark.parametrize(
    ("t", "weak"),
    [
        ({}, []),
        ({"a": 5.0}, ["a"]),
        ({"a": -5.9}, ["a"]),
        ({"a": 6.9}, ["a"]),
        ({"a": 7.1}, []),
        ({"a": 28.0, "b": 8.5, "c": -7.1}, ["b", "c"]),
        ({"a": -28.0, "b": -14.0}, []),
        ({"a": 142.0, "b": -29.0}, []),
        ({"a": 142.0, "b": 14.0}, ["b"]),
        ({"a": 8.0, "b": 5.0}, ["b"]),
    ],
)
def test_what_is_too_weak(t, weak):
    assert [c.key for c in too_weak(chosen(**t), LIMIT)] == weak


def test_an_effect_that_is_no_number_is_too_weak():
    assert too_weak(chosen(a=float("nan"), b=30.0), LIMIT)[0].key == "a"


def show(residual):
    noise = np.array([0.1, 0.2])
    rms = [
        float(np.sqrt(np.mean(np.concatenate([r[:, k] for r in residual]) ** 2))) for k in (0, 1)
    ]
    return SimpleNamespace(residual=residual, noise=noise, channel_rms=lambda k: rms[k])


def white(factor=1.0):
    rng = np.random.default_rng(3)
    return [np.array([0.1, 0.2]) * factor * rng.normal(size=(1000, 2)) for _ in range(2)]


SETUP = SimpleNamespace(outputs=("q_radps", "az_mps2"))
CALM, TURBULENT = ReplayEstimator(), PredictionErrorEstimator(None)  # type: ignore[arg-type]


def test_noise_leaves_nothing():
    remaining = excess_residuals(SETUP, show(white()), CALM)
    assert not remaining
    assert remaining == Excess({}, ())


def test_a_channel_above_its_noise_is_left_in_any_air():
    residual = [r * [1.0, 1.3] for r in white()]
    for estimator in (CALM, TURBULENT):
        remaining = excess_residuals(SETUP, show(residual), estimator)
        assert remaining
        assert remaining.above == {"az_mps2": pytest.approx(1.3, rel=0.03)}


def test_colour_counts_in_calm_air_alone():
    residual = [
        lfilter([0.8], [1.0, -0.6], r, axis=0) * [1.0, 0.0] + r * [0.0, 1.0] for r in white()
    ]
    assert excess_residuals(SETUP, show(residual), CALM) == Excess({}, ("q_radps",))
    assert not excess_residuals(SETUP, show(residual), TURBULENT)
