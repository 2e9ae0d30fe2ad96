"""Campaigns in Python leave the bytes of the command, and their results read as they were
written.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import uqharness as uq
from tests.helpers.places import TESTS
from uqharness.campaign.read_spec import read_campaign as read_file
from uqharness.campaign.run import Progress
from uqharness.cli.main import main
from uqharness.commands.campaign import CampaignResult, campaign_of
from uqharness.statistics.pbox import Sample

pytestmark = pytest.mark.usefixtures("flights_here")

CAMPAIGN = TESTS / "doc_campaign.toml"
TABLES = ("cases.parquet", "pbox.parquet", "excursions.csv", "statements.csv")


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> CampaignResult:
    return uq.run_campaign(CAMPAIGN, tmp_path_factory.mktemp("python") / "results", workers=2)


def test_a_campaign_leaves_the_bytes_of_the_command(
    result: CampaignResult, tmp_path: Path, capsys: pytest.CaptureFixture
):
    assert main(["campaign", "run", str(CAMPAIGN), "--out", str(tmp_path / "out"), "--serial"]) == 0
    for name in TABLES:
        assert (result.folder / name).read_bytes() == (tmp_path / "out" / name).read_bytes(), name
    capsys.readouterr()
    # Either goes on with what the other has begun.
    assert main(["campaign", "run", str(CAMPAIGN), "--out", str(result.folder)]) == 0
    assert "32 of them before" in capsys.readouterr().out
    repeat = uq.run_campaign(CAMPAIGN, tmp_path / "out")
    assert repeat.cases.equals(result.cases)
    assert capsys.readouterr() == ("", "")


def test_its_tables_are_those_of_the_folder(result: CampaignResult):
    assert len(result.cases) == 32
    stored = pd.read_parquet(result.folder / "pbox.parquet")
    boxes = result.pboxes()
    assert set(boxes) == set(zip(stored["metric"], stored["condition"], strict=True))
    for (metric, condition), box in boxes.items():
        rows = stored[(stored["metric"] == metric) & (stored["condition"] == condition)]
        for name in (
            "value",
            "lower",
            "upper",
            "band_lower",
            "band_upper",
            "corner_lower",
            "corner_upper",
        ):
            np.testing.assert_array_equal(getattr(box, name), rows[name])
    statements = result.statements()
    assert list(statements["radius_m"]) == [15, 25, 15, 25]
    assert set(statements["best"]) <= set(result.cases["epistemic_id"])


def test_a_dictionary_and_a_file_mean_the_same(result: CampaignResult, tmp_path: Path):
    sections = tomllib.loads(CAMPAIGN.read_text())
    reports: list[Progress] = []
    outcome = uq.run_campaign(
        sections, tmp_path / "out", workers=1, hours=20 / 3600, on_progress=reports.append
    )
    assert reports[-1].done == len(outcome.cases) == 4
    assert outcome.manifest["campaign"]["aleatory"]["flights"] == 1
    assert outcome.manifest["command"] == ""
    assert result.manifest["command"] == f"uqharness campaign run {CAMPAIGN} --out {result.folder}"
    flight = result.cases[result.cases["aleatory_id"] == 0].reset_index(drop=True)
    pd.testing.assert_frame_equal(outcome.cases, flight)
    spec = read_file(CAMPAIGN)
    assert all(
        campaign_of(inputs).as_dict() == spec.as_dict()
        for inputs in (sections, spec, CAMPAIGN, str(CAMPAIGN))
    )


def test_bad_input_is_said(result: CampaignResult, tmp_path: Path):
    with pytest.raises(uq.BadInputError, match="not a campaign folder"):
        uq.read_campaign(tmp_path)
    with pytest.raises(uq.BadInputError, match=r"nowhere\.toml"):
        uq.run_campaign("nowhere.toml", tmp_path / "out")
    with pytest.raises(uq.BadInputError, match="received int"):
        uq.run_campaign(3, tmp_path / "out")
    with pytest.raises(uq.BadInputError, match="flights"):
        uq.run_campaign(
            tomllib.loads(CAMPAIGN.read_text()) | {"aleatory": {"flights": 0, "duration_s": 1}},
            tmp_path / "out",
        )
    with pytest.raises(uq.BadInputError, match="workers = 0"):
        uq.run_campaign(CAMPAIGN, tmp_path / "out", workers=0)
    with pytest.raises(uq.BadInputError, match="engine = 'numba'"):
        uq.run_campaign(CAMPAIGN, tmp_path / "out", engine="numba")
    with pytest.raises(uq.BadInputError, match="another campaign"):
        uq.run_campaign(CAMPAIGN, result.folder, hours=1.0)
    (result.folder / "statements.csv").write_text("condition\n")
    with pytest.raises(uq.BadInputError, match=r"statements\.csv"):
        uq.read_campaign(result.folder).statements()


def test_a_pbox_counts_what_is_not_known():
    values = {"a": [3.0, 1.0, 2.0], "b": [2.0, float("nan"), 4.0]}
    box = uq.pbox(values)
    same = uq.pbox([Sample("a", np.array([1.0, 2.0, 3.0])), Sample("b", np.array([2.0, 4.0]), 1)])
    for name in ("value", "lower", "upper", "band_lower", "band_upper", "corner_lower"):
        np.testing.assert_array_equal(getattr(box, name), getattr(same, name))
    assert box.lower[-1] == 2 / 3
    assert set(uq.pbox(list(values.values())).corner_lower) <= {"0", "1"}
    for invalid in ([], [[]], [[float("nan")]], [["x"]]):
        with pytest.raises(uq.BadInputError, match="samples: "):
            uq.pbox(invalid)
    with pytest.raises(uq.BadInputError, match="confidence = 0"):
        uq.pbox(values, confidence=0.0)
