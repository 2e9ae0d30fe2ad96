"""Errors of uncalibrated air data, from attitude and ground velocity.

Scale of the airspeed: V = s |ground velocity - wind|, in flight that turns through the wind. Scale
and offset of angle of attack and sideslip: the measured angle against that of the motion through
the mean wind. A late ground velocity is moved to the accelerations first. Each error has a normal
prior, and the scatter between blocks of time gives its standard error; a flight that does not
determine an error leaves its prior.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from sysid.aerodynamics import smooth
from sysid.arrays import FloatArray
from sysid.logs import alpha_of, beta_of, to_earth
from sysid.record import FlightRecord
from sysid.units import G0_MPS2

PRIOR = {
    ("V_mps", "scale"): (1.0, 0.05),
    ("alpha_rad", "scale"): (1.0, 0.3),
    ("alpha_rad", "offset"): (0.0, 0.05),
    ("beta_rad", "scale"): (1.0, 0.3),
    ("beta_rad", "offset"): (0.0, 0.05),
    ("h_m", "position"): (0.0, 0.1),
}
"""Mean and standard deviation of a sensor's scale and offset (rad) before the flight: a probe
beside a fuselage or wing reads angles wrong by up to a half, speeds by some percent, and static
pressure by some percent of the dynamic one."""
BLOCK_S = 20.0
_MIN_SAMPLES = 40
_PITCH_STD_RAD, _HEADING_STD_RAD = 0.015, 0.05
"""Standard deviation of a constant error of pitch angle and magnetic heading, rad."""
_MIN_TURN_RAD = 1.5  # of the course, below which wind and airspeed cannot be told apart


@dataclass(frozen=True)
class AirDataError:
    """Scale or offset of an air-data channel: truth = (reading - offset) / scale. The position
    error is that of a barometer's static port, as a share of the dynamic pressure.

    Attributes
    ----------
    channel, kind : str
        Channel, and "scale", "offset" (rad) or "position".
    value, std : float
        Estimate and standard error.
    basis : str
        "data", "prior and data" or "prior only".
    """

    channel: str
    kind: str
    value: float
    std: float
    basis: str

    def text(self) -> str:
        """Describe the error with its 95 % interval."""
        half = 1.96 * self.std
        if self.kind == "scale":
            return (
                f"{self.channel} reads {self.value:.2f} ± {half:.2f} times the truth ({self.basis})"
            )
        if self.kind == "position":
            return (
                f"{self.channel} rises by {self.value:.2f} ± {half:.2f} times V^2/2g with airspeed"
                f" (position error of static pressure, {self.basis})"
            )
        return (
            f"{self.channel} is offset by {np.degrees(self.value):.1f} ±"
            f" {np.degrees(half):.1f} deg ({self.basis})"
        )


def basis_of(std: float, prior_std: float) -> str:
    """Return where a value comes from, by the share of information that the flight adds to the
    prior: below a fifth nothing to speak of, above nine tenths all.
    """
    added = 1.0 - (std / prior_std) ** 2
    return "prior only" if added < 0.2 else "data" if added > 0.9 else "prior and data"


def combine(value: float, std: float, prior: tuple[float, float]) -> tuple[float, float]:
    """Return mean and standard deviation of a normal prior with a normal measurement."""
    if not np.isfinite(std):
        return prior
    weight = prior[1] ** 2 / (prior[1] ** 2 + std**2)
    return prior[0] + weight * (value - prior[0]), float(np.sqrt(weight) * std)


def air_data_errors(record: FlightRecord) -> list[AirDataError]:
    """Estimate scale and offset of the measured air data.

    Parameters
    ----------
    record : FlightRecord
        Flight; without ground velocity and heading the priors remain.
    """
    late_s = velocity_lateness(record)
    record, shifted = (_with_earlier_velocity(record, s) for s in (late_s, late_s + _LATE_STD_S))
    speed = _speed_scale(record)
    estimates = {("V_mps", "scale"): combine(*speed[:2], PRIOR["V_mps", "scale"])}
    if np.isfinite(speed[1]) and "psi_rad" in record:
        angles, shifted_angles = (_angle_errors(r, speed[2]) for r in (record, shifted))
        # A turn begins within a second: what a later velocity changes is an error too.
        for key, (value, std) in angles.items():
            change = shifted_angles[key][0] - value if key in shifted_angles and late_s else 0.0
            estimates[key] = value, float(np.hypot(std, change))
    if (position := _position_error(record)) is not None:
        estimates["h_m", "position"] = combine(*position, PRIOR["h_m", "position"])
    out = []
    for (channel, kind), prior in PRIOR.items():
        if kind == "position" and (channel, kind) not in estimates:
            continue
        if channel not in record or channel in record.metadata.estimates:
            continue
        value, std = estimates.get((channel, kind), prior)
        out.append(AirDataError(channel, kind, value, std, basis_of(std, prior[1])))
    return out


def velocity_lateness(record: FlightRecord) -> float:
    """Return how late the ground velocity follows the accelerations, s; 0 without these.

    A satellite receiver holds and filters its velocity. The delay is the one at which the velocity
    is nearest to the integral of the accelerations, apart from a drift and constant errors of the
    accelerometers in each block of time.
    """
    names = ("ax_mps2", "ay_mps2", "az_mps2", "phi_rad", "theta_rad", "psi_rad")
    velocities = ("vn_mps", "ve_mps", "vd_mps")
    if not all(n in record for n in (*names, *velocities)):
        return 0.0
    columns = {n: np.asarray(record[n], dtype=float) for n in (*names, *velocities)}
    time_s, usable = record["time_s"], np.ones(len(record), dtype=bool)
    for values in columns.values():
        usable &= np.isfinite(values)
    if usable.sum() < _MIN_SAMPLES * 5:
        return 0.0
    # The integral of each body axis: constant errors of the accelerometers turn with the aircraft.
    axes = np.stack([to_earth(columns, np.outer(row, np.ones(len(time_s)))) for row in np.eye(3)])
    force = np.stack([columns[n] for n in names[:3]])
    earth = np.einsum("ijk,ik->jk", axes, force)
    earth[2] += G0_MPS2
    integral = np.cumsum(np.nan_to_num(earth), axis=1) * record.dt_s
    drifts = np.cumsum(np.nan_to_num(axes), axis=2) * record.dt_s
    block = _blocks(time_s)
    lags = np.arange(0.0, _MAX_LATE_S, 0.02)
    cost = np.zeros(len(lags))
    for b in np.unique(block):
        part = (block == b) & usable
        if part.sum() < 0.5 * BLOCK_S / record.dt_s:
            continue
        t = time_s[part]
        t0 = t - t.mean()
        for axis, name in enumerate(velocities):
            drift = np.column_stack([np.ones(len(t)), t0, t0**2, *drifts[:, axis, part]])
            q = np.linalg.qr(drift)[0]
            for k, lag in enumerate(lags):
                residual = np.interp(t + lag, time_s[usable], columns[name][usable])
                residual -= integral[axis][part]
                residual -= q @ (q.T @ residual)
                cost[k] += float(residual @ residual)
    return float(lags[int(np.argmin(cost))]) if cost.any() else 0.0


_MAX_LATE_S, _LATE_STD_S = 1.0, 0.04
"""Largest delay of a ground velocity, and the error of its estimate, s."""


def _with_earlier_velocity(record: FlightRecord, late_s: float) -> FlightRecord:
    """Return the record with the ground velocity moved to earlier times."""
    time_s = record["time_s"]
    names = [n for n in ("vn_mps", "ve_mps", "vd_mps") if n in record and late_s]
    columns = {}
    for n in names:
        rows = np.isfinite(record[n])
        columns[n] = np.interp(time_s + late_s, time_s[rows], record[n][rows], right=np.nan)
    return record.with_columns(columns)


def _blocks(time_s: FloatArray) -> FloatArray:
    """Return the number of the block of time of each row."""
    return np.floor((time_s - time_s[0]) / BLOCK_S).astype(int)


def _speed_scale(record: FlightRecord) -> tuple[float, float, FloatArray]:
    """Return scale of the airspeed, standard error, and wind (north, east) [m/s].

    The error is that of a jackknife over blocks, in each of which the wind may differ; infinite
    without turns.
    """
    names = ("vn_mps", "ve_mps", "V_mps")
    no_estimate = (1.0, np.inf, np.zeros(2))
    if not all(n in record for n in names):
        return no_estimate
    north, east, speed = (record[n] for n in names)
    down = record.columns.get("vd_mps", np.zeros(len(record)))
    usable = np.isfinite(north) & np.isfinite(east) & np.isfinite(speed) & np.isfinite(down)
    rows = np.flatnonzero(usable)[:: max(1, round(0.5 / record.dt_s))]
    if len(rows) < _MIN_SAMPLES:
        return no_estimate
    course = np.unwrap(np.arctan2(east[rows], north[rows]))
    if np.ptp(course) < _MIN_TURN_RAD:
        return no_estimate

    def fit(chosen: FloatArray) -> FloatArray:
        """Return wind and scale of the rows chosen."""
        at = rows[chosen]

        def left(x: FloatArray) -> FloatArray:
            air = np.sqrt((north[at] - x[0]) ** 2 + (east[at] - x[1]) ** 2 + down[at] ** 2)
            return speed[at] - x[2] * air

        return np.asarray(least_squares(left, np.array([0.0, 0.0, 1.0]), loss="soft_l1").x)

    value, std = _jackknife(lambda chosen: float(fit(chosen)[2]), _blocks(record["time_s"][rows]))
    return value, std, fit(np.ones(len(rows), dtype=bool))[:2]


def _position_error(record: FlightRecord) -> tuple[float, float] | None:
    """Return by what share of V^2/2g a barometric height rises with airspeed, and its error.

    Heights less the integral of the vertical speed are regressed in each block of time, with a
    drift; a late velocity adds a multiple of itself.
    """
    if not all(n in record for n in ("h_m", "vd_mps", "V_mps")):
        return None
    h, climb, speed = record["h_m"], -record["vd_mps"], record["V_mps"]
    rows = np.flatnonzero(np.isfinite(h) & np.isfinite(climb) & np.isfinite(speed))
    if len(rows) < _MIN_SAMPLES * 5:
        return None
    path = np.cumsum(np.nan_to_num(climb)) * record.dt_s
    block = _blocks(record["time_s"][rows])
    x = np.column_stack([speed**2 / (2.0 * G0_MPS2), climb])[rows]
    y = (h - path)[rows]
    for b in np.unique(block):
        part = block == b
        level = np.column_stack([np.ones(part.sum()), np.arange(part.sum())])
        for values in (y, *x.T):
            values[part] -= level @ np.linalg.lstsq(level, values[part], rcond=None)[0]
    return _jackknife(
        lambda chosen: float(np.linalg.lstsq(x[chosen], y[chosen], rcond=None)[0][0]), block
    )


def _angle_errors(
    record: FlightRecord, wind_mps: FloatArray
) -> dict[tuple[str, str], tuple[float, float]]:
    """Return channel and kind to estimate and standard error of the angles' errors.

    The angles of the motion through the mean wind lack the gusts, to which the aircraft answers.
    Turns command angles that no gust causes: the load factor 1 / cos(phi) and the bank angle are
    instruments, which the gusts do not enter. Priors are included.
    """
    phi, theta, psi = (record[f"{c}_rad"] for c in ("phi", "theta", "psi"))
    down = record.columns.get("vd_mps", np.zeros(len(record)))
    alpha, beta = motion_angles(
        np.column_stack([record["vn_mps"] - wind_mps[0], record["ve_mps"] - wind_mps[1], down]),
        np.column_stack([phi, theta, psi]),
    )
    # Ten samples a second: gusts correlate over longer times.
    out: dict[tuple[str, str], tuple[float, float]] = {}
    load = 1.0 / np.maximum(np.cos(phi), 0.2)
    step = max(1, round(0.1 / record.dt_s))
    for channel, true, instrument, attitude_std in (
        ("alpha_rad", alpha, load, _PITCH_STD_RAD),
        ("beta_rad", beta, np.sin(phi), _HEADING_STD_RAD),
    ):
        if channel not in record:
            continue
        reading = record[channel]
        usable = np.isfinite(reading) & np.isfinite(true) & np.isfinite(instrument)
        rows = np.flatnonzero(usable)[::step]
        if len(rows) < _MIN_SAMPLES:
            continue
        x, y, lever = true[rows], reading[rows], instrument[rows] - instrument[rows].mean()
        slope, slope_std = _scale_posterior(x, y, lever, PRIOR[channel, "scale"])
        out[channel, "scale"] = slope, slope_std
        # The offset is taken at the scale that prior and flight give together.
        difference = y - slope * x
        offset = float(difference.mean())
        standard_error = _sum_std(np.ones(len(y)), difference - offset) / len(y)
        # A misaligned attitude is an offset of the true angle.
        parts = (standard_error, slope * attitude_std, slope_std * float(x.mean()))
        out[channel, "offset"] = combine(
            offset, float(np.linalg.norm(parts)), PRIOR[channel, "offset"]
        )
    return out


_SCALES = np.linspace(0.05, 3.0, 60)


def _scale_posterior(
    x: FloatArray, y: FloatArray, lever: FloatArray, prior: tuple[float, float]
) -> tuple[float, float]:
    """Return mean and standard deviation of the scale s of y = s x + c + gust, with its prior.

    The instrument ``lever`` (n,) of mean zero is orthogonal to the gust at the true scale. The
    variance of that product is taken at each scale, so that an instrument that hardly moves x says
    little (Anderson and Rubin, Ann. Math. Stat. 20 (1949) 46), where an estimate with a standard
    error would be far off and sure of itself.
    """
    x, y = x - x.mean(), y - y.mean()
    errors = [y - s * x for s in _SCALES]
    square = np.array([(lever @ e / max(_sum_std(lever, e), 1e-300)) ** 2 for e in errors])
    square += ((_SCALES - prior[0]) / prior[1]) ** 2
    weights = np.exp(-0.5 * (square - square.min()))
    weights /= weights.sum()
    mean = float(weights @ _SCALES)
    # Half a step of the grid is the least that it resolves.
    step = 0.5 * float(_SCALES[1] - _SCALES[0])
    return mean, float(np.sqrt(max(weights @ (_SCALES - mean) ** 2, step**2)))


def _sum_std(weights: FloatArray, error: FloatArray) -> float:
    """Return the standard deviation of a weighted sum of correlated errors of mean zero.

    Turns and gusts last longer than a block of time, so that blocks are no independent draws. The
    variance is the sum of products of both autocovariances, up to the first zero of either
    (Bartlett, J. R. Stat. Soc. 98 (1935) 536).
    """
    n = len(error)
    total = float(weights @ weights) * float(error @ error) / n
    for lag in range(1, n // 3):
        pair = [float(v[lag:] @ v[:-lag]) for v in (weights, error)]
        if min(pair) <= 0.0:
            break
        total += 2.0 * pair[0] * pair[1] / (n - lag)
    return float(np.sqrt(total))


def motion_angles(velocity: FloatArray, attitude: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return angle of attack and sideslip (n,) [rad] of a motion through still air.

    Parameters
    ----------
    velocity : ndarray of shape (n, 3)
        North, east, down, m/s.
    attitude : ndarray of shape (n, 3)
        Roll, pitch, heading, rad.

    Examples
    --------
    >>> alpha, beta = motion_angles(np.array([[20.0, 0.0, 0.0]]), np.array([[0.0, 0.1, 0.0]]))
    >>> float(alpha[0].round(6)), float(beta[0].round(6))
    (0.1, 0.0)
    """
    phi, theta, psi = attitude.T
    north, east, down = velocity.T
    forward = north * np.cos(psi) + east * np.sin(psi)
    right = -north * np.sin(psi) + east * np.cos(psi)
    u = forward * np.cos(theta) - down * np.sin(theta)
    below = forward * np.sin(theta) + down * np.cos(theta)
    v = right * np.cos(phi) + below * np.sin(phi)
    w = -right * np.sin(phi) + below * np.cos(phi)
    return alpha_of(u, w), beta_of(u, v, w)


