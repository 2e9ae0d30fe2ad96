"""What bounds the values of a data file, whoever wrote it: how deep they are, how many, how long it takes to look at them."""

from __future__ import annotations

import struct
from collections.abc import Iterable

DEEPEST = 100
"""Levels of values inside values."""
# Values may be shared; this many, each counted as often as it is met, is more than any result holds.
_MOST_VALUES = 50_000_000
# A key's hash is computed by every part of it, recursively.
_KEY_PARTS = 1000
# Parts looked at for hashes and for types, each as often as it is.
_MOST_LOOKS = 20_000_000
MALFORMED = (
    ArithmeticError,
    AttributeError,
    ImportError,
    LookupError,
    RecursionError,
    TypeError,
    ValueError,
    struct.error,
)
"""What content that `dump` did not write may raise while it is read."""


class DataFileError(ValueError):
    """Bytes that are no such file, a damaged one, or a value that such a file cannot hold."""


class Sizes:
    """How deep and how large each value is, counted with all inside it."""

    def __init__(self) -> None:
        self.height: list[int] = []
        self.parts: list[int] = []
        self._looks = 0

    def note(self, children: Iterable[int]) -> None:
        """One more value, of these earlier ones."""
        height, parts = 0, 1
        for child in children:
            height = max(height, self.height[child])
            parts += self.parts[child]
        if height >= DEEPEST:
            raise DataFileError(
                f"values are nested more than {DEEPEST} deep, or one is inside itself"
            )
        if parts > _MOST_VALUES:
            raise DataFileError(f"it holds more than {_MOST_VALUES} values")
        self.height.append(height + 1)
        self.parts.append(parts)

    def check_keys(self, keys: Iterable[int]) -> None:
        """Refuse keys whose hashing would take long."""
        keys = list(keys)
        if any(self.parts[key] > _KEY_PARTS for key in keys):
            raise DataFileError(f"a key has more than {_KEY_PARTS} parts")
        self.look_at(keys)

    def look_at(self, values: Iterable[int]) -> None:
        """Count what it takes to go through these once more."""
        self._looks += sum(self.parts[value] for value in values)
        if self._looks > _MOST_LOOKS:
            raise DataFileError(f"looking at its values takes more than {_MOST_LOOKS} steps")
