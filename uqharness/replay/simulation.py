"""Replays as functions of one parameter vector, for the estimators.

`Replay` maps theta (parameters, sensor biases, delays, start states) to the outputs of all
segments. Simulations are cached per process, so that perturbing one element of theta repeats only
the segments that it affects. `replay_pool` flies the replays of many points together;
`nuisance_layout` builds theta's nuisance part.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from uqharness.parallel import process_count, process_pool
from uqharness.replay.flights import Flight
from uqharness.replay.in_lanes import ReplayJob, fly_all, split_job
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

_MAX_CACHE_BYTES = 300_000_000
_MAX_PENDING_BYTES = _MAX_CACHE_BYTES // 4
"""Bytes of simulations flown together: all of them must stay cached until they are read."""
_MAX_IDLE_BYTES = _MAX_CACHE_BYTES // 4
"""Bytes that stay cached after many points were read: those of the point that all are near."""
Start = tuple[FloatArray, float, float]
"""Start state (9,), delay of the controls [s], unseen share of a jump."""


class Replay:
    """Outputs of a set of segments as a function of theta; picklable.

    Parameters
    ----------
    model : ReplayModel
        The aircraft.
    segments : sequence of Segment
        What is replayed.
    names : sequence of str
        The elements of theta, see Notes.
    channels : sequence of str
        Which of CHANNELS are returned.
    token : str
        Unique name of this replay, the key of its cached simulations.
    base : Mapping, optional
        Properties set in all replays.
    late_s : Mapping, optional
        Channel to a known delay [s], in addition to an estimated one.

    Notes
    -----
    Names of theta's elements are JSBSim properties; ``bias/<flight>/<channel>``, added to an
    output; ``delay/<flight>/<sensor>``, the delay of a sensor's outputs (SENSOR_OF) or, for
    CONTROL_DELAY, of the controls [s]; ``unseen/<flight>``, the share of a jump that the
    accelerometers of its row have not seen; ``start/<segment number>/<state>``, added to a
    segment's start state.
    """

    def __init__(
        self,
        model: ReplayModel,
        segments: Sequence[Segment],
        names: Sequence[str],
        channels: Sequence[str],
        token: str,
        *,
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
        self._last_outputs: dict[int, tuple[tuple[tuple[_Key, ...], bytes], FloatArray]] = {}
        self._sizes: list[int] = []
        # Sort theta's elements by what they affect.
        for i, name in enumerate(names):
            kind, _, target = name.partition("/")
            where, _, element = target.rpartition("/")
            if kind == UNSEEN:
                self._unseen[target] = i
            elif kind == "bias" and element in self.channels:
                self._biases.setdefault(where, []).append((i, self.channels.index(element)))
            elif kind == "delay" and element == CONTROL_DELAY:
                self._late[where] = i
            elif kind == "delay":
                late = [k for k, c in enumerate(self.channels) if SENSOR_OF.get(c, c) == element]
                self._delays.setdefault(where, []).extend((i, k) for k in late)
            elif kind == "start":
                self._starts.setdefault(int(where), []).append((i, STATES.index(element)))
        for segment in self.segments:
            rows = shape_of(
                model, segment, segment.flight in self._delays or bool(self._late_s)
            ).rows
            self._sizes.append(rows * len(CHANNELS) * 8)

    def moved(self, index: int) -> tuple[int, ...] | None:
        """Return the numbers of the segments that an element of theta affects, None for all."""
        kind, _, target = self.names[index].partition("/")
        if kind == "start":
            return (int(target.partition("/")[0]),)
        # Only properties affect all segments.
        flight = (
            target
            if kind == UNSEEN
            else target.rpartition("/")[0]
            if kind in ("bias", "delay")
            else None
        )
        return (
            None
            if flight is None
            else tuple(k for k, s in enumerate(self.segments) if s.flight == flight)
        )

    def starts_at(self, theta: FloatArray) -> list[Start]:
        """Return each segment's start state (9,), control delay [s] and unseen share of a jump at
        theta.
        """
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
        """Return the properties, and each segment's start state and control timing, at theta."""
        return {**self.base, **{n: float(theta[i]) for i, n in self._properties}}, self.starts_at(
            theta
        )

    def __call__(self, theta: FloatArray) -> list[FloatArray]:
        """Return the outputs (n, m) of every segment at theta."""
        self.fetch([theta], map)
        properties, starts = self._conditions(theta)
        return [
            self._sensed(segment, number, theta, self._pieces(number, segment, properties, start))
            for number, (segment, start) in enumerate(zip(self.segments, starts, strict=True))
        ]

    def _sensed(
        self, segment: Segment, number: int, theta: FloatArray, pieces: Mapping[_Key, ReplayJob]
    ) -> FloatArray:
        """Return the outputs (n, m) of one segment with delays and biases; the latest are
        cached.
        """
        late, biased = self._delays.get(segment.flight, []), self._biases.get(segment.flight, [])
        # Equal simulations with equal delays and biases give equal outputs.
        state = (tuple(pieces), theta[[i for i, _ in (*late, *biased)]].tobytes())
        cached = self._last_outputs.get(number)
        if cached is not None and cached[0] == state:
            return cached[1]
        n = len(segment.time_s)
        # The first replay may have outputs between rows, for delayed sensors; a second one has rows
        # only.
        between, *rows = (
            self._fly_cached(key, job)[:, self._columns] for key, job in pieces.items()
        )
        outputs = (rows[0] if rows else at_rows(between, n)).copy()
        late_s = dict(self._late_s)
        for i, k in late:
            late_s[k] = late_s.get(k, 0.0) + float(theta[i])
        for k, seconds in late_s.items():
            if seconds != 0.0:
                outputs[:, k] = late_rows(between[:, k], n, seconds / segment.dt_s)
        for i, k in biased:
            outputs[:, k] += theta[i]
        outputs.setflags(write=False)
        self._last_outputs[number] = (state, outputs)
        return outputs

    def _fly_cached(self, key: _Key, job: ReplayJob) -> FloatArray:
        """Return a simulation from the cache, or fly it."""
        rows = _replay_cache.get(key)
        if rows is None:
            (rows,) = fly_all([job])
            _remember(key, rows)
        else:
            _replay_cache.move_to_end(key)
        return rows

    def _pieces(
        self, number: int, segment: Segment, properties: Mapping[str, float], conditions: Start
    ) -> dict[_Key, ReplayJob]:
        """Return the simulations of one segment by their cache keys, as `split_job` divides
        them.
        """
        start, late_s, unseen = conditions
        between = segment.flight in self._delays or bool(self._late_s)
        late = {*self._late_s, *(k for _, k in self._delays.get(segment.flight, ()))}
        # Sensors without a delay are read at the rows themselves.
        on_time = [c for k, c in enumerate(self.channels) if k not in late]
        jobs = split_job(
            ReplayJob(self.model, segment, dict(properties), start, late_s, between, unseen=unseen),
            on_time,
        )
        key = (self.token, number, np.array(list(properties.values())).tobytes(), start.tobytes())
        return {(*key, late_s, job.unseen, job.between): job for job in jobs}

    def forget(self) -> None:
        """Remove the cached simulations of this replay and its copies."""
        for key in [k for k in _replay_cache if k[0] == self.token]:
            counter["bytes"] -= _replay_cache.pop(key).nbytes

    def fetch(self, thetas: Sequence[FloatArray], pool: Callable[..., Iterable[Any]]) -> None:
        """Fly whatever several theta need and is not cached, each simulation once.

        ``pool`` is a `map`, a process pool's for example. Afterwards ``self(theta)`` only reads the
        cache, so little travels between processes.
        """
        for _ in self.fetched(thetas, pool):
            pass

    def shrink_memory(self) -> None:
        """Remove all but the most recent simulations from the cache."""
        _shrink(_MAX_IDLE_BYTES)

    def fetched(
        self, thetas: Sequence[FloatArray], pool: Callable[..., Iterable[Any]]
    ) -> Iterator[FloatArray]:
        """Yield each theta as soon as its simulations are cached, as many together as the cache can
        hold.
        """
        jobs: dict[_Key, ReplayJob] = {}
        waiting: list[FloatArray] = []
        size = 0
        for theta in thetas:
            properties, starts = self._conditions(theta)
            for number, (segment, start) in enumerate(zip(self.segments, starts, strict=True)):
                for key, job in self._pieces(number, segment, properties, start).items():
                    if key in _replay_cache:
                        _replay_cache.move_to_end(key)
                    elif key not in jobs:
                        jobs[key] = job
                        size += self._sizes[number]
            waiting.append(theta)
            # Fly what has accumulated before the cache would have to drop any of it.
            if size > _MAX_PENDING_BYTES:
                _fly(jobs, pool)
                yield from waiting
                jobs, waiting, size = {}, [], 0
        _fly(jobs, pool)
        yield from waiting


