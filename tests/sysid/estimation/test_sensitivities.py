"""Sensitivities by differences against derivatives written out; simulations that fail, are rough or
do not care.
"""

from __future__ import annotations

import re

import numpy as np
import pytest

from sysid.estimation.output_error import (
    TARGETS,
    SafeSimulation,
    first_steps,
    roughness,
    sensitivities,
    target_for,
)

T = np.linspace(0.0, 3.0, 60)
FREE = (np.full(2, -np.inf), np.full(2, np.inf))


def decay(theta):
    """Two outputs of an amplitude and a rate."""
    y = theta[0] * np.exp(-theta[1] * T)
    return np.column_stack([y, 1e4 * y**2])


def exact(theta) -> np.ndarray:
    e = np.exp(-theta[1] * T)
    first = np.stack([e, -theta[0] * T * e], axis=-1)
    y = theta[0] * e
    return np.stack([first, 2e4 * y[:, None] * first], axis=1)


def differences(theta, model=decay, limits=FREE, central=True, columns=(0, 1), map_=None):
    theta = np.asarray(theta, dtype=float)
    simulation = SafeSimulation(model, (T.size,), 2)
    base = simulation(theta)
    assert not isinstance(base, str)
    step = first_steps(theta, *limits)
    return sensitivities(
        simulation,
        theta,
        base,
        step,
        columns,
        limits,
        np.abs(base).max(axis=0),
        central=central,
        map_fn=map_,
    )


@pytest.mark.parametrize(("central", "close"), [(True, 1e-6), (False, 2e-3)])
@pytest.mark.parametrize("theta", [(2.0, 0.5), (2e-4, 0.0), (3e6, 2.0)])
def test_derivatives_are_the_exact_ones(central, close, theta):
    found, truth = differences(theta, central=central), exact(theta)
    size = np.abs(truth).max(axis=(0, 1))
    assert np.abs(found.sensitivity.dense() - truth).max(axis=(0, 1)) / size == pytest.approx(
        0.0, abs=close
    )
    assert found.effect.all()
    # Of another point they are others.
    assert (
        np.abs(found.sensitivity.dense() - exact((1.2 * theta[0], theta[1] + 0.3))).max()
        > 0.05 * size.max()
    )


def test_at_a_bound_and_beside_a_failure_one_side_is_taken():
    seen = []

    def brittle(theta):
        seen.append(theta.copy())
        if theta[1] > 0.5:
            raise RuntimeError("no such rate")
        return decay(theta)

    limits = np.array([2.0, -np.inf]), np.array([np.inf, np.inf])
    found = differences((2.0, 0.5), brittle, limits)
    assert min(theta[0] for theta in seen) >= 2.0
    np.testing.assert_allclose(found.sensitivity.dense(), exact((2.0, 0.5)), rtol=5e-3, atol=1.0)


def test_what_moves_no_output_or_always_fails_has_no_effect():
    found = differences((2.0, 0.5), lambda theta: decay([theta[0], 0.5]))
    assert found.effect.tolist() == [True, False]
    assert not found.sensitivity.dense()[:, :, 1].any()
    found = differences(
        (2.0, 0.5), lambda theta: decay(theta) if theta[1] == 0.5 else np.full((T.size, 2), np.nan)
    )
    assert found.effect.tolist() == [True, False]


def test_an_injected_map_runs_every_simulation():
    counted = []

    def counting(function, points):
        points = list(points)
        counted.append(len(points))
        return map(function, points)

    found = differences((2.0, 0.5), map_=counting)
    assert found.runs == sum(counted) > 0
    np.testing.assert_array_equal(
        found.sensitivity.dense(), differences((2.0, 0.5)).sensitivity.dense()
    )


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (np.ones((3, 2)), r"returned shapes \[\(3, 2\)\], measured has \[\(4, 2\)\]"),
        (
            np.array([[1.0, 2.0], [1.0, np.nan], [1.0, 1.0], [1.0, 1.0]]),
            "not finite, .* from stacked sample 1 on",
        ),
        (np.full((4, 2), 1e150), "beyond 1e.100"),
        ("words", "not numeric"),
    ],
)
def test_wrong_outputs_are_a_sentence(answer, said):
    found = SafeSimulation(lambda theta: answer, (4,), 2)(np.zeros(1))
    assert isinstance(found, str)
    assert re.search(said, found)


def test_segments_are_stacked_and_a_model_may_raise_anything():
    simulation = SafeSimulation(lambda theta: [np.ones(2), 2.0 * np.ones(3)], (2, 3), 1)
    assert simulation(np.zeros(1)).ravel().tolist() == [1.0, 1.0, 2.0, 2.0, 2.0]
    assert (
        SafeSimulation(lambda theta: {}[1], (2,), 1)(np.zeros(1)) == "simulate raised KeyError: 1"
    )


def test_roughness_is_that_of_printed_digits():
    theta, small = np.array([2.0, 0.5]), np.array([1e-5, 1e-5])

    def rough(decimals):
        simulation = SafeSimulation(lambda p: np.round(decay(p), decimals), (T.size,), 2)
        base = simulation(theta)
        return roughness(simulation, theta, base, small, FREE, np.ones(2), map_fn=None)[0]

    # Rounding to a unit u has the deviation u/sqrt(12).
    assert rough(0) < 1.0
    for decimals in (2, 4):
        assert rough(decimals) == pytest.approx(10.0**-decimals / np.sqrt(12.0), rel=0.5)
    assert rough(15) < 1e-8
    broken = SafeSimulation(lambda p: {}[1], (T.size,), 2)
    assert roughness(broken, theta, decay(theta), small, FREE, np.ones(2), map_fn=None) == (0.0, 6)


def test_the_wanted_change_balances_and_is_bounded():
    assert target_for(1e-9) == pytest.approx(1e-3)
    assert (target_for(0.0), target_for(1.0)) == TARGETS


def test_first_steps_without_a_hint():
    found = first_steps(
        np.array([5.0, 0.0, 0.0]), np.array([-9.0, -1.0, -np.inf]), np.array([9.0, 3.0, np.inf])
    )
    assert found == pytest.approx([5e-4, 4e-4, 1e-4])
