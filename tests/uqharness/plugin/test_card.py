"""The card of an aircraft that came without one."""

from __future__ import annotations

from sysid.foreign.regular_files import parse_toml
from uqharness.plugin.card import card_text
from uqharness.simulator.facts import AircraftFacts, ControlFacts

CONTROLS = {
    "elevator": ControlFacts(-1, 25.0, "fcs/elevator-pos-deg"),
    "aileron": ControlFacts(0),
    "rudder": ControlFacts(1, 12.5),
    "throttle": ControlFacts(1),
}
FACTS = AircraftFacts(1.97, 3.66, 0.53, 1, CONTROLS)


def test_what_the_flights_told_stands_in_the_card():
    card = parse_toml(card_text("plane", "plane.xml", FACTS, [], errors=False))
    assert card["aircraft"] == {"name": "plane", "xml": "plane.xml", "dt_s": 0.01}
    assert card["reference"] == {"S_m2": 1.97, "b_m": 3.66, "c_m": 0.53}
    elevator = card["inputs"]["elevator"]
    assert (elevator["throw_deg"], elevator["position"], elevator["positive"]) == (
        -25,
        "fcs/elevator-pos-deg",
        "nose up",
    )
    assert card["inputs"]["aileron"]["throw_deg"] == 1.0
    assert "throw_deg" not in card["inputs"]["throttle"]
    assert card["inputs"]["throttle"]["limits"] == [0, 1]
    assert not {"metrics", "parameters"} & card.keys()
