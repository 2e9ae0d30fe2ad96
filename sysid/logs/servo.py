"""Servo PWM to surface deflection: by the card's tables, with v-tails and elevons taken apart. Pure numerics.

Channel, neutral and sense come from the autopilot's parameters (`sysid.logs.servo_parameters`) where the log has them, else
from the card, else channels from the usual order (1 aileron, 2 elevator, 3 throttle, 4 rudder). Degrees come from the card.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from sysid.errors import Finding
from sysid.logs.card import AirframeCard, Mix, Servo, Table
from sysid.logs.servo_parameters import USUAL, Output, functions, outputs

_LEFT_RIGHT = {"elevon": (77, 78), "vtail": (79, 80)}
COLUMNS = {
    "elevator": "elevator_deg",
    "aileron": "aileron_deg",
    "rudder": "rudder_deg",
    "throttle": "throttle_pct",
}


@dataclass(frozen=True)
class Control:
    """How one command column is made: weights times the deflection of servo channels.

    parts    ((channel, servo, weight), ...)       basis  where the channel is from, in a word or two
    told     channel, table and where each is from, in a sentence       against  what the card says otherwise
    """

    parts: tuple[tuple[int, Servo, float], ...]
    basis: str
    told: str = ""
    against: str = ""

    @property
    def label(self) -> str:
        """For the record's metadata."""
        return (
            " ".join(f"{w:+g}*servo{c}" if w != 1.0 else f"servo{c}" for c, _, w in self.parts)
            + f" ({self.basis})"
        )


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
    return np.where(
        x < xs[0],
        ys[0] + first * (x - xs[0]),
        np.where(x > xs[-1], ys[-1] + last * (x - xs[-1]), out),
    )


def controls(
    card: AirframeCard | None, parameters: Mapping[str, float]
) -> tuple[dict[str, Control], list[Finding]]:
    """Column -> how to make it; what the log's own parameters say counts before the card.

    Degrees are the card's: no parameter has them. Without a card only the throttle can be had.
    """
    described, by_channel = outputs(parameters), functions(parameters)
    out: dict[str, Control] = {}
    findings: list[Finding] = []
    if card is not None:
        for mix in card.mixes:
            _mixed(mix, "card", out)
        findings += _assumed_mixes(card, by_channel, out)
        for name in COLUMNS:
            if COLUMNS[name] in out or (name not in card.servos and name not in card.throws):
                continue
            control = (
                _described(card, name, described[name])
                if name in described
                else _by_card(card, name, bool(by_channel))
            )
            if control is not None:
                out[COLUMNS[name]] = control
    if "throttle_pct" not in out and "throttle" in described:
        output = described["throttle"][0]
        low, high = _known(output.low, 1000.0), _known(output.high, 2000.0)
        if high > low:
            servo = Servo(((low, 0.0), (high, 100.0)), (0.0, 100.0), output.channel)
            out["throttle_pct"] = Control(
                ((output.channel, servo, 1.0),), "MIN and MAX of the log's parameters"
            )
    return out, findings


def _known(value: float, otherwise: float) -> float:
    return otherwise if math.isnan(value) else value


def _assumed_mixes(
    card: AirframeCard, by_channel: Mapping[int, int], out: dict[str, Control]
) -> list[Finding]:
    findings = []
    for kind, (left, right) in _LEFT_RIGHT.items():
        channels = [
            next((n for n, f in by_channel.items() if f == side), None) for side in (left, right)
        ]
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
    return findings


def _by_card(card: AirframeCard, name: str, has_functions: bool) -> Control | None:
    """A log without parameters: the card's table on the card's channel, or on the usual one."""
    servo = card.servos.get(name)
    if servo is None or (has_functions and not servo.channel):
        return None  # the autopilot says what its outputs do, and none of them does this
    channel = servo.channel or USUAL[name]
    basis = "card" if servo.channel else "usual order"
    return Control(
        ((channel, servo, 1.0),),
        basis,
        f"{_as_words(name, channel, servo)} by the card's servo_pwm",
    )


def _described(card: AirframeCard, name: str, members: tuple[Output, ...]) -> Control | None:
    """A surface whose outputs the log's parameters describe."""
    parts, told, against = [], [], []
    for output in members:
        made = _table(card, name, output)
        if made is None:
            return None
        servo, degrees = made
        parts.append((output.channel, servo, 1.0 / len(members)))
        told.append(f"{_as_words(name, output.channel, servo)} by {output.source}, {degrees}")
        against += _conflicts(card.servos.get(name), servo, output)
    return Control(
        tuple(parts), members[0].source.split(",")[0], "; ".join(told), "; ".join(against)
    )


