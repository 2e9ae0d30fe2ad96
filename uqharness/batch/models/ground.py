"""Contact of gear and structure with the ground: it ends a flight, so no forces of contact are computed.

A contact point touches where it lies below the ground; one that retracts counts while its gear is down. JSBSim looks for contact
behind the aerodynamics, with the place and attitude of the same frame.
"""

from __future__ import annotations

from collections.abc import Sequence

from uqharness.batch.form.ir import Value
from uqharness.batch.models.auxiliary import arm
from uqharness.batch.models.motion import MATRIX, matrix
from uqharness.batch.models.vectors import dot
from uqharness.batch.translate.frame import TIME, Frame
from uqharness.flight import ContactPoint

TOUCHED = "#ground/time"
"""Slot: when a point first touched [s]; -1 until then."""
POINT = "#ground/point"
"""Slot: the number of that point."""
_DOWN = 0.99
"""Position of a gear from which on JSBSim takes it for down."""


def trace_ground(frame: Frame, points: Sequence[ContactPoint]) -> None:
    """Remember the first contact. Behind the initialising frames TOUCHED tells of a flight that starts on the ground."""
    if not points:
        return
    b = frame.builder
    down = matrix(frame, MATRIX)
    height = frame.get("position/h-agl-ft")
    touched, point = frame.memory(TOUCHED[1:], -1.0), frame.memory(POINT[1:], -1.0)
    number: Value = b.constant(-1.0)
    for k, contact in reversed(list(enumerate(points))):
        x, y, z = (b.constant(c) for c in contact.at_in)
        # How far the point lies below the CG: the body's axes seen from the local vertical.
        below = dot((down[0][2], down[1][2], down[2][2]), arm(frame, (x, y, z)))
        low = (height - below).lt(0.0)
        if contact.retracts:
            low = b.op("and", low, frame.get("gear/gear-pos-norm").gt(_DOWN))
        number = low.choose(float(k), number)
    first = b.op("and", number.ge(0.0), touched.lt(0.0))
    frame.remember(TOUCHED[1:], first.choose(frame.get(TIME), touched), -1.0)
    frame.remember(POINT[1:], first.choose(number, point), -1.0)
