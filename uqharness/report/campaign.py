"""Prepare the results of a campaign for reports: p-boxes, claims, sensitivity, tracks, engines.

`read_campaign_report` reads a complete campaign and formulates its verdict. The sections are shared
by the pages of a campaign, of a study, of a refinement and of a dossier.
"""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from sysid.units import percent
from uqharness.campaign import (
    CONFIDENCE,
    ENOUGH_EXCURSIONS,
    FULL_FLIGHT,
    INTERIOR_MARK,
    PATHLESS_METRICS,
    STATUS,
    TOLERANCE,
    CheckRow,
    Condition,
    Document,
    EpistemicSection,
    Manifest,
    RateRange,
    Statement,
    as_number,
    band_confidence,
    corners_only_words,
    engine_words,
    hardest_condition,
    in_condition,
    joint_words,
    read_cases,
    read_complete,
    read_decisions,
    read_engine_check,
    read_sensitivity,
    samples,
)
from uqharness.campaign.conditions import conditions
from uqharness.campaign.statements import statements
from uqharness.errors import BadInputError
from uqharness.parquet_files import read_table
from uqharness.report.ground_track import flight_track
from uqharness.report.parts import (
    Block,
    Cell,
    Facts,
    Figure,
    Figures,
    Level,
    Section,
    Sentence,
    Table,
    Words,
    format_value,
)
from uqharness.report.pbox import LabelledBox, corner_words, pbox_figure
from uqharness.report.svg import Scale, rows_chart
from uqharness.statistics import NO, OPEN, YES, PBox, Sample, widened
from uqharness.statistics.pbox import pbox

# Text and table rows on excursion rates.

_ANSWER_WORDS = {YES: "yes", NO: "no", OPEN: "inconclusive"}
_OTHER = "other"
_KIND_WORDS = {
    "loss_of_control": "Loss of control",
    "ground_contact": "Ground contact",
    "diverged": "Diverged",
    _OTHER: "Ended otherwise",
}
"""Column heads by kind of aborted flight."""


def answer_words(item: Statement) -> str:
    """Return the answer; an inconclusive one with its reason."""
    words = _ANSWER_WORDS[item.answer]
    return f"{words}: {item.reason or 'too few flight hours'}" if item.answer == OPEN else words


def sentence(item: Statement) -> str:
    """Return one statement as sentences for the verdict.

    Parameters
    ----------
    item : Statement
        Claim on one condition, radius and distance.

    Returns
    -------
    str
        Rates at the best and worst corner with limits [1/h], the answer, and the share of flights.
    """
    cell = item.cell
    # Rates at the best and worst corner with limits, then the answer.
    text = f"Excursions beyond {cell.radius_m:g} m per flight hour: "
    if all(math.isnan(rate.rate) for rate in cell.rates):
        return text + "undefined, because no flight was scored."
    text += f"{item.best.rate:.3g} at the best corner, {item.worst.rate:.3g} at the worst"
    text += (
        f" ({CONFIDENCE:.0%} limits {_limits(item.best)} and {_limits(item.worst)}, each flight one"
        " sample, "
    )
    hours = max(rate.hours for rate in cell.rates)
    text = (
        text.replace("%", " %")
        + f"{hours:.3g} h per corner{' at most' if _uneven(item) else ''}). "
    )
    text += (
        f"At most {item.acceptable_per_h:g} per hour at every corner?"
        f" {answer_words(item).capitalize()}."
    )
    # The share of flights is known only for a fixed number of flights.
    share = item.flight_share
    return text + (f" {share.capitalize()}." if share else "")


def row(item: Statement) -> dict[str, str]:
    """Return one statement as texts for the table.

    Parameters
    ----------
    item : Statement
        Claim on one condition, radius and distance.

    Returns
    -------
    dict of str to str
        Cells by column: condition, radius, best, worst, worst_corner, answer, hours, dispersion,
        carried (dispersion allowed for) and outside (share outside the data).
    """
    cell = item.cell
    share = item.extrapolated_share
    return {
        "condition": cell.condition.label,
        "radius": f"{cell.radius_m:g} m, {'3-D' if cell.distance == '3d' else 'horizontal'}",
        "best": f"{item.best.rate:.3g} [{_limits(item.best)}]",
        "worst": f"{item.worst.rate:.3g} [{_limits(item.worst)}]",
        "worst_corner": item.worst.epistemic_id,
        "answer": item.answer,
        "hours": f"{sum(rate.hours for rate in cell.rates):.4g}",
        "dispersion": (
            "too few to say"
            if math.isnan(item.dispersion_observed)
            else f"{item.dispersion_observed:.2g}"
        ),
        "carried": _dispersion_words(item),
        "outside": "not known" if math.isnan(share) else percent(share),
    }


