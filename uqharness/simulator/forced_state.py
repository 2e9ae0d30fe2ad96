"""States imposed on the model: attitude, velocity and controls set, engines and controls settled.

`force_state` returns the accelerations at a given state; trim, linearisation and replays use it. It
loads the XML once for many states: the instance is reset, after a check that this gives the bits of
a new one. With a `ControlEquilibrium` the control system is first brought to rest: frames are
run with the motion frozen until nothing changes. Body rates can be left free, for control laws that
integrate a rate error and settle only at the commanded rate.
"""

from __future__ import annotations

import functools
import math
import re
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from sysid.units import FT_M
from uqharness.errors import BadInputError
from uqharness.simulator import engine, settling
from uqharness.simulator.aircraft import Aircraft, model_files, open_aircraft, staged
from uqharness.simulator.staging import HasFiles

# Control system at rest. In the first frames of an instance, filters and integrators start from
# zero, and flaps and gear move: forces are not those of steady flight.

RATES_HELD, RATES_FREE = "flight/steady-controls", "flight/steady-rates"
"""Run properties of a mission that starts with the control system at rest, body rates held or free.
"""

AT_REST = 1e-9
"""Relative (or absolute below 1) change per frame that counts as rest."""
BLOCK_FRAMES, MAX_BLOCKS, PATIENCE = 50, 400, 20
CONVERGED = 1e-11  # change over a block
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
    """How the control system is brought to rest.

    Attributes
    ----------
    watched : tuple of str
        Properties that must come to rest.
    free : bool
        Whether body rates are left to the control system.
    """

    watched: tuple[str, ...]
    free: bool = False

    @property
    def mark(self) -> str:
        """Return the run property that tells a flight to start this way."""
        return RATES_FREE if self.free else RATES_HELD


_POSITION = re.compile(r"fcs/(?:mag-)?([\w\-]+-pos)-(?:rad|deg)")


def control_outputs(aircraft: HasFiles) -> tuple[str, ...]:
    """Return the properties that the control system writes and the rest of the model reads.

    These are inputs of aerodynamics, engines and external forces. Raises BadInputError.
    """
    outputs, read = _written_and_read(aircraft)
    levers = {
        name
        for name in outputs
        if any(name.startswith(f"fcs/{lever}-pos-norm") for lever in _LEVERS)
    }
    direct = {name for name in outputs if name.startswith(_DIRECT)}
    # JSBSim converts a surface's position: the aerodynamics may read degrees in radians.
    positions = {match[1] for name in read if (match := _POSITION.fullmatch(name))}
    converted = {n for n in outputs if (m := _POSITION.fullmatch(n)) and m[1] in positions}
    return tuple(sorted((outputs & read) | converted | levers | direct))


def _written_and_read(aircraft: HasFiles) -> tuple[set[str], set[str]]:
    """Return the properties that the control system writes, and those that other sections read."""
    outputs: set[str] = set()
    read: set[str] = set()
    files = model_files(aircraft)
    for file in (*files.local.values(), *files.shared.values()):
        root = etree.parse(
            BytesIO(file.content), etree.XMLParser(remove_comments=True, resolve_entities=False)
        ).getroot()
        # A file is an aircraft with sections, or one section of its own.
        for section in [root] if root.tag != "fdm_config" else root.iterchildren("*"):
            if section.tag in _CONTROLS:
                outputs.update(_outputs(section))
            else:
                read.update(_tokens(section))
    return outputs, read


def _outputs(section: Any) -> Iterator[str]:
    """Yield the properties that the components of a section write."""
    for channel in section.iter("channel"):
        for component in channel.iterchildren("*"):
            if name := (component.get("name") or "").strip():
                # JSBSim derives the property from a name without a path.
                yield _without_index(
                    name if "/" in name else f"fcs/{re.sub(r'[^a-z0-9._-]', '-', name.lower())}"
                )
            for output in component.iterchildren("output"):
                yield _without_index((output.text or "").strip())


def _tokens(section: Any) -> Iterator[str]:
    """Yield the texts of a section that may be names of properties."""
    for element in section.iter("*"):
        text = (element.text or "").strip().lstrip("-+")
        if _NAME.fullmatch(text):
            yield _without_index(text)


def _without_index(name: str) -> str:
    """Return a property's name without the index of the first one."""
    return name.removesuffix("[0]")


