"""Filter error against a textbook Kalman filter, statsmodels and known truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from statsmodels.tsa.statespace.mlemodel import MLEModel

from sysid import filter_error
from sysid.estimation.filter_error import read_record
from sysid.estimation.kalman import make_model, run_filter

DT = 0.05
U = np.sign(np.sin(np.arange(400) * 0.11))


def rate(x, u, theta):
    return np.array([theta[0] * x[0] + x[1], theta[1] * x[0] - 0.8 * x[1] + theta[2] * u[0]])


def measure(x, u, theta):
    return np.array([x[0], x[0] + 0.5 * x[1]])


TRUE, Q, R = np.array([-0.6, -3.0, 2.0]), np.array([0.0, 0.5]), np.array([0.05, 0.08])


def discrete(theta):
    """Transition and input matrices as Runge-Kutta 4 makes them (its Taylor series to fourth
    order).
    """
    A, B = np.array([[theta[0], 1.0], [theta[1], -0.8]]), np.array([0.0, theta[2]])
    h = A * DT
    series = np.eye(2) + h / 2 @ (np.eye(2) + h / 3 @ (np.eye(2) + h / 4))
    return np.eye(2) + h @ series, DT * series @ B


def noise_of_a_step(theta, q):
    """Covariance that white noise of density q^2 gathers in a step: Simpson's rule, the middle
    being the mean of the ends.
    """
    phi = discrete(theta)[0]
    Q, half = np.diag(np.square(q)), 0.5 * (np.eye(2) + phi)
    return DT / 6 * (Q + 4 * half @ Q @ half.T + phi @ Q @ phi.T)


def exact_noise(theta, q):
    """The same by Van Loan's matrix exponential (IEEE Trans. Automatic Control 23, 1978)."""
    A = np.array([[theta[0], 1.0], [theta[1], -0.8]])
    joint = expm(np.block([[-A, np.diag(np.square(q))], [np.zeros((2, 2)), A.T]]) * DT)
    return joint[2:, 2:].T @ joint[:2, 2:]


def fly(seed, n=400, q=Q):
    rng = np.random.default_rng(seed)
    joint = expm(np.array([[TRUE[0], 1.0, 0.0], [TRUE[1], -0.8, TRUE[2]], [0.0, 0.0, 0.0]]) * DT)
    x, z = np.zeros(2), np.empty((n, 2))
    root = np.linalg.cholesky(exact_noise(TRUE, q) + 1e-15 * np.eye(2))
    for k in range(n):
        z[k] = [x[0], x[0] + 0.5 * x[1]] + R * rng.normal(size=2)
        x = joint[:2, :2] @ x + joint[:2, 2] * U[k % 400] + root @ rng.normal(size=2)
    return z


def textbook(vector, z):
    """Negative log-likelihood by the Kalman filter as in any textbook; vector: theta, ln sqrt Q22,
    ln R.
    """
    phi, gamma = discrete(vector[:3])
    q, r = noise_of_a_step(vector[:3], [0.0, np.exp(vector[3])]), np.diag(np.exp(2 * vector[4:6]))
    H = np.array([[1.0, 0.0], [1.0, 0.5]])
    x, P, cost = np.zeros(2), 0.01 * np.eye(2), 0.0
    for k in range(len(z)):
        e, S = z[k] - H @ x, H @ P @ H.T + r
        inverse = np.linalg.inv(S)
        cost += 0.5 * (e @ inverse @ e + np.log(np.linalg.det(S)))
        K = P @ H.T @ inverse
        x, P = x + K @ e, (np.eye(2) - K @ H) @ P
        x, P = phi @ x + gamma * U[k], phi @ P @ phi.T + q
    return cost


