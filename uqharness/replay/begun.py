"""Where a segment finds its actuators: behind a lag they are on their way to the commands that came before its first row."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from cachetools import LRUCache, cached

from sysid.arrays import FloatArray
from uqharness.replay.model import ReplayModel
from uqharness.replay.segments import Segment
from uqharness.simulator import SHORTEST_S, Actuator

_KEPT, _MODELS = 512, 16
_STEP_S = 1e-3
"""Longest step of an actuator, from command to command."""


def begun(
    model: ReplayModel, segment: Segment, properties: Mapping[str, float], limits: FloatArray
) -> FloatArray:
    """(c,) where actuators with a lag stand at the first row, and where controls that jump stood before it, in the record's units;
    NaN of other controls, and where no command before it is known. properties: values in force, of which the actuators' own
    count; limits (c, 2): where a command goes no further."""
    out = np.full(len(model.controls), np.nan)
    before = segment.at_commands().before
    if before is None or not len(before):
        return out
    for control in model.jumping:
        k = model.controls.index(control)
        out[k] = np.clip(before[-1, k], *limits[k])
    given = {**_given(model), **properties}
    for control, numbers in model.lags.items():
        k = model.controls.index(control)
        lag, rate = (_number(text, given) for text in numbers)
        if control in model.lagging and np.isfinite(before[:, k]).all() and not math.isnan(lag):
            fastest = math.inf if math.isnan(rate) else abs(rate * model.position_unit(control))
            servo = Actuator(lag if lag * SHORTEST_S < 1.0 else None, fastest)
            out[k] = _last(servo, np.clip(before[:, k], *limits[k]), segment.command_s)
    return out


@cached(
    LRUCache(_KEPT), key=lambda servo, commands, command_s: (servo, commands.tobytes(), command_s)
)
def _last(servo: Actuator, commands: FloatArray, command_s: float) -> float:
    """Where a servo at rest at the first of some commands is when the last of them has been held as long as the others."""
    step_s = command_s / max(1, math.ceil(command_s / _STEP_S - 1e-6))
    return float(servo.follow(np.append(commands, commands[-1]), command_s, step_s)[-1])


@cached(LRUCache(_MODELS), key=lambda model: model.identity)
def _given(model: ReplayModel) -> dict[str, float]:
    """Values in the XML of the properties that actuators' numbers are."""
    fdm = model.open(0.01)
    exists = fdm.get_property_manager().hasNode
    return {name: float(fdm[name]) for name in model.servos if exists(name)}


def _number(text: str, given: Mapping[str, float]) -> float:
    """A number of an actuator, as it stands or as the property that it is; NaN without one."""
    try:
        return float(text)
    except ValueError:
        return given.get(text, math.nan)
