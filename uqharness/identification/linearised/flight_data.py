"""Flights, model and replays as the linearised estimators share them.

`FlightData` is fixed for a set of flights, `ModelState` holds all numbers that are estimated, and
`Trajectory` the replays at one `ModelState`. `stage_models` keeps JSBSim's folders.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sysid.aerodynamics.rigid_body import OUTPUTS as STEP_OUTPUTS
from sysid.arrays import FloatArray
from sysid.effects import Effect
from sysid.estimation import channel_noise, shows_process_noise
from uqharness.identification.replay_fit import BIASES, OUTPUTS
from uqharness.replay import (
    CONTROL_DELAY,
    CONTROLS,
    SENSOR_OF,
    UNSEEN,
    Flight,
    ReplayFolder,
    ReplayModel,
    Segment,
    measured_outputs,
    states,
)
from uqharness.replay.flights import segments
from uqharness.simulator import Actuator, Aircraft, servo_number
from uqharness.xml import servo_of_surface


def acts_on_motion(effect: Effect) -> bool:
    """Return whether an effect acts on the motion, and so belongs in the aircraft's XML.

    Effects of sensors and of the record's clock do not.
    """
    return not (effect.subsystem or "").startswith(("sensor.", "record"))


def control_delay_name(flight: str) -> str:
    """Return the name of the delay [s] with which a flight's controls act after their rows.

    A simulation's half step and late logging cause one.
    """
    return f"lateness/{flight}/{CONTROL_DELAY}"


def jump_share_name(flight: str) -> str:
    """Return the name of the share of a control's jump that its row's accelerometers miss."""
    return f"{UNSEEN}/{flight}"


@dataclass(frozen=True)
class EffectProperty:
    """Property of the simulation through which an effect acts.

    Attributes
    ----------
    name : str
        The property.
    absent : float
        Its value without the effect.
    servo : Actuator or None
        The servo without the effect, for an effect on a servo.
    term : str
        "lag" or "rate_limit" of the servo.
    unit_deg : float
        Degrees per unit of the servo's output.
    """

    name: str
    absent: float
    servo: Actuator | None = None
    term: str = ""
    unit_deg: float = 1.0

    @property
    def exact(self) -> bool:
        """Whether a value of the property restores the aircraft bit for bit.

        A servo without a lag has no such value.
        """
        return self.servo is None or self.term != "lag" or self.servo.lag is not None

    def at(self, value: float) -> float:
        """Return the property's value for a value of the effect."""
        return (
            self.absent + value
            if self.servo is None
            else servo_number(self.servo, self.term, value, self.unit_deg)
        )


