"""refinement.json from what a refinement found: verdict, effects, disagreement, what is left. Flies nothing."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.effects import CERTAIN_T, DIFFERENT, Alternative, Choice, Effect, Refusal
from sysid.estimation import NOISE_FLOOR
from uqharness.identification.linearised import Setup
from uqharness.refinement.find import Found, chosen_interval
from uqharness.refinement.judge import Judged, Verdict
from uqharness.refinement.rates import is_fastest
from uqharness.refinement.showing.disagreement import disagreements
from uqharness.refinement.showing.remains import NOTHING, label, no_place, place_of, states_along
from uqharness.refinement.showing.scan import dependence
from uqharness.refinement.showing.show import Shown, gap_document, left_in
from uqharness.refinement.showing.words import (
    contradicted,
    separating_manoeuvre,
    still_asked,
    unnamed,
    why,
)
from uqharness.refinement.types import Bent
from uqharness.refinement.writing.effects import switch_of
from uqharness.simulator import Actuator, Aircraft

MOST_SAID = 3
"""Candidates still asked for that are told in words; the others stand in `remaining.where` alone."""
_AXES = (("p_radps", "Cl", "roll"), ("q_radps", "Cm", "pitch"), ("r_radps", "Cn", "yaw"))


def find_disagreements(
    setup: Setup, shown: Shown, settled: Shown, controls: Sequence[Any]
) -> list[dict[str, Any]]:
    """Where ``shown`` lies outside what noise gives. A model that is at the noise in flight leaves more than that in coefficients,
    because held commands and gusts have their share there; then what it leaves is what is allowed."""
    kinds = [s.kind for s in setup.segments]
    allowed = [settled.floor] * len(kinds)
    if all(
        settled.channel_rms(k) <= NOISE_FLOOR * float(settled.noise[k])
        for k in range(len(setup.outputs))
    ):
        pairs = list(zip(kinds, settled.coefficients, strict=True))
        together = {kind: np.concatenate([g for k, g in pairs if k == kind]) for kind in kinds}
        allowed = [
            np.maximum(settled.floor, np.sqrt(np.mean(together[kind] ** 2, axis=0)))
            for kind in kinds
        ]
    each_row = [
        np.broadcast_to(a, g.shape) for a, g in zip(allowed, shown.coefficients, strict=True)
    ]
    return disagreements(
        shown.coefficients, each_row, _ranges(shown, controls), kinds, setup.segments[0].dt_s
    )


def _ranges(shown: Shown, controls: Sequence[Any]) -> list[dict[str, Any]]:
    """States in which regions are looked for, one mapping a segment: rates by their size."""
    rates = {rate: f"abs_{rate}" for rate, _, _ in _AXES}
    along = states_along(shown.flown, controls)
    return [
        {rates.get(n, n): np.abs(v) if n in rates else v for n, v in states.items()}
        for states in along
    ]


def _remaining(chosen: Found, judged: Judged, controls: Sequence[Any]) -> dict[str, Any]:
    """Whether anything is left that noise does not explain, where, and on what it depends."""
    found, (setup, _, after), (other, _, fitted) = judged.found, judged.train, judged.test
    left, held_out = left_in(setup, after, found.gusty), left_in(other, fitted, found.gusty)
    effects, refused, moments = chosen.effects, found.selection.refused, moments_of(chosen)
    strong = [refused] if refused is not None and refused.strong else []
    # What the train flights ask for and the test flights speak against is a disagreement without a name, unless chance asked.
    against = [c for c in judged.withdrawn if abs(c.t) > chosen.limit + DIFFERENT]
    told = {c.key for c in (*against, *chosen.unnamed, *chosen.selection.chosen)}
    more = [(key, t) for key, t in chosen.left if key not in told]
    bent = [] if chosen.bent is None else [chosen.bent]
    where = [_unconfirmed(found.effects[r.key], r) for r in strong]
    where += _disagreeing(setup, after, controls) if left else []
    where += [
        _told(effects[c.key], c.t, contradicted(effects[c.key], c, judged.verdicts[c.key].says))
        for c in against
    ]
    where += [_bent(b, [effects[k] for k in b.instead]) for b in bent]
    where += [_told(effects[c.key], c.t, unnamed(effects[c.key], c)) for c in chosen.unnamed]
    where += [_still_asked(effects[key], t, k) for k, (key, t) in enumerate(more)]
    where += moments.values()
    contradicts = bool(against) and not found.selection.chosen
    unexplained = (
        bool(left) or bool(strong) or contradicts or bool(more) or bool(bent) or bool(moments)
    )
    sides = {
        "train": [*left.above, *left.coloured, *moments],
        "test": [*held_out.above, *held_out.coloured],
    }
    if unexplained or any(sides.values()):
        asked = [
            *(key for key, _ in more),
            *(r.key for r in strong),
            *(c.key for c in (*chosen.unnamed, *judged.withdrawn)),
        ]
        place = place_of(judged, sides, [*asked, *(k for b in bent for k in b.instead)], controls)
    else:
        place = no_place(NOTHING)
    near = strong_of(place["candidates"], {*told, *(key for key, _ in more)})
    where += [_still_asked(effects[key], t, len(more) + k) for k, (key, t) in enumerate(near)]
    return {
        "unexplained": unexplained,
        "where": where,
        "channels_above_noise": left.above,
        "coloured_channels": list(left.coloured),
        "place": place,
    }


def _disagreeing(setup: Setup, shown: Shown, controls: Sequence[Any]) -> list[dict[str, Any]]:
    """Regions in which coefficients disagree, then coefficients above their noise and the states on which they depend."""
    out = find_disagreements(setup, shown, shown, controls)
    states = _ranges(shown, controls)
    for k, c in enumerate(COEFFICIENTS):
        ratio = shown.coefficient_rms(k) / float(shown.floor[k])
        if ratio > NOISE_FLOOR:
            depends = [
                {"state": n, "share": s}
                for n, s in dependence([g[:, k] for g in shown.coefficients], states)
            ]
            out.append({"coefficient": c, "rms_over_noise": ratio, "depends_on": depends})
    return out


def _unconfirmed(effect: Effect, refused: Refusal) -> dict[str, Any]:
    """Where the residual is and on what it depends, from the nearest candidate that was not confirmed."""
    term = effect.parsed
    depends = [] if term is None else [{"state": v} for v in term.variables]
    words = (
        f"something is missing in {effect.coefficient or effect.subsystem} that depends on "
        f"{', '.join(d['state'] for d in depends) or effect.term}: {effect.name} comes "
        f"nearest (|t| {abs(refused.t):.1f}), but {refused.why}"
    )
    return {**label(effect), "depends_on": depends, "t": refused.t, "words": words}


def document_of(
    chosen: Found, judged: Judged, aircraft: Aircraft, controls: Sequence[Any]
) -> dict[str, Any]:
    """refinement.json as far as flights and models say it.

    chosen: what the train flights say, before the test flights were asked; aircraft: as given; controls: of every train segment
    """
    found, (setup, before, after) = judged.found, judged.train
    switches = {c.key: switch_of(chosen.effects[c.key], aircraft) for c in chosen.selection.chosen}
    effects = [_effect(found, c, judged.verdicts[c.key], switches) for c in found.selection.chosen]
    withdrawn = [
        _effect(chosen, c, judged.verdicts[c.key], switches, withdrawn=True)
        for c in judged.withdrawn
    ]
    remaining = _remaining(chosen, judged, controls)
    verdict = (
        "unexplained"
        if remaining["unexplained"]
        else "effects-found"
        if effects
        else "no-missing-effect"
    )
    refused = found.selection.refused
    return {
        "verdict": verdict,
        "disagreement": find_disagreements(setup, before, after, controls),
        "effects": effects,
        "withdrawn": withdrawn,
        "chosen": [_effect(chosen, c, None, switches) for c in chosen.selection.chosen],
        "remaining": remaining,
        "gap": {"train": gap_document(*judged.train), "test": gap_document(*judged.test)},
        "switch": [
            {"property": s[0], "off": s[1]}
            for c in found.selection.chosen
            if (s := switches[c.key]) is not None
        ],
        "parameters": {n: {"value": v, "std": s} for n, (v, s) in found.parameters.items()},
        "best_refused": None
        if refused is None
        else {"effect": refused.key.removeprefix("effect/"), "t": refused.t, "why": refused.why},
        "candidates": {
            "limit": found.limit,
            "scores": [{"effect": name, "t": t} for name, t in found.scoreboard],
        },
        "timing": {"controls_late_s": found.controls_late_s},
        "trail": list(found.trail),
        "notes": [*found.notes, *(n for f in setup.flights for n in f.notes)],
    }


def moments_of(chosen: Found) -> dict[str, dict[str, Any]]:
    """Angular rate -> what is told of moments about its axis that nothing explains, where flights in turbulence show them."""
    rows = {}
    for (rate, c, axis), gain in zip(
        _AXES, () if chosen.gusts is None else chosen.gusts.moments, strict=False
    ):
        if gain > CERTAIN_T**2 and rate in chosen.setup.outputs:
            gains = f"allowing for them gains {gain:.0f} in twice the log likelihood"
            words = f"moments act about the {axis} axis that no effect explains: {gains}"
            rows[rate] = {"coefficient": c, "twice_log_likelihood": float(gain), "words": words}
    return rows


def _bent(form: Bent, instead: Sequence[Effect]) -> dict[str, Any]:
    """A curve in effects' own states that shows that they have not the form of what is missing."""
    words = (
        f"what is missing in {form.coefficient} does not have the form of {' and '.join(e.name for e in instead)}: beside "
        f"{'them' if len(instead) > 1 else 'it'} a {form.name} gains {form.gain:.0f} in twice the log likelihood"
    )
    return {
        "coefficient": form.coefficient,
        "depends_on": [{"state": s} for s in form.states],
        "twice_log_likelihood": form.gain,
        "p": form.p,
        "words": words,
    }


