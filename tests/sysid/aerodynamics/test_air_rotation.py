"""The air's rotation found in residuals, against gusts that are drawn and whose rotation is
integrated here.
"""

from __future__ import annotations

import numpy as np
import pytest

from sysid.aerodynamics.air_motion import (
    CHANNELS,
    ROLLING,
    AirPiece,
    air_pieces,
    with_channels_of,
    without_air_rotation,
)
from sysid.aerodynamics.coefficients import half_width, smooth
from sysid.aerodynamics.residuals import Cutoffs, Piece, PieceNoise, ResidualPiece, Residuals
from sysid.aerodynamics.sensor_noise import autocorrelation
from sysid.record import FlightRecord

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


def flown(seed, gusts_std=0.002, rotating=1.0, noise=True, bank=0.0):
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
    felt = change - weight + np.cross(rates, np.column_stack([u, v, w]))
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
        zip(CHANNELS, (zero + V, alpha, beta, zero, q, r, zero + bank, zero, *felt.T), strict=True)
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
    residuals, air, _ = flown(1, bank=bank)
    still, found = without_air_rotation(residuals, air, (0.0, 0.0, 0.0), STD)
    assert found.share == pytest.approx(1.0, abs=0.06)
    for j in (4, 5):
        assert rms(still, j) < 0.35 * rms(residuals, j)
    # Told the opposite bank, a good part of it would be left: the axes count.
    if bank:
        turned = [
            AirPiece({**a.channels, "phi_rad": -a.channels["phi_rad"]}, a.slopes, B) for a in air
        ]
        other, _ = without_air_rotation(residuals, turned, (0.0, 0.0, 0.0), STD)
        assert rms(other, 5) > 2.0 * rms(still, 5)


def test_air_that_does_not_rotate_is_left_as_it_is():
    residuals, air, _ = flown(2, rotating=0.0)
    still, found = without_air_rotation(residuals, air, (0.0, 0.0, 0.0), STD)
    assert abs(found.share) < 4.0 * found.std
    assert rms(still, 4) == pytest.approx(rms(residuals, 4), rel=0.02)


def test_a_share_between_is_found_as_such():
    residuals, air, _ = flown(3, rotating=0.5)
    _, found = without_air_rotation(residuals, air, (0.0, 0.0, 0.0), STD)
    assert found.share == pytest.approx(0.5, abs=0.05)


def test_calm_air_has_no_gusts_whatever_the_vanes_noise():
    residuals, air, _ = flown(4, gusts_std=0.0)
    still, found = without_air_rotation(residuals, air, (0.0, 0.0, 0.0), STD)
    assert found.level == 0.0
    assert np.array_equal(still.delta, residuals.delta)
    assert all(p.noise is not None and not p.noise.passages for p in still.pieces)
    # With a figure three times too small the vanes' noise passes for gusts.
    _, found = without_air_rotation(
        residuals, air, (0.0, 0.0, 0.0), {c: s / 3.0 for c, s in STD.items()}
    )
    assert found.level > 0.0


def test_the_level_is_that_of_the_gradient_and_rolling_has_the_size_that_follows_from_it():
    residuals, air, _x = flown(5, gusts_std=0.004)
    still, found = without_air_rotation(residuals, air, (0.0, 0.0, 0.0), STD)
    white = (0.004 / DT) ** 2  # of the change from sample to sample
    assert found.level == pytest.approx(white, rel=0.15)
    (rolling,) = still.pieces[0].noise.passages
    assert rolling.channel == ROLLING
    assert not rolling.gain[:, [0, 1, 2, 4, 5]].any()
    # White noise of that level through a lag of 4b/(pi V), drawn.
    time_s = 4 * B / np.pi / V
    size = np.sqrt(0.8 * np.pi / 3 * (np.pi * 100 / (4 * B)) ** (1 / 3) * white)
    rng = np.random.default_rng(6)
    drawn = smooth(lagged(size * rng.standard_normal(40 * N), time_s), DT, CUT.all_hz)[1000:-1000]
    variance = float(np.mean(rolling.gain[:, 3] ** 2)) * autocorrelation(rolling.weights)[0]
    assert variance == pytest.approx(Cl_p**2 * np.var(drawn), rel=0.2)
    assert variance != pytest.approx(Cl_p**2 * np.var(drawn) * 2.0, rel=0.2)


def test_slopes_are_asked_of_the_model_and_channels_can_be_replaced():
    from tests.sysid.aerodynamics.test_sensor_noise import flight, predict

    record, pieces = flight(300)
    (air,) = air_pieces(record, pieces, predict, float("inf"))
    assert air.slopes[:, 1, 4] == pytest.approx(-10 * 0.53 / (2 * record["V_mps"]))
    assert air.slopes[:, 0, 3] == pytest.approx(-0.2 * 3.66 / (2 * record["V_mps"]))
    assert not air.slopes[:, 0, 4].any()
    moved = FlightRecord({c: record[c] + (c == "alpha_rad") for c in record.columns})
    (other,) = with_channels_of([air], moved, [Piece("m", slice(0, 300), 0.0, 6.0)], float("inf"))
    assert other.channels["alpha_rad"] == pytest.approx(air.channels["alpha_rad"] + 1.0)
    assert other.slopes is air.slopes
