"""Assemble a flight record from a raw log, a signal map and an airframe card.

The grid is uniform at the rate of the fastest rate or acceleration channel; tables keep their own
times. Commands are held onto the grid, all other signals are interpolated, and nothing is bridged
across a gap. `bridge` fills short dropouts of a finished record. No files are read here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.errors import Finding, LogError
from sysid.foreign.raw import MessageTable, RawLog
from sysid.logs.card import AirframeCard
from sysid.logs.channels import (
    CIRCLE_FROM,
    Channel,
    Times,
    mode_rows,
    resolve,
    select_rows,
    selected,
    with_derived,
    wrap_angles,
)
from sysid.logs.checking.checks import (
    check_channel,
    check_record,
    estimated_channels,
    one_per_cause,
    recheck,
)
from sysid.logs.manoeuvres import FlightPhase, find_free_flight, find_loiters, loiter_commands
from sysid.logs.sensors import Sensors
from sysid.logs.servo import Control, controls, deflection, elevator_channel
from sysid.logs.signal_map import Clock, Entry, ServoOutputs, SignalMap
from sysid.logs.tables import columns_message
from sysid.logs.time_base import JUMP_S, clean, hold, interpolate, time_unit_finding
from sysid.record import FlightRecord, Metadata
from sysid.vocabulary import COMMANDS, LABELS, MANOEUVRE_TEXT, PLANE_MODES, SIGNALS

# Put messages with a clock of their own on the time of the log.
#
# A second logger starts at another time than the autopilot. Its offset is either known, or
# found where one of its fields correlates best with a field of the log that moves alike (a
# throttle command and the current of the motor).

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
    # Its import takes half a second, and most flights need no alignment.
    from scipy.signal import fftconvolve

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


_GRID_CHANNELS = ("p_radps", "q_radps", "r_radps", "ax_mps2", "ay_mps2", "az_mps2")
_MAX_ROWS = 40_000_000
_MIN_ROW_LIMIT, _ROWS_PER_SAMPLE = 1_000_000, 20


def assemble(
    raw: RawLog,
    signal_map: SignalMap,
    card: AirframeCard | None,
    source: str = "",
    sha256: str = "",
    run_checks: bool = True,
) -> FlightRecord:
    """Build the record of a whole log, with the findings of all checks in its metadata.

    Parameters
    ----------
    raw : RawLog
        Content of the log.
    signal_map : SignalMap
        Sources of the signals.
    card : AirframeCard or None
        Servo tables; without a card no surface deflection can be computed from servo outputs.
    source, sha256 : str
        File name and digest, for the metadata.
    run_checks : bool
        False leaves out the checks of the finished record; `with_checks` adds them.

    Raises
    ------
    LogError
        If the log has none of the channels that a record is made of.
    """
    # A copy whose messages are dropped one by one as the record grows.
    raw = replace(raw, messages=dict(raw.messages))
    mode = mode_rows(raw, signal_map.rows)
    # Clocks are aligned over both parts of a flight, which then agree.
    selection = partial(selected, rows=replace(signal_map.rows, part=""), mode=mode)
    raw, assumed = align_clocks(raw, signal_map.clocks, selection)
    sensors = Sensors(raw, signal_map.sensors)
    start = _start(raw, sensors)
    loiters = loiter_commands(raw, start)
    times = Times(raw)
    servos, servo_controls, findings = _servo_channels(raw, signal_map.servos, card, times)
    # Each signal has a function that makes its channel: a log field, else a servo output.
    sources: dict[str, Callable[[], Channel | None]] = {
        name: partial(resolve, raw, name, candidates, times, sensors)
        for name, candidates in signal_map.entries.items()
    }
    for name, make in servos.items():
        sources[name] = partial(_first_of, sources.get(name), make)
    grid = _grid(raw, sources, signal_map)
    step = float(np.median(np.diff(grid)))
    columns: dict[str, NDArray[Any]] = {"time_s": grid}
    origin: dict[str, tuple[str, float, bool]] = {}
    checked: set[str] = set()
    mode_changes = np.array([])
    last_use = _last_use(signal_map)
    for name in SIGNALS:
        # Make one channel at a time and drop messages that no later one needs: a large log must
        # not be in memory as messages, channels and columns together.
        channel = sources[name]() if name in sources else None
        _drop(raw, last_use.get(name, ()))  # the channel holds its own copy
        if channel is None:
            continue
        findings += check_channel(channel, step, checked)
        columns[name] = _on_grid(channel, grid)
        origin[name] = (channel.label, channel.rate_hz, channel.estimate)
        if name == "mode":
            columns[name] = _mode_names(columns[name], raw)
            mode_changes = channel.time_s[1:][np.diff(channel.values) != 0]
    fields = {n: " or ".join(c.label for c in some) for n, some in signal_map.entries.items()}
    labels_of_derived, notes = with_derived(columns, signal_map.derived, fields)
    for name, label in labels_of_derived.items():
        _, rate, estimate = origin.get(name, ("", math.nan, False))
        origin[name] = (label, rate, estimate)
    assumed += notes
    findings += _servo_tables(servo_controls, {n: label for n, (label, _, _) in origin.items()})
    labels = _manoeuvres(raw, grid)
    if labels is not None:
        columns["manoeuvre"] = labels
    # Angles that count turns are put on one turn; they were not out of range.
    wrapped = wrap_angles(columns)
    columns.update(wrapped)
    findings = [f for f in findings if f.code != "out-of-range" or f.channel not in wrapped]
    for column in columns.values():
        column.setflags(write=False)  # the record then shares them instead of copying
    phase = _phase(raw, columns, signal_map.servos, times, mode_changes)
    meta = Metadata(
        source=source,
        sha256=sha256,
        dialect=raw.dialect,
        vehicle=raw.vehicle,
        aircraft="" if card is None else card.name,
        grid_hz=round(1.0 / step, 6),
        start=start,
        native_hz={n: round(rate, 4) for n, (_, rate, _) in origin.items() if np.isfinite(rate)},
        channels={n: label for n, (label, _, _) in origin.items()},
        estimates=tuple(n for n, (_, _, estimate) in origin.items() if estimate),
        free_flight_s=() if phase.free_s is None else (phase.free_s,),
        loiters=find_loiters(columns, loiters),
    )
    record = FlightRecord(columns, meta)
    findings += sensors.findings()
    # A sensor may stand still on the ground.
    findings = [f for f in findings if f.code != "stuck" or _in_flight(f, phase.free_s)]
    findings = [
        *raw.findings,
        Finding(
            "flight-phase",
            "",
            "info",
            phase.reason,
            {} if phase.tow_s is None else {"tow_end_s": phase.tow_s[1]},
        ),
        *assumed,
        *findings,
    ]
    record = FlightRecord(record.columns, replace(meta, findings=tuple(findings)))
    subset = select_rows(record, signal_map.rows, mode)
    if not run_checks:
        return subset
    return with_checks(record) if subset is record else with_current_checks(subset)


def with_current_checks(record: FlightRecord) -> FlightRecord:
    """Return the record with all checks of its own rows run again.

    It may have been imported by a version that lacked some of them, or with rows that are gone.
    """
    findings = recheck(record)
    estimates = estimated_channels(record.metadata.estimates, findings)
    meta = replace(record.metadata, findings=tuple(findings), estimates=estimates)
    return replace(record, metadata=meta)


def with_checks(record: FlightRecord) -> FlightRecord:
    """Add the findings of the record checks to a record of `assemble`."""
    meta = record.metadata
    fresh = check_record(record, next(iter(meta.free_flight_s), None))
    findings = one_per_cause([*meta.findings, *fresh])
    estimates = estimated_channels(meta.estimates, findings)
    return FlightRecord(
        record.columns, replace(meta, findings=tuple(findings), estimates=estimates)
    )


def _in_flight(finding: Finding, free_s: tuple[float, float] | None) -> bool:
    """Return whether the span of a finding overlaps free flight."""
    return (
        free_s is not None
        and finding.numbers["start_s"] < free_s[1]
        and finding.numbers["end_s"] > free_s[0]
    )


def _first_of(
    from_message: Callable[[], Channel | None] | None, from_servo: Callable[[], Channel | None]
) -> Channel | None:
    """Return the channel of a surface's own message, else that of its servo output."""
    channel = from_message() if from_message is not None else None
    return channel if channel is not None else from_servo()


