"""Delay of an angle of flow or an airspeed, separated from gusts by the motion that controls
caused.

    y(t) = k x(t - tau) + g(t)

y is the derivative of the channel, x its value by rates and accelerations, g the derivative of the
gusts. The aircraft responds to gusts, so that x and g have a cross-spectrum Sxg. That of x and y
is k Sxx exp(-i w tau) + Sxg; its phase is not the delay, however high the coherence. A control z
that does not follow gusts is uncorrelated with them: Szy = k exp(-i w tau) Szx holds in any air.
Controls are therefore instruments, and the estimate is limited information maximum likelihood in
bands of frequency:

    Q(k, tau) = sum over bands of 2 (n - p) log(1 + |P r|^2 / (n - p) s^2),
    r = y - k exp(-i w tau) x

P projects the n frequencies of a band on its p instruments, and s^2 is the remaining power. Least
squares is the case z = x. It is correct in calm air; its standard error includes gusts in step
with x as large as the residual.

References: Anderson and Rubin, Ann. Math. Stat. 20 (1949) 46 (estimate); Bekker, Econometrica 62
(1994) 657 (many instruments); Newey and West, Econometrica 55 (1987) 703 (gusts of varying
strength); Sargan, Econometrica 26 (1958) 393 (Q at its minimum); Stock and Yogo in "Identification
and Inference for Econometric Models", 2005, 80 (weak instruments).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from sysid.arrays import FloatArray
from sysid.logs.checking.kinematics import (
    LEAK,
    TAPERED,
    Law,
    Stretches,
    band_of,
    groups_of,
    spectrum,
    stretches,
)
from sysid.record import FlightRecord

ComplexArray = NDArray[np.complexfloating]
INSTRUMENTS = {
    "V_mps": ("elevator_deg", "throttle_pct"),
    "alpha_rad": ("elevator_deg", "throttle_pct"),
    "beta_rad": ("aileron_deg", "rudder_deg"),
}
"""Controls that move a channel of the air data."""
_LATE_S = 0.005 * np.arange(-100.0, 101.0)
_LOG_SCALES = 0.05 * np.arange(-12.0, 13.0)
_FINE_LOG_SCALES = 0.02 * np.arange(-40.0, 41.0)
# Prior standard deviation of the logarithm of the scale; larger errors are reported by
# `physics`.
_SCALE_STD = 0.15
_FLOOR = 0.01  # relative accuracy of the best sensors
_REFINEMENT, _REFINEMENTS = 5.0, 3
_OVERIDENTIFICATION_LEVEL = 0.05  # level of the test of overidentifying restrictions
_DEPENDENT = 1e-6
# Share of a row: a jump of a control acts on the acceleration of its own row, and in the mean
# half a row early on the derivative. A tenth of the lift jumps.
_ROW = 0.05
_MIN_STRENGTH = 10.0
_GUST_S = 5.0  # residuals within this time count as one gust


@dataclass(frozen=True)
class Lateness:
    """Delay of a channel.

    Attributes
    ----------
    late_s, std_s : float
        Delay and standard error, s; infinite if the flight has no information.
    scale : float
        The factor k.
    misfit, freedom : float
        Q at its minimum, chi-squared with ``freedom`` degrees if instruments and gusts are
        independent.
    by : str
        Instruments: "controls" or "motion".
    """

    late_s: float
    std_s: float
    scale: float
    misfit: float
    freedom: float
    by: str = "controls"


UNKNOWN = Lateness(0.0, math.inf, math.nan, 0.0, 0.0)


@dataclass(frozen=True)
class Part:
    """Fourier transforms of one stretch of ``rows`` samples.

    Signals x, y (n,) and instruments z (p, n) at frequencies f (n,) [Hz].
    """

    f: FloatArray
    x: ComplexArray
    y: ComplexArray
    z: ComplexArray
    rows: int
    dt_s: float

    def in_time(self, values: ComplexArray) -> FloatArray:
        """Return the time series, shape (rows,), of a transform (n,)."""
        transform = np.zeros(self.rows // 2 + 1, dtype=np.complex128)
        transform[np.rint(self.f * self.rows * self.dt_s).astype(int)] = values * math.sqrt(
            self.rows
        )
        return np.asarray(np.fft.irfft(transform, self.rows), dtype=np.float64)


@dataclass(frozen=True)
class _BandInformation:
    """Information of a band on delay and log scale.

    Attributes
    ----------
    information, chance : ndarray of shape (2, 2)
        Information by the instruments, and variance that chance adds to the score.
    instruments : int
        Number of instruments.
    factor : ndarray of shape (n, 2)
        Factor of the score.
    residual : ndarray of shape (n,)
        Residual r.
    """

    information: FloatArray
    chance: FloatArray
    instruments: int
    factor: ComplexArray
    residual: ComplexArray


@dataclass(frozen=True)
class _Band:
    """A band of both signals, (n,), with an orthonormal base of its instruments, (n, p).

    ``members`` marks its frequencies among all.
    """

    omega: FloatArray
    x: ComplexArray
    y: ComplexArray
    base: ComplexArray
    members: NDArray[np.bool_]

    @property
    def count(self) -> float:
        """Number of independent frequencies; the taper correlates neighbours."""
        return self.omega.size / TAPERED

    @property
    def instruments(self) -> int:
        """Number of independent instruments."""
        return int(self.base.shape[1])

    def powers(self, late_s: FloatArray, scale: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the power of r along the instruments and the other power a frequency, each
        (late, scale).

        The latter includes a floor for the accuracy of sensors.
        """
        delayed = np.exp(-1j * np.outer(late_s, self.omega)) * self.x
        projection, on_base = np.conj(self.base.T) @ self.y, delayed @ np.conj(self.base)
        k = scale[None, :]
        x_power = np.sum(np.abs(on_base) ** 2, axis=1)[:, None]
        on = (
            _power(projection)
            - 2.0 * k * np.real(np.conj(on_base) @ projection)[:, None]
            + k**2 * x_power
        )
        total = (
            _power(self.y)
            - 2.0 * k * np.real(np.conj(delayed) @ self.y)[:, None]
            + k**2 * _power(self.x)
        )
        noise = (
            np.maximum(total - on, 0.0) / (self.count - self.instruments)
            + (_FLOOR * k) ** 2 * x_power / self.instruments
        )
        return np.maximum(on, 0.0), noise

    def at(self, late_s: float, scale: float) -> _BandInformation:
        """Return the information of the band at this delay and scale."""
        delayed = scale * self.x * np.exp(-1j * self.omega * late_s)
        r = self.y - delayed
        noise = float(self.powers(np.array([late_s]), np.array([scale]))[1][0, 0])
        # Derivatives of k exp(-i w tau) x by tau and by log k.
        slope = np.stack([-1j * self.omega * delayed, delayed], axis=1)
        on, off, across = self._on(slope), slope - self._on(slope), r - self._on(r)
        # The common part of slopes and residual outside the instruments belongs to gusts, not
        # to controls.
        common = np.conj(across) @ off / _power(across) if _power(across) > 0.0 else np.zeros(2)
        free = off - np.outer(across, common)
        by_chance = self.instruments / (self.count - self.instruments)
        net_information = np.conj(on.T) @ on - by_chance * np.conj(off.T) @ off
        chance = by_chance * np.conj(free.T) @ free
        factor = (on - np.outer(self._on(r), common)) / noise
        return _BandInformation(
            2.0 * np.real(net_information) / noise,
            2.0 * np.real(chance) / noise,
            self.instruments,
            factor,
            r,
        )

    def _on(self, values: ComplexArray) -> ComplexArray:
        """Project on the instruments."""
        return np.asarray(self.base @ (np.conj(self.base.T) @ values))


