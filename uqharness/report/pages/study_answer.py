"""What a study's page shows before anything is unfolded: the answer, the ground track, one p-box, the effect found, the cells."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from uqharness.campaign import CONFIDENCE, Condition, Statement, hardest_of
from uqharness.campaign.conditions import conditions
from uqharness.errors import BadInputError
from uqharness.parquet_files import read_table
from uqharness.refinement_document import Refinement
from uqharness.replay import HISTORIES, read_histories
from uqharness.report.campaign import CampaignFound, answer_level, span
from uqharness.report.ground_track import ground_track, lap_of, track_distance
from uqharness.report.history import Model, farthest_figure
from uqharness.report.pages.compare import ratio_figure
from uqharness.report.pages.refine_effects import capital
from uqharness.report.parts import (
    Block,
    Cell,
    Figure,
    Figures,
    Level,
    Say,
    Section,
    Table,
    Words,
    shown,
)
from uqharness.report.pbox import DrawnBox, corner_words, pbox_figure
from uqharness.report.statements import aborted_cells, aborted_head, aborted_kinds
from uqharness.result_documents import read_document

_SURE = f"{100 * CONFIDENCE:g} %"
_MARKS = {"yes": "✓", "no": "✕", "open": "?"}
_WORDS = {"yes": "yes", "no": "no", "open": "inconclusive"}
_FIRST = ("cross_track_median_m", "altitude_median_m", "speed_median_mps", "heading_median_deg")
_NONE_ABORTED = "No flight was aborted."
_TRACK_COLUMNS = ("when", "model", "time_s", "north_m", "east_m", "distance_m")
Sides = Mapping[str, CampaignFound]
"""Campaigns by when they were flown: before, after."""


def answer_says(answer: Mapping[str, Any]) -> tuple[Say, ...]:
    """The answer with its level, then why, what the model lacked, and what to do next as plain facts."""
    level: Level = answer["level"] if answer["level"] in ("good", "warn", "bad") else ""
    rest = (answer[part] for part in ("why", "lacked", "next"))
    return Say(answer["answer"], level), *(Say(text) for text in rest if text)


def first_figures(
    folder: Path, study: Mapping[str, Any], sides: Sides, missing: list[str]
) -> tuple[Block, ...]:
    """One lap as ground track and as distance over time, and the p-box, all of the hardest condition; those of them that there are.

    Damage is told in ``missing``.
    """
    try:
        drawn = _lap(folder / "tracks.parquet", study.get("tracks") or {})
    except BadInputError as error:
        missing.append(str(error))
        drawn = []
    box = _pbox(sides)
    drawn += [] if box is None else [box]
    return (Figures(tuple(drawn), narrow=True),) if drawn else ()


def _lap(path: Path, tracks: Mapping[str, Any]) -> list[Figure]:
    if "radius_m" not in tracks:
        return []
    frame = read_table(path).to_pandas()
    lacking = [name for name in _TRACK_COLUMNS if name not in frame]
    if lacking:
        raise BadInputError(f"{path}: has no column {', '.join(lacking)}; run the study again")
    lap, radius_m = lap_of(frame), float(tracks["radius_m"])
    if lap is None:
        return []
    condition = Condition(float(tracks["wind_mps"]), str(tracks["turbulence"]))
    track = ground_track("ground-track", lap, radius_m, condition.words)
    return [track, track_distance("track-distance", lap, radius_m)]


def _pbox(sides: Sides) -> Figure | None:
    """The first quantity that all campaigns have in the hardest condition, over each other."""
    if not sides:
        return None
    *_, last = sides.values()
    condition = hardest_of(conditions(last.frame))
    for metric in _FIRST:
        items = {
            w: next((f for f in s.findings if (f.metric, f.condition) == (metric, condition)), None)
            for w, s in sides.items()
        }
        found = {when: item for when, item in items.items() if item is not None}
        if len(found) < len(sides):
            continue
        boxes = [
            DrawnBox(
                when if len(found) > 1 else "",
                item.box,
                item.samples,
                corner_words(sides[when].frame),
                smooth=True,
            )
            for when, item in reversed(found.items())
        ]
        item = found[next(iter(found))]
        halves = ", ".join(
            f"{span(*f.box.quantile(0.5))} {f.unit}{f' ({when})' if when else ''}"
            for when, f in found.items()
        )
        caption = (
            f"P-box of the {item.words} error, {condition.words}: {len(item.samples)} epistemic samples, "
            f"{len(item.samples[0].values)} flights each. Half of the flights stay below {halves}."
        )
        return pbox_figure("answer-pbox", item.axis, item.unit, boxes, caption)
    return None


def effect_section(folder: Path) -> Section:
    """Which effects were found, and log against simulation on the held-out flights. Raises BadInputError."""
    done = read_document(folder / "refinement.json", Refinement)
    gap = done["gap"]["test"]["channels"]
    rows = []
    for e in done["effects"]:
        unit = "" if e.get("unit") in (None, "", "1") else f" {e['unit']}"
        t = e.get("evidence", {}).get("t")
        held = (e.get("test") or {}).get("gap")
        tested = (
            Cell("smaller residual", "good")
            if held == "shrank"
            else Cell("not shown" if held else "not tested")
        )
        value = f"{shown(e['value'], '.4g')} ± {shown(e['std'], '.2g')}{unit}"
        rows.append(
            (capital(e["name"]), value, shown(None if t is None else abs(t), ".1f"), tested)
        )
    head = ("Effect", "Value, standard error", "|t| [-]", "On the held-out flight")
    table = Table("Effects that refinement added to the model.", head, tuple(rows))
    models = [Model("_before", "second", "before"), Model("_after", "first", "after")]
    noise = {c: row["noise_rms"] for c, row in gap.items()}
    ratios = {
        c.rpartition("_")[0] or c: {
            when: row[f"rms_{when}"] / row["noise_rms"] for when in ("before", "after")
        }
        for c, row in gap.items()
        if all(row.get(key) for key in ("rms_before", "rms_after", "noise_rms"))
    }
    series = [("before", "second", "ring"), ("after", "first", "disc")]
    drawn = [
        farthest_figure(read_histories(folder / HISTORIES), noise, models, "effect"),
        ratio_figure("effect-residuals", ratios, series, "channels on the held-out flight"),
    ]
    figures = tuple(figure for figure in drawn if figure is not None)
    blocks: list[Block] = [table if rows else Words("Refinement added no effect to the model.")]
    return Section("The effect found", (*blocks, *((Figures(figures),) if figures else ())))


def cells_section(sides: Sides) -> Section:
    """A row per condition and radius: the answer before and after, with the rate and its limits at the worst corner."""
    *_, last = sides.values()
    if not last.signed:
        return Section(
            "Cells of wind and turbulence", (Words("The campaign counts no excursions."),)
        )
    acceptable = f"{last.signed[0].acceptable_per_h:g}"
    by_place = {when: {_place(item): item for item in side.signed} for when, side in sides.items()}
    kinds = aborted_kinds([item for side in sides.values() for item in side.signed])
    rows: list[tuple[str | Cell, ...]] = []
    for item in last.signed:
        if item.cell.distance != "horizontal":
            continue
        here = [by_place[when].get(_place(item)) for when in sides]
        hours = f"{sum(rate.hours for rate in item.cell.rates):.4g}"
        place = (item.cell.condition.label, f"{item.cell.radius_m:g} m")
        rows.append(
            (*place, *(_answer(found) for found in here), hours, *aborted_cells(kinds, here))
        )
    names = [f"Answer {when}" for when in sides] if len(sides) > 1 else ["Answer"]
    head = ("Wind, turbulence", "Radius", *names, "Flight hours", *aborted_head(kinds))
    text = (
        f"At most {acceptable} excursions beyond the radius per flight hour at every corner? Below each answer the rate at the "
        f"worst corner [1/h] and its {_SURE} limits. "
    )
    text += (
        f"Aborted flights of all corners by kind{', before / after' if len(sides) > 1 else ''}."
        if kinds
        else _NONE_ABORTED
    )
    table = Table("Answer by wind, turbulence and radius.", head, tuple(rows))
    return Section("Cells of wind and turbulence", (Words(text, note=True), table))


def _place(item: Statement) -> tuple[Condition, float, str]:
    return item.cell.condition, item.cell.radius_m, item.cell.distance


def _answer(item: Statement | None) -> Cell:
    if item is None:
        return Cell("not flown")
    worst = item.worst
    rate = (
        "no flight was scored"
        if math.isnan(worst.rate)
        else f"{worst.rate:.3g} [{worst.lower:.2g} to {shown(worst.upper)}]"
    )
    return Cell(
        _WORDS[item.answer],
        answer_level(item),
        f"{item.reason}; {rate}" if item.reason else rate,
        mark=_MARKS[item.answer],
    )


def read_side(folder: Path, missing: list[str], read: Any) -> CampaignFound | None:
    """A campaign of the study; None, and told in ``missing``, where it cannot be read."""
    try:
        found: CampaignFound = read(folder)
    except BadInputError as error:
        missing.append(str(error))
        return None
    return found


def folded(sections: Sequence[Section]) -> list[Section]:
    """The same sections, each closed until it is opened."""
    return [Section(s.title, s.blocks, s.parts, folded=True) for s in sections]
