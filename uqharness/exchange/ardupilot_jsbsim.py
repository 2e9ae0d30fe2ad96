"""An aircraft folder for ArduPilot's JSBSim backend, ``--model jsbsim:NAME``.

The backend (libraries/SITL/SIM_JSBSim.cpp) owns the run script: it puts the aircraft on the ground,
starts engine 0, trims on the gear, and then sets ``fcs/*-cmd-norm`` in every frame at 1,200 Hz. The
copy written here has what that needs: commands scaled to the model's own, the eye point at the
accelerometer, contact points, and properties that the backend sets in an aircraft without engines.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from sysid.units import FT_M, G0_MPS2, IN_M
from uqharness.errors import BadInputError
from uqharness.exchange.frozen_copy import (
    copied_files,
    declared_values,
    subfolder,
    write_aircraft,
)
from uqharness.exchange.states import Derivatives, SourceModel
from uqharness.isolation import ProcessEndedError, run_in_worker
from uqharness.simulator import (
    Aircraft,
    Staging,
    engine,
    open_aircraft,
)
from uqharness.xml import (
    Document,
    Insertion,
    Node,
    append_child,
    apply,
    attribute,
    insert_before,
    parse_document,
)

RATE_HZ = 1200.0
"""Frames per second of the backend."""
SWITCH = "ardupilot/commands"
"""Property that is 1 where ArduPilot's commands drive the model, 0 where its own commands do."""
SYSTEM = "ardupilot"
LOST_TERMS = ("nothing of the aerodynamics: the program runs JSBSim",)
_COMMANDS = ("elevator", "aileron", "rudder", "throttle")
_OWN_GAINS = ("EST_HGT_OMEGA", "RATE_D_ON", "EAS2TAS")
"""Parameters under ``ap/`` that ArduPlane does not have by this name."""
_PARAMETER = re.compile(r"[A-Z][A-Z0-9_]+")
_SETTLE_S = 10.0


@dataclass(frozen=True)
class GroundStart:
    """How the aircraft stands 10 s after the backend's start with closed throttle.

    Attributes
    ----------
    height_m : float
        Height of the CG above the ground.
    theta_rad, phi_rad : float
        Attitude.
    failure : str
        Why the start failed; empty if it did not.
    """

    height_m: float = math.nan
    theta_rad: float = math.nan
    phi_rad: float = math.nan
    failure: str = ""


def write_folder(
    source: SourceModel, name: str, root: Path, replace_contacts: bool = False
) -> Aircraft:
    """Write ``root/aircraft/NAME`` and return it as an aircraft.

    Parameters
    ----------
    source : SourceModel
        Its properties are frozen in the copy's files.
    name : str
        Name of the copy's folder and XML file.
    root : Path
        What ArduPilot calls its autotest directory.
    replace_contacts : bool
        Whether three wheels replace contact points on which the backend cannot trim.

    Raises
    ------
    BadInputError
        If a property to be frozen is declared by no file of the aircraft.
    """
    aircraft = source.aircraft
    files = copied_files(source, name)
    systems = subfolder(files, "systems")
    document = parse_document(Path(f"{name}.xml"), files[f"{name}.xml"])
    fdm = open_aircraft(aircraft)
    engine.run_ic(fdm)  # fills the tanks and places the CG
    engines = fdm.get_propulsion().get_num_engines()
    contacts = fdm.get_ground_reactions().get_num_gear_units()
    cg_in = [float(fdm[f"inertia/cg-{axis}-in"]) for axis in "xyz"]
    insertions = [
        *_system_reference(document),
        *_eye_point(document, cg_in, aircraft.accelerometer_m),
        *(_contact_points(document, source, cg_in) if replace_contacts or contacts < 3 else []),
    ]
    files[f"{name}.xml"] = apply(document, insertions)
    files[f"{systems}/{SYSTEM}.xml"] = _command_system(aircraft, engines)
    files["airframe.toml"] = _card(files["airframe.toml"].decode())
    return write_aircraft(files, name, root)


