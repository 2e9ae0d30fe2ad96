"""Next flights: from a corner campaign and bounds to test points that fly, and what their data do to the bounds."""

from __future__ import annotations

import csv
import json
import shlex
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from sysid.aerodynamics.residuals import Cutoffs, ResidualPiece, Residuals
from sysid.model_form.model_form import read_model_form
from tests.helpers import campaign_fakes as fakes
from tests.helpers.jsbsim_schema import schema_errors
from tests.helpers.model_forms import LONGITUDINAL, MEAN, SPREAD, made_up_form
from tests.helpers.page_checks import problems
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import run_campaign
from uqharness.cli.main import main
from uqharness.flight.spec import FlightResult
from uqharness.next_flight.plan import (
    prospects,
    scatter_ratios,
    widths_over,
)
from uqharness.next_flight.points import (
    AUTOPILOT,
    RECOVERY_S,
    Condition,
    Occupancy,
    Steps,
    TestFlight,
    TestPoint,
    fly_points,
    library,
    schedule,
    try_points,
    unit_times,
)
from uqharness.simulator.aircraft import PROJECT_ROOT, find_aircraft
from uqharness.simulator.mission import find_script

pytestmark = pytest.mark.usefixtures("flights_here")

CAMPAIGN = """
[campaign]
aircraft = "espaaro"
mission = "loiter"
seed = 7

[aleatory]
flights = 2
duration_s = 40
burn_in_s = 40
wind_mps = 3
turbulence = "light"

[epistemic]
method = "corners"
interior = 0
nominal = false
bounds = { CX = 0.008, CY = 0.010, CZ = 0.05, Cl = 0.0015, Cm = 0.012, Cn = 0.0015 }
"""


SLOPES = {"CX": 1.0, "CY": 4.0, "CZ": 0.5, "Cl": 0.25, "Cm": 0.1, "Cn": 0.05}


