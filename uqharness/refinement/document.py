"""refinement.json from what a refinement found: verdict, effects, disagreement, what is left.

Flies nothing.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.display import rows_table, view
from sysid.distributions import f_tail, gamma_tail
from sysid.effects import (
    CERTAIN_T,
    DIFFERENT,
    DISAGREES,
    Alternative,
    Choice,
    Effect,
    Refusal,
    scores,
)
from sysid.estimation import NOISE_FLOOR, integral_time, rms
from uqharness.identification.linearised import FlightData, Trajectory
from uqharness.refinement.evaluation import Shown, gap_document, left_in
from uqharness.refinement.judge import Judged, Verdict, evidence_of
from uqharness.refinement.round import Bent
from uqharness.refinement.rounds import eligible, is_fastest
from uqharness.refinement.search import Found, chosen_interval
from uqharness.refinement.write_xml import switch_of
from uqharness.results.refinement import Alternative as AlternativeDocument
from uqharness.results.refinement import (
    AlternativeEvidence,
    Candidates,
    Gaps,
    HoldOutTest,
    Identified,
    NearbyCandidate,
    Refinement,
    RefusedCandidate,
    Region,
    Remaining,
    RemainingPart,
    ResidualLocation,
    Score,
    State,
    Switch,
    Timing,
    Withdrawn,
)
from uqharness.results.refinement import Effect as EffectDocument
from uqharness.results.refinement import Evidence as EvidenceDocument
from uqharness.simulator import Actuator, Aircraft

# Where a model and flights disagree: coefficient by manoeuvre and region of the state, in
# shares of samples and in words. Pure.

_LEAST_S = 0.5


def disagreements(
    gap: Sequence[FloatArray],
    allowed: Sequence[FloatArray],
    states: Sequence[Mapping[str, FloatArray]],
    labels: Sequence[str],
    dt_s: float,
    most: int = 12,
) -> list[Region]:
    """gap, allowed [(n, 6)]: coefficients demanded minus predicted, and the standard deviation that
    noise and parameters allow; states: name -> (n,), where a region may be looked for; labels:
    manoeuvre of every segment.

    Each entry, the largest first, is the third of a state's range, of the state that tells most, in
    which the share of samples outside the 95 % interval is largest; size: rms there over the
    standard deviation allowed."""
    found: list[tuple[float, Region]] = []
    for kind in dict.fromkeys(labels):
        mine = [k for k, label in enumerate(labels) if label == kind]
        ratio = np.concatenate([gap[k] / allowed[k] for k in mine])
        along = {n: np.concatenate([states[k][n] for k in mine]) for n in states[mine[0]]}
        for c, coefficient in enumerate(COEFFICIENTS):
            z = ratio[:, c]
            outside = np.abs(z) > 1.96
            if not len(z) or outside.mean() < DISAGREES:
                continue
            (state, low, high), mask = _telling(outside, along)
            seconds, size = float(outside[mask].sum()) * dt_s, float(np.sqrt(np.mean(z[mask] ** 2)))
            if seconds < _LEAST_S:
                continue
            share = float(outside[mask].mean())
            words = (
                f"{coefficient}, {kind}, {state} {low:.3g} to {high:.3g}: {100 * share:.0f} % of"
                f" samples outside the 95 % interval, {seconds:.1f} s of {len(z) * dt_s:.1f} s; rms"
                f" {size:.1f} times what noise and parameters allow"
            )
            row = Region(
                coefficient=coefficient,
                manoeuvre=kind,
                region={state: [low, high]},
                share_outside_95=share,
                size=size,
                words=words,
            )
            found.append((size * seconds, row))
    return [row for _, row in sorted(found, key=lambda f: -f[0])][:most]


def _telling(
    outside: NDArray[np.bool_], states: Mapping[str, FloatArray]
) -> tuple[tuple[str, float, float], NDArray[np.bool_]]:
    """The region, a third of some state's samples, in which most of the samples outside are
    gathered.
    """
    found = []
    for name, values in states.items():
        for low, high in pairwise(np.quantile(values, [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0]).tolist()):
            mask = (values >= low) & (values <= high)
            if mask.sum() >= 10 and high > low:
                found.append(((name, low, high), mask))
    everywhere = ("all", math.nan, math.nan), np.ones(len(outside), dtype=bool)
    return max(found, key=lambda f: float(outside[f[1]].mean()), default=everywhere)


# Sentences about effects: why one was named, and which manoeuvre would separate two of them.

_EXCITES = {
    "alpha": (
        "slow changes of angle of attack by speed (level flight from the slowest to the fastest)"
    ),
    "beta": "steady sideslips at several angles",
    "p_hat": "aileron doublets of two sizes and lengths",
    "q_hat": "elevator doublets of two lengths",
    "r_hat": "rudder doublets of two lengths",
    "alphadot_hat": (
        "elevator doublets beside turns at constant angle of attack: alphadot without q and q"
        " without alphadot"
    ),
    "betadot_hat": "flat turns beside rudder doublets: r without betadot",
    "de": "elevator steps at constant speed, by throttle",
    "da": "short aileron pulses: deflection before there is a roll rate",
    "dr": "short rudder pulses: deflection before there is a yaw rate",
    "dt": "throttle steps",
    "CT": "throttle doublets at constant speed and angle of attack",
    "V_rel": "the same manoeuvres at widely different speeds, thrust held",
    "h_over_b": "the same manoeuvres high and low",
}
_SUBSYSTEM = {
    "stall": "a slow approach to the stall, and a fast one",
    "propulsion": "throttle doublets at two speeds; a static thrust measurement",
    "mass": (
        "none in the air: a swing test on the ground measures Ixz, weighing the centre of gravity"
    ),
    "actuator": "the surface moved on the ground with its position logged",
    "sensor": "calibration of the sensor on the ground",
    "ground": "the same manoeuvre low and high",
    "record": "a tap on the aircraft logged by all sensors",
}


def why(effect: Effect, choice: Choice) -> str:
    """One sentence: physics, where it shows, how strongly the flights say so."""
    sign = "positive" if choice.value > 0 else "negative"
    usual = f", where {effect.sign} is usual" if effect.sign else ""
    where = f"; it shows in {effect.regime}" if effect.regime else ""
    source = f" ({effect.reference})" if effect.reference else ""
    return (
        f"{effect.physics}{where}{source}. Estimate {choice.value:.4g} ± {choice.std:.2g}"
        f" ({sign}{usual}), |t| {abs(choice.t):.1f} with standard errors corrected for coloured"
        " residuals"
    )


def separating_manoeuvre(one: Effect, other: Effect) -> str:
    """The manoeuvre that would separate two effects that these flights do not."""
    for effect in (one, other):
        part = (effect.subsystem or "").partition(".")[0]
        if part == "mass" and effect.term == "Ixz":
            return (
                "measure Ixz on the ground (swing test); in the air a wrong Ixz is pitching moment"
                " from roll rate squared and, with the other sign, from yaw rate squared: rudder"
                " doublets separate them only as long as the aircraft has no moment from yaw rate"
                " squared of its own"
            )
        if part in _SUBSYSTEM:
            return _SUBSYSTEM[part]
    a, b = one.parsed, other.parsed
    assert a is not None
    assert b is not None
    apart = [v for v in (*a.variables, *b.variables) if (v in a.variables) != (v in b.variables)]
    if not apart:
        return (
            f"the same manoeuvres at several amplitudes: {a.text} and {b.text} differ in how they"
            " grow"
        )
    return "; ".join(dict.fromkeys(_EXCITES[v] for v in apart[:2]))


_OF_STATE = {
    "V_mps": "V_rel",
    "alpha_rad": "alpha",
    "beta_rad": "beta",
    "p_radps": "p_hat",
    "q_radps": "q_hat",
    "r_radps": "r_hat",
    "elevator_deg": "de",
    "aileron_deg": "da",
    "rudder_deg": "dr",
    "throttle_pct": "dt",
}


def would_tell(state: str | None, nearest: Sequence[Effect], loudest: tuple[str, float]) -> str:
    """The flight that would tell what is left.

    state: with which the residual goes; nearest: candidates, the best first; loudest: kind of
    manoeuvre in which the channel's residual is largest, and its rms over noise there"""
    kind, ratio = loudest
    said = [
        (
            f"repeat {kind}, where the channel is at {ratio:.2f} times its noise,"
            " at other amplitudes and speeds"
        )
    ]
    if state is not None:
        said.insert(0, _EXCITES[_OF_STATE[state]])
    if len(nearest) > 1:
        first, second = nearest[:2]
        said.append(
            f"to separate {first.name} from {second.name}: {separating_manoeuvre(first, second)}"
        )
    return "; ".join(said)


