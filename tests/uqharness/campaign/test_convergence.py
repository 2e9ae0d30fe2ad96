"""Area metric and convergence of a campaign by their two commands."""

from __future__ import annotations

import csv
import json

import pytest
from lxml import etree

from tests.helpers import campaign_fakes as fakes
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import run_campaign
from uqharness.cli.main import main

pytestmark = pytest.mark.usefixtures("flights_here")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Six walks of 20 flights."""
    root = tmp_path_factory.mktemp("walks")
    text = fakes.CAMPAIGN.replace(
        '"corners"', '"walk"\nsamples = 6\nwalk_rate_per_sqrt_s = 0.01'
    ).replace("flights = 3", "flights = 20")
    spec = read_campaign(fakes.campaign_file(root, text))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("uqharness.campaign.run.validate_model", lambda fly, case: None)
        run_campaign(spec, root / "out", executor=SerialExecutor(), fly=fakes.steady)
    return root / "out"


def test_the_convergence_command(folder, capsys):
    assert main(["campaign", "convergence", str(folder), "--repeats", "5", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    rows = list(csv.DictReader((folder / "convergence.csv").read_text().splitlines()))
    assert len(rows) == len(result["rows"]) == 3 * (1 + 3)
    assert {row["kind"] for row in rows} == {"aleatory", "epistemic"}
    first = next(row for row in rows if row["kind"] == "aleatory")
    assert (first["repeats"], first["flights"], first["samples"]) == ("5", "4", "")
    assert 0.0 < float(first["distance"]) <= float(first["expected_distance"])
    assert [row["samples"] for row in rows if row["kind"] == "epistemic"][:3] == ["2", "4", "6"]
    for name in result["figures"]:
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
        (["area", "--value", "speed"], "--value speed: a metric with its number"),
        (["area", "--value", "speed=3"], "no metric of this campaign"),
        (["area", "--flight", "nowhere.csv"], "cannot be read"),
    ],
)
def test_convergence_and_area_refuse_bad_arguments(folder, words, fragment, capsys):
    assert main(["campaign", words[0], str(folder), *words[1:]]) == 2
    assert fragment in capsys.readouterr().err
