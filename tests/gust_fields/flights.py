"""Flights of the hidden effects' own simulator in any air."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sysid.arrays import FloatArray
from sysid.record import FlightRecord
from tests.gust_fields.fields import BODY, Air, Setting, air_of, mean_wind, to_earth
from tests.hidden_effects.flights import NOISE, Flight, _record, substeps
from tests.hidden_effects.gusts import NODE_S
from tests.hidden_effects.manoeuvres import Pilot
from tests.hidden_effects.motion import Air as AirData
from tests.hidden_effects.motion import Model, integrate, trim

INSTRUMENTS = "V_mps", "phi_rad", "theta_rad", "h_m", "p_radps", "q_radps", "r_radps"
"""What a pilot reads with the noise of the record; without a damper not the rates."""


@dataclass
class Breath:
    """Writes the air's nodes of the next interval before it is flown, at the state as it will be."""

    pilot: Pilot
    air: Air
    in_body: bool
    nodes: FloatArray
    away: FloatArray
    dt_s: float

    def __call__(self, k: int, air: AirData, x: FloatArray) -> FloatArray:
        self.write(k * self.dt_s, x[:, 0], air.dot[:, 0])
        self.away[k] = self.air(k * self.dt_s, x[:, 0])[1]
        return self.pilot(k, air, x)

    def write(self, time_s: float, state: FloatArray, rate: FloatArray) -> None:
        """Nodes from a time to one behind the next sample."""
        first = int(np.ceil(time_s / NODE_S - 1e-9))
        for node in range(first, min(first + int(self.dt_s / NODE_S) + 2, len(self.nodes))):
            present = state + (node * NODE_S - time_s) * rate
            gust, _ = self.air(node * NODE_S, present)
            if self.in_body:
                level = to_earth(np.array([present[6], present[7], 0.0]))
                gust = np.concatenate([level @ gust[:3], level @ gust[3:]])
            self.nodes[node, :, 0] = gust


def fly_in(
    flight: Flight,
    family: str,
    setting: Setting,
    ground_std_mps: float | None = None,
    pilots: type[Pilot] = Pilot,
) -> FlightRecord:
    """Fly one flight in the air of a family and return its record, with ground velocities of that
    noise if it is given.
    """
    card = flight.card
    dt = 1.0 / card.rate_hz
    n = round(card.seconds * card.rate_hz)
    model = Model([flight.airframe], [flight.effects], [flight.drive])
    x0, s0 = trim(model, np.array([card.V_mps]), np.array([card.h_m]))
    x0[:3, 0] += to_earth(x0[6:9, 0]).T @ mean_wind(family, setting)
    rng = np.random.default_rng([card.seed, 1])
    noise = {name: card.noise * std * rng.standard_normal(n) for name, std in NOISE.items()}
    read = np.column_stack([noise[c] for c in INSTRUMENTS])
    constant = s0 + np.sign(s0) * 0.5 * model.deadband
    pilot = pilots([card], x0, constant, read[:, :, None])
    nodes = np.zeros((round(card.seconds / NODE_S) + 5, 6, 1))
    breath = Breath(pilot, air_of(family, setting), family in BODY, nodes, np.zeros((n, 3)), dt)
    breath.write(0.0, x0[:, 0], np.zeros(12))
    history = integrate(model, x0, constant, n, dt, substeps(dt), breath, nodes)
    # A vane elsewhere meets other air.
    V, offset = history.V[:, 0], breath.away
    history.alpha[:, 0] -= offset[:, 2] / V
    history.beta[:, 0] -= offset[:, 1] / V
    record = _record(replace(flight, card=replace(card, w20_kt=0.0)), history, 0, noise, dt)
    if ground_std_mps is None:
        return record
    velocity = np.gradient(history.x[:, 9:12, 0], dt, axis=0)
    velocity += ground_std_mps * rng.standard_normal(velocity.shape)
    names = ("vn_mps", "ve_mps", "vd_mps")
    return record.with_columns(dict(zip(names, velocity.T, strict=True)))
