"""Data files come back exactly, and forged ones are refused."""

from __future__ import annotations

import hashlib
import json
import math
import random
import struct
import sys
import tracemalloc
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from sysid.aerodynamics import GustStates
from sysid.errors import Finding
from sysid.foreign import typed_files
from sysid.foreign.raw import MessageTable, RawLog
from sysid.foreign.typed_files import (
    MAGIC,
    DataFileError,
    dump,
    find_class,
    load,
    storable_class,
)


def same(a: Any, b: Any) -> bool:
    """Equal in type and bits."""
    if type(a) is not type(b):
        return False
    if isinstance(a, float):
        return struct.pack("<d", a) == struct.pack("<d", b)
    if isinstance(a, np.ndarray):
        about = [
            (x.dtype.str, x.dtype.descr, x.shape, x.flags.f_contiguous, x.flags.writeable)
            for x in (a, b)
        ]
        if a.dtype == object:
            return about[0] == about[1] and all(map(same, a.ravel(), b.ravel()))
        return about[0] == about[1] and a.tobytes() == b.tobytes()
    if isinstance(a, np.generic):
        return a.dtype == b.dtype and a.tobytes() == b.tobytes()
    if isinstance(a, dict | MappingProxyType):
        return len(a) == len(b) and all(map(same, a, b)) and all(map(same, a.values(), b.values()))
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return bool(a == b)


PLAIN = [
    None,
    True,
    False,
    0,
    -5,
    2**63,
    -(2**70),
    10**5000,
    0.0,
    -0.0,
    5e-324,
    1 / 3,
    math.inf,
    -math.inf,
    math.nan,
    struct.unpack("<d", b"\x01\x00\x00\x00\x00\x00\xf8\xff")[0],
    "",
    "é\n\x1b",
    "\ud83d\ude00 \udcff",
    b"",
    b"\x00" * 70,
    [],
    (),
    {},
    set(),
    frozenset(),
    [1, [2, (3,)]],
    {(1, "a"): {2}, None: [], 1.5: frozenset([b"x"])},
    MappingProxyType({"a": 1}),
    Path("a/b c"),
    Path("/x\udc80"),
    slice(1, None, 2),
    np.float64(1 / 3),
    np.float32(0.1),
    np.int8(-3),
    np.bool_(True),
    np.str_(""),
    np.str_("ab"),
    np.complex128(1 - 2j),
    np.datetime64(5, "ns"),
    np.longdouble(1) / 3,
]


@pytest.mark.parametrize("value", PLAIN, ids=range(len(PLAIN)))
def test_values_come_back_bit_for_bit(value):
    assert same(load(dump(value)), value)
    assert same(load(dump([value, {"x": value}])), [value, {"x": value}])


@pytest.mark.parametrize(
    "dtype",
    [
        "?",
        "u1",
        "<i2",
        ">i4",
        "<u8",
        "<f2",
        ">f8",
        "<c16",
        "S3",
        "<U4",
        "V5",
        "<M8[ns]",
        "<m8[25us]",
    ],
)
@pytest.mark.parametrize("shape", [(), (0,), (7,), (2, 0, 3), (3, 4)])
def test_arrays_come_back_bit_for_bit(dtype, shape):
    count = int(np.prod(shape)) * np.dtype(dtype).itemsize
    # Characters of a text array must be characters.
    content = (
        bytes(k % 120 for k in range(count))
        if "U" not in dtype
        else np.full(shape, "aé", dtype).tobytes()
    )
    result = (
        np.frombuffer(content, np.uint8).view(dtype).reshape(shape)
        if count
        else np.empty(shape, dtype)
    )
    for value in (
        result,
        result.copy(),
        np.asfortranarray(result),
        result[..., ::2] if result.ndim else result,
    ):
        back = load(dump(value))
        expected = (
            value
            if value.flags.c_contiguous or value.flags.f_contiguous
            else np.ascontiguousarray(value)
        )
        expected.flags.writeable = value.flags.writeable
        assert same(back, expected)


def test_structured_and_object_arrays_come_back():
    kind = np.dtype([("a", "<i4"), ("b", ">f8", (2, 2)), ("c", [("d", "S3")])])
    result = np.zeros(3, kind)
    result["b"] = 1 / 3
    assert same(load(dump(result)), result)
    texts = np.array([["a", None, "é"], ["", "a", "\udc80"]], dtype=object)
    assert same(load(dump(texts)), texts)
    assert same(load(dump(np.asfortranarray(texts))), np.asfortranarray(texts))
    mixed = np.array([1, "x", None, (2.0,)], dtype=object)
    assert same(load(dump(mixed)), mixed)


