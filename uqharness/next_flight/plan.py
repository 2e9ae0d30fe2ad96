"""From a campaign's sensitivity to the next test flight: which coefficient, where in its states, and what to fly.

Pure but for the flights that it simulates: writes nothing outside a temporary folder.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sysid.aerodynamics import COEFFICIENTS, Cutoffs, Residuals, combine_flights
from sysid.arrays import FloatArray
from sysid.digests import file_sha256
from sysid.model_form import (
    CoefficientBounds,
    Design,
    FitOptions,
    Information,
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
from uqharness.next_flight.points import (
    MOST_BANK_RAD,
    QUIET_S,
    RECOVERY_S,
    REST_S,
    TRANSITION_S,
    CampaignMission,
    Condition,
    Occupancy,
    TestPoint,
    library,
    schedule,
)
from uqharness.next_flight.trials import (
    WIDER,
    Refused,
    TestFlight,
    Trial,
    fly_points,
    has_autopilot,
    has_noise,
    residuals_of,
    sorted_points,
    try_points,
    unit_times,
)
from uqharness.simulator import Aircraft, content_hash, find_aircraft
from uqharness.text_tables import text_table

# What a flight would do to every coefficient's interval where a mission flies.


@dataclass(frozen=True)
class Prospect:
    """Mean widths of one coefficient's interval over the mission: now, after the flight, after as many seconds of what was flown
    before, and after endless flying, the scatter being what it is. narrowing, parameter_narrowing: shares of the width, and of its
    parameter part, that go.

    redone: what bounds made again will show. Their scatter is that of other speeds: noise grows as the dynamic pressure falls.
    """

    now: Width
    then: Width
    redone: Width
    naive: Width
    ever: Width

    @property
    def narrowing(self) -> float:
        """Share by which the mean width shrinks at the present scatter."""
        return 1.0 - self.then.total / self.now.total

    @property
    def parameter_narrowing(self) -> float:
        """Share of the parameter part that goes."""
        return 1.0 - self.then.parameter / self.now.parameter

    @property
    def at_most(self) -> float:
        """Narrowing after endless flying."""
        return 1.0 - self.ever.total / self.now.total


def prospects(
    form: ModelForm, mission: Occupancy, flown: Residuals, weight: float, trials: Sequence[Trial]
) -> dict[str, Prospect]:
    """Of every coefficient, from a simulated flight's states. weight: see `sysid.model_form.information_gain.information`."""
    behind_s = sum(f.seconds for f in form.flights)
    new_s = sum(float(p.time_s[-1] - p.time_s[0]) for p in flown.pieces)
    scatter = scatter_ratios(form, flown, trials)
    out = {}
    for c, bounds in form.coefficients.items():
        states = mission.of(bounds.states)
        told = [information(bounds, flown.states, weight)]
        share = new_s / behind_s if behind_s > 0.0 else math.nan
        same = Information(
            np.asarray(share * np.linalg.inv(bounds.XtX_inv)),
            share * bounds.n,
            bounds.hull.low,
            bounds.hull.high,
        )
        repeated = with_more_data(bounds, [same]) if math.isfinite(share) else bounds
        then = (
            with_more_data(bounds, told),
            with_more_data(bounds, told, scatter[c]),
            repeated,
            asymptotic(bounds),
        )
        out[c] = Prospect(
            width(bounds, states, form.outside),
            *(expected_width(bounds, b, states, form.outside) for b in then),
        )
    return out


def scatter_ratios(form: ModelForm, flown: Residuals, trials: Sequence[Trial]) -> dict[str, float]:
    """Coefficient -> residual variance at a flight's speeds over that behind the bounds, by the trend of the model's trials."""
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
        power = speed_power(
            speeds, np.array([float(np.mean(t.delta[:, k] ** 2)) for t in trials]), counts
        )
        if hull is None or power == 0.0:
            out[c] = 1.0
            continue
        box, v = hull
        before = mean_power(box.middle[v], float(box.low[v]), float(box.high[v]), power)
        out[c] = float(np.mean(flown.states["V_mps"] ** power)) / before
    return out


def designs_of(form: ModelForm) -> dict[str, Design]:
    """The form's own terms, to fit other flights as it was fitted."""
    return {c: Design(b.states, b.terms) for c, b in form.coefficients.items()}


def widths_over(form: ModelForm, mission: Occupancy) -> dict[str, Width]:
    """Mean widths of a form's intervals where a mission flies."""
    return {c: width(b, mission.of(b.states), form.outside) for c, b in form.coefficients.items()}


