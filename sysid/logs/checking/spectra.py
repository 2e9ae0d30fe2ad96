"""Two noisy signals that should be one: scale, sign and lateness of one against the other, and how much of it is evidence.

    y(t) = k x(t - tau),   both with noise of unknown size at every frequency

Noise in x pulls the regression of y on x (H1) towards zero and noise in y pushes the reverse regression (H2) up, so the true scale
lies between the two (Bendat and Piersol, "Random Data", 4th ed. 2010, 6.1.4 and 9.2). Only bands whose coherence cannot be chance
count; what two channels of mere noise have in common is chance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from sysid.arrays import FloatArray

ComplexArray = NDArray[np.complexfloating]
SURE = 3.0
"""Standard errors on either side of what counts as possible."""
_BANDS, _LEAST_BINS = 12, 6
_CHANCE = 1e-5  # that a band of mere noise counts, all bands together; lateness and sign are looked for, which helps chance
_FLOOR = 0.01  # relative: no two sensors agree better
_MOST_LATE_S, _LATE_STEP_S = 0.5, 0.005
_TAPER = 0.2  # share of a stretch at either end
TAPERED = 1.26
"""By which the taper raises the variance of sums over frequencies: mean w^4 / (mean w^2)^2."""
LEAK = 5e-3
"""Of the strongest band's power: what leaks from it has its phase and not its own."""
_SIGN_MARGIN = 1.15  # by how much the reversed sign has to explain more, since lateness can look like it in a narrow band


@dataclass(frozen=True)
class Relation:
    """y = scale * x(t - late_s).

    low, high   the scale lies between, SURE standard errors and the noise of both signals counted; negative for a reversed sign
    late_std_s  standard error of ``late_s``
    coherence   of the bands that count, mean      bands   number of them, 0: no evidence
    """

    low: float
    high: float
    late_s: float
    late_std_s: float
    coherence: float
    bands: int

    @property
    def evident(self) -> bool:
        """Whether the signals have more in common than chance gives."""
        return self.bands > 0

    @property
    def scale(self) -> float:
        """Geometric middle of ``low`` and ``high``."""
        return (
            math.copysign(math.sqrt(self.low * self.high), self.low)
            if self.evident
            else float("nan")
        )

    def allows(self, scale: float, tolerance: float = 0.0) -> bool:
        """Whether the scale can be this one; ``tolerance`` relative on either side."""
        least, most = sorted((self.low, self.high))
        near, far = sorted((scale * (1.0 + tolerance), scale / (1.0 + tolerance)))
        return self.evident and least <= far and most >= near


NOTHING = Relation(float("nan"), float("nan"), float("nan"), float("inf"), 0.0, 0)


def relate(
    x: Sequence[FloatArray], y: Sequence[FloatArray], dt_s: float, low_hz: float, high_hz: float
) -> Relation:
    """The relation of y to x, from stretches (n,) without gaps, ``dt_s`` apart, in a band of frequencies."""
    parts = [spectrum(a, b, dt_s, low_hz, high_hz) for a, b in zip(x, y, strict=True)]
    if not parts:
        return NOTHING
    frequency = np.concatenate([part[0] for part in parts])
    fx, fy = (np.concatenate([part[k] for part in parts]) for k in (1, 2))
    power = np.sum(np.abs(fx) ** 2) * np.sum(np.abs(fy) ** 2)
    if frequency.size < _LEAST_BINS or not power > 0.0:
        return NOTHING
    groups = groups_of(frequency, low_hz, high_hz)
    late, sign = _coarse(frequency, fx, fy, groups)
    turned = sign * fy * np.exp(2j * np.pi * frequency * late)
    rows = []
    most = max(float(np.mean(np.abs(fx[group]) ** 2)) for group in groups)
    for group in groups:
        if float(np.mean(np.abs(fx[group]) ** 2)) < LEAK * most:
            continue
        a, b, k = fx[group], turned[group], float(np.count_nonzero(group))
        xx, yy, xy = (
            float(np.sum(np.abs(a) ** 2)),
            float(np.sum(np.abs(b) ** 2)),
            complex(np.sum(np.conj(a) * b)),
        )
        shared = abs(xy) ** 2 / (xx * yy) if xx * yy > 0.0 else 0.0
        chance = (1.0 - min(shared, 1.0)) ** (k - 1.0)
        if chance * len(groups) >= _CHANCE:
            continue
        variance = (1.0 - min(shared, 1.0)) / (2.0 * k * shared) + _FLOOR**2
        center = 2.0 * np.pi * float(np.sum(np.abs(a) ** 2 * frequency[group]) / xx)
        rows.append(
            (
                1.0 / variance,
                math.log(abs(xy) / xx),
                math.log(yy / abs(xy)),
                np.angle(xy),
                center,
                shared,
            )
        )
    if not rows:
        return NOTHING
    weight, first, second, phase, omega, shared_all = (
        np.array(column, dtype=np.float64) for column in zip(*rows, strict=True)
    )
    if not np.all(np.isfinite(first + second)) or np.sum(weight * np.cos(phase)) <= 0.0:
        return NOTHING
    information = float(weight.sum())
    middle = float(weight @ first) / information
    # Bands that disagree with one another say that more than noise is between the two.
    excess = max(1.0, float(weight @ (first - middle) ** 2) / max(1, len(rows) - 1))
    spread = math.sqrt(excess / information)
    about = float(weight @ omega**2)
    fine = -float(weight @ (omega * phase)) / about
    miss = max(1.0, float(weight @ (phase + omega * fine) ** 2) / max(1, len(rows) - 1))
    ends = (middle - SURE * spread, float(weight @ second) / information + SURE * spread)
    return Relation(
        sign * math.exp(ends[0]),
        sign * math.exp(ends[1]),
        late + fine,
        math.sqrt(miss / about),
        float(weight @ shared_all) / information,
        len(rows),
    )


