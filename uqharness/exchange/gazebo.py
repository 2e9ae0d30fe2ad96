"""Gazebo's AdvancedLiftDrag system as SDF, for gz-sim and for Gazebo classic.

The equations are those of gz-sim's src/systems/advanced_lift_drag/AdvancedLiftDrag.cc with the
pitching moment as of pull request 3817 (2026): before it, the moment of sideslip replaced those of
the constant and of the angle of attack, so that every aeroplane flew without pitch stiffness. The
system gives no mass and no inertia: these stand in the link, whose axes are forward, left, up. A
joint turns by the deflection times its ``direction``; coefficients of a control surface are per
degree of its joint.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from lxml import etree

from sysid.arrays import FloatArray
from sysid.foreign.regular_files import read_regular
from uqharness.errors import BadInputError
from uqharness.exchange.states import (
    Derivatives,
    FlightStates,
    Reference,
    SourceModel,
    air_velocity,
    lift_drag,
)

_COLUMNS = {"a": "alpha", "b": "beta", "p": "p", "q": "q", "r": "r"}
_TAGS: Mapping[str, tuple[str, ...]] = {
    # Tag's prefix to the suffixes that the program reads.
    "CL": ("0", "a", "b", "p", "q", "r"),
    "CD": ("0", "p", "q", "r"),
    "CY": ("a", "b", "p", "q", "r"),
    "Cell": ("a", "b", "p", "q", "r"),
    "Cem": ("0", "a", "b", "p", "q", "r"),
    "Cen": ("a", "b", "p", "q", "r"),
}
_COEFFICIENT = {"CL": "CL", "CD": "CD", "CY": "CY", "Cell": "Cl", "Cem": "Cm", "Cen": "Cn"}
GEOMETRY = ("area", "mac", "AR", "eff", "alpha_stall", "Cema_stall", "air_density")
TAGS = (*(f"{prefix}{end}" for prefix, ends in _TAGS.items() for end in ends), *GEOMETRY)
_CTRL = tuple(f"{prefix}_ctrl" for prefix in _TAGS)
_STALL_RAD, _SHARPNESS, _K1, _K2 = 0.4712, 15.0, -0.224, -0.115
LOST_TERMS = (
    "constants of side force, rolling and yawing moment",
    "all products and squares but the drag polar",
    "the propeller and its torque, the model-form deltas",
)


@dataclass(frozen=True)
class ControlSurface:
    """A joint of the model and the coefficients per degree that it adds.

    Attributes
    ----------
    name : str
        Joint.
    shares : Mapping
        Joint's angle over each deflection (``de``, ``da``, ``dr``) that moves it: the trailing edge
        goes up for a turn about an axis to the left, to the right for one about an axis up. Empty
        for a flap.
    direction : float
        The program multiplies the joint's angle by it.
    effects : Mapping
        ``CL_ctrl`` ... ``Cen_ctrl`` [1/deg].
    """

    name: str
    shares: Mapping[str, float]
    direction: float
    effects: Mapping[str, float]


@dataclass(frozen=True)
class LiftDragModel:
    """The content of an AdvancedLiftDrag element.

    Attributes
    ----------
    tags : Mapping
        `TAGS` to numbers.
    surfaces : sequence of ControlSurface
        Its control surfaces.
    arm_m : tuple of float
        From the centre of gravity to the point where the forces act, forward, right, down [m].
    air_m : tuple of float
        The same to the point whose velocity counts.
    axes : ndarray
        (3, 3) forward, right and down of the system (rows) in forward, right, down of the link.
    """

    tags: Mapping[str, float]
    surfaces: Sequence[ControlSurface]
    arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    air_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axes: FloatArray = field(default_factory=lambda: np.eye(3), compare=False)


def parameters(source: SourceModel, fitted: Mapping[str, Derivatives]) -> LiftDragModel:
    """Return the element for a source and its `derivatives`."""
    reference, middle = source.reference, source.middle
    aspect_ratio = reference.b_m**2 / reference.S_m2
    line = lift_drag(source, fitted["CL"], fitted["CD"])
    tangents = {prefix: fitted[name].tangent(middle) for prefix, name in _COEFFICIENT.items()}
    lift, drag = tangents["CL"], tangents["CD"]
    tags = {
        f"{prefix}{end}": tangents[prefix][_COLUMNS[end]]
        for prefix, ends in _TAGS.items()
        for end in ends
        if end != "0"
    }
    # Induced drag contains the lift of the deflections; the rest of their drag is a term of theirs.
    lift_there = line.lift_0 + line.lift_alpha * middle["alpha"]
    lift_there += sum(lift[v] * middle[v] for v in ("de", "da", "dr"))
    more_drag = {v: drag[v] - 2.0 * line.induced * lift_there * lift[v] for v in ("de", "da", "dr")}
    drag_there = fitted["CD"].at(middle)
    tags |= {
        "CL0": line.lift_0,
        "CLa": line.lift_alpha,
        "CD0": drag_there
        - line.induced * lift_there**2
        - sum(more_drag[v] * middle[v] for v in more_drag),
        "Cem0": tangents["Cem"]["0"],
        "area": reference.S_m2,
        "mac": reference.c_m,
        "AR": aspect_ratio,
        "eff": line.oswald(aspect_ratio),
        # No flight of the source stalls.
        "alpha_stall": _STALL_RAD,
        "Cema_stall": tangents["Cem"]["alpha"],
        "air_density": 1.2041,
    }
    surfaces = []
    for variable, names in (
        ("de", (("elevator_joint", -1.0),)),
        ("da", (("left_aileron_joint", -1.0), ("right_aileron_joint", 1.0))),
        ("dr", (("rudder_joint", -1.0),)),
    ):
        effects = {
            f"{prefix}_ctrl": (more_drag if prefix == "CD" else tangents[prefix])[variable]
            for prefix in _TAGS
        }
        share = 1.0 / len(names)
        surfaces += [
            ControlSurface(
                name, {variable: direction}, direction, {k: share * x for k, x in effects.items()}
            )
            for name, direction in names
        ]
    return LiftDragModel({tag: tags[tag] for tag in TAGS}, surfaces)


def parts(model: LiftDragModel) -> dict[tuple[str, str], list[float]]:
    """Return what each surface adds to a coefficient per deflection of its variable."""
    result: dict[tuple[str, str], list[float]] = {}
    for surface in model.surfaces:
        for variable, share in surface.shares.items():
            turned = share * surface.direction
            for prefix, name in _COEFFICIENT.items():
                effect = turned * surface.effects[f"{prefix}_ctrl"]
                result.setdefault((name, variable), []).append(effect)
    return result


def coefficients(model: LiftDragModel, states: FlightStates) -> FloatArray:
    """Return CX CY CZ Cl Cm Cn (n, 6) by the program's equations, of its area and lengths."""
    tag = model.tags
    # Without <mac> the program takes the mean chord.
    span = math.sqrt(tag["area"] * tag["AR"])
    chord = tag["mac"] or tag["area"] / span
    lengths = np.array([span, chord, span])
    # The velocity is that of a point of the link; rates are the link's, whatever the axes.
    u, v, w = model.axes @ air_velocity(states, model.air_m)
    # The program's speed is that in the plane of symmetry, its sideslip atan2(v, u).
    plane, alpha, beta = np.hypot(u, w), np.arctan2(w, u), np.arctan2(v, u)
    value = states.reduced_by(span, chord).values
    stall = tag["alpha_stall"]
    before, behind = np.exp(-_SHARPNESS * (alpha - stall)), np.exp(_SHARPNESS * (alpha + stall))
    sigma = (1.0 + before + behind) / ((1.0 + before) * (1.0 + behind))
    plate = 2.0 * np.sign(alpha) * np.sin(alpha) ** 2 * np.cos(alpha)
    control = {key: np.zeros(len(states)) for key in _CTRL}
    for surface in model.surfaces:
        for variable, share in surface.shares.items():
            # The program multiplies the joint's angle by the direction.
            turned = value[variable] * share * surface.direction
            for key in _CTRL:
                control[key] = control[key] + surface.effects[key] * turned

    def rates(prefix: str) -> FloatArray:
        # Rates are reduced by the speed in the plane, and act with its pressure.
        return np.asarray(plane * sum(tag[f"{prefix}{v}"] * value[v] for v in ("p", "q", "r")))

    def linear(prefix: str) -> FloatArray:
        slopes = tag[f"{prefix}a"] * alpha + tag[f"{prefix}b"] * beta
        return np.asarray(tag.get(f"{prefix}0", 0.0) + slopes + control[f"{prefix}_ctrl"])

    lift = (1.0 - sigma) * (tag["CL0"] + tag["CLa"] * alpha) + sigma * plate
    lift = lift + tag["CLb"] * beta + control["CL_ctrl"]
    aspect_ratio = tag["AR"]
    flat = 2.0 / (1.0 + math.exp(_K1 + _K2 * max(aspect_ratio, 1.0 / aspect_ratio)))
    drag = (1.0 - sigma) * (tag["CD0"] + lift**2 / (math.pi * aspect_ratio * tag["eff"]))
    drag = drag + sigma * np.abs(flat * (0.5 - 0.5 * np.cos(2.0 * alpha))) + control["CD_ctrl"]
    lift, drag = plane**2 * lift + rates("CL"), plane**2 * drag + rates("CD")
    pitch = linear("Cem")
    # Behind the stall the slope is another.
    is_stalled = np.abs(alpha) > stall
    steep = tag["Cema"] * np.sign(alpha) * stall
    steep = steep + tag["Cema_stall"] * (alpha - np.sign(alpha) * stall)
    pitch = np.where(is_stalled, pitch - tag["Cema"] * alpha + steep, pitch)
    cx = -drag * np.cos(alpha) + lift * np.sin(alpha)
    cz = -drag * np.sin(alpha) - lift * np.cos(alpha)
    lateral = [plane**2 * linear(p) + rates(p) for p in ("CY", "Cell", "Cen")]
    pitch = plane**2 * pitch + rates("Cem")
    # Back to the link's axes; the forces act at a point of the link.
    forces = np.column_stack([cx, lateral[0], cz]) @ model.axes
    moments = (np.column_stack([lateral[1], pitch, lateral[2]]) * lengths) @ model.axes
    moments = moments + np.cross(np.array(model.arm_m), forces)
    return np.hstack([forces, moments / lengths])


