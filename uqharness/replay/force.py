"""The model's own forces and moments at measured states: each state forced upon it, each answer read."""

from __future__ import annotations

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
from uqharness.replay.forced import States, by_batch
from uqharness.replay.ground import terrain_m
from uqharness.replay.model import ReplayModel, control_setters
from uqharness.replay.segments import Segment
from uqharness.simulator import MOST_FRAMES, SETTLED_RADPS, TRIM_LATITUDE_DEG, body_velocity, engine

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
