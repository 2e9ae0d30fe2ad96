"""Translate ``<waypoint_heading>`` and ``<waypoint_distance>``: geodesics on the ellipsoid.

Between nearly opposite points the flight is noted as beyond the engine.
"""

from __future__ import annotations

import math

from sysid.units import FT_M, SHORT_DEG_RAD
from uqharness.batch.form.ir import Value
from uqharness.batch.models.geodesic import geodesic
from uqharness.batch.translate.component import Component


def waypoint_heading(c: Component) -> None:
    """Trace the azimuth of the geodesic from source to target, -pi to pi."""
    unit = c.node.attributes.get("unit", "") or "RAD"
    if unit not in ("RAD", "DEG"):
        c.scope.refuse(c.node, f"unit='{unit}' of <waypoint_heading>: allowed are RAD and DEG")
    azimuth, _ = _geodesic(c)
    c.write_outputs(c.clipped(azimuth * (180.0 / math.pi) if unit == "DEG" else azimuth))


def waypoint_distance(c: Component) -> None:
    """Trace the length of the geodesic from source to target."""
    unit = c.node.attributes.get("unit", "") or "FT"
    if unit not in ("FT", "M"):
        c.scope.refuse(c.node, f"unit='{unit}' of <waypoint_distance>: allowed are FT and M")
    _, distance = _geodesic(c)
    c.write_outputs(c.clipped(distance * FT_M if unit == "M" else distance))


def _geodesic(c: Component) -> tuple[Value, Value]:
    """Return azimuth at the source [rad] and length [ft] of the geodesic."""
    lat1, lon1 = _coordinate(c, "source_latitude"), _coordinate(c, "source_longitude")
    lat2, lon2 = _coordinate(c, "target_latitude"), _coordinate(c, "target_longitude")
    # JSBSim ends the flight for a latitude beyond the poles.
    for latitude in (lat1, lat2):
        c.scope.note_beyond(c.builder.op("abs", latitude).gt(math.pi / 2.0))
    azimuth, length, is_beyond = geodesic(c.builder, (lat1, lon1), (lat2, lon2))
    c.scope.note_beyond(is_beyond)
    return azimuth, length


def _coordinate(c: Component, tag: str) -> Value:
    """Return a latitude or longitude [rad]."""
    node = c.needed(tag)
    c.scope.only(node, ("unit",))
    degrees = node.attributes.get("unit", "") == "DEG"
    value = c.scope.property_value(node)
    return value * SHORT_DEG_RAD if degrees else value