def contradicted(effect: Effect, choice: Choice, says: str) -> str:
    """What is said of an effect that the train flights ask for and the test flights speak against,
    or do not show beside what is unexplained. says: what the test flights say (judge.Verdict)."""
    asked = f"the train flights ask for {effect.name} (|t| {abs(choice.t):.1f}), and "
    if says == "grew":
        grew = "with it the gap on the test flights grew: it is withdrawn"
        return f"{asked}{grew}; something differs between the flights that has no name here"
    return (
        f"{asked}the test flights do not show it: beside something that nothing explains it is"
        " withdrawn"
    )


def unnamed(effect: Effect, choice: Choice) -> str:
    """What is said of an effect that would have been named, were nothing unexplained beside it."""
    return (
        f"{effect.name} would explain a part of it (|t| {abs(choice.t):.1f}), too little to be"
        " named beside something that nothing explains"
    )


def still_asked(effect: Effect, t: float) -> str:
    """What is said of a candidate that the flights still ask for beside the effects that were
    chosen.
    """
    return (
        f"{effect.name} is still asked for (|t| {abs(t):.1f}): it, or something like it, is missing"
    )


# Where a residual stands above its noise: in which stretch of time, in which band of
# frequencies, and with which state.
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
MOST_BLOCKS, MOST_BANDS = 64, 24
"""Blocks and frequencies of one series: more are put together, so that a long log costs no more
rectangles.
"""
LEAST_SAMPLES = 16
WINDOW_LIKENESS = (4.0 / 9.0, 1.0 / 36.0)
"""Correlation of the periodogram's neighbours, one and two apart, that the Hann window makes of
independent ones.
"""
BY_CHANCE = 0.01
"""Chance that anything is placed in noise alone."""
TENTHS = 10


