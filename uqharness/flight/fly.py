"""Fly one mission: conditions and seeds in, recorded signals and scores out.

`record_mission` sets conditions, initialises, and records; `score` computes medians, means, maxima,
excursions and loss of control, from a commanded path or from the start. `GroundWatch` ends airborne
flights that touch the ground. A campaign spends most of its time here.
"""

from __future__ import annotations

import atexit
import contextlib
import math
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.units import FT_M
from uqharness.errors import BadInputError
from uqharness.flight.autopilot_process import (
    AutopilotProcess,
    AutopilotSettings,
    AutopilotStoppedError,
)
from uqharness.flight.random_numbers import Split
from uqharness.flight.spec import (
    COEFFICIENTS,
    DIVERGED_FPS,
    TURBULENCE_W20_KT,
    FlightResult,
    FlightSpec,
)
from uqharness.flight.stepping import first_levels, has_air_system, stepper
from uqharness.flight.waypoints import FlownItem, WaypointGuide, WaypointMission
from uqharness.isolation import report_time
from uqharness.simulator import (
    CHANGEABLE,
    MARK,
    SECOND_ORDER,
    STANDARD,
    Aircraft,
    Source,
    StagedMission,
    aircraft_fingerprint,
    bring_to_rest,
    engine,
    find_aircraft,
    find_script,
    marked_equilibrium,
    parse_xml,
    refuse_conflicts,
    settle_fuel_flow,
)

# Scores of a flight along a commanded path: medians, means, maxima, excursions, loss of
# control.
#
# Definitions are those of the campaign tables: an excursion is counted when the distance from
# the path first exceeds the radius and re-arms ``rearm_m`` inside it; loss of control is |bank|
# > 80 deg, |alpha| > 25 deg, altitude error > 60 m or a state not finite.

BANK_LIMIT_RAD = np.deg2rad(80.0)
ALPHA_LIMIT_RAD = np.deg2rad(25.0)
ALTITUDE_LIMIT_M = 60.0


