"""The model's own forces and moments at measured states: each state forced upon it, each answer read."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from cachetools import LRUCache, cached

from sysid.aerodynamics.coefficients import MassProperties
from sysid.arrays import FloatArray
from sysid.parallel import ALONE, Processes
from sysid.units import FT_M, LBF_FT_NM, LBF_N, PSF_PA, SLUG_KG
from uqharness import batch
from uqharness.batch import StateProgram
from uqharness.errors import BadInputError
from uqharness.replay.in_lanes import level_of, sources_of
from uqharness.replay.model import ReplayModel, control_setters, terrain_m
from uqharness.replay.segments import Segment
from uqharness.simulator import MOST_FRAMES, SETTLED_RADPS, TRIM_LATITUDE_DEG, body_velocity, engine

# Forces at measured states by the batch engine, where it understands the aircraft and enough
# states are asked for at once.
#
# A model's first states are answered by both engines, and JSBSim answers all others too where
# they differ. What was asked before does not decide who answers: a run that goes on after an
# interruption gets the same digits.

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
    names = {*properties, *(known.program.properties if known.program is not None else ())}
    if known.program is None or not names <= set(known.program.properties):
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


_FORCES = tuple(f"forces/fb{a}-{kind}-lbs" for kind in ("total", "aero") for a in "xyz")
_MOMENTS = tuple(f"moments/{a}-{kind}-lbsft" for kind in ("total", "aero") for a in "lmn")
_RECORDS = (*_FORCES, *_MOMENTS, "aero/qbar-psf")
_WEIGHED = 8


@dataclass(frozen=True)
class ForcedModel:
    """What the model says at n states: aerodynamic and other forces [N], moments about the CG [N m], (n, 3) each; qbar (n,) [Pa].

    ``other`` is everything but aerodynamics and gravity, thrust above all. ``coefficients`` (n, 6) CX CY CZ Cl Cm Cn.
    """

    aero_force: FloatArray
    other_force: FloatArray
    aero_moment: FloatArray
    other_moment: FloatArray
    qbar: FloatArray
    mass: MassProperties

    @property
    def coefficients(self) -> FloatArray:
        """CX CY CZ Cl Cm Cn of the model at each sample, (n, 6), body axes at the centre of gravity."""
        pressure = self.qbar[:, None] * self.mass.S
        return np.hstack(
            [self.aero_force / pressure, self.aero_moment / (pressure * self.mass.lengths)]
        )


@dataclass(frozen=True)
class StatesOf:
    """States of one segment to be forced: V, alpha, beta, phi, theta, p, q, r (n,) each; controls (n, c) [record units];
    altitude_m (n,) above sea level, default the segment's throughout."""

    segment: Segment
    states: Mapping[str, FloatArray]
    controls: FloatArray
    altitude_m: FloatArray | None = None

    def asked(self, model: ReplayModel) -> States:
        """With controls in their properties' units, over ground that none of the states is below."""
        n = len(self.controls)
        height = np.full(n, self.segment.altitude_m) if self.altitude_m is None else self.altitude_m
        terrain = min(terrain_m(model, self.segment), float(height.min()))
        return States(self.states, model.to_property(self.controls), height, np.full(n, terrain))


def force_states(
    model: ReplayModel,
    segment: Segment,
    states: Mapping[str, FloatArray],
    controls: FloatArray,
    properties: Mapping[str, float],
    altitude_m: FloatArray | None = None,
) -> ForcedModel:
    """`force_all` of one segment's states."""
    return force_all(model, [StatesOf(segment, states, controls, altitude_m)], properties)[0]


def force_all(
    model: ReplayModel,
    parts: Sequence[StatesOf],
    properties: Mapping[str, float],
    map_: Processes = ALONE,
) -> list[ForcedModel]:
    """What the model says of several sets of states, those of one time step asked for at once. Where JSBSim answers, ``map_``
    spreads the sets.

    ``model`` must pass its controls straight through (`ReplayFolder` with every control ideal): a lag would remember the state
    before. Raises BadInputError.
    """
    out: dict[int, ForcedModel] = {}
    # Steps of segments of one record differ by rounding.
    steps = [round(part.segment.dt_s, 9) for part in parts]
    for dt_s in dict.fromkeys(steps):
        places = [k for k, step in enumerate(steps) if step == dt_s]
        out |= zip(
            places,
            _of_step(model, [parts[k].asked(model) for k in places], dt_s, properties, map_),
            strict=True,
        )
    return [out[k] for k in range(len(parts))]


def _of_step(
    model: ReplayModel,
    every: Sequence[States],
    dt_s: float,
    properties: Mapping[str, float],
    map_: Processes,
) -> list[ForcedModel]:
    def by_jsbsim(some: States) -> FloatArray:
        return _by_jsbsim((model, dt_s, properties, some))

    raw = by_batch(model, States.of(every), dt_s, properties, _RECORDS, by_jsbsim)
    if raw is None:
        raw = np.concatenate(
            list(map_(_by_jsbsim, [(model, dt_s, properties, states) for states in every]))
        )
    mass = _mass_of(model, dt_s, properties)
    edges = np.cumsum([0, *(len(part.controls) for part in every)])
    return [_said(raw[a:b], mass) for a, b in pairwise(edges.tolist())]


