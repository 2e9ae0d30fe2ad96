"""Short dropouts are bridged, long ones are not, and the figures say how many."""

import numpy as np
import pandas as pd
import pytest

from sysid.errors import LogError
from sysid.logs.assemble import bridge
from sysid.record import FlightRecord

N = 200


def record(**columns):
    time = 1e5 + 0.02 * np.arange(N)
    wave = np.sin(0.1 * np.arange(N))
    return FlightRecord(
        {"time_s": time, "q_radps": wave, "elevator_deg": np.round(wave), **columns}
    )


def test_lost_rows_come_back_with_straight_lines_and_held_commands():
    whole = record(manoeuvre=np.array(["pitch"] * N, dtype=object))
    kept = np.ones(N, dtype=bool)
    kept[[20, 21, 50, 70, 71, 72]] = False
    found, notes = bridge(whole.rows(kept), ("q_radps", "elevator_deg"), ("elevator_deg",))
    assert len(found) == N
    assert np.allclose(found["time_s"], whole["time_s"], atol=1e-9, rtol=0)
    assert np.allclose(found["q_radps"], whole["q_radps"], atol=0.02)
    assert found["q_radps"][50] == np.mean(whole["q_radps"][[49, 51]])
    assert (found["elevator_deg"][70:73] == whole["elevator_deg"][69]).all()
    assert set(found["manoeuvre"]) == {"pitch"}
    assert notes == ["6 lost row(s) were put back, each gap at most 0.1 s long"]
    assert len(found.segments(("q_radps", "elevator_deg"))) == 1


def test_nothing_is_bridged_across_a_long_gap_nor_in_a_channel_that_is_mostly_holes():
    whole = record()
    kept = np.ones(N, dtype=bool)
    kept[80:90] = False
    found, notes = bridge(whole.rows(kept), ("q_radps",))
    assert len(found) == N - 10
    assert not notes
    assert len(found.segments(("q_radps",))) == 2
    holes = np.array(whole["q_radps"])
    holes[::3] = np.nan
    found, notes = bridge(record(q_radps=holes), ("q_radps",))
    assert np.isnan(found["q_radps"]).sum() == np.isnan(holes).sum()
    assert not notes


def test_missing_samples_are_counted_and_the_ends_stay_missing():
    holes = np.array(record()["q_radps"])
    holes[[0, 1, 40, 41, 100, -1]] = np.nan
    found, notes = bridge(record(q_radps=holes), ("q_radps", "alpha_rad"))
    assert np.flatnonzero(np.isnan(found["q_radps"])).tolist() == [0, 1, N - 1]
    assert notes == ["3 of 197 samples of q_radps are missing and were bridged in straight lines"]


def test_a_table_of_pandas_is_read_with_its_row_numbers_and_checked_for_degrees(tmp_path):
    from sysid.logs.checking.checks import in_degrees
    from sysid.logs.load import import_log
    from tests.helpers.synthetic import flight

    good = flight(40.0)
    table = pd.DataFrame(dict(good.columns))
    table.to_csv(tmp_path / "good.csv")
    read = import_log(tmp_path / "good.csv")
    assert set(read.columns) == set(good.columns)
    assert not [f for f in read.metadata.findings if in_degrees(f)]
    for name in ("phi_rad", "theta_rad", "q_radps"):
        table.assign(**{name: np.degrees(table[name])}).to_csv(tmp_path / "bad.csv", index=False)
        assert [f for f in import_log(tmp_path / "bad.csv").metadata.findings if in_degrees(f)], (
            name
        )


def test_a_header_without_rows_is_refused(tmp_path):
    (tmp_path / "header.csv").write_text("time_s,V_mps\n")
    with pytest.raises(LogError, match="no rows"):
        FlightRecord.read(tmp_path / "header.csv")
