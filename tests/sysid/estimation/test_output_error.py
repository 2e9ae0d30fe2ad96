"""Output error against certified values and known truth; derivatives, failures and refusals."""

from __future__ import annotations

import re
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy import signal

from campaigns.estimators import aircraft
from sysid import output_error
from sysid.arrays import FloatArray
from sysid.estimation.output_error import (
    SafeSimulation,
    first_steps,
    forward_differences,
    sensitivities,
)
from tests.reference import nist


def misra(theta):
    return theta[0] * (1.0 - np.exp(-theta[1] * nist.MISRA1A.x))


def thurber(theta):
    x = nist.THURBER.x
    return np.polyval(theta[3::-1], x) / (1.0 + x * (theta[4] + x * (theta[5] + x * theta[6])))


@pytest.mark.parametrize(
    ("model", "y", "start", "value", "sd"),
    [
        (misra, nist.MISRA1A.y, [500.0, 1e-4], nist.MISRA1A.values, nist.MISRA1A.std),
        (misra, nist.MISRA1A.y, [250.0, 5e-4], nist.MISRA1A.values, nist.MISRA1A.std),
        (
            thurber,
            nist.THURBER.y,
            [1000, 1000, 400, 40, 0.7, 0.3, 0.03],
            nist.THURBER.values,
            nist.THURBER.std,
        ),
        (
            thurber,
            nist.THURBER.y,
            [1300, 1500, 500, 75, 1.0, 0.4, 0.05],
            nist.THURBER.values,
            nist.THURBER.std,
        ),
    ],
)
def test_nist_certified_values_and_standard_deviations(model, y, start, value, sd):
    fit = output_error(model, start, y)
    assert fit.converged
    np.testing.assert_allclose(fit.theta, value, rtol=1e-6)
    np.testing.assert_allclose(fit.std_crb, sd, rtol=1e-5)
    assert (np.diff(fit.cost_history) <= 0.0).all()
    if model is misra:
        assert np.sqrt(fit.noise_cov[0, 0]) == pytest.approx(nist.MISRA1A.residual_std, rel=1e-8)


def test_a_wrong_model_does_not_meet_the_certified_values():
    x = nist.MISRA1A.x
    fit = output_error(
        lambda theta: theta[0] * theta[1] * x / (1.0 + theta[1] * x), [500, 1e-4], nist.MISRA1A.y
    )
    assert not np.allclose(fit.theta, nist.MISRA1A.values, rtol=1e-2)


def decay(theta, t):
    first = theta[0] * np.exp(-theta[1] * t)
    return np.column_stack([first, theta[2] * first * t + theta[3]])


T = np.arange(400) * 0.02
TRUE = np.array([2.0, 0.7, 30.0, 500.0])


def noisy(seed, scale=1.0):
    return decay(TRUE, T) + scale * np.random.default_rng(seed).normal(size=(T.size, 2)) * [
        0.05,
        2.0,
    ]


def test_segments_dropouts_full_noise_and_an_injected_map():
    rng = np.random.default_rng(2)
    mix = np.array([[0.05, 0.0], [1.5, 1.0]])
    measured = [decay(TRUE, t) + rng.normal(size=(t.size, 2)) @ mix.T for t in (T, T[:250])]

    def two(theta):
        return [decay(theta, T), decay(theta, T[:250])]

    measured[0][50:90, 0] = np.nan
    measured[1][::2, 1] = np.nan
    with ThreadPoolExecutor(2) as pool:
        fit = output_error(two, [1.0, 1.0, 10.0, 400.0], measured, noise="full", map=pool.map)
    assert isinstance(fit.residual, list)
    assert [part.shape for part in fit.residual] == [(400, 2), (250, 2)]
    assert np.isnan(fit.residual[0][50:90, 0]).all()
    assert (np.abs(fit.theta - TRUE) < 4.5 * fit.std).all()
    assert fit.noise_cov[0, 1] / np.sqrt(
        fit.noise_cov[0, 0] * fit.noise_cov[1, 1]
    ) == pytest.approx(0.83, abs=0.1)
    diagonal = output_error(two, [1.0, 1.0, 10.0, 400.0], measured)
    assert diagonal.std[0] > 1.2 * fit.std[0]  # the correlation was worth knowing


