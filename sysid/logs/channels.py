"""Evaluate map entries: one signal from the fields of a raw log, on the times of its message.

`resolve` applies function, scale, offset and table of a `signal_map.Entry`. The module also has
the conversions that several importers share: air data from velocity components, angles onto one
turn, and positions from latitude and longitude.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.errors import Finding, LogError
from sysid.foreign.raw import MessageTable, RawLog
from sysid.logs.sensors import Sensors
from sysid.logs.servo import extrapolating_table
from sysid.logs.signal_map import Derived, Entry, RowSelection, SignalMap
from sysid.logs.time_base import CleanTime, clean
from sysid.record import FlightRecord
from sysid.units import G0_MPS2, SEA_LEVEL_KGPM3

# Air data from velocity components in body axes.

COMPONENTS = ("u_mps", "v_mps", "w_mps")
"""Velocity through the air in body axes (forward, right, down), m/s, as columns of a table."""


def speed_of(u: FloatArray, v: FloatArray, w: FloatArray) -> FloatArray:
    """Return the true airspeed, shape (n,), in the unit of the components."""
    return np.sqrt(u**2 + v**2 + w**2)


def alpha_of(u: FloatArray, w: FloatArray) -> FloatArray:
    """Return the angle of attack, rad, shape (n,); NaN without motion in the plane of symmetry."""
    return np.where((u != 0.0) | (w != 0.0), np.arctan2(w, u), np.nan)


def beta_of(u: FloatArray, v: FloatArray, w: FloatArray) -> FloatArray:
    """Return the sideslip, rad, + with air from the right, shape (n,); NaN without motion."""
    speed = speed_of(u, v, w)
    return np.arcsin(np.divide(v, speed, out=np.full_like(speed, np.nan), where=speed > 0.0))


def components_of(
    speed: FloatArray, alpha: FloatArray, beta: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return u, v, w in the unit of ``speed``, each of shape (n,); alpha and beta in rad.

    Examples
    --------
    >>> u, v, w = components_of(np.array([20.0]), np.array([0.1]), np.array([0.0]))
    >>> float(alpha_of(u, w)[0].round(6))
    0.1
    """
    return (
        speed * np.cos(alpha) * np.cos(beta),
        speed * np.sin(beta),
        speed * np.sin(alpha) * np.cos(beta),
    )


