"""Polynomial terms by name and value, segments of records, and the helper equations."""

from __future__ import annotations

from math import comb

import numpy as np
import pytest

from sysid.aerodynamics.coefficients import (
    MassProperties,
    full_polynomial,
    parse_term,
    regressors,
    term_name,
)
from sysid.aerodynamics.residuals import as_logged, cut_pieces
from sysid.record import FlightRecord, Metadata
from tests.helpers.open_equations import OUTPUTS, OpenEquations
from tests.helpers.sixdof import TABLE_2_6, Airframe, derivative, isa_density, thrust

STATES = ("V_mps", "alpha_rad", "q_radps", "theta_rad")


def test_terms_by_name():
    terms = full_polynomial(4)
    assert len(terms) == 15
    assert [parse_term(term_name(t, STATES), STATES) for t in terms] == list(terms)
    assert parse_term("alpha_rad*alpha_rad", STATES) == parse_term("alpha_rad^2", STATES)
    for invalid in ("beta_rad", "alpha_rad^9", "alpha_rad**2", "alpha_rad^0", ""):
        with pytest.raises(ValueError, match="term"):
            parse_term(invalid, STATES)


@pytest.mark.parametrize(("count", "order"), [(1, 3), (2, 2), (3, 3), (4, 2)])
def test_a_full_polynomial_has_every_term_once(count, order):
    terms = full_polynomial(count, order)
    assert len(terms) == len(set(terms)) == comb(count + order, order)
    assert max(map(sum, terms)) == order
    assert [sum(t) for t in terms] == sorted(sum(t) for t in terms)


def test_values_are_products_of_powers():
    z = np.random.default_rng(0).standard_normal((20, 2))
    result = regressors(z, ((0, 0), (2, 1), (0, 3)))
    np.testing.assert_allclose(
        result, np.column_stack([np.ones(20), z[:, 0] ** 2 * z[:, 1], z[:, 1] ** 3])
    )
    # A polynomial's values come back by least squares on its terms, and not on fewer.
    terms = full_polynomial(2)
    y = 1.0 - z[:, 0] * z[:, 1] + 2.0 * z[:, 1] ** 2
    remainder = [
        float(np.linalg.lstsq(regressors(z, t), y, rcond=None)[1][0]) for t in (terms, terms[:-1])
    ]
    assert remainder[0] < 1e-20
    assert remainder[1] > 1.0


# The equations in the open against an independent set, and records cut into segments.

TERMS = tuple(f"aero/{n}" for n in TABLE_2_6)
BODY = Airframe()
MASS = MassProperties(
    BODY.m,
    np.array([[BODY.Ixx, 0, -BODY.Ixz], [0, BODY.Iyy, 0], [-BODY.Ixz, 0, BODY.Izz]]),
    BODY.S,
    BODY.b,
    BODY.c,
)


def test_rates_and_specific_force_are_those_of_the_independent_equations():
    rng = np.random.default_rng(2)
    equations = OpenEquations(TERMS, ("p_radps",), OUTPUTS, MASS, BODY.g)
    theta = np.array([*TABLE_2_6.values(), 0.01])
    for _ in range(20):
        V, alpha, beta = rng.uniform(15, 30), rng.uniform(-0.1, 0.2), rng.uniform(-0.1, 0.1)
        p, q, r, phi, pitch = rng.uniform(-0.5, 0.5, 5)
        de, da, dr, throttle = *rng.uniform(-5, 5, 3), rng.uniform(20, 80)
        velocity = V * np.array(
            [np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)]
        )
        state = np.array([*velocity, p, q, r, phi, pitch, 0.0, 0.0, 0.0, -100.0])
        rate = derivative(BODY, state, np.array([de, da, dr, throttle]))
        rho = isa_density(100.0)
        u = np.array([de, da, dr, thrust(throttle, V, rho), 0, 0, 0, 0, 0, rho, *np.zeros(6)])
        x = equations.start([V, alpha, beta, p, q, r, phi, pitch])
        result = np.array(equations.f(x, u, theta), dtype=float)
        np.testing.assert_allclose(result[3:8], [*rate[3:6], *rate[6:8]], rtol=1e-9, atol=1e-12)
        step = 1e-6
        after = velocity + step * rate[:3]
        V2 = np.linalg.norm(after)
        np.testing.assert_allclose(
            result[:3],
            [
                (V2 - V) / step,
                (np.arctan2(after[2], after[0]) - alpha) / step,
                (np.arcsin(after[1] / V2) - beta) / step,
            ],
            rtol=1e-4,
            atol=1e-5,
        )
        outputs = dict(zip(OUTPUTS, np.array(equations.g(x, u, theta), dtype=float), strict=True))
        assert outputs["p_radps"] == pytest.approx(p + 0.01)


def record(**columns):
    time = np.arange(0.0, 60.0, 0.02)
    base = {"time_s": time, "elevator_deg": np.zeros(time.size), "q_radps": np.zeros(time.size)}
    return FlightRecord({**base, **columns}, Metadata(native_hz={"q_radps": 10.0}))


def test_segments_are_manoeuvres_else_excitation_else_everything():
    time = np.arange(0.0, 60.0, 0.02)
    labels = np.where((time >= 10) & (time < 15), "doublet", "").astype(object)
    pieces, options = cut_pieces(record(manoeuvre=labels), ("q_radps",))
    assert [(p.label, round(p.start_s, 2), round(p.end_s, 2)) for p in pieces] == [
        ("doublet", 10.0, 14.98)
    ]
    assert "labelled" in options
    moved = np.where((time >= 20) & (time < 21), 5.0, 0.0)
    pieces, options = cut_pieces(record(elevator_deg=moved), ("q_radps",))
    assert len(pieces) == 1
    assert pieces[0].start_s == pytest.approx(19.0, abs=0.05)
    assert pieces[0].end_s == pytest.approx(24.0, abs=0.05)
    pieces, options = cut_pieces(record(), ("q_radps",), max_s=20.0)
    assert [p.rows.stop - p.rows.start for p in pieces] == [1000, 1000, 1000]
    gap = np.zeros(time.size)
    gap[1500] = np.nan
    pieces, _ = cut_pieces(record(q_radps=gap), ("q_radps",), max_s=100.0)
    assert [p.rows for p in pieces] == [slice(0, 1500), slice(1501, 3000)]


def test_a_slow_channel_counts_once_for_every_time_it_was_logged():
    values = as_logged(record(), "q_radps", slice(3, 103))
    assert np.isfinite(values).sum() == 20
    assert np.isfinite(as_logged(record(), "elevator_deg", slice(0, 100))).all()
