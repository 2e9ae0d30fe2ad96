"""Fly many flights of one mission in lanes, with interruptions and branches.

`fly_many` and `record_many` fly complete flights. `Course` flies piece by piece for rare-event
simulation: a flight can be stored as a `FlightSnapshot`, resumed in another lane, or branched into
several that meet different air and noise from there on.

A snapshot contains only numbers: the slots of its lane (integrators, filters, delays, events,
counters), the records so far, and the frame. Streams are functions of seeds, splits and frame, so
they are regenerated up to that frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.units import FT_M
from uqharness.batch.auxiliary import POINT, TOUCHED
from uqharness.batch.interpret import Interpreter
from uqharness.batch.llvm import Target, choose_target
from uqharness.batch.mission import (
    AIR_WIND,
    WIND,
    LaneMission,
    LoadedStart,
    Rester,
    Settler,
    load_start,
    make_mission,
)
from uqharness.batch.motion import CONDITIONS, WEIGHTS_PARTS, round_44_bits, start_state
from uqharness.batch.motion import slots as state_slots
from uqharness.batch.program import (
    Feed,
    Flyer,
    from_blocks,
    initial_state,
    select_lanes,
    share_feed,
    slot,
    step_once,
    to_blocks,
)
from uqharness.batch.streams import (
    GUSTS,
    LEVELS,
    TRANSIENTS,
    HostGusts,
    MovingLevels,
    Noise,
    Rows,
    Series,
    Turbulence,
    noise_streams,
)
from uqharness.batch.translate.engines import has_power_balance, settling_slot
from uqharness.batch.translate.frame import OUT_OF_RANGE, TIME, canonical
from uqharness.batch.translate.piston import Piston
from uqharness.batch.translate.propeller import Propeller
from uqharness.batch.translate.turbine import Turboprop
from uqharness.batch.winds import COUNTER, NORMALS
from uqharness.errors import BadInputError
from uqharness.flight import (
    DIVERGED_FPS,
    OPTIONAL_SIGNALS,
    TURBULENCE_W20_KT,
    ContactPoint,
    FlightResult,
    FlightSpec,
    LevelDriver,
    RecordedFlight,
    Split,
    TransientDriver,
    dryden_parameters,
    first_levels,
    record_stride,
    refuse_above_ceiling,
    row_counts,
    score,
    scored_signals,
    set_conditions,
    staged_mission,
    to_signals,
)
from uqharness.simulator import (
    CHANGEABLE,
    FTLBF_PER_S_HP,
    Source,
    StagedMission,
    forced_state,
    power_is_balanced,
)

# From flight specifications to the state before the first frame: JSBSim's start, then two
# initialising frames.

_SETTLING_FRAMES = 200
"""Steps between two tests of whether engines are steady."""
_RENEWALS = 12
_BALANCING_ROUNDS, _BALANCED = 50, 1e-9
"""Rounds of balancing at most, and the relative change of power that ends them."""


@dataclass(frozen=True)
class InitialLanes:
    """State of all lanes after the initialising frames.

    ``values``: slot -> value in each lane. ``noise``: seed -> noise, advanced to there.
    """

    values: dict[str, FloatArray]
    noise: Mapping[int, Noise]


def initialise_lanes(lanes: LaneMission, specs: Sequence[FlightSpec]) -> InitialLanes:
    """Initialise flights.

    Parameters
    ----------
    lanes : LaneMission
        The mission.
    specs : sequence of FlightSpec
        One per lane.

    Returns
    -------
    InitialLanes

    Raises
    ------
    BadInputError
        For a property that cannot be set, that initialising overwrites, and for a start on the
        ground.
    """
    # Flights that differ only in what they meet later begin alike: each start is computed once.
    draws = bool(lanes.flight.draws)
    keys = [(*_start_key(lanes, spec), spec.seed_noise if draws else 0) for spec in specs]
    lane_of_key = dict(zip(reversed(keys), reversed(range(len(keys))), strict=True))
    distinct = tuple(sorted(lane_of_key, key=repr))
    # Groups of one campaign begin alike, too. Noise is advanced by its flights and not shared.
    initial = None if draws else lanes.starts.get(distinct)
    if initial is None:
        initial = _initialise_distinct(lanes, [specs[lane_of_key[key]] for key in distinct])
        if not draws:
            lanes.starts[distinct] = initial
    number = {key: k for k, key in enumerate(distinct)}
    places = np.array([number[key] for key in keys])
    return InitialLanes(
        {name: value[places] for name, value in initial.values.items()}, initial.noise
    )


def _start_key(lanes: LaneMission, spec: FlightSpec) -> tuple[Hashable, ...]:
    """Return what decides how a flight begins, apart from its noise."""
    return (
        *(spec.wind_mps, spec.wind_from_deg, spec.turbulence),
        tuple(sorted(spec.properties.items())),
        tuple(first_levels(spec, lanes.dt_s).items()),
    )


def _initialise_distinct(lanes: LaneMission, specs: Sequence[FlightSpec]) -> InitialLanes:
    """Initialise flights, each in a lane."""
    count = len(specs)
    loaded = _load_starts(lanes, specs)
    unset = _unset_properties(lanes, specs)
    rows = [
        unset | _set_properties(lanes, one, spec) for one, spec in zip(loaded, specs, strict=True)
    ]
    values = start_state(
        {name: np.array([one.conditions[name] for one in loaded]) for name in CONDITIONS}
    )
    assigned = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    # Properties that were set override those of the start state.
    values |= assigned
    values |= {
        name: np.array([one.static[name] for one in loaded])
        for name in loaded[0].static
        if name not in assigned
    }
    # Without an air system JSBSim initialises with its own wind; the flight's wind follows.
    wind, flight_wind = (
        np.array([getattr(one, field) for one in loaded])
        for field in ("wind_fps", "flight_wind_fps")
    )
    # With engines there is a third initialising frame, after their steady state.
    noise = {
        s: Noise(
            s, lanes.flight.draws, lanes.flight.first_draws, initialising=3 if lanes.steady else 2
        )
        for s in dict.fromkeys(spec.seed_noise for spec in specs)
    }

    def initialise(flyer: Interpreter, number: int) -> None:
        """Compute an initialising frame with its draws."""
        normals = np.array([noise[spec.seed_noise].initial[number] for spec in specs])
        values.update(
            {
                name: normals[:, k]
                for k, (name, _) in enumerate(lanes.flight.draws[: normals.shape[1]])
            }
        )
        values.update(step_once(flyer, values, count))

    def run_ic(initialisers: Sequence[Interpreter]) -> None:
        """Compute the initialising frames, the first in the wind of the initial conditions."""
        for number, flyer in enumerate(initialisers):
            if number == 0:
                values.update(
                    {
                        name: speed
                        for name, speed in zip(WIND, wind.T, strict=True)
                        if name in flyer.program.slots
                    }
                )
            initialise(flyer, number)
        if not lanes.air:
            values.update(zip(WIND, flight_wind.T, strict=True))

    run_ic(lanes.initialisers)
    # Engines reach their steady state between the initialising frames and the renewal frame.
    renewer, initialiser = lanes.renewer, lanes.initialisers[1]
    if renewer is not None:
        settle(
            lanes.settlers,
            values,
            count,
            renew=lambda: initialise(renewer, 2),
            run_ic=lambda: run_ic((initialiser, initialiser)),
        )
    if lanes.rester is not None:
        bring_to_rest(lanes.rester, values, count, lambda: run_ic((initialiser, initialiser)))
    if lanes.points and (values[TOUCHED] >= 0.0).any():
        raise BadInputError(
            "the flight starts on the ground, where the batch engine computes no forces; use"
            ' engine = "jsbsim"'
        )
    _check_retained(specs, assigned, values)
    return InitialLanes(values, noise)


def settle(
    settlers: Sequence[Settler],
    values: dict[str, FloatArray],
    count: int,
    *,
    renew: Callable[[], None],
    run_ic: Callable[[], None],
) -> None:
    """Bring every lane's engines to their steady state; ``values`` is updated.

    As `simulator.engine.settle_engines`: JSBSim's iteration, a frame in which time stands still,
    and where a propeller is out of balance then, frames of the flight, the initialising frames
    and another such frame.

    Parameters
    ----------
    settlers : sequence of Settler
        From `mission.settlers_of`.
    values : dict of str to ndarray
        Slot -> one value per lane.
    count : int
        Number of lanes.
    renew : callable
        Computes the frame in which time stands still.
    run_ic : callable
        Computes the initialising frames once more.
    """
    off_balance = reach_steady_state(settlers, values, count, renew)
    if off_balance.any():
        balance_propellers(settlers, values, off_balance, renew=renew, run_ic=run_ic)


def reach_steady_state(
    settlers: Sequence[Settler],
    values: dict[str, FloatArray],
    count: int,
    renew: Callable[[], None],
) -> NDArray[np.bool_]:
    """Bring engines to JSBSim's steady state; parameters as `settle`.

    Returns the lanes (count,) in which a propeller is out of balance then.
    """
    for turboprop in _turboprops(settlers):
        if (limited_throttle := values.get(f"#{turboprop.limited_throttle}")) is not None:
            values[f"#{turboprop.limited_throttle}"] = np.nan_to_num(limited_throttle, nan=1.0)
    for settler in settlers:
        _settle_engine(settler.steady, settling_slot(settler.engine), values, count)
    renew()
    off_balance = np.zeros(count, dtype=bool)
    for settler in settlers:
        if not has_power_balance(settler.engine):
            continue
        name = settler.engine.name
        absorbed, power_hp = (
            values[f"{name}{reading}"] for reading in ("propeller-power-ftlbps", "power-hp")
        )
        off_balance |= ~power_is_balanced(absorbed, power_hp * FTLBF_PER_S_HP)
        # JSBSim cranks an engine that its half-second steps stopped. Here its propeller turns it
        # from full speed, and the steady state is the same.
        motor, thruster = settler.engine.motor, settler.engine.thruster
        if isinstance(motor, Piston) and isinstance(thruster, Propeller):
            stopped = values[f"{name}set-running"] == 0.0
            for shaft, rpm in (
                ("engine-rpm", motor.numbers.max_rpm),
                ("propeller-rpm", motor.numbers.max_rpm / thruster.gear),
            ):
                values[f"{name}{shaft}"] = np.where(stopped, rpm, values[f"{name}{shaft}"])
            off_balance |= stopped
        else:
            # Electric motors never report that they run, and turboprops no power in a frame without
            # time, so that JSBSim's frames settle them.
            off_balance[:] = True
    return off_balance


def balance_propellers(
    settlers: Sequence[Settler],
    values: dict[str, FloatArray],
    off_balance: NDArray[np.bool_],
    *,
    renew: Callable[[], None],
    run_ic: Callable[[], None],
) -> None:
    """Bring the propellers of the lanes ``off_balance`` into balance; parameters as `settle`."""
    count, turboprops = len(off_balance), _turboprops(settlers)
    is_beyond = np.zeros(count, dtype=bool)
    unbalanced_values = dict(values)
    powers = [
        f"{settler.engine.name}power-hp"
        for settler in settlers
        if isinstance(settler.engine.motor, Piston)
    ]
    for _ in range(_BALANCING_ROUNDS):
        for settler in settlers:
            going = settling_slot(settler.engine, balancing=True)
            # Count the turns of this round only.
            counts = (f"{going.removesuffix('going')}{word}" for word in ("count", "turns"))
            values |= {name: np.zeros(count) for name in counts}
            values[going] = off_balance.astype(float)
            _settle_engine(settler.balance, going, values, count)
            if isinstance(settler.engine.motor, Piston):
                is_beyond |= values[f"{settler.engine.name}set-running"] == 0.0
        # Rates of incidence are of the accelerations a frame before, which JSBSim's frames leave
        # at those of the settled thrust.
        values |= {f"#{motor.settled}": np.ones(count) for motor in turboprops}
        balanced = [values[name] for name in powers]
        for _ in range(_RENEWALS):
            renew()
        # Systems that read an engine and set its efficiency or friction move its balance.
        if all(
            np.allclose(values[name], power, rtol=_BALANCED, atol=_BALANCED)
            for name, power in zip(powers, balanced, strict=True)
        ):
            break
    if is_beyond.any():
        values[OUT_OF_RANGE] = np.where(is_beyond, 1.0, values.get(OUT_OF_RANGE, 0.0))
    if turboprops:
        # Initialising would set them to idle: JSBSim's frames have filled the integrators' history
        # with the present rates.
        for part in WEIGHTS_PARTS:
            for back in (1, 2, 3):
                pairs = zip(state_slots(part, back), state_slots(part, 0), strict=True)
                values |= {
                    f"#{old}": values[f"#{new}"] for old, new in pairs if f"#{new}" in values
                }
    else:
        run_ic()
        renew()
    # A lane does not depend on the others.
    values |= {
        name: np.where(off_balance, values[name], value)
        for name, value in unbalanced_values.items()
    }


def bring_to_rest(
    rester: Rester, values: dict[str, FloatArray], count: int, run_ic: Callable[[], None]
) -> None:
    """Bring every lane's control system to rest; ``values`` is updated.

    Blocks of frames with frozen motion, each followed by the initialising frames (``run_ic``), as
    `simulator.forced_state.bring_to_rest`. Engines spool at their own rates, which ends at the same
    place.
    """
    held = [f"#{name}" for part in WEIGHTS_PARTS for name in state_slots(part)]
    held += ["#earth/angle", *rester.fuel]
    held = [name for name in held if name not in rester.rates]
    program = rester.flyer.program

    def change_over_block(watched: Sequence[str], is_moving: NDArray[np.bool_]) -> FloatArray:
        """Fly a block of frames where ``is_moving`` and return the largest relative change."""
        before = dict(values)
        state = initial_state(
            program, count, {name: v for name, v in values.items() if name in program.slots}
        )
        rester.flyer.fly(state, 1, forced_state.BLOCK_FRAMES)
        values.update({name: slot(program, state, name, count) for name in program.slots})
        values.update({name: before[name] for name in held if name in before})
        run_ic()
        change = np.zeros(count)
        for name in watched:
            step = np.abs(values[name] - before[name]) / np.maximum(np.abs(values[name]), 1.0)
            change = np.maximum(change, step)
        # A lane does not depend on the others.
        values.update(
            {name: np.where(is_moving, values[name], value) for name, value in before.items()}
        )
        return change

    is_moving = np.ones(count, dtype=bool)
    smallest, blocks_without_gain = np.full(count, np.inf), np.zeros(count, dtype=int)
    for _ in range(forced_state.MAX_BLOCKS):
        change = change_over_block((*rester.watched, *rester.rates), is_moving)
        has_gained = change < 0.5 * smallest
        smallest = np.where(has_gained, change, smallest)
        blocks_without_gain = np.where(has_gained, 0, blocks_without_gain + 1)
        is_moving &= change > forced_state.CONVERGED
        is_moving &= blocks_without_gain < forced_state.PATIENCE
        if not is_moving.any():
            break
    # As `simulator.forced_state.settle_fuel_flow`.
    is_moving = np.ones(count, dtype=bool)
    for _ in range(forced_state.MAX_BLOCKS if rester.flows else 0):
        is_moving &= change_over_block(rester.flows, is_moving) > forced_state.CONVERGED
        if not is_moving.any():
            break


def _turboprops(settlers: Sequence[Settler]) -> list[Turboprop]:
    """Return the turboprops among engines."""
    return [s.engine.motor for s in settlers if isinstance(s.engine.motor, Turboprop)]


def _settle_engine(flyer: Flyer, going: str, values: dict[str, FloatArray], count: int) -> None:
    """Fly a settling program until its slot ``going`` is 0 in every lane; ``values`` is updated."""
    program = flyer.program
    state = initial_state(
        program, count, {name: v for name, v in values.items() if name in program.slots}
    )
    while slot(program, state, going, count).any():
        flyer.fly(state, 1, _SETTLING_FRAMES)
    values |= {name: slot(program, state, name, count) for name in program.slots}


def _load_starts(lanes: LaneMission, specs: Sequence[FlightSpec]) -> list[LoadedStart]:
    """Load each distinct start once in JSBSim."""
    by_start: dict[tuple[object, ...], LoadedStart] = {}
    out = []
    for spec in specs:
        changes = tuple(
            (n, v)
            for n, v in sorted(spec.properties.items())
            if n.startswith("ic/") or n in CHANGEABLE
        )
        key = (spec.wind_mps, spec.wind_from_deg, spec.turbulence, changes)
        if key not in by_start:
            by_start[key] = load_start(lanes, spec)
        out.append(by_start[key])
    return out


def _set_properties(lanes: LaneMission, loaded: LoadedStart, spec: FlightSpec) -> dict[str, float]:
    """Return the properties that are set for a flight; mass and what depends on it as JSBSim
    computed them.
    """
    values = (spec.wind_mps, spec.wind_from_deg, TURBULENCE_W20_KT[spec.turbulence])
    air = dict(zip(AIR_WIND, values, strict=True)) if lanes.air else {}
    assigned = {**air, **first_levels(spec, lanes.dt_s), **spec.properties}
    return {
        name: loaded.static.get(name, float(value))
        for name, value in ((canonical(n), v) for n, v in assigned.items())
    }


def _unset_properties(lanes: LaneMission, specs: Sequence[FlightSpec]) -> dict[str, float]:
    """Return the values in the XML of properties that some of the flights do not set."""
    names = [frozenset(spec.properties) for spec in specs]
    partial = sorted(frozenset.union(*names) - frozenset.intersection(*names))
    if not partial:
        return {}
    fdm = lanes.mission.open()
    set_conditions(fdm, lanes.mission, replace(specs[0], properties={}))
    return {canonical(name): float(fdm[name]) for name in partial}


def _check_retained(
    specs: Sequence[FlightSpec],
    assigned: Mapping[str, FloatArray],
    values: Mapping[str, FloatArray],
) -> None:
    """Raise BadInputError if initialising changed a property that was set, because the model
    computes it.
    """
    for name in dict.fromkeys(name for spec in specs for name in spec.properties):
        if name.startswith("ic/") or name in CHANGEABLE:
            continue
        expected, actual = assigned[canonical(name)], values[canonical(name)]
        moved = np.abs(actual - expected) > 1e-9 * np.maximum(np.abs(expected), 1.0)
        if moved.any():
            lane = int(np.argmax(moved))
            raise BadInputError(
                f"property {name} was set to {expected[lane]:g} and is {actual[lane]:g}"
                " after initialising: the model computes it, so it cannot be set"
            )


# Streams of lanes: each air, noise and walk is generated once, piece by piece, and shared by all
# lanes with the same seeds.

Air = tuple[float, float, float]
"""Airspeed [m/s], height [m] and span [m] of the host's gusts."""
Splits = tuple[Split, ...]


