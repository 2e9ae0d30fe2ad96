"""airframe.toml and systems for an aircraft without a card, and scales of its functions.

`card_text` writes a card from measured facts. `add_scales` adds a scale and a bias to each force
and moment function of an aircraft without coefficient properties, and `bake_scales` later writes
scales into the author's numbers.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sysid.units import FT_M
from uqharness.simulator import (
    ALTITUDE_M,
    DT_S,
    MEMS_NOISE_STD,
    AircraftFacts,
    ControlFacts,
    HostProperty,
)
from uqharness.toml import as_toml, dotted
from uqharness.xml import (
    SLOT,
    AeroSection,
    Axis,
    Document,
    Insertion,
    Node,
    Reference,
    SectionEdit,
    append_child,
    append_remark,
    apply,
    attribute,
    call,
    declarations,
    declare,
    folder_documents,
    function_lines,
    number,
    property_value,
    replace_attribute,
    replace_text,
    value,
)

# Scales and biases. The author's functions are unchanged. In each axis one function follows that
# adds (scale - 1) times each function's value, and q S (b, c) times the biases, which are
# coefficients in the author's axes. At scale 1 and bias 0 it adds zero: the flight is
# bit-identical.

COEFFICIENT_PROPERTY = re.compile(r"aero/(CX|CY|CZ|Cl|Cm|Cn)_\w+")
SYSTEM_NAME = "scale-bias"
SCALE_PREFIX = "uq/scale/"
_IDENTIFIED = re.compile(rb"[ \t]*<!-- identified ([^>]*?)-->")


@dataclass(frozen=True)
class ScaledFunction:
    """A function with its scale and bias.

    Attributes
    ----------
    axis, function : str
        Axis, and the function's property.
    file, line
        Where it is written.
    scale, bias : str
        Properties.
    """

    axis: str
    function: str
    file: str
    line: int
    scale: str
    bias: str


def coefficient_properties(documents: list[Document]) -> list[str]:
    """Return the properties ``aero/<C>_<term>`` that files declare; they replace scales."""
    return [
        name
        for document in documents
        for name, _ in declarations(document)
        if COEFFICIENT_PROPERTY.fullmatch(name)
    ]


def add_scales(edit: SectionEdit, reference: Reference) -> tuple[SectionEdit, list[ScaledFunction]]:
    """Add the functions ``uq/scaled/<axis>``; return the edit and the scaled functions in order.

    The properties are declared by `scale_system`.
    """
    section = edit.section
    names, edit = _names(edit)
    short = _short_names(section, names)
    all_rows = []
    for _, axis in sorted(section.axes.items()):
        # Forces that act at the CG and at the aerodynamic centre need separate functions.
        for at_cg in (False, True):
            nodes = [
                node
                for node in axis.functions
                if (attribute(node, "apply_at_cg") == "true") is at_cg
            ]
            if not nodes:
                continue
            rows = [
                ScaledFunction(
                    axis.name,
                    names[id(node)],
                    str(axis.document.path.relative_to(section.folder)),
                    node.line,
                    f"uq/scale/{short[id(node)]}",
                    f"uq/bias/{short[id(node)]}",
                )
                for node in nodes
            ]
            all_rows += rows
            edit = edit.plus(
                axis.document,
                append_child(axis.document, axis.node, _function(axis, rows, at_cg, reference)),
            )
    return edit, all_rows


def scale_system(rows: list[ScaledFunction]) -> bytes:
    """Return the system that declares scales (1) and biases (0) with comments."""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        "<!--",
        (
            "  Factor and addition to each force and moment function of the aerodynamics, for"
            " identification and refinement."
        ),
        (
            "  A scale multiplies the function; a bias is a coefficient: q S bias for a force, q S"
            " b bias (ROLL, YAW) or q S c bias"
        ),
        "  (PITCH) for a moment, positive as the axis it stands in.",
        "-->",
        f'<system name="{SYSTEM_NAME}">',
    ]
    for row in rows:
        lines += [
            f"  {declare(row.scale, '1', f'{row.axis}: {row.function}')}",
            f"  {declare(row.bias, '0')}",
        ]
    return ("\n".join([*lines, "</system>"]) + "\n").encode("utf-8")


@dataclass(frozen=True)
class BakedScales:
    """Scales written into the author's numbers.

    Attributes
    ----------
    changed : dict of str to tuple of float
        Scale property to the author's number before and after.
    remaining : tuple of str
        Scales that stay properties: their functions have no single number, such as a table.
    """

    changed: Mapping[str, tuple[float, float]]
    remaining: tuple[str, ...]


def bake_scales(folder: Path) -> BakedScales:
    """Write the scales of an instrumented aircraft into the author's numbers, in place.

    In a product with a constant factor, that factor is multiplied by the scale, and the scale
    becomes 1; the model is unchanged to rounding (eight digits). Biases, and scales of functions
    without such a factor, are kept.

    Parameters
    ----------
    folder : Path
        Folder of the instrumented aircraft. Other bytes of its XML are unchanged; a comment gives
        the old number and the estimate.

    Returns
    -------
    BakedScales
        The changed numbers, and the scales that remain.
    """
    documents = list(folder_documents(folder))
    functions = _scaled_functions(documents)
    changed: dict[str, tuple[float, float]] = {}
    remaining = []
    edits: dict[Path, list[Insertion]] = {document.path: [] for document in documents}
    for document in documents:
        for name, declared in declarations(document):
            if not name.startswith(SCALE_PREFIX):
                continue
            scale = float(attribute(declared, "value"))
            if scale == 1.0:
                continue
            # A table, for example, has no constant factor.
            place = _constant_factor(documents, functions.get(name, ""))
            if place is None:
                remaining.append(name)
                continue
            owner, node = place
            before = number(node, f"<{node.tag}>", owner)
            changed[name] = (before, before * scale)
            # The comment of the estimate moves from the scale to the number.
            remark = f"was {node.text.strip()}, times {name} = {scale:.8g}"
            note = _IDENTIFIED.search(_behind(document, declared))
            if note:
                remark += f" ({note.group(1).decode('utf-8', 'replace').strip()})"
            edits[owner.path] += [
                replace_text(owner, node, f"{before * scale:.8g}"),
                append_remark(owner, node, remark),
            ]
            edits[document.path] += [replace_attribute(document, declared, "value", "1")]
            if note:
                at = declared.end + note.start()
                edits[document.path].append(Insertion(at, b"", note.group(0)))
    for document in documents:
        if edits[document.path]:
            document.path.write_bytes(apply(document, edits[document.path]))
    return BakedScales(changed, tuple(remaining))


def _behind(document: Document, node: Node) -> bytes:
    """Return the bytes between an element and the end of its line."""
    end = document.raw.find(b"\n", node.end)
    return document.raw[node.end : None if end < 0 else end]


def _scaled_functions(documents: Iterable[Document]) -> dict[str, str]:
    """Return scale property to the name of the function that it multiplies."""
    functions = {}
    for document in documents:
        for product in document.root.walk():
            if product.tag != "product" or len(product.children) != 2:
                continue
            # The form that `_function` writes: (scale - 1) times the function.
            difference, function = product.children
            if difference.tag != "difference" or not difference.children:
                continue
            scale = difference.children[0].text.strip()
            if scale.startswith(SCALE_PREFIX):
                functions[scale] = function.text.strip()
    return functions


def _constant_factor(documents: Iterable[Document], name: str) -> tuple[Document, Node] | None:
    """Return the constant factor of a function, with its file; None without one."""
    for document in documents:
        for node in document.root.walk():
            if node.tag != "function" or re.sub(r"\s", "-", attribute(node, "name")) != name:
                continue
            body = [child for child in node.children if child.tag != "description"]
            if len(body) != 1 or body[0].tag not in ("product", "value", "v"):
                return None
            factors = body[0].children if body[0].tag == "product" else body
            constants = [child for child in factors if child.tag in ("value", "v")]
            # The last constant is the coefficient; earlier ones convert units.
            return (document, constants[-1]) if constants else None
    return None


def _function(
    axis: Axis, rows: list[ScaledFunction], at_cg: bool, reference: Reference
) -> list[str]:
    """Return the lines of the function that adds scales and biases of an axis."""
    slot = SLOT[axis.name]
    lengths = [reference.lengths[slot - 3]] if slot >= 3 else []
    scaled = [
        call(
            "product",
            call("difference", property_value(row.scale), value(1, "g")),
            property_value(row.function),
        )
        for row in rows
    ]
    biases = call(
        "product",
        property_value("aero/qbar-psf"),
        reference.area,
        *lengths,
        call("sum", *(property_value(row.bias) for row in rows)),
    )
    name = f"uq/scaled/{axis.name}{'-at-cg' if at_cg else ''}"
    return function_lines(name, "sum", [term.line() for term in (*scaled, biases)], at_cg)


def _names(edit: SectionEdit) -> tuple[dict[int, str], SectionEdit]:
    """Return the property of each function; functions without a name get one."""
    names: dict[int, str] = {}
    for axis in edit.section.axes.values():
        for k, node in enumerate(axis.functions, 1):
            name = attribute(node, "name")
            if not name:
                name = f"uq/own/{axis.name}-{k}"
                edit = edit.plus(
                    axis.document,
                    Insertion(node.start + len("<function"), f' name="{name}"'.encode("ascii")),
                )
            # JSBSim turns white space in a name into hyphens (FGPropertyManager::mkPropertyName).
            names[id(node)] = re.sub(r"\s", "-", name)
    return names, edit


def _short_names(section: AeroSection, names: dict[int, str]) -> dict[int, str]:
    """Return the last part of each function's name if it is unique, else all of it with hyphens."""
    nodes: list[tuple[Axis, Node]] = [
        (axis, node) for axis in section.axes.values() for node in axis.functions
    ]
    # Names that are unique by their last part are shortened.
    count = Counter(_leaf(names[id(node)]) for _, node in nodes)
    out = {}
    for axis, node in nodes:
        name = names[id(node)]
        short = _leaf(name) if count[_leaf(name)] == 1 else name.strip("/").replace("/", "-")
        short = re.sub(r"[^\w.\-]", "-", short)
        out[id(node)] = short if re.match(r"[A-Za-z_]", short) else f"{axis.name}-{short}"
    return out


