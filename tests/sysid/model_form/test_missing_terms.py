"""Terms that an interval's polynomial lacks, on residuals whose making is known."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.aerodynamics.coefficients import COEFFICIENTS, STATES
from sysid.aerodynamics.residuals import Cutoffs, ResidualPiece, Residuals
from sysid.model_form.fit import fit_bounds, missing_terms

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
    made = residuals(lambda s: 0.06 * s["p_radps"] ** 2 + 0.004 * s["elevator_pos_deg"])
    bounds = fit_bounds(made)["Cm"].bounds
    found = missing_terms(made, "Cm", bounds)
    assert [m.name for m in found] == ["p_radps^2", "elevator_pos_deg"]
    assert found[0].states == ("p_radps",)
    # With both gone noise is left: the shares add up to one less its variance over the scatter's.
    assert sum(m.share for m in found) == pytest.approx(1.0 - NOISE**2 / bounds.s2, abs=0.06)
    assert found[0].share > found[1].share


def test_noise_lacks_nothing():
    made = residuals()
    assert all(missing_terms(made, c, f.bounds) == [] for c, f in fit_bounds(made).items())


def test_a_term_of_the_polynomial_itself_is_never_missing():
    made = residuals(lambda s: 0.05 * s["alpha_rad"] * s["q_radps"])
    assert missing_terms(made, "Cm", fit_bounds(made)["Cm"].bounds) == []


def test_flights_without_a_state_of_the_bounds_are_refused():
    bounds = fit_bounds(residuals())["Cm"].bounds
    with pytest.raises(ValueError, match="no q_radps"):
        missing_terms(residuals(without="q_radps"), "Cm", bounds)
