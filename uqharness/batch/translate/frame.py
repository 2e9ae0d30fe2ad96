"""A frame while it is traced: what stands in each property at this place of the frame, and the
sections that come of it.

Properties are slots of the state. A property that nothing ever writes is a constant, folded where
it is read, unless it is one of the ``inputs`` that differ from lane to lane. ``writers`` must be
known before the first section is traced, because a property may be read before it is written: it
then has the value of the frame before."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NoReturn

from uqharness.batch.form.ir import Builder, Value
from uqharness.batch.form.maths import reuse_sines
from uqharness.batch.form.program import Program, Section, Stream, When
from uqharness.errors import BadInputError
from uqharness.xml import Document, Node

# What the translation of XML to the intermediate form shares: the builder, the document, how a
# property is read, and refusals.

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_NAME = re.compile(r"/?[A-Za-z_][A-Za-z0-9_.\-]*(\[\d+\])?(/[A-Za-z_][A-Za-z0-9_.\-]*(\[\d+\])?)*")
_ROOT = "/fdm/jsbsim/"


@dataclass(frozen=True)
class Scope:
    """Where XML is read.

    builder   makes the values
    document  the file, for messages
    read      the value of a property, None if nobody computes it: then the file is refused
    draw      the standard normal (``random``) or the number of -1 to 1 (``urandom``) that an
    element draws in this frame;
              None: refused
    note_beyond  is handed a condition under which JSBSim computes what the engine cannot: the
    flight does not count then"""

    builder: Builder
    document: Document
    read: Callable[[str], Value | None]
    draw: Callable[[Node], Value | None] = lambda _: None
    note_beyond: Callable[[Value], None] = lambda _: None

    def where(self, condition: Value) -> Scope:
        """The same for what JSBSim computes only where the condition holds: elsewhere nothing is
        noted.
        """

        def note(beyond: Value) -> None:
            self.note_beyond(self.builder.op("and", condition, beyond))

        return replace(self, note_beyond=note)

    def refuse(self, node: Node, why: str) -> NoReturn:
        """Raise BadInputError with file and line."""
        raise BadInputError(f"{self.document.where(node)}: {why}")

    def only(self, node: Node, attributes: Collection[str] = ()) -> None:
        """Refuse attributes that are not understood."""
        for name in node.attributes:
            if name not in attributes:
                self.refuse(
                    node,
                    f"attribute '{name}' of <{node.tag}> is not understood by the batch engine; fly"
                    ' it with engine = "jsbsim"',
                )

    def number(self, node: Node, text: str | None = None) -> float:
        """A number as JSBSim writes it: decimal, without blanks inside."""
        text = (node.text if text is None else text).strip()
        if not _NUMBER.fullmatch(text) or not math.isfinite(float(text)):
            self.refuse(node, f"<{node.tag}> must be a finite decimal number; received {text!r}")
        return float(text)

    def property_value(self, node: Node) -> Value:
        """The value of the property that the element's text names; a minus sign before the name
        negates it.
        """
        if node.children:
            self.refuse(
                node,
                f"<{node.tag}> must be the name of a property; received <{node.children[0].tag}>,"
                " which JSBSim ignores",
            )
        return self.named_property(node, node.text)

    def named_property(self, node: Node, text: str) -> Value:
        """The value of the property that a text of the element names; a minus sign before the name
        negates it.
        """
        text = text.strip()
        negative = text.startswith("-")
        name = property_of(self, node, text.removeprefix("-"))
        value = self.read(name)
        if value is None:
            self.refuse(
                node,
                f"property {name} is not computed by the batch engine; fly this aircraft with"
                ' engine = "jsbsim"',
            )
        return -value if negative else value

    def parameter(self, node: Node, text: str | None = None) -> Value:
        """A number, or the value of a property with or without a minus sign."""
        text = (node.text if text is None else text).strip()
        return (
            self.builder.constant(self.number(node, text))
            if is_number(text)
            else self.named_property(node, text)
        )

    @property
    def undefined(self) -> Value:
        """NaN: what JSBSim ends the flight for."""
        return self.builder.constant(math.nan)


def canonical(name: str) -> str:
    """One spelling of a property's name: no root, no index 0."""
    return name.strip().removeprefix(_ROOT).replace("[0]", "")


def property_of(scope: Scope, node: Node, text: str) -> str:
    """The property that a text names; refused if it is no name."""
    name = canonical(text)
    if not _NAME.fullmatch(name):
        scope.refuse(
            node, f"<{node.tag}> must be the name of a property; received {text.strip()!r}"
        )
    return name


