"""Servos that may be slower or looser than the model's: the trial values that represent their
effects until these are simulated, and the likeliest servos together.

A servo's rate limit and dead zone act only beyond a threshold, and the lag of a servo without one
is far from small, so no single slope is right: several values are tried.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.arrays import FloatArray
from sysid.effects import (
    Columns,
    Information,
    LazyColumns,
    SelectedEffect,
    Selection,
    project_out,
    score_tests,
)
from uqharness.identification.linearised import (
    NEARBY_SHARE,
    FlightData,
    Linearisation,
    Probe,
    control_delay_name,
    control_delay_s,
    dead_zone_change,
    surface_change,
)
from uqharness.refinement.estimators import Estimator
from uqharness.replay import CONTROLS, Segment, delayed_command, runs_per_row
from uqharness.simulator import Actuator

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


def with_servo_limits(data: FlightData, fit: Linearisation, estimator: Estimator) -> FlightData:
    """Return the data with the rate limit, lag and dead zone of each servo that represent its
    effects.

    Their estimated change equals their actual change, by a fit without effects.
    """
    if not data.servos:
        return data
    rates = {surface: _trial_rates(data, surface, servo) for surface, servo in data.servos.items()}

    def changes(surface: str, segment: Segment, p: Probe) -> dict[str, FloatArray]:
        """Return what each trial value of a servo changes in the surface's position."""
        servo, k = data.servos[surface], CONTROLS.index(surface)
        lags = LAGS_S if servo.lag is None else ()
        return {
            **{
                _rate_column(surface, x): surface_change(
                    "rate_limit", servo, segment, k, (servo.rate, x)
                )
                for x in rates[surface]
            },
            **{
                _zone_column(surface, width): dead_zone_change(p.controls[:, k], width)
                for width in WIDTHS_DEG
            },
            **{
                _lag_column(surface, x): surface_change("lag", servo, segment, k, lag_s=x)
                for x in lags
            },
        }

    information = _information_of(data, fit, estimator, [*data.servos], changes)
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


def _information_of(
    data: FlightData,
    fit: Linearisation,
    estimator: Estimator,
    controls: Sequence[str],
    changes: Callable[[str, Segment, Probe], Mapping[str, FloatArray]],
) -> Information:
    """Return the normal equations of changes (n,) of ``controls`` [deg, %], by name."""

    def columns_of(k: int, names: Collection[str] | None = None) -> Columns:
        """Return the columns of a segment that are among ``names``."""
        p = fit.probes[k]
        inputs = {
            name: (-1, p.by_control[:, :, CONTROLS.index(control)] * change[:, None])
            for control in controls
            for name, change in changes(control, data.segments[k], p).items()
            if names is None or name in names
        }
        return Columns(tuple(inputs), inputs, {})

    names = columns_of(0).names
    return estimator.information(data, fit, LazyColumns(names, columns_of, len(data.segments)))


@dataclass(frozen=True)
class LikeliestServos:
    """The servos of all surfaces that together explain the residuals best.

    Attributes
    ----------
    effects : mapping
        Lags and rate limits by effect key.
    gain : float
        Increase of 2 ln L, less the gains required of the effects, over the fit, in which the delay
        of the controls stands for them.
    """

    effects: Mapping[str, float]
    gain: float


@dataclass(frozen=True)
class _TrialServo:
    """A servo of a surface, and its effects beside those of the model's servo, by key."""

    surface: str
    servo: Actuator
    effects: Mapping[str, float]

    @property
    def name(self) -> str:
        """Name of its column."""
        return f"{self.surface} {self.servo.lag} {self.servo.rate}"


def likeliest_servos(
    data: FlightData, fit: Linearisation, estimator: Estimator, required_gains: Mapping[str, float]
) -> LikeliestServos | None:
    """Return the servos that together explain the residuals best; None if the model's do.

    The flight is linear in the motion of its surfaces, and this depends on commands and servos
    alone. So the likelihood of any servos is a quadratic form of their columns, all of whose
    coefficients are one. The delay of the controls, which resembles slow servos, is zero with them.

    Parameters
    ----------
    data, fit, estimator
        The flights, and the fit without effects.
    required_gains : mapping
        Gain in 2 ln L required of each candidate, by key.
    """
    trials = {surface: _trial_servos(data, surface) for surface in data.servos}
    point = fit.trajectory.point

    def changes(control: str, segment: Segment, p: Probe) -> dict[str, FloatArray]:
        """Return what each trial servo changes in a surface's position, and what the delay has
        changed in another control.
        """
        k, commands = CONTROLS.index(control), segment.at_commands()
        h, values = commands.dt_s, commands.controls[:, k]

        def positions(servo: Actuator) -> FloatArray:
            """Return the surface's positions with a servo."""
            return servo.follow(values, h, h / runs_per_row(h))

        late_s = control_delay_s(point, segment.flight)
        if control not in trials:
            late = delayed_command(values, commands.time_s, late_s)
            return {control: segment.on_rows(values - late)}
        before = delayed_command(positions(data.servos[control]), commands.time_s, late_s)
        return {t.name: segment.on_rows(positions(t.servo) - before) for t in trials[control]}

    information = _information_of(data, fit, estimator, CONTROLS, changes)
    delays = [control_delay_name(f) for f in data.timed]
    free = information.index(n for n in fit.columns[0].names if n not in delays)
    servos = [trial for rows in trials.values() for trial in rows]
    in_time = [c for c in CONTROLS if c not in trials]
    columns = information.index([*(t.name for t in servos), *in_time])
    g, u = project_out(*information.total, free, columns)
    required = np.array([sum(required_gains[k] for k in t.effects) for t in servos])
    # All combinations of one servo per surface, with the other controls in time.
    n = len(servos)
    in_time_gain = float(2.0 * u[n:].sum() - g[n:, n:].sum())
    gain = 2.0 * u[:n] - np.diagonal(g)[:n] - 2.0 * g[:n, n:].sum(axis=1) - required
    best: tuple[int, ...] = ()
    best_gain = 0.0
    *outer, last = ([k for k, t in enumerate(servos) if t.surface == s] for s in trials)
    for choice in itertools.product(*outer):
        gain_of_last = gain[last] - 2.0 * g[np.ix_(last, choice)].sum(axis=1)
        pairs = itertools.combinations(choice, 2)
        total = (
            in_time_gain
            + gain[[*choice]].sum()
            - 2.0 * sum(g[pair] for pair in pairs)
            + gain_of_last
        )
        if total.max() > best_gain:
            best, best_gain = (*choice, last[int(np.argmax(total))]), float(total.max())
    effects = {key: x for k in best for key, x in servos[k].effects.items()}
    return LikeliestServos(effects, best_gain) if effects else None


def _trial_servos(data: FlightData, surface: str) -> list[_TrialServo]:
    """Return servos of a surface with another lag, rate limit or both, and the model's first."""
    servo, key = data.servos[surface], f"effect/actuator.{surface}/"
    trials = []
    for lag_s in (0.0, *LAGS_S):
        for rate in (servo.rate, *_trial_rates(data, surface, servo)):
            effects = {f"{key}lag": lag_s, f"{key}rate_limit": 1.0 / rate - 1.0 / servo.rate}
            lag = servo.lag_with(lag_s) if lag_s else servo.lag
            changed = {k: x for k, x in effects.items() if x}
            trials.append(_TrialServo(surface, replace(servo, lag=lag, rate=rate), changed))
    return trials


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
