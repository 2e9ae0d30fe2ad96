"""equation_error against certified values, statsmodels and closed forms."""

import numpy as np
import pytest
import statsmodels.api as sm
from scipy import signal

from sysid import equation_error
from tests.reference import nist


def coloured(rng, n, a, sigma=1.0):
    return signal.lfilter([1.0], [1.0, -a], rng.normal(size=n + 200) * sigma)[200:]


def test_longley_certified():
    reg = equation_error(np.column_stack([np.ones(16), nist.LONGLEY_X]), nist.LONGLEY_Y)
    np.testing.assert_allclose(reg.theta, nist.LONGLEY, rtol=1e-9)
    np.testing.assert_allclose(reg.std_white, nist.LONGLEY_SD, rtol=1e-9)
    np.testing.assert_allclose(
        reg.std, nist.LONGLEY_SD, rtol=1e-9
    )  # 16 samples: no colour is claimed
    assert np.sqrt(reg.s2) == pytest.approx(nist.LONGLEY_RESIDUAL_SD, rel=1e-9)
    assert reg.r2 == pytest.approx(nist.LONGLEY_R2, rel=1e-10)
    assert set(reg.status.values()) == {"identified"}
    assert any("near-collinear" in text for text in reg.warnings)


def test_longley_digit_in_the_data_is_felt():
    X = np.column_stack([np.ones(16), nist.LONGLEY_X])
    X[0, 1] += 0.1
    assert not np.allclose(equation_error(X, nist.LONGLEY_Y).theta, nist.LONGLEY, rtol=1e-4)


def test_filip_certified_where_normal_equations_fail():
    X = np.vander(nist.FILIP_X, 11, increasing=True)
    reg = equation_error(X, nist.FILIP_Y)
    np.testing.assert_allclose(reg.theta, nist.FILIP, rtol=1e-6)
    np.testing.assert_allclose(reg.std_white, nist.FILIP_SD, rtol=1e-6)
    assert reg.r2 == pytest.approx(nist.FILIP_R2, rel=1e-8)
    normal = np.linalg.lstsq(X.T @ X, X.T @ nist.FILIP_Y, rcond=None)[0]
    assert not np.allclose(normal, nist.FILIP, rtol=1e-2)


def test_statsmodels_ols():
    rng = np.random.default_rng(1)
    X = np.column_stack([np.ones(300), rng.normal(size=(300, 3)) * [1.0, 1e-6, 1e5]])
    y = X @ [3.0, -1.0, 2e5, 1e-5] + 0.2 * rng.normal(size=300)
    ours, theirs = equation_error(X, y), sm.OLS(y, X).fit()
    np.testing.assert_allclose(ours.theta, theirs.params, rtol=1e-8)
    np.testing.assert_allclose(ours.std_white, theirs.bse, rtol=1e-8)
    assert ours.r2 == pytest.approx(theirs.rsquared)
    assert equation_error(X[:, 1:], y).r2 == pytest.approx(sm.OLS(y, X[:, 1:]).fit().rsquared)
    assert ours.warnings == []


def test_coloured_standard_errors_agree_with_hac_and_white_ones_do_not():
    rng = np.random.default_rng(2)
    n = 20_000
    X = np.column_stack([np.ones(n), coloured(rng, n, 0.9), rng.normal(size=n)])
    y = X @ [1.0, 2.0, 3.0] + coloured(rng, n, 0.8)
    reg = equation_error(X, y)
    hac = sm.OLS(y, X).fit(cov_type="HAC", cov_kwds={"maxlags": 120}).bse
    np.testing.assert_allclose(reg.std, hac, rtol=0.15)
    assert reg.std[0] > 2.5 * reg.std_white[0]
    assert any("coloured" in text for text in reg.warnings)


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


def test_segments_seek_no_correlation_across_joins():
    rng = np.random.default_rng(6)
    y = np.concatenate([coloured(rng, 400, 0.9), coloured(rng, 600, 0.9)])
    one, two = (
        equation_error(np.ones((1000, 1)), y),
        equation_error(np.ones((1000, 1)), y, segments=[400, 600]),
    )
    assert one.theta == pytest.approx(two.theta)
    assert one.std[0] != two.std[0]


@pytest.mark.parametrize(
    ("X", "y", "names", "said"),
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
def test_bad_input_is_refused(X, y, names, said):
    with pytest.raises(ValueError, match=said):
        equation_error(X, y, names=names)
