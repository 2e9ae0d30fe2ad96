"""Sensitivity from the flights of a corner campaign: known shares, common random numbers, failures, refusals, its table."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pandas as pd
import pytest

from sysid.foreign.regular_files import sha256_hex
from tests.helpers import campaign_fakes as fakes
from tests.helpers.model_forms import made_up_form
from uqharness.campaign.cases import Mission
from uqharness.campaign.conditions import Condition
from uqharness.campaign.manifest import read_manifest, write_manifest
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import run_campaign
from uqharness.campaign.sensitivity import (
    SENSITIVITY,
    MetricSensitivity,
    analyse_campaign,
    find_winner,
    read_corner_campaign,
    read_interior_campaign,
)
from uqharness.cli.main import run_words
from uqharness.errors import BadInputError
from uqharness.flight.spec import FlightResult
from uqharness.sensitivity.measures import Index, MethodResult, PairRange, Ranking, all_undefined

pytestmark = pytest.mark.usefixtures("flights_here")

SLOPES = {"CX": 4.0, "CY": 2.0, "CZ": 1.0, "Cl": 0.5, "Cm": 0.25, "Cn": 0.0}


SHARES = {name: slope / 7.75 for name, slope in SLOPES.items()}


FLIGHTS = 12


def known_effects(spec):
    """Cross track: additive. Altitude: CX matters at high CY only. Speed: every corner the same.
    Chance is the air's alone.
    """
    level = {name: spec.properties.get(f"uq/{name}/level", 0.5) for name in SLOPES}
    draw = np.random.default_rng(spec.seed_turbulence)
    chance = float(draw.gamma(4.0))
    metrics = dict.fromkeys(fakes.ERROR_METRICS, 1.0) | dict.fromkeys(fakes.EXCURSIONS, 0.0)
    metrics["cross_track_median_m"] = (
        5.0 + sum(SLOPES[name] * level[name] for name in SLOPES) + chance
    )
    metrics["altitude_median_m"] = 2.0 + 3.0 * level["CX"] * level["CY"] + level["CZ"] + chance
    metrics["speed_median_mps"] = chance
    metrics |= {"loss_of_control": 0.0, "extrapolated_share": 0.0}
    return FlightResult("ok", "", spec.burn_in_s + spec.duration_s, metrics, {}, {})


def large(spec):
    return with_bump(spec, 80.0)


def dip(spec):
    """Least in the middle of CX."""
    level = spec.properties.get("uq/CX/level", 0.5)
    result = fakes.steady(spec)
    metrics = dict(result.metrics) | {"cross_track_median_m": 2.0 + 8.0 * abs(level - 0.5)}
    return FlightResult("ok", "", spec.burn_in_s + spec.duration_s, metrics, {}, {})


def with_bump(spec, size):
    result = known_effects(spec)
    level = spec.properties.get("uq/CX/level", 0.5)
    result.metrics["cross_track_median_m"] += size * level * (1.0 - level)
    return result


def one_fails(spec):
    """One corner crashes in one air."""
    result = known_effects(spec)
    corner = all(spec.properties[f"uq/{name}/level"] == 1.0 for name in SLOPES)
    if corner and spec.seed_turbulence % 5 == 0:
        return FlightResult("crashed", "reached the ground at 90 s", 90.0, {}, {}, {})
    return result


def fly(folder, function, name="out", text=fakes.CAMPAIGN, flights=FLIGHTS):
    spec = read_campaign(
        fakes.campaign_file(folder, text.replace("flights = 3", f"flights = {flights}"))
    )
    with pytest.MonkeyPatch.context() as patch:
        # The check flight in a process of its own is tested elsewhere and costs seconds.
        patch.setattr("uqharness.campaign.run.validate_model", lambda *_: None)
        run_campaign(spec, folder / name, executor=SerialExecutor(), fly=function)
    return folder / name


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    return fly(tmp_path_factory.mktemp("campaign"), known_effects)


def found_in(folder, metric, **options):
    (only,) = analyse_campaign(read_corner_campaign(folder), metrics=(metric,), **options)
    return only


def test_additive_shares_are_exact_and_the_order_certain(simulated):
    result = found_in(simulated, "cross_track_median_m")
    for name, share in SHARES.items():
        index = result.result.indices[name]
        assert (index.minimum.value, index.maximum.value) == pytest.approx((share, share))
        assert index.minimum.low - 1e-9 <= share <= index.maximum.high + 1e-9
    assert result.ranking.first == "CX"
    assert result.ranking.certain
    # Known at a bound, the envelope loses just that share: 7.75 m wide, 52 %.
    assert (
        "The p-box is 7.75 m wide; with CX known to lie at one of its bounds it would shrink by"
        " 52 %" in result.words
    )
    assert "Certain:" in result.words


def test_an_interaction_makes_a_range_and_the_order_uncertain(simulated):
    result = found_in(simulated, "altitude_median_m")
    for name in ("CX", "CY"):
        index = result.result.indices[name]
        assert (index.minimum.value, index.maximum.value) == pytest.approx((0.0, 0.75))
    assert result.result.indices["CZ"].maximum.value == pytest.approx(0.25)
    assert not result.ranking.certain
    assert {"CZ", "CY" if result.ranking.first == "CX" else "CX"} <= set(result.ranking.by_ranges)
    assert "Not certain: at some values of the other coefficients" in result.words


def test_a_metric_that_no_corner_moves_is_undefined_with_a_reason(simulated):
    result = found_in(simulated, "speed_median_mps")
    assert all(
        math.isnan(index.maximum.value) and index.reason for index in result.result.indices.values()
    )
    assert result.ranking.first == ""
    assert "no width" in result.words


def test_failed_flights_leave_their_air_out_everywhere_and_end_certainty(tmp_path):
    folder = fly(tmp_path, one_fails, flights=30)
    is_lost = sum(
        row["status"] != "ok"
        for row in read_corner_campaign(folder).frame[["status"]].to_dict(orient="records")
    )
    assert 0 < is_lost <= 3 * 10
    result = found_in(folder, "cross_track_median_m")
    if is_lost <= 3:
        assert result.left_out == is_lost
        assert result.flights == 30 - is_lost
        assert result.result.indices["CX"].maximum.value == pytest.approx(SHARES["CX"])
        assert "left out, because a flight of theirs failed" in result.words
    else:
        assert "gave no finite value" in result.words
    assert not result.ranking.certain


def test_one_flight_per_corner_has_shares_but_no_certainty(tmp_path):
    result = found_in(fly(tmp_path, known_effects, flights=1), "cross_track_median_m")
    assert result.result.indices["CX"].maximum.value == pytest.approx(SHARES["CX"])
    assert math.isnan(result.result.indices["CX"].maximum.high)
    assert "no interval from 1 aleatory draws" in result.result.statement
    assert not result.ranking.certain


def test_campaigns_that_are_no_corners_or_not_complete_are_refused(tmp_path, simulated):
    def refused(folder, message):
        with pytest.raises(BadInputError, match=message):
            read_corner_campaign(folder)

    refused(tmp_path, "not a campaign folder")
    text = fakes.CAMPAIGN.split("[epistemic]")[0] + '[epistemic]\nmethod = "none"\n'
    none = fly(tmp_path, fakes.steady, "none", text)
    refused(none, r'not a corner campaign \(method = "none"\)')
    text = fakes.CAMPAIGN.replace('method = "corners"', 'method = "levels"\nlevels = [0.5]')
    middle = fly(tmp_path, fakes.steady, "middle", text)
    refused(middle, r"levels \[0.5\]")
    corners = read_corner_campaign(simulated)
    assert len(read_interior_campaign(middle, corners).frame) == FLIGHTS
    with pytest.raises(BadInputError, match="not a campaign of levels"):
        read_interior_campaign(simulated, corners)
    manifest = read_manifest(none)
    write_manifest(none, manifest | {"state": "interrupted", "command": "uqharness campaign run x"})
    refused(none, "not complete; finish it first with: uqharness campaign run x")
    write_manifest(none, manifest | {"cases": 5})
    refused(none, "the manifest lists 5")
    with pytest.raises(BadInputError, match="metric cross_tracks: not in"):
        found_in(simulated, "cross_tracks")


def call(*words):
    return run_words(["sensitivity", *map(str, words)])


def test_the_command_writes_table_figure_and_words_the_same_each_time(simulated, capsys):
    assert call(simulated) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert "cross_track_median_m: reduce CX first." in captured.out
    figure = simulated / "figures" / "sensitivity-3mps-moderate.svg"
    first = (simulated / "sensitivity.csv").read_bytes(), figure.read_bytes()
    assert call(simulated, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert ((simulated / "sensitivity.csv").read_bytes(), figure.read_bytes()) == first
    assert result["figures"] == [str(figure)]
    cell = result["sensitivity"]["3 m/s moderate"]["cross_track_median_m"]
    assert cell["first"] == "CX"
    assert cell["certain"] is True
    assert cell["indices"]["CX"]["value"] == pytest.approx([SHARES["CX"]] * 2)
    assert result["sensitivity"]["3 m/s moderate"]["speed_median_mps"]["indices"]["CX"][
        "value"
    ] == [
        None,
        None,
    ]
    with (simulated / "sensitivity.csv").open() as handle:
        rows = list(csv.DictReader(handle))
    by_key = {(row["metric"], row["coefficient"]): row for row in rows}
    assert float(by_key["cross_track_median_m", "CY"]["share_max"]) == pytest.approx(
        SHARES["CY"], rel=1e-5
    )
    undefined = by_key["speed_median_mps", "CX"]
    assert undefined["share_min"] == ""
    assert "no width" in undefined["reason"]
    assert b"median cross-track error" in first[1]
    assert b"median speed error" not in first[1]


def test_nothing_to_compare_exits_with_one(tmp_path, capsys):
    folder = fly(tmp_path, fakes.trivial, flights=8)
    assert call(folder) == 1
    assert "no width" in capsys.readouterr().out


def test_interior_points_check_the_corners_and_move_no_share(tmp_path, simulated):
    text = fakes.CAMPAIGN.replace("interior = 0\nnominal = false", "interior = 9")
    reference = analyse_campaign(
        read_corner_campaign(fly(tmp_path / "i", known_effects, text=text)),
        metrics=["cross_track_median_m"],
    )
    single = analyse_campaign(read_corner_campaign(simulated), metrics=["cross_track_median_m"])
    assert reference[0].result.indices == single[0].result.indices
    assert reference[0].flights == single[0].flights
    assert reference[0].result.details["interior_outside"] == 0.0
    bumped = analyse_campaign(
        read_corner_campaign(fly(tmp_path / "b", large, text=text)),
        metrics=["cross_track_median_m"],
    )
    assert bumped[0].result.details["interior_outside"] > 0.02


def test_the_p_box_holds_the_nominal_model_and_the_points_between_corners(tmp_path):
    """The error is least between the bounds: corners alone exclude the nominal model's
    distribution.
    """
    text = fakes.CAMPAIGN.partition("bounds =")[0] + "bounds = { CX = 0.02 }\n"
    text += 'coefficients = ["CX"]\n'
    boxes = {}
    for name, keys in (("all", ""), ("corners", "interior = 0\nnominal = false\n")):
        folder = fly(tmp_path, dip, name, text + keys)
        frame = pd.read_parquet(folder / "cases.parquet")
        box = pd.read_parquet(folder / "pbox.parquet")
        boxes[name] = box[box["metric"] == "cross_track_median_m"]
        if name == "all":
            nominal = frame.loc[frame["epistemic_id"] == "nominal", "cross_track_median_m"].median()
            assert frame["epistemic_id"].nunique() == 2 + 2 + 1

    def smallest_median(box):
        return box.loc[box["upper"] >= 0.5, "value"].min()

    assert smallest_median(boxes["all"]) <= nominal < smallest_median(boxes["corners"])


def test_an_ellipsoid_has_no_corners_to_compare(tmp_path):
    made_up_form().write(tmp_path / "model-form.json")
    text = (
        fakes.CAMPAIGN.partition("bounds =")[0]
        + 'bounds = "model-form.json"\nset = "ellipsoid"\ncoefficients = ["CX", "CY"]\n'
    )
    spec = read_campaign(fakes.campaign_file(tmp_path, text))
    mission = Mission(tmp_path / "plane", "a" * 64, tmp_path / "loiter.xml", "b" * 64)
    run_campaign(
        spec, tmp_path / "out", executor=SerialExecutor(), fly=fakes.steady, mission=mission
    )
    with pytest.raises(BadInputError, match=r'points of an ellipsoid.*set = "box"'):
        read_corner_campaign(tmp_path / "out")


RANGES = {"CX": (0.2, 0.3), "Cm": (0.7, 0.8)}


def find() -> list[MetricSensitivity]:
    indices = {
        n: PairRange(Index(a, a - 0.1, a), Index(b, b, math.nan)) for n, (a, b) in RANGES.items()
    }
    shrink = {f"shrink_{end}": np.array([0.1, 0.6]) for end in ("min", "max", "low", "high")}
    details = {"area": 12.0, "area_low": 11.0, "area_high": 13.0, **shrink}
    result = MethodResult("proposed", 8, indices, True, "s", details)
    one = MetricSensitivity(
        Condition(3.0, "moderate"),
        "speed_max_mps",
        result,
        20,
        1,
        Ranking("Cm", ("CX",)),
        "reduce Cm first",
    )
    empty = all_undefined("proposed", RANGES, "no width")
    return [
        one,
        MetricSensitivity(
            Condition(5.0, "none"), "altitude_max_m", empty, 20, 0, Ranking(""), "undefined"
        ),
    ]


def manifest(content: bytes) -> dict:
    return {"format": 2, "state": "complete", "tables": {SENSITIVITY: sha256_hex(content)}}


def by_wind(spec):
    """Wide in wind, where Cm drives the error; narrow without, where CX does."""
    result = fakes.steady(spec)
    level = {name: spec.properties[f"uq/{name}/level"] for name in ("CX", "Cm")}
    chance = 1e-3 * (spec.seed_turbulence % 100)
    slopes = {"CX": 3.0, "Cm": 6.0} if spec.wind_mps else {"CX": 0.8, "Cm": 0.2}
    total = sum(slopes[name] * level[name] for name in slopes)
    result.metrics["cross_track_median_m"] = chance + total
    return result


def test_the_condition_with_the_widest_p_box_names_the_winner(tmp_path):
    text = fakes.CAMPAIGN.partition("bounds =")[0].replace("wind_mps = 3", "wind_mps = [0, 3]")
    text += 'bounds = { CX = 0.008, Cm = 0.012 }\ncoefficients = ["CX", "Cm"]\n'
    folder = fly(tmp_path, by_wind, text=text)
    winner = find_winner(folder, "cross_track_median_m")
    assert (winner.coefficient, winner.condition) == ("Cm", "3 m/s moderate")
    assert winner.share == pytest.approx((2.0 / 3.0, 2.0 / 3.0))
    # In calm air CX drives it: the answer is not the same everywhere.
    assert not winner.certain
    assert find_winner(folder, "cross_track_median_m", coefficient="CX").share[0] < 0.5
    for options, message in (
        ({"metric": "altitude"}, "--metric altitude: .* has "),
        ({"coefficient": "Cn"}, "--coefficient Cn: not uncertain in"),
    ):
        with pytest.raises(BadInputError, match=message):
            find_winner(folder, **options)
