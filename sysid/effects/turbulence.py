"""Estimate the turbulence of recorded flights by maximum likelihood.

Gusts enter V, alpha and beta as white rates. Their rotation of the air and their axes are states of
`sysid.aerodynamics.air_motion`; the likelihood chooses among these structures. The spectral
densities depend on the airspeed, those of V and p as V, those of alpha and beta as 1/V, and each
flight has its own intensities. Gusts may pass at one constant speed, as in simulations that
generate them beforehand.

Each part of this model prevents a bias that was measured:

- Without the air's rotation, gusts that pitch the air and change alpha reduced Cm_alpha to a third.
- Without gusts along the path that turn with the aircraft, a moment from yaw rate squared appeared
  at |t| of 7.
- Without white moments about the body's axes, a moment that the model lacks is attributed to the
  air, and terms in other coefficients to the effects of such air.
- Gusts that pass at one speed, taken to pass at the airspeed, appeared as damping and stability
  that depend on thrust or angle of attack, at |t| of 4 to 6.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from cachetools import LRUCache
from scipy.optimize import Bounds, OptimizeResult, minimize

from sysid.aerodynamics import LENGTHS, NX, GustStates, Steps
from sysid.arrays import FloatArray
from sysid.effects.coloured_innovations import InnovationColour
from sysid.effects.tuned import CERTAIN_T, SIGNIFICANT_Z
from sysid.estimation import MeasuredSystem, Process, gains, variance_gradient, whiten_innovations
from sysid.parallel import SERIAL, Processes, Shared

# The likelihood of flights in an air, and its score: the derivatives with the air's intensities
# and the sensors' noise.
#
# Minus twice the log likelihood of one-step predictions with fitted start states (Astrom,
# Automatica 16, 1980), with w = L^-1 e whitened:
#
# sum |w|^2 + 2 ln det L, L L' = F = H P H' + R (1)
#
# One backward pass gives its derivatives, channel by channel (Koopman and Shephard, Biometrika 79,
# 1992; Durbin and Koopman, Time Series Analysis by State Space Methods, 2012, sections 6.4 and
# 7.3.3). With the innovation v, its variance s, the gain K and C = 1 - K h,
#
# u = v/s - K'r,  D = 1/s + K'N K,  r- = C'r + h'v/s,  N- = C'N C + h'h/s                (2)
# d/dR = D - u^2,  d/dQ = N - r r' after the step,  d/dP(0) = N - r r' before the first sample  (3)
#
# The start state maximises the likelihood, so its change with the air has no first-order effect.


@dataclass(frozen=True)
class Score:
    """Minus twice the log likelihood and its derivatives.

    Attributes
    ----------
    cost : float
        Minus twice the log likelihood; infinite, with zero derivatives, where no filter exists.
    noise : (m,) array
        Derivative with the logarithm of each sensor's standard deviation.
    process, begin : (S, x) array
        Derivatives with the variances of each segment's process noise and initial air.
    curvature : tuple of array
        The three derivatives without the sum of squares: upper bounds of the curvature with the
        logarithms.
    """

    cost: float
    noise: FloatArray
    process: FloatArray
    begin: FloatArray
    curvature: tuple[FloatArray, FloatArray, FloatArray]


class AirLikelihood:
    """Likelihood of segments as a function of the air.

    ``rows`` are the rows of OUTPUTS that ``measured``, (n, m) per segment, holds. The result does
    not depend on the number of processes.
    """

    def __init__(
        self,
        steps: Sequence[Steps],
        measured: Sequence[FloatArray],
        rows: Sequence[int],
        pool: Processes = SERIAL,
    ) -> None:
        self._pool = pool
        order = sorted(range(len(measured)), key=lambda k: -len(measured[k]))
        count = min(pool.count, len(order))
        self._groups = [order[k::count] for k in range(count)]
        self._shared = [
            pool.share([MeasuredSystem.of(steps[k], measured[k], rows) for k in group])
            for group in self._groups
        ]

    def __call__(self, noise: FloatArray, process: Process, slopes: bool = True) -> Score:
        """Evaluate the likelihood with sensor noise (m,); without ``slopes`` derivatives are 0."""
        jobs = [
            (shared, noise, process.of(group), slopes)
            for shared, group in zip(self._shared, self._groups, strict=True)
        ]
        scores = [one for some in self._pool(_score_segments, jobs) for one in some]
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


def _score_segments(job: tuple[Shared, FloatArray, Process, bool]) -> list[_Slopes]:
    """Return the cost of each segment and its derivatives, (2, m), (2, x) and (2, x): the parts of
    the determinant and of the squares.
    """
    shared, noise, process, sloping = job
    return [
        _score_segment(system, noise, (q, p), sloping)
        for system, q, p in zip(shared.value, process.noise, process.begin, strict=True)
    ]


def _score_segment(
    system: MeasuredSystem, noise: FloatArray, air: tuple[FloatArray, FloatArray], sloping: bool
) -> _Slopes:
    """Return the cost of one segment and its derivatives, as `_scored`."""
    flat = np.zeros((2, len(noise))), np.zeros((2, len(air[0]))), np.zeros((2, len(air[0])))
    try:
        filter_gains = gains(system, noise, air, with_prior_variance=False)
    except np.linalg.LinAlgError:
        return np.inf, *flat
    through = whiten_innovations(system, filter_gains)
    if not np.isfinite(through.starts).all():
        return np.inf, *flat
    white = _without_start(through.innovations, through.starts)
    cost = float(np.sum(white**2)) + 2.0 * filter_gains.logdet  # (1)
    if not sloping:
        return cost, *flat
    noise_slopes, process, begin = variance_gradient(system, filter_gains, white, air[0])
    return cost, 2.0 * noise**2 * noise_slopes, process, begin


def _without_start(innovations: FloatArray, starts: FloatArray) -> FloatArray:
    """Return innovations (n, m) with the start state fitted, whose sensitivities are ``starts``.

    By normal equations: errors of the state enter the sum of squares squared, and a search needs
    this a thousand times.
    """
    flat, stacked = starts.reshape(-1, starts.shape[2]), innovations.ravel()
    gram = flat.T @ flat
    scale = np.sqrt(np.diagonal(gram))
    scale[scale == 0.0] = 1.0
    state = np.linalg.lstsq(gram / np.outer(scale, scale), flat.T @ stacked / scale, rcond=1e-13)[0]
    return np.asarray((stacked - flat @ (state / scale)).reshape(innovations.shape))


Linear = Callable[[Sequence[int], Sequence[GustStates]], Sequence[Steps]]
"""Function that returns the linear systems of some segments in given airs."""
V_REFERENCE = 20.0
LIGHT_AIR = np.array([0.25, 5e-4, 5e-4, 5e-2, 1e-4, 1e-4, 1e-4, 1e-6, 1e-6])
"""The nine intensities of light air, at V_REFERENCE: start of the search.

