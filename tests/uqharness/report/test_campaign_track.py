"""Ground tracks of a campaign: of the flights flown again, worst first; without any, the command
that flies the worst.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from uqharness.report.campaign import track_cases, track_section
from uqharness.report.parts import Figures, Words

pytestmark = pytest.mark.usefixtures("flights_here")

TIME = np.arange(0.0, 40.0, 0.1)
ANGLE = 2.0 * np.pi * TIME / 40.0
FRAME = pd.DataFrame(
    {
        "case_id": ["a", "b", "c", "d"],
        "epistemic_id": ["CX-", "CX+", "CX-", "CX+"],
        "wind_mps": [3.0, 3.0, 7.0, 7.0],
        "turbulence": ["moderate"] * 4,
        "cross_track_median_m": [9.0, 1.0, 2.0, 4.0],
    }
)


def record(folder, case, radius=100.0):
    path = folder / "rerun" / case / "record.parquet"
    path.parent.mkdir(parents=True)
    offset = np.sin(TIME)
    columns = {
        "time_s": TIME,
        "north_m": (radius + offset) * np.cos(ANGLE),
        "east_m": (radius + offset) * np.sin(ANGLE),
    }
    pd.DataFrame(columns | {"error_cross_track": offset}).to_parquet(path)


def blocks(folder, frame=FRAME):
    (section,) = track_section(folder, frame, "x-")
    return section.blocks


def test_the_worst_and_the_median_flight_of_the_hardest_condition_are_shown():
    assert track_cases(FRAME) == ("d", "c")
    five = pd.DataFrame(
        {
            "case_id": list("abcde"),
            "wind_mps": 3.0,
            "turbulence": "light",
            "cross_track_median_m": [5, 1, 4, 2, 3.0],
        }
    )
    assert track_cases(five) == ("a", "e")
    assert track_cases(five.assign(cross_track_median_m=[np.nan, 1.0, np.nan, np.nan, np.nan])) == (
        "b",
    )
    assert track_cases(five.assign(cross_track_median_m=np.nan)) == ()
    assert track_cases(five.drop(columns="cross_track_median_m")) == ()


def test_records_are_drawn_the_farthest_first(tmp_path):
    for case in ("b", "a", "elsewhere"):
        record(tmp_path, case)
    figures = next(b for b in blocks(tmp_path) if isinstance(b, Figures)).items
    assert [f.name for f in figures] == ["x-track-a", "x-track-b"]
    assert "Case a: CX-, 3 m/s moderate." in figures[0].caption
    assert "commanded circle, radius 100 m" in str(figures[0].svg)


def test_a_damaged_record_is_told_and_no_error(tmp_path):
    record(tmp_path, "a")
    path = tmp_path / "rerun" / "a" / "record.parquet"
    path.write_bytes(path.read_bytes()[:100])
    assert any(isinstance(b, Words) and "record.parquet" in b.text for b in blocks(tmp_path))