@pytest.fixture(scope="module", autouse=True)
def fewer_points():
    """A library of a third of the points: these tests are about what is done with them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("uqharness.next_flight.points.AMPLITUDES", (0.2,))
        yield


def known_effects(spec):
    """Cross track: CY above all. Altitude: CX alone."""
    level = {name: spec.properties.get(f"uq/{name}/level", 0.0) for name in SLOPES}
    metrics = dict.fromkeys(fakes.ERROR_METRICS, 1.0) | dict.fromkeys(fakes.EXCURSIONS, 0.0)
    metrics["cross_track_median_m"] = (
        5.0 + sum(SLOPES[n] * level[n] for n in SLOPES) + spec.seed_turbulence % 7
    )
    metrics["altitude_median_m"] = 1.0 + 2.0 * level["CX"]
    metrics |= {"loss_of_control": 0.0, "extrapolated_share": 0.0}
    return FlightResult("ok", "", spec.burn_in_s + spec.duration_s, metrics, {}, {})


def flown_campaign(folder: Path, text: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "campaign.toml"
    path.write_text(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("uqharness.campaign.run.validate_model", lambda *_: None)
        run_campaign(
            read_campaign(path), folder / "out", executor=SerialExecutor(), fly=known_effects
        )
    return folder / "out"


@pytest.fixture(scope="module")
def campaign(tmp_path_factory) -> Path:
    return flown_campaign(tmp_path_factory.mktemp("campaign"), CAMPAIGN)


@pytest.fixture(scope="module")
def first(tmp_path_factory) -> Path:
    """The first flight of the reference truth: two manoeuvres only, so that much is left to
    learn.
    """
    path = tmp_path_factory.mktemp("first") / "first.parquet"
    arguments = shlex.split(
        """fly espaaro_truth --script flight-bounds --duration-s 24 --noise --turbulence light"""
    )
    assert main([*arguments, "--seed", "5", "--out", str(path)]) == 0
    return path


@pytest.fixture(scope="module")
def bounds(first, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("bounds") / "bounds"
    arguments = [
        "bounds",
        "espaaro",
        "--flight",
        str(first),
        "--out",
        str(out),
        "--no-check",
        "--no-figures",
    ]
    assert main(arguments) == 0
    return out / "model-form.json"


@pytest.fixture(scope="module")
def planned(campaign, bounds, tmp_path_factory) -> tuple[int, Path]:
    """Exit code and folder of a plan of a minute and a half at one speed."""
    out = tmp_path_factory.mktemp("next") / "next"
    arguments = [
        "next-flight",
        str(campaign),
        "--bounds",
        str(bounds),
        *shlex.split("--minutes 1.5 --speeds 22 --cases 2"),
    ]
    return main([*arguments, "--turbulence", "light", "--out", str(out)]), out


def test_the_winner_and_its_prospects_are_told(planned):
    code, out = planned
    document = json.loads((out / "next-flight.json").read_text())
    assert document["format"] == "next-flight 1"
    assert (document["coefficient"], document["metric"]) == ("CY", "cross_track_median_m")
    assert document["share"] == pytest.approx([4.0 / 5.9, 4.0 / 5.9], abs=0.01)
    row = document["prospects"]["CY"]
    assert row["width_after"] < row["width"]
    assert 0.0 < row["narrowing"] <= row["narrowing_at_most"] + 1e-3
    assert row["parameter_narrowing"] > max(0.5, row["parameter_narrowing_same_manoeuvres"])
    assert code == (0 if row["narrowing"] >= 0.05 else 1)
    assert document["verdict"] == ("fly" if code == 0 else "no")
    assert set(document["where"]) == {"V_mps", "beta_rad", "p_radps", "r_radps"}
    # The loiter turns at some 0.16 rad/s; two manoeuvres from straight flight did so in gusts and
    # when they swung alone.
    r = document["where"]["r_radps"]
    assert r["mission"][0] > 0.1 > r["data"][1]
    assert r["mission"][1] > r["data"][2]
    assert document["flight_s"] <= 90.0
    assert any("constant" in w for w in document["warnings"])
    assert (out / "figures" / "next-flight.svg").stat().st_size > 10_000
    report = (out / "report.html").read_text(encoding="utf-8")
    assert document["points"][0]["name"] in report
    assert problems(report) == []


@pytest.mark.slow
def test_the_script_flies_and_the_redone_bounds_are_as_predicted(
    planned, campaign, first, bounds, tmp_path, capsys
):
    """One seed scatters; the mean over seeds is the study's (campaigns/next-flight)."""
    _, out = planned
    record = tmp_path / "new.parquet"
    arguments = [
        "fly",
        "espaaro_truth",
        "--script",
        str(out / "next-flight.xml"),
        "--noise",
        "--turbulence",
        "light",
    ]
    assert main([*arguments, "--seed", "77", "--out", str(record)]) == 0
    document = json.loads((out / "next-flight.json").read_text())
    labels = [n for n in pd.read_parquet(record)["manoeuvre"].unique() if n]
    assert set(labels) == {p["name"] for p in document["points"]}
    pair = tmp_path / "both"
    arguments = [
        "bounds",
        "espaaro",
        "--flight",
        str(first),
        str(record),
        "--out",
        str(pair),
        "--no-check",
        "--no-figures",
    ]
    assert main(arguments) == 0
    capsys.readouterr()
    arguments = [
        "next-flight",
        str(campaign),
        "--bounds",
        str(bounds),
        "--cases",
        "2",
        "--out",
        str(out),
        "--json",
    ]
    main([*arguments, "--redone", str(pair / "model-form.json")])
    achieved = json.loads(capsys.readouterr().out)["achieved"]
    for c in ("CY", "Cn"):
        # At the sizes of today's parts; more manoeuvres make those surer as well, so that more goes
        # than was promised.
        promised = document["prospects"][c]["parameter_narrowing"]
        assert 0.5 * promised < promised - 0.1 < achieved[c]["parameter_narrowing"] < 1.0
        assert achieved[c]["predicted_parameter"] == document["prospects"][c]["parameter_narrowing"]