def aborted_kinds(claims: Sequence[Statement]) -> tuple[str, ...]:
    """Return the kinds of aborted flights that get a column; empty if no flight was aborted.

    Parameters
    ----------
    claims : sequence of Statement
        Claims of all campaigns in the table.

    Returns
    -------
    tuple of str
        The three usual kinds, and "other" if such flights occurred.
    """
    # Count by kind over all statements.
    totals = {kind: sum(item.aborted[kind] for item in claims) for kind in _KIND_WORDS}
    return (
        tuple(kind for kind in _KIND_WORDS if kind != _OTHER or totals[kind])
        if any(totals.values())
        else ()
    )


def aborted_head(kinds: Sequence[str]) -> tuple[str, ...]:
    """Return the column heads of aborted flights; empty without kinds."""
    limit = f"Aborted flights, {100 * CONFIDENCE:g} % upper limit [1/h]"
    return (*(_KIND_WORDS[kind] for kind in kinds), limit) if kinds else ()


def aborted_cells(kinds: Sequence[str], items: Sequence[Statement | None]) -> tuple[str, ...]:
    """Return the cells of aborted flights.

    Parameters
    ----------
    kinds : sequence of str
        Kinds of `aborted_kinds`; without any the result is empty.
    items : sequence of Statement or None
        Claims of the same condition in several campaigns; None where it was not flown.

    Returns
    -------
    tuple of str
        Counts by kind and the upper limit of the rate [1/h], campaigns separated by a slash.
    """
    if not kinds:
        return ()
    counts = (
        " / ".join("not flown" if item is None else str(item.aborted[kind]) for item in items)
        for kind in kinds
    )
    limits = " / ".join(
        "not flown" if item is None else format_value(item.loss_upper_per_h) for item in items
    )
    return (*counts, limits)


def assumptions(claims: Sequence[Statement], settings: Document) -> list[str]:
    """Return the assumptions of the statements, and where the flights contradict them.

    Parameters
    ----------
    claims : sequence of Statement
        Claims of a campaign.
    settings : Document
        Settings of the campaign.

    Returns
    -------
    list of str
        Sentences.
    """
    # What the limits assume on clustering.
    allowed = settings.metrics.dispersion
    allowance = (
        f"Upper limits allow for a variance of the excursions per flight of {allowed:g} times their"
        " mean ([metrics] dispersion), or the observed ratio of a corner if larger. Lower limits"
        " need no such assumption."
    )
    if settings.stop.rule != "decide":
        allowance += (
            f" With {ENOUGH_EXCURSIONS} excursions or more at less than one per hour at a smaller"
            f" radius in the same air, the upper limit of the ratio there ({100 * CONFIDENCE:g} %)"
            " replaces the assumed one."
        )
    lines = [
        "Flights are independent of each other; within a flight excursions may come in clusters.",
        allowance,
        (
            "An aborted flight counts as one excursion in the upper limit. Rates are per flight"
            " hour, and yes also needs an acceptable rate of aborted flights ([metrics]"
            " acceptable_loss_per_h)."
        ),
        (
            "Corners are the simulated epistemic samples. Statements do not cover models between or"
            " outside them."
        ),
    ]
    # One statement per condition and radius.
    horizontal = {
        (item.cell.condition.words, item.cell.radius_m): item
        for item in claims
        if item.cell.distance == "horizontal"
    }
    measured = [item for item in horizontal.values() if item.dispersion.measured]
    if measured:
        quickest = min(measured, key=lambda item: item.quiet_hours_needed)
        lines.append(
            f"Clusters were measured for {len(measured)} of {len(horizontal)} conditions and radii."
            " A yes at a corner without an excursion then needs"
            f" {quickest.quiet_hours_needed:.3g} h in {quickest.cell.condition.words} beyond"
            f" {quickest.cell.radius_m:g} m."
        )
    # Tell the user if flights cluster more than the limits allow for.
    contradicted = [item for item in claims if item.dispersion_observed > item.dispersion_allowed]
    if contradicted:
        worst = max(contradicted, key=lambda item: item.dispersion_observed)
        lines.append(
            f"More clustered than assumed: {worst.dispersion_observed:.2g} times the mean beyond"
            f" {worst.cell.radius_m:g} m in {worst.cell.condition.words}. Raise [metrics]"
            " dispersion for conditions without an excursion so far."
        )
    return lines


def _dispersion_words(item: Statement) -> str:
    """Return the dispersion that limits allow for, its origin, and the quiet hours it needs."""
    corners = len(item.cell.rates)
    # Where the dispersion comes from.
    origin = "assumed"
    if item.dispersion.measured:
        origin = f"from {item.dispersion.nearest_m:g} m"
        if item.dispersion.measured < corners:
            origin += f" at {item.dispersion.measured} of {corners} corners"
    return f"{item.dispersion_allowed:.3g} {origin}, {item.quiet_hours_needed:.3g} h"


def _limits(side: RateRange) -> str:
    """Format the limits of a rate."""
    upper = "open" if math.isinf(side.upper) else f"{side.upper:.3g}"
    return f"{side.lower:.2g} to {upper}"


def _uneven(item: Statement) -> bool:
    """Return whether the corners flew different numbers of flights."""
    return len({rate.flights for rate in item.cell.rates}) > 1


