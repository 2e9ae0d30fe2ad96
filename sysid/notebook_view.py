"""What a notebook shows of a result: its name, a few facts, a table, warnings, as HTML without scripts or styles of its own.

Texts may come from logs and files of others, so that all of them are escaped.
"""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

MOST_ROWS = 20


def view(
    title: str, *parts: str, facts: Mapping[str, object] | None = None, warnings: Iterable[str] = ()
) -> str:
    """The whole view.

    Parameters
    ----------
    title
        One line, text.
    parts
        HTML below the facts: tables and charts.
    facts
        Name to value, text or number, on one line.
    warnings
        Sentences, listed last.
    """
    line = "; ".join(
        f"{html.escape(name)}: {html.escape(written(value))}"
        for name, value in (facts or {}).items()
    )
    said = "".join(f"<li>{html.escape(text)}</li>" for text in warnings)
    pieces = [f"<p><b>{html.escape(title)}</b></p>", f"<p>{line}</p>" if line else "", *parts]
    pieces.append(f"<p>Warnings</p><ul>{said}</ul>" if said else "")
    return f"<div>{''.join(pieces)}</div>"


def rows_table(rows: Sequence[Mapping[str, object]]) -> str:
    """Rows of equal keys as an HTML table; empty for no row."""
    if not rows:
        return ""
    head = "".join(f"<th>{html.escape(str(key))}</th>" for key in rows[0])
    body = "".join(
        "<tr>"
        + "".join(f"<td>{html.escape(written(value))}</td>" for value in row.values())
        + "</tr>"
        for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def frame_table(frame: pd.DataFrame) -> str:
    """A pandas table as HTML, its first and last rows where there are many."""
    return str(frame.to_html(max_rows=MOST_ROWS, show_dimensions=True))


def written(value: object) -> str:
    """A value in a cell: numbers to four digits, nothing where a number is undefined."""
    if isinstance(value, bool) or not isinstance(value, float):
        return str(value)
    return "" if math.isnan(value) else f"{value:.4g}"
