"""How a channel of a flight record is shown to people: its quantity, its unit, the factor that brings it there."""

from __future__ import annotations

import re
from collections.abc import Iterable

from sysid.units import RAD_DEG

_UNITS = {
    "rad": ("deg", RAD_DEG),
    "radps": ("deg/s", RAD_DEG),
    "mps": ("m/s", 1.0),
    "mps2": ("m/s²", 1.0),
    "m": ("m", 1.0),
    "deg": ("deg", 1.0),
    "pct": ("%", 1.0),
    "s": ("s", 1.0),
    "kgpm3": ("kg/m³", 1.0),
    "rpm": ("1/min", 1.0),
}
_CONTROLS = {"elevator": "deg", "aileron": "deg", "rudder": "deg", "throttle": "%"}


def shown_channel(name: str) -> tuple[str, str, float]:
    """Quantity, unit and factor: ``("q", "deg/s", 57.3)`` of ``q_radps``, angles in degrees.

    A name without a unit is a number, its unit ``-``.
    """
    if name in _CONTROLS:
        return name, _CONTROLS[name], 1.0
    quantity, _, unit = name.rpartition("_")
    if not quantity or unit not in _UNITS:
        return name, "-", 1.0
    label, factor = _UNITS[unit]
    return quantity.replace("_", " "), label, factor


def axis_label(name: str) -> str:
    """Quantity and unit for an axis."""
    quantity, unit, _ = shown_channel(name)
    return f"{quantity} [{unit}]"


def with_shown_names(text: str, channels: Iterable[str]) -> str:
    """The text with names of columns as people read them: ``q`` for ``q_radps``. channels: the columns that it may name."""
    names = {c: shown_channel(c)[0] for c in channels}
    found = re.compile(r"\b(" + "|".join(map(re.escape, names)) + r")\b") if names else None
    return text if found is None else found.sub(lambda match: names[match[0]], text)