# Names of epistemic samples: texts are written for corners and adapted to what was flown.

Part = TypeVar("Part")
NOUNS: Mapping[str, str] = {"corners": "corner", "levels": "combination", "walk": "walk"}
"""Name of an epistemic sample by method; "sample" for any other."""


def kind_of(epistemic: EpistemicSection) -> str:
    """Return the method of a campaign for `with_sample_noun`; "samples" if others than corners
    flew.
    """
    # "corner" would be wrong for interior points, the nominal model and ellipsoids.
    mixed = epistemic.method == "corners" and (
        epistemic.interior or epistemic.nominal or epistemic.set != "box"
    )
    return "samples" if mixed else epistemic.method


def with_sample_noun(part: Part, method: str) -> Part:
    """Replace "corner" in a text, or in all texts of a page part, by the noun of the method.

    Parameters
    ----------
    part : str, tuple or page part
        Drawings within it stay as they are.
    method : str
        Result of `kind_of`.
    """
    noun = NOUNS.get(method, "sample")
    return part if noun == "corner" else _replace_corner(part, noun)


def _replace_corner(part: Any, noun: str) -> Any:
    """Replace the noun recursively in texts, tuples and dataclasses."""
    if isinstance(part, str):
        return part.replace("corner", noun).replace("Corner", noun.capitalize())
    if isinstance(part, tuple):
        return tuple(_replace_corner(item, noun) for item in part)
    if isinstance(part, Figure):
        return replace(part, caption=_replace_corner(part.caption, noun))
    if is_dataclass(part) and not isinstance(part, type):
        return replace(
            part, **{f.name: _replace_corner(getattr(part, f.name), noun) for f in fields(part)}
        )
    return part


_QUANTITIES = (
    ("cross_track", "cross-track", "m"),
    ("altitude", "altitude", "m"),
    ("speed", "speed", "mps"),
    ("heading", "heading", "deg"),
)
_UNITS = {"m": "m", "mps": "m/s", "deg": "deg"}
# Medians of the published flight (Hale 2016, section 3.9), measured by its own sensors; 3 m/s wind,
# moderate to severe.
_PUBLISHED = {"cross_track": 9.41, "altitude": 2.16, "speed": 0.61}
_PUBLISHED_AIRCRAFT, _PUBLISHED_WIND_MPS, _PUBLISHED_AIR = "espaaro", 3.0, ("moderate", "severe")


@dataclass(frozen=True)
class Finding:
    """The p-box of a median error.

    Attributes
    ----------
    metric : str
        Column of cases.parquet.
    quantity, words, unit : str
        Quantity, its name in sentences, and unit.
    measured : bool
        Whether the error is that of the noisy sensors.
    condition : Condition
        Wind and turbulence.
    box : PBox
        The p-box.
    samples : sequence of Sample
        Its epistemic samples.
    published : float or None
        Median of the published flight in this condition.
    widened : float or None
        Share of its area by which interior points widen it; None without such points.
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
        """Heading of the figure."""
        origin = "as the sensors measured it" if self.measured else "true, without sensor noise"
        return f"Median {self.words} error, {origin}"

    @property
    def axis(self) -> str:
        """Label of the axis without unit."""
        return f"median |{self.words} error|, {'measured' if self.measured else 'true'}"


@dataclass(frozen=True)
class CampaignReport:
    """A complete campaign with its results.

    Attributes
    ----------
    folder : Path
        Campaign folder.
    manifest : Manifest
        Its manifest.
    frame : DataFrame
        cases.parquet.
    findings : tuple of Finding
        P-boxes of the median errors.
    signed : tuple of Statement
        Claims on excursions.
    question : str
        What the campaign asks.
    verdict : tuple of Sentence
        Its answer.
    engine_check : tuple of CheckRow
        Comparison of the engines.
    """

    folder: Path
    manifest: Manifest
    frame: pd.DataFrame
    findings: tuple[Finding, ...]
    signed: tuple[Statement, ...]
    question: str
    verdict: tuple[Sentence, ...]
    engine_check: tuple[CheckRow, ...] = ()

    @property
    def settings(self) -> Document:
        """Settings of the campaign."""
        return self.manifest.settings

    @property
    def aircraft(self) -> str:
        """Name of the aircraft; "." is the folder of the campaign's file."""
        place = Path(self.manifest.campaign_file).parent / self.settings.campaign.aircraft
        return Path(os.path.normpath(place)).name


def read_campaign_report(folder: Path) -> CampaignReport:
    """Read a complete campaign and formulate its verdict.

    Parameters
    ----------
    folder : Path
        Campaign folder.

    Raises
    ------
    BadInputError
        If the campaign is not complete or a table is damaged.
    """
    # Tables first, then what follows from them.
    manifest = read_complete(folder)
    frame = read_cases(folder, manifest)
    findings = tuple(_findings(frame, manifest))
    signed = tuple(statements(frame, manifest.campaign, read_decisions(folder, manifest)))
    verdict = tuple(_verdict(frame, manifest.settings, findings, signed))
    check = tuple(read_engine_check(folder, manifest))
    question = " ".join(
        [
            _question(frame, manifest.settings),
            *(f"{words[0].upper()}{words[1:]}." for words in joint_words(manifest)),
            *(
                f"{words[0].upper()}{words[1:]}."
                for words in corners_only_words(manifest.campaign["epistemic"])
            ),
        ]
    )
    return CampaignReport(folder, manifest, frame, findings, signed, question, verdict, check)


