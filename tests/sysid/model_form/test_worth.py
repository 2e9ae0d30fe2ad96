"""What more data would do to an interval: closed forms, a brute-force repetition of the future, and
an exhaustive choice.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from sysid.aerodynamics.coefficients import full_polynomial, regressors
from sysid.model_form.information_gain import (
    asymptotic,
    belief,
    expected_width,
    information,
    mean_power,
    parameter_variance,
    speed_power,
    weighted_quartiles,
    width,
    with_more_data,
)
from tests.helpers.model_forms import bounds_from

STATE = "alpha_rad"


def test_a_straight_line_follows_the_textbook():
    """s2 (1/n + (x - mean)^2/Sxx) of a line, before and after points are added at both ends (Draper
    and Smith, ch. 1).
    """
    rng = np.random.default_rng(1)
    x = np.linspace(-1.0, 1.0, 40)
    now = bounds_from(x, 0.3 * x + 0.1 * rng.standard_normal(40), f=2.0)
    more = np.repeat([-3.0, 3.0], 10)
    then = with_more_data(now, [information(now, {STATE: more})])
    at = np.array([-2.0, 0.0, 0.7, 5.0])
    both = np.concatenate([x, more])
    for bounds, data in ((now, x), (then, both)):
        expected = (
            2.0
            * now.s2
            * (1.0 / len(data) + (at - data.mean()) ** 2 / np.sum((data - data.mean()) ** 2))
        )
        assert parameter_variance(bounds, {STATE: at}) == pytest.approx(expected, rel=1e-12)
    assert (then.n, then.n_effective, then.dof) == (60, 30.0, 28.0)
    assert then.t == pytest.approx(stats.t.ppf(0.975, 28.0))
    assert then.hull.low[0] == -3.0
    # No more data, no change; endless data, no parameter part and the normal's quantile.
    assert with_more_data(now, []) is now
    ever = width(asymptotic(now), {STATE: at})
    assert ever.parameter == 0.0
    assert asymptotic(now).t == pytest.approx(1.959964, rel=1e-6)


def test_a_refit_of_both_data_sets_has_the_predicted_interval():
    """Second order in two states, other normalisation in the refit: the same functions, so the same
    variance.
    """
    rng = np.random.default_rng(2)
    names = ("V_mps", "alpha_rad")
    first, second = (
        rng.normal([21.0, 0.02], [1.0, 0.03], (300, 2)),
        rng.normal([24.0, 0.05], [0.5, 0.02], (200, 2)),
    )
    both = np.vstack([first, second])
    y = rng.standard_normal(500)
    now = bounds_from(first, y[:300], names, 2, centre=first.mean(axis=0), scale=first.std(axis=0))
    refit = bounds_from(both, y, names, 2, centre=both.mean(axis=0), scale=both.std(axis=0))
    then = with_more_data(now, [information(now, dict(zip(names, second.T, strict=True)))])
    at = dict(zip(names, rng.normal([23.0, 0.03], [1.0, 0.03], (50, 2)).T, strict=True))
    assert parameter_variance(then, at) / now.s2 == pytest.approx(
        parameter_variance(refit, at) / refit.s2, rel=1e-6
    )
    # Samples at twice the rate are worth half as much.
    twice = {name: np.repeat(v, 2) for name, v in zip(names, second.T, strict=True)}
    assert with_more_data(now, [information(now, twice, 0.5)]).XtX_inv == pytest.approx(
        then.XtX_inv, rel=1e-9
    )


@pytest.mark.parametrize("offset", [0.0, 0.8])
def test_the_expected_width_is_that_of_futures_played_out(offset):
    """Draw the truth from what is believed today, make the second flight's data from it, fit both,
    measure: the mean over futures.

    With an offset the bounds are stretched to hold zero, and the width depends on what will be
    found."""
    rng = np.random.default_rng(3)
    sigma = 0.4
    x, z = rng.uniform(-1.0, 1.0, 60), rng.uniform(1.0, 3.0, 200)
    now = bounds_from(x, offset + 0.2 * x + sigma * rng.standard_normal(60))
    at = {STATE: np.linspace(0.0, 3.0, 15)}
    then = with_more_data(now, [information(now, {STATE: z})])
    predicted = expected_width(now, then, at, draws=2000)
    X, Z, A = (np.column_stack([np.ones(len(v)), v]) for v in (x, z, at[STATE]))
    mean, covariance = belief(now)
    root = np.linalg.cholesky(covariance)
    C = np.linalg.inv(X.T @ X + Z.T @ Z)
    half = stats.t.ppf(0.975, 258) * np.sqrt(now.s2 * (1.0 + np.einsum("ni,ij,nj->n", A, C, A)))
    found = []
    for _ in range(3000):
        truth = mean + root @ rng.standard_normal(2)
        second = Z @ truth + np.sqrt(now.s2) * rng.standard_normal(200)
        beta = C @ (X.T @ X @ now.beta_hat + Z.T @ second)
        y = A @ beta
        found.append(np.mean(np.maximum(y + half, 0.0) - np.minimum(y - half, 0.0)))
    error = np.std(found) / np.sqrt(len(found))
    assert predicted.total == pytest.approx(
        np.mean(found), abs=max(4.0 * error, 0.002 * predicted.total)
    )
    if offset:
        # The stretched part is there: half-widths alone would be less.
        assert predicted.total > 1.1 * np.mean(2.0 * half)


def test_what_is_believed_of_terms_is_nearer_to_them_than_their_estimates():
    """Terms of one size, estimated here well and there badly: shrinking beats the estimates, and
    the spread is honest.
    """
    rng = np.random.default_rng(9)
    size, terms = 0.1, full_polynomial(3, 2)
    states = ("V_mps", "alpha_rad", "q_radps")
    error = believed = inside = 0.0
    for _ in range(60):
        x = rng.standard_normal((14, 3)) * [1.0, 1.0, 0.2]
        beta = size * rng.standard_normal(len(terms))
        now = bounds_from(x, regressors(x, terms) @ beta + 0.1 * rng.standard_normal(14), states, 2)
        now = replace(now, s2=0.01)
        mean, covariance = belief(now)
        error += float(np.sum((now.beta_hat - beta) ** 2))
        believed += float(np.sum((mean - beta) ** 2))
        inside += float(np.mean(np.abs(mean - beta) < 1.96 * np.sqrt(np.diag(covariance)))) / 60
    assert believed < 0.1 * error
    assert believed / (60 * len(terms)) < size**2
    assert 0.85 < inside < 0.99


def test_well_known_terms_are_believed_as_estimated():
    rng = np.random.default_rng(10)
    x = rng.uniform(-1.0, 1.0, 5000)
    now = bounds_from(x, 0.5 + 0.3 * x + 0.05 * rng.standard_normal(5000))
    mean, covariance = belief(now)
    assert mean == pytest.approx(now.beta_hat, rel=1e-4)
    assert covariance == pytest.approx(now.s2 * now.XtX_inv, rel=1e-3, abs=1e-10)


def test_scatter_of_the_new_data_is_pooled():
    rng = np.random.default_rng(4)
    now = bounds_from(rng.uniform(-1.0, 1.0, 100), rng.standard_normal(100))
    more = [information(now, {STATE: rng.uniform(-1.0, 1.0, 300)})]
    assert with_more_data(now, more).s2 == now.s2
    assert with_more_data(now, more, 0.6).s2 == pytest.approx(now.s2 * (100 + 0.6 * 300) / 400)


def test_scatter_falls_with_speed_as_it_was_made_to():
    rng = np.random.default_rng(7)
    speeds = rng.uniform(18.0, 25.0, 60)
    variances = 3.0 * speeds**-4.0 * np.exp(0.1 * rng.standard_normal(60))
    assert speed_power(speeds, variances, np.full(60, 200.0)) == pytest.approx(-4.0, abs=0.5)
    # Speeds that do not differ, or variances that follow nothing, tell no power.
    assert speed_power(np.full(60, 22.0), variances, np.full(60, 200.0)) == 0.0
    assert speed_power(speeds, np.exp(3.0 * rng.standard_normal(60)), np.full(60, 200.0)) == 0.0
    even = rng.uniform(18.0, 25.0, 200_000)
    middle = np.quantile(even, [0.25, 0.5, 0.75])
    assert mean_power(middle, 18.0, 25.0, -4.0) == pytest.approx(np.mean(even**-4.0), rel=2e-3)


def test_weighted_quartiles():
    values = np.arange(1.0, 101.0)
    assert weighted_quartiles(values, np.ones(100)) == pytest.approx([25.0, 50.0, 75.0])
    assert weighted_quartiles(values, (values == 7.0).astype(float)) == pytest.approx(
        [7.0, 7.0, 7.0]
    )
    assert np.isnan(weighted_quartiles(values, np.zeros(100))).all()


def test_clamped_bounds_look_no_further_than_their_data():
    rng = np.random.default_rng(8)
    now = bounds_from(rng.uniform(-1.0, 1.0, 100), rng.standard_normal(100))
    far, edge = {STATE: np.array([4.0])}, {STATE: np.array([float(now.hull.high[0])])}
    assert parameter_variance(now, far, "clamp") == pytest.approx(parameter_variance(now, edge))
    # With data out there the clamp moves out too, and they count where they were taken.
    then = with_more_data(now, [information(now, {STATE: np.full(50, 4.0)})])
    assert parameter_variance(then, far, "clamp") == pytest.approx(parameter_variance(then, far))
    assert replace(then, hull=now.hull).hull.high[0] < 4.0
