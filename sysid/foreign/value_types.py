"""Does a value have the type that an annotation asks for?"""

from __future__ import annotations

import types
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence, Set
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

import numpy as np

_NUMBERS: dict[Any, tuple[type, ...]] = {
    float: (float, int, np.floating, np.integer),
    int: (int, np.integer),
    bool: (bool, np.bool_),
    complex: (complex, float, int, np.number),
}
_SEQUENCES = (list, tuple, Sequence, Collection, Iterable, set, frozenset, Set)
_MAPPINGS = (dict, Mapping, types.MappingProxyType)


def fits(value: Any, hint: Any) -> bool:
    """Whether the value is what the annotation says, items and all; an int serves as a float, a list as a tuple.

    Values of other classes count by their class alone. A callable is no data and fits nothing.
    """
    if hint is Any or hint is object or isinstance(hint, TypeVar):
        return True
    if hint is None or hint is type(None):
        return value is None
    origin, args = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return any(fits(value, arg) for arg in args)
    if origin is Literal:
        return any(type(value) is type(arg) and value == arg for arg in args)
    kind = origin or hint
    if kind in (Callable, Iterator):
        return False
    if kind is np.ndarray:
        return isinstance(value, np.ndarray)
    if kind in _NUMBERS:
        return isinstance(value, _NUMBERS[kind])
    if kind in _MAPPINGS:
        return isinstance(value, Mapping) and _mapping_fits(value, args)
    if kind in _SEQUENCES:
        return isinstance(value, list | tuple | set | frozenset) and _items_fit(value, kind, args)
    return isinstance(kind, type) and not _is_protocol(kind) and isinstance(value, kind)


def _mapping_fits(value: Mapping[Any, Any], args: tuple[Any, ...]) -> bool:
    if not args:
        return True
    key, item = args
    return all(fits(k, key) and fits(v, item) for k, v in value.items())


def _items_fit(value: Collection[Any], kind: Any, args: tuple[Any, ...]) -> bool:
    if (kind in (set, frozenset, Set)) != isinstance(value, set | frozenset) and kind not in (
        Collection,
        Iterable,
    ):
        return False
    if kind is tuple and not (len(args) == 2 and args[1] is Ellipsis):
        # A plain tuple is any; one with types listed has one item for each.
        return not args or (len(value) == len(args) and all(map(fits, value, args)))
    return not args or all(fits(item, args[0]) for item in value)


def _is_protocol(kind: type) -> bool:
    """Whether it says what methods a value has: data has none."""
    return bool(getattr(kind, "_is_protocol", False))
