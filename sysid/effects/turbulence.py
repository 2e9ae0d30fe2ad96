"""How gusty the air was: process noise of the linearised flight by maximum likelihood.

Gusts enter V, alpha and beta as white rates; what else they do, rotating with the air and turning
with the aircraft, is in the states of `sysid.aerodynamics.air_motion`. Whether they do either is
decided by the likelihood. The spectra go with the airspeed V and with the air of the day (in
MIL-F-8785C with height, too): those of V and p as V, those of alpha and beta as 1/V, and each
flight has intensities of its own. Where gusts were made beforehand for one speed, as simulations
often do, they pass at that speed however fast the aircraft flies. Left out, the air's rotation
would pass for stability: gusts that pitch the air and change alpha at once made Cm_alpha a third of
its size. Gusts along the path that turn with the aircraft, left out, were moments from yaw rate
squared at |t| of 7. Where the model lacks a moment, white moments about the body's axes stand for
it, as large as the flights ask for: without them a filter takes it for air, and terms in other
coefficients for what such air would do. Gusts that pass at one speed, taken to pass at the
airspeed, were damping and stability that go with thrust or angle of attack at |t| of 4 to 6, since
the slow flight's air rotated too fast."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from cachetools import LRUCache
from scipy.optimize import Bounds, minimize

from sysid.aerodynamics import LENGTHS, NX, GustStates, Steps
from sysid.arrays import FloatArray
from sysid.effects.coloured_innovations import InnovationColour
from sysid.effects.prediction import start_fitted
from sysid.effects.tuned import CERTAIN_T, DIFFERENT
from sysid.estimation import MeasuredSystem, Process, gains, variance_gradient, whiten_innovations
from sysid.parallel import SERIAL, Processes, Shared

# How likely flights are in an air, and the score: how that goes with the air's intensities and
# the sensors' noise.
#
# Minus twice the log likelihood of one-step predictions, start states fitted (Astrom,
# Automatica 16, 1980), with w = L^-1 e whitened:
#
# sum |w|^2 + 2 ln det L, L L' = F = H P H' + R (1)
#
# Its slopes come of one pass backwards, channel by channel (Koopman and Shephard, Biometrika
# 79, 1992; Durbin and Koopman, Time Series Analysis by State Space Methods, 2012, sections 6.4
# and 7.3.3). With the innovation v, its variance s, the gain K and C = 1 - K h,
#
# u = v/s - K'r, D = 1/s + K'N K, r- = C'r + h'v/s, N- = C'N C + h'h/s (2) d/dR = D - u^2, d/dQ
# = N - r r' behind the step, d/dP(0) = N - r r' before the first sample (3)
#
# The start state is where the likelihood is largest, so that its change with the air takes
# nothing away.


@dataclass(frozen=True)
class Score:
    """cost: minus twice the log likelihood; its slopes with the logarithm of each sensor's standard
    deviation, noise (m,), and with the variances of each segment's process noise and begin (S, x).
    Infinite, its slopes zero, where no filter follows.

    curvature: the same slopes without the sum of squares, (m,), (S, x), (S, x), an upper bound of
    the curvature with the logarithms"""

    cost: float
    noise: FloatArray
    process: FloatArray
    begin: FloatArray
    curvature: tuple[FloatArray, FloatArray, FloatArray]


class AirLikelihood:
    """Segments whose likelihood is asked for in many airs.

    which: rows of OUTPUTS that ``measured`` [(n, m)] holds. Who does the work does not change a bit
    of it."""

    def __init__(
        self,
        steps: Sequence[Steps],
        measured: Sequence[FloatArray],
        rows: Sequence[int],
        by: Processes = SERIAL,
    ) -> None:
        self._by = by
        order = sorted(range(len(measured)), key=lambda k: -len(measured[k]))
        count = min(by.count, len(order))
        self._groups = [order[k::count] for k in range(count)]
        self._shared = [
            by.share([MeasuredSystem.of(steps[k], measured[k], rows) for k in group])
            for group in self._groups
        ]

    def __call__(self, noise: FloatArray, process: Process, slopes: bool = True) -> Score:
        """noise (m,) standard deviations of the sensors; without ``slopes`` they are zero."""
        jobs = [
            (shared, noise, process.of(group), slopes)
            for shared, group in zip(self._shared, self._groups, strict=True)
        ]
        scores = [one for some in self._by(_scored, jobs) for one in some]
        order = np.argsort(np.concatenate(self._groups))
        cost, by_noise, by_process, by_begin = (
            np.stack(part)[order] for part in zip(*scores, strict=True)
        )
        followed = float(np.isfinite(cost).all())
        curvature, square = (
            (by_noise[:, k].sum(axis=0), by_process[:, k], by_begin[:, k]) for k in (0, 1)
        )
        noise_slopes, air, begin = (
            followed * (b - s) for b, s in zip(curvature, square, strict=True)
        )
        return Score(float(cost.sum()), noise_slopes, air, begin, curvature)


_Slopes = tuple[float, FloatArray, FloatArray, FloatArray]


def _scored(job: tuple[Shared, FloatArray, Process, bool]) -> list[_Slopes]:
    """Cost of each segment, and its slopes, those of the logarithm and those of the squares (2, m),
    (2, x) and (2, x); infinite, its slopes zero, where no filter follows."""
    shared, noise, process, sloping = job
    return [
        _one(seen, noise, (q, p), sloping)
        for seen, q, p in zip(shared.value, process.noise, process.begin, strict=True)
    ]


def _one(
    system: MeasuredSystem, noise: FloatArray, air: tuple[FloatArray, FloatArray], sloping: bool
) -> _Slopes:
    flat = np.zeros((2, len(noise))), np.zeros((2, len(air[0]))), np.zeros((2, len(air[0])))
    try:
        filter_gains = gains(system, noise, air, with_prior_variance=False)
    except np.linalg.LinAlgError:
        return np.inf, *flat
    through = whiten_innovations(system, filter_gains)
    if not np.isfinite(through.starts).all():
        return np.inf, *flat
    white, _, _ = start_fitted(through.innovations, through.starts)
    cost = float(np.sum(white**2)) + 2.0 * filter_gains.logdet  # (1)
    if not sloping:
        return cost, *flat
    noise_slopes, process, begin = variance_gradient(system, filter_gains, white, air[0])
    return cost, 2.0 * noise**2 * noise_slopes, process, begin


Linear = Callable[[Sequence[int], Sequence[GustStates]], Sequence[Steps]]
"""Steps of some of the segments, linearised with gusts that act so in each."""
V_REFERENCE = 20.0
LIGHT_AIR = np.array([0.25, 5e-4, 5e-4, 5e-2, 1e-4, 1e-4, 1e-4, 1e-6, 1e-6])
"""Intensities of V [m2/s3], alpha and beta [rad2/s], the air's roll [rad2/s3], of moments about
the three axes that nothing explains, as angular accelerations [rad2/s3], and of the air's pitch and
yaw beyond what gusts at the wing make, as rates of alpha and beta [rad2/s]; all at V_REFERENCE.
Light air, to begin with."""
_MOMENTS = slice(4, 7)
_OWN_ROTATION = slice(7, 9)
_MOST_OWN = 1.0
"""Largest noise of the air's own pitch and yaw, as a share of that of gusts across the path, or of
the air's roll: an isotropic field has no more.
"""
_LENGTHS = (1.0, 0.5, 0.25, 2.0, 0.7, 1.4)
"""Lengths of q_h and r_h that are tried, in units of the standard's."""
_STRUCTURE_ROUNDS = 2
_FINER = 1.2
"""Factor by which the likeliest length is refined."""
_NONE = 1e-6
"""Factor on an intensity that leaves nothing of it."""
_MEMORY_S = 10.0
"""How long gusts along and across the path last: L/V of MIL-F-8785C at the heights of model
aircraft.
"""
_WITHOUT_ACROSS = np.array([1.0, _NONE, _NONE, *[1.0] * 6])
"""Factors that leave gusts along the path and the air's roll: a sensor that is off, or play, passes
for those.
"""
_FACTORS = (1e-4, 1e-2, 0.1, 1.0, 5.0)
"""Of LIGHT_AIR, from the best of which the search begins."""
_MOST_SEGMENTS, _OF_A_FLIGHT, _FOR_SPEED = 10, 6, 4
_FASTER, _MOST_FASTER, _AS_MEANT = 0.04, 3.0, 0.02
"""Logarithm of the passing speed by which it is moved to find the likeliest; how many such steps
that is away at most; standard deviation of that logarithm about a flight's mean airspeed, for gusts
are made beforehand for the speed that is to be flown."""
_STRUCTURES = tuple(
    (rotating, turning_with, in_body)
    for in_body in (False, True)
    for rotating, turning_with in ((True, True), (True, False), (False, False), (False, True))
    if turning_with or not in_body
)
"""Whether gusts rotate the air, turn with their axes, and have the body's axes. Gusts in axes that
do not turn are fixed to the earth.
"""
_REACH, _ENOUGH, _FAILED, _LEAST_BENT = 14.0, 1.0, 1e12, 20.0
"""Of the search, in logarithms: how far it goes; the fall of minus twice the log likelihood at
which it ends; that of a filter that fails; the least curvature that it takes."""
_FEW, _MOST_DESCENTS = 4, 25
REMEMBERED_AIRS = 2
"""Ways in which gusts act whose linear systems are remembered: the one searched about and the one
tried. Each takes as much memory as a fit."""
NOISE_PRIOR = np.log(2.0)
"""Standard deviation of the logarithm of a sensor's noise about what the card says."""


