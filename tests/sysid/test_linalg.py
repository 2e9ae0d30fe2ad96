"""Sparse sums, compiled loops and recursions, against the same written out."""

from __future__ import annotations

import importlib.util
import pickle
from itertools import pairwise

import numba
import numpy as np
import pytest
from scipy.signal import lfilter

from sysid.linalg import Blocks, compiled, first_order

EDGES = [0, 4, 9, 15]


def sensitivity(seed: int = 0) -> np.ndarray:
    """(15, 3, 8): two columns of all segments, two of each one alone."""
    s = np.random.default_rng(seed).standard_normal((15, 3, 8))
    for k in range(3):
        s[: EDGES[k], :, 2 + 2 * k : 4 + 2 * k] = 0.0
        s[EDGES[k + 1] :, :, 2 + 2 * k : 4 + 2 * k] = 0.0
    return s


def blocks(dense: np.ndarray) -> Blocks:
    return Blocks.from_segments([dense[a:b] for a, b in pairwise(EDGES)])


def test_of_each_segment_the_columns_that_move_it_are_kept():
    s = sensitivity()
    section = blocks(s)
    assert [c.tolist() for c in section.columns] == [[0, 1, 2, 3], [0, 1, 4, 5], [0, 1, 6, 7]]
    np.testing.assert_array_equal(section.dense(), s)
    vector = np.arange(8.0)
    np.testing.assert_allclose(section.matvec(vector), s @ vector, atol=1e-12)
    np.testing.assert_array_equal(section.largest(), np.abs(s).max(axis=0))
    some = np.array([1, 4, 7])
    np.testing.assert_array_equal(section.select_columns(some).dense(), s[:, :, some])
    doubled = section.map_parts(
        lambda part, columns, rows: part * np.arange(15.0)[rows, None, None]
    )
    np.testing.assert_array_equal(doubled.dense(), s * np.arange(15.0)[:, None, None])
    assert not np.array_equal(doubled.dense(), s)


# Compiled loops give what they give uncompiled, where their code can be kept and where it
# cannot.


def total(values):
    result = 0.0
    for k in range(len(values)):
        result += values[k] ** 2
    return result


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


# First-order recursions against their closed form and against scipy's own filter.


@pytest.mark.parametrize("keep", [0.0, 0.3, 0.999, -0.5])
def test_noise_as_another_implementation_has_it(keep: float) -> None:
    x = np.random.default_rng(1).standard_normal(3000)
    inputs = x.copy()
    expected = lfilter([1.0], [1.0, -keep], x, zi=[keep * 2.0])[0]
    np.testing.assert_allclose(first_order(x, keep, 2.0), expected, rtol=1e-10, atol=1e-10)
    np.testing.assert_array_equal(x, inputs)
