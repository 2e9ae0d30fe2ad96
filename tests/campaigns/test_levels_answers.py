"""Answers of statements against simulated campaigns whose rates are known."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from campaigns.levels.answers import (
    ASKED_M,
    NEAR_M,
    REACH,
    TRUTHS,
    keeps_level,
    main,
    measured,
    simulated,
)

pytestmark = pytest.mark.slow

COMMITTED = Path(__file__).parents[2] / "campaigns" / "levels" / "answers.csv"


def named(name: str):
    return next(truth for truth in TRUTHS if truth.campaign == name)


def test_flights_have_the_rates_they_are_said_to_have():
    """Per hour flown at each corner, and the share of flights with an excursion at the worst."""
    truth = replace(named("clusters of 4 and aborted flights"), flights=1_000_000, abort=0.3)
    frame = simulated(truth, np.random.default_rng(1))
    frame["lost"] = 1.0 * (frame["status"] != "ok")
    sums = frame.groupby("epistemic_id")[
        [f"excursions_{ASKED_M:g}m", f"excursions_{NEAR_M:g}m", "lost", "duration_s"]
    ].sum()
    hours = sums["duration_s"] / 3600.0
    assert (sums[f"excursions_{ASKED_M:g}m"] / hours).tolist() == pytest.approx(
        [truth.rate * share for share in REACH], rel=0.05
    )
    assert (sums[f"excursions_{NEAR_M:g}m"] / hours).tolist() == pytest.approx(
        [truth.near_per_h] * 4, rel=0.05
    )
    assert (sums["lost"] / hours).tolist() == pytest.approx([truth.loss_per_h] * 4, rel=0.02)
    worst = frame[frame["epistemic_id"] == "3"]
    share = ((worst[f"excursions_{ASKED_M:g}m"] > 0) | (worst["lost"] > 0)).mean()
    assert share == pytest.approx(truth.flight_share, rel=0.02)


@pytest.mark.parametrize("name", ["half of the flights aborted", "clusters of 2"])
def test_answers_keep_their_level(name):
    level = measured(named(name), 60)
    assert keeps_level(level, 60)
    assert level["yes_to_four_times"] > 0.1


def test_answers_do_not_where_clusters_are_assumed_away():
    truth = replace(named("clusters of 4, of which the campaign knows nothing"), cluster=8)
    assert measured(truth, 80)["wrong_yes"] > 0.15


def test_limits_that_say_nothing_keep_no_level():
    names = ("wrong_yes", "wrong_yes_losses", "wrong_no", "missed_share")
    assert not keeps_level({**dict.fromkeys(names, 0.0), "infinite_limits": 1.0}, 1000)


def test_the_committed_table_is_of_these_campaigns_and_keeps_its_levels():
    rows = list(csv.DictReader(COMMITTED.read_text(encoding="utf-8").splitlines()))
    assert [row["campaign"] for row in rows] == [truth.campaign for truth in TRUTHS]
    assert [row["kept"] == "yes" for row in rows] == [truth.counts_near for truth in TRUTHS]


def test_too_few_repeats_are_refused(tmp_path, capsys):
    assert main(["--out", str(tmp_path), "--repeats", "10"]) == 2
    assert "100 at least" in capsys.readouterr().err