def _table(card: AirframeCard, name: str, output: Output) -> tuple[Servo, str] | None:
    """PWM to deflection, and where the degrees are from.

    The card's own table keeps its slope, since an autopilot's MIN and MAX may leave some of the throw unused.
    """
    own, throw = card.servos.get(name), card.throws.get(name)
    limits = own.limits if own is not None else (-math.inf, math.inf)
    if name == "throttle":
        low, high = _known(output.low, 1000.0), _known(output.high, 2000.0)
        if own is not None and not output.low < output.high:
            return own, "the card's servo_pwm"
        ends = (0.0, 100.0) if output.sense >= 0.0 else (100.0, 0.0)
        return Servo(((low, ends[0]), (high, ends[1])), (0.0, 100.0), output.channel), "0 and 100 %"
    sense = output.sense or (
        1.0 if own is None else math.copysign(1.0, own.table[-1][1] - own.table[0][1])
    )
    if throw is not None and output.spans and (throw.key == "throw_deg" or own is None):
        ends = (throw.low, throw.high) if sense > 0.0 else (throw.high, throw.low)
        table: Table = ((output.low, ends[0]), (output.neutral, 0.0), (output.high, ends[1]))
        return Servo(
            table, limits, output.channel
        ), f"degrees assumed: the card's {throw.key} at the ends of travel"
    if own is None:
        return None
    neutral = _neutral(own)
    shift = _known(output.neutral, neutral) - neutral
    turn = 1.0 if sense * (own.table[-1][1] - own.table[0][1]) > 0.0 else -1.0
    if turn < 0.0:  # the other way round about the neutral
        table = tuple((2.0 * neutral - pwm + shift, angle) for pwm, angle in reversed(own.table))
    else:
        table = tuple((pwm + shift, angle) for pwm, angle in own.table)
    return Servo(table, own.limits, output.channel), "degrees a us by the card's servo_pwm"


def _neutral(servo: Servo) -> float:
    """PWM of no deflection."""
    rows = sorted(servo.table, key=lambda row: row[1])
    return float(np.interp(0.0, [angle for _, angle in rows], [pwm for pwm, _ in rows]))


_SAME_US = 5.0


def _conflicts(own: Servo | None, used: Servo, output: Output) -> list[str]:
    """What the card says otherwise than the log, in words."""
    if own is None:
        return []
    found = []
    if own.channel not in (None, output.channel):
        found.append(f"the card says channel {own.channel}, the log {output.channel}")
    if (own.table[-1][1] - own.table[0][1]) * (used.table[-1][1] - used.table[0][1]) < 0.0:
        found.append(f"servo {output.channel} turns the other way in the card")
    if (
        abs(_neutral(own) - _neutral(used)) > _SAME_US
        and used.table[0][1] * used.table[-1][1] < 0.0
    ):
        found.append(
            f"the neutral of servo {output.channel} is {_neutral(used):g} us in the log, {_neutral(own):g} us in the card"
        )
    return found


def _as_words(name: str, channel: int, servo: Servo) -> str:
    pwm = "/".join(f"{p:g}" for p, _ in servo.table)
    angles = "/".join(f"{a:g}" for _, a in servo.table)
    return f"{name} is servo {channel}, {pwm} us = {angles} {'%' if name == 'throttle' else 'deg'}"


def _mixed(mix: Mix, basis: str, out: dict[str, Control]) -> None:
    first, second = mix.outputs
    left, right = mix.left.channel or 0, mix.right.channel or 0
    out[COLUMNS[first]] = Control(
        ((left, mix.left, 0.5), (right, mix.right, 0.5)), f"{mix.kind}, {basis}"
    )
    out[COLUMNS[second]] = Control(
        ((left, mix.left, 0.5), (right, mix.right, -0.5)), f"{mix.kind}, {basis}"
    )


def elevator_channel(parameters: Mapping[str, float]) -> int:
    """Servo output that pitches the aircraft, for checks that need its activity and not its angle."""
    for n, function in functions(parameters).items():
        if function in (19, 77, 79):
            return n
    return USUAL["elevator"]
