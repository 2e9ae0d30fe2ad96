"""Records above 60 Hz are thinned; commands act at their own times."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sysid.errors import Finding
from sysid.record import FlightRecord, Metadata
from tests.helpers.flown import fly
from uqharness.errors import BadInputError
from uqharness.replay.flights import (
    in_free_flight,
    measured_outputs,
    measured_surfaces,
    prepare,
    segments,
)
from uqharness.replay.model import CONTROLS
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


def test_segments_of_a_thinned_record_hold_its_commands_between_their_rows():
    record = fly((("pitch-doublet", 22.0),), seed=1, rate_hz=100.0)
    flight = prepare("fast", record, ())
    for segment in segments(flight, ()):
        own = segment.at_commands()
        assert segment.per_row == 2
        assert own.command_s == pytest.approx(0.01)
        rows = record.between(segment.time_s[0] - 1e-6, segment.time_s[-1] + 1e-6)
        column = own.controls[:, CONTROLS.index("elevator")]
        np.testing.assert_array_equal(column, rows["elevator_deg"])


def test_commands_of_a_very_fast_record_are_averaged_over_five_milliseconds():
    n = 4000
    record = fly((("pitch-doublet", 22.0),), seed=1, seconds=6.0)
    column = np.where(np.arange(n) >= 1001, 2.0, 0.0)
    slow = record.rows(np.arange(len(record)) < 1)
    fast = type(record)(
        {c: np.repeat(slow[c], n) for c in slow.columns}
        | {"time_s": 1e-3 * np.arange(n), "elevator_deg": column},
        record.metadata,
    )
    flight = prepare("fast", fast, ())
    assert flight.per_row == 4
    assert flight.record.dt_s == pytest.approx(0.02)
    np.testing.assert_allclose(flight.commands["elevator_deg"][199:203], [0.0, 1.6, 2.0, 2.0])


def test_a_clock_that_is_one_row_late_is_one_command_late_and_nothing_else():
    record = fly((("pitch-doublet", 22.0),), seed=1, rate_hz=100.0)
    flight = prepare("fast", record, ())
    moved = flight.with_delayed_commands(0.01)
    for column, values in flight.commands.items():
        np.testing.assert_allclose(moved.commands[column][1:], values[:-1], atol=1e-9)
        assert moved.commands[column][0] == values[0]
    felt = flight.with_smoothing_delay()
    assert felt.per_row == 1
    assert segments(felt, ())[0].commands is None


@pytest.mark.parametrize("rate_hz", [25.0, 50.0])
def test_a_command_that_is_late_by_a_part_of_a_row_is_held_as_long_as_it_was(rate_hz):
    """Beside a record of 200 Hz in which each command begins so much later: the same to a sample,
    and no straight line between.
    """
    record = fly((("pitch-doublet", 22.0),), seed=1, rate_hz=rate_hz, seconds=6.0)
    n, finer = len(record), round(200.0 / rate_hz)
    asked = np.where(np.arange(n) % 20 >= 10, 3.0, -1.0)
    measured = np.sin(0.1 * np.arange(n))
    plain = record.with_columns({"elevator_deg": asked, "aileron_pos_deg": measured})
    flight = prepare("late", plain, ("aileron",))
    late_s = (finer + 3) * 0.005
    moved = flight.with_delayed_commands(late_s)
    assert moved.per_row == finer
    fine = moved.commands["elevator_deg"]
    expected = np.concatenate([np.full(finer + 3, asked[0]), np.repeat(asked, finer)])[: len(fine)]
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
    whole = flight.with_delayed_commands(1.0 / rate_hz)
    assert whole.per_row == 1
    np.testing.assert_allclose(whole.record["elevator_deg"][1:], asked[:-1], atol=1e-9)


def test_a_position_that_is_its_command_is_not_measured():
    """A surface without a lag jumps with its command; drawn from row to row in a straight line it
    would come half a row early.
    """
    record = fly((("roll-yaw", 22.0),), seed=1, seconds=6.0)
    assert measured_surfaces([record]) == ("elevator", "aileron", "rudder")
    jumping = record.with_columns({"rudder_pos_deg": record["rudder_deg"] * (1.0 + 1e-6)})
    assert measured_surfaces([jumping]) == ("elevator", "aileron")
    # Another record, in which it is one, decides for both.
    assert measured_surfaces([jumping, record]) == ("elevator", "aileron", "rudder")
    late = record.with_columns({"rudder_pos_deg": np.roll(record["rudder_deg"], 1)})
    assert "rudder" in measured_surfaces([late])


def northward(**metadata):
    """A flight whose heading has its noise on both sides of north, as a record has it: from 0 to 2
    pi.
    """
    record = fly((("pitch-doublet", 22.0),), seed=1, rate_hz=50.0)
    noise = np.random.default_rng(4).normal(0.0, 0.01, len(record))
    noise[:2] = -0.01, 0.01
    turned = record.with_columns({"psi_rad": noise % (2.0 * np.pi)})
    return replace(turned, metadata=replace(turned.metadata, **metadata)), noise


def test_a_late_heading_that_is_moved_stays_north():
    late = Finding(
        "delay", "psi_rad", "warning", "psi_rad is late", {"delay_s": 0.03, "std_s": 0.002}
    )
    record, noise = northward(findings=(late,))
    flight = prepare("north", record, ())
    assert any("psi_rad was moved 30 ms" in note for note in flight.notes)
    (heading, *_) = measured_outputs(flight, ("psi_rad",))
    start = segments(flight, ())[0].start[5]
    assert abs(np.sin(start)) < 0.01
    gap = heading[:, 0] - start
    # A straight line from 6.28 to 0.01 would put south in between, and every such place would count
    # as a turn.
    assert np.nanmax(np.abs(gap)) < 2.0 * np.abs(noise).max()


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
    stands = any("it stands as recorded" in note for note in flight.notes)
    assert stands is (not align)


def test_a_heading_logged_at_every_other_row_counts_from_the_turn_of_its_start():
    record, noise = northward(native_hz={"psi_rad": 25.0})
    # West of north at every row that was not logged: a segment that begins there begins just below
    # 2 pi.
    noise = np.abs(noise) * np.where(np.arange(len(noise)) % 2, -1.0, 1.0)
    flight = prepare(
        "north", record.with_columns({"psi_rad": noise % (2.0 * np.pi)}), (), min_s=1.0, max_s=3.02
    )
    assert any(piece.rows.start % 2 for piece in flight.pieces)
    for segment, block in zip(
        segments(flight, ()), measured_outputs(flight, ("psi_rad",)), strict=True
    ):
        assert np.isnan(block).any()
        assert np.nanmax(np.abs(block - segment.start[5])) < 2.0 * np.abs(noise).max()


def starts_of_p(motion, draws=25):
    """Start states of p, in its noise, less what they are in truth, of flights whose p is a motion
    from the first row on.
    """
    record = fly((("pitch-doublet", 22.0),), seed=1, rate_hz=50.0)
    time_s, noise, out = record["time_s"] - record["time_s"][0], 0.003, []
    for seed in range(draws):
        drawn = noise * np.random.default_rng(seed).standard_normal(len(record))
        flight = prepare("f", record.with_columns({"p_radps": motion(time_s) + drawn}), ())
        (first, *_) = segments(flight, ())
        out.append((first.start[6] - motion(np.zeros(1))[0]) / noise)
    return np.array(out)


@pytest.mark.parametrize("roll_s", [0.02, 0.05, 0.15])
def test_a_segment_that_begins_with_a_fast_roll_starts_where_it_began(roll_s):
    """A straight line through the first 0.4 s would start some 300 times its noise away."""
    off = starts_of_p(lambda t: 1.1 * (1.0 - np.exp(-t / roll_s)))
    assert np.sqrt(np.mean(off**2)) < 1.3
    assert np.abs(off).max() < 4.0


def test_a_straight_beginning_still_averages_the_noise():
    off = starts_of_p(lambda t: 0.02 + 0.1 * t)
    assert np.sqrt(np.mean(off**2)) < 0.6


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
