"""Derivatives of a stock aircraft are those of its XML."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.ordinary_flights.examine import derivatives, estimate, with_vanes
from tests.ordinary_flights.truth import Weather, cruise, fly, write_model


def test_derivatives_are_the_constants_of_the_aircraft() -> None:
    slopes = cruise("minisgs").slopes
    assert slopes["Cl"]["p"] == pytest.approx(-0.47, rel=1e-3)
    assert slopes["Cn"]["r"] == pytest.approx(-0.025, rel=1e-2)
    assert slopes["Cl"]["da"] > 0.0 > slopes["Cm"]["de"]
    assert slopes["Cn"]["dr"] < 0.0


def test_flight_stays_near_cruise_and_differs_by_seed() -> None:
    a, b = (fly("minisgs", seed, 10.0, Weather()) for seed in (1, 2))
    assert np.all(np.abs(a["phi_rad"]) < 1.0)
    assert a.dt_s == pytest.approx(0.02)
    assert not np.array_equal(a["p_radps"], b["p_radps"])


@pytest.mark.slow
def test_accelerometers_replace_the_vanes(tmp_path: Path) -> None:
    record, model = fly("c172p", 31, 120.0, Weather("milspec")), write_model("c172p", tmp_path, 31)
    rows = {}
    for vanes in ("true", "none"):
        result, _ = estimate("c172p", with_vanes(record, vanes), model, tmp_path)
        rows[vanes] = {r.name: r for r in derivatives("c172p", result)}
    assert np.mean([r.inside for r in rows["none"].values()]) >= 0.9
    # Lift scales what depends on the angle of attack, and a flight without steps of the elevator
    # does not tell its slope.
    assert "Cm_alpha" not in rows["none"]
    ratios = {n: rows["none"][n].std / rows["true"][n].std for n in _MATTERS}
    assert max(ratios.values()) < 2.0, ratios
    assert np.median(list(ratios.values())) < 1.2


_MATTERS = ("Cl_beta", "Cl_p", "Cl_da", "Cm_q", "Cm_de", "Cn_beta", "Cn_r", "Cn_dr")


@pytest.mark.slow
def test_flight_without_steps_says_where_the_start_value_counts(tmp_path: Path) -> None:
    record = fly("minisgs", 31, 90.0, Weather("milspec", turns=False))
    result, _ = estimate("minisgs", record, write_model("minisgs", tmp_path, 31), tmp_path)
    rows = {r.name: r for r in derivatives("minisgs", result)}
    assert {rows[n].basis for n in ("Cm_q", "Cn_r")} == {"start value and data"}
    assert rows["CY_beta"].basis == "data"
    assert np.mean([r.inside for r in rows.values() if r.basis == "data"]) >= 0.9