WORTH = 0.05
"""Share by which a flight must narrow the interval in the mission's flight states to be worth flying."""
SENSORS = 1.3
"""Up to this ratio of the scatter's standard deviation to that of the model's own simulated flight it is noise and air."""
_TURN_RAD = math.radians(8.0)
_TRIES = 8


@dataclass(frozen=True)
class Options:
    """minutes: the flight's length at most; speeds_mps: of the points (default: the mission's); seed of the simulations."""

    minutes: float = 5.0
    speeds_mps: tuple[float, ...] = ()
    seed: int = 1


@dataclass(frozen=True)
class Where:
    """Quartiles (3,) of one state: in the data behind the bounds, on the mission, and of the uncertainty there, which is
    occupancy times prediction variance."""

    state: str
    data: FloatArray
    mission: FloatArray
    variance: FloatArray


@dataclass(frozen=True)
class Planned:
    """A test point of the flight. gain: share of the mean width that it took when it was chosen, given those before it."""

    point: TestPoint
    start_s: float
    end_s: float
    gain: float


@dataclass(frozen=True)
class NextFlight:
    """What to fly for ``coefficient``, and what that will bring.

    scatter, simulated_scatter  s of the bounds, and of the same fit to the flight as the model alone, with its sensors, flies it
    extrapolated  share of the mission outside the data          states  of the planned flight, name -> (n,), filtered
    end_s         length of the flight                            refused  points that the model did not bear
    bounds_then   the coefficient's interval with the flight's data, but for beta
    """

    coefficient: str
    prospects: Mapping[str, Prospect]
    where: tuple[Where, ...]
    extrapolated: float
    plan: tuple[Planned, ...]
    end_s: float
    scatter: float
    simulated_scatter: float
    refused: tuple[Refused, ...]
    tried: int
    states: Mapping[str, FloatArray]
    bounds_then: CoefficientBounds

    @property
    def prospect(self) -> Prospect:
        """What the flight promises for the chosen coefficient."""
        return self.prospects[self.coefficient]

    @property
    def worth_flying(self) -> bool:
        """Whether its interval narrows enough for a flight."""
        return self.prospect.narrowing >= WORTH

    @property
    def form_is_short(self) -> bool:
        """Whether the scatter is more than sensors and air explain, so that a term is missing (or the air was rougher)."""
        return self.scatter > SENSORS * self.simulated_scatter


def check_form(form: ModelForm, aircraft: Aircraft, coefficient: str, where: str) -> None:
    """Refuse bounds that cannot be narrowed by flying. Raises BadInputError saying what to do."""
    if form.aircraft.name != aircraft.name:
        raise BadInputError(
            f"{where}: the bounds belong to aircraft '{form.aircraft.name}', the campaign flew '{aircraft.name}'; give the bounds "
            "of the aircraft that flew (uqharness bounds)"
        )
    if coefficient not in form.coefficients:
        raise BadInputError(
            f"{where}: has no bounds for {coefficient}; it has {', '.join(form.coefficients)}. Make them with uqharness bounds"
        )
    bounds = form.coefficients[coefficient]
    if all(not any(term) for term in bounds.terms):
        raise BadInputError(
            f"{where}: the bounds of {coefficient} are constant: they depend on no flight state, so there is no place in which "
            "data would narrow them more than elsewhere. Make bounds of order 1 or 2 from a flight that moves "
            f"{', '.join(bounds.states)} (uqharness bounds --order 2), then ask again"
        )


def allowed_states(form: ModelForm, mission: Occupancy) -> dict[str, tuple[float, float]]:
    """What test points may reach: the range of data and mission together, half as wide again on either side, and 60 deg of bank."""
    out: dict[str, tuple[float, float]] = {}
    for bounds in form.coefficients.values():
        for k, state in enumerate(bounds.states):
            if state.startswith(("V_", "alpha", "beta")) and state in mission.states:
                values = mission.states[state]
                low, high = (
                    min(bounds.hull.low[k], values.min()),
                    max(bounds.hull.high[k], values.max()),
                )
                out[state] = float(low - WIDER * (high - low)), float(high + WIDER * (high - low))
    most = MOST_BANK_RAD
    if "phi_rad" in mission.states:
        most = max(most, float(np.abs(mission.states["phi_rad"]).max()))
    return {**out, "phi_rad": (-most, most)}


