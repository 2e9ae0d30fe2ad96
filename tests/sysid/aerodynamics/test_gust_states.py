"""The filter's gust states against the gusts themselves, carried through an aircraft's motion."""

import numpy as np
import pytest

from sysid.aerodynamics.gust_states import NOISE_START, NOISY, STATE_STD, GustStates

B, DT, N = 3.66, 1e-3, 4000


def motion():
    """A banked, rolling, turning path: V, phi, dphi, dpsi (N,); theta is 0 and the ground velocity along the heading is V."""
    t = np.arange(N) * DT
    phi = 0.4 + 0.3 * np.sin(2.0 * t)
    return 21.0, phi, 0.6 * np.cos(2.0 * t), 9.81 / 21.0 * np.tan(phi)


def gusts(rng):
    """u_h, v_h, w_h (N,) as random walks, m/s."""
    return np.cumsum(rng.normal(size=(3, N)) * np.sqrt(DT) * 0.5, axis=1)


def carried(u, v, w, passing=None):
    """q_h, r_h of the states and of their definition, for alpha and beta that come from gusts (u, v, w) alone."""
    V, phi, dphi, dpsi = motion()
    states = GustStates(B, passing)
    _, T_q, T_r = states.lags_s(V)
    alpha = -(w * np.cos(phi) - v * np.sin(phi)) / V
    beta = -(v * np.cos(phi) + w * np.sin(phi)) / V
    x = np.array([V, alpha[0], beta[0], 0, 0, 0, phi[0], 0, *states.start(V, alpha[0], beta[0], phi[0])])
    x[11], x[12] = V + u[0], x[12] + v[0] / V
    q, r, found, defined = 0.0, 0.0, [], []
    for k in range(N - 1):
        x[0], x[1], x[2], x[6] = V, alpha[k], beta[k], phi[k]
        x[4], x[5] = dpsi[k] * np.sin(phi[k]), dpsi[k] * np.cos(phi[k])
        found.append(states.level(x)[1:])
        defined.append((q, r))
        # Between gusts, alpha and beta change as the gusts' components along turning, banking axes do.
        dalpha = dphi[k] * (w[k] * np.sin(phi[k]) + v[k] * np.cos(phi[k])) / V
        dbeta = -dphi[k] * (w[k] * np.cos(phi[k]) - v[k] * np.sin(phi[k])) / V
        x[8:] = x[8:] + DT * np.array(states.rates(x, (0.0, dalpha, dbeta, dphi[k])))
        q += (-q * DT - (w[k + 1] - w[k]) / (passing or V)) / T_q  # 3.7.5: q = -dw/dx behind a lag
        r += (-r * DT + (v[k + 1] - v[k]) / (passing or V)) / T_r  # 3.7.5: r = +dv/dx
    return np.array(found), np.array(defined)


def test_rotation_follows_from_what_changes_alpha_and_beta():
    u, v, w = gusts(np.random.default_rng(0))
    found, defined = carried(u, v, w)
    assert defined.std(axis=0).min() > 0.02
    np.testing.assert_allclose(found, defined, atol=0.03 * defined.std())
    wrong, _ = carried(u, -v, w)
    assert np.abs(wrong[:, 1] - defined[:, 1]).max() > defined.std()


def test_gusts_that_pass_at_a_speed_of_their_own():
    u, v, w = gusts(np.random.default_rng(1))
    found, defined = carried(u, v, w, passing=15.0)
    np.testing.assert_allclose(found, defined, atol=0.04 * defined.std())
    at_airspeed, _ = carried(u, v, w)
    assert np.abs(at_airspeed - defined).max() > 0.5 * defined.std()


def test_gusts_turn_with_the_heading():
    # Air at (u, v) along and across a heading that turns at dpsi: its velocity over the ground changes by dpsi x (u, v).
    states, V, dpsi, u, v, phi = GustStates(B), 21.0, 0.3, 1.5, -0.8, 0.5
    x = np.array([V, 0.0, 0.0, 0.0, dpsi * np.sin(phi), dpsi * np.cos(phi), phi, 0.0, *states.start(V, 0.0, 0.0, phi)])
    np.testing.assert_allclose(states.turning(x), 0.0)
    x[11], x[12] = V + u, x[12] + v / V
    dV, dalpha, dbeta = states.turning(x)
    ahead, right = -v * dpsi, u * dpsi  # d/dt of (u cos psi - v sin psi, u sin psi + v cos psi) along the axes
    assert dV == pytest.approx(-ahead)
    assert dbeta == pytest.approx(-right * np.cos(phi) / V)
    assert dalpha == pytest.approx(right * np.sin(phi) / V)


def test_body_axes_are_the_heading_axes_pitched_and_banked():
    states = GustStates(B)
    x = np.array([21.0, 0.03, -0.02, 0.1, 0.2, 0.3, 0.5, 0.2, 0.0, 0.0, 0.0, 21.0, 0.0])
    x[8:11] = states.start(21.0, 0.03, -0.02, 0.5)[:3]
    np.testing.assert_allclose(states.rotation(x), 0.0, atol=1e-12)
    x[8] = 0.1
    np.testing.assert_allclose(
        states.rotation(x), 0.1 * np.array([np.cos(0.2), np.sin(0.5) * np.sin(0.2), np.cos(0.5) * np.sin(0.2)])
    )


def test_sizes_agree():
    assert len(STATE_STD) == len(NOISE_START) == 8 + len(GustStates(B).start(20.0, 0.0, 0.0, 0.0))
    assert max(NOISY) < 9