def _leaf(name: str) -> str:
    """Return the last part of a name."""
    return name.rstrip("/").rsplit("/", 1)[-1]


_ASSUMED_THROW_DEG = 20.0
ERRORS_SYSTEM = "path-errors"
# A surface that is commanded by its angle has an assumed reach.
_LIMITS: Mapping[str, list[float]] = {
    "norm": [-1, 1],
    "deg": [-20, 20],
    "rad": [-0.35, 0.35],
}
_POSITIVE = {
    "elevator": ("nose down", "nose up"),
    "aileron": ("right wing down", "left wing down"),
    "rudder": ("nose left", "nose right"),
    "throttle": ("more thrust", "less thrust"),
}


def card_text(
    name: str, xml: str, facts: AircraftFacts, scaled: Sequence[ScaledFunction], errors: bool
) -> str:
    """Return airframe.toml for an aircraft without one.

    Parameters
    ----------
    name, xml : str
        Name and XML file of the aircraft.
    facts : AircraftFacts
        Measured facts.
    scaled : sequence of Scaled
        Scales, which become parameters.
    errors : bool
        Whether the system path-errors is added, whose properties score missions.
    """
    # Header, which says what to check before trusting the card.
    plain_name = as_toml(name)[1:-1]
    lines = [
        (
            f"# What XML cannot say of {plain_name}. Written by `uqharness instrument`, which"
            f" measured the aircraft in JSBSim{_where(facts)}:"
        ),
        (
            "# read it before trusting it. A throw is degrees of surface per unit of the normalised"
            " command, mean of both ends, with + as"
        ),
        "# a flight record counts (nose down, right wing down, nose left).",
        "",
        "[aircraft]",
        f"name = {as_toml(name)}",
        f"xml = {as_toml(xml)}",
        f"dt_s = {facts.dt_s:g}"
        + ("     # its propellers are unstable at 0.01 s" if facts.dt_s < DT_S else ""),
        "",
        "[reference]                                   # the XML's metrics",
        f"S_m2 = {facts.S_m2!r}",
        f"b_m = {facts.b_m!r}",
        f"c_m = {facts.c_m!r}",
    ]
    # One section for each control: its property, unit, sign and limits.
    for control, control_facts in facts.controls.items():
        remark = _remark(control_facts)
        lines += [
            "",
            f"[inputs.{control}]{' ' * (45 - len(control) - 9)}{remark}".rstrip(),
            f"property = {as_toml(control_facts.property or f'fcs/{control}-cmd-norm')}",
            f'unit = "{control_facts.unit}"',
        ]
        lines += [
            f'positive = "{_POSITIVE[control][control_facts.sense < 0]}"',
            f"limits = {_limits(control, control_facts)}",
        ]
        throw = control_facts.throw_deg
        if control != "throttle" and control_facts.unit == "norm":
            # Surfaces without a measured angle get an assumed throw.
            assumed = "" if throw is not None else "     # assumed: the XML tells no angle"
            if throw is None:
                throw = _ASSUMED_THROW_DEG if control_facts.sense else 1.0
            lines.append(f"throw_deg = {(control_facts.sense or 1) * throw:.6g}{assumed}")
        lines.append(
            f"servo_pwm = {_pulses(control, throw)}     # assumed: your log's, if it has others"
        )
        if control_facts.position is not None:
            lines.append(f"position = {as_toml(control_facts.position)}")
        if control_facts.position_unit is not None:
            lines.append(f'position_unit = "{control_facts.position_unit}"')
    # Noise cannot be measured in JSBSim; small MEMS units are assumed.
    lines += ["", "[sensors.noise_std]                            # assumed: small MEMS units; SI"]
    lines += [f"{name} = {std!r}" for name, std in MEMS_NOISE_STD.items()]
    # A mission scores what the added system computes.
    if errors:
        lines += [
            "",
            (
                "[metrics]                                     # from the line the flight began"
                f" on: Systems/{ERRORS_SYSTEM}.xml"
            ),
            'cross_track = { true = "nav/cross-track-m" }',
            'altitude = { true = "nav/altitude-error-m" }',
            'speed = { true = "nav/speed-error-mps" }',
            'distance_3d = { true = "nav/distance-3d-m" }',
            "",
            "[replay]                                      # nothing in the aircraft reads it",
            f'without_systems = ["{ERRORS_SYSTEM}"]',
        ]
    # Scale factors become parameters that identify can estimate.
    if scaled:
        lines += [
            "",
            (
                "# Factors on the aircraft's own functions. The biases (uq/bias/...) of one axis"
                " act alike, so none is a default."
            ),
            "[parameters]",
        ]
        lines += [f"{dotted((row.scale,))} = {_inline(scale_entry(row))}" for row in scaled]
    # What a simulator host provides stays with the aircraft.
    if facts.host:
        lines += ["", *host_lines(facts.host)]
    return "\n".join(lines) + "\n"


