"""Straight lines through all runs, against scipy's regression and statsmodels' robust standard
errors.
"""

from __future__ import annotations

import numpy as np
import pytest
import statsmodels.api as sm
from scipy import stats

from uqharness.sensitivity.measures import Z, box_area, reach_of_box, scatter
from uqharness.sensitivity.study import run_study

BOX = {"a": (0.0, 2.0), "b": (-1.0, 1.0)}


def scattered(model, **more):
    made = run_study(
        model, BOX, {"w": stats.norm(0.0, 1.0)}, samples=128, draws=8, methods=("scatter",)
    )
    return scatter(made, made.outputs["output"], **more), made


def test_slopes_are_those_of_a_regression_through_all_points():
    found, made = scattered(lambda a, b, w: 3.0 * a + b**3 + 0.3 * w)
    y, area = made.outputs["output"].sampled, box_area(made.outputs["output"].sampled)
    for i, name in enumerate("ab"):
        line = stats.linregress(np.repeat(made.theta[:, i], 8), y.ravel())
        assert found.details["slope"][i] == pytest.approx(line.slope)
        assert found.details["r2"][i] == pytest.approx(line.rvalue**2)
        assert found.indices[name].value == pytest.approx(2.0 * abs(line.slope) / area)
    assert found.details["r2_sum"] == pytest.approx(found.details["r2"].sum())


def test_the_interval_joins_the_robust_error_and_the_widths():
    found, made = scattered(lambda a, b, w: 3.0 * a + b**3 + 0.3 * w)
    y = made.outputs["output"].sampled
    area = box_area(y)
    fit = sm.OLS(y.mean(axis=1), sm.add_constant(made.theta[:, 0])).fit(cov_type="HC1")
    width = reach_of_box(lambda e, a: np.log(box_area(y[np.ix_(e, a)])), y.shape, 0)
    half = np.hypot(Z * fit.bse[1] * 2.0 / area, found.indices["a"].value * width)
    assert found.indices["a"].high - found.indices["a"].value == pytest.approx(half, rel=1e-6)


def test_lines_that_explain_and_lines_that_do_not():
    assert scattered(lambda a, b, w: 3.0 * a + b)[0].holds
    hidden = scattered(lambda a, b, w: 3.0 * a + b + 5.0 * w, intervals=False)[0]
    assert not hidden.holds
    assert "the means follow" in hidden.statement
    curved = scattered(lambda a, b, w: (a - 1.0) ** 2 + b**2)[0]
    assert not curved.holds
    assert "do not explain" in curved.statement
    # No slope is seen where chance makes as large a one.
    assert curved.indices["a"].low == 0.0


def test_without_width_there_is_no_share():
    assert np.isnan(scattered(lambda a, b, w: 1.0 + 0.0 * a)[0].indices["a"].value)
