"""Surface positions from logged commands by the aircraft's own actuators.

A log holds commands, constant between samples, while the aerodynamics depend on positions. A delay
of 5 ms changes moment coefficients by 4 %. Actuators are therefore stepped at the aircraft's own
step and in JSBSim's order (FGActuator.cpp, version 1.3.3): lag by Tustin's rule, rate limit, then
stops.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from sysid.linalg import first_order
from uqharness.errors import BadInputError
from uqharness.simulator import engine
from uqharness.simulator.aircraft import Aircraft, open_aircraft, parse_xml, position_factor
from uqharness.simulator.staging import model_files

SHORTEST_S = 1e-3
"""Time constant [s] below which a servo has no lag."""


FREE_LAG = 1e15
"""Lag [1/s] of a servo that follows without delay, as far as a replay resolves."""


@dataclass(frozen=True)
class Actuator:
    """A first-order servo with rate limit and stops.

    Attributes
    ----------
    lag : float or None
        Inverse time constant [1/s]; None without a lag.
    rate : float
        Rate limit [unit/s].
    low, high : float
        Stops [unit].
    """

    lag: float | None
    rate: float = math.inf
    low: float = -math.inf
    high: float = math.inf

    def lag_with(self, more_s: float) -> float:
        """Return the lag [1/s] of a time constant longer by ``more_s``, at least SHORTEST_S."""
        return 1.0 / max((1.0 / self.lag if self.lag else 0.0) + more_s, SHORTEST_S)

    def slowed_to(self, more_s_per_unit: float) -> float:
        """Return the rate limit [unit/s] if each unit takes ``more_s_per_unit`` [s] longer."""
        return 1.0 / max(more_s_per_unit + 1.0 / self.rate, 1e-9)

    def follow(self, commands: FloatArray, dt_s: float, step_s: float) -> FloatArray:
        """Return positions (n,) for commands (n,).

        Parameters
        ----------
        commands : ndarray
            Commands (n,) in the unit of the stops.
        dt_s : float
            Time between rows [s].
        step_s : float
            Integration step [s]. A row's command acts from the step that arrives at the row; the
            servo starts at rest.
        """
        return self.follow_with_midpoints(commands, dt_s, step_s)[0]

    def follow_with_midpoints(
        self, commands: FloatArray, dt_s: float, step_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return positions (n,) at the rows, and (n-1,) half-way between rows, linearly
        interpolated.
        """
        steps_per_row = max(1, round(dt_s / step_s))
        # The command of a row acts in the step that ends at the row.
        fine_commands = np.repeat(commands, steps_per_row)[
            : (len(commands) - 1) * steps_per_row + 1
        ].astype(float)
        positions = fine_commands
        if self.lag is not None:
            half = step_s * self.lag
            # Tustin: y' = keep y + gain (u + u').
            gain, keep = half / (2.0 + half), (2.0 - half) / (2.0 + half)
            positions = first_order(
                gain * (fine_commands + np.concatenate([fine_commands[:1], fine_commands[:-1]])),
                keep,
                fine_commands[0],
            )
        positions = _limit_rate(positions, self.rate * step_s)
        # JSBSim's lag keeps its unlimited output; the rate limit keeps its limited one.
        np.clip(positions, self.low, self.high, out=positions)
        early, late = (
            steps_per_row // 2,
            -(-steps_per_row // 2),
        )  # the steps on either side of the middle, one and the same if runs is even
        return positions[::steps_per_row], 0.5 * (
            positions[early : len(positions) - late : steps_per_row]
            + positions[late : len(positions) - early : steps_per_row]
        )


def servo_number(servo: Actuator, term: str, value: float, unit_deg: float = 1.0) -> float:
    """Return the parameter of an actuator that is slower by ``value``.

    ``term`` is ``lag`` (``value`` [s] of time constant) or ``rate_limit`` (``value`` [s/deg]);
    ``unit_deg`` are the degrees per unit of the actuator's output.
    """
    if term == "rate_limit":
        return servo.slowed_to(value) / unit_deg
    return FREE_LAG if servo.lag is None and value == 0.0 else servo.lag_with(value)


def _limit_rate(requested: FloatArray, max_step: float) -> FloatArray:
    """Return positions (n,) that follow the request by at most ``max_step`` per step."""
    positions = requested.copy()
    # Only where a step is too long does the loop in Python run.
    limit_starts = np.flatnonzero(np.abs(np.diff(requested)) > max_step) + 1
    targets, caught_up = requested.tolist() if len(limit_starts) else [], 0
    for first in limit_starts.tolist():
        # Still catching up from an earlier step.
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
    """Return the actuator of each control's position property, from the XML, in the record's unit.

    Raises
    ------
    BadInputError
        If a control has no actuator.
    """
    result = all_actuators(aircraft)
    missing = [c for c in controls if c not in result]
    if missing:
        raise BadInputError(
            f"aircraft '{aircraft.name}': no <actuator> has the name of [inputs.{missing[0]}]"
            " position"
        )
    return {c: result[c] for c in controls}


def all_actuators(aircraft: Aircraft) -> dict[str, Actuator]:
    """Return the actuators that have the name of a control's position, by control.

    JSBSim is opened only if one of their numbers is a property's name. Raises BadInputError if that
    fails.
    """
    control_by_property = {
        c.position: name for name, c in aircraft.card.inputs.items() if c.position
    }
    simulator = cache(lambda: open_aircraft(aircraft))

    def number(element: Any, tag: str, default: float) -> float:
        """Return the number of an element; it may be given by a property's name."""
        text = (element.findtext(tag) or "").strip()
        if not text:
            return default
        try:
            return float(text)
        except ValueError:
            engine.require(simulator(), [text])
            return float(simulator()[text])

    result: dict[str, Actuator] = {}
    for name in sorted(model_files(aircraft).local):
        for element in parse_xml(aircraft.folder / name).getroot().iter("actuator"):
            control = control_by_property.get(element.get("name", ""))
            if control is None:
                continue
            lag = number(element, "lag", math.nan)
            factor = position_factor(aircraft.card.inputs[control])
            stops = (
                number(element, "clipto/min", -math.inf),
                number(element, "clipto/max", math.inf),
            )
            low, high = sorted(factor * stop for stop in stops)
            rate = abs(factor) * number(element, "rate_limit", math.inf)
            result[control] = Actuator(None if math.isnan(lag) else lag, rate, low, high)
    return result
