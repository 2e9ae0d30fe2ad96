"""report.html and figures/*.svg of a campaign's folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from uqharness.files import inner_folder, write_bytes
from uqharness.report.campaign import read_found
from uqharness.report.pages.campaign import campaign_page
from uqharness.report.parts import figures_of, render
from uqharness.report.svg import standalone

REPORT = "report.html"


@dataclass(frozen=True)
class Report:
    """What was written, and the verdict as plain sentences."""

    path: Path
    figures: tuple[Path, ...]
    verdict: tuple[str, ...]


def write_report(folder: Path) -> Report:
    """Write report.html and figures/*.svg into a complete campaign's folder. Same folder, same bytes. Raises BadInputError."""
    page = campaign_page(read_found(folder))
    path = folder / REPORT
    write_bytes(path, render(page).encode())
    figures, paths = inner_folder(folder, "figures"), []
    for figure in figures_of(page.sections):
        paths.append(figures / f"{figure.name}.svg")
        write_bytes(paths[-1], standalone(figure.svg).encode())
    return Report(path, tuple(paths), tuple(item.text for item in page.verdict))
