"""Performance of an aircraft from its coefficients: stall, glide, climb, ceiling, turn.

The trimmed polar (the elevator balances Cm at every alpha) and the thrust at full throttle are read
from the model in JSBSim; the figures follow from point performance (J. D. Anderson, Aircraft
Performance and Design, chapters 5 and 6). Thrust acts along the flight path, climb angles are
small, the polar does not depend on altitude.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sysid.arrays import FloatArray
from sysid.units import G0_MPS2, RAD_DEG
from uqharness.exchange import (
    VARIABLES,
    FlightStates,
    SourceModel,
    lift_and_drag,
    source_model,
)
from uqharness.replay import ReplayFolder, Segment, force_states
from uqharness.simulator import Aircraft

_LOWEST_ALPHA_DEG = -4.0
_ALTITUDES_M = np.arange(0.0, 16_001.0, 500.0)
_UNITS = {
    "stall_speed": "m/s",
    "best_glide_ratio": "1",
    "best_glide_speed": "m/s",
    "least_sink_rate": "m/s",
    "least_sink_speed": "m/s",
    "climb_rate": "m/s",
    "climb_speed": "m/s",
    "greatest_speed": "m/s",
    "turn_rate": "deg/s",
    "turn_radius": "m",
    "ceiling": "m",
}


@dataclass(frozen=True)
class Polar:
    """Trimmed polar: alpha [rad], CL and CD (n,), in order of alpha up to the stall."""

    alpha: FloatArray
    cl: FloatArray
    cd: FloatArray


@dataclass(frozen=True)
class Sheet:
    """Figures by name (NaN where undefined, with a reason), and the rows against speed."""

    figures: Mapping[str, float]
    reasons: Mapping[str, str]
    rows: Sequence[Mapping[str, float]] = field(default=())


def _thrust_at(thrust: FloatArray, grid: FloatArray, speed: FloatArray) -> FloatArray:
    """Return thrust [N] at speeds, interpolated over the grid."""
    return np.asarray(np.interp(speed, grid, thrust))


def sheet(
    polar: Polar,
    weight_N: float,
    S_m2: float,
    rho: float,
    speeds: FloatArray,
    thrust_N: FloatArray,
) -> Sheet:
    """Compute the figures at one altitude.

    Parameters
    ----------
    polar : Polar
        Its largest CL is that of the stall.
    weight_N, S_m2, rho : float
        Weight, reference area and air density [kg/m3].
    speeds, thrust_N : array (m,)
        Full-throttle thrust over true airspeed.

    Returns
    -------
    Sheet
        Without the ceiling.

    Examples
    --------
    >>> cl = np.linspace(0.0, 1.2, 2401)
    >>> polar = Polar(cl / 5.0, cl, 0.03 + 0.05 * cl**2)
    >>> v = np.array([0.0, 100.0])
    >>> out = sheet(polar, 20.0, 0.35, 1.225, v, np.array([10.0, 0.0]))
    >>> round(out.figures["best_glide_ratio"], 3)  # 1 / (2 sqrt(0.03 0.05))
    12.91
    """
    figures = dict.fromkeys(_UNITS, math.nan)
    reasons: dict[str, str] = {}
    # Level flight: each lift coefficient has its speed, and its drag is the thrust required.
    lifts = polar.cl > 1e-3
    if not np.any(lifts):
        return Sheet(figures, dict.fromkeys(_UNITS, "no lift below the stall"))
    alpha, cl, cd = (a[lifts] for a in (polar.alpha, polar.cl, polar.cd))
    speed = np.sqrt(2.0 * weight_N / (rho * S_m2 * cl))
    drag = weight_N * cd / cl
    figures["stall_speed"] = float(np.min(speed))
    ratio = cl / cd
    # Best glide: largest lift over drag.
    glide = int(np.argmax(ratio))
    figures["best_glide_ratio"], figures["best_glide_speed"] = (
        float(ratio[glide]),
        float(speed[glide]),
    )
    # Least sink: least power required.
    sink = drag * speed / weight_N
    index = int(np.argmin(sink))
    figures["least_sink_rate"], figures["least_sink_speed"] = (
        float(sink[index]),
        float(speed[index]),
    )
    # Climb: excess power over weight.
    available = _thrust_at(thrust_N, speeds, speed)
    climb = speed * (available - drag) / weight_N
    best = int(np.argmax(climb))
    if np.max(available) <= 0.0:
        for name in ("climb_rate", "climb_speed", "greatest_speed", "turn_rate", "turn_radius"):
            reasons[name] = "no thrust"
    else:
        figures["climb_rate"], figures["climb_speed"] = float(climb[best]), float(speed[best])
        # Greatest speed: the fastest at which full throttle holds level flight.
        fast = np.linspace(figures["stall_speed"], float(speeds[-1]), 2000)
        required = np.interp(
            2.0 * weight_N / (rho * S_m2 * fast**2), np.sort(cl), cd[np.argsort(cl)]
        )
        excess = _thrust_at(thrust_N, speeds, fast) - 0.5 * rho * fast**2 * S_m2 * required
        level = np.flatnonzero(excess >= 0.0)
        if level.size:
            figures["greatest_speed"] = float(fast[level[-1]])
            _turn(figures, fast, cl, cd, weight_N, S_m2, rho=rho, speeds=speeds, thrust_N=thrust_N)
        else:
            for name in ("greatest_speed", "turn_rate", "turn_radius"):
                reasons[name] = "full throttle does not hold level flight"
    order = np.argsort(speed)
    picked = order[np.linspace(0, len(order) - 1, min(len(order), 25)).astype(int)]
    rows = [
        {
            "V_mps": float(speed[i]),
            "lift_to_drag": float(ratio[i]),
            "drag_N": float(drag[i]),
            "thrust_N": float(available[i]),
            "climb_mps": float(climb[i]),
            "alpha_deg": float(alpha[i]) * RAD_DEG,
        }
        for i in picked
        if speed[i] <= 4.0 * figures["stall_speed"]
    ]
    return Sheet(figures, reasons, rows)


def _turn(
    figures: dict[str, float],
    fast: FloatArray,
    cl: FloatArray,
    cd: FloatArray,
    weight_N: float,
    S_m2: float,
    *,
    rho: float,
    speeds: FloatArray,
    thrust_N: FloatArray,
) -> None:
    """Add the fastest sustained level turn: thrust balances drag at the turn's lift."""
    pressure = 0.5 * rho * fast**2 * S_m2
    affordable = _thrust_at(thrust_N, speeds, fast) / pressure
    # The largest CL whose drag the thrust balances, at each speed.
    allowed = np.where(cd[None, :] <= affordable[:, None], cl[None, :], 0.0).max(axis=1)
    load = allowed * pressure / weight_N
    rate = G0_MPS2 * np.sqrt(np.maximum(load**2 - 1.0, 0.0)) / fast
    best = int(np.argmax(rate))
    if rate[best] > 0.0:
        figures["turn_rate"] = float(rate[best]) * RAD_DEG
        figures["turn_radius"] = float(fast[best] / rate[best])


