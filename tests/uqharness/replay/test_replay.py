"""Replays against independent equations of motion, and the timing of commands."""

from __future__ import annotations

import math
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from sysid.aerodynamics.coefficients import smooth
from tests.helpers.flown import NOISE, fly
from tests.helpers.sixdof import Airframe
from tests.hidden_effects.cases import cards
from tests.hidden_effects.flights import Flight
from tests.hidden_effects.flights import fly as fly_hidden
from tests.hidden_effects.motion import Model, trim
from uqharness.errors import BadInputError
from uqharness.identification.replay_fit import demanded_coefficients, forced_at
from uqharness.replay.flights import prepare, read_flight, segments, states
from uqharness.replay.force import force_states
from uqharness.replay.model import CONTROLS, ReplayFolder, ReplayModel
from uqharness.replay.replay import (
    CHANNELS,
    STATES,
    fly_segment,
    initial_actuator_positions,
    runs_per_row,
)
from uqharness.replay.segments import Segment
from uqharness.simulator.aircraft import find_aircraft

SURFACES = ("elevator", "aileron", "rudder")


@pytest.fixture(scope="module")
def aircraft():
    return find_aircraft("espaaro")


@pytest.fixture(scope="module")
def clean():
    return fly((("pitch-3211", 22.0), ("roll-yaw", 22.0)), seed=None)


def exact(segment, record):
    """The segment from the record's very first state instead of a straight line through 0.4 s."""
    at = int(np.argmin(np.abs(record["time_s"] - segment.time_s[0])))
    return replace(
        segment, start=np.array([record[c][at] for c in STATES]), altitude_m=100.0, h_m=100.0
    )


def misses(aircraft, record, measured, late=0, averaged=False):
    """Largest rms of replay minus record by channel over the record's segments, in units of Table
    2.1's noise.

    averaged: with the commands between two rows replaced by their mean.
    """
    flight = prepare("f", record, measured)
    worst_of = dict.fromkeys(CHANNELS, 0.0)
    with ReplayFolder(aircraft, measured=measured) as model:
        for segment in segments(flight, measured):
            segment = exact(segment, record)
            if averaged:
                segment = replace(segment, commands=None)
            if late:
                shifted = np.vstack([segment.controls[:1]] * late + [segment.controls[:-late]])
                targets = np.vstack([segment.targets[:1]] * late + [segment.targets[:-late]])
                segment = replace(segment, controls=shifted, targets=targets)
            trajectory = fly_segment(model, segment, {})
            rows = flight.record.between(segment.time_s[0] - 1e-6, segment.time_s[-1] + 1e-6)
            for k, name in enumerate(CHANNELS):
                truth = np.unwrap(rows[name]) if name == "psi_rad" else rows[name]
                gap = np.sqrt(np.mean((trajectory[:, k] - truth) ** 2)) / NOISE.get(name, 0.01)
                worst_of[name] = max(worst_of[name], gap)
    return worst_of


def test_a_replay_of_measured_surfaces_is_the_flight_itself(aircraft, clean):
    gaps = misses(aircraft, clean, SURFACES)
    assert max(gaps.values()) < 0.15, gaps


def test_a_replay_of_commands_goes_through_the_actuators(aircraft, clean):
    gaps = misses(aircraft, clean, ())
    # Tustin's rule moves a servo within the run in which its command steps: one sample of a_z in a
    # step sees it early.
    assert max(v for c, v in gaps.items() if c != "az_mps2") < 0.15, gaps
    assert gaps["az_mps2"] < 0.6


@pytest.mark.parametrize("measured", [SURFACES, ()], ids=["positions", "commands"])
def test_a_replay_one_step_late_would_be_seen(aircraft, clean, measured):
    gaps = misses(aircraft, clean, measured, late=1)
    assert gaps["p_radps"] > 2.5
    assert gaps["q_radps"] > 2.5


def test_sample_times_are_met_at_any_record_rate(aircraft):
    for rate in (25.0, 100.0):
        record = fly((("roll-yaw", 22.0),), seed=None, rate_hz=rate)
        gaps = misses(aircraft, record, SURFACES)
        assert max(gaps.values()) < 1.0, (rate, gaps)
    assert [runs_per_row(dt) for dt in (0.004, 0.01, 0.015, 0.02, 0.1)] == [2, 4, 4, 4, 20]


def prepared_step():
    """An elevator step of 4 deg at row 20."""
    dynamics = Model([Airframe()], [()])
    x0, s0 = trim(dynamics, np.array([22.0]), np.array([100.0]))
    controls = np.repeat(s0[:, 0][None], 60, axis=0)
    controls[20:, 0] += 4.0
    alpha = float(np.arctan2(x0[2, 0], x0[0, 0]))
    start = np.array([22.0, alpha, 0.0, 0.0, x0[7, 0], 0.0, 0.0, 0.0, 0.0])
    return Segment("step", "f", 0.02 * np.arange(60), controls, start, 100.0, 100.0)