def test_free_and_bounds():
    measured = noisy(3)
    fit = output_error(
        lambda theta: decay(theta, T),
        [1.0, 0.7, 20.0, 400.0],
        measured,
        names=["a", "b", "c", "d"],
        free=["a", "c", "d"],
        bounds={"c": (0.0, 25.0)},
    )
    assert fit.status == {"a": "identified", "b": "fixed", "c": "not-identified", "d": "identified"}
    assert "upper bound" in fit.reason["c"]
    assert fit.theta[2] == 25.0
    assert np.isnan(fit.std[[1, 2]]).all()
    wide = output_error(
        lambda theta: decay(theta, T),
        [1.0, 0.7, 30.0, 400.0],
        measured,
        bounds=[(0, 9), (0, 9), (0, 99), (0, 999)],
    )
    assert set(wide.status.values()) == {"identified"}


def test_collinear_and_uninformed_parameters_are_named_and_the_rest_estimated():
    measured = noisy(4)

    def model(theta):  # theta[4] acts on nothing, theta[0] and theta[5] only as a product
        return decay(np.array([theta[0] * theta[5], *theta[1:4]]), T)

    fit = output_error(
        model,
        [1.0, 1.0, 10.0, 400.0, 5.0, 1.5],
        measured,
        names=["a", "b", "c", "d", "idle", "gain"],
    )
    assert [fit.status[name] for name in ("a", "gain", "idle")] == ["not-identified"] * 3
    assert "gain" in fit.reason["a"]
    assert "no effect" in fit.reason["idle"]
    assert np.isnan(fit.std[[0, 4, 5]]).all()
    assert np.isnan(fit.cov[0]).all()
    assert fit.theta[4] == 5.0
    single = output_error(lambda theta: decay(theta, T), [1.0, 1.0, 10.0, 400.0], measured)
    np.testing.assert_allclose(fit.theta[1:4], single.theta[1:], rtol=1e-4)
    np.testing.assert_allclose(fit.std[1:4], single.std[1:], rtol=1e-3)
    assert set(single.status.values()) == {"identified"}


def test_a_simulation_that_fails_or_diverges_at_trial_points_is_stepped_around():
    measured = noisy(5)
    calls = []

    def fragile(theta):
        calls.append(theta)
        if theta[0] > 5.0:
            raise ZeroDivisionError("beyond the table")
        out = decay(theta, T)
        return np.where(theta[2] > 60.0, np.nan, out)

    fit = output_error(fragile, [0.05, 3.0, 1.0, 0.0], measured)
    assert fit.converged
    assert (np.abs(fit.theta - TRUE) < 4.5 * fit.std).all()
    assert fit.n_simulations == len(calls)
    assert (np.diff(fit.cost_history) <= 0.0).all()
    with pytest.raises(ValueError, match=r"fails at theta0.*beyond the table"):
        output_error(fragile, [6.0, 3.0, 1.0, 0.0], measured)


def test_sensitivities_carried_on_give_the_same_answer_with_fewer_simulations():
    measured = noisy(7)
    fits = {
        way: output_error(lambda theta: decay(theta, T), 0.6 * TRUE, measured, differences=way)
        for way in ("auto", "secant")
    }
    assert all(fit.converged for fit in fits.values())
    np.testing.assert_allclose(
        fits["secant"].theta, fits["auto"].theta, atol=1e-2 * fits["auto"].std.min()
    )
    np.testing.assert_allclose(fits["secant"].std, fits["auto"].std, rtol=2e-3)
    assert fits["secant"].n_simulations < 0.7 * fits["auto"].n_simulations


