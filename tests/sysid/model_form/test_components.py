"""Components of the model error, over many draws of known parts and against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import fft, stats

from sysid.aerodynamics.coefficients import regressors
from sysid.model_form import components
from sysid.model_form.components import (
    TIMES_S,
    make_blocks,
    sample,
    separate,
)
from sysid.model_form.fit import Design, FitOptions, fit_bounds
from tests.helpers.residual_pieces import HALF, filtered, first_order, residuals_of

STATES = ("V_mps", "alpha_rad")
LENGTH = 250


def draw(
    seed,
    polynomial,
    persistent,
    transient,
    noise,
    presumed=None,
    blocks=12,
    flights=1,
    of_flight=0.0,
):
    """Residuals whose parts are known, and the model's error in them piece by piece."""
    rng = np.random.default_rng(seed)
    beta = polynomial * rng.standard_normal(6)
    of_flights = of_flight * rng.standard_normal(flights)
    series, errors, states, numbers = [], [], [], []
    for number in range(blocks * flights):
        n = LENGTH + 2 * HALF
        t = 0.02 * np.arange(n)
        v = rng.standard_normal() + 0.3 * np.sin(0.7 * t + 6.3 * rng.random())
        a = rng.uniform(0.5, 1.5) * np.exp(-((t - 2.0) ** 2)) * np.sin(4.0 * t + 6.3 * rng.random())
        x = np.column_stack([np.ones(n), v, a, v * v, v * a, a * a])
        flight = number // blocks
        error = (
            x @ beta
            + of_flights[flight]
            + persistent * rng.standard_normal()
            + transient * first_order(n, 0.4, rng)
        )
        errors.append(filtered(error))
        series.append(filtered(error + noise * rng.standard_normal(n)))
        states.append({"V_mps": 20.0 + 2.0 * filtered(v), "alpha_rad": 0.03 * filtered(a)})
        numbers.append(flight)
    return residuals_of(series, presumed or noise, states, numbers), errors


def fitted(residuals):
    return fit_bounds(residuals, {"CX": Design(STATES)}, FitOptions())["CX"]


def share_inside(bounds, residuals, errors, widen=1.0):
    """Of the model's error, within the whole interval before the sign clip."""
    inside = []
    for piece, error in zip(residuals.pieces, errors, strict=True):
        z = bounds.normalised(piece.states)
        variance = (
            bounds.s2 * bounds.leverage_factor * bounds.leverage(z)
            + bounds.parts.persistent**2
            + bounds.parts.transient**2
        )
        inside.append(
            np.abs(error - regressors(z, bounds.terms) @ bounds.beta_hat)
            <= widen * bounds.parts.total_t * np.sqrt(variance)
        )
    return float(np.mean(np.concatenate(inside)))


def over_draws(seeds, widen=1.0, **parts):
    """Share of the error of twelve further blocks within the interval of twelve."""
    shares = []
    for seed in seeds:
        residuals, errors = draw(seed, blocks=24, **parts)
        result, new = (
            type(residuals)(residuals.pieces[k::2], 0.02, residuals.cutoffs) for k in (0, 1)
        )
        shares.append(share_inside(fitted(result).bounds, new, errors[1::2], widen))
    return float(np.mean(shares))


@pytest.mark.parametrize(
    "parts",
    [
        {"polynomial": 0.005, "persistent": 0.005, "transient": 0.005, "noise": 0.02},
        pytest.param(
            {"polynomial": 0.01, "persistent": 0.0, "transient": 0.02, "noise": 0.01},
            marks=pytest.mark.slow,
        ),
        pytest.param(
            {"polynomial": 0.0, "persistent": 0.02, "transient": 0.01, "noise": 0.03},
            marks=pytest.mark.slow,
        ),
    ],
    ids=["small", "transient", "persistent"],
)
def test_new_blocks_lie_within_as_often_as_stated(parts):
    # Sixteen draws: the standard error is a point and a half.
    assert 0.91 <= over_draws(range(16), **parts) <= 0.985
    # The count can say no.
    assert over_draws(range(6), widen=0.6, **parts) < 0.9


