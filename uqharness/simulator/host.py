"""FlightGear as the host of an aircraft: the properties that it provides, provided without it.

Many aircraft are written for FlightGear and read its property tree: pilot's controls, states in
FlightGear's units, and switches of systems that scripts drive. JSBSim alone has none of them and
ends at the first one that is missing. `scan` lists what a model reads, computes and declares,
`resolve` gives each property that only a host would provide a source, and `host_system_xml` writes
the sources as an ordinary ``<system>`` that runs before all others. A source is a number, or a sum
of JSBSim properties with factors, evaluated in every frame.

The conversions are those of FlightGear's interface (src/FDM/JSBSim/JSBSim.cxx, flight.cxx).
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import PurePosixPath
from typing import Any
from xml.parsers import expat
from xml.sax.saxutils import escape

from lxml import etree

from sysid.units import FT_M, RAD_DEG
from uqharness.errors import BadInputError

HOST_SYSTEM = "flightgear-host"
SWITCH = "host/flightgear"
"""Property that is 1 while the system copies; FlightGear itself would set it to 0."""
THROTTLE = "host/throttle-cmd-norm"
"""Command of all engines of an aircraft whose control system reads FlightGear's throttles."""


def _words(text: str) -> frozenset[str]:
    """Return the words of a text."""
    return frozenset(text.split())


_FPS_KT = 0.5924838
_INHG_PSF = 0.014139
# The lever that keeps the mixture of sea level, as a pilot leans it.
_LEANED = "0.00047254 * atmosphere/P-psf"
_PILOT_G = "-1 * accelerations/n-pilot-z-norm"

# Pilot's controls that FlightGear copies to JSBSim's commands, the other way round. The number
# applies where the model computes JSBSim's command itself: then FlightGear's is the input.
_CONTROLS: Mapping[str, tuple[str, float]] = {
    "/controls/flight/elevator": ("fcs/elevator-cmd-norm", 0.0),
    "/controls/flight/aileron": ("fcs/aileron-cmd-norm", 0.0),
    "/controls/flight/rudder": ("-1 * fcs/rudder-cmd-norm", 0.0),
    "/controls/flight/elevator-trim": ("fcs/pitch-trim-cmd-norm", 0.0),
    "/controls/flight/aileron-trim": ("fcs/roll-trim-cmd-norm", 0.0),
    "/controls/flight/rudder-trim": ("-1 * fcs/yaw-trim-cmd-norm", 0.0),
    "/controls/flight/flaps": ("fcs/flap-cmd-norm", 0.0),
    "/controls/flight/speedbrake": ("fcs/speedbrake-cmd-norm", 0.0),
    "/controls/flight/spoilers": ("fcs/spoiler-cmd-norm", 0.0),
    "/controls/engines/engine{n}/throttle": ("fcs/throttle-cmd-norm{n}", 0.0),
    "/controls/engines/engine{n}/mixture": ("fcs/mixture-cmd-norm{n}", 1.0),
    "/controls/engines/engine{n}/propeller-pitch": ("fcs/advance-cmd-norm{n}", 1.0),
    "/controls/engines/engine{n}/propeller-feather": ("fcs/feather-cmd-norm{n}", 0.0),
    "/controls/gear/gear-down": ("gear/gear-cmd-norm", 1.0),
    "/controls/gear/brake-left": ("fcs/left-brake-cmd-norm", 0.0),
    "/controls/gear/brake-right": ("fcs/right-brake-cmd-norm", 0.0),
    "/controls/gear/tiller-cmd-norm": ("fcs/steer-cmd-norm", 0.0),
}
_SURFACES = {
    "elevator": "/controls/flight/elevator",
    "aileron": "/controls/flight/aileron",
    "rudder": "/controls/flight/rudder",
}
# Scripts of some aircraft hand the throttle on under a name such as throttle-fdm.
_THROTTLES = re.compile(r"/controls/engines/engine(\[\d+\])?/throttle(-(?!idle)[\w\-]+)?")

