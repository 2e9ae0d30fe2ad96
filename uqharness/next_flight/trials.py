"""Try test points on the model.

Each point is simulated with sensor noise and turbulence. A point is refused if the flight ends or a
state leaves its allowed range; otherwise its filtered states say what information it would add, and
its residuals what scatter noise and air alone produce.
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
    turbulence_and_noise_seeds,
    write_record,
)
from uqharness.next_flight.points import (
    AUTOPILOT,
    MAX_HEIGHT_LOSS_M,
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

RANGE_EXTENSION = 0.5
"""Share of its range by which a state may exceed what has been flown: flight tests proceed in
small steps.
"""
_FALLBACK_UNIT_S = 0.5
_DOUBLET_PEAK = 2.331122


@dataclass(frozen=True)
class TestFlight:
    """How test flights are simulated.

    Attributes
    ----------
    aircraft : Aircraft
        Model that flies.
    mission : Path
        Run script that the points are added to.
    has_autopilot : bool
        Whether the aircraft has this project's autopilot.
    begin_s : float
        When the first transition may start.
    turbulence, turbulence_source : str
        Intensity and model of turbulence.
    noise : bool
        Whether sensors have noise.
    rate_hz : float
        Rate of the record.
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
    """A test point as the model flew it.

    Attributes
    ----------
    point : TestPoint
        The point.
    states : mapping
        State -> values (n,), filtered as the data behind the bounds.
    delta : array (n, 6)
        Residual coefficients, which contain noise and gusts only.
    """

    point: TestPoint
    states: Mapping[str, FloatArray]
    delta: FloatArray


@dataclass(frozen=True)
class RefusedPoint:
    """A test point that must not be flown, and the reason."""

    point: TestPoint
    reason: str


def has_autopilot(aircraft: Aircraft) -> bool:
    """Return whether the aircraft has this project's autopilot."""
    # The instance must outlive its manager, or absolute names are not found.
    fdm = open_aircraft(aircraft)
    manager = fdm.get_property_manager()
    return all(manager.hasNode(name) for name in AUTOPILOT)


def has_noise(aircraft: Aircraft) -> bool:
    """Return whether the aircraft has a sensors system."""
    return bool(open_aircraft(aircraft).get_property_manager().hasNode("sensor/V-mps"))


def unit_times(aircraft: Aircraft, speed_mps: float, altitude_m: float) -> dict[str, float]:
    """Choose the duration of one unit of a control's pattern from the modes of the model.

    The spectrum of a doublet of half width T, (4/w) sin^2(wT/2), is largest where tan(wT/2) = wT,
    at wT = 2.33. The elevator excites the short period, aileron and rudder the dutch roll.

    Parameters
    ----------
    aircraft : Aircraft
        Model.
    speed_mps, altitude_m : float
        Condition of the trim.

    Returns
    -------
    dict
        Control -> seconds, between 0.2 and 3; 0.5 s if the model cannot be trimmed.
    """
    frequencies: dict[str, float] = {}
    try:
        # Modes at the trim; a model that cannot be trimmed gets the default.
        trim = find_trim(aircraft, SteadyCondition(speed_mps, altitude_m))
        if trim.converged:
            frequencies = {
                m.name: abs(complex(m.real, m.imag)) for m in modes(linearise(aircraft, trim))
            }
    except (BadInputError, ArithmeticError, ValueError, np.linalg.LinAlgError):
        pass
    pitch, yaw = (
        (
            float(f"{min(max(_DOUBLET_PEAK / frequencies[m], 0.2), 3.0):.1g}")
            if frequencies.get(m, 0.0) > 0.0
            else _FALLBACK_UNIT_S
        )
        for m in ("short_period", "dutch_roll")
    )
    return {"elevator": pitch, "aileron": yaw, "rudder": yaw, "throttle": round(3.0 * pitch, 1)}


