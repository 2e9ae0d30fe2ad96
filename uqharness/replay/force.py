"""The model's forces and moments at measured states.

Each state is imposed on JSBSim and the forces are read, by JSBSim itself or, for many states at
once, by a compiled program of the batch engine. Residual coefficients, equation error and start
values are made from them.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from cachetools import LRUCache, cached
from numpy.typing import NDArray

from sysid.aerodynamics.coefficients import MassProperties
from sysid.arrays import FloatArray
from sysid.parallel import SERIAL, Processes
from sysid.units import FT_M, LBF_FT_NM, LBF_N, PSF_PA
from uqharness import batch
from uqharness.batch import StateProgram
from uqharness.errors import BadInputError
from uqharness.replay.in_lanes import level_of, open_with_engines, sources_of
from uqharness.replay.model import ReplayModel, control_setters, terrain_m
from uqharness.replay.segments import Segment
from uqharness.simulator import (
    MAX_FRAMES,
    SETTLED_RADPS,
    STATIONARY_SHARE,
    TRIM_LATITUDE_DEG,
    body_velocity,
    engine,
    mass_properties,
)

# Forces at measured states by the batch engine, for many states of an aircraft that it understands.
# Some states of each program are evaluated by JSBSim as well, and JSBSim evaluates all if the two
# differ. Earlier requests do not decide which engine is used, so a resumed run is bit-identical.

_LOG = logging.getLogger("uqharness")
_T = TypeVar("_T")
MIN_BATCH_STATES = 2_000
"""Number of states from which the aircraft is compiled. Compiling takes as long as 12,000 states by
JSBSim, but callers that evaluate a whole flight do so several times; trims and start states are
fewer."""
MIN_BATCH_STATES_ENGINES = 250
"""The same with engines in <propulsion>, which JSBSim settles in up to 10 ms a state."""
TOLERANCE = 1e-6
"""Largest difference of a force or moment between the engines, relative to its largest size among
the states compared."""
SLOPE_TOLERANCE = 1e-3
"""Largest difference of a load's slope with a property, relative to its largest size."""
_COMPARED_STATES, _MAX_PROGRAMS, _LEVEL_M = 9, 8, 1000.0


@dataclass(frozen=True)
class States:
    """Flight states of n samples, ready to be imposed.

    Attributes
    ----------
    motion : Mapping
        Names of `replay.STATES` without the heading to (n,) values.
    controls : ndarray
        (n, c) in the units of their properties.
    altitude_m, terrain_m : ndarray
        (n,) altitude of the aircraft and of the ground, above sea level [m].
    """

    motion: Mapping[str, FloatArray]
    controls: FloatArray
    altitude_m: FloatArray
    terrain_m: FloatArray

    def subset(self, rows: NDArray[Any]) -> States:
        """Select rows."""
        motion = {name: np.asarray(value)[rows] for name, value in self.motion.items()}
        return States(motion, self.controls[rows], self.altitude_m[rows], self.terrain_m[rows])

    @staticmethod
    def of(parts: Sequence[States]) -> States:
        """Concatenate several sets of states."""
        if len(parts) == 1:
            return parts[0]
        motion = {
            name: np.concatenate([np.asarray(p.motion[name], dtype=float) for p in parts])
            for name in parts[0].motion
        }
        controls, altitude, terrain = (
            [getattr(p, name) for p in parts] for name in ("controls", "altitude_m", "terrain_m")
        )
        return States(
            motion, np.concatenate(controls), np.concatenate(altitude), np.concatenate(terrain)
        )


@dataclass
class _CachedProgram:
    """A compiled program: None before the first large request, and ``refused`` where JSBSim has to
    answer. ``slopes`` has for each property whether its slopes agree with JSBSim's.
    """

    program: StateProgram | None = None
    refused: bool = False
    slopes: dict[str, bool] = field(default_factory=dict)


_cached_programs: LRUCache[str, _CachedProgram] = LRUCache(_MAX_PROGRAMS)