def _system_reference(document: Document) -> list[Insertion]:
    """Return the reference to the system of commands, before all that may read commands."""
    sections = ("system", "autopilot", "flight_control", "external_reactions", "aerodynamics")
    first = min(
        (node for node in document.root.children if node.tag in sections),
        key=lambda node: node.start,
        default=None,
    )
    line = [f'<system file="{SYSTEM}"/>  <!-- commands of ArduPilot -->']
    if first is None:
        return [append_child(document, document.root, line)]
    return [insert_before(document, first, line)]


def _command_system(aircraft: Aircraft, engines: int) -> bytes:
    """Return the system that scales the normalised commands to those of the model."""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        "<!-- ArduPilot sets fcs/aileron-, elevator-, rudder- and throttle-cmd-norm in each frame.",
        f"     With {SWITCH} at 1 they are scaled to the commands of the model. -->",
        f'<system name="{SYSTEM}">',
        f'  <property value="1">{SWITCH}</property>',
    ]
    if not engines:
        declared = declared_values(aircraft)
        # The backend sets both; JSBSim drops the whole frame's commands where one is unknown.
        lines += [
            f'  <property value="0">{name}</property>'
            for name in ("fcs/throttle-cmd-norm", "propulsion/engine[0]/set-running")
            if name not in declared
        ]
    scales = [line for control in _COMMANDS for line in _scale(aircraft, control, engines)]
    if scales:
        lines += [f'  <channel name="{SYSTEM}" execute="{SWITCH}">', *scales, "  </channel>"]
    return "\n".join([*lines, "</system>", ""]).encode()


def _scale(aircraft: Aircraft, control: str, engines: int) -> list[str]:
    """Return the components that drive a control of the model by the normalised command.

    Full command either way is the end of the travel on that side.
    """
    command = f"fcs/{control}-cmd-norm"
    targets: dict[str, tuple[float, float]] = {}
    card = aircraft.card.inputs.get(control)
    if card is not None and card.property.removesuffix("[0]") != command:
        targets[card.property] = card.limits
    if control == "throttle":
        # The backend commands the first engine alone.
        targets |= {f"{command}[{k}]": (0.0, 1.0) for k in range(1, engines)}
    lines = []
    for k, (name, (low, high)) in enumerate(targets.items()):
        points = [(0.0, low), (1.0, high)]
        if control != "throttle":
            points = [(-1.0, low), (0.0, 0.0), (1.0, high)]
        lines += [
            f'    <fcs_function name="{SYSTEM}/{control}-{k}">',
            "      <function>",
            "        <table>",
            f'          <independentVar lookup="row">{command}</independentVar>',
            "          <tableData>",
            *(f"            {x:g} {y:.12g}" for x, y in points),
            "          </tableData>",
            "        </table>",
            "      </function>",
            f"      <output>{name}</output>",
            "    </fcs_function>",
        ]
    return lines


def _eye_point(
    document: Document, cg_in: list[float], accelerometer_m: tuple[float, float, float]
) -> list[Insertion]:
    """Return the edit that puts EYEPOINT, where the backend reads accelerations, at the IMU."""
    forward, right, down = accelerometer_m
    # Structural axes point aft, right and up.
    place = (
        cg_in[0] * IN_M - forward,
        cg_in[1] * IN_M + right,
        cg_in[2] * IN_M - down,
    )
    x, y, z = (f"{value + 0.0:.9g}" for value in place)
    line = f'<location name="EYEPOINT" unit="M"> <x>{x}</x> <y>{y}</y> <z>{z}</z> </location>'
    metrics = next(node for node in document.root.children if node.tag == "metrics")
    old = [
        node
        for node in metrics.children
        if node.tag == "location" and attribute(node, "name") == "EYEPOINT"
    ]
    if not old:
        return [append_child(document, metrics, [f"{line}  <!-- of the accelerometers -->"])]
    return [Insertion(n.start, document.encoded(line), document.raw[n.start : n.end]) for n in old]