def fly_points(
    flight: TestFlight, points: Sequence[TestPoint], seed: int, path: Path
) -> tuple[bool, float, str]:
    """Simulate points and write the record.

    Returns
    -------
    ok : bool
        Whether the flight reached its end.
    flown_s : float
        How long it flew.
    reason : str
        Why it ended.
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
    """Simulate a script, or its first ``duration_s`` seconds; see `fly_points`."""
    read = read_script(script)
    turbulence, noise = turbulence_and_noise_seeds(seed)
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
    """Compute residual coefficients of records, one `Residuals` per record.

    Raises BadInputError if a record cannot be read.
    """
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
) -> tuple[list[Trial], list[RefusedPoint]]:
    """Simulate every point, those of one condition in one flight.

    A point at which a flight ends is refused, and the points after it are flown again.

    Parameters
    ----------
    flight : TestFlight
        How flights are simulated.
    points : sequence of TestPoint
        Grouped by condition.
    allowed : mapping
        State -> smallest and largest value that a point, with its recovery, may reach.
    cutoffs : Cutoffs
        Filters of the residuals.
    seed : int
        Seed of the first flight; later flights use the next ones.

    Returns
    -------
    trials : list of Trial
    refused : list of RefusedPoint
    """
    trials: list[Trial] = []
    refused: list[RefusedPoint] = []
    with scratch_folder() as scratch:
        for number, (_, group) in enumerate(groupby(points, key=lambda p: p.condition)):
            remaining, attempt = list(group), 0
            while remaining:
                path = scratch.path / f"trial-{number}-{attempt}.parquet"
                attempt += 1
                ok, flown_s, reason = fly_points(flight, remaining, seed + number, path)
                timed, _ = schedule(remaining, flight.begin_s)
                # Points whose recovery was complete before the flight ended count as flown.
                done = [t for t in timed if ok or t.end_s + RECOVERY_S <= flown_s]
                # The first point that is not complete ended the flight.
                ended = [] if ok else remaining[len(done) : len(done) + 1]
                accepted, rejected = _check_points(
                    path, [(t.point, t.start_s, t.end_s) for t in done], allowed
                )
                refused += rejected + [RefusedPoint(p, f"the flight ends: {reason}") for p in ended]
                if accepted:
                    trials += _trials_of(flight.aircraft, path, accepted, cutoffs)
                remaining = remaining[len(done) + len(ended) :]
    return trials, refused


def _check_points(
    path: Path,
    points: Sequence[tuple[TestPoint, float, float]],
    allowed: Mapping[str, tuple[float, float]],
) -> tuple[list[TestPoint], list[RefusedPoint]]:
    """Split points by whether they stay within the allowed ranges and do not lose too much
    height.
    """
    import pandas as pd

    frame = pd.read_parquet(path)
    accepted: list[TestPoint] = []
    rejected: list[RefusedPoint] = []
    for point, start_s, end_s in points:
        rows = frame[(frame["time_s"] >= start_s) & (frame["time_s"] <= end_s + RECOVERY_S)]
        reason = ""
        if "h_m" in rows and float(rows["h_m"].iloc[0] - rows["h_m"].min()) > MAX_HEIGHT_LOSS_M:
            reason = (
                f"it loses {float(rows['h_m'].iloc[0] - rows['h_m'].min()):.0f} m, allowed are"
                f" {MAX_HEIGHT_LOSS_M:g}"
            )
        for state, (low, high) in allowed.items():
            values = rows[state].to_numpy()
            if reason:
                break
            # Percentiles instead of extremes: single samples are sensor noise.
            lowest, highest = np.percentile(values, [1.0, 99.0])
            if lowest < low or highest > high:
                reason = (
                    f"{state} reaches {lowest if lowest < low else highest:.3g}, allowed are"
                    f" {low:.3g} to {high:.3g}"
                )
                break
        if reason:
            rejected.append(RefusedPoint(point, reason))
        else:
            accepted.append(point)
    return accepted, rejected


def _trials_of(
    aircraft: Aircraft, path: Path, points: Sequence[TestPoint], cutoffs: Cutoffs
) -> list[Trial]:
    """Compute states and residuals of each point of a record."""
    try:
        (residuals,) = residuals_of(aircraft, [path], cutoffs)
    except LogError as error:
        raise BadInputError(str(error)) from None
    out = []
    for point in points:
        # Segments are labelled with the point's name.
        pieces = [p for p in residuals.pieces if p.label == point.name]
        if pieces:
            names = [n for n in pieces[0].states if all(n in p.states for p in pieces)]
            states = {n: np.concatenate([p.states[n] for p in pieces]) for n in names}
            out.append(Trial(point, states, np.concatenate([p.delta for p in pieces])))
    return out


def sorted_points(points: Sequence[TestPoint]) -> list[TestPoint]:
    """Sort points by condition, conditions in the order of first appearance."""
    conditions = list(dict.fromkeys(p.condition for p in points))
    return sorted(points, key=lambda p: conditions.index(p.condition))
