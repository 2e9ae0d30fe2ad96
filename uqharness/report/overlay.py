"""P-boxes of two campaigns over each other: the same flights before and after something changed in the model."""

from __future__ import annotations

from collections.abc import Mapping

from uqharness.campaign.conditions import conditions
from uqharness.report.campaign import CampaignFound, hardest_first, span
from uqharness.report.parts import Block, Cell, Figures, Level, Section, Table, Words, shown
from uqharness.report.pbox import DrawnBox, corner_words, pbox_figure

_OVERLAID = 2
"""Conditions whose p-boxes are drawn over each other, the hardest; the table holds all."""


def overlay_section(
    before: CampaignFound,
    after: CampaignFound,
    names: Mapping[str, str],
    prefix: str = "",
    title: str = "Before and after",
) -> Section:
    """P-boxes of two campaigns over each other wherever both have the same quantity in the same condition."""
    titles = ("before", "after")
    drawn = hardest_first([c for c in conditions(before.frame) if c in conditions(after.frame)])[
        :_OVERLAID
    ]
    words = [corner_words(side.frame) for side in (before, after)]
    later = {(item.metric, item.condition): item for item in after.findings}
    figures, rows = [], []
    for item in sorted(
        before.findings,
        key=lambda f: drawn.index(f.condition) if f.condition in drawn else len(drawn),
    ):
        other = later.get((item.metric, item.condition))
        if other is None:
            continue
        if item.condition in drawn:
            # After is solid and before dashed, as in every other chart of the two.
            boxes = [
                DrawnBox(t, f.box, f.samples, w)
                for t, f, w in zip(titles, (item, other), words, strict=True)
            ][::-1]
            place = f"{item.condition.wind_mps:g}mps-{item.condition.turbulence}".replace(".", "p")
            name = f"{prefix}before-after-{item.metric.replace('_', '-')}-{place}"
            figures.append(
                pbox_figure(
                    name, item.axis, item.unit, boxes, f"{item.title}; {item.condition.words}."
                )
            )
        ends = [f.box.quantile(0.5) for f in (item, other)]
        widths = [high - low for low, high in ends]
        ratio = (
            widths[1] / widths[0] if widths[0] > 0.0 and widths[0] < float("inf") else float("nan")
        )
        # A width is a fact: no claim was tested that a tick could confirm.
        level: Level = "warn" if ratio > 1.0 else ""
        change = Cell(
            shown(ratio, ".2f"),
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
        f"Two p-boxes over each other: the dashed one before ({names['before']}), the solid one after ({names['after']})."
        " A narrower box means that less is unknown; a "
        "box that moved means that the model was wrong. The cursor names the epistemic sample behind each side."
    )
    notes: list[Block] = [Words(text, note=True)]
    unlike = _unlike(before, after)
    if unlike:
        notes.append(
            Words(
                f"Not the same flights otherwise: {unlike} differ, so part of the change may be theirs."
            )
        )
    head = ("Error", "Condition", "Middle before", "Middle after", "Width after over before [-]")
    table = Table("Where half of the flights stay below, before and after.", head, tuple(rows))
    return Section(title, (*notes, Figures(tuple(figures)), table))


def _unlike(before: CampaignFound, after: CampaignFound) -> str:
    """What of two campaigns is flown differently, besides the model and its bounds."""
    pairs = [
        (side.campaign["campaign"]["seed"], side.campaign["aleatory"]) for side in (before, after)
    ]
    names = ["seed"] if pairs[0][0] != pairs[1][0] else []
    keys = [k for k in pairs[0][1] if k != "variables"]
    return ", ".join([*names, *(k for k in keys if pairs[0][1].get(k) != pairs[1][1].get(k))])
