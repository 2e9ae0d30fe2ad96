"""Messages become a record: grid, held commands, angles, manoeuvres and dropouts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sysid.errors import LogError
from sysid.foreign.raw import MessageTable, RawLog
from sysid.logs.assemble import assemble, bridge
from sysid.logs.load import import_log
from sysid.logs.signal_map import Entry, SignalMap
from sysid.record import FlightRecord

FAST, SLOW = 0.02 * np.arange(250), 0.1 * np.arange(50) + 0.008
ENTRIES = {
    "q_radps": (Entry("IMU", 0, ("q",)),),
    "theta_rad": (Entry("ATT", 0, ("theta",)),),
    "psi_rad": (Entry("ATT", 0, ("psi",), function="heading"),),
    "elevator_deg": (Entry("OUT", 0, ("elevator",)),),
    "mode": (Entry("MODE", 0, ("number",)),),
}


def raw_log(dialect: str = "dataflash", **more) -> RawLog:
    messages = {
        ("IMU", 0): MessageTable(FAST, {"q": np.sin(FAST)}),
        ("ATT", 0): MessageTable(
            SLOW, {"theta": 0.1 * SLOW, "psi": 2.0 * np.pi - 0.5 + 0.3 * SLOW}
        ),
        ("OUT", 0): MessageTable(SLOW, {"elevator": np.round(4.0 * np.sin(3.0 * SLOW))}),
        ("MODE", 0): MessageTable(np.array([0.0, 2.01]), {"number": np.array([0.0, 12.0])}),
    }
    return RawLog(dialect, messages, **more)


def build(raw: RawLog):
    return assemble(raw, SignalMap("test", ENTRIES), None)


def test_the_fastest_rate_is_the_grid_and_the_rest_lies_on_it() -> None:
    record = build(raw_log())
    inside = slice(5, 240)
    assert record["time_s"] == pytest.approx(FAST)
    np.testing.assert_array_equal(record["q_radps"], np.sin(FAST))
    assert record["theta_rad"][inside] == pytest.approx(0.1 * FAST[inside])
    # Across north and round again, with no value in between.
    expected = np.mod(2.0 * np.pi - 0.5 + 0.3 * FAST, 2.0 * np.pi)
    assert record["psi_rad"][inside] == pytest.approx(expected[inside])
    assert record.metadata.grid_hz == pytest.approx(50.0)
    assert record.metadata.native_hz["theta_rad"] == pytest.approx(10.0)


def test_where_the_flight_began() -> None:
    raw = raw_log()
    fix = MessageTable(
        SLOW,
        {"Lat": np.r_[0.0, np.full(49, 37.5)], "Lng": np.full(50, -76.0), "Alt": np.full(50, 12.0)},
    )
    log = RawLog("dataflash", {**raw.messages, ("GPS", 0): fix})
    assert build(log).metadata.start == {"lat_deg": 37.5, "lon_deg": -76.0, "alt_m": 12.0}
    assert build(raw).metadata.start == {}
    scaled = MessageTable(
        SLOW, {"lat": np.full(50, 375e6), "lon": np.full(50, -760e6), "alt": np.full(50, 12_000.0)}
    )
    log = RawLog("tlog", {**raw.messages, ("GLOBAL_POSITION_INT", 0): scaled})
    assert build(log).metadata.start == pytest.approx(
        {"lat_deg": 37.5, "lon_deg": -76.0, "alt_m": 12.0}
    )


@pytest.mark.parametrize("absurd", [1e300, 2.0**63, 1e10])
def test_absurd_times_ask_for_no_memory(tmp_path: Path, absurd: float) -> None:
    lines = ["FMT, 130, 20, IMU, Qfff, TimeUS,GyrX,GyrY,GyrZ"]
    # Ten stamps a microsecond apart, an hour less a second, ten more, and so on.
    times = [3.599e9 * block + k for block in range(40) for k in range(10)] + [absurd]
    lines += [f"IMU, {t:.0f}, 0.1, 0.2, 0.3" for t in times]
    (tmp_path / "a.log").write_text("\n".join(lines))
    with pytest.raises(LogError, match=r"would be more than .* rows"):
        import_log(tmp_path / "a.log")


# Short dropouts are bridged, long ones are not, and the figures say how many.

N = 200


def record(**columns):
    time = 1e5 + 0.02 * np.arange(N)
    wave = np.sin(0.1 * np.arange(N))
    return FlightRecord(
        {"time_s": time, "q_radps": wave, "elevator_deg": np.round(wave), **columns}
    )


def test_lost_rows_come_back_with_straight_lines_and_held_commands():
    complete = record(manoeuvre=np.array(["pitch"] * N, dtype=object))
    retained = np.ones(N, dtype=bool)
    retained[[20, 21, 50, 70, 71, 72]] = False
    result, notes = bridge(complete.rows(retained), ("q_radps", "elevator_deg"), ("elevator_deg",))
    assert len(result) == N
    assert np.allclose(result["time_s"], complete["time_s"], atol=1e-9, rtol=0)
    assert np.allclose(result["q_radps"], complete["q_radps"], atol=0.02)
    assert result["q_radps"][50] == np.mean(complete["q_radps"][[49, 51]])
    assert (result["elevator_deg"][70:73] == complete["elevator_deg"][69]).all()
    assert set(result["manoeuvre"]) == {"pitch"}
    assert notes == ["6 lost row(s) were put back, each gap at most 0.1 s long"]
    assert len(result.segments(("q_radps", "elevator_deg"))) == 1


def test_nothing_is_bridged_across_a_long_gap_nor_in_a_channel_that_is_mostly_holes():
    complete = record()
    retained = np.ones(N, dtype=bool)
    retained[80:90] = False
    result, notes = bridge(complete.rows(retained), ("q_radps",))
    assert len(result) == N - 10
    assert not notes
    assert len(result.segments(("q_radps",))) == 2
    holes = np.array(complete["q_radps"])
    holes[::3] = np.nan
    result, notes = bridge(record(q_radps=holes), ("q_radps",))
    assert np.isnan(result["q_radps"]).sum() == np.isnan(holes).sum()
    assert not notes


def test_missing_samples_are_counted_and_the_ends_stay_missing():
    holes = np.array(record()["q_radps"])
    holes[[0, 1, 40, 41, 100, -1]] = np.nan
    result, notes = bridge(record(q_radps=holes), ("q_radps", "alpha_rad"))
    assert np.flatnonzero(np.isnan(result["q_radps"])).tolist() == [0, 1, N - 1]
    assert notes == ["3 of 197 samples of q_radps are missing and were bridged in straight lines"]


def test_a_table_of_pandas_is_read_with_its_row_numbers_and_checked_for_degrees(tmp_path):
    from sysid.logs.checking.checks import in_degrees
    from sysid.logs.load import import_log
    from tests.helpers.synthetic import flight

    valid = flight(40.0)
    table = pd.DataFrame(dict(valid.columns))
    table.to_csv(tmp_path / "good.csv")
    read = import_log(tmp_path / "good.csv")
    assert set(read.columns) == set(valid.columns)
    assert not [f for f in read.metadata.findings if in_degrees(f)]
    for name in ("phi_rad", "theta_rad", "q_radps"):
        table.assign(**{name: np.degrees(table[name])}).to_csv(tmp_path / "bad.csv", index=False)
        assert [f for f in import_log(tmp_path / "bad.csv").metadata.findings if in_degrees(f)], (
            name
        )
