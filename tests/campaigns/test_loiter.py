"""Table 4.7 and its p-boxes from shards: shares known in closed form are found, and others than the
print's are said to be.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from campaigns.excursions.reproduce import HOME as EXCURSIONS
from campaigns.library.flights import FLIGHTS
from campaigns.loiter.one_flight import SIGNALS, errors, flights, run
from campaigns.loiter.reproduce import CELL, METRICS, main
from tests.helpers.study_flights import fly_study, with_medians
from uqharness.errors import BadInputError
from uqharness.flight import COEFFICIENTS, FlightResult

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
    result = {}
    for name, effects in (("printed", PRINTED), ("otherwise", OTHERWISE)):
        folder = tmp_path_factory.mktemp(name)
        fly = with_medians(linear(effects))
        source = fly_study(EXCURSIONS / "campaign.toml", CELL, folder / FLIGHTS, fly)
        assert main([str(source), "--out", str(folder)]) == 0
        result[name] = folder
    return result


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


def test_a_source_without_flights_is_bad_input(tmp_path, capsys):
    assert main([str(tmp_path), "--out", str(tmp_path)]) == 2
    assert str(tmp_path) in capsys.readouterr().err


def flight_with(scatter):
    """Errors normal with the standard deviation ``spread``, those that sensors saw twice as
    large.
    """

    def fly(spec):
        true = np.random.default_rng(3).normal(0.0, scatter, 40_000)
        signals = {
            f"{name}{suffix}": factor * true
            for name in SIGNALS
            for suffix, factor in (("", 1.0), ("_measured", 2.0))
        }
        return FlightResult("ok", "", spec.duration_s, {}, {}, signals)

    return fly


def test_quantiles_are_those_of_the_folded_normal_distribution(tmp_path):
    reports = run(tmp_path, flight_with(1.5))
    frame = pd.read_csv(tmp_path / "one-flight.csv")
    assert len(frame) == len(reports) * 2 * len(SIGNALS)
    for measured, rows in frame.groupby(frame["error"].str.endswith("_measured")):
        # Half of |x| lies below 0.6745 sigma, 95 % below 1.96 sigma.
        sigma = 3.0 if measured else 1.5
        assert rows["q50"].to_numpy() == pytest.approx(0.6745 * sigma, rel=0.02)
        assert rows["q95"].to_numpy() == pytest.approx(1.96 * sigma, rel=0.02)
        assert rows["q50"].to_numpy() != pytest.approx(0.6745 * 2.0, rel=0.02)
    picture = (tmp_path / "one-flight.svg").read_text()
    assert picture.count("median, published flight") == 3


def test_a_flight_that_ended_early_has_no_distribution_of_an_hour():
    with pytest.raises(BadInputError, match="ended diverged"):
        errors(FlightResult("diverged", "not finite at 60 s", 60.0, {}, {}, {}))


def test_four_flights_differ_by_air_or_model_alone():
    result = list(flights().values())
    assert len(result) == 4
    assert len({spec.seed_turbulence for spec in result}) == 1
    assert [spec.turbulence for spec in result] == ["moderate", "severe", "severe", "severe"]
    assert [bool(spec.properties) for spec in result] == [False, False, True, True]
    assert result[2].properties != result[3].properties
