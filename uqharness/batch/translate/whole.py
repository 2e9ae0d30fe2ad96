"""A whole frame of a flight: JSBSim's models and the aircraft's XML in JSBSim's order of execution.

Clock and events, propagation, atmosphere, winds, systems, mass, auxiliary, propulsion,
aerodynamics, external reactions, accelerations. A flight is two frames in which time stands still
(JSBSim's initialisation), then frames of one step."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from uqharness.batch.form.program import Program, Stream
from uqharness.batch.models import winds
from uqharness.batch.models.atmosphere import trace_air_data, trace_atmosphere, trace_ratios
from uqharness.batch.models.auxiliary import trace_auxiliary, trace_ground, trace_start_distance
from uqharness.batch.models.motion import (
    INTEGRATORS,
    WEIGHTS,
    remember_derivatives,
    trace_accelerations,
    trace_propagate,
    trace_time,
)
from uqharness.batch.translate.aerodynamics import (
    functions_of,
    trace_aerodynamics,
    trace_external,
    trace_totals,
)
from uqharness.batch.translate.channels import (
    Sources,
    Systems,
    compute_where_read,
    refuse_inner_names,
)
from uqharness.batch.translate.engines import STEADY_STEP_S, Propulsion, read_propulsion
from uqharness.batch.translate.frame import HOOKS, REQUIRED, Frame, Values, settable
from uqharness.batch.translate.script import trace_events
from uqharness.batch.translate.tanks import MASS
from uqharness.errors import BadInputError
from uqharness.flight import ContactPoint

_HOOKS = {**winds.WRITES, **HOOKS}
_RENEWED = 3


@dataclass(frozen=True)
class Flight:
    """A flight as programs: ``first`` and ``second`` are the initialising frames, ``frame`` is
    every frame of the flight.

    ``draws`` are the places of the flight's frame in which noise is drawn, in their order: slot and
    execution rate; ``first_draws`` how many each initialising frame draws.

    ``steady`` are turns of each engine's way to its steady state, flown while their slot ``going``
    is not 0; ``renewed`` is a frame in which time stands still, behind them; None where there are
    no engines and nobody asked for it."""

    first: Program
    second: Program
    frame: Program
    draws: tuple[tuple[str, int], ...]
    first_draws: int
    propulsion: Propulsion
    steady: tuple[Program, ...] = ()
    renewed: Program | None = None


@dataclass(frozen=True)
class _Models:
    """What a frame is traced from; ``methods`` are the integrators of the parts of the motion."""

    sources: Sources
    systems: Systems
    propulsion: Propulsion
    methods: dict[str, int]
    asked: Asked


@dataclass(frozen=True)
class Asked:
    """What a flight is to have beside the aircraft's own.

    inputs   properties that differ between lanes; one that the aircraft writes differs in its value
    before the first frame alone
    fed      streams, whose columns are properties that the host sets before each frame records
    what is recorded behind a frame points   where the aircraft touches the ground any_step  the
    step is a number of the lane, in slot STEP; else it is that of the aircraft reweighed whoever
    changes the mass in a lane changes that of the aircraft without fuel as well
    (propulsion.mass.DRY) started  the host starts the engines, as ``propulsion/set-running`` does
    renewed  a frame behind the initialising ones in which time stands still is asked for, engines
    or none turned   the host's gusts reach the air through JSBSim's own properties, by the heading
    of the frame before"""

    inputs: Collection[str]
    fed: Sequence[Stream]
    records: Collection[str]
    points: Sequence[ContactPoint] = ()
    turned: bool = False
    any_step: bool = False
    reweighed: bool = False
    started: bool = False
    renewed: bool = False


def trace_flight(sources: Sources, dt_s: float, values: Values, asked: Asked) -> Flight:
    """The programs of a flight. Raises BadInputError with file and line for what is not
    understood.
    """
    methods = {part: _integrator(values, name) for part, name in INTEGRATORS.items()}
    _require(values, asked.inputs)
    propulsion = read_propulsion(sources, values, asked.started)
    fed = {name for stream in asked.fed for name in stream.columns}
    if propulsion.tanks and not asked.reweighed and set(asked.inputs) & set(MASS):
        raise BadInputError("the mass of an aircraft with tanks cannot differ between lanes here")
    models = _Models(
        sources, Systems(sources.systems, dt_s, len(propulsion.engines)), propulsion, methods, asked
    )
    every = Frame(dt_s, values, None, any_step=asked.any_step)
    _trace(every, models, 0)
    written = every.writes | fed
    inputs = set(asked.inputs) - written
    frames = [Frame(step, values, written, inputs, asked.any_step) for step in (0.0, 0.0, dt_s)]
    for frame, phase in zip(frames, (1, 2, 0), strict=True):
        _trace(frame, models, phase)
    for name in asked.records:
        if not name.startswith("#") and frames[2].read(name) is None:
            raise BadInputError(
                f"property {name} is not computed by the batch engine, so it cannot be recorded"
            )
    first, second, flight = frames
    streams = [
        *asked.fed,
        *([winds.NORMALS] if any(s.when.mask == winds.MASK for s in flight.sections) else []),
    ]
    return Flight(
        first.program(()),
        second.program(()),
        flight.program(asked.records, streams),
        tuple(flight.draws),
        len(first.draws),
        propulsion,
        *_settling(models, values, written, inputs),
    )


def _settling(
    models: _Models, values: Values, written: Collection[str], inputs: Collection[str]
) -> tuple[tuple[Program, ...], Program | None]:
    """The way to each engine's steady state, and the frame behind it."""
    if not models.propulsion.engines and not models.asked.renewed:
        return (), None
    ways = []
    for engine in models.propulsion.engines:
        frame = Frame(STEADY_STEP_S, values, written, inputs)
        models.propulsion.trace_steady(frame, engine)
        ways.append(frame.program(()))
    renewed = Frame(0.0, values, written, inputs, models.asked.any_step)
    _trace(renewed, models, _RENEWED)
    return tuple(ways), renewed.program(())


