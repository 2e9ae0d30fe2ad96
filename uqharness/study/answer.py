"""The answer of a study in four lines: answer, why, what the model lacked and what adding it bought, what to do next."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.digests import sha256_hex
from sysid.model_form import MIN_SHARE_INSIDE
from sysid.units import counted, percent
from uqharness.campaign import (
    CONFIDENCE,
    Condition,
    Statement,
    cases,
    find_mission,
    hardest_of,
    in_condition,
    make_copy,
    needs_copy,
    read_sensitivity,
    samples,
)
from uqharness.campaign.conditions import conditions
from uqharness.campaign.execution import ProcessExecutor
from uqharness.campaign.folder import (
    read_cases,
    read_complete,
    read_decisions,
    read_manifest,
    spec_of,
)
from uqharness.campaign.statements import statements
from uqharness.errors import BadInputError
from uqharness.files import scratch_folder
from uqharness.flight import FlightResult, FlightSpec, record_mission, staged_mission
from uqharness.parallel import process_count
from uqharness.parquet_files import write_table
from uqharness.replay import shown_channel
from uqharness.result_documents import Coverage, Fit, Part, read_document
from uqharness.simulator import Source
from uqharness.statistics import NO, OPEN, YES, Sample, envelope
from uqharness.statistics.pbox import pbox
from uqharness.study.spec import ChainSpec
from uqharness.study.stages import AFTER, BEFORE, Stage

if TYPE_CHECKING:
    import pandas as pd


# What two campaigns of a study say of the aircraft's performance, before and after refinement,
# in sentences.

Sentence = tuple[str, str]
"""Text and level: good where a claim was tested and held, warn, bad, or empty for a plain fact."""
GOOD, WARN, BAD, PLAIN = "good", "warn", "bad", ""

_QUANTITIES = (
    ("cross_track_median_m", "cross-track error", "m"),
    ("altitude_median_m", "altitude error", "m"),
    ("speed_median_mps", "speed error", "m/s"),
    ("heading_median_deg", "heading error", "deg"),
)
_LEVELS = {YES: GOOD, NO: BAD, OPEN: WARN}
_ANSWERS = {YES: "yes", NO: "no", OPEN: "inconclusive"}
TOO_FEW = "too few flight hours"
"""Why an answer is inconclusive whose statement gives no other reason."""
CONDITIONS_TOLD = 4
"""Conditions that are told one by one; of more than that, the hardest, with all of them counted."""
MUCH_OUTSIDE = 0.1
SAME = 0.02
"""Relative change of a width below which it is called unchanged."""


@dataclass(frozen=True)
class Width:
    """How wide a p-box is: the area between its sides [unit of the metric], and its median [low, high].

    Infinite, with the reason, where flights failed: their error may be anything.
    """

    area: float
    median: tuple[float, float]
    reason: str = ""


@dataclass(frozen=True)
class Flown:
    """A finished campaign: its folder, flights, settings, statements, and the rows of its sensitivity.csv."""

    folder: Path
    frame: pd.DataFrame
    campaign: Mapping[str, Any]
    signed: list[Statement]
    shares: list[dict[str, str]]


def read_flown(out: Path, both: bool) -> dict[str, Flown]:
    """The campaigns in a study's folder by when they were flown; ``both``: before and after refinement. Raises BadInputError."""
    return {
        when: _read(out / f"campaign-{when}") for when in ((BEFORE, AFTER) if both else (BEFORE,))
    }


def _read(folder: Path) -> Flown:
    manifest = read_complete(folder)
    frame, campaign = read_cases(folder, manifest), manifest["campaign"]
    signed = statements(frame, campaign, read_decisions(folder, manifest))
    return Flown(folder, frame, campaign, signed, read_sensitivity(folder, manifest) or [])


