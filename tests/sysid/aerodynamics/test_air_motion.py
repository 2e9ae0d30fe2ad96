"""Rotation of turbulent air: found in residuals of drawn gusts, and carried as filter states."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.aerodynamics.air_motion import (
    CHANNELS,
    ROLLING,
    AirPiece,
    GustStates,
    without_air_rotation,
)
from sysid.aerodynamics.coefficients import half_width, smooth
from sysid.aerodynamics.flight_equations import flow_rates, sines
from sysid.aerodynamics.residuals import Cutoffs, PieceNoise, ResidualPiece, Residuals
from sysid.aerodynamics.sensor_noise import autocorrelation

DT, N, V, B, G = 0.02, 6000, 21.0, 3.66, 9.80665
Cm_q, Cn_r, Cl_p = -0.35, -0.02, -0.045  # [s/rad], as slopes with the rates themselves
STD = {"alpha_rad": 0.0017, "beta_rad": 0.0017, "q_radps": 0.0035, "az_mps2": 0.16, "V_mps": 0.1}
CUT = Cutoffs()


def gust(rng, std):
    """Wind angle of gusts whose gradient is nearly white, of first order over 5 s; and (N,) its
    change from sample to sample.
    """
    x = np.zeros(N)
    for k in range(1, N):
        x[k] = x[k - 1] * (1 - DT / 5.0) + std * rng.standard_normal()
    return x, np.diff(x, prepend=0.0) / DT


def lagged(x, time_s):
    """T y. = -y + x, by Heun's rule."""
    y = np.zeros(len(x))
    for k in range(1, len(x)):
        first = (x[k - 1] - y[k - 1]) / time_s
        second = (x[k] - y[k - 1] - DT * first) / time_s
        y[k] = y[k - 1] + 0.5 * DT * (first + second)
    return y


def fly(seed, gusts_std=0.002, rotating=1.0, noise=True, bank=0.0):
    """Residuals and air of a level weave in gusts; what the air's rotation added to Cm; rate of the
    gust's gradient.
    """
    rng = np.random.default_rng(seed)
    t = DT * np.arange(N)
    alpha_i, beta_i = 0.05 + 0.03 * np.sin(0.9 * t), 0.02 * np.sin(0.6 * t)
    (a, da), (b, db) = gust(rng, gusts_std), gust(rng, gusts_std)
    alpha, beta = alpha_i + a, beta_i + b
    q, r = 0.05 * np.sin(1.3 * t), 0.04 * np.cos(0.8 * t)
    rates = np.column_stack([0 * t, q, r])
    u, v, w = V * np.cos(alpha) * np.cos(beta), V * np.sin(beta), V * np.sin(alpha) * np.cos(beta)
    da_i, db_i = 0.027 * np.cos(0.9 * t), 0.012 * np.cos(0.6 * t)
    # Velocity changes as inertial angles do, at constant speed: alpha. and beta. of (u, v, w) as
    # the vanes see it.
    ca, sa, cb, sb = np.cos(alpha), np.sin(alpha), np.cos(beta), np.sin(beta)
    change = V * np.column_stack(
        [-sa * cb * da_i - ca * sb * db_i, cb * db_i, ca * cb * da_i - sa * sb * db_i]
    )
    weight = G * np.array([0.0, np.sin(bank), np.cos(bank)])
    sensed = change - weight + np.cross(rates, np.column_stack([u, v, w]))
    x, y = np.cos(bank) * da + np.sin(bank) * db, np.sin(bank) * da - np.cos(bank) * db
    qh, rh = lagged(x, 4 * B / np.pi / V), lagged(y, 3 * B / np.pi / V)
    q_air, r_air = np.cos(bank) * qh + np.sin(bank) * rh, -np.sin(bank) * qh + np.cos(bank) * rh
    delta = np.zeros((N, 6))
    delta[:, 4], delta[:, 5] = -Cm_q * q_air, -Cn_r * r_air
    delta = rotating * smooth(delta, DT, CUT.all_hz) + 1e-5 * smooth(
        rng.standard_normal((N, 6)), DT, CUT.all_hz
    )
    zero = np.zeros(N)
    columns = dict(
        zip(
            CHANNELS, (zero + V, alpha, beta, zero, q, r, zero + bank, zero, *sensed.T), strict=True
        )
    )
    if noise:
        columns |= {c: columns[c] + s * rng.standard_normal(N) for c, s in STD.items()}
    slopes = np.zeros((N, 3, 6))
    slopes[:, 0, 3], slopes[:, 1, 4], slopes[:, 2, 5] = Cl_p, Cm_q, Cn_r
    m = half_width(DT, CUT.all_hz)
    rows = [slice(k, k + 600) for k in range(0, N, 600)]
    pieces = tuple(
        ResidualPiece("m", t[s][m:-m], delta[s][m:-m], {}, 0, PieceNoise((), {}, 600 - 2 * m))
        for s in rows
    )
    air = [AirPiece({c: x[s] for c, x in columns.items()}, slopes[s], B) for s in rows]
    return Residuals(pieces, DT, CUT), air, x


