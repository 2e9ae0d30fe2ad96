"""Run all checks of a log and report them as findings with numbers.

`check_channel` looks at one channel on its own time stamps, `check_record` at a finished record,
`check_motion` at the channels of free flight against each other, and `recheck` repeats the checks
on a record that is read from a file. The signs of surfaces are tested here; the other tests are in
`signals`, `physics`, `kinematics` and `timing`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.arrays import FloatArray
from sysid.errors import Finding
from sysid.logs.channels import Channel, components_of
from sysid.logs.checking.kinematics import AIR, band_passed, lever_arm_finding
from sysid.logs.checking.physics import (
    MAX_RAD,
    affected_results,
    check_physics,
    degrees_by_size,
    map_correction,
)
from sysid.logs.checking.signals import (
    check_estimates,
    detect_wraps,
    interpolation_interval,
    sample_hold,
    stuck_span,
)
from sysid.logs.time_base import SLOWEST_STEP_S, CleanTime, time_unit_finding
from sysid.record import FlightRecord, Metadata
from sysid.units import percent
from sysid.vocabulary import COMMANDS, LABELS, SIGNALS

# Check the sign of each surface by the angular acceleration that it causes.
#
# Positive elevator pitches the nose down, positive aileron rolls right, positive rudder yaws
# the nose left. The angular acceleration is regressed on the surface, the other surface of the
# plane, the rates and the angles of flow. The latter account for an autopilot's response to
# gusts, which follows the motion. A surface follows its command with a lag, and the aircraft
# too; the lag that explains most is used.

_BAND_HZ = (0.15, 4.0)
_BLOCK_S = 3.0
_MIN_BLOCKS = 5
_MAX_LAG_S = 0.16
_MIN_S, _MAX_S = 8.0, 300.0
_MIN_HZ = 18.0
_MIN_RATIO = 6.0  # |effect| over standard error
_MIN_SHARE = 0.15  # of the angular acceleration without the covariates' part
# Share explained earlier with the opposite sign: a quick aircraft swings back within the lags.
_MAX_OPPOSITE = 0.3
_MOVING_DEG = 0.3  # least rms of the surface in the band
_ANGULAR_ACCELERATION = "angular acceleration"


@dataclass(frozen=True)
class Axis:
    """A surface, the rate [rad/s] that it drives, the sign of its effect, and covariates of that
    rate.
    """

    surface: str
    rate: str
    sense: float
    covariates: tuple[str, ...]


AXES = (
    Axis("elevator_deg", "q_radps", -1.0, ("alpha_rad", "az_mps2", "V_mps")),
    Axis("aileron_deg", "p_radps", 1.0, ("beta_rad", "r_radps", "rudder_deg")),
    Axis("rudder_deg", "r_radps", -1.0, ("beta_rad", "p_radps", "aileron_deg")),
)


@dataclass(frozen=True)
class SurfaceEffect:
    """Effect of a surface on the angular acceleration.

    Attributes
    ----------
    slope, std : float
        Angular acceleration a degree, 1/s2, and standard error.
    late_s : float
        Lag of the surface, s.
    share : float
        Share of the variance that it explains.
    against : float
        Largest share that an earlier lag explains with the opposite sign.
    """

    slope: float
    std: float
    late_s: float
    share: float
    against: float = 0.0

    @property
    def certain(self) -> bool:
        """Whether the flight determines the sign."""
        return (
            abs(self.slope) > _MIN_RATIO * self.std
            and self.share > _MIN_SHARE
            and self.against < _MAX_OPPOSITE * self.share
        )


def effect(record: FlightRecord, axis: Axis) -> SurfaceEffect | None:
    """Estimate the effect of a surface on its axis.

    Returns
    -------
    Effect or None
        None if the surface does not move, is not logged, or is logged too slowly.
    """
    column = _column(record, axis.surface)
    if column is None or axis.rate not in record or len(record) < 3:
        return None
    dt = record.dt_s
    native = min(
        (record.metadata.native_hz.get(n, 1.0 / dt) for n in (column, axis.rate)), default=1.0 / dt
    )
    if native < _MIN_HZ:
        # An autopilot responds to a gust within a sample: its action and the effect of that
        # cannot be separated.
        return None
    high = min(_BAND_HZ[1], 0.2 * native)
    covariates = tuple(
        n for n in axis.covariates if n in record and np.isfinite(record[n]).mean() > 0.5
    )
    if "alpha_rad" in covariates and "alpha_rad" not in record.metadata.estimates:
        # Lift depends on alpha and elevator: with a measured alpha it would stand for the
        # elevator.
        covariates = tuple(n for n in covariates if n != "az_mps2")
    parts = _parts(record, (column, axis.rate, *covariates), dt)
    if not parts or high < 2.0 * _BAND_HZ[0]:
        return None
    rows = [{n: band_passed(c[n], dt, _BAND_HZ[0], high) for n in c} for c in parts]
    if math.sqrt(float(np.mean(np.concatenate([c[column] for c in rows]) ** 2))) < _MOVING_DEG:
        return None
    for c in rows:
        c[_ANGULAR_ACCELERATION] = np.gradient(c[axis.rate], dt)
    lags = range(round(_MAX_LAG_S / dt) + 1)
    effects = [
        e
        for lag in lags
        if (e := _regress(rows, column, (axis.rate, *covariates), lag, dt)) is not None
    ]
    if not effects:
        return None
    # The lag that explains most, and the largest share of an earlier lag with the opposite sign.
    best = max(effects, key=lambda e: e.share)
    opposite_shares = [
        e.share for e in effects if e.late_s < best.late_s and e.slope * best.slope < 0.0
    ]
    return replace(best, against=max(opposite_shares, default=0.0))


def check_surfaces(record: FlightRecord) -> list[Finding]:
    """Return findings on surfaces whose effect certainly has the wrong sign."""
    out = []
    # An effect of uncertain or expected sign is no finding.
    for axis in AXES:
        surface_effect = effect(record, axis)
        if (
            surface_effect is None
            or not surface_effect.certain
            or surface_effect.slope * axis.sense > 0.0
        ):
            continue
        # The finding names the logged column, which a map can correct.
        column = _column(record, axis.surface) or axis.surface
        opposite_effects = {
            "elevator_deg": "pitches the nose up",
            "aileron_deg": "rolls left",
            "rudder_deg": "yaws the nose right",
        }
        text = (
            f"+ {column} {opposite_effects[axis.surface]}: {axis.rate} changes by"
            f" {surface_effect.slope:+.3g} +- {surface_effect.std:.2g} rad/s2 a degree,"
            f" {surface_effect.late_s * 1e3:.0f} ms later"
            f" (it explains {100 * surface_effect.share:.0f} % of the acceleration that the other"
            " signals leave): its sign is reversed"
        )
        numbers = {
            "slope": -1.0,
            "effect": surface_effect.slope,
            "std": surface_effect.std,
            "late_s": surface_effect.late_s,
            "share": surface_effect.share,
        }
        out.append(
            Finding(
                "sign",
                column,
                "error",
                text,
                numbers,
                affected_results(column),
                map_correction(column, -1.0, record.metadata),
            )
        )
    return out


def _column(record: FlightRecord, surface: str) -> str | None:
    """Return the measured position if there is one, else the command."""
    position = surface.replace("_deg", "_pos_deg")
    return next(
        (n for n in (position, surface) if n in record and np.isfinite(record[n]).mean() > 0.5),
        None,
    )


def _parts(record: FlightRecord, names: tuple[str, ...], dt: float) -> list[dict[str, FloatArray]]:
    """Return the longest stretches without gaps, up to _MAX_S in total."""
    rows_left, out = round(_MAX_S / dt), []
    for part in sorted(record.segments(names, _MIN_S), key=lambda s: s.start - s.stop):
        stop = min(part.stop, part.start + rows_left)
        if stop - part.start < max(_MIN_S / dt, 64):
            break
        out.append({n: np.asarray(record[n][part.start : stop], dtype=np.float64) for n in names})
        rows_left -= stop - part.start
    return out


def _regress(
    rows: list[dict[str, FloatArray]], column: str, covariates: tuple[str, ...], lag: int, dt: float
) -> SurfaceEffect | None:
    """Regress with the surface ``lag`` samples earlier.

    Standard errors are cluster-robust over blocks of seconds (Liang and Zeger 1986).
    """
    targets, designs, blocks, first = [], [], [], 0
    for c in rows:
        n = c[column].size - lag
        moved = [
            c[column][:n],
            *(c[o][:n] if o.endswith("_deg") else c[o][lag:] for o in covariates),
        ]
        targets.append(c[_ANGULAR_ACCELERATION][lag:])
        designs.append(np.column_stack(moved))
        block = first + (np.arange(n) * dt // _BLOCK_S).astype(int)
        blocks.append(block)
        first = int(block[-1]) + 1
    y, a, block = np.concatenate(targets), np.vstack(designs), np.concatenate(blocks)
    # Partial out the covariates from surface and acceleration.
    design = a[:, 1:] / np.maximum(a[:, 1:].std(axis=0), 1e-12)
    pair = np.column_stack([a[:, 0], y])
    surface, acceleration = (pair - design @ np.linalg.lstsq(design, pair, rcond=1e-9)[0]).T
    power = float(surface @ surface)
    count = int(block[-1]) + 1
    if (
        not power > 1e-6 * float(a[:, 0] @ a[:, 0])
        or count < _MIN_BLOCKS
        or not float(acceleration @ acceleration) > 0.0
    ):
        return None
    slope = float(surface @ acceleration) / power
    sums = np.zeros(count)
    np.add.at(sums, block, surface * (acceleration - slope * surface))
    std = math.sqrt(float(sums @ sums) * count / (count - 2.0)) / power
    return SurfaceEffect(
        slope, std, lag * dt, slope**2 * power / float(acceleration @ acceleration)
    )


_GUIDANCE = frozenset({"h_demand_m", "V_demand_mps", "cross_track_m"})
_EDGE_SHARE = 1e-3  # channels start and end a few samples apart: no dropout worth a line


def check_channel(c: Channel, grid_step_s: float, reported: set[str]) -> list[Finding]:
    """Check times, gaps, holds, wraps, range and origin of one channel.

    Parameters
    ----------
    c : Channel
        Channel on its own time stamps.
    grid_step_s : float
        Step of the record, s.
    reported : set of str
        Messages whose times were reported already; this channel's message is added.
    """
    out: list[Finding] = []
    message = c.label.split(".")[0].split(" ")[0]
    if message not in reported and c.name != "mode":
        reported.add(message)
        # Guidance messages come and go with the flight mode; their gaps are harmless.
        severity = "info" if c.name in _GUIDANCE else "warning"
        out += _times(message, c) + _gaps(message, c, severity)
    out += (
        _hold(c.name, c, grid_step_s)
        + _wrap(c.name, c)
        + _range(c.name, c.label, c.values)
        + _stuck_before_factor(c)
    )
    if c.estimate:
        text = (
            f"{c.name} ({c.label}) is computed by the autopilot's estimator, no vane measured it."
            " In gusts it misses the gust angle: do not identify force or moment derivatives from"
            " it in turbulence"
        )
        out.append(Finding("estimate", c.name, "warning", text, {}))
    return out


def _times(message: str, c: Channel) -> list[Finding]:
    """Return findings on times that run backwards or repeat."""
    out = []
    if c.clean.backwards:
        text = (
            f"{c.clean.backwards} records of {message} have times that run backwards, underflow or"
            " jump; left out"
        )
        numbers = {"records": float(c.clean.backwards), "dropped_s": c.clean.dropped_s}
        out.append(Finding("time-backwards", message, "warning", text, numbers))
    if c.clean.repeats:
        text = f"{c.clean.repeats} records of {message} repeat the time of the one before; left out"
        out.append(
            Finding("time-repeats", message, "info", text, {"records": float(c.clean.repeats)})
        )
    return out


def _gaps(message: str, c: Channel, severity: str) -> list[Finding]:
    """Return a finding on the gaps of a message."""
    gaps = c.clean.gaps
    if not len(gaps):
        return []
    spans = gaps[:, 1] - gaps[:, 0]
    worst = int(np.argmax(spans))
    text = (
        f"{len(gaps)} gaps in {message} (usual step {c.clean.step_s * 1e3:.0f} ms),"
        f" {spans.sum():.2f} s in all, longest {spans[worst]:.2f} s at {gaps[worst, 0]:.2f} s; NaN"
        " in the record, nothing is interpolated across them"
    )
    numbers = {
        "gaps": float(len(gaps)),
        "total_s": float(spans.sum()),
        "longest_s": float(spans[worst]),
        "longest_at_s": float(gaps[worst, 0]),
    }
    return [Finding("gap", message, severity, text, numbers)]


def _hold(name: str, c: Channel, grid_step_s: float) -> list[Finding]:
    """Return a finding on a channel that is slower than the grid.

    It is either logged slower, or logged fast with values that are held.
    """
    if name == "mode" or name in _GUIDANCE:
        return []
    ratio = c.clean.step_s / grid_step_s
    if ratio > 1.3:
        kind = "held" if name in COMMANDS else "interpolated"
        late = 0.5 * (c.clean.step_s - grid_step_s) if name in COMMANDS else 0.0
        text = (
            f"{name} is logged at {c.rate_hz:.1f} Hz, {kind} onto a {1 / grid_step_s:.1f} Hz grid"
        )
        if late:
            text += (
                f"; it comes {late * 1e3:.0f} ms late on average, {2 * late * 1e3:.0f} ms at most"
            )
        numbers = {"native_hz": c.rate_hz, "grid_hz": 1 / grid_step_s, "mean_late_s": late}
        return [Finding("slower-than-grid", name, "info", text, numbers)]
    return _resolution_findings(name, c)


def _resolution_findings(name: str, c: Channel) -> list[Finding]:
    """Return a finding on a channel with fewer or coarser values than samples."""
    if name in COMMANDS or name == "rho_kgpm3":
        # Commands are held by nature; a density is computed and hardly changes.
        return []
    repetition = sample_hold(c.values)
    if repetition is not None and repetition.is_held:
        rate = c.rate_hz / repetition.run
        text = (
            f"{name} is logged at {c.rate_hz:.1f} Hz but its value changes at {rate:.1f} Hz only"
            f" (sample and hold, mean run {repetition.run:.1f} samples): it lags by"
            f" {0.5 * (repetition.run - 1) * c.clean.step_s * 1e3:.0f} ms on average"
        )
        numbers = {"logged_hz": c.rate_hz, "native_hz": rate, "mean_run": repetition.run}
        return [
            Finding(
                "sample-and-hold", name, "warning", text, numbers, "phases: dampings and delays"
            )
        ]
    if repetition is not None:
        text = (
            f"{name} moves in steps of {repetition.quantum:.3g}: its noise is at least"
            f" {repetition.quantum / 12**0.5:.2g} (step / sqrt 12)"
        )
        return [Finding("quantised", name, "info", text, {"quantum": repetition.quantum})]
    interval = interpolation_interval(c.values)
    if interval is not None:
        rate = c.rate_hz / interval
        text = (
            f"{name} is logged at {c.rate_hz:.1f} Hz but lies on straight lines between values at"
            f" {rate:.1f} Hz: it was interpolated before logging; its noise looks smaller than it"
            " is, and its samples are not independent"
        )
        numbers = {"logged_hz": c.rate_hz, "native_hz": rate}
        return [
            Finding(
                "interpolated",
                name,
                "warning",
                text,
                numbers,
                "standard errors, and what is faster than its own rate",
            )
        ]
    return []


_MAY_STAND_STILL = frozenset(
    {
        "elevator_pos_deg",
        "aileron_pos_deg",
        "rudder_pos_deg",
        "rpm",
        "thrust_N",
        "rho_kgpm3",
        *_GUIDANCE,
    }
)
"""Channels that may be constant in flight. A constant value is a stopped sensor only if noise
moved the channel before.
"""


def has_factor(label: str) -> bool:
    """Return whether the channel of this label is multiplied by a field of another message."""
    return " x " in label


def _stuck_before_factor(c: Channel) -> list[Finding]:
    """Return a finding on a sensor that stood still, hidden by a factor that did not."""
    if c.raw is None or not has_factor(c.label) or c.name in COMMANDS:
        return []
    span = stuck_span(c.raw, c.clean.step_s, noisy=c.name in _MAY_STAND_STILL)
    return (
        []
        if span is None
        else [_stuck_finding(c.name, float(c.raw[span[0]]), (c.time_s[span[0]], c.time_s[span[1]]))]
    )


def _stuck_finding(name: str, value: float, span_s: tuple[float, float]) -> Finding:
    """Return the finding on a channel that stood still for a time."""
    begin, end = (float(t) for t in span_s)
    text = (
        f"{name} stands at {value:.4g} from {begin:.2f} to {end:.2f} s, among samples that all"
        " differ"
    )
    return Finding(
        "stuck", name, "error", text, {"start_s": begin, "end_s": end}, affected_results(name)
    )


def _stuck(record: FlightRecord) -> list[Finding]:
    """Return findings on channels that stood still for seconds, though noise usually moves every
    sample.
    """
    out = []
    for name, values in record.columns.items():
        if (
            name in LABELS
            or name in COMMANDS
            or name == "time_s"
            or has_factor(record.metadata.channels.get(name, ""))
        ):
            continue
        span = stuck_span(values, record.dt_s, noisy=name in _MAY_STAND_STILL)
        if span is not None:
            out.append(
                _stuck_finding(
                    name, values[span[0]], (record["time_s"][span[0]], record["time_s"][span[1]])
                )
            )
    return out


def _components_interpolated(flight: FlightRecord) -> list[Finding]:
    """Return findings on airspeed, alpha and beta whose components u, v, w were interpolated.

    Linear components do not make V, alpha and beta linear, so that these must be transformed
    first.
    """
    if not all(n in flight for n in AIR):
        return []
    rates = {flight.metadata.native_hz.get(n, 1.0 / flight.dt_s) for n in AIR}
    if min(rates) < 0.75 / flight.dt_s or any(interpolation_interval(flight[n]) for n in AIR):
        return []
    with np.errstate(all="ignore"):
        intervals = [
            interval
            for c in components_of(*(flight[n] for n in AIR))
            if (interval := interpolation_interval(c)) is not None
        ]
    if len(intervals) < 2:
        return []
    logged = 1.0 / flight.dt_s
    native = logged / max(intervals)
    text = (
        f"airspeed, alpha and beta come at {logged:.1f} Hz but their components u, v, w lie on"
        f" straight lines between values at {native:.1f} Hz: they were interpolated before logging;"
        " their noise looks smaller than it is"
    )
    numbers = {"logged_hz": logged, "native_hz": native}
    spoils = "standard errors, and what is faster than its own rate"
    return [Finding("interpolated", name, "warning", text, numbers, spoils) for name in AIR]


def _wrap(name: str, c: Channel) -> list[Finding]:
    """Return a finding on jumps by a whole integer range: a counter or scaled integer that
    wrapped.
    """
    if c.raw is None or name in LABELS or SIGNALS[name].kind == "heading":
        return []
    wrap = detect_wraps(c.raw)
    if wrap is None:
        return []
    text = (
        f"{name} ({c.label}) jumps by {wrap[1]:g} {wrap[0]} times from one end of its range to"
        f" the other: a {wrap[2]} wrap"
    )
    numbers = {
        "jumps": float(wrap[0]),
        "span": wrap[1],
        "values": 256.0 if wrap[2].startswith("8-") else 65536.0,
    }
    return [Finding("wraps", name, "error", text, numbers, affected_results(name))]


def _range(
    name: str, label: str, values: FloatArray, meta: Metadata | None = None
) -> list[Finding]:
    """Return a finding on values outside the plausible range, with the correction for degrees."""
    signal = SIGNALS[name]
    finite = values[np.isfinite(values)]
    if not len(finite) or name in LABELS:
        return []
    outside = (finite < signal.low) | (finite > signal.high)
    share = float(outside.mean())
    numbers = {"share": share, "low": float(finite.min()), "high": float(finite.max())}
    if share <= 0:
        return []
    hint = correction = ""
    if name in MAX_RAD and degrees_by_size(name, values):
        hint = "; it looks like degrees where radians are due (scale 0.0174533 in the map)"
        correction = map_correction(name, np.pi / 180.0, meta or Metadata(channels={name: label}))
    text = (
        f"{name} ({label}) leaves [{signal.low:g}, {signal.high:g}] {signal.unit} in"
        f" {percent(share)} of the log (from {numbers['low']:.4g} to {numbers['high']:.4g}){hint}"
    )
    severity = "error" if share > 0.01 else "warning"
    return [
        Finding("out-of-range", name, severity, text, numbers, affected_results(name), correction)
    ]


def estimated_channels(mapped: tuple[str, ...], findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return the channels that no sensor measured, by the map or by the checks."""
    computed = (f.channel for f in findings if f.code == "estimate" and f.channel in AIR[1:])
    return tuple(dict.fromkeys((*mapped, *computed)))


