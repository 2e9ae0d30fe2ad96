"""Text of functions: when a slot is written, tables printed once, a width that does not fit."""

from __future__ import annotations

import pytest

from uqharness.batch.ir import Builder, Function
from uqharness.batch.llvm import FunctionPrinter, Vectors


def _lines(function: Function, vectors: Vectors, mask: str | None = None) -> list[str]:
    slots = list(function.slots)
    return FunctionPrinter(
        function, vectors, lambda what, name: (f"%{what}s", slots.index(name)), "f.", mask
    ).lines()


def test_a_slot_is_written_when_its_old_value_has_been_read() -> None:
    b = Builder()
    late = b.load("b") + 1.0
    product = b.load("a") * 2.0
    lines = _lines(b.finish({}, {"a": late, "b": product}), Vectors(4))
    reads = [k for k, line in enumerate(lines) if " load <4 x double>" in line]
    writes = [k for k, line in enumerate(lines) if " store <4 x double>" in line]
    assert len(reads) == len(writes) == 2
    assert min(writes) > max(reads)


def test_a_value_that_nothing_old_waits_for_is_stored_at_once() -> None:
    b = Builder()
    first = b.load("a") + 1.0
    last = b.op("sqrt", b.load("b")) * 3.0
    lines = _lines(b.finish({}, {"a": first, "c": last}), Vectors(1))
    assert next(k for k, line in enumerate(lines) if "store" in line) < next(
        k for k, line in enumerate(lines) if "sqrt" in line
    )


def test_masked_lanes_keep_what_they_have() -> None:
    b = Builder()
    lines = _lines(b.finish({}, {"a": b.load("b") + 1.0}), Vectors(2), "%mask")
    assert any("select <2 x i1> %mask" in line for line in lines)
    assert not any(
        "select" in line for line in _lines(b.finish({}, {"a": b.load("b") + 1.0}), Vectors(2))
    )


def test_a_table_is_printed_once() -> None:
    b, vectors = Builder(), Vectors(2)
    table = b.table([1.0, -0.0])
    _lines(
        b.finish(
            {}, {"a": b.op("lookup", table, b.load("a")), "b": b.op("lookup", table, b.load("b"))}
        ),
        vectors,
    )
    text = vectors.declarations()
    assert text.count("private constant [2 x double]") == 1
    assert "double 0x3FF0000000000000, double 0x8000000000000000" in text


def test_a_width_that_divides_no_block_is_refused() -> None:
    with pytest.raises(ValueError, match="a width divides 8; received 3"):
        Vectors(3)
