"""Locate the strongest remaining residual: flight, time, channel, frequency band, state,
candidates.

The location is that of the largest gain of a scan statistic over the channels above their noise or
coloured, on training and hold-out flights. If all channels are at their noise but a candidate is
strong, it is the location of what the candidate explains. The residuals that candidates would leave
are computed from the linearised likelihood of the training flights, with everything estimated
again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.distributions import f_tail, gamma_tail
from sysid.effects import Effect, score_tests, tuned
from sysid.estimation import integral_time, rms
from uqharness.identification.linearised import FlightData, Trajectory
from uqharness.refinement.candidates import eligible
from uqharness.refinement.evaluation import Evaluation
from uqharness.refinement.hold_out import HoldOutResult, train_information
from uqharness.refinement.search_result import SearchResult
from uqharness.refinement.sentences import discriminating_manoeuvre
from uqharness.results.refinement import NearbyCandidate, Region, ResidualLocation

NEAREST = 3
MAX_CANDIDATES = 12
"""Candidates of largest gain whose remaining residual is computed."""
NO_RESIDUAL = (
    "every channel of the training and hold-out flights is at its noise, and no candidate is"
    " significant"
)
_STATES = ("V_mps", "alpha_rad", "beta_rad", "p_radps", "q_radps", "r_radps")
_CONTROLS = ("elevator_deg", "aileron_deg", "rudder_deg", "throttle_pct")


@dataclass(frozen=True)
class Series:
    """One channel of one segment: residual over noise (n,) at times (n,), and states at all
    rows.
    """

    flights: str
    flight: str
    manoeuvre: str
    channel: str
    white: FloatArray
    time_s: FloatArray
    states: Mapping[str, FloatArray]

    @property
    def present(self) -> FloatArray:
        """Residuals at measured rows."""
        return self.white[np.isfinite(self.white)]

    @property
    def rate_hz(self) -> float:
        """Measured rows per second; NaN below two."""
        t = self.time_s[np.isfinite(self.white)]
        return float((len(t) - 1) / (t[-1] - t[0])) if len(t) > 1 else float("nan")


def place_of(
    hold_out: HoldOutResult,
    channels: Mapping[str, Sequence[str]],
    keys: Sequence[str],
    controls: Sequence[FloatArray],
) -> ResidualLocation:
    """Find where in the flights residuals remain: `remaining.place` of refinement.json.

    Parameters
    ----------
    hold_out : HoldOutResult
    channels : mapping
        "train" and "test" to the channels whose residuals exceed their noise or are coloured.
    keys : sequence of str
        Candidates that the training flights support besides the effects, or effects of another form
        than the missing one.
    controls : sequence of array
        Control positions in every training segment.
    """
    train, test = hold_out.train, hold_out.test
    series = series_of("train", train.data, train.after, controls)
    series += series_of("test", test.data, test.after, [s.controls for s in test.data.segments])
    nearest = Nearest(hold_out.result)
    if any(channels.values()):
        place, correlate = locate_burst([s for s in series if s.channel in channels[s.flights]])
    else:
        place, correlate = _place_of_candidate(
            nearest, [s for s in series if s.flights == "train"], keys[0]
        )
    candidates, current_rms = nearest.leaving(place["channel"], {c.key for c in hold_out.withdrawn})
    effects = [hold_out.result.effects[k] for k, _, _ in candidates]
    parts = {
        "channel_on_train": current_rms,
        "candidates": [
            NearbyCandidate(**label(e), name=e.name, t=t, leaves=leaves)
            for e, (_, t, leaves) in zip(effects, candidates, strict=True)
        ],
        "would_tell": discriminating_manoeuvre(
            None if correlate is None else correlate.state,
            effects,
            _loudest_manoeuvre(series, place),
        ),
    }
    return ResidualLocation(**(place | parts))


def no_place(reason: str) -> dict[str, Any]:
    """Return the document without a place, and the reason."""
    empty: dict[str, Any] = dict.fromkeys(ResidualLocation.model_fields)
    return empty | {"candidates": [], "reason": reason, "state_reason": reason}


def series_of(
    flights: str, data: FlightData, evaluation: Evaluation, controls: Sequence[FloatArray]
) -> list[Series]:
    """Return every channel of every segment of one side's flights."""
    return [
        Series(flights, s.flight, s.kind, c, w[:, k], s.time_s, states)
        for s, w, states in zip(
            data.segments,
            evaluation.white,
            states_along(evaluation.trajectory, controls),
            strict=True,
        )
        for k, c in enumerate(data.outputs)
    ]