# States that FlightGear computes from JSBSim's. The first source whose properties exist is taken.
_STATES: Mapping[str, tuple[str, ...]] = {
    "/velocities/airspeed-kt": ("velocities/vc-kts",),
    "/velocities/equivalent-kt": ("velocities/ve-kts",),
    "/velocities/groundspeed-kt": (f"{_FPS_KT} * velocities/vg-fps",),
    "/velocities/groundspeed-3D-kt": (f"{_FPS_KT} * velocities/ned-velocity-mag-fps",),
    "/velocities/mach": ("velocities/mach",),
    "/velocities/vertical-speed-fps": ("velocities/h-dot-fps",),
    "/velocities/speed-north-fps": ("velocities/v-north-fps",),
    "/velocities/speed-east-fps": ("velocities/v-east-fps",),
    "/velocities/speed-down-fps": ("velocities/v-down-fps",),
    "/velocities/uBody-fps": ("velocities/u-aero-fps",),
    "/velocities/vBody-fps": ("velocities/v-aero-fps",),
    "/velocities/wBody-fps": ("velocities/w-aero-fps",),
    "/velocities/uGround-fps": ("velocities/u-fps",),
    "/velocities/vGround-fps": ("velocities/v-fps",),
    "/velocities/wGround-fps": ("velocities/w-fps",),
    "/position/altitude-ft": ("position/h-sl-ft",),
    "/position/altitude-agl-ft": ("position/h-agl-ft",),
    "/position/altitude-agl-m": (f"{FT_M} * position/h-agl-ft",),
    "/position/gear-agl-ft": ("position/h-agl-ft",),
    "/position/gear-agl-m": (f"{FT_M} * position/h-agl-ft",),
    "/position/ground-elev-ft": ("position/terrain-elevation-asl-ft",),
    "/position/ground-elev-m": (f"{FT_M} * position/terrain-elevation-asl-ft",),
    "/position/latitude-deg": ("position/lat-geod-deg",),
    "/position/longitude-deg": ("position/long-gc-deg",),
    "/orientation/roll-deg": ("attitude/phi-deg",),
    "/orientation/pitch-deg": ("attitude/theta-deg",),
    "/orientation/heading-deg": ("attitude/psi-deg",),
    "/orientation/heading-magnetic-deg": ("attitude/psi-deg",),
    "/orientation/true-heading-deg": ("attitude/psi-deg",),
    "/orientation/track-deg": (f"{RAD_DEG} * flight-path/psi-gt-rad", "attitude/psi-deg"),
    "/orientation/alpha-deg": ("aero/alpha-deg",),
    "/orientation/side-slip-deg": ("aero/beta-deg",),
    "/orientation/side-slip-rad": ("aero/beta-rad",),
    "/orientation/path-deg": (f"{RAD_DEG} * flight-path/gamma-rad",),
    "/orientation/p-body": ("velocities/p-rad_sec",),
    "/orientation/q-body": ("velocities/q-rad_sec",),
    "/orientation/r-body": ("velocities/r-rad_sec",),
    "/orientation/roll-rate-degps": (f"{RAD_DEG} * velocities/phidot-rad_sec",),
    "/orientation/pitch-rate-degps": (f"{RAD_DEG} * velocities/thetadot-rad_sec",),
    "/orientation/yaw-rate-degps": (f"{RAD_DEG} * velocities/psidot-rad_sec",),
    "/accelerations/nlf": ("forces/load-factor",),
    "/accelerations/n-z-cg-fps_sec": ("accelerations/Nz",),
    "/accelerations/pilot-g": (_PILOT_G,),
    "/accelerations/pilot-gdamped": (_PILOT_G,),
    "/accelerations/pilot/x-accel-fps_sec": ("accelerations/a-pilot-x-ft_sec2",),
    "/accelerations/pilot/y-accel-fps_sec": ("accelerations/a-pilot-y-ft_sec2",),
    "/accelerations/pilot/z-accel-fps_sec": ("accelerations/a-pilot-z-ft_sec2",),
    "/engines/engine{n}/rpm": ("propulsion/engine{n}/engine-rpm", "propulsion/engine{n}/rpm"),
    "/engines/engine{n}/running": ("propulsion/engine{n}/set-running",),
    "/engines/engine{n}/n1": ("propulsion/engine{n}/n1",),
    "/engines/engine{n}/n2": ("propulsion/engine{n}/n2",),
    "/engines/engine{n}/thrust_lb": ("propulsion/engine{n}/thrust-lbs",),
    "/engines/engine{n}/thrust-lbs": ("propulsion/engine{n}/thrust-lbs",),
    "/engines/engine{n}/mp-inhg": ("propulsion/engine{n}/map-inhg",),
    "/engines/engine{n}/mp-osi": ("propulsion/engine{n}/map-inhg",),
    "/engines/engine{n}/egt-degf": ("propulsion/engine{n}/egt-degF",),
    "/engines/engine{n}/cht-degf": ("propulsion/engine{n}/cht-degF",),
    "/engines/engine{n}/itt_degf": ("1.8 * propulsion/engine{n}/itt-c + 32",),
    "/engines/engine{n}/oil-temperature-degf": ("propulsion/engine{n}/oil-temperature-degF",),
    "/engines/engine{n}/oil-pressure-psi": ("propulsion/engine{n}/oil-pressure-psi",),
    "/engines/engine{n}/fuel-flow-gph": ("propulsion/engine{n}/fuel-flow-rate-gph",),
    "/engines/engine{n}/fuel-flow_pph": ("3600 * propulsion/engine{n}/fuel-flow-rate-pps",),
    "/engines/engine{n}/thruster/rpm": ("propulsion/engine{n}/propeller-rpm",),
    "/engines/engine{n}/thruster/pitch": ("propulsion/engine{n}/blade-angle",),
    "/engines/engine{n}/thruster/torque": ("propulsion/engine{n}/propeller-torque-ftlb",),
    "/gear/gear{n}/wow": ("gear/unit{n}/WOW",),
    "/gear/gear{n}/compression-norm": ("gear/unit{n}/compression-ft",),
    "/gear/gear{n}/compression-ft": ("gear/unit{n}/compression-ft",),
    "/gear/gear{n}/rollspeed-ms": (f"{FT_M} * gear/unit{{n}}/wheel-speed-fps",),
    "/gear/gear{n}/position-norm": ("gear/gear-pos-norm",),
    "/surface-positions/elevator-pos-norm": ("fcs/elevator-pos-norm",),
    "/surface-positions/left-aileron-pos-norm": ("fcs/left-aileron-pos-norm",),
    "/surface-positions/right-aileron-pos-norm": ("fcs/right-aileron-pos-norm",),
    "/surface-positions/rudder-pos-norm": ("-1 * fcs/rudder-pos-norm",),
    "/surface-positions/flap-pos-norm": ("fcs/flap-pos-norm",),
    "/surface-positions/speedbrake-pos-norm": ("fcs/speedbrake-pos-norm",),
    "/surface-positions/spoilers-pos-norm": ("fcs/spoiler-pos-norm",),
    "/consumables/fuel/tank{n}/level-lbs": ("propulsion/tank{n}/contents-lbs",),
    "/consumables/fuel/tank{n}/level-gal_us": ("0.16666667 * propulsion/tank{n}/contents-lbs",),
    "/consumables/fuel/tank{n}/level-norm": ("0.01 * propulsion/tank{n}/pct-full",),
    "/consumables/fuel/tank{n}/density-ppg": ("propulsion/tank{n}/density-lbs_per_gal",),
    "/consumables/fuel/total-fuel-lbs": ("propulsion/total-fuel-lbs",),
    "/environment/density-slugft3": ("atmosphere/rho-slugs_ft3",),
    "/environment/pressure-inhg": (f"{_INHG_PSF} * atmosphere/P-psf",),
    "/environment/temperature-degc": ("0.55555556 * atmosphere/T-R - 273.15",),
    "/environment/wind-from-north-fps": ("-1 * atmosphere/wind-north-fps",),
    "/environment/wind-from-east-fps": ("-1 * atmosphere/wind-east-fps",),
    "/instrumentation/airspeed-indicator/indicated-speed-kt": ("velocities/vc-kts",),
    "/instrumentation/airspeed-indicator/indicated-mach": ("velocities/mach",),
    "/instrumentation/altimeter/indicated-altitude-ft": ("position/h-sl-ft",),
    "/instrumentation/attitude-indicator/indicated-pitch-deg": ("attitude/theta-deg",),
    "/instrumentation/attitude-indicator/indicated-roll-deg": ("attitude/phi-deg",),
    "/instrumentation/heading-indicator/indicated-heading-deg": ("attitude/psi-deg",),
    "/instrumentation/magnetic-compass/indicated-heading-deg": ("attitude/psi-deg",),
    "/sim/time/elapsed-sec": ("simulation/sim-time-sec",),
    "/sim/time/sim-time-sec": ("simulation/sim-time-sec",),
    "/sim/time/delta-sec": ("simulation/dt",),
    "/sim-time-sec": ("simulation/sim-time-sec",),
}
_INDEX = re.compile(r"\[(\d+)\]")