def strong_of(
    candidates: Sequence[Mapping[str, Any]], told: Collection[str]
) -> list[tuple[str, float]]:
    """(key, t) of the nearest candidates beside what stands that have more than CERTAIN_T and are not told yet: an effect that was
    withdrawn had their place."""
    keys = [f"effect/{c.get('coefficient') or c['subsystem']}/{c['term']}" for c in candidates]
    return [
        (k, c["t"])
        for k, c in zip(keys, candidates, strict=True)
        if abs(c["t"]) > CERTAIN_T and k not in told
    ]


def _still_asked(effect: Effect, t: float, rank: int) -> dict[str, Any]:
    return (
        _told(effect, t, still_asked(effect, t)) if rank < MOST_SAID else {**label(effect), "t": t}
    )


def _told(effect: Effect, t: float, words: str) -> dict[str, Any]:
    return {**label(effect), "t": t, "words": words}


def _effect(
    found: Found,
    c: Choice,
    verdict: Verdict | None,
    switches: Mapping[str, tuple[str, float] | None],
    withdrawn: bool = False,
) -> dict[str, Any]:
    """One effect; what the test flights say of it is no part of what was chosen."""
    e, switch = found.effects[c.key], switches[c.key]
    value, std, unit = _as_written(found, e, c)
    test = (
        {}
        if verdict is None
        else {
            "change_of_twice_log_likelihood": verdict.change,
            "std": verdict.std,
            "gap": verdict.says,
            "rms_over_that_of_train": verdict.far,
            "share_of_estimate": verdict.share[0],
            "share_std": verdict.share[1],
        }
    )
    return {
        **label(e),
        "name": e.name,
        "why": why(e, c),
        "value": value,
        "std": std,
        "unit": unit,
        "property": None if switch is None else switch[0],
        "evidence": {
            "t": c.t,
            "twice_log_likelihood": c.gain,
            "confirmed_on_held_out_manoeuvres": c.confirmed_gain,
            "held_out_estimate_differs_by_std": c.difference,
            "interval_95": _interval(found, e, c),
        },
        **({"withdrawn": withdrawn, "test": test} if test else {}),
        "alternatives": [_alternative(found, e, a) for a in c.alternatives],
    }


