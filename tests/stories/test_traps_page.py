"""Every trap of docs/jsbsim-traps.md names the test that reproduces it, and every such test stands
on a page.
"""

from __future__ import annotations

import re

from tests.helpers.doc_names import defined, rows
from tests.helpers.places import ROOT

PAGE = (ROOT / "docs" / "jsbsim-traps.md").read_text(encoding="utf-8")
DEFECTS = ROOT / "tests" / "jsbsim_defects"
TRAPS = ("test_defects.py", "test_silent_defects.py", "test_reach.py")


def reproductions(*names: str) -> set[str]:
    return {test for name in names for test in defined(DEFECTS / name) if test.startswith("test_")}


def test_each_trap_names_its_test():
    present = reproductions(*TRAPS)
    present |= reproductions("../uqharness/replay/test_speed.py")
    untested = 0
    for row in rows(PAGE):
        assert len(row) == 4, row
        listed = re.findall(r"`(test_\w+)`", row[3])
        if row[3].startswith("none: "):
            untested += 1
        else:
            assert len(listed) == 1, row
            assert listed[0] in present, row
    assert untested <= 1


def test_each_test_is_named_by_a_page():
    listed = set(re.findall(r"`(test_\w+)`", PAGE))
    lacking = reproductions(*TRAPS) - listed
    assert lacking == {"test_the_version_these_findings_belong_to"}
    letters = {
        re.match(r"test_([a-z])_", test)[1]
        for test in reproductions("test_turbulence_defects.py")
        if re.match(r"test_[a-z]_", test)
    }
    air = (ROOT / "docs" / "air.md").read_text(encoding="utf-8")
    assert letters == set(re.findall(r"^\| ([a-z]) \| ", air, re.M))
