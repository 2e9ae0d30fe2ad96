"""What goes wrong with a log, said once: the error that ends a command and the finding that does not."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


class LogError(ValueError):
    """A log, map or card that cannot be used. Says what was received, what is allowed, what to do next."""

    def __init__(self, message: str, path: Path | str | None = None, where: str | None = None) -> None:
        """Join `path` (file) and `where` ("line 12", "offset 4711") in front of `message`."""
        prefix = "" if path is None else f"{path}: "
        place = "" if where is None else f"{where}: "
        super().__init__(prefix + place + message)


@dataclass(frozen=True)
class Finding:
    """One thing a log says about itself that a user must know.

    code      stable key, e.g. "sample-and-hold"
    channel   signal or message name it concerns, "" for the whole log
    severity  "info" (know it), "warning" (look at it), "error" (do not use this channel for that)
    message   one sentence with the figures in it
    numbers   the same figures for machines
    """

    code: str
    channel: str
    severity: str
    message: str
    numbers: Mapping[str, float] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Plain dictionary for JSON; figures that are not finite become None."""
        numbers = {k: (float(v) if math.isfinite(v) else None) for k, v in self.numbers.items()}
        return {
            "code": self.code,
            "channel": self.channel,
            "severity": self.severity,
            "message": self.message,
            "numbers": numbers,
        }


def finding_from_dict(data: Mapping[str, Any]) -> Finding:
    """Inverse of `Finding.as_dict` (None becomes NaN)."""
    numbers = {str(k): (math.nan if v is None else float(v)) for k, v in dict(data.get("numbers", {})).items()}
    return Finding(str(data["code"]), str(data["channel"]), str(data["severity"]), str(data["message"]), numbers)
