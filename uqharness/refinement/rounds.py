"""Chosen effects written into a copy of the aircraft, flown and estimated with everything else; and
what may be chosen there.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sysid.arrays import FloatArray
from sysid.effects import (
    DIFFERENT,
    EARNED,
    OVERWHELMING,
    RESOLVED_ROWS,
    UNKNOWN_ROWS,
    Choice,
    Columns,
    Effect,
    Evidence,
    Selection,
    TurbulenceModel,
    agreement,
    corrected,
    judged,
    projected,
    scores,
    select,
    solve,
)
from sysid.parallel import Processes
from uqharness.identification import fit_replays
from uqharness.identification.linearised import (
    LOCAL_SLOPE,
    NEARBY_SHARE,
    FlightData,
    Linearisation,
    ModelState,
    StagedModels,
    Trajectory,
    begun_at,
    best_flown,
    effect_columns,
    fit_at,
    gust_refit,
    in_dead_zone,
    in_dynamics,
    observed,
    point_of,
    refit,
    slopes_here,
    surface_change,
    with_sensors_of,
)
from uqharness.identification.linearised import fly as linearised_fly
from uqharness.plugin import Estimate
from uqharness.refinement.round import Round, Start, column_evidence, joint_point
from uqharness.refinement.write_xml import Written, carrier, control_slopes, write_effects
from uqharness.replay import CONTROLS, Flight, ReplayModel, batched_pool, runs_per_row
from uqharness.simulator import Actuator, Aircraft, find_aircraft

# Controls recorded late or early: one time for all of them looks like a lag in every servo, and
# is no effect of the aircraft.
#
# The time competes with the candidates as one column (sysid.effects.score) before any effect is
# chosen. Where it explains as much as the best of them, and as all servos' lags together, the
# records are put right, and the choice is made on those.

CONTROLS_LATE = Effect(
    None,
    "record",
    "delay",
    "controls recorded early or late",
    "all commands act one time later than the record says",
    unit="s",
)
MOST_CORRECTIONS = 4
LEAST_LATE_ROWS = DIFFERENT * RESOLVED_ROWS
"""A time below this share of a row is within what a replay resolves."""


def controls_late(
    evidence: Evidence,
    free: Sequence[str],
    odds: Mapping[str, float],
    limit: float,
    least_s: float,
    early_s: float,
) -> tuple[float, float] | None:
    """(seconds, standard error) by which all controls act after their rows, None where the flights
    do not say so.

    evidence    with the column of CONTROLS_LATE; odds: candidate -> odds of the effects that
    compete with it
    limit       |t| asked; least_s, early_s: what is later, or earlier, than this is a slip of the
    record"""
    key = CONTROLS_LATE.key
    value, std, _ = corrected(evidence, free, key)
    if not abs(value / std) > limit or not (value > least_s or value < -early_s):
        return None
    own = float(scores(evidence, free, [key]).gain[0])
    rivals = list(odds)
    merit = scores(evidence, free, rivals).gain - np.array([odds[k] for k in rivals])
    if np.nanmax(merit, initial=0.0) > own:
        return None
    lags = [k for k in rivals if k.startswith("effect/actuator.") and k.endswith("/lag")]
    if lags and joint_gain(evidence, free, lags) > own + DIFFERENT**2:
        return None
    if (confirming := evidence.confirming) is not None and not agreement(
        evidence, free, key, ~confirming
    )[0] > 0.0:
        return None
    return value, std


def joint_gain(evidence: Evidence, free: Sequence[str], keys: Sequence[str]) -> float:
    """Rise of twice the log likelihood by several candidates at once, u' g^-1 u with the free
    columns taken out.
    """
    g, left = projected(*evidence.everything, evidence.index(free), evidence.index(keys))
    return float(left @ solve(g, left[:, None])[:, 0])


def later(flights: Sequence[Flight], late_s: float) -> list[Flight]:
    """The flights with every command and position ``late_s`` seconds later; before the first row
    its value is held.
    """
    return [f.with_delayed_commands(late_s) if late_s else f for f in flights]


def words(late_s: float, std_s: float, dt_s: float) -> str:
    """The finding as an engineer reads it."""
    way = "after" if late_s > 0 else "before"
    return (
        f"the controls act {1e3 * abs(late_s):.1f} +/- {1e3 * std_s:.1f} ms"
        f" ({abs(late_s) / dt_s:.2f} rows) {way} the time the records give them, all by the same: a"
        " matter of the record's clock, not of a servo; put right in every flight here before"
        " effects were looked for. Find out which clock stamps the commands"
    )


# At which rate limit a servo's slowness shows: nothing happens down to the fastest motion asked
# of it, then more and more.
#
# One slope for all of that is right nowhere: a limit a little below the fastest motion would be
# estimated above it, where it does nothing. So some limits are tried, each against the servo's
# own, for the one whose estimated change is the change it makes; its column stands for the
# effect. Once an effect is flown, its column is the slope at the limit that flies. So are dead
# zones.

SHARES = (0.98, 0.95, 0.9, 0.85, 0.75, 0.6, 0.45, 0.3)
"""Limits tried, of the fastest motion."""
FASTER = (0.75, 0.5, 0.25, 0.0)
"""Limits tried above the servo's own: its share in the travel time of a degree, the rest that of
the fastest motion.
"""

WIDTHS_DEG = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
"""Dead zones tried: about as wide as the one that there is, a column has its form; a narrow one
moves a surface at once.
"""


def limits_tried(
    setup: FlightData, fit: Linearisation, gusts: TurbulenceModel | None
) -> FlightData:
    """The setup with the rate limit and the dead zone of each servo whose estimated change is the
    change it makes, by a fit without effects."""
    if not setup.servos:
        return setup
    tried = {surface: _asked(setup, surface, servo) for surface, servo in setup.servos.items()}
    columns = []
    for segment, p in zip(setup.segments, fit.probes, strict=True):
        inputs: dict[str, tuple[int, FloatArray]] = {}
        for surface, servo in setup.servos.items():
            k = CONTROLS.index(surface)
            moved = {
                _key(surface, x): surface_change("rate_limit", servo, segment, k, (servo.rate, x))
                for x in tried[surface]
            }
            moved |= {
                _zone(surface, width): in_dead_zone(p.controls[:, k], width) for width in WIDTHS_DEG
            }
            inputs |= {
                name: (-1, p.by_control[:, :, k] * by[:, None]) for name, by in moved.items()
            }
        columns.append(Columns(tuple(inputs), inputs, {}))
    evidence, free = column_evidence(setup, fit, columns, gusts), fit.columns[0].names
    widths, limits, zones = np.array(WIDTHS_DEG), {}, {}
    for surface, servo in setup.servos.items():
        found = scores(evidence, free, [_zone(surface, width) for width in WIDTHS_DEG])
        zone = just_so(widths, found.estimate / widths, found.t)
        if zone is not None:
            zones[surface] = zone
        found = scores(evidence, free, [_key(surface, limit) for limit in tried[surface]])
        speeds = np.array(tried[surface])
        wanted = found.estimate / (1.0 / speeds - 1.0 / servo.rate)
        strength = np.where(wanted > 0.0, np.abs(found.t), 0.0)
        side = max(
            (speeds < servo.rate, speeds > servo.rate), key=lambda s: strength[s].max(initial=0.0)
        )
        best = just_so(speeds[side], wanted[side], found.t[side])
        if best is not None:
            limits[surface] = (servo.rate, best)
    return replace(setup, limits=limits, zones=zones)


def _asked(setup: FlightData, surface: str, servo: Actuator) -> list[float]:
    """Limits to try [deg/s]: below the fastest motion and the servo's own, falling; and above its
    own, up to the fastest motion without a limit, rising."""
    fastest, free = (_fastest(setup, surface, s) for s in (servo, replace(servo, rate=np.inf)))
    slower = [
        limit for share in SHARES if 1.0 < (limit := share * min(fastest, servo.rate)) < servo.rate
    ]
    # A quarter of the way and so on, in travel time per degree; at the end the limit does nothing
    # any more.
    faster = (
        [1.0 / (share / servo.rate + (1.0 - share) / free) for share in FASTER]
        if free > servo.rate / NEARBY_SHARE
        else []
    )
    return [*slower, *faster]


def _key(surface: str, limit: float) -> str:
    return f"{surface}@{limit:g}"


def _zone(surface: str, width: float) -> str:
    return f"{surface}~{width:g}"


def just_so(limit: FloatArray, wanted: FloatArray, t: FloatArray) -> float | None:
    """The limit [deg/s] whose estimated share is 1; ``wanted`` (n,): estimated shares at limits
    (n,) further and further from the servo's own.

    Else the one of which they say most; None where all speaks against such a servo.
    """
    fine = np.isfinite(wanted) & (wanted > 0.0)
    if not fine.any():
        return None
    limit, share, t = limit[fine], np.log(wanted[fine]), t[fine]
    for k in range(len(limit) - 1):
        if share[k] >= 0.0 > share[k + 1]:
            return float(
                limit[k] + (limit[k + 1] - limit[k]) * share[k] / (share[k] - share[k + 1])
            )
    return float(limit[int(np.argmax(np.abs(t)))])


def _fastest(setup: FlightData, surface: str, servo: Actuator) -> float:
    """Fastest motion of a surface [deg/s], from row to row."""
    k = CONTROLS.index(surface)
    return max(
        float(
            np.abs(
                np.diff(servo.follow(s.controls[:, k], s.dt_s, s.dt_s / runs_per_row(s.dt_s)))
            ).max(initial=0.0)
        )
        / s.dt_s
        for s in (segment.at_commands() for segment in setup.segments)
    )


def _surface(key: str) -> str:
    """Of which surface's servo an effect is; another text where it is of none."""
    return key.removeprefix("effect/actuator.").partition("/")[0]


