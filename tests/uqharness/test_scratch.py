"""Temporary folders end with their process, however it ends; nobody else's folder is touched."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from uqharness import files
from uqharness.errors import BadInputError
from uqharness.files import hide_scratch_paths, scratch_folder

pytestmark = pytest.mark.skipif(os.name == "nt", reason="kills and forks as POSIX has them")

_HOLD = """
import sys, time
from uqharness.files import scratch_folder, hide_scratch_paths
held = scratch_folder("held")
(held.path / "big").write_text("x")
print(held.path, flush=True)
time.sleep(600)
"""
_USE = "from uqharness.files import scratch_folder\nwith scratch_folder() as s: print(s.path)"


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for temporary files of this test, for this process and its children."""
    folder = tmp_path / "place"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setattr(files, "_homes", {})
    return folder


def _holder() -> tuple[subprocess.Popen[str], Path]:
    process = subprocess.Popen([sys.executable, "-c", _HOLD], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    return process, Path(process.stdout.readline().strip())


def _end(process: subprocess.Popen[str], number: int = signal.SIGKILL) -> None:
    process.send_signal(number)
    process.wait()
    assert process.stdout is not None
    process.stdout.close()


def _use() -> None:
    subprocess.run([sys.executable, "-c", _USE], check=True, stdout=subprocess.DEVNULL)


def test_a_folder_lives_for_its_block_and_is_private(place: Path) -> None:
    with scratch_folder("mission") as constant:
        assert constant.path.is_dir()
        assert constant.path.name.startswith("mission-")
        assert Path(constant) == constant.path
        assert constant.path.stat().st_mode & 0o777 == 0o700
        assert constant.path.parent.parent == place
    assert not constant.path.exists()
    constant.close()


def test_a_process_that_ends_by_itself_leaves_nothing(place: Path) -> None:
    _use()
    assert list(place.iterdir()) == []


def test_a_killed_process_leaves_nothing_after_the_next(place: Path) -> None:
    process, path = _holder()
    _end(process)
    assert (path / "big").is_file(), "a kill -9 leaves its folder at first"
    _use()
    assert list(place.iterdir()) == []


def test_a_living_process_keeps_its_folder(place: Path) -> None:
    process, path = _holder()
    try:
        _use()
        files.remove_abandoned_folders()
        assert (path / "big").is_file()
    finally:
        _end(process)


def test_only_folders_of_our_own_kind_are_swept(place: Path, tmp_path: Path) -> None:
    process, path = _holder()
    _end(process)
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "owner.lock").touch()
    (precious / "kept").touch()
    (place / "uqharness-1-abcdefgh").symlink_to(precious, target_is_directory=True)
    (place / "uqharness-mine").mkdir()
    (place / "uqharness-mine" / "owner.lock").touch()
    unlocked = place / "uqharness-2-abcdefgh"
    unlocked.mkdir()
    (unlocked / "notes").touch()
    linked = place / "uqharness-3-abcdefgh"
    linked.mkdir()
    (linked / "owner.lock").symlink_to(precious / "owner.lock")
    (linked / "notes").touch()
    (path / "way-out").symlink_to(precious, target_is_directory=True)
    elsewhere = place / "uqharness-4-abcdefgh"
    elsewhere.mkdir()
    (elsewhere / "owner.lock").write_text("process 4 on another-machine.example\n")
    files.remove_abandoned_folders()
    assert not path.parent.exists()
    assert (precious / "kept").exists()
    assert (unlocked / "notes").exists()
    assert (linked / "notes").exists()
    assert (place / "uqharness-mine").exists()
    assert elsewhere.exists()
    assert (place / "uqharness-1-abcdefgh").is_symlink()


def test_folders_made_while_others_sweep_all_stand(place: Path) -> None:
    dead = [_holder() for _ in range(3)]
    for process, _ in dead:
        _end(process)
    living = [
        subprocess.Popen([sys.executable, "-c", _HOLD], stdout=subprocess.PIPE, text=True)
        for _ in range(4)
    ]
    try:
        with ThreadPoolExecutor(4) as threads:
            sweeps = [threads.submit(files.remove_abandoned_folders) for _ in range(200)]
            paths = [Path(p.stdout.readline().strip()) for p in living if p.stdout is not None]
            for done in sweeps:
                done.result()
        assert all((path / "big").is_file() for path in paths)
        assert not any(path.exists() for _, path in dead)
    finally:
        for process in living:
            _end(process)


def test_a_folder_swept_while_it_was_being_made_is_made_again(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, selected = files.try_lock, []

    def too_late(handle: int) -> bool:
        # Another process has taken the folder for an orphan's, and removed it, before this one held
        # the lock.
        if not selected:
            (folder,) = place.iterdir()
            selected.append(folder)
            (folder / files.LOCK).unlink()
            folder.rmdir()
        return real(handle)

    monkeypatch.setattr(files, "try_lock", too_late)
    with scratch_folder() as constant:
        assert constant.path.is_dir()
        assert selected
        assert constant.path.parent != selected[0]


def test_a_forked_child_has_folders_of_its_own_and_leaves_its_parents_alone(place: Path) -> None:
    with scratch_folder() as constant:
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            specific = scratch_folder()
            constant.close()
            os.write(write, str(specific.path).encode())
            os._exit(0)
        os.waitpid(child, 0)
        theirs = Path(os.read(read, 4096).decode())
        os.close(read)
        os.close(write)
        assert constant.path.is_dir()
        assert theirs.parent != constant.path.parent
        files.remove_abandoned_folders()
        assert not theirs.exists()
        assert constant.path.is_dir()


def test_an_emptied_folder_of_temporary_files_is_no_end(place: Path) -> None:
    with scratch_folder() as first:
        home = first.path.parent
        first.close()
        (home / files.LOCK).unlink()
        home.rmdir()
        with scratch_folder() as second:
            assert second.path.is_dir()


def test_no_place_for_temporary_files_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
    monkeypatch.setattr(files, "_homes", {})
    with pytest.raises(BadInputError, match="set TMPDIR"):
        scratch_folder()


def test_a_message_about_a_copy_names_the_aircraft_and_not_the_copy_s_place(tmp_path):
    with scratch_folder("card") as folder:
        copy = folder.path / "aircraft" / "c310" / "c310.xml"
        text = f"mission: {copy}:68: no thrust; see '{folder.path / 'c310'}'"
        assert hide_scratch_paths(text) == "mission: c310/c310.xml:68: no thrust; see 'c310'"
    remaining = f"{tmp_path / 'aircraft' / 'c310.xml'}:3: /tmp/uqharness-plane/c310.xml"
    assert hide_scratch_paths(remaining) == remaining
