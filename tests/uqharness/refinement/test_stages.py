"""Stages of a refinement: kept exactly, found again, and harmless whoever wrote them."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import numpy as np
import pytest

from sysid.effects import Information
from sysid.errors import Finding
from sysid.foreign.typed_files import dump
from uqharness.identification.linearised import Linearisation, ModelState, Trajectory
from uqharness.refinement.stages import STAGES_FOLDER, Stages


@pytest.fixture
def folder(tmp_path) -> Path:
    return tmp_path / STAGES_FOLDER


def fail() -> None:
    raise AssertionError("made again")


def find() -> list[Finding]:
    return [Finding("a", "", "info", "m", {"x": float(np.float64(1) / 3)})]


def test_what_was_made_is_found_again_by_the_same_input_alone(folder, caplog):
    result = Stages(folder, ["input"])("effects", list[Finding], find)
    assert Stages(folder, ["input"])("effects", list[Finding], fail) == result
    assert Stages(folder, ["other"])("effects", list[Finding], lambda: [*find(), *find()]) == [
        *result,
        *result,
    ]
    assert Stages(None, ())("effects", list[Finding], find) == result
    assert caplog.messages == []


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "not a data file"),
        (pickle.dumps([1]), "not a data file"),
        (dump(find())[:-1], "damaged"),
        (dump([1]), "not what is asked for"),
        (dump({"a": 1}), "not what is asked for"),
        (None, "is a folder, not a regular file"),
    ],
)
def test_what_is_not_the_stage_is_said_and_made_again(folder, caplog, content, reason):
    stages = Stages(folder, ["input"])
    stages("effects", list[Finding], find)
    (path,) = folder.iterdir()
    path.unlink()
    if content is None:
        path.mkdir()
    else:
        path.write_bytes(content)
    assert stages("effects", list[Finding], find) == find()
    assert caplog.messages[0].startswith(f"{path}: ")
    assert reason in caplog.messages[0]
    assert caplog.messages[0].endswith("; this stage is computed again")
    if content is not None:
        assert len(caplog.messages) == 1
        assert stages("effects", list[Finding], fail) == find()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no such pipes")
def test_a_pipe_in_the_place_of_a_stage_holds_nothing_up(folder, caplog):
    stages = Stages(folder, ["input"])
    folder.mkdir()
    os.mkfifo(folder / f"effects-{stages.key}.data")
    assert stages("effects", list[Finding], find) == find()
    assert "is a pipe" in caplog.messages[0]


class Harm:
    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self):
        return Path.touch, (self.mark,)


def test_nothing_in_the_folder_is_run(folder, tmp_path, caplog):
    """A pickle with a command in it, under the name of today and of yesterday."""
    mark = tmp_path / "ran"
    stages = Stages(folder, ["input"])
    folder.mkdir()
    for ending in ("data", "pickle"):
        (folder / f"effects-{stages.key}.{ending}").write_bytes(pickle.dumps(Harm(mark)))
    assert stages("effects", list[Finding], find) == find()
    assert not mark.exists()
    pickle.loads((folder / f"effects-{stages.key}.pickle").read_bytes())
    assert mark.exists()


def test_a_value_that_is_no_data_is_handed_on_and_said(folder, caplog):
    assert Stages(folder, ["input"])("effects", object, lambda: print) is print
    assert "cannot hold a builtins.builtin_function_or_method" in caplog.messages[0]
    assert not folder.exists()


def test_forget_removes_its_own_files_alone(folder, tmp_path, caplog):
    stages = Stages(folder, ["input"])
    stages("effects", list[Finding], find)
    outside = tmp_path / "outside"
    outside.write_text("x")
    linked = folder / f"named-{stages.key}.data"
    linked.symlink_to(outside)
    (folder / "notes.txt").write_text("mine")
    stages.remove()
    assert outside.read_text() == "x"
    assert [path.name for path in folder.iterdir()] == ["notes.txt"]
    (folder / "notes.txt").unlink()
    stages("effects", list[Finding], find)
    stages.remove()
    assert not folder.exists()
    stages.remove()


def test_a_link_in_the_place_of_the_folder_is_not_followed(folder, tmp_path, caplog):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    stages = Stages(folder, ["input"])
    retained = elsewhere / f"effects-{stages.key}.data"
    retained.write_bytes(dump([]))
    folder.symlink_to(elsewhere)
    assert stages("effects", list[Finding], find) == find()
    stages.remove()
    assert list(elsewhere.iterdir()) == [retained]
    assert caplog.messages == [
        f"{folder}: is a link, not a folder of this program; stages are not kept"
    ]


def test_a_link_planted_where_the_file_is_being_written_is_not_followed(folder, tmp_path, caplog):
    victim = tmp_path / "victim"
    victim.write_text("x")
    stages = Stages(folder, ["input"])
    folder.mkdir()
    for name in (f".effects-{stages.key}.data.part", f"effects-{stages.key}.data"):
        (folder / name).symlink_to(victim)
    assert stages("effects", list[Finding], find) == find()
    assert victim.read_text() == "x"
    assert stages("effects", list[Finding], fail) == find()


def test_filtered_segments_are_filtered_again_instead_of_stored(folder: Path):
    evidence = Information(
        ("a",), np.ones((1, 1, 1)), np.ones((1, 1)), np.zeros(1, dtype=int), np.zeros(1), ()
    )
    trajectory = Trajectory(ModelState({}, {}, ()), [], [], [], 1.0)
    fit = Linearisation(trajectory, [], [], [], evidence, (), [])
    stages = Stages(folder, ["key"])
    assert stages("fit", Linearisation, lambda: fit).followed == []
    stored = stages("fit", Linearisation, fail)
    assert stored.followed is None
    assert stored.trajectory == trajectory
