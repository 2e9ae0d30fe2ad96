"""Streams of lanes: each air, noise and walk is made once, a piece at a time, and shared by all lanes that meet it."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence

import numpy as np
from numpy.typing import NDArray

from sysid.units import FT_M
from uqharness.batch.form.flying import Feed, shared, slot
from uqharness.batch.lanes.begin import Begun
from uqharness.batch.lanes.mission import LaneMission
from uqharness.batch.lanes.streams import GUSTS, LEVELS, TRANSIENTS, HostGusts, MovingLevels, Series, Turbulence, noise_streams
from uqharness.batch.models.start import rounded
from uqharness.batch.models.winds import COUNTER, NORMALS
from uqharness.flight import TURBULENCE_W20_KT, FlightSpec, LevelDriver, TransientDriver, dryden_parameters

Array = NDArray[np.float64]


class Feeder:
    """Feeds of the next frames for the lanes that are still flying."""

    def __init__(self, lanes: LaneMission, specs: Sequence[FlightSpec], started: Begun) -> None:
        self._lanes, self._specs, self._started = lanes, specs, started
        self._program = lanes.program
        self._wanted = {stream.name for stream in self._program.streams}
        self._noise = noise_streams(lanes.flight.draws)
        self._series: dict[tuple[str, Hashable], Series] = {}
        self._windows: dict[Hashable, _Window] = {}
        gusty = GUSTS.name in self._wanted
        self._airs = [(spec.seed_turbulence, *self._scales(k)) for k, spec in enumerate(specs)] if gusty else []

    def feeds(self, alive: NDArray[np.intp], frames: int, state: Array) -> dict[str, Feed]:
        """For ``frames`` frames on."""
        out: dict[str, Feed] = {}
        if self._noise:
            out |= self._noise_feeds(alive, frames)
        if GUSTS.name in self._wanted:
            out[GUSTS.name] = self._fed(GUSTS.name, [self._airs[k] for k in alive], frames, self._gusts)
        if LEVELS.name in self._wanted:
            out[LEVELS.name] = self._fed(LEVELS.name, [self._specs[k].levels for k in alive], frames, self._levels)
        if TRANSIENTS.name in self._wanted:
            out[TRANSIENTS.name] = self._fed(TRANSIENTS.name, [self._specs[k].transient for k in alive], frames, self._levels)
        if NORMALS.name in self._wanted:
            out[NORMALS.name] = self._turbulence(alive, frames, state)
        return out

    def _noise_feeds(self, alive: NDArray[np.intp], frames: int) -> dict[str, Feed]:
        seeds = [self._specs[k].seed_noise for k in alive]
        # What no lane meets any more stands still: nobody asks for it again.
        rows = {seed: self._started.noise[seed].frames(frames) for seed in dict.fromkeys(seeds)}
        out = {}
        for stream in self._noise:
            pieces = {seed: found[stream.name] for seed, found in rows.items()}
            out[stream.name] = shared({s: p.array for s, p in pieces.items()}, seeds, next(iter(pieces.values())).first_row)
        return out

    def _fed(self, name: str, keys: Sequence[Hashable], frames: int, make: Callable[..., Series]) -> Feed:
        pieces = {}
        first = 0
        for key in dict.fromkeys(keys):
            if (name, key) not in self._series:
                self._series[name, key] = make(key)
            array, first = self._series[name, key].rows(frames)
            pieces[key] = array
        return shared(pieces, keys, first)

    def _levels(self, driver: LevelDriver | TransientDriver) -> MovingLevels:
        return MovingLevels(driver, self._lanes.dt_s)

    def _scales(self, lane: int) -> tuple[float, float, float]:
        """Airspeed [m/s], height [m] and span [m] at the start, from which the host's gusts are made."""
        values, spec = self._started.values, self._specs[lane]
        if self._lanes.air:
            speed = float(values["velocities/vt-fps"][lane]) * FT_M
        else:
            toward = math.radians(spec.wind_from_deg + 180.0)
            north = float(values["velocities/v-north-fps"][lane]) * FT_M - spec.wind_mps * math.cos(toward)
            east = float(values["velocities/v-east-fps"][lane]) * FT_M - spec.wind_mps * math.sin(toward)
            down = float(values["velocities/v-down-fps"][lane]) * FT_M
            speed = math.sqrt(north * north + east * east + down * down)
        height = float(values["position/h-agl-ft"][lane]) * FT_M
        span = float(values.get("metrics/bw-ft", np.full(lane + 1, self._lanes.span_ft))[lane]) * FT_M
        return rounded(max(speed, 1.0)), rounded(max(height, 3.048)), span

    def _gusts(self, key: tuple[int, float, float, float]) -> HostGusts:
        seed, speed, height, span = key
        w20 = TURBULENCE_W20_KT[self._specs[0].turbulence]
        return HostGusts(dryden_parameters(speed, height, w20, span), self._lanes.dt_s, seed)

    def _turbulence(self, alive: NDArray[np.intp], frames: int, state: Array) -> Feed:
        """Lanes of one air may stand at different rows: each air keeps those that any of its lanes may still need."""
        counters = slot(self._program, state, COUNTER, len(alive)).astype(np.int64)
        seeds = [self._specs[k].seed_turbulence for k in alive]
        pieces = {}
        low = int(counters.min())
        for seed in dict.fromkeys(seeds):
            window = self._windows.setdefault(seed, _Window(Turbulence(seed)))
            pieces[seed] = window.from_to(low, int(counters.max()) + frames)
        return shared(pieces, seeds, low)


class _Window:
    """Rows of a series from where somebody still needs them."""

    def __init__(self, series: Series) -> None:
        self._series, self._first = series, 0
        self._held: Array | None = None

    def from_to(self, first: int, last: int) -> Array:
        known = 0 if self._held is None else len(self._held)
        lacking = last - (self._first + known)
        if lacking > 0 or self._held is None:
            new = self._series.rows(max(lacking, 1)).array
            self._held = new if self._held is None else np.concatenate([self._held, new])
        self._held = self._held[first - self._first :]
        self._first = first
        return self._held[: last - first]
