"""Compiled flights: the bytes of numpy's at every width, whatever the lanes, their order and the
pieces of time.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.batch_against import same_bits
from tests.helpers.batch_programs import feeds, mixed, run_program
from tests.helpers.few import few
from uqharness.batch.ir import Builder
from uqharness.batch.llvm import targets
from uqharness.batch.llvm_flight import FlightKernel, compile_program
from uqharness.batch.passes import optimise
from uqharness.batch.program import (
    BLOCK,
    Feed,
    Program,
    Section,
    Stream,
    initial_state,
    remap_state,
    select_lanes,
)

LANES, FRAMES = 21, 60


def _start(program: Program, lanes: int = LANES) -> np.ndarray:
    rng = np.random.default_rng(9)
    own = {name: rng.normal(size=lanes) for name in ("s0", "s1", "s2", "s3", "constant a")}
    return initial_state(program, lanes, own)


@pytest.fixture(scope="module")
def kernels() -> dict[str, FlightKernel]:
    return {name: compile_program(mixed(), target) for name, target in targets().items()}


@pytest.mark.parametrize("seed", few([0, 1], 1))
def test_every_target_flies_the_bits_of_numpy(seed: int) -> None:
    program = mixed(seed, sections=9)
    start = _start(program)
    wanted_state = start.copy()
    wanted = run_program(program, wanted_state, 1, FRAMES, feeds(FRAMES, LANES), 3)
    assert wanted.shape == (len(program.records), 3 * BLOCK, FRAMES // 3)
    assert np.isfinite(wanted).mean() > 0.5
    for name, target in targets().items():
        state = start.copy()
        got = compile_program(program, target).fly(state, 1, FRAMES, feeds(FRAMES, LANES), 3)
        assert same_bits(got, wanted).all(), name
        assert same_bits(state, wanted_state).all(), name


@pytest.mark.parametrize("name", targets())
def test_pieces_of_time_are_the_whole(name: str, kernels: dict[str, FlightKernel]) -> None:
    program, given = mixed(), feeds(FRAMES, LANES)
    whole = _start(program)
    records = kernels[name].fly(whole, 1, FRAMES, given, 4)
    state, parts, frame = _start(program), [], 1
    for frames in (1, 2, 7, 0, 30, 20):
        parts.append(kernels[name].fly(state, frame, frames, given, 4))
        frame += frames
    assert same_bits(np.concatenate(parts, axis=2), records).all()
    assert same_bits(state, whole).all()


@pytest.mark.parametrize("name", targets())
def test_lanes_do_not_depend_on_their_place(name: str, kernels: dict[str, FlightKernel]) -> None:
    program, given = mixed(), feeds(FRAMES, LANES)
    start = _start(program)
    order = np.random.default_rng(1).permutation(LANES)[:13]
    picked = select_lanes(start, order)
    records = kernels[name].fly(start, 1, FRAMES, given)
    moved = {key: feed._replace(offsets=feed.offsets[order]) for key, feed in given.items()}
    assert same_bits(
        kernels[name].fly(picked, 1, FRAMES, moved)[:, : len(order)], records[:, order]
    ).all()


@pytest.mark.parametrize("name", targets())
def test_a_nan_lane_harms_no_other(name: str, kernels: dict[str, FlightKernel]) -> None:
    program, given = mixed(), feeds(FRAMES, LANES)
    sound, harmed = _start(program), _start(program)
    harmed[1, :6, 2] = np.nan
    a, b = kernels[name].fly(sound, 1, FRAMES, given), kernels[name].fly(harmed, 1, FRAMES, given)
    different = np.flatnonzero(~same_bits(a, b).all(axis=(0, 2)))
    assert different.tolist() == [BLOCK + 2]


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
    wanted = run_program(program, initial_state(program, 5, {"pace": paces}), 1, 6, {"x": feed})
    assert wanted[0, :5].tolist()[0][1:4] == [0.0, 1.0, 2.0]
    assert np.isnan(wanted[0, 0, [0, 4, 5]]).all()
    assert np.isnan(wanted[0, 1:4]).all()
    assert wanted[0, 4, 2:].tolist() == [6.0, 6.0, 7.0, 7.0]
    for target in targets().values():
        got = compile_program(program, target).fly(
            initial_state(program, 5, {"pace": paces}), 1, 6, {"x": feed}
        )
        assert same_bits(got, wanted).all()


def test_calls_that_do_not_fit_are_refused(kernels: dict[str, FlightKernel]) -> None:
    program, given = mixed(), feeds(FRAMES, LANES)
    kernel, state = kernels["scalar"], _start(mixed())
    with pytest.raises(ValueError, match="need rows 0 to 31; each lane has 0 to 30"):
        kernel.fly(state, 1, FRAMES + 4, given)
    with pytest.raises(ValueError, match="leave the 62 rows"):
        kernel.fly(state, 1, 4, {**given, "wind": given["wind"]._replace(offsets=np.array([70]))})
    with pytest.raises(ValueError, match="leave the 62 rows"):
        kernel.fly(state, 1, 4, {**given, "wind": given["wind"]._replace(offsets=np.array([-1]))})
    with pytest.raises(ValueError, match="noise, wind are needed; received wind"):
        kernel.fly(state, 1, 4, {"wind": given["wind"]})
    with pytest.raises(ValueError, match="whole offset"):
        kernel.fly(
            state,
            1,
            4,
            {**given, "wind": given["wind"]._replace(offsets=np.zeros(2 * 24, dtype=np.int64))},
        )
    with pytest.raises(ValueError, match="the state has shape"):
        kernel.fly(state[:, :5], 1, 4, given)
    with pytest.raises(ValueError, match="count from 1"):
        kernel.fly(state, 0, 4, given)
    with pytest.raises(ValueError, match="no slot nonsense"):
        initial_state(program, 3, {"nonsense": 1.0})


@pytest.mark.parametrize("name", few(targets(), 1))
def test_a_program_after_all_passes_has_the_same_bits(name: str) -> None:
    program = mixed(2, sections=9)
    changed = optimise(program)
    assert changed.prelude is not None
    wanted = run_program(program, _start(program), 1, FRAMES, feeds(FRAMES, LANES), 3)
    start = remap_state(_start(program), program, changed)
    got = compile_program(changed, targets()[name]).fly(start, 1, FRAMES, feeds(FRAMES, LANES), 3)
    assert same_bits(got, wanted).all()