def performance(flown: Mapping[str, Flown]) -> Iterator[Sentence]:
    """Sentences about the campaigns of a study, one or before and after refinement."""
    both = AFTER in flown
    last = flown[AFTER if both else BEFORE]
    found = conditions(last.frame)
    if not any(_asked(last.signed, condition) for condition in found):
        yield "No excursion can be counted: this aircraft publishes no distance from a path.", WARN
    elif len(found) > 1:
        yield _tally(last)
    told = found if len(found) <= CONDITIONS_TOLD else [hardest_of(found)]
    for condition in told:
        for item in _asked(last.signed, condition):
            yield _excursions(item, _same(flown[BEFORE].signed, item) if both else None)
        for metric, words, unit in _QUANTITIES:
            sides = {
                when: width_of(in_condition(item.frame, condition), metric)
                for when, item in flown.items()
            }
            present = [side for side in sides.values() if side is not None]
            if len(present) == len(sides):
                yield _pbox_sentence(
                    words, unit, condition, float(last.campaign["aleatory"]["duration_s"]), present
                )
        yield from _widest(last.shares, condition)
        # Bounds that are numbers hold everywhere: only those of a model form have an outside.
        if isinstance(last.campaign["epistemic"].get("bounds"), str):
            yield from _outside(in_condition(last.frame, condition), condition)
    yield _ended(flown)


def asked_of(flown: Flown) -> list[Statement]:
    """The statements about the smallest radius, one a condition; none where no distance from a path is known."""
    return [
        item for condition in conditions(flown.frame) for item in _asked(flown.signed, condition)
    ]


def answer_words(item: Statement) -> str:
    """The answer in words; of an inconclusive one with the reason."""
    return (
        f"{_ANSWERS[item.answer]} ({item.reason or TOO_FEW})"
        if item.answer == OPEN
        else _ANSWERS[item.answer]
    )


def _asked(signed: Sequence[Statement], condition: Condition) -> list[Statement]:
    """The statement about the smallest radius, which is what is asked; none where no distance from a path is known."""
    here = [
        item
        for item in signed
        if item.cell.condition == condition and item.cell.distance == "horizontal"
    ]
    return sorted(here, key=lambda item: item.cell.radius_m)[:1]


def _same(signed: Sequence[Statement], wanted: Statement) -> Statement | None:
    def key(item: Statement) -> tuple[Condition, float, str]:
        return item.cell.condition, item.cell.radius_m, item.cell.distance

    return next((item for item in signed if key(item) == key(wanted)), None)


def _tally(flown: Flown) -> Sentence:
    """The answers of all conditions, counted, for the smallest radius."""
    asked = asked_of(flown)
    radius = asked[0].cell.radius_m
    words = []
    for answer in (YES, NO, OPEN):
        named = [item.cell.condition.label for item in asked if item.answer == answer]
        if named:
            words.append(f"{_ANSWERS[answer]} in {len(named)} ({', '.join(named)})")
    text = f"At most {counted(asked[0].acceptable_per_h, 'excursion')} beyond {radius:g} m per flight hour at every corner? "
    text += f"Of {len(asked)} conditions: "
    answers = {item.answer for item in asked}
    return text + "; ".join(
        words
    ) + ".", BAD if NO in answers else WARN if OPEN in answers else GOOD


def _excursions(item: Statement, before: Statement | None) -> Sentence:
    cell = item.cell
    asked = (
        f"In {cell.condition.words}: at most {counted(item.acceptable_per_h, 'excursion')} beyond {cell.radius_m:g} m per flight hour "
        f"at every corner? {answer_words(item).capitalize()}: {_rates(item)}"
    )
    if item.flight_share:
        asked += f"; {item.flight_share}"
    if before is None:
        return asked + ".", _LEVELS[item.answer]
    return f"{asked}. Before refinement: {_ANSWERS[before.answer]}, {_rates(before)}.", _LEVELS[
        item.answer
    ]