def conditions_of(
    mission: Occupancy, flight: TestFlight, speeds_mps: Sequence[float]
) -> list[Condition]:
    """Speeds at which the mission flies (quantiles 5, 50, 95 %), straight and in its turns; without an autopilot as it flies."""
    if not flight.has_autopilot:
        return [Condition()]
    speeds = sorted(speeds_mps) or [
        float(f"{v:.3g}") for v in np.quantile(mission.states["V_mps"], [0.05, 0.5, 0.95])
    ]
    phi = mission.states.get("phi_rad", np.zeros(1))
    banks = [0.0]
    for side in (phi[phi > _TURN_RAD], phi[phi < -_TURN_RAD]):
        if len(side) > 0.1 * len(phi):
            banks.append(float(round(math.degrees(float(np.median(side))))))
    return [Condition(v, b) for v in dict.fromkeys(speeds) for b in banks]


def plan_flight(
    form: ModelForm,
    coefficient: str,
    mission: Occupancy,
    flight: TestFlight,
    options: Options,
    say: Callable[[str], object] = lambda stage: None,
) -> NextFlight:
    """Choose test points, simulate their flight, predict what it brings.

    Raises BadInputError where nothing can be flown or no point tells anything.
    """
    cutoffs = Cutoffs(form.filtering.cutoff_hz, form.filtering.airspeed_cutoff_hz)
    _check_minutes(flight, options)
    say("trying test points")
    trials, refused = try_library(form, mission, flight, options, cutoffs)
    say("choosing")
    return plan_from(form, coefficient, mission, flight, options, trials, refused, say)


def _check_minutes(flight: TestFlight, options: Options) -> None:
    """Refuse, before anything is flown, a flight too short for the shortest of any test points."""
    least = QUIET_S + REST_S + RECOVERY_S + _before(flight)
    if 60.0 * options.minutes < least:
        raise BadInputError(
            f"--minutes {options.minutes:g}: no test point fits; the shortest takes {least / 60.0:.2g} minutes with what comes "
            "before it"
        )


def _before(flight: TestFlight) -> float:
    return flight.begin_s + (TRANSITION_S if flight.has_autopilot else 0.0)


def try_library(
    form: ModelForm, mission: Occupancy, flight: TestFlight, options: Options, cutoffs: Cutoffs
) -> tuple[list[Trial], list[Refused]]:
    """Every test point of the library, flown by the model. Raises BadInputError if it bears none."""
    conditions = conditions_of(mission, flight, options.speeds_mps)
    speed = float(np.median(mission.states["V_mps"]))
    points = library(flight.aircraft, conditions, unit_times(flight.aircraft, speed, 100.0))
    trials, refused = try_points(
        flight, points, allowed_states(form, mission), cutoffs, options.seed
    )
    if not trials:
        first = refused[0]
        raise BadInputError(
            f"of {len(points)} test points '{flight.aircraft.name}' bears none; the first, {first.point.name}: {first.reason}. "
            "Give other --speeds, or bounds from a flight that moves more"
        )
    return trials, refused


def plan_from(
    form: ModelForm,
    coefficient: str,
    mission: Occupancy,
    flight: TestFlight,
    options: Options,
    trials: Sequence[Trial],
    refused: Sequence[Refused],
    say: Callable[[str], object] = lambda stage: None,
) -> NextFlight:
    """The same from points that have been tried already."""
    bounds = form.coefficients[coefficient]
    states = mission.of(bounds.states)
    weight = form.filtering.rate_hz / flight.rate_hz
    offers = [
        Offer(
            t.point.condition.text,
            t.point.seconds + RECOVERY_S,
            information(bounds, t.states, weight),
        )
        for t in trials
    ]
    transition = TRANSITION_S if flight.has_autopilot else 0.0
    chosen = choose(
        bounds, offers, states, 60.0 * options.minutes - flight.begin_s, transition, form.outside
    )
    if not chosen:
        raise BadInputError(
            f"--minutes {options.minutes:g}: no test point fits or narrows anything; the shortest takes "
            f"{(min(o.seconds for o in offers) + _before(flight)) / 60.0:.2g} minutes with what comes before it"
        )
    gains: dict[int, float] = {}
    before = _mean_half_width(form, coefficient, states)
    for order, item in enumerate(chosen):
        gains[order] = (before - item.half_width) / before
        before = item.half_width
    picked = [(trials[c.index].point, gains[k]) for k, c in enumerate(chosen)]
    conditions = [p.condition for p in sorted_points([p for p, _ in picked])]
    picked.sort(key=lambda item: conditions.index(item[0].condition))
    say("simulating the flight")
    flown, kept, lost = _simulate(flight, picked, options.seed + 1000, form)
    timed, end_s = schedule([p for p, _ in kept], flight.begin_s)
    plan = tuple(
        Planned(t.point, t.start_s, t.end_s, g) for t, (_, g) in zip(timed, kept, strict=True)
    )
    say("predicting")
    return NextFlight(
        coefficient=coefficient,
        prospects=prospects(form, mission, flown, weight, trials),
        where=_where(form, coefficient, mission),
        extrapolated=float(np.mean(form.extrapolated(mission.of(form.states)))),
        plan=plan,
        end_s=end_s,
        scatter=math.sqrt(bounds.s2),
        simulated_scatter=_scatter(flown, form, coefficient),
        refused=(*refused, *lost),
        tried=len(trials) + len(refused),
        states=flown.states,
        bounds_then=with_more_data(bounds, [information(bounds, flown.states, weight)]),
    )


