"""Check the sign of each surface by the angular acceleration that it causes.

Positive elevator pitches the nose down, positive aileron rolls right, positive rudder yaws the
nose left. The angular acceleration is regressed on the surface, the other surface of the plane,
the rates and the angles of flow. The latter account for an autopilot's response to gusts, which
follows the motion. A surface follows its command with a lag, and the aircraft too; the lag that
explains most is used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sysid.arrays import FloatArray
from sysid.errors import Finding
from sysid.logs.checking.kinematics import band_passed
from sysid.logs.checking.physics import affected_results, map_correction
from sysid.record import FlightRecord

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
class Effect:
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


def effect(record: FlightRecord, axis: Axis) -> Effect | None:
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
    for axis in AXES:
        surface_effect = effect(record, axis)
        if (
            surface_effect is None
            or not surface_effect.certain
            or surface_effect.slope * axis.sense > 0.0
        ):
            continue
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
            f" ({100 * surface_effect.share:.0f} % of what else is left): its sign is reversed"
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
) -> Effect | None:
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
    return Effect(slope, std, lag * dt, slope**2 * power / float(acceleration @ acceleration))