def felt(chosen: Sequence[Choice], setup: FlightData) -> tuple[Choice, ...]:
    """The choices, rate limits no higher than the fastest motion asked of their servo: above it any
    limit is the same.
    """

    def within(c: Choice) -> Choice:
        least = least_felt(setup, c.key)
        return c if c.value >= least else replace(c, value=least, t=least / c.std)

    return tuple(within(c) for c in chosen)


def least_felt(setup: FlightData, key: str) -> float:
    """Value [s/deg] of a servo's rate limit effect below which nothing changes any more; of any
    other effect -inf.
    """
    surface = _surface(key)
    servo = setup.servos.get(surface)
    if not key.endswith("/rate_limit") or servo is None or not np.isfinite(servo.rate):
        return -np.inf
    fastest = _fastest(setup, surface, replace(servo, rate=np.inf))
    if servo.lag is not None:
        # A servo is fastest where its command jumps, and slows down to the next row.
        rows = servo.lag * setup.segments[0].at_commands().dt_s
        fastest *= rows / -np.expm1(-rows)
    return float(min(1.0 / fastest - 1.0 / servo.rate, 0.0))


def as_known_here(selection: Selection, found: Round) -> Selection:
    """Rate limits above the servos' own where their slope at the flown value has them, with the
    standard errors of that; where the flights say nothing of it, the way to the fastest motion is
    the error. |t|, of the whole change, stays."""

    def local(c: Choice) -> Choice:
        here = c.key + LOCAL_SLOPE
        if here not in found.evidence.names:
            return c
        least = least_felt(found.setup, c.key)
        value = found.flown[c.key]
        flown = found.evidence.taken_out({c.key: -value})
        step, std, _ = corrected(flown, [n for n in found.free if n != c.key], here)
        if not np.isfinite(std):
            return replace(c, std=max(c.std, value - least))
        return replace(c, value=float(np.clip(value + step, least, 0.0)), std=std)

    return replace(selection, chosen=tuple(map(local, selection.chosen)))


