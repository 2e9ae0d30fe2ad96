"""Build the page of a study: answer, ground track, p-box, effect and conditions.

All findings and the pages of the stages follow in closed sections. Campaigns are read once; what
cannot be read is listed on the page.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

from uqharness.campaign import CONFIDENCE, Condition, Statement, hardest_condition
from uqharness.campaign.conditions import conditions
from uqharness.errors import BadInputError
from uqharness.parquet_files import read_table
from uqharness.replay import HISTORIES, read_histories
from uqharness.report.campaign import (
    CampaignReport,
    aborted_cells,
    aborted_head,
    aborted_kinds,
    answer_level,
    overlay_section,
    read_campaign_report,
    span,
)
from uqharness.report.ground_track import ground_track, lap_of, track_distance
from uqharness.report.history import Model, farthest_figure
from uqharness.report.pages.campaign import PBOXES, campaign_page, grid_section
from uqharness.report.pages.compare import compare_page, ratio_figure
from uqharness.report.pages.identify import identify_page
from uqharness.report.pages.model_form import bounds_page, coverage_page
from uqharness.report.pages.refinement import capital, refine_page
from uqharness.report.parts import (
    Block,
    Bullets,
    Cell,
    Code,
    Figure,
    Figures,
    Level,
    Page,
    Section,
    Sentence,
    Sentences,
    Table,
    Words,
    format_value,
    level_of,
    provenance,
)
from uqharness.report.pbox import LabelledBox, corner_words, pbox_figure
from uqharness.results.base import read_result
from uqharness.results.refinement import Refinement
from uqharness.results.study import Stage, Study, StudyAnswer, Tracks

# Open part of the page: answer, ground track, p-box, effect, conditions.

_SURE = f"{100 * CONFIDENCE:g} %"
_MARKS = {"yes": "✓", "no": "✕", "open": "?"}
_WORDS = {"yes": "yes", "no": "no", "open": "inconclusive"}
_FIRST = ("cross_track_median_m", "altitude_median_m", "speed_median_mps", "heading_median_deg")
_NONE_ABORTED = "No flight was aborted."
_TRACK_COLUMNS = ("when", "model", "time_s", "north_m", "east_m", "distance_m")
Sides = Mapping[str, CampaignReport]
"""Campaigns by when they were flown: before, after."""


def answer_sentences(answer: StudyAnswer) -> tuple[Sentence, ...]:
    """Return the answer with its level, then reason, model deficiency and next step."""
    # Only the answer has a level; the other sentences are facts.
    facts = (answer.why, answer.lacked, answer.next)
    return Sentence(answer.answer, level_of(answer.level)), *(Sentence(t) for t in facts if t)


def first_figures(
    folder: Path, study: Study, sides: Sides, missing: list[str]
) -> tuple[Block, ...]:
    """Return the lap as ground track and distance, and the p-box, all in the hardest condition.

    Parameters
    ----------
    folder : Path
        Study folder.
    study : Study
        Content of study.json.
    sides : mapping of str to CampaignReport
        Campaigns by when they were flown.
    missing : list of str
        Receives messages on files that cannot be read.
    """
    try:
        figures = _lap(folder / "tracks.parquet", study.tracks)
    except BadInputError as error:
        missing.append(str(error))
        figures = []
    box = _pbox(sides)
    figures += [] if box is None else [box]
    return (Figures(tuple(figures), narrow=True),) if figures else ()


def _lap(path: Path, tracks: Tracks | None) -> list[Figure]:
    """Draw one lap; empty if the study has no tracks. Raises BadInputError."""
    if tracks is None or tracks.radius_m is None:
        return []
    frame = read_table(path).to_pandas()
    # Tracks of other versions may lack columns.
    lacking = [name for name in _TRACK_COLUMNS if name not in frame]
    if lacking:
        raise BadInputError(f"{path}: has no column {', '.join(lacking)}; run the study again")
    lap, radius_m = lap_of(frame), tracks.radius_m
    if lap is None:
        return []
    condition = Condition(tracks.wind_mps or 0.0, tracks.turbulence or "none")
    track = ground_track("ground-track", lap, radius_m, condition.words)
    return [track, track_distance("track-distance", lap, radius_m)]


def _pbox(sides: Sides) -> Figure | None:
    """Draw the first quantity that all campaigns have in the hardest condition."""
    if not sides:
        return None
    *_, last = sides.values()
    condition = hardest_condition(conditions(last.frame))
    # The first metric that all campaigns have in this condition.
    for metric in _FIRST:
        # Finding of this metric in each campaign.
        items = {
            w: next((f for f in s.findings if (f.metric, f.condition) == (metric, condition)), None)
            for w, s in sides.items()
        }
        findings = {when: item for when, item in items.items() if item is not None}
        if len(findings) < len(sides):
            continue
        # The later campaign in front.
        boxes = [
            LabelledBox(
                when if len(findings) > 1 else "",
                item.box,
                item.samples,
                corner_words(sides[when].frame),
                smooth=True,
            )
            for when, item in reversed(findings.items())
        ]
        item = findings[next(iter(findings))]
        halves = ", ".join(
            f"{span(*f.box.quantile(0.5))} {f.unit}{f' ({when})' if when else ''}"
            for when, f in findings.items()
        )
        caption = (
            f"P-box of the {item.words} error, {condition.words}: {len(item.samples)} epistemic"
            f" samples, {len(item.samples[0].values)} flights each. Half of the flights stay below"
            f" {halves}."
        )
        return pbox_figure("answer-pbox", item.axis, item.unit, boxes, caption)
    return None


def effect_section(folder: Path) -> Section:
    """Return the effects found, and log against simulation on the hold-out flights.

    Parameters
    ----------
    folder : Path
        Folder of the refinement.

    Raises
    ------
    BadInputError
        If the folder cannot be read.
    """
    done = read_result(folder / "refinement.json", Refinement)
    # Residuals of the hold-out flights.
    gap = done.gap.test.channels
    rows = []
    for e in done.effects:
        unit = "" if e.unit in (None, "", "1") else f" {e.unit}"
        t = e.evidence.t
        # Result of the effect on the hold-out flights.
        tested = (
            Cell("smaller residual", "good")
            if e.test is not None and e.test.gap == "shrank"
            else Cell("not shown" if e.test else "not tested")
        )
        value = f"{format_value(e.value, '.4g')} ± {format_value(e.std, '.2g')}{unit}"
        rows.append(
            (capital(e.name), value, format_value(None if t is None else abs(t), ".1f"), tested)
        )
    head = ("Effect", "Value, standard error", "|t| [-]", "On the held-out flight")
    table = Table("Effects that refinement added to the model.", head, tuple(rows))
    models = [Model("_before", "second", "before"), Model("_after", "first", "after")]
    noise = {c: row.noise_rms for c, row in gap.items()}
    # Residual rms over noise, before and after.
    ratios = {
        c.rpartition("_")[0] or c: {
            "before": row.rms_before / row.noise_rms,
            "after": row.rms_after / row.noise_rms,
        }
        for c, row in gap.items()
        if row.rms_before and row.rms_after and row.noise_rms
    }
    series = [("before", "second", "ring"), ("after", "first", "disc")]
    optional_figures = [
        farthest_figure(read_histories(folder / HISTORIES), noise, models, "effect"),
        ratio_figure("effect-residuals", ratios, series, "channels on the held-out flight"),
    ]
    figures = tuple(figure for figure in optional_figures if figure is not None)
    blocks: list[Block] = [table if rows else Words("Refinement added no effect to the model.")]
    return Section("The effect found", (*blocks, *((Figures(figures),) if figures else ())))


def cells_section(sides: Sides) -> Section:
    """Return a row per condition and radius with the answers before and after.

    Parameters
    ----------
    sides : mapping of str to CampaignReport
        Campaigns by when they were flown; at least one.

    Returns
    -------
    Section
        Answer, rate at the worst corner with limits [1/h], and aborted flights.
    """
    *_, last = sides.values()
    if not last.signed:
        return Section(
            "Cells of wind and turbulence", (Words("The campaign counts no excursions."),)
        )
    acceptable = f"{last.signed[0].acceptable_per_h:g}"
    # Statements of each campaign by condition, radius and distance.
    by_place = {when: {_place(item): item for item in side.signed} for when, side in sides.items()}
    kinds = aborted_kinds([item for side in sides.values() for item in side.signed])
    rows: list[tuple[str | Cell, ...]] = []
    for item in last.signed:
        if item.cell.distance != "horizontal":
            continue
        cell_statements = [by_place[when].get(_place(item)) for when in sides]
        hours = f"{sum(rate.hours for rate in item.cell.rates):.4g}"
        place = (item.cell.condition.label, f"{item.cell.radius_m:g} m")
        rows.append(
            (
                *place,
                *(_answer(claim) for claim in cell_statements),
                hours,
                *aborted_cells(kinds, cell_statements),
            )
        )
    names = [f"Answer {when}" for when in sides] if len(sides) > 1 else ["Answer"]
    head = ("Wind, turbulence", "Radius", *names, "Flight hours", *aborted_head(kinds))
    text = (
        f"At most {acceptable} excursions beyond the radius per flight hour at every corner? Below"
        f" each answer the rate at the worst corner [1/h] and its {_SURE} limits. "
    )
    text += (
        f"Aborted flights of all corners by kind{', before / after' if len(sides) > 1 else ''}."
        if kinds
        else _NONE_ABORTED
    )
    table = Table("Answer by wind, turbulence and radius.", head, tuple(rows))
    return Section("Cells of wind and turbulence", (Words(text, note=True), table))


def _place(item: Statement) -> tuple[Condition, float, str]:
    """Return the key of a statement: condition, radius, distance."""
    return item.cell.condition, item.cell.radius_m, item.cell.distance


def _answer(item: Statement | None) -> Cell:
    """Return the answer of a statement with the rate at the worst corner."""
    if item is None:
        return Cell("not flown")
    worst = item.worst
    rate = (
        "no flight was scored"
        if math.isnan(worst.rate)
        else f"{worst.rate:.3g} [{worst.lower:.2g} to {format_value(worst.upper)}]"
    )
    return Cell(
        _WORDS[item.answer],
        answer_level(item),
        f"{item.reason}; {rate}" if item.reason else rate,
        mark=_MARKS[item.answer],
    )


def read_side(folder: Path, missing: list[str], read: Any) -> CampaignReport | None:
    """Return a campaign of the study.

    Parameters
    ----------
    folder : Path
        Campaign folder.
    missing : list of str
        Receives a message if it cannot be read.
    read : callable
        Reads a folder.
    """
    try:
        report: CampaignReport = read(folder)
    except BadInputError as error:
        missing.append(str(error))
        return None
    return report


def folded(sections: Sequence[Section]) -> list[Section]:
    """Return the sections closed."""
    return [Section(s.title, s.blocks, s.parts, folded=True) for s in sections]


STUDY = "study.json"
_STATES: Mapping[str, Level] = {"done": "", "running": "warn", "waiting": "", "failed": "bad"}
_STAGE_SECTIONS: Mapping[str, tuple[str, ...]] = {
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
        "Gap on the hold-out flights, before and after",
        "Coefficients before and after",
        "What is left",
        "What changed in the XML",
    ),
}
"""Sections of a stage's page that the study displays; the stage's own page has all."""
_SHOWN_ABOVE = _STAGE_SECTIONS["campaign"][:2]
_PAGES: Mapping[str, Callable[[Path, str], Page]] = {
    "identify": partial(identify_page, segments=1, only=_STAGE_SECTIONS["identify"]),
    "compare": partial(compare_page, segments=1),
    "bounds": partial(bounds_page, only=_STAGE_SECTIONS["bounds"]),
    "refine": partial(refine_page, only=_STAGE_SECTIONS["refine"]),
    "validate-bounds": partial(coverage_page, only=_STAGE_SECTIONS["validate-bounds"]),
}


def study_page(folder: Path) -> Page:
    """Return the page of a folder that ``uqharness study`` wrote, finished or not.

    Parameters
    ----------
    folder : Path
        Study folder.

    Raises
    ------
    BadInputError
        If study.json cannot be read. Stages that cannot be read are listed on the page.
    """
    study = read_result(folder / STUDY, Study)
    missing: list[str] = []
    # Campaigns before and after a refinement, or the only one.
    overlaid = study.pair
    # Each campaign is read once, however often it is shown.
    read = cache(read_campaign_report)
    names = overlaid or _one_campaign(study)
    sides = {
        when: side
        for when, name in names.items()
        if (side := read_side(folder / name, missing, read)) is not None
    }
    sections, first = _answered(folder, study, sides, missing)
    folded_sections: list[Section] = []
    if first and study.verdict:
        folded_sections.append(Section("All findings", (Sentences(_sentences(study)),)))
    # Two campaigns are compared, each with its grid of answers.
    if len(sides) > 1:
        folded_sections += [overlay_section(sides["before"], sides["after"], overlaid)]
        folded_sections += [
            grid_section(side.signed, f"Answers {when}") for when, side in sides.items()
        ]
    # Selected sections of every finished stage.
    for number, stage in enumerate(study.stages):
        section = _stage_page(
            folder, stage, number, missing, list(names.values()) if len(sides) > 1 else [], read
        )
        folded_sections += [] if section is None else [section]
    folded_sections.append(_stage_section(study))
    if missing:
        sections.append(
            Section("What could not be read", (Bullets(tuple(dict.fromkeys(missing))),))
        )
    folded_sections.append(_provenance(study))
    question = study.question or "The study's file has no question."
    sections += folded(folded_sections)
    if first:
        return Page(question, "", _verdict(study), tuple(sections), first)
    return Page(f"Study: {study.study}", question, _verdict(study), tuple(sections))


def _one_campaign(study: Study) -> dict[str, str]:
    """Return the folder of the first campaign of a study without refinement; empty without one."""
    done = [
        s.folder for s in study.stages if s.kind == "campaign" and s.state == "done" and s.folder
    ]
    return dict.fromkeys([""], done[0]) if done else {}


def _answered(
    folder: Path, study: Study, sides: Mapping[str, CampaignReport], missing: list[str]
) -> tuple[list[Section], tuple[Block, ...]]:
    """Return the open sections, and the figures next to the answer."""
    sections: list[Section] = []
    refined = [
        s.folder for s in study.stages if s.kind == "refine" and s.state == "done" and s.folder
    ]
    try:
        sections += [effect_section(folder / name) for name in refined[:1]]
    except BadInputError as error:
        missing.append(f"refine: {error}")
    sections += [cells_section(sides)] if sides else []
    return sections, first_figures(folder, study, sides, missing) if study.answer else ()


def _verdict(study: Study) -> tuple[Sentence, ...]:
    """Return the answer or the findings, with the state of an unfinished study."""
    sentences = [*answer_sentences(study.answer)] if study.answer else [*_sentences(study)]
    stages = study.stages
    done = sum(stage.state == "done" for stage in stages)
    state = study.state
    # A study that stopped or is running says so first.
    if state == "failed":
        failed = ", ".join(stage.name for stage in stages if stage.state == "failed") or "a stage"
        sentences.insert(
            0,
            Sentence(
                f"The study stopped: {failed} failed. The same command goes on once the cause is"
                " gone.",
                "bad",
            ),
        )
    elif state != "done":
        sentences.insert(
            0,
            Sentence(
                f"The study is not finished: {done} of {len(stages)} stages are done.", "warn"
            ),
        )
    elif not sentences:
        sentences.append(
            Sentence(f"All {len(stages)} stages are done; the study draws no conclusion in words.")
        )
    return tuple(sentences)


def _sentences(study: Study) -> tuple[Sentence, ...]:
    """Return the sentences of the study's verdict."""
    return tuple(Sentence(item.text, level_of(item.level)) for item in study.verdict or ())


