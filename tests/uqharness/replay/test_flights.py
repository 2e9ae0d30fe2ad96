"""Flights for replay: thinning, times of commands, and throttles from thrust."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import uqharness as uq
from sysid.errors import Finding
from sysid.logs.servo import MAX_LATE_S
from sysid.record import FlightRecord, Metadata
from tests.helpers.flown import fly
from uqharness.errors import BadInputError
from uqharness.replay.flights import (
    SOURCES,
    in_free_flight,
    mean_ahead,
    prepare,
    segments,
    throttle_at,
    with_steps_placed,
    with_throttle,
)
from uqharness.simulator import find_aircraft


def test_a_command_between_two_kept_rows_acts_as_long_as_it_did():
    record = fly((("pitch-doublet", 22.0),), seed=1, seconds=6.0)
    n = len(record)
    fast = record.with_columns(
        {"time_s": 0.01 * np.arange(n), "elevator_deg": np.where(np.arange(n) >= 101, 2.0, 0.0)}
    )
    flight = prepare("fast", fast, ())
    thin = flight.record
    assert abs(thin.dt_s - 0.02) < 1e-12
    np.testing.assert_allclose(thin["elevator_deg"][49:52], [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(thin["q_radps"], fast["q_radps"][::2])


@pytest.mark.parametrize(("in_manoeuvre", "skipped"), [(True, 15), (False, 0)])
def test_a_record_that_begins_in_a_manoeuvre_is_replayed_once_servos_are_at_their_commands(
    in_manoeuvre, skipped
):
    record = fly((("pitch-doublet", 22.0),), seed=1, seconds=8.0)
    first = int(np.argmax(np.abs(record["q_radps"]))) if in_manoeuvre else 0
    section = FlightRecord({c: record[c][first:] for c in record.columns}, record.metadata)
    assert (abs(section["q_radps"][0]) > 0.2) == in_manoeuvre
    flight = prepare("cut", section, ())
    assert flight.pieces[0].rows.start == skipped
    assert segments(flight, ())[0].time_s[0] == pytest.approx(section["time_s"][skipped])


def test_a_clock_that_is_one_row_late_is_one_command_late_and_nothing_else():
    record = fly((("pitch-doublet", 22.0),), seed=1, rate_hz=100.0)
    flight = prepare("fast", record, ())
    moved = flight.with_delayed_commands(0.01)
    for column, values in flight.commands.items():
        np.testing.assert_allclose(moved.commands[column][1:], values[:-1], atol=1e-9)
        assert moved.commands[column][0] == values[0]
    sensed = flight.with_smoothing_delay()
    assert sensed.per_row == 1
    assert segments(sensed, ())[0].commands is None


@pytest.mark.parametrize("rate_hz", [25.0, 50.0])
def test_a_command_that_is_late_by_a_part_of_a_row_is_held_as_long_as_it_was(rate_hz):
    """Beside a record of 200 Hz in which each command begins so much later: the same to a sample,
    and no straight line between.
    """
    record = fly((("pitch-doublet", 22.0),), seed=1, rate_hz=rate_hz, seconds=6.0)
    n, finer = len(record), round(200.0 / rate_hz)
    request = np.where(np.arange(n) % 20 >= 10, 3.0, -1.0)
    measured = np.sin(0.1 * np.arange(n))
    plain = record.with_columns({"elevator_deg": request, "aileron_pos_deg": measured})
    flight = prepare("late", plain, ("aileron",))
    late_s = (finer + 3) * 0.005
    moved = flight.with_delayed_commands(late_s)
    assert moved.per_row == finer
    fine = moved.commands["elevator_deg"]
    expected = np.concatenate([np.full(finer + 3, request[0]), np.repeat(request, finer)])[
        : len(fine)
    ]
    np.testing.assert_allclose(fine, expected, atol=1e-6)
    # A row's own value is what acts until the next one, on average; a position is where it was.
    np.testing.assert_allclose(
        moved.record["elevator_deg"][5], expected[5 * finer : 6 * finer].mean(), atol=1e-6
    )
    np.testing.assert_allclose(
        moved.record["aileron_pos_deg"][3:],
        np.sin(0.1 * (np.arange(n) - late_s * rate_hz))[3:],
        atol=2e-3,
    )
    # Between two samples of 5 ms the mean time is right.
    between = flight.with_delayed_commands(late_s + 0.002).commands["elevator_deg"]
    np.testing.assert_allclose(between[1:], 0.6 * fine[1:] + 0.4 * fine[:-1], atol=1e-6)
    complete = flight.with_delayed_commands(1.0 / rate_hz)
    assert complete.per_row == 1
    np.testing.assert_allclose(complete.record["elevator_deg"][1:], request[:-1], atol=1e-9)


@pytest.mark.parametrize(
    ("numbers", "align", "moved"),
    [
        ({"delay_s": 0.03, "std_s": 0.007}, True, True),
        (
            {"delay_s": 0.03, "std_s": 0.008},
            True,
            False,
        ),  # less than four standard errors, whatever the severity
        ({"delay_s": 0.03}, True, False),  # of an error nobody stated
        ({"delay_s": 0.03, "std_s": 0.002}, False, False),
    ],
)
def test_a_channel_is_moved_only_where_it_is_late_for_sure(numbers, align, moved):
    late = Finding("delay", "alpha_rad", "info", "alpha_rad comes 30 ms late", numbers)
    record = fly((("pitch-doublet", 22.0),), seed=1, rate_hz=50.0)
    record = replace(record, metadata=replace(record.metadata, findings=(late,)))
    flight = prepare("late", record, (), align=align)
    assert np.array_equal(flight.record["alpha_rad"], record["alpha_rad"]) is not moved
    assert any("alpha_rad was moved 30 ms" in note for note in flight.notes) is moved
    static = any("it stands as recorded" in note for note in flight.notes)
    assert static is (not align)


@pytest.mark.parametrize(("speed", "flew"), [(0.4, False), (-2.5, False), (7.0, True)])
def test_a_log_that_stood_on_the_ground_is_refused(speed, flew):
    """A slow glider flies, whatever the log's own rule says of it; a parked aircraft does not."""
    n = 400
    record = FlightRecord(
        {"time_s": 0.02 * np.arange(n), "V_mps": np.full(n, speed)},
        Metadata(
            dialect="ulog",
            findings=(Finding("flight-phase", "", "info", "it never flew: slow", {}),),
        ),
    )
    aircraft = find_aircraft("espaaro")
    if flew:
        assert len(in_free_flight(record, aircraft, "x.ulg")) == n
        return
    with pytest.raises(BadInputError, match=r"x\.ulg: it never flew: slow; a log with free flight"):
        in_free_flight(record, aircraft, "x.ulg")