def _require(values: Values, inputs: Collection[str]) -> None:
    """Refuse settings that JSBSim obeys and the batch engine does not have."""
    for name, wanted in REQUIRED.items():
        if values.get(name, wanted) != wanted:
            raise BadInputError(f"{name} = {values[name]:g}: the batch engine has {wanted:g} alone")
    for name in inputs:
        if not settable(name):
            raise BadInputError(
                f"property {name} cannot be set in the batch engine: JSBSim does more with it than"
                " keep its value"
            )


def _integrator(values: Values, name: str) -> int:
    number = int(values[name])
    if number not in WEIGHTS:
        raise BadInputError(
            f"{name} = {number}: the batch engine has JSBSim's integrators"
            f" {', '.join(map(str, WEIGHTS))}"
        )
    return number


def _trace(frame: Frame, models: _Models, phase: int) -> None:
    """One frame; ``phase`` is 1 or 2 in an initialising frame, _RENEWED in one behind them, 0 in
    flight.
    """
    sources, propulsion, asked = models.sources, models.propulsion, models.asked
    frame.hooks.update(_HOOKS)
    frame.live["simulation/dt"] = lambda: frame.step
    for part in (sources.aerodynamics, sources.external):
        if part is not None:
            refuse_inner_names(frame, *part)
            for function in functions_of(part[1]) if phase == 1 else ():
                compute_where_read(frame, part[0], function)
    propulsion.prepare(frame, phase == 1)
    with frame.section("time"):
        trace_time(frame)
    if asked.turned and phase == 0:
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
        trace_ground(frame, asked.points)
    with frame.section("accelerations"):
        trace_totals(
            frame, ("aero", "prop", "external") if propulsion.engines else ("aero", "external")
        )
        if phase == 2:
            remember_derivatives(frame)
        trace_accelerations(frame)
