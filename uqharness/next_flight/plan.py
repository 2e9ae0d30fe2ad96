"""Plan the test flight that narrows one coefficient's bounds most where a mission flies.

The campaign's sensitivity names the coefficient. `plan_flight` lets the model fly every test point
of a library, chooses points greedily by the narrowing of the interval per second of flight,
simulates the flight of the chosen points, and predicts the interval after it (an update of the
normal equations with the simulated states). Nothing is written outside a temporary folder.

`achieved` compares predicted and actual narrowing once bounds with the new flight exist.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sysid.aerodynamics import COEFFICIENTS, Cutoffs, Residuals, combine_flights
from sysid.arrays import FloatArray
from sysid.foreign.regular_files import file_sha256
from sysid.model_form import (
    BoundInformation,
    CoefficientBounds,
    Design,
    FitOptions,
    MissingTerm,
    ModelForm,
    Offer,
    Width,
    asymptotic,
    choose,
    expected_width,
    fit_bounds,
    information,
    mean_power,
    missing_terms,
    parameter_variance,
    speed_power,
    weighted_quartiles,
    width,
    with_more_data,
)
from sysid.units import percent
from uqharness.errors import BadInputError
from uqharness.files import scratch_folder
from uqharness.heartbeat import Callback, silent
from uqharness.next_flight.points import (
    MAX_BANK_RAD,
    QUIET_S,
    RANGE_EXTENSION,
    RECOVERY_S,
    REST_S,
    TRANSITION_S,
    CampaignMission,
    Condition,
    Occupancy,
    RefusedPoint,
    TestFlight,
    TestPoint,
    Trial,
    fly_points,
    has_autopilot,
    has_noise,
    library,
    residuals_of,
    schedule,
    sorted_points,
    try_points,
    unit_times,
)
from uqharness.results.base import read_result
from uqharness.results.next_flight import AchievedRow, Prediction, Predictions
from uqharness.simulator import Aircraft, content_hash, find_aircraft
from uqharness.text_tables import text_table

# Widths of the intervals with and without a flight, over the states of a mission.


@dataclass(frozen=True)
class Prospect:
    """Mean widths of one coefficient's interval over the mission.

    Attributes
    ----------
    current : Width
        With today's data.
    planned : Width
        With the flight's data, at today's scatter.
    refitted : Width
        With the flight's data, at the scatter expected when bounds are estimated again: noise grows
        as the dynamic pressure falls, so other speeds change it.
    repeated : Width
        With as many seconds of the manoeuvres that were flown before.
    asymptotic : Width
        With unlimited data, at today's scatter.
    """

    current: Width
    planned: Width
    refitted: Width
    repeated: Width
    asymptotic: Width

    @property
    def narrowing(self) -> float:
        """Share by which the mean width shrinks at today's scatter."""
        return 1.0 - self.planned.total / self.current.total

    @property
    def parameter_narrowing(self) -> float:
        """Share by which the part of the width that comes from the parameters shrinks."""
        return 1.0 - self.planned.parameter / self.current.parameter

    @property
    def at_most(self) -> float:
        """Share by which the mean width shrinks with unlimited data."""
        return 1.0 - self.asymptotic.total / self.current.total


