"""Random streams against JSBSim's: normals, noise, gusts and levels, cut anywhere, copied, compiled or not."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from tests.helpers import batch_oracle
from uqharness.batch.llvm import targets
from uqharness.batch.streams import (
    MODULUS,
    MULTIPLIER,
    HostGusts,
    JsbsimNormals,
    MovingLevels,
    Noise,
    Turbulence,
    compiled_pairs,
    compiled_recursion,
    compiled_tries,
    noise_streams,
    numpy_tries,
    polar_normals,
)
from uqharness.flight.dryden import COMPONENTS, dryden_gusts, dryden_parameters, numpy_recursion
from uqharness.flight.random_numbers import numpy_pairs
from uqharness.flight.spec import COEFFICIENTS, LevelDriver

AIR = (22.2, 100.0, 30.0, 3.66)


DRAWS = (("a", 3), ("b", 1), ("c", 3), ("d", 2), ("e", 1))


WALK = LevelDriver("walk", 7, "walk-000000", COEFFICIENTS, (0.012,) * 6)


MIXED = (("a", 3), ("b/uniform", 1), ("c", 3), ("d/uniform", 2), ("e", 1), ("f/uniform", 1))


@pytest.mark.parametrize("draws", [DRAWS, MIXED])
def test_noise_is_drawn_in_jsbsims_order_with_mixed_rates(draws) -> None:
    body = "".join(
        f'<channel name="{slot}" execrate="{every}"><fcs_function name="noise/{slot}"><function>'
        f"<{'urandom' if slot.endswith('/uniform') else 'random'}/></function></fcs_function>"
        "</channel>"
        for slot, every in draws
    )
    fdm = batch_oracle.load(body)
    fdm["simulation/randomseed"] = 11
    fdm.run_ic()
    noise = Noise(11, draws)
    names = [f"noise/{slot}" for slot, _ in draws]
    np.testing.assert_allclose([fdm[name] for name in names], noise.initial[1], rtol=1e-15)
    fed = noise.frames(40)
    constant = dict(zip((slot for slot, _ in draws), noise.initial[1], strict=True))
    for frame in range(1, 41):
        fdm.run()
        for stream in noise_streams(draws):
            if frame % stream.every == 0:
                rows = fed[stream.name]
                constant |= zip(
                    stream.columns,
                    rows.array[frame // stream.every - 1 - rows.first_row],
                    strict=True,
                )
        np.testing.assert_allclose(
            [fdm[name] for name in names], [constant[slot] for slot, _ in draws], rtol=1e-15
        )


def test_host_gusts_are_those_of_jsbsims_engine() -> None:
    theirs = dryden_gusts(20_000, 0.01, *AIR, seed=3)
    gusts = HostGusts(dryden_parameters(*AIR), 0.01, 3)
    parts = [gusts.rows(n).array for n in (1, 8192, 300)]
    other = copy.deepcopy(gusts)
    last = gusts.rows(11_507)
    ours = np.concatenate([*parts, last.array])
    assert last.first_row == 8493
    assert other.rows(11_507).array.tobytes() == last.array.tobytes()
    for column, name in enumerate(COMPONENTS):
        assert ours[:, column].tobytes() == theirs.component(name).tobytes()
    assert not np.any(HostGusts(dryden_parameters(*AIR), 0.01, 4).rows(100).array == ours[:100])


def test_streams_of_one_seed_are_independent() -> None:
    n = 40_000
    series = {
        "noise": Noise(17, [("a", 1)]).frames(n)["noise/1"].array[:, 0],
        "turbulence": Turbulence(18).rows(n).array[:, 0],
        "gusts": np.diff(HostGusts(dryden_parameters(*AIR), 0.01, 17).rows(n + 1).array[:, 3]),
        "levels": np.diff(MovingLevels(WALK, 0.01).rows(n + 1).array[:, 0]),
    }
    correlation = np.corrcoef(list(series.values())) - np.eye(len(series))
    assert np.abs(correlation).max() < 4.5 / np.sqrt(n)


PER_FRAME = 100


FRAMES = 2000


_MANY = "".join(f'<function name="z{k}"><random/></function>' for k in range(PER_FRAME))


def draw(body: str, names: list[str], frames: int, **seeds: int) -> np.ndarray:
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
    theirs = draw(_MANY, [f"z{k}" for k in range(PER_FRAME)], FRAMES, simulation=seed).ravel()
    ours = JsbsimNormals(seed).take(PER_FRAME + theirs.size)[PER_FRAME:]
    # Two initialising frames draw once each; the first's numbers are gone when the second has run.
    assert np.mean(ours == theirs) > 0.95
    assert np.abs(ours / theirs - 1.0).max() < 3 * 2.0**-52
    assert np.mean(JsbsimNormals(seed).take(theirs.size) == theirs) < 1e-3


def test_seeds_0_and_1_are_one_stream_and_others_are_not() -> None:
    assert np.array_equal(JsbsimNormals(0).take(99), JsbsimNormals(1).take(99))
    assert not np.any(JsbsimNormals(2).take(99) == JsbsimNormals(1).take(99))
    for invalid in (-1, MODULUS):
        with pytest.raises(ValueError, match="from 0 to"):
            JsbsimNormals(invalid)


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


@pytest.mark.parametrize("name", list(targets()))
def test_pairs_have_numpys_bits(name: str) -> None:
    raw = np.random.PCG64(1).random_raw(160_000).view(np.int64).reshape(-1, 2, 8)
    raw[0, :, :4] = [[0, -1, -(2**63), 2**63 - 1], [0, -1, 2**63 - 1, -(2**63)]]
    ours = compiled_pairs(targets()[name])(raw)
    assert ours.tobytes() == numpy_pairs(raw).tobytes()
    # One bit of a raw number that counts is seen.
    raw[7, 0, 3] ^= 1 << 12
    assert ours.tobytes() != numpy_pairs(raw).tobytes()
