"""What a log's estimator computed is as uncertain as the model leaves it; a sensor is as its card says, or as quiet as it shows."""

from types import SimpleNamespace

import numpy as np
import pytest

from uqharness.identification.linearised import Fit, Flown, Setup
from uqharness.refinement import base
from uqharness.refinement.base import as_quiet, noise_left

OUTPUTS = ("alpha_rad", "p_radps")


def setup_of(measured):
    return SimpleNamespace(outputs=OUTPUTS, measured=measured, noise=np.array([0.002, 0.004]))


def test_noise_of_a_computed_channel_is_what_the_model_leaves_of_it():
    rng = np.random.default_rng(0)
    residual = np.column_stack([0.01 * np.sin(0.05 * np.arange(4000)), 0.02 * rng.standard_normal(4000)])
    residual[::3, 0] = np.nan
    setup = setup_of([residual[:1000], residual[1000:]])
    flown = SimpleNamespace(outputs=[np.zeros((1000, 2)), np.zeros((3000, 2))])
    noise = noise_left(setup, flown, ["alpha_rad"])
    assert noise[0] == pytest.approx(0.01 / np.sqrt(2.0), rel=0.02)
    assert noise[1] == 0.004
    # A channel that shows less than its own noise keeps that.
    still = setup_of([0.01 * residual])
    assert noise_left(still, SimpleNamespace(outputs=[np.zeros((4000, 2))]), ["alpha_rad"])[0] == 0.002


@pytest.mark.parametrize(("left", "taken"), [(0.7, 0.7), (0.3, 0.5), (1.4, 1.0)])
def test_a_sensor_is_as_quiet_as_the_fit_leaves_it_down_to_half_its_card(monkeypatch, left, taken):
    card, seen = np.array([0.002, 0.004]), {}
    residual = left * card * np.random.default_rng(1).standard_normal((20_000, 2))
    residual[::5, 1] = np.nan
    setup = Setup((), (), (), OUTPUTS, (residual[:5000], residual[5000:]), card, (), {})
    outputs = [np.zeros((5000, 2)), np.zeros((15_000, 2))]
    columns = [SimpleNamespace(names=("aero/a",))]
    fit = Fit(Flown(None, outputs, [], [], 1.0), [], [], columns, None, ())
    monkeypatch.setattr(base, "whiten", lambda steps, measured, columns, which, noise: seen.setdefault("white", [noise]))
    monkeypatch.setattr(base, "gather", lambda white, names, group, prior: (white, names, group))
    quiet, again = as_quiet(setup, fit)
    assert quiet.noise == pytest.approx(taken * card, rel=0.02)
    assert again.flown.cost == pytest.approx(np.nansum((residual / quiet.noise) ** 2))
    assert again.evidence == ([quiet.noise], ("aero/a",), [0])
