"""Walks at full size beside the corners of the excursion tables: inside, outside, in the airs that
all flew.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from campaigns.excursions.full_size import plan as corners_plan
from campaigns.library.tables import common_airs
from tests.helpers.campaign_scripts import campaign_script
from tests.helpers.shards import flown
from uqharness.errors import BadInputError
from uqharness.flight import COEFFICIENTS

STUDY = campaign_script("time-varying", "full_size")
PLAN = replace(STUDY.plan(), airs=25, samples=8).with_samples(8).with_flights(25)


def between(spread):
    """Corners lie from 10 to 16; walks about the middle, ``spread`` times as far from it as
    corners.
    """

    def change(flight) -> float:
        air = 0.1 * float(np.random.default_rng(flight.seed_turbulence).normal())
        if flight.levels is None:
            return 10.0 + air + sum(flight.properties[f"uq/{name}/level"] for name in COEFFICIENTS)
        return 13.0 + air + spread * 3.0 * (int(flight.levels.epistemic_id[-1]) / 3.5 - 1.0)

    return change


@pytest.fixture(scope="module")
def corners(tmp_path_factory):
    plan = corners_plan()
    return flown(
        plan, tmp_path_factory.mktemp("corners"), between(1.0), list(plan.only(["severe-3"]))[:1]
    )


@pytest.mark.parametrize(
    ("spread", "verdict", "area"), [(0.5, "inside", 0.5), (1.5, "outside", 1.5)]
)
def test_walks_within_the_corners_and_beyond(corners, tmp_path, spread, verdict, area):
    told = STUDY.tables(PLAN, flown(PLAN, tmp_path / "shards", between(spread)), tmp_path, corners)
    frame = pd.read_csv(tmp_path / "containment.csv").set_index("metric")
    row = frame.loc["speed_median_mps"]
    assert row["verdict"] == verdict
    assert row["area_ratio"] == pytest.approx(area, abs=0.05)
    assert (row["corners"], row["walks"], row["hours_per_walk"]) == (64, 8, 25)
    grown = pd.read_csv(tmp_path / "walks-enough.csv")
    areas = grown[grown["metric"] == "speed_median_mps"].set_index("samples")["area"]
    assert areas.index.tolist() == [2, 4, 8]
    assert areas.is_monotonic_increasing
    assert set(pd.read_csv(tmp_path / "rates.csv")["kind"]) == {"corners", "walks"}
    assert any("8" in line and "100 %" in line for line in told)


def test_walks_fly_the_air_of_the_corners():
    ours, theirs = STUDY.plan(), corners_plan()
    shards = [next(iter(plan.only(["severe-3"]))) for plan in (ours, theirs)]
    first = [
        plan.cases(shard)[0].flight for plan, shard in zip((ours, theirs), shards, strict=True)
    ]
    assert first[0].seed_turbulence == first[1].seed_turbulence
    assert first[0].seed_noise == first[1].seed_noise
    assert ours.spec.epistemic.bounds == theirs.spec.epistemic.bounds
    assert sum(len(s.part.aleatory_ids) * len(s.part.samples) for s in ours.shards()) == 2000 * 50


def test_a_round_that_is_not_complete_is_left_out():
    walks = pd.DataFrame(
        {"epistemic_id": ["a", "b", "a", "b", "a"], "aleatory_id": [0, 0, 1, 1, 2]}
    )
    corner = pd.DataFrame({"epistemic_id": ["x"] * 3, "aleatory_id": [1, 2, 3]})
    outer, inner = common_airs(corner, walks)
    assert outer["aleatory_id"].tolist() == [1]
    assert inner["aleatory_id"].tolist() == [1, 1]
    with pytest.raises(BadInputError, match="no air in common"):
        common_airs(corner[corner["aleatory_id"] == 3], walks)
