"""Where nothing of the catalogue explains what is left: a smooth term in one state, or times a second, offered for naming.

It is searched on the train flights' linearised likelihood beside everything that stands, written as a table into a copy of the
aircraft and flown on both sides as an effect is. It names nothing and changes no verdict.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.effects import (
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
from uqharness.refinement.beside import left_in
from uqharness.refinement.candidates import effect_columns
from uqharness.refinement.find import Found
from uqharness.refinement.fit import Fit, merged
from uqharness.refinement.hold_out import linearised
from uqharness.refinement.judge import Judged, Write, evidence_of, gap_change, sensed_by
from uqharness.refinement.rounds import column_evidence
from uqharness.refinement.setup import confirming_segments
from uqharness.refinement.showing.show import Shown, gap_document, show, with_replays
from uqharness.refinement.types import Array, Setup, Side
from uqharness.refinement.writing.tables import GRID, property_of_table, write_table
from uqharness.simulator import Aircraft

Z95 = 1.959963984540054
STATES = ("alpha", "beta", "p_hat", "q_hat", "r_hat", "de", "da", "dr", "CT", "V_rel")
UNNAMED = "unnamed"
"""Folder of the aircraft with the term, beside the refined one."""
EXPLAINED = "the catalogue leaves nothing that asks for one"
Inputs = dict[str, tuple[int, Array]]


@dataclass(frozen=True)
class Offer:
    """A smooth term: fit and model, the aircraft that flies it, and its part of refinement.json."""

    fit: SmoothFit
    aircraft: Aircraft
    document: dict[str, Any]


def offered(judged: Judged, write: Write, map_: Processes) -> Offer | str:
    """The term that explains most of what is left, flown on both sides, or why there is none.

    write: a model as an aircraft in a folder of its own
    """
    train, test = judged.sides
    about = _About(judged.found, judged.found.after)
    fits = [f for c in COEFFICIENTS for f in about.fits(about.terms(c))]
    best = max(fits, key=lambda f: f.merit, default=None)
    if best is None:
        return "no state varies on the train flights"
    done = _settled(about, best, train, write, map_) if best.stands_out(len(fits)) else None
    if done is None or left_in(train.setup, done.shown, about.found.gusty):
        # One state is not enough: every state times every other, in the coefficient that the best of one points to.
        twos = [f for times in STATES for f in about.fits(about.terms(best.term.coefficient, times))]
        fits += twos
        second = max(twos, key=lambda f: f.merit, default=best)
        if second.merit > best.merit and second.stands_out(len(fits)):
            other = _settled(about, second, train, write, map_)
            done = other if done is None or other.shown.surprise < done.shown.surprise else done
    if done is None:
        return f"no smooth term explains more than the best of the {len(fits)} tried does by chance"
    round_, aircraft, shown = done.round, done.aircraft, done.shown
    name = round_.fit.term.name
    if not shown.surprise < judged.train[2].surprise:
        return f"flown in the simulation, a {name} does not lower the error"
    there = show(aircraft, test.setup, test.measured, test.ideal, map_, sensed_by(round_.found), test.air)
    verdict = gap_change("smooth", judged.test[2], there, test.setup, shown)
    if verdict.says == "grew":
        return f"with a {name} the gap on the hold-out flights grew"
    gap = {}
    for key, (setup, _, before), side, after in (("train", judged.train, train, shown), ("test", judged.test, test, there)):
        if before.replays is not None:
            after = with_replays(after, aircraft, side.setup, side.measured, side.ideal, map_, sensed_by(round_.found))
        gap[key] = gap_document(setup, before, after)
    instead = [c.key for c in judged.found.selection.chosen if c.key in round_.instead]
    return Offer(
        round_.fit, aircraft,
        {
            **_term(round_), "in_place_of": [judged.found.effects[k].name for k in instead], "tried": len(fits),
            "p": min(1.0, done.searched.p * len(fits)), "twice_log_likelihood": done.searched.ratio,
            **_left_of(done, gap["train"]),
            "test": {
                "gap": verdict.says, "change_of_twice_log_likelihood": verdict.change, "std": verdict.std,
                "rms_over_that_of_train": verdict.far,
            },
            "gap": gap,
        },
    )  # fmt: skip


@dataclass(frozen=True)
class _Round:
    """A term estimated about a flight; found: everything else as it is beside the term; instead: keys of the effects in whose place
    it stands."""

    found: Found
    fit: SmoothFit
    instead: tuple[str, ...]


class _About:
    """A flight about which terms are estimated, that of ``found`` or, with its setup, another; before: the term in that flight."""

    def __init__(self, found: Found, fit: Fit, setup: Setup | None = None, before: _Round | None = None) -> None:
        self.found, self.fit, self.setup, self.before = found, fit, setup, before
        self.along = [p.variables() for p in fit.probes]
        self.every = {n: np.concatenate([v[n] for v in self.along]) for n in STATES}

    def evidence(self, make: Callable[[Mapping[str, Array]], Inputs]) -> tuple[Evidence, list[str]]:
        """Of everything and more columns, made from a segment's variables; and the names that are free beside those."""
        names = tuple(make(self.along[0]))
        more = MadeColumns(names, lambda k, _: Columns(names, make(self.along[k]), {}), len(self.along))
        chosen = {c.key: c.value for c in self.found.selection.chosen}
        if self.setup is None:
            evidence = evidence_of(self.found, self.found.gusts, (), more)
        else:
            effects = effect_columns(self.setup, self.fit.probes, self.fit.flown, [self.found.effects[k] for k in chosen])
            flown = {} if self.before is None else self.before.fit.flown
            evidence = column_evidence(self.setup, self.fit, merged(effects, more)).taken_out({**chosen, **flown})
        apart = {*self.found.effects, *names}
        return evidence, [*(n for n in evidence.names if n not in apart), *chosen]

    def fits(self, terms: Sequence[Smooth]) -> list[SmoothFit]:
        """Each of the terms alone."""
        return fit_smooth(*self.evidence(lambda v: _inputs(terms, v)), terms) if terms else []

    def terms(self, coefficient: str, times: str | None = None) -> list[Smooth]:
        """Of every state that varies."""
        made = (smooth_term(coefficient, s, times, self.every) for s in STATES if s != times)
        return [t for t in made if t is not None]

    def estimated(self, term: Smooth) -> _Round:
        """The term, smoothed with what coloured residuals leave of the information, and everything else beside it.

        Effects that are functions of the same states in the same coefficient are in the curve: beside it they would tell nothing.
        """
        given = [c.key for c in self.found.selection.chosen if _is_in(self.found.effects[c.key], term)]
        instead = (*given, *(self.before.instead if self.before else ()))
        evidence, free = self.evidence(term.inputs)
        free = [n for n in free if n not in instead]
        (fit,) = fit_smooth(evidence, free, [term])
        (fit,) = fit_smooth(
            evidence, free, [term], colour_dispersion(evidence, free, fit, _left(_smoothed(evidence, fit), free, fit))
        )
        chosen = [c for c in self.found.selection.chosen if c.key not in instead]
        found = corrected_each(_smoothed(evidence, fit), [*free, *fit.own], [*self.found.names, *(c.key for c in chosen)])
        at = self.fit.flown.point.values
        moved = tuple(replace(c, value=found[c.key][0], std=found[c.key][1]) for c in chosen)
        parameters = {n: (at[n] + found[n][0], found[n][1]) for n in self.found.names}
        selection = replace(self.found.selection, chosen=moved)
        return _Round(replace(self.found, parameters=parameters, selection=selection), fit, instead)


