"""Where a residual stands above its noise: in which stretch of time, in which band of frequencies, and with which state.

A whitened residual is cut into blocks, each block into Welch's windowed periodogram. Under noise an ordinate is exponential with
mean 1. Every rectangle of neighbouring blocks and neighbouring frequencies is tried; with N ordinates of sum S in it,

    gain = 2 (S - N - N log(S / N))   where S > N                                                                          (G)

is twice the log likelihood ratio of noise that is S/N times as strong in the rectangle against the noise as given: a scan statistic
(Kulldorff, Commun. Stat. Theory Methods 26 (1997) 1481) for Whittle's likelihood. Blocks of several lengths are tried, because a
short burst needs short blocks and a slow drift long ones. The p-value is the tail of the sum's gamma distribution, times the number
of rectangles tried (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.arrays import FloatArray
from sysid.distributions import f_tail, gamma_tail
from sysid.estimation import integral_time

BLOCKS_S = (0.5, 1.0, 2.0, 4.0)
"""Lengths of the blocks that are tried; a band is known to one over the length."""
MOST_BLOCKS, MOST_BANDS = 64, 24
"""Blocks and frequencies of one series: more are put together, so that a long log costs no more rectangles."""
LEAST_SAMPLES = 16
WINDOW_LIKENESS = (4.0 / 9.0, 1.0 / 36.0)
"""Correlation of the periodogram's neighbours, one and two apart, that the Hann window makes of independent ones."""
BY_CHANCE = 0.01
"""Chance that anything is placed in noise alone."""
TENTHS = 10


@dataclass(frozen=True)
class Burst:
    """Rows [start, stop) and band [Hz] of a series in which it stands above the noise.

    gain: equation (G), corrected for the window; p: chance that noise alone gives as much in any rectangle of this series
    """

    start: int
    stop: int
    low_hz: float
    high_hz: float
    gain: float
    p: float


@dataclass(frozen=True)
class With:
    """The range [low, high] of a state with which a series goes, the share of its variance that the state explains, and the p-value
    of that share among the states tried. of: "mean" where its mean changes with the state, "size" where its square does."""

    state: str
    low: float
    high: float
    share: float
    of: str
    p: float


