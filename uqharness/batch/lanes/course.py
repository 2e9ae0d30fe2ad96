"""Flights of one program in progress: begun, flown piece by piece, held, and taken up again in
other lanes.

A held flight is numbers alone: the slots of its lane (integrators' histories, filters, delays,
events, counters), what was recorded, where it stands. Its streams are functions of their seeds, its
splits and the frame, and are made again up to there."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.units import FT_M
from uqharness.batch.form.program import (
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
from uqharness.batch.lanes.mission import (
    AIR_WIND,
    WIND,
    LaneMission,
    Loaded,
    load_start,
    make_mission,
)
from uqharness.batch.lanes.streams import (
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
from uqharness.batch.machine.llvm import Target, choose_target
from uqharness.batch.models.auxiliary import POINT, TOUCHED
from uqharness.batch.models.motion import CONDITIONS, rounded, start_state
from uqharness.batch.models.winds import COUNTER, NORMALS
from uqharness.batch.translate.frame import BEYOND, TIME, canonical
from uqharness.errors import BadInputError
from uqharness.flight import (
    OPTIONAL_SIGNALS,
    TURBULENCE_W20_KT,
    ContactPoint,
    FlightResult,
    FlightSpec,
    LevelDriver,
    Recorded,
    Split,
    TransientDriver,
    dryden_parameters,
    first_levels,
    in_signals,
    record_stride,
    refuse_above_ceiling,
    row_counts,
    score,
    scored_signals,
    staged_mission,
)
from uqharness.simulator import CHANGEABLE, Source, StagedMission

# From the specification of flights to their state before the first frame: JSBSim's start, then
# the two initialising frames.

_TURNS = 200
"""Turns between two looks at whether engines have come to rest."""


@dataclass(frozen=True)
class Begun:
    """``values``: slot to its value in each lane behind the initialising frames.

    ``noise``: by seed, drawn up to there.
    """

    values: dict[str, FloatArray]
    noise: Mapping[int, Noise]


def begin(lanes: LaneMission, specs: Sequence[FlightSpec]) -> Begun:
    """Initialise. Raises BadInputError for a property that cannot be set, or that initialising has
    overwritten.
    """
    count = len(specs)
    loaded = _loaded(lanes, specs)
    values = start_state(
        {name: np.array([one.conditions[name] for one in loaded]) for name in CONDITIONS}
    )
    rows = [_given(lanes, one, spec) for one, spec in zip(loaded, specs, strict=True)]
    given = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    values |= given
    values |= {
        name: np.array([one.static[name] for one in loaded])
        for name in loaded[0].static
        if name not in given
    }
    wind, blown = (
        np.array([getattr(one, which) for one in loaded]) for which in ("wind_fps", "blown_fps")
    )
    noise = {
        s: Noise(
            s, lanes.flight.draws, lanes.flight.first_draws, initialising=3 if lanes.steady else 2
        )
        for s in dict.fromkeys(spec.seed_noise for spec in specs)
    }
    for number, flyer in enumerate(
        (*lanes.initialisers, *([lanes.renewer] if lanes.renewer is not None else []))
    ):
        if number == len(lanes.initialisers):
            settle(lanes.settlers, values, count)
        if number == 0:
            values |= {
                name: speed
                for name, speed in zip(WIND, wind.T, strict=True)
                if name in flyer.program.slots
            }
        drawn = np.array([noise[spec.seed_noise].initial[number] for spec in specs])
        values |= {f"#draw/{k}": drawn[:, k] for k in range(drawn.shape[1])}
        values |= step_once(flyer, values, count)
        if number == 1 and not lanes.air:
            values |= dict(zip(WIND, blown.T, strict=True))
    if lanes.points and (values[TOUCHED] >= 0.0).any():
        raise BadInputError(
            "the flight starts on the ground, where the batch engine computes no forces; fly it"
            ' with engine = "jsbsim"'
        )
    _require_kept(specs, given, values)
    return Begun(values, noise)


def settle(
    settlers: Sequence[tuple[str, Flyer]], values: dict[str, FloatArray], count: int
) -> None:
    """Bring every lane's engines to their steady state. settlers: as `compiled_settlers` gives
    them.
    """
    for going, flyer in settlers:
        program = flyer.program
        state = initial_state(
            program, count, {name: v for name, v in values.items() if name in program.slots}
        )
        while slot(program, state, going, count).any():
            flyer.fly(state, 1, _TURNS)
        values |= {name: slot(program, state, name, count) for name in program.slots}


def _loaded(lanes: LaneMission, specs: Sequence[FlightSpec]) -> list[Loaded]:
    """JSBSim is asked once for each start that differs."""
    found: dict[tuple[object, ...], Loaded] = {}
    out = []
    for spec in specs:
        own = tuple(
            (n, v)
            for n, v in sorted(spec.properties.items())
            if n.startswith("ic/") or n in CHANGEABLE
        )
        key = (spec.wind_mps, spec.wind_from_deg, spec.turbulence, own)
        if key not in found:
            found[key] = load_start(lanes, spec)
        out.append(found[key])
    return out


def _given(lanes: LaneMission, loaded: Loaded, spec: FlightSpec) -> dict[str, float]:
    """Properties that are set for a flight; mass and what follows from it as JSBSim has them."""
    blowing = (spec.wind_mps, spec.wind_from_deg, TURBULENCE_W20_KT[spec.turbulence])
    air = dict(zip(AIR_WIND, blowing, strict=True)) if lanes.air else {}
    asked = {**air, **first_levels(spec, lanes.dt_s), **spec.properties}
    return {
        name: loaded.static.get(name, float(value))
        for name, value in ((canonical(n), v) for n, v in asked.items())
    }


def _require_kept(
    specs: Sequence[FlightSpec], given: Mapping[str, FloatArray], values: Mapping[str, FloatArray]
) -> None:
    for name in specs[0].properties:
        if name.startswith("ic/") or name in CHANGEABLE:
            continue
        wanted, kept = given[canonical(name)], values[canonical(name)]
        moved = np.abs(kept - wanted) > 1e-9 * np.maximum(np.abs(wanted), 1.0)
        if moved.any():
            lane = int(np.argmax(moved))
            raise BadInputError(
                f"property {name} was set to {wanted[lane]:g} and stands at {kept[lane]:g} after"
                " initialising: the model computes it, so it cannot be set"
            )


# Streams of lanes: each air, noise and walk is made once, a piece at a time, and shared by all
# lanes that meet it.

Air = tuple[float, float, float]
"""Airspeed [m/s], height [m] and span [m] from which the host's gusts are made."""
Splits = tuple[Split, ...]