def raw_log() -> RawLog:
    modes = np.array(["AUTO", None, "AUTO", "é", ""], dtype=object)
    table = MessageTable(np.arange(5.0), {"Mode": modes, "I": np.arange(5, dtype="u1")})
    return RawLog(
        "dataflash",
        {("ATT", 0): table, ("ATT", 1): table},
        {"ATT": 10},
        {"P": 0.1},
        ((1.5, "armed"),),
        "plane",
        {"mav": 1.0, "x": "y"},
        (Finding("late", "GPS", "info", "late", {"s": math.nan}),),
    )


def test_a_raw_log_comes_back_with_what_it_shares():
    log = raw_log()
    back = load(dump(log), RawLog)
    assert list(back.messages) == [("ATT", 0), ("ATT", 1)]
    assert back.messages["ATT", 0] is back.messages["ATT", 1]
    for name, values in log.messages["ATT", 0].fields.items():
        assert same(back.messages["ATT", 0].fields[name], values)
    assert (back.counts, back.parameters, back.texts, back.vehicle, back.facts) == (
        log.counts,
        log.parameters,
        log.texts,
        log.vehicle,
        log.facts,
    )
    assert math.isnan(back.findings[0].numbers["s"])
    with pytest.raises(DataFileError, match="a list that is not what is asked for"):
        load(dump([log]), RawLog)


@dataclass(frozen=True)
class Foreign:
    x: int = 1


class Numbers(list):
    pass


def inside_itself() -> list:
    value: list = []
    value.append(value)
    return value


def deep(levels: int) -> Any:
    value: Any = 0
    for _ in range(levels):
        value = (value,)
    return value


@pytest.mark.parametrize(
    ("value", "output"),
    [
        (print, "builtins.builtin_function_or_method"),
        (Foreign(), "test_typed_files.Foreign"),
        (Numbers(), "test_typed_files.Numbers"),
        (object(), "builtins.object"),
        (int, "builtins.type"),
        (np.zeros(2, "O,i4"), "an array of"),
        (np.ma.zeros(3), "MaskedArray"),
        (np.dtype("f8"), "Float64DType"),
        ({"a": [0, 1j]}, "a builtins.complex, at a.1"),
        (inside_itself(), "inside itself"),
        (deep(101), "nested more than 100"),
        (np.zeros(3, "V0"), "items without bytes"),
        (np.zeros(1, np.dtype("f8", metadata={"a": 1})), "items of the type"),
        (RawLog("x", {}, vehicle=3), "vehicle of sysid.foreign.raw:RawLog holds a int"),  # type: ignore[arg-type]
        (
            RawLog("x", {("a", "0"): MessageTable(np.zeros(1), {})}),
            "messages of sysid.foreign.raw:RawLog",
        ),  # type: ignore[dict-item]
        ({tuple(range(2000)): 1}, "a key has more than 1000 parts"),
    ],
)
def test_dump_refuses_what_is_no_data(value, output):
    with pytest.raises(DataFileError) as error:
        dump(value)
    assert output in str(error.value)


def test_dump_bounds_the_header(monkeypatch):
    monkeypatch.setattr(typed_files, "MAX_HEADER_BYTES", 1000)
    assert len(load(dump(np.zeros(10_000)))) == 10_000
    with pytest.raises(DataFileError, match="allows 1000"):
        dump(list(range(1000)))
    monkeypatch.undo()
    text = dump(list(range(1000)))
    monkeypatch.setattr(typed_files, "MAX_HEADER_BYTES", 1000)
    with pytest.raises(DataFileError, match="longer than allowed"):
        load(text)


def test_dump_and_load_bound_the_visits_of_shared_values(monkeypatch):
    numbers = {str(k): 1.0 for k in range(100)}
    text = dump([Finding("a", "", "info", str(k), numbers) for k in range(100)])
    assert len(load(text)) == 100
    monkeypatch.setattr(typed_files, "_MAX_VISITS", 10_000)
    with pytest.raises(DataFileError, match="takes more than 10000 steps"):
        load(text)


