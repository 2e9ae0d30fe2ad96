"""Replay: JSBSim flown through recorded controls against equations that owe it nothing, and the
timing of commands.
"""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sysid.aerodynamics.coefficients import half_width, smooth
from tests.helpers.flown import NOISE, fly
from tests.helpers.sixdof import Airframe
from tests.hidden_effects.motion import Model, integrate, trim
from uqharness.errors import BadInputError
from uqharness.identification.replay_fit import demanded_coefficients, forced_at
from uqharness.replay import replay
from uqharness.replay.flights import prepare, read_flight, segments, states
from uqharness.replay.force import force_states
from uqharness.replay.model import CONTROLS, ReplayFolder
from uqharness.replay.replay import CHANNELS, STATES, by_run, fly_segment, runs_per_row
from uqharness.replay.segments import Segment
from uqharness.replay.simulation import Replay, counter
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
            flown = fly_segment(model, segment, {})
            rows = flight.record.between(segment.time_s[0] - 1e-6, segment.time_s[-1] + 1e-6)
            for k, name in enumerate(CHANNELS):
                truth = np.unwrap(rows[name]) if name == "psi_rad" else rows[name]
                gap = np.sqrt(np.mean((flown[:, k] - truth) ** 2)) / NOISE.get(name, 0.01)
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


def test_the_first_acceleration_has_seen_the_first_command(aircraft, clean):
    flight = prepare("f", clean, SURFACES)
    with ReplayFolder(aircraft, measured=SURFACES) as model:
        segment = exact(segments(flight, SURFACES)[0], clean)
        moved = segment.controls.copy()
        moved[0, 0] += 5.0
        before, after = (
            fly_segment(model, segment, {}),
            fly_segment(model, replace(segment, controls=moved), {}),
        )
    az, q = CHANNELS.index("az_mps2"), CHANNELS.index("q_radps")
    assert after[0, az] - before[0, az] == pytest.approx(
        0.036 * 5.0 * 0.5 * 1.2133 * 22.0**2 * 1.97 / 21.34, rel=0.01
    )
    assert after[0, q] == before[0, q]
    assert abs(after[1, q] - before[1, q]) > 0.01


def test_sample_times_are_met_at_any_record_rate(aircraft):
    for rate in (25.0, 100.0):
        record = fly((("roll-yaw", 22.0),), seed=None, rate_hz=rate)
        gaps = misses(aircraft, record, SURFACES)
        assert max(gaps.values()) < 1.0, (rate, gaps)
    assert [runs_per_row(dt) for dt in (0.004, 0.01, 0.015, 0.02, 0.1)] == [2, 4, 4, 4, 20]


def test_commands_act_between_the_rows_of_a_thinned_record(aircraft):
    """At 100 Hz every second row is compared; steps that fall between two of those keep their time,
    their mean does not.
    """
    record = fly((("roll-yaw", 22.0),), seed=None, rate_hz=100.0)
    (steps,) = np.flatnonzero(np.abs(np.diff(record["aileron_deg"])) > 5.0)[:1] + 1
    if steps % 2 == 0:
        record = record.rows(np.arange(len(record)) > 0)
    for measured in ((), SURFACES):
        gaps = misses(aircraft, record, measured)
        assert gaps["p_radps"] < 0.07, (measured, gaps)
        assert misses(aircraft, record, measured, averaged=True)["p_radps"] > 0.14


def controls_of(rows, **more):
    controls = np.asarray(rows, dtype=float)[:, None]
    return SimpleNamespace(controls=controls, targets=None, **more)


def moments(values):
    """Sum, mean time and half the mean square of the time [runs] of a step's parts, behind
    row 2.
    """
    parts = np.diff(np.append(values, values[-1]), prepend=0.0)[8:] / 8.0
    times = np.arange(len(parts))
    return [float((parts * times**k).sum()) / (k or 1) for k in (0, 1, 2)]


OWN = [1.0, 0.5, 1.0 / 6.0]
"""Of the step itself: a step that sums of runs count begins half a run before it is set."""


