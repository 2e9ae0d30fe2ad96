"""Types of array items as plain text, through JSON and back."""

from __future__ import annotations

import json

import numpy as np
import pytest

from sysid.foreign.typed_files import describe_dtype, dtype_from

TYPES = [
    "<f8",
    ">i2",
    "|u1",
    "|b1",
    "<c16",
    "<M8[ns]",
    "<m8[us]",
    "<U5",
    "|S3",
    "|V7",
    [("a", "<f8"), ("b", ">i4")],
    [("a", "<f8", (2, 3)), ("deep", [("c", "|u1"), ("d", "<U2")])],
]


@pytest.mark.parametrize("kind", TYPES, ids=str)
def test_a_type_comes_back_through_json(kind):
    dtype = np.dtype(kind)
    written = json.loads(json.dumps(describe_dtype(dtype)))
    assert dtype_from(written) == dtype
    assert dtype_from(written) != np.dtype([("a", "<f4")])


@pytest.mark.parametrize(
    "dtype",
    [
        np.dtype(object),
        np.dtype([("a", object)]),
        np.dtype("f8", metadata={"a": 1}),
        np.dtype((np.int32, (2,))),
    ],
    ids=str,
)
def test_what_text_cannot_say_is_refused(dtype):
    with pytest.raises(ValueError, match="items of the type"):
        describe_dtype(dtype)


@pytest.mark.parametrize(
    "written",
    [
        "|O",
        "i4,i4",
        "(2,)i4",
        "__import__('os')",
        "<f8 ",
        "<f99999999999",
        "",
        [["a", "|O"]],
        [["a", "<f8", [0]]],
        [["a", "<f8", [-1]]],
        [["a", "<f8", [True]]],
        [[3, "<f8"]],
        json.loads("[[" * 12 + '"a","<i4"' + "]]" * 12),
    ],
    ids=str,
)
def test_a_strangers_text_is_no_type(written):
    with pytest.raises((ValueError, TypeError)):
        dtype_from(written)
