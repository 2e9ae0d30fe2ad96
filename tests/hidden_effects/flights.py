"""Flight records of flight cards flown with hidden effects: the equations of motion, then the
sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sysid.arrays import FloatArray
from sysid.record import FlightRecord, Metadata
from tests.helpers.sixdof import Airframe
from tests.hidden_effects.effects import PLACES, Effect
from tests.hidden_effects.gusts import NODE_S, turbulence
from tests.hidden_effects.manoeuvres import Card, Pilot
from tests.hidden_effects.motion import CALM, Drive, History, Model, integrate, trim

STEP_S = 0.004
# Table 2.1 of the dissertation, one standard deviation.
NOISE = {
    "V_mps": 0.5,
    "alpha_rad": np.radians(0.1),
    "beta_rad": np.radians(0.1),
    "phi_rad": np.radians(0.5),
    "theta_rad": np.radians(0.5),
    "p_radps": np.radians(0.2),
    "q_radps": np.radians(0.2),
    "r_radps": np.radians(0.2),
    "ax_mps2": 0.16,
    "ay_mps2": 0.16,
    "az_mps2": 0.16,
    "h_m": 1.33,
    "psi_rad": np.radians(0.5),  # of the same sensor as phi and theta; the table has no heading
}


@dataclass(frozen=True)
class Flight:
    """One card flown by one airframe with its hidden effects and its servos (None: LAG and
    RATE).
    """

    card: Card
    airframe: Airframe
    effects: tuple[Effect, ...] = ()
    drive: Drive | None = None


@dataclass(frozen=True)
class Flown:
    """A record and what its sensors did not see: states (n, 12), commands (n, 4)."""

    record: FlightRecord
    x: FloatArray
    commands: FloatArray


def fly(flights: Sequence[Flight], step_s: float = STEP_S) -> list[FlightRecord]:
    """Records of the flights, in order."""
    return [f.record for f in fly_and_tell(flights, step_s)]


def fly_and_tell(flights: Sequence[Flight], step_s: float = STEP_S) -> list[Flown]:
    """Records and truth of the flights, in order; those of one rate, length and kind are flown
    together.
    """
    groups: dict[tuple[float, float, bool], list[int]] = {}
    for i, f in enumerate(flights):
        dots = any(e.needs_dots for e in f.effects)
        groups.setdefault((f.card.rate_hz, f.card.seconds, dots), []).append(i)
    out: dict[int, Flown] = {}
    for members in groups.values():
        for start in range(0, len(members), 120):
            part = members[start : start + 120]
            out |= dict(zip(part, _combine([flights[i] for i in part], step_s), strict=True))
    return [out[i] for i in range(len(flights))]


def _combine(flights: Sequence[Flight], step_s: float) -> list[Flown]:
    cards = [f.card for f in flights]
    dt = 1.0 / cards[0].rate_hz
    n = round(cards[0].seconds / dt)
    model = Model(
        [f.airframe for f in flights], [f.effects for f in flights], [f.drive for f in flights]
    )
    x0, s0 = trim(model, np.array([c.V_mps for c in cards]), np.array([c.h_m for c in cards]))
    instruments = np.empty((n, 4, len(cards)))
    drawing = []
    for lane, c in enumerate(cards):
        rng = np.random.default_rng([c.seed, 1])
        drawing.append(
            {name: c.noise * std * rng.standard_normal(n) for name, std in NOISE.items()}
        )
        instruments[:, :, lane] = np.column_stack(
            [drawing[-1][name] for name in ("V_mps", "phi_rad", "theta_rad", "h_m")]
        )
    # A dead zone swallows its half: the commands that hold the trim lie beyond it.
    constant = s0 + np.sign(s0) * 0.5 * model.deadband
    pilot = Pilot(cards, x0, constant, instruments)
    history = integrate(model, x0, constant, n, dt, substeps(dt, step_s), pilot, gusts_of(flights))
    return [
        Flown(
            _record(f, history, lane, drawing[lane], dt),
            history.x[:, :, lane].copy(),
            history.commands[:, :, lane].copy(),
        )
        for lane, f in enumerate(flights)
    ]


def substeps(dt_s: float, step_s: float = STEP_S) -> int:
    """RK4 steps from one sample to the next, none longer than ``step_s``."""
    return max(1, int(np.ceil(dt_s / step_s - 1e-6)))


def gusts_of(flights: Sequence[Flight]) -> FloatArray:
    """(N, 6, B) the flights' air every NODE_S; CALM where none has any."""
    if not any(f.card.w20_kt for f in flights):
        return CALM
    longest = max(f.card.seconds for f in flights)
    nodes = np.zeros((round(longest / NODE_S) + 3, 6, len(flights)))
    for lane, f in enumerate(flights):
        c = f.card
        if c.w20_kt > 0.0:
            nodes[:, :, lane] = _air(c.V_mps, c.h_m, c.w20_kt, f.airframe.b, longest, c.seed)
    return nodes


