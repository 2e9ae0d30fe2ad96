"""Proof of match: which objective tests the segments of a flight contain, and whether the model
stays within their tolerances.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from sysid.arrays import FloatArray
from sysid.units import DEG_RAD, FT_M, G0_MPS2, KT_MPS
from uqharness.replay import History

# Objective tests of 14 CFR Part 60, Appendix A, Attachment 2, Table A2A with their tolerances,
# as data.
#
# Checked line by line against the edition of 1 January 2014 (14 CFR Ch. I, pages 53 to 58).
# Where a test gives two tolerances for a parameter, the less restrictive one counts (paragraph
# 2 of that attachment). A tolerance in percent is taken of the measured value at each moment,
# except where the table says of the peak.
#
# Left out: tests of ground handling, take-off, landing, engines, forces on the controls and
# failures, of which a flight record says nothing.

REGULATION = "14 CFR Part 60, Appendix A, Attachment 2, Table A2A"


@dataclass(frozen=True)
class Band:
    """A tolerance of a channel throughout a time history.

    channel   of a flight record, in its unit; absolute: half width in that unit; share: of the
    measured value, 0 for none of_peak   the share is of the greatest measured value, not of that of
    each moment
    one_of    bands with the same word are alternatives, of which one has to hold
    """

    channel: str
    absolute: float
    share: float = 0.0
    of_peak: bool = False
    one_of: str = ""


@dataclass(frozen=True)
class Oscillation:
    """Tolerances of a mode that the controls, once at rest, leave to itself.

    channel     in which it is measured
    period_s    absolute tolerance of the period [s], 0 for none; the greater of it and period_share
    counts half_share  of the time to half or double amplitude; damping: absolute, of the damping
    ratio; one of the two has to hold
    cycles      that the test needs; 0: as many as tell the time to half or double amplitude
    shortest_s, longest_s  periods [s] that are looked for
    """

    channel: str
    period_s: float
    period_share: float
    half_share: float
    damping: float
    cycles: float
    shortest_s: float
    longest_s: float


@dataclass(frozen=True)
class Test:
    """One test of the table.

    entry      number of its line; tolerance: in words, as the table means it
    control    that makes the manoeuvre; "" for none before_s, after_s  record that it needs before
    and after the input peak_radps  least and greatest peak of the measured rate with which the
    input counts as such; None: any"""

    entry: str
    title: str
    tolerance: str
    control: str
    bands: tuple[Band, ...] = ()
    oscillation: Oscillation | None = None
    before_s: float = 0.0
    after_s: float = 0.0
    peak_radps: tuple[float, float] | None = None


_SMALL_PEAK_RADPS = (0.5 * DEG_RAD, 2.0 * DEG_RAD)


def _small_input_test(entry: str, axis: str, control: str, channel: str) -> Test:
    return Test(
        entry,
        f"Small control inputs, {axis}",
        f"±0.15°/s body {axis} rate or ±20 % of its peak, throughout",
        control,
        (Band(channel, 0.15 * DEG_RAD, 0.20, of_peak=True),),
        before_s=5.0,
        after_s=5.0,
        peak_radps=_SMALL_PEAK_RADPS,
    )


TESTS = (
    _small_input_test("2.b.4", "pitch", "elevator", "q_radps"),
    _small_input_test("2.b.5", "roll", "aileron", "p_radps"),
    _small_input_test("2.b.6", "yaw", "rudder", "r_radps"),
    Test(
        "2.c.1",
        "Power change dynamics",
        "±3 kt airspeed, ±100 ft altitude, ±20 % or ±1.5° pitch angle",
        "throttle",
        (
            Band("V_mps", 3.0 * KT_MPS),
            Band("h_m", 100.0 * FT_M),
            Band("theta_rad", 1.5 * DEG_RAD, 0.20),
        ),
        before_s=5.0,
        after_s=15.0,
    ),
    Test(
        "2.c.9",
        "Phugoid dynamics",
        "±10 % period; ±10 % time to half or double amplitude, or ±0.02 damping ratio",
        "",
        oscillation=Oscillation("V_mps", 0.0, 0.10, 0.10, 0.02, 3.0, 5.0, 120.0),
    ),
    Test(
        "2.c.10",
        "Short period dynamics",
        "±1.5° pitch angle or ±2°/s pitch rate; ±0.10 g acceleration",
        "elevator",
        (
            Band("theta_rad", 1.5 * DEG_RAD, one_of="pitch"),
            Band("q_radps", 2.0 * DEG_RAD, one_of="pitch"),
            Band("az_mps2", 0.10 * G0_MPS2),
        ),
    ),
    Test(
        "2.d.2",
        "Roll response (rate)",
        "±10 % or ±2°/s roll rate",
        "aileron",
        (Band("p_radps", 2.0 * DEG_RAD, 0.10),),
    ),
    Test(
        "2.d.4",
        "Spiral stability",
        "correct trend and ±2° or ±10 % bank angle in 20 s",
        "",
        (Band("phi_rad", 2.0 * DEG_RAD, 0.10),),
        after_s=20.0,
    ),
    Test(
        "2.d.6",
        "Rudder response",
        "±2°/s or ±10 % yaw rate",
        "rudder",
        (Band("r_radps", 2.0 * DEG_RAD, 0.10),),
    ),
    Test(
        "2.d.7",
        "Dutch roll",
        "±0.5 s or ±10 % period; ±10 % time to half or double amplitude, or ±0.02 damping ratio",
        "rudder",
        oscillation=Oscillation("r_radps", 0.5, 0.10, 0.10, 0.02, 6.0, 0.3, 20.0),
    ),
)
"""In the table's order. Of 2.d.7 the time between the peaks of bank and sideslip is not judged."""


