"""JSBSim's normals against JSBSim, and how its generators are shared, seeded and drawn from."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from tests.helpers import batch_oracle
from uqharness.batch.llvm import targets
from uqharness.batch.llvm_random import compiled_tries
from uqharness.batch.streams import MODULUS, MULTIPLIER, JsbsimNormals, numpy_tries, polar_normals

PER_FRAME = 100
FRAMES = 2000
_MANY = "".join(f'<function name="z{k}"><random/></function>' for k in range(PER_FRAME))


def drawn(body: str, names: list[str], frames: int, **seeds: int) -> np.ndarray:
    """What JSBSim's functions have behind its initialisation and behind each frame, (frames + 1,
    names).
    """
    fdm = batch_oracle.load(body)
    for name, seed in seeds.items():
        fdm[f"{name}/randomseed"] = seed
    fdm.run_ic()
    manager = fdm.get_property_manager()
    nodes = [manager.get_node(name) for name in names]
    out = np.empty((frames + 1, len(names)))
    for row in range(frames + 1):
        if row:
            fdm.run()
        out[row] = [node.get_double_value() for node in nodes]
    return out


@pytest.mark.parametrize("seed", [0, 1, 12345, MODULUS - 1])
def test_normals_are_jsbsims(seed: int) -> None:
    theirs = drawn(_MANY, [f"z{k}" for k in range(PER_FRAME)], FRAMES, simulation=seed).ravel()
    ours = JsbsimNormals(seed).take(PER_FRAME + theirs.size)[PER_FRAME:]
    # Two initialising frames draw once each; the first's numbers are gone when the second has run.
    assert np.mean(ours == theirs) > 0.95
    assert np.abs(ours / theirs - 1.0).max() < 3 * 2.0**-52
    assert np.mean(JsbsimNormals(seed).take(theirs.size) == theirs) < 1e-3


def test_seeds_0_and_1_are_one_stream_and_others_are_not() -> None:
    assert np.array_equal(JsbsimNormals(0).take(99), JsbsimNormals(1).take(99))
    assert not np.any(JsbsimNormals(2).take(99) == JsbsimNormals(1).take(99))
    for wrong in (-1, MODULUS):
        with pytest.raises(ValueError, match="from 0 to"):
            JsbsimNormals(wrong)


def test_a_seed_drops_the_second_normal_of_a_try() -> None:
    fdm = batch_oracle.load("".join(f'<function name="{n}"><random/></function>' for n in "abc"))
    fdm["simulation/randomseed"] = 5
    fdm.run()  # three drawn: one of the second try is left
    fdm["simulation/randomseed"] = 77
    fdm.run()
    np.testing.assert_allclose([fdm[n] for n in "abc"], JsbsimNormals(77).take(3), rtol=1e-15)


@pytest.mark.parametrize(
    ("seeds", "shared"), [({"simulation": 9}, True), ({"simulation": 9, "atmosphere": 31}, False)]
)
def test_turbulence_takes_four_from_its_own_or_the_common_generator(
    seeds: dict[str, int], shared: bool
) -> None:
    fdm = batch_oracle.load("".join(f'<function name="{n}"><random/></function>' for n in "abc"))
    for name, seed in seeds.items():
        fdm[f"{name}/randomseed"] = seed
    fdm.run_ic()
    fdm["atmosphere/turb-type"] = 4
    fdm["atmosphere/turbulence/milspec/severity"] = 3
    fdm["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = 50.0
    stream = JsbsimNormals(9)
    stream.take(6)
    for _ in range(5):
        fdm.run()
        if shared:
            stream.take(4)
        np.testing.assert_allclose([fdm[n] for n in "abc"], stream.take(3), rtol=1e-15)
    assert fdm["atmosphere/turb-down-fps"] != 0.0


@pytest.mark.parametrize("name", list(targets()))
def test_compiled_tries_have_numpys_bits(name: str) -> None:
    tries = compiled_tries(targets()[name], MODULUS, MULTIPLIER, polar_normals)
    for state, count in ((1, 100_000), (MODULUS - 1, 4097), (16807, 8), (5, 1), (7, 0)):
        ours, behind = tries(state, count)
        theirs, expected = numpy_tries(state, count)
        assert ours.tobytes() == theirs.tobytes()
        assert behind == expected
    other = compiled_tries(targets()[name], MODULUS, MULTIPLIER + 1, polar_normals)
    assert other(1, 100)[0].tobytes() != numpy_tries(1, 100)[0].tobytes()


def test_the_generator_is_minstd_rand0() -> None:
    # ISO C++: the 10000th number of the default seed.
    state = 1
    for _ in range(2500):
        state = numpy_tries(state, 1)[1]
    assert state == 1043618065


def test_calls_cut_the_stream_anywhere_and_copies_go_on() -> None:
    whole = JsbsimNormals(3).take(1000)
    cut = JsbsimNormals(3)
    parts = [cut.take(n) for n in (1, 0, 7, 300)]
    other = cut.copy()
    parts.append(cut.take(692))
    assert np.concatenate(parts).tobytes() == whole.tobytes()
    assert other.take(692).tobytes() == parts[-1].tobytes()


def test_threads_do_not_meet_in_compiled_tries() -> None:
    tries = compiled_tries(list(targets().values())[-1], MODULUS, MULTIPLIER, polar_normals)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda seed: JsbsimNormals(seed, tries).take(300_000), range(2, 10)))
    for seed, normals in zip(range(2, 10), found, strict=True):
        assert normals.tobytes() == JsbsimNormals(seed, tries).take(300_000).tobytes()
