"""Test points tried on the model: flown in simulation, refused where they leave what may be flown,
measured by what they tell.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np

from sysid.aerodynamics import Cutoffs, Residuals
from sysid.arrays import FloatArray
from sysid.errors import LogError
from uqharness.errors import BadInputError
from uqharness.files import scratch_folder
from uqharness.flight import (
    DEFAULT_TURBULENCE_SOURCE,
    FlightSpec,
    recorded_flight,
    two_seeds,
    write_record,
)
from uqharness.next_flight.points import (
    AUTOPILOT,
    MOST_LOSS_M,
    RECOVERY_S,
    TestPoint,
    schedule,
    script_text,
)
from uqharness.replay import flight_residuals, prediction_of, read_bounds_flights
from uqharness.simulator import (
    Aircraft,
    SteadyCondition,
    find_trim,
    linearise,
    modes,
    open_aircraft,
    read_script,
)
from uqharness.simulator import aircraft as properties

WIDER = 0.5
"""A state may leave what has been flown by this share of its range: flight tests go on step by
step.
"""
_FALLBACK_UNIT_S = 0.5
_PEAK = 2.331122


@dataclass(frozen=True)
class TestFlight:
    """How test flights are flown: aircraft, mission script, what holds it, and the air and noise
    they meet.

    begin_s: when the first transition may begin. ``rate_hz`` of the record.
    """

    aircraft: Aircraft
    mission: Path
    has_autopilot: bool
    begin_s: float
    turbulence: str = "none"
    noise: bool = True
    rate_hz: float = 50.0
    turbulence_source: str = DEFAULT_TURBULENCE_SOURCE

    __test__ = False


@dataclass(frozen=True)
class Trial:
    """A test point as flown: states name -> (n,), filtered as the bounds' data are, and what noise
    and air left, delta (n, 6).
    """

    point: TestPoint
    states: Mapping[str, FloatArray]
    delta: FloatArray


@dataclass(frozen=True)
class Refused:
    """A test point that may not be flown, and why."""

    point: TestPoint
    reason: str


def has_autopilot(aircraft: Aircraft) -> bool:
    """Whether the aircraft has this project's autopilot."""
    manager = open_aircraft(aircraft).get_property_manager()
    return all(manager.hasNode(name) for name in AUTOPILOT)


def has_noise(aircraft: Aircraft) -> bool:
    """Whether the aircraft has the sensors that ``noise`` asks for."""
    return bool(open_aircraft(aircraft).get_property_manager().hasNode("sensor/V-mps"))


def unit_times(aircraft: Aircraft, speed_mps: float, altitude_m: float) -> dict[str, float]:
    """Seconds of one unit by control, from the model's own modes: a doublet then has most of its
    power where the mode answers.

    The spectrum of a doublet of half width T, (4/w) sin^2(wT/2), is largest at tan(wT/2) = wT, wT =
    2.33. The elevator follows the short period, aileron and rudder the dutch roll. 0.5 s for a
    model that cannot be trimmed at that speed."""
    found: dict[str, float] = {}
    try:
        trim = find_trim(aircraft, SteadyCondition(speed_mps, altitude_m))
        if trim.converged:
            found = {m.name: abs(complex(m.real, m.imag)) for m in modes(linearise(aircraft, trim))}
    except (BadInputError, ArithmeticError, ValueError, np.linalg.LinAlgError):
        pass
    pitch, yaw = (
        (
            float(f"{min(max(_PEAK / found[m], 0.2), 3.0):.1g}")
            if found.get(m, 0.0) > 0.0
            else _FALLBACK_UNIT_S
        )
        for m in ("short_period", "dutch_roll")
    )
    return {"elevator": pitch, "aileron": yaw, "rudder": yaw, "throttle": round(3.0 * pitch, 1)}


def fly_points(
    flight: TestFlight, points: Sequence[TestPoint], seed: int, path: Path
) -> tuple[bool, float, str]:
    """Fly the points, write the record; whether it ended well, how long it flew, and why it
    ended.
    """
    script = path.with_suffix(".xml")
    text = script_text(
        flight.mission,
        flight.aircraft,
        points,
        flight.begin_s,
        flight.has_autopilot,
        path.stem,
        "Test points",
    )
    script.write_bytes(text)
    return fly_script(flight, script, seed, path)