def _rates(item: Statement) -> str:
    hours = max((rate.hours for rate in item.cell.rates), default=0.0)
    if hours <= 0.0 or math.isnan(item.worst.rate):
        return "undefined, for no flight was scored"
    sure = f"{100 * CONFIDENCE:g} % upper limit"
    upper = (
        f"no finite {sure}" if math.isinf(item.worst.upper) else f"{sure} {item.worst.upper:.3g}/h"
    )
    return (
        f"{item.best.rate:.3g} (best corner) to {item.worst.rate:.3g} (worst) per hour in {hours:.3g} h per corner, "
        f"{upper} at the worst corner"
    )


def width_of(rows: pd.DataFrame, metric: str) -> Width | None:
    """Width of the p-box of one condition's flights; None where no flight has the metric."""
    if metric not in rows:
        return None
    found = samples(rows, metric)
    if not any(sample.values.size for sample in found):
        return None
    median = pbox(found, CONFIDENCE).quantile(0.5)
    unknown = sum(sample.unknown for sample in found)
    if unknown:
        return Width(
            math.inf,
            median,
            f"{unknown} of {len(rows)} flights have no such error, which leaves its sides open",
        )
    return Width(area(found), median)


def area(found: Sequence[Sample]) -> float:
    """Area between the envelopes of the samples' distribution functions, in the unit of the values; none may be unknown."""
    values = np.unique(np.concatenate([sample.values for sample in found]))
    lower, upper = envelope(found, values)
    return float(np.sum((upper - lower)[:-1] * np.diff(values)))


def _pbox_sentence(
    words: str, unit: str, condition: Condition, duration_s: float, sides: Sequence[Width]
) -> Sentence:
    text = f"Median {words} of a typical {duration_s:g} s flight, best to worst corner: "
    if len(sides) == 1:
        return f"{text}{_span(sides[0])} {unit} ({condition.label}).", PLAIN if not sides[
            0
        ].reason else WARN
    before, after = sides
    text += f"{_span(before)} {unit} before refinement, {_span(after)} {unit} after ({condition.label}); "
    if after.reason:
        return f"{text}the p-box after refinement has no finite width: {after.reason}.", WARN
    if before.reason:
        return (
            f"{text}the p-box became narrower: before, {before.reason}; after, none lacks it.",
            PLAIN,
        )
    if before.area == 0.0:
        return f"{text}the p-box had no width before.", WARN
    ratio = after.area / before.area
    sizes = f"mean width {before.area:.3g} {unit} before, {after.area:.3g} {unit} after"
    if ratio < 1.0 - SAME:
        return f"{text}the p-box became narrower by {100 * (1 - ratio):.0f} % ({sizes}).", PLAIN
    if ratio > 1.0 + SAME:
        return (
            f"{text}the p-box did NOT become narrower, it is {100 * (ratio - 1):.0f} % wider ({sizes}).",
            WARN,
        )
    return f"{text}the p-box did NOT become narrower ({sizes}).", WARN


def _span(side: Width) -> str:
    low, high = side.median
    return f"at least {low:.3g}" if math.isinf(high) else f"{low:.3g} to {high:.3g}"


def _ended(flown: Mapping[str, Flown]) -> Sentence:
    parts, failed_any, lost_any = [], False, False
    for when, item in flown.items():
        frame = item.frame
        failed, lost = (
            int((frame["status"] != "ok").sum()),
            int(frame["loss_of_control"].fillna(0).sum()),
        )
        parts.append(
            f"{len(frame)} {when if len(flown) > 1 else ''}".strip()
            + f" ({failed} failed, control lost in {lost})"
        )
        failed_any, lost_any = failed_any or failed > 0, lost_any or lost > 0
    level = BAD if lost_any else WARN if failed_any else PLAIN
    return (
        f"Flights: {', '.join(parts)}; a failed flight is bounded at the worst, never dropped.",
        level,
    )


