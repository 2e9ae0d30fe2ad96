"""refinement.json in sentences: what the test flights say of an effect, what is left, and where."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from uqharness.replay import shown_channel

_AWAY = 1e9
"""Change of twice a log likelihood that is no measure of noise any more: replays of one of the two models diverge."""


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
    near = ", ".join(
        f"{c['name']} {c['leaves']:.2f} (|t| {abs(c['t']):.1f})" for c in place["candidates"]
    )
    now = f"rms over noise of {name} on the train flights {place['channel_on_train']:.2f}"
    second = f"{now}; with the nearest candidates it would be: {near}"
    return [first, second, f"the flight that would tell: {place['would_tell']}"]


def smooth_says(smooth: Mapping[str, Any]) -> str:
    """What is said of a smooth term that is offered for naming, in a line."""
    channel, _, _ = shown_channel(smooth["channel"])
    instead = (
        f", in place of {' and '.join(smooth['in_place_of'])}," if smooth["in_place_of"] else ""
    )
    return (
        f"not named, no physics: a {smooth['name']} ({smooth['property']}){instead} brings {channel} on the train flights from "
        f"{smooth['channel_on_train']:.2f} to {smooth['leaves']:.2f} times its noise; {test_says(smooth)}"
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
        out.append(
            "above their noise: " + ", ".join(f"{c} ({r:.2f} times)" for c, r in above.items())
        )
    if remaining["coloured_channels"]:
        out.append(f"residuals not white: {', '.join(remaining['coloured_channels'])}")
    for w in remaining["where"]:
        if "words" in w:
            out.append(w["words"])
        elif "rms_over_noise" in w:
            depends = (
                w["depends_on"][0]["state"] if w["depends_on"] else "none of the states looked at"
            )
            out.append(
                f"{w['coefficient']}: {w['rms_over_noise']:.2f} times noise, depends on {depends}"
            )
    return out


def test_says(effect: Mapping[str, Any]) -> str:
    """What the test flights say of one effect."""
    test = effect["test"]
    change, std = test["change_of_twice_log_likelihood"], test["std"]
    number = f"twice the log likelihood {_with_error(change, std)} with it"
    if abs(change) >= _AWAY:
        more, leaves = ("more", "without") if change > 0.0 else ("less", "with")
        number = f"twice the log likelihood over a billion {more} with it, for {leaves} it the model leaves the flights altogether"
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
