"""Equations of docs/method.md stand beside functions that exist, and the ones that can be are held
against them.
"""

from __future__ import annotations

import re

from tests.helpers.doc_names import wrong_places
from tests.helpers.places import ROOT

PAGE = (ROOT / "docs" / "method.md").read_text(encoding="utf-8")


def test_functions_of_the_page_exist():
    assert wrong_places(PAGE) == []


def test_each_equation_has_its_function_near():
    parts = re.split(r"\n## ", PAGE)[1:]
    for part in parts:
        equations = part.count("$$") // 2
        places = len(re.findall(r"`[\w/]+\.(?:py:[\w.]+|xml)`", part))
        assert equations == 0 or places >= 1, part.splitlines()[0]
    assert PAGE.count("$$") // 2 >= 20
    assert PAGE.count("$$") % 2 == 0
