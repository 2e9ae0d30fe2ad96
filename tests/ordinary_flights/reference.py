"""Ordinary flights of the reference simulator, in air of any kind: turns held by a pilot's loops.

The truth is the E-SPAARO with derivatives changed by up to a half, so that the published model is
a wrong start. Forces, servos, sensors and air are those of `tests.hidden_effects`, none of them
JSBSim's; servos lag and the record has commands alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sysid.arrays import FloatArray
from sysid.record import FlightRecord
from tests.gust_fields.fields import Setting
from tests.gust_fields.flights import fly_in
from tests.helpers.sixdof import TABLE_2_6, Airframe
from tests.hidden_effects.flights import Flight
from tests.hidden_effects.manoeuvres import Card, Manoeuvre, Pilot
from tests.hidden_effects.motion import Air

HEIGHT_M, TAIL_M, GROUND_STD_MPS = 80.0, 1.6, 0.1
CHANGE = 0.4
"""Largest change of a derivative, as a logarithm."""
YAW_GAIN_DEG_S, WASHOUT_S, STEP_S = 12.0, 3.0, 0.02


class DampedPilot(Pilot):
    """A pilot whose loops damp all rates that the gyros measure, so that they answer the gusts."""

    slow = 0.0

    def __call__(self, k: int, air: Air, x: FloatArray) -> FloatArray:
        """Return the commands (4, 1) of sample k."""
        measured = x.copy()
        measured[3:6] += self.noise[k, 4:]
        out = super().__call__(k, air, measured)
        self.slow += STEP_S / WASHOUT_S * (float(measured[5, 0]) - self.slow)
        out[2] += np.round(YAW_GAIN_DEG_S * (measured[5] - self.slow), 2)
        return out


def airframe(seed: int) -> Airframe:
    """Return the truth of a seed."""
    rng = np.random.default_rng([seed, 41])
    factor = np.exp(rng.uniform(-CHANGE, CHANGE, len(TABLE_2_6)))
    changed = {
        name: value * (1.0 if name.endswith("_0") else f)
        for (name, value), f in zip(TABLE_2_6.items(), factor, strict=True)
    }
    return Airframe(coefficients=changed)


def fly_reference(
    family: str, seed: int, seconds: float, w20_kt: float
) -> tuple[FlightRecord, Mapping[str, float]]:
    """Fly turns of 12 to 25 s in the air of a family; return record and true derivatives."""
    rng = np.random.default_rng([seed, 42])
    legs, time_s = [], 5.0
    while time_s < seconds - 5.0:
        length = rng.uniform(12.0, 25.0)
        bank = float(rng.choice([-30.0, -18.0, 0.0, 18.0, 30.0]))
        legs.append(Manoeuvre("turn", time_s, length - 1.0, bank_deg=bank, hands_off=False))
        time_s += length
    card = Card(22.0, tuple(legs), seed, seconds, h_m=HEIGHT_M)
    truth = airframe(seed)
    setting = Setting(card.V_mps, HEIGHT_M, w20_kt, truth.b, TAIL_M, seconds, seed)
    record = fly_in(Flight(card, truth), family, setting, GROUND_STD_MPS, DampedPilot)
    columns = {n: v for n, v in record.columns.items() if n != "manoeuvre"}
    rates = dict.fromkeys(columns, card.rate_hz)
    metadata = replace(record.metadata, native_hz=rates)
    return FlightRecord(columns, metadata), truth.coefficients