def states_along(
    trajectory: Trajectory, controls: Sequence[FloatArray]
) -> list[dict[str, FloatArray]]:
    """Return states and controls by name, (n,) each, one mapping per segment."""
    pairs = zip(trajectory.x, controls, strict=True)
    return [
        dict(zip(_STATES, x.T, strict=False)) | dict(zip(_CONTROLS, u.T, strict=False))
        for x, u in pairs
    ]


def locate_burst(series: Sequence[Series]) -> tuple[dict[str, Any], StateCorrelate | None]:
    """Return the place of the largest gain over noise.

    If chance alone gives as much, it is the channel of largest residual, without an interval.
    """
    # The loudest stretch and band of every series; short series have none.
    long = [s for s in series if len(s.present) >= MIN_SAMPLES]
    bursts = [
        (burst, s) for s in long if (burst := largest_burst(s.present, s.rate_hz)) is not None
    ]
    burst, best = max(
        bursts, key=lambda f: f[0].gain, default=(None, max(series, key=lambda s: rms(s.white)))
    )
    # Its channel in all segments: does the residual go with a state?
    alike = [s for s in series if (s.flights, s.channel) == (best.flights, best.channel)]
    correlate = state_correlate([s.white for s in alike], [s.states for s in alike])
    # Bonferroni over the series that were searched.
    p = 1.0 if burst is None else min(1.0, burst.p * len(bursts))
    place = no_place("") | {
        "flights": best.flights,
        "channel": best.channel,
        "p": p,
        **_state(correlate),
    }
    place["rms_over_noise"] = rms(np.concatenate([s.white for s in alike]))
    if burst is None or p > BY_CHANCE:
        return (
            place
            | {
                "reason": (
                    "no time span and no frequency band exceeds the noise significantly (p"
                    f" {p:.2g})"
                )
            },
            correlate,
        )
    # Share of the channel's excess over noise that the stretch explains.
    rows = np.flatnonzero(np.isfinite(best.white))[burst.start : burst.stop]
    inside = best.white[rows]
    excess = sum(float(np.nansum(s.white**2 - np.isfinite(s.white))) for s in alike)
    excess_inside = float(np.sum(inside**2 - 1.0))
    return (
        place
        | {
            "flight": best.flight,
            "manoeuvre": best.manoeuvre,
            "from_s": float(best.time_s[rows[0]]),
            "to_s": float(best.time_s[rows[-1]]),
            "from_Hz": burst.low_hz,
            "to_Hz": burst.high_hz,
            "rms_over_noise": rms(inside),
            "share_of_excess": min(excess_inside / excess, 1.0)
            if excess_inside > 0.0 and excess > 0.0
            else None,
            "reason": None,
        },
        correlate,
    )


class Nearest:
    """Candidates beside the selected effects, on the linearised likelihood of the training
    flights.
    """

    def __init__(self, result: SearchResult) -> None:
        self.result = result
        self.information = train_information(result, list(result.effects))
        self.free = [n for n in self.information.names if n not in result.effects] + [
            c.key for c in result.selection.chosen
        ]
        unselected = [e for e in result.effects.values() if e.key not in self.free]
        # Effects that were simulated and dropped have columns in the fit: projecting these out
        # would leave nothing.
        dropped = [e.key for e in unselected if e.key in result.flown_values]
        open_ = eligible(
            [e for e in unselected if e.key not in dropped],
            result.data,
            result.after.columns[0].names,
            self.information,
        )
        self.scores = score_tests(self.information, self.free, [*open_, *dropped])

    def residual(self, *keys: str, left_out: str = "") -> list[FloatArray]:
        """Return residuals over noise (n, m) of each segment with everything estimated beside these
        candidates, without one effect.
        """
        free = [n for n in (*self.free, *keys) if n != left_out]
        return self.information.residual(self.information.estimates(self.information.index(free)))

    def trace(self, key: str) -> list[FloatArray]:
        """Return what a candidate would explain beside the effects, or an effect beside the others,
        (n, m) per segment.
        """
        with_candidate = self.residual(*(() if key in self.free else (key,)))
        return [a - b for a, b in zip(self.residual(left_out=key), with_candidate, strict=True)]

    def leaving(
        self, channel: str, withdrawn: set[str]
    ) -> tuple[list[tuple[str, float, float]], float]:
        """Return three candidates (key, t, rms over noise that each leaves of the channel), and the
        rms without any.

        ``withdrawn`` are keys that the hold-out flights contradicted.
        """
        k = self.result.data.outputs.index(channel)
        order = np.argsort(-np.nan_to_num(self.scores.gain, nan=-1.0))
        strongest = [
            i
            for i in order
            if self.scores.names[i] not in withdrawn and np.isfinite(self.scores.t[i])
        ][:MAX_CANDIDATES]
        rows = [
            (self.scores.names[i], float(self.scores.t[i]), self._rms(k, self.scores.names[i]))
            for i in strongest
        ]
        return sorted(rows, key=lambda r: r[2])[:NEAREST], self._rms(k)

    def _rms(self, k: int, *keys: str) -> float:
        """Return the rms of channel ``k``'s residual over noise."""
        return rms(np.concatenate([e[:, k] for e in self.residual(*keys)]))