def _outside(rows: pd.DataFrame, condition: Condition) -> Iterator[Sentence]:
    share = rows["extrapolated_share"].mean()
    if not math.isnan(share):
        text = f"{percent(share)} of the scored time in {condition.words} was flown outside the states that the bounds come from"
        yield (
            (text + (", where they are extrapolated." if share > 0 else ".")),
            WARN if share > MUCH_OUTSIDE else PLAIN,
        )


def _widest(shares: Sequence[Mapping[str, str]], condition: Condition) -> Iterator[Sentence]:
    """Which coefficient's bounds give each p-box most of its width, from sensitivity.csv; nothing where that is undefined."""
    rows = [row for row in shares if row["condition"] == condition.label and row["share_max"]]
    parts = []
    for metric, words, _ in _QUANTITIES:
        of_metric = [row for row in rows if row["metric"] == metric]
        if of_metric:
            first = max(of_metric, key=lambda row: float(row["share_max"]))
            low, high = (100 * float(first[key]) for key in ("share_min", "share_max"))
            parts.append(
                f"{first['coefficient']} ({words}, {low:.0f} to {high:.0f} % of the width)"
            )
    if parts:
        yield (
            f"What a next flight should reduce in {condition.words}: the bounds of {'; '.join(parts)}.",
            PLAIN,
        )


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


def _answer_widest(last: Flown, condition: Condition) -> str:
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
    widest = _answer_widest(last, condition)
    return (
        f"{widest}; uqharness next-flight {last.folder} --out DIR plans a flight for it."
        if widest
        else ""
    )


# What a study found, in sentences computed from its stages' results: the answer first, then
# what it rests on.

REFINEMENT = Path("refine") / "refinement.json"
_ABOVE_NOISE = 1.15  # as `compare` and `refine` have it


def judge(
    spec: ChainSpec,
    stages: Sequence[Stage],
    rows: Sequence[Mapping[str, Any]],
    out: Path,
    flown: Mapping[str, Flown],
) -> list[Sentence]:
    """Every sentence, from what the stages left in ``out`` and the campaigns ``flown``.

    Raises BadInputError for a document that is damaged.
    """
    kinds = {stage.kind for stage in stages}
    codes = {row["name"]: row["exit"] for row in rows}
    found: list[Sentence] = []
    if flown:
        found += performance(flown)
    if "refine" in kinds:
        found += _of_refinement(out / REFINEMENT)
    if "validate-bounds" in kinds:
        found += _coverage(out, spec.bounds.validate_on if spec.bounds else (), "refine" in kinds)
    if "identify" in kinds:
        found.append(
            _identified(read_document(out / "identify" / "fit.json", Fit), codes["identify"])
        )
    ended = [
        stage.name.removeprefix("fly-")
        for stage in stages
        if stage.kind == "fly" and codes[stage.name] == 1
    ]
    if ended:
        found.append(
            (
                f"Flown but ended early: {', '.join(ended)}; what was recorded until then was used.",
                WARN,
            )
        )
    return found


def _of_refinement(path: Path) -> list[Sentence]:
    document = read_document(path, Part)
    try:
        return list(_refined(document))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise BadInputError(
            f"{path}: is no refinement's document ({error}); run the study again"
        ) from None


