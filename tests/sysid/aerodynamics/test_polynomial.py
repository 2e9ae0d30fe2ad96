"""Polynomial terms by name and their values, against powers written out."""

from __future__ import annotations

from math import comb

import numpy as np
import pytest

from sysid.aerodynamics.coefficients import (
    full_polynomial,
    parse_term,
    regressors,
    stack,
    term_name,
)

STATES = ("V_mps", "alpha_rad", "q_radps", "theta_rad")


def test_terms_by_name():
    terms = full_polynomial(4)
    assert len(terms) == 15
    assert [parse_term(term_name(t, STATES), STATES) for t in terms] == list(terms)
    assert parse_term("alpha_rad*alpha_rad", STATES) == parse_term("alpha_rad^2", STATES)
    for bad in ("beta_rad", "alpha_rad^9", "alpha_rad**2", "alpha_rad^0", ""):
        with pytest.raises(ValueError, match="term"):
            parse_term(bad, STATES)


@pytest.mark.parametrize(("count", "order"), [(1, 3), (2, 2), (3, 3), (4, 2)])
def test_a_full_polynomial_has_every_term_once(count, order):
    terms = full_polynomial(count, order)
    assert len(terms) == len(set(terms)) == comb(count + order, order)
    assert max(map(sum, terms)) == order
    assert [sum(t) for t in terms] == sorted(sum(t) for t in terms)


def test_values_are_products_of_powers():
    z = np.random.default_rng(0).standard_normal((20, 2))
    found = regressors(z, ((0, 0), (2, 1), (0, 3)))
    np.testing.assert_allclose(
        found, np.column_stack([np.ones(20), z[:, 0] ** 2 * z[:, 1], z[:, 1] ** 3])
    )
    # A polynomial's values come back by least squares on its terms, and not on fewer.
    terms = full_polynomial(2)
    y = 1.0 - z[:, 0] * z[:, 1] + 2.0 * z[:, 1] ** 2
    rest = [
        float(np.linalg.lstsq(regressors(z, t), y, rcond=None)[1][0]) for t in (terms, terms[:-1])
    ]
    assert rest[0] < 1e-20
    assert rest[1] > 1.0


def test_states_side_by_side():
    states = {"V_mps": np.array([20.0, 21.0]), "alpha_rad": np.array([0.1, 0.2])}
    assert stack(states, ("alpha_rad", "V_mps")).tolist() == [[0.1, 20.0], [0.2, 21.0]]
    assert stack({"V_mps": 20.0}, ("V_mps",)).shape == (1, 1)
    with pytest.raises(KeyError):
        stack(states, ("beta_rad",))
