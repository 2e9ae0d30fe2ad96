"""Write report.html of a folder of results, and its drawings.

`kind_of` recognises a folder by its files; the page module of that kind builds the page. The same
folder gives the same bytes. A page begins with a warning if files of the folder have changed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from uqharness.checksums import FileFault, faults
from uqharness.errors import BadInputError
from uqharness.files import inner_folder, write_bytes
from uqharness.report.history import MAX_SEGMENTS
from uqharness.report.parts import (
    Figures,
    Page,
    Section,
    Sentence,
    every_section,
    first_lines,
    render,
)
from uqharness.report.svg import standalone

# Recognition of folders.

KINDS = (
    ("study.json", "study"),
    ("manifest.json", "campaign run"),
    ("refinement.json", "refine"),
    ("fit.json", "identify"),
    ("model-form.json", "bounds"),
    ("compare.json", "compare"),
    ("coverage.json", "validate-bounds"),
)
"""File that identifies a folder, and the command that writes it; the first match counts."""

SEGMENTED = ("identify", "compare")
"""Kinds whose page displays only the worst segments by default."""

_NEXT_FLIGHT = "next-flight.json"


def kind_of(folder: Path) -> str:
    """Return the command that wrote a folder of results.

    Parameters
    ----------
    folder : Path
        Folder of results.

    Returns
    -------
    str
        Command, e.g. "identify".

    Raises
    ------
    BadInputError
        If the folder is not recognised; the message names the files that were looked for.
    """
    if not folder.is_dir():
        raise BadInputError(f"{folder}: is no folder; report takes the --out of another command")
    # A study contains campaigns, so the order of the kinds matters.
    for name, kind in KINDS:
        if (folder / name).is_file():
            return kind
    if (folder / _NEXT_FLIGHT).is_file():
        raise BadInputError(
            f"{folder}: next-flight writes its report.html itself and report does not; open that"
            " page, or run uqharness next-flight again to write it anew"
        )
    expected_files = ", ".join(f"{name} ({kind})" for name, kind in KINDS)
    raise BadInputError(f"{folder}: no results to report on; looked for {expected_files}")


def page_of(folder: Path, every_segment: bool = False) -> Page:
    """Return the page of a folder of results.

    Parameters
    ----------
    folder : Path
        Folder of results.
    every_segment : bool
        Whether the histories of all segments are included.

    Raises
    ------
    BadInputError
        If the folder is not recognised or cannot be read.
    """
    kind = kind_of(folder)
    # Imported here so that a page loads only what its kind needs.
    if kind == "study":
        from uqharness.report.pages.study import study_page

        return study_page(folder)
    if kind == "refine":
        from uqharness.report.pages.refinement import refine_page

        return refine_page(folder)
    if kind == "identify":
        from uqharness.report.pages.identify import identify_page

        return identify_page(folder, segments=None if every_segment else MAX_SEGMENTS)
    if kind == "compare":
        from uqharness.report.pages.compare import compare_page

        return compare_page(folder, segments=None if every_segment else MAX_SEGMENTS)
    if kind == "campaign run":
        from uqharness.report.campaign import read_campaign_report
        from uqharness.report.pages.campaign import campaign_page

        return campaign_page(read_campaign_report(folder))
    from uqharness.report.pages.model_form import bounds_page, coverage_page

    return bounds_page(folder) if kind == "bounds" else coverage_page(folder)


REPORT = "report.html"
_MAX_NAMED = 5
"""Number of damaged files that a page names."""


@dataclass(frozen=True)
class Report:
    """Files that were written.

    Attributes
    ----------
    path : Path
        report.html.
    figures : tuple of Path
        Drawings.
    page : Page
        Content.
    damaged : tuple of Fault
        Files that are not as they were written.
    rewritten : tuple of str
        Files that were damaged and are now new.
    """

    path: Path
    figures: tuple[Path, ...]
    page: Page
    damaged: tuple[FileFault, ...] = ()
    rewritten: tuple[str, ...] = ()

    @property
    def verdict(self) -> list[str]:
        """The verdict as plain sentences."""
        return [item.text for item in self.page.verdict]

    @property
    def warnings(self) -> list[str]:
        """Sentences on files that were damaged."""
        folder = self.path.parent
        return [
            *(f"{folder / n} had changed since it was written; restored" for n in self.rewritten),
            *(f"{folder / fault.name}: {fault.problem}" for fault in self.damaged),
        ]

    @property
    def text(self) -> str:
        """The summary that a terminal shows."""
        return "\n".join(
            [
                *first_lines(self.page),
                "",
                f"results in {self.path.parent}, the report in {self.path}",
            ]
        )


def write_report(folder: Path, figures: bool = False) -> Report:
    """Write ``folder``/report.html.

    Parameters
    ----------
    folder : Path
        Folder of results.
    figures : bool
        Whether drawings are written to figures/; those of a campaign always are.

    Raises
    ------
    BadInputError
        If the folder is not recognised or cannot be read.
    """
    page, kind = page_of(folder), kind_of(folder)
    # Drawings of the page, or of a page with all segments.
    figure_page = page if figures or kind == "campaign run" else None
    if figures and kind in SEGMENTED:
        figure_page = page_of(folder, every_segment=True)
    return write_page(folder, page, figure_page)


def write_campaign_report(folder: Path) -> Report:
    """Write the report of a complete campaign; other folders are refused."""
    from uqharness.report.campaign import read_campaign_report
    from uqharness.report.pages.campaign import campaign_page

    page = campaign_page(read_campaign_report(folder))
    return write_page(folder, page, page)


def write_page(folder: Path, page: Page, figure_page: Page | None = None) -> Report:
    """Write a page as ``folder``/report.html.

    Parameters
    ----------
    folder : Path
        Folder of results.
    page : Page
        Report.
    figure_page : Page, optional
        Page whose drawings are written to figures/.

    Returns
    -------
    Report
        Files written, and damaged files of the folder.

    Raises
    ------
    BadInputError
        If a file cannot be written.
    """
    path, file_faults = folder / REPORT, faults(folder)
    drawings = (
        ()
        if figure_page is None
        else tuple(write_figures(folder, figure_page.sections, figure_page.title))
    )
    new_files = {item.relative_to(folder).as_posix() for item in (path, *drawings)}
    # Files that are rewritten now are intact again.
    damaged = tuple(fault for fault in file_faults if fault.name not in new_files)
    if damaged:
        page = replace(page, verdict=(Sentence(_damage_words(damaged), "bad"), *page.verdict))
    write_bytes(path, render(page).encode("utf-8", errors="replace"))
    rewritten = tuple(fault.name for fault in file_faults if fault.name in new_files)
    return Report(path, drawings, page, damaged, rewritten)


def _damage_words(damaged: Sequence[FileFault]) -> str:
    """Return the warning that files are not as they were written."""
    listed = "; ".join(f"{fault.name}: {fault.problem}" for fault in damaged[:_MAX_NAMED])
    more = f"; and {len(damaged) - _MAX_NAMED} more" if len(damaged) > _MAX_NAMED else ""
    return (
        f"Do not rely on this page: {len(damaged)} of the folder's files changed after "
        f"uqharness wrote the folder. {listed}{more}."
    )


def write_html(path: Path, page: Page) -> None:
    """Write a page as a file. Raises BadInputError."""
    write_bytes(path, render(page).encode("utf-8", errors="replace"))


def write_figures(folder: Path, sections: Iterable[Section], title: str) -> list[Path]:
    """Write the drawings of sections that name a file.

    Parameters
    ----------
    folder : Path
        Drawings go to its subfolder figures.
    sections : iterable of Section
        Sections of a page.
    title : str
        Heading of files that hold several drawings.

    Returns
    -------
    list of Path
        Files written.
    """
    # Refuses a folder that is a link.
    place, paths = inner_folder(folder, "figures"), []

    def write(name: str, text: str) -> None:
        """Write one drawing."""
        paths.append(place / f"{name}.svg")
        write_bytes(paths[-1], text.encode("utf-8", errors="replace"))

    for section in every_section(sections):
        for block in section.blocks:
            if not isinstance(block, Figures) or block.file is None:
                continue
            # One file for all drawings of the block.
            if block.file and block.items:
                columns = 3 if block.narrow else 2
                charts = [(figure.svg, figure.caption) for figure in block.items]
                write(
                    block.file,
                    standalone(charts, f"{title}: {section.title}", block.legend, columns),
                )
            elif not block.file:
                for figure in block.items:
                    write(
                        figure.name, standalone([(figure.svg, figure.caption)], legend=block.legend)
                    )
    return paths
