"""The coverage study in small: the full one is `python -m campaigns.estimators.reproduce`."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from campaigns.estimators import aircraft
from campaigns.estimators import reproduce as study_coverage
from campaigns.estimators.reproduce import CASES, binomial_range, run_case

BY_NAME = {case.name: case for case in CASES}


@pytest.mark.slow
@pytest.mark.parametrize("plane", ["longitudinal", "lateral"])
def test_calm_air_is_covered(plane):
    table = run_case(BY_NAME[f"{plane}, calm, output_error"], 12, [300] * 3)
    pooled = table.iloc[-1]
    assert 90.0 < pooled["coverage_pct"] < 99.0
    assert table["inside"][:-1].all()
    assert pooled["warned"] == 0
    assert pooled["not_converged"] == 0


@pytest.mark.slow
def test_turbulence_is_covered_by_filter_error_and_not_by_cramer_rao_output_error():
    plain = run_case(BY_NAME["longitudinal, light turbulence, output_error"], 5, [300] * 3).iloc[-1]
    assert plain["crb_coverage_pct"] < 70.0
    assert plain["warned"] == 5
    filtered = run_case(BY_NAME["longitudinal, light turbulence, filter_error"], 2, [300] * 3).iloc[
        -1
    ]
    assert filtered["coverage_pct"] > 85.0  # of 24 intervals
    assert filtered["warned"] == 0
    assert filtered["median_error_over_true_pct"] < plain["median_error_over_true_pct"]


def test_binomial_range_is_exact():
    low, high = binomial_range(100, 0.95, 0.05)
    assert stats.binom.cdf(low - 1, 100, 0.95) <= 0.025 < stats.binom.cdf(low, 100, 0.95)
    assert stats.binom.sf(high, 100, 0.95) <= 0.025 < stats.binom.sf(high - 1, 100, 0.95)


def test_dryden_gusts_have_the_stated_variance_and_length():
    rng, lag = np.random.default_rng(0), 40 * aircraft.FINE
    for make, tau in ((aircraft._first_order, 0.8), (aircraft._second_order, 0.8)):
        series = np.concatenate([make(2.0, tau, 4000 * aircraft.FINE, rng) for _ in range(15)])
        assert series.std() == pytest.approx(2.0, rel=0.1)
        one = np.corrcoef(series[:-lag], series[lag:])[
            0, 1
        ]  # 0.8 s apart: 1/e, or (1 - 1/2)/e for the transverse gust
        assert one == pytest.approx(
            np.exp(-1.0) * (1.0 if make is aircraft._first_order else 0.5), abs=0.08
        )


def test_command_writes_the_table_and_refuses_bad_input(tmp_path, capsys):
    out = tmp_path / "table.csv"
    arguments = ["--seeds", "2", "--segments", "2", "--samples", "200", "--only", "lateral, calm"]
    arguments += ["--out", str(out)]
    assert study_coverage.main(arguments) in (0, 1)
    assert list(pd.read_csv(out)["parameter"])[-1] == "pooled"
    assert "coverage_pct" in capsys.readouterr().out
    assert study_coverage.main(["--seeds", "0", "--out", str(out)]) == 2
    assert study_coverage.main(["--only", "nothing", "--out", str(out)]) == 2
