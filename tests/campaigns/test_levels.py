"""Limits, answers and bands against campaigns whose rates and distributions are known."""

from __future__ import annotations

import csv
from dataclasses import replace

import pytest

from campaigns.levels import answers, bands, reproduce
from tests.helpers.few import few
from uqharness.simulator.aircraft import PROJECT_ROOT

HOME = PROJECT_ROOT / "campaigns" / "levels"
REPEATS = 1500


def committed(name: str) -> list[dict[str, str]]:
    return list(csv.DictReader((HOME / name).read_text(encoding="utf-8").splitlines()))


@pytest.mark.parametrize("truth", few(reproduce.TRUTHS, 3), ids=lambda truth: truth.campaign)
def test_limits_keep_their_level(truth):
    assert reproduce.keeps_level(reproduce.measured(truth, REPEATS), REPEATS)


def test_limits_per_scheduled_hour_or_of_single_excursions_do_not():
    by_name = {truth.campaign: truth for truth in reproduce.TRUTHS}
    aborted = reproduce.measured(by_name["every flight but one in ten aborted"], REPEATS)
    assert aborted["losses_as_scheduled"] > 0.9
    clustered = reproduce.measured(by_name["clusters at the carried limit of 4, rare"], REPEATS)
    assert clustered["excursions_if_poisson"] > 5.0 * reproduce.ERROR


@pytest.mark.slow
@pytest.mark.parametrize("name", ["half of the flights aborted", "clusters of 2"])
def test_answers_keep_their_level(name):
    (truth,) = (truth for truth in answers.TRUTHS if truth.campaign == name)
    level = answers.measured(truth, 60)
    assert answers.keeps_level(level, 60)
    assert level["yes_to_four_times"] > 0.1


@pytest.mark.slow
def test_answers_do_not_where_clusters_are_assumed_away():
    name = "clusters of 4, of which the campaign knows nothing"
    (truth,) = (truth for truth in answers.TRUTHS if truth.campaign == name)
    assert answers.measured(replace(truth, cluster=8), 80)["wrong_yes"] > 0.15


def test_the_band_keeps_its_level_and_bands_of_one_corner_do_not():
    level = bands.measured(bands.Truth(16, 40, 0.9), 300)
    assert bands.keeps_level(level["missed"], 300)
    assert level["half_width"] < level["half_width_bonferroni"]
    assert not bands.keeps_level(level["missed_one_corner"], 300)
    assert not bands.keeps_level(level["missed_first_drawn"], 300)


def test_the_committed_tables_are_of_these_campaigns_and_keep_their_levels():
    rows = committed("answers.csv")
    retained = [(row["campaign"], row["kept"] == "yes") for row in rows]
    assert retained == [(truth.campaign, truth.counts_near) for truth in answers.TRUTHS]
    rows = committed("bands.csv")
    sizes = [(int(row["corners"]), int(row["airs"])) for row in rows]
    assert sizes == [(truth.corners, truth.airs) for truth in bands.TRUTHS]
    assert all(float(row["missed"]) <= 0.05 and row["kept"] == "yes" for row in rows)
    assert len(committed("levels.csv")) == len(reproduce.TRUTHS)


@pytest.mark.parametrize(
    ("study", "minimum"), [(reproduce, "1000"), (answers, "100"), (bands, "100")]
)
def test_too_few_repeats_are_refused(study, minimum, tmp_path, capsys):
    assert study.main(["--out", str(tmp_path), "--repeats", "10"]) == 2
    assert f"{minimum} at least" in capsys.readouterr().err
