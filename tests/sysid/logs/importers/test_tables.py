"""Tables as logs: what is read, in which unit, and what is refused before memory is asked for."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from sysid.errors import LogError
from sysid.logs.csv_dialects import CSV_DIALECTS, CsvDialect, csv_dialect_of, si_factor
from sysid.logs.load import import_log
from sysid.logs.tables import (
    read_csv,
    read_parquet,
    read_record,
    read_small_table,
)
from sysid.record import FlightRecord
from tests.helpers.synthetic import flight


def test_jsbsim_csv_is_turned_into_si_by_its_suffixes(tmp_path: Path) -> None:
    record = flight(10.0)
    columns = {
        "Time": record["time_s"],
        "/fdm/jsbsim/velocities/vtrue-fps": record["V_mps"] / 0.3048,
        "/fdm/jsbsim/aero/alpha-deg": np.degrees(record["alpha_rad"]),
        "/fdm/jsbsim/attitude/psi-rad": record["psi_rad"],
        "/fdm/jsbsim/velocities/q-rad_sec": record["q_radps"],
        "/fdm/jsbsim/accelerations/a-pilot-z-ft_sec2": record["az_mps2"] / 0.3048,
        "/fdm/jsbsim/position/h-sl-ft": (record["h_m"] + 500.0) / 0.3048,
        "/fdm/jsbsim/fcs/elevator-cmd-deg": record["elevator_deg"],
        "/fdm/jsbsim/atmosphere/rho-slugs_ft3": np.full(len(record), 1.225 / 515.378818393),
    }
    path = tmp_path / "out.csv"
    np.savetxt(
        path,
        np.column_stack(list(columns.values())),
        delimiter=",",
        header=",".join(columns),
        comments="",
    )
    back = import_log(path)
    assert back.metadata.dialect == "jsbsim-csv"
    for name in ("V_mps", "alpha_rad", "psi_rad", "q_radps", "az_mps2", "elevator_deg"):
        np.testing.assert_allclose(back[name], record[name], rtol=1e-9, atol=1e-9, err_msg=name)
    np.testing.assert_allclose(back["rho_kgpm3"], 1.225, rtol=1e-6)
    np.testing.assert_allclose(np.diff(back["h_m"]), np.diff(record["h_m"]), atol=1e-9)


def test_a_users_map_for_any_csv(tmp_path: Path) -> None:
    record = flight(10.0)
    path = tmp_path / "mine.csv"
    table = np.column_stack(
        [record["time_s"], np.degrees(record["q_radps"]), 1500 + 20 * record["elevator_deg"]]
    )
    np.savetxt(path, table, delimiter=",", header="t,pitch_rate,ele_us", comments="")
    user_map = tmp_path / "map.toml"
    user_map.write_text(
        '[signals.q_radps]\nmessage = "csv"\nfield = "pitch_rate"\nscale ='
        ' 0.017453292519943295\n[signals.elevator_deg]\nmessage = "csv"\nfield = "ele_us"\ntable ='
        " [[1100, -20], [1500, 0], [1900, 20]]\n"
    )
    back = import_log(path, user_map)
    np.testing.assert_allclose(back["q_radps"], record["q_radps"], atol=1e-12)
    np.testing.assert_allclose(back["elevator_deg"], record["elevator_deg"], atol=1e-9)


def test_rows_are_counted_before_memory_is_asked_for(tmp_path: Path) -> None:
    rows = 20_000_000
    zeros = pa.table({"time_s": np.zeros(rows), "q_radps": np.zeros(rows)})
    with pq.ParquetWriter(tmp_path / "a.parquet", zeros.schema, compression="zstd") as writer:
        for _ in range(5):
            writer.write_table(zeros)
    with pytest.raises(LogError, match=r"100000000 rows of 2 columns would take 1\.6 GB of memory"):
        FlightRecord.read(tmp_path / "a.parquet")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "time_s,q_radps," + ",".join(f"c{i}" for i in range(6000)) + "\n0,1\n",
            "has 6002 columns; at most 5000",
        ),
        ("time_s,q_radps\n" + ",".join(["1"] * 9000) + "\n", "has 9000 columns; at most 5000"),
        ("time_s,q_radps\n" + "1" * 1_500_000, "line 2: has more than 1 MB"),
        (
            "time_s," + ",".join(f"c{i}" for i in range(4000)) + "\n" + "1\n" * 100_000,
            "4001 columns would take 3.2 GB",
        ),
        (
            '# flight_record {"a":' + "[" * 3000 + "]" * 3000 + "}\ntime_s,q_radps\n0,1\n1,1\n",
            "metadata is damaged",
        ),
        (
            '# flight_record {"grid_hz":' + "1" * 5000 + "}\ntime_s,q_radps\n0,1\n1,1\n",
            "metadata is damaged",
        ),
        (
            '# flight_record {"grid_hz":1' + "0" * 400 + "}\ntime_s,q_radps\n0,1\n1,1\n",
            "metadata is damaged",
        ),
        ('# flight_record {"native_hz":[1]}\ntime_s,q_radps\n0,1\n1,1\n', "metadata is damaged"),
        ('time_s,q_radps\n0,1\n"1,2\n', "not a readable flight record"),
    ],
)
def test_tables_that_are_made_to_harm_are_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(LogError, match=said):
        import_log(tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("column", "said"),
    [
        (pa.array([[1.0, 2.0]] * 50), "holds list<"),
        (pa.array([{"a": 1.0}] * 50), "holds struct<"),
        (pa.array([b"\xff\xfe"] * 50), "not a readable Parquet file"),
        (
            pa.Array.from_buffers(pa.string(), 50, pa.array([b"\xff\xfe"] * 50).buffers()),
            "not a readable Parquet file",
        ),
    ],
)
@pytest.mark.parametrize("mapped", [True, False])
def test_columns_of_lists_structs_and_bytes_are_refused(
    tmp_path: Path, column: pa.Array, said: str, mapped: bool
) -> None:
    name = "odd" if mapped else "q_radps"
    pq.write_table(pa.table({"time_s": np.arange(50) * 0.02, name: column}), tmp_path / "a.parquet")
    (tmp_path / "map.toml").write_text('[signals.q_radps]\nmessage = "csv"\nfield = "odd"\n')
    with pytest.raises(LogError, match=said):
        import_log(tmp_path / "a.parquet", tmp_path / "map.toml" if mapped else None)


def test_columns_that_a_map_does_not_name_are_not_read(tmp_path: Path) -> None:
    table = pa.table(
        {"time_s": np.arange(50) * 0.02, "q": np.ones(50), "other": pa.array([[b"\xff"]] * 50)}
    )
    pq.write_table(table, tmp_path / "a.parquet")
    (tmp_path / "map.toml").write_text('[signals.q_radps]\nmessage = "csv"\nfield = "q"\n')
    assert len(import_log(tmp_path / "a.parquet", tmp_path / "map.toml")) == 50


def test_numbers_written_as_packed_texts_are_read(tmp_path: Path) -> None:
    values = [f"{k % 7}.5" if k else None for k in range(50)]
    pq.write_table(
        pa.table({"time_s": np.arange(50) * 0.02, "q_radps": values}), tmp_path / "a.parquet"
    )
    read = FlightRecord.read(tmp_path / "a.parquet")["q_radps"]
    assert np.isnan(read[0])
    np.testing.assert_array_equal(read[1:], [k % 7 + 0.5 for k in range(1, 50)])


@pytest.mark.parametrize(
    ("name", "factor"),
    [
        ("velocities/u-fps", 0.3048),
        ("accelerations/udot-ft_sec2", 0.3048),
        ("velocities/vtrue-kts", 1852.0 / 3600.0),
        ("inertia/weight-lbs", 0.45359237 * 9.80665),
        ("aero/qbar-psf", 0.45359237 * 9.80665 / 0.3048**2),
        ("inertia/mass-slugs", 0.45359237 * 9.80665 / 0.3048),
        ("aero/alpha-deg", 1.0),
        ("attitude/psi-rad", 1.0),
    ],
)
def test_suffixes_are_units(name: str, factor: float) -> None:
    assert si_factor(name) == pytest.approx(factor, rel=1e-6)


def test_a_csv_dialect_is_one_entry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = ["t", "xp/airspeed_kmh"]
    assert csv_dialect_of(names) == "csv"
    dialect = CsvDialect(
        "xp",
        "XP",
        "xp/",
        lambda n: n[1].startswith("xp/"),
        lambda n: 1.0 / 3.6 if "kmh" in n else 1.0,
    )
    monkeypatch.setitem(cast("dict[str, CsvDialect]", CSV_DIALECTS), "xp", dialect)
    assert csv_dialect_of(names) == "xp"
    (tmp_path / "a.csv").write_text("t,xp/airspeed_kmh\n0,36\n1,72\n")
    raw = read_csv(tmp_path / "a.csv", dialect=dialect)
    assert (raw.dialect, raw.vehicle) == ("xp", "XP")
    assert raw.messages[("csv", 0)].fields["airspeed_kmh"] == pytest.approx([10.0, 20.0])


def test_cells_that_are_no_numbers_are_dropouts_and_columns_of_words_stay_words(
    tmp_path: Path,
) -> None:
    rows = [f"{0.1 * k:.1f},{k},mode" for k in range(10)]
    rows[3] = "0.3,oops,mode"
    (tmp_path / "a.csv").write_text("t, x,word\n" + "\n".join(rows) + "\n")
    raw = read_csv(tmp_path / "a.csv")
    table = raw.messages[("csv", 0)]
    assert np.flatnonzero(np.isnan(table.fields["x"])).tolist() == [3]
    assert set(table.fields["word"]) == {"mode"}
    (finding,) = raw.findings
    assert (finding.code, finding.channel, finding.numbers) == (
        "damaged-cells",
        "x",
        {"cells": 1.0, "line": 5.0},
    )
    assert list(
        read_csv(tmp_path / "a.csv", {"csv": frozenset({"x"})}).messages[("csv", 0)].fields
    ) == ["x"]


def test_rows_without_a_time_are_left_out(tmp_path: Path) -> None:
    pq.write_table(
        pa.table({"time": [0.0, None, 0.2, 0.3], "x": [1.0, 2.0, 3.0, 4.0]}), tmp_path / "a.parquet"
    )
    table = read_parquet(tmp_path / "a.parquet").messages[("csv", 0)]
    assert table.time_s.tolist() == [0.0, 0.2, 0.3]
    assert table.fields["x"].tolist() == [1.0, 3.0, 4.0]
    with pytest.raises(LogError, match="would take"):
        read_parquet(tmp_path / "a.parquet", max_bytes=100)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x,y\n1,2\n3,4\n", "no time column; name it in a map .* its columns are x, y;"),
        ("t,x\n0,1\n", "only 1 rows"),
        ("t,x\nsoon,1\nlater,2\n", "the time column t holds text"),
        ("t,x\n0,1\nnan,2\n", "fewer than two numbers"),
        ("t,x\n0,1,2\n1,1,2\n", "line 2: has 3 cells, the header 2"),
    ],
)
def test_tables_that_are_no_flight(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(LogError, match=said):
        read_csv(tmp_path / "a.csv")


def test_a_record_is_told_by_content_and_its_cells_are_numbers(tmp_path: Path) -> None:
    (tmp_path / "a.parquet").write_text(
        '# flight_record {"a": 1}\ntime_s,q_radps,manoeuvre\n0,1,\n1,,pull\n'
    )
    columns, metadata = read_record(tmp_path / "a.parquet")
    assert metadata == '{"a": 1}'
    assert columns["manoeuvre"].tolist() == ["", "pull"]
    assert np.isnan(columns["q_radps"][1])
    for text, said in (
        ("time_s,q_radps\n0,x\n", "row 1: column q_radps holds 'x'"),
        ("time_s,q\n0,1\n", "unknown column 'q'"),
    ):
        (tmp_path / "b.csv").write_text(text)
        with pytest.raises(LogError, match=said):
            read_record(tmp_path / "b.csv")


def test_a_small_tables_names_stay_texts(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("manoeuvre,start_s,note\n3211,1,a\n12,2.5,\n")
    found = read_small_table(tmp_path / "m.csv")
    assert found["manoeuvre"].tolist() == ["3211", "12"]
    assert found["start_s"].tolist() == [1.0, 2.5]
    assert found["note"].tolist() == ["a", ""]