def _contact_points(document: Document, source: SourceModel, cg_in: list[float]) -> list[Insertion]:
    """Return three wheels below the CG: one in front, two beside and a little behind it."""
    reference = source.reference
    span = reference.b_m
    weight_n = reference.mass_kg * G0_MPS2
    # Each carries a third of the weight at 2 cm, damped at .7 of critical.
    spring = weight_n / 3.0 / 0.02
    damping = 2.0 * 0.7 * math.sqrt(spring * reference.mass_kg / 3.0)
    # The backend starts 1.3 m above the ground.
    below = min(0.08 * span, 1.0)
    # At 13 deg nose up the CG must still be in front of the main wheels.
    behind = below * math.tan(math.radians(20.0))
    places = {
        "NOSE": (-0.25 * span, 0.0),
        "LEFT": (behind, -0.1 * span),
        "RIGHT": (behind, 0.1 * span),
    }
    lines = []
    for wheel, (aft, right) in places.items():
        x, y, z = (cg_in[0] * IN_M + aft, cg_in[1] * IN_M + right, cg_in[2] * IN_M - below)
        lines += [
            f'<contact type="BOGEY" name="{wheel}">',
            f'  <location unit="M"> <x>{x:.6g}</x> <y>{y:.6g}</y> <z>{z:.6g}</z> </location>',
            "  <static_friction>0.5</static_friction>",
            "  <dynamic_friction>0.5</dynamic_friction>",
            "  <rolling_friction>0.02</rolling_friction>",
            f'  <spring_coeff unit="N/M">{spring:.6g}</spring_coeff>',
            f'  <damping_coeff unit="N/M/SEC">{damping:.6g}</damping_coeff>',
            '  <max_steer unit="DEG">0</max_steer>',
            "  <brake_group>NONE</brake_group>",
            "  <retractable>0</retractable>",
            "</contact>",
        ]
    section = next((n for n in document.root.children if n.tag == "ground_reactions"), None)
    if section is not None:
        old = [node for node in section.children if node.tag == "contact"]
        removed = [_removal(document, node) for node in old]
        return [*removed, append_child(document, section, lines)]
    return [
        append_child(
            document,
            document.root,
            ["<ground_reactions>", *(f"  {line}" for line in lines), "</ground_reactions>"],
        )
    ]


def _removal(document: Document, node: Node) -> Insertion:
    """Return the edit that removes an element with the blank text before it."""
    start = len(document.raw[: node.start].rstrip())
    return Insertion(start, b"", document.raw[start : node.end])


def _card(text: str) -> bytes:
    """Return the card of the copy, with the model's own commands in open loop."""
    switch = f'"{SWITCH}" = 0'
    for pattern, replacement in (
        (r"(?m)^(\s*open_loop\s*=\s*\{)\s*(?=\S)", rf"\g<1> {switch}, "),
        (r"(?m)^(\[modes\.open_loop\].*)$", rf"\g<1>\n{switch}"),
        (r"(?m)^(\[modes\].*)$", rf"\g<1>\nopen_loop = {{ {switch} }}"),
    ):
        text, edits = re.subn(pattern, replacement, text, count=1)
        if edits:
            return text.replace(f"{switch}, }}", f"{switch} }}").encode()
    return f"{text.rstrip()}\n\n[modes]\nopen_loop = {{ {switch} }}\n".encode()


