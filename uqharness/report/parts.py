"""Define the parts of report pages and render them to HTML.

Parts are frozen dataclasses (`Page`, `Section`, `Table`, `Figures`, ...) that the modules in
`uqharness.report.pages` build and templates/page.html.j2 displays. `first_lines` gives the terminal
summary of a page.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from typing import Any, ClassVar, Literal

import jinja2
from markupsafe import Markup

from sysid.display import visible
from uqharness.results.base import Part
from uqharness.text_tables import text_table

Level = Literal["good", "warn", "bad", ""]
SIGNS: Mapping[str, str] = {"good": "✓", "bad": "✕", "warn": "!", "": ""}
"""Mark shown with a colour, for readers who do not see it."""


def level_of(value: str | None) -> Level:
    """Return a valid level, or the empty one."""
    return value if value in ("good", "warn", "bad") else ""  # type: ignore[return-value]


@dataclass(frozen=True)
class Sentence:
    """A sentence of the verdict; ``level`` is good, warn, bad or empty for a plain fact."""

    text: str
    level: Level = ""

    @property
    def sign(self) -> str:
        """Mark of the level."""
        return SIGNS[self.level]


@dataclass(frozen=True)
class Words:
    """A paragraph; a ``note`` is shown in a softer colour."""

    kind: ClassVar[str] = "words"
    text: str
    note: bool = False


@dataclass(frozen=True)
class Bullets:
    """A list of sentences; with ``key`` a terminal shows it too."""

    kind: ClassVar[str] = "bullets"
    items: tuple[str, ...]
    key: bool = False


@dataclass(frozen=True)
class Sentences:
    """Sentences with levels."""

    kind: ClassVar[str] = "told"
    items: tuple[Sentence, ...]


@dataclass(frozen=True)
class Cell:
    """A table cell with a level.

    Attributes
    ----------
    text : str
        Content.
    level : str
        Colours the cell: good, warn, bad or empty.
    small : str
        Second line in small type.
    code : bool
        Whether the text is set in a fixed-width font.
    mark : str
        Mark instead of that of the level.
    """

    text: str
    level: Level = ""
    small: str = ""
    code: bool = False
    mark: str = ""

    @property
    def sign(self) -> str:
        """Mark of the cell."""
        return self.mark or SIGNS[self.level]


@dataclass(frozen=True)
class Table:
    """A table of text or cells; the first column heads its row.

    With ``key`` a terminal shows it too.
    """

    kind: ClassVar[str] = "table"
    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str | Cell, ...], ...]
    key: bool = False

    @property
    def cells(self) -> tuple[tuple[Cell, ...], ...]:
        """Rows of cells; plain texts are wrapped."""
        return tuple(tuple(Cell(c) if isinstance(c, str) else c for c in row) for row in self.rows)


@dataclass(frozen=True)
class Figure:
    """A drawing with its caption.

    ``cursor`` holds the data that the page's script reads out under the pointer; None for no
    cursor.
    """

    name: str
    svg: Markup
    caption: str
    cursor: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Figures:
    """Drawings side by side.

    Attributes
    ----------
    items : tuple of Figure
        The drawings.
    legend : tuple of (str, str)
        Class of figure.css and words, for all drawings.
    narrow : bool
        Whether three fit in a row.
    file : str or None
        Name in figures/ of the file that holds them all; empty: one file each; None: no file.
    """

    kind: ClassVar[str] = "figures"
    items: tuple[Figure, ...]
    legend: tuple[tuple[str, str], ...] = ()
    narrow: bool = False
    file: str | None = None


@dataclass(frozen=True)
class Facts:
    """Names and values."""

    kind: ClassVar[str] = "facts"
    items: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Code:
    """Lines of a file or a command line."""

    kind: ClassVar[str] = "code"
    label: str
    text: str


Block = Words | Bullets | Sentences | Table | Figures | Facts | Code


@dataclass(frozen=True)
class Section:
    """A heading, its blocks and subsections; ``folded`` sections are closed at first."""

    title: str
    blocks: tuple[Block, ...]
    parts: tuple[Section, ...] = ()
    folded: bool = False


@dataclass(frozen=True)
class Page:
    """A report.

    Attributes
    ----------
    title, question : str
        Heading, and the question that the report answers (empty if the title is the question).
    verdict : tuple of Sentence
        Answer, shown first.
    sections : tuple of Section
        Sections.
    first : tuple of Block
        Figures next to the verdict. With them the verdict is set in larger letters and both fill
        one
        screen.
    """

    title: str
    question: str
    verdict: tuple[Sentence, ...]
    sections: tuple[Section, ...] = field(default=())
    first: tuple[Block, ...] = ()


def is_wanted(title: str, only: Collection[str] | None) -> bool:
    """Return whether a section is displayed; ``only`` lists the titles, None means all."""
    return only is None or title in only


@cache
def _template() -> jinja2.Template:
    """Return the compiled page template."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("uqharness.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("page.html.j2")


