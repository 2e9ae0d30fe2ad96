"""Where a residual stands above its noise: bursts of a known band at a known time, states, and
noise alone, which has no place.
"""

from __future__ import annotations

import numpy as np
import pytest

from uqharness.refinement.residual_location import (
    BY_CHANCE,
    band_of,
    dependence,
    largest_burst,
    shortest_interval,
    state_correlate,
)

RATE = 50.0
TIME = np.arange(4500) / RATE


def noise(seed: int, n: int = len(TIME)) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(n)


@pytest.mark.parametrize(("size", "seed"), [(1.0, 0), (1.0, 1), (3.0, 2), (10.0, 3)])
def test_a_burst_is_found_at_its_time_and_in_its_band(size, seed):
    """A sine whose frequency runs from 5 to 7 Hz between 30 and 34 s; size: its rms over the
    noise's.
    """
    t = TIME - 30.0
    chirp = np.where(
        (t >= 0.0) & (t < 4.0),
        size * np.sqrt(2.0) * np.sin(2.0 * np.pi * (5.0 * t + t**2 / 4.0)),
        0.0,
    )
    result = largest_burst(noise(seed) + chirp, RATE)
    assert result is not None
    assert result.p < 1e-6
    assert result.start / RATE == pytest.approx(30.0, abs=0.6)
    assert result.stop / RATE == pytest.approx(34.0, abs=0.6)
    assert 3.0 <= result.low_hz <= 5.0
    assert 7.0 <= result.high_hz <= 9.5


def test_a_slow_drift_is_found_below_the_blocks_frequency():
    result = largest_burst(noise(4) + np.where(TIME > 60.0, 2.0, 0.0), RATE)
    assert result is not None
    assert result.low_hz == 0.0
    assert result.high_hz < 3.0
    assert result.start / RATE == pytest.approx(60.0, abs=2.0)
    assert result.stop == len(TIME)


def test_colour_below_the_noise_has_a_band():
    """A residual whose rms is that of its noise, but half of its power below 2.5 Hz where a tenth
    belongs.
    """
    spectrum = np.fft.rfft(noise(5))
    f = np.fft.rfftfreq(len(TIME), 1.0 / RATE)
    e = np.fft.irfft(np.where(f < 2.5, 2.2, 0.75) * spectrum, len(TIME))
    result = largest_burst(e / np.std(e), RATE)
    assert result is not None
    assert result.p < BY_CHANCE
    assert result.high_hz < 3.5


@pytest.mark.parametrize("n", [500, pytest.param(4500, marks=pytest.mark.slow)])
def test_noise_alone_has_no_place(n):
    """Of 150 draws chance may place two at one in a hundred (a binomial's 99 % is five)."""
    ps = [
        result.p
        for seed in range(150)
        if (result := largest_burst(noise(seed, n), RATE)) is not None
    ]
    assert sum(p < BY_CHANCE for p in ps) <= 5
    assert all(0.0 <= p <= 1.0 for p in ps)


def test_what_is_too_short_has_no_place():
    assert largest_burst(np.full(10, 9.0), RATE) is None


def test_the_densest_stretch_holds_half():
    weights = np.array([1.0, 0.0, 5.0, 4.0, 0.0, 1.0])
    assert shortest_interval(weights) == (2, 4)
    assert shortest_interval(np.zeros(3)) == (0, 1)


def test_the_band_of_a_sine_holds_its_frequency():
    low, high = band_of(np.sin(2.0 * np.pi * 6.0 * TIME[:500]), RATE)
    assert low < 6.0 < high
    assert high - low < 0.5


def states(seed: int, n: int = 3000) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {name: rng.uniform(-1.0, 1.0, n) for name in ("alpha_rad", "p_radps", "elevator_deg")}


def test_a_residual_goes_with_the_state_that_makes_it():
    x = states(1)
    mean = np.where(x["alpha_rad"] > 0.6, 2.0, 0.0)
    result = state_correlate([noise(2, 3000) + mean], [x])
    assert result is not None
    assert (result.state, result.of) == ("alpha_rad", "mean")
    assert result.low == pytest.approx(0.6, abs=0.05)
    assert result.high == pytest.approx(1.0, abs=0.01)
    assert result.share == pytest.approx(np.var(mean) / (np.var(mean) + 1.0), abs=0.05)


def test_a_residual_whose_sign_changes_goes_with_a_state_by_its_size():
    x = states(3)
    result = state_correlate([noise(4, 3000) * np.where(np.abs(x["p_radps"]) > 0.7, 4.0, 1.0)], [x])
    assert result is not None
    assert (result.state, result.of) == ("p_radps", "size")


def test_noise_goes_with_no_state_white_or_coloured():
    """A coloured residual beside a slow state: counted as independent samples, chance would pass in
    most draws.
    """
    white = [state_correlate([noise(seed, 3000)], [states(100 + seed)]) for seed in range(60)]
    assert sum(result is not None for result in white) <= 3

    def slow(seed: int) -> np.ndarray:
        return np.convolve(noise(seed, 3149), np.ones(150) / 150.0**0.5, "valid")

    coloured = [
        state_correlate([slow(seed)], [{"alpha_rad": slow(1000 + seed)}]) for seed in range(60)
    ]
    assert sum(result is not None for result in coloured) <= 6


def test_rows_not_measured_are_left_out():
    x = states(5)
    e = noise(6, 3000) + 3.0 * x["alpha_rad"]
    e[::3] = np.nan
    result = state_correlate([e], [x])
    assert result is not None
    assert result.state == "alpha_rad"


def test_a_residual_depends_on_what_it_was_made_of():
    rng = np.random.default_rng(0)
    x = [
        {
            "alpha_rad": rng.uniform(0.0, 0.3, 600),
            "V_mps": rng.uniform(18.0, 24.0, 600),
            "still": np.zeros(600),
        }
        for _ in range(3)
    ]
    white = [rng.standard_normal(600) for _ in x]
    result = [e + 40.0 * (s["alpha_rad"] - 0.15) for e, s in zip(white, x, strict=True)]
    (name, share), (other, remainder) = dependence(result, x)
    assert (name, other) == ("alpha_rad", "V_mps")
    slope = 1600.0 * 0.3**2 / 12.0
    assert share == pytest.approx(slope / (slope + 1.0), abs=0.03)
    # Adjusted for its numbers, a curve through noise explains nothing.
    assert abs(remainder) < 0.02
    assert all(abs(s) < 0.02 for _, s in dependence(white, x))
    assert dependence([np.zeros(600)], x[:1]) == []