def test_the_script_keeps_the_missions_lines_and_none_of_its_air(planned):
    _, out = planned
    text = (out / "next-flight.xml").read_text()
    assert (
        '<property value="120">ap/loiter-center-east-m</property>      <!-- m; the flight begins on'
        " the circle" in text
    )
    assert '<property value="0">air/wind-mps</property>' in text
    assert '<property value="0">air/turbulence-w20-kt</property>' in text
    # What stands above the root of loiter.xml tells of another flight.
    assert "takes about a minute to settle" not in text
    assert schema_errors(out / "next-flight.xml") == []


def test_the_table_holds_every_step(planned):
    _, out = planned
    document = json.loads((out / "next-flight.json").read_text())
    with (out / "test-points.csv").open() as handle:
        rows = list(csv.DictReader(handle))
    steps = [(p["number"], s["control"], s["size"]) for p in document["points"] for s in p["steps"]]
    assert [
        (int(r["number"]), r["control"], float(r["size"])) for r in rows if r["control"]
    ] == steps
    assert {int(r["number"]) for r in rows} == {p["number"] for p in document["points"]}
    limits = find_aircraft("espaaro").card.inputs
    assert all(limits[c].limits[0] < size < limits[c].limits[1] for _, c, size in steps)


@pytest.fixture(scope="module")
def fixed_plan() -> TestFlight:
    return TestFlight(find_aircraft("espaaro"), find_script("loiter"), True, 4.0, noise=False)


def test_points_are_flown_as_they_are_written(fixed_plan, tmp_path):
    """Speed and bank at the start, the steps in the commands, and a safety pilot where a point goes
    wrong.
    """
    points = [
        TestPoint("dive", (Steps("elevator", 15.0, 1.5, ((1, 1.0),)),), Condition(22.0), 6.0),
        TestPoint("doublet", (Steps("elevator", 2.0, 0.5),), Condition(22.0)),
        TestPoint(
            "left turn",
            (Steps("aileron", 3.0, 0.5), Steps("rudder", -2.0, 0.4, start_s=0.3)),
            Condition(24.0, -20.0),
        ),
    ]
    path = tmp_path / "flight.parquet"
    ok, _, _ = fly_points(fixed_plan, points, 1, path)
    assert ok
    frame = pd.read_parquet(path)
    timed, end_s = schedule(points, fixed_plan.begin_s)
    assert frame["time_s"].iloc[-1] == pytest.approx(end_s, abs=0.05)
    parts = {p.kind: frame[frame["manoeuvre"] == p.name] for p in points}
    assert parts["doublet"]["time_s"].iloc[0] == pytest.approx(timed[1].start_s, abs=0.03)
    assert len(parts["doublet"]) == pytest.approx(50 * points[1].seconds, abs=2)
    # Taken over before its end: 30 deg nose down is enough.
    assert len(parts["dive"]) < 0.4 * 50 * points[0].seconds
    assert np.degrees(parts["dive"]["theta_rad"].min()) == pytest.approx(-30.0, abs=1.5)
    assert frame["h_m"].min() > -60.0
    turn = parts["left turn"].iloc[0]
    assert turn["V_mps"] == pytest.approx(24.0, abs=0.6)
    assert np.degrees(turn["phi_rad"]) == pytest.approx(-20.0, abs=3.0)
    for name, column, steps in (
        ("doublet", "elevator_deg", {2.0, -2.0, 0.0}),
        ("left turn", "aileron_deg", {3.0, -3.0, 0.0}),
    ):
        command = parts[name][column].to_numpy()
        assert {round(float(v), 4) for v in command - command[0]} == steps


def test_a_point_that_leaves_what_may_be_flown_is_refused_and_the_rest_are_tried(fixed_plan):
    wild = TestPoint("wild", (Steps("aileron", 24.0, 1.5),), Condition(22.0))
    calm = TestPoint("calm", (Steps("aileron", 3.0, 0.5),), Condition(22.0))
    trials, refused = try_points(fixed_plan, [wild, calm], {"phi_rad": (-0.9, 0.9)}, Cutoffs(), 1)
    assert [t.point.kind for t in trials] == ["calm"]
    assert trials[0].states["p_radps"].max() > 0.1
    assert len(trials[0].states["p_radps"]) == len(trials[0].delta)
    (invalid,) = refused
    assert invalid.point.kind == "wild"
    assert "phi_rad reaches" in invalid.reason