class Feeder:
    """Feeds of the next frames for the lanes that are still flying.

    airs: each lane's; begun: noise by seed, where the lanes stand before their first frame. Lanes
    that go on behind ``frame`` frames have ``splits``, and their streams are made anew up to there.
    """

    def __init__(
        self,
        lanes: LaneMission,
        specs: Sequence[FlightSpec],
        airs: Sequence[Air],
        begun: Mapping[int, Noise] | None = None,
        frame: int = 0,
        splits: Sequence[Splits] | None = None,
        target: Target | None = None,
    ) -> None:
        self._branching, self._target = False, target or choose_target()
        self._lanes, self._specs, self._airs, self._frame = lanes, specs, airs, frame
        self._splits = [()] * len(specs) if splits is None else splits
        self._program = lanes.program
        self._wanted = {stream.name for stream in self._program.streams}
        self._noise = noise_streams(lanes.flight.draws)
        self._noises: dict[tuple[int, Splits], Noise] = {
            (seed, ()): noise for seed, noise in (begun or {}).items()
        }
        self._series: dict[tuple[str, Hashable], Series] = {}
        self._windows: dict[Hashable, _Window] = {}

    def followed(self, lanes: Sequence[int], frame: int, splits: Sequence[Splits]) -> Feeder:
        """A feeder behind ``frame`` frames whose lane k goes on with lane ``lanes[k]`` of this one,
        which is given up: streams that are known go on where they stand, those of a new last split
        leave them there."""
        specs, airs = [self._specs[k] for k in lanes], [self._airs[k] for k in lanes]
        other = Feeder(self._lanes, specs, airs, None, frame, splits, self._target)
        other._branching = True
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
                    found = other._series[name] = self._series[name]
                    if isinstance(found, HostGusts):
                        found.branch_from_now_on()
            other._branch(self, place)
        return other

    def _branch(self, parent: Feeder, place: int) -> None:
        """Gusts of a lane that has just left its parent's."""
        key = self._air(place)
        *own, splits = key
        if splits and (GUSTS.name, key) not in self._series:
            source = parent._series.get((GUSTS.name, (*own, splits[:-1])))
            found = source.branched(splits[-1]) if isinstance(source, HostGusts) else None
            if found is not None:
                self._series[GUSTS.name, key] = found

    def feeds(self, alive: NDArray[np.intp], frames: int, state: FloatArray) -> dict[str, Feed]:
        """For ``frames`` frames on."""
        out: dict[str, Feed] = {}
        if self._noise:
            out |= self._noise_feeds(alive, frames)
        if GUSTS.name in self._wanted:
            out[GUSTS.name] = self._fed(
                GUSTS.name, [self._air(k) for k in alive], frames, self._gusts
            )
        if LEVELS.name in self._wanted:
            out[LEVELS.name] = self._fed(
                LEVELS.name, [(self._specs[k].levels, ()) for k in alive], frames, self._levels
            )
        if TRANSIENTS.name in self._wanted:
            drivers = [(self._specs[k].transient, self._splits[k]) for k in alive]
            out[TRANSIENTS.name] = self._fed(TRANSIENTS.name, drivers, frames, self._levels)
        if NORMALS.name in self._wanted:
            out[NORMALS.name] = self._turbulence(alive, frames, state)
        return out

    def _noise_feeds(self, alive: NDArray[np.intp], frames: int) -> dict[str, Feed]:
        seeds = [(self._specs[k].seed_noise, self._splits[k]) for k in alive]
        # What no lane meets any more stands still: nobody asks for it again.
        rows = {key: self._noise_of(*key).frames(frames) for key in dict.fromkeys(seeds)}
        out = {}
        for stream in self._noise:
            pieces = {seed: found[stream.name] for seed, found in rows.items()}
            out[stream.name] = share_feed(
                {s: p.array for s, p in pieces.items()},
                seeds,
                next(iter(pieces.values())).first_row,
            )
        return out

    def _noise_of(self, seed: int, splits: Splits) -> Noise:
        if (seed, splits) not in self._noises:
            flight, initialising = self._lanes.flight, 3 if self._lanes.steady else 2
            if splits:
                # Noise has no memory: that of the last split is all that is heard.
                made = Noise(
                    splits[-1].seed("noise"), flight.draws, 0, self._target, frame=splits[-1].frame
                )
                made.frames(self._frame - splits[-1].frame)
            else:
                made = Noise(seed, flight.draws, flight.first_draws, self._target, initialising)
                made.frames(self._frame)
            self._noises[seed, splits] = made
        return self._noises[seed, splits]

    def _fed(
        self, name: str, keys: Sequence[Hashable], frames: int, make: Callable[..., Series]
    ) -> Feed:
        pieces = {}
        first = 0
        for key in dict.fromkeys(keys):
            if (name, key) not in self._series:
                self._series[name, key] = make(key)
                self._series[name, key].rows(self._frame)
            array, first = self._series[name, key].rows(frames)
            pieces[key] = array
        return share_feed(pieces, keys, first)

    def _levels(self, key: tuple[LevelDriver | TransientDriver, Splits]) -> MovingLevels:
        return MovingLevels(key[0], self._lanes.dt_s, splits=key[1])

    def _air(self, lane: int) -> tuple[int, str, Air, Splits]:
        spec = self._specs[lane]
        return spec.seed_turbulence, spec.turbulence, self._airs[lane], self._splits[lane]

    def _gusts(self, key: tuple[int, str, Air, Splits]) -> HostGusts:
        seed, turbulence, (speed, height, span), splits = key
        refuse_above_ceiling(turbulence, height)
        made = HostGusts(
            dryden_parameters(speed, height, TURBULENCE_W20_KT[turbulence], span),
            self._lanes.dt_s,
            seed,
            self._target,
            splits,
        )
        if self._branching:
            made.branch_from_now_on()
        return made

    def _turbulence(self, alive: NDArray[np.intp], frames: int, state: FloatArray) -> Feed:
        """Lanes of one air may stand at different rows: each air keeps those that any of its lanes
        may still need.
        """
        counters = slot(self._program, state, COUNTER, len(alive)).astype(np.int64)
        seeds = [(self._specs[k].seed_turbulence, self._splits[k]) for k in alive]
        pieces = {}
        low = int(counters.min())
        for seed in dict.fromkeys(seeds):
            if seed not in self._windows:
                self._windows[seed] = _Window(_turbulence_of(*seed, self._target))
            window = self._windows[seed]
            pieces[seed] = window.from_to(low, int(counters.max()) + frames)
        return share_feed(pieces, seeds, low)


