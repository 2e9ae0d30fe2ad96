"""Flying-quality levels of MIL-F-8785C for the modes of a linear model.

The numbers are the specification's tables; levels are 1, 2, 3, or 4 for worse than Level 3. They were written for piloted aircraft:
for a small unmanned one they are a yardstick, not a requirement.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from sysid.units import G0_MPS2
from uqharness.simulator import MODE_NAMES, LinearModel, Mode

CATEGORIES = ("A", "B", "C")
CLASSES = ("I", "II-L", "II-C", "III", "IV")

# 3.2.2.1.2, Table IV: short-period damping, (Level 1 low, high), (Level 2 low, high), Level 3 low.
SHORT_PERIOD_DAMPING = {
    "A": ((0.35, 1.30), (0.25, 2.00), 0.15),
    "B": ((0.30, 2.00), (0.20, 2.00), 0.15),
    "C": ((0.35, 1.30), (0.25, 2.00), 0.15),
}
# 3.2.2.1.1, Figs 1-3: CAP = wn^2/(n/alpha) in g rad^-1 s^-2 for Levels 1 and 2; the lower Level 2 bound is Level 3's too.
CAP = {
    "A": ((0.28, 3.6), (0.16, 10.0)),
    "B": ((0.085, 3.6), (0.038, 10.0)),
    "C": ((0.16, 3.6), (0.096, 10.0)),
}
# 3.2.1.2: least damping at Levels 1 and 2, shortest time to double amplitude [s] at Level 3.
PHUGOID_DAMPING, PHUGOID_DOUBLE_S = (0.04, 0.0), 55.0
# 3.2.1.1: airspeed must not diverge without oscillation at Levels 1 and 2; shortest time to double
# amplitude [s] at Level 3.
DIVERGENCE, DIVERGENCE_DOUBLE_S = "3.2.1.1", 6.0
# 3.3.1.4: least zeta wn [rad/s] of a coupled roll-spiral oscillation at Levels 1, 2 and 3 in
# categories B and C; category A permits none.
ROLL_SPIRAL_RADPS = (0.5, 0.3, 0.15)


@dataclass(frozen=True)
class Assessment:
    """One requirement met or not: the criterion, its value and unit, the level reached (1..4), the paragraph."""

    mode: str
    criterion: str
    value: float
    unit: str
    level: int
    paragraph: str


def assess(
    model: LinearModel, found: Sequence[Mode], category: str = "B", aircraft_class: str = "I"
) -> list[Assessment]:
    """Levels of every mode that has a requirement. ValueError for an unknown category or class."""
    if category not in CATEGORIES or aircraft_class not in CLASSES:
        raise ValueError(
            f"category {category!r}, class {aircraft_class!r}: allowed are {', '.join(CATEGORIES)} and {', '.join(CLASSES)}"
        )
    by_name: dict[str, list[Mode]] = {name: [] for name in MODE_NAMES}
    for mode in found:
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
    """n/alpha [g/rad] = -Z_w V / g, from the linear model's Z_w."""
    return -float(model.A[2, 2]) * model.trim.condition.V_mps / G0_MPS2


