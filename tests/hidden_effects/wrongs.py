"""Wrong cards: numbers of a servo, a sensor, the thrust map or a clock that differ between the
flights and what refine is given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tests.hidden_effects.effects import SURFACES, Effect
from tests.hidden_effects.motion import AT_ONCE, LAG, RATE, Drive

SAME: Mapping[str, tuple[str, ...]] = {
    "propulsion:thrust_scale": ("CX:CT",),
    # A centre of gravity elsewhere is accelerometers elsewhere and other linear coefficients.
    "sensor.accelerometer:place_x": ("mass:cg_x",),
}
SAME_NUMBER: Mapping[str, tuple[str, float]] = {
    "propulsion:thrust_scale": ("CX:CT", 1.0),
    "sensor.accelerometer:place_x": ("mass:cg_x", -1.0),
}
"""Key -> its other name, and by what its number is to be multiplied there."""
TRUE_LAG, TRUE_RATE = LAG[0], RATE[0]
_BIASES = {"ax_mps2": (0.1, 0.4), "theta_rad": (0.01, 0.03), "phi_rad": (0.01, 0.03)}
_SCALES = {
    "V_mps": (0.03, 0.10),
    "alpha_rad": (0.04, 0.20),
    "beta_rad": (0.04, 0.20),
    "r_radps": (0.02, 0.08),
}
_LATE = {
    "alpha_rad": (0.02, 0.08),
    "beta_rad": (0.02, 0.08),
    "V_mps": (0.1, 0.4),
    "p_radps": (0.008, 0.03),
}


@dataclass(frozen=True)
class Stated:
    """What the aircraft folder says otherwise than the project's.

    Servos by surface (lag 1/s, rate limit deg/s; None: no such line), factor on the thrust map,
    accelerometers' place [m]."""

    lag: Mapping[str, float | None] = field(default_factory=dict)
    rate: Mapping[str, float | None] = field(default_factory=dict)
    thrust: float = 1.0
    accelerometer: tuple[float, float, float] = (0.0, 0.0, 0.0)


PLAIN = Stated()
IDEAL_SERVOS = Stated(dict.fromkeys((*SURFACES, "throttle")), dict.fromkeys(SURFACES))
"""An aircraft folder whose servos act at once."""


@dataclass(frozen=True)
class Wrong:
    """One wrong card.

    key     what a right answer calls it        value   truth in the answer's unit (None: not
    determined by such flights)
    stated  what the folder says                effects what the flights have that the folder has
    not drive   the flights' servos (None: LAG and RATE) trace   the same as an effect of the
    flights, to weigh it (None: a clock's fault is not weighed)"""

    key: str
    value: float | None
    stated: Stated = PLAIN
    effects: tuple[Effect, ...] = ()
    drive: Drive | None = None
    trace: Effect | None = None

    @property
    def accepted(self) -> frozenset[str]:
        return frozenset({self.key, *SAME.get(self.key, ())})


KINDS = (
    *("lag faster",) * 5,
    *("lag slower",) * 5,
    *("rate lower",) * 3,
    *("rate higher",) * 2,
    *("sensor late",) * 4,
    *("controls late",) * 2,
    *("controls early",) * 2,
    *("scale",) * 4,
    *("bias",) * 3,
    *("accelerometer",) * 4,
    *("vane",) * 2,
    *("thrust",) * 4,
)
"""Kinds of the forty wrong cards of a draw; faster, slower, lower, higher: the flights against the
folder.
"""