@dataclass(frozen=True)
class Burst:
    """Rows [start, stop) and band [Hz] of a series in which it stands above the noise.

    gain: equation (G), corrected for the window; p: chance that noise alone gives as much in any
    rectangle of this series"""

    start: int
    stop: int
    low_hz: float
    high_hz: float
    gain: float
    p: float


@dataclass(frozen=True)
class With:
    """The range [low, high] of a state with which a series goes, the share of its variance that the
    state explains, and the p-value of that share among the states tried. of: "mean" where its mean
    changes with the state, "size" where its square does."""

    state: str
    low: float
    high: float
    share: float
    of: str
    p: float


def loudest(white: FloatArray, rate_hz: float) -> Burst | None:
    """The rectangle of largest gain in a residual over its noise (n,) at equal steps; None where no
    rectangle is above the noise or the series is shorter than `LEAST_SAMPLES`."""
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
    """Rows [start, stop) of the largest gain in the burst's band, whose ends lie within a block of
    the burst's: where in a block it begins, the blocks do not say."""
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
    """(blocks, bands) sums of ordinates, (bands,) ordinates in each band, (bands + 1,) edges [Hz];
    Nyquist's is left out.
    """
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
    """The rectangle of largest gain in blocks of n rows, p that of this rectangle alone, and how
    many rectangles there are.
    """
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
    """By how much the variance of a sum of neighbouring ordinates exceeds that of
    independent ones.
    """
    one, two = (
        c * np.maximum(ordinates - lag, 0.0) / ordinates for lag, c in enumerate(WINDOW_LIKENESS, 1)
    )
    return np.asarray(1.0 + 2.0 * (one + two))


def densest(weights: FloatArray, share: float = 0.5) -> tuple[int, int]:
    """The shortest stretch [start, stop) that holds at least ``share`` of the sum of weights (n,),
    none negative.
    """
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
    """The state, or control, with which a residual goes: a mean by tenths of the state explains
    most of its variance.

    series [(n,)], states name -> (n,) at the same rows; rows that are not finite are left out. A
    residual whose mean goes with nothing is asked for its square. None where chance (`BY_CHANCE`, F
    test with as many samples as the coloured series is worth, all states tried) explains as much;
    certain: the series has no noise, and the state that explains most is told."""
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
    """States on which a residual [(n,)] depends: (name, adjusted share of its variance that a mean
    by tenths of the state explains), the largest first."""
    y = np.concatenate(series)
    y = y - y.mean()
    every = ((n, _explained(y, np.concatenate([s[n] for s in states]), len(y))) for n in states[0])
    return sorted(((n, row[0]) for n, row in every if row is not None), key=lambda r: -r[1])[:most]


def _explained(
    y: FloatArray, x: FloatArray, worth: float
) -> tuple[float, float, float, float] | None:
    """(adjusted share of y's variance that a mean by tenths of x explains, its p-value, the range
    of x with half of that).
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
    left = worth - len(edges) + 1
    F = share / free / max((1.0 - share) / left, 1e-300)
    low, high = densest(part)
    adjusted = 1.0 - (1.0 - share) * (worth - 1.0) / left
    return adjusted, float(f_tail(F, free, left)), float(edges[low]), float(edges[high])


# Where the strongest of what a refinement leaves sits: flight, stretch of time, channel, band,
# state, and what comes nearest.
#
# The place is that of largest gain in `scan.loudest`, over the channels that are above their
# noise or coloured, on train and hold-out flights. Where every channel is at its noise and a
# candidate is asked for all the same, the place is that of the candidate's own trace in the
# residual. What candidates would leave is told by the linearised likelihood of the train
# flights, everything estimated again beside each.

NEAREST = 3
LOOKED_AT = 12
"""Candidates of largest gain that are asked what they leave of the channel."""
NOTHING = (
    "every channel of the train and hold-out flights is at its noise, and no candidate is asked for"
)
_STATES = ("V_mps", "alpha_rad", "beta_rad", "p_radps", "q_radps", "r_radps")
_CONTROLS = ("elevator_deg", "aileron_deg", "rudder_deg", "throttle_pct")


@dataclass(frozen=True)
class Series:
    """One channel of one segment: residual over noise (n,) at time_s (n,), where it was measured;
    states at all rows.
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
        """Residual at the rows at which the channel was measured."""
        return self.white[np.isfinite(self.white)]

    @property
    def rate_hz(self) -> float:
        """Measured rows a second; NaN below two."""
        t = self.time_s[np.isfinite(self.white)]
        return float((len(t) - 1) / (t[-1] - t[0])) if len(t) > 1 else float("nan")