def is_fastest(choice: Choice, setup: FlightData) -> bool:
    """Whether a rate limit lies within its error of the fastest motion asked of the servo, so that
    it may be any number above.
    """
    return bool(choice.value - 2.0 * choice.std <= least_felt(setup, choice.key))


HELD_FLIGHTS = 8
"""Flights in which a number that JSBSim reads once may come to its value."""
_OF_TIME = ("s", "s/deg")
"""Units of delays and lags, and of rate limits."""


def fly(start: Start, selection: Selection, about: Round, folder: Path) -> Round | None:
    """The effects flown, everything estimated with them, again until the numbers that JSBSim reads
    once (mass, servos) stand, and what would be chosen there; None where no filter can follow the
    flights with them. about: the round it begins from.

    Until they stand, what they leave looks like other effects. One whose estimated change is as
    large as before it was changed, and no likelier for it, does not do what its column says, and is
    left out."""
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
    """How far to go from a value at which the estimated change is so much, (value, change), by the
    secant; at most to twice it.

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
    with StagedModels(staged, setup) as bench:
        gusts = start.gusts
        if gusts is not None:
            # What an effect did was noise to the sensors, and a filter that follows vanes late
            # finds their scales and rates.
            found = gust_refit(
                bench.model,
                bench.direct_model,
                setup,
                begin,
                names,
                start.limits,
                start.map_,
                gusts,
                tune=True,
            )
            fit, gusts, setup, cost = found.fit, found.gusts, found.setup, found.neg2_log_likelihood
        else:
            options = [begin, replace(start.before.trajectory.point, effects=written)]
            best = best_flown(bench.model, setup, options, start.map_)
            fit = refit(
                bench.model, bench.direct_model, setup, best.point, names, start.limits, start.map_
            )
            cost = fit.trajectory.cost
    return _round_of(start, setup, fit, gusts, cost, written)


def fitted_effects(setup: FlightData) -> dict[str, str]:
    """Return key -> property of the active effects that a fit of replays estimates: all carried
    ones but those of servos.
    """
    return {key: place.name for key, place in setup.carriers.items() if place.servo is None}


def with_values(selection: Selection, values: Mapping[str, float]) -> Selection:
    """Return the selection with other values of some effects by key; standard errors stay."""
    chosen = tuple(
        replace(c, value=values[c.key], t=values[c.key] / c.std) if c.key in values else c
        for c in selection.chosen
    )
    return replace(selection, chosen=chosen)


def sensors_moved(setup: FlightData, point: ModelState) -> bool:
    """Whether an active effect moves a sensor; replays of a fit have their sensors where the card
    says.
    """
    return any("/place_" in e.key and point.effects.get(e.key) for e in setup.active)


def fit_point(
    model: ReplayModel,
    setup: FlightData,
    point: ModelState,
    names: Sequence[str],
    limits: Mapping[str, tuple[float, float]],
    pool: Processes,
    absent: Collection[str] = (),
) -> Trajectory | None:
    """Estimate properties, carried effects, start states and nuisances at once by output error on
    replays.

    Parameters
    ----------
    model : the aircraft with the active effects of ``setup``
    point : where the fit begins; what it does not estimate keeps the value it has there
    names : properties to estimate, with their ``limits``
    absent : keys of active effects that stay at zero

    Returns
    -------
    The replay at the estimates, or None if the fit did not converge.
    """
    unlimited = (-np.inf, np.inf)
    carried = {k: prop for k, prop in fitted_effects(setup).items() if k not in absent}
    sensed = {
        e.key: point.effects[e.key]
        for e in setup.active
        if not in_dynamics(e) and e.key not in absent
    }
    properties = setup.properties(point)
    free = [*names, *carried.values()]
    data = replace(
        observed(setup, sensed),
        begin=begun_at(point),
        properties={n: v for n, v in properties.items() if n not in free},
    )
    result = fit_replays(
        model,
        data,
        free,
        [np.array([properties[n] for n in free])],
        [limits.get(n, unlimited) for n in free],
        batched_pool(pool),
        errors=False,
    )
    result.replay.forget()
    if not result.fit.converged:
        return None
    estimates = result.values()
    effects = {
        key: estimates[carried[key]] - setup.carriers[key].absent if key in carried else value
        for key, value in point.effects.items()
    }
    fitted = point_of(result, setup, names, sensed)
    fitted = replace(fitted, values={**point.values, **fitted.values}, effects=effects)
    return linearised_fly(model, setup, fitted, pool)


def settled(start: Start, final: Round, folder: Path) -> Round:
    """The round with everything estimated once more by output error on replays, the objective and
    the estimator of `identify`.

    Linearised columns choose effects and come near; they carry errors of a few per cent and a prior
    of delays. In turbulence, and where the fit does not converge or fits worse, the round stays as
    it is. What JSBSim reads once and what sensors do stays."""
    if final.gusts is not None or not final.flown:
        return final
    written = {**final.flown, **final.held}
    staged, setup = stage(start, written, folder)
    setup = replace(setup, noise=final.setup.noise)
    point = final.fit.trajectory.point
    if sensors_moved(setup, point):
        return final
    names = [n for n in start.names if n in point.values]
    with StagedModels(staged, setup) as bench:
        flown = fit_point(bench.model, setup, point, names, start.limits, start.map_)
        # The concentrated likelihood and this cost, of fixed noise, differ a little at the optimum.
        if flown is None or flown.cost > final.fit.trajectory.cost + DIFFERENT**2:
            return final
        effects = flown.point.effects
        fit = fit_at(
            bench.model,
            bench.direct_model,
            setup,
            [*start.names, *written],
            flown,
            start.map_,
            final.fit.analytic,
        )
    again = _round_of(start, setup, fit, None, flown.cost, written)
    exact = {key: effects[key] for key in fitted_effects(setup)}
    return replace(again, selection=with_values(again.selection, exact))


def _round_of(
    start: Start,
    setup: FlightData,
    fit: Linearisation,
    gusts: TurbulenceModel | None,
    cost: float,
    written: Mapping[str, float],
) -> Round:
    """Judge effects, written at such values by key, at the fit flown with them."""
    keys = list(written)
    values = {e.key: fit.trajectory.point.effects[e.key] for e in setup.active}
    rest = [e for e in start.effects.values() if e.key not in keys]
    columns = effect_columns(
        setup, fit.probes, fit.trajectory, [*rest, *slopes_here(setup.active, fit.trajectory.point)]
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
        {k: written[k] for k in setup.fixed_effects},
    )


def odds_at(
    start: Start, free: Sequence[str], evidence: Evidence, chosen: Sequence[str] = ()
) -> dict[str, float]:
    """What may be chosen at a flight's evidence beside columns ``free``, what is ``chosen`` there
    included, and the gain asked.
    """
    open_ = eligible(
        [e for e in start.effects.values() if e.key not in chosen], start.setup, free, evidence
    )
    return {
        k: start.odds(start.effects[k])
        for k in (*open_, *(k for k in start.effects if k in chosen))
    }


def resolved(start: Start, found: Round) -> Selection:
    """The effects flown, less times and rate limits that a replay or a log's rows do not resolve;
    the rest judged without them.

    A time too short to be named may still be what is there: among the alternatives it stands, if it
    explains as much."""
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
    setup: FlightData,
) -> list[str]:
    """Times among effects that are no candidates, being too short, that have their sign in the
    place of one that was kept.
    """
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
    effects: Sequence[Effect], setup: FlightData, free: Sequence[str], evidence: Evidence
) -> dict[str, float]:
    """Candidates worth scoring beside the columns ``free``, and their odds: delays that a replay
    cannot resolve are left out, and what the search did without, of which the evidence has no
    column."""
    there = [e for e in effects if e.key in evidence.names]
    found = scores(evidence, free, [e.key for e in there])
    return {
        e.key: e.odds
        for e, estimate, share in zip(there, found.estimate.tolist(), found.share, strict=True)
        if share > 0.0
        and (estimate > 0.0 or not e.positive or may_be_faster(e, setup))
        and _resolves(e, estimate, setup)
    }


def _resolves(effect: Effect, value: float, setup: FlightData) -> bool:
    """Whether an effect of time is longer than what a replay or a log's rows leave open, a rate
    limit's over the way of a doublet; True of other effects."""
    if effect.unit not in _OF_TIME:
        return True
    way = largest_step(setup, effect) if effect.unit == "s/deg" else 1.0
    # When within a row of a log a command changed, the log does not say.
    return (
        abs(value) * way
        > (UNKNOWN_ROWS if setup.late else LEAST_LATE_ROWS) * setup.segments[0].dt_s
    )