# Cache of the process, shared by unpickled copies of a replay.
_Key = tuple[str, int, bytes, bytes, float, float, bool]
_replay_cache: OrderedDict[_Key, FloatArray] = OrderedDict()
counter = {"rows": 0, "bytes": 0, "segments": 0}


def _fly(jobs: Mapping[_Key, ReplayJob], pool: Callable[..., Iterable[Any]]) -> None:
    """Fly jobs and cache the results."""
    for key, rows in zip(jobs, fly_all(list(jobs.values()), pool), strict=True):
        _remember(key, rows)


def _remember(key: _Key, rows: FloatArray) -> None:
    """Add a simulation to the cache and to the counters of progress."""
    _replay_cache[key] = rows
    counter["rows"] += len(rows)
    counter["segments"] += 1
    counter["bytes"] += rows.nbytes
    _shrink(_MAX_CACHE_BYTES)


def _shrink(max_bytes: int) -> None:
    """Remove the oldest simulations above a number of bytes."""
    while counter["bytes"] > max_bytes:
        counter["bytes"] -= _replay_cache.popitem(last=False)[1].nbytes


# Replays of many points at once, by the batch engine or in worker processes; simulations that
# points share are flown once.


def batched_pool(pool: Callable[..., Any]) -> Callable[..., Iterable[Any]]:
    """Return a `map` for output error that flies the replays of its points together.

    As many as fit the cache are flown at once, and results are returned one by one. ``pool``
    distributes what JSBSim flies.
    """

    def mapped(function: Callable[[FloatArray], Any], points: Any) -> Iterable[Any]:
        # Output error maps a callable object whose attribute ``simulate`` is the replay.
        replay = getattr(function, "simulate", None)
        return (
            _map_replays(function, replay, list(points), pool)
            if isinstance(replay, Replay)
            else map(function, list(points))
        )

    return mapped


