"""Mass, inertia and centre of gravity given as numbers, and the aircraft's <mass_balance> edited so that it has them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields

from sysid.units import IN_M, LB_KG, SLUG_FT2_KGM2, SLUG_LB
from uqharness.errors import BadInputError
from uqharness.simulator import Aircraft, numbers_for
from uqharness.xml import Document, Insertion, Node, append_child, attribute

_STEP = re.compile(r"(\w+)(?:\[@name='(\w+)'\])?")
# Factor from the option's unit to the property's; JSBSim's inertia/ixz-slugs_ft2 is minus the product of inertia.
_PROPERTIES: Mapping[str, tuple[str, float]] = {
    "mass_kg": ("inertia/mass-slugs", 1.0 / (SLUG_LB * LB_KG)),
    "ixx_kgm2": ("inertia/ixx-slugs_ft2", 1.0 / SLUG_FT2_KGM2),
    "iyy_kgm2": ("inertia/iyy-slugs_ft2", 1.0 / SLUG_FT2_KGM2),
    "izz_kgm2": ("inertia/izz-slugs_ft2", 1.0 / SLUG_FT2_KGM2),
    "ixz_kgm2": ("inertia/ixz-slugs_ft2", -1.0 / SLUG_FT2_KGM2),
    "cg_x_m": ("inertia/cg-x-in", 1.0 / IN_M),
    "cg_y_m": ("inertia/cg-y-in", 1.0 / IN_M),
    "cg_z_m": ("inertia/cg-z-in", 1.0 / IN_M),
}


@dataclass(frozen=True)
class MassProperties:
    """What is known of the aircraft as it flew, fuel and loads on board included; None: as the XML has it.

    ``mass_kg``; moments of inertia about the centre of gravity in body axes [kg m2], ``ixz_kgm2`` the product, the integral of x z
    over the mass; ``cg_x_m`` ... in the XML's own structural frame [m], x aft, y right, z up.
    """

    mass_kg: float | None = None
    ixx_kgm2: float | None = None
    iyy_kgm2: float | None = None
    izz_kgm2: float | None = None
    ixz_kgm2: float | None = None
    cg_x_m: float | None = None
    cg_y_m: float | None = None
    cg_z_m: float | None = None

    def given(self) -> dict[str, float]:
        """Those that are given, by name."""
        values = ((item.name, getattr(self, item.name)) for item in fields(self))
        return {name: float(value) for name, value in values if value is not None}


def mass_insertions(
    aircraft: Aircraft, document: Document, mass: MassProperties
) -> tuple[Insertion, ...]:
    """The edits of ``document``, the aircraft's XML, after which JSBSim computes those mass properties. Empty for none.

    The other inertias stay as JSBSim computes them. Raises BadInputError for values that no body has, and where a number is not in
    this file.
    """
    given = mass.given()
    if not given:
        return ()
    for name, value in given.items():
        free = name.startswith(("cg", "ixz"))
        if not math.isfinite(value) or not (free or value > 0.0):
            raise BadInputError(
                f"{name} = {value:g}: a {'finite' if free else 'positive'} number is needed"
            )
    moments = [given.get(f"i{axis}{axis}_kgm2") for axis in "xyz"]
    if None not in moments and max(moments) > sum(moments) - max(moments):  # type: ignore[type-var, arg-type, operator]
        raise BadInputError(
            f"ixx, iyy, izz = {moments} kg m2: no body has one moment of inertia above the sum of the other two"
        )
    wanted = {_PROPERTIES[name][0]: _PROPERTIES[name][1] * value for name, value in given.items()}
    texts = numbers_for(aircraft, wanted)
    return tuple(_edit(document, path, text) for path, text in texts.items())


def _edit(document: Document, path: str, text: str) -> Insertion:
    """The element at ``path`` with that number, made where there is none."""
    node = document.root
    steps = path.split("/")
    for step in steps[:-1]:
        node = _child(document, node, step)
    old = node.find(steps[-1])
    if old is None:
        return append_child(
            document, node, [f'<{steps[-1]} unit="SLUG*FT2"> {text} </{steps[-1]}>']
        )
    raw = document.raw
    new = (
        raw[old.start : old.open_end] + f" {text} ".encode("ascii") + raw[old.close_start : old.end]
    )
    return Insertion(old.start, new, raw[old.start : old.end])


def _child(document: Document, node: Node, step: str) -> Node:
    match = _STEP.fullmatch(step)
    assert match is not None
    for child in node.all(match[1]):
        if match[2] is None or attribute(child, "name") == match[2]:
            return child
    raise BadInputError(
        f"{document.where(node)}: <{step}> is not in this file, so that mass properties cannot be changed"
    )