def test_early_commands_leave_servos_where_they_begin(aircraft):
    """The elevator is on its way at the first row; a millisecond more or less moves it little."""
    step = prepared_step()
    before = np.repeat(step.controls[:1], 40, axis=0)
    before[:, 0] += 10.0
    with ReplayFolder(aircraft) as model:
        moving = replace(step, before=before)
        early, punctual, late = (
            fly_segment(model, moving, {}, late_s=late_s) for late_s in (-1e-3, 0.0, 1e-3)
        )
    q = CHANNELS.index("q_radps")
    change, opposite = (np.abs(x - punctual)[:15, q].max() for x in (early, late))
    assert change < 2.0 * opposite + 1e-4


def test_commands_early_by_rows_are_those_of_a_segment_that_begins_later(aircraft):
    step, rows = prepared_step(), 6
    controls = np.repeat(step.controls[:1], 60, axis=0)
    controls[2:, 0] += 8.0
    before = np.repeat(step.controls[:1], 40, axis=0)
    early = replace(step, controls=controls, before=before)
    later = replace(
        step,
        controls=np.vstack([controls[rows:], np.repeat(controls[-1:], rows, axis=0)]),
        before=np.vstack([before, controls[:rows]]),
    )
    with ReplayFolder(aircraft) as model:
        flown = fly_segment(model, early, {}, late_s=-rows * step.dt_s)
        expected = fly_segment(model, later, {})
        prompt = fly_segment(model, early, {})
    q = CHANNELS.index("q_radps")
    assert flown[:, q] == pytest.approx(expected[:, q], abs=1e-9)
    assert np.abs(prompt[:, q] - expected[:, q]).max() > 0.1


def test_an_accelerometer_away_from_the_cg_feels_the_rotation(aircraft, clean):
    flight = prepare("f", clean, SURFACES)
    arm = (0.3, 0.1, -0.2)
    with ReplayFolder(aircraft, measured=SURFACES) as model:
        at_cg, offset = segments(flight, SURFACES)[1], segments(flight, SURFACES, arm)[1]
        gap = fly_segment(model, offset, {}) - fly_segment(model, at_cg, {})
        trajectory = fly_segment(model, at_cg, {})
    rates = trajectory[:, 6:9]
    slope = np.gradient(rates, 0.02, axis=0)
    expected = np.cross(slope, arm) + np.cross(rates, np.cross(rates, arm))
    assert np.abs(gap[:, :9]).max() == 0.0
    assert (
        np.sqrt(np.mean((gap[:, 9:12] - expected) ** 2))
        < 0.05 * np.sqrt(np.mean(expected**2)) + 0.03
    )


def test_forced_states_give_the_flights_coefficients_back(aircraft, clean):
    flight = prepare("f", clean, SURFACES)
    with (
        ReplayFolder(aircraft, measured=SURFACES) as model,
        ReplayFolder(aircraft, measured=SURFACES, ideal=CONTROLS) as level,
    ):
        section, every = (
            segments(flight, SURFACES),
            [states(flight, piece) for piece in flight.pieces],
        )
        for segment, channels, (forced, result) in zip(
            section, every, forced_at(model, level, section, every, {}), strict=True
        ):
            demand, output = (
                demanded_coefficients(channels, forced, segment),
                smooth(forced.coefficients, 0.02),
            )
            np.testing.assert_allclose(demand[5:-5, :3], output[5:-5, :3], atol=6e-4)
            np.testing.assert_allclose(demand[5:-5, 3:], output[5:-5, 3:], atol=1.5e-3)
            np.testing.assert_allclose(result["de"], segment.controls[:, 0])
        assert forced.mass.inertia[0, 2] == pytest.approx(-0.25, rel=1e-3)
        assert forced.mass.mass == pytest.approx(21.34, rel=1e-3)
        # The same sample asked twice, once after another: no state is remembered.
        repeat = force_states(
            level,
            segment,
            {k: v[[7, 300, 7]] for k, v in channels.items()},
            segment.controls[[7, 300, 7]],
            {},
        )
        np.testing.assert_allclose(repeat.coefficients[0], repeat.coefficients[2], atol=1e-12)


