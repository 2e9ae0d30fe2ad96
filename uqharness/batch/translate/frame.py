"""Trace one frame: values of properties while XML is translated, and the sections that result.

Properties are slots of the state. A property that nothing writes is a constant, folded where it is
read, unless it is one of the ``inputs`` that differ between lanes. All written properties must be
known before the first section is traced, because a property may be read before it is written; it
then has the value of the frame before.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import MappingProxyType
from typing import NoReturn

from uqharness.batch.ir import Builder, Value
from uqharness.batch.maths import reuse_sines
from uqharness.batch.program import Program, Section, Stream, When
from uqharness.errors import BadInputError
from uqharness.simulator import engine
from uqharness.xml import Document, Node

# Shared by all translators: builder, document, reading of properties, errors with file and line.

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_NAME = re.compile(r"/?[A-Za-z_][A-Za-z0-9_.\-]*(\[\d+\])?(/[A-Za-z_][A-Za-z0-9_.\-]*(\[\d+\])?)*")
_ROOT = "/fdm/jsbsim/"
JSBSIM_ATTRIBUTES = frozenset(
    [
        "action",
        "apply",
        "apply_at_cg",
        "breakPoint",
        "continuous",
        "copyto",
        "dispersion",
        "distribution",
        "execrate",
        "execute",
        "file",
        "format",
        "frame",
        "internal",
        "logic",
        "lookup",
        "lower",
        "mean",
        "model",
        "name",
        "negated_crossproduct_inertia",
        "noscale",
        "persistent",
        "rate",
        "sense",
        "seed",
        "shape",
        "stddev",
        "tc",
        "type",
        "unit",
        "upper",
        "value",
        "variation",
    ]
)
"""Attributes that JSBSim 1.3.3 reads in some element of an aircraft or script; it ignores all
others.
"""


@dataclass(frozen=True)
class Scope:
    """Context in which XML is read.

    Attributes
    ----------
    builder : Builder
        Creates the values.
    document : Document
        File, for messages.
    read : callable
        Returns the value of a property; None if nothing computes it, then the file is refused.
    draw : callable
        Returns the standard normal (``random``) or uniform number in -1..1 (``urandom``) that an
        element draws in this frame; None if that is not supported.
    note_beyond : callable
        Called with a condition under which JSBSim computes what the engine cannot; such a flight
        does not count.
    """

    builder: Builder
    document: Document
    read: Callable[[str], Value | None]
    draw: Callable[[Node], Value | None] = lambda _: None
    note_beyond: Callable[[Value], None] = lambda _: None

    def where(self, condition: Value) -> Scope:
        """Return a scope for what JSBSim computes only where the condition holds; elsewhere nothing
        is noted.
        """

        def note(is_beyond: Value) -> None:
            """Note a condition within the outer one."""
            self.note_beyond(self.builder.op("and", condition, is_beyond))

        return replace(self, note_beyond=note)

    def refuse(self, node: Node, reason: str) -> NoReturn:
        """Raise BadInputError with file and line."""
        raise BadInputError(f"{self.document.where(node)}: {reason}")

    def only(self, node: Node, attributes: Collection[str] = ()) -> None:
        """Refuse attributes other than these, unless JSBSim reads them nowhere."""
        for name in node.attributes:
            if name not in attributes and name in JSBSIM_ATTRIBUTES:
                self.refuse(
                    node,
                    f"attribute '{name}' of <{node.tag}> is not supported by the batch engine; use"
                    ' engine = "jsbsim"',
                )

    def number(self, node: Node, text: str | None = None) -> float:
        """Parse a number as JSBSim writes it: decimal, without blanks inside."""
        text = (node.text if text is None else text).strip()
        if not _NUMBER.fullmatch(text) or not math.isfinite(float(text)):
            self.refuse(node, f"<{node.tag}> must be a finite decimal number; received {text!r}")
        return float(text)

    def property_value(self, node: Node) -> Value:
        """Return the value of the property that the element's text names; a minus sign negates
        it.
        """
        if node.children:
            self.refuse(
                node,
                f"<{node.tag}> must be the name of a property; received <{node.children[0].tag}>,"
                " which JSBSim ignores",
            )
        return self.named_property(node, node.text)

    def named_property(self, node: Node, text: str) -> Value:
        """Return the value of the property that ``text`` names; a minus sign negates it."""
        text = text.strip()
        negative = text.startswith("-")
        name = property_of(self, node, text.removeprefix("-"))
        value = self.read(name)
        if value is None:
            self.refuse(
                node,
                f'property {name} is not computed by the batch engine; use engine = "jsbsim"',
            )
        return -value if negative else value

    def parameter(self, node: Node, text: str | None = None) -> Value:
        """Return a number, or the value of a property with or without a minus sign."""
        text = (node.text if text is None else text).strip()
        return (
            self.builder.constant(self.number(node, text))
            if is_number(text)
            else self.named_property(node, text)
        )

    @property
    def undefined(self) -> Value:
        """NaN, for what JSBSim ends the flight for."""
        return self.builder.constant(math.nan)


def error_scope(document: Document) -> Scope:
    """Return a scope for errors outside a frame; it reads no property."""
    return Scope(Builder(), document, lambda _: None)


def canonical(name: str) -> str:
    """Return the canonical spelling of a property: no root, no index 0.

    Examples
    --------
    >>> canonical("/fdm/jsbsim/fcs/throttle-cmd-norm[0]")
    'fcs/throttle-cmd-norm'
    """
    return name.strip().removeprefix(_ROOT).replace("[0]", "")


def property_of(scope: Scope, node: Node, text: str) -> str:
    """Return the property that a text names; refuse other texts."""
    name = canonical(text)
    if not _NAME.fullmatch(name):
        scope.refuse(
            node, f"<{node.tag}> must be the name of a property; received {text.strip()!r}"
        )
    return name


def function_name(name: str) -> str:
    """Return the property of a function: white space becomes '-'."""
    return "".join("-" if c.isspace() else c for c in name)


def is_number(text: str) -> bool:
    """Return whether JSBSim takes the text for a number; otherwise it names a property.

    Examples
    --------
    >>> is_number("-1.5e3"), is_number("fcs/elevator-cmd-norm")
    (True, False)
    """
    return bool(_NUMBER.fullmatch(text.strip()))


TIME = "simulation/sim-time-sec"
STEP = "#step"
"""Slot with the step [s], if it differs between lanes."""
MAX_SECTIONS, MAX_OPERATIONS, MAX_SLOTS = 2_000, 60_000, 2_500
"""Limits of a frame; E-SPAARO has 40, 3,800 and 520. Compiling takes about ten seconds at the
limits.
"""
DRAW, UNIFORM = "#draw/", "/uniform"
"""Start of the name of a slot with a drawn number, and its end for a uniform one."""
OUT_OF_RANGE = "#beyond"
"""Slot that is nonzero once a function had an argument beyond the engine's range; the lane's
results are not JSBSim's from then on.
"""
INITIALISED = "initialised:"
"""Prefix of a property's name for its value after JSBSim's initialising frames."""


class Values(dict[str, float]):
    """Values of properties before the first frame, by canonical name, each requested once.

    Parameters
    ----------
    value_of : callable
        Returns a value, or None if there is no such property.
    constant : callable
        Whether a property keeps its value if nothing writes it; JSBSim changes others, which are
        not computed here.
    """

    def __init__(
        self,
        value_of: Callable[[str], float | None],
        constant: Callable[[str], bool] = lambda _: True,
    ) -> None:
        """Start without values."""
        super().__init__()
        self._value_of = value_of
        self.constant = constant
        self._absent: set[str] = set()

    def __contains__(self, name: object) -> bool:
        return self._lookup(str(name)) is not None

    def __missing__(self, name: str) -> float:
        value = self._lookup(name)
        if value is None:
            raise KeyError(name)
        return value

    def get(  # type: ignore[override]
        self, name: str, default: float | None = None
    ) -> float | None:
        """Return the value, or ``default`` if there is no such property."""
        value = self._lookup(name)
        return default if value is None else value

    def setdefault(self, name: str, default: float = 0.0) -> float:
        """Return the value; if there is none, ``default``, which is stored."""
        value = self._lookup(name)
        if value is None:
            self[name] = value = default
        return value

    def _lookup(self, name: str) -> float | None:
        """Return the value from the cache or the source; None if there is none."""
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


class LeftOutError(BadInputError):
    """Something reads a property of an element that was left out; the text is the reason for
    leaving that out.
    """


@dataclass
class LeftOut:
    """Elements that the engine does not support and whose properties nothing in the flight reads.

    Attributes
    ----------
    nodes : dict
        Element -> why it was left out.
    properties : dict
        Property that such an element writes -> the same reason; whatever reads it is left out in
        turn, or the flight is refused.
    has_grown : bool
        Whether something was added since the last survey of the frame.
    """

    nodes: dict[Node, str] = field(default_factory=dict)
    properties: dict[str, str] = field(default_factory=dict)
    has_grown: bool = False

    def add(self, node: Node, properties: Collection[str], reason: str) -> None:
        """Leave an element out."""
        self.nodes[node] = reason
        self.properties |= dict.fromkeys(properties, reason)
        self.has_grown = True


class Frame:
    """Trace of one frame.

    Parameters
    ----------
    dt_s : float
        Step; 0 while JSBSim initialises.
    values : mapping
        Property -> value before the first frame.
    written_properties : collection of str or None
        Properties that some frame writes: they are state. None: not known yet; every property
        counts as state, and ``writes`` lists the written ones afterwards.
    inputs : collection of str
        Properties that differ between lanes and are never written.
    any_step : bool
        Whether the step is a number of the lane, in slot STEP.
    left_out : LeftOut, optional
        What earlier surveys left out; without it, everything that is not supported is refused.
    requested : collection of str or None
        Properties that something reads; None: all.

    ``live`` has properties that are computed where they are read, as JSBSim does with a function
    that has not run yet; ``hooks`` those whose setting changes others too.
    """

    def __init__(
        self,
        dt_s: float,
        values: Mapping[str, float],
        written_properties: Collection[str] | None,
        inputs: Collection[str] = (),
        any_step: bool = False,
        left_out: LeftOut | None = None,
        requested: Collection[str] | None = None,
    ) -> None:
        """Start without sections."""
        self.left_out = left_out
        # JSBSim's trim status: actuators and kinematics are at their commands.
        self.trimming = False
        # Properties of the author's that JSBSim computes for engines of another kind.
        self.authored: Collection[str] = ()
        self.reads: set[str] = set()
        self.requested = requested
        self.dt_s, self.any_step = dt_s, any_step
        self.values = (
            values
            if isinstance(values, Values)
            else {canonical(n): float(v) for n, v in values.items()}
        )
        # None in the survey pass, which finds the written properties.
        self.written_properties = (
            None
            if written_properties is None
            else frozenset(canonical(name) for name in written_properties)
        )
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
        """Step of the frame [s]."""
        return self.builder.constant(self.dt_s) if self.initialising else self.load_step

    @property
    def load_step(self) -> Value:
        """Step at which the aircraft was loaded [s], from which filter coefficients are
        computed.
        """
        return (
            self.memory(STEP[1:], self.dt_s) if self.any_step else self.builder.constant(self.dt_s)
        )

    @property
    def initialising(self) -> bool:
        """Whether time stands still, as in the two frames that JSBSim runs before a flight."""
        return self.dt_s == 0.0

    @contextmanager
    def section(self, name: str, when: When | None = None) -> Iterator[None]:
        """Make one section of what is traced inside.

        Sections do not nest; a value of one must not be used in another.
        """
        if self._when is not None:
            raise RuntimeError(f"section {name} inside section {self._name}")
        self._when, self._name = when or When(), name
        # Each section has its own builder; values pass through slots.
        self.builder = Builder()
        try:
            yield
        except BaseException:
            self._when = None
            raise
        self.sections.append(Section(name, self.builder.finish({}), self._when))
        self._when = None
        self._refuse_too_large()

    def _refuse_too_large(self) -> None:
        """Refuse a frame that would keep the compiler busy for minutes, as soon as it exceeds the
        limits.
        """
        function = self.sections[-1].function
        self._operations += len(function.nodes)
        self._slots.update(function.slots)
        for count, maximum, words in (
            (len(self.sections), MAX_SECTIONS, "components and functions"),
            (self._operations, MAX_OPERATIONS, "operations a frame"),
            (len(self._slots), MAX_SLOTS, "numbers of state (each frame of a delay is one)"),
        ):
            if count > maximum:
                raise BadInputError(
                    f"too large for the batch engine: more than {maximum} {words}; "
                    'use engine = "jsbsim"'
                )

    def read(self, name: str) -> Value | None:
        """Return the present value of a property; None if nothing computes it.

        Raises LeftOutError for a property of an element that was left out.
        """
        name = canonical(name)
        self.reads.add(name)
        if self.left_out is not None and name in self.left_out.properties:
            raise LeftOutError(self.left_out.properties[name])
        if name in self.live:
            return self.live[name]()
        # The survey pass: every property may be written later.
        if self.written_properties is None:
            return self.builder.load(name)
        if name in self.written_properties or name in self.inputs:
            self.values.setdefault(name, 0.0)
            return self.builder.load(name)
        if isinstance(self.values, Values) and not self.values.constant(name):
            return None
        value = self.values.get(name)
        return None if value is None else self.builder.constant(value)

    def requests(self, name: str) -> bool:
        """Return whether something reads a property; always true in the survey."""
        return self.requested is None or name in self.requested

    @contextmanager
    def leaving_out(self, node: Node, properties: Collection[str]) -> Iterator[None]:
        """Leave an element out if it is not supported, unless it does more than write
        ``properties`` that are nothing to JSBSim's models.

        A function with random numbers stays, because its draws belong to the common stream.
        """
        try:
            yield
        except BadInputError as error:
            names = {canonical(name) for name in properties}
            if (
                self.left_out is None
                or any(
                    name in self.hooks or made_by_jsbsim(name) or keeps_value(name)
                    for name in names
                )
                or any(inner.tag in ("random", "urandom") for inner in node.walk())
            ):
                raise
            self.left_out.add(node, names, str(error))

    def is_left_out(self, node: Node) -> bool:
        """Return whether an element was left out."""
        return self.left_out is not None and node in self.left_out.nodes

    def get(self, name: str) -> Value:
        """Return the present value of a property that the engine computes; KeyError if it does
        not.
        """
        value = self.read(name)
        if value is None:
            raise KeyError(name)
        return value

    def write(self, name: str, value: Value | float) -> None:
        """Write a property as XML does; its hook does what JSBSim does besides."""
        name = canonical(name)
        hook = self.hooks.get(name)
        if hook is None:
            self.store(name, value)
        else:
            hook(self, self.builder.value(value))

    def store(self, name: str, value: Value | float) -> None:
        """Write a property without its hook."""
        name = canonical(name)
        self.writes.add(name)
        # The survey must have seen every write.
        if self.written_properties is not None and name not in self.written_properties:
            raise KeyError(f"{name} is written here, which was not foreseen")
        self.values.setdefault(name, 0.0)
        self.builder.store(name, value)

    def memory(self, name: str, first: float = 0.0) -> Value:
        """Load a slot that is no property, last set by `remember`; ``first`` before the first
        frame.

        Its name starts with '#'.
        """
        self.values.setdefault(f"#{name}", first)
        return self.builder.load(f"#{name}")

    def remember(self, name: str, value: Value | float, first: float = 0.0) -> None:
        """Store a value into such a slot."""
        self.values.setdefault(f"#{name}", first)
        self.builder.store(f"#{name}", value)

    def is_commanded(self, slot: str) -> bool:
        """Return whether a command's hook sets such a slot; always true in the survey."""
        return self.written_properties is None or f"#{slot}" in self.written_properties

    def scope(self, document: Document) -> Scope:
        """Return a scope for elements of ``document`` in the current section."""
        return Scope(self.builder, document, self.read, self._draw_for(document), self.note_beyond)

    def note_beyond(self, condition: Value) -> None:
        """Mark lanes in which the condition holds."""
        if condition.constant is not None and not condition.constant:
            return
        self.remember(OUT_OF_RANGE[1:], condition.choose(1.0, self.memory(OUT_OF_RANGE[1:])))

    def draw(self, uniform: bool = False) -> Value | None:
        """Draw a standard normal, or a uniform number in -1..1; None in a section that lanes run
        at different times.
        """
        assert self._when is not None
        if self.written_properties is not None and (
            self._when.mask is not None or self._when.at is not None
        ):
            return None
        name = f"{DRAW}{len(self.draws)}{UNIFORM if uniform else ''}"
        self.draws.append((name, self._when.every))
        self.values[name] = 0.0
        return self.builder.load(name)

    def _draw_for(self, document: Document) -> Callable[[Node], Value | None]:
        """Return the draw function of a scope; elements with a seed have no stream."""

        def draw(node: Node) -> Value | None:
            """Draw the number of a ``<random>`` or ``<urandom>``."""
            return None if "seed" in node.attributes else self.draw(node.tag == "urandom")

        return draw

    def program(self, records: Collection[str], streams: Collection[Stream] = ()) -> Program:
        """Return all sections as a program."""
        slots: dict[str, float] = {}
        for section in self.sections:
            for name in section.function.slots:
                slots.setdefault(name, self.values[name])
        # Streams and records may name slots that no section uses.
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


