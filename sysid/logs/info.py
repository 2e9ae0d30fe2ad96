"""Report what a log can be used for: loiter metrics, replay, identification.

`log_info` checks channels, rates and findings of a record for each purpose and gives a reason for
each verdict. It reads no files; `uqharness log info` prints the result.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from sysid.errors import Finding
from sysid.logs.manoeuvres import Manoeuvre, find_manoeuvres
from sysid.record import Boot, FlightRecord, Loiter
from sysid.vocabulary import SURFACES

# Twenty samples a cycle of the short period, which is near 1 Hz for small aircraft.
IDENTIFICATION_MIN_HZ = 20.0
REPLAY_MIN_HZ = 10.0
LOITER_MIN_HZ = 1.0
LOITER_MIN_S = 300.0
MIN_MOVING_DEG = 0.5
_NOT_AEROPLANES = re.compile(
    r"copter|rover|sub\b|quad|hexa|octo|tricopter|helicopter|boat|antenna|blimp|rotary",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Purpose:
    """A purpose (loiter-metrics, replay or identification), whether the log serves it, and the
    reason.
    """

    name: str
    serves: bool
    reason: str


@dataclass(frozen=True)
class LogInfo:
    """The report of `uqharness log info`.

    Attributes
    ----------
    source, dialect, vehicle : str
        File name, format and vehicle.
    duration_s, start_s : float
        Length of the record and its first time, s.
    flight_s : tuple of float or None
        Start and end of free flight, s.
    grid_hz : float
        Rate of the record, Hz.
    rates_hz, channels : mapping
        Logged rate [Hz] and log field of each channel.
    findings : tuple of Finding
        Results of the checks.
    purposes : tuple of Purpose
        Verdict and reason for each purpose.
    manoeuvres : tuple of Manoeuvre
        Manoeuvres detected in the commands.
    loiters : tuple of Loiter
        Commanded circles.
    flights, flight_number : tuple of Boot, int
        Boots of the log, and the one that was read.
    """

    source: str
    dialect: str
    vehicle: str
    duration_s: float
    start_s: float
    flight_s: tuple[float, float] | None
    grid_hz: float
    rates_hz: Mapping[str, float]
    channels: Mapping[str, str]
    findings: tuple[Finding, ...]
    purposes: tuple[Purpose, ...]
    manoeuvres: tuple[Manoeuvre, ...] = ()
    loiters: tuple[Loiter, ...] = ()
    flights: tuple[Boot, ...] = ()
    flight_number: int = 1

    @property
    def serves(self) -> bool:
        """Whether the log serves at least one purpose."""
        return any(p.serves for p in self.purposes)

    def as_dict(self) -> dict[str, Any]:
        """Return a dictionary for JSON."""
        return {
            "source": self.source,
            "dialect": self.dialect,
            "vehicle": self.vehicle,
            "flights": [asdict(boot) for boot in self.flights],
            "flight_number": self.flight_number,
            "duration_s": self.duration_s,
            "start_s": self.start_s,
            "free_flight_s": None if self.flight_s is None else list(self.flight_s),
            "grid_hz": self.grid_hz,
            "channels": {
                n: {"source": self.channels.get(n, ""), "rate_hz": self.rates_hz.get(n)}
                for n in self.channels
            },
            "findings": [f.as_dict() for f in self.findings],
            "manoeuvres": [m.as_dict() for m in self.manoeuvres],
            "loiters": [asdict(loiter) for loiter in self.loiters],
            "purposes": {p.name: {"serves": p.serves, "reason": p.reason} for p in self.purposes},
            "serves": self.serves,
        }


def log_info(record: FlightRecord) -> LogInfo:
    """Evaluate the record of a whole log, as `import_log` returns it.

    Parameters
    ----------
    record : FlightRecord
        Record with its metadata.

    Returns
    -------
    LogInfo
        Purposes with reasons, channels with rates, findings, manoeuvres and loiters.
    """
    meta = record.metadata
    time = record["time_s"]
    flight_s = meta.free_flight_s[0] if meta.free_flight_s else None
    if flight_s is None and meta.dialect in ("record", ""):
        flight_s = float(time[0]), float(time[-1])  # a record holds the part that was flown
    # A log without flight serves no purpose.
    obstacle = _no_flight(record)
    flight = record if flight_s is None else record.between(*flight_s)
    judges = {"loiter-metrics": _loiter, "replay": _replay, "identification": _identification}
    purposes = []
    for name, judge in judges.items():
        serves, reason = (False, obstacle) if obstacle else judge(flight)
        purposes.append(Purpose(name, serves, reason))
    channels = dict(meta.channels) or {n: "column" for n in record.columns if n != "time_s"}
    return LogInfo(
        source=meta.source,
        dialect=meta.dialect,
        vehicle=meta.vehicle,
        duration_s=float(time[-1] - time[0]),
        start_s=float(time[0]),
        flight_s=flight_s,
        grid_hz=1.0 / record.dt_s,
        rates_hz=dict(meta.native_hz) or dict.fromkeys(channels, 1.0 / record.dt_s),
        channels=channels,
        findings=meta.findings,
        purposes=tuple(purposes),
        loiters=meta.loiters,
        flights=meta.flights,
        flight_number=meta.flight_number,
        manoeuvres=() if obstacle else find_manoeuvres(flight),
    )


def no_aeroplane(record: FlightRecord) -> str:
    """Return the message that refuses a log of another kind of vehicle.

    Parameters
    ----------
    record : FlightRecord
        Its metadata names the vehicle.

    Returns
    -------
    str
        "" for an aeroplane, and if the log does not name its vehicle.
    """
    vehicle = record.metadata.vehicle
    return f"no aeroplane: the log is of '{vehicle}'" if _NOT_AEROPLANES.search(vehicle) else ""


def _no_flight(record: FlightRecord) -> str:
    """Return why the log serves no purpose at all; "" if nothing prevents it."""
    meta = record.metadata
    if wrong_vehicle := no_aeroplane(record):
        return wrong_vehicle
    negative = _finding(record, "negative-airspeed")
    no_flight = "" if meta.free_flight_s or meta.dialect in ("record", "") else _phase_text(record)
    vtol = f" ({meta.vehicle})" if "VTOL" in meta.vehicle else ""
    reasons = [r for r in (no_flight and no_flight + vtol, negative) if r]
    return "; ".join(reasons)


def _phase_text(record: FlightRecord) -> str:
    """Return the message about flight phases."""
    return _finding(record, "flight-phase") or "no part of it is free flight"


def _finding(record: FlightRecord, code: str) -> str:
    """Return the message of the first finding with a code; "" if there is none."""
    return next((f.message for f in record.metadata.findings if f.code == code), "")


def _missing(record: FlightRecord, names: tuple[str, ...]) -> list[str]:
    """Return the channels that are absent or never finite."""
    return [n for n in names if n not in record or not np.isfinite(record[n]).any()]


def _rate(record: FlightRecord, names: tuple[str, ...]) -> float:
    """Return the slowest native rate of the channels that exist, Hz."""
    native = record.metadata.native_hz
    return min(
        (native.get(n, 1.0 / record.dt_s) for n in names if n in record), default=float("nan")
    )


def _loiter(record: FlightRecord) -> tuple[bool, str]:
    """Return whether the record serves loiter metrics, and why."""
    path = ("cross_track_m",) if not _missing(record, ("cross_track_m",)) else ("north_m", "east_m")
    missing = _missing(record, (*path, "h_m", "V_mps"))
    if missing:
        return False, f"no {', '.join(missing)}"
    if error := _first_error(record, (*path, "h_m", "V_mps")):
        return False, error
    # The slowest channel limits the resolution of a loiter metric.
    rate = _rate(record, (*path, "h_m", "V_mps"))
    if rate < 0.9 * LOITER_MIN_HZ:
        return (
            False,
            (
                f"the slowest of path, height and speed is logged at {rate:.2g} Hz; at least"
                f" {LOITER_MIN_HZ:g} Hz"
            ),
        )
    loiter_s = _loiter_seconds(record)
    if loiter_s < LOITER_MIN_S:
        return (
            False,
            (
                f"only {loiter_s:.0f} s of circling flight; at least {LOITER_MIN_S:.0f} s give"
                " stable medians"
            ),
        )
    return (
        True,
        (
            f"{loiter_s / 60:.1f} min of circling flight with {', '.join(path)}, height and speed"
            f" at {rate:.1f} Hz"
        ),
    )


def _loiter_seconds(record: FlightRecord) -> float:
    """Return the duration of circling flight, s.

    It is the time in mode LOITER or CIRCLE, else the time on at least three turns of one sense.
    """
    if "mode" in record:
        inside = (record["mode"] == "LOITER") | (record["mode"] == "CIRCLE")
        if inside.any():
            return float(inside.sum() * record.dt_s)
    if "psi_rad" not in record:
        return 0.0
    psi = record["psi_rad"]
    unwrapped = np.unwrap(psi[np.isfinite(psi)])
    if not len(unwrapped) or abs(unwrapped[-1] - unwrapped[0]) < 6 * np.pi:
        return 0.0
    rate = abs(unwrapped[-1] - unwrapped[0]) / (len(unwrapped) * record.dt_s)
    return float(len(unwrapped) * record.dt_s) if rate > 0.02 else 0.0


def _moving(record: FlightRecord) -> list[str]:
    """Return the surfaces that move by more than MIN_MOVING_DEG."""
    spans = {
        n: float(np.nanmax(record[n]) - np.nanmin(record[n]))
        for n in (*SURFACES, *(n.replace("_deg", "_pos_deg") for n in SURFACES))
        if not _missing(record, (n,))
    }
    return [n for n, span in spans.items() if span > MIN_MOVING_DEG]


def _surfaces(record: FlightRecord) -> str:
    """Return why the surfaces cannot be used; "" if they can."""
    positions = {n: n.replace("_deg", "_pos_deg") for n in SURFACES}
    measured = [n for n in SURFACES if not _missing(record, (positions[n],))]
    # Measured positions make the commands unnecessary.
    if len(measured) == len(SURFACES):
        return ""
    missing = [n for n in _missing(record, SURFACES) if n not in measured]
    if len(missing) == len(SURFACES):
        needs = _finding(record, "no-card")
        return f"no surfaces: {needs}" if needs else "no surfaces are logged"
    if not _moving(record):
        return (
            f"the surfaces stand still (less than {MIN_MOVING_DEG} deg); if they are in rad, write"
            " scale = 57.29578 in the map"
        )
    commanded = len(_missing(record, SURFACES)) < len(SURFACES)
    names = missing if commanded or not measured else [positions[n] for n in missing]
    return f"no {', '.join(names)}" if names else ""


def _used_surfaces(record: FlightRecord) -> list[str]:
    """Return the channels that a replay uses: the measured position if there is one, else the
    command.
    """
    positions = {n: n.replace("_deg", "_pos_deg") for n in SURFACES}
    return [n if _missing(record, (positions[n],)) else positions[n] for n in SURFACES]


def _first_error(record: FlightRecord, channels: Iterable[str]) -> str:
    """Return the first error of these channels and name the others; "" without errors."""
    used = {*channels, "time_s"}
    errors = [f for f in record.metadata.findings if f.severity == "error" and f.channel in used]
    other_channels = list(
        dict.fromkeys(f.channel for f in errors[1:] if f.channel != errors[0].channel)
    )
    return (
        errors[0].message
        + (f"; errors also of {', '.join(other_channels)}" if other_channels else "")
        if errors
        else ""
    )


def _lacks(record: FlightRecord, missing: list[str]) -> str:
    """Return all that is missing as one sentence; "" if nothing is."""
    return "; ".join(
        filter(None, (f"no {', '.join(missing)}" if missing else "", _surfaces(record)))
    )


def _replay(record: FlightRecord) -> tuple[bool, str]:
    """Return whether the record serves a replay, and why."""
    needed = ("V_mps", "phi_rad", "theta_rad", "p_radps", "q_radps", "r_radps", "h_m")
    missing = _missing(record, (*needed, "throttle_pct"))
    if reason := _lacks(record, missing):
        return False, reason
    # A channel that the replay uses must have no error.
    used = (*needed, "alpha_rad", "beta_rad", "psi_rad", "throttle_pct", *_used_surfaces(record))
    if error := _first_error(record, used):
        return False, error
    rate = _rate(record, (*SURFACES, "p_radps", "q_radps", "r_radps"))
    if rate < 0.75 * REPLAY_MIN_HZ:
        return (
            False,
            (
                f"commands and rates come at {rate:.1f} Hz; a replay needs at least"
                f" {REPLAY_MIN_HZ:g} Hz"
            ),
        )
    note = "" if rate >= 20 else "; at this rate fast manoeuvres are blurred"
    return (
        True,
        f"surfaces, throttle, attitude, rates, speed and height at {rate:.1f} Hz or more{note}",
    )


def _identification(record: FlightRecord) -> tuple[bool, str]:
    """Return whether the record serves identification, and why."""
    rates = ("p_radps", "q_radps", "r_radps", "ax_mps2", "ay_mps2", "az_mps2")
    missing = _missing(record, (*rates, "V_mps"))
    if reason := _lacks(record, missing):
        return False, reason
    rate = min(_rate(record, rates), _rate(record, SURFACES))
    if rate < 0.95 * IDENTIFICATION_MIN_HZ:
        return (
            False,
            (
                f"rates, accelerations or surfaces come at {rate:.1f} Hz; at least"
                f" {IDENTIFICATION_MIN_HZ:g} Hz"
            ),
        )
    angles = ("phi_rad", "theta_rad", "alpha_rad", "beta_rad")
    if error := _first_error(record, (*rates, *_used_surfaces(record), "V_mps", *angles)):
        return False, error
    # Estimated angles do not exclude identification, but restrict it to calm air.
    estimates = [n for n in record.metadata.estimates if n in ("alpha_rad", "beta_rad")]
    if estimates:
        note = f"; {' and '.join(estimates)} are estimates: good in calm air only"
    elif _missing(record, ("alpha_rad", "beta_rad")):
        note = "; no alpha or beta: their terms keep the values of --prior FILE, or of the aircraft"
    else:
        note = ""
    return (
        True,
        f"rates, accelerations and surfaces at {rate:.1f} Hz or more, surfaces moving{note}",
    )
