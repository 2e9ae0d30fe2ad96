"""What the stages of a refinement hand each other."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace

import numpy as np

from sysid.aerodynamics.rigid_body import OUTPUTS as STEP_OUTPUTS
from sysid.arrays import FloatArray
from sysid.effects import Effect
from sysid.estimation import channel_noise, shows_process_noise
from uqharness.errors import BadInputError
from uqharness.identification.replay_fit import BIASES, OUTPUTS
from uqharness.replay import (
    CONTROL_DELAY,
    CONTROLS,
    SENSOR_OF,
    UNSEEN,
    Flight,
    ReplayFolder,
    Segment,
    measured_outputs,
    states,
)
from uqharness.replay.flights import segments
from uqharness.simulator import Actuator, Aircraft, servo_number
from uqharness.simulator.actuators import actuators


def in_dynamics(effect: Effect) -> bool:
    """Whether the effect belongs in the aircraft's XML; a sensor's does not move the aircraft."""
    return not (effect.subsystem or "").startswith(("sensor.", "record"))


def lateness(flight: str) -> str:
    """Name of the time [s] by which a flight's controls act after their rows: a simulation's half
    step, a hand that logged late.
    """
    return f"lateness/{flight}/{CONTROL_DELAY}"


def unseen(flight: str) -> str:
    """Name of the share of a control's jump that the accelerometers of its row have not seen."""
    return f"{UNSEEN}/{flight}"


@dataclass(frozen=True)
class Carrier:
    """Property of the simulation that an effect moves: name; absent: its value without the effect;
    servo, term: of a servo's lag or rate limit the servo as given, and which of the two it is."""

    name: str
    absent: float
    servo: Actuator | None = None
    term: str = ""

    @property
    def exact(self) -> bool:
        """Whether the property restores the aircraft as given, bit for bit: no number is a servo
        without a lag.
        """
        return self.servo is None or self.term != "lag" or self.servo.lag is not None

    def at(self, value: float) -> float:
        """The property where the effect has a value."""
        return (
            self.absent + value
            if self.servo is None
            else servo_number(self.servo, self.term, value)
        )


@dataclass(frozen=True)
class FlightData:
    """Everything about the flights that does not change with the model's numbers.

    measured [(n, m)] outputs as logged; noise (m,); positions: surfaces whose positions the
    record has, ideal: controls that are passed straight through; late: flight -> sensors whose
    delay is estimated; timed: flights of which it is estimated how late the controls act
    (`lateness`); jumping: of which is estimated what is `unseen`; biased: channels; active:
    effects that the model being flown has, or that its sensors have; carriers: key -> carrier of
    those that have one; servos: actuators of the surfaces whose commands alone were recorded;
    limits: surface -> rate limits [deg/s] from and to which a slower servo's effect is read while
    it is no part of the model; zones: surface -> width [deg] of the dead zone by which one is;
    lower_bounds: key -> value of an active rate limit's effect below which nothing changes any
    more; slopes: numbers that the active effects are written with
    (`writing.slopes.control_slopes`), none where none is"""

    flights: tuple[Flight, ...]
    segments: tuple[Segment, ...]
    channels: tuple[Mapping[str, FloatArray], ...]
    outputs: tuple[str, ...]
    measured: tuple[FloatArray, ...]
    noise: FloatArray
    biased: tuple[str, ...]
    late: Mapping[str, Sequence[str]]
    positions: tuple[str, ...] = ()
    ideal: tuple[str, ...] = ()
    active: tuple[Effect, ...] = ()
    carriers: Mapping[str, Carrier] = field(default_factory=dict)
    servos: Mapping[str, Actuator] = field(default_factory=dict)
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    zones: Mapping[str, float] = field(default_factory=dict)
    lower_bounds: Mapping[str, float] = field(default_factory=dict)
    slopes: Mapping[str, float] = field(default_factory=dict)
    timed: tuple[str, ...] = ()
    jumping: tuple[str, ...] = ()

    @property
    def output_rows(self) -> list[int]:
        """Columns of the replay's outputs that are compared."""
        return [STEP_OUTPUTS.index(c) for c in self.outputs]

    def properties(self, point: ModelState) -> dict[str, float]:
        """Every property that is set at a point: its values, and those of the active effects."""
        by_carrier = {
            carrier.name: carrier.at(point.effects.get(key, 0.0))
            for key, carrier in self.carriers.items()
        }
        return {**point.values, **by_carrier}

    @property
    def fixed_effects(self) -> list[str]:
        """Keys of active effects that JSBSim reads once (mass, dead zones): no step moves them."""
        return [e.key for e in self.active if e.key not in self.carriers and in_dynamics(e)]

    @property
    def nuisance(self) -> tuple[str, ...]:
        """Names of gyro biases and delays, estimated beside parameters and effects."""
        names = [f"bias/{f.name}/{c}" for f in self.flights for c in self.biased]
        names += [*(lateness(f) for f in self.timed), *(unseen(f) for f in self.jumping)]
        return (*names, *(f"delay/{f}/{s}" for f, sensors in self.late.items() for s in sensors))


