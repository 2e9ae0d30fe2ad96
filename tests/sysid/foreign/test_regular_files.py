"""Special files are refused at once; TOML, JSON and digests of regular ones."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from sysid.foreign.regular_files import (
    ParseError,
    open_regular,
    parse_json,
    parse_toml,
    read_regular,
    require_regular,
    sha256_hex,
    sha256_of_parts,
)


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


# TOML and JSON from anywhere: plain types, or one error with its line.

DEEP = 100_000


def test_what_is_sound_is_read() -> None:
    assert parse_toml("[a]\nb = [1, 2.5]\n") == {"a": {"b": [1, 2.5]}}
    assert parse_json(b'{"a": [1, null]}') == parse_json('{"a": [1, null]}') == {"a": [1, None]}


@pytest.mark.parametrize(
    ("text", "line", "word"),
    [
        ("a = 1\nb = = 2\n", 2, "TOML"),
        ("a = 1\nb = [", 2, "TOML"),
        (f"a = {'[' * DEEP}{']' * DEEP}", None, "deeply"),
        (f"a = {'9' * 5000}", None, "digits"),
        ("a = 2024-02-31", 1, "date"),
        ("a = 1\na = 2", 2, "TOML"),
    ],
)
def test_toml_that_is_none(text: str, line: int | None, word: str) -> None:
    with pytest.raises(ParseError, match=word) as result:
        parse_toml(text)
    assert result.value.line == line


@pytest.mark.parametrize(
    ("text", "line", "word"),
    [
        ('{"a": 1,\n "b" 2}', 2, "JSON"),
        ("", 1, "JSON"),
        (f"{'[' * DEEP}{']' * DEEP}", None, "deeply"),
        ("9" * 5000, None, "digits"),
        (b'{"a": "\xff"}', None, "UTF-8"),
    ],
)
def test_json_that_is_none(text: str | bytes, line: int | None, word: str) -> None:
    with pytest.raises(ParseError, match=word) as result:
        parse_json(text)
    assert result.value.line == line


# Digests of files and bytes.

OF_ABC = (
    "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"  # FIPS 180-2, appendix B.1
)


def test_bytes_have_the_published_digest() -> None:
    assert sha256_hex(b"abc") == OF_ABC
    assert sha256_hex(b"abd") != OF_ABC
    assert sha256_of_parts(part for part in (b"a", memoryview(b"bc"))) == OF_ABC
    assert sha256_of_parts([b"bc", b"a"]) != OF_ABC