# Period and damping of a mode from what it does when nothing drives it.

_N_START_PERIODS = 60


@dataclass(frozen=True)
class Mode:
    """A damped sinusoid found in a record.

    period_s   of the oscillation as seen, 2 pi over the damped frequency, and its standard error
    damping    ratio, + where it dies away, and its standard error
    half_s     time to half amplitude, or to double where it grows; infinite without damping
    cycles     periods in the record; amplitude: at its beginning, in the record's unit; left: rms
    of what it does not explain"""

    period_s: float
    period_std_s: float
    damping: float
    damping_std: float
    half_s: float
    cycles: float
    amplitude: float
    residual_std: float


def fit_mode(time_s: FloatArray, y: FloatArray, shortest_s: float, longest_s: float) -> Mode | None:
    """Damped sinusoid beside a straight line, by least squares; None where no period within the
    limits fits the record.

    Parameters
    ----------
    time_s, y : ndarray
        Record (n,) without a driven input; NaN are left out.
    shortest_s, longest_s : float
        Periods [s] that are looked for; none longer than the record.

    Notes ----- Amplitude, phase and line are linear and are solved for at each frequency and decay
    rate (variable projection, Golub and Pereyra 1973). Standard errors are of white residuals."""
    finite = np.isfinite(y)
    t, z = time_s[finite] - time_s[0], y[finite]
    if t.size < 12:
        return None
    span = float(t[-1])
    longest, shortest = min(longest_s, span), max(shortest_s, 4.0 * span / t.size)
    if not longest > shortest:
        return None

    def residual(x: FloatArray) -> FloatArray:
        base = _mode_basis(t, x)
        out: FloatArray = z - base @ np.linalg.lstsq(base, z, rcond=None)[0]
        return out

    starts = [
        np.array([2.0 * math.pi / period, decay * 2.0 * math.pi / period])
        for period in np.geomspace(shortest, longest, _N_START_PERIODS)
        for decay in (0.02, 0.3)
    ]
    first = min(starts, key=lambda x: float(np.sum(residual(x) ** 2)))
    low, high = 2.0 * math.pi / longest, 2.0 * math.pi / shortest
    fit = least_squares(
        residual, first, bounds=([0.9 * low, -high], [1.1 * high, high]), x_scale=np.abs(first)
    )
    omega, decay = (float(v) for v in fit.x)
    if not low <= omega <= high:
        return None
    residual_std = float(np.sqrt(np.sum(fit.fun**2) / max(t.size - 6, 1)))
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * residual_std**2
    natural_radps = math.hypot(omega, decay)
    # Damping ratio is decay over the natural frequency: its derivatives by frequency and decay
    # rate.
    damping_gradient = np.array([-decay * omega, omega**2]) / natural_radps**3
    amplitudes = np.linalg.lstsq(_mode_basis(t, fit.x), z, rcond=None)[0]
    period = 2.0 * math.pi / omega
    return Mode(
        period,
        period * math.sqrt(covariance[0, 0]) / omega,
        decay / natural_radps,
        float(np.sqrt(damping_gradient @ covariance @ damping_gradient)),
        math.log(2.0) / abs(decay) if decay else math.inf,
        span / period,
        float(math.hypot(amplitudes[0], amplitudes[1])),
        residual_std,
    )


