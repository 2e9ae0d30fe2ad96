"""Prepare a mission for lanes: compile its programs, and ask JSBSim for the values before the first
frame.

JSBSim loads the aircraft once. Mass, metrics and initial conditions are its numbers, so units,
defaults and ``<initialize>`` files are interpreted in one place.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from cachetools import LRUCache

from uqharness.batch.auxiliary import POINT, TOUCHED
from uqharness.batch.interpret import Interpreter
from uqharness.batch.llvm import choose_target
from uqharness.batch.llvm_flight import compile_program
from uqharness.batch.motion import CONDITIONS, WEIGHTS_PARTS, round_44_bits
from uqharness.batch.motion import slots as state_slots
from uqharness.batch.passes import optimise, propagate_constants, specialise_startup
from uqharness.batch.program import Flyer, Program, Stream
from uqharness.batch.streams import GUSTS, LEVELS, TRANSIENTS, noise_streams
from uqharness.batch.translate.channels import Sources, read_sources
from uqharness.batch.translate.engines import Engine
from uqharness.batch.translate.flight import Flight, TraceRequest, trace_flight
from uqharness.batch.translate.frame import (
    INITIALISED,
    OUT_OF_RANGE,
    Values,
    canonical,
    is_constant,
)
from uqharness.batch.translate.tanks import DRY, MASS
from uqharness.batch.translate.turbine import Turbine
from uqharness.errors import BadInputError
from uqharness.flight import (
    ContactPoint,
    FlightSpec,
    contact_points,
    has_air_system,
    record_stride,
    set_conditions,
    set_wind_without_air,
    without_missing_switches,
)
from uqharness.simulator import (
    CHANGEABLE,
    MARK,
    RATES_FREE,
    RATES_HELD,
    StagedMission,
    engine,
    forced_state,
)
from uqharness.xml import read_document

_START = re.compile(r"(?<![\w/])(?:/?fdm/jsbsim/)?ic/[\w.\-]+(?:\[\d+\])?")
_ENGINE = "propulsion/engine"
_MAX_STARTS = 4
WIND = tuple(f"atmosphere/wind-{axis}-fps" for axis in ("north", "east", "down"))
"""The steady wind in JSBSim."""
AIR_WIND = ("air/wind-mps", "air/wind-from-deg", "air/turbulence-w20-kt")
"""Inputs of the air system, which differ between lanes of one program."""
GROUND_SPEED = tuple(f"velocities/v-{axis}-fps" for axis in ("north", "east", "down"))
_STATIC = ("inertia/", "metrics/", "gear/unit", "contact/unit")
"""Prefixes of properties that JSBSim computes only when it initialises."""


@dataclass(frozen=True)
class LoadedStart:
    """What JSBSim has loaded and set for one start, before initialising.

    Attributes
    ----------
    conditions : mapping
        CONDITIONS -> value.
    settings : mapping
        Values of properties that were set, as the model reports them.
    static : mapping
        Mass and start properties that differ from the aircraft's.
    wind_fps : tuple
        Steady wind (north, east, down) of JSBSim's initial conditions.
    flight_wind_fps : tuple
        Steady wind of the flight, if JSBSim and not the air system applies it.
    """

    conditions: Mapping[str, float]
    settings: Mapping[str, float]
    static: Mapping[str, float]
    wind_fps: tuple[float, ...]
    flight_wind_fps: tuple[float, ...]


@dataclass(frozen=True)
class LaneMission:
    """A mission for any number of lanes.

    Attributes
    ----------
    mission : StagedMission
        Aircraft and script.
    flight : Flight
        Traced frames.
    inputs, varying : tuple of str
        Properties, and all slots, that may differ between lanes.
    stride : int
        Frames between rows.
    dt_s : float
        Step.
    air : bool
        Whether the aircraft has the air system.
    span_ft : float
        Wing span.
    points : tuple of ContactPoint
        Points that end a flight when they touch the ground.
    steady : bool
        Whether engines start in the steady state of their throttles.
    """

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

    def of_copy(self, mission: StagedMission) -> LaneMission:
        """Return the translation for a copy of the same files, with what was compiled already."""
        old, new = (str(one.aircraft.folder) for one in (self.mission, mission))
        left_out = tuple(text.replace(old, new) for text in self.flight.left_out)
        copy = replace(self, mission=mission, flight=replace(self.flight, left_out=left_out))
        # Cached properties are entries of the instance; none depends on the places of files.
        copy.__dict__.update(
            {
                name: value
                for name, value in self.__dict__.items()
                if isinstance(getattr(LaneMission, name, None), cached_property)
            }
        )
        return copy

    @property
    def between(self) -> tuple[Program, ...]:
        """The programs that run between the initialising frames and the flight."""
        if self.steady:
            return self.flight.settling
        return () if self.flight.resting is None else (self.flight.resting,)

    @cached_property
    def program(self) -> Program:
        """The optimised frame; computed when it is flown, because `refusals` does not need it."""
        flight = self.flight
        between = self.between
        # Fold what never changes after the initialising frames, then add the noise streams.
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
        """The program, compiled for this processor."""
        return compile_program(self.program, choose_target())

    @cached_property
    def initialisers(self) -> tuple[Interpreter, Interpreter]:
        """The two initialising frames."""
        # Without an air system, airspeed for the host's gusts comes from the ground speed.
        retained = [*self.inputs, *(() if self.air else GROUND_SPEED)]
        retained += [name for one in self.between for name in one.slots]
        first, second = specialise_startup(
            self.flight.first, self.flight.second, self.program, retained
        )
        return Interpreter(first), Interpreter(second)

    @cached_property
    def rester(self) -> Rester | None:
        """What brings the control system to rest; None if the mission does not start so."""
        resting = self.flight.resting
        if resting is None:
            return None
        propulsion = self.flight.propulsion
        readings = tuple(
            f"{engine.name}{reading}"
            for engine in propulsion.engines
            for reading in ("thrust-lbs", "propeller-rpm")
        )
        outputs = map(canonical, forced_state.control_outputs(self.mission.aircraft))
        watched = [name for name in (*outputs, *readings) if name in resting.slots]
        contents = [f"{tank.name}contents-lbs" for tank in propulsion.tanks]
        used = [f"{engine.name}fuel-used-lbs" for engine in propulsion.engines]
        fuel = [name for name in (*contents, *used) if name in resting.slots]
        turbines = [e.motor for e in propulsion.engines if isinstance(e.motor, Turbine)]
        flows = [f"#{motor.key}/pph" for motor in turbines]
        free = RATES_FREE in self.mission.script.run_properties
        rates = [f"#{name}" for name in state_slots("rates")] if free else []
        return Rester(
            compile_program(resting, choose_target()),
            tuple(watched),
            tuple(fuel),
            tuple(flows),
            tuple(rates),
        )

    @cached_property
    def starts(self) -> LRUCache[Any, Any]:
        """Starts that were computed (`course.initialise_lanes`), by what decides them."""
        return LRUCache(_MAX_STARTS)

    @cached_property
    def settlers(self) -> tuple[Settler, ...]:
        """Programs that settle engines, as `settlers_of` returns them."""
        return settlers_of(self.flight)

    @cached_property
    def renewer(self) -> Interpreter | None:
        """The frame after the steady state, in which time stands still; None without engines."""
        return (
            Interpreter(self.flight.renewed)
            if self.steady and self.flight.renewed is not None
            else None
        )


@dataclass(frozen=True)
class Rester:
    """How the control system is brought to rest, as by `simulator.forced_state.bring_to_rest`.

    Attributes
    ----------
    flyer : Flyer
        Frames with frozen motion.
    watched : tuple of str
        Slots that must come to rest.
    fuel : tuple of str
        Slots of the tanks' contents and of the fuel used, which stay.
    flows : tuple of str
        Slots of the turbines' fuel flow [lbs/h].
    rates : tuple of str
        Slots of body rates that the control system brings to rest; empty if they are held.
    """

    flyer: Flyer
    watched: tuple[str, ...]
    fuel: tuple[str, ...]
    flows: tuple[str, ...] = ()
    rates: tuple[str, ...] = ()


@dataclass(frozen=True)
class Settler:
    """How an engine reaches its steady state.

    Attributes
    ----------
    engine : Engine
        The engine.
    steps, balancing_steps : Program
        Steps of JSBSim's iteration, and of the flight.
    """

    engine: Engine
    steps: Program
    balancing_steps: Program

    @cached_property
    def steady(self) -> Flyer:
        """JSBSim's iteration, compiled."""
        return compile_program(self.steps, choose_target())

    @cached_property
    def balance(self) -> Flyer:
        """Steps of the flight, compiled when a propeller is out of balance."""
        return compile_program(self.balancing_steps, choose_target())