def _is_in(effect: Effect, term: Smooth) -> bool:
    """Whether a curve of the term's states can be what the effect is."""
    parsed = effect.parsed
    if parsed is None or effect.coefficient != term.coefficient:
        return False
    times = [f.text for f in parsed.factors if f.variable == term.times]
    return times == [term.times] * (term.times is not None) and {*parsed.variables} <= {term.state, term.times}


@dataclass(frozen=True)
class _Done:
    """A term as it flies: as it was found, about which flight it was estimated, the aircraft with it and with everything as it is
    beside it, and the train flights of that."""

    searched: SmoothFit
    about: _About
    round: _Round
    aircraft: Aircraft
    shown: Shown


def _inputs(terms: Sequence[Smooth], found: Mapping[str, Array]) -> Inputs:
    return {n: row for t in terms for n, row in t.inputs(found).items()}


def _smoothed(evidence: Evidence, fit: SmoothFit) -> Evidence:
    """The evidence with the smoothing as what is known of the term's columns beforehand."""
    prior = evidence.prior.copy()
    prior[evidence.index(fit.term.columns)] += fit.dispersion * fit.precision
    return replace(evidence, prior=prior)


def _left(evidence: Evidence, free: Sequence[str], fit: SmoothFit) -> list[Array]:
    """[(n, m)] whitened residuals with the free columns and the term fitted."""
    return evidence.residual(evidence.fitted(evidence.index([*free, *fit.own])))