def _mean_half_width(form: ModelForm, coefficient: str, states: Mapping[str, FloatArray]) -> float:
    bounds = form.coefficients[coefficient]
    variance = bounds.constant_variance + parameter_variance(bounds, states, form.outside)
    return float(bounds.t * np.mean(np.sqrt(variance)))


def _where(form: ModelForm, coefficient: str, mission: Occupancy) -> tuple[Where, ...]:
    bounds = form.coefficients[coefficient]
    states = mission.of(bounds.states)
    variance = parameter_variance(bounds, states, form.outside)
    even = np.ones(len(variance))
    return tuple(
        Where(
            s,
            bounds.hull.middle[k],
            weighted_quartiles(states[s], even),
            weighted_quartiles(states[s], variance),
        )
        for k, s in enumerate(bounds.states)
    )


def _simulate(
    flight: TestFlight, picked: Sequence[tuple[TestPoint, float]], seed: int, form: ModelForm
) -> tuple[Residuals, list[tuple[TestPoint, float]], list[Refused]]:
    """The whole flight by the model; a point at which it ends is taken out. Raises BadInputError if it never ends well."""
    cutoffs = Cutoffs(form.filtering.cutoff_hz, form.filtering.airspeed_cutoff_hz)
    left, lost = list(picked), list[Refused]()
    with scratch_folder() as scratch:
        for attempt in range(_TRIES):
            path = scratch.path / f"next-flight-{attempt}.parquet"
            ok, flown_s, reason = fly_points(flight, [p for p, _ in left], seed, path)
            if ok:
                return residuals_of(flight.aircraft, [path], cutoffs)[0], left, lost
            timed, _ = schedule([p for p, _ in left], flight.begin_s)
            bad = next(
                (k for k, t in enumerate(timed) if t.end_s + RECOVERY_S > flown_s), len(left) - 1
            )
            lost.append(Refused(left[bad][0], f"the flight ends: {reason}"))
            left = [item for item in left if item[0] != left[bad][0]]
            if not left:
                break
    raise BadInputError(
        f"the flight of the chosen test points does not end well: {lost[-1].reason}"
    )


def _scatter(flown: Residuals, form: ModelForm, coefficient: str) -> float:
    """s of the form's terms fitted to a flight; NaN where that flight is too short for them."""
    try:
        fitted = fit_bounds(flown, {coefficient: designs_of(form)[coefficient]}, FitOptions())
    except ValueError:
        return math.nan
    return math.sqrt(fitted[coefficient].bounds.s2)


# What a planned flight starts from: bounds and aircraft of the campaign, the flight as it is
# simulated, and what to be wary of.

_BURN_IN_S = 120.0
_ON_AUTOPILOT_S = 4.0


def bounds_of(campaign: CampaignMission, folder: Path, coefficient: str) -> Path:
    """The model form that the campaign in ``folder`` flew. Raises BadInputError for other bounds, saying what to do."""
    if campaign.spec.inputs.model_form is not None:
        return campaign.spec.inputs.model_form
    if not _constant(campaign):
        raise BadInputError(
            f"{folder}: flew the bounds that the aircraft carries; give the model-form.json that they were made from with "
            "--bounds (constant ones tell nothing of where data are lacking)"
        )
    raise BadInputError(
        f"{folder}: flew constant bounds of {coefficient}, which depend on no flight state: nothing says where data are "
        "lacking. Make bounds from flights (uqharness bounds AIRCRAFT --flight FILE --out DIR) and give them with "
        "--bounds DIR/model-form.json"
    )


def _constant(campaign: CampaignMission) -> bool:
    """Whether the campaign file gave its bounds as numbers."""
    return isinstance(campaign.spec.epistemic.bounds, dict)


def aircraft_of(campaign: CampaignMission) -> Aircraft:
    """What is flown: the author's aircraft, but for a trimmed start, whose initial conditions lie in the campaign's copy."""
    own = campaign.spec.start is not None or campaign.mission.source == Path()
    return find_aircraft(campaign.mission.aircraft if own else campaign.mission.source)


