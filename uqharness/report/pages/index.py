"""The page of any folder of results: what the folder is, is told by its files."""

from __future__ import annotations

from pathlib import Path

from uqharness.errors import BadInputError
from uqharness.report.history import MOST_SEGMENTS
from uqharness.report.parts import Page

KINDS = (
    ("study.json", "study"),
    ("manifest.json", "campaign run"),
    ("refinement.json", "refine"),
    ("fit.json", "identify"),
    ("model-form.json", "bounds"),
    ("compare.json", "compare"),
    ("coverage.json", "validate-bounds"),
)
"""File that marks a folder, and the command that writes it; the first that is there counts."""

SEGMENTED = ("identify", "compare")
"""Kinds whose page shows the worst segments alone, unless all are asked for."""

_NEXT_FLIGHT = "next-flight.json"


def kind_of(folder: Path) -> str:
    """Command whose results ``folder`` holds. Raises BadInputError for none, with what was looked for."""
    if not folder.is_dir():
        raise BadInputError(f"{folder}: is no folder; report takes the --out of another command")
    for name, kind in KINDS:
        if (folder / name).is_file():
            return kind
    if (folder / _NEXT_FLIGHT).is_file():
        raise BadInputError(
            f"{folder}: next-flight writes its report.html itself and report does not; open that page, or run uqharness "
            "next-flight again to write it anew"
        )
    looked = ", ".join(f"{name} ({kind})" for name, kind in KINDS)
    raise BadInputError(f"{folder}: no results to report on; looked for {looked}")


def page_of(folder: Path, every_segment: bool = False) -> Page:
    """The page of a folder of results; ``every_segment``: with the histories of all segments, not of the worst alone.

    Raises BadInputError.
    """
    kind = kind_of(folder)
    # Imported here: a page needs what its folder's kind needs and no more.
    if kind == "study":
        from uqharness.report.pages.study import study_page

        return study_page(folder)
    if kind == "refine":
        from uqharness.report.pages.refinement import refine_page

        return refine_page(folder)
    if kind == "identify":
        from uqharness.report.pages.identify import identify_page

        return identify_page(folder, segments=None if every_segment else MOST_SEGMENTS)
    if kind == "compare":
        from uqharness.report.pages.compare import compare_page

        return compare_page(folder, segments=None if every_segment else MOST_SEGMENTS)
    if kind == "campaign run":
        from uqharness.report.campaign import read_found
        from uqharness.report.pages.campaign import campaign_page

        return campaign_page(read_found(folder))
    from uqharness.report.pages.coverage import coverage_page
    from uqharness.report.pages.model_form import bounds_page

    return bounds_page(folder) if kind == "bounds" else coverage_page(folder)
