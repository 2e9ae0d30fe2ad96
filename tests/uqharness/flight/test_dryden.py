"""The Dryden generator against the closed forms of MIL-F-8785C."""

from __future__ import annotations

import copy
import dataclasses
import time
import tracemalloc

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import welch

from uqharness.errors import BadInputError
from uqharness.flight.dryden import (
    COMPONENTS,
    Component,
    DrydenGusts,
    dryden_gusts,
    dryden_parameters,
    dryden_psd,
    dryden_sigma,
    gust_blocks,
)
from uqharness.flight.random_numbers import Split

AIR = (22.2, 100.0, 30.0, 3.66)  # V m/s, h m, W20 kt, span m


def test_parameters_at_a_hand_computed_point() -> None:
    # h = 500 ft: 0.177 + 0.4115 = 0.5885; L_u = 500/0.5885^1.2, sigma_u/sigma_w = 0.5885^-0.4
    par = dryden_parameters(50.0, 152.4, 30.0, 10.0)
    assert par.L_w_m == pytest.approx(152.4)
    assert par.L_u_m == pytest.approx(152.4 * 1.88933, rel=1e-4)
    assert par.sigma_w_mps == pytest.approx(1.54333, rel=1e-5)
    assert par.sigma_u_mps / par.sigma_w_mps == pytest.approx(1.23623, rel=1e-4)


def test_horizontal_and_vertical_agree_at_1000_ft() -> None:
    par = dryden_parameters(50.0, 304.8, 30.0, 10.0)
    assert par.L_u_m == pytest.approx(par.L_w_m, rel=1e-12)
    assert par.sigma_u_mps == pytest.approx(par.sigma_w_mps, rel=1e-12)


@pytest.mark.parametrize("component", COMPONENTS)
@pytest.mark.parametrize("air", [AIR, (60.0, 20.0, 15.0, 11.0), (15.0, 300.0, 45.0, 1.5)])
def test_sigma_is_the_root_of_the_integrated_spectrum(
    component: Component, air: tuple[float, float, float, float]
) -> None:
    variance = quad(
        lambda log_w: float(dryden_psd(component, np.exp(log_w), *air)) * np.exp(log_w),
        -15,
        20,
        limit=400,
    )
    assert dryden_sigma(component, *air) == pytest.approx(np.sqrt(variance[0]), rel=1e-5)


def test_roll_spectrum_is_the_printed_form() -> None:
    V, h, W20, b = AIR
    omega = np.array([0.01, 0.5, 3.0, 20.0])
    sigma_w = 0.1 * W20 * 1852 / 3600
    printed = (
        sigma_w**2
        / (V * h)
        * 0.8
        * (np.pi * h / (4 * b)) ** (1 / 3)
        / (1 + (4 * b * omega / (np.pi * V)) ** 2)
    )
    np.testing.assert_allclose(dryden_psd("p", omega, *AIR), printed, rtol=1e-12)


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
    dt, n = 0.02, 1_800_000
    V, h, W20, b = AIR
    gusts = dryden_gusts(n, dt, V, h, W20, 1.1 * b, seed=11)
    frequency, density = welch(gusts.q_radps, fs=1 / dt, nperseg=32768, detrend=False)
    band = (frequency >= 2.0) & (frequency < 6.0)
    ratio = np.mean(
        density[band] / (2 * np.pi * dryden_psd("q", 2 * np.pi * frequency[band], *AIR))
    )
    assert abs(ratio - 1.0) > 5 * np.sqrt(1.0 / (0.95 * 4.0 * n * dt))


@pytest.mark.parametrize("seeds", [400, pytest.param(2000, marks=pytest.mark.slow)])
def test_first_samples_are_stationary_and_so_are_all_others(seeds: int) -> None:
    starts = {name: np.empty((seeds, 3)) for name in COMPONENTS}
    for seed in range(seeds):
        gusts = dryden_gusts(30, 0.05, *AIR, seed=(3, seed))
        for name in COMPONENTS:
            starts[name][seed] = gusts.component(name)[[0, 5, 29]]
    for name in COMPONENTS:
        # Standard error of a standard deviation from 2000 draws: 1/sqrt(4000) = 1.6 %; four of
        # them.
        ratio = np.sqrt(np.mean(starts[name] ** 2, axis=0)) / dryden_sigma(name, *AIR)
        np.testing.assert_allclose(ratio, 1.0, atol=4.1 / np.sqrt(2.0 * seeds))


@pytest.mark.parametrize(("slope_of", "rate", "sign"), [("w", "q", -1.0), ("v", "r", 1.0)])
def test_rates_are_the_smoothed_gradients_of_the_velocities(
    slope_of: Component, rate: Component, sign: float
) -> None:
    # T dq/dt + q = sign (d/dt)(velocity)/V: integrate both sides over the record. The trapezoids
    # miss a little of a rough q.
    dt, n = 0.001, 200_000
    gusts = dryden_gusts(n, dt, *AIR, seed=5)
    par = dryden_parameters(*AIR)
    T = par.T_q_s if rate == "q" else par.T_r_s
    series = gusts.component(rate)
    integral = np.concatenate([[0.0], np.cumsum(0.5 * dt * (series[1:] + series[:-1]))])
    left = T * (series - series[0]) + integral
    right = sign / par.V_mps * (gusts.component(slope_of) - gusts.component(slope_of)[0])
    assert np.std(left - right) < 0.03 * np.std(right)
    assert np.std(left + right) > np.std(right)


