"""Faults that are built into a log as it was read, before any map, grid or check: the change, and
the finding due."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sysid.foreign.raw import MessageTable, RawLog
from sysid.logs.assemble import servo_field
from sysid.logs.card import AirframeCard
from sysid.logs.channels import Times, resolve
from sysid.logs.checking.kinematics import body_rates_of_attitude, to_body, to_earth
from sysid.logs.servo import controls
from sysid.logs.signal_map import Entry, SignalMap
from sysid.units import FT_M, G0_MPS2, KT_MPS

ACCELERATIONS = ("ax_mps2", "ay_mps2", "az_mps2")
RATES = ("p_radps", "q_radps", "r_radps")
DEG = 180.0 / np.pi


@dataclass(frozen=True)
class Fault:
    """A change of channels, and the finding due.

    kind      scale | late | stuck | held | interpolated | wrapped | estimate
    size      factor, lateness [s], samples a value is held for, or span of the wrap
    channels  signals of the record; lateness moves the whole message that carries them
    codes     findings that count as this fault
    aliases   channel names that count as right, where they are not ``channels``
    """

    name: str
    kind: str
    size: float
    channels: tuple[str, ...]
    codes: tuple[str, ...]
    aliases: tuple[str, ...] = ()

    @property
    def named(self) -> tuple[str, ...]:
        """Channels that a finding has to name."""
        return self.aliases or self.channels


UNIT = ("unit", "sign")
FAULTS = (
    Fault("airspeed in knots", "scale", 1.0 / KT_MPS, ("V_mps",), UNIT),
    Fault("airspeed in ft/s", "scale", 1.0 / FT_M, ("V_mps",), UNIT),
    Fault("accelerations in g", "scale", 1.0 / G0_MPS2, ACCELERATIONS, UNIT),
    Fault("height in feet", "scale", 1.0 / FT_M, ("h_m",), UNIT),
    Fault("rates in deg/s", "scale", DEG, RATES, UNIT),
    Fault("pitch rate in deg/s", "scale", DEG, ("q_radps",), UNIT),
    Fault("elevator table reversed", "scale", -1.0, ("elevator_deg",), UNIT),
    Fault("aileron reversed", "scale", -1.0, ("aileron_deg",), UNIT),
    Fault("rudder reversed", "scale", -1.0, ("rudder_deg",), UNIT),
    Fault("az reversed", "scale", -1.0, ("az_mps2",), UNIT),
    Fault("ay reversed", "scale", -1.0, ("ay_mps2",), UNIT),
    Fault("roll rate reversed", "scale", -1.0, ("p_radps",), UNIT),
    Fault("yaw rate reversed", "scale", -1.0, ("r_radps",), UNIT),
    Fault("alpha reversed", "scale", -1.0, ("alpha_rad",), UNIT),
    Fault("beta reversed", "scale", -1.0, ("beta_rad",), UNIT),
    Fault("attitude 150 ms late", "late", 0.15, ("phi_rad",), ("delay",), ("attitude",)),
    Fault("airspeed 300 ms late", "late", 0.30, ("V_mps",), ("delay",)),
    Fault(
        "ground velocity 250 ms late", "late", 0.25, ("vn_mps",), ("delay",), ("ground velocity",)
    ),
    Fault("pitch rate stuck for 5 s", "stuck", 5.0, ("q_radps",), ("stuck",)),
    Fault("airspeed stuck for 5 s", "stuck", 5.0, ("V_mps",), ("stuck",)),
    Fault("pitch rate interpolated, 1 of 5", "interpolated", 5.0, ("q_radps",), ("interpolated",)),
    Fault("az interpolated, 1 of 4", "interpolated", 4.0, ("az_mps2",), ("interpolated",)),
    Fault("pitch rate held, 1 of 5", "held", 5.0, ("q_radps",), ("sample-and-hold",)),
    Fault("roll rate held, 1 of 3", "held", 3.0, ("p_radps",), ("sample-and-hold",)),
    Fault("pitch rate in 8 bits of 0.1 deg/s", "wrapped", 256.0, ("q_radps",), ("wraps",)),
    Fault("airspeed in 8 bits of 0.1 m/s", "wrapped", 256.0, ("V_mps",), ("wraps",)),
    Fault("rates by an estimator", "estimate", 1.0, RATES, ("estimate",)),
    Fault("airspeed by an estimator", "estimate", 1.0, ("V_mps",), ("estimate",)),
    Fault(
        "alpha and beta by an estimator", "estimate", 1.0, ("alpha_rad", "beta_rad"), ("estimate",)
    ),
)


def seeded(
    raw: RawLog, signals: SignalMap, card: AirframeCard | None, fault: Fault
) -> tuple[RawLog, AirframeCard | None] | None:
    """Return the log and the card with a fault; None where the log has no such channel.

    Of a surface that comes from servo outputs the PWM is turned over about its neutral, as if the
    table were reversed.
    """
    if fault.kind == "estimate":
        changed = _estimated(raw, signals, fault.channels)
        return None if changed is None else (changed, card)
    done: set[tuple[str, int, str]] = set()
    for channel in fault.channels:
        entry = _source(raw, signals, channel)
        if entry is None:
            turned = _turned(raw, signals, card, channel) if fault.kind == "scale" else None
            if turned is None:
                return None
            raw = turned
            continue
        key, field = (entry.message, entry.instance), entry.fields[0]
        if (*key, field) in done:
            continue
        done.add((*key, field))
        if len(entry.fields) > 1 and fault.kind != "late":
            return None
        raw = _changed(raw, key, field, fault, entry.scale)
    return (raw, card)


def _source(raw: RawLog, signals: SignalMap, channel: str) -> Entry | None:
    for entry in signals.entries.get(channel, ()):
        table = raw.messages.get((entry.message, entry.instance))
        if table is not None and all(f in table.fields for f in entry.fields):
            return entry
    return None


def _estimated(raw: RawLog, signals: SignalMap, channels: tuple[str, ...]) -> RawLog | None:
    """Replace sensors by an estimate from attitude, ground velocity and a steady wind."""
    times = Times(raw)
    names = ("phi_rad", "theta_rad", "psi_rad", "vn_mps", "ve_mps", "vd_mps", "V_mps")
    sources = {n: resolve(raw, n, signals.entries.get(n, ()), times) for n in names}
    entries = {n: _source(raw, signals, n) for n in channels}
    if None in sources.values() or None in entries.values():
        return None
    messages = dict(raw.messages)
    for name, entry in entries.items():
        table = messages[(entry.message, entry.instance)]
        step = float(np.median(np.diff(table.time_s)))
        at = {}
        for n, c in sources.items():
            values = np.unwrap(c.values) if n == "psi_rad" else c.values
            at[n] = np.interp(table.time_s, c.time_s, values)
        if name in RATES:
            rates = body_rates_of_attitude(*(at[n] for n in names[:3]), step)
            estimate = rates[RATES.index(name)]
        else:
            # The filter smooths a receiver's velocity.
            kernel = np.ones(max(1, round(0.5 / step)))
            weights = np.convolve(np.ones(table.time_s.size), kernel, "same")
            ground = np.stack([np.convolve(at[n], kernel, "same") / weights for n in names[3:6]])
            u, v, w = to_body(at, ground - _steady_wind(at)[:, None])
            speed = np.sqrt(u**2 + v**2 + w**2)
            air = {"V_mps": speed, "alpha_rad": np.arctan2(w, u), "beta_rad": np.arcsin(v / speed)}
            estimate = air[name]
        fields = {**table.fields, entry.fields[0]: estimate / entry.scale}
        messages[(entry.message, entry.instance)] = MessageTable(table.time_s, fields)
    return replace(raw, messages=messages)


def _steady_wind(at: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the wind (3,) that fits the airspeed best, of motion with the nose into the relative
    wind."""
    nose = to_earth(at, np.stack([at["V_mps"], 0.0 * at["V_mps"], 0.0 * at["V_mps"]]))
    wind = np.array(
        [np.mean(at[n] - a) for n, a in zip(("vn_mps", "ve_mps", "vd_mps"), nose, strict=True)]
    )
    return np.array([wind[0], wind[1], 0.0])