def _short_period(
    roots: list[Mode], third: list[Mode], model: LinearModel, category: str
) -> list[Assessment]:
    """Judge the short period, or the pair that takes its place.

    Beside a third oscillatory mode the short period is one real root. The pitch response to a
    control then oscillates with the pair, which is judged instead of it.
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
        1 if _within(zeta, first) else 2 if _within(zeta, second) else 3 if zeta >= third_low else 4
    )
    cap = wn**2 / load_factor_per_alpha(model)
    one, two = CAP[category]
    control = 1 if _within(cap, one) else 2 if _within(cap, two) else 3 if cap >= two[0] else 4
    return [
        Assessment(name, "damping", zeta, "1", damping, "3.2.2.1.2"),
        Assessment(name, "CAP", cap, "1/(g s^2)", control, "3.2.2.1.1"),
        *divergence,
    ]


def _damping_and_frequency(pair: list[Mode]) -> tuple[float, float]:
    """Return zeta and wn [rad/s] of a pair, or of two real roots of one sign as a pair."""
    if len(pair) == 1:
        return pair[0].zeta, pair[0].wn_radps
    wn = math.sqrt(pair[0].real * pair[1].real)
    return -(pair[0].real + pair[1].real) / (2 * wn), wn


def _divergence(root: Mode) -> Assessment:
    """Judge an unstable real root of the longitudinal motion."""
    double = math.log(2.0) / root.real
    level = 3 if double >= DIVERGENCE_DOUBLE_S else 4
    return Assessment(root.name, "divergence, time to double", double, "s", level, DIVERGENCE)


def _phugoid(pair: list[Mode]) -> list[Assessment]:
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
    """Least zeta, zeta wn [rad/s] and wn [rad/s] at Levels 1, 2 and 3 (3.3.1.1, Table VI)."""
    light = aircraft_class in ("I", "IV")
    if category == "A":
        one = (0.19, 0.35, 1.0 if light else 0.4)
    elif category == "B":
        one = (0.08, 0.15, 0.4)
    else:
        one = (0.08, 0.15, 1.0) if light or aircraft_class == "II-C" else (0.08, 0.10, 0.4)
    return one, (0.02, 0.05, 0.4), (0.0, -math.inf, 0.4)


def roll_limits_s(category: str, aircraft_class: str) -> tuple[float, float, float]:
    """Longest roll time constant [s] at Levels 1, 2 and 3 (3.3.1.2, Table VII)."""
    quick = aircraft_class in ("I", "IV") or (category == "C" and aircraft_class == "II-C")
    return (1.0, 1.4, 10.0) if quick and category != "B" else (1.4, 3.0, 10.0)


def spiral_limits_s(category: str) -> tuple[float, float, float]:
    """Shortest time to double amplitude [s] at Levels 1, 2 and 3 (3.3.1.3, Table VIII)."""
    return (20.0 if category == "B" else 12.0, 8.0, 4.0)


def _dutch_roll(pair: list[Mode], category: str, aircraft_class: str) -> list[Assessment]:
    if len(pair) == 2 and max(root.real for root in pair) >= 0:
        return [Assessment("dutch_roll", "damping", float("nan"), "1", 4, "3.3.1.1")]
    zeta, wn = _damping_and_frequency(pair)
    decay = -pair[0].real if len(pair) == 1 else zeta * wn
    level = _first(
        zeta >= least_zeta and decay >= product and wn >= least_wn
        for least_zeta, product, least_wn in dutch_roll_limits(category, aircraft_class)
    )
    return [Assessment("dutch_roll", "damping", zeta, "1", level, "3.3.1.1")]


def _roll_spiral(found: list[Mode], category: str) -> list[Assessment]:
    """Judge a coupled roll-spiral oscillation (lateral phugoid)."""
    return [
        Assessment(
            mode.name,
            "coupled roll-spiral, zeta wn",
            -mode.real,
            "rad/s",
            4 if category == "A" else _first(-mode.real >= limit for limit in ROLL_SPIRAL_RADPS),
            "3.3.1.4",
        )
        for mode in found
    ]


def _roll(found: list[Mode], category: str, aircraft_class: str) -> list[Assessment]:
    if not found:
        return []
    real = found[0].real
    if real >= 0:
        return [Assessment("roll", "time constant", float("nan"), "s", 4, "3.3.1.2")]
    constant = -1.0 / real
    level = _first(constant <= limit for limit in roll_limits_s(category, aircraft_class))
    return [Assessment("roll", "time constant", constant, "s", level, "3.3.1.2")]


def _spiral(found: list[Mode], category: str) -> list[Assessment]:
    if not found:
        return []
    real = found[0].real
    if real <= 0:
        return [Assessment("spiral", "time to double", math.inf, "s", 1, "3.3.1.3")]
    double = math.log(2.0) / real
    level = _first(double >= limit for limit in spiral_limits_s(category))
    return [Assessment("spiral", "time to double", double, "s", level, "3.3.1.3")]


def _first(met: Iterable[bool]) -> int:
    """The best Level whose limit is met, 4 for none."""
    return next((level for level, yes in enumerate(met, start=1) if yes), 4)


def _within(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= value <= limits[1]
