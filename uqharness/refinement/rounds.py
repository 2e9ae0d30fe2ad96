"""Chosen effects written into a copy of the aircraft, flown and estimated with everything else; and what may be chosen there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sysid.effects import (
    DIFFERENT,
    EARNED,
    OVERWHELMING,
    UNKNOWN_ROWS,
    Effect,
    Evidence,
    Gusts,
    Selection,
    judged,
    scores,
    select,
)
from uqharness.identification import fit_replays
from uqharness.identification.linearised import (
    Bench,
    Fit,
    Setup,
    begun_at,
    best_flown,
    effect_columns,
    fit_at,
    gust_refit,
    in_dynamics,
    observed,
    point_of,
    refit,
    slopes_here,
    with_sensors_of,
)
from uqharness.identification.linearised import fly as linearised_fly
from uqharness.plugin import Estimate
from uqharness.refinement.rates import felt, least_felt
from uqharness.refinement.round import Round, Start, column_evidence, joint_point
from uqharness.refinement.timing import LEAST_LATE_ROWS
from uqharness.refinement.writing.effects import Written, carrier, control_slopes, write_effects
from uqharness.replay import CONTROLS, spread_over
from uqharness.simulator import Actuator, Aircraft, find_aircraft

HELD_FLIGHTS = 8
"""Flights in which a number that JSBSim reads once may come to its value."""
_OF_TIME = ("s", "s/deg")
"""Units of delays and lags, and of rate limits."""


def fly(start: Start, selection: Selection, about: Round, folder: Path) -> Round | None:
    """The effects flown, everything estimated with them, again until the numbers that JSBSim reads once (mass, servos) stand, and
    what would be chosen there; None where no filter can follow the flights with them. about: the round it begins from.

    Until they stand, what they leave looks like other effects. One whose estimated change is as large as before it was changed, and
    no likelier for it, does not do what its column says, and is left out.
    """
    now = _fly_once(start, selection, about, folder)
    last: dict[str, tuple[float, float]] = {}
    merit = float("inf")
    for number in range(HELD_FLIGHTS):
        if now is None or not now.far:
            break
        chosen = []
        for c in now.selection.chosen:
            if c.key not in now.far:
                chosen.append(c)
                continue
            here = (now.far[c.key], c.value - now.far[c.key])
            nearer = c.key not in last or here[1] * np.sign(last[c.key][1]) < abs(last[c.key][1])
            if nearer or merit - now.merit > DIFFERENT**2:
                chosen.append(replace(c, value=here[0] + ahead(last.get(c.key), here)))
            last[c.key] = here
        merit = now.merit
        again = folder.with_name(f"{folder.name}-{number}")
        following = _fly_once(start, Selection(tuple(chosen)), now, again) if chosen else None
        if following is None:
            break
        now = following
    return now


def _fly_once(start: Start, selection: Selection, about: Round, folder: Path) -> Round | None:
    try:
        return _flown(start, selection, about, folder)
    except np.linalg.LinAlgError:
        return None


def ahead(last: tuple[float, float] | None, here: tuple[float, float]) -> float:
    """How far to go from a value at which the estimated change is so much, (value, change), by the secant; at most to twice it.

    A lag's slope falls off with the lag: the next estimated change is a small part of the whole.
    """
    value, change = here
    if last is None or last[0] == value:
        return change
    slope = (change - last[1]) / (value - last[0])
    most = max(abs(change), abs(value))
    return change if not slope < 0.0 else float(np.clip(-change / slope, -most, most))


def _flown(start: Start, selection: Selection, about: Round, folder: Path) -> Round:
    written = replace(selection, chosen=felt(selection.chosen, start.setup)).values
    keys = list(written)
    staged, setup = stage(start, written, folder)
    begin, names = replace(joint_point(start, about, keys), effects=written), [*start.names, *keys]
    with Bench(staged, setup) as bench:
        gusts = start.gusts
        if gusts is not None:
            # What an effect did was noise to the sensors, and a filter that follows vanes late finds their scales and rates.
            found = gust_refit(
                bench.model,
                bench.straight,
                setup,
                begin,
                names,
                start.limits,
                start.map_,
                gusts,
                tune=True,
            )
            fit, gusts, setup, cost = found.fit, found.gusts, found.setup, found.surprise
        else:
            options = [begin, replace(start.before.flown.point, effects=written)]
            best = best_flown(bench.model, setup, options, start.map_)
            fit = refit(
                bench.model, bench.straight, setup, best.point, names, start.limits, start.map_
            )
            cost = fit.flown.cost
    return _round_of(start, setup, fit, gusts, cost, written)


def settled(start: Start, final: Round, folder: Path) -> Round:
    """The round with everything estimated once more by output error on replays, the objective and the estimator of `identify`.

    Linearised columns choose effects and come near; they carry errors of a few per cent and a prior of delays. In turbulence, and
    where the fit does not converge or fits worse, the round stays as it is. What JSBSim reads once and what sensors do stays.
    """
    if final.gusts is not None or not final.flown:
        return final
    written = {**final.flown, **final.held}
    staged, setup = stage(start, written, folder)
    setup = replace(setup, noise=final.setup.noise)
    point = final.fit.flown.point
    carried = {key: place.name for key, place in setup.carriers.items() if place.servo is None}
    names = [n for n in start.names if n in point.values]
    sensed = {e.key: point.effects[e.key] for e in setup.active if not in_dynamics(e)}
    if any("/place_" in key for key in sensed):
        # Replays of a fit have their sensors where the card says.
        return final
    properties = setup.properties(point)
    free = [*names, *carried.values()]
    begun = np.array([properties[n] for n in free])
    data = replace(
        observed(setup, sensed),
        begin=begun_at(point),
        properties={n: v for n, v in properties.items() if n not in free},
    )
    unlimited = (-np.inf, np.inf)
    limits = [start.limits.get(n, unlimited) for n in free]
    with Bench(staged, setup) as bench:
        result = fit_replays(
            bench.model, data, free, [begun], limits, spread_over(start.map_), errors=False
        )
        result.replay.forget()
        estimates = result.values()
        effects = {
            key: estimates[carried[key]] - setup.carriers[key].absent if key in carried else value
            for key, value in point.effects.items()
        }
        new = point_of(result, setup, names, sensed)
        new = replace(new, values={**point.values, **new.values}, effects=effects)
        flown = linearised_fly(bench.model, setup, new, start.map_)
        # The concentrated likelihood and this cost, of fixed noise, differ a little at the optimum.
        if not result.found.converged or flown.cost > final.fit.flown.cost + DIFFERENT**2:
            return final
        fit = fit_at(
            bench.model,
            bench.straight,
            setup,
            [*start.names, *written],
            flown,
            start.map_,
            final.fit.analytic,
        )
    again = _round_of(start, setup, fit, None, flown.cost, written)
    exact = {key: effects[key] for key in carried}
    chosen = tuple(
        replace(c, value=exact[c.key], t=exact[c.key] / c.std) if c.key in exact else c
        for c in again.selection.chosen
    )
    return replace(again, selection=replace(again.selection, chosen=chosen))


def _round_of(
    start: Start,
    setup: Setup,
    fit: Fit,
    gusts: Gusts | None,
    cost: float,
    written: Mapping[str, float],
) -> Round:
    """Judge effects, written at such values by key, at the fit flown with them."""
    keys = list(written)
    values = {e.key: fit.flown.point.effects[e.key] for e in setup.active}
    rest = [e for e in start.effects.values() if e.key not in keys]
    columns = effect_columns(
        setup, fit.probes, fit.flown, [*rest, *slopes_here(setup.active, fit.flown.point)]
    )
    evidence = column_evidence(setup, fit, columns, gusts).taken_out(values)
    odds = odds_at(start, fit.columns[0].names, evidence, keys)
    free = [n for n in fit.columns[0].names if n not in keys]
    again = select(
        evidence,
        free,
        odds,
        chosen=keys,
        limit=start.limit,
        empirical=start.coloured,
        alone=OVERWHELMING,
    )
    again = replace(again, chosen=felt(again.chosen, start.setup))
    same = again.values.keys() == set(keys)
    own = again.chosen if same else felt(judged(evidence, free, keys, list(odds)), start.setup)
    merit = cost + sum(start.effects[k].odds + EARNED * start.limit**2 for k in keys)
    return Round(
        setup,
        fit,
        evidence,
        Selection(own, again.refused, again.trail),
        again,
        merit,
        gusts,
        values,
        {k: written[k] for k in setup.held},
    )


def odds_at(
    start: Start, free: Sequence[str], evidence: Evidence, chosen: Sequence[str] = ()
) -> dict[str, float]:
    """What may be chosen at a flight's evidence beside columns ``free``, what is ``chosen`` there included, and the gain asked."""
    open_ = eligible(
        [e for e in start.effects.values() if e.key not in chosen], start.setup, free, evidence
    )
    return {
        k: start.odds(start.effects[k])
        for k in (*open_, *(k for k in start.effects if k in chosen))
    }


