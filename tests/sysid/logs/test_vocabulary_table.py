"""The table of signals and their sources."""

from __future__ import annotations

from sysid.logs.signal_map import markdown_table, shipped_dialects
from sysid.vocabulary import SIGNALS
from tests.helpers.places import ROOT


def test_every_signal_has_a_row_and_every_dialect_a_column() -> None:
    head, _, *rows = markdown_table().splitlines()
    assert [cell.strip() for cell in head.split("|")[4:-1]] == shipped_dialects()
    assert [row.split("`")[1] for row in rows] == list(SIGNALS)
    (speed,) = (row for row in rows if row.startswith("| `V_mps` |"))
    assert "VFR_HUD.airspeed" in speed


def test_the_documentation_holds_the_vocabulary() -> None:
    page = (ROOT / "docs" / "log-reference.md").read_text(encoding="utf-8")
    for line in markdown_table().splitlines():
        assert "|".join(line.split("|")[:4]) + "|" in page