def settlers_of(flight: Flight) -> tuple[Settler, ...]:
    """Return how each engine reaches its steady state."""
    engines = flight.propulsion.engines
    return tuple(map(Settler, engines, flight.steady, flight.balancing))


def _refuse_running(mission: StagedMission) -> None:
    """Raise BadInputError, with file and line, if the initial conditions start engines."""
    start = mission.aircraft.folder / mission.script.initialize
    path = start if start.is_file() else start.with_name(f"{start.name}.xml")
    document = read_document(path)
    for node in document.root.walk():
        if node.tag == "running":
            raise BadInputError(
                f"{document.where(node)}: <running> in initial conditions is not supported by the"
                " batch engine"
            )


def make_mission(
    mission: StagedMission,
    spec: FlightSpec,
    inputs: Collection[str],
    records: Sequence[str],
    optional: Sequence[str] = (),
) -> LaneMission:
    """Translate a mission.

    Parameters
    ----------
    mission : StagedMission
        Aircraft and script.
    spec : FlightSpec
        Conditions of the flight and rate of the record.
    inputs : collection of str
        Properties that may differ between lanes.
    records, optional : sequence of str
        Properties that are recorded; optional ones only if they exist.

    Returns
    -------
    LaneMission

    Raises
    ------
    BadInputError
        With file and line, for what the batch engine does not support.
    """
    # Refuse early what cannot be flown at all.
    sources = read_sources(mission.aircraft, mission.script.path)
    _refuse_running(mission)
    free = RATES_FREE in mission.script.run_properties
    rest = free or RATES_HELD in mission.script.run_properties
    # Mass properties that a lane changes are set per lane later.
    unchanged = replace(
        spec, properties={n: v for n, v in spec.properties.items() if n not in CHANGEABLE}
    )

    def opened() -> Any:
        """Open JSBSim with the conditions of the flight, mass unchanged."""
        fdm = mission.open()
        set_conditions(fdm, mission, unchanged)
        return fdm

    fdm = opened()
    air = has_air_system(fdm)
    values = Values(initial_values(opened, fdm), is_constant)
    values.setdefault(OUT_OF_RANGE)
    # Streams that the host feeds: gusts, moving levels, transient levels.
    gusty = spec.turbulence != "none" and spec.turbulence_source == "spec"
    fed: list[Stream] = [GUSTS] if gusty else []
    fed += [LEVELS] if spec.levels is not None else []
    fed += [TRANSIENTS] if spec.transient is not None else []
    exists = fdm.get_property_manager().hasNode
    records = [*records, *(name for name in optional if exists(name))]
    points = tuple(contact_points(fdm, mission.aircraft))
    records = [*records, *((TOUCHED, POINT) if points else ())]
    names = dict.fromkeys(canonical(name) for name in inputs)
    if any(name.startswith("inertia/") for name in names):
        # A change of one of these may change the others.
        names |= dict.fromkeys(MASS)
    names |= dict.fromkeys(name for name in start_properties(sources) if exists(name))
    # Without an air system, the initialising frames have another wind.
    names |= dict.fromkeys(AIR_WIND if air else WIND)
    request = TraceRequest(
        tuple(names),
        fed,
        records,
        points,
        gusts_by_heading=gusty and not air,
        changes_dry_mass=True,
        rest=rest,
        rates_free=free,
    )
    flight = trace_flight(sources, mission.aircraft.dt_s, values, request)
    # Everything that differs between lanes must not be folded as a constant.
    varying = (
        *request.inputs,
        *(f"#{name}" for part in WEIGHTS_PARTS for name in state_slots(part)),
        *(name for name, _ in flight.draws),
    )
    varying = (*varying, *(DRY if set(request.inputs) & set(MASS) else ()))
    steady = MARK in mission.script.run_properties and flight.renewed is not None
    return LaneMission(
        mission,
        flight,
        tuple(request.inputs),
        varying,
        record_stride(spec, mission.aircraft.dt_s),
        mission.aircraft.dt_s,
        air,
        float(values["metrics/bw-ft"]),
        points,
        steady,
    )