def resolved(start: Start, found: Round) -> Selection:
    """The effects flown, less times and rate limits that a replay or a log's rows do not resolve; the rest judged without them.

    A time too short to be named may still be what is there: among the alternatives it stands, if it explains as much.
    """
    chosen = found.selection.values
    kept = [k for k, value in chosen.items() if _resolves(start.effects[k], value, start.setup)]
    free = [n for n in found.free if n not in found.keys]
    rest = [
        e for e in start.effects.values() if e.key in found.evidence.names and e.key not in kept
    ]
    open_ = list(eligible(rest, start.setup, found.free, found.evidence))
    brief = _brief([e for e in rest if e.key not in open_], free, kept, found.evidence, start.setup)
    if len(kept) == len(chosen) and not brief:
        return found.selection
    again = judged(found.evidence, free, kept, [*open_, *brief])
    if len(kept) == len(chosen):
        # The same effects, with more alternatives: their estimates are those of the flight.
        flown = {c.key: c for c in found.selection.chosen}
        again = tuple(
            replace(c, value=flown[c.key].value, std=flown[c.key].std, t=flown[c.key].t)
            for c in again
        )
    return replace(found.selection, chosen=again)


def _brief(
    effects: Sequence[Effect],
    free: Sequence[str],
    kept: Sequence[str],
    evidence: Evidence,
    setup: Setup,
) -> list[str]:
    """Times among effects that are no candidates, being too short, that have their sign in the place of one that was kept."""
    timed = [e for e in effects if e.unit in _OF_TIME]
    if not timed or not kept:
        return []
    names = [e.key for e in timed]
    instead = [
        scores(evidence, [*free, *(o for o in kept if o != k)], names).estimate for k in kept
    ]
    largest = np.max(np.nan_to_num(instead, nan=-np.inf), axis=0)
    return [
        e.key
        for e, value in zip(timed, largest, strict=True)
        if value > 0.0 or not e.positive or may_be_faster(e, setup)
    ]


