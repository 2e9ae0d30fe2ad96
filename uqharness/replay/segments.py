"""A recorded manoeuvre cut out to be flown again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Segment:
    """One piece to fly through.

    time_s (n,) equidistant; controls (n, c) in the record's units, in the model's order of controls; start (9,) as STATES;
    altitude_m above sea level at the start; h_m what the record calls its height there; arm_m place of the accelerometers
    from the CG; targets (n, c) the commands behind measured positions, NaN where there are none. above_ground: whether h_m is that.
    """

    label: str
    flight: str
    time_s: Array
    controls: Array
    start: Array
    altitude_m: float
    h_m: float
    arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    targets: Array | None = None
    above_ground: bool = False

    @property
    def dt_s(self) -> float:
        """Mean time between rows [s]."""
        return float(self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1)