def initial_values(open_fdm: Callable[[], Any], fdm: Any = None) -> Callable[[str], float | None]:
    """Return a function from a property to its value before initialising.

    Values come from ``fdm`` or a new instance; mass and metrics from one that was initialised. None
    for properties that do not exist.
    """
    fdm = open_fdm() if fdm is None else fdm
    initialised = open_fdm()
    engine.run_ic(initialised)
    exists = fdm.get_property_manager().hasNode
    exists_initialised = initialised.get_property_manager().hasNode

    def value(name: str) -> float | None:
        """Return the value of a property."""
        if name == "aero/qbar-area":
            # JSBSim reads uninitialised memory here; 0 is used instead.
            return 0.0
        if name.startswith(INITIALISED):
            name = name.removeprefix(INITIALISED)
            number = float(initialised[name]) if exists_initialised(name) else None
            return (
                round_44_bits(number) if number is not None and name.startswith(_ENGINE) else number
            )
        if name.startswith(_STATIC):
            return float(initialised[name]) if exists_initialised(name) else None
        if name.startswith(_ENGINE):
            # Running engines: numbers of the C library, which differ in the last place between
            # machines.
            return round_44_bits(float(fdm[name])) if exists(name) else None
        return float(fdm[name]) if exists(name) else None

    return value


