"""Errors that a user can act on.

The command line prints their text and exits with code 2. Any other exception is a defect of this
program.
"""

from __future__ import annotations

from sysid.errors import LogError, shortened

__all__ = ["BadInputError", "EnginesDifferError", "LogError", "TerminatedError"]


class BadInputError(Exception):
    """Input that cannot be used.

    The text says what was received, what is allowed, and what to do next.

    Parameters
    ----------
    *lines : str
        One sentence each; a file may contain several mistakes. Line ends inside a sentence become
        blanks.
    """

    def __init__(self, *lines: str) -> None:
        text = "\n".join(" ".join(line.split("\n")) for line in lines)
        super().__init__(*shortened(text).split("\n"))

    def __str__(self) -> str:
        return "\n".join(self.args)


class EnginesDifferError(Exception):
    """The batch engine and JSBSim disagree on the same case; the campaign is invalid."""


class TerminatedError(KeyboardInterrupt):
    """SIGTERM was received; the process ends as after Ctrl-C."""