def test_separate_finds_the_parts_that_were_put_in():
    result = [fitted(draw(seed, 0.01, 0.012, 0.02, 0.02)[0]).bounds.parts for seed in range(8)]
    assert np.mean([p.transient for p in result]) == pytest.approx(0.02, rel=0.1)
    assert np.mean([p.persistent for p in result]) == pytest.approx(0.012, rel=0.5)
    assert np.mean([p.transient_time_s for p in result]) == pytest.approx(0.4, rel=0.35)
    assert np.mean([p.noise_scale for p in result]) == pytest.approx(1.0, abs=0.1)
    assert all(p.found for p in result)
    assert all(np.isnan(p.flight) for p in result)  # one flight


def test_components_without_model_error():
    noise = 0.02
    for seed in range(6):
        bounds = fitted(draw(seed, 0.0, 0.0, 0.0, noise)[0]).bounds
        low, high = bounds.bounds({"V_mps": np.array([20.0]), "alpha_rad": np.array([0.0])})
        assert not bounds.parts.found
        # The published interval of noisy samples is 2 x 1.96 x 0.0096 wide here, the smoother's
        # share of the noise.
        assert high - low < 0.25 * 2 * 1.96 * 0.0096
        assert bounds.parts.not_above < 0.5 * 0.0096
    assert fitted(draw(1, 0.0, 0.0, 0.01, noise)[0]).bounds.parts.found


@pytest.mark.parametrize("presumed", [pytest.param(0.5, marks=pytest.mark.slow), 2.0])
def test_a_noise_presumed_wrong_costs_no_coverage(presumed):
    parts = {"polynomial": 0.005, "persistent": 0.01, "transient": 0.01, "noise": 0.02}
    assert over_draws(range(8), presumed=presumed * 0.02, **parts) >= 0.93
    reports = [
        fitted(draw(seed, 0.0, 0.0, 0.0, 0.02, presumed=0.04)[0]).bounds.parts for seed in range(4)
    ]
    # Overstated, it shows in the data, which scatter less than it says.
    assert np.mean([p.noise_scale for p in reports]) < 0.75


def test_what_differs_from_flight_to_flight_widens_the_persistent_part():
    result = {"polynomial": 0.005, "persistent": 0.004, "transient": 0.005, "noise": 0.01}
    difference = [
        fitted(draw(seed, blocks=6, flights=5, of_flight=0.02, **result)[0]).bounds.parts
        for seed in range(6)
    ]
    alike = [fitted(draw(seed, blocks=6, flights=5, **result)[0]).bounds.parts for seed in range(6)]
    assert np.mean([p.flight for p in difference]) > 3.0 * np.mean([p.flight for p in alike])
    assert np.mean([p.flight for p in difference]) == pytest.approx(0.02, rel=0.6)
    assert all(p.persistent > p.flight for p in difference)


def test_solve_is_the_dense_formulas(monkeypatch):
    """Log likelihood of y ~ N(0, D + X S X'), estimate and covariance of its coefficients, by the n
    x n covariance.
    """
    result = fitted(
        draw(2, 0.005, 0.01, 0.01, 0.02, blocks=4, flights=2, of_flight=0.01)[0]
    ).separation
    monkeypatch.setattr(components, "_BLOCK_SIZE", 500)  # a few points and rows at a time
    problem, blocks, some = (
        result.problem,
        result.problem.blocks,
        np.argsort(-result.posterior.weights)[:7],
    )
    points = result.points.subset(some)
    solved = problem.solve(points)
    for k in range(len(some)):
        low = min(int(points.colour[k]), len(TIMES_S) - 2)
        share = points.colour[k] - low
        coloured = (1.0 - share) * blocks.coloured(TIMES_S[low]) + share * blocks.coloured(
            TIMES_S[low + 1]
        )
        D = (
            points.block[k] * blocks.constant
            + points.transient[k] * coloured
            + points.noise[k] * blocks.noise
        )
        S = np.diag(
            np.r_[np.full(problem.terms, points.polynomial[k]), np.full(2, points.flight[k])]
        )
        C, gain = np.diag(D) + problem.X @ S @ problem.X.T, S @ problem.X.T
        dense = [
            stats.multivariate_normal(np.zeros(len(C)), factor * C).logpdf(blocks.y)
            for factor in (1.0, 1.1)
        ]
        right, invalid = np.array(dense) + 0.5 * len(C) * np.log(2.0 * np.pi)
        assert solved.log_likelihood[k] == pytest.approx(right, abs=1e-6)
        assert abs(solved.log_likelihood[k] - invalid) > 0.1
        scatter = np.sqrt(np.diag(solved.covariance[k]))
        np.testing.assert_allclose(
            solved.beta[k], gain @ np.linalg.solve(C, blocks.y), atol=1e-6 * scatter.min()
        )
        covariance = S - gain @ np.linalg.solve(C, gain.T)
        np.testing.assert_allclose(
            solved.covariance[k] / np.outer(scatter, scatter),
            covariance / np.outer(scatter, scatter),
            atol=1e-6,
        )
        np.testing.assert_allclose(
            result.rows.beta[some[k]], solved.beta[k], atol=1e-9 * scatter.min()
        )