def by_batch(
    model: ReplayModel,
    states: States,
    dt_s: float,
    properties: Mapping[str, float],
    records: Sequence[str],
    by_jsbsim: Callable[[States], FloatArray],
) -> FloatArray | None:
    """Return the recorded properties at the states, (n, len(records)); None where JSBSim has to
    answer.

    ``by_jsbsim`` evaluates some of the states for comparison.
    """
    entry = _cached_programs.setdefault(model.identity, _CachedProgram())
    # A refusal is final for this model.
    minimum = MIN_BATCH_STATES_ENGINES if model.throttles else MIN_BATCH_STATES
    if entry.refused or len(states.controls) < minimum:
        return None
    # Recompile with the union of the properties, so that alternating sets do not recompile each
    # time.
    names = {*properties, *(entry.program.properties if entry.program is not None else ())}
    if entry.program is None or not names <= set(entry.program.properties):
        entry.program = _verified(
            model, states, dt_s, properties, by_jsbsim, _compile(model, dt_s, names, records)
        )
        entry.refused = entry.program is None
    if entry.program is None:
        return None
    out = _evaluate(entry.program, model, states, dt_s, properties)
    # JSBSim evaluates states in which an engine stops.
    stopped = np.asarray(np.isnan(out).any(axis=1))
    if stopped.any():
        out[stopped] = by_jsbsim(states.subset(stopped))
    return out


def _compile(
    model: ReplayModel, dt_s: float, names: set[str], records: Sequence[str]
) -> StateProgram | None:
    """Translate and compile the aircraft; None where the engine cannot."""
    if batch.available() is not None:
        return None
    controls, _ = model.control_properties()
    inputs = sorted(names | set(model.varied))
    try:
        return batch.make_states(
            sources_of(model),
            lambda: open_with_engines(model, dt_s),
            dt_s,
            controls,
            inputs,
            records,
            model.by_rates,
        )
    except BadInputError as error:
        _LOG.info("forces are evaluated by JSBSim, which is slower: %s", error)
        return None


def _verified(
    model: ReplayModel,
    states: States,
    dt_s: float,
    properties: Mapping[str, float],
    by_jsbsim: Callable[[States], FloatArray],
    program: StateProgram | None,
) -> StateProgram | None:
    """Return the program if it agrees with JSBSim at some of the states, None otherwise."""
    if program is None:
        return None
    # Compare states that are spread over the whole request.
    subset = states.subset(
        np.unique(np.linspace(0, len(states.controls) - 1, _COMPARED_STATES).astype(int))
    )
    from_batch, from_jsbsim = _evaluate(program, model, subset, dt_s, properties), by_jsbsim(subset)
    difference = float(
        np.nanmax(
            np.abs(from_batch - from_jsbsim) / np.maximum(np.abs(from_jsbsim).max(axis=0), 1e-3),
            initial=0.0,
        )
    )
    if difference <= TOLERANCE:
        return program
    _LOG.warning(
        "forces are evaluated by JSBSim, which is slower: the batch engine differs by %.1g of a"
        " force's size",
        difference,
    )
    return None


def _evaluate(
    program: StateProgram,
    model: ReplayModel,
    states: States,
    dt_s: float,
    properties: Mapping[str, float],
    steps: Mapping[str, float] | None = None,
) -> FloatArray:
    """Evaluate a compiled program at the states; with ``steps``, its slopes with properties."""
    V, alpha, beta = (
        np.asarray(states.motion[name], dtype=float) for name in ("V_mps", "alpha_rad", "beta_rad")
    )
    n = len(V)
    # At one latitude geodetic height is linear in height above sea level, to 1e-9 below 3 km.
    (latitude, at_sea), (_, at_top) = (level_of(model, level) for level in (0.0, _LEVEL_M))
    height = at_sea + (at_top - at_sea) / _LEVEL_M * states.altitude_m
    conditions = {
        "ic/lat-geod-rad": np.full(n, latitude),
        "ic/long-gc-rad": np.zeros(n),
        "ic/geod-alt-ft": height,
        "ic/phi-rad": states.motion["phi_rad"],
        "ic/theta-rad": states.motion["theta_rad"],
        "ic/psi-true-rad": np.zeros(n),
        "ic/u-fps": V * np.cos(alpha) * np.cos(beta) / FT_M,
        "ic/v-fps": V * np.sin(beta) / FT_M,
        "ic/w-fps": V * np.sin(alpha) * np.cos(beta) / FT_M,
        "ic/p-rad_sec": states.motion["p_radps"],
        "ic/q-rad_sec": states.motion["q_radps"],
        "ic/r-rad_sec": states.motion["r_radps"],
    }
    # One column a property: the throttle of several engines is repeated.
    _, places = model.control_properties()
    inputs = batch.StateInputs(
        conditions, states.terrain_m / FT_M, dt_s, states.controls[:, places], properties
    )
    if steps is None:
        return batch.at_states(program, inputs)
    return batch.slopes_at_states(program, inputs, steps)


