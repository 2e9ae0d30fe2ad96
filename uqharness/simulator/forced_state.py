"""A state forced upon the model: a fresh instance put there, its engines and, if asked, its control
system settled.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from sysid.units import FT_M
from uqharness.errors import BadInputError
from uqharness.simulator import engine, settling
from uqharness.simulator.aircraft import Aircraft, open_aircraft
from uqharness.simulator.staging import HasFiles, model_files

# The control system at rest: what aerodynamics and engines read of it no longer changes while
# the aircraft's motion stands still.
#
# In the first frames of an instance its filters and integrators are on their way from zero,
# flaps and gear from where JSBSim has put them: forces there are not those of steady flight.
# Frames are run with the motion frozen until all comes to rest. The body rates may be left
# free: a control law that integrates the error of a rate rests where the aircraft turns as
# commanded, and nowhere before.

RATES_HELD, RATES_FREE = "flight/steady-controls", "flight/steady-rates"
"""Run properties of a mission that begins with the control system at rest, body rates held or free
meanwhile.
"""

AT_REST = 1e-9
"""Change in a frame, as a share of the value or of 1, below which nothing moves."""
BLOCK_FRAMES, MAX_BLOCKS, PATIENCE = 50, 400, 20
_CONVERGED = 1e-11  # change over a block
_MOVED_POSITION = 1e-6  # deg or rad
_ROTATION = "simulation/integrator/rate/rotational"
_RATES = ("p", "q", "r")
_CONTROLS = frozenset({"flight_control", "autopilot", "system"})
_LEVERS = ("throttle", "mixture", "advance", "feather")
_DIRECT = ("propulsion/", "inertia/", "external_reactions/")
_NAME = re.compile(r"[A-Za-z_/][\w./\-]*(\[\d+\])?")
_WIND = tuple(f"atmosphere/wind-{axis}-fps" for axis in ("north", "east", "down"))
_BY_POWER = ("thrust-lbs", "propeller-rpm")


@dataclass(frozen=True)
class ControlEquilibrium:
    """How the control system comes to rest.

    ``watched``: properties that must; ``free``: the body rates are left free meanwhile.
    """

    watched: tuple[str, ...]
    free: bool = False

    @property
    def mark(self) -> str:
        """The run property that says so to a flight."""
        return RATES_FREE if self.free else RATES_HELD


def control_outputs(aircraft: HasFiles) -> tuple[str, ...]:
    """Properties that components of the control system write and aerodynamics, engines or external
    forces read. Raises BadInputError."""
    outputs, read = _written_and_read(aircraft)
    levers = {
        name
        for name in outputs
        if any(name.startswith(f"fcs/{lever}-pos-norm") for lever in _LEVERS)
    }
    return tuple(
        sorted((outputs & read) | levers | {name for name in outputs if name.startswith(_DIRECT)})
    )


def written_by_components(aircraft: HasFiles) -> set[str]:
    """Properties that components of the control system write. Raises BadInputError."""
    return _written_and_read(aircraft)[0]


def _written_and_read(aircraft: HasFiles) -> tuple[set[str], set[str]]:
    outputs: set[str] = set()
    read: set[str] = set()
    files = model_files(aircraft)
    for file in (*files.local.values(), *files.shared.values()):
        root = etree.parse(
            BytesIO(file.content), etree.XMLParser(remove_comments=True, resolve_entities=False)
        ).getroot()
        for section in [root] if root.tag != "fdm_config" else root.iterchildren("*"):
            if section.tag in _CONTROLS:
                outputs.update(_outputs(section))
            else:
                read.update(_tokens(section))
    return outputs, read


def _outputs(section: Any) -> Iterator[str]:
    for channel in section.iter("channel"):
        for component in channel.iterchildren("*"):
            if name := (component.get("name") or "").strip():
                yield _without_index(
                    name if "/" in name else f"fcs/{re.sub(r'[^a-z0-9._-]', '-', name.lower())}"
                )
            for output in component.iterchildren("output"):
                yield _without_index((output.text or "").strip())


def _tokens(section: Any) -> Iterator[str]:
    for element in section.iter("*"):
        text = (element.text or "").strip().lstrip("-+")
        if _NAME.fullmatch(text):
            yield _without_index(text)


def _without_index(name: str) -> str:
    return name.removesuffix("[0]")


def control_equilibrium(aircraft: HasFiles, fdm: Any, free: bool = False) -> ControlEquilibrium:
    """What must come to rest in an instance of the aircraft. Raises BadInputError."""
    exists = fdm.get_property_manager().hasNode
    return ControlEquilibrium(
        tuple(name for name in control_outputs(aircraft) if exists(name)), free
    )


def moving_property(fdm: Any, equilibrium: ControlEquilibrium) -> str:
    """What of the control system moves in the next frame, in which time and motion stand still;
    empty where nothing does.
    """
    old_values = [fdm[name] for name in equilibrium.watched]
    engine.renew_forces(fdm)
    for name, old in zip(equilibrium.watched, old_values, strict=True):
        if abs(fdm[name] - old) > AT_REST * max(abs(old), 1.0):
            return name
    return ""


def bring_to_rest(fdm: Any, equilibrium: ControlEquilibrium) -> str:
    """Run frames, the motion frozen, until control system and engines rest: empty, or what still
    changes. Clock and fuel stay.

    With ``rest.free`` the body rates end where the control system brings them. Raises
    BadInputError."""
    try:
        return _run_to_rest(fdm, equilibrium)
    except engine.RuntimeFailure as error:
        raise BadInputError(engine.explain(fdm, error)) from None


def still_moving(fdm: Any, equilibrium: ControlEquilibrium, names: Sequence[str]) -> set[str]:
    """Bring the control system to rest as far as it goes, and return those of ``names`` that change
    in further frames.
    """
    if not bring_to_rest(fdm, equilibrium):
        return set()
    old_values = {name: fdm[name] for name in names}
    run_frozen(fdm, BLOCK_FRAMES)
    return {name for name in names if not abs(fdm[name] - old_values[name]) <= _MOVED_POSITION}


def _run_to_rest(fdm: Any, equilibrium: ControlEquilibrium) -> str:
    exists = fdm.get_property_manager().hasNode
    engines = range(fdm.get_propulsion().get_num_engines())
    powers = [
        f"propulsion/engine[{k}]/{reading}"
        for k in engines
        for reading in _BY_POWER
        if exists(f"propulsion/engine[{k}]/{reading}")
    ]
    rates = [f"velocities/{axis}-rad_sec" for axis in _RATES] if equilibrium.free else []
    names = [*equilibrium.watched, *powers, *rates]
    read = [engine.handle(fdm, name).get_double_value for name in names]
    previous, smallest, blocks_without_gain, largest, worst = (
        [get() for get in read],
        float("inf"),
        0,
        float("inf"),
        "",
    )
    for _ in range(MAX_BLOCKS):
        run_frozen(fdm, BLOCK_FRAMES, equilibrium.free)
        current = [get() for get in read]
        changes = [
            abs(new - old) / max(abs(new), 1.0) for new, old in zip(current, previous, strict=True)
        ]
        largest = max(changes, default=0.0)
        worst = names[changes.index(largest)] if changes else ""
        previous = current
        if not largest > _CONVERGED:
            return ""
        smallest, blocks_without_gain = (
            (largest, 0) if largest < 0.5 * smallest else (smallest, blocks_without_gain + 1)
        )
        if blocks_without_gain == PATIENCE:
            break
    if largest <= AT_REST * BLOCK_FRAMES:
        return ""
    return (
        f"the control system does not come to rest: {worst} still changes by {largest:.2g} in"
        f" {BLOCK_FRAMES} frames"
    )


def run_frozen(fdm: Any, frames: int, free: bool = False) -> None:
    """Frames with the motion frozen, then the aircraft back where it was: the Earth has turned
    beneath it meanwhile.

    ``free``: body rates are left to the control system.
    """
    frozen = [name for name in settling.INTEGRATORS if not (free and name == _ROTATION)]
    saved = {name: fdm[name] for name in frozen}
    time_s, trimming = fdm.get_sim_time(), fdm.get_trim_status()
    for name in frozen:
        fdm[name] = 0.0
    # While JSBSim takes itself to be trimming, no engine draws fuel, and actuators, flaps and gear
    # stand where they are commanded.
    fdm.set_trim_status(True)
    try:
        for _ in range(frames):
            # A script's events must not take these frames for flight.
            fdm.set_sim_time(time_s)
            fdm.run()
    finally:
        fdm.set_trim_status(trimming)
        fdm.set_sim_time(time_s)
        for name, value in saved.items():
            fdm[name] = value
    if free:
        for axis in _RATES:
            fdm[f"ic/{axis}-rad_sec"] = fdm[f"velocities/{axis}-rad_sec"]
    # A turboprop would fall back to idle.
    if not settling.has_turboprop(fdm):
        wind = {name: fdm[name] for name in _WIND}
        fdm.run_ic()
        for name, value in wind.items():
            fdm[name] = value


def marked_equilibrium(
    run_properties: Sequence[str], aircraft: HasFiles, fdm: Any
) -> ControlEquilibrium | None:
    """How a mission's flights bring the control system to rest before they begin; None where they
    need not.

    Raises BadInputError.
    """
    for free, mark in ((False, RATES_HELD), (True, RATES_FREE)):
        if mark in run_properties:
            return control_equilibrium(aircraft, fdm, free)
    return None


TRIM_LATITUDE_DEG = 45.0
"""Where states are forced and trims are made: there JSBSim's effective gravity is 9.806 m/s2."""