@dataclass(frozen=True)
class ModelState:
    """Values of properties and nuisance by name; start (9,) of every segment; effects: values of
    the active effects by key.
    """

    values: Mapping[str, float]
    nuisance: Mapping[str, float]
    starts: tuple[FloatArray, ...]
    effects: Mapping[str, float] = field(default_factory=dict)


def late_by(point: ModelState, flight: str) -> float:
    """How late [s] a flight's controls act at a point."""
    return point.nuisance.get(lateness(flight), 0.0)


def unseen_share(point: ModelState, flight: str) -> float:
    """The share of a jump that is unseen at a point."""
    return point.nuisance.get(unseen(flight), 0.0)


@dataclass(frozen=True)
class Trajectory:
    """Replays at a point: outputs [(n, m)] with biases and delays, reference states [(n, 8)], cost:
    sum of squares over noise.
    """

    point: ModelState
    outputs: list[FloatArray]
    x: list[FloatArray]
    height: list[FloatArray]
    cost: float


# What a refinement is made of before anything is chosen: flights cut and judged, aircraft
# staged, candidates listed.


def make_setup(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    measured: Sequence[str],
    ideal: Sequence[str] = (),
) -> FlightData:
    """Segments, measured outputs and noise of some flights."""
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
    """(m,) noise of outputs [(n, m)] by their own samples and the aircraft's card."""
    stds = channel_noise(measured, outputs, aircraft.card.sensors.noise_std)
    return np.array([stds[c] for c in outputs])


def with_sensors_of(setup: FlightData, aircraft: Aircraft) -> FlightData:
    """The same flights, without effects that are active, with the accelerometers where this
    aircraft has them: a centre of gravity that moves leaves them behind."""
    segments = tuple(replace(s, arm_m=aircraft.accelerometer_m) for s in setup.segments)
    return replace(setup, segments=segments, active=(), carriers={}, lower_bounds={})


def servos_of(
    aircraft: Aircraft, measured: Sequence[str], ideal: Sequence[str]
) -> dict[str, Actuator]:
    """Actuators of the surfaces that the flights know by their commands alone; none where the XML
    has none by that name.
    """
    out: dict[str, Actuator] = {}
    for surface in ("elevator", "aileron", "rudder"):
        if surface in aircraft.card.inputs and surface not in (*measured, *ideal):
            with contextlib.suppress(BadInputError):
                out |= actuators(aircraft, [surface])
    return out


class StagedModels(ExitStack):
    """An aircraft staged for replay, as it flies and with every control straight through.

    A context.
    """

    def __init__(self, aircraft: Aircraft, setup: FlightData) -> None:
        super().__init__()
        self._folders = [
            ReplayFolder(aircraft, measured=setup.positions, ideal=ideal)
            for ideal in (setup.ideal, CONTROLS)
        ]

    def __enter__(self) -> StagedModels:
        self.model, self.direct_model = map(self.enter_context, self._folders)
        return self


def turbulent(setup: FlightData, trajectory: Trajectory) -> bool:
    """Whether what the replay leaves is coloured, no function of the motion, and there in quiet
    flight as well.
    """
    columns = [
        k for k, c in enumerate(setup.outputs) if c[:2] in ("p_", "q_", "r_", "ax", "ay", "az")
    ]
    residual = [
        (z - y)[:, columns] for z, y in zip(setup.measured, trajectory.outputs, strict=True)
    ]
    return shows_process_noise(
        residual, [y[:, columns] for y in trajectory.outputs], setup.noise[columns]
    )


def estimated_channels(setup: FlightData) -> tuple[str, ...]:
    """Outputs that no sensor measured in some flight, the autopilot's estimator computed them."""
    estimates = {c for flight in setup.flights for c in flight.record.metadata.estimates}
    return tuple(c for c in setup.outputs if c in estimates)


def with_estimator_noise(setup: FlightData, residual_rms: Mapping[str, float]) -> FloatArray:
    """(m,) noise of the setup, but for channels that an estimator computed: there, the
    ``residual_rms`` of a fit where it is larger, for no card knows an estimator's error."""
    guessed = estimated_channels(setup)
    stated = zip(setup.outputs, setup.noise.tolist(), strict=True)
    return np.array([max(n, residual_rms.get(c, n)) if c in guessed else n for c, n in stated])


def setup_in_gusts(aircraft: Aircraft, setup: FlightData) -> FlightData:
    """The same with the card's sensor noise where it says one: third differences of an
    accelerometer see gusts as noise. The card says nothing of what an estimator computed."""
    stated, guessed = aircraft.card.sensors.noise_std, estimated_channels(setup)
    card_noise = zip(setup.outputs, setup.noise.tolist(), strict=True)
    noise = np.array([n if c in guessed else stated.get(c, n) for c, n in card_noise])
    return replace(setup, noise=noise)
