"""How gusty the air was: process noise of the linearised flight by maximum likelihood.

Gusts enter V, alpha and beta as white rates; what else they do, rotating with the air and turning with the aircraft, is in the
states of `sysid.aerodynamics.gust_states`. Whether they do either is decided by the likelihood. The spectra go with the
airspeed V and with
the air of the day (in MIL-F-8785C with height, too): those of V and p as V, those of alpha and beta as 1/V, and each flight has
intensities of its own.
Left out, the air's rotation would pass for stability: gusts that pitch the air and change alpha at once made Cm_alpha a third of
its size. Gusts along the path that turn with the aircraft, left out, were moments from yaw rate squared at |t| of 7.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import NX, GustStates, Steps
from sysid.effects.gust_cost import Likelihood
from sysid.effects.prediction import surprise
from sysid.estimation import Process
from sysid.parallel import ALONE, Processes

FloatArray = NDArray[np.float64]
Linear = Callable[[Sequence[int], GustStates], Sequence[Steps]]
"""Steps of some of the segments, linearised with gusts that act so."""
V_REFERENCE = 20.0
_START = np.array([0.25, 5e-4, 5e-4, 5e-2, 1e-4])
"""Intensities of V [m2/s3], alpha and beta [rad2/s], the air's roll [rad2/s3], what its pitch and yaw have besides [rad2/s3]; all
at V_REFERENCE. Light air, to begin with."""
_MEMORY_S = 10.0
"""How long gusts along and across the path last: L/V of MIL-F-8785C at the heights of model aircraft."""
AIR_SHARE = 0.03
"""Share of the gain that comes of V, alpha and beta in air. In light Dryden turbulence it is a fifth; where a moment that the
model lacks acts now and then, nothing."""
_STILL = np.array([1e-6, 1e-6, 1e-6, 1.0, 1.0])
_FACTORS = (1e-4, 1e-2, 0.1, 0.5, 1.0, 2.0, 5.0)
_COARSE = ((0.03, 0.2, 5.0, 30.0), (0.4, 0.7, 1.4, 2.5))
_FINE = ((0.75, 0.87, 1.15, 1.33),)
_MOST_SEGMENTS = 10
_OF_A_FLIGHT = 6
_WHOLE = (0.1, 0.2, 0.4, 0.65, 1.5, 2.5, 5.0)
_NOISIER = ((0.4, 0.6, 0.8, 1.3, 1.8, 2.6), (0.83, 0.91, 1.1, 1.2))
_OWN = ((0.3, 0.55, 1.8, 3.3), (0.75, 1.33))
_OTHER_AIR = ((True, False), (False, False), (False, True))


@dataclass(frozen=True)
class Gusts:
    """The air of some flights.

    states    how gusts act; values (5,) as _START over all flights; own: flight -> (5,)
    process   noise that they make in each segment; gain: twice the log likelihood gained over calm air
    moving    the part of it that is lost where air rotates but does not move along V, alpha and beta
    """

    states: GustStates
    values: FloatArray
    own: Mapping[str, FloatArray]
    process: Process
    gain: float
    moving: float = np.inf

    @property
    def air(self) -> bool:
        """Whether it is air at all: a moment that nothing explains passes for air that rotates and stands still."""
        return self.moving > AIR_SHARE * self.gain

    @property
    def words(self) -> str:
        """How the gusts act."""
        turning = "turn with the aircraft" if self.states.turning_with else "do not turn with the aircraft"
        return f"gusts that {'rotate the air' if self.states.rotating else 'do not rotate the air'} and {turning}"


def process_of(values: FloatArray, V: float, states: GustStates) -> tuple[FloatArray, FloatArray]:
    """(13, 13) covariance per second of the states' noise at airspeed V, and (13, 13) covariance of the air's at the start, from
    the five values of _START."""
    faster = V / V_REFERENCE
    lags = states.lags_s(V)
    noise, begin = np.zeros((NX, NX)), np.zeros((NX, NX))
    # Dryden far above its corner: PSD of u' is 2 sigma^2 V/L, of alpha' = w'/V 3 sigma^2/(L V).
    noise[0, 0], noise[1, 1], noise[2, 2] = values[0] * faster, values[1] / faster, values[2] / faster
    noise[8, 8] = values[3] * faster
    for k in (1, 2):
        noise[8 + k, 8 + k] = values[4] * lags[k] ** 2
    for k in range(3):
        # Stationary from the start: T x' = -x + n has the variance N/(2T), and the states 9 and 10 are T times the rotation.
        tied = noise[k, k] if k and states.rotating else 0.0
        begin[8 + k, 8 + k] = 0.5 * lags[k] * (noise[8 + k, 8 + k] + tied)
    if states.turning_with:
        begin[11, 11], begin[12, 12] = 0.5 * _MEMORY_S * noise[0, 0], 0.5 * _MEMORY_S * noise[2, 2]
    return noise, begin


def gust_intensity(
    linear: Linear, measured: Sequence[FloatArray], which: Sequence[int], noise: FloatArray, V: Sequence[float],
    flights: Sequence[str], states: GustStates, near: Gusts | None = None, by: Processes = ALONE,
) -> Gusts:  # fmt: skip
    """The air of the segments, V their airspeeds, flights whose they are; found on at most ten of them, then of each flight on
    at most six.

    states: what gusts do besides, to begin with; near: an estimate from which to search, whose states stay.
    """
    search = _Search(linear, measured, which, noise, V, by)
    some = _spread(range(len(measured)), _MOST_SEGMENTS)
    if near is None:
        first = _Point(states, _START, np.inf)
        here = search.finer(some, search.best(some, first, [(states, f * _START) for f in _FACTORS]), _COARSE)
        other = search.other_air(some, here)
        here = here if other.states == here.states else search.finer(some, other, _COARSE)
    else:
        here = search.at(some, near.states, near.values)
    here = search.finer(some, here, _FINE)
    gain = near.gain if near is not None else search.calm(some, here.states) - here.cost
    moving = near.moving if near is not None else search.at(some, here.states, _STILL * here.values).cost - here.cost
    own = dict.fromkeys(flights, here.values)
    for flight in own if len(own) > 1 or near is not None else ():
        part = _spread([k for k, f in enumerate(flights) if f == flight], _OF_A_FLIGHT)
        if near is not None and flight in near.own:
            found = search.finer(part, search.at(part, here.states, near.own[flight]), _OWN[1:])
        else:
            found = search.at(part, here.states, here.values)
            found = search.best(part, found, [(here.states, f * here.values) for f in _WHOLE])
            found = search.finer(part, found, _OWN)
        own[flight] = found.values
    process = _process([own[f] for f in flights], V, here.states)
    return Gusts(here.states, here.values, own, process, gain, moving)


@dataclass(frozen=True)
class _Point:
    states: GustStates
    values: FloatArray
    cost: float


@dataclass(frozen=True)
class _Search:
    """Minus twice the log likelihood of segments, by the gusts in them."""

    linear: Linear
    measured: Sequence[FloatArray]
    which: Sequence[int]
    noise: FloatArray
    V: Sequence[float]
    by: Processes
    asked: dict[tuple[tuple[int, ...], GustStates], Likelihood] = field(default_factory=dict)

    def costs(self, some: Sequence[int], states: GustStates, points: Sequence[FloatArray]) -> FloatArray:
        key = (tuple(some), states)
        if key not in self.asked:
            data = [self.measured[k] for k in some]
            self.asked[key] = Likelihood(self.linear(some, states), data, self.which, self.by)
        V = [self.V[k] for k in some]
        air = [_process([p] * len(some), V, states) for p in points]
        return self.asked[key].costs(np.tile(self.noise, (len(points), 1)), air)

    def at(self, some: Sequence[int], states: GustStates, values: FloatArray) -> _Point:
        return _Point(states, values, float(self.costs(some, states, [values])[0]))

    def best(self, some: Sequence[int], here: _Point, trials: Sequence[tuple[GustStates, FloatArray]]) -> _Point:
        states = trials[0][0]
        found = self.costs(some, states, [v for _, v in trials])
        k = int(np.argmin(found))
        return _Point(states, trials[k][1], float(found[k])) if found[k] < here.cost else here

    def finer(self, some: Sequence[int], here: _Point, rounds: Sequence[Sequence[float]]) -> _Point:
        """One intensity after the other."""
        for factors in rounds:
            for k in range(len(_START)):
                one = np.arange(len(_START)) == k
                here = self.best(some, here, [(here.states, np.where(one, f, 1.0) * here.values) for f in factors])
        return here

    def other_air(self, some: Sequence[int], here: _Point) -> _Point:
        """With gusts that do not rotate, or do not turn with the aircraft, where the flights are likelier so."""
        found = here
        besides = np.array([1.0, 1.0, 1.0, 1.0, 30.0])
        for rotating, turning in _OTHER_AIR:
            states = replace(here.states, rotating=rotating, turning_with=turning)
            found = self.best(some, found, [(states, here.values), (states, besides * here.values)])
        return found

    def calm(self, some: Sequence[int], states: GustStates) -> float:
        data = [self.measured[k] for k in some]
        return surprise(self.linear(some, states), data, self.which, self.noise)


def noise_factors(
    steps: Sequence[Steps], measured: Sequence[FloatArray], which: Sequence[int], noise: FloatArray, process: Process,
    kinds: Sequence[str], by: Processes = ALONE,
) -> FloatArray:  # fmt: skip
    """(m,) factors on the sensors' noise (m,) that make the flights likeliest beside the process noise, one for each kind of
    channel; found on at most ten of the segments.

    In gusts the samples of a channel do not tell its noise by themselves, and a filter that takes sensors for twice as noisy as
    they are follows them late: that looks like a servo's lag.
    """
    some = _spread(range(len(steps)), _MOST_SEGMENTS)
    likelihood = Likelihood([steps[k] for k in some], [measured[k] for k in some], which, by)
    theirs = process.of(some)

    def cost(factors: Sequence[FloatArray]) -> FloatArray:
        return likelihood.costs(np.array(factors) * noise, [theirs] * len(factors), mend=True)

    best = np.ones(len(noise))
    low = float(cost([best])[0])
    for trial_factors in _NOISIER:
        for kind in dict.fromkeys(kinds):
            own = np.array([k == kind for k in kinds])
            trials = [np.where(own, f * best, best) for f in trial_factors]
            found = cost(trials)
            if found.min() < low:
                best, low = trials[int(np.argmin(found))], float(found.min())
    return best


def _process(values: Sequence[FloatArray], V: Sequence[float], states: GustStates) -> Process:
    """Of segments with such values and airspeeds."""
    made = [process_of(p, v, states) for p, v in zip(values, V, strict=True)]
    return Process(np.stack([noise for noise, _ in made]), np.stack([begin for _, begin in made]))


def _spread(members: Sequence[int], most: int) -> list[int]:
    """At most so many of them, from the first to the last."""
    return [members[k] for k in np.unique(np.linspace(0, len(members) - 1, min(len(members), most)).astype(int)).tolist()]