def _findings(frame: pd.DataFrame, manifest: Manifest) -> list[Finding]:
    """Return the p-boxes of the medians per condition and quantity, measured before true."""
    findings = []
    settings = manifest.settings
    for condition in conditions(frame):
        rows = in_condition(frame, condition)
        # True and measured error of each quantity.
        for quantity, words, unit in _QUANTITIES:
            for measured in (True, False):
                metric = f"{quantity}_median_{unit}" + ("_measured" if measured else "")
                corners = samples(rows, metric) if metric in rows else []
                if (measured and not settings.aleatory.sensor_noise) or not any(
                    c.values.size for c in corners
                ):
                    continue
                # The band allows for sequential looks.
                box = pbox(corners, band_confidence(manifest.campaign, CONFIDENCE))
                published = _published(settings, condition, quantity) if measured else None
                interior_widening = _interior_widening(corners)
                findings.append(
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
                        interior_widening,
                    )
                )
    return findings


def _interior_widening(corner_samples: Sequence[Sample]) -> float | None:
    """Return by which share of its area the interior points widen the p-box of the corners."""
    interior = [
        sample for sample in corner_samples if sample.epistemic_id.startswith(INTERIOR_MARK)
    ]
    corners = [
        sample for sample in corner_samples if not sample.epistemic_id.startswith(INTERIOR_MARK)
    ]
    return widened(corners, interior) if interior and corners else None


def _published(settings: Document, condition: Condition, quantity: str) -> float | None:
    """Return the median of the published flight if aircraft and condition are the same."""
    same_aircraft = Path(settings.campaign.aircraft).name == _PUBLISHED_AIRCRAFT
    same_air = condition.wind_mps == _PUBLISHED_WIND_MPS and condition.turbulence in _PUBLISHED_AIR
    return _PUBLISHED[quantity] if same_aircraft and same_air else None


def _question(frame: pd.DataFrame, settings: Document) -> str:
    """Return the question that the campaign answers, with what was flown."""
    air, epistemic = settings.aleatory, settings.epistemic
    corners = frame["epistemic_id"].nunique()
    between = frame["epistemic_id"][frame["epistemic_id"].str.startswith(INTERIOR_MARK)].nunique()
    ends = "points of the joint ellipsoid" if epistemic.set == "ellipsoid" else "corners"
    interior_text = f" and {between} points between them" if between else ""
    coefficients = ", ".join(epistemic.coefficients)
    intervals = f"within the intervals of {coefficients}"
    # What was flown at each epistemic sample, by method.
    samples_text = {
        "none": "the model as it is, without model-form uncertainty",
        "corners": (
            f"{corners - between} {ends}{interior_text} of the model-form intervals of"
            f" {coefficients}"
        ),
        "levels": f"{corners} combinations of levels {intervals}",
        "lhs": f"{corners} fixed levels, a Latin hypercube, {intervals}",
        "white": f"{corners} samples of levels redrawn at every step {intervals}",
        "walk": f"{corners} random walks {intervals}",
    }[epistemic.method]
    # Walk rates belong to the description.
    if epistemic.method == "walk":
        rates = epistemic.walk_rate_per_sqrt_s or {}
        samples_text += (
            " at "
            + ", ".join(f"{name} {rate:.3g}" for name, rate in rates.items())
            + " per square root of a second"
        )
    if epistemic.parameters is not None:
        samples_text += f"; parameters drawn from {Path(epistemic.parameters.fit).name}"
    winds = ", ".join(f"{wind:g}" for wind in air.wind_mps)
    noise = "noisy" if air.sensor_noise else "noise-free"
    return (
        "How much do errors and excursions of this mission depend on the model's epistemic"
        f" uncertainty? {samples_text[0].upper()}{samples_text[1:]}; {air.flights} flights each,"
        f" of {air.duration_s:g} s scored after {air.burn_in_s:g} s of burn-in; wind {winds}"
        f" m/s from {air.wind_from_deg:g} deg, turbulence {', '.join(air.turbulence)}"
        f" ({air.turbulence_source}), {noise} sensors."
    )


_ANSWER_LEVELS: Mapping[str, Level] = {YES: "good", NO: "bad", OPEN: "warn"}


