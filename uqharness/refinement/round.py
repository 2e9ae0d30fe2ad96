"""A round of a refinement: what it begins from and how it ends.

Everything is moved to its estimate on the linearised flight together with the effects. An effect
that the parameters have made up for so far cannot be put in by itself: with a centre of gravity
elsewhere and Cm_alpha as it was, the replay is worse than without, and no step leads down from
there."""

from __future__ import annotations

import contextlib
import logging
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from sysid.digests import file_sha256, sha256_hex
from sysid.effects import (
    DIFFERENT,
    GUST_ODDS,
    STANDS,
    VANE_ODDS,
    Columns,
    Effect,
    Evidence,
    Selection,
    TurbulenceModel,
    follow,
    gather,
    subsystem_effects,
    whiten_each,
)
from sysid.effects.catalogue import catalogue
from sysid.foreign.regular_files import read_regular
from sysid.foreign.typed_files import DataFileError, dump_parts, load
from sysid.parallel import Processes
from uqharness.errors import BadInputError
from uqharness.files import write_parts
from uqharness.identification.linearised import (
    PRIOR,
    FlightData,
    Linearisation,
    ModelState,
    in_step,
    merged,
    moved_starts,
    stepped,
)
from uqharness.replay import SENSOR_OF
from uqharness.simulator import Aircraft


@dataclass(frozen=True)
class Start:
    """What every round begins from: the aircraft, the flights, the fit without effects, the
    candidates and how they are judged.

    effects: the candidates by key; limits: of the parameters; limit: |t| asked of an effect
    gusts: the air, where flights are judged by one-step predictions
    merit: of the flight without effects, as a `Round` has it
    """

    aircraft: Aircraft
    setup: FlightData
    before: Linearisation
    names: tuple[str, ...]
    effects: Mapping[str, Effect]
    limits: Mapping[str, tuple[float, float]]
    limit: float
    map_: Processes
    merit: float
    gusts: TurbulenceModel | None = None

    @property
    def free(self) -> tuple[str, ...]:
        """Columns estimated in any case."""
        return self.before.columns[0].names

    @property
    def coloured(self) -> bool:
        """Whether the candidates' own spread tells how much of a t is chance: in turbulence and in
        an autopilot's logs.
        """
        return self.gusts is not None or bool(self.setup.late)

    def odds(self, effect: Effect) -> float:
        """Gain asked of an effect besides: its own odds, and those of what a gust model that is a
        little off would look like.
        """
        if self.gusts is None:
            return effect.odds
        gust_like = like_turning_air(effect) or (effect.subsystem or "").startswith(
            ("sensor.", "actuator.", "mass")
        )
        if not self.gusts.is_standard and effect.subsystem in VANES and effect.term == "scale":
            return effect.odds + VANE_ODDS
        return effect.odds + GUST_ODDS * gust_like


VANES = ("sensor.alpha_rad", "sensor.beta_rad")


def like_turning_air(effect: Effect) -> bool:
    """Whether it does what air does that turns as it moves: terms with the rates of the wind
    angles.
    """
    term = effect.parsed
    return term is not None and any(v in ("alphadot_hat", "betadot_hat") for v in term.variables)


@dataclass(frozen=True)
class Round:
    """Effects flown with everything estimated; the first round has none.

    evidence   as it would be had the effects not been flown, around the flight with them
    selection  the effects flown, judged there; again: what would be chosen there
    merit      minus twice the log likelihood, and what the effects must earn: less is better;
    gusts: the air, estimated with them
    flown      key -> value flown; held: those of numbers that JSBSim reads once
    """

    setup: FlightData
    fit: Linearisation
    evidence: Evidence
    selection: Selection
    again: Selection
    merit: float
    gusts: TurbulenceModel | None
    flown: Mapping[str, float] = field(default_factory=dict)
    held: Mapping[str, float] = field(default_factory=dict)

    @property
    def standing(self) -> bool:
        """Whether what would be chosen is what flew, with the same numbers where JSBSim reads them
        once.
        """
        return self.again.values.keys() == self.keys and not self._off(STANDS)

    @property
    def far(self) -> dict[str, float]:
        """key -> value flown, of numbers that JSBSim reads once and whose estimates lie
        elsewhere.
        """
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


