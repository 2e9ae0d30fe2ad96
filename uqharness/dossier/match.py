"""Proof of match: objective tests of a flight simulator applied to flight and model.

The tests and tolerances are those of 14 CFR Part 60, Appendix A, Attachment 2, Table A2A, for
handling qualities. `proof_of_match` finds the tests that each segment contains by its control
inputs, and compares measured and simulated time histories. Phugoid and Dutch roll are compared by
period and damping, which `fit_mode` estimates from the free response.
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

# Tests of Table A2A as data, checked against the edition of 1 January 2014 (14 CFR Ch. I, pages 53
# to 58). Where a test gives two tolerances for one parameter, the less restrictive counts
# (paragraph 2 of the attachment). A tolerance in percent refers to the measured value at each
# instant unless the table names the peak. Tests of ground handling, take-off, landing, engines,
# control forces and failures are left out: flight records hold no data for them.

REGULATION = "14 CFR Part 60, Appendix A, Attachment 2, Table A2A"


@dataclass(frozen=True)
class Band:
    """Tolerance of one channel over a time history.

    Attributes
    ----------
    channel : str
        Channel of a flight record.
    absolute : float
        Half width in the channel's unit.
    share : float
        Half width as a share of the measured value; 0 for none. The larger of the two counts.
    of_peak : bool
        Whether `share` refers to the largest measured value instead of each one.
    one_of : str
        Bands with the same text are alternatives: one of them must hold.
    """

    channel: str
    absolute: float
    share: float = 0.0
    of_peak: bool = False
    one_of: str = ""


@dataclass(frozen=True)
class Oscillation:
    """Tolerances of a mode that is compared in free response.

    Attributes
    ----------
    channel : str
        Channel in which the mode is measured.
    period_s, period_share : float
        Tolerance of the period, absolute [s] and relative; the larger counts.
    half_share, damping : float
        Relative tolerance of the time to half or double amplitude, and absolute tolerance of the
        damping ratio; one of the two must hold.
    cycles : float
        Cycles that the test requires.
    shortest_s, longest_s : float
        Search range of the period [s].
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
    """One line of the table.

    Attributes
    ----------
    entry, title : str
        Number and name in the table.
    tolerance : str
        Tolerances as text.
    control : str
        Control of the manoeuvre; empty for none.
    bands, oscillation
        Tolerances of time histories or of a mode.
    before_s, after_s : float
        Length of record [s] required before and after the input.
    peak_radps : tuple of float or None
        Allowed range of the peak rate [rad/s] of the first band; None for any.
    """

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
"""Range of the peak rate [rad/s] that makes a control input "small"."""


def _small_input_test(entry: str, axis: str, control: str, channel: str) -> Test:
    """Return the test of small control inputs about one axis."""
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
"""In the table's order. For 2.d.7, the phase between bank and sideslip is not compared."""


# Period and damping of a mode from its free response.

_N_START_PERIODS = 60
"""Number of periods at which the search of `fit_mode` is started."""


@dataclass(frozen=True)
class Mode:
    """A damped sinusoid fitted to a record.

    Attributes
    ----------
    period_s, period_std_s : float
        Damped period [s] and its standard error.
    damping, damping_std : float
        Damping ratio, positive for a decaying oscillation, and its standard error.
    half_s : float
        Time to half or double amplitude [s]; infinite without damping.
    cycles : float
        Periods in the record.
    amplitude : float
        At the start of the record, in its unit.
    residual_std : float
        Standard deviation of the residual.
    """

    period_s: float
    period_std_s: float
    damping: float
    damping_std: float
    half_s: float
    cycles: float
    amplitude: float
    residual_std: float


