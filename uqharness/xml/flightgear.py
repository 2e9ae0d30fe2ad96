"""The protocol file by which FlightGear reads a flight from a text file.

Format: FlightGear's README.protocol and README.IO (generic protocol, ASCII mode): one line a sample, fields in the chunks' order.
"""

from __future__ import annotations

FIELDS = (
    ("latitude-deg", "double", "/position/latitude-deg"),
    ("longitude-deg", "double", "/position/longitude-deg"),
    ("altitude-ft", "double", "/position/altitude-ft"),
    ("roll-deg", "double", "/orientation/roll-deg"),
    ("pitch-deg", "double", "/orientation/pitch-deg"),
    ("heading-deg", "double", "/orientation/heading-deg"),
    ("airspeed-kt", "double", "/velocities/airspeed-kt"),
)
"""Name, type and property of each field of a line. Altitude above sea level, true heading."""


def protocol_xml() -> str:
    """The protocol's text; FlightGear looks for it under Protocol/ of its data folder."""
    lines = ['<?xml version="1.0"?>', "<PropertyList>", "  <generic>", "    <input>"]
    lines += [
        "      <line_separator>newline</line_separator>",
        "      <var_separator>,</var_separator>",
    ]
    for name, kind, node in FIELDS:
        lines += [
            "      <chunk>",
            f"        <name>{name}</name>",
            f"        <type>{kind}</type>",
            f"        <node>{node}</node>",
        ]
        lines.append("      </chunk>")
    return "\n".join([*lines, "    </input>", "  </generic>", "</PropertyList>"]) + "\n"
