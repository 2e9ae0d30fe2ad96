"""The DataFlash record format: what an FMT record says, as numpy types (for binary reader, text reader and writer)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAGIC = b"\xa3\x95"
FMT_TYPE = 128
FMT_LENGTH = 89

# Format character -> (numpy type, multiplier that turns the stored integer into the field's unit).
CHARACTERS: dict[str, tuple[str, float]] = {
    "a": ("<i2", 1.0),
    "b": ("<i1", 1.0),
    "B": ("<u1", 1.0),
    "h": ("<i2", 1.0),
    "H": ("<u2", 1.0),
    "i": ("<i4", 1.0),
    "I": ("<u4", 1.0),
    "q": ("<i8", 1.0),
    "Q": ("<u8", 1.0),
    "f": ("<f4", 1.0),
    "d": ("<f8", 1.0),
    "g": ("<f2", 1.0),
    "M": ("<u1", 1.0),
    "c": ("<i2", 0.01),
    "C": ("<u2", 0.01),
    "e": ("<i4", 0.01),
    "E": ("<u4", 0.01),
    "L": ("<i4", 1e-7),
    "n": ("S4", 1.0),
    "N": ("S16", 1.0),
    "Z": ("S64", 1.0),
}
INSTANCE_NAMES = ("I", "C", "Instance", "Inst")


@dataclass(frozen=True)
class Format:
    """One FMT record: type number, total length in bytes, name, format characters and column names."""

    type: int
    length: int
    name: str
    characters: str
    columns: tuple[str, ...]

    @property
    def dtype(self) -> np.dtype[Any]:
        """Structured type of the payload (without the three header bytes)."""
        fields: list[Any] = []
        for column, character in zip(self.columns, self.characters, strict=True):
            base = CHARACTERS[character][0]
            fields.append((column, base, (32,)) if character == "a" else (column, base))
        return np.dtype(fields)

    @property
    def instance_column(self) -> str | None:
        """The column that numbers instances of one sensor, by its usual names; None when there is none."""
        for column, character in zip(self.columns, self.characters, strict=True):
            if column in INSTANCE_NAMES and character in "bBhHiI":
                return column
        return None

    @property
    def time_column(self) -> tuple[str, float] | None:
        """(column, seconds per unit) of the time stamp, or None.

        In the GPS message of logs before version 3.4 TimeMS is the GPS time of week; T is the autopilot's clock.
        """
        if self.name.startswith("GPS") and "TimeUS" not in self.columns and "T" in self.columns:
            return "T", 1e-3
        for name, scale in (("TimeUS", 1e-6), ("TimeMS", 1e-3)):
            if name in self.columns:
                return name, scale
        return None


def make_format(kind: int, length: int, name: str, characters: str, columns: str) -> Format | None:
    """Build a Format; None when it contradicts itself (a damaged FMT record must not steer the reader)."""
    names = tuple(columns.split(",")) if columns else ()
    printable = name.isascii() and name.isidentifier() and len(name) <= 4
    if (
        not printable
        or len(names) != len(characters)
        or len(set(names)) != len(names)
        or not all(names)
    ):
        return None
    if any(c not in CHARACTERS for c in characters):
        return None
    made = Format(kind, length, name, characters, names)
    return made if made.dtype.itemsize + 3 == length else None


def scaled(values: NDArray[Any], character: str) -> NDArray[Any]:
    """Field values in the field's unit: multiplied where the format says so, text decoded, the rest unchanged."""
    kind, multiplier = CHARACTERS[character]
    if kind.startswith("S"):
        return np.array(
            [v.split(b"\0", 1)[0].decode("latin-1") for v in values.tolist()], dtype=object
        )
    return values.astype(np.float64) * multiplier if multiplier != 1.0 else values


def text(raw: bytes) -> str:
    """Text of a fixed-length field up to its first NUL."""
    return raw.split(b"\0", 1)[0].decode("latin-1")