class Feeder:
    """Feeds of the next frames for the lanes that are still flying.

    Parameters
    ----------
    lanes : LaneMission
        The mission.
    specs, airs : sequence
        Specification and air of each lane.
    initial_noise : mapping, optional
        Seed -> noise, advanced to the first frame.
    frame : int
        Frames already flown; streams are regenerated up to there.
    splits : sequence, optional
        Splits of each lane.
    target : Target, optional
        Processor.
    """

    def __init__(
        self,
        lanes: LaneMission,
        specs: Sequence[FlightSpec],
        airs: Sequence[Air],
        *,
        initial_noise: Mapping[int, Noise] | None = None,
        frame: int = 0,
        splits: Sequence[Splits] | None = None,
        target: Target | None = None,
    ) -> None:
        """List the streams of the program; nothing is generated yet."""
        self._branching, self._target = False, target or choose_target()
        self._lanes, self._specs, self._airs, self._frame = lanes, specs, airs, frame
        self._splits = [()] * len(specs) if splits is None else splits
        self._program = lanes.program
        self._stream_names = {stream.name for stream in self._program.streams}
        self._noise = noise_streams(lanes.flight.draws)
        self._noises: dict[tuple[int, Splits], Noise] = {
            (seed, ()): noise for seed, noise in (initial_noise or {}).items()
        }
        self._series: dict[tuple[str, Hashable], Series] = {}
        self._windows: dict[Hashable, _Window] = {}

    def followed(self, lanes: Sequence[int], frame: int, splits: Sequence[Splits]) -> Feeder:
        """Return a feeder after ``frame`` frames whose lane k continues lane ``lanes[k]`` of this
        one.

        Existing streams continue where they are; a lane with a new split leaves them there. This
        feeder must not be used afterwards.
        """
        specs, airs = [self._specs[k] for k in lanes], [self._airs[k] for k in lanes]
        other = Feeder(self._lanes, specs, airs, frame=frame, splits=splits, target=self._target)
        other._branching = True
        # Share noise, turbulence and series that continue unchanged.
        for place, spec in enumerate(other._specs):
            key = (spec.seed_noise, splits[place])
            if key in self._noises:
                other._noises[key] = self._noises[key]
            air = (spec.seed_turbulence, splits[place])
            if air in self._windows:
                other._windows[air] = self._windows[air]
            moving = (
                (LEVELS.name, (spec.levels, ())),
                (TRANSIENTS.name, (spec.transient, splits[place])),
            )
            for name in ((GUSTS.name, other._air(place)), *moving):
                if name in self._series:
                    series = other._series[name] = self._series[name]
                    if isinstance(series, HostGusts):
                        series.keep_branching_state()
            other._branch(self, place)
        return other

    def _branch(self, parent: Feeder, place: int) -> None:
        """Branch the gusts of a lane off its parent's."""
        key = self._air(place)
        *gust_key, splits = key
        if splits and (GUSTS.name, key) not in self._series:
            source = parent._series.get((GUSTS.name, (*gust_key, splits[:-1])))
            branched = source.branched(splits[-1]) if isinstance(source, HostGusts) else None
            if branched is not None:
                self._series[GUSTS.name, key] = branched

    def feeds(self, active: NDArray[np.intp], frames: int, state: FloatArray) -> dict[str, Feed]:
        """Return the feeds of the next ``frames`` frames for the active lanes."""
        out: dict[str, Feed] = {}
        if self._noise:
            out |= self._noise_feeds(active, frames)
        if GUSTS.name in self._stream_names:
            out[GUSTS.name] = self._series_feed(
                GUSTS.name, [self._air(k) for k in active], frames, self._gusts
            )
        if LEVELS.name in self._stream_names:
            out[LEVELS.name] = self._series_feed(
                LEVELS.name, [(self._specs[k].levels, ()) for k in active], frames, self._levels
            )
        if TRANSIENTS.name in self._stream_names:
            drivers = [(self._specs[k].transient, self._splits[k]) for k in active]
            out[TRANSIENTS.name] = self._series_feed(TRANSIENTS.name, drivers, frames, self._levels)
        if NORMALS.name in self._stream_names:
            out[NORMALS.name] = self._turbulence(active, frames, state)
        return out

    def _noise_feeds(self, active: NDArray[np.intp], frames: int) -> dict[str, Feed]:
        """Return the feeds of sensor noise."""
        seeds = [(self._specs[k].seed_noise, self._splits[k]) for k in active]
        # Noise of lanes that have ended is not advanced.
        rows = {key: self._noise_of(*key).frames(frames) for key in dict.fromkeys(seeds)}
        out = {}
        for stream in self._noise:
            pieces = {seed: noise_rows[stream.name] for seed, noise_rows in rows.items()}
            out[stream.name] = share_feed(
                {s: p.array for s, p in pieces.items()},
                seeds,
                next(iter(pieces.values())).first_row,
            )
        return out

    def _noise_of(self, seed: int, splits: Splits) -> Noise:
        """Return the noise of a seed after the splits, created at its first use."""
        if (seed, splits) not in self._noises:
            flight, initialising = self._lanes.flight, 3 if self._lanes.steady else 2
            if splits:
                # Noise has no memory, so only the last split matters.
                noise = Noise(
                    splits[-1].seed("noise"), flight.draws, 0, self._target, frame=splits[-1].frame
                )
                noise.frames(self._frame - splits[-1].frame)
            else:
                # The undisturbed noise starts at the first frame; skip the frames already flown.
                noise = Noise(seed, flight.draws, flight.first_draws, self._target, initialising)
                noise.frames(self._frame)
            self._noises[seed, splits] = noise
        return self._noises[seed, splits]

    def _series_feed(
        self, name: str, keys: Sequence[Hashable], frames: int, make: Callable[..., Series]
    ) -> Feed:
        """Return the feed of a stream with one row per frame; ``make`` creates missing series."""
        pieces = {}
        first = 0
        for key in dict.fromkeys(keys):
            # New series skip the frames already flown.
            if (name, key) not in self._series:
                self._series[name, key] = make(key)
                self._series[name, key].rows(self._frame)
            array, first = self._series[name, key].rows(frames)
            pieces[key] = array
        return share_feed(pieces, keys, first)

    def _levels(self, key: tuple[LevelDriver | TransientDriver, Splits]) -> MovingLevels:
        """Create the moving levels of a driver."""
        return MovingLevels(key[0], self._lanes.dt_s, splits=key[1])

    def _air(self, lane: int) -> tuple[int, str, Air, Splits]:
        """Return the key of a lane's gusts."""
        spec = self._specs[lane]
        return spec.seed_turbulence, spec.turbulence, self._airs[lane], self._splits[lane]

    def _gusts(self, key: tuple[int, str, Air, Splits]) -> HostGusts:
        """Create the host gusts of an air; BadInputError above the ceiling of the turbulence
        model.
        """
        seed, turbulence, (speed, height, span), splits = key
        refuse_above_ceiling(turbulence, height)
        gusts = HostGusts(
            dryden_parameters(speed, height, TURBULENCE_W20_KT[turbulence], span),
            self._lanes.dt_s,
            seed,
            self._target,
            splits,
        )
        if self._branching:
            gusts.keep_branching_state()
        return gusts

    def _turbulence(self, active: NDArray[np.intp], frames: int, state: FloatArray) -> Feed:
        """Return the feed of JSBSim's turbulence.

        Lanes of one air may be at different rows, so each air keeps the rows that some lane may
        still need.
        """
        counters = slot(self._program, state, COUNTER, len(active)).astype(np.int64)
        seeds = [(self._specs[k].seed_turbulence, self._splits[k]) for k in active]
        pieces = {}
        low = int(counters.min())
        for seed in dict.fromkeys(seeds):
            if seed not in self._windows:
                self._windows[seed] = _Window(_turbulence_series(*seed, self._target))
            window = self._windows[seed]
            pieces[seed] = window.from_to(low, int(counters.max()) + frames)
        return share_feed(pieces, seeds, low)