# Switches of the aircraft's own systems, by words of their names: the first row that fits decides.
# A word is a part between slashes, hyphens and underscores, without digits.
_WORDS: tuple[tuple[frozenset[str], float], ...] = (
    (frozenset({"magnetos", "magneto"}), 3.0),
    (frozenset({"serviceable", "available", "healthy"}), 1.0),
    (
        _words(
            "apu augmentation autobrake brake canopy chute contaminated contamination crash"
            " crashed cutoff cutout damage damaged dead disabled door doors drag drogue dump"
            " external fail failed failure failures fault faults feather fire flooded fouling"
            " freeze friction groundhandling hook ice icing inop jammed jato jettison kill"
            " killed leak leakage lock locked parking primer pushback reduction refuel refueling"
            " repairing reversed reverser roughness smoke starter stuck tailhook tiller tow"
            " towing use winch wingholder wow"
        ),
        0.0,
    ),
    (frozenset({"volts", "volt", "voltage"}), 28.0),
    (frozenset({"psi"}), 3000.0),
    (frozenset({"mixture", "condition"}), 1.0),
)
_HOOKS = _words("aerotow hitch hitches hook tow winch")
_SYSTEMS = _words(
    "electric electrical electrics electronics hydraulic hydraulics hyd fuel pneumatic avionics"
    " ignition power engines engine consumables switches"
)
_ON = _words(
    "alternator avail avionics bat batt battery boost breaker bus circuit condition enable enabled"
    " feed gen generator ignition main master on open operational output outputs power powered"
    " pressure pump pumps running selected selector serviceable supply switch system valve working"
)
# Similarity of parts of names from where one is a misspelling, in JSBSim's tree and outside.
_SAME_NAME_OF_JSBSIM, _SAME_NAME = 0.7, 0.85
# Sections of JSBSim's own tree: in the first ones scripts may add names, in the others an unknown
# name is an error.
_JSBSIM = _words("fcs gear simulation propulsion")
_PHYSICS = _words(
    "accelerations aero atmosphere attitude external_reactions flight-path forces ic inertia"
    " metrics moments position velocities"
)


@dataclass(frozen=True)
class HostProperty:
    """A property that a host provides.

    Attributes
    ----------
    name : str
        The property as the model writes it.
    source : str
        A number, or an expression of JSBSim properties.
    kind : str
        "control", "state", "system" (a switch that is on), "command" (an input of the model that
        nothing else sets), "unknown" (0, or the author's value), or "misspelt": rather an error
        than a host's property.
    place : str
        Where it is read, such as "u3.xml:21"; empty if unknown.
    similar : str
        The existing name that an author's misspelling may have meant; empty without one.
    """

    name: str
    source: str
    kind: str
    place: str = ""
    similar: str = ""

    @property
    def misspelt(self) -> bool:
        """Return whether the name looks like a misspelt property of JSBSim or of the model."""
        return self.kind == "misspelt"


