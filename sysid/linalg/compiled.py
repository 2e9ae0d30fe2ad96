"""Loops that numba compiles, and keeps compiled beside their source."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit
from numba.extending import register_jitable

Loop = Callable[..., Any]


def compiled(loop: Loop) -> Loop:
    """The loop, compiled when it is first called with such arguments.

    A division by zero gives what numpy's gives. The machine code is kept for the next process in the source's ``__pycache__``, or
    in the user's cache where that cannot be written; where neither can, every process compiles anew.
    """
    try:
        kept: Loop = njit(cache=True, nogil=True, error_model="numpy")(loop)
    except RuntimeError:
        kept = njit(nogil=True, error_model="numpy")(loop)
    return kept


def within(part: Loop) -> Loop:
    """The part, which compiled loops of the same file may call and Python as well: for other files' the code that is kept would not
    be renewed when they change."""
    known: Loop = register_jitable(part)
    return known
