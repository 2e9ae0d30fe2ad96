"""Flights as fits take them: whose noise the card knows, and which channels no sensor measured."""

from types import SimpleNamespace

import numpy as np
import pytest

from uqharness.identification.linearised.flight_data import (
    estimated_channels,
    output_noise,
    with_card_noise,
    with_estimator_noise,
)

OUTPUTS = ("alpha_rad", "p_radps")


def data_of(estimates=()):
    record = SimpleNamespace(metadata=SimpleNamespace(estimates=estimates))
    other = SimpleNamespace(metadata=SimpleNamespace(estimates=()))
    flights = [SimpleNamespace(record=other), SimpleNamespace(record=record)]
    return SimpleNamespace(outputs=OUTPUTS, flights=flights, noise=np.array([0.002, 0.004]))


def test_channels_that_an_estimator_computed_are_known():
    assert estimated_channels(data_of(estimates=("alpha_rad", "h_m"))) == ("alpha_rad",)
    assert estimated_channels(data_of()) == ()


def test_noise_of_a_computed_channel_is_what_the_model_leaves_of_it():
    data = data_of(estimates=("alpha_rad",))
    assert with_estimator_noise(data, {"alpha_rad": 0.007, "p_radps": 0.02}).tolist() == [
        0.007,
        0.004,
    ]
    # A channel that shows less than its own noise keeps that, and so does one that was not fitted.
    assert with_estimator_noise(data, {"alpha_rad": 0.001, "p_radps": 0.02}).tolist() == [
        0.002,
        0.004,
    ]
    assert (
        with_estimator_noise(data, {}).tolist()
        == with_estimator_noise(data, {"alpha_rad": np.nan}).tolist()
        == [0.002, 0.004]
    )
    assert with_estimator_noise(data_of(), {"alpha_rad": 0.007}).tolist() == [0.002, 0.004]


def test_noise_is_known_by_samples_and_card():
    aircraft = SimpleNamespace(
        card=SimpleNamespace(
            sensors=SimpleNamespace(noise_std={"alpha_rad": 0.0017, "p_radps": 0.0035})
        )
    )
    data = np.array([0.001, 0.01]) * np.random.default_rng(0).standard_normal((8000, 2))
    assert output_noise(aircraft, [data[:3000], data[3000:]], OUTPUTS) == pytest.approx(
        [0.0017, 0.01], rel=0.05
    )


def test_in_gusts_the_card_speaks_of_sensors_alone(monkeypatch):
    monkeypatch.setattr(
        "uqharness.identification.linearised.flight_data.replace", lambda data, noise: noise
    )
    card = SimpleNamespace(
        sensors=SimpleNamespace(noise_std={"alpha_rad": 0.0017, "p_radps": 0.0035})
    )
    aircraft = SimpleNamespace(card=card)
    assert with_card_noise(aircraft, data_of(estimates=("alpha_rad",))).tolist() == [0.002, 0.0035]
    assert with_card_noise(aircraft, data_of()).tolist() == [0.0017, 0.0035]
