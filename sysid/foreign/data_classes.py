"""The classes whose values a data file may hold: dataclasses and named tuples of this project's own packages."""

from __future__ import annotations

import dataclasses
import importlib
import importlib.util
import re
import typing
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from sysid.foreign.value_types import fits

PACKAGES = ("sysid", "uqharness")
_NAME = re.compile(rf"({'|'.join(PACKAGES)})((?:\.[a-z][a-z0-9_]*)+):([A-Za-z_][A-Za-z0-9_]*)")


@dataclass(frozen=True)
class OwnClass:
    """A class, its name ("module:class"), its fields in order and their annotations."""

    kind: type
    name: str
    fields: tuple[str, ...]
    hints: tuple[Any, ...]

    def values(self, value: Any) -> list[Any]:
        """What the fields hold."""
        return [getattr(value, name) for name in self.fields]

    def misfit(self, values: Sequence[Any]) -> str:
        """Which field's value is not of the type that is annotated, in words; "" if none."""
        if len(values) != len(self.fields):
            return f"{self.name} has {len(self.fields)} fields, not {len(values)}"
        for name, value, hint in zip(self.fields, values, self.hints, strict=True):
            if not fits(value, hint):
                return f"{name} of {self.name} holds a {type(value).__name__} that its annotation does not allow"
        return ""

    def made(self, values: Sequence[Any]) -> Any:
        """An object with these values, of which no code has run."""
        if issubclass(self.kind, tuple):
            return tuple.__new__(self.kind, values)
        given = dict(zip(self.fields, values, strict=True))
        found: Any = object.__new__(self.kind)
        for name, value in given.items():
            object.__setattr__(found, name, value)
        return found


def find_class(name: Any, fields: Any) -> OwnClass:
    """The class of that name with exactly these fields. Only modules of this project are imported. Raises ValueError."""
    parts = _NAME.fullmatch(name) if isinstance(name, str) else None
    if parts is None:
        raise ValueError(f"no class of this program: {str(name)[:80]!r}")
    module = parts[1] + parts[2]
    above = module.rpartition(".")[0]
    # A folder without __init__.py is data, such as the campaigns and what reproduces them.
    if any(
        not _is_package(".".join(above.split(".")[: n + 1])) for n in range(above.count(".") + 1)
    ):
        raise ValueError(f"no class of this program: {name}")
    found = vars(importlib.import_module(module)).get(parts[3])
    own = own_class(found) if isinstance(found, type) else None
    if own is None or own.name != name:
        raise ValueError(f"no class of this program whose values are data: {name}")
    if fields != list(own.fields):
        raise ValueError(f"{name} has other fields in this version of the program")
    return own


def _is_package(name: str) -> bool:
    spec = importlib.util.find_spec(name)
    return (
        spec is not None and spec.origin is not None and spec.submodule_search_locations is not None
    )


@cache
def own_class(kind: type) -> OwnClass | None:
    """What is to be known of a class to store its values; None for any but a dataclass or named tuple of this project."""
    name = f"{kind.__module__}:{kind.__qualname__}"
    if not _NAME.fullmatch(name):
        return None
    # A dataclass that is a list or an error as well holds more than its fields.
    plain = dataclasses.is_dataclass(kind) and kind.__new__ is object.__new__
    if not plain and not _is_named_tuple(kind):
        return None
    try:
        hints = typing.get_type_hints(kind)
    except NameError:
        # Annotated with what is imported for type checkers alone.
        return None
    named: Any = kind
    fields = (
        tuple(field.name for field in dataclasses.fields(named)) if plain else tuple(named._fields)
    )
    return OwnClass(kind, name, fields, tuple(hints[field] for field in fields))


def _is_named_tuple(kind: type) -> bool:
    fields = getattr(kind, "_fields", None)
    return (
        kind.__bases__ == (tuple,)
        and isinstance(fields, tuple)
        and all(name in kind.__annotations__ for name in fields)
    )