@dataclass(frozen=True)
class TurbulenceModel:
    """The air of some flights.

    states    how gusts act in each segment; values (7,) as LIGHT_AIR, of the air the flights' mean;
    by_flight: flight -> (7,); passing:
              flight -> speed at which its gusts pass [m/s], 0: the airspeed
    process   noise that they make in each segment; gain: twice the log likelihood gained over calm
    air
    across    the part of it that is lost without gusts across the path, in alpha and beta moments
    (3,) what is lost without moments about each axis that nothing explains; NaN where no filter
    follows without
    factors   (m,) on the noise that the sensors are said to have
    colour    what a filter of this air leaves of the flights: how they depart from the gust model;
              None: nothing"""

    states: tuple[GustStates, ...]
    values: FloatArray
    by_flight: Mapping[str, FloatArray]
    passing: Mapping[str, float]
    process: Process
    gain: float
    across: float
    moments: FloatArray
    factors: FloatArray
    colour: InnovationColour | None = None

    @property
    def air(self) -> bool:
        """Whether it is air at all: turbulence moves across the path, too. A transient moment
        passes for air that rotates, a sensor that is off for gusts along the path."""
        return self.across > CERTAIN_T**2

    def in_other(self, V: Sequence[float], flights: Sequence[str]) -> TurbulenceModel:
        """The same air in other segments, V their airspeeds, flights whose they are: those not
        known of have what all have, and gusts that pass at one speed pass at their mean airspeed.
        """
        first = self.states[0]
        passing = {
            f: bool(first.passing_mps) * float(np.mean([V[k] for k in part]))
            for f, part in _members(flights).items()
        }
        passing |= self.passing
        by_flight = {f: self.by_flight.get(f, self.values) for f in flights}
        states = tuple(first._replace(passing_mps=passing[f]) for f in flights)
        return replace(
            self,
            states=states,
            by_flight=by_flight,
            passing=passing,
            process=_process([by_flight[f] for f in flights], V, states),
        )

    @property
    def kind(self) -> tuple[bool, bool, bool]:
        """Whether the gusts rotate the air, turn with the aircraft, and pass at one speed in each
        flight.
        """
        first = self.states[0]
        return first.rotating, first.turning_with, bool(first.passing_mps)

    @property
    def words(self) -> str:
        """How the gusts act."""
        rotating, turning_with, at_one_speed = self.kind
        passing = ", and pass at one speed in each flight" if at_one_speed else ""
        rotate, turn = ("" if so else "do not " for so in (rotating, turning_with))
        axes = " of the body's axes" if self.states[0].in_body else ""
        order = 0 if self.colour is None else len(self.colour.coefficients)
        colour_words = f", and whose innovations depend on {order} rows before" if order else ""
        return (
            f"gusts{axes} that {rotate}rotate the air{self._lengths} and {turn}turn with the"
            f" aircraft{passing}{colour_words}"
        )

    @property
    def _lengths(self) -> str:
        """How the air's pitch and yaw depart from the standard, in words."""
        first = self.states[0]
        parts = []
        for name, share, length in (
            ("pitch", first.q_share, first.q_length),
            ("yaw", first.r_share, first.r_length),
        ):
            if not first.rotating or (share, length) == (1.0, 1.0):
                continue
            size = f"{length:.2g} times the standard's length"
            parts.append(
                f"{name} {'reversed, ' if share < 0.0 else ''}{size}"
                if share
                else f"{name} not by gusts at the wing"
            )
        return f" ({', '.join(parts)})" if parts else ""


