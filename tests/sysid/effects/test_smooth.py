"""Smooth terms: smoothing and band against independent formulas, coverage, chance, colour, and the
forms that are told.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline, make_smoothing_spline
from scipy.signal import lfilter
from scipy.stats import binom

from sysid.effects import WhitenedSegment, normal_equations
from sysid.effects.smooth import (
    colour_dispersion,
    fit_smooth,
    held_out_gain,
    similar_forms,
    smooth_term,
)
from sysid.effects.tuned import FAMILY_ERROR_RATE

N = 600
PARAMETERS = ("aero/Cm_0", "aero/Cm_alpha")


def states(seed=0, n=N):
    """Variables along a flight: alpha often near the middle of its range, q_hat and CT."""
    rng = np.random.default_rng(seed)
    return {
        "alpha": 0.05 + 0.03 * np.tanh(rng.normal(size=n)),
        "q_hat": rng.normal(size=n) / 100.0,
        "CT": rng.uniform(size=n),
    }


def evidence_of(found, remaining, terms, free=("1", "alpha"), parts=3):
    """Evidence of one channel in segments of equal length; left (n,): residual over noise; free:
    columns of the model.
    """
    columns = {"1": np.ones(len(remaining)), "alpha": found["alpha"]}
    rows = [columns[n] for n in free] + [row for t in terms for _, row in t.inputs(found).values()]
    names = [f"aero/Cm_{n}" for n in free] + [n for t in terms for n in t.columns]
    columns = np.column_stack(rows)
    white = []
    for part in np.array_split(np.arange(len(remaining)), parts):
        residual = remaining[part][:, None]
        present = np.ones(residual.shape, dtype=bool)
        white.append(
            WhitenedSegment(
                residual, columns[part][:, None, :], 0.0, np.zeros((8, 1)), present, np.ones(1)
            )
        )
    return normal_equations(white, names, range(parts), {}), [
        n for n in names if n.startswith("aero/")
    ]


def fitted(found, remaining, term, **more):
    evidence, free = evidence_of(found, remaining, [term], **more)
    return fit_smooth(evidence, free, [term])[0]


def bump(x):
    """Thirty standard deviations of noise high, a third of the range wide."""
    return 4.0 * np.exp(-(((x - 0.06) / 0.012) ** 2))


def without_line(x, y):
    return y - np.polyval(np.polyfit(x, y, 1), x)


def build(seed, curve=bump, found=None):
    found = states() if found is None else found
    return found, curve(found["alpha"]) + np.random.default_rng(seed).normal(
        size=len(found["alpha"])
    )


def test_the_curve_is_that_of_penalised_least_squares_and_nearly_scipys_smoothing_spline():
    result, y = build(1)
    x, term = result["alpha"], smooth_term("Cm", "alpha", None, result)
    fit = fitted(result, y, term)
    penalty = fit.precision[-1]
    # Least squares of y and of the second derivative by Simpson's rule, in B-splines.
    B, edges = BSpline.design_matrix(x, term.knots, 3).toarray(), term.knots[3:-3]
    places = np.linspace(edges[0], edges[-1], 20 * (len(edges) - 1) + 1)
    weight = np.ones(len(places))
    weight[1:-1:2], weight[2:-1:2] = 4.0, 2.0
    weight *= (places[1] - places[0]) / 3.0
    second = BSpline(term.knots, np.eye(B.shape[1]), 3).derivative(2)(
        np.clip(places, edges[0], edges[-1])
    )
    stacked = np.vstack([B, np.sqrt(penalty * weight)[:, None] * second])
    line = B @ np.linalg.lstsq(stacked, np.append(y, np.zeros(len(places))), rcond=None)[0]
    ours, _ = fit.curve(x)
    assert np.allclose(ours, without_line(x, line), atol=2e-3)
    # A knot at every sample instead of eleven.
    order = np.argsort(x)
    theirs = make_smoothing_spline(x[order], y[order], lam=penalty)(x)
    assert np.std(ours - without_line(x, theirs)) < 0.05 * np.std(ours)


def test_restricted_likelihood_band_and_degrees_of_freedom_are_the_bayesian_linear_models():
    result, y = build(2)
    term = smooth_term("Cm", "alpha", None, result)
    fit = fitted(result, y, term)
    X, Z = np.column_stack([np.ones(N), result["alpha"]]), term.at(result["alpha"])[:, 2:]

    def restricted(tau2):
        V = np.eye(N) + tau2 * Z @ Z.T
        W = np.linalg.inv(V)
        P = W - W @ X @ np.linalg.solve(X.T @ W @ X, X.T @ W)
        return -(np.linalg.slogdet(V)[1] + np.linalg.slogdet(X.T @ W @ X)[1] + y @ P @ y)

    tau2 = 1.0 / fit.precision[-1]
    assert fit.ratio == pytest.approx(restricted(tau2) - restricted(0.0), rel=1e-4)
    assert all(restricted(tau2) > restricted(f * tau2) for f in (0.3, 3.0))
    M = np.eye(N) - X @ np.linalg.pinv(X)
    cov = np.linalg.inv(Z.T @ M @ Z + np.eye(Z.shape[1]) / tau2)
    at = np.linspace(*term.ends, 7)
    value, std = fit.curve(at)
    assert np.allclose(value, term.at(at)[:, 2:] @ cov @ Z.T @ M @ y, rtol=1e-3, atol=1e-4)
    assert np.allclose(
        std,
        np.sqrt(np.einsum("nk,kj,nj->n", term.at(at)[:, 2:], cov, term.at(at)[:, 2:])),
        rtol=1e-3,
    )
    assert fit.edf == pytest.approx(np.trace(cov @ Z.T @ M @ Z), rel=1e-3)


def test_bands_hold_the_curve_as_often_as_they_say_and_a_part_of_them_does_not():
    result = states(3)
    term = smooth_term("Cm", "alpha", None, result)
    truth = without_line(result["alpha"], bump(result["alpha"]))
    inside, narrow = [], []
    for seed in range(60):
        _, y = build(100 + seed, found=result)
        value, std = fitted(result, y, term).curve(result["alpha"])
        inside.append(np.mean(np.abs(value - truth) < 1.96 * std))
        narrow.append(np.mean(np.abs(value - truth) < 0.5 * std))
    assert 0.91 < np.mean(inside) < 0.99
    assert np.mean(narrow) < 0.6


def test_noise_is_offered_a_term_no_more_often_than_stated_and_a_bump_always():
    rng, runs = np.random.default_rng(4), 300
    result = states(4)
    terms = [
        smooth_term("Cm", s, t, result)
        for s, t in (("alpha", None), ("q_hat", None), ("CT", None), ("alpha", "CT"))
    ]
    evidence, free = evidence_of(result, np.zeros(N), terms, parts=1)
    columns = evidence.white[0].columns[:, 0, :]
    offers = 0
    for _ in range(runs):
        noise = replace(evidence, score=(rng.normal(size=N) @ columns)[None, :])
        offers += any(f.stands_out(len(terms)) for f in fit_smooth(noise, free, terms))
    assert offers <= binom.ppf(0.999, runs, FAMILY_ERROR_RATE)
    result, y = build(5)
    assert fitted(result, y, smooth_term("Cm", "alpha", None, result)).p < 1e-10


def test_colour_takes_information_away():
    """A residual that lasts five samples: counted as white, the band is too narrow."""
    x = 0.05 + 0.03 * np.sin(np.arange(1500) / 40.0)
    result = states(6, 1500) | {"alpha": x}
    term = smooth_term("Cm", "alpha", None, result)
    truth = without_line(x, bump(x))
    inside = {"white": [], "coloured": []}
    for seed in range(20):
        noise = lfilter([0.6], [1.0, -0.8], np.random.default_rng(seed).normal(size=1600))[100:]
        evidence, free = evidence_of(result, bump(x) + noise, [term])
        (white,) = fit_smooth(evidence, free, [term])
        remaining = [
            (p[:, None])
            for p in np.array_split(without_line(x, bump(x) + noise) - white.curve(x)[0], 3)
        ]
        c = colour_dispersion(evidence, free, white, remaining)
        (coloured,) = fit_smooth(evidence, free, [term], c)
        # A first-order residual that lasts: its variance times (1 + 0.8)/(1 - 0.8), for what
        # changes slowly.
        assert 3.0 < c < 9.5
        for name, fit in (("white", white), ("coloured", coloured)):
            value, std = fit.curve(x)
            inside[name].append(np.mean(np.abs(value - truth) < 1.96 * std))
    assert np.mean(inside["coloured"]) > 0.88
    assert np.mean(inside["white"]) < 0.8
    evidence, free = evidence_of(
        result, bump(x) + np.random.default_rng(7).normal(size=1500), [term]
    )
    (fit,) = fit_smooth(evidence, free, [term])
    assert (
        colour_dispersion(
            evidence, free, fit, [np.random.default_rng(8).normal(size=(500, 1)) for _ in range(3)]
        )
        < 1.1
    )


def test_the_line_is_the_terms_own_where_the_model_has_none():
    result, y = build(9, lambda x: 60.0 * (x - 0.05))
    term = smooth_term("Cm", "alpha", None, result)
    with_line, reduced = fitted(result, y, term), fitted(result, y, term, free=("1",))
    assert not with_line.estimated[:2].any()
    assert with_line.p > 0.01
    assert reduced.estimated[:2].tolist() == [False, True]
    value, std = reduced.curve(np.array([0.07]))
    centred = 60.0 * (0.07 - result["alpha"].mean())
    assert abs(value[0] - centred) < 4.0 * std[0] < 2.0


def test_beyond_the_data_the_ends_hold_and_a_state_that_stands_still_has_no_term():
    result, y = build(10)
    fit = fitted(result, y, smooth_term("Cm", "alpha", None, result))
    low, high = fit.term.ends
    assert np.array_equal(
        fit.curve(np.array([low - 1.0, high + 1.0]))[0], fit.curve(np.array([low, high]))[0]
    )
    assert smooth_term("Cm", "alpha", None, result | {"alpha": np.full(N, 0.05)}) is None


def test_a_product_is_found_as_one():
    result = states(11)
    y = bump(result["alpha"]) * 2.0 * (result["CT"] - 0.5) + np.random.default_rng(12).normal(
        size=N
    )
    terms = [
        smooth_term("Cm", s, t, result)
        for s, t in (("alpha", None), ("CT", None), ("q_hat", "CT"), ("alpha", "CT"))
    ]
    evidence, free = evidence_of(result, y, terms)
    best = max(fit_smooth(evidence, free, terms), key=lambda f: f.merit)
    assert (best.term.label, best.term.name) == (
        "Cm_of_alpha_times_CT",
        "smooth term of angle of attack, times thrust coefficient, in pitching moment",
    )


def test_a_third_of_the_flight_confirms_what_is_there_and_not_what_is_noise():
    result, y = build(13)
    part = np.array([True, True, False])
    term = smooth_term("Cm", "alpha", None, result)
    evidence, free = evidence_of(result, y, [term])
    assert held_out_gain(evidence, free, fit_smooth(evidence, free, [term])[0], part) > 50.0
    # A curve in the first parts alone.
    y[400:] -= 2.0 * bump(result["alpha"][400:])
    evidence, free = evidence_of(result, y, [term])
    assert held_out_gain(evidence, free, fit_smooth(evidence, free, [term])[0], part) < -50.0


@pytest.mark.parametrize(
    ("curve", "form"),
    [
        (lambda x: 8.0 * np.tanh((x - 0.05) / 0.006), "step at 0.0499"),
        (lambda x: 300.0 * np.maximum(x - 0.062, 0.0), "kink at 0.06"),
        (lambda x: 5000.0 * x**2, "square"),
    ],
)
def test_the_nearest_form_is_told_with_its_place_among_the_knots(curve, form):
    result, y = build(14, curve)
    fit = fitted(result, y, smooth_term("Cm", "alpha", None, result))
    nearest, correlation = similar_forms(fit, result["alpha"], np.ones(N))[0]
    assert nearest.startswith(form)
    assert abs(correlation) > 0.97
