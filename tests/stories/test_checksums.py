"""SHA256SUMS: one bit or the end of any file of a campaign, a study or a refinement is missed by
nobody who checks.
"""

from __future__ import annotations

import errno
import random
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.fuzz.formats import CORPUS
from uqharness.campaign.tables import record_table
from uqharness.campaign.verify import verify
from uqharness.checksums import SUMS, faults, read_sums, update_sums, write_sums
from uqharness.errors import BadInputError
from uqharness.files import write_bytes
from uqharness.report import write_report


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Path:
    """A campaign that is complete, and a study and a refinement with a campaign inside, all
    sealed.
    """
    root = tmp_path_factory.mktemp("sealed")
    shutil.copytree(CORPUS / "results" / "campaign", root / "campaign")
    record_table(root / "campaign", "engine-check.csv", b"part,condition\nstart,calm\n" * 20)
    write_sums(root / "campaign")
    for kind, inner in (("study", "campaign-before"), ("refined", "pbox/before")):
        shutil.copytree(CORPUS / "results" / kind, root / kind)
        shutil.copytree(root / "campaign", root / kind / inner)
        write_sums(root / kind)
    return root


def flip(path: Path, bit: int) -> None:
    content = bytearray(path.read_bytes())
    content[bit // 8] ^= 1 << (bit % 8)
    path.write_bytes(content)


def files_of(root: Path) -> list[Path]:
    return [
        path
        for kind in ("campaign", "study", "refined")
        for path in sorted((root / kind).rglob("*"))
        if path.is_file() and path.stat().st_size
    ]


def damage(root: Path, flips: int, cuts: int, seed: int):
    """Damage one file after another, each restored before the next; folder and file of each."""
    chance = random.Random(seed)
    files = files_of(root)
    for number in range(flips + cuts):
        path = chance.choice(files)
        content = path.read_bytes()
        if number < flips:
            flip(path, chance.randrange(8 * len(content)))
        else:
            path.write_bytes(content[: chance.randrange(len(content))])
        yield root / path.relative_to(root).parts[0], path
        path.write_bytes(content)


@pytest.mark.parametrize(
    ("flips", "cuts"), [(60, 15), pytest.param(1000, 100, marks=pytest.mark.slow)]
)
def test_every_flip_and_every_cut_is_seen(results, flips, cuts):
    assert all(verify(results / kind).whole for kind in ("campaign", "study", "refined"))
    unseen = []
    for folder, path in damage(results, flips, cuts, 20161201):
        # What a report looks at, and what verify does.
        if verify(folder).whole or not faults(folder):
            unseen.append(path)
    assert unseen == []
    assert all(verify(results / kind).whole for kind in ("campaign", "study", "refined"))


def test_a_report_says_so(results, tmp_path):
    folder = shutil.copytree(results / "refined", tmp_path / "refined")
    clean = write_report(folder)
    assert clean.damaged == ()
    page = clean.path.read_bytes()
    flip(folder / "pbox" / "before" / "engine-check.csv", 300)
    report = write_report(folder)
    assert [fault.name for fault in report.damaged] == ["pbox/before/engine-check.csv"]
    assert b"engine-check.csv" in report.path.read_bytes()
    flip(folder / "pbox" / "before" / "engine-check.csv", 300)
    flip(folder / "report.html", 300)
    repeat = write_report(folder)
    assert (repeat.damaged, repeat.rewritten) == ((), ("report.html",))
    assert repeat.path.read_bytes() == page
    assert verify(folder).whole


def test_what_is_written_later_is_entered_and_what_users_add_is_not(results, tmp_path):
    folder = shutil.copytree(results / "study", tmp_path / "study")
    write_bytes(folder / "fit" / "new.csv", b"1\n")
    (folder / "notes.txt").write_text("mine")
    sums = read_sums(folder)
    assert "fit/new.csv" in sums.files
    assert "notes.txt" not in sums.files
    assert sums.folders == ("campaign-before",)
    (folder / "fit" / "new.csv").unlink()
    assert [item.state for item in verify(folder).files if item.name == "fit/new.csv"] == [
        "missing"
    ]
    update_sums(folder / "fit" / "new.csv")
    assert verify(folder).whole
    done = subprocess.run(["sha256sum", "-c", "--quiet", SUMS], cwd=folder, capture_output=True)
    assert done.returncode == 0


@pytest.mark.parametrize("name", ["a\\b", "a\nb", "ü", "a b "])
def test_any_name(tmp_path, name):
    (tmp_path / name).write_bytes(b"x")
    write_sums(tmp_path)
    assert list(read_sums(tmp_path).files) == [name]
    assert (
        subprocess.run(["sha256sum", "-c", SUMS], cwd=tmp_path, capture_output=True).returncode == 0
    )


def test_links_are_neither_followed_nor_entered(tmp_path):
    folder, outside = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    (folder / "a").write_bytes(b"x")
    outside.write_bytes(b"x")
    (folder / "b").symlink_to(outside)
    write_sums(folder)
    assert list(read_sums(folder).files) == ["a"]
    (folder / "a").unlink()
    (folder / "a").symlink_to(outside)
    assert [fault.name for fault in faults(folder)] == ["a"]


def test_a_full_or_broken_disk_ends_in_a_sentence(results, tmp_path, monkeypatch):
    folder = shutil.copytree(results / "refined", tmp_path / "refined")

    def broken(*_: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("os.fsync", broken)
    with pytest.raises(BadInputError, match=r"SHA256SUMS: cannot be written: Input/output error"):
        write_sums(folder)
    with pytest.raises(BadInputError, match=r"new\.csv: cannot be written: Input/output error"):
        write_bytes(folder / "new.csv", b"1\n")
    monkeypatch.undo()
    assert verify(folder).whole
