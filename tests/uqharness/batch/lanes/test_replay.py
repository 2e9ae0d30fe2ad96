"""Replays in lanes: what a row shows does not depend on how it was computed."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from tests.helpers.few import few
from uqharness import batch
from uqharness.batch import replay as module
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


def test_a_row_of_another_frame_is_another():
    (every,), (some,) = flown(1, lane()), flown(8, lane())
    assert some[1:].tobytes() != every[7:-1:8].tobytes()


def test_lanes_flown_in_many_calls_are_those_of_one(monkeypatch):
    lanes = [lane(FRAMES if k % 3 else 24, -13.8 - 0.1 * k) for k in range(20)]
    together = flown(8, *lanes)
    monkeypatch.setattr(module, "_RECORD_BYTES", 1)
    apart = flown(8, *lanes)
    assert [len(rows) for rows in together] == [4 if k % 3 == 0 else 7 for k in range(20)]
    assert [a.tobytes() for a in apart] == [b.tobytes() for b in together]
    # Lanes differ, so that one in another's place would be noticed.
    assert len({rows.tobytes() for rows in together}) == len(lanes)


def test_lanes_of_other_lengths_share_calls_and_rows_are_those_of_each_alone(monkeypatch):
    lengths = [FRAMES, 8, 47, 46, 24, 45, 46, 16, 45, 30]
    lanes = [lane(frames, -13.8 - 0.1 * k) for k, frames in enumerate(lengths)]
    calls = []
    made = module._fly_part
    monkeypatch.setattr(
        module,
        "_fly_part",
        lambda replay, jobs, values: (calls.append(len(jobs)), made(replay, jobs, values))[1],
    )
    together = flown(1, *lanes)
    # Eight lie side by side, whatever their lengths; what is much shorter than the longest begins a
    # call of its own.
    assert calls == [8, 2]
    assert [len(rows) for rows in together] == [frames + 1 for frames in lengths]
    for one, rows in zip(lanes, together, strict=True):
        assert flown(1, one)[0].tobytes() == rows.tobytes()
