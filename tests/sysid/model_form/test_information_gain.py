"""Expected narrowing of intervals and choice of manoeuvres, against closed forms and
enumeration.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import stats

from sysid.model_form.information_gain import (
    Offer,
    asymptotic,
    belief,
    choose,
    expected_width,
    information,
    mean_power,
    parameter_variance,
    speed_power,
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
    current = bounds_from(x, 0.3 * x + 0.1 * rng.standard_normal(40), f=2.0)
    more = np.repeat([-3.0, 3.0], 10)
    previous = with_more_data(current, [information(current, {STATE: more})])
    at = np.array([-2.0, 0.0, 0.7, 5.0])
    pair = np.concatenate([x, more])
    for bounds, data in ((current, x), (previous, pair)):
        expected = (
            2.0
            * current.s2
            * (1.0 / len(data) + (at - data.mean()) ** 2 / np.sum((data - data.mean()) ** 2))
        )
        assert parameter_variance(bounds, {STATE: at}) == pytest.approx(expected, rel=1e-12)
    assert (previous.n, previous.n_effective, previous.dof) == (60, 30.0, 28.0)
    assert previous.t == pytest.approx(stats.t.ppf(0.975, 28.0))
    assert previous.hull.low[0] == -3.0
    # No more data, no change; endless data, no parameter part and the normal's quantile.
    assert with_more_data(current, []) is current
    ever = width(asymptotic(current), {STATE: at})
    assert ever.parameter == 0.0
    assert asymptotic(current).t == pytest.approx(1.959964, rel=1e-6)


@pytest.mark.parametrize("offset", [0.0, 0.8])
def test_the_expected_width_is_that_of_futures_played_out(offset):
    """Draw the truth from what is believed today, make the second flight's data from it, fit both,
    measure: the mean over futures.

    With an offset the bounds are stretched to hold zero, and the width depends on what will be
    found."""
    rng = np.random.default_rng(3)
    sigma = 0.4
    x, z = rng.uniform(-1.0, 1.0, 60), rng.uniform(1.0, 3.0, 200)
    current = bounds_from(x, offset + 0.2 * x + sigma * rng.standard_normal(60))
    at = {STATE: np.linspace(0.0, 3.0, 15)}
    previous = with_more_data(current, [information(current, {STATE: z})])
    predicted = expected_width(current, previous, at, draws=2000)
    X, Z, A = (np.column_stack([np.ones(len(v)), v]) for v in (x, z, at[STATE]))
    mean, covariance = belief(current)
    root = np.linalg.cholesky(covariance)
    C = np.linalg.inv(X.T @ X + Z.T @ Z)
    half = stats.t.ppf(0.975, 258) * np.sqrt(current.s2 * (1.0 + np.einsum("ni,ij,nj->n", A, C, A)))
    result = []
    for _ in range(3000):
        truth = mean + root @ rng.standard_normal(2)
        second = Z @ truth + np.sqrt(current.s2) * rng.standard_normal(200)
        beta = C @ (X.T @ X @ current.beta_hat + Z.T @ second)
        y = A @ beta
        result.append(np.mean(np.maximum(y + half, 0.0) - np.minimum(y - half, 0.0)))
    error = np.std(result) / np.sqrt(len(result))
    assert predicted.total == pytest.approx(
        np.mean(result), abs=max(4.0 * error, 0.002 * predicted.total)
    )
    if offset:
        # The stretched part is there: half-widths alone would be less.
        assert predicted.total > 1.1 * np.mean(2.0 * half)


def test_scatter_falls_with_speed_as_it_was_made_to():
    rng = np.random.default_rng(7)
    speeds = rng.uniform(18.0, 25.0, 60)
    variances = 3.0 * speeds**-4.0 * np.exp(0.1 * rng.standard_normal(60))
    assert speed_power(speeds, variances, np.full(60, 200.0)) == pytest.approx(-4.0, abs=0.5)
    # Speeds that do not differ, or variances that follow nothing, tell no power.
    assert speed_power(np.full(60, 22.0), variances, np.full(60, 200.0)) == 0.0
    assert speed_power(speeds, np.exp(3.0 * rng.standard_normal(60)), np.full(60, 200.0)) == 0.0
    symmetric = rng.uniform(18.0, 25.0, 200_000)
    middle = np.quantile(symmetric, [0.25, 0.5, 0.75])
    assert mean_power(middle, 18.0, 25.0, -4.0) == pytest.approx(np.mean(symmetric**-4.0), rel=2e-3)


# Which manoeuvres to fly: against every set that could be flown, and a budget of seconds.

FLIGHT_CHOICE_STATE = "alpha_rad"


def test_the_choice_is_the_best_set_where_all_sets_can_be_tried():
    rng = np.random.default_rng(5)
    x = rng.normal(0.0, 0.5, 80)
    current = bounds_from(x, rng.standard_normal(80), order=2)
    mission = {FLIGHT_CHOICE_STATE: rng.normal(2.0, 0.2, 300)}
    places = (-2.0, 0.0, 1.0, 2.0, 3.0)
    offers = [
        Offer(
            str(p),
            10.0,
            information(current, {FLIGHT_CHOICE_STATE: p + 0.1 * rng.standard_normal(50)}),
        )
        for p in places
    ]
    chosen = choose(current, offers, mission, 30.0, 0.0)
    assert [c.seconds for c in chosen] == [10.0, 10.0, 10.0]
    halves = {
        s: float(
            np.mean(
                with_more_data(current, [offers[k].information for k in s]).interval(mission)[1]
                - with_more_data(current, [offers[k].information for k in s]).interval(mission)[0]
            )
        )
        / 2.0
        for s in itertools.combinations_with_replacement(range(5), 3)
    }
    got = halves[tuple(sorted(c.index for c in chosen))]
    assert chosen[-1].half_width == pytest.approx(got, rel=1e-9)
    assert got <= 1.01 * min(halves.values())
    assert got < 0.9 * halves[(1, 1, 1)]
