"""Properties that an aircraft's XML declares or computes; FlightGear's protocol file."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from uqharness.xml.document import (
    FIELDS,
    declaration,
    declarations,
    declared_properties,
    folder_documents,
    parse_document,
    protocol_xml,
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
    result = declaration(DOCUMENT, "aero/second")
    assert result is not None
    assert result.attributes["value"] == "2"
    assert declaration(DOCUMENT, "aero/read") is None
    assert declaration(DOCUMENT, "aero/commented") is None


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


def test_lists_of_properties_are_no_files_of_jsbsim(tmp_path: Path):
    comments = b"<?xml version='1.0'?>\n" + b"<!-- a -- > b -->\n".replace(b"-- >", b"- >") * 200
    (tmp_path / "list.xml").write_bytes(comments + b"<PropertyList><property/></PropertyList>")
    (tmp_path / "model.xml").write_bytes(comments + b"<system><!-- <PropertyList> --></system>")
    assert [document.root.tag for document in folder_documents(tmp_path)] == ["system"]


# The protocol file of a FlightGear playback is what FlightGear's README.protocol describes.


def test_the_protocol_is_an_input_of_comma_separated_lines():
    root = ElementTree.fromstring(protocol_xml())
    assert root.tag == "PropertyList"
    inputs = root.find("generic/input")
    assert inputs is not None
    assert (inputs.findtext("line_separator"), inputs.findtext("var_separator")) == ("newline", ",")
    chunks = [
        (c.findtext("name"), c.findtext("type"), c.findtext("node"))
        for c in inputs.findall("chunk")
    ]
    assert chunks == list(FIELDS)
    assert len({node for _, _, node in chunks}) == len(chunks) == 7
    assert all(kind == "double" for _, kind, _ in chunks)
