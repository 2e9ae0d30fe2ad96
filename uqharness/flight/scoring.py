"""What a flight is scored by: errors from a commanded path, or, where nothing is commanded, deviations from the start."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sysid.units import FT_M
from uqharness.flight.spec import FlightResult, FlightSpec
from uqharness.simulator import STANDARD, Aircraft, Source

# Scores of a flight along a commanded path: medians, means, maxima, excursions, loss of
# control.
#
# Definitions are those of the campaign tables: an excursion is counted when the distance from
# the path first exceeds the radius and re-arms ``rearm_m`` inside it; loss of control is |bank|
# > 80 deg, |alpha| > 25 deg, altitude error > 60 m or a state not finite.

BANK_LIMIT_RAD = np.deg2rad(80.0)
ALPHA_LIMIT_RAD = np.deg2rad(25.0)
ALTITUDE_LIMIT_M = 60.0


def absolute_statistics(error: NDArray[np.float64]) -> tuple[float, float, float]:
    """Median, mean and maximum of ``|error|`` (n,); NaN for no sample at all."""
    if error.size == 0:
        return float("nan"), float("nan"), float("nan")
    magnitude = np.abs(error)
    return float(np.median(magnitude)), float(np.mean(magnitude)), float(np.max(magnitude))


def count_excursions(distance: NDArray[np.float64], radius_m: float, rearm_m: float) -> int:
    """Number of excursions of ``|distance|`` (n,) [m] beyond ``radius_m``, re-armed at ``radius_m - rearm_m``.

    A flight that begins outside counts one. ValueError unless 0 <= rearm_m < radius_m.
    """
    if not 0.0 <= rearm_m < radius_m:
        raise ValueError(
            f"rearm_m = {rearm_m} must be at least 0 and less than the excursion radius {radius_m} m"
        )
    magnitude = np.abs(distance)
    outside = magnitude > radius_m
    inside = magnitude < radius_m - rearm_m
    # Only samples that decide matter: between the two radii the counter keeps its state.
    decided = outside[outside | inside]
    if decided.size == 0:
        return 0
    return int(decided[0]) + int(np.count_nonzero(decided[1:] & ~decided[:-1]))


def lost_control(
    phi_rad: NDArray[np.float64],
    alpha_rad: NDArray[np.float64],
    altitude_error_m: NDArray[np.float64],
) -> bool:
    """Whether a flight lost control at any sample; a sample that is not finite counts as lost."""
    finite = np.isfinite(phi_rad) & np.isfinite(alpha_rad) & np.isfinite(altitude_error_m)
    beyond = (
        (np.abs(phi_rad) > BANK_LIMIT_RAD)
        | (np.abs(alpha_rad) > ALPHA_LIMIT_RAD)
        | (np.abs(altitude_error_m) > ALTITUDE_LIMIT_M)
    )
    return bool(np.any(beyond | ~finite))


_STATISTICS = ("median", "mean", "max")
_UNITS: Mapping[str, str] = {"cross_track": "m", "altitude": "m", "speed": "mps"}
LOAD_FACTOR = "load_factor_max"


class Recorded:
    """Signals of one flight as flown so far, and how it ended."""

    def __init__(
        self,
        names: Sequence[str],
        rows: NDArray[np.float64],
        status: str,
        reason: str,
        flown_s: float,
    ) -> None:
        self.status = status
        self.reason = reason
        self.flown_s = flown_s
        self.signals: dict[str, NDArray[np.float64]] = {
            name: rows[:, column] for column, name in enumerate(names)
        }


def commanded_signals(aircraft: Aircraft) -> dict[str, Source]:
    """The card's error signals, true and measured."""
    signals = {key: Source(card.true) for key, card in aircraft.card.metrics.items()}
    return signals | {
        f"{key}_measured": Source(card.measured)
        for key, card in aircraft.card.metrics.items()
        if card.measured
    }


def from_start_signals(straight: bool) -> dict[str, Source]:
    """What deviations from the start are made of; any JSBSim aircraft has it. ``straight``: the flight is to go straight on."""
    names = {"height_m": "h_m", "V_mps": "V_mps", "psi_rad": "psi_rad"}
    table = {ours: STANDARD[theirs] for ours, theirs in names.items()} | {
        "load_factor": Source("accelerations/Nz")
    }
    if straight:
        table |= {
            f"{axis}_m": Source(f"position/from-start-neu-{axis[0]}-ft", FT_M)
            for axis in ("north", "east")
        }
        table |= {name: STANDARD[name] for name in ("vn_mps", "ve_mps")}
    return table


