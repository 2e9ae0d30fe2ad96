"""Compiled code: lanes that do not fill a block, state, independence of lanes, no contraction."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.batch_against import same_bits
from uqharness.batch.ir import TRANSCENDENTAL, Builder, Function, evaluate
from uqharness.batch.llvm import Target, compile_function, print_function, targets
from uqharness.batch.maths import lower
from uqharness.batch.program import BLOCK, from_blocks, to_blocks


def _function() -> Function:
    b = Builder()
    x, s = b.input("x"), b.load("s")
    b.store("s", s * 0.9 + b.op("sin", x))
    b.store("untouched twin", b.load("untouched"))
    return lower(b.finish({"r": b.op("exp", s) + x * x - x, "k": b.constant(2.0)}))


@pytest.mark.parametrize("lanes", [1, 3, BLOCK, BLOCK + 1, 50])
@pytest.mark.parametrize("name", targets())
def test_any_number_of_lanes(lanes: int, name: str) -> None:
    rng = np.random.default_rng(1)
    inputs = {"x": rng.normal(size=lanes)}
    state = {s: rng.normal(size=lanes) for s in ("s", "untouched")}
    outputs, after = compile_function(_function(), targets()[name])(inputs, state)
    wanted, wanted_after = evaluate(_function(), inputs, state)
    assert all(same_bits(outputs[k], wanted[k]).all() for k in wanted)
    assert all(
        same_bits(after[k], wanted_after[k]).all() for k in ("s", "untouched", "untouched twin")
    )


def test_a_nan_lane_harms_no_other() -> None:
    x = np.random.default_rng(2).normal(size=40)
    harmed = x.copy()
    harmed[[3, 17]] = np.nan
    for target in targets().values():
        kernel = compile_function(_function(), target)
        sound, _ = kernel({"x": x}, {"s": x})
        other, _ = kernel({"x": harmed}, {"s": x})
        assert np.flatnonzero(~same_bits(sound["r"], other["r"])).tolist() == [3, 17]


def test_products_and_sums_are_not_fused() -> None:
    b = Builder()
    function = b.finish({"r": b.input("x") * b.input("y") + b.input("z")})
    for name, target in targets().items():
        kernel = compile_function(function, target)
        assert "vfm" not in kernel.assembly
        e = 2.0**-30
        made, _ = kernel({"x": np.array([1 + e]), "y": np.array([1 - e]), "z": np.array([-1.0])})
        assert made["r"][0] == 0.0, name


def test_the_widest_registers_are_used() -> None:
    register = {"scalar": "xmm", "sse2": "xmm", "avx2": "ymm", "avx512": "zmm"}
    for name, target in targets().items():
        assert register[name] in compile_function(_function(), target).assembly


def test_blocks_and_back() -> None:
    rows = [np.arange(11.0), np.array([7.0])]
    array = to_blocks(rows, 11)
    assert array.shape == (2, 2, BLOCK)
    assert from_blocks(array, 11)[0].tolist() == rows[0].tolist()
    assert from_blocks(array, 11)[1].tolist() == [7.0] * 11


def test_what_cannot_be_compiled_is_refused() -> None:
    b = Builder()
    with pytest.raises(ValueError, match="only after"):
        print_function(b.finish({"r": b.op("sin", b.input("x"))}), Target("x86-64", "", 4))
    with pytest.raises(ValueError, match="divides 8"):
        print_function(b.finish({"r": b.input("x")}), Target("x86-64", "", 3))


def test_nothing_outside_is_called() -> None:
    """Machine code reaches 2 GB: a function of the C library would lie beyond, and its bits would
    be that machine's.
    """
    b = Builder()
    x, y = b.input("x"), b.input("y")
    made = {name: b.op(name, *(x, y)[:count]) for name, count in TRANSCENDENTAL.items()}
    made |= {"floor": b.op("floor", x), "sqrt": b.op("sqrt", x)}
    for name, target in targets().items():
        assert "call" not in compile_function(lower(b.finish(made)), target).assembly, name


def test_floor_is_exact_on_every_processor() -> None:
    b = Builder()
    function = b.finish({"r": b.op("floor", b.input("x"))})
    special = [
        0.0,
        -0.0,
        0.3,
        -0.3,
        1.0,
        -1.0,
        2.5,
        -2.5,
        np.inf,
        -np.inf,
        np.nan,
        2.0**52 - 0.5,
        -(2.0**52) + 0.5,
        1e300,
        5e-324,
    ]
    x = np.array(
        [*special, -5e-324, 2.0**53 + 2, -1e300, 0.5, -0.5, 4503599627370495.5, -4503599627370495.5]
    )
    x = np.concatenate([x, np.random.default_rng(1).normal(size=1000) * 100])
    for name, target in targets().items():
        assert same_bits(compile_function(function, target)({"x": x})[0]["r"], np.floor(x)).all(), (
            name
        )


@pytest.mark.parametrize("count", [1, 2, 37])
def test_tables_are_held_at_their_ends(count: int) -> None:
    rng = np.random.default_rng(3)
    b = Builder()
    numbers = rng.normal(size=count)
    other = b.op("lookup", b.table([7.0, -0.0]), b.input("x") - 1.0)
    function = b.finish(
        {"r": b.op("lookup", b.table(numbers.tolist()), b.input("x")), "other": other}
    )
    x = np.concatenate(
        [
            [0.0, -0.0, 0.99, 1.0, -3.0, np.nan, np.inf, -np.inf, 1e300, 35.999, 36.0],
            rng.uniform(-2, 40, 200),
        ]
    )
    wanted = numbers[np.clip(np.nan_to_num(x, nan=0.0), 0, count - 1).astype(int)]
    assert same_bits(evaluate(function, {"x": x})[0]["r"], wanted).all()
    for name, target in targets().items():
        made, _ = compile_function(function, target)({"x": x})
        assert same_bits(made["r"], wanted).all(), name
        assert same_bits(made["other"], evaluate(function, {"x": x})[0]["other"]).all(), name
