"""Trace a complete frame: JSBSim's models and the aircraft's XML in JSBSim's order of execution.

Clock and events, propagation, atmosphere, winds, systems, mass, auxiliary, propulsion,
aerodynamics, external reactions, accelerations. A flight consists of two frames in which time
stands still (JSBSim's initialisation), then frames of one step.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

from uqharness.batch import winds
from uqharness.batch.atmosphere import trace_air_data, trace_atmosphere, trace_ratios
from uqharness.batch.auxiliary import trace_auxiliary, trace_ground, trace_start_distance
from uqharness.batch.ir import Value
from uqharness.batch.motion import (
    INTEGRATORS,
    WEIGHTS,
    remember_derivatives,
    trace_accelerations,
    trace_propagate,
    trace_time,
)
from uqharness.batch.program import Program, Stream
from uqharness.batch.translate.aerodynamics import (
    functions_of,
    shift_function,
    trace_aerodynamics,
    trace_external,
    trace_totals,
)
from uqharness.batch.translate.channels import (
    Sources,
    Systems,
    compute_inner_names,
    compute_where_read,
)
from uqharness.batch.translate.engines import STEADY_STEP_S, Propulsion, read_propulsion
from uqharness.batch.translate.frame import (
    HOOKS,
    REQUIRED,
    Frame,
    LeftOut,
    Values,
    canonical,
    function_name,
    settable,
)
from uqharness.batch.translate.script import trace_events
from uqharness.batch.translate.tanks import MASS
from uqharness.errors import BadInputError
from uqharness.flight import ContactPoint
from uqharness.xml import Document, Node

_HOOKS = {**winds.WRITES, **HOOKS}
_RENEWAL, _REST = 3, 4


@dataclass(frozen=True)
class Flight:
    """A flight as programs.

    Attributes
    ----------
    first, second : Program
        The initialising frames.
    frame : Program
        Every frame of the flight.
    draws : tuple of (str, int)
        Slots in which the frame draws noise, in order, and their execution rates.
    first_draws : int
        Number of draws of each initialising frame.
    propulsion : Propulsion
        Engines and tanks.
    steady : tuple of Program
        One per engine: steps to its steady state, flown while its settling slot is not 0.
    renewed : Program or None
        A frame in which time stands still, after the engines are steady; None without engines,
        unless requested.
    balancing : tuple of Program
        One per engine: steps of the flight until its propeller is in balance, flown where JSBSim's
        steps leave it out of balance.
    resting : Program or None
        A frame with frozen motion, which brings the control system to rest; None unless requested.
    left_out : tuple of str
        Reasons for which elements were left out, because nothing in the flight reads them.
    """

    first: Program
    second: Program
    frame: Program
    draws: tuple[tuple[str, int], ...]
    first_draws: int
    propulsion: Propulsion
    steady: tuple[Program, ...] = ()
    renewed: Program | None = None
    balancing: tuple[Program, ...] = ()
    resting: Program | None = None
    left_out: tuple[str, ...] = ()

    @property
    def settling(self) -> tuple[Program, ...]:
        """All programs between the initialising frames and the flight."""
        frames = [program for program in (self.renewed, self.resting) if program is not None]
        return (*self.steady, *self.balancing, *frames)


@dataclass(frozen=True)
class FrameModels:
    """What a frame is traced from; ``methods`` are the integrators of the parts of the motion."""

    sources: Sources
    systems: Systems
    propulsion: Propulsion
    methods: dict[str, int]
    request: TraceRequest


@dataclass(frozen=True)
class TraceRequest:
    """What a flight needs besides the aircraft.

    Attributes
    ----------
    inputs : collection of str
        Properties that differ between lanes; if the aircraft writes one, only its initial value
        differs.
    streams : sequence of Stream
        Their columns are properties that the host sets before each frame.
    records : collection of str
        Properties that are recorded after a frame.
    points : sequence of ContactPoint
        Where the aircraft touches the ground.
    gusts_by_heading : bool
        Host gusts enter through JSBSim's properties, by the heading of the frame before.
    any_step : bool
        The step is a number of the lane, in slot STEP.
    changes_dry_mass : bool
        Lanes that change the mass also change that of the aircraft without fuel (`tanks.DRY`).
    engines_running : bool
        The host starts the engines, as ``propulsion/set-running`` does.
    renewal : bool
        A frame after the initialising ones in which time stands still is needed, with or without
        engines.
    rest : bool
        The flight starts with the control system at rest.
    rates_free : bool
        The control system brings the body rates to rest as well.
    """

    inputs: Collection[str]
    streams: Sequence[Stream]
    records: Collection[str]
    points: Sequence[ContactPoint] = ()
    gusts_by_heading: bool = False
    any_step: bool = False
    changes_dry_mass: bool = False
    engines_running: bool = False
    renewal: bool = False
    rest: bool = False
    rates_free: bool = False


def trace_flight(sources: Sources, dt_s: float, values: Values, request: TraceRequest) -> Flight:
    """Trace the programs of a flight.

    Parameters
    ----------
    sources : Sources
        XML of aircraft and script.
    dt_s : float
        Step.
    values : Values
        Values of properties before the first frame.
    request : TraceRequest
        What differs between lanes, what is fed, what is recorded.

    Returns
    -------
    Flight

    Raises
    ------
    BadInputError
        With file and line, for what the engine does not support.
    """
    methods = {part: _integrator(values, name) for part, name in INTEGRATORS.items()}
    _check_settings(values, request.inputs)
    propulsion = read_propulsion(sources, values, request.engines_running)
    stream_slots = {name for stream in request.streams for name in stream.columns}
    # The dry mass would no longer fit the total.
    if propulsion.changes_mass and not request.changes_dry_mass and set(request.inputs) & set(MASS):
        raise BadInputError("a mass that changes in flight cannot differ between lanes here")
    models = FrameModels(
        sources,
        Systems(sources.systems, dt_s, len(propulsion.engines)),
        propulsion,
        methods,
        request,
    )
    # What is not supported is left out where nothing reads it. Each round finds what reads a
    # property of the elements that earlier rounds left out.
    left_out = LeftOut()
    for part in (sources.ground, sources.mass):
        _leave_functions_out(left_out, part)
    while True:
        left_out.has_grown = False
        # A first pass finds all written properties; the frames themselves follow.
        survey = Frame(dt_s, values, None, any_step=request.any_step, left_out=left_out)
        _trace(survey, models, 0)
        written_properties = survey.writes | stream_slots
        inputs = set(request.inputs) - written_properties
        requested = survey.reads | {canonical(name) for name in request.records}
        frames = [
            Frame(step, values, written_properties, inputs, request.any_step, left_out, requested)
            for step in (0.0, 0.0, dt_s)
        ]
        for frame, phase in zip(frames, (1, 2, 0), strict=True):
            _trace(frame, models, phase)
        if not left_out.has_grown:
            break
    # Records that nothing computes are refused after tracing.
    for name in request.records:
        if canonical(name) in frames[2].live:
            raise BadInputError(
                f"property {name} is computed only where it is read, so it cannot be recorded"
            )
        if not name.startswith("#") and frames[2].read(name) is None:
            raise BadInputError(
                f"property {name} is not computed by the batch engine, so it cannot be recorded"
            )
    first, second, flight = frames
    # JSBSim's turbulence needs normals only if its section exists.
    streams = [
        *request.streams,
        *([winds.NORMALS] if any(s.when.mask == winds.MASK for s in flight.sections) else []),
    ]
    return Flight(
        first.program(()),
        second.program(()),
        flight.program(request.records, streams),
        tuple(flight.draws),
        len(first.draws),
        propulsion,
        *_trace_settling(models, frames[2], inputs),
        _trace_rest(models, frames[2], inputs) if request.rest else None,
        tuple(left_out.nodes.values()),
    )


def _leave_functions_out(left_out: LeftOut, part: tuple[Document, Node] | None) -> None:
    """Leave out functions of ground contact and mass, which nothing here computes."""
    if part is None:
        return
    document, root = part
    for node in root.walk():
        name = node.attributes.get("name", "")
        if node.tag in ("function", "table") and name:
            left_out.add(
                node,
                [canonical(function_name(name))],
                f"{document.where(node)}: <{node.tag}> of <{root.tag}> is not supported by the"
                " batch engine",
            )


def _trace_settling(
    models: FrameModels, flight: Frame, inputs: Collection[str]
) -> tuple[tuple[Program, ...], Program | None, tuple[Program, ...]]:
    """Trace the steps to each engine's steady state, the frame after them, and the steps that
    balance a propeller.
    """
    if not models.propulsion.engines and not models.request.renewal:
        return (), None, ()
    settling: list[Program] = []
    balancing: list[Program] = []
    for engine in models.propulsion.engines:
        for steps, step in ((settling, STEADY_STEP_S), (balancing, flight.dt_s)):
            frame = _similar(flight, step, inputs)
            models.propulsion.trace_steady(frame, engine, steps is balancing)
            steps.append(frame.program(()))
    # JSBSim runs one frame without time after the steady state.
    renewed = _similar(flight, 0.0, inputs, models.request.any_step)
    _trace(renewed, models, _RENEWAL)
    return tuple(settling), renewed.program(()), tuple(balancing)


def _trace_rest(models: FrameModels, flight: Frame, inputs: Collection[str]) -> Program:
    """Trace the frame of `simulator.forced_state.run_frozen`: integrators move free rates alone."""
    if flight.draws or any(section.when.mask == winds.MASK for section in flight.sections):
        raise BadInputError(
            "frames of JSBSim bring the control system to rest before the flight begins, and draw"
            ' random numbers; use engine = "jsbsim"'
        )
    resting = _similar(flight, flight.dt_s, inputs)
    methods = dict.fromkeys(models.methods, 0)
    if models.request.rates_free:
        methods["rates"] = models.methods["rates"]
    _trace(resting, replace(models, methods=methods), _REST)
    return resting.program(())


def _similar(flight: Frame, step: float, inputs: Collection[str], any_step: bool = False) -> Frame:
    """Return a frame of another step with the properties of the flight's."""
    return Frame(
        step,
        flight.values,
        flight.written_properties,
        inputs,
        any_step,
        flight.left_out,
        flight.requested,
    )


