"""Tables as logs: separators, units, times, missing columns, and refusals."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from sysid.errors import LogError
from sysid.logs.csv_dialects import si_factor
from sysid.logs.load import import_log
from sysid.logs.tables import read_csv, read_parquet, read_record
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


@pytest.mark.parametrize(
    ("text", "output"),
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
def test_tables_that_are_made_to_harm_are_refused(tmp_path: Path, text: str, output: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(LogError, match=output):
        import_log(tmp_path / "a.csv")


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
    ("text", "output"),
    [
        ("x,y\n1,2\n3,4\n", "no time column; name it in a map .* its columns are x, y;"),
        ("t,x\n0,1\n", "only 1 rows"),
        ("t,x\nsoon,1\nlater,2\n", "the time column t holds text"),
        ("t,x\n0,1\nnan,2\n", "fewer than two numbers"),
        ("t,x\n0,1,2\n1,1,2\n", "line 2: has 3 cells, the header 2"),
    ],
)
def test_tables_that_are_no_flight(tmp_path: Path, text: str, output: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(LogError, match=output):
        read_csv(tmp_path / "a.csv")


def test_a_record_is_told_by_content_and_its_cells_are_numbers(tmp_path: Path) -> None:
    (tmp_path / "a.parquet").write_text(
        '# flight_record {"a": 1}\ntime_s,q_radps,manoeuvre\n0,1,\n1,,pull\n'
    )
    columns, metadata = read_record(tmp_path / "a.parquet")
    assert metadata == '{"a": 1}'
    assert columns["manoeuvre"].tolist() == ["", "pull"]
    assert np.isnan(columns["q_radps"][1])
    for text, output in (
        ("time_s,q_radps\n0,x\n", "row 1: column q_radps holds 'x'"),
        ("time_s,q\n0,1\n", "unknown column 'q'"),
    ):
        (tmp_path / "b.csv").write_text(text)
        with pytest.raises(LogError, match=output):
            read_record(tmp_path / "b.csv")


# Tables as people have them: separators, decimal signs, units, times, angles, missing columns.

NAMES = ("TAS", "roll", "pitch", "heading", "p", "q", "r", "STAB_POS", "RUDDER_POS")
SIGNALS = (
    "V_mps",
    "phi_rad",
    "theta_rad",
    "psi_rad",
    "p_radps",
    "q_radps",
    "r_radps",
    "elevator_pos_deg",
    "rudder_pos_deg",
)
MAP = "".join(
    f'[signals.{s}]\nmessage = "csv"\nfield = "{n}"\n' for s, n in zip(SIGNALS, NAMES, strict=True)
)


def rows(count: int = 500) -> list[tuple[float, list[float]]]:
    out = []
    for k in range(count):
        t = 0.02 * k
        psi = math.remainder(2.9 + 0.05 * t, 2.0 * math.pi)
        wave = [math.sin(t), math.cos(t), math.sin(2.0 * t), 0.05 + 0.01 * math.sin(t)]
        out.append(
            (
                t,
                [
                    20.0 + wave[0],
                    0.2 * wave[0],
                    0.03 * wave[0],
                    psi,
                    0.2 * wave[1],
                    0.03 * wave[1],
                    wave[3],
                    5.0 * wave[0],
                    3.0 * wave[2],
                ],
            )
        )
    return out


def table(
    path: Path,
    time_name: str,
    time: object,
    separator: str = ",",
    decimal: str = ".",
    top: str = "",
) -> Path:
    lines = [separator.join([time_name, *NAMES])]
    for t, values in rows():
        cells = [time(t), *(f"{v:.9f}" for v in values)]  # type: ignore[operator]
        lines.append(separator.join(cell.replace(".", decimal) for cell in cells))
    path.write_text(top + "\n".join(lines) + "\n", encoding="cp1252")
    return path


def clock(t: float) -> str:
    return f"2024-05-01T23:59:{55 + t:09.6f}" if t < 5.0 else f"2024-05-02T00:00:{t - 5.0:09.6f}"


@pytest.mark.parametrize(
    ("name", "time", "line"),
    [
        ("time", "{:.2f}", ""),
        ("TIME", "{:.2f}", ""),
        ("Delta", "{:.2f}", 'field = "Delta"\nunit = "s"'),
        ("Zeit [ms]", "ms", 'column = "Zeit [ms]"\nunit = "ms"'),
        ("time_us", "us", ""),
        ("TimeUS", "us", ""),
        ("timestamp", "us", ""),
        ("timestamp", "ms", ""),
        ("odd", "us", 'message = "csv"\nfield = "odd"\nscale = 1e-6'),
        ("stamp", "iso", 'field = "stamp"\nunit = "iso"'),
        ("UTC time", "iso", ""),
        ("Zeitstempel", "iso", ""),
        ("Lcl Time", "day", ""),
    ],
)
@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", ","), ("\t", ".")])
def test_any_time_column_and_any_separator(
    tmp_path: Path, name: str, time: str, line: str, separator: str, decimal: str
) -> None:
    write = {
        "ms": lambda t: f"{5e5 + 1e3 * t:.0f}",
        "us": lambda t: f"{5e8 + 1e6 * t:.0f}",
        "iso": clock,
        "day": lambda t: clock(t).split("T")[1],
    }.get(time, lambda t: f"{t:.2f}")
    path = table(tmp_path / "a.csv", name, write, separator, decimal)
    (tmp_path / "m.toml").write_text(MAP + (f"[signals.time_s]\n{line}\n" if line else ""))
    record = import_log(path, tmp_path / "m.toml")
    np.testing.assert_allclose(np.diff(record["time_s"]), 0.02, atol=1e-6)
    np.testing.assert_allclose(record["V_mps"], [v[0] for _, v in rows()], atol=1e-8)
    guessed = [f for f in record.metadata.findings if f.code == "time-unit"]
    assert len(guessed) == (name == "timestamp")
    if guessed:
        words = {"us": "steps of 20000 s: .* microseconds", "ms": "steps of 20 s: .* milliseconds"}
        assert guessed[0].mend.endswith(f'unit = "{time}"')
        with pytest.raises(AssertionError, match=words[time]):
            raise AssertionError(guessed[0].message)


def test_seconds_that_cannot_be_are_an_error_with_the_line_to_write(tmp_path: Path) -> None:
    path = table(tmp_path / "a.csv", "x", lambda t: f"{1e6 * t:.0f}")
    (tmp_path / "m.toml").write_text(MAP + '[signals.time_s]\nfield = "x"\nunit = "s"\n')
    with pytest.raises(LogError, match=r'steps of 20000 s: .* microseconds.* unit = "us"'):
        import_log(path, tmp_path / "m.toml")


def test_what_a_map_names_and_the_table_lacks_is_said_with_the_columns(tmp_path: Path) -> None:
    path = table(tmp_path / "a.csv", "time", lambda t: f"{t:.2f}")
    (tmp_path / "m.toml").write_text('[signals.V_mps]\nmessage = "csv"\nfield = "TSA"\n')
    with pytest.raises(LogError, match=r"its columns are time, TAS, roll.*log map FILE --out"):
        import_log(path, tmp_path / "m.toml")
    (tmp_path / "m.toml").write_text(MAP.replace('"TAS"', '"TSA"'))
    codes = {f.code: f for f in import_log(path, tmp_path / "m.toml").metadata.findings}
    assert codes["not-in-log"].channel == "V_mps"
    with pytest.raises(LogError, match=r"unknown column 'time'.*log map FILE --out"):
        import_log(path)


def test_a_line_of_units_and_a_number_sign_in_a_name(tmp_path: Path) -> None:
    lines = ["time;speed #1;note", "s;kt;-", *(f"{0.02 * k:.2f};{20 + k};#{k}" for k in range(50))]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    (tmp_path / "m.toml").write_text('[signals.V_mps]\nmessage = "csv"\nfield = "speed #1"\n')
    record = import_log(tmp_path / "a.csv", tmp_path / "m.toml")
    np.testing.assert_allclose(record["V_mps"], 20.0 + np.arange(50))


def test_a_record_whose_times_are_no_seconds_says_so(tmp_path: Path) -> None:
    time = 20000.0 * np.arange(200)
    FlightRecord({"time_s": time, "q_radps": np.sin(time * 1e-6)}).write(tmp_path / "r.csv")
    (finding,) = [
        f for f in import_log(tmp_path / "r.csv").metadata.findings if f.code == "time-unit"
    ]
    assert finding.severity == "error"
    assert "microseconds" in finding.message
