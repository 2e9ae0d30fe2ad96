"""Flight cards: which manoeuvre when, how large; and the pilot between them, all of whose doing is
in the recorded commands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from tests.hidden_effects.motion import STOPS, Air

CONTROLS = ("elevator", "aileron", "rudder", "throttle")


@dataclass(frozen=True)
class Pulse:
    """A doublet or 3-2-1-1: ``size`` in deg or percent, ``unit_s`` one part's length, ``after_s``
    from the manoeuvre's start.
    """

    control: str
    shape: str
    size: float
    unit_s: float
    after_s: float = 0.8

    def at(self, t: FloatArray) -> FloatArray:
        """Increment at times t (n,) from the manoeuvre's start."""
        parts, signs = (
            ((1, 1), (1, -1)) if self.shape == "doublet" else ((3, 2, 1, 1), (1, -1, 1, -1))
        )
        if self.shape == "step":
            parts, signs = (6,), (1,)
        edges = self.after_s + self.unit_s * np.concatenate([[0.0], np.cumsum(parts)])
        out = np.zeros_like(t)
        for sign, a, b in zip(signs, edges, edges[1:], strict=False):
            out[(t >= a - 1e-9) & (t < b - 1e-9)] = sign * self.size
        return out


@dataclass(frozen=True)
class Manoeuvre:
    """A labelled stretch. Hands off (the pilot's corrections frozen) unless ``bank_deg`` asks for a
    steady turn.
    """

    label: str
    at_s: float
    length_s: float
    pulses: tuple[Pulse, ...] = ()
    bank_deg: float = 0.0
    hands_off: bool = True


@dataclass(frozen=True)
class Card:
    """One flight: airspeed and height above the start's sea level [m/s, m], sample rate, air and
    noise.

    ``w20_kt`` wind at 20 ft of the turbulence, 0 calm; ``noise`` factor on Table 2.1; ``positions``
    records the surfaces."""

    V_mps: float
    manoeuvres: tuple[Manoeuvre, ...]
    seed: int
    seconds: float = 90.0
    rate_hz: float = 50.0
    h_m: float = 100.0
    w20_kt: float = 0.0
    noise: float = 1.0
    positions: bool = False


SLEW_DEG_PER_S = 120.0
KINDS = (
    "elevator doublet",
    "aileron doublet",
    "rudder doublet",
    "elevator 3-2-1-1",
    "aileron 3-2-1-1",
    "rudder 3-2-1-1",
    "throttle",
    "roll and pitch",
    "loiter",
    "roll and yaw",
)
"""Kinds of manoeuvre in the order in which a flight takes them (from a start of its own)."""


def card(
    seed: int,
    V_mps: float,
    *,
    seconds: float = 90.0,
    strength: float = 1.0,
    kinds: Sequence[str] = KINDS,
    first: int = 0,
    hands_off: bool = True,
    **remainder: float | bool,
) -> Card:
    """A flight of manoeuvres one after another, sizes, signs and lengths of parts drawn from the
    seed.

    ``hands_off`` False: the pilot corrects throughout (near the ground). ``strength`` scales every
    amplitude; deflections shrink with dynamic pressure so that speeds are alike in response."""
    rng = np.random.default_rng(seed)
    quick = 22.0 / V_mps
    result: list[Manoeuvre] = []
    at, number = 2.0, first
    while True:
        kind = kinds[number % len(kinds)]
        sign = float(rng.choice([-1.0, 1.0]))
        vary = strength * float(rng.uniform(0.75, 1.25)) * quick
        unit = float(rng.uniform(0.85, 1.2)) * quick
        length, bank, pulses = 7.0, 0.0, ()
        if kind == "elevator doublet":
            pulses = (Pulse("elevator", "doublet", sign * 6.0 * vary, 0.55 * unit),)
        elif kind == "aileron doublet":
            pulses = (Pulse("aileron", "doublet", sign * 8.0 * vary, 0.6 * unit),)
        elif kind == "rudder doublet":
            pulses = (Pulse("rudder", "doublet", sign * 7.0 * vary, 0.8 * unit),)
        elif kind == "elevator 3-2-1-1":
            pulses = (Pulse("elevator", "3211", sign * 4.5 * vary, 0.4 * unit),)
        elif kind == "aileron 3-2-1-1":
            pulses = (Pulse("aileron", "3211", sign * 6.0 * vary, 0.35 * unit),)
        elif kind == "rudder 3-2-1-1":
            pulses = (Pulse("rudder", "3211", sign * 6.0 * vary, 0.45 * unit),)
        elif kind == "throttle":
            size = sign * min(30.0 * strength * float(rng.uniform(0.75, 1.25)), 35.0)
            pulses = (Pulse("throttle", "doublet", size, 2.2),)
            pulses += (Pulse("elevator", "doublet", -sign * 4.0 * vary, 0.45 * unit, 2.0),)
        elif kind == "roll and pitch":
            pulses = (
                Pulse("aileron", "doublet", sign * 8.0 * vary, 0.6 * unit),
                Pulse("elevator", "3211", -sign * 4.0 * vary, 0.35 * unit, 0.9),
            )
        elif kind == "roll and yaw":
            pulses = (
                Pulse("aileron", "doublet", sign * 7.0 * vary, 0.5 * unit),
                Pulse("rudder", "doublet", -sign * 6.0 * vary, 0.7 * unit, 2.4),
                Pulse("elevator", "doublet", 4.0 * vary, 0.45 * unit, 4.2),
            )
        elif kind == "loiter":
            length, bank = 9.0, sign * 25.0
        elif kind == "pull":  # towards the stall: power off, nose up, doublets there
            pulses = (
                Pulse("throttle", "step", -18.0, 0.8, 0.3),
                Pulse("elevator", "step", -1.5 * vary, 0.4 * unit, 1.0),
                Pulse("elevator", "doublet", -2.2 * vary, 0.4 * unit, 1.4 + 0.8 * unit),
            )
        else:
            raise ValueError(f"unknown manoeuvre {kind}; known are {KINDS} and pull")
        if at + length + 1.0 > seconds:
            break
        result.append(
            Manoeuvre(kind, at, length, pulses, bank, hands_off=hands_off and kind != "loiter")
        )
        at += length + (2.0 if kind == "loiter" else 3.0)
        number += 1
    return Card(V_mps, tuple(result), seed, seconds, **remainder)  # type: ignore[arg-type]


