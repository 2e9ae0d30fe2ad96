"""What a study found, in sentences computed from its stages' results: the answer first, then what it rests on."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from uqharness.bounds_validation import HOLDS_FROM
from uqharness.campaign_manifest import read_manifest
from uqharness.campaign_rounds import read_decisions
from uqharness.campaign_tables import CONFIDENCE, Condition, conditions, in_condition, samples
from uqharness.case_table import CASES, read_table
from uqharness.chain_spec import ChainSpec
from uqharness.chain_stages import AFTER, BEFORE, Stage
from uqharness.decide import NO, OPEN, YES
from uqharness.pbox import Sample, envelope, pbox
from uqharness.statements import Statement, statements

if TYPE_CHECKING:
    import pandas as pd

Sentence = tuple[str, str]
"""Text and level: good, warn or bad."""
GOOD, WARN, BAD = "good", "warn", "bad"

_QUANTITIES = (
    ("cross_track_median_m", "cross-track error", "m"), ("altitude_median_m", "altitude error", "m"),
    ("speed_median_mps", "speed error", "m/s"), ("heading_median_deg", "heading error", "deg"),
)  # fmt: skip
_LEVELS = {YES: GOOD, NO: BAD, OPEN: WARN}
_ANSWERS = {YES: "yes", NO: "no", OPEN: "open, the flights do not settle it"}
_ABOVE_NOISE = 1.15  # as `compare` and `refine` have it
SAME = 0.02
"""Relative change of a width below which it is called unchanged."""


@dataclass(frozen=True)
class Width:
    """How wide a p-box is: the area between its sides [unit of the metric], and its median [low, high]; NaN with a reason."""

    area: float
    median: tuple[float, float]
    reason: str = ""


def judge(spec: ChainSpec, stages: Sequence[Stage], rows: Sequence[Mapping[str, Any]], out: Path) -> list[Sentence]:
    """Every sentence, from what the stages left in ``out``."""
    kinds = {stage.kind for stage in stages}
    codes = {row["name"]: row["exit"] for row in rows}
    found: list[Sentence] = []
    if "campaign" in kinds:
        found += _campaigns(out, "refine" in kinds)
    if "refine" in kinds:
        found += _refined(json.loads((out / "refine" / "refinement.json").read_text(encoding="utf-8")))
    if "validate-bounds" in kinds:
        found += _coverage(out, spec.bounds.validate_on if spec.bounds else (), "refine" in kinds)
    if "identify" in kinds:
        found.append(
            _identified(json.loads((out / "identify" / "fit.json").read_text(encoding="utf-8")), codes["identify"])
        )
    ended = [stage.name.removeprefix("fly-") for stage in stages if stage.kind == "fly" and codes[stage.name] == 1]
    if ended:
        found.append((f"Flown but ended early: {', '.join(ended)}; what was recorded until then was used.", WARN))
    return found


@dataclass(frozen=True)
class _Flown:
    """A finished campaign: its flights, its settings, its statements."""

    frame: pd.DataFrame
    campaign: Mapping[str, Any]
    signed: list[Statement]


def _read(folder: Path) -> _Flown:
    frame = read_table(folder / CASES).to_pandas()
    campaign = read_manifest(folder)["campaign"]
    return _Flown(frame, campaign, statements(frame, campaign, read_decisions(folder)))


def _campaigns(out: Path, both: bool) -> Iterator[Sentence]:
    flown = {when: _read(out / f"campaign-{when}") for when in ((BEFORE, AFTER) if both else (BEFORE,))}
    last = flown[AFTER if both else BEFORE]
    found = conditions(last.frame)
    hardest = _hardest(found)
    if len(found) > 1:
        yield _tally(last)
    for item in last.signed:
        if item.cell.condition == hardest and item.cell.distance == "horizontal":
            yield _excursions(item, _same(flown[BEFORE].signed, item) if both else None)
    for metric, words, unit in _QUANTITIES:
        sides = {when: _width(in_condition(item.frame, hardest), metric) for when, item in flown.items()}
        present = [side for side in sides.values() if side is not None]
        if len(present) == len(sides):
            yield _pbox_sentence(words, unit, hardest, float(last.campaign["aleatory"]["duration_s"]), present)
    yield _ended(flown)
    yield from _outside(last)


def _hardest(found: Sequence[Condition]) -> Condition:
    order = ("none", "light", "moderate", "severe")
    return max(found, key=lambda item: (order.index(item.turbulence), item.wind_mps))


def _same(signed: Sequence[Statement], wanted: Statement) -> Statement | None:
    def key(item: Statement) -> tuple[Condition, float, str]:
        return item.cell.condition, item.cell.radius_m, item.cell.distance

    return next((item for item in signed if key(item) == key(wanted)), None)


def _tally(flown: _Flown) -> Sentence:
    """The answers of all conditions, counted, for the smallest radius."""
    radius = min((item.cell.radius_m for item in flown.signed), default=math.nan)
    asked = [item for item in flown.signed if item.cell.radius_m == radius and item.cell.distance == "horizontal"]
    if not asked:
        return "No condition has a count of excursions: this aircraft publishes no distance from a path.", WARN
    words = []
    for answer in (YES, NO, OPEN):
        named = [item.cell.condition.label for item in asked if item.answer == answer]
        if named:
            words.append(f"{answer} in {len(named)} ({', '.join(named)})")
    text = f"At most {asked[0].acceptable_per_h:g} excursions beyond {radius:g} m per flight hour at every corner? "
    text += f"Of {len(asked)} conditions: "
    answers = {item.answer for item in asked}
    return text + "; ".join(words) + ".", BAD if NO in answers else WARN if OPEN in answers else GOOD


def _excursions(item: Statement, before: Statement | None) -> Sentence:
    cell = item.cell
    asked = (
        f"In {cell.condition.words}: at most {item.acceptable_per_h:g} excursions beyond {cell.radius_m:g} m per flight hour "
        f"at every corner? {_ANSWERS[item.answer].capitalize()}: {_rates(item)}"
    )
    if before is None:
        return asked + ".", _LEVELS[item.answer]
    return f"{asked}. Before refinement: {_ANSWERS[before.answer].split(',')[0]}, {_rates(before)}.", _LEVELS[
        item.answer
    ]


def _rates(item: Statement) -> str:
    hours = max((rate.hours for rate in item.cell.rates), default=0.0)
    if hours <= 0.0 or math.isnan(item.worst.rate):
        return "undefined, for no flight was scored"
    upper = "any number" if math.isinf(item.worst.upper) else f"{item.worst.upper:.3g}"
    return (
        f"{item.best.rate:.3g} (best corner) to {item.worst.rate:.3g} (worst) per hour in {hours:.3g} h per corner, "
        f"which leave up to {upper} at the worst corner with {100 * CONFIDENCE:g} % confidence"
    )


def _width(rows: pd.DataFrame, metric: str) -> Width | None:
    """Of one condition's flights; None where no flight has the metric."""
    if metric not in rows:
        return None
    found = samples(rows, metric)
    if not any(sample.values.size for sample in found):
        return None
    median = pbox(found, CONFIDENCE).quantile(0.5)
    unknown = sum(sample.unknown for sample in found)
    if unknown:
        return Width(math.nan, median, f"{unknown} of {len(rows)} flights have no such error, so its right end is open")
    return Width(area(found), median)