def test_values_of_the_runs_around_a_step_give_it_its_time():
    """Mean time, spread and the row's own value: integrators count half of a run's change, a lag by
    Tustin's rule as much.
    """
    segment = controls_of([0.0, 0.0, 8.0, 8.0, 8.0])
    jumping = by_run(segment, 4, [False], [False])[:, 0]
    np.testing.assert_allclose(
        jumping[7:13],
        8.0 * np.array([0.0, 1.0, 1.0 / 18.0, 47.0 / 36.0, 41.0 / 36.0, 1.0]),
        atol=1e-12,
    )
    lagging = by_run(segment, 4, [False], [True])[:, 0]
    np.testing.assert_allclose(
        lagging[7:12], 8.0 * np.array([0.0, 0.0, 23.0 / 12.0, 7.0 / 12.0, 1.0]), atol=1e-12
    )
    assert moments(jumping) == pytest.approx(OWN)
    assert moments(lagging) == pytest.approx(OWN)
    for late in (-1.5, 0.75, 2.0):
        moved = [by_run(segment, 4, [False], [lags], late=late)[:, 0] for lags in (False, True)]
        # The same step, later; what jumps has jumped at its row all the same, unless outputs
        # between rows are asked for.
        assert [m.sum() for m in moved] == pytest.approx([8.0 * (8.5 - late)] * 2)
        assert moved[0][8] == pytest.approx(8.0)
        assert by_run(segment, 4, [False], [False], late=late, jump_share=None)[
            :, 0
        ].sum() == pytest.approx(8.0 * (8.5 - late))
    assert by_run(segment, 4, [False], [False], late=2.0, jump_share=None)[8, 0] == 0.0
    # A row that was read before its command went out has seen nothing of the step, or a share; the
    # step's time stays.
    for seen in (0.0, 0.25):
        blind = by_run(segment, 4, [False], [False], jump_share=seen)[:, 0]
        assert blind[8] == pytest.approx(8.0 * seen)
        assert moments(blind) == pytest.approx(OWN)
        np.testing.assert_array_equal(
            by_run(segment, 4, [False], [True], jump_share=seen)[:, 0], lagging
        )


@pytest.mark.parametrize("late", [0.75, 3.0, -1.5, 400.0, -400.0])
def test_late_controls_are_those_on_time_in_proportion_between_two_runs(late):
    segment = controls_of(np.random.default_rng(3).normal(size=30))
    on_time = by_run(segment, 4, [False], [True], jump_share=None)[:, 0]
    at = np.arange(len(on_time))
    found = by_run(segment, 4, [False], [True], late=late, jump_share=None)[:, 0]
    np.testing.assert_array_equal(found, np.interp(at - late, at, on_time))
    assert not np.array_equal(found, on_time)


def test_controls_that_are_remembered_are_no_one_s_to_change():
    segment, other = controls_of([0.0, 0.0, 8.0, 8.0]), controls_of([0.0, 0.0, 8.0, 9.0])
    first = by_run(segment, 4, [False], [True])
    kept = first.copy()
    first += 1.0
    np.testing.assert_array_equal(by_run(segment, 4, [False], [True]), kept)
    assert not np.array_equal(by_run(other, 4, [False], [True]), kept)
    assert not np.array_equal(by_run(segment, 4, [False], [False]), kept)


def test_with_few_runs_a_row_a_step_has_its_mean_time_alone_and_stays_within_its_row():
    segment = controls_of([0.0, 0.0, 8.0, 8.0])
    jumping, lagging = (by_run(segment, 2, [False], [lags])[:, 0] for lags in (False, True))
    np.testing.assert_array_equal(jumping[3:], [0.0, 8.0, 4.0, 8.0])
    np.testing.assert_array_equal(lagging[3:], [0.0, 0.0, 12.0, 8.0])


