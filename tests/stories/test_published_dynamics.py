"""A published dynamic example: Jategaonkar's unstable aircraft (2015, ch. 4), whose constants the
book prints.

wdot = Zw w + (u0 + Zq) q + Zde de,   qdot = Mw w + Mq q + Mde de,   az = Zw w + Zq q + Zde de,   u0
= 44.57 m/s"""

import numpy as np
import pytest

from sysid import equation_error, filter_error, output_error, stepwise
from tests.helpers.places import TESTS

NAMES = ("Zw", "Zq", "Zde", "Mw", "Mq", "Mde")
PUBLISHED = np.array([-1.4249, -1.4768, -6.2632, 0.2163, -3.7067, -12.784])
START = np.array([-1.22871, -1.4768, -4.20491, 0.116197, -2.7067, -18.7718])  # the author's
DT = 0.05
DATA = np.loadtxt(
    TESTS / "reference" / "unstable_aircraft.csv", delimiter=",", comments="#", skiprows=3
)
W, Q, DE, AZ = DATA.T
MEASURED = np.column_stack([AZ, W, Q])


def rate(x, u, theta):
    return np.array(
        [
            theta[0] * x[0] + (44.57 + theta[1]) * x[1] + theta[2] * u[0],
            theta[3] * x[0] + theta[4] * x[1] + theta[5] * u[0],
        ]
    )


def observe(x, u, theta):
    return np.array([theta[0] * x[0] + theta[1] * x[1] + theta[2] * u[0], x[0], x[1]])


def simulate(theta, elevator, constant=False):
    x, out = np.zeros(2), []
    for k, current in enumerate(elevator):
        out.append(observe(x, [current], theta))
        previous = current if constant or k + 1 == len(elevator) else elevator[k + 1]
        middle = 0.5 * (current + previous)
        k1 = rate(x, [current], theta)
        k2 = rate(x + 0.5 * DT * k1, [middle], theta)
        k3 = rate(x + 0.5 * DT * k2, [middle], theta)
        x = x + DT / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rate(x + DT * k3, [previous], theta))
    return np.array(out)


def test_equation_error_gives_the_published_constants_to_their_last_digit():
    result = equation_error(DATA[:, :3], AZ, names=NAMES[:3])
    np.testing.assert_allclose(result.theta, PUBLISHED[:3], atol=5e-5)
    assert (result.std < 1e-5).all()


def test_stepwise_takes_what_the_published_equation_has_and_nothing_else():
    more = [W * Q, W**2, DE**2, np.ones_like(W), np.abs(Q)]
    noisy = AZ + 0.05 * np.random.default_rng(3).standard_normal(AZ.size)
    assert stepwise(np.column_stack([DATA[:, :3], *more]), noisy, keep=(0, 1)).selected == [0, 1, 2]


@pytest.mark.slow
def test_filter_error_agrees_within_its_bounds_from_the_authors_start():
    fit = filter_error(
        rate,
        observe,
        np.zeros(2),
        START,
        DE[:, None],
        MEASURED,
        np.arange(W.size) * DT,
        names=NAMES,
    )
    assert fit.converged
    assert (np.abs(fit.theta - PUBLISHED) < 2.0 * fit.std).all()
    np.testing.assert_allclose(fit.theta, PUBLISHED, rtol=2e-3)


@pytest.mark.parametrize(
    "start", [START, 1.5 * PUBLISHED, np.zeros(6)], ids=["author's", "half off", "zero"]
)
def test_output_error_of_an_unstable_aircraft_comes_home_from_far_off(start):
    noise = np.array([0.05, 0.03, 0.005])
    measured = simulate(PUBLISHED, DE) + noise * np.random.default_rng(5).standard_normal(
        MEASURED.shape
    )
    fit = output_error(lambda theta: simulate(theta, DE), start, measured, names=NAMES)
    assert fit.converged
    assert (np.abs(fit.theta - PUBLISHED) < 3.0 * fit.std).all()
    assert not any(w.startswith("coloured") for w in fit.warnings)


def test_output_error_is_as_near_as_its_input_between_samples_allows():
    constant, level = (
        output_error(
            lambda theta, constant=constant: simulate(theta, DE, constant),
            START,
            MEASURED,
            names=NAMES,
        )
        for constant in (True, False)
    )
    np.testing.assert_allclose(level.theta, PUBLISHED, rtol=0.03)
    assert not np.allclose(constant.theta, PUBLISHED, rtol=0.15)