def control_equilibrium(aircraft: HasFiles, fdm: Any, free: bool = False) -> ControlEquilibrium:
    """Return what must come to rest in an instance of the aircraft. Raises BadInputError."""
    exists = fdm.get_property_manager().hasNode
    return ControlEquilibrium(
        tuple(name for name in control_outputs(aircraft) if exists(name)), free
    )


def moving_property(fdm: Any, equilibrium: ControlEquilibrium, frames: int = 0) -> str:
    """Return a watched property that changes in the next frame; empty if none does.

    Time and motion are frozen in that frame; with ``frames``, motion alone in that many.
    """
    old_values = [fdm[name] for name in equilibrium.watched]
    if frames:
        run_frozen(fdm, frames)
    else:
        engine.renew_forces(fdm)
    for name, old in zip(equilibrium.watched, old_values, strict=True):
        if abs(fdm[name] - old) > AT_REST * max(abs(old), 1.0):
            return name
    return ""


def bring_to_rest(fdm: Any, equilibrium: ControlEquilibrium) -> str:
    """Run frames with frozen motion until control system and engines are at rest.

    Clock and fuel are unchanged. With ``equilibrium.free``, body rates end where the control system
    brings them. Returns an empty text, or what still changes. Raises BadInputError.
    """
    try:
        return _run_to_rest(fdm, equilibrium)
    except engine.RuntimeFailure as error:
        raise BadInputError(engine.explain(fdm, error)) from None


def settle_fuel_flow(fdm: Any, equilibrium: ControlEquilibrium) -> None:
    """Run frames with frozen motion until turbines draw fuel steadily.

    Their flow follows the thrust at 1000 lb/h per second, long after the controls are at rest.
    """
    exists = fdm.get_property_manager().hasNode
    flows = [
        engine.handle(fdm, f"propulsion/engine[{k}]/fuel-flow-rate-pps").get_double_value
        for k in range(fdm.get_propulsion().get_num_engines())
        if exists(f"propulsion/engine[{k}]/n2")
    ]
    for _ in range(MAX_BLOCKS if flows else 0):
        before = [get() for get in flows]
        run_frozen(fdm, BLOCK_FRAMES, equilibrium.free)
        if all(abs(get() - old) <= CONVERGED for get, old in zip(flows, before, strict=True)):
            return


def still_moving(fdm: Any, equilibrium: ControlEquilibrium, names: Sequence[str]) -> set[str]:
    """Bring the control system to rest and return those of ``names`` that keep changing."""
    if not bring_to_rest(fdm, equilibrium):
        return set()
    old_values = {name: fdm[name] for name in names}
    # It does not come to rest: see which of the names are affected.
    run_frozen(fdm, BLOCK_FRAMES)
    return {name for name in names if not abs(fdm[name] - old_values[name]) <= _MOVED_POSITION}


def _run_to_rest(fdm: Any, equilibrium: ControlEquilibrium) -> str:
    """Run blocks of frames until no watched property changes, or no progress is made."""
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
        if not largest > CONVERGED:
            return ""
        # Give up once PATIENCE blocks have not halved the smallest change.
        smallest, blocks_without_gain = (
            (largest, 0) if largest < 0.5 * smallest else (smallest, blocks_without_gain + 1)
        )
        if blocks_without_gain == PATIENCE:
            break
    # Small enough, although it has not converged.
    if largest <= AT_REST * BLOCK_FRAMES:
        return ""
    return (
        f"the control system does not come to rest: {worst} still changes by {largest:.2g} in"
        f" {BLOCK_FRAMES} frames"
    )


def run_frozen(fdm: Any, frames: int, free: bool = False) -> None:
    """Run frames with frozen motion, then restore the position: the Earth turned meanwhile.

    ``free`` leaves body rates to the control system.
    """
    frozen = [name for name in settling.INTEGRATORS if not (free and name == _ROTATION)]
    saved = {name: fdm[name] for name in frozen}
    time_s, trimming = fdm.get_sim_time(), fdm.get_trim_status()
    for name in frozen:
        fdm[name] = 0.0
    # In trim mode engines draw no fuel, and actuators, flaps and gear are at their commands.
    fdm.set_trim_status(True)
    try:
        for _ in range(frames):
            # Events of a script must not see time advance.
            fdm.set_sim_time(time_s)
            fdm.run()
    finally:
        fdm.set_trim_status(trimming)
        fdm.set_sim_time(time_s)
        for name, value in saved.items():
            fdm[name] = value
    if free:
        for axis in _RATES:
            # Keep the rates that the control system reached.
            fdm[f"ic/{axis}-rad_sec"] = fdm[f"velocities/{axis}-rad_sec"]
    # Initialisation would set a turboprop to idle.
    if not settling.has_turboprop(fdm):
        wind = {name: fdm[name] for name in _WIND}
        fdm.run_ic()
        for name, value in wind.items():
            fdm[name] = value