def relate_means(x: FloatArray, y: FloatArray) -> Relation:
    """The relation of means (n,) over blocks of time, their own mean included: for what is steady rather than moving.

    Blocks count as independent. No lateness can be told.
    """
    good = np.isfinite(x) & np.isfinite(y)
    x, y = x[good], y[good]
    n = x.size
    xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
    if n < _LEAST_BINS or not xx * yy > 0.0 or xy == 0.0:
        return NOTHING
    shared = min(1.0, xy**2 / (xx * yy))
    if math.exp(0.5 * (n - 1.0) * math.log(max(1.0 - shared, 1e-300))) >= _CHANCE:
        return NOTHING
    spread = math.sqrt((1.0 - shared) / (n * shared) + _FLOOR**2)
    sign = math.copysign(1.0, xy)
    first, second = math.log(abs(xy) / xx), math.log(yy / abs(xy))
    return Relation(
        sign * math.exp(first - SURE * spread),
        sign * math.exp(second + SURE * spread),
        float("nan"),
        float("inf"),
        shared,
        1,
    )


def spectrum(
    x: FloatArray, y: FloatArray, dt_s: float, low_hz: float, high_hz: float
) -> tuple[FloatArray, ComplexArray, ComplexArray]:
    """Frequencies inside the band and the Fourier transforms there, tapered at the ends, straight lines taken out."""
    n = x.size
    at = np.linspace(-1.0, 1.0, n)
    edge = np.clip(
        np.minimum(np.arange(n) + 0.5, n - np.arange(n) - 0.5) / max(1.0, _TAPER * n), 0.0, 1.0
    )
    taper = 0.5 - 0.5 * np.cos(np.pi * edge)
    frequency = np.asarray(np.fft.rfftfreq(n, dt_s), dtype=np.float64)
    inside = (frequency >= low_hz) & (frequency <= high_hz)
    out = []
    for values in (x, y):
        level = values - values.mean()
        straight = level - at * float(at @ level) / float(at @ at)
        out.append(np.fft.rfft(straight * taper)[inside] / math.sqrt(n))
    return frequency[inside], out[0], out[1]


def band_passed(x: FloatArray, dt_s: float, low_hz: float, high_hz: float) -> FloatArray:
    """(..., n) without what lies below and above the band, nothing moved in time; mirrored beyond its ends.

    The gain is that of Butterworth's high-pass and low-pass of the second order, each run forwards and backwards.
    """
    n = x.shape[-1]
    frequency = np.arange(1, n) / (2.0 * n * dt_s)
    gain = 1.0 / ((1.0 + (low_hz / frequency) ** 4) * (1.0 + (frequency / high_hz) ** 4))
    return np.asarray(
        fft.idct(fft.dct(x, norm="ortho") * np.concatenate([[0.0], gain]), norm="ortho")
    )


def groups_of(frequency: FloatArray, low_hz: float, high_hz: float) -> list[NDArray[np.bool_]]:
    """Bands of equal ratio, joined upwards until each has enough frequencies."""
    edges = np.geomspace(low_hz, high_hz, _BANDS + 1)[1:]
    found, begin = [], 0.0
    for edge in edges:
        group = (frequency > begin) & (frequency <= edge * (1.0 + 1e-9))
        if np.count_nonzero(group) >= _LEAST_BINS:
            found.append(group)
            begin = edge * (1.0 + 1e-9)
    rest = frequency > begin
    if found and rest.any():
        found[-1] = found[-1] | rest
    return found or [np.ones(frequency.size, dtype=bool)]


def _coarse(
    frequency: FloatArray, fx: ComplexArray, fy: ComplexArray, groups: Sequence[NDArray[np.bool_]]
) -> tuple[float, float]:
    """Lateness to _LATE_STEP_S and sign that bring the bands together, each band counting by its own correlation."""
    late = np.arange(-_MOST_LATE_S, _MOST_LATE_S + 0.5 * _LATE_STEP_S, _LATE_STEP_S)
    total = np.zeros(late.size)
    # Powers of one turn per step: a hundred times cheaper than an exponential each, and right to 1e-13.
    turns = np.broadcast_to(
        np.exp(2j * np.pi * _LATE_STEP_S * frequency), (late.size, frequency.size)
    ).copy()
    turns[0] = np.exp(2j * np.pi * late[0] * frequency)
    np.multiply.accumulate(turns, axis=0, out=turns)
    for group in groups:
        cross = np.conj(fx[group]) * fy[group]
        size = math.sqrt(
            float(np.sum(np.abs(fx[group]) ** 2)) * float(np.sum(np.abs(fy[group]) ** 2))
        )
        if size > 0.0:
            along = (
                np.real((turns[:, group] * cross).sum(axis=1)) / size
            )  # no BLAS, whose threads cost more than they do
            total += np.count_nonzero(group) * along * np.abs(along)
    # Of equals the least lateness.
    total *= 1.0 - 1e-3 * np.abs(late)
    best, worst = int(np.argmax(total)), int(np.argmin(total))
    if -total[worst] > _SIGN_MARGIN * total[best]:
        return float(late[worst]), -1.0
    return float(late[best]), 1.0
