"""Only regular files are read, at once and in bounds."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from sysid.foreign.regular_files import (
    in_words,
    open_regular,
    read_regular,
    read_regular_text,
    require_regular,
)


def test_a_regular_file_and_a_link_to_one_are_read(tmp_path: Path) -> None:
    file = tmp_path / "a.txt"
    file.write_bytes(b"x = 1\r\ny = 2\r")
    (tmp_path / "link.txt").symlink_to(file)
    assert read_regular(tmp_path / "link.txt") == file.read_bytes()
    assert read_regular_text(file) == "x = 1\ny = 2\n"
    assert require_regular(file).st_size == 13
    with open_regular(file) as handle:
        assert handle.readline() == b"x = 1\r\n"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in the file system here")
def test_pipes_sockets_devices_and_folders_are_refused_at_once_and_by_name(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    (tmp_path / "to-pipe").symlink_to(pipe)
    with socket.socket(socket.AF_UNIX) as server:
        where = os.getcwd()
        os.chdir(tmp_path)  # a socket's path has a short limit
        try:
            server.bind("socket")
        finally:
            os.chdir(where)
        for path, kind in (
            (pipe, "a pipe"),
            (tmp_path / "to-pipe", "a pipe"),
            (tmp_path / "socket", "a socket"),
            (tmp_path, "a folder"),
            (Path("/dev/zero"), "a device"),
        ):
            for reader in (require_regular, read_regular, open_regular):
                with pytest.raises(OSError, match="regular file") as refusal:
                    reader(path)
                assert refusal.value.strerror == f"is {kind}, not a regular file"
                assert refusal.value.filename == str(path)


def test_what_became_a_pipe_after_the_look_is_refused_without_waiting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(tmp_path / "pipe")
    monkeypatch.setattr("sysid.foreign.regular_files.require_regular", lambda path: None)
    with pytest.raises(OSError, match="is a pipe"):
        open_regular(tmp_path / "pipe")


def test_a_file_that_is_too_big_is_refused_before_memory_is_asked_for(tmp_path: Path) -> None:
    big = tmp_path / "big"
    with big.open("wb") as handle:
        handle.truncate(1 << 40)
    with pytest.raises(OSError, match="at most") as refusal:
        read_regular(big)
    assert refusal.value.strerror == "has 1100 GB; at most 64 MB are read here"
    exact = tmp_path / "exact"
    exact.write_bytes(b"x" * 100)
    assert len(read_regular(exact, max_bytes=100)) == 100
    with pytest.raises(OSError, match="has 100 bytes; at most 99 bytes"):
        read_regular(exact, max_bytes=99)


def test_a_file_that_says_it_is_empty_is_read_up_to_the_limit() -> None:
    endless = Path("/proc/self/maps")
    if not endless.exists():
        pytest.skip("this system has no /proc")
    assert endless.stat().st_size == 0
    with pytest.raises(OSError, match="at most 10 bytes"):
        read_regular(endless, max_bytes=10)


def test_a_missing_file_and_a_name_that_cannot_be_one(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_regular(tmp_path / "none")
    with pytest.raises(OSError, match="is no file name"):
        read_regular(Path("a\0b"))


def test_sizes_in_words() -> None:
    assert [in_words(n) for n in (12, 62_000, 19_700_000, 3_200_000_000)] == [
        "12 bytes",
        "62 KB",
        "19.7 MB",
        "3.2 GB",
    ]