def _place_of_candidate(
    nearest: Nearest, series: Sequence[Series], key: str
) -> tuple[dict[str, Any], StateCorrelate | None]:
    """Return the place of what a candidate or an effect explains on the training flights.

    It is the shortest time, and the narrowest band, that hold half of it.
    """
    data, trace = nearest.result.data, nearest.trace(key)
    power = np.array([np.nansum(d**2, axis=0) for d in trace])
    k = int(np.argmax(power.sum(axis=0)))
    s = int(np.argmax(power[:, k]))
    alike = [e for e in series if e.channel == data.outputs[k]]
    best, d = alike[s], np.nan_to_num(trace[s][:, k])
    start, stop = shortest_interval(d**2)
    low, high = band_of(d, 1.0 / data.segments[s].dt_s)
    correlate = state_correlate([e[:, k] for e in trace], [e.states for e in alike], certain=True)
    return {
        "flights": "train",
        "flight": best.flight,
        "manoeuvre": best.manoeuvre,
        "channel": best.channel,
        "from_s": float(best.time_s[start]),
        "to_s": float(best.time_s[stop - 1]),
        "from_Hz": low,
        "to_Hz": high,
        "rms_over_noise": rms(np.concatenate([e.white for e in alike])),
        "share_of_excess": float(np.sum(d[start:stop] ** 2) / power[:, k].sum()),
        "p": None,
        **_state(correlate),
        "reason": None,
    }, correlate


def _state(correlate: StateCorrelate | None) -> dict[str, Any]:
    """Return the document of a state with which a residual varies."""
    if correlate is None:
        return {
            "state": None,
            "state_reason": "no state and no control correlates with it significantly",
        }
    return {"state": asdict(correlate), "state_reason": None}


def label(effect: Effect) -> dict[str, Any]:
    """Return an effect's coefficient or subsystem, and its term."""
    where = (
        {"coefficient": effect.coefficient}
        if effect.coefficient is not None
        else {"subsystem": effect.subsystem or ""}
    )
    return {**where, "term": effect.term}


def _loudest_manoeuvre(series: Sequence[Series], place: Mapping[str, Any]) -> tuple[str, float]:
    """Return the kind of manoeuvre with the channel's largest residual, and the rms over noise
    there.
    """
    mine = [s for s in series if (s.flights, s.channel) == (place["flights"], place["channel"])]
    kinds = dict.fromkeys(s.manoeuvre for s in mine)
    sizes = {
        kind: rms(np.concatenate([s.white for s in mine if s.manoeuvre == kind])) for kind in kinds
    }
    return max(sizes.items(), key=lambda size: size[1])


# The scan statistic.
#
# A whitened residual is cut into blocks, each block into Welch's windowed periodogram. Under
# noise an ordinate is exponential with mean 1. Every rectangle of neighbouring blocks and
# neighbouring frequencies is tried; with N ordinates of sum S in it,
#
# gain = 2 (S - N - N log(S / N)) where S > N (G)
#
# is twice the log likelihood ratio of noise that is S/N times as strong in the rectangle
# against the noise as given: a scan statistic (Kulldorff, Commun. Stat. Theory Methods 26
# (1997) 1481) for Whittle's likelihood. Blocks of several lengths are tried, because a short
# burst needs short blocks and a slow drift long ones. The p-value is the tail of the sum's
# gamma distribution, times the number of rectangles tried (Bonferroni).

