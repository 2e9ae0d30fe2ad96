"""Thrust or propeller speed in place of the throttle: the throttle that a flight had comes back."""

from __future__ import annotations

import numpy as np
import pytest

import uqharness as uq
from sysid.record import FlightRecord
from uqharness.errors import BadInputError
from uqharness.replay.flights import SOURCES, prepare_together, throttle_at, with_throttle
from uqharness.simulator import find_aircraft

AIRCRAFT = find_aircraft("espaaro")


@pytest.fixture(scope="module")
def record() -> FlightRecord:
    """A flight of the aircraft itself, whose thrust and propeller speed JSBSim computed as
    it flew.
    """
    return uq.fly("espaaro", script="doublet-elevator", duration_s=6).record


def only(record: FlightRecord, column: str, factor: float = 1.0) -> FlightRecord:
    """Without throttle, and with one of SOURCES."""
    kept = without(record).columns
    return FlightRecord({**kept, column: factor * record[column]}, record.metadata)


def without(record: FlightRecord) -> FlightRecord:
    """The record without throttle and what can stand for it."""
    kept = {
        name: values
        for name, values in record.columns.items()
        if name not in ("throttle_pct", *SOURCES)
    }
    return FlightRecord(kept, record.metadata)


@pytest.mark.parametrize("column", ["thrust_N", "rpm"])
def test_the_throttle_that_was_flown_comes_back(record: FlightRecord, column: str) -> None:
    found, said = with_throttle(only(record, column), AIRCRAFT, "f")
    # The flight's thrust follows its changing airspeed late by the propeller's time constant.
    assert np.abs(found["throttle_pct"] - record["throttle_pct"]).max() < 0.5
    assert said.startswith(f"throttle_pct was made of {column}: ")


def test_a_larger_thrust_is_another_throttle(record: FlightRecord) -> None:
    found, _ = with_throttle(only(record, "thrust_N", 1.2), AIRCRAFT, "f")
    assert (found["throttle_pct"] - record["throttle_pct"]).min() > 2.0


def test_a_thrust_that_the_engine_cannot_have_is_refused(record: FlightRecord) -> None:
    with pytest.raises(
        BadInputError,
        match=r"f: thrust_N is .* N, and espaaro's engines have .* between no and full throttle",
    ):
        with_throttle(only(record, "thrust_N", 20.0), AIRCRAFT, "f")


def test_a_record_with_a_throttle_keeps_it_and_one_with_neither_is_refused(
    record: FlightRecord,
) -> None:
    assert with_throttle(record, AIRCRAFT, "f") == (record, "")
    neither = without(record)
    assert with_throttle(neither, AIRCRAFT, "f") == (neither, "")
    with pytest.raises(BadInputError, match="the record has no throttle_pct"):
        prepare_together(["f"], [neither], AIRCRAFT)


def test_flights_for_replay_are_driven_by_it(record: FlightRecord) -> None:
    (flight,), _ = prepare_together(["f"], [only(record, "thrust_N")], AIRCRAFT)
    assert any("throttle_pct was made of thrust_N" in note for note in flight.notes)
    assert np.isfinite(flight.record["throttle_pct"]).all()


def test_a_glider_s_or_rocket_s_rpm_has_no_meaning(record: FlightRecord) -> None:
    from uqharness.plugin import with_card

    with pytest.raises(BadInputError, match="has no propeller"):
        with_throttle(only(record, "rpm"), with_card(find_aircraft("T37")), "f")


def test_throttle_at_is_the_inverse_of_the_curves() -> None:
    speeds, throttles = np.array([20.0, 40.0]), np.array([0.0, 50.0, 100.0])
    curves = np.array([[0.0, 100.0, 200.0], [-50.0, 0.0, 50.0]])
    V = np.array([20.0, 40.0, 30.0, np.nan, 20.0, 20.0])
    wanted = np.array([150.0, 25.0, 50.0, 1.0, np.nan, 900.0])
    np.testing.assert_allclose(
        throttle_at(V, wanted, speeds, throttles, curves), [75.0, 75.0, 50.0, np.nan, np.nan, 100.0]
    )