def _verdict(
    frame: pd.DataFrame,
    settings: Document,
    findings: Sequence[Finding],
    signed: Sequence[Statement],
) -> list[Sentence]:
    """Return the verdict: hardest condition, its excursions and medians, and failures."""
    kind = kind_of(settings.epistemic)
    # The verdict is about the hardest condition.
    hardest = hardest_condition(conditions(frame))
    duration = settings.aleatory.duration_s
    sentences = [Sentence(f"Hardest condition: {hardest.words}.")]
    for statement in signed:
        if statement.cell.condition == hardest and statement.cell.distance == "horizontal":
            sentences.append(
                Sentence(with_sample_noun(sentence(statement), kind), answer_level(statement))
            )
    if PATHLESS_METRICS[0] in frame:
        sentences.append(
            Sentence(
                "No path was commanded: errors are deviations from the state at the start of"
                " scoring."
            )
        )
    for quantity, _, _ in _QUANTITIES:
        pair = [
            item for item in findings if item.condition == hardest and item.quantity == quantity
        ]
        if pair:
            sentences.append(Sentence(with_sample_noun(_median_sentence(pair, duration), kind)))
    # Failed flights are counted as the worst outcome.
    failed = int((frame["status"] != "ok").sum())
    counted = (
        f"{failed} failed; these count as the worst outcome" if failed else "all ended as planned"
    )
    sentences.append(Sentence(f"Of {len(frame)} flights, {counted}.", "warn" if failed else ""))
    # Loss of control in flights that ended on time counts as well.
    losses = int(frame["loss_of_control"].fillna(0).sum())
    loss_text = (
        f"{losses} of the {len(frame)} flights lost control."
        if losses
        else "No scored flight lost control."
    )
    sentences.append(
        Sentence(loss_text, "bad" if losses else "" if failed < len(frame) else "warn")
    )
    return sentences


def answer_level(statement: Statement) -> Level:
    """Return the level of an answer."""
    return _ANSWER_LEVELS[statement.answer]


def hardest_first(grid: Sequence[Condition]) -> list[Condition]:
    """Return conditions from the strongest turbulence and wind to the weakest."""
    remaining, ordered = list(grid), []
    while remaining:
        ordered.append(hardest_condition(remaining))
        remaining.remove(ordered[-1])
    return ordered


def _median_sentence(pair: Sequence[Finding], duration_s: float) -> str:
    """Return a sentence on the median of one quantity, true and measured, with the published
    flight.
    """
    parts = []
    # True before measured.
    for item in sorted(pair, key=lambda finding: finding.measured):
        low, high = item.box.quantile(0.5)
        parts.append(
            f"{span(low, high)} {item.unit} {'as measured' if item.measured else 'in truth'}"
        )
    text = (
        f"Median {pair[0].words} error of a typical {duration_s:g} s flight, best to worst corner:"
        f" {', '.join(parts)}"
    )
    for item in pair:
        if item.published is not None:
            low, high = item.box.value[0], item.box.value[-1]
            where = (
                "within"
                if low <= item.published <= high
                else "below"
                if item.published < low
                else "above"
            )
            text += (
                f"; the published flight's {item.published:g} {item.unit} lies {where} the range"
                " measured by single flights, "
            )
            text += f"{low:.3g} to {high:.3g} {item.unit}"
    return text + "."


def span(low: float, high: float) -> str:
    """Format an interval."""
    if math.isinf(high):
        return f"at least {low:.3g}"
    return f"{low:.3g} to {high:.3g}" if low != high else f"{low:.3g}"


# Sensitivity section.

_SENSITIVITY_METRICS = (
    "cross_track_median_m",
    "altitude_median_m",
    "speed_median_mps",
    "heading_median_deg",
)
Row = Mapping[str, str]


def sensitivity_section(
    folder: Path, manifest: Mapping[str, Any], prefix: str = ""
) -> tuple[Section, ...]:
    """Return the sensitivity section; empty if ``uqharness sensitivity`` was not run.

    Parameters
    ----------
    folder : Path
        Campaign folder.
    manifest : mapping
        Its manifest.
    prefix : str
        Prefix of figure names.

    Raises
    ------
    BadInputError
        If sensitivity.csv is damaged.
    """
    # Display the hardest condition; the table file has all.
    table_rows = read_sensitivity(folder, manifest)
    if not table_rows:
        return ()
    conditions = by_condition(table_rows)
    order = ("none", "light", "moderate", "severe")
    hardest = max(conditions, key=lambda c: (order.index(c.turbulence), c.wind_mps))
    rows = conditions[hardest]
    counts = [
        r["metric"]
        for r in rows
        if r["metric"].startswith("excursions_") and not r["metric"].endswith("_3d")
    ]
    by_metric = {
        m: metric_rows
        for m in (*_SENSITIVITY_METRICS, *counts[:1])
        if (metric_rows := [r for r in rows if r["metric"] == m])
    }
    text = (
        "Share of the p-box's width due to each coefficient's interval: the thick bar is the range"
        " over the values of the other coefficients, the wide pale one its 95 % sampling interval."
        " Coefficients whose ranges overlap are not ranked."
        f" {hardest.words[0].upper()}{hardest.words[1:]}; all conditions and metrics are in"
        " sensitivity.csv."
    )
    table = Table(
        "Share of the p-box's width by coefficient, and the reduction of the width if the"
        " coefficient were known.",
        ("Metric", "Coefficient", "Share", "Its 95 % interval", "Shrinks by"),
        tuple(_table_row(r) for metric_rows in by_metric.values() for r in _ordered(metric_rows)),
    )
    blocks = (
        Words(text, note=True),
        range_figures(rows, tuple(by_metric), hardest, "", prefix),
        table,
    )
    return (Section("Sensitivity", blocks),)