def _map_replays(
    function: Callable[[FloatArray], Any],
    replay: Replay,
    points: list[FloatArray],
    pool: Callable[..., Any],
) -> Iterator[Any]:
    """Evaluate a function at points whose simulations are fetched in advance."""
    yield from map(function, replay.fetched(points, pool))
    replay.shrink_memory()


@contextmanager
def replay_pool(workers: int | None = None) -> Any:
    """Yield a `map` for output error that flies the replays of all its points together.

    What JSBSim flies is distributed to ``workers`` processes, started when first needed; one worker
    is this process.
    """
    count = process_count(workers)
    with ExitStack() as stack:
        executor: Any = None

        def by_processes(function: Callable[[Any], Any], jobs: Sequence[Any]) -> Any:
            # Started when the first replay is one that the batch engine does not fly.
            nonlocal executor
            if count == 1:
                return map(function, jobs)
            executor = executor or stack.enter_context(process_pool(count))
            return executor.map(function, jobs, chunksize=max(1, len(jobs) // (8 * count)))

        yield batched_pool(by_processes)


# The nuisance part of theta: sensor biases, delays and start states.

_FREE_STARTS = (
    "V_mps",
    "alpha_rad",
    "beta_rad",
    "phi_rad",
    "theta_rad",
    "p_radps",
    "q_radps",
    "r_radps",
)
_START_WIDTH = {"V_mps": 6.0, "alpha_rad": 0.2, "beta_rad": 0.2, "phi_rad": 0.3, "theta_rad": 0.2}
_BIAS_WIDTH = {"V_mps": 5.0, "ax_mps2": 2.0, "ay_mps2": 2.0, "az_mps2": 2.0}
_DEFAULT_WIDTH = 0.5
_DELAY_WIDTH = 0.15
SHARES = (0.0, 1.0)
"""Bounds of the unseen share of a jump: none and all of it."""
_REFERENCE = SENSOR_OF["p_radps"]


@dataclass(frozen=True)
class Layout:
    """Names and bounds of theta: parameters first, then biases, delays, shares and start states."""

    names: tuple[str, ...]
    bounds: list[tuple[float, float]]


def nuisance_layout(
    names: Sequence[str],
    limits: Sequence[tuple[float, float]],
    segments: Sequence[Segment],
    biases: Sequence[str],
    outputs: Sequence[str],
    *,
    late: Mapping[str, Sequence[str]],
    jumping: Sequence[str] = (),
) -> Layout:
    """Extend parameters by the nuisance parameters of a fit.

    Parameters
    ----------
    names, limits : sequence
        Parameters and their bounds.
    segments : sequence of Segment
        What is replayed.
    biases : sequence of str
        Channels with one constant bias a flight.
    outputs : sequence of str
        Fitted channels; start states are free for those among them and for those
        that the record lacks.
    late : Mapping
        Flight to the sensors, or CONTROL_DELAY, whose delay is estimated.
    jumping : sequence of str
        Flights with an unseen share of jumps.

    Returns
    -------
    Layout
        Names and bounds of the complete theta.
    """
    extra, bounds = [], list(limits)
    for flight in dict.fromkeys(s.flight for s in segments):
        for channel in biases:
            extra.append(f"bias/{flight}/{channel}")
            width = _BIAS_WIDTH.get(channel, 0.1)
            bounds.append((-width, width))
    for flight, channels in late.items():
        extra += [f"delay/{flight}/{channel}" for channel in channels]
        bounds += [(-_DELAY_WIDTH, _DELAY_WIDTH)] * len(channels)
    extra += [f"{UNSEEN}/{flight}" for flight in jumping]
    bounds += [SHARES] * len(jumping)
    # The initial heading is not free: the heading is no fitted output.
    for number, segment in enumerate(segments):
        for state in _FREE_STARTS:
            # The motion shows where an angle without a vane begins.
            if state not in outputs and state not in segment.unmeasured:
                continue
            extra.append(f"start/{number}/{state}")
            width = _START_WIDTH.get(state, _DEFAULT_WIDTH)
            if segment.reach is not None:
                # A delayed sensor shows the start a few rows later, after a fast mode has moved on.
                width += float(segment.reach[STATES.index(state)])
            bounds.append((-width, width))
    return Layout((*names, *extra), bounds)


def delayed(
    flights: Sequence[Flight], outputs: Sequence[str], requested: Sequence[str] | None
) -> dict[str, list[str]]:
    """Return flight to the sensors, or CONTROL_DELAY, whose delays are estimated.

    By default the controls of every flight, because the actuation began somewhere within the sample
    of its command, and in logs every sensor but the gyros, because channels are stamped when
    written; the gyros are the reference. ``requested`` overrides this.
    """
    out = {}
    for flight in flights:
        # Records of simulations have no native rates: their sensors are on time.
        logged = bool(flight.record.metadata.native_hz)
        sensors = [
            SENSOR_OF.get(c, c)
            for c in outputs
            if (logged if requested is None else c in requested)
        ]
        if requested is None:
            sensors = [CONTROL_DELAY, *(c for c in sensors if c != _REFERENCE)]
        elif CONTROL_DELAY in requested:
            sensors = [CONTROL_DELAY, *sensors]
        out[flight.name] = list(dict.fromkeys(sensors))
    return out


LATE_ROWS = 0.5
"""Rows by which the controls of a record may act early or late before its commands count as
shifted.
"""
_MIN_LATE_S = 0.0075  # JSBSim's own flights act half a run early (see replay.py).


def late_limit_s(flight: Flight, dt_s: float) -> float:
    """Return the largest delay of a flight's controls that counts as aligned [s].

    Half a row of commands, ``dt_s`` long; infinite for a log, whose channels are stamped when
    written.
    """
    return math.inf if flight.record.metadata.native_hz else max(LATE_ROWS * dt_s, _MIN_LATE_S)


def shifted_command_warnings(
    flights: Sequence[Flight],
    segments: Sequence[Segment],
    nuisance: Mapping[str, tuple[float, float]],
) -> list[str]:
    """Return a warning for every flight whose estimated control delay exceeds the limit of its
    record.
    """
    warnings = []
    for flight in flights:
        late, std = nuisance.get(f"delay/{flight.name}/{CONTROL_DELAY}", (0.0, 0.0))
        # The limit follows the spacing of commands, not of output rows.
        limit = late_limit_s(flight, next(s.command_s for s in segments if s.flight == flight.name))
        # An undetermined delay (std NaN) fails the comparison and raises no warning.
        # Significant at two standard errors.
        if abs(late) - 2.0 * std > limit:
            warnings.append(
                f"{flight.name}: controls act {1e3 * abs(late):.1f} ms"
                f" {'late' if late > 0.0 else 'early'}, where {1e3 * limit:.1f} ms are allowed: the"
                " command columns are shifted; a command belongs to the first row whose"
                " acceleration includes it"
            )
    return warnings
