"""Store results as bytes and read them back exactly, without running code from the file.

Files and pipes may have been written by others, so that pickle is not an option. A file is 8 bytes
of magic and version, the SHA-256 of all that follows, the length of the header (8 bytes,
little-endian), the header in JSON, then raw buffers at multiples of 64 bytes from the end of the
header. The header lists every value as a node that refers to earlier nodes by number: reading does
not recurse, and shared values stay shared. Values are plain Python types, numpy arrays, and
dataclasses and named tuples of this project. `dump` and `load` are the interface.
"""

from __future__ import annotations

import dataclasses
import importlib
import importlib.util
import json
import re
import struct
import types
import typing
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

import numpy as np

from sysid.errors import one_line
from sysid.foreign.regular_files import sha256_of_parts

_NUMBERS: dict[Any, tuple[type, ...]] = {
    float: (float, int, np.floating, np.integer),
    int: (int, np.integer),
    bool: (bool, np.bool_),
    complex: (complex, float, int, np.number),
}
_SEQUENCES = (list, tuple, Sequence, Collection, Iterable, set, frozenset, Set)
_MAPPINGS = (dict, Mapping, types.MappingProxyType)


def fits(value: Any, hint: Any) -> bool:
    """Return whether a value has the type of an annotation, including its items.

    An int may stand for a float and a list for a tuple. Values of classes are compared by class
    alone. A callable is not data and fits nothing.

    Examples
    --------
    >>> fits((1, 2.5), tuple[float, ...]), fits("a", float | None)
    (True, False)
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
    """Return whether keys and values fit their annotations."""
    if not args:
        return True
    key, item = args
    return all(fits(k, key) and fits(v, item) for k, v in value.items())


def _items_fit(value: Collection[Any], kind: Any, args: tuple[Any, ...]) -> bool:
    """Return whether the items of a sequence or set fit; a set fits only annotations that allow
    one.
    """
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
    """Return whether the annotation is a protocol: it describes methods, and data has none."""
    return bool(getattr(kind, "_is_protocol", False))


# Storable classes: dataclasses and named tuples of this project's packages.

PACKAGES = ("sysid", "uqharness")
_NAME = re.compile(rf"({'|'.join(PACKAGES)})((?:\.[a-z][a-z0-9_]*)+):([A-Za-z_][A-Za-z0-9_]*)")


@dataclass(frozen=True)
class StorableClass:
    """A class whose values a file may hold.

    Attributes
    ----------
    kind : type
        The class.
    name : str
        "module:class".
    fields : tuple of str
        Field names in order.
    hints : tuple
        Their annotations.
    """

    kind: type
    name: str
    fields: tuple[str, ...]
    hints: tuple[Any, ...]

    def values(self, value: Any) -> list[Any]:
        """Return the values of the fields."""
        return [getattr(value, name) for name in self.fields]

    def mismatch(self, values: Sequence[Any]) -> str:
        """Return a sentence about the first field whose value does not fit its annotation; "" if
        all fit.
        """
        if len(values) != len(self.fields):
            return f"{self.name} has {len(self.fields)} fields, not {len(values)}"
        for name, value, hint in zip(self.fields, values, self.hints, strict=True):
            if not fits(value, hint):
                return (
                    f"{name} of {self.name} holds a {type(value).__name__} that its annotation does"
                    " not allow"
                )
        return ""

    def build(self, values: Sequence[Any]) -> Any:
        """Return an object with these field values without running ``__init__`` or
        ``__post_init__``.
        """
        if issubclass(self.kind, tuple):
            return tuple.__new__(self.kind, values)
        fields = dict(zip(self.fields, values, strict=True))
        instance: Any = object.__new__(self.kind)
        for name, value in fields.items():
            object.__setattr__(instance, name, value)
        return instance


def find_class(name: Any, fields: Any) -> StorableClass:
    """Return the class with that name and exactly these fields.

    Only modules of this project are imported. Raises ValueError if there is no such class.
    """
    parts = _NAME.fullmatch(name) if isinstance(name, str) else None
    if parts is None:
        raise ValueError(f"no class of this program: {str(name)[:80]!r}")
    module = parts[1] + parts[2]
    above = module.rpartition(".")[0]
    # A folder without __init__.py holds data, such as the campaigns; importing from it would
    # run code of unknown origin.
    if any(
        not _is_package(".".join(above.split(".")[: n + 1])) for n in range(above.count(".") + 1)
    ):
        raise ValueError(f"no class of this program: {name}")
    target = vars(importlib.import_module(module)).get(parts[3])
    storable = storable_class(target) if isinstance(target, type) else None
    if storable is None or storable.name != name:
        raise ValueError(f"no class of this program whose values are data: {name}")
    if fields != list(storable.fields):
        raise ValueError(f"{name} has other fields in this version of the program")
    return storable


def _is_package(name: str) -> bool:
    """Return whether a module name belongs to a package with an ``__init__.py``."""
    spec = importlib.util.find_spec(name)
    return (
        spec is not None and spec.origin is not None and spec.submodule_search_locations is not None
    )


@cache
def storable_class(kind: type) -> StorableClass | None:
    """Return how to store values of a class; None unless it is a dataclass or named tuple of this
    project.
    """
    name = f"{kind.__module__}:{kind.__qualname__}"
    if not _NAME.fullmatch(name):
        # Not of this project.
        return None
    # A dataclass that also inherits from list or an exception holds more than its fields.
    plain = dataclasses.is_dataclass(kind) and kind.__new__ is object.__new__
    if not plain and not _is_named_tuple(kind):
        return None
    try:
        hints = typing.get_type_hints(kind)
    except NameError:
        # Annotated with what is imported for type checkers alone.
        return None
    cls: Any = kind
    # A field with a default may say that it is computed again instead of stored.
    fields = (
        tuple(f.name for f in dataclasses.fields(cls) if f.metadata.get("stored", True))
        if plain
        else tuple(cls._fields)
    )
    return StorableClass(kind, name, fields, tuple(hints[field] for field in fields))


def _is_named_tuple(kind: type) -> bool:
    """Return whether a class was made by typing.NamedTuple."""
    fields = getattr(kind, "_fields", None)
    return (
        kind.__bases__ == (tuple,)
        and isinstance(fields, tuple)
        and all(name in kind.__annotations__ for name in fields)
    )


# Types of array items (dtypes) as text.

_PLAIN = re.compile(r"[<>|][biufcmMSUV][0-9]{0,9}(\[[0-9]{0,9}[a-zA-Zμ]{1,2}\])?")
_MAX_DTYPE_DEPTH = 8


def describe_dtype(dtype: np.dtype[Any]) -> Any:
    """Return a dtype as text, or as lists of text if it has fields.

    Raises ValueError if the text would not give the same dtype back.
    """
    if dtype.kind not in "biufcmMSUV" or dtype.metadata is not None:
        raise ValueError(f"items of the type {dtype}")
    description = _listed(np.lib.format.dtype_to_descr(dtype))
    try:
        same = dtype_from(description) == dtype
    except ValueError:
        same = False
    if not same:
        raise ValueError(f"items of the type {dtype}")
    return description


def dtype_from(description: Any) -> np.dtype[Any]:
    """Return the dtype that `describe_dtype` described; raise ValueError or TypeError for other
    input.
    """
    dtype: np.dtype[Any] = np.lib.format.descr_to_dtype(_checked(description, 0))
    if dtype.hasobject or dtype.subdtype is not None:
        raise ValueError("an array's items are not plain")
    return dtype


def _listed(description: Any) -> Any:
    """Convert nested tuples to lists, which JSON keeps."""
    return (
        [_listed(item) for item in description]
        if isinstance(description, list | tuple)
        else description
    )


def _checked(description: Any, depth: int) -> Any:
    """Return a description with the tuples that numpy requires.

    Only texts that name one plain type reach numpy, which would evaluate others.
    """
    if isinstance(description, str):
        if not _PLAIN.fullmatch(description):
            raise ValueError(f"no type of items: {description[:40]!r}")
        return description
    if depth > _MAX_DTYPE_DEPTH:
        raise ValueError("types of items are nested too deep")
    fields = []
    for name, kind, *shape in description:
        if not isinstance(name, str) or not all(
            type(n) is int and n > 0 for part in shape for n in part
        ):
            raise ValueError("a field of an array's items has no name or no shape")
        fields.append((name, _checked(kind, depth + 1), *(tuple(part) for part in shape)))
    return fields


# Limits on depth, number and checking time of the values, whoever wrote the file.

MAX_DEPTH = 100
"""Levels of values inside values."""
# Shared values count as often as they occur. No result of this project is as large.
_MAX_VALUES = 50_000_000
# Hashing a key visits all of its parts, recursively.
_MAX_KEY_PARTS = 1000
# Visits for hashes and type checks, in all.
_MAX_VISITS = 20_000_000
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
"""Exceptions that content not written by `dump` may raise while it is read."""


class DataFileError(ValueError):
    """Bytes that are not a data file, a damaged file, or a value that a file cannot hold."""


class Sizes:
    """Depth and number of parts of each value, including everything inside it."""

    def __init__(self) -> None:
        self.height: list[int] = []
        self.parts: list[int] = []
        self._looks = 0

    def note(self, children: Iterable[int]) -> None:
        """Add one value that contains these earlier values; raise DataFileError beyond a limit."""
        height, parts = 0, 1
        for child in children:
            height = max(height, self.height[child])
            parts += self.parts[child]
        if height >= MAX_DEPTH:
            raise DataFileError(
                f"values are nested more than {MAX_DEPTH} deep, or one is inside itself"
            )
        if parts > _MAX_VALUES:
            raise DataFileError(f"it holds more than {_MAX_VALUES} values")
        self.height.append(height + 1)
        self.parts.append(parts)

    def check_keys(self, keys: Iterable[int]) -> None:
        """Raise DataFileError for keys that would take long to hash."""
        keys = list(keys)
        if any(self.parts[key] > _MAX_KEY_PARTS for key in keys):
            raise DataFileError(f"a key has more than {_MAX_KEY_PARTS} parts")
        self.count_visits(keys)

    def count_visits(self, values: Iterable[int]) -> None:
        """Count one more visit of all parts; raise DataFileError beyond the limit."""
        self._looks += sum(self.parts[value] for value in values)
        if self._looks > _MAX_VISITS:
            raise DataFileError(f"looking at its values takes more than {_MAX_VISITS} steps")


# Reading. No code of a stored class runs, and memory stays in proportion to the file.

# Keys with equal hashes are compared with each other: many of them take quadratic time.
_MAX_EQUAL_HASHES = 64


class Reader:
    """Builds the values of a file from the nodes of its header.

    ``classes`` are pairs of class name and field names; ``buffers`` are the bytes behind the
    header, each of which exactly one node uses.
    """

    def __init__(self, classes: Any, buffers: list[memoryview]) -> None:
        self._classes = [find_class(name, fields) for name, fields in classes]
        self._buffers: list[memoryview | None] = list(buffers)
        self._sizes = Sizes()
        self._values: list[Any] = []

    def values(self, nodes: Any) -> Any:
        """Build all nodes in order and return the value of the last, which contains all others."""
        for number, (kind, *content) in enumerate(nodes):
            try:
                value, children = _READERS[kind](self, *content)
            except MALFORMED as error:
                raise DataFileError(f"malformed: value {number}: {one_line(error)}") from None
            self._sizes.note(children)
            self._values.append(value)
        return self._values[-1]

    def _at(self, numbers: Any) -> list[Any]:
        """Return the values of earlier nodes; raise ValueError for other numbers."""
        if type(numbers) is not list or not all(
            type(n) is int and 0 <= n < len(self._values) for n in numbers
        ):
            raise ValueError("it refers to values that do not come before it")
        return [self._values[n] for n in numbers]

    def _keys(self, numbers: Any) -> list[Any]:
        """Return the keys of a set or dictionary, after checks of size and equal hashes."""
        keys = self._at(numbers)
        self._sizes.check_keys(numbers)
        hashes = sorted(hash(key) for key in keys)
        if any(a == b for a, b in zip(hashes, hashes[_MAX_EQUAL_HASHES:], strict=False)):
            raise ValueError("its keys would take long to tell apart")
        return keys

    def _none(self) -> tuple[Any, Sequence[int]]:
        """Build None; like all builders, return a value and the nodes that it contains."""
        return None, ()

    def _bool(self, value: Any) -> tuple[Any, Sequence[int]]:
        return _require_type(bool, value), ()

    def _int(self, value: Any) -> tuple[Any, Sequence[int]]:
        return (int(value, 16) if type(value) is str else _require_type(int, value)), ()

    def _float(self, value: Any) -> tuple[Any, Sequence[int]]:
        return (
            struct.unpack(">d", bytes.fromhex(value))[0]
            if type(value) is str
            else _require_type(float, value)
        ), ()

    def _str(self, value: Any) -> tuple[Any, Sequence[int]]:
        return _decoded_text(value), ()

    def _path(self, value: Any) -> tuple[Any, Sequence[int]]:
        return Path(_decoded_text(value)), ()

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
        return _require_distinct(set(self._keys(numbers)), numbers), numbers

    def _frozenset(self, numbers: Any) -> tuple[Any, Sequence[int]]:
        return _require_distinct(frozenset(self._keys(numbers)), numbers), numbers

    def _dict(self, keys: Any, values: Any) -> tuple[Any, Sequence[int]]:
        """Build a dictionary."""
        mapping = dict(zip(self._keys(keys), self._at(values), strict=True))
        return _require_distinct(mapping, keys), keys + values

    def _mappingproxy(self, keys: Any, values: Any) -> tuple[Any, Sequence[int]]:
        mapping, children = self._dict(keys, values)
        return MappingProxyType(mapping), children

    def _scalar(self, dtype: Any, value: Any) -> tuple[Any, Sequence[int]]:
        """Build a numpy scalar from its dtype and its bytes in hexadecimal."""
        kind, content = dtype_from(dtype), bytes.fromhex(value)
        if len(content) != kind.itemsize:
            raise ValueError("a scalar's bytes are not those of its type")
        return np.ndarray((), kind, content or b"\0")[()], ()

    def _object(self, number: Any, numbers: Any) -> tuple[Any, Sequence[int]]:
        """Build a dataclass or named tuple after checking its field types."""
        if type(number) is not int or number < 0:
            raise ValueError("it has no class")
        storable, values = self._classes[number], self._at(numbers)
        self._sizes.count_visits(numbers)
        mismatch = storable.mismatch(values)
        if mismatch:
            raise ValueError(mismatch)
        return storable.build(values), numbers

    def _array(
        self, shape: Any, order: Any, writeable: Any, dtype: Any, number: Any
    ) -> tuple[Any, Sequence[int]]:
        """Build an array of plain items from its bytes."""
        kind, content = dtype_from(dtype), self._buffer(number)
        if _count(shape) * kind.itemsize != len(content) or (kind.itemsize == 0 and _count(shape)):
            raise ValueError("an array's bytes are not those of its shape and type")
        flat = np.frombuffer(content, np.uint8).view(kind) if len(content) else np.empty(0, kind)
        # Copy: the buffer may be unaligned, where sums are slower and may differ in the last
        # digit.
        return _shaped(flat.copy(), shape, order, writeable), ()

    def _texts(
        self, shape: Any, order: Any, writeable: Any, lengths: Any, encoded: Any
    ) -> tuple[Any, Sequence[int]]:
        """Build an array of str and None from one buffer of lengths (-1 for None) and one of
        UTF-8.
        """
        sizes, content = np.frombuffer(self._buffer(lengths), "<i8"), self._buffer(encoded)
        if (
            _count(shape) != len(sizes)
            or (sizes < -1).any()
            or int(np.maximum(sizes, 0).sum()) != len(content)
        ):
            raise ValueError("an array's texts are not as long as it says")
        flat = np.empty(len(sizes), dtype=object)
        # Labels repeat: equal texts become one object.
        decoded: dict[bytes, str] = {}
        begin = 0
        for i, size in enumerate(sizes.tolist()):
            if size >= 0:
                raw = bytes(content[begin : begin + size])
                text = decoded.get(raw)
                flat[i] = (
                    decoded.setdefault(raw, raw.decode("utf-8", "surrogatepass"))
                    if text is None
                    else text
                )
                begin += size
        return _shaped(flat, shape, order, writeable), ()

    def _objects(
        self, shape: Any, order: Any, writeable: Any, numbers: Any
    ) -> tuple[Any, Sequence[int]]:
        """Build an array of objects from earlier values."""
        values = self._at(numbers)
        if _count(shape) != len(values):
            raise ValueError("an array has not as many values as its shape says")
        flat = np.empty(len(values), dtype=object)
        for i, value in enumerate(values):
            flat[i] = value
        return _shaped(flat, shape, order, writeable), numbers

    def _buffer(self, number: Any) -> memoryview:
        """Hand over a buffer to the one node that may use it."""
        buffer = self._buffers[number] if type(number) is int and number >= 0 else None
        if buffer is None:
            raise ValueError("it has no buffer, or that of another value")
        # Two nodes with one buffer would let a small file fill the memory with copies.
        self._buffers[number] = None
        return buffer


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


def _require_type(kind: type, value: Any) -> Any:
    """Return the value if its type is exactly `kind`; raise TypeError otherwise."""
    if type(value) is not kind:
        raise TypeError(f"a {kind.__name__} is written as a {type(value).__name__}")
    return value


def _decoded_text(value: Any) -> str:
    """Return a text; a list of one hexadecimal text holds bytes that JSON cannot represent."""
    if type(value) is list:
        (value,) = value
        return bytes.fromhex(value).decode("utf-8", "surrogatepass")
    text: str = _require_type(str, value)
    return text


def _require_distinct(container: Any, numbers: Any) -> Any:
    """Return the container if no equal keys were merged; raise ValueError otherwise."""
    if len(container) != len(numbers):
        raise ValueError("two of its keys are equal")
    return container


def _count(shape: Any) -> int:
    """Return the number of items of an array of this shape."""
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
    """Give a flat array its shape, memory order and write permission."""
    if order not in ("C", "F"):
        raise ValueError("an array has no order")
    array = flat.reshape(shape, order=order)
    array.flags.writeable = _require_type(bool, writeable)
    return array


# Writing, and the file format.

MAGIC = b"UQDATA\x00\x01"
"""First bytes of a file. The last one is the version of the format."""
MAX_HEADER_BYTES = 16 * 1024 * 1024
"""Largest JSON header. Parsed, it takes up to 30 times as much memory."""
_DIGEST = 32
_ALIGNMENT = 64


def dump(value: Any) -> bytes:
    """Return a value as bytes.

    Parameters
    ----------
    value : object
        None, bool, int, float (bit for bit), str, bytes, list, tuple, dict, set, frozenset, slice,
        mapping proxy, Path, numpy scalar or array, or a dataclass or named tuple of ``sysid`` and
        ``uqharness``, nested to any depth up to MAX_DEPTH. A value that occurs twice is written
        once.

    Raises
    ------
    DataFileError
        For any other value, a value inside itself, or more than MAX_HEADER_BYTES apart from
        arrays.

    Examples
    --------
    >>> load(dump({"a": (1, 2.5)}))
    {'a': (1, 2.5)}
    """
    return b"".join(dump_parts(value))


def dump_parts(value: Any) -> list[bytes | memoryview]:
    """Return the bytes of `dump` in parts to be written one after the other, without copying
    arrays.
    """
    writer = _Writer()
    writer.add(value)
    return writer.parts()


def load(data: bytes, kind: Any = Any) -> Any:
    """Return the value that `dump` wrote, bit for bit, with the same parts shared.

    Dataclasses are restored without their ``__init__`` and ``__post_init__``, so that no code runs
    on unchecked values; the type of every field is checked against its annotation. A read-only
    array is a view of ``data``.

    Parameters
    ----------
    data : bytes
        Content of a file.
    kind : type or annotation
        Type that the value must have.

    Raises
    ------
    DataFileError
        If the bytes are not such a file, are damaged, or hold a value of another type.
    """
    begin = len(MAGIC) + _DIGEST
    if len(data) < begin + 8 or data[: len(MAGIC)] != MAGIC:
        raise DataFileError("not a data file of this version of the program")
    content = memoryview(data)[begin:]
    # The digest covers everything behind it, so that a damaged file is recognised before it is
    # parsed.
    if bytes.fromhex(sha256_of_parts([content])) != data[len(MAGIC) : begin]:
        raise DataFileError("damaged: its content does not match its digest")
    length = int.from_bytes(content[:8], "little")
    if length > min(MAX_HEADER_BYTES, len(content) - 8):
        raise DataFileError("malformed: its header is longer than allowed")
    try:
        header = json.loads(bytes(content[8 : 8 + length]))
        value = Reader(
            header["classes"], _buffers(header["buffers"], content[8 + length :])
        ).values(header["nodes"])
    except DataFileError:
        raise
    except MALFORMED as error:
        raise DataFileError(f"malformed: {one_line(error)}") from None
    if not fits(value, kind):
        raise DataFileError(f"it holds a {type(value).__name__} that is not what is asked for")
    return value


def _padding(length: int) -> int:
    """Return the number of bytes up to the next multiple of the alignment."""
    return -length % _ALIGNMENT


def _buffers(lengths: Any, content: memoryview) -> list[memoryview]:
    """Split the bytes behind the header into buffers of these lengths."""
    buffers, begin = [], 0
    for length in lengths:
        if type(length) is not int or length < 0:
            raise ValueError("a buffer has no length")
        buffers.append(content[begin : begin + length])
        begin += length + _padding(length)
    if begin != len(content):
        raise ValueError("the buffers do not fill the file")
    return buffers


class _Writer:
    """Collects nodes and buffers of a value and of everything inside it."""

    def __init__(self) -> None:
        self._nodes: list[str] = []
        self._classes: dict[type, int] = {}
        self._class_nodes: list[list[Any]] = []
        self._buffers: list[Any] = []
        self._sizes = Sizes()
        # The values are kept alive, because ``id`` of a deleted object may be reused.
        self._numbers: dict[Any, tuple[int, Any]] = {}
        self._trail: list[str] = []

    def parts(self) -> list[bytes | memoryview]:
        """Return the file in parts: magic, digest, header, padded buffers."""
        lengths = [len(buffer) for buffer in self._buffers]
        header = (
            f'{{"classes":{_json(self._class_nodes)},"buffers":{_json(lengths)},'
            f'"nodes":[{",".join(self._nodes)}]}}'
        ).encode()
        if len(header) > MAX_HEADER_BYTES:
            raise DataFileError(
                f"the value takes {len(header)} bytes beside its arrays; a data file allows"
                f" {MAX_HEADER_BYTES}"
            )
        parts = [len(header).to_bytes(8, "little"), header]
        for buffer in self._buffers:
            parts += [buffer, bytes(_padding(len(buffer)))]
        return [MAGIC, bytes.fromhex(sha256_of_parts(parts)), *parts]

    def add(self, value: Any) -> int:
        """Return the number of a value's node, written now if it is new."""
        key = _identity(value)
        if key in self._numbers:
            return self._numbers[key][0]
        if len(self._trail) > MAX_DEPTH:
            raise DataFileError(
                f"values are nested more than {MAX_DEPTH} deep, or one is inside itself"
            )
        node, children = self._node(value)
        self._sizes.note(children)
        self._nodes.append(_json(node))
        number = len(self._nodes) - 1
        self._numbers[key] = number, value
        return number

    def _node(self, value: Any) -> tuple[list[Any], list[int]]:
        """Return a value's node and the numbers of the nodes that it refers to."""
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
            scalar = np.asarray(value)
            return ["scalar", self._dtype(scalar.dtype), scalar.tobytes().hex()], []
        storable = storable_class(kind)
        if storable is None:
            raise DataFileError(
                f"a data file cannot hold a {kind.__module__}.{kind.__qualname__}{self._place()}"
            )
        return self._object(storable, value)

    def _object(self, storable: StorableClass, value: Any) -> tuple[list[Any], list[int]]:
        """Write a dataclass or named tuple whose fields fit their annotations."""
        if storable.kind not in self._classes:
            self._classes[storable.kind] = len(self._class_nodes)
            self._class_nodes.append([storable.name, list(storable.fields)])
        values = storable.values(value)
        mismatch = storable.mismatch(values)
        if mismatch:
            raise DataFileError(f"{mismatch}{self._place()}")
        items = self._all(zip(storable.fields, values, strict=True))
        self._sizes.count_visits(items)
        return ["object", self._classes[storable.kind], items], items

    def _array(self, value: np.ndarray) -> tuple[list[Any], list[int]]:
        """Write an array: plain items and texts as buffers, other objects as nodes."""
        order = "F" if value.flags.f_contiguous and not value.flags.c_contiguous else "C"
        flat = value.reshape(-1, order=order)  # type: ignore[call-overload]
        layout = [list(value.shape), order, value.flags.writeable]
        if not value.dtype.hasobject:
            dtype = self._dtype(value.dtype)
            if value.dtype.itemsize == 0 and value.size:
                raise DataFileError(
                    f"a data file cannot hold an array of items without bytes{self._place()}"
                )
            # Not all dtypes export their memory (datetime64 does not); a view of bytes always
            # does.
            raw = np.ascontiguousarray(flat).view(np.uint8).data if value.size else b""
            return ["array", *layout, dtype, self._buffer(raw)], []
        if value.dtype != object:
            raise DataFileError(f"a data file cannot hold an array of {value.dtype}{self._place()}")
        if all(item is None or type(item) is str for item in flat):
            texts = [None if item is None else _encoded(item) for item in flat]
            lengths = np.array([-1 if text is None else len(text) for text in texts], dtype="<i8")
            encoded = b"".join(text for text in texts if text)
            return ["texts", *layout, self._buffer(lengths.tobytes()), self._buffer(encoded)], []
        items = self._all(enumerate(flat))
        return ["objects", *layout, items], items

    def _dtype(self, dtype: np.dtype[Any]) -> Any:
        """Describe a dtype; raise DataFileError with the place of the array."""
        try:
            return describe_dtype(dtype)
        except ValueError as error:
            raise DataFileError(f"a data file cannot hold {error}{self._place()}") from None

    def _buffer(self, content: Any) -> int:
        """Add a buffer and return its number."""
        self._buffers.append(content)
        return len(self._buffers) - 1

    def _all(self, values: Iterable[tuple[Any, Any]]) -> list[int]:
        """Write named values and return their node numbers; the names locate an error."""
        numbers = []
        for name, value in values:
            self._trail.append(str(name))
            numbers.append(self.add(value))
            self._trail.pop()
        return numbers

    def _place(self) -> str:
        """Return where in the value an error occurred, for messages."""
        return f", at {'.'.join(self._trail)}" if self._trail else ""


