"""Area metric and convergence: closed forms, simulation, and the two commands."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from lxml import etree

from tests.helpers import campaign_fakes as fakes
from uqharness.campaign.execution.processes import SerialExecutor
from uqharness.campaign.run import run_campaign
from uqharness.campaign.spec.read import read_campaign
from uqharness.cli.main import main
from uqharness.statistics.area import area_metric
from uqharness.statistics.convergence import growth, repeats
from uqharness.statistics.pbox import Sample, pbox


def box(*corners, unknown=0):
    return pbox([Sample(str(number), np.asarray(values, float), unknown) for number, values in enumerate(corners)])


def test_the_area_of_a_single_flight_is_its_mean_distance():
    """One corner, one flight: integral of |F - step| = mean |X - x|; within a wide box the flight is inside."""
    values = [1.0, 2.0, 4.0]
    for flight in (0.0, 2.0, 7.0):
        found = area_metric(box(values), np.array([flight]))
        assert found.area == pytest.approx(np.mean(np.abs(np.array(values) - flight)))
    assert area_metric(box([0.0, 1.0], [5.0, 6.0]), np.array([3.0])).area == 0.0


def test_the_area_is_the_shift_where_one_distribution_is_moved():
    values = np.random.default_rng(1).normal(size=200)
    for shift in (0.5, -0.5):
        found = area_metric(box(values), values + shift)
        assert found.area == pytest.approx(abs(shift), rel=0.05)
        assert (found.above if shift > 0 else found.below) == pytest.approx(found.area)
    # Between two corners nothing is left of it.
    assert area_metric(box(values, values + 1.0), values + 0.5).area == pytest.approx(0.0, abs=1e-9)


def test_failed_flights_leave_room_above():
    flights = np.array([9.0] * 8)
    assert area_metric(box([1.0] * 8), flights).area == pytest.approx(8.0)
    assert area_metric(box([1.0] * 4, unknown=4), flights).area == pytest.approx(4.0)


def test_chance_is_blamed_before_the_model_is():
    generator = np.random.default_rng(2)
    false = 0
    for _ in range(200):
        model = box(*(generator.normal(shift, 1.0, 60) for shift in (0.0, 0.5, 1.0)))
        false += area_metric(model, generator.normal(1.0, 1.0, 12)).beyond_chance > 0.0
    assert false / 200 <= 0.05
    model = box(generator.normal(size=200))
    assert area_metric(model, generator.normal(2.0, 1.0, 30)).beyond_chance > 0.0
    # A single flight far away is no proof: the model may send one in fifty there.
    assert area_metric(model, np.array([9.0])).beyond_chance == 0.0


def test_repeats_of_one_law_lie_within_what_chance_explains_and_others_do_not():
    generator = np.random.default_rng(3)
    apart = [repeats(generator.gamma(4.0, 1.0, 400), 10) for _ in range(200)]
    assert np.mean([item.distance <= item.expected for item in apart]) >= 0.95
    assert apart[0].curves.shape == (10, 40)
    drifting = generator.normal(size=400) + np.repeat(np.arange(10), 40)
    assert repeats(drifting, 10).distance > apart[0].expected
    with pytest.raises(ValueError, match="do not make 10 repeats"):
        repeats(np.arange(19.0), 10)


def test_the_chance_that_one_more_sample_leaves_the_envelope():
    """Walks as draws from one law: at a fixed value the next one lies outside in 2/(m + 1) of studies, in no more."""
    generator = np.random.default_rng(4)
    curves = generator.random((4000, 17))
    outside = (curves[:, 16] > curves[:, :16].max(axis=1)) | (curves[:, 16] < curves[:, :16].min(axis=1))
    samples = [generator.normal(generator.normal(), 1.0, 50) for _ in range(16)]
    found = growth(samples, seed=1)
    assert [item.samples for item in found] == [2, 4, 8, 16]
    assert np.mean(outside) == pytest.approx(found[-1].chance_of_more, abs=0.02)
    areas = [item.area for item in found]
    assert areas == sorted(areas)
    assert found[-1].area_low == found[-1].area == found[-1].area_high
    same = growth([np.array([1.0, 2.0, np.inf])] * 4, seed=1)
    assert [item.area for item in same] == [0.0, 0.0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Six walks of 20 flights."""
    root = tmp_path_factory.mktemp("walks")
    text = fakes.CAMPAIGN.replace('"corners"', '"walk"\nsamples = 6\nwalk_rate_per_sqrt_s = 0.01').replace(
        "flights = 3", "flights = 20"
    )
    spec = read_campaign(fakes.campaign_file(root, text))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("uqharness.campaign.run.validate_model", lambda fly, case: None)
        run_campaign(spec, root / "out", executor=SerialExecutor(), fly=fakes.steady)
    return root / "out"


def test_the_convergence_command(folder, capsys):
    assert main(["campaign", "convergence", str(folder), "--repeats", "5", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    rows = list(csv.DictReader((folder / "convergence.csv").read_text().splitlines()))
    assert len(rows) == len(found["rows"]) == 3 * (1 + 3)
    assert {row["kind"] for row in rows} == {"aleatory", "epistemic"}
    first = next(row for row in rows if row["kind"] == "aleatory")
    assert (first["repeats"], first["flights"], first["samples"]) == ("5", "4", "")
    assert 0.0 < float(first["distance"]) <= float(first["expected_distance"])
    assert [row["samples"] for row in rows if row["kind"] == "epistemic"][:3] == ["2", "4", "6"]
    for name in found["figures"]:
        assert etree.parse(name).getroot().tag == "{http://www.w3.org/2000/svg}svg"
    before = (folder / "convergence.csv").read_bytes()
    assert main(["campaign", "convergence", str(folder), "--repeats", "5"]) == 0
    assert (folder / "convergence.csv").read_bytes() == before
    assert "5 repeats of 4 flights lie within" in capsys.readouterr().out


def test_the_area_command(folder, tmp_path, capsys):
    name = "cross_track_median_m_measured"
    assert main(["campaign", "area", str(folder), "--value", f"{name}=10", "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert (row["metric"], row["flights"], row["verdict"]) == (name, 1, "no contradiction")
    table = tmp_path / "flights.csv"
    table.write_text(f"wind_mps,turbulence,{name}\n" + "3,moderate,500\n" * 30 + "5,moderate,1\n")
    assert main(["campaign", "area", str(folder), "--flight", str(table)]) == 1
    assert "30 flights" in capsys.readouterr().out
    (row,) = csv.DictReader((folder / "area.csv").read_text().splitlines())
    assert row["verdict"] == "outside"
    assert float(row["area_above"]) == pytest.approx(float(row["area"]))
    assert float(row["area"]) > 100


@pytest.mark.parametrize(
    ("words", "fragment"),
    [
        (["convergence", "--repeats", "1"], "at least 2"),
        (["convergence", "--metric", "altitude"], "--metric altitude: not in"),
        (["area"], "no flight to compare"),
        (["area", "--value", "speed"], "must be METRIC=NUMBER"),
        (["area", "--value", "speed=3"], "no metric of this campaign"),
        (["area", "--flight", "nowhere.csv"], "cannot be read"),
    ],
)
def test_what_cannot_be_answered(folder, words, fragment, capsys):
    assert main(["campaign", words[0], str(folder), *words[1:]]) == 2
    assert fragment in capsys.readouterr().err
