r"""Text and tables that are safe to print on a terminal or to show in a notebook.

Logs, file names and models may contain escape sequences that rename a window, hide lines or paste
commands, and characters that reverse the order of text. `visible` writes them out (``\x1b``,
``\u202e``); `clean_streams` does so for everything that a process prints. `view` builds the HTML
that a notebook shows for a result, with all texts escaped and without scripts or styles.
"""

from __future__ import annotations

import contextlib
import html
import math
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TextIO, cast

if TYPE_CHECKING:
    import pandas as pd

# All control characters except tab and line feed, lone surrogates, line and paragraph
# separators, and marks that change the direction of text.
_CONTROL_CHARACTERS = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)


def visible(text: str) -> str:
    r"""Return ``text`` with every character that steers a terminal written as an escape.

    Tab and line feed stay as they are.

    Examples
    --------
    >>> visible("\x1b[2J")
    '\\x1b[2J'
    """
    return _CONTROL_CHARACTERS.sub(_escaped, text)


def _escaped(match: re.Match[str]) -> str:
    r"""Write one control character as ``\xNN`` or ``\uNNNN``."""
    code = ord(match[0])
    # The longer form is a JSON escape too, so that strings inside JSON output keep their meaning.
    return f"\\x{code:02x}" if code < 0x20 else f"\\u{code:04x}"


class _EscapingStream:
    """A text stream that escapes control characters and otherwise behaves like the stream it
    wraps.
    """

    def __init__(self, stream: TextIO) -> None:
        self.raw_stream = stream

    def write(self, text: str) -> int:
        """Write ``text`` escaped; return the length of ``text`` as received, as streams must."""
        self.raw_stream.write(_encodable(visible(text), self.raw_stream))
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Write each line in turn."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.raw_stream, name)

    def __enter__(self) -> _EscapingStream:
        return self

    def __exit__(self, *_: object) -> None:
        self.raw_stream.flush()

    def __iter__(self) -> Iterator[str]:
        return iter(self.raw_stream)


def _encodable(text: str, stream: TextIO) -> str:
    """Replace characters that the stream's encoding lacks by escapes.

    Output that is piped in Latin-1 or ASCII must not raise UnicodeEncodeError.
    """
    encoding = getattr(stream, "encoding", None) or "utf-8"
    with contextlib.suppress(LookupError):
        return text.encode(encoding, "backslashreplace").decode(encoding)
    return text


def clean_streams() -> None:
    """Make standard output and standard error of this process escape control characters.

    A second call has no further effect.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is not None and not isinstance(stream, _EscapingStream):
            setattr(sys, name, cast(TextIO, _EscapingStream(stream)))


@contextlib.contextmanager
def clean_terminal() -> Iterator[None]:
    """Escape control characters on both streams inside a ``with`` block; restore the streams
    after it.
    """
    original_streams = sys.stdout, sys.stderr
    clean_streams()
    try:
        yield
    finally:
        sys.stdout, sys.stderr = original_streams


def cursor_stream(stream: TextIO) -> TextIO:
    """Return the unwrapped stream, for code that moves the cursor itself.

    The caller passes all foreign text through `visible` first.
    """
    return stream.raw_stream if isinstance(stream, _EscapingStream) else stream


# HTML views of results for notebooks.
MAX_ROWS = 20
"""Rows of a table that are shown; pandas leaves out the middle of a longer one."""


def view(
    title: str, *parts: str, facts: Mapping[str, object] | None = None, warnings: Iterable[str] = ()
) -> str:
    """Build the HTML view of a result: title, facts, tables, warnings.

    Parameters
    ----------
    title : str
        One line of text.
    *parts : str
        HTML of tables and charts, shown below the facts.
    facts : mapping, optional
        Name to value (text or number), shown on one line.
    warnings : iterable of str
        Sentences, shown last.

    Returns
    -------
    str
        HTML in which all texts are escaped, without scripts and styles.
    """
    line = "; ".join(
        f"{html.escape(name)}: {html.escape(cell_text(value))}"
        for name, value in (facts or {}).items()
    )
    warning_items = "".join(f"<li>{html.escape(text)}</li>" for text in warnings)
    pieces = [f"<p><b>{html.escape(title)}</b></p>", f"<p>{line}</p>" if line else "", *parts]
    pieces.append(f"<p>Warnings</p><ul>{warning_items}</ul>" if warning_items else "")
    return f"<div>{''.join(pieces)}</div>"


def rows_table(rows: Sequence[Mapping[str, object]]) -> str:
    """Return rows with equal keys as an HTML table; an empty string for no rows."""
    if not rows:
        return ""
    head = "".join(f"<th>{html.escape(str(key))}</th>" for key in rows[0])
    body = "".join(
        "<tr>"
        + "".join(f"<td>{html.escape(cell_text(value))}</td>" for value in row.values())
        + "</tr>"
        for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def frame_table(frame: pd.DataFrame) -> str:
    """Return a pandas DataFrame as HTML, with at most MAX_ROWS of its rows."""
    return str(frame.to_html(max_rows=MAX_ROWS, show_dimensions=True))


def cell_text(value: object) -> str:
    """Return the text of a table cell: four significant digits, empty for NaN."""
    if isinstance(value, bool) or not isinstance(value, float):
        return str(value)
    return "" if math.isnan(value) else f"{value:.4g}"