def airs_of(
    lanes: LaneMission, specs: Sequence[FlightSpec], values: Mapping[str, FloatArray]
) -> list[Air]:
    """Return each lane's air from its values after initialising."""
    return [_air_of(lanes, spec, values, lane) for lane, spec in enumerate(specs)]


def _air_of(
    lanes: LaneMission, spec: FlightSpec, values: Mapping[str, FloatArray], lane: int
) -> Air:
    """Return airspeed, height and span of a lane; without an air system the steady wind is
    subtracted from the ground speed.
    """
    if lanes.air:
        speed = float(values["velocities/vt-fps"][lane]) * FT_M
    else:
        # The wind blows towards the opposite of its direction of origin.
        toward = math.radians(spec.wind_from_deg + 180.0)
        north = float(values["velocities/v-north-fps"][lane]) * FT_M - spec.wind_mps * math.cos(
            toward
        )
        east = float(values["velocities/v-east-fps"][lane]) * FT_M - spec.wind_mps * math.sin(
            toward
        )
        down = float(values["velocities/v-down-fps"][lane]) * FT_M
        speed = math.sqrt(north * north + east * east + down * down)
    height = float(values["position/h-agl-ft"][lane]) * FT_M
    span = float(values.get("metrics/bw-ft", np.full(lane + 1, lanes.span_ft))[lane]) * FT_M
    return round_44_bits(max(speed, 1.0)), round_44_bits(max(height, 3.048)), span


