"""The study of bounds over seeds: small always, in full when there is time."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from sysid.aerodynamics.terms import COEFFICIENTS
from tests.helpers.campaign_scripts import campaign_script

_SCRIPT = campaign_script("model-form")
CASES = _SCRIPT.CASES
Case = _SCRIPT.Case
main = _SCRIPT.main
run_case = _SCRIPT.run_case
tables = _SCRIPT.tables
verdict = _SCRIPT.verdict


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    """Two seeds of the reference truth, one of the nominal truth in still air."""
    folder = tmp_path_factory.mktemp("flights")
    truth = Case("truth", "espaaro_truth", "light", ("default", "every sample counts"))
    still = next(c for c in CASES if c.name == "still")
    return pd.DataFrame([*run_case(truth, 3, folder), *run_case(truth, 4, folder), *run_case(still, 3, folder)])


def test_the_third_flight_is_covered(rows):
    """Two seeds scatter by two points a coefficient; all six together by less."""
    mine = rows[(rows["case"] == "truth") & (rows["variant"] == "default")]
    by_coefficient = mine.groupby("coefficient")["share_95"].mean()
    assert set(by_coefficient.index) == set(COEFFICIENTS)
    assert by_coefficient.min() > 0.88
    assert by_coefficient.mean() == pytest.approx(0.95, abs=0.025)
    assert mine["share_68"].mean() == pytest.approx(0.70, abs=0.05)


def test_counting_every_sample_covers_less(rows):
    mine = rows[rows["case"] == "truth"].groupby("variant")["share_95"].mean()
    assert mine["every sample counts"] < mine["default"] - 0.005


def test_in_still_air_the_nominal_truths_bounds_are_the_noise(rows):
    mine = rows[rows["case"] == "still"]
    ratio = mine["mean_width"] / mine["forced_width"]
    assert ratio.max() < 1.3
    assert ratio.min() > 0.9


def test_turbulence_widens_roll_and_nothing_else_so_much(rows):
    mine = rows[(rows["case"] == "truth") & (rows["variant"] == "default")].groupby("coefficient")
    ratio = mine["mean_width"].mean() / mine["noise_width"].mean()
    assert ratio.idxmax() == "Cl"
    assert ratio["CY"] < 1.3


def test_the_tables_and_the_verdict_say_so(rows):
    text = tables(rows)
    assert "| CX |" in text
    assert "99.4 / 64" in text
    assert "3-2-1-1, 20 m/s" in text
    assert verdict(rows.assign(share_95=0.95, mean_width=1.0, forced_width=1.0)) == []
    bad = verdict(rows.assign(share_95=np.where(rows["coefficient"] == "Cm", 0.9, 0.95), mean_width=1.4, forced_width=1.0))
    assert any(line.startswith("Cm: 90.0 %") for line in bad)
    assert any("CY" in line and "1.40 times" in line for line in bad)


@pytest.mark.slow
def test_twenty_seeds(tmp_path):
    assert main(["--out", str(tmp_path), "--seeds", "20"]) == 0
    assert "as asked for" in (tmp_path / "tables.md").read_text()