def prospects(
    form: ModelForm,
    mission: Occupancy,
    simulated: Residuals,
    weight: float,
    trials: Sequence[Trial],
) -> dict[str, Prospect]:
    """Compute the prospect of every coefficient from the states of a simulated flight.

    Parameters
    ----------
    form : ModelForm
        Today's bounds.
    mission : Occupancy
        States at which the mission flies.
    simulated : Residuals
        Residual coefficients and states of the simulated flight.
    weight : float
        Samples of the bounds' data per sample of the flight; see
        `sysid.model_form.information_gain.information`.
    trials : sequence of Trial
        Test points as the model flew them, for the trend of the scatter with airspeed.

    Returns
    -------
    dict
        Coefficient -> Prospect.
    """
    # Length of the data behind the bounds, and of the simulated flight.
    data_s = sum(f.seconds for f in form.flights)
    new_s = sum(float(p.time_s[-1] - p.time_s[0]) for p in simulated.pieces)
    scatter = scatter_ratios(form, simulated, trials)
    out = {}
    # What the flight adds to each coefficient's information, at the states of the mission.
    for c, bounds in form.coefficients.items():
        states = mission.of(bounds.states)
        gained = [information(bounds, simulated.states, weight)]
        share = new_s / data_s if data_s > 0.0 else math.nan
        # Repeating the old manoeuvres multiplies their normal matrix by the ratio of flight times.
        repeated_information = BoundInformation(
            np.asarray(share * np.linalg.inv(bounds.XtX_inv)),
            share * bounds.n,
            bounds.hull.low,
            bounds.hull.high,
        )
        repeated = (
            with_more_data(bounds, [repeated_information]) if math.isfinite(share) else bounds
        )
        expected_forms = (
            with_more_data(bounds, gained),
            with_more_data(bounds, gained, scatter[c]),
            repeated,
            asymptotic(bounds),
        )
        out[c] = Prospect(
            width(bounds, states, form.outside),
            *(expected_width(bounds, b, states, form.outside) for b in expected_forms),
        )
    return out


def scatter_ratios(
    form: ModelForm, simulated: Residuals, trials: Sequence[Trial]
) -> dict[str, float]:
    """Predict the scatter at a flight's speeds.

    Parameters
    ----------
    form : ModelForm
        Bounds, whose hull has the speeds of the data behind them.
    simulated : Residuals
        The flight, with states (n,).
    trials : sequence of Trial
        Test points: the power law of their residual variance over V is the trend that is used.

    Returns
    -------
    dict
        Coefficient -> residual variance in the flight over residual variance behind the bounds; 1
        if there is no trend.
    """
    out = {}
    speeds = np.array([float(np.mean(t.states["V_mps"])) for t in trials])
    counts = np.array([float(len(t.delta)) for t in trials])
    hull = next(
        (
            (b.hull, b.states.index("V_mps"))
            for b in form.coefficients.values()
            if "V_mps" in b.states
        ),
        None,
    )
    for c in form.coefficients:
        k = COEFFICIENTS.index(c)
        # Residual variance follows a power of airspeed.
        power = speed_power(
            speeds, np.array([float(np.mean(t.delta[:, k] ** 2)) for t in trials]), counts
        )
        if hull is None or power == 0.0:
            out[c] = 1.0
            continue
        box, v = hull
        before = mean_power(box.middle[v], float(box.low[v]), float(box.high[v]), power)
        out[c] = float(np.mean(simulated.states["V_mps"] ** power)) / before
    return out


def designs_of(form: ModelForm) -> dict[str, Design]:
    """Return states and terms of a form, so that other flights are fitted with the same
    polynomial.
    """
    return {c: Design(b.states, b.terms) for c, b in form.coefficients.items()}


def widths_over(form: ModelForm, mission: Occupancy) -> dict[str, Width]:
    """Compute the mean widths of a form's intervals at the states of a mission."""
    return {c: width(b, mission.of(b.states), form.outside) for c, b in form.coefficients.items()}


MIN_NARROWING = 0.05
"""Smallest narrowing of the interval on the mission for which a flight is recommended."""
MAX_SENSOR_SCATTER_RATIO = 1.3
"""Largest ratio of the bounds' scatter (standard deviation) to that of the simulated flight that
sensors and air explain.
"""
_TURN_RAD = math.radians(8.0)
_MAX_ATTEMPTS = 8


@dataclass(frozen=True)
class Options:
    """Limits of a plan.

    Attributes
    ----------
    minutes : float
        Largest length of the flight.
    speeds_mps : tuple of float
        Airspeeds of the test points; empty for those of the mission.
    seed : int
        Seed of the simulations.
    """

    minutes: float = 5.0
    speeds_mps: tuple[float, ...] = ()
    seed: int = 1


