"""The study's flights: one to make bounds from, three to judge them by, each without noise and with
any amount of it.

A flight is flown without sensor noise, so the autopilot hears none; noise of Table 2.1 is added to
the record afterwards. Each noisy record so has a noise-free twin, and in still air all seeds share
one flight. The true model error is what the flown aircraft's coefficients are at the noise-free
states minus what the model's are there, behind the filter that residuals pass. The effect of the
air's rotation on the flown aircraft is therefore no model error.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from sysid.aerodynamics import (
    AirPiece,
    Cutoffs,
    Residuals,
    air_pieces,
    with_channels_of,
    with_sensor_noise,
    without_air_rotation,
)
from sysid.aerodynamics.residuals import PieceNoise
from sysid.estimation import NoiseSize
from sysid.model_form.fit import with_noise
from sysid.record import FlightRecord
from uqharness.errors import BadInputError
from uqharness.files import scratch_folder
from uqharness.flight.recorded import recorded_flight, seeded_spec
from uqharness.flight.spec import FlightSpec
from uqharness.identification.bounds import noise_sizes
from uqharness.replay.flights import Flight, measured_surfaces, prepare
from uqharness.replay.residuals import (
    ReplayPair,
    cut_for_residuals,
    flight_residuals,
    prediction_of,
)
from uqharness.simulator.aircraft import Aircraft, find_aircraft
from uqharness.simulator.mission import read_script
from uqharness.simulator.own_mission import PLANS, THREE_TWO_ONE_ONE, Manoeuvre, Plan, script

MODEL, TRUTH = "espaaro", "espaaro_truth"
CUTOFFS = Cutoffs()
SPEEDS = (18.5, 21.0, 27.0)
BOUNDS = Plan(
    "study-bounds",
    "model-form bounds from 16.5 to 27.5 m/s",
    16.5,
    (
        Manoeuvre("pull-up, 16.5 m/s", "elevator", -8.0, 0.9, recovery_s=8.0, speed_mps=18.0),
        Manoeuvre("3-2-1-1, 18 m/s", "elevator", -6.0, 0.4, THREE_TWO_ONE_ONE),
        Manoeuvre("yaw doublet, 18 m/s", "rudder", -8.5, 0.9),
        Manoeuvre(
            "roll doublet, 18 m/s",
            "aileron",
            -10.0,
            0.6,
            rest_s=2.0,
            recovery_s=8.0,
            speed_mps=22.5,
        ),
        Manoeuvre("pitch doublet, 22.5 m/s", "elevator", -5.0, 0.5),
        Manoeuvre("throttle doublet, 22.5 m/s", "throttle", -22.0, 1.6, rest_s=1.5),
        Manoeuvre("yaw doublet, 22.5 m/s", "rudder", 8.0, 0.7, recovery_s=10.0, speed_mps=27.5),
        Manoeuvre("roll doublet, 27.5 m/s", "aileron", 8.0, 0.5, rest_s=2.0),
        Manoeuvre("pitch doublet, 27.5 m/s", "elevator", 3.5, 0.4),
        Manoeuvre("yaw doublet, 27.5 m/s", "rudder", -7.0, 0.7, recovery_s=1.0),
    ),
    settle_s=12.0,
)
"""As flight-bounds, over a wider range of speeds; the pull-up reaches 11 deg of incidence, where
lift separates."""
_CHOSEN = (0, 1, 2, 3, 6)  # of the validation flight's manoeuvres: one of each kind


@dataclass(frozen=True)
class Case:
    """The aircraft that flies, and its air."""

    name: str
    aircraft: str
    turbulence: str


CASES = (
    Case("nominal-calm", MODEL, "none"),
    Case("nominal-light", MODEL, "light"),
    Case("truth-calm", TRUTH, "none"),
    Case("truth-light", TRUTH, "light"),
)


def validation_plan(speed_mps: float) -> Plan:
    """Return five manoeuvres of the validation flight at one speed; sizes go down with it, so that
    load factors stay alike."""
    plan = next(p for p in PLANS if p.name == "flight-validation")
    manoeuvres = []
    for m in (plan.manoeuvres[k] for k in _CHOSEN):
        name, size = (
            f"{m.name.partition(',')[0]}, {speed_mps:g} m/s",
            round(m.size * 20.0 / speed_mps, 1),
        )
        manoeuvres.append(replace(m, name=name, size=size, recovery_s=5.0, speed_mps=None))
    name, moved = f"study-validation-{speed_mps:g}", tuple(manoeuvres)
    return replace(plan, name=name, speed_mps=speed_mps, manoeuvres=moved, settle_s=10.0)


PLANS_FLOWN = (BOUNDS, *(validation_plan(speed) for speed in SPEEDS))


@dataclass(frozen=True)
class Quiet:
    """A noise-free flight.

    record, measured  as flown, and surfaces with measured positions true              residuals
    whose delta is the true model error, states noise-free, both filtered unit              the same
    pieces with the noise that Table 2.1's figures give air               pieces from which the
    air's rotation follows
    """

    record: FlightRecord
    measured: tuple[str, ...]
    true: Residuals
    unit: Residuals
    air: tuple[AirPiece, ...]


def quiet_flight(case: Case, plan: Plan, seed: int) -> Quiet:
    """Fly a plan once without sensor noise. Raises BadInputError when the flight does not end
    well."""
    # In still air all seeds share one flight.
    return _fly(case.aircraft, case.turbulence, plan, 0 if case.turbulence == "none" else seed)


@lru_cache(maxsize=16)
def _fly(aircraft: str, turbulence: str, plan: Plan, seed: int) -> Quiet:
    record = _record(find_aircraft(aircraft), turbulence, plan, seed)
    measured = measured_surfaces([record])
    flight = _flight(plan.name, record, measured)
    model = find_aircraft(MODEL)
    with model_pair(measured) as pair:
        arm = model.accelerometer_m
        residuals = flight_residuals(pair, flight, arm, CUTOFFS)
        air = tuple(air_pieces(flight.record, flight.pieces, pair.of(flight), CUTOFFS.airspeed_hz))
        flight_of = (flight.record, flight.pieces, pair.of(flight))
        unit = with_sensor_noise(residuals, *flight_of, arm, table_noise())
    deltas = [np.zeros_like(p.delta) for p in residuals.pieces]
    if aircraft != MODEL:
        with prediction_of(find_aircraft(aircraft), measured) as pair:
            other = flight_residuals(pair, flight, arm, CUTOFFS)
        # Each is the measured coefficient minus the prediction of one of the two aircraft.
        deltas = [a.delta - b.delta for a, b in zip(residuals.pieces, other.pieces, strict=True)]
    pieces = (replace(p, delta=d) for p, d in zip(residuals.pieces, deltas, strict=True))
    return Quiet(record, measured, replace(residuals, pieces=tuple(pieces)), unit, air)


def _record(aircraft: Aircraft, turbulence: str, plan: Plan, seed: int) -> FlightRecord:
    with scratch_folder("model-form") as scratch:
        path = scratch.path / f"{plan.name}.xml"
        path.write_text(script(plan), encoding="utf-8")
        read = read_script(path)
        spec = FlightSpec(
            aircraft.folder, path, read.end_s, turbulence=turbulence, record_rate_hz=50.0
        )
        table, recorded = recorded_flight(aircraft, read, seeded_spec(spec, seed))
        if recorded.status != "ok":
            raise BadInputError(
                f"{plan.name}, seed {seed}: the flight did not end well: {recorded.reason}"
            )
        copy = scratch.path / "record.parquet"
        table.to_parquet(copy)
        return FlightRecord.read(copy)


def _flight(name: str, record: FlightRecord, measured: tuple[str, ...]) -> Flight:
    return cut_for_residuals(prepare(name, record, measured), measured)


def model_pair(measured: tuple[str, ...]) -> AbstractContextManager[ReplayPair]:
    """Open the model."""
    return prediction_of(find_aircraft(MODEL), measured)


def table_noise() -> dict[str, float]:
    """Return standard deviations of Table 2.1 by channel, as in the model's card; these are the
    true sizes throughout."""
    return {c: s for c, s in find_aircraft(MODEL).card.sensors.noise_std.items() if np.isfinite(s)}


@dataclass(frozen=True)
class Noisy:
    """A flight's measured residuals and the noise estimated from its samples, by the factor of the
    card's error and channel."""

    residuals: Residuals
    unit: Residuals
    air: tuple[AirPiece, ...]
    sizes: Mapping[float, Mapping[str, NoiseSize]]

    def knowing(self, sizes: Mapping[str, NoiseSize]) -> Residuals:
        """Return the residuals with noise of these sizes, without the air's rotation; gains are
        those of the noise-free flight."""
        pieces = []
        for piece, twin in zip(self.residuals.pieces, self.unit.pieces, strict=True):
            assert twin.noise is not None
            pieces.append(replace(piece, noise=_resized(twin.noise, sizes)))
        noisy = replace(self.residuals, pieces=tuple(pieces))
        arm = find_aircraft(MODEL).accelerometer_m
        return without_air_rotation(
            noisy, self.air, arm, {c: size.std for c, size in sizes.items()}
        )[0]

    def exactly(self) -> Residuals:
        """Return the residuals with the true noise, known exactly."""
        return self.knowing({c: NoiseSize(s, 0.0) for c, s in table_noise().items()})