def _last_use(signal_map: SignalMap) -> dict[str, list[str]]:
    """Return signal to messages that no later signal needs; servo outputs are never listed."""
    last: dict[str, str] = {}
    for name in SIGNALS:
        for entry in signal_map.entries.get(name, ()):
            last[entry.message] = name
            if entry.times is not None:
                last[entry.times[0]] = name
            for rule in signal_map.sensors:
                if rule.covers(entry):
                    last.update(dict.fromkeys((rule.message, *rule.also), name))
    if signal_map.servos is not None:
        last.pop(signal_map.servos.message, None)
    out: dict[str, list[str]] = {}
    for message, name in last.items():
        out.setdefault(name, []).append(message)
    return out


def _drop(raw: RawLog, messages: Iterable[str]) -> None:
    """Delete messages from the log, to free memory."""
    remaining = raw.messages
    assert isinstance(remaining, dict)
    for key in [k for k in remaining if k[0] in messages]:
        del remaining[key]


def _grid(
    raw: RawLog, sources: Mapping[str, Callable[[], Channel | None]], signal_map: SignalMap
) -> FloatArray:
    """Return the grid times: those of a table, or a uniform grid at the rate of the fastest
    channel.
    """
    best: Channel | None = None
    for names in (_GRID_CHANNELS, tuple(n for n in SIGNALS if n not in (*_GRID_CHANNELS, "mode"))):
        for name in names:
            channel = sources[name]() if name in sources else None
            if channel is not None and (best is None or channel.rate_hz > best.rate_hz):
                best = channel
        if best is not None:
            break
    if best is None:
        raise LogError(_no_signal(raw, signal_map))
    if ("csv", 0) in raw.messages:
        return best.time_s
    step = best.clean.step_s
    if not np.isfinite(step) or step <= 0:
        raise LogError("no channel has two samples; the log is too short to use")
    span = best.time_s[-1] - best.time_s[0]
    # Gaps become rows of NaN. A few stamps that are a microsecond apart and far from the others
    # would otherwise fill the memory.
    max_rows = min(_MAX_ROWS, _MIN_ROW_LIMIT + _ROWS_PER_SAMPLE * len(best.time_s))
    if span / step > max_rows:
        raise LogError(
            f"{span:.0f} s at {1 / step:.0f} Hz would be more than {max_rows} rows; cut the log"
            " into parts or correct its times"
        )
    # Stamps jitter by microseconds; a step of whole microseconds keeps the grid on the samples.
    step = round(step, 6) or step
    return np.round(best.time_s[0] + step * np.arange(int(np.floor(span / step + 0.25)) + 1), 9)