def _check_settings(values: Values, inputs: Collection[str]) -> None:
    """Refuse settings that JSBSim obeys and the engine does not support."""
    for name, required in REQUIRED.items():
        if values.get(name, required) != required:
            raise BadInputError(
                f"{name} = {values[name]:g}: the batch engine has {required:g} alone"
            )
    for name in inputs:
        if not settable(name):
            raise BadInputError(
                f"property {name} cannot be set in the batch engine: JSBSim does more with it than"
                " keep its value"
            )


def _integrator(values: Values, name: str) -> int:
    """Return the number of an integrator; refuse unknown ones."""
    number = int(values[name])
    if number not in WEIGHTS:
        raise BadInputError(
            f"{name} = {number}: the batch engine has JSBSim's integrators"
            f" {', '.join(map(str, WEIGHTS))}"
        )
    return number


def _integrator_hook(name: str, number: float) -> Callable[[Frame, Value], None]:
    """Return the hook of an integrator's number: systems that detect a crash change it, which ends
    the flight here.
    """

    def write(frame: Frame, value: Value) -> None:
        """Note another number."""
        frame.note_beyond(value.ne(number))
        frame.store(name, number)

    return write


def _trace(frame: Frame, models: FrameModels, phase: int) -> None:
    """Trace one frame; ``phase`` is 1 or 2 in the initialising frames, _RENEWAL or _REST in one
    after them, 0 in flight.
    """
    sources, propulsion, request = models.sources, models.propulsion, models.request
    frame.hooks.update(_HOOKS)
    frame.authored, frame.trimming = propulsion.authored, phase == _REST
    for name in INTEGRATORS.values():
        frame.hooks[name] = _integrator_hook(name, float(frame.values[name]))
    frame.live["simulation/dt"] = lambda: frame.step
    # Before its first run a function is evaluated where it is read.
    for part in (sources.aerodynamics, sources.external):
        if part is not None:
            compute_inner_names(frame, *part)
            shift = shift_function(part[1])
            uncached = [] if shift is None else [shift]
            for function in functions_of(part[1]) if phase == 1 else uncached:
                compute_where_read(frame, part[0], function)
    propulsion.prepare(frame, phase == 1)
    # From here on in JSBSim's order of execution.
    # Events of a script must not see time advance while the control system comes to rest.
    if phase != _REST:
        with frame.section("time"):
            trace_time(frame)
    if request.gusts_by_heading and phase == 0:
        with frame.section("gusts of the host"):
            winds.turn_gusts(frame)
    trace_events(frame, sources.script)
    with frame.section("propagation"):
        trace_propagate(frame, models.methods)
    with frame.section("atmosphere"):
        trace_atmosphere(frame)
        trace_ratios(frame)
    winds.trace_winds(frame)
    models.systems.trace(frame, first=phase == 1)
    propulsion.trace_mass(frame, phase == 1)
    with frame.section("auxiliary"):
        trace_auxiliary(frame)
        trace_air_data(frame)
        trace_start_distance(frame)
    propulsion.trace(frame)
    parts = [sources.document, None] if sources.aerodynamics is None else [*sources.aerodynamics]
    trace_aerodynamics(frame, parts[0], parts[1])  # type: ignore[arg-type]
    parts = [sources.document, None] if sources.external is None else [*sources.external]
    trace_external(frame, parts[0], parts[1])  # type: ignore[arg-type]
    with frame.section("ground"):
        trace_ground(frame, request.points)
    with frame.section("accelerations"):
        trace_totals(
            frame, ("aero", "prop", "external") if propulsion.engines else ("aero", "external")
        )
        # The histories of the integrators start with these derivatives.
        if phase == 2:
            remember_derivatives(frame)
        trace_accelerations(frame)
