"""Links in a results folder that somebody else made: what they lead to is neither written nor
removed.
"""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import struct
from pathlib import Path

import pytest

from tests.fuzz.formats import CORPUS
from tests.helpers import campaign_fakes as fakes
from uqharness.campaign.store import JOURNAL, LOCK, Store, is_running, run_lock
from uqharness.cli.main import main
from uqharness.errors import BadInputError

pytestmark = pytest.mark.usefixtures("flights_here")
PRECIOUS = b"precious\n" * 40


@pytest.fixture
def victim(tmp_path) -> Path:
    path = tmp_path / "home" / "precious"
    path.parent.mkdir()
    path.write_bytes(PRECIOUS)
    return path


@pytest.fixture
def folder(tmp_path) -> Path:
    return shutil.copytree(CORPUS / "results" / "campaign", tmp_path / "results")


def commands(folder: Path, campaign: Path) -> list[list[str]]:
    return [
        ["campaign", "run", str(campaign), "--out", str(folder), "--serial"],
        ["campaign", "verify", str(folder)],
        ["campaign", "status", str(folder)],
        ["campaign", "report", str(folder), "--no-tracks"],
        ["campaign", "merge", str(folder)],
        ["campaign", "rerun", str(folder), "--case", "4"],
        ["campaign", "salvage", str(folder)],
        ["campaign", "salvage", str(folder), "--campaign", str(campaign)],
        ["sensitivity", str(folder)],
        ["report", str(folder)],
    ]


SLOW = pytest.mark.slow
LINKS = [
    LOCK,
    JOURNAL,
    f"{JOURNAL}-journal",
    f"{JOURNAL}-wal",
    "manifest.json",
    ".manifest.json.part",
    "cases.parquet",
    ".SHA256SUMS.part",
    "SHA256SUMS",
    "report.html",
    ".report.html.part",
    "engine-check.csv",
    "figures",
    "rerun",
    ".salvage",
    "shards",
    "aircraft",
    ".journal.damaged-1.sqlite.part",
]


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        pytest.param(name, kind, marks=() if name == LINKS[0] and kind == "soft" else SLOW)
        for name in LINKS
        for kind in ("soft", "hard")
    ],
)
def test_no_command_writes_through_a_link(folder, victim, tmp_path, name, kind, capsys):
    campaign = fakes.campaign_file(tmp_path, fakes.CAMPAIGN)
    place = folder / name
    is_folder = "." not in name or name == ".salvage"
    if kind == "hard" and (is_folder or name == JOURNAL):
        pytest.skip("a folder has no second name, and a journal's is salvage's own")
    if place.exists():
        place.unlink()
    if kind == "hard":
        os.link(victim, place)
    else:
        place.symlink_to(victim.parent if is_folder else victim)
    for words in commands(folder, campaign):
        code = main(words)
        assert code in (0, 1, 2), words
        if code == 2:
            assert "Traceback" not in capsys.readouterr().err
        assert victim.read_bytes() == PRECIOUS, words
        assert sorted(victim.parent.iterdir()) == [victim], words


def test_a_lock_that_is_a_link_is_refused_and_a_plain_one_held(tmp_path, victim):
    (tmp_path / LOCK).symlink_to(victim)
    with pytest.raises(BadInputError, match=r"run\.lock: .*is a link to"), run_lock(tmp_path):
        pass
    assert not is_running(tmp_path)
    (tmp_path / LOCK).unlink()
    with run_lock(tmp_path):
        assert is_running(tmp_path)
        assert (tmp_path / LOCK).read_text().startswith(f"process {os.getpid()} on")
    assert (tmp_path / LOCK).read_bytes() == b""


@pytest.mark.slow
def test_a_rollback_file_that_names_another_file_removes_nothing(folder, victim):
    """SQLite removes a super journal that no other journal names; a forged rollback file can name
    any file.
    """
    process = os.fork()
    if process == 0:
        database = sqlite3.connect(folder / JOURNAL)
        database.execute("pragma cache_size = 1")
        database.execute("update outcome set reason = 'half of a batch'")
        os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(process, 0)
    leftover = folder / f"{JOURNAL}-journal"
    content = leftover.read_bytes()
    page = struct.unpack(">I", content[24:28])[0]
    name = str(victim).encode()
    locked = 0x40000000 // page + 1
    forged = content + struct.pack(">I", locked) + name
    forged += struct.pack(">II", len(name), sum(name)) + content[:8]
    leftover.write_bytes(forged)
    with pytest.raises(BadInputError, match="names another file"), Store(folder):
        pass
    for words in commands(folder, folder / "none.toml")[1:]:
        assert main(words) in (0, 1, 2), words
        assert victim.exists(), words
    # The forgery is one: SQLite by itself does remove the file.
    with sqlite3.connect(folder / JOURNAL) as database:
        database.execute("select count(*) from outcome").fetchone()
    assert not victim.exists()