def _mode_basis(t: FloatArray, x: FloatArray) -> FloatArray:
    omega, decay = x
    envelope = np.exp(np.clip(-decay * t, -50.0, 50.0))
    return np.column_stack(
        [envelope * np.cos(omega * t), envelope * np.sin(omega * t), np.ones_like(t), t]
    )


CONTROLS = ("elevator", "aileron", "rudder", "throttle")
PASS, FAIL, ABSENT, INCONCLUSIVE = "pass", "fail", "not in the data", "inconclusive"
_MOVED_SHARE = 0.3
"""Of a control's largest travel in a segment, from which it counts as moved; the test's own control
must move and no other.
"""
_AT_REST_SHARE = 0.05  # of its travel within the segment
_NOISE_FACTOR = (
    4.0  # a record of some hundred samples reaches this many standard deviations by noise alone
)
_MIN_CYCLES = 1.5
_NO_SEGMENT = "no segment in which"
_MIN_AMPLITUDE_RATIO = 3.0  # amplitude over what an oscillation leaves unexplained
_MIN_RESPONSE_SHARE = 0.01  # amplitude over the whole response: less is rounding or drift


@dataclass(frozen=True)
class Row:
    """One tolerance in one segment.

    quantity   channel of a record, or ``period``, ``time to half amplitude``, ``damping ratio``
    (``_s`` and no unit)
    worst      largest difference of measured minus model, in the channel's unit, at at_s; band:
    half width there
    share      of the samples inside; measured, model: of an oscillation; answer: one of PASS, FAIL,
    UNSURE; why: of the last"""

    quantity: str
    worst: float
    band: float
    at_s: float
    share: float
    answer: str
    reason: str = ""
    measured: float = math.nan
    model: float = math.nan

    @property
    def ratio(self) -> float:
        """Largest difference over its tolerance."""
        return abs(self.worst) / self.band if self.band else math.inf


@dataclass(frozen=True)
class SegmentResult:
    """A test in a segment: its rows, the answer they give together, and the reason where that is
    neither pass nor fail.
    """

    test: Test
    segment: History
    rows: tuple[Row, ...]
    answer: str
    reason: str = ""


@dataclass(frozen=True)
class Match:
    """All tests of all segments. missing: entry of a test -> why no segment contains it."""

    results: tuple[SegmentResult, ...]
    missing: Mapping[str, str]

    def of(self, entry: str) -> tuple[SegmentResult, ...]:
        """Segments that contain a test."""
        return tuple(j for j in self.results if j.test.entry == entry)


def prove(segments: Sequence[History], suffix: str, noise: Mapping[str, float | None]) -> Match:
    """Every test of the table in every segment.

    Parameters
    ----------
    segments
        Channels as measured, controls by their names, and the model's channels with ``suffix``
        behind their names.
    noise
        Channel -> standard deviation of its sensor's noise, in the channel's unit; None or absent
        where it is not known.
    """
    travel = {
        c: max((_travel(s.columns[c]) for s in segments if c in s.columns), default=0.0)
        for c in CONTROLS
    }
    results: list[SegmentResult] = []
    missing: dict[str, str] = {}
    for test in TESTS:
        outcomes = [_evaluate_segment(test, segment, suffix, noise, travel) for segment in segments]
        segment_results = [x for x in outcomes if isinstance(x, SegmentResult)]
        results += segment_results
        if not segment_results:
            missing[test.entry] = _most_common_reason([x for x in outcomes if isinstance(x, str)])
    return Match(tuple(results), missing)


def limits(band: Band, measured: FloatArray) -> FloatArray:
    """Half width (n,) of a tolerance about what was measured: the less restrictive of its absolute
    value and its share.
    """
    size = np.abs(measured)
    if band.of_peak:
        size = np.full(measured.size, np.max(size, initial=0.0, where=np.isfinite(size)))
    return np.maximum(band.absolute, band.share * size)


def _most_common_reason(reasons: Sequence[str]) -> str:
    """The reason that most segments give; where nothing but other manoeuvres was flown, that."""
    if not reasons:
        return "there is no segment of a flight"
    specific = [r for r in reasons if not r.startswith(_NO_SEGMENT)] or list(reasons)
    return max(dict.fromkeys(specific), key=specific.count)