def slewed(expected: FloatArray, maximum: float) -> FloatArray:
    """(n, ...) commands that follow ``wanted`` by at most ``most`` a sample: a hand needs time;
    servos stay off their limit.
    """
    out = expected.copy()
    for k in range(1, len(out)):
        out[k] = out[k - 1] + np.clip(expected[k] - out[k - 1], -maximum, maximum)
    return out


class Pilot:
    """Commands of B flights: trim, the manoeuvres' increments, and gentle corrections from noisy
    instruments between them.

    Corrections: elevator on pitch attitude and height, aileron on bank, throttle on airspeed;
    smoothed over half a second, frozen hands-off. ``noise`` (n, 4, B) of V, phi, theta, h is what
    the pilot's instruments add."""

    def __init__(
        self, cards: Sequence[Card], trim_x: FloatArray, trim_s: FloatArray, noise: FloatArray
    ) -> None:
        dt = 1.0 / cards[0].rate_hz
        n = round(cards[0].seconds / dt)
        t = np.arange(n) * dt
        B = len(cards)
        self.increments, self.bank, self.frozen = (
            np.zeros((n, 4, B)),
            np.zeros((n, B)),
            np.zeros((n, B), dtype=bool),
        )
        for lane, flight in enumerate(cards):
            for m in flight.manoeuvres:
                inside = (t >= m.at_s - 1e-9) & (t < m.at_s + m.length_s - 1e-9)
                for pulse in m.pulses:
                    self.increments[:, CONTROLS.index(pulse.control), lane] += (
                        pulse.at(t - m.at_s) * inside
                    )
                # The turn is entered before its label begins, so that the labelled stretch is a
                # turn.
                turning = (t >= m.at_s - 1.0) & (t < m.at_s + m.length_s)
                self.bank[turning, lane] += np.radians(m.bank_deg)
                self.frozen[inside & m.hands_off, lane] = True
        self.increments[:, :3] = slewed(self.increments[:, :3], SLEW_DEG_PER_S * dt)
        self.V, self.theta, self.h = np.array([c.V_mps for c in cards]), trim_x[7], -trim_x[11]
        self.trim, self.noise = trim_s, noise
        self.share = 1.0 - np.exp(-dt / 0.4)
        self.correction = np.zeros((4, B))
        self._low, self._high = (np.array(side)[:, None] for side in zip(*STOPS, strict=True))

    def __call__(self, k: int, air: Air, x: FloatArray) -> FloatArray:
        V, phi, theta, h = (
            air.V + self.noise[k, 0],
            x[6] + self.noise[k, 1],
            x[7] + self.noise[k, 2],
            -x[11] + self.noise[k, 3],
        )
        climb = np.clip(np.where(self.h < 20.0, 0.05, 0.01) * (self.h - h), -0.12, 0.12)
        turn = 0.10 * np.abs(np.sin(self.bank[k]))
        expected = np.zeros_like(self.correction)
        expected[0] = 9.0 * (theta - self.theta - climb) - 20.0 * turn + 1.5 * x[4]
        expected[1] = -6.0 * (phi - self.bank[k]) - 0.8 * x[3]
        expected[3] = -4.0 * (V - self.V) + 40.0 * climb
        moved = self.correction + self.share * (expected - self.correction)
        self.correction = np.where(self.frozen[k], self.correction, moved)
        out = self.trim + self.correction + self.increments[k]
        # A servo knows hundredths of a degree.
        return np.asarray(np.clip(np.round(out, 2), self._low, self._high))
