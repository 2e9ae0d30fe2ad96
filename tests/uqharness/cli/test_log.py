"""`uqharness log info` and `log import`: what they print and write, their exit codes and errors."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest

from sysid.logs.card import read_card
from sysid.logs.dataflash_writer import write_dataflash
from sysid.logs.signal_map import shipped_map
from sysid.record import FlightRecord
from tests.helpers.log_writers import write_text_log, write_tlog
from tests.helpers.page_checks import problems, words_of
from tests.helpers.places import TESTS
from tests.helpers.synthetic import flight
from uqharness.cli.main import main

CARD = TESTS / "sysid" / "data" / "airframe.toml"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "flight.bin"
    write_dataflash(
        flight(duration_s=40.0, start_s=5.0), path, read_card(CARD), vehicle="ArduPlane V4.6.0"
    )
    return path


def test_info_as_text(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["log", "info", str(log), "--aircraft", str(CARD), "--no-cache"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "flight.bin (dataflash) is good for"
    assert "  yes  identification: " in "\n".join(lines[1:4])
    assert lines[4] == "vehicle      ArduPlane V4.6.0"
    assert len(lines) <= 25
    label = shipped_map("dataflash").entries["q_radps"][0].label
    assert f"q_radps 50.0 Hz {label};" in "\n".join(lines)


def test_a_log_that_serves_nothing_exits_1(tmp_path: Path) -> None:
    write_tlog(tmp_path / "copter.tlog", flight(20.0), mav_type=2)
    assert main(["log", "info", str(tmp_path / "copter.tlog"), "--no-cache"]) == 1


def test_import_writes_a_record_and_the_cache_gives_the_same(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    common = ["--aircraft", str(CARD), "--cache", str(tmp_path / "cache")]
    assert main(["log", "import", str(log), "--out", str(tmp_path / "a.parquet"), *common]) == 0
    stored = list((tmp_path / "cache").iterdir())
    assert len(stored) == 1
    assert f"{tmp_path / 'a.parquet'}: 2000 rows at 50 Hz, " in capsys.readouterr().out
    assert (
        main(["log", "import", str(log), "--out", str(tmp_path / "b.csv"), "--json", *common]) == 0
    )
    assert json.loads(capsys.readouterr().out)["rows"] == 2000
    a, b = FlightRecord.read(tmp_path / "a.parquet"), FlightRecord.read(tmp_path / "b.csv")
    for name in a.columns:
        np.testing.assert_array_equal(a[name], b[name])
    stored[0].write_bytes(b"PAR1 broken")  # an interrupted run's leavings are made anew
    assert main(["log", "import", str(log), "--out", str(tmp_path / "c.parquet"), *common]) == 0
    np.testing.assert_array_equal(
        FlightRecord.read(tmp_path / "c.parquet")["q_radps"], a["q_radps"]
    )


def test_import_labels_manoeuvres_from_a_table(log: Path, tmp_path: Path) -> None:
    table = tmp_path / "table.csv"
    table.write_text("manoeuvre,start_s,end_s\npull,10,12\n")
    words = [
        "log",
        "import",
        str(log),
        "--out",
        str(tmp_path / "a.parquet"),
        "--manoeuvres",
        str(table),
        "--no-cache",
    ]
    assert main(words) == 0
    record = FlightRecord.read(tmp_path / "a.parquet")
    inside = record["time_s"][record["manoeuvre"] == "pull"]
    assert 10.0 <= inside[0] < 10.05
    assert 11.95 < inside[-1] <= 12.0


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log with a pitch doublet at 20 s and a roll doublet at 30 s."""
    record = flight(duration_s=40.0, amplitude=0.2)
    time = record["time_s"]
    doublet = np.where((time >= 0.0) & (time < 0.5), 4.0, 0.0)
    inputs = {"elevator_deg": 20.0, "aileron_deg": 30.0, "rudder_deg": 99.0}
    columns = {
        n: sum(
            s * np.interp(time - at - d, time, doublet, left=0.0) for s, d in ((1, 0.0), (-1, 0.5))
        )
        for n, at in inputs.items()
    }
    path = tmp_path_factory.mktemp("flown") / "flown.bin"
    write_dataflash(
        record.with_columns({**columns, "throttle_pct": np.full(time.size, 50.0)}),
        path,
        read_card(CARD),
    )
    return path