def _limits(control: str, facts: ControlFacts) -> list[float]:
    """Return the range of a command."""
    if control == "throttle":
        return [0, 100] if facts.unit == "pct" else [0, 1]
    return _LIMITS[facts.unit]


_HOST_REMARKS = {"system": "on", "command": "an input of the model"}


def host_lines(host: Sequence[HostProperty]) -> list[str]:
    """Return the section [host] of a card."""
    return [
        "[host]                                        # provided by FlightGear, its host",
        "# A number, or JSBSim's properties times numbers. Edit it where the aircraft needs",
        "# another state of its systems; what FlightGear leaves to scripts is a guess.",
        *(_host_line(row) for row in host),
    ]


def _host_line(row: HostProperty) -> str:
    """Return the line of a host's property in the card."""
    try:
        source: float | str = float(row.source)
    except ValueError:
        source = row.source
    line = f"{as_toml(row.name)} = {as_toml(source)}"
    remark = _HOST_REMARKS.get(row.kind, "")
    return f"{line}     # {remark}" if remark else line


def _where(facts: AircraftFacts) -> str:
    """Return speed and altitude of the measurement as text."""
    if not math.isfinite(facts.V_mps):
        return ""
    return f" at {facts.V_mps:.0f} m/s, {ALTITUDE_M:.0f} m"


