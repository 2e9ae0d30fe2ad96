"""Altitude at the start of a flight whose record does not tell it.

Air density changes by 1 % in 100 m, and so does every identified coefficient. Without density or
altitude in the record, the altitude of the aircraft's only initial condition is used, with a
warning.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from lxml import etree

from sysid.record import FlightRecord
from sysid.units import FT_M
from uqharness.errors import BadInputError
from uqharness.simulator.aircraft import parse_xml

_METRES = {"M": 1.0, "FT": FT_M, "KM": 1000.0}
_SETTLES = "a column rho_kgpm3 settles it"


def with_start_altitude(record: FlightRecord, folder: Path) -> tuple[FlightRecord, str]:
    """Return the record with an altitude above sea level, and a warning if that is assumed.

    Parameters
    ----------
    record : FlightRecord
        The flight.
    folder : Path
        Folder of the aircraft with its initial conditions.

    Returns
    -------
    record : FlightRecord
        Unchanged if density or altitude is known, or no assumption is possible.
    warning : str
        Empty if nothing is assumed.
    """
    start = record.metadata.start
    if "rho_kgpm3" in record or "alt_m" in start:
        return record, ""
    altitudes = _initial_altitudes(folder)
    # Several initial conditions, or none: nothing can be assumed.
    if len(altitudes) != 1:
        return (
            record,
            (
                "the record has neither rho_kgpm3 nor the altitude of its start; it was flown in"
                " the air of sea level: 100 m more are 1 % less density, which goes into every"
                f" coefficient; {_SETTLES}"
            ),
        )
    name, altitude = altitudes[0]
    metadata = replace(record.metadata, start={**start, "alt_m": altitude})
    return (
        record.with_columns({}, metadata),
        (
            f"the record has neither rho_kgpm3 nor the altitude of its start; {altitude:g} m above"
            f" sea level were taken from {name}: 100 m more are 1 % less density, which goes into"
            f" every coefficient; {_SETTLES}"
        ),
    )


def _initial_altitudes(folder: Path) -> list[tuple[str, float]]:
    """Return (file, altitude above sea level [m]) of the initial conditions that give one."""
    altitudes = []
    for path in sorted(folder.glob("*.xml")):
        try:
            root = parse_xml(path).getroot()
        except BadInputError:
            continue
        if root.tag != "initialize":
            continue
        # JSBSim: altitude above sea level, or above the ground at an elevation.
        ground = _length(root, "elevation")
        above = [_length(root, "altitudeAGL"), _length(root, "altitude")]
        sea = _length(root, "altitudeMSL")
        agl = next((a for a in above if a is not None), None)
        if sea is None and agl is not None:
            sea = agl + (ground or 0.0)
        if sea is not None:
            altitudes.append((path.name, sea))
    return altitudes


def _length(root: etree._Element, tag: str) -> float | None:
    """Return an element's length [m]; None without a number. JSBSim's default unit is feet."""
    element = root.find(tag)
    try:
        return (
            None
            if element is None
            else float(element.text or "") * _METRES[element.get("unit", "FT").upper()]
        )
    except (ValueError, KeyError):
        return None
