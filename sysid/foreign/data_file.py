"""Results as bytes and back, exactly, without running what the bytes say: for files and pipes that others may have written to.

A file is: 8 bytes of magic and version, the SHA-256 of all that follows, the length of the header (8 bytes, little-endian), the
header in JSON, then raw buffers, each beginning at a multiple of 64 bytes from the end of the header. The header lists every value
as a node that refers to earlier nodes by number, so that reading neither recurses nor copies what is shared. Only plain values,
numpy arrays and the dataclasses of this project's own packages can be written or read.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterable
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from sysid.digests import sha256_of_parts
from sysid.errors import in_a_line
from sysid.foreign.data_classes import OwnClass, own_class
from sysid.foreign.data_dtypes import described
from sysid.foreign.data_limits import DEEPEST, MALFORMED, DataFileError, Sizes
from sysid.foreign.data_reader import Reader
from sysid.foreign.value_types import fits

MAGIC = b"UQDATA\x00\x01"
"""The last byte is the version of the format."""
HEADER_MOST = 16 * 1024 * 1024
"""Bytes of JSON that a file may begin with; parsed they take up to 30 times as many."""
_DIGEST = 32
_ALIGNMENT = 64


def dump(value: Any) -> bytes:
    """The value as bytes.

    None, bool, int, float (every bit of it), str, bytes, list, tuple, dict, set, frozenset, slice, mapping proxy, Path, numpy
    scalars and arrays, and dataclasses of ``sysid`` and ``uqharness``. What is met twice is written once. Raises
    DataFileError for anything else, for a value inside itself, and for one of more than HEADER_MOST bytes beside its arrays.
    """
    return b"".join(dump_parts(value))


def dump_parts(value: Any) -> list[bytes | memoryview]:
    """The same bytes in parts, one after the other: arrays are not copied."""
    writer = _Writer()
    writer.add(value)
    return writer.parts()


def load(data: bytes, kind: Any = Any) -> Any:
    """The value that `dump` wrote, equal to it bit for bit, with the same parts shared; an array is read-only if it was.

    A read-only array is a view of ``data``. Dataclasses are restored without their ``__init__`` and ``__post_init__``: the fields
    are what those had left, and no code runs on values that nobody looked at yet. The type of every field is held against its
    annotation, and the whole against ``kind``. Raises DataFileError.
    """
    begin = len(MAGIC) + _DIGEST
    if len(data) < begin + 8 or data[: len(MAGIC)] != MAGIC:
        raise DataFileError("not a data file of this version of the program")
    content = memoryview(data)[begin:]
    if bytes.fromhex(sha256_of_parts([content])) != data[len(MAGIC) : begin]:
        raise DataFileError("damaged: its content is not what its digest says")
    length = int.from_bytes(content[:8], "little")
    if length > min(HEADER_MOST, len(content) - 8):
        raise DataFileError("malformed: its header is longer than allowed")
    try:
        header = json.loads(bytes(content[8 : 8 + length]))
        found = Reader(
            header["classes"], _buffers(header["buffers"], content[8 + length :])
        ).values(header["nodes"])
    except DataFileError:
        raise
    except MALFORMED as error:
        raise DataFileError(f"malformed: {in_a_line(error)}") from None
    if not fits(found, kind):
        raise DataFileError(f"it holds a {type(found).__name__} that is not what is asked for")
    return found


def _padding(length: int) -> int:
    return -length % _ALIGNMENT


def _buffers(lengths: Any, content: memoryview) -> list[memoryview]:
    found, begin = [], 0
    for length in lengths:
        if type(length) is not int or length < 0:
            raise ValueError("a buffer has no length")
        found.append(content[begin : begin + length])
        begin += length + _padding(length)
    if begin != len(content):
        raise ValueError("the buffers do not fill the file")
    return found


class _Writer:
    def __init__(self) -> None:
        self._nodes: list[str] = []
        self._classes: dict[type, int] = {}
        self._class_nodes: list[list[Any]] = []
        self._buffers: list[Any] = []
        self._sizes = Sizes()
        # The values are held here too, for the number of one that is gone may be another's.
        self._known: dict[Any, tuple[int, Any]] = {}
        self._trail: list[str] = []

    def parts(self) -> list[bytes | memoryview]:
        lengths = [len(buffer) for buffer in self._buffers]
        header = (
            f'{{"classes":{_json(self._class_nodes)},"buffers":{_json(lengths)},"nodes":[{",".join(self._nodes)}]}}'
        ).encode()
        if len(header) > HEADER_MOST:
            raise DataFileError(
                f"the value takes {len(header)} bytes beside its arrays; a data file allows {HEADER_MOST}"
            )
        parts = [len(header).to_bytes(8, "little"), header]
        for buffer in self._buffers:
            parts += [buffer, bytes(_padding(len(buffer)))]
        return [MAGIC, bytes.fromhex(sha256_of_parts(parts)), *parts]

    def add(self, value: Any) -> int:
        """The value's number, its own node written if there is none yet."""
        key = _identity(value)
        if key in self._known:
            return self._known[key][0]
        if len(self._trail) > DEEPEST:
            raise DataFileError(
                f"values are nested more than {DEEPEST} deep, or one is inside itself"
            )
        node, children = self._node(value)
        self._sizes.note(children)
        self._nodes.append(_json(node))
        number = len(self._nodes) - 1
        self._known[key] = number, value
        return number

    def _node(self, value: Any) -> tuple[list[Any], list[int]]:
        kind: Any = type(value)
        if kind in _SCALARS:
            return [kind.__name__, _SCALARS[kind](value)], []
        if value is None:
            return ["none"], []
        if kind is bytes:
            return ["bytes", self._buffer(value)], []
        if kind in (list, tuple, set, frozenset):
            items = self._all(enumerate(value))
            if kind in (set, frozenset):
                self._sizes.check_keys(items)
            return [kind.__name__, items], items
        if kind in (dict, MappingProxyType):
            keys = self._all(("key", key) for key in value)
            self._sizes.check_keys(keys)
            values = self._all(value.items())
            return ["dict" if kind is dict else "mappingproxy", keys, values], keys + values
        if kind is slice:
            items = self._all((name, getattr(value, name)) for name in ("start", "stop", "step"))
            return ["slice", items], items
        if isinstance(value, Path):
            return ["path", _text(str(value))], []
        if kind is np.ndarray:
            return self._array(value)
        if isinstance(value, np.generic):
            alone = np.asarray(value)
            return ["scalar", self._dtype(alone.dtype), alone.tobytes().hex()], []
        own = own_class(kind)
        if own is None:
            raise DataFileError(
                f"a data file cannot hold a {kind.__module__}.{kind.__qualname__}{self._place()}"
            )
        return self._object(own, value)

    def _object(self, own: OwnClass, value: Any) -> tuple[list[Any], list[int]]:
        if own.kind not in self._classes:
            self._classes[own.kind] = len(self._class_nodes)
            self._class_nodes.append([own.name, list(own.fields)])
        values = own.values(value)
        wrong = own.misfit(values)
        if wrong:
            raise DataFileError(f"{wrong}{self._place()}")
        items = self._all(zip(own.fields, values, strict=True))
        self._sizes.look_at(items)
        return ["object", self._classes[own.kind], items], items

    def _array(self, value: np.ndarray) -> tuple[list[Any], list[int]]:
        order = "F" if value.flags.f_contiguous and not value.flags.c_contiguous else "C"
        flat = value.reshape(-1, order=order)  # type: ignore[call-overload]
        about = [list(value.shape), order, value.flags.writeable]
        if not value.dtype.hasobject:
            dtype = self._dtype(value.dtype)
            if value.dtype.itemsize == 0 and value.size:
                raise DataFileError(
                    f"a data file cannot hold an array of items without bytes{self._place()}"
                )
            # Not all types offer their memory as it is; bytes do.
            raw = np.ascontiguousarray(flat).view(np.uint8).data if value.size else b""
            return ["array", *about, dtype, self._buffer(raw)], []
        if value.dtype != object:
            raise DataFileError(f"a data file cannot hold an array of {value.dtype}{self._place()}")
        if all(item is None or type(item) is str for item in flat):
            texts = [None if item is None else _encoded(item) for item in flat]
            lengths = np.array([-1 if text is None else len(text) for text in texts], dtype="<i8")
            joined = b"".join(text for text in texts if text)
            return ["texts", *about, self._buffer(lengths.tobytes()), self._buffer(joined)], []
        items = self._all(enumerate(flat))
        return ["objects", *about, items], items

    def _dtype(self, dtype: np.dtype[Any]) -> Any:
        try:
            return described(dtype)
        except ValueError as error:
            raise DataFileError(f"a data file cannot hold {error}{self._place()}") from None

    def _buffer(self, content: Any) -> int:
        self._buffers.append(content)
        return len(self._buffers) - 1

    def _all(self, values: Iterable[tuple[Any, Any]]) -> list[int]:
        found = []
        for name, value in values:
            self._trail.append(str(name))
            found.append(self.add(value))
            self._trail.pop()
        return found

    def _place(self) -> str:
        return f", at {'.'.join(self._trail)}" if self._trail else ""


def _json(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def _identity(value: Any) -> Any:
    """Equal for what may be one node: the same object, or plain values that nothing can tell apart."""
    # NaN is not equal to itself: two of them may be keys of one dictionary.
    if type(value) is float and value == value:
        return float, struct.pack("<d", value)
    if type(value) in (bool, int, str):
        return type(value), value
    return id(value)


def _encoded(text: str) -> bytes:
    # File names may carry bytes that are no UTF-8, as lone surrogates.
    return text.encode("utf-8", "surrogatepass")


def _text(text: str) -> Any:
    """As it is, or its bytes in hex where JSON would not give it back."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return [_encoded(text).hex()]
    return text


def _number(value: int) -> Any:
    # Decimal digits take quadratic time.
    return value if abs(value) < 2**63 else hex(value)


def _real(value: float) -> Any:
    # NaN carries bits of its own.
    return value if np.isfinite(value) else struct.pack(">d", value).hex()


_SCALARS: dict[type, Callable[[Any], Any]] = {bool: bool, int: _number, float: _real, str: _text}