@dataclass(frozen=True)
class StateQuartiles:
    """Quartiles (3,) of one flight state.

    Attributes
    ----------
    state : str
        Its name.
    data, mission : array (3,)
        In the data behind the bounds, and on the mission.
    variance : array (3,)
        Of the uncertainty on the mission: quartiles weighted by the prediction variance.
    """

    state: str
    data: FloatArray
    mission: FloatArray
    variance: FloatArray


@dataclass(frozen=True)
class PlannedPoint:
    """A test point of the flight, its times [s], and the share of the mean width that it removed
    when it was chosen after the points before it.
    """

    point: TestPoint
    start_s: float
    end_s: float
    gain: float


@dataclass(frozen=True)
class NextFlight:
    """A planned flight and what it is expected to bring.

    Attributes
    ----------
    coefficient : str
        Coefficient that the flight is for.
    prospects : mapping
        Coefficient -> Prospect.
    where : tuple of StateQuartiles
        Where data and mission lie, per state of the coefficient's bounds.
    extrapolated : float
        Share of the mission outside the data.
    plan : tuple of PlannedPoint
        Test points in the order of the flight.
    end_s : float
        Length of the flight.
    scatter : float
        Residual standard deviation of the bounds.
    simulated_scatter : float
        That of the same fit to the simulated flight, which has sensor noise and turbulence but no
        model error; NaN if the flight is too short.
    refused : tuple of RefusedPoint
        Points that the model could not fly within the limits.
    n_points : int
        Points that were simulated.
    states : mapping
        State -> filtered values (n,) of the planned flight.
    bounds_after : CoefficientBounds
        Bounds of the coefficient with the flight's data, but unchanged polynomial coefficients.
    """

    coefficient: str
    prospects: Mapping[str, Prospect]
    where: tuple[StateQuartiles, ...]
    extrapolated: float
    plan: tuple[PlannedPoint, ...]
    end_s: float
    scatter: float
    simulated_scatter: float
    refused: tuple[RefusedPoint, ...]
    n_points: int
    states: Mapping[str, FloatArray]
    bounds_after: CoefficientBounds

    @property
    def prospect(self) -> Prospect:
        """Prospect of the chosen coefficient."""
        return self.prospects[self.coefficient]

    @property
    def worth_flying(self) -> bool:
        """Whether the interval narrows by at least `MIN_NARROWING`."""
        return self.prospect.narrowing >= MIN_NARROWING

    @property
    def form_is_short(self) -> bool:
        """Whether the scatter is larger than sensors and air explain, so that the polynomial lacks
        a term (or the air was rougher).
        """
        return self.scatter > MAX_SENSOR_SCATTER_RATIO * self.simulated_scatter


def check_form(form: ModelForm, aircraft: Aircraft, coefficient: str, where: str) -> None:
    """Refuse bounds that cannot be narrowed by flying.

    Parameters
    ----------
    form : ModelForm
        The bounds.
    aircraft : Aircraft
        Aircraft of the campaign.
    coefficient : str
        Coefficient that must be in them.
    where : str
        Name of the bounds in messages.

    Raises
    ------
    BadInputError
        If they belong to another aircraft, lack the coefficient, or are constant.
    """
    if form.aircraft.name != aircraft.name:
        raise BadInputError(
            f"{where}: the bounds belong to aircraft '{form.aircraft.name}', the campaign flew"
            f" '{aircraft.name}'; give the bounds of the aircraft that flew (uqharness bounds)"
        )
    if coefficient not in form.coefficients:
        raise BadInputError(
            f"{where}: has no bounds for {coefficient}; it has {', '.join(form.coefficients)}. Make"
            " them with uqharness bounds"
        )
    bounds = form.coefficients[coefficient]
    if all(not any(term) for term in bounds.terms):
        raise BadInputError(
            f"{where}: the bounds of {coefficient} are constant: they depend on no flight state, so"
            " no test point narrows them more than another. Make bounds"
            f" of order 1 or 2 from a flight that moves {', '.join(bounds.states)} (uqharness"
            " bounds --order 2), then ask again"
        )


