"""report.html of any folder of results, and figures/*.svg beside it: the drawings of the page as files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from uqharness.checksums import Fault, faults
from uqharness.files import inner_folder, write_bytes
from uqharness.report.pages.index import SEGMENTED, kind_of, page_of
from uqharness.report.parts import Figures, Page, Say, Section, every_section, first_lines, render
from uqharness.report.svg import standalone

REPORT = "report.html"
_NAMED = 5
"""Damaged files that a page names."""


@dataclass(frozen=True)
class Report:
    """What was written. ``damaged``: files of the folder that are not as they were written; ``rewritten``: those that now are."""

    path: Path
    figures: tuple[Path, ...]
    page: Page
    damaged: tuple[Fault, ...] = ()
    rewritten: tuple[str, ...] = ()

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
    path, found = folder / REPORT, faults(folder)
    drawings = () if drawn is None else tuple(write_figures(folder, drawn.sections, drawn.title))
    written = {item.relative_to(folder).as_posix() for item in (path, *drawings)}
    damaged = tuple(fault for fault in found if fault.name not in written)
    if damaged:
        page = replace(page, verdict=(Say(_damage_words(damaged), "bad"), *page.verdict))
    write_bytes(path, render(page).encode("utf-8", errors="replace"))
    again = tuple(fault.name for fault in found if fault.name in written)
    return Report(path, drawings, page, damaged, again)


def _damage_words(damaged: Sequence[Fault]) -> str:
    """Say on the page that files are not as they were written, and how many."""
    named = "; ".join(f"{fault.name}: {fault.problem}" for fault in damaged[:_NAMED])
    more = f"; and {len(damaged) - _NAMED} more" if len(damaged) > _NAMED else ""
    return (
        f"Do not rely on this page: {len(damaged)} of the folder's files changed after "
        f"uqharness wrote the folder. {named}{more}."
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
