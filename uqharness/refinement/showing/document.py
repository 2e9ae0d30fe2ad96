"""refinement.json from what a refinement found: verdict, effects, disagreement, what is left. Computes words and numbers; flies
nothing."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.effects import (
    CERTAIN_T,
    DIFFERENT,
    Alternative,
    Choice,
    Disagreement,
    Effect,
    Refusal,
    dependence,
    disagreements,
)
from sysid.estimation import NOISE_FLOOR
from uqharness.refinement.find import Found, chosen_interval
from uqharness.refinement.judge import Judged, Verdict
from uqharness.refinement.rates import is_fastest
from uqharness.refinement.showing.remains import NOTHING, nowhere, place_of
from uqharness.refinement.showing.show import Shown, gap_document, left_in, state_ranges
from uqharness.refinement.showing.words import (
    another_form,
    contradicted,
    moments_left,
    separating_manoeuvre,
    still_asked,
    unnamed,
    why,
)
from uqharness.refinement.types import Bent, Setup
from uqharness.refinement.writing.effects import switch_of
from uqharness.replay import Segment
from uqharness.simulator import Actuator, Aircraft

MOST_SAID = 3
"""Candidates still asked for that are told in words; the others stand in `remaining.where` alone."""
_AXES = (("p_radps", "Cl", "roll"), ("q_radps", "Cm", "pitch"), ("r_radps", "Cn", "yaw"))


def find_disagreements(setup: Setup, shown: Shown, settled: Shown, controls: Sequence[Any]) -> list[Disagreement]:
    """Where ``shown`` lies outside what noise gives. A model that is at the noise in flight leaves more than that in coefficients,
    because held commands and gusts have their share there; then what it leaves is what is allowed."""
    quiet = all(settled.channel_rms(k) <= NOISE_FLOOR * float(settled.noise[k]) for k in range(len(setup.outputs)))
    together: dict[str, list[Any]] = {}
    for s, g in zip(setup.segments, settled.coefficients, strict=True):
        together.setdefault(kind_of(s), []).append(g)
    by_kind = {kind: np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0)) for kind, parts in together.items()}
    allowed = [
        np.broadcast_to(np.maximum(settled.floor, by_kind[kind_of(s)]) if quiet else settled.floor, g.shape)
        for s, g in zip(setup.segments, shown.coefficients, strict=True)
    ]
    labels = [kind_of(s) for s in setup.segments]
    return disagreements(shown.coefficients, allowed, state_ranges(setup, shown.flown, controls), labels, setup.segments[0].dt_s)


def kind_of(segment: Segment) -> str:
    """The kind of a manoeuvre: its label without the speed behind a comma."""
    return segment.label.split(",")[0]


def _remaining(found: Found, setup: Setup, shown: Shown, left: Sequence[Disagreement], controls: Sequence[Any]) -> dict[str, Any]:
    """Whether anything is left that noise does not explain, where, and on what it depends."""
    left_here = left_in(setup, shown, found.gusty)
    refused = found.selection.refused
    strong = refused is not None and refused.strong
    unexplained = bool(left_here) or strong
    where: list[dict[str, Any]] = []
    if refused is not None and strong:
        where.append(_unconfirmed(found.effects[refused.key], refused))
    if left_here:
        where += [_region(d) for d in left]
        states = state_ranges(setup, shown.flown, controls)
        for k, c in enumerate(COEFFICIENTS):
            ratio = shown.coefficient_rms(k) / float(shown.floor[k])
            if ratio > NOISE_FLOOR:
                where.append({
                    "coefficient": c, "rms_over_noise": ratio,
                    "depends_on": [{"state": n, "share": s} for n, s in dependence(shown.coefficients, states, k)],
                })  # fmt: skip
    return {
        "unexplained": unexplained, "where": where, "channels_above_noise": left_here.above,
        "coloured_channels": list(left_here.coloured),
    }  # fmt: skip


def _unconfirmed(effect: Effect, refused: Refusal) -> dict[str, Any]:
    """Where the residual is and on what it depends, from the nearest candidate that was not confirmed."""
    term = effect.parsed
    depends = [] if term is None else [{"state": v} for v in term.variables]
    words = (
        f"something is missing in {effect.coefficient or effect.subsystem} that depends on "
        f"{', '.join(d['state'] for d in depends) or effect.term}: {effect.name} comes "
        f"nearest (|t| {abs(refused.t):.1f}), but {refused.why}"
    )
    return {**_label(effect), "depends_on": depends, "t": refused.t, "words": words}


def _region(d: Disagreement) -> dict[str, Any]:
    return {
        "coefficient": d.coefficient, "manoeuvre": d.manoeuvre, "region": {d.region.state: [d.region.low, d.region.high]},
        "share_outside_95": d.share, "size": d.size, "words": d.words,
    }  # fmt: skip


def document_of(chosen: Found, judged: Judged, aircraft: Aircraft, controls: Sequence[Any]) -> dict[str, Any]:
    """refinement.json as far as flights and models say it.

    chosen  what the train flights say, before the test flights were asked; aircraft: as given; controls: positions
    in every train segment
    """
    found, (setup, before, after) = judged.found, judged.train
    left = find_disagreements(setup, after, after, controls)
    remaining = _remaining(found, setup, after, left, controls)
    switches = {c.key: switch_of(chosen.effects[c.key], aircraft) for c in chosen.selection.chosen}
    effects = [_effect(found, c, judged.verdicts[c.key], switches) for c in found.selection.chosen]
    withdrawn = [_effect(chosen, c, judged.verdicts[c.key], switches, withdrawn=True) for c in judged.withdrawn]
    # What the train flights ask for and the test flights speak against is a disagreement without a name, unless chance asked.
    asked = [c for c in judged.withdrawn if abs(c.t) > chosen.limit + DIFFERENT]
    remaining["where"] += [_contradicted(chosen.effects[c.key], c, judged.verdicts[c.key]) for c in asked]
    remaining["where"] += [] if chosen.bent is None else [_bent(chosen.bent, [chosen.effects[k] for k in chosen.bent.instead])]
    remaining["where"] += [_unnamed(chosen.effects[c.key], c) for c in chosen.unnamed]
    told = {c.key for c in (*asked, *chosen.unnamed, *chosen.selection.chosen)}
    more = [(key, t) for key, t in chosen.left if key not in told]
    remaining["where"] += [_still_asked(chosen.effects[key], t, k) for k, (key, t) in enumerate(more)]
    moments = moments_of(chosen)
    remaining["where"] += list(moments.values())
    remaining["unexplained"] |= (bool(asked) and not effects) or bool(more) or chosen.bent is not None or bool(moments)
    remaining["place"] = place = _place(chosen, judged, remaining, [key for key, _ in more], list(moments), controls)
    near = strong_of(place["candidates"], {*told, *(key for key, _ in more)})
    remaining["where"] += [_still_asked(chosen.effects[key], t, len(more) + k) for k, (key, t) in enumerate(near)]
    verdict = "unexplained" if remaining["unexplained"] else "effects-found" if effects else "no-missing-effect"
    refused = found.selection.refused
    return {
        "verdict": verdict,
        "disagreement": [_region(d) for d in find_disagreements(setup, before, after, controls)],
        "effects": effects,
        "withdrawn": withdrawn,
        "chosen": [_effect(chosen, c, None, switches) for c in chosen.selection.chosen],
        "remaining": remaining,
        "gap": {"train": gap_document(*judged.train), "test": gap_document(*judged.test)},
        "switch": [
            {"property": found_switch[0], "off": found_switch[1]}
            for c in found.selection.chosen
            if (found_switch := switches[c.key]) is not None
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


def _place(
    chosen: Found, judged: Judged, remaining: Mapping[str, Any], more: Sequence[str], rates: Sequence[str],
    controls: Sequence[Any],
) -> dict[str, Any]:  # fmt: skip
    """Where the strongest of what is left sits: on train or hold-out flights, or where a candidate is asked for. rates: channels
    of the axes about which a moment is missing."""
    other, _, fitted = judged.test
    held_out = left_in(other, fitted, judged.found.gusty)
    left = {
        "train": [*remaining["channels_above_noise"], *remaining["coloured_channels"], *rates],
        "test": [*held_out.above, *held_out.coloured],
    }
    refused = judged.found.selection.refused
    strong = [refused.key] if refused is not None and refused.strong else []
    bent = () if chosen.bent is None else chosen.bent.instead
    asked = [*more, *strong, *(c.key for c in chosen.unnamed), *(c.key for c in judged.withdrawn), *bent]
    if not any(left.values()) and not remaining["unexplained"]:
        return nowhere(NOTHING)
    return place_of(judged, left, asked, controls)


def moments_of(chosen: Found) -> dict[str, dict[str, Any]]:
    """Angular rate -> what is told of moments about its axis that nothing explains, where flights in turbulence show them."""
    found = zip(_AXES, () if chosen.gusts is None else chosen.gusts.moments, strict=False)
    return {
        rate: {"coefficient": c, "twice_log_likelihood": float(gain), "words": moments_left(axis, float(gain))}
        for (rate, c, axis), gain in found
        if gain > CERTAIN_T**2 and rate in chosen.setup.outputs
    }  # fmt: skip


def _contradicted(effect: Effect, choice: Choice, verdict: Verdict) -> dict[str, Any]:
    return {**_label(effect), "t": choice.t, "words": contradicted(effect, choice, verdict.says)}


def _bent(form: Bent, instead: Sequence[Effect]) -> dict[str, Any]:
    depends = [{"state": s} for s in form.states]
    return {
        "coefficient": form.coefficient, "depends_on": depends, "twice_log_likelihood": form.gain, "p": form.p,
        "words": another_form(form, instead),
    }  # fmt: skip


def _unnamed(effect: Effect, choice: Choice) -> dict[str, Any]:
    return {**_label(effect), "t": choice.t, "words": unnamed(effect, choice)}


def strong_of(candidates: Sequence[Mapping[str, Any]], told: Collection[str]) -> list[tuple[str, float]]:
    """(key, t) of the nearest candidates beside what stands that have more than CERTAIN_T and are not told yet: an effect that was
    withdrawn had their place."""
    keys = [f"effect/{c.get('coefficient') or c['subsystem']}/{c['term']}" for c in candidates]
    return [(k, c["t"]) for k, c in zip(keys, candidates, strict=True) if abs(c["t"]) > CERTAIN_T and k not in told]


def _still_asked(effect: Effect, t: float, rank: int) -> dict[str, Any]:
    said = {"words": still_asked(effect, t)} if rank < MOST_SAID else {}
    return {**_label(effect), "t": t, **said}


def _label(effect: Effect) -> dict[str, str]:
    where = {"coefficient": effect.coefficient} if effect.coefficient is not None else {"subsystem": effect.subsystem or ""}
    return {**where, "term": effect.term}


def _effect(
    found: Found, c: Choice, verdict: Verdict | None, switches: Mapping[str, tuple[str, float] | None], withdrawn: bool = False
) -> dict[str, Any]:
    """One effect; what the test flights say of it is no part of what was chosen."""
    e, switch = found.effects[c.key], switches[c.key]
    value, std, unit = _as_written(found, e, c)
    test: dict[str, Any] = {}
    if verdict is not None:
        row = {
            "change_of_twice_log_likelihood": verdict.change, "std": verdict.std, "gap": verdict.says,
            "rms_over_that_of_train": verdict.far, "share_of_estimate": verdict.share[0], "share_std": verdict.share[1],
        }  # fmt: skip
        test = {"withdrawn": withdrawn, "test": row}
    return {
        **_label(e),
        "name": e.name,
        "why": why(e, c),
        "value": value,
        "std": std,
        "unit": unit,
        "property": None if switch is None else switch[0],
        "evidence": {
            "t": c.t, "twice_log_likelihood": c.gain, "confirmed_on_held_out_manoeuvres": c.confirmed_gain,
            "held_out_estimate_differs_by_std": c.difference, "interval_95": _interval(found, e, c),
        },
        **test,
        "alternatives": [_alternative(found, e, a) for a in c.alternatives],
    }  # fmt: skip


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
    row: dict[str, Any] = {
        **_label(other), "name": other.name,
        "evidence": {
            "twice_log_likelihood": a.gain, "t_of_the_effect_beside_it": a.t_beside, "likeness": a.likeness,
            "companions": [c.removeprefix("effect/") for c in a.companions],
        },
        "separable": a.separable,
    }  # fmt: skip
    if not a.separable:
        row["would_separate"] = separating_manoeuvre(own, other)
    return row