@dataclass(frozen=True)
class FlightData:
    """Flights and settings of an estimation: all that does not change with the parameters.

    Attributes
    ----------
    flights, segments : tuple
        Flights, and the segments of all of them.
    channels : tuple of mapping
        Each segment's states, (n,) each.
    outputs : tuple of str
        The m compared channels.
    measured : tuple of (n, m) array
        Logged outputs of each segment.
    noise : (m,) array
        Standard deviations of the outputs' noise.
    biased : tuple of str
        Channels with an estimated bias.
    delayed_sensors : mapping
        Flight to the sensors whose delay is estimated.
    positions : tuple of str
        Surfaces whose positions were recorded.
    ideal : tuple of str
        Controls without an actuator.
    active : tuple of Effect
        Effects that the model or its sensors have.
    carriers : mapping
        Effect key to the property through which it acts.
    servos : mapping
        Actuators of the surfaces of which only commands were recorded.
    trial_rate_limits : mapping
        Surface to the two rate limits [deg/s] whose difference is a slower servo's regressor
        while the model has no such effect.
    trial_lags : mapping
        Surface to the lag [s] that gives its regressor likewise, of servos without one.
    trial_dead_zones : mapping
        Surface to the width [deg] of the dead zone that gives its regressor likewise.
    lower_bounds : mapping
        Effect key to the value of a rate limit's effect below which nothing changes.
    slopes : mapping
        Control slopes that active effects are written with.
    timed : tuple of str
        Flights whose controls have an estimated delay (`lateness`).
    jumping : tuple of str
        Flights with an estimated share of jumps (`unseen`).
    """

    flights: tuple[Flight, ...]
    segments: tuple[Segment, ...]
    channels: tuple[Mapping[str, FloatArray], ...]
    outputs: tuple[str, ...]
    measured: tuple[FloatArray, ...]
    noise: FloatArray
    biased: tuple[str, ...]
    delayed_sensors: Mapping[str, Sequence[str]]
    positions: tuple[str, ...] = ()
    ideal: tuple[str, ...] = ()
    active: tuple[Effect, ...] = ()
    carriers: Mapping[str, EffectProperty] = field(default_factory=dict)
    servos: Mapping[str, Actuator] = field(default_factory=dict)
    trial_rate_limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    trial_lags: Mapping[str, float] = field(default_factory=dict)
    trial_dead_zones: Mapping[str, float] = field(default_factory=dict)
    lower_bounds: Mapping[str, float] = field(default_factory=dict)
    slopes: Mapping[str, float] = field(default_factory=dict)
    timed: tuple[str, ...] = ()
    jumping: tuple[str, ...] = ()

    @property
    def output_rows(self) -> list[int]:
        """Columns of the compared outputs in a replay."""
        return [STEP_OUTPUTS.index(c) for c in self.outputs]

    def properties(self, point: ModelState) -> dict[str, float]:
        """Return all properties that are set at a point: parameters and active effects."""
        by_carrier = {
            carrier.name: carrier.at(point.effects.get(key, 0.0))
            for key, carrier in self.carriers.items()
        }
        return {**point.values, **by_carrier}

    def with_effects(self, keys: Collection[str]) -> FlightData:
        """Return the data of a model that has these of the active effects alone."""
        return replace(
            self,
            active=tuple(e for e in self.active if e.key in keys),
            carriers={key: place for key, place in self.carriers.items() if key in keys},
        )

    @property
    def fixed_effects(self) -> list[str]:
        """Keys of active effects that no step changes: JSBSim reads mass and dead zones once."""
        return [e.key for e in self.active if e.key not in self.carriers and acts_on_motion(e)]

    @property
    def nuisance(self) -> tuple[str, ...]:
        """Names of biases, delays and jump shares, estimated beside parameters and effects."""
        names = [f"bias/{f.name}/{c}" for f in self.flights for c in self.biased]
        names += [
            *(control_delay_name(f) for f in self.timed),
            *(jump_share_name(f) for f in self.jumping),
        ]
        return (
            *names,
            *(f"delay/{f}/{s}" for f, sensors in self.delayed_sensors.items() for s in sensors),
        )


@dataclass(frozen=True)
class ModelState:
    """All numbers of a model that are estimated.

    Attributes
    ----------
    values : mapping
        Parameters: properties by name.
    nuisance : mapping
        Biases, delays and jump shares by name.
    starts : tuple of (9,) array
        Start state of each segment.
    effects : mapping
        Values of the active effects by key.
    """

    values: Mapping[str, float]
    nuisance: Mapping[str, float]
    starts: tuple[FloatArray, ...]
    effects: Mapping[str, float] = field(default_factory=dict)


def control_delay_s(point: ModelState, flight: str) -> float:
    """Return the delay of a flight's controls [s]."""
    return point.nuisance.get(control_delay_name(flight), 0.0)


def jump_share(point: ModelState, flight: str) -> float:
    """Return the share of a flight's jumps that its rows' accelerometer readings lack."""
    return point.nuisance.get(jump_share_name(flight), 0.0)


@dataclass(frozen=True)
class Trajectory:
    """Replays at one `ModelState`.

    Attributes
    ----------
    point : ModelState
    outputs : list of (n, m) array
        Outputs of each segment, with the sensors' errors.
    x : list of (n, 8) array
        States of the reference.
    height : list of (n,) array
        Height above ground [m].
    cost : float
        Sum of squared residuals over noise; infinite where a replay diverged.
    """

    point: ModelState
    outputs: list[FloatArray]
    x: list[FloatArray]
    height: list[FloatArray]
    cost: float


# Preparation: segments, measured outputs and their noise.


def parameter_limits(aircraft: Aircraft) -> dict[str, tuple[float, float]]:
    """Return lower and upper bound of each parameter of the aircraft's card."""
    unlimited = (-np.inf, np.inf)
    return {
        n: unlimited if c.bounds is None else c.bounds for n, c in aircraft.card.parameters.items()
    }


