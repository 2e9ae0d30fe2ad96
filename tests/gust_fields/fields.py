"""Air of many kinds: gusts of other spectra, turned, cut, delayed, reversed, held or passing at
another speed, and a frozen isotropic von Karman field that is fixed to the earth and met by a wing
of strips, a tail and vanes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from sysid.arrays import FloatArray
from tests.hidden_effects.gusts import FT, KNOT, NODE_S, turbulence

FAMILIES = (
    "heading",
    "body",
    "earth",
    "no-rates",
    "no-velocities",
    "no-q",
    "no-r",
    "q-reversed",
    "independent-rates",
    "lags-0.25",
    "lags-0.5",
    "lags-2",
    "passage-15",
    "passage-35",
    "passage-airspeed",
    "passage-groundspeed",
    "tail-delay",
    "first-order",
    "karman",
    "roll-1797",
    "from-rest",
    "held-20-ms",
    "field-wing",
    "field-boom",
    "field-tip",
)
BODY = "body", "field-wing", "field-boom", "field-tip"
"""Families whose gusts are given in body axes."""
STRIPS, MODES, KARMAN = 8, 700, 1.339
SHORTEST_M, LONGEST_M = 0.4, 2000.0
"""Wavelengths of the field."""


@dataclass(frozen=True)
class Setting:
    """V [m/s], height [m], wind at 20 ft [kt], span [m], tail arm [m] and length of a flight [s]."""

    V: float
    h: float
    w20_kt: float
    b: float
    tail_m: float
    seconds: float
    seed: int


Air = Callable[[float, FloatArray], tuple[FloatArray, FloatArray]]
"""Of a time [s] and a state (12,): the air's velocity and rotation (6,), and by how much the
velocity at the vanes differs from it, body axes (3,) [m/s]."""


def air_of(family: str, setting: Setting) -> Air:
    """Return the air of a family; gusts in heading axes but for those of `BODY`."""
    if family.startswith("field"):
        return frozen_field(setting, family.removeprefix("field-"))
    nodes = dryden(family, setting)
    if family in ("first-order", "karman"):
        nodes = spectral(family, setting)
    last, none = len(nodes) - 2, np.zeros(3)
    wind = mean_wind(family, setting)
    passed_s, before_s = 0.0, 0.0

    def air(time_s: float, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        nonlocal passed_s, before_s
        level = to_earth(np.array([0.0, 0.0, state[8]])).T
        # Gusts are a function of the time that the flight would have taken at its first speed.
        speed = np.linalg.norm(state[:3] - to_earth(state[6:9]).T @ wind)
        if family == "passage-groundspeed":
            speed = np.linalg.norm(state[:3])
        is_at_present_speed = family in ("passage-airspeed", "passage-groundspeed")
        passed_s += (time_s - before_s) * (speed / setting.V if is_at_present_speed else 1.0)
        before_s = time_s
        k, share = divmod(min(passed_s / NODE_S, last), 1.0)
        gust = nodes[int(k)] * (1.0 - share) + nodes[int(k) + 1] * share
        if family == "earth":
            gust = np.concatenate([level @ gust[:3], level @ gust[3:]])
        gust[:3] += level @ wind
        return gust, none

    return air


def mean_wind(family: str, at: Setting) -> FloatArray:
    """(3,) mean wind in earth axes [m/s]; none unless the family has a speed over ground."""
    size = 0.6 * at.w20_kt * KNOT if family == "passage-groundspeed" else 0.0
    return size * np.array([-0.8, 0.6, 0.0])


def spectral(family: str, at: Setting) -> FloatArray:
    """(n, 6) gusts every NODE_S of first-order or von Karman spectra, with scales, rotation and p
    of MIL-F-8785C, as sums of sines."""
    rng = np.random.default_rng([at.seed, 6])
    feet = at.h / FT
    profile = 0.177 + 0.000823 * feet
    n = 4 * round(at.seconds / NODE_S)
    omega = 2.0 * np.pi * np.fft.rfftfreq(n, NODE_S)

    def amplitudes(density: FloatArray) -> NDArray[np.complex128]:
        """Random amplitudes of a one-sided spectrum per rad/s."""
        draw = rng.standard_normal((2, len(omega)))
        return 0.5 * n * np.sqrt(density * omega[1]) * (draw[0] - 1j * draw[1])

    def velocity(sigma: float, scale: float, *, along: bool) -> NDArray[np.complex128]:
        """Amplitudes of a velocity."""
        x = scale * omega / at.V
        if family == "first-order":
            shape = 2.0 / (1.0 + x**2)
        elif along:
            shape = 2.0 / (1.0 + (KARMAN * x) ** 2) ** (5 / 6)
        else:
            shape = (1.0 + 8 / 3 * (KARMAN * x) ** 2) / (1.0 + (KARMAN * x) ** 2) ** (11 / 6)
        return amplitudes(sigma**2 * scale / (np.pi * at.V) * shape)

    sigma_w = 0.1 * at.w20_kt * KNOT
    sigma_u, scale_u = sigma_w / profile**0.4, at.h / profile**1.2
    u = velocity(sigma_u, scale_u, along=True)
    v = velocity(sigma_u, scale_u, along=False)
    w = velocity(sigma_w, at.h, along=False)
    lag = 4.0 * at.b / (np.pi * at.V)
    roll = 0.8 * (np.pi * at.h / (4.0 * at.b)) ** (1 / 3) * sigma_w**2 / (at.V * at.h)
    p = amplitudes(roll / (1.0 + (lag * omega) ** 2))
    q = -1j * omega / at.V / (1.0 + 1j * lag * omega) * w
    r = 1j * omega / at.V / (1.0 + 0.75j * lag * omega) * v
    return np.fft.irfft(np.array([u, v, w, p, q, r]), n).T


def dryden(family: str, at: Setting) -> FloatArray:
    """(n, 6) Dryden gusts every NODE_S, changed as the family says."""
    rng = np.random.default_rng([at.seed, 5])
    _, _, factor = family.partition("lags-")
    passage = family.removeprefix("passage-")
    nodes = turbulence(
        float(passage) if passage.isdigit() else at.V,
        at.h,
        at.w20_kt,
        at.b * float(factor or 1.0),
        at.seconds * (1.5 if passage.endswith("speed") else 1.0) + 1.0,
        rng,
        is_from_rest=family == "from-rest",
    )
    if family == "no-rates":
        nodes[:, 3:] = 0.0
    elif family == "no-velocities":
        nodes[:, :3] = 0.0
    elif family == "no-q":
        nodes[:, 4] = 0.0
    elif family == "q-reversed":
        nodes[:, 4] *= -1.0
    elif family == "no-r":
        nodes[:, 5] = 0.0
    elif family == "held-20-ms":
        nodes = np.repeat(nodes[::2], 2, axis=0)
    elif family == "roll-1797":
        # sigma_p = 1.9 sigma_w / sqrt(L_w b), L_p = sqrt(L_w b) / 2.6: another first-order roll.
        size = np.sqrt(at.h * at.b)
        keep = np.exp(-2.6 * at.V / size * NODE_S)
        white = 0.19 * at.w20_kt * KNOT / size * np.sqrt(1.0 - keep**2)
        nodes[:, 3] = lfilter([white], [1.0, -keep], rng.standard_normal(len(nodes)))
    elif family == "independent-rates":
        other = turbulence(at.V, at.h, at.w20_kt, at.b, at.seconds + 1.0, rng)
        nodes[:, 3:] = other[:, 3:]
    elif family == "tail-delay":
        rows = np.maximum(np.arange(len(nodes)) - at.tail_m / at.V / NODE_S, 0.0)
        times = np.arange(len(nodes), dtype=float)
        tail_v, tail_w = (np.interp(rows, times, nodes[:, k]) for k in (1, 2))
        nodes[:, 4] = (tail_w - nodes[:, 2]) / at.tail_m
        nodes[:, 5] = (nodes[:, 1] - tail_v) / at.tail_m
    return nodes


def frozen_field(at: Setting, vanes: str) -> Air:
    """Isotropic von Karman turbulence fixed to the earth, a sum of random plane waves.

    The wing meets the mean over its strips and rolls and yaws with their moments, the tail pitches
    and yaws with its difference from the wing. ``vanes``: what they read, the wing's mean, the air
    on a boom ahead, or that at a wing's tip."""
    rng = np.random.default_rng([at.seed, 7])
    scale, sigma = max(at.h, 3.0), 0.1 * at.w20_kt * KNOT
    edges = np.log(2.0 * np.pi / np.array([LONGEST_M, SHORTEST_M]))
    width = (edges[1] - edges[0]) / MODES
    number = np.exp(edges[0] + width * (np.arange(MODES) + rng.random(MODES)))
    shape = KARMAN * scale * number
    energy = shape**4 / (1.0 + shape**2) ** (17.0 / 6.0) * number * width
    # Three components of variance sigma^2 have the energy 1.5 sigma^2.
    size = np.sqrt(1.5 * sigma**2 * energy / energy.sum())
    direction = rng.standard_normal((MODES, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    waves = []
    for _ in range(2):
        raw = rng.standard_normal((MODES, 3))
        raw -= np.sum(raw * direction, axis=1)[:, None] * direction
        waves.append(size[:, None] * raw)
    vector = number[:, None] * direction
    y = at.b * ((np.arange(STRIPS) + 0.5) / STRIPS - 0.5)
    wing = np.column_stack([np.zeros(STRIPS), y, np.zeros(STRIPS)])
    ahead = {"wing": [0.0, 0.0, 0.0], "boom": [0.8, 0.0, 0.0], "tip": [0.2, 0.45 * at.b, 0.0]}
    places = np.vstack([wing, [-at.tail_m, 0.0, 0.0], ahead[vanes]])

    def air(time_s: float, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        axes = to_earth(state[6:9])
        phase = (state[9:12] + places @ axes.T) @ vector.T
        velocity = (np.cos(phase) @ waves[0] + np.sin(phase) @ waves[1]) @ axes
        strips, tail, vane = velocity[:STRIPS], velocity[STRIPS], velocity[STRIPS + 1]
        mean = strips.mean(axis=0)
        p = strips[:, 2] @ y / (y @ y)
        q = (tail[2] - mean[2]) / at.tail_m
        r = (mean[1] - tail[1]) / at.tail_m
        offset = np.zeros(3) if vanes == "wing" else vane - mean
        return np.array([*mean, p, q, r]), offset

    return air


def to_earth(angles: FloatArray) -> FloatArray:
    """(3, 3) body axes to earth axes by phi, theta, psi."""
    (sf, st, sp), (cf, ct, cp) = np.sin(angles), np.cos(angles)
    return np.array(
        [
            [ct * cp, sf * st * cp - cf * sp, cf * st * cp + sf * sp],
            [ct * sp, sf * st * sp + cf * cp, cf * st * sp - sf * cp],
            [-st, sf * ct, cf * ct],
        ]
    )
