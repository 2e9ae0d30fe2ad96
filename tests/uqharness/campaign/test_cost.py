"""What a campaign is said to cost before it starts, and the question that a long one asks."""

from __future__ import annotations

import json
import tracemalloc

import pytest

from tests.helpers import campaign_fakes as fakes
from uqharness.campaign import cost
from uqharness.campaign.cases import build_cases
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import find_mission
from uqharness.campaign.sampling import epistemic_samples
from uqharness.cli.main import main

pytestmark = pytest.mark.usefixtures("flights_here")

MEAN = (
    '\n[aleatory.variables."inertia/mass-slugs"]\ndistribution = "normal"\nmean = [1.4, 1.5]\nstd ='
    " 0.02\n"
)


CORNERS = 'method = "corners"'


LEVELS = 'method = "levels"\nlevels = [0, 0.5, 1]'


METHODS = [
    f"{CORNERS}\ninterior = 5\nnominal = true",
    f"{CORNERS}\nset_default",
    LEVELS,
    'method = "white"\nsamples = 3',
    "none",
]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("mean", ["", MEAN])
def test_flights_are_counted_as_they_are_built(tmp_path, method, mean):
    text = fakes.CAMPAIGN.replace("wind_mps = 3", "wind_mps = [1, 3]")
    plain = text.partition("[epistemic]")[0] + '[epistemic]\nmethod = "none"\n'
    if "\n" in method:
        text = text.replace("interior = 0\nnominal = false\n", "")
    text = plain if method == "none" else text.replace(CORNERS, method.replace("\nset_default", ""))
    spec = read_campaign(fakes.campaign_file(tmp_path, text + mean))
    mission = find_mission(spec)
    size = cost.size_of(spec)
    assert size.epistemic == len(epistemic_samples(spec))
    assert size.flights == len(build_cases(spec, mission))
    assert size.hours == pytest.approx(size.flights * 210.0 / 3600.0)
    assert cost.size_of(spec, 5).flights == -(-size.flights // 5)
    flight = cost.one_case(spec, mission).flight
    assert (flight.aircraft, flight.duration_s, flight.turbulence) == (
        mission.aircraft,
        150.0,
        "moderate",
    )


def test_time_is_that_of_what_is_missing():
    size = cost.Size(10, 1, 64, 640, 3600.0, False)
    result = cost.Cost(size, 40, cost.Pace(1.0, 0.001), 2)
    assert (result.missing, result.seconds, result.is_long) == (
        600,
        pytest.approx(600 * 4.6 / 2),
        False,
    )
    assert "40 flights done before; about 23 min on 2 processes of this machine" in result.words
    assert cost.Cost(size, 0, cost.Pace(600.0, 0.0), 2).is_long
    assert cost.Cost(size, 0, None, 2).seconds is None
    assert "about" not in cost.Cost(size, 0, None, 2).words


def test_a_campaign_of_years_is_refused_at_once_in_little_memory(tmp_path, capsys):
    path = fakes.campaign_file(tmp_path, fakes.CAMPAIGN.replace("flights = 3", "flights = 1000000"))
    tracemalloc.start()
    try:
        code = main(["campaign", "run", str(path), "--out", str(tmp_path / "out")])
        maximum = tracemalloc.get_traced_memory()[1]
    finally:
        # Left running, it would slow down every test that follows.
        tracemalloc.stop()
    output = capsys.readouterr()
    assert (code, output.out) == (2, "")
    assert (
        "64000000 flights (64 epistemic samples, 1 condition, 1000000 each), 3733333 flight h"
        in output.err
    )
    assert "128 GB of disk" in output.err
    assert "give --yes to run it, or --hours H" in output.err
    assert maximum < 200e6
    assert not (tmp_path / "out").exists()


def test_a_slow_model_is_refused_after_its_check_flight_and_yes_flies_it(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr("uqharness.flight.fly.fly", fakes.steady)
    slow = cost.Pace(3600.0, 0.0)
    monkeypatch.setattr("uqharness.campaign.run.validate_model", lambda fly, case: slow)
    run = ["campaign", "run", str(fakes.campaign_file(tmp_path)), "--serial", "--out"]
    assert main([*run, str(tmp_path / "out")]) == 2
    assert "about 8 days on 1 process of this machine" in capsys.readouterr().err
    assert main([*run, str(tmp_path / "out"), "--yes", "--json"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["cases"] == 192
    assert "192 flights (64 epistemic samples" in printed.err
    assert main([*run, str(tmp_path / "hours"), "--hours", "0.05"]) == 0


def test_check_flies_nothing_that_counts(tmp_path, capsys):
    text = fakes.CAMPAIGN.replace('"plane"', '"espaaro"').replace("150", "3600")
    text = text.replace('"loiter.xml"', '"scripts/loiter.xml"')
    check = ["campaign", "check", str(fakes.campaign_file(tmp_path, text))]
    before = sorted(tmp_path.rglob("*"))
    assert main([*check, "--json", "--workers", "2"]) == 0
    result = json.loads(capsys.readouterr().out)
    counts = [result[name] for name in ("flights", "epistemic_samples", "conditions")]
    assert counts == [192, 64, 1]
    assert not result["more_than_a_day"]
    assert 0.1 < result["expected_s"] < 3600.0
    assert sorted(tmp_path.rglob("*")) == before
    assert main([*check, "--hours", "1000000"]) == 0
    assert "needs --yes or --hours" in capsys.readouterr().out
    assert main([*check, "--workers", "0"]) == 2
