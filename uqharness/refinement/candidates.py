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

from sysid.effects import (
    Effect,
    Information,
    Selection,
    estimate_selected,
    score_tests,
    subsystem_effects,
    tuned,
)
from sysid.effects.catalogue import catalogue
from uqharness.identification.linearised import FlightData
from uqharness.replay import CONTROLS, SENSOR_OF
from uqharness.simulator import Actuator

SHORTEST_ROWS = tuned.SIGNIFICANT_Z * tuned.RESOLVED_ROWS
"""Shortest time, in rows, that a replay resolves."""
TIME_UNITS = ("s", "s/deg")
"""Units of delays and lags, and of rate limits."""


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