SETTLED_RADPS, MAX_FRAMES = 1e-6, 25
"""Change of alphadot and betadot from frame to frame at which a forced state has settled, and the
frames that it may take.
"""

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
    """A state to be forced upon the model: air-relative velocity [m/s], Euler angles [rad], body
    rates [rad/s].
    """

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
    equilibrium: ControlEquilibrium | None = None,
) -> tuple[NDArray[np.float64], dict[str, float]]:
    """Accelerations (6,) [m/s2, rad/s2] of the model at a forced state in still air, and the values
    of those ``outputs`` that the model has.

    Actuators stand at their commands (first frame of a fresh instance, or with ``equilibrium`` the control
    system brought to rest); the ground is put 300 m below. Raises BadInputError."""
    fdm, _ = open_forced(aircraft, state, controls, altitude_m, properties, equilibrium)
    return read_accelerations(fdm, outputs)


def read_accelerations(
    fdm: Any, outputs: tuple[str, ...]
) -> tuple[NDArray[np.float64], dict[str, float]]:
    """Accelerations (6,) [m/s2, rad/s2] of an instance as it stands, and the values of those
    ``outputs`` that it has.
    """
    acceleration = np.array([fdm[name] for name in ACCELERATIONS])
    acceleration[:3] *= FT_M
    manager = fdm.get_property_manager()
    return acceleration, {name: fdm[name] for name in outputs if manager.hasNode(name)}


