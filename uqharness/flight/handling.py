"""Flying-quality levels of MIL-F-8785C for the modes of a linear model.

`assess` rates every mode that has a requirement; levels are 1, 2, 3, or 4 for worse than Level 3.
`level_edges` and `root_limits` draw the limits in the complex plane, and `root_locus` follows the
modes over airspeed. The specification is for piloted aircraft: for small unmanned ones it is a
yardstick, not a requirement.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from sysid.arrays import FloatArray
from sysid.units import G0_MPS2
from uqharness.requests.simulation import AircraftClass, Category
from uqharness.simulator import (
    MODE_NAMES,
    Aircraft,
    LinearModel,
    Mode,
    SteadyCondition,
    find_trim,
    linearise,
    modes,
)

CATEGORIES: tuple[str, ...] = get_args(Category)
CLASSES: tuple[str, ...] = get_args(AircraftClass)

# 3.2.2.1.2, Table IV: short-period damping, (Level 1 low, high), (Level 2 low, high), Level 3 low.
SHORT_PERIOD_DAMPING = {
    "A": ((0.35, 1.30), (0.25, 2.00), 0.15),
    "B": ((0.30, 2.00), (0.20, 2.00), 0.15),
    "C": ((0.35, 1.30), (0.25, 2.00), 0.15),
}
# 3.2.2.1.1, Figs 1-3: CAP = wn^2/(n/alpha) in g rad^-1 s^-2 for Levels 1 and 2; the lower Level 2
# bound is Level 3's too.
CAP = {
    "A": ((0.28, 3.6), (0.16, 10.0)),
    "B": ((0.085, 3.6), (0.038, 10.0)),
    "C": ((0.16, 3.6), (0.096, 10.0)),
}
# 3.2.1.2: least damping at Levels 1 and 2, shortest time to double amplitude [s] at Level 3.
PHUGOID_DAMPING, PHUGOID_DOUBLE_S = (0.04, 0.0), 55.0
# 3.2.1.1: no divergence of airspeed at Levels 1 and 2; shortest time to double amplitude [s] at
# Level 3.
DIVERGENCE, DIVERGENCE_DOUBLE_S = "3.2.1.1", 6.0
# 3.3.1.4: least zeta wn [rad/s] of a coupled roll-spiral oscillation at Levels 1, 2 and 3 in
# categories B and C; category A permits none.
ROLL_SPIRAL_RADPS = (0.5, 0.3, 0.15)


@dataclass(frozen=True)
class Assessment:
    """One requirement and the level reached.

    Attributes
    ----------
    mode, criterion : str
        Mode and what is rated.
    value, unit : float, str
        Value; NaN if it is undefined.
    level : int
        1 to 3, or 4 for worse than Level 3.
    paragraph : str
        Paragraph of MIL-F-8785C.
    """

    mode: str
    criterion: str
    value: float
    unit: str
    level: int
    paragraph: str


def assess(
    model: LinearModel, all_modes: Sequence[Mode], category: str = "B", aircraft_class: str = "I"
) -> list[Assessment]:
    """Return the levels of all modes that have a requirement.

    Parameters
    ----------
    model : LinearModel
        Linear model about a trim.
    all_modes : sequence of Mode
        Its modes.
    category : str
        Flight phase category A, B or C.
    aircraft_class : str
        Class I to IV, with II-L and II-C.

    Raises
    ------
    ValueError
        For an unknown category or class.
    """
    if category not in CATEGORIES or aircraft_class not in CLASSES:
        raise ValueError(
            f"category {category!r}, class {aircraft_class!r}: allowed are {', '.join(CATEGORIES)}"
            f" and {', '.join(CLASSES)}"
        )
    # Modes may be missing or occur twice (two real roots).
    by_name: dict[str, list[Mode]] = {name: [] for name in MODE_NAMES}
    for mode in all_modes:
        by_name[mode.name].append(mode)
    return [
        *_short_period(by_name["short_period"], by_name["third"], model, category),
        *_phugoid(by_name["phugoid"]),
        *_dutch_roll(by_name["dutch_roll"], category, aircraft_class),
        *_roll(by_name["roll"], category, aircraft_class),
        *_spiral(by_name["spiral"], category),
        *_roll_spiral(by_name["other"], category),
    ]


def load_factor_per_alpha(model: LinearModel) -> float:
    """Return n/alpha = -Z_w V/g [g/rad] of a linear model."""
    return -float(model.A[2, 2]) * model.trim.condition.V_mps / G0_MPS2


def _short_period(
    roots: list[Mode], third: list[Mode], model: LinearModel, category: str
) -> list[Assessment]:
    """Rate the short period, or the pair that replaces it.

    Next to a third oscillatory mode, the short period is a real root. The pitch response oscillates
    with the pair, which is then rated.
    """
    pair = third or roots
    name = pair[0].name
    divergence = [
        _divergence(root) for root in roots if root.imag == 0 and root.real > 0 and root.wn_radps
    ]
    if len(pair) == 1 and not pair[0].imag:
        return divergence
    if len(pair) == 2 and pair[0].real * pair[1].real <= 0:
        undefined = Assessment(name, "damping", float("nan"), "1", 4, "3.2.2.1.2")
        return [undefined, *divergence]
    zeta, wn = _damping_and_frequency(pair)
    first, second, third_low = SHORT_PERIOD_DAMPING[category]
    damping = (
        1
        if _is_within(zeta, first)
        else 2
        if _is_within(zeta, second)
        else 3
        if zeta >= third_low
        else 4
    )
    # CAP = wn^2/(n/alpha), 3.2.2.1.1.
    cap = wn**2 / load_factor_per_alpha(model)
    one, two = CAP[category]
    control = (
        1 if _is_within(cap, one) else 2 if _is_within(cap, two) else 3 if cap >= two[0] else 4
    )
    return [
        Assessment(name, "damping", zeta, "1", damping, "3.2.2.1.2"),
        Assessment(name, "CAP", cap, "1/(g s^2)", control, "3.2.2.1.1"),
        *divergence,
    ]


def _damping_and_frequency(pair: list[Mode]) -> tuple[float, float]:
    """Return zeta and wn [rad/s] of a pair, or of two real roots of equal sign."""
    if len(pair) == 1:
        return pair[0].zeta, pair[0].wn_radps
    wn = math.sqrt(pair[0].real * pair[1].real)
    return -(pair[0].real + pair[1].real) / (2 * wn), wn


def _divergence(root: Mode) -> Assessment:
    """Rate an unstable real root of the longitudinal motion."""
    double = math.log(2.0) / root.real
    level = 3 if double >= DIVERGENCE_DOUBLE_S else 4
    return Assessment(root.name, "divergence, time to double", double, "s", level, DIVERGENCE)


def _phugoid(pair: list[Mode]) -> list[Assessment]:
    """Rate the phugoid (3.2.1.2), or divergences in its place."""
    unstable = [root for root in pair if root.imag == 0 and root.real > 0]
    if unstable:
        return [_divergence(root) for root in unstable]
    slowest = max(pair, key=lambda mode: mode.real)
    zeta = slowest.zeta if slowest.imag else (1.0 if slowest.real < 0 else 0.0)
    if zeta >= PHUGOID_DAMPING[0]:
        level = 1
    elif zeta >= PHUGOID_DAMPING[1]:
        level = 2
    else:
        level = 3 if math.log(2.0) / slowest.real >= PHUGOID_DOUBLE_S else 4
    return [Assessment("phugoid", "damping", zeta, "1", level, "3.2.1.2")]


def dutch_roll_limits(category: str, aircraft_class: str) -> tuple[tuple[float, float, float], ...]:
    """Return the least zeta, zeta wn and wn [rad/s] at Levels 1 to 3 (3.3.1.1, Table VI)."""
    light = aircraft_class in ("I", "IV")
    if category == "A":
        one = (0.19, 0.35, 1.0 if light else 0.4)
    elif category == "B":
        one = (0.08, 0.15, 0.4)
    else:
        one = (0.08, 0.15, 1.0) if light or aircraft_class == "II-C" else (0.08, 0.10, 0.4)
    return one, (0.02, 0.05, 0.4), (0.0, -math.inf, 0.4)


def roll_limits_s(category: str, aircraft_class: str) -> tuple[float, float, float]:
    """Return the longest roll time constant [s] at Levels 1 to 3 (3.3.1.2, Table VII).

    Examples
    --------
    >>> roll_limits_s("B", "I")
    (1.4, 3.0, 10.0)
    """
    quick = aircraft_class in ("I", "IV") or (category == "C" and aircraft_class == "II-C")
    return (1.0, 1.4, 10.0) if quick and category != "B" else (1.4, 3.0, 10.0)


def spiral_limits_s(category: str) -> tuple[float, float, float]:
    """Return the shortest time to double amplitude [s] at Levels 1 to 3 (3.3.1.3, Table VIII)."""
    return (20.0 if category == "B" else 12.0, 8.0, 4.0)


def _dutch_roll(pair: list[Mode], category: str, aircraft_class: str) -> list[Assessment]:
    """Rate the Dutch roll (3.3.1.1)."""
    if len(pair) == 2 and max(root.real for root in pair) >= 0:
        return [Assessment("dutch_roll", "damping", float("nan"), "1", 4, "3.3.1.1")]
    zeta, wn = _damping_and_frequency(pair)
    decay = -pair[0].real if len(pair) == 1 else zeta * wn
    level = _best_level(
        zeta >= least_zeta and decay >= product and wn >= least_wn
        for least_zeta, product, least_wn in dutch_roll_limits(category, aircraft_class)
    )
    return [Assessment("dutch_roll", "damping", zeta, "1", level, "3.3.1.1")]


def _roll_spiral(coupled_modes: list[Mode], category: str) -> list[Assessment]:
    """Rate a coupled roll-spiral oscillation (3.3.1.4)."""
    return [
        Assessment(
            mode.name,
            "coupled roll-spiral, zeta wn",
            -mode.real,
            "rad/s",
            4
            if category == "A"
            else _best_level(-mode.real >= limit for limit in ROLL_SPIRAL_RADPS),
            "3.3.1.4",
        )
        for mode in coupled_modes
    ]


def _roll(roots: list[Mode], category: str, aircraft_class: str) -> list[Assessment]:
    """Rate the roll mode (3.3.1.2)."""
    if not roots:
        return []
    real = roots[0].real
    if real >= 0:
        return [Assessment("roll", "time constant", float("nan"), "s", 4, "3.3.1.2")]
    constant = -1.0 / real
    level = _best_level(constant <= limit for limit in roll_limits_s(category, aircraft_class))
    return [Assessment("roll", "time constant", constant, "s", level, "3.3.1.2")]


def _spiral(roots: list[Mode], category: str) -> list[Assessment]:
    """Rate the spiral mode (3.3.1.3)."""
    if not roots:
        return []
    real = roots[0].real
    if real <= 0:
        return [Assessment("spiral", "time to double", math.inf, "s", 1, "3.3.1.3")]
    double = math.log(2.0) / real
    level = _best_level(double >= limit for limit in spiral_limits_s(category))
    return [Assessment("spiral", "time to double", double, "s", level, "3.3.1.3")]


def _best_level(limits_met: Iterable[bool]) -> int:
    """Return the best level whose limit is met, 4 for none."""
    return next((level for level, yes in enumerate(limits_met, start=1) if yes), 4)


def _is_within(value: float, limits: tuple[float, float]) -> bool:
    """Return whether a value lies within limits."""
    return limits[0] <= value <= limits[1]


# Limits of the levels as lines in the complex plane of eigenvalues.

OSCILLATORY = ("short_period", "phugoid", "dutch_roll")
"""Modes whose levels are areas of the plane; roll and spiral have limits of a real root."""


def level_edges(
    mode: str, category: str, aircraft_class: str, imag: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the largest real part [1/s] of a pair at Levels 1, 2 and 3, each (n,).

    Parameters
    ----------
    mode : str
        One of `OSCILLATORY`. For the short period only damping counts, without its upper limit.
    category, aircraft_class : str
        As of `assess`.
    imag : ndarray
        Imaginary parts (n,) [rad/s], positive.

    Raises
    ------
    ValueError
        For another mode.
    """
    if mode == "short_period":
        (one, _), (two, _), three = SHORT_PERIOD_DAMPING[category]
        return _real_part(one, imag), _real_part(two, imag), _real_part(three, imag)
    if mode == "phugoid":
        first, second = (_real_part(zeta, imag) for zeta in PHUGOID_DAMPING)
        return first, second, np.full(imag.shape, math.log(2.0) / PHUGOID_DOUBLE_S)
    if mode != "dutch_roll":
        raise ValueError(f"mode {mode!r}: allowed are {', '.join(OSCILLATORY)}")
    edges = []
    for zeta, product, wn in dutch_roll_limits(category, aircraft_class):
        # wn at least its limit: outside a circle about the origin.
        slow = -np.sqrt(np.maximum(wn**2 - imag**2, 0.0))
        edges.append(np.minimum(np.minimum(_real_part(zeta, imag), slow), -max(product, 0.0)))
    return edges[0], edges[1], edges[2]


