"""Numbers, triplets and tables of engine files."""

from __future__ import annotations

from pathlib import Path

import pytest

from uqharness.batch.ir import Builder
from uqharness.batch.translate.engine_files import (
    grid,
    number,
    refuse_tags,
    required_number,
    triplet,
    with_number,
)
from uqharness.batch.translate.frame import Scope
from uqharness.errors import BadInputError
from uqharness.xml.document import Node, parse_document


def parsed(text: str) -> tuple[Scope, Node]:
    document = parse_document(Path("e.xml"), text.encode())
    return Scope(Builder(), document, lambda _: None), document.root


def test_numbers_bear_units_or_have_defaults() -> None:
    scope, node = parsed('<e><a unit="FT">2</a><a>3</a></e>')
    assert number(scope, node, "a", 1.0, "IN") == 24.0
    assert number(scope, node, "b", 1.5, "IN") == 1.5
    for text, said in (
        ('<e><a unit="FT">2</a></e>', "unit FT of <a>"),
        ('<e><a unit="IN" dispersion="1">2</a></e>', "'dispersion'"),
    ):
        scope, node = parsed(text)
        with pytest.raises(BadInputError, match=said):
            number(scope, node, "a", 1.0, "LBS" if "FT" in text else "IN")
    with pytest.raises(BadInputError, match=r"e\.xml:1: <e> has no <c>"):
        required_number(scope, node, "c")


def test_what_lacks_of_a_triplet_is_zero() -> None:
    scope, node = parsed('<l unit="FT"><x>1</x><z>2</z></l>')
    assert triplet(scope, node, "IN") == (12.0, 0.0, 24.0)
    scope, node = parsed('<l unit="M"><roll>1</roll><yaw>2</yaw></l>')
    assert triplet(scope, node, "IN") == (3.2808399 * 12.0, 0.0, 2.0 * (3.2808399 * 12.0))


@pytest.mark.parametrize(
    ("lines", "shape"),
    [("0 1\n1 2", (2, 0)), ("5 6\n0 1 2\n1 2 3", (2, 2)), ("5\n0 1\n1 2", (2, 1)), ("0 1", (1, 0))],
)
def test_the_second_line_tells_the_dimension(lines: str, shape: tuple[int, int]) -> None:
    scope, node = parsed(f'<table type="internal"><tableData>{lines}</tableData></table>')
    found = grid(scope, node)
    assert (len(found.rows), len(found.columns)) == shape


def test_strange_tables_and_elements_are_refused() -> None:
    for text in (
        "<table><independentVar>a</independentVar><tableData>0 1</tableData></table>",
        '<table type="internal"><tableData></tableData></table>',
    ):
        scope, node = parsed(text)
        with pytest.raises(BadInputError, match=r"e\.xml:1"):
            grid(scope, node)
    with pytest.raises(BadInputError, match="<tableData> of <table> is no good"):
        refuse_tags(scope, node, {"tableData": "is no good"}, ("type",))


def test_an_engine_bears_its_number() -> None:
    scope, node = parsed('<e><function name="propulsion/engine[#]/a"><p>b[#]</p></function></e>')
    copy = with_number((scope.document, node), 2)[1]
    assert copy.children[0].attributes["name"] == "propulsion/engine[2]/a"
    assert copy.children[0].children[0].text == "b[2]"
    assert node.children[0].attributes["name"] == "propulsion/engine[#]/a"