def condition_sections(content: bytes) -> list[Section]:
    """Return the drawings of a sensitivity.csv.

    Parameters
    ----------
    content : bytes
        The file.

    Returns
    -------
    list of Section
        One per condition; its drawings share a file.
    """
    out = []
    for condition, condition_rows in by_condition(
        list(csv.DictReader(content.decode().splitlines()))
    ).items():
        file = f"sensitivity-{condition.wind_mps:g}mps-{condition.turbulence}"
        figures = range_figures(condition_rows, _SENSITIVITY_METRICS[:3], condition, file)
        out += [Section(condition.words, (figures,))] if figures.items else []
    return out


def by_condition(rows: Sequence[Row]) -> dict[Condition, list[Row]]:
    """Group rows of sensitivity.csv by condition."""
    out: dict[Condition, list[Row]] = {}
    for row in rows:
        out.setdefault(Condition(float(row["wind_mps"]), row["turbulence"]), []).append(row)
    return out


def range_figures(
    rows: Sequence[Row], metrics: Sequence[str], condition: Condition, file: str, prefix: str = ""
) -> Figures:
    """Return a chart per metric with a share.

    Parameters
    ----------
    rows : sequence of mapping
        Rows of sensitivity.csv of one condition.
    metrics : sequence of str
        Metrics to draw.
    condition : Condition
        The condition, for captions.
    file, prefix : str
        File as in `Figures`, and prefix of figure names.
    """
    by_metric = {m: [r for r in rows if r["metric"] == m and r["share_min"]] for m in metrics}
    figures = tuple(
        _figure(m, _ordered(metric_rows), condition, prefix)
        for m, metric_rows in by_metric.items()
        if metric_rows
    )
    return Figures(figures, _LEGEND, True, file)


_LEGEND = (
    ("thick", "smallest to largest share over the pairs of corners"),
    ("wide", "95 % sampling interval"),
)


def _ordered(rows: Sequence[Row]) -> list[Row]:
    """Sort rows by share, largest first."""
    return sorted(
        rows, key=lambda r: -(float(r["share_min"] or 0.0) + float(r["share_max"] or 0.0))
    )


def _figure(metric: str, rows: Sequence[Row], condition: Condition, prefix: str) -> Figure:
    """Draw the shares of one metric."""
    words, first = _words(metric), rows[0]
    label = (
        f"Sensitivity of the {words}: shares of the p-box's width [-] by coefficient;"
        f" {first['coefficient']} has {float(first['share_min']):.2g} to"
        f" {float(first['share_max']):.2g}."
    )
    name, x = (
        f"{prefix}sensitivity-{metric.replace('_', '-')}",
        Scale("share of the p-box's width [-]", 0.0, 1.0),
    )
    chart = rows_chart(name, label, x, [r["coefficient"] for r in rows], 22)
    for k, r in enumerate(rows):
        low, high = float(r["share_min"]), float(r["share_max"])
        chart.across(float(r["share_low"] or low), float(r["share_high"] or high), k, "wide")
        chart.across(low, high, k, "thick")
        for end in (low, high):
            chart.marker(end, float(k), "first", "bar")
    return Figure(chart.name, chart.svg(), f"{words[0].upper()}{words[1:]}; {condition.words}.")


def _table_row(r: Row) -> tuple[str, ...]:
    """Return the table row of one coefficient."""
    if not r["share_min"]:
        return (
            _words(r["metric"]),
            r["coefficient"],
            f"undefined: {r['reason']}",
            "undefined",
            "undefined",
        )

    def span(low: str, high: str, scale: float = 1.0, unit: str = "") -> str:
        """Format an interval of scaled numbers."""
        return (
            f"{scale * float(low):.2g} to {scale * float(high):.2g}{unit}"
            if low and high
            else "undefined"
        )

    return (
        _words(r["metric"]),
        r["coefficient"],
        span(r["share_min"], r["share_max"]),
        span(r["share_low"], r["share_high"]),
        span(r["shrink_min"], r["shrink_max"], 100.0, " %"),
    )


def _words(metric: str) -> str:
    """Return the name of a metric in sentences."""
    if metric.startswith("excursions_"):
        return f"excursions beyond {metric.split('_')[1].removesuffix('m')} m"
    quantity = metric.rsplit("_", 2)[0].replace("_", "-")
    return f"median {quantity} error"


# Ground tracks of repeated flights.

MAX_TRACKS = 4
"""Number of tracks in the page, those farthest from the path first."""
_WORST = "cross_track_median_m"
_COLUMNS = ("time_s", "north_m", "east_m", "error_cross_track")


