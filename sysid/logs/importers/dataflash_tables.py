"""From the columns of a DataFlash log, binary or text, to a RawLog: instances split, parameters, texts, vehicle."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.errors import Finding, LogError
from sysid.foreign.raw import MessageTable, RawLog
from sysid.logs.importers.dataflash_format import Format

Columns = dict[str, NDArray[Any]]
# Messages that identify the vehicle, its parameters and its modes; small in every log.
MOST_INSTANCES = 256  # of one kind of message
ALWAYS = frozenset({"PARM", "MSG", "MODE", "VER", "ARM", "EV", "ORGN"})
# VER.BU, the number of the firmware's build type.
_BUILD = {
    1: "ArduRover",
    2: "ArduCopter",
    3: "ArduPlane",
    4: "AntennaTracker",
    7: "ArduSub",
    12: "Blimp",
    13: "Heli",
}
_ONLY_IN = {
    "ATC_RAT_RLL_P": "ArduCopter",
    "RATE_RLL_P": "ArduCopter",
    "WPNAV_SPEED": "ArduCopter",
    "ATC_STR_RAT_P": "ArduRover",
    "RLL2SRV_TCONST": "ArduPlane",
    "ARSPD_FBW_MIN": "ArduPlane",
}
_VEHICLE = re.compile(
    r"^(Ardu|APM[: ]?)(Plane|Copter|Rover|Sub)|^(AntennaTracker|Blimp|Rover)", re.IGNORECASE
)


def assemble(
    dialect: str,
    columns: dict[str, Columns],
    formats: Mapping[str, Format],
    counts: Mapping[str, int],
    findings: list[Finding],
    path: Path,
    places: Mapping[str, NDArray[np.int64]] | None = None,
    headers: tuple[int, ...] = (),
) -> RawLog:
    """Split instances and pull out parameters, texts and vehicle. Raises LogError when nothing carries a time.

    places   position in the file of each record, by message      headers  positions of further headers of a log
    """
    places = places or {}
    messages: dict[tuple[str, int], MessageTable] = {}
    for name in list(columns):
        fmt = formats[name]
        stamp = fmt.time_column
        if stamp is None or stamp[0] not in columns[name]:
            continue
        table = columns[name]
        time_s = table[stamp[0]] / np.float64(round(1.0 / stamp[1]))
        for instance, rows in _instances(table, fmt.instance_column):
            fields = {
                c: v[rows] for c, v in table.items() if c not in (stamp[0], fmt.instance_column)
            }
            place = places.get(name)
            order = place[rows] if place is not None and len(place) == len(time_s) else None
            messages[(name, instance)] = MessageTable(time_s[rows], fields, order)
        if name not in ALWAYS:
            del columns[name]  # the messages hold what is needed; a big log must not be there twice
    if not messages:
        raise LogError(
            "no message carries a time stamp (TimeUS or TimeMS); nothing can be placed in time",
            path,
        )
    texts, parameters = _texts(messages), _parameters(columns)
    said = messages.get(("MSG", 0))
    set_at = places.get("PARM")
    return RawLog(
        headers=headers,
        text_places=() if said is None or said.place is None else tuple(said.place.tolist()),
        parameter_log=()
        if set_at is None or not parameters
        else tuple(
            (int(at), str(n), float(v))
            for at, n, v in zip(
                set_at, columns["PARM"]["Name"], columns["PARM"]["Value"], strict=False
            )
        ),
        dialect=dialect,
        messages=messages,
        counts=dict(counts),
        parameters=parameters,
        texts=texts,
        vehicle=_vehicle(texts, columns, parameters),
        findings=tuple(findings),
    )


def _instances(table: Columns, column: str | None) -> list[tuple[int, Any]]:
    """(instance, its rows); a column of more numbers than any vehicle has sensors counts something else."""
    if column is None or column not in table:
        return [(0, slice(None))]
    numbers = table[column]
    if len(numbers) and numbers.min() == numbers.max():
        return [(int(numbers[0]), slice(None))]
    found = np.unique(numbers)
    return (
        [(int(i), numbers == i) for i in found]
        if len(found) <= MOST_INSTANCES
        else [(0, slice(None))]
    )


def _texts(messages: Mapping[tuple[str, int], MessageTable]) -> tuple[tuple[float, str], ...]:
    table = messages.get(("MSG", 0))
    if table is None or "Message" not in table.fields:
        return ()
    return tuple(
        (float(t), str(m)) for t, m in zip(table.time_s, table.fields["Message"], strict=True)
    )


def _parameters(columns: dict[str, Columns]) -> dict[str, float]:
    table = columns.get("PARM", {})
    if "Name" not in table or "Value" not in table:
        return {}
    return {str(n): float(v) for n, v in zip(table["Name"], table["Value"], strict=True)}


def _vehicle(
    texts: tuple[tuple[float, str], ...],
    columns: dict[str, Columns],
    parameters: Mapping[str, float],
) -> str:
    """What the log calls itself, else what its parameters are of; an aeroplane that takes off on rotors says VTOL."""
    named = _named(texts, columns)
    if not named:
        # Parameters that one kind of vehicle alone has.
        named = next((kind for name, kind in _ONLY_IN.items() if name in parameters), "")
    return (
        f"{named or 'ArduPlane'} VTOL"
        if parameters.get("Q_ENABLE", 0.0) > 0.0 and "VTOL" not in named
        else named
    )


def _named(texts: tuple[tuple[float, str], ...], columns: dict[str, Columns]) -> str:
    build = columns.get("VER", {}).get("BU")
    for _, message in texts:
        if _VEHICLE.match(message):
            return message
    if build is not None and len(build):
        return _BUILD.get(int(build[0]), "")
    return ""
