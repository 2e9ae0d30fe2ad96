"""The search for what a model lacks: effects are proposed by their score, flown and fitted with
everything else, and compared.

1. The linearised likelihood about the model flown last proposes effects (sysid.effects.selection).
Where one that
   enters is overwhelming, no other enters beside it until it has flown: what linearisation leaves
   of it looks like others.
2. The model with them is flown and everything is estimated, what JSBSim reads once until it stands.
3. Where it asks for several more, leaves moments that nothing explains, or no filter follows it,
what explains nearly as much in
   the newest one's place flies, too, three times in all: an airspeed sensor that reads a quarter
   too much looks at first like thrust that is off, |t| 36 and 37. Flown, the sensor's fault leaves
   nothing to ask for.
4. The search ends with a model that proposes itself. The best by the log likelihood, less what each
effect must earn, stands."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from sysid.effects import (
    ALIKE,
    CERTAIN_T,
    COMPARABLE,
    DIFFERENT,
    EARNED,
    GUST_LIMIT,
    OVERWHELMING,
    RESOLVED_ROWS,
    SEVERAL,
    UNKNOWN_ROWS,
    Choice,
    Effect,
    Evidence,
    Refusal,
    Selection,
    TurbulenceModel,
    chance_limit,
    conditional_interval,
    judged,
    likeness,
    scores,
    select,
    threshold,
)
from sysid.parallel import Processes
from uqharness.errors import BadInputError
from uqharness.identification.linearised import (
    PRIOR,
    FlightData,
    Linearisation,
    StagedModels,
    TurbulentFit,
    effect_columns,
    gust_refit,
    in_one_step,
    lateness,
    make_setup,
    setup_in_gusts,
    turbulent,
    with_jumps,
)
from uqharness.plugin import Estimate
from uqharness.refinement.base import Base, as_quiet, base_fit_and_noise, left_alone
from uqharness.refinement.round import Bent, Round, Stages, Start, candidates_for, column_evidence
from uqharness.refinement.rounds import (
    CONTROLS_LATE,
    LEAST_LATE_ROWS,
    MOST_CORRECTIONS,
    as_known_here,
    controls_late,
    eligible,
    fly,
    later,
    limits_tried,
    odds_at,
    resolved,
    settled,
    words,
)
from uqharness.refinement.write_xml import of_lift_slope
from uqharness.replay import SENSOR_OF
from uqharness.simulator import Aircraft

ROUNDS = 6
LONE = (
    "one channel of a sensor late by itself was not believed beside other delays and servos ({}):"
    " the effects were sought without such delays"
)
Say = Callable[[str], object]
Fly = Callable[[Selection, Round, Path], Round | None]


@dataclass(frozen=True)
class Searched:
    """The best model, which may be the one without effects, how it went, and what is to be told."""

    best: Round
    trail: tuple[str, ...]
    notes: tuple[str, ...] = ()


def search(start: Start, evidence: Evidence, work: Path, say: Say) -> Searched:
    """The best model about ``evidence`` of the flight without effects; one without delays of single
    channels where such a delay was chosen beside another time, unless it is less likely by more
    than chance gives: a servo whose command comes late looks like a gyro and an attitude that are,
    and a lag."""
    found = _search(start, evidence, work / "round", say)
    doubtful = lone_among_times(found.best.selection.chosen, start.effects)
    if not doubtful:
        return found
    without = replace(start, effects={k: e for k, e in start.effects.items() if not _lone(e)})
    again = _search(without, evidence, work / "whole", say)
    # By predictions, a sensor's delay takes samples away.
    if start.gusts is None and (
        not again.best.keys or again.best.merit > found.best.merit + CERTAIN_T**2
    ):
        return found
    return replace(
        again, notes=(LONE.format(", ".join(f"{e.subsystem} {e.term}" for e in doubtful)),)
    )


def _search(start: Start, evidence: Evidence, folder: Path, say: Say) -> Searched:
    odds = odds_at(start, start.free, evidence)
    first = select(
        evidence, start.free, odds, limit=start.limit, empirical=start.coloured, alone=OVERWHELMING
    )
    bare = about = Round(
        start.setup, start.before, evidence, Selection(()), first, start.merit, start.gusts
    )
    trail = [f"round 1: {line}" for line in first.trail]
    flown: list[Round] = []
    seen: set[frozenset[str]] = set()
    doubted = 0
    flight = partial(fly, start)
    for number in range(2, ROUNDS + 2):
        proposal = about.again
        if about.standing or not proposal.chosen:
            break
        here = folder.with_name(f"{folder.name}{number}")
        say(f"round {number}: flying with {_listed(proposal.values)}")
        proposed = flight(proposal, about, here)
        trail += (
            [f"round {number}: {line}" for line in proposed.again.trail]
            if proposed is not None
            else []
        )
        others = instead_of(start, proposed, proposal, about)[: SEVERAL - doubted]
        doubted += len(others)
        if others:
            say(f"flying {'; '.join(_listed(o.values) for o in others)} instead")
        # One at a time, and the better one stays: a round takes a tenth of a gigabyte and more.
        now, proposed = proposed, None
        for k, other in enumerate(others):
            tried = flight(other, about, here.with_name(f"{here.name}-instead{k}"))
            now = likeliest([r for r in (tried, now) if r is not None])
            del tried
        if now is None:
            trail.append(
                f"round {number}: flights with these effects can be neither replayed nor followed;"
                " what was flown before stands"
            )
            break
        if now.keys != proposal.values.keys():
            trail.append(
                f"round {number}: {_listed(now.keys)} flies better than {_listed(proposal.values)}"
            )
        # Those that are not the best of what they judge would take the most memory.
        flown = [*(r for r in flown if r is likeliest([*flown, r])), now]
        about = now
        seen.add(now.keys)
        following = frozenset(now.again.values)
        if following in seen and following != now.keys:
            trail.append(f"round {number}: back to effects flown before; the best round stands")
            break
    best, lines = without_weak(
        likeliest(flown) or bare,
        bare,
        flown,
        start.limit,
        flight,
        folder.with_name(f"{folder.name}-kept"),
    )
    if best.keys and not best.merit < bare.merit and _same_samples(best, bare.keys):
        best, lines = (
            bare,
            [*lines, "flown, the effects do not lower the error by what they must earn"],
        )
    if best.keys and not best.standing and not lines:
        lines = ["the best of the rounds flown, not one that stands"]
    return Searched(best, (*trail, *lines))


def instead_of(
    start: Start, now: Round | None, proposal: Selection, about: Round
) -> list[Selection]:
    """Proposals with another candidate in the place of the newest effect, where that is doubtful:
    no filter follows flights with it (now: None), it leaves moments that nothing explains, or it is
    overwhelming and leaves several effects to be asked for."""
    new = [c for c in proposal.chosen if c.key not in about.flown]
    if len(new) != 1:
        return []
    if now is not None:
        several = (
            abs(new[0].t) > OVERWHELMING
            and sum(c.key not in now.keys for c in now.again.chosen) >= SEVERAL
        )
        if not several and (now.gusts is None or not np.any(now.gusts.moments > CERTAIN_T**2)):
            return []
    kept = [k for k in proposal.values if k != new[0].key]
    free = [*start.free, *kept]
    odds = odds_at(start, [*start.free, *about.flown], about.evidence, kept)
    names = comparable(about.evidence, free, [k for k in odds if k not in kept], new[0].key)
    return [Selection(judged(about.evidence, start.free, [*kept, name], ())) for name in names]


def comparable(
    evidence: Evidence, free: Sequence[str], candidates: Sequence[str], key: str
) -> list[str]:
    """Other candidates that explain nearly as much as ``key`` in its place, the best first, no two
    of them alike.
    """
    others = [k for k in candidates if k != key]
    own, *gains = np.nan_to_num(scores(evidence, free, [key, *others]).gain, nan=-np.inf)
    gain = np.array(gains)
    found: list[str] = []
    for k in np.argsort(-gain):
        if len(found) == SEVERAL or not gain[k] >= COMPARABLE * own:
            break
        same = np.abs(np.nan_to_num(likeness(evidence, free, others[k], [key, *found])))
        if same.max() < ALIKE:
            found.append(others[k])
    return found


def likeliest(flown: Sequence[Round]) -> Round | None:
    """The round of least merit among those that judge the same samples as the last; None of
    none.
    """
    same = [r for r in flown if _same_samples(r, flown[-1].keys)]
    return min(same, key=lambda r: r.merit, default=None)


def _same_samples(found: Round, keys: frozenset[str]) -> bool:
    """Whether a round judges what one with effects ``keys`` does: by predictions, a sensor's delay
    takes samples away.
    """
    other = (
        k for k in found.keys ^ keys if k.startswith("effect/sensor.") and k.endswith("/delay")
    )
    return not found.gusts or not any(other)


def without_weak(
    best: Round, bare: Round, flown: Sequence[Round], limit: float, again: Fly, folder: Path
) -> tuple[Round, list[str]]:
    """The best round, or where effects that it flies say less than they must once they fly, the one
    without them; and why. bare: the round without any.

    Such a choice goes to and fro: what an effect seemed to be is gone when it flies, and there
    again when it does not."""
    if not any(c.t**2 > EARNED * limit**2 for c in best.selection.chosen):
        return bare, [
            f"flown, {c.key} has |t| {abs(c.t):.1f}: no effect" for c in best.selection.chosen
        ]
    weak = [c for c in best.selection.chosen if not abs(c.t) > limit] if not best.standing else []
    if not weak or len(weak) == len(best.selection.chosen):
        return best, []
    kept = tuple(c for c in best.selection.chosen if c not in weak)
    same = [r for r in flown if r.keys == {c.key for c in kept}]
    found = min(same, key=lambda r: r.merit) if same else again(Selection(kept), best, folder)
    if found is None:
        return best, []
    return found, [
        f"flown, {c.key} has |t| {abs(c.t):.1f}: the best round without it" for c in weak
    ]


def lone_among_times(chosen: Sequence[Choice], effects: Mapping[str, Effect]) -> list[Effect]:
    """Delays of single channels and everything else that is a time or a servo's, where both were
    chosen; else none.
    """
    of = [effects[c.key] for c in chosen]
    timed = [
        e for e in of if e.unit in ("s", "s/deg") or (e.subsystem or "").startswith("actuator.")
    ]
    return timed if any(map(_lone, timed)) and len(timed) > 1 else []


def _lone(effect: Effect) -> bool:
    """Whether it is the delay of one channel of a sensor that has several."""
    return effect.unit == "s" and (effect.subsystem or "").partition(".")[2] in SENSOR_OF


def _listed(keys: Iterable[str]) -> str:
    return ", ".join(k.removeprefix("effect/").replace("/", " ") for k in keys)


# Refinement: find where a model and flights disagree, name the missing effect, put it into the
# model, and show on other flights what it did.
#
# Train flights choose; test flights only show. A choice is made on the train flights'
# linearised likelihood (sysid.effects.selection), the chosen effects are then written into a
# copy of the aircraft, flown and estimated with everything else, and the choice is made again
# around that flight until it stands.

NO_AIR = (
    "the residuals of replays looked like turbulence, but of air that does not move across the"
    " flight path: an effect in the aircraft or its sensors, and the flights were judged by replays"
)
IN_TURBULENCE = (
    "the residuals of replays showed turbulence: effects and parameters were judged by predictions"
    " one sample ahead, with process noise estimated ({} more in twice the log likelihood than calm"
    " air; {})"
)
DIVERGED = 1e6
"""Gain over calm air that says no more than that the model leaves such flights in calm air."""


@dataclass(frozen=True)
class Found:
    """What the train flights say: fits without and with the effects, the choice, everything
    estimated.

    before, after   fits of the model without and with the effects; after is before where there are
    none
    parameters      property -> (value, standard error corrected for colour); plain: property ->
    value without the effects
    scoreboard      the candidates that explain most of what the parameters leave, each alone:
    (name, t); limit: |t| asked
    gusts           the air, where it was turbulent and the flights were judged by one-step
    predictions
    late_s          by how much all controls were moved later than recorded before the choice was
    made
    slopes          numbers that effects of stall and propulsion are written with
    flown           key -> value that an effect has in ``after``
    unnamed         effects that were chosen and are too weak to be named beside something
    unexplained
    bent            the curve that a chosen effect's state asks for, whose form none of the chosen
    has
    left            candidates that are not chosen and whose |t| beside the chosen is above
    CERTAIN_T: (key, t), the strongest first"""

    setup: FlightData
    names: tuple[str, ...]
    before: Linearisation
    after: Linearisation
    selection: Selection
    effects: Mapping[str, Effect]
    parameters: Mapping[str, tuple[float, float]]
    notes: tuple[str, ...]
    plain: Mapping[str, float] = field(default_factory=dict)
    gusts: TurbulenceModel | None = None
    scoreboard: tuple[tuple[str, float], ...] = ()
    limit: float = float("nan")
    late_s: float = 0.0
    trail: tuple[str, ...] = ()
    slopes: Mapping[str, float] = field(default_factory=dict)
    flown: Mapping[str, float] = field(default_factory=dict)
    unnamed: tuple[Choice, ...] = ()
    bent: Bent | None = None
    left: tuple[tuple[str, float], ...] = ()

    @property
    def gusty(self) -> bool:
        """Whether one-step predictions judged."""
        return self.gusts is not None

    @property
    def controls_late_s(self) -> float:
        """How late the controls act by records whose clock is off: by how much they were moved, and
        what was left then; else 0.
        """
        left = [
            v for n, v in self.after.trajectory.point.nuisance.items() if n.startswith("lateness/")
        ]
        return self.late_s + float(np.mean(left or [0.0])) if self.late_s else 0.0


def find_effects(
    aircraft: Aircraft,
    setup: FlightData,
    extra: Sequence[Effect],
    work: Path,
    map_: Processes,
    say: Say,
    keep: Stages,
    put_right: tuple[float, ...] = (),
) -> Found:
    """Choose and estimate the missing effects on the train flights. ``work``: folder for staged
    copies of the aircraft; keep: what an earlier run had found; put_right: by how much the setup's
    controls act later than recorded, as found step by step."""
    names = tuple(aircraft.card.parameters)
    if not names:
        raise BadInputError(
            f"aircraft '{aircraft.name}': its airframe.toml lists no [parameters], so nothing says"
            " what may be re-identified first"
        )
    recorded, command_s = setup, setup.segments[0].command_s
    if put_right:
        setup = make_setup(
            aircraft, later(recorded.flights, sum(put_right)), recorded.positions, recorded.ideal
        )
    limits = {
        n: c.bounds if c.bounds is not None else (-np.inf, np.inf)
        for n, c in aircraft.card.parameters.items()
    }
    gusts = None
    with StagedModels(aircraft, setup) as bench:
        say("re-identifying the parameters")
        asked, again = names, len(put_right) or ""
        setup = given = with_jumps(setup, bench.model)
        before, names, excited, notes, noise = keep(
            f"parameters{again}",
            Base,
            lambda: base_fit_and_noise(aircraft, bench, given, asked, limits, map_),
        )
        setup = replace(setup, noise=noise)
        effects = candidates_for(setup, asked, extra)
        if turbulent(setup, before.trajectory):
            say(
                f"the air was turbulent: predicting one sample ahead, scoring {len(effects)}"
                " candidate effects"
            )
            gusty, at = setup_in_gusts(aircraft, setup), before.trajectory.point
            air = keep(
                f"air{again}",
                TurbulentFit,
                lambda: gust_refit(
                    bench.model, bench.direct_model, gusty, at, excited, limits, map_, tune=True
                ),
            )
            if air.gusts.air:
                setup, before, gusts, names = air.setup, air.fit, air.gusts, excited
            else:
                notes = [*notes, NO_AIR]
    if gusts is None:
        say(f"scoring {len(effects)} candidate effects")
        setup, before = as_quiet(setup, before)
    setup = limits_tried(setup, before, gusts)
    timed = [CONTROLS_LATE] if len(put_right) < MOST_CORRECTIONS and not setup.late else []
    columns = effect_columns(setup, before.probes, before.trajectory, [*effects, *timed])
    evidence = column_evidence(setup, before, columns, gusts)
    least_t, slips = 0.0 if gusts is None else GUST_LIMIT, slips_s(command_s, not put_right)
    late = _of_the_clock(setup, before, evidence, effects, slips, least_t) if timed else None
    if late is not None:
        say(f"all controls act {1e3 * late[0]:.1f} ms after their rows; putting the records right")
        found = find_effects(
            aircraft, recorded, extra, work, map_, say, keep, (*put_right, late[0])
        )
        if not put_right:
            found = replace(
                found, notes=(words(found.controls_late_s, late[1], command_s), *found.notes)
            )
        return found
    free = before.columns[0].names
    open_ = list(eligible(effects, setup, free, evidence))
    limit = (
        chance_limit(evidence, free, open_)
        if gusts is None
        else max(threshold(len(open_)), least_t)
    )
    merit = before.trajectory.cost if gusts is None else air.neg2_log_likelihood
    start = Start(
        aircraft,
        setup,
        before,
        names,
        {e.key: e for e in effects},
        limits,
        limit,
        map_,
        merit,
        gusts,
    )
    searched = search(start, evidence, work, say)
    if searched.best.keys:
        say("estimating everything by output error")
        searched = replace(searched, best=settled(start, searched.best, work / "settled"))
    found = _found(start, searched, evidence)
    board = score_table(evidence, free, [e for e in effects if e.key in open_])
    told = (*notes, *left_alone(asked, names), *found.notes)
    return replace(found, notes=told, late_s=sum(put_right), scoreboard=board)


def _found(start: Start, searched: Searched, evidence: Evidence) -> Found:
    """Everything estimated with the best model; evidence: without effects."""
    best, gusts, gusty = searched.best, searched.best.gusts, start.gusts is not None
    if best.keys:
        known = as_known_here(resolved(start, best), best)
        selection = with_resolution(known, start.effects, best.setup.segments[0].dt_s)
    else:
        selection = replace(
            best.again, chosen=(), refused=_not_borne_out(start, best.again) or best.again.refused
        )
    # A number that JSBSim reads once stands within its error of the one flown, and what goes with
    # it moves by that, too.
    parameters = in_one_step(
        best.evidence, start.names, best.fit, [*selection.values], moved=gusty or bool(best.held)
    )
    selection, slopes = of_lift_slope(selection, start.before, best.fit)
    open_ = eligible([*start.effects.values()], start.setup, best.free, best.evidence)
    plain = in_one_step(evidence, start.names, start.before, (), moved=gusty)
    notes, trail = searched.notes, searched.trail
    if gusts is not None:
        gain = f"{gusts.gain:.4g}" if gusts.gain < DIVERGED else "over a million"
        notes = (*notes, IN_TURBULENCE.format(gain, gusts.words))
        trail = tuple(f"one-step predictions: {line}" for line in trail)
    return Found(
        best.setup,
        start.names,
        start.before,
        best.fit,
        selection,
        start.effects,
        parameters,
        notes,
        {n: value for n, (value, _) in plain.items()},
        gusts,
        limit=start.limit,
        trail=trail,
        slopes=slopes,
        flown=best.flown,
        left=left_beside(best.evidence, start.free, [*selection.values], open_),
    )


def slips_s(command_s: float, first: bool) -> tuple[float, float]:
    """What is later, and what is earlier [s], than this is a slip of the record; in the first step,
    less is what every fit allows for, as an integration has it, and a simulator's flight acts up to
    half a step before its row. command_s: from one command to the next."""
    least = LEAST_LATE_ROWS * command_s
    return (max(least, PRIOR["lateness"]), UNKNOWN_ROWS * command_s) if first else (least, least)


def _of_the_clock(
    setup: FlightData,
    before: Linearisation,
    evidence: Evidence,
    effects: Sequence[Effect],
    slips: tuple[float, float],
    least_t: float,
) -> tuple[float, float] | None:
    """`controls_late` of the flights as they are with the controls at their rows, beside the
    effects that compete with it there; slips: `slips_s`; least_t: |t| asked at least."""
    held = {lateness(f): before.trajectory.point.nuisance[lateness(f)] for f in setup.timed}
    at_rows = evidence.taken_out(held)
    free = [n for n in before.columns[0].names if n not in held]
    odds = eligible(effects, setup, free, at_rows)
    return controls_late(at_rows, free, odds, max(threshold(len(odds) + 1), least_t), *slips)


def _not_borne_out(start: Start, first: Selection) -> Refusal | None:
    """The strongest effect chosen on the linearised flight that the simulation did not bear out."""
    if not first.chosen:
        return None
    c = first.chosen[0]
    # Gusts estimated beside it may explain what stood a little above the limit; not what was
    # overwhelming.
    strong = abs(c.t) > (start.limit + DIFFERENT if start.gusts is None else OVERWHELMING)
    if start.gusts is not None and not strong:
        return None
    return Refusal(
        c.key, c.t, c.gain, "flown in the simulation it does not lower the error by as much", strong
    )


def with_resolution(selection: Selection, effects: Mapping[str, Effect], dt_s: float) -> Selection:
    """Standard errors of times with what a replay resolves added: a servo's lag by Tustin's rule is
    off by part of a ms.
    """

    def widened(c: Choice) -> Choice:
        if effects[c.key].unit != "s":
            return c
        std = float(np.hypot(c.std, RESOLVED_ROWS * dt_s))
        return replace(c, std=std, t=c.value / std)

    return replace(selection, chosen=tuple(widened(c) for c in selection.chosen))


def chosen_interval(choice: Choice, limit: float) -> tuple[float, float]:
    """95 % interval of an effect, given that it was chosen at |t| above ``limit``; that t may be by
    a narrower standard error than the one told."""
    own = choice.t * choice.std
    narrower = abs(choice.value / own) if own else 1.0
    return conditional_interval(choice.value, choice.std, limit * narrower)


def left_beside(
    evidence: Evidence, free: Sequence[str], chosen: Sequence[str], odds: Iterable[str]
) -> tuple[tuple[str, float], ...]:
    """Candidates not chosen whose |t| beside the chosen is above CERTAIN_T: (key, t), the strongest
    first.
    """
    own = [n for n in free if not n.startswith("effect/")]
    rest = [k for k in odds if k not in chosen and k in evidence.names]
    t = np.nan_to_num(scores(evidence, [*own, *chosen], rest).t) if rest else np.zeros(0)
    order = np.argsort(-np.abs(t))
    return tuple((rest[i], float(t[i])) for i in order if abs(t[i]) > CERTAIN_T)


def score_table(
    evidence: Evidence, free: Sequence[str], effects: Sequence[Effect]
) -> tuple[tuple[str, float], ...]:
    """The twelve candidates with the largest gain, alone beside the parameters: (name, t)."""
    found = scores(evidence, free, [e.key for e in effects])
    order = np.argsort(-np.nan_to_num(found.gain, nan=-1.0))[:12]
    return tuple(
        (f"{effects[i].coefficient or effects[i].subsystem} {effects[i].term}", float(found.t[i]))
        for i in order
    )


def remark(
    choice: Choice, effect: Effect, flights: Sequence[str], command: str, limit: float
) -> str:
    """What stands beside the number in the XML; limit: |t| above which it was chosen."""
    low, high = chosen_interval(choice, limit)
    said = (
        f"{effect.name}: {choice.value:.5g} +/- {choice.std:.2g}, 95 % [{low:.5g}, {high:.5g}];"
        f" from {', '.join(flights)}"
    )
    return f"{said}; {command}" if command else said


def estimates_of(
    found: Found, flights: Sequence[str], initial: Mapping[str, float]
) -> dict[str, Estimate]:
    """New numbers of the re-identified parameters with their remarks."""
    return {
        n: Estimate(
            value, f"{value:.5g} +/- {std:.2g}, was {initial[n]:.5g}; refine; {', '.join(flights)}"
        )
        for n, (value, std) in found.parameters.items()
    }
