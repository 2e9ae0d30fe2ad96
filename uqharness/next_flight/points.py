"""Test points that a next flight could consist of: which control, how far, how long, at which speed and bank."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from uqharness.simulator import Aircraft, InputCard

DOUBLET = ((1, 1.0), (1, -1.0))
THREE_TWO_ONE_ONE = ((3, 1.0), (2, -1.0), (1, 1.0), (1, -1.0))
QUIET_S = 1.0
"""Open loop before the first step: the segment's start state is estimated from it."""
REST_S = 3.0
STEADY_S = 6.0
AMPLITUDES = (0.1, 0.2, 0.35)
"""Of half the control's travel."""
_SURFACES = ("elevator", "aileron", "rudder")


@dataclass(frozen=True)
class Steps:
    """Steps of a control about where it stands: ``pattern`` of (units, sign), ``size`` in the control's unit, from ``start_s``."""

    control: str
    size: float
    unit_s: float
    pattern: tuple[tuple[int, float], ...] = DOUBLET
    start_s: float = 0.0

    @property
    def end_s(self) -> float:
        """When the last step ends [s]."""
        return self.start_s + self.unit_s * sum(units for units, _ in self.pattern)


@dataclass(frozen=True)
class Condition:
    """What a test point begins from: true airspeed and bank of a steady turn (0: straight, + right). None: as the mission flies."""

    speed_mps: float | None = None
    bank_deg: float = 0.0

    @property
    def text(self) -> str:
        """Speed and bank in words."""
        if self.speed_mps is None:
            return "as the mission flies"
        turn = f", {self.bank_deg:+.0f} deg bank" if self.bank_deg else ""
        return f"{self.speed_mps:.3g} m/s{turn}"


@dataclass(frozen=True)
class TestPoint:
    """``kind`` in words, the steps (none: steady flight, controls as they stand), and ``rest_s`` after the last of them."""

    kind: str
    steps: tuple[Steps, ...]
    condition: Condition
    rest_s: float = REST_S

    # pytest takes a class of this name for tests.
    __test__ = False

    @property
    def name(self) -> str:
        """The point in words: kind and condition."""
        return f"{self.kind}, {self.condition.text}"

    @property
    def seconds(self) -> float:
        """From taking the controls over to giving them back."""
        return QUIET_S + max((s.end_s for s in self.steps), default=0.0) + self.rest_s


def half_travel(card: InputCard) -> float:
    """Half the way from stop to stop, in the control's own unit."""
    return 0.5 * (card.limits[1] - card.limits[0])


def library(
    aircraft: Aircraft, conditions: Sequence[Condition], unit_s: Mapping[str, float]
) -> list[TestPoint]:
    """Steady flight, doublets both ways, 3-2-1-1, throttle doublets and all axes in turn, at every condition.

    unit_s: seconds of one unit by control. Amplitudes follow the card's stops; which of them an aircraft bears, a simulation tells.
    """
    kinds = [*_kinds(aircraft, unit_s)]
    return [replace(point, condition=c) for c in conditions for point in kinds]


def _kinds(aircraft: Aircraft, unit_s: Mapping[str, float]) -> Iterator[TestPoint]:
    nowhere = Condition()
    inputs = aircraft.card.inputs
    yield TestPoint("steady", (), nowhere, STEADY_S)
    for control in (c for c in _SURFACES if c in inputs):
        unit, travel, what = unit_s[control], half_travel(inputs[control]), inputs[control].unit
        for share in AMPLITUDES:
            for sign in (1.0, -1.0):
                size = _rounded(sign * share * travel)
                yield TestPoint(
                    f"{control} doublet {size:+g} {what}", (Steps(control, size, unit),), nowhere
                )
    if "elevator" in inputs:
        travel, what = half_travel(inputs["elevator"]), inputs["elevator"].unit
        for share in (-0.1, 0.1):
            size = _rounded(share * travel)
            steps = Steps("elevator", size, 0.7 * unit_s["elevator"], THREE_TWO_ONE_ONE)
            yield TestPoint(f"elevator 3-2-1-1 {size:+g} {what}", (steps,), nowhere)
    if "throttle" in inputs:
        travel, what = half_travel(inputs["throttle"]), inputs["throttle"].unit
        for share in (0.4, -0.4):
            size = _rounded(share * travel)
            steps = Steps("throttle", size, unit_s["throttle"])
            yield TestPoint(f"throttle doublet {size:+g} {what}", (steps,), nowhere, 1.5)
    surfaces = [c for c in _SURFACES if c in inputs]
    if len(surfaces) > 1:
        for share in (0.1, 0.2):
            start, steps_of = 0.0, list[Steps]()
            for control in surfaces:
                size = _rounded(
                    (0.6 if control == "elevator" else 1.0) * share * half_travel(inputs[control])
                )
                steps_of.append(Steps(control, size, unit_s[control], start_s=start))
                # The next axis begins while this one still moves: this separates products of states.
                start += 1.5 * unit_s[control]
            yield TestPoint(
                f"doublets of {', '.join(surfaces)} {share:.0%}", tuple(steps_of), nowhere
            )


def _rounded(size: float) -> float:
    """Two figures: what a pilot or an operator can be told."""
    return float(f"{size:.2g}")
