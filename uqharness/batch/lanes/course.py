"""Flights of one program in progress: begun, flown piece by piece, held, and taken up again in other lanes.

A held flight is numbers alone: the slots of its lane (integrators' histories, filters, delays, events, counters), what was
recorded, where it stands. Its streams are functions of their seeds, its splits and the frame, and are made again up to there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from uqharness.batch.form.flying import begun, blocked, chosen, slot, unblocked
from uqharness.batch.lanes.begin import begin
from uqharness.batch.lanes.feeds import Air, Feeder, Splits, airs_of
from uqharness.batch.lanes.mission import LaneMission
from uqharness.batch.models.ground import POINT, TOUCHED
from uqharness.batch.models.winds import COUNTER
from uqharness.batch.translate.frame import BEYOND, TIME
from uqharness.flight import (
    ContactPoint,
    FlightSpec,
    Recorded,
    Split,
    in_signals,
    record_stride,
    row_counts,
)
from uqharness.simulator import Source, StagedMission

HEIGHT, SPEED = "position/h-agl-ft", "velocities/vt-fps"
_CHUNK = 4000
"""Frames flown between two looks at which lanes have ended."""


_BEYOND_REASON = (
    "a function of the aircraft had an argument that JSBSim ends for (mod by 0, a condition that is neither 0 "
    "nor 1, a switch without such a case) or that is beyond the batch engine (sin, cos and tan beyond 1,600,000, "
    'fmod with a quotient beyond 2^50, mod beyond 32 bits); fly the campaign with engine = "jsbsim"'
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

    state (slots,) in the order of the program; records (channels, rows) of the scored part so far; air from which the host's
    gusts are made; splits at which it branched; end, and whether it is still flying.
    """

    spec: FlightSpec
    frame: int
    state: FloatArray
    records: FloatArray
    air: Air
    splits: Splits
    end: End
    flying: bool

    def branched(self, made: Ready, root: int, aleatory_id: int, level: int, branch: int) -> Held:
        """The same flight whose air and noise go on with streams of that key. Raises ValueError for a flight that has ended."""
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
        """Take held flights up, each in a lane of its own; one may come several times. Raises ValueError unless all stand behind
        the same frame."""
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
            self._state = blocked(
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
        """Flights before their first frame. Raises BadInputError for a start that cannot be flown."""
        lanes, program = made.lanes, made.lanes.program
        started = begin(lanes, specs)
        burn, _ = row_counts(specs[0], lanes.dt_s * lanes.stride)
        airs = airs_of(lanes, specs, started.values)
        state = begun(
            program, len(specs), {n: v for n, v in started.values.items() if n in program.slots}
        )
        columns = np.array(unblocked(state, len(specs))).T
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
        """Go on up to behind ``frame`` frames, default the end. Raises ValueError for a frame that is past, or is no row's."""
        lanes, program = self._made.lanes, self._made.lanes.program
        spec = self._held[0].spec
        stride = record_stride(spec, lanes.dt_s)
        goal = self.last if frame is None else frame
        if goal < self.frame or goal > self.last or goal % stride:
            raise ValueError(
                f"a frame from {self.frame} to {self.last} that {stride} divides is needed; received {goal}"
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
                self._state = chosen(self._state, going)
            self._alive = self._alive[going]
            self.frame += frames
        self.frame = goal

    def follow(self, lanes: Sequence[int], branches: Sequence[Branch | None]) -> None:
        """Go on with those lanes alone, in that order; one may come several times, and with a key it branches here.

        The bytes are those of ``held``, ``branched`` and another course, but streams go on where they stand and are not made anew.
        What was recorded so far is dropped. Raises ValueError for a lane that has ended, and for none at all.
        """
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
        self._state = chosen(self._state, [place[lane] for lane in lanes])
        self._ends, self._held = [self._ends[lane] for lane in lanes], held
        self._alive = np.arange(len(held), dtype=np.intp)
        self._parts = [[one.records[:, :0]] for one in held]

    def taken(self) -> list[FloatArray]:
        """Each lane's rows (channels, rows) since the last call, in the order of the program's records; they are dropped here."""
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
        """(lanes,) a slot's value in each lane that is flying, NaN elsewhere. Raises ValueError for what is no slot."""
        out = np.full(len(self._held), np.nan)
        if self._alive.size:
            out[self._alive] = slot(self._made.lanes.program, self._state, name, len(self._alive))
        return out

    def held(self, lanes: Sequence[int] | None = None) -> list[Held]:
        """The flights of those lanes (all by default) as they stand."""
        wanted = range(len(self._held)) if lanes is None else lanes
        columns = (
            np.array(unblocked(self._state, len(self._alive))).T
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