def area(found: Sequence[Sample]) -> float:
    """Area between the envelopes of the samples' distribution functions, in the unit of the values; none may be unknown."""
    values = np.unique(np.concatenate([sample.values for sample in found]))
    lower, upper = envelope(found, values)
    return float(np.sum((upper - lower)[:-1] * np.diff(values)))


def _pbox_sentence(words: str, unit: str, condition: Condition, duration_s: float, sides: Sequence[Width]) -> Sentence:
    text = f"Median {words} of a typical {duration_s:g} s flight, best to worst corner: "
    if len(sides) == 1:
        return f"{text}{_span(sides[0])} {unit} ({condition.label}).", GOOD if not sides[0].reason else WARN
    before, after = sides
    text += f"{_span(before)} {unit} before refinement, {_span(after)} {unit} after ({condition.label}); "
    reason = next((f"{side.reason} {when}" for side, when in ((before, BEFORE), (after, AFTER)) if side.reason), "")
    if reason:
        return f"{text}whether the p-box became narrower is undefined: {reason}.", WARN
    if before.area == 0.0:
        return f"{text}the p-box had no width before.", WARN
    ratio = after.area / before.area
    sizes = f"mean width {before.area:.3g} {unit} before, {after.area:.3g} {unit} after"
    if ratio < 1.0 - SAME:
        return f"{text}the p-box became narrower by {100 * (1 - ratio):.0f} % ({sizes}).", GOOD
    if ratio > 1.0 + SAME:
        return f"{text}the p-box did NOT become narrower, it is {100 * (ratio - 1):.0f} % wider ({sizes}).", WARN
    return f"{text}the p-box did NOT become narrower ({sizes}).", WARN


def _span(side: Width) -> str:
    low, high = side.median
    return f"at least {low:.3g}" if math.isinf(high) else f"{low:.3g} to {high:.3g}"


def _ended(flown: Mapping[str, _Flown]) -> Sentence:
    parts, failed_any, lost_any = [], False, False
    for when, item in flown.items():
        frame = item.frame
        failed, lost = int((frame["status"] != "ok").sum()), int(frame["loss_of_control"].fillna(0).sum())
        parts.append(
            f"{len(frame)} {when if len(flown) > 1 else ''}".strip() + f" ({failed} failed, control lost in {lost})"
        )
        failed_any, lost_any = failed_any or failed > 0, lost_any or lost > 0
    level = BAD if lost_any else WARN if failed_any else GOOD
    return f"Flights: {', '.join(parts)}; a failed flight is bounded at the worst, never dropped.", level