def _refined(document: Mapping[str, Any]) -> Iterator[Sentence]:
    effects = [e for e in document["effects"] if not e["withdrawn"]]
    flights = f"from {', '.join(_stems(document['train']))}"
    if effects:
        named = "; ".join(
            f"{e['name']}, {e['value']:.4g} ± {e['std']:.2g}{'' if e['unit'] in ('', '1') else ' ' + e['unit']}"
            + (f" ({e['property']})" if e["property"] else "")
            for e in effects
        )
        yield (
            f"Refinement named, {flights}: {named}.",
            GOOD if document["verdict"] == "effects-found" else WARN,
        )
    elif document["verdict"] == "no-missing-effect":
        yield f"Refinement found nothing missing {flights}.", GOOD
    if document["verdict"] == "unexplained":
        yield "Refinement leaves something unexplained: " + _unexplained(document) + ".", BAD
    test = document["gap"]["test"]
    # In turbulence replays hold what the gusts did, and predictions judge.
    predictions = test.get("predictions") or {}
    gap = predictions or test["channels"]
    ratios = {
        c: (g["rms_before"] / g["noise_rms"], g["rms_after"] / g["noise_rms"])
        for c, g in gap.items()
        if all(g[k] is not None for k in g) and g["noise_rms"] > 0.0
    }
    whose = "rms of one-step predictions" if predictions else "rms"
    flown = f"On the hold-out flights ({', '.join(_stems(document['test']))}) {whose} over noise"
    above = {c: r for c, r in ratios.items() if max(r) > _ABOVE_NOISE}
    if not above:
        most = max((max(r) for r in ratios.values()), default=math.nan)
        yield f"{flown} is at most {most:.2f} in every channel, before and after.", GOOD
        return
    words = ", ".join(
        f"{c} {b:.2f} to {a:.2f}"
        for c, (b, a) in sorted(above.items(), key=lambda item: -max(item[1]))
    )
    shrank = all(a <= b * (1 + SAME) for b, a in above.values())
    reached = all(a <= _ABOVE_NOISE for _, a in above.values())
    yield (
        f"{flown} went, from before to after: {words} (1: the sensors' noise).",
        GOOD if shrank and reached else WARN,
    )


def _stems(names: Sequence[str]) -> list[str]:
    return [Path(name).stem for name in names]


def _unexplained(document: Mapping[str, Any]) -> str:
    withdrawn = [e["name"] for e in document["effects"] if e["withdrawn"]]
    if withdrawn:
        return (
            f"{', '.join(withdrawn)} did not shrink the gap on the test flights and was withdrawn"
        )
    where = [
        w.get("words") or w.get("coefficient", "")
        for w in document["remaining"]["where"]
        if "words" in w or "t" not in w
    ]
    return (
        "; ".join(w for w in where if w) or "the residuals are not white, and no place stands out"
    )


def _coverage(out: Path, flights: Sequence[str], both: bool) -> Iterator[Sentence]:
    documents = {
        when: read_document(out / f"validate-{when}" / "coverage.json", Coverage)
        for when in ((BEFORE, AFTER) if both else (BEFORE,))
    }
    found = {when: document["coverage"] for when, document in documents.items()}
    named = ", ".join(flights)
    for when, coverage in found.items():
        shares = {c: row["0.95"] for c, row in coverage.items()}
        low, high = min(shares, key=lambda c: shares[c]), max(shares, key=lambda c: shares[c])
        which = f" {when} refinement" if both else ""
        text = f"Of {named}, {100 * shares[low]:.1f} % ({low}) to {100 * shares[high]:.1f} % ({high}) lies inside"
        text += f" the 95 % bounds{which}"
        verdicts = documents[when].get("verdicts", {})
        bad = [c for c, said in verdicts.items() if said == "fails"] or [
            c for c in shares if not shares[c] >= MIN_SHARE_INSIDE
        ]
        open_ = [c for c, said in verdicts.items() if said == "inconclusive"]
        if bad:
            text += f": those of {', '.join(bad)} do not hold."
        elif open_:
            text += f": too short a flight to tell of {', '.join(open_)}."
        else:
            text += "."
        yield text, BAD if bad else WARN if open_ else GOOD
    if both:
        widths = {
            w: {c: row["mean_width"] for c, row in coverage.items()}
            for w, coverage in found.items()
        }
        change = {
            c: _change(widths[BEFORE][c], width)
            for c, width in widths[AFTER].items()
            if c in widths[BEFORE]
        }
        moved = ", ".join(f"{c} {100 * x:+.0f} %" for c, x in change.items() if abs(x) > SAME)
        still = ", ".join(c for c, x in change.items() if abs(x) <= SAME)
        unknown = ", ".join(c for c, x in change.items() if math.isnan(x))
        ends = (
            (moved, ""),
            (still, " as before"),
            (unknown, " undefined, a width is 0 or not known"),
        )
        words = "; ".join(names + end for names, end in ends if names)
        text = f"Mean width of the bounds on {named}, after against before refinement: {words}"
        shrank = [c for c, x in change.items() if x < -SAME]
        yield f"{text}{'' if shrank else '; none is narrower'}.", PLAIN if shrank else WARN