# JSBSim's own properties: which exist, which keep their value, which XML and hosts may write,
# which must have a fixed value. Determined by experiment with JSBSim 1.3.3; XML declares all
# other properties.

_LEVERS = (
    r"fcs/(?!steer-pos-deg).*-(cmd|pos)-(norm|rad|deg)(\[\d+\])?|fcs/.*-brake-cmd-norm"
    r"|gear/gear-(cmd|pos)-norm"
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
    r"|ram-air-factor|cooling-factor|starter-norm|boost-speed"
    r"|bleed-factor|reverser|mixture-ratio|isp)"
)
_ENGINE_MADE = (
    r"propulsion/engine(\[\d+\])?/(set-running|thrust-lbs|fuel-flow-rate-(pps|gph)"
    r"|fuel-used-lbs|(engine|propeller)-rpm"
    r"|advance-ratio|thrust-coefficient|helical-tip-Mach|prop-induced-velocity_fps"
    r"|propeller-(power-ftlbps|torque-ftlb)"
    r"|[xyz]-reference-position|power-hp|current-amperes|map-(pa|inhg)"
    r"|boostloss-(factor|hp)|(cht|egt)-degF|AFR"
    r"|oil-(temperature-degF|pressure-psi)|n[12]|MaxN[12]|injection_cmd|seized|stalled"
    r"|Inj(ectionTimer|WaterNorm|N[12]increment)"
    r"|a?tsfc|itt-c|engtemp-c|total-vac-impulse|oxi-flow-rate-pps|engtrq-ftlb|ielu_intervent"
    r"|combustion_efficiency|total-impulse"
    r"|vacuum-thrust_lbs|rotor-.*|.*-angle-.*)"
)
_TANK_SET = (
    r"propulsion/tank(\[\d+\])?/(contents-lbs|priority|external-flow-rate-pps|unusable-volume-gal"
    r"|[xyz]-position)"
)
_TANK_MADE = r"propulsion/tank(\[\d+\])?/(pct-full|density-lbs_per_gal|local-i..-slug_ft2)"
_CONTACT_SET = (
    r"(gear|contact)/unit(\[\d+\])?/"
    r"(pos-norm|[xyz]-position|(static|dynamic|rolling)_friction_coeff)"
)
_CONTACT = (
    rf"{_CONTACT_SET}|(gear|contact)/unit(\[\d+\])?/(WOW|compression-ft|compression-velocity-fps"
    r"|slip-angle-deg|wheel-speed-fps|steering-angle-deg|castered|solid|bumpiness"
    r"|maximum-force-lbs|rolling_friction-factor|static-friction-factor)"
)
_CONTACT_MADE = r"(gear|contact)/unit(\[\d+\])?/(AGL-ft|side_friction_coeff)"
_STEERING = r"fcs/steer-pos-deg(\[\d+\])?"
_JSBSIM_MADE = re.compile(
    r"(simulation|inertial|ic|orbital|velocities|position|attitude|accelerations|forces|moments"
    r"|flight-path|inertia|metrics|ground"
    r"|atmosphere)/.*"
    r"|aero/(Re|alpha(-wing|-max|-min)?-rad|alpha-deg|(alpha|beta)dot-(rad|deg)_sec"
    r"|(mag-)?beta-(rad|deg)|[bc]i2vel|cl-squared"
    r"|h_b-(cg|mac)-ft|qbar(UV|UW)?-psf|qbar-area|stall-hyst-norm)"
    rf"|systems/stall-warn-norm|gear/(num-units|wow)|{_CONTACT}|{_CONTACT_MADE}"
    rf"|fcs/mag-.*-pos-rad|{_STEERING}"
    r"|propulsion/(tat-[rc]|pt-lbs_sqft|active_engine|set-running|starter_cmd|cutoff_cmd"
    r"|magneto_cmd|refuel|fuel_dump|fuel_freeze"
    rf"|total-.*-lbs)|{_ENGINE_SET}|{_ENGINE_MADE}|{_TANK_SET}|{_TANK_MADE}|buoyant_forces/.*"
)
_FIXED = re.compile(
    r"(metrics|inertia|external_reactions)/.*|simulation/(integrator/.*|gravity-model"
    r"|gravitational-torque)"
    rf"|{_AIR}|atmosphere/(randomseed|turb-(north|east|down)-fps|[pqr]-turb-rad_sec)"
    r"|.*/malfunction/fail_(zero|hardover|stuck|low|high)"
    # Contact ends a flight, so that points keep their values in the air.
    rf"|gear/(wow|num-units)|{_CONTACT}|ground/.*"
    r"|forces/fb[xyz]-gear-lbs|moments/[lmn]-gear-lbsft"
    rf"|{_LEVERS}|position/terrain-elevation-asl-ft"
    rf"|{_ENGINE_SET}|propulsion/engine(\[\d+\])?/[xyz]-reference-position|{_TANK_SET}"
    rf"|propulsion/tank(\[\d+\])?/density-lbs_per_gal"
)
_WRITABLE = re.compile(
    rf"{_AIR}|metrics/aero-rp-[xyz]-in|{_ENGINE_SET}|{_TANK_SET}|{_CONTACT_SET}|{_STEERING}"
    r"|inertia/pointmass-(weight-lbs|location-[XYZ]-inches)(\[\d+\])?"
    r"|simulation/integrator/(rate|position)/(rotational|translational)"
    r"|propulsion/(magneto|starter|cutoff)_cmd"
)
_NOT_BY_HOST = re.compile(r"propulsion/(magneto|starter|cutoff)_cmd")
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
"""Settings of JSBSim -> the only supported value."""


