"""The format of a file by its content, whatever its name."""

from __future__ import annotations

from pathlib import Path

import pytest

from sysid.errors import LogError
from sysid.logs.detect import detect
from sysid.record import FlightRecord
from tests.helpers.log_writers import write_text_log, write_tlog, write_ulog


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
    complete = bin_log.read_bytes()
    (tmp_path / "a").write_bytes(b"\0" * 50 + complete)
    assert detect(tmp_path / "a") == "dataflash"
    (tmp_path / "a").write_bytes(b"\0" * 50 + complete.replace(b"\xa3\x95\x80", b"\xa3\x95\x81"))
    with pytest.raises(LogError, match="not recognised"):
        detect(tmp_path / "a")


@pytest.mark.parametrize(
    ("content", "output"),
    [
        (b"", "the file is empty"),
        (b"PK\x03\x04rest", "a ZIP archive .unpack it first."),
        (b"\x1f\x8brest", "a gzip archive"),
        (b"name,colour\nrobin,red\n", "not recognised .* first line is 'name,colour'"),
    ],
)
def test_what_is_no_log_is_refused_by_name(tmp_path: Path, content: bytes, output: str) -> None:
    (tmp_path / "a.bin").write_bytes(content)
    with pytest.raises(LogError, match=output):
        detect(tmp_path / "a.bin")
