"""The builder: each value once, constants folded, simplifications that keep every bit; and what it
refuses.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.helpers.batch_against import same_bits
from uqharness.batch.ir import Builder, evaluate, rewrite


def test_simplifications_keep_every_bit() -> None:
    x = np.array([0.0, -0.0, 1.5, -2.5, math.inf, -math.inf, math.nan, 5e-324, 1e308])
    b = Builder()
    v = b.input("x")
    result = {
        "one": v * 1.0,
        "left": 1.0 * v,
        "over": v / 1.0,
        "less": v - 0.0,
        "more": v + -0.0,
        "twice": b.op("neg", -v),
        "four": v / 4.0,
        "minus": v * -1.0,
    }
    got, _ = evaluate(b.finish(result), {"x": x})
    expected = {"four": x / 4.0, "minus": -x}
    for name, row in got.items():
        assert same_bits(row, expected.get(name, x)).all(), name
    assert "div" not in b.finish(result).counts()
    retained = b.finish({"a": v + 0.0, "b": v * 0.0})
    assert {"add", "mul"} <= set(retained.counts())


def test_tables_are_told_apart_and_folded() -> None:
    b = Builder()
    assert b.table([0.0, 1.0]).index == b.table([0, 1]).index
    assert b.table([0.0, 1.0]).index != b.table([-0.0, 1.0]).index
    assert b.op("lookup", b.table([3.0, 4.0]), b.constant(1.5)).constant == 4.0
    function = b.finish({"r": b.op("lookup", b.table([3.0, 4.0]), b.input("x"))})
    assert (
        rewrite(function, ("lookup",), lambda builder, node, a: builder.op(node.operation, *a))
        == function
    )
    with pytest.raises(ValueError, match="a number at least"):
        b.table([])
    with pytest.raises(ValueError, match="lookup takes table, f64"):
        b.op("lookup", b.input("x"), b.input("x"))
