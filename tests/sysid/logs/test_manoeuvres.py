"""Manoeuvres named by a table of times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sysid.errors import LogError
from sysid.logs.manoeuvres import label_manoeuvres
from tests.helpers.synthetic import flight


def test_manoeuvres_from_a_table(tmp_path: Path) -> None:
    record = flight(10.0)
    table = tmp_path / "m.csv"
    table.write_text("flight,manoeuvre,start_s,end_s\none,pull-up,2,4\ntwo,3211,5,6\n")
    labels = label_manoeuvres(record, table, "one")["manoeuvre"]
    assert set(labels) == {"", "pull-up"}
    assert (labels == "pull-up").sum() == 101
    with pytest.raises(LogError, match="no manoeuvre of flight 'three'"):
        label_manoeuvres(record, table, "three")
    table.write_text("a,b\n1,2\n")
    with pytest.raises(LogError, match="has no column"):
        label_manoeuvres(record, table, "one")


def test_without_a_column_of_flights_every_row_counts_and_the_later_one_wins(
    tmp_path: Path,
) -> None:
    table = tmp_path / "m.csv"
    table.write_text("manoeuvre,start_s,end_s\npull-up,2,4\n3211,3,6\n")
    record = flight(10.0)
    labelled = label_manoeuvres(record, table, "any")
    for time, name in ((1.9, ""), (2.5, "pull-up"), (3.5, "3211"), (6.1, "")):
        assert labelled["manoeuvre"][np.searchsorted(record["time_s"], time)] == name
    assert "manoeuvre" not in record


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("manoeuvre,start_s,end_s\na,soon,4\n", "start_s holds a time that is no number"),
        (
            "manoeuvre,start_s,end_s\na,90,95\n",
            "no manoeuvre of flight 'one' lies between 0.0 and 10.0 s",
        ),
        ("manoeuvre,start_s,end_s\n" + "a,1,2\n" * 10_001, "10001 manoeuvres; at most 10000"),
    ],
)
def test_tables_that_name_nothing_are_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "m.csv").write_text(text)
    with pytest.raises(LogError, match=said):
        label_manoeuvres(flight(10.0), tmp_path / "m.csv", "one")
