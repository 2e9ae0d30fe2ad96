"""Where controls stand between rows: paths that are not straight, jumps at a row, and what accelerometers have seen of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics.rigid_body import STATES
from sysid.arrays import FloatArray
from sysid.parallel import Processes
from uqharness.identification.linearised.reference import Probe
from uqharness.identification.linearised.types import Flown, Point, Setup
from uqharness.identification.replay_fit import jumping_in
from uqharness.replay import (
    CONTROLS,
    ReplayModel,
    Segment,
    StatesOf,
    altitudes,
    by_run,
    force_all,
    surface_positions,
)


def with_jumps(setup: Setup, model: ReplayModel) -> Setup:
    """The setup with the flights in which some control of the model jumps: what accelerometers miss of that is estimated."""
    return replace(setup, jumping=tuple(jumping_in(model, setup.segments, setup.late)))


def middles(model: ReplayModel, setup: Setup, point: Point | None = None) -> list[FloatArray]:
    """[(2, n - 1, c)] how far the controls stand from the mean of a step's ends at its middle, and at its end from the next row's.

    A servo's path is no straight line, and a surface without a lag jumps at a row: until then it stands where it stood. Where
    commands act between rows, the middle is such that Simpson's rule has the path's own area.
    """
    cut = [segment.at_commands() for segment in setup.segments]
    held = np.array([c not in model.measured for c in model.controls])
    servos = {} if point is None else setup.properties(point)
    ends = surface_positions(model, cut, CONTROLS, servos)
    halves = (
        surface_positions(model, [_halved(s) for s in cut], CONTROLS, servos)
        if held.any()
        else [None] * len(cut)
    )
    jumps = np.array([c in model.jumping for c in model.controls])
    made = zip(cut, ends, halves, setup.segments, strict=True)
    return [_middle(own, at, half, held, jumps, segment.per_row) for own, at, half, segment in made]


def _halved(segment: Segment) -> Segment:
    """The same flight with rows half as far apart; a command is held over both halves."""
    fine = np.repeat(segment.controls, 2, axis=0)[:-1]
    time_s = np.linspace(segment.time_s[0], segment.time_s[-1], len(fine))
    targets = None if segment.targets is None else np.repeat(segment.targets, 2, axis=0)[:-1]
    return replace(segment, time_s=time_s, controls=fine, targets=targets)


def _middle(
    segment: Segment,
    ends: FloatArray,
    half: FloatArray | None,
    held: NDArray[np.bool_],
    jumps: NDArray[np.bool_],
    k: int,
) -> FloatArray:
    middle = np.where(
        held, ends[:-1], by_run(segment, 2, [not h for h in held], [False] * len(held))[1::2]
    )
    if half is not None:
        middle[:, held] = half[1::2][:, held]
    last = np.where(jumps, middle, ends[1:])
    if k > 1:
        mean = ((ends[:-1] + 4.0 * middle + last) / 6.0).reshape(-1, k, len(held)).mean(axis=1)
        ends, last = ends[::k], last[k - 1 :: k]
        middle = (6.0 * mean - ends[:-1] - last) / 4.0
    return np.stack([middle - 0.5 * (ends[:-1] + ends[1:]), last - ends[1:]])


def bends_of(
    straight: ReplayModel,
    setup: Setup,
    flown: Flown,
    found: Sequence[Probe],
    away: Sequence[FloatArray],
    map_: Processes,
) -> list[FloatArray]:
    """[(2, n - 1, 6)] by how much force and moment at the middle of a step differ from the mean of its ends, and at its end from
    the next row's: what the model says there, the surfaces where they stand by their `middles`, the motion half-way."""
    asked = []
    for segment, p, height, (middle, end) in zip(
        setup.segments, found, flown.height, away, strict=True
    ):
        x, u, h = (
            np.concatenate([0.5 * (v[:-1] + v[1:]), v[1:]])
            for v in (p.reference.x, p.controls, height)
        )
        motion = {name: x[:, k] for k, name in enumerate(STATES)}
        asked.append(
            StatesOf(
                segment, motion, u + np.concatenate([middle, end]), altitudes(straight, segment, h)
            )
        )
    out = []
    for p, forced in zip(
        found, force_all(straight, asked, setup.properties(flown.point), map_), strict=True
    ):
        own = np.hstack([p.reference.force, p.reference.moment])
        there = np.hstack(
            [forced.aero_force + forced.other_force, forced.aero_moment + forced.other_moment]
        )
        middle, end = np.split(there, 2)
        out.append(np.stack([middle - 0.5 * (own[:-1] + own[1:]), end - own[1:]]))
    return out


def jumped(away: FloatArray) -> FloatArray | None:
    """(n, c) by how much the controls jump at each row, by their `middles`; the first row's is not known. None where none does."""
    return np.vstack([np.zeros_like(away[1, :1]), -away[1]]) if away[1].any() else None
