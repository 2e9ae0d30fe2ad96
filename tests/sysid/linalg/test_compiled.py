"""Compiled loops give what they give uncompiled, where their code can be kept and where it
cannot.
"""

from __future__ import annotations

import importlib.util
import pickle

import numba
import numpy as np
import pytest

from sysid.linalg import compiled


def total(values):
    found = 0.0
    for k in range(len(values)):
        found += values[k] ** 2
    return found


@pytest.mark.parametrize("writable", [True, False])
def test_a_compiled_loop_is_the_loop(monkeypatch: pytest.MonkeyPatch, writable: bool) -> None:
    plain = numba.njit

    def njit(cache: bool = False, nogil: bool = False, error_model: str = "python"):
        if cache and not writable:
            raise RuntimeError("cannot cache function: no locator available")
        return plain(nogil=nogil, error_model=error_model)

    monkeypatch.setattr(numba, "njit", njit)
    values = np.linspace(0.0, 1.0, 50)
    assert compiled(total)(values) == total(values)


def test_a_cache_of_moved_modules_is_discarded(tmp_path):
    """An index that names a class of a module that is gone, as an upgrade in place leaves it."""
    source = tmp_path / "moved_loop.py"
    source.write_text("def total(x):\n    return x + 1.0\n")
    for attempt in range(2):
        spec = importlib.util.spec_from_file_location("moved_loop", source)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        assert compiled(module.total)(1.0) == 2.0
        (index,) = (tmp_path / "__pycache__").glob("*.nbi")
        if attempt == 0:
            with index.open("rb") as file:
                version = pickle.load(file)
            # Protocol 0: a global of a module that does not exist.
            index.write_bytes(pickle.dumps(version) + b"cno_such_module\nName\n.")
    with index.open("rb") as file:
        pickle.load(file)
        assert pickle.load(file)
