"""Where nothing of the catalogue explains what is left: a smooth term in one state, or times a
second, offered for naming.

It is searched on the train flights' linearised likelihood beside everything that stands, written as
a table into a copy of the aircraft and flown on both sides as an effect is. It names nothing and
changes no verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.effects import (
    COMPARABLE,
    DIFFERENT,
    OVERWHELMING,
    Choice,
    Columns,
    Effect,
    Evidence,
    MadeColumns,
    Smooth,
    SmoothFit,
    colour_dispersion,
    corrected_each,
    fit_smooth,
    forms_like,
    held_out_gain,
    known_forms,
    smooth_term,
)
from sysid.estimation import rms
from sysid.parallel import Processes
from uqharness.identification.linearised import FlightData, Linearisation, effect_columns, merged
from uqharness.refinement.evaluation import Shown, gap_document, left_in, show, with_replays
from uqharness.refinement.judge import (
    Judged,
    Write,
    evidence_of,
    gap_change,
    left_out,
    linearised,
    property_values,
    written_at,
)
from uqharness.refinement.round import Bent, Side, column_evidence
from uqharness.refinement.search import Found
from uqharness.refinement.write_xml import GRID, property_of_table, write_table
from uqharness.results.refinement import HoldOutTest, ResidualTables, SmoothTerm
from uqharness.simulator import Aircraft

# Smooth terms about a flight: estimated beside everything that stands there, in the place of
# effects that a curve can be.
#
# A chosen effect whose own state, in its own coefficient, still asks for a curve is not the
# form of what is missing.

STATES = ("alpha", "beta", "p_hat", "q_hat", "r_hat", "de", "da", "dr", "CT", "V_rel")
Inputs = dict[str, tuple[int, FloatArray]]


@dataclass(frozen=True)
class Estimated:
    """A term estimated about a flight; found: everything else as it is beside the term; instead:
    keys of the effects in whose place it stands."""

    found: Found
    fit: SmoothFit
    instead: tuple[str, ...]


class CurvesAbout:
    """A flight about which terms are estimated, that of ``found`` or, with its setup, another;
    before: the term in that flight.
    """

    def __init__(
        self,
        found: Found,
        fit: Linearisation,
        setup: FlightData | None = None,
        before: Estimated | None = None,
    ) -> None:
        self.found, self.fit, self.setup, self.before = found, fit, setup, before
        self.along = [p.variables() for p in fit.probes]
        self.every = {n: np.concatenate([v[n] for v in self.along]) for n in STATES}

    def evidence(
        self, make: Callable[[Mapping[str, FloatArray]], Inputs]
    ) -> tuple[Evidence, list[str]]:
        """Of everything and more columns, made from a segment's variables; and the names that are
        free beside those.
        """
        names = tuple(make(self.along[0]))
        more = MadeColumns(
            names, lambda k, _: Columns(names, make(self.along[k]), {}), len(self.along)
        )
        chosen = self.found.selection.values
        if self.setup is None:
            evidence = evidence_of(self.found, (), more)
        else:
            effects = effect_columns(
                self.setup,
                self.fit.probes,
                self.fit.trajectory,
                [self.found.effects[k] for k in chosen],
            )
            flown = {} if self.before is None else self.before.fit.flown
            evidence = column_evidence(self.setup, self.fit, merged(effects, more), None).taken_out(
                {**chosen, **flown}
            )
        apart = {*self.found.effects, *names}
        return evidence, [*(n for n in evidence.names if n not in apart), *chosen]

    def fits(self, terms: Sequence[Smooth]) -> list[SmoothFit]:
        """Each of the terms alone."""
        if not terms:
            return []
        return fit_smooth(
            *self.evidence(lambda v: {n: row for t in terms for n, row in t.inputs(v).items()}),
            terms,
        )

    def fitted(
        self, term: Smooth, instead: Sequence[str] = ()
    ) -> tuple[SmoothFit, Evidence, list[str]]:
        """The term beside everything but effects ``instead`` of which it stands, smoothed with what
        coloured residuals leave of the information; of what evidence, and the names that are free.
        """
        evidence, free = self.evidence(term.inputs)
        free = [n for n in free if n not in instead]
        (fit,) = fit_smooth(evidence, free, [term])
        smooth = smoothed(evidence, fit)
        dispersion = colour_dispersion(
            evidence, free, fit, smooth.residual(smooth.fitted(evidence.index([*free, *fit.own])))
        )
        return fit_smooth(evidence, free, [term], dispersion)[0], evidence, free

    def terms(self, coefficient: str, times: str | None = None) -> list[Smooth]:
        """Of every state that varies."""
        made = (smooth_term(coefficient, s, times, self.every) for s in STATES if s != times)
        return [t for t in made if t is not None]

    def estimated(self, term: Smooth) -> Estimated:
        """The term, smoothed with what coloured residuals leave of the information, and everything
        else beside it.

        Effects that are functions of the same states in the same coefficient are in the curve:
        beside it they would tell nothing."""
        given = [
            c.key for c in self.found.selection.chosen if is_in(self.found.effects[c.key], term)
        ]
        instead = (*given, *(self.before.instead if self.before else ()))
        fit, evidence, free = self.fitted(term, instead)
        chosen = [c for c in self.found.selection.chosen if c.key not in instead]
        found = corrected_each(
            smoothed(evidence, fit),
            [*free, *fit.own],
            [*self.found.names, *(c.key for c in chosen)],
        )
        at = self.fit.trajectory.point.values
        moved = tuple(replace(c, value=found[c.key][0], std=found[c.key][1]) for c in chosen)
        parameters = {n: (at[n] + found[n][0], found[n][1]) for n in self.found.names}
        selection = replace(self.found.selection, chosen=moved)
        return Estimated(
            replace(self.found, parameters=parameters, selection=selection), fit, instead
        )


def is_in(effect: Effect, term: Smooth) -> bool:
    """Whether a curve of the term's states can be what the effect is."""
    parsed = effect.parsed
    if parsed is None or effect.coefficient != term.coefficient:
        return False
    times = [f.text for f in parsed.factors if f.variable == term.times]
    return times == [term.times] * (term.times is not None) and {*parsed.variables} <= {
        term.state,
        term.times,
    }


