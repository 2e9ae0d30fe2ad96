"""A payload that differs from flight to flight: its slope is found where there is one, and none
where there is none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from campaigns.excursions.full_size import plan as constant_plan
from campaigns.payload.full_size import MASS, effect, plan, tables
from sysid.units import SLUG_KG
from tests.helpers.shards import flown
from uqharness.errors import BadInputError
from uqharness.flight import COEFFICIENTS

PLAN = replace(plan(), airs=25).with_flights(25)
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
    other = constant_plan()
    return flown(
        other, tmp_path_factory.mktemp("constant"), by_mass(0.0), list(other.only(["severe-3"]))[:1]
    )


@pytest.mark.parametrize("slope", [0.12, pytest.param(0.0, marks=pytest.mark.slow)])
def test_the_slope_is_found_where_there_is_one(constant, tmp_path, slope):
    told = tables(PLAN, flown(PLAN, tmp_path / "shards", by_mass(slope)), tmp_path, constant)
    frame = pd.read_csv(tmp_path / "effects.csv").set_index("metric")
    for row in frame.to_dict("records"):
        assert row["airs"] == 25
        assert abs(row["slope_per_kg"] - slope) < 4.0 * row["slope_error"]
        assert (abs(row["slope_per_kg"]) > 10.0 * row["slope_error"]) == (slope != 0.0)
        assert row["area_ratio"] == pytest.approx(1.0, abs=0.03)
        assert (row["spread"] > 1.3 * row["constant_spread"]) == (slope != 0.0)
    assert len(told) == 3
    assert set(pd.read_csv(tmp_path / "rates.csv")["kind"]) == {"payload varied", "constant"}


def test_a_slope_needs_three_airs():
    two = pd.DataFrame(
        {"epistemic_id": ["a", "a"], "aleatory_id": [0, 1], "m": [1.0, 2.0], MASS: [1.4, 1.5]}
    )
    with pytest.raises(BadInputError, match="needs three at least"):
        effect(two, two.drop(columns=MASS), "m", 1.46)


def test_flights_with_and_without_payload_differ_by_it_alone():
    ours, theirs = plan(), constant_plan()
    first = [p.cases(next(iter(p.only(["severe-3"]))))[5] for p in (ours, theirs)]
    assert first[0].flight.properties.keys() - first[1].flight.properties.keys() == {PROPERTY}
    assert replace(first[0].flight, properties=first[1].flight.properties) == first[1].flight
    masses = [
        SLUG_KG * case.inputs[MASS]
        for shard in list(ours.shards())[:1]
        for case in ours.cases(shard)
    ]
    assert min(masses) > 0.9 * 21.33
    assert max(masses) < 1.1 * 21.35
    assert len(set(masses)) == 25
