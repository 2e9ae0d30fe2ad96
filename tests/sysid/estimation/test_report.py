"""Edges of what an estimator may say: no degree of freedom left, zero responses, forms of bounds
and starts.
"""

import numpy as np
import pytest

from sysid import equation_error, filter_error, output_error
from sysid.estimation.results import unresolved


def two_outputs(theta):
    time = np.linspace(0.0, 5.0, 40)
    return np.column_stack([theta[0] + theta[1] * time, theta[2] + 0.0 * time])


def test_an_output_met_exactly_by_its_only_parameter_gives_no_bound():
    rng = np.random.default_rng(1)
    measured = two_outputs([1.0, 2.0, 3.0]) + 0.1 * rng.normal(size=(40, 2))
    measured[1:, 1] = np.nan
    fit = output_error(two_outputs, np.zeros(3), measured, names=["a", "b", "c"])
    assert fit.status == {"a": "identified", "b": "identified", "c": "not-identified"}
    assert np.isnan(fit.std[2])
    assert "output 1 has 1 samples, of which the parameters use up 1.0" in fit.reason["c"]
    measured[5, 1] = 3.1
    assert (
        output_error(two_outputs, np.zeros(3), measured, names=["a", "b", "c"]).status["c"]
        == "identified"
    )


def test_a_simulation_that_diverges_has_no_standard_error():
    """(b - 1) exp(g t), b = 1: at g = 12/s a difference of two such simulations is 1e18 times b's
    own rounding.
    """
    rng, time = np.random.default_rng(3), np.linspace(0.0, 5.0, 100)
    measured = 1.0 + 0.1 * rng.normal(size=(100, 1))

    def fitted(growth_1ps):
        def simulate(theta):
            return (theta[0] - 1.0) * np.exp(growth_1ps * time)[:, None] + theta[1]

        return output_error(simulate, [1.0, 1.0], measured, names=["b", "level"])

    lost, kept = fitted(12.0), fitted(0.1)
    assert lost.status == {"b": "not-identified", "level": "identified"}
    assert np.isnan(lost.std[0])
    assert "the simulation diverges" in lost.reason["b"]
    assert set(kept.status.values()) == {"identified"}
    reasons = unresolved(np.array([1.0, 1.0]), np.array([[3e9, 2.0]]), np.array([10.0]))
    assert "moves output 0 by its own size" in reasons[0]
    assert reasons[1] == ""
    assert unresolved(np.array([1.0]), np.array([[np.inf]]), np.array([10.0]))[0]
    assert unresolved(np.array([0.0]), np.array([[3e9]]), np.array([10.0])) == [""]


def test_bounds_of_a_name_that_is_none_are_a_value_error():
    with pytest.raises(ValueError, match="bounds names 1; the parameters are a, b, c"):
        output_error(
            two_outputs,
            np.zeros(3),
            two_outputs([1, 2, 3]),
            names=["a", "b", "c"],
            bounds={1: (0, 2)},
        )


def test_a_zero_response_is_met_exactly_and_without_a_numerical_warning():
    found = equation_error(np.column_stack([np.ones(50), np.arange(50.0)]), np.zeros(50))
    assert (found.theta == 0.0).all()
    assert not found.warnings


def test_initial_states_of_segments_may_be_nested_lists_or_rows_of_an_array():
    rng = np.random.default_rng(2)
    time = np.arange(60) * 0.05
    z = [start * np.exp(-2.0 * time) + 0.01 * rng.normal(size=60) for start in (1.0, 0.5)]
    fits = [
        filter_error(
            lambda x, u, th: [th[0] * x[0]],
            lambda x, u, th: [x[0]],
            x0,
            [-1.0],
            None,
            z,
            [time, time],
        )
        for x0 in ([[1.0], [0.5]], np.array([[1.0], [0.5]]), [np.array([1.0]), np.array([0.5])])
    ]
    assert abs(fits[0].theta[0] + 2.0) < 4.0 * fits[0].std[0]
    assert fits[0].theta[0] == fits[1].theta[0] == fits[2].theta[0]
