"""A mission made ready: what keeps its value, what JSBSim is asked for, which start a
flight has.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.batch_flights import START, aircraft, craft
from tests.helpers.batch_whole import copied, spec
from uqharness.batch.course import fly_many, record_many
from uqharness.batch.mission import initial_values
from uqharness.errors import BadInputError
from uqharness.flight.fly import record_mission, scored_signals, staged_mission
from uqharness.simulator import (
    StartSection,
    copy_folder,
    engine,
    find_aircraft,
    write_own_mission,
)

BODY = """<system name='s'><property value='3'>s/declared</property><property value='3'>velocities/vc-kts</property>
<function name='s/f'><sum><property>position/vrp-radius-ft</property><property>s/declared</property></sum></function></system>
<aerodynamics/>"""


def test_values_before_the_first_frame():
    with craft(aircraft(BODY), START) as result:
        value = initial_values(result.open)
        fdm = result.open()
        engine.run_ic(fdm)
    # Loading alone does not make mass and metrics.
    assert value("inertia/mass-slugs") == fdm["inertia/mass-slugs"] > 0.0
    assert value("s/declared") == 3.0
    assert value("s/unheard-of") is None
    assert value("aero/qbar-area") == 0.0


def test_what_the_model_computes_cannot_be_set():
    """JSBSim's engine says the same of a property that initialising overwrites."""
    with pytest.raises(BadInputError, match="uq/CZ/delta was set to 1 and is 0 after initialising"):
        fly_many([spec(properties={"uq/CZ/delta": 1.0}, duration_s=2.0)])


def test_an_aircraft_that_was_edited_is_translated_anew(tmp_path):
    plane = copied(tmp_path)
    inputs = spec(plane, duration_s=5.0)
    (before,) = fly_many([inputs])
    file = plane / "espaaro.xml"
    file.write_text(file.read_text().replace("</fdm_config>", "<!-- --></fdm_config>"))
    (same,) = fly_many([inputs])
    assert before.signals["cross_track"].tobytes() == same.signals["cross_track"].tobytes()
    text = (plane / "Systems/autopilot.xml").read_text()
    compass = (
        "<magnetometer name='m'><location/><output>fcs/elevator-cmd-norm</output></magnetometer>"
    )
    (plane / "Systems/autopilot.xml").write_text(
        text.replace("</channel>", f"{compass}</channel>", 1)
    )
    with pytest.raises(BadInputError):
        fly_many([inputs])


def test_a_flight_starts_with_the_control_system_at_rest(tmp_path):
    folder = tmp_path / "aircraft" / "x24b"
    folder.parent.mkdir()
    copy_folder(find_aircraft("x24b").folder, folder)
    script, _ = write_own_mission(
        find_aircraft(folder), StartSection(V_mps=196.1, altitude_m=3000.0), "steady"
    )
    inputs = spec(
        aircraft=str(folder),
        script=str(script),
        duration_s=1.0,
        burn_in_s=0.0,
        turbulence="none",
        sensor_noise=False,
    )

    def recorded():
        """Return the signals of both engines, JSBSim's first."""
        staged = staged_mission(inputs)
        flights = record_mission(staged, inputs, scored_signals(staged)), *record_many([inputs])
        assert [flight.status for flight in flights] == ["ok", "ok"]
        return [{**flight.signals} for flight in flights]

    def difference(one, other):
        """Return the largest difference relative to each signal's size."""
        return max(
            np.abs(one[name] - other[name]).max() / np.abs(one[name]).max()
            for name in one.keys() & other.keys()
            if np.abs(one[name]).max() > 1e-3
        )

    by_jsbsim, by_batch = recorded()
    assert difference(by_jsbsim, by_batch) < 1e-8
    # Without these frames the control system moves at the start.
    text = script.read_text()
    mark = '<property value="1">flight/steady-controls</property>'
    assert mark in text
    script.write_text(text.replace(mark, ""))
    assert difference(by_batch, recorded()[1]) > 1e-4
    script.write_text(text.replace("steady-controls", "steady-rates"))
    # With its body rates free as well.
    assert difference(*recorded()) < 1e-8