def airs_of(
    lanes: LaneMission, specs: Sequence[FlightSpec], values: Mapping[str, FloatArray]
) -> list[Air]:
    """Each lane's air, of its values behind initialising."""
    return [_air_of(lanes, spec, values, lane) for lane, spec in enumerate(specs)]


def _air_of(
    lanes: LaneMission, spec: FlightSpec, values: Mapping[str, FloatArray], lane: int
) -> Air:
    if lanes.air:
        speed = float(values["velocities/vt-fps"][lane]) * FT_M
    else:
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
    return rounded(max(speed, 1.0)), rounded(max(height, 3.048)), span


def _turbulence_of(seed: int, splits: Splits, target: Target) -> Series:
    """Normals alone: the filters are the aircraft's, so that the last split's are all that is
    heard.
    """
    if splits:
        return _Behind(
            Turbulence(splits[-1].seed("turbulence"), target, splits[-1].turbulence_row),
            splits[-1].turbulence_row,
        )
    return Turbulence(seed, target)


class _Behind:
    """A series that begins at a row: those before it, which nobody asks for, are NaN."""

    def __init__(self, series: Series, row: int) -> None:
        self._series, self._row = series, row

    def rows(self, n: int) -> Rows:
        """The next ``n`` rows."""
        lacking, self._row = min(n, self._row), max(self._row - n, 0)
        array, first = self._series.rows(n - lacking)
        return Rows(
            np.concatenate([np.full((lacking, array.shape[1]), np.nan), array]), first - lacking
        )