def _change(before: float | None, after: float | None) -> float:
    """Relative change; NaN where one is not known or there was nothing to change from."""
    return math.nan if not before or after is None else after / before - 1.0


def _identified(document: Mapping[str, Any], code: int) -> Sentence:
    done = [row for row in document["parameters"].values() if row["status"] == "identified"]
    flights = ", ".join(_stems(document["flights"]))
    text = f"{len(done)} of {len(document['parameters'])} parameters were identified from {flights} by {document['method']}"
    ratios = {
        c: v["rms"] / v["noise"]
        for c, v in document["fit"].items()
        if v["rms"] is not None and v["noise"]
    }
    worst = max(ratios, key=lambda c: ratios[c], default="")
    if worst:
        text += f"; the largest residual is {ratios[worst]:.2f} times the noise ({worst})"
    if code:
        return f"{text}. The estimation did NOT converge, or nothing was identified.", BAD
    tested = GOOD if worst else PLAIN
    return f"{text}.", tested if not worst or ratios[worst] <= _ABOVE_NOISE else WARN


# Ground tracks beside the answer: the model and its worst corner, before and after, in the same
# air of the hardest condition.

TRACKS = "tracks.parquet"
NOMINAL, WORST = "nominal", "worst corner"
_LARGEST = "cross_track_max_m"
_DISTANCE = "cross_track"
_RATE_HZ = 5.0
_NORTH, _EAST = "nav/north-m", "nav/east-m"


@dataclass(frozen=True)
class Asked:
    """A finished campaign: its folder, its flights, and the statement of the smallest radius in the condition drawn, if any."""

    folder: Path
    frame: pd.DataFrame
    statement: Statement | None


def fly_tracks(out: Path, asked: Mapping[str, Asked], workers: int | None = None) -> dict[str, Any]:
    """Fly them into ``out``/tracks.parquet; what study.json keeps of it. ``asked``: when -> campaign, the last one chooses the air.

    The air is that in which the last campaign's worst corner went farthest from its path. Columns: when, model (``nominal``:
    plugin off; ``worst corner``), epistemic_id, time_s, north_m, east_m, distance_m. Without such flights the reason is told.
    """
    *_, last = asked.values()
    air = None if any(item.statement is None for item in asked.values()) else _tracks_air(last)
    if air is None or last.statement is None:
        return {"reason": "no flight of the hardest condition has a distance from its path"}
    condition = last.statement.cell.condition
    try:
        flights = {
            (when, model, name): spec
            for when, item in asked.items()
            for model, name, spec in _flights(item, air)
        }
        import pandas as pd
        import pyarrow as pa

        frame = pd.concat(_flown(flights, workers), ignore_index=True)
        write_table(pa.Table.from_pandas(frame, preserve_index=False), out / TRACKS)
    except BadInputError as error:
        return {"reason": str(error)}
    return {
        "wind_mps": condition.wind_mps,
        "turbulence": condition.turbulence,
        "aleatory_id": air,
        "radius_m": last.statement.cell.radius_m,
    }


def hardest(found: Sequence[Statement]) -> Statement | None:
    """The statement about the smallest radius in the hardest condition; None where no distance from a path is known."""
    here = [item for item in found if item.cell.distance == "horizontal"]
    if not here:
        return None
    condition = hardest_of(item.cell.condition for item in here)
    return min(
        (item for item in here if item.cell.condition == condition),
        key=lambda item: item.cell.radius_m,
    )


