"""The reader process: limits of time and memory, damage, and exact results."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from sysid.errors import LogError
from sysid.foreign import limited
from sysid.foreign.limited import LIMITS, Limit
from sysid.foreign.raw import RawLog
from sysid.logs import tables, tlog, ulog
from sysid.logs.load import import_log
from sysid.logs.signal_map import shipped_map
from sysid.record import FlightRecord
from tests.helpers.log_writers import write_text_log, write_tlog, write_ulog
from tests.helpers.places import ROOT

has_address_limit = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="no limit of address space here"
)


def _message(kind: bytes, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), kind[0]) + body


def _slow_ulog(path: Path) -> Path:
    """Formats that hold one another, each many times: 30 KB that keep pyulog for minutes."""
    nested = b"".join(
        _message(b"F", f"f{i}:f{i + 1}[200] a;f{i + 1}[200] b;".encode()) for i in range(6)
    ) + _message(b"F", b"f6:float z;")
    top = _message(b"F", b"sensor_combined:uint64_t timestamp;f0 q;")
    data = _message(b"A", b"\0\0\0sensor_combined") + _message(b"D", bytes(602)) * 50
    path.write_bytes(
        b"ULog\x01\x12\x35\x01" + bytes(8) + _message(b"B", bytes(40)) + nested + top + data
    )
    return path


@pytest.fixture
def short_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LIMITS, "ulog", Limit(1.0, 1e6, 400_000_000, 8.0))


def _same(a: RawLog, b: RawLog) -> None:
    assert list(a.messages) == list(b.messages)
    for key, table in a.messages.items():
        np.testing.assert_array_equal(table.time_s, b.messages[key].time_s)
        assert list(table.fields) == list(b.messages[key].fields)
        for name, values in table.fields.items():
            assert values.dtype == b.messages[key].fields[name].dtype
            np.testing.assert_array_equal(values, b.messages[key].fields[name])
    remainder = [
        (
            r.dialect,
            dict(r.counts),
            dict(r.parameters),
            r.texts,
            r.vehicle,
            dict(r.facts),
            r.findings,
        )
        for r in (a, b)
    ]
    assert remainder[0] == remainder[1]


def test_what_comes_through_the_child_is_what_the_reader_gives(
    tmp_path: Path, flown: FlightRecord
) -> None:
    write_tlog(tmp_path / "a.tlog", flown)
    expected = shipped_map("tlog").field_selection()
    _same(
        limited.read_raw(tmp_path / "a.tlog", "tlog", expected),
        tlog.read(tmp_path / "a.tlog", expected),
    )
    time_us = flown["time_s"] * 1e6
    write_ulog(tmp_path / "a.ulg", {"airspeed": (time_us, {"true_airspeed_m_s": flown["V_mps"]})})
    _same(limited.read_raw(tmp_path / "a.ulg", "ulog", None), ulog.read(tmp_path / "a.ulg", None))
    flown.write(tmp_path / "a.parquet")
    _same(
        limited.read_raw(tmp_path / "a.parquet", "parquet", None),
        tables.read_parquet(tmp_path / "a.parquet"),
    )


def test_one_child_serves_several_files_and_a_refusal_does_not_end_it(
    tmp_path: Path, flown: FlightRecord
) -> None:
    flown.write(tmp_path / "a.csv")
    (tmp_path / "bad.csv").write_text("time_s,q_radps\n0,1\n1,what\n")
    FlightRecord.read(tmp_path / "a.csv")
    child = limited._children[os.getpid()]
    with pytest.raises(LogError, match="holds 'what', which is not a number"):
        FlightRecord.read(tmp_path / "bad.csv")
    FlightRecord.read(tmp_path / "a.csv")
    assert limited._children[os.getpid()] is child
    child.process.kill()
    child.process.wait()
    assert len(FlightRecord.read(tmp_path / "a.csv")) == len(flown)


@pytest.mark.usefixtures("short_time")
def test_a_log_that_would_take_minutes_is_refused_in_time_and_the_next_is_read(
    tmp_path: Path,
) -> None:
    start = time.monotonic()
    with pytest.raises(LogError, match=r"longer than the 1 s that a file of .* may take"):
        import_log(_slow_ulog(tmp_path / "slow.ulg"))
    assert time.monotonic() - start < 60.0
    time_us = np.arange(100) * 1e4
    write_ulog(
        tmp_path / "a.ulg", {"airspeed": (time_us, {"true_airspeed_m_s": np.full(100, 20.0)})}
    )
    assert len(import_log(tmp_path / "a.ulg")) == 100


@pytest.mark.slow
@has_address_limit
def test_a_log_that_would_fill_the_memory_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(LIMITS, "ulog", Limit(5.0, 1e6, 60_000_000, 8.0))
    fields = b"".join(b"float[60000] a%d;" % i for i in range(1500))
    body = [
        _message(b"B", bytes(40)),
        _message(b"F", b"airspeed:" + fields + b"uint64_t timestamp;"),
    ]
    body += [_message(b"A", b"\0\0\0airspeed"), _message(b"D", bytes(60002)) * 20]
    (tmp_path / "big.ulg").write_bytes(b"ULog\x01\x12\x35\x01" + bytes(8) + b"".join(body))
    # Where the system takes long over each request for memory that it refuses, the time limit comes
    # first.
    with pytest.raises(
        LogError, match=r"(of memory|longer than the \d+ s) that a file of .* may take"
    ):
        import_log(tmp_path / "big.ulg")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in the file system here")
def test_a_pipe_a_folder_and_a_device_are_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path, kind in (
        (tmp_path / "pipe", "a pipe"),
        (Path("/dev/zero"), "a device"),
        (tmp_path, "a folder"),
    ):
        with pytest.raises(LogError, match=f"is {kind}"):
            import_log(path)
        with pytest.raises(LogError, match=f"is {kind}"):
            FlightRecord.read(path)
    write_text_log(tmp_path / "a.log", _little())
    for name in ("map_path", "card_path"):
        with pytest.raises(LogError, match="is a pipe"):
            import_log(tmp_path / "a.log", **{name: tmp_path / "pipe"})


def _little() -> FlightRecord:
    names = (
        "V_mps",
        "phi_rad",
        "theta_rad",
        "psi_rad",
        "p_radps",
        "q_radps",
        "r_radps",
        "ax_mps2",
        "ay_mps2",
        "az_mps2",
        "elevator_deg",
        "aileron_deg",
        "rudder_deg",
        "throttle_pct",
    )
    return FlightRecord({"time_s": np.arange(100) * 0.02, **{n: np.full(100, 1.0) for n in names}})


def test_no_python_file_of_the_working_folder_runs_in_the_child(
    tmp_path: Path, flown: FlightRecord
) -> None:
    flown.write(tmp_path / "a.csv")
    for name in ("json", "queue", "numpy", "pandas", "signal", "sysid", "sitecustomize"):
        (tmp_path / f"{name}.py").write_text(f"open('ran-{name}', 'w')\n")
    code = (
        f"import sys; sys.path.append({str(ROOT)!r})\nfrom pathlib import Path\nfrom sysid.record"
        " import FlightRecord\n"
    )
    code += "print(len(FlightRecord.read(Path('a.csv'))))"
    done = subprocess.run(
        [sys.executable, "-P", "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        env={k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONSAFEPATH")},
    )
    assert done.stdout.strip() == str(len(flown))
    assert not list(tmp_path.glob("ran-*"))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")
def test_the_child_ends_with_a_killed_parent_even_in_the_middle_of_a_file(tmp_path: Path) -> None:
    slow = _slow_ulog(tmp_path / "slow.ulg")
    code = (
        f"import sys; sys.path.insert(0, {str(ROOT)!r})\nfrom pathlib import Path\nfrom"
        " sysid.foreign import limited\nimport"
        f" threading\nthreading.Thread(target=limited.read_raw, args=(Path({str(slow)!r}), 'ulog',"
        " None), daemon=True).start()\nimport os, time\nwhile os.getpid() not in"
        " limited._children:"
        " time.sleep(0.01)\ntime.sleep(2.0)\nprint(limited._children[os.getpid()].process.pid,"
        " flush=True)\ntime.sleep(600)\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    assert Path(f"/proc/{child}").exists()
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    parent.stdout.close()
    deadline = time.monotonic() + 30.0
    while (
        Path(f"/proc/{child}").exists()
        and "Z" not in Path(f"/proc/{child}/stat").read_text().split()[2]
    ):
        assert time.monotonic() < deadline, "the reader outlives its parent"
        time.sleep(0.05)


def test_progress_comes_through(
    tmp_path: Path, flown: FlightRecord, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The clock is no part of this test: a busy machine may take its time.
    monkeypatch.setitem(LIMITS, "tlog", Limit(600.0, 0.25e6, 300_000_000, 8.0))
    write_tlog(tmp_path / "one.tlog", flown, every=1)
    (tmp_path / "a.tlog").write_bytes((tmp_path / "one.tlog").read_bytes() * 6)
    shares: list[float] = []
    limited.read_raw(
        tmp_path / "a.tlog", "tlog", shipped_map("tlog").field_selection(), shares.append
    )
    assert shares
    assert all(0.0 <= share <= 1.0 for share in shares)