def gust_strength_mps2(values: FloatArray) -> float:
    """Return the strength sigma^2 / L of gusts [m/s2], the larger of those along and across the
    path.

    values: (7,) estimates of the air of a flight, as `TurbulenceModel.by_flight` has them. The
    spectral density of u' is 2 sigma^2 V / L, that of alpha' and beta' 3 sigma^2 / (L V)
    (`process_of`).
    """
    along_path = values[0] / (2.0 * V_REFERENCE)
    across = np.max(values[1:3]) * V_REFERENCE / 3.0
    return float(max(along_path, across))


def process_of(values: FloatArray, V: float, states: GustStates) -> tuple[FloatArray, FloatArray]:
    """(13,) variances per second of the states' noise at airspeed V, and (13,) of the air's at the
    start, from the nine values of LIGHT_AIR. Spectra of the velocities go with the speed at which
    the gusts pass."""
    faster = (states.passing_mps or V) / V_REFERENCE
    noise, begin = np.zeros(NX), np.zeros(NX)
    # Dryden far above its corner: PSD of u' is 2 sigma^2 V/L, of alpha' = w'/V 3 sigma^2/(L V).
    noise[0], noise[1], noise[2] = (
        values[0] * faster,
        *(faster * values[1:3] * (V_REFERENCE / V) ** 2),
    )
    # A coefficient's noise is a moment's by dynamic pressure.
    noise[3:6] = values[_MOMENTS] * (V / V_REFERENCE) ** 4
    noise[8] = values[3] * faster
    # Stationary from the start: x' = -x/T + n has the variance N T/2, and the states 9 to 12 are
    # velocities.
    begin[8:11] = (
        0.5
        * np.array(states.lags_s(V))
        * [
            noise[8],
            states.rotating * states.q_share**2 * V**2 * noise[1],
            states.rotating * states.r_share**2 * V**2 * noise[2],
        ]
    )
    begin[11:] = (
        0.5
        * _MEMORY_S
        * states.turning_with
        * (noise[[2, 1]] * V**2 if states.in_body else noise[[0, 2]] * [1.0, V**2])
    )
    # The air's own pitch and yaw; h_q and h_r are velocities.
    noise[9:11] = V**2 * faster * values[_OWN_ROTATION] * (V_REFERENCE / V) ** 2
    begin[9:11] += 0.5 * np.array(states.lags_s(V)[1:]) * noise[9:11]
    return noise, begin


