"""Forces at measured states by the batch engine, where it understands the aircraft and enough states are asked for at once.

A model's first states are answered by both engines, and JSBSim answers all others too where they differ. What was asked before does
not decide who answers: a run that goes on after an interruption gets the same digits.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from cachetools import LRUCache

from sysid.arrays import FloatArray
from sysid.units import FT_M
from uqharness import batch
from uqharness.batch import StateProgram
from uqharness.errors import BadInputError
from uqharness.replay.in_lanes import level_of, sources_of
from uqharness.replay.model import ReplayModel

_LOG = logging.getLogger("uqharness")
WORTH_ROWS = 2_000
"""States asked for at once from which on the aircraft is translated and compiled, for which JSBSim answers some 12,000. Who asks
for the states of a whole flight asks several times; tests, trims and start states ask for fewer."""
AGREES = 1e-6
"""Largest difference of a force or moment between the engines, in units of its largest size among the states compared."""
_COMPARED, _KEPT, _LEVEL_M = 9, 8, 1000.0


@dataclass(frozen=True)
class States:
    """n states: motion by names of `replay.STATES` without the heading, each (n,); controls (n, c) in their properties' units;
    altitude_m (n,) above sea level; terrain_m (n,) of the ground."""

    motion: Mapping[str, FloatArray]
    controls: FloatArray
    altitude_m: FloatArray
    terrain_m: FloatArray

    def some(self, rows: FloatArray) -> States:
        """Those of some rows."""
        motion = {name: np.asarray(value)[rows] for name, value in self.motion.items()}
        return States(motion, self.controls[rows], self.altitude_m[rows], self.terrain_m[rows])

    @staticmethod
    def of(parts: Sequence[States]) -> States:
        """Several sets of states as one."""
        if len(parts) == 1:
            return parts[0]
        motion = {
            name: np.concatenate([np.asarray(p.motion[name], dtype=float) for p in parts])
            for name in parts[0].motion
        }
        controls, altitude, terrain = (
            [getattr(p, name) for p in parts] for name in ("controls", "altitude_m", "terrain_m")
        )
        return States(
            motion, np.concatenate(controls), np.concatenate(altitude), np.concatenate(terrain)
        )


@dataclass
class _Known:
    """program: None until it is worth one, and where JSBSim is to answer (``refused``)."""

    program: StateProgram | None = None
    refused: bool = False


_known: LRUCache[str, _Known] = LRUCache(_KEPT)


def by_batch(
    model: ReplayModel,
    asked: States,
    dt_s: float,
    properties: Mapping[str, float],
    records: Sequence[str],
    by_jsbsim: Callable[[States], FloatArray],
) -> FloatArray | None:
    """(n, records) at the states, None where JSBSim is to answer. ``by_jsbsim`` answers for it."""
    known = _known.setdefault(model.identity, _Known())
    if known.refused or len(asked.controls) < WORTH_ROWS:
        return None
    names = {*properties, *(known.program.given if known.program is not None else ())}
    if known.program is None or not names <= set(known.program.given):
        known.program = _judged(
            model, asked, dt_s, properties, by_jsbsim, _made(model, dt_s, names, records)
        )
        known.refused = known.program is None
    return (
        None if known.program is None else _answered(known.program, model, asked, dt_s, properties)
    )


def _made(
    model: ReplayModel, dt_s: float, names: set[str], records: Sequence[str]
) -> StateProgram | None:
    if batch.available() is not None:
        return None
    controls = [model.card.inputs[name].property for name in model.controls]
    inputs = sorted(names | set(model.varied))
    try:
        return batch.make_states(
            sources_of(model),
            lambda: model.open(dt_s),
            dt_s,
            controls,
            inputs,
            records,
            model.by_rates,
        )
    except BadInputError as error:
        _LOG.info("states are forced upon JSBSim: %s", error)
        return None


def _judged(
    model: ReplayModel,
    asked: States,
    dt_s: float,
    properties: Mapping[str, float],
    by_jsbsim: Callable[[States], FloatArray],
    program: StateProgram | None,
) -> StateProgram | None:
    """The program, if it answers as JSBSim does."""
    if program is None:
        return None
    some = asked.some(np.unique(np.linspace(0, len(asked.controls) - 1, _COMPARED).astype(int)))
    ours, theirs = _answered(program, model, some, dt_s, properties), by_jsbsim(some)
    apart = float(np.max(np.abs(ours - theirs) / np.maximum(np.abs(theirs).max(axis=0), 1e-3)))
    if apart <= AGREES:
        return program
    _LOG.warning(
        "states are forced upon JSBSim: the batch engine differs by %.1g of a force's size", apart
    )
    return None


def _answered(
    program: StateProgram,
    model: ReplayModel,
    asked: States,
    dt_s: float,
    properties: Mapping[str, float],
) -> FloatArray:
    V, alpha, beta = (
        np.asarray(asked.motion[name], dtype=float) for name in ("V_mps", "alpha_rad", "beta_rad")
    )
    n = len(V)
    # At one latitude geodetic height goes with height above sea level in a straight line, to 1e-9 of it below 3 km.
    (latitude, at_sea), (_, at_top) = (level_of(model, level) for level in (0.0, _LEVEL_M))
    height = at_sea + (at_top - at_sea) / _LEVEL_M * asked.altitude_m
    conditions = {
        "ic/lat-geod-rad": np.full(n, latitude),
        "ic/long-gc-rad": np.zeros(n),
        "ic/geod-alt-ft": height,
        "ic/phi-rad": asked.motion["phi_rad"],
        "ic/theta-rad": asked.motion["theta_rad"],
        "ic/psi-true-rad": np.zeros(n),
        "ic/u-fps": V * np.cos(alpha) * np.cos(beta) / FT_M,
        "ic/v-fps": V * np.sin(beta) / FT_M,
        "ic/w-fps": V * np.sin(alpha) * np.cos(beta) / FT_M,
        "ic/p-rad_sec": asked.motion["p_radps"],
        "ic/q-rad_sec": asked.motion["q_radps"],
        "ic/r-rad_sec": asked.motion["r_radps"],
    }
    return batch.at_states(
        program, conditions, asked.terrain_m / FT_M, dt_s, asked.controls, properties
    )