def _outside(flown: _Flown) -> Iterator[Sentence]:
    share = flown.frame["extrapolated_share"].mean()
    if not math.isnan(share):
        text = f"{100 * share:.2g} % of the scored time was flown outside the states that the bounds were made from"
        yield (text + (", where bounds are extrapolated." if share > 0 else ".")), WARN if share > 0.1 else GOOD


def _refined(document: Mapping[str, Any]) -> Iterator[Sentence]:
    effects = [e for e in document["effects"] if not e["withdrawn"]]
    flights = f"from {', '.join(_stems(document['train']))}"
    if effects:
        named = "; ".join(
            f"{e['name']}, {e['value']:.4g} ± {e['std']:.2g}{'' if e['unit'] in ('', '1') else ' ' + e['unit']}"
            + (f" ({e['property']})" if e["property"] else "")
            for e in effects
        )
        yield f"Refinement named, {flights}: {named}.", GOOD if document["verdict"] == "effects-found" else WARN
    elif document["verdict"] == "no-missing-effect":
        yield f"Refinement found nothing missing {flights}.", GOOD
    if document["verdict"] == "unexplained":
        yield "Refinement leaves something unexplained: " + _unexplained(document) + ".", BAD
    gap = document["gap"]["test"]["channels"]
    ratios = {
        c: (g["rms_before"] / g["noise_rms"], g["rms_after"] / g["noise_rms"]) for c, g in gap.items() if g["noise_rms"]
    }
    flown = f"On {', '.join(_stems(document['test']))}, which chose nothing, rms over noise"
    above = {c: r for c, r in ratios.items() if max(r) > _ABOVE_NOISE}
    if not above:
        most = max((max(r) for r in ratios.values()), default=math.nan)
        yield f"{flown} is at most {most:.2f} in every channel, before and after.", GOOD
        return
    words = ", ".join(f"{c} {b:.2f} to {a:.2f}" for c, (b, a) in sorted(above.items(), key=lambda item: -max(item[1])))
    shrank = all(a <= b * (1 + SAME) for b, a in above.values())
    reached = all(a <= _ABOVE_NOISE for _, a in above.values())
    yield f"{flown} went, from before to after: {words} (1: the sensors' noise).", GOOD if shrank and reached else WARN


def _stems(names: Sequence[str]) -> list[str]:
    return [Path(name).stem for name in names]


def _unexplained(document: Mapping[str, Any]) -> str:
    withdrawn = [e["name"] for e in document["effects"] if e["withdrawn"]]
    if withdrawn:
        return f"{', '.join(withdrawn)} did not shrink the gap on the test flights and was withdrawn"
    where = [w.get("words") or w.get("coefficient", "") for w in document["remaining"]["where"]]
    return "; ".join(w for w in where if w) or "the residuals are not white, and no place stands out"


def _coverage(out: Path, flights: Sequence[str], both: bool) -> Iterator[Sentence]:
    found = {
        when: json.loads((out / f"validate-{when}" / "coverage.json").read_text(encoding="utf-8"))["coverage"]
        for when in ((BEFORE, AFTER) if both else (BEFORE,))
    }
    named = ", ".join(flights)
    for when, coverage in found.items():
        shares = {c: row["0.95"] for c, row in coverage.items()}
        low, high = min(shares, key=lambda c: shares[c]), max(shares, key=lambda c: shares[c])
        which = f" {when} refinement" if both else ""
        text = f"Of {named}, {100 * shares[low]:.1f} % ({low}) to {100 * shares[high]:.1f} % ({high}) lies inside"
        text += f" the 95 % bounds{which}"
        holds = shares[low] >= HOLDS_FROM
        text += "." if holds else f": they do not hold, at least {100 * HOLDS_FROM:g} % is asked for."
        yield text, GOOD if holds else BAD
    if both:
        widths = {w: {c: row["mean_width"] for c, row in coverage.items()} for w, coverage in found.items()}
        change = {c: width / widths[BEFORE][c] - 1.0 for c, width in widths[AFTER].items() if c in widths[BEFORE]}
        words = ", ".join(f"{c} {100 * x:+.0f} %" for c, x in change.items())
        text = f"Mean width of the bounds on {named}, after against before refinement: {words}"
        shrank = [c for c, x in change.items() if x < -SAME]
        yield f"{text}{'' if shrank else '; none is narrower'}.", GOOD if shrank else WARN


def _identified(document: Mapping[str, Any], code: int) -> Sentence:
    done = [row for row in document["parameters"].values() if row["status"] == "identified"]
    flights = ", ".join(_stems(document["flights"]))
    text = f"{len(done)} of {len(document['parameters'])} parameters were identified from {flights} by {document['method']}"
    ratios = {c: v["rms"] / v["noise"] for c, v in document["fit"].items() if v["rms"] is not None and v["noise"]}
    worst = max(ratios, key=lambda c: ratios[c], default="")
    if worst:
        text += f"; the largest residual is {ratios[worst]:.2f} times the noise ({worst})"
    if code:
        return f"{text}. The estimation did NOT converge, or nothing was identified.", BAD
    return f"{text}.", GOOD if not worst or ratios[worst] <= _ABOVE_NOISE else WARN