@dataclass(frozen=True)
class Names:
    """Properties that the XML of a model names.

    Attributes
    ----------
    read : dict
        Property that is read to the place, "file:line", of its first reading.
    computed : set
        Properties that functions and components compute.
    declared : dict
        Properties that the XML declares to their values; None for a declaration without a value.
    stray : dict
        Values of declarations in places where JSBSim ignores them, such as a channel.
    compared : dict
        Property to the numbers with which conditions compare it for equality.
    """

    read: dict[str, str] = field(default_factory=dict)
    computed: set[str] = field(default_factory=set)
    declared: dict[str, float | None] = field(default_factory=dict)
    stray: dict[str, float] = field(default_factory=dict)
    compared: dict[str, list[float]] = field(default_factory=dict)


def canonical(name: str) -> str:
    """Return one spelling of a property: no index 0, and names of JSBSim's tree relative to it.

    Examples
    --------
    >>> canonical("/controls/engines/engine[0]/throttle"), canonical("/fdm/jsbsim/fcs/flap")
    ('/controls/engines/engine/throttle', 'fcs/flap')
    """
    return name.removeprefix("/fdm/jsbsim/").replace("[0]", "")


# Reading names from XML.

_NAME = re.compile(r"[-+]?(/?[A-Za-z_][\w.\-]*(\[(\d+|#)\])?(/[A-Za-z_][\w.\-]*(\[(\d+|#)\])?)*)")
_TEXT_TAGS = _words(
    "author copyright description documentation email filecreationdate fileheader license"
    " limitation note reference references version"
)
# Elements whose text is a property even without a slash.
_READING_TAGS = frozenset({"property", "p", "independentVar", "input"})
# Elements whose text is no property, although it may look like one.
_LITERAL_TAGS = frozenset(
    {"frame", "interpolation", "output", "axis", "tableData", "type", "table"}
)
_MODELS = _words(
    "system autopilot flight_control aerodynamics propulsion ground_reactions mass_balance metrics"
    " external_reactions buoyant_forces fdm_config planet engine thruster"
)
_VALUE_ATTRIBUTES = ("value", "execute", "execrate", "noise", "property")


def scan(files: Iterable[tuple[str, bytes]], engines: int = 1) -> Names:
    """Return the properties that XML files of a model read, compute and declare.

    Parameters
    ----------
    files : iterable of (str, bytes)
        Name and content of each file.
    engines : int
        Number of engines, for the names with # in the files of engines and propellers.
    """
    names = Names()
    for file, content in files:
        parser = etree.XMLParser(remove_comments=True, resolve_entities=False)
        root = etree.parse(BytesIO(content), parser).getroot()
        if root.tag not in ("initialize", "runscript"):
            _scan_element(root, file, names, engines)
    return names


def _scan_element(element: Any, file: str, names: Names, engines: int) -> None:
    """Add the names of an element and of all below it."""
    for child in element.iterchildren("*"):
        if child.tag in _TEXT_TAGS or (child.tag == "function" and _is_template(child)):
            continue
        text = (child.text or "").strip()
        place = f"{file}:{child.sourceline or 0}"
        if child.tag == "property" and (element.tag in _MODELS or "value" in child.attrib):
            _add_declaration(child, element, text, names)
        elif child.tag == "output" and element.tag != "fdm_config":
            names.computed.update(_expanded(text, engines))
        elif child.tag in ("test", "condition") or (child.tag == "execute" and text):
            for line in text.splitlines():
                words = line.split()
                _add_reads([words[0], *words[2:]] if words else [], place, names, engines)
                if len(words) == 3 and words[1] in _EQUALS and _NUMBER.fullmatch(words[2]):
                    names.compared.setdefault(canonical(words[0]), []).append(float(words[2]))
        elif child.tag in _READING_TAGS or (child.tag not in _LITERAL_TAGS and "/" in text):
            _add_reads([text], place, names, engines)
        if name := (child.get("name") or "").strip():
            if child.tag == "function":
                names.computed.update(_expanded(re.sub(r"\s", "-", name), engines))
            elif element.tag == "channel":
                names.computed.add(component_output(name))
        for key in _VALUE_ATTRIBUTES:
            value = child.get(key, "").strip()
            if "/" in value and child.tag != "property":
                _add_reads([value], place, names, engines)
        _scan_element(child, file, names, engines)


def component_output(name: str) -> str:
    """Return the property of a component, which JSBSim derives from a name without a path."""
    return canonical(
        name if "/" in name else f"fcs/{re.sub(r'[^a-z0-9._-]', '-', name.strip().lower())}"
    )


def _is_template(function: Any) -> bool:
    """Return whether a function's properties are its arguments."""
    return str(function.get("type") or "") == "template"


def _add_declaration(node: Any, parent: Any, text: str, names: Names) -> None:
    """Add a ``<property>`` that declares a name."""
    try:
        value = float(node.get("value", "nan"))
    except ValueError:
        value = 0.0
    name = canonical(text)
    if parent.tag in _MODELS:
        names.declared.setdefault(name, None if "value" not in node.attrib else value)
    else:
        names.stray.setdefault(name, value)


