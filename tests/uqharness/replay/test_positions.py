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
    surface_positions,
)
from uqharness.replay import positions as module
from uqharness.replay.in_lanes import by_jsbsim
from uqharness.simulator import Aircraft, copy_folder, find_aircraft

RATE = "fcs/servo-rate-deg_sec"


@pytest.fixture(autouse=True)
def nothing_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever other tests asked for is forgotten."""
    for name in ("_position_cache", "_chains"):
        monkeypatch.setattr(module, name, OrderedDict())
    module._chain_agrees.cache.clear()


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
    with ReplayFolder(find_aircraft("espaaro")) as result:
        yield result


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
    model: ReplayModel, dt_s: float
) -> None:
    piece = segment(dt_s=dt_s, seed=3)
    (initial,) = surface_positions(model, [piece], CONTROLS)
    np.testing.assert_allclose(initial, in_jsbsim(model, piece), rtol=0.0, atol=1e-12)
    assert apart(initial, piece.controls) > 0.01


def test_a_servo_that_reads_the_airspeed_is_flown_with_its_aircraft(tmp_path: Path) -> None:
    with ReplayFolder(
        changed(
            tmp_path,
            f"<rate_limit>{RATE}</rate_limit>",
            "<rate_limit>aero/qbar-psf</rate_limit>",
        )
    ) as copy:
        piece = segment(seed=7)
        (initial,) = surface_positions(copy, [piece], CONTROLS)
        np.testing.assert_allclose(initial, in_jsbsim(copy, piece), rtol=0.0, atol=1e-9)
        faster = replace(piece, start=piece.start * np.array([1.5, *[1.0] * 8]))
        (other,) = surface_positions(copy, [faster], CONTROLS)
        np.testing.assert_allclose(other, in_jsbsim(copy, faster), rtol=0.0, atol=1e-9)
        assert apart(other, initial) > 1e-3
