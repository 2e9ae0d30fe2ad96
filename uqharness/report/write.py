"""report.html of any folder of results, and figures/*.svg beside it: the drawings of the page as files."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from uqharness.files import inner_folder, write_bytes
from uqharness.report.pages.index import SEGMENTED, kind_of, page_of
from uqharness.report.parts import Figures, Page, Section, every_section, first_lines, render
from uqharness.report.svg import standalone

REPORT = "report.html"


@dataclass(frozen=True)
class Report:
    """What was written."""

    path: Path
    figures: tuple[Path, ...]
    page: Page

    @property
    def verdict(self) -> list[str]:
        """The verdict as plain sentences."""
        return [item.text for item in self.page.verdict]

    @property
    def text(self) -> str:
        """What a terminal shows: the page's first lines and where the rest is."""
        return "\n".join(
            [
                *first_lines(self.page),
                "",
                f"results in {self.path.parent}, the report in {self.path}",
            ]
        )


def write_report(folder: Path, figures: bool = False) -> Report:
    """Write ``folder``/report.html from the folder's own files. Same folder, same bytes. Raises BadInputError.

    ``figures``: write its drawings into figures/ as well. Those of a campaign always are.
    """
    page, kind = page_of(folder), kind_of(folder)
    drawn = page if figures or kind == "campaign run" else None
    if figures and kind in SEGMENTED:
        drawn = page_of(folder, every_segment=True)
    return write_page(folder, page, drawn)


def write_campaign_report(folder: Path) -> Report:
    """The same for the folder of a complete campaign and no other."""
    from uqharness.report.campaign import read_found
    from uqharness.report.pages.campaign import campaign_page

    page = campaign_page(read_found(folder))
    return write_page(folder, page, page)


def write_page(folder: Path, page: Page, drawn: Page | None = None) -> Report:
    """Write a page as ``folder``/report.html, and the drawings of ``drawn`` into figures/. Raises BadInputError."""
    path = folder / REPORT
    write_bytes(path, render(page).encode("utf-8", errors="replace"))
    return Report(
        path,
        () if drawn is None else tuple(write_figures(folder, drawn.sections, drawn.title)),
        page,
    )


def write_html(path: Path, page: Page) -> None:
    """Write a page as a file of its own. Raises BadInputError."""
    write_bytes(path, render(page).encode("utf-8", errors="replace"))


def write_figures(folder: Path, sections: Iterable[Section], title: str) -> list[Path]:
    """Write the drawings of sections that name a file into ``folder``/figures; ``title`` heads those that share one."""
    place, paths = inner_folder(folder, "figures"), []

    def write(name: str, text: str) -> None:
        paths.append(place / f"{name}.svg")
        write_bytes(paths[-1], text.encode("utf-8", errors="replace"))

    for section in every_section(sections):
        for block in section.blocks:
            if not isinstance(block, Figures) or block.file is None:
                continue
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