def text(model: LiftDragModel, source: SourceModel, name: str, classic: bool = False) -> bytes:
    """Return a complete SDF model: a link with mass and inertia, joints, and the system.

    ``classic`` writes the plug-in of Gazebo classic in place of gz-sim's system.
    """
    reference = source.reference
    # Gazebo classic reads SDF up to 1.7.
    sdf = etree.Element("sdf", version="1.6" if classic else "1.9")
    sdf.append(etree.Comment(" Written by uqharness export; axes forward, left, up. "))
    body = etree.SubElement(sdf, "model", name=name)
    link = etree.SubElement(body, "link", name="base_link")
    inertial = etree.SubElement(link, "inertial")
    _add(inertial, "mass", reference.mass_kg)
    inertia = etree.SubElement(inertial, "inertia")
    matrix = reference.inertia_kgm2
    # Forward, left, up: products with one of y and z change their sign, yz keeps it.
    for tag, number in (
        ("ixx", matrix[0, 0]),
        ("ixy", -matrix[0, 1]),
        ("ixz", -matrix[0, 2]),
        ("iyy", matrix[1, 1]),
        ("iyz", matrix[1, 2]),
        ("izz", matrix[2, 2]),
    ):
        _add(inertia, tag, float(number))
    for surface in model.surfaces:
        _add_joint(body, surface, reference.throw_deg)
    plugin = etree.SubElement(
        body,
        "plugin",
        filename="libAdvancedLiftDragPlugin.so" if classic else "gz-sim-advanced-lift-drag-system",
        name="advanced_lift_drag" if classic else "gz::sim::systems::AdvancedLiftDrag",
    )
    for tag in TAGS:
        _add(plugin, tag, model.tags[tag])
    etree.SubElement(plugin, "ref_pt" if classic else "cp").text = "0 0 0"
    etree.SubElement(plugin, "forward").text = "1 0 0"
    etree.SubElement(plugin, "upward").text = "0 0 1"
    etree.SubElement(plugin, "link_name").text = "base_link"
    etree.SubElement(plugin, "num_ctrl_surfaces").text = str(len(model.surfaces))
    for index, surface in enumerate(model.surfaces):
        element = etree.SubElement(plugin, "control_surface")
        etree.SubElement(element, "name").text = surface.name
        etree.SubElement(element, "index").text = str(index)
        _add(element, "direction", surface.direction)
        for key in ("CD", "CY", "CL", "Cell", "Cem", "Cen"):
            _add(element, f"{key}_ctrl", surface.effects[f"{key}_ctrl"])
    if classic:
        etree.SubElement(plugin, "robotNamespace").text = ""
    etree.indent(sdf)
    return bytes(etree.tostring(sdf, xml_declaration=True, encoding="utf-8", pretty_print=True))