_SECTIONS = re.compile(
    r"(simulation|inertial|ic|orbital|velocities|position|attitude|accelerations|forces|moments"
    r"|flight-path|inertia|metrics|ground|atmosphere)/.*"
)
_OF_MODEL = re.compile(
    r"(forces|moments)/.*-(prop|buoyancy)-.*|inertia/pointmass-.*|simulation/integrator/.*"
)


@lru_cache(maxsize=4096)
def made_by_jsbsim(name: str) -> bool:
    """Return whether JSBSim computes the property, so that it may change although no XML writes
    it.
    """
    if _JSBSIM_MADE.fullmatch(name) is None:
        return False
    # Authors put properties of their own into JSBSim's sections.
    return bool(
        not _SECTIONS.fullmatch(name)
        or _OF_MODEL.fullmatch(name)
        or engine.exists_without_model(name)
    )


def keeps_value(name: str) -> bool:
    """Return whether a property of JSBSim keeps its value unless something writes it."""
    is_authors = _JSBSIM_MADE.fullmatch(name) is not None and not made_by_jsbsim(name)
    return _FIXED.fullmatch(name) is not None and not is_authors


def is_constant(name: str) -> bool:
    """Return whether a property keeps its value unless something writes it: a setting of JSBSim,
    or a property of the XML or the host.
    """
    return keeps_value(name) or not made_by_jsbsim(name)