def place_of(
    judged: Judged,
    left: Mapping[str, Sequence[str]],
    asked: Sequence[str],
    controls: Sequence[FloatArray],
) -> ResidualLocation:
    """`remaining.place` of refinement.json where something remains.

    left      "train", "test" -> channels that are above their noise or coloured there
    asked     keys of what the train flights ask for beside the effects, or of effects that have
    another form than what is missing controls  positions in every train segment"""
    setup, _, shown = judged.train
    other, _, fitted = judged.test
    both = series_of("train", setup, shown, controls) + series_of(
        "test", other, fitted, [s.controls for s in other.segments]
    )
    nearest = Nearest(judged.found)
    if any(left.values()):
        place, goes = where_loudest([s for s in both if s.channel in left[s.flights]])
    else:
        place, goes = _where_asked(nearest, [s for s in both if s.flights == "train"], asked[0])
    candidates, now = nearest.leaving(place["channel"], {c.key for c in judged.withdrawn})
    effects = [judged.found.effects[k] for k, _, _ in candidates]
    parts = {
        "channel_on_train": now,
        "candidates": [
            NearbyCandidate(**label(e), name=e.name, t=t, leaves=leaves)
            for e, (_, t, leaves) in zip(effects, candidates, strict=True)
        ],
        "would_tell": would_tell(
            None if goes is None else goes.state, effects, _loudest_manoeuvre(both, place)
        ),
    }
    return ResidualLocation(**(place | parts))


def no_place(reason: str) -> dict[str, Any]:
    """The place of nothing."""
    names = (
        "flights",
        "flight",
        "manoeuvre",
        "channel",
        "from_s",
        "to_s",
        "from_Hz",
        "to_Hz",
        "rms_over_noise",
        "share_of_excess",
    )
    empty: dict[str, Any] = dict.fromkeys((*names, "p", "state", "channel_on_train", "would_tell"))
    return empty | {"candidates": [], "reason": reason, "state_reason": reason}


def series_of(
    flights: str, setup: FlightData, shown: Shown, controls: Sequence[FloatArray]
) -> list[Series]:
    """Every channel of every segment of one side's flights."""
    return [
        Series(flights, s.flight, s.kind, c, w[:, k], s.time_s, states)
        for s, w, states in zip(
            setup.segments, shown.white, states_along(shown.flown, controls), strict=True
        )
        for k, c in enumerate(setup.outputs)
    ]


def states_along(flown: Trajectory, controls: Sequence[FloatArray]) -> list[dict[str, FloatArray]]:
    """States and controls by name, each (n,), one mapping a segment."""
    both = zip(flown.x, controls, strict=True)
    return [
        dict(zip(_STATES, x.T, strict=False)) | dict(zip(_CONTROLS, u.T, strict=False))
        for x, u in both
    ]


def where_loudest(series: Sequence[Series]) -> tuple[dict[str, Any], With | None]:
    """Place of the largest gain over noise; where chance alone would give it, the loudest channel
    without an interval.
    """
    long = [s for s in series if len(s.present) >= LEAST_SAMPLES]
    found = [(burst, s) for s in long if (burst := loudest(s.present, s.rate_hz)) is not None]
    burst, best = max(
        found, key=lambda f: f[0].gain, default=(None, max(series, key=lambda s: rms(s.white)))
    )
    alike = [s for s in series if (s.flights, s.channel) == (best.flights, best.channel)]
    goes = goes_with([s.white for s in alike], [s.states for s in alike])
    p = 1.0 if burst is None else min(1.0, burst.p * len(found))
    named = no_place("") | {
        "flights": best.flights,
        "channel": best.channel,
        "p": p,
        **_state(goes),
    }
    named["rms_over_noise"] = rms(np.concatenate([s.white for s in alike]))
    if burst is None or p > BY_CHANCE:
        return (
            named
            | {
                "reason": (
                    "no stretch and no band stands above the noise by more than chance gives (p"
                    f" {p:.2g})"
                )
            },
            goes,
        )
    rows = np.flatnonzero(np.isfinite(best.white))[burst.start : burst.stop]
    inside = best.white[rows]
    excess = sum(float(np.nansum(s.white**2 - np.isfinite(s.white))) for s in alike)
    held = float(np.sum(inside**2 - 1.0))
    return (
        named
        | {
            "flight": best.flight,
            "manoeuvre": best.manoeuvre,
            "from_s": float(best.time_s[rows[0]]),
            "to_s": float(best.time_s[rows[-1]]),
            "from_Hz": burst.low_hz,
            "to_Hz": burst.high_hz,
            "rms_over_noise": rms(inside),
            "share_of_excess": min(held / excess, 1.0) if held > 0.0 and excess > 0.0 else None,
            "reason": None,
        },
        goes,
    )