def _add(parent: etree._Element, tag: str, number: float) -> None:
    """Add an element with a number, which its shortest text repeats exactly."""
    etree.SubElement(parent, tag).text = repr(float(number))


def _add_joint(
    body: etree._Element, surface: ControlSurface, throw_deg: Mapping[str, float]
) -> None:
    """Add a surface's link and joint. Its axis points left, a rudder's up."""
    link = etree.SubElement(body, "link", name=surface.name.removesuffix("_joint"))
    inertial = etree.SubElement(link, "inertial")
    _add(inertial, "mass", 1e-6)
    inertia = etree.SubElement(inertial, "inertia")
    for tag in ("ixx", "iyy", "izz"):
        _add(inertia, tag, 1e-9)
    joint = etree.SubElement(body, "joint", name=surface.name, type="revolute")
    etree.SubElement(joint, "parent").text = "base_link"
    etree.SubElement(joint, "child").text = link.get("name")
    axis = etree.SubElement(joint, "axis")
    variable = next(iter(surface.shares))
    etree.SubElement(axis, "xyz").text = "0 0 1" if variable == "dr" else "0 1 0"
    limit = etree.SubElement(axis, "limit")
    name = {"de": "elevator", "da": "aileron", "dr": "rudder"}[variable]
    travel = math.radians(throw_deg.get(name, 25.0))
    _add(limit, "lower", -travel)
    _add(limit, "upper", travel)


