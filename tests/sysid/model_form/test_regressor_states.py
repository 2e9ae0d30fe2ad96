"""States freed of noise: what moves is kept, what is noise goes."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.model_form.fit import denoised_states, remove_state_noise
from tests.helpers.residual_pieces import DT, filtered, noise_of, residuals_of

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
    made = residuals_of(
        [np.zeros(len(x)) for x in noisy],
        states=[{"V_mps": x, "theta_rad": x / 100.0} for x in noisy],
    )
    pieces = [
        type(p)(
            p.label, p.time_s, p.delta, p.states, 0, noise_of(len(p), 0.01, states={"V_mps": std})
        )
        for p in made.pieces
    ]
    return denoised_states(pieces, DT)


def rms(parts):
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


@pytest.mark.parametrize("size", [0.0, 1.5])
def test_most_of_the_noise_goes_and_the_motion_stays(size):
    true, noisy = measured(1, size)
    found = cleaned(noisy)
    before = rms([a - b for a, b in zip(noisy, true, strict=True)])
    after = rms([f["V_mps"] - b for f, b in zip(found, true, strict=True)])
    assert after < 0.4 * before
    # Piece by piece the mean is as it was measured, and states without noise are as they were.
    assert [f["V_mps"].mean() for f in found] == pytest.approx([x.mean() for x in noisy])
    assert all(np.array_equal(f["theta_rad"], x / 100.0) for f, x in zip(found, noisy, strict=True))
    # A state presumed free of noise keeps all of it.
    kept = cleaned(noisy, 1e-6)
    assert rms([f["V_mps"] - b for f, b in zip(kept, true, strict=True)]) == pytest.approx(
        before, rel=0.05
    )


def test_a_band_without_motion_takes_no_other_bands_motion():
    """Low bands hold a few waves of a few pieces, and may show nothing of a state that moves in
    others, and faster.
    """
    rng = np.random.default_rng(2)
    true = []
    for number, n in enumerate((361, 311, 206, 271, 281, 291, 196, 261, 291)):
        t = DT * np.arange(n + 4)
        true.append(
            20.0
            + (
                8.0 * np.exp(-((t - 2.5) ** 2)) * np.sin(4.0 * (t - 2.5))
                if number in (1, 5)
                else 0.0 * t
            )
        )
    noisy = [filtered(x + STD * rng.standard_normal(len(x))) for x in true]
    found, true = cleaned(noisy), [filtered(x) for x in true]
    assert rms([f["V_mps"] - b for f, b in zip(found, true, strict=True)]) < 0.2 * rms(
        [b - 20.0 for b in true]
    )


def test_pieces_that_do_not_know_their_noise_stay_as_they_are():
    made = residuals_of([np.zeros(50)] * 2)
    bare = type(made)(
        tuple(type(p)(p.label, p.time_s, p.delta, p.states) for p in made.pieces), DT, made.cutoffs
    )
    assert remove_state_noise(bare) is bare
    assert remove_state_noise(made).pieces[0].noise is made.pieces[0].noise