V [m2/s3]; alpha and beta [rad2/s]; the air's roll [rad2/s3]; unexplained moments about the three
axes, as angular accelerations [rad2/s3]; the air's pitch and yaw beyond those of gusts at the
wing, as rates of alpha and beta [rad2/s].
"""
_MOMENTS = slice(4, 7)
_INDEPENDENT_ROTATION = slice(7, 9)
_MAX_INDEPENDENT = 1.0
"""Largest independent noise of the air's pitch and yaw, as a share of that of gusts across the path
or of the air's roll; an isotropic field has no more.
"""
_LENGTHS = (1.0, 0.5, 0.25, 2.0, 0.7, 1.4)
"""Trial lengths of the air's roll, pitch and yaw, in units of the standard's."""
_LONGEST_ROLL = 4.0
"""The same of roll alone: MIL-STD-1797's, sqrt(L b)/2.6, far above a small aircraft."""
_COMMON_SPEEDS = (0.5, 0.7, 1.4, 2.0)
"""Trial speeds at which the gusts of all flights pass, over their mean airspeed."""
_STRUCTURE_ROUNDS = 2
_FINER = 1.2
"""Factor of the refinement about the likeliest length."""
_NEGLIGIBLE = 1e-6
"""Factor that makes an intensity negligible."""
_MEMORY_S = 10.0
"""Time scale of gusts along and across the path: L/V of MIL-F-8785C at heights of small UAVs."""
_WITHOUT_ACROSS = np.array([1.0, _NEGLIGIBLE, _NEGLIGIBLE, *[1.0] * 6])
"""Factors that remove gusts across the path. Those along it and the air's roll stay, because sensor
errors and play resemble them.
"""
_FACTORS = (1e-4, 1e-2, 0.1, 1.0, 5.0)
"""Factors on LIGHT_AIR; the search starts from the likeliest."""
_MAX_SEGMENTS, _SEGMENTS_PER_FLIGHT, _SEGMENTS_FOR_SPEED, _SEGMENTS_FOR_AZIMUTH = 10, 6, 4, 2
_SPEED_LOG_STEP, _MAX_SPEED_STEPS, _SPEED_LOG_PRIOR_STD = 0.04, 3.0, 0.02
"""Step of the logarithm of the passing speed, the most such steps, and the prior standard deviation
of the logarithm about a flight's mean airspeed.
"""
_STRUCTURES = tuple(
    {"rotating": rotating, "turning_with": turning_with, "in_body": in_body}
    | {"in_earth": False, "azimuth_rad": 0.0}
    for in_body in (False, True)
    for rotating, turning_with in ((True, True), (True, False), (False, False), (False, True))
    if turning_with or not in_body
)
"""Structures: whether gusts rotate the air, whether they turn with the aircraft, and whether their
axes are the body's or the heading's.
"""
_AZIMUTHS, _AZIMUTH_STEPS = 5, (0.2, 0.05)
"""Number of trial azimuths of axes that are fixed to the earth, and steps [rad] of the parabolas
about the likeliest one.
"""
_STANDARD_ROTATION = {f"{axis}_length": 1.0 for axis in "pqr"} | {"r_share": 1.0}
"""Rotation with which these axes are tried."""
_SEARCH_RANGE, _COST_TOLERANCE, _FAILED_COST, _MIN_CURVATURE = 14.0, 1.0, 1e12, 20.0
"""Settings of the search in logarithms: its range, the decrease of the cost that ends it, the cost
of a filter that fails, and the least curvature.
"""
_FEW_DESCENTS, _MAX_DESCENTS = 4, 25
CACHED_AIRS = 2
"""Structures of the air whose linear systems are cached: the current one and the trial. Each takes
as much memory as a fit.
"""
NOISE_PRIOR = np.log(2.0)
"""Prior standard deviation of the logarithm of a sensor's noise about the card's value."""


