"""Airspeed and angles of flow from the three components of the motion through the air. Pure numerics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray

COMPONENTS = ("u_mps", "v_mps", "w_mps")
"""Columns of a table, m/s in body axes: forward, right, down."""


def speed_of(u: FloatArray, v: FloatArray, w: FloatArray) -> FloatArray:
    """(n,) true airspeed, in the unit of the components."""
    return np.sqrt(u**2 + v**2 + w**2)


def alpha_of(u: FloatArray, w: FloatArray) -> FloatArray:
    """(n,) angle of attack, rad; NaN where nothing moves in the plane of symmetry."""
    return np.where((u != 0.0) | (w != 0.0), np.arctan2(w, u), np.nan)


def beta_of(u: FloatArray, v: FloatArray, w: FloatArray) -> FloatArray:
    """(n,) sideslip, rad, + air from the right; NaN where nothing moves."""
    speed = speed_of(u, v, w)
    return np.arcsin(np.divide(v, speed, out=np.full_like(speed, np.nan), where=speed > 0.0))


def components_of(
    speed: FloatArray, alpha: FloatArray, beta: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """u, v, w, each (n,), in the unit of the speed: the inverse."""
    return (
        speed * np.cos(alpha) * np.cos(beta),
        speed * np.sin(beta),
        speed * np.sin(alpha) * np.cos(beta),
    )


def with_air_data(columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Columns of a table with V, alpha and beta made of u, v, w where it has no such columns of its own; u, v, w are left out."""
    out = {name: values for name, values in columns.items() if name not in COMPONENTS}
    if not all(name in columns for name in COMPONENTS):
        return out
    u, v, w = (np.asarray(columns[name], dtype=np.float64) for name in COMPONENTS)
    with np.errstate(invalid="ignore", over="ignore"):
        made = {
            "V_mps": speed_of(u, v, w),
            "alpha_rad": alpha_of(u, w),
            "beta_rad": beta_of(u, v, w),
        }
    return {**made, **out}