def test_info_lists_the_manoeuvres_that_it_finds(
    flights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["log", "info", str(flights), "--aircraft", str(CARD), "--no-cache"]
    main([*words, "--json"])
    result = json.loads(capsys.readouterr().out)["manoeuvres"]
    assert [(m["axis"], m["kind"], m["unit"]) for m in result] == [
        ("pitch", "doublet", "deg"),
        ("roll", "doublet", "deg"),
    ]
    assert [m["start_s"] for m in result] == pytest.approx([20.0, 30.0], abs=0.03)
    main(words)
    assert (
        "  pitch doublet          20.00 to 21.00 s, +4 deg" in capsys.readouterr().out.splitlines()
    )


def test_import_labels_what_is_found(
    flights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        "--aircraft",
        str(CARD),
        *shlex.split("--no-cache --manoeuvres found --out"),
        str(tmp_path / "a.parquet"),
    ]
    assert main(["log", "import", str(flights), *words]) == 0
    record = FlightRecord.read(tmp_path / "a.parquet")
    assert set(record["manoeuvre"]) == {"", "pitch doublet", "roll doublet"}
    steady = flight(duration_s=20.0, amplitude=0.0)
    write_dataflash(steady, tmp_path / "still.bin", read_card(CARD))
    assert main(["log", "import", str(tmp_path / "still.bin"), *words]) == 2
    assert "no manoeuvre was found in the commands" in capsys.readouterr().err


def test_bad_arguments_exit_2(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "text.bin").write_text("This is a text about flying.\n" * 50)
    for words, output in (
        (["import", log, "--out", tmp_path / "a.xls"], "must end with .parquet or .csv"),
        (["import", log, "--out", tmp_path / "file" / "a.csv"], "cannot be written"),
        (["info", log, "--aircraft", "nosuch"], "aircraft 'nosuch' not found"),
        (["info", log, "--map", tmp_path / "none.toml"], "none.toml: cannot read this signal map"),
        (["info", tmp_path / "none.bin"], "none.bin: no such file"),
        (["info", tmp_path / "text.bin"], "text.bin: "),
    ):
        assert main(["log", *map(str, words), "--no-cache"]) == 2
        printed = capsys.readouterr().err
        assert printed.startswith("uqharness: error: ")
        assert output in printed
        assert printed.count("\n") == 1


def test_a_logs_vehicle_and_a_files_name_cannot_steer_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "x\x1b[31m.log"
    write_text_log(log, flight(duration_s=40.0, start_s=5.0), "ArduPlane \x1b]0;owned\x07")
    main(["log", "info", str(log), "--no-cache"])
    main(["log", "info", str(tmp_path / "none\x1b[2J"), "--no-cache"])
    observed = capsys.readouterr()
    assert r"\x1b]0;owned\x07" in observed.out
    assert r"none\x1b[2J: " in observed.err
    assert "\x1b" not in observed.out + observed.err


def test_info_writes_a_page_when_asked_and_says_the_same(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["log", "info", str(log), "--aircraft", str(CARD), "--json", "--no-cache"]
    assert main(words) == 0
    plain = capsys.readouterr().out
    table = tmp_path / "manoeuvres.csv"
    table.write_text("manoeuvre,start_s,end_s\npush-over,10,14\n", encoding="utf-8")
    path = tmp_path / "page.html"
    assert main([*words, "--out", str(path), "--manoeuvres", str(table)]) == 0
    assert capsys.readouterr().out == plain
    page = path.read_text(encoding="utf-8")
    assert problems(page) == []
    assert "push-over" in words_of(page)


def test_a_proposed_map_is_read_by_info_and_never_overwrites(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = flight(duration_s=30.0)
    rows = zip(record["time_s"], record["V_mps"], record["theta_rad"], strict=True)
    lines = ["Time (ms);TAS [kt];Pitch"]
    lines += [f"{1e3 * t:.0f};{v * 3.6 / 1.852:.6f};{theta:.9f}" for t, v, theta in rows]
    log, out = tmp_path / "a.csv", tmp_path / "map.toml"
    log.write_text("\n".join(lines))
    assert main(["log", "map", str(log), "--out", str(out), "--json"]) == 0
    signals = json.loads(capsys.readouterr().out)["signals"]
    assert signals["V_mps"]["scale"] == pytest.approx(1.852 / 3.6)
    assert set(signals) == {"V_mps", "theta_rad"}
    main(["log", "info", str(log), "--map", str(out), "--no-cache"])
    assert "csv.TAS [kt]" in capsys.readouterr().out
    edited = out.read_text() + "# mine"
    out.write_text(edited)
    assert main(["log", "map", str(log), "--out", str(out)]) == 2
    assert "exists" in capsys.readouterr().err
    assert out.read_text() == edited
    log.write_text("time,a,b\n0,1,2\n1,2,3\n2,3,1\n")
    assert main(["log", "map", str(log), "--out", str(tmp_path / "b.toml")]) == 1