def one_per_cause(findings: Sequence[Finding]) -> list[Finding]:
    """Remove findings that another finding explains.

    A wrong unit or sign takes a channel out of its range and makes an airspeed negative. A channel
    in degrees, or one that stands still, violates every relation in which it occurs, and its sign
    cannot be determined.
    """
    wrong_units = {f.channel for f in findings if f.code in ("unit", "sign")}
    frozen = {f.channel for f in findings if f.code == "frozen" and f.severity == "error"}
    by_size = {f.channel for f in findings if f.code == "out-of-range" and f.mend}
    distinct: list[Finding] = []
    for f in findings:
        explained = (
            (f.code in ("out-of-range", "negative-airspeed") and f.channel in wrong_units)
            or (
                f.code in ("kinematics-disagree", "delay")
                and f.channel in frozen | wrong_units | by_size
            )
            or (f.code in ("stuck", "quantised", "sample-and-hold") and f.channel in frozen)
        )
        if not explained and f not in distinct:
            distinct.append(f)
    return distinct


def check_record(record: FlightRecord, free_s: tuple[float, float] | None) -> list[Finding]:
    """Check dropouts, speeds below zero, frozen channels and kinematic consistency.

    Parameters
    ----------
    record : FlightRecord
        Finished record.
    free_s : tuple or None
        Free flight, s; None checks the whole record and leaves the kinematic checks out.
    """
    # Only free flight is checked: on the ground sensors rest.
    flight = record if free_s is None else record.between(*free_s)
    out: list[Finding] = []
    for name, values in flight.columns.items():
        if name in LABELS or name == "time_s" or not len(values):
            continue
        # The edges of a record may lack samples; more is a dropout.
        missing = float(np.mean(~np.isfinite(values)))
        if missing > _EDGE_SHARE:
            text = f"{name} is missing in {percent(missing)} of the flight"
            severity = "warning" if missing > 0.01 and name not in _GUIDANCE else "info"
            out.append(Finding("dropouts", name, severity, text, {"share": missing}))
    # Steps slower than a recorder has are a wrong unit of time.
    if len(record) > 2 and record.dt_s > SLOWEST_STEP_S:
        out.append(time_unit_finding("time_s", record.dt_s, converted=False))
    out += _frozen(flight) + _stuck(flight) + _components_interpolated(flight)
    # A pitot tube and its static port that are swapped show negative airspeed.
    if "V_mps" in flight and len(flight):
        speed = flight["V_mps"][np.isfinite(flight["V_mps"])]
        below = float(np.mean(speed < 0)) if len(speed) else 0.0
        if below > 0.5:
            text = (
                f"airspeed is negative in {100 * below:.0f} % of the samples (median"
                f" {np.median(speed):.2f} m/s)"
            )
            out.append(
                Finding(
                    "negative-airspeed",
                    "V_mps",
                    "error",
                    text,
                    {"share": below, "median": float(np.median(speed))},
                )
            )
    if free_s is not None:
        out += check_motion(flight)
    return out


