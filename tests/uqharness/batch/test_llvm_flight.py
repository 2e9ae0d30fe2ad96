"""Compiled flights: the bytes of numpy's at every width, whatever the lanes, their order and the
pieces of time.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from tests.helpers.batch_against import same_bits
from tests.helpers.batch_programs import feeds, mixed, run_program
from tests.helpers.few import few
from uqharness.batch.ir import Builder
from uqharness.batch.llvm import targets
from uqharness.batch.llvm_flight import FlightKernel, compile_program
from uqharness.batch.program import (
    BLOCK,
    Feed,
    Program,
    Section,
    Stream,
    initial_state,
)

LANES, FRAMES = 21, 60


def _start(program: Program, lanes: int = LANES) -> np.ndarray:
    rng = np.random.default_rng(9)
    specific = {name: rng.normal(size=lanes) for name in ("s0", "s1", "s2", "s3", "constant a")}
    return initial_state(program, lanes, specific)


@pytest.fixture(scope="module")
def kernels() -> dict[str, FlightKernel]:
    return {name: compile_program(mixed(), target) for name, target in targets().items()}


@pytest.mark.parametrize("seed", few([0, 1], 1))
def test_every_target_flies_the_bits_of_numpy(seed: int) -> None:
    program = mixed(seed, sections=9)
    start = _start(program)
    wanted_state = start.copy()
    expected = run_program(program, wanted_state, 1, FRAMES, feeds(FRAMES, LANES), 3)
    assert expected.shape == (len(program.records), 3 * BLOCK, FRAMES // 3)
    assert np.isfinite(expected).mean() > 0.5
    for (name, target), quick in itertools.product(targets().items(), (False, True)):
        state = start.copy()
        kernel = compile_program(program, target, quick=quick)
        got = kernel.fly(state, 1, FRAMES, feeds(FRAMES, LANES), 3)
        assert same_bits(got, expected).all(), name
        assert same_bits(state, wanted_state).all(), name


def test_a_row_beyond_a_lanes_own_is_nan_and_never_read(kernels: dict[str, FlightKernel]) -> None:
    b = Builder()
    b.store("count", b.load("count") + b.load("pace"))
    program = Program(
        (Section("s", b.finish({})),),
        {"count": 0.0, "pace": 1.0, "n": 0.0},
        (Stream("x", ("n",), counter="count"),),
        ("n",),
    )
    paces = np.array([1.0, -1.0, np.nan, 1e300, 0.5])
    feed = Feed(np.arange(10.0).reshape(-1, 1), 1, np.array([0, 3, 3, 3, 6]), 3)
    expected = run_program(program, initial_state(program, 5, {"pace": paces}), 1, 6, {"x": feed})
    assert expected[0, :5].tolist()[0][1:4] == [0.0, 1.0, 2.0]
    assert np.isnan(expected[0, 0, [0, 4, 5]]).all()
    assert np.isnan(expected[0, 1:4]).all()
    assert expected[0, 4, 2:].tolist() == [6.0, 6.0, 7.0, 7.0]
    for target in targets().values():
        got = compile_program(program, target).fly(
            initial_state(program, 5, {"pace": paces}), 1, 6, {"x": feed}
        )
        assert same_bits(got, expected).all()