def allowed_states(form: ModelForm, mission: Occupancy) -> dict[str, tuple[float, float]]:
    """Return the ranges that test points may reach: state -> (lower, upper).

    The range of data and mission together is extended by half its width on either side; bank is
    limited to 60 deg or the mission's largest.
    """
    out: dict[str, tuple[float, float]] = {}
    # Only airspeed and angles limit a point; rates may be anything.
    for bounds in form.coefficients.values():
        for k, state in enumerate(bounds.states):
            if state.startswith(("V_", "alpha", "beta")) and state in mission.states:
                values = mission.states[state]
                low, high = (
                    min(bounds.hull.low[k], values.min()),
                    max(bounds.hull.high[k], values.max()),
                )
                out[state] = (
                    float(low - RANGE_EXTENSION * (high - low)),
                    float(high + RANGE_EXTENSION * (high - low)),
                )
    bank_limit = MAX_BANK_RAD
    if "phi_rad" in mission.states:
        bank_limit = max(bank_limit, float(np.abs(mission.states["phi_rad"]).max()))
    return {**out, "phi_rad": (-bank_limit, bank_limit)}


def conditions_of(
    mission: Occupancy, flight: TestFlight, speeds_mps: Sequence[float]
) -> list[Condition]:
    """List speeds and banks of test points.

    Speeds are ``speeds_mps``, or the 5, 50 and 95 % quantiles of the mission; each is flown
    straight and at the median bank of left and right turns. Without an autopilot there is one
    condition: as the mission flies.
    """
    if not flight.has_autopilot:
        return [Condition()]
    speeds = sorted(speeds_mps) or [
        float(f"{v:.3g}") for v in np.quantile(mission.states["V_mps"], [0.05, 0.5, 0.95])
    ]
    phi = mission.states.get("phi_rad", np.zeros(1))
    banks = [0.0]
    for side in (phi[phi > _TURN_RAD], phi[phi < -_TURN_RAD]):
        # A turn counts if the mission spends more than a tenth of its time in it.
        if len(side) > 0.1 * len(phi):
            banks.append(float(round(math.degrees(float(np.median(side))))))
    return [Condition(v, b) for v in dict.fromkeys(speeds) for b in banks]


def plan_flight(
    form: ModelForm,
    coefficient: str,
    mission: Occupancy,
    flight: TestFlight,
    options: Options,
    callback: Callback = silent,
) -> NextFlight:
    """Choose test points, simulate their flight and predict the narrowing.

    Parameters
    ----------
    form : ModelForm
        Today's bounds.
    coefficient : str
        Coefficient to narrow.
    mission : Occupancy
        States at which the mission flies.
    flight : TestFlight
        How test flights are simulated.
    options : Options
        Length, speeds and seed.
    callback : callable
        Called with the name of each step as it starts.

    Returns
    -------
    NextFlight

    Raises
    ------
    BadInputError
        If no test point can be flown, fits into the time, or narrows anything.
    """
    cutoffs = Cutoffs(form.filtering.cutoff_hz, form.filtering.airspeed_cutoff_hz)
    _check_minutes(flight, options)
    callback("trying test points")
    trials, refused = try_library(form, mission, flight, options, cutoffs)
    callback("choosing")
    return plan_from(
        form, coefficient, mission, flight, options, trials, refused=refused, callback=callback
    )


def _check_minutes(flight: TestFlight, options: Options) -> None:
    """Refuse a flight that is too short for any test point, before anything is simulated."""
    shortest_s = QUIET_S + REST_S + RECOVERY_S + _lead_in_s(flight)
    if 60.0 * options.minutes < shortest_s:
        raise BadInputError(
            f"--minutes {options.minutes:g}: no test point fits; the shortest takes"
            f" {shortest_s / 60.0:.2g} minutes with what comes before it"
        )


