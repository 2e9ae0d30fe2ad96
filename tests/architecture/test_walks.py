"""The five walks of docs/architecture.md: modules that exist, at most twelve each."""

from __future__ import annotations

import re
from itertools import pairwise

import pytest

from tests.architecture.rooms import modules
from tests.helpers.places import ROOT

MAX_MODULES = 12
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
SECTION = PAGE.split("## Five walks\n")[1].split("\n## ")[0]
WALKS = dict(re.findall(r"^\*\*(.+?)\.\*\* ((?:.+\n)+)", SECTION, re.M))


@pytest.mark.parametrize("title", WALKS)
def test_a_walk_names_at_most_twelve_modules_that_exist(title: str) -> None:
    names = re.findall(r"`((?:sysid|uqharness)\.[a-z_.]+)`", WALKS[title])
    assert set(names) <= modules().keys()
    assert 5 <= len(set(names)) <= MAX_MODULES
    assert not any(a == b for a, b in pairwise(names))