def test_a_force_that_goes_with_alphadot_is_the_one_of_the_state_itself(aircraft, clean, tmp_path):
    """JSBSim's alphadot is the frame before's: forced one after the other, states would have each
    other's.
    """
    folder = tmp_path / "aircraft" / aircraft.name
    shutil.copytree(aircraft.folder, folder)
    xml = folder / aircraft.xml.name
    term = """<function name="aero/force/CZ_ad"><product><property>aero/qbar-psf</property><property>metrics/Sw-sqft</property>
        <value>0.3</value><property>aero/alphadot-rad_sec</property></product></function>"""
    text, result = re.subn(r'(<axis name="Z"[^>]*>)', rf"\1{term}", xml.read_text(encoding="utf-8"))
    assert result == 1
    xml.write_text(text, encoding="utf-8")
    flight = prepare("f", clean, SURFACES)
    rows, output = [7, 300, 7, 120], []
    for some in (
        aircraft,
        replace(
            find_aircraft(folder),
            engine_path=aircraft.engine_path,
            systems_path=aircraft.systems_path,
        ),
    ):
        with ReplayFolder(some, measured=SURFACES, ideal=CONTROLS) as level:
            segment = segments(flight, SURFACES)[0]
            x = {k: v[rows] for k, v in states(flight, flight.pieces[0]).items()}
            output.append(force_states(level, segment, x, segment.controls[rows], {}))
    plain, with_term = output
    np.testing.assert_allclose(with_term.coefficients[0], with_term.coefficients[2], atol=1e-7)
    force = with_term.aero_force + with_term.other_force
    V, alpha, beta, p, q, r = (
        x[c] for c in ("V_mps", "alpha_rad", "beta_rad", "p_radps", "q_radps", "r_radps")
    )
    u, v, w = V * np.cos(alpha) * np.cos(beta), V * np.sin(beta), V * np.sin(alpha) * np.cos(beta)
    ud = force[:, 0] / with_term.mass.mass - 9.80665 * np.sin(x["theta_rad"]) + r * v - q * w
    wd = (
        force[:, 2] / with_term.mass.mass
        + 9.80665 * np.cos(x["theta_rad"]) * np.cos(x["phi_rad"])
        + q * u
        - p * v
    )
    alphadot = (u * wd - w * ud) / (u**2 + w**2)
    assert np.abs(alphadot).max() > 0.02
    np.testing.assert_allclose(
        with_term.coefficients[:, 2] - plain.coefficients[:, 2], 0.3 * alphadot, atol=2e-4
    )


def test_records_that_cannot_be_replayed_say_why(aircraft, clean, tmp_path):
    plain = clean.rows(slice(0, None))
    columns = {
        k: v for k, v in plain.columns.items() if k not in ("elevator_deg", "elevator_pos_deg")
    }
    with pytest.raises(BadInputError, match=r"no elevator_deg; without the surfaces"):
        prepare("f", type(clean)(columns), ())
    with pytest.raises(BadInputError, match="10"):
        prepare("f", clean.rows(np.arange(len(clean)) % 10 == 0), ())
    with pytest.raises(BadInputError, match="no stretch of 60 s"):
        prepare("f", clean, SURFACES, min_s=60.0, max_s=90.0)
    empty = tmp_path / "empty.csv"
    empty.write_text("")
    with pytest.raises(BadInputError, match=r"empty\.csv"):
        read_flight(empty, aircraft)


# Where actuators stand at a segment's first row: against a first-order lag's solution, and in
# replays of independent flights.

DT_S = 0.02
LIMITS = np.array([[-25.0, 25.0], [-25.0, 25.0], [-25.0, 25.0], [0.0, 100.0]])
STEPS = (100, 3)
"""Rows before a segment, and those of them behind a step of the command."""


@pytest.fixture(scope="module")
def model():
    with ReplayFolder(find_aircraft("espaaro")) as result:
        yield result


def piece(step_deg: float = 2.0, throttle_pct: float = 4.0) -> Segment:
    """Commands that stepped three rows before the first one and stay."""
    count, behind = STEPS
    begin, step = (
        np.array([1.0, -2.0, 0.5, 50.0]),
        np.array([step_deg, -step_deg, step_deg, throttle_pct]),
    )
    before = begin + step * (np.arange(count)[:, None] >= count - behind)
    start = np.array([22.2, 0.015, 0.01, 0.1, 0.05, 1.0, 0.05, -0.02, 0.03])
    time_s = DT_S * np.arange(60)
    return Segment(
        "m", "f", time_s, np.tile(begin + step, (60, 1)), start, 130.0, 100.0, before=before
    )


def test_a_lag_has_gone_as_far_as_its_time_constant_says(model: ReplayModel) -> None:
    result, held_s = piece(), STEPS[1] * DT_S
    lags = {"elevator": 25.0, "aileron": 25.0, "rudder": 25.0, "throttle": 6.0}
    assert {c: float(lag) for c, (lag, _) in model.lags.items()} == lags
    short = [math.exp(-held_s * lags[c]) for c in model.controls]
    step = result.before[-1] - result.before[0]
    assert result.before[-1] - initial_actuator_positions(
        model, result, {}, LIMITS
    ) == pytest.approx(step * short, abs=0.01 * np.abs(step).max())


def test_the_beginnings_of_replays_are_those_of_independent_flights(model: ReplayModel) -> None:
    """A motor of 1/6 s and a throttle that moves: without what came before, ax at the first rows is
    off by a part of its noise.
    """
    card = replace(cards("begun", "mixed", 0.0, 1.0, 50.0)[0], noise=1e-4)
    flight = prepare("f", fly_hidden([Flight(card, Airframe())])[0], ())
    k, noise = CHANNELS.index("ax_mps2"), 0.16
    reference, forgotten = [], []
    for segment, part in zip(segments(flight, ()), flight.pieces, strict=True):
        observed = flight.record["ax_mps2"][part.rows][:10]
        for remaining, specific in (
            (reference, segment),
            (forgotten, replace(segment, before=None)),
        ):
            remaining.append(
                np.abs(fly_segment(model, specific, {})[:10, k] - observed).max() / noise
            )
    assert max(reference) < 0.02
    assert max(forgotten) > 0.1
