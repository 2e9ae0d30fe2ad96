"""State the results of a study in sentences: an answer in four lines, and a verdict.

The answer says whether the acceptable rate of excursions is met at every corner of the model-form
bounds, why, which effects the model lacked, and what to do next. The verdict lists one sentence
with a level for each claim about performance, refinement, bounds and identification. All numbers
come from the files that the stages of the study wrote (cases, statements, sensitivity.csv,
refinement.json, coverage.json, fit.json).

`fly_tracks` records ground tracks of the model and of its worst corner, before and after
refinement, in the same air.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.foreign.regular_files import sha256_hex
from sysid.model_form import MIN_SHARE_INSIDE
from sysid.units import counted, percent
from uqharness.campaign import (
    CONFIDENCE,
    Condition,
    Document,
    ProcessExecutor,
    Statement,
    cases,
    find_mission,
    hardest_condition,
    in_condition,
    make_copy,
    needs_copy,
    read_cases,
    read_complete,
    read_decisions,
    read_manifest,
    read_sensitivity,
    samples,
    spec_of,
)
from uqharness.campaign.conditions import conditions
from uqharness.campaign.statements import statements
from uqharness.errors import BadInputError
from uqharness.files import scratch_folder
from uqharness.flight import FlightResult, FlightSpec, record_mission, staged_mission
from uqharness.parallel import process_count
from uqharness.parquet_files import write_table
from uqharness.replay import shown_channel
from uqharness.results.base import read_result
from uqharness.results.identification import Coverage, Fit
from uqharness.results.refinement import Refinement
from uqharness.results.study import Stage as StageResult
from uqharness.results.study import StudyAnswer
from uqharness.simulator import Source
from uqharness.statistics import NO, OPEN, YES, Sample, envelope
from uqharness.statistics.pbox import pbox
from uqharness.study.spec import ChainSpec
from uqharness.study.stages import AFTER, BEFORE, Stage

if TYPE_CHECKING:
    import pandas as pd


# Performance before and after refinement, from the two campaigns of a study.

Sentence = tuple[str, str]
"""Text and level: good for a claim that was tested and holds, warn, bad, or empty for a fact."""
LEVEL_GOOD, LEVEL_WARN, LEVEL_BAD, LEVEL_PLAIN = "good", "warn", "bad", ""

_QUANTITIES = (
    ("cross_track_median_m", "cross-track error", "m"),
    ("altitude_median_m", "altitude error", "m"),
    ("speed_median_mps", "speed error", "m/s"),
    ("heading_median_deg", "heading error", "deg"),
)
_LEVELS = {YES: LEVEL_GOOD, NO: LEVEL_BAD, OPEN: LEVEL_WARN}
_ANSWERS = {YES: "yes", NO: "no", OPEN: "inconclusive"}
TOO_FEW = "too few flight hours"
"""Reason of an inconclusive answer whose statement has none."""
MAX_CONDITIONS = 4
"""Up to this number all conditions are listed; beyond it only the hardest, and counts."""
LARGE_EXTRAPOLATED_SHARE = 0.1
NEGLIGIBLE_CHANGE = 0.02
"""Relative change of a width that counts as unchanged."""


@dataclass(frozen=True)
class Width:
    """Width of a p-box.

    Attributes
    ----------
    area : float
        Area between its two distribution functions [unit of the metric]. Infinite if flights
        failed: their error is unbounded.
    median : (float, float)
        Lower and upper bound of the median.
    reason : str
        Why the area is infinite; else empty.
    """

    area: float
    median: tuple[float, float]
    reason: str = ""


@dataclass(frozen=True)
class FlownCampaign:
    """A finished campaign of a study.

    Attributes
    ----------
    folder : Path
        Its folder.
    frame : DataFrame
        One row per flight (cases.parquet).
    settings : Document
        Its settings, from the manifest.
    statements : list of Statement
        Excursion rates against the acceptable rate: one per condition, radius and kind of distance.
    shares : list of dict
        Rows of sensitivity.csv; empty without it.
    """

    folder: Path
    frame: pd.DataFrame
    settings: Document
    statements: list[Statement]
    shares: list[dict[str, str]]


def read_campaigns(out: Path, refined: bool) -> dict[str, FlownCampaign]:
    """Read the campaigns in a study's folder.

    Parameters
    ----------
    out : Path
        The study's folder.
    refined : bool
        Whether the study has a campaign with the refined model.

    Returns
    -------
    dict
        ``before`` and, if ``refined``, ``after`` -> campaign.

    Raises
    ------
    BadInputError
        If a campaign is not finished or its files are damaged.
    """
    return {
        when: _read(out / f"campaign-{when}")
        for when in ((BEFORE, AFTER) if refined else (BEFORE,))
    }


def _read(folder: Path) -> FlownCampaign:
    """Read one finished campaign."""
    manifest = read_complete(folder)
    frame = read_cases(folder, manifest)
    all_statements = statements(frame, manifest.campaign, read_decisions(folder, manifest))
    return FlownCampaign(
        folder, frame, manifest.settings, all_statements, read_sensitivity(folder, manifest) or []
    )


def performance(campaigns: Mapping[str, FlownCampaign]) -> Iterator[Sentence]:
    """Yield sentences on the performance in each condition, before and after refinement.

    Parameters
    ----------
    campaigns : mapping
        ``before`` and possibly ``after`` -> campaign.

    Yields
    ------
    (str, str)
        Text and level.
    """
    refined = AFTER in campaigns
    # With refinement, the refined model is the answer; the other is for comparison.
    last = campaigns[AFTER if refined else BEFORE]
    all_conditions = conditions(last.frame)
    if not any(_tightest_statement(last.statements, condition) for condition in all_conditions):
        yield (
            "No excursion can be counted: this aircraft publishes no distance from a path.",
            LEVEL_WARN,
        )
    elif len(all_conditions) > 1:
        yield _tally(last)
    listed = (
        all_conditions
        if len(all_conditions) <= MAX_CONDITIONS
        else [hardest_condition(all_conditions)]
    )
    for condition in listed:
        for item in _tightest_statement(last.statements, condition):
            yield _excursions(
                item, _matching_statement(campaigns[BEFORE].statements, item) if refined else None
            )
        # P-boxes are compared only if both campaigns have the metric.
        for metric, words, unit in _QUANTITIES:
            sides = {
                when: width_of(in_condition(item.frame, condition), metric)
                for when, item in campaigns.items()
            }
            present = [side for side in sides.values() if side is not None]
            if len(present) == len(sides):
                yield _pbox_sentence(
                    words, unit, condition, last.settings.aleatory.duration_s, present
                )
        yield from _widest(last.shares, condition)
        # Bounds that are numbers hold everywhere: only those of a model form have an outside.
        if isinstance(last.settings.epistemic.bounds, str):
            yield from _extrapolation(in_condition(last.frame, condition), condition)
    yield _flight_counts(campaigns)


def tightest_statements(campaign: FlownCampaign) -> list[Statement]:
    """Return the statements on the smallest radius, one per condition.

    Empty if the aircraft publishes no distance from a path.
    """
    return [
        item
        for condition in conditions(campaign.frame)
        for item in _tightest_statement(campaign.statements, condition)
    ]


def answer_words(item: Statement) -> str:
    """Return the answer in words, with the reason if it is inconclusive."""
    return (
        f"{_ANSWERS[item.answer]} ({item.reason or TOO_FEW})"
        if item.answer == OPEN
        else _ANSWERS[item.answer]
    )


def _tightest_statement(
    all_statements: Sequence[Statement], condition: Condition
) -> list[Statement]:
    """Return the condition's statement on the smallest radius in a list; an empty list if there is
    none.
    """
    horizontal = [
        item
        for item in all_statements
        if item.cell.condition == condition and item.cell.distance == "horizontal"
    ]
    return sorted(horizontal, key=lambda item: item.cell.radius_m)[:1]


def _matching_statement(all_statements: Sequence[Statement], target: Statement) -> Statement | None:
    """Return the statement on the same condition, radius and distance as ``target``."""

    def key(item: Statement) -> tuple[Condition, float, str]:
        return item.cell.condition, item.cell.radius_m, item.cell.distance

    return next((item for item in all_statements if key(item) == key(target)), None)


def _tally(campaign: FlownCampaign) -> Sentence:
    """Count the answers of all conditions for the smallest radius."""
    answered = tightest_statements(campaign)
    radius = answered[0].cell.radius_m
    words = []
    for answer in (YES, NO, OPEN):
        labels = [item.cell.condition.label for item in answered if item.answer == answer]
        if labels:
            words.append(f"{_ANSWERS[answer]} in {len(labels)} ({', '.join(labels)})")
    text = (
        f"At most {counted(answered[0].acceptable_per_h, 'excursion')} beyond {radius:g} m per"
        " flight hour at every corner? "
    )
    text += f"Of {len(answered)} conditions: "
    answers = {item.answer for item in answered}
    return text + "; ".join(words) + ".", (
        LEVEL_BAD if NO in answers else LEVEL_WARN if OPEN in answers else LEVEL_GOOD
    )


def _excursions(item: Statement, before: Statement | None) -> Sentence:
    """State the answer of one condition with its rates, and the answer before refinement."""
    cell = item.cell
    text = (
        f"In {cell.condition.words}: at most {counted(item.acceptable_per_h, 'excursion')} beyond"
        f" {cell.radius_m:g} m per flight hour at every corner? {answer_words(item).capitalize()}:"
        f" {_rates(item)}"
    )
    if item.flight_share:
        text += f"; {item.flight_share}"
    if before is None:
        return text + ".", _LEVELS[item.answer]
    return (
        f"{text}. Before refinement: {_ANSWERS[before.answer]}, {_rates(before)}.",
        _LEVELS[item.answer],
    )


def _rates(item: Statement) -> str:
    """State the excursion rates [1/h] at the best and the worst corner, and the upper limit."""
    hours = max((rate.hours for rate in item.cell.rates), default=0.0)
    # No flight was long enough to be scored.
    if hours <= 0.0 or math.isnan(item.worst.rate):
        return "undefined, for no flight was scored"
    sure = f"{100 * CONFIDENCE:g} % upper limit"
    upper = (
        f"no finite {sure}" if math.isinf(item.worst.upper) else f"{sure} {item.worst.upper:.3g}/h"
    )
    return (
        f"{item.best.rate:.3g} (best corner) to {item.worst.rate:.3g} (worst) per hour in"
        f" {hours:.3g} h per corner, {upper} at the worst corner"
    )


def width_of(rows: pd.DataFrame, metric: str) -> Width | None:
    """Compute the width of the p-box of a metric in one condition.

    Parameters
    ----------
    rows : DataFrame
        Flights of the condition.
    metric : str
        Column of the metric.

    Returns
    -------
    Width or None
        None if no flight has the metric.
    """
    if metric not in rows:
        return None
    groups = samples(rows, metric)
    if not any(sample.values.size for sample in groups):
        return None
    median = pbox(groups, CONFIDENCE).quantile(0.5)
    # A flight without the metric may have had any value.
    unknown = sum(sample.unknown for sample in groups)
    if unknown:
        return Width(
            math.inf,
            median,
            f"{unknown} of {len(rows)} flights have no such error, which leaves its sides open",
        )
    return Width(area(groups), median)


def area(groups: Sequence[Sample]) -> float:
    """Integrate the area between the envelopes of several empirical distribution functions.

    Parameters
    ----------
    groups : sequence of Sample
        One per corner; no value may be unknown.

    Returns
    -------
    float
        Area, in the unit of the values.

    Examples
    --------
    >>> import numpy as np
    >>> from uqharness.statistics import Sample
    >>> round(area([Sample("0", np.array([1.0, 2.0])), Sample("1", np.array([1.5, 2.5]))]), 6)
    0.5
    """
    # The envelopes are step functions that change only at samples.
    values = np.unique(np.concatenate([sample.values for sample in groups]))
    lower, upper = envelope(groups, values)
    return float(np.sum((upper - lower)[:-1] * np.diff(values)))


def _pbox_sentence(
    words: str, unit: str, condition: Condition, duration_s: float, widths: Sequence[Width]
) -> Sentence:
    """State the median of a metric, and whether its p-box became narrower.

    ``widths`` has the width before refinement and, in a study with refinement, the width after.
    """
    text = f"Median {words} of a typical {duration_s:g} s flight, best to worst corner: "
    if len(widths) == 1:
        return f"{text}{_span(widths[0])} {unit} ({condition.label}).", (
            LEVEL_PLAIN if not widths[0].reason else LEVEL_WARN
        )
    before, after = widths
    text += (
        f"{_span(before)} {unit} before refinement, {_span(after)} {unit} after"
        f" ({condition.label}); "
    )
    if after.reason:
        return f"{text}the p-box after refinement has no finite width: {after.reason}.", LEVEL_WARN
    if before.reason:
        return (
            f"{text}the p-box became narrower: before, {before.reason}; after, none lacks it.",
            LEVEL_PLAIN,
        )
    if before.area == 0.0:
        return f"{text}the p-box had no width before.", LEVEL_WARN
    # A change below 2 % counts as none.
    ratio = after.area / before.area
    sizes = f"mean width {before.area:.3g} {unit} before, {after.area:.3g} {unit} after"
    if ratio < 1.0 - NEGLIGIBLE_CHANGE:
        return (
            f"{text}the p-box became narrower by {100 * (1 - ratio):.0f} % ({sizes}).",
            LEVEL_PLAIN,
        )
    if ratio > 1.0 + NEGLIGIBLE_CHANGE:
        return (
            (
                f"{text}the p-box did NOT become narrower, it is {100 * (ratio - 1):.0f} % wider"
                f" ({sizes})."
            ),
            LEVEL_WARN,
        )
    return f"{text}the p-box did NOT become narrower ({sizes}).", LEVEL_WARN


def _span(side: Width) -> str:
    """State the bounds of the median."""
    low, high = side.median
    return f"at least {low:.3g}" if math.isinf(high) else f"{low:.3g} to {high:.3g}"


def _flight_counts(campaigns: Mapping[str, FlownCampaign]) -> Sentence:
    """Count failed flights and losses of control."""
    parts, any_failed, any_lost_control = [], False, False
    for when, item in campaigns.items():
        frame = item.frame
        failed, lost_control = (
            int((frame["status"] != "ok").sum()),
            int(frame["loss_of_control"].fillna(0).sum()),
        )
        parts.append(
            f"{len(frame)} {when if len(campaigns) > 1 else ''}".strip()
            + f" ({failed} failed, control lost in {lost_control})"
        )
        any_failed, any_lost_control = (
            any_failed or failed > 0,
            any_lost_control or lost_control > 0,
        )
    level = LEVEL_BAD if any_lost_control else LEVEL_WARN if any_failed else LEVEL_PLAIN
    return (
        f"Flights: {', '.join(parts)}; a failed flight is bounded at the worst, never dropped.",
        level,
    )


def _extrapolation(rows: pd.DataFrame, condition: Condition) -> Iterator[Sentence]:
    """State how much of the scored time was outside the states of the flights that the bounds come
    from; yield nothing where that is undefined.
    """
    share = rows["extrapolated_share"].mean()
    if not math.isnan(share):
        text = (
            f"{percent(share)} of the scored time in {condition.words} was outside the flight"
            " states of the bounds' data"
        )
        yield (
            (text + (", where they are extrapolated." if share > 0 else ".")),
            LEVEL_WARN if share > LARGE_EXTRAPOLATED_SHARE else LEVEL_PLAIN,
        )


def _widest(shares: Sequence[Mapping[str, str]], condition: Condition) -> Iterator[Sentence]:
    """State which coefficient's bounds contribute most to the width of each p-box, from
    sensitivity.csv; yield nothing where that is undefined.
    """
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
            (
                f"What a next flight should reduce in {condition.words}: the bounds of"
                f" {'; '.join(parts)}."
            ),
            LEVEL_PLAIN,
        )


_ORDER = (YES, NO, OPEN)
_CONFIDENCE_WORDS = f"{100 * CONFIDENCE:g} %"
_TRACK = "cross_track_median_m"
_MAX_NAMES = 3
"""Number of effects that a line names."""


def answer_of(
    campaigns: Mapping[str, FlownCampaign],
    refinement: Refinement | None,
    verdict: Sequence[tuple[str, str]],
    refused_stages: Sequence[str] = (),
) -> StudyAnswer:
    """Compute the answer of a study.

    Parameters
    ----------
    campaigns : mapping
        ``before`` and possibly ``after`` -> finished campaign; may be empty.
    refinement : Refinement or None
        Content of refinement.json.
    verdict : sequence of (str, str)
        All sentences of the study; the worst one is the reason if no campaign counts excursions.
    refused_stages : sequence of str
        Stages that ended with exit code 1.
    """
    last = campaigns.get(AFTER) or campaigns.get(BEFORE)
    answered = tightest_statements(last) if last is not None else []
    remark = (
        f" These stages answered no: {', '.join(refused_stages)} (log/STAGE.txt)."
        if refused_stages
        else ""
    )
    # Nothing to answer with: state why, and the worst sentence of the verdict.
    if last is None or not answered:
        first = next(
            (s for level in (LEVEL_BAD, LEVEL_WARN) for s in verdict if s[1] == level),
            verdict[0] if verdict else ("", ""),
        )
        reason = (
            "no campaign was run"
            if last is None
            else "the aircraft publishes no distance from a path"
        )
        text = f"No excursion rate: {reason}."
        lacked = (
            ""
            if refinement is None
            else _missing_effects_line(refinement, campaigns, same_answers=False)
        )
        return StudyAnswer(
            level=LEVEL_WARN,
            answer=text,
            why=first[0],
            lacked=lacked,
            next=f"Next: give the study a campaign that counts excursions.{remark}",
        )
    answers = {item.cell.condition: item.answer for item in answered}
    # The level is good or bad only if all conditions agree.
    level = _LEVELS[answered[0].answer] if len(set(answers.values())) == 1 else LEVEL_WARN
    first_words = _group_by_answer(answered)
    text = f"{first_words[:1].upper()}{first_words[1:]} ({_CONFIDENCE_WORDS} confidence)."
    # Only conditions whose answer changed are repeated.
    before = tightest_statements(campaigns[BEFORE]) if AFTER in campaigns else []
    changed = [item for item in before if answers.get(item.cell.condition) != item.answer]
    if changed:
        text += f" Before refinement: {_group_by_answer(changed)}."
    lacked = (
        ""
        if refinement is None
        else _missing_effects_line(refinement, campaigns, same_answers=not changed)
    )
    return StudyAnswer(
        level=level,
        answer=text,
        why=_reason_line(answered),
        lacked=lacked,
        next=f"{_next_step(last, answered)}{remark}",
    )


def _group_by_answer(answered: Sequence[Statement]) -> str:
    """List conditions by answer, in the order yes, no, inconclusive: ``yes in 3 and 7 m/s, no in 12
    m/s wind with light turbulence``.
    """
    by_answer: dict[str, list[Condition]] = {}
    for item in sorted(answered, key=lambda s: _ORDER.index(s.answer)):
        by_answer.setdefault(answer_words(item), []).append(item.cell.condition)
    airs = {item.cell.condition.turbulence for item in answered}
    # If all conditions have the same turbulence, it is named once.
    if len(airs) == 1:
        return (
            f"{', '.join(f'{answer} in {_winds(group)}' for answer, group in by_answer.items())}"
            f" wind with {_air(airs.pop())}"
        )
    return "; ".join(
        f"{answer} in {_list_conditions(group)}" for answer, group in by_answer.items()
    )


def _winds(group: Sequence[Condition]) -> str:
    """List wind speeds: ``3, 7 and 12 m/s``."""
    winds = [f"{condition.wind_mps:g}" for condition in group]
    return f"{' and '.join(filter(None, (', '.join(winds[:-1]), winds[-1])))} m/s"


def _air(turbulence: str) -> str:
    """Name the turbulence of a condition."""
    return f"{'no' if turbulence == 'none' else turbulence} turbulence"


def _list_conditions(all_conditions: Sequence[Condition]) -> str:
    """List conditions by turbulence: ``3 and 7 m/s wind with light turbulence``."""
    by_air: dict[str, list[Condition]] = {}
    for condition in all_conditions:
        by_air.setdefault(condition.turbulence, []).append(condition)
    return ", ".join(f"{_winds(group)} wind with {_air(air)}" for air, group in by_air.items())


def _reason_line(answered: Sequence[Statement]) -> str:
    """State for each answer the rate of the deciding condition with its limit; then flight hours
    and aborted flights.
    """
    one_air = len({item.cell.condition.turbulence for item in answered}) == 1
    parts = []
    for answer in _ORDER:
        same_answer = [item for item in answered if item.answer == answer]
        if same_answer:
            item = _deciding_statement(same_answer, answer)
            place = (
                f"{item.cell.condition.wind_mps:g} m/s" if one_air else item.cell.condition.label
            )
            parts.append(f"{_rate(item, answer)} in {place}")
    # Hours of all corners together.
    hours = [sum(rate.hours for rate in item.cell.rates) for item in answered]
    hours_words = (
        f"{min(hours):.3g}"
        if max(hours) - min(hours) < 1.0
        else f"{min(hours):.3g} to {max(hours):.3g}"
    )
    return (
        f"Why: excursions beyond {answered[0].cell.radius_m:g} m, worst corner: {', '.join(parts)};"
        f" acceptable {answered[0].acceptable_per_h:g}/h; {hours_words} h a condition,"
        f" {_aborted_words(answered)}."
    )


def _aborted_words(answered: Sequence[Statement]) -> str:
    """Count aborted flights by kind."""
    kinds = {kind: sum(item.aborted[kind] for item in answered) for kind in answered[0].aborted}
    total = sum(kinds.values())
    if not total:
        return "no flights aborted"
    kind_words = ", ".join(
        f"{kind.replace('_', ' ')} {number}" for kind, number in kinds.items() if number
    )
    return f"{total} flight{'' if total == 1 else 's'} aborted ({kind_words})"


def _deciding_statement(candidates: Sequence[Statement], answer: str) -> Statement:
    """Return the statement with the highest limit that the answer rests on; if several have it, the
    one in the hardest condition.
    """
    # A no rests on the lower confidence limit of the worst corner, other answers on the upper one.
    limits = [item.worst.lower if answer == NO else item.worst.upper for item in candidates]
    highest = [
        item for item, limit in zip(candidates, limits, strict=True) if limit == max(limits)
    ] or list(candidates)
    condition = hardest_condition(item.cell.condition for item in highest)
    return next(item for item in highest if item.cell.condition == condition)


def _rate(item: Statement, answer: str) -> str:
    """State the rate and the confidence limit that support the answer."""
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


def _missing_effects_line(
    refinement: Refinement, campaigns: Mapping[str, FlownCampaign], same_answers: bool
) -> str:
    """Name the effects that the model lacked, and what adding them changed."""
    effects = [e for e in refinement.effects if not e.withdrawn]
    if not effects:
        if refinement.verdict == "no-missing-effect":
            return "These flights show no effect that the model lacks."
        return "A residual remains that no effect of the catalogue explains."
    names = [e.name for e in effects]
    remainder = f" and {len(names) - _MAX_NAMES} more" if len(names) > _MAX_NAMES else ""
    improvements = [
        *_improvements(refinement, campaigns),
        *(["same answers"] if same_answers and AFTER in campaigns else []),
    ]
    improvement_words = (
        f". With {'it' if len(names) == 1 else 'them'}: {', '.join(improvements)}"
        if improvements
        else ""
    )
    return f"The model lacked {', '.join(names[:_MAX_NAMES])}{remainder}{improvement_words}."


def _improvements(refinement: Refinement, campaigns: Mapping[str, FlownCampaign]) -> Iterator[str]:
    """Yield how much refinement reduced the largest hold-out residual and the cross-track p-box."""
    sigma = {
        c: (row.rms_before / row.noise_rms, row.rms_after / row.noise_rms)
        for c, row in refinement.gap.test.channels.items()
        if row.rms_before and row.rms_after and row.noise_rms
    }
    # The channel with the largest residual before refinement
    if sigma:
        channel = max(sigma, key=lambda c: sigma[c][0])
        before, after = sigma[channel]
        name = shown_channel(channel)[0]
        yield f"held-out residual of {name} from {before:.3g} to {after:.3g} sigma"
    if AFTER in campaigns:
        condition = _hardest_condition(campaigns[AFTER])
        widths = [
            width_of(in_condition(campaigns[when].frame, condition), _TRACK)
            for when in (BEFORE, AFTER)
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
                if abs(change) > NEGLIGIBLE_CHANGE
                else "as wide"
            )
            yield f"cross-track p-box {words}"


def _hardest_condition(campaign: FlownCampaign) -> Condition:
    """Return the hardest condition of a campaign."""
    return hardest_condition(item.cell.condition for item in campaign.statements)


def _next_step(last: FlownCampaign, answered: Sequence[Statement]) -> str:
    """State what would change the answer, or else what would narrow the p-box."""
    inconclusive = [item for item in answered if item.answer == OPEN]
    if inconclusive:
        return " ".join(["Next:", *_decide_inconclusive(last, inconclusive)])
    # Even the best corner fails: a better model cannot change the answer.
    refused = [item for item in answered if item.answer == NO]
    # Even the best corner is above the acceptable rate.
    infeasible = [item for item in refused if item.best.lower > item.acceptable_per_h]
    if infeasible:
        item = min(infeasible, key=lambda s: s.best.lower)
        return (
            f"Next: change the autopilot, the radius or the wind limit: {item.cell.condition.label}"
            f" fails at the best corner too (at least {item.best.lower:.2g}/h), so no better model"
            " changes it."
        )
    if refused:
        item = refused[0]
        return (
            f"Next: a better model may change the no in {item.cell.condition.label}: the best"
            f" corner has {item.best.rate:.2g}/h. {_propose_flight(last, item.cell.condition)}"
        ).rstrip()
    proposal = _propose_flight(last, _hardest_condition(last))
    return f"Next: the question is answered. {proposal}".rstrip()


def _decide_inconclusive(last: FlownCampaign, inconclusive: Sequence[Statement]) -> Iterator[str]:
    """Yield what would decide inconclusive conditions: more hours if these are too few, else
    removal of the stated reason.
    """
    too_few_hours = [item for item in inconclusive if not item.reason]
    if too_few_hours:
        item = max(too_few_hours, key=lambda s: s.worst.upper)
        where = item.cell.condition.label
        # With excursions observed, more hours may decide either way; without any, the hours needed
        # for a yes can be computed.
        if item.worst.rate > 0.0:
            yield f"more flight hours in {where} ([aleatory] flights), or a narrower model."
            yield from filter(None, [_propose_flight(last, item.cell.condition)])
        else:
            hours = item.quiet_hours_needed
            yield (
                f"fly {hours:.3g} h per corner in {where} ([aleatory] flights); that much without"
                " an excursion is a yes."
            )
    for reason in dict.fromkeys(item.reason for item in inconclusive if item.reason):
        same_reason = [item for item in inconclusive if item.reason == reason]
        advice = (
            "raise [metrics] dispersion"
            if same_reason[0].dispersion.is_contradicted
            else "remove the cause"
        )
        yield (
            f"{advice} for {', '.join(item.cell.condition.label for item in same_reason)}:"
            f" {reason}, which more hours do not change."
        )


def _widest_coefficient(last: FlownCampaign, condition: Condition) -> str:
    """State which coefficient contributes most to the cross-track p-box; empty if unknown."""
    rows = [
        r
        for r in last.shares
        if r["condition"] == condition.label and r["metric"] == _TRACK and r["share_max"]
    ]
    if not rows:
        return ""
    first = max(rows, key=lambda row: float(row["share_max"]))
    return (
        f"{first['coefficient']} makes {100 * float(first['share_max']):.0f} % of the cross-track"
        " p-box"
    )


def _propose_flight(last: FlownCampaign, condition: Condition) -> str:
    """Propose a flight that would narrow the bounds of the widest coefficient."""
    widest = _widest_coefficient(last, condition)
    return (
        f"{widest}; uqharness next-flight {last.folder} --out DIR plans a flight for it."
        if widest
        else ""
    )


# The verdict: one sentence and a level for each result of the stages.

REFINEMENT = Path("refine") / "refinement.json"
_ABOVE_NOISE = 1.15  # as `compare` and `refine` have it


def judge(
    spec: ChainSpec,
    stages: Sequence[Stage],
    rows: Sequence[StageResult],
    out: Path,
    campaigns: Mapping[str, FlownCampaign],
) -> list[Sentence]:
    """Return all sentences of the verdict.

    Parameters
    ----------
    spec : ChainSpec
        The study.
    stages : sequence of Stage
        Its stages.
    rows : sequence of StageResult
        Entries of the stages in study.json, with their exit codes.
    out : Path
        The study's folder.
    campaigns : mapping
        ``before`` and possibly ``after`` -> finished campaign; may be empty.

    Returns
    -------
    list of (str, str)
        Text and level.

    Raises
    ------
    BadInputError
        If a document of a stage is damaged.
    """
    kinds = {stage.kind for stage in stages}
    codes = {row.name: row.exit or 0 for row in rows}
    sentences: list[Sentence] = []
    if campaigns:
        sentences += performance(campaigns)
    # Then refinement, bounds, identification, in this order.
    if "refine" in kinds:
        sentences += _refinement_sentences(read_result(out / REFINEMENT, Refinement))
    if "validate-bounds" in kinds:
        sentences += _coverage(
            out, spec.bounds.validate_on if spec.bounds else (), "refine" in kinds
        )
    if "identify" in kinds:
        sentences.append(
            _identification(read_result(out / "identify" / "fit.json", Fit), codes["identify"])
        )
    ended_early = [
        stage.name.removeprefix("fly-")
        for stage in stages
        if stage.kind == "fly" and codes[stage.name] == 1
    ]
    if ended_early:
        sentences.append(
            (
                (
                    f"Flown but ended early: {', '.join(ended_early)}; what was recorded until then"
                    " was used."
                ),
                LEVEL_WARN,
            )
        )
    return sentences


def _refinement_sentences(document: Refinement) -> Iterator[Sentence]:
    """State the effects that were found, what is unexplained, and the hold-out residuals."""
    effects = [e for e in document.effects if not e.withdrawn]
    flights = f"from {', '.join(_stems(document.train))}"
    if effects:
        effect_words = "; ".join(
            f"{e.name}, {_number(e.value, '.4g')} ±"
            f" {_number(e.std, '.2g')}{'' if e.unit in (None, '', '1') else f' {e.unit}'}"
            + (f" ({e.property})" if e.property else "")
            for e in effects
        )
        yield (
            f"Refinement named, {flights}: {effect_words}.",
            LEVEL_GOOD if document.verdict == "effects-found" else LEVEL_WARN,
        )
    elif document.verdict == "no-missing-effect":
        yield f"Refinement found no missing effect {flights}.", LEVEL_GOOD
    if document.verdict == "unexplained":
        yield "Refinement leaves a residual unexplained: " + _unexplained(document) + ".", LEVEL_BAD
    test = document.gap.test
    # In turbulence the residuals of replays include the gust response, so one-step predictions
    # are compared.
    predictions = test.predictions
    # Residuals relative to the sensor noise
    ratios = {
        c: (g.rms_before / g.noise_rms, g.rms_after / g.noise_rms)
        for c, g in (predictions or test.channels).items()
        if g.rms_before is not None and g.rms_after is not None and g.noise_rms
    }
    whose = "rms of one-step predictions" if predictions else "rms"
    heading = f"On the hold-out flights ({', '.join(_stems(document.test))}) {whose} over noise"
    above = {c: r for c, r in ratios.items() if max(r) > _ABOVE_NOISE}
    if not above:
        largest = max((max(r) for r in ratios.values()), default=math.nan)
        yield f"{heading} is at most {largest:.2f} in every channel, before and after.", LEVEL_GOOD
        return
    words = ", ".join(
        f"{c} {b:.2f} to {a:.2f}"
        for c, (b, a) in sorted(above.items(), key=lambda item: -max(item[1]))
    )
    # Good only if residuals shrank and reached the noise.
    shrank = all(a <= b * (1 + NEGLIGIBLE_CHANGE) for b, a in above.values())
    reached = all(a <= _ABOVE_NOISE for _, a in above.values())
    yield (
        f"{heading} went, from before to after: {words} (1: the sensors' noise).",
        LEVEL_GOOD if shrank and reached else LEVEL_WARN,
    )


def _stems(names: Sequence[str]) -> list[str]:
    """Return file names without folder and extension."""
    return [Path(name).stem for name in names]


def _number(value: float | None, form: str) -> str:
    """Format a number that may be undefined."""
    return "undefined" if value is None else format(value, form)


def _unexplained(document: Refinement) -> str:
    """State which effects were withdrawn, or where residuals remain."""
    withdrawn = [e.name for e in document.effects if e.withdrawn]
    if withdrawn:
        return f"{', '.join(withdrawn)} did not reduce the hold-out residuals and was withdrawn"
    where = [w.words or w.coefficient for w in document.remaining.where if w.words or w.t is None]
    return "; ".join(w for w in where if w) or "the residuals are coloured, at no particular place"


def _coverage(out: Path, flights: Sequence[str], refined: bool) -> Iterator[Sentence]:
    """State which share of the hold-out flights the 95 % bounds contain, per coefficient, and how
    their mean width changed by refinement.
    """
    documents = {
        when: read_result(out / f"validate-{when}" / "coverage.json", Coverage)
        for when in ((BEFORE, AFTER) if refined else (BEFORE,))
    }
    coverages = {when: document.coverage for when, document in documents.items()}
    flight_names = ", ".join(flights)
    for when, coverage in coverages.items():
        shares = {c: row.share_95 for c, row in coverage.items()}
        low, high = min(shares, key=lambda c: shares[c]), max(shares, key=lambda c: shares[c])
        suffix = f" {when} refinement" if refined else ""
        text = (
            f"Of {flight_names}, {100 * shares[low]:.1f} % ({low}) to {100 * shares[high]:.1f} %"
            f" ({high}) lies inside"
        )
        text += f" the 95 % bounds{suffix}"
        verdicts = documents[when].verdicts
        # Documents without verdicts are judged by the share of samples inside.
        failing = [c for c, verdict in verdicts.items() if verdict == "fails"] or [
            c for c in shares if not shares[c] >= MIN_SHARE_INSIDE
        ]
        # The worst verdict decides the sentence and its level.
        undecided = [c for c, verdict in verdicts.items() if verdict == "inconclusive"]
        if failing:
            text += f": those of {', '.join(failing)} do not hold."
        elif undecided:
            text += f": too short a flight to tell of {', '.join(undecided)}."
        else:
            text += "."
        yield text, LEVEL_BAD if failing else LEVEL_WARN if undecided else LEVEL_GOOD
    # Compare the widths before and after refinement.
    if refined:
        widths = {
            w: {c: row.mean_width for c, row in coverage.items()}
            for w, coverage in coverages.items()
        }
        change = {
            c: _change(widths[BEFORE][c], width)
            for c, width in widths[AFTER].items()
            if c in widths[BEFORE]
        }
        moved = ", ".join(
            f"{c} {100 * x:+.0f} %" for c, x in change.items() if abs(x) > NEGLIGIBLE_CHANGE
        )
        unchanged = ", ".join(c for c, x in change.items() if abs(x) <= NEGLIGIBLE_CHANGE)
        unknown = ", ".join(c for c, x in change.items() if math.isnan(x))
        # Coefficients with changed, unchanged and undefined widths.
        groups = (
            (moved, ""),
            (unchanged, " as before"),
            (unknown, " undefined, a width is 0 or not known"),
        )
        words = "; ".join(names + end for names, end in groups if names)
        text = (
            f"Mean width of the bounds on {flight_names}, after against before refinement: {words}"
        )
        shrank = [c for c, x in change.items() if x < -NEGLIGIBLE_CHANGE]
        yield (
            f"{text}{'' if shrank else '; none is narrower'}.",
            LEVEL_PLAIN if shrank else LEVEL_WARN,
        )


def _change(before: float | None, after: float | None) -> float:
    """Return the relative change; NaN if a width is unknown or the first is zero."""
    return math.nan if not before or after is None else after / before - 1.0


def _identification(document: Fit, code: int) -> Sentence:
    """State how many parameters were identified and the largest residual over its noise."""
    done = [row for row in document.parameters.values() if row.status == "identified"]
    flights = ", ".join(_stems(document.flights))
    text = (
        f"{len(done)} of {len(document.parameters)} parameters were identified from {flights} by"
        f" {document.method}"
    )
    # Residuals relative to the noise of the card
    ratios = {c: v.rms / v.noise for c, v in document.fit.items() if v.rms is not None and v.noise}
    worst = max(ratios, key=lambda c: ratios[c], default="")
    if worst:
        text += f"; the largest residual is {ratios[worst]:.2f} times the noise ({worst})"
    if code:
        return f"{text}. Not converged, or no parameter identified.", LEVEL_BAD
    tested = LEVEL_GOOD if worst else LEVEL_PLAIN
    return f"{text}.", tested if not worst or ratios[worst] <= _ABOVE_NOISE else LEVEL_WARN


# Ground tracks: the model and its worst corner, before and after refinement, in the same air of
# the hardest condition.

TRACKS = "tracks.parquet"
NOMINAL, WORST = "nominal", "worst corner"
_LARGEST = "cross_track_max_m"
_DISTANCE = "cross_track"
_RATE_HZ = 5.0
_NORTH, _EAST = "nav/north-m", "nav/east-m"


@dataclass(frozen=True)
class TrackRequest:
    """A finished campaign whose worst corner is flown again.

    Attributes
    ----------
    folder : Path
        The campaign's folder.
    frame : DataFrame
        One row per flight.
    statement : Statement or None
        Statement on the smallest radius in the hardest condition.
    """

    folder: Path
    frame: pd.DataFrame
    statement: Statement | None


def fly_tracks(
    out: Path, requests: Mapping[str, TrackRequest], workers: int | None = None
) -> dict[str, Any]:
    """Fly the nominal model and the worst corner of each campaign and write tracks.parquet.

    The air is that in which the worst corner of the last campaign had the largest cross-track
    error. Columns: when, model (``nominal``: plugin off; ``worst corner``), epistemic_id, time_s,
    north_m, east_m, distance_m.

    Parameters
    ----------
    out : Path
        The study's folder.
    requests : mapping
        ``before`` and possibly ``after`` -> campaign.
    workers : int, optional
        Processes.

    Returns
    -------
    dict
        Wind, turbulence, number of the air and radius, for study.json; or ``reason`` if nothing
        could be flown.
    """
    *_, last = requests.values()
    # All campaigns must have a statement, and flights with a distance.
    air = None if any(item.statement is None for item in requests.values()) else _worst_air(last)
    if air is None or last.statement is None:
        return {"reason": "no flight of the hardest condition has a distance from its path"}
    condition = last.statement.cell.condition
    try:
        flights = {
            (when, model, name): spec
            for when, item in requests.items()
            for model, name, spec in _track_flights(item, air)
        }
        import pandas as pd
        import pyarrow as pa

        frame = pd.concat(_fly_frames(flights, workers), ignore_index=True)
        write_table(pa.Table.from_pandas(frame, preserve_index=False), out / TRACKS)
    except BadInputError as error:
        return {"reason": str(error)}
    return {
        "wind_mps": condition.wind_mps,
        "turbulence": condition.turbulence,
        "aleatory_id": air,
        "radius_m": last.statement.cell.radius_m,
    }


def hardest(candidates: Sequence[Statement]) -> Statement | None:
    """Return the statement on the smallest radius in the hardest condition; None if no distance
    from a path is recorded.
    """
    horizontal = [item for item in candidates if item.cell.distance == "horizontal"]
    if not horizontal:
        return None
    condition = hardest_condition(item.cell.condition for item in horizontal)
    return min(
        (item for item in horizontal if item.cell.condition == condition),
        key=lambda item: item.cell.radius_m,
    )


def _worst_air(request: TrackRequest) -> int | None:
    """Return the number of the air in which the worst corner had the largest cross-track error;
    None if some flight lacks the error.
    """
    assert request.statement is not None
    rows = in_condition(request.frame, request.statement.cell.condition)
    rows = rows[
        (rows["epistemic_id"] == request.statement.worst.epistemic_id) & (rows["status"] == "ok")
    ]
    if _LARGEST not in rows or rows[_LARGEST].isna().any() or rows.empty:
        return None
    return int(rows["aleatory_id"].iloc[int(rows[_LARGEST].to_numpy(dtype=float).argmax())])


def _track_flights(request: TrackRequest, air: int) -> Iterator[tuple[str, str, FlightSpec]]:
    """Yield model, epistemic id and flight: without the plugin's deltas, and at the worst corner
    exactly as the campaign flew it.
    """
    spec = spec_of(read_manifest(request.folder))
    mission = find_mission(spec, request.folder)
    if needs_copy(spec):
        make_copy(spec, mission, request.folder)
    assert request.statement is not None
    condition = request.statement.cell.condition
    part = cases.Part(range(air, air + 1), ((condition.wind_mps, condition.turbulence),))
    worst_id = request.statement.worst.epistemic_id
    # The case exactly as the campaign flew it, plugin included.
    case = next(
        case for case in cases.build_cases(spec, mission, part) if case.epistemic_id == worst_id
    )
    nominal_properties = {
        name: value for name, value in case.flight.properties.items() if not name.startswith("uq/")
    }
    yield (
        NOMINAL,
        "",
        replace(case.flight, properties=nominal_properties, levels=None, transient=None),
    )
    yield WORST, worst_id, case.flight


@dataclass(frozen=True)
class _Recorder:
    """Fly in a worker process and record position and distance from the path into ``folder``."""

    folder: Path

    def __call__(self, spec: FlightSpec) -> FlightResult:
        """Record one flight; BadInputError if the aircraft's card has no cross-track metric."""
        import pandas as pd

        mission = staged_mission(spec)
        metric = mission.aircraft.card.metrics.get(_DISTANCE)
        if metric is None:
            raise BadInputError(
                f"{mission.aircraft.name}: its card has no metric {_DISTANCE}, so there is no path"
                " to draw"
            )
        table = {
            "north_m": Source(_NORTH),
            "east_m": Source(_EAST),
            "distance_m": Source(metric.true),
        }
        record = record_mission(mission, replace(spec, record_rate_hz=_RATE_HZ), table)
        pd.DataFrame(record.signals).to_parquet(self.folder / _record_name(spec), index=False)
        return FlightResult(record.status, record.reason, record.flown_s, {}, {}, {})


