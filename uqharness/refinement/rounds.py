"""Chosen effects written into a copy of the aircraft, flown and estimated with everything else, until the choice stands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from sysid.effects import (
    EARNED,
    OVERWHELMING,
    STANDS,
    TWINS,
    UNKNOWN_ROWS,
    Choice,
    Columns,
    Effect,
    Evidence,
    Selection,
    gather,
    judged,
    scores,
    select,
    whiten_each,
)
from uqharness.refinement.begin import About, joint_point
from uqharness.refinement.candidates import effect_columns
from uqharness.refinement.fit import PRIOR, Fit, best_flown, merged, refit
from uqharness.refinement.gusts import GustFit, gust_evidence, gust_refit
from uqharness.refinement.rates import felt
from uqharness.refinement.rivals import at_values, companion, far_off, read_once_first, rival, without_weak
from uqharness.refinement.round import Round, Start
from uqharness.refinement.setup import Bench, with_sensors_of
from uqharness.refinement.timing import LEAST_LATE_ROWS
from uqharness.refinement.types import Point, Setup, in_dynamics
from uqharness.refinement.writing.effects import Written, carrier, write_effects
from uqharness.refinement.writing.slopes import control_slopes
from uqharness.replay import CONTROLS
from uqharness.simulator import Aircraft, find_aircraft

ROUNDS = 4
Say = Callable[[str], None]


def settle(start: Start, selection: Selection, evidence: Evidence, work: Path, say: Say) -> tuple[Round | None, list[str]]:
    """Fly what was chosen and choose again until the choice stands; the best of the rounds flown, and the trail.

    None where every round flown is worse than the aircraft as it was. A choice that goes to and fro ends at the second sight of a
    set of effects.
    """
    trail: list[str] = []
    flown: list[Round] = []
    seen: set[frozenset[str]] = set()
    about = About(start.before.flown.point, evidence, {})
    for number in range(2, ROUNDS + 2):
        if not selection.chosen:
            break
        say(f"round {number}: flying with {_listed([c.key for c in selection.chosen])}")
        folder = work / f"round{number}"
        if number == 2 and not start.gusts:
            selection = read_once_first(selection, start.effects, start.aircraft)
        now = _tried(start, selection, about, folder)
        if now is not None and not start.gusts:
            now = at_values(now, partial(_tried, start), folder)
        if now is None:
            trail.append(f"round {number}: no filter follows flights with these effects; what was flown before stands")
            break
        trail += [f"round {number}: {line}" for line in now.again.trail]
        if number == 2 and not now.standing:
            now, lines = _contested(start, now, selection, about, work, say)
            trail += lines
        flown.append(now)
        if now.standing:
            break
        seen.add(now.keys)
        following = frozenset(c.key for c in now.again.chosen)
        if following in seen and following != now.keys:
            trail.append(f"round {number}: back to effects flown before; the best round stands")
            break
        selection, about = now.again, now.about
        if start.gusts:
            rest = [e for e in start.effects if e.key not in now.keys]
            one = companion(start, now, eligible(rest, start.setup, now.fit, now.evidence), folder, say, _predicted)
            if one is not None:
                added = [c.key for c in one.chosen if c.key not in now.keys]
                trail.append(f"round {number}: of what was asked for, {_listed(added)} flies best by itself")
                selection = one
    best = likeliest(flown) if start.gusts else min(flown, key=lambda r: r.merit, default=None)
    best, lines = without_weak(best, flown, start.limit, partial(_tried, start), work / "kept")
    trail += lines
    if best is not None and not start.gusts:
        best = at_values(best, partial(_tried, start), work / "last")
    if start.gusts:
        if best is not None and best is not flown[-1] and not lines:
            trail.append(f"the best of {len(flown)} rounds flown, not the last")
        return best if selection.chosen or (best and best.standing) else None, trail
    if best is None or not best.merit < start.before.flown.cost:
        if best is not None:
            trail.append("flown, the effects do not lower the error by what they must earn")
        return None, trail
    if not best.standing and not lines:
        trail.append(f"the best of {len(flown)} rounds flown, not one that stands")
    return best, trail


def likeliest(flown: Sequence[Round]) -> Round | None:
    """The round of least merit among those that judge the same samples as the last: a sensor's delay takes some away."""

    def late(r: Round) -> frozenset[str]:
        return frozenset(k for k in r.keys if k.startswith("effect/sensor.") and k.endswith("/delay"))

    return min((r for r in flown if late(r) == late(flown[-1])), key=lambda r: r.merit, default=None)


