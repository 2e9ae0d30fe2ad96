"""Errors a user can act on. The command line prints their text and exits with 2; anything else is a defect of ours."""

from __future__ import annotations


class BadInputError(Exception):
    """Input that cannot be used. The text says what was received, what is allowed, and what to do next."""
