"""The filter's gust states against the gusts themselves, carried through an aircraft's motion."""

import numpy as np
import pytest

from sysid.aerodynamics.air_motion import GustStates
from sysid.aerodynamics.flight_equations import flow_rates, sines

B, DT, N = 3.66, 1e-3, 4000
V0 = 21.0


def motion():
    """A banked, rolling, pitching, turning path: phi, dphi, theta, dtheta, dpsi (N,); V0 over the
    ground, along the heading.
    """
    t = np.arange(N) * DT
    phi, theta = 0.4 + 0.3 * np.sin(2.0 * t), 0.15 * np.sin(1.3 * t)
    return phi, 0.6 * np.cos(2.0 * t), theta, 0.195 * np.cos(1.3 * t), 9.81 / V0 * np.tan(phi)


def gusts(rng, strength=0.5):
    """u_h, v_h, w_h (N,) as random walks from still air, m/s."""
    walk = np.cumsum(rng.normal(size=(3, N)) * np.sqrt(DT) * strength, axis=1)
    return walk - walk[:, :1]


def body_axes(phi, theta):
    """(3, 3) heading axes to body axes."""
    sf, cf, st, ct = np.sin(phi), np.cos(phi), np.sin(theta), np.cos(theta)
    return np.array([[ct, 0.0, -st], [sf * st, cf, sf * ct], [cf * st, -sf, cf * ct]])


def seen(k, u, v, w, path):
    """V, alpha, beta in gusts of heading axes."""
    phi, _, theta, _, _ = path
    x, y, z = body_axes(phi[k], theta[k]) @ [V0 - u[k], -v[k], -w[k]]
    V = np.sqrt(x * x + y * y + z * z)
    return V, np.arctan2(z, x), np.arcsin(y / V)


def carried(u, v, w, passing=0.0):
    """q_h, r_h of the states and of their definition, for V, alpha and beta that come from gusts
    (u, v, w) alone.
    """
    path = phi, dphi, theta, dtheta, dpsi = motion()
    states = GustStates(B, passing)
    x = np.array([*seen(0, u, v, w, path), 0, 0, 0, phi[0], theta[0]])
    still = np.array([*seen(0, 0 * u, 0 * v, 0 * w, path), 0, 0, 0, phi[0], theta[0]])
    x = np.array([*x, *states.start(still)])
    q, r, found, defined = 0.0, 0.0, [], []
    for k in range(N - 1):
        x[:3], x[6], x[7] = seen(k, u, v, w, path), phi[k], theta[k]
        # Level turns: body rates of a heading that turns, and of what changes the attitude.
        x[3:6] = body_axes(phi[k], theta[k]) @ [0.0, 0.0, dpsi[k]]
        x[3:6] += [dphi[k], dtheta[k] * np.cos(phi[k]), -dtheta[k] * np.sin(phi[k])]
        found.append(states.level(x)[1:])
        defined.append((q, r))
        # The ground velocity turns with the heading; weight and lift are in what turns it.
        level_turn = body_axes(phi[k], theta[k]) @ [0.0, V0 * dpsi[k], 0.0]
        felt = tuple(a + b for a, b in zip(level_turn, states.turning(x), strict=True))
        trig = sines(x)
        rated = (*flow_rates(x, felt, trig, 0.0), dphi[k], dtheta[k])
        x[8:] = x[8:] + DT * np.array(states.rates(x, rated))
        speed = passing or x[0]
        q += (-q * DT * speed - (w[k + 1] - w[k])) / (
            4.0 * B / np.pi
        )  # 3.7.5: q = -dw/dx behind a lag
        r += (-r * DT * speed + (v[k + 1] - v[k])) / (3.0 * B / np.pi)  # 3.7.5: r = +dv/dx
    return np.array(found), np.array(defined)


@pytest.mark.parametrize("strength", [0.5, 3.0])
def test_rotation_follows_from_what_changes_alpha_and_beta(strength):
    u, v, w = gusts(np.random.default_rng(0), strength)
    found, defined = carried(u, v, w)
    assert defined.std(axis=0).min() > 0.04 * strength
    np.testing.assert_allclose(found, defined, atol=0.01 * defined.std())
    wrong, _ = carried(u, -v, w)
    assert np.abs(wrong[:, 1] - defined[:, 1]).max() > defined.std()


def test_gusts_that_pass_at_a_speed_of_their_own():
    u, v, w = gusts(np.random.default_rng(1))
    found, defined = carried(u, v, w, passing=15.0)
    np.testing.assert_allclose(found, defined, atol=0.01 * defined.std())
    at_airspeed, _ = carried(u, v, w)
    assert np.abs(at_airspeed - defined).max() > 0.2 * defined.std()


def test_no_gust_changes_a_state_of_the_air_at_once():
    rng = np.random.default_rng(2)
    states, path = GustStates(B), motion()
    before, after = (rng.normal(size=3) for _ in range(2))
    x, y = (
        np.array([*seen(5, *np.outer(g, np.ones(N)), path), 0.0, 0.0, 0.0, path[0][5], path[2][5]])
        for g in (before, after)
    )
    W = states.start(y)[1] - states.start(x)[1]
    # Air that moves down by so much more makes W less by that; h_q as it was, q_h has turned.
    assert pytest.approx(after[2] - before[2]) == W
    held = [states.level(np.array([*z, *states.start(x)]))[1] for z in (x, y)]
    np.testing.assert_allclose(held, [0.0, -(after[2] - before[2]) / (4.0 * B / np.pi)], atol=1e-12)


def test_gusts_turn_with_the_heading():
    # Air at (u, v) along and across a heading that turns at dpsi: its velocity over the ground
    # changes by dpsi x (u, v).
    states, dpsi, u, v, phi, theta = GustStates(B), 0.3, 1.5, -0.8, 0.5, 0.2
    own = np.array([V0, 0.04, -0.03, 0.0, 0.0, 0.0, phi, theta])
    own[3:6] = body_axes(phi, theta) @ [0.0, 0.0, dpsi]
    x = np.array([*own, *states.start(own)])
    np.testing.assert_allclose(states.turning(x), 0.0, atol=1e-14)
    x[11:] += u, v
    # d/dt of (u cos psi - v sin psi, u sin psi + v cos psi) along the axes, and less of it relative
    # to the air
    np.testing.assert_allclose(
        states.turning(x), body_axes(phi, theta) @ [v * dpsi, -u * dpsi, 0.0], atol=1e-14
    )
    assert not np.any(states._replace(turning_with=False).turning(x))


def test_body_axes_are_the_heading_axes_pitched_and_banked():
    states = GustStates(B)
    own = np.array([21.0, 0.03, -0.02, 0.1, 0.2, 0.3, 0.5, 0.2])
    x = np.array([*own, *states.start(own)])
    np.testing.assert_allclose(states.rotation(x), 0.0, atol=1e-12)
    x[8] = 0.1
    np.testing.assert_allclose(
        states.rotation(x),
        0.1 * np.array([np.cos(0.2), np.sin(0.5) * np.sin(0.2), np.cos(0.5) * np.sin(0.2)]),
    )
