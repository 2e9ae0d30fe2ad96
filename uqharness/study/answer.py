"""The answer of a study in four lines: answer, why, what the model lacked and what adding it bought, what to do next."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from uqharness.campaign import CONFIDENCE, Condition, Statement, hardest_of, in_condition
from uqharness.replay import shown_channel
from uqharness.statistics import NO, OPEN, YES
from uqharness.study.performance import BAD, GOOD, WARN, Flown, asked_of, width_of
from uqharness.study.stages import AFTER, BEFORE

_WORDS = {YES: "yes", NO: "no", OPEN: "inconclusive (too few flight hours)"}
_LEVELS = {YES: GOOD, NO: BAD, OPEN: WARN}
_ORDER = (YES, NO, OPEN)
_SURE = f"{100 * CONFIDENCE:g} %"
_TRACK = "cross_track_median_m"
_NAMED = 3
"""Effects and channels that are named in a line; of more than that, the first."""


@dataclass(frozen=True)
class Answer:
    """Lines without the question; ``lacked`` is empty for a study without refinement. ``level``: good, warn or bad."""

    level: str
    answer: str
    why: str
    lacked: str
    next: str


def answer_of(
flown: Mapping[str, Flown], refinement: Mapping[str, Any] | None, verdict: Sequence[tuple[str, str]],
    no: Sequence[str] = (),
) -> Answer:  # fmt: skip
    """The answer from the finished campaigns, before and after, and refinement.json.

    verdict: all sentences of the study, which answer where no campaign counts excursions. no: stages whose own answer is no.
    """
    last = flown.get(AFTER) or flown.get(BEFORE)
    asked = asked_of(last) if last is not None else []
    lacked = "" if refinement is None else _lacked(refinement, flown)
    remark = f" These stages answered no: {', '.join(no)} (log/STAGE.txt)." if no else ""
    if last is None or not asked:
        first = next((s for level in (BAD, WARN) for s in verdict if s[1] == level), verdict[0] if verdict else ("", ""))
        why = "no campaign was flown" if last is None else "the aircraft publishes no distance from a path"
        text = f"No excursion rate: {why}."
        return Answer(WARN, text, first[0], lacked, f"Next: give the study a campaign that counts excursions.{remark}")
    before = {item.cell.condition: item.answer for item in asked_of(flown[BEFORE])} if AFTER in flown else None
    answers = {item.cell.condition: item.answer for item in asked}
    # Good or bad is what holds in every condition.
    level = _LEVELS[next(iter(answers.values()))] if len(set(answers.values())) == 1 else WARN
    first_words = _grouped(answers)
    text = (
        f"{first_words[:1].upper()}{first_words[1:]}: at most {asked[0].acceptable_per_h:g} excursions beyond "
        f"{asked[0].cell.radius_m:g} m per flight hour at every corner, {_SURE} confidence."
    )
    if before is not None:
        changed = {c: a for c, a in before.items() if answers.get(c) != a}
        text += f" Before refinement: {_grouped(changed) if changed else 'the same answers'}."
    return Answer(level, text, _why(asked), lacked, f"{_next(last, asked)}{remark}")


def _grouped(answers: Mapping[Condition, str]) -> str:
    found = {answer: [c for c, a in answers.items() if a == answer] for answer in _ORDER}
    return "; ".join(f"{_WORDS[answer]} in {_named(here)}" for answer, here in found.items() if here)


def _named(found: Sequence[Condition]) -> str:
    """Conditions by turbulence: ``3 and 7 m/s wind with light turbulence``."""
    by_air: dict[str, list[str]] = {}
    for condition in found:
        by_air.setdefault(condition.turbulence, []).append(f"{condition.wind_mps:g}")
    parts = []
    for air, winds in by_air.items():
        listed = " and ".join(filter(None, (", ".join(winds[:-1]), winds[-1])))
        parts.append(f"{listed} m/s wind with {'no' if air == 'none' else air} turbulence")
    return ", ".join(parts)


def _why(asked: Sequence[Statement]) -> str:
    """The rate of the hardest condition of each answer with the limit that decides, hours, and what happened to the flights."""
    parts = []
    for answer in _ORDER:
        here = [item for item in asked if item.answer == answer]
        if here:
            item = _deciding(here, answer)
            parts.append(f"{item.cell.condition.label}: {_rate(item, answer)}")
    hours = [sum(rate.hours for rate in item.cell.rates) for item in asked]
    flown = f"{min(hours):.3g}" if max(hours) - min(hours) < 1.0 else f"{min(hours):.3g} to {max(hours):.3g}"
    lost = sum(sum(item.aborted.values()) for item in asked)
    return f"Why: {'; '.join(parts)}; {flown} h a condition, {lost or 'no'} flight{'' if lost == 1 else 's'} aborted."


def _deciding(found: Sequence[Statement], answer: str) -> Statement:
    """The one with the highest limit that the answer rests on; of several the hardest."""
    limits = [item.worst.lower if answer == NO else item.worst.upper for item in found]
    highest = [item for item, limit in zip(found, limits, strict=True) if limit == max(limits)] or list(found)
    condition = hardest_of(item.cell.condition for item in highest)
    return next(item for item in highest if item.cell.condition == condition)


def _rate(item: Statement, answer: str) -> str:
    worst = item.worst
    if math.isnan(worst.rate):
        return "undefined, for no flight was scored"
    upper = f"no finite {_SURE} upper limit" if math.isinf(worst.upper) else f"{_SURE} upper limit {worst.upper:.3g}/h"
    if answer == YES:
        return f"{upper} at the worst corner"
    if answer == NO:
        if worst.upper <= item.acceptable_per_h:
            return f"aborted flights, {_SURE} upper limit {item.loss_upper_per_h:.3g}/h at the worst corner"
        return f"{worst.rate:.3g}/h at the worst corner, {_SURE} limits {worst.lower:.2g} to {worst.upper:.3g}"
    return f"{worst.rate:.3g}/h at the worst corner, {upper}"


def _lacked(refinement: Mapping[str, Any], flown: Mapping[str, Flown]) -> str:
    effects = [e for e in refinement["effects"] if not e["withdrawn"]]
    if not effects:
        if refinement["verdict"] == "no-missing-effect":
            return "The model lacked nothing that these flights show."
        return "Something is missing in the model that no effect of the catalogue explains."
    named = [f"{e['name']} {e['value']:.4g} ± {e['std']:.2g}{'' if e['unit'] in ('', '1') else ' ' + e['unit']}" for e in effects]
    more = f" and {len(named) - _NAMED} more" if len(named) > _NAMED else ""
    bought = list(_bought(refinement, flown))
    gained = f". Adding them: {'; '.join(bought)}" if bought else ""
    return f"The model lacked {', '.join(named[:_NAMED])}{more}{gained}."


def _bought(refinement: Mapping[str, Any], flown: Mapping[str, Flown]) -> Iterator[str]:
    gap = refinement["gap"]["test"]["channels"]
    sigma = {
        c: (row["rms_before"] / row["noise_rms"], row["rms_after"] / row["noise_rms"])
        for c, row in gap.items()
        if all(row.get(key) for key in ("rms_before", "rms_after", "noise_rms"))
    }
    if sigma:
        channel = max(sigma, key=lambda c: sigma[c][0])
        before, after = sigma[channel]
        name = shown_channel(channel)[0]
        yield f"residual of {name} on the held-out flight {before:.3g} sigma before, {after:.3g} after"
    if AFTER in flown:
        condition = _drawn(flown[AFTER])
        widths = [width_of(in_condition(flown[when].frame, condition), _TRACK) for when in (BEFORE, AFTER)]
        if all(width is not None and math.isfinite(width.area) for width in widths) and widths[0] and widths[0].area > 0.0:
            assert widths[1] is not None
            change = 100.0 * (widths[1].area / widths[0].area - 1.0)
            words = f"{-change:.0f} % narrower" if change < 0.0 else f"{change:.0f} % wider"
            yield f"p-box of the cross-track error {words} in {condition.label}"


def _drawn(flown: Flown) -> Condition:
    return hardest_of(item.cell.condition for item in flown.signed)


def _next(last: Flown, asked: Sequence[Statement]) -> str:
    """What would change the answer, else what would narrow what is left."""
    open_ = [item for item in asked if item.answer == OPEN]
    if open_:
        item = max(open_, key=lambda s: s.worst.upper)
        where = item.cell.condition.label
        if item.worst.rate > 0.0:
            more = f"Next: more flight hours in {where} ([aleatory] flights), or a narrower model."
            return f"{more} {_flight(last, item.cell.condition)}".rstrip()
        hours = item.quiet_hours_needed
        return f"Next: fly {hours:.3g} h per corner in {where} ([aleatory] flights); that much without an excursion is a yes."
    refused = [item for item in asked if item.answer == NO]
    beyond = [item for item in refused if item.best.lower > item.acceptable_per_h]
    if beyond:
        item = min(beyond, key=lambda s: s.best.lower)
        return (
            f"Next: {item.cell.condition.label} fails at the best corner too (at least {item.best.lower:.2g}/h), so no better "
            f"model changes it: change the autopilot, the radius or the wind limit. {_flight(last, item.cell.condition)}"
        ).rstrip()
    if refused:
        item = refused[0]
        return (
            f"Next: {item.cell.condition.label} is a no at the worst corner, with {item.best.rate:.2g}/h at the best: a better "
            f"model may change it. {_flight(last, item.cell.condition)}"
        ).rstrip()
    return f"Next: nothing for this question. {_flight(last, _drawn(last))}".rstrip()


def _widest(last: Flown, condition: Condition) -> str:
    rows = [r for r in last.shares if r["condition"] == condition.label and r["metric"] == _TRACK and r["share_max"]]
    if not rows:
        return ""
    first = max(rows, key=lambda row: float(row["share_max"]))
    return f"{first['coefficient']} makes {100 * float(first['share_max']):.0f} % of the cross-track p-box"


def _flight(last: Flown, condition: Condition) -> str:
    widest = _widest(last, condition)
    return f"{widest}: uqharness next-flight {last.folder} --out DIR plans the flight that narrows it." if widest else ""