def gust_intensity(
    linear: Linear,
    measured: Sequence[FloatArray],
    rows: Sequence[int],
    noise: FloatArray,
    V: Sequence[float],
    flights: Sequence[str],
    states: GustStates,
    prior_model: TurbulenceModel | None = None,
    by: Processes = SERIAL,
    kinds: Sequence[str] = (),
) -> tuple[TurbulenceModel, FloatArray]:
    """The likeliest air of the segments, V their airspeeds, flights whose they are; found on at
    most ten of them, then of each flight on at most six. And (m,) factors by which the sensors'
    noise changes.

    states: what gusts do besides, to begin with; near: an estimate from which to search, its
    factors part of ``noise``; where strength and noise alone gain no more than chance would, the
    rest of it stands. Gusts pass at the airspeed, or at one speed in each flight, which is then
    found with the rest, whichever is likelier. kinds: of each channel; the sensors of a kind have
    one factor beside the air, by a prior about what they are said to have (NOISE_PRIOR); none:
    their noise is known. In gusts the samples of a channel do not tell its noise by themselves, and
    a filter that takes sensors for twice as noisy as they are follows them late: that looks like a
    servo's lag."""
    prior_factors = np.ones(len(noise)) if prior_model is None else prior_model.factors
    search = _Search(linear, measured, rows, noise / prior_factors, V, by)
    some = _evenly_spaced(range(len(measured)), _MOST_SEGMENTS)
    of = _members(flights)
    if prior_model is None:
        starts = [_Point((states,) * len(measured), f * LIGHT_AIR, prior_factors) for f in _FACTORS]
        last = search.best(some, starts)
    else:
        prior_model = prior_model.in_other(V, flights)
        last = _Point(prior_model.states, prior_model.values, prior_factors).with_intensities(
            prior_model.by_flight, flights
        )
        # Far from what is stated no slope may lead back.
        is_far = len(kinds) and np.abs(np.log(prior_factors)).max() > NOISE_PRIOR
        last = search.best(
            some, [last, *([replace(last, factors=np.ones(len(noise)))] if is_far else [])]
        )
    best = search.descend(some, last, kinds)
    if prior_model is None or last.cost - best.cost > DIFFERENT**2:
        # What gusts do, an effect that is missing or a sensor that is off may have decided before.
        best = search.structured(some, best, kinds)
        if prior_model is None:
            # A flight in weaker air looks like one whose gusts pass slower, and where air is not
            # its own, like moments that act.
            best = search.by_flight(of, best, flights, _FEW)
        if best.states[0].rotating:
            # Gusts tell how fast they pass by the moments of their rotation, and that only beside
            # parameters that are near.
            other = search.best(some, [best.with_states(passing_mps=0.0), search.passing(of, best)])
            best = search.descend(some, other, kinds) if other.states != best.states else best
        best = search.by_flight(of, best, flights)
    # What is lost counts from this air, which was found flight by flight.
    best = search.best(some, [best])
    gain, across = (
        (search.loss(some, best, left) for left in (0.0, _WITHOUT_ACROSS))
        if prior_model is None
        else (prior_model.gain, prior_model.across)
    )
    single_moments = np.where(np.eye(len(LIGHT_AIR)), _NONE, 1.0)[_MOMENTS]
    losses = np.array([search.loss(some, best, left) for left in single_moments])
    moments = np.where(np.isfinite(losses), losses, np.nan)
    by_flight = {f: best.of(members[0]) for f, members in of.items()}
    passing = {f: best.states[members[0]].passing_mps for f, members in of.items()}
    process = search.process(range(len(measured)), best)
    return TurbulenceModel(
        best.states,
        best.values,
        by_flight,
        passing,
        process,
        gain,
        across,
        moments,
        best.factors,
        None if prior_model is None else prior_model.colour,
    ), best.factors / prior_factors


