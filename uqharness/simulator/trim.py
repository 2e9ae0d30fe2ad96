"""Steady flight: attitude, controls and throttle at which no acceleration remains.

JSBSim's trim needs a <propulsion> engine and fails for a thrust map in external_reactions.
`find_trim` instead solves for zero accelerations by bounded least squares. Each evaluation imposes
a state on the model as it is after loading (`forced_state`), because an instance that has run
remembers its actuators. It serves any winged aircraft with named controls, gliders included. If
there is no trim, the result says which control saturates, or how much thrust is missing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sysid.units import G0_MPS2, LBF_N, SLUG_KG
from uqharness.errors import BadInputError
from uqharness.simulator import engine, forced_state, settling
from uqharness.simulator.aircraft import Aircraft, host_properties, open_aircraft, with_step
from uqharness.simulator.aircraft_checks import rotor_place
from uqharness.simulator.forced_state import (
    BodyState,
    ControlEquilibrium,
    body_velocity,
    evaluate_state,
    force_state,
    impose_state,
    on_shared_instance,
    open_forced,
    read_accelerations,
    set_control,
    set_initial_state,
)

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

# Explanations of trims without enough, or with too much, thrust.

SPEEDS = (0.9, 0.75, 0.6, 1.1, 1.35, 2.0)
"""Shares of the requested speed at which flight is tried, in this order on each side."""
_HALVINGS = 3


@dataclass(frozen=True)
class AtLimit:
    """Steady flight with the throttle at one end.

    Attributes
    ----------
    climb_rad : float
        Flight-path angle [rad].
    thrust_N : float
        Thrust [N]; NaN if the model does not report it.
    """

    climb_rad: float
    thrust_N: float


def thrust_reason(
    V_mps: float,
    target_rad: float,
    full: Callable[[float], AtLimit | None],
    idle: Callable[[float], AtLimit | None],
    mass_kg: float,
) -> str:
    """Explain a path that full throttle cannot hold or idle cannot descend to.

    Parameters
    ----------
    V_mps, target_rad : float
        True airspeed [m/s] and flight-path angle [rad].
    full, idle : callable
        Return the steady flight at an airspeed with the throttle at that end, or None.
    mass_kg : float
        Mass, which turns acceleration into thrust [kg].

    Returns
    -------
    str
        A sentence with the missing or excess thrust and the nearest speed that fits; empty if
        thrust is not the cause.
    """
    # direction is -1 for full throttle, which may climb too little, and +1 for idle, which may
    # descend too little.
    for throttle, fly_at_end, direction in (("full", full, -1.0), ("idle", idle, 1.0)):
        limit = fly_at_end(V_mps)
        if limit is None or direction * (limit.climb_rad - target_rad) <= 0.0:
            continue
        # Along the path, thrust must balance drag and the weight's component m g sin(climb).
        change = G0_MPS2 * abs(math.sin(limit.climb_rad) - math.sin(target_rad))
        thrust = (
            f"{limit.thrust_N:.0f} N of thrust"
            if math.isfinite(limit.thrust_N)
            else "the thrust of that throttle"
        )
        shortfall = (
            f"{'deceleration' if direction < 0.0 else 'acceleration'} {change:.2g} m/s^2 at"
            f" {throttle} throttle: {thrust}"
        )
        amount = f"{mass_kg * change:.3g} N too {'little' if direction < 0.0 else 'much'}"
        return (
            f"{shortfall} at {V_mps:g} m/s, {amount};"
            f" {_advice(V_mps, target_rad, fly_at_end, direction, limit)}"
        )
    return ""


def dead_throttle_message(property_name: str, thrust_N: float, unsettled: str) -> str:
    """Return a sentence for engines whose thrust does not depend on the throttle.

    ``thrust_N`` is the thrust [N] at both ends; ``unsettled`` is added as a remark.
    """
    remark = f" ({unsettled})" if unsettled else ""
    return (
        f"{property_name} does not change the thrust, {thrust_N:.0f} N at either end{remark};"
        " `uqharness instrument` looks for the property that does; else name it as"
        " [inputs.throttle] property of a card, or leave [inputs.throttle] out of it to fly with"
        " the engines as they are"
    )


def _advice(
    V_mps: float,
    target_rad: float,
    fly_at_end: Callable[[float], AtLimit | None],
    direction: float,
    limit: AtLimit,
) -> str:
    """Return the nearest speed that fits, slower ones first, else the nearest path."""

    def fits(V: float) -> bool | None:
        limit_at_speed = fly_at_end(V)
        return (
            None
            if limit_at_speed is None
            else direction * (limit_at_speed.climb_rad - target_rad) <= 0.0
        )

    # Search outwards on each side for the first speed that fits, then refine by bisection.
    for slower in (True, False):
        outside = V_mps
        for share in SPEEDS:
            if (share < 1.0) is not slower:
                continue
            inside = share * V_mps
            fit = fits(inside)
            if fit is None:
                # No steady flight at all: beyond a stall or a control's limit.
                break
            if not fit:
                outside = inside
                continue
            for _ in range(_HALVINGS):
                middle = 0.5 * (inside + outside)
                inside, outside = (middle, outside) if fits(middle) else (inside, middle)
            sign = "<=" if slower else ">="
            # Rounded to the side that flies.
            tenths = math.floor(10.0 * inside) if slower else math.ceil(10.0 * inside)
            return f"try V {sign} {tenths / 10.0:g} m/s"
    speed_range = f"{min(SPEEDS) * V_mps:.3g} to {max(SPEEDS) * V_mps:.3g} m/s"
    # Rounded to the side that flies.
    # No speed fits: advise the path that this throttle holds.
    hundredths = 100.0 * math.degrees(limit.climb_rad)
    path, sign = (
        (math.floor(hundredths), "<=") if direction < 0.0 else (math.ceil(hundredths), ">=")
    )
    return (
        f"no speed from {speed_range} fits; try a path of {sign} {path / 100.0:g} deg (--climb-deg,"
        " climb_deg of [start])"
    )


_ENGINE_THRUSTS = (
    "propulsion/engine/thrust-lbs",
    *(f"propulsion/engine[{k}]/thrust-lbs" for k in range(1, 8)),
)
_PROPELLER_RPM = "propulsion/engine/propeller-rpm"
_BODY_RATES = ("velocities/p-rad_sec", "velocities/q-rad_sec", "velocities/r-rad_sec")
_MASS = "inertia/mass-slugs"
_SURFACES = ("elevator", "aileron", "rudder", "throttle")
_LATERAL_LOAD_FACTOR = "accelerations/Ny"
_G_MPS2 = 9.806
_AXES = (
    "forward acceleration",
    "sideways acceleration",
    "downward acceleration",
    "roll acceleration",
    "pitch acceleration",
    "yaw acceleration",
    "lateral specific force",
)
_UNITS = ("m/s^2",) * 3 + ("rad/s^2",) * 3 + ("m/s^2",)
_AT_LIMIT = 0.005  # of a range: a search keeps off its bounds
_STALLED_STEPS, _STALLED_GAIN = 3, 0.98  # a search ends where that many steps leave that share
_LATERAL_SHARE = 0.1  # of the largest acceleration, from where bank may help
_UNSETTLED_SHARE = 0.25  # of a failed search's evaluations, from where it failed for that
_STEP_SHARES = (0.5, 0.2, 0.1, 0.05)  # of the step, at which an unstable engine is tried again
# Forces that are no aerodynamic ones
_PUSHES = tuple(f"forces/fb{a}-{part}-lbs" for a in "xyz" for part in ("prop", "external"))
_MIN_CHANGE = 1e-9  # m/s2, rad/s2
_MAX_CLIMB_RAD = 0.9
_NEARLY_STEADY = 1e-3  # m/s2, rad/s2: steady to the digits that a sentence has
_OPEN_THROTTLE = 0.9  # of the throttle's travel, from where a second search begins
_MAX_BANK_RAD = math.radians(
    5.0
)  # of straight flight whose surfaces alone do not balance it (MIL-F-8785C, 3.3.9)
_WATCHED_FRAMES = 10
_OFF_CENTRE = 0.6  # of a command's range: a filter of a command in the centre may rest at zero
_RATE_TIME_S = 1.0  # weighs an angular acceleration against the rate that it leads to


@dataclass(frozen=True)
class SteadyCondition:
    """A steady flight condition.

    Attributes
    ----------
    V_mps : float
        True airspeed [m/s].
    altitude_m : float
        Altitude above sea level [m].
    climb_rad, heading_rad : float
        Flight-path angle and heading [rad].
    bank_rad : float
        Bank [rad]. Other than 0 asks for a coordinated turn (no lateral specific force). The
        condition of a trim may have a bank in straight flight, with a turn rate of 0.
    wind_ned_mps : tuple of float
        Velocity of the air (north, east, down) [m/s]; it changes only the ground velocity.
    properties : mapping
        Properties set before the trim.
    """

    V_mps: float
    altitude_m: float = 0.0
    climb_rad: float = 0.0
    bank_rad: float = 0.0
    heading_rad: float = 0.0
    wind_ned_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    properties: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Trim:
    """Result of a trim.

    Attributes
    ----------
    condition : SteadyCondition
        With the flight-path angle and bank found, if these were unknowns.
    converged : bool
        Whether all accelerations vanish.
    reason : str
        Which control is saturated or what keeps accelerating; empty if converged.
    alpha_rad, beta_rad, theta_rad : float
        Incidence, sideslip and pitch [rad].
    turn_rate_radps, p_radps, q_radps, r_radps : float
        Turn rate and body rates [rad/s].
    controls : mapping
        In each control's own unit.
    positions_deg : mapping
        Surface positions, where the model reports them.
    thrust_N, rpm : float
        NaN if the model does not report them.
    residual : ndarray
        Remaining accelerations (6,) [m/s2, rad/s2].
    velocity_ned_mps : tuple of float
        Ground velocity [m/s].
    equilibrium : ControlEquilibrium or None
        How the control system was brought to rest; None if it is at rest from the first frame.
    """

    condition: SteadyCondition
    converged: bool
    reason: str
    alpha_rad: float
    beta_rad: float
    theta_rad: float
    turn_rate_radps: float
    p_radps: float
    q_radps: float
    r_radps: float
    controls: Mapping[str, float]
    positions_deg: Mapping[str, float]
    thrust_N: float
    rpm: float
    residual: NDArray[np.float64]
    velocity_ned_mps: tuple[float, float, float]
    equilibrium: ControlEquilibrium | None = None

    @property
    def state(self) -> BodyState:
        """Return the trimmed state at its heading."""
        u, v, w = body_velocity(self.condition.V_mps, self.alpha_rad, self.beta_rad)
        condition = self.condition
        rates = self.p_radps, self.q_radps, self.r_radps
        return BodyState(u, v, w, condition.bank_rad, self.theta_rad, condition.heading_rad, *rates)

    def __repr__(self) -> str:
        summary = f"alpha {self.alpha_rad:.4g} rad" if self.converged else self.reason
        return f"Trim({self.condition.V_mps:g} m/s at {self.condition.altitude_m:g} m, {summary})"


def pitch_for_climb(alpha: float, beta: float, phi: float, climb: float) -> float:
    """Return the pitch angle [rad] for a flight-path angle at a bank.

    Source: Stevens and Lewis, Aircraft Control and Simulation, rate-of-climb constraint. NaN if
    there is none.

    Examples
    --------
    >>> round(pitch_for_climb(0.05, 0.0, 0.0, 0.1), 12)
    0.15
    """
    a = math.cos(alpha) * math.cos(beta)
    b = math.sin(phi) * math.sin(beta) + math.cos(phi) * math.sin(alpha) * math.cos(beta)
    s = math.sin(climb)
    root = a * a - s * s + b * b
    if root < 0.0:
        return float("nan")
    return math.atan2(a * b + s * math.sqrt(root), a * a - s * s)


def force_near_trim(
    aircraft: Aircraft,
    trim: Trim,
    state: BodyState,
    controls: Mapping[str, float],
) -> NDArray[np.float64]:
    """Return accelerations (6,) [m/s2, rad/s2] at a state near a trim with settled controls.

    The control system stays as it rested in the trim; only parts without delay respond. Raises
    BadInputError.
    """
    condition = trim.condition

    def action(fdm: Any, rearm: bool) -> forced_state.Evaluation:
        impose_state(
            fdm,
            aircraft,
            trim.state,
            trim.controls,
            condition.altitude_m,
            condition.properties,
            trim.equilibrium,
            rearm=rearm,
        )
        for name, value in controls.items():
            set_control(fdm, aircraft, name, value)
        set_initial_state(fdm, state)
        engine.run_ic(fdm)
        if fdm.get_propulsion().get_num_engines():
            engine.settle_engines(fdm)
        return (*read_accelerations(fdm, ()), "")

    return on_shared_instance(aircraft, action)[0]


def find_trim(aircraft: Aircraft, condition: SteadyCondition, *, explains: bool = True) -> Trim:
    """Trim an aircraft by bounded least squares.

    Parameters
    ----------
    aircraft : Aircraft
        An aircraft with wings.
    condition : SteadyCondition
        Flight condition.
    explains : bool
        Whether a failure is explained, which takes several searches at other speeds.

    Returns
    -------
    Trim
        Not converged, with a reason, if there is no trim.

    Raises
    ------
    BadInputError
        If the model does not load, or is a rotorcraft.

    Notes
    -----
    Unknowns are alpha, beta, elevator, aileron, rudder, throttle, and the rate of a turn. Equations
    are the six accelerations and, in a turn, zero lateral specific force.

    Without thrust to set (a glider, or rockets with empty tanks), the flight-path angle replaces
    the throttle. Engines that do not respond to the throttle, or never settle, are a failure. If
    surfaces alone do not balance straight flight (a rudder coupled to the ailerons), bank up to 5
    deg replaces the rudder. If the control system moves at the trim, states are imposed with it at
    rest, body rates first held, then free.
    """
    if rotor := rotor_place(aircraft):
        raise BadInputError(f"{rotor}; only aircraft with wings are trimmed")
    equilibrium = _moving_from_the_start(aircraft, condition)
    result = _search(aircraft, condition, equilibrium)
    # The control system was at rest at the start, but may move at the trim found.
    if equilibrium is None and (equilibrium := _moving_at_trim(aircraft, result.trim)) is not None:
        result = _search(aircraft, condition, equilibrium)
    if equilibrium is None and not result.trim.converged:
        # Filters that began before the air data were there move only as time passes.
        equilibrium = _moving_from_the_start(aircraft, condition, frames=_WATCHED_FRAMES)
        if equilibrium is not None:
            resting = _search(aircraft, condition, equilibrium)
            result = resting if resting.trim.converged else result
    if equilibrium is not None and not result.trim.converged and result.problem.unsettled:
        # A control law that integrates a rate error rests only at the commanded rate.
        free = _search(aircraft, condition, replace(equilibrium, free=True))
        result = free if free.trim.converged else result
    return result.explained() if explains else result.trim


@dataclass(frozen=True)
class _SearchResult:
    """End of a search.

    Attributes
    ----------
    problem, trim, x
        Problem, resulting trim, and scaled unknowns.
    failure : str
        Why it is no trim; empty if the search found none.
    """

    problem: _Problem
    trim: Trim
    x: NDArray[np.float64]
    failure: str

    def explained(self) -> Trim:
        """Return the trim; without convergence, with its cause."""
        if self.trim.converged:
            return self.trim
        hint = ""
        if not self.problem.aircraft.has_card and host_properties(self.problem.aircraft):
            hint = (
                "; it reads properties of its host, and `uqharness instrument` finds by their"
                " effect which systems must be on"
            )
        return replace(
            self.trim, reason=f"{_condition_text(self.problem.condition)}: {self._cause()}{hint}"
        )

    def _cause(self) -> str:
        """Return why there is no trim: settling, thrust, a saturated control, or none of these."""
        if self.failure:
            return self.failure
        problem, residual = self.problem, self.trim.residual
        # Order of suspicion: settling, thrust, a saturated control, a wing that stalls.
        limits = problem.at_limits(self.x)
        axis = int(np.argmax(np.abs(residual)))
        throttle_end = dict(limits).get("throttle", "")
        mass_kg = _mass_kg(problem, self.x)
        # Thrust is suspected if the throttle is saturated or the forward acceleration is largest.
        if "throttle" in problem.names and (throttle_end or axis == 0):
            end = throttle_end if residual[0] == 0.0 else "upper" if residual[0] < 0.0 else "lower"
            if reason := _thrust_reason(problem, end, mass_kg):
                return reason
        remaining = f"{_AXES[axis]} of {residual[axis]:.3g} {_UNITS[axis]} remains"
        if throttle_end and axis == 0:
            amount = (
                f"{mass_kg * abs(residual[0]):.3g} N too"
                f" {'little' if residual[0] < 0.0 else 'much'}"
            )
            remaining += f", thrust is {amount}"
        saturated = [name for name, _ in limits if name != "alpha"]
        where = ", ".join(problem.limit_words(name, end) for name, end in limits)
        if "alpha" in dict(limits):
            return (
                f"{where}: {remaining}; the wing does not carry the aircraft at this speed and "
                "height, so try a faster or lower flight"
            )
        if saturated:
            speed = "another speed"
            if saturated[0] == "elevator" and axis in {2, 4}:
                # Sinking, or nose-down at the stop: the alpha that level flight needs is too large.
                slow = (residual[2] > 0.0) if axis == 2 else (residual[4] < 0.0)
                speed += f", rather a {'faster' if slow else 'slower'} one"
            return (
                f"{where}: {remaining}; try {speed}, or widen limits in"
                f" [inputs.{saturated[0]}] of airframe.toml if the aircraft has more travel"
            )
        if axis == 2 and residual[2] > 0.0:
            return (
                f"{remaining} at the alpha of most lift, {math.degrees(self.trim.alpha_rad):.3g}"
                " deg: the wing does not carry the aircraft at this speed and height, so try a"
                " faster or lower flight"
            )
        return (
            f"no equilibrium: {remaining} where all accelerations are least (alpha "
            f"{math.degrees(self.trim.alpha_rad):.3g} deg), although no control is at its limit; "
            "try another speed or height"
        )


def _search(
    aircraft: Aircraft, condition: SteadyCondition, equilibrium: ControlEquilibrium | None
) -> _SearchResult:
    """Search with the control system as in the first frame, or brought to rest."""
    cards = aircraft.card.inputs
    # The instance must outlive its manager, or absolute names are not found.
    probe = open_aircraft(aircraft)
    exists = probe.get_property_manager().hasNode
    names = [
        name
        for name in _SURFACES
        if name in cards and (aircraft.has_card or exists(cards[name].property))
    ]
    acts, unused, dead = _throttle_acts(aircraft, condition, names, equilibrium)
    fixed = {} if acts else {n: unused for n in names if n == "throttle"}
    # Without thrust to set, the path is unknown instead.
    gliding = bool(fixed) or "throttle" not in names
    # A surface that moves nothing (the rudder of a flying wing) would take the search's steps.
    fixed |= _dead_surfaces(aircraft, condition, names, equilibrium)
    problem = _Problem(
        aircraft,
        condition,
        tuple(n for n in names if n not in fixed),
        fixed,
        free_climb=gliding,
        equilibrium=equilibrium,
    )
    x = problem.solve()
    trim = _result(problem, x)
    failure, unstable = ("", False) if trim.converged else _unsettled(problem, x)
    if unstable or (equilibrium is not None and not equilibrium.free and problem.never_settles):
        return _SearchResult(problem, trim, x, dead or failure)
    # Lateral accelerations alone are no matter of the throttle.
    size = np.abs(trim.residual)
    is_lateral = float(np.max(size[[0, 2, 4]])) < _LATERAL_SHARE * float(np.max(size))
    if (
        not trim.converged
        and not is_lateral
        and acts
        and dict(problem.at_limits(x)).get("throttle") != "upper"
    ):
        # Windmilling and powered propellers are two steady states with a jump in thrust between
        # them: try again from an open throttle.
        other_x = problem.solve(_OPEN_THROTTLE)
        other = _result(problem, other_x)
        x, trim = (other_x, other) if other.converged else (x, trim)
    lateral = np.abs(trim.residual)[[1, 3, 5]]
    if (
        not trim.converged
        and not problem.turning
        and np.max(lateral) > _LATERAL_SHARE * np.max(np.abs(trim.residual))
    ):
        # Lateral accelerations remain: let straight flight bank. Without ailerons the rudder rolls
        # the aircraft by sideslip.
        for neutral in ("rudder", "aileron"):
            banked = problem.banked(neutral)
            other = _result(banked, other_x := banked.solve())
            if other.converged:
                problem, x, trim = banked, other_x, other
                break
    if trim.converged or not failure:
        failure = _unsettled_at(problem, x) if trim.converged else ""
    failure = dead or failure
    return _SearchResult(
        problem, replace(trim, converged=trim.converged and not failure), x, failure
    )


def _moving_from_the_start(
    aircraft: Aircraft, condition: SteadyCondition, frames: int = 0
) -> ControlEquilibrium | None:
    """Return the equilibrium needed if the control system moves at this speed; else None.

    Commands are off centre: a filter of a centred command may rest at zero. ``frames`` pass with
    frozen motion.
    """
    u, v, w = body_velocity(condition.V_mps, 0.05, 0.0)
    cards = aircraft.card.inputs
    # The instance must outlive its manager, or absolute names are not found.
    probe = open_aircraft(aircraft)
    exists = probe.get_property_manager().hasNode
    # Controls that exist, at 60 % of their range.
    ends = {
        name: cards[name].limits
        for name in _SURFACES
        if name in cards and exists(cards[name].property)
    }
    controls = {name: low + _OFF_CENTRE * (high - low) for name, (low, high) in ends.items()}
    state = BodyState(u, v, w, 0.0, 0.05, condition.heading_rad)
    return _moving_at(aircraft, condition, state, controls, frames)


def _moving_at_trim(aircraft: Aircraft, trim: Trim) -> ControlEquilibrium | None:
    """Return the equilibrium needed if the control system moves at a trim; else None."""
    return (
        _moving_at(aircraft, trim.condition, trim.state, trim.controls)
        if math.isfinite(trim.theta_rad)
        else None
    )


def _moving_at(
    aircraft: Aircraft,
    condition: SteadyCondition,
    state: BodyState,
    controls: Mapping[str, float],
    frames: int = 0,
) -> ControlEquilibrium | None:
    """Return the equilibrium needed if the control system moves at a state; else None."""
    fdm, _ = open_forced(aircraft, state, controls, condition.altitude_m, condition.properties)
    equilibrium = forced_state.control_equilibrium(aircraft, fdm)
    return equilibrium if forced_state.moving_property(fdm, equilibrium, frames) else None


def _throttle_acts(
    aircraft: Aircraft,
    condition: SteadyCondition,
    names: list[str],
    equilibrium: ControlEquilibrium | None,
) -> tuple[bool, float, str]:
    """Return whether the throttle sets thrust, its setting if not, and an error if engines ignore
    it.

    A glider's throttle may be the lever of its air brakes, which stay in.
    """
    if "throttle" not in names:
        return False, 0.0, ""
    card = aircraft.card.inputs["throttle"]
    u, v, w = body_velocity(condition.V_mps, 0.05, 0.0)
    state = BodyState(u, v, w, 0.0, 0.05, condition.heading_rad)
    accelerations, pushes, unsettled = [], [], ""
    # Compare the accelerations at both ends of the throttle.
    for end in card.limits:
        acceleration, out, end_unsettled = evaluate_state(
            aircraft,
            state,
            {"throttle": end},
            condition.altitude_m,
            condition.properties,
            _PUSHES,
            equilibrium=equilibrium,
        )
        accelerations.append(acceleration)
        pushes.append(np.array([*out.values()]))
        unsettled = unsettled or end_unsettled
    forward = [float(acceleration[0]) for acceleration in accelerations]
    if float(np.max(np.abs(accelerations[1] - accelerations[0]))) > _MIN_CHANGE:
        is_brake = np.array_equal(pushes[0], pushes[1]) and max(forward) < 0.0
        return not is_brake, card.limits[int(np.argmax(forward))], ""
    full = {"throttle": card.limits[1]}
    fdm, _ = open_forced(
        aircraft, state, full, condition.altitude_m, condition.properties, equilibrium
    )
    if not fdm.get_propulsion().get_num_engines() or settling.spent_rockets(fdm):
        return False, card.limits[0], ""
    exists = fdm.get_property_manager().hasNode
    thrust_N = LBF_N * sum(fdm[name] for name in _ENGINE_THRUSTS if exists(name))
    return False, card.limits[0], dead_throttle_message(card.property, thrust_N, unsettled)


def _dead_surfaces(
    aircraft: Aircraft,
    condition: SteadyCondition,
    names: list[str],
    equilibrium: ControlEquilibrium | None,
) -> dict[str, float]:
    """Return the surfaces that change no force and no moment, at the middle of their ranges."""
    u, v, w = body_velocity(condition.V_mps, 0.05, 0.0)
    state = BodyState(u, v, w, 0.0, 0.05, condition.heading_rad)
    dead = {}
    for name in names:
        if name == "throttle":
            continue
        low, high = aircraft.card.inputs[name].limits
        accelerations = [
            evaluate_state(
                aircraft,
                state,
                {name: low + share * (high - low)},
                condition.altitude_m,
                condition.properties,
                equilibrium=equilibrium,
            )[0]
            for share in (0.25, 0.8)
        ]
        if float(np.max(np.abs(accelerations[1] - accelerations[0]))) <= _MIN_CHANGE:
            dead[name] = 0.5 * (low + high)
    return dead


def _unsettled(problem: _Problem, x: NDArray[np.float64]) -> tuple[str, bool]:
    """Return what does not settle at the unknowns, and whether a shorter step would settle.

    If all settles there but failed in much of the search, the last failure counts.
    """
    condition = problem.condition

    def unsettled_with(aircraft: Aircraft) -> str:
        state, controls, _, _ = problem.unpack(x)
        if not math.isfinite(state.theta):
            return ""
        return evaluate_state(
            aircraft,
            state,
            controls,
            condition.altitude_m,
            condition.properties,
            equilibrium=problem.equilibrium,
        )[2]

    # At the solution; else where the search failed last.
    reason = unsettled_with(problem.aircraft)
    if not reason and len(problem.unsettled) > _UNSETTLED_SHARE * problem.evaluations:
        x = problem.unsettled[-1]
        reason = unsettled_with(problem.aircraft)
    if not reason:
        return "", False
    # A propeller that a shorter step settles is a matter of the integrator.
    for share in _STEP_SHARES:
        dt_s = float(f"{share * problem.aircraft.dt_s:.2g}")
        if not unsettled_with(with_step(problem.aircraft, dt_s)):
            larger = (
                f", or a propeller's <ixx> of {1.0 / share:g} times the XML's"
                if "propeller" in reason
                else ""
            )
            return (
                (
                    f"{reason}; it is unstable at this step and settles at a shorter one (dt_s = "
                    f"{dt_s:g} in [aircraft] of airframe.toml{larger})"
                ),
                True,
            )
    return reason, False


def _unsettled_at(problem: _Problem, x: NDArray[np.float64]) -> str:
    """Return what does not settle at these unknowns."""
    state, controls, _, _ = problem.unpack(x)
    condition = problem.condition
    return evaluate_state(
        problem.aircraft,
        state,
        controls,
        condition.altitude_m,
        condition.properties,
        equilibrium=problem.equilibrium,
    )[2]


def _mass_kg(problem: _Problem, x: NDArray[np.float64]) -> float:
    """Return the aircraft's mass [kg]."""
    state, controls, _, _ = problem.unpack(x)
    condition = problem.condition
    _, out = force_state(
        problem.aircraft, state, controls, condition.altitude_m, condition.properties, (_MASS,)
    )
    return SLUG_KG * out[_MASS]


