"""Repeats of the nominal model at full size: alike where they are, apart where one differs, and how
many flights are enough.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from campaigns.convergence.reproduce import HOME, enough, main
from campaigns.library.flights import FLIGHTS, cases_of, records
from tests.helpers.study_flights import fly_study, with_medians
from uqharness.errors import BadInputError

CAMPAIGN, CELL = HOME / "campaign.toml", "light-0"
TURN = {c.flight.seed_turbulence: c.aleatory_id for c in cases_of(CAMPAIGN, CELL, range(400))}


def normal(flight) -> float:
    return 5.0 + 0.2 * float(np.random.default_rng(flight.seed_turbulence).standard_normal())


def shifted_once(flight) -> float:
    """The third repeat lies half a standard deviation higher."""
    return normal(flight) + 0.25 * (200 <= TURN[flight.seed_turbulence] < 300)


def test_repeats_that_are_alike_and_one_that_is_not(tmp_path):
    for name, change in (("like", normal), ("unlike", shifted_once)):
        path = tmp_path / name / FLIGHTS
        fly_study(CAMPAIGN, CELL, path, with_medians(change), 400, resolution=0.0005)
        assert main([str(path), "--repeats", "4", "--out", str(path.parent)]) == 0
        frame = pd.read_csv(tmp_path / name / "convergence.csv")
        assert frame["repeats"].tolist() == [4, 4, 4]
        assert frame["flights"].tolist() == [100, 100, 100]
        difference = frame["distance"] > frame["expected_distance"]
        assert difference.tolist() == [name == "unlike"] * 3
        assert (tmp_path / name / "curves.svg").read_text().startswith("<svg")
        assert "all,1,400,400," in (tmp_path / name / "cost.csv").read_text()


def test_parts_come_closer_with_their_number_as_chance_says():
    frame = pd.DataFrame(
        {"aleatory_id": range(5000), "m": np.random.default_rng(4).normal(size=5000)}
    )
    result = enough(frame, "m")
    assert [row["flights"] for row in result] == [10, 20, 50, 100, 200, 500]
    assert [row["parts"] for row in result] == [500, 250, 100, 50, 25, 10]
    assert all(row["distance"] < row["bound"] for row in result)
    # A standard error of a median is 1.2533 / sqrt(n); of m parts the farthest lies about its
    # sqrt(2 ln m) away.
    for row in result[:4]:
        assert row["median_off"] == pytest.approx(
            1.2533 / row["flights"] ** 0.5 * (2.0 * np.log(row["parts"])) ** 0.5, rel=0.35
        )
    frame.loc[2000:2499, "m"] += 0.5
    assert enough(frame, "m")[-1]["distance"] > enough(frame, "m")[-1]["bound"]


def test_flights_without_a_value_are_refused():
    with pytest.raises(BadInputError, match="has no value"):
        enough(pd.DataFrame({"aleatory_id": [0, 1], "m": [1.0, np.nan]}), "m")


def test_the_published_flights_are_all_there():
    assert [row["flights"] for row in records(HOME / FLIGHTS)[CELL]] == [500] * 10
