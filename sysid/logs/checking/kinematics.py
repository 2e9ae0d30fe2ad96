"""What the channels of a flight must have to do with one another, whatever the aircraft: relations that hold for any rigid body.

Each relation says that one channel, or what is made of it, equals something made of others. `sysid.logs.checking.spectra`
estimates scale, sign and lateness of it. Equations of motion of the centre of gravity: Etkin and Reid, "Dynamics of Flight",
3rd ed. 1996, 4.3, 4.7.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from sysid.logs.air_velocity import components_of
from sysid.logs.checking.spectra import NOTHING, Relation, relate, relate_means
from sysid.record import FlightRecord
from sysid.units import G0_MPS2

Columns = Mapping[str, FloatArray]
Pair = tuple[FloatArray, FloatArray]
BAND_HZ = (0.08, 2.5)
_SLOW_HZ = 0.15  # below it an aircraft's angle of attack hardly changes
_OF_NATIVE = 0.15  # of a channel's own rate: up to there straight lines between its samples lose less than 8 %
_MIN_S, _MOST_S = 8.0, 200.0
_BLOCK_S = 2.0
ATTITUDE = ("phi_rad", "theta_rad", "psi_rad")
RATES = ("p_radps", "q_radps", "r_radps")
ACCELERATIONS = ("ax_mps2", "ay_mps2", "az_mps2")
GROUND = ("vn_mps", "ve_mps", "vd_mps")
AIR = ("V_mps", "alpha_rad", "beta_rad")


@dataclass(frozen=True)
class Law:
    """One relation that physics demands. It says of ``subject`` what ``says`` tells in words.

    uses   every channel that has a part in it        sides  channels and step [s] -> (x, y), y of the subject
    means  of blocks of time are compared, not motion  high_hz  above which it holds no longer
    """

    subject: str
    says: str
    uses: tuple[str, ...]
    sides: Callable[[Columns, float], Pair]
    means: bool = False
    high_hz: float = BAND_HZ[1]


@dataclass(frozen=True)
class Stretches:
    """Parts of a record without gaps in any channel of a law, and the rate [Hz] of the slowest of them."""

    parts: tuple[Columns, ...]
    dt_s: float
    native_hz: float


def body_rates_of_attitude(
    phi: FloatArray, theta: FloatArray, psi: FloatArray, dt_s: float
) -> FloatArray:
    """(3, n) p, q, r by central differences of the Euler angles (psi on any branch)."""
    dphi = np.gradient(np.unwrap(phi), dt_s)
    dtheta = np.gradient(theta, dt_s)
    dpsi = np.gradient(np.unwrap(psi), dt_s)
    p = dphi - np.sin(theta) * dpsi
    q = np.cos(phi) * dtheta + np.sin(phi) * np.cos(theta) * dpsi
    r = -np.sin(phi) * dtheta + np.cos(phi) * np.cos(theta) * dpsi
    return np.stack([p, q, r])


def to_earth(c: Columns, vector: FloatArray) -> FloatArray:
    """(3, n) in north, east, down of a vector (3, n) in body axes."""
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
    """(3, n) in body axes of a vector (3, n) in north, east, down; the inverse of `to_earth`."""
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
    """(3, n) gravity in body axes, m/s2."""
    phi, theta = c["phi_rad"], c["theta_rad"]
    return G0_MPS2 * np.stack(
        [-np.sin(theta), np.sin(phi) * np.cos(theta), np.cos(phi) * np.cos(theta)]
    )


def _rate(axis: int) -> Callable[[Columns, float], Pair]:
    def sides(c: Columns, dt: float) -> Pair:
        return body_rates_of_attitude(c["phi_rad"], c["theta_rad"], c["psi_rad"], dt)[axis], c[
            RATES[axis]
        ]

    return sides


def _felt_on_path(axis: int) -> Callable[[Columns, float], Pair]:
    """Specific force against the ground velocity's change, free of wind and of the aircraft."""

    def sides(c: Columns, dt: float) -> Pair:
        change = np.gradient(np.stack([c[n] for n in GROUND]), dt, axis=1)
        return to_body(c, change)[axis] - gravity(c)[axis], c[ACCELERATIONS[axis]]

    return sides


def air_velocity(c: Columns) -> FloatArray:
    """(3, n) u, v, w of the motion through the air, m/s."""
    return np.stack(components_of(*(c[n] for n in AIR)))


def _felt_in_air(axis: int) -> Callable[[Columns, float], Pair]:
    def sides(c: Columns, dt: float) -> Pair:
        v, omega = air_velocity(c), np.stack([c[n] for n in RATES])
        return (np.gradient(v, dt, axis=1) + np.cross(omega, v, axis=0) - gravity(c))[axis], c[
            ACCELERATIONS[axis]
        ]

    return sides


