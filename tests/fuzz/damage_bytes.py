"""Damage that knows nothing of a format: what disks, networks and editors without mercy do to
bytes.
"""

from __future__ import annotations

import numpy as np

from tests.fuzz.hostile import WORDS, pick

_HEADER = 2048
_INTEGERS = WORDS["integers"]


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """``data`` with one to three injuries; never longer than three times itself."""
    for _ in range(int(rng.integers(1, 4))):
        if not data:
            return data
        data = pick(_KINDS, rng)(data, rng)
    return data


def _stretch(data: bytes, rng: np.random.Generator) -> tuple[int, int]:
    a = int(rng.integers(0, len(data)))
    return a, min(len(data), a + int(rng.integers(1, max(2, len(data) // 10))))


def _cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: int(rng.integers(0, len(data)))]


def _flips_in(data: bytes, rng: np.random.Generator, span: int) -> bytes:
    out = bytearray(data)
    for place in rng.integers(0, max(1, span), int(rng.integers(1, 40))):
        out[int(place)] ^= 1 << int(rng.integers(0, 8))
    return bytes(out)


def _flips(data: bytes, rng: np.random.Generator) -> bytes:
    return _flips_in(data, rng, len(data))


def _flips_in_header(data: bytes, rng: np.random.Generator) -> bytes:
    # Headers steer a reader more than payload does.
    return _flips_in(data, rng, min(len(data), _HEADER))


def _one_flip(data: bytes, rng: np.random.Generator) -> bytes:
    out = bytearray(data)
    out[int(rng.integers(0, len(data)))] ^= 1 << int(rng.integers(0, 8))
    return bytes(out)


def _flips_in_footer(data: bytes, rng: np.random.Generator) -> bytes:
    # Parquet and ZIP keep their tables of contents at the end.
    span = min(len(data), _HEADER)
    return data[: len(data) - span] + _flips_in(data[len(data) - span :], rng, span)


def _zeros(data: bytes, rng: np.random.Generator) -> bytes:
    a, b = _stretch(data, rng)
    return data[:a] + bytes(b - a) + data[b:]


def _noise(data: bytes, rng: np.random.Generator) -> bytes:
    a, b = _stretch(data, rng)
    return data[:a] + rng.bytes(b - a) + data[b:]


def _twice(data: bytes, rng: np.random.Generator) -> bytes:
    a, b = _stretch(data, rng)
    return data[:b] + data[a:b] + data[b:]


def _removed(data: bytes, rng: np.random.Generator) -> bytes:
    a, b = _stretch(data, rng)
    return data[:a] + data[b:]


def _swapped(data: bytes, rng: np.random.Generator) -> bytes:
    (a, b), (c, d) = sorted((_stretch(data, rng), _stretch(data, rng)))
    if b > c:
        return _twice(data, rng)
    return data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


def _integer(data: bytes, rng: np.random.Generator) -> bytes:
    size = int(rng.choice([1, 2, 4, 8]))
    value = pick(_INTEGERS, rng) % 2 ** (8 * size)
    span = len(data) if rng.random() < 0.5 else min(len(data), _HEADER)
    a = int(rng.integers(0, max(1, span)))
    order = "little" if rng.random() < 0.8 else "big"
    return (data[:a] + value.to_bytes(size, order) + data[a + size :])[: max(len(data), a + size)]


def _appended(data: bytes, rng: np.random.Generator) -> bytes:
    return data + (rng.bytes(int(rng.integers(1, 300))) if rng.random() < 0.5 else data)


_KINDS = (
    *(_cut, _flips, _flips_in_header, _flips_in_footer, _one_flip, _one_flip, _zeros),
    *(_noise, _twice, _removed, _swapped, _integer, _integer, _appended),
)