def _lead_in_s(flight: TestFlight) -> float:
    """Return the seconds before the first test point."""
    return flight.begin_s + (TRANSITION_S if flight.has_autopilot else 0.0)


def try_library(
    form: ModelForm, mission: Occupancy, flight: TestFlight, options: Options, cutoffs: Cutoffs
) -> tuple[list[Trial], list[RefusedPoint]]:
    """Let the model fly every test point of the library.

    Raises BadInputError if none stays within the limits.
    """
    conditions = conditions_of(mission, flight, options.speeds_mps)
    speed = float(np.median(mission.states["V_mps"]))
    points = library(flight.aircraft, conditions, unit_times(flight.aircraft, speed, 100.0))
    trials, refused = try_points(
        flight, points, allowed_states(form, mission), cutoffs, options.seed
    )
    if not trials:
        first = refused[0]
        raise BadInputError(
            f"'{flight.aircraft.name}': none of the {len(points)} test points is feasible; the"
            f" first, {first.point.name}: {first.reason}. Give other --speeds, or bounds from a"
            " flight with larger motions"
        )
    return trials, refused


def plan_from(
    form: ModelForm,
    coefficient: str,
    mission: Occupancy,
    flight: TestFlight,
    options: Options,
    trials: Sequence[Trial],
    *,
    refused: Sequence[RefusedPoint],
    callback: Callback = silent,
) -> NextFlight:
    """Plan a flight from test points that have been simulated already; see `plan_flight`."""
    bounds = form.coefficients[coefficient]
    states = mission.of(bounds.states)
    weight = form.filtering.rate_hz / flight.rate_hz
    # Each point is offered with its flight time and the information that its states add.
    offers = [
        Offer(
            t.point.condition.text,
            t.point.seconds + RECOVERY_S,
            information(bounds, t.states, weight),
        )
        for t in trials
    ]
    transition = TRANSITION_S if flight.has_autopilot else 0.0
    # Greedy choice by narrowing per second, with transitions between conditions.
    chosen = choose(
        bounds, offers, states, 60.0 * options.minutes - flight.begin_s, transition, form.outside
    )
    if not chosen:
        raise BadInputError(
            f"--minutes {options.minutes:g}: no test point fits or narrows anything; the shortest"
            f" takes {(min(o.seconds for o in offers) + _lead_in_s(flight)) / 60.0:.2g} minutes"
            " with what comes before it"
        )
    # The gain of a point depends on the points chosen before it.
    gains: dict[int, float] = {}
    before = _mean_half_width(form, coefficient, states)
    for order, item in enumerate(chosen):
        gains[order] = (before - item.half_width) / before
        before = item.half_width
    picked = [(trials[c.index].point, gains[k]) for k, c in enumerate(chosen)]
    # Points of one condition are flown together, which saves transitions.
    conditions = [p.condition for p in sorted_points([p for p, _ in picked])]
    picked.sort(key=lambda item: conditions.index(item[0].condition))
    callback("simulating the flight")
    # A new seed: the flight meets other noise and gusts than the trials that chose it.
    simulated, flown_points, rejected = _simulate(flight, picked, options.seed + 1000, form)
    # Points may have been removed, so times are computed again.
    timed, end_s = schedule([p for p, _ in flown_points], flight.begin_s)
    plan = tuple(
        PlannedPoint(t.point, t.start_s, t.end_s, g)
        for t, (_, g) in zip(timed, flown_points, strict=True)
    )
    callback("predicting")
    return NextFlight(
        coefficient=coefficient,
        prospects=prospects(form, mission, simulated, weight, trials),
        where=_state_quartiles(form, coefficient, mission),
        extrapolated=float(np.mean(form.extrapolated(mission.of(form.states)))),
        plan=plan,
        end_s=end_s,
        scatter=math.sqrt(bounds.s2),
        simulated_scatter=_scatter(simulated, form, coefficient),
        refused=(*refused, *rejected),
        n_points=len(trials) + len(refused),
        states=simulated.states,
        bounds_after=with_more_data(bounds, [information(bounds, simulated.states, weight)]),
    )