def rms(residuals, j):
    return float(np.sqrt(np.mean(residuals.delta[:, j] ** 2)))


@pytest.mark.parametrize("bank", [0.0, 0.5])
def test_rotation_that_is_there_is_found_and_taken_out(bank):
    residuals, air, _ = fly(1, bank=bank)
    steady, result = without_air_rotation(residuals, air, (0.0, 0.0, 0.0), STD)
    assert result.share == pytest.approx(1.0, abs=0.06)
    for j in (4, 5):
        assert rms(steady, j) < 0.35 * rms(residuals, j)
    # Told the opposite bank, a good part of it would be left: the axes count.
    if bank:
        turned = [
            AirPiece({**a.channels, "phi_rad": -a.channels["phi_rad"]}, a.slopes, B) for a in air
        ]
        other, _ = without_air_rotation(residuals, turned, (0.0, 0.0, 0.0), STD)
        assert rms(other, 5) > 2.0 * rms(steady, 5)


def test_calm_air_has_no_gusts_whatever_the_vanes_noise():
    residuals, air, _ = fly(4, gusts_std=0.0)
    steady, result = without_air_rotation(residuals, air, (0.0, 0.0, 0.0), STD)
    assert result.level == 0.0
    assert np.array_equal(steady.delta, residuals.delta)
    assert all(p.noise is not None and not p.noise.passages for p in steady.pieces)
    # With a figure three times too small the vanes' noise passes for gusts.
    _, result = without_air_rotation(
        residuals, air, (0.0, 0.0, 0.0), {c: s / 3.0 for c, s in STD.items()}
    )
    assert result.level > 0.0


def test_the_level_is_that_of_the_gradient_and_rolling_has_the_size_that_follows_from_it():
    residuals, air, _x = fly(5, gusts_std=0.004)
    steady, result = without_air_rotation(residuals, air, (0.0, 0.0, 0.0), STD)
    white = (0.004 / DT) ** 2  # of the change from sample to sample
    assert result.level == pytest.approx(white, rel=0.15)
    (rolling,) = steady.pieces[0].noise.passages
    assert rolling.channel == ROLLING
    assert not rolling.gain[:, [0, 1, 2, 4, 5]].any()
    # White noise of that level through a lag of 4b/(pi V), drawn.
    time_s = 4 * B / np.pi / V
    size = np.sqrt(0.8 * np.pi / 3 * (np.pi * 100 / (4 * B)) ** (1 / 3) * white)
    rng = np.random.default_rng(6)
    drawing = smooth(lagged(size * rng.standard_normal(40 * N), time_s), DT, CUT.all_hz)[1000:-1000]
    variance = float(np.mean(rolling.gain[:, 3] ** 2)) * autocorrelation(rolling.weights)[0]
    assert variance == pytest.approx(Cl_p**2 * np.var(drawing), rel=0.2)
    assert variance != pytest.approx(Cl_p**2 * np.var(drawing) * 2.0, rel=0.2)


