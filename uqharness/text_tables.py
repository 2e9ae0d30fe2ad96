"""Tables as text, markdown and CSV, and CSV tables of this program read back."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sysid.display import frame_table, view
from uqharness.errors import BadInputError

if TYPE_CHECKING:
    import pandas as pd


class TabularResult:
    """A result that notebooks show as a table."""

    def to_dataframe(self) -> pd.DataFrame:
        """Return the table."""
        raise NotImplementedError

    def _facts(self) -> Mapping[str, object]:
        """Return names and values shown above the table."""
        return {}

    def _repr_html_(self) -> str:
        """Return the table as HTML for a notebook."""
        warnings = getattr(self, "warnings", ())
        return view(
            repr(self), frame_table(self.to_dataframe()), facts=self._facts(), warnings=warnings
        )


def text_table(rows: Sequence[Mapping[str, str]]) -> list[str]:
    """Return rows of equal keys as right-aligned lines, the header first.

    Examples
    --------
    >>> text_table([{"a": "1", "b": "20"}])
    ['a   b', '1  20']
    """
    keys = list(rows[0])
    width = {k: max(len(k), *(len(r[k]) for r in rows)) for k in keys}
    return [
        "  ".join(k.rjust(width[k]) for k in keys),
        *("  ".join(r[k].rjust(width[k]) for k in keys) for r in rows),
    ]


def markdown_table(rows: Sequence[Mapping[str, str]]) -> str:
    """Return rows of equal keys as a markdown table."""
    keys = list(rows[0])
    lines = ["| " + " | ".join(keys) + " |", "|" + "---|" * len(keys)]
    return (
        "\n".join(
            [
                *lines,
                *("| " + " | ".join(r[k].replace("|", "/") for k in keys) + " |" for r in rows),
            ]
        )
        + "\n"
    )


def csv_text(rows: Sequence[Mapping[str, str]]) -> str:
    """Return rows of equal keys as CSV."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: plain_cell(text) for key, text in row.items()} for row in rows)
    return buffer.getvalue()


def plain_cell(text: str) -> str:
    """Return a cell that no spreadsheet takes for a formula.

    Texts that begin like a formula get an apostrophe; numbers stay.

    Examples
    --------
    >>> plain_cell("=1+1"), plain_cell("-2.5")
    ("'=1+1", '-2.5')
    """
    # A single "-" marks an empty cell.
    if not text.startswith(("=", "+", "-", "@", "\t", "\r")) or text == "-":
        return text
    try:
        float(text)
    except ValueError:
        return f"'{text}"
    return text


def csv_rows(
    content: bytes,
    path: Path,
    numbers: Collection[str],
    texts: Collection[str],
    maybe: Collection[str] = (),
) -> list[dict[str, str]]:
    """Return the rows of a CSV table as text.

    Parameters
    ----------
    content : bytes
        Content of the file.
    path : Path
        Name of the file in messages.
    numbers, texts, maybe : collection of str
        Required columns: numbers, texts, and numbers that may be empty.

    Raises
    ------
    BadInputError
        If a column is missing or a number is none.
    """
    try:
        reader = csv.DictReader(io.StringIO(content.decode("utf-8"), newline=""))
        rows = list(reader)
    except UnicodeDecodeError:
        raise BadInputError(f"{path}: not a text file in UTF-8") from None
    except csv.Error as error:
        raise BadInputError(f"{path}: not a readable CSV table: {error}") from None
    missing = [name for name in (*numbers, *maybe, *texts) if name not in (reader.fieldnames or ())]
    if missing:
        raise BadInputError(f"{path}: has no column {missing[0]}; make the table again")
    for line, row in enumerate(rows, start=2):
        # A truncated row lacks its last columns, which may not be among the required ones.
        if None in row or None in row.values():
            raise BadInputError(
                f"{path}:{line}: has another number of columns than the first line; make the table"
                " again"
            )
        invalid = [name for name in (*numbers, *maybe) if not _is_number(row[name], name in maybe)]
        if invalid or any(row[name] is None for name in texts):
            name = invalid[0] if invalid else next(name for name in texts if row[name] is None)
            raise BadInputError(
                f"{path}:{line}: {name} is {row[name]!r}, which it cannot be; make the table again"
            )
    return rows


def _is_number(text: str | None, may_be_empty: bool) -> bool:
    """Return whether a text is a number, or empty where that is allowed."""
    if text == "":
        return may_be_empty
    try:
        return text is not None and not math.isnan(float(text))
    except ValueError:
        return False