def speed_change(c: Columns, dt_s: float) -> Pair:
    """What the accelerometers say of the airspeed's derivative [m/s2], and the derivative itself, each (n,)."""
    force = np.stack([c[n] for n in ACCELERATIONS]) + gravity(c)
    alpha, beta = c["alpha_rad"], c["beta_rad"]
    along = np.stack([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    return np.sum(along * force, axis=0), np.gradient(c["V_mps"], dt_s)


def _alpha_change(c: Columns, dt: float) -> Pair:
    force = np.stack([c[n] for n in ACCELERATIONS]) + gravity(c)
    p, q, r = (c[n] for n in RATES)
    alpha, beta = c["alpha_rad"], c["beta_rad"]
    speed = np.maximum(np.abs(c["V_mps"]), 1.0)
    turned = q - np.tan(beta) * (p * np.cos(alpha) + r * np.sin(alpha))
    return turned + (force[2] * np.cos(alpha) - force[0] * np.sin(alpha)) / (
        speed * np.cos(beta)
    ), np.gradient(alpha, dt)


def _beta_change(c: Columns, dt: float) -> Pair:
    force = np.stack([c[n] for n in ACCELERATIONS]) + gravity(c)
    alpha, beta = c["alpha_rad"], c["beta_rad"]
    speed = np.maximum(np.abs(c["V_mps"]), 1.0)
    turned = c["p_radps"] * np.sin(alpha) - c["r_radps"] * np.cos(alpha)
    across = np.stack([-np.sin(beta) * np.cos(alpha), np.cos(beta), -np.sin(beta) * np.sin(alpha)])
    return turned + np.sum(across * force, axis=0) / speed, np.gradient(beta, dt)


def _weight(c: Columns, dt: float) -> Pair:
    """Specific force downwards of flight that neither climbs ever faster nor sinks ever faster: minus gravity."""
    down = to_earth(
        {**c, "psi_rad": np.zeros(c["phi_rad"].size)}, np.stack([c[n] for n in ACCELERATIONS])
    )[2]
    return np.full(down.size, -G0_MPS2), down


def _turn(c: Columns, dt: float) -> Pair:
    """A steady turn: the horizontal force across is speed times the heading's rate."""
    phi, theta = c["phi_rad"], c["theta_rad"]
    across = np.cos(phi) * c["ay_mps2"] - np.sin(phi) * c["az_mps2"]
    return across, c["V_mps"] * np.cos(theta) * np.gradient(np.unwrap(c["psi_rad"]), dt)


def _climb_on_path(c: Columns, dt: float) -> Pair:
    return -c["vd_mps"], np.gradient(c["h_m"], dt)


def _climb_in_air(c: Columns, dt: float) -> Pair:
    return -to_earth({**c, "psi_rad": np.zeros(c["phi_rad"].size)}, air_velocity(c))[
        2
    ], np.gradient(c["h_m"], dt)


def _climb_by_pitch(c: Columns, dt: float) -> Pair:
    return c["V_mps"] * np.sin(c["theta_rad"]), np.gradient(c["h_m"], dt)


def _position(place: str, speed: str) -> Callable[[Columns, float], Pair]:
    def sides(c: Columns, dt: float) -> Pair:
        return c[speed], np.gradient(c[place], dt)

    return sides


def _laws() -> tuple[Law, ...]:
    moving = (*ATTITUDE, *RATES, *ACCELERATIONS)
    found = [
        Law(n, "the rate of the logged attitude", (*ATTITUDE, n), _rate(k))
        for k, n in enumerate(RATES)
    ]
    for k, n in enumerate(ACCELERATIONS):
        found.append(
            Law(
                n,
                "the ground velocity's change less gravity",
                (*GROUND, *ATTITUDE, n),
                _felt_on_path(k),
            )
        )
        found.append(
            Law(
                n,
                "what the motion through the air demands",
                (*AIR, *ATTITUDE, *RATES, n),
                _felt_in_air(k),
            )
        )
    found += [
        Law(
            n,
            "what rates and accelerations say",
            (*AIR, *moving[:2], *RATES, *ACCELERATIONS),
            sides,
        )
        for n, sides in zip(AIR, (speed_change, _alpha_change, _beta_change), strict=True)
    ]
    found += [
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
    return tuple(found)


LAWS = _laws()
WIND_LAW = Law(
    "V_mps",
    "ground speed and a steady wind",
    ("V_mps", "vn_mps", "ve_mps"),
    lambda c, dt: (c["vn_mps"], c["V_mps"]),
)
"""Judged by `against_wind`; here for its names."""


def stretches(record: FlightRecord, law: Law, most_s: float = _MOST_S) -> Stretches | None:
    """The longest parts of a record that have all channels of a law, ``most_s`` seconds together; None without any."""
    if any(n not in record for n in law.uses) or len(record) < 3:
        return None
    left, parts = round(most_s / record.dt_s), []
    for part in sorted(record.segments(law.uses, _MIN_S), key=lambda s: s.start - s.stop):
        rows = slice(part.start, min(part.stop, part.start + left))
        if rows.stop - rows.start < _MIN_S / record.dt_s:
            break
        parts.append({n: record[n][rows] for n in law.uses})
        left -= rows.stop - rows.start
    native = record.metadata.native_hz
    slowest = min([1.0 / record.dt_s, *(native[n] for n in law.uses if n in native)])
    return Stretches(tuple(parts), record.dt_s, slowest) if parts else None


def judged(law: Law, found: Stretches) -> Relation:
    """What the flight says of a law: scale, sign and lateness of its subject against the rest."""
    if law is WIND_LAW:
        return against_wind(found)
    pairs = [law.sides(c, found.dt_s) for c in found.parts]
    if law.means:
        x, y = (np.concatenate([_means(p[k], found.dt_s) for p in pairs]) for k in (0, 1))
        return relate_means(x, y)
    low, high = band_of(law, found)
    if high <= 1.5 * low:
        return NOTHING
    return relate([p[0] for p in pairs], [p[1] for p in pairs], found.dt_s, low, high)


def band_of(law: Law, found: Stretches) -> tuple[float, float]:
    """Frequencies [Hz] between which a law holds and the stretches tell of it."""
    longest = max(c[law.subject].size for c in found.parts) * found.dt_s
    low = max(0.02 if law.high_hz < BAND_HZ[1] else BAND_HZ[0], 2.0 / longest)
    return low, min(law.high_hz, _OF_NATIVE * found.native_hz)


def _means(values: FloatArray, dt_s: float) -> FloatArray:
    n = max(1, round(_BLOCK_S / dt_s))
    return values[: values.size // n * n].reshape(-1, n).mean(axis=1)


_WIND_MPS, _WIND_SHARE = (
    5.0,
    0.3,
)  # what a wind may be before anything is measured, one standard deviation


def against_wind(found: Stretches) -> Relation:
    """Airspeed as a multiple of the speed over ground less a steady wind, from block means; scale and wind are estimated together.

    A flight that never turns tells little of either: a prior on the wind stands for what is then unknown.
    """
    v, n, e = (
        np.concatenate([_means(c[name], found.dt_s) for c in found.parts]) for name in WIND_LAW.uses
    )
    if v.size < 4:
        return NOTHING
    ground = float(np.median(np.hypot(n, e)))
    prior = max(_WIND_MPS, _WIND_SHARE * ground)
    theta = np.array([max(float(np.median(v)), 1e-6) / max(ground, 1e-6), 0.0, 0.0])
    std = 0.05 * float(np.median(np.abs(v))) + 1e-9
    information = np.eye(3)
    for _ in range(12):
        a, b = n - theta[1], e - theta[2]
        length = np.maximum(np.hypot(a, b), 1e-6)
        residual = v - theta[0] * length
        std = max(float(np.sqrt(np.mean(residual**2))), 0.02 * float(np.median(np.abs(v))), 1e-9)
        jacobian = np.column_stack([length, -theta[0] * a / length, -theta[0] * b / length]) / std
        # Blocks of some seconds share gusts: one in five counts as independent.
        information = jacobian.T @ jacobian / 5.0 + np.diag([0.0, prior**-2, prior**-2])
        slope = jacobian.T @ residual / std / 5.0 - np.array([0.0, theta[1], theta[2]]) / prior**2
        step = np.linalg.solve(information + 1e-12 * np.eye(3), slope)
        theta = theta + step
        if np.max(np.abs(step)) < 1e-6:
            break
    if not theta[0] > 0.0:
        return NOTHING
    spread = 3.0 * float(np.sqrt(np.linalg.inv(information)[0, 0])) / theta[0] + 0.05
    if not spread < 1.0:
        return NOTHING
    ends = theta[0] * np.exp(-spread), theta[0] * np.exp(spread)
    return Relation(float(ends[0]), float(ends[1]), float("nan"), float("inf"), 1.0, 1)


def all_laws() -> Sequence[Law]:
    """Every law that a flight is held against."""
    return (*LAWS, WIND_LAW)
