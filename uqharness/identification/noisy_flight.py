"""What a flight's residual coefficients hold beside the model's error: noise of its sensors, and the air's own rotation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.aerodynamics import (
    AirFound,
    AirPiece,
    Cutoffs,
    Residuals,
    air_pieces,
    offset_records,
    with_sensor_noise,
    without_air_rotation,
)
from sysid.estimation import NoiseSize, noise_size
from sysid.model_form import NOISY
from uqharness.replay import Flight, ReplayPair
from uqharness.simulator import Aircraft

VANES = ("alpha_rad", "beta_rad")


def noise_sizes(
    flight: Flight, stated: Mapping[str, float], cutoffs: Cutoffs
) -> dict[str, NoiseSize]:
    """White noise of each channel: what the flight's samples show above the filter's cut-off, the card's figure as prior.

    stated: channel -> standard deviation that the card gives.
    """
    record = flight.record
    out = {}
    for name in NOISY:
        if name not in record:
            continue
        pieces = [np.asarray(record[name][p.rows], dtype=float) for p in flight.pieces]
        found = noise_size(
            [x for x in pieces if np.isfinite(x).all()],
            record.dt_s,
            cutoffs.all_hz,
            stated.get(name),
        )
        if found is not None:
            out[name] = found
    return out


@dataclass(frozen=True)
class NoisyFlight:
    """A flight's residuals with the noise that its own sensors have put in, and what tells of the air's rotation.

    std   channel -> of its noise        air   none where alpha or beta come from an estimator, which feels no gusts
    """

    residuals: Residuals
    std: Mapping[str, float]
    air: Sequence[AirPiece] | None
    arm_m: tuple[float, ...]

    @staticmethod
    def of(
        pair: ReplayPair, flight: Flight, residuals: Residuals, aircraft: Aircraft
    ) -> NoisyFlight:
        """Asks the model for what noise and rotation would change."""
        sizes = noise_sizes(flight, aircraft.card.sensors.noise_std, residuals.cutoffs)
        std = {c: found.std for c, found in sizes.items()}
        # Rates moved by noise's probe and by rotation's are the same states: asked once.
        model, arm = pair.around(flight), tuple(aircraft.accelerometer_m)
        pair.ahead_near(flight, offset_records(flight.record, residuals.cutoffs), flight.pieces)
        noisy = with_sensor_noise(
            residuals,
            flight.record,
            flight.pieces,
            model,
            arm,
            std,
            {c: found.spread for c, found in sizes.items()},
        )
        felt = not set(VANES) & set(flight.record.metadata.estimates)
        air = (
            air_pieces(flight.record, flight.pieces, model, residuals.cutoffs.airspeed_hz)
            if felt
            else None
        )
        return NoisyFlight(noisy, std, air, arm)

    def in_still_air(self, residuals: Residuals) -> tuple[Residuals, AirFound | None]:
        """Residuals of the flight behind any filter, with noise, without the rotation of the air."""
        return (
            (residuals, None)
            if self.air is None
            else without_air_rotation(residuals, self.air, self.arm_m, self.std)
        )


def noisy_residuals(
    pair: ReplayPair, flight: Flight, residuals: Residuals, aircraft: Aircraft
) -> Residuals:
    """A flight's residuals with the noise of its sensors and of the air's rolling, without the air's rotation."""
    noisy = NoisyFlight.of(pair, flight, residuals, aircraft)
    return noisy.in_still_air(noisy.residuals)[0]


def said_of_air(flight: Flight, air: AirFound) -> str:
    """What was taken for the air's."""
    return (
        f"{flight.name}: {100.0 * air.share:.0f} ± {100.0 * air.std:.0f} % of the rotation that frozen gusts have is in the "
        "residuals; it is the air's, not the model's, and was taken out"
    )
