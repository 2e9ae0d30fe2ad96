"""Noise added once more."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.model_form.fit import noise_floor, with_noise


def test_noise_is_added_where_there_is_a_figure_for_it():
    channels = {c: np.full(20_000, 5.0) for c in ("a", "b", "c")}
    noisy = with_noise(channels, {"a": 0.5, "b": float("nan")}, np.random.default_rng(3))
    assert np.std(noisy["a"]) == pytest.approx(0.5, rel=0.02)
    assert np.mean(noisy["a"]) == pytest.approx(5.0, abs=0.02)
    assert noisy["b"] is channels["b"]
    assert noisy["c"] is channels["c"]
    assert np.all(channels["a"] == 5.0)
    again = with_noise(channels, {"a": 0.5}, np.random.default_rng(3))
    np.testing.assert_array_equal(again["a"], noisy["a"])


def test_a_floor_is_the_rms_over_experiments():
    first, second = np.array([[3.0, 0.0], [-3.0, 0.0]]), np.array([[1.0, 2.0], [1.0, 2.0]])
    np.testing.assert_allclose(noise_floor([first]), [3.0, 0.0])
    np.testing.assert_allclose(noise_floor([first, second]), [np.sqrt(5.0), np.sqrt(2.0)])
