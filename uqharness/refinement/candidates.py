"""Candidate effects of given flights, and the shortest times that these resolve.

Candidates are the catalogue (`sysid.effects.catalogue`) without what the model estimates already,
and the user's own effects. A servo's rate limit and dead zone act only beyond a threshold, and the
lag of a servo without one is far from small, so no single slope is right: several values are tried.
The value whose estimated change equals its actual change represents the effect until it is
simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.arrays import FloatArray
from sysid.effects import (
    Columns,
    Effect,
    Information,
    SelectedEffect,
    Selection,
    estimate_selected,
    score_tests,
    subsystem_effects,
    tuned,
)
from sysid.effects.catalogue import catalogue
from uqharness.identification.linearised import (
    NEARBY_SHARE,
    FlightData,
    Linearisation,
    dead_zone_change,
    surface_change,
)
from uqharness.refinement.estimators import Estimator
from uqharness.replay import CONTROLS, SENSOR_OF, runs_per_row
from uqharness.simulator import Actuator

SHORTEST_ROWS = tuned.SIGNIFICANT_Z * tuned.RESOLVED_ROWS
"""Shortest time, in rows, that a replay resolves."""
TIME_UNITS = ("s", "s/deg")
"""Units of delays and lags, and of rate limits."""
SLOWER_SHARES = (0.98, 0.95, 0.9, 0.85, 0.75, 0.6, 0.45, 0.3)
"""Rate limits tried below the servo's nominal one, as shares of the fastest motion."""
SHARES_OF_JUMP = (0.2, 0.14, 0.1, 0.07, 0.05, 0.03)
"""More of them for a servo without a lag, whose fastest motion is a jump within a row."""
FASTER_SHARES = (0.75, 0.5, 0.25, 0.0)
"""Rate limits tried above the nominal one: its share in the travel time per degree; the rest is
that of the fastest motion."""
LAGS_S = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32)
"""Lags tried for a servo without one: a jump's small delay resembles no slow surface."""
WIDTHS_DEG = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
"""Widths of dead zones tried: a column has the form of a zone about as wide."""


def candidate_effects(
    data: FlightData, parameters: Sequence[str], extra: Sequence[Effect]
) -> list[Effect]:
    """Return the user's effects ``extra`` and the catalogue, without what the model estimates
    already.
    """
    # Delays of an autopilot's sensors are nuisances there, no candidates.
    delayed = data.outputs if not data.delayed_sensors else ()
    sensors = list(dict.fromkeys(SENSOR_OF.get(c, c) for c in delayed))
    channels = [c for c in delayed if c in SENSOR_OF]
    subsystems = subsystem_effects(list(data.servos), data.outputs, sensors, channels)
    effects: dict[str, Effect] = {}
    for e in (*extra, *catalogue(), *subsystems):
        if e.coefficient is None or e.property_name not in parameters:
            effects.setdefault(e.key, e)
    return list(effects.values())


def eligible(
    effects: Sequence[Effect], data: FlightData, free: Sequence[str], information: Information
) -> list[str]:
    """Return the keys of the candidates to score beside the columns ``free``.

    Candidates without information of their own, of an impossible sign, and times that a replay
    cannot resolve are left out.
    """
    present = [e for e in effects if e.key in information.names]
    result = score_tests(information, free, [e.key for e in present])
    rows = zip(present, result.estimate.tolist(), result.share, strict=True)
    return [
        e.key
        for e, estimate, share in rows
        if share > 0.0 and _has_possible_sign(e, estimate, data) and _is_resolved(e, estimate, data)
    ]


def without_unresolved(
    selection: Selection,
    effects: Sequence[Effect],
    data: FlightData,
    free: Sequence[str],
    information: Information,
) -> Selection:
    """Remove times and rate limits that replays or the log's rows do not resolve; re-estimate the
    others.

    A removed time may be the cause all the same: it stays among the alternatives if it explains as
    much.

    Parameters
    ----------
    selection : Selection
        Effects of a model.
    effects : sequence of Effect
        All candidates.
    data : FlightData
    free : sequence of str
        Columns that the model's fit estimates, effects included.
    information : Information
    """
    by_key = {e.key: e for e in effects}
    values = selection.values
    resolved = [k for k, value in values.items() if _is_resolved(by_key[k], value, data)]
    others_free = [n for n in free if n not in values]
    unselected = [e for e in effects if e.key in information.names and e.key not in resolved]
    open_keys = eligible(unselected, data, free, information)
    closed = [e for e in unselected if e.key not in open_keys]
    short = _short_times(closed, others_free, resolved, information, data)
    if len(resolved) == len(values) and not short:
        return selection
    estimated = estimate_selected(information, others_free, resolved, [*open_keys, *short])
    if len(resolved) == len(values):
        # The same effects with more alternatives: their estimates are those of the flight.
        simulated = {c.key: c for c in selection.chosen}
        estimated = tuple(
            replace(c, value=s.value, std=s.std, t=s.t)
            for c, s in ((c, simulated[c.key]) for c in estimated)
        )
    return replace(selection, chosen=estimated)


