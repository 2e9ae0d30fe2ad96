"""How high a flight began when its record does not say: as high as the aircraft's own initial
conditions.
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
    """The record with an altitude above sea level to begin at, and a sentence when that is an
    assumption ("" when it is not).

    A hundred metres are one per cent of the air's density, and so of every force and moment.
    """
    start = record.metadata.start
    if "rho_kgpm3" in record or "alt_m" in start:
        return record, ""
    altitudes = _initial_altitudes(folder)
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
    """(file, altitude above sea level [m]) of the initial conditions in an aircraft's folder that
    name one.
    """
    altitudes = []
    for path in sorted(folder.glob("*.xml")):
        try:
            root = parse_xml(path).getroot()
        except BadInputError:
            continue
        if root.tag != "initialize":
            continue
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
    """The element's length [m]; None where it is absent or no number.

    JSBSim's unit without an attribute is feet.
    """
    element = root.find(tag)
    try:
        return (
            None
            if element is None
            else float(element.text or "") * _METRES[element.get("unit", "FT").upper()]
        )
    except (ValueError, KeyError):
        return None
