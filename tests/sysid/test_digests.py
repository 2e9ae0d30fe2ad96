"""Digests of files and bytes."""

import os
from pathlib import Path

import pytest

from sysid.foreign.regular_files import file_sha256, sha256_hex, sha256_of_parts

OF_ABC = (
    "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"  # FIPS 180-2, appendix B.1
)


def test_bytes_have_the_published_digest() -> None:
    assert sha256_hex(b"abc") == OF_ABC
    assert sha256_hex(b"abd") != OF_ABC
    assert sha256_of_parts(part for part in (b"a", memoryview(b"bc"))) == OF_ABC
    assert sha256_of_parts([b"bc", b"a"]) != OF_ABC


def test_a_file_has_the_digest_of_its_content(tmp_path: Path) -> None:
    file = tmp_path / "abc"
    file.write_bytes(b"abc")
    assert file_sha256(file) == OF_ABC
    content = b"\x00\xff" * 1_000_000  # longer than any buffer it is read through
    file.write_bytes(content)
    assert file_sha256(file) == sha256_hex(content)


def test_what_is_no_regular_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="a folder"):
        file_sha256(tmp_path)
    with pytest.raises(FileNotFoundError):
        file_sha256(tmp_path / "none")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe")
        with pytest.raises(OSError, match="a pipe"):
            file_sha256(tmp_path / "pipe")
