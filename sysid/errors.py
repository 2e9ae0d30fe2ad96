"""Errors and findings about flight logs.

`LogError` ends a command: the log, map or card cannot be used. A `Finding` is a property of a log
that the user must know; it is stored in the record's metadata and does not end anything.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

MAX_LINE_CHARACTERS = 1000
"""Characters of one line of an error message. Messages quote files, and a file may hold a word of
a megabyte.
"""


MAX_LINES = 40
"""Lines of an error message that lists mistakes."""


def shortened(text: str) -> str:
    """Return ``text`` with the middle of long lines left out and the lines after MAX_LINES
    counted.
    """
    if len(text) <= MAX_LINE_CHARACTERS:
        return text
    head, tail = MAX_LINE_CHARACTERS * 3 // 4, MAX_LINE_CHARACTERS // 5
    lines = text.split("\n")
    if len(lines) > MAX_LINES:
        lines[MAX_LINES - 1 :] = [f"and {len(lines) - MAX_LINES + 1} more"]
    return "\n".join(
        x if len(x) <= MAX_LINE_CHARACTERS else f"{x[:head]} [...] {x[-tail:]}" for x in lines
    )


def one_line(error: BaseException) -> str:
    r"""Return the message of an error on one line of at most 200 characters; its class name if
    empty.

    Examples
    --------
    >>> one_line(ValueError("two\nlines")), one_line(KeyError())
    ('two lines', 'KeyError')
    """
    return " ".join(str(error).split())[:200] or type(error).__name__


class LogError(ValueError):
    """A log, signal map or card that cannot be used.

    The message says what was received, what is allowed and what to do.
    """

    def __init__(
        self, message: str, path: Path | str | None = None, where: str | None = None
    ) -> None:
        """Prefix ``message`` with ``path`` (a file) and ``where`` ("line 12")."""
        prefix = "" if path is None else f"{path}: "
        place = "" if where is None else f"{where}: "
        # Quoted content may hold line ends; the message stays on one line.
        super().__init__(shortened(" ".join((prefix + place + message).split("\n"))))


@dataclass(frozen=True)
class Finding:
    """A property of a log that the user must know.

    Attributes
    ----------
    code : str
        Stable key, such as "sample-and-hold".
    channel : str
        Signal or message that it concerns; "" for the whole log.
    severity : str
        "info" (know it), "warning" (look at it) or "error" (do not use this channel for that).
    message : str
        One sentence with the figures in it.
    numbers : mapping
        The same figures by name.
    spoils : str
        Results that would be wrong; "" if none.
    mend : str
        Lines of a signal map that correct it; "" if a map cannot.
    """

    code: str
    channel: str
    severity: str
    message: str
    numbers: Mapping[str, float] = field(default_factory=dict)
    spoils: str = ""
    mend: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return a dictionary for JSON, with None for figures that are not finite."""
        numbers = {k: (float(v) if math.isfinite(v) else None) for k, v in self.numbers.items()}
        return {
            "code": self.code,
            "channel": self.channel,
            "severity": self.severity,
            "message": self.message,
            "numbers": numbers,
            "spoils": self.spoils,
            "mend": self.mend,
        }


def finding_from_dict(data: Mapping[str, Any]) -> Finding:
    """Return the finding that `Finding.as_dict` wrote; None becomes NaN."""
    numbers = {
        str(k): (math.nan if v is None else float(v))
        for k, v in dict(data.get("numbers", {})).items()
    }
    code, channel, severity, message = (
        str(data[key]) for key in ("code", "channel", "severity", "message")
    )
    return Finding(
        code,
        channel,
        severity,
        message,
        numbers,
        str(data.get("spoils", "")),
        str(data.get("mend", "")),
    )
