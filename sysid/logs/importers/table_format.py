"""How the text of a table is written: separator, decimal sign, encoding, and the lines that hold names and units.

Every combination of separator and decimal sign is tried on the table's first lines, with Python's csv module; the one that
reads most cells as numbers below a line of names is taken.
"""

from __future__ import annotations

import csv
import itertools
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

SNIFFED_BYTES = 65536
_SNIFFED_LINES = 60
_WAYS = ((",", "."), (";", ","), (";", "."), ("\t", "."), ("\t", ","), ("|", "."), (",", ","))
_CLOCK = re.compile(r"\d:\d\d")
_SPACES = ((" ", "."), (" ", ","))
SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}


@dataclass(frozen=True)
class TableFormat:
    """How a table is written.

    separator, decimal, encoding   as pandas takes them, but " " for any number of spaces
    header_line   line (from 0) of the names; those before it hold comments, or words about the file
    names, units  of the columns; ``units`` is empty where no line of units follows the names
    numeric       number of columns that hold numbers or times of day
    trailing      whether a separator follows the last cell of each row, but not the last name
    """

    separator: str
    decimal: str
    encoding: str
    header_line: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    numeric: int
    trailing: bool = False

    @property
    def first_row_line(self) -> int:
        """Line (from 0) of the first row of values."""
        return self.header_line + 1 + bool(self.units)


def decoded(head: bytes) -> tuple[str, str] | None:
    """Text of a file's first bytes and its encoding, None for what is no text."""
    if b"\0" in head:
        return None
    # A character may be cut at the end of the head.
    lines = head if len(head) < SNIFFED_BYTES else head[: head.rfind(b"\n") + 1]
    for encoding in ("utf-8-sig", "cp1252"):
        try:
            text = lines.decode(encoding)
        except UnicodeDecodeError:
            continue
        # Bytes of any kind can be cp1252: a table has lines of printable characters.
        printable = sum(c.isprintable() or c in "\t\r\n" for c in text[:2000])
        if encoding == "utf-8-sig" or printable > 0.99 * len(text[:2000]):
            return text, encoding
    return None


def listed(names: Sequence[Any]) -> str:
    """The columns of a table and the way to a map, for a message."""
    shown = ", ".join(str(name)[:40] for name in names[:40])
    more = f" and {len(names) - 40} more" if len(names) > 40 else ""
    return f"its columns are {shown}{more}; `uqharness log map FILE --out map.toml` proposes a map"


def sniff(head: bytes) -> TableFormat | None:
    """How the table is written whose first bytes (up to SNIFFED_BYTES) these are; None where they are no table."""
    content = decoded(head)
    if content is None:
        return None
    text, encoding = content
    lines = [
        (number, line)
        for number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"))
        if line.strip() and not line.startswith("#")
    ][:_SNIFFED_LINES]
    for ways in (_WAYS, _SPACES):
        tried = [_read_as(lines, separator, decimal, encoding) for separator, decimal in ways]
        scored = [(score, -k, way) for k, (score, way) in enumerate(tried) if way is not None]
        if scored:
            return max(scored)[2]
    return None


def is_number(cell: str, decimal: str = ".") -> bool:
    """Whether a cell is empty or a number."""
    cell = cell.strip()
    if decimal != ".":
        if "." in cell:
            return False
        cell = cell.replace(decimal, ".")
    if not cell:
        return True
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _read_as(
    lines: Sequence[tuple[int, str]], separator: str, decimal: str, encoding: str
) -> tuple[float, TableFormat | None]:
    """Share of the cells that are numbers, weighted by their count, and the format; None where this is no table."""
    try:
        rows = [
            next(
                csv.reader(
                    [line.strip() if separator == " " else line],
                    delimiter=separator,
                    skipinitialspace=True,
                )
            )
            for _, line in lines
        ]
    except (csv.Error, StopIteration):
        return 0.0, None
    if len(rows) < 2:
        return 0.0, None
    width = Counter(len(row) for row in rows[len(rows) // 2 :]).most_common(1)[0][0]
    # A separator at the end of each row, but not of the names, adds an empty cell.
    narrow = width - 1 if all(not row[-1] for row in rows[len(rows) // 2 :]) else width
    top = next(
        (
            k
            for k, (row, below) in enumerate(itertools.pairwise(rows))
            if len(row) in (width, narrow) and len(below) == width
        ),
        None,
    )
    if top is None or narrow < 2:
        return 0.0, None
    first = [cell.strip() for cell in rows[0] if cell.strip()]
    if any(is_number(cell.strip(), decimal) for cell in rows[top]) and len(first) > 1:
        # Names that are fewer than the cells below them are names all the same: the reader counts both.
        top = top if any(is_number(cell, decimal) for cell in first) else 0
    names = [cell.strip() for cell in rows[top]]
    body = [row[:narrow] for row in rows[top + 1 :] if len(row) == width]
    units: tuple[str, ...] = ()
    if len(body) > 1:
        numeric = _numeric_columns(body[1:], decimal)
        words = [bool(body[0][k].strip()) and not is_number(body[0][k], decimal) for k in numeric]
        if numeric and len(words) > 1 and sum(words) > len(words) // 2:
            units, body = tuple(cell.strip() for cell in body[0]), body[1:]
    numeric = _numeric_columns(body, decimal)
    cells = sum(bool(row[k].strip()) for row in body for k in numeric)
    named = [name for name in names if name]
    if any(is_number(name, decimal) for name in named) or len(set(named)) < 2:
        cells //= 4  # numbers above numbers are rather a row than names
    if not cells:
        return 0.0, None
    clocks = sum(all(_CLOCK.search(row[k]) for row in body) for k in range(len(body[0])))
    table = TableFormat(
        separator,
        decimal,
        encoding,
        lines[top][0],
        tuple(names),
        units,
        len(numeric) + clocks,
        len(rows[top]) == narrow < width,
    )
    return float(cells), table


def _numeric_columns(rows: Sequence[Sequence[str]], decimal: str) -> list[int]:
    """Columns most of whose cells are numbers, as far as they are not empty."""
    columns = []
    for k in range(len(rows[0])):
        cells = [row[k] for row in rows if row[k].strip()]
        if 2 * sum(is_number(cell, decimal) for cell in cells) > len(cells):
            columns.append(k)
    return columns