def test_a_command_goes_no_further_than_its_limits():
    """What does not fit comes a run later; at the limit itself there is no room."""
    segment = controls_of([0.0, 0.0, 8.0, 8.0, 8.0])
    free = by_run(segment, 4, [False], [True], limits=np.array([[-20.0, 20.0]]))[:, 0]
    np.testing.assert_array_equal(free, by_run(segment, 4, [False], [True])[:, 0])
    held = by_run(segment, 4, [False], [True], limits=np.array([[-20.0, 11.0]]))[:, 0]
    np.testing.assert_allclose(held[7:12], [0.0, 0.0, 11.0, 9.0, 8.0], atol=1e-12)
    assert moments(held)[:2] == pytest.approx(OWN[:2])
    for high in (9.0, 8.0, 7.0):
        near = by_run(segment, 4, [False], [True], limits=np.array([[-20.0, high]]))[:, 0]
        assert near.max() == max(high, 8.0)
    down = by_run(
        controls_of([0.0, 0.0, -8.0, -8.0, -8.0]),
        4,
        [False],
        [True],
        limits=np.array([[-11.0, 20.0]]),
    )[:, 0]
    np.testing.assert_allclose(down, -held, atol=1e-12)


def test_a_measured_position_that_turns_has_its_own_area():
    """Sums over runs have a twelfth of the change of direction too little: it comes a run after the
    row.
    """
    turning = controls_of([0.0, 0.0, 4.0, 8.0, 8.0])
    line = np.interp(np.arange(17.0), 4.0 * np.arange(5), turning.controls[:, 0])
    added = by_run(turning, 4, [True], [False])[:, 0] - line
    expected = np.zeros(17)
    expected[[5, 13]] = 1.0 / 12.0, -1.0 / 12.0
    np.testing.assert_allclose(added, expected, atol=1e-12)


def test_accelerometers_read_before_the_command_feel_the_step_a_row_later(aircraft):
    segment = prepared_step()
    with ReplayFolder(aircraft, ideal=SURFACES) as model:
        seen, half, blind = (
            fly_segment(model, segment, {}, unseen=share) for share in (0.0, 0.5, 1.0)
        )
        still = fly_segment(
            model,
            replace(segment, controls=np.repeat(segment.controls[:1], len(segment.time_s), axis=0)),
            {},
        )
    felt = CHANNELS.index("az_mps2")
    step = seen[20, felt] - still[20, felt]
    assert abs(step) > 0.1
    assert blind[20, felt] == pytest.approx(still[20, felt], abs=0.02 * abs(step))
    assert half[20, felt] == pytest.approx(
        0.5 * (seen[20, felt] + blind[20, felt]), abs=0.02 * abs(step)
    )
    # Only that row's accelerations differ: what the aircraft does is the same but for a run's share
    # of one step.
    rates = [CHANNELS.index(c) for c in ("p_radps", "q_radps", "r_radps")]
    q = CHANNELS.index("q_radps")
    assert (
        np.abs(blind[:, rates] - seen[:, rates]).max()
        < 0.02 * np.abs(seen[:, q] - still[:, q]).max()
    )
    assert np.abs(blind[21:, felt] - seen[21:, felt]).max() < 0.05 * abs(step)


def prepared_step():
    """An elevator step of 4 deg at row 20."""
    dynamics = Model([Airframe()], [()])
    x0, s0 = trim(dynamics, np.array([22.0]), np.array([100.0]))
    controls = np.repeat(s0[:, 0][None], 60, axis=0)
    controls[20:, 0] += 4.0
    alpha = float(np.arctan2(x0[2, 0], x0[0, 0]))
    start = np.array([22.0, alpha, 0.0, 0.0, x0[7, 0], 0.0, 0.0, 0.0, 0.0])
    return Segment("step", "f", 0.02 * np.arange(60), controls, start, 100.0, 100.0)