def _mean_half_width(form: ModelForm, coefficient: str, states: Mapping[str, FloatArray]) -> float:
    """Compute the mean half width of the coefficient's interval over the mission."""
    bounds = form.coefficients[coefficient]
    variance = bounds.constant_variance + parameter_variance(bounds, states, form.outside)
    return float(bounds.t * np.mean(np.sqrt(variance)))


def _state_quartiles(
    form: ModelForm, coefficient: str, mission: Occupancy
) -> tuple[StateQuartiles, ...]:
    """Compute for each state the quartiles of data, mission and uncertainty."""
    bounds = form.coefficients[coefficient]
    states = mission.of(bounds.states)
    variance = parameter_variance(bounds, states, form.outside)
    equal_weights = np.ones(len(variance))
    return tuple(
        StateQuartiles(
            s,
            bounds.hull.middle[k],
            weighted_quartiles(states[s], equal_weights),
            weighted_quartiles(states[s], variance),
        )
        for k, s in enumerate(bounds.states)
    )


def _simulate(
    flight: TestFlight, picked: Sequence[tuple[TestPoint, float]], seed: int, form: ModelForm
) -> tuple[Residuals, list[tuple[TestPoint, float]], list[RefusedPoint]]:
    """Let the model fly all chosen points in one flight; a point at which the flight ends is
    removed and the rest is flown again.

    Raises BadInputError if no attempt reaches the end.
    """
    cutoffs = Cutoffs(form.filtering.cutoff_hz, form.filtering.airspeed_cutoff_hz)
    remaining, rejected = list(picked), list[RefusedPoint]()
    with scratch_folder() as scratch:
        for attempt in range(_MAX_ATTEMPTS):
            path = scratch.path / f"next-flight-{attempt}.parquet"
            ok, flown_s, reason = fly_points(flight, [p for p, _ in remaining], seed, path)
            if ok:
                return residuals_of(flight.aircraft, [path], cutoffs)[0], remaining, rejected
            timed, _ = schedule([p for p, _ in remaining], flight.begin_s)
            # The first point that was not completed ended the flight.
            failed_index = next(
                (k for k, t in enumerate(timed) if t.end_s + RECOVERY_S > flown_s),
                len(remaining) - 1,
            )
            rejected.append(RefusedPoint(remaining[failed_index][0], f"the flight ends: {reason}"))
            remaining = [item for item in remaining if item[0] != remaining[failed_index][0]]
            if not remaining:
                break
    raise BadInputError(f"the flight of the chosen test points fails: {rejected[-1].reason}")


def _scatter(simulated: Residuals, form: ModelForm, coefficient: str) -> float:
    """Compute the residual standard deviation of the form's terms fitted to a flight; NaN if the
    flight is too short for them.
    """
    try:
        fitted = fit_bounds(simulated, {coefficient: designs_of(form)[coefficient]}, FitOptions())
    except ValueError:
        return math.nan
    return math.sqrt(fitted[coefficient].bounds.s2)


# Inputs of a plan from a campaign's folder, and remarks on their quality.

_BURN_IN_S = 120.0
_ON_AUTOPILOT_S = 4.0


def bounds_of(campaign: CampaignMission, folder: Path, coefficient: str) -> Path:
    """Return the model-form file that a campaign used.

    Parameters
    ----------
    campaign : CampaignMission
        The campaign.
    folder : Path
        Its folder, for messages.
    coefficient : str
        Coefficient to narrow, for messages.

    Raises
    ------
    BadInputError
        If the campaign used constant bounds, or those that the aircraft carries.
    """
    if campaign.spec.inputs.model_form is not None:
        return campaign.spec.inputs.model_form
    if not _has_constant_bounds(campaign):
        raise BadInputError(
            f"{folder}: flew the bounds that the aircraft carries; give the model-form.json that"
            " they were made from with --bounds (constant ones tell nothing of where data are"
            " lacking)"
        )
    raise BadInputError(
        f"{folder}: flew constant bounds of {coefficient}, which depend on no flight state, so that"
        " no state lacks data. Make bounds from flights (uqharness bounds AIRCRAFT"
        " --flight FILE --out DIR) and give them with --bounds DIR/model-form.json"
    )


