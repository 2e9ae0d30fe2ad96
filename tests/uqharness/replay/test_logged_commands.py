"""Commands of a log on a replay's rows, and what a late accelerometer tells of the time before a
segment.
"""

from dataclasses import replace

import numpy as np
import pytest

from sysid.logs.servo import MAX_LATE_S, logged_rows
from tests.helpers.flown import fly
from uqharness.replay.flights import mean_ahead, measured_outputs, prepare, with_steps_placed

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
    flown = prepare("f", record, ()).record["aileron_deg"]
    direct = prepare(
        "f", record.with_columns({"aileron_deg": np.asarray(record["aileron_deg"])}), ()
    ).record["aileron_deg"]
    np.testing.assert_array_equal(flown, direct)
    right = mean_ahead(acted, 4)[::4]
    held = mean_ahead(np.asarray(record["aileron_deg"]), 4)[::4]
    assert np.abs(flown - right).sum() < 0.7 * np.abs(held - right).sum()


def test_a_record_whose_commands_are_on_every_row_stays_as_it_is():
    record = fly((("roll-yaw", 22.0),), seed=3, positions=False)
    same, notes, late_s = with_steps_placed(record, ("elevator_deg", "aileron_deg", "rudder_deg"))
    assert notes == []
    assert late_s == 0.0
    np.testing.assert_array_equal(same["aileron_deg"], record["aileron_deg"])


def test_rows_that_were_logged_are_those_that_change_and_the_ones_before_them():
    command = np.array([0.0, 0.0, 0.0, 0.0, 5.0, 5.0, 6.0, 6.0, 6.0, 6.0])
    assert np.flatnonzero(logged_rows(command, 3)).tolist() == [1, 4, 6]


def test_the_first_samples_of_a_logs_accelerometers_are_of_the_time_before():
    record, _ = logged()
    flight = prepare("f", record, ())
    (first, *_) = measured_outputs(flight, ("p_radps", "az_mps2"))
    assert np.isnan(first[:2, 1]).all()
    assert np.isfinite(first[2, 1])
    assert np.isfinite(first[0, 0])
    plain = prepare("f", replace(record, metadata=replace(record.metadata, native_hz={})), ())
    assert np.isfinite(measured_outputs(plain, ("az_mps2",))[0][0, 0])


def test_commands_as_felt_are_half_way_at_their_jump_and_as_late_as_the_gyro():
    record = fly((("roll-yaw", 22.0),), seed=None)
    flight = prepare("f", record, ())
    (at,) = np.flatnonzero(np.diff(record["aileron_deg"]) > 5.0)[:1]
    before, after = record["aileron_deg"][at], record["aileron_deg"][at + 1]
    for late_s, share in ((0.0, 0.5), (0.005, 0.25)):
        felt = replace(flight, gyro_late_s=late_s).with_smoothing_delay().record["aileron_deg"]
        assert felt[at + 1] == pytest.approx(share * after + (1.0 - share) * before)
        assert felt[at + 2] == pytest.approx(record["aileron_deg"][at + 2])