def test_wrong_model_form_is_reported_and_the_right_one_is_not():
    rng = np.random.default_rng(7)
    u = signal.square(T * 3.0)
    y = signal.lfilter([0.05], [1.0, -0.95], u + 0.8 * u**2 * np.sin(T))
    measured = y + 0.01 * rng.normal(size=T.size)
    invalid = output_error(
        lambda theta: signal.lfilter([theta[0]], [1.0, -theta[1]], u), [0.1, 0.9], measured
    )
    assert any("the model's form" in text for text in invalid.warnings)
    assert (invalid.std > 1.5 * invalid.std_crb).all()

    def complete(theta):
        return signal.lfilter([theta[0]], [1.0, -theta[1]], u + theta[2] * u**2 * np.sin(T))

    right = output_error(complete, [0.1, 0.9, 0.0], measured)
    assert right.warnings == []


@pytest.mark.parametrize(
    "plane", [aircraft.LONGITUDINAL, aircraft.LATERAL], ids=lambda plane: plane.name
)
def test_turbulence_is_reported_and_calm_air_is_not(plane):
    warned = {}
    for wind in (0.0, 15.0):
        rng = np.random.default_rng([11, plane.inputs])
        truth, start = plane.draw(rng)
        inputs, measured = aircraft.fly(plane, truth, [400] * 3, wind, rng)
        fit = output_error(
            lambda theta, u=inputs: aircraft.simulate(plane, theta, u), start, measured
        )
        assert fit.converged
        warned[wind] = [text for text in fit.warnings if "turbulence" in text]
        if wind == 0.0:
            assert (np.abs(fit.theta - truth) < 4.5 * fit.std).all()
    assert warned[0.0] == []
    assert warned[15.0]


@pytest.mark.parametrize(
    ("arguments", "output"),
    [
        ({"theta0": [1.0, np.nan]}, "not finite"),
        ({"theta0": []}, "at least one"),
        ({"names": ["a"]}, "1 entries for 2"),
        ({"bounds": [(0, 1)]}, "1 entries for 2"),
        ({"bounds": [(2.0, 3.0), (None, None)]}, "outside its bounds"),
        ({"bounds": [(2.0, 1.0), (None, None)]}, "lower must be below"),
        ({"free": ["nobody"]}, "nobody"),
        ({"free": []}, "no parameter"),
        ({"measured": np.ones((3, 2, 2))}, "shape"),
        ({"measured": np.array([1.0, np.inf, 3.0])}, "not finite"),
        ({"measured": np.ones(7)}, "return the outputs at the measured samples"),
        ({"measured": np.full((5, 1), np.nan)}, "no sample at all"),
        ({"measured": [np.ones((3, 1)), np.ones((3, 2))]}, "columns"),
        ({"measured": np.array([1.0, 2.0]), "simulate": lambda theta: theta}, "measure more"),
        ({"noise": "white"}, "diagonal"),
        ({"differences": "guess"}, "central"),
    ],
)
def test_bad_input_is_refused(arguments, output):
    x = np.arange(5.0)
    inputs = {
        "simulate": lambda theta: theta[0] + theta[1] * x,
        "theta0": [1.0, 1.0],
        "measured": x,
    }
    with pytest.raises(ValueError, match=output):
        output_error(**{**inputs, **arguments})


def test_estimates_alone_are_the_same_and_say_nothing_of_errors():
    t = np.linspace(0.0, 5.0, 200)
    measured = 2.0 * np.exp(-0.5 * t) + 0.01 * np.random.default_rng(1).standard_normal(200)

    def fitted(**options):
        return output_error(
            lambda theta: theta[0] * np.exp(-theta[1] * t), [1.0, 1.0], measured, **options
        )

    complete, single = fitted(), fitted(errors=False)
    assert np.allclose(single.theta, complete.theta, rtol=1e-12)
    assert single.converged
    assert np.isnan(single.std).all()
    assert np.isnan(single.cov).all()
    assert np.isfinite(complete.std).all()


