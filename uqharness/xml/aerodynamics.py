"""Where an aircraft's aerodynamic forces are written down: the file, the axis elements, and the axes they are meant in.

JSBSim 1.3.3 (FGAerodynamics) takes the axes from the first force axis it meets and, if others follow, goes on with a warning that
nobody sees; of two elements for the same axis the later one replaces the earlier. Both are met here before anything is written.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from sysid.units import FT_M
from uqharness.errors import BadInputError
from uqharness.xml.document import Document, Node, attribute, number, read_document

BODY, AXIAL, WIND, STABILITY = "body", "axial", "wind", "stability"
"""Axes of forces: X forward, Y right, Z down; AXIAL aft, SIDE right, NORMAL up; DRAG, SIDE, LIFT; the same turned by alpha alone.

Of moments only ``body``, ``wind`` and ``stability`` (ROLL, PITCH, YAW about those axes).
"""

_FORCE_SLOT = {"X": 0, "DRAG": 0, "AXIAL": 0, "Y": 1, "SIDE": 1, "Z": 2, "LIFT": 2, "NORMAL": 2}
_MOMENT_SLOT = {"ROLL": 3, "PITCH": 4, "YAW": 5}
SLOT: Mapping[str, int] = {**_FORCE_SLOT, **_MOMENT_SLOT}
"""JSBSim's six places: what is written under one name lands in the place of the others of the same number."""

_FRAMES = {"": BODY, "BODY": BODY, "WIND": WIND, "STABILITY": STABILITY}


@dataclass(frozen=True)
class Axis:
    """An ``<axis>`` that counts, and the file it stands in."""

    document: Document
    node: Node

    @property
    def name(self) -> str:
        """The axis as the author named it: X, LIFT, ROLL ..."""
        return attribute(self.node, "name")

    @property
    def functions(self) -> list[Node]:
        """The axis' functions, in the author's order."""
        return self.node.all("function")


@dataclass(frozen=True)
class AeroSection:
    """The ``<aerodynamics>`` of an aircraft.

    main      the aircraft's XML; ``document`` the file that holds the section (main, or the one it includes), ``node`` its element
    force     body, axial, wind or stability;  ``moment`` body, wind or stability
    axes      JSBSim's place (0..5: x y z forces, roll pitch yaw) to the axis element that counts there
    overridden  axis elements that a later one of the same place replaces: JSBSim ignores them
    """

    folder: Path
    main: Document
    document: Document
    node: Node
    force: str
    moment: str
    axes: Mapping[int, Axis]
    overridden: tuple[Axis, ...]

    @property
    def documents(self) -> list[Document]:
        """The files involved, each once."""
        return [self.main] if self.document is self.main else [self.main, self.document]


def read_section(folder: Path, xml: str) -> AeroSection:
    """The aerodynamics of the aircraft ``folder/xml``. Raises BadInputError with file and line for what cannot be instrumented."""
    main = read_document(folder / xml)
    if main.root.tag != "fdm_config":
        raise BadInputError(
            f"{main.where(main.root)}: <{main.root.tag}>, but a JSBSim aircraft begins with <fdm_config>"
        )
    outer = main.root.find("aerodynamics")
    if outer is None:
        raise BadInputError(
            f"{main.where(main.root)}: no <aerodynamics>, so there are no coefficients to add to"
        )
    document, node = included(folder, main, outer)
    found = [Axis(main, child) for child in outer.all("axis")]
    if document is not main:
        found += [Axis(document, child) for child in node.all("axis")]
    for axis in found:
        if axis.name not in SLOT:
            raise BadInputError(
                f"{axis.document.where(axis.node)}: axis '{axis.name}' is unknown to JSBSim; allowed are {', '.join(SLOT)}"
            )
    force = _force_axes([axis for axis in found if axis.name in _FORCE_SLOT])
    moment = _agreed([axis for axis in found if axis.name in _MOMENT_SLOT], "moment") or BODY
    axes = {SLOT[axis.name]: axis for axis in found}
    lost = tuple(axis for axis in found if axes[SLOT[axis.name]] is not axis)
    return AeroSection(folder, main, document, node, force, moment, axes, lost)