def may_be_faster(effect: Effect, setup: FlightData) -> bool:
    """Whether the effect is the lag or the rate limit of a servo that has one in the XML, which the
    real one need not have.
    """
    servo = setup.servos.get((effect.subsystem or "").removeprefix("actuator."), Actuator(None))
    return (effect.term == "lag" and servo.lag is not None) or (
        effect.term == "rate_limit" and np.isfinite(servo.rate)
    )


def largest_step(setup: FlightData, effect: Effect) -> float:
    """Half the range [deg] of the commands that an actuator's effect is about: how far a doublet
    goes.
    """
    k = CONTROLS.index((effect.subsystem or "").partition(".")[2])
    return 0.5 * max(float(np.ptp(s.controls[:, k])) for s in setup.segments)


def stage(start: Start, values: Mapping[str, float], folder: Path) -> tuple[Aircraft, FlightData]:
    """A copy of the aircraft that carries effects of such values, by key, and the setup that knows
    of them.
    """
    slopes, effects = control_slopes(start.before), [start.effects[k] for k in values]
    staged = write_staged(
        start.aircraft, [Written(e, values[e.key], "", slopes) for e in effects], folder
    )
    carriers = {e.key: found for e in effects if (found := carrier(e, start.aircraft)) is not None}
    setup = with_sensors_of(start.setup, staged)
    least = {e.key: least_felt(setup, e.key) for e in effects}
    return staged, replace(
        setup, active=tuple(effects), carriers=carriers, slopes=slopes, lower_bounds=least
    )


def write_staged(aircraft: Aircraft, effects: Sequence[Written], folder: Path) -> Aircraft:
    """A copy of the aircraft in ``folder`` with effects that have a property of their own at none:
    whoever flies it sets them, and the same effects give the same file, compiled once."""
    still = [w if carrier(w.effect, aircraft) is None else replace(w, value=0.0) for w in effects]
    return write_copy(aircraft, still, {}, folder)


def write_copy(
    aircraft: Aircraft, effects: Sequence[Written], estimates: Mapping[str, Estimate], folder: Path
) -> Aircraft:
    """A copy of the aircraft in ``folder`` with effects and new numbers of its parameters, on its
    engines and systems.
    """
    target = folder / "aircraft" / aircraft.folder.name
    target.parent.mkdir(parents=True)
    write_effects(aircraft, effects, estimates, target)
    return replace(
        find_aircraft(target), engine_path=aircraft.engine_path, systems_path=aircraft.systems_path
    )
