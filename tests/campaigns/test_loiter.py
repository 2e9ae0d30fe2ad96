"""Table 4.7 and its p-boxes from shards: shares known in closed form are found, and others than the
print's are said to be.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from campaigns.excursions.reproduce import HOME as EXCURSIONS
from campaigns.library.flights import FLIGHTS
from campaigns.library.study import published_table
from campaigns.loiter.reproduce import CELL, METRICS, compare, main
from tests.helpers.study_flights import flown, with_medians
from uqharness.flight import COEFFICIENTS

# Effects of a level [the metric's unit]: shares are each over their sum where all have one sign,
# whatever the others are.
PRINTED = {"CX": 0.02, "CY": 3.95, "CZ": 0.32, "Cl": 0.33, "Cm": 0.4, "Cn": 4.98}
OTHERWISE = {"CX": 9.0, "CY": 0.2, "CZ": 0.2, "Cl": 0.2, "Cm": 0.2, "Cn": 0.2}


def linear(effects):
    def change(flight) -> float:
        air = float(np.random.default_rng(flight.seed_turbulence).normal())
        return (
            40.0
            + air
            + sum(effects[name] * flight.properties[f"uq/{name}/level"] for name in COEFFICIENTS)
        )

    return change


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    found = {}
    for name, effects in (("printed", PRINTED), ("otherwise", OTHERWISE)):
        folder = tmp_path_factory.mktemp(name)
        fly = with_medians(linear(effects))
        source = flown(EXCURSIONS / "campaign.toml", CELL, folder / FLIGHTS, fly)
        assert main([str(source), "--out", str(folder)]) == 0
        found[name] = folder
    return found


@pytest.mark.parametrize(("name", "effects"), [("printed", PRINTED), ("otherwise", OTHERWISE)])
def test_shares_of_a_linear_response_are_its_effects_over_their_sum(folders, name, effects):
    frame = pd.read_csv(folders[name] / "shares.csv")
    assert len(frame) == 6 * len(METRICS)
    for row in frame.to_dict("records"):
        true = effects[row["coefficient"]] / sum(effects.values())
        # Values of 40 to 50 are kept within 0.5 %, of a width of 10.
        assert row["share_min"] == pytest.approx(true, abs=0.012)
        assert row["share_max"] == pytest.approx(true, abs=0.012)


def test_shares_as_printed_overlap_and_others_do_not(folders):
    verdicts = {}
    for name, folder in folders.items():
        frame = pd.read_csv(folder / "shares.csv")
        verdicts[name] = (
            frame[frame["metric"] == "cross_track_median_m"]
            .set_index("coefficient")["beside"]
            .to_dict()
        )
    assert set(verdicts["printed"].values()) == {"overlaps"}
    assert verdicts["otherwise"]["CX"] == "above"
    assert verdicts["otherwise"]["Cn"] == verdicts["otherwise"]["CY"] == "below"


def test_the_pbox_has_its_quantiles_and_the_picture_its_charts(folders):
    frame = pd.read_csv(folders["printed"] / "pboxes.csv")
    middle = frame[(frame["metric"] == "speed_median_mps") & (frame["probability"] == 0.5)].iloc[0]
    assert middle["worst"] - middle["best"] == pytest.approx(10.0, abs=0.5)
    # CX moves less than the grid's half a per cent.
    assert (f"{middle['best_corner']:06d}"[1:], f"{middle['worst_corner']:06d}"[1:]) == (
        "00000",
        "11111",
    )
    assert middle["hours_per_corner"] == 25
    assert (folders["printed"] / "pboxes.svg").read_text().count('class="label"') == 2 * len(
        METRICS
    )


def test_ranges_are_compared_by_their_limits():
    table = published_table("4.7").set_index("coefficient")
    assert table.loc["CX", "altitude_max"] == 0.7427
    assert compare((0.1, 0.4), (0.4, 0.5)) == "overlaps"
    assert compare((0.1, 0.35), (0.4, 0.5)) == "below"
    assert compare((0.55, 0.8), (0.4, 0.5)) == "above"


def test_a_source_without_flights_is_bad_input(tmp_path, capsys):
    assert main([str(tmp_path), "--out", str(tmp_path)]) == 2
    assert str(tmp_path) in capsys.readouterr().err