def _turned(
    raw: RawLog, signals: SignalMap, card: AirframeCard | None, channel: str
) -> RawLog | None:
    control = controls(card, raw.parameters)[0].get(channel)
    outputs = signals.servos
    if control is None or outputs is None:
        return None
    key = (outputs.message, outputs.instance)
    fields = dict(raw.messages[key].fields)
    for number, servo, _ in control.parts:
        name = servo_field(outputs, raw, number)
        if name is None:
            return None
        rows = sorted(servo.table, key=lambda row: row[1])
        neutral = np.interp(0.0, [angle for _, angle in rows], [pwm for pwm, _ in rows])
        fields[name] = 2.0 * neutral - np.asarray(fields[name], dtype=np.float64)
    return replace(
        raw, messages={**raw.messages, key: MessageTable(raw.messages[key].time_s, fields)}
    )


def _changed(raw: RawLog, key: tuple[str, int], field: str, fault: Fault, unit: float) -> RawLog:
    table = raw.messages[key]
    values = np.asarray(table.fields[field], dtype=np.float64)
    time = table.time_s + (fault.size if fault.kind == "late" else 0.0)
    if fault.kind != "late":
        values = _altered(values, table.time_s, fault, unit)
    fields: Mapping[str, NDArray[np.float64]] = {**table.fields, field: values}
    return replace(raw, messages={**raw.messages, key: MessageTable(time, fields)})


def _altered(
    values: NDArray[np.float64], time: NDArray[np.float64], fault: Fault, unit: float
) -> NDArray[np.float64]:
    n = round(fault.size)
    at = np.arange(values.size)
    match fault.kind:
        case "scale":
            return values * fault.size
        case "stuck":
            middle = 0.5 * (time[0] + time[-1])
            first = int(np.searchsorted(time, middle))
            return np.where((time >= middle) & (time < middle + fault.size), values[first], values)
        case "held":
            return values[at // n * n]
        case "interpolated":
            return np.interp(at, at[::n], values[::n])
        case "wrapped":
            # In whole units of 0.1 m/s without a sign, or of 0.1 deg/s with one.
            step, low = (0.1, 0.0) if fault.channels == ("V_mps",) else (0.1 / DEG, -128.0)
            return (np.mod(np.round(values * unit / step) - low, fault.size) + low) * step / unit
    raise ValueError(f"unknown kind of fault: {fault.kind}")


def part_of(raw: RawLog, start_s: float, end_s: float) -> RawLog:
    """Return the part of a log between two times."""
    out = {}
    for key, table in raw.messages.items():
        rows = (table.time_s >= start_s) & (table.time_s <= end_s)
        out[key] = MessageTable(table.time_s[rows], {n: v[rows] for n, v in table.fields.items()})
    return replace(raw, messages=out)