def _no_signal(raw: RawLog, signal_map: SignalMap) -> str:
    """Return why no signal of the map is in the log, and what to do."""
    for (message, _), table in raw.messages.items():
        mapped = {
            f
            for e in signal_map.entries.values()
            for c in e
            if c.message == message
            for f in c.fields
        }
        finite_s = table.time_s[np.isfinite(table.time_s)]
        steps = np.diff(finite_s)
        if mapped & set(table.fields) and np.median(steps if steps.size else [0.0]) > JUMP_S:
            column = str(raw.facts.get("time column", message))
            finding = time_unit_finding(column, float(np.median(steps)), converted=False)
            return f"{finding.message}; write in the map: {'; '.join(finding.mend.splitlines())}"
    if "columns" in raw.facts:
        return (
            f"no signal of the map '{signal_map.name}' is among the columns of this table:"
            f" {columns_message(str(raw.facts['columns']).split(chr(10)))}"
        )
    available = ", ".join(sorted({m for m, _ in raw.messages})[:20])
    return (
        f"no signal of the map '{signal_map.name}' is in this log; it has {available or 'nothing'};"
        " give a --map (`uqharness log map FILE --out map.toml` proposes one)"
    )


def _on_grid(c: Channel, grid: FloatArray) -> NDArray[Any]:
    """Put a channel on the grid by the method of its kind."""
    if c.name == "mode":
        at = np.searchsorted(c.time_s, grid, side="right") - 1
        return np.where(at >= 0, c.values[np.maximum(at, 0)], np.nan)
    if len(c.time_s) == len(grid) and np.array_equal(c.time_s, grid):
        return c.values
    if c.name in COMMANDS:
        return hold(c.time_s, c.values, c.clean.gaps, grid, c.clean.step_s)
    if c.name in CIRCLE_FROM:
        return _interpolate_angle(c.name, c, grid)
    return interpolate(c.time_s, c.values, c.clean.gaps, grid)


