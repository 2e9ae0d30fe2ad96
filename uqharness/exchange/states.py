"""Flight states around a trim, the source's coefficients there, and its derivatives.

The states fill a box around steady flight: angle of attack, sideslip, body rates, deflections and
speed. `Derivatives` are the coefficients of a full quadratic polynomial, fitted to the source over
the box at the trim's speed: terms that a format cannot hold are fitted as well and then left out,
so that they do not bend those that it can hold.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from cachetools import LRUCache, cached

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.units import PSF_PA, SEA_LEVEL_KGPM3
from uqharness.errors import BadInputError
from uqharness.replay import ForcedModel, ReplayFolder, Segment, force_states
from uqharness.simulator import (
    Aircraft,
    SteadyCondition,
    Trim,
    content_hash,
    engine,
    find_trim,
    open_aircraft,
)

VARIABLES = ("alpha", "beta", "p", "q", "r", "de", "da", "dr")
"""Angles [rad], rates pb/2V, qc/2V, rb/2V [-], deflections [deg]: the terms of a derivative."""
SURFACES = ("elevator", "aileron", "rudder")
_HALF_WIDTH = {"alpha": 0.1, "beta": 0.1, "p": 0.05, "q": 0.005, "r": 0.03}
"""Half-widths of the box [rad, -]: gusts and manoeuvres of ordinary flight."""
_SPEED_SHARE, _TRAVEL_SHARE = 0.2, 0.4
_SPEEDS_MPS = np.geomspace(8.0, 260.0, 16)
_ORDINARY_LIFT = 0.5


@dataclass(frozen=True)
class FlightStates:
    """n flight states.

    Attributes
    ----------
    V_mps : ndarray
        (n,) true airspeed [m/s].
    values : Mapping
        `VARIABLES` to (n,) values; rates are reduced by the speed and the lengths below.
    b_m, c_m : float
        Span and chord of the reduced rates.
    """

    V_mps: FloatArray
    values: Mapping[str, FloatArray]
    b_m: float
    c_m: float

    def __len__(self) -> int:
        return len(self.V_mps)

    def reduced_by(self, b_m: float, c_m: float) -> FlightStates:
        """Return the same states with rates reduced by other lengths."""
        factor = {"p": b_m / self.b_m, "q": c_m / self.c_m, "r": b_m / self.b_m}
        values = {name: value * factor.get(name, 1.0) for name, value in self.values.items()}
        return FlightStates(self.V_mps, values, b_m, c_m)


def air_velocity(states: FlightStates, place_m: Sequence[float] | FloatArray) -> FloatArray:
    """Return the velocity (3, n) of a point of the turning body through the air, over the speed.

    ``place_m`` counts from the centre of gravity; forward, right, down.
    """
    value = states.values
    alpha, beta = value["alpha"], value["beta"]
    air = np.stack([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    lengths = np.array([states.b_m, states.c_m, states.b_m])
    turn = 2.0 * np.column_stack([value[v] for v in "pqr"]) / lengths
    return np.asarray(air + np.cross(turn, np.asarray(place_m)).T)


@dataclass(frozen=True)
class Reference:
    """What a format needs besides the coefficients.

    Attributes
    ----------
    S_m2, b_m, c_m : float
        Wing area, span, chord.
    mass_kg : float
        Mass.
    inertia_kgm2 : ndarray
        (3, 3) about the CG, body axes; the element (0, 2) is -Ixz.
    throw_deg : Mapping
        Surface to its largest deflection [deg].
    """

    S_m2: float
    b_m: float
    c_m: float
    mass_kg: float
    inertia_kgm2: FloatArray
    throw_deg: Mapping[str, float]


@dataclass(frozen=True)
class Derivatives:
    """A coefficient's polynomial: constant, linear and quadratic terms.

    ``terms`` maps "0", a variable, or two variables joined by "*" to its value per rad, per reduced
    rate, per degree.
    """

    terms: Mapping[str, float]

    def at(self, values: Mapping[str, float]) -> float:
        """Return the polynomial's value; variables that are not named are 0."""
        return float(self._sum(values))

    def over(self, states: FlightStates) -> FloatArray:
        """Return the polynomial's values at n states."""
        return np.asarray(self._sum(states.values))

    def _sum(self, values: Mapping[str, Any]) -> Any:
        """Return the sum of the terms at numbers or arrays."""
        total = self.terms["0"]
        for name, factor in self.terms.items():
            if name != "0":
                total = total + factor * math.prod(values.get(v, 0.0) for v in name.split("*"))
        return total

    def tangent(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the linear function that touches the polynomial at these values.

        "0" is its constant, each variable its slope.
        """
        slopes = {}
        for variable in VARIABLES:
            slope = self.terms[variable]
            for other in VARIABLES:
                pair = "*".join(sorted((variable, other), key=VARIABLES.index))
                double = 2.0 if other == variable else 1.0
                slope += double * self.terms[pair] * values.get(other, 0.0)
            slopes[variable] = slope
        constant = self.at(values) - sum(slopes[v] * values.get(v, 0.0) for v in VARIABLES)
        return {"0": constant, **slopes}


@dataclass(frozen=True)
class SourceModel:
    """The source: an aircraft whose coefficients can be evaluated at any state.

    Attributes
    ----------
    aircraft : Aircraft
        The aircraft.
    trim : Trim
        Steady flight in the middle of the box.
    properties : Mapping
        JSBSim properties in force, such as those of an epistemic member.
    reference : Reference
        Geometry, mass and throws.
    """

    aircraft: Aircraft
    trim: Trim
    reference: Reference
    properties: Mapping[str, float] = field(default_factory=dict)

    @property
    def controls(self) -> dict[str, float]:
        """Return the trim's controls as flight records have them: degrees, percent."""
        model = _folder_of(self.aircraft).model
        commands = self.trim.controls
        return {name: model.to_record(name, commands.get(name, 0.0)) for name in model.controls}

    @property
    def middle(self) -> dict[str, float]:
        """Return the trim's values of `VARIABLES`."""
        deflections, controls = ("de", "da", "dr"), self.controls
        values = {d: controls.get(s, 0.0) for d, s in zip(deflections, SURFACES, strict=True)}
        return {"alpha": self.trim.alpha_rad, **values}

    def full(self, control: str) -> tuple[float, float]:
        """Return the ends of a control's travel in degrees or percent, in its property's order."""
        model = _folder_of(self.aircraft).model
        low, high = (model.to_record(control, x) for x in model.card.inputs[control].limits)
        return low, high

    def coefficients(self, states: FlightStates) -> FloatArray:
        """Return CX CY CZ Cl Cm Cn of the aerodynamics (n, 6), body axes at the CG."""
        return self._forced(states).coefficients

    def thrust(self, throttle: float | None = None) -> tuple[float, float]:
        """Return the force forward [N] and the moment about the forward axis [N m] of the engines.

        At the trim's speed and angle of attack, and its throttle unless another one is given [%].
        """
        middle = self.middle
        values = {name: np.full(1, middle.get(name, 0.0)) for name in VARIABLES}
        states = FlightStates(np.array([self.trim.condition.V_mps]), values, 1.0, 1.0)
        forced = self._forced(states, throttle)
        return float(forced.other_force[0, 0]), float(forced.other_moment[0, 0])

    def _forced(self, states: FlightStates, throttle: float | None = None) -> ForcedModel:
        """Impose the states, at the trim's throttle unless another one is given [%]."""
        model, n = _folder_of(self.aircraft).model, len(states)
        if throttle is None:
            throttle = self.controls.get("throttle", 0.0)
        columns = {
            "elevator": states.values["de"],
            "aileron": states.values["da"],
            "rudder": states.values["dr"],
            "throttle": np.full(n, throttle),
        }
        rate = 2.0 * states.V_mps
        motion = {
            "V_mps": states.V_mps,
            "alpha_rad": states.values["alpha"],
            "beta_rad": states.values["beta"],
            "phi_rad": np.zeros(n),
            "theta_rad": states.values["alpha"],
            "p_radps": states.values["p"] * rate / states.b_m,
            "q_radps": states.values["q"] * rate / states.c_m,
            "r_radps": states.values["r"] * rate / states.b_m,
        }
        segment = Segment(
            "states",
            "export",
            self.aircraft.dt_s * np.arange(2.0),
            np.zeros((2, len(model.controls))),
            np.zeros(9),
            self.trim.condition.altitude_m,
            0.0,
        )
        controls = np.column_stack([columns[name] for name in model.controls])
        return force_states(model, segment, motion, controls, self.properties)


def source_model(
    aircraft: Aircraft,
    speed_mps: float | None = None,
    properties: Mapping[str, float] | None = None,
) -> SourceModel:
    """Return the source model around a trim.

    Parameters
    ----------
    aircraft : Aircraft
        With a card.
    speed_mps : float, optional
        True airspeed of the trim; by default the geometric middle of the speeds that trim.
    properties : Mapping, optional
        JSBSim properties in force.

    Raises
    ------
    BadInputError
        If the aircraft does not trim.
    """
    in_force = dict(properties or {})
    trim = _trim(aircraft, speed_mps, in_force)
    zero = {name: np.zeros(1) for name in VARIABLES}
    one = FlightStates(np.array([trim.condition.V_mps]), zero, 1.0, 1.0)
    source = SourceModel(aircraft, trim, Reference(1.0, 1.0, 1.0, 1.0, np.eye(3), {}), in_force)
    mass = source._forced(one).mass
    throws = {s: max(map(abs, source.full(s))) for s in SURFACES if s in aircraft.card.inputs}
    reference = Reference(mass.S, mass.b, mass.c, mass.mass, np.asarray(mass.inertia), throws)
    return replace(source, reference=reference)


@cached(LRUCache(4), key=content_hash)
def _folder_of(aircraft: Aircraft) -> ReplayFolder:
    """Return the copy of an aircraft that is evaluated; commands pass at once.

    A lag would depend on the state before.
    """
    controls = [name for name in (*SURFACES, "throttle") if name in aircraft.card.inputs]
    return ReplayFolder(aircraft, controls, ideal=controls)


def _trim(aircraft: Aircraft, speed_mps: float | None, properties: Mapping[str, float]) -> Trim:
    """Return a trim at the speed, or at the middle of the speeds that trim."""
    if speed_mps is not None:
        trim = find_trim(aircraft, SteadyCondition(speed_mps, 200.0, properties=properties))
        if not trim.converged:
            raise BadInputError(
                f"{aircraft.name}: no trim at {speed_mps:g} m/s: {trim.reason}; choose another"
                " --speed-mps"
            )
        return trim

    def trim_at(k: int) -> Trim | None:
        if not 0 <= k < len(_SPEEDS_MPS):
            return None
        condition = SteadyCondition(float(_SPEEDS_MPS[k]), 200.0, properties=properties)
        trim = find_trim(aircraft, condition, explains=False)
        return trim if trim.converged else None

    # Begin at an ordinary lift coefficient: speeds that do not trim take the longest.
    fdm = open_aircraft(aircraft)
    engine.run_ic(fdm)
    loading = float(fdm["inertia/weight-lbs"]) / max(float(fdm["metrics/Sw-sqft"]), 1e-9)
    ordinary = math.sqrt(2.0 * loading * PSF_PA / SEA_LEVEL_KGPM3 / _ORDINARY_LIFT)
    order = np.argsort(np.abs(np.log(_SPEEDS_MPS / ordinary)))
    start, first = next(((k, t) for k in order.tolist() if (t := trim_at(k))), (0, None))
    trims = [] if first is None else [first]
    for step in (1, -1):
        k = start + step
        while trims and (neighbour := trim_at(k)) is not None:
            trims.append(neighbour)
            k += step
    trims.sort(key=lambda t: t.condition.V_mps)
    if not trims:
        raise BadInputError(
            f"{aircraft.name}: trims at no speed from {_SPEEDS_MPS[0]:.0f} to"
            f" {_SPEEDS_MPS[-1]:.0f} m/s; `uqharness modes` says why at one speed"
        )
    return trims[len(trims) // 2]


def box(source: SourceModel, n: int, seed: int = 0, spread: bool = True) -> FlightStates:
    """Return n random states in the box around the source's trim; see `box_around`."""
    return box_around(source.reference, source.middle, source.trim, n, seed, spread)


def box_around(
    reference: Reference,
    middle: Mapping[str, float],
    trim: Trim | None,
    n: int,
    seed: int = 0,
    spread: bool = True,
) -> FlightStates:
    """Return n random states in a box.

    Parameters
    ----------
    reference : Reference
        Lengths of the reduced rates, and throws of the surfaces.
    middle : Mapping
        `VARIABLES` to the middle of the box; 0 where they are not named.
    trim : Trim or None
        Its speed; None takes 20 m/s.
    n, seed : int
        Number of states, and seed of the draw.
    spread : bool
        Whether the speed varies, too, by 20 % either way.
    """
    rng = np.random.default_rng(seed)
    values = {
        name: middle.get(name, 0.0) + half_width * rng.uniform(-1.0, 1.0, n)
        for name, half_width in _HALF_WIDTH.items()
    }
    for name, surface in zip(("de", "da", "dr"), SURFACES, strict=True):
        throw = reference.throw_deg.get(surface, 0.0)
        spread_deg = _TRAVEL_SHARE * throw * rng.uniform(-1.0, 1.0, n)
        values[name] = np.clip(middle.get(name, 0.0) + spread_deg, -throw, throw)
    speed = np.full(n, 20.0 if trim is None else trim.condition.V_mps)
    if spread:
        speed = speed * (1.0 + _SPEED_SHARE * rng.uniform(-1.0, 1.0, n))
    return FlightStates(speed, values, reference.b_m, reference.c_m)


def order_dependence(source: SourceModel, states: FlightStates, n: int = 12) -> float:
    """Return how far coefficients depend on the states evaluated before, over their variation.

    0 but for control systems with filters or integrators, whose surfaces keep a memory.
    """
    orders = np.arange(min(n, len(states))), np.arange(min(n, len(states)))[::-1]
    forward, backward = (
        source.coefficients(
            replace(
                states,
                V_mps=states.V_mps[order],
                values={name: value[order] for name, value in states.values.items()},
            )
        )
        for order in orders
    )
    difference = np.abs(forward - backward[::-1]).max(axis=0)
    return float((difference / np.maximum(forward.std(axis=0), 1e-9)).max())


def derivatives(source: SourceModel, n: int = 600, seed: int = 1) -> dict[str, Derivatives]:
    """Return the quadratic polynomial of each body-axis coefficient around the trim's speed.

    Also of lift and drag, CL and CD, in the axes of the angle of attack: CL = CX sin(alpha) - CZ
    cos(alpha), CD = -CX cos(alpha) - CZ sin(alpha).
    """
    states = box(source, n, seed, spread=False)
    body = source.coefficients(states)
    lift, drag = lift_and_drag(body, states.values["alpha"])
    columns = {name: body[:, k] for k, name in enumerate(COEFFICIENTS)} | {"CL": lift, "CD": drag}
    return {name: polynomial(states, values) for name, values in columns.items()}


def lift_and_drag(body: FloatArray, alpha: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return CL and CD of body-axis coefficients (n, 6)."""
    cx, cz = body[:, 0], body[:, 2]
    return (
        cx * np.sin(alpha) - cz * np.cos(alpha),
        -cx * np.cos(alpha) - cz * np.sin(alpha),
    )


def polynomial(states: FlightStates, values: FloatArray) -> Derivatives:
    """Fit a full quadratic polynomial by least squares."""
    names = ["0", *VARIABLES]
    columns = [np.ones(len(states)), *(states.values[name] for name in VARIABLES)]
    for a, b in itertools.combinations_with_replacement(VARIABLES, 2):
        names.append(f"{a}*{b}")
        columns.append(states.values[a] * states.values[b])
    matrix = np.column_stack(columns)
    # Columns of one size: deflections are in degrees, rates a few thousandths.
    scale = np.maximum(np.abs(matrix).max(axis=0), 1e-30)
    solution = np.linalg.lstsq(matrix / scale, values, rcond=1e-12)[0] / scale
    return Derivatives(dict(zip(names, solution.tolist(), strict=True)))


# Lift line and drag polar, as stability-axis formats hold them.
#
# Over the box of angles of attack the lift coefficient is a line in alpha, and the drag
# coefficient a parabola in the lift coefficient, both by least squares.

_ALPHA_HALF_WIDTH_RAD = 0.1
_NO_INDUCED_DRAG = 1e9


@dataclass(frozen=True)
class LiftDrag:
    """CL = lift_0 + lift_alpha alpha; CD = drag_0 + induced CL^2.

    Attributes
    ----------
    lift_0, lift_alpha : float
        Constant [-] and slope [1/rad].
    drag_0, induced : float
        Drag without lift [-], and the factor of CL^2 [-].
    """

    lift_0: float
    lift_alpha: float
    drag_0: float
    induced: float

    def oswald(self, aspect_ratio: float) -> float:
        """Return Oswald's factor: induced = 1 / (pi e AR); very large without induced drag."""
        if self.induced <= 0.0:
            return _NO_INDUCED_DRAG
        return 1.0 / (math.pi * aspect_ratio * self.induced)


def lift_drag(source: SourceModel, lift: Derivatives, drag: Derivatives) -> LiftDrag:
    """Fit lift line and drag polar to the source's CL and CD at the trim's controls of zero rates.

    Deflections are 0: their lift and drag are terms of their own.
    """
    alphas = source.trim.alpha_rad + _ALPHA_HALF_WIDTH_RAD * np.linspace(-1.0, 1.0, 41)
    lifts = np.array([lift.at({"alpha": float(a)}) for a in alphas])
    drags = np.array([drag.at({"alpha": float(a)}) for a in alphas])
    slope, constant = np.polyfit(alphas, lifts, 1)
    # CD over CL^2 of the line, which is what the formats compute.
    squares = (constant + slope * alphas) ** 2
    induced, drag_0 = np.polyfit(squares, drags, 1)
    if induced <= 0.0:
        # Drag that falls with lift has no Oswald factor; the loss shows what that costs.
        induced, drag_0 = 0.0, float(drags.mean())
    return LiftDrag(float(constant), float(slope), float(drag_0), float(induced))