def test_an_aircraft_without_the_autopilot_gets_steps_on_top_of_its_mission(tmp_path):
    """JSBSim's own c172x holds height and heading; a step of its elevator command is added to what
    its pilot commands.
    """
    flight = TestFlight(
        find_aircraft("c172x"),
        PROJECT_ROOT / "campaigns" / "c172" / "hold.xml",
        False,
        10.0,
        noise=False,
    )
    point = TestPoint("elevator", (Steps("elevator", 0.1, 0.5),), Condition())
    path = tmp_path / "c172.parquet"
    ok, _, reason = fly_points(flight, [point], 1, path)
    assert ok, reason
    frame = pd.read_parquet(path)
    inside = frame[frame["manoeuvre"] == "elevator, as the mission flies"]
    assert inside["time_s"].iloc[0] == pytest.approx(10.0, abs=0.03)
    assert inside["q_radps"].max() - inside["q_radps"].min() > 0.02
    text = path.with_suffix(".xml").read_text()
    assert not any(name in text for name in AUTOPILOT)


def test_the_library_follows_the_cards_stops_and_the_models_modes():
    aircraft = find_aircraft("espaaro")
    times = unit_times(aircraft, 22.2, 100.0)
    # Short period 7.9 rad/s, dutch roll 2.9 rad/s: 2.33 over either, to one figure.
    assert times["elevator"] == pytest.approx(0.3)
    assert times["rudder"] == pytest.approx(0.8)
    points = library(aircraft, [Condition(20.0), Condition(24.0, 25.0)], times)
    assert len(points) == len({p.name for p in points})
    sizes = {
        s.size
        for p in points
        for s in p.steps
        if s.control == "rudder" and "rudder doublet" in p.kind
    }
    assert sizes == {5.0, -5.0}
    assert all(p.seconds > 4.0 for p in points)
    assert RECOVERY_S > 5.0


def refused(capsys, *arguments: str) -> str:
    assert main(["next-flight", *arguments]) == 2
    return capsys.readouterr().err


def test_what_cannot_be_answered_is_refused_with_what_to_do(campaign, bounds, tmp_path, capsys):
    out = ["--out", str(tmp_path / "next")]
    valid = [str(campaign), "--bounds", str(bounds), *out]
    assert "constant bounds of CY" in refused(capsys, str(campaign), *out)
    assert "not a campaign folder" in refused(capsys, str(tmp_path), *out)
    assert "--metric nonsense" in refused(capsys, *valid, "--metric", "nonsense")
    assert "--minutes 0" in refused(capsys, *valid, "--minutes", "0")
    assert "--speeds fast" in refused(capsys, *valid, "--speeds", "fast")
    assert "is no model form" in refused(
        capsys, str(campaign), "--bounds", str(campaign / "manifest.json"), *out
    )
    assert "no test point fits" in refused(
        capsys, *valid, "--minutes", "0.1", "--speeds", "22", "--cases", "1"
    )
    form = json.loads(bounds.read_text())
    other = tmp_path / "other.json"
    other.write_text(json.dumps({**form, "aircraft": {**form["aircraft"], "name": "glider"}}))
    assert "belong to aircraft 'glider'" in refused(
        capsys, str(campaign), "--bounds", str(other), *out
    )
    row = form["coefficients"]["CY"]
    row |= {"terms": ["1"], "beta_hat": [0.0], "XtX_inv": [[1.0 / row["n"]]]}
    other.write_text(json.dumps(form))
    output = refused(capsys, str(campaign), "--bounds", str(other), *out)
    assert "the bounds of CY are constant" in output
    assert "--order 2" in output
    del form["coefficients"]["CY"]
    other.write_text(json.dumps(form))
    assert "has no bounds for CY" in refused(capsys, str(campaign), "--bounds", str(other), *out)
    assert not (tmp_path / "next").exists()