BLOCKS_S = (0.5, 1.0, 2.0, 4.0)
"""Lengths of the blocks that are tried; a band is known to one over the length."""
MAX_BLOCKS, MAX_BANDS = 64, 24
"""Blocks and frequencies of one series: more are put together, so that a long log costs no more
rectangles.
"""
MIN_SAMPLES = 16
WINDOW_LIKENESS = (4.0 / 9.0, 1.0 / 36.0)
"""Correlation of the periodogram's neighbours, one and two apart, that the Hann window makes of
independent ones.
"""
BY_CHANCE = 0.01
"""Chance that anything is placed in noise alone."""
TENTHS = 10


@dataclass(frozen=True)
class Burst:
    """Rows [start, stop) and band [Hz] in which a series exceeds the noise.

    ``gain`` is equation (G), corrected for the window; ``p`` is the probability that noise alone
    gives as much in any rectangle of the series.
    """

    start: int
    stop: int
    low_hz: float
    high_hz: float
    gain: float
    p: float


@dataclass(frozen=True)
class StateCorrelate:
    """Range [low, high] of a state with which a series varies.

    ``share`` of the series' variance is explained by the state, with p-value ``p`` among the tested
    states. ``of`` is "mean" if its mean varies with the state, "size" if its square does.
    """

    state: str
    low: float
    high: float
    share: float
    of: str
    p: float


