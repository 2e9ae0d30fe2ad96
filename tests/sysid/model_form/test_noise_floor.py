"""What noise alone does to residual coefficients."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.aerodynamics.coefficients import MassProperties
from sysid.aerodynamics.residuals import Cutoffs, Prediction
from sysid.aerodynamics.segmentation import Piece
from sysid.model_form.noise_floor import NOISY, floor_of, noise_floor, with_noise
from sysid.record import FlightRecord


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
    np.testing.assert_allclose(floor_of([first]), [3.0, 0.0])
    np.testing.assert_allclose(floor_of([first, second]), [np.sqrt(5.0), np.sqrt(2.0)])


def test_noise_is_what_the_filters_weights_make_of_it():
    """A flight at rest in the air, a model without coefficients: variances by the smoother's weights .1 .25 .3 .25 .1, by hand."""
    n, V, rho = 3000, 20.0, 1.225
    columns = {c: np.full(n, V if c == "V_mps" else 0.0) for c in NOISY} | {"time_s": 0.02 * np.arange(n)}
    record = FlightRecord(columns)
    mass = MassProperties(20.0, np.diag([5.0, 6.0, 10.0]), 1.97, 3.66, 0.53)

    def predict(record: FlightRecord, piece: Piece) -> Prediction:
        qbar = 0.5 * rho * record["V_mps"][piece.rows] ** 2
        zero = np.zeros((len(qbar), 3))
        return Prediction(np.zeros((len(qbar), 6)), zero, zero, qbar, mass, {})

    noise = {"ay_mps2": 0.16, "p_radps": 0.0035}
    found = noise_floor(record, [Piece("x", slice(0, n), 0.0, 0.02 * n)], predict, noise, (0, 0, 0), Cutoffs(), repeats=4)
    pressure = 0.5 * rho * V**2 * 1.97
    side = 20.0 * 0.16 * np.sqrt(0.3**2 + 2 * 0.25**2 + 2 * 0.1**2) / pressure
    roll = 5.0 * 0.0035 * np.sqrt(2 * (1 + 4)) / (10 * 0.02) / (pressure * 3.66)
    assert found[1] == pytest.approx(side, rel=0.04)
    assert found[3] == pytest.approx(roll, rel=0.04)
    assert np.all(found[[0, 2]] == 0.0)
