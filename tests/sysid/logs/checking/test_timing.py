"""Delays of air data in calm and turbulent air, on synthetic spectra and independent flights."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sysid.logs.checking.kinematics import (
    all_laws,
    estimate_relation,
    groups_of,
    spectrum,
    stretches,
)
from sysid.logs.checking.physics import check_physics
from sysid.logs.checking.timing import UNKNOWN, Lateness, Part, channel_lateness, lateness
from sysid.record import FlightRecord
from tests.helpers.sixdof import Airframe
from tests.helpers.synthetic import flight
from tests.hidden_effects.flights import Flight, fly
from tests.hidden_effects.manoeuvres import card

LATE_S = 0.03
LAWS = {
    law.subject: law for law in all_laws() if law.statement == "what rates and accelerations say"
}
CONTROLS = ("elevator_deg", "aileron_deg", "rudder_deg", "throttle_pct")


# Made signals: dx/dt of a first-order heave, which a control and gusts move.


def build(
    seed: int, gust: float, feedback: float = 0.0, rows: int = 4500
) -> tuple[list[Part], list[np.ndarray]]:
    """Spectra of x, y and the control; alpha' = x + g', x = -2 alpha + control, so that x follows
    what gusts do to alpha.
    """
    rng = np.random.default_rng(seed)
    dt, n = 0.02, rows
    pushed = np.cumsum(rng.standard_normal(n + 1)) * math.sqrt(dt)
    pushed = np.convolve(np.diff(pushed), np.ones(5) / 5.0, "same") / dt * gust
    request = np.repeat(rng.choice([-1.0, 1.0], n // 20 + 1), 20)[:n]
    alpha, x, y, u = 0.0, np.empty(n), np.empty(n), np.empty(n)
    for k in range(n):
        u[k] = request[k] - feedback * alpha
        x[k] = -2.0 * alpha + u[k]
        y[k] = x[k] + pushed[k]
        alpha += dt * y[k]
    at = np.arange(n) * dt
    y = np.interp(at - LATE_S, at, y)
    x, y = (v + 0.01 * rng.standard_normal(n) for v in (x, y))
    f, fx, fy = spectrum(x, y, dt, 0.08, 2.5)
    z = spectrum(u, u, dt, 0.08, 2.5)[1]
    return [Part(f, fx, fy, z[None], n, dt)], groups_of(f, 0.08, 2.5)


def deviations(result: list[Lateness]) -> np.ndarray:
    return np.array([(late.late_s - LATE_S) / late.std_s for late in result])


def test_controls_tell_lateness_in_gusts_with_its_error():
    z = deviations([lateness(*build(seed, 0.5)) for seed in range(40)])
    assert 0.75 < np.sqrt(np.mean(z**2)) < 1.3
    assert np.mean(np.abs(z) < 1.96) >= 0.85


def test_the_motion_itself_does_not():
    """The phase of y against x, which gusts turn: the reason for instruments."""
    result = []
    for seed in range(6):
        parts, groups = build(seed, 0.5)
        result.append(lateness([replace(p, z=p.x[None]) for p in parts], groups))
    assert min(late.late_s for late in result) > LATE_S + 0.03
    # Its restrictions are broken, and its error grows with them.
    assert min(late.misfit / late.freedom for late in result) > 2.0
    assert np.abs(deviations(result)).max() < 2.0


# Flights.


def simulate(w20_kt: float, count: int, rate_hz: float = 25.0) -> list[FlightRecord]:
    cards = [
        card(500 + i, 20.0 + 3.0 * (i % 3), first=i, rate_hz=rate_hz, w20_kt=w20_kt)
        for i in range(count)
    ]
    return fly([Flight(c, Airframe()) for c in cards])


@pytest.fixture(scope="module")
def calm() -> list[FlightRecord]:
    return simulate(0.0, 4)


@pytest.fixture(scope="module")
def light() -> list[FlightRecord]:
    return simulate(15.0, 12)


def made_late(record: FlightRecord, channel: str, late_s: float) -> FlightRecord:
    return record.with_columns(
        {channel: np.interp(record["time_s"] - late_s, record["time_s"], record[channel])}
    )


@pytest.mark.parametrize("channel", ["alpha_rad", "beta_rad"])
@pytest.mark.parametrize("late_s", [0.03, 0.06])
def test_a_late_vane_is_found_in_calm_air(calm: list[FlightRecord], channel: str, late_s: float):
    for record in calm:
        result = {
            f.channel: f.numbers
            for f in check_physics(made_late(record, channel, late_s))
            if f.code == "delay"
        }
        assert result[channel]["delay_s"] == pytest.approx(late_s, abs=0.006)
        assert result[channel]["std_s"] < 0.0075
        assert abs(result[channel]["delay_s"] - late_s) < 3.5 * result[channel]["std_s"]
        assert set(result) == {channel}


@pytest.mark.parametrize("channel", ["alpha_rad", "beta_rad"])
def test_errors_cover_in_turbulence(light: list[FlightRecord], channel: str):
    result = [
        channel_lateness(made_late(record, channel, LATE_S), LAWS[channel]) for record in light
    ]
    assert {late.by for late in result} == {"controls"}
    z = deviations(result)
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.5
    # The phase between the two, by its own error.
    naive = [
        estimate_relation(LAWS[channel], stretches(made_late(r, channel, LATE_S), LAWS[channel]))
        for r in light
    ]
    invalid = np.array([(r.late_s - LATE_S) / r.late_std_s for r in naive])
    assert np.sqrt(np.mean(invalid**2)) > 1.6


def test_without_controls_calm_air_tells_and_gusts_do_not(
    calm: list[FlightRecord], light: list[FlightRecord]
):
    law = LAWS["alpha_rad"]
    for record, maximum in ((calm[0], 0.05), (light[0], math.inf)):
        plain = FlightRecord(
            {n: v for n, v in record.columns.items() if n not in CONTROLS}, record.metadata
        )
        late = channel_lateness(made_late(plain, "alpha_rad", 0.2), law)
        assert late.by == "motion"
        assert abs(late.late_s - 0.2) < 2.0 * late.std_s
        assert late.std_s <= maximum
        assert channel_lateness(plain, law, by_motion=False) == UNKNOWN
    assert late.std_s > 0.1
    # Motion that no control explains and no noise disturbs.
    exact = channel_lateness(made_late(flight(60.0), "alpha_rad", 0.05), law)
    assert exact.by == "motion"
    assert exact.late_s == pytest.approx(0.05, abs=0.003)
    assert exact.std_s < 0.006
