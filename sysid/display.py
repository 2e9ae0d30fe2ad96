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
_UNSEEN = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)


def visible(text: str) -> str:
    """The text with every character that a terminal would act on written out."""
    return _UNSEEN.sub(_written_out, text)


def _written_out(match: re.Match[str]) -> str:
    code = ord(match[0])
    # The longer form is also JSON's, which leaves these characters as they are in its strings.
    return f"\\x{code:02x}" if code < 0x20 else f"\\u{code:04x}"


class _Visible:
    """A text stream that writes only what may be seen; in all else the stream it stands for."""

    def __init__(self, stream: TextIO) -> None:
        self.underneath = stream

    def write(self, text: str) -> int:
        """Write; the length of the text as it was given."""
        self.underneath.write(_encodable(visible(text), self.underneath))
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Write one after another."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.underneath, name)

    def __enter__(self) -> _Visible:
        return self

    def __exit__(self, *_: object) -> None:
        self.underneath.flush()

    def __iter__(self) -> Iterator[str]:
        return iter(self.underneath)


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
        if stream is not None and not isinstance(stream, _Visible):
            setattr(sys, name, cast(TextIO, _Visible(stream)))


@contextlib.contextmanager
def clean_terminal() -> Iterator[None]:
    """The same for a block; the streams that were there before come back after it."""
    before = sys.stdout, sys.stderr
    clean_streams()
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def drawing(stream: TextIO) -> TextIO:
    """The stream as it was before: for what moves the cursor itself, with texts that went through
    `visible`.
    """
    return stream.underneath if isinstance(stream, _Visible) else stream


# What a notebook shows of a result: its name, a few facts, a table, warnings, as HTML without
# scripts or styles of its own.
#
# Texts may come from logs and files of others, so that all of them are escaped.

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