def test_independent_noises_are_independent() -> None:
    gusts = dryden_gusts(720_000, 0.05, *AIR, seed=9)
    for one, other in (
        ("u", "v"),
        ("u", "w"),
        ("v", "w"),
        ("p", "u"),
        ("p", "q"),
        ("p", "r"),
        ("q", "r"),
    ):
        correlation = np.corrcoef(gusts.component(one), gusts.component(other))[0, 1]
        assert abs(correlation) < 0.06, (one, other)


def test_seeds() -> None:
    one, same, other, longer_key = (
        dryden_gusts(500, 0.01, *AIR, seed=seed) for seed in (0, 0, 1, (0, 1))
    )
    for field in ("u_mps", "v_mps", "w_mps", "p_radps", "q_radps", "r_radps"):
        assert getattr(one, field).tobytes() == getattr(same, field).tobytes()
        assert not np.array_equal(getattr(one, field), getattr(other, field))
        assert not np.array_equal(getattr(one, field), getattr(longer_key, field))
    with pytest.raises(dataclasses.FrozenInstanceError):
        one.dt_s = 1.0  # type: ignore[misc]


@pytest.mark.parametrize("block", [1, 7, 256, 999, 1000, 5000])
def test_blocks_are_the_same_samples_to_the_bit(block: int) -> None:
    whole = dryden_gusts(1000, 0.01, *AIR, seed=(3, 4))
    parts = list(gust_blocks(1000, 0.01, *AIR, seed=(3, 4), block=block))
    assert len(parts) == -(-1000 // block)
    for name in COMPONENTS:
        assert (
            np.concatenate([part.component(name) for part in parts]).tobytes()
            == whole.component(name).tobytes()
        )


def test_pages_cross_their_seams_unchanged_and_copies_go_on() -> None:
    whole = dryden_gusts(20_000, 0.01, *AIR, seed=8)
    gusts = DrydenGusts(dryden_parameters(*AIR), 0.01, 8)
    pages = [gusts.page()]
    copied = copy.deepcopy(gusts)
    pages += [gusts.page(), gusts.page()]
    for row, name in enumerate(COMPONENTS):
        np.testing.assert_array_equal(
            np.concatenate([page[row] for page in pages])[:20_000], whole.component(name)
        )
    assert copied.page().tobytes() == pages[1].tobytes()


def test_a_day_of_gusts_takes_the_memory_of_a_block() -> None:
    tracemalloc.start()
    try:
        blocks = gust_blocks(8_640_000, 0.01, *AIR, seed=1, block=8192)
        for _ in range(40):
            next(blocks)
        assert tracemalloc.get_traced_memory()[1] < 5e6
    finally:
        tracemalloc.stop()


def test_intensity_scales_one_history() -> None:
    light, severe = (
        dryden_gusts(100, 0.01, 22.2, 100.0, W20, 3.66, seed=4) for W20 in (15.0, 45.0)
    )
    for name in COMPONENTS:
        np.testing.assert_allclose(severe.component(name), 3.0 * light.component(name), rtol=1e-12)
    assert not np.any(dryden_gusts(100, 0.01, 22.2, 100.0, 0.0, 3.66, seed=4).w_mps)


def test_an_hour_takes_less_than_a_second() -> None:
    dryden_gusts(10, 0.01, *AIR, seed=1)
    start = time.process_time()
    dryden_gusts(360_000, 0.01, *AIR, seed=1)
    assert time.process_time() - start < 1.0


def test_below_ten_feet_the_values_of_ten_feet_hold() -> None:
    assert dryden_parameters(20.0, 0.0, 30.0, 3.0) == dryden_parameters(20.0, 3.048, 30.0, 3.0)


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


def test_gusts_that_branch_within_a_page_need_its_noise() -> None:
    """The page anew and what follows are those of a split from the start; without the noise, and
    elsewhere, there is none.
    """
    parameters, split = dryden_parameters(*AIR), Split(9000, 1, 2, 3, 4)
    gusts = DrydenGusts(parameters, 0.01, 7)
    gusts.page()
    assert gusts.branched(Split(0, 1, 2, 3, 4)) is None
    gusts.keep_noise()
    own = gusts.page()
    found = gusts.branched(split)
    assert found is not None
    branch, page = found
    reference = DrydenGusts(parameters, 0.01, 7, splits=(split,))
    reference.page()
    assert np.array_equal(page, reference.page())
    assert np.array_equal(branch.page(), reference.page())
    within = 9000 - page.shape[1]
    assert np.array_equal(page[:, :within], own[:, :within])
    assert not np.array_equal(page[:, within:], own[:, within:])
    with pytest.raises(ValueError, match="last page ends at step 16384"):
        gusts.branched(Split(100, 1, 2, 3, 4))