@dataclass(frozen=True)
class TurbulenceModel:
    """Estimated air of some flights.

    Attributes
    ----------
    states : tuple of GustStates
        Structure of the gusts in each segment.
    values : (9,) array
        Intensities as LIGHT_AIR, the mean of the flights.
    by_flight : mapping
        Flight to its intensities (9,).
    passing : mapping
        Flight to the speed at which its gusts pass [m/s]; 0 for the airspeed.
    process : Process
        Process noise of each segment.
    gain : float
        Twice the log likelihood gained over calm air.
    across : float
        The part of the gain that is lost without gusts across the path, in alpha and beta.
    moments : (3,) array
        Loss without unexplained moments about each axis; NaN where no filter exists without them.
    factors : (m,) array
        Factors on the sensors' stated noise.
    colour : InnovationColour or None
        Colour of the innovations in this air: the departure from the gust model.
    azimuth_rad : mapping
        Flight to the azimuth of axes that are fixed to the earth.
    """

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
    azimuth_rad: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_turbulent(self) -> bool:
        """Whether the air is turbulent, by gusts across the path.

        Transient moments resemble air that rotates, sensor errors gusts along the path.
        """
        return self.across > CERTAIN_T**2

    def in_segments(
        self, V: Sequence[float], flights: Sequence[str], psi_rad: Sequence[float]
    ) -> TurbulenceModel:
        """Return the same air in other segments, with airspeeds ``V`` and mean headings ``psi_rad``
        of the named ``flights``.

        New flights have the mean intensities. If gusts pass at one speed, it is the mean airspeed
        in a new flight, unless all flights have a common one.
        """
        first = self.states[0]
        passing = {
            f: bool(first.passing_mps) * self._passing_of_new(float(np.mean([V[k] for k in part])))
            for f, part in _segments_of(flights).items()
        }
        passing |= self.passing
        by_flight = {f: self.by_flight.get(f, self.values) for f in flights}
        states = tuple(
            first._replace(
                passing_mps=passing[f],
                azimuth_rad=self.azimuth_rad.get(f, first.azimuth_rad),
                psi_rad=psi,
            )
            for f, psi in zip(flights, psi_rad, strict=True)
        )
        return replace(
            self,
            states=states,
            by_flight=by_flight,
            passing=passing,
            process=_process([by_flight[f] for f in flights], V, states),
        )

    def _passing_of_new(self, V: float) -> float:
        """Return the speed at which gusts pass in a new flight at airspeed ``V``."""
        speeds = {*self.passing.values()}
        if len(speeds) != 1:
            return V
        (speed,) = speeds
        is_far = speed > 0.0 and abs(np.log(speed / V)) > _SPEED_LOG_STEP * _MAX_SPEED_STEPS
        return speed if is_far or (speed and len(self.passing) > 1) else V

    @property
    def kind(self) -> tuple[bool, bool, bool]:
        """Whether gusts rotate the air, turn with the aircraft, and pass at one speed."""
        first = self.states[0]
        return first.rotating, first.turning_with, bool(first.passing_mps)

    @property
    def words(self) -> str:
        """Description of the gusts."""
        rotating, turning_with, at_one_speed = self.kind
        passing = ", and pass at one speed in each flight" if at_one_speed else ""
        rotate, turn = ("" if does else "do not " for does in (rotating, turning_with))
        first = self.states[0]
        azimuths = sorted({round(np.degrees(s.azimuth_rad)) for s in self.states})
        azimuth_words = " and ".join(f"{azimuth} deg" for azimuth in azimuths)
        axes = (
            " of the body's axes"
            if first.in_body
            else f" of axes at an azimuth of {azimuth_words}"
            if first.in_earth
            else ""
        )
        order = 0 if self.colour is None else len(self.colour.coefficients)
        colour_words = f", and whose innovations depend on {order} rows before" if order else ""
        return (
            f"gusts{axes} that {rotate}rotate the air{self._lengths} and {turn}turn with the"
            f" aircraft{passing}{colour_words}"
        )

    @property
    def _lengths(self) -> str:
        """Departures of the air's rotation from the standard, in words."""
        first = self.states[0]
        parts = []
        for name, share, length in (
            ("roll", 1.0, first.p_length),
            ("pitch", first.q_share, first.q_length),
            ("yaw", first.r_share, first.r_length),
        ):
            if (share, length) == (1.0, 1.0) or not (first.rotating or name == "roll"):
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

    ``values`` (9,) are intensities as in `TurbulenceModel.by_flight`. The spectral density of u' is
    2 sigma^2 V / L, that of alpha' and beta' 3 sigma^2 / (L V) (`process_of`).
    """
    along_path = values[0] / (2.0 * V_REFERENCE)
    across = np.max(values[1:3]) * V_REFERENCE / 3.0
    return float(max(along_path, across))


def process_of(values: FloatArray, V: float, states: GustStates) -> tuple[FloatArray, FloatArray]:
    """Return the process noise (13,) of the states per second at airspeed V, and the initial
    variances (13,) of the air.

    ``values`` are the nine intensities of LIGHT_AIR; those of velocities scale with the speed at
    which gusts pass.
    """
    faster = (states.passing_mps or V) / V_REFERENCE
    noise, begin = np.zeros(NX), np.zeros(NX)
    # Dryden far above its corner: PSD of u' is 2 sigma^2 V/L, of alpha' = w'/V 3 sigma^2/(L V).
    noise[0], noise[1], noise[2] = (
        values[0] * faster,
        *(faster * values[1:3] * (V_REFERENCE / V) ** 2),
    )
    across_noise = noise[2]
    if states.in_earth:
        # Gusts along and across the azimuth, by the mean heading.
        c2 = float(np.cos(states.psi_rad - states.azimuth_rad)) ** 2
        noise[0], noise[2] = (
            c2 * noise[0] + (1.0 - c2) * V**2 * across_noise,
            (1.0 - c2) * noise[0] / V**2 + c2 * across_noise,
        )
    # Moments are coefficients times dynamic pressure.
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
            states.rotating * states.r_share**2 * V**2 * across_noise,
        ]
    )
    begin[11:] = (
        0.5
        * _MEMORY_S
        * states.turning_with
        * (noise[[2, 1]] * V**2 if states.in_body else noise[[0, 2]] * [1.0, V**2])
    )
    # Independent noise of the air's pitch and yaw; h_q and h_r are velocities.
    noise[9:11] = V**2 * faster * values[_INDEPENDENT_ROTATION] * (V_REFERENCE / V) ** 2
    begin[9:11] += 0.5 * np.array(states.lags_s(V)[1:]) * noise[9:11]
    return noise, begin


@dataclass(frozen=True)
class TurbulenceSearch:
    """Search for the air of segments.

    The air is estimated on at most ten segments, then that of each flight on at most six.

    Attributes
    ----------
    linear : callable
        Returns the linear systems of some segments in given airs.
    measured : sequence of (n, m) array
        Measured outputs of each segment.
    rows : sequence of int
        Rows of OUTPUTS that were measured.
    noise : (m,) array
        Sensor noise; includes the factors of ``initial``.
    V, flights : sequence
        Airspeed [m/s] and flight of each segment.
    states : GustStates
        Structure of the gusts at the start.
    initial : TurbulenceModel, optional
        Start of the search. Its structure is kept if new intensities and noise gain no more than
        chance.
    pool : Processes
        Pool of processes.
    kinds : sequence of str
        Kind of sensor of each channel. The sensors of a kind have one estimated factor on their
        noise, with the prior NOISE_PRIOR; empty if the noise is known. In gusts samples do not
        determine the noise, and a filter with twice the true noise lags, like a servo.
    psi_rad : sequence of float, optional
        Mean heading of each segment.
    """

    linear: Linear
    measured: Sequence[FloatArray]
    rows: Sequence[int]
    noise: FloatArray
    V: Sequence[float]
    flights: Sequence[str]
    _: KW_ONLY
    states: GustStates
    initial: TurbulenceModel | None = None
    pool: Processes = SERIAL
    kinds: Sequence[str] = ()
    psi_rad: Sequence[float] | None = None

    @cached_property
    def _prior_factors(self) -> FloatArray:
        return np.ones(len(self.noise)) if self.initial is None else self.initial.factors

    @cached_property
    def _search(self) -> _Search:
        noise = self.noise / self._prior_factors
        return _Search(self.linear, self.measured, self.rows, noise, self.V, self.pool)

    @cached_property
    def _segments(self) -> list[int]:
        """Segments on which the air is estimated."""
        return _evenly_spaced(range(len(self.measured)), _MAX_SEGMENTS)

    @cached_property
    def _descended(self) -> tuple[float, _Point]:
        """The cost at the start, and the point of the likeliest intensities and noise."""
        psi_rad = [0.0] * len(self.measured) if self.psi_rad is None else self.psi_rad
        # 1. Start: light air of several strengths, or the air before.
        if self.initial is None:
            each = tuple(self.states._replace(psi_rad=psi) for psi in psi_rad)
            starts = [_Point(each, f * LIGHT_AIR, self._prior_factors) for f in _FACTORS]
        else:
            present = self.initial.in_segments(self.V, self.flights, psi_rad)
            starts = _points_of(present, self.flights, has_noise=bool(self.kinds))
        start = self._search.best(self._segments, starts)
        # 2. Intensities, and the sensors' noise.
        return start.cost, self._search.descend(self._segments, start, self.kinds)

    @cached_property
    def _chosen(self) -> _Point:
        """The likeliest point."""
        start_cost, optimum = self._descended
        # 3. Structure, passing speed and intensities of each flight, if the start was far.
        is_first = self.initial is None
        if not is_first and start_cost - optimum.cost <= SIGNIFICANT_Z**2:
            return optimum
        chosen = self._search.choose_air(
            self._segments,
            _segments_of(self.flights),
            optimum,
            self.flights,
            self.kinds,
            is_first=is_first,
        )
        return self._search.best(self._segments, [chosen])

    @property
    def cost(self) -> float:
        """Minus twice the log likelihood of some segments before the structure is chosen."""
        return self._descended[1].cost

    def forget(self) -> None:
        """Free the memory of cached likelihoods."""
        self._search.likelihoods.clear()

    @property
    def gain(self) -> float:
        """Decrease of ``cost`` by the structure."""
        return self.cost - self._chosen.cost

    def run(self) -> tuple[TurbulenceModel, FloatArray]:
        """Return the air, and the changes (m,) of the sensors' noise."""
        search, segments, initial, best = self._search, self._segments, self.initial, self._chosen
        segments_of_flight = _segments_of(self.flights)
        # 4. What is lost without parts of this air, with intensities by flight.
        gain, across = (
            (search.loss(segments, best, factors) for factors in (0.0, _WITHOUT_ACROSS))
            if initial is None
            else (initial.gain, initial.across)
        )
        single_moments = np.where(np.eye(len(LIGHT_AIR)), _NEGLIGIBLE, 1.0)[_MOMENTS]
        losses = np.array([search.loss(segments, best, factors) for factors in single_moments])
        return TurbulenceModel(
            best.states,
            best.values,
            {f: best.of(members[0]) for f, members in segments_of_flight.items()},
            {f: best.states[members[0]].passing_mps for f, members in segments_of_flight.items()},
            search.process(range(len(self.measured)), best),
            gain,
            across,
            np.where(np.isfinite(losses), losses, np.nan),
            best.factors,
            None if initial is None else initial.colour,
            {f: best.states[members[0]].azimuth_rad for f, members in segments_of_flight.items()},
        ), best.factors / self._prior_factors