def _inertial(path: Path, root: etree._Element, plugin: etree._Element) -> etree._Element | None:
    """Return the inertial element of the link that the plugin moves."""
    link_name = (plugin.findtext("link_name") or "").strip().split("::")[-1]
    links = list(root.iter("link"))
    selected = [link for link in links if link.get("name") == link_name] or links[:1]
    return selected[0].find("inertial") if selected else None


def _mass(path: Path, inertial: etree._Element | None) -> tuple[float, FloatArray]:
    """Return the mass and the inertia (3, 3) in forward, right, down; NaN where there is none."""
    matrix, mass = np.full((3, 3), math.nan), math.nan
    if inertial is not None:
        mass = _number(path, inertial, "mass", math.nan)
        inertia = inertial.find("inertia")
        if inertia is not None:
            moments = {
                tag: _number(path, inertia, tag, 0.0)
                for tag in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
            }
            # From forward, left, up to forward, right, down.
            xy, xz, yz = -moments["ixy"], -moments["ixz"], moments["iyz"]
            matrix = np.array(
                [[moments["ixx"], xy, xz], [xy, moments["iyy"], yz], [xz, yz, moments["izz"]]]
            )
    return mass, matrix


def _root(path: Path) -> etree._Element:
    """Parse an SDF file. Raises BadInputError with its line."""
    try:
        return etree.fromstring(
            read_regular(path, 5_000_000),
            etree.XMLParser(resolve_entities=False, no_network=True, huge_tree=False),
        )
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except etree.XMLSyntaxError as error:
        raise BadInputError(f"{path}:{error.lineno or 1}: no XML: {error.msg}") from None


