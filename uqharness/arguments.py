"""Arguments of functions in Python: refused by name, with what was given and what is needed, in one
sentence.
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
    """Raise BadInputError unless the value of the argument ``name`` ``fits``; ``needed`` says what
    does, as "a path".
    """
    if not fits:
        received = str(value) if isinstance(value, Real) else _SHORT.repr(value)
        raise BadInputError(f"{name} = {received}: {needed} is needed")


def instance(name: str, value: Any, kind: type, needed: str) -> Any:
    """The value, which is of that kind. Raises BadInputError, as all functions here do."""
    require(name, value, isinstance(value, kind), needed)
    return value


def integer(name: str, value: Any, minimum: int = 0) -> int:
    """A whole number, numpy's too; True and False are none."""
    fits = isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= minimum
    require(name, value, fits, f"a whole number of at least {minimum}")
    return int(value)


def workers(value: object) -> int | None:
    """A number of processes, None for the function's own choice."""
    return None if value is None else integer("workers", value, 1)


def number(
    name: str,
    value: Any,
    needed: str = "a finite number",
    fits: Callable[[float], bool] = math.isfinite,
) -> float:
    """A number, numpy's too; True and False are none.

    NaN and infinity must fit what is asked for.
    """
    real = isinstance(value, Real) and not isinstance(value, bool)
    require(name, value, real and fits(float(value)), needed)
    return float(value)


def share(name: str, value: object) -> float:
    """A confidence: between 0 and 1, neither of them."""
    return number(
        name, value, "a number between 0 and 1, such as 0.95,", lambda given: 0.0 < given < 1.0
    )


def flag(name: str, value: object) -> bool:
    """True or False, numpy's too."""
    require(name, value, isinstance(value, bool | np.bool_), "True or False")
    return bool(value)


def path(name: str, value: Any) -> Path:
    """A path, given as a text that is not empty or as any path."""
    require(
        name,
        value,
        isinstance(value, str | os.PathLike) and bool(os.fspath(value)),
        "a path, as a str or a Path,",
    )
    return Path(value)


def one_of(name: str, value: Any, allowed: Collection[Any]) -> Any:
    """The value, which is one of those."""
    if not (isinstance(value, str | int) and value in allowed):
        raise BadInputError(
            f"{name} = {_SHORT.repr(value)}: allowed are {', '.join(map(str, allowed))}"
        )
    return value


def properties(value: object) -> dict[str, float]:
    """JSBSim properties and what they are set to; None for none."""
    settings = (
        {}
        if value is None
        else instance("properties", value, Mapping, 'a mapping such as {"aero/Cm_q": -10.0}')
    )
    return {str(name): number(f"properties: {name}", setting) for name, setting in settings.items()}
