"""Detect what was done to the samples of a channel: held, interpolated, quantised, stuck, wrapped.

`check_estimates` detects channels that pass for measurements but were computed from other
channels. All functions are pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from sysid.errors import Finding
from sysid.logs.checking.kinematics import (
    ACCELERATIONS,
    AIR,
    ATTITUDE,
    GROUND,
    RATES,
    body_rates_of_attitude,
    speed_change,
    to_body,
)
from sysid.logs.manoeuvres import moving_mean
from sysid.record import FlightRecord

_MIN_SAMPLES = 60
_MIN_CHANGES = 20
# Equal samples in a row; fewer are a held value, more a standstill.
_STANDSTILL_SAMPLES = 50
_COMMON = 0.9  # share of changes on one beat
# Median over smallest size of the corners of lines, below which all corners have one size.
_SAME_SIZE = 1.5
_STUCK_S = 2.0  # shortest standstill that is reported
_ROUNDING = 8.0 * float(np.finfo(np.float64).eps)
# Sixth differences over white noise; in variance 1 + 36 + 225 + 400 + 225 + 36 + 1.
_SIXTH_DIFFERENCE_GAIN = 924.0**0.5
# Quantum over the usual step, above which coarse steps hide a quiet motion.
_COARSE_SHARE = 1e-4
# Second longest standstill over the longest; a channel with more of them often stands still.
_MAX_OTHER_STANDSTILL = 0.25
# Noise over the usual step between samples; motion alone has far less.
_MIN_NOISE = 0.2
_BITS = (8, 16)
_ON_LATTICE = 1e-3  # tolerance of a multiple, in steps
_WRAPS = tuple(
    (span * unit, f"{bits}-bit" + ("" if unit == 1.0 else f", 1/{1 / unit:.0f}"))
    for bits, span in ((16, 65536.0), (8, 256.0))
    for unit in (1.0, 0.1, 0.01, 0.001)
)


@dataclass(frozen=True)
class SampleHold:
    """How a channel repeats its values.

    Attributes
    ----------
    run : float
        Mean number of samples from one change to the next.
    quantum : float
        Size of the smallest step.
    is_held : bool
        True if values were held, False if the channel is merely coarse.
    """

    run: float
    quantum: float
    is_held: bool


def sample_hold(values: FloatArray) -> SampleHold | None:
    """Detect repeated values.

    A coarse channel keeps its value while it moves by less than a step, and then changes by one
    step. A held channel changes by all that has accumulated, or all its changes fall on one beat.

    Parameters
    ----------
    values : ndarray of shape (n,)
        Samples; NaN is ignored.

    Returns
    -------
    SampleHold or None
        None if the channel changes with most samples, or hardly moves.
    """
    finite = values[np.isfinite(values)]
    if len(finite) < _MIN_SAMPLES:
        return None
    with np.errstate(invalid="ignore", over="ignore"):
        steps = np.abs(np.diff(finite))
    changes = np.flatnonzero(steps > 0.0)
    runs = np.diff(changes)
    moving = runs[runs <= _STANDSTILL_SAMPLES]
    if len(moving) < _MIN_CHANGES or float(moving.mean()) < 1.8:
        return None
    sizes = steps[changes]
    # A quantile, since rounding makes single steps smaller.
    quantum = float(np.quantile(sizes, 0.01))
    # A coarse channel returns to its levels; a held one meets new values.
    levels = len(np.unique(np.round(finite / max(0.1 * quantum, np.finfo(np.float64).tiny))))
    gathered = float(np.mean(sizes > 1.5 * quantum)) > 0.3 and levels > 0.5 * len(changes)
    # All changes on one beat: a value that is refreshed every few samples.
    beat = int(np.median(moving))
    on_beat = beat >= 2 and max(np.bincount(changes % beat)) > _COMMON * len(changes)
    return SampleHold(float(moving.mean()), quantum, gathered or bool(on_beat))


def interpolation_interval(values: FloatArray) -> float | None:
    """Return the mean number of samples between measured values if those between are interpolated
    linearly.

    None if they are not.
    """
    finite = values[np.isfinite(values)]
    if len(finite) < _MIN_SAMPLES:
        return None
    slope = np.abs(np.diff(finite))
    bend = np.abs(np.diff(finite, 2))
    usual = float(np.median(slope))
    tolerance = max(
        8.0 * float(np.finfo(np.float32).eps) * float(np.abs(finite).max()), 1e-4 * usual
    )
    # Second differences vanish inside straight lines and not at measured values.
    kinks = bend > tolerance
    starts = np.flatnonzero(kinks & ~np.concatenate([[False], kinks[:-1]]))
    if (
        usual <= 4.0 * tolerance
        or len(starts) < _MIN_CHANGES
        or float(np.median(bend[kinks])) < 20.0 * tolerance
    ):
        return None
    if float(np.median(bend[kinks])) < _SAME_SIZE * float(np.quantile(bend[kinks], 0.05)):
        return None  # corners of one size are those of a slow motion in coarse steps
    spacing = np.diff(starts)
    middle = float(np.median(spacing))
    regular = float(np.mean(np.abs(spacing - middle) <= 1.0)) > 0.8
    return (
        float(spacing.mean())
        if middle >= 2.0 and regular and float(kinks.mean()) < 2.2 / middle
        else None
    )


def stuck_span(values: FloatArray, step_s: float, noisy: bool = True) -> tuple[int, int] | None:
    """Return first and last sample of the longest standstill of a channel that otherwise always
    moves.

    Parameters
    ----------
    values : ndarray of shape (n,)
        Samples.
    step_s : float
        Their step, s.
    noisy : bool
        Require noise around the standstill, for channels that may be constant in flight.

    Returns
    -------
    tuple of int or None
        None without such a standstill of at least 2 s.
    """
    if len(values) < _MIN_SAMPLES:
        return None
    steps = np.abs(np.diff(values))
    moving = steps[steps > 0.0]
    if not len(moving):
        return None
    # Samples count as equal within the rounding error of a unit conversion or an interpolation.
    tolerance = _ROUNDING * float(np.nanmax(np.abs(values)))
    moving = moving[moving > tolerance]
    quantum = _step_of_lattice(moving)
    if quantum > _COARSE_SHARE * _median(moving) and _noise(values) < quantum:
        # In coarse steps a quiet motion stands still, unless noise moves it.
        return None
    same = np.concatenate([[False], steps <= tolerance, [False]])
    edges = np.flatnonzero(np.diff(same.astype(np.int8)))
    if not len(edges):
        return None
    begins, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(ends - begins))
    first, last = int(begins[longest]), int(ends[longest])
    # The samples around must move; of an instrument with noise, by noise.
    around = max(20, round(1.0 / step_s))
    before, after = values[max(0, first - around) : first + 1], values[last : last + around + 1]
    sides = [side for side in (before, after) if len(side) > 10]
    is_noisy_around = bool(sides) and all(
        np.mean(np.abs(np.diff(side)) > tolerance) > _COMMON for side in sides
    )
    if noisy:
        is_noisy_around = is_noisy_around and all(_has_white_noise(side) for side in sides)
    if len(sides) == 1:
        # Constant to one end of the log. A simulation without noise is so too in steady flight.
        is_noisy_around = is_noisy_around and _noise(sides[0]) > _MIN_NOISE * _median(
            np.abs(np.diff(sides[0]))
        )
    other_lengths = np.delete(ends - begins, longest)
    is_single = not len(other_lengths) or int(other_lengths.max()) < _MAX_OTHER_STANDSTILL * (
        last - first
    )
    return (
        (first, last)
        if is_noisy_around and is_single and (last - first) * step_s > _STUCK_S
        else None
    )


def _noise(values: FloatArray) -> float:
    """Return the standard deviation of noise from sixth differences, to which motion hardly
    contributes.
    """
    return _median(np.abs(np.diff(values[np.isfinite(values)], 6))) / (
        0.6745 * _SIXTH_DIFFERENCE_GAIN
    )


def _median(values: FloatArray) -> float:
    """Return the median; 0 for no values."""
    return float(np.median(values)) if len(values) else 0.0


def _step_of_lattice(steps: FloatArray) -> float:
    """Return the step of which all steps are multiples; 0 if there is none."""
    if not len(steps):
        return 0.0
    smallest = float(steps.min())
    # The smallest step may be several units. The median over small steps removes their rounding
    # errors.
    for units in range(1, 11):
        unit = smallest / units
        small = steps[steps < 20.0 * smallest]
        unit = float(np.median(small / np.round(small / unit)))
        counts = steps / unit
        if float(np.quantile(np.abs(counts - np.round(counts)), 0.9)) < 0.05:
            return unit
    return 0.0


def _has_white_noise(values: FloatArray) -> bool:
    """Return whether noise rather than motion causes the steps between samples.

    Each step of white noise undoes half of the one before: correlation -0.5.
    """
    steps = np.diff(values)
    steps = steps[np.isfinite(steps)]
    steps = steps - steps.mean() if len(steps) else steps
    return len(steps) > 10 and float(steps[1:] @ steps[:-1]) < -0.15 * float(steps @ steps)


def _integer_ranges(steps: FloatArray) -> list[tuple[float, str]]:
    """Return ranges of 8 and 16 bits in the unit of the smallest step, if all steps are multiples
    of it.
    """
    if not len(steps):
        return []
    unit = float(steps.min())
    counts = steps / unit
    if counts.max() > 2.0**16 or float(np.abs(counts - np.round(counts)).max()) > _ON_LATTICE * max(
        1.0, counts.max() / 2**8
    ):
        return []
    return [(2.0**bits * unit, f"{bits}-bit, {unit:.3g}") for bits in _BITS]


def detect_wraps(raw: FloatArray) -> tuple[int, float, str] | None:
    """Detect jumps by a whole integer range.

    A number that wraps leaves its range at one end and returns at the other; with the range added
    it moves as usual.

    Parameters
    ----------
    raw : ndarray of shape (n,)
        Logged numbers.

    Returns
    -------
    tuple or None
        Number of jumps, range and description of the integer type; None without jumps.
    """
    values = raw[np.isfinite(raw)]
    if len(values) < 20:
        return None
    steps = np.diff(values)
    moving = np.abs(steps[steps != 0.0])
    low, high = float(values.min()), float(values.max())
    for span, description in (*_WRAPS, *_integer_ranges(moving)):
        jumps = np.flatnonzero(np.abs(np.abs(steps) - span) < 0.25 * span)
        if not len(jumps) or high - low > 1.02 * span or len(jumps) > 0.2 * len(steps):
            continue
        usual = (
            float(np.quantile(np.delete(np.abs(steps), jumps), 0.99))
            if len(moving) > len(jumps)
            else 0.0
        )
        margin = max(2.0 * usual, 0.01 * span)
        # Before and after a wrap the number is near opposite ends of its range.
        ends = np.minimum(values[jumps], values[jumps + 1]) - low < margin
        ends &= high - np.maximum(values[jumps], values[jumps + 1]) < margin
        returns = np.abs(np.abs(steps[jumps]) - span) <= margin
        if usual < 0.2 * span and float(np.mean(ends & returns)) > _COMMON:
            return len(jumps), span, description
    return None


# Estimates that pass for measurements. Noise of a sensor is independent of all other channels.
# Rates that equal the derivative of the attitude have none. An airspeed whose change from
# sample to sample equals the accelerometers' value, without the steps back of white noise, has
# none. Angles of flow that share the noise of the attitude were computed from attitude and
# ground velocity.

# Difference of a computed rate from the derivative of the attitude, in its standard deviations.
_SAME_RATE = 0.005
# High-frequency residual of an angle of flow against attitude and ground velocity, over its own.
_MAX_RESIDUAL_SHARE = 0.5
_SMOOTHED_S = 0.5  # time constant of an estimator for the receiver's velocity
# Correlation of neighbouring steps: -0.5 for white noise, 0 or more without noise.
_STEPS_BACK = -0.25
# Correlation of neighbouring third differences: -0.75 for white noise.
_NOISE = -0.55
# Third differences over white noise; in variance 1 + 9 + 9 + 1.
_THIRD_DIFFERENCE_GAIN = 20.0**0.5
_MAX_EXPLAINED = 10.0
"""Steps of an airspeed over the steps that accelerometer noise causes: 1 to 3 for estimates, 37 or
more for ArduPlane's sensor.
"""
_MIN_NOISE_MPS2 = 1e-4
"""Below the noise of any accelerometer (0.01 mg), and ten times the error of a simulation's
integrators.
"""
# Samples of a channel until one falls on a row of the grid, and the tolerance, in rows.
_MAX_BEAT, _ON_ROW = 4, 0.01
_MIN_ESTIMATE_SAMPLES = 100
_SPOILS = "standard errors; in gusts an estimate misses the gust, and derivatives from it are wrong"


def check_estimates(flight: FlightRecord) -> list[Finding]:
    """Return findings on rates, airspeed and angles of flow that no sensor measured.

    Nothing is reported if no accelerometer shows noise (a simulation).
    """
    # Without noise in the accelerations (simulated logs) nothing can be told.
    declared = set(flight.metadata.estimates)
    if len(flight) < _MIN_ESTIMATE_SAMPLES or not any(
        _estimates_noisy(flight, n) for n in ACCELERATIONS
    ):
        return []
    estimated = []
    # A gyro has noise that the derivative of the attitude lacks.
    for name in _computed_rates(flight):
        estimated.append(
            (name, "equals the derivative of the logged attitude: no gyro's noise is in it")
        )
    # An airspeed sensor has noise that integrated accelerations lack.
    if "V_mps" not in declared and _smooth_speed(flight):
        estimated.append(
            (
                "V_mps",
                (
                    "changes as the accelerometers say from sample to sample: no airspeed sensor's"
                    " noise is in it"
                ),
            )
        )
    # Angles computed from attitude and ground velocity assume still air.
    for name in _computed_angles(flight):
        if name not in declared:
            estimated.append(
                (
                    name,
                    (
                        "has the attitude's noise and none of its own: it was computed from"
                        " attitude and ground velocity"
                    ),
                )
            )
    return [
        Finding(
            "estimate",
            name,
            "warning",
            f"{name} {reason}; it is an estimate (estimate = true in a map)",
            {},
            _SPOILS,
        )
        for name, reason in estimated
    ]


def _estimates_noisy(flight: FlightRecord, name: str) -> bool:
    """Return whether an accelerometer shows white noise."""
    return (
        name in flight
        and _high_frequency_size(flight[name][:: _stride(flight, name)])
        > _THIRD_DIFFERENCE_GAIN * _MIN_NOISE_MPS2
        and _steps_back(np.diff(flight[name][:: _stride(flight, name)], 2)) < _NOISE
    )


def _stride(flight: FlightRecord, name: str) -> int:
    """Return the number of rows from one logged sample of a channel to the next."""
    native = flight.metadata.native_hz.get(name, 1.0 / flight.dt_s)
    return max(1, int(np.ceil(1.0 / (flight.dt_s * native) - 1e-3)))


def _sample_stride(flight: FlightRecord, name: str) -> int:
    """Return the rows after which the samples of a channel fall on rows again."""
    ratio = 1.0 / (flight.dt_s * flight.metadata.native_hz.get(name, 1.0 / flight.dt_s))
    for samples in range(1, _MAX_BEAT + 1):
        if abs(samples * ratio - round(samples * ratio)) < _ON_ROW * samples * ratio:
            return max(1, round(samples * ratio))
    return _stride(flight, name)


def _steps_back(values: FloatArray) -> float:
    """Return the correlation of neighbouring steps: -0.5 for white noise, 0 or more for motion."""
    steps = np.diff(values)
    pairs = np.isfinite(steps[1:]) & np.isfinite(steps[:-1])
    a, b = steps[1:][pairs], steps[:-1][pairs]
    if a.size < _MIN_ESTIMATE_SAMPLES:
        return float("nan")
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0.0 else float("nan")


def _has(flight: FlightRecord, names: Sequence[str]) -> bool:
    """Return whether all channels have enough finite samples."""
    return all(n in flight and np.isfinite(flight[n]).sum() > _MIN_ESTIMATE_SAMPLES for n in names)


def _computed_rates(flight: FlightRecord) -> list[str]:
    """Return the rates that equal the derivative of the logged attitude."""
    if not _has(flight, ATTITUDE):
        return []
    phi, theta, psi = (flight[n] for n in ATTITUDE)
    derivative = body_rates_of_attitude(phi, theta, psi, flight.dt_s)
    out = []
    for name, attitude_rate in zip(RATES, derivative, strict=True):
        usable = (
            np.isfinite(attitude_rate) & np.isfinite(flight[name])
            if name in flight
            else np.zeros(0, dtype=bool)
        )
        if usable.sum() > _MIN_ESTIMATE_SAMPLES:
            size = float(np.std(flight[name][usable]))
            # The median, because ends of gaps and turns of the heading differ.
            if (
                size > 0.0
                and float(np.median(np.abs(flight[name][usable] - attitude_rate[usable])))
                < _SAME_RATE * size
            ):
                out.append(name)
    return out


def _smooth_speed(flight: FlightRecord) -> bool:
    """Return whether the airspeed has no noise apart from that of the accelerometers."""
    names = (*AIR, *ATTITUDE[:2], *ACCELERATIONS)
    if not _has(flight, names):
        return False
    change, _ = speed_change({n: flight[n] for n in names}, flight.dt_s)
    integrated = np.concatenate([[0.0], np.cumsum(0.5 * (change[1:] + change[:-1]) * flight.dt_s)])
    rows = _stride(flight, "V_mps")
    residual = (flight["V_mps"] - integrated)[::rows]
    if not _steps_back(residual) > _STEPS_BACK:
        return False
    # Filtered sensor noise shows no steps back either, but it exceeds what the accelerometers
    # explain.
    means = change[: change.size // rows * rows].reshape(-1, rows).mean(axis=1)
    explained = _high_frequency_size(means) / _THIRD_DIFFERENCE_GAIN * rows * flight.dt_s
    return _median_size(np.diff(residual)) < _MAX_EXPLAINED * explained


def _computed_angles(flight: FlightRecord) -> list[str]:
    """Return the angles of flow whose noise is that of attitude and ground velocity."""
    if not _has(flight, (*AIR, *ATTITUDE, *GROUND)):
        return []
    computed: dict[str, list[FloatArray]] = {"alpha_rad": [], "beta_rad": []}
    # An estimator smooths the receiver's velocity, whose noise would otherwise hide the
    # relation.
    for window in (1, max(1, round(_SMOOTHED_S / flight.dt_s))):
        ground = np.stack([moving_mean(flight[n], window) for n in GROUND])
        u, v, w = to_body({n: flight[n] for n in ATTITUDE}, ground)
        computed["alpha_rad"].append(np.arctan2(w, u))
        computed["beta_rad"].append(np.arcsin(v / np.maximum(np.sqrt(u**2 + v**2 + w**2), 1.0)))
    out = []
    for name, versions in computed.items():
        rows = _sample_stride(flight, name)
        # Use the rows of measured samples: between them an interpolated channel has less noise.
        first = max(
            range(rows), key=lambda k: np.nan_to_num(_high_frequency_size(flight[name][k::rows]))
        )
        channel_noise, *residual_noise = (
            _high_frequency_size(x[first::rows])
            for x in (flight[name], *(flight[name] - way for way in versions))
        )
        if min(residual_noise) < _MAX_RESIDUAL_SHARE * channel_noise:
            out.append(name)
    return out


def _high_frequency_size(values: FloatArray) -> float:
    """Return the size of third differences, to which motion hardly contributes."""
    return _median_size(np.diff(values, 3))


def _median_size(steps: FloatArray) -> float:
    """Return the median absolute value; NaN for few values."""
    steps = steps[np.isfinite(steps)]
    return float(np.median(np.abs(steps))) if steps.size > _MIN_ESTIMATE_SAMPLES else float("nan")
