"""Statements of a made-up campaign whose rates are known."""

from __future__ import annotations

import csv
import io

import numpy as np
import pandas as pd
import pytest

from uqharness.campaign.statements import number, statements, statements_csv

HOURS = 0.5


def campaign(acceptable=4.0, rule="flights") -> dict:
    air = {"duration_s": 3600.0 * HOURS, "flights": 400, "wind_mps": [3.0], "turbulence": ["none"]}
    return {
        "stop": {"rule": rule}, "aleatory": air,
        "metrics": {"excursion_radius_m": [15.0], "acceptable_per_h": acceptable, "dispersion": 1.0},
    }  # fmt: skip


def flown(means=(0.5, 1.5), flights=400, failed=0, seed=0) -> pd.DataFrame:
    """Poisson counts per flight, of corners with these means."""
    rng = np.random.default_rng(seed)
    rows = []
    for corner, mean in enumerate(means):
        for k in range(flights):
            bad = k < failed
            rows.append({
                "wind_mps": 3.0, "turbulence": "none", "epistemic_id": f"{corner:02d}", "status": "crashed" if bad else "ok",
                "duration_s": 3600.0 * HOURS, "excursions_15m": float(rng.poisson(mean)), "excursions_15m_3d": np.nan,
                "extrapolated_share": 0.25,
            })  # fmt: skip
    return pd.DataFrame(rows)


def test_the_best_and_the_worst_corner_and_their_limits():
    frame = flown()
    (found,) = statements(frame, campaign())
    rates = frame.groupby("epistemic_id")["excursions_15m"].mean() / HOURS
    assert (found.best.epistemic_id, found.worst.epistemic_id) == ("00", "01")
    assert (found.best.rate, found.worst.rate) == pytest.approx((rates["00"], rates["01"]))
    for item, truth in ((found.best, 1.0), (found.worst, 3.0)):
        assert item.lower < truth < item.upper
    assert found.answer == "yes"
    assert found.extrapolated_share == 0.25
    assert found.corner_limits.shape == (2, 2)
    assert found.dispersion_observed == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize(("acceptable", "answer"), [(4.0, "yes"), (3.0, "open"), (2.0, "no")])
def test_the_answer_is_about_the_worst_corner(acceptable, answer):
    assert statements(flown(), campaign(acceptable))[0].answer == answer


def test_a_flight_that_failed_may_have_had_one_more():
    whole, broken = (statements(flown(failed=k), campaign())[0] for k in (0, 160))
    assert broken.worst.rate == pytest.approx(whole.worst.rate + 0.4 / HOURS)
    assert broken.best.rate == whole.best.rate
    assert broken.answer != "yes"


def test_more_flights_narrow_the_limits():
    few, many = (statements(flown(flights=n), campaign())[0].worst for n in (50, 800))
    assert many.upper - many.lower < 0.5 * (few.upper - few.lower)


def test_a_decision_that_was_taken_stands():
    rows = [{"condition": "3 m/s none", "radius_m": "15", "epistemic_id": "all", "answer": "flying"}]
    assert statements(flown(), campaign(), rows)[0].answer == "flying"
    other = [{**rows[0], "radius_m": "25"}]
    assert statements(flown(), campaign(), other)[0].answer == "yes"


def test_the_table_has_a_row_a_statement_and_nothing_where_nothing_is_known():
    (row,) = csv.DictReader(io.StringIO(statements_csv(statements(flown((0.001, 0.001), 30), campaign())).decode()))
    assert (row["condition"], row["radius_m"], row["flights"]) == ("3 m/s none", "15", "60")
    assert row["dispersion_observed"] == ""
    assert float(row["hours"]) == pytest.approx(60 * HOURS)
    assert number(float("nan")) == ""
    assert number(1.23456789) == "1.23457"