def test_excluding_blocks_is_fitting_the_others():
    residuals, _ = draw(3, 0.005, 0.01, 0.01, 0.02)
    complete = fitted(residuals)
    remainder = type(residuals)(residuals.pieces[2:], 0.02, residuals.cutoffs)
    terms, b = complete.bounds.terms, complete.bounds
    repeat = separate(
        make_blocks(
            remainder, "CX", [regressors(b.normalised(p.states), terms) for p in remainder.pieces]
        )
    ).components()
    quick, all_blocks = complete.separation.excluding([0, 1]), complete.separation.components()
    assert quick.total_variance.mean == pytest.approx(repeat.total_variance.mean, rel=0.15)
    assert quick.transient == pytest.approx(repeat.transient, rel=0.15)
    scatter = np.sqrt(np.diag(repeat.covariance))
    assert np.all(np.abs(quick.beta - repeat.beta) < 0.5 * scatter)
    assert np.any(np.abs(all_blocks.beta - repeat.beta) > 0.2 * scatter)


def test_tails_that_reach_further_than_a_normal_distributions_widen_the_interval():
    """Error in two blocks of twelve alone: its variance says too little of those two."""
    residuals, errors = draw(1, 0.0, 0.0, 0.0, 0.005)
    rng = np.random.default_rng(9)
    series = [
        p.delta[:, 0]
        + (0.05 * filtered(first_order(LENGTH + 2 * HALF, 0.4, rng)) if k < 2 else 0.0)
        for k, p in enumerate(residuals.pieces)
    ]
    output = residuals_of(series, 0.005, [p.states for p in residuals.pieces])
    errors = [
        e + s - p.delta[:, 0] for e, s, p in zip(errors, series, residuals.pieces, strict=True)
    ]
    result = fitted(output)
    assert result.separation.components().tail > 1.1
    assert share_inside(result.bounds, output, errors) > 0.93


# Blocks: what is constant, what is coloured, and the noise, by frequency.


def test_coloured_variances_are_those_of_the_process():
    rng = np.random.default_rng(3)
    n, time = 200, 0.4
    waves = np.array(
        [fft.dct(first_order(n, time, rng), norm="ortho") ** 2 for _ in range(3000)]
    ).mean(axis=0)
    blocks = make_blocks(residuals_of([np.zeros(n)]), "CX", [np.ones((n, 1))])
    result = blocks.coloured(time)
    np.testing.assert_allclose(result, waves[: len(result)], rtol=0.2)
    assert np.abs(blocks.coloured(3 * time) / waves[: len(result)] - 1.0).max() > 0.5


# Importance sampling against integrals in closed form.


@pytest.mark.parametrize("width", [1.0, 0.05, 0.002])
def test_means_spreads_and_evidence_of_a_normal_likelihood(width):
    """A correlated normal in the cube, from flat to one that 256 points of the prior all miss."""
    middle = np.array([0.4, 0.6, 0.55])
    cov = width**2 * np.array([[0.04, 0.02, 0.0], [0.02, 0.04, 0.0], [0.0, 0.0, 0.01]])
    normal = stats.multivariate_normal(middle, cov)
    result = sample(normal.logpdf, 3)
    assert result.weights.sum() == pytest.approx(1.0)
    assert result.effective > 100.0
    if width < 1.0:  # the whole of it lies inside the cube
        mean = result.weights @ result.points
        scatter = (result.points - mean).T @ ((result.points - mean) * result.weights[:, None])
        np.testing.assert_allclose(mean, middle, atol=0.15 * 0.2 * width)
        np.testing.assert_allclose(scatter, cov, atol=0.2 * 0.04 * width**2)
        assert result.log_evidence == pytest.approx(0.0, abs=0.1)
        other = sample(lambda x: normal.logpdf(x) + 3.0, 3)
        assert other.log_evidence == pytest.approx(3.0, abs=0.1)