def _evaluate_segment(
    test: Test,
    segment: History,
    suffix: str,
    noise: Mapping[str, float | None],
    travel: Mapping[str, float],
) -> SegmentResult | str:
    """The test in a segment, or why the segment does not contain it."""
    moved = [
        c
        for c in CONTROLS
        if travel[c] > 0.0 and _travel(segment.columns.get(c)) >= _MOVED_SHARE * travel[c]
    ]
    if test.control and test.control not in moved:
        return f"{_NO_SEGMENT} the {test.control} is moved"
    if test.control and moved != [test.control]:
        return (
            f"{' and '.join(c for c in moved if c != test.control)} moved with the {test.control}"
        )
    start, end = _input_interval(segment, moved)
    before_s, after_s = start - float(segment.time_s[0]), float(segment.time_s[-1]) - end
    if before_s < test.before_s or after_s < test.after_s:
        needs = " and ".join(
            f"{x:g} s {w}" for x, w in ((test.before_s, "before"), (test.after_s, "after")) if x
        )
        input_name = f"the {test.control} input" if test.control else "the last input"
        return (
            f"{needs} {input_name} are needed; the records have {max(before_s, 0.0):.1f} s before and"
            f" {max(after_s, 0.0):.1f} s after"
        )
    if test.oscillation is not None:
        return _evaluate_oscillation(test, test.oscillation, segment, suffix, end)
    missing_channels = [
        b.channel
        for b in test.bands
        if b.channel not in segment.columns or f"{b.channel}{suffix}" not in segment.columns
    ]
    if missing_channels:
        return f"the results have no {missing_channels[0]} of log and model"
    if test.peak_radps is not None:
        values = segment.columns[test.bands[0].channel]
        peak = float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))
        if not test.peak_radps[0] <= peak <= test.peak_radps[1]:
            low, high = (math.degrees(x) for x in test.peak_radps)
            return (
                f"inputs with a peak of {low:g} to {high:g} deg/s are needed; the peak is"
                f" {math.degrees(peak):.3g} deg/s"
            )
    evaluated = segment if test.control else _after(segment, end)
    rows = [_band_row(band, evaluated, suffix, noise.get(band.channel)) for band in test.bands]
    if all(row is None for row in rows):
        return "the records have no samples of its channels"
    return SegmentResult(
        test, segment, tuple(r for r in rows if r is not None), *_combine_answers(test, rows)
    )


def _after(segment: History, start_s: float) -> History:
    """What follows after a time."""
    selected = segment.time_s >= start_s
    return replace(
        segment,
        time_s=segment.time_s[selected],
        columns={c: v[selected] for c, v in segment.columns.items()},
    )


def _band_row(band: Band, segment: History, suffix: str, noise: float | None) -> Row | None:
    measured, model = segment.columns[band.channel], segment.columns[f"{band.channel}{suffix}"]
    finite = np.isfinite(measured) & np.isfinite(model)
    if not finite.any():
        return None
    difference, half_width = (measured - model)[finite], limits(band, measured)[finite]
    worst = int(np.argmax(np.abs(difference) / half_width))
    inside = float(np.mean(np.abs(difference) <= half_width))
    answer, reason = (PASS, "") if inside == 1.0 else (FAIL, "")
    if (
        answer == FAIL
        and noise
        and band.absolute < _NOISE_FACTOR * noise
        and float(half_width.min()) < _NOISE_FACTOR * noise
    ):
        answer, reason = INCONCLUSIVE, "the sensor's noise is too large for this tolerance"
    return Row(
        band.channel,
        float(difference[worst]),
        float(half_width[worst]),
        float(segment.time_s[finite][worst]),
        inside,
        answer,
        reason,
    )


def _combine_answers(test: Test, rows: Sequence[Row | None]) -> tuple[str, str]:
    """Answer and reason of a test from its rows: alternatives need one pass, the others all."""
    groups: dict[str, list[Row | None]] = {}
    for k, (band, row) in enumerate(zip(test.bands, rows, strict=True)):
        groups.setdefault(band.one_of or str(k), []).append(row)
    answers = [_best_alternative(group) for group in groups.values()]
    for decisive in (FAIL, INCONCLUSIVE):
        first_reason = next((why for answer, why in answers if answer == decisive), None)
        if first_reason is not None:
            return decisive, first_reason
    return PASS, ""


def _best_alternative(group: Sequence[Row | None]) -> tuple[str, str]:
    available = [r for r in group if r is not None]
    if not available:
        return INCONCLUSIVE, "a channel has no samples"
    best = min(available, key=lambda r: (PASS, INCONCLUSIVE, FAIL).index(r.answer))
    return best.answer, best.reason


