"""Nodes of a data file made into values: shared ones shared, each buffer once, and nothing that is
not there yet.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from sysid.foreign.typed_files import DataFileError, Reader

FINDING = [
    "sysid.errors:Finding",
    ["code", "channel", "severity", "message", "numbers", "spoils", "mend"],
]


def read(*nodes, classes=(), buffers=()):
    return Reader(classes, [memoryview(b) for b in buffers]).values([list(n) for n in nodes])


@pytest.mark.parametrize(
    ("node", "value"),
    [
        (("none",), None),
        (("bool", True), True),
        (("int", -7), -7),
        (("int", "0x" + "f" * 40), 16**40 - 1),
        (("float", 0.5), 0.5),
        (("str", "é"), "é"),
        (("path", "a/b"), Path("a/b")),
        (("list", []), []),
        (("tuple", []), ()),
    ],
)
def test_plain_nodes(node, value):
    found = read(node)
    assert found == value
    assert type(found) is type(value) or isinstance(value, Path)


def test_every_bit_of_a_float_comes_back():
    bits = "7ff8000000000123"
    assert struct.pack(">d", read(("float", bits))).hex() == bits


def test_a_value_that_two_hold_is_one():
    outer = read(("list", []), ("list", [0, 0]), ("tuple", [1, 0]))
    assert outer[0][0] is outer[0][1] is outer[1]


def test_arrays_have_their_order_and_may_be_read_only():
    data = np.arange(6, dtype="<i4")
    found = read(("array", [2, 3], "F", False, "<i4", 0), buffers=[data.tobytes()])
    np.testing.assert_array_equal(found, data.reshape((2, 3), order="F"))
    assert found.flags.f_contiguous
    assert not found.flags.writeable
    other = read(("array", [2, 3], "C", True, "<i4", 0), buffers=[data.tobytes()])
    assert not np.array_equal(found, other)
    other[0, 0] = 9


def test_repeated_texts_are_one_object_and_a_missing_one_is_none():
    lengths = struct.pack("<4q", 2, -1, 2, 0)
    found = read(("texts", [4], "C", True, 0, 1), buffers=[lengths, b"abab"])
    assert found.tolist() == ["ab", None, "ab", ""]
    assert found[0] is found[2]


def test_mappings_and_slices():
    found = read(
        ("str", "a"),
        ("int", 1),
        ("none",),
        ("dict", [0, 1], [1, 2]),
        ("slice", [1, 2, 2]),
        ("list", [3, 4]),
    )
    assert found == [{"a": 1, 1: None}, slice(1, None, None)]
    proxy = read(("str", "a"), ("mappingproxy", [0], [0]))
    assert dict(proxy) == {"a": "a"}
    with pytest.raises(TypeError):
        proxy["b"] = 1


@pytest.mark.parametrize(
    ("nodes", "said"),
    [
        ([("none",), ("list", [1])], "value 1: it refers to values that do not come before it"),
        ([("int", 1), ("float", 1.0), ("set", [0, 1])], "two of its keys are equal"),
        ([("bytes", 0), ("bytes", 0)], "value 1: it has no buffer, or that of another value"),
        ([("array", [3], "C", True, "<f8", 0)], "bytes are not those of its shape and type"),
        ([("array", [1], "X", True, "<f8", 0)], "no order"),
        ([("array", [-1], "C", True, "<f8", 0)], "no shape"),
        (
            [("str", "c"), ("object", 0, [0, 0, 0, 0, 0, 0, 0])],
            "numbers of sysid.errors:Finding holds a str",
        ),
        ([("eval", "1")], "value 0"),
        ([("list", []), ("set", [0])], "unhashable"),
        ([("none",), *(("list", [k]) for k in range(150))], "nested more than 100 deep"),
    ],
)
def test_nodes_that_are_none_are_refused_with_their_number(nodes, said):
    with pytest.raises(DataFileError, match=said):
        read(*nodes, classes=[FINDING], buffers=[bytes(8)])