def check_motion(flight: FlightRecord) -> list[Finding]:
    """Check channels of free flight against each other.

    The checks are of units, signs, delays, effects of the surfaces and position of the
    accelerometers.
    """
    if len(flight) < 3:
        return []
    plausible = {
        n: np.where(np.abs(v) < _MAX_PLAUSIBLE, v, np.nan)
        for n, v in flight.columns.items()
        if n not in LABELS and n != "time_s"
    }
    # Damaged samples must not dominate the sums of squares.
    flight = flight.with_columns(
        {n: v for n, v in plausible.items() if not np.array_equal(v, flight[n], equal_nan=True)}
    )
    findings = check_physics(flight)
    # Correct units and signs first: a reversed rate would make its surface look reversed.
    corrected_columns = {
        f.channel: flight[f.channel] / f.numbers["slope"]
        for f in findings
        if f.code in ("unit", "sign")
    }
    corrected = flight.with_columns(corrected_columns)
    findings += [*check_surfaces(corrected), *check_estimates(corrected)]
    # A wrong unit or sign, or angles that were not measured, would look like a lever arm.
    has_error = any(
        f.severity == "error" or (f.code == "estimate" and f.channel in AIR) for f in findings
    )
    return findings if has_error else [*findings, *lever_arm_finding(flight)]