@dataclass(frozen=True)
class Performance:
    """Performance of an aircraft.

    Attributes
    ----------
    source : SourceModel
        The aircraft at its trim.
    nominal : Sheet
        Without increments.
    intervals : mapping of str to (low, high)
        Over the corners of CX, CZ and Cm; NaN without bounds.
    has_bounds : bool
        Whether the aircraft has bounds.
    notes : tuple of str
        Assumptions.
    """

    source: SourceModel
    nominal: Sheet
    intervals: Mapping[str, tuple[float, float]]
    has_bounds: bool
    notes: tuple[str, ...]

    @property
    def units(self) -> Mapping[str, str]:
        """Return the unit of each figure."""
        return _UNITS


def performance(
    aircraft: Aircraft,
    altitude_m: float = 0.0,
    stall_alpha_deg: float = 14.0,
    with_bounds: bool = True,
) -> Performance:
    """Compute the performance of an aircraft.

    Parameters
    ----------
    aircraft : Aircraft
        With a card.
    altitude_m : float
        Altitude above sea level [m].
    stall_alpha_deg : float
        Angle of attack of the stall, where CL has no maximum before.
    with_bounds : bool
        Whether to compute the corners of its model-form bounds.

    Raises
    ------
    BadInputError
        For an aircraft that does not trim.
    """
    source = source_model(aircraft)
    weight = source.reference.mass_kg * G0_MPS2
    polar, stalls = _polar(source, stall_alpha_deg, {})
    speeds = np.linspace(0.3, 6.0, 58) * source.trim.condition.V_mps
    altitudes = np.array([altitude_m, *_ALTITUDES_M[altitude_m < _ALTITUDES_M]])
    thrusts, densities = _thrusts(source, speeds, altitudes)
    cases: list[Mapping[str, float]] = [{}]
    has_bounds = with_bounds and _has_bounds(source)
    if has_bounds:
        names = ("CX", "CZ", "Cm")
        cases += [
            {"uq/active": 1.0}
            | {f"uq/{name}/level": level for name, level in zip(names, levels, strict=True)}
            | {f"uq/{name}/level": 0.5 for name in ("CY", "Cl", "Cn")}
            for levels in itertools.product((0.0, 1.0), repeat=3)
        ]
    sheets = []
    without_drag = 0
    for properties in cases:
        case = polar if not properties else _polar(source, stall_alpha_deg, properties)[0]
        if properties and np.any(case.cd[case.cl > 0.0] <= 0.0):
            # Independent errors of CX and CZ may cancel all drag, which no aeroplane can.
            without_drag += 1
            continue
        one = sheet(
            case, weight, source.reference.S_m2, densities[altitude_m], speeds, thrusts[altitude_m]
        )
        figures, reasons = dict(one.figures), dict(one.reasons)
        _ceiling(
            figures, reasons, case, source, weight, speeds, thrusts=thrusts, densities=densities
        )
        sheets.append(Sheet(figures, reasons, one.rows))
    intervals = {}
    for name in _UNITS:
        values = [one.figures[name] for one in sheets if math.isfinite(one.figures[name])]
        intervals[name] = (
            (min(values), max(values)) if has_bounds and values else (math.nan, math.nan)
        )
    notes = [] if stalls else [f"stall assumed at alpha {stall_alpha_deg:g} deg"]
    if without_drag:
        notes.append(
            f"{without_drag} of {len(cases) - 1} corners have no drag and are left out: the bounds"
            " of CX are wider than its drag"
        )
    undefined = sum(not math.isfinite(s.figures["climb_rate"]) for s in sheets)
    if undefined and has_bounds:
        notes.append(f"{undefined} of {len(sheets)} corners have no lift below the stall")
    return Performance(source, sheets[0], intervals, has_bounds, tuple(notes))