_FORCES = tuple(f"forces/fb{a}-{kind}-lbs" for kind in ("total", "aero") for a in "xyz")
_MOMENTS = tuple(f"moments/{a}-{kind}-lbsft" for kind in ("total", "aero") for a in "lmn")
_RECORDS = (*_FORCES, *_MOMENTS, "aero/qbar-psf")
_MAX_MASSES = 8


@dataclass(frozen=True)
class ForcedModel:
    """Forces and moments of the model at n states, body axes at the centre of gravity.

    Attributes
    ----------
    aero_force, aero_moment : ndarray
        (n, 3) aerodynamic force [N] and moment about the CG [N m].
    other_force, other_moment : ndarray
        (n, 3) everything but aerodynamics and gravity, thrust above all.
    qbar : ndarray
        (n,) dynamic pressure [Pa].
    mass : MassProperties
        Mass, inertia and reference lengths.
    """

    aero_force: FloatArray
    other_force: FloatArray
    aero_moment: FloatArray
    other_moment: FloatArray
    qbar: FloatArray
    mass: MassProperties

    @property
    def coefficients(self) -> FloatArray:
        """Return CX CY CZ Cl Cm Cn of the model (n, 6), body axes at the centre of gravity."""
        pressure = self.qbar[:, None] * self.mass.S
        return np.hstack(
            [self.aero_force / pressure, self.aero_moment / (pressure * self.mass.lengths)]
        )


@dataclass(frozen=True)
class SegmentStates:
    """States of one segment to be imposed.

    Attributes
    ----------
    segment : Segment
        Where they belong.
    states : Mapping
        V, alpha, beta, phi, theta, p, q, r by channel name, (n,) each.
    controls : ndarray
        (n, c) in the record's units.
    altitude_m : ndarray, optional
        (n,) above sea level [m]; by default the segment's throughout.
    """

    segment: Segment
    states: Mapping[str, FloatArray]
    controls: FloatArray
    altitude_m: FloatArray | None = None

    def to_states(self, model: ReplayModel) -> States:
        """Convert controls to their properties' units, over ground that lies below all states."""
        n = len(self.controls)
        height = np.full(n, self.segment.altitude_m) if self.altitude_m is None else self.altitude_m
        # A state below the ground would meet ground reactions.
        terrain = min(terrain_m(model, self.segment), float(height.min()))
        return States(self.states, model.to_property(self.controls), height, np.full(n, terrain))


def force_states(
    model: ReplayModel,
    segment: Segment,
    states: Mapping[str, FloatArray],
    controls: FloatArray,
    properties: Mapping[str, float],
    altitude_m: FloatArray | None = None,
) -> ForcedModel:
    """Evaluate the states of one segment; see `force_all`."""
    return force_all(model, [SegmentStates(segment, states, controls, altitude_m)], properties)[0]


