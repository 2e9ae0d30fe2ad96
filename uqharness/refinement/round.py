"""A round of a refinement: what it begins from and how it ends.

Everything is moved to its estimate on the linearised flight together with the effects. An effect that the parameters have made up
for so far cannot be put in by itself: with a centre of gravity elsewhere and Cm_alpha as it was, the replay is worse than without,
and no step leads down from there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from sysid.effects import DIFFERENT, GUST_ODDS, STANDS, Effect, Evidence, Gusts, Selection
from sysid.parallel import Processes
from uqharness.identification.linearised import Fit, Point, Setup, moved_starts, stepped
from uqharness.simulator import Aircraft


@dataclass(frozen=True)
class Start:
    """What every round begins from: the aircraft, the flights, the fit without effects, the candidates and how they are judged.

    effects: the candidates by key; limits: of the parameters; limit: |t| asked of an effect
    gusts: the air, where flights are judged by one-step predictions
    merit: of the flight without effects, as a `Round` has it
    """

    aircraft: Aircraft
    setup: Setup
    before: Fit
    names: tuple[str, ...]
    effects: Mapping[str, Effect]
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
        if self.gusts is None:
            return effect.odds
        gust_like = like_turning_air(effect) or (effect.subsystem or "").startswith(
            ("sensor.", "actuator.", "mass")
        )
        return effect.odds + GUST_ODDS * gust_like


def like_turning_air(effect: Effect) -> bool:
    """Whether it does what air does that turns as it moves: terms with the rates of the wind angles."""
    term = effect.parsed
    return term is not None and any(v in ("alphadot_hat", "betadot_hat") for v in term.variables)


@dataclass(frozen=True)
class Round:
    """Effects flown with everything estimated; the first round has none.

    evidence   as it would be had the effects not been flown, around the flight with them
    selection  the effects flown, judged there; again: what would be chosen there
    merit      minus twice the log likelihood, and what the effects must earn: less is better; gusts: the air, estimated with them
    flown      key -> value flown; held: those of numbers that JSBSim reads once
    """

    setup: Setup
    fit: Fit
    evidence: Evidence
    selection: Selection
    again: Selection
    merit: float
    gusts: Gusts | None
    flown: Mapping[str, float] = field(default_factory=dict)
    held: Mapping[str, float] = field(default_factory=dict)

    @property
    def standing(self) -> bool:
        """Whether what would be chosen is what flew, with the same numbers where JSBSim reads them once."""
        return self.again.values.keys() == self.keys and not self._off(STANDS)

    @property
    def far(self) -> dict[str, float]:
        """key -> value flown, of numbers that JSBSim reads once and whose estimates lie elsewhere."""
        return self._off(DIFFERENT)

    def _off(self, most: float) -> dict[str, float]:
        chosen = [c for c in self.selection.chosen if c.key in self.held]
        return {
            c.key: self.held[c.key]
            for c in chosen
            if abs(c.value - self.held[c.key]) > most * c.std
        }

    @property
    def keys(self) -> frozenset[str]:
        """Keys of the chosen effects."""
        return frozenset(self.selection.values)

    @property
    def free(self) -> tuple[str, ...]:
        """Columns estimated in its flight, those of its effects included."""
        return self.fit.columns[0].names


def joint_point(start: Start, about: Round, keys: Sequence[str]) -> Point:
    """Parameters, nuisance and start states where they are best beside the effects ``keys``, linearly; no effect in it yet, and
    other properties as they were without any."""
    evidence, point, plain, free = (
        about.evidence,
        about.fit.flown.point,
        start.before.flown.point,
        start.free,
    )
    delta = evidence.fitted(evidence.index([*free, *keys]))
    step = dict(zip(free, delta[evidence.index(free)].tolist(), strict=True))
    values = {n: point.values.get(n, v) for n, v in plain.values.items()}
    moved = stepped(
        start.setup, replace(plain, values=values, nuisance=point.nuisance), step, start.limits
    )
    delta[evidence.index(list(about.flown))] -= [*about.flown.values()]
    return replace(moved, starts=moved_starts(point.starts, evidence.white, delta))