def with_air_data(columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Replace columns u, v, w by V, alpha and beta; existing columns of these names stay."""
    out = {name: values for name, values in columns.items() if name not in COMPONENTS}
    if not all(name in columns for name in COMPONENTS):
        return out
    u, v, w = (np.asarray(columns[name], dtype=np.float64) for name in COMPONENTS)
    with np.errstate(invalid="ignore", over="ignore"):
        air_data = {
            "V_mps": speed_of(u, v, w),
            "alpha_rad": alpha_of(u, w),
            "beta_rad": beta_of(u, v, w),
        }
    return {**air_data, **out}


@dataclass(frozen=True)
class Channel:
    """A signal on its own time stamps, before it is put on the grid of a record.

    Attributes
    ----------
    name, label : str
        Signal, and the log field that it was made from.
    time_s, values : ndarray of shape (n,)
        Increasing times, s, and values in the signal's unit.
    clean : CleanTime
        Which records of the message were used.
    estimate : bool
        True if no sensor measured it.
    raw : ndarray of shape (n,) or None
        Values as logged, to detect integers that wrap; None if several fields are combined.
    """

    name: str
    label: str
    time_s: FloatArray
    values: FloatArray
    clean: CleanTime
    estimate: bool
    raw: FloatArray | None = None

    @property
    def rate_hz(self) -> float:
        """Usual rate, Hz; NaN below two samples."""
        return 1.0 / self.clean.step_s if self.clean.step_s > 0 else float("nan")


class Times:
    """Cleaned time stamps of each message, computed once."""

    def __init__(self, raw: RawLog) -> None:
        self._raw = raw
        self._cleaned: dict[tuple[str, int], CleanTime] = {}

    def of(self, key: tuple[str, int]) -> CleanTime:
        """Return the cleaned times of one message."""
        if key not in self._cleaned:
            self._cleaned[key] = clean(self._raw.messages[key].time_s)
        return self._cleaned[key]


def resolve(
    raw: RawLog, name: str, candidates: tuple[Entry, ...], times: Times, sensors: Sensors
) -> Channel | None:
    """Return the first candidate that the log has with at least two usable samples.

    Parameters
    ----------
    raw : RawLog
        Content of the log.
    name : str
        Signal; a flight mode may have a single sample.
    candidates : tuple of Entry
        Entries of the map in order of preference.
    times : Times
        Cleaned time stamps.
    sensors : Sensors
        Choice among sensor instances.

    Returns
    -------
    Channel or None
        None if the log has no candidate.
    """
    for candidate in candidates:
        entry = sensors.resolve(candidate)
        key = (entry.message, entry.instance or 0)
        table = raw.messages.get(key)
        if table is None or not all(f in table.fields for f in entry.fields):
            continue
        cleaned = times.of(key)
        if int(cleaned.keep.sum()) < (1 if name == "mode" else 2):
            continue
        fields = [_numeric(table, f, entry)[cleaned.keep] for f in entry.fields]
        time_s = table.time_s[cleaned.keep]
        values = _apply(entry, fields, time_s)
        if entry.times is not None:
            values = values * _factor(raw, entry.times, times, time_s)
        # A field of NaN only does not supply the signal; try the next candidate.
        if not np.any(np.isfinite(values)):
            continue
        sensors.note_use(candidate)
        raw_values = fields[0] if len(fields) == 1 else None
        return Channel(name, entry.label, time_s, values, cleaned, entry.estimate, raw_values)
    return None


def _numeric(table: MessageTable, field: str, entry: Entry) -> FloatArray:
    """Return a field as float array; raise LogError for text and arrays."""
    values = table.fields[field]
    if values.dtype == object or values.ndim != 1:
        raise LogError(
            f"{entry.label}: the field {field} holds text or arrays, not numbers; map another field"
        )
    with np.errstate(invalid="ignore"):
        return values.astype(np.float64)


def _factor(
    raw: RawLog, source: tuple[str, str], times: Times, at_s: FloatArray
) -> FloatArray | float:
    """Return the factor of an entry's ``times`` at the times ``at_s``; 1 if the log does not have
    it.
    """
    table = raw.messages.get((source[0], 0))
    if table is None or source[1] not in table.fields:
        return 1.0
    keep = times.of((source[0], 0)).keep
    if table.fields[source[1]].dtype == object:
        raise LogError(
            f"{'.'.join(source)}: this factor holds text, not numbers; name another field in times"
        )
    values = table.fields[source[1]][keep].astype(np.float64)
    is_usable = np.isfinite(values) & (values > 0.1) & (values < 10.0)
    return (
        np.interp(at_s, table.time_s[keep][is_usable], values[is_usable])
        if is_usable.any()
        else 1.0
    )


def _apply(entry: Entry, fields: list[FloatArray], time_s: FloatArray) -> FloatArray:
    """Evaluate function, scale and offset, or the table, of an entry."""
    if entry.table:
        return extrapolating_table(fields[0], entry.table)
    x = fields[0]
    scale, offset = entry.scale, entry.offset
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        match entry.function:
            case "value":
                return offset + scale * x
            case "heading":
                return np.mod(offset + scale * x, 2 * np.pi)
            case "mean":
                return offset + scale * np.mean(fields, axis=0)
            case "sum":
                return offset + scale * np.tensordot(np.array(entry.weights), fields, axes=1)
            case "product":
                return offset + scale * x * fields[1]
            case "polar_cos":
                return offset + scale * x * np.cos(np.radians(fields[1]))
            case "polar_sin":
                return offset + scale * x * np.sin(np.radians(fields[1]))
            case "density_of_eas2tas":
                return np.where(x > 0.5, SEA_LEVEL_KGPM3 / x**2, np.nan)
            case "air_speed":
                return offset + scale * speed_of(*fields)
            case "air_alpha":
                return offset + scale * alpha_of(*fields)
            case "air_beta":
                return offset + scale * beta_of(*fields)
            case "above_start":
                y = offset + scale * x
                # The start level is the median of the first second.
                first = y[time_s <= time_s[np.argmax(np.isfinite(y))] + 1.0]
                return y - (float(np.nanmedian(first)) if np.isfinite(first).any() else 0.0)
            case "north_of_start" | "east_of_start":
                return local_position_m(scale * x, scale * fields[1])[
                    0 if entry.function == "north_of_start" else 1
                ]
        return _euler(fields)[
            ("quaternion_roll", "quaternion_pitch", "quaternion_yaw").index(entry.function)
        ]


CIRCLE_FROM = {"psi_rad": 0.0, "phi_rad": -np.pi}
"""Angles on the circle, and the begin of the turn on which they are recorded, rad."""
_TURN_MARGIN = 0.02  # rad, by which a logged angle may miss the end of its turn
_MAX_RADIAN_SLOPE = 8.0  # slope between angle and rate, the geometric mean of 1 and 57.3


def wrap_angles(columns: Mapping[str, NDArray[Any]]) -> dict[str, FloatArray]:
    """Put heading and roll angle, logged in radians on another turn, on the turn of the
    vocabulary.

    Angles beyond one turn are either radians that count turns, or degrees. Jumps tell: one turn is
    6.28 rad or 360 degrees. Without jumps, the slope of the derivative against the angular rate
    tells.

    Returns
    -------
    dict
        The changed columns alone.
    """
    wrapped = {}
    for name, start in CIRCLE_FROM.items():
        if name not in columns:
            continue
        values = columns[name]
        is_finite = np.isfinite(values)
        on_turn = (values[is_finite] >= start) & (values[is_finite] <= start + 2.0 * np.pi)
        if bool(on_turn.all()):
            continue
        if _in_radians(name, values[is_finite], columns):
            usable = is_finite & (np.abs(np.where(is_finite, values, 0.0)) < 1e6)
            angle = np.mod(np.where(usable, values, 0.0) - start, 2.0 * np.pi) + start
            wrapped[name] = np.where(usable, angle, values)
    return wrapped


def _in_radians(name: str, angle: FloatArray, columns: Mapping[str, NDArray[Any]]) -> bool:
    """Return whether an angle that leaves its turn is in radians."""
    steps = np.abs(np.diff(angle))
    if steps.size < 2 or float(steps.max()) > 180.0:
        return False
    # Jumps by 2 pi.
    leaps = np.abs(steps - 2.0 * np.pi) < 0.1 * 2.0 * np.pi
    if leaps.any() and float(leaps.mean()) < 0.05 and float(np.median(steps)) < 1.0:
        return True
    rate = columns.get("r_radps" if name == "psi_rad" else "p_radps")
    if rate is not None:
        # Without jumps compare the derivative with the angular rate, which is in rad/s.
        slope = np.gradient(columns[name], columns["time_s"])
        is_finite = np.isfinite(slope) & np.isfinite(rate)
        size = float(np.median(np.abs(rate[is_finite]))) if is_finite.any() else 0.0
        if size > 0.0:
            return float(np.median(np.abs(slope[is_finite]))) < _MAX_RADIAN_SLOPE * size
    return name == "psi_rad" and float(np.abs(angle).max()) <= np.pi + _TURN_MARGIN


def local_position_m(lat_deg: FloatArray, lon_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return north and east of the first fix, m, each of shape (n,).

    The plane is tangent to the WGS 84 ellipsoid at the first fix; (0, 0) is no fix and gives NaN.
    """
    fix = (
        np.isfinite(lat_deg)
        & np.isfinite(lon_deg)
        & ((np.abs(lat_deg) > 1e-6) | (np.abs(lon_deg) > 1e-6))
    )
    if not fix.any():
        return np.full(len(lat_deg), np.nan), np.full(len(lat_deg), np.nan)
    first = int(np.argmax(fix))
    lat0 = np.radians(lat_deg[first])
    a, e2 = 6378137.0, 6.69437999014e-3
    w = 1.0 - e2 * np.sin(lat0) ** 2
    north = np.radians(lat_deg - lat_deg[first]) * a * (1 - e2) / w**1.5
    turn = np.mod(lon_deg - lon_deg[first] + 180.0, 360.0) - 180.0
    east = np.radians(turn) * a / np.sqrt(w) * np.cos(lat0)
    return np.where(fix, north, np.nan), np.where(fix, east, np.nan)


def _euler(q: list[FloatArray]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return roll, pitch and yaw (0 to 2 pi), rad, of quaternions (w, x, y, z); NaN for norms
    below 0.5.
    """
    w, x, y, z = q
    size = np.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = (c / np.where(size > 0.5, size, np.nan) for c in (w, x, y, z))
    phi = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    theta = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    psi = np.mod(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)), 2 * np.pi)
    return phi, theta, psi


# Signals that a map computes from other signals of a record, and rows that a map selects.
#
# True airspeed from indicated airspeed and density, density from height, thrust from the speed
# of a propeller. What is assumed becomes a finding of the record.

_T0_K, _LAPSE, _GAS = 288.15, 0.0065, 287.053
_P0 = 101325.0


def derived_signal(
    derived: Derived, columns: Mapping[str, FloatArray], fields: Mapping[str, str] | None = None
) -> tuple[FloatArray, str]:
    """Return the values of a derived signal and a sentence on how it was computed.

    Parameters
    ----------
    derived : Derived
        Signal, function and parameters.
    columns : mapping
        Columns of the record, each of shape (n,).
    fields : mapping, optional
        Signal to the fields that the map reads it from, for the error.

    Raises
    ------
    LogError
        If a column that the function needs is absent.
    """
    p = derived.parameters

    def column(name: str) -> FloatArray:
        """Return a column of the record."""
        if name not in columns:
            absent = (fields or {}).get(name)
            cause = (
                f"which the map reads from {absent}: this log does not have it (uqharness log map"
                " lists the fields)"
                if absent
                else "which neither the log nor the map supplies"
            )
            raise LogError(f"[derived.{derived.signal}]: {derived.function} needs {name}, {cause}")
        return columns[name]

    with np.errstate(invalid="ignore", divide="ignore"):
        match derived.function:
            case "density_of_height":
                height = p["altitude_m"] + column("h_m")
                # Pressure of the standard atmosphere (ISA), temperature of the day.
                pressure = _P0 * (1.0 - _LAPSE * height / _T0_K) ** (G0_MPS2 / (_GAS * _LAPSE))
                kelvin = p["temperature_C"] + 273.15 - _LAPSE * column("h_m")
                text = (
                    f"standard pressure at {p['altitude_m']:g} m + h_m,"
                    f" {p['temperature_C']:g} C at the start"
                )
                return pressure / (_GAS * kelvin), text
            case "true_airspeed":
                # Dynamic pressure is equal: V = V_indicated sqrt(rho0 / rho).
                indicated = column("V_mps")
                if "rho_kgpm3" in columns:
                    density, basis = columns["rho_kgpm3"], "rho_kgpm3"
                else:
                    density, basis = np.full_like(indicated, SEA_LEVEL_KGPM3), "1.225 kg/m3"
                return indicated * np.sqrt(SEA_LEVEL_KGPM3 / density), (
                    f"V_mps was indicated airspeed, density from {basis}"
                )
            # T = CT rho n^2 D^4 with CT at the advance ratio J = V / (n D).
            case "propeller_thrust":
                n = column("rpm") * p["rpm_scale"] / 60.0
                speed = column("V_mps")
                rho = columns.get("rho_kgpm3", np.full_like(n, SEA_LEVEL_KGPM3))
                advance = np.where(n > 0.0, speed / (n * p["diameter_m"]), 0.0)
                ct = p["ct"]
                if isinstance(ct[0], tuple):
                    coefficient = extrapolating_table(advance, ct)
                else:
                    coefficient = np.polynomial.polynomial.polyval(advance, ct)
                thrust = np.where(
                    n > 0.0, p["propellers"] * coefficient * rho * n**2 * p["diameter_m"] ** 4, 0.0
                )
                thrust = np.where(np.isfinite(column("rpm")), thrust, np.nan)
                scale = "" if p["rpm_scale"] == 1.0 else f" times {p['rpm_scale']:g}"
                return thrust, (
                    f"CT(J) rho n^2 D^4 with D = {p['diameter_m']:g} m and n = rpm/60{scale};"
                    f" advance ratio {np.nanquantile(advance, 0.05):.2f} to"
                    f" {np.nanquantile(advance, 0.95):.2f}"
                )
    raise AssertionError(derived.function)


def assumptions(signal_map: SignalMap, labels: Mapping[str, str]) -> list[Finding]:
    """Return a finding with the units, signs and factors that the user's map states.

    Parameters
    ----------
    signal_map : SignalMap
        The user's map.
    labels : mapping
        Signal to the log field that it was made from.
    """
    texts = []
    for name, candidates in signal_map.entries.items():
        entry = next((e for e in candidates if labels.get(name) == e.label), None)
        text = "" if entry is None else _entry_text(entry)
        if text:
            texts.append(f"{name} = {text}")
    if not texts:
        return []
    return [Finding("assumed-map", "", "info", f"by the map: {'; '.join(texts)}", {})]


def _entry_text(entry: Entry) -> str:
    """Describe how an entry converts its fields; empty if it takes them as they are."""
    fields = (
        " ".join(f"{w:+g} {f}" for w, f in zip(entry.weights, entry.fields, strict=True))
        if entry.weights
        else ", ".join(entry.fields)
    )
    parts = [f"{entry.function} of {fields}" if entry.function not in ("value", "sum") else fields]
    if entry.unit:
        parts.append(f"in {entry.unit}")
    if entry.table:
        parts.append("by its table")
    elif entry.scale != 1.0 or entry.offset:
        parts.append(f"times {entry.scale:.6g}" + (f" {entry.offset:+.4g}" if entry.offset else ""))
    return " ".join(parts) if len(parts) > 1 or entry.function != "value" else ""


def mode_rows(raw: RawLog, rows: RowSelection) -> tuple[FloatArray, FloatArray] | None:
    """Return times and values of the field that selects rows; None if no field does.

    Raises
    ------
    LogError
        If the log does not have it.
    """
    if rows.source is None:
        return None
    message, field = rows.source
    table = raw.messages.get((message, 0))
    if table is None or field not in table.fields or table.fields[field].dtype == object:
        raise LogError(f"[rows]: this log has no numbers {message}.{field}")
    keep = clean(table.time_s).keep
    return table.time_s[keep], table.fields[field][keep].astype(np.float64)


def selected(
    time_s: FloatArray, rows: RowSelection, mode: tuple[FloatArray, FloatArray] | None
) -> NDArray[np.bool_]:
    """Return whether each time is selected; the mode holds from one sample to the next."""
    chosen = (time_s >= rows.from_s) & (time_s <= rows.to_s)
    if mode is not None:
        at = np.searchsorted(mode[0], time_s, side="right") - 1
        chosen &= (at >= 0) & np.isin(mode[1][np.maximum(at, 0)], rows.values)
    if rows.part and chosen.any():
        # Blocks count from the first selected row, so that both parts have the same length.
        number = np.floor((time_s - time_s[chosen][0]) / rows.block_s).astype(int)
        chosen &= number % 2 == (0 if rows.part == "odd" else 1)
    return chosen


def select_rows(
    record: FlightRecord,
    rows: RowSelection,
    mode: tuple[FloatArray, FloatArray] | None = None,
) -> FlightRecord:
    """Return the selected rows of a record, with a finding.

    The parts of free flight are limited to the selected rows; without free flight there, the
    selected rows count as flight.

    Raises
    ------
    LogError
        If fewer than two rows are selected.
    """
    time = record["time_s"]
    chosen = selected(time, rows, mode)
    texts = []
    if np.isfinite(rows.from_s) or np.isfinite(rows.to_s):
        texts.append(
            f"{max(rows.from_s, float(time[0])):g} to {min(rows.to_s, float(time[-1])):g} s"
        )
    if rows.source is not None and mode is not None:
        values = " or ".join(f"{value:g}" for value in rows.values)
        texts.append(f"{'.'.join(rows.source)} = {values}")
    if rows.part:
        texts.append(f"{rows.part} blocks of {rows.block_s:g} s")
    if not texts or bool(chosen.all()):
        return record
    if int(chosen.sum()) < 2:
        available = ""
        if mode is not None:
            modes = np.unique(mode[1][np.isfinite(mode[1])])[:10]
            available = f"; its values are {', '.join(f'{value:g}' for value in modes)}"
        raise LogError(
            f"no rows are selected by {' and '.join(texts)}; the log covers {time[0]:g} to"
            f" {time[-1]:g} s{available}"
        )
    text = f"{int(chosen.sum())} of {len(time)} rows selected: {' and '.join(texts)}"
    indices = np.flatnonzero(chosen)
    subset = (
        record.rows(slice(int(indices[0]), int(indices[-1]) + 1))
        if len(indices) == indices[-1] - indices[0] + 1
        else FlightRecord(
            {name: values[chosen] for name, values in record.columns.items()}, record.metadata
        )
    )
    start, end = float(subset["time_s"][0]), float(subset["time_s"][-1])
    meta = subset.metadata
    free = tuple(
        (max(a, start), min(b, end)) for a, b in meta.free_flight_s if max(a, start) < min(b, end)
    )
    findings = meta.findings
    if not free:
        text += "; they count as free flight"
        free = ((start, end),)
        findings = tuple(f for f in findings if f.code != "flight-phase")
    finding = Finding("selected-rows", "", "info", text, {"start_s": start, "end_s": end})
    # Findings about single rows outside the selection no longer apply; checks are run again.
    meta = replace(meta, free_flight_s=free, findings=(finding, *findings))
    return FlightRecord(subset.columns, meta)


def with_derived(
    columns: dict[str, Any],
    derived: Sequence[Derived],
    fields: Mapping[str, str] | None = None,
) -> tuple[dict[str, str], list[Finding]]:
    """Add derived signals to the columns, in the order of the map; ``fields`` as `derived_signal`.

    Returns
    -------
    labels : dict
        Signal to its label.
    findings : list of Finding
        One for each signal.
    """
    labels, findings = {}, []
    for item in derived:
        values, text = derived_signal(item, columns, fields)
        columns[item.signal] = values
        labels[item.signal] = item.function
        message = f"{item.signal} by {item.function}: {text}"
        findings.append(Finding("assumed-derived", item.signal, "info", message, {}))
    return labels, findings