def _points_of(model: TurbulenceModel, flights: Sequence[str], *, has_noise: bool) -> list[_Point]:
    """Return the starts of a search from an earlier air.

    With estimated noise that is far from the stated one, the stated one is a start as well: the
    search may not find its way back to it.
    """
    point = _Point(model.states, model.values, model.factors).with_intensities(
        model.by_flight, flights
    )
    is_far = has_noise and np.abs(np.log(model.factors)).max() > NOISE_PRIOR
    return [point, replace(point, factors=np.ones(len(model.factors)))] if is_far else [point]


@dataclass(frozen=True)
class _Point:
    """An air in the search: structure, intensities, noise factors, cost, and each segment's factors
    on the intensities.
    """

    states: tuple[GustStates, ...]
    values: FloatArray
    factors: FloatArray
    cost: float = np.inf
    segment_factors: FloatArray = field(default_factory=lambda: np.ones((1, len(LIGHT_AIR))))

    def of(self, k: int) -> FloatArray:
        """Return the intensities (9,) in a segment."""
        return np.asarray(self.values * self.segment_factors[k % len(self.segment_factors)])

    def with_intensities(
        self, by_flight: Mapping[str, FloatArray], flights: Sequence[str]
    ) -> _Point:
        """Return the point with the intensities of each segment's flight.

        Unexplained moments belong to the model and are equal in all flights.
        """
        values = np.mean([by_flight[f] for f in dict.fromkeys(flights)], axis=0)
        values[_MOMENTS] = self.values[_MOMENTS]
        stronger = np.array([by_flight[f] / values for f in flights])
        stronger[:, _MOMENTS] = 1.0
        return replace(self, values=values, segment_factors=stronger, cost=np.inf)

    def length(self, axis: str) -> tuple[float, float]:
        """Return length and share of the air's roll (axis p, of share 1), pitch (q) or yaw (r)."""
        first = self.states[0]
        return getattr(first, f"{axis}_length"), getattr(first, f"{axis}_share", 1.0)

    def with_length(self, axis: str, length: float, share: float) -> _Point:
        """Return the point with another `length` of an axis."""
        changes = {f"{axis}_length": length} | ({} if axis == "p" else {f"{axis}_share": share})
        return self.with_states(**changes)

    def with_azimuth(self, members: Sequence[int], azimuth_rad: float) -> _Point:
        """Return the point with another azimuth of the axes in some segments."""
        states = list(self.states)
        for k in members:
            states[k] = states[k]._replace(azimuth_rad=azimuth_rad)
        return replace(self, states=tuple(states))

    def with_states(self, **changes: Any) -> _Point:
        """Return the point with a changed structure in every segment."""
        return replace(self, states=tuple(s._replace(**changes) for s in self.states))