def _remark(facts: ControlFacts) -> str:
    """Return the comment behind a control's heading; empty if its keys say everything."""
    if facts.unmeasured:
        return f"# not measured, so sense and throw are assumed: {facts.unmeasured}"
    if not facts.sense:
        return "# moves nothing in this aircraft"
    if facts.thrust_N is not None:
        closed, opened = (round(thrust, 3) + 0.0 for thrust in facts.thrust_N)
        return f"# thrust {closed:.4g} N closed, {opened:.4g} N open"
    return ""


def _pulses(control: str, throw_deg: float | None) -> list[list[float]]:
    """Return servo pulses [us] and their meaning: degrees of a surface, percent of a throttle."""
    if control == "throttle" or throw_deg is None:
        return [[1000, 0], [2000, 100]]
    reach = float(f"{abs(throw_deg):.6g}")
    return [[1000, -reach], [1500, 0], [2000, reach]]


def scale_entry(row: ScaledFunction) -> dict[str, Any]:
    """Return the entry of a scale in [parameters]."""
    return {"initial": 1.0, "bounds": [-1, 4], "unit": "1", "source": f"factor on {row.function}"}


def _inline(entry: Mapping[str, Any]) -> str:
    """Return an inline table of TOML."""
    return "{ " + ", ".join(f"{key} = {as_toml(value)}" for key, value in entry.items()) + " }"


