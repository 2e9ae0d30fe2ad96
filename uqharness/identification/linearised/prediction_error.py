"""Prediction error method in turbulence: a Kalman filter with gust states predicts each sample.

A flight in turbulence cannot be replayed, because its gusts are unknown. The model's forces and
their slopes are evaluated along the measured flight instead. A linear filter about them predicts
each sample from the samples before it. `gust_refit` alternates between estimating the air and a
Gauss-Newton step of the parameters.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from cachetools import LRUCache

from sysid.aerodynamics import (
    AIR,
    GustStates,
    Steps,
    flow_by_wind,
    rates,
    smooth,
    with_gust_states,
)
from sysid.aerodynamics.rigid_body import STATES as X_STATES
from sysid.arrays import FloatArray
from sysid.effects import (
    CACHED_AIRS,
    SIGNIFICANT_Z,
    Columns,
    FilteredSegment,
    TurbulenceModel,
    TurbulenceSearch,
    filter_segments,
    fit_colour,
    neg2_log_likelihood,
    whiten_filtered,
    with_air,
)
from sysid.estimation import MeasuredSystem
from sysid.parallel import SERIAL, Processes
from uqharness.identification.linearised.flight_data import (
    FlightData,
    ModelState,
    StagedModels,
    Trajectory,
    control_delay_s,
    jump_share,
)
from uqharness.identification.linearised.linearise import (
    Probe,
    accelerometer_outputs,
    control_jumps,
    delay_by_rows,
    load_deviations,
    path_deviations,
    sensor_delay_s,
    sensor_gain,
    sensor_offset,
    vane_offset_m,
    vane_shift,
    with_jumping_flights,
    with_mean_loads,
    with_property_slopes,
    with_sensor_errors,
    without_sensor_errors,
)
from uqharness.identification.linearised.replay_fit import (
    PRIOR,
    Linearisation,
    ModelFit,
    apply_step,
    parameter_columns,
    positions,
    probe_trajectory,
    slopes_of,
    step_from,
    steps_of,
)
from uqharness.replay import ReplayModel, Segment, with_controls_of

_KINDS = {
    c: kind
    for kind, members in {
        "attitude": ("phi", "theta", "psi"),
        "rate": ("p", "q", "r"),
        "force": ("ax", "ay", "az"),
        "wind": ("alpha", "beta"),
    }.items()
    for c in members
}
"""Kind of sensor of each channel, by the channel's name without unit."""
_SMOOTH_HZ = {"V_mps": 2.0}
_OVER_GROUND = ("psi_rad", "vn_mps", "ve_mps", "vd_mps")
_ANGLES = [X_STATES.index(name) for name in ("alpha_rad", "beta_rad")]
AIR_SEARCH_LENGTH, AIR_SEARCH_ITERATION = 5.0, 5
"""Length of a step, in standard errors, below which the air is estimated again, and the iteration
in which it is in any case.
"""
SERIES_TERMS = 5
"""Terms of the binomial series for states between rows; the sixth is 2e-4 where a motion decays by
a third per row.
"""
DELAY_GRID = 0.05
"""Grid of the controls' delay, in rows; positions are interpolated linearly between its points."""
STEP_SHARE_RANGE = 0.125, 4.0
"""Smallest and largest share of a step."""
NEARBY = 0.01
"""Relative change of a length, or change of the azimuth [rad] or of the gust ahead [m/s], to which
the innovations' sensitivity is found.
"""
TOLERANCE, ITERATIONS = 0.2, 10
"""Length of a step, in standard errors, that ends the iteration, and the most iterations."""


@dataclass(frozen=True)
class PredictedStates:
    """States (n, 8) of a segment predicted by the filter.

    ``variance`` (n, 2) and ``gust_ahead_mps`` (n,) as in `Probe`.
    """

    x: FloatArray
    variance: FloatArray
    gust_ahead_mps: FloatArray


@dataclass(frozen=True)
class TurbulentFit(ModelFit):
    """A model fitted to flights in turbulence.

    Attributes
    ----------
    turbulence : TurbulenceModel
        The air, estimated with the model.
    step_length : float
        Length of the last step, in standard errors.
    """

    turbulence: TurbulenceModel
    step_length: float