def fit_mode(time_s: FloatArray, y: FloatArray, shortest_s: float, longest_s: float) -> Mode | None:
    """Fit a damped sinusoid plus a straight line by least squares.

    Parameters
    ----------
    time_s, y : ndarray
        Record (n,) of a free response; NaN are ignored.
    shortest_s, longest_s : float
        Search range of the period [s], limited by length and sampling of the record.

    Returns
    -------
    Mode or None
        None if no period in the range fits, or the record has fewer than 12 samples.

    Notes
    -----
    Amplitude, phase and line are linear and eliminated at each frequency and decay rate (variable
    projection, Golub and Pereyra 1973). Standard errors assume white residuals.

    Examples
    --------
    >>> t = np.arange(0.0, 10.0, 0.02)
    >>> mode = fit_mode(t, np.exp(-0.3 * t) * np.cos(3.0 * t), 0.5, 10.0)
    >>> f"{mode.period_s:.3f} s, damping {mode.damping:.3f}"
    '2.094 s, damping 0.100'
    """
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

    # The residual has many local minima in frequency: start from the best point of a grid.
    starts = [
        np.array([2.0 * math.pi / period, decay * 2.0 * math.pi / period])
        for period in np.geomspace(shortest, longest, _N_START_PERIODS)
        for decay in (0.02, 0.3)
    ]
    first = min(starts, key=lambda x: float(np.sum(residual(x) ** 2)))
    low, high = 2.0 * math.pi / longest, 2.0 * math.pi / shortest
    # Frequency within the search range, decay rate of either sign.
    fit = least_squares(
        residual, first, bounds=([0.9 * low, -high], [1.1 * high, high]), x_scale=np.abs(first)
    )
    omega, decay = (float(v) for v in fit.x)
    if not low <= omega <= high:
        return None
    # Six parameters: frequency, decay rate, two amplitudes, and the line.
    residual_std = float(np.sqrt(np.sum(fit.fun**2) / max(t.size - 6, 1)))
    # Covariance of frequency and decay rate from the Jacobian.
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * residual_std**2
    natural_radps = math.hypot(omega, decay)
    # zeta = decay/natural: gradient with respect to frequency and decay rate.
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
    """Return the basis (n, 4) of a mode x = (frequency, decay) [rad/s, 1/s]: cosine, sine, 1, t."""
    omega, decay = x
    envelope = np.exp(np.clip(-decay * t, -50.0, 50.0))
    return np.column_stack(
        [envelope * np.cos(omega * t), envelope * np.sin(omega * t), np.ones_like(t), t]
    )


CONTROLS = ("elevator", "aileron", "rudder", "throttle")
PASS, FAIL, ABSENT, INCONCLUSIVE = "pass", "fail", "not in the data", "inconclusive"
_MOVED_SHARE = 0.3
"""A control has moved if its travel exceeds this share of its largest travel in any segment."""
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
    """One tolerance applied to one segment.

    Attributes
    ----------
    quantity : str
        Channel of a record, or a quantity of a mode.
    worst : float
        Largest difference, measured minus model, in the channel's unit.
    band : float
        Tolerance (half width) at that sample.
    at_s : float
        Time of that sample [s].
    share : float
        Share of samples within tolerance; NaN for a mode.
    answer, reason : str
        PASS, FAIL or INCONCLUSIVE, and why it is inconclusive.
    measured, model : float
        Values of a mode; NaN for a time history.
    """

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
        """Return the largest difference divided by its tolerance."""
        return abs(self.worst) / self.band if self.band else math.inf


@dataclass(frozen=True)
class SegmentResult:
    """Result of one test in one segment.

    Attributes
    ----------
    test, segment
        The test and the segment.
    rows : tuple of Row
        One for each tolerance.
    answer, reason : str
        Overall answer, and the reason if it is neither pass nor fail.
    """

    test: Test
    segment: History
    rows: tuple[Row, ...]
    answer: str
    reason: str = ""


@dataclass(frozen=True)
class Match:
    """Results of all tests.

    Attributes
    ----------
    results : tuple of SegmentResult
        One for each test and each segment that contains it.
    missing : mapping
        Entry of a test that no segment contains to the reason.
    """

    results: tuple[SegmentResult, ...]
    missing: Mapping[str, str]

    def of(self, entry: str) -> tuple[SegmentResult, ...]:
        """Return the results of the test with this entry."""
        return tuple(j for j in self.results if j.test.entry == entry)


def proof_of_match(
    segments: Sequence[History], suffix: str, noise: Mapping[str, float | None]
) -> Match:
    """Apply every test of the table to every segment.

    Parameters
    ----------
    segments : sequence of History
        Measured channels and controls by their names, and simulated channels with ``suffix``
        appended.
    suffix : str
        Suffix of simulated channels.
    noise : mapping
        Channel to standard deviation of its sensor noise, in the channel's unit; None if unknown.

    Returns
    -------
    Match
        Results, and the tests that no segment contains.
    """
    # The largest travel of each control in any segment is the scale for "moved".
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
        # No segment contains the test: give the most common reason.
        if not segment_results:
            missing[test.entry] = _most_common_reason([x for x in outcomes if isinstance(x, str)])
    return Match(tuple(results), missing)


def limits(band: Band, measured: FloatArray) -> FloatArray:
    """Return the half width (n,) of a tolerance, the larger of its absolute and relative value.

    Parameters
    ----------
    band : Band
        The tolerance.
    measured : ndarray
        Measured channel (n,), in its unit.
    """
    size = np.abs(measured)
    if band.of_peak:
        size = np.full(measured.size, np.max(size, initial=0.0, where=np.isfinite(size)))
    return np.maximum(band.absolute, band.share * size)