def _thrust_reason(problem: _Problem, end: str, mass_kg: float) -> str:
    """Return the explanation of `thrust_reason` for one end of the throttle."""
    aircraft, condition = problem.aircraft, problem.condition
    limits = aircraft.card.inputs["throttle"].limits
    free = tuple(name for name in problem.names if name != "throttle")
    start: NDArray[np.float64] | None = None

    def at(V: float) -> AtLimit | None:
        nonlocal start
        limited = _Problem(
            aircraft,
            replace(condition, V_mps=V),
            free,
            {"throttle": limits[end == "upper"]},
            free_climb=True,
            equilibrium=problem.equilibrium,
        )
        unknowns = limited.solve(start=start, tolerance=_NEARLY_STEADY)
        result = _result(limited, unknowns)
        # A governor hunts in its last digits; the sentence needs two.
        if not (result.converged or float(np.max(np.abs(result.residual))) < _NEARLY_STEADY):
            return None
        start = unknowns
        return AtLimit(result.condition.climb_rad, result.thrust_N)

    def never(V: float) -> AtLimit | None:
        return None

    full, idle = (at, never) if end == "upper" else (never, at)
    return thrust_reason(condition.V_mps, condition.climb_rad, full, idle, mass_kg)


class _Problem:
    """Unknowns, bounds and equations of steady flight.

    Parameters
    ----------
    aircraft, condition
        What is trimmed.
    names : tuple of str
        Controls that are unknown.
    fixed : mapping
        Controls that are not.
    free_climb, free_bank : bool
        Whether the path, or the bank of straight flight, is unknown.
    equilibrium : ControlEquilibrium, optional
        Brings the control system to rest at each state.
    """

    def __init__(
        self,
        aircraft: Aircraft,
        condition: SteadyCondition,
        names: tuple[str, ...],
        fixed: Mapping[str, float],
        *,
        free_climb: bool,
        free_bank: bool = False,
        equilibrium: ControlEquilibrium | None = None,
    ) -> None:
        self.aircraft, self.condition, self.names, self.fixed, self.equilibrium = (
            aircraft,
            condition,
            names,
            fixed,
            equilibrium,
        )
        self.free_climb, self.free_bank = free_climb, free_bank
        self.evaluations, self.unsettled = 0, list[NDArray[np.float64]]()
        self.turning = condition.bank_rad != 0.0
        lows, highs = (
            np.array([aircraft.card.inputs[name].limits[end] for name in names], dtype=float)
            for end in (0, 1)
        )
        extra = [0.1] * (self.turning + free_climb + free_bank)
        # Unknowns are scaled to order one: 0.1 rad, a tenth of the control's span, 0.1 rad/s.
        self.scale = np.concatenate([[0.1, 0.1], (highs - lows) / 10.0, extra])
        extra_limits = np.array(
            [3.0] * self.turning + [_MAX_CLIMB_RAD] * free_climb + [_MAX_BANK_RAD] * free_bank
        )
        # Incidence from -20 to 29 deg, sideslip up to 20 deg.
        self.lower = np.concatenate([[-0.35, -0.35], lows, -extra_limits]) / self.scale
        self.upper = np.concatenate([[0.5, 0.35], highs, extra_limits]) / self.scale
        rate = [_G_MPS2 * math.tan(condition.bank_rad) / condition.V_mps] * self.turning
        climb = [condition.climb_rad] * free_climb
        self.guess = np.concatenate(
            [[0.03, 0.0], 0.5 * (lows + highs), rate, climb, [0.0] * free_bank]
        )

    @property
    def never_settles(self) -> bool:
        """Return whether engines or control system settled in under a tenth of the evaluations."""
        return len(self.unsettled) > 0.9 * self.evaluations

    def banked(self, control: str) -> _Problem:
        """Return the same problem with unknown bank and a neutral control."""
        neutral = {
            name: 0.5 * sum(self.aircraft.card.inputs[name].limits)
            for name in self.names
            if name == control
        }
        names = tuple(name for name in self.names if name not in neutral)
        return _Problem(
            self.aircraft,
            self.condition,
            names,
            {**self.fixed, **neutral},
            free_climb=self.free_climb,
            free_bank=True,
            equilibrium=self.equilibrium,
        )

    def at_limits(self, x: NDArray[np.float64]) -> list[tuple[str, str]]:
        """Return which of alpha, beta and the controls are at their "lower" or "upper" limit."""
        out = []
        for name, value, low, high in zip(
            ["alpha", "beta", *self.names], x, self.lower, self.upper, strict=False
        ):
            margin = _AT_LIMIT * (high - low)
            if min(value - low, high - value) < margin:
                out.append((name, "lower" if value - low < margin else "upper"))
        return out

    def limit_words(self, name: str, end: str) -> str:
        """Return a saturated unknown and its limit, in its own unit, as text."""
        k = ["alpha", "beta", *self.names].index(name)
        value = float((self.lower if end == "lower" else self.upper)[k] * self.scale[k])
        if k < 2:
            return f"{name} is at its {end} limit of {math.degrees(value):.3g} deg"
        unit = self.aircraft.card.inputs[name].unit
        return f"{name} is saturated at its {end} limit of {value:g} {unit}"

    def solve(
        self,
        throttle: float = 0.5,
        start: NDArray[np.float64] | None = None,
        tolerance: float = 0.0,
    ) -> NDArray[np.float64]:
        """Return the scaled unknowns with the smallest accelerations.

        Parameters
        ----------
        throttle : float
            Initial throttle as a share of its range.
        start : ndarray, optional
            Initial unknowns instead.
        tolerance : float
            Accelerations [m/s2, rad/s2] at which to stop; three steps without progress stop it too.
        """
        # Processes that only fly need no solver.
        from scipy.optimize import least_squares

        if start is None:
            start = self.guess / self.scale
            if "throttle" in self.names:
                at = 2 + self.names.index("throttle")
                start[at] = self.lower[at] + throttle * (self.upper[at] - self.lower[at])
        # least_squares requires an interior point.
        start = np.clip(start, self.lower + 1e-9, self.upper - 1e-9)
        costs: list[float] = []

        def callback(intermediate_result: OptimizeResult) -> None:
            cost = float(intermediate_result.cost)
            costs.append(cost)
            # Ends failing searches early: evaluations with engines to settle are slow.
            stalled = (
                len(costs) > _STALLED_STEPS and cost > _STALLED_GAIN * costs[-1 - _STALLED_STEPS]
            )
            hopeless = len(costs) > 1 and self.never_settles
            if (stalled and cost > _NEARLY_STEADY**2) or 2.0 * cost < tolerance**2 or hopeless:
                raise StopIteration

        solution = least_squares(
            self.residual,
            start,
            bounds=(self.lower, self.upper),
            xtol=1e-14,
            ftol=1e-14,
            gtol=1e-14,
            x_scale=1.0,
            diff_step=1e-6,
            max_nfev=25,
            callback=callback,
        )
        return np.asarray(solution.x)

    def unpack(self, x: NDArray[np.float64]) -> tuple[BodyState, dict[str, float], float, float]:
        """Return state, controls, turn rate [rad/s] and flight-path angle [rad] of the unknowns."""
        value = x * self.scale
        alpha, beta = float(value[0]), float(value[1])
        phi = float(value[-1]) if self.free_bank else self.condition.bank_rad
        controls = {
            name: float(v)
            for name, v in zip(self.names, value[2 : 2 + len(self.names)], strict=True)
        } | dict(self.fixed)
        # Steady turn: body rates are the turn rate about the vertical, resolved in body axes.
        rate = float(value[2 + len(self.names)]) if self.turning else 0.0
        climb = float(value[-1 - self.free_bank]) if self.free_climb else self.condition.climb_rad
        theta = pitch_for_climb(alpha, beta, phi, climb)
        u, v, w = body_velocity(self.condition.V_mps, alpha, beta)
        state = BodyState(
            u,
            v,
            w,
            phi,
            theta,
            self.condition.heading_rad,
            p=-rate * math.sin(theta),
            q=rate * math.cos(theta) * math.sin(phi),
            r=rate * math.cos(theta) * math.cos(phi),
        )
        return state, controls, rate, climb

    def residual(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return accelerations [m/s2, rad/s2], and in a turn the lateral specific force [m/s2].

        Free body rates also count by their distance from the state's.
        """
        state, controls, _, _ = self.unpack(x)
        # No pitch angle gives this path at this bank.
        if not math.isfinite(state.theta):
            return np.full(7 if self.turning else 6, 1e3)
        condition = self.condition
        acceleration, out, unsettled = evaluate_state(
            self.aircraft,
            state,
            controls,
            condition.altitude_m,
            condition.properties,
            (_LATERAL_LOAD_FACTOR, *_BODY_RATES),
            equilibrium=self.equilibrium,
        )
        self.evaluations += 1
        if unsettled:
            self.unsettled.append(x.copy())
        if self.equilibrium is not None and self.equilibrium.free:
            ended = np.array([out[name] for name in _BODY_RATES])
            acceleration[3:] += (ended - (state.p, state.q, state.r)) / _RATE_TIME_S
        if self.turning:
            acceleration = np.append(acceleration, out[_LATERAL_LOAD_FACTOR] * _G_MPS2)
        return np.where(np.isfinite(acceleration), acceleration, 1e3)


def _condition_text(condition: SteadyCondition) -> str:
    """Return the condition as the start of an error message."""
    return (
        f"no steady flight at {condition.V_mps:g} m/s, bank {math.degrees(condition.bank_rad):g}"
        f" deg, climb {math.degrees(condition.climb_rad):g} deg"
    )


def _result(problem: _Problem, x: NDArray[np.float64]) -> Trim:
    """Return the trim at the unknowns."""
    aircraft, condition, names = problem.aircraft, problem.condition, problem.names
    state, controls, rate, climb = problem.unpack(x)
    residual = problem.residual(x)
    keys = {
        key: aircraft.card.outputs[key]
        for key in ("thrust_N", "rpm")
        if key in aircraft.card.outputs
    }
    surfaces = {
        name: aircraft.card.inputs[name].position or f"fcs/{name}-pos-deg"
        for name in names
        if name != "throttle"
    }
    outputs = (*keys.values(), *surfaces.values(), *_ENGINE_THRUSTS, _PROPELLER_RPM)
    _, out = force_state(
        aircraft,
        state,
        controls,
        condition.altitude_m,
        condition.properties,
        outputs,
        equilibrium=problem.equilibrium,
    )
    engines_lbf = [out[name] for name in _ENGINE_THRUSTS if name in out]
    # The card's thrust, else the sum of the engines.
    thrust_N = out.get(
        keys.get("thrust_N", ""), LBF_N * sum(engines_lbf) if engines_lbf else float("nan")
    )
    converged = bool(np.max(np.abs(residual)) < 1e-6)
    return Trim(
        condition=replace(condition, climb_rad=climb, bank_rad=state.phi),
        converged=converged,
        reason="" if converged else _condition_text(condition),
        alpha_rad=math.atan2(state.w, state.u),
        beta_rad=math.asin(state.v / condition.V_mps),
        theta_rad=state.theta,
        turn_rate_radps=rate,
        p_radps=state.p,
        q_radps=state.q,
        r_radps=state.r,
        controls=controls,
        positions_deg={name: out[source] for name, source in surfaces.items() if source in out},
        thrust_N=thrust_N,
        rpm=out.get(keys.get("rpm", _PROPELLER_RPM), float("nan")),
        residual=residual,
        velocity_ned_mps=_velocity_ned(state, condition.wind_ned_mps),
        equilibrium=problem.equilibrium,
    )


def _velocity_ned(state: BodyState, wind: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return the ground velocity (north, east, down) [m/s]."""
    from scipy.spatial.transform import Rotation

    body_to_ned = Rotation.from_euler("ZYX", [state.psi, state.theta, state.phi])
    air = body_to_ned.apply([state.u, state.v, state.w])
    return float(air[0] + wind[0]), float(air[1] + wind[1]), float(air[2] + wind[2])
