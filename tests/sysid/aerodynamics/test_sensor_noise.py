"""Variance of sensor noise in residual coefficients, against drawn noise through the same
filters.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import fft, linalg

from sysid.aerodynamics.coefficients import MassProperties, kernel
from sysid.aerodynamics.residuals import Cutoffs, Piece, Prediction, residual_coefficients
from sysid.aerodynamics.sensor_noise import (
    NOISY_CHANNELS,
    autocorrelation,
    cosine_variance,
    noise_cosines,
    noise_variance,
    with_noise_of,
    with_sensor_noise,
)
from sysid.record import FlightRecord

DT = 0.02
STD = {
    "V_mps": 0.5,
    "alpha_rad": 0.0017,
    "beta_rad": 0.0017,
    "p_radps": 0.0035,
    "q_radps": 0.0035,
    "r_radps": 0.0035,
    "ax_mps2": 0.16,
    "ay_mps2": 0.16,
    "az_mps2": 0.16,
}
MASS = MassProperties(
    20.0, np.array([[5.0, 0.0, -0.8], [0.0, 6.0, 0.0], [-0.8, 0.0, 10.0]]), 1.97, 3.66, 0.53
)
ARM = (0.3, 0.1, -0.2)
AS_USUAL = Cutoffs()


def flight(n=900, speeds=(18.0, 26.0)):
    """A slow change of speed with a gentle weave: no channel at rest, every gain another one along
    the way.
    """
    t = DT * np.arange(n)
    columns = {
        "time_s": t,
        "V_mps": np.linspace(*speeds, n),
        "alpha_rad": 0.03 + 0.02 * np.sin(0.8 * t),
    }
    columns |= {
        "beta_rad": 0.02 * np.sin(0.5 * t),
        "phi_rad": 0.1 * np.sin(0.3 * t),
        "theta_rad": 0.05 + 0.0 * t,
    }
    columns |= {f"{a}_radps": 0.1 * np.cos((0.4 + 0.2 * k) * t) for k, a in enumerate("pqr")}
    columns |= {
        "ax_mps2": 0.5 + 0.0 * t,
        "ay_mps2": 0.2 * np.sin(0.5 * t),
        "az_mps2": -9.8 + np.sin(0.8 * t),
    }
    return FlightRecord(columns), [Piece("m", slice(0, n), 0.0, DT * (n - 1))]


def predict(record: FlightRecord, piece: Piece) -> Prediction:
    """A little aeroplane: lift, sideforce, damping, weathercock; qbar of the measured airspeed."""
    V, alpha, beta, p, q, r = (
        record[c][piece.rows]
        for c in ("V_mps", "alpha_rad", "beta_rad", "p_radps", "q_radps", "r_radps")
    )
    b, c = MASS.b / (2 * V), MASS.c / (2 * V)
    columns = [
        -0.03 + 2.0 * alpha**2,
        -0.3 * beta,
        -0.3 - 3.0 * alpha,
        -0.2 * p * b - 0.01 * beta,
        -0.4 * alpha - 10 * q * c,
        0.06 * beta - 0.4 * r * b,
    ]
    zero = np.zeros((len(V), 3))
    return Prediction(np.column_stack(columns), zero, zero, 0.6 * V**2, MASS, {})


def build(record, pieces, cutoffs=AS_USUAL, std=STD, arm=ARM):
    plain = residual_coefficients(record, pieces, predict, arm, cutoffs)
    return with_sensor_noise(
        plain, record, pieces, predict, arm, std, relative_std=dict.fromkeys(std, 0.1)
    )


def draw(record, pieces, repeats, cutoffs=AS_USUAL, std=STD):
    """Changes (repeats, n, 6) of the residuals under drawn noise."""
    plain = residual_coefficients(record, pieces, predict, ARM, cutoffs).delta
    out = []
    for seed in range(repeats):
        rng = np.random.default_rng(seed)
        noisy = record.with_columns(
            {c: record[c] + s * rng.standard_normal(len(record[c])) for c, s in std.items()}
        )
        out.append(residual_coefficients(noisy, pieces, predict, ARM, cutoffs).delta - plain)
    return np.array(out)


def test_the_variance_is_that_of_drawn_noise_at_every_speed():
    record, pieces = flight()
    (piece,) = build(record, pieces).pieces
    result = noise_variance(piece.noise)
    measured = np.mean(draw(record, pieces, 60) ** 2, axis=0)
    for part in np.array_split(np.arange(len(result)), 4):
        np.testing.assert_allclose(
            result[part].mean(axis=0), measured[part].mean(axis=0), rtol=0.12
        )
    # Accelerometers' noise goes as 1/qbar: at 18 m/s it is twice that at 26 m/s; one variance for
    # all would be seen.
    assert result[:100, 1].mean() > 3.0 * result[-100:, 1].mean()
    assert abs(result.mean(axis=0)[1] / measured[-200:].mean(axis=0)[1] - 1.0) > 0.3


@pytest.mark.parametrize("channel", NOISY_CHANNELS)
def test_each_channel_comes_through_by_itself(channel):
    record, pieces = flight()
    std = {channel: STD[channel]}
    (piece,) = build(record, pieces, std=std).pieces
    result, measured = (
        noise_variance(piece.noise).mean(axis=0),
        np.mean(draw(record, pieces, 25, std=std) ** 2, axis=(0, 1)),
    )
    # What comes by way of the square of the rates times the arm is left to its first order.
    np.testing.assert_allclose(result, measured, rtol=0.15, atol=1e-4 * measured.max())
    assert (result > 0.0).any()
    assert {p.channel for p in piece.noise.passages} == {channel}


def test_the_cosine_transforms_variances_are_those_of_drawn_noise():
    record, pieces = flight(300)
    (piece,) = build(record, pieces).pieces
    result, scatter = noise_cosines(piece.noise)
    waves = fft.dct(draw(record, pieces, 150), axis=1, norm="ortho")
    measured = np.mean(waves**2, axis=0)
    for part in (slice(1, 20), slice(20, 40), slice(40, 70)):
        np.testing.assert_allclose(
            result[part].mean(axis=0), measured[part].mean(axis=0), rtol=0.15
        )
    assert result.sum(axis=0) == pytest.approx(noise_variance(piece.noise).sum(axis=0))
    # All channels a tenth off, each in its own way: a variance is off by a fifth at most, and by
    # less where many share it.
    assert np.all((scatter > 0.08) & (scatter <= 0.2 + 1e-12))


@pytest.mark.parametrize("n", [1, 2, 3, 8, 61])
def test_variances_of_waves_are_those_of_the_dense_transform(n):
    """Row by row b' T b, T the covariance of the samples; with correlation shorter and longer than
    the series.
    """
    basis = fft.dct(np.eye(n), axis=0, norm="ortho")
    for correlation in (autocorrelation(tuple(kernel(4, DT))), tuple(0.9 ** np.arange(100))):
        lags = np.r_[correlation[:n], np.zeros(max(0, n - len(correlation)))]
        dense = np.diag(basis @ linalg.toeplitz(lags) @ basis.T)
        result = cosine_variance(n, correlation)
        np.testing.assert_allclose(result, dense, rtol=1e-10, atol=1e-13 * dense.max())
        assert n == 1 or not np.allclose(
            result, np.diag(basis @ linalg.toeplitz(0.9 * lags + 0.1 * lags[0]) @ basis.T)
        )


def test_another_filter_takes_the_gains_along():
    record, pieces = flight()
    used = build(record, pieces)
    for cutoffs in (Cutoffs(3.0), Cutoffs(12.0), Cutoffs(airspeed_hz=float("inf"))):
        plain = residual_coefficients(record, pieces, predict, ARM, cutoffs)
        selected = noise_variance(with_noise_of(plain, used).pieces[0].noise).mean(axis=0)
        request = noise_variance(build(record, pieces, cutoffs).pieces[0].noise).mean(axis=0)
        np.testing.assert_allclose(selected, request, rtol=0.02)
        assert (
            np.abs(selected / noise_variance(used.pieces[0].noise).mean(axis=0) - 1.0).max() > 0.1
        )


def test_channels_without_a_figure_are_free_of_noise():
    record, pieces = flight(200)
    for std in ({}, {"ax_mps2": float("nan"), "ay_mps2": 0.0}):
        noise = build(record, pieces, std=std).pieces[0].noise
        assert noise.passages == ()
        assert not noise_variance(noise).any()
    short = replace(pieces[0], rows=slice(0, 4))
    pair = with_sensor_noise(
        residual_coefficients(record, [short, *pieces], predict, ARM),
        record,
        [short, *pieces],
        predict,
        ARM,
        STD,
    )
    assert len(pair.pieces) == 1


def test_a_flight_at_rest_by_hand():
    """The smoother's weights are .1 .25 .3 .25 .1, a slope's (-2 -1 0 1 2)/(10 dt); variances
    follow by hand.
    """
    n, V = 300, 20.0
    columns = {
        c: np.full(n, V if c == "V_mps" else 0.0) for c in (*NOISY_CHANNELS, "phi_rad", "theta_rad")
    }
    record = FlightRecord(columns | {"time_s": DT * np.arange(n)})
    pieces = [Piece("x", slice(0, n), 0.0, DT * (n - 1))]
    mass = MassProperties(20.0, np.diag([5.0, 6.0, 10.0]), 1.97, 3.66, 0.53)

    def at_rest(record: FlightRecord, piece: Piece) -> Prediction:
        qbar = 0.6 * record["V_mps"][piece.rows] ** 2
        zero = np.zeros((len(qbar), 3))
        return Prediction(np.zeros((len(qbar), 6)), zero, zero, qbar, mass, {})

    plain = residual_coefficients(record, pieces, at_rest)
    made_of = with_sensor_noise(
        plain, record, pieces, at_rest, (0.0, 0.0, 0.0), {"ay_mps2": 0.16, "p_radps": 0.0035}
    )
    result = np.sqrt(noise_variance(made_of.pieces[0].noise))
    pressure = 0.6 * V**2 * 1.97
    side = 20.0 * 0.16 * np.sqrt(0.3**2 + 2 * 0.25**2 + 2 * 0.1**2) / pressure
    roll = 5.0 * 0.0035 * np.sqrt(2 * (1 + 4)) / (10 * DT) / (pressure * 3.66)
    np.testing.assert_allclose(result[:, 1], side, rtol=1e-6)
    np.testing.assert_allclose(result[:, 3], roll, rtol=1e-6)
    assert not result[:, [0, 2]].any()