def measured_states(data: FlightData, point: ModelState) -> list[FloatArray]:
    """Return the measured states (n, 8) of each segment, smoothed, without the sensors' errors."""
    x = []
    for segment, channels in zip(data.segments, data.channels, strict=True):
        columns = []
        for name in X_STATES:
            value = without_sensor_errors(
                np.array(channels[name], dtype=float), name, segment, point
            )
            value = smooth(value, segment.dt_s, _SMOOTH_HZ.get(name, 6.0))
            late = sensor_delay_s(name, segment, point)
            columns.append(delay_by_rows(value, -late / segment.dt_s) if late else value)
        seen_values = np.column_stack(columns)
        x.append(seen_values - vane_offset_m(point) * vane_shift(seen_values, X_STATES))
    return x


def delay_rows(data: FlightData, segment: Segment, point: ModelState) -> dict[str, int]:
    """Return each channel's delay in whole rows."""
    return {c: round(sensor_delay_s(c, segment, point) / segment.dt_s) for c in data.outputs}


def aligned_outputs(data: FlightData, point: ModelState) -> list[FloatArray]:
    """Return the measured outputs (n, m) of each segment with whole rows of delay removed.

    A delayed sample beside current ones contradicts gusts that the filter has followed already,
    which would appear as noise.
    """
    delayed = [
        (z, delay_rows(data, s, point)) for s, z in zip(data.segments, data.measured, strict=True)
    ]
    return [
        np.column_stack([shift_rows(z[:, k], -late[c]) for k, c in enumerate(data.outputs)])
        for z, late in delayed
    ]


def shift_rows(values: FloatArray, rows: int) -> FloatArray:
    """Return values (n,) delayed by whole rows (advanced if negative); NaN where there are none."""
    at, last = np.arange(len(values)) - rows, len(values) - 1
    return np.where((at >= 0) & (at <= last), values[np.clip(at, 0, last)], np.nan)


def predict(
    models: StagedModels,
    data: FlightData,
    point: ModelState,
    pool: Processes,
    path: Sequence[PredictedStates] | None = None,
    *,
    control_paths: ControlPaths | None = None,
) -> tuple[Trajectory, list[Probe]]:
    """Probe the model along the measured flight, or along the predicted ``path``.

    ``control_paths`` are those of this model and flight, if there are several predictions.
    """
    x = measured_states(data, point) if path is None else [states.x for states in path]
    height = [np.array(c["h_m"], dtype=float) for c in data.channels]
    trajectory = Trajectory(
        point,
        [np.zeros((len(s.time_s), len(data.outputs))) for s in data.segments],
        x,
        height,
        float("nan"),
    )
    direct_model = models.direct_model
    controls, offsets = (control_paths or ControlPaths(models.model, data)).at(point)
    probes = probe_trajectory(direct_model, data, trajectory, controls, pool, consistent=False)
    curved = zip(
        probes,
        load_deviations(direct_model, data, trajectory, probes, offsets, pool),
        offsets,
        strict=True,
    )
    winds = _flows_by_wind(data, x)
    probes = [
        replace(p, reference=replace(p.reference, bend=b, flow_by_wind=w), jumped=control_jumps(a))
        for (p, b, a), w in zip(curved, winds, strict=True)
    ]
    if path is not None:
        variances = [states.variance for states in path]
        probes = [
            replace(p, reference=replace(p.reference, gust_ahead_mps=states.gust_ahead_mps))
            for p, states in zip(
                with_mean_loads(direct_model, data, trajectory, probes, variances, pool),
                path,
                strict=True,
            )
        ]
    return trajectory, probes


def _flows_by_wind(data: FlightData, path: Sequence[FloatArray]) -> list[FloatArray | None]:
    """Return `flow_by_wind` along ``path`` ((n, 8) per segment); None where the velocity over the
    ground or the heading was not measured.
    """
    pieces = [(f.record, piece.rows) for f in data.flights for piece in f.pieces]
    out = list[FloatArray | None]()
    for (record, rows), segment, x in zip(pieces, data.segments, path, strict=True):
        is_measured = all(c in record and np.isfinite(record[c][rows]).all() for c in _OVER_GROUND)
        if not is_measured:
            out.append(None)
            continue
        psi, north, east, down = (np.array(record[c][rows]) for c in _OVER_GROUND)
        out.append(flow_by_wind(x, psi, north, east, down, segment.dt_s))
    return out


