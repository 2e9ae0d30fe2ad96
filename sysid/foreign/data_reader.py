"""The nodes of a data file's header made into values. Nothing is run, and nothing grows beyond what the file holds."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from sysid.errors import in_a_line
from sysid.foreign.data_classes import find_class
from sysid.foreign.data_dtypes import dtype_from
from sysid.foreign.data_limits import MALFORMED, DataFileError, Sizes

# Keys of one hash are compared one by one.
_ALIKE_HASHES = 64


class Reader:
    """Values by the numbers of their nodes; ``buffers`` are the bytes behind the header, each of one node."""

    def __init__(self, classes: Any, buffers: list[memoryview]) -> None:
        self._classes = [find_class(name, fields) for name, fields in classes]
        self._buffers: list[memoryview | None] = list(buffers)
        self._sizes = Sizes()
        self._values: list[Any] = []

    def values(self, nodes: Any) -> Any:
        """The last of the values, which all others belong to."""
        for number, (kind, *content) in enumerate(nodes):
            try:
                value, children = _READERS[kind](self, *content)
            except MALFORMED as error:
                raise DataFileError(f"malformed: value {number}: {in_a_line(error)}") from None
            self._sizes.note(children)
            self._values.append(value)
        return self._values[-1]

    def _at(self, numbers: Any) -> list[Any]:
        if type(numbers) is not list or not all(
            type(n) is int and 0 <= n < len(self._values) for n in numbers
        ):
            raise ValueError("it refers to values that do not come before it")
        return [self._values[n] for n in numbers]

    def _keys(self, numbers: Any) -> list[Any]:
        found = self._at(numbers)
        self._sizes.check_keys(numbers)
        hashes = sorted(hash(key) for key in found)
        if any(a == b for a, b in zip(hashes, hashes[_ALIKE_HASHES:], strict=False)):
            raise ValueError("its keys would take long to tell apart")
        return found

    def _none(self) -> tuple[Any, Sequence[int]]:
        return None, ()

    def _bool(self, value: Any) -> tuple[Any, Sequence[int]]:
        return _of(bool, value), ()

    def _int(self, value: Any) -> tuple[Any, Sequence[int]]:
        return (int(value, 16) if type(value) is str else _of(int, value)), ()

    def _float(self, value: Any) -> tuple[Any, Sequence[int]]:
        return (
            struct.unpack(">d", bytes.fromhex(value))[0]
            if type(value) is str
            else _of(float, value)
        ), ()

    def _str(self, value: Any) -> tuple[Any, Sequence[int]]:
        return _untext(value), ()

    def _path(self, value: Any) -> tuple[Any, Sequence[int]]:
        return Path(_untext(value)), ()

    def _bytes(self, number: Any) -> tuple[Any, Sequence[int]]:
        return bytes(self._buffer(number)), ()

    def _list(self, numbers: Any) -> tuple[Any, Sequence[int]]:
        return self._at(numbers), numbers

    def _tuple(self, numbers: Any) -> tuple[Any, Sequence[int]]:
        return tuple(self._at(numbers)), numbers

    def _slice(self, numbers: Any) -> tuple[Any, Sequence[int]]:
        start, stop, step = self._at(numbers)
        return slice(start, stop, step), numbers

    def _set(self, numbers: Any) -> tuple[Any, Sequence[int]]:
        return _all_of(set(self._keys(numbers)), numbers), numbers

    def _frozenset(self, numbers: Any) -> tuple[Any, Sequence[int]]:
        return _all_of(frozenset(self._keys(numbers)), numbers), numbers

    def _dict(self, keys: Any, values: Any) -> tuple[Any, Sequence[int]]:
        found = dict(zip(self._keys(keys), self._at(values), strict=True))
        return _all_of(found, keys), keys + values

    def _mappingproxy(self, keys: Any, values: Any) -> tuple[Any, Sequence[int]]:
        found, children = self._dict(keys, values)
        return MappingProxyType(found), children

    def _scalar(self, dtype: Any, value: Any) -> tuple[Any, Sequence[int]]:
        kind, content = dtype_from(dtype), bytes.fromhex(value)
        if len(content) != kind.itemsize:
            raise ValueError("a scalar's bytes are not those of its type")
        return np.ndarray((), kind, content or b"\0")[()], ()

    def _object(self, number: Any, numbers: Any) -> tuple[Any, Sequence[int]]:
        if type(number) is not int or number < 0:
            raise ValueError("it has no class")
        own, values = self._classes[number], self._at(numbers)
        self._sizes.look_at(numbers)
        wrong = own.misfit(values)
        if wrong:
            raise ValueError(wrong)
        return own.made(values), numbers

    def _array(
        self, shape: Any, order: Any, writeable: Any, dtype: Any, number: Any
    ) -> tuple[Any, Sequence[int]]:
        kind, content = dtype_from(dtype), self._buffer(number)
        if _count(shape) * kind.itemsize != len(content) or (kind.itemsize == 0 and _count(shape)):
            raise ValueError("an array's bytes are not those of its shape and type")
        flat = np.frombuffer(content, np.uint8).view(kind) if len(content) else np.empty(0, kind)
        # Copied, as it lies in the file at any address: sums of unaligned numbers are slower and may differ in the last digit.
        return _shaped(flat.copy(), shape, order, writeable), ()

    def _texts(
        self, shape: Any, order: Any, writeable: Any, lengths: Any, joined: Any
    ) -> tuple[Any, Sequence[int]]:
        sizes, content = np.frombuffer(self._buffer(lengths), "<i8"), self._buffer(joined)
        if (
            _count(shape) != len(sizes)
            or (sizes < -1).any()
            or int(np.maximum(sizes, 0).sum()) != len(content)
        ):
            raise ValueError("an array's texts are not as long as it says")
        flat = np.empty(len(sizes), dtype=object)
        # Labels repeat: the same text is one object.
        known: dict[bytes, str] = {}
        begin = 0
        for i, size in enumerate(sizes.tolist()):
            if size >= 0:
                raw = bytes(content[begin : begin + size])
                text = known.get(raw)
                flat[i] = (
                    known.setdefault(raw, raw.decode("utf-8", "surrogatepass"))
                    if text is None
                    else text
                )
                begin += size
        return _shaped(flat, shape, order, writeable), ()

    def _objects(
        self, shape: Any, order: Any, writeable: Any, numbers: Any
    ) -> tuple[Any, Sequence[int]]:
        values = self._at(numbers)
        if _count(shape) != len(values):
            raise ValueError("an array has not as many values as its shape says")
        flat = np.empty(len(values), dtype=object)
        for i, value in enumerate(values):
            flat[i] = value
        return _shaped(flat, shape, order, writeable), numbers

    def _buffer(self, number: Any) -> memoryview:
        found = self._buffers[number] if type(number) is int and number >= 0 else None
        if found is None:
            raise ValueError("it has no buffer, or that of another value")
        # Copies of one by many values would fill the memory.
        self._buffers[number] = None
        return found


_READERS: dict[str, Callable[..., tuple[Any, Sequence[int]]]] = {
    "none": Reader._none,
    "bool": Reader._bool,
    "int": Reader._int,
    "float": Reader._float,
    "str": Reader._str,
    "path": Reader._path,
    "bytes": Reader._bytes,
    "list": Reader._list,
    "tuple": Reader._tuple,
    "slice": Reader._slice,
    "set": Reader._set,
    "frozenset": Reader._frozenset,
    "dict": Reader._dict,
    "mappingproxy": Reader._mappingproxy,
    "scalar": Reader._scalar,
    "object": Reader._object,
    "array": Reader._array,
    "texts": Reader._texts,
    "objects": Reader._objects,
}


def _of(kind: type, value: Any) -> Any:
    if type(value) is not kind:
        raise TypeError(f"a {kind.__name__} is written as a {type(value).__name__}")
    return value


def _untext(value: Any) -> str:
    if type(value) is list:
        (value,) = value
        return bytes.fromhex(value).decode("utf-8", "surrogatepass")
    found: str = _of(str, value)
    return found


def _all_of(found: Any, numbers: Any) -> Any:
    if len(found) != len(numbers):
        raise ValueError("two of its keys are equal")
    return found


def _count(shape: Any) -> int:
    """Items of an array of this shape."""
    if (
        type(shape) is not list
        or len(shape) > 32
        or not all(type(n) is int and 0 <= n < 2**48 for n in shape)
    ):
        raise ValueError("an array has no shape")
    count = 1
    for n in shape:
        count *= n
    return count


def _shaped(flat: Any, shape: Any, order: Any, writeable: Any) -> Any:
    if order not in ("C", "F"):
        raise ValueError("an array has no order")
    found = flat.reshape(shape, order=order)
    found.flags.writeable = _of(bool, writeable)
    return found
