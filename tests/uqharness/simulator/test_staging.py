"""Private copies of an aircraft, its identity, and what its XML may name."""

from __future__ import annotations

import hashlib
import logging
from pathlib import Path

import pytest

from uqharness.errors import BadInputError
from uqharness.simulator import engine
from uqharness.simulator.aircraft import PROJECT_ROOT, find_aircraft
from uqharness.simulator.staging import (
    copy_folder,
    fingerprint,
    identity,
    leads_out,
    model_files,
    screen_file,
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
    result = stage(aircraft, tmp_path / "root")
    files = model_files(aircraft)
    present = {
        p.relative_to(result.folder).as_posix(): p.read_bytes()
        for p in result.folder.rglob("*")
        if p.is_file()
    }
    assert present == {name: file.content for name, file in files.local.items()}
    assert result.xml.is_file()
    assert "unused.xml" not in present
    assert dict(result.user_folders)[result.folder] == folder


def test_a_staging_is_kept_until_a_file_changes(folder: Path) -> None:
    first, mark = staged(find_aircraft(folder)), fingerprint(find_aircraft(folder))
    assert staged(find_aircraft(folder)) is first
    assert fingerprint(find_aircraft(folder)) == mark
    xml = folder / "espaaro.xml"
    xml.write_bytes(xml.read_bytes() + b"\n")
    assert staged(find_aircraft(folder)) is not first
    assert fingerprint(find_aircraft(folder)) != mark


def test_what_was_taken_out_is_said_once(
    folder: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    xml = folder / "espaaro.xml"
    xml.write_text(
        xml.read_text().replace("</fdm_config>", "<output name='x' type='CSV'/></fdm_config>")
    )
    with caplog.at_level(logging.INFO, "uqharness"):
        result = stage(find_aircraft(folder), tmp_path / "one")
        stage(find_aircraft(folder), tmp_path / "two")
    output = [r.getMessage() for r in caplog.records if "left out" in r.getMessage()]
    assert len(output) == 1
    assert "1 <output> left out" in output[0]
    assert b"<output" not in result.xml.read_bytes()


# Files that an aircraft is made of: their identity, what is read, and copies.


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


# What a foreign XML may ask for: elements blanked byte by byte, names that lead out, entities.


def test_what_is_taken_out_leaves_every_other_byte_and_line() -> None:
    raw = (
        b'<a>\r\n<output name="x>y"/>\n<b><output>kept</output></b>\n<output>\n<c'
        b' file="/etc"/></output><input/><c/>\n</a>\n'
    )
    result = screen_file(raw, "a.xml")
    assert [(tag, line) for tag, line in result.removed] == [
        ("output", 2),
        ("output", 4),
        ("input", 5),
    ]
    assert len(result.content) == len(raw)
    assert result.content.count(b"\n") == raw.count(b"\n")
    assert b"<b><output>kept</output></b>" in result.content
    assert result.content.rstrip().endswith(b"<c/>\n</a>")
    assert result.references == ()
    assert screen_file(b"<a><b/></a>", "b.xml").content == b"<a><b/></a>"


def test_an_element_made_by_an_entity_is_refused() -> None:
    sly = b"<!DOCTYPE a [<!ENTITY o \"<output name='/tmp/x' type='CSV'/>\">]><a>&o;</a>"
    with pytest.raises(BadInputError, match="comes from an entity"):
        screen_file(sly, "a.xml")
    path = b'<!DOCTYPE a [<!ENTITY p "/etc/passwd">]><a><system file="&p;"/></a>'
    with pytest.raises(BadInputError, match="leads out"):
        screen_file(path, "a.xml")
    # Text from an entity is what stock systems have.
    assert screen_file(b'<!DOCTYPE a [<!ENTITY on "1">]><a><v>&on;</v></a>', "a.xml").removed == ()


def test_entities_do_not_multiply() -> None:
    lines = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 12))
    bomb = f'<!DOCTYPE a [<!ENTITY e0 "0123456789">{lines}]><a>&e11;</a>'.encode()
    with pytest.raises(BadInputError, match="not well-formed"):
        screen_file(bomb, "bomb.xml")


def test_every_stock_file_passes() -> None:
    stock = engine.default_root()
    roots = {screen_file(path.read_bytes(), path.name).root for path in stock.rglob("*.xml")}
    assert {
        "fdm_config",
        "system",
        "runscript",
        "turbine_engine",
        "propeller",
        "initialize",
    } <= roots


@pytest.mark.parametrize(
    "name",
    [
        "/etc/passwd",
        "~/x",
        "../x",
        "a/../../x",
        "a/..",
        "C:\\x",
        "C:x",
        "\\\\host\\share",
        "..\\x",
        "a\\..\\x",
        "a\0b",
    ],
)
def test_names_that_lead_out_on_some_system(name):
    assert leads_out(name)