def noisy_twin(
    calm: Quiet, pair: ReplayPair, stream: tuple[int, ...], card_factors: tuple[float, ...]
) -> Noisy:
    """Add noise of Table 2.1 from the stream to a flight, and force the measured states upon the
    model."""
    std = table_noise()
    channels = {c: calm.record[c] for c in std if c in calm.record}
    record = calm.record.with_columns(with_noise(channels, std, np.random.default_rng(stream)))
    flight = _flight("noisy", record, calm.measured)
    residuals = flight_residuals(pair, flight, find_aircraft(MODEL).accelerometer_m, CUTOFFS)
    air = tuple(with_channels_of(calm.air, flight.record, flight.pieces, CUTOFFS.airspeed_hz))
    sizes = {
        f: noise_sizes(flight, {c: f * s for c, s in std.items()}, CUTOFFS) for f in card_factors
    }
    return Noisy(residuals, calm.unit, air, sizes)


def _resized(noise: PieceNoise, sizes: Mapping[str, NoiseSize]) -> PieceNoise:
    """Scale noise of Table 2.1 to other sizes: gains are proportional to them."""
    std, passages = table_noise(), []
    for p in (p for p in noise.passages if p.channel in sizes):
        size = sizes[p.channel]
        passages.append(
            replace(p, gain=p.gain * (size.std / std[p.channel]), relative_std=size.relative_std)
        )
    states = {c: (sizes[c].std, weights) for c, (_, weights) in noise.states.items() if c in sizes}
    return PieceNoise(tuple(passages), states, noise.n)