def read(path: Path) -> tuple[LiftDragModel, Reference]:
    """Read the first AdvancedLiftDrag element of an SDF file, and its link's mass and inertia.

    Geometry of the element; mass and inertia are NaN where the link has none.

    Raises
    ------
    BadInputError
        With the line, for no such element, or numbers and axes that are none.
    """
    root = _root(path)
    plugins = {
        element: f"{element.get('filename')}{element.get('name')}".lower().replace("_", "")
        for element in root.iter("plugin")
    }
    plugin = next((e for e, name in plugins.items() if "advancedliftdrag" in name), None)
    if plugin is None:
        plain = sum("liftdrag" in name for name in plugins.values())
        raise BadInputError(
            f"{path}: has no plugin AdvancedLiftDrag; nothing can be compared"
            + (f" ({plain} plugins LiftDrag, of single wings, are not read)" if plain else "")
        )
    # Tags that are missing are 0 in the program, but for these.
    defaults = {"alpha_stall": math.pi / 2.0, "air_density": 1.2041, "area": 1.0}
    tags = {tag: _number(path, plugin, tag, defaults.get(tag, 0.0)) for tag in TAGS}
    for tag in ("area", "AR", "eff"):
        if not tags[tag] > 0.0:
            raise BadInputError(f"{path}: <{tag}> = {tags[tag]:g}: a number above 0 is needed")
    joints = {joint.get("name"): joint for joint in root.iter("joint")}
    # The program counts on <num_ctrl_surfaces>.
    count = round(_number(path, plugin, "num_ctrl_surfaces", 0.0))
    elements = list(plugin.iter("control_surface"))[: max(count, 0)]
    names = [(element.findtext("name") or "").strip() for element in elements]
    links = [f"{name} {_child(joints.get(name))}" for name in names]
    has_elevator = any(variable_of(link) == "de" for link in links)
    surfaces = []
    for element, name, link in zip(elements, names, links, strict=True):
        effects = {key: _number(path, element, key, 0.0) for key in _CTRL}
        direction = _number(path, element, "direction", 1.0)
        along = _axis(path, joints.get(name))
        shares = _shares(link, along, {k: direction * x for k, x in effects.items()}, has_elevator)
        surfaces.append(ControlSurface(name, shares, direction, effects))
    inertial = _inertial(path, root, plugin)
    mass, inertia = _mass(path, inertial)
    place = None if inertial is None else inertial.find("pose")
    centre = np.zeros(3) if place is None else _vector(path, place, 3)
    # Gazebo classic's point is <ref_pt>; its forces act there from the centre of gravity.
    classic = plugin.find("ref_pt") is not None
    at = plugin.find("ref_pt" if classic else "cp")
    point = np.zeros(3) if at is None else _vector(path, at, 3)
    arm = point if classic else point - centre
    span = math.sqrt(tags["area"] * tags["AR"])
    throws = {
        name: _travel(path, [joints.get(s.name) for s in surfaces if variable in s.shares])
        for variable, name in (("de", "elevator"), ("da", "aileron"), ("dr", "rudder"))
    }
    chord = tags["mac"] or tags["area"] / span
    return (
        LiftDragModel(tags, surfaces, _down(arm), _down(point - centre), _axes(path, plugin)),
        Reference(tags["area"], span, chord, mass, inertia, throws),
    )


def _axes(path: Path, plugin: etree._Element) -> FloatArray:
    """Return the system's forward, right and down in those of the link."""
    rows = []
    for tag, default in (("forward", (1.0, 0.0, 0.0)), ("upward", (0.0, 0.0, 1.0))):
        element = plugin.find(tag)
        vector = np.array(default) if element is None else _vector(path, element, 3)
        length = float(np.linalg.norm(vector))
        if not length > 0.0:
            raise BadInputError(f"{path}: <{tag}> has no length; a direction is needed")
        rows.append(vector / length)
    forward, upward = rows
    if abs(float(forward @ upward)) > 1e-3:
        raise BadInputError(f"{path}: <forward> and <upward> are not perpendicular")
    axes = np.array([forward, np.cross(forward, upward), -upward])
    # From forward, left, up of the link to its forward, right, down.
    return np.asarray(axes * np.array([1.0, -1.0, -1.0]) + 0.0)


