"""Files written whole, and only where they belong."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from uqharness.errors import BadInputError
from uqharness.files import inner_folder, try_lock, write_bytes


def test_a_folder_within_results_is_made_and_found_again(tmp_path: Path) -> None:
    assert inner_folder(tmp_path, "a", "b") == tmp_path / "a" / "b"
    assert inner_folder(tmp_path, "a", "b").is_dir()


def test_a_link_in_a_results_folder_is_not_written_through(tmp_path: Path) -> None:
    elsewhere, results = tmp_path / "elsewhere", tmp_path / "results"
    elsewhere.mkdir()
    results.mkdir()
    (results / "figures").symlink_to(elsewhere, target_is_directory=True)
    with pytest.raises(BadInputError, match="figures: is a link to"):
        inner_folder(results, "figures")
    with pytest.raises(BadInputError, match="is a link to"):
        inner_folder(results, "figures", "deeper")
    assert not list(elsewhere.iterdir())
    # The results folder itself may be a link of the user's own.
    (tmp_path / "mine").symlink_to(results, target_is_directory=True)
    assert inner_folder(tmp_path / "mine", "made").is_dir()


def test_a_link_with_the_name_of_a_file_is_replaced(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("kept")
    for name in ("report.html", ".report.html.part"):
        (tmp_path / name).symlink_to(secret)
    write_bytes(tmp_path / "report.html", b"new")
    assert secret.read_text() == "kept"
    assert (tmp_path / "report.html").read_bytes() == b"new"
    assert not (tmp_path / "report.html").is_symlink()


def test_a_lock_is_taken_once_and_given_back_at_the_end_of_its_process(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    path.touch()
    constant = (
        "import os, sys\nfrom uqharness.files import try_lock\n"
        "print(try_lock(os.open(sys.argv[1], os.O_RDWR)), flush=True)\nsys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", constant, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"True\n"
        handle = os.open(path, os.O_RDWR)
        assert not try_lock(handle)
        other.kill()
        other.wait()
        assert try_lock(handle)
        os.close(handle)