def largest_burst(white: FloatArray, rate_hz: float) -> Burst | None:
    """Return the rectangle of largest gain in a residual over its noise (n,) at equal steps.

    None if no rectangle exceeds the noise or the series is shorter than `MIN_SAMPLES`.
    """
    bursts: list[tuple[Burst, int]] = []
    rectangles_tried = 0
    for length_s in BLOCKS_S:
        n = max(MIN_SAMPLES, round(length_s * rate_hz), -(-len(white) // MAX_BLOCKS))
        if n > len(white):
            break
        burst, rectangles = _largest(white, n, rate_hz)
        rectangles_tried += rectangles
        if burst is not None:
            bursts.append((burst, n))
    if not bursts:
        return None
    burst, n = max(bursts, key=lambda f: f[0].gain)
    start, stop = _sharpened(white, rate_hz, burst, n)
    return replace(burst, start=start, stop=stop, p=min(1.0, burst.p * rectangles_tried))


def _gain(S: FloatArray, N: FloatArray) -> FloatArray:
    """Evaluate equation (G) for sums S of N ordinates; 0 where they do not exceed the noise."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where((S > N) & (N > 0.0), 2.0 * (S - N - N * np.log(S / N)), 0.0)


def _sharpened(white: FloatArray, rate_hz: float, burst: Burst, n: int) -> tuple[int, int]:
    """Return the rows [start, stop) of largest gain in the burst's band.

    The ends lie within a block of the burst's, because blocks do not resolve them.
    """
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
    """Return sums of ordinates (blocks, bands), ordinates per band (bands,), and edges (bands + 1,)
    [Hz], without Nyquist's.
    """
    blocks = white[: len(white) // n * n].reshape(-1, n)
    window = np.hanning(n + 1)[:-1]
    power = np.abs(np.fft.rfft(blocks * window, axis=1))[:, : (n + 1) // 2] ** 2 / float(
        window @ window
    )
    weight = np.ones(power.shape[1])
    weight[0] = 0.5  # The mean's ordinate is real: half as many numbers as the others have.
    step = -(-len(weight) // MAX_BANDS)
    starts = np.arange(0, len(weight), step)
    edges = np.maximum((np.append(starts, len(weight)) - 0.5) * rate_hz / n, 0.0)
    return np.add.reduceat(power * weight, starts, axis=1), np.add.reduceat(weight, starts), edges


def _largest(white: FloatArray, n: int, rate_hz: float) -> tuple[Burst | None, int]:
    """Return the rectangle of largest gain in blocks of n rows, with its own p, and the number of
    rectangles.
    """
    power, weight, edges = _periodogram(white, n, rate_hz)
    blocks, bands = power.shape
    total = np.zeros((blocks + 1, bands + 1))
    total[1:, 1:] = power.cumsum(axis=0).cumsum(axis=1)
    count = np.append(0.0, np.cumsum(weight))
    low, high = np.triu_indices(bands + 1, 1)
    per_block = count[high] - count[low]
    variance_ratio = _variance_ratio(per_block)
    best: Burst | None = None
    for a in range(blocks):
        inside = total[a + 1 :] - total[a]
        S = inside[:, high] - inside[:, low]
        N = np.arange(1, blocks - a + 1)[:, None] * per_block
        gain = _gain(S, N) / variance_ratio
        j, k = np.unravel_index(int(np.argmax(gain)), gain.shape)
        if gain[j, k] > (0.0 if best is None else best.gain):
            p = float(gamma_tail(S[j, k] / variance_ratio[k], N[j, k] / variance_ratio[k]))
            stop = (a + int(j) + 1) * n
            best = Burst(
                a * n, stop, float(edges[low[k]]), float(edges[high[k]]), float(gain[j, k]), p
            )
    return best, blocks * (blocks + 1) // 2 * len(low)


def _variance_ratio(ordinates: FloatArray) -> FloatArray:
    """Return the ratio of the variance of sums of neighbouring ordinates to that of independent
    ones.
    """
    one, two = (
        c * np.maximum(ordinates - lag, 0.0) / ordinates for lag, c in enumerate(WINDOW_LIKENESS, 1)
    )
    return np.asarray(1.0 + 2.0 * (one + two))


def shortest_interval(weights: FloatArray) -> tuple[int, int]:
    """Return the shortest stretch [start, stop) with half of the sum of non-negative weights
    (n,).
    """
    total = np.append(0.0, np.cumsum(weights))
    need = 0.5 * total[-1] * (1.0 - 1e-12)
    every = np.arange(len(total))
    stops = np.maximum(np.searchsorted(total, total + need), every + 1)
    starts = every[stops < len(total)]
    k = int(np.argmin(stops[starts] - starts))
    return k, int(stops[k])


def band_of(series: FloatArray, rate_hz: float) -> tuple[float, float]:
    """Return the narrowest band [Hz] that holds half of a series' power."""
    window = np.hanning(len(series) + 2)[1:-1]
    power = np.abs(np.fft.rfft(series * window)) ** 2
    low, high = shortest_interval(power)
    step = rate_hz / len(series)
    return max((low - 0.5) * step, 0.0), (high - 0.5) * step


def state_correlate(
    series: Sequence[FloatArray], states: Sequence[Mapping[str, FloatArray]], certain: bool = False
) -> StateCorrelate | None:
    """Return the state or control whose tenths explain most of a residual's variance by their
    means.

    Parameters
    ----------
    series : sequence of (n,) array
        Residuals; rows that are not finite are omitted.
    states : sequence of mapping
        State name to (n,) values at the same rows.
    certain : bool
        The series has no noise: the state that explains most is returned in any case.

    Returns
    -------
    StateCorrelate or None
        None if chance (`BY_CHANCE`; F test with the effective number of samples of the coloured
        series, over all states) explains as much. If the mean varies with no state, the square is
        tested.
    """
    finite = [np.isfinite(e) for e in series]
    measured = [e[k] for e, k in zip(series, finite, strict=True)]
    if sum(len(e) for e in measured) <= 2 * TENTHS:
        return None
    for of, values in (("mean", measured), ("size", [e**2 for e in measured])):
        mean = float(np.mean(np.concatenate(values)))
        pieces = [v - mean for v in values if len(v)]
        y = np.concatenate(pieces)
        effective_samples = max(len(y) / integral_time(pieces), TENTHS + 2.0)
        every = (
            (n, np.concatenate([s[n][k] for s, k in zip(states, finite, strict=True)]))
            for n in states[0]
        )
        shares = {
            n: row for n, x in every if (row := _explained(y, x, effective_samples)) is not None
        }
        if not shares:
            continue
        name = max(shares, key=lambda n: shares[n][0])
        share, p, low, high = shares[name]
        p = min(1.0, p * 2 * len(shares))
        if certain or p < BY_CHANCE:
            return StateCorrelate(name, low, high, share, of, p)
    return None


def dependence(
    series: Sequence[FloatArray], states: Sequence[Mapping[str, FloatArray]]
) -> list[tuple[str, float]]:
    """Return the three states on which a residual depends most, as (name, adjusted share of
    variance), the largest first.
    """
    y = np.concatenate(series)
    y = y - y.mean()
    every = ((n, _explained(y, np.concatenate([s[n] for s in states]), len(y))) for n in states[0])
    return sorted(((n, row[0]) for n, row in every if row is not None), key=lambda r: -r[1])[:3]


def _explained(
    y: FloatArray, x: FloatArray, effective_samples: float
) -> tuple[float, float, float, float] | None:
    """Return the adjusted share of y's variance that means by tenths of x explain, its p-value, and
    the range of x with half of it.
    """
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, TENTHS + 1)))
    total = float(y @ y)
    if len(edges) < 3 or not total > 0.0:
        return None
    where = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    number = np.bincount(where, minlength=len(edges) - 1)
    sums = np.bincount(where, y, minlength=len(edges) - 1)
    part = sums**2 / np.maximum(number, 1)
    share, free = float(part.sum()) / total, len(edges) - 2
    degrees = effective_samples - len(edges) + 1
    F = share / free / max((1.0 - share) / degrees, 1e-300)
    low, high = shortest_interval(part)
    adjusted = 1.0 - (1.0 - share) * (effective_samples - 1.0) / degrees
    return adjusted, float(f_tail(F, free, degrees)), float(edges[low]), float(edges[high])


