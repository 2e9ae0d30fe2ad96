"""Validation of arguments of the Python API.

Each function returns the validated value, or raises BadInputError with one sentence that names the
argument, the value received and what is needed.
"""

from __future__ import annotations

import math
import os
import reprlib
from collections.abc import Callable, Collection, Mapping
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import numpy as np

from uqharness.errors import BadInputError

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 80


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
        received = str(value) if isinstance(value, Real) else _SHORT.repr(value)
        raise BadInputError(f"{name} = {received}: {needed} is needed")


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


def workers(value: object) -> int | None:
    """Return a number of worker processes; None leaves the choice to the function."""
    return None if value is None else integer("workers", value, 1)


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


def share(name: str, value: object) -> float:
    """Return a confidence level, between 0 and 1 exclusive."""
    return number(
        name, value, "a number between 0 and 1, such as 0.95,", lambda given: 0.0 < given < 1.0
    )


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


def one_of(name: str, value: Any, allowed: Collection[Any]) -> Any:
    """Return the value if it is one of ``allowed``."""
    if not (isinstance(value, str | int) and value in allowed):
        raise BadInputError(
            f"{name} = {_SHORT.repr(value)}: allowed are {', '.join(map(str, allowed))}"
        )
    return value


def properties(value: object) -> dict[str, float]:
    """Return JSBSim properties and their values; None gives an empty dictionary."""
    settings = (
        {}
        if value is None
        else instance("properties", value, Mapping, 'a mapping such as {"aero/Cm_q": -10.0}')
    )
    return {str(name): number(f"properties: {name}", setting) for name, setting in settings.items()}
