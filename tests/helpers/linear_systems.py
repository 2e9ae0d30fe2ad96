"""Linear systems of the shapes that a linearised flight has."""

from __future__ import annotations

import numpy as np
from scipy.linalg import sqrtm

from sysid.aerodynamics import NX
from sysid.aerodynamics.rigid_body import OUTPUTS, Steps


def system(n: int, seed: int) -> Steps:
    """A stable random system of the right shapes, the first eight states seen."""
    rng = np.random.default_rng(seed)
    phi = np.repeat((0.9 * np.eye(NX) + 0.03 * rng.standard_normal((NX, NX)))[None], n - 1, axis=0)
    half_columns = np.repeat(np.ascontiguousarray(sqrtm(phi[0]).real.T)[None], n - 1, axis=0)
    g0, g1 = (0.1 * rng.standard_normal((n - 1, NX, 6)) for _ in range(2))
    H = np.repeat(rng.standard_normal((len(OUTPUTS), NX))[None], n, axis=0)
    D = np.repeat(0.2 * rng.standard_normal((len(OUTPUTS), 6))[None], n, axis=0)
    defect = 0.05 * rng.standard_normal((n - 1, NX))
    start = np.vstack([np.eye(8), rng.standard_normal((NX - 8, 8))])
    y_ref = rng.standard_normal((n, len(OUTPUTS)))
    return Steps(0.02, phi, half_columns, g0, g1, defect, H, D, y_ref, start)
