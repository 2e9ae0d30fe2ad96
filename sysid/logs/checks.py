"""What real logs get wrong, found and reported with numbers. Pure numerics on channels and records."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sysid.errors import Finding
from sysid.logs.channels import Channel
from sysid.logs.kinematics import check_kinematics
from sysid.record import FlightRecord
from sysid.vocabulary import COMMANDS, LABELS, SIGNALS

FloatArray = NDArray[np.float64]
_GUIDANCE = frozenset({"h_demand_m", "V_demand_mps", "cross_track_m"})
_EDGE_SHARE = 1e-3  # channels start and end a few samples apart: no dropout worth a line


def check_channel(c: Channel, grid_step_s: float, seen: set[str]) -> list[Finding]:
    """Times, gaps, holds, wraps, range and origin of one channel.

    seen  messages whose times were reported already; this channel's is added
    """
    out: list[Finding] = []
    message = c.label.split(".")[0].split(" ")[0]
    if message not in seen and c.name != "mode":
        seen.add(message)
        # Guidance messages come and go with the flight mode; their gaps harm nobody.
        severity = "info" if c.name in _GUIDANCE else "warning"
        out += _times(message, c) + _gaps(message, c, severity)
    out += _hold(c.name, c, grid_step_s) + _wrap(c.name, c) + _range(c.name, c.label, c.values)
    if c.estimate:
        text = (
            f"{c.name} ({c.label}) is computed by the autopilot's estimator, no vane measured it. In gusts it misses"
            " the gust angle: do not identify force or moment derivatives from it in turbulence"
        )
        out.append(Finding("estimate", c.name, "warning", text, {}))
    return out


def _times(message: str, c: Channel) -> list[Finding]:
    out = []
    if c.clean.backwards:
        text = f"{c.clean.backwards} records of {message} have times that run backwards, underflow or jump; left out"
        numbers = {"records": float(c.clean.backwards), "dropped_s": c.clean.dropped_s}
        out.append(Finding("time-backwards", message, "warning", text, numbers))
    if c.clean.repeats:
        text = f"{c.clean.repeats} records of {message} repeat the time of the one before; left out"
        out.append(Finding("time-repeats", message, "info", text, {"records": float(c.clean.repeats)}))
    return out


def _gaps(message: str, c: Channel, severity: str) -> list[Finding]:
    gaps = c.clean.gaps
    if not len(gaps):
        return []
    spans = gaps[:, 1] - gaps[:, 0]
    worst = int(np.argmax(spans))
    text = (
        f"{len(gaps)} gaps in {message} (usual step {c.clean.step_s * 1e3:.0f} ms), {spans.sum():.2f} s in all, longest"
        f" {spans[worst]:.2f} s at {gaps[worst, 0]:.2f} s; NaN in the record, nothing is interpolated across them"
    )
    numbers = {
        "gaps": float(len(gaps)),
        "total_s": float(spans.sum()),
        "longest_s": float(spans[worst]),
        "longest_at_s": float(gaps[worst, 0]),
    }
    return [Finding("gap", message, severity, text, numbers)]


def _hold(name: str, c: Channel, grid_step_s: float) -> list[Finding]:
    """A channel slower than the grid: either logged slower, or logged fast while its values are held."""
    if name == "mode" or name in _GUIDANCE:
        return []
    ratio = c.clean.step_s / grid_step_s
    if ratio > 1.3:
        kind = "held" if name in COMMANDS else "interpolated"
        late = 0.5 * (c.clean.step_s - grid_step_s) if name in COMMANDS else 0.0
        text = f"{name} is logged at {c.rate_hz:.1f} Hz, {kind} onto a {1 / grid_step_s:.1f} Hz grid"
        if late:
            text += f"; it comes {late * 1e3:.0f} ms late on average, {2 * late * 1e3:.0f} ms at most"
        numbers = {"native_hz": c.rate_hz, "grid_hz": 1 / grid_step_s, "mean_late_s": late}
        return [Finding("slower-than-grid", name, "info", text, numbers)]
    held = repeat_length(c.values)
    if name not in COMMANDS and held >= 1.8:
        rate = c.rate_hz / held
        text = (
            f"{name} is logged at {c.rate_hz:.1f} Hz but its value changes at {rate:.1f} Hz only (sample and hold, mean"
            f" run {held:.1f} samples): it lags by {0.5 * (held - 1) * c.clean.step_s * 1e3:.0f} ms on average"
        )
        numbers = {"logged_hz": c.rate_hz, "native_hz": rate, "mean_run": held}
        return [Finding("sample-and-hold", name, "warning", text, numbers)]
    return []


def repeat_length(values: FloatArray) -> float:
    """Mean run of equal values while the signal moves (runs longer than 50 samples count as standing still)."""
    good = values[np.isfinite(values)]
    if len(good) < 20:
        return 1.0
    changes = np.flatnonzero(np.diff(good) != 0)
    if len(changes) < 10:
        return 1.0
    runs = np.diff(changes)
    moving = runs[runs <= 50]
    return float(moving.mean()) if len(moving) >= 10 else 1.0


def _wrap(name: str, c: Channel) -> list[Finding]:
    """Steps of a whole integer range in the logged number: a counter or scaled integer that wrapped."""
    if c.raw is None or name in LABELS or SIGNALS[name].kind == "heading" or len(c.raw) < 20:
        return []
    steps = np.abs(np.diff(c.raw[np.isfinite(c.raw)]))
    moving = steps[steps > 0]
    if not len(moving):
        return []
    usual = float(np.quantile(moving, 0.9))
    for span, what in ((65536.0, "16-bit"), (655.36, "16-bit, 1/100"), (65.536, "16-bit, 1/1000"), (256.0, "8-bit")):
        hits = int(np.sum(np.abs(steps - span) < 0.03 * span))
        if hits and span > 20.0 * usual and span > 0.4 * float(np.ptp(c.raw[np.isfinite(c.raw)])):
            text = f"{name} ({c.label}) jumps by {span:g} {hits} times while it usually moves {usual:.3g}: a {what} wrap"
            return [Finding("wraps", name, "error", text, {"jumps": float(hits), "span": span})]
    return []


def _range(name: str, label: str, values: FloatArray) -> list[Finding]:
    signal = SIGNALS[name]
    good = values[np.isfinite(values)]
    if not len(good) or name in LABELS:
        return []
    outside = (good < signal.low) | (good > signal.high)
    share = float(outside.mean())
    numbers = {"share": share, "low": float(good.min()), "high": float(good.max())}
    if share <= 0:
        return []
    hint = ""
    if signal.unit.startswith("rad") and share > 0.01 and float(np.quantile(np.abs(good), 0.99)) > 3.2:
        hint = "; it looks like degrees where radians are due (scale 0.0174533 in the map)"
    text = (
        f"{name} ({label}) leaves [{signal.low:g}, {signal.high:g}] {signal.unit} in {100 * share:.2g} % of the log"
        f" (from {numbers['low']:.4g} to {numbers['high']:.4g}){hint}"
    )
    severity = "error" if share > 0.01 else "warning"
    return [Finding("out-of-range", name, severity, text, numbers)]


def check_record(record: FlightRecord, free_s: tuple[float, float] | None) -> list[Finding]:
    """Dropouts, speeds below zero, frozen channels and kinematic consistency, over free flight where there is one."""
    flight = record if free_s is None else record.between(*free_s)
    out: list[Finding] = []
    for name, values in flight.columns.items():
        if name in LABELS or name == "time_s" or not len(values):
            continue
        missing = float(np.mean(~np.isfinite(values)))
        if missing > _EDGE_SHARE:
            text = f"{name} is missing in {100 * missing:.2g} % of the flight"
            severity = "warning" if missing > 0.01 and name not in _GUIDANCE else "info"
            out.append(Finding("dropouts", name, severity, text, {"share": missing}))
        good = values[np.isfinite(values)]
        if name not in COMMANDS and len(good) > 50 and np.ptp(good) == 0.0 and name != "rho_kgpm3":
            text = f"{name} stands at {good[0]:g} throughout: sensor absent or not logged"
            out.append(Finding("frozen", name, "error", text, {"value": float(good[0])}))
    if "V_mps" in flight and len(flight):
        speed = flight["V_mps"][np.isfinite(flight["V_mps"])]
        below = float(np.mean(speed < 0)) if len(speed) else 0.0
        if below > 0.5:
            text = f"airspeed is negative in {100 * below:.0f} % of the samples (median {np.median(speed):.2f} m/s)"
            out.append(Finding("negative-airspeed", "V_mps", "error", text, {"share": below, "median": float(np.median(speed))}))
    if free_s is not None:
        out += check_kinematics(flight)
    return out


def check_units(record: FlightRecord) -> list[Finding]:
    """Angles and rates that cannot be radians, by their range or by each other: for tables that no importer has looked at."""
    out: list[Finding] = []
    for name, values in record.columns.items():
        if name not in LABELS and SIGNALS[name].unit.startswith("rad"):
            out += _range(name, "column", values)
    if len(record) > 1:
        out += [f for f in check_kinematics(record) if f.code in ("unit", "sign")]
    return out


def in_degrees(finding: Finding) -> bool:
    """Does this finding say that a channel is off by the factor between degrees and radians?"""
    ratio = abs(finding.numbers.get("slope", 1.0))
    beyond = max(abs(finding.numbers.get("low", 0.0)), abs(finding.numbers.get("high", 0.0)))
    by_range = finding.code == "out-of-range" and finding.severity == "error" and SIGNALS[finding.channel].unit == "rad"
    return (by_range and beyond > 2.0 * np.pi) or (finding.code == "unit" and not 1 / 45.0 <= ratio <= 45.0)
