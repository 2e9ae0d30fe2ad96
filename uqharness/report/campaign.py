"""What a campaign found, ready to be told: p-boxes of the median errors, supportable claims, the verdict as sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from uqharness.campaign import (
    CONFIDENCE,
    UNCOMMANDED_METRICS,
    Condition,
    Statement,
    band_confidence,
    corners_only_words,
    hardest_of,
    in_condition,
    joint_words,
    samples,
)
from uqharness.campaign.conditions import conditions
from uqharness.campaign.folder import (
    CheckRow,
    read_cases,
    read_complete,
    read_decisions,
    read_engine_check,
)
from uqharness.campaign.spec import INTERIOR_MARK
from uqharness.campaign.statements import statements
from uqharness.report import statements as report_statements
from uqharness.report.parts import Level, Say
from uqharness.report.sample_words import called, kind_of
from uqharness.statistics import NO, OPEN, YES, PBox, Sample, widened
from uqharness.statistics.pbox import pbox

_QUANTITIES = (
    ("cross_track", "cross-track", "m"),
    ("altitude", "altitude", "m"),
    ("speed", "speed", "mps"),
    ("heading", "heading", "deg"),
)
_UNITS = {"m": "m", "mps": "m/s", "deg": "deg"}
# Medians of the published flight (Hale 2016, section 3.9), measured by its own sensors; 3 m/s wind, moderate to severe.
_PUBLISHED = {"cross_track": 9.41, "altitude": 2.16, "speed": 0.61}
_PUBLISHED_AIRCRAFT, _PUBLISHED_WIND_MPS, _PUBLISHED_AIR = "espaaro", 3.0, ("moderate", "severe")


@dataclass(frozen=True)
class Finding:
    """One p-box of a median error and the samples it is the envelope of. ``metric`` is its column of cases.parquet.

    ``widened``: by which share of its area the points between the corners widen it; None where none were flown.
    """

    metric: str
    quantity: str
    words: str
    unit: str
    measured: bool
    condition: Condition
    box: PBox
    samples: Sequence[Sample]
    published: float | None
    widened: float | None = None

    @property
    def title(self) -> str:
        """Heading of the metric's figure."""
        seen = "as the sensors measured it" if self.measured else "true, without sensor noise"
        return f"Median {self.words} error, {seen}"

    @property
    def axis(self) -> str:
        """Name of the figure's axis, unit left out."""
        return f"median |{self.words} error|, {'measured' if self.measured else 'true'}"


@dataclass(frozen=True)
class CampaignFound:
    """A complete campaign: its manifest, its flights, and what they say."""

    folder: Path
    manifest: Mapping[str, Any]
    frame: pd.DataFrame
    findings: tuple[Finding, ...]
    signed: tuple[Statement, ...]
    asked: str
    verdict: tuple[Say, ...]
    engine_check: tuple[CheckRow, ...] = ()

    @property
    def campaign(self) -> Mapping[str, Any]:
        """Every setting of the campaign, as the manifest has it."""
        return self.manifest["campaign"]

    @property
    def aircraft(self) -> str:
        """Name of the aircraft flown."""
        return Path(self.campaign["campaign"]["aircraft"]).name


def read_found(folder: Path) -> CampaignFound:
    """Read a complete campaign's folder. Raises BadInputError."""
    manifest = read_complete(folder)
    frame = read_cases(folder, manifest)
    campaign = manifest["campaign"]
    findings = tuple(_findings(frame, campaign))
    signed = tuple(statements(frame, campaign, read_decisions(folder, manifest)))
    verdict = tuple(_verdict(frame, campaign, findings, signed))
    check = tuple(read_engine_check(folder, manifest))
    asked = " ".join(
        [
            _asked(frame, campaign),
            *(f"{words[0].upper()}{words[1:]}." for words in joint_words(manifest)),
            *(
                f"{words[0].upper()}{words[1:]}."
                for words in corners_only_words(campaign["epistemic"])
            ),
        ]
    )
    return CampaignFound(folder, manifest, frame, findings, signed, asked, verdict, check)


def _findings(frame: pd.DataFrame, campaign: Mapping[str, Any]) -> list[Finding]:
    """P-boxes of the medians: per condition, per quantity, measured before true (the published flight is measured)."""
    found = []
    for condition in conditions(frame):
        rows = in_condition(frame, condition)
        for quantity, words, unit in _QUANTITIES:
            for measured in (True, False):
                metric = f"{quantity}_median_{unit}" + ("_measured" if measured else "")
                corners = samples(rows, metric) if metric in rows else []
                if (measured and not campaign["aleatory"]["sensor_noise"]) or not any(
                    c.values.size for c in corners
                ):
                    continue
                box = pbox(corners, band_confidence(campaign, CONFIDENCE))
                published = _published(campaign, condition, quantity) if measured else None
                grown = _widened(corners)
                found.append(
                    Finding(
                        metric,
                        quantity,
                        words,
                        _UNITS[unit],
                        measured,
                        condition,
                        box,
                        corners,
                        published,
                        grown,
                    )
                )
    return found


def _widened(found: Sequence[Sample]) -> float | None:
    between = [sample for sample in found if sample.epistemic_id.startswith(INTERIOR_MARK)]
    others = [sample for sample in found if not sample.epistemic_id.startswith(INTERIOR_MARK)]
    return widened(others, between) if between and others else None