def make_flight_data(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    measured: Sequence[str],
    ideal: Sequence[str] = (),
) -> FlightData:
    """Return the data of some flights; parameters as the attributes of `FlightData`."""
    arm = aircraft.accelerometer_m
    pieces = [s for f in flights for s in segments(f, measured, arm)]
    outputs = tuple(
        c for c in OUTPUTS if any(c in f.record and np.isfinite(f.record[c]).any() for f in flights)
    )
    data = [b for f in flights for b in measured_outputs(f, outputs)]
    late = {
        f.name: list(dict.fromkeys(SENSOR_OF.get(c, c) for c in outputs))
        for f in flights
        if f.record.metadata.native_hz
    }
    return FlightData(
        tuple(flights),
        tuple(pieces),
        tuple(states(f, p) for f in flights for p in f.pieces),
        outputs,
        tuple(data),
        output_noise(aircraft, data, outputs),
        tuple(b for b in BIASES if b in outputs),
        late,
        tuple(measured),
        tuple(ideal),
        servos=servos_of(aircraft, measured, ideal),
        timed=tuple(f.name for f in flights if f.name not in late),
    )


def output_noise(
    aircraft: Aircraft, measured: Sequence[FloatArray], outputs: Sequence[str]
) -> FloatArray:
    """Return the noise (m,) of measured outputs, from their samples and the aircraft's card."""
    stds = channel_noise(measured, outputs, aircraft.card.sensors.noise_std)
    return np.array([stds[c] for c in outputs])


def with_sensors_of(data: FlightData, aircraft: Aircraft) -> FlightData:
    """Return the data without active effects, with the accelerometers' position of an aircraft.

    An effect that moves the centre of gravity changes that position.
    """
    segments = tuple(replace(s, arm_m=aircraft.accelerometer_m) for s in data.segments)
    return replace(data, segments=segments, active=(), carriers={}, lower_bounds={})


def servos_of(
    aircraft: Aircraft, measured: Sequence[str], ideal: Sequence[str]
) -> dict[str, Actuator]:
    """Return the actuators of surfaces of which only commands were recorded.

    One without dynamics stands for an actuator that the XML lacks and `write_servo` can add.
    """
    servos = {
        surface: servo_of_surface(aircraft, surface)
        for surface in ("elevator", "aileron", "rudder")
        if surface not in (*measured, *ideal)
    }
    return {surface: servo for surface, servo in servos.items() if servo is not None}


@dataclass(frozen=True)
class StagedModels:
    """An aircraft as flights are simulated: ``model`` with its actuators, for replays, and
    ``direct_model`` without, for loads at given positions of the controls.
    """

    model: ReplayModel
    direct_model: ReplayModel


@contextlib.contextmanager
def stage_models(aircraft: Aircraft, data: FlightData) -> Iterator[StagedModels]:
    """Stage both copies of an aircraft for some flights; their folders are removed at the end."""
    with (
        ReplayFolder(aircraft, measured=data.positions, ideal=data.ideal) as model,
        ReplayFolder(aircraft, measured=data.positions, ideal=CONTROLS) as direct_model,
    ):
        yield StagedModels(model, direct_model)


def is_turbulent(data: FlightData, trajectory: Trajectory) -> bool:
    """Return whether a replay's residuals show turbulence.

    They do if they are coloured, no function of the motion, and present in quiet flight as well.
    """
    columns = [
        k for k, c in enumerate(data.outputs) if c[:2] in ("p_", "q_", "r_", "ax", "ay", "az")
    ]
    residual = [(z - y)[:, columns] for z, y in zip(data.measured, trajectory.outputs, strict=True)]
    return shows_process_noise(
        residual, [y[:, columns] for y in trajectory.outputs], data.noise[columns]
    )


def estimated_channels(data: FlightData) -> tuple[str, ...]:
    """Return the outputs that an autopilot's estimator computed in some flight."""
    estimates = {c for flight in data.flights for c in flight.record.metadata.estimates}
    return tuple(c for c in data.outputs if c in estimates)


def with_estimator_noise(data: FlightData, residual_rms: Mapping[str, float]) -> FloatArray:
    """Return the noise (m,) of the outputs, raised to ``residual_rms`` for an estimator's channels.

    A card states noise of sensors, not errors of an estimator.
    """
    guessed = estimated_channels(data)
    stated = zip(data.outputs, data.noise.tolist(), strict=True)
    return np.array([max(n, residual_rms.get(c, n)) if c in guessed else n for c, n in stated])


def with_card_noise(aircraft: Aircraft, data: FlightData) -> FlightData:
    """Return the data with the noise that the card states.

    In gusts the samples of an accelerometer overstate its noise. Channels of an estimator keep
    the noise of their samples.
    """
    stated, guessed = aircraft.card.sensors.noise_std, estimated_channels(data)
    card_noise = zip(data.outputs, data.noise.tolist(), strict=True)
    noise = np.array([n if c in guessed else stated.get(c, n) for c, n in card_noise])
    return replace(data, noise=noise)
