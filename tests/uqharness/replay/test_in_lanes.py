"""Replays by the batch engine against JSBSim's, and JSBSim as the fallback."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from uqharness.errors import BadInputError
from uqharness.plugin import with_card
from uqharness.replay import (
    ReplayFolder,
    ReplayJob,
    ReplayModel,
    Segment,
    fly_all,
)
from uqharness.replay import in_lanes as module
from uqharness.replay.in_lanes import by_jsbsim
from uqharness.simulator import find_aircraft

ROWS, DT_S = 120, 0.02
NAMES = ("aero/Cm_q", "aero/CZ_alpha", "aero/Cl_p")


def segment(rows: int = ROWS, dt_s: float = DT_S, seed: int = 1) -> Segment:
    """Steps of all controls about level flight."""
    rng = np.random.default_rng(seed)
    constant = np.repeat(rng.normal(size=(rows // 10 + 1, 4)), 10, axis=0)[:rows]
    controls = np.array([0.2, 0.0, 0.0, 60.0]) + constant * np.array([1.5, 2.0, 1.0, 4.0])
    start = np.array([22.2, 0.015, 0.01, 0.1, 0.05, 1.0, 0.05, -0.02, 0.03])
    return Segment("piece", "flight", dt_s * np.arange(rows), controls, start, 130.0, 100.0)


@pytest.fixture(
    scope="module",
    params=[(), ("elevator", "aileron", "rudder")],
    ids=["commands", "measured surfaces"],
)
def model(request: pytest.FixtureRequest) -> Iterator[ReplayModel]:
    """The E-SPAARO for replay."""
    with ReplayFolder(find_aircraft("espaaro"), measured=request.param) as result:
        yield result


def jobs(model: ReplayModel) -> list[ReplayJob]:
    """Lanes of different length, step, lateness, start and properties."""
    rng = np.random.default_rng(2)
    result = []
    for piece in (segment(), segment(90, 0.0213, 3), segment(60, 1.0 / 60.0, 4)):
        for between in (False, True):
            properties = {
                name: model.card.parameters[name].initial * (1.0 + 0.1 * rng.normal())
                for name in NAMES
            }
            start = piece.start * (1.0 + 0.02 * rng.normal(size=9))
            result.append(ReplayJob(model, piece, properties, start, 0.004, between))
    return result


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Largest difference of a channel over its largest size."""
    return float(np.max(np.abs(a - b).max(0) / np.maximum(np.abs(b).max(0), 1e-3)))


def test_replays_agree_with_jsbsim(model: ReplayModel) -> None:
    every = jobs(model)
    for ours, job in zip(fly_all(every), every, strict=True):
        theirs = by_jsbsim(job)
        assert ours.shape == theirs.shape
        assert apart(ours, theirs) < 1e-8


def test_a_change_of_a_ten_thousandth_is_noticed(model: ReplayModel) -> None:
    job = jobs(model)[0]
    other = ReplayJob(
        model,
        job.segment,
        {**job.properties, "aero/Cm_q": job.properties["aero/Cm_q"] * 1.0001},
        job.start,
        0.004,
    )
    assert apart(fly_all([other])[0], by_jsbsim(job)) > 1e-7


def test_rows_behind_a_failure_are_nan(model: ReplayModel) -> None:
    piece = segment()
    wild = ReplayJob(model, piece, {"aero/Cm_q": 1e9}, piece.start)
    calm = ReplayJob(model, piece, {"aero/Cm_q": -13.8}, piece.start)
    ours, reference = fly_all([wild, calm])
    theirs = by_jsbsim(wild)
    assert np.isnan(ours[-1]).all()
    assert np.isfinite(ours[0]).all()
    assert np.isnan(theirs[-1]).all()
    assert apart(reference, by_jsbsim(calm)) < 1e-8


def test_what_is_not_understood_is_flown_by_jsbsim(
    model: ReplayModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise BadInputError("x.xml:3: not understood")

    monkeypatch.setattr(module, "_programs", {})
    monkeypatch.setattr("uqharness.batch.read_sources", refused)
    job = jobs(model)[0]
    np.testing.assert_array_equal(fly_all([job])[0], by_jsbsim(job))


NOISY = """<channel name="Noisy">
  <sensor name="fcs/noisy">
    <input>attitude/phi-rad</input> <noise variation="ABSOLUTE">0.1</noise>
  </sensor>
  <summer name="fcs/unread"> <input>fcs/noisy</input> </summer>
</channel>
"""


@pytest.mark.parametrize("moves", [False, True], ids=["idle", "in the elevator"])
def test_noise_that_moves_nothing_is_no_hindrance(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, moves: bool
) -> None:
    """An open-loop autopilot of JSBSim's c172x has a noisy sensor: replays took twelve times as
    long."""
    folder = tmp_path / "espaaro"
    shutil.copytree(find_aircraft("espaaro").folder, folder)
    xml = folder / "espaaro.xml"
    text = xml.read_text(encoding="utf-8")
    place = text.index('<channel name="Actuators">')
    text = text[:place] + NOISY + text[place:]
    if moves:
        text = text.replace("<input>fcs/elevator-selected-deg</input>", "<input>fcs/unread</input>")
    xml.write_text(text, encoding="utf-8")
    monkeypatch.setattr(module, "_programs", {})
    caplog.set_level("INFO", logger="uqharness")
    with ReplayFolder(find_aircraft(folder)) as noisy:
        (job, *_) = jobs(noisy)
        (ours,) = fly_all([job])
        assert ("random numbers" in caplog.text) == moves
        if not moves:
            assert apart(ours, by_jsbsim(job)) < 1e-8


def test_an_engine_that_differs_is_not_used(
    model: ReplayModel, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    real = module._fly_batch
    monkeypatch.setattr(module, "_programs", {})
    monkeypatch.setattr(
        module,
        "_fly_batch",
        lambda program, some: [rows * (1.0 + 1e-5) for rows in real(program, some)],
    )
    job = jobs(model)[0]
    np.testing.assert_array_equal(fly_all([job])[0], by_jsbsim(job))
    assert "differs" in caplog.text


@pytest.mark.parametrize("name", ["c172p", pytest.param("T37", marks=pytest.mark.slow)])
def test_engines_start_in_their_steady_state_as_in_jsbsim(name: str) -> None:
    """A piston engine with its propeller, two turbines; throttles that move."""
    speed = {"c172p": 50.0, "T37": 90.0}[name]
    aircraft = with_card(find_aircraft(name))
    with ReplayFolder(aircraft) as model:
        rows = 60
        controls = segment(rows).controls * np.array([0.5, 0.3, 0.3, 1.0])
        start = np.array([speed, 0.03, 0.0, 0.02, 0.03, 1.0, 0.0, 0.0, 0.0])
        piece = Segment("piece", "flight", DT_S * np.arange(rows), controls, start, 530.0, 500.0)
        some = [ReplayJob(model, piece, {}, start * (1.0 + 0.01 * k), 0.0) for k in range(3)]
        ours = fly_all(some)
        assert module._programs[module._program_key(some[0])] is not None
        for rows_of, job in zip(ours, some, strict=True):
            assert apart(rows_of, by_jsbsim(job)) < 1e-6
        faster = ReplayJob(model, piece, {}, start, 0.01)
        assert apart(ours[0], by_jsbsim(faster)) > 1e-4