def _stage_section(study: Study) -> Section:
    """Return the table of stages with their commands."""
    rows = []
    for stage in study.stages:
        state = Cell(stage.state, _STATES.get(stage.state, "warn"), small=stage.error or "")
        answer = {0: "done", 1: "ran, the answer is no", None: ""}.get(stage.exit, "")
        seconds = "" if stage.seconds is None else format_value(stage.seconds, ".1f")
        rows.append((stage.name, stage.kind, state, answer, seconds))
    table = Table(
        "Stages in the order in which they run.",
        ("Stage", "Kind", "State", "Answer", "Time [s]"),
        tuple(rows),
    )
    commands = "\n".join(stage.command for stage in study.stages if stage.command)
    words = Words(
        "The commands of the stages, each of which repeats its stage from a shell:", note=True
    )
    return Section(
        "Stages", (table, *((words, Code("Commands of the stages", commands)) if commands else ()))
    )


def _stage_page(
    folder: Path,
    stage: Stage,
    number: int,
    missing: list[str],
    overlaid: Sequence[str | None],
    read: Callable[[Path], CampaignReport],
) -> Section | None:
    """Return selected sections of a finished stage's page; None if it has nothing to display."""
    if stage.state != "done" or not stage.folder:
        return None
    place, prefix = folder / stage.folder, f"s{number}-"
    # Sections that the open part already displays.
    skipped = _SHOWN_ABOVE if stage.folder in overlaid else ()
    titles = [title for title in _STAGE_SECTIONS.get(stage.kind, ()) if title not in skipped]
    try:
        if stage.kind == "campaign":
            page = campaign_page(read(place), prefix, titles)
        elif stage.kind in _PAGES:
            page = _PAGES[stage.kind](place, prefix)
        else:
            return None
    except BadInputError as error:
        missing.append(f"{stage.name}: {error}")
        return None
    sections = tuple(s for s in page.sections if s.title in titles)
    page_hint = Words(
        f"All of it: {stage.folder}/report.html, written by uqharness report {stage.folder}.",
        note=True,
    )
    return Section(
        f"{stage.name}: {page.title}",
        (Words(page.question, note=True), Sentences(page.verdict), page_hint),
        sections,
    )


def _provenance(study: Study) -> Section:
    """Return command, version and hashes of study file and inputs."""
    inputs = dict.fromkeys(item for stage in study.stages for item in (stage.inputs or {}).items())
    return provenance(
        ("Command", study.command or "not recorded"),
        ("Version", f"uqharness {study.version or 'not recorded'}"),
        (f"Study file {study.file} (SHA-256)", study.hash or "not recorded"),
        *((f"Input {name} (SHA-256)", digest) for name, digest in inputs),
    )
