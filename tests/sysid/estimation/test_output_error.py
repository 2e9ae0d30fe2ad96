"""output_error against certified values, scipy, and known truth; and where it must say no."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy import optimize, signal

from campaigns.estimators import aircraft
from sysid import output_error
from tests.reference import nist


def misra(theta):
    return theta[0] * (1.0 - np.exp(-theta[1] * nist.MISRA1A_X))


def thurber(theta):
    x = nist.THURBER_X
    return np.polyval(theta[3::-1], x) / (1.0 + x * (theta[4] + x * (theta[5] + x * theta[6])))


@pytest.mark.parametrize(
    ("model", "y", "start", "value", "sd"),
    [
        (misra, nist.MISRA1A_Y, [500.0, 1e-4], nist.MISRA1A, nist.MISRA1A_SD),
        (misra, nist.MISRA1A_Y, [250.0, 5e-4], nist.MISRA1A, nist.MISRA1A_SD),
        (
            thurber,
            nist.THURBER_Y,
            [1000, 1000, 400, 40, 0.7, 0.3, 0.03],
            nist.THURBER,
            nist.THURBER_SD,
        ),
        (
            thurber,
            nist.THURBER_Y,
            [1300, 1500, 500, 75, 1.0, 0.4, 0.05],
            nist.THURBER,
            nist.THURBER_SD,
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
        assert np.sqrt(fit.noise_cov[0, 0]) == pytest.approx(nist.MISRA1A_RESIDUAL_SD, rel=1e-8)


def test_a_wrong_model_does_not_meet_the_certified_values():
    x = nist.MISRA1A_X
    fit = output_error(
        lambda theta: theta[0] * theta[1] * x / (1.0 + theta[1] * x), [500, 1e-4], nist.MISRA1A_Y
    )
    assert not np.allclose(fit.theta, nist.MISRA1A, rtol=1e-2)


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


def test_scipy_weighted_least_squares_agrees():
    measured = noisy(0)
    fit = output_error(
        lambda theta: decay(theta, T), [1.0, 1.0, 0.0, 0.0], measured, differences="central"
    )
    weight = 1.0 / np.sqrt(np.diagonal(fit.noise_cov))
    found = optimize.least_squares(
        lambda theta: ((measured - decay(theta, T)) * weight).ravel(),
        TRUE,
        x_scale=TRUE,
        xtol=1e-14,
        ftol=1e-14,
    )
    np.testing.assert_allclose(fit.theta, found.x, rtol=1e-4)
    np.testing.assert_allclose(fit.cov_crb, np.linalg.inv(found.jac.T @ found.jac), rtol=2e-3)
    np.testing.assert_allclose(fit.std, fit.std_crb, rtol=0.2)
    assert fit.converged
    assert fit.warnings == []
    assert fit.n_simulations < 150
    assert np.sqrt(np.diagonal(fit.noise_cov)) == pytest.approx([0.05, 2.0], rel=0.1)


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_units_do_not_matter_and_zeros_are_a_start(unit):
    measured = noisy(1)
    plain = output_error(lambda theta: decay(theta, T), [1.0, 1.0, 0.0, 0.0], measured)
    scaled = output_error(
        lambda theta: decay(theta / [1, 1, unit, unit], T), [1.0, 1.0, 0.0, 0.0], measured
    )
    np.testing.assert_allclose(scaled.theta, plain.theta * [1, 1, unit, unit], rtol=1e-5)
    np.testing.assert_allclose(scaled.std, plain.std * [1, 1, unit, unit], rtol=1e-4)


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
    alone = output_error(lambda theta: decay(theta, T), [1.0, 1.0, 10.0, 400.0], measured)
    np.testing.assert_allclose(fit.theta[1:4], alone.theta[1:], rtol=1e-4)
    np.testing.assert_allclose(fit.std[1:4], alone.std[1:], rtol=1e-3)
    assert set(alone.status.values()) == {"identified"}


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


def test_an_all_zero_start_of_an_unstable_looking_model_is_brought_home():
    elevator = np.sign(np.sin(T * 2.0)) * (T < 6.0)
    matrix = np.array([[1.0, 1.0], [0.0, 0.0]])

    def short_period(theta):
        x, out = np.zeros(2), np.empty((T.size, 2))
        for k in range(T.size):
            out[k] = x
            matrix[:] = [[theta[0], 1.0], [theta[1], theta[2]]]
            x = x + 0.02 * (matrix @ x + [0.0, theta[3] * elevator[k]])
        return out

    truth = np.array([-2.0, -8.0, -3.0, -10.0])
    measured = short_period(truth) + np.random.default_rng(8).normal(size=(T.size, 2)) * [
        0.01,
        0.02,
    ]
    fit = output_error(short_period, np.zeros(4), measured)
    assert fit.converged
    assert (np.abs(fit.theta - truth) < 4.5 * fit.std).all()
    assert (np.diff(fit.cost_history) <= 0.0).all()


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


def test_no_convergence_is_said():
    fit = output_error(
        lambda theta: decay(theta, T), [0.1, 5.0, 0.0, 0.0], noisy(6), max_iterations=1
    )
    assert not fit.converged
    assert "not converged" in fit.warnings[0]


def test_wrong_model_form_is_reported_and_the_right_one_is_not():
    rng = np.random.default_rng(7)
    u = signal.square(T * 3.0)
    y = signal.lfilter([0.05], [1.0, -0.95], u + 0.8 * u**2 * np.sin(T))
    measured = y + 0.01 * rng.normal(size=T.size)
    wrong = output_error(
        lambda theta: signal.lfilter([theta[0]], [1.0, -theta[1]], u), [0.1, 0.9], measured
    )
    assert any("the model's form" in text for text in wrong.warnings)
    assert (wrong.std > 1.5 * wrong.std_crb).all()

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
    ("arguments", "said"),
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
def test_bad_input_is_refused(arguments, said):
    x = np.arange(5.0)
    given = {"simulate": lambda theta: theta[0] + theta[1] * x, "theta0": [1.0, 1.0], "measured": x}
    with pytest.raises(ValueError, match=said):
        output_error(**{**given, **arguments})


def test_estimates_alone_are_the_same_and_say_nothing_of_errors():
    t = np.linspace(0.0, 5.0, 200)
    measured = 2.0 * np.exp(-0.5 * t) + 0.01 * np.random.default_rng(1).standard_normal(200)

    def fitted(**options):
        return output_error(
            lambda theta: theta[0] * np.exp(-theta[1] * t), [1.0, 1.0], measured, **options
        )

    whole, alone = fitted(), fitted(errors=False)
    assert np.allclose(alone.theta, whole.theta, rtol=1e-12)
    assert alone.converged
    assert np.isnan(alone.std).all()
    assert np.isnan(alone.cov).all()
    assert np.isfinite(whole.std).all()