class ControlPaths:
    """Positions of the controls of some flights, with the delays and servos of a point.

    Those at the last points of the grid of delays are cached: iterations move the delays within a
    point's neighbours.
    """

    def __init__(self, model: ReplayModel, data: FlightData) -> None:
        self._model, self._data = model, data
        self._cache: LRUCache[object, tuple[list[FloatArray], list[FloatArray]]] = LRUCache(4)

    def at(self, point: ModelState) -> tuple[list[FloatArray], list[FloatArray]]:
        """Return `positions` and `path_deviations` at a point.

        They are interpolated between the grid points below and above its delays. With the nearest
        grid point alone, estimates half-way between two points would alternate without end.
        """
        places = {
            s.flight: control_delay_s(point, s.flight) / s.dt_s / DELAY_GRID
            for s in self._data.segments
        }
        before = {flight: float(np.floor(place)) for flight, place in places.items()}
        shares = [places[s.flight] - before[s.flight] for s in self._data.segments]
        first = self._on_grid(before, 0.0, point)
        last = self._on_grid(before, 1.0, point) if any(shares) else first
        controls, deviations = (
            [a + share * (b - a) for a, b, share in zip(lower, upper, shares, strict=True)]
            for lower, upper in zip(first, last, strict=True)
        )
        return controls, deviations

    def _on_grid(
        self, places: Mapping[str, float], offset: float, point: ModelState
    ) -> tuple[list[FloatArray], list[FloatArray]]:
        """Return both with delays of ``places`` + ``offset`` of each flight, with a point's
        servos.
        """
        properties = self._data.properties(point)
        servos = [(name, properties.get(name)) for name in self._model.servos]
        key = (*places.items(), offset, *servos)
        if key not in self._cache:
            data = _with_delays(self._model, self._data, places, offset)
            self._cache[key] = (
                positions(self._model, data, point),
                path_deviations(self._model, data, point),
            )
        return self._cache[key]


def _with_delays(
    model: ReplayModel, data: FlightData, places: Mapping[str, float], offset: float
) -> FlightData:
    """Return the data with each flight's commands delayed by multiples of PLACES rows."""
    if not offset and not any(places.values()):
        return data
    pieces: list[Segment] = []
    for f in data.flights:
        delay_s = (places.get(f.name, 0.0) + offset) * DELAY_GRID * f.record.dt_s
        recorded = data.segments[len(pieces) : len(pieces) + len(f.pieces)]
        pieces += with_controls_of(
            recorded, f.with_delayed_commands(delay_s), tuple(model.measured)
        )
    return replace(data, segments=tuple(pieces))


def gust_refit(
    models: StagedModels,
    data: FlightData,
    start: ModelState,
    names: Sequence[str],
    limits: Mapping[str, tuple[float, float]],
    pool: Processes,
    *,
    turbulence: TurbulenceModel | None = None,
    iterations: int = ITERATIONS,
    tune: bool = False,
    fixed_air: bool = False,
    initial: Mapping[str, float] | None = None,
    callback: Callable[[int, float], None] | None = None,
) -> TurbulentFit:
    """Estimate parameters, nuisance and the air from a flight in turbulence.

    Each iteration estimates the air where it is due, evaluates the innovations and their
    sensitivities at the current model (`_evaluate`), and takes a Gauss-Newton step.

    Parameters
    ----------
    start : ModelState
        First values.
    names : sequence of str
        Estimated properties and active effects.
    limits : mapping
        Limits of properties.
    turbulence : TurbulenceModel, optional
        First values of the air.
    tune : bool
        Estimate the sensors' noise as well. It has no effect on an autopilot's log, whose
        attitudes are filtered.
    fixed_air : bool
        Keep ``turbulence``.
    initial : mapping, optional
        Values of the model before any fit: a second start where the air is unknown.
    callback : callable, optional
        Receives each iteration's number and the length of its step in standard errors.

    Raises
    ------
    numpy.linalg.LinAlgError
        If predictions are not finite.
    """
    data = with_jumping_flights(data, models.model)
    tune = tune and not data.delayed_sensors
    control_paths = ControlPaths(models.model, data)
    at = _Iterate(data, start, turbulence)
    if turbulence is None:
        starts = _starts(data, start, initial)
        if len(starts) > 1:
            at = likeliest_start(models, data, starts, pool, tune=tune)
    for number in range(1, iterations + 1):
        # Far from the estimate, what parameters will explain would be taken for gusts.
        is_near = at.length < AIR_SEARCH_LENGTH or number == AIR_SEARCH_ITERATION
        is_prediction = at.path is not None
        has_new_air = not fixed_air and (
            at.lacks_air or (is_near and at.distance_since_air > SIGNIFICANT_Z)
        )
        result, step = _evaluate(
            models,
            at,
            names,
            pool,
            estimates_air=has_new_air,
            tune=tune,
            # Near the estimate, the air moves along with the parameters.
            free_air=is_near and is_prediction and not fixed_air,
            # Colour estimated without an effect has absorbed it: the first iteration estimates
            # it anew.
            keeps_colour=number > 1 or fixed_air,
            fixed_colour=fixed_air,
            control_paths=control_paths,
        )
        if not np.isfinite(step).all():
            raise np.linalg.LinAlgError("predictions with this model are no numbers")
        if callback is not None:
            callback(number, result.step_length)
        # The air is up to date if it was estimated about predictions, this close to here.
        is_air_settled = fixed_air or (has_new_air and is_prediction)
        distance = 0.0 if is_air_settled else at.distance_since_air
        is_converged = (
            is_prediction and result.step_length < TOLERANCE and distance <= SIGNIFICANT_Z
        )
        if is_converged or not result.turbulence.is_turbulent or number == iterations:
            return result
        # Steps in different air are not comparable.
        share = (
            1.0
            if has_new_air or at.step is None
            else step_share(at.share, at.step, step, result.fit.information.total[0])
        )
        at = _advance(at, result, step, share, distance, limits)
        # Two linearisations at a time would take the most memory of all.
        del result
    raise ValueError(f"iterations={iterations}: at least one is needed")


