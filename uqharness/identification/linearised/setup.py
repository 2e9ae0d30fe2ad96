"""What a refinement is made of before anything is chosen: flights cut and judged, aircraft staged, candidates listed."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace

import numpy as np

from sysid.arrays import FloatArray
from sysid.estimation import channel_noise, process_noise_shown
from uqharness.errors import BadInputError
from uqharness.identification.channels import BIASES, OUTPUTS
from uqharness.identification.linearised.types import Flown, Setup
from uqharness.replay import CONTROLS, SENSOR_OF, Flight, ReplayFolder, measured_outputs, states
from uqharness.replay.flights import segments
from uqharness.simulator import Actuator, Aircraft
from uqharness.simulator.actuators import actuators


def make_setup(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    measured: Sequence[str],
    ideal: Sequence[str] = (),
) -> Setup:
    """Segments, measured outputs and noise of some flights."""
    arm = aircraft.accelerometer_m
    cut = [s for f in flights for s in segments(f, measured, arm)]
    outputs = tuple(
        c for c in OUTPUTS if any(c in f.record and np.isfinite(f.record[c]).any() for f in flights)
    )
    data = [b for f in flights for b in measured_outputs(f, outputs)]
    late = {
        f.name: list(dict.fromkeys(SENSOR_OF.get(c, c) for c in outputs))
        for f in flights
        if f.record.metadata.native_hz
    }
    return Setup(
        tuple(flights),
        tuple(cut),
        tuple(states(f, p) for f in flights for p in f.pieces),
        outputs,
        tuple(data),
        known_noise(aircraft, data, outputs),
        tuple(b for b in BIASES if b in outputs),
        late,
        tuple(measured),
        tuple(ideal),
        servos=servos_of(aircraft, measured, ideal),
        timed=tuple(f.name for f in flights if f.name not in late),
    )


def known_noise(
    aircraft: Aircraft, measured: Sequence[FloatArray], outputs: Sequence[str]
) -> FloatArray:
    """(m,) noise of outputs [(n, m)] by their own samples and the aircraft's card."""
    known = channel_noise(measured, outputs, aircraft.card.sensors.noise_std)
    return np.array([known[c] for c in outputs])


def with_sensors_of(setup: Setup, aircraft: Aircraft) -> Setup:
    """The same flights, without effects that are active, with the accelerometers where this aircraft has them: a centre of gravity
    that moves leaves them behind."""
    segments = tuple(replace(s, arm_m=aircraft.accelerometer_m) for s in setup.segments)
    return replace(setup, segments=segments, active=(), carriers={}, least={})


def servos_of(
    aircraft: Aircraft, measured: Sequence[str], ideal: Sequence[str]
) -> dict[str, Actuator]:
    """Actuators of the surfaces that the flights know by their commands alone; none where the XML has none by that name."""
    out: dict[str, Actuator] = {}
    for surface in ("elevator", "aileron", "rudder"):
        if surface in aircraft.card.inputs and surface not in (*measured, *ideal):
            with contextlib.suppress(BadInputError):
                out |= actuators(aircraft, [surface])
    return out


class Bench(ExitStack):
    """An aircraft staged for replay, as it flies and with every control straight through. A context."""

    def __init__(self, aircraft: Aircraft, setup: Setup) -> None:
        super().__init__()
        self._folders = [
            ReplayFolder(aircraft, measured=setup.positions, ideal=ideal)
            for ideal in (setup.ideal, CONTROLS)
        ]

    def __enter__(self) -> Bench:
        self.model, self.straight = map(self.enter_context, self._folders)
        return self


def turbulent(setup: Setup, flown: Flown) -> bool:
    """Whether what the replay leaves is coloured, no function of the motion, and there in quiet flight as well."""
    columns = [
        k for k, c in enumerate(setup.outputs) if c[:2] in ("p_", "q_", "r_", "ax", "ay", "az")
    ]
    residual = [(z - y)[:, columns] for z, y in zip(setup.measured, flown.outputs, strict=True)]
    return process_noise_shown(
        residual, [y[:, columns] for y in flown.outputs], setup.noise[columns]
    )


def estimated_channels(setup: Setup) -> tuple[str, ...]:
    """Outputs that no sensor measured in some flight, the autopilot's estimator computed them."""
    told = {c for flight in setup.flights for c in flight.record.metadata.estimates}
    return tuple(c for c in setup.outputs if c in told)


def noise_left(setup: Setup, left: Mapping[str, float]) -> FloatArray:
    """(m,) noise of the setup, but for channels that an estimator computed: there, the rms of what a fit has ``left`` of them where
    it is larger, for no card knows an estimator's error."""
    guessed = estimated_channels(setup)
    given = zip(setup.outputs, setup.noise.tolist(), strict=True)
    return np.array([max(n, left.get(c, n)) if c in guessed else n for c, n in given])


def setup_in_gusts(aircraft: Aircraft, setup: Setup) -> Setup:
    """The same with the card's sensor noise where it says one: third differences of an accelerometer see gusts as noise. The card
    says nothing of what an estimator computed."""
    stated, guessed = aircraft.card.sensors.noise_std, estimated_channels(setup)
    given = zip(setup.outputs, setup.noise.tolist(), strict=True)
    noise = np.array([n if c in guessed else stated.get(c, n) for c, n in given])
    return replace(setup, noise=noise)
