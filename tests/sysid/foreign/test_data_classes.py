"""Classes whose values a file may hold: this project's dataclasses, by name and by fields, and no
code of them.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import pytest

from sysid.aerodynamics import GustStates
from sysid.errors import Finding, LogError
from sysid.foreign.typed_files import dump, find_class, load, storable_class
from sysid.record import FlightRecord

FIELDS = ["code", "channel", "severity", "message", "numbers", "spoils", "mend"]


def test_a_class_is_found_by_its_name_and_made_without_running_it():
    own = find_class("sysid.errors:Finding", FIELDS)
    assert own is storable_class(Finding)
    value = Finding("a", "b", "info", "m", {"n": 1.0})
    made = own.build(own.values(value))
    assert made == value
    assert type(made) is Finding
    # A record without its time would be refused by its own code.
    record = storable_class(FlightRecord)
    assert record is not None
    assert record.build([{}, None]).columns == {}
    with pytest.raises(LogError, match="time_s"):
        FlightRecord({})


def test_a_named_tuple_is_made_of_its_fields():
    value = GustStates(2.8, turning_with=False)
    own = storable_class(GustStates)
    assert own is find_class("sysid.aerodynamics.air_motion:GustStates", list(GustStates._fields))
    found = load(dump({"states": value}))["states"]
    assert type(found) is GustStates
    assert found == value
    assert "b of sysid.aerodynamics.air_motion:GustStates holds a str" in own.mismatch(
        ["2.8", 0.0, True, True, False, 1.0, 1.0, 1.0, 1.0]
    )
    assert (
        storable_class(
            type("Other", (GustStates,), {"__module__": "sysid.aerodynamics.air_motion"})
        )
        is None
    )


def test_values_of_another_type_are_told():
    own = find_class("sysid.errors:Finding", FIELDS)
    assert own.mismatch(["a", "b", "info", "m", {}, "", ""]) == ""
    assert "message of sysid.errors:Finding holds a int" in own.mismatch(
        ["a", "b", "info", 3, {}, "", ""]
    )
    assert own.mismatch(["a"]) == "sysid.errors:Finding has 7 fields, not 1"


@pytest.mark.parametrize(
    ("name", "fields", "said"),
    [
        ("os:system", [], "no class of this program"),
        ("sysid..os:system", [], "no class"),
        (3, [], "no class"),
        ("sysid.nothing:Here", [], "sysid.nothing|No module"),
        ("sysid.errors:LogError", [], "whose values are data"),
        ("sysid.foreign.raw:Finding", FIELDS, "whose values are data"),
        ("sysid.errors:Finding", FIELDS[:4], "other fields"),
        ("sysid.errors:Finding", FIELDS[::-1], "other fields"),
        ("sysid.data.nowhere:X", [], "no class"),
    ],
    ids=str,
)
def test_any_other_name_is_refused(name, fields, said):
    before = set(sys.modules)
    with pytest.raises((ValueError, ImportError), match=said):
        find_class(name, fields)
    assert not {m for m in set(sys.modules) - before if not m.startswith("sysid")}


def test_only_plain_dataclasses_of_the_project_are_its_own():
    @dataclass
    class Stranger:
        a: int

    assert storable_class(Stranger) is None
    assert storable_class(dict) is None
    assert storable_class(LogError) is None
    assert storable_class(Finding) is not None
