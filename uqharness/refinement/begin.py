"""Where a round of the refinement begins: everything moved to its estimate on the linearised flight together with the effects.

An effect that the parameters have made up for so far cannot be put in by itself: with a centre of gravity elsewhere and Cm_alpha
as it was, the replay is worse than without, and no step leads down from there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from sysid.effects import Evidence
from uqharness.refinement.fit import moved_starts, stepped
from uqharness.refinement.types import Point, Setup


@dataclass(frozen=True)
class About:
    """A flight with its evidence: the point flown, the evidence as it would be without effects, values of those flown."""

    point: Point
    evidence: Evidence
    flown: Mapping[str, float]


def joint_point(
    about: About,
    setup: Setup,
    plain: Point,
    free: Sequence[str],
    keys: Sequence[str],
    limits: Mapping[str, tuple[float, float]],
) -> Point:
    """Parameters, nuisance and start states where they are best beside the effects ``keys``, linearly; no effect in it yet.

    setup: without effects; plain: a point of it, whose other properties stay.
    """
    evidence = about.evidence
    delta = evidence.fitted(evidence.index([*free, *keys]))
    step = {n: float(delta[i]) for n, i in zip(free, evidence.index(free), strict=True)}
    values = {n: about.point.values.get(n, v) for n, v in plain.values.items()}
    moved = stepped(setup, replace(plain, values=values, nuisance=about.point.nuisance), step, limits)
    change = delta.copy()
    for key, value in about.flown.items():
        change[evidence.index([key])[0]] -= value
    return replace(moved, starts=moved_starts(about.point.starts, evidence.white, change))