@lru_cache(maxsize=64)
def _air(V: float, h: float, w20_kt: float, b: float, seconds: float, seed: int) -> FloatArray:
    return turbulence(V, h, w20_kt, b, seconds, np.random.default_rng([seed, 2]))


def _record(
    flight: Flight, history: History, lane: int, noise: dict[str, FloatArray], dt: float
) -> FlightRecord:
    x, card = history.x[:, :, lane], flight.card
    time = dt * np.arange(len(x))
    columns = {
        "V_mps": history.V[:, lane],
        "alpha_rad": history.alpha[:, lane],
        "beta_rad": history.beta[:, lane],
        "phi_rad": x[:, 6],
        "theta_rad": x[:, 7],
        "psi_rad": x[:, 8],
        "p_radps": x[:, 3],
        "q_radps": x[:, 4],
        "r_radps": x[:, 5],
        "ax_mps2": history.felt[:, 0, lane],
        "ay_mps2": history.felt[:, 1, lane],
        "az_mps2": history.felt[:, 2, lane],
        "h_m": -x[:, 11] - (card.h_m if card.h_m > 20.0 else 0.0),
    }
    for effect in flight.effects:
        if effect.subject.startswith("sensor.") and effect.subject not in PLACES:
            name = effect.subject.removeprefix("sensor.")
            columns[name] = sensed(columns[name], effect, dt)
    columns = {name: values + noise.get(name, 0.0) for name, values in columns.items()}
    columns["psi_rad"] = np.mod(columns["psi_rad"], 2.0 * np.pi)
    rows = sum(round(e.size / dt) for e in flight.effects if e.subject == "record")
    commands = earlier(history.commands[:, :, lane], rows)
    positions = history.positions[:, :, lane]
    columns |= {
        "time_s": time,
        "elevator_deg": commands[:, 0],
        "aileron_deg": commands[:, 1],
        "rudder_deg": commands[:, 2],
        "throttle_pct": commands[:, 3],
        "rho_kgpm3": history.rho[:, lane],
    }
    if card.positions:
        columns |= {
            f"{s}_pos_deg": positions[:, i] for i, s in enumerate(("elevator", "aileron", "rudder"))
        }
    labels = np.full(len(time), "", dtype=object)
    for m in card.manoeuvres:
        labels[(time >= m.at_s - 1e-9) & (time < m.at_s + m.length_s - 1e-9)] = m.label
    return FlightRecord(
        {**columns, "manoeuvre": labels},
        Metadata(source="flight", dialect="simulation", grid_hz=1.0 / dt),
    )


def earlier(values: FloatArray, rows: int) -> FloatArray:
    """(n, ...) values as a clock gives them that is that many rows early (late, if negative); the
    ends are held.
    """
    return np.asarray(values[np.clip(np.arange(len(values)) + rows, 0, len(values) - 1)])


def sensed(values: FloatArray, effect: Effect, dt: float) -> FloatArray:
    """(n, ...) a channel as a sensor with this fault gives it."""
    if effect.term == "bias":
        return values + effect.size
    if effect.term == "scale":
        return values * (1.0 + effect.size)
    at = np.clip(np.arange(len(values)) - effect.size / dt, 0.0, len(values) - 1.0)
    low = np.minimum(at.astype(int), len(values) - 2)
    share = (at - low).reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(values[low] * (1.0 - share) + values[low + 1] * share)