def writable(name: str) -> bool:
    """Return whether the engine does what JSBSim does when XML writes the property."""
    return not made_by_jsbsim(name) or _WRITABLE.fullmatch(name) is not None


def settable(name: str) -> bool:
    """Return whether the engine does what JSBSim does when a host sets the property before the
    flight.
    """
    if _NOT_BY_HOST.fullmatch(name):
        return False
    return writable(name) or _BY_HOST.fullmatch(name) is not None


def integer_hook(name: str) -> Callable[[Frame, Value], None]:
    """Return the hook of a property that JSBSim keeps as an integer: the fraction is dropped."""

    def write(frame: Frame, value: Value) -> None:
        """Store the truncated value."""
        size = frame.builder.op("floor", frame.builder.op("abs", value))
        frame.store(name, value.lt(0.0).choose(-size, size))

    return write


def command_hook(slots: Collection[str]) -> Callable[[Frame, Value], None]:
    """Return the hook of a command to all engines; each keeps it as an integer.

    ``slots`` are memories without '#'.
    """

    def write(frame: Frame, value: Value) -> None:
        """Remember the truncated value; refuse a command to one engine alone."""
        if frame.values.get("propulsion/active_engine", -1.0) not in (-1.0, None):
            raise BadInputError(
                "propulsion/active_engine selects one engine: commands to it alone are not"
                " understood by the batch engine"
            )
        size = frame.builder.op("floor", frame.builder.op("abs", value))
        for slot in slots:
            frame.writes.add(f"#{slot}")
            frame.remember(slot, value.lt(0.0).choose(-size, size))

    return write


