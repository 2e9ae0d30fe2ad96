"""Equation error and stepwise regression, against certified values, statsmodels and closed
forms.
"""

from __future__ import annotations

import numpy as np
import pytest
import statsmodels.api as sm
from scipy import signal

from sysid import equation_error, stepwise
from tests.reference import nist


def coloured(rng, n, a, sigma=1.0):
    return signal.lfilter([1.0], [1.0, -a], rng.normal(size=n + 200) * sigma)[200:]


def test_longley_certified():
    reg = equation_error(np.column_stack([np.ones(16), nist.LONGLEY.x]), nist.LONGLEY.y)
    np.testing.assert_allclose(reg.theta, nist.LONGLEY.values, rtol=1e-9)
    np.testing.assert_allclose(reg.std_white, nist.LONGLEY.std, rtol=1e-9)
    np.testing.assert_allclose(
        reg.std, nist.LONGLEY.std, rtol=1e-9
    )  # 16 samples: no colour is claimed
    assert np.sqrt(reg.s2) == pytest.approx(nist.LONGLEY.residual_std, rel=1e-9)
    assert reg.r2 == pytest.approx(nist.LONGLEY.r2, rel=1e-10)
    assert set(reg.status.values()) == {"identified"}
    assert any("near-collinear" in text for text in reg.warnings)


def test_filip_certified_where_normal_equations_fail():
    X = np.vander(nist.FILIP.x, 11, increasing=True)
    reg = equation_error(X, nist.FILIP.y)
    np.testing.assert_allclose(reg.theta, nist.FILIP.values, rtol=1e-6)
    np.testing.assert_allclose(reg.std_white, nist.FILIP.std, rtol=1e-6)
    assert reg.r2 == pytest.approx(nist.FILIP.r2, rel=1e-8)
    normal = np.linalg.lstsq(X.T @ X, X.T @ nist.FILIP.y, rcond=None)[0]
    assert not np.allclose(normal, nist.FILIP.values, rtol=1e-2)


def test_mean_of_a_first_order_series_in_closed_form():
    rng = np.random.default_rng(3)
    n, a = 50_000, 0.9
    reg = equation_error(np.ones((n, 1)), coloured(rng, n, a))
    # variance of the mean of an AR(1): sigma^2 / (n (1 - a)^2)
    assert reg.std[0] == pytest.approx(1.0 / (np.sqrt(n) * (1.0 - a)), rel=0.05)


def test_coverage_of_coloured_and_white_intervals():
    rng = np.random.default_rng(4)
    hits, white = 0, 0
    for _ in range(200):
        X = np.column_stack(
            [np.ones(1500), coloured(rng, 1500, 0.95), np.sin(np.arange(1500) * 0.05)]
        )
        reg = equation_error(X, X @ [1.0, 0.5, -2.0] + coloured(rng, 1500, 0.85))
        hits += int(np.sum(np.abs(reg.theta - [1.0, 0.5, -2.0]) < 1.96 * reg.std))
        white += int(np.sum(np.abs(reg.theta - [1.0, 0.5, -2.0]) < 1.96 * reg.std_white))
    assert 0.92 < hits / 600 < 0.98
    assert white / 600 < 0.6


def test_collinear_columns_are_named_and_the_rest_estimated():
    rng = np.random.default_rng(5)
    X = rng.normal(size=(200, 5))
    X[:, 4] = 2.0 * X[:, 0] - X[:, 1]
    X[:, 3] = 0.0
    y = X @ [1.0, 1.0, 3.0, 0.0, 0.0] + 0.1 * rng.normal(size=200)
    reg = equation_error(X, y, names=["a", "b", "c", "zero", "d"])
    assert reg.status == {
        "a": "not-identified",
        "b": "not-identified",
        "c": "identified",
        "zero": "not-identified",
        "d": "not-identified",
    }
    assert "b" in reg.reason["a"]
    assert "d" in reg.reason["a"]
    assert "zero" in reg.reason["zero"]
    assert np.isnan(reg.std[[0, 1, 3, 4]]).all()
    assert reg.theta[2] == pytest.approx(3.0, abs=5 * reg.std[2])
    X[:, 4] += 0.5 * rng.normal(size=200)
    assert equation_error(X, y, names=["a", "b", "c", "zero", "d"]).status["d"] == "identified"