def _interpolate_angle(name: str, c: Channel, grid: FloatArray) -> FloatArray:
    """Interpolate an angle on the circle; NaN where the samples are NaN."""
    sine = interpolate(c.time_s, np.sin(c.values), c.clean.gaps, grid)
    is_finite = np.isfinite(c.values)
    # Unwrap, interpolate, and wrap again onto the turn of the vocabulary.
    unwrapped = c.values.copy()
    unwrapped[is_finite] = np.unwrap(c.values[is_finite])
    out = interpolate(c.time_s, unwrapped, c.clean.gaps, grid)
    out = np.mod(out, 2 * np.pi) if name == "psi_rad" else np.mod(out + np.pi, 2 * np.pi) - np.pi
    return np.where(np.isfinite(sine), out, np.nan)


def _servo_channels(
    raw: RawLog, outputs: ServoOutputs | None, card: AirframeCard | None, times: Times
) -> tuple[dict[str, Callable[[], Channel | None]], dict[str, Control], list[Finding]]:
    """Return the functions that make channels from servo outputs, their controls and findings."""
    if outputs is None or (outputs.message, outputs.instance) not in raw.messages:
        return {}, {}, []
    key = (outputs.message, outputs.instance)
    if int(times.of(key).keep.sum()) < 2:
        return {}, {}, []
    servo_controls, findings = controls(card, raw.parameters)
    if card is None:
        text = (
            "servo outputs are logged but no card says what angles they mean: give --aircraft, or"
            " tables in --map"
        )
        findings.append(Finding("no-card", outputs.message, "warning", text, {}))
    return (
        {
            n: partial(_servo_channel, raw, outputs, times, n, control)
            for n, control in servo_controls.items()
        },
        servo_controls,
        findings,
    )


def _servo_tables(
    servo_controls: Mapping[str, Control], labels: Mapping[str, str]
) -> list[Finding]:
    """Return findings on the servo tables that were used and on conflicts between card and log."""
    used = [c for n, c in servo_controls.items() if labels.get(n, "").endswith(c.label)]
    descriptions, conflicts = (
        "; ".join(filter(None, parts))
        for parts in ([c.description for c in used], [c.conflicts for c in used])
    )
    out = [Finding("servo-table", "", "info", descriptions, {})] if descriptions else []
    if conflicts:
        text = f"card and log do not agree, the log's parameters were used: {conflicts}"
        out.append(Finding("servo-conflict", "", "warning", text, {}))
    return out


def _servo_channel(
    raw: RawLog, outputs: ServoOutputs, times: Times, name: str, control: Control
) -> Channel | None:
    """Return one command from the servo outputs, by the weights and tables of its control."""
    key = (outputs.message, outputs.instance)
    table, cleaned = raw.messages[key], times.of(key)
    fields = [servo_field(outputs, raw, channel) for channel, _, _ in control.parts]
    parts = [table.fields[f][cleaned.keep].astype(np.float64) for f in fields if f is not None]
    if len(parts) < len(fields):
        return None
    values = sum(
        (
            w * deflection(pwm, servo)
            for pwm, (_, servo, w) in zip(parts, control.parts, strict=True)
        ),
        start=np.zeros(int(cleaned.keep.sum())),
    )
    if not np.isfinite(values).any():
        return None
    return Channel(
        name,
        f"{outputs.message} {control.label}",
        table.time_s[cleaned.keep],
        values,
        cleaned,
        False,
    )