def _short_times(
    effects: Sequence[Effect],
    free: Sequence[str],
    selected: Sequence[str],
    information: Information,
    data: FlightData,
) -> list[str]:
    """Return times that are too short to be candidates but have a possible sign in place of a kept
    effect.
    """
    times = [e for e in effects if e.unit in TIME_UNITS]
    if not times or not selected:
        return []
    keys = [e.key for e in times]
    in_place = [
        score_tests(information, [*free, *(o for o in selected if o != k)], keys).estimate
        for k in selected
    ]
    largest = np.max(np.nan_to_num(in_place, nan=-np.inf), axis=0)
    return [
        e.key
        for e, value in zip(times, largest, strict=True)
        if _has_possible_sign(e, float(value), data)
    ]


def _has_possible_sign(effect: Effect, value: float, data: FlightData) -> bool:
    """Return whether an effect may have that sign: times are positive, unless a servo has one to
    lose.
    """
    return value > 0.0 or not effect.positive or may_be_faster(effect, data)


def _is_resolved(effect: Effect, value: float, data: FlightData) -> bool:
    """Return whether replays and the log's rows resolve a time, or a rate limit over a doublet.

    Other effects are always resolved.
    """
    if effect.unit not in TIME_UNITS:
        return True
    travel = largest_step(data, effect) if effect.unit == "s/deg" else 1.0
    # A log does not say when within a row a command changed.
    shortest_rows = tuned.UNRESOLVED_ROWS if data.delayed_sensors else SHORTEST_ROWS
    return abs(value) * travel > shortest_rows * data.segments[0].dt_s


def may_be_faster(effect: Effect, data: FlightData) -> bool:
    """Return whether an effect is the lag or rate limit of a servo that has one in the XML, which
    the real servo may lack.
    """
    servo = data.servos.get((effect.subsystem or "").removeprefix("actuator."), Actuator(None))
    return (effect.term == "lag" and servo.lag is not None) or (
        effect.term == "rate_limit" and np.isfinite(servo.rate)
    )


def largest_step(data: FlightData, effect: Effect) -> float:
    """Return half the range of an actuator's commands [deg], the travel of a doublet."""
    k = CONTROLS.index((effect.subsystem or "").partition(".")[2])
    return 0.5 * max(float(np.ptp(s.controls[:, k])) for s in data.segments)


# Rate limits and dead zones of servos.


def with_servo_limits(data: FlightData, fit: Linearisation, estimator: Estimator) -> FlightData:
    """Return the data with the rate limit, lag and dead zone of each servo that represent its
    effects.

    Their estimated change equals their actual change, by a fit without effects.
    """
    if not data.servos:
        return data
    rates = {surface: _trial_rates(data, surface, servo) for surface, servo in data.servos.items()}
    # A column of what each trial value changes along the flights.
    columns = []
    for segment, p in zip(data.segments, fit.probes, strict=True):
        inputs: dict[str, tuple[int, FloatArray]] = {}
        for surface, servo in data.servos.items():
            k = CONTROLS.index(surface)
            changes = {
                _rate_column(surface, x): surface_change(
                    "rate_limit", servo, segment, k, (servo.rate, x)
                )
                for x in rates[surface]
            }
            changes |= {
                _zone_column(surface, width): dead_zone_change(p.controls[:, k], width)
                for width in WIDTHS_DEG
            }
            if servo.lag is None:
                changes |= {
                    _lag_column(surface, x): surface_change("lag", servo, segment, k, lag_s=x)
                    for x in LAGS_S
                }
            inputs |= {
                name: (-1, p.by_control[:, :, k] * change[:, None])
                for name, change in changes.items()
            }
        columns.append(Columns(tuple(inputs), inputs, {}))
    information = estimator.information(data, fit, columns)
    free = fit.columns[0].names
    widths, limits, zones = np.array(WIDTHS_DEG), {}, {}
    lags = dict[str, float]()
    for surface, servo in data.servos.items():
        result = score_tests(information, free, [_zone_column(surface, w) for w in WIDTHS_DEG])
        zone = limit_of_unit_gain(widths, result.estimate / widths, result.t)
        if zone is not None:
            zones[surface] = zone
        if servo.lag is None:
            result = score_tests(information, free, [_lag_column(surface, x) for x in LAGS_S])
            lag = limit_of_unit_gain(np.array(LAGS_S), result.estimate / LAGS_S, result.t)
            lags |= {} if lag is None else {surface: lag}
        result = score_tests(information, free, [_rate_column(surface, x) for x in rates[surface]])
        speeds = np.array(rates[surface])
        gain = result.estimate / (1.0 / speeds - 1.0 / servo.rate)
        strength = np.where(gain > 0.0, np.abs(result.t), 0.0)
        # A servo is either slower or faster than nominal: the side that explains more.
        side = max(
            (speeds < servo.rate, speeds > servo.rate), key=lambda s: strength[s].max(initial=0.0)
        )
        rate = limit_of_unit_gain(speeds[side], gain[side], result.t[side])
        if rate is not None:
            limits[surface] = (servo.rate, rate)
    return replace(data, trial_rate_limits=limits, trial_lags=lags, trial_dead_zones=zones)


