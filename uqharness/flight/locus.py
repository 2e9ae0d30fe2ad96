"""How the modes move with airspeed: a trim and a linear model at each of several speeds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from uqharness.flight.handling import Assessment, assess, load_factor_per_alpha
from uqharness.simulator import (
    Aircraft,
    LinearModel,
    Mode,
    SteadyCondition,
    find_trim,
    linearise,
    modes,
)

SLOWEST, FASTEST, STEPS = 0.7, 1.6, 12
"""Range of the usual speeds as shares of the speed asked for, and the number of steps in it."""
_GIVEN_UP = 2


@dataclass(frozen=True)
class LocusPoint:
    """Modes and Levels at one true airspeed [m/s], and n/alpha [g/rad] there."""

    V_mps: float
    modes: tuple[Mode, ...]
    levels: tuple[Assessment, ...]
    n_alpha: float


@dataclass(frozen=True)
class Locus:
    """Points by rising speed, and the speeds [m/s] without a trim, each with its reason."""

    points: tuple[LocusPoint, ...]
    refused: tuple[tuple[float, str], ...]


def usual_speeds(
    V_mps: float, low: float | None = None, high: float | None = None
) -> tuple[float, ...]:
    """Speeds [m/s] in even steps from ``low`` to ``high``; without them from 0.7 to 1.6 times ``V_mps``."""
    first, last = SLOWEST * V_mps if low is None else low, FASTEST * V_mps if high is None else high
    return tuple(float(v) for v in np.linspace(first, last, STEPS + 1))


def point_at(model: LinearModel, category: str, aircraft_class: str) -> LocusPoint:
    """Modes and Levels of a linear model."""
    found = modes(model)
    levels = assess(model, found, category, aircraft_class)
    return LocusPoint(
        model.trim.condition.V_mps, tuple(found), tuple(levels), load_factor_per_alpha(model)
    )


def root_locus(
    aircraft: Aircraft,
    condition: SteadyCondition,
    speeds: Sequence[float],
    category: str,
    aircraft_class: str,
    first: LocusPoint | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Locus:
    """Modes at each of ``speeds`` [m/s], all else as in ``condition``.

    Speeds are tried from the condition's own outwards. A trim that does not exist costs ten times as much as one that does, so
    behind two speeds in a row without one the others on that side are listed as not tried. first: the point at the condition's
    own speed, where it is known.
    """
    centre = condition.V_mps
    points = {} if first is None else {first.V_mps: first}
    refused: dict[float, str] = {}
    wanted = sorted(set(speeds) | ({centre} if first is None else set()))
    sides = ([v for v in reversed(wanted) if v <= centre], [v for v in wanted if v > centre])
    done = 0
    for side, beyond in zip(sides, ("slower", "faster"), strict=True):
        failed: list[float] = []
        for V in side:
            done += 1
            if len(failed) >= _GIVEN_UP:
                refused[V] = (
                    f"not tried: {beyond} than {failed[0]:.4g} and {failed[1]:.4g} m/s, which do not trim"
                )
            elif V not in points:
                trim = find_trim(aircraft, replace(condition, V_mps=V))
                if trim.converged:
                    points[V] = point_at(linearise(aircraft, trim), category, aircraft_class)
                    failed = []
                else:
                    refused[V] = trim.reason
                    failed.append(V)
            progress(done, len(wanted))
    return Locus(
        tuple(points[v] for v in sorted(points)), tuple((v, refused[v]) for v in sorted(refused))
    )
