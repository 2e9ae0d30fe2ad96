"""Order of filter error's unknowns in one vector: parameters, process noise, measurement noise, initial states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray


@dataclass(frozen=True)
class Layout:
    """Order of the vector: free theta, Q of noisy states, ln r, initial states segment by segment.

    Q enters as a variance with zero as its bound: there its gradient tells whether the data want any (as a logarithm it
    would run away along a flat valley), and Fisher scoring is nearly exact in variances. R has no such bound.
    """

    theta0: FloatArray
    columns: NDArray[np.intp]
    noisy: NDArray[np.intp]
    outputs: int
    states: int
    segments: int
    with_x0: bool

    @property
    def process(self) -> slice:
        """Where the process-noise variances stand."""
        return slice(self.columns.size, self.columns.size + self.noisy.size)

    @property
    def logs(self) -> slice:
        """Where the logarithms of the measurement noise stand."""
        return slice(self.process.stop, self.process.stop + self.outputs)

    def pack(self, theta: FloatArray, q: FloatArray, r: FloatArray, x0: FloatArray) -> FloatArray:
        """The search's vector from parameters (k,), process noise (nx,), noise (ny,) and start states (segments, nx)."""
        parts = [theta[self.columns], q[self.noisy], np.log(r)]
        return np.concatenate([*parts, x0.T.ravel()] if self.with_x0 else parts)

    def unpack(
        self, vector: FloatArray, x0: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """theta (k,), Q (nx,) variances per second, r (m,) standard deviations, x0 (nx, s)."""
        theta, q = self.theta0.copy(), np.zeros(self.states)
        a, b = self.columns.size, self.columns.size + self.noisy.size
        theta[self.columns] = vector[:a]
        q[self.noisy] = vector[a:b]
        r = np.exp(vector[b : b + self.outputs])
        if self.with_x0:
            x0 = vector[b + self.outputs :].reshape(self.segments, self.states).T
        return theta, q, r, x0

    def limits(
        self, lower: FloatArray, upper: FloatArray, scale: FloatArray, spread: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Bounds of the whole vector: Q up to (a thousand states' scales)^2, r within 1e-5 and 10 of the spread."""
        low = [lower[self.columns], np.zeros(self.noisy.size), np.log(1e-5 * spread)]
        high = [upper[self.columns], (1e3 * scale[self.noisy]) ** 2, np.log(1e1 * spread)]
        extra = [np.full(self.segments * self.states, np.inf)] if self.with_x0 else []
        return np.concatenate(low + [-part for part in extra]), np.concatenate(high + extra)

    def names(self, labels: tuple[str, ...]) -> list[str]:
        """Name of every entry of the search's vector, in its order."""
        out = [labels[i] for i in self.columns] + [f"Q of state {i}" for i in self.noisy]
        out += [f"ln r of output {i}" for i in range(self.outputs)]
        if self.with_x0:
            out += [
                f"x0[{i}] of segment {s}" for s in range(self.segments) for i in range(self.states)
            ]
        return out
