"""Charts of one flight: a chart for what the record has, none for what it lacks; the burn-in is
shaded.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from lxml import etree

from uqharness.flight.spec import FlightSpec
from uqharness.report.rerun import flight_figures

TIME = np.arange(0.0, 10.0, 0.1)
RECORD = pd.DataFrame(
    {
        "time_s": TIME,
        "V_mps": 20.0 + np.sin(TIME),
        "h_m": 100.0,
        "phi_rad": 0.1,
        "ve_mps": 20.0,
        "vn_mps": np.cos(TIME),
        "error_cross_track": 3.0,
        "elevator_pos_deg": -1.0,
        "elevator_deg": -2.0,
        "throttle_pct": 60.0,
        "level_CX": 0.3,
        "delta_CX": 0.01,
        "level_Cm": 0.7,
        "delta_Cm": 0.0,
    }
)


def spec(**more):
    class Flight:
        burn_in_s = 2.0
        excursion_radius_m = (5.0, 900.0)

    for name, value in more.items():
        setattr(Flight, name, value)
    flight: FlightSpec = Flight()
    return flight


def drawn(record, **more):
    return {
        figure.name: etree.fromstring(str(figure.svg))
        for figure in flight_figures(record, spec(**more))
    }


def words(svg):
    return {e.text for e in svg.iter("text")}


def test_a_chart_for_what_there_is():
    found = drawn(RECORD)
    kinds = ("track", "errors", "angles", "speed", "height", "surfaces", "throttle", "levels")
    assert list(found) == [f"flight-{kind}" for kind in kinds]
    # The position of a surface says more than its command, and a coefficient without a delta is
    # certain.
    assert "elevator_pos_deg" in words(found["flight-surfaces"])
    assert "elevator_deg" not in words(found["flight-surfaces"])
    assert "CX" in words(found["flight-levels"])
    assert "Cm" not in words(found["flight-levels"])
    fewer = drawn(
        RECORD.drop(columns=["throttle_pct", "error_cross_track", "level_CX", "level_Cm"])
    )
    assert set(found) - set(fewer) == {"flight-throttle", "flight-errors", "flight-levels"}