def track_section(folder: Path, frame: pd.DataFrame, prefix: str = "") -> tuple[Section, ...]:
    """Return the tracks of repeated flights, or the command that repeats the worst one.

    Parameters
    ----------
    folder : Path
        Campaign folder; records are in its subfolder rerun.
    frame : DataFrame
        cases.parquet.
    prefix : str
        Prefix of figure names.

    Returns
    -------
    tuple of Section
        Empty for a mission without a commanded path.
    """
    if _WORST not in frame or not frame[_WORST].notna().any():
        return ()
    # Farthest flight first; flights without a value count as farthest.
    rows = frame.assign(far=frame[_WORST].fillna(np.inf)).sort_values(
        ["far", "case_id"], ascending=[False, True]
    )
    figures: list[Figure] = []
    notes: list[Block] = []
    # Records of repeated flights.
    records = {
        path.parent.name: path
        for path in (folder / "rerun").glob("*/record.parquet")
        if path.is_file()
    }
    rows = rows[rows["case_id"].astype(str).isin(list(records))]
    for case_id, epistemic_id, wind, air in rows[
        ["case_id", "epistemic_id", "wind_mps", "turbulence"]
    ].itertuples(index=False):
        if len(figures) == MAX_TRACKS:
            break
        path = records[str(case_id)]
        try:
            figure = _track(
                path,
                f"{prefix}track-{case_id}",
                f"Case {case_id}: {epistemic_id}, {float(wind):g} m/s {air}.",
            )
        except BadInputError as error:
            notes.append(Words(str(error)))
            continue
        if figure is not None:
            figures.append(figure)
    if figures:
        text = "Repeated flights of the campaign, the largest median cross-track error first."
        return (
            Section(
                "Ground track", (Words(text, note=True), *notes, Figures(tuple(figures), file=""))
            ),
        )
    worst = worst_case(frame)
    text = (
        "This folder has no record of a flight. These commands repeat the worst flight of the"
        " hardest condition and draw it here:"
    )
    commands = (
        ("Fly", f"uqharness campaign rerun DIR --case {worst}"),
        ("Report", "uqharness campaign report DIR"),
    )
    return (Section("Ground track", (*notes, Words(text, note=True), Facts(commands))),)