# Where a model and flights disagree: coefficient by manoeuvre and region of the state, in
# shares of samples and in words. Pure.

_MIN_S = 0.5
MAX_REGIONS = 12


def disagreements(
    gap: Sequence[FloatArray],
    allowed: Sequence[FloatArray],
    states: Sequence[Mapping[str, FloatArray]],
    labels: Sequence[str],
    dt_s: float,
) -> list[Region]:
    """Return regions of the states in which coefficients disagree, the largest disagreement first.

    Each is the third of a state's range with the largest share of samples outside the 95 %
    interval, for the state that explains most; its size is the rms there over the allowed standard
    deviation.

    Parameters
    ----------
    gap, allowed : sequence of (n, 6) array
        Demanded minus predicted coefficients, and the standard deviation that noise and parameters
        allow.
    states : sequence of mapping
        State name to (n,), in which regions are searched.
    labels : sequence of str
        Manoeuvre of every segment.
    dt_s : float
        Step of the rows.
    """
    regions: list[tuple[float, Region]] = []
    for kind in dict.fromkeys(labels):
        mine = [k for k, label in enumerate(labels) if label == kind]
        ratio = np.concatenate([gap[k] / allowed[k] for k in mine])
        states_of_kind = {n: np.concatenate([states[k][n] for k in mine]) for n in states[mine[0]]}
        for c, coefficient in enumerate(COEFFICIENTS):
            z = ratio[:, c]
            outside = np.abs(z) > 1.96
            if not len(z) or outside.mean() < tuned.DISAGREEMENT_SHARE:
                continue
            (state, low, high), mask = _densest_region(outside, states_of_kind)
            seconds, size = float(outside[mask].sum()) * dt_s, float(np.sqrt(np.mean(z[mask] ** 2)))
            if seconds < _MIN_S:
                continue
            share = float(outside[mask].mean())
            words = (
                f"{coefficient}, {kind}, {state} {low:.3g} to {high:.3g}: {100 * share:.0f} % of"
                f" samples outside the 95 % interval, {seconds:.1f} s of {len(z) * dt_s:.1f} s; rms"
                f" {size:.1f} times the value expected from noise and parameters"
            )
            row = Region(
                coefficient=coefficient,
                manoeuvre=kind,
                region={state: [low, high]},
                share_outside_95=share,
                size=size,
                words=words,
            )
            regions.append((size * seconds, row))
    return [row for _, row in sorted(regions, key=lambda f: -f[0])][:MAX_REGIONS]


def _densest_region(
    outside: NDArray[np.bool_], states: Mapping[str, FloatArray]
) -> tuple[tuple[str, float, float], NDArray[np.bool_]]:
    """Return the region, a third of a state's samples, that holds most of the samples outside."""
    regions = []
    for name, values in states.items():
        for low, high in pairwise(np.quantile(values, [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0]).tolist()):
            mask = (values >= low) & (values <= high)
            if mask.sum() >= 10 and high > low:
                regions.append(((name, low, high), mask))
    everywhere = ("all", math.nan, math.nan), np.ones(len(outside), dtype=bool)
    return max(regions, key=lambda f: float(outside[f[1]].mean()), default=everywhere)