def _power(values: ComplexArray) -> float:
    """Return the sum of squared magnitudes."""
    return float(np.sum(np.abs(values) ** 2))


def channel_lateness(record: FlightRecord, law: Law, by_motion: bool = True) -> Lateness:
    """Estimate the delay of a law's subject, one of INSTRUMENTS.

    Controls serve as instruments and, if ``by_motion``, the motion itself. The estimate with the
    smaller standard error is returned, since both errors include the effect of gusts.
    """
    controls = tuple(n for name in INSTRUMENTS[law.subject] if (n := _recorded(record, name)))
    parts = stretches(record, replace(law, uses=(*law.uses, *controls))) if controls else None
    estimates = [] if parts is None else [_late_by(parts, law, controls)]
    if by_motion and (parts := stretches(record, law)) is not None:
        estimates.append(_late_by(parts, law, ()))
    return min(estimates, key=lambda late: late.std_s, default=UNKNOWN)


def _recorded(record: FlightRecord, control: str) -> str | None:
    """Return the column of a control, or of its position if no command was recorded; None without
    either.
    """
    candidates = (control, control.replace("_deg", "_pos_deg"))
    return next((n for n in candidates if n in record and np.isfinite(record[n]).any()), None)


def _late_by(stretch_set: Stretches, law: Law, controls: Sequence[str]) -> Lateness:
    """Estimate the delay with controls as instruments, or with the motion if there are none."""
    low, high = band_of(law, stretch_set)
    if high <= 1.5 * low:
        return UNKNOWN
    parts = []
    for c in stretch_set.parts:
        x, y = law.sides(c, stretch_set.dt_s)
        f, fx, fy = spectrum(x, y, stretch_set.dt_s, low, high)
        # Central differences attenuate y with frequency; x gets the same gain.
        fx = fx * np.sinc(2.0 * f * stretch_set.dt_s)
        z = (
            [spectrum(c[n], c[n], stretch_set.dt_s, low, high)[1] for n in controls]
            if controls
            else [fx]
        )
        parts.append(Part(f, fx, fy, np.stack(z), x.size, stretch_set.dt_s))
    f = np.concatenate([p.f for p in parts])
    if not f.size:
        return UNKNOWN
    groups = groups_of(f, low, high)
    late = lateness(parts, groups)
    if not math.isfinite(late.std_s):
        return late
    row_s = _ROW * stretch_set.dt_s
    # A control acts within its row; motion and gusts add the error of `_gusts_s`.
    if controls:
        return replace(late, std_s=math.hypot(late.std_s, row_s))
    return replace(
        late, std_s=math.hypot(late.std_s, row_s, _gusts_s(parts, groups, late)), by="motion"
    )


