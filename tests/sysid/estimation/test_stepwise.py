"""stepwise: finds what is there, leaves out what is not, and says by which statistic."""

import numpy as np
import pytest
import statsmodels.api as sm
from scipy import signal

from sysid import stepwise


def candidates(rng, n=600):
    a, q, d = rng.normal(size=(3, n))
    return np.column_stack([np.ones(n), a, q, d, a**2, a * q, q**2, a**3])


def test_finds_the_terms_that_made_the_data():
    rng = np.random.default_rng(0)
    X = candidates(rng)
    y = X[:, [1, 3, 5]] @ [1.0, -0.5, 0.2] + 0.1 * rng.normal(size=len(X))
    found = stepwise(X, y, names=["1", "a", "q", "d", "a2", "aq", "q2", "a3"])
    assert found.selected == [1, 3, 5]
    assert found.names == ("a", "d", "aq")
    np.testing.assert_allclose(found.theta, [1.0, -0.5, 0.2], atol=5 * found.std.max())
    assert [step.action for step in found.history] == ["enter"] * 3 + ["stop"]
    assert all(step.effective_f > step.threshold for step in found.history[:-1])
    assert found.history[-1].effective_f < found.history[-1].threshold
    assert found.history[2].press < found.history[0].press
    assert found.history[2].pse < found.history[0].pse


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
    found = stepwise(X, a + b + 0.05 * rng.normal(size=500))
    assert found.selected == [1, 2]
    assert any(step.action == "remove" and step.index == 0 for step in found.history)


def test_pure_noise_selects_nothing_most_of_the_time():
    hits = 0
    for seed in range(60):
        rng = np.random.default_rng([3, seed])
        hits += bool(stepwise(candidates(rng, 300), rng.normal(size=300)).selected)
    assert hits <= 4


def test_colour_does_not_let_in_what_white_f_would():
    fooled, white = 0, 0
    for seed in range(20):
        rng = np.random.default_rng([4, seed])
        smooth = signal.lfilter([1.0], [1.0, -0.98], rng.normal(size=(1500, 5)), axis=0)
        found = stepwise(smooth[:, 1:], smooth[:, 0])
        fooled += bool(found.selected)
        white += found.history[0].partial_f > found.history[0].threshold
    assert white >= 15
    assert fooled <= 3


def test_collinear_candidates_and_repeated_runs():
    rng = np.random.default_rng(5)
    X = candidates(rng)
    X = np.column_stack([X, X[:, 1]])
    y = 2.0 * X[:, 1] + 0.1 * rng.normal(size=len(X))
    found = stepwise(X, y)
    assert found.selected == [1]
    again = stepwise(X, y)
    assert found.history == again.history
    assert stepwise(X, y, keep=[8]).selected == [8]


def test_bad_input_is_refused():
    with pytest.raises(ValueError, match="keep"):
        stepwise(np.ones((9, 2)), np.ones(9), keep=[2])
    with pytest.raises(ValueError, match="f_remove"):
        stepwise(np.ones((9, 2)), np.ones(9), f_enter=2.0, f_remove=3.0)