def _add_reads(texts: Iterable[str], place: str, names: Names, engines: int) -> None:
    """Add texts that are names of properties."""
    for text in texts:
        match = _NAME.fullmatch(text)
        # Conditions also have numbers and operators.
        if match and match.group(1) not in _OPERATORS:
            for name in _expanded(match.group(1), engines):
                names.read.setdefault(name, place)


_EQUALS = _words("== EQ eq != NE ne")
_OPERATORS = _words("AND OR EQ NE GT GE LT LE and or eq ne gt ge lt le")


def _expanded(text: str, engines: int) -> Iterator[str]:
    """Yield a name, or one for each engine if it has # for its number."""
    numbers = range(engines) if "#" in text else range(1)
    return (canonical(text.replace("#", str(number))) for number in numbers if text)


# Sources.

_TERM = re.compile(
    r"(?:(?P<factor>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*\*\s*)?"
    r"(?P<property>/?[A-Za-z_][\w.\-]*(?:\[\d+\])?(?:/[A-Za-z_][\w.\-]*(?:\[\d+\])?)*)"
)
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


@dataclass(frozen=True)
class Expression:
    """A constant plus factors times properties."""

    constant: float
    terms: tuple[tuple[float, str], ...] = ()


def parse_source(text: str) -> Expression:
    """Return the expression of a source: terms ``[number *] property`` or numbers, with + and -.

    Operators need blanks on both sides, because names contain hyphens. Raises ValueError.

    Examples
    --------
    >>> parse_source("1.8 * propulsion/engine/itt-c + 32")
    Expression(constant=32.0, terms=((1.8, 'propulsion/engine/itt-c'),))
    """
    constant, terms = 0.0, []
    parts = re.split(r"\s+([+-])\s+", text.strip())
    for sign, part in zip(["+", *parts[1::2]], parts[::2], strict=True):
        factor = -1.0 if sign == "-" else 1.0
        if _NUMBER.fullmatch(part):
            constant += factor * float(part)
        elif match := _TERM.fullmatch(part):
            terms.append((factor * float(match["factor"] or 1.0), match["property"]))
        else:
            raise ValueError(
                f"'{part}' is neither a number nor [number *] property; write for example"
                " 0.5 * fcs/flap-cmd-norm + 0.1"
            )
    return Expression(constant, tuple(terms))


def resolve(
    names: Names, missing: Mapping[str, str], exists: Callable[[str], bool]
) -> tuple[HostProperty, ...]:
    """Return what a host provides to a model.

    Parameters
    ----------
    names : Names
        What its XML names.
    missing : mapping
        Properties that are read and that nothing defines, to the similar name of an existing one
        (empty without one).
    exists : callable
        Whether JSBSim or the model has a property.

    Returns
    -------
    tuple of HostProperty
        In the order of reading. Controls and states of FlightGear that the model declares itself
        and never computes are among them: FlightGear would overwrite them.
    """
    unset = {canonical(name): similar for name, similar in missing.items()}
    gang = len(_commanded_throttles(names)) > 1
    rows: dict[str, HostProperty] = {}
    for name in dict.fromkeys([*names.read, *unset]):
        if name in names.computed:
            continue
        absolute = name if name.startswith("/") else f"/{name}"
        # A property of JSBSim's own tree that exists is not FlightGear's.
        if not name.startswith("/") and name not in unset:
            continue
        place = names.read.get(name, "")
        row = (
            _control(name, absolute, place, names, exists, gang)
            or _state(name, absolute, place, exists)
            or (
                _switch(name, absolute, place, names, unset.get(name, ""))
                if name in unset or names.declared.get(name, 0.0) is None
                else None
            )
        )
        # Gliders read switches of engines that they lack: a parachute on the magnetos, for example.
        if row is not None and row.kind == "system" and _lacks_engine(absolute, exists):
            row = replace(row, source="0", kind="unknown")
        # A constant that the model declares itself stays the author's.
        is_constant = name not in unset and names.declared.get(name) is not None
        if row is not None and not (is_constant and not parse_source(row.source).terms):
            rows[name] = row
        # A brake or fault of FlightGear's tree that is set for the start is released in flight, and
        # a switch that is off until the pilot starts the engines is on.
        elif name.startswith("/") and is_constant:
            value = 0.0 if _lacks_engine(absolute, exists) else _on_value(absolute, names)
            if names.declared[name] and is_off(name):
                rows[name] = HostProperty(name, "0", "unknown", place)
            elif not names.declared[name] and value:
                rows[name] = HostProperty(name, f"{value:g}", "system", place)
    if any(row.source == THROTTLE for row in rows.values()):
        rows[THROTTLE] = HostProperty(THROTTLE, "0", "command")
    return tuple(rows.values())


def commands(names: Names) -> dict[str, str]:
    """Return control to the property that commands it, where this is not JSBSim's.

    A model that computes fcs/elevator-cmd-norm from FlightGear's control is commanded by that.
    """
    result = {
        control: name
        for control, name in _SURFACES.items()
        if _is_read(names, name) and f"fcs/{control}-cmd-norm" in names.computed
    }
    throttles = _commanded_throttles(names)
    if throttles:
        result["throttle"] = THROTTLE if len(throttles) > 1 else throttles[0]
    return result


def _is_read(names: Names, name: str) -> bool:
    """Return whether a property is an input of the model."""
    return name in names.read and name not in names.computed