class _Window:
    """Rows of a series from where somebody still needs them."""

    def __init__(self, series: Series) -> None:
        self._series, self._first = series, 0
        self._held: FloatArray | None = None

    def from_to(self, first: int, last: int) -> FloatArray:
        known = 0 if self._held is None else len(self._held)
        lacking = last - (self._first + known)
        if lacking > 0 or self._held is None:
            new = self._series.rows(max(lacking, 1)).array
            self._held = new if self._held is None else np.concatenate([self._held, new])
        self._held = self._held[first - self._first :]
        self._first = first
        return self._held[: last - first]


HEIGHT, SPEED = "position/h-agl-ft", "velocities/vt-fps"
_CHUNK = 4000
"""Frames flown between two looks at which lanes have ended."""


_BEYOND_REASON = (
    "a function of the aircraft had an argument that JSBSim ends for (mod by 0, a condition that is"
    " neither 0 nor 1, a switch without such a case) or that is beyond the batch engine (sin, cos"
    " and tan beyond 1,600,000, fmod with a quotient beyond 2^50, mod beyond 32 bits); fly the"
    ' campaign with engine = "jsbsim"'
)


@dataclass(frozen=True)
class Ready:
    """A mission translated for flights that are alike. ``table`` is what is scored, by name."""

    staged: StagedMission
    lanes: LaneMission
    table: dict[str, Source]