def root_limits(mode: str, category: str, aircraft_class: str) -> tuple[float, float, float]:
    """Return the largest real root [1/s] of roll or spiral at Levels 1, 2 and 3.

    Raises ValueError for another mode.
    """
    if mode == "roll":
        one, two, three = (-1.0 / constant for constant in roll_limits_s(category, aircraft_class))
    elif mode == "spiral":
        one, two, three = (math.log(2.0) / double for double in spiral_limits_s(category))
    else:
        raise ValueError(f"mode {mode!r}: allowed are roll, spiral")
    return one, two, three


def cap_limits(category: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the limits of CAP [1/(g s^2)] at Levels 1 and 2; Level 3 has Level 2's lower one."""
    return CAP[category]


def _real_part(zeta: float, imag: FloatArray) -> FloatArray:
    """Return the real part of a pair with a damping below 1."""
    return np.asarray(-zeta / math.sqrt(1.0 - zeta**2) * imag)


# Modes over airspeed: a trim and a linear model at each speed.

SLOWEST, FASTEST, STEPS = 0.7, 1.6, 12
"""Default speeds: range as shares of the requested speed, and number of steps."""
_MAX_FAILURES = 2


@dataclass(frozen=True)
class LocusPoint:
    """Modes and levels at one true airspeed [m/s], with n/alpha [g/rad]."""

    V_mps: float
    modes: tuple[Mode, ...]
    levels: tuple[Assessment, ...]
    n_alpha: float


@dataclass(frozen=True)
class Locus:
    """Points by rising speed, and the speeds [m/s] without a trim with their reasons."""

    points: tuple[LocusPoint, ...]
    refused: tuple[tuple[float, str], ...]


def default_speeds(
    V_mps: float, low: float | None = None, high: float | None = None
) -> tuple[float, ...]:
    """Return evenly spaced speeds [m/s] from ``low`` to ``high``, by default .7 to 1.6 times V."""
    first, last = SLOWEST * V_mps if low is None else low, FASTEST * V_mps if high is None else high
    return tuple(float(v) for v in np.linspace(first, last, STEPS + 1))


def locus_point(model: LinearModel, category: str, aircraft_class: str) -> LocusPoint:
    """Return modes and levels of a linear model."""
    all_modes = modes(model)
    levels = assess(model, all_modes, category, aircraft_class)
    return LocusPoint(
        model.trim.condition.V_mps, tuple(all_modes), tuple(levels), load_factor_per_alpha(model)
    )


def root_locus(
    aircraft: Aircraft,
    condition: SteadyCondition,
    speeds: Sequence[float],
    category: str,
    aircraft_class: str,
    *,
    first: LocusPoint | None = None,
    callback: Callable[[int, int], None] = lambda done, total: None,
) -> Locus:
    """Return the modes at several airspeeds.

    Parameters
    ----------
    aircraft : Aircraft
        The aircraft.
    condition : SteadyCondition
        Flight condition; only its airspeed is varied.
    speeds : sequence of float
        True airspeeds [m/s].
    category, aircraft_class : str
        As of `assess`.
    first : LocusPoint, optional
        The point at the condition's own speed, if known.
    callback : callable
        Called with the numbers of finished and of all speeds.

    Notes
    -----
    Speeds are tried outwards from the condition's own. A trim that does not exist takes ten times
    as long as one that does: after two failures in a row, the remaining speeds of that side are not
    tried.
    """
    centre = condition.V_mps
    points = {} if first is None else {first.V_mps: first}
    refused: dict[float, str] = {}
    all_speeds = sorted(set(speeds) | ({centre} if first is None else set()))
    # Outwards from the known speed on both sides.
    sides = (
        [v for v in reversed(all_speeds) if v <= centre],
        [v for v in all_speeds if v > centre],
    )
    done = 0
    for side, direction in zip(sides, ("slower", "faster"), strict=True):
        failed: list[float] = []
        for V in side:
            done += 1
            if len(failed) >= _MAX_FAILURES:
                refused[V] = (
                    f"not tried: {direction} than {failed[0]:.4g} and {failed[1]:.4g} m/s, which do"
                    " not trim"
                )
            elif V not in points:
                trim = find_trim(aircraft, replace(condition, V_mps=V))
                if trim.converged:
                    points[V] = locus_point(linearise(aircraft, trim), category, aircraft_class)
                    failed = []
                else:
                    refused[V] = trim.reason
                    failed.append(V)
            callback(done, len(all_speeds))
    return Locus(
        tuple(points[v] for v in sorted(points)), tuple((v, refused[v]) for v in sorted(refused))
    )