def _evaluate_oscillation(
    test: Test, tolerances: Oscillation, segment: History, suffix: str, from_s: float
) -> SegmentResult | str:
    """The free oscillation after the last input, of log and model."""
    name = tolerances.channel
    if name not in segment.columns or f"{name}{suffix}" not in segment.columns:
        return f"the results have no {name} of log and model"
    free = segment.time_s > from_s
    t = segment.time_s[free]
    if t.size < 12:
        return "the records end with the last input"
    log, model = (
        fit_mode(t, segment.columns[c][free], tolerances.shortest_s, tolerances.longest_s)
        for c in (name, f"{name}{suffix}")
    )
    response = _travel(segment.columns[name])
    if (
        not response
        or log is None
        or log.cycles < _MIN_CYCLES
        or log.amplitude
        <= max(_MIN_AMPLITUDE_RATIO * log.residual_std, _MIN_RESPONSE_SHARE * response)
    ):
        return (
            f"no oscillation of {_MIN_CYCLES:g} cycles or more is seen after the input; the"
            f" records have {t[-1] - t[0]:.1f} s"
        )
    if model is None:
        return SegmentResult(test, segment, (), FAIL, "the model does not oscillate there")
    rows = _mode_rows(tolerances, log, model, float(t[0]))
    needed_cycles = tolerances.cycles
    if log.cycles < needed_cycles and not (
        tolerances.channel == "V_mps" and log.half_s <= t[-1] - t[0]
    ):
        reason = f"{log.cycles:.1f} of the {needed_cycles:g} cycles that the test needs"
        return SegmentResult(test, segment, rows, INCONCLUSIVE, reason)
    damping = min(rows[1:], key=lambda r: (PASS, INCONCLUSIVE, FAIL).index(r.answer))
    answers = [rows[0].answer, damping.answer]
    answer = next((a for a in (FAIL, INCONCLUSIVE) if a in answers), PASS)
    return SegmentResult(
        test,
        segment,
        rows,
        answer,
        "the record is too short or too noisy to tell" if answer == INCONCLUSIVE else "",
    )


def _mode_rows(tolerances: Oscillation, log: Mode, model: Mode, at_s: float) -> tuple[Row, ...]:
    half_std = log.half_s * log.damping_std / abs(log.damping) if log.damping else math.inf
    quantities = (
        (
            "period_s",
            log.period_s,
            model.period_s,
            max(tolerances.period_s, tolerances.period_share * log.period_s),
            log.period_std_s,
        ),
        (
            "time to half or double amplitude_s",
            log.half_s,
            model.half_s,
            tolerances.half_share * log.half_s,
            half_std,
        ),
        ("damping ratio", log.damping, model.damping, tolerances.damping, log.damping_std),
    )
    rows = []
    for quantity, measured, modelled, band, std in quantities:
        difference = measured - modelled
        answer = PASS if abs(difference) <= band else FAIL
        # A measurement less sure than the tolerance can neither hold nor break it.
        inconclusive = not (math.isfinite(difference) and 2.0 * std <= band)
        rows.append(
            Row(
                quantity,
                difference,
                band,
                at_s,
                math.nan,
                INCONCLUSIVE if inconclusive else answer,
                "",
                measured,
                modelled,
            )
        )
    return tuple(rows)


def _travel(values: FloatArray | None) -> float:
    finite = np.empty(0) if values is None else values[np.isfinite(values)]
    return float(np.ptp(finite)) if finite.size else 0.0


def _input_interval(segment: History, moved: Sequence[str]) -> tuple[float, float]:
    """When the moved controls first leave where they stand and last come to rest [s]; both the
    first time where none moves.
    """
    t = segment.time_s
    first, last = float(t[-1]), float(t[0])
    for control in moved:
        values = segment.columns[control]
        changes = np.abs(np.diff(values)) > 0.0
        left_start = np.abs(values - values[0]) > _AT_REST_SHARE * _travel(values)
        off_end = np.abs(values - values[-1]) > _AT_REST_SHARE * _travel(values)
        if changes.any() and left_start.any():
            first = min(first, float(t[int(np.argmax(left_start))]))
            last = max(last, float(t[min(len(t) - 1, len(t) - int(np.argmax(off_end[::-1])))]))
    return (first, last) if moved and last > first else (float(t[0]), float(t[0]))
