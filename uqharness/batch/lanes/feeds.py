"""Streams of lanes: each air, noise and walk is made once, a piece at a time, and shared by all lanes that meet it."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.units import FT_M
from uqharness.batch.form.flying import Feed, shared, slot
from uqharness.batch.lanes.mission import LaneMission
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
from uqharness.batch.machine.target import Target, chosen_target
from uqharness.batch.models.start import rounded
from uqharness.batch.models.winds import COUNTER, NORMALS
from uqharness.flight import (
    TURBULENCE_W20_KT,
    FlightSpec,
    LevelDriver,
    Split,
    TransientDriver,
    dryden_parameters,
    refuse_above_ceiling,
)

Air = tuple[float, float, float]
"""Airspeed [m/s], height [m] and span [m] from which the host's gusts are made."""
Splits = tuple[Split, ...]


class Feeder:
    """Feeds of the next frames for the lanes that are still flying.

    airs: each lane's; begun: noise by seed, where the lanes stand before their first frame. Lanes that go on behind ``frame``
    frames have ``splits``, and their streams are made anew up to there.
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
        self._branching, self._target = False, target or chosen_target()
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
        """A feeder behind ``frame`` frames whose lane k goes on with lane ``lanes[k]`` of this one, which is given up: streams that
        are known go on where they stand, those of a new last split leave them there."""
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
            out[stream.name] = shared(
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
        return shared(pieces, keys, first)

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
        """Lanes of one air may stand at different rows: each air keeps those that any of its lanes may still need."""
        counters = slot(self._program, state, COUNTER, len(alive)).astype(np.int64)
        seeds = [(self._specs[k].seed_turbulence, self._splits[k]) for k in alive]
        pieces = {}
        low = int(counters.min())
        for seed in dict.fromkeys(seeds):
            if seed not in self._windows:
                self._windows[seed] = _Window(_turbulence_of(*seed, self._target))
            window = self._windows[seed]
            pieces[seed] = window.from_to(low, int(counters.max()) + frames)
        return shared(pieces, seeds, low)


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
    """Normals alone: the filters are the aircraft's, so that the last split's are all that is heard."""
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
