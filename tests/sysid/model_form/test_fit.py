"""Missing terms, rates of variation and noise of regressors, on residuals of known origin."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.aerodynamics.coefficients import COEFFICIENTS, STATES
from sysid.aerodynamics.residuals import Cutoffs, ResidualPiece, Residuals
from sysid.model_form.components import STEP_S, variation
from sysid.model_form.fit import (
    Design,
    denoised_states,
    fit_bounds,
    missing_terms,
)
from tests.helpers.residual_pieces import DT, filtered, noise_of, residuals_of

NOISE = 1e-3


def residuals(more=lambda states: 0.0, seed: int = 1, without: str = "") -> Residuals:
    """Five pieces of ten seconds: Cm is a straight line in alpha, coloured noise, and ``more``; the
    rest is noise.
    """
    rng = np.random.default_rng(seed)
    pieces = []
    for k in range(5):
        n = 500
        states = {}
        for s in STATES:
            slow = np.convolve(rng.standard_normal(n + 60), np.hanning(60) / 30.0, "valid")[:n]
            states[s] = {"V_mps": 21.0, "throttle_pct": 60.0}.get(s, 0.0) + slow
        states.pop(without, None)
        delta = (
            NOISE
            * np.array(
                [
                    np.convolve(rng.standard_normal(n + 4), np.ones(5) / np.sqrt(5.0), "valid")
                    for _ in range(6)
                ]
            ).T
        )
        delta[:, COEFFICIENTS.index("Cm")] += 0.02 * states["alpha_rad"] + more(states)
        pieces.append(ResidualPiece(f"piece {k}", 0.02 * np.arange(n), delta, states))
    return Residuals(tuple(pieces), 0.02, Cutoffs())


def test_a_square_and_a_surface_are_named_with_their_shares():
    output = residuals(lambda s: 0.06 * s["p_radps"] ** 2 + 0.004 * s["elevator_pos_deg"])
    bounds = fit_bounds(output)["Cm"].bounds
    result = missing_terms(output, "Cm", bounds)
    assert [m.name for m in result] == ["p_radps^2", "elevator_pos_deg"]
    assert result[0].states == ("p_radps",)
    # With both gone noise is left: the shares add up to one less its variance over the scatter's.
    assert sum(m.share for m in result) == pytest.approx(1.0 - NOISE**2 / bounds.s2, abs=0.06)
    assert result[0].share > result[1].share


def test_noise_lacks_nothing():
    result = residuals()
    assert all(missing_terms(result, c, f.bounds) == [] for c, f in fit_bounds(result).items())


def test_flights_without_a_state_of_the_bounds_are_refused():
    bounds = fit_bounds(residuals())["Cm"].bounds
    with pytest.raises(ValueError, match="no q_radps"):
        missing_terms(residuals(without="q_radps"), "Cm", bounds)


# How fast a model's error wanders: known sines and random walks.


def wandering(rate_hz: float, seconds: float = 200.0, f: float = 0.2) -> tuple[Residuals, float]:
    """A residual A sin(2 pi f t) beside a state that tells nothing of it, and the rms of
    its slope.
    """
    time = np.arange(0.0, seconds, 1.0 / rate_hz)
    y = 0.01 * np.sin(2 * np.pi * f * time)
    rng = np.random.default_rng(0)
    states = {"V_mps": 20.0 + rng.standard_normal(len(time))}
    piece = ResidualPiece("x", time, np.column_stack([y] * 6), states)
    return Residuals((piece,), 1.0 / rate_hz, Cutoffs()), 0.01 * 2 * np.pi * f / np.sqrt(2)


@pytest.mark.parametrize("rate_hz", [25.0, 50.0, 100.0])
def test_the_rate_of_variation_does_not_depend_on_the_recorders_rate(rate_hz):
    residuals, slope = wandering(rate_hz)
    bounds = fit_bounds(residuals, {"CZ": Design(("V_mps",), ((0,),))})["CZ"].bounds
    low, high = bounds.bounds(residuals.states)
    result = variation(residuals, "CZ", bounds, cutoff_hz=2.0)
    expected = slope * STEP_S / (high - low)[0]
    assert result.sigma == pytest.approx(expected, rel=0.03)
    assert result.rate == pytest.approx(expected / np.sqrt(0.02), rel=0.03)
    # A smooth signal is no random walk: over a tenfold step the rate comes out about root ten times
    # as large.
    assert result.lagged[0.1] / result.lagged[0.02] == pytest.approx(np.sqrt(5.0), rel=0.03)


def test_too_short_for_the_low_pass_is_no_rate_and_not_zero():
    residuals, _ = wandering(50.0, seconds=2.0)
    bounds = fit_bounds(residuals, {"CZ": Design(("V_mps",), ((0,),))})["CZ"].bounds
    result = variation(residuals, "CZ", bounds, cutoff_hz=0.1)
    assert np.isnan(result.rate)
    assert len(result.increments) == 0


# States freed of noise: what moves is kept, what is noise goes.

STD = 0.5


def measured(seed, size, n=300, pieces=9):
    """Airspeed that sways slowly, behind the filter: true, and as a noisy sensor has it."""
    rng = np.random.default_rng(seed)
    true, noisy = [], []
    for _ in range(pieces):
        t = DT * np.arange(n + 4)
        x = (
            20.0
            + 2.0 * rng.standard_normal()
            + size * np.sin(2 * np.pi * 0.2 * t + 6.3 * rng.random())
        )
        true.append(filtered(x))
        noisy.append(filtered(x + STD * rng.standard_normal(n + 4)))
    return true, noisy


def cleaned(noisy, std=STD):
    result = residuals_of(
        [np.zeros(len(x)) for x in noisy],
        states=[{"V_mps": x, "theta_rad": x / 100.0} for x in noisy],
    )
    pieces = [
        type(p)(
            p.label, p.time_s, p.delta, p.states, 0, noise_of(len(p), 0.01, states={"V_mps": std})
        )
        for p in result.pieces
    ]
    return denoised_states(pieces, DT)


def rms(parts):
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


@pytest.mark.parametrize("size", [0.0, 1.5])
def test_most_of_the_noise_goes_and_the_motion_stays(size):
    true, noisy = measured(1, size)
    result = cleaned(noisy)
    before = rms([a - b for a, b in zip(noisy, true, strict=True)])
    after = rms([f["V_mps"] - b for f, b in zip(result, true, strict=True)])
    assert after < 0.4 * before
    # Piece by piece the mean is as it was measured, and states without noise are as they were.
    assert [f["V_mps"].mean() for f in result] == pytest.approx([x.mean() for x in noisy])
    assert all(
        np.array_equal(f["theta_rad"], x / 100.0) for f, x in zip(result, noisy, strict=True)
    )
    # A state presumed free of noise keeps all of it.
    retained = cleaned(noisy, 1e-6)
    assert rms([f["V_mps"] - b for f, b in zip(retained, true, strict=True)]) == pytest.approx(
        before, rel=0.05
    )


# Noise added once more.
