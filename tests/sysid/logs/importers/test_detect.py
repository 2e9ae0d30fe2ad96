"""A file's kind by its content, whatever its name."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from sysid.errors import LogError
from sysid.logs.detect import detect, frame_length, frame_time
from sysid.logs.load import import_log
from sysid.record import FlightRecord
from tests.helpers.log_writers import write_text_log, write_tlog, write_ulog
from tests.helpers.synthetic import flight


def test_every_kind_is_told_under_a_strangers_name(
    tmp_path: Path, bin_log: Path, flown: FlightRecord
) -> None:
    short = flown.rows(slice(0, 200))
    write_text_log(tmp_path / "dataflash-text", short)
    write_tlog(tmp_path / "tlog", short)
    write_ulog(
        tmp_path / "ulog",
        {"airspeed": ((short["time_s"] * 1e6).astype(int), {"v": short["V_mps"]})},
    )
    for kind in ("csv", "parquet"):
        short.write(tmp_path / f"a.{kind}")
        (tmp_path / f"a.{kind}").rename(tmp_path / kind)
    (tmp_path / "dataflash").write_bytes(bin_log.read_bytes())
    (tmp_path / "jsbsim-csv").write_text("Time,/fdm/jsbsim/velocities/u-fps\n0,1\n0.1,1\n")
    for path in tmp_path.iterdir():
        if path.suffix:
            continue
        assert detect(path) == path.name
        path.rename(path.with_suffix(".png"))
        assert detect(path.with_suffix(".png")) == path.name


def test_a_binary_log_whose_beginning_is_lost_is_told_by_its_first_format(
    tmp_path: Path, bin_log: Path
) -> None:
    whole = bin_log.read_bytes()
    (tmp_path / "a").write_bytes(b"\0" * 50 + whole)
    assert detect(tmp_path / "a") == "dataflash"
    (tmp_path / "a").write_bytes(b"\0" * 50 + whole.replace(b"\xa3\x95\x80", b"\xa3\x95\x81"))
    with pytest.raises(LogError, match="not recognised"):
        detect(tmp_path / "a")


def test_telemetry_between_noise_is_told_and_noise_is_not(tmp_path: Path) -> None:
    write_tlog(tmp_path / "a.tlog", flight(10.0))
    data = (tmp_path / "a.tlog").read_bytes()
    (tmp_path / "a.tlog").write_bytes(b"\x55" * 200 + data)
    assert detect(tmp_path / "a.tlog") == "tlog"
    (tmp_path / "a.tlog").write_bytes(bytes(b ^ 0x55 for b in data))
    with pytest.raises(LogError, match="not recognised"):
        detect(tmp_path / "a.tlog")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "the file is empty"),
        (b"PK\x03\x04rest", "a ZIP archive .unpack it first."),
        (b"\x1f\x8brest", "a gzip archive"),
        (b"name,colour\nrobin,red\n", "not recognised .* first line is 'name,colour'"),
    ],
)
def test_what_is_no_log_is_refused_by_name(tmp_path: Path, content: bytes, said: str) -> None:
    (tmp_path / "a.bin").write_bytes(content)
    with pytest.raises(LogError, match=said):
        detect(tmp_path / "a.bin")


def test_a_folder_and_a_missing_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="folder"):
        detect(tmp_path)
    with pytest.raises(LogError, match="no such file"):
        detect(tmp_path / "a.bin")


def test_a_table_of_numbers_is_one_and_of_words_is_none(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("# made by hand\nt,pitch\n0,1\n1,\n")
    assert detect(tmp_path / "a") == "csv"
    (tmp_path / "a").write_text("# made by hand\nt,pitch\n0,1\n1,up\n")
    with pytest.raises(LogError, match="not recognised"):
        detect(tmp_path / "a")


def test_lengths_of_frames_of_both_versions() -> None:
    """Header, payload and checksum: 6 + n + 2 bytes, or 10 + n + 2, and 13 of a signature."""
    for n in (0, 28, 255):
        assert frame_length(bytes([0xFE, n, 0, 1, 1, 30]), 0) == 6 + n + 2
        assert frame_length(b"x" + bytes([0xFD, n, 0, 0, 0, 1, 1, 30, 0, 0]), 1) == 10 + n + 2
        assert frame_length(bytes([0xFD, n, 1, 0, 0, 1, 1, 30, 0, 0]), 0) == 10 + n + 2 + 13
    assert frame_time(struct.pack(">Q", 1_700_000_000_500_000), 0) == 1_700_000_000.5


def test_an_encrypted_parquet_file_is_named_as_such(tmp_path: Path) -> None:
    (tmp_path / "a.parquet").write_bytes(b"PARE" + bytes(100) + b"PARE")
    with pytest.raises(LogError, match="encrypted Parquet"):
        import_log(tmp_path / "a.parquet")
