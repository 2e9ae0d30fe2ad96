"""Kinematic relations between the channels of a flight, for any rigid body.

Each `Law` states that a channel, or a quantity derived from it, equals one derived from other
channels. `relate` estimates scale, sign and delay of one signal against the other, and
`estimate_relation` applies it to a law; `lever_arm` estimates the position of the accelerometers.
Equations of motion of the centre of gravity: Etkin and Reid, "Dynamics of Flight", 3rd ed. 1996,
4.3, 4.7.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from sysid.arrays import FloatArray
from sysid.errors import Finding
from sysid.logs.channels import components_of
from sysid.record import FlightRecord
from sysid.units import G0_MPS2

# Two noisy signals that should be equal: scale, sign and delay of one against the other.
#
# y(t) = k x(t - tau), both with noise of unknown size at every frequency
#
# Noise in x biases the regression of y on x (H1) towards zero, and noise in y biases the reverse
# regression (H2) upwards, so that the true scale lies between the two (Bendat and Piersol, "Random
# Data", 4th ed. 2010, 6.1.4 and 9.2). Only bands count whose coherence is significant.

ComplexArray = NDArray[np.complexfloating]
SURE = 3.0
"""Standard errors on either side of the possible scales."""
_BANDS, _MIN_BINS = 12, 6
# Probability that a band of pure noise counts, over all bands. It is small because the search
# for delay and sign favours chance.
_CHANCE = 1e-5
_FLOOR = 0.01  # relative accuracy of the best sensors
_MAX_LATE_S, _LATE_STEP_S = 0.5, 0.005
_TAPER = 0.2  # share of a stretch that is tapered at either end
TAPERED = 1.26
"""Factor by which the taper raises the variance of sums over frequencies: mean w^4 / (mean w^2)^2.
"""
LEAK = 5e-3
"""Share of the strongest band's power. A weaker band holds leakage, with the phase of the strong
one.
"""
# Factor by which the reversed sign must explain more: in a narrow band a delay looks like a
# sign.
_SIGN_MARGIN = 1.15


@dataclass(frozen=True)
class Relation:
    """The relation y = scale * x(t - late_s).

    Attributes
    ----------
    low, high : float
        Limits of the scale: SURE standard errors and the noise of both signals; negative for a
        reversed sign.
    late_s, late_std_s : float
        Delay and its standard error, s.
    coherence : float
        Mean coherence of the bands that count.
    bands : int
        Number of bands that count; 0 is no evidence.
    """

    low: float
    high: float
    late_s: float
    late_std_s: float
    coherence: float
    bands: int

    @property
    def evident(self) -> bool:
        """Whether the signals have more in common than chance gives."""
        return self.bands > 0

    @property
    def scale(self) -> float:
        """Geometric mean of ``low`` and ``high``; NaN without evidence."""
        return (
            math.copysign(math.sqrt(self.low * self.high), self.low)
            if self.evident
            else float("nan")
        )

    def allows(self, scale: float, tolerance: float = 0.0) -> bool:
        """Return whether the scale may be this one, within a relative tolerance on either side."""
        low, high = sorted((self.low, self.high))
        smallest, largest = sorted((scale * (1.0 + tolerance), scale / (1.0 + tolerance)))
        return self.evident and low <= largest and high >= smallest


NO_RELATION = Relation(float("nan"), float("nan"), float("nan"), float("inf"), 0.0, 0)


def relate(
    x: Sequence[FloatArray], y: Sequence[FloatArray], dt_s: float, low_hz: float, high_hz: float
) -> Relation:
    """Estimate the relation of y to x in a frequency band.

    Parameters
    ----------
    x, y : sequence of ndarray of shape (n,)
        Stretches without gaps.
    dt_s : float
        Step of the samples, s.
    low_hz, high_hz : float
        Band.

    Returns
    -------
    Relation
        `NO_RELATION` if no band has significant coherence.
    """
    parts = [spectrum(a, b, dt_s, low_hz, high_hz) for a, b in zip(x, y, strict=True)]
    if not parts:
        return NO_RELATION
    frequency = np.concatenate([part[0] for part in parts])
    fx, fy = (np.concatenate([part[k] for part in parts]) for k in (1, 2))
    power = np.sum(np.abs(fx) ** 2) * np.sum(np.abs(fy) ** 2)
    if frequency.size < _MIN_BINS or not power > 0.0:
        return NO_RELATION
    groups = groups_of(frequency, low_hz, high_hz)
    # Delay and sign on a grid first; the phases then give the rest of the delay.
    late, sign = _coarse_lateness(frequency, fx, fy, groups)
    aligned = sign * fy * np.exp(2j * np.pi * frequency * late)
    rows = []
    strongest = max(float(np.mean(np.abs(fx[group]) ** 2)) for group in groups)
    for group in groups:
        if float(np.mean(np.abs(fx[group]) ** 2)) < LEAK * strongest:
            continue
        a, b, k = fx[group], aligned[group], float(np.count_nonzero(group))
        xx, yy, xy = (
            float(np.sum(np.abs(a) ** 2)),
            float(np.sum(np.abs(b) ** 2)),
            complex(np.sum(np.conj(a) * b)),
        )
        # Coherence of the band, its probability by chance, and the variance of the log scale.
        shared = abs(xy) ** 2 / (xx * yy) if xx * yy > 0.0 else 0.0
        chance = (1.0 - min(shared, 1.0)) ** (k - 1.0)
        if chance * len(groups) >= _CHANCE:
            continue
        variance = (1.0 - min(shared, 1.0)) / (2.0 * k * shared) + _FLOOR**2
        center = 2.0 * np.pi * float(np.sum(np.abs(a) ** 2 * frequency[group]) / xx)
        # Logarithms of H1 and H2, phase, and mean frequency weighted by power.
        rows.append(
            (
                1.0 / variance,
                math.log(abs(xy) / xx),
                math.log(yy / abs(xy)),
                np.angle(xy),
                center,
                shared,
            )
        )
    if not rows:
        return NO_RELATION
    weight, first, second, phase, omega, shared_all = (
        np.array(column, dtype=np.float64) for column in zip(*rows, strict=True)
    )
    if not np.all(np.isfinite(first + second)) or np.sum(weight * np.cos(phase)) <= 0.0:
        return NO_RELATION
    information = float(weight.sum())
    middle = float(weight @ first) / information
    # Bands that disagree show that more than noise separates the signals: inflate the variance.
    excess = max(1.0, float(weight @ (first - middle) ** 2) / max(1, len(rows) - 1))
    std = math.sqrt(excess / information)
    information_s2 = float(weight @ omega**2)
    # Weighted regression of the phase on frequency.
    fine_late = -float(weight @ (omega * phase)) / information_s2
    phase_excess = max(
        1.0, float(weight @ (phase + omega * fine_late) ** 2) / max(1, len(rows) - 1)
    )
    ends = (middle - SURE * std, float(weight @ second) / information + SURE * std)
    return Relation(
        sign * math.exp(ends[0]),
        sign * math.exp(ends[1]),
        late + fine_late,
        math.sqrt(phase_excess / information_s2),
        float(weight @ shared_all) / information,
        len(rows),
    )


def relate_means(x: FloatArray, y: FloatArray) -> Relation:
    """Estimate the relation of block means, shape (n,), their mean included: for steady
    quantities.

    Blocks count as independent. The delay is NaN.
    """
    is_finite = np.isfinite(x) & np.isfinite(y)
    x, y = x[is_finite], y[is_finite]
    n = x.size
    xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
    if n < _MIN_BINS or not xx * yy > 0.0 or xy == 0.0:
        return NO_RELATION
    shared = min(1.0, xy**2 / (xx * yy))
    if math.exp(0.5 * (n - 1.0) * math.log(max(1.0 - shared, 1e-300))) >= _CHANCE:
        return NO_RELATION
    std = math.sqrt((1.0 - shared) / (n * shared) + _FLOOR**2)
    sign = math.copysign(1.0, xy)
    first, second = math.log(abs(xy) / xx), math.log(yy / abs(xy))
    return Relation(
        sign * math.exp(first - SURE * std),
        sign * math.exp(second + SURE * std),
        float("nan"),
        float("inf"),
        shared,
        1,
    )


def spectrum(
    x: FloatArray, y: FloatArray, dt_s: float, low_hz: float, high_hz: float
) -> tuple[FloatArray, ComplexArray, ComplexArray]:
    """Return the frequencies in a band and the Fourier transforms of x and y there.

    The signals are detrended and tapered at both ends.
    """
    n = x.size
    at = np.linspace(-1.0, 1.0, n)
    edge = np.clip(
        np.minimum(np.arange(n) + 0.5, n - np.arange(n) - 0.5) / max(1.0, _TAPER * n), 0.0, 1.0
    )
    taper = 0.5 - 0.5 * np.cos(np.pi * edge)
    frequency = np.asarray(np.fft.rfftfreq(n, dt_s), dtype=np.float64)
    inside = (frequency >= low_hz) & (frequency <= high_hz)
    out = []
    for values in (x, y):
        level = values - values.mean()
        detrended = level - at * float(at @ level) / float(at @ at)
        out.append(np.fft.rfft(detrended * taper)[inside] / math.sqrt(n))
    return frequency[inside], out[0], out[1]


def band_passed(x: FloatArray, dt_s: float, low_hz: float, high_hz: float) -> FloatArray:
    """Filter (..., n) to a band without delay, mirrored at the ends.

    The gain is that of second-order Butterworth high-pass and low-pass filters, each run forwards
    and backwards.
    """
    n = x.shape[-1]
    frequency = np.arange(1, n) / (2.0 * n * dt_s)
    gain = 1.0 / ((1.0 + (low_hz / frequency) ** 4) * (1.0 + (frequency / high_hz) ** 4))
    return np.asarray(
        fft.idct(fft.dct(x, norm="ortho") * np.concatenate([[0.0], gain]), norm="ortho")
    )


def groups_of(frequency: FloatArray, low_hz: float, high_hz: float) -> list[NDArray[np.bool_]]:
    """Return masks of bands with equal frequency ratio, merged upwards until each has enough
    frequencies.
    """
    edges = np.geomspace(low_hz, high_hz, _BANDS + 1)[1:]
    groups, last_edge = [], 0.0
    for edge in edges:
        group = (frequency > last_edge) & (frequency <= edge * (1.0 + 1e-9))
        if np.count_nonzero(group) >= _MIN_BINS:
            groups.append(group)
            last_edge = edge * (1.0 + 1e-9)
    # Frequencies above the last complete band join it.
    remainder = frequency > last_edge
    if groups and remainder.any():
        groups[-1] = groups[-1] | remainder
    return groups or [np.ones(frequency.size, dtype=bool)]


def _coarse_lateness(
    frequency: FloatArray, fx: ComplexArray, fy: ComplexArray, groups: Sequence[NDArray[np.bool_]]
) -> tuple[float, float]:
    """Return delay, on a grid of _LATE_STEP_S, and sign that maximise the correlation over all
    bands.
    """
    late = np.arange(-_MAX_LATE_S, _MAX_LATE_S + 0.5 * _LATE_STEP_S, _LATE_STEP_S)
    total = np.zeros(late.size)
    # Powers of one rotation per step: a hundred times faster than exponentials, accurate to
    # 1e-13.
    turns = np.broadcast_to(
        np.exp(2j * np.pi * _LATE_STEP_S * frequency), (late.size, frequency.size)
    ).copy()
    turns[0] = np.exp(2j * np.pi * late[0] * frequency)
    np.multiply.accumulate(turns, axis=0, out=turns)
    for group in groups:
        cross = np.conj(fx[group]) * fy[group]
        size = math.sqrt(
            float(np.sum(np.abs(fx[group]) ** 2)) * float(np.sum(np.abs(fy[group]) ** 2))
        )
        if size > 0.0:
            # Without BLAS: its threads cost more than they save.
            correlation = np.real((turns[:, group] * cross).sum(axis=1)) / size
            total += np.count_nonzero(group) * correlation * np.abs(correlation)
    # Among equal correlations prefer the smallest delay.
    total *= 1.0 - 1e-3 * np.abs(late)
    best, worst = int(np.argmax(total)), int(np.argmin(total))
    if -total[worst] > _SIGN_MARGIN * total[best]:
        return float(late[worst]), -1.0
    return float(late[best]), 1.0


Columns = Mapping[str, FloatArray]
Pair = tuple[FloatArray, FloatArray]
BAND_HZ = (0.08, 2.5)
_SLOW_HZ = 0.15  # below it the angle of attack hardly changes
# Share of a channel's own rate up to which linear interpolation loses less than 8 %.
_OF_NATIVE = 0.15
_MIN_S, _MAX_S = 8.0, 200.0
_BLOCK_S = 2.0
ATTITUDE = ("phi_rad", "theta_rad", "psi_rad")
RATES = ("p_radps", "q_radps", "r_radps")
ACCELERATIONS = ("ax_mps2", "ay_mps2", "az_mps2")
GROUND = ("vn_mps", "ve_mps", "vd_mps")
AIR = ("V_mps", "alpha_rad", "beta_rad")


@dataclass(frozen=True)
class Law:
    """A relation that physics demands between the channels of any aircraft.

    Attributes
    ----------
    subject : str
        Channel on the left side.
    statement : str
        Right side in words.
    uses : tuple of str
        All channels that occur in it.
    sides : callable
        (columns, step [s]) to (x, y), where y belongs to the subject.
    means : bool
        Compare means of blocks instead of motion.
    high_hz : float
        Frequency up to which it holds.
    """

    subject: str
    statement: str
    uses: tuple[str, ...]
    sides: Callable[[Columns, float], Pair]
    means: bool = False
    high_hz: float = BAND_HZ[1]


@dataclass(frozen=True)
class Stretches:
    """Parts of a record without gaps in the channels of a law, their step [s] and slowest rate
    [Hz].
    """

    parts: tuple[Columns, ...]
    dt_s: float
    native_hz: float


def body_rates_of_attitude(
    phi: FloatArray, theta: FloatArray, psi: FloatArray, dt_s: float
) -> FloatArray:
    """Return p, q, r, shape (3, n), by central differences of the Euler angles (psi on any
    branch).
    """
    dphi = np.gradient(np.unwrap(phi), dt_s)
    dtheta = np.gradient(theta, dt_s)
    dpsi = np.gradient(np.unwrap(psi), dt_s)
    p = dphi - np.sin(theta) * dpsi
    q = np.cos(phi) * dtheta + np.sin(phi) * np.cos(theta) * dpsi
    r = -np.sin(phi) * dtheta + np.cos(phi) * np.cos(theta) * dpsi
    return np.stack([p, q, r])


def to_earth(c: Columns, vector: FloatArray) -> FloatArray:
    """Transform a vector, shape (3, n), from body axes to north, east, down."""
    phi, theta, psi = (c[n] for n in ATTITUDE)
    across = np.sin(phi) * vector[1] + np.cos(phi) * vector[2]
    forward = np.cos(theta) * vector[0] + np.sin(theta) * across
    side = np.cos(phi) * vector[1] - np.sin(phi) * vector[2]
    north, east = (
        np.cos(psi) * forward - np.sin(psi) * side,
        np.sin(psi) * forward + np.cos(psi) * side,
    )
    return np.stack([north, east, -np.sin(theta) * vector[0] + np.cos(theta) * across])


def to_body(c: Columns, vector: FloatArray) -> FloatArray:
    """Transform a vector, shape (3, n), from north, east, down to body axes."""
    phi, theta, psi = (c[n] for n in ATTITUDE)
    level, side = (
        np.cos(psi) * vector[0] + np.sin(psi) * vector[1],
        np.cos(psi) * vector[1] - np.sin(psi) * vector[0],
    )
    forward, down = (
        np.cos(theta) * level - np.sin(theta) * vector[2],
        np.sin(theta) * level + np.cos(theta) * vector[2],
    )
    return np.stack(
        [forward, np.cos(phi) * side + np.sin(phi) * down, np.cos(phi) * down - np.sin(phi) * side]
    )


def gravity(c: Columns) -> FloatArray:
    """Return gravity in body axes, m/s2, shape (3, n)."""
    phi, theta = c["phi_rad"], c["theta_rad"]
    return G0_MPS2 * np.stack(
        [-np.sin(theta), np.sin(phi) * np.cos(theta), np.cos(phi) * np.cos(theta)]
    )


def _rate(axis: int) -> Callable[[Columns, float], Pair]:
    """Return the law of an angular rate: derivative of the attitude."""

    def sides(c: Columns, dt: float) -> Pair:
        return body_rates_of_attitude(c["phi_rad"], c["theta_rad"], c["psi_rad"], dt)[axis], c[
            RATES[axis]
        ]

    return sides


def _force_on_path(axis: int) -> Callable[[Columns, float], Pair]:
    """Return the law of a specific force by the ground velocity, independent of wind."""

    def sides(c: Columns, dt: float) -> Pair:
        change = np.gradient(np.stack([c[n] for n in GROUND]), dt, axis=1)
        return to_body(c, change)[axis] - gravity(c)[axis], c[ACCELERATIONS[axis]]

    return sides


def air_velocity(c: Columns) -> FloatArray:
    """Return u, v, w through the air, m/s, shape (3, n)."""
    return np.stack(components_of(*(c[n] for n in AIR)))


def _force_in_air(axis: int) -> Callable[[Columns, float], Pair]:
    """Return the law of a specific force: acceleration through still air, dv/dt + omega x v - g."""

    def sides(c: Columns, dt: float) -> Pair:
        v, omega = air_velocity(c), np.stack([c[n] for n in RATES])
        return (np.gradient(v, dt, axis=1) + np.cross(omega, v, axis=0) - gravity(c))[axis], c[
            ACCELERATIONS[axis]
        ]

    return sides


def speed_change(c: Columns, dt_s: float) -> Pair:
    """Return the derivative of the airspeed [m/s2] by the accelerometers and by differences, each
    (n,).
    """
    force = np.stack([c[n] for n in ACCELERATIONS]) + gravity(c)
    alpha, beta = c["alpha_rad"], c["beta_rad"]
    flow_axis = np.stack([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    return np.sum(flow_axis * force, axis=0), np.gradient(c["V_mps"], dt_s)


def _alpha_change(c: Columns, dt: float) -> Pair:
    """Return the derivative of alpha by rates and accelerations, and by differences."""
    force = np.stack([c[n] for n in ACCELERATIONS]) + gravity(c)
    p, q, r = (c[n] for n in RATES)
    alpha, beta = c["alpha_rad"], c["beta_rad"]
    speed = np.maximum(np.abs(c["V_mps"]), 1.0)
    rotation_rate = q - np.tan(beta) * (p * np.cos(alpha) + r * np.sin(alpha))
    return rotation_rate + (force[2] * np.cos(alpha) - force[0] * np.sin(alpha)) / (
        speed * np.cos(beta)
    ), np.gradient(alpha, dt)


def _beta_change(c: Columns, dt: float) -> Pair:
    """Return the derivative of beta by rates and accelerations, and by differences."""
    force = np.stack([c[n] for n in ACCELERATIONS]) + gravity(c)
    alpha, beta = c["alpha_rad"], c["beta_rad"]
    speed = np.maximum(np.abs(c["V_mps"]), 1.0)
    rotation_rate = c["p_radps"] * np.sin(alpha) - c["r_radps"] * np.cos(alpha)
    across = np.stack([-np.sin(beta) * np.cos(alpha), np.cos(beta), -np.sin(beta) * np.sin(alpha)])
    return rotation_rate + np.sum(across * force, axis=0) / speed, np.gradient(beta, dt)


def _weight(c: Columns, dt: float) -> Pair:
    """Return the downward specific force of flight without vertical acceleration: minus gravity."""
    down = to_earth(
        {**c, "psi_rad": np.zeros(c["phi_rad"].size)}, np.stack([c[n] for n in ACCELERATIONS])
    )[2]
    return np.full(down.size, -G0_MPS2), down


def _turn(c: Columns, dt: float) -> Pair:
    """Return the horizontal force of a steady turn, and speed times heading rate."""
    phi, theta = c["phi_rad"], c["theta_rad"]
    across = np.cos(phi) * c["ay_mps2"] - np.sin(phi) * c["az_mps2"]
    return across, c["V_mps"] * np.cos(theta) * np.gradient(np.unwrap(c["psi_rad"]), dt)


def _climb_on_path(c: Columns, dt: float) -> Pair:
    """Return the vertical speed, and the derivative of the height."""
    return -c["vd_mps"], np.gradient(c["h_m"], dt)


def _climb_in_air(c: Columns, dt: float) -> Pair:
    """Return the climb through still air, and the derivative of the height."""
    return -to_earth({**c, "psi_rad": np.zeros(c["phi_rad"].size)}, air_velocity(c))[
        2
    ], np.gradient(c["h_m"], dt)


def _climb_by_pitch(c: Columns, dt: float) -> Pair:
    """Return the climb by airspeed and pitch angle, and the derivative of the height."""
    return c["V_mps"] * np.sin(c["theta_rad"]), np.gradient(c["h_m"], dt)


def _position(place: str, speed: str) -> Callable[[Columns, float], Pair]:
    """Return the law of a position: derivative against the ground velocity."""

    def sides(c: Columns, dt: float) -> Pair:
        return c[speed], np.gradient(c[place], dt)

    return sides


def _laws() -> tuple[Law, ...]:
    """Return all laws but that of the wind."""
    moving = (*ATTITUDE, *RATES, *ACCELERATIONS)
    laws = [
        Law(n, "the rate of the logged attitude", (*ATTITUDE, n), _rate(k))
        for k, n in enumerate(RATES)
    ]
    # Accelerations: from the path over ground, and from the motion through the air.
    for k, n in enumerate(ACCELERATIONS):
        laws.append(
            Law(
                n,
                "the ground velocity's change less gravity",
                (*GROUND, *ATTITUDE, n),
                _force_on_path(k),
            )
        )
        laws.append(
            Law(
                n,
                "what the motion through the air demands",
                (*AIR, *ATTITUDE, *RATES, n),
                _force_in_air(k),
            )
        )
    laws += [
        Law(
            n,
            "what rates and accelerations say",
            (*AIR, *moving[:2], *RATES, *ACCELERATIONS),
            sides,
        )
        for n, sides in zip(AIR, (speed_change, _alpha_change, _beta_change), strict=True)
    ]
    # Laws of means, for what is too slow or too noisy to differentiate.
    laws += [
        Law(
            "az_mps2",
            "the weight that has to be carried",
            (*ATTITUDE[:2], *ACCELERATIONS),
            _weight,
            means=True,
        ),
        Law(
            "V_mps",
            "the turns that the accelerometers feel",
            ("V_mps", *ATTITUDE, *ACCELERATIONS[1:]),
            _turn,
            means=True,
        ),
        Law("h_m", "the vertical speed", ("vd_mps", "h_m"), _climb_on_path),
        Law("h_m", "the climb through the air", (*AIR, *ATTITUDE[:2], "h_m"), _climb_in_air),
        Law(
            "h_m",
            "airspeed and pitch angle",
            ("V_mps", "theta_rad", "h_m"),
            _climb_by_pitch,
            high_hz=_SLOW_HZ,
        ),
        Law(
            "north_m", "the ground velocity", ("vn_mps", "north_m"), _position("north_m", "vn_mps")
        ),
        Law("east_m", "the ground velocity", ("ve_mps", "east_m"), _position("east_m", "ve_mps")),
    ]
    return tuple(laws)


LAWS = _laws()
WIND_LAW = Law(
    "V_mps",
    "ground speed and a steady wind",
    ("V_mps", "vn_mps", "ve_mps"),
    lambda c, dt: (c["vn_mps"], c["V_mps"]),
)
"""Airspeed against ground speed; `against_wind` estimates its relation together with the wind."""


def stretches(record: FlightRecord, law: Law, max_s: float = _MAX_S) -> Stretches | None:
    """Return the longest parts of a record that have all channels of a law.

    Parameters
    ----------
    record : FlightRecord
        Free flight.
    law : Law
        Gives the channels.
    max_s : float
        Total duration of the parts, s.

    Returns
    -------
    Stretches or None
        None without a part of at least 8 s.
    """
    if any(n not in record for n in law.uses) or len(record) < 3:
        return None
    rows_left, parts = round(max_s / record.dt_s), []
    # Longest stretches first.
    for part in sorted(record.segments(law.uses, _MIN_S), key=lambda s: s.start - s.stop):
        rows = slice(part.start, min(part.stop, part.start + rows_left))
        if rows.stop - rows.start < _MIN_S / record.dt_s:
            break
        parts.append({n: record[n][rows] for n in law.uses})
        rows_left -= rows.stop - rows.start
    native = record.metadata.native_hz
    slowest = min([1.0 / record.dt_s, *(native[n] for n in law.uses if n in native)])
    return Stretches(tuple(parts), record.dt_s, slowest) if parts else None


def estimate_relation(law: Law, stretch_set: Stretches) -> Relation:
    """Estimate scale, sign and delay of a law's subject."""
    if law is WIND_LAW:
        return against_wind(stretch_set)
    pairs = [law.sides(c, stretch_set.dt_s) for c in stretch_set.parts]
    if law.means:
        x, y = (np.concatenate([_means(p[k], stretch_set.dt_s) for p in pairs]) for k in (0, 1))
        return relate_means(x, y)
    low, high = band_of(law, stretch_set)
    if high <= 1.5 * low:
        return NO_RELATION
    return relate([p[0] for p in pairs], [p[1] for p in pairs], stretch_set.dt_s, low, high)