class Nearest:
    """Candidates beside the chosen effects, on the linearised likelihood of the train flights."""

    def __init__(self, found: Found) -> None:
        self.found = found
        self.evidence = evidence_of(found, list(found.effects))
        self.free = [n for n in self.evidence.names if n not in found.effects] + [
            c.key for c in found.selection.chosen
        ]
        rest = [e for e in found.effects.values() if e.key not in self.free]
        # What flew and does not stand is among the columns of the fit, beside which nothing of it
        # would be left.
        flew = [e.key for e in rest if e.key in found.flown]
        open_ = eligible(
            [e for e in rest if e.key not in flew],
            found.setup,
            found.after.columns[0].names,
            self.evidence,
        )
        self.scores = scores(self.evidence, self.free, [*open_, *flew])

    def residual(self, *more: str, without: str = "") -> list[FloatArray]:
        """[(n, m)] residuals over noise with everything fitted beside these candidates, less one
        effect.
        """
        free = [n for n in (*self.free, *more) if n != without]
        return self.evidence.residual(self.evidence.fitted(self.evidence.index(free)))

    def trace(self, key: str) -> list[FloatArray]:
        """[(n, m)] what a candidate would explain beside the effects, or an effect does beside the
        others.
        """
        having = self.residual(*(() if key in self.free else (key,)))
        return [a - b for a, b in zip(self.residual(without=key), having, strict=True)]

    def leaving(self, channel: str, gone: set[str]) -> tuple[list[tuple[str, float, float]], float]:
        """Three candidates (key, t, rms over noise that each leaves of the channel), and what is
        there without any. gone: keys that the hold-out flights spoke against."""
        k = self.found.setup.outputs.index(channel)
        order = np.argsort(-np.nan_to_num(self.scores.gain, nan=-1.0))
        asked = [
            i for i in order if self.scores.names[i] not in gone and np.isfinite(self.scores.t[i])
        ][:LOOKED_AT]
        rows = [
            (self.scores.names[i], float(self.scores.t[i]), self._rms(k, self.scores.names[i]))
            for i in asked
        ]
        return sorted(rows, key=lambda r: r[2])[:NEAREST], self._rms(k)

    def _rms(self, k: int, *more: str) -> float:
        return rms(np.concatenate([e[:, k] for e in self.residual(*more)]))


def _where_asked(
    nearest: Nearest, series: Sequence[Series], key: str
) -> tuple[dict[str, Any], With | None]:
    """Place of what a candidate or an effect explains on the train flights: the half of it that
    lies closest together in time, and in frequency."""
    setup, trace = nearest.found.setup, nearest.trace(key)
    power = np.array([np.nansum(d**2, axis=0) for d in trace])
    k = int(np.argmax(power.sum(axis=0)))
    s = int(np.argmax(power[:, k]))
    alike = [e for e in series if e.channel == setup.outputs[k]]
    best, d = alike[s], np.nan_to_num(trace[s][:, k])
    start, stop = densest(d**2)
    low, high = band_of(d, 1.0 / setup.segments[s].dt_s)
    goes = goes_with([e[:, k] for e in trace], [e.states for e in alike], certain=True)
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
        **_state(goes),
        "reason": None,
    }, goes


def _state(goes: With | None) -> dict[str, Any]:
    if goes is None:
        return {
            "state": None,
            "state_reason": "no state and no control explains more of it than chance does",
        }
    return {"state": asdict(goes), "state_reason": None}


def label(effect: Effect) -> dict[str, Any]:
    """An effect's coefficient or subsystem, and its term."""
    where = (
        {"coefficient": effect.coefficient}
        if effect.coefficient is not None
        else {"subsystem": effect.subsystem or ""}
    )
    return {**where, "term": effect.term}


def _loudest_manoeuvre(series: Sequence[Series], place: Mapping[str, Any]) -> tuple[str, float]:
    """Kind of manoeuvre in which the channel's residual is largest, and its rms over noise
    there.
    """
    mine = [s for s in series if (s.flights, s.channel) == (place["flights"], place["channel"])]
    kinds = dict.fromkeys(s.manoeuvre for s in mine)
    sizes = {
        kind: rms(np.concatenate([s.white for s in mine if s.manoeuvre == kind])) for kind in kinds
    }
    return max(sizes.items(), key=lambda size: size[1])


