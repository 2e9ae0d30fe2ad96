"""Sensor noise in residual coefficients: white noise through formula, filter and differentiator.

Gains vary slowly, so that noise n_c of channel c adds to the residual of a coefficient

    e(k) = sum over c and its ways w of  g_cw(k) sum_j h_w(j) n_c(k - j)

with h_w the smoother, the differentiator or both in series. An offset passes the smoother unchanged
and the differentiator not at all, so the gains g of the smoothed ways are found by offsetting a
channel; those of the differentiated rates are m arm/(qbar S) and I/(qbar S l). Noise of
accelerometers therefore scales with 1/qbar. `sysid.model_form` separates model error from this
noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache

import numpy as np
from scipy import fft

from sysid.aerodynamics.coefficients import half_width, kernel
from sysid.aerodynamics.residuals import (
    Cutoffs,
    Model,
    Passage,
    Piece,
    PieceNoise,
    Prediction,
    Residuals,
    Way,
    residual_piece,
    residual_rows,
    steady_airspeed,
)
from sysid.arrays import FloatArray
from sysid.record import FlightRecord

ACCELERATIONS = ("ax_mps2", "ay_mps2", "az_mps2")
RATES = ("p_radps", "q_radps", "r_radps")
FORCE_CHANNELS = ("V_mps", "alpha_rad", "beta_rad", *RATES)
"""Channels on which the model's forces depend."""
NOISY_CHANNELS = (*FORCE_CHANNELS, *ACCELERATIONS)
"""Channels whose noise reaches a residual coefficient."""
_CACHE_SIZE = 4096
"""Cached spectra: those of a long flight's pieces at every time constant, some 10 kB each."""
_OFFSETS = {"V_mps": 0.1}
_OFFSET = 1e-3
"""Difference step of channels without an entry in _OFFSETS: small against motion, large against
rounding.
"""


@cache
def autocorrelation(weights: tuple[float, ...]) -> tuple[float, ...]:
    """Compute the autocorrelation at lags 0, 1, ... of unit white noise after a filter.

    Examples
    --------
    >>> autocorrelation((0.5, 0.5))
    (0.5, 0.25)
    """
    w = np.array(weights)
    return tuple(float(w[lag:] @ w[: len(w) - lag]) for lag in range(len(w)))


@lru_cache(_CACHE_SIZE)
def cosine_variance(n: int, correlation: tuple[float, ...]) -> FloatArray:
    """Compute the variances (n,) of the orthonormal DCT-II of a stationary series.

    With T the autocovariance, 2 cos a cos b = cos(a - b) + cos(a + b) makes n times the variance of
    wave k > 0

        sum over d of (n - |d|) T_d cos(pi d k / n)  +  sum over s of W_s cos(pi s k / n)

    with W_s the sum of T_(i - j) over i + j + 1 = s. The result is read-only, as it is cached.

    Parameters
    ----------
    n : int
        Length of the series.
    correlation : tuple of floats
        Autocovariance at lags 0, 1, ...; zero beyond.
    """
    # First sum of the formula, over differences of indices.
    lags = np.zeros(n)
    lags[: len(correlation)] = correlation[:n]
    lag_terms = 2.0 * np.arange(n, 0, -1) * lags
    lag_terms[0] *= 0.5
    # W_s: every second lag to either side of 0 (or -1 and 1), as far as i and j reach.
    sums = np.empty(n)
    sums[::2] = 2.0 * np.cumsum(lags[::2]) - lags[0]
    sums[1::2] = 2.0 * np.cumsum(lags[1::2])
    sequence = np.concatenate([lag_terms, np.zeros(n)])
    sequence[1 : n + 1] += sums
    sequence[n + 1 :] += sums[-2::-1]
    out = np.asarray(fft.rfft(sequence).real[:n] / n)
    out[0] = 0.5 * sequence.sum() / n
    out.flags.writeable = False
    return out


