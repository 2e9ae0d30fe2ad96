"""What the stages of a refinement hand each other beside the fits."""

from __future__ import annotations

from dataclasses import dataclass

from sysid.effects import Gusts
from uqharness.identification.linearised import Setup


@dataclass(frozen=True)
class Side:
    """Train or test flights: setup, the air or None."""

    setup: Setup
    air: Gusts | None = None


@dataclass(frozen=True)
class Bent:
    """A curve that the forms chosen are not: coefficient and states, name in words, what it gains in twice the log likelihood
    beside all that was chosen, and with what probability chance gives as much; instead: keys of the effects that it can be."""

    coefficient: str
    states: tuple[str, ...]
    name: str
    gain: float
    p: float
    instead: tuple[str, ...]