@dataclass(frozen=True)
class _Iterate:
    """State of `gust_refit` between two iterations.

    Attributes
    ----------
    data : FlightData
        With the sensor noise that was estimated.
    point : ModelState
    turbulence : TurbulenceModel or None
        The air; None before it is first estimated.
    path : list of PredictedStates or None
        Predicted states about which the model is linearised; None for the measured ones.
    analytic : tuple of str or None
        As in `with_property_slopes`.
    step : (K,) array or None
        The last step, of which ``share`` was taken.
    length : float
        Length of the last step in standard errors.
    distance_since_air : float
        Distance from where the air was estimated, in standard errors.
    predicted : (Trajectory, list of Probe) or None
        Result of `predict` here, where the choice of the start has it already.
    """

    data: FlightData
    point: ModelState
    turbulence: TurbulenceModel | None
    path: list[PredictedStates] | None = None
    analytic: tuple[str, ...] | None = None
    step: FloatArray | None = None
    share: float = 1.0
    length: float = float("inf")
    distance_since_air: float = float("inf")
    predicted: tuple[Trajectory, list[Probe]] | None = None

    @property
    def lacks_air(self) -> bool:
        """Whether the air of some flight has not been estimated."""
        flights = {s.flight for s in self.data.segments}
        return self.turbulence is None or not flights <= self.turbulence.by_flight.keys()


