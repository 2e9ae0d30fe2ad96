"""What a refinement did to the model's intervals and to a mission, as sections of its page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from uqharness.errors import BadInputError
from uqharness.report.parts import (
    Block,
    Cell,
    Figure,
    Figures,
    Level,
    Section,
    Table,
    Words,
    percent,
    shown,
)
from uqharness.report.svg import Scale, rows_chart


def interval_section(gap: Mapping[str, Any], prefix: str = "") -> Section:
    """Width and coverage of the model-form intervals on the test flights, before and after."""
    title = "Model-form intervals on the test flights"
    intervals = gap.get("intervals") or {
        "reason": "this folder was written before they were computed"
    }
    if intervals["reason"] is not None:
        return Section(title, (Words(f"Not shown: {intervals['reason']}."),))
    rows = []
    for name, r in intervals["coefficients"].items():
        before, after = r["width_before"], r["width_after"]
        level: Level = "warn" if before is not None and after is not None and after > before else ""
        rows.append(
            (
                name,
                shown(before),
                Cell(shown(after), level),
                *(_share(r, when) for when in ("before", "after")),
            )
        )
    head = (
        "Coefficient [-]",
        "Mean width before",
        "After",
        "Test samples inside before [%]",
        "After [%]",
    )
    caption = f"{100.0 * intervals['confidence']:g} % intervals of each model, fitted on the train flights."
    text = "As uqharness bounds fits them, one set for each model; ± is one standard error, neighbouring samples being alike."
    figures = Figures(
        _interval_figures(intervals, prefix),
        (("second", "before"), ("first", "after")),
        file="intervals",
    )
    return Section(
        title, (Words(text, note=True), figures, Table(caption, head, tuple(rows), key=True))
    )


def _interval_figures(intervals: Mapping[str, Any], prefix: str) -> tuple[Figure, ...]:
    """Mean width after over before, and the share of the test samples inside with its 95 % limits."""
    rows = intervals["coefficients"]
    widths = {
        c: r["width_after"] / r["width_before"]
        for c, r in rows.items()
        if r["width_after"] and r["width_before"]
    }
    out = []
    if widths:
        label = (
            "Mean width after over before [-]: "
            + ", ".join(f"{c} {v:.2f}" for c, v in widths.items())
            + "."
        )
        x = Scale("mean width after over before [-]", 0.0, 1.1 * max(1.0, *widths.values()))
        chart = rows_chart(f"{prefix}interval-widths", label, x, tuple(rows), 24)
        chart.upright(1.0, "zero")
        for k, c in enumerate(rows):
            if c in widths:
                chart.marker(widths[c], float(k), "first", "disc")
        out.append(
            Figure(chart.name, chart.svg(), "Mean width of the intervals after, over before [-].")
        )
    sides = (("before", "second", "ring", -0.15), ("after", "first", "disc", 0.15))
    known = [
        (
            k + aside,
            kind,
            shape,
            100.0 * r[f"coverage_{when}"],
            196.0 * (r[f"coverage_std_{when}"] or 0.0),
        )
        for k, r in enumerate(rows.values())
        for when, kind, shape, aside in sides
        if r[f"coverage_{when}"] is not None
    ]
    if known:
        label = f"Test samples inside the intervals [%], {min(row[3] for row in known):.1f} at the least."
        least = min(share - half for *_, share, half in known)
        x = Scale("test samples inside [%], with 95 % limits", max(0.0, least - 2.0), 101.0)
        chart = rows_chart(f"{prefix}interval-coverage", label, x, tuple(rows), 24)
        chart.upright(100.0 * intervals["confidence"], "limit")
        for at, kind, shape, share, half in known:
            chart.across(share - half, share + half, at, kind)
            chart.marker(share, at, kind, shape)
        out.append(
            Figure(
                chart.name,
                chart.svg(),
                "Share of the test samples inside; the dashed line is what is asked for.",
            )
        )
    return tuple(out)


def _share(row: Mapping[str, Any], when: str) -> str:
    share, std = row[f"coverage_{when}"], row[f"coverage_std_{when}"]
    return "undefined" if share is None else f"{percent(share, '.1f')} ± {percent(std, '.1f')}"


def mission_section(folder: Path, gap: Mapping[str, Any], prefix: str = "") -> Section:
    """P-boxes of the mission flown with both models inside their own intervals."""
    title = "The mission before and after"
    mission = gap.get("pbox") or {"reason": "this folder was written before it was flown"}
    if mission.get("reason") is not None:
        return Section(title, (Words(f"Not shown: {mission['reason']}."),))
    # With these pandas is loaded, and not every refinement flies a mission.
    from uqharness.report.campaign import read_found
    from uqharness.report.overlay import overlay_section

    folders = mission["folders"]
    said = (
        f"{mission['mission']}, {mission['corners']} corners, {mission['flights_per_corner']} flights of "
        f"{mission['duration_s']:g} s each, the same air for both models. Failed flights: {mission['before']['failed']} before, "
        f"{mission['after']['failed']} after."
    )
    if len(folders) < 2:
        return Section(
            title, (Words(f"{said} Without an effect there is one model, and nothing to compare."),)
        )
    try:
        pair = [read_found(folder / name) for name in folders]
    except BadInputError as error:
        return Section(title, (Words(f"{said} The campaigns cannot be read: {error}"),))
    drawn = overlay_section(
        pair[0],
        pair[1],
        dict(zip(("before", "after"), folders, strict=True)),
        f"{prefix}mission-",
        title,
    )
    blocks: list[Block] = [Words(said, note=True)]
    for block in drawn.blocks:
        if isinstance(block, Figures):
            blocks.append(replace(block, file="pbox"))
        else:
            blocks.append(replace(block, key=True) if isinstance(block, Table) else block)
    return Section(title, tuple(blocks))