_MAX_PLAUSIBLE = 1e7
"""Larger than any channel in any unit: damage."""


_MOVING_TOGETHER = (
    ("V_mps", "alpha_rad", "theta_rad", "q_radps", "ax_mps2", "az_mps2", "h_m"),
    ("beta_rad", "phi_rad", "psi_rad", "p_radps", "r_radps", "ay_mps2"),
)
"""Groups of channels of which none is constant while another moves."""
_MIN_SPAN = 1e-9


def _frozen(flight: FlightRecord) -> list[Finding]:
    """Return findings on constant channels; errors if a related channel moves."""
    out = []
    # Range of each channel; a few samples cannot tell.
    spans = {
        n: np.ptp(v[np.isfinite(v)])
        for n, v in flight.columns.items()
        if n not in LABELS and np.isfinite(v).sum() > 50
    }
    for name, span in spans.items():
        if span != 0.0 or name in COMMANDS or name == "time_s":
            continue
        value = float(flight[name][np.isfinite(flight[name])][0])
        # A sensor is absent if a related channel moves.
        moving = [
            n
            for group in _MOVING_TOGETHER
            if name in group
            for n in group
            if spans.get(n, 0.0) > _MIN_SPAN
        ]
        if moving:
            text = (
                f"{name} stands at {value:g} throughout while {moving[0]} moves: sensor absent or"
                " not logged"
            )
            out.append(
                Finding("frozen", name, "error", text, {"value": value}, affected_results(name))
            )
        # Constant density is an assumption of many logs, not a fault.
        elif name != "rho_kgpm3":
            text = (
                f"{name} is {value:g} throughout; no other channel shows that it should have"
                " changed"
            )
            out.append(Finding("frozen", name, "info", text, {"value": value}))
    return out


