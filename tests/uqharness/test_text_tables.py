"""Tables as text, and back."""

from __future__ import annotations

from pathlib import Path

import pytest

from uqharness.errors import BadInputError
from uqharness.text_tables import csv_rows, csv_text, markdown_table, text_table

ROWS = [{"name": "a", "value": "1.5"}, {"name": "long | name", "value": ""}]


def test_columns_of_a_terminal_stand_below_one_another():
    assert text_table(ROWS) == ["       name  value", "          a    1.5", "long | name       "]


def test_a_markdown_table_keeps_its_columns():
    assert markdown_table(ROWS) == "| name | value |\n|---|---|\n| a | 1.5 |\n| long / name |  |\n"


def test_rows_of_a_csv_are_read_back_as_they_were():
    assert csv_rows(csv_text(ROWS).encode(), Path("t.csv"), (), ("name",), ("value",)) == ROWS


@pytest.mark.parametrize(
    ("content", "output"),
    [
        (b"name\na\n", "t.csv: has no column value"),
        (b"name,value\na,x\n", "t.csv:2: value is 'x'"),
        (b"name,value\na,nan\n", "t.csv:2: value is 'nan'"),
        (b"name,value\na,1\nb\n", "t.csv:3: has another number of columns"),
        (b"name,value\na,\n", "t.csv:2: value is ''"),
        (b"name,value\n\xff,1\n", "t.csv: not a text file in UTF-8"),
        (b'name,value\n"' + b"a" * 200_000 + b'",1\n', "t.csv: not a readable CSV table"),
    ],
)
def test_rows_that_cannot_be_are_named(content, output):
    with pytest.raises(BadInputError, match=output):
        csv_rows(content, Path("t.csv"), ("value",), ("name",))