class StateSpace(MLEModel):
    """The same model in statsmodels."""

    def __init__(self, z):
        super().__init__(z, k_states=2, k_posdef=2)
        self["design"] = np.array([[1.0, 0.0], [1.0, 0.5]])
        self["selection"] = np.eye(2)
        self.initialize_known(np.zeros(2), 0.01 * np.eye(2))

    def update(self, params, **kwargs):
        phi, gamma = discrete(params[:3])
        self["transition"] = phi
        self["state_intercept"] = gamma[:, None] * U[: self.nobs]
        self["state_cov"] = noise_of_a_step(params[:3], [0.0, np.exp(params[3])])
        self["obs_cov"] = np.diag(np.exp(2 * params[4:6]))


@pytest.fixture(scope="module")
def fitted():
    z = fly(0)
    fit = filter_error(
        rate,
        measure,
        [0.0, 0.0],
        [-0.2, -1.0, 0.5],
        U[:, None],
        z,
        np.arange(400) * DT,
        names=["a", "b", "c"],
        process_noise=[1],
        x0_std=[0.1, 0.1],
        hold="zoh",
        tolerance=1e-5,
    )
    return z, fit


def test_likelihood_is_that_of_the_textbook_filter_and_of_statsmodels(fitted):
    z, fit = fitted
    noise = [fit.process_noise_cov[1, 1], *np.diag(fit.noise_cov)]
    vector = np.concatenate([fit.theta, 0.5 * np.log(noise)])
    assert fit.cost == pytest.approx(textbook(vector, z), rel=1e-7)
    constant = 0.5 * z.size * np.log(2 * np.pi)
    assert fit.cost == pytest.approx(-StateSpace(z).loglike(vector) - constant, rel=1e-6)
    assert abs(fit.cost - textbook(vector + 0.01, z)) > 1e-3


def test_estimates_are_the_textbook_filters_maximum_and_its_curvature(fitted):
    z, fit = fitted
    assert fit.converged
    noise = [fit.process_noise_cov[1, 1], *np.diag(fit.noise_cov)]
    estimate = np.array([*fit.theta, *(0.5 * np.log(noise))])

    # Second differences: f(a + b) and f(-a - b) less those of a and of b alone.
    def both_ways(step):
        return textbook(estimate + step, z) + textbook(estimate - step, z)

    steps = 1e-3 * np.eye(6)
    single, centre = [both_ways(step) for step in steps], textbook(estimate, z)
    hessian = np.zeros((6, 6))
    for i in range(6):
        for j in range(i + 1):
            mixed = both_ways(steps[i] + steps[j]) - single[i] - single[j] + 2.0 * centre
            hessian[i, j] = hessian[j, i] = mixed / 2e-6
    # Newton's step from the estimate leads to the maximum of the textbook's likelihood.
    slope = [(textbook(estimate + s, z) - textbook(estimate - s, z)) / 2e-3 for s in steps]
    best = estimate - np.linalg.solve(hessian, slope)
    assert (np.abs(fit.theta - best[:3]) < 0.01 * fit.std).all()
    # The measure is fine enough to tell truth from estimate.
    assert (np.abs(fit.theta - TRUE) > 0.01 * fit.std).any()
    np.testing.assert_allclose(np.exp(estimate[4:]), np.exp(best[4:]), rtol=5e-3)
    assert np.exp(estimate[3]) == pytest.approx(np.exp(best[3]), rel=1e-2)
    np.testing.assert_allclose(fit.std_crb, np.sqrt(np.diag(np.linalg.inv(hessian)))[:3], rtol=0.12)
    np.testing.assert_allclose(fit.std, fit.std_crb, rtol=0.2)
    assert fit.process_noise_cov[0, 0] == 0.0
    assert fit.warnings == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seeds", "minimum"), [(4, 9), pytest.param(12, 29, marks=pytest.mark.slow)]
)
def test_coverage_in_process_noise_where_output_error_fails(seeds, minimum):
    hits, total = 0, 0
    t = [np.arange(130) * DT] * 3
    inputs = [U[a : a + 130] for a in (0, 130, 260)]
    for seed in range(seeds):
        z = fly(100 + seed)
        parts = [z[a : a + 130] for a in (0, 130, 260)]
        fit = filter_error(
            rate, measure, [0.0, 0.0], [-0.2, -1.0, 0.5], inputs, parts, t, hold="zoh"
        )
        hits += int(np.sum(np.abs(fit.theta - TRUE) < 1.96 * fit.std))
        total += 3
    assert (
        hits >= minimum
    )  # of 12 or 36; at a level of 95 % fewer than this have a probability of 2e-3 or 1e-3