def _tracks_air(asked: Asked) -> int | None:
    """The air in which the worst corner went farthest."""
    assert asked.statement is not None
    rows = in_condition(asked.frame, asked.statement.cell.condition)
    rows = rows[
        (rows["epistemic_id"] == asked.statement.worst.epistemic_id) & (rows["status"] == "ok")
    ]
    if _LARGEST not in rows or rows[_LARGEST].isna().any() or rows.empty:
        return None
    return int(rows["aleatory_id"].iloc[int(rows[_LARGEST].to_numpy(dtype=float).argmax())])


def _flights(asked: Asked, air: int) -> Iterator[tuple[str, str, FlightSpec]]:
    """Model, epistemic id and flight of both: that of the worst corner as the campaign flew it, and without the plugin's deltas."""
    spec = spec_of(read_manifest(asked.folder))
    mission = find_mission(spec, asked.folder)
    if needs_copy(spec):
        make_copy(spec, mission, asked.folder)
    assert asked.statement is not None
    condition = asked.statement.cell.condition
    part = cases.Part(range(air, air + 1), ((condition.wind_mps, condition.turbulence),))
    wanted = asked.statement.worst.epistemic_id
    case = next(
        case for case in cases.build_cases(spec, mission, part) if case.epistemic_id == wanted
    )
    plain = {
        name: value for name, value in case.flight.properties.items() if not name.startswith("uq/")
    }
    yield NOMINAL, "", replace(case.flight, properties=plain, levels=None, transient=None)
    yield WORST, wanted, case.flight


@dataclass(frozen=True)
class _Recorder:
    """A flight function for a worker: flies in JSBSim and leaves place and distance from the path in ``folder``."""

    folder: Path

    def __call__(self, spec: FlightSpec) -> FlightResult:
        import pandas as pd

        mission = staged_mission(spec)
        metric = mission.aircraft.card.metrics.get(_DISTANCE)
        if metric is None:
            raise BadInputError(
                f"{mission.aircraft.name}: its card has no metric {_DISTANCE}, so no track can be drawn beside a path"
            )
        table = {
            "north_m": Source(_NORTH),
            "east_m": Source(_EAST),
            "distance_m": Source(metric.true),
        }
        flown = record_mission(mission, replace(spec, record_rate_hz=_RATE_HZ), table)
        pd.DataFrame(flown.signals).to_parquet(self.folder / _file(spec), index=False)
        return FlightResult(flown.status, flown.reason, flown.flown_s, {}, {}, {})


def _timeout_s(flight: FlightSpec) -> float:
    return 120.0 + 0.5 * (flight.duration_s + flight.burn_in_s)


def _file(spec: FlightSpec) -> str:
    return sha256_hex(repr(spec).encode()) + ".parquet"


def _flown(
    flights: Mapping[tuple[str, str, str], FlightSpec], workers: int | None
) -> Iterator[pd.DataFrame]:
    import pandas as pd

    numbered = {str(k): spec for k, spec in enumerate(flights.values())}
    with scratch_folder() as scratch:
        folder = scratch.path
        executor = ProcessExecutor(process_count(workers), timeout_s=_timeout_s, retries=0)
        for outcome in (
            item for batch in executor.run(_Recorder(folder), numbered.items()) for item in batch
        ):
            if not (folder / _file(numbered[outcome.case_id])).is_file():
                raise BadInputError(
                    f"the flights of the ground track were not flown: {outcome.reason or outcome.status}"
                )
        for (when, model, name), spec in flights.items():
            frame = pd.read_parquet(folder / _file(spec))
            frame.insert(0, "when", when)
            frame.insert(1, "model", model)
            frame.insert(2, "epistemic_id", name)
            yield frame
