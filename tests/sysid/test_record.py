"""FlightRecord: what may be in it, writing and reading, segments."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sysid.errors import Finding, LogError
from sysid.record import FlightRecord, Metadata
from tests.helpers.synthetic import flight


def example() -> FlightRecord:
    record = flight(4.0)
    gappy = record["alpha_rad"].copy()
    gappy[10:20] = np.nan
    labels = np.full(len(record), "", dtype=object)
    labels[30:40] = "pitch-doublet"
    meta = Metadata(
        source="a.bin",
        sha256="00",
        dialect="dataflash",
        vehicle="ArduPlane",
        aircraft="espaaro",
        grid_hz=50.0,
        start={"lat_deg": 37.1977},
        native_hz={"V_mps": 10.0},
        channels={"V_mps": "ARSP.Airspeed"},
        estimates=("beta_rad",),
        free_flight_s=((0.5, 3.5),),
        findings=(
            Finding("gap", "IMU", "warning", "a gap", {"total_s": 1.5, "nan": float("nan")}),
        ),
    )
    return FlightRecord({**record.columns, "alpha_rad": gappy, "manoeuvre": labels}, meta)


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_written_and_read_back_the_same(tmp_path: Path, suffix: str) -> None:
    record = example()
    record.write(tmp_path / f"r{suffix}")
    back = FlightRecord.read(tmp_path / f"r{suffix}")
    assert list(back.columns) == list(record.columns)
    for name, values in record.columns.items():
        np.testing.assert_array_equal(back[name], values)
    assert back.metadata.to_json() == record.metadata.to_json()
    assert back.metadata.warnings == ["a gap"]


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=20), st.integers(0, 19))
def test_any_numbers_survive_csv(
    tmp_path_factory: pytest.TempPathFactory, values: list[float], hole: int
) -> None:
    column = np.array(values)
    column[hole % len(column)] = np.nan
    path = tmp_path_factory.mktemp("csv") / "r.csv"
    FlightRecord({"time_s": np.arange(len(column)) / 3.0, "h_m": column}).write(path)
    np.testing.assert_array_equal(FlightRecord.read(path)["h_m"], column)


def test_refusals_name_the_column_and_the_row() -> None:
    t = np.arange(5.0)
    with pytest.raises(LogError, match="needs the column time_s"):
        FlightRecord({"V_mps": t})
    with pytest.raises(LogError, match=r"unknown columns \['speed'\]"):
        FlightRecord({"time_s": t, "speed": t})
    with pytest.raises(LogError, match="does not increase at row 3"):
        FlightRecord({"time_s": np.array([0.0, 1.0, 2.0, 1.5])})
    with pytest.raises(LogError, match=r"V_mps has shape \(4,\)"):
        FlightRecord({"time_s": t, "V_mps": t[:4]})
    with pytest.raises(LogError, match="every sample needs its time"):
        FlightRecord({"time_s": np.array([0.0, np.nan])})
    with pytest.raises(LogError, match="this record has no q_radps"):
        FlightRecord({"time_s": t})["q_radps"]


def test_segments_stop_at_dropouts_and_time_gaps() -> None:
    record = example()
    assert record.segments(("alpha_rad",)) == [slice(0, 10), slice(20, 200)]
    assert record.segments(("alpha_rad",), min_s=1.0) == [slice(20, 200)]
    keep = np.ones(200, dtype=bool)
    keep[100:110] = False
    assert record.rows(keep).segments(("V_mps",)) == [slice(0, 100), slice(100, 190)]
