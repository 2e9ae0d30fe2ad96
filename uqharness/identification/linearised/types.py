"""What the stages of a refinement hand each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from sysid.aerodynamics.rigid_body import OUTPUTS as STEP_OUTPUTS
from sysid.arrays import FloatArray
from sysid.effects import Effect
from uqharness.replay import CONTROL_DELAY, UNSEEN, Flight, Segment
from uqharness.simulator import Actuator, servo_number


def in_dynamics(effect: Effect) -> bool:
    """Whether the effect belongs in the aircraft's XML; a sensor's does not move the aircraft."""
    return not (effect.subsystem or "").startswith(("sensor.", "record"))


def lateness(flight: str) -> str:
    """Name of the time [s] by which a flight's controls act after their rows: a simulation's half step, a hand that logged late."""
    return f"lateness/{flight}/{CONTROL_DELAY}"


def unseen(flight: str) -> str:
    """Name of the share of a control's jump that the accelerometers of its row have not seen."""
    return f"{UNSEEN}/{flight}"


@dataclass(frozen=True)
class Carrier:
    """Property of the simulation that an effect moves: name; absent: its value without the effect; servo, term: of a servo's lag or
    rate limit the servo as given, and which of the two it is."""

    name: str
    absent: float
    servo: Actuator | None = None
    term: str = ""

    @property
    def exact(self) -> bool:
        """Whether the property restores the aircraft as given, bit for bit: no number is a servo without a lag."""
        return self.servo is None or self.term != "lag" or self.servo.lag is not None

    def at(self, value: float) -> float:
        """The property where the effect has a value."""
        return (
            self.absent + value
            if self.servo is None
            else servo_number(self.servo, self.term, value)
        )


@dataclass(frozen=True)
class Setup:
    """Everything about the flights that does not change with the model's numbers.

    measured [(n, m)] outputs as logged; noise (m,); positions: surfaces whose positions the record has, ideal: controls that are
    passed straight through; late: flight -> sensors whose delay is estimated; timed: flights of which it is
    estimated how late the controls act (`lateness`); jumping: of which is estimated what is `unseen`; biased: channels;
    active: effects that the model being flown has, or that its sensors have; carriers: key -> carrier of those that have one;
    servos: actuators of the surfaces whose commands alone were recorded; limits: surface -> rate limits [deg/s] from and to which
    a slower servo's effect is read while it is no part of the model; zones: surface -> width [deg] of the dead zone by
    which one is; least: key -> value of an active rate limit's effect below which nothing changes any more;
    slopes: numbers that the active effects are written with (`writing.slopes.control_slopes`), none where none is
    """

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
    least: Mapping[str, float] = field(default_factory=dict)
    slopes: Mapping[str, float] = field(default_factory=dict)
    timed: tuple[str, ...] = ()
    jumping: tuple[str, ...] = ()

    @property
    def which(self) -> list[int]:
        """Columns of the replay's outputs that are compared."""
        return [STEP_OUTPUTS.index(c) for c in self.outputs]

    def properties(self, point: Point) -> dict[str, float]:
        """Every property that is set at a point: its values, and those of the active effects."""
        carried = {
            carrier.name: carrier.at(point.effects.get(key, 0.0))
            for key, carrier in self.carriers.items()
        }
        return {**point.values, **carried}

    @property
    def held(self) -> list[str]:
        """Keys of active effects that JSBSim reads once (mass, dead zones): no step moves them."""
        return [e.key for e in self.active if e.key not in self.carriers and in_dynamics(e)]

    @property
    def nuisance(self) -> tuple[str, ...]:
        """Names of gyro biases and delays, estimated beside parameters and effects."""
        names = [f"bias/{f.name}/{c}" for f in self.flights for c in self.biased]
        names += [*(lateness(f) for f in self.timed), *(unseen(f) for f in self.jumping)]
        return (*names, *(f"delay/{f}/{s}" for f, sensors in self.late.items() for s in sensors))


@dataclass(frozen=True)
class Point:
    """Values of properties and nuisance by name; start (9,) of every segment; effects: values of the active effects by key."""

    values: Mapping[str, float]
    nuisance: Mapping[str, float]
    starts: tuple[FloatArray, ...]
    effects: Mapping[str, float] = field(default_factory=dict)


def late_by(point: Point, flight: str) -> float:
    """How late [s] a flight's controls act at a point."""
    return point.nuisance.get(lateness(flight), 0.0)


def unseen_share(point: Point, flight: str) -> float:
    """The share of a jump that is unseen at a point."""
    return point.nuisance.get(unseen(flight), 0.0)


@dataclass(frozen=True)
class Flown:
    """Replays at a point: outputs [(n, m)] with biases and delays, reference states [(n, 8)], cost: sum of squares over noise."""

    point: Point
    outputs: list[FloatArray]
    x: list[FloatArray]
    height: list[FloatArray]
    cost: float
