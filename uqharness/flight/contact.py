"""Contact with the ground: an airborne mission ends where the gear, the structure or, without contact points, the CG touches it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from uqharness.errors import BadInputError
from uqharness.simulator import Aircraft, engine, parse_xml

_MARGIN_FT = 1.0
# Ten g towards the ground for as long as nobody looks.
_HARDEST_FPS2 = 320.0


class GroundWatch:
    """Runs an initialised flight block by block and sees every step in which a contact point touches the ground.

    A flight that starts on its contact points is not airborne, and may touch the ground, until the first step without contact.
    ``block_s`` is the time between two calls of `advance`.
    """

    def __init__(self, fdm: Any, aircraft: Aircraft, block_s: float) -> None:
        units = _units(fdm)
        names = _names(aircraft, len(units))
        self._points = [
            (engine.handle(fdm, f"{unit}/WOW").get_double_value, name)
            for unit, name in zip(units, names, strict=True)
        ]
        self._reach_ft = max((_distance_ft(fdm, unit) for unit in units), default=0.0) + _MARGIN_FT
        self._block_s = block_s
        self._height = engine.handle(fdm, "position/h-agl-ft").get_double_value
        self._climb = engine.handle(fdm, "velocities/h-dot-fps").get_double_value
        self._airborne = not self._touching()

    def advance(self, run: Callable[[int], None], steps: int) -> str:
        """Run ``steps`` steps, or up to the first contact of an airborne flight; what touched, empty where nothing did."""
        if not self._near():
            run(steps)
            self._airborne = True
        else:
            for _ in range(steps):
                run(1)
                name = self._touching()
                if name and self._airborne:
                    return name
                self._airborne = self._airborne or not name
        return "the centre of gravity" if self._height() <= 0.0 else ""

    def _near(self) -> bool:
        """Whether a contact point could reach the ground within a block. Each step is looked at only then: it costs time."""
        fall_ft = 2.0 * abs(self._climb()) * self._block_s + 0.5 * _HARDEST_FPS2 * self._block_s**2
        return bool(self._points) and self._height() < self._reach_ft + fall_ft

    def _touching(self) -> str:
        return next((name for wow, name in self._points if wow()), "")


@dataclass(frozen=True)
class ContactPoint:
    """A gear or structure contact point; ``at_in`` [in] in the structural frame. ``retracts``: it counts while the gear is down."""

    name: str
    at_in: tuple[float, float, float]
    retracts: bool


def contact_points(fdm: Any, aircraft: Aircraft) -> list[ContactPoint]:
    """Those of a loaded aircraft. Raises BadInputError where JSBSim does not say where they are."""
    units = _units(fdm)
    found = []
    for unit, name in zip(units, _names(aircraft, len(units)), strict=True):
        names = [f"{unit}/{axis}-position" for axis in "xyz"]
        engine.require(fdm, names)
        x, y, z = (float(fdm[n]) for n in names)
        found.append(
            ContactPoint(name, (x, y, z), fdm.get_property_manager().hasNode(f"{unit}/pos-norm"))
        )
    return found


def _units(fdm: Any) -> list[str]:
    """Contact points as property folders, in the order of the XML: gear and structure are counted together."""
    exists = fdm.get_property_manager().hasNode
    found = []
    for number in range(int(fdm["gear/num-units"])):
        found += [
            unit
            for unit in (f"gear/unit[{number}]", f"contact/unit[{number}]")
            if exists(f"{unit}/WOW")
        ]
    return found


def _names(aircraft: Aircraft, count: int) -> list[str]:
    """What the XML calls the contact points; their numbers where it is not to be had."""
    try:
        found = [
            item.get("name", "")
            for item in parse_xml(aircraft.xml).getroot().iterfind("ground_reactions/contact")
        ]
    except BadInputError:
        found = []
    named = found if len(found) == count else [""] * count
    return [f"contact point {name.strip() or number}" for number, name in enumerate(named)]


def _distance_ft(fdm: Any, unit: str) -> float:
    """From the CG, the same whatever the attitude."""
    exists = fdm.get_property_manager().hasNode
    if not all(exists(f"{unit}/{axis}-position") for axis in "xyz"):
        return math.inf
    return math.dist(
        *(
            [fdm[name] / 12.0 for name in names]
            for names in (
                [f"{unit}/{axis}-position" for axis in "xyz"],
                [f"inertia/cg-{axis}-in" for axis in "xyz"],
            )
        )
    )