def is_number(text: str) -> bool:
    """Whether JSBSim takes the text for a number; otherwise it is the name of a property."""
    return bool(_NUMBER.fullmatch(text.strip()))


TIME = "simulation/sim-time-sec"
STEP = "#step"
"""Slot of the step [s] where it is a number of the lane."""
MOST_SECTIONS, MOST_OPERATIONS, MOST_SLOTS = 2_000, 60_000, 2_500
"""Of a frame: E-SPAARO has 40, 3,800 and 520. At the limits compiling takes some ten seconds."""
BEYOND = "#beyond"
"""Slot that is not 0 once a function had an argument beyond the engine's range: what the lane flies
from there is not JSBSim's.
"""
INITIALISED = "initialised:"
"""Before a property's name: its value behind JSBSim's initialising frames."""


class Values(dict[str, float]):
    """Values of properties before the first frame, by their canonical names, each asked for once.

    value_of   the value, None: there is no such property constant   whether a property that nobody
    writes keeps its value: others change in JSBSim, which nobody computes here"""

    def __init__(
        self,
        value_of: Callable[[str], float | None],
        constant: Callable[[str], bool] = lambda _: True,
    ) -> None:
        super().__init__()
        self._value_of = value_of
        self.constant = constant
        self._absent: set[str] = set()

    def __contains__(self, name: object) -> bool:
        return self._found(str(name)) is not None

    def __missing__(self, name: str) -> float:
        found = self._found(name)
        if found is None:
            raise KeyError(name)
        return found

    def get(  # type: ignore[override]
        self, name: str, default: float | None = None
    ) -> float | None:
        """The value; ``default`` where there is no such property."""
        found = self._found(name)
        return default if found is None else found

    def setdefault(self, name: str, default: float = 0.0) -> float:
        """The value; where there is none, ``default`` from now on."""
        found = self._found(name)
        if found is None:
            self[name] = found = default
        return found

    def _found(self, name: str) -> float | None:
        if dict.__contains__(self, name):
            return dict.__getitem__(self, name)
        if name in self._absent:
            return None
        value = None if name.startswith("#") else self._value_of(name)
        if value is None:
            self._absent.add(name)
            return None
        self[name] = value
        return value


