"""The answer of a study in four lines: answer, why, what the model lacked and what adding it bought, what to do next."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from uqharness.campaign import CONFIDENCE, Condition, Statement, hardest_of, in_condition
from uqharness.replay import shown_channel
from uqharness.statistics import NO, OPEN, YES
from uqharness.study.performance import (
    BAD,
    GOOD,
    SAME,
    WARN,
    Flown,
    answer_words,
    asked_of,
    width_of,
)
from uqharness.study.stages import AFTER, BEFORE

_LEVELS = {YES: GOOD, NO: BAD, OPEN: WARN}
_ORDER = (YES, NO, OPEN)
_SURE = f"{100 * CONFIDENCE:g} %"
_TRACK = "cross_track_median_m"
_NAMED = 3
"""Effects that are named in a line; of more than that, the first."""


@dataclass(frozen=True)
class Answer:
    """Lines without the question; ``lacked`` is empty for a study without refinement. ``level``: good, warn or bad."""

    level: str
    answer: str
    why: str
    lacked: str
    next: str


def answer_of(
    flown: Mapping[str, Flown],
    refinement: Mapping[str, Any] | None,
    verdict: Sequence[tuple[str, str]],
    no: Sequence[str] = (),
) -> Answer:
    """The answer from the finished campaigns, before and after, and refinement.json.

    verdict: all sentences of the study, which answer where no campaign counts excursions. no: stages whose own answer is no.
    """
    last = flown.get(AFTER) or flown.get(BEFORE)
    asked = asked_of(last) if last is not None else []
    remark = f" These stages answered no: {', '.join(no)} (log/STAGE.txt)." if no else ""
    if last is None or not asked:
        first = next(
            (s for level in (BAD, WARN) for s in verdict if s[1] == level),
            verdict[0] if verdict else ("", ""),
        )
        why = (
            "no campaign was flown"
            if last is None
            else "the aircraft publishes no distance from a path"
        )
        text = f"No excursion rate: {why}."
        lacked = "" if refinement is None else _lacked(refinement, flown, same=False)
        return Answer(
            WARN,
            text,
            first[0],
            lacked,
            f"Next: give the study a campaign that counts excursions.{remark}",
        )
    answers = {item.cell.condition: item.answer for item in asked}
    # Good or bad is what holds in every condition.
    level = _LEVELS[asked[0].answer] if len(set(answers.values())) == 1 else WARN
    first_words = _grouped(asked)
    text = f"{first_words[:1].upper()}{first_words[1:]} ({_SURE} confidence)."
    before = asked_of(flown[BEFORE]) if AFTER in flown else []
    changed = [item for item in before if answers.get(item.cell.condition) != item.answer]
    if changed:
        text += f" Before refinement: {_grouped(changed)}."
    lacked = "" if refinement is None else _lacked(refinement, flown, same=not changed)
    return Answer(level, text, _why(asked), lacked, f"{_next(last, asked)}{remark}")


def _grouped(asked: Sequence[Statement]) -> str:
    """Conditions by answer, in the order yes, no, inconclusive: ``yes in 3 and 7 m/s, no in 12 m/s wind with light turbulence``."""
    found: dict[str, list[Condition]] = {}
    for item in sorted(asked, key=lambda s: _ORDER.index(s.answer)):
        found.setdefault(answer_words(item), []).append(item.cell.condition)
    airs = {item.cell.condition.turbulence for item in asked}
    if len(airs) == 1:
        return f"{', '.join(f'{answer} in {_winds(here)}' for answer, here in found.items())} wind with {_air(airs.pop())}"
    return "; ".join(f"{answer} in {_named(here)}" for answer, here in found.items())


def _winds(found: Sequence[Condition]) -> str:
    winds = [f"{condition.wind_mps:g}" for condition in found]
    return f"{' and '.join(filter(None, (', '.join(winds[:-1]), winds[-1])))} m/s"


def _air(turbulence: str) -> str:
    return f"{'no' if turbulence == 'none' else turbulence} turbulence"


def _named(found: Sequence[Condition]) -> str:
    """Conditions by turbulence: ``3 and 7 m/s wind with light turbulence``."""
    by_air: dict[str, list[Condition]] = {}
    for condition in found:
        by_air.setdefault(condition.turbulence, []).append(condition)
    return ", ".join(f"{_winds(here)} wind with {_air(air)}" for air, here in by_air.items())


def _why(asked: Sequence[Statement]) -> str:
    """The rate of the hardest condition of each answer with the limit that decides, hours, and what happened to the flights."""
    one_air = len({item.cell.condition.turbulence for item in asked}) == 1
    parts = []
    for answer in _ORDER:
        here = [item for item in asked if item.answer == answer]
        if here:
            item = _deciding(here, answer)
            where = (
                f"{item.cell.condition.wind_mps:g} m/s" if one_air else item.cell.condition.label
            )
            parts.append(f"{_rate(item, answer)} in {where}")
    hours = [sum(rate.hours for rate in item.cell.rates) for item in asked]
    flown = (
        f"{min(hours):.3g}"
        if max(hours) - min(hours) < 1.0
        else f"{min(hours):.3g} to {max(hours):.3g}"
    )
    return (
        f"Why: excursions beyond {asked[0].cell.radius_m:g} m, worst corner: {', '.join(parts)}; "
        f"acceptable {asked[0].acceptable_per_h:g}/h; {flown} h a condition, {_aborted(asked)}."
    )


def _aborted(asked: Sequence[Statement]) -> str:
    """How many flights were aborted, by kind."""
    kinds = {kind: sum(item.aborted[kind] for item in asked) for kind in asked[0].aborted}
    lost = sum(kinds.values())
    if not lost:
        return "no flights aborted"
    named = ", ".join(
        f"{kind.replace('_', ' ')} {number}" for kind, number in kinds.items() if number
    )
    return f"{lost} flight{'' if lost == 1 else 's'} aborted ({named})"


def _deciding(found: Sequence[Statement], answer: str) -> Statement:
    """The one with the highest limit that the answer rests on; of several the hardest."""
    limits = [item.worst.lower if answer == NO else item.worst.upper for item in found]
    highest = [
        item for item, limit in zip(found, limits, strict=True) if limit == max(limits)
    ] or list(found)
    condition = hardest_of(item.cell.condition for item in highest)
    return next(item for item in highest if item.cell.condition == condition)


def _rate(item: Statement, answer: str) -> str:
    worst = item.worst
    if math.isnan(worst.rate):
        return "undefined (no flight was scored)"
    upper = "without an upper limit" if math.isinf(worst.upper) else f"at most {worst.upper:.3g}/h"
    if answer == YES:
        return upper
    if answer == NO:
        if worst.upper <= item.acceptable_per_h:
            return f"{upper} and aborted flights up to {item.loss_upper_per_h:.3g}/h"
        return f"{worst.rate:.3g}/h ({worst.lower:.2g} to {worst.upper:.3g})"
    return f"{worst.rate:.3g}/h ({upper})"


def _lacked(refinement: Mapping[str, Any], flown: Mapping[str, Flown], same: bool) -> str:
    """Effects by name, and what adding them bought; ``same``: whether the answers before and after are."""
    effects = [e for e in refinement["effects"] if not e["withdrawn"]]
    if not effects:
        if refinement["verdict"] == "no-missing-effect":
            return "The model lacked nothing that these flights show."
        return "Something is missing in the model that no effect of the catalogue explains."
    named = [e["name"] for e in effects]
    more = f" and {len(named) - _NAMED} more" if len(named) > _NAMED else ""
    bought = [*_bought(refinement, flown), *(["same answers"] if same and AFTER in flown else [])]
    gained = f". With {'it' if len(named) == 1 else 'them'}: {', '.join(bought)}" if bought else ""
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
        yield f"held-out residual of {name} from {before:.3g} to {after:.3g} sigma"
    if AFTER in flown:
        condition = _drawn(flown[AFTER])
        widths = [
            width_of(in_condition(flown[when].frame, condition), _TRACK) for when in (BEFORE, AFTER)
        ]
        if (
            all(width is not None and math.isfinite(width.area) for width in widths)
            and widths[0]
            and widths[0].area > 0.0
        ):
            assert widths[1] is not None
            change = widths[1].area / widths[0].area - 1.0
            words = (
                f"{100 * abs(change):.0f} % {'narrower' if change < 0.0 else 'wider'}"
                if abs(change) > SAME
                else "as wide"
            )
            yield f"cross-track p-box {words}"


def _drawn(flown: Flown) -> Condition:
    return hardest_of(item.cell.condition for item in flown.signed)


def _next(last: Flown, asked: Sequence[Statement]) -> str:
    """What would change the answer, else what would narrow what is left."""
    open_ = [item for item in asked if item.answer == OPEN]
    if open_:
        return " ".join(["Next:", *_undecided(last, open_)])
    refused = [item for item in asked if item.answer == NO]
    beyond = [item for item in refused if item.best.lower > item.acceptable_per_h]
    if beyond:
        item = min(beyond, key=lambda s: s.best.lower)
        return (
            f"Next: change the autopilot, the radius or the wind limit: {item.cell.condition.label} fails at the best corner too "
            f"(at least {item.best.lower:.2g}/h), so no better model changes it."
        )
    if refused:
        item = refused[0]
        return (
            f"Next: a better model may change the no in {item.cell.condition.label}: the best corner has {item.best.rate:.2g}/h. "
            f"{_flight(last, item.cell.condition)}"
        ).rstrip()
    return f"Next: nothing for this question. {_flight(last, _drawn(last))}".rstrip()


def _undecided(last: Flown, found: Sequence[Statement]) -> Iterator[str]:
    """What would decide the conditions that are inconclusive: hours where they are too few, else what the reason asks for."""
    short = [item for item in found if not item.reason]
    if short:
        item = max(short, key=lambda s: s.worst.upper)
        where = item.cell.condition.label
        if item.worst.rate > 0.0:
            yield f"more flight hours in {where} ([aleatory] flights), or a narrower model."
            yield from filter(None, [_flight(last, item.cell.condition)])
        else:
            hours = item.quiet_hours_needed
            yield f"fly {hours:.3g} h per corner in {where} ([aleatory] flights); that much without an excursion is a yes."
    for reason in dict.fromkeys(item.reason for item in found if item.reason):
        here = [item for item in found if item.reason == reason]
        advice = "raise [metrics] dispersion" if here[0].dispersion.beyond else "remove the cause"
        yield f"{advice} for {', '.join(item.cell.condition.label for item in here)}: {reason}, which more hours do not change."


def _widest(last: Flown, condition: Condition) -> str:
    rows = [
        r
        for r in last.shares
        if r["condition"] == condition.label and r["metric"] == _TRACK and r["share_max"]
    ]
    if not rows:
        return ""
    first = max(rows, key=lambda row: float(row["share_max"]))
    return f"{first['coefficient']} makes {100 * float(first['share_max']):.0f} % of the cross-track p-box"


def _flight(last: Flown, condition: Condition) -> str:
    widest = _widest(last, condition)
    return (
        f"{widest}; uqharness next-flight {last.folder} --out DIR plans a flight for it."
        if widest
        else ""
    )
