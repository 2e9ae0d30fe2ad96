"""Contact with the ground: the first step in which a point touches, and which, against JSBSim's
weight on wheels.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.batch_flights import DT_S, START, aircraft, craft, flown, started
from tests.helpers.few import few
from uqharness.batch.mission import initial_values
from uqharness.batch.models.auxiliary import POINT, TOUCHED
from uqharness.batch.models.motion import CONDITIONS
from uqharness.batch.translate.flight import TraceRequest, trace_flight
from uqharness.batch.translate.frame import Values, is_constant
from uqharness.flight.fly import contact_points
from uqharness.simulator import engine
from uqharness.simulator.aircraft import find_aircraft

POINTS = {
    "TAIL": ("STRUCTURE", 60, 0, -12, 0),
    "LEFT": ("BOGEY", -5, -20, -30, 1),
    "RIGHT": ("BOGEY", -5, 20, -30, 0),
    "NOSE": ("STRUCTURE", -50, 0, 6, 0),
}
GROUND = (
    "<ground_reactions>"
    + "".join(
        f"""<contact type="{kind}" name="{name}"><location unit="IN"><x>{x}</x><y>{y}</y><z>{z}</z></location>
<static_friction>0.8</static_friction><dynamic_friction>0.5</dynamic_friction><rolling_friction>0.02</rolling_friction>
<spring_coeff unit="LBS/FT">100</spring_coeff><damping_coeff unit="LBS/FT/SEC">10</damping_coeff>
<max_steer unit="DEG">0</max_steer><brake_group>NONE</brake_group><retractable>{retracts}</retractable></contact>"""
        for name, (kind, x, y, z, retracts) in POINTS.items()
    )
    + "</ground_reactions>"
)


def contact(start, steps=120):
    """Step and number of the first contact by JSBSim, and time and number by the translation."""
    given = {
        **START,
        "ic/h-sl-ft": 12.0,
        "ic/u-fps": 0.0,
        "ic/v-fps": 0.0,
        "ic/w-fps": 0.0,
        "ic/q-rad_sec": 0.0,
        **start,
    }
    with craft(aircraft("<aerodynamics/>", ground=GROUND), given) as made:
        fdm, sources = made.open(), made.sources()
        points = contact_points(fdm, find_aircraft(made.root / "aircraft" / "point"))
        conditions = {name: float(fdm[name]) for name in CONDITIONS}
        values = Values(initial_values(made.open), is_constant)
        flight = trace_flight(sources, DT_S, values, TraceRequest((), [], [TOUCHED, POINT], points))
        engine.run_ic(fdm)
        there = fdm.get_property_manager().hasNode
        units = [[f"gear/unit[{k}]/WOW", f"contact/unit[{k}]/WOW"] for k in range(len(POINTS))]
        wow = [engine.handle(fdm, next(name for name in names if there(name))) for names in units]
        first = None
        for step in range(1, steps + 1):
            fdm.run()
            touching = [k for k, node in enumerate(wow) if node.get_double_value()]
            if touching:
                first = (step, touching[0])
                break
    state = started(flight, conditions)
    _, records = flown(flight.frame, state, steps)
    return first, records


@pytest.mark.parametrize(
    ("start", "name"),
    few(
        [
            ({"ic/theta-rad": 0.5, "ic/phi-rad": 0.0}, "TAIL"),
            ({"ic/theta-rad": -0.9, "ic/phi-rad": 0.0}, "NOSE"),
            ({"ic/theta-rad": 0.0, "ic/phi-rad": -0.5}, "LEFT"),
            ({"ic/theta-rad": 0.0, "ic/phi-rad": 0.5, "ic/lat-geod-rad": -0.7}, "RIGHT"),
            ({"ic/theta-rad": 0.0, "ic/phi-rad": 3.0, "ic/h-sl-ft": 5.0}, "NOSE"),
        ],
        2,
    ),
)
def test_the_first_point_and_its_step(start, name):
    first, records = contact(start)
    assert first is not None
    step, number = first
    assert list(POINTS)[number] == name
    assert (records[0, : step - 1] == -1.0).all()
    assert records[0, step - 1 :] == pytest.approx(step * DT_S, abs=1e-12)
    assert (records[1, step - 1 :] == number).all()


def test_gear_that_is_up_does_not_count():
    start = {"ic/theta-rad": 0.0, "ic/phi-rad": -0.5}
    down, _ = contact(start)
    up, records = contact({**start, "gear/gear-cmd-norm": 0.0, "gear/gear-pos-norm": 0.0})
    assert down is not None
    assert up is not None
    assert (down[1], up[0] > down[0]) == (1, True)
    assert records[0, -1] == pytest.approx(up[0] * DT_S, abs=1e-12)


def test_high_up_nothing_touches():
    first, records = contact({"ic/h-sl-ft": 500.0})
    assert first is None
    assert np.unique(records[0]) == [-1.0]