def check_units(record: FlightRecord) -> list[Finding]:
    """Check ranges, units and signs of a table's channels.

    Parameters
    ----------
    record : FlightRecord
        Record made from the table.

    Returns
    -------
    list of Finding
        Codes "out-of-range", "unit" and "sign", one for each cause.
    """
    out = check_ranges(record)
    if len(record) > 1:
        out += [f for f in check_motion(record) if f.code in ("unit", "sign")]
    return one_per_cause(out)


def check_ranges(record: FlightRecord) -> list[Finding]:
    """Return findings on channels outside the vocabulary's ranges."""
    groups = [
        _range(n, record.metadata.channels.get(n, "column"), v, record.metadata)
        for n, v in record.columns.items()
        if n not in LABELS
    ]
    return [f for group in groups for f in group]


_RECORD_CODES = frozenset(
    {
        "time-unit",
        "unit",
        "sign",
        "kinematics-disagree",
        "delay",
        "lever-arm",
        "frozen",
        "stuck",
        "negative-airspeed",
        "dropouts",
        "out-of-range",
        "sample-and-hold",
        "interpolated",
        "quantised",
    }
)
"""Codes of findings that depend on the record alone."""


def recheck(record: FlightRecord) -> list[Finding]:
    """Return the findings of a record by the current checks.

    Findings about the log that it was made from are kept; all that the record itself shows is new.
    """
    if len(record) < 3:
        return list(record.metadata.findings)
    declared = record.metadata.estimates
    scaled_channels = {n for n, label in record.metadata.channels.items() if has_factor(label)}
    log_findings = [
        f
        for f in record.metadata.findings
        if (f.code not in _RECORD_CODES and (f.code != "estimate" or f.channel in declared))
        or (f.code == "stuck" and f.channel in scaled_channels)
    ]
    free = record.metadata.free_flight_s
    start, end = float(record["time_s"][0]), float(record["time_s"][-1])
    span = (max(start, free[0][0]), min(end, free[0][1])) if free else (start, end)
    span = span if span[1] > span[0] else (start, end)
    with np.errstate(all="ignore"):  # damaged values may overflow
        new = [*check_ranges(record), *_samples(record), *check_record(record, span)]
    return one_per_cause([*log_findings, *new])


