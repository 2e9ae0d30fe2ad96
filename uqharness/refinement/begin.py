"""Where a round of the refinement begins: everything moved to its estimate on the linearised flight together with the effects.

An effect that the parameters have made up for so far cannot be put in by itself: with a centre of gravity elsewhere and Cm_alpha
as it was, the replay is worse than without, and no step leads down from there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sysid.effects import OVERWHELMING, TRACE, Evidence, Selection, Twins, judged
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


def strong_first(
    selection: Selection, evidence: Evidence, free: Sequence[str], odds: Mapping[str, float], confirming: NDArray[np.bool_],
    twins: Twins | None, alone: bool = False,
) -> Selection:  # fmt: skip
    """The choice less what is weak beside its strongest: what linearisation leaves of a strong effect looks like a weak one.

    Those come to their turn when it has been flown. alone: an overwhelming one flies by itself, as about the flight as measured in
    gusts: beside a vane that reads 1.8 times the angle, a centre of gravity elsewhere had two thirds of its |t|, and stayed.
    """
    top = max((abs(c.t) for c in selection.chosen), default=0.0)
    least = top if alone and top > OVERWHELMING else TRACE * top
    kept = [c.key for c in selection.chosen if abs(c.t) >= least]
    if len(kept) == len(selection.chosen):
        return selection
    later = ", ".join(c.key for c in selection.chosen if c.key not in kept)
    chosen = judged(evidence, free, kept, list(odds), confirming, twins)
    return Selection(chosen, selection.refused, (*selection.trail, f"put off until the strong ones fly: {later}"))
