"""Sentences about effects: why one was named, and which manoeuvre would separate two of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from sysid.effects import Choice, Effect
from uqharness.refinement.types import Bent
from uqharness.replay import shown_channel

_EXCITES = {
    "alpha": "slow changes of angle of attack by speed (level flight from the slowest to the fastest)",
    "beta": "steady sideslips at several angles",
    "p_hat": "aileron doublets of two sizes and lengths",
    "q_hat": "elevator doublets of two lengths",
    "r_hat": "rudder doublets of two lengths",
    "alphadot_hat": "elevator doublets beside turns at constant angle of attack: alphadot without q and q without alphadot",
    "betadot_hat": "flat turns beside rudder doublets: r without betadot",
    "de": "elevator steps at constant speed, by throttle",
    "da": "short aileron pulses: deflection before there is a roll rate",
    "dr": "short rudder pulses: deflection before there is a yaw rate",
    "dt": "throttle steps",
    "CT": "throttle doublets at constant speed and angle of attack",
    "V_rel": "the same manoeuvres at widely different speeds, thrust held",
    "h_over_b": "the same manoeuvres high and low",
}
_SUBSYSTEM = {
    "stall": "a slow approach to the stall, and a fast one",
    "propulsion": "throttle doublets at two speeds; a static thrust measurement",
    "mass": "none in the air: a swing test on the ground measures Ixz, weighing the centre of gravity",
    "actuator": "the surface moved on the ground with its position logged",
    "sensor": "calibration of the sensor on the ground",
    "ground": "the same manoeuvre low and high",
    "record": "a tap on the aircraft logged by all sensors",
}


def why(effect: Effect, choice: Choice) -> str:
    """One sentence: physics, where it shows, how strongly the flights say so."""
    sign = "positive" if choice.value > 0 else "negative"
    where = f"; it shows in {effect.regime}" if effect.regime else ""
    source = f" ({effect.reference})" if effect.reference else ""
    return (
        f"{effect.physics}{where}{source}. "
        f"Estimate {choice.value:.4g} ± {choice.std:.2g} ({sign}), |t| {abs(choice.t):.1f} with "
        "standard errors corrected for coloured residuals"
    )


def separating_manoeuvre(one: Effect, other: Effect) -> str:
    """The manoeuvre that would separate two effects that these flights do not."""
    for effect in (one, other):
        part = (effect.subsystem or "").partition(".")[0]
        if part == "mass" and effect.term == "Ixz":
            return (
                "measure Ixz on the ground (swing test); in the air a wrong Ixz is pitching moment from roll rate squared "
                "and, with the other sign, from yaw rate squared: rudder doublets separate them only as long as the "
                "aircraft has no moment from yaw rate squared of its own"
            )
        if part in _SUBSYSTEM:
            return _SUBSYSTEM[part]
    a, b = one.parsed, other.parsed
    assert a is not None
    assert b is not None
    apart = [v for v in (*a.variables, *b.variables) if (v in a.variables) != (v in b.variables)]
    if not apart:
        return f"the same manoeuvres at several amplitudes: {a.text} and {b.text} differ in how they grow"
    return "; ".join(dict.fromkeys(_EXCITES[v] for v in apart[:2]))


_OF_STATE = {
    "V_mps": "V_rel", "alpha_rad": "alpha", "beta_rad": "beta", "p_radps": "p_hat", "q_radps": "q_hat", "r_radps": "r_hat",
    "elevator_deg": "de", "aileron_deg": "da", "rudder_deg": "dr", "throttle_pct": "dt",
}  # fmt: skip


def would_tell(state: str | None, nearest: Sequence[Effect], loudest: tuple[str, float]) -> str:
    """The flight that would tell what is left.

    state: with which the residual goes; nearest: candidates, the best first; loudest: kind of manoeuvre in which the channel's
    residual is largest, and its rms over noise there
    """
    kind, ratio = loudest
    said = [f"repeat {kind}, where the channel is at {ratio:.2f} times its noise, at other amplitudes and speeds"]
    if state is not None:
        said.insert(0, _EXCITES[_OF_STATE[state]])
    if len(nearest) > 1:
        first, second = nearest[:2]
        said.append(f"to separate {first.name} from {second.name}: {separating_manoeuvre(first, second)}")
    return "; ".join(said)


def place_says(place: Mapping[str, Any]) -> list[str]:
    """Where the strongest of what is left sits, in at most three lines; none where nothing is left."""
    if place["channel"] is None:
        return []
    name, _, _ = shown_channel(place["channel"])
    side = "hold-out" if place["flights"] == "test" else "train"
    if place["from_s"] is None:
        first = f"residual of {name}, {side} flights, {place['rms_over_noise']:.2f} times its noise: {place['reason']}"
    else:
        share = place["share_of_excess"]
        held = "" if share is None else f", {100.0 * share:.0f} % of what is left of the channel"
        when = f"{place['flight']}, {place['from_s']:.1f} to {place['to_s']:.1f} s ({place['manoeuvre']})"
        band = f"{place['from_Hz']:.2g} to {place['to_Hz']:.2g} Hz"
        first = f"residual of {name}, {side} flight {when}, {band}: {place['rms_over_noise']:.2f} times its noise{held}"
    goes = place["state"]
    if goes is not None:
        state, unit, factor = shown_channel(goes["state"])
        first += (
            f"; its {goes['of']} goes with {state}, most at {factor * goes['low']:.3g} to {factor * goes['high']:.3g} {unit} "
            f"({100.0 * goes['share']:.0f} % of its variance)"
        )
    near = ", ".join(f"{c['name']} {c['leaves']:.2f} (|t| {abs(c['t']):.1f})" for c in place["candidates"])
    now = f"rms over noise of {name} on the train flights {place['channel_on_train']:.2f}"
    second = f"{now}; with the nearest candidates it would be: {near}"
    return [first, second, f"the flight that would tell: {place['would_tell']}"]


def smooth_says(smooth: Mapping[str, Any]) -> str:
    """What is said of a smooth term that is offered for naming, in a line."""
    channel, _, _ = shown_channel(smooth["channel"])
    instead = f", in place of {' and '.join(smooth['in_place_of'])}," if smooth["in_place_of"] else ""
    return (
        f"not named, no physics: a {smooth['name']} ({smooth['property']}){instead} brings {channel} on the train flights from "
        f"{smooth['channel_on_train']:.2f} to {smooth['leaves']:.2f} times its noise; {test_says(smooth)}"
    )


def contradicted(effect: Effect, choice: Choice, says: str) -> str:
    """What is said of an effect that the train flights ask for and the test flights speak against, or do not show beside what is
    unexplained. says: what the test flights say (judge.Verdict)."""
    asked = f"the train flights ask for {effect.name} (|t| {abs(choice.t):.1f}), and "
    if says == "grew":
        grew = "with it the gap on the test flights grew: it is withdrawn"
        return f"{asked}{grew}; something differs between the flights that has no name here"
    return f"{asked}the test flights do not show it: beside something that nothing explains it is withdrawn"


def unnamed(effect: Effect, choice: Choice) -> str:
    """What is said of an effect that would have been named, were nothing unexplained beside it."""
    return (
        f"{effect.name} would explain a part of it (|t| {abs(choice.t):.1f}), too little to be named beside something that nothing "
        "explains"
    )


def another_form(form: Bent, instead: Sequence[Effect]) -> str:
    """What is said where a curve in an effect's own states shows that the effect has not the form of what is missing."""
    names = " and ".join(e.name for e in instead)
    return (
        f"what is missing in {form.coefficient} does not have the form of {names}: beside {'them' if len(instead) > 1 else 'it'} a "
        f"{form.name} gains {form.gain:.0f} in twice the log likelihood"
    )


