"""Numbers that JSBSim reads once (mass, servos): no step moves them, so they fly again until they stand."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sysid.effects import DIFFERENT, Choice, Selection
from uqharness.refinement.begin import About
from uqharness.refinement.round import Round

HELD_FLIGHTS = 8
"""Flights in which a number that JSBSim reads once may come to its value."""


def far_off(held: Sequence[Choice], written: Mapping[str, float]) -> dict[str, float]:
    """key -> value flown, of numbers that JSBSim reads once and whose estimates lie elsewhere."""
    return {c.key: written[c.key] for c in held if abs(c.value - written[c.key]) > DIFFERENT * c.std}


def at_values(now: Round, fly: Callable[[Selection, About, Path], Round | None], folder: Path) -> Round:
    """The round flown again, its effects the same, until the numbers that JSBSim reads once stand.

    Until they do, what they leave looks like other effects. One whose estimated change is as large as before it was changed, and no
    likelier for it, does not do what its column says, and is left out.

    fly: with effects, from where a round ended, in a folder of its own.
    """
    last: dict[str, tuple[float, float]] = {}
    merit = float("inf")
    for number in range(HELD_FLIGHTS):
        if not now.far:
            break
        chosen = []
        for c in now.selection.chosen:
            if c.key not in now.far:
                chosen.append(c)
                continue
            here = (now.far[c.key], c.value - now.far[c.key])
            nearer = c.key not in last or here[1] * np.sign(last[c.key][1]) < abs(last[c.key][1])
            if nearer or merit - now.merit > DIFFERENT**2:
                chosen.append(replace(c, value=here[0] + ahead(last.get(c.key), here)))
            last[c.key] = here
        if not chosen:
            break
        merit = now.merit
        following = fly(Selection(tuple(chosen)), now.about, folder.with_name(f"{folder.name}-{number}"))
        if following is None:
            break
        now = following
    return now


def ahead(last: tuple[float, float] | None, here: tuple[float, float]) -> float:
    """How far to go from a value at which the estimated change is so much, (value, change), by the secant; at most to twice
    the value.

    A lag's slope falls off with the lag: the next estimated change is a small part of the whole.
    """
    value, change = here
    if last is None or last[0] == value:
        return change
    slope = (change - last[1]) / (value - last[0])
    most = max(abs(change), abs(value))
    return change if not slope < 0.0 else float(np.clip(-change / slope, -most, most))