def eligible(
    effects: Sequence[Effect], setup: Setup, free: Sequence[str], evidence: Evidence
) -> dict[str, float]:
    """Candidates worth scoring beside the columns ``free``, and their odds: delays that a replay cannot resolve are left out, and
    what the search did without, of which the evidence has no column."""
    there = [e for e in effects if e.key in evidence.names]
    found = scores(evidence, free, [e.key for e in there])
    return {
        e.key: e.odds
        for e, estimate, share in zip(there, found.estimate.tolist(), found.share, strict=True)
        if share > 0.0
        and (estimate > 0.0 or not e.positive or may_be_faster(e, setup))
        and _resolves(e, estimate, setup)
    }


def _resolves(effect: Effect, value: float, setup: Setup) -> bool:
    """Whether an effect of time is longer than what a replay or a log's rows leave open, a rate limit's over the way of a doublet;
    True of other effects."""
    if effect.unit not in _OF_TIME:
        return True
    way = largest_step(setup, effect) if effect.unit == "s/deg" else 1.0
    # When within a row of a log a command changed, the log does not say.
    return (
        abs(value) * way
        > (UNKNOWN_ROWS if setup.late else LEAST_LATE_ROWS) * setup.segments[0].dt_s
    )


def may_be_faster(effect: Effect, setup: Setup) -> bool:
    """Whether the effect is the lag or the rate limit of a servo that has one in the XML, which the real one need not have."""
    servo = setup.servos.get((effect.subsystem or "").removeprefix("actuator."), Actuator(None))
    return (effect.term == "lag" and servo.lag is not None) or (
        effect.term == "rate_limit" and np.isfinite(servo.rate)
    )


def largest_step(setup: Setup, effect: Effect) -> float:
    """Half the range [deg] of the commands that an actuator's effect is about: how far a doublet goes."""
    k = CONTROLS.index((effect.subsystem or "").partition(".")[2])
    return 0.5 * max(float(np.ptp(s.controls[:, k])) for s in setup.segments)


def stage(start: Start, values: Mapping[str, float], folder: Path) -> tuple[Aircraft, Setup]:
    """A copy of the aircraft that carries effects of such values, by key, and the setup that knows of them."""
    slopes, effects = control_slopes(start.before), [start.effects[k] for k in values]
    staged = write_staged(
        start.aircraft, [Written(e, values[e.key], "", slopes) for e in effects], folder
    )
    carriers = {e.key: found for e in effects if (found := carrier(e, start.aircraft)) is not None}
    setup = with_sensors_of(start.setup, staged)
    least = {e.key: least_felt(setup, e.key) for e in effects}
    return staged, replace(
        setup, active=tuple(effects), carriers=carriers, slopes=slopes, least=least
    )


def write_staged(aircraft: Aircraft, effects: Sequence[Written], folder: Path) -> Aircraft:
    """A copy of the aircraft in ``folder`` with effects that have a property of their own at none: whoever flies it sets them, and
    the same effects give the same file, compiled once."""
    still = [w if carrier(w.effect, aircraft) is None else replace(w, value=0.0) for w in effects]
    return write_copy(aircraft, still, {}, folder)


def write_copy(
    aircraft: Aircraft, effects: Sequence[Written], estimates: Mapping[str, Estimate], folder: Path
) -> Aircraft:
    """A copy of the aircraft in ``folder`` with effects and new numbers of its parameters, on its engines and systems."""
    target = folder / "aircraft" / aircraft.folder.name
    target.parent.mkdir(parents=True)
    write_effects(aircraft, effects, estimates, target)
    return replace(
        find_aircraft(target), engine_path=aircraft.engine_path, systems_path=aircraft.systems_path
    )
