"""Constants of side force, roll and yaw that an aircraft's XML can have: read from its bias properties."""

from __future__ import annotations

from uqharness.replay import ReplayModel
from uqharness.xml import SLOT, read_section

_BIAS = "uq/bias/"
_LATERAL = tuple(SLOT[axis] for axis in ("SIDE", "ROLL", "YAW"))


def lateral_constants(model: ReplayModel) -> tuple[str, ...]:
    """One bias property for each of side force, roll and yaw, of an aircraft whose functions have scales and biases.

    Every aircraft is a little asymmetric and no symmetric model is: a constant moment is no evidence of a control's effect.
    """
    axes = read_section(model.staging.folder, model.staging.xml.name).axes
    out = []
    for slot in _LATERAL:
        nodes = axes[slot].node.walk() if slot in axes else ()
        found = [
            node.text.strip()
            for node in nodes
            if node.tag == "property" and node.text.strip().startswith(_BIAS)
        ]
        out += found[:1]
    return tuple(out)
