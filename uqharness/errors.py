"""Errors a user can act on. The command line prints their text and exits with 2; anything else is a
defect of ours.
"""

from __future__ import annotations

from sysid.errors import shortened


class BadInputError(Exception):
    """Input that cannot be used. The text says what was received, what is allowed, and what to do
    next.

    ``lines`` are one sentence each: a file's mistakes may be several. What a file has put into one
    does not break it in two."""

    def __init__(self, *lines: str) -> None:
        text = "\n".join(" ".join(line.split("\n")) for line in lines)
        super().__init__(*shortened(text).split("\n"))

    def __str__(self) -> str:
        return "\n".join(self.args)


class EnginesDifferError(Exception):
    """The batch engine and JSBSim flew the same case otherwise, so the campaign's results are not
    valid.
    """


class TerminatedError(KeyboardInterrupt):
    """SIGTERM asked this process to end, which it does as after Ctrl-C."""