def smoothed(evidence: Evidence, fit: SmoothFit) -> Evidence:
    """The evidence with the smoothing as what is known of the term's columns beforehand."""
    prior = evidence.prior.copy()
    prior[evidence.index(fit.term.columns)] += fit.dispersion * fit.precision
    return replace(evidence, prior=prior)


def bent(found: Found) -> tuple[Bent, tuple[Choice, ...]] | None:
    """The curve in a chosen effect's own states and coefficient that stands out most beside all
    that was chosen, and the other effects as they are with it in the place of those that it can be;
    None where none stands out: the forms chosen are enough."""
    about = CurvesAbout(found, found.after)
    terms = _own_terms(found, about)
    fits = [about.fitted(f.term)[0] for f in about.fits(terms) if f.stands_out(len(terms))]
    best = max((f for f in fits if f.stands_out(len(terms))), key=lambda f: f.merit, default=None)
    if best is None:
        return None
    term, done = best.term, about.estimated(best.term)
    beside = tuple(replace(c, t=c.value / c.std) for c in done.found.selection.chosen)
    states = (term.state, *((term.times,) if term.times else ()))
    return Bent(
        term.coefficient, states, term.name, best.ratio, best.p * len(terms), done.instead
    ), beside


def _own_terms(found: Found, about: CurvesAbout) -> list[Smooth]:
    """Curves that chosen effects can be, each in a state of its own; of an effect of two states: in
    one, times the other.
    """
    asked: dict[tuple[str, str, str | None], None] = {}
    for c in found.selection.chosen:
        effect = found.effects[c.key]
        states = () if effect.parsed is None else effect.parsed.variables
        if effect.coefficient is None or len(states) > 2 or not {*states} <= {*STATES}:
            continue
        for state in states:
            asked[effect.coefficient, state, next((s for s in states if s != state), None)] = None
    made = [
        smooth_term(coefficient, state, times, about.every) for coefficient, state, times in asked
    ]
    own = [found.effects[c.key] for c in found.selection.chosen]
    return [t for t in made if t is not None and any(is_in(e, t) for e in own)]


Z95 = 1.959963984540054
UNNAMED = "unnamed"
"""Folder of the aircraft with the term, beside the refined one."""
EXPLAINED = "the catalogue leaves nothing that asks for one"