def marked_equilibrium(
    run_properties: Sequence[str], aircraft: HasFiles, fdm: Any
) -> ControlEquilibrium | None:
    """Return the equilibrium that a mission's run properties ask for; None if they do not.

    Raises BadInputError.
    """
    for free, mark in ((False, RATES_HELD), (True, RATES_FREE)):
        if mark in run_properties:
            return control_equilibrium(aircraft, fdm, free)
    return None


TRIM_LATITUDE_DEG = 45.0
"""Latitude of forced states and trims [deg]; JSBSim's effective gravity there is 9.806 m/s2."""

SETTLED_RADPS, MAX_FRAMES = 1e-6, 25
"""Change of alphadot and betadot per frame at which a forced state has settled, and the largest
number of frames.
"""
STATIONARY_SHARE = 1e-9
"""Relative change of the loads between two frames below which they are stationary."""

ACCELERATIONS = (
    "accelerations/udot-ft_sec2",
    "accelerations/vdot-ft_sec2",
    "accelerations/wdot-ft_sec2",
    "accelerations/pdot-rad_sec2",
    "accelerations/qdot-rad_sec2",
    "accelerations/rdot-rad_sec2",
)


def body_velocity(V: float, alpha: float, beta: float) -> tuple[float, float, float]:
    """Return u, v, w of an airspeed V at alpha and beta [rad], in the unit of V.

    Examples
    --------
    >>> body_velocity(20.0, 0.0, 0.0)
    (20.0, 0.0, 0.0)
    """
    return (
        V * math.cos(alpha) * math.cos(beta),
        V * math.sin(beta),
        V * math.sin(alpha) * math.cos(beta),
    )


@dataclass(frozen=True)
class BodyState:
    """A state: air-relative velocity [m/s], Euler angles [rad], body rates [rad/s]."""

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
    *,
    equilibrium: ControlEquilibrium | None = None,
) -> tuple[NDArray[np.float64], dict[str, float]]:
    """Return the accelerations of the model at a state in still air.

    Parameters
    ----------
    aircraft : Aircraft
        The aircraft.
    state : BodyState
        Velocity, attitude and rates.
    controls : mapping
        Control to command, in the card's units.
    altitude_m : float
        Altitude above sea level [m]; the ground is 300 m below.
    properties : mapping, optional
        Properties set before initialisation.
    outputs : tuple of str
        Properties to read, where they exist.
    equilibrium : ControlEquilibrium, optional
        Brings the control system to rest; else actuators are at their commands.

    Returns
    -------
    accelerations : ndarray
        (6,) du, dv, dw [m/s2], dp, dq, dr [rad/s2].
    values : dict
        Of ``outputs``.

    Raises
    ------
    BadInputError
        If the model does not load or a property does not exist.
    """
    return evaluate_state(
        aircraft, state, controls, altitude_m, properties, outputs, equilibrium=equilibrium
    )[:2]


Evaluation = tuple[NDArray[np.float64], dict[str, float], str]
"""Accelerations, outputs, and what does not settle (empty if all does)."""


def evaluate_state(
    aircraft: Aircraft,
    state: BodyState,
    controls: Mapping[str, float],
    altitude_m: float,
    properties: Mapping[str, float] | None = None,
    outputs: tuple[str, ...] = (),
    *,
    equilibrium: ControlEquilibrium | None = None,
) -> Evaluation:
    """Return what `force_state` does, and what does not settle at the state."""

    def action(fdm: Any, rearm: bool) -> Evaluation:
        unsettled = impose_state(
            fdm, aircraft, state, controls, altitude_m, properties, equilibrium, rearm=rearm
        )
        return (*read_accelerations(fdm, outputs), unsettled)

    return on_shared_instance(aircraft, action)


def read_accelerations(
    fdm: Any, outputs: tuple[str, ...]
) -> tuple[NDArray[np.float64], dict[str, float]]:
    """Return accelerations (6,) [m/s2, rad/s2] and ``outputs`` of an instance as it is."""
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
    """Return a new instance at a state, and what does not settle (empty if all does).

    Engines are settled, and with ``equilibrium`` the control system. Parameters as of
    `force_state`.
    """
    fdm = open_aircraft(aircraft)
    return fdm, impose_state(fdm, aircraft, state, controls, altitude_m, properties, equilibrium)