def _gusts_s(parts: Sequence[Part], groups: Sequence[NDArray[np.bool_]], late: Lateness) -> float:
    """Return the delay, s, that gusts in step with the motion could cause if as strong as the
    residual.
    """
    turn, weight = 0.0, 0.0
    for b in _bands(parts, groups):
        delayed = late.scale * b.x * np.exp(-1j * b.omega * late.late_s)
        share = _power(b.y - delayed) / max(_power(delayed), 1e-300)
        information = 1.0 / (share / (2.0 * b.count) + _FLOOR**2)
        omega = math.sqrt(float(np.mean(b.omega**2)))
        turn, weight = (
            turn + information * omega * math.sqrt(share),
            weight + information * omega**2,
        )
    return turn / weight


def lateness(parts: Sequence[Part], groups: Sequence[NDArray[np.bool_]]) -> Lateness:
    """Estimate the delay of y after x by the instruments z.

    Parameters
    ----------
    parts : sequence of Part
        Stretches.
    groups : sequence of ndarray of bool
        Bands: masks of the concatenated frequencies of all parts.

    Returns
    -------
    Lateness
        `UNKNOWN` if the instruments are too weak.
    """
    bands = _bands(parts, groups)
    if not bands:
        return UNKNOWN
    late_s, scale, misfit = _minimise(bands)
    informations = [band.at(late_s, scale) for band in bands]
    information = np.sum([t.information for t in informations], axis=0) + np.diag(
        [0.0, _SCALE_STD**-2]
    )
    # Instruments are weak if chance alone could give a large part of the information (Stock and
    # Yogo).
    by_chance = math.sqrt(sum(float(t.chance[0, 0]) ** 2 / t.instruments for t in informations))
    of_late = information[0, 0] - information[0, 1] ** 2 / information[1, 1]
    if not of_late > _MIN_STRENGTH * by_chance or not information[1, 1] > 0.0:
        return UNKNOWN
    # Sandwich covariance, by the larger of two score variances.
    inverse = np.linalg.inv(information)
    score_covariance = information + np.sum([t.chance for t in informations], axis=0)
    variances = [
        float((inverse @ m @ inverse)[0, 0])
        for m in (score_covariance, _score_variance(parts, bands, informations))
    ]
    freedom = 2.0 * sum(b.instruments for b in bands) - 1.0
    # If the instruments follow gusts, the part that looks like a delay may be as large as the
    # misfit.
    inflation = 1.0 + max(0.0, misfit - float(chdtri(freedom, _OVERIDENTIFICATION_LEVEL)))
    return Lateness(
        late_s,
        math.sqrt(inflation * max(*variances, _variance_by_likelihood(bands, late_s, misfit))),
        scale,
        misfit,
        freedom,
    )