def _settled(about: _About, fit: SmoothFit, train: Side, write: Write, map_: Processes) -> _Done:
    """A term flown, and estimated once more about the flight with it, which is nearer to what was measured."""
    done = _flown(about, fit, train, write, map_)
    if about.found.gusty or not np.isfinite(done.shown.cost):
        return done
    again = _flown(_beside(done, train, map_), fit, train, write, map_)
    return again if again.shown.cost < done.shown.cost else done


def _flown(about: _About, fit: SmoothFit, train: Side, write: Write, map_: Processes) -> _Done:
    round_ = about.estimated(fit.term)
    aircraft = write(round_.found)
    write_table(aircraft, round_.fit)
    shown = show(aircraft, train.setup, train.measured, train.ideal, map_, sensed_by(round_.found), train.air)
    return _Done(fit, about, round_, aircraft, shown)


def _beside(done: _Done, train: Side, map_: Processes) -> _About:
    """The flight with the term in it, linearised anew."""
    found = done.round.found
    setup, fit = linearised(found, done.aircraft, train, found.setup, done.shown.flown, map_)
    return _About(found, fit, setup, done.round)


def _term(round_: _Round) -> dict[str, Any]:
    """The term by itself."""
    fit, term = round_.fit, round_.fit.term
    return {
        "coefficient": term.coefficient, "state": term.state, "times": term.times, "name": term.name,
        "property": property_of_table(term), "unit": term.unit, "effective_degrees_of_freedom": fit.edf,
        "dispersion": fit.dispersion,
    }  # fmt: skip


def _left_of(done: _Done, gap: Mapping[str, Any]) -> dict[str, Any]:
    """The channel of which the term explains most, what it and the forms like it leave there, and its curve over the data.

    gap: G of the train flights without and with it
    """
    fit, term, about = done.round.fit, done.round.fit.term, done.about
    rows = gap["predictions"] or gap["channels"]
    ratio = {c: (r["rms_before"] / r["noise_rms"], r["rms_after"] / r["noise_rms"]) for c, r in rows.items()}
    channel = max(ratio, key=lambda c: ratio[c][0] - ratio[c][1])
    x = about.every[term.state]
    near, shapes = forms_like(fit, x, about.every[term.times] if term.times else np.ones_like(x)), known_forms(term.knots)

    def columns(v: Mapping[str, Array]) -> Inputs:
        k, by = COEFFICIENTS.index(term.coefficient), v[term.times] if term.times else 1.0
        return term.inputs(v) | {f"form/{n}": (k, shapes[n](v[term.state]) * by) for n, _ in near}

    evidence, free = about.evidence(columns)
    free = [n for n in free if n not in done.round.instead]

    def leaves(form: str) -> float:
        residual = evidence.residual(evidence.fitted(evidence.index([*free, form])))
        return rms(np.concatenate([r[:, list(ratio).index(channel)] for r in residual]))

    confirming = confirming_segments(about.found.setup)
    held_out = [held_out_gain(evidence, free, fit, part) for part in (~confirming, confirming)] if confirming.any() else []
    at = np.linspace(*term.ends, GRID)
    value, std = fit.curve(at)
    return {
        "confirmed_on_held_out_manoeuvres": min(held_out, default=None),
        "channel": channel, "channel_on_train": ratio[channel][0], "leaves": ratio[channel][1],
        "shapes": [{"form": n, "correlation": r, "leaves": leaves(f"form/{n}")} for n, r in near],
        "curve": {
            "at": at.tolist(), "value": value.tolist(), "low": (value - Z95 * std).tolist(), "high": (value + Z95 * std).tolist(),
            "samples": np.histogram(x, np.append(at - 0.5 * (at[1] - at[0]), np.inf))[0].tolist(),
        },
    }  # fmt: skip