def impose_state(
    fdm: Any,
    aircraft: Aircraft,
    state: BodyState,
    controls: Mapping[str, float],
    altitude_m: float,
    properties: Mapping[str, float] | None,
    equilibrium: ControlEquilibrium | None = None,
    *,
    rearm: bool = False,
) -> str:
    """Bring an instance in the state after loading to a state; return what does not settle.

    ``rearm`` puts actuators at their commands first, where a reset leaves them at zero. Other
    parameters as of `force_state`.
    """
    for name, value in (properties or {}).items():
        engine.set_property(fdm, name, value)
    apply_controls(fdm, aircraft, controls)
    fdm["ic/lat-geod-deg"] = TRIM_LATITUDE_DEG
    # Far above the ground, where no ground effect or gear acts.
    fdm["ic/terrain-elevation-ft"] = (altitude_m - 300.0) / FT_M
    fdm["ic/h-sl-ft"] = altitude_m / FT_M
    set_initial_state(fdm, state)
    # In trim mode actuators take a frame for their first one.
    fdm.set_trim_status(rearm)
    engine.run_ic(fdm)
    if rearm:
        fdm.set_trim_status(False)
        engine.renew_forces(fdm)
    unsettled = engine.settle_engines(fdm) if fdm.get_propulsion().get_num_engines() else ""
    return unsettled or (bring_to_rest(fdm, equilibrium) if equilibrium is not None else "")


# One instance for many states: loading the XML takes ten times as long as an evaluation.

_MAX_SHARED = 4
# Only a file sets all initial conditions at once; setting one property rounds the others.
_ORIGIN = """<?xml version="1.0"?>
<initialize name="origin" version="2.0">
  <position frame="ECEF">
    <x unit="FT">20925646.32546</x> <y unit="FT">0</y> <z unit="FT">0</z>
  </position>
  <orientation unit="RAD" frame="LOCAL"> <x>0</x> <y>0</y> <z>0</z> </orientation>
</initialize>
"""
_ORIGIN_ZEROS = ("ic/terrain-elevation-ft", "ic/vt-fps", "ic/lat-gc-rad", "ic/h-sl-ft")
# Setting these does something.
_ACTING = ("ic/", "simulation/", "propulsion/set-running")
_shared_lock = threading.RLock()


class _SharedInstance:
    """A loaded instance that can be reset, and the evidence that a reset is exact.

    JSBSim's own reset leaves commands and other plain properties, which are put back, and the
    memory of actuators, which `impose_state` rearms. Where neither way gives the bits of a new
    instance (propellers that do not settle to the last digit, control laws with memory), every
    evaluation loads the XML.
    """

    def __init__(self, aircraft: Aircraft) -> None:
        self.aircraft = aircraft
        self.fdm = open_aircraft(aircraft)
        self._origin = staged(aircraft).root / "uqharness-origin.xml"
        self._origin.write_text(_ORIGIN, encoding="utf-8")
        # Values after loading, and how to put them back.
        self._settings = [
            (node.get_double_value, node.set_double_value, node.get_double_value())
            for name in engine.writable(self.fdm)
            if not name.startswith(_ACTING)
            for node in (engine.handle(self.fdm, name),)
        ]
        self.checked = False
        self.ways = [False, True]

    def reset(self) -> None:
        """Put the instance back into its state after loading."""
        self.fdm.reset_to_initial_conditions(2)
        self.fdm.load_ic(str(self._origin), False)
        for name in _ORIGIN_ZEROS:
            self.fdm[name] = 0.0
        for get, put, value in self._settings:
            if get() != value:
                put(value)

    def evaluate(self, action: Callable[[Any, bool], Evaluation]) -> Evaluation:
        """Return an action's evaluation on the reset instance."""
        self.reset()
        return action(self.fdm, self.ways[0])

    def check(self) -> None:
        """Keep the ways of resetting that give the bits of a new instance in unlike states."""
        self.checked = True
        for state, share in _UNLIKE:
            try:
                expected = self._probe(
                    open_aircraft(self.aircraft), False, state=state, share=share
                )
                # A frame with other commands, which a reset must make undone.
                self.fdm.run()
            except (BadInputError, engine.RuntimeFailure):
                # It does not fly in this state, which need not be one of the caller's.
                self.ways = []
                return
            probe = functools.partial(self._probe, state=state, share=share)
            self.keep_exact(probe, expected)

    def keep_exact(self, action: Callable[[Any, bool], Evaluation], expected: Evaluation) -> None:
        """Keep the ways of resetting with which an action gives the expected bits."""
        exact = []
        for rearm in self.ways:
            try:
                self.reset()
                if _same_bits(action(self.fdm, rearm), expected):
                    exact.append(rearm)
            except (BadInputError, engine.RuntimeFailure):
                continue
        self.ways = exact

    def _probe(self, fdm: Any, rearm: bool, *, state: BodyState, share: float | None) -> Evaluation:
        """Return the evaluation of a state with controls at a share of their ranges, or unset."""
        exists = fdm.get_property_manager().hasNode
        controls = {
            name: (1.0 - share) * card.limits[0] + share * card.limits[1]
            for name, card in self.aircraft.card.inputs.items()
            if share is not None and card.limits and exists(card.property)
        }
        unsettled = impose_state(fdm, self.aircraft, state, controls, 800.0, None, rearm=rearm)
        return (*read_accelerations(fdm, _PROBED), unsettled)