def still_asked(effect: Effect, t: float) -> str:
    """What is said of a candidate that the flights still ask for beside the effects that were chosen."""
    return f"{effect.name} is still asked for (|t| {abs(t):.1f}): it, or something like it, is missing"


def moments_left(axis: str, gain: float) -> str:
    """What is said where a filter in turbulence needs moments about an axis that no effect explains."""
    return (
        f"moments act about the {axis} axis that no effect explains: allowing for them gains {gain:.0f} in twice the log likelihood"
    )


def nowhere(document: Mapping[str, Any]) -> str:
    """What is said where no region stands out: nothing at all is missing, or what is missing shows over whole flights alone."""
    named = [abs(e["evidence"]["t"]) for e in (*document["effects"], *document["withdrawn"])]
    named += [abs(w["t"]) for w in document["remaining"]["where"] if "t" in w]
    if named:
        return (
            "in no single region beyond what noise allows a sample; over all samples together the flights disagree with the "
            f"model all the same (|t| up to {max(named):.0f})"
        )
    if document["remaining"]["unexplained"]:
        return "in no single region beyond what noise allows a sample, but the flights as a whole: see what is left"
    return "nowhere beyond what noise allows"


def left_over(remaining: Mapping[str, Any]) -> list[str]:
    """What is left, in sentences; none where nothing is."""
    if not remaining["unexplained"]:
        return [w["words"] for w in remaining["where"] if "words" in w]
    out = []
    above = remaining["channels_above_noise"]
    if above:
        out.append("above their noise: " + ", ".join(f"{c} ({r:.2f} times)" for c, r in above.items()))
    if remaining["coloured_channels"]:
        out.append(f"residuals not white: {', '.join(remaining['coloured_channels'])}")
    for w in remaining["where"]:
        if "words" in w:
            out.append(w["words"])
        elif "rms_over_noise" in w:
            depends = w["depends_on"][0]["state"] if w["depends_on"] else "none of the states looked at"
            out.append(f"{w['coefficient']}: {w['rms_over_noise']:.2f} times noise, depends on {depends}")
    return out


