"""Bands over corners on common air against distribution functions that are known."""

from __future__ import annotations

import csv

from campaigns.levels.bands import TRUTHS, Truth, keeps_level, main, measured

REPEATS = 300


def test_the_band_keeps_its_level_and_bands_of_one_corner_do_not():
    level = measured(Truth(16, 40, 0.9), REPEATS)
    assert keeps_level(level["missed"], REPEATS)
    assert level["half_width"] < level["half_width_bonferroni"]
    assert not keeps_level(level["missed_one_corner"], REPEATS)
    assert not keeps_level(level["missed_first_drawn"], REPEATS)


def test_the_table_beside_the_study_is_about_these_campaigns():
    with open("campaigns/levels/bands.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(int(row["corners"]), int(row["airs"])) for row in rows] == [
        (truth.corners, truth.airs) for truth in TRUTHS
    ]
    assert all(float(row["missed"]) <= 0.05 and row["kept"] == "yes" for row in rows)


def test_too_few_repeats_are_refused(tmp_path, capsys):
    assert main(["--out", str(tmp_path), "--repeats", "10"]) == 2
    assert "100 at least" in capsys.readouterr().err