def _timeout_s(flight: FlightSpec) -> float:
    """Return the time limit of a flight [s of wall clock]."""
    return 120.0 + 0.5 * (flight.duration_s + flight.burn_in_s)


def _record_name(spec: FlightSpec) -> str:
    """Return a file name that is unique to the flight's settings."""
    return sha256_hex(repr(spec).encode()) + ".parquet"


def _fly_frames(
    flights: Mapping[tuple[str, str, str], FlightSpec], workers: int | None
) -> Iterator[pd.DataFrame]:
    """Fly all flights in parallel and yield their records with when, model and epistemic id."""
    import pandas as pd

    numbered = {str(k): spec for k, spec in enumerate(flights.values())}
    with scratch_folder() as scratch:
        folder = scratch.path
        executor = ProcessExecutor(process_count(workers), timeout_s=_timeout_s, retries=0)
        # A flight without a file has failed.
        for outcome in (
            item for batch in executor.run(_Recorder(folder), numbered.items()) for item in batch
        ):
            if not (folder / _record_name(numbered[outcome.case_id])).is_file():
                raise BadInputError(
                    f"the flights of the ground track failed: {outcome.reason or outcome.status}"
                )
        for (when, model, name), spec in flights.items():
            frame = pd.read_parquet(folder / _record_name(spec))
            frame.insert(0, "when", when)
            frame.insert(1, "model", model)
            frame.insert(2, "epistemic_id", name)
            yield frame
