"""Dryden turbulence and its filters against the closed forms of MIL-F-8785C."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.signal import lfilter, welch

from uqharness.errors import BadInputError
from uqharness.flight.dryden import (
    COMPONENTS,
    PAGE_STEPS,
    DrydenGusts,
    _Recursion,
    discretise,
    dryden_gusts,
    dryden_parameters,
    dryden_psd,
    first_order,
)

AIR = (22.2, 100.0, 30.0, 3.66)  # V m/s, h m, W20 kt, span m


def test_parameters_at_a_hand_computed_point() -> None:
    # h = 500 ft: 0.177 + 0.4115 = 0.5885; L_u = 500/0.5885^1.2, sigma_u/sigma_w = 0.5885^-0.4
    par = dryden_parameters(50.0, 152.4, 30.0, 10.0)
    assert par.L_w_m == pytest.approx(152.4)
    assert par.L_u_m == pytest.approx(152.4 * 1.88933, rel=1e-4)
    assert par.sigma_w_mps == pytest.approx(1.54333, rel=1e-5)
    assert par.sigma_u_mps / par.sigma_w_mps == pytest.approx(1.23623, rel=1e-4)


def test_gradient_spectra_are_filtered_velocity_spectra() -> None:
    V, _, _, b = AIR
    omega = np.array([0.01, 0.5, 3.0, 20.0])
    q_over_w = dryden_psd("q", omega, *AIR) / dryden_psd("w", omega, *AIR)
    r_over_v = dryden_psd("r", omega, *AIR) / dryden_psd("v", omega, *AIR)
    np.testing.assert_allclose(
        q_over_w, (omega / V) ** 2 / (1 + (4 * b * omega / (np.pi * V)) ** 2), rtol=1e-12
    )
    np.testing.assert_allclose(
        r_over_v, (omega / V) ** 2 / (1 + (3 * b * omega / (np.pi * V)) ** 2), rtol=1e-12
    )


def test_spectra_of_the_samples() -> None:
    # 10 h at 50 Hz; bands of 2 B T > 1700 degrees of freedom: 5 standard deviations of the worst
    # are 17 %.
    dt, n = 0.02, 1_800_000
    gusts = dryden_gusts(n, dt, *AIR, seed=11)
    for component in COMPONENTS:
        frequency, density = welch(
            gusts.component(component), fs=1 / dt, nperseg=32768, detrend=False
        )
        for low, high in ((0.01, 0.03), (0.03, 0.1), (0.1, 0.5), (0.5, 2.0), (2.0, 6.0)):
            band = (frequency >= low) & (frequency < high)
            # What lies above half the sampling rate folds down: the sampled process has the sum of
            # the images.
            images = sum(
                2
                * np.pi
                * dryden_psd(component, 2 * np.pi * np.abs(frequency[band] + k / dt), *AIR)
                for k in range(-20, 21)
            )
            error = np.sqrt(1.0 / (0.95 * (high - low) * n * dt))
            assert np.mean(density[band] / images) == pytest.approx(1.0, abs=5 * error), (
                component,
                low,
            )


def test_a_wrong_span_is_noticed() -> None:
    # Counter-case of the test above: 10 % on the span changes the density of p, q, r by far more
    # than its tolerance.
    dt, n = 0.02, 500_000
    V, h, W20, b = AIR
    gusts = dryden_gusts(n, dt, V, h, W20, 1.1 * b, seed=11)
    frequency, density = welch(gusts.q_radps, fs=1 / dt, nperseg=32768, detrend=False)
    band = (frequency >= 2.0) & (frequency < 6.0)
    ratio = np.mean(
        density[band] / (2 * np.pi * dryden_psd("q", 2 * np.pi * frequency[band], *AIR))
    )
    assert abs(ratio - 1.0) > 5 * np.sqrt(1.0 / (0.95 * 4.0 * n * dt))


def test_pages_cross_their_seams_unchanged_and_copies_go_on() -> None:
    complete = dryden_gusts(20_000, 0.01, *AIR, seed=8)
    gusts = DrydenGusts(dryden_parameters(*AIR), 0.01, 8)
    pages = [gusts.page()]
    copied = copy.deepcopy(gusts)
    pages += [gusts.page(), gusts.page()]
    for row, name in enumerate(COMPONENTS):
        np.testing.assert_array_equal(
            np.concatenate([page[row] for page in pages])[:20_000], complete.component(name)
        )
    assert copied.page().tobytes() == pages[1].tobytes()


@pytest.mark.parametrize(
    ("n", "dt", "air"),
    [
        (0, 0.01, AIR),
        (10, 0.0, AIR),
        (10, 0.01, (0.0, 100.0, 30.0, 3.66)),
        (10, 0.01, (22.0, 400.0, 30.0, 3.66)),
        (10, 0.01, (22.0, float("nan"), 30.0, 3.66)),
        (10, 0.01, (22.0, 100.0, -1.0, 3.66)),
        (10, 0.01, (22.0, 100.0, 30.0, float("nan"))),
    ],
)
def test_bad_input_is_refused(n: int, dt: float, air: tuple[float, float, float, float]) -> None:
    with pytest.raises(BadInputError):
        dryden_gusts(n, dt, *air, seed=1)


# The filters of the gusts against matrix functions of scipy and against the plain recursion.

A = ((-0.2, 0.0, 0.0), (0.2, -0.2, 0.0), (0.8, -0.3, -5.0))
B = (0.2, 0.0, 0.0)


@pytest.mark.parametrize("dt", [0.0005, 0.01, 0.3, 3.0])
def test_discretisation_has_the_exact_noise_covariance(dt: float) -> None:
    step, factor = (np.array(result) for result in discretise(A, B, dt))
    a, b = np.array(A), np.array(B)
    stationary = solve_continuous_lyapunov(a, -np.outer(b, b))
    np.testing.assert_allclose(step, expm(a * dt), rtol=1e-12)
    np.testing.assert_allclose(
        factor.T @ factor, stationary - step @ stationary @ step.T, rtol=1e-6, atol=1e-15
    )
    # Another step's covariance is another one.
    assert not np.allclose(factor.T @ factor, stationary, rtol=1e-3) or dt > 1.0


@pytest.mark.parametrize("x", [1e-7, 0.1, 9.0, 30.0, 800.0])
def test_a_running_sum_is_the_recursion(x: float) -> None:
    keep = first_order(x, 1.0).keep
    drive = np.random.default_rng(1).standard_normal(2 * PAGE_STEPS)
    recursion = _Recursion(keep)
    pages = [recursion.page(drive[:PAGE_STEPS]), recursion.page(drive[PAGE_STEPS:])]
    assert pages[0][0] == 0.0
    assert pages[1][0] == pages[0][-1]
    expected = lfilter([1.0], [1.0, -keep], drive)
    result = np.concatenate([page[1:] for page in pages])
    np.testing.assert_allclose(result, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())
    invalid = lfilter([1.0], [1.0, -keep * (1.0 + 1e-9)], drive)
    assert x > 3.0 or np.abs(result - invalid).max() > 1e-12 * np.abs(expected).max()
