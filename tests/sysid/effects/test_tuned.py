"""The table of numbers is the whole of it, short and explained."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
TABLE = ROOT / "sysid/effects/tuned.py"
MOST = 25


def numbers(text: str) -> dict[str, tuple[float, str]]:
    """name -> (value, reason) of a module's constants that are one number."""
    body = ast.parse(text).body
    out = {}
    for k, node in enumerate(body):
        if not isinstance(node, ast.Assign) or not isinstance(node.value, ast.Constant):
            continue
        following = body[k + 1] if k + 1 < len(body) else None
        told = isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant)
        out[node.targets[0].id] = (
            node.value.value,
            " ".join(following.value.value.split()) if told else "",
        )
    return out


def test_at_most_so_many_numbers_each_with_its_reason():
    table = numbers(TABLE.read_text())
    assert 10 < len(table) <= MOST
    assert [name for name, (_, reason) in table.items() if not reason] == []
    assert numbers("A = 0.5\nB = 1.0\n'Because.'\n") == {"A": (0.5, ""), "B": (1.0, "Because.")}


@pytest.mark.parametrize("room", ["sysid/effects", "uqharness/refinement"])
def test_every_number_of_the_table_is_used_and_stands_nowhere_else(room):
    table = numbers(TABLE.read_text())
    files = [p for p in (ROOT / room).rglob("*.py") if p != TABLE]
    assert not [(p.name, n) for p in files for n in numbers(p.read_text()) if n in table]


def test_no_number_of_the_table_is_idle():
    text = "".join(
        p.read_text()
        for room in ("sysid/effects", "uqharness/refinement")
        for p in (ROOT / room).rglob("*.py")
    )
    assert [n for n in numbers(TABLE.read_text()) if text.count(n) < 3] == []
