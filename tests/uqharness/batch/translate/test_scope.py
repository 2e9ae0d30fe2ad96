"""Numbers, names and parameters as JSBSim reads them, and refusals with file and line."""

from __future__ import annotations

from pathlib import Path

import pytest

from uqharness.batch.ir import Builder
from uqharness.batch.translate.frame import Scope, canonical, is_number, property_of
from uqharness.errors import BadInputError
from uqharness.xml.document import parse_document

DOCUMENT = parse_document(Path("a.xml"), b"<a>\n<gain>x</gain></a>")
NODE = DOCUMENT.root.children[0]


def _scope() -> Scope:
    builder = Builder()
    return Scope(builder, DOCUMENT, lambda name: builder.load(name) if name == "x/y" else None)


@pytest.mark.parametrize("text", ["1", "-.5", "+2.", " 1e-3 ", "0.25E+7"])
def test_numbers(text: str) -> None:
    assert is_number(text)
    assert _scope().parameter(NODE, text).constant == float(text)


@pytest.mark.parametrize("text", ["x/y", "-x/y", "/fdm/jsbsim/x/y", "x[0]/y"])
def test_properties_with_a_sign(text: str) -> None:
    scope = _scope()
    assert not is_number(text)
    value = scope.parameter(NODE, text)
    plain = scope.builder.load("x/y")
    assert value.index == (-plain if text.startswith("-") else plain).index


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1.5x", "must be the name of a property; received '1.5x'"),
        ("--x/y", "must be the name of a property"),
        ("x y", "must be the name of a property"),
        ("1e999", "finite decimal number"),
        ("x/z", "property x/z is not computed"),
    ],
)
def test_refusals(text: str, message: str) -> None:
    with pytest.raises(BadInputError, match=message) as error:
        _scope().parameter(NODE, text)
    assert str(error.value).startswith("a.xml:2: ")


def test_one_spelling_of_a_name() -> None:
    assert canonical(" /fdm/jsbsim/fcs/throttle-cmd-norm[0] ") == "fcs/throttle-cmd-norm"
    assert canonical("/host/x") == "/host/x"
    assert property_of(_scope(), NODE, "a/b[2]") == "a/b[2]"