def _states(
    source: SourceModel, values: Mapping[str, FloatArray], speed: FloatArray
) -> FlightStates:
    """Return flight states; variables that are not named are 0."""
    every = {name: values.get(name, np.zeros(len(speed))) for name in VARIABLES}
    return FlightStates(speed, every, source.reference.b_m, source.reference.c_m)


def _polar(
    source: SourceModel, stall_alpha_deg: float, properties: Mapping[str, float]
) -> tuple[Polar, bool]:
    """Return the trimmed polar up to the stall, and whether CL has its maximum there."""
    alpha = np.radians(np.linspace(_LOWEST_ALPHA_DEG, stall_alpha_deg, 121))
    n = len(alpha)
    travel = source.reference.throw_deg.get("elevator", 0.0)
    model = SourceModel(source.aircraft, source.trim, source.reference, dict(properties))
    speed = np.full(2 * n, source.trim.condition.V_mps)
    deflections = np.repeat([0.0, 0.25 * travel], n)
    body = model.coefficients(
        _states(source, {"alpha": np.tile(alpha, 2), "de": deflections}, speed)
    )
    free, moved = body[:n], body[n:]
    slope = (moved - free) / (0.25 * travel) if travel else np.zeros_like(free)
    with np.errstate(divide="ignore", invalid="ignore"):
        elevator = np.where(np.abs(slope[:, 4]) > 1e-9, -free[:, 4] / slope[:, 4], 0.0)
    elevator = np.clip(elevator, -travel, travel)
    lift, drag = lift_and_drag(free + slope * elevator[:, None], alpha)
    top = int(np.argmax(lift))
    keep = slice(0, top + 1)
    return Polar(alpha[keep], lift[keep], drag[keep]), top < n - 1


