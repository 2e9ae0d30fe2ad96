"""Flight modes by number and name, against the table of pymavlink."""

from __future__ import annotations

from pymavlink.mavutil import mode_mapping_apm

from sysid.logs.signal_map import markdown_table
from sysid.vocabulary import PLANE_MODES
from tests.helpers.places import ROOT


def test_numbers_are_those_of_pymavlink():
    shared = set(PLANE_MODES) & set(mode_mapping_apm)
    assert len(shared) >= 20
    assert {n: PLANE_MODES[n] for n in shared} == {n: mode_mapping_apm[n] for n in shared}


# The table of signals and their sources.


def test_the_documentation_holds_the_vocabulary() -> None:
    page = (ROOT / "docs" / "log-reference.md").read_text(encoding="utf-8")
    for line in markdown_table().splitlines():
        assert "|".join(line.split("|")[:4]) + "|" in page