@dataclass(frozen=True)
class _Point:
    states: tuple[GustStates, ...]
    values: FloatArray
    factors: FloatArray
    cost: float = np.inf
    stronger: FloatArray = field(default_factory=lambda: np.ones((1, len(LIGHT_AIR))))

    @property
    def kind(self) -> tuple[bool, bool, bool]:
        """Whether the gusts rotate the air, turn with their axes, and have the body's axes."""
        first = self.states[0]
        return first.rotating, first.turning_with, first.in_body

    def of(self, k: int) -> FloatArray:
        """(7,) intensities in a segment."""
        return np.asarray(self.values * self.stronger[k % len(self.stronger)])

    def with_intensities(
        self, by_flight: Mapping[str, FloatArray], flights: Sequence[str]
    ) -> _Point:
        """With the air of each segment as strong as that of its flight; moments that nothing
        explains are the model's, and alike in all flights."""
        values = np.mean([by_flight[f] for f in dict.fromkeys(flights)], axis=0)
        values[_MOMENTS] = self.values[_MOMENTS]
        stronger = np.array([by_flight[f] / values for f in flights])
        stronger[:, _MOMENTS] = 1.0
        return replace(self, values=values, stronger=stronger, cost=np.inf)

    def with_states(self, **changes: Any) -> _Point:
        """With gusts that act otherwise in every segment."""
        return replace(self, states=tuple(s._replace(**changes) for s in self.states))


