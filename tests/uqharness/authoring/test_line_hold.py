"""The line hold of an authored aircraft: closed loops, and flights that fixed controls lose."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from uqharness.authoring.line_hold import GLIDE, LATERAL, LONGITUDINAL, regulator
from uqharness.commands.authoring import author
from uqharness.commands.simulation import fly
from uqharness.errors import BadInputError
from uqharness.requests.authoring import AuthorRequest
from uqharness.requests.simulation import FlyRequest
from uqharness.simulator import (
    StartSection,
    SteadyCondition,
    find_aircraft,
    find_trim,
    linearise,
    write_steady_start,
)

DATA = Path(__file__).parent / "data"


@pytest.fixture(scope="module")
def kite(tmp_path_factory):
    folder = tmp_path_factory.mktemp("line-hold") / "kite"
    author(AuthorRequest(sources=(DATA / "kite.st", DATA / "kite.mass"), out=folder))
    return find_aircraft(folder)


def test_no_regulator_without_controls(kite):
    model = linearise(kite, find_trim(kite, SteadyCondition(13.6, 200.0)))
    for states, controls in (
        (LONGITUDINAL, ("elevator", "throttle")),
        (LATERAL, ("aileron", "rudder")),
    ):
        gains, rows = regulator(model, states)
        assert rows == controls
        assert gains.shape == (2, 7)
    idle = replace(model, B=np.zeros_like(model.B))
    with pytest.raises(BadInputError, match="no control moves it"):
        regulator(idle, LATERAL)


@pytest.mark.parametrize(("engaged", "constant"), [(1, True), (0, False)])
def test_hold_flies_a_corner_that_fixed_controls_lose(engaged, constant, kite, tmp_path):
    """The corner of a nose-heavy, rolling aeroplane, in light turbulence."""
    corner = {f"uq/{c}/level": level for c, level in (("Cl", 1.0), ("Cm", 0.2), ("Cn", 0.0))}
    path = tmp_path / "record.csv"
    fly(
        FlyRequest(
            aircraft=str(kite.folder),
            mission="steady",
            speed_mps=13.6,
            altitude_m=200,
            duration_s=20,
            turbulence="light",
            properties={"ap/engaged": engaged, "uq/active": 1.0, **corner},
            out=path,
        )
    )
    record = pd.read_csv(path, comment="#")
    first, late = record.iloc[0], record[record.time_s > 12.0]
    # The servos begin at the trim, not at what the law computes before the flight.
    assert abs(first.aileron_pos_deg) < 1.0
    distant = max(
        late.h_m.abs().max(), late.cross_track_m.abs().max(), (late.V_mps - 13.6).abs().max()
    )
    assert (distant < 8.0) == constant


def test_start_on_an_autopilot_needs_one(kite, tmp_path):
    start = StartSection(V_mps=13.6, altitude_m=200, autopilot=True)
    script = tmp_path / "steady.xml"
    write_steady_start(kite, start, script, "x")
    assert '<property value="1">ap/engaged</property>' in script.read_text()
    with pytest.raises(BadInputError, match="no autopilot = "):
        write_steady_start(
            find_aircraft("espaaro"), start.model_copy(update={"V_mps": 22.2}), script, "x"
        )


def test_a_glider_holds_its_speed_by_the_elevator(tmp_path):
    sources = (DATA / "kite.st", DATA / "kite.mass")
    folder = tmp_path / "glider"
    author(AuthorRequest(sources=sources, thrust_n=0.0, out=folder))
    campaign = (folder / "campaign.toml").read_text()
    assert "autopilot = true" in campaign
    assert "altitude_m = 304" in campaign
    glider = find_aircraft(folder)
    trim = find_trim(glider, SteadyCondition(13.6, 1000.0))
    assert trim.condition.climb_rad < 0.0
    gains, controls = regulator(linearise(glider, trim), GLIDE)
    assert controls == ("elevator",)
    # Slow: nose down, which is elevator up on the scale of this project.
    assert gains[0, GLIDE.index("speed")] > 0.0
    path = tmp_path / "glide.csv"
    fly(
        FlyRequest(
            aircraft=str(folder),
            mission="steady",
            speed_mps=13.6,
            altitude_m=1000,
            duration_s=25,
            properties={"ap/engaged": 1.0, "uq/active": 1.0, "uq/Cm/level": 0.2},
            out=path,
        )
    )
    record = pd.read_csv(path, comment="#")
    assert abs(record.V_mps.iloc[-1] - 13.6) < 0.2
    assert record.h_m.iloc[-1] < -10.0
