"""What goes wrong with a log, said once: the error that ends a command and the finding that does
not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

MAX_LINE_CHARACTERS = 1000
"""Of a line of an error: what a file holds is quoted, and a file may hold a word of a megabyte."""


MAX_LINES = 40
"""Of an error that lists mistakes."""


def shortened(text: str) -> str:
    """The text with the middle of every line of more than MOST_CHARACTERS left out, and what comes
    after MOST_LINES counted.
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
    """What went wrong, short and without line ends."""
    return " ".join(str(error).split())[:200] or type(error).__name__


class LogError(ValueError):
    """A log, map or card that cannot be used.

    Says what was received, what is allowed, what to do next.
    """

    def __init__(
        self, message: str, path: Path | str | None = None, where: str | None = None
    ) -> None:
        """Join `path` (file) and `where` ("line 12", "offset 4711") in front of `message`."""
        prefix = "" if path is None else f"{path}: "
        place = "" if where is None else f"{where}: "
        # One line, whatever a file has put into it.
        super().__init__(shortened(" ".join((prefix + place + message).split("\n"))))


@dataclass(frozen=True)
class Finding:
    """One thing a log says about itself that a user must know.

    code      stable key, e.g. "sample-and-hold"
    channel   signal or message name it concerns, "" for the whole log
    severity  "info" (know it), "warning" (look at it), "error" (do not use this channel for that)
    message   one sentence with the figures in it
    numbers   the same figures for machines
    spoils    what would come out wrong, "" where nothing would
    mend      the lines of a signal map that put it right, "" where a map cannot
    """

    code: str
    channel: str
    severity: str
    message: str
    numbers: Mapping[str, float] = field(default_factory=dict)
    spoils: str = ""
    mend: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Plain dictionary for JSON; figures that are not finite become None."""
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
    """Inverse of `Finding.as_dict` (None becomes NaN)."""
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