def test_segments_dropouts_and_unequal_lengths():
    z = fly(2)
    first, second = z[:250].copy(), z[250:].copy()
    first[40:60, 0] = np.nan
    second[::3] = np.nan
    t = np.arange(400) * DT
    fit = filter_error(
        rate,
        measure,
        [np.zeros(2), np.zeros(2)],
        [-0.2, -1.0, 0.5],
        [U[:250], U[250:]],
        [first, second],
        [t[:250], t[250:]],
        hold="zoh",
        process_noise=[1],
    )
    assert fit.converged
    assert [part.shape for part in fit.residual] == [(250, 2), (150, 2)]
    assert np.isnan(fit.residual[0][45, 0])
    assert np.isfinite(fit.residual[0][45, 1])
    assert (np.abs(fit.theta - TRUE) < 4.5 * fit.std).all()


@pytest.mark.parametrize(
    ("change", "output"),
    [
        ({"t": np.zeros(50)}, "increase"),
        ({"t": np.arange(49.0)}, "same samples"),
        ({"u": np.full(50, np.nan)}, "not finite"),
        ({"x0": [0.0, 0.0, 0.0]}, r"f\(x, u, theta\)"),
        ({"x0": [np.zeros(2), np.zeros(2)]}, "match"),
        ({"f": lambda x, u, theta: x[0]}, "must return 2"),
        ({"f": lambda x, u, theta: 1 / 0}, "ZeroDivisionError"),
        ({"g": lambda x, u, theta: x * np.nan}, "not finite"),
        ({"names": ["a"]}, "names"),
        ({"hold": "cubic"}, "zoh"),
        ({"process_noise": [7]}, "process_noise"),
        ({"x0_std": -1.0}, "positive"),
        ({"jacobian_every": 0}, "jacobian_every"),
    ],
)
def test_bad_input_is_refused(change, output):
    inputs = {"f": rate, "g": measure, "x0": [0.0, 0.0], "theta0": TRUE, "u": U[:50]}
    inputs |= {"z": np.zeros((50, 2)), "t": np.arange(50.0)}
    inputs |= change
    with pytest.raises(ValueError, match=output):
        filter_error(**inputs)


def test_inputs_between_samples_are_used():
    # x integrates u = t^2 over one sample: exactly 1/3 when the input half-way is known, 1/2 by a
    # straight line.
    u, z, t = np.array([[0.0], [1.0]]), np.array([[0.0], [0.0]]), np.array([0.0, 1.0])

    def missed(u_middle=None):
        record, x0 = read_record([0.0], u, z, t, False, u_middle)
        model = make_model(
            lambda x, u, theta: u + 0.0 * theta,
            lambda x, u, theta: x,
            x0[:, 0],
            u[0],
            np.zeros(1),
            1,
        )
        one = np.ones((1, 1))
        result = run_filter(
            model,
            record,
            0 * one,
            0 * one,
            0.1 * one,
            x0[:, None, :],
            p0=1e-12 * one,
            difference=np.array([1e-5]),
            every=1,
        )
        return -result.raw[1, 0, 0]

    assert missed() == pytest.approx(1 / 2)
    assert missed(np.array([[0.25]])) == pytest.approx(1 / 3)
    with pytest.raises(ValueError, match="u_middle"):
        missed(np.array([[0.25], [0.5]]))
