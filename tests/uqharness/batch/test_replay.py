"""Replays in lanes and forces at given states: a row does not depend on how it was computed."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from tests.helpers.few import few
from uqharness import batch
from uqharness.batch import llvm_flight
from uqharness.batch.llvm import build_code, choose_target
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
            stride=stride,
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


def fly(stride: int, *lanes: batch.ReplayLane) -> list[np.ndarray]:
    result = dict(batch.fly_replays(program(stride), lanes))
    return [result[k] for k in range(len(lanes))]


@pytest.mark.parametrize("stride", few([8, 2], 1))
def test_rows_do_not_depend_on_how_many_frames_lie_between_them(stride):
    (every,), (some,) = fly(1, lane()), fly(stride, lane())
    assert every.shape == (FRAMES + 1, len(RAW))
    assert some.tobytes() == every[::stride].tobytes()


def test_rows_do_not_depend_on_how_frames_are_compiled(monkeypatch):
    rows = []
    for calls, quick_frames in ((10**9, 10**9), (0, 10**9), (0, 0)):
        monkeypatch.setattr(llvm_flight, "INTERPRETED_CALLS", calls)
        monkeypatch.setattr(llvm_flight, "QUICK_FRAMES", quick_frames)
        rows.append(fly(1, lane())[0])
    for flyer in (program(1).flyer, program(1).initialisers[0]):
        assert {"_quick", "_optimised"} <= set(vars(flyer))
    assert rows[0].tobytes() == rows[1].tobytes() == rows[2].tobytes()


def test_quick_code_gives_way_to_optimised_code_in_the_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("UQ_CACHE", str(tmp_path))

    def names_after(quick: bool) -> set[str]:
        build_code.cache_clear()
        llvm_flight.compile_program(program(1).program, choose_target(), quick)
        return {path.name for path in (tmp_path / "objects").iterdir()}

    (quick,) = names_after(True)
    (optimised,) = names_after(False) - {quick}
    (tmp_path / "objects" / quick).unlink()
    assert names_after(True) == {optimised}


DT_S_FORCED, INPUT_FORCED = 0.0025, "aero/Cm_q"
