"""How fast a model's error wanders: known sines and random walks."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.aerodynamics.residuals import Cutoffs, ResidualPiece, Residuals
from sysid.model_form.components import STEP_S, variation
from sysid.model_form.fit import Design, fit_bounds


def wandering(rate_hz: float, seconds: float = 200.0, f: float = 0.2) -> tuple[Residuals, float]:
    """A residual A sin(2 pi f t) beside a state that tells nothing of it, and the rms of
    its slope.
    """
    time = np.arange(0.0, seconds, 1.0 / rate_hz)
    y = 0.01 * np.sin(2 * np.pi * f * time)
    rng = np.random.default_rng(0)
    states = {"V_mps": 20.0 + rng.standard_normal(len(time))}
    piece = ResidualPiece("x", time, np.column_stack([y] * 6), states)
    return Residuals((piece,), 1.0 / rate_hz, Cutoffs()), 0.01 * 2 * np.pi * f / np.sqrt(2)


@pytest.mark.parametrize("rate_hz", [25.0, 50.0, 100.0])
def test_the_rate_of_variation_does_not_depend_on_the_recorders_rate(rate_hz):
    residuals, slope = wandering(rate_hz)
    bounds = fit_bounds(residuals, {"CZ": Design(("V_mps",), ((0,),))})["CZ"].bounds
    low, high = bounds.bounds(residuals.states)
    found = variation(residuals, "CZ", bounds, cutoff_hz=2.0)
    expected = slope * STEP_S / (high - low)[0]
    assert found.sigma == pytest.approx(expected, rel=0.03)
    assert found.rate == pytest.approx(expected / np.sqrt(0.02), rel=0.03)
    # A smooth signal is no random walk: over a tenfold step the rate comes out about root ten times
    # as large.
    assert found.lagged[0.1] / found.lagged[0.02] == pytest.approx(np.sqrt(5.0), rel=0.03)


def test_a_true_random_walks_rate_is_the_same_over_any_step_above_the_filters():
    rng = np.random.default_rng(2)
    time = 0.02 * np.arange(60_000)
    level = np.cumsum(0.012 * np.sqrt(0.02) * rng.standard_normal(len(time)))
    y = 0.02 * (level - level.mean())
    states = {"V_mps": 20.0 + rng.standard_normal(len(time))}
    residuals = Residuals(
        (ResidualPiece("x", time, np.column_stack([y] * 6), states),), 0.02, Cutoffs()
    )
    bounds = fit_bounds(residuals, {"CZ": Design(("V_mps",), ((0,),))})["CZ"].bounds
    low, high = bounds.bounds(residuals.states)
    found = variation(residuals, "CZ", bounds, cutoff_hz=10.0)
    width = (high - low)[0] / 0.02
    assert found.lagged[1.0] * width == pytest.approx(0.012, rel=0.1)
    assert found.lagged[0.5] / found.lagged[2.0] == pytest.approx(1.0, abs=0.15)


def test_too_short_for_the_low_pass_is_no_rate_and_not_zero():
    residuals, _ = wandering(50.0, seconds=2.0)
    bounds = fit_bounds(residuals, {"CZ": Design(("V_mps",), ((0,),))})["CZ"].bounds
    found = variation(residuals, "CZ", bounds, cutoff_hz=0.1)
    assert np.isnan(found.rate)
    assert len(found.increments) == 0