@dataclass(frozen=True)
class End:
    """How a flight ended, or ``ok`` as long as it goes on."""

    status: str = "ok"
    reason: str = ""
    flown_s: float = 0.0


class Branch(NamedTuple):
    """Key of a branch's streams, to which each stream's kind is added."""

    root: int
    aleatory_id: int
    level: int
    branch: int


@dataclass(frozen=True)
class Held:
    """One flight behind ``frame`` frames: numbers that go on in any lane.

    state (slots,) in the order of the program; records (channels, rows) of the scored part so far;
    air from which the host's gusts are made; splits at which it branched; end, and whether it is
    still flying."""

    spec: FlightSpec
    frame: int
    state: FloatArray
    records: FloatArray
    air: Air
    splits: Splits
    end: End
    flying: bool

    def branched(self, made: Ready, root: int, aleatory_id: int, level: int, branch: int) -> Held:
        """The same flight whose air and noise go on with streams of that key.

        Raises ValueError for a flight that has ended.
        """
        if not self.flying:
            raise ValueError(
                f"the flight has ended ({self.end.status}): there is nothing to branch"
            )
        slots = list(made.lanes.program.slots)
        row = int(self.state[slots.index(COUNTER)]) if COUNTER in slots else 0
        return replace(
            self, splits=(*self.splits, Split(self.frame, root, aleatory_id, level, branch, row))
        )