def _evaluate(
    models: StagedModels,
    at: _Iterate,
    names: Sequence[str],
    pool: Processes,
    *,
    estimates_air: bool,
    tune: bool,
    free_air: bool,
    keeps_colour: bool,
    fixed_colour: bool,
    control_paths: ControlPaths,
) -> tuple[TurbulentFit, FloatArray]:
    """Return the flights' innovations and sensitivities at an iterate, and the step (K,) from it.

    ``free_air`` projects the sensitivities on changes of the air; ``keeps_colour`` starts from the
    colour of the innovations that the air has.
    """
    # 1. Linear systems along the path.
    trajectory, reference_probes = at.predicted or predict(
        models, at.data, at.point, pool, at.path, control_paths=control_paths
    )
    systems = _LinearSystems(at.data, trajectory, reference_probes, pool)
    # 2. Air and sensor noise.
    turbulence, data = at.turbulence, at.data
    if estimates_air:
        turbulence, factors = _turbulence_search(at.data, systems, at.turbulence, tune).run()
        data = replace(at.data, noise=factors * at.data.noise)
    assert turbulence is not None
    # 3. Innovations.
    steps = systems.all(turbulence.states)
    if free_air:
        followed = _with_free_air(systems, steps, turbulence, data.noise)
    else:
        rows, process = data.output_rows, turbulence.process
        followed = [*filter_segments(steps, systems.measured, rows, data.noise, process)]
    # Free the systems of other airs before the columns, which take the most memory.
    del systems
    # 4. Columns at the predicted states. Smoothed measurements contain later samples: linearised
    # about them, the airspeed sensor appears half a percent high.
    prediction, predicted_probes = at_predictions(
        data, trajectory, reference_probes, steps, followed, turbulence
    )
    active = {e.key for e in data.active}
    sloped_probes, analytic = with_property_slopes(
        models.direct_model,
        data.segments,
        predicted_probes,
        [n for n in names if n not in active],
        data.properties(at.point),
        analytic=at.analytic,
        pool=pool,
    )
    columns = parameter_columns(data, sloped_probes, prediction, names, analytic)
    # 5. Colour of the innovations, normal equations and step.
    colour, information = fit_colour(
        followed, columns, PRIOR, turbulence.colour if keeps_colour else None, fixed=fixed_colour
    )
    step, length = step_from(data, at.point, information)
    cost = float(sum(np.sum(w.residual**2) for w in information.white))
    fit = Linearisation(
        replace(prediction, cost=cost),
        sloped_probes,
        steps,
        columns,
        information,
        analytic,
        followed if free_air else None,
    )
    turbulence = replace(turbulence, colour=colour)
    neg2_log = neg2_log_likelihood(information.white) + (colour.penalty if colour else 0.0)
    return TurbulentFit(data, fit, neg2_log, turbulence, length), step


def _advance(
    at: _Iterate,
    result: TurbulentFit,
    step: FloatArray,
    share: float,
    distance: float,
    limits: Mapping[str, tuple[float, float]],
) -> _Iterate:
    """Return the iterate after a ``share`` of a step, ``distance`` from where the air was
    estimated.
    """
    names = result.fit.columns[0].names
    moves = dict(zip(names, (share * step).tolist(), strict=True))
    point = apply_step(result.data, at.point, moves, limits)
    probes = result.fit.probes
    path = []
    states = with_equal_readings(result.data, [p.body for p in probes], at.point, point)
    for x, p in zip(states, probes, strict=True):
        assert p.variance is not None
        assert p.gust_ahead_mps is not None
        path.append(PredictedStates(x, p.variance, p.gust_ahead_mps))
    return _Iterate(
        result.data,
        point,
        result.turbulence,
        path,
        result.fit.analytic,
        step,
        share,
        result.step_length,
        distance + share * result.step_length,
    )


def step_share(
    share: float, before: FloatArray, step: FloatArray, information: FloatArray
) -> float:
    """Return the share of ``step`` (K,) to take, by Aitken's rule for vectors.

    ``share`` is what was taken of the step ``before``; the metric is ``information``. A force that
    depends on alphadot changes that acceleration itself, of which columns contain half, so that
    steps overshoot. Steps of a sensor's delay fall short.

    References
    ----------
    Irons and Tuck, Int. J. Numer. Meth. Eng. 1, 1969.
    """
    change = step - before
    size = float(change @ information @ change)
    return (
        float(np.clip(-share * (before @ information @ change) / size, *STEP_SHARE_RANGE))
        if size > 0.0
        else 1.0
    )


def with_equal_readings(
    data: FlightData, path: Sequence[FloatArray], before: ModelState, after: ModelState
) -> list[FloatArray]:
    """Return states (n, 8) whose readings by the sensors ``after`` equal those of ``path`` by the
    sensors ``before``, since a filter follows the readings.
    """
    return [
        np.column_stack(
            [
                without_sensor_errors(
                    x[:, k] * sensor_gain(c, before) + sensor_offset(c, segment, before),
                    c,
                    segment,
                    after,
                )
                for k, c in enumerate(X_STATES)
            ]
        )
        for segment, x in zip(data.segments, path, strict=True)
    ]


def unfiltered_residuals(
    models: StagedModels,
    data: FlightData,
    point: ModelState,
    pool: Processes,
    turbulence: TurbulenceModel,
) -> tuple[Trajectory, list[FloatArray]]:
    """Return the measured flight and its residuals without a filter, in units of the noise.

    Residuals are measured outputs minus the model's at the measured states, (n, m) per segment.
    """
    trajectory, probes = predict(models, data, point, pool)
    steps = _LinearSystems(data, trajectory, probes, pool)
    pairs = zip(steps.measured, steps.all(turbulence.states), strict=True)
    return trajectory, [(z - s.y_ref[:, data.output_rows]) / data.noise for z, s in pairs]