def with_sensor_noise(
    residuals: Residuals,
    record: FlightRecord,
    pieces: Sequence[Piece],
    model: Model,
    arm_m: Sequence[float],
    std: Mapping[str, float],
    *,
    relative_std: Mapping[str, float] | None = None,
) -> Residuals:
    """Add the sensor noise of each piece to a flight's residuals.

    Parameters
    ----------
    residuals : Residuals
        From `residual_coefficients`.
    record, pieces, model, arm_m
        As given to `residual_coefficients`.
    std : mapping of str to float
        White noise of each channel in its unit; channels without a figure are noise-free.
    relative_std : mapping of str to float, optional
        Relative standard deviation of each figure.

    Returns
    -------
    Residuals
        With ``noise`` in every piece.
    """
    cutoffs = residuals.cutoffs
    record = steady_airspeed(record, cutoffs.airspeed_hz)
    sizes = {c: s for c, s in std.items() if np.isfinite(s) and s > 0.0}
    piece_noises = (
        _piece_noise(record, p, model, arm_m, cutoffs, sizes, relative_std=dict(relative_std or {}))
        for p in pieces
    )
    of_pieces = [noise for noise in piece_noises if noise is not None]
    with_noise = tuple(
        replace(p, noise=noise) for p, noise in zip(residuals.pieces, of_pieces, strict=True)
    )
    return replace(residuals, pieces=with_noise)


def offset_records(record: FlightRecord, cutoffs: Cutoffs) -> list[FlightRecord]:
    """Return the records at which `with_sensor_noise` calls the model, one per force channel."""
    steady = steady_airspeed(record, cutoffs.airspeed_hz)
    return [_offset(steady, c) for c in FORCE_CHANNELS]


def _offset(record: FlightRecord, channel: str) -> FlightRecord:
    """Add the difference step to one channel of a record."""
    return record.with_columns({channel: record[channel] + _OFFSETS.get(channel, _OFFSET)})


def _piece_noise(
    record: FlightRecord,
    piece: Piece,
    model: Model,
    arm: Sequence[float],
    cutoffs: Cutoffs,
    std: Mapping[str, float],
    *,
    relative_std: Mapping[str, float],
) -> PieceNoise | None:
    """Compute the noise of one piece; None if it is shorter than the filter."""
    prediction = model(record, piece)
    residual = residual_piece(record, piece, prediction, arm, cutoffs.all_hz)
    if residual is None:
        return None
    m = (piece.rows.stop - piece.rows.start - len(residual)) // 2
    filters = _Filters(record.dt_s, m, cutoffs.airspeed_hz)
    passages = []
    # Smoothed ways: gains by offsetting each channel.
    for channel in (c for c in NOISY_CHANNELS if c in std):
        offset, offset_record = _OFFSETS.get(channel, _OFFSET), _offset(record, channel)
        offset_prediction = model(offset_record, piece) if channel in FORCE_CHANNELS else prediction
        offset_residual = residual_rows(
            offset_record, piece, offset_prediction, arm, cutoffs.all_hz
        )
        gain = std[channel] / offset * (offset_residual - residual.delta)
        passages.append(
            Passage(
                channel,
                "smoothed",
                gain,
                filters.weights(channel, "smoothed"),
                relative_std.get(channel, 0.0),
            )
        )
    # Differentiated ways of the angular rates: gains in closed form.
    for channel in (c for c in RATES if c in std):
        for way, gain in _differentiated(
            prediction, np.asarray(arm, dtype=float), slice(m, m + len(residual)), channel
        ):
            passages.append(
                Passage(
                    channel,
                    way,
                    std[channel] * gain,
                    filters.weights(channel, way),
                    relative_std.get(channel, 0.0),
                )
            )
    states = {
        c: (s, filters.weights(c, "smoothed")) for c, s in std.items() if c in residual.states
    }
    return PieceNoise(tuple(passages), states, len(residual))


@dataclass(frozen=True)
class _Filters:
    """Filter weights over m samples to either side, with the airspeed's low-pass before them."""

    dt_s: float
    m: int
    airspeed_hz: float

    def weights(self, channel: str, way: Way) -> tuple[float, ...]:
        """Return the weights of one way of a channel."""
        out = kernel(self.m, self.dt_s, derivative=0 if way == "smoothed" else 1)
        if way == "both":
            out = np.convolve(out, kernel(self.m, self.dt_s))
        if channel == "V_mps" and np.isfinite(self.airspeed_hz):
            out = np.convolve(out, kernel(half_width(self.dt_s, self.airspeed_hz), self.dt_s))
        return tuple(out.tolist())


