"""Machine code that is kept between processes."""

from __future__ import annotations

import os
import stat
import subprocess
import sys

import numpy as np
import pytest

from uqharness.batch import llvm, object_cache
from uqharness.batch.ir import Builder
from uqharness.batch.llvm_flight import compile_program
from uqharness.batch.program import Program, Section, When

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
def test_code_that_is_not_surely_ours_is_compiled_again(folder, damage, tmp_path):
    key, code = object_cache.object_key("a"), bytes(range(256)) * 8
    object_cache.remember(key, code)
    assert object_cache.recall(key) == code
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
    assert object_cache.recall(key) is None
    object_cache.remember(key, code)
    assert object_cache.recall(key) == (None if damage == "folder" else code)


def test_the_code_that_was_used_last_is_kept(folder, monkeypatch):
    keys = [object_cache.object_key(str(k)) for k in range(4)]
    for key in keys:
        object_cache.remember(key, b"x" * 1000)
        os.utime(folder / f"{key}{object_cache.SUFFIX}", (1e9, 1e9))
    assert object_cache.recall(keys[1]) is not None
    monkeypatch.setattr(object_cache, "MAX_BYTES", 2500)
    object_cache.remember(object_cache.object_key("new"), b"x" * 1000)
    kept = [key for key in (*keys, object_cache.object_key("new")) if object_cache.recall(key)]
    assert kept == [keys[1], object_cache.object_key("new")]


def test_a_kept_flight_gives_the_same_bits(folder):
    b = Builder()
    b.store("x", b.op("sqrt", b.load("x") * 1.1 + 0.3))
    program = Program((Section("one", b.finish({}), When()),), {"x": 1.0}, (), ("x",))
    rows = []
    for _ in range(2):
        llvm.build_code.cache_clear()
        flyer = compile_program(program, llvm.choose_target())
        state = np.ones((1, len(flyer.program.slots), 8))
        rows.append(flyer.fly(state, 1, 50))
        assert len(list(folder.iterdir())) == 1
    assert np.array_equal(rows[0], rows[1])
    assert np.ptp(rows[0]) > 0.0
