"""Replays as the estimators want them: outputs as a function of one vector, with a memory, so that little is flown twice."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from uqharness.replay.in_lanes import ReplayJob, as_flown, fly_all
from uqharness.replay.model import ReplayModel
from uqharness.replay.replay import (
    CHANNELS,
    CONTROL_DELAY,
    SENSOR_OF,
    STATES,
    UNSEEN,
    at_rows,
    late_rows,
    shape_of,
)
from uqharness.replay.segments import Segment

_CACHE_BYTES = 300_000_000
_TOGETHER_BYTES = _CACHE_BYTES // 4
"""Of pieces flown together: all are read before the first is forgotten, and what they are compared with stays besides."""
_RESTING_BYTES = _CACHE_BYTES // 4
"""Of pieces that stay when many points have been read: those of the point that all of them are near."""
Start = tuple[FloatArray, float, float]
"""Start state (9,), how late the controls act [s], share of a jump unseen."""


class Replay:
    """simulate(theta) of a set of segments, for the estimators: picklable, with the runs of late memory kept.

    theta is laid out by ``names``: JSBSim properties; ``bias/<flight>/<channel>`` added to an output;
    ``delay/<flight>/<sensor>`` by which a sensor's outputs come late, s (SENSOR_OF), or, for CONTROL_DELAY, by which the controls
    act late; ``unseen/<flight>`` the share of a control's jump that the accelerometers of its row have not seen; and
    ``start/<segment number>/<state>`` added to a segment's start state. What a perturbed value does not touch is
    not flown again.
    channels: which of CHANNELS are returned; late_s: channel -> known time by which it comes late besides.
    """

    def __init__(
        self,
        model: ReplayModel,
        segments: Sequence[Segment],
        names: Sequence[str],
        channels: Sequence[str],
        token: str,
        base: Mapping[str, float] | None = None,
        late_s: Mapping[str, float] | None = None,
    ) -> None:
        self.model, self.segments, self.names = model, tuple(segments), tuple(names)
        self.channels, self.token = tuple(channels), token
        self.base = dict(base or {})
        self._late_s = {self.channels.index(c): s for c, s in (late_s or {}).items() if s != 0.0}
        self._columns = [CHANNELS.index(c) for c in channels]
        self._properties = [
            (i, n)
            for i, n in enumerate(names)
            if not n.startswith(("bias/", "delay/", "start/", f"{UNSEEN}/"))
        ]
        self._biases: dict[str, list[tuple[int, int]]] = {}
        self._delays: dict[str, list[tuple[int, int]]] = {}
        self._starts: dict[int, list[tuple[int, int]]] = {}
        self._late: dict[str, int] = {}
        self._unseen: dict[str, int] = {}
        self._kept: dict[int, tuple[tuple[tuple[_Key, ...], bytes], FloatArray]] = {}
        self._sizes: list[int] = []
        for i, name in enumerate(names):
            kind, _, rest = name.partition("/")
            where, _, what = rest.rpartition("/")
            if kind == UNSEEN:
                self._unseen[rest] = i
            elif kind == "bias" and what in self.channels:
                self._biases.setdefault(where, []).append((i, self.channels.index(what)))
            elif kind == "delay" and what == CONTROL_DELAY:
                self._late[where] = i
            elif kind == "delay":
                late = [k for k, c in enumerate(self.channels) if SENSOR_OF.get(c, c) == what]
                self._delays.setdefault(where, []).extend((i, k) for k in late)
            elif kind == "start":
                self._starts.setdefault(int(where), []).append((i, STATES.index(what)))
        for segment in self.segments:
            rows = shape_of(
                model, segment, segment.flight in self._delays or bool(self._late_s)
            ).rows
            self._sizes.append(rows * len(CHANNELS) * 8)

    def moved(self, index: int) -> tuple[int, ...] | None:
        """Numbers of the segments whose outputs theta's element moves, None for all."""
        kind, _, rest = self.names[index].partition("/")
        if kind == "start":
            return (int(rest.partition("/")[0]),)
        flight = (
            rest
            if kind == UNSEEN
            else rest.rpartition("/")[0]
            if kind in ("bias", "delay")
            else None
        )
        return (
            None
            if flight is None
            else tuple(k for k, s in enumerate(self.segments) if s.flight == flight)
        )

    def starts_at(self, theta: FloatArray) -> list[Start]:
        """Every segment's start state (9,), how late its controls act [s], and what share of a jump is unseen, at theta."""
        starts = []
        for number, segment in enumerate(self.segments):
            start = segment.start.copy()
            for i, k in self._starts.get(number, ()):
                start[k] += theta[i]
            late, unseen = (
                float(theta[of[segment.flight]]) if segment.flight in of else 0.0
                for of in (self._late, self._unseen)
            )
            starts.append((start, late, unseen))
        return starts

    def _conditions(self, theta: FloatArray) -> tuple[dict[str, float], list[Start]]:
        """Properties, and every segment's start state and timing of the controls, at theta."""
        return {**self.base, **{n: float(theta[i]) for i, n in self._properties}}, self.starts_at(
            theta
        )

    def __call__(self, theta: FloatArray) -> list[FloatArray]:
        """[(n, m)] outputs, one array a segment."""
        self.fetch([theta], map)
        properties, starts = self._conditions(theta)
        return [
            self._sensed(segment, number, theta, self._pieces(number, segment, properties, start))
            for number, (segment, start) in enumerate(zip(self.segments, starts, strict=True))
        ]

    def _sensed(
        self, segment: Segment, number: int, theta: FloatArray, pieces: Mapping[_Key, ReplayJob]
    ) -> FloatArray:
        """(n, m) outputs of one segment with its flight's delays and biases; the last ones are kept."""
        late, biased = self._delays.get(segment.flight, []), self._biases.get(segment.flight, [])
        state = (tuple(pieces), theta[[i for i, _ in (*late, *biased)]].tobytes())
        kept = self._kept.get(number)
        if kept is not None and kept[0] == state:
            return kept[1]
        n = len(segment.time_s)
        between, *rows = (self._flown(key, job)[:, self._columns] for key, job in pieces.items())
        flown = (rows[0] if rows else at_rows(between, n)).copy()
        late_s = dict(self._late_s)
        for i, k in late:
            late_s[k] = late_s.get(k, 0.0) + float(theta[i])
        for k, seconds in late_s.items():
            if seconds != 0.0:
                flown[:, k] = late_rows(between[:, k], n, seconds / segment.dt_s)
        for i, k in biased:
            flown[:, k] += theta[i]
        flown.setflags(write=False)
        self._kept[number] = (state, flown)
        return flown

    def _flown(self, key: _Key, job: ReplayJob) -> FloatArray:
        found = _flown.get(key)
        if found is None:
            (found,) = fly_all([job])
            _remember(key, found)
        else:
            _flown.move_to_end(key)
        return found

    def _pieces(
        self, number: int, segment: Segment, properties: Mapping[str, float], conditions: Start
    ) -> dict[_Key, ReplayJob]:
        """Replays of one segment by what makes them, as `as_flown` has them."""
        start, late_s, unseen = conditions
        between = segment.flight in self._delays or bool(self._late_s)
        late = {*self._late_s, *(k for _, k in self._delays.get(segment.flight, ()))}
        on_time = [c for k, c in enumerate(self.channels) if k not in late]
        jobs = as_flown(
            ReplayJob(self.model, segment, dict(properties), start, late_s, between, unseen=unseen),
            on_time,
        )
        made = (self.token, number, np.array(list(properties.values())).tobytes(), start.tobytes())
        return {(*made, late_s, job.unseen, job.between): job for job in jobs}

    def forget(self) -> None:
        """Let go of what is remembered of this replay and its copies: nothing more will be asked of it."""
        for key in [k for k in _flown if k[0] == self.token]:
            counter["bytes"] -= _flown.pop(key).nbytes

    def fetch(self, thetas: Sequence[FloatArray], map_: Callable[..., Iterable[Any]]) -> None:
        """Fly whatever several theta need and nobody remembers, each piece once, by ``map_`` (a process pool's, say).

        Afterwards every ``self(theta)`` only puts together what is remembered: little has to travel between processes.
        """
        for _ in self.fetched(thetas, map_):
            pass

    def rest(self) -> None:
        """Let go of most pieces: those asked for last stay."""
        _shrink(_RESTING_BYTES)

    def fetched(
        self, thetas: Sequence[FloatArray], map_: Callable[..., Iterable[Any]]
    ) -> Iterator[FloatArray]:
        """Each theta as soon as its pieces have been flown, each once; those of so many theta together as are remembered until they
        are asked for."""
        jobs: dict[_Key, ReplayJob] = {}
        waiting: list[FloatArray] = []
        size = 0
        for theta in thetas:
            properties, starts = self._conditions(theta)
            for number, (segment, start) in enumerate(zip(self.segments, starts, strict=True)):
                for key, job in self._pieces(number, segment, properties, start).items():
                    if key in _flown:
                        _flown.move_to_end(key)
                    elif key not in jobs:
                        jobs[key] = job
                        size += self._sizes[number]
            waiting.append(theta)
            if size > _TOGETHER_BYTES:
                _fly(jobs, map_)
                yield from waiting
                jobs, waiting, size = {}, [], 0
        _fly(jobs, map_)
        yield from waiting


# Memory of the process, shared by unpickled copies of a replay: perturbing one segment's start leaves the others as they were.
_Key = tuple[str, int, bytes, bytes, float, float, bool]
_flown: OrderedDict[_Key, FloatArray] = OrderedDict()
counter = {"rows": 0, "bytes": 0, "segments": 0}


def _fly(jobs: Mapping[_Key, ReplayJob], map_: Callable[..., Iterable[Any]]) -> None:
    for key, found in zip(jobs, fly_all(list(jobs.values()), map_), strict=True):
        _remember(key, found)


def _remember(key: _Key, found: FloatArray) -> None:
    _flown[key] = found
    counter["rows"] += len(found)
    counter["segments"] += 1
    counter["bytes"] += found.nbytes
    _shrink(_CACHE_BYTES)


def _shrink(most: int) -> None:
    while counter["bytes"] > most:
        counter["bytes"] -= _flown.popitem(last=False)[1].nbytes
