"""Properties of JSBSim's own flight control model: which change with which, which take no value, and the engines' levers."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping

from uqharness.batch.form.ir import Value
from uqharness.batch.translate.frame import Frame
from uqharness.batch.translate.properties import writable

_WITH_SIZE = ("left-aileron", "right-aileron", "elevator", "rudder")
_SURFACES = (*_WITH_SIZE, "flap", "speedbrake", "spoiler")
_LEVERS = ("throttle", "mixture", "advance", "feather")
CHANNEL_STEP = "simulation/channel-dt"
_NO_VALUE = re.compile(
    r"fcs/mag-.*-pos-rad|fcs/feather-.*|.*/(saturated|initial-integrator-value|randomseed|malfunction/fail_(zero|hardover|stuck|low|high))"
)


def read_only(name: str) -> bool:
    """Whether JSBSim ignores what a component writes to it, or takes it otherwise than as a value."""
    return bool(_NO_VALUE.fullmatch(name)) or not writable(name)


def _surface(surface: str, degrees: bool) -> Callable[[Frame, Value], None]:
    """Surfaces stand in radians and degrees: either sets the other, and their size."""

    def write(frame: Frame, value: Value) -> None:
        radians = value * (math.pi / 180.0) if degrees else value
        frame.store(f"fcs/{surface}-pos-deg", value if degrees else value * (180.0 / math.pi))
        frame.store(f"fcs/{surface}-pos-rad", radians)
        if surface in _WITH_SIZE:
            frame.store(f"fcs/mag-{surface}-pos-rad", frame.builder.op("abs", radians))

    return write


HOOKS: Mapping[str, Callable[[Frame, Value], None]] = {
    f"fcs/{surface}-pos-{unit}": _surface(surface, unit == "deg")
    for surface in _SURFACES
    for unit in ("rad", "deg")
}
"""For ``Frame.hooks``: properties whose setting moves others."""


def copy_levers(frame: Frame, engines: int) -> None:
    """Put each engine's levers where they are commanded, as JSBSim does in every frame before the channels."""
    for number in range(engines):
        index = f"[{number}]" if number else ""
        for lever in _LEVERS:
            frame.write(f"fcs/{lever}-pos-norm{index}", frame.get(f"fcs/{lever}-cmd-norm{index}"))
