"""Replays in lanes and forces at given states: a row does not depend on how it was computed."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from tests.helpers.few import few
from uqharness import batch
from uqharness.batch import replay as module
from uqharness.errors import BadInputError
from uqharness.replay import CONTROLS, ReplayFolder
from uqharness.replay.replay import RAW
from uqharness.simulator import find_aircraft

FRAMES, DT_S = 48, 0.0025


INPUT = "aero/Cm_q"


@cache
def program(stride: int) -> batch.ReplayProgram:
    with ReplayFolder(find_aircraft("espaaro")) as model:
        root = model.staging.root
        files = batch.Files(
            model.staging.folder, model.staging.xml, root / "engine", root / "systems"
        )
        controls = [model.card.inputs[name].property for name in CONTROLS]
        return batch.make_replay(
            batch.read_sources(files, None),
            lambda: model.open(DT_S),
            DT_S,
            controls,
            [INPUT],
            [*RAW],
            stride,
        )


def lane(frames: int = FRAMES, value: float = -13.8) -> batch.ReplayLane:
    conditions = {
        "ic/lat-geod-rad": 0.6,
        "ic/long-gc-rad": 0.0,
        "ic/geod-alt-ft": 400.0,
        "ic/phi-rad": 0.1,
        "ic/theta-rad": 0.05,
        "ic/psi-true-rad": 1.0,
        "ic/u-fps": 72.0,
        "ic/v-fps": 0.5,
        "ic/w-fps": 1.0,
        "ic/p-rad_sec": 0.05,
        "ic/q-rad_sec": -0.02,
        "ic/r-rad_sec": 0.03,
    }
    controls = np.repeat([[0.2, 0.1, -0.1, 60.0]], frames + 1, axis=0)
    controls[10:, 0] = 2.0
    return batch.ReplayLane({INPUT: value}, conditions, 0.0, controls, DT_S)


def flown(stride: int, *lanes: batch.ReplayLane) -> list[np.ndarray]:
    found = dict(batch.fly_replays(program(stride), lanes))
    return [found[k] for k in range(len(lanes))]


@pytest.mark.parametrize("stride", few([8, 2], 1))
def test_rows_do_not_depend_on_how_many_frames_lie_between_them(stride):
    (every,), (some,) = flown(1, lane()), flown(stride, lane())
    assert every.shape == (FRAMES + 1, len(RAW))
    assert some.tobytes() == every[::stride].tobytes()


def test_lanes_flown_in_many_calls_are_those_of_one(monkeypatch):
    lanes = [lane(FRAMES if k % 3 else 24, -13.8 - 0.1 * k) for k in range(20)]
    together = flown(8, *lanes)
    monkeypatch.setattr(module, "_RECORD_BYTES", 1)
    apart = flown(8, *lanes)
    assert [len(rows) for rows in together] == [4 if k % 3 == 0 else 7 for k in range(20)]
    assert [a.tobytes() for a in apart] == [b.tobytes() for b in together]
    # Lanes differ, so that one in another's place would be noticed.
    assert len({rows.tobytes() for rows in together}) == len(lanes)


DT_S_FORCED, INPUT_FORCED = 0.0025, "aero/Cm_q"


RECORDS = ("forces/fbz-aero-lbs", "moments/m-total-lbsft", "aero/qbar-psf")


CONDITIONS = {
    "ic/lat-geod-rad": 0.6,
    "ic/long-gc-rad": 0.0,
    "ic/geod-alt-ft": 400.0,
    "ic/phi-rad": 0.1,
    "ic/theta-rad": 0.05,
    "ic/psi-true-rad": 0.0,
    "ic/u-fps": 72.0,
    "ic/v-fps": 0.5,
    "ic/w-fps": 1.0,
    "ic/p-rad_sec": 0.05,
    "ic/q-rad_sec": -0.02,
    "ic/r-rad_sec": 0.03,
}


@cache
def programs() -> tuple[batch.StateProgram, batch.ReplayProgram]:
    with ReplayFolder(find_aircraft("espaaro"), ideal=CONTROLS) as model:
        root = model.staging.root
        sources = batch.read_sources(
            batch.Files(model.staging.folder, model.staging.xml, root / "engine", root / "systems"),
            None,
        )
        controls = [model.card.inputs[name].property for name in CONTROLS]

        def open_fdm():
            return model.open(DT_S_FORCED)

        forced = batch.make_states(
            sources, open_fdm, DT_S_FORCED, controls, [INPUT_FORCED], RECORDS
        )
        with pytest.raises(BadInputError, match="no/such-property"):
            batch.make_states(
                sources, open_fdm, DT_S_FORCED, controls, [INPUT_FORCED], ["no/such-property"]
            )
        return forced, batch.make_replay(
            sources, open_fdm, DT_S_FORCED, controls, [INPUT_FORCED], RECORDS, 1
        )


def both(speed_fps: tuple[float, ...], Cm_q: float) -> tuple[np.ndarray, np.ndarray]:
    forced, replay = programs()
    n = len(speed_fps)
    conditions = {name: np.full(n, value) for name, value in CONDITIONS.items()} | {
        "ic/u-fps": np.array(speed_fps)
    }
    controls = np.column_stack(
        [np.linspace(-3.0, 3.0, n), np.linspace(2.0, -2.0, n), np.full(n, 0.5), np.full(n, 60.0)]
    )
    said = batch.at_states(
        forced, conditions, np.zeros(n), DT_S_FORCED, controls, {INPUT_FORCED: Cm_q}
    )
    lanes = [
        batch.ReplayLane(
            {INPUT_FORCED: Cm_q},
            {c: v[k] for c, v in conditions.items()},
            0.0,
            np.repeat(controls[[k]], 2, axis=0),
            DT_S_FORCED,
        )
        for k in range(n)
    ]
    flown = dict(batch.fly_replays(replay, lanes))
    return said, np.array([flown[k][0] for k in range(n)])


def test_states_are_the_first_rows_of_replays_from_there():
    said, begun = both((60.0, 72.0, 85.0), -13.8)
    np.testing.assert_allclose(said, begun, rtol=1e-12)