class Frame:
    """Traces one frame.

    dt_s       step of the frame, 0 while JSBSim initialises
    values     property to its value before the first frame: declared ones, and those of JSBSim's
    own models
    written    properties that are written in some frame: they are state; None: not known yet, every
    property is taken for one,
               and ``writes`` has them when all is traced
    inputs     properties whose value may differ between lanes and is never written

    ``live`` has properties that are computed wherever they are read, as JSBSim does with a function
    that has not been run yet; ``hooks`` those whose setting moves more than themselves."""

    def __init__(
        self,
        dt_s: float,
        values: Mapping[str, float],
        written: Collection[str] | None,
        inputs: Collection[str] = (),
        any_step: bool = False,
    ) -> None:
        self.dt_s, self.any_step = dt_s, any_step
        self.values = (
            values
            if isinstance(values, Values)
            else {canonical(n): float(v) for n, v in values.items()}
        )
        self.written = None if written is None else frozenset(canonical(name) for name in written)
        self.writes: set[str] = set()
        self.inputs = frozenset(canonical(name) for name in inputs)
        self.builder = Builder()
        self.sections: list[Section] = []
        self.streams: list[Stream] = []
        self.draws: list[tuple[str, int]] = []
        self.live: dict[str, Callable[[], Value]] = {}
        self.hooks: dict[str, Callable[[Frame, Value], None]] = {}
        self._when: When | None = None
        self._name = ""
        self._operations = 0
        self._slots: set[str] = set()

    @property
    def step(self) -> Value:
        """The step of the frame [s]."""
        return self.builder.constant(self.dt_s) if self.initialising else self.load_step

    @property
    def load_step(self) -> Value:
        """The step at which the aircraft was loaded [s], from which its filters' coefficients are
        made.
        """
        return (
            self.memory(STEP[1:], self.dt_s) if self.any_step else self.builder.constant(self.dt_s)
        )

    @property
    def initialising(self) -> bool:
        """Whether time stands still: JSBSim runs two such frames before a flight."""
        return self.dt_s == 0.0

    @contextmanager
    def section(self, name: str, when: When | None = None) -> Iterator[None]:
        """What is traced inside becomes one section.

        Sections do not nest; values of one are not for use in another.
        """
        if self._when is not None:
            raise RuntimeError(f"section {name} inside section {self._name}")
        self._when, self._name = when or When(), name
        self.builder = Builder()
        yield
        self.sections.append(Section(name, self.builder.finish({}), self._when))
        self._when = None
        self._refuse_too_large()

    def _refuse_too_large(self) -> None:
        """Refuse a frame that would keep the compiler busy for minutes, as soon as it is one."""
        function = self.sections[-1].function
        self._operations += len(function.nodes)
        self._slots.update(function.slots)
        for count, most, words in (
            (len(self.sections), MOST_SECTIONS, "components and functions"),
            (self._operations, MOST_OPERATIONS, "operations a frame"),
            (len(self._slots), MOST_SLOTS, "numbers of state (each frame of a delay is one)"),
        ):
            if count > most:
                raise BadInputError(
                    f"too large for the batch engine: more than {most} {words}; "
                    'fly this aircraft with engine = "jsbsim"'
                )

    def read(self, name: str) -> Value | None:
        """What the property stands at here; None if nothing makes it."""
        name = canonical(name)
        if name in self.live:
            return self.live[name]()
        if self.written is None:
            return self.builder.load(name)
        if name in self.written or name in self.inputs:
            self.values.setdefault(name, 0.0)
            return self.builder.load(name)
        if isinstance(self.values, Values) and not self.values.constant(name):
            return None
        value = self.values.get(name)
        return None if value is None else self.builder.constant(value)

    def get(self, name: str) -> Value:
        """The same of a property that the engine itself makes. KeyError if it does not."""
        value = self.read(name)
        if value is None:
            raise KeyError(name)
        return value

    def write(self, name: str, value: Value | float) -> None:
        """Put a value into a property, from here on, as the XML does: what JSBSim does besides is
        done by its hook.
        """
        name = canonical(name)
        hook = self.hooks.get(name)
        if hook is None:
            self.store(name, value)
        else:
            hook(self, self.builder.value(value))

    def store(self, name: str, value: Value | float) -> None:
        """The same without the hook."""
        name = canonical(name)
        self.writes.add(name)
        if self.written is not None and name not in self.written:
            raise KeyError(f"{name} is written here, which was not foreseen")
        self.values.setdefault(name, 0.0)
        self.builder.store(name, value)

    def memory(self, name: str, first: float = 0.0) -> Value:
        """A slot that is no property: what ``remember`` put there, in the frame before ``first``.

        Its name begins with '#'.
        """
        self.values.setdefault(f"#{name}", first)
        return self.builder.load(f"#{name}")

    def remember(self, name: str, value: Value | float, first: float = 0.0) -> None:
        """Put a value into such a slot."""
        self.values.setdefault(f"#{name}", first)
        self.builder.store(f"#{name}", value)

    def scope(self, document: Document) -> Scope:
        """For translating elements of ``document`` inside the present section."""
        return Scope(self.builder, document, self.read, self._draw_for(document), self._note_beyond)

    def _note_beyond(self, condition: Value) -> None:
        if condition.constant is not None and not condition.constant:
            return
        self.remember(BEYOND[1:], condition.choose(1.0, self.memory(BEYOND[1:])))

    def normal(self) -> Value | None:
        """A standard normal that is drawn here; None in a section in which lanes draw at different
        times.
        """
        assert self._when is not None
        if self.written is not None and (self._when.mask is not None or self._when.at is not None):
            return None
        name = f"#draw/{len(self.draws)}"
        self.draws.append((name, self._when.every))
        self.values[name] = 0.0
        return self.builder.load(name)

    def _draw_for(self, document: Document) -> Callable[[Node], Value | None]:
        def draw(node: Node) -> Value | None:
            return None if node.tag != "random" or "seed" in node.attributes else self.normal()

        return draw

    def program(self, records: Collection[str], streams: Collection[Stream] = ()) -> Program:
        """All sections as a program."""
        slots: dict[str, float] = {}
        for section in self.sections:
            for name in section.function.slots:
                slots.setdefault(name, self.values[name])
        for stream in streams:
            for name in stream.columns:
                slots.setdefault(name, 0.0)
        for name in records:
            slots.setdefault(canonical(name), self.values[canonical(name)])
        return reuse_sines(
            Program(
                tuple(self.sections),
                slots,
                tuple(streams),
                tuple(canonical(name) for name in records),
            )
        )


