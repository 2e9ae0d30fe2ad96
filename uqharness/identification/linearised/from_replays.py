"""The fit of the model as it is: its parameters re-identified, those that the flights do not determine left alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from uqharness.identification.linearised.columns import sensor_gain, unsensed
from uqharness.identification.linearised.sensed import sensor_late_s
from uqharness.identification.linearised.types import Point, Setup
from uqharness.identification.replay_fit import Observed, ReplayFit
from uqharness.replay import CONTROL_DELAY, UNSEEN


def observed(setup: Setup, sensed: Mapping[str, float] | None = None) -> Observed:
    """What a fit compares replays with; sensed: values of sensors' effects by key, taken out of what was measured."""
    late = {**setup.late, **dict.fromkeys(setup.timed, (CONTROL_DELAY,))}
    if not sensed:
        return Observed(setup.segments, setup.outputs, setup.measured, setup.biased, late)
    point = Point({}, {}, (), dict(sensed))
    late_s = {c: sensor_late_s(c, setup.segments[0], point) for c in setup.outputs}
    data = [
        np.column_stack([unsensed(z[:, k], c, s, point) for k, c in enumerate(setup.outputs)])
        for z, s in zip(setup.measured, setup.segments, strict=True)
    ]
    return Observed(setup.segments, setup.outputs, data, setup.biased, late, late_s)


def point_of(
    found: ReplayFit, setup: Setup, names: Sequence[str], sensed: Mapping[str, float] | None = None
) -> Point:
    """Where a fit of properties ``names`` ended, with the sensors' effects that were taken out of what was measured; 0 stands for
    what the fit has not estimated."""
    estimates = found.values()
    nuisance = {n: estimates.get(n.replace("lateness/", "delay/"), 0.0) for n in setup.nuisance}
    nuisance |= {n: v for n, v in estimates.items() if n.startswith(f"{UNSEEN}/")}
    point = Point(
        {n: estimates[n] for n in names}, nuisance, tuple(found.starts()), dict(sensed or {})
    )
    return replace(point, nuisance={n: value * _gain(n, point) for n, value in nuisance.items()})


def begun_at(point: Point) -> dict[str, float]:
    """The other way: values by the names of a fit's layout from which a point's biases, delays and shares are sought."""
    return {
        n.replace("lateness/", "delay/"): value / _gain(n, point)
        for n, value in point.nuisance.items()
    }


def _gain(name: str, point: Point) -> float:
    """By what a sensor multiplies a bias of that name, of the channel before it; 1 of all that is no bias."""
    return sensor_gain(name.split("/")[2], point) if name.startswith("bias/") else 1.0