def _most_common_reason(reasons: Sequence[str]) -> str:
    """Return the most frequent reason; "no segment" counts only if there is no other."""
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
    """Return the result of a test, or the reason why the segment does not contain it."""
    # A test is contained if its own control moves and no other does.
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
    # Input interval of the controls that moved.
    start, end = _input_interval(segment, moved)
    before_s, after_s = start - float(segment.time_s[0]), float(segment.time_s[-1]) - end
    if before_s < test.before_s or after_s < test.after_s:
        # The table requires a length of steady record on both sides of the input.
        needs = " and ".join(
            f"{x:g} s {w}" for x, w in ((test.before_s, "before"), (test.after_s, "after")) if x
        )
        input_name = f"the {test.control} input" if test.control else "the last input"
        return (
            f"{needs} {input_name} are needed; the records have {max(before_s, 0.0):.1f} s before"
            f" and {max(after_s, 0.0):.1f} s after"
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
    # Tests without a control compare the free response only.
    evaluated = segment if test.control else _after(segment, end)
    rows = [_band_row(band, evaluated, suffix, noise.get(band.channel)) for band in test.bands]
    if all(row is None for row in rows):
        return "the records have no samples of its channels"
    return SegmentResult(
        test, segment, tuple(r for r in rows if r is not None), *_combine_answers(test, rows)
    )


def _after(segment: History, start_s: float) -> History:
    """Return the part of a segment from a time on."""
    selected = segment.time_s >= start_s
    return replace(
        segment,
        time_s=segment.time_s[selected],
        columns={c: v[selected] for c, v in segment.columns.items()},
    )


def _band_row(band: Band, segment: History, suffix: str, noise: float | None) -> Row | None:
    """Compare one channel with its tolerance; None without a finite sample."""
    measured, model = segment.columns[band.channel], segment.columns[f"{band.channel}{suffix}"]
    finite = np.isfinite(measured) & np.isfinite(model)
    if not finite.any():
        return None
    difference, half_width = (measured - model)[finite], limits(band, measured)[finite]
    worst = int(np.argmax(np.abs(difference) / half_width))
    inside = float(np.mean(np.abs(difference) <= half_width))
    answer, reason = (PASS, "") if inside == 1.0 else (FAIL, "")
    if (
        # A tolerance near the sensor noise is exceeded by noise alone.
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
    """Return the answer and reason of a test: one alternative must pass, and all other bands."""
    groups: dict[str, list[Row | None]] = {}
    for k, (band, row) in enumerate(zip(test.bands, rows, strict=True)):
        groups.setdefault(band.one_of or str(k), []).append(row)
    answers = [_best_alternative(group) for group in groups.values()]
    for decisive in (FAIL, INCONCLUSIVE):
        first_reason = next((reason for answer, reason in answers if answer == decisive), None)
        if first_reason is not None:
            return decisive, first_reason
    return PASS, ""


def _best_alternative(group: Sequence[Row | None]) -> tuple[str, str]:
    """Return answer and reason of the best of several alternative rows."""
    available = [r for r in group if r is not None]
    if not available:
        return INCONCLUSIVE, "a channel has no samples"
    best = min(available, key=lambda r: (PASS, INCONCLUSIVE, FAIL).index(r.answer))
    return best.answer, best.reason


def _evaluate_oscillation(
    test: Test, tolerances: Oscillation, segment: History, suffix: str, from_s: float
) -> SegmentResult | str:
    """Compare the free oscillation of flight and model after the last input."""
    name = tolerances.channel
    if name not in segment.columns or f"{name}{suffix}" not in segment.columns:
        return f"the results have no {name} of log and model"
    # Free response: after the last input.
    free = segment.time_s > from_s
    t = segment.time_s[free]
    if t.size < 12:
        return "the records end with the last input"
    log, model = (
        fit_mode(t, segment.columns[c][free], tolerances.shortest_s, tolerances.longest_s)
        for c in (name, f"{name}{suffix}")
    )
    # A fit of noise or of drift is no oscillation.
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
    # Time to half amplitude and damping ratio are alternatives.
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
    """Return the rows of period, time to half amplitude and damping ratio."""
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
        # A standard error above half the tolerance allows neither pass nor fail.
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
    """Return the range of the finite values; 0 without any."""
    finite = np.empty(0) if values is None else values[np.isfinite(values)]
    return float(np.ptp(finite)) if finite.size else 0.0


def _input_interval(segment: History, moved: Sequence[str]) -> tuple[float, float]:
    """Return when the moved controls leave their first position and reach their last one [s].

    Both are the start of the segment if no control moved.
    """
    t = segment.time_s
    first, last = float(t[-1]), float(t[0])
    for control in moved:
        values = segment.columns[control]
        # Constant controls have no input.
        changes = np.abs(np.diff(values)) > 0.0
        left_start = np.abs(values - values[0]) > _AT_REST_SHARE * _travel(values)
        off_end = np.abs(values - values[-1]) > _AT_REST_SHARE * _travel(values)
        if changes.any() and left_start.any():
            first = min(first, float(t[int(np.argmax(left_start))]))
            last = max(last, float(t[min(len(t) - 1, len(t) - int(np.argmax(off_end[::-1])))]))
    return (first, last) if moved and last > first else (float(t[0]), float(t[0]))