MOST_SAID = 3
"""Candidates still asked for that are told in words; the others stand in `remaining.where`
alone.
"""
_AXES = (("p_radps", "Cl", "roll"), ("q_radps", "Cm", "pitch"), ("r_radps", "Cn", "yaw"))


def find_disagreements(
    setup: FlightData, shown: Shown, settled: Shown, controls: Sequence[Any]
) -> list[Region]:
    """Where ``shown`` lies outside what noise gives. A model that is at the noise in flight leaves
    more than that in coefficients, because held commands and gusts have their share there; then
    what it leaves is what is allowed."""
    kinds = [s.kind for s in setup.segments]
    allowed = [settled.floor] * len(kinds)
    if all(
        settled.channel_rms(k) <= NOISE_FLOOR * float(settled.noise[k])
        for k in range(len(setup.outputs))
    ):
        pairs = list(zip(kinds, settled.coefficients, strict=True))
        together = {kind: np.concatenate([g for k, g in pairs if k == kind]) for kind in kinds}
        allowed = [
            np.maximum(settled.floor, np.sqrt(np.mean(together[kind] ** 2, axis=0)))
            for kind in kinds
        ]
    each_row = [
        np.broadcast_to(a, g.shape) for a, g in zip(allowed, shown.coefficients, strict=True)
    ]
    return disagreements(
        shown.coefficients, each_row, _ranges(shown, controls), kinds, setup.segments[0].dt_s
    )


def _ranges(shown: Shown, controls: Sequence[Any]) -> list[dict[str, Any]]:
    """States in which regions are looked for, one mapping a segment: rates by their size."""
    rates = {rate: f"abs_{rate}" for rate, _, _ in _AXES}
    along = states_along(shown.flown, controls)
    return [
        {rates.get(n, n): np.abs(v) if n in rates else v for n, v in states.items()}
        for states in along
    ]


def _remaining(chosen: Found, judged: Judged, controls: Sequence[Any]) -> Remaining:
    """Whether anything is left that noise does not explain, where, and on what it depends."""
    found, (setup, _, after), (other, _, fitted) = judged.found, judged.train, judged.test
    left, held_out = left_in(setup, after, found.gusty), left_in(other, fitted, found.gusty)
    effects, refused, moments = chosen.effects, found.selection.refused, moments_of(chosen)
    strong = [refused] if refused is not None and refused.strong else []
    # What the train flights ask for and the test flights speak against is a disagreement without a
    # name, unless chance asked.
    against = [c for c in judged.withdrawn if abs(c.t) > chosen.limit + DIFFERENT]
    told = {c.key for c in (*against, *chosen.unnamed, *chosen.selection.chosen)}
    more = [(key, t) for key, t in chosen.left if key not in told]
    bent = [] if chosen.bent is None else [chosen.bent]
    where = [_unconfirmed(found.effects[r.key], r) for r in strong]
    where += _disagreeing(setup, after, controls) if left else []
    where += [
        _told(effects[c.key], c.t, contradicted(effects[c.key], c, judged.verdicts[c.key].says))
        for c in against
    ]
    where += [_bent(b, [effects[k] for k in b.instead]) for b in bent]
    where += [_told(effects[c.key], c.t, unnamed(effects[c.key], c)) for c in chosen.unnamed]
    where += [_still_asked(effects[key], t, k) for k, (key, t) in enumerate(more)]
    where += moments.values()
    contradicts = bool(against) and not found.selection.chosen
    # Moments that only noise explains are air: a missing effect has a score, a curve or residuals.
    unexplained = bool(left) or bool(strong) or contradicts or bool(more) or bool(bent)
    sides = {
        "train": [*left.above, *left.coloured, *moments],
        "test": [*held_out.above, *held_out.coloured],
    }
    if unexplained or any(sides.values()):
        asked = [
            *(key for key, _ in more),
            *(r.key for r in strong),
            *(c.key for c in (*chosen.unnamed, *judged.withdrawn)),
        ]
        place = place_of(judged, sides, [*asked, *(k for b in bent for k in b.instead)], controls)
    else:
        place = ResidualLocation(**no_place(NOTHING))
    near = strong_of(place.candidates, {*told, *(key for key, _ in more)})
    where += [_still_asked(effects[key], t, len(more) + k) for k, (key, t) in enumerate(near)]
    return Remaining(
        unexplained=unexplained,
        where=where,
        channels_above_noise={**left.above},
        coloured_channels=list(left.coloured),
        place=place,
    )