def _listed(keys: Sequence[str]) -> str:
    return ", ".join(k.removeprefix("effect/").replace("/", " ") for k in keys)


def _tried(start: Start, selection: Selection, about: About, folder: Path) -> Round | None:
    """The effects flown; None where no filter can follow the flights with them."""
    try:
        return _flown(start, selection, about, folder)
    except np.linalg.LinAlgError:
        return None


def _contested(start: Start, now: Round, selection: Selection, about: About, work: Path, say: Say) -> tuple[Round, list[str]]:
    """The first round and what is to be said of it: of an overwhelming effect, flown in gusts, that leaves others, or of the
    alternative that flies better in its place."""
    key = selection.chosen[0].key
    if start.gusts is None or abs(selection.chosen[0].t) <= OVERWHELMING:
        return now, []
    odds = eligible(start.effects, start.setup, start.before, about.evidence)
    best = rival(start, now, selection, about, odds, work, say, _predicted)
    instead = _tried(start, Selection((best,)), about, work / "rival") if best is not None else None
    if best is None or instead is None:
        return now, []
    other = f"at {best.value:.4g}" if best.key == key else f"than {key}"
    told = f"round 2: flown alone, {best.key} does better {other}"
    return instead, [told, *(f"round 2: {line}" for line in instead.again.trail)]


def _begun(start: Start, selection: Selection, about: About, folder: Path) -> tuple[Aircraft, Setup, Point, list[str]]:
    """The aircraft with the effects, the setup that knows of them, the point to begin from, and the names to be estimated there."""
    by_key = {e.key: e for e in start.effects}
    keys = [c.key for c in selection.chosen]
    staged, setup = stage(start.aircraft, start.setup, [by_key[k] for k in keys], selection, start.before, folder)
    first, free = start.before.flown.point, start.before.columns[0].names
    joint = joint_point(about, start.setup, first, free, keys, start.limits)
    return staged, setup, with_effects(joint, selection), [*start.names, *keys]


def _predicted(start: Start, selection: Selection, about: About, folder: Path) -> GustFit:
    """One-step predictions with effects; parameters, air and the sensors' noise estimated with them."""
    assert start.gusts is not None
    selection = replace(selection, chosen=felt(selection.chosen, start.setup))
    staged, setup, begin, names = _begun(start, selection, about, folder)
    with Bench(staged, start.measured, start.ideal) as bench:
        return gust_refit(bench.model, bench.straight, setup, begin, names, start.limits, start.map_, start.gusts, tune=True)