def _turbulence_series(seed: int, splits: Splits, target: Target) -> Series:
    """Return the normals of an air after its splits.

    The filters belong to the aircraft, so only the last split matters.
    """
    if splits:
        return _OffsetSeries(
            Turbulence(splits[-1].seed("turbulence"), target, splits[-1].turbulence_row),
            splits[-1].turbulence_row,
        )
    return Turbulence(seed, target)


class _OffsetSeries:
    """A series that starts at a row; the rows before it, which are not used, are NaN."""

    def __init__(self, series: Series, row: int) -> None:
        """Keep the series and the number of rows before it."""
        self._series, self._row = series, row

    def rows(self, n: int) -> Rows:
        """Return the next ``n`` rows."""
        lacking, self._row = min(n, self._row), max(self._row - n, 0)
        array, first = self._series.rows(n - lacking)
        return Rows(
            np.concatenate([np.full((lacking, array.shape[1]), np.nan), array]), first - lacking
        )


class _Window:
    """Rows of a series from the first one that is still needed."""

    def __init__(self, series: Series) -> None:
        """Start at row 0."""
        self._series, self._first = series, 0
        self._stored: FloatArray | None = None

    def from_to(self, first: int, last: int) -> FloatArray:
        """Return rows ``first`` to ``last`` (exclusive) and drop those before ``first``."""
        stored_rows = 0 if self._stored is None else len(self._stored)
        lacking = last - (self._first + stored_rows)
        if lacking > 0 or self._stored is None:
            new = self._series.rows(max(lacking, 1)).array
            self._stored = new if self._stored is None else np.concatenate([self._stored, new])
        self._stored = self._stored[first - self._first :]
        self._first = first
        return self._stored[: last - first]