def _disagreeing(setup: FlightData, shown: Shown, controls: Sequence[Any]) -> list[RemainingPart]:
    """Regions in which coefficients disagree, then coefficients above their noise and the states on
    which they depend.
    """
    regions = find_disagreements(setup, shown, shown, controls)
    out = [RemainingPart(**region.as_json()) for region in regions]
    states = _ranges(shown, controls)
    for k, c in enumerate(COEFFICIENTS):
        ratio = shown.coefficient_rms(k) / float(shown.floor[k])
        if ratio > NOISE_FLOOR:
            depends = [
                State(state=n, share=s)
                for n, s in dependence([g[:, k] for g in shown.coefficients], states)
            ]
            out.append(RemainingPart(coefficient=c, rms_over_noise=ratio, depends_on=depends))
    return out


def _unconfirmed(effect: Effect, refused: Refusal) -> RemainingPart:
    """Where the residual is and on what it depends, from the nearest candidate that was not
    confirmed.
    """
    term = effect.parsed
    depends = [] if term is None else [State(state=v) for v in term.variables]
    words = (
        f"something is missing in {effect.coefficient or effect.subsystem} that depends on "
        f"{', '.join(d.state for d in depends) or effect.term}: {effect.name} comes "
        f"nearest (|t| {abs(refused.t):.1f}), but {refused.why}"
    )
    return RemainingPart(**label(effect), depends_on=depends, t=refused.t, words=words)


def document_of(
    chosen: Found, judged: Judged, aircraft: Aircraft, controls: Sequence[Any]
) -> Refinement:
    """refinement.json as far as flights and models say it.

    chosen: what the train flights say, before the test flights were asked; aircraft: as given;
    controls: of every train segment"""
    found, (setup, before, after) = judged.found, judged.train
    switches = {c.key: switch_of(chosen.effects[c.key], aircraft) for c in chosen.selection.chosen}
    effects = [
        EffectDocument(**_effect(found, c, judged.verdicts[c.key], switches))
        for c in found.selection.chosen
    ]
    withdrawn = [
        Withdrawn(**_effect(chosen, c, judged.verdicts[c.key], switches, withdrawn=True))
        for c in judged.withdrawn
    ]
    remaining = _remaining(chosen, judged, controls)
    refused = found.selection.refused
    return Refinement(
        verdict=(
            "unexplained"
            if remaining.unexplained
            else "effects-found"
            if effects
            else "no-missing-effect"
        ),
        disagreement=find_disagreements(setup, before, after, controls),
        effects=effects,
        withdrawn=withdrawn,
        chosen=[
            EffectDocument(**_effect(chosen, c, None, switches)) for c in chosen.selection.chosen
        ],
        remaining=remaining,
        gap=Gaps(train=gap_document(*judged.train), test=gap_document(*judged.test)),
        switch=[
            Switch(property=s[0], off=s[1])
            for c in found.selection.chosen
            if (s := switches[c.key]) is not None
        ],
        parameters={n: Identified(value=v, std=s) for n, (v, s) in found.parameters.items()},
        best_refused=(
            None
            if refused is None
            else RefusedCandidate(
                effect=refused.key.removeprefix("effect/"), t=refused.t, why=refused.why
            )
        ),
        candidates=Candidates(
            limit=found.limit, scores=[Score(effect=name, t=t) for name, t in found.scoreboard]
        ),
        timing=Timing(controls_late_s=found.controls_late_s),
        trail=list(found.trail),
        notes=[*found.notes, *(n for f in setup.flights for n in f.notes)],
    )


def moments_of(chosen: Found) -> dict[str, RemainingPart]:
    """Return by angular rate a sentence on moments about its axis that the gust model does not
    describe.
    """
    rows = {}
    for (rate, c, axis), gain in zip(
        _AXES, () if chosen.gusts is None else chosen.gusts.moments, strict=False
    ):
        if gain > CERTAIN_T**2 and rate in chosen.setup.outputs:
            gains = f"allowing for them gains {gain:.0f} in twice the log likelihood"
            words = (
                f"air that the gust model does not describe moves the aircraft about the {axis}"
                f" axis: {gains}"
            )
            rows[rate] = RemainingPart(coefficient=c, twice_log_likelihood=gain, words=words)
    return rows


def _bent(form: Bent, instead: Sequence[Effect]) -> RemainingPart:
    """A curve in effects' own states that shows that they have not the form of what is missing."""
    words = (
        f"what is missing in {form.coefficient} does not have the form of"
        f" {' and '.join(e.name for e in instead)}: beside {'them' if len(instead) > 1 else 'it'} a"
        f" {form.name} gains {form.gain:.0f} in twice the log likelihood"
    )
    return RemainingPart(
        coefficient=form.coefficient,
        depends_on=[State(state=s) for s in form.states],
        twice_log_likelihood=form.gain,
        p=form.p,
        words=words,
    )


