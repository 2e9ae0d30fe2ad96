"""The page of a refinement, from refinement.json, model.diff and histories.parquet."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from uqharness.refinement_document import Refinement
from uqharness.replay import HISTORIES, History, have, read_histories, shown_channel
from uqharness.report.history import Z95, Model, end_to_end, history_section
from uqharness.report.pages.compare import in_shown_unit, ratio_figure
from uqharness.report.pages.refine_effects import capital, effect_section, headline
from uqharness.report.pages.refine_shown import interval_section, mission_section
from uqharness.report.pages.refine_unnamed import RMS, smooth_lines, smooth_sections
from uqharness.report.pages.refine_words import (
    carried_by,
    left_over,
    nowhere,
    place_says,
    test_says,
)
from uqharness.report.parts import (
    Block,
    Bullets,
    Cell,
    Code,
    Facts,
    Figure,
    Figures,
    Page,
    Say,
    Section,
    Table,
    Words,
    is_wanted,
    percent,
    provenance,
    remarks,
    shown,
)
from uqharness.result_documents import read_document

REFINEMENT = "refinement.json"
_DIFF_LINES = 400


def refine_page(folder: Path, prefix: str = "", only: Collection[str] | None = None) -> Page:
    """The page of the folder that ``uqharness refine`` wrote. ``only``: titles of the sections that are shown, if not all.

    Raises BadInputError.
    """
    done = read_document(folder / REFINEMENT, Refinement)
    histories = read_histories(folder / HISTORIES)
    gap = done["gap"]["test"]
    diff = _diff(folder)
    sections = [
        gap_section(gap, prefix),
        effect_section(done, diff, prefix),
        *_place_sections(done),
    ]
    sections += [*smooth_sections(done, prefix), _where_section(done)]
    touched = list(
        dict.fromkeys(e["coefficient"] for e in done["effects"] if "coefficient" in e)
    ) or list(COEFFICIENTS)
    figures = _coefficient_figures(histories, touched, gap, prefix)
    if figures:
        text = (
            "What the test flights demand minus what the model gives, before and after, segments end to end. The band is what "
            "the sensors' noise alone gives in 95 % of the samples."
        )
        legend = (
            ("second thin", "before"),
            ("first thin", "after"),
            ("fill1", "95 % band of the noise"),
        )
        drawn = Figures(figures, legend, file="coefficients")
        sections.append(Section("Coefficients before and after", (Words(text, note=True), drawn)))
    noise = {c: row["noise_rms"] for c, row in gap["channels"].items()}
    models = [Model("_before", "second", "before"), Model("_after", "first", "after")]
    if is_wanted(title := "Test flights against both models", only):
        sections += history_section(
            histories,
            noise,
            models,
            title,
            f"{prefix}refine-",
            2,
            lambda rank, _: "history" if rank == 0 and done["effects"] else None,
        )
    sections += [interval_section(gap, prefix), mission_section(folder, gap, prefix)]
    sections += [
        _left_section(done),
        _parameter_section(done),
        _model_section(done, diff),
        *remarks(done),
    ]
    train, test = (", ".join(done.get(k, ())) or "flights not recorded" for k in ("train", "test"))
    facts = (
        ("Command", done.get("command") or "not recorded"),
        ("Chosen on", train),
        ("Shown on", test),
        ("Time", f"{shown(done.get('seconds'), '.0f')} s"),
        (
            "Files",
            "refinement.json, model.diff, histories.parquet, aircraft/ (the refined model), beside this page",
        ),
    )
    sections.append(provenance(*facts))
    asked = f"What does the model lack? Effects were chosen on {train} and shown on the hold-out flights {test}."
    return Page("Refinement", asked, _verdict(done), tuple(sections))


_VERDICTS = {
    "no-missing-effect": ("Nothing is missing beyond what the sensors' noise hides", "good"),
    "unexplained": ("Something is missing that no effect of the catalogue explains", "bad"),
}
_SHRANK = ("Effects were found, and the gap on the hold-out flights shrank", "good")
_UNTOLD = ("Effects were found; the hold-out flights do not tell whether the gap shrank", "warn")
_UNEXPLAINED_BESIDE = (
    "Effects were found, and something beside them is left that no effect of the catalogue explains"
)


def _verdict(done: Mapping[str, Any]) -> tuple[Say, ...]:
    held = [(e.get("test") or {}).get("gap") == "shrank" for e in done["effects"]]
    found = {"effects-found": _SHRANK if any(held) else _UNTOLD}
    text, level = {**_VERDICTS, **found}.get(done["verdict"], (done["verdict"], "warn"))
    if done["verdict"] == "unexplained" and done["effects"]:
        text = _UNEXPLAINED_BESIDE
    said = [Say(f"{text} ({done['verdict']}).", level)]
    for e, tested_and_held in zip(done["effects"], held, strict=True):
        t = (
            shown(abs(e["evidence"]["t"]), ".1f")
            if e.get("evidence", {}).get("t") is not None
            else "undefined"
        )
        tested = f"; {test_says(e)}" if e.get("test") else ""
        said.append(
            Say(
                f"{headline(e)} ({carried_by(e)}), |t| {t}{tested}.",
                "good" if tested_and_held else "warn",
            )
        )
    for e in done.get("withdrawn", ()):
        said.append(Say(f"Withdrawn: {headline(e)}; {test_says(e)}.", "warn"))
    for e in done["effects"]:
        alike = [
            a["name"].removesuffix(" off") for a in e.get("alternatives", ()) if not a["separable"]
        ]
        if alike:
            said.append(
                Say(f"{capital(e['name'])} is confounded with: {'; '.join(alike)}.", "warn")
            )
    said += smooth_lines(done)
    worst = _largest_fall(done["gap"]["test"])
    if worst:
        said.append(Say(worst))
    return tuple(said)


def _largest_fall(gap: Mapping[str, Any]) -> str:
    rows = {c: r for c, r in gap["channels"].items() if all(r.get(k) for k in RMS)}
    if not rows:
        return ""
    name = max(
        rows, key=lambda c: (rows[c]["rms_before"] - rows[c]["rms_after"]) / rows[c]["noise_rms"]
    )
    quantity, unit, factor = shown_channel(name)
    before, after, noise = (factor * rows[name][k] for k in RMS)
    first, last = f"{before:.3g}", f"{after:.3g}"
    change = f"stays at {last}" if first == last else f"goes from {first} to {last}"
    return (
        f"On the test flights the error of {quantity} {change} {unit} (rms), "
        f"beside noise of {noise:.3g} {unit}."
    )


def _diff(folder: Path) -> str:
    path = folder / "model.diff"
    return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""


def _place_sections(done: Mapping[str, Any]) -> list[Section]:
    """Where the strongest of what is left sits; none where nothing is left, or where the folder is older than that."""
    place = done["remaining"].get("place")
    if not place or place["channel"] is None:
        return []
    lines = tuple(f"{capital(line)}." for line in place_says(place))
    name, _, _ = shown_channel(place["channel"])
    rows = tuple(
        (capital(c["name"]), shown(abs(c["t"]), ".1f"), shown(c["leaves"], ".3f"))
        for c in place["candidates"]
    )
    now = shown(place["channel_on_train"], ".3f")
    caption = (
        f"Nearest candidates: what each leaves of {name} on the train flights, {now} without any."
    )
    table = Table(caption, ("Candidate", "|t| [-]", "Rms over noise left [-]"), rows)
    return [Section("Where something is left", (Bullets(lines, key=True), table))]


def _where_section(done: Mapping[str, Any]) -> Section:
    rows = []
    for d in done["disagreement"]:
        region = "; ".join(_region(s, ends) for s, ends in d.get("region", {}).items())
        size = (percent(d["share_outside_95"], ".0f"), shown(d["size"], ".2g"))
        rows.append((d["coefficient"], d["manoeuvre"], region, *size))
    if not rows:
        text = nowhere(done)
        return Section("Where model and flights disagreed", (Words(f"{capital(text)}."),))
    head = ("Coefficient", "Manoeuvre", "Region", "Outside the 95 % band [%]", "Size [-]")
    table = Table(
        "Disagreement of the train flights, the largest first.", head, tuple(rows), key=True
    )
    return Section("Where model and flights disagreed", (table,))


def _region(state: str, ends: Sequence[float | None]) -> str:
    quantity, unit, factor = shown_channel(state)
    low, high = (None if v is None else factor * v for v in ends)
    named = f"|{quantity.removeprefix('abs ')}|" if quantity.startswith("abs ") else quantity
    return f"{named} {shown(low)} to {shown(high)} {unit}".removesuffix(" -")


def gap_section(gap: Mapping[str, Any], prefix: str = "") -> Section:
    """Gap on the test flights before and after, by channel and coefficient."""
    figures, rows = [], []
    for kind in ("channels", "coefficients"):
        ratios = {}
        for name, r in gap.get(kind, {}).items():
            label, (before, after, noise) = in_shown_unit(name, r, *RMS)
            if before is not None and after is not None and noise:
                ratios[shown_channel(name)[0]] = {"before": before / noise, "after": after / noise}
                same = shown(after) == shown(before)
                answer = Cell(shown(after), "" if same else "good" if after < before else "bad")
            else:
                answer = Cell(shown(after))
            rows.append((label, shown(before), answer, shown(noise)))
        series = [("before", "second", "ring"), ("after", "first", "disc")]
        figure = ratio_figure(
            f"{prefix}shrinkage-{kind}", ratios, series, f"{kind} on the test flights"
        )
        figures += [figure] if figure else []
    theil = gap.get("theil", {})
    if theil:
        rows.append(
            (
                "Theil's U, mean [-]",
                shown(theil.get("before"), ".4f"),
                Cell(shown(theil.get("after"), ".4f")),
                "",
            )
        )
    text = (
        "Before: the model with its parameters identified again, without the effects. After: with them. Start states and biases "
        "are each flight's own. ✓: smaller than before, ✕: larger, by what three figures show."
    )
    table = Table(
        "Gap on the test flights: rms of log minus model.",
        ("Quantity", "Before", "After", "Noise"),
        tuple(rows),
        True,
    )
    drawn = Figures(tuple(figures), file="gap")
    blocks: list[Block] = [Words(text, note=True), drawn, table]
    if gap.get("predictions"):
        blocks += [Words(_TURBULENT), _prediction_table(gap["predictions"])]
    return Section("Gap on the test flights, before and after", tuple(blocks))


_TURBULENT = (
    "The flights were turbulent. The gap above is of replays, as compare has it, and holds what the gusts did; effects are judged "
    "by the errors of predictions one sample ahead."
)


def _prediction_table(predictions: Mapping[str, Any]) -> Table:
    rows = []
    for name, r in predictions.items():
        label, values = in_shown_unit(name, r, *RMS)
        rows.append((label, *(shown(v) for v in values)))
    head = ("Quantity", "Before", "After", "Expected")
    return Table(
        "Errors of predictions one sample ahead on the test flights, rms.", head, tuple(rows), True
    )


def _coefficient_figures(
    histories: Sequence[History], names: Sequence[str], gap: Mapping[str, Any], prefix: str
) -> tuple[Figure, ...]:
    out = []
    for c in names:
        if not have(histories, (f"{c}_gap_before", f"{c}_gap_after")):
            continue
        noise = gap["coefficients"].get(c, {}).get("noise_rms")
        band = None
        if noise is not None:
            half = [np.full(len(h.time_s), Z95 * noise) for h in histories]
            band = ([-h for h in half], half, "")
        label = f"{c} [-] demanded by the test flights minus the model's, before and after, segments end to end."
        series = [(f"{c}_gap_before", "second thin", ""), (f"{c}_gap_after", "first thin", "")]
        out.append(
            end_to_end(
                histories,
                f"{prefix}demand-{c}",
                series,
                band,
                label,
                f"flight minus model, {c} [-]",
                f"{c} [-]",
            )
        )
    return tuple(out)


def _left_section(done: Mapping[str, Any]) -> Section:
    said = tuple(left_over(done["remaining"]))
    if said:
        return Section("What is left", (Bullets(said, key=True),))
    unplaced = done["remaining"].get("unexplained")
    return Section(
        "What is left",
        (
            Words(
                "More than noise, and nothing tells where." if unplaced else "Nothing beyond noise."
            ),
        ),
    )


def _parameter_section(done: Mapping[str, Any]) -> Section:
    rows = tuple(
        (Cell(n, code=True), shown(r["value"], ".6g"), shown(r["std"], ".2g"))
        for n, r in done.get("parameters", {}).items()
    )
    head = ("Property", "Value", "Standard error")
    return Section(
        "Parameters, identified with the effects",
        (Table("Parameters of the refined model.", head, rows),),
    )


def _model_section(done: Mapping[str, Any], diff: str) -> Section:
    blocks: list[Block] = [Facts((("Refined model", str(done.get("model", "not recorded"))),))]
    switch = [
        f"{s['property']} = {s['off']:g} restores the model without it"
        for s in done.get("switch", ())
    ]
    if switch:
        blocks.append(Bullets(tuple(switch)))
    lines = diff.splitlines()
    if lines:
        more = (
            [f"... {len(lines) - _DIFF_LINES} more lines in model.diff"]
            if len(lines) > _DIFF_LINES
            else []
        )
        blocks.append(Code("What changed in the XML", "\n".join([*lines[:_DIFF_LINES], *more])))
    return Section("What changed in the XML", tuple(blocks))