# JSBSim's own properties: which there are, which keep their value, which XML and hosts may
# write, which must stand as they are.
#
# Found by experiment with JSBSim 1.3.3. A property that is none of its own is made by the XML
# that declares it.

_LEVERS = (
    r"fcs/.*-(cmd|pos)-(norm|rad|deg)(\[\d+\])?|fcs/.*-brake-cmd-norm|gear/gear-(cmd|pos)-norm"
)
_AIR = (
    r"atmosphere/((gust|wind)-(north|east|down)-fps|wind-mag-fps|psiw-rad|turb-type|delta-T"
    r"|P-sl-psf"
    r"|turbulence/milspec/(severity|windspeed_at_20ft_AGL-fps))"
)
_ENGINE_SET = (
    r"propulsion/engine(\[\d+\])?/([xyz]-position|(pitch|yaw|reverser)-angle-rad|blade-angle"
    r"|constant-speed-mode|propeller-sense"
    r"|friction-hp|bsfc-lbs_hphr|volumetric-efficiency|air-intake-impedance-factor"
    r"|ram-air-factor|cooling-factor|starter-norm"
    r"|bleed-factor)"
)
_ENGINE_MADE = (
    r"propulsion/engine(\[\d+\])?/(set-running|thrust-lbs|fuel-flow-rate-(pps|gph)"
    r"|fuel-used-lbs|(engine|propeller)-rpm"
    r"|advance-ratio|thrust-coefficient|helical-tip-Mach|prop-induced-velocity_fps"
    r"|propeller-(power-ftlbps|torque-ftlb)"
    r"|[xyz]-reference-position|power-hp|current-amperes|map-(pa|inhg)|boost-speed"
    r"|boostloss-(factor|hp)|(cht|egt)-degF|AFR"
    r"|oil-(temperature-degF|pressure-psi)|n[12]|MaxN[12]|injection_cmd|seized|stalled"
    r"|Inj(ectionTimer|WaterNorm|N[12]increment)"
    r"|a?tsfc|itt-c|engtrq-ftlb|ielu_intervent|combustion_efficiency|total-impulse"
    r"|vacuum-thrust_lbs|rotor-.*|.*-angle-.*)"
)
_TANK_SET = (
    r"propulsion/tank(\[\d+\])?/(contents-lbs|priority|external-flow-rate-pps|unusable-volume-gal"
    r"|[xyz]-position)"
)
_TANK_MADE = r"propulsion/tank(\[\d+\])?/(pct-full|density-lbs_per_gal|local-i..-slug_ft2)"
_OWN = re.compile(
    r"(simulation|inertial|ic|orbital|velocities|position|attitude|accelerations|forces|moments"
    r"|flight-path|inertia|metrics|ground"
    r"|atmosphere)/.*"
    r"|aero/(Re|alpha(-wing|-max|-min)?-rad|alpha-deg|(alpha|beta)dot-(rad|deg)_sec"
    r"|(mag-)?beta-(rad|deg)|[bc]i2vel|cl-squared"
    r"|h_b-(cg|mac)-ft|qbar(UV|UW)?-psf|qbar-area|stall-hyst-norm)"
    r"|systems/stall-warn-norm|gear/(num-units|wow|unit(\[\d+\])?/.*)|contact/unit(\[\d+\])?/.*"
    r"|fcs/mag-.*-pos-rad"
    r"|propulsion/(tat-[rc]|pt-lbs_sqft|active_engine|set-running|starter_cmd|cutoff_cmd"
    r"|magneto_cmd|refuel|fuel_dump|fuel_freeze"
    rf"|total-.*-lbs)|{_ENGINE_SET}|{_ENGINE_MADE}|{_TANK_SET}|{_TANK_MADE}|buoyant_forces/.*"
)
_FIXED = re.compile(
    r"(metrics|inertia|external_reactions)/.*|simulation/(integrator/.*|gravity-model"
    r"|gravitational-torque)"
    rf"|{_AIR}|atmosphere/(randomseed|turb-(north|east|down)-fps|[pqr]-turb-rad_sec)"
    r"|.*/malfunction/fail_(zero|hardover|stuck|low|high)"
    # 0: contact ends a flight
    r"|gear/(unit(\[\d+\])?/)?(WOW|wow|compression-ft|compression-velocity-fps)"
    rf"|{_LEVERS}|position/terrain-elevation-asl-ft"
    rf"|{_ENGINE_SET}|propulsion/engine(\[\d+\])?/[xyz]-reference-position|{_TANK_SET}"
    rf"|propulsion/tank(\[\d+\])?/density-lbs_per_gal"
)
_WRITABLE = re.compile(rf"{_AIR}|metrics/aero-rp-[xyz]-in|{_ENGINE_SET}|{_TANK_SET}")
_BY_HOST = re.compile(
    r"metrics/(bw-ft|cbarw-ft)|inertia/(mass-slugs|weight-lbs|empty-weight-lbs|cg-[xyz]-in"
    r"|i..-slugs_ft2)"
    r"|simulation/(integrator/.*|gravity-model)|ic/.*|position/terrain-elevation-asl-ft"
)
REQUIRED: Mapping[str, float] = MappingProxyType(
    {
        "simulation/gravity-model": 1.0,
        "simulation/gravitational-torque": 0.0,
        "simulation/terminate": 0.0,
        "forces/hold-down": 0.0,
        "atmosphere/SL-graded-delta-T": 0.0,
        "atmosphere/vapor-pressure-psf": 0.0,
        "atmosphere/updownburst/number-of-cells": 0.0,
        "atmosphere/cosine-gust/magnitude-ft_sec": 0.0,
        **{
            f"simulation/models/FG{model}/enabled": 1.0
            for model in (
                "Inertial",
                "Propagate",
                "Atmosphere",
                "Winds",
                "FCS",
                "MassBalance",
                "Auxiliary",
                "Propulsion",
                "Aerodynamics",
                "ExternalReactions",
                "Aircraft",
                "Accelerations",
            )
        },
    }
)
"""Settings of JSBSim to the only value that the batch engine has."""


