"""Reads the gains of an autopilot from ArduPilot's parameter file, as ground stations and MAVProxy save it."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from sysid.foreign.regular_files import open_regular
from sysid.logs import parse_parameters
from uqharness.errors import BadInputError
from uqharness.flight.autopilot_gains import AutopilotGains, autopilot_gains

_MOST_BYTES = 10_000_000


def read_gains(path: Path, properties: Collection[str]) -> AutopilotGains:
    """Gains in a .parm or .param file for an aircraft with these properties.

    Parameters
    ----------
    path
        Text, a parameter's name and value a line.
    properties
        Names of the aircraft's properties; gains are those under ``ap/``.

    Raises
    ------
    BadInputError
        With file and line: no such file, a line that is no parameter, a value that a loop cannot have, PX4's parameters, and an
        aircraft or a file without such gains.
    """
    try:
        with open_regular(path) as file:
            content = file.read(_MOST_BYTES + 1)
    except OSError as error:
        raise BadInputError(
            f"{path}: {error.strerror or error}; give an ArduPilot parameter file (.parm or .param)"
        ) from None
    if len(content) > _MOST_BYTES or b"\0" in content:
        raise BadInputError(
            f"{path}: is no parameter file: a text with a name and a value a line (.parm or .param)"
        )
    text = content.decode("utf-8-sig", errors="replace")
    try:
        return autopilot_gains(parse_parameters(text), properties)
    except ValueError as error:
        raise BadInputError(f"{path}: {_line_of(text, str(error))}{error}") from None


def _line_of(text: str, message: str) -> str:
    """'line 3: ' of the parameter whose name begins the message; the last line counts, as it does in reading."""
    name = message.split()[0]
    found = [
        n
        for n, line in enumerate(text.splitlines(), 1)
        if name in line.split("#")[0].replace(",", " ").split()
    ]
    return f"line {found[-1]}: " if found else ""
