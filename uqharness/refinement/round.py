"""A round of a refinement: what it begins from and how it ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from sysid.effects import GUST_ODDS, Effect, Evidence, Gusts, Selection
from sysid.parallel import Processes
from uqharness.refinement.begin import About
from uqharness.refinement.fit import Fit
from uqharness.refinement.types import Setup
from uqharness.simulator import Aircraft


@dataclass(frozen=True)
class Start:
    """What every round begins from: the aircraft, the flights, the fit without effects, the candidates and how they are judged.

    limits: of the parameters; limit: |t| asked of an effect
    gusts: the air, where flights are judged by one-step predictions
    merit: of the flight without effects, as a `Round` has it
    """

    aircraft: Aircraft
    setup: Setup
    before: Fit
    names: tuple[str, ...]
    effects: Sequence[Effect]
    limits: Mapping[str, tuple[float, float]]
    limit: float
    map_: Processes
    merit: float
    gusts: Gusts | None = None

    @property
    def free(self) -> tuple[str, ...]:
        """Columns estimated in any case."""
        return self.before.columns[0].names

    @property
    def coloured(self) -> bool:
        """Whether the candidates' own spread tells how much of a t is chance: in turbulence and in an autopilot's logs."""
        return self.gusts is not None or bool(self.setup.late)

    def odds(self, effect: Effect) -> float:
        """Gain asked of an effect besides: its own odds, and those of what a gust model that is a little off would look like."""
        return effect.odds + (GUST_ODDS if self.gusts is not None and _gust_like(effect) else 0.0)


def like_turning_air(effect: Effect) -> bool:
    """Whether it does what air does that turns as it moves: terms with the rates of the wind angles."""
    term = effect.parsed
    return term is not None and any(v in ("alphadot_hat", "betadot_hat") for v in term.variables)


def _gust_like(effect: Effect) -> bool:
    return like_turning_air(effect) or (effect.subsystem or "").startswith(("sensor.", "actuator.", "mass"))


@dataclass(frozen=True)
class Round:
    """Effects flown with everything estimated.

    evidence   as it would be had the effects not been flown, around the flight with them
    selection  the effects flown, judged there; again: what would be chosen there
    standing   whether that is the same, with the same numbers where JSBSim reads them once
    merit      minus twice the log likelihood, and what the effects must earn: less is better; gusts: the air, estimated with them
    about      where it ended
    held       key -> value flown, of numbers that JSBSim reads once; far: of those whose estimates lie elsewhere
    """

    setup: Setup
    fit: Fit
    evidence: Evidence
    selection: Selection
    again: Selection
    standing: bool
    merit: float
    gusts: Gusts | None
    about: About
    held: Mapping[str, float] = field(default_factory=dict)
    far: Mapping[str, float] = field(default_factory=dict)

    @property
    def keys(self) -> frozenset[str]:
        """Keys of the chosen effects."""
        return frozenset(c.key for c in self.selection.chosen)

    @property
    def free(self) -> tuple[str, ...]:
        """Columns estimated in its flight, those of its effects included."""
        return self.fit.columns[0].names