def force_all(
    model: ReplayModel,
    parts: Sequence[SegmentStates],
    properties: Mapping[str, float],
    pool: Processes = SERIAL,
) -> list[ForcedModel]:
    """Evaluate several sets of states; those of one time step are evaluated together.

    Parameters
    ----------
    model : ReplayModel
        Must pass its controls through (`ReplayFolder` with every control ideal): a lag would depend
        on the state before.
    parts : sequence of SegmentStates
        Sets of states.
    properties : Mapping
        JSBSim properties in force.
    pool : callable
        A `map` that distributes the sets where JSBSim evaluates them.

    Returns
    -------
    list of ForcedModel
        One a set.

    Raises
    ------
    BadInputError
        For a property that the model does not have.
    """
    return _by_step(
        model, parts, lambda sets, dt_s: _force_step(model, sets, dt_s, properties, pool)
    )


def _by_step(
    model: ReplayModel,
    parts: Sequence[SegmentStates],
    evaluate: Callable[[list[States], float], list[_T]],
) -> list[_T]:
    """Evaluate the sets of each time step together; return the result of each set."""
    out: dict[int, _T] = {}
    # Time steps of segments of one record differ by rounding only.
    steps = [round(part.segment.dt_s, 9) for part in parts]
    for dt_s in dict.fromkeys(steps):
        places = [k for k, step in enumerate(steps) if step == dt_s]
        out |= zip(places, evaluate([parts[k].to_states(model) for k in places], dt_s), strict=True)
    return [out[k] for k in range(len(parts))]


def _force_step(
    model: ReplayModel,
    state_sets: Sequence[States],
    dt_s: float,
    properties: Mapping[str, float],
    pool: Processes,
) -> list[ForcedModel]:
    """Evaluate sets of states of one time step together, and split the result."""

    def by_jsbsim(subset: States) -> FloatArray:
        return _by_jsbsim((model, dt_s, properties, subset))

    raw = by_batch(model, States.of(state_sets), dt_s, properties, _RECORDS, by_jsbsim)
    # Each set has a separate instance, so sets can be evaluated in parallel.
    if raw is None:
        raw = np.concatenate(
            list(pool(_by_jsbsim, [(model, dt_s, properties, states) for states in state_sets]))
        )
    mass = _mass_of(model, dt_s, properties)
    edges = np.cumsum([0, *(len(part.controls) for part in state_sets)])
    return [_forced_model(raw[a:b], mass) for a, b in pairwise(edges.tolist())]


def _by_jsbsim(job: tuple[ReplayModel, float, Mapping[str, float], States]) -> FloatArray:
    """Evaluate one job in JSBSim; a function of one argument, for pools."""
    model, dt_s, properties, states = job
    return _force_in_jsbsim(_open(model, dt_s, properties), model, states)


def _forced_model(raw: FloatArray, mass: MassProperties) -> ForcedModel:
    """Convert recorded properties to SI units; other forces are total minus aerodynamic ones."""
    total, aero = raw[:, 0:3] * LBF_N, raw[:, 3:6] * LBF_N
    total_moment, aero_moment = raw[:, 6:9] * LBF_FT_NM, raw[:, 9:12] * LBF_FT_NM
    return ForcedModel(
        aero, total - aero, aero_moment, total_moment - aero_moment, raw[:, 12] * PSF_PA, mass
    )


def _open(model: ReplayModel, dt_s: float, properties: Mapping[str, float]) -> Any:
    """Open an instance of the model with properties set."""
    fdm = model.open(dt_s)
    for name, value in properties.items():
        engine.set_property(fdm, name, value)
    return fdm


@cached(
    LRUCache(_MAX_MASSES),
    key=lambda model, dt_s, properties: (model.identity, *sorted(properties.items())),
)
def _mass_of(model: ReplayModel, dt_s: float, properties: Mapping[str, float]) -> MassProperties:
    """Return the mass properties of a model."""
    fdm = _open(model, dt_s, properties)
    engine.run_ic(fdm)
    return mass_properties(fdm, model.card.reference)


def _force_in_jsbsim(fdm: Any, model: ReplayModel, states: States) -> FloatArray:
    """Impose n states one after the other; return the recorded properties (n, len(_RECORDS))."""
    get = [engine.handle(fdm, name).get_double_value for name in _RECORDS]
    rates = [
        engine.handle(fdm, f"aero/{name}dot-rad_sec").get_double_value for name in ("alpha", "beta")
    ]
    raw = np.empty((len(states.controls), len(get)))
    for k in _imposed(fdm, model, states):
        if model.by_rates:
            _settle_rates(fdm, *rates)
        raw[k] = [g() for g in get]
    return raw