def score_commanded(spec: FlightSpec, recorded: Recorded) -> FlightResult:
    """Errors from the commanded path, height and speed, excursions, loss of control."""
    metrics: dict[str, float] = {}
    undefined: dict[str, str] = {}
    complete = recorded.status == "ok"
    for key, unit in _UNITS.items():
        for suffix in ("", "_measured"):
            values = recorded.signals.get(key + suffix)
            names = [f"{key}_{kind}_{unit}{suffix}" for kind in _STATISTICS]
            if values is None or not complete:
                why = (
                    recorded.reason
                    if values is not None
                    else f"the card names no {key}{suffix} under [metrics]"
                )
                metrics |= dict.fromkeys(names, math.nan)
                undefined |= dict.fromkeys(names, why)
            else:
                metrics |= dict(zip(names, absolute_statistics(values), strict=True))
    for radius in spec.excursion_radius_m:
        for key, suffix in (("cross_track", ""), ("distance_3d", "_3d")):
            values = recorded.signals.get(key)
            name = f"excursions_{radius:g}m{suffix}"
            if values is None:
                metrics[name], undefined[name] = (
                    math.nan,
                    f"the card names no {key} under [metrics]",
                )
            else:
                # What was flown counts, however the flight ended: a campaign bounds the rest from above.
                metrics[name] = float(count_excursions(values, radius, spec.rearm_m))
    return _result(recorded, metrics, undefined, recorded.signals.get("altitude", np.zeros(0)))


def score_from_start(spec: FlightSpec, recorded: Recorded) -> FlightResult:
    """Deviations of height, speed and heading from where scoring begins, and the largest load factor.

    A flight that is to go straight on has a path, the line on which scoring began; any other has none, and its cross-track errors
    and excursions are undefined. Loss of control is judged by bank and incidence.
    """
    metrics: dict[str, float] = {}
    undefined: dict[str, str] = {}
    complete = recorded.status == "ok" and recorded.signals["height_m"].size > 0
    psi = np.unwrap(recorded.signals["psi_rad"])
    cross_track = _cross_track(recorded)
    if cross_track is None:
        undefined["cross_track"] = "no path is commanded"
    else:
        height = recorded.signals["height_m"]
        distances = {"": cross_track, "_3d": np.sqrt(cross_track**2 + (height - height[:1]) ** 2)}
        for suffix, distance in distances.items():
            for radius in spec.excursion_radius_m:
                metrics[f"excursions_{radius:g}m{suffix}"] = float(
                    count_excursions(distance, radius, spec.rearm_m)
                )
    deviations = {
        **({} if cross_track is None else {"cross_track": (cross_track, "m")}),
        "altitude": (recorded.signals["height_m"], "m"),
        "speed": (recorded.signals["V_mps"], "mps"),
        "heading": (np.rad2deg(psi), "deg"),
    }
    for key, (values, unit) in deviations.items():
        names = [f"{key}_{kind}_{unit}" for kind in _STATISTICS]
        statistics = absolute_statistics(values - values[:1]) if complete else (math.nan,) * 3
        metrics |= dict(zip(names, statistics, strict=True))
    # 1 in level flight.
    metrics[LOAD_FACTOR] = float(np.max(recorded.signals["load_factor"])) if complete else math.nan
    if not complete:
        undefined |= dict.fromkeys((*deviations, LOAD_FACTOR), recorded.reason)
    return _result(recorded, metrics, undefined, np.zeros(0))


def _cross_track(recorded: Recorded) -> NDArray[np.float64] | None:
    """(n,) [m] distance from the line on which scoring began, + to the right; None where the flight is not to go straight on."""
    if "north_m" not in recorded.signals:
        return None
    north, east, vn, ve = (
        recorded.signals[name] for name in ("north_m", "east_m", "vn_mps", "ve_mps")
    )
    if north.size == 0:
        return north
    # Roots and products have the same bits on every processor; a C library's hypot need not.
    speed = math.sqrt(vn[0] * vn[0] + ve[0] * ve[0])
    track: NDArray[np.float64] = ((east - east[0]) * vn[0] - (north - north[0]) * ve[0]) / speed
    return track


def _result(
    recorded: Recorded,
    metrics: dict[str, float],
    undefined: dict[str, str],
    altitude: NDArray[np.float64],
) -> FlightResult:
    bank = recorded.signals["phi_rad"]
    error = altitude if altitude.size else np.zeros_like(bank)
    lost = recorded.status != "ok" or lost_control(bank, recorded.signals["alpha_rad"], error)
    metrics["loss_of_control"] = float(lost)
    outside = recorded.signals.get("extrapolated")
    if outside is None or outside.size == 0:
        metrics["extrapolated_share"] = math.nan
        undefined["extrapolated_share"] = "the aircraft publishes no uq/extrapolated"
    else:
        metrics["extrapolated_share"] = float(np.mean(outside > 0.5))
    return FlightResult(
        recorded.status, recorded.reason, recorded.flown_s, metrics, undefined, recorded.signals
    )
