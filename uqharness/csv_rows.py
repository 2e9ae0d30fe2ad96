"""Rows of a CSV table that this program wrote, read back with a look at what they must have."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Collection
from pathlib import Path

from uqharness.errors import BadInputError


def csv_rows(
    content: bytes, path: Path, numbers: Collection[str], texts: Collection[str], maybe: Collection[str] = ()
) -> list[dict[str, str]]:
    """Rows of a CSV table as text.

    Raises BadInputError where a column is missing, ``numbers`` are none, or what stands in ``maybe`` is neither empty nor a number.
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
        wrong = [name for name in (*numbers, *maybe) if not _is_number(row[name], name in maybe)]
        if wrong or any(row[name] is None for name in texts):
            name = wrong[0] if wrong else next(name for name in texts if row[name] is None)
            raise BadInputError(f"{path}:{line}: {name} is {row[name]!r}, which it cannot be; make the table again")
    return rows


def _is_number(text: str | None, may_be_empty: bool) -> bool:
    if text == "":
        return may_be_empty
    try:
        return text is not None and not math.isnan(float(text))
    except ValueError:
        return False
