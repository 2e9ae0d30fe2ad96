"""The page of a whole study: answer, ground track, p-box, effect and cells; folded, all findings and what each stage found."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

from uqharness.errors import BadInputError
from uqharness.report.campaign import CampaignFound, read_found
from uqharness.report.overlay import overlay_section
from uqharness.report.pages.campaign import PBOXES, campaign_page, grid_section
from uqharness.report.pages.compare import compare_page
from uqharness.report.pages.coverage import coverage_page
from uqharness.report.pages.identify import identify_page
from uqharness.report.pages.model_form import bounds_page
from uqharness.report.pages.refinement import refine_page
from uqharness.report.pages.study_answer import (
    answer_says,
    cells_section,
    effect_section,
    first_figures,
    folded,
    read_side,
)
from uqharness.report.parts import (
    Block,
    Bullets,
    Cell,
    Code,
    Level,
    Page,
    Say,
    Section,
    Table,
    Told,
    Words,
    provenance,
    shown,
)
from uqharness.result_documents import Study, read_document

STUDY = "study.json"
_STATES: Mapping[str, Level] = {"done": "", "running": "warn", "waiting": "", "failed": "bad"}
_KEPT: Mapping[str, tuple[str, ...]] = {
    "identify": ("Parameters",),
    "compare": ("Gap by channel", "Log against model"),
    "bounds": ("How wide the bounds are", "Slices of the bounds"),
    "validate-bounds": ("Coverage by coefficient",),
    "campaign": (
        "Where the answer is yes, no or inconclusive",
        PBOXES,
        "Which uncertainty makes the width",
        "Failed flights",
    ),
    "refine": (
        "Effects",
        "Where model and flights disagreed",
        "Gap on the test flights, before and after",
        "Coefficients before and after",
        "What is left",
        "What changed in the XML",
    ),
}
"""Sections that a study shows of a stage's page; the rest stands in the stage's own."""
_SHOWN_ABOVE = _KEPT["campaign"][:2]
_PAGES: Mapping[str, Callable[[Path, str], Page]] = {
    "identify": partial(identify_page, segments=1, only=_KEPT["identify"]),
    "compare": partial(compare_page, segments=1),
    "bounds": partial(bounds_page, only=_KEPT["bounds"]),
    "refine": partial(refine_page, only=_KEPT["refine"]),
    "validate-bounds": partial(coverage_page, only=_KEPT["validate-bounds"]),
}


def study_page(folder: Path) -> Page:
    """The page of the folder that ``uqharness study`` wrote, finished or not. Raises BadInputError."""
    study = read_document(folder / STUDY, Study)
    missing: list[str] = []
    both = study.get("before_after") or {}
    # Each campaign is read once, however often it is shown.
    read = cache(read_found)
    names = both or _one_campaign(study)
    sides = {
        when: side
        for when, name in names.items()
        if (side := read_side(folder / name, missing, read)) is not None
    }
    sections, first = _answered(folder, study, sides, missing)
    rest: list[Section] = []
    if first and study.get("verdict"):
        rest.append(Section("All findings", (Told(_sentences(study)),)))
    if len(sides) > 1:
        rest += [overlay_section(sides["before"], sides["after"], both)]
        rest += [grid_section(side.signed, f"Answers {when}") for when, side in sides.items()]
    for number, stage in enumerate(study["stages"]):
        section = _stage_page(
            folder, stage, number, missing, list(names.values()) if len(sides) > 1 else [], read
        )
        rest += [] if section is None else [section]
    rest.append(_stage_section(study))
    if missing:
        sections.append(
            Section("What could not be read", (Bullets(tuple(dict.fromkeys(missing))),))
        )
    rest.append(_provenance(study))
    asked = study.get("question") or "The study's file asks no question in words."
    sections += folded(rest)
    if first:
        return Page(asked, "", _verdict(study), tuple(sections), first)
    return Page(f"Study: {study['study']}", asked, _verdict(study), tuple(sections))


def _one_campaign(study: Mapping[str, Any]) -> dict[str, str]:
    """Folder of the first campaign of a study without refinement, under no name; empty without one."""
    done = [
        s["folder"]
        for s in study["stages"]
        if s["kind"] == "campaign" and s["state"] == "done" and s.get("folder")
    ]
    return dict.fromkeys([""], done[0]) if done else {}


def _answered(
    folder: Path, study: Mapping[str, Any], sides: Mapping[str, CampaignFound], missing: list[str]
) -> tuple[list[Section], tuple[Block, ...]]:
    """The sections that stand open, and the figures beside the answer; no figure for a study without an answer."""
    sections: list[Section] = []
    refined = [
        s["folder"]
        for s in study["stages"]
        if s["kind"] == "refine" and s["state"] == "done" and s.get("folder")
    ]
    try:
        sections += [effect_section(folder / name) for name in refined[:1]]
    except BadInputError as error:
        missing.append(f"refine: {error}")
    sections += [cells_section(sides)] if sides else []
    return sections, first_figures(folder, study, sides, missing) if study.get("answer") else ()


def _verdict(study: Mapping[str, Any]) -> tuple[Say, ...]:
    said = [*answer_says(study["answer"])] if study.get("answer") else [*_sentences(study)]
    stages = study["stages"]
    done = sum(stage["state"] == "done" for stage in stages)
    state = study.get("state", "running")
    if state == "failed":
        bad = (
            ", ".join(stage["name"] for stage in stages if stage["state"] == "failed") or "a stage"
        )
        said.insert(
            0,
            Say(
                f"The study stopped: {bad} failed. The same command goes on once the cause is gone.",
                "bad",
            ),
        )
    elif state != "done":
        said.insert(
            0, Say(f"The study is not finished: {done} of {len(stages)} stages are done.", "warn")
        )
    elif not said:
        said.append(
            Say(f"All {len(stages)} stages are done; the study draws no conclusion in words.")
        )
    return tuple(said)


def _sentences(study: Mapping[str, Any]) -> tuple[Say, ...]:
    return tuple(
        Say(item["text"], _level(item.get("level"))) for item in study.get("verdict") or ()
    )


def _level(value: Any) -> Level:
    return value if value in ("good", "warn", "bad") else ""


def _stage_section(study: Mapping[str, Any]) -> Section:
    rows = []
    for stage in study["stages"]:
        state = Cell(
            stage["state"], _STATES.get(stage["state"], "warn"), small=stage.get("error") or ""
        )
        answer = {0: "done", 1: "ran, the answer is no"}.get(stage.get("exit"), "")
        seconds = "" if stage.get("seconds") is None else shown(stage["seconds"], ".1f")
        rows.append((stage["name"], stage["kind"], state, answer, seconds))
    table = Table(
        "Stages in the order in which they run.",
        ("Stage", "Kind", "State", "Answer", "Time [s]"),
        tuple(rows),
    )
    commands = "\n".join(stage["command"] for stage in study["stages"] if stage.get("command"))
    words = Words(
        "The commands of the stages, each of which repeats its stage from a shell:", note=True
    )
    return Section(
        "Stages", (table, *((words, Code("Commands of the stages", commands)) if commands else ()))
    )


def _stage_page(
    folder: Path,
    stage: Mapping[str, Any],
    number: int,
    missing: list[str],
    overlaid: Sequence[str | None],
    read: Callable[[Path], CampaignFound],
) -> Section | None:
    """What a finished stage found, shortened; None for a stage that leaves nothing to show here."""
    if stage["state"] != "done" or not stage.get("folder"):
        return None
    place, prefix = folder / stage["folder"], f"s{number}-"
    skipped = _SHOWN_ABOVE if stage["folder"] in overlaid else ()
    kept = [title for title in _KEPT.get(stage["kind"], ()) if title not in skipped]
    try:
        if stage["kind"] == "campaign":
            page = campaign_page(read(place), prefix, kept)
        elif stage["kind"] in _PAGES:
            page = _PAGES[stage["kind"]](place, prefix)
        else:
            return None
    except BadInputError as error:
        missing.append(f"{stage['name']}: {error}")
        return None
    sections = tuple(s for s in page.sections if s.title in kept)
    own = Words(
        f"All of it: {stage['folder']}/report.html, written by uqharness report {stage['folder']}.",
        note=True,
    )
    return Section(
        f"{stage['name']}: {page.title}",
        (Words(page.asked, note=True), Told(page.verdict), own),
        sections,
    )


def _provenance(study: Mapping[str, Any]) -> Section:
    seen = dict.fromkeys(
        item for stage in study["stages"] for item in (stage.get("inputs") or {}).items()
    )
    return provenance(
        ("Command", study.get("command") or "not recorded"),
        ("Version", f"uqharness {study.get('version', 'not recorded')}"),
        (f"Study file {study.get('file', '')} (SHA-256)", study.get("hash") or "not recorded"),
        *((f"Input {name} (SHA-256)", digest) for name, digest in seen),
    )
