"""Values held against annotations."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, Protocol

import numpy as np
import pytest
from numpy.typing import NDArray

from sysid.errors import Finding
from sysid.foreign.typed_files import fits


class Flying(Protocol):
    def fly(self) -> None: ...


class Bird:
    def fly(self) -> None: ...


NOTE = Finding("a", "", "info", "m")
YES = [
    (1, float),
    (np.float64(1), float),
    (np.int64(1), int),
    (True, bool),
    (np.True_, bool),
    (None, None),
    (None, float | None),
    ("a", str),
    ("a", Literal["a", "b"]),
    (print, Any),
    ([1.0], list[float]),
    ((1, "a"), tuple[int, str]),
    ((1, 2, 3), tuple[int, ...]),
    ((), tuple[int, ...]),
    ((1, "a"), tuple),
    ([1], Sequence[int]),
    ({1}, set[int]),
    (frozenset("a"), frozenset[str]),
    ({"a": [1]}, Mapping[str, list[int]]),
    (MappingProxyType({1: 2}), Mapping[int, int]),
    ({}, dict),
    (np.zeros(1), NDArray[Any]),
    (NOTE, Finding),
    ([NOTE], list[Finding]),
    (Path("a"), Path),
    (slice(1), slice),
    ({("a", 1): NOTE}, dict[tuple[str, int], Finding]),
]
NO = [
    ("1", float),
    (1.0, int),
    (1, str),
    (1, bool),
    (0, None),
    ("a", float | None),
    ("c", Literal["a", "b"]),
    (True, Literal[1]),
    (["a"], list[float]),
    ((1,), tuple[int, str]),
    ((1, "a"), tuple[int, ...]),
    ("ab", Sequence[str]),
    ({1}, list[int]),
    ([1], set[int]),
    ({1: [1]}, Mapping[str, list[int]]),
    ({"a": 1}, Mapping[str, list[int]]),
    ([], dict),
    ([1.0], NDArray[Any]),
    ({}, Finding),
    ([None], list[Finding]),
    ("a", Path),
    (print, Callable[..., Any]),
    (iter([]), Iterator[int]),
    (Bird(), Flying),
    ("ab", tuple[str, ...]),
]


@pytest.mark.parametrize(("value", "hint"), YES, ids=range(len(YES)))
def test_what_fits(value, hint):
    assert fits(value, hint)


@pytest.mark.parametrize(("value", "hint"), NO, ids=range(len(NO)))
def test_what_does_not(value, hint):
    assert not fits(value, hint)
