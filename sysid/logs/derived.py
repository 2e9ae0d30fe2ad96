"""Signals that a map computes from other signals of a record, and rows that a map selects.

True airspeed from indicated airspeed and density, density from height, thrust from the speed of a
propeller. What is assumed becomes a finding of the record.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.errors import Finding, LogError
from sysid.foreign.raw import RawLog
from sysid.logs.servo import extrapolating_table
from sysid.logs.signal_map import Derived, Entry, RowSelection, SignalMap
from sysid.logs.time_base import clean
from sysid.record import FlightRecord
from sysid.units import G0_MPS2

_RHO0, _T0_K, _LAPSE, _GAS = 1.225, 288.15, 0.0065, 287.053
_P0 = 101325.0


def derived_signal(derived: Derived, columns: Mapping[str, FloatArray]) -> tuple[FloatArray, str]:
    """Return the values of a derived signal and a sentence on how it was computed.

    Parameters
    ----------
    derived : Derived
        Signal, function and parameters.
    columns : mapping
        Columns of the record, each of shape (n,).

    Raises
    ------
    LogError
        If a column that the function needs is absent.
    """
    p = derived.parameters

    def column(name: str) -> FloatArray:
        """Return a column of the record."""
        if name not in columns:
            raise LogError(
                f"[derived.{derived.signal}]: {derived.function} needs {name}, which neither the"
                " log nor the map supplies"
            )
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
                indicated = column("V_mps")
                if "rho_kgpm3" in columns:
                    density, basis = columns["rho_kgpm3"], "rho_kgpm3"
                else:
                    density, basis = np.full_like(indicated, _RHO0), "1.225 kg/m3"
                return indicated * np.sqrt(_RHO0 / density), (
                    f"V_mps was indicated airspeed, density from {basis}"
                )
            case "propeller_thrust":
                n = column("rpm") * p["rpm_scale"] / 60.0
                speed = column("V_mps")
                rho = columns.get("rho_kgpm3", np.full_like(n, _RHO0))
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
    if not free:
        text += "; they count as free flight"
        free = ((start, end),)
    finding = Finding("selected-rows", "", "info", text, {"start_s": start, "end_s": end})
    # Findings about single rows outside the selection no longer apply; checks are run again.
    meta = replace(meta, free_flight_s=free, findings=(finding, *meta.findings))
    return FlightRecord(subset.columns, meta)


def with_derived(
    columns: dict[str, Any], derived: Sequence[Derived]
) -> tuple[dict[str, str], list[Finding]]:
    """Add derived signals to the columns, in the order of the map.

    Returns
    -------
    labels : dict
        Signal to its label.
    findings : list of Finding
        One for each signal.
    """
    labels, findings = {}, []
    for item in derived:
        values, text = derived_signal(item, columns)
        columns[item.signal] = values
        labels[item.signal] = item.function
        message = f"{item.signal} by {item.function}: {text}"
        findings.append(Finding("assumed-derived", item.signal, "info", message, {}))
    return labels, findings
