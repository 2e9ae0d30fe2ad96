"""A sensor is as its card says, or as quiet as it shows."""

from types import SimpleNamespace

import numpy as np
import pytest

from uqharness.identification.linearised import FlightData, Linearisation, Trajectory
from uqharness.refinement import base
from uqharness.refinement.base import as_quiet

OUTPUTS = ("alpha_rad", "p_radps")


@pytest.mark.parametrize(("left", "taken"), [(0.7, 0.7), (0.3, 0.5), (1.4, 1.0)])
def test_a_sensor_is_as_quiet_as_the_fit_leaves_it_down_to_half_its_card(monkeypatch, left, taken):
    card, seen = np.array([0.002, 0.004]), {}
    residual = left * card * np.random.default_rng(1).standard_normal((20_000, 2))
    residual[::5, 1] = np.nan
    setup = FlightData((), (), (), OUTPUTS, (residual[:5000], residual[5000:]), card, (), {})
    outputs = [np.zeros((5000, 2)), np.zeros((15_000, 2))]
    columns = [SimpleNamespace(names=("aero/a",))]
    fit = Linearisation(Trajectory(None, outputs, [], [], 1.0), [], [], columns, None, ())
    monkeypatch.setattr(
        base,
        "whiten",
        lambda steps, measured, columns, which, noise: seen.setdefault("white", [noise]),
    )
    monkeypatch.setattr(base, "gather", lambda white, names, group, prior: (white, names, group))
    quiet, again = as_quiet(setup, fit)
    assert quiet.noise == pytest.approx(taken * card, rel=0.02)
    assert again.flown.cost == pytest.approx(np.nansum((residual / quiet.noise) ** 2))
    assert again.evidence == ([quiet.noise], ("aero/a",), [0])