@pytest.mark.parametrize("model", ["servo", pytest.param("at once", marks=pytest.mark.slow)])
def test_steps_of_commands_through_a_servo_at_its_rate_limit_and_without_one(
    aircraft, model, monkeypatch
):
    """Against the servo's own solution (exact lag, then the limit) and fourth-order motion; a run
    of 10 ms is seen.
    """
    dynamics = Model([Airframe()], [()])
    if model == "at once":
        dynamics.lag[:3], dynamics.rate[:3] = 1e9, 1e9
    x0, s0 = trim(dynamics, np.array([22.0]), np.array([100.0]))
    steps = np.zeros((140, 4, 1))
    steps[20:45, 1], steps[45:70, 1], steps[90:, 0] = 14.0, -14.0, -3.0
    flown = integrate(dynamics, x0, s0, 140, 0.02, 40, lambda k, air, x: s0 + steps[k])
    x, time = flown.x[:, :, 0], 0.02 * np.arange(140)
    controls = (s0 + steps)[:, :, 0]
    start = np.array(
        [22.0, flown.alpha[0, 0], flown.beta[0, 0], x[0, 6], x[0, 7], 0.0, 0.0, 0.0, 0.0]
    )
    segment = Segment("steps", "f", time, controls, start, 100.0, 100.0)
    ideal = () if model == "servo" else SURFACES

    def miss():
        with ReplayFolder(aircraft, ideal=ideal) as staged:
            replayed = fly_segment(staged, segment, {})
        return max(
            np.abs(replayed[:, 6 + k] - x[:, 3 + k]).max() / NOISE[c]
            for k, c in enumerate(("p_radps", "q_radps"))
        )

    assert miss() < (0.25 if model == "servo" else 0.75)
    for longest in ("MAX_STEP_S", "SHORT_STEP_S"):
        monkeypatch.setattr(replay, longest, 0.01)
    assert miss() > 1.0


def test_the_copy_leaves_the_aircraft_as_it_was_and_goes_away(aircraft):
    from uqharness.simulator.aircraft import content_hash

    before = content_hash(aircraft)
    with ReplayFolder(aircraft, measured=SURFACES, settings={"aero/Cm_q": -10.0}) as model:
        text = (model.staging.folder / aircraft.xml.name).read_text()
        assert 'file="autopilot"' not in text
        assert text.count("<lag>") == 1  # the motor's, which was not measured
        assert model.open(0.01)["aero/Cm_q"] == -10.0
        root = model.staging.root
    assert not root.exists()
    assert content_hash(aircraft) == before


def test_an_accelerometer_away_from_the_cg_feels_the_rotation(aircraft, clean):
    flight = prepare("f", clean, SURFACES)
    arm = (0.3, 0.1, -0.2)
    with ReplayFolder(aircraft, measured=SURFACES) as model:
        at_cg, away = segments(flight, SURFACES)[1], segments(flight, SURFACES, arm)[1]
        gap = fly_segment(model, away, {}) - fly_segment(model, at_cg, {})
        flown = fly_segment(model, at_cg, {})
    rates = flown[:, 6:9]
    slope = np.gradient(rates, 0.02, axis=0)
    expected = np.cross(slope, arm) + np.cross(rates, np.cross(rates, arm))
    assert np.abs(gap[:, :9]).max() == 0.0
    assert (
        np.sqrt(np.mean((gap[:, 9:12] - expected) ** 2))
        < 0.05 * np.sqrt(np.mean(expected**2)) + 0.03
    )


def test_theta_is_laid_out_by_names_and_what_is_unmoved_is_not_flown_again(aircraft, clean):
    flight = prepare("f", clean, SURFACES)
    with ReplayFolder(aircraft, measured=SURFACES) as model:
        cut = segments(flight, SURFACES)
        replay = Replay(
            model,
            cut,
            ("aero/Cm_q", "bias/f/q_radps", "start/1/phi_rad"),
            ("q_radps", "phi_rad"),
            "test",
        )
        base = replay(np.array([-13.8, 0.0, 0.0]))
        flown = counter["rows"]
        biased = replay(np.array([-13.8, 0.01, 0.0]))
        assert counter["rows"] == flown
        moved = replay(np.array([-13.8, 0.0, 0.1]))
        assert counter["rows"] == flown + len(cut[1].time_s)
    assert [b.shape for b in base] == [(500, 2), (500, 2)]
    np.testing.assert_allclose(biased[0][:, 0] - base[0][:, 0], 0.01, atol=1e-12)
    assert moved[1][0, 1] - base[1][0, 1] == pytest.approx(0.1, abs=1e-9)
    np.testing.assert_array_equal(moved[0], base[0])