def _down(vector: FloatArray) -> tuple[float, float, float]:
    """Return a vector of forward, left, up in forward, right, down."""
    x, y, z = map(float, vector)
    return x, 0.0 - y, 0.0 - z


def _vector(path: Path, element: etree._Element, count: int) -> FloatArray:
    """Return the first numbers of an element's text."""
    try:
        vector = np.array([float(word) for word in (element.text or "").split()][:count])
    except ValueError:
        vector = np.zeros(0)
    if len(vector) < count or not np.all(np.isfinite(vector)):
        raise BadInputError(
            f"{path}:{element.sourceline}: <{element.tag}> {element.text!r}: {count} finite numbers"
            " are needed"
        )
    return vector


def _child(joint: etree._Element | None) -> str:
    """Return the name of the link that a joint turns."""
    return "" if joint is None else (joint.findtext("child") or "").strip()


def _axis(path: Path, joint: etree._Element | None) -> FloatArray:
    """Return the axis of a joint in forward, left, up; left and up both where the file has none."""
    element = None if joint is None else joint.find("axis/xyz")
    return np.array([0.0, 1.0, 1.0]) if element is None else _vector(path, element, 3)


def _travel(path: Path, joints: Sequence[etree._Element | None]) -> float:
    """Return the largest deflection [deg] of joints; 20 where the file limits none."""
    limits = [joint.find("axis/limit") for joint in joints if joint is not None]
    ends = [
        math.degrees(abs(_number(path, limit, tag, 0.0)))
        for limit in limits
        if limit is not None
        for tag in ("lower", "upper")
    ]
    return max((end for end in ends if 1.0 < end < 90.0), default=20.0)


def _shares(
    name: str, axis: FloatArray, effects: Mapping[str, float], has_elevator: bool
) -> dict[str, float]:
    """Return a joint's angle over each deflection that moves it.

    Deflections are positive trailing edge down (ailerons: of the left one), trailing edge left for
    a rudder; the joint's and link's names tell the surface, its axis the sign. Elevons and v-tails
    move with two of them; the elevons of an aeroplane with an elevator are ailerons. A surface
    whose names tell nothing is what its moments are largest of, with this project's signs.

    Parameters
    ----------
    name : str
        Of joint and link.
    axis : ndarray
        Of the joint, forward, left, up.
    effects : Mapping
        Per degree of the joint.
    has_elevator : bool
        Whether another joint is an elevator.
    """
    lower = name.lower()
    edge_down = -math.copysign(1.0, axis[1])
    right = -1.0 if re.search(r"right|starboard|(?:^|[\W_])r(?:[\W_]|$)", lower) else 1.0
    if "elevon" in lower:
        ailerons = {"da": right * edge_down}
        return ailerons if has_elevator else {"de": edge_down, **ailerons}
    by_moment = {
        "de": -effects["Cem_ctrl"],
        "da": effects["Cell_ctrl"],
        "dr": -effects["Cen_ctrl"],
    }
    if re.search(r"v_?-?tail|ruddervator", lower):
        return {"de": edge_down, "dr": math.copysign(1.0, by_moment["dr"])}
    variable = variable_of(lower)
    if not variable and "flap" in lower:
        return {}
    if variable == "dr":
        return {"dr": -math.copysign(1.0, axis[2])}
    if variable:
        return {variable: edge_down * (right if variable == "da" else 1.0)}
    variable = max(by_moment, key=lambda v: abs(by_moment[v]))
    return {variable: math.copysign(1.0, by_moment[variable])} if by_moment[variable] else {}


def variable_of(name: str) -> str:
    """Return the deflection that a name tells: de, da, dr; "" for none, and for elevons."""
    words = {"elev": "de", "ail": "da", "rud": "dr"}
    lower = re.sub(r"elevon|ruddervator|v_?-?tail", "", name.lower())
    return next((variable for word, variable in words.items() if word in lower), "")


def _number(path: Path, parent: etree._Element, tag: str, default: float) -> float:
    """Return the number of a child element."""
    element = parent.find(tag)
    if element is None:
        return default
    try:
        number = float(element.text or "")
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise BadInputError(
            f"{path}:{element.sourceline}: <{tag}> {element.text!r}: a finite number is needed"
        )
    return number
