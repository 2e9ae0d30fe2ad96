"""A private copy of an aircraft: kept while its files stay, made anew once one changes."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.staging import (
    copy_folder,
    copy_staging,
    fingerprint,
    model_files,
    stage,
    staged,
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    copy_folder(find_aircraft("espaaro").folder, tmp_path / "plane")
    return tmp_path / "plane"


def test_only_what_is_opened_is_laid_out_and_as_it_passed(folder: Path, tmp_path: Path) -> None:
    (folder / "unused.xml").write_text("<system name='x'/>")
    aircraft = find_aircraft(folder)
    made = stage(aircraft, tmp_path / "root")
    files = model_files(aircraft)
    there = {
        p.relative_to(made.folder).as_posix(): p.read_bytes()
        for p in made.folder.rglob("*")
        if p.is_file()
    }
    assert there == {name: file.content for name, file in files.local.items()}
    assert made.xml.is_file()
    assert "unused.xml" not in there
    assert dict(made.user_folders)[made.folder] == folder


def test_a_staging_is_kept_until_a_file_changes(folder: Path) -> None:
    first, mark = staged(find_aircraft(folder)), fingerprint(find_aircraft(folder))
    assert staged(find_aircraft(folder)) is first
    assert fingerprint(find_aircraft(folder)) == mark
    xml = folder / "espaaro.xml"
    xml.write_bytes(xml.read_bytes() + b"\n")
    assert staged(find_aircraft(folder)) is not first
    assert fingerprint(find_aircraft(folder)) != mark


def test_a_second_root_may_be_edited(folder: Path, tmp_path: Path) -> None:
    first = staged(find_aircraft(folder))
    second = copy_staging(first, tmp_path / "second")
    second.xml.write_text("<gone/>")
    assert first.xml.read_bytes() != second.xml.read_bytes()
    assert [real for _, real in second.user_folders] == [real for _, real in first.user_folders]
    assert all(at.is_relative_to(tmp_path / "second") for at, _ in second.user_folders)


def test_what_was_taken_out_is_said_once(
    folder: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    xml = folder / "espaaro.xml"
    xml.write_text(
        xml.read_text().replace("</fdm_config>", "<output name='x' type='CSV'/></fdm_config>")
    )
    with caplog.at_level(logging.INFO, "uqharness"):
        made = stage(find_aircraft(folder), tmp_path / "one")
        stage(find_aircraft(folder), tmp_path / "two")
    said = [r.getMessage() for r in caplog.records if "left out" in r.getMessage()]
    assert len(said) == 1
    assert "1 <output> left out" in said[0]
    assert b"<output" not in made.xml.read_bytes()
