"""What a terminal is sent: text in which nothing of a log, a file's name or a model can steer it.

A log may hold escape sequences that rename a window, hide lines or paste commands, and a name may
hold characters that turn the order of what follows. On standard output and standard error they show
as what they are: ``\x1b``, ``\u202e``."""

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

# Control characters but tab and line feed, lone surrogates, line and paragraph separators, marks
# that turn the order of text.
_CONTROL_CHARACTERS = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)


def visible(text: str) -> str:
    """The text with every character that a terminal would act on written out."""
    return _CONTROL_CHARACTERS.sub(_escaped, text)


def _escaped(match: re.Match[str]) -> str:
    code = ord(match[0])
    # The longer form is also JSON's, which leaves these characters as they are in its strings.
    return f"\\x{code:02x}" if code < 0x20 else f"\\u{code:04x}"


class _EscapingStream:
    """A text stream that writes only what may be seen; in all else the stream it stands for."""

    def __init__(self, stream: TextIO) -> None:
        self.raw_stream = stream

    def write(self, text: str) -> int:
        """Write; the length of the text as it was given."""
        self.raw_stream.write(_encodable(visible(text), self.raw_stream))
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Write one after another."""
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
    """The text with what the stream's encoding lacks written out: output to a pipe in Latin-1 or
    ASCII is no reason to fail.
    """
    encoding = getattr(stream, "encoding", None) or "utf-8"
    with contextlib.suppress(LookupError):
        return text.encode(encoding, "backslashreplace").decode(encoding)
    return text


def clean_streams() -> None:
    """From now on, standard output and standard error of this process write only what may be seen.

    May be called again.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is not None and not isinstance(stream, _EscapingStream):
            setattr(sys, name, cast(TextIO, _EscapingStream(stream)))


@contextlib.contextmanager
def clean_terminal() -> Iterator[None]:
    """The same for a block; the streams that were there before come back after it."""
    original_streams = sys.stdout, sys.stderr
    clean_streams()
    try:
        yield
    finally:
        sys.stdout, sys.stderr = original_streams


def cursor_stream(stream: TextIO) -> TextIO:
    """The stream as it was before: for what moves the cursor itself, with texts that went through
    `visible`.
    """
    return stream.raw_stream if isinstance(stream, _EscapingStream) else stream


# What a notebook shows of a result: its name, a few facts, a table, warnings, as HTML without
# scripts or styles of its own.
#
# Texts may come from logs and files of others, so that all of them are escaped.

MAX_ROWS = 20


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
        f"{html.escape(name)}: {html.escape(cell_text(value))}"
        for name, value in (facts or {}).items()
    )
    warning_items = "".join(f"<li>{html.escape(text)}</li>" for text in warnings)
    pieces = [f"<p><b>{html.escape(title)}</b></p>", f"<p>{line}</p>" if line else "", *parts]
    pieces.append(f"<p>Warnings</p><ul>{warning_items}</ul>" if warning_items else "")
    return f"<div>{''.join(pieces)}</div>"


def rows_table(rows: Sequence[Mapping[str, object]]) -> str:
    """Rows of equal keys as an HTML table; empty for no row."""
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
    """A pandas table as HTML, its first and last rows where there are many."""
    return str(frame.to_html(max_rows=MAX_ROWS, show_dimensions=True))


def cell_text(value: object) -> str:
    """A value in a cell: numbers to four digits, nothing where a number is undefined."""
    if isinstance(value, bool) or not isinstance(value, float):
        return str(value)
    return "" if math.isnan(value) else f"{value:.4g}"
