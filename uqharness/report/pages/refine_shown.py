"""What a refinement did to the model's intervals and to a mission, as sections of its page."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from uqharness.errors import BadInputError
from uqharness.report.campaign import read_found
from uqharness.report.overlay import overlay_section
from uqharness.report.parts import Cell, Level, Section, Table, Words, shown


def interval_section(gap: Mapping[str, Any]) -> Section:
    """Width and coverage of the model-form intervals on the test flights, before and after."""
    title = "Model-form intervals on the test flights"
    intervals = gap.get("intervals") or {"reason": "this folder was written before they were computed"}
    if intervals["reason"] is not None:
        return Section(title, (Words(f"Not shown: {intervals['reason']}."),))
    rows = []
    for name, r in intervals["coefficients"].items():
        before, after = r["width_before"], r["width_after"]
        level: Level = "" if before is None or after is None or before == after else "good" if after < before else "bad"
        rows.append((name, shown(before), Cell(shown(after), level), *(_share(r, when) for when in ("before", "after"))))
    head = ("Coefficient [1]", "Mean width before", "After", "Test samples inside before [%]", "After [%]")
    caption = f"{100.0 * intervals['confidence']:g} % intervals of each model, fitted on the train flights."
    text = "As uqharness bounds fits them, one set for each model; ± is one standard error, neighbouring samples being alike."
    return Section(title, (Words(text, note=True), Table(caption, head, tuple(rows))))


def _share(row: Mapping[str, Any], when: str) -> str:
    share, std = row[f"coverage_{when}"], row[f"coverage_std_{when}"]
    return "undefined" if share is None else f"{100.0 * share:.1f} ± {shown(None if std is None else 100.0 * std, '.1f')}"


def mission_section(folder: Path, gap: Mapping[str, Any], prefix: str = "") -> Section:
    """P-boxes of the mission flown with both models inside their own intervals."""
    title = "The mission before and after"
    mission = gap.get("pbox") or {"reason": "this folder was written before it was flown"}
    if mission.get("reason") is not None:
        return Section(title, (Words(f"Not shown: {mission['reason']}."),))
    folders = mission["folders"]
    said = (
        f"{mission['mission']}, {mission['corners']} corners, {mission['flights_per_corner']} flights of "
        f"{mission['duration_s']:g} s each, the same air for both models. Failed flights: {mission['before']['failed']} before, "
        f"{mission['after']['failed']} after."
    )
    if len(folders) < 2:
        return Section(title, (Words(f"{said} Without an effect there is one model, and nothing to compare."),))
    try:
        pair = [read_found(folder / name) for name in folders]
    except BadInputError as error:
        return Section(title, (Words(f"{said} The campaigns cannot be read: {error}"),))
    drawn = overlay_section(pair[0], pair[1], dict(zip(("before", "after"), folders, strict=True)), f"{prefix}mission-", title)
    return Section(title, (Words(said, note=True), *drawn.blocks))