# Commands of a log on a replay's rows, and what a late accelerometer tells of the time before a
# segment.

EVERY = 8


def logged(rate_hz=200.0):
    """A record at 200 Hz whose commands were logged at 25 Hz, and the commands as they were."""
    record = fly((("roll-yaw", 22.0),), seed=3, rate_hz=rate_hz, positions=False)
    acted = np.asarray(record["aileron_deg"])
    rows = np.maximum(
        ((np.arange(len(acted)) + 5) // EVERY) * EVERY - 5, 0
    )  # its clock is not the manoeuvres'
    native = {"aileron_deg": 25.0, "elevator_deg": 25.0, "rudder_deg": 25.0, "p_radps": rate_hz}
    slow = record.with_columns(
        {c: np.asarray(record[c])[rows] for c in ("elevator_deg", "aileron_deg", "rudder_deg")}
    )
    return replace(slow, metadata=replace(slow.metadata, native_hz=native)), acted


def test_steps_are_placed_on_the_logs_own_rows_before_it_is_thinned():
    record, acted = logged()
    placed, notes, late_s = with_steps_placed(record, ("elevator_deg", "aileron_deg", "rudder_deg"))
    assert (
        np.abs(placed["aileron_deg"] - acted).sum()
        < 0.7 * np.abs(record["aileron_deg"] - acted).sum()
    )
    assert len(notes) == 3
    assert 0.0 <= late_s <= MAX_LATE_S
    assert notes[1].startswith("aileron_deg was logged at 25 Hz")
    flight = prepare("f", record, ()).record["aileron_deg"]
    direct = prepare(
        "f", record.with_columns({"aileron_deg": np.asarray(record["aileron_deg"])}), ()
    ).record["aileron_deg"]
    np.testing.assert_array_equal(flight, direct)
    right = mean_ahead(acted, 4)[::4]
    constant = mean_ahead(np.asarray(record["aileron_deg"]), 4)[::4]
    assert np.abs(flight - right).sum() < 0.7 * np.abs(constant - right).sum()


def test_commands_as_felt_are_half_way_at_their_jump_and_as_late_as_the_gyro():
    record = fly((("roll-yaw", 22.0),), seed=None)
    flight = prepare("f", record, ())
    (at,) = np.flatnonzero(np.diff(record["aileron_deg"]) > 5.0)[:1]
    before, after = record["aileron_deg"][at], record["aileron_deg"][at + 1]
    for late_s, share in ((0.0, 0.5), (0.005, 0.25)):
        sensed = replace(flight, gyro_late_s=late_s).with_smoothing_delay().record["aileron_deg"]
        assert sensed[at + 1] == pytest.approx(share * after + (1.0 - share) * before)
        assert sensed[at + 2] == pytest.approx(record["aileron_deg"][at + 2])


# Thrust or propeller speed in place of the throttle: the throttle that a flight had comes back.

AIRCRAFT = find_aircraft("espaaro")


@pytest.fixture(scope="module")
def record() -> FlightRecord:
    """A flight of the aircraft itself, whose thrust and propeller speed JSBSim computed as
    it flew.
    """
    return uq.fly("espaaro", script="doublet-elevator", duration_s=6).record


def only(record: FlightRecord, column: str, factor: float = 1.0) -> FlightRecord:
    """Without throttle, and with one of SOURCES."""
    retained = leave_out(record).columns
    return FlightRecord({**retained, column: factor * record[column]}, record.metadata)


def leave_out(record: FlightRecord) -> FlightRecord:
    """The record without throttle and what can stand for it."""
    retained = {
        name: values
        for name, values in record.columns.items()
        if name not in ("throttle_pct", *SOURCES)
    }
    return FlightRecord(retained, record.metadata)


@pytest.mark.parametrize("column", ["thrust_N", "rpm"])
def test_the_throttle_that_was_flown_comes_back(record: FlightRecord, column: str) -> None:
    result, output = with_throttle(only(record, column), AIRCRAFT, "f")
    # The flight's thrust follows its changing airspeed late by the propeller's time constant.
    assert np.abs(result["throttle_pct"] - record["throttle_pct"]).max() < 0.5
    assert output.startswith(f"throttle_pct was made of {column}: ")


def test_a_thrust_that_the_engine_cannot_have_is_refused(record: FlightRecord) -> None:
    with pytest.raises(
        BadInputError,
        match=r"f: thrust_N is .* N, and espaaro's engines have .* between no and full throttle",
    ):
        with_throttle(only(record, "thrust_N", 20.0), AIRCRAFT, "f")


def test_throttle_at_is_the_inverse_of_the_curves() -> None:
    speeds, throttles = np.array([20.0, 40.0]), np.array([0.0, 50.0, 100.0])
    curves = np.array([[0.0, 100.0, 200.0], [-50.0, 0.0, 50.0]])
    V = np.array([20.0, 40.0, 30.0, np.nan, 20.0, 20.0])
    expected = np.array([150.0, 25.0, 50.0, 1.0, np.nan, 900.0])
    np.testing.assert_allclose(
        throttle_at(V, expected, speeds, throttles, curves),
        [75.0, 75.0, 50.0, np.nan, np.nan, 100.0],
    )