def _thrusts(
    source: SourceModel, speeds: FloatArray, altitudes_m: FloatArray
) -> tuple[dict[float, FloatArray], dict[float, float]]:
    """Return full-throttle thrust [N] at speeds, and air density [kg/m3], by altitude."""
    aircraft = source.aircraft
    inputs = aircraft.card.inputs
    controls = [name for name in ("throttle",) if name in inputs]
    n = len(speeds) * len(altitudes_m)
    zero_signals = (
        "alpha_rad",
        "beta_rad",
        "phi_rad",
        "theta_rad",
        "p_radps",
        "q_radps",
        "r_radps",
    )
    every = np.tile(speeds, len(altitudes_m))
    motion = {"V_mps": every, **dict.fromkeys(zero_signals, np.zeros(n))}
    with ReplayFolder(aircraft, controls, ideal=controls) as model:
        segment = Segment(
            "thrust",
            "performance",
            aircraft.dt_s * np.arange(2.0),
            np.zeros((2, len(controls))),
            np.zeros(9),
            float(altitudes_m[0]),
            0.0,
        )
        ends = [max(model.to_record(name, x) for x in inputs[name].limits) for name in controls]
        full = np.array([ends] * n)
        forced = force_states(model, segment, motion, full, {}, np.repeat(altitudes_m, len(speeds)))
    thrust = forced.other_force[:, 0].reshape(len(altitudes_m), -1)
    density = (2.0 * forced.qbar / every**2).reshape(len(altitudes_m), -1)[:, -1]
    return (
        {float(h): row for h, row in zip(altitudes_m, thrust, strict=True)},
        {float(h): float(rho) for h, rho in zip(altitudes_m, density, strict=True)},
    )


def _has_bounds(source: SourceModel) -> bool:
    """Return whether the aircraft has the model-form plugin."""
    return any(b"uq/active" in path.read_bytes() for path in source.aircraft.folder.rglob("*.xml"))


def _ceiling(
    figures: dict[str, float],
    reasons: dict[str, str],
    polar: Polar,
    source: SourceModel,
    weight: float,
    speeds: FloatArray,
    *,
    thrusts: Mapping[float, FloatArray],
    densities: Mapping[float, float],
) -> None:
    """Add the altitude at which the best rate of climb falls to zero."""
    before: tuple[float, float] | None = None
    for altitude, thrust in thrusts.items():
        one = sheet(polar, weight, source.reference.S_m2, densities[altitude], speeds, thrust)
        climb = one.figures["climb_rate"]
        if not math.isfinite(climb):
            reasons["ceiling"] = one.reasons.get("climb_rate", "no climb")
            return
        if climb <= 0.0:
            if before is None:
                reasons["ceiling"] = "no climb at this altitude"
            else:
                share = before[1] / (before[1] - climb)
                figures["ceiling"] = before[0] + share * (altitude - before[0])
            return
        before = (altitude, climb)
    reasons["ceiling"] = f"above {_ALTITUDES_M[-1]:g} m"