# The filter's gust states against the gusts themselves, carried through an aircraft's motion.

GUST_STATES_B, GUST_STATES_DT, GUST_STATES_N = 3.66, 1e-3, 4000
V0 = 21.0


def motion():
    """A banked, rolling, pitching, turning path: phi, dphi, theta, dtheta, dpsi (N,); V0 over the
    ground, along the heading.
    """
    t = np.arange(GUST_STATES_N) * GUST_STATES_DT
    phi, theta = 0.4 + 0.3 * np.sin(2.0 * t), 0.15 * np.sin(1.3 * t)
    return phi, 0.6 * np.cos(2.0 * t), theta, 0.195 * np.cos(1.3 * t), 9.81 / V0 * np.tan(phi)


def gusts(rng, strength=0.5):
    """u_h, v_h, w_h (N,) as random walks from still air, m/s."""
    walk = np.cumsum(
        rng.normal(size=(3, GUST_STATES_N)) * np.sqrt(GUST_STATES_DT) * strength, axis=1
    )
    return walk - walk[:, :1]


def body_axes(phi, theta):
    """(3, 3) heading axes to body axes."""
    sf, cf, st, ct = np.sin(phi), np.cos(phi), np.sin(theta), np.cos(theta)
    return np.array([[ct, 0.0, -st], [sf * st, cf, sf * ct], [cf * st, -sf, cf * ct]])


def observe(k, u, v, w, path):
    """V, alpha, beta in gusts of heading axes."""
    phi, _, theta, _, _ = path
    x, y, z = body_axes(phi[k], theta[k]) @ [V0 - u[k], -v[k], -w[k]]
    V = np.sqrt(x * x + y * y + z * z)
    return V, np.arctan2(z, x), np.arcsin(y / V)


def transport(u, v, w, passing=0.0, psi=None):
    """q_h, r_h of the states and of their definition, for V, alpha and beta that come from gusts
    (u, v, w) alone: in heading axes, or in those of an azimuth, from which the first heading is
    psi.
    """
    path = phi, dphi, theta, dtheta, dpsi = motion()
    states, across = GustStates(GUST_STATES_B, passing), v
    if psi is not None:
        states = states._replace(turning_with=False, in_earth=True, psi_rad=psi)
        at = psi + GUST_STATES_DT * np.append(0.0, np.cumsum(dpsi))[: len(u)]
        u, v = np.cos(at) * u + np.sin(at) * v, np.cos(at) * v - np.sin(at) * u
    x = np.array([*observe(0, u, v, w, path), 0, 0, 0, phi[0], theta[0]])
    steady = np.array([*observe(0, 0 * u, 0 * v, 0 * w, path), 0, 0, 0, phi[0], theta[0]])
    x = np.array([*x, *states.start(steady)])
    q, r, result, defined = 0.0, 0.0, [], []
    for k in range(GUST_STATES_N - 1):
        x[:3], x[6], x[7] = observe(k, u, v, w, path), phi[k], theta[k]
        # Level turns: body rates of a heading that turns, and of what changes the attitude.
        x[3:6] = body_axes(phi[k], theta[k]) @ [0.0, 0.0, dpsi[k]]
        x[3:6] += [dphi[k], dtheta[k] * np.cos(phi[k]), -dtheta[k] * np.sin(phi[k])]
        result.append(states.level(x)[1:])
        defined.append((q, r))
        # The ground velocity turns with the heading; weight and lift are in what turns it.
        level_turn = body_axes(phi[k], theta[k]) @ [0.0, V0 * dpsi[k], 0.0]
        sensed = tuple(a + b for a, b in zip(level_turn, states.turning(x), strict=True))
        trig = sines(x)
        rated = (*flow_rates(x, sensed, trig, 0.0), dphi[k], dtheta[k])
        x[8:] = x[8:] + GUST_STATES_DT * np.array(states.rates(x, rated))
        # Gusts of heading axes pass at the speed through the mean air and the gust down, which is
        # no state; those of JSBSim at V.
        speed = passing or (np.hypot(V0, w[k]) if psi is None else x[0])
        q += (-q * GUST_STATES_DT * speed - (w[k + 1] - w[k])) / (
            4.0 * GUST_STATES_B / np.pi
        )  # 3.7.5: q = -dw/dx behind a lag
        r += (-r * GUST_STATES_DT * speed + (across[k + 1] - across[k])) / (
            3.0 * GUST_STATES_B / np.pi
        )  # 3.7.5: r = +dv/dx
    return np.array(result), np.array(defined)