def included(folder: Path, document: Document, node: Node) -> tuple[Document, Node]:
    """The file and element that ``node`` stands for: itself, or the root of what its ``file`` attribute names."""
    name = attribute(node, "file")
    if not name:
        return document, node
    given = Path(name)
    if given.is_absolute() or ".." in given.parts:
        raise BadInputError(
            f'{document.where(node)}: file="{name}" lies outside the aircraft\'s folder, and a copy of the folder would go on '
            "using it; move the file into the folder"
        )
    path = folder / (name if name.endswith(".xml") else f"{name}.xml")
    if not path.is_file():
        raise BadInputError(f'{document.where(node)}: file="{name}": there is no {path}')
    other = read_document(path)
    if other.root.tag != node.tag:
        raise BadInputError(
            f"{other.where(other.root)}: <{other.root.tag}>, but <{node.tag}> is expected here"
        )
    return other, other.root


def _force_axes(axes: list[Axis]) -> str:
    """The force axes in use, by JSBSim's rules (FGAerodynamics::DetermineAxisSystem); BadInputError where they are mixed."""
    if not axes:
        return BODY
    kinds: list[tuple[str, Axis]] = []
    for axis in axes:
        if axis.name in ("X", "Y", "Z"):
            kinds.append((_frame(axis), axis))
        elif axis.name in ("LIFT", "DRAG"):
            kinds.append((WIND, axis))
        elif axis.name in ("AXIAL", "NORMAL"):
            kinds.append((AXIAL, axis))
    # SIDE alone decides nothing; without any other axis JSBSim takes wind axes.
    return _same(kinds, "force") or WIND


def _agreed(axes: list[Axis], what: str) -> str | None:
    return _same([(_frame(axis), axis) for axis in axes], what)


def _same(kinds: list[tuple[str, Axis]], what: str) -> str | None:
    if not kinds:
        return None
    first, axis = kinds[0]
    for kind, other in kinds[1:]:
        if kind != first:
            raise BadInputError(
                f'{other.document.where(other.node)}: {what} axes are mixed: <axis name="{other.name}"> is in {kind} axes, '
                f'<axis name="{axis.name}"> (line {axis.node.line}) in {first} axes. JSBSim loads that and takes all of them for '
                f"{first} axes, so the aircraft does not fly what is written; write all in one system first"
            )
    return first


def _frame(axis: Axis) -> str:
    frame = attribute(axis.node, "frame")
    if frame not in _FRAMES:
        raise BadInputError(
            f"{axis.document.where(axis.node)}: frame '{frame}' is unknown to JSBSim; allowed are BODY, WIND, STABILITY"
        )
    return _FRAMES[frame]


_UNITS = {"": 1.0, "FT": 1.0, "IN": 1.0 / 12.0, "M": 1.0 / FT_M, "KM": 1000.0 / FT_M}
_AREAS = {"": 1.0, **{f"{unit}2": factor**2 for unit, factor in _UNITS.items() if unit}}


def read_reference(section: AeroSection) -> tuple[float, float, float]:
    """Wing area [ft2], span and chord [ft] as written in <metrics>; NaN for what is not there.

    JSBSim's own conversions have ten digits, so compare, but compute with its metrics/... properties. Raises BadInputError.
    """
    document, metrics, outer = _metrics(section)
    out = []
    for name, units in (("wingarea", _AREAS), ("wingspan", _UNITS), ("chord", _UNITS)):
        node = metrics.find(name) or outer.find(name)
        if node is None:
            out.append(math.nan)
            continue
        unit = attribute(node, "unit")
        if unit not in units:
            raise BadInputError(
                f"{document.where(node)}: unit '{unit}' of <{name}>; allowed are {', '.join(filter(None, units))}"
            )
        out.append(number(node, name, document) * units[unit])
    return out[0], out[1], out[2]


def require_reference(section: AeroSection) -> None:
    """BadInputError with file and line unless <metrics> gives a wing area, span and chord above zero."""
    document, metrics, outer = _metrics(section)
    for name, value in zip(("wingarea", "wingspan", "chord"), read_reference(section), strict=True):
        if not value > 0.0:
            node = metrics.find(name) or outer.find(name)
            line, is_what = (metrics, "missing") if node is None else (node, node.text.strip())
            raise BadInputError(
                f"{document.where(line)}: <{name}> is {is_what}, so a coefficient has nothing to be multiplied by; give it in "
                "<metrics>, or S_m2, b_m and c_m under [reference] in airframe.toml"
            )


def _metrics(section: AeroSection) -> tuple[Document, Node, Node]:
    """File and element that hold the metrics, and the element in the aircraft's XML."""
    outer = section.main.root.find("metrics")
    if outer is None:
        raise BadInputError(
            f"{section.main.where(section.main.root)}: no <metrics>, which JSBSim requires"
        )
    document, metrics = included(section.folder, section.main, outer)
    return document, metrics, outer
