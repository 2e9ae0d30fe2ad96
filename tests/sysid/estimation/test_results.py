"""Identifiability against variance inflation of statsmodels and the pseudo-inverse;
correlations.
"""

from __future__ import annotations

import numpy as np
import pytest
import statsmodels.api as sm

from sysid.estimation.results import assess, correlation

NAMES = ("a", "b", "c", "d")


def regressors(seed: int = 0) -> np.ndarray:
    """(50, 4) of very unlike units."""
    return np.random.default_rng(seed).standard_normal((50, 4)) * [1.0, 1e6, 1e-5, 30.0]


def test_independent_parameters_are_all_identified():
    X = regressors()
    result = assess(X.T @ X, NAMES)
    assert result.identified.all()
    assert result.reason == ("",) * 4
    np.testing.assert_allclose(result.inverse, np.linalg.inv(X.T @ X), rtol=1e-8)
    # Of each regressor on the others, about zero, as no constant is among them.
    shares = [sm.OLS(X[:, k], np.delete(X, k, axis=1)).fit().rsquared for k in range(4)]
    assert result.vif == pytest.approx([1.0 / (1.0 - r) for r in shares], rel=1e-8)
    assert result.notes == ()


def test_collinear_parameters_name_each_other_and_the_rest_keep_theirs():
    X = regressors()
    X[:, 3] = 30.0 * X[:, 0]
    result = assess(X.T @ X, NAMES)
    assert result.identified.tolist() == [False, True, True, False]
    assert result.reason[0].startswith("collinear with d")
    assert result.reason[3].startswith("collinear with a")
    assert np.isinf(result.vif[[0, 3]]).all()
    remainder = X[:, [0, 1, 2]]
    expected = np.linalg.inv(remainder.T @ remainder)
    np.testing.assert_allclose(result.inverse[1:3, 1:3], expected[1:3, 1:3], rtol=1e-6)


def test_a_parameter_without_effect_says_so():
    X = regressors()
    X[:, 2] = 0.0
    result = assess(X.T @ X, NAMES)
    assert result.identified.tolist() == [True, True, False, True]
    assert result.reason[2] == "no effect on any output in these data"
    assert not assess(np.zeros((4, 4)), NAMES).identified.any()


@pytest.mark.parametrize(("difference", "noted"), [(1e-3, True), (0.3, False)])
def test_near_collinearity_is_a_note_and_no_refusal(difference, noted):
    X = regressors()
    X[:, 3] = 30.0 * (X[:, 0] + difference * X[:, 3] / 30.0)
    result = assess(X.T @ X, NAMES)
    assert result.identified.all()
    assert bool(result.notes) is noted
    if noted:
        assert "near-collinear: " in result.notes[0]
        assert {"a", "d"} == set(
            result.notes[0].removeprefix("near-collinear: ").split(" (")[0].split(", ")
        )


# What can be read off an estimator's records.


def test_correlations_of_samples_and_of_what_is_not_known():
    data = np.random.default_rng(0).standard_normal((50, 3)) @ np.array(
        [[1.0, 0.5, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 9.0]]
    )
    cov = np.cov(data.T)
    assert correlation(cov) == pytest.approx(np.corrcoef(data.T))
    cov[1] = cov[:, 1] = np.nan
    result = correlation(cov)
    assert np.isnan(result[1]).all()
    assert result[0, 2] == pytest.approx(np.corrcoef(data.T)[0, 2])