def _differentiated(
    prediction: Prediction, arm: FloatArray, inner: slice, channel: str
) -> list[tuple[Way, FloatArray]]:
    """Return gains (n, 6) of a rate's noise through its derivative.

    The derivative enters moments, and forces where the sensors have an arm.
    """
    mass = prediction.mass
    axis = RATES.index(channel)
    pressure = prediction.qbar[inner] * mass.S
    moments = np.zeros((len(pressure), 6))
    moments[:, 3:] = mass.inertia[:, axis] / (pressure[:, None] * mass.lengths)
    out: list[tuple[Way, FloatArray]] = [("differentiated", moments)]
    if np.any(arm):
        # Unit angular acceleration times the arm.
        unit = np.zeros(3)
        unit[axis] = 1.0
        forces = np.zeros((len(pressure), 6))
        forces[:, :3] = -mass.mass * np.cross(unit, arm) / pressure[:, None]
        out.append(("both", forces))
    return out


def with_noise_of(residuals: Residuals, other: Residuals) -> Residuals:
    """Give residuals the noise of ``other``, the same pieces behind another filter.

    Gains hardly depend on the filter; weights are replaced. Both have the same step. Raises
    ValueError where the pieces differ.
    """
    pieces = []
    for piece, other_piece in zip(residuals.pieces, other.pieces, strict=True):
        assert other_piece.noise is not None
        # Another filter keeps more or fewer samples at the ends.
        extra_rows = (len(piece) - len(other_piece)) // 2
        filters = _Filters(
            other.dt_s,
            half_width(residuals.dt_s, residuals.cutoffs.all_hz),
            residuals.cutoffs.airspeed_hz,
        )
        passages = tuple(
            replace(
                p,
                gain=_resized(p.gain, extra_rows, len(piece)),
                weights=filters.weights(p.channel, p.way),
            )
            for p in other_piece.noise.passages
        )
        states = {
            c: (s, filters.weights(c, "smoothed")) for c, (s, _) in other_piece.noise.states.items()
        }
        pieces.append(replace(piece, noise=PieceNoise(passages, states, len(piece))))
    return replace(residuals, pieces=tuple(pieces))


def _resized(gain: FloatArray, extra_rows: int, n: int) -> FloatArray:
    """Extend the gain by ``extra_rows`` at either end (shorten it if negative) to n rows."""
    if extra_rows < 0:
        gain, extra_rows = gain[-extra_rows:], 0
    return np.asarray(
        np.pad(gain, ((extra_rows, max(0, n - len(gain) - extra_rows)), (0, 0)), mode="edge")[:n]
    )


def noise_variance(noise: PieceNoise) -> FloatArray:
    """Compute the noise variance (n, 6) of a piece's samples [-]."""
    out = np.zeros((noise.n, 6))
    for p in noise.passages:
        out += p.gain**2 * autocorrelation(p.weights)[0]
    return out


def noise_cosines(noise: PieceNoise) -> tuple[FloatArray, FloatArray]:
    """Compute the variances (n, 6) of the noise's cosine transform (orthonormal DCT-II).

    Gains enter by their rms. Also returns the relative standard deviation (6,) of the total
    variance.
    """
    out = np.zeros((noise.n, 6))
    size_errors: dict[str, FloatArray] = {}
    for p in noise.passages:
        channel_variance = cosine_variance(noise.n, autocorrelation(p.weights))[:, None] * np.mean(
            p.gain**2, axis=0
        )
        out += channel_variance
        # The error of a channel's figure is common to all its ways; the relative error of a
        # variance is twice that of a standard deviation.
        size_errors[p.channel] = size_errors.get(
            p.channel, np.zeros(6)
        ) + 2.0 * p.relative_std * channel_variance.sum(axis=0)
    total = np.maximum(out.sum(axis=0), np.finfo(float).tiny)
    return out, np.sqrt(sum((v / total) ** 2 for v in size_errors.values()) + np.zeros(6))