def parameters(source: SourceModel, fitted: Mapping[str, Derivatives]) -> str:
    """Return the ``.parm`` file: signs of the servos, speeds and throttle of the trim, and gains.

    ArduPlane commands nose up, right wing down and nose right; a servo is reversed where the
    model's own command does the opposite. Gains are the properties ``ap/NAME`` of an aircraft that
    has ArduPlane's loops as a system.
    """
    middle = source.middle
    values = {}
    for servo, coefficient, variable, surface in (
        (1, "Cl", "da", "aileron"),
        (2, "Cm", "de", "elevator"),
        (4, "Cn", "dr", "rudder"),
    ):
        # A command may move the surface against the sign of flight records.
        low, high = source.full(surface) if surface in source.controls else (0.0, 1.0)
        slope = fitted[coefficient].tangent(middle)[variable] * (high - low)
        values[f"SERVO{servo}_REVERSED"] = float(slope < 0.0)
    speed = source.trim.condition.V_mps
    values |= {
        "AIRSPEED_CRUISE": round(speed, 1),
        "AIRSPEED_MIN": round(0.75 * speed, 1),
        "AIRSPEED_MAX": round(1.3 * speed, 1),
    }
    throttle = source.aircraft.card.inputs.get("throttle")
    if throttle is not None and "throttle" in source.trim.controls:
        low, high = throttle.limits
        share = (source.trim.controls["throttle"] - low) / (high - low)
        values["TRIM_THROTTLE"] = round(100.0 * share)
    for prop, number in declared_values(source.aircraft).items():
        gain = prop.removeprefix("ap/")
        if gain == "RATE_FLTD":
            values |= {"RLL_RATE_FLTD": number, "PTCH_RATE_FLTD": number}
        elif prop != gain and gain not in _OWN_GAINS and _PARAMETER.fullmatch(gain):
            values[gain] = number
    # ArduPlane's speed controller needs room on both sides of the cruise speed.
    low, high = 1.15 * values["AIRSPEED_MIN"], 0.9 * values["AIRSPEED_MAX"]
    values["AIRSPEED_CRUISE"] = round(min(max(speed, low), high), 1)
    # A servo of the model's own must not be lagged twice.
    values["SIM_SERVO_SPEED"] = 0.0
    return "".join(f"{name} {value:g}\n" for name, value in values.items())


def ground_start(aircraft: Aircraft, root: Path) -> GroundStart:
    """Start the aircraft as the backend does and let it stand for 10 s.

    The same initial state (1.3 m above the ground, 13 deg nose up, no speed), the same frame rate
    and ground trim, and commands of 0. It runs in a process of its own, which JSBSim's ground trim
    ends on the contact points of some aircraft.
    """
    try:
        return run_in_worker(_stand, aircraft, root)
    except ProcessEndedError as error:
        return GroundStart(failure=error.reason)


def _stand(aircraft: Aircraft, root: Path) -> GroundStart:
    """Start the aircraft on the ground in this process."""
    place = root / "aircraft" / aircraft.name
    fdm = engine.open_fdm(Staging(root, place.name), 1.0 / RATE_HZ)
    fdm["ic/h-agl-ft"] = 1.3 / FT_M
    fdm["ic/theta-deg"] = 13.0
    fdm["ic/vt-fps"] = 0.0
    try:
        engine.run_ic(fdm)
        fdm["propulsion/engine[0]/set-running"] = 1.0
        for _ in range(round(0.01 * RATE_HZ) + 1):
            fdm.run()
        fdm["simulation/do_simple_trim"] = 2.0
        for _ in range(round(_SETTLE_S * RATE_HZ)):
            for name in _COMMANDS:
                fdm[f"fcs/{name}-cmd-norm"] = 0.0
            fdm.run()
    except BadInputError as error:
        return GroundStart(failure=str(error))
    except engine.RuntimeFailure as error:
        return GroundStart(failure=engine.explain(fdm, error))
    height_m = float(fdm["position/h-agl-ft"]) * FT_M
    theta, phi = float(fdm["attitude/theta-rad"]), float(fdm["attitude/phi-rad"])
    failure = ""
    if not all(map(math.isfinite, (height_m, theta, phi))):
        failure = "the motion diverges on the ground"
    elif height_m < 0.0 or abs(phi) > 0.5 or abs(theta) > 0.7:
        failure = (
            f"it comes to rest at {height_m:.2f} m with {math.degrees(theta):.0f} deg pitch and"
            f" {math.degrees(phi):.0f} deg bank; check the contact points"
        )
    return GroundStart(height_m, theta, phi, failure)
