"""Build the page of a campaign: p-boxes, answers, rates, sensitivity, failures, provenance."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import pandas as pd

from sysid.units import percent
from uqharness.campaign import (
    CONFIDENCE,
    Condition,
    ExcursionCell,
    Statement,
    corners_only_words,
)
from uqharness.campaign.conditions import conditions
from uqharness.report import campaign as report_statements
from uqharness.report.campaign import (
    CampaignReport,
    Finding,
    answer_level,
    engine_section,
    hardest_first,
    kind_of,
    sensitivity_section,
    span,
    track_section,
    with_sample_noun,
)
from uqharness.report.parts import (
    Block,
    Bullets,
    Cell,
    Figure,
    Figures,
    Level,
    Page,
    Section,
    Table,
    Words,
    format_value,
    is_wanted,
    provenance,
)
from uqharness.report.pbox import LabelledBox, corner_words, pbox_figure
from uqharness.statistics import ExcursionRate, best_and_worst, poisson_upper

CONDITIONS_DRAWN = 4
"""Number of conditions, the hardest, whose p-boxes are drawn; the tables hold all."""

PBOXES = "P-boxes of the median errors"
_FAILURES_LISTED = 40
_SURE = f"{100 * CONFIDENCE:g} %"
_MARKS = {"yes": "✓", "no": "✕", "open": "?"}


def campaign_page(
    report: CampaignReport, prefix: str = "", only: Collection[str] | None = None
) -> Page:
    """Return the page of a campaign.

    Parameters
    ----------
    report : CampaignReport
        Complete campaign.
    prefix : str
        Prefix of figure names, unique if several campaigns share a page.
    only : collection of str, optional
        Titles of the sections to build; default: all.
    """
    # Texts are written for corners and adapted to the samples that were flown.
    kind = kind_of(report.settings.epistemic)
    sections = [with_sample_noun(grid_section(report.signed), kind)]
    if is_wanted(PBOXES, only):
        section = with_sample_noun(pbox_section(report, prefix), kind)
        remarks = tuple(
            Words(f"{text[0].upper()}{text[1:]}.")
            for text in corners_only_words(report.manifest.campaign["epistemic"])
        )
        sections.append(replace(section, blocks=(*remarks, *section.blocks)))
    sections += track_section(report.folder, report.frame, prefix)
    sections += sensitivity_section(report.folder, report.manifest, prefix)
    sections += [
        *(with_sample_noun(s, kind) for s in rate_sections(report)),
        failure_section(report.frame),
    ]
    engine = report.settings.campaign.engine
    sections += [
        engine_section(engine, report.manifest.engine_reasons, report.engine_check),
        _provenance(report),
    ]
    return Page(f"Campaign of {report.aircraft}", report.question, report.verdict, tuple(sections))


def pbox_section(report: CampaignReport, prefix: str = "") -> Section:
    """Return the p-boxes of the medians in the hardest conditions, and a table of all.

    Parameters
    ----------
    report : CampaignReport
        Complete campaign.
    prefix : str
        Prefix of figure names.

    Returns
    -------
    Section
        Drawings of at most `CONDITIONS_DRAWN` conditions and the table of medians.
    """
    # Draw the hardest conditions only.
    displayed = hardest_first(conditions(report.frame))[:CONDITIONS_DRAWN]
    words = corner_words(report.frame)
    figures = tuple(
        _figure(item, words, prefix)
        for condition in displayed
        for item in report.findings
        if item.condition == condition
    )
    intro = (
        "Each thin curve is one epistemic sample: the cumulative probability of its flights'"
        " median error. The bold pair is their envelope, the p-box; its width is epistemic"
        " uncertainty, its slope aleatory. The dashed band adds the sampling error of a finite"
        f" number of flights: it holds for all corners and all values together at {_SURE}. The"
        " cursor shows the sample that sets either side: − for a coefficient at its lower bound, +"
        " for one at its upper."
    )
    published = any(item.published is not None for item in report.findings)
    if published:
        intro += (
            " The published flight was measured by its sensors, so it is marked only in charts of"
            " measured errors."
        )
    blocks: list[Block] = [Words(intro, note=True), Figures(figures, file="")]
    # Say how many conditions are not drawn.
    undrawn = len(conditions(report.frame)) - len(displayed)
    if undrawn > 0:
        text = (
            f"Further conditions, not drawn: {undrawn}; they are in the tables below and in"
            " pbox.parquet."
        )
        blocks.append(Words(text, note=True))
    between = any(item.widened is not None for item in report.findings)
    head = [
        "Error",
        "Condition",
        "Middle of the p-box",
        f"With {_SURE} band",
        "Set by, best",
        "Set by, worst",
    ]
    head += [
        *(["Widened by interior points"] if between else []),
        *(["Published flight"] if published else []),
    ]
    caption = (
        "Medians of the flights: the range of the p-box at probability 0.5, the same with the"
        " band, and the samples that set its two ends"
        + (", and the share of the p-box's area that interior points add." if between else ".")
    )
    blocks.append(
        Table(
            caption,
            tuple(head),
            tuple(_median_row(item, words, between, published) for item in report.findings),
        )
    )
    return Section(PBOXES, tuple(blocks))


def _figure(item: Finding, words: dict[str, str], prefix: str) -> Figure:
    """Draw the p-box of one median."""
    place = f"{item.condition.wind_mps:g}mps-{item.condition.turbulence}"
    name = f"{prefix}pbox-{item.metric.replace('_', '-')}-{place}".replace(".", "p")
    mark = (
        None
        if item.published is None
        else (item.published, f"published flight, {item.published:g} {item.unit}")
    )
    labelled_box = LabelledBox("", item.box, item.samples, words)
    return pbox_figure(
        name, item.axis, item.unit, [labelled_box], f"{item.title}; {item.condition.words}.", mark
    )


def _median_row(
    item: Finding, words: dict[str, str], between: bool, published: bool
) -> tuple[str, ...]:
    """Return the table row of one median."""
    # Median of the p-box with its band, and the samples that set its ends.
    band = " to ".join(format_value(end) for end in item.box.band_quantile(0.5))
    ends = [words.get(name, name) for name in item.box.set_by(0.5)]
    row = [
        f"{item.title} [{item.unit}]",
        item.condition.label,
        span(*item.box.quantile(0.5)),
        band,
        *ends,
    ]
    if between:
        row.append(
            "" if item.widened is None or math.isnan(item.widened) else percent(item.widened)
        )
    if published:
        row.append("" if item.published is None else f"{item.published:g}")
    return tuple(row)


def grid_section(
    signed: Sequence[Statement], title: str = "Where the answer is yes, no or inconclusive"
) -> Section:
    """Return a grid of answers per radius: wind across, turbulence down.

    Parameters
    ----------
    signed : sequence of Statement
        Claims on excursions.
    title : str
        Heading.

    Returns
    -------
    Section
        Each cell holds the answer and the rate at the worst corner.
    """
    acceptable = f"{signed[0].acceptable_per_h:g}" if signed else ""
    text = (
        f"The question of each cell: at most {acceptable} excursions per flight hour at every"
        " corner? ✓ yes; ✕ no: some corner has more; ? inconclusive: too few flight hours, or the"
        " reason in the cell. Below the answer is the rate at the worst corner with its"
        f" {_SURE} limits, in excursions per flight hour."
    )
    if not signed:
        return Section(title, (Words("This campaign counts no excursions.", note=True),))
    tables: list[Block] = []
    for radius in dict.fromkeys(item.cell.radius_m for item in signed):
        # Cells of this radius, horizontal distance only.
        cells = {
            (item.cell.condition.turbulence, item.cell.condition.wind_mps): item
            for item in signed
            if item.cell.radius_m == radius and item.cell.distance == "horizontal"
        }
        winds = sorted({wind for _, wind in cells})
        rows: list[tuple[str | Cell, ...]] = [
            (air, *(_grid_cell(cells.get((air, wind))) for wind in winds))
            for air in dict.fromkeys(air for air, _ in cells)
        ]
        head = ("Turbulence", *(f"{wind:g} m/s wind" for wind in winds))
        if cells:
            tables.append(
                Table(
                    f"Excursions beyond {radius:g} m, horizontal distance, per flight hour.",
                    head,
                    tuple(rows),
                )
            )
    return Section(title, (Words(text, note=True), *tables))


def _grid_cell(item: Statement | None) -> Cell:
    """Return the answer of a condition with the rate at the worst corner."""
    if item is None:
        return Cell("not flown")
    limits = f"{item.worst.lower:.2g} to {format_value(item.worst.upper)}"
    rate = (
        "undefined: no flight was scored"
        if math.isnan(item.worst.rate)
        else f"{item.worst.rate:.3g} per h [{limits}]"
    )
    level: Level = answer_level(item)
    return Cell(
        item.answer,
        level,
        f"{item.reason}; {rate}" if item.reason else rate,
        mark=_MARKS[item.answer],
    )


def rate_sections(report: CampaignReport) -> list[Section]:
    """Return the supportable claims, and the counts behind them."""
    signed = report.signed
    acceptable = f"{report.settings.metrics.acceptable_per_h:g}"
    text = (
        f"Excursions per flight hour of the best and the worst corner with limits ({_SURE} each)."
        " Each flight counts as one sample, so the limits allow for clusters of excursions, and"
        ' they hold for all corners at once. "Yes": every corner has at most'
        f' {acceptable} per hour; "no": some corner has more; each is wrong with a probability of'
        " at most the error rate of its condition."
    )
    # Columns of aborted flights only if there are some.
    kinds = report_statements.aborted_kinds(signed)
    head = (
        "Condition",
        "Beyond",
        "Best corner [1/h]",
        "Worst corner [1/h]",
        f"At most {acceptable} per hour?",
        "Flight hours",
        *report_statements.aborted_head(kinds),
        "Variance over mean",
        "Allowed for, and hours needed without excursions",
        "Time outside the data",
    )
    # Claims: limits that hold for clusters and for having picked the corner.
    words = corner_words(report.frame)
    rows = tuple(_signed_row(item, words, kinds) for item in signed)
    first = Section(
        "Supportable claims",
        (
            Words(text, note=True),
            Table(
                "Supportable claims: excursions per flight hour, by condition and radius.",
                head,
                rows,
            ),
            Bullets(tuple(report_statements.assumptions(signed, report.settings))),
        ),
    )
    text = (
        f"In brackets: exact Poisson limits ({_SURE}) of that corner alone; after 0 the one-sided"
        " limit. The last limits hold for all corners at once. Poisson limits assume independent"
        " excursions and hours that were fixed beforehand; otherwise use the table above. A failed"
        " flight counts as one more excursion in the upper limit."
    )
    # Counts: limits of each corner alone, under the usual assumptions.
    counted = (
        "Condition",
        "Beyond",
        "Best corner [1/h]",
        "Worst corner [1/h]",
        "Limits over all corners [1/h]",
        "Hours per corner",
        "Failed flights",
    )
    rows = tuple(_excursion_row(item.cell, words) for item in signed)
    second = Section(
        "Excursions per flight hour",
        (
            Words(text, note=True),
            Table("Excursions counted per flight hour, best and worst corner.", counted, rows),
        ),
    )
    return [first, second]


def _signed_row(
    item: Statement, words: dict[str, str], kinds: Sequence[str]
) -> tuple[str | Cell, ...]:
    """Return the row of a claim."""
    row = report_statements.row(item)
    worst = Cell(row["worst"], small=words.get(row["worst_corner"], row["worst_corner"]))
    answer = Cell(item.answer, answer_level(item), item.reason, mark=_MARKS[item.answer])
    return (
        row["condition"],
        row["radius"],
        row["best"],
        worst,
        answer,
        row["hours"],
        *report_statements.aborted_cells(kinds, [item]),
        row["dispersion"],
        row["carried"],
        row["outside"],
    )


def _excursion_row(cell: ExcursionCell, words: dict[str, str]) -> tuple[str | Cell, ...]:
    """Return the row of counted excursions, best and worst corner."""
    best, worst = best_and_worst(cell.rates)
    return (
        cell.condition.label,
        f"{cell.radius_m:g} m, {'3-D' if cell.distance == '3d' else 'horizontal'}",
        Cell(
            _rate(best, best.rate, best.events),
            small=words.get(best.epistemic_id, best.epistemic_id),
        ),
        Cell(
            _rate(worst, worst.rate_upper, worst.events_upper),
            small=words.get(worst.epistemic_id, worst.epistemic_id),
        ),
        f"{best.simultaneous[0]:.2g} to {format_value(worst.simultaneous[1])}",
        f"{worst.hours:.3g}",
        str(sum(rate.failed for rate in cell.rates)),
    )


def _rate(item: ExcursionRate, rate: float, events: int) -> str:
    """Format a rate with its exact Poisson limits."""
    if math.isnan(rate):
        return "undefined: no hours"
    # Without an event only the one-sided limit is meaningful.
    if events == 0:
        return f"0 (< {poisson_upper(0, item.hours, CONFIDENCE):.2g})"
    return f"{format_value(rate)} [{item.limits[0]:.2g}, {format_value(item.limits[1])}]"


def failure_section(frame: pd.DataFrame) -> Section:
    """Return the list of failed flights."""
    failed = frame[frame["status"] != "ok"]
    if failed.empty:
        return Section("Failed flights", (Words("None."),))
    # List the first failures by name.
    more = (
        f", the first {_FAILURES_LISTED} are listed; all are in cases.parquet"
        if len(failed) > _FAILURES_LISTED
        else ""
    )
    names = ["case_id", "epistemic_id", "aleatory_id", "wind_mps", "turbulence", "status", "reason"]
    rows = []
    for case, corner, flight, wind, air, status, reason in (
        failed[names].head(_FAILURES_LISTED).itertuples(index=False)
    ):
        where = Condition(float(wind), str(air)).label
        rows.append(
            (Cell(case, code=True), Cell(corner, code=True), str(flight), where, status, reason)
        )
    head = ("Case", "Corner", "Flight", "Condition", "Status", "Reason")
    return Section("Failed flights", (Table(f"{len(failed)} failed{more}.", head, tuple(rows)),))


def _provenance(report: CampaignReport) -> Section:
    """Return commands, seed, versions and hashes with which the campaign can be repeated."""
    manifest, settings = report.manifest, report.settings.campaign
    names = {"aircraft": settings.aircraft, "script": settings.mission}
    # Hash of each input with its name.
    hashes = [
        (f"{role.capitalize()} (SHA-256)", " ".join([digest, names.get(role, "")]).strip())
        for role, digest in manifest.hashes.items()
    ]
    return provenance(
        ("Command", manifest.command or "not recorded"),
        ("One flight again", "uqharness campaign rerun DIR --case CASE"),
        ("Root seed", str(manifest.seed)),
        (
            "Versions",
            ", ".join(f"{name} {version}" for name, version in manifest.versions.items()),
        ),
        *hashes,
        (
            "Tables",
            (
                "cases.parquet (one row per flight), pbox.parquet, excursions.csv, statements.csv,"
                " next to this page"
            ),
        ),
    )