def _has_constant_bounds(campaign: CampaignMission) -> bool:
    """Return whether the campaign file has its bounds as numbers."""
    return isinstance(campaign.spec.epistemic.bounds, dict)


def aircraft_of(campaign: CampaignMission) -> Aircraft:
    """Return the aircraft to plan with: the author's, or the campaign's copy if that holds the
    initial conditions (a trimmed start).
    """
    uses_copy = campaign.spec.start is not None or campaign.mission.source == Path()
    return find_aircraft(campaign.mission.aircraft if uses_copy else campaign.mission.source)


def flight_of(
    campaign: CampaignMission, aircraft: Aircraft, form: ModelForm, turbulence: str
) -> TestFlight:
    """Return how the test flight is simulated.

    Parameters
    ----------
    campaign : CampaignMission
        Its mission script, burn-in and source of turbulence are used.
    aircraft : Aircraft
        Aircraft of the test flight.
    form : ModelForm
        Bounds, whose sample rate (at most 60 Hz) is that of the record.
    turbulence : str
        Intensity.

    Returns
    -------
    TestFlight
    """
    on_autopilot = campaign.spec.start is None and has_autopilot(aircraft)
    # The autopilot needs a few seconds; without it the mission's own burn-in applies.
    begin_s = (
        _ON_AUTOPILOT_S
        if on_autopilot
        else min(float(campaign.spec.aleatory.burn_in_s), _BURN_IN_S)
    )
    # The record keeps every n-th frame, so its rate is the nearest that the frame rate allows.
    steps = max(1, round(1.0 / (min(form.filtering.rate_hz, 60.0) * aircraft.dt_s)))
    return TestFlight(
        aircraft,
        campaign.mission.script,
        on_autopilot,
        begin_s,
        turbulence,
        has_noise(aircraft),
        1.0 / (steps * aircraft.dt_s),
        campaign.spec.aleatory.turbulence_source,
    )


def missing_in(
    form: ModelForm, aircraft: Aircraft, coefficient: str, flights: Sequence[Path]
) -> list[MissingTerm]:
    """Find terms that are missing in a coefficient's polynomial.

    Parameters
    ----------
    form : ModelForm
        The bounds.
    aircraft : Aircraft
        Aircraft that predicts the flights.
    coefficient : str
        Its polynomial is extended term by term.
    flights : sequence of Path
        Records.

    Returns
    -------
    list of MissingTerm

    Raises
    ------
    BadInputError
        If the flights cannot be read or are too short.
    """
    cutoffs = Cutoffs(form.filtering.cutoff_hz, form.filtering.airspeed_cutoff_hz)
    residuals = combine_flights(residuals_of(aircraft, flights, cutoffs))
    try:
        return missing_terms(residuals, coefficient, form.coefficients[coefficient])
    except ValueError as error:
        raise BadInputError(f"--flight: {error}") from None