def test_the_campaigns_own_form_is_taken_where_it_flew_one(tmp_path, bounds, capsys):
    """Told what the same bounds have brought: nothing."""
    (tmp_path / "c").mkdir()
    shutil.copy(bounds, tmp_path / "c" / "model-form.json")
    i = CAMPAIGN.index("bounds = {")
    folder = flown_campaign(
        tmp_path / "c", CAMPAIGN[:i] + 'coefficients = ["CY", "Cn"]\nbounds = "model-form.json"\n'
    )
    arguments = [
        "next-flight",
        str(folder),
        "--redone",
        str(bounds),
        "--cases",
        "1",
        "--out",
        str(tmp_path / "next"),
    ]
    assert main([*arguments, "--json"]) == 1
    result = json.loads(capsys.readouterr().out)
    assert set(result["achieved"]) == set(read_model_form(bounds).coefficients)
    assert result["achieved"]["CY"]["narrowing"] == 0.0
    assert result["achieved"]["CY"]["predicted"] is None
    assert not (tmp_path / "next").exists()
    assert main(arguments) == 1
    assert "narrowing" in capsys.readouterr().out


FORM = made_up_form({"CZ": LONGITUDINAL, "Cm": LONGITUDINAL})


MISSION = Occupancy(
    {name: np.full(20, MEAN.get(name, 0.0)) for name in LONGITUDINAL}, 1, 0, 2.0, "the mission"
)


def states(rng, n, speed=22.0):
    return {s: MEAN.get(s, 0.0) + SPREAD[s] * rng.standard_normal(n) for s in LONGITUDINAL} | {
        "V_mps": np.full(n, speed)
    }


def simulate(n=2000, **more) -> Residuals:
    rng = np.random.default_rng(0)
    return Residuals(
        (ResidualPiece("m", 0.02 * np.arange(n), np.zeros((n, 6)), states(rng, n, **more)),),
        0.02,
        Cutoffs(),
    )


def trial(speed, power=-4.0, n=400):
    rng = np.random.default_rng(int(speed))
    delta = np.sqrt(speed**power) * rng.standard_normal((n, 6))
    return SimpleNamespace(states={"V_mps": np.full(n, speed)}, delta=delta)


STEADY = [trial(22.0)] * 4


def test_more_data_narrow_and_endless_data_narrow_most():
    few, many = (prospects(FORM, MISSION, simulate(n), 0.2, STEADY) for n in (500, 20_000))
    for name in ("CZ", "Cm"):
        assert few[name].narrowing < many[name].narrowing <= many[name].at_most < 1.0
        assert few[name].parameter_narrowing < many[name].parameter_narrowing < 1.0
        assert many[name].current == widths_over(FORM, MISSION)[name]
        assert many[name].asymptotic.parameter == 0.0
    empty = prospects(FORM, MISSION, simulate(500), 0.0, STEADY)
    assert empty["CZ"].parameter_narrowing == pytest.approx(0.0, abs=0.01)


def test_scatter_follows_the_speed_as_the_trials_do():
    trials = [trial(v) for v in np.linspace(16.0, 28.0, 40)]
    slow, fast = (scatter_ratios(FORM, simulate(speed=v), trials)["CZ"] for v in (18.0, 26.0))
    assert slow / fast == pytest.approx((26.0 / 18.0) ** 4, rel=0.3)
    assert scatter_ratios(FORM, simulate(speed=18.0), STEADY) == {"CZ": 1.0, "Cm": 1.0}
    # Bounds that do not know the speed cannot tell.
    blind = replace(
        FORM,
        coefficients={
            n: replace(b, states=("x", *b.states[1:])) for n, b in FORM.coefficients.items()
        },
    )
    assert scatter_ratios(blind, simulate(speed=18.0), trials)["CZ"] == 1.0