# Sensitivities by differences against derivatives written out; simulations that fail, are rough
# or do not care.


@pytest.mark.parametrize(
    ("answer", "output"),
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
def test_safe_simulation_reports_wrong_outputs(answer, output):
    result = SafeSimulation(lambda theta: answer, (4,), 2)(np.zeros(1))
    assert isinstance(result, str)
    assert re.search(output, result)


# Parameters that move different segments share a run, and give what each alone would.

LENGTHS = (30, 40, 50)
THETA = np.array([0.7, 1.0, 2.0, 3.0, -0.5])
"""A rate that all segments share, a start for each, a bias of the last two."""


class Decays:
    """Three decays; counts how often it is simulated."""

    def __init__(
        self, of=lambda index: {1: (0,), 2: (1,), 3: (2,), 4: (1, 2)}.get(index), fails=None
    ):
        self.moved, self.fails, self.runs = of, fails, 0

    def __call__(self, theta):
        self.runs += 1
        if self.fails is not None and self.fails(theta):
            raise RuntimeError("no")
        parts = []
        for number, n in enumerate(LENGTHS):
            t = np.linspace(0.0, 2.0, n)
            y = theta[1 + number] * np.exp(-theta[0] * t) + (theta[4] if number else 0.0)
            parts.append(np.column_stack([y, y**2]))
        return parts


def differences_together(model, central):
    simulation = SafeSimulation(model, LENGTHS, 2)
    base = simulation(THETA)
    limits = (np.full(5, -np.inf), np.full(5, np.inf))
    step, scatter = first_steps(THETA, *limits), np.ones(2)
    return sensitivities(
        simulation, THETA, base, step, range(5), limits, scatter, central=central, map_fn=None
    )


def test_sensitivities_of_a_failing_parameter_leave_its_group():
    result = differences_together(Decays(fails=lambda theta: theta[2] != THETA[2]), False)
    assert result.effect.tolist() == [True, True, False, True, True]
    right = differences_together(Decays(), False).sensitivity.dense()
    np.testing.assert_allclose(
        np.delete(result.sensitivity.dense(), 2, axis=2),
        np.delete(right, 2, axis=2),
        rtol=1e-9,
        atol=1e-12,
    )


def test_forward_differences_at_steps_given():
    result = forward_differences(Decays(), THETA, np.full(5, 1e-6), (LENGTHS, 2))
    assert result is not None
    np.testing.assert_allclose(
        result.dense(), differences_together(Decays(), True).sensitivity.dense(), atol=1e-4
    )
    assert [columns.tolist() for columns in result.columns] == [[0, 1], [0, 2, 4], [0, 3, 4]]
    assert (
        forward_differences(
            Decays(fails=lambda theta: theta[4] != THETA[4]), THETA, np.full(5, 1e-6), (LENGTHS, 2)
        )
        is None
    )


# Edges of what an estimator may say: no degree of freedom left, zero responses, forms of bounds
# and starts.


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


def test_a_fit_near_its_minimum_does_not_start_again_for_an_output_without_explanation() -> None:
    """The second output is disturbed by what no model explains, as by gusts."""
    t = np.linspace(0.0, 5.0, 200)
    rng = np.random.default_rng(6)

    def simulate(theta: FloatArray) -> FloatArray:
        return np.column_stack([theta[0] * np.exp(-theta[1] * t), theta[0] * t / 100.0])

    measured = simulate(np.array([2.0, 0.5])) + rng.standard_normal((200, 2)) * [0.01, 1.0]
    numbers: list[int] = []
    fit = output_error(
        simulate,
        [1.8, 0.6],
        measured,
        differences="secant",
        max_iterations=5,
        tolerance=1e-12,
        callback=lambda number, length: numbers.append(number),
    )
    assert not fit.converged
    assert numbers == [1, 2, 3, 4, 5]
    np.testing.assert_allclose(fit.theta, [2.0, 0.5], atol=4.0 * fit.std.max())
