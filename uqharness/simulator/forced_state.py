"""A state forced upon the model: a fresh instance put there, its engines and, if asked, its control system settled."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.units import FT_M
from uqharness.simulator import control_system, engine
from uqharness.simulator.aircraft import Aircraft, open_aircraft
from uqharness.simulator.control_system import Rest

TRIM_LATITUDE_DEG = 45.0
"""Where states are forced and trims are made: there JSBSim's effective gravity is 9.806 m/s2."""

SETTLED_RADPS, MOST_FRAMES = 1e-6, 25
"""Change of alphadot and betadot from frame to frame at which a forced state has settled, and the frames that it may take."""

ACCELERATIONS = (
    "accelerations/udot-ft_sec2",
    "accelerations/vdot-ft_sec2",
    "accelerations/wdot-ft_sec2",
    "accelerations/pdot-rad_sec2",
    "accelerations/qdot-rad_sec2",
    "accelerations/rdot-rad_sec2",
)


def body_velocity(V: float, alpha: float, beta: float) -> tuple[float, float, float]:
    """u, v, w [m/s] of airspeed V at alpha, beta."""
    return (
        V * math.cos(alpha) * math.cos(beta),
        V * math.sin(beta),
        V * math.sin(alpha) * math.cos(beta),
    )


@dataclass(frozen=True)
class BodyState:
    """A state to be forced upon the model: air-relative velocity [m/s], Euler angles [rad], body rates [rad/s]."""

    u: float
    v: float
    w: float
    phi: float
    theta: float
    psi: float
    p: float = 0.0
    q: float = 0.0
    r: float = 0.0


def force_state(
    aircraft: Aircraft,
    state: BodyState,
    controls: Mapping[str, float],
    altitude_m: float,
    properties: Mapping[str, float] | None = None,
    outputs: tuple[str, ...] = (),
    rest: Rest | None = None,
) -> tuple[NDArray[np.float64], dict[str, float]]:
    """Accelerations (6,) [m/s2, rad/s2] of the model at a forced state in still air, and the values of those ``outputs`` that
    the model has.

    Actuators stand at their commands (first frame of a fresh instance, or with ``rest`` the control system brought to rest); the
    ground is put 300 m below. Raises BadInputError.
    """
    fdm, _ = forced(aircraft, state, controls, altitude_m, properties, rest)
    return answers(fdm, outputs)


def answers(fdm: Any, outputs: tuple[str, ...]) -> tuple[NDArray[np.float64], dict[str, float]]:
    """Accelerations (6,) [m/s2, rad/s2] of an instance as it stands, and the values of those ``outputs`` that it has."""
    acceleration = np.array([fdm[name] for name in ACCELERATIONS])
    acceleration[:3] *= FT_M
    manager = fdm.get_property_manager()
    return acceleration, {name: fdm[name] for name in outputs if manager.hasNode(name)}


def forced(
    aircraft: Aircraft,
    state: BodyState,
    controls: Mapping[str, float],
    altitude_m: float,
    properties: Mapping[str, float] | None,
    rest: Rest | None = None,
) -> tuple[Any, str]:
    """A fresh instance at that state, engines settled, and with ``rest`` the control system, and what does not settle (empty: all
    does)."""
    fdm = open_aircraft(aircraft)
    for name, value in (properties or {}).items():
        engine.set_property(fdm, name, value)
    apply_controls(fdm, aircraft, controls)
    fdm["ic/lat-geod-deg"] = TRIM_LATITUDE_DEG
    fdm["ic/terrain-elevation-ft"] = (altitude_m - 300.0) / FT_M
    fdm["ic/h-sl-ft"] = altitude_m / FT_M
    place(fdm, state)
    engine.run_ic(fdm)
    unsettled = engine.settle_engines(fdm) if fdm.get_propulsion().get_num_engines() else ""
    return fdm, unsettled or (control_system.bring_to_rest(fdm, rest) if rest is not None else "")


def place(fdm: Any, state: BodyState) -> None:
    """Give an instance its start: attitude, velocity and body rates."""
    fdm["ic/phi-rad"], fdm["ic/theta-rad"], fdm["ic/psi-true-rad"] = (
        state.phi,
        state.theta,
        state.psi,
    )
    fdm["ic/u-fps"], fdm["ic/v-fps"], fdm["ic/w-fps"] = (
        state.u / FT_M,
        state.v / FT_M,
        state.w / FT_M,
    )
    fdm["ic/p-rad_sec"], fdm["ic/q-rad_sec"], fdm["ic/r-rad_sec"] = state.p, state.q, state.r


def apply_controls(fdm: Any, aircraft: Aircraft, controls: Mapping[str, float]) -> None:
    """Set the command properties of the card's inputs; every engine runs, and takes JSBSim's throttle where that is the input."""
    engines = fdm.get_propulsion().get_num_engines()
    if engines:
        # First of all: starting the engines opens their throttles.
        engine.start_engines(fdm)
    for control, value in controls.items():
        set_control(fdm, aircraft, control, value)


def set_control(fdm: Any, aircraft: Aircraft, control: str, value: float) -> None:
    """Set one input's property, all throttles where it is JSBSim's first; nothing where the card has no such input."""
    card = aircraft.card.inputs.get(control)
    if card is None:
        return
    engine.set_property(fdm, card.property, value)
    if card.property == "fcs/throttle-cmd-norm":
        for index in range(1, fdm.get_propulsion().get_num_engines()):
            fdm[f"fcs/throttle-cmd-norm[{index}]"] = value