IDLE_SYSTEM = "idle-throttle"
IDLE_XML = b"""<?xml version="1.0" encoding="UTF-8"?>
<!-- JSBSim makes this property for aircraft with engines alone; hosts set it and records \
have a column for it. -->
<system name="idle-throttle">
  <property value="0">fcs/throttle-cmd-norm</property>
</system>
"""

ERRORS_XML = f"""<?xml version="1.0" encoding="UTF-8"?>
<!--
  How far the flight is from the steady straight one it began as: for scoring a mission \
of an aircraft that has no navigation.
  Read ten times a second at a step of 0.01 s; nothing in the aircraft reads it.

    nav/cross-track-m      m    distance from the line of the initial velocity over the ground, \
+ to the right of it
    nav/altitude-error-m   m    height above the initial one
    nav/speed-error-mps    m/s  true airspeed less the initial one
    nav/distance-3d-m      m    distance from the line, height included
-->
<system name="path-errors">
  <channel name="Errors" execrate="10">
    <fcs_function name="nav/cross-track-m">
      <function>
        <quotient>
          <product>
            <value>{FT_M}</value>
            <difference>
              <product> <property>position/from-start-neu-e-ft</property> \
<property>ic/vn-fps</property> </product>
              <product> <property>position/from-start-neu-n-ft</property> \
<property>ic/ve-fps</property> </product>
            </difference>
          </product>
          <sqrt>
            <sum>
              <product> <property>ic/vn-fps</property> <property>ic/vn-fps</property> </product>
              <product> <property>ic/ve-fps</property> <property>ic/ve-fps</property> </product>
            </sum>
          </sqrt>
        </quotient>
      </function>
    </fcs_function>
    <fcs_function name="nav/altitude-error-m">
      <function>
        <product>
          <value>{FT_M}</value>
          <difference> <property>position/h-sl-ft</property> \
<property>ic/h-sl-ft</property> </difference>
        </product>
      </function>
    </fcs_function>
    <fcs_function name="nav/speed-error-mps">
      <function>
        <product>
          <value>{FT_M}</value>
          <difference> <property>velocities/vt-fps</property> \
<property>ic/vt-fps</property> </difference>
        </product>
      </function>
    </fcs_function>
    <fcs_function name="nav/distance-3d-m">
      <function>
        <sqrt>
          <sum>
            <product> <property>nav/cross-track-m</property> \
<property>nav/cross-track-m</property> </product>
            <product> <property>nav/altitude-error-m</property> \
<property>nav/altitude-error-m</property> </product>
          </sum>
        </sqrt>
      </function>
    </fcs_function>
  </channel>
</system>
""".encode()