def offered(judged: Judged, write: Write, map_: Processes) -> tuple[Aircraft, SmoothTerm] | str:
    """The aircraft that flies the smooth term that explains most of what is left, and the term's
    part of refinement.json; or why there is none. write: a model as an aircraft in a folder of its
    own."""
    train, test = judged.sides
    about = CurvesAbout(judged.found, judged.found.after)
    fits = [f for c in COEFFICIENTS for f in about.fits(about.terms(c))]
    best = max(fits, key=lambda f: f.merit, default=None)
    if best is None:
        return "no state varies on the train flights"
    done = _settled(about, best, train, write, map_) if best.stands_out(len(fits)) else None
    if done is None or left_in(train.setup, done.shown, about.found.gusty):
        # One state is not enough: every state times every other, in the coefficient that the best
        # of one points to.
        twos = [
            f for times in STATES for f in about.fits(about.terms(best.term.coefficient, times))
        ]
        fits += twos
        second = max(twos, key=lambda f: f.merit, default=best)
        if second.merit > best.merit and second.stands_out(len(fits)):
            other = _settled(about, second, train, write, map_)
            done = min(
                (d for d in (done, other) if d is not None),
                key=lambda d: d.shown.surprise,
                default=None,
            )
    if done is None:
        return f"no smooth term explains more than the best of the {len(fits)} tried does by chance"
    round_, aircraft, shown = done.round, done.aircraft, done.shown
    fit, term = round_.fit, round_.fit.term
    name = term.name
    if not shown.surprise < judged.train[2].surprise:
        return f"flown in the simulation, a {name} does not lower the error"
    there = show(aircraft, test, map_, written_at(round_.found, near=judged.test[2].flown.point))
    verdict = gap_change(judged.test[2], there, test.setup, shown)
    if verdict.says == "grew":
        return f"with a {name} the gap on the hold-out flights grew"
    gap = {}
    for key, (setup, _, before), side, after in (
        ("train", judged.train, train, shown),
        ("test", judged.test, test, there),
    ):
        if before.replays is not None:
            after = with_replays(after, aircraft, side, map_, written_at(round_.found))
        gap[key] = gap_document(setup, before, after)
    instead = [k for k in judged.found.selection.values if k in round_.instead]
    return aircraft, SmoothTerm(
        coefficient=term.coefficient,
        state=term.state,
        times=term.times,
        name=name,
        property=property_of_table(term),
        unit=term.unit,
        effective_degrees_of_freedom=float(fit.edf),
        dispersion=fit.dispersion,
        in_place_of=[judged.found.effects[k].name for k in instead],
        tried=len(fits),
        p=min(1.0, done.searched.p * len(fits)),
        twice_log_likelihood=done.searched.ratio,
        **_left_of(done, gap["train"]),
        test=HoldOutTest(
            gap=verdict.says,
            change_of_twice_log_likelihood=verdict.change,
            std=verdict.std,
            rms_over_that_of_train=verdict.far,
        ),
        gap=gap,
    )


@dataclass(frozen=True)
class _Done:
    """A term as it flies: as it was found, about which flight it was estimated, the aircraft with
    it and with everything as it is beside it, and the train flights of that."""

    searched: SmoothFit
    about: CurvesAbout
    round: Estimated
    aircraft: Aircraft
    shown: Shown


def _settled(
    about: CurvesAbout, fit: SmoothFit, train: Side, write: Write, map_: Processes
) -> _Done | None:
    """A term flown, and estimated once more about the flight with it, which is nearer to what was
    measured; None as `_flown`.
    """
    done = _flown(about, fit, train, write, map_)
    if done is None or about.found.gusty or not np.isfinite(done.shown.cost):
        return done
    found = done.round.found
    setup, flown = linearised(found, done.aircraft, train, found.setup, done.shown.flown, map_)
    again = _flown(CurvesAbout(found, flown, setup, done.round), fit, train, write, map_)
    return again if again is not None and again.shown.cost < done.shown.cost else done


def _flown(
    about: CurvesAbout, fit: SmoothFit, train: Side, write: Write, map_: Processes
) -> _Done | None:
    """The term as it flies; None where the flight that it is estimated about is so far off that its
    estimates are no numbers.
    """
    round_ = about.estimated(fit.term)
    estimates = [
        *round_.fit.values,
        *(value for value, _ in round_.found.parameters.values()),
        *round_.found.selection.values.values(),
    ]
    if not np.isfinite(estimates).all():
        return None
    aircraft = write(round_.found)
    write_table(aircraft, round_.fit)
    shown = show(
        aircraft, train, map_, written_at(round_.found, near=round_.found.after.trajectory.point)
    )
    return _Done(fit, about, round_, aircraft, shown)