def _jackknife(fit: object, block: FloatArray) -> tuple[float, float]:
    """Return an estimate and its standard error by leaving out each block."""
    assert callable(fit)
    numbers = np.unique(block)
    value = fit(np.ones(len(block), dtype=bool))
    if len(numbers) < 3:
        return value, np.inf
    estimates = np.array([fit(block != n) for n in numbers])
    b = len(numbers)
    return value, float(np.sqrt((b - 1) / b * np.sum((estimates - estimates.mean()) ** 2)))


def motion_angle(record: FlightRecord, channel: str, time_constant_s: float) -> FloatArray:
    """Return the fast part of angle of attack or sideslip that the motion explains, rad, (n,).

    alpha' = q + (az + g cos theta cos phi) / V, beta' = p sin alpha - r + (ay + g cos theta sin
    phi) / V for small angles, integrated without the parts slower than the time constant.
    """
    speed = np.maximum(record["V_mps"], 1.0)
    phi, theta = record["phi_rad"], record["theta_rad"]
    p, q, r = (record[f"{c}_radps"] for c in "pqr")
    if channel == "alpha_rad":
        rate = q + (record["az_mps2"] + G0_MPS2 * np.cos(theta) * np.cos(phi)) / speed
        if "beta_rad" in record:
            rate = rate - p * record["beta_rad"]
    else:
        alpha = record.columns.get("alpha_rad", theta)
        rate = (
            p * np.sin(alpha)
            - r * np.cos(alpha)
            + (record["ay_mps2"] + G0_MPS2 * np.cos(theta) * np.sin(phi)) / speed
        )
    rate = np.where(np.isfinite(rate), rate, 0.0)
    keep = np.exp(-record.dt_s / time_constant_s)
    out = np.zeros(len(rate))
    for k in range(1, len(rate)):
        out[k] = keep * out[k - 1] + 0.5 * record.dt_s * (rate[k] + rate[k - 1])
    return smooth(out[:, None], record.dt_s, 3.0)[:, 0]
