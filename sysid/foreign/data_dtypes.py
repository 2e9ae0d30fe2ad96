"""Types of array items as plain lists of text, and back."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

_PLAIN = re.compile(r"[<>|][biufcmMSUV][0-9]{0,9}(\[[0-9]{0,9}[a-zA-Zμ]{1,2}\])?")
_DEEPEST = 8


def described(dtype: np.dtype[Any]) -> Any:
    """A dtype as text or, if it has fields, lists of text. Raises ValueError for what has no such description."""
    if dtype.kind not in "biufcmMSUV" or dtype.metadata is not None:
        raise ValueError(f"items of the type {dtype}")
    found = _listed(np.lib.format.dtype_to_descr(dtype))
    try:
        same = dtype_from(found) == dtype
    except ValueError:
        same = False
    if not same:
        raise ValueError(f"items of the type {dtype}")
    return found


def dtype_from(description: Any) -> np.dtype[Any]:
    """The dtype that `described` wrote. Raises ValueError or TypeError."""
    found: np.dtype[Any] = np.lib.format.descr_to_dtype(_checked(description, 0))
    if found.hasobject or found.subdtype is not None:
        raise ValueError("an array's items are not plain")
    return found


def _listed(description: Any) -> Any:
    return (
        [_listed(item) for item in description]
        if isinstance(description, list | tuple)
        else description
    )


def _checked(description: Any, depth: int) -> Any:
    """The same with tuples where numpy wants them; only texts that name one plain type ever reach numpy."""
    if isinstance(description, str):
        if not _PLAIN.fullmatch(description):
            raise ValueError(f"no type of items: {description[:40]!r}")
        return description
    if depth > _DEEPEST:
        raise ValueError("types of items are nested too deep")
    fields = []
    for name, kind, *shape in description:
        if not isinstance(name, str) or not all(
            type(n) is int and n > 0 for part in shape for n in part
        ):
            raise ValueError("a field of an array's items has no name or no shape")
        fields.append((name, _checked(kind, depth + 1), *(tuple(part) for part in shape)))
    return fields
