"""The protocol file of a FlightGear playback is what FlightGear's README.protocol describes."""

from __future__ import annotations

from xml.etree import ElementTree

from uqharness.xml.document import FIELDS, protocol_xml


def test_the_protocol_is_an_input_of_comma_separated_lines():
    root = ElementTree.fromstring(protocol_xml())
    assert root.tag == "PropertyList"
    given = root.find("generic/input")
    assert given is not None
    assert (given.findtext("line_separator"), given.findtext("var_separator")) == ("newline", ",")
    chunks = [
        (c.findtext("name"), c.findtext("type"), c.findtext("node")) for c in given.findall("chunk")
    ]
    assert chunks == list(FIELDS)
    assert len({node for _, _, node in chunks}) == len(chunks) == 7
    assert all(kind == "double" for _, kind, _ in chunks)
