"""Validation of arguments of the Python API.

Each function returns the validated value, or raises BadInputError with one sentence that names the
argument, the value received and what is needed.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import numpy as np

from uqharness.errors import BadInputError
from uqharness.requests.base import received_text


def require(name: str, value: object, fits: bool, needed: str) -> None:
    """Raise BadInputError unless an argument's value ``fits``.

    Parameters
    ----------
    name : str
        Name of the argument.
    value : object
        Value received; long ones are abbreviated.
    fits : bool
        Whether it is valid.
    needed : str
        What is valid, such as "a path".

    Examples
    --------
    >>> require("dt_s", -1.0, False, "a positive number")
    Traceback (most recent call last):
    uqharness.errors.BadInputError: dt_s = -1.0: a positive number is needed
    """
    if not fits:
        raise BadInputError(f"{name} = {received_text(value)}: {needed} is needed")


def instance(name: str, value: Any, kind: type, needed: str) -> Any:
    """Return the value if it is an instance of ``kind``."""
    require(name, value, isinstance(value, kind), needed)
    return value


def integer(name: str, value: Any, minimum: int = 0) -> int:
    """Return an integer of at least ``minimum``; numpy integers are valid, booleans are not."""
    # bool is a subclass of int.
    fits = isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= minimum
    require(name, value, fits, f"a whole number of at least {minimum}")
    return int(value)


def number(
    name: str,
    value: Any,
    needed: str = "a finite number",
    fits: Callable[[float], bool] = math.isfinite,
) -> float:
    """Return a real number; numpy numbers are valid, booleans are not.

    ``fits`` decides which numbers are valid, NaN and infinity among them.
    """
    # numpy's scalars are registered as Real; booleans are excluded.
    real = isinstance(value, Real) and not isinstance(value, bool)
    require(name, value, real and fits(float(value)), needed)
    return float(value)


def flag(name: str, value: object) -> bool:
    """Return a boolean; numpy booleans are valid."""
    require(name, value, isinstance(value, bool | np.bool_), "True or False")
    return bool(value)


def path(name: str, value: Any) -> Path:
    """Return a path given as a non-empty text or as any path object."""
    require(
        name,
        value,
        isinstance(value, str | os.PathLike) and bool(os.fspath(value)),
        "a path, as a str or a Path,",
    )
    return Path(value)