def _trial_rates(data: FlightData, surface: str, servo: Actuator) -> list[float]:
    """Return trial rate limits [deg/s].

    First those below the fastest motion and the nominal limit, falling, then those above the limit,
    up to the fastest motion without one, rising.
    """
    fastest, unlimited = (
        _fastest_motion(data, surface, s) for s in (servo, replace(servo, rate=np.inf))
    )
    slower = [
        limit
        for share in (*SLOWER_SHARES, *(SHARES_OF_JUMP if servo.lag is None else ()))
        if 1.0 < (limit := share * min(fastest, servo.rate)) < servo.rate
    ]
    # Interpolated in travel time per degree; the last limit is never reached.
    faster = (
        [1.0 / (share / servo.rate + (1.0 - share) / unlimited) for share in FASTER_SHARES]
        if unlimited > servo.rate / NEARBY_SHARE
        else []
    )
    return [*slower, *faster]


def _rate_column(surface: str, limit: float) -> str:
    """Return the name of a trial rate limit's column."""
    return f"{surface}@{limit:g}"


def _lag_column(surface: str, lag_s: float) -> str:
    """Return the name of a trial lag's column."""
    return f"{surface}%{lag_s:g}"


def _zone_column(surface: str, width: float) -> str:
    """Return the name of a trial dead zone's column."""
    return f"{surface}~{width:g}"


def limit_of_unit_gain(limit: FloatArray, gain: FloatArray, t: FloatArray) -> float | None:
    """Return the limit whose estimated change equals its actual change.

    Parameters
    ----------
    limit : (n,) array
        Values with increasing distance from the nominal one.
    gain : (n,) array
        Ratio of the estimated to the actual change.
    t : (n,) array
        |t| of each.

    Returns
    -------
    float or None
        The limit of gain 1, interpolated; otherwise that of largest |t|; None if no gain is
        positive.
    """
    usable = np.isfinite(gain) & (gain > 0.0)
    if not usable.any():
        return None
    limit, log_gain, t = limit[usable], np.log(gain[usable]), t[usable]
    for k in range(len(limit) - 1):
        if log_gain[k] >= 0.0 > log_gain[k + 1]:
            step, fall = limit[k + 1] - limit[k], log_gain[k] - log_gain[k + 1]
            return float(limit[k] + step * log_gain[k] / fall)
    return float(limit[int(np.argmax(np.abs(t)))])


def _fastest_motion(data: FlightData, surface: str, servo: Actuator) -> float:
    """Return the fastest motion of a surface from row to row [deg/s]."""
    k = CONTROLS.index(surface)
    return max(
        float(
            np.abs(
                np.diff(servo.follow(s.controls[:, k], s.dt_s, s.dt_s / runs_per_row(s.dt_s)))
            ).max(initial=0.0)
        )
        / s.dt_s
        for s in (segment.at_commands() for segment in data.segments)
    )


def clip_to_active_range(selection: Selection, data: FlightData) -> Selection:
    """Limit rate limits to the fastest motion, above which any limit is equivalent."""

    def clipped(c: SelectedEffect) -> SelectedEffect:
        """Return one effect within its range."""
        lower_bound = least_active_value(data, c.key)
        return c if c.value >= lower_bound else replace(c, value=lower_bound, t=lower_bound / c.std)

    return selection.with_each(clipped)


def least_active_value(data: FlightData, key: str) -> float:
    """Return the value of a rate limit's effect [s/deg] below which nothing changes; -inf for
    others.
    """
    surface = key.removeprefix("effect/actuator.").partition("/")[0]
    servo = data.servos.get(surface)
    if not key.endswith("/rate_limit") or servo is None or not np.isfinite(servo.rate):
        return -np.inf
    fastest = _fastest_motion(data, surface, replace(servo, rate=np.inf))
    if servo.lag is not None:
        # A servo is fastest where its command jumps, and slows down to the next row.
        rows = servo.lag * data.segments[0].at_commands().dt_s
        fastest *= rows / -np.expm1(-rows)
    return float(min(1.0 / fastest - 1.0 / servo.rate, 0.0))


def is_fastest(effect: SelectedEffect, data: FlightData) -> bool:
    """Return whether a rate limit is within its error of the servo's fastest commanded motion.

    Its interval is then open above.
    """
    return bool(effect.value - 2.0 * effect.std <= least_active_value(data, effect.key))