def strong_of(
    candidates: Sequence[NearbyCandidate], told: Collection[str]
) -> list[tuple[str, float]]:
    """(key, t) of the nearest candidates beside what stands that have more than CERTAIN_T and are
    not told yet: an effect that was withdrawn had their place."""
    keys = [f"effect/{c.coefficient or c.subsystem}/{c.term}" for c in candidates]
    return [
        (k, c.t)
        for k, c in zip(keys, candidates, strict=True)
        if abs(c.t) > CERTAIN_T and k not in told
    ]


def _still_asked(effect: Effect, t: float, rank: int) -> RemainingPart:
    return (
        _told(effect, t, still_asked(effect, t))
        if rank < MOST_SAID
        else RemainingPart(**label(effect), t=t)
    )


def _told(effect: Effect, t: float, words: str) -> RemainingPart:
    return RemainingPart(**label(effect), t=t, words=words)


def _effect(
    found: Found,
    c: Choice,
    verdict: Verdict | None,
    switches: Mapping[str, tuple[str, float] | None],
    withdrawn: bool = False,
) -> dict[str, Any]:
    """One effect; what the test flights say of it is no part of what was chosen."""
    e, switch = found.effects[c.key], switches[c.key]
    value, std, unit = _as_written(found, e, c)
    test = verdict and {
        "withdrawn": withdrawn,
        "test": HoldOutTest(
            change_of_twice_log_likelihood=verdict.change,
            std=verdict.std,
            gap=verdict.says,
            rms_over_that_of_train=verdict.far,
            share_of_estimate=verdict.share[0],
            share_std=verdict.share[1],
        ),
    }
    return {
        **label(e),
        "name": e.name,
        "why": why(e, c),
        "value": value,
        "std": std,
        "unit": unit,
        "property": None if switch is None else switch[0],
        "evidence": EvidenceDocument(
            t=c.t,
            twice_log_likelihood=c.gain,
            confirmed_on_held_out_manoeuvres=c.confirmed_gain,
            held_out_estimate_differs_by_std=c.difference,
            interval_95=_interval(found, e, c),
        ),
        **(test or {}),
        "alternatives": [_alternative(found, e, a) for a in c.alternatives],
    }


def _interval(found: Found, e: Effect, c: Choice) -> list[float | None]:
    """95 % interval of the number as it stands in the XML, given that it was chosen; open above
    where a servo is never asked for more than its rate limit."""
    low, high = chosen_interval(c, found.limit)
    ends = sorted(_as_written(found, e, replace(c, value=v))[0] for v in (low, high))
    return [ends[0], None if e.term == "rate_limit" and is_fastest(c, found.setup) else ends[1]]


def _as_written(found: Found, e: Effect, c: Choice) -> tuple[float, float, str]:
    """Value, standard error and unit as the number stands in the XML: a servo's lag there is 1/s,
    its rate limit deg/s.
    """
    surface = (e.subsystem or "").partition(".")[2]
    servo = found.setup.servos.get(surface)
    if e.term == "lag" and servo is not None:
        rate = servo.lag_with(c.value)
        return rate, rate**2 * c.std, "1/s"
    if e.term == "rate_limit":
        limit = (servo or Actuator(None)).slowed_to(c.value)
        return limit, limit**2 * c.std, "deg/s"
    return c.value, c.std, e.unit


def _alternative(found: Found, own: Effect, a: Alternative) -> AlternativeDocument:
    other = found.effects[a.key]
    advice = {} if a.separable else {"would_separate": separating_manoeuvre(own, other)}
    return AlternativeDocument(
        **label(other),
        name=other.name,
        evidence=AlternativeEvidence(
            twice_log_likelihood=a.gain,
            t_of_the_effect_beside_it=a.t_beside,
            likeness=a.likeness,
            companions=[c.removeprefix("effect/") for c in a.companions],
        ),
        separable=a.separable,
        **advice,
    )


# What a notebook shows of a refinement, from its document.


def refinement_view(title: str, document: Refinement) -> str:
    """Verdict, effects with estimate and standard deviation, and each channel's residual on the
    test flights.
    """
    effects = [
        {
            "effect": e.name,
            "property": e.property or "",
            "estimate": math.nan if e.value is None else e.value,
            "std": math.nan if e.std is None else e.std,
            "unit": e.unit,
        }
        for e in document.effects
    ]
    gaps = [
        {
            "channel": name,
            "before [sigma]": _ratio(row.rms_before, row.noise_rms),
            "after [sigma]": _ratio(row.rms_after, row.noise_rms),
        }
        for name, row in document.gap.test.channels.items()
    ]
    residual = "<p>Residual on the test flights</p>"
    return view(
        title,
        rows_table(effects),
        residual,
        rows_table(gaps),
        facts={"verdict": document.verdict},
    )


def _ratio(rms: float | None, noise: float | None) -> float:
    return math.nan if rms is None or not noise else rms / noise