def fly_script(
    flight: TestFlight, script: Path, seed: int, path: Path, duration_s: float | None = None
) -> tuple[bool, float, str]:
    """The same for a script that is written already, or its first seconds."""
    read = read_script(script)
    turbulence, noise = two_seeds(seed)
    spec = FlightSpec(
        aircraft=flight.aircraft.folder,
        script=script,
        duration_s=duration_s or read.end_s,
        turbulence=flight.turbulence,
        turbulence_source=flight.turbulence_source,
        sensor_noise=flight.noise,
        seed_turbulence=turbulence,
        seed_noise=noise,
        properties=dict(properties.SECOND_ORDER),
        record_rate_hz=flight.rate_hz,
    )
    record, recorded = recorded_flight(flight.aircraft, read, spec)
    write_record(record, path)
    return recorded.status == "ok", recorded.flown_s, recorded.reason


def residuals_of(aircraft: Aircraft, paths: Sequence[Path], cutoffs: Cutoffs) -> list[Residuals]:
    """Residual coefficients of records, one a record. Raises BadInputError."""
    arm = aircraft.accelerometer_m
    flights, measured = read_bounds_flights(paths, aircraft)
    with prediction_of(aircraft, measured) as pair:
        return [flight_residuals(pair, f, arm, cutoffs) for f in flights]


def try_points(
    flight: TestFlight,
    points: Sequence[TestPoint],
    allowed: Mapping[str, tuple[float, float]],
    cutoffs: Cutoffs,
    seed: int,
) -> tuple[list[Trial], list[Refused]]:
    """Fly every point once, those of a condition in one flight. A point at which a flight ends is
    refused, the rest flown again.

    allowed: state -> smallest and largest value that a point, with its recovery, may reach.
    """
    trials: list[Trial] = []
    refused: list[Refused] = []
    with scratch_folder() as scratch:
        for number, (_, group) in enumerate(groupby(points, key=lambda p: p.condition)):
            left, again = list(group), 0
            while left:
                path = scratch.path / f"trial-{number}-{again}.parquet"
                again += 1
                ok, flown_s, reason = fly_points(flight, left, seed + number, path)
                timed, _ = schedule(left, flight.begin_s)
                done = [t for t in timed if ok or t.end_s + RECOVERY_S <= flown_s]
                ended = [] if ok else left[len(done) : len(done) + 1]
                good, bad = _judged(path, [(t.point, t.start_s, t.end_s) for t in done], allowed)
                refused += bad + [Refused(p, f"the flight ends: {reason}") for p in ended]
                if good:
                    trials += _measured(flight.aircraft, path, good, cutoffs)
                left = left[len(done) + len(ended) :]
    return trials, refused


def _judged(
    path: Path,
    points: Sequence[tuple[TestPoint, float, float]],
    allowed: Mapping[str, tuple[float, float]],
) -> tuple[list[TestPoint], list[Refused]]:
    import pandas as pd

    frame = pd.read_parquet(path)
    good: list[TestPoint] = []
    bad: list[Refused] = []
    for point, start_s, end_s in points:
        rows = frame[(frame["time_s"] >= start_s) & (frame["time_s"] <= end_s + RECOVERY_S)]
        reason = ""
        if "h_m" in rows and float(rows["h_m"].iloc[0] - rows["h_m"].min()) > MOST_LOSS_M:
            reason = (
                f"it loses {float(rows['h_m'].iloc[0] - rows['h_m'].min()):.0f} m, allowed are"
                f" {MOST_LOSS_M:g}"
            )
        for state, (low, high) in allowed.items():
            values = rows[state].to_numpy()
            if reason:
                break
            # Single samples are the sensors' noise.
            least, most = np.percentile(values, [1.0, 99.0])
            if least < low or most > high:
                reason = (
                    f"{state} reaches {least if least < low else most:.3g}, allowed are {low:.3g}"
                    f" to {high:.3g}"
                )
                break
        if reason:
            bad.append(Refused(point, reason))
        else:
            good.append(point)
    return good, bad


def _measured(
    aircraft: Aircraft, path: Path, points: Sequence[TestPoint], cutoffs: Cutoffs
) -> list[Trial]:
    try:
        (residuals,) = residuals_of(aircraft, [path], cutoffs)
    except LogError as error:
        raise BadInputError(str(error)) from None
    out = []
    for point in points:
        pieces = [p for p in residuals.pieces if p.label == point.name]
        if pieces:
            names = [n for n in pieces[0].states if all(n in p.states for p in pieces)]
            states = {n: np.concatenate([p.states[n] for p in pieces]) for n in names}
            out.append(Trial(point, states, np.concatenate([p.delta for p in pieces])))
    return out


def sorted_points(points: Sequence[TestPoint]) -> list[TestPoint]:
    """Points of one condition together, conditions in the order of first choice."""
    conditions = list(dict.fromkeys(p.condition for p in points))
    return sorted(points, key=lambda p: conditions.index(p.condition))