@dataclass(frozen=True)
class _Search:
    """Search for the likeliest air of segments."""

    linear: Linear
    measured: Sequence[FloatArray]
    which: Sequence[int]
    noise: FloatArray
    V: Sequence[float]
    pool: Processes
    likelihoods: LRUCache[tuple[tuple[int, GustStates], ...], AirLikelihood] = field(
        default_factory=lambda: LRUCache(CACHED_AIRS)
    )

    def score(self, segments: Sequence[int], point: _Point, slopes: bool = True) -> Score:
        """Return the score of the segments ``segments``."""
        states = [point.states[k] for k in segments]
        key = tuple(zip(segments, states, strict=True))
        if key not in self.likelihoods:
            data = [self.measured[k] for k in segments]
            self.likelihoods[key] = AirLikelihood(
                self.linear(segments, states), data, self.which, self.pool
            )
        return self.likelihoods[key](
            point.factors * self.noise, self.process(segments, point), slopes
        )

    def process(self, segments: Sequence[int], point: _Point) -> Process:
        """Return the process noise in the segments ``segments``."""
        return _process(
            [point.of(k) for k in segments],
            [self.V[k] for k in segments],
            [point.states[k] for k in segments],
        )

    def choose_air(
        self,
        segments: Sequence[int],
        segments_of_flight: Mapping[str, Sequence[int]],
        point: _Point,
        flights: Sequence[str],
        kinds: Sequence[str],
        *,
        is_first: bool,
    ) -> _Point:
        """Choose structure, passing speed and the intensities of each flight.

        Missing effects or sensor errors may have determined those of ``point``, unless this
        ``is_first``.
        """
        best = self.choose_structure(segments, segments_of_flight, point, kinds)
        if is_first:
            # Weaker air in one flight resembles gusts that pass more slowly, or moments.
            best = self.by_flight(segments_of_flight, best, flights, _FEW_DESCENTS)
        if best.states[0].rotating:
            # The moments of their rotation determine how fast gusts pass, if the parameters are
            # close.
            at_airspeed = best.with_states(passing_mps=0.0)
            likelier = self.best(segments, [at_airspeed, self.passing(segments_of_flight, best)])
            if likelier.states != best.states:
                best = self.descend(segments, likelier, kinds)
            # Some simulators generate gusts for one speed, whichever the aircraft's is. Real gusts
            # pass at the airspeed, so that what parameters have yet to explain is no evidence.
            common = self.common_speed(segments, best)
            best = self.accept(segments, best, common, kinds, CERTAIN_T**2)
        return self.by_flight(segments_of_flight, best, flights)

    def by_flight(
        self,
        segments_of_flight: Mapping[str, Sequence[int]],
        point: _Point,
        flights: Sequence[str],
        max_descents: int = _MAX_DESCENTS,
    ) -> _Point:
        """Return the point with estimated intensities of each flight.

        ``segments_of_flight`` maps flights to segments, ``flights`` names each segment's flight.
        """
        if len(segments_of_flight) == 1:
            return point
        single = {
            f: replace(
                point, values=point.of(part[0]), segment_factors=np.ones((1, len(LIGHT_AIR)))
            )
            for f, part in segments_of_flight.items()
        }
        by_flight = {
            f: self.descend(
                _evenly_spaced(segments_of_flight[f], _SEGMENTS_PER_FLIGHT), one, (), max_descents
            ).values
            for f, one in single.items()
        }
        return point.with_intensities(by_flight, flights)

    def passing(self, flights: Mapping[str, Sequence[int]], point: _Point) -> _Point:
        """Return the point with gusts that pass at one speed in each flight.

        The speed is the minimum of a parabola through three speeds about the mean airspeed.
        ``flights`` maps flights to their segments.
        """
        states = list(point.states)
        for members in flights.values():
            speed = float(np.mean([self.V[k] for k in members]))
            segments = _evenly_spaced(members, _SEGMENTS_FOR_SPEED)
            trials = [
                point.with_states(passing_mps=speed * np.exp(_SPEED_LOG_STEP * k))
                for k in (-1, 0, 1)
            ]
            slower, best_point, faster = (
                self.score(segments, p, slopes=False).cost for p in trials
            )
            bend = (
                slower
                - 2.0 * best_point
                + faster
                + 2.0 * (_SPEED_LOG_STEP / _SPEED_LOG_PRIOR_STD) ** 2
            )
            steps = 0.5 * (slower - faster) / bend if bend > 0.0 else np.sign(slower - faster)
            # Without a filter at all three speeds there is no parabola.
            steps = steps if np.isfinite([slower, best_point, faster]).all() else 0.0
            likeliest = speed * float(
                np.exp(_SPEED_LOG_STEP * np.clip(steps, -_MAX_SPEED_STEPS, _MAX_SPEED_STEPS))
            )
            for k in members:
                states[k] = states[k]._replace(passing_mps=likeliest)
        return replace(point, states=tuple(states))

    def best(self, segments: Sequence[int], points: Sequence[_Point]) -> _Point:
        """Return the likeliest of points."""
        return min(
            (replace(p, cost=self.score(segments, p, slopes=False).cost) for p in points),
            key=lambda p: p.cost,
        )

    def choose_structure(
        self,
        segments: Sequence[int],
        flights: Mapping[str, Sequence[int]],
        point: _Point,
        kinds: Sequence[str],
    ) -> _Point:
        """Choose the structure of the gusts: rotation, axes, and the lengths of roll, pitch and
        yaw.

        Each choice is repeated after the others.
        """
        best = point
        for _ in range(_STRUCTURE_ROUNDS):
            before = best
            frames = [best.with_states(**changes) for changes in _STRUCTURES]
            others = [frame for frame in frames if frame.states != best.states]
            frame = self.likeliest_structure(segments, best, others)
            best = self.accept(segments, best, frame, kinds)
            # Air that does not rotate is asked as well: a reversed pitch alone can make rotation
            # by the standard less likely than none.
            for axis in ("p", "q", "r"):
                shape = self.length(segments, best, axis)
                best = self.accept(segments, best, shape, kinds)
            if best.states == before.states:
                break
        # Last, because reversed pitch and yaw resemble the opposite azimuth.
        earth = self.earth_axes(segments, flights, best)
        if best.states[0].in_earth:
            return self.accept(segments, best, earth, kinds)
        turned = self.accept(segments, best, earth, kinds, CERTAIN_T**2)
        return best if turned is best else self.choose_structure(segments, flights, turned, kinds)

    def accept(
        self,
        segments: Sequence[int],
        best: _Point,
        trial: _Point,
        kinds: Sequence[str],
        required_gain: float = SIGNIFICANT_Z**2,
    ) -> _Point:
        """Return the optimum from a trial of another structure if it gains more than required."""
        if trial.states == best.states:
            return best
        required_cost = best.cost - required_gain
        other = self.descend(segments, trial, kinds, required_cost=required_cost)
        return other if other.cost < required_cost else best

    def likeliest_structure(
        self, segments: Sequence[int], best: _Point, others: Sequence[_Point]
    ) -> _Point:
        """Return the likeliest of points, compared with light unexplained moments and light
        independent rotation.

        At their estimated size these would absorb the differences between structures.
        """
        cleaned = [
            replace(_without_absorbers(p), segment_factors=best.segment_factors)
            for p in (best, *others)
        ]
        chosen = self.best(segments, cleaned)
        return best if chosen.states == best.states else replace(chosen, cost=np.inf)

    def earth_axes(
        self, segments: Sequence[int], flights: Mapping[str, Sequence[int]], best: _Point
    ) -> _Point:
        """Return the point with axes at the likeliest azimuth over the earth, in each flight.

        Gusts and rotation of some simulators have the axes of the mean wind. The opposite azimuth
        reverses pitch and yaw.
        """
        frame = {"rotating": True, "turning_with": False, "in_body": False, "in_earth": True}
        is_new = not best.states[0].in_earth
        standard = _without_absorbers(best.with_states(**frame, **_STANDARD_ROTATION))
        trials = [standard.with_states(q_share=q) for q in (1.0, -1.0)] if is_new else [best]
        turned = [self.with_azimuths(flights, trial) for trial in trials]
        chosen = self.best(segments, turned)
        if is_new:
            # Near the likeliest azimuth most of the gain is there already.
            present = self.score(segments, _without_absorbers(best), slopes=False).cost
            if chosen.cost >= present:
                return best
        for step in _AZIMUTH_STEPS:
            chosen = self.with_finer_azimuths(flights, chosen, step)
        return self.likeliest_structure(segments, best, [replace(chosen, cost=np.inf)])

    def with_azimuths(self, flights: Mapping[str, Sequence[int]], point: _Point) -> _Point:
        """Return the point with the likeliest azimuth in each flight.

        The azimuth turns vectors, so that the cost is nearly a trigonometric polynomial of second
        order. Its minimum and the likeliest of the trials that determine it are compared.
        """
        for members in flights.values():
            some = _evenly_spaced(members, _SEGMENTS_FOR_AZIMUTH)
            trials = 2.0 * np.pi / _AZIMUTHS * np.arange(_AZIMUTHS)
            costs = np.array([self.azimuth_cost(some, point, members, a) for a in trials])
            likeliest = float(trials[np.argmin(costs)])
            if np.isfinite(costs).all():
                fine = np.fft.irfft(np.fft.rfft(costs), 360)
                angle = float(np.radians(np.argmin(fine)))
                if self.azimuth_cost(some, point, members, angle) < costs.min():
                    likeliest = angle
            point = point.with_azimuth(members, likeliest)
        return point

    def with_finer_azimuths(
        self, flights: Mapping[str, Sequence[int]], point: _Point, step: float
    ) -> _Point:
        """Return the point with the azimuths at the minimum of a parabola through three each."""
        for members in flights.values():
            some = _evenly_spaced(members, _SEGMENTS_FOR_SPEED)
            middle = point.states[members[0]].azimuth_rad
            before, here, after = (
                self.azimuth_cost(some, point, members, middle + k * step) for k in (-1, 0, 1)
            )
            shift = parabola_minimum(before, here, after)
            azimuth = (middle + step * shift) % (2.0 * np.pi)
            point = point.with_azimuth(members, azimuth)
        return point

    def azimuth_cost(
        self, some: Sequence[int], point: _Point, members: Sequence[int], azimuth_rad: float
    ) -> float:
        """Return the cost of ``some`` segments of a flight, with axes at an azimuth in it."""
        return self.score(some, point.with_azimuth(members, azimuth_rad), slopes=False).cost

    def length(self, segments: Sequence[int], best: _Point, axis: str) -> _Point:
        """Return the point with the likeliest length of the air's roll (axis p), or the likeliest
        sign and length of its pitch (q) or yaw (r).
        """
        few = _evenly_spaced(segments, _SEGMENTS_FOR_SPEED)
        # The air's roll does not follow from gusts at the wing and has no sign.
        has_share = axis != "p"
        reversed_or_none = [(1.0, -1.0), (0.5, -1.0), (1.0, 0.0)] if has_share else []
        lengths = _LENGTHS if has_share else (*_LENGTHS, _LONGEST_ROLL)
        shapes = [*((n, 1.0) for n in lengths), *reversed_or_none]
        # In air that does not rotate, pitch and yaw follow from no gusts, and one of them may.
        starts_rotating = has_share and not best.states[0].rotating
        base = (
            best.with_states(rotating=True, q_share=0.0, r_share=0.0) if starts_rotating else best
        )
        chosen = self.likeliest_structure(few, best, [base.with_length(axis, *s) for s in shapes])
        length, share = chosen.length(axis)
        if chosen.states == best.states and (length == 1.0 or starts_rotating):
            return best
        finer = [base.with_length(axis, length * _FINER**k, share) for k in (-1, 1)]
        return self.likeliest_structure(few, chosen, finer)

    def common_speed(self, segments: Sequence[int], best: _Point) -> _Point:
        """Return the point with the likeliest speed at which the gusts of all flights pass.

        The air's rotation at such a speed has its present lengths or the standard's.
        """
        mean = float(np.mean(self.V))
        faster = np.array([s.passing_mps or v for s, v in zip(best.states, self.V, strict=True)])
        standard = {"p_length": 1.0, "q_length": 1.0, "r_length": 1.0}

        def at(ratio: float, lengths: Mapping[str, float]) -> _Point:
            """Return the point with a speed; its gusts keep their process noise."""
            values = best.values * float(np.mean(faster)) / (ratio * mean)
            values[_MOMENTS] = best.values[_MOMENTS]
            changed = best.with_states(passing_mps=ratio * mean, **lengths)
            return replace(changed, values=values)

        segments = _evenly_spaced(segments, _SEGMENTS_FOR_SPEED)
        trials = [
            (ratio, lengths, at(ratio, lengths))
            for ratio in _COMMON_SPEEDS
            for lengths in ({}, standard)
        ]
        chosen = self.likeliest_structure(segments, best, [point for *_, point in trials])
        of_chosen = [(r, n) for r, n, point in trials if point.states == chosen.states]
        if chosen.states == best.states or not of_chosen:
            return best
        ratio, lengths = of_chosen[0]
        # The minimum of a parabola through three speeds, twice: an error of a few per cent would
        # appear as moments that depend on the airspeed.
        for step in (np.log(_FINER), _SPEED_LOG_STEP):
            speeds = [ratio * float(np.exp(k * step)) for k in (-1, 0, 1)]
            slower, middle, faster_cost = (
                self.score(segments, _without_absorbers(at(r, lengths)), slopes=False).cost
                for r in speeds
            )
            ratio *= float(np.exp(step * parabola_minimum(slower, middle, faster_cost)))
        return at(ratio, lengths)

    def loss(self, segments: Sequence[int], point: _Point, factors: FloatArray | float) -> float:
        """Return the loss in 2 ln L if the intensities of a point are multiplied by ``factors``."""
        return (
            self.score(segments, replace(point, values=factors * point.values), slopes=False).cost
            - point.cost
        )

    def descend(
        self,
        segments: Sequence[int],
        point: _Point,
        kinds: Sequence[str],
        max_descents: int = _MAX_DESCENTS,
        required_cost: float = np.inf,
    ) -> _Point:
        """Return the likeliest intensities near a point, and with ``kinds`` the sensors' noise.

        A quasi-Newton search in the logarithms (L-BFGS-B; Byrd, Lu, Nocedal and Zhu, SIAM J. Sci.
        Comput. 16, 1995). It ends early if the last decrease in each remaining iteration would not
        suffice for ``required_cost``.
        """
        objective = _Objective.of(self, segments, point, kinds)
        options = {
            "maxiter": max_descents,
            "ftol": _COST_TOLERANCE / max(abs(objective.first.cost), 1.0),
            "gtol": 0.0,
        }
        costs = [objective.first.cost]

        def check_progress(intermediate_result: OptimizeResult) -> None:
            """End a search that would not reach the required cost."""
            costs.append(float(intermediate_result.fun))
            remaining = max_descents + 1 - len(costs)
            if costs[-1] - remaining * (costs[-2] - costs[-1]) > required_cost:
                raise StopIteration

        optimum = minimize(
            objective,
            np.zeros(len(objective.scale)),
            callback=check_progress,
            jac=True,
            method="L-BFGS-B",
            bounds=objective.bounds,
            options=options,
        )
        x = optimum.x / objective.scale
        return replace(objective.at(x), cost=float(optimum.fun) - objective.penalty(x)[0])