def truth_hook(name: str) -> Callable[[Frame, Value], None]:
    """Return the hook of a property that JSBSim keeps as a truth value."""

    def write(frame: Frame, value: Value) -> None:
        """Store 1 or 0."""
        frame.store(name, value.ne(0.0).choose(1.0, 0.0))

    return write


# Properties of JSBSim's flight control: which change together, which ignore values, and the
# engines' levers.

_WITH_SIZE = ("left-aileron", "right-aileron", "elevator", "rudder")
_SURFACES = (*_WITH_SIZE, "flap", "speedbrake", "spoiler")
_CONTROLS_LEVERS = ("throttle", "mixture", "advance", "feather")
CHANNEL_STEP = "simulation/channel-dt"
_NO_VALUE = re.compile(
    r"fcs/mag-.*-pos-rad|.*/(saturated|initial-integrator-value|randomseed"
    r"|malfunction/fail_(zero|hardover|stuck|low|high))"
)


# Instruments that engines of one kind have in JSBSim; those of other kinds are the author's.
_GAUGES = {
    "piston_engine": ("AFR", "cht-degF", "egt-degF", "oil-pressure-psi", "oil-temperature-degF"),
    "turboprop_engine": ("itt-c",),
}


def gauges_of_other_engines(kinds: Iterable[str]) -> frozenset[str]:
    """Return the instruments that the engines of a model, given by their kinds, do not have.

    Examples
    --------
    >>> sorted(gauges_of_other_engines(["piston_engine"]))
    ['propulsion/engine/itt-c']
    """
    return frozenset(
        canonical(f"propulsion/engine[{k}]/{gauge}")
        for k, kind in enumerate(kinds)
        for other, gauges in _GAUGES.items()
        for gauge in gauges
        if other != kind
    )


def read_only(name: str) -> bool:
    """Return whether JSBSim ignores what a component writes, or does not treat it as a value."""
    return bool(_NO_VALUE.fullmatch(name)) or not writable(name)


def _surface(surface: str, degrees: bool) -> Callable[[Frame, Value], None]:
    """Return the hook of a surface: radians, degrees and magnitude change together."""

    def write(frame: Frame, value: Value) -> None:
        """Store the surface in both units."""
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
} | {
    name: truth_hook(name)
    for name in (
        f"fcs/feather-{kind}-norm{index}"
        for kind in ("cmd", "pos")
        for index in ("", *(f"[{k}]" for k in range(1, 8)))
    )
}
"""For ``Frame.hooks``: properties whose setting changes others."""


def copy_levers(frame: Frame, engines: int) -> None:
    """Set each engine's levers to their commands, as JSBSim does in every frame before the
    channels.
    """
    for number in range(engines):
        index = f"[{number}]" if number else ""
        for lever in _CONTROLS_LEVERS:
            frame.write(f"fcs/{lever}-pos-norm{index}", frame.get(f"fcs/{lever}-cmd-norm{index}"))
