"""What a report page is made of, whatever it reports on: frozen parts that templates/page.html.j2
knows how to show.
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
from uqharness.text_tables import text_table

Level = Literal["good", "warn", "bad", ""]
SIGNS: Mapping[str, str] = {"good": "✓", "bad": "✕", "warn": "!", "": ""}
"""What stands beside a colour, for readers without it."""


@dataclass(frozen=True)
class Sentence:
    """A sentence of the verdict, and whether it is good news; an empty level is a plain fact."""

    text: str
    level: Level = ""

    @property
    def sign(self) -> str:
        """The mark beside the sentence."""
        return SIGNS[self.level]


@dataclass(frozen=True)
class Words:
    """A paragraph; ``note`` in a softer colour."""

    kind: ClassVar[str] = "words"
    text: str
    note: bool = False


@dataclass(frozen=True)
class Bullets:
    """A list of sentences; ``key``: a terminal shows them too."""

    kind: ClassVar[str] = "bullets"
    items: tuple[str, ...]
    key: bool = False


@dataclass(frozen=True)
class Sentences:
    """Sentences with their level, as in the verdict."""

    kind: ClassVar[str] = "told"
    items: tuple[Sentence, ...]


@dataclass(frozen=True)
class Cell:
    """A table cell that is more than text: its level colours it, its sign says the same without
    colour.
    """

    text: str
    level: Level = ""
    small: str = ""
    code: bool = False
    mark: str = ""

    @property
    def sign(self) -> str:
        """The mark in the cell."""
        return self.mark or SIGNS[self.level]


@dataclass(frozen=True)
class Table:
    """Rows of text or cells under a caption; the first column heads its row.

    ``key``: a terminal shows it too.
    """

    kind: ClassVar[str] = "table"
    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str | Cell, ...], ...]
    key: bool = False

    @property
    def cells(self) -> tuple[tuple[Cell, ...], ...]:
        """Rows of cells, plain texts made into cells."""
        return tuple(tuple(Cell(c) if isinstance(c, str) else c for c in row) for row in self.rows)


@dataclass(frozen=True)
class Figure:
    """A drawing with its caption.

    ``cursor`` is what the page's script reads out under the pointer; None for no cursor.
    """

    name: str
    svg: Markup
    caption: str
    cursor: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Figures:
    """Drawings side by side; ``legend`` (class of figure.css, words) holds for all of them.

    file: name without ending of the file in figures/ that holds them all; empty: each has one of
    its own name; None: no file."""

    kind: ClassVar[str] = "figures"
    items: tuple[Figure, ...]
    legend: tuple[tuple[str, str], ...] = ()
    narrow: bool = False
    file: str | None = None


@dataclass(frozen=True)
class Facts:
    """Names and what they are; ``code`` for what is to be read letter by letter."""

    kind: ClassVar[str] = "facts"
    items: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Code:
    """Lines as they stand in a file or on a command line."""

    kind: ClassVar[str] = "code"
    label: str
    text: str


Block = Words | Bullets | Sentences | Table | Figures | Facts | Code


@dataclass(frozen=True)
class Section:
    """A heading with what stands under it, and the sections within it; ``folded`` until the reader
    opens it.
    """

    title: str
    blocks: tuple[Block, ...]
    parts: tuple[Section, ...] = ()
    folded: bool = False


@dataclass(frozen=True)
class Page:
    """A whole report: the verdict is shown first, then ``first``, then what was asked (where that
    is not the title), then sections.

    With ``first`` the verdict is the answer and its reasons, in larger letters, and page and
    ``first`` make one screen."""

    title: str
    question: str
    verdict: tuple[Sentence, ...]
    sections: tuple[Section, ...] = field(default=())
    first: tuple[Block, ...] = ()


def is_wanted(title: str, only: Collection[str] | None) -> bool:
    """Whether a section is among those that are shown (None: all): what is not need not be
    drawn.
    """
    return only is None or title in only


@cache
def _template() -> jinja2.Template:
    """The page's template, compiled once a process."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("uqharness.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("page.html.j2")


def render(page: Page) -> str:
    """The page as one HTML file that needs no other. Same page, same bytes."""
    blocks = (
        *page.first,
        *(block for section in every_section(page.sections) for block in section.blocks),
    )
    cursors = any(
        figure.cursor for block in blocks if isinstance(block, Figures) for figure in block.items
    )
    sheets = [_text(name) for name in ("figure.css", "page.css")]
    rendered = _template().render(
        page=page, style=Markup("".join(sheets)), script=Markup(_text("page.js")) if cursors else ""
    )
    # A control character in a file's or a flight's name has no meaning on a page.
    return visible(rendered)


def every_section(sections: Iterable[Section]) -> Iterator[Section]:
    """Sections and those within them, as a reader meets them."""
    for section in sections:
        yield section
        yield from every_section(section.parts)


def first_lines(page: Page) -> list[str]:
    """What a terminal shows of a page: the sentences of its verdict, then its key tables
    and lists.
    """
    lines = [item.text for item in page.verdict]
    for block in (block for section in every_section(page.sections) for block in section.blocks):
        if isinstance(block, Table) and block.key and block.rows:
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
    return (
        resources.files("uqharness.report")
        .joinpath(f"templates/{name}")
        .read_text(encoding="utf-8")
    )


def format_value(value: float | None, form: str = ".3g") -> str:
    """A figure as text. What is undefined says so and is never a 0; what has no end is open."""
    if value is None or math.isnan(value):
        return "undefined"
    return "open" if math.isinf(value) else format(value, form)


def percent(value: float | None, form: str = ".3g") -> str:
    """A share as a number of percent."""
    return format_value(None if value is None else 100.0 * value, form)


def remarks(
    document: Mapping[str, Any], key: Iterable[str] = ("warnings", "notes")
) -> tuple[Section, ...]:
    """The section of a document's warnings and notes, none where there are none; a terminal shows
    those named in ``key``.
    """
    remarks_by_name = {name: tuple(document.get(name, ())) for name in ("warnings", "notes")}
    blocks = tuple(Bullets(items, name in key) for name, items in remarks_by_name.items() if items)
    return (Section("Warnings and notes", blocks),) if blocks else ()


def provenance(*facts: tuple[str, str]) -> Section:
    """The provenance of a page: its last section."""
    return Section("Provenance", (Facts(facts),))
