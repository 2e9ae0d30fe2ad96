"""Mass, inertia and reference lengths: read from JSBSim, and set through the numbers of the XML.

`mass_properties` reads them. In JSBSim 1.3.3, properties such as inertia/iyy-slugs_ft2 are
read-only: they follow from <mass_balance>, point masses and fuel. `MassChange` adjusts the numbers
in a copy of the XML until the properties reach their targets. inertia/ixz-slugs_ft2 is the entry of
the inertia matrix, that is, minus the product of inertia.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from sysid.aerodynamics.coefficients import MassProperties
from sysid.logs import Reference
from sysid.units import FT_M, IN_M, LB_KG, SLUG_FT2_KGM2, SLUG_KG, SLUG_LB
from uqharness.errors import BadInputError
from uqharness.files import scratch_folder
from uqharness.simulator import engine
from uqharness.simulator.aircraft import Aircraft, parse_xml, stage
from uqharness.simulator.staging import Staging, copy_staging


def mass_properties(fdm: Any, reference: Reference) -> MassProperties:
    """Read mass, inertia and reference lengths of an initialised instance.

    Lengths of the card, ``reference``, take precedence.
    """
    get = fdm.__getitem__
    unit = SLUG_KG * FT_M**2
    # JSBSim publishes the elements of its inertia matrix: inertia/ixz is minus the product of
    # inertia Ixz.
    names = [["ixx", "ixy", "ixz"], ["ixy", "iyy", "iyz"], ["ixz", "iyz", "izz"]]
    inertia = unit * np.array([[get(f"inertia/{n}-slugs_ft2") for n in row] for row in names])
    return MassProperties(
        float(get("inertia/mass-slugs")) * SLUG_KG,
        inertia,
        reference.S_m2 or get("metrics/Sw-sqft") * FT_M**2,
        reference.b_m or get("metrics/bw-ft") * FT_M,
        reference.c_m or get("metrics/cbarw-ft") * FT_M,
    )


_WEIGHT = {"LBS": 1.0, "KG": LB_KG}
_INERTIA = {"SLUG*FT2": 1.0, "KG*M2": SLUG_FT2_KGM2}
_LENGTH_FT = {"FT": 1.0, "M": FT_M, "IN": 12.0}
_LENGTH_IN = {"IN": 1.0, "FT": 1.0 / 12.0, "M": IN_M}
_MAX_ITERATIONS, _TOLERANCE = (
    60,
    1e-9,
)  # the centre of gravity nears what is asked by the share of fuel and loads at each try


@dataclass(frozen=True)
class _Place:
    """Where the XML holds a property's number.

    Attributes
    ----------
    path : str
        Path below <fdm_config>.
    units : mapping
        Unit attribute to its size in the property's unit (before `per_property_unit`).
    default : str
        Unit without an attribute.
    per_property_unit : float
        Further factor from the property's unit.
    """

    path: str
    units: Mapping[str, float]
    default: str
    per_property_unit: float = 1.0


_PLACES: Mapping[str, _Place] = {
    "inertia/mass-slugs": _Place("mass_balance/emptywt", _WEIGHT, "LBS", SLUG_LB),
    "inertia/weight-lbs": _Place("mass_balance/emptywt", _WEIGHT, "LBS"),
    "inertia/empty-weight-lbs": _Place("mass_balance/emptywt", _WEIGHT, "LBS"),
    **{
        f"inertia/{name}-slugs_ft2": _Place(f"mass_balance/{name}", _INERTIA, "SLUG*FT2")
        for name in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    },
    **{
        f"inertia/cg-{axis}-in": _Place(
            f"mass_balance/location[@name='CG']/{axis}", _LENGTH_IN, "IN"
        )
        for axis in "xyz"
    },
    "metrics/bw-ft": _Place("metrics/wingspan", _LENGTH_FT, "FT"),
    "metrics/cbarw-ft": _Place("metrics/chord", _LENGTH_FT, "FT"),
}

CHANGEABLE = frozenset(_PLACES)
"""Properties that a flight may set although JSBSim only computes them."""


class MassChange:
    """Copies of a staged aircraft with other mass properties.

    Parameters
    ----------
    aircraft : Aircraft
        The aircraft.
    staging : Staging
        Its staged copy; changed copies are written next to it.
    open_copy : callable
        Opens an instance with a staged copy.
    """

    def __init__(
        self, aircraft: Aircraft, staging: Staging, open_copy: Callable[[Staging], Any]
    ) -> None:
        self._aircraft = aircraft
        self._staging = staging
        self._changed: Staging | None = None
        self._open_copy = open_copy
        self._nominal: dict[str, float] | None = None

    def realise(self, target: Mapping[str, float]) -> Staging:
        """Return a staged copy in which every property of ``target`` has its value.

        Raises
        ------
        BadInputError
            For an impossible value, for properties that depend on each other, and for a number that
            is not in the aircraft's main XML file.
        """
        elements, tree = self._elements(target)
        if self._nominal is None:
            self._nominal = self._measure(tree, CHANGEABLE)
        for name, value in target.items():
            if not math.isfinite(value) or (
                value <= 0.0 and not name.startswith(("inertia/cg", "inertia/ix", "inertia/iyz"))
            ):
                raise BadInputError(f"property {name} = {value:g}: must be a positive number")
        actual = {name: self._nominal[name] for name in target}
        # Fixed-point iteration: the error shrinks by the share of fuel and loads in each step.
        for _ in range(_MAX_ITERATIONS):
            self._move(elements, target, actual)
            actual = self._measure(tree, target)
            if all(
                _is_close(actual[name], value, self._nominal[name])
                for name, value in target.items()
            ):
                assert self._changed is not None
                return self._changed
        mismatch = ", ".join(
            f"{name} is {actual[name]:g} instead of {value:g}" for name, value in target.items()
        )
        raise BadInputError(
            f"{self._aircraft.xml}: these mass properties cannot be set together: {mismatch}; "
            "set only independent ones (a mass or a weight, not both)"
        )

    def _elements(
        self, target: Mapping[str, float]
    ) -> tuple[dict[str, etree._Element], etree._ElementTree]:
        """Return the XML elements behind the target properties, and the tree that holds them.

        A missing inertia is created with the value 0.
        """
        path = self._aircraft.xml
        tree = parse_xml(self._staging.xml)
        root = tree.getroot()
        elements: dict[str, etree._Element] = {}
        for name in target:
            place = _PLACES[name]
            element = root.find(place.path)
            if (
                element is None
                and place.units is _INERTIA
                and root.find("mass_balance/emptywt") is not None
            ):
                mass_balance = root.find("mass_balance")
                assert mass_balance is not None
                element = etree.SubElement(mass_balance, place.path.rpartition("/")[2])
                element.text = "0"
            if element is None:
                section, _, leaf = place.path.partition("/")
                raise BadInputError(
                    f"{path}:{root.sourceline}: property {name} comes from <{leaf}> in <{section}>,"
                    " which is not in this file, so it cannot be changed"
                )
            # Two properties of one number (mass and weight) cannot be set independently.
            if element in elements.values():
                raise BadInputError(
                    f"{path}:{element.sourceline}: two of the properties to set come from the same"
                    f" <{element.tag}>"
                )
            _unit(path, element, place)
            elements[name] = element
        return elements, tree

    def _move(
        self,
        elements: Mapping[str, etree._Element],
        target: Mapping[str, float],
        actual: Mapping[str, float],
    ) -> None:
        """Add the remaining difference to each element, in its own unit."""
        for name, element in elements.items():
            place = _PLACES[name]
            change = (
                (target[name] - actual[name])
                * place.per_property_unit
                * _unit(self._aircraft.xml, element, place)
            )
            if place.units is _INERTIA and element.tag not in ("ixx", "iyy", "izz"):
                mass_balance = element.getparent()
                assert mass_balance is not None
                # Cross products: the property is the matrix entry; the XML may hold the entry or
                # its negative.
                change *= (
                    -1.0 if mass_balance.get("negated_crossproduct_inertia") == "false" else 1.0
                )
            element.text = repr(float(element.text or 0.0) + change)

    def _measure(self, tree: etree._ElementTree, names: Any) -> dict[str, float]:
        """Write the tree, initialise the copy, and return the properties."""
        if self._changed is None:
            self._changed = copy_staging(self._staging, self._staging.root / "changed")
        tree.write(str(self._changed.xml), encoding="UTF-8", xml_declaration=True)
        fdm = self._open_copy(self._changed)
        engine.run_ic(fdm)
        return {name: float(fdm[name]) for name in names}


def xml_numbers_for(aircraft: Aircraft, target: Mapping[str, float]) -> dict[str, str]:
    """Return the XML numbers for which properties of CHANGEABLE have their target values.

    Parameters
    ----------
    aircraft : Aircraft
        The aircraft.
    target : mapping
        Property to value in its own unit.

    Returns
    -------
    dict
        Path below the root, such as ``mass_balance/location[@name='CG']/x``, to the number as text.

    Raises
    ------
    BadInputError
        As `MassChange.realise`.
    """
    with scratch_folder("mass") as scratch:
        change = MassChange(
            aircraft,
            stage(aircraft, scratch.path / "root"),
            lambda staging: engine.open_fdm(staging, aircraft.dt_s),
        )
        root = parse_xml(change.realise(target).xml).getroot()
        # The solver has written the numbers into the copy.
        paths = [_PLACES[name].path for name in target]
        return {path: (root.findtext(path) or "").strip() for path in paths}


def _is_close(actual: float, target: float, nominal: float) -> bool:
    """Return whether a property has reached its target."""
    return abs(actual - target) <= _TOLERANCE * max(abs(target), abs(nominal), 1e-3)


def _unit(path: Path, element: etree._Element, place: _Place) -> float:
    """Return the element's unit in units of the property, before ``per_property_unit``."""
    owner = element
    if place.units is _LENGTH_IN:
        parent = element.getparent()
        assert parent is not None
        owner = parent
    unit = owner.get("unit", place.default)
    if unit not in place.units:
        raise BadInputError(
            f"{path}:{owner.sourceline}: unit {unit!r} of <{owner.tag}>: known are"
            f" {', '.join(place.units)}"
        )
    try:
        float(element.text or "")
    except ValueError:
        raise BadInputError(
            f"{path}:{element.sourceline}: <{element.tag}> is {element.text!r}, no number"
        ) from None
    return place.units[unit]
