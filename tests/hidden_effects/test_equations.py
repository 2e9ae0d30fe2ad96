"""Compiled equations and terms against Python's own arithmetic, and the air's motion against the
aeroplane's.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.hidden_effects import effects
from tests.hidden_effects.cases import SECOND
from tests.hidden_effects.catalogue import ENTRIES
from tests.hidden_effects.effects import Effect
from tests.hidden_effects.equations import STACK, VARIABLES, interpolated, run
from tests.hidden_effects.expressions import programme
from tests.hidden_effects.motion import Model, evaluate

COEFFICIENT_TERMS = sorted(
    {e.form or e.term for e in ENTRIES.values() if e.subject in effects.COEFFICIENTS}
)
UNNAMED = [
    "tanh((de-(-1.5))/0.9)",
    "maximum(p_hat-(-0.005),0)/0.02",
    "interp(beta,[-0.08,-0.04,0.0,0.04,0.08],[0.3,-0.9,0.1,0.8,-0.2])",
]


def of_lanes(form, observed):
    """Values of one term in lanes of their own, beside another that has a table."""
    reference = Effect("CX", "table", 1.0, "interp(beta,[-0.1,0.1],[0,1])")
    terms = Model([SECOND], [(reference, Effect("Cm", "term", 1.0, form))]).terms
    return np.array(
        [
            run(terms, terms.begins[1], terms.ends[1], column, np.zeros(STACK))
            for column in observed.T
        ]
    )


@pytest.mark.parametrize(
    "form", [*COEFFICIENT_TERMS, *UNNAMED, "-alpha/(1-beta)+sqrt(V_rel)", "where(beta<0,-de,+da)"]
)
def test_compiled_terms_are_pythons(form):
    rng = np.random.default_rng(4)
    observed = rng.normal(size=(len(VARIABLES), 40)) * 0.2
    observed[[VARIABLES.index(v) for v in ("de", "da", "dr")]] *= 30.0
    observed[VARIABLES.index("V_rel")] += 1.0
    observed[VARIABLES.index("t_s")] += 45.0
    expected = effects.value(form, dict(zip(VARIABLES, observed, strict=True)))
    np.testing.assert_allclose(of_lanes(form, observed), expected, rtol=1e-13, atol=1e-15)
    assert np.ptp(expected) > 0.0


def test_tables_hold_their_ends():
    tables = np.array([9.0, 3.0, -1.0, 0.0, 2.0, 5.0, 6.0, 4.0])
    at = [-3.0, -1.0, -0.5, 0.0, 1.0, 2.0, 7.0]
    assert [interpolated(tables, 1, v) for v in at] == list(np.interp(at, tables[2:5], tables[5:]))
    assert np.isnan(interpolated(tables, 1, np.nan))


@pytest.mark.parametrize(
    "form", ["alpha if beta else 1", "alpha//2", "tanh(alpha)(2)", "alpha == beta"]
)
def test_programme_refuses_what_no_term_may_contain(form):
    with pytest.raises(ValueError, match="nothing that a term may contain"):
        programme(form)


def test_programme_refuses_deep_terms():
    deep = "alpha"
    for _ in range(STACK):
        deep = f"beta+({deep})"
    with pytest.raises(ValueError, match="at most 16"):
        programme(deep)


@pytest.mark.slow
def test_air_that_moves_is_an_aeroplane_that_moves_the_other_way():
    rng = np.random.default_rng(8)
    x = rng.normal(size=(12, 5)) * np.array([2, 2, 2, 0.3, 0.3, 0.3, 0.3, 0.3, 1, 9, 9, 9])[:, None]
    x[0] += 22.0
    s = np.full((4, 5), 2.0)
    s[3] = 55.0
    wind = rng.normal(size=(3, 5))
    model = Model([SECOND] * 5, [(Effect("Cm", "alpha*beta", 0.3),)] * 5)
    calm = evaluate(model, x, s, None)
    # North, east and down of the wind from the heading's axes, then into the body: both matrices by
    # successive turns.
    moved = x.copy()
    for lane in range(5):
        phi, theta = x[6, lane], x[7, lane]
        pitch = np.array(
            [[np.cos(theta), 0, -np.sin(theta)], [0, 1, 0], [np.sin(theta), 0, np.cos(theta)]]
        )
        roll = np.array([[1, 0, 0], [0, np.cos(phi), np.sin(phi)], [0, -np.sin(phi), np.cos(phi)]])
        moved[:3, lane] += roll @ pitch @ wind[:, lane]
    windy = evaluate(model, moved, s, np.vstack([wind, np.zeros((3, 5))]))
    for name in ("V", "alpha", "beta", "felt"):
        np.testing.assert_allclose(
            getattr(windy, name), getattr(calm, name), rtol=1e-11, atol=1e-12
        )
    np.testing.assert_allclose(windy.dot[3:6], calm.dot[3:6], rtol=1e-10, atol=1e-12)
    assert np.abs(evaluate(model, moved, s, None).felt - calm.felt).max() > 0.1
