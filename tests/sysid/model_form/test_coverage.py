"""Coverage verdicts at their limits, thirds of a state, conformal factors."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.model_form.coverage import bins, conformal, coverage, verdict
from sysid.model_form.fit import Design, FitOptions, fit_bounds
from sysid.model_form.model_form import AircraftReference, Filtering, ModelForm
from tests.helpers.residual_pieces import DT, HALF, filtered, first_order, residuals_of


@pytest.mark.parametrize(
    ("share", "error", "output"),
    [
        (0.898, 0.010, "fails"),  # its upper limit is 91.4 %
        (0.935, 0.010, "holds"),
        (0.933, 0.010, "fails"),
        (0.93, 0.024, "holds"),
        (0.93, 0.026, "inconclusive"),
        (0.97, 0.030, "inconclusive"),
        (0.84, 0.200, "fails"),
        (1.0, 0.0, "holds"),
        (float("nan"), 0.01, "fails"),
        (0.95, float("nan"), "inconclusive"),
    ],
)
def test_verdicts(share, error, output):
    assert verdict(share, error, 0.95) == output


def test_thirds_of_a_state():
    speeds = np.linspace(18.0, 27.0, 300)
    output = residuals_of([np.zeros(100)] * 3, states=[{"V_mps": v} for v in np.split(speeds, 3)])
    inside = [np.ones(100), np.ones(100), np.zeros(100)]
    result = bins(output, "V_mps", inside)
    assert [b.share for b in result] == [1.0, 1.0, 0.0]
    assert [b.n for b in result] == [100, 100, 100]
    assert (result[0].low, result[-1].high) == (18.0, 27.0)
    assert bins(output, "alpha_rad", inside) == ()


def test_a_further_manoeuvre_is_held_as_often_as_said():
    rng = np.random.default_rng(1)
    constant = []
    for _ in range(400):
        stretch = [np.abs(rng.standard_t(3)) * np.ones(5) for _ in range(20)]
        result = conformal(residuals_of([np.zeros(5)] * 19).pieces, stretch[:19])
        constant.append(stretch[19][0] <= result.factor)
    assert result.level == pytest.approx(0.95)
    assert np.mean(constant) == pytest.approx(0.95, abs=0.035)


def shaken(seed: int, vibration: float):
    """Residuals with a slow model error, sensor noise, and a vibration of 4 Hz that no sensor's
    white noise has.
    """
    rng = np.random.default_rng(seed)
    series = []
    for _ in range(12):
        n = 500 + 2 * HALF
        wave = np.sin(2.0 * np.pi * 4.0 * DT * np.arange(n) + 6.3 * rng.random())
        error = 0.01 * first_order(n, 0.5, rng) + 0.003 * rng.standard_normal()
        series.append(filtered(error + vibration * wave + 0.01 * rng.standard_normal(n)))
    return residuals_of(series)


@pytest.mark.parametrize("vibration", [0.0, 0.04])
def test_motion_is_judged_whatever_shakes_the_sensors(vibration):
    designs, options = {"CX": Design(("V_mps",), order=0)}, FitOptions()
    bounds = fit_bounds(shaken(1, vibration), designs, options)["CX"].bounds
    form = ModelForm(
        AircraftReference("a", ""), (), Filtering(6.0, 2.0, 0.5, 50.0), 0.95, "grow", {"CX": bounds}
    )
    share = coverage(form, shaken(2, vibration))["CX"].share[0.95]
    assert 0.93 < share < 0.99