HEIGHT, SPEED = "position/h-agl-ft", "velocities/vt-fps"
_CHUNK = 4000
"""Frames between two tests of which lanes have ended."""


_BEYOND_REASON = (
    "a function of the aircraft had an argument that JSBSim ends for (mod by 0, a condition that is"
    " neither 0 nor 1, a switch without such a case) or that is beyond the batch engine (sin, cos"
    " and tan beyond 1,600,000, fmod with a quotient beyond 2^50, mod beyond 32 bits); or an"
    " engine stopped and needs its starter, or a torque limiter acted at the start; run the"
    ' campaign with engine = "jsbsim"'
)


@dataclass(frozen=True)
class CompiledMission:
    """A mission translated for flights of one program; ``table`` maps names of scored signals to
    their sources.
    """

    staged: StagedMission
    lanes: LaneMission
    table: dict[str, Source]


@dataclass(frozen=True)
class End:
    """How a flight ended; ``ok`` while it goes on."""

    status: str = "ok"
    reason: str = ""
    flown_s: float = 0.0


class Branch(NamedTuple):
    """Key of a branch's streams; the kind of each stream is added to it."""

    root: int
    aleatory_id: int
    level: int
    branch: int


@dataclass(frozen=True)
class FlightSnapshot:
    """One flight after ``frame`` frames, which can continue in any lane.

    Attributes
    ----------
    spec : FlightSpec
        The flight.
    frame : int
        Frames flown.
    state : array (slots,)
        In the order of the program.
    records : array (channels, rows)
        Records of the scored part so far.
    air : (float, float, float)
        Airspeed, height and span of the host's gusts.
    splits : tuple of Split
        Where it branched.
    end : End
        How it ended.
    flying : bool
        Whether it still flies.
    """

    spec: FlightSpec
    frame: int
    state: FloatArray
    records: FloatArray
    air: Air
    splits: Splits
    end: End
    flying: bool

    def branched(
        self, mission: CompiledMission, root: int, aleatory_id: int, level: int, branch: int
    ) -> FlightSnapshot:
        """Return the same flight with air and noise from streams of another key.

        Raises ValueError if the flight has ended.
        """
        if not self.flying:
            raise ValueError(
                f"the flight has ended ({self.end.status}): there is nothing to branch"
            )
        slots = list(mission.lanes.program.slots)
        row = int(self.state[slots.index(COUNTER)]) if COUNTER in slots else 0
        return replace(
            self, splits=(*self.splits, Split(self.frame, root, aleatory_id, level, branch, row))
        )