def _imposed(fdm: Any, model: ReplayModel, states: States) -> Iterator[int]:
    """Impose n states one after the other, engines settled; yield the number of each."""
    engines = fdm.get_propulsion().get_num_engines()
    if engines:
        engine.start_engines(fdm)
    # Handles are looked up once; each state sets values only.
    setters = control_setters(fdm, model)
    fdm["ic/lat-geod-deg"] = TRIM_LATITUDE_DEG
    terrain = engine.handle(fdm, "ic/terrain-elevation-ft").set_double_value
    names = (
        "h-sl-ft",
        "phi-rad",
        "theta-rad",
        "psi-true-rad",
        "u-fps",
        "v-fps",
        "w-fps",
        "p-rad_sec",
        "q-rad_sec",
        "r-rad_sec",
    )
    state_setters = [engine.handle(fdm, f"ic/{name}").set_double_value for name in names]
    motion = states.motion
    for k in range(len(states.controls)):
        for handles, value in zip(setters, states.controls[k], strict=True):
            for setter in handles:
                setter(float(value))
        u, v, w = body_velocity(
            float(motion["V_mps"][k]), float(motion["alpha_rad"][k]), float(motion["beta_rad"][k])
        )
        state = (
            states.altitude_m[k] / FT_M,
            motion["phi_rad"][k],
            motion["theta_rad"][k],
            0.0,
            u / FT_M,
            v / FT_M,
            w / FT_M,
            motion["p_radps"][k],
            motion["q_radps"][k],
            motion["r_radps"][k],
        )
        # Order matters: the ground first, then the state, then one initialisation.
        terrain(float(states.terrain_m[k]) / FT_M)
        for setter, value in zip(state_setters, state, strict=True):
            setter(float(value))
        if not fdm.run_ic():
            raise engine.RuntimeFailure(f"JSBSim could not take the state of sample {k}")
        if engines:
            engine.settle_engines(fdm)
        yield k


def _settle_rates(fdm: Any, alphadot: Callable[[], float], betadot: Callable[[], float]) -> None:
    # JSBSim takes alphadot and betadot from the accelerations of the frame before, which belong to
    # another state when states are imposed.
    """Repeat the evaluation until the rates of alpha and beta belong to the imposed state."""
    previous, change = (alphadot(), betadot()), float("inf")
    for _ in range(MAX_FRAMES):
        engine.renew_forces(fdm)
        current, last_change = (alphadot(), betadot()), change
        change = abs(current[0] - previous[0]) + abs(current[1] - previous[1])
        # The iteration diverges where a force exceeds the acceleration that it contributes to; then
        # no frame is better than another.
        if change < SETTLED_RADPS or not change < last_change:
            return
        previous = current


def property_slopes(
    model: ReplayModel,
    parts: Sequence[SegmentStates],
    properties: Mapping[str, float],
    names: Sequence[str],
    pool: Processes = SERIAL,
) -> list[FloatArray]:
    """Return the change of force [N] and moment [N m] per unit of properties, (n, k, 6) a set.

    Central differences with engines at constant speed. The motion is frozen until the loads are
    stationary: lift changes the rate of alpha and with it the induced drag. Parameters as
    `force_all`; ``names`` has the k properties.
    """

    def of_step(state_sets: list[States], dt_s: float) -> list[FloatArray]:
        """Evaluate sets of states of one time step."""
        missing = [name for name in names if name not in properties]
        current = dict(zip(missing, model.current_values(dt_s, missing), strict=True))
        values = {**properties, **current}
        jobs = [(model, dt_s, values, names, states) for states in state_sets]
        by_batch = _slopes_by_batch(model, dt_s, values, names, States.of(state_sets))
        if by_batch is None:
            return list(pool(_slopes_by_jsbsim, jobs))
        return np.split(by_batch, np.cumsum([len(states.controls) for states in state_sets])[:-1])

    return _by_step(model, parts, of_step)