def start_properties(sources: Sources) -> list[str]:
    """List JSBSim's initial conditions that the XML reads; they differ between lanes as starts
    do.
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


def load_start(mission: LaneMission, spec: FlightSpec) -> LoadedStart:
    """Let JSBSim load and set one start.

    Raises BadInputError for what cannot be set.
    """
    changed = {name: value for name, value in spec.properties.items() if name in CHANGEABLE}
    fdm = mission.mission.open(changed=changed)
    set_conditions(fdm, mission.mission, spec)
    settings = without_missing_switches(fdm, spec.properties)
    conditions = {name: float(fdm[name]) for name in CONDITIONS}
    wind = tuple(float(fdm[f"ic/vw-{axis}-fps"]) for axis in ("north", "east", "down"))
    static = {
        name: round_44_bits(float(fdm[name])) for name in mission.inputs if _START.fullmatch(name)
    }
    # Mass properties are set before initialising; JSBSim computes what depends on them.
    if changed:
        engine.run_ic(fdm)
        static |= {name: float(fdm[name]) for name in mission.inputs if name.startswith(_STATIC)}
        if mission.flight.propulsion.changes_mass and set(mission.inputs) & set(MASS):
            static |= mission.flight.propulsion.dry_aircraft(lambda name: float(fdm[name]))
    set_wind_without_air(fdm, spec)
    return LoadedStart(conditions, settings, static, wind, tuple(float(fdm[name]) for name in WIND))
