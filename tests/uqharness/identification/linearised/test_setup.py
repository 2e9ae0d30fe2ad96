"""Flights as fits take them: whose noise the card knows, and which channels no sensor measured."""

from types import SimpleNamespace

import numpy as np

from uqharness.identification.linearised.setup import estimated_channels, setup_in_gusts

OUTPUTS = ("alpha_rad", "p_radps")


def setup_of(estimates=()):
    record = SimpleNamespace(metadata=SimpleNamespace(estimates=estimates))
    other = SimpleNamespace(metadata=SimpleNamespace(estimates=()))
    flights = [SimpleNamespace(record=other), SimpleNamespace(record=record)]
    return SimpleNamespace(outputs=OUTPUTS, flights=flights, noise=np.array([0.002, 0.004]))


def test_channels_that_an_estimator_computed_are_known():
    assert estimated_channels(setup_of(estimates=("alpha_rad", "h_m"))) == ("alpha_rad",)
    assert estimated_channels(setup_of()) == ()


def test_in_gusts_the_card_speaks_of_sensors_alone(monkeypatch):
    monkeypatch.setattr("uqharness.identification.linearised.setup.replace", lambda setup, noise: noise)
    card = SimpleNamespace(sensors=SimpleNamespace(noise_std={"alpha_rad": 0.0017, "p_radps": 0.0035}))
    aircraft = SimpleNamespace(card=card)
    assert setup_in_gusts(aircraft, setup_of(estimates=("alpha_rad",))).tolist() == [0.002, 0.0035]
    assert setup_in_gusts(aircraft, setup_of()).tolist() == [0.0017, 0.0035]
