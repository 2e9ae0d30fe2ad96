"""Build the page of a validation of model-form bounds, from coverage.json and residuals.parquet."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from sysid.model_form import MIN_SHARE_INSIDE
from uqharness.replay import History, read_histories, shown_channel
from uqharness.report.pages.model_form import COVERAGE, RESIDUALS, within_section
from uqharness.report.parts import (
    Cell,
    Level,
    Page,
    Section,
    Sentence,
    Table,
    Words,
    format_value,
    is_wanted,
    percent,
    provenance,
    remarks,
)
from uqharness.results.base import read_result
from uqharness.results.identification import Coverage


def coverage_page(folder: Path, prefix: str = "", only: Collection[str] | None = None) -> Page:
    """Return the page of a folder that ``uqharness validate-bounds --out`` wrote.

    ``only`` lists titles of the sections to build. Raises BadInputError.
    """
    return coverage_page_of(
        read_result(folder / COVERAGE, Coverage), read_histories(folder / RESIDUALS), prefix, only
    )


def coverage_page_of(
    document: Coverage,
    pieces: Sequence[History] = (),
    prefix: str = "",
    only: Collection[str] | None = None,
) -> Page:
    """Return the page of a validation from its document and residuals.

    Parameters
    ----------
    document : Coverage
        Content of coverage.json.
    pieces : sequence of History
        Residuals of the new flight.
    prefix : str
        Prefix of figure names.
    only : collection of str, optional
        Titles of the sections to build; default: all.

    Returns
    -------
    Page
        The verdict says whether the bounds hold, fail, or the flight is too short to tell.
    """
    sections = [_coverage_section(document)]
    if is_wanted(title := "The new flight within the bounds", only):
        sections += within_section(pieces, list(document.coverage), title, "coverage", prefix)
    sections += [
        *_manoeuvre_section(document),
        *_bin_section(document),
        *_conformal_section(document),
        *remarks(document, key=("notes",)),
    ]
    sections.append(provenance(("Command", document.command or "not recorded")))
    verdicts = _verdicts(document)
    # Failure outweighs an inconclusive result.
    failing, unsure = (
        [c for c, v in verdicts.items() if v == kind] for kind in ("fails", "inconclusive")
    )
    if failing:
        shares = ", ".join(f"{c} {100 * document.coverage[c].share_95:.1f} %" for c in failing)
        verdict = Sentence(
            f"The 95 % bounds do not hold: they contain only {shares} of the samples.", "bad"
        )
    elif unsure:
        verdict = Sentence(
            "Inconclusive: the flight is too short to tell whether the bounds of"
            f" {', '.join(unsure)} hold.",
            "warn",
        )
    else:
        verdict = Sentence(
            "The bounds hold: every coefficient's share of this flight agrees with the 95 % that"
            " its bounds state.",
            "good",
        )
    question = "Do the bounds hold on a flight that they were not made from?"
    return Page("Validation of model-form bounds", question, (verdict,), tuple(sections))


_LEVELS: Mapping[str, Level] = {"holds": "good", "fails": "bad", "inconclusive": "warn"}


def _verdicts(document: Coverage) -> dict[str, str]:
    """Return the verdict of each coefficient; in older documents it follows from the coverage."""
    return {
        c: "holds" if row.share_95 >= MIN_SHARE_INSIDE else "fails"
        for c, row in document.coverage.items()
    } | document.verdicts


def _coverage_section(document: Coverage) -> Section:
    """Return the coverage by coefficient."""
    rows, verdicts = [], _verdicts(document)
    for c, row in document.coverage.items():
        level = _LEVELS[verdicts[c]]
        # Coverage with its standard error, at both confidences.
        errors = document.errors.get(c, {})
        first, second = (
            f"{100 * share:.1f} ± {percent(errors.get(k), '.1f')}"
            for k, share in (("0.95", row.share_95), ("0.68", row.share_68))
        )
        outside_share = percent(document.outside_data.get(c), ".1f")
        size = (
            format_value(row.n_effective, ".0f"),
            format_value(row.mean_width),
            outside_share,
        )
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
        "Samples are measured: the noise of this flight's sensors is added to the bounds. Mean"
        " width is without it. The standard error counts autocorrelation."
    )
    table = Table(
        "Share of a new flight's samples inside the bounds, ± standard error.",
        head,
        tuple(rows),
        key=True,
    )
    return Section("Coverage by coefficient", (Words(text, note=True), table))


def _manoeuvre_section(document: Coverage) -> tuple[Section, ...]:
    """Return the coverage by manoeuvre; empty if it was not recorded."""
    names = tuple(document.coverage)
    rows = tuple(
        (
            m,
            *(
                " / ".join(percent(row.get(c, {}).get(p), ".0f") for p in ("0.95", "0.68"))
                for c in names
            ),
        )
        for m, row in document.manoeuvres.items()
    )
    table = Table(
        "Share of the samples inside the 95 / 68 % bounds [%].", ("Manoeuvre", *names), rows
    )
    return (Section("Coverage by manoeuvre", (table,)),) if rows else ()


def _bin_section(document: Coverage) -> tuple[Section, ...]:
    """Return the coverage by thirds of speed and incidence; empty if it was not recorded."""
    names = tuple(document.coverage)
    rows = []
    for row in (*document.by_speed, *document.by_incidence):
        quantity, unit, factor = shown_channel(row.state)
        # Range of the state in displayed units.
        low, high = (format_value(None if x is None else factor * x) for x in (row.low, row.high))
        ends = f"{quantity} {low} to {high} {unit}"
        rows.append((ends, str(row.samples), *(percent(row.share.get(c), ".0f") for c in names)))
    table = Table(
        "Share of the samples inside the 95 % bounds [%], by thirds of a state.",
        ("Range", "Samples", *names),
        tuple(rows),
    )
    return (Section("Coverage by speed and incidence", (table,)),) if rows else ()


def _conformal_section(document: Coverage) -> tuple[Section, ...]:
    """Return the conformal factors; empty if there are none."""
    rows = tuple(
        (
            c,
            format_value(r.factor, ".2f"),
            percent(r.level, ".0f"),
            format_value(r.manoeuvres, ".0f"),
        )
        for c, r in document.conformal.items()
    )
    if not rows:
        return ()
    text = (
        "Bounds this many times as wide hold 95 % of the samples of a further manoeuvre, at the"
        " level given, whatever the distributions are, if manoeuvres are alike."
    )
    words = [Words(text, note=True)]
    # With one flight the variation between flights cannot be estimated.
    unknown = [c for c, std in document.flight_variance.items() if std is None]
    if unknown:
        words.append(
            Words(
                "How model error varies from flight to flight is not estimable for"
                f" {', '.join(unknown)}: one flight.",
                note=True,
            )
        )
    table = Table(
        "Conformal factor by coefficient.",
        ("Coefficient", "Factor [-]", "Level [%]", "Manoeuvres"),
        rows,
    )
    return (Section("Manoeuvre by manoeuvre", (*words, table)),)
