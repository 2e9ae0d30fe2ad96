"""The components by their tags: what each may have in it, and how it is traced."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from uqharness.batch.translate.components import filters, gains
from uqharness.batch.translate.components.component import Component

_COEFFICIENTS = tuple(f"c{k}" for k in range(1, 7))
_MEASURED = ("lag", "noise", "drift_rate", "gain", "bias", "quantization")
_CONTROL = ("kp", "kd", "pvdot", "trigger")


@dataclass(frozen=True)
class Kind:
    """``trace`` writes what the component does; ``once`` and ``many`` are its own elements, ``attributes`` those beside name."""

    trace: Callable[[Component], None]
    once: tuple[str, ...] = ()
    many: tuple[str, ...] = ()
    attributes: tuple[str, ...] = ()


KINDS: Mapping[str, Kind] = {
    "pure_gain": Kind(gains.pure_gain, ("gain",)),
    "scheduled_gain": Kind(gains.scheduled_gain, ("gain", "table")),
    "aerosurface_scale": Kind(
        gains.aerosurface_scale, ("gain", "domain", "range", "zero_centered")
    ),
    "summer": Kind(gains.summer, ("bias",)),
    "deadband": Kind(gains.deadband, ("width", "gain")),
    "fcs_function": Kind(gains.fcs_function, ("function",)),
    "angle": Kind(gains.angle, ("source_angle", "target_angle"), attributes=("unit",)),
    "lag_filter": Kind(filters.lag_filter, _COEFFICIENTS),
    "lead_lag_filter": Kind(filters.lead_lag_filter, _COEFFICIENTS),
    "second_order_filter": Kind(filters.second_order_filter, _COEFFICIENTS),
    "washout_filter": Kind(filters.washout_filter, _COEFFICIENTS),
    "pid": Kind(filters.pid, (*_CONTROL, "ki"), attributes=("type",)),
    "integrator": Kind(filters.integrator, (*_CONTROL, "c1")),
    "kinematic": Kind(gains.kinematic, ("traverse", "noscale")),
    "switch": Kind(gains.switch, ("default",), ("test",)),
    "distributor": Kind(gains.distributor, (), ("case",), ("type",)),
    "actuator": Kind(
        filters.actuator, ("lag", "deadband_width", "hysteresis_width", "bias"), ("rate_limit",)
    ),
    "linear_actuator": Kind(
        filters.linear_actuator,
        ("set", "reset", "versus", "bias", "module", "hysteresis", "lag", "rate", "gain"),
    ),
    "sensor": Kind(filters.sensor, _MEASURED),
    "gyro": Kind(filters.gyro, (*_MEASURED, "axis", "orientation")),
    "accelerometer": Kind(filters.accelerometer, (*_MEASURED, "axis", "orientation", "location")),
}
"""Components that are understood."""

REFUSED: Mapping[str, str] = {
    "magnetometer": "takes the field of the day on which it runs",
    "waypoint_heading": "finds geodesics on the ellipsoid, which the batch engine does not",
    "waypoint_distance": "finds geodesics on the ellipsoid, which the batch engine does not",
}
"""Components of JSBSim's that are not, and why."""


def trace(c: Component) -> None:
    """What the component does in the frame. Raises BadInputError with file and line for what is not understood."""
    tag = c.node.tag
    if tag in REFUSED:
        c.scope.refuse(c.node, f'<{tag}> {REFUSED[tag]}; fly this aircraft with engine = "jsbsim"')
    kind = KINDS.get(tag)
    if kind is None:
        c.scope.refuse(c.node, f"component <{tag}> is unknown; allowed are {', '.join(KINDS)}")
    c.check(kind.once, kind.many, kind.attributes)
    kind.trace(c)