class Course:
    """Flights side by side, all behind the same number of frames."""

    def __init__(self, made: Ready, held: Sequence[Held]) -> None:
        """Take held flights up, each in a lane of its own; one may come several times. Raises
        ValueError unless all stand behind the same frame."""
        frames = {one.frame for one in held}
        if len(frames) != 1:
            raise ValueError(
                f"flights of one course stand behind the same frame; received {sorted(frames)}"
            )
        self._made, self.frame = made, frames.pop()
        self._held = list(held)
        self._parts: list[list[FloatArray]] = [[one.records] for one in held]
        self._ends = [one.end for one in held]
        self._alive = np.array([k for k, one in enumerate(held) if one.flying], dtype=np.intp)
        if self._alive.size:
            self._state = to_blocks(
                list(np.array([held[k].state for k in self._alive]).T), len(self._alive)
            )
        self._feeder = Feeder(
            made.lanes,
            [one.spec for one in held],
            [one.air for one in held],
            None,
            self.frame,
            [one.splits for one in held],
        )

    @classmethod
    def begun(cls, made: Ready, specs: Sequence[FlightSpec]) -> Course:
        """Flights before their first frame.

        Raises BadInputError for a start that cannot be flown.
        """
        lanes, program = made.lanes, made.lanes.program
        started = begin(lanes, specs)
        burn, _ = row_counts(specs[0], lanes.dt_s * lanes.stride)
        airs = airs_of(lanes, specs, started.values)
        state = initial_state(
            program, len(specs), {n: v for n, v in started.values.items() if n in program.slots}
        )
        columns = np.array(from_blocks(state, len(specs))).T
        first = (
            _first_row(made, started.values, len(specs))[:, :, None]
            if burn == 0
            else np.empty((len(program.records), len(specs), 0))
        )
        course = cls(
            made,
            [
                Held(spec, 0, columns[k], first[:, k], airs[k], (), End(), True)
                for k, spec in enumerate(specs)
            ],
        )
        course._feeder = Feeder(lanes, specs, airs, started.noise)
        return course

    @property
    def last(self) -> int:
        """Frames of the whole flight."""
        stride = record_stride(self._held[0].spec, self._made.lanes.dt_s)
        return sum(row_counts(self._held[0].spec, self._made.lanes.dt_s * stride)) * stride

    def fly(self, frame: int | None = None) -> None:
        """Go on up to behind ``frame`` frames, default the end.

        Raises ValueError for a frame that is past, or is no row's.
        """
        lanes, program = self._made.lanes, self._made.lanes.program
        spec = self._held[0].spec
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
            skip = max(0, burn - self.frame // stride)
            ending = np.any(_over(records, columns, lanes.points), axis=1)
            going = []
            for place, lane in enumerate(self._alive):
                here = records[:, place, :]
                end, self._ends[lane] = (
                    _ended(here, columns, lanes.points)
                    if ending[place]
                    else (None, _going(here, columns))
                )
                self._parts[lane].append(
                    here[:, skip : rows if end is None else max(skip, end)].copy()
                )
                if end is None:
                    going.append(place)
            if len(going) < self._alive.size and going:
                self._state = select_lanes(self._state, going)
            self._alive = self._alive[going]
            self.frame += frames
        self.frame = goal

    def follow(self, lanes: Sequence[int], branches: Sequence[Branch | None]) -> None:
        """Go on with those lanes alone, in that order; one may come several times, and with a key
        it branches here.

        The bytes are those of ``held``, ``branched`` and another course, but streams go on where
        they stand and are not made anew. What was recorded so far is dropped. Raises ValueError for
        a lane that has ended, and for none at all."""
        if not lanes:
            raise ValueError("a course follows one lane at least; received none")
        place = {int(lane): k for k, lane in enumerate(self._alive)}
        ended = [lane for lane in lanes if lane not in place]
        if ended:
            raise ValueError(
                f"lane {ended[0]} has ended ({self._ends[ended[0]].status}): it cannot be followed"
            )
        program = self._made.lanes.program
        rows = (
            np.zeros(len(self._alive))
            if COUNTER not in program.slots
            else self.watched(COUNTER)[self._alive]
        )
        held = []
        for lane, key in zip(lanes, branches, strict=True):
            split = (
                ()
                if key is None
                else (Split(self.frame, *key, turbulence_row=int(rows[place[lane]])),)
            )
            held.append(replace(self._held[lane], splits=(*self._held[lane].splits, *split)))
        self._feeder = self._feeder.followed(lanes, self.frame, [one.splits for one in held])
        self._state = select_lanes(self._state, [place[lane] for lane in lanes])
        self._ends, self._held = [self._ends[lane] for lane in lanes], held
        self._alive = np.arange(len(held), dtype=np.intp)
        self._parts = [[one.records[:, :0]] for one in held]

    def taken(self) -> list[FloatArray]:
        """Each lane's rows (channels, rows) since the last call, in the order of the program's
        records; they are dropped here.
        """
        found = [
            np.concatenate(parts, axis=1) if len(parts) > 1 else parts[0] for parts in self._parts
        ]
        self._parts = [[part[:, :0]] for part in found]
        return found

    @property
    def ends(self) -> list[End]:
        """How each lane's flight stands."""
        return list(self._ends)

    @property
    def splits(self) -> list[Splits]:
        """Where each lane's flight branched so far."""
        return [one.splits for one in self._held]

    def watched(self, name: str) -> FloatArray:
        """(lanes,) a slot's value in each lane that is flying, NaN elsewhere.

        Raises ValueError for what is no slot.
        """
        out = np.full(len(self._held), np.nan)
        if self._alive.size:
            out[self._alive] = slot(self._made.lanes.program, self._state, name, len(self._alive))
        return out

    def held(self, lanes: Sequence[int] | None = None) -> list[Held]:
        """The flights of those lanes (all by default) as they stand."""
        wanted = range(len(self._held)) if lanes is None else lanes
        columns = (
            np.array(from_blocks(self._state, len(self._alive))).T
            if self._alive.size
            else np.empty((0, 0))
        )
        place = {int(lane): k for k, lane in enumerate(self._alive)}
        return [
            replace(
                self._held[k],
                frame=self.frame,
                records=np.concatenate(self._parts[k], axis=1),
                end=self._ends[k],
                flying=k in place,
                state=columns[place[k]].copy() if k in place else self._held[k].state,
            )
            for k in wanted
        ]

    def recorded(self) -> list[Recorded]:
        """What was recorded of each flight so far, to be scored."""
        found = zip(self._ends, self._parts, strict=True)
        return [_recorded(self._made, end, np.concatenate(parts, axis=1)) for end, parts in found]


def _over(
    records: FloatArray, columns: dict[str, int], points: Sequence[ContactPoint]
) -> NDArray[np.bool_]:
    """Rows (..., rows) of records (channels, ..., rows) in which a flight is over."""
    height, speed = records[columns[HEIGHT]], records[columns[SPEED]]
    over = np.asarray(~np.isfinite(height + speed) | (height <= 0.0))
    return np.asarray(over | (records[columns[TOUCHED]] >= 0.0)) if points else over


def _going(records: FloatArray, columns: dict[str, int]) -> End:
    return End(flown_s=float(records[columns[TIME], -1]))


def _ended(
    records: FloatArray, columns: dict[str, int], points: Sequence[ContactPoint]
) -> tuple[int | None, End]:
    """The row in which a lane's flight ended, None while it goes on, and how."""
    height, speed, time = (records[columns[name]] for name in (HEIGHT, SPEED, TIME))
    bad = ~np.isfinite(height + speed)
    touched = records[columns[TOUCHED]] if points else np.full(height.size, -1.0)
    over = _over(records, columns, points)
    if not over.any():
        return None, _going(records, columns)
    row = int(np.argmax(over))
    flown_s = float(time[row])
    if bad[row] and not touched[row] >= 0.0:
        return row, End("diverged", f"the state was no longer finite at {flown_s:.1f} s", flown_s)
    what = "the centre of gravity"
    if touched[row] >= 0.0:
        what, flown_s = points[int(records[columns[POINT], row])].name, float(touched[row])
    return row, End("ground-contact", f"{what} touched the ground at {flown_s:.1f} s", flown_s)


def _first_row(made: Ready, values: dict[str, FloatArray], lanes: int) -> FloatArray:
    """Recorded properties before the first frame (channels, lanes)."""
    slots = made.lanes.program.slots
    return np.stack(
        [
            np.broadcast_to(values.get(name, np.array(slots[name])), lanes)
            for name in made.lanes.program.records
        ]
    )


def _recorded(made: Ready, end: End, records: FloatArray) -> Recorded:
    index = {name: k for k, name in enumerate(made.lanes.program.records)}
    properties = [s.property for s in made.table.values()] + [
        s.over for s in made.table.values() if s.over is not None
    ]
    rows = in_signals(
        np.ascontiguousarray(records[[index[name] for name in properties]].T), made.table
    )
    if np.any(records[index[BEYOND]] != 0.0):
        return Recorded(list(made.table), rows, "crashed", _BEYOND_REASON, end.flown_s)
    return Recorded(list(made.table), rows, end.status, end.reason, end.flown_s)


# Many flights of one mission flown at once, each in its lane: what ``flight.fly`` gives for
# one, to the rounding of a double.

_RECORD_BYTES = 100_000_000
"""Records of lanes that are flown together."""
_FIXED = ("simulation/integrator/", "simulation/gravity-model")
"""Properties that decide which program flies."""
_KEPT = 24


_ready: dict[Hashable, Ready] = {}


def fly_many(specs: Sequence[FlightSpec]) -> list[FlightResult]:
    """Fly and score flights; results in the order given.

    Raises BadInputError as ``flight.fly`` does, and for what the batch engine does not understand.
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


def record_many(specs: Sequence[FlightSpec]) -> list[Recorded]:
    """Fly without scoring: what was recorded of each flight, in the order given.

    Raises BadInputError as ``fly_many`` does.
    """
    results: dict[int, Recorded] = {}
    groups: dict[Hashable, list[int]] = {}
    for k, spec in enumerate(specs):
        groups.setdefault(
            (_program_key(spec), spec.duration_s, spec.burn_in_s, spec.record_rate_hz), []
        ).append(k)
    for places in groups.values():
        for part in _parts(specs, places):
            results.update(zip(part, _fly_alike([specs[k] for k in part]), strict=True))
    return [results[k] for k in range(len(specs))]


def _program_key(spec: FlightSpec) -> Hashable:
    fixed = tuple(sorted((n, float(v)) for n, v in spec.properties.items() if n.startswith(_FIXED)))
    air = (spec.turbulence != "none", spec.turbulence_source, spec.sensor_noise)
    moving = (
        spec.levels is not None,
        None if spec.transient is None else spec.transient.coefficients,
    )
    flight = (str(spec.aircraft), str(spec.script), air, moving, spec.record_rate_hz)
    return (flight, fixed, tuple(sorted(spec.properties)))


def _parts(specs: Sequence[FlightSpec], places: Sequence[int]) -> Iterator[Sequence[int]]:
    """Groups whose records fit into memory; flights of one air stand together, so that its streams
    are made once.
    """
    spec = specs[places[0]]
    lane_bytes = max(1.0, spec.duration_s * spec.record_rate_hz) * 20 * 8
    most = max(8, int(_RECORD_BYTES / lane_bytes) // 8 * 8)
    ordered = sorted(places, key=lambda k: (specs[k].seed_turbulence, specs[k].seed_noise))
    return (ordered[k : k + most] for k in range(0, len(ordered), most))


def ready(spec: FlightSpec) -> Ready:
    """The mission of a flight, translated once for all flights that one program flies.

    Raises BadInputError.
    """
    staged = staged_mission(spec)
    key = (id(staged), _program_key(spec))
    found = _ready.get(key)
    if found is None or found.staged is not staged:
        signals = scored_signals(staged)
        inputs = [name for name in spec.properties if not name.startswith(_FIXED)]
        needed = [s.property for s in signals.values()] + [
            s.over for s in signals.values() if s.over is not None
        ]
        records = list(dict.fromkeys([TIME, *needed, HEIGHT, SPEED, BEYOND]))
        made = make_mission(
            staged, spec, inputs, records, [s.property for s in OPTIONAL_SIGNALS.values()]
        )
        there = {
            name: s
            for name, s in OPTIONAL_SIGNALS.items()
            if s.property in made.flight.frame.records
        }
        found = Ready(staged, made, {"time_s": Source(TIME), **signals, **there})
        while len(_ready) >= _KEPT:
            del _ready[next(iter(_ready))]
        _ready[key] = found
    return found


def _fly_alike(specs: Sequence[FlightSpec]) -> list[Recorded]:
    course = Course.begun(ready(specs[0]), specs)
    course.fly()
    return course.recorded()


def forget() -> None:
    """Forget compiled missions: the next flights are translated and compiled anew."""
    _ready.clear()


# Whether the batch engine can fly a mission here, and if not, why.


def refusals(spec: FlightSpec, varying: Collection[str] = ()) -> tuple[str, ...]:
    """Sentences, with file and line, on what is not understood of a flight's aircraft and mission;
    empty: it can be flown.

    varying: properties that differ between flights, beside those that ``spec`` sets.
    """
    properties = {**dict.fromkeys(varying, 0.0), **spec.properties}
    try:
        ready(replace(spec, properties=properties))
    except BadInputError as error:
        return tuple(str(error).splitlines())
    return ()