def _by_jsbsim(job: tuple[ReplayModel, float, Mapping[str, float], States]) -> FloatArray:
    model, dt_s, properties, states = job
    return _forced(_opened(model, dt_s, properties), model, states)


def _said(raw: FloatArray, mass: MassProperties) -> ForcedModel:
    total, aero = raw[:, 0:3] * LBF_N, raw[:, 3:6] * LBF_N
    total_moment, aero_moment = raw[:, 6:9] * LBF_FT_NM, raw[:, 9:12] * LBF_FT_NM
    return ForcedModel(
        aero, total - aero, aero_moment, total_moment - aero_moment, raw[:, 12] * PSF_PA, mass
    )


def _opened(model: ReplayModel, dt_s: float, properties: Mapping[str, float]) -> Any:
    fdm = model.open(dt_s)
    for name, value in properties.items():
        engine.set_property(fdm, name, value)
    return fdm


@cached(
    LRUCache(_WEIGHED),
    key=lambda model, dt_s, properties: (model.identity, *sorted(properties.items())),
)
def _mass_of(model: ReplayModel, dt_s: float, properties: Mapping[str, float]) -> MassProperties:
    """Mass properties of a model."""
    fdm = _opened(model, dt_s, properties)
    engine.run_ic(fdm)
    return mass_properties(fdm, model)


def _forced(fdm: Any, model: ReplayModel, asked: States) -> FloatArray:
    """(n, records) at n states, one after the other."""
    engines = fdm.get_propulsion().get_num_engines()
    if engines:
        engine.start_engines(fdm)
    setters = control_setters(fdm, model)
    fdm["ic/lat-geod-deg"] = TRIM_LATITUDE_DEG
    terrain = engine.handle(fdm, "ic/terrain-elevation-ft").set_double_value
    names = (
        "h-sl-ft",
        "phi-rad",
        "theta-rad",
        "psi-true-rad",
        "u-fps",
        "v-fps",
        "w-fps",
        "p-rad_sec",
        "q-rad_sec",
        "r-rad_sec",
    )
    put = [engine.handle(fdm, f"ic/{name}").set_double_value for name in names]
    get = [engine.handle(fdm, name).get_double_value for name in _RECORDS]
    rates = [
        engine.handle(fdm, f"aero/{name}dot-rad_sec").get_double_value for name in ("alpha", "beta")
    ]
    raw, states = np.empty((len(asked.controls), len(get))), asked.motion
    for k in range(len(raw)):
        for handles, value in zip(setters, asked.controls[k], strict=True):
            for setter in handles:
                setter(float(value))
        u, v, w = body_velocity(
            float(states["V_mps"][k]), float(states["alpha_rad"][k]), float(states["beta_rad"][k])
        )
        state = (
            asked.altitude_m[k] / FT_M,
            states["phi_rad"][k],
            states["theta_rad"][k],
            0.0,
            u / FT_M,
            v / FT_M,
            w / FT_M,
            states["p_radps"][k],
            states["q_radps"][k],
            states["r_radps"][k],
        )
        terrain(float(asked.terrain_m[k]) / FT_M)
        for setter, value in zip(put, state, strict=True):
            setter(float(value))
        if not fdm.run_ic():
            raise engine.RuntimeFailure(f"JSBSim could not take the state of sample {k}")
        if engines:
            engine.settle_engines(fdm)
        if model.by_rates:
            _settle_rates(fdm, *rates)
        raw[k] = [g() for g in get]
    return raw


def _settle_rates(fdm: Any, alphadot: Callable[[], float], betadot: Callable[[], float]) -> None:
    # JSBSim takes alphadot and betadot from the accelerations of the frame before: of another state, when states are forced.
    before, moved = (alphadot(), betadot()), float("inf")
    for _ in range(MOST_FRAMES):
        engine.renew_forces(fdm)
        now, last = (alphadot(), betadot()), moved
        moved = abs(now[0] - before[0]) + abs(now[1] - before[1])
        # A force that outgrows the acceleration that it is a part of settles nowhere, and no frame of it is better than another.
        if moved < SETTLED_RADPS or not moved < last:
            return
        before = now


def mass_properties(fdm: Any, model: ReplayModel) -> MassProperties:
    """Mass, inertia and reference lengths of an initialised instance; the card's lengths win."""
    get = fdm.__getitem__
    unit = SLUG_KG * FT_M**2
    # JSBSim publishes the elements of its inertia matrix: inertia/ixz is minus the product of inertia Ixz.
    names = [["ixx", "ixy", "ixz"], ["ixy", "iyy", "iyz"], ["ixz", "iyz", "izz"]]
    inertia = unit * np.array([[get(f"inertia/{n}-slugs_ft2") for n in row] for row in names])
    reference = model.card.reference
    return MassProperties(
        float(get("inertia/mass-slugs")) * SLUG_KG,
        inertia,
        reference.S_m2 or get("metrics/Sw-sqft") * FT_M**2,
        reference.b_m or get("metrics/bw-ft") * FT_M,
        reference.c_m or get("metrics/cbarw-ft") * FT_M,
    )
