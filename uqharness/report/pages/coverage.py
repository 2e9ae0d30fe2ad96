"""The page of a validation of model-form bounds, from coverage.json and residuals.parquet."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from sysid.model_form import MIN_SHARE_INSIDE
from uqharness.replay import History, read_histories, shown_channel
from uqharness.report.pages.model_form import COVERAGE, RESIDUALS, within_section
from uqharness.report.parts import (
    Cell,
    Level,
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
from uqharness.result_documents import Coverage, read_document


def coverage_page(folder: Path, prefix: str = "", only: Collection[str] | None = None) -> Page:
    """The page of the folder that ``uqharness validate-bounds --out`` wrote. ``only``: titles of the sections shown, if not all.

    Raises BadInputError.
    """
    return coverage_page_of(
        read_document(folder / COVERAGE, Coverage), read_histories(folder / RESIDUALS), prefix, only
    )


def coverage_page_of(
    found: Mapping[str, Any],
    pieces: Sequence[History] = (),
    prefix: str = "",
    only: Collection[str] | None = None,
) -> Page:
    """The page of a validation from its document and its residuals."""
    sections = [_coverage_section(found)]
    if is_wanted(title := "The new flight within the bounds", only):
        sections += within_section(pieces, list(found["coverage"]), title, "coverage", prefix)
    sections += [
        *_manoeuvre_section(found),
        *_bin_section(found),
        *_conformal_section(found),
        *remarks(found, key=("notes",)),
    ]
    sections.append(provenance(("Command", found.get("command") or "not recorded")))
    said = found.get("verdicts") or {
        c: "holds" if row["0.95"] >= MIN_SHARE_INSIDE else "fails"
        for c, row in found["coverage"].items()
    }
    bad, unsure = ([c for c, v in said.items() if v == kind] for kind in ("fails", "inconclusive"))
    if bad:
        shares = ", ".join(f"{c} {100 * found['coverage'][c]['0.95']:.1f} %" for c in bad)
        verdict = Say(
            f"The 95 % bounds do not hold: they contain only {shares} of the samples.", "bad"
        )
    elif unsure:
        verdict = Say(
            f"Inconclusive: the flight is too short to tell whether the bounds of {', '.join(unsure)} hold.",
            "warn",
        )
    else:
        verdict = Say(
            "The bounds hold: every coefficient's share of this flight agrees with the 95 % that its bounds state.",
            "good",
        )
    asked = "Do the bounds hold on a flight that they were not made from?"
    return Page("Validation of model-form bounds", asked, (verdict,), tuple(sections))


_LEVELS: Mapping[str, Level] = {"holds": "good", "fails": "bad", "inconclusive": "warn"}


def _coverage_section(found: Mapping[str, Any]) -> Section:
    rows = []
    for c, row in found["coverage"].items():
        level = _LEVELS[
            found.get("verdicts", {}).get(
                c, "holds" if row["0.95"] >= MIN_SHARE_INSIDE else "fails"
            )
        ]
        errors = found.get("errors", {}).get(c, {})
        first, second = (
            f"{100 * row[k]:.1f} ± {percent(errors.get(k), '.1f')}" for k in ("0.95", "0.68")
        )
        beyond = percent(found.get("outside_data", {}).get(c), ".1f")
        size = (shown(row.get("n_effective"), ".0f"), shown(row.get("mean_width")), beyond)
        rows.append((c, Cell(first, level), second, *size))
    head = (
        "Coefficient",
        "Inside the 95 % bounds [%]",
        "Inside the 68 % bounds [%]",
        "Independent samples",
        "Mean width [-]",
        "Outside the data [%]",
    )
    text = (
        "Samples are measured: the noise of this flight's sensors is added to the bounds. Mean width is without it. The standard "
        "error counts autocorrelation."
    )
    table = Table(
        "Share of a new flight's samples inside the bounds, ± standard error.",
        head,
        tuple(rows),
        key=True,
    )
    return Section("Coverage by coefficient", (Words(text, note=True), table))


def _manoeuvre_section(found: Mapping[str, Any]) -> tuple[Section, ...]:
    names = tuple(found["coverage"])
    rows = tuple(
        (
            m,
            *(
                " / ".join(percent(row.get(c, {}).get(p), ".0f") for p in ("0.95", "0.68"))
                for c in names
            ),
        )
        for m, row in found.get("manoeuvres", {}).items()
    )
    table = Table(
        "Share of the samples inside the 95 / 68 % bounds [%].", ("Manoeuvre", *names), rows
    )
    return (Section("Coverage by manoeuvre", (table,)),) if rows else ()


def _bin_section(found: Mapping[str, Any]) -> tuple[Section, ...]:
    names = tuple(found["coverage"])
    rows = []
    for row in (*found.get("by_speed", ()), *found.get("by_incidence", ())):
        quantity, unit, factor = shown_channel(row["state"])
        ends = f"{quantity} {factor * row['from']:.3g} to {factor * row['to']:.3g} {unit}"
        rows.append(
            (ends, str(row["samples"]), *(percent(row["share"].get(c), ".0f") for c in names))
        )
    table = Table(
        "Share of the samples inside the 95 % bounds [%], by thirds of a state.",
        ("Range", "Samples", *names),
        tuple(rows),
    )
    return (Section("Coverage by speed and incidence", (table,)),) if rows else ()


def _conformal_section(found: Mapping[str, Any]) -> tuple[Section, ...]:
    rows = tuple(
        (
            c,
            shown(r.get("factor"), ".2f"),
            percent(r.get("level"), ".0f"),
            shown(r.get("manoeuvres"), ".0f"),
        )
        for c, r in found.get("conformal", {}).items()
    )
    if not rows:
        return ()
    text = (
        "Bounds this many times as wide hold 95 % of the samples of a further manoeuvre, at the level given, whatever the "
        "distributions are, if manoeuvres are alike."
    )
    words = [Words(text, note=True)]
    unknown = [c for c, std in found.get("flight_variance", {}).items() if std is None]
    if unknown:
        words.append(
            Words(
                f"How model error varies from flight to flight is not estimable for {', '.join(unknown)}: one flight.",
                note=True,
            )
        )
    table = Table(
        "Conformal factor by coefficient.",
        ("Coefficient", "Factor [-]", "Level [%]", "Manoeuvres"),
        rows,
    )
    return (Section("Manoeuvre by manoeuvre", (*words, table)),)