def _flown(start: Start, selection: Selection, about: About, folder: Path) -> Round:
    by_key = {e.key: e for e in start.effects}
    selection = replace(selection, chosen=felt(selection.chosen, start.setup))
    keys = [c.key for c in selection.chosen]
    staged, setup, begin, names = _begun(start, selection, about, folder)
    rest = [e for e in start.effects if e.key not in keys]
    with Bench(staged, start.measured, start.ideal) as bench:
        gusts, surprise = start.gusts, float("nan")
        if gusts is not None:
            # What an effect did was noise to the sensors, and a filter that follows vanes late finds their scales and rates.
            found = gust_refit(bench.model, bench.straight, setup, begin, names, start.limits, start.map_, gusts, tune=True)
            fit, gusts, setup, surprise = found.fit, found.gusts, found.setup, found.surprise
            evidence = gust_evidence(setup, found, effect_columns(setup, fit.probes, fit.flown, rest))
        else:
            options = [begin, with_effects(start.before.flown.point, selection)]
            best = best_flown(bench.model, setup, options, start.map_)
            fit = refit(bench.model, bench.straight, setup, best.point, names, start.limits, start.map_)
            evidence = candidate_evidence(setup, fit, rest)
    written = {c.key: c.value for c in selection.chosen}
    values = {e.key: fit.flown.point.effects[e.key] for e in setup.active}
    evidence = evidence.taken_out(values)
    free = [n for n in fit.columns[0].names if n not in keys]
    odds = {**eligible(rest, start.setup, fit, evidence), **{k: by_key[k].odds for k in keys}}
    odds = {k: o + start.handicap.get(k, 0.0) for k, o in odds.items()}
    again = select(
        evidence,
        free,
        odds,
        start.confirming,
        chosen=keys,
        limit=start.limit,
        twins=TWINS,
        empirical=start.gusts is not None or bool(start.setup.late),
    )
    again = replace(again, chosen=felt(again.chosen, start.setup))
    standing = {c.key for c in again.chosen} == set(keys)
    own = again.chosen if standing else felt(judged(evidence, free, keys, list(odds), start.confirming, TWINS), start.setup)
    # What JSBSim reads once (mass, servos) has to be written anew until the number stands.
    held = [c for c in own if c.key not in setup.carriers and in_dynamics(by_key[c.key])]
    moving = [c for c in held if abs(c.value - written[c.key]) > STANDS * c.std]
    far = far_off(held, written)
    again = again if start.gusts is None else first_at_values(again, own, far)
    cost = fit.flown.cost if gusts is None else surprise
    merit = cost + sum(by_key[k].odds + EARNED * start.limit**2 for k in keys)
    return Round(
        setup, fit, evidence, Selection(own, again.refused, again.trail), again, standing and not moving, merit, gusts,
        About(fit.flown.point, evidence, values), surprise, {c.key: written[c.key] for c in held}, far,
    )  # fmt: skip


def first_at_values(again: Selection, own: Sequence[Choice], far: Mapping[str, float]) -> Selection:
    """What is to be flown next: of the effects flown, ``own``, nothing but these where a number that is held in flight was far from
    its estimate. Until it flies at its value, what it leaves looks like others."""
    if not far:
        return again
    trail = (*again.trail, f"first at their values: {_listed([c.key for c in own])}")
    return replace(again, chosen=tuple(own), trail=trail)


def candidate_evidence(setup: Setup, fit: Fit, effects: Sequence[Effect]) -> Evidence:
    """Evidence of a fit's own columns and of every candidate's."""
    return column_evidence(setup, fit, effect_columns(setup, fit.probes, fit.flown, effects))


def column_evidence(setup: Setup, fit: Fit, extra: Sequence[Columns]) -> Evidence:
    """Evidence of a fit's own columns beside others."""
    columns = merged(fit.columns, extra)
    white = whiten_each(fit.steps, setup.measured, columns, setup.which, setup.noise)
    return gather(white, columns.names, [s.flight for s in setup.segments], PRIOR, fit.columns[0].names)


def resolved(start: Start, found: Round) -> Selection:
    """The effects flown, less times that a replay or a log's rows do not resolve; the rest judged without them.

    A time too short to be named may still be what is there: among the alternatives it stands, if it explains as much.
    """
    by_key = {e.key: e for e in start.effects}
    least = _least_late_s(start.setup)
    chosen = found.selection.chosen
    kept = [c.key for c in chosen if by_key[c.key].unit != "s" or abs(c.value) > least]
    free = [n for n in found.fit.columns[0].names if n not in found.keys]
    rest = [e for e in start.effects if e.key in found.evidence.names and e.key not in kept]
    open_ = list(eligible(rest, start.setup, found.fit, found.evidence))
    brief = _brief([e for e in rest if e.key not in open_], free, kept, found.evidence, start.setup)
    if len(kept) == len(chosen) and not brief:
        return found.selection
    again = judged(found.evidence, free, kept, [*open_, *brief], start.confirming, TWINS)
    return replace(found.selection, chosen=again)


