"""What two campaigns of a study say of the aircraft's performance, before and after refinement, in sentences."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.units import counted, percent
from uqharness.campaign import (
    CONFIDENCE,
    Condition,
    Statement,
    hardest_of,
    in_condition,
    read_sensitivity,
    samples,
)
from uqharness.campaign.conditions import conditions
from uqharness.campaign.folder import read_cases, read_complete, read_decisions
from uqharness.campaign.statements import statements
from uqharness.statistics import NO, OPEN, YES, Sample, envelope
from uqharness.statistics.pbox import pbox
from uqharness.study.stages import AFTER, BEFORE

if TYPE_CHECKING:
    import pandas as pd

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
