"""Forces at given states: the row with which a replay from there begins."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from uqharness import batch
from uqharness.errors import BadInputError
from uqharness.replay import CONTROLS, ReplayFolder
from uqharness.simulator import find_aircraft

DT_S, INPUT = 0.0025, "aero/Cm_q"
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
            return model.open(DT_S)

        forced = batch.make_states(sources, open_fdm, DT_S, controls, [INPUT], RECORDS)
        with pytest.raises(BadInputError, match="no/such-property"):
            batch.make_states(sources, open_fdm, DT_S, controls, [INPUT], ["no/such-property"])
        return forced, batch.make_replay(sources, open_fdm, DT_S, controls, [INPUT], RECORDS, 1)


def both(speed_fps: tuple[float, ...], Cm_q: float) -> tuple[np.ndarray, np.ndarray]:
    forced, replay = programs()
    n = len(speed_fps)
    conditions = {name: np.full(n, value) for name, value in CONDITIONS.items()} | {
        "ic/u-fps": np.array(speed_fps)
    }
    controls = np.column_stack(
        [np.linspace(-3.0, 3.0, n), np.linspace(2.0, -2.0, n), np.full(n, 0.5), np.full(n, 60.0)]
    )
    said = batch.at_states(forced, conditions, np.zeros(n), DT_S, controls, {INPUT: Cm_q})
    lanes = [
        batch.ReplayLane(
            {INPUT: Cm_q},
            {c: v[k] for c, v in conditions.items()},
            0.0,
            np.repeat(controls[[k]], 2, axis=0),
            DT_S,
        )
        for k in range(n)
    ]
    flown = dict(batch.fly_replays(replay, lanes))
    return said, np.array([flown[k][0] for k in range(n)])


def test_states_are_the_first_rows_of_replays_from_there():
    said, begun = both((60.0, 72.0, 85.0), -13.8)
    np.testing.assert_allclose(said, begun, rtol=1e-12)


def test_another_property_is_another_moment_alone():
    said, other = both((72.0,), -13.8)[0], both((72.0,), -20.0)[0]
    assert abs(other[0, 1] - said[0, 1]) > 1e-3
    np.testing.assert_array_equal(other[0, [0, 2]], said[0, [0, 2]])