def test_says(effect: Mapping[str, Any]) -> str:
    """What the test flights say of one effect."""
    test = effect["test"]
    change, std = test["change_of_twice_log_likelihood"], test["std"]
    number = f"twice the log likelihood {_with_error(change, std)} with it"
    share, wide = test.get("share_of_estimate"), test.get("share_std")
    # A standard error of half the way between none and all tells neither from the other.
    if share is not None and wide is not None and math.isfinite(share) and wide < 0.5:
        number += f", {share:.2f} ± {wide:.2f} of the estimate fits them best"
    if test["gap"] == "shrank":
        return f"on the test flights the gap shrank: {number}"
    if test["gap"] == "grew":
        return f"on the test flights the gap grew: {number}; withdrawn"
    if test["gap"] == "too far":
        far = f"{test['rms_over_that_of_train']:.0f} times as far from either model as the train flights"
        return f"the test flights do not tell: they lie {far}; look for what is wrong with them"
    gone = "; withdrawn beside what nothing explains" if effect.get("withdrawn") else ""
    return f"the test flights do not tell whether the gap shrank: {number}{gone}"


def _with_error(value: float, std: float) -> str:
    """``value ± std`` with three significant figures of the standard error, and as many places of the value."""
    if not (math.isfinite(value) and math.isfinite(std) and std > 0.0):
        return f"{value:+.4g} ± {std:.3g}"
    places = 2 - math.floor(math.log10(std))
    return f"{round(value, places):+.{max(places, 0)}f} ± {round(std, places):.{max(places, 0)}f}"


def carried_by(effect: Mapping[str, Any]) -> str:
    """Where an effect of refinement.json stands: its property, a number of the XML, or a sensor."""
    sensor = str(effect.get("subsystem", "")).startswith("sensor.")
    return str(effect.get("property") or ("a sensor's" if sensor else "a number in the XML"))