def _commanded_throttles(names: Names) -> list[str]:
    """Return FlightGear's throttles from which the model computes JSBSim's commands."""
    throttles = [
        name for name in names.read if _THROTTLES.fullmatch(name) and name not in names.computed
    ]
    computed = any(name.startswith("fcs/throttle-cmd-norm") for name in names.computed)
    return throttles if computed else []


def _with_index(table: Mapping[str, Any], name: str) -> tuple[Any, str]:
    """Return the entry of a table for a name, and the name's index as text; None without one."""
    if name in table:
        return table[name], ""
    match = _INDEX.search(name)
    index = match.group(0) if match else ""
    # Engine 0 has no index in the canonical spelling.
    for part in ("engine", "gear", "tank"):
        pattern = re.sub(rf"/{part}(\[\d+\])?/(?!.*/{part}/)", f"/{part}{{n}}/", name, count=1)
        if part == "gear":
            pattern = re.sub(r"^/gear/gear(\[\d+\])?/", "/gear/gear{n}/", name)
        if pattern in table:
            return table[pattern], index
    return None, index


_OF_ENGINE = re.compile(r"/engine(\[\d+\])?/")


def _lacks_engine(name: str, exists: Callable[[str], bool]) -> bool:
    """Return whether a property belongs to an engine that the aircraft does not have."""
    match = _OF_ENGINE.search(name)
    return match is not None and not exists(f"propulsion/engine{match[1] or ''}/set-running")


def _exist(source: str, exists: Callable[[str], bool]) -> bool:
    """Return whether all properties of a source exist."""
    return all(exists(name) for _, name in parse_source(source).terms)


def _control(
    name: str,
    absolute: str,
    place: str,
    names: Names,
    exists: Callable[[str], bool],
    gang: bool,
) -> HostProperty | None:
    """Return the source of a pilot's control; None for another property."""
    if match := _THROTTLES.fullmatch(absolute):
        index = match.group(1) or ""
        entry = _CONTROLS["/controls/engines/engine{n}/throttle"]
    else:
        entry, index = _with_index(_CONTROLS, absolute)
    if entry is None:
        return None
    source, initial = entry[0].replace("{n}", index), entry[1]
    if _THROTTLES.fullmatch(absolute) and any(
        computed.startswith("fcs/throttle-cmd-norm") for computed in names.computed
    ):
        return HostProperty(name, THROTTLE if gang else "0", "command", place)
    # A copy of a command that the model computes from this control would be a loop.
    if any(canonical(read) in names.computed for _, read in parse_source(source).terms):
        if absolute.endswith("/mixture"):
            return HostProperty(name, _LEANED, "control", place)
        return HostProperty(name, f"{initial:g}", "command", place)
    if not _exist(source, exists):
        return HostProperty(name, f"{initial:g}", "system" if initial else "unknown", place)
    return HostProperty(name, source, "control", place)


def _state(
    name: str, absolute: str, place: str, exists: Callable[[str], bool]
) -> HostProperty | None:
    """Return the source of a state; None for another property, or one that JSBSim cannot give."""
    entry, index = _with_index(_STATES, absolute)
    sources = [source.replace("{n}", index) for source in entry or ()]
    source = next((source for source in sources if _exist(source, exists)), None)
    return None if source is None else HostProperty(name, source, "state", place)


def _switch(name: str, absolute: str, place: str, names: Names, similar: str) -> HostProperty:
    """Return the value of a property that only the aircraft's scripts would set."""
    if name in names.stray:
        return HostProperty(name, f"{names.stray[name]:g}", "unknown", place)
    if _is_misspelt(name, similar):
        return HostProperty(name, "0", "misspelt", place, similar)
    value = _on_value(absolute, names)
    return HostProperty(name, f"{value:g}", "system" if value else "unknown", place)


def _on_value(absolute: str, names: Names) -> float:
    """Return the value of a switch in flight; if it is on, the one that the model's conditions ask
    for.
    """
    value = switch_value(absolute)
    positions = [each for each in names.compared.get(absolute, ()) if each > 0.0]
    return max(positions) if value and positions and value not in positions else value


def _is_misspelt(name: str, similar: str) -> bool:
    """Return whether a name without definition is rather a misspelling of a similar one."""
    # Names that differ in digits alone are another engine's or tank's.
    if name.startswith("/") or re.sub(r"\d", "", similar) == re.sub(r"\d", "", name):
        return False
    # Scripts do not add properties to JSBSim's physics.
    if name.partition("/")[0] in _PHYSICS:
        return True
    sections = {name.partition("/")[0], similar.partition("/")[0]}
    # Compare only the parts that differ: a long common path makes all names of a system alike.
    words = [
        part
        for part in zip(name.split("/"), similar.split("/"), strict=False)
        if part[0] != part[1]
    ]
    limit = _SAME_NAME_OF_JSBSIM if sections & (_JSBSIM | _PHYSICS) else _SAME_NAME
    # Scripts add names that extend another one by a word, such as engine/cutoff-commanded.
    return name.count("/") == similar.count("/") and all(
        difflib.SequenceMatcher(None, *pair).ratio() >= limit for pair in words
    )


