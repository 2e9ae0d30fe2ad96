"""Outputs as the sensors give them: elsewhere than the card says, late, scaled, off by a constant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sysid.arrays import FloatArray
from uqharness.identification.linearised.columns import (
    at_vane,
    sensor_gain,
    sensor_offset,
    vane_place_m,
)
from uqharness.identification.linearised.reference import Probe
from uqharness.identification.linearised.types import Point, Setup
from uqharness.replay import SENSOR_OF, Segment, late_rows


def as_sensed(
    y: FloatArray,
    setup: Setup,
    segment: Segment,
    point: Point,
    earlier: Mapping[str, int] | None = None,
    between: FloatArray | None = None,
    behind: FloatArray | None = None,
) -> FloatArray:
    """(n, m) outputs as the sensors give them: elsewhere, late, scaled, off by a constant. Changes ``y`` in place.

    earlier: channel -> rows by which it is compared with what was measured that much later.
    Where some are late, between: the same outputs between the rows of a replay as well, or behind (n, m): what it takes from them.
    """
    forward = vane_place_m(point)
    if forward:
        y += forward * at_vane(y, setup.outputs)
        between = None if between is None else between + forward * at_vane(between, setup.outputs)
    for k, c in enumerate(setup.outputs):
        late = sensor_late_s(c, segment, point) - (earlier or {}).get(c, 0) * segment.dt_s
        if late and np.isfinite(y[:, k]).all():
            if behind is not None:
                y[:, k] -= behind[:, k]
            elif between is not None:
                y[:, k] = late_rows(between[:, k], len(y), late / segment.dt_s)
        y[:, k] *= sensor_gain(c, point)
        y[:, k] += sensor_offset(c, segment, point)
    return y


def placed(segment: Segment, point: Point) -> Segment:
    """The segment with the accelerometers where they are at a point."""
    x, y, z = (
        own + point.effects.get(f"effect/sensor.accelerometer/place_{axis}", 0.0)
        for axis, own in zip("xyz", segment.arm_m, strict=True)
    )
    return segment if (x, y, z) == tuple(segment.arm_m) else replace(segment, arm_m=(x, y, z))


def sensor_late_s(channel: str, segment: Segment, point: Point) -> float:
    """By how much a channel is late at a point [s]."""
    sensor = SENSOR_OF.get(channel, channel)
    own = {sensor, channel}
    return point.nuisance.get(f"delay/{segment.flight}/{sensor}", 0.0) + sum(
        point.effects.get(f"effect/sensor.{s}/delay", 0.0) for s in own
    )


def moved_later(values: FloatArray, rows: float) -> FloatArray:
    """(n,) values as they come ``rows`` later, along a cubic; the first, or for negative rows the last, held beyond the ends."""
    # Takes a tenth of a second to load, and few flights have a late sensor.
    from scipy.interpolate import CubicSpline

    at = np.arange(len(values), dtype=float)
    return np.asarray(CubicSpline(at, values)(np.clip(at - rows, 0.0, at[-1])))


def late_rate(p: Probe, channel: str, values: FloatArray, late_s: float) -> FloatArray:
    """(n,) rate of change of an output that is late: in a replay that of the time before each row (after it, if early), since a
    step of a control makes a kink at a row."""
    if not p.reference.consistent or late_s == 0.0:
        return p.rate_of(channel, values)
    step = np.diff(values) / p.reference.dt_s
    return np.concatenate([[0.0], step] if late_s > 0.0 else [step, [0.0]])
