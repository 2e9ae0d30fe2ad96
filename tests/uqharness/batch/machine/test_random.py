"""Compiled normals against numpy's form, at every width."""

from __future__ import annotations

import numpy as np
import pytest

from uqharness.batch.llvm import targets
from uqharness.batch.llvm_random import compiled_pairs
from uqharness.flight.random_numbers import Normals, numpy_pairs


@pytest.mark.parametrize("name", list(targets()))
def test_pairs_have_numpys_bits(name: str) -> None:
    raw = np.random.PCG64(1).random_raw(160_000).view(np.int64).reshape(-1, 2, 8)
    raw[0, :, :4] = [[0, -1, -(2**63), 2**63 - 1], [0, -1, 2**63 - 1, -(2**63)]]
    ours = compiled_pairs(targets()[name])(raw)
    assert ours.tobytes() == numpy_pairs(raw).tobytes()
    # One bit of a raw number that counts is seen.
    raw[7, 0, 3] ^= 1 << 12
    assert ours.tobytes() != numpy_pairs(raw).tobytes()


def test_a_stream_takes_either_form() -> None:
    compiled = compiled_pairs(list(targets().values())[-1])
    one, other = Normals(np.random.PCG64(4), compiled), Normals(np.random.PCG64(4))
    assert one.take(1001).tobytes() == other.take(1001).tobytes()
