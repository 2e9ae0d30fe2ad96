"""Streams against what JSBSim's engine meets in the same case; cut anywhere, copied, and
independent of each other.
"""

from __future__ import annotations

import copy

import numpy as np
import pytest

from tests.helpers import batch_oracle
from uqharness.batch.models.winds import NORMALS
from uqharness.batch.streams import (
    GUSTS,
    LEVELS,
    TRANSIENTS,
    HostGusts,
    JsbsimNormals,
    MovingLevels,
    Noise,
    Turbulence,
    noise_streams,
)
from uqharness.flight import Split, stepping
from uqharness.flight.dryden import COMPONENTS, dryden_gusts, dryden_parameters
from uqharness.flight.spec import COEFFICIENTS, LevelDriver, TransientDriver
from uqharness.flight.stepping import level_blocks

AIR = (22.2, 100.0, 30.0, 3.66)
DRAWS = (("a", 3), ("b", 1), ("c", 3), ("d", 2), ("e", 1))
WALK = LevelDriver("walk", 7, "walk-000000", COEFFICIENTS, (0.012,) * 6)


def test_columns_are_what_jsbsims_engine_sets() -> None:
    assert GUSTS.columns == stepping._GUSTS
    assert LEVELS.columns == stepping._LEVELS
    assert TRANSIENTS.columns == stepping._TRANSIENTS
    assert len(NORMALS.columns) == 4


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
    held = dict(zip((slot for slot, _ in draws), noise.initial[1], strict=True))
    for frame in range(1, 41):
        fdm.run()
        for stream in noise_streams(draws):
            if frame % stream.every == 0:
                rows = fed[stream.name]
                held |= zip(
                    stream.columns,
                    rows.array[frame // stream.every - 1 - rows.first_row],
                    strict=True,
                )
        np.testing.assert_allclose(
            [fdm[name] for name in names], [held[slot] for slot, _ in draws], rtol=1e-15
        )


def test_first_draws_may_be_fewer() -> None:
    noise, plain = Noise(11, DRAWS, first_draws=2), JsbsimNormals(11)
    np.testing.assert_array_equal(noise.initial, plain.take(4).reshape(2, 2))
    assert noise.frames(1)["noise/1"].array.tolist() == [plain.take(2).tolist()]


@pytest.mark.parametrize("draws", [DRAWS, (("a", 2), ("b", 2)), (("a", 1),), ()])
def test_frames_cut_the_noise_anywhere_and_copies_go_on(draws: tuple[tuple[str, int], ...]) -> None:
    whole = Noise(5, draws).frames(500)
    cut = Noise(5, draws)
    parts = [cut.frames(n) for n in (1, 0, 2, 97, 150)]
    other = copy.deepcopy(cut)
    parts.append(cut.frames(250))
    again = other.frames(250)
    for stream in noise_streams(draws):
        joined = np.concatenate([part[stream.name].array for part in parts])
        assert joined.tobytes() == whole[stream.name].array.tobytes()
        assert len(joined) == 500 // stream.every
        assert parts[-1][stream.name].first_row == 250 // stream.every
        assert again[stream.name].array.tobytes() == parts[-1][stream.name].array.tobytes()


def test_rates_that_never_meet_are_refused() -> None:
    with pytest.raises(ValueError, match="at most"):
        Noise(1, [("a", 997), ("b", 991)])


def test_turbulence_has_a_generator_of_its_own() -> None:
    turbulence = Turbulence(31)
    rows = np.concatenate([turbulence.rows(n).array for n in (3, 0, 5)])
    assert rows.tobytes() == JsbsimNormals(31).take(32).tobytes()
    assert turbulence.rows(1).first_row == 8


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


@pytest.mark.parametrize(
    "driver",
    [
        WALK,
        LevelDriver("white", 7, "white-000000", COEFFICIENTS),
        TransientDriver(7, 3, ("CX", "Cn"), (0.9, 1.4)),
    ],
)
def test_levels_are_those_of_jsbsims_engine(driver: LevelDriver | TransientDriver) -> None:
    theirs = np.concatenate(list(level_blocks(driver, 3000, 0.01)))
    levels = MovingLevels(driver, 0.01)
    first = levels.rows(1234).array
    other = copy.deepcopy(levels)
    last = levels.rows(1766)
    assert np.concatenate([first, last.array]).tobytes() == theirs.tobytes()
    assert last.first_row == 1234
    assert other.rows(1766).array.tobytes() == last.array.tobytes()


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


def test_gusts_that_branch_where_they_stand_are_those_with_the_split_from_the_start() -> None:
    """Within a page, at its end, and twice; without memory of the page there is none."""
    parameters = dryden_parameters(*AIR)
    for frame in (300, 8192, 9000):
        own = HostGusts(parameters, 0.01, 5)
        own.keep_branching_state()
        own.rows(frame)
        first = Split(frame, 1, 2, 3, 4)
        branch = own.branched(first)
        assert branch is not None
        np.testing.assert_array_equal(
            branch.rows(700).array, gusts_with((first,), frame + 700)[frame:]
        )
        second = Split(frame + 700, 1, 2, 3, 5)
        again = branch.branched(second)
        assert again is not None
        np.testing.assert_array_equal(
            again.rows(9000).array, gusts_with((first, second), frame + 9700)[frame + 700 :]
        )
        np.testing.assert_array_equal(own.rows(500).array, gusts_with((), frame + 500)[frame:])
    with pytest.raises(ValueError, match="are at row"):
        own.branched(Split(3, 1, 2, 3, 4))
    forgetful = HostGusts(parameters, 0.01, 5)
    forgetful.rows(300)
    assert forgetful.branched(Split(300, 1, 2, 3, 4)) is None


def gusts_with(splits: tuple[Split, ...], rows: int) -> np.ndarray:
    return HostGusts(dryden_parameters(*AIR), 0.01, 5, splits=splits).rows(rows).array
