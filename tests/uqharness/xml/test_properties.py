"""Properties that an aircraft's XML declares, computes or names."""

from __future__ import annotations

from pathlib import Path

import pytest

from uqharness.xml.document import (
    declaration,
    declarations,
    declare,
    declared_properties,
    folder_declares,
    folder_names,
    has_function,
    parse_document,
)

XML = b"""<fdm_config>
  <!-- <property value="1">aero/commented</property> -->
  <property value="0.5"> aero/first </property>
  <property>aero/read</property>
  <system name="x"><property value="2">aero/second</property></system>
  <function name=" aero/sum "><property>aero/first</property></function>
  <actuator name="fcs/servo"/>
</fdm_config>
"""
DOCUMENT = parse_document(Path("a.xml"), XML)


def test_what_is_declared_has_a_value_and_is_no_remark():
    assert [name for name, _ in declarations(DOCUMENT)] == ["aero/first", "aero/second"]
    found = declaration(DOCUMENT, "aero/second")
    assert found is not None
    assert found.attributes["value"] == "2"
    assert declaration(DOCUMENT, "aero/read") is None
    assert declaration(DOCUMENT, "aero/commented") is None


def test_what_is_computed_is_a_function_of_that_name():
    assert has_function(DOCUMENT, "aero/sum")
    assert not has_function(DOCUMENT, "aero/first")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "Systems").mkdir()
    (tmp_path / "Systems" / "a.xml").write_bytes(XML)
    (tmp_path / "broken.xml").write_text('<property value="1">aero/broken</property')
    (tmp_path / "wide.xml").write_text(
        '<property value="1">aero/wide</property>', encoding="utf-16"
    )
    (tmp_path / "other.txt").write_text('<property value="1">aero/text</property>')
    return tmp_path


def test_a_folder_declares_what_one_of_its_xml_files_does(folder: Path):
    assert folder_declares(folder, "aero/first")
    for name in ("aero/read", "aero/broken", "aero/wide", "aero/text"):
        assert not folder_declares(folder, name)


def test_a_folder_names_properties_in_text_and_attributes(folder: Path):
    for prefix in ("aero/re", "fcs/servo", "aero/sum"):
        assert folder_names(folder, prefix)
    for prefix in ("ero/read", "aero/commented", "nav/"):
        assert not folder_names(folder, prefix)


def test_what_is_written_is_declared():
    lines = [declare("aero/a", "1.5"), declare("aero/b<c", "0", "a remark -- ours")]
    assert lines == [
        '<property value="1.5">aero/a</property>',
        '<property value="0">aero/b&lt;c</property>  <!-- a remark - - ours -->',
    ]
    document = parse_document(Path("a.xml"), "\n".join(["<a>", *lines, "</a>"]).encode())
    assert [name for name, _ in declarations(document)] == ["aero/a", "aero/b<c"]


def test_what_is_computed_is_no_declared_coefficient(tmp_path: Path):
    (tmp_path / "a.xml").write_bytes(
        b'<fdm_config><property value="1">aero/b</property><property value="1">aero/a</property>'
        b'<property value="1">fcs/c</property>'
        b'<property value="0">aero/sum</property><property'
        b' value="0">aero/filtered</property><function name="aero/sum"/><function/>'
        b"<lag_filter><output>aero/filtered</output></lag_filter></fdm_config>"
    )
    assert declared_properties(tmp_path, "aero/") == ("aero/a", "aero/b")
    assert declared_properties(tmp_path, "nav/") == ()
    # Asked again: of another folder's copy, of a file that has changed, and beside one that is no
    # XML.
    (tmp_path / "copy").mkdir()
    (tmp_path / "copy" / "a.xml").write_bytes((tmp_path / "a.xml").read_bytes())
    (tmp_path / "copy" / "b.xml").write_bytes(b"<a><b></a>")
    assert declared_properties(tmp_path / "copy", "aero/") == ("aero/a", "aero/b")
    (tmp_path / "copy" / "a.xml").write_bytes(b'<a><property value="1">aero/d</property></a>')
    assert declared_properties(tmp_path / "copy", "aero/") == ("aero/d",)
    # Computed in one file, declared in the other.
    assert declared_properties(tmp_path, "aero/") == ("aero/a", "aero/b", "aero/d")