def likeliest_start(
    models: StagedModels,
    data: FlightData,
    starts: Sequence[ModelState],
    pool: Processes,
    *,
    tune: bool,
) -> _Iterate:
    """Return the start of the largest likelihood in its air, with that air and sensor noise.

    Raises
    ------
    numpy.linalg.LinAlgError
        If no filter follows the flights from any start.
    """
    searches: list[tuple[TurbulenceSearch, _Iterate, _LinearSystems]] = []
    for point in starts:
        predicted = predict(models, data, point, pool)
        systems = _LinearSystems(data, *predicted, pool)
        search = _turbulence_search(data, systems, None, tune)
        if np.isfinite(search.cost):
            searches.append((search, _Iterate(data, point, None, predicted=predicted), systems))
    searches.sort(key=lambda trial: trial[0].cost)
    for search, _, systems in searches[1:]:
        systems.systems.clear()
        search.forget()
    # The structure of the air does not depend on delays.
    nuisance = [at.point.nuisance for _, at, _ in searches]
    searches = [s for s, one in zip(searches, nuisance, strict=True) if one == nuisance[0]]
    best, lowest, gain = None, np.inf, np.inf
    for search, at, systems in searches:
        # From a start this much less likely, the structure of the air would have to gain more
        # than twice what it gained from the likeliest.
        if search.cost - searches[0][0].cost > gain:
            break
        try:
            turbulence, factors = search.run()
            tuned = replace(data, noise=factors * data.noise)
            followed = filter_segments(
                systems.all(turbulence.states),
                systems.measured,
                tuned.output_rows,
                tuned.noise,
                turbulence.process,
            )
        except np.linalg.LinAlgError:
            continue
        cost = neg2_log_likelihood(
            whiten_filtered(followed, [Columns((), {}, {})] * len(data.segments))
        )
        gain = min(gain, search.gain)
        if cost < lowest:
            best, lowest = replace(at, data=tuned, turbulence=turbulence), cost
    if best is None:
        raise np.linalg.LinAlgError("predictions from every start are no numbers")
    return best


def _starts(
    data: FlightData, start: ModelState, initial: Mapping[str, float] | None
) -> list[ModelState]:
    """Return the starts of a fit whose air is unknown.

    Output error takes gusts for aerodynamics. From its derivatives the search for the air can end
    in another structure, such as air whose pitch has the wrong sign, which the fit then keeps; the
    model before any fit may be closer. Delays estimated by replays in turbulence may be far off,
    too, and the filter stays near its start.
    """
    delays = ("lateness/", "delay/")
    in_time = {n: 0.0 if n.startswith(delays) else v for n, v in start.nuisance.items()}
    is_late = any(abs(v - in_time[n]) > PRIOR["lateness"] for n, v in start.nuisance.items())
    starts = [start, replace(start, nuisance=in_time)][: 1 + is_late]
    values = {n: (initial or {}).get(n, v) for n, v in start.values.items()}
    if values != start.values:
        starts += [replace(s, values=values) for s in starts]
    return starts