def _json(value: Any) -> str:
    """Return compact JSON; NaN is refused."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def _identity(value: Any) -> Any:
    """Return equal keys for values that may share one node.

    These are the same object, or plain values that cannot be distinguished.
    """
    # NaN is not equal to itself: two of them may be keys of one dictionary.
    if type(value) is float and value == value:
        return float, struct.pack("<d", value)
    if type(value) in (bool, int, str):
        return type(value), value
    return id(value)


def _encoded(text: str) -> bytes:
    """Encode as UTF-8; file names may carry other bytes as lone surrogates."""
    # File names may carry bytes that are no UTF-8, as lone surrogates.
    return text.encode("utf-8", "surrogatepass")


def _text(text: str) -> Any:
    """Return a text as it is, or its bytes in hexadecimal if JSON would not preserve it."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return [_encoded(text).hex()]
    return text


def _number(value: int) -> Any:
    """Return an int, in hexadecimal if long: decimal conversion takes quadratic time."""
    # Decimal digits take quadratic time.
    return value if abs(value) < 2**63 else hex(value)


def _real(value: float) -> Any:
    """Return a float, or its bits in hexadecimal if it is not finite: NaN has a payload."""
    # The payload bits of a NaN are preserved.
    return value if np.isfinite(value) else struct.pack(">d", value).hex()


_SCALARS: dict[type, Callable[[Any], Any]] = {bool: bool, int: _number, float: _real, str: _text}
