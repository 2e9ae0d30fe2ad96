"""Servo PWM to surface deflection: by the card's tables, with v-tails and elevons taken apart. Pure numerics.

Which output moves what comes from the card's channel, else from the autopilot's SERVOn_FUNCTION, else from the usual
order (1 aileron, 2 elevator, 3 throttle, 4 rudder).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.errors import Finding
from sysid.logs.card import AirframeCard, Mix, Servo, Table

FloatArray = NDArray[np.float64]
# SERVOn_FUNCTION numbers as ArduPilot documents them.
_FUNCTIONS = {4: "aileron", 19: "elevator", 21: "rudder", 70: "throttle"}
_LEFT_RIGHT = {"elevon": (77, 78), "vtail": (79, 80)}
_USUAL = {"aileron": 1, "elevator": 2, "throttle": 3, "rudder": 4}
COLUMNS = {"elevator": "elevator_deg", "aileron": "aileron_deg", "rudder": "rudder_deg", "throttle": "throttle_pct"}


@dataclass(frozen=True)
class Control:
    """How one command column is made: weights times the deflection of servo channels.

    parts  ((channel, servo, weight), ...)
    """

    parts: tuple[tuple[int, Servo, float], ...]
    basis: str

    @property
    def label(self) -> str:
        """For the record's metadata."""
        return " ".join(f"{w:+g}*servo{c}" if w != 1.0 else f"servo{c}" for c, _, w in self.parts) + f" ({self.basis})"


def deflection(pwm: FloatArray, servo: Servo) -> FloatArray:
    """(n,) PWM in us to deflection, end slopes continued to the stops; NaN where the output was off (<= 500)."""
    out = extrapolating_table(pwm, servo.table)
    out = np.clip(out, *servo.limits)
    return np.where(np.isfinite(pwm) & (pwm > 500.0), out, np.nan)


def extrapolating_table(x: FloatArray, table: Table) -> FloatArray:
    """Piecewise linear function through `table`, its first and last slope continued beyond the ends."""
    xs, ys = (np.array(v, dtype=np.float64) for v in zip(*table, strict=True))
    out = np.interp(x, xs, ys)
    first = (ys[1] - ys[0]) / (xs[1] - xs[0])
    last = (ys[-1] - ys[-2]) / (xs[-1] - xs[-2])
    return np.where(x < xs[0], ys[0] + first * (x - xs[0]), np.where(x > xs[-1], ys[-1] + last * (x - xs[-1]), out))


def functions(parameters: Mapping[str, float]) -> dict[int, int]:
    """SERVOn_FUNCTION of a log: channel -> function number, the disabled ones left out."""
    found = {n: parameters.get(f"SERVO{n}_FUNCTION", 0.0) for n in range(1, 33)}
    return {n: int(v) for n, v in found.items() if v}


def controls(card: AirframeCard | None, parameters: Mapping[str, float]) -> tuple[dict[str, Control], list[Finding]]:
    """Column -> how to make it. Without a card only the throttle can be had (from SERVOn_MIN and _MAX); says so."""
    by_channel = functions(parameters)
    channel_of = {name: n for n, f in reversed(by_channel.items()) if (name := _FUNCTIONS.get(f))}
    out: dict[str, Control] = {}
    findings: list[Finding] = []
    if card is not None:
        for mix in card.mixes:
            _mixed(mix, "card", out)
        for kind, (left, right) in _LEFT_RIGHT.items():
            channels = [next((n for n, f in by_channel.items() if f == side), None) for side in (left, right)]
            servo = card.servos.get("elevator")
            if None in channels or servo is None or any(m.kind == kind for m in card.mixes):
                continue
            panels = [Servo(servo.table, servo.limits, channel) for channel in channels]
            _mixed(Mix(kind, panels[0], panels[1]), "SERVOn_FUNCTION", out)
            text = (
                f"outputs {channels[0]} and {channels[1]} are {kind} panels by SERVOn_FUNCTION; the card has no"
                f" [mixing.{kind}], so the elevator's table was used for both, + trailing edge down: check the signs"
            )
            findings.append(Finding("mixing-assumed", f"{kind}", "warning", text, {}))
        for name, servo in card.servos.items():
            if name not in COLUMNS or COLUMNS[name] in out:
                continue
            basis = "card" if servo.channel else "SERVOn_FUNCTION" if name in channel_of else "usual order"
            channel = servo.channel or channel_of.get(name) or _USUAL[name]
            if basis == "usual order" and by_channel:
                # The autopilot says what its outputs do, and none of them does this.
                continue
            out[COLUMNS[name]] = Control(((channel, servo, 1.0),), basis)
    if "throttle_pct" not in out and "throttle" in channel_of:
        n = channel_of["throttle"]
        low, high = parameters.get(f"SERVO{n}_MIN", 1000.0), parameters.get(f"SERVO{n}_MAX", 2000.0)
        if high > low:
            servo = Servo(((low, 0.0), (high, 100.0)), (0.0, 100.0), n)
            out["throttle_pct"] = Control(((n, servo, 1.0),), "SERVOn_MIN and _MAX")
    return out, findings


def _mixed(mix: Mix, basis: str, out: dict[str, Control]) -> None:
    first, second = mix.outputs
    left, right = mix.left.channel or 0, mix.right.channel or 0
    out[COLUMNS[first]] = Control(((left, mix.left, 0.5), (right, mix.right, 0.5)), f"{mix.kind}, {basis}")
    out[COLUMNS[second]] = Control(((left, mix.left, 0.5), (right, mix.right, -0.5)), f"{mix.kind}, {basis}")


def elevator_channel(parameters: Mapping[str, float]) -> int:
    """Servo output that pitches the aircraft, for checks that need its activity and not its angle."""
    for n, function in functions(parameters).items():
        if function in (19, 77, 79):
            return n
    return _USUAL["elevator"]