def _left_of(done: _Done, gap: ResidualTables) -> dict[str, Any]:
    """The channel of which the term explains most, what it and the forms like it leave there, and
    its curve over the data. gap: G of the train flights without and with it."""
    fit, term, about = done.round.fit, done.round.fit.term, done.about
    ratio = {
        c: (r.rms_before / r.noise_rms, r.rms_after / r.noise_rms)
        for c, r in (gap.predictions or gap.channels).items()
        if r.rms_before is not None and r.rms_after is not None and r.noise_rms
    }
    channel = max(ratio, key=lambda c: ratio[c][0] - ratio[c][1])
    x = about.every[term.state]
    near, shapes = (
        forms_like(fit, x, about.every[term.times] if term.times else np.ones_like(x)),
        known_forms(term.knots),
    )

    def columns(v: Mapping[str, FloatArray]) -> Inputs:
        k, by = COEFFICIENTS.index(term.coefficient), v[term.times] if term.times else 1.0
        return term.inputs(v) | {f"form/{n}": (k, shapes[n](v[term.state]) * by) for n, _ in near}

    evidence, free = about.evidence(columns)
    free = [n for n in free if n not in done.round.instead]

    def leaves(form: str) -> float:
        residual = evidence.residual(evidence.fitted(evidence.index([*free, form])))
        return float(
            rms(np.concatenate([r[:, list(gap.channels).index(channel)] for r in residual]))
        )

    confirming = evidence.confirming
    held_out = (
        []
        if confirming is None
        else [held_out_gain(evidence, free, fit, part) for part in (~confirming, confirming)]
    )
    at = np.linspace(*term.ends, GRID)
    value, std = fit.curve(at)
    return {
        "confirmed_on_held_out_manoeuvres": min(held_out, default=None),
        "channel": channel,
        "channel_on_train": ratio[channel][0],
        "leaves": ratio[channel][1],
        "shapes": [{"form": n, "correlation": r, "leaves": leaves(f"form/{n}")} for n, r in near],
        "curve": {
            "at": at.tolist(),
            "value": value.tolist(),
            "low": (value - Z95 * std).tolist(),
            "high": (value + Z95 * std).tolist(),
            "samples": np.histogram(x, np.append(at - 0.5 * (at[1] - at[0]), np.inf))[0].tolist(),
        },
    }


# Effects too weak to be named beside something that nothing explains.
#
# What is unexplained goes with many candidates a little, so that limits for chance no longer
# hold: an effect is then named where it is strong, or nearly as strong as the strongest. Train
# flights alone decide.


def too_weak(chosen: Sequence[Choice], limit: float) -> tuple[Choice, ...]:
    """Those that would not be named beside something unexplained; limit: |t| asked of any. |t| is
    by the standard error that is told, which may be wider than what chose them."""
    t = [abs(c.value / c.std) for c in chosen]
    asked = max(min(COMPARABLE * max(t, default=0.0), OVERWHELMING), limit + DIFFERENT)
    return tuple(c for c, own in zip(chosen, t, strict=True) if not own >= asked)


def named_beside(found: Found, train: Side, whole: Aircraft, map_: Processes) -> Found:
    """The same, everything estimated again without what is too weak, if the model with all of it
    leaves the train flights unexplained: by what is left of them, or by a curve that the forms
    chosen are not (`curves.bent`), beside which the others are judged. whole: the aircraft with all
    of it."""
    chosen, curve = found.selection.chosen, bent(found)
    if curve is None:
        weak = too_weak(chosen, found.limit)
        at = written_at(found, property_values(found, found), found.after.trajectory.point)
        if weak and not left_in(train.setup, show(whole, train, map_, at), found.gusty):
            return found
    else:
        form, others = curve
        found = replace(found, bent=form)
        part = [c for c in chosen if c.key in form.instead]
        asked = {c.key for c in too_weak([*part, *others], found.limit)}
        weak = tuple(c for c in chosen if c.key in asked)
    if not weak:
        return found
    rest = left_out(found, evidence_of(found), [c.key for c in weak])
    lines = [f"too weak beside what is unexplained: - {c.key} t {c.t:.1f}" for c in weak]
    return replace(rest, unnamed=weak, trail=(*found.trail, *lines))
