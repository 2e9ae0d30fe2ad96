"""Lift line and drag polar, as stability-axis formats hold them.

Over the box of angles of attack the lift coefficient is a line in alpha, and the drag coefficient a
parabola in the lift coefficient, both by least squares.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uqharness.exchange.states import Derivatives, SourceModel

_ALPHA_HALF_WIDTH_RAD = 0.1
_NO_INDUCED_DRAG = 1e9


@dataclass(frozen=True)
class LiftDrag:
    """CL = lift_0 + lift_alpha alpha; CD = drag_0 + induced CL^2.

    Attributes
    ----------
    lift_0, lift_alpha : float
        Constant [-] and slope [1/rad].
    drag_0, induced : float
        Drag without lift [-], and the factor of CL^2 [-].
    """

    lift_0: float
    lift_alpha: float
    drag_0: float
    induced: float

    def oswald(self, aspect_ratio: float) -> float:
        """Return Oswald's factor: induced = 1 / (pi e AR); very large without induced drag."""
        if self.induced <= 0.0:
            return _NO_INDUCED_DRAG
        return 1.0 / (math.pi * aspect_ratio * self.induced)


def lift_drag(source: SourceModel, lift: Derivatives, drag: Derivatives) -> LiftDrag:
    """Fit lift line and drag polar to the source's CL and CD at the trim's controls of zero rates.

    Deflections are 0: their lift and drag are terms of their own.
    """
    alphas = source.trim.alpha_rad + _ALPHA_HALF_WIDTH_RAD * np.linspace(-1.0, 1.0, 41)
    lifts = np.array([lift.at({"alpha": float(a)}) for a in alphas])
    drags = np.array([drag.at({"alpha": float(a)}) for a in alphas])
    slope, constant = np.polyfit(alphas, lifts, 1)
    # CD over CL^2 of the line, which is what the formats compute.
    squares = (constant + slope * alphas) ** 2
    induced, drag_0 = np.polyfit(squares, drags, 1)
    if induced <= 0.0:
        # Drag that falls with lift has no Oswald factor; the loss shows what that costs.
        induced, drag_0 = 0.0, float(drags.mean())
    return LiftDrag(float(constant), float(slope), float(drag_0), float(induced))