def open_forced(
    aircraft: Aircraft,
    state: BodyState,
    controls: Mapping[str, float],
    altitude_m: float,
    properties: Mapping[str, float] | None,
    equilibrium: ControlEquilibrium | None = None,
) -> tuple[Any, str]:
    """A fresh instance at that state, engines settled, and with ``equilibrium`` the control system, and
    what does not settle (empty: all does)."""
    fdm = open_aircraft(aircraft)
    for name, value in (properties or {}).items():
        engine.set_property(fdm, name, value)
    apply_controls(fdm, aircraft, controls)
    fdm["ic/lat-geod-deg"] = TRIM_LATITUDE_DEG
    fdm["ic/terrain-elevation-ft"] = (altitude_m - 300.0) / FT_M
    fdm["ic/h-sl-ft"] = altitude_m / FT_M
    set_initial_state(fdm, state)
    engine.run_ic(fdm)
    unsettled = engine.settle_engines(fdm) if fdm.get_propulsion().get_num_engines() else ""
    return fdm, unsettled or (bring_to_rest(fdm, equilibrium) if equilibrium is not None else "")


def set_initial_state(fdm: Any, state: BodyState) -> None:
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
    """Set the command properties of the card's inputs; every engine runs, and takes JSBSim's
    throttle where that is the input.
    """
    engines = fdm.get_propulsion().get_num_engines()
    if engines:
        # First of all: starting the engines opens their throttles.
        engine.start_engines(fdm)
    for control, value in controls.items():
        set_control(fdm, aircraft, control, value)


def set_control(fdm: Any, aircraft: Aircraft, control: str, value: float) -> None:
    """Set one input's property, all throttles where it is JSBSim's first; nothing where the card
    has no such input.
    """
    card = aircraft.card.inputs.get(control)
    if card is None:
        return
    engine.set_property(fdm, card.property, value)
    if card.property == "fcs/throttle-cmd-norm":
        for index in range(1, fdm.get_propulsion().get_num_engines()):
            fdm[f"fcs/throttle-cmd-norm[{index}]"] = value