@dataclass(frozen=True)
class _Objective:
    """Penalised cost of segments as a function of changes of logarithms about a point.

    The x are the logarithms of the nine intensities, then those of the noise of each kind of
    sensor. The search has them multiplied by ``scale``.

    Attributes
    ----------
    search, segments, point
        The likelihood and where the search starts.
    shared : (k, m) array
        1 where a channel is of a kind of sensor.
    each : list of Process
        Process noise by each intensity alone: process noise and initial variances are linear in
        it.
    precision, prior : (9 + k,) array
        Inverse prior variance of each logarithm, and its value at the point less the prior mean.
    first : Score
        The score at the point.
    scale : (9 + k,) array
        Root of the curvature.
    """

    search: _Search
    segments: Sequence[int]
    point: _Point
    shared: FloatArray
    each: Sequence[Process]
    precision: FloatArray
    prior: FloatArray
    first: Score
    scale: FloatArray

    @staticmethod
    def of(
        search: _Search, segments: Sequence[int], point: _Point, kinds: Sequence[str]
    ) -> _Objective:
        """Return the objective about a point, with the sensors' ``kinds`` (none: noise fixed)."""
        unlike = list(dict.fromkeys(kinds))
        shared = np.array([[kind == one for kind in kinds] for one in unlike], dtype=float).reshape(
            len(unlike), len(point.factors)
        )
        each = [
            search.process(segments, replace(point, values=single))
            for single in np.diag(point.values)
        ]
        sizes = (len(point.values), len(unlike))
        precision = np.repeat([0.0, NOISE_PRIOR**-2], sizes)
        of_noise = shared @ np.log(point.factors) / np.maximum(shared.sum(axis=1), 1.0)
        prior = np.concatenate([np.zeros(sizes[0]), of_noise])
        first = search.score(segments, point)
        unscaled = _Objective(
            search, segments, point, shared, each, precision, prior, first, np.ones(len(prior))
        )
        # With a variance's logarithm the curvature equals the determinant's derivative, with a
        # standard deviation's twice that.
        curvature = unscaled.by_logarithms(0.0 * prior, *first.curvature)
        curvature *= np.repeat([1.0, 2.0], sizes)
        return replace(unscaled, scale=np.sqrt(np.maximum(curvature, _MIN_CURVATURE)))

    def at(self, x: FloatArray) -> _Point:
        """Return the point at changes of the logarithms."""
        count = len(self.each)
        return replace(
            self.point,
            values=self.point.values * np.exp(x[:count]),
            factors=self.point.factors * np.exp(x[count:] @ self.shared),
        )

    def by_logarithms(
        self, x: FloatArray, noise: FloatArray, process: FloatArray, begin: FloatArray
    ) -> FloatArray:
        """Return derivatives with the logarithms from those with the variances."""
        air = [np.sum(process * p.noise) + np.sum(begin * p.begin) for p in self.each]
        return np.concatenate([np.exp(x[: len(air)]) * air, self.shared @ noise])

    def penalty(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Return minus twice the logarithm of the prior, and its gradient."""
        distance = x + self.prior
        return float(self.precision @ distance**2), 2.0 * self.precision * distance

    def __call__(self, y: FloatArray) -> tuple[float, FloatArray]:
        """Return the penalised cost and its gradient in scaled logarithms."""
        x = y / self.scale
        score = self.search.score(self.segments, self.at(x)) if y.any() else self.first
        if not np.isfinite(score.cost):
            # A filter that fails has the largest cost and no gradient.
            return _FAILED_COST, np.zeros(len(x))
        penalty, slope = self.penalty(x)
        gradient = self.by_logarithms(x, score.noise, score.process, score.begin) + slope
        return score.cost + penalty, gradient / self.scale

    @property
    def bounds(self) -> Bounds:
        """Bounds of the scaled logarithms.

        Gusts across the path and the air's roll limit the independent pitch and yaw.
        """
        values, upper = self.point.values, np.full(len(self.scale), _SEARCH_RANGE)
        roll = values[3] * (LENGTHS[1] * self.point.states[0].b / V_REFERENCE) ** 2
        limit = _MAX_INDEPENDENT * np.maximum(values[1:3], roll) / values[_INDEPENDENT_ROTATION]
        upper[_INDEPENDENT_ROTATION] = np.clip(np.log(limit), 1.0 - _SEARCH_RANGE, _SEARCH_RANGE)
        return Bounds(-_SEARCH_RANGE * self.scale, upper * self.scale)


def parabola_minimum(before: float, here: float, after: float) -> float:
    """Return the minimum of a parabola through costs at -1, 0 and 1, at most 1.5 away; 0 where
    there is none.
    """
    bend = before - 2.0 * here + after
    shift = 0.5 * (before - after) / bend if bend > 0.0 else 0.0
    return float(np.clip(np.nan_to_num(shift), -1.5, 1.5))


def _without_absorbers(point: _Point) -> _Point:
    """Return the point with light unexplained moments and light independent rotation."""
    clean = point.values.copy()
    clean[4:] = np.minimum(clean[4:], LIGHT_AIR[4:])
    return replace(point, values=clean)


def _segments_of(flights: Sequence[str]) -> dict[str, list[int]]:
    """Return the segments of each flight."""
    return {f: [k for k, own in enumerate(flights) if own == f] for f in dict.fromkeys(flights)}


def _process(
    values: Sequence[FloatArray], V: Sequence[float], states: Sequence[GustStates]
) -> Process:
    """Return the process noise of segments from their intensities and airspeeds."""
    noise, begin = zip(
        *(process_of(p, v, s) for p, v, s in zip(values, V, states, strict=True)), strict=True
    )
    return Process(np.stack(noise), np.stack(begin))


def _evenly_spaced(members: Sequence[int], max_count: int) -> list[int]:
    """Return at most ``max_count`` members, evenly spaced from the first to the last."""
    return [
        members[k]
        for k in np.unique(
            np.linspace(0, len(members) - 1, min(len(members), max_count)).astype(int)
        ).tolist()
    ]