def _variance_by_likelihood(bands: Sequence[_Band], late_s: float, misfit: float) -> float:
    """Return the variance of the delay by which Q is larger without any delay.

    In a short flight the minimum of Q may be one of several. For N samples of unknown variance, a
    value that is z standard errors off raises Q by N log(1 + z^2 / N).
    """
    samples = 2.0 * sum(b.count - b.instruments for b in bands)
    more = float(np.min(_misfits(bands, np.zeros(1), _FINE_LOG_SCALES))) - misfit
    squares = samples * math.expm1(min(more / samples, 50.0))
    return late_s**2 / squares if squares > 0.0 else 0.0


def _bands(parts: Sequence[Part], groups: Sequence[NDArray[np.bool_]]) -> list[_Band]:
    """Return the bands with power and enough frequencies for their instruments."""
    f, x, y = (np.concatenate([getattr(p, name) for p in parts]) for name in ("f", "x", "y"))
    z = np.concatenate([p.z for p in parts], axis=1)
    size = np.sqrt(np.sum(np.abs(z) ** 2, axis=1))
    z = z[size > 0.0] / size[size > 0.0, None]
    out = []
    means = [float(np.mean(np.abs(x[group]) ** 2)) for group in groups]
    for group, mean in zip(groups, means, strict=True):
        if mean < LEAK * max(means):
            continue
        # Orthonormal base of the independent instruments.
        left_vectors, sizes, _ = np.linalg.svd(z[:, group].T, full_matrices=False)
        base = (
            left_vectors[:, sizes > _DEPENDENT * sizes[0]]
            if sizes.size and sizes[0] > 0.0
            else left_vectors[:, :0]
        )
        if base.shape[1] > 0 and np.count_nonzero(group) / TAPERED > 2 * base.shape[1] + 1:
            out.append(_Band(2.0 * np.pi * f[group], x[group], y[group], base, group))
    return out


def _minimise(bands: Sequence[_Band]) -> tuple[float, float, float]:
    """Return delay and scale at the minimum of Q, and Q there, on successively finer grids."""
    late, logs = _LATE_S, _LOG_SCALES
    for _ in range(_REFINEMENTS + 1):
        q = _misfits(bands, late, logs)
        i, j = np.unravel_index(int(np.argmin(q)), q.shape)
        best = float(late[i]), float(np.exp(logs[j])), float(q[i, j])
        steps = (late[1] - late[0]) / _REFINEMENT, (logs[1] - logs[0]) / _REFINEMENT
        # The next grid spans a few steps of this one around the minimum.
        late, logs = (
            v[n] + step * np.arange(-8.0, 9.0)
            for v, n, step in zip((late, logs), (i, j), steps, strict=True)
        )
    return best


def _misfits(bands: Sequence[_Band], late_s: FloatArray, log_scales: FloatArray) -> FloatArray:
    """Return Q, shape (late, scale), including the prior of the scale."""
    q = np.tile((log_scales / _SCALE_STD) ** 2, (late_s.size, 1))
    for b in bands:
        on, noise = b.powers(late_s, np.exp(log_scales))
        free = b.count - b.instruments
        q += 2.0 * free * np.log1p(on / np.maximum(free * noise, 1e-300))
    return q


def _score_variance(
    parts: Sequence[Part], bands: Sequence[_Band], informations: Sequence[_BandInformation]
) -> FloatArray:
    """Return the variance of the score, shape (2, 2), allowing for gusts of varying strength.

    In a roll, slow gusts become fast ones while controls move.
    """
    count = bands[0].members.size
    factor, residual = (
        np.zeros((count, 2), dtype=np.complex128),
        np.zeros(count, dtype=np.complex128),
    )
    for b, t in zip(bands, informations, strict=True):
        factor[b.members], residual[b.members] = t.factor, t.residual
    out, begin = np.zeros((2, 2)), 0
    for p in parts:
        part_rows = slice(begin, begin + p.f.size)
        begin += p.f.size
        score = np.stack([p.in_time(factor[part_rows, k]) for k in (0, 1)]) * p.in_time(
            residual[part_rows]
        )
        window = max(1, min(round(_GUST_S / p.dt_s), p.rows))
        # Sums over a moving window are Bartlett's weights of lagged products (Newey and West).
        sums = np.stack([np.convolve(row, np.ones(window)) for row in score])
        out += sums @ sums.T / window
    return out