_UNLIKE = (
    (BodyState(40.0, 1.0, 2.0, 0.1, 0.1, 0.2, 0.1, 0.05, 0.02), 0.7),
    (BodyState(55.0, -1.5, 1.0, -0.2, 0.05, 0.0, -0.05, -0.02, 0.01), None),
)
_PROBED = (
    *(f"forces/fb{axis}-{part}-lbs" for axis in "xyz" for part in ("aero", "prop", "total")),
    *(f"moments/{axis}-{part}-lbsft" for axis in "lmn" for part in ("aero", "prop", "total")),
)
_shared: OrderedDict[object, _SharedInstance] = OrderedDict()


def _same_bits(a: Evaluation, b: Evaluation) -> bool:
    """Return whether two evaluations are equal to the last bit."""
    bits = [
        (x.tobytes(), tuple(values), np.array([*values.values()]).tobytes(), text)
        for x, values, text in (a, b)
    ]
    return bits[0] == bits[1]


def on_shared_instance(aircraft: Aircraft, action: Callable[[Any, bool], Evaluation]) -> Evaluation:
    """Return an action's evaluation on an instance as it is after loading.

    Parameters
    ----------
    aircraft : Aircraft
        The aircraft.
    action : callable
        Takes an instance and whether to rearm its actuators (`impose_state`). It must leave the
        integration step and integrators as they are, and keep no reference to the instance.

    Returns
    -------
    Evaluation
        With the bits of a new instance.

    Raises
    ------
    BadInputError
        If the model does not load, or of the action.
    """
    modes = aircraft.card.modes.get("open_loop", {})
    key = (staged(aircraft).root, aircraft.name, aircraft.dt_s, tuple(modes.items()))
    with _shared_lock:
        # Taken out: an error leaves an instance that is not used again.
        shared = _shared.pop(key, None)
        if shared is None:
            shared = _SharedInstance(aircraft)
            result = action(shared.fdm, False)
        elif not shared.ways:
            result = action(open_aircraft(aircraft), False)
        elif not shared.checked:
            shared.check()
            result = action(open_aircraft(aircraft), False)
            shared.keep_exact(action, result)
        else:
            result = shared.evaluate(action)
        _shared[key] = shared
        while len(_shared) > _MAX_SHARED:
            _shared.popitem(last=False)
        return result


def set_initial_state(fdm: Any, state: BodyState) -> None:
    """Set attitude, velocity and body rates of the initial conditions."""
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
    """Set the commands of the card's inputs, with all engines running."""
    engines = fdm.get_propulsion().get_num_engines()
    if engines:
        # Starting the engines opens their throttles, so it comes first.
        engine.start_engines(fdm)
    for control, value in controls.items():
        set_control(fdm, aircraft, control, value)


def set_control(fdm: Any, aircraft: Aircraft, control: str, value: float) -> None:
    """Set one input's property; all throttles if it is JSBSim's first one.

    Does nothing if the card has no such input.
    """
    card = aircraft.card.inputs.get(control)
    if card is not None:
        set_command(fdm, card.property, value)


def set_command(fdm: Any, name: str, value: float) -> None:
    """Set a command property; the throttles of all engines that pull if it is JSBSim's first."""
    pulling = engine.throttles(fdm)[0] if name == engine.THROTTLE else []
    for command in pulling or [name]:
        engine.set_property(fdm, command, value)