def own(name: str) -> bool:
    """Whether JSBSim makes the property itself, so that it may change although no XML writes it."""
    return _OWN.fullmatch(name) is not None


def fixed(name: str) -> bool:
    """Whether one of JSBSim's own properties keeps its value as long as nobody writes it."""
    return _FIXED.fullmatch(name) is not None


def writable(name: str) -> bool:
    """Whether the batch engine does what JSBSim does when XML writes the property."""
    return not own(name) or _WRITABLE.fullmatch(name) is not None


def settable(name: str) -> bool:
    """Whether the batch engine does what JSBSim does when a host sets the property before the
    flight.
    """
    return writable(name) or _BY_HOST.fullmatch(name) is not None


# Properties of JSBSim's own flight control model: which change with which, which take no value,
# and the engines' levers.

_WITH_SIZE = ("left-aileron", "right-aileron", "elevator", "rudder")
_SURFACES = (*_WITH_SIZE, "flap", "speedbrake", "spoiler")
_CONTROLS_LEVERS = ("throttle", "mixture", "advance", "feather")
CHANNEL_STEP = "simulation/channel-dt"
_NO_VALUE = re.compile(
    r"fcs/mag-.*-pos-rad|fcs/feather-.*|.*/(saturated|initial-integrator-value|randomseed"
    r"|malfunction/fail_(zero|hardover|stuck|low|high))"
)


def read_only(name: str) -> bool:
    """Whether JSBSim ignores what a component writes to it, or takes it otherwise than as a
    value.
    """
    return bool(_NO_VALUE.fullmatch(name)) or not writable(name)


def _surface(surface: str, degrees: bool) -> Callable[[Frame, Value], None]:
    """Surfaces stand in radians and degrees: either sets the other, and their size."""

    def write(frame: Frame, value: Value) -> None:
        radians = value * (math.pi / 180.0) if degrees else value
        frame.store(f"fcs/{surface}-pos-deg", value if degrees else value * (180.0 / math.pi))
        frame.store(f"fcs/{surface}-pos-rad", radians)
        if surface in _WITH_SIZE:
            frame.store(f"fcs/mag-{surface}-pos-rad", frame.builder.op("abs", radians))

    return write


HOOKS: Mapping[str, Callable[[Frame, Value], None]] = {
    f"fcs/{surface}-pos-{unit}": _surface(surface, unit == "deg")
    for surface in _SURFACES
    for unit in ("rad", "deg")
}
"""For ``Frame.hooks``: properties whose setting moves others."""


def copy_levers(frame: Frame, engines: int) -> None:
    """Put each engine's levers where they are commanded, as JSBSim does in every frame before the
    channels.
    """
    for number in range(engines):
        index = f"[{number}]" if number else ""
        for lever in _CONTROLS_LEVERS:
            frame.write(f"fcs/{lever}-pos-norm{index}", frame.get(f"fcs/{lever}-cmd-norm{index}"))
