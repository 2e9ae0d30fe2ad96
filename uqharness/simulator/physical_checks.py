"""What an aircraft's XML says that no aeroplane can have: geometry, inertia, and rotors.

JSBSim loads a wing without area or an inertia that no body has without a word, and then flies NaN
or nonsense. The values are read from the XML, so that a message has the file and the line. What
cannot be flown is refused; what JSBSim flies although no body or no trim of ours fits it is a note.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from lxml import etree

from sysid.units import SLUG_FT2_KGM2
from uqharness.errors import BadInputError
from uqharness.simulator.staging import HasFiles, Opened, opened

_LOG = logging.getLogger("uqharness")
_SIZES = {"wingarea": "area", "wingspan": "span", "chord": "mean chord"}
_MOMENTS = ("ixx", "iyy", "izz")
_PRODUCTS = ("ixy", "ixz", "iyz")
_TO_KGM2 = {"KG*M2": 1.0, "SLUG*FT2": SLUG_FT2_KGM2}
_TRIANGLE_TOLERANCE = 0.01  # inertia in an XML has two or three digits
_noted: set[tuple[str, str]] = set()


@dataclass(frozen=True)
class _Number:
    """A number of the XML with its place, "file:line"."""

    value: float
    place: str


def check_physical(aircraft: HasFiles) -> None:
    """Refuse sizes and inertia that no aircraft has; note rotors and inertia that no body has.

    Parameters
    ----------
    aircraft : HasFiles
        Any aircraft; its files are read through the gate.

    Raises
    ------
    BadInputError
        For a wing area, span or chord that is not positive, and for moments of inertia that are
        not positive or whose products make the tensor indefinite, with file and line.
    """
    files = opened(aircraft)
    root = _root(aircraft, files, aircraft.xml.relative_to(aircraft.folder).as_posix())
    _check_sizes(_section(aircraft, files, root, "metrics"))
    _check_inertia(_section(aircraft, files, root, "mass_balance"))
    if rotor := rotor_place(aircraft):
        place, _, text = rotor.partition(": ")
        _note(
            place, f"{text}; it is not trimmed, so commands that start from steady flight refuse it"
        )


def rotor_place(aircraft: HasFiles) -> str:
    """Where the XML has a rotor, as a sentence "file:line: ..."; empty for other aircraft."""
    files = opened(aircraft)
    rotors = {
        PurePosixPath(name).name
        for name, file in (files.own | files.beside).items()
        if file.root == "rotor"
    }
    for name, file in files.own.items():
        for reference in file.references:
            if reference.tag == "thruster" and PurePosixPath(reference.name).name in rotors:
                place = f"{aircraft.folder / name}:{reference.line}"
                return (
                    f'{place}: <thruster file="{reference.name}"> is a rotor: this is a rotorcraft'
                )
    return ""


@dataclass(frozen=True)
class _Section:
    """An element of the aircraft and the file that holds it."""

    element: Any
    where: str

    def number(self, tag: str) -> _Number | None:
        """The number of a child; None where there is none, or no number (JSBSim says so itself)."""
        child = self.element.find(tag)
        if child is None:
            return None
        try:
            value = float((child.text or "").strip())
        except ValueError:
            return None
        unit = (child.get("unit") or "").upper()
        factor = _TO_KGM2.get(unit, SLUG_FT2_KGM2) if tag in (*_MOMENTS, *_PRODUCTS) else 1.0
        return _Number(value * factor, f"{self.where}:{child.sourceline}")


def _root(aircraft: HasFiles, files: Opened, name: str) -> _Section | None:
    if name not in files.own:
        return None
    parser = etree.XMLParser(remove_comments=True, resolve_entities=False)
    where = str(aircraft.folder / name)
    try:
        root = etree.parse(BytesIO(files.own[name].content), parser).getroot()
    except etree.XMLSyntaxError as error:
        raise BadInputError(f"{where}:{error.lineno}: not well-formed XML: {error.msg}") from None
    return _Section(root, where)


def _section(aircraft: HasFiles, files: Opened, root: _Section | None, tag: str) -> _Section | None:
    """A section of the aircraft, from a file of its own where it names one."""
    element = None if root is None else root.element.find(tag)
    if root is None or element is None:
        return None
    if not (name := (element.get("file") or "").strip()):
        return _Section(element, root.where)
    return _root(aircraft, files, name if name.endswith(".xml") else f"{name}.xml")


def _check_sizes(metrics: _Section | None) -> None:
    for tag, words in _SIZES.items() if metrics is not None else ():
        number = metrics.number(tag)  # type: ignore[union-attr]
        if number is not None and not (number.value > 0.0 and math.isfinite(number.value)):
            raise BadInputError(
                f"{number.place}: <{tag}> is {number.value:g}: a positive {words} is needed, because "
                "coefficients and dimensionless rates refer to it"
            )


def _check_inertia(mass: _Section | None) -> None:
    if mass is None:
        return
    moments = [mass.number(tag) for tag in _MOMENTS]
    # Point masses may carry all of the inertia; a moment below zero is wrong even then.
    has_points = mass.element.find("pointmass") is not None
    for tag, moment in zip(_MOMENTS, moments, strict=True):
        if moment is None or (has_points and moment.value == 0.0):
            continue
        if not (moment.value > 0.0 and math.isfinite(moment.value)):
            raise BadInputError(
                f"{moment.place}: <{tag}> is {moment.value:g} kg m^2: a positive moment of inertia "
                "is needed"
            )
    present = [moment for moment in moments if moment is not None and moment.value > 0.0]
    if len(present) != 3:
        return
    products = [number.value if (number := mass.number(tag)) else 0.0 for tag in _PRODUCTS]
    # JSBSim has two sign conventions for products; a tensor that is possible in one passes.
    low, middle, high = max(_principal(present, products, sign) for sign in (1.0, -1.0))
    values = f"principal moments {low:.4g}, {middle:.4g} and {high:.4g} kg m^2"
    place = present[0].place
    if not low > 0.0:
        raise BadInputError(
            f"{place}: impossible inertia, {values}: all three must be positive; products "
            f"({', '.join(_PRODUCTS)}) are too large for the moments"
        )
    if high > (1.0 + _TRIANGLE_TOLERANCE) * (low + middle):
        _note(
            place,
            f"impossible inertia, {values}: the largest exceeds the sum of the others by "
            f"{100.0 * (high / (low + middle) - 1.0):.0f} %, which no body has; check {', '.join(_MOMENTS)} "
            "and their units",
        )


def _principal(
    moments: list[_Number], products: list[float], sign: float
) -> tuple[float, float, float]:
    """Principal moments of inertia [kg m2], rising."""
    xy, xz, yz = (sign * value for value in products)
    (xx, yy, zz) = (moment.value for moment in moments)
    low, middle, high = np.linalg.eigvalsh([[xx, -xy, -xz], [-xy, yy, -yz], [-xz, -yz, zz]])
    return float(low), float(middle), float(high)


def _note(place: str, text: str) -> None:
    """Say it once per process, and not again of a copy that this process made of the aircraft."""
    key = Path(place).name.rpartition(":")[0], text
    if key not in _noted:
        _noted.add(key)
        _LOG.warning("%s: %s", place, text)
