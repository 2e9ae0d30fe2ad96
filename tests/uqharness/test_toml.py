"""Values and keys as they would stand in a TOML file, and the line that a key stands on."""

from __future__ import annotations

from pathlib import Path

import pytest

from sysid.foreign.regular_files import parse_toml
from uqharness.errors import BadInputError
from uqharness.toml import as_toml, dotted, line_of, read_toml

TEXT = """[aleatory]
flights = 3
[aleatory.variables."inertia/mass-slugs"]
mean = [1.0, 2.0]
[[fly]]
name = "one"
[[fly]]
name = "two"
"""


@pytest.mark.parametrize(
    "value",
    ['with "quotes", \\, \x7f and ä', 1.5e-300, -3, True, [1, [2.5, "x"]], float("inf"), ""],
)
def test_a_value_is_read_back_as_it_was(value):
    assert parse_toml(f"a = {as_toml(value)}") == {"a": value}


@pytest.mark.parametrize("key", ["plain-key_1", "inertia/mass-slugs", 'a "b".c', "ä", ""])
def test_a_key_is_read_back_as_it_was(key):
    assert parse_toml(f"{dotted(('a', key))} = 1") == {"a": {key: 1}}


def test_what_toml_has_no_form_for_is_said_all_the_same():
    assert as_toml(None) == "None"
    assert as_toml({"a": 1}) == "{'a': 1}"


@pytest.mark.parametrize(
    ("location", "line"),
    [
        (("aleatory", "flights"), 2),
        (("aleatory", "variables", "inertia/mass-slugs", "mean"), 4),
        (("fly", 1, "name"), 8),
        (("aleatory", "seed"), 1),
        (("elsewhere",), 1),
    ],
)
def test_the_line_of_a_key_or_of_its_section(location, line):
    assert line_of(TEXT, location) == line


@pytest.mark.parametrize(
    ("content", "output"),
    [
        (b"a = \xff", "not a text file in UTF-8"),
        (b"a = 1\nb = ", ":2: not valid TOML"),
        (None, "cannot be read"),
    ],
)
def test_a_file_that_cannot_be_read_is_named(content, output, tmp_path: Path):
    path = tmp_path / "file.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(BadInputError, match=output) as error:
        read_toml(path)
    assert str(error.value).startswith(str(path))