class _LinearSystems:
    """Linear systems of the segments for different airs; the last ones are cached.

    A call returns systems without inputs, for likelihoods; `all` those with inputs.

    Attributes
    ----------
    measured : list of (n, m) array
        The outputs that the systems describe, from `aligned_outputs`.
    """

    def __init__(
        self, data: FlightData, trajectory: Trajectory, probes: Sequence[Probe], pool: Processes
    ) -> None:
        self.data, self.trajectory, self.probes, self.pool = data, trajectory, probes, pool
        self.measured = aligned_outputs(data, trajectory.point)
        self.slopes = slopes_of(probes, pool)
        self.systems: OrderedDict[tuple[int, GustStates, bool], Steps] = OrderedDict()

    def __call__(
        self, some: Sequence[int], states: Sequence[GustStates], inputs: bool = False
    ) -> list[Steps]:
        requests = [(k, air, inputs) for k, air in zip(some, states, strict=True)]
        missing, point = [key for key in requests if key not in self.systems], self.trajectory.point
        systems = steps_of(
            [self.slopes[k] for k, *_ in missing],
            [air for _, air, _ in missing],
            self.data,
            point,
            self.pool,
            inputs=inputs,
        )
        for (k, active, _), s in zip(missing, systems, strict=True):
            which, segment = self.data.output_rows, self.data.segments[k]
            share, rows = jump_share(point, segment.flight), delay_rows(self.data, segment, point)
            # Outputs are those at the reference, biases added.
            y = s.y_ref[:, which] - share * accelerometer_outputs(
                self.probes[k].felt_jump(0.5 * share), self.data.outputs
            )
            part = [
                sensor_delay_s(c, segment, point) / segment.dt_s - rows[c]
                for c in self.data.outputs
            ]
            behind = (
                self._behind(self.probes[k], s, y, active, np.array(part)) if any(part) else None
            )
            s.y_ref[:, which] = with_sensor_errors(
                y, self.data, segment, point, shifted_rows=rows, behind=behind
            )
            self.systems[k, active, inputs] = (
                replace(s, H=output_matrix_between_rows(s, which, part)) if any(part) else s
            )
        for key in requests:
            self.systems.move_to_end(key)
        out = [self.systems[key] for key in requests]
        while len(self.systems) > CACHED_AIRS * len(self.probes):
            self.systems.popitem(last=False)
        return out

    def _behind(
        self, p: Probe, steps: Steps, y: FloatArray, states: GustStates, late: FloatArray
    ) -> FloatArray:
        """Return the change (n, m) of the reference's outputs ``y`` (n, m) over delays ``late``
        (m,), fractions of a row.

        States move by the model between rows, not along the reference, which jumps by the
        innovation at each row: a parabola from the start of each step with its rate to the end.
        Controls add what the states do not explain.
        """
        point = self.trajectory.point
        gain = np.array([sensor_gain(c, point) for c in self.data.outputs])
        H = steps.H[:, self.data.output_rows] / gain[:, None]
        x = with_gust_states(p.reference.x, states, p.reference.turn)
        first = rates(p.reference, p.mass, x, gusts=states) * steps.dt_s
        curvature = steps.defect + np.diff(x, axis=0) - first[:-1]
        # A delayed sensor measures the step before a row, an early one the step after it.
        none = np.zeros_like(curvature[:1])
        ended, bent_before = (
            np.concatenate([first[:1], first[:-1] + 2.0 * curvature]),
            np.concatenate([none, curvature]),
        )
        start_rate, bent_behind = first, np.concatenate([curvature, none])
        sensed = y + vane_offset_m(point) * vane_shift(y, self.data.outputs)
        by_controls = np.diff(sensed, axis=0) - np.einsum("nij,nj->ni", H[1:], np.diff(x, axis=0))
        out = late * np.concatenate([by_controls[:1], by_controls])
        for k, part in enumerate(late):
            slope, bend = (ended, bent_before) if part > 0.0 else (start_rate, bent_behind)
            out[:, k] += np.einsum("nx,nx->n", H[:, k], part * slope - part**2 * bend)
        return np.asarray(out)

    def all(self, states: Sequence[GustStates]) -> list[Steps]:
        """Return the systems of all segments."""
        return self(range(len(self.probes)), states, inputs=True)


def output_matrix_between_rows(
    steps: Steps, rows: Sequence[int], late: Sequence[float]
) -> FloatArray:
    """Return H (n, m, x) for outputs ``rows`` that are delayed by fractions ``late`` of a row.

    States between rows follow (I + T)^a with a = -late and T = phi - I of the step, as a binomial
    series.
    """
    H = steps.H.copy()
    turn = steps.phi - np.eye(steps.phi.shape[1])
    for k, part in zip(rows, late, strict=True):
        if part:
            step = np.concatenate([turn[:1], turn] if part > 0.0 else [turn, turn[-1:]])
            power = H[:, k]
            for j in range(1, SERIES_TERMS + 1):
                power = np.einsum("nx,nxy->ny", power, step) * ((1.0 - part - j) / j)
                H[:, k] += power
    return H


def follow_in_free_air(
    data: FlightData, fit: Linearisation, turbulence: TurbulenceModel
) -> list[FilteredSegment]:
    """Filter the segments of a fit, the air free in each beside the columns."""
    if fit.followed is not None:
        return fit.followed
    linear = _LinearSystems(data, fit.trajectory, fit.probes, SERIAL)
    return _with_free_air(linear, fit.steps, turbulence, data.noise)