_SlopesJob = tuple[ReplayModel, float, Mapping[str, float], Sequence[str], States]


def _slopes_by_batch(
    model: ReplayModel,
    dt_s: float,
    values: Mapping[str, float],
    names: Sequence[str],
    states: States,
) -> FloatArray | None:
    """Return slopes (n, k, 6) by the program that evaluated the model's loads; None without one, or
    where it differs from JSBSim.
    """
    entry = _cached_programs.get(model.identity)
    if entry is None or entry.program is None or not {*names} <= entry.program.properties:
        return None
    program = entry.program

    def evaluate(requested: States, of_names: Sequence[str]) -> FloatArray:
        """Evaluate the program; loads in SI units."""
        steps = {name: _slope_step(values[name]) for name in of_names}
        raw = _evaluate(program, model, requested, dt_s, values, steps)
        return np.asarray(raw[..., _LOADS] * _SI_OF_LOADS)

    if new := [name for name in names if name not in entry.slopes]:
        rows = np.unique(np.linspace(0, len(states.controls) - 1, _COMPARED_STATES).astype(int))
        subset = states.subset(rows)
        expected = _slopes_by_jsbsim((model, dt_s, values, new, subset))
        size = np.abs(expected).max(axis=(0, 2), keepdims=True)
        # A property without effect has a slope of rounding.
        size = np.maximum(size, 1e-3 * size.max())
        agree = np.abs(evaluate(subset, new) - expected) <= SLOPE_TOLERANCE * size
        entry.slopes |= dict(zip(new, agree.all(axis=(0, 2)).tolist(), strict=True))
    if not all(entry.slopes[name] for name in names):
        return None
    out = evaluate(states, names)
    return None if np.isnan(out).any() else out


def _slope_step(value: float) -> float:
    """Return the step of a property: a thousandth."""
    return 1e-3 * max(abs(value), 1e-2)


_LOADS, _SI_OF_LOADS = (0, 1, 2, 6, 7, 8), np.repeat([LBF_N, LBF_FT_NM], 3)
"""Places of the total force and moment in _RECORDS, and their units in N and N m."""


def _slopes_by_jsbsim(job: _SlopesJob) -> FloatArray:
    """Return slopes (n, k, 6) by JSBSim; a function of one argument, for pools."""
    model, dt_s, values, names, states = job
    fdm = _open(model, dt_s, values)
    get = [engine.handle(fdm, _RECORDS[place]).get_double_value for place in _LOADS]
    handles = [engine.handle(fdm, name).set_double_value for name in names]
    out = np.empty((len(states.controls), len(names), 6))
    for k in _imposed(fdm, model, states):
        # With the motion frozen, move one property at a time, both ways.
        fdm.suspend_integration()
        for j, (name, move) in enumerate(zip(names, handles, strict=True)):
            sides, step = [], _slope_step(values[name])
            for shift in (step, -step):
                move(values[name] + shift)
                sides.append(_settled_loads(fdm, get))
            move(values[name])
            out[k, j] = (sides[0] - sides[1]) / (2.0 * step)
        fdm.resume_integration()
    return out * _SI_OF_LOADS


def _settled_loads(fdm: Any, get: Sequence[Callable[[], float]]) -> FloatArray:
    """Run frames with integration suspended until the loads (6,) that ``get`` reads stand still;
    return them.
    """
    # Plain numbers: this runs tens of thousands of times, and arrays of six cost more than a frame.
    fdm.run()
    loads, moved = [g() for g in get], float("inf")
    for _ in range(MAX_FRAMES):
        fdm.run()
        before, last = loads, moved
        loads = [g() for g in get]
        change = max(
            abs(load - load_before) for load, load_before in zip(loads, before, strict=True)
        )
        moved = change / max(*map(abs, loads), 1e-9)
        # Loads that outgrow the accelerations that they are part of settle nowhere.
        if moved < STATIONARY_SHARE or not moved < last:
            break
    return np.array(loads)