def misspelt_physics(names: Names, existing: Collection[str]) -> tuple[HostProperty, ...]:
    """Return misspelt names of JSBSim's physics in a model that JSBSim does not load.

    Parameters
    ----------
    names : Names
        What its XML names.
    existing : collection of str
        Properties that JSBSim has whatever the model is.
    """
    defined = {*existing, *names.computed, *names.declared}
    rows = []
    for name, place in names.read.items():
        if name.partition("/")[0] in _PHYSICS and name not in defined:
            matches = difflib.get_close_matches(name, existing, n=1, cutoff=0.8)
            if matches and _is_misspelt(name, matches[0]):
                rows.append(HostProperty(name, "0", "misspelt", place, matches[0]))
    return tuple(rows)


def switch_value(name: str) -> float:
    """Return the value at which a system of an aircraft in flight stands; 0 for other properties.

    Examples
    --------
    >>> switch_value("/systems/electrical/outputs/battery-switch")
    1.0
    >>> switch_value("/sim/model/pushback/enabled")
    0.0
    """
    words = [re.sub(r"[\d\]\[]", "", word) for word in re.split(r"[/_\-.]", name.lower())]
    present = {word for word in words if word}
    leaf = {re.sub(r"[\d\]\[]", "", w) for w in re.split(r"[_\-.]", name.lower().split("/")[-1])}
    # An open hook has released the tow.
    if present & _HOOKS and leaf & {"open", "released"}:
        return 1.0
    for group, value in _WORDS:
        if present & group:
            return value
    # A valve is named after its tank.
    is_valve = "tank" in leaf and bool(present & {"valve", "valves"})
    if present & _SYSTEMS and (leaf & _ON or is_valve):
        return 1.0
    # A consumer among the outputs of the electrics has its voltage; a factor leaves a product.
    if present & {"electric", "electrical"} and "outputs" in present:
        return 28.0
    return 1.0 if leaf & {"factor", "multiplier"} else 0.0


def is_off(name: str) -> bool:
    """Return whether a property belongs to what is off, closed or whole in flight."""
    words = {re.sub(r"[\d\]\[]", "", word) for word in re.split(r"[/_\-.]", name.lower())}
    return any(value == 0.0 and words & group for group, value in _WORDS)


@dataclass(frozen=True)
class SetFile:
    """What FlightGear reads of an aircraft's ``-set.xml`` and of the files that it includes.

    Attributes
    ----------
    aero : str
        Name of the flight model, without ``.xml``; empty without one.
    flight_model : str
        Program of the flight model, such as "jsb"; empty without one.
    values : dict
        Property to its initial number.
    """

    aero: str = ""
    flight_model: str = ""
    values: Mapping[str, float] = field(default_factory=dict)


def read_set_file(name: str, read: Callable[[str], bytes | None]) -> SetFile:
    """Return the content of a ``-set.xml``; empty for XML that is none.

    Parameters
    ----------
    name : str
        Path in the aircraft's folder.
    read : callable
        Returns the content of a file of the aircraft's folder; None without that file, such as one
        of FlightGear's own.
    """
    texts: dict[str, str] = {}
    aliases: dict[str, str] = {}
    _read_list(name, "", read, texts, aliases, depth=0)
    for key, target in aliases.items():
        if target in texts:
            texts[key] = texts[target]
    values = {}
    for key, text in texts.items():
        if text.lower() in ("true", "false"):
            values[key] = float(text.lower() == "true")
        elif _NUMBER.fullmatch(text):
            values[key] = float(text)
    aero = texts.get("/sim/aero", "").removesuffix(".xml")
    return SetFile(aero, texts.get("/sim/flight-model", ""), values)


_MAX_INCLUDES = 20


def _read_list(
    name: str,
    path: str,
    read: Callable[[str], bytes | None],
    texts: dict[str, str],
    aliases: dict[str, str],
    depth: int,
) -> None:
    """Add the properties of a file below ``path``; what is inside an element replaces includes."""
    content = read(name) if depth < _MAX_INCLUDES else None
    if content is None:
        return
    parser = etree.XMLParser(remove_comments=True, resolve_entities=False)
    try:
        root = etree.parse(BytesIO(content), parser).getroot()
    except etree.XMLSyntaxError:
        return
    if root.tag != "PropertyList":
        return

    def walk(element: Any, path: str) -> None:
        if include := (element.get("include") or "").strip():
            for place in _included_places(include, name):
                if read(place) is not None:
                    _read_list(place, path, read, texts, aliases, depth + 1)
                    break
        numbers: dict[str, int] = {}
        for child in element.iterchildren("*"):
            number = child.get("n")
            index = int(number) if (number or "").isdigit() else numbers.get(child.tag, 0)
            numbers[child.tag] = index + 1
            key = canonical(f"{path}/{child.tag}" + (f"[{index}]" if index else ""))
            if alias := child.get("alias"):
                aliases[key] = canonical(alias)
            if not len(child) and (text := (child.text or "").strip()):
                texts[key] = text
                aliases.pop(key, None)
            walk(child, key if key.startswith("/") else f"/fdm/jsbsim/{key}")

    walk(root, path)


def _included_places(include: str, name: str) -> Iterator[str]:
    """Yield where a file may lie that another one includes: beside it, or in Aircraft/NAME."""
    yield (PurePosixPath(name).parent / include).as_posix()
    yield include
    parts = PurePosixPath(include).parts
    if len(parts) > 2 and parts[0] == "Aircraft":
        yield PurePosixPath(*parts[2:]).as_posix()