def band_of(law: Law, stretch_set: Stretches) -> tuple[float, float]:
    """Return the frequencies [Hz] in which a law holds and the stretches have information."""
    longest = max(c[law.subject].size for c in stretch_set.parts) * stretch_set.dt_s
    low = max(0.02 if law.high_hz < BAND_HZ[1] else BAND_HZ[0], 2.0 / longest)
    return low, min(law.high_hz, _OF_NATIVE * stretch_set.native_hz)


def _means(values: FloatArray, dt_s: float) -> FloatArray:
    """Return means over blocks of _BLOCK_S."""
    n = max(1, round(_BLOCK_S / dt_s))
    return values[: values.size // n * n].reshape(-1, n).mean(axis=1)


# Prior standard deviation of the wind: absolute, and as a share of the ground speed.
_WIND_MPS, _WIND_SHARE = 5.0, 0.3


def against_wind(stretch_set: Stretches) -> Relation:
    """Estimate the airspeed as a multiple of ground speed less a steady wind, from block means.

    Scale and wind are estimated together by Gauss-Newton. In a straight flight they are hardly
    separable; a prior on the wind bounds the error.
    """
    v, n, e = (
        np.concatenate([_means(c[name], stretch_set.dt_s) for c in stretch_set.parts])
        for name in WIND_LAW.uses
    )
    if v.size < 4:
        return NO_RELATION
    ground = float(np.median(np.hypot(n, e)))
    # The wind may be a share of the ground speed.
    prior = max(_WIND_MPS, _WIND_SHARE * ground)
    theta = np.array([max(float(np.median(v)), 1e-6) / max(ground, 1e-6), 0.0, 0.0])
    std = 0.05 * float(np.median(np.abs(v))) + 1e-9
    information = np.eye(3)
    for _ in range(12):
        # Model: V = theta0 |ground velocity - wind|, linearised at theta.
        a, b = n - theta[1], e - theta[2]
        length = np.maximum(np.hypot(a, b), 1e-6)
        residual = v - theta[0] * length
        std = max(float(np.sqrt(np.mean(residual**2))), 0.02 * float(np.median(np.abs(v))), 1e-9)
        jacobian = np.column_stack([length, -theta[0] * a / length, -theta[0] * b / length]) / std
        # Neighbouring blocks share gusts: one in five counts as independent.
        information = jacobian.T @ jacobian / 5.0 + np.diag([0.0, prior**-2, prior**-2])
        slope = jacobian.T @ residual / std / 5.0 - np.array([0.0, theta[1], theta[2]]) / prior**2
        step = np.linalg.solve(information + 1e-12 * np.eye(3), slope)
        theta = theta + step
        if np.max(np.abs(step)) < 1e-6:
            break
    if not theta[0] > 0.0:
        return NO_RELATION
    relative_std = 3.0 * float(np.sqrt(np.linalg.inv(information)[0, 0])) / theta[0] + 0.05
    if not relative_std < 1.0:
        return NO_RELATION
    ends = theta[0] * np.exp(-relative_std), theta[0] * np.exp(relative_std)
    return Relation(float(ends[0]), float(ends[1]), float("nan"), float("inf"), 1.0, 1)


def all_laws() -> Sequence[Law]:
    """Return every law."""
    return (*LAWS, WIND_LAW)


# Position of the accelerometers, from the accelerations that rotation causes there.

LEVER_ARM_BAND_HZ = (0.08, 2.0)
_MIN_SEGMENT_S = 20.0
_MIN_ROWS = 20  # a slower log does not contain the band
_MAX_STRETCH_S = 600.0


def _longest_stretch(record: FlightRecord, names: tuple[str, ...]) -> FlightRecord | None:
    """Return the longest stretch of a record with these channels; None if it is too short or too
    slow.
    """
    if not all(n in record for n in names):
        return None
    segments = record.segments(names, _MIN_SEGMENT_S)
    if not segments:
        return None
    best = max(segments, key=lambda s: s.stop - s.start)
    # Ten minutes are plenty, and keep the check quick on long logs.
    part = record.rows(
        slice(best.start, min(best.stop, best.start + int(_MAX_STRETCH_S / record.dt_s)))
    )
    return part if len(part) >= _MIN_ROWS and 0.4 / part.dt_s > LEVER_ARM_BAND_HZ[0] else None


def _band(x: FloatArray, dt_s: float) -> FloatArray:
    """Filter (..., n) to LEVER_ARM_BAND_HZ, with the upper edge below 0.4 of the sampling rate."""
    return band_passed(x, dt_s, LEVER_ARM_BAND_HZ[0], min(LEVER_ARM_BAND_HZ[1], 0.4 / dt_s))


_LEVER_ARM_BLOCK_S, _MIN_BLOCKS = 4.0, 8
_MAX_STD_M = 0.3  # a flight without turns regresses noise on noise and has a large error
_MIN_RATIO = 4.5  # standard errors: three axes in every log, a few dozen blocks behind each error


@dataclass(frozen=True)
class LeverArm:
    """Position of the accelerometer from the CG in body axes, m, each of shape (3,).

    Attributes
    ----------
    position_m, std_m : ndarray of shape (3,)
        Estimate and standard error.
    timing_m : ndarray of shape (3,)
        Error that rates half a row before or after the accelerations would cause: in omega x v, a
        time offset t of omega is omega_dot x (t v), which is a lever arm of t v.
    """

    position_m: FloatArray
    std_m: FloatArray
    timing_m: FloatArray


def lever_arm(record: FlightRecord) -> LeverArm | None:
    """Estimate the accelerometer position relative to the point that V, alpha and beta describe
    (the CG).

    The model is a = dv/dt + omega x v - g + (omega_dot x) r + omega x (omega x r), with all terms
    filtered alike, solved by least squares over the longest stretch without gaps.

    Parameters
    ----------
    record : FlightRecord
        Free flight with measured V, alpha, beta, attitude, rates and accelerations.

    Returns
    -------
    LeverArm or None
        None if a channel is missing or estimated, or the stretch is too short.
    """
    names = ("V_mps", "alpha_rad", "beta_rad", *ATTITUDE, *RATES, *ACCELERATIONS)
    if any(n in record.metadata.estimates for n in ("alpha_rad", "beta_rad")):
        return None
    part = _longest_stretch(record, names)
    if part is None:
        return None
    dt = part.dt_s
    speed, alpha, beta = part["V_mps"], part["alpha_rad"], part["beta_rad"]
    phi, theta = part["phi_rad"], part["theta_rad"]
    p, q, r = (part[n] for n in RATES)
    v = np.stack(
        [
            speed * np.cos(alpha) * np.cos(beta),
            speed * np.sin(beta),
            speed * np.sin(alpha) * np.cos(beta),
        ]
    )
    g = G0_MPS2 * np.stack(
        [-np.sin(theta), np.sin(phi) * np.cos(theta), np.cos(phi) * np.cos(theta)]
    )
    omega = np.stack([p, q, r])
    # Specific force at the CG.
    acceleration = np.gradient(v, dt, axis=1) + np.cross(omega, v, axis=0) - g
    measured = np.stack([part[n] for n in ACCELERATIONS])
    dp, dq, dr = np.gradient(omega, dt, axis=1)
    # Coefficients of r: (omega_dot x) + omega x (omega x).
    rows = np.array(
        [
            [-(q**2 + r**2), p * q - dr, p * r + dq],
            [p * q + dr, -(p**2 + r**2), q * r - dp],
            [p * r - dq, q * r + dp, -(p**2 + q**2)],
        ]
    )
    a = np.concatenate(_band(rows, dt).swapaxes(1, 2))
    b = _band(measured - acceleration, dt).ravel()
    weight = np.ones(b.size)
    for _ in range(2):
        information = (a * weight[:, None]).T @ a
        if np.linalg.cond(information) > 1e8:
            return None
        position = np.linalg.solve(information, a.T @ (weight * b))
        residual = b - a @ position
        # Weight the axes by their residuals: beta's noise times the airspeed acts on one, the
        # airspeed's noise on another.
        weight = np.repeat(
            1.0 / np.maximum(np.mean(residual.reshape(3, -1) ** 2, axis=1), 1e-300), speed.size
        )
    # Residuals are correlated in time and larger in manoeuvres: cluster-robust covariance over
    # blocks of some seconds (Liang and Zeger, Biometrika 73, 1986).
    block = np.tile(np.arange(speed.size) * dt // _LEVER_ARM_BLOCK_S, 3).astype(int)
    sums = np.zeros((block.max() + 1, 3))
    information = (a * weight[:, None]).T @ a
    np.add.at(sums, block, a * (weight * residual)[:, None])
    if len(sums) < _MIN_BLOCKS:
        return None
    inverse = np.linalg.inv(information)
    scatter = sums.T @ sums * len(sums) / (len(sums) - 3.0)
    return LeverArm(
        np.asarray(position, dtype=float),
        np.sqrt(np.diag(inverse @ scatter @ inverse)),
        0.5 * dt * np.mean(np.abs(v), axis=1),
    )


def lever_arm_finding(record: FlightRecord) -> list[Finding]:
    """Return a finding if the accelerometer is off the CG.

    The distance must exceed _MIN_RATIO standard errors (at least 3 cm) plus the effect of timing.
    """
    arm = lever_arm(record)
    if arm is None:
        return []
    threshold_m = np.maximum(_MIN_RATIO * arm.std_m, 0.03) + arm.timing_m
    is_off_cg = (np.abs(arm.position_m) > threshold_m) & (arm.std_m < _MAX_STD_M)
    if not is_off_cg.any():
        return []
    pairs = ", ".join(
        f"{n} {v:+.2f} +- {s:.2f}" for n, v, s in zip("xyz", arm.position_m, arm.std_m, strict=True)
    )
    numbers = {f"{n}_m": float(v) for n, v in zip("xyz", arm.position_m, strict=True)}
    numbers |= {f"{n}_std_m": float(v) for n, v in zip("xyz", arm.std_m, strict=True)}
    text = (
        f"the accelerometers sit off the CG: {pairs} m; put it into the card's [sensors] position_m"
    )
    return [Finding("lever-arm", "ax_mps2", "warning", text, numbers)]