def absolute_statistics(error: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return median, mean and maximum of ``|error|`` (n,); NaN without samples.

    Examples
    --------
    >>> absolute_statistics(np.array([-1.0, 2.0, 6.0]))
    (2.0, 3.0, 6.0)
    """
    if error.size == 0:
        return float("nan"), float("nan"), float("nan")
    magnitude = np.abs(error)
    # `np.median` takes three times as long, which campaigns of many short flights feel. NaN sorts
    # behind all numbers.
    middle = error.size // 2
    ordered = np.partition(magnitude, [max(middle - 1, 0), middle, -1])
    median = ordered[middle] if error.size % 2 else 0.5 * (ordered[middle - 1] + ordered[middle])
    if np.isnan(ordered[-1]):
        median = np.nan
    return float(median), float(np.mean(magnitude)), float(np.max(magnitude))


def count_excursions(distance: NDArray[np.float64], radius_m: float, rearm_m: float) -> int:
    """Return the number of excursions beyond a radius.

    Parameters
    ----------
    distance : ndarray
        Distance from the path (n,) [m], of either sign.
    radius_m, rearm_m : float
        An excursion starts beyond ``radius_m`` and ends inside ``radius_m - rearm_m`` [m]. A flight
        that starts outside counts one.

    Raises
    ------
    ValueError
        Unless 0 <= rearm_m < radius_m.

    Examples
    --------
    >>> count_excursions(np.array([0.0, 11.0, 9.5, 11.0, 0.0, -12.0]), 10.0, 1.0)
    2
    """
    if not 0.0 <= rearm_m < radius_m:
        raise ValueError(
            f"rearm_m = {rearm_m} must be at least 0 and less than the excursion radius"
            f" {radius_m} m"
        )
    magnitude = np.abs(distance)
    outside = magnitude > radius_m
    inside = magnitude < radius_m - rearm_m
    # Between the two radii the counter keeps its state: drop these samples.
    decided = outside[outside | inside]
    if decided.size == 0:
        return 0
    return int(decided[0]) + int(np.count_nonzero(decided[1:] & ~decided[:-1]))


def lost_control(
    phi_rad: NDArray[np.float64],
    alpha_rad: NDArray[np.float64],
    altitude_error_m: NDArray[np.float64],
) -> bool:
    """Return whether a flight lost control at any sample; samples that are not finite count.

    Parameters
    ----------
    phi_rad, alpha_rad, altitude_error_m : ndarray
        Bank and incidence [rad] and altitude error [m], each (n,).
    """
    finite = np.isfinite(phi_rad) & np.isfinite(alpha_rad) & np.isfinite(altitude_error_m)
    exceeded = (
        (np.abs(phi_rad) > BANK_LIMIT_RAD)
        | (np.abs(alpha_rad) > ALPHA_LIMIT_RAD)
        | (np.abs(altitude_error_m) > ALTITUDE_LIMIT_M)
    )
    return bool(np.any(exceeded | ~finite))


_STATISTICS = ("median", "mean", "max")
_UNITS: Mapping[str, str] = {"cross_track": "m", "altitude": "m", "speed": "mps"}
LOAD_FACTOR = "load_factor_max"


class RecordedFlight:
    """Signals of a flight, and how it ended.

    Attributes
    ----------
    status, reason : str
        One of STATUSES, and the reason if it is not ok.
    flown_s : float
        Time at the end [s].
    signals : dict
        Signal to (n,).
    items : list of FlownItem
        Items of a waypoint mission.
    """

    def __init__(
        self,
        names: Sequence[str],
        rows: NDArray[np.float64],
        status: str,
        reason: str,
        flown_s: float,
    ) -> None:
        self.status = status
        self.reason = reason
        self.flown_s = flown_s
        self.items: list[FlownItem] = []
        self.signals: dict[str, NDArray[np.float64]] = {
            name: rows[:, column] for column, name in enumerate(names)
        }


def commanded_signals(aircraft: Aircraft) -> dict[str, Source]:
    """Return the card's error signals, true and measured."""
    signals = {key: Source(card.true) for key, card in aircraft.card.metrics.items()}
    return signals | {
        f"{key}_measured": Source(card.measured)
        for key, card in aircraft.card.metrics.items()
        if card.measured
    }


def from_start_signals(flies_straight: bool) -> dict[str, Source]:
    """Return the signals of deviations from the start; every JSBSim aircraft has them.

    ``flies_straight`` adds position and ground velocity, for the distance from a line.
    """
    names = {"height_m": "h_m", "V_mps": "V_mps", "psi_rad": "psi_rad"}
    table = {ours: STANDARD[theirs] for ours, theirs in names.items()} | {
        "load_factor": Source("accelerations/Nz")
    }
    if flies_straight:
        table |= {
            f"{axis}_m": Source(f"position/from-start-neu-{axis[0]}-ft", FT_M)
            for axis in ("north", "east")
        }
        table |= {name: STANDARD[name] for name in ("vn_mps", "ve_mps")}
    return table


def score_commanded(spec: FlightSpec, recorded: RecordedFlight) -> FlightResult:
    """Score errors from the commanded path, altitude and airspeed, excursions, loss of control."""
    metrics: dict[str, float] = {}
    undefined: dict[str, str] = {}
    complete = recorded.status == "ok"
    for key, unit in _UNITS.items():
        for suffix in ("", "_measured"):
            values = recorded.signals.get(key + suffix)
            names = [f"{key}_{kind}_{unit}{suffix}" for kind in _STATISTICS]
            if values is None or not complete:
                reason = (
                    recorded.reason
                    if values is not None
                    else f"the card names no {key}{suffix} under [metrics]"
                )
                metrics |= dict.fromkeys(names, math.nan)
                undefined |= dict.fromkeys(names, reason)
            else:
                metrics |= dict(zip(names, absolute_statistics(values), strict=True))
    # Excursions count up to the end of the flight, whatever its status.
    for radius in spec.excursion_radius_m:
        for key, suffix in (("cross_track", ""), ("distance_3d", "_3d")):
            values = recorded.signals.get(key)
            name = f"excursions_{radius:g}m{suffix}"
            if values is None:
                metrics[name], undefined[name] = (
                    math.nan,
                    f"the card names no {key} under [metrics]",
                )
            else:
                # Excursions before an early end count; a campaign bounds the remainder from above.
                metrics[name] = float(count_excursions(values, radius, spec.rearm_m))
    return _result(recorded, metrics, undefined, recorded.signals.get("altitude", np.zeros(0)))


def score_from_start(spec: FlightSpec, recorded: RecordedFlight) -> FlightResult:
    """Score deviations of altitude, airspeed and heading from the start, and the load factor.

    In a straight flight the path is the line on which scoring starts. Other flights have no path;
    their cross-track errors and excursions are undefined. Loss of control uses bank and incidence.
    """
    metrics: dict[str, float] = {}
    undefined: dict[str, str] = {}
    complete = recorded.status == "ok" and recorded.signals["height_m"].size > 0
    # A heading through north must not jump by 360 deg.
    psi = np.unwrap(recorded.signals["psi_rad"])
    cross_track = _cross_track(recorded)
    if cross_track is None:
        undefined["cross_track"] = "no path is commanded"
    else:
        height = recorded.signals["height_m"]
        distances = {"": cross_track, "_3d": np.sqrt(cross_track**2 + (height - height[:1]) ** 2)}
        for suffix, distance in distances.items():
            for radius in spec.excursion_radius_m:
                metrics[f"excursions_{radius:g}m{suffix}"] = float(
                    count_excursions(distance, radius, spec.rearm_m)
                )
    deviations = {
        **({} if cross_track is None else {"cross_track": (cross_track, "m")}),
        "altitude": (recorded.signals["height_m"], "m"),
        "speed": (recorded.signals["V_mps"], "mps"),
        "heading": (np.rad2deg(psi), "deg"),
    }
    for key, (values, unit) in deviations.items():
        names = [f"{key}_{kind}_{unit}" for kind in _STATISTICS]
        statistics = absolute_statistics(values - values[:1]) if complete else (math.nan,) * 3
        metrics |= dict(zip(names, statistics, strict=True))
    # The load factor is 1 in level flight.
    metrics[LOAD_FACTOR] = float(np.max(recorded.signals["load_factor"])) if complete else math.nan
    if not complete:
        undefined |= dict.fromkeys((*deviations, LOAD_FACTOR), recorded.reason)
    return _result(recorded, metrics, undefined, np.zeros(0))


def _cross_track(recorded: RecordedFlight) -> NDArray[np.float64] | None:
    """Return the distance (n,) [m] from the initial line, + to the right; None without one."""
    if "north_m" not in recorded.signals:
        return None
    north, east, vn, ve = (
        recorded.signals[name] for name in ("north_m", "east_m", "vn_mps", "ve_mps")
    )
    if north.size == 0:
        return north
    # sqrt is bit-identical on all processors; a C library's hypot is not.
    speed = math.sqrt(vn[0] * vn[0] + ve[0] * ve[0])
    # Cross product of the position with the initial direction, + to the right.
    track: NDArray[np.float64] = ((east - east[0]) * vn[0] - (north - north[0]) * ve[0]) / speed
    return track


def _result(
    recorded: RecordedFlight,
    metrics: dict[str, float],
    undefined: dict[str, str],
    altitude: NDArray[np.float64],
) -> FlightResult:
    """Return the result with loss of control and the share of extrapolated samples."""
    bank = recorded.signals["phi_rad"]
    error = altitude if altitude.size else np.zeros_like(bank)
    control_lost = recorded.status != "ok" or lost_control(
        bank, recorded.signals["alpha_rad"], error
    )
    metrics["loss_of_control"] = float(control_lost)
    outside = recorded.signals.get("extrapolated")
    if outside is None or outside.size == 0:
        metrics["extrapolated_share"] = math.nan
        undefined["extrapolated_share"] = "the aircraft publishes no uq/extrapolated"
    else:
        metrics["extrapolated_share"] = float(np.mean(outside > 0.5))
    return FlightResult(
        recorded.status, recorded.reason, recorded.flown_s, metrics, undefined, recorded.signals
    )


# Ground contact: an airborne flight ends when gear, structure or, without contact points, the CG
# touches the ground.

_MARGIN_FT = 1.0
# Ten g downwards between two checks.
_MAX_SINK_ACCELERATION_FPS2 = 320.0


class GroundWatch:
    """Runs a flight in blocks and detects the first step with ground contact.

    A flight that starts on its contact points may touch the ground until the first step without
    contact.

    Parameters
    ----------
    fdm : FGFDMExec
        Initialised instance.
    aircraft : Aircraft
        Its XML names the contact points.
    block_s : float
        Time between two calls of `advance` [s].
    """

    def __init__(self, fdm: Any, aircraft: Aircraft, block_s: float) -> None:
        units = _units(fdm)
        names = _names(aircraft, len(units))
        self._points = [
            (engine.handle(fdm, f"{unit}/WOW").get_double_value, name)
            for unit, name in zip(units, names, strict=True)
        ]
        self._reach_ft = max((_distance_ft(fdm, unit) for unit in units), default=0.0) + _MARGIN_FT
        self._block_s = block_s
        self._height = engine.handle(fdm, "position/h-agl-ft").get_double_value
        self._climb = engine.handle(fdm, "velocities/h-dot-fps").get_double_value
        self._airborne = not self._touching()

    def advance(self, advance_steps: Callable[[int], None], steps: int) -> str:
        """Run ``steps`` steps, or up to ground contact; return what touched, or an empty text."""
        if not self._is_near_ground():
            advance_steps(steps)
            self._airborne = True
        else:
            for _ in range(steps):
                advance_steps(1)
                name = self._touching()
                if name and self._airborne:
                    return name
                # Airborne from the first step without contact.
                self._airborne = self._airborne or not name
        return "the centre of gravity" if self._height() <= 0.0 else ""

    def _is_near_ground(self) -> bool:
        """Return whether a contact point could reach the ground within a block.

        Single steps are checked only then, because that takes time.
        """
        fall_ft = (
            2.0 * abs(self._climb()) * self._block_s
            + 0.5 * _MAX_SINK_ACCELERATION_FPS2 * self._block_s**2
        )
        return bool(self._points) and self._height() < self._reach_ft + fall_ft

    def _touching(self) -> str:
        """Return the name of a contact point on the ground; empty if there is none."""
        return next((name for wow, name in self._points if wow()), "")


@dataclass(frozen=True)
class ContactPoint:
    """A gear or structure contact point.

    Attributes
    ----------
    name : str
        Name in the XML.
    at_in : tuple of float
        Position in the structural frame [in].
    retracts : bool
        Whether it counts only with the gear down.
    unit : str
        Property folder, whose positions the aircraft's systems may move; empty without one.
    """

    name: str
    at_in: tuple[float, float, float]
    retracts: bool
    unit: str = ""


def contact_points(fdm: Any, aircraft: Aircraft) -> list[ContactPoint]:
    """Return the contact points of a loaded aircraft.

    Raises BadInputError if JSBSim does not report their positions.
    """
    units = _units(fdm)
    points = []
    for unit, name in zip(units, _names(aircraft, len(units)), strict=True):
        names = [f"{unit}/{axis}-position" for axis in "xyz"]
        engine.require(fdm, names)
        x, y, z = (float(fdm[n]) for n in names)
        retracts = fdm.get_property_manager().hasNode(f"{unit}/pos-norm")
        points.append(ContactPoint(name, (x, y, z), retracts, unit))
    return points


def _units(fdm: Any) -> list[str]:
    """Return the property folders of the contact points; gear and structure share one numbering."""
    exists = fdm.get_property_manager().hasNode
    units = []
    for number in range(int(fdm["gear/num-units"])):
        units += [
            unit
            for unit in (f"gear/unit[{number}]", f"contact/unit[{number}]")
            if exists(f"{unit}/WOW")
        ]
    return units


def _names(aircraft: Aircraft, count: int) -> list[str]:
    """Return the XML's names of the contact points, or their numbers."""
    try:
        xml_names = [
            item.get("name", "")
            for item in parse_xml(aircraft.xml).getroot().iterfind("ground_reactions/contact")
        ]
    except BadInputError:
        xml_names = []
    names = xml_names if len(xml_names) == count else [""] * count
    return [f"contact point {name.strip() or number}" for number, name in enumerate(names)]


def _distance_ft(fdm: Any, unit: str) -> float:
    """Return the distance of a contact point from the CG [ft]; infinite if unknown."""
    exists = fdm.get_property_manager().hasNode
    if not all(exists(f"{unit}/{axis}-position") for axis in "xyz"):
        return math.inf
    return math.dist(
        *(
            [fdm[name] / 12.0 for name in names]
            for names in (
                [f"{unit}/{axis}-position" for axis in "xyz"],
                [f"inertia/cg-{axis}-in" for axis in "xyz"],
            )
        )
    )


_CONDITION_PROPERTIES = (
    "air/wind-mps",
    "air/wind-from-deg",
    "air/turbulence-w20-kt",
    "air/turbulence-source",
    "sensor/noise",
    "simulation/randomseed",
    "atmosphere/randomseed",
)
_RESERVED = {
    "air/wind-mps": "give the wind as a condition (--wind-mps, wind_mps)",
    "air/wind-from-deg": "give the wind as a condition (--wind-from-deg, wind_from_deg)",
    "air/turbulence-w20-kt": "give the turbulence as a condition (--turbulence, turbulence)",
    "air/turbulence-source": "give it as a condition (--turbulence-source, turbulence_source)",
    "sensor/noise": "give it as a condition (--noise, sensor_noise)",
    "simulation/randomseed": "give a seed (--seed, seed)",
    "atmosphere/randomseed": "give a seed (--seed, seed)",
    "simulation/dt": "the step belongs to the aircraft's card ([aircraft] dt_s)",
}
# JSBSim's generator takes 31 bits and maps seed 0 to seed 1.
_MAX_SEED = 2**31 - 2


def fly(spec: FlightSpec, autopilot: AutopilotSettings | None = None) -> FlightResult:
    """Fly one mission and score it.

    Parameters
    ----------
    spec : FlightSpec
        The flight.
    autopilot : AutopilotSettings, optional
        A real autopilot in place of the script's.

    Returns
    -------
    FlightResult
        Also of a flight that diverges, hits the ground or crashes, with status and reason.

    Raises
    ------
    BadInputError
        If the flight cannot start: unknown aircraft, script or property, impossible values.
    """
    return _fly_and_score(spec, one_ulp_off=False, autopilot=autopilot)


def fly_one_ulp_off(spec: FlightSpec) -> FlightResult:
    """Fly from a ground velocity one unit in the last place larger: the effect of rounding."""
    return _fly_and_score(spec, one_ulp_off=True)


def _fly_and_score(
    spec: FlightSpec, one_ulp_off: bool, autopilot: AutopilotSettings | None = None
) -> FlightResult:
    """Fly and score a spec."""
    mission = staged_mission(spec)
    recorded = record_mission(
        mission,
        spec,
        scored_signals(mission),
        OPTIONAL_SIGNALS,
        one_ulp_off=one_ulp_off,
        autopilot=autopilot,
    )
    return score(mission, spec, recorded)


def scored_signals(mission: StagedMission) -> dict[str, Source]:
    """Return the signals that a mission is scored by."""
    signals = (
        from_start_signals(_steady(mission))
        if _from_start(mission)
        else commanded_signals(mission.aircraft)
    )
    return signals | {"phi_rad": Source("attitude/phi-rad"), "alpha_rad": Source("aero/alpha-rad")}


OPTIONAL_SIGNALS: Mapping[str, Source] = MappingProxyType(
    {"extrapolated": Source("uq/extrapolated")}
)
"""Signals scored where the aircraft has them."""


def score(mission: StagedMission, spec: FlightSpec, recorded: RecordedFlight) -> FlightResult:
    """Return the scores of a recorded flight."""
    return (
        score_from_start(spec, recorded)
        if _from_start(mission)
        else score_commanded(spec, recorded)
    )


def _steady(mission: StagedMission) -> bool:
    """Return whether the mission starts from steady flight."""
    return MARK in mission.script.run_properties


def _from_start(mission: StagedMission) -> bool:
    """Return whether deviations count from the start, for lack of a commanded path."""
    return _steady(mission) or not mission.aircraft.card.metrics


def staged_mission(spec: FlightSpec) -> StagedMission:
    """Return the staged mission of a flight, reused while aircraft and script are unchanged.

    Raises BadInputError.
    """
    return _staged(str(spec.aircraft), str(spec.script), _fingerprint(spec))


def _fingerprint(spec: FlightSpec) -> str:
    """Return a text that changes with the files of aircraft and script."""
    # A long-lived worker must notice edits, so that the cache is keyed by file states.
    script = find_script(spec.script)
    return f"{aircraft_fingerprint(spec.aircraft)}-{script.stat().st_mtime_ns}"


@lru_cache(maxsize=8)
def _staged(aircraft: str, script: str, fingerprint: str) -> StagedMission:
    """Stage a mission; the fingerprint is part of the key."""
    mission = StagedMission(find_aircraft(aircraft), find_script(script))
    atexit.register(mission.close)
    return mission


def record_mission(
    mission: StagedMission,
    spec: FlightSpec,
    signals: Mapping[str, Source],
    optional: Mapping[str, Source] | None = None,
    *,
    keep_burn_in: bool = False,
    one_ulp_off: bool = False,
    splits: Sequence[Split] = (),
    autopilot: AutopilotSettings | WaypointMission | None = None,
) -> RecordedFlight:
    """Fly a spec and record signals.

    Rows are taken after a step, so that the accelerations of a row include its commands.

    Parameters
    ----------
    mission : StagedMission
        Aircraft and script.
    spec : FlightSpec
        Conditions, seeds and durations.
    signals, optional : mapping
        Signals to record, and signals recorded if they exist.
    keep_burn_in : bool
        Whether to record the burn-in too.
    one_ulp_off : bool
        Whether the ground velocity starts one unit in the last place larger.
    splits : sequence of Split
        Frames behind which the flight branches.
    autopilot : AutopilotSettings or WaypointMission, optional
        A real autopilot that commands the aircraft in lock step, or a mission that the aircraft's
        own autopilot flies.

    Returns
    -------
    RecordedFlight
        Rows at ``spec.record_rate_hz``, and how the flight ended.

    Raises
    ------
    BadInputError
        If the flight cannot start.
    ValueError
        For splits of a flight with JSBSim's own turbulence or transient model error.
    """
    # Mass properties are set through the XML, others after loading.
    changed = {name: value for name, value in spec.properties.items() if name in CHANGEABLE}
    fdm = mission.open(changed=changed)
    dt_s = fdm.get_delta_t()
    stride = record_stride(spec, dt_s)
    set_conditions(fdm, mission, spec)
    if one_ulp_off:
        larger = max("ic/vn-fps", "ic/ve-fps", key=lambda name: abs(fdm[name]))
        fdm[larger] = math.nextafter(fdm[larger], math.copysign(math.inf, fdm[larger]))
    # The first levels must act during initialisation too.
    for name, value in first_levels(spec, dt_s).items():
        engine.set_property(fdm, name, value)
    engine.run_ic(fdm)
    _require_settings_hold(fdm, without_missing_switches(fdm, spec.properties))
    set_wind_without_air(fdm, spec)
    if MARK in mission.script.run_properties and fdm.get_propulsion().get_num_engines():
        engine.settle_engines(fdm)
    if (
        # Controls come to rest before the flight starts.
        equilibrium := marked_equilibrium(mission.script.run_properties, mission.aircraft, fdm)
    ) is not None:
        bring_to_rest(fdm, equilibrium)
        settle_fuel_flow(fdm, equilibrium)
    present = {name: source for name, source in (optional or {}).items() if _exists(fdm, source)}
    table = {"time_s": Source("simulation/sim-time-sec"), **signals, **present}
    try:
        getters = _getters(fdm, table)
    except BadInputError as error:
        raise BadInputError(f"{mission.aircraft.xml}: {error}") from None
    burn_in_rows, recorded_rows = row_counts(spec, dt_s * stride, keep_burn_in)
    advance = stepper(fdm, spec, dt_s, (burn_in_rows + recorded_rows) * stride, splits)
    values = array("d")
    height = engine.handle(fdm, "position/h-agl-ft").get_double_value
    speed = engine.handle(fdm, "velocities/vt-fps").get_double_value
    # Step in blocks of one row; the host feeds gusts and levels before each step.
    watch = GroundWatch(fdm, mission.aircraft, stride * dt_s)
    status, reason = "ok", ""
    if burn_in_rows == 0:
        values.extend([get() for get in getters])
    connection = contextlib.ExitStack()
    guide = None
    try:
        if isinstance(autopilot, WaypointMission):
            guide = WaypointGuide(autopilot, fdm)
            advance = guide.around(advance)
        elif autopilot is not None:
            process = connection.enter_context(AutopilotProcess(autopilot, mission.aircraft))
            advance = process.around(fdm, advance)
        for block in range(burn_in_rows + recorded_rows):
            report_time(block * stride * dt_s)
            touched = watch.advance(advance, stride)
            if not (math.isfinite(height()) and speed() < DIVERGED_FPS):
                status, reason = "diverged", f"the state was no longer finite at {_clock(fdm)}"
                break
            if touched:
                status, reason = "ground-contact", f"{touched} touched the ground at {_clock(fdm)}"
                break
            # Rows of the burn-in are not recorded.
            if block >= burn_in_rows:
                values.extend([get() for get in getters])
    except AutopilotStoppedError as error:
        status, reason = "crashed", str(error)
    except engine.RuntimeFailure as error:
        status, reason = "crashed", engine.explain(fdm, error)
    except MemoryError:
        status, reason = "crashed", f"JSBSim ran out of memory at {_clock(fdm)}"
    finally:
        connection.close()
    rows = to_signals(np.frombuffer(values).reshape(-1, len(getters)), table)
    recorded = RecordedFlight(list(table), rows, status, reason, float(fdm.get_sim_time()))
    recorded.items = [] if guide is None else guide.report()
    return recorded


def row_counts(spec: FlightSpec, row_s: float, keep_burn_in: bool = False) -> tuple[int, int]:
    """Return the numbers of burn-in rows and of recorded rows, each of ``row_s`` [s]."""
    burn = 0 if keep_burn_in else math.ceil(round(spec.burn_in_s / row_s, 9))
    return burn, math.ceil(
        round((spec.duration_s + (spec.burn_in_s if keep_burn_in else 0.0)) / row_s, 9)
    )


def _clock(fdm: Any) -> str:
    """Return the simulation time as text."""
    return f"{fdm.get_sim_time():.1f} s"


def record_stride(spec: FlightSpec, dt_s: float) -> int:
    """Return the steps per recorded row. Raises BadInputError if the rate does not divide the
    step's.
    """
    stride = round(1.0 / (spec.record_rate_hz * dt_s))
    if stride < 1 or abs(stride * spec.record_rate_hz * dt_s - 1.0) > 1e-6:
        raise BadInputError(
            f"record rate {spec.record_rate_hz:g} Hz: with a step of {dt_s:g} s, "
            f"{1 / dt_s:g} Hz divided by a whole number is possible"
        )
    return stride


def _exists(fdm: Any, source: Source) -> bool:
    """Return whether a source's properties exist."""
    manager = fdm.get_property_manager()
    return bool(
        manager.hasNode(source.property) and (source.over is None or manager.hasNode(source.over))
    )


def _getters(fdm: Any, table: Mapping[str, Source]) -> list[Callable[[], float]]:
    """Return the getters of all properties, then of all divisors."""
    names = [s.property for s in table.values()] + [
        s.over for s in table.values() if s.over is not None
    ]
    engine.require(fdm, names)
    return [engine.handle(fdm, name).get_double_value for name in names]


def to_signals(read: FloatArray, table: Mapping[str, Source]) -> FloatArray:
    """Return signals (n, m) from the values of the getters (n, m + divisors).

    NaN or infinite where a divisor is zero.
    """
    rows = np.empty((len(read), len(table)))
    divisor = len(table)
    for column, source in enumerate(table.values()):
        rows[:, column] = read[:, column] * source.factor
        if source.over is not None:
            with np.errstate(divide="ignore", invalid="ignore"):
                rows[:, column] /= read[:, divisor]
            divisor += 1
    return rows


def set_conditions(fdm: Any, mission: StagedMission, spec: FlightSpec) -> None:
    """Set seeds, wind, turbulence, noise and properties on a mission before initialisation.

    Parameters
    ----------
    fdm : FGFDMExec
        Instance just opened.
    mission : StagedMission
        Aircraft and script.
    spec : FlightSpec
        Conditions.

    Raises
    ------
    BadInputError
        For values out of range, properties that events set, and conditions that need a system which
        the aircraft does not have.
    """
    if spec.turbulence not in TURBULENCE_W20_KT:
        raise BadInputError(
            f"turbulence '{spec.turbulence}': allowed are {', '.join(TURBULENCE_W20_KT)}"
        )
    if spec.turbulence_source not in ("jsbsim", "spec"):
        raise BadInputError(
            f"turbulence source '{spec.turbulence_source}': allowed are jsbsim, spec"
        )
    for name in ("seed_turbulence", "seed_noise"):
        if not 0 <= getattr(spec, name) <= _MAX_SEED:
            raise BadInputError(
                f"{name} = {getattr(spec, name)}: an integer from 0 to {_MAX_SEED} is needed"
            )
    for name in spec.properties:
        if name in _RESERVED:
            raise BadInputError(f"property {name} cannot be set by name: {_RESERVED[name]}")
    # A script may change the integrators for some frames, to restart a multistep rule at a jump.
    chosen = [name for name, value in spec.properties.items() if SECOND_ORDER.get(name) != value]
    refuse_conflicts(mission.script, [*_CONDITION_PROPERTIES, *chosen])
    _require_transient(fdm, mission, spec)
    # Wind and turbulence go through the air system, where there is one.
    with_air = has_air_system(fdm)
    if not with_air and spec.turbulence != "none" and spec.turbulence_source == "jsbsim":
        raise BadInputError(
            f"aircraft '{mission.aircraft.name}' has no air system (property air/wind-north-fps),"
            " and JSBSim's turbulence alone is wrong in a wind and above sea level"
            ' (docs/jsbsim-traps.md): use turbulence_source = "spec" (--turbulence-source spec),'
            ' or add <system file="air"/> to its XML'
        )
    fdm["simulation/randomseed"] = spec.seed_noise
    fdm["atmosphere/randomseed"] = spec.seed_turbulence
    if with_air:
        fdm["air/wind-mps"] = spec.wind_mps
        fdm["air/wind-from-deg"] = spec.wind_from_deg
        fdm["air/turbulence-w20-kt"] = TURBULENCE_W20_KT[spec.turbulence]
        fdm["air/turbulence-source"] = 0.0 if spec.turbulence_source == "jsbsim" else 1.0
    if fdm.get_property_manager().hasNode("sensor/V-mps"):
        fdm["sensor/noise"] = float(spec.sensor_noise)
    elif spec.sensor_noise:
        raise BadInputError(
            f"aircraft '{mission.aircraft.name}' has no sensors system (property sensor/V-mps): use"
            " sensor_noise = false (omit --noise)"
        )
    for name, value in without_missing_switches(fdm, spec.properties).items():
        if name not in CHANGEABLE:
            engine.set_property(fdm, name, value)
    # Initial conditions are an airspeed; the ground velocity includes the wind.
    # The wind blows towards this direction.
    toward = math.radians(spec.wind_from_deg + 180.0)
    if spec.wind_mps:
        north, east = fdm["ic/vn-fps"], fdm["ic/ve-fps"]
        fdm["ic/vn-fps"] = north + spec.wind_mps * math.cos(toward) / FT_M
        fdm["ic/ve-fps"] = east + spec.wind_mps * math.sin(toward) / FT_M
        if not with_air:
            # Set last, when it no longer changes the ground velocity. JSBSim's direction is the one
            # that the wind blows to.
            fdm["ic/vw-dir-deg"] = math.degrees(toward)
            fdm["ic/vw-mag-fps"] = spec.wind_mps / FT_M


def _require_transient(fdm: Any, mission: StagedMission, spec: FlightSpec) -> None:
    """Raise BadInputError if a transient model error cannot act on the aircraft."""
    if spec.transient is None:
        return
    exists = fdm.get_property_manager().hasNode
    missing = [
        name for name in (f"uq/{c}/transient-level" for c in COEFFICIENTS) if not exists(name)
    ]
    if missing:
        raise BadInputError(
            f"aircraft '{mission.aircraft.name}' has no property {missing[0]}, so no transient"
            " model error can act on it: renew its model-form.xml (uqharness instrument), or use"
            " [epistemic] transient = false"
        )


def without_missing_switches(fdm: Any, properties: Mapping[str, float]) -> dict[str, float]:
    """Return properties with zero bounds in place of a switch that the aircraft does not have.

    The switch is uq/<C>/active = 0; older plugins lack it.
    """
    exists = fdm.get_property_manager().hasNode
    result: dict[str, float] = {}
    for name, value in properties.items():
        plugin, _, setting = name.rpartition("/")
        if setting == "active" and plugin.startswith("uq/") and value == 0.0 and not exists(name):
            result |= {f"{plugin}/lower": 0.0, f"{plugin}/upper": 0.0}
        else:
            result[name] = value
    return result


def set_wind_without_air(fdm: Any, spec: FlightSpec) -> None:
    """Set the steady wind in an aircraft without the air system, after initialisation.

    Initialisation would reset it.
    """
    if has_air_system(fdm):
        return
    toward = math.radians(spec.wind_from_deg + 180.0)
    fdm["atmosphere/wind-north-fps"] = spec.wind_mps * math.cos(toward) / FT_M
    fdm["atmosphere/wind-east-fps"] = spec.wind_mps * math.sin(toward) / FT_M
    fdm["atmosphere/wind-down-fps"] = 0.0


def _require_settings_hold(fdm: Any, properties: Mapping[str, float]) -> None:
    """Raise BadInputError for a property that initialisation has overwritten.

    It would have no effect, without a message.
    """
    for name, value in properties.items():
        actual = fdm[name]
        if (
            name not in CHANGEABLE
            and not name.startswith("ic/")
            and abs(actual - value) > 1e-9 * max(abs(value), 1.0)
        ):
            raise BadInputError(
                f"property {name} was set to {value:g} and is {actual:g} after initialising: the"
                " model computes it, so it cannot be set"
            )
