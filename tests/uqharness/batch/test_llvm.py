"""Compiled code: lanes that do not fill a block, state, no contraction, and machine code kept between processes."""

from __future__ import annotations

import os
import stat
import subprocess
import sys

import numpy as np
import pytest

from tests.helpers.batch_against import same_bits
from uqharness.batch import llvm
from uqharness.batch.ir import TRANSCENDENTAL, Builder, Function, evaluate
from uqharness.batch.llvm import compile_function, targets
from uqharness.batch.maths import lower
from uqharness.batch.program import BLOCK


def _function() -> Function:
    b = Builder()
    x, s = b.input("x"), b.load("s")
    b.store("s", s * 0.9 + b.op("sin", x))
    b.store("untouched twin", b.load("untouched"))
    return lower(b.finish({"r": b.op("exp", s) + x * x - x, "k": b.constant(2.0)}))


@pytest.mark.parametrize("lanes", [1, BLOCK + 1])
@pytest.mark.parametrize("name", targets())
def test_compile_function_with_any_number_of_lanes(lanes: int, name: str) -> None:
    rng = np.random.default_rng(1)
    inputs = {"x": rng.normal(size=lanes)}
    state = {s: rng.normal(size=lanes) for s in ("s", "untouched")}
    outputs, after = compile_function(_function(), targets()[name])(inputs, state)
    expected, wanted_after = evaluate(_function(), inputs, state)
    assert all(same_bits(outputs[k], expected[k]).all() for k in expected)
    assert all(
        same_bits(after[k], wanted_after[k]).all() for k in ("s", "untouched", "untouched twin")
    )


def test_products_and_sums_are_not_fused() -> None:
    b = Builder()
    function = b.finish({"r": b.input("x") * b.input("y") + b.input("z")})
    for name, target in targets().items():
        kernel = compile_function(function, target)
        assert "vfm" not in kernel.assembly
        e = 2.0**-30
        result, _ = kernel({"x": np.array([1 + e]), "y": np.array([1 - e]), "z": np.array([-1.0])})
        assert result["r"][0] == 0.0, name


def test_machine_code_calls_no_library() -> None:
    """Machine code reaches 2 GB: a function of the C library would lie beyond, and its bits would
    be that machine's.
    """
    b = Builder()
    x, y = b.input("x"), b.input("y")
    result = {name: b.op(name, *(x, y)[:count]) for name, count in TRANSCENDENTAL.items()}
    result |= {"floor": b.op("floor", x), "sqrt": b.op("sqrt", x)}
    for name, target in targets().items():
        assert "call" not in compile_function(lower(b.finish(result)), target).assembly, name


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
    expected = numbers[np.clip(np.nan_to_num(x, nan=0.0), 0, count - 1).astype(int)]
    assert same_bits(evaluate(function, {"x": x})[0]["r"], expected).all()
    for name, target in targets().items():
        result, _ = compile_function(function, target)({"x": x})
        assert same_bits(result["r"], expected).all(), name
        assert same_bits(result["other"], evaluate(function, {"x": x})[0]["other"]).all(), name


TEXT = """
define double @scale(double %x) {{
  %y = fmul double %x, {factor}
  ret double %y
}}
"""


CALL = """
import ctypes, sys
from uqharness.batch import llvm
code = llvm.build_code.__wrapped__(sys.argv[1], "scale", llvm.choose_target())
print(ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(code.address)(2.0))
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("UQ_CACHE", str(tmp_path))
    return tmp_path / "objects"


def scale(factor):
    text = TEXT.format(factor=factor)
    out = subprocess.run([sys.executable, "-c", CALL, text], capture_output=True, text=True)
    assert out.returncode == 0, out.stderr
    return float(out.stdout)


def test_another_process_takes_the_code_of_the_same_text(folder):
    assert scale("3.0") == 6.0
    (file,) = folder.iterdir()
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    # Code of another text under this name shows that it is the file that is loaded.
    assert scale("5.0") == 10.0
    (other,) = set(folder.iterdir()) - {file}
    file.write_bytes(other.read_bytes())
    assert scale("3.0") == 10.0


@pytest.mark.parametrize("damage", ["digest", "mark", "short", "writable", "link", "folder"])
def test_damaged_or_foreign_code_is_compiled_again(folder, damage, tmp_path):
    key, code = llvm.object_key("a"), bytes(range(256)) * 8
    llvm.remember(key, code)
    assert llvm.recall(key) == code
    (file,) = folder.iterdir()
    content = file.read_bytes()
    if damage == "digest":
        file.write_bytes(content[:-1] + b"x")
    elif damage == "mark":
        file.write_bytes(b"U" + content[1:])
    elif damage == "short":
        file.write_bytes(content[:10])
    elif damage == "writable":
        file.chmod(0o620)
    elif damage == "folder":
        folder.chmod(0o770)
    else:
        file.rename(tmp_path / "elsewhere")
        file.symlink_to(tmp_path / "elsewhere")
    assert llvm.recall(key) is None
    llvm.remember(key, code)
    assert llvm.recall(key) == (None if damage == "folder" else code)


def test_the_code_that_was_used_last_is_kept(folder, monkeypatch):
    keys = [llvm.object_key(str(k)) for k in range(4)]
    for key in keys:
        llvm.remember(key, b"x" * 1000)
        os.utime(folder / f"{key}{llvm.SUFFIX}", (1e9, 1e9))
    assert llvm.recall(keys[1]) is not None
    monkeypatch.setattr(llvm, "MAX_BYTES", 2500)
    llvm.remember(llvm.object_key("new"), b"x" * 1000)
    retained = [key for key in (*keys, llvm.object_key("new")) if llvm.recall(key)]
    assert retained == [keys[1], llvm.object_key("new")]