def loudest(white: FloatArray, rate_hz: float) -> Burst | None:
    """The rectangle of largest gain in a residual over its noise (n,) at equal steps; None where no rectangle is above the noise
    or the series is shorter than `LEAST_SAMPLES`."""
    found: list[tuple[Burst, int]] = []
    tried = 0
    for length_s in BLOCKS_S:
        n = max(LEAST_SAMPLES, round(length_s * rate_hz), -(-len(white) // MOST_BLOCKS))
        if n > len(white):
            break
        burst, rectangles = _largest(white, n, rate_hz)
        tried += rectangles
        if burst is not None:
            found.append((burst, n))
    if not found:
        return None
    burst, n = max(found, key=lambda f: f[0].gain)
    start, stop = _sharpened(white, rate_hz, burst, n)
    return replace(burst, start=start, stop=stop, p=min(1.0, burst.p * tried))


def _gain(S: FloatArray, N: FloatArray) -> FloatArray:
    """Equation (G) of sums S of N ordinates; 0 where they are not above the noise."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where((S > N) & (N > 0.0), 2.0 * (S - N - N * np.log(S / N)), 0.0)


def _sharpened(white: FloatArray, rate_hz: float, burst: Burst, n: int) -> tuple[int, int]:
    """Rows [start, stop) of the largest gain in the burst's band, whose ends lie within a block of the burst's: where in a block
    it begins, the blocks do not say."""
    f = np.fft.rfftfreq(len(white), 1.0 / rate_hz)
    inside = (f >= burst.low_hz) & (f < burst.high_hz)
    band = np.fft.irfft(np.where(inside, np.fft.rfft(white), 0.0), len(white))
    ordinates = (burst.high_hz - burst.low_hz) / rate_hz
    total = np.append(0.0, np.cumsum(band**2)) / max(float(inside.mean()), 1e-9) * ordinates
    starts = np.arange(max(burst.start - n, 0), min(burst.start + n, burst.stop - 1) + 1)
    stops = np.arange(max(burst.stop - n, burst.start + 1), min(burst.stop + n, len(white)) + 1)
    S = total[stops] - total[starts][:, None]
    N = ordinates * np.maximum(stops - starts[:, None], 0)
    gain = _gain(S, N)
    k, j = np.unravel_index(int(np.argmax(gain)), gain.shape)
    return (int(starts[k]), int(stops[j])) if gain[k, j] > 0.0 else (burst.start, burst.stop)


def _periodogram(
    white: FloatArray, n: int, rate_hz: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(blocks, bands) sums of ordinates, (bands,) ordinates in each band, (bands + 1,) edges [Hz]; Nyquist's is left out."""
    blocks = white[: len(white) // n * n].reshape(-1, n)
    window = np.hanning(n + 1)[:-1]
    power = np.abs(np.fft.rfft(blocks * window, axis=1))[:, : (n + 1) // 2] ** 2 / float(
        window @ window
    )
    weight = np.ones(power.shape[1])
    weight[0] = 0.5  # The mean's ordinate is real: half as many numbers as the others have.
    step = -(-len(weight) // MOST_BANDS)
    starts = np.arange(0, len(weight), step)
    edges = np.maximum((np.append(starts, len(weight)) - 0.5) * rate_hz / n, 0.0)
    return np.add.reduceat(power * weight, starts, axis=1), np.add.reduceat(weight, starts), edges


def _largest(white: FloatArray, n: int, rate_hz: float) -> tuple[Burst | None, int]:
    """The rectangle of largest gain in blocks of n rows, p that of this rectangle alone, and how many rectangles there are."""
    power, weight, edges = _periodogram(white, n, rate_hz)
    blocks, bands = power.shape
    total = np.zeros((blocks + 1, bands + 1))
    total[1:, 1:] = power.cumsum(axis=0).cumsum(axis=1)
    count = np.append(0.0, np.cumsum(weight))
    low, high = np.triu_indices(bands + 1, 1)
    per_block = count[high] - count[low]
    spread = _spread(per_block)
    best: Burst | None = None
    for a in range(blocks):
        inside = total[a + 1 :] - total[a]
        S = inside[:, high] - inside[:, low]
        N = np.arange(1, blocks - a + 1)[:, None] * per_block
        gain = _gain(S, N) / spread
        j, k = np.unravel_index(int(np.argmax(gain)), gain.shape)
        if gain[j, k] > (0.0 if best is None else best.gain):
            p = float(gamma_tail(S[j, k] / spread[k], N[j, k] / spread[k]))
            stop = (a + int(j) + 1) * n
            best = Burst(
                a * n, stop, float(edges[low[k]]), float(edges[high[k]]), float(gain[j, k]), p
            )
    return best, blocks * (blocks + 1) // 2 * len(low)


def _spread(ordinates: FloatArray) -> FloatArray:
    """By how much the variance of a sum of neighbouring ordinates exceeds that of independent ones."""
    one, two = (
        c * np.maximum(ordinates - lag, 0.0) / ordinates for lag, c in enumerate(WINDOW_LIKENESS, 1)
    )
    return np.asarray(1.0 + 2.0 * (one + two))


def densest(weights: FloatArray, share: float = 0.5) -> tuple[int, int]:
    """The shortest stretch [start, stop) that holds at least ``share`` of the sum of weights (n,), none negative."""
    total = np.append(0.0, np.cumsum(weights))
    need = share * total[-1] * (1.0 - 1e-12)
    every = np.arange(len(total))
    stops = np.maximum(np.searchsorted(total, total + need), every + 1)
    starts = every[stops < len(total)]
    k = int(np.argmin(stops[starts] - starts))
    return k, int(stops[k])


def band_of(series: FloatArray, rate_hz: float) -> tuple[float, float]:
    """The narrowest band [Hz] that holds half of a series' power."""
    window = np.hanning(len(series) + 2)[1:-1]
    power = np.abs(np.fft.rfft(series * window)) ** 2
    low, high = densest(power)
    step = rate_hz / len(series)
    return max((low - 0.5) * step, 0.0), (high - 0.5) * step


def goes_with(
    series: Sequence[FloatArray], states: Sequence[Mapping[str, FloatArray]], certain: bool = False
) -> With | None:
    """The state, or control, with which a residual goes: a mean by tenths of the state explains most of its variance.

    series [(n,)], states name -> (n,) at the same rows; rows that are not finite are left out. A residual whose mean goes with
    nothing is asked for its square. None where chance (`BY_CHANCE`, F test with as many samples as the coloured series is worth,
    all states tried) explains as much; certain: the series has no noise, and the state that explains most is told.
    """
    known = [np.isfinite(e) for e in series]
    kept = [e[k] for e, k in zip(series, known, strict=True)]
    if sum(len(e) for e in kept) <= 2 * TENTHS:
        return None
    for of, values in (("mean", kept), ("size", [e**2 for e in kept])):
        mean = float(np.mean(np.concatenate(values)))
        pieces = [v - mean for v in values if len(v)]
        y = np.concatenate(pieces)
        worth = max(len(y) / integral_time(pieces), TENTHS + 2.0)
        every = (
            (n, np.concatenate([s[n][k] for s, k in zip(states, known, strict=True)]))
            for n in states[0]
        )
        found = {n: row for n, x in every if (row := _explained(y, x, worth)) is not None}
        if not found:
            continue
        name = max(found, key=lambda n: found[n][0])
        share, p, low, high = found[name]
        p = min(1.0, p * 2 * len(found))
        if certain or p < BY_CHANCE:
            return With(name, low, high, share, of, p)
    return None


def dependence(
    series: Sequence[FloatArray], states: Sequence[Mapping[str, FloatArray]], most: int = 3
) -> list[tuple[str, float]]:
    """States on which a residual [(n,)] depends: (name, adjusted share of its variance that a mean by tenths of the state
    explains), the largest first."""
    y = np.concatenate(series)
    y = y - y.mean()
    every = ((n, _explained(y, np.concatenate([s[n] for s in states]), len(y))) for n in states[0])
    return sorted(((n, row[0]) for n, row in every if row is not None), key=lambda r: -r[1])[:most]


def _explained(
    y: FloatArray, x: FloatArray, worth: float
) -> tuple[float, float, float, float] | None:
    """(adjusted share of y's variance that a mean by tenths of x explains, its p-value, the range of x with half of that)."""
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, TENTHS + 1)))
    total = float(y @ y)
    if len(edges) < 3 or not total > 0.0:
        return None
    where = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    number = np.bincount(where, minlength=len(edges) - 1)
    sums = np.bincount(where, y, minlength=len(edges) - 1)
    part = sums**2 / np.maximum(number, 1)
    share, free = float(part.sum()) / total, len(edges) - 2
    left = worth - len(edges) + 1
    F = share / free / max((1.0 - share) / left, 1e-300)
    low, high = densest(part)
    adjusted = 1.0 - (1.0 - share) * (worth - 1.0) / left
    return adjusted, float(f_tail(F, free, left)), float(edges[low]), float(edges[high])