def servo_field(outputs: ServoOutputs, raw: RawLog, channel: int) -> str | None:
    """Return the field of a servo output in this log; None if it is absent.

    ``channel`` counts from 1; PX4 counts from 0.
    """
    names = outputs.fields_of(channel - 1 if raw.dialect == "ulog" else channel)
    return next(
        (
            name
            for name in names
            if name in raw.messages[(outputs.message, outputs.instance)].fields
        ),
        None,
    )


def _phase(
    raw: RawLog,
    columns: Mapping[str, NDArray[Any]],
    outputs: ServoOutputs | None,
    times: Times,
    mode_changes_s: FloatArray,
) -> FlightPhase:
    """Find free flight from speed, height, pitch rate and elevator, whichever the log has."""
    grid = columns["time_s"]
    speed = columns.get("V_mps")
    if speed is None and "vn_mps" in columns and "ve_mps" in columns:
        speed = np.hypot(columns["vn_mps"], columns["ve_mps"])
    elevator = columns.get("elevator_deg")
    if (
        elevator is None
        and outputs is not None
        and (outputs.message, outputs.instance) in raw.messages
    ):
        key = (outputs.message, outputs.instance)
        field = servo_field(outputs, raw, elevator_channel(raw.parameters))
        cleaned = times.of(key)
        if field is not None and int(cleaned.keep.sum()) > 1:
            pwm = raw.messages[key].fields[field][cleaned.keep].astype(np.float64)
            elevator = hold(
                raw.messages[key].time_s[cleaned.keep], pwm, cleaned.gaps, grid, cleaned.step_s
            )
    return find_free_flight(
        grid,
        np.full(len(grid), np.nan) if speed is None else speed,
        columns.get("h_m"),
        columns.get("q_radps"),
        elevator,
        mode_changes_s,
    )


def _mode_names(numbers: FloatArray, raw: RawLog) -> NDArray[Any]:
    """Return flight modes as text: ArduPlane's names, or "mode N" for other vehicles."""
    plane = raw.dialect.startswith("dataflash") or raw.facts.get("mav_type") == 1.0
    mode_names = PLANE_MODES if plane else {}
    unique, inverse = np.unique(np.where(np.isfinite(numbers), numbers, -1), return_inverse=True)
    names = ["" if u < 0 else mode_names.get(int(u), f"mode {int(u)}") for u in unique]
    return np.array(names, dtype=object)[inverse]


def _manoeuvres(raw: RawLog, grid: FloatArray) -> NDArray[Any] | None:
    """Return labels from texts such as "manoeuvre pitch-doublet" and "manoeuvre end"; None
    without any.

    `dataflash_writer` writes such texts.
    """
    marks = [
        (t, text.removeprefix(MANOEUVRE_TEXT))
        for t, text in raw.texts
        if text.startswith(MANOEUVRE_TEXT)
    ]
    if not marks:
        return None
    names = np.array(["", *("" if name == "end" else name for _, name in marks)], dtype=object)
    half = 0.5 * float(np.median(np.diff(grid)))
    return names[np.searchsorted(np.array([t for t, _ in marks]), grid + half, side="right")]


def _start(raw: RawLog, sensors: Sensors) -> dict[str, float]:
    """Return the first GPS fix as lat_deg, lon_deg and alt_m; empty without one."""
    for message, lat, lon, alt, scale in (
        ("GPS", "Lat", "Lng", "Alt", 1.0),
        ("GLOBAL_POSITION_INT", "lat", "lon", "alt", 1e-7),
        ("vehicle_gps_position", "lat", "lon", "alt", 1e-7),
    ):
        entry = sensors.resolve(Entry(message, None, (lat, lon)))
        table = raw.messages.get((entry.message, entry.instance or 0))
        if table is None or lat not in table.fields or lon not in table.fields:
            continue
        fix = np.flatnonzero(np.abs(table.fields[lat].astype(float)) > 0)
        if len(fix):
            start = {
                "lat_deg": float(table.fields[lat][fix[0]]) * scale,
                "lon_deg": float(table.fields[lon][fix[0]]) * scale,
            }
            if alt in table.fields:
                start["alt_m"] = float(table.fields[alt][fix[0]]) * (1.0 if scale == 1.0 else 1e-3)
            return start
    return {}