def flight_of(
    campaign: CampaignMission, aircraft: Aircraft, form: ModelForm, turbulence: str
) -> TestFlight:
    """The test flight as it is simulated: the mission's script and air of that intensity, recorded at the bounds' rate."""
    held = campaign.spec.start is None and has_autopilot(aircraft)
    begin_s = _ON_AUTOPILOT_S if held else min(float(campaign.spec.aleatory.burn_in_s), _BURN_IN_S)
    steps = max(1, round(1.0 / (min(form.filtering.rate_hz, 60.0) * aircraft.dt_s)))
    return TestFlight(
        aircraft,
        campaign.mission.script,
        held,
        begin_s,
        turbulence,
        has_noise(aircraft),
        1.0 / (steps * aircraft.dt_s),
        campaign.spec.aleatory.turbulence_source,
    )


def missing_in(
    form: ModelForm, aircraft: Aircraft, coefficient: str, flights: Sequence[Path]
) -> list[MissingTerm]:
    """Terms that the flights show to be missing in a coefficient's polynomial. Raises BadInputError."""
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
    flown: bool,
) -> list[str]:
    """What makes the plan less certain than it looks, a sentence each.

    Parameters
    ----------
    bounds
        The file of ``form``, None where it is the campaign's own.
    flights
        Files that are said to be those behind the bounds.
    flown
        Whether the mission's flight states come from the campaign's own flights.
    """
    aircraft, out = flight.aircraft, []
    if form.aircraft.sha256 != content_hash(aircraft) and campaign.spec.start is None:
        out.append(
            f"aircraft '{aircraft.name}' has changed since the bounds were made: they belong to the model as it was"
        )
    if not campaign.same_aircraft:
        out.append(
            "the campaign was made by uqharness 0.1: whether its aircraft is as it was cannot be told, nor whether its table is"
        )
    if campaign.spec.inputs.model_form is None:
        kind = (
            "constant ones" if _constant(campaign) else "perhaps: those that the aircraft carries"
        )
        out.append(
            f"the campaign flew other bounds than these ({kind}): which coefficient wins may differ with these"
        )
    elif bounds is not None and bounds.read_bytes() != campaign.spec.inputs.model_form.read_bytes():
        out.append(
            "the campaign flew other bounds than these: which coefficient wins may differ with these"
        )
    known = {f.sha256 for f in form.flights}
    others = [p.name for p in flights if file_sha256(p) not in known]
    if others:
        out.append(
            f"--flight {', '.join(others)}: not among the flights behind the bounds; its scatter may differ"
        )
    if campaign.failed and flown:
        out.append(
            f"{campaign.failed} flights of the campaign failed and do not count for the mission's states"
        )
    if not flight.noise:
        out.append(
            f"aircraft '{aircraft.name}' has no sensors system: the flight was simulated without sensor noise"
        )
    if not flight.has_autopilot:
        out.append(
            f"aircraft '{aircraft.name}' has none of this project's autopilot: test points are steps added to the commands while "
            "the mission is flown, at its speed and bank alone"
        )
    return out


# What a flight has brought: bounds before and after it, over the same mission, beside what was
# predicted.

Row = Mapping[str, float | None]


def achieved(
    before: ModelForm, after: ModelForm, mission: Occupancy, planned: Path
) -> dict[str, Row]:
    """Coefficient -> widths, narrowings and, where ``planned`` is a next-flight.json, those predicted there."""
    predicted = _planned(planned)
    then, now = widths_over(after, mission), widths_over(before, mission)
    return {
        c: {
            "width": now[c].total,
            "width_after": then[c].total,
            "narrowing": 1.0 - then[c].total / now[c].total,
            "predicted": predicted.get(c, {}).get("narrowing_redone"),
            "parameter_narrowing": 1.0 - then[c].parameter / now[c].parameter,
            "predicted_parameter": predicted.get(c, {}).get("parameter_narrowing"),
        }
        for c in now
        if c in then
    }


def as_text(rows: Mapping[str, Row]) -> str:
    """A table for a terminal."""
    return "\n".join(
        text_table(
            [
                {"coefficient": c, **{k: _cell(k, v) for k, v in row.items()}}
                for c, row in rows.items()
            ]
        )
    )


def _cell(key: str, value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.3g}" if "width" in key else percent(value)


def _planned(path: Path) -> dict[str, dict[str, float]]:
    """Prospects of a flight planned in the same folder; empty without one."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))["prospects"]
    except (OSError, ValueError, KeyError, TypeError):
        return {}
    return found if isinstance(found, dict) else {}