@pytest.mark.parametrize("strength", [0.5, 3.0])
def test_rotation_follows_from_what_changes_alpha_and_beta(strength):
    u, v, w = gusts(np.random.default_rng(0), strength)
    result, defined = transport(u, v, w)
    assert defined.std(axis=0).min() > 0.04 * strength
    np.testing.assert_allclose(result, defined, atol=0.01 * defined.std())
    invalid, _ = transport(u, -v, w)
    assert np.abs(invalid[:, 1] - defined[:, 1]).max() > defined.std()


def test_gusts_that_pass_at_a_speed_of_their_own():
    u, v, w = gusts(np.random.default_rng(1))
    result, defined = transport(u, v, w, passing=15.0)
    np.testing.assert_allclose(result, defined, atol=0.01 * defined.std())
    at_airspeed, _ = transport(u, v, w)
    assert np.abs(at_airspeed - defined).max() > 0.2 * defined.std()


def test_gusts_and_rotation_in_axes_of_one_azimuth():
    u, v, w = gusts(np.random.default_rng(2))
    result, defined = transport(u, v, w, psi=2.0)
    np.testing.assert_allclose(result, defined, atol=0.02 * defined.std())
    # A quarter of a turn from the axes, their pitch rolls the aircraft.
    across = GustStates(GUST_STATES_B, turning_with=False, in_earth=True, psi_rad=0.5 * np.pi)
    level_flight = np.array([V0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    x = np.array([*level_flight, *across.start(level_flight)])
    np.testing.assert_allclose(across.rotation(x), 0.0, atol=1e-14)
    x[9] += 0.1 * 4.0 * GUST_STATES_B / np.pi
    np.testing.assert_allclose(across.rotation(x), [0.1, 0.0, 0.0], atol=1e-14)


def test_gusts_turn_with_the_heading():
    # Air at (u, v) along and across a heading that turns at dpsi: its velocity over the ground
    # changes by dpsi x (u, v).
    states, dpsi, u, v, phi, theta = GustStates(GUST_STATES_B), 0.3, 1.5, -0.8, 0.5, 0.2
    specific = np.array([V0, 0.04, -0.03, 0.0, 0.0, 0.0, phi, theta])
    specific[3:6] = body_axes(phi, theta) @ [0.0, 0.0, dpsi]
    x = np.array([*specific, *states.start(specific)])
    np.testing.assert_allclose(states.turning(x), 0.0, atol=1e-14)
    x[11:] += u, v
    # d/dt of (u cos psi - v sin psi, u sin psi + v cos psi) along the axes, and less of it relative
    # to the air
    np.testing.assert_allclose(
        states.turning(x), body_axes(phi, theta) @ [v * dpsi, -u * dpsi, 0.0], atol=1e-14
    )
    assert not np.any(states._replace(turning_with=False).turning(x))


def test_gusts_turn_with_the_body():
    gust, rates = np.array([1.5, -0.8, 0.6]), np.array([0.4, -0.3, 0.2])
    states = GustStates(GUST_STATES_B, in_body=True, ahead_mps=gust[0])
    specific = np.array([V0, 0.04, -0.03, *rates, 0.5, 0.2])
    x = np.array([*specific, *states.start(specific)])
    x[11:] += gust[1:]
    u, v, w = -np.cross(rates, gust)
    np.testing.assert_allclose(states.turning(x), [u, v, w], atol=1e-14)
