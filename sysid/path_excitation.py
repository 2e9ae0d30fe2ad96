"""What a flight can tell at all, looked up in its measured channels before anything is estimated.

A parameter without excitation must not be estimated in the hope that its standard error will say so: where the signal
is no larger than the noise, the linearised equations take noise for signal and the bound comes out too small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sysid.path_data import PathData
from sysid.path_kinematics import OUTPUTS, WIND

FloatArray = NDArray[np.float64]
MIN_TURN_RAD = 1.0
MIN_SIGNAL_TO_NOISE = 3.0
_SENSORS = {"V": "V_mps", "alpha": "alpha_rad", "beta": "beta_rad"}
_HORIZONTAL = ("vn_mps", "ve_mps", "north_m", "east_m")


def possible(free: Sequence[str], data: PathData) -> tuple[PathData, tuple[str, ...], dict[str, str]]:
    """(data to use, parameters to estimate, name -> reason for the others).

    On a straight course wind and airspeed errors cannot be told apart: neither is estimated, and the horizontal ground
    velocity and position are not compared.
    """
    refused: dict[str, str] = {}
    turn = _turn(data)
    ground = any(c in data.channels for c in _HORIZONTAL)
    straight = ground and turn < MIN_TURN_RAD
    for name in dict.fromkeys(free):
        kind, _, sensor = name.partition("_")
        channel = _SENSORS.get(sensor)
        if channel is not None and channel not in data.channels:
            refused[name] = f"no measured {channel} to compare with"
        elif name in (*WIND[:2], "scale_V", "bias_V") and straight:
            refused[name] = (
                f"the heading stays within {np.degrees(turn):.0f} deg (at least {np.degrees(MIN_TURN_RAD):.0f}):"
                " wind and airspeed error cannot be told apart"
            )
        elif name in (*WIND, "scale_V", "bias_V") and not ground:
            refused[name] = "no ground velocity and no position to compare with"
        elif kind == "scale" and sensor in ("alpha", "beta") and channel is not None:
            signal, noise = _signal(data, channel)
            if signal < MIN_SIGNAL_TO_NOISE * noise:
                refused[name] = f"no excitation: {channel} moves by {signal:.2g} with a noise of {noise:.2g}"
    if straight:
        data = _without_horizontal(data)
    return data, tuple(n for n in dict.fromkeys(free) if n not in refused), refused


def _without_horizontal(data: PathData) -> PathData:
    rows = [OUTPUTS.index(c) for c in _HORIZONTAL]
    stretches = []
    for s in data.stretches:
        measured = s.measured.copy()
        measured[rows] = np.nan
        stretches.append(replace(s, measured=measured))
    return replace(
        data,
        stretches=tuple(stretches),
        channels=tuple(c for c in data.channels if c not in _HORIZONTAL),
        notes=(*data.notes, "a straight course: horizontal ground velocity and position were not compared"),
    )


def _turn(data: PathData) -> float:
    """Largest difference between two headings, rad, at most pi (5 s medians would do; noise is small beside 1 rad)."""
    row = OUTPUTS.index("psi_rad")
    psi = np.concatenate([s.measured[row] for s in data.stretches])
    psi = psi[np.isfinite(psi)]
    middle = np.angle(np.mean(np.exp(1j * psi)))
    away = np.angle(np.exp(1j * (psi - middle)))
    low, high = np.quantile(away, [0.02, 0.98])
    return float(min(np.pi, high - low))


def _signal(data: PathData, channel: str) -> tuple[float, float]:
    """(standard deviation of the smooth part, of the noise) of a channel: noise from second differences."""
    row = OUTPUTS.index(channel)
    series = [s.measured[row][np.isfinite(s.measured[row])] for s in data.stretches]
    series = [v for v in series if len(v) > 10]
    if not series:
        return 0.0, 1.0
    noise = float(np.sqrt(np.mean(np.concatenate([np.diff(v, 2) for v in series]) ** 2) / 6.0))
    total = float(np.std(np.concatenate(series)))
    return float(np.sqrt(max(0.0, total**2 - noise**2))), noise