def _samples(record: FlightRecord) -> list[Finding]:
    """Return findings on held, coarse and interpolated channels of a record.

    Channels that the import itself interpolated are left out.
    """
    out = []
    rate = 1.0 / record.dt_s if len(record) > 1 else float("nan")
    for name, values in record.columns.items():
        if (
            name in LABELS
            or name == "time_s"
            or SIGNALS[name].kind == "heading"
            or name in _GUIDANCE
        ):
            continue
        if record.metadata.native_hz.get(name, rate) < 0.75 * rate:
            continue
        no_damage = CleanTime(
            np.ones(len(values), dtype=bool), record.dt_s, 0, 0, 0.0, np.zeros((0, 2))
        )
        out += _resolution_findings(
            name, Channel(name, "column", record["time_s"], values, no_damage, False)
        )
    return out


def in_degrees(finding: Finding) -> bool:
    """Return whether a finding says that a channel is wrong by the factor between degrees and
    radians.

    Parameters
    ----------
    finding : Finding
        With the code "out-of-range" or "unit"; other codes give False.
    """
    ratio = abs(finding.numbers.get("slope", 1.0))
    largest = max(abs(finding.numbers.get("low", 0.0)), abs(finding.numbers.get("high", 0.0)))
    by_range = (
        finding.code == "out-of-range"
        and finding.severity == "error"
        and SIGNALS[finding.channel].unit == "rad"
    )
    return (by_range and largest > 2.0 * np.pi) or (
        finding.code == "unit" and not 1 / 45.0 <= ratio <= 45.0
    )