@dataclass(frozen=True)
class _Search:
    """Minus twice the log likelihood of segments, by the gusts in them and the sensors' noise."""

    linear: Linear
    measured: Sequence[FloatArray]
    which: Sequence[int]
    noise: FloatArray
    V: Sequence[float]
    by: Processes
    likelihoods: LRUCache[tuple[tuple[int, GustStates], ...], AirLikelihood] = field(
        default_factory=lambda: LRUCache(REMEMBERED_AIRS)
    )

    def score(self, some: Sequence[int], point: _Point, slopes: bool = True) -> Score:
        """That of the segments ``some``."""
        states = [point.states[k] for k in some]
        key = tuple(zip(some, states, strict=True))
        if key not in self.likelihoods:
            data = [self.measured[k] for k in some]
            self.likelihoods[key] = AirLikelihood(
                self.linear(some, states), data, self.which, self.by
            )
        return self.likelihoods[key](point.factors * self.noise, self.process(some, point), slopes)

    def process(self, some: Sequence[int], point: _Point) -> Process:
        """Noise that gusts make in the segments ``some``."""
        return _process(
            [point.of(k) for k in some], [self.V[k] for k in some], [point.states[k] for k in some]
        )

    def by_flight(
        self,
        of: Mapping[str, Sequence[int]],
        point: _Point,
        flights: Sequence[str],
        max_descents: int = _MOST_DESCENTS,
    ) -> _Point:
        """The point with each flight's own intensities, sought from those that it has there; of:
        flight -> its segments; flights: whose each segment is."""
        if len(of) == 1:
            return point
        single = {
            f: replace(point, values=point.of(part[0]), stronger=np.ones((1, len(LIGHT_AIR))))
            for f, part in of.items()
        }
        by_flight = {
            f: self.descend(_evenly_spaced(of[f], _OF_A_FLIGHT), one, (), max_descents).values
            for f, one in single.items()
        }
        return point.with_intensities(by_flight, flights)

    def passing(self, flights: Mapping[str, Sequence[int]], point: _Point) -> _Point:
        """A point with gusts that pass at one speed in each of the ``flights`` (their segments),
        the likeliest about the mean airspeed: the lowest point of a parabola through three."""
        states = list(point.states)
        for members in flights.values():
            speed = float(np.mean([self.V[k] for k in members]))
            some = _evenly_spaced(members, _FOR_SPEED)
            trials = [
                point.with_states(passing_mps=speed * np.exp(_FASTER * k)) for k in (-1, 0, 1)
            ]
            slower, best_point, faster = (self.score(some, p, slopes=False).cost for p in trials)
            bend = slower - 2.0 * best_point + faster + 2.0 * (_FASTER / _AS_MEANT) ** 2
            steps = 0.5 * (slower - faster) / bend if bend > 0.0 else np.sign(slower - faster)
            # Where no filter follows there is no parabola.
            steps = steps if np.isfinite([slower, best_point, faster]).all() else 0.0
            likeliest = speed * float(np.exp(_FASTER * np.clip(steps, -_MOST_FASTER, _MOST_FASTER)))
            for k in members:
                states[k] = states[k]._replace(passing_mps=likeliest)
        return replace(point, states=tuple(states))

    def best(self, some: Sequence[int], points: Sequence[_Point]) -> _Point:
        """The likeliest of points."""
        return min(
            (replace(p, cost=self.score(some, p, slopes=False).cost) for p in points),
            key=lambda p: p.cost,
        )

    def structured(self, some: Sequence[int], point: _Point, kinds: Sequence[str]) -> _Point:
        """Choose how gusts act: whether they rotate the air and turn, their axes, the lengths of
        pitch and yaw. Each choice is asked again after the others."""
        best = point
        for _ in range(_STRUCTURE_ROUNDS):
            before = best
            frames = [
                best.with_states(rotating=r, turning_with=t, in_body=body)
                for r, t, body in _STRUCTURES
                if (r, t, body) != best.kind
            ]
            best = self.accept_trials(some, best, [self.unabsorbed(some, best, frames)], kinds)
            if best.states[0].rotating:
                for axis in ("q", "r"):
                    best = self.accept_trials(some, best, [self.length(some, best, axis)], kinds)
            if best.states == before.states:
                break
        return best

    def accept_trials(
        self, some: Sequence[int], best: _Point, trials: Sequence[_Point], kinds: Sequence[str]
    ) -> _Point:
        """The best point, or the likeliest near one of the trials that gains more than chance."""
        for trial in trials:
            if trial.states == best.states:
                continue
            other = self.descend(some, trial, kinds)
            best = other if other.cost < best.cost - DIFFERENT**2 else best
        return best

    def unabsorbed(self, some: Sequence[int], best: _Point, others: Sequence[_Point]) -> _Point:
        """The likeliest of points where neither moments that nothing explains nor the air's own
        rotation hide what gusts do; with the intensities of the best point."""
        clean = best.values.copy()
        clean[4:] = np.minimum(clean[4:], LIGHT_AIR[4:])
        cleaned = [replace(p, values=clean, stronger=best.stronger) for p in (best, *others)]
        chosen = self.best(some, cleaned)
        return best if chosen.states == best.states else replace(chosen, cost=np.inf)

    def length(self, some: Sequence[int], best: _Point, axis: str) -> _Point:
        """The likeliest sign and length of the air's pitch (axis q) or yaw (r)."""

        def at(share: float, length: float) -> _Point:
            return best.with_states(**{f"{axis}_share": share, f"{axis}_length": length})

        some = _evenly_spaced(some, _FOR_SPEED)
        shapes = [*((1.0, n) for n in _LENGTHS), (-1.0, 1.0), (-1.0, 0.5), (0.0, 1.0)]
        chosen = self.unabsorbed(some, best, [at(*shape) for shape in shapes])
        first = chosen.states[0]
        share, length = getattr(first, f"{axis}_share"), getattr(first, f"{axis}_length")
        if chosen.states == best.states and length == 1.0:
            return best
        finer = [at(share, float(length * _FINER**k)) for k in (-1, 1)]
        return self.unabsorbed(some, chosen, finer)

    def loss(self, some: Sequence[int], point: _Point, factors: FloatArray | float) -> float:
        """Twice the log likelihood that is lost where so much is ``factors`` of each intensity at a
        point found.
        """
        return (
            self.score(some, replace(point, values=factors * point.values), slopes=False).cost
            - point.cost
        )

    def descend(
        self,
        some: Sequence[int],
        point: _Point,
        kinds: Sequence[str],
        max_descents: int = _MOST_DESCENTS,
    ) -> _Point:
        """The likeliest air near a point, and with ``kinds`` the likeliest noise of the sensors: a
        quasi-Newton search in the logarithms (L-BFGS-B; Byrd, Lu, Nocedal and Zhu, SIAM J. Sci.
        Comput. 16, 1995)."""
        unlike = list(dict.fromkeys(kinds))
        shared = np.array([[kind == one for kind in kinds] for one in unlike], dtype=float).reshape(
            len(unlike), len(point.factors)
        )
        at, sizes = len(point.values), (len(point.values), len(unlike))
        each = [self.process(some, replace(point, values=alone)) for alone in np.diag(point.values)]

        def point_at(x: FloatArray) -> _Point:
            return replace(
                point,
                values=point.values * np.exp(x[:at]),
                factors=point.factors * np.exp(x[at:] @ shared),
            )

        def by_each(
            x: FloatArray, noise: FloatArray, process: FloatArray, begin: FloatArray
        ) -> FloatArray:
            # The noise of a step, and the air at the start, go with each intensity in a straight
            # line.
            air = [np.sum(process * p.noise) + np.sum(begin * p.begin) for p in each]
            return np.concatenate([np.exp(x[:at]) * air, shared @ noise])

        prior = np.repeat([0.0, NOISE_PRIOR**-2], sizes)
        none = np.zeros(len(prior))
        # From what the sensors are said to have to where the search begins.
        off = np.concatenate(
            [np.zeros(at), shared @ np.log(point.factors) / np.maximum(shared.sum(axis=1), 1.0)]
        )
        first = self.score(some, point)
        # A variance's logarithm bends as steeply as the logarithm's own slope, that of a deviation
        # twice so.
        scale = np.sqrt(
            np.maximum(by_each(none, *first.curvature) * np.repeat([1.0, 2.0], sizes), _LEAST_BENT)
        )

        def cost(y: FloatArray) -> tuple[float, FloatArray]:
            x = y / scale
            score = self.score(some, point_at(x)) if y.any() else first
            if not np.isfinite(score.cost):
                # A filter that fails is as unlikely as can be, and no slope.
                return _FAILED, none
            slope = by_each(x, score.noise, score.process, score.begin) + 2.0 * prior * (x + off)
            return score.cost + float(prior @ (x + off) ** 2), slope / scale

        options = {
            "maxiter": max_descents,
            "ftol": _ENOUGH / max(abs(first.cost), 1.0),
            "gtol": 0.0,
        }
        upper = np.full(len(scale), _REACH)
        # The air's own pitch and yaw are as strong as gusts across the path, or its roll, allow.
        roll = point.values[3] * (LENGTHS[1] * point.states[0].b / V_REFERENCE) ** 2
        limit = _MOST_OWN * np.maximum(point.values[1:3], roll) / point.values[_OWN_ROTATION]
        upper[_OWN_ROTATION] = np.clip(np.log(limit), 1.0 - _REACH, _REACH)
        bounds = Bounds(-_REACH * scale, upper * scale)
        optimum = minimize(cost, none, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
        x = optimum.x / scale
        return replace(point_at(x), cost=float(optimum.fun) - float(prior @ (x + off) ** 2))


def _members(flights: Sequence[str]) -> dict[str, list[int]]:
    """Flight -> its segments."""
    return {f: [k for k, own in enumerate(flights) if own == f] for f in dict.fromkeys(flights)}


def _process(
    values: Sequence[FloatArray], V: Sequence[float], states: Sequence[GustStates]
) -> Process:
    """Of segments with such values and airspeeds."""
    noise, begin = zip(
        *(process_of(p, v, s) for p, v, s in zip(values, V, states, strict=True)), strict=True
    )
    return Process(np.stack(noise), np.stack(begin))


def _evenly_spaced(members: Sequence[int], max_count: int) -> list[int]:
    """At most so many of them, from the first to the last."""
    return [
        members[k]
        for k in np.unique(
            np.linspace(0, len(members) - 1, min(len(members), max_count)).astype(int)
        ).tolist()
    ]
