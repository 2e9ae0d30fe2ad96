"""The study of bounds over seeds: one seed's flights, what its noise is worth, and what the tables
say of made-up answers.
"""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from sysid.aerodynamics import noise_variance
from tests.helpers.campaign_scripts import campaign_script

FLIGHTS: ModuleType = campaign_script("model-form", "flights")
JUDGE: ModuleType = campaign_script("model-form", "judge")
STUDY: ModuleType = campaign_script("model-form")
TABLES: ModuleType = campaign_script("model-form", "tables")
CASES = {c.name: c for c in FLIGHTS.CASES}


@cache
def quiet_bounds_flight(name: str) -> Any:
    """The noise-free flight for bounds of one case."""
    return FLIGHTS.quiet_flight(CASES[name], FLIGHTS.BOUNDS, 0)


@pytest.fixture(scope="module")
def answers() -> list[dict[str, Any]]:
    """A seed of the truth and of the model itself in still air."""
    return [JUDGE.run_seed(CASES[name], 3) for name in ("nominal-calm", "truth-calm")]


def test_noisy_twin_adds_the_stated_noise():
    calm = quiet_bounds_flight("nominal-calm")
    with FLIGHTS.model_pair(calm.measured) as pair:
        one, same, other = (
            FLIGHTS.noisy_twin(calm, pair, (k, 0, 0), (1.0, 2.0)) for k in (1, 1, 2)
        )
    assert np.array_equal(one.residuals.delta, same.residuals.delta)
    assert not np.array_equal(one.residuals.delta, other.residuals.delta)
    # What is added is what the gains say of it.
    for k in range(6):
        measured = np.std(one.residuals.delta[:, k])
        stated = np.sqrt(
            np.mean(np.concatenate([noise_variance(p.noise)[:, k] for p in one.exactly().pieces]))
        )
        assert measured == pytest.approx(stated, rel=0.2)  # one draw, behind a slow filter
    result = one.sizes[1.0]
    assert result["p_radps"].std == pytest.approx(0.00349, rel=0.1)


@pytest.mark.slow
def test_the_true_error_is_inside_and_the_widths_are_the_noise_knowns(answers):
    rows, fits = STUDY.frames(answers)
    usual = rows[rows["way"] == "default"].set_index(["case", "coefficient", "speed_mps"])
    reference = rows[rows["way"] == "noise known"].set_index(["case", "coefficient", "speed_mps"])
    assert usual["inside_stretched"].min() > 0.9
    assert (usual["width"] / reference["width"]).max() < 1.5
    parts = fits[fits["way"] == "default"].set_index(["case", "coefficient"])
    assert not parts.loc["nominal-calm"]["found"].any()
    assert parts.loc["truth-calm"].loc[["CX", "CZ", "Cl", "Cm"], "found"].all()
    # Far below what the dissertation's interval holds, noise and all.
    assert (
        parts.loc["nominal-calm"]["persistent_width"]
        < 0.2 * parts.loc["nominal-calm"]["published_width"]
    ).all()


@pytest.mark.slow
def test_tables_and_verdicts(answers):
    rows, fits = STUDY.frames(answers)
    text = TABLES.tables(rows, fits)
    assert "| CX |" in text
    assert "truth-calm" in text
    invalid = TABLES.verdict(rows.assign(inside=0.9), fits)
    assert any("CY at 27 m/s: 90.0 %" in line for line in invalid)
    wide = rows.assign(width=np.where(rows["way"] == "default", 2.0, 1.0))
    assert any("2.00 times as wide" in line for line in TABLES.verdict(wide, fits))
    assert any(
        "a model error of CZ" in line for line in TABLES.verdict(rows, fits.assign(found=False))
    )
    assert any(
        "that is not there" in line for line in TABLES.verdict(rows, fits.assign(found=True))
    )
    valid = TABLES.verdict(
        rows.assign(inside=0.95, width=1.0, third=0.95),
        fits.assign(found=fits["case"] == "truth-calm"),
    )
    assert valid == []
