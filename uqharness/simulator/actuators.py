"""Surface positions from logged commands: the aircraft's own actuators, as JSBSim 1.3.3 steps them.

A log has commands, held from one sample to the next, while the aerodynamics see positions. Five
milliseconds here are four per cent of every moment coefficient, so the actuators are stepped at the
aircraft's own step and order: lag by Tustin's rule, then the rate limit, then the stops
(FGActuator.cpp)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from sysid.linalg import first_order
from uqharness.errors import BadInputError
from uqharness.simulator.aircraft import Aircraft, open_aircraft, parse_xml

SHORTEST_S = 1e-3
"""Time constant below which a servo acts at once."""


FREE_LAG = 1e15
"""Lag [1/s] with which a servo acts at once, to what a replay can tell."""


@dataclass(frozen=True)
class Actuator:
    """First-order lag [1/s] (None: none), rate limit [unit/s] and stops."""

    lag: float | None
    rate: float = math.inf
    low: float = -math.inf
    high: float = math.inf

    def lag_with(self, more_s: float) -> float:
        """Lag [1/s] where its time constant is so much longer, or for a negative one shorter: at
        least SHORTEST_S.
        """
        return 1.0 / max((1.0 / self.lag if self.lag else 0.0) + more_s, SHORTEST_S)

    def slowed_to(self, more_s_per_unit: float) -> float:
        """Rate limit [unit/s] where each unit of travel takes so much longer."""
        return 1.0 / max(more_s_per_unit + 1.0 / self.rate, 1e-9)

    def follow(self, commands: FloatArray, dt_s: float, step_s: float) -> FloatArray:
        """(n,) positions at rows ``dt_s`` apart, each having seen its row's command for one step of
        ``step_s``; starts at rest.
        """
        return self.follow_finely(commands, dt_s, step_s)[0]

    def follow_finely(
        self, commands: FloatArray, dt_s: float, step_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """(n,) positions at rows as `follow` has them, and (n-1,) half-way between, in straight
        lines from step to step.
        """
        steps_per_row = max(1, round(dt_s / step_s))
        # A row's command is there from the run on that arrives at the row.
        fine_commands = np.repeat(commands, steps_per_row)[
            : (len(commands) - 1) * steps_per_row + 1
        ].astype(float)
        positions = fine_commands
        if self.lag is not None:
            half = step_s * self.lag
            gain, keep = half / (2.0 + half), (2.0 - half) / (2.0 + half)
            positions = first_order(
                gain * (fine_commands + np.concatenate([fine_commands[:1], fine_commands[:-1]])),
                keep,
                fine_commands[0],
            )
        positions = _limit_rate(positions, self.rate * step_s)
        # The lag remembers its own output, the rate limit what it let through.
        np.clip(positions, self.low, self.high, out=positions)
        early, late = (
            steps_per_row // 2,
            -(-steps_per_row // 2),
        )  # the steps on either side of the middle, one and the same if runs is even
        return positions[::steps_per_row], 0.5 * (
            positions[early : len(positions) - late : steps_per_row]
            + positions[late : len(positions) - early : steps_per_row]
        )


def servo_number(servo: Actuator, term: str, value: float) -> float:
    """The number of an actuator whose lag is ``value`` [s] longer than the servo's, or whose rate
    limit takes ``value`` [s/unit] longer; term: lag or rate_limit."""
    if term == "rate_limit":
        return servo.slowed_to(value)
    return FREE_LAG if servo.lag is None and value == 0.0 else servo.lag_with(value)


def _limit_rate(requested: FloatArray, max_step: float) -> FloatArray:
    """(n,) positions that follow what is asked, by ``max_step`` from one to the next at most; the
    first is what is asked.
    """
    positions = requested.copy()
    limit_starts = np.flatnonzero(np.abs(np.diff(requested)) > max_step) + 1
    targets, caught_up = requested.tolist() if len(limit_starts) else [], 0
    for first in limit_starts.tolist():
        if first < caught_up:
            continue
        position, k = float(positions[first - 1]), first
        while k < len(targets):
            position = min(max(targets[k], position - max_step), position + max_step)
            positions[k] = position
            k += 1
            if position == targets[k - 1]:
                break
        caught_up = k
    return positions


def actuators(aircraft: Aircraft, controls: Sequence[str]) -> dict[str, Actuator]:
    """The actuator behind each control's position, from the XML.

    Raises BadInputError for a control without one.
    """
    control_by_property = {
        aircraft.card.inputs[c].position: c for c in controls if c in aircraft.card.inputs
    }
    fdm = open_aircraft(aircraft)
    result: dict[str, Actuator] = {}
    for path in sorted(aircraft.folder.rglob("*.xml")):
        for element in parse_xml(path).getroot().iter("actuator"):
            control = control_by_property.get(element.get("name"))
            if control is None:
                continue

            def number(tag: str, default: float, element=element) -> float:  # type: ignore[no-untyped-def]
                text = (element.findtext(tag) or "").strip()
                if not text:
                    return default
                try:
                    return float(text)
                except ValueError:
                    return float(fdm[text])

            lag = number("lag", math.nan)
            result[control] = Actuator(
                None if math.isnan(lag) else lag,
                number("rate_limit", math.inf),
                number("clipto/min", -math.inf),
                number("clipto/max", math.inf),
            )
    missing = [c for c in controls if c not in result]
    if missing:
        raise BadInputError(
            f"aircraft '{aircraft.name}': no <actuator> has the name of [inputs.{missing[0]}]"
            " position"
        )
    return result
