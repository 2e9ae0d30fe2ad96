"""Put messages with a clock of their own on the time of the log.

A second logger starts at another time than the autopilot. Its offset is either known, or found
where one of its fields correlates best with a field of the log that moves alike (a throttle
command and the current of the motor).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from sysid.arrays import FloatArray
from sysid.errors import Finding, LogError
from sysid.foreign.raw import MessageTable, RawLog
from sysid.logs.signal_map import Clock
from sysid.logs.time_base import clean

_MIN_STEP_S = 0.02
_MIN_OVERLAP = 0.4  # of the shorter signal
_MIN_CORRELATION = 0.7
_RIVAL_MARGIN = 0.1
"""Correlation by which the best offset must exceed every offset outside its own peak."""


def align_clocks(
    raw: RawLog,
    clocks: Sequence[Clock],
    is_selected: Callable[[FloatArray], NDArray[np.bool_]] | None = None,
) -> tuple[RawLog, list[Finding]]:
    """Return the log with the times of its second clocks shifted, and a finding for each.

    Parameters
    ----------
    raw : RawLog
        Content of the log.
    clocks : sequence of Clock
        From the map.
    is_selected : callable, optional
        Times of the log, s, to True where the map selects rows. Only these rows of the log's field
        are compared: a command that nothing follows (manual flight) would spoil the correlation.

    Raises
    ------
    LogError
        If the fields of ``align`` are absent or no offset is clearly the best.
    """
    messages: dict[tuple[str, int], MessageTable] = dict(raw.messages)
    findings = []
    for clock in clocks:
        keys = [key for key in messages if key[0] == clock.message]
        if not keys:
            continue
        if clock.align is None:
            assert clock.offset_s is not None
            offset = clock.offset_s
            text = f"times of {clock.message}: {offset:+.3f} s by the map"
            numbers = {"offset_s": offset}
        else:
            field, other, other_field = clock.align
            moving = _series(messages, clock.message, field)
            time, values = _series(messages, other, other_field)
            chosen = np.ones(len(time), dtype=bool) if is_selected is None else is_selected(time)
            # Where no row is selected, `select_rows` reports it.
            fixed = (time[chosen], values[chosen]) if chosen.sum() > 1 else (time, values)
            offset, correlation, rival = best_offset(moving, fixed, clock.search_s)
            pair = f"{clock.message}.{field} and {other}.{other_field}"
            numbers = {"offset_s": offset, "correlation": correlation, "rival": rival}
            if not (abs(correlation) >= _MIN_CORRELATION and correlation > rival + _RIVAL_MARGIN):
                raise LogError(
                    f"[clocks.{clock.message}]: the offset cannot be found: {pair} correlate by"
                    f" {correlation:.2f} at best ({offset:+.2f} s) and by {rival:.2f} elsewhere;"
                    " narrow search_s, name other fields, or give offset_s"
                )
            text = (
                f"times of {clock.message}: {offset:+.2f} s, where {pair} correlate by"
                f" {correlation:.2f} (by {rival:.2f} at most elsewhere)"
            )
        for key in keys:
            messages[key] = replace(messages[key], time_s=messages[key].time_s + offset)
        findings.append(Finding("assumed-clock", "", "info", text, numbers))
    return replace(raw, messages=messages), findings


def _series(
    messages: Mapping[tuple[str, int], MessageTable], message: str, field: str
) -> tuple[FloatArray, FloatArray]:
    """Return times and finite values of a field."""
    table = messages.get((message, 0))
    if table is None or field not in table.fields or table.fields[field].dtype == object:
        available = sorted(f"{m}.{f}" for (m, _), t in messages.items() for f in t.fields)[:20]
        raise LogError(
            f"[clocks]: align names {message}.{field}, which this log does not have; it has"
            f" {', '.join(available)}"
        )
    keep = clean(table.time_s).keep & np.isfinite(table.fields[field].astype(np.float64))
    return table.time_s[keep], table.fields[field][keep].astype(np.float64)


def best_offset(
    moving: tuple[FloatArray, FloatArray],
    fixed: tuple[FloatArray, FloatArray],
    search_s: tuple[float, float] = (-np.inf, np.inf),
) -> tuple[float, float, float]:
    """Return the offset of a clock that maximises the correlation of two signals.

    Parameters
    ----------
    moving, fixed : tuple of ndarray
        Times, s, and values of the signal on the second clock and of that on the log's clock.
    search_s : tuple of float
        Least and largest offset, s.

    Returns
    -------
    offset_s : float
        Seconds to add to the times of ``moving``.
    correlation : float
        Pearson's correlation there, over the time that both cover.
    rival : float
        Largest correlation outside the peak.

    Examples
    --------
    >>> t = np.arange(0.0, 60.0, 0.1)
    >>> x = np.sin(0.3 * t) + np.sin(0.11 * t**1.2)
    >>> round(best_offset((t[100:400] - 30.0, x[100:400]), (t, x))[0], 2)
    30.0
    """
    steps = [float(np.median(np.diff(t))) if len(t) > 1 else np.nan for t, _ in (moving, fixed)]
    if not np.all(np.isfinite(steps)):
        return 0.0, 0.0, 0.0
    # Grid of the faster signal; the slower one holds straight lines between its samples.
    step = max(min(steps), _MIN_STEP_S)
    a, b = (np.interp(np.arange(t[0], t[-1], step), t, x) for t, x in (moving, fixed))
    correlation = _sliding_correlation(a, b)
    lags = np.arange(-len(a) + 1, len(b))
    offsets = fixed[0][0] - moving[0][0] + step * lags
    allowed = np.isfinite(correlation) & (offsets >= search_s[0]) & (offsets <= search_s[1])
    if not allowed.any():
        return 0.0, 0.0, 0.0
    correlation = np.where(allowed, correlation, -np.inf)
    best = int(np.argmax(correlation))
    top = float(correlation[best])
    # The peak ends where the correlation has fallen to half and rises again.
    lower = right = best
    while (
        lower > 0
        and correlation[lower - 1] > -np.inf
        and (correlation[lower] > 0.5 * top or correlation[lower - 1] < correlation[lower])
    ):
        lower -= 1
    while (
        right < len(correlation) - 1
        and correlation[right + 1] > -np.inf
        and (correlation[right] > 0.5 * top or correlation[right + 1] < correlation[right])
    ):
        right += 1
    outside = np.concatenate([correlation[:lower], correlation[right + 1 :]])
    rival = float(outside.max()) if np.isfinite(outside).any() else 0.0
    # Vertex of the parabola through the three best points.
    shift = 0.0
    if 0 < best < len(correlation) - 1 and np.isfinite(correlation[[best - 1, best + 1]]).all():
        before, after = correlation[best - 1], correlation[best + 1]
        bend = before - 2.0 * top + after
        shift = float(0.5 * (before - after) / bend) if bend < 0.0 else 0.0
    return float(offsets[best] + shift * step), top, rival


def _sliding_correlation(a: FloatArray, b: FloatArray) -> NDArray[np.float64]:
    """Return the correlation of two series at every lag of ``a``, NaN where they overlap little.

    Means and variances are those of the overlapping parts.
    """
    ones_a, ones_b = np.ones_like(a), np.ones_like(b)
    a, b = a - a.mean(), b - b.mean()

    def summed(x: FloatArray, y: FloatArray) -> FloatArray:
        """Return sum x(k) y(k + lag)."""
        return np.asarray(fftconvolve(y, x[::-1]))

    count = np.maximum(summed(ones_a, ones_b), 1.0)
    sum_a, sum_b = summed(a, ones_b), summed(ones_a, b)
    var_a = summed(a**2, ones_b) - sum_a**2 / count
    var_b = summed(ones_a, b**2) - sum_b**2 / count
    product = summed(a, b) - sum_a * sum_b / count
    # Rounding of the transforms leaves variances near zero where a signal is constant.
    floor_a, floor_b = 1e-6 * float(np.sum(a**2)), 1e-6 * float(np.sum(b**2))
    usable = (count >= _MIN_OVERLAP * min(len(a), len(b))) & (var_a > floor_a) & (var_b > floor_b)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(usable, product / np.sqrt(var_a * var_b), np.nan)
