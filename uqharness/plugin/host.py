"""What an aircraft made for FlightGear reads of it, passed on in JSBSim alone: a system that copies properties.

FlightGear's interface to JSBSim writes commands and engine readings into its own property tree in every frame, and some aircraft
read them there: the p51d takes its throttle from /controls/engines/engine/throttle, and governs it by /engines/engine/mp-inhg.
Without the host these stay at zero.
"""

from __future__ import annotations

from collections.abc import Sequence

HOST_SYSTEM = "flightgear-host"
SWITCH = "host/flightgear"
"""Property that is 1 where copying is on: 0 in the XML, where the aircraft flies as its author's; the card's open loop sets it."""


def host_xml(pairs: Sequence[tuple[str, str]]) -> bytes:
    """The system's XML for pairs of FlightGear's property and JSBSim's own, which is copied to it in every frame."""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        "<!-- FlightGear's properties that the aircraft reads, with what it would write there, a frame late as it does. -->",
        f'<system name="{HOST_SYSTEM}">',
        f'  <property value="0">{SWITCH}</property>',
        f'  <channel name="FlightGear" execute="{SWITCH}">',
    ]
    for number, (theirs, own) in enumerate(pairs):
        lines += [
            f'    <pure_gain name="host/copy-{number}">',
            f"      <input>{own}</input>",
            "      <gain>1</gain>",
            f"      <output>{theirs}</output>",
            "    </pure_gain>",
        ]
    return "\n".join([*lines, "  </channel>", "</system>", ""]).encode()