def render(page: Page) -> str:
    """Return the page as one HTML file that needs no other; the same page gives the same bytes."""
    blocks = (
        *page.first,
        *(block for section in every_section(page.sections) for block in section.blocks),
    )
    # The script is included only if a figure has a cursor.
    cursors = any(
        figure.cursor for block in blocks if isinstance(block, Figures) for figure in block.items
    )
    # Style sheets and script are part of the page, so it needs no other file.
    sheets = [_text(name) for name in ("figure.css", "page.css")]
    rendered = _template().render(
        page=page, style=Markup("".join(sheets)), script=Markup(_text("page.js")) if cursors else ""
    )
    # Control characters in names of files or flights must not reach the page.
    return visible(rendered)


def every_section(sections: Iterable[Section]) -> Iterator[Section]:
    """Yield sections and their subsections in reading order."""
    for section in sections:
        yield section
        yield from every_section(section.parts)


def first_lines(page: Page) -> list[str]:
    """Return what a terminal shows of a page.

    Parameters
    ----------
    page : Page
        Report.

    Returns
    -------
    list of str
        Sentences of the verdict, then key tables and lists.
    """
    lines = [item.text for item in page.verdict]
    for block in (block for section in every_section(page.sections) for block in section.blocks):
        if isinstance(block, Table) and block.key and block.rows:
            # Small print of a cell follows in parentheses.
            cells = [
                [f"{c.text} ({c.small})" if c.small else c.text for c in row] for row in block.cells
            ]
            lines += [
                "",
                block.caption,
                *text_table([dict(zip(block.head, row, strict=True)) for row in cells]),
            ]
        elif isinstance(block, Bullets) and block.key:
            lines += ["", *block.items]
    return lines


@cache
def _text(name: str) -> str:
    """Read a file of the templates folder."""
    return (
        resources.files("uqharness.report")
        .joinpath(f"templates/{name}")
        .read_text(encoding="utf-8")
    )


def format_value(value: float | None, form: str = ".3g") -> str:
    """Format a number; "undefined" for None and NaN, "open" for infinity.

    Examples
    --------
    >>> format_value(0.12345), format_value(float("nan")), format_value(float("inf"))
    ('0.123', 'undefined', 'open')
    """
    if value is None or math.isnan(value):
        return "undefined"
    return "open" if math.isinf(value) else format(value, form)


def percent(value: float | None, form: str = ".3g") -> str:
    """Format a share as a number of percent."""
    return format_value(None if value is None else 100.0 * value, form)


def remarks(
    document: Mapping[str, Any] | Part, key: Iterable[str] = ("warnings", "notes")
) -> tuple[Section, ...]:
    """Return the section of a document's warnings and notes.

    Parameters
    ----------
    document : Part or mapping
        Holds the lists "warnings" and "notes".
    key : iterable of str
        Lists that a terminal shows as well.

    Returns
    -------
    tuple of Section
        Empty without warnings and notes.
    """
    remarks_by_name = {name: tuple(document.get(name, ())) for name in ("warnings", "notes")}
    blocks = tuple(Bullets(items, name in key) for name, items in remarks_by_name.items() if items)
    return (Section("Warnings and notes", blocks),) if blocks else ()


def provenance(*facts: tuple[str, str]) -> Section:
    """Return the last section of a page: where its content comes from."""
    return Section("Provenance", (Facts(facts),))
