"""A campaign's page says which engine flew, why, and how far it is from JSBSim."""

from __future__ import annotations

from uqharness.campaign.tables import CheckRow
from uqharness.report.campaign import engine_section
from uqharness.report.parts import Table


def row(metric, difference, verdict="alike", remark="", case="1", part="whole"):
    return CheckRow(part, "calm", case, metric, "1", "1", "1", difference, verdict, remark)


def test_the_largest_difference_of_each_metric_and_what_was_excused():
    rows = [
        row("status", ""),
        row("altitude_max_m", "1e-9"),
        row("altitude_max_m", "3e-8", case="2"),
        row("excursions_15m", "1.0", "excused", "came near"),
        row("excursions_15m", "0.0", case="2"),
        row("nearest_excursions_15m", ""),
        row("altitude_max_m", "1.0", "alike", part="start"),
    ]
    output, note, table = engine_section("batch", [], rows).blocks
    assert output.text == "Simulated in the batch engine."
    assert note.text.startswith("2 complete flights, ")
    assert isinstance(table, Table)
    assert table.rows == (
        ("status", "1", "", "0"),
        ("altitude_max_m", "2", "3e-08", "0"),
        ("excursions_15m", "2", "0", "1 (came near)"),
    )
    assert len(engine_section("batch", [], []).blocks) == 2
