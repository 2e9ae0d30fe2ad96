"""Surface positions by actuators alone, against the whole aircraft in JSBSim."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.uqharness.replay.test_in_lanes import DT_S, apart, segment
from uqharness.replay import (
    CHANNELS,
    CONTROLS,
    ReplayFolder,
    ReplayJob,
    ReplayModel,
    Segment,
    positions,
    surface_positions,
)
from uqharness.replay import positions as module
from uqharness.replay.in_lanes import by_jsbsim
from uqharness.simulator import Aircraft, copy_folder, find_aircraft

RATE = "fcs/servo-rate-deg_sec"
LAG = "<lag>25</lag>"


@pytest.fixture(autouse=True)
def nothing_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever other tests asked for is forgotten."""
    for name in ("_position_cache", "_chains"):
        monkeypatch.setattr(module, name, OrderedDict())
    module._chain_agrees.cache.clear()


@pytest.fixture
def flights(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """How many stretches were flown by components alone, and by whole aircraft."""
    count = {"chain": 0, "whole": 0}

    def counted(kind: str, real):
        def call(*args: object):
            count[kind] += (
                len(args[1])
                if kind == "whole"
                else sum(len(s.time_s) > module._TRIAL_ROWS for s in args[2])
            )
            return real(*args)

        return call

    monkeypatch.setattr(module, "fly_chain", counted("chain", module.fly_chain))
    monkeypatch.setattr(module, "_fly_aircraft", counted("whole", module._fly_aircraft))
    return count


def changed(tmp_path: Path, old: str, new: str) -> Aircraft:
    """The E-SPAARO with a text of its XML replaced everywhere."""
    folder = tmp_path / "espaaro"
    copy_folder(find_aircraft("espaaro").folder, folder)
    xml = folder / "espaaro.xml"
    text = xml.read_text(encoding="utf-8")
    assert old in text
    xml.write_text(text.replace(old, new), encoding="utf-8")
    return find_aircraft(folder)


@pytest.fixture(scope="module")
def model() -> Iterator[ReplayModel]:
    """The E-SPAARO, surfaces commanded."""
    with ReplayFolder(find_aircraft("espaaro")) as made:
        yield made


def in_jsbsim(
    model: ReplayModel, piece: Segment, properties: dict[str, float] | None = None
) -> np.ndarray:
    """Positions of the whole aircraft [record units]; the E-SPAARO's are in these."""
    job = ReplayJob(
        model, piece, properties or {}, piece.start, extra=tuple(model.positions().values())
    )
    return by_jsbsim(job)[:, len(CHANNELS) :]


@pytest.mark.parametrize("dt_s", [DT_S, 0.01, 0.0213])
def test_components_alone_put_the_surfaces_where_jsbsim_s_aircraft_does(
    model: ReplayModel, flights: dict[str, int], dt_s: float
) -> None:
    piece = segment(dt_s=dt_s, seed=3)
    (stood,) = surface_positions(model, [piece], CONTROLS)
    assert flights == {"chain": 1, "whole": 0}
    np.testing.assert_allclose(stood, in_jsbsim(model, piece), rtol=0.0, atol=1e-12)
    assert apart(stood, piece.controls) > 0.01


def test_a_servo_that_reads_the_airspeed_is_flown_with_its_aircraft(
    flights: dict[str, int], tmp_path: Path
) -> None:
    with ReplayFolder(
        changed(
            tmp_path,
            f"<rate_limit>{RATE}</rate_limit>",
            "<rate_limit>velocities/vt-fps</rate_limit>",
        )
    ) as copy:
        piece = segment(seed=7)
        (stood,) = surface_positions(copy, [piece], CONTROLS)
        np.testing.assert_allclose(stood, in_jsbsim(copy, piece), rtol=0.0, atol=1e-9)
        faster = replace(piece, start=piece.start * np.array([1.5, *[1.0] * 8]))
        surface_positions(copy, [faster], CONTROLS)
        assert flights == {"chain": 0, "whole": 2}


def test_a_chain_that_comes_to_other_positions_is_not_used(
    model: ReplayModel, flights: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    real = module.control_chain

    def wrong(*args):
        found = real(*args)
        return replace(found, xml=found.xml.replace(LAG, "<lag>25.0001</lag>"))

    monkeypatch.setattr(module, "control_chain", wrong)
    piece = segment(seed=8)
    (stood,) = surface_positions(model, [piece], CONTROLS)
    assert flights == {"chain": 0, "whole": 1}
    np.testing.assert_allclose(stood, in_jsbsim(model, piece), rtol=0.0, atol=1e-9)


def in_both(
    model: ReplayModel,
    cut: list[Segment],
    servos: dict[str, float],
    monkeypatch: pytest.MonkeyPatch,
) -> list[list[np.ndarray]]:
    """Positions by the components alone: by JSBSim, and by the batch engine, which must
    have flown.
    """
    flown = []
    monkeypatch.setattr(positions, "_programs", {})
    real = positions._fly_batch
    monkeypatch.setattr(
        positions,
        "_fly_batch",
        lambda program, asked, some: flown.append(len(some)) or real(program, asked, some),
    )
    out = []
    for worth_s in (1e9, 0.0):
        monkeypatch.setattr(module, "_position_cache", OrderedDict())
        monkeypatch.setattr(positions, "MIN_CHAIN_BATCH_S", worth_s)
        assert not flown
        out.append(surface_positions(model, cut, CONTROLS, servos))
    # One to be compared with, then all.
    assert flown == [1, len(cut)]
    return out


def test_the_batch_engine_moves_the_components_as_jsbsim_does(
    model: ReplayModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    cut = [segment(seed=21), segment(seed=22, rows=130)]
    for servos in ({}, {RATE: 60.0}):
        theirs, ours = in_both(model, cut, servos, monkeypatch)
        for a, b, piece in zip(theirs, ours, cut, strict=True):
            np.testing.assert_allclose(b, a, rtol=0.0, atol=1e-11)
            assert apart(a, piece.controls) > 0.01
