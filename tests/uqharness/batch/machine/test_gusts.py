"""The compiled recursion against numpy's form, at every width and for segments of every length."""

from __future__ import annotations

import numpy as np
import pytest

from uqharness.batch.llvm import targets
from uqharness.batch.llvm_random import compiled_recursion
from uqharness.flight.dryden import numpy_recursion


@pytest.mark.parametrize("name", list(targets()))
@pytest.mark.parametrize("steps", [1, 2, 16, 64])
def test_states_have_numpys_bits(name: str, steps: int) -> None:
    drive = np.random.default_rng(steps).standard_normal(8192)
    drive[:2] = -0.0
    powers = 0.93 ** np.arange(1, steps + 1)
    recur = compiled_recursion(targets()[name])
    for last in (0.0, -0.0, 0.7):
        ours = recur(drive, powers, 1.0 / powers, last)
        assert ours.tobytes() == numpy_recursion(drive, powers, 1.0 / powers, last).tobytes()
    assert ours.tobytes() != recur(drive, powers, 1.0 / powers, 0.7 * (1.0 + 2.0**-52)).tobytes()


def test_other_sizes_are_refused() -> None:
    recur = compiled_recursion(next(iter(targets().values())))
    with pytest.raises(ValueError, match="multiple"):
        recur(np.zeros(100), np.ones(64), np.ones(64), 0.0)
