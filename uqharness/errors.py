"""Errors a user can act on. The command line prints their text and exits with 2; anything else is a defect of ours."""

from __future__ import annotations


class BadInputError(Exception):
    """Input that cannot be used. The text says what was received, what is allowed, and what to do next."""


class FlightFailedError(Exception):
    """A flight that started but could not be finished.

    ``status`` is one of the campaign's statuses (``diverged``, ``crashed``, ``timeout``), ``reason`` a sentence.
    """

    def __init__(self, status: str, reason: str) -> None:
        super().__init__(f"{status}: {reason}")
        self.status = status
        self.reason = reason
