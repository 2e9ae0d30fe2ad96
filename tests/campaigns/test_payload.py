"""A payload that differs from flight to flight: its slope is found where there is one, and none
where there is none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from campaigns.excursions.reproduce import HOME as EXCURSIONS
from campaigns.library.flights import FLIGHTS, cases_of
from campaigns.payload.reproduce import CELL, HOME, MASS, effect, main
from sysid.units import SLUG_KG
from tests.helpers.study_flights import fly_study, with_medians
from uqharness.errors import BadInputError
from uqharness.flight import COEFFICIENTS

PROPERTY = MASS.removeprefix("variable_")


def by_mass(slope_per_kg):
    def change(flight) -> float:
        draw = np.random.default_rng(flight.seed_turbulence)
        payload_kg = SLUG_KG * (flight.properties.get(PROPERTY, 1.46225) - 1.46225)
        value = 5.0 + 0.1 * float(draw.normal()) + slope_per_kg * payload_kg
        # What the mass does besides to this flight.
        scatter = 0.02 * float(draw.normal()) if PROPERTY in flight.properties else 0.0
        return (
            value
            + scatter
            + 0.3 * sum(flight.properties[f"uq/{name}/level"] for name in COEFFICIENTS)
        )

    return change


@pytest.fixture(scope="module")
def constant(tmp_path_factory):
    path = tmp_path_factory.mktemp("constant") / FLIGHTS
    return fly_study(EXCURSIONS / "campaign.toml", CELL, path, with_medians(by_mass(0.0)))


@pytest.mark.parametrize("slope", [0.12, pytest.param(0.0, marks=pytest.mark.slow)])
def test_the_slope_is_found_where_there_is_one(constant, tmp_path, slope):
    fly = with_medians(by_mass(slope))
    source = fly_study(HOME / "campaign.toml", CELL, tmp_path / FLIGHTS, fly)
    assert main([str(source), "--constant", str(constant), "--out", str(tmp_path)]) == 0
    frame = pd.read_csv(tmp_path / "effects.csv").set_index("metric")
    assert len(frame) == 3
    for row in frame.to_dict("records"):
        assert row["airs"] == 25
        assert abs(row["slope_per_kg"] - slope) < 4.0 * row["slope_error"]
        assert (abs(row["slope_per_kg"]) > 10.0 * row["slope_error"]) == (slope != 0.0)
        assert row["area_ratio"] == pytest.approx(1.0, abs=0.03)
        assert (row["spread"] > 1.3 * row["constant_spread"]) == (slope != 0.0)
    assert set(pd.read_csv(tmp_path / "rates.csv")["kind"]) == {"payload varied", "constant"}


def test_a_slope_needs_three_airs():
    two = pd.DataFrame(
        {"epistemic_id": ["a", "a"], "aleatory_id": [0, 1], "m": [1.0, 2.0], MASS: [1.4, 1.5]}
    )
    with pytest.raises(BadInputError, match="needs three at least"):
        effect(two, two.drop(columns=MASS), "m")


def test_flights_with_and_without_payload_differ_by_it_alone():
    ours, theirs = (
        cases_of(home / "campaign.toml", CELL, range(25)) for home in (HOME, EXCURSIONS)
    )
    assert ours[5].flight.properties.keys() - theirs[5].flight.properties.keys() == {PROPERTY}
    assert replace(ours[5].flight, properties=theirs[5].flight.properties) == theirs[5].flight
    masses = [SLUG_KG * case.inputs[MASS] for case in ours]
    assert min(masses) > 0.9 * 21.33
    assert max(masses) < 1.1 * 21.35
    assert len(set(masses)) == 25