def _with_free_air(
    linear: _LinearSystems, steps: Sequence[Steps], turbulence: TurbulenceModel, noise: FloatArray
) -> list[FilteredSegment]:
    """Filter segments; columns are projected on what no other noise of a state, no other length of
    the air's roll, pitch and yaw, no other azimuth of its axes, and no mean gust ahead would do.
    """
    rows, process = linear.data.output_rows, turbulence.process
    names = ["p_length", "q_length", "r_length"]
    names += ["azimuth_rad"] if turbulence.states[0].in_earth else []
    names += ["ahead_mps"] if turbulence.states[0].in_body else []

    def nearby_airs(k: int) -> Iterator[MeasuredSystem]:
        """Yield the systems of a segment one by one, to save memory."""
        air = turbulence.states[k]
        for name in names:
            value = getattr(air, name)
            change = NEARBY * (value if name.endswith("length") else 1.0)
            linear.systems.clear()
            (system,) = linear([k], [air._replace(**{name: value + change})])
            yield MeasuredSystem.of(system, linear.measured[k], rows)

    followed = filter_segments(steps, linear.measured, rows, noise, process)
    return [*with_air(followed, process, noise, nearby_airs)]


def mean_heading(channels: Mapping[str, FloatArray]) -> float:
    """Return a segment's mean heading [rad]; 0 where none was measured."""
    return float(np.unwrap(channels["psi_rad"]).mean())


def _turbulence_search(
    data: FlightData, systems: _LinearSystems, initial: TurbulenceModel | None, tune: bool
) -> TurbulenceSearch:
    """Return the search for the air, and with ``tune`` for factors on the sensors' noise."""
    return TurbulenceSearch(
        systems,
        systems.measured,
        data.output_rows,
        data.noise,
        [float(x[:, 0].mean()) for x in systems.trajectory.x],
        [s.flight for s in data.segments],
        states=GustStates(systems.probes[0].mass.b),
        initial=initial,
        pool=systems.pool,
        kinds=[_KINDS.get(c.split("_")[0], c) for c in data.outputs] if tune else (),
        psi_rad=[mean_heading(c) for c in data.channels],
    )


def at_predictions(
    data: FlightData,
    trajectory: Trajectory,
    probes: Sequence[Probe],
    steps: Sequence[Steps],
    followed: Sequence[FilteredSegment],
    turbulence: TurbulenceModel,
) -> tuple[Trajectory, list[Probe]]:
    """Return probes whose terms are evaluated at the filter's predicted states, and the outputs
    there.

    At the measured states a term would contain the gust that it is to predict: Cl_p was estimated
    at three quarters of its value.
    """
    out, outputs = [], []
    for p, s, one, states in zip(probes, steps, followed, turbulence.states, strict=True):
        d = one.innovations_only.path
        x = with_gust_states(p.reference.x, states, p.reference.turn) + d
        air = x[:, 3:6] - np.column_stack(states.rotation(x.T))
        full_rates = rates(p.reference, p.mass, x, gusts=states)
        flow = rates(p.reference, p.mass, x, gusts=states._replace(turning_with=False))[:, 1:3]
        wind = p.reference.flow_by_wind if states.in_earth else None
        relative = np.column_stack([x[:, :3], air, x[:, 6:8]])
        coefficients = p.coefficients + _coefficient_change(
            p, (relative - p.reference.x)[:, : len(AIR)]
        )
        out.append(
            replace(
                p,
                reference=replace(p.reference, flow_by_wind=wind),
                coefficients=coefficients,
                body=x[:, :8],
                x=relative,
                rate=full_rates[:, :8],
                flow_rate=flow if wind is None else flow + wind,
                variance=one.gains.state_variance[:, _ANGLES],
                gust_ahead_mps=states.gust_ahead(x.T),
            )
        )
        outputs.append(
            s.y_ref[:, data.output_rows] + np.einsum("nij,nj->ni", s.H[:, data.output_rows], d)
        )
    return replace(trajectory, outputs=outputs), out


def _coefficient_change(p: Probe, moved: FloatArray) -> FloatArray:
    """Return the change (n, 6) of CX to Cn for a change ``moved`` (n, 6) of the air quantities."""
    faster = moved[:, :1] / p.reference.x[:, :1]
    change = (
        np.einsum("nij,nj->ni", p.reference.slopes, moved) / p.scale - 2.0 * faster * p.coefficients
    )
    change[:, 0] -= p.by_inflow * faster[:, 0]
    return change