def with_initial_values(
    properties: Iterable[HostProperty], values: Mapping[str, float]
) -> tuple[HostProperty, ...]:
    """Return the properties with an author's initial values where nothing else is known."""
    rows = []
    for row in properties:
        name = row.name if row.name in values else f"/{row.name}"
        value = values.get(name, 0.0)
        # A selector that is on has one of several positions.
        if row.kind == "system" and value:
            row = replace(row, source=f"{value:.12g}")
        takes = row.kind in ("unknown", "misspelt") and row.source == "0"
        if takes and name in values and not is_off(name):
            row = replace(row, source=f"{value:.12g}", kind="unknown", similar="")
        rows.append(row)
    return tuple(rows)


# Writing the system.


def with_host_entries(
    properties: Iterable[HostProperty], card: Mapping[str, float | str]
) -> tuple[HostProperty, ...]:
    """Return the properties with the sources of a card's [host], which may add some."""
    rows = {canonical(row.name): row for row in properties}
    for name, source in card.items():
        key = canonical(name)
        text = source if isinstance(source, str) else f"{source:.12g}"
        old = rows.get(key, HostProperty(name, text, "unknown"))
        kind = "unknown" if old.misspelt else old.kind
        rows[key] = HostProperty(old.name, text, kind, old.place)
    return tuple(rows.values())


def describe(properties: Collection[HostProperty]) -> str:
    """Return a sentence that counts what the host provides and names what is merely 0."""
    parts = []
    for kind, (one, many) in _KIND_WORDS.items():
        number = sum(row.kind == kind for row in properties if row.name != THROTTLE)
        if number:
            parts.append(f"{number} {one if number == 1 else many}")
    other = [row.name for row in properties if row.kind == "unknown"]
    if other:
        examples = ", ".join(other[:3]) + (", ..." if len(other) > 3 else "")
        parts.append(f"{len(other)} more at a fixed value ({examples})")
    return f"reads properties of its host (FlightGear), which are provided: {', '.join(parts)}"


_KIND_WORDS = {
    "control": ("copied command", "copied commands"),
    "command": ("input", "inputs"),
    "state": ("state", "states"),
    "system": ("system on", "systems on"),
}


def host_system_xml(properties: Iterable[HostProperty], name: str = HOST_SYSTEM) -> bytes:
    """Return the system that declares the constants and computes the other properties."""
    rows = [(row, parse_source(row.source)) for row in properties]
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        "<!-- What the aircraft reads of its host (FlightGear), so that it flies in JSBSim alone:",
        "     [host] of airframe.toml. Speeds and engines are those of the frame before.",
        f"     In FlightGear set {SWITCH} to 0. -->",
        f'<system name="{name}">',
        f'  <property value="1">{SWITCH}</property>',
    ]
    for row, expression in rows:
        if not expression.terms:
            lines.append(
                f'  <property value="{expression.constant:.12g}">{escape(row.name)}</property>'
            )
    copies = [(row, expression) for row, expression in rows if expression.terms]
    if copies:
        lines.append(f'  <channel name="{name}" execute="{SWITCH}">')
        for index, (row, expression) in enumerate(copies):
            lines += _component(index, row.name, expression)
        lines.append("  </channel>")
    return "\n".join([*lines, "</system>", ""]).encode()


def _component(index: int, name: str, expression: Expression) -> list[str]:
    """Return the lines of the component that computes a property."""
    if len(expression.terms) == 1 and not expression.constant:
        ((factor, source),) = expression.terms
        return [
            f'    <pure_gain name="host/copy-{index}">',
            f"      <input>{escape(source)}</input>",
            f"      <gain>{factor:.12g}</gain>",
            f"      <output>{escape(name)}</output>",
            "    </pure_gain>",
        ]
    terms = [
        f"<product> <value>{factor:.12g}</value> <property>{escape(source)}</property> </product>"
        for factor, source in expression.terms
    ]
    return [
        f'    <fcs_function name="host/copy-{index}">',
        "      <function>",
        "        <sum>",
        *(f"          {term}" for term in terms),
        f"          <value>{expression.constant:.12g}</value>",
        "        </sum>",
        "      </function>",
        f"      <output>{escape(name)}</output>",
        "    </fcs_function>",
    ]


def insert_system(content: bytes, system: bytes, where: str) -> bytes:
    """Return an aircraft's XML with a system before all others; lines keep their numbers."""
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise BadInputError(f"{where}:1: is in UTF-16; save the file as UTF-8")
    at = _place(content)
    body = re.sub(rb"<\?.*?\?>|<!--.*?-->", b"", system, flags=re.DOTALL)
    return content[:at] + b" ".join(line.strip() for line in body.split(b"\n")) + content[at:]


def _place(content: bytes) -> int:
    """Return the byte before the first section that may read a host's properties."""
    parser = expat.ParserCreate()
    depth, places, ends = 0, dict[str, int](), [len(content)]

    def opened(tag: str, _: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth == 2:
            places.setdefault(tag, parser.CurrentByteIndex)

    def closed(_: str) -> None:
        nonlocal depth
        depth -= 1
        if depth == 0:
            ends[0] = parser.CurrentByteIndex

    parser.StartElementHandler, parser.EndElementHandler = opened, closed
    parser.Parse(content, True)
    # JSBSim loads systems in the order of the text, before autopilot and flight control.
    sections = ("system", "autopilot", "flight_control", "aerodynamics")
    return next((places[tag] for tag in sections if tag in places), ends[0])