# Short dropouts are bridged; long gaps stay.

MAX_BRIDGED_S = 0.1
MAX_BRIDGED_SHARE = 0.2
"""Share of a channel's samples that may be bridged. Bridged samples count as measurements, so that
standard errors are at most 10 % too small.
"""


def bridge(
    record: FlightRecord,
    names: Sequence[str],
    held_channels: Collection[str] = (),
    longest_s: float = MAX_BRIDGED_S,
) -> tuple[FlightRecord, list[str]]:
    """Fill the short dropouts of a record.

    Rows that are missing over at most ``longest_s`` are inserted, evenly spaced in time. Then NaN
    over at most that long is interpolated linearly in the channels ``names``, or held in those of
    ``held_channels``. A channel with more than MAX_BRIDGED_SHARE to fill stays as it is, and so
    does every longer gap.

    Parameters
    ----------
    record : FlightRecord
        Record with dropouts.
    names : sequence of str
        Channels to fill.
    held_channels : collection of str
        Channels that keep the last value instead (commands).
    longest_s : float
        Longest dropout that is filled, s.

    Returns
    -------
    record : FlightRecord
        The filled record.
    notes : list of str
        A sentence with numbers for each kind of repair.
    """
    record, restored_rows = _restore_rows(record, longest_s)
    notes = (
        [f"{restored_rows} lost row(s) were put back, each gap at most {longest_s:g} s long"]
        if restored_rows
        else []
    )
    time = record["time_s"]
    columns: dict[str, NDArray[Any]] = {}
    for name in names:
        if name not in record or name in LABELS:
            continue
        values = np.array(record[name], dtype=np.float64)
        finite_rows = np.flatnonzero(np.isfinite(values))
        # Dropouts: steps between finite samples that skip rows, within the allowed time.
        jumps = np.flatnonzero(
            (np.diff(finite_rows) > 1) & (np.diff(time[finite_rows]) <= longest_s + record.dt_s)
        )
        inside = (
            np.concatenate([np.arange(finite_rows[j] + 1, finite_rows[j + 1]) for j in jumps])
            if jumps.size
            else np.zeros(0, int)
        )
        if not inside.size or inside.size > MAX_BRIDGED_SHARE * (finite_rows.size + inside.size):
            continue
        if name in held_channels:
            values[inside] = values[finite_rows[np.searchsorted(finite_rows, inside) - 1]]
        else:
            values[inside] = np.interp(time[inside], time[finite_rows], values[finite_rows])
        columns[name] = values
        if inside.size > restored_rows:
            method = "held" if name in held_channels else "bridged in straight lines"
            notes.append(
                f"{inside.size} of {finite_rows.size + inside.size} samples of {name} are missing"
                f" and were {method}"
            )
    return (record.with_columns(columns) if columns else record), notes


def _restore_rows(record: FlightRecord, longest_s: float) -> tuple[FlightRecord, int]:
    """Insert rows of NaN where time skips a few steps; return the record and their number.

    Labels repeat the row before.
    """
    time, dt = record["time_s"], record.dt_s
    steps = np.diff(time)
    at = np.flatnonzero((steps > 1.5 * dt) & (steps <= longest_s + dt))
    # Rows that fit into the step, apart from its end.
    missing = np.rint(steps[at] / dt).astype(int) - 1
    at, missing = at[missing > 0], missing[missing > 0]
    missing_rows = int(missing.sum())
    if not 0 < missing_rows <= MAX_BRIDGED_SHARE * (len(record) + missing_rows):
        return record, 0
    where = np.repeat(at + 1, missing)
    new = np.concatenate(
        [
            time[k] + steps[k] * np.arange(1, n + 1) / (n + 1)
            for k, n in zip(at, missing, strict=True)
        ]
    )
    columns: dict[str, NDArray[Any]] = {"time_s": np.insert(time, where, new)}
    for name, values in record.columns.items():
        if name != "time_s":
            columns[name] = np.insert(
                values, where, values[where - 1] if name in LABELS else np.nan
            )
    return FlightRecord(columns, record.metadata), missing_rows
