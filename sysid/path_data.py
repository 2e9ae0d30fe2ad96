"""What path reconstruction works on: stretches without gaps, channels at the rows really logged, input noise."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal as dsp

from sysid.flight_record import FlightRecord
from sysid.log_errors import LogError
from sysid.path_kinematics import INPUTS, NAMES, OUTPUTS, to_cg
from sysid.path_smoother import Stretch

FloatArray = NDArray[np.float64]
_NEEDED = (*INPUTS, "V_mps", "phi_rad", "theta_rad", "psi_rad")
_GROUND = ("vn_mps", "ve_mps", "vd_mps", "north_m", "east_m")
FIRST_NOISE = {
    "V_mps": 0.5, "alpha_rad": 0.01, "beta_rad": 0.01, "phi_rad": 0.01, "theta_rad": 0.01, "psi_rad": 0.02,
    "h_m": 1.5, "vn_mps": 0.3, "ve_mps": 0.3, "vd_mps": 0.3, "north_m": 2.0, "east_m": 2.0,
}  # fmt: skip
# Above the motion of small aircraft, below the autopilots' input filters: here the sensors' own noise is seen.
_NOISE_BAND_HZ = (4.0, 9.0)
MAX_HZ = 60.0
# Least noise of a compared channel, as a share of FIRST_NOISE: attitudes and positions of an autopilot are estimates
# made with the same gyros, and agreeing with them better than this proves nothing.
NOISE_FLOOR = 0.05
_LEAST_INPUT = np.array([1e-3, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5])


@dataclass(frozen=True)
class PathData:
    """Stretches of a record, the channels compared, and what was done to them (notes)."""

    stretches: tuple[Stretch, ...]
    spans_s: tuple[tuple[float, float], ...]
    dt_s: float
    channels: tuple[str, ...]
    notes: tuple[str, ...]


def thinned(record: FlightRecord) -> FlightRecord:
    """The record on a grid of at most `MAX_HZ`: inputs averaged over blocks, the rest taken at the block's middle.

    An odd number of rows makes a block, so that its middle is a row.
    """
    block = int(np.ceil(1.0 / (record.dt_s * MAX_HZ) - 1e-9))
    block += 1 - block % 2
    if block <= 1:
        return record
    count = len(record) // block
    out = record.rows(np.isin(np.arange(len(record)), np.arange(count) * block + block // 2))
    means = {c: record[c][: count * block].reshape(count, block).mean(axis=1) for c in INPUTS if c in record}
    return out.with_columns(means)


def build(
    record: FlightRecord,
    min_s: float,
    max_s: float,
    arm_m: tuple[float, float, float],
    delays_s: Mapping[str, float] | None,
    use_estimates: bool,
) -> PathData:
    """Cut the record into stretches. LogError when channels are missing or no stretch is long enough."""
    missing = [n for n in _NEEDED if n not in record]
    if missing:
        raise LogError(f"path reconstruction needs {', '.join(_NEEDED)}; the record has no {', '.join(missing)}")
    dt = record.dt_s
    delays = _known_delays(record) if delays_s is None else dict(delays_s)
    estimates = set() if use_estimates else set(record.metadata.estimates)
    names = [c for c in OUTPUTS if c in record and c not in estimates and np.isfinite(record[c]).any()]
    notes = [f"{c} is an estimate and was not compared" for c in sorted(estimates & set(OUTPUTS) & set(record.columns))]
    notes += [f"{c} was moved {delays[c] * 1e3:.0f} ms earlier" for c in names if abs(delays.get(c, 0.0)) > 1e-9]
    rows = _stretches(record, min_s, max_s)
    if not rows:
        longest = max((s.stop - s.start for s in record.segments(_NEEDED)), default=0) * dt
        raise LogError(
            f"no stretch of {min_s:g} s without a gap in {', '.join(_NEEDED)} (the longest is {longest:.1f} s);"
            " nothing is integrated across gaps"
        )
    measured = np.full((len(OUTPUTS), len(record)), np.nan)
    native = record.metadata.native_hz
    for c in names:
        stride = max(1, round(1.0 / (dt * native[c]))) if native.get(c, 0.0) > 0 else 1
        moved = _earlier(record[c], delays.get(c, 0.0) / dt, c)
        # A channel slower than the grid counts once for every time it was logged.
        first = _logged_row(moved, stride)
        measured[OUTPUTS.index(c), first::stride] = moved[first::stride]
    drive = np.stack([record[c] for c in INPUTS])
    stretches = tuple(Stretch(s, to_cg(drive[:, s], arm_m, dt), measured[:, s]) for s in rows)
    time = record["time_s"]
    spans = tuple((float(time[s.start]), float(time[s.stop - 1])) for s in rows)
    return PathData(stretches, spans, dt, tuple(names), tuple(notes))


def _logged_row(values: FloatArray, stride: int) -> int:
    """First of the rows at which a filled-in channel was really logged: a straight line bends at those alone."""
    bends = np.abs(np.diff(values, 2))
    if stride <= 1 or len(bends) < 4 * stride or not np.isfinite(bends).any():
        return 0
    sums = [np.nansum(bends[(first - 1) % stride :: stride]) for first in range(stride)]
    return int(np.argmax(sums))


def _known_delays(record: FlightRecord) -> dict[str, float]:
    out: dict[str, float] = {}
    for f in record.metadata.findings:
        if f.code == "delay":
            channels = _GROUND if f.channel == "ground velocity" else (f.channel,)
            out |= {c: f.numbers["delay_s"] for c in channels if c in record}
    return out


def _stretches(record: FlightRecord, min_s: float, max_s: float) -> list[slice]:
    out = []
    for segment in record.segments(_NEEDED, min_s):
        parts = max(1, int(np.ceil((segment.stop - segment.start) * record.dt_s / max_s)))
        edges = np.linspace(segment.start, segment.stop, parts + 1).astype(int)
        out += [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
    return out


def _earlier(values: FloatArray, shift: float, name: str) -> FloatArray:
    """Values moved `shift` rows earlier (linear between rows), NaN where nothing is known."""
    if abs(shift) < 1e-6:
        return np.asarray(values)
    rows = np.arange(len(values))
    turned = values.copy()
    good = np.isfinite(values)
    if name in ("psi_rad", "phi_rad"):
        turned[good] = np.unwrap(values[good])
    out = np.interp(rows + shift, rows, turned, left=np.nan, right=np.nan)
    return np.mod(out, 2 * np.pi) if name == "psi_rad" else out


def first_path(stretch: Stretch) -> FloatArray:
    """(24, n) path to linearise about first: the measured channels themselves, zero sensor errors and wind."""
    n = stretch.drive.shape[1]
    at = np.arange(n)
    filled = {}
    for c, values in zip(OUTPUTS, stretch.measured, strict=True):
        good = np.isfinite(values)
        turned = np.unwrap(values[good]) if c in ("phi_rad", "psi_rad") else values[good]
        filled[c] = np.interp(at, at[good], turned) if good.any() else np.zeros(n)
    speed = np.maximum(filled["V_mps"], 1.0)
    alpha, beta = filled["alpha_rad"], filled["beta_rad"]
    out = np.zeros((len(NAMES), n))
    out[0] = speed * np.cos(alpha) * np.cos(beta)
    out[1] = speed * np.sin(beta)
    out[2] = speed * np.sin(alpha) * np.cos(beta)
    for k, c in enumerate(("phi_rad", "theta_rad", "psi_rad", "h_m", "north_m", "east_m")):
        out[3 + k] = filled[c]
    return out


def input_noise(data: PathData) -> FloatArray:
    """(6,) standard deviation per step of white noise as strong as the inputs' noise inside `_NOISE_BAND_HZ`."""
    rate = 1.0 / data.dt_s
    high = min(_NOISE_BAND_HZ[1], 0.45 * rate)
    low = min(_NOISE_BAND_HZ[0], 0.5 * high)
    longest = max(data.stretches, key=lambda s: s.drive.shape[1]).drive
    frequency, density = dsp.welch(longest, fs=rate, nperseg=min(longest.shape[1], round(4 * rate)), detrend="linear")
    inside = (frequency >= low) & (frequency <= high)
    # One-sided density S of white noise sampled at `rate` with standard deviation s: S = 2 s^2 / rate.
    return np.maximum(np.sqrt(np.median(density[:, inside], axis=1) * rate / 2.0), _LEAST_INPUT)
