"""What a replay's theta holds beside the parameters: sensor biases, delays and the segments' start states."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from uqharness.replay.flights import Flight
from uqharness.replay.replay import CONTROL_DELAY, SENSOR_OF, STATES, UNSEEN
from uqharness.replay.segments import Segment

_FREE_STARTS = (
    "V_mps",
    "alpha_rad",
    "beta_rad",
    "phi_rad",
    "theta_rad",
    "p_radps",
    "q_radps",
    "r_radps",
)
_START_WIDTH = {"V_mps": 6.0, "alpha_rad": 0.2, "beta_rad": 0.2, "phi_rad": 0.3, "theta_rad": 0.2}
_BIAS_WIDTH = {"V_mps": 5.0, "ax_mps2": 2.0, "ay_mps2": 2.0, "az_mps2": 2.0}
_DEFAULT_WIDTH = 0.5
_DELAY_WIDTH = 0.15
SHARES = (0.0, 1.0)
"""Of a jump that accelerometers have not seen: none and all of it. Beyond, a control would move further than it does."""
_REFERENCE = SENSOR_OF["p_radps"]


@dataclass(frozen=True)
class Layout:
    """theta of the replay: parameters first, then biases and start states."""

    names: tuple[str, ...]
    bounds: list[tuple[float, float]]


def nuisance_layout(
    names: Sequence[str],
    limits: Sequence[tuple[float, float]],
    cut: Sequence[Segment],
    biases: Sequence[str],
    outputs: Sequence[str],
    late: Mapping[str, Sequence[str]],
    jumping: Sequence[str] = (),
) -> Layout:
    """Parameters, one bias a flight and channel, the delays ``late`` (flight -> channels), what the accelerometers have not seen of
    the jumps in flights ``jumping``, start states of every segment."""
    extra, bounds = [], list(limits)
    for flight in dict.fromkeys(s.flight for s in cut):
        for channel in biases:
            extra.append(f"bias/{flight}/{channel}")
            width = _BIAS_WIDTH.get(channel, 0.1)
            bounds.append((-width, width))
    for flight, channels in late.items():
        extra += [f"delay/{flight}/{channel}" for channel in channels]
        bounds += [(-_DELAY_WIDTH, _DELAY_WIDTH)] * len(channels)
    extra += [f"{UNSEEN}/{flight}" for flight in jumping]
    bounds += [SHARES] * len(jumping)
    for number, segment in enumerate(cut):
        for state in _FREE_STARTS:
            if state not in outputs:
                continue
            extra.append(f"start/{number}/{state}")
            width = _START_WIDTH.get(state, _DEFAULT_WIDTH)
            if segment.reach is not None:
                # A sensor that is late shows the start a few rows later, when a fast mode has moved on.
                width += float(segment.reach[STATES.index(state)])
            bounds.append((-width, width))
    return Layout((*names, *extra), bounds)


def delayed(
    flights: Sequence[Flight], outputs: Sequence[str], asked: Sequence[str] | None
) -> dict[str, list[str]]:
    """Flight -> what is late, of which delays are estimated: the controls (CONTROL_DELAY) and sensors.

    By default the controls, in every flight: a command is held for a sample, and whatever carried it out began somewhere in
    between; and, of logs, whose channels are stamped when written, every sensor but the gyros, from which delays count.
    """
    out = {}
    for flight in flights:
        logged = bool(flight.record.metadata.native_hz)
        wanted = [SENSOR_OF.get(c, c) for c in outputs if (logged if asked is None else c in asked)]
        if asked is None:
            wanted = [CONTROL_DELAY, *(c for c in wanted if c != _REFERENCE)]
        elif CONTROL_DELAY in asked:
            wanted = [CONTROL_DELAY, *wanted]
        out[flight.name] = list(dict.fromkeys(wanted))
    return out


LATE_ROWS = 0.5
"""A record's commands act from their own row on: controls that act more rows earlier or later than this are misplaced."""
_LEAST_LATE_S = 0.0075  # JSBSim's own flights act half a run early (see replay.py).


def late_limit_s(flight: Flight, dt_s: float) -> float:
    """How late the controls of a flight may act: half a row of commands, ``dt_s`` long; without limit for a log, whose channels are
    stamped when written."""
    return math.inf if flight.record.metadata.native_hz else max(LATE_ROWS * dt_s, _LEAST_LATE_S)


def misplaced(
    flights: Sequence[Flight], cut: Sequence[Segment], nuisance: Mapping[str, tuple[float, float]]
) -> list[str]:
    """A sentence for every flight whose controls, by the estimate in ``nuisance``, act when its record says they do not."""
    said = []
    for flight in flights:
        late, std = nuisance.get(f"delay/{flight.name}/{CONTROL_DELAY}", (0.0, 0.0))
        limit = late_limit_s(flight, next(s.command_s for s in cut if s.flight == flight.name))
        # A delay that the flight does not determine (std NaN) says nothing.
        if abs(late) - 2.0 * std > limit:
            said.append(
                f"{flight.name}: its controls act {1e3 * abs(late):.1f} ms {'late' if late > 0.0 else 'early'}, and "
                f"{1e3 * limit:.1f} ms are allowed: its command columns are shifted; a command belongs to the row whose "
                "acceleration has seen it first"
            )
    return said