def sealed(header: Any, buffers: bytes = b"", length: int | None = None) -> bytes:
    """A file with a true digest, as someone makes it who knows the format."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    content = (len(text) if length is None else length).to_bytes(8, "little") + text + buffers
    return MAGIC + hashlib.sha256(content).digest() + content


def file_of(*nodes: Any, classes: Any = (), buffers: Any = (), content: bytes = b"") -> bytes:
    return sealed(
        {"classes": list(classes), "buffers": list(buffers), "nodes": list(nodes)}, content
    )


FINDING = [
    "sysid.errors:Finding",
    ["code", "channel", "severity", "message", "numbers", "spoils", "mend"],
]
LAUGHS = [["tuple", []], *(["tuple", [k, k]] for k in range(60))]

HOSTILE = {
    "no JSON": sealed(b"{"),
    "deep JSON": sealed(b"[" * 100_000),
    "header too long": sealed(b"{}", length=2**63),
    "no nodes": file_of(),
    "an empty node": file_of([]),
    "unknown kind": file_of(["eval", "1"]),
    "too many parts": file_of(["none", 1]),
    "digits": file_of(["int", "1" * 9 + "_x"]),
    "short float": file_of(["float", "00"]),
    "text as list": file_of(["str", ["zz"]]),
    "itself": file_of(["list", [0]]),
    "later": file_of(["list", [1]], ["none"]),
    "before the first": file_of(["none"], ["list", [-1]]),
    "unhashable key": file_of(["list", []], ["set", [0]]),
    "equal keys": file_of(["int", 1], ["float", 1.0], ["set", [0, 1]]),
    "more keys than values": file_of(["none"], ["dict", [0], []]),
    "deep": file_of(["none"], *(["list", [k]] for k in range(200))),
    "laughs": file_of(*LAUGHS),
    "keys of one hash": file_of(
        *(["int", hex(k * (2**61 - 1))] for k in range(500)), ["set", list(range(500))]
    ),
    "a NUL in a path": file_of(["path", 3]),
    "huge array": file_of(["array", [2**40], "C", True, "<f8", 0], buffers=[0]),
    "overflowing shape": file_of(
        ["array", [2**32, 2**32, 2**32], "C", True, "<f8", 0], buffers=[0]
    ),
    "negative axis": file_of(["array", [-1], "C", True, "u1", 0], buffers=[1], content=bytes(64)),
    "objects from bytes": file_of(
        ["array", [1], "C", True, "|O", 0], buffers=[8], content=bytes(64)
    ),
    "type of code": file_of(
        ["array", [1], "C", True, "__import__('os')", 0], buffers=[8], content=bytes(64)
    ),
    "deep type": file_of(
        ["array", [1], "C", True, json.loads("[[" * 30 + '"a","<i4"' + "]]" * 30), 0],
        buffers=[8],
        content=bytes(64),
    ),
    "field of huge size": file_of(
        ["array", [0], "C", True, [["a", "<f8", [2**31, 2**31]]], 0], buffers=[0]
    ),
    "one buffer for many": file_of(
        *(["bytes", 0] for _ in range(1000)), buffers=[100_000], content=bytes(100_032)
    ),
    "one big key for many": file_of(
        *LAUGHS[:9], *(["dict", [8] * 200, [0] * 200] for _ in range(1000))
    ),
    "no such buffer": file_of(["bytes", 0]),
    "buffer beyond the end": file_of(["bytes", 0], buffers=[2**62]),
    "left over": file_of(["none"], content=b"x"),
    "a false scalar": file_of(["scalar", "<f8", "00"]),
    "huge scalar": file_of(["scalar", "V999999999", ""]),
    "texts too long": file_of(
        ["texts", [1], "C", True, 0, 1],
        buffers=[8, 3],
        content=struct.pack("<q", 5).ljust(64) + b"abc".ljust(64),
    ),
    "texts that overflow": file_of(
        ["texts", [2], "C", True, 0, 1],
        buffers=[16, 0],
        content=struct.pack("<qq", 2**62, 2**62).ljust(64),
    ),
    "fewer objects": file_of(["none"], ["objects", [5], "C", True, [0]]),
    "bool as int": file_of(["int", True]),
    "laughs as a key": file_of(*LAUGHS[:40], ["set", [39]]),
    "huge empty items": file_of(["array", [2**40], "C", True, "V0", 0], buffers=[0]),
    "array of arrays": file_of(
        ["array", [1], "C", True, "(2,)i4", 0], buffers=[8], content=bytes(64)
    ),
    "last buffer": file_of(["bytes", -1], buffers=[1], content=bytes(64)),
    "negative buffer": file_of(["bytes", 0], buffers=[-1]),
    "texts of negative length": file_of(
        ["texts", [2], "C", True, 0, 1],
        buffers=[16, 3],
        content=struct.pack("<qq", -2, 3).ljust(64) + b"abc".ljust(64),
    ),
    "last class": file_of(["object", -1, []], classes=[FINDING]),
    "no such class": file_of(["object", 0, []]),
    "field missing": file_of(["str", "c"], ["object", 0, [0]], classes=[FINDING]),
    "field of another type": file_of(
        ["str", "c"], ["object", 0, [0, 0, 0, 0, 0]], classes=[FINDING]
    ),
    "other fields": file_of(["none"], classes=[["sysid.errors:Finding", ["code"]]]),
    **{
        name: file_of(["none"], classes=[[name, []]])
        for name in (
            "os:system",
            "sysid.errors:finding_from_dict",
            "sysid.foreign.raw:Finding",
            "sysid.nothing:Here",
            "sysid.foreign.raw:RawLog.x",
            "sysid..os:system",
            "uqharness.__main__:main",
            "sysidious.raw_log:RawLog",
            "tests.sysid.foreign.test_typed_files:Foreign",
            "sysid.estimation.kalman:Model",
        )
    },
    "a class without fields": file_of(["none"], classes=[["sysid.foreign.raw:RawLog"]]),
}


@pytest.mark.parametrize("content", HOSTILE.values(), ids=HOSTILE)
def test_a_forged_file_is_refused_and_takes_no_memory(content):
    before = set(sys.modules)
    tracemalloc.start()
    try:
        with pytest.raises(DataFileError):
            load(content)
        assert tracemalloc.get_traced_memory()[1] < 3_000_000 + 30 * len(content)
    finally:
        tracemalloc.stop()
    assert not {
        name
        for name in set(sys.modules) - before
        if name.startswith(("uqharness.data", "tests.sysid.test_data"))
    }


def test_load_refuses_another_version():
    text = bytearray(dump(1))
    text[len(MAGIC) - 1] += 1
    with pytest.raises(DataFileError, match="of this version"):
        load(bytes(text))


def test_mutated_headers_give_a_value_or_a_sentence():
    """A forger's file is another value or is refused; nothing else is ever raised."""
    written = dump(
        {"log": raw_log(), "more": [1, 2.5, "x", (slice(0, 3), np.zeros((2, 3))), {b"k": {1, 2}}]}
    )
    length = int.from_bytes(written[40:48], "little")
    header, content = written[48 : 48 + length], written[48 + length :]
    chance = random.Random(20)
    pieces = [
        b"0",
        b"-1",
        b"1e999",
        b"true",
        b"null",
        b"[]",
        b"[0]",
        b'"x"',
        b"{}",
        b"99999999999999999999",
        b"[[[[0]]]]",
    ]
    refused = []
    for _ in range(3000):
        text = bytearray(header)
        for _ in range(chance.randint(1, 3)):
            at = chance.randrange(len(text))
            if chance.random() < 0.5:
                text[at] = chance.randrange(256)
            else:
                text[at : at + chance.randint(0, 4)] = chance.choice(pieces)
        try:
            load(sealed(bytes(text), content))
        except DataFileError as error:
            refused.append(str(error))
    assert 1000 < len(refused) < 3000
    assert all(text.isprintable() and len(text) < 600 for text in refused)


# Classes whose values a file may hold: this project's dataclasses, by name and by fields, and
# no code of them.


def test_named_tuple_round_trip():
    value = GustStates(2.8, turning_with=False)
    specific = storable_class(GustStates)
    assert specific is find_class(
        "sysid.aerodynamics.air_motion:GustStates", list(GustStates._fields)
    )
    result = load(dump({"states": value}))["states"]
    assert type(result) is GustStates
    assert result == value
    assert "b of sysid.aerodynamics.air_motion:GustStates holds a str" in specific.mismatch(
        ["2.8", *value[1:]]
    )
    assert (
        storable_class(
            type("Other", (GustStates,), {"__module__": "sysid.aerodynamics.air_motion"})
        )
        is None
    )


# Nodes of a data file made into values: shared ones shared, each buffer once, and nothing that
# is not there yet.