def track_cases(frame: pd.DataFrame) -> tuple[str, ...]:
    """Return the cases to repeat for the ground track: the worst and the median flight."""
    if _WORST not in frame or not frame[_WORST].notna().any():
        return ()
    rows = in_condition(frame, hardest_condition(conditions(frame)))
    scored = rows[rows[_WORST].notna()].sort_values([_WORST, "case_id"], ascending=[False, True])
    return (
        tuple(str(case) for case in dict.fromkeys(scored["case_id"].iloc[[0, len(scored) // 2]]))
        if len(scored)
        else ()
    )


def worst_case(frame: pd.DataFrame) -> str:
    """Return the case with the largest median cross-track error in the hardest condition."""
    rows = in_condition(frame, hardest_condition(conditions(frame)))
    scored = rows[rows[_WORST].notna()]
    rows = (
        rows if scored.empty else scored.sort_values([_WORST, "case_id"], ascending=[False, True])
    )
    return str(rows["case_id"].iloc[0])


def _track(path: Path, name: str, words: str) -> Figure | None:
    """Draw the track of a record; None without a position."""
    table = read_table(path).to_pandas()
    columns = {n: table[n].to_numpy(dtype=float) for n in _COLUMNS if n in table}
    if "error_cross_track" in columns:
        columns["cross_track_m"] = columns.pop("error_cross_track")
    return flight_track(name, columns, words)


# Engine and comparison with JSBSim.

_NAMES: Mapping[str, str] = {"batch": "the batch engine", "jsbsim": "JSBSim"}


def engine_section(engine: str, reasons: Sequence[str], rows: Sequence[CheckRow]) -> Section:
    """Return which engine flew, why, and how far it is from JSBSim.

    Parameters
    ----------
    engine : str
        Engine that flew: ``batch`` or ``jsbsim``.
    reasons : sequence of str
        Why it was chosen.
    rows : sequence of CheckRow
        Comparison of the engines.
    """
    engine_text = engine_words(_NAMES[engine], tuple(reasons))
    blocks: list[Block] = [Words(f"Simulated in {engine_text}.")]
    full_flights = [row for row in rows if row.part == FULL_FLIGHT]
    if engine == "batch":
        flights = len({row.case_id for row in full_flights})
        text = (
            f"{flights} complete flights, and the first seconds of some of each condition, were"
            " repeated in JSBSim. Differences are relative to the metric's spread over the"
            f" condition's flights; at {TOLERANCE:g} of it the campaign would have stopped."
            " engine-check.csv has every row."
        )
        blocks += [Words(text, note=True), *_tables(full_flights)]
    return Section("Engine", tuple(blocks))


def _tables(rows: Sequence[CheckRow]) -> list[Block]:
    """Return the table of differences between the engines by metric."""
    by_metric: dict[str, list[CheckRow]] = {}
    for row in rows:
        if row.difference or row.metric == STATUS:
            by_metric.setdefault(row.metric, []).append(row)
    if not by_metric:
        return []
    head = ("Metric", "Flights", "Largest difference over spread", "Excused")
    return [
        Table(
            "The batch engine against JSBSim.",
            head,
            tuple(_row(name, metric_rows) for name, metric_rows in by_metric.items()),
        )
    ]


def _row(name: str, rows: Sequence[CheckRow]) -> tuple[str, ...]:
    """Return the row of one metric."""
    excused = [row for row in rows if row.verdict == "excused"]
    remarks = "; ".join(dict.fromkeys(row.remark for row in excused))
    shares = [as_number(row.difference) for row in rows if row.verdict != "excused"]
    defined = [share for share in shares if not math.isnan(share)]
    largest = "" if name == STATUS else f"{max(defined):.2g}" if defined else "undefined"
    return (name, str(len(rows)), largest, f"{len(excused)} ({remarks})" if excused else "0")


# Comparison of two campaigns.

_OVERLAID = 2
"""Number of conditions, the hardest, whose p-boxes are drawn in one chart."""


def overlay_section(
    before: CampaignReport,
    after: CampaignReport,
    names: Mapping[str, str],
    prefix: str = "",
    title: str = "Before and after",
) -> Section:
    """Draw the p-boxes of two campaigns in one chart wherever both have the same quantity.

    Parameters
    ----------
    before, after : CampaignReport
        Campaigns.
    names : mapping of str to str
        Names of the two by "before" and "after".
    prefix, title : str
        Prefix of figure names, and heading.

    Returns
    -------
    Section
        Charts of the hardest conditions, and a table of all.
    """
    titles = ("before", "after")
    # Draw the hardest conditions that both campaigns flew.
    displayed = hardest_first(
        [c for c in conditions(before.frame) if c in conditions(after.frame)]
    )[:_OVERLAID]
    words = [corner_words(side.frame) for side in (before, after)]
    # Findings of the second campaign by metric and condition.
    updated = {(item.metric, item.condition): item for item in after.findings}
    figures, rows = [], []
    for item in sorted(
        before.findings,
        key=lambda f: displayed.index(f.condition) if f.condition in displayed else len(displayed),
    ):
        other = updated.get((item.metric, item.condition))
        if other is None:
            continue
        if item.condition in displayed:
            # After is solid and before dashed, as in every other chart of the two.
            boxes = [
                LabelledBox(t, f.box, f.samples, w)
                for t, f, w in zip(titles, (item, other), words, strict=True)
            ][::-1]
            place = f"{item.condition.wind_mps:g}mps-{item.condition.turbulence}".replace(".", "p")
            name = f"{prefix}before-after-{item.metric.replace('_', '-')}-{place}"
            figures.append(
                pbox_figure(
                    name, item.axis, item.unit, boxes, f"{item.title}; {item.condition.words}."
                )
            )
        # Width at the median before and after.
        ends = [f.box.quantile(0.5) for f in (item, other)]
        widths = [high - low for low, high in ends]
        ratio = (
            widths[1] / widths[0] if widths[0] > 0.0 and widths[0] < float("inf") else float("nan")
        )
        # A width is a fact, not a tested claim, so it gets no tick.
        level: Level = "warn" if ratio > 1.0 else ""
        change = Cell(
            format_value(ratio, ".2f"),
            level,
            small="wider" if ratio > 1.0 else "narrower" if ratio < 1.0 else "",
        )
        rows.append(
            (
                f"{item.title} [{item.unit}]",
                item.condition.label,
                span(*ends[0]),
                span(*ends[1]),
                change,
            )
        )
    if not figures:
        return Section(
            title, (Words("The two campaigns share no quantity in the same condition."),)
        )
    text = (
        f"P-boxes before (dashed: {names['before']}) and after (solid: {names['after']}). A"
        " narrower box has less epistemic uncertainty; a shifted box shows an error of the first"
        " model. The cursor shows the epistemic sample that sets each side."
    )
    notes: list[Block] = [Words(text, note=True)]
    # A change of settings makes the comparison ambiguous.
    unlike = _differences(before, after)
    if unlike:
        notes.append(
            Words(f"The campaigns differ in {unlike} too, which may explain part of the change.")
        )
    head = ("Error", "Condition", "Middle before", "Middle after", "Width after over before [-]")
    table = Table("Medians of the flights, before and after.", head, tuple(rows))
    return Section(title, (*notes, Figures(tuple(figures)), table))


def _differences(before: CampaignReport, after: CampaignReport) -> str:
    """Return what two campaigns flew differently besides the model and its bounds."""
    first, second = before.settings, after.settings
    names = ["seed"] if first.campaign.seed != second.campaign.seed else []
    keys = [key for key in type(first.aleatory).model_fields if key != "variables"]
    names += [k for k in keys if getattr(first.aleatory, k) != getattr(second.aleatory, k)]
    return ", ".join(names)
