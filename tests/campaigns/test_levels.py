"""Upper limits of statements against campaigns whose rates are known: 1,500 repeats each."""

from __future__ import annotations

import pytest

from campaigns.levels.reproduce import ERROR, TRUTHS, keeps_level, main, measured
from tests.helpers.few import few

REPEATS = 1500


@pytest.mark.parametrize("truth", few(TRUTHS, 3), ids=lambda truth: truth.campaign)
def test_limits_keep_their_level(truth):
    assert keeps_level(measured(truth, REPEATS), REPEATS)


def test_limits_that_take_too_little_into_account_do_not():
    """The check says no to a limit per scheduled hour, and to one that takes clusters for single
    excursions.
    """
    aborted, clustered = (
        "every flight but one in ten aborted",
        "clusters at the carried limit of 4, rare",
    )
    by_name = {
        truth.campaign: measured(truth, REPEATS)
        for truth in TRUTHS
        if truth.campaign in (aborted, clustered)
    }
    assert by_name[aborted]["losses_as_scheduled"] > 0.9
    assert by_name[clustered]["excursions_if_poisson"] > 5.0 * ERROR


@pytest.mark.slow
def test_it_writes_its_table(tmp_path, capsys):
    assert main(["--out", str(tmp_path), "--repeats", "1000"]) == 0
    assert len((tmp_path / "levels.csv").read_text().splitlines()) == 1 + len(TRUTHS)
    assert main(["--out", str(tmp_path), "--repeats", "10"]) == 2
    assert "1000 at least" in capsys.readouterr().err