def _interval(found: Found, e: Effect, c: Choice) -> list[float | None]:
    """95 % interval of the number as it stands in the XML, given that it was chosen; open above where a servo is never asked for
    more than its rate limit."""
    low, high = chosen_interval(c, found.limit)
    ends = sorted(_as_written(found, e, replace(c, value=v))[0] for v in (low, high))
    return [ends[0], None if e.term == "rate_limit" and is_fastest(c, found.setup) else ends[1]]


def _as_written(found: Found, e: Effect, c: Choice) -> tuple[float, float, str]:
    """Value, standard error and unit as the number stands in the XML: a servo's lag there is 1/s, its rate limit deg/s."""
    surface = (e.subsystem or "").partition(".")[2]
    servo = found.setup.servos.get(surface)
    if e.term == "lag" and servo is not None:
        rate = servo.lag_with(c.value)
        return rate, rate**2 * c.std, "1/s"
    if e.term == "rate_limit":
        limit = (servo or Actuator(None)).slowed_to(c.value)
        return limit, limit**2 * c.std, "deg/s"
    return c.value, c.std, e.unit


def _alternative(found: Found, own: Effect, a: Alternative) -> dict[str, Any]:
    other = found.effects[a.key]
    return {
        **label(other),
        "name": other.name,
        "evidence": {
            "twice_log_likelihood": a.gain,
            "t_of_the_effect_beside_it": a.t_beside,
            "likeness": a.likeness,
            "companions": [c.removeprefix("effect/") for c in a.companions],
        },
        "separable": a.separable,
        **({} if a.separable else {"would_separate": separating_manoeuvre(own, other)}),
    }