def joint_point(start: Start, about: Round, keys: Sequence[str]) -> ModelState:
    """Parameters, nuisance and start states where they are best beside the effects ``keys``,
    linearly; no effect in it yet, and other properties as they were without any."""
    evidence, point, plain, free = (
        about.evidence,
        about.fit.trajectory.point,
        start.before.trajectory.point,
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


# Results of a refinement's stages kept on disk until it is done, so that one which was killed
# goes on where it was.

_LOG = logging.getLogger("uqharness")
T = TypeVar("T")
FOLDER = ".stages"
MOST_BYTES = 2_000_000_000
"""What a stage's file may hold; an hour of flights at 50 Hz takes less."""
_NAME = re.compile(r"[a-z]+[0-9]*-[0-9a-f]{16}\.data")


class Stages:
    """Remembers what functions returned, by a name and a key of everything that went in.

    A folder of results may come from anybody: its files are data and nothing in them is run. One
    that cannot be read, or is not what a stage of that name returns, counts as not there, which is
    said."""

    def __init__(self, folder: Path | None, parts: Sequence[str]) -> None:
        self.folder = folder
        self.key = sha256_hex("\0".join(parts).encode())[:16]

    def __call__(self, name: str, kind: Any, make: Callable[[], T]) -> T:
        """What ``make`` returns, from the disk if an earlier run with the same input got that far.

        ``kind``: its type.
        """
        folder = self._usable()
        if folder is None:
            return make()
        path = folder / f"{name}-{self.key}.data"
        try:
            found: T = load(read_regular(path, MOST_BYTES), kind)
            return found
        except FileNotFoundError:
            pass
        except (OSError, DataFileError) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else error
            _LOG.warning("%s: %s; this stage is computed again", path, reason)
        made = make()
        try:
            write_parts(path, dump_parts(made))
        except (BadInputError, DataFileError) as error:
            _LOG.warning(
                "%s: %s; if this run is interrupted, this stage is computed again", path, error
            )
        return made

    def forget(self) -> None:
        """Remove the files: the refinement is done.

        What is not a stage's own file stays, and so does the folder then.
        """
        folder = self._usable()
        if folder is None:
            return
        with contextlib.suppress(OSError):
            for path in folder.iterdir():
                if _NAME.fullmatch(path.name):
                    path.unlink()
            folder.rmdir()

    def _usable(self) -> Path | None:
        """The folder, unless it is a link to another place."""
        if self.folder is None or not self.folder.is_symlink():
            return self.folder
        _LOG.warning(
            "%s: is a link, not a folder of this program; stages are not kept", self.folder
        )
        self.folder = None
        return None


# What the stages of a refinement hand each other beside the fits.


@dataclass(frozen=True)
class Side:
    """Train or test flights: setup, the air or None."""

    setup: FlightData
    air: TurbulenceModel | None = None


@dataclass(frozen=True)
class Bent:
    """A curve that the forms chosen are not: coefficient and states, name in words, what it gains
    in twice the log likelihood beside all that was chosen, and with what probability chance gives
    as much; instead: keys of the effects that it can be."""

    coefficient: str
    states: tuple[str, ...]
    name: str
    gain: float
    p: float
    instead: tuple[str, ...]


# What a refinement is made of before anything is chosen: flights cut and judged, aircraft
# staged, candidates listed.


def file_hash(path: Path) -> str:
    """SHA-256 of a file's content. Raises BadInputError."""
    try:
        return file_sha256(path)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror}") from None


def refuse_shared(train: Sequence[Path], test: Sequence[Path]) -> None:
    """BadInputError when a test file has the content of a train file: a flight that chose cannot
    prove.
    """
    seen = {file_hash(path): path for path in train}
    for path in test:
        other = seen.get(file_hash(path))
        if other is not None:
            raise BadInputError(
                f"--test {path}: the same flight as --train {other}; a flight that helped to choose"
                " proves nothing: give another one"
            )


def candidates_for(
    setup: FlightData, names: Sequence[str], extra: Sequence[Effect]
) -> list[Effect]:
    """The catalogue less what the model estimates already, and the user's own effects."""
    surfaces = list(setup.servos)
    timed = setup.outputs if not setup.late else ()
    sensors, parts = (
        list(dict.fromkeys(SENSOR_OF.get(c, c) for c in timed)),
        [c for c in timed if c in SENSOR_OF],
    )
    every = [*extra, *catalogue(), *subsystem_effects(surfaces, setup.outputs, sensors, parts)]
    out: dict[str, Effect] = {}
    for e in every:
        if e.coefficient is None or e.property_name not in names:
            out.setdefault(e.key, e)
    return list(out.values())


def confirming_segments(setup: FlightData) -> NDArray[np.bool_]:
    """(S,) every third manoeuvre of each kind confirms what the others found; the kind is its label
    without speeds and numbers.
    """
    kinds = [s.kind for s in setup.segments]
    found = np.array([kinds[:k].count(kind) % 3 == 1 for k, kind in enumerate(kinds)])
    if not found.any() and len(found) > 2:
        found[1::3] = True
    return found


def column_evidence(
    setup: FlightData, fit: Linearisation, extra: Sequence[Columns], gusts: TurbulenceModel | None
) -> Evidence:
    """Evidence of a fit's own columns beside others; gusts: the air, where one-step predictions
    judge.
    """
    columns = merged(fit.columns, extra)
    measured, process = (
        (setup.measured, None)
        if gusts is None
        else (in_step(setup, fit.trajectory.point), gusts.process)
    )
    white = whiten_each(
        follow(fit.steps, measured, setup.output_rows, setup.noise, process), columns
    )
    return gather(white, columns.names, confirming_segments(setup), PRIOR, fit.columns[0].names)