def warnings_of(
    form: ModelForm,
    campaign: CampaignMission,
    flight: TestFlight,
    bounds: Path | None,
    flights: Sequence[Path],
    from_campaign: bool,
) -> list[str]:
    """List what makes the plan less certain, one sentence each.

    Parameters
    ----------
    form : ModelForm
        Bounds that are used.
    campaign : CampaignMission
        The campaign.
    flight : TestFlight
        How the flight was simulated.
    bounds : Path or None
        File of ``form``; None if it is the campaign's.
    flights : sequence of Path
        Records that the user gives as those behind the bounds.
    from_campaign : bool
        Whether the mission's states come from flights of the campaign.
    """
    aircraft, out = flight.aircraft, []
    # Aircraft or bounds have changed since the campaign.
    if form.aircraft.sha256 != content_hash(aircraft) and campaign.spec.start is None:
        out.append(
            f"aircraft '{aircraft.name}' has changed since the bounds were made: they belong to the"
            " model as it was"
        )
    if not campaign.same_aircraft:
        out.append(
            "the campaign was made by uqharness 0.1: later changes of its aircraft or of its table"
            " cannot be detected"
        )
    # The bounds of the plan are others than the campaign's.
    if campaign.spec.inputs.model_form is None:
        kind = (
            "constant ones"
            if _has_constant_bounds(campaign)
            else "perhaps: those that the aircraft carries"
        )
        out.append(
            f"the campaign flew other bounds than these ({kind}): which coefficient wins may differ"
            " with these"
        )
    elif bounds is not None and bounds.read_bytes() != campaign.spec.inputs.model_form.read_bytes():
        out.append(
            "the campaign flew other bounds than these: which coefficient wins may differ with"
            " these"
        )
    # Flights that are not behind the bounds.
    form_hashes = {f.sha256 for f in form.flights}
    foreign = [p.name for p in flights if file_sha256(p) not in form_hashes]
    if foreign:
        out.append(
            f"--flight {', '.join(foreign)}: not among the flights behind the bounds; its scatter"
            " may differ"
        )
    if campaign.failed and from_campaign:
        out.append(
            f"{campaign.failed} flights of the campaign failed and do not count for the mission's"
            " states"
        )
    if not flight.noise:
        out.append(
            f"aircraft '{aircraft.name}' has no sensors system: the flight was simulated without"
            " sensor noise"
        )
    if not flight.has_autopilot:
        out.append(
            f"aircraft '{aircraft.name}' has none of this project's autopilot: test points are"
            " steps added to the commands while the mission is flown, at its speed and bank alone"
        )
    return out


# Widths before and after a flight over the same mission, with those predicted.


def achieved(
    before: ModelForm, after: ModelForm, mission: Occupancy, planned: Path
) -> dict[str, AchievedRow]:
    """Compare bounds before and after a flight.

    Parameters
    ----------
    before, after : ModelForm
        Bounds without and with the flight.
    mission : Occupancy
        States at which widths are averaged.
    planned : Path
        The next-flight.json of the flight; predictions are None if it cannot be read.

    Returns
    -------
    dict
        Coefficient -> widths, narrowings and predicted narrowings.
    """
    predicted = _read_predictions(planned)
    widths_after, widths_before = widths_over(after, mission), widths_over(before, mission)
    return {
        c: AchievedRow(
            width=widths_before[c].total,
            width_after=widths_after[c].total,
            narrowing=1.0 - widths_after[c].total / widths_before[c].total,
            predicted=predicted.get(c, Prediction()).narrowing_redone,
            parameter_narrowing=1.0 - widths_after[c].parameter / widths_before[c].parameter,
            predicted_parameter=predicted.get(c, Prediction()).parameter_narrowing,
        )
        for c in widths_before
        if c in widths_after
    }


def as_text(rows: Mapping[str, AchievedRow]) -> str:
    """Format the rows of `achieved` as a table for a terminal."""
    return "\n".join(
        text_table(
            [
                {"coefficient": c, **{k: _cell(k, v) for k, v in row.as_json().items()}}
                for c, row in rows.items()
            ]
        )
    )


def _cell(key: str, value: float | None) -> str:
    """Format a width as a number, a narrowing as a percentage."""
    if value is None:
        return "–"
    return f"{value:.3g}" if "width" in key else percent(value)


def _read_predictions(path: Path) -> dict[str, Prediction]:
    """Read the prospects of a next-flight.json; empty if there is none."""
    try:
        return read_result(path, Predictions).prospects
    except BadInputError:
        return {}
