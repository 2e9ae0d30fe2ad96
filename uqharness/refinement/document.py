"""Contents of refinement.json: verdict, effects, disagreements and remaining residuals.

They follow from a search and its hold-out test; nothing is simulated here.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.display import rows_table, view
from sysid.effects import Alternative, Effect, RejectedCandidate, SelectedEffect, tuned
from sysid.estimation import NOISE_FLOOR
from uqharness.identification.linearised import FlightData
from uqharness.refinement.evaluation import Evaluation, excess_residuals, residual_tables
from uqharness.refinement.hold_out import HoldOutResult, Verdict
from uqharness.refinement.residual_location import (
    NO_RESIDUAL,
    dependence,
    disagreements,
    label,
    no_place,
    place_of,
    states_along,
)
from uqharness.refinement.search_result import FormMismatch, SearchResult, chosen_interval
from uqharness.refinement.sentences import (
    reason_for,
    separating_manoeuvre,
    still_significant,
    too_weak_to_name,
    withdrawal_reason,
)
from uqharness.refinement.servos import is_fastest
from uqharness.refinement.write_xml import switch_of
from uqharness.results.refinement import Alternative as AlternativeDocument
from uqharness.results.refinement import (
    AlternativeEvidence,
    Candidates,
    Gaps,
    HoldOutTest,
    Identified,
    NearbyCandidate,
    Refinement,
    RefusedCandidate,
    Region,
    Remaining,
    RemainingPart,
    ResidualLocation,
    Score,
    State,
    Switch,
    Timing,
    Withdrawn,
)
from uqharness.results.refinement import Effect as EffectDocument
from uqharness.results.refinement import Evidence as EvidenceDocument
from uqharness.simulator import Actuator, Aircraft

MAX_DESCRIBED = 3
"""Significant candidates that the text describes; the others are in `remaining.where` only."""
_AXES = (("p_radps", "Cl", "roll"), ("q_radps", "Cm", "pitch"), ("r_radps", "Cn", "yaw"))


def find_disagreements(
    data: FlightData, evaluation: Evaluation, reference: Evaluation, controls: Sequence[Any]
) -> list[Region]:
    """Return regions in which an evaluation exceeds what noise explains.

    Held commands and gusts leave more than noise in coefficients. If the ``reference`` evaluation
    is at the noise in the channels, its residuals in coefficients are allowed as well.
    """
    kinds = [s.kind for s in data.segments]
    allowed = [reference.floor] * len(kinds)
    if all(
        reference.channel_rms(k) <= NOISE_FLOOR * float(reference.noise[k])
        for k in range(len(data.outputs))
    ):
        pairs = list(zip(kinds, reference.coefficients, strict=True))
        by_kind = {kind: np.concatenate([g for k, g in pairs if k == kind]) for kind in kinds}
        allowed = [
            np.maximum(reference.floor, np.sqrt(np.mean(by_kind[kind] ** 2, axis=0)))
            for kind in kinds
        ]
    each_row = [
        np.broadcast_to(a, g.shape) for a, g in zip(allowed, evaluation.coefficients, strict=True)
    ]
    return disagreements(
        evaluation.coefficients,
        each_row,
        _ranges(evaluation, controls),
        kinds,
        data.segments[0].dt_s,
    )


def _ranges(evaluation: Evaluation, controls: Sequence[Any]) -> list[dict[str, Any]]:
    """Return the states in which regions are searched, one mapping per segment; rates by
    magnitude.
    """
    rates = {rate: f"abs_{rate}" for rate, _, _ in _AXES}
    segments = states_along(evaluation.trajectory, controls)
    return [
        {rates.get(n, n): np.abs(v) if n in rates else v for n, v in states.items()}
        for states in segments
    ]


def _remaining(chosen: SearchResult, hold_out: HoldOutResult, controls: Sequence[Any]) -> Remaining:
    """Return whether residuals exceed noise, where, and on what they depend."""
    result, data, after = hold_out.result, hold_out.train.data, hold_out.train.after
    effects, mismatch, refused = chosen.effects, chosen.mismatch, result.selection.refused
    mismatched_keys = () if mismatch is None else mismatch.replaced
    # Evidence that the model lacks something: residuals on the training flights, a strong candidate
    # that no simulation confirmed, a curve, other strong candidates. An effect that the training
    # flights support and the hold-out flights contradict is an unnamed disagreement, unless chance
    # explains it or another effect remains.
    excess = excess_residuals(data, after, result.estimator)
    strong = [refused] if refused is not None and refused.strong else []
    contradicted = [
        c for c in hold_out.withdrawn if abs(c.t) > chosen.critical_t + tuned.SIGNIFICANT_Z
    ]
    reported = {c.key for c in (*contradicted, *chosen.unclear, *chosen.selection.chosen)}
    candidates = [(key, t) for key, t in chosen.strong_candidates if key not in reported]
    contradicts = bool(contradicted) and not result.selection.chosen
    unexplained = any((excess, strong, contradicts, candidates, mismatch is not None))
    # Moments that only noise explains are air: a missing effect has a score, a curve or residuals.
    moments = unexplained_moments(chosen)
    # In words.
    where = [_unconfirmed(effects[r.key], r) for r in strong]
    where += _disagreeing(data, after, controls) if excess else []
    for c in contradicted:
        reason = withdrawal_reason(effects[c.key], c, hold_out.verdicts[c.key].gap)
        where.append(_part(effects[c.key], c.t, reason))
    if mismatch is not None:
        where.append(_wrong_form(mismatch, [effects[k] for k in mismatched_keys]))
    where += [
        _part(effects[c.key], c.t, too_weak_to_name(effects[c.key], c)) for c in chosen.unclear
    ]
    where += [_still_significant(effects[key], t, k) for k, (key, t) in enumerate(candidates)]
    where += moments.values()
    # Where the strongest of it is.
    test_excess = excess_residuals(hold_out.test.data, hold_out.test.after, result.estimator)
    channels = {
        "train": [*excess.above, *excess.coloured, *moments],
        "test": [*test_excess.above, *test_excess.coloured],
    }
    if unexplained or any(channels.values()):
        keys = [
            *(key for key, _ in candidates),
            *(r.key for r in strong),
            *(c.key for c in (*chosen.unclear, *hold_out.withdrawn)),
            *mismatched_keys,
        ]
        place = place_of(hold_out, channels, keys, controls)
    else:
        place = ResidualLocation(**no_place(NO_RESIDUAL))
    nearby = strong_unreported(place.candidates, {*reported, *(key for key, _ in candidates)})
    where += [
        _still_significant(effects[key], t, len(candidates) + k)
        for k, (key, t) in enumerate(nearby)
    ]
    return Remaining(
        unexplained=unexplained,
        where=where,
        channels_above_noise={**excess.above},
        coloured_channels=list(excess.coloured),
        place=place,
    )


def _disagreeing(
    data: FlightData, evaluation: Evaluation, controls: Sequence[Any]
) -> list[RemainingPart]:
    """Return regions in which coefficients disagree, then coefficients above their noise with the
    states on which they depend.
    """
    regions = find_disagreements(data, evaluation, evaluation, controls)
    out = [RemainingPart(**region.as_json()) for region in regions]
    states = _ranges(evaluation, controls)
    for k, c in enumerate(COEFFICIENTS):
        ratio = evaluation.coefficient_rms(k) / float(evaluation.floor[k])
        if ratio > NOISE_FLOOR:
            depends = [
                State(state=n, share=s)
                for n, s in dependence([g[:, k] for g in evaluation.coefficients], states)
            ]
            out.append(RemainingPart(coefficient=c, rms_over_noise=ratio, depends_on=depends))
    return out


def _unconfirmed(effect: Effect, refused: RejectedCandidate) -> RemainingPart:
    """Describe where the residual is and on what it depends, from the nearest unconfirmed
    candidate.
    """
    term = effect.parsed
    depends = [] if term is None else [State(state=v) for v in term.variables]
    words = (
        f"an effect is missing in {effect.coefficient or effect.subsystem} that depends on "
        f"{', '.join(d.state for d in depends) or effect.term}; the nearest candidate is "
        f"{effect.name} (|t| {abs(refused.t):.1f}), but {refused.reason}"
    )
    return RemainingPart(**label(effect), depends_on=depends, t=refused.t, words=words)


def document_of(
    chosen: SearchResult, hold_out: HoldOutResult, aircraft: Aircraft, controls: Sequence[Any]
) -> Refinement:
    """Return the part of refinement.json that flights and models determine.

    Parameters
    ----------
    chosen : SearchResult
        The selection on the training flights.
    hold_out : HoldOutResult
        What remains after the hold-out test.
    aircraft : Aircraft
        The original aircraft.
    controls : sequence of array
        Control positions of every training segment.
    """
    result, data, train, test = hold_out.result, hold_out.train.data, hold_out.train, hold_out.test
    switches = {c.key: switch_of(chosen.effects[c.key], aircraft) for c in chosen.selection.chosen}
    # Effects that the hold-out flights support, and those that they withdrew.
    effects = [
        EffectDocument(**_effect(result, c, hold_out.verdicts[c.key], switches))
        for c in result.selection.chosen
    ]
    withdrawn = [
        Withdrawn(**_effect(chosen, c, hold_out.verdicts[c.key], switches, withdrawn=True))
        for c in hold_out.withdrawn
    ]
    # What remains decides the verdict: effects do not count while something is unexplained.
    remaining = _remaining(chosen, hold_out, controls)
    refused = result.selection.refused
    return Refinement(
        verdict=(
            "unexplained"
            if remaining.unexplained
            else "effects-found"
            if effects
            else "no-missing-effect"
        ),
        disagreement=find_disagreements(data, train.before, train.after, controls),
        effects=effects,
        withdrawn=withdrawn,
        chosen=[
            EffectDocument(**_effect(chosen, c, None, switches)) for c in chosen.selection.chosen
        ],
        remaining=remaining,
        gap=Gaps(
            train=residual_tables(data, train.before, train.after),
            test=residual_tables(test.data, test.before, test.after),
        ),
        switch=[
            Switch(property=s[0], off=s[1])
            for c in result.selection.chosen
            if (s := switches[c.key]) is not None
        ],
        parameters={n: Identified(value=v, std=s) for n, (v, s) in result.parameters.items()},
        best_refused=(
            None
            if refused is None
            else RefusedCandidate(
                effect=refused.key.removeprefix("effect/"), t=refused.t, why=refused.reason
            )
        ),
        candidates=Candidates(
            limit=result.critical_t,
            scores=[Score(effect=name, t=t) for name, t in result.scoreboard],
        ),
        timing=Timing(controls_late_s=result.controls_late_s),
        trail=list(result.trail),
        notes=[*result.notes, *(n for f in data.flights for n in f.notes)],
    )


def unexplained_moments(chosen: SearchResult) -> dict[str, RemainingPart]:
    """Return, by angular rate, reports of moments that the gust model does not describe."""
    parts = {}
    gains = chosen.estimator.unexplained_moments()
    for rate, c, axis in _AXES:
        if rate in gains and rate in chosen.data.outputs:
            gain = gains[rate]
            words = (
                f"moments about the {axis} axis that the gust model does not describe: including"
                f" them gains {gain:.0f} in twice the log likelihood"
            )
            parts[rate] = RemainingPart(coefficient=c, twice_log_likelihood=gain, words=words)
    return parts


def _wrong_form(form: FormMismatch, effects: Sequence[Effect]) -> RemainingPart:
    """Describe a curve in the states of effects whose form is not that of the missing one."""
    words = (
        f"the residual in {form.coefficient} does not have the form of"
        f" {' and '.join(e.name for e in effects)}: an additional"
        f" {form.name} gains {form.gain:.0f} in twice the log likelihood"
    )
    return RemainingPart(
        coefficient=form.coefficient,
        depends_on=[State(state=s) for s in form.states],
        twice_log_likelihood=form.gain,
        p=form.p,
        words=words,
    )


def strong_unreported(
    candidates: Sequence[NearbyCandidate], reported: Collection[str]
) -> list[tuple[str, float]]:
    """Return (key, t) of candidates with |t| above CERTAIN_T that are not reported yet, the
    strongest first.

    A withdrawn effect may have taken their place.
    """
    keys = [f"effect/{c.coefficient or c.subsystem}/{c.term}" for c in candidates]
    return [
        (k, c.t)
        for k, c in zip(keys, candidates, strict=True)
        if abs(c.t) > tuned.CERTAIN_T and k not in reported
    ]


def _still_significant(effect: Effect, t: float, rank: int) -> RemainingPart:
    """Describe a candidate that the flights still support."""
    return (
        _part(effect, t, still_significant(effect, t))
        if rank < MAX_DESCRIBED
        else RemainingPart(**label(effect), t=t)
    )


def _part(effect: Effect, t: float, words: str) -> RemainingPart:
    """Return an entry of ``remaining`` for an effect."""
    return RemainingPart(**label(effect), t=t, words=words)


def _effect(
    result: SearchResult,
    c: SelectedEffect,
    verdict: Verdict | None,
    switches: Mapping[str, tuple[str, float] | None],
    withdrawn: bool = False,
) -> dict[str, Any]:
    """Return the document of one effect, with the verdict of the hold-out flights."""
    e, switch = result.effects[c.key], switches[c.key]
    value, std, unit = _as_written(result, e, c)
    test = verdict and {
        "withdrawn": withdrawn,
        "test": HoldOutTest(
            change_of_twice_log_likelihood=verdict.change,
            std=verdict.std,
            gap=verdict.gap,
            rms_over_that_of_train=verdict.residual_ratio,
            share_of_estimate=verdict.share[0],
            share_std=verdict.share[1],
        ),
    }
    return {
        **label(e),
        "name": e.name,
        "why": reason_for(e, c),
        "value": value,
        "std": std,
        "unit": unit,
        "property": None if switch is None else switch[0],
        "evidence": EvidenceDocument(
            t=c.t,
            twice_log_likelihood=c.gain,
            confirmed_on_held_out_manoeuvres=c.confirmed_gain,
            held_out_estimate_differs_by_std=c.difference,
            interval_95=_interval(result, e, c),
        ),
        **(test or {}),
        "alternatives": [_alternative(result, e, a) for a in c.alternatives],
    }


def _interval(result: SearchResult, e: Effect, c: SelectedEffect) -> list[float | None]:
    """Return the 95 % interval of the number in the XML, conditional on its selection.

    It is open above where a servo is never commanded faster than its rate limit.
    """
    low, high = chosen_interval(c, result.critical_t)
    ends = sorted(_as_written(result, e, replace(c, value=v))[0] for v in (low, high))
    return [ends[0], None if e.term == "rate_limit" and is_fastest(c, result.data) else ends[1]]


def _as_written(result: SearchResult, e: Effect, c: SelectedEffect) -> tuple[float, float, str]:
    """Return value, standard error and unit of the number in the XML: a lag is in 1/s, a rate limit
    in deg/s.
    """
    surface = (e.subsystem or "").partition(".")[2]
    servo = result.data.servos.get(surface)
    if e.term == "lag" and servo is not None:
        rate = servo.lag_with(c.value)
        return rate, rate**2 * c.std, "1/s"
    if e.term == "rate_limit":
        limit = (servo or Actuator(None)).slowed_to(c.value)
        return limit, limit**2 * c.std, "deg/s"
    return c.value, c.std, e.unit


def _alternative(result: SearchResult, effect: Effect, a: Alternative) -> AlternativeDocument:
    """Return the document of an alternative."""
    other = result.effects[a.key]
    advice = {} if a.separable else {"would_separate": separating_manoeuvre(effect, other)}
    return AlternativeDocument(
        **label(other),
        name=other.name,
        evidence=AlternativeEvidence(
            twice_log_likelihood=a.gain,
            t_of_the_effect_beside_it=a.t_beside,
            likeness=a.likeness,
            companions=[c.removeprefix("effect/") for c in a.companions],
        ),
        separable=a.separable,
        **advice,
    )


# What a notebook shows of a refinement, from its document.


def refinement_view(title: str, document: Refinement) -> str:
    """Return the text for the terminal: verdict, effects, and each channel's residual on the
    hold-out flights.
    """
    effects = [
        {
            "effect": e.name,
            "property": e.property or "",
            "estimate": math.nan if e.value is None else e.value,
            "std": math.nan if e.std is None else e.std,
            "unit": e.unit,
        }
        for e in document.effects
    ]
    gaps = [
        {
            "channel": name,
            "before [sigma]": _ratio(row.rms_before, row.noise_rms),
            "after [sigma]": _ratio(row.rms_after, row.noise_rms),
        }
        for name, row in document.gap.test.channels.items()
    ]
    residual = "<p>Residual on the hold-out flights</p>"
    return view(
        title,
        rows_table(effects),
        residual,
        rows_table(gaps),
        facts={"verdict": document.verdict},
    )


def _ratio(rms: float | None, noise: float | None) -> float:
    """Return a residual over its noise; NaN without noise."""
    return math.nan if rms is None or not noise else rms / noise