@pytest.mark.parametrize(
    ("X", "y", "names", "output"),
    [
        (np.ones((5, 2)), np.ones(4), None, "rows"),
        (np.ones((2, 2)), np.ones(2), None, "more samples"),
        (np.ones((5, 1)), np.ones(5), ["a", "b"], "2 entries for 1"),
        (np.ones((5, 2)), np.ones(5), ["a", "a"], "repeats"),
        (np.array([[1.0], [np.nan], [2.0]]), np.ones(3), None, "first row 1"),
        (np.ones((3, 1)), np.array([1.0, np.inf, 1.0]), None, "NaN or infinity"),
        ([["x"], ["y"]], [1.0, 2.0], None, "numeric"),
    ],
)
def test_bad_input_is_refused(X, y, names, output):
    with pytest.raises(ValueError, match=output):
        equation_error(X, y, names=names)


# stepwise: finds what is there, leaves out what is not, and says by which statistic.


def candidates(rng, n=600):
    a, q, d = rng.normal(size=(3, n))
    return np.column_stack([np.ones(n), a, q, d, a**2, a * q, q**2, a**3])


def test_finds_the_terms_that_made_the_data():
    rng = np.random.default_rng(0)
    X = candidates(rng)
    y = X[:, [1, 3, 5]] @ [1.0, -0.5, 0.2] + 0.1 * rng.normal(size=len(X))
    result = stepwise(X, y, names=["1", "a", "q", "d", "a2", "aq", "q2", "a3"])
    assert result.selected == [1, 3, 5]
    assert result.names == ("a", "d", "aq")
    np.testing.assert_allclose(result.theta, [1.0, -0.5, 0.2], atol=5 * result.std.max())
    assert [step.action for step in result.history] == ["enter"] * 3 + ["stop"]
    assert all(step.effective_f > step.threshold for step in result.history[:-1])
    assert result.history[-1].effective_f < result.history[-1].threshold
    assert result.history[2].press < result.history[0].press
    assert result.history[2].pse < result.history[0].pse


def test_partial_f_is_that_of_statsmodels():
    rng = np.random.default_rng(1)
    X = candidates(rng)
    y = X[:, [1, 3]] @ [1.0, -0.5] + 0.1 * rng.normal(size=len(X))
    second = stepwise(X, y).history[1]
    small, large = sm.OLS(y, X[:, [1]]).fit(), sm.OLS(y, X[:, [1, 3]]).fit()
    assert second.partial_f == pytest.approx(large.compare_f_test(small)[0], rel=1e-9)
    assert second.press == pytest.approx(large.get_influence().ess_press, rel=1e-9)


def test_a_superseded_term_is_removed():
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, 500))
    X = np.column_stack([a + b + 0.3 * rng.normal(size=500), a, b])
    result = stepwise(X, a + b + 0.05 * rng.normal(size=500))
    assert result.selected == [1, 2]
    assert any(step.action == "remove" and step.index == 0 for step in result.history)


def test_pure_noise_selects_nothing_most_of_the_time():
    hits = 0
    for seed in range(60):
        rng = np.random.default_rng([3, seed])
        hits += bool(stepwise(candidates(rng, 300), rng.normal(size=300)).selected)
    assert hits <= 4


def test_collinear_candidates_and_repeated_runs():
    rng = np.random.default_rng(5)
    X = candidates(rng)
    X = np.column_stack([X, X[:, 1]])
    y = 2.0 * X[:, 1] + 0.1 * rng.normal(size=len(X))
    result = stepwise(X, y)
    assert result.selected == [1]
    repeat = stepwise(X, y)
    assert result.history == repeat.history
    assert stepwise(X, y, keep=[8]).selected == [8]