class Course:
    """Flights in lanes, all after the same number of frames."""

    def __init__(self, mission: CompiledMission, snapshots: Sequence[FlightSnapshot]) -> None:
        """Resume snapshots, each in its own lane; a snapshot may occur several times.

        Raises ValueError unless all are at the same frame.
        """
        frames = {one.frame for one in snapshots}
        if len(frames) != 1:
            raise ValueError(
                f"flights of one course must be at the same frame; received {sorted(frames)}"
            )
        self._mission, self.frame = mission, frames.pop()
        self._snapshots = list(snapshots)
        self._parts: list[list[FloatArray]] = [[one.records] for one in snapshots]
        self._ends = [one.end for one in snapshots]
        self._alive = np.array([k for k, one in enumerate(snapshots) if one.flying], dtype=np.intp)
        if self._alive.size:
            self._state = to_blocks(
                list(np.array([snapshots[k].state for k in self._alive]).T), len(self._alive)
            )
        # Streams are regenerated up to this frame.
        self._feeder = Feeder(
            mission.lanes,
            [one.spec for one in snapshots],
            [one.air for one in snapshots],
            frame=self.frame,
            splits=[one.splits for one in snapshots],
        )

    @classmethod
    def start(cls, mission: CompiledMission, specs: Sequence[FlightSpec]) -> Course:
        """Return flights before their first frame.

        Raises BadInputError for a start that cannot be flown.
        """
        lanes, program = mission.lanes, mission.lanes.program
        initial = initialise_lanes(lanes, specs)
        burn, _ = row_counts(specs[0], lanes.dt_s * lanes.stride)
        airs = airs_of(lanes, specs, initial.values)
        state = initial_state(
            program, len(specs), {n: v for n, v in initial.values.items() if n in program.slots}
        )
        columns = np.array(from_blocks(state, len(specs))).T
        # Without burn-in the initial state is the first row of the record.
        first = (
            _first_row(mission, initial.values, len(specs))[:, :, None]
            if burn == 0
            else np.empty((len(program.records), len(specs), 0))
        )
        course = cls(
            mission,
            [
                FlightSnapshot(spec, 0, columns[k], first[:, k], airs[k], (), End(), True)
                for k, spec in enumerate(specs)
            ],
        )
        # The noise of initialising continues in flight.
        course._feeder = Feeder(lanes, specs, airs, initial_noise=initial.noise)
        return course

    @property
    def last(self) -> int:
        """Frames of the complete flight."""
        stride = record_stride(self._snapshots[0].spec, self._mission.lanes.dt_s)
        return sum(row_counts(self._snapshots[0].spec, self._mission.lanes.dt_s * stride)) * stride

    def fly(self, frame: int | None = None) -> None:
        """Fly up to ``frame`` frames, by default to the end.

        Raises ValueError for a frame in the past, or between two rows of the record.
        """
        lanes, program = self._mission.lanes, self._mission.lanes.program
        spec = self._snapshots[0].spec
        stride = record_stride(spec, lanes.dt_s)
        goal = self.last if frame is None else frame
        if goal < self.frame or goal > self.last or goal % stride:
            raise ValueError(
                f"a frame from {self.frame} to {self.last} that {stride} divides is needed;"
                f" received {goal}"
            )
        burn, _ = row_counts(spec, lanes.dt_s * stride)
        chunk = max(1, _CHUNK // stride) * stride
        columns = {name: k for k, name in enumerate(program.records)}
        while self.frame < goal and self._alive.size:
            frames = min(chunk, goal - self.frame)
            feeds = self._feeder.feeds(self._alive, frames, self._state)
            records = lanes.flyer.fly(self._state, self.frame + 1, frames, feeds, stride)
            rows = records.shape[2]
            # Rows of the burn-in are not kept.
            skip = max(0, burn - self.frame // stride)
            # One vectorised test for all lanes; only lanes that end are examined row by row.
            ending = np.any(_is_over(records, columns, lanes.points), axis=1)
            going = []
            for place, lane in enumerate(self._alive):
                lane_records = records[:, place, :]
                end, self._ends[lane] = (
                    _find_end(lane_records, columns, lanes.points)
                    if ending[place]
                    else (None, _in_progress(lane_records, columns))
                )
                self._parts[lane].append(
                    lane_records[:, skip : rows if end is None else max(skip, end)].copy()
                )
                if end is None:
                    going.append(place)
            # Lanes that have ended are removed from the state.
            if len(going) < self._alive.size and going:
                self._state = select_lanes(self._state, going)
            self._alive = self._alive[going]
            self.frame += frames
        self.frame = goal

    def follow(self, lanes: Sequence[int], branches: Sequence[Branch | None]) -> None:
        """Continue with the given lanes only, in that order.

        The results are bit-identical to those of ``snapshots``, ``branched`` and a new course, but
        streams are not regenerated. Records so far are dropped.

        Parameters
        ----------
        lanes : sequence of int
            Lanes to continue; one may occur several times.
        branches : sequence of Branch or None
            Key with which a lane branches here; None: it continues as it is.

        Raises
        ------
        ValueError
            For a lane that has ended, and for an empty list.
        """
        if not lanes:
            raise ValueError("a course follows one lane at least; received none")
        place = {int(lane): k for k, lane in enumerate(self._alive)}
        ended = [lane for lane in lanes if lane not in place]
        if ended:
            raise ValueError(
                f"lane {ended[0]} has ended ({self._ends[ended[0]].status}): it cannot be followed"
            )
        program = self._mission.lanes.program
        # Row of the turbulence at which each lane branches.
        rows = (
            np.zeros(len(self._alive))
            if COUNTER not in program.slots
            else self.slot_values(COUNTER)[self._alive]
        )
        snapshots = []
        for lane, key in zip(lanes, branches, strict=True):
            split = (
                ()
                if key is None
                else (Split(self.frame, *key, turbulence_row=int(rows[place[lane]])),)
            )
            snapshots.append(
                replace(self._snapshots[lane], splits=(*self._snapshots[lane].splits, *split))
            )
        self._feeder = self._feeder.followed(lanes, self.frame, [one.splits for one in snapshots])
        self._state = select_lanes(self._state, [place[lane] for lane in lanes])
        self._ends, self._snapshots = [self._ends[lane] for lane in lanes], snapshots
        self._alive = np.arange(len(snapshots), dtype=np.intp)
        self._parts = [[one.records[:, :0]] for one in snapshots]

    def take_rows(self) -> list[FloatArray]:
        """Return each lane's rows (channels, rows) since the last call, in the order of the
        program's records, and drop them.
        """
        rows = [
            np.concatenate(parts, axis=1) if len(parts) > 1 else parts[0] for parts in self._parts
        ]
        self._parts = [[part[:, :0]] for part in rows]
        return rows

    @property
    def ends(self) -> list[End]:
        """How each lane's flight ended."""
        return list(self._ends)

    @property
    def splits(self) -> list[Splits]:
        """Where each lane's flight has branched."""
        return [one.splits for one in self._snapshots]

    def slot_values(self, name: str) -> FloatArray:
        """Return a slot's value (lanes,), NaN for lanes that have ended.

        Raises ValueError if there is no such slot.
        """
        out = np.full(len(self._snapshots), np.nan)
        if self._alive.size:
            out[self._alive] = slot(
                self._mission.lanes.program, self._state, name, len(self._alive)
            )
        return out

    def snapshots(self, lanes: Sequence[int] | None = None) -> list[FlightSnapshot]:
        """Return the flights of the given lanes (all by default) as they are."""
        selected = range(len(self._snapshots)) if lanes is None else lanes
        columns = (
            np.array(from_blocks(self._state, len(self._alive))).T
            if self._alive.size
            else np.empty((0, 0))
        )
        # Lanes that have ended keep the state of their last snapshot.
        place = {int(lane): k for k, lane in enumerate(self._alive)}
        return [
            replace(
                self._snapshots[k],
                frame=self.frame,
                records=np.concatenate(self._parts[k], axis=1),
                end=self._ends[k],
                flying=k in place,
                state=columns[place[k]].copy() if k in place else self._snapshots[k].state,
            )
            for k in selected
        ]

    def recorded(self) -> list[RecordedFlight]:
        """Return the records of each flight so far, ready to be scored."""
        pairs = zip(self._ends, self._parts, strict=True)
        return [
            _to_recorded(self._mission, end, np.concatenate(parts, axis=1)) for end, parts in pairs
        ]


def _is_over(
    records: FloatArray, columns: dict[str, int], points: Sequence[ContactPoint]
) -> NDArray[np.bool_]:
    """Return (..., rows) whether a flight is over, from records (channels, ..., rows): not finite,
    below ground, or in contact.
    """
    height, speed = records[columns[HEIGHT]], records[columns[SPEED]]
    over = np.asarray(_has_diverged(height, speed) | (height <= 0.0))
    return np.asarray(over | (records[columns[TOUCHED]] >= 0.0)) if points else over


def _has_diverged(height: FloatArray, speed: FloatArray) -> NDArray[np.bool_]:
    """Return elementwise whether a flight has diverged, as `flight.fly` decides it."""
    return np.asarray(~(np.isfinite(height) & (speed < DIVERGED_FPS)))


def _in_progress(records: FloatArray, columns: dict[str, int]) -> End:
    """Return the state of a flight that goes on."""
    return End(flown_s=float(records[columns[TIME], -1]))


def _find_end(
    records: FloatArray, columns: dict[str, int], points: Sequence[ContactPoint]
) -> tuple[int | None, End]:
    """Return the row in which a flight ended (None while it goes on), and how."""
    height, speed, time = (records[columns[name]] for name in (HEIGHT, SPEED, TIME))
    diverged = _has_diverged(height, speed)
    touched = records[columns[TOUCHED]] if points else np.full(height.size, -1.0)
    over = _is_over(records, columns, points)
    if not over.any():
        return None, _in_progress(records, columns)
    row = int(np.argmax(over))
    flown_s = float(time[row])
    if diverged[row] and not touched[row] >= 0.0:
        return row, End("diverged", f"the state was no longer finite at {flown_s:.1f} s", flown_s)
    # Contact points are reported with the time of first contact.
    part = "the centre of gravity"
    if touched[row] >= 0.0:
        part, flown_s = points[int(records[columns[POINT], row])].name, float(touched[row])
    return row, End("ground-contact", f"{part} touched the ground at {flown_s:.1f} s", flown_s)


def _first_row(mission: CompiledMission, values: dict[str, FloatArray], lanes: int) -> FloatArray:
    """Return the recorded properties before the first frame (channels, lanes)."""
    slots = mission.lanes.program.slots
    return np.stack(
        [
            np.broadcast_to(values.get(name, np.array(slots[name])), lanes)
            for name in mission.lanes.program.records
        ]
    )


def _to_recorded(mission: CompiledMission, end: End, records: FloatArray) -> RecordedFlight:
    """Convert records to signals; a flight that left the range of the engine counts as crashed."""
    index = {name: k for k, name in enumerate(mission.lanes.program.records)}
    properties = [s.property for s in mission.table.values()] + [
        s.over for s in mission.table.values() if s.over is not None
    ]
    rows = to_signals(
        np.ascontiguousarray(records[[index[name] for name in properties]].T), mission.table
    )
    if np.any(records[index[OUT_OF_RANGE]] != 0.0):
        return RecordedFlight(list(mission.table), rows, "crashed", _BEYOND_REASON, end.flown_s)
    return RecordedFlight(list(mission.table), rows, end.status, end.reason, end.flown_s)


# Many flights at once: the results of ``flight.fly`` to rounding.

_RECORD_BYTES = 100_000_000
"""Memory for the records of lanes that are flown together."""
_FIXED = ("simulation/integrator/", "simulation/gravity-model")
"""Properties that select the program."""
_CACHE_SIZE = 24


_cache: dict[Hashable, CompiledMission] = {}
_translations: dict[Hashable, LaneMission] = {}


def fly_many(specs: Sequence[FlightSpec]) -> list[FlightResult]:
    """Fly and score flights.

    Parameters
    ----------
    specs : sequence of FlightSpec
        Any missions; flights of one program are flown together.

    Returns
    -------
    list of FlightResult
        In the order of ``specs``.

    Raises
    ------
    BadInputError
        As ``flight.fly``, and for what the batch engine does not support.
    """
    recorded = record_many(specs)
    staged = {
        mission: staged_mission(spec)
        for mission, spec in {(spec.aircraft, spec.script): spec for spec in specs}.items()
    }
    return [
        score(staged[spec.aircraft, spec.script], spec, one)
        for spec, one in zip(specs, recorded, strict=True)
    ]


def record_many(specs: Sequence[FlightSpec]) -> list[RecordedFlight]:
    """Fly flights without scoring; return what was recorded, in the order of ``specs``.

    Raises BadInputError as `fly_many`.
    """
    results: dict[int, RecordedFlight] = {}
    kinds: dict[Hashable, list[int]] = {}
    groups: dict[Hashable, list[int]] = {}
    # Flights of one program and one record length are flown together.
    for k, spec in enumerate(specs):
        length = (spec.duration_s, spec.burn_in_s, spec.record_rate_hz)
        kinds.setdefault((_program_key(spec, ()), length), []).append(k)
    for kind, places in kinds.items():
        every = frozenset(name for k in places for name in specs[k].properties)
        for k in places:
            names = frozenset(specs[k].properties)
            # The nominal model sets no levels: it keeps those of the XML in the corners' program.
            if not any(name.startswith("ic/") or name in CHANGEABLE for name in every - names):
                names = every
            groups.setdefault((kind, names), []).append(k)
    for places in groups.values():
        for part in _parts(specs, places):
            results.update(zip(part, _fly_alike([specs[k] for k in part]), strict=True))
    return [results[k] for k in range(len(specs))]


def _program_key(spec: FlightSpec, names: Collection[str]) -> tuple[Hashable, ...]:
    """Return what decides which program a flight needs, beginning with its files.

    ``names`` are the properties that flights of the program set.
    """
    fixed = tuple(sorted((n, float(v)) for n, v in spec.properties.items() if n.startswith(_FIXED)))
    air = (spec.turbulence != "none", spec.turbulence_source, spec.sensor_noise)
    moving = (
        spec.levels is not None,
        None if spec.transient is None else spec.transient.coefficients,
    )
    files = (str(spec.aircraft), str(spec.script))
    return (*files, air, moving, spec.record_rate_hz, fixed, tuple(sorted(names)))


def _parts(specs: Sequence[FlightSpec], places: Sequence[int]) -> Iterator[Sequence[int]]:
    """Split flights into groups whose records fit into memory.

    Flights of one air are adjacent, so that its streams are generated once.
    """
    spec = specs[places[0]]
    lane_bytes = max(1.0, spec.duration_s * spec.record_rate_hz) * 20 * 8
    max_lanes = max(8, int(_RECORD_BYTES / lane_bytes) // 8 * 8)
    ordered = sorted(places, key=lambda k: (specs[k].seed_turbulence, specs[k].seed_noise))
    return (ordered[k : k + max_lanes] for k in range(0, len(ordered), max_lanes))


def compiled_mission(spec: FlightSpec, names: Collection[str] | None = None) -> CompiledMission:
    """Return the translated mission of a flight, from a cache if possible.

    ``names`` are the properties that its flights set; by default those of ``spec``. Raises
    BadInputError for what the batch engine does not support.
    """
    staged = staged_mission(spec)
    names = spec.properties if names is None else names
    key = (id(staged), _program_key(spec, names))
    cached = _cache.get(key)
    # A mission that was staged anew needs a new program.
    if cached is None or cached.staged is not staged:
        signals = scored_signals(staged)
        # Integrators and gravity model select the program; all other properties are inputs.
        inputs = [name for name in names if not name.startswith(_FIXED)]
        needed = [s.property for s in signals.values()] + [
            s.over for s in signals.values() if s.over is not None
        ]
        records = list(dict.fromkeys([TIME, *needed, HEIGHT, SPEED, OUT_OF_RANGE]))
        # A campaign flies copies of one aircraft, which each process translates once.
        content = (staged.content, _program_key(spec, names)[2:], tuple(records))
        lanes = _translations.get(content)
        if lanes is None:
            lanes = _translations[content] = make_mission(
                staged, spec, inputs, records, [s.property for s in OPTIONAL_SIGNALS.values()]
            )
            while len(_translations) > _CACHE_SIZE:
                del _translations[next(iter(_translations))]
        else:
            lanes = lanes.of_copy(staged)
        optional = {
            name: s
            for name, s in OPTIONAL_SIGNALS.items()
            if s.property in lanes.flight.frame.records
        }
        cached = CompiledMission(staged, lanes, {"time_s": Source(TIME), **signals, **optional})
        # Drop the oldest missions.
        while len(_cache) >= _CACHE_SIZE:
            del _cache[next(iter(_cache))]
        _cache[key] = cached
    return cached


def _fly_alike(specs: Sequence[FlightSpec]) -> list[RecordedFlight]:
    """Fly flights of one program."""
    names = dict.fromkeys(name for spec in specs for name in spec.properties)
    course = Course.start(compiled_mission(specs[0], names), specs)
    course.fly()
    return course.recorded()


def forget() -> None:
    """Clear the cache of compiled missions."""
    _cache.clear()
    _translations.clear()


# Support of a mission by the batch engine.


def refusals(spec: FlightSpec, varying: Collection[str] = ()) -> tuple[str, ...]:
    """List what the batch engine does not support in a flight's aircraft and mission.

    Parameters
    ----------
    spec : FlightSpec
        The flight.
    varying : collection of str
        Properties that differ between flights, besides those that ``spec`` sets.

    Returns
    -------
    tuple of str
        Sentences with file and line; empty if the flight can be flown.
    """
    properties = {**dict.fromkeys(varying, 0.0), **spec.properties}
    try:
        compiled_mission(replace(spec, properties=properties))
    except BadInputError as error:
        return tuple(str(error).splitlines())
    return ()


def left_out_elements(spec: FlightSpec, varying: Collection[str] = ()) -> tuple[str, ...]:
    """List which elements of a flight's aircraft are left out, because nothing in it reads them.

    Parameters as `refusals`; sentences with file and line. Raises BadInputError for a flight that
    cannot be flown.
    """
    properties = {**dict.fromkeys(varying, 0.0), **spec.properties}
    return compiled_mission(replace(spec, properties=properties)).lanes.flight.left_out
