"""What is said of an estimation's course: its iteration, how far it has to go, and about how long that takes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass
class Descent:
    """Told each iteration (`sysid.estimation.gauss_newton.Told`), tells ``on_stage`` a sentence.

    Steps become shorter by about a constant factor from one iteration to the next: the time left is that of the iterations until
    they are ``tolerance`` standard errors long, at most of all that are allowed (``most``). Descents that follow one another count
    anew.
    """

    what: str
    on_stage: Callable[[str], None]
    tolerance: float
    most: int
    clock: Callable[[], float] = time.monotonic
    _begun: float = 0.0
    _lengths: list[float] = field(default_factory=list)

    def __call__(self, iteration: int, length: float) -> None:
        """An iteration begins from which the next step would be ``length`` standard errors long."""
        if iteration == 1 or not self._lengths:
            self._begun, self._lengths = self.clock(), []
        self._lengths.append(length)
        text = f"{self.what}: iteration {iteration}"
        if math.isfinite(length):
            text += f", {length:.2g} standard errors to go"
        left = self.seconds_left(iteration)
        self.on_stage(text if left is None else f"{text}, about {max(1, round(left))} s left")

    def seconds_left(self, iteration: int) -> float | None:
        """None in the first iterations of a descent."""
        done = len(self._lengths) - 1
        if done < 2:
            return None
        wanted = max(float(self.most - iteration), 1.0)
        first, last = self._lengths[0], self._lengths[-1]
        if 0.0 < last < first and last > self.tolerance:
            wanted = min(wanted, math.log(last / self.tolerance) * done / math.log(first / last))
        elif last <= self.tolerance:
            wanted = 1.0
        return wanted * (self.clock() - self._begun) / done
