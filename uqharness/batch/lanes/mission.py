"""A mission made ready to fly in lanes: its programs compiled, and what JSBSim has to say before
the first frame.

JSBSim itself loads the aircraft once: mass, metrics and initial conditions are its numbers, so that
units, defaults and ``<initialize>`` files have one meaning."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from uqharness.batch.form.interpret import Interpreter
from uqharness.batch.form.passes import optimise, propagate_constants, specialise_startup
from uqharness.batch.form.program import Flyer, Program, Stream
from uqharness.batch.lanes.streams import GUSTS, LEVELS, TRANSIENTS, noise_streams
from uqharness.batch.machine.flight import compile_program
from uqharness.batch.machine.llvm import choose_target
from uqharness.batch.models.auxiliary import POINT, TOUCHED
from uqharness.batch.models.motion import CONDITIONS, WEIGHTS_PARTS, rounded, slots
from uqharness.batch.translate.channels import Sources, read_sources
from uqharness.batch.translate.engines import going
from uqharness.batch.translate.frame import BEYOND, INITIALISED, Values, canonical, fixed, own
from uqharness.batch.translate.tanks import DRY, MASS, dry_aircraft
from uqharness.batch.translate.whole import Asked, Flight, trace_flight
from uqharness.errors import BadInputError
from uqharness.flight import (
    ContactPoint,
    FlightSpec,
    as_model_has,
    contact_points,
    has_air,
    record_stride,
    set_conditions,
    set_wind_without_air,
)
from uqharness.simulator import CHANGEABLE, MARK, RATES_FREE, RATES_HELD, StagedMission, engine
from uqharness.xml import Document, read_document

_DECLARING = (
    "system",
    "autopilot",
    "flight_control",
    "aerodynamics",
    "external_reactions",
    "run",
    "propulsion",
)
"""Elements whose property children declare; elsewhere they read."""
_START = re.compile(r"(?<![\w/])(?:/?fdm/jsbsim/)?ic/[\w.\-]+(?:\[\d+\])?")
_ENGINE = "propulsion/engine"
WIND = tuple(f"atmosphere/wind-{axis}-fps" for axis in ("north", "east", "down"))
"""The steady wind as JSBSim blows it."""
AIR_WIND = ("air/wind-mps", "air/wind-from-deg", "air/turbulence-w20-kt")
"""The conditions of a flight as the air system has them: one program flies them all."""
GROUND_SPEED = tuple(f"velocities/v-{axis}-fps" for axis in ("north", "east", "down"))
_STATIC = ("inertia/", "metrics/")
"""What loading alone does not fill in."""


@dataclass(frozen=True)
class Loaded:
    """What JSBSim has loaded and set for one start, before initialising.

    conditions  CONDITIONS
    settings    values of properties that were set: the aircraft's own where it has not all of them
    wind_fps    steady wind, north, east, down, of JSBSim's initial conditions
    blown_fps   that of the flight, where JSBSim blows it itself and not the air system
    """

    conditions: Mapping[str, float]
    settings: Mapping[str, float]
    static: Mapping[str, float]
    wind_fps: tuple[float, ...]
    blown_fps: tuple[float, ...]


@dataclass(frozen=True)
class LaneMission:
    """A mission for any number of lanes. ``inputs`` are properties that may differ between them,
    ``varying`` all slots that may; a row is recorded every ``stride`` frames; ``steady``: engines
    begin in the steady state of their throttles."""

    mission: StagedMission
    flight: Flight
    inputs: tuple[str, ...]
    varying: tuple[str, ...]
    stride: int
    dt_s: float
    air: bool
    span_ft: float
    points: tuple[ContactPoint, ...]
    steady: bool = False

    @cached_property
    def program(self) -> Program:
        """A frame of the flight with less work: made when it is flown, for who asks whether it can
        be does without.
        """
        flight = self.flight
        between = (
            (*flight.steady, flight.renewed) if self.steady and flight.renewed is not None else ()
        )
        program = propagate_constants(
            (flight.first, flight.second), flight.frame, self.varying, between
        )
        program = replace(program, streams=(*program.streams, *noise_streams(flight.draws)))
        return optimise(
            program,
            [name for name in program.slots if name.startswith("#turbulence/row")],
            self.stride,
        )

    @cached_property
    def flyer(self) -> Flyer:
        """The program of the flight, compiled for this processor."""
        return compile_program(self.program, choose_target())

    @cached_property
    def initialisers(self) -> tuple[Interpreter, Interpreter]:
        """The two initialising frames."""
        behind = [one for one in (*self.flight.steady, self.flight.renewed) if one is not None]
        # From the ground speed the host's gusts are made where there is no air system.
        kept = [*self.inputs, *(() if self.air else GROUND_SPEED)]
        kept += [name for one in behind for name in one.slots] if self.steady else []
        first, second = specialise_startup(
            self.flight.first, self.flight.second, self.program, kept
        )
        return Interpreter(first), Interpreter(second)

    @cached_property
    def settlers(self) -> tuple[tuple[str, Flyer], ...]:
        """As `compiled_settlers` gives them."""
        return compiled_settlers(self.flight)

    @cached_property
    def renewer(self) -> Interpreter | None:
        """The frame behind the steady state, in which time stands still; None without one."""
        return (
            Interpreter(self.flight.renewed)
            if self.steady and self.flight.renewed is not None
            else None
        )


def compiled_settlers(flight: Flight) -> tuple[tuple[str, Flyer], ...]:
    """For each engine the slot that is not 0 while it is on its way to its steady state, and the
    turns of that way, compiled.
    """
    return tuple(
        (going(engine), compile_program(program, choose_target()))
        for engine, program in zip(flight.propulsion.engines, flight.steady, strict=True)
    )


def _refuse_running(mission: StagedMission) -> None:
    """BadInputError with file and line where the initial conditions start engines, which is not
    understood.
    """
    start = mission.aircraft.folder / mission.script.initialize
    path = start if start.is_file() else start.with_name(f"{start.name}.xml")
    document = read_document(path)
    for node in document.root.walk():
        if node.tag == "running":
            raise BadInputError(
                f"{document.where(node)}: <running> in initial conditions is not understood by the"
                " batch engine"
            )


def make_mission(
    mission: StagedMission,
    spec: FlightSpec,
    inputs: Collection[str],
    records: Sequence[str],
    optional: Sequence[str] = (),
) -> LaneMission:
    """Translate the mission under the conditions of ``spec``, recorded at its rate.

    Raises BadInputError with file and line.
    """
    sources = read_sources(mission.aircraft, mission.script.path)
    _refuse_running(mission)
    _refuse_settling(mission)
    unchanged = replace(
        spec, properties={n: v for n, v in spec.properties.items() if n not in CHANGEABLE}
    )

    def opened() -> Any:
        fdm = mission.open()
        set_conditions(fdm, mission, unchanged)
        return fdm

    fdm = opened()
    air = has_air(fdm)
    values = Values(initial_values(opened, fdm), constant_properties(sources))
    values.setdefault(BEYOND)
    gusty = spec.turbulence != "none" and spec.turbulence_source == "spec"
    fed: list[Stream] = [GUSTS] if gusty else []
    fed += [LEVELS] if spec.levels is not None else []
    fed += [TRANSIENTS] if spec.transient is not None else []
    there = fdm.get_property_manager().hasNode
    records = [*records, *(name for name in optional if there(name))]
    points = tuple(contact_points(fdm, mission.aircraft))
    records = [*records, *((TOUCHED, POINT) if points else ())]
    names = dict.fromkeys(canonical(name) for name in inputs)
    if any(name.startswith("inertia/") for name in names):
        # Whatever is changed of them may move the others.
        names |= dict.fromkeys(MASS)
    names |= dict.fromkeys(name for name in start_properties(sources) if there(name))
    # Without an air system the wind is another one in the initialising frames.
    names |= dict.fromkeys(AIR_WIND if air else WIND)
    asked = Asked(tuple(names), fed, records, points, turned=gusty and not air, reweighed=True)
    flight = trace_flight(sources, mission.aircraft.dt_s, values, asked)
    varying = (
        *asked.inputs,
        *(f"#{name}" for part in WEIGHTS_PARTS for name in slots(part)),
        *(name for name, _ in flight.draws),
    )
    varying = (*varying, *(DRY if set(asked.inputs) & set(MASS) else ()))
    steady = MARK in mission.script.run_properties and flight.renewed is not None
    return LaneMission(
        mission,
        flight,
        tuple(asked.inputs),
        varying,
        record_stride(spec, mission.aircraft.dt_s),
        mission.aircraft.dt_s,
        air,
        float(values["metrics/bw-ft"]),
        points,
        steady,
    )


def _refuse_settling(mission: StagedMission) -> None:
    if any(mark in mission.script.run_properties for mark in (RATES_HELD, RATES_FREE)):
        raise BadInputError(
            f"{mission.script.path}: frames of JSBSim bring the control system to rest before the"
            ' flight begins; fly it with engine = "jsbsim"'
        )


def initial_values(open_fdm: Callable[[], Any], fdm: Any = None) -> Callable[[str], float | None]:
    """A property's value before initialising, as in ``fdm`` or a new instance; mass and metrics
    from one that was initialised.
    """
    fdm = open_fdm() if fdm is None else fdm
    done = open_fdm()
    engine.run_ic(done)
    exists = fdm.get_property_manager().hasNode
    later = done.get_property_manager().hasNode

    def value(name: str) -> float | None:
        if name == "aero/qbar-area":
            # JSBSim does not set it before it computes it: whatever stands in the memory would be
            # read.
            return 0.0
        if name.startswith(INITIALISED):
            name = name.removeprefix(INITIALISED)
            found = float(done[name]) if later(name) else None
            return rounded(found) if found is not None and name.startswith(_ENGINE) else found
        if name.startswith(_STATIC):
            return float(done[name]) if later(name) else None
        if name.startswith(_ENGINE):
            # Engines that a script has set running: numbers of the C library, which differ in the
            # last place between machines.
            return rounded(float(fdm[name])) if exists(name) else None
        return float(fdm[name]) if exists(name) else None

    return value


def start_properties(sources: Sources) -> list[str]:
    """JSBSim's initial conditions that the XML reads: they differ from lane to lane as
    starts do.
    """
    parts = [(system.document, system.node) for system in sources.systems]
    parts += [
        part
        for part in (sources.aerodynamics, sources.external, sources.propulsion)
        if part is not None
    ]
    parts += [(sources.script, sources.script.root)]
    texts = [
        text
        for _, root in parts
        for node in root.walk()
        for text in (node.text, *node.attributes.values())
    ]
    return [canonical(name) for name in dict.fromkeys(_START.findall("\n".join(texts)))]


def constant_properties(sources: Sources) -> Callable[[str], bool]:
    """Whether a property keeps its value as long as nobody writes it: declared in the XML, or one
    of JSBSim's settings.
    """
    declared: set[str] = set()
    parts = [(system.document, system.node) for system in sources.systems]
    parts += [part for part in (sources.aerodynamics, sources.external) if part is not None]
    documents: list[Document] = [
        sources.document,
        sources.script,
        *(document for document, _ in parts),
    ]
    for document in documents:
        for node in document.root.walk():
            if node.tag == "property" and node.parent is not None and node.parent.tag in _DECLARING:
                declared.add(canonical(node.text))

    def constant(name: str) -> bool:
        return fixed(name) or (name in declared and not own(name))

    return constant


def load_start(mission: LaneMission, spec: FlightSpec) -> Loaded:
    """Have JSBSim load and set one start. Raises BadInputError for what cannot be set."""
    changed = {name: value for name, value in spec.properties.items() if name in CHANGEABLE}
    fdm = mission.mission.open(changed=changed)
    set_conditions(fdm, mission.mission, spec)
    settings = as_model_has(fdm, spec.properties)
    conditions = {name: float(fdm[name]) for name in CONDITIONS}
    wind = tuple(float(fdm[f"ic/vw-{axis}-fps"]) for axis in ("north", "east", "down"))
    static = {name: rounded(float(fdm[name])) for name in mission.inputs if _START.fullmatch(name)}
    if changed:
        engine.run_ic(fdm)
        static |= {name: float(fdm[name]) for name in mission.inputs if name.startswith(_STATIC)}
        if mission.flight.propulsion.tanks and set(mission.inputs) & set(MASS):
            static |= dry_aircraft(mission.flight.propulsion.tanks, lambda name: float(fdm[name]))
    set_wind_without_air(fdm, spec)
    return Loaded(conditions, settings, static, wind, tuple(float(fdm[name]) for name in WIND))