def test_forced_states_give_the_flights_coefficients_back(aircraft, clean):
    flight = prepare("f", clean, SURFACES)
    with (
        ReplayFolder(aircraft, measured=SURFACES) as model,
        ReplayFolder(aircraft, measured=SURFACES, ideal=CONTROLS) as straight,
    ):
        cut, every = segments(flight, SURFACES), [states(flight, piece) for piece in flight.pieces]
        for segment, channels, (forced, found) in zip(
            cut, every, forced_at(model, straight, cut, every, {}), strict=True
        ):
            demand, said = (
                demanded_coefficients(channels, forced, segment),
                smooth(forced.coefficients, 0.02),
            )
            np.testing.assert_allclose(demand[5:-5, :3], said[5:-5, :3], atol=6e-4)
            np.testing.assert_allclose(demand[5:-5, 3:], said[5:-5, 3:], atol=1.5e-3)
            np.testing.assert_allclose(found["de"], segment.controls[:, 0])
        assert forced.mass.inertia[0, 2] == pytest.approx(-0.25, rel=1e-3)
        assert forced.mass.mass == pytest.approx(21.34, rel=1e-3)
        # The same sample asked twice, once after another: no state is remembered.
        again = force_states(
            straight,
            segment,
            {k: v[[7, 300, 7]] for k, v in channels.items()},
            segment.controls[[7, 300, 7]],
            {},
        )
        np.testing.assert_allclose(again.coefficients[0], again.coefficients[2], atol=1e-12)


def test_a_force_that_goes_with_alphadot_is_the_one_of_the_state_itself(aircraft, clean, tmp_path):
    """JSBSim's alphadot is the frame before's: forced one after the other, states would have each
    other's.
    """
    folder = tmp_path / "aircraft" / aircraft.name
    shutil.copytree(aircraft.folder, folder)
    xml = folder / aircraft.xml.name
    term = """<function name="aero/force/CZ_ad"><product><property>aero/qbar-psf</property><property>metrics/Sw-sqft</property>
        <value>0.3</value><property>aero/alphadot-rad_sec</property></product></function>"""
    text, found = re.subn(r'(<axis name="Z"[^>]*>)', rf"\1{term}", xml.read_text(encoding="utf-8"))
    assert found == 1
    xml.write_text(text, encoding="utf-8")
    flight = prepare("f", clean, SURFACES)
    rows, said = [7, 300, 7, 120], []
    for some in (
        aircraft,
        replace(
            find_aircraft(folder),
            engine_path=aircraft.engine_path,
            systems_path=aircraft.systems_path,
        ),
    ):
        with ReplayFolder(some, measured=SURFACES, ideal=CONTROLS) as straight:
            segment = segments(flight, SURFACES)[0]
            x = {k: v[rows] for k, v in states(flight, flight.pieces[0]).items()}
            said.append(force_states(straight, segment, x, segment.controls[rows], {}))
    plain, with_term = said
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


def test_the_smoother_is_what_the_differentiator_does_to_a_derivative():
    t = np.arange(400) * 0.02
    wave, slope = np.sin(3.0 * t), 3.0 * np.cos(3.0 * t)
    np.testing.assert_allclose(
        smooth(wave, 0.02, derivative=1)[5:-5], smooth(slope, 0.02)[5:-5], atol=3e-3
    )
    np.testing.assert_allclose(smooth(np.ones(40), 0.02), 1.0)
    np.testing.assert_allclose(smooth(2.0 * t, 0.02, derivative=1), 2.0)
    fast = np.sin(2 * np.pi * 6.0 * np.arange(4000) * 0.002)
    assert half_width(0.002) > 10
    assert np.std(smooth(fast, 0.002)[100:-100]) / np.std(fast) == pytest.approx(
        1 / np.sqrt(2), abs=0.03
    )


def test_records_that_cannot_be_replayed_say_why(aircraft, clean, tmp_path):
    bare = clean.rows(slice(0, None))
    columns = {
        k: v for k, v in bare.columns.items() if k not in ("elevator_deg", "elevator_pos_deg")
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
