"""Files that an aircraft is made of: their identity, what is read, and copies."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from uqharness.errors import BadInputError
from uqharness.simulator.aircraft import PROJECT_ROOT, find_aircraft
from uqharness.simulator.staging import copy_folder, identity, model_files, signature, walk


def test_the_identity_of_a_self_contained_aircraft_is_that_of_its_folder() -> None:
    """Case ids of campaigns hang on it."""
    folder = PROJECT_ROOT / "aircraft" / "espaaro"
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.suffix in {".xml", ".toml"} and path.is_file():
            digest.update(
                path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes() + b"\0"
            )
    assert identity(find_aircraft("espaaro")) == digest.hexdigest()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A copy of the project's own aircraft."""
    copy_folder(find_aircraft("espaaro").folder, tmp_path / "plane")
    return tmp_path / "plane"


def test_files_are_walked_in_one_order_by_parts(tmp_path: Path) -> None:
    for name in ("b.xml", "a/z.xml", "a.xml", "a/b/c.xml", ".git/x"):
        path = tmp_path / "plane" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("<a/>")
    assert [name for name, _ in walk(tmp_path / "plane")] == [
        "a/b/c.xml",
        "a/z.xml",
        "a.xml",
        "b.xml",
    ]


def test_a_copy_has_the_same_identity_and_a_changed_byte_another(
    folder: Path, tmp_path: Path
) -> None:
    before, seen = identity(find_aircraft(folder)), signature(folder)
    copy_folder(folder, tmp_path / "other" / "plane")
    assert identity(find_aircraft(tmp_path / "other" / "plane")) == before
    xml = folder / "espaaro.xml"
    xml.write_bytes(xml.read_bytes() + b"\n")
    assert identity(find_aircraft(folder)) != before
    assert signature(folder) != seen


def test_what_jsbsim_may_open_is_what_the_xml_refers_to(folder: Path) -> None:
    before = set(model_files(find_aircraft(folder)).local)
    assert "espaaro.xml" in before
    (folder / "unused.xml").write_text("<system name='x'/>")
    text = (folder / "espaaro.xml").read_text()
    (folder / "espaaro.xml").write_text(
        text.replace("</fdm_config>", '<system file="used"/></fdm_config>')
    )
    (folder / "Systems").mkdir(exist_ok=True)
    (folder / "Systems" / "used.xml").write_text("<system name='x'/>")
    assert set(model_files(find_aircraft(folder)).local) - before == {"Systems/used.xml"}


def test_a_linked_folder_is_refused(folder: Path, tmp_path: Path) -> None:
    (folder / "loop").symlink_to(folder, target_is_directory=True)
    with pytest.raises(BadInputError, match="link to a folder"):
        list(walk(folder))
    with pytest.raises(BadInputError, match="cannot be read"):
        list(walk(tmp_path / "nowhere"))