def _brief(effects: Sequence[Effect], free: Sequence[str], kept: Sequence[str], evidence: Evidence, setup: Setup) -> list[str]:
    """Times among effects that are no candidates, being too short, that have their sign in the place of one that was kept."""
    timed = [e for e in effects if e.unit in ("s", "s/deg")]
    if not timed or not kept:
        return []
    names = [e.key for e in timed]
    instead = [scores(evidence, [*free, *(o for o in kept if o != k)], names).estimate for k in kept]
    largest = np.max(np.nan_to_num(instead, nan=-np.inf), axis=0)
    return [e.key for e, value in zip(timed, largest, strict=True) if value > 0.0 or not e.positive or may_be_faster(e, setup)]


def _least_late_s(setup: Setup) -> float:
    # When within a row of a log a command changed, the log does not say.
    return (UNKNOWN_ROWS if setup.late else LEAST_LATE_ROWS) * setup.segments[0].dt_s


def eligible(effects: Sequence[Effect], setup: Setup, fit: Fit, evidence: Evidence) -> dict[str, float]:
    """Candidates worth scoring and their odds: delays that a replay cannot resolve are left out."""
    found = scores(evidence, fit.columns[0].names, [e.key for e in effects])
    least = _least_late_s(setup)
    out = {}
    for e, estimate, share in zip(effects, found.estimate, found.share, strict=True):
        if not share > 0.0:
            continue
        if e.positive and not estimate > 0.0 and not may_be_faster(e, setup):
            continue
        if e.unit == "s" and not abs(estimate) > least:
            continue
        if e.unit == "s/deg" and not abs(estimate) * largest_step(setup, e) > least:
            continue
        out[e.key] = e.odds
    return out


def may_be_faster(effect: Effect, setup: Setup) -> bool:
    """Whether the effect is the lag or the rate limit of a servo that has one in the XML, which the real one need not have."""
    servo = setup.servos.get((effect.subsystem or "").removeprefix("actuator."))
    if servo is None:
        return False
    return (effect.term == "lag" and servo.lag is not None) or (effect.term == "rate_limit" and np.isfinite(servo.rate))


def largest_step(setup: Setup, effect: Effect) -> float:
    """Half the range [deg] of the commands that an actuator's effect is about: how far a doublet goes."""
    k = CONTROLS.index((effect.subsystem or "").partition(".")[2])
    return 0.5 * max(float(np.ptp(s.controls[:, k])) for s in setup.segments)


def stage(
    aircraft: Aircraft, setup: Setup, chosen: Sequence[Effect], selection: Selection, fit: Fit, folder: Path
) -> tuple[Aircraft, Setup]:
    """A copy of the aircraft that carries the effects, and the setup that knows of them."""
    value = {c.key: c.value for c in selection.chosen}
    slopes = control_slopes(fit)
    staged = write_staged(aircraft, [Written(e, value[e.key], "", slopes) for e in chosen], folder)
    carriers = {e.key: found for e in chosen if (found := carrier(e, aircraft)) is not None}
    return staged, replace(with_sensors_of(setup, staged), active=tuple(chosen), carriers=carriers, slopes=slopes)


def write_staged(aircraft: Aircraft, effects: Sequence[Written], folder: Path) -> Aircraft:
    """A copy of the aircraft in ``folder`` with effects that have a property of their own at none: whoever flies it sets them, and
    the same effects give the same file, compiled once."""
    target = folder / "aircraft" / aircraft.folder.name
    target.parent.mkdir(parents=True)
    still = [w if carrier(w.effect, aircraft) is None else replace(w, value=0.0) for w in effects]
    write_effects(aircraft, still, {}, target)
    return replace(find_aircraft(target), engine_path=aircraft.engine_path, systems_path=aircraft.systems_path)


def with_effects(point: Point, selection: Selection) -> Point:
    """The point with every chosen effect at its value."""
    return replace(point, effects={c.key: c.value for c in selection.chosen})