def wrong(kind: str, rate_hz: float, rng: np.random.Generator) -> Wrong:
    """A wrong card of a kind with numbers drawn by chance."""
    sign = float(rng.choice([-1.0, 1.0]))
    surface = str(rng.choice(SURFACES))
    if kind.startswith(("lag", "rate")):
        return _servo(kind, surface, rng)
    if kind == "sensor late":
        return _sensor("delay", _LATE, 1.0, rng)
    if kind == "scale":
        return _sensor("scale", _SCALES, sign, rng)
    if kind == "bias":
        return _sensor("bias", _BIASES, sign, rng)
    if kind.startswith("controls"):
        rows = int(rng.integers(1, 3)) * (1 if kind == "controls late" else -1)
        return Wrong(
            "record:delay", rows / rate_hz, effects=(Effect("record", "delay", rows / rate_hz),)
        )
    if kind == "accelerometer":
        axis = int(rng.integers(3))
        size = sign * float(rng.uniform(0.08, 0.30))
        effect = Effect("sensor.accelerometer", f"place_{'xyz'[axis]}", size)
        if rng.random() < 0.5:
            return Wrong(effect.key, size, effects=(effect,), trace=effect)
        place = [0.0, 0.0, 0.0]
        place[axis] = -size
        return Wrong(
            effect.key, size, Stated(accelerometer=(place[0], place[1], place[2])), trace=effect
        )
    if kind == "vane":
        effect = Effect("sensor.vane", "place_x", sign * float(rng.uniform(0.3, 0.9)))
        return Wrong(effect.key, effect.size, effects=(effect,), trace=effect)
    if kind == "thrust":
        share = sign * float(rng.uniform(0.06, 0.20))
        return Wrong(
            "propulsion:thrust_scale",
            share,
            Stated(thrust=1.0 / (1.0 + share)),
            trace=Effect("propulsion", "thrust_scale", -share / (1.0 + share)),
        )
    raise ValueError(f"unknown wrong card {kind}; known are {sorted(set(KINDS))}")


def _sensor(
    term: str, ranges: Mapping[str, tuple[float, float]], sign: float, rng: np.random.Generator
) -> Wrong:
    channel = str(rng.choice(list(ranges)))
    effect = Effect(f"sensor.{channel}", term, sign * float(rng.uniform(*ranges[channel])))
    return Wrong(effect.key, effect.size, effects=(effect,), trace=effect)


def _servo(kind: str, surface: str, rng: np.random.Generator) -> Wrong:
    """A servo whose lag or rate limit the folder has wrong, either way; half of the lags are wrong
    in the folder alone.
    """
    subject = f"actuator.{surface}"
    if kind == "lag slower" and rng.random() < 0.5:
        lag = float(rng.uniform(8.0, 18.0))
        effect = Effect(subject, "lag", lag)
        return Wrong(effect.key, lag, effects=(effect,), trace=effect)
    if kind == "lag slower":
        stated = float(rng.uniform(45.0, 120.0))
        return Wrong(
            f"{subject}:lag",
            TRUE_LAG,
            Stated(lag={surface: stated}),
            trace=Effect(subject, "lag", stated),
        )
    if kind == "lag faster" and rng.random() < 0.5:
        stated = float(rng.uniform(8.0, 17.0))
        return Wrong(
            f"{subject}:lag",
            TRUE_LAG,
            Stated(lag={surface: stated}),
            trace=Effect(subject, "lag", stated),
        )
    if kind == "lag faster":
        lag = float(rng.uniform(45.0, 120.0)) if rng.random() < 0.6 else AT_ONCE
        lags = tuple(lag if s == surface else LAG[0] for s in SURFACES)
        # A servo that acts at once has no lag that could be estimated.
        return Wrong(
            f"{subject}:lag",
            lag if lag < AT_ONCE else None,
            drive=Drive((*lags, LAG[3]), RATE),
            trace=Effect(subject, "lag", TRUE_LAG),
        )
    if kind == "rate lower":
        limit = float(rng.uniform(30.0, 70.0))
        effect = Effect(subject, "rate_limit", limit)
        return Wrong(effect.key, limit, effects=(effect,), trace=effect)
    # The hand asks for 120 deg/s at most: the true limit of 240 is never felt.
    stated = float(rng.uniform(30.0, 60.0))
    return Wrong(
        f"{subject}:rate_limit",
        None,
        Stated(rate={surface: stated}),
        trace=Effect(subject, "rate_limit", stated),
    )


def together(stated: Stated, more: Stated) -> Stated:
    """One folder that says both; the second holds where both speak of the same servo."""
    return replace(
        more,
        lag={**stated.lag, **more.lag},
        rate={**stated.rate, **more.rate},
        thrust=stated.thrust * more.thrust,
    )


def names(wrongs: Sequence[Wrong]) -> str:
    """Keys as the table has them."""
    return " + ".join(w.key for w in wrongs)