def _published(campaign: Mapping[str, Any], condition: Condition, quantity: str) -> float | None:
    """The published flight's median, where it was flown in this condition by this aircraft."""
    same_aircraft = Path(campaign["campaign"]["aircraft"]).name == _PUBLISHED_AIRCRAFT
    same_air = condition.wind_mps == _PUBLISHED_WIND_MPS and condition.turbulence in _PUBLISHED_AIR
    return _PUBLISHED[quantity] if same_aircraft and same_air else None


def _asked(frame: pd.DataFrame, campaign: Mapping[str, Any]) -> str:
    air, epistemic = campaign["aleatory"], campaign["epistemic"]
    corners = frame["epistemic_id"].nunique()
    between = frame["epistemic_id"][frame["epistemic_id"].str.startswith(INTERIOR_MARK)].nunique()
    ends = "points of the joint ellipsoid" if epistemic["set"] == "ellipsoid" else "corners"
    also = f" and {between} points between them" if between else ""
    within = f"within the intervals of {', '.join(epistemic['coefficients'])}"
    samples_text = {
        "none": "the model as it is, without model-form uncertainty",
        "corners": f"{corners - between} {ends}{also} of the model-form intervals of {', '.join(epistemic['coefficients'])}",
        "levels": f"{corners} combinations of levels {within}",
        "lhs": f"{corners} fixed levels, a Latin hypercube, {within}",
        "white": f"{corners} samples of levels redrawn at every step {within}",
        "walk": f"{corners} random walks {within}",
    }[epistemic["method"]]
    if epistemic["method"] == "walk":
        rates = epistemic["walk_rate_per_sqrt_s"]
        samples_text += (
            " at "
            + ", ".join(f"{name} {rate:.3g}" for name, rate in rates.items())
            + " per square root of a second"
        )
    if "parameters" in epistemic:
        samples_text += f"; parameters drawn from {Path(epistemic['parameters']['fit']).name}"
    winds = ", ".join(f"{wind:g}" for wind in air["wind_mps"])
    noise = "noisy" if air["sensor_noise"] else "noise-free"
    return (
        f"How much do errors and excursions of this mission depend on the model's epistemic uncertainty? "
        f"{samples_text[0].upper()}{samples_text[1:]}; {air['flights']} flights each, of {air['duration_s']:g} s scored "
        f"after {air['burn_in_s']:g} s of burn-in; wind {winds} m/s from {air['wind_from_deg']:g} deg, "
        f"turbulence {', '.join(air['turbulence'])} ({air['turbulence_source']}), {noise} sensors."
    )


_ANSWER_LEVELS: Mapping[str, Level] = {YES: "good", NO: "bad", OPEN: "warn"}


def _verdict(
    frame: pd.DataFrame,
    campaign: Mapping[str, Any],
    findings: Sequence[Finding],
    signed: Sequence[Statement],
) -> list[Say]:
    """The answer in words with numbers: the hardest condition, its excursions, its medians, and what failed."""
    kind = kind_of(campaign["epistemic"])
    hardest = hardest_of(conditions(frame))
    duration = campaign["aleatory"]["duration_s"]
    said = [Say(f"Hardest condition flown: {hardest.words}.")]
    for statement in signed:
        if statement.cell.condition == hardest and statement.cell.distance == "horizontal":
            said.append(
                Say(called(report_statements.sentence(statement), kind), answer_level(statement))
            )
    if UNCOMMANDED_METRICS[0] in frame:
        said.append(
            Say(
                "No path was commanded: errors are deviations from the state in which scoring began."
            )
        )
    for quantity, _, _ in _QUANTITIES:
        both = [
            item for item in findings if item.condition == hardest and item.quantity == quantity
        ]
        if both:
            said.append(Say(called(_median_sentence(both, duration), kind)))
    failed = int((frame["status"] != "ok").sum())
    counted = (
        f"{failed} failed; they are bounded at the worst, not dropped"
        if failed
        else "all ended as planned"
    )
    said.append(Say(f"Of {len(frame)} flights, {counted}.", "warn" if failed else ""))
    losses = int(frame["loss_of_control"].fillna(0).sum())
    lost = f"{losses} of them lost control." if losses else "No scored flight lost control."
    said.append(Say(lost, "bad" if losses else "" if failed < len(frame) else "warn"))
    return said


def answer_level(statement: Statement) -> Level:
    """Whether an answer is good news."""
    return _ANSWER_LEVELS[statement.answer]


def hardest_first(found: Sequence[Condition]) -> list[Condition]:
    """Conditions from the strongest turbulence and wind to the weakest."""
    left, out = list(found), []
    while left:
        out.append(hardest_of(left))
        left.remove(out[-1])
    return out


def _median_sentence(both: Sequence[Finding], duration_s: float) -> str:
    """One quantity, true and (where there is one) measured, against the published flight."""
    parts = []
    for item in sorted(both, key=lambda finding: finding.measured):
        low, high = item.box.quantile(0.5)
        parts.append(
            f"{span(low, high)} {item.unit} {'as measured' if item.measured else 'in truth'}"
        )
    text = f"Median {both[0].words} error of a typical {duration_s:g} s flight, best to worst corner: {', '.join(parts)}"
    for item in both:
        if item.published is not None:
            low, high = item.box.value[0], item.box.value[-1]
            where = (
                "within"
                if low <= item.published <= high
                else "below"
                if item.published < low
                else "above"
            )
            text += f"; the published flight's {item.published:g} {item.unit} lies {where} the range measured by single flights, "
            text += f"{low:.3g} to {high:.3g} {item.unit}"
    return text + "."


def span(low: float, high: float) -> str:
    """An interval of a quantile in words."""
    if math.isinf(high):
        return f"at least {low:.3g}"
    return f"{low:.3g} to {high:.3g}" if low != high else f"{low:.3g}"
