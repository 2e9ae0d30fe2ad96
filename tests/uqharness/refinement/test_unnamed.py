"""A form of no catalogue, flown by the independent equations: offered as a smooth term, drawn,
flown, and named by nobody.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from sysid.effects.catalogue import coefficient_effect
from sysid.effects.smooth import smooth_term
from tests.helpers.page_checks import problems
from tests.helpers.report_folders import refinement
from tests.helpers.sixdof import Airframe
from tests.hidden_effects.effects import Effect, value
from tests.hidden_effects.flights import Flight, fly
from tests.hidden_effects.manoeuvres import card
from uqharness.batch.course import fly_many
from uqharness.cli.main import main
from uqharness.flight.spec import FlightSpec
from uqharness.refinement import run
from uqharness.refinement.curves import STATES, can_represent
from uqharness.refinement.smooth_terms import EXPLAINED
from uqharness.requests.refinement import RefineRequest
from uqharness.results.refinement import Refinement
from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.mission import find_script

pytestmark = pytest.mark.slow

KINDS = ("elevator 3-2-1-1", "roll and pitch", "roll and yaw")
CARDS = tuple(
    card(40 + i, V, seconds=24.0, kinds=KINDS, first=i) for i, V in enumerate((20.0, 22.0, 21.0))
)
BUMP = Effect("Cm", "bump", 0.003, "2.718281828**(-((alpha-0.03)/0.012)**2)")


def refined(folder, *effects, w20_kt=0.0):
    """Exit code and folder of a refinement of two train flights and one to test on."""
    result = fly([Flight(replace(c, w20_kt=w20_kt), Airframe(), effects) for c in CARDS])
    paths = [folder / f"{k}.parquet" for k in range(len(result))]
    for record, path in zip(result, paths, strict=True):
        record.write(path)
    out, (*train, test) = folder / "out", map(str, paths)
    arguments = [
        "refine",
        "espaaro",
        "--train",
        *train,
        "--test",
        test,
        "--out",
        str(out),
        "--no-pbox",
        "--workers",
        "1",
    ]
    return main(arguments), out


def remaining(out):
    result = json.loads((out / "refinement.json").read_text(encoding="utf-8"))
    return result, result["remaining"]["smooth"]


@pytest.fixture(scope="module")
def bumped(tmp_path_factory):
    code, out = refined(tmp_path_factory.mktemp("bump"), BUMP)
    assert code == 1
    return out


def test_the_term_is_offered_and_changes_no_verdict(bumped):
    result, smooth = remaining(bumped)
    assert result["verdict"] == "unexplained"
    assert result["remaining"]["smooth_reason"] is None
    assert (smooth["coefficient"], smooth["state"], smooth["times"]) == ("Cm", "alpha", None)
    assert smooth["p"] < 1e-6
    assert 3.0 < smooth["effective_degrees_of_freedom"] < 12.0
    assert smooth["shapes"][0]["form"].startswith("hump at 0.03") or smooth["shapes"][0][
        "form"
    ].startswith("hump at 0.02")
    assert not any("uq/unnamed" in json.dumps(e) for e in (*result["effects"], *result["switch"]))


def test_the_effect_named_is_told_not_to_have_the_form(bumped):
    result, smooth = remaining(bumped)
    (form,) = [w for w in result["remaining"]["where"] if w.get("p") is not None]
    assert (form["coefficient"], form["depends_on"]) == ("Cm", [{"state": "alpha"}])
    assert form["p"] < 1e-6
    assert form["twice_log_likelihood"] > 30.0
    assert form["words"].startswith(
        "the residual in Cm does not have the form of pitching moment due to angle of attack cubed"
    )
    assert f"an additional {smooth['name']} gains" in form["words"]


def test_its_band_holds_the_hidden_form(bumped):
    _, smooth = remaining(bumped)
    at, curve, low, high, samples = (
        np.array(smooth["curve"][k]) for k in ("at", "value", "low", "high", "samples")
    )
    xml = (bumped / smooth["model"]).read_text(encoding="utf-8")
    estimates = {
        n: float(re.search(rf'<property value="([^"]*)">aero/{n}</property>', xml)[1])
        for n in ("Cm_0", "Cm_alpha")
    }
    assert smooth["in_place_of"] == ["pitching moment due to angle of attack cubed"]
    assert ">aero/Cm_alpha3<" not in xml
    truth = {n: Airframe().coefficients[n] for n in estimates}
    # TrainTestInformation with the lines that go with them; what is left of the lines' difference is the
    # parameters' own.
    gap = (
        (estimates["Cm_0"] - truth["Cm_0"])
        + (estimates["Cm_alpha"] - truth["Cm_alpha"]) * at
        + curve
    )
    gap = gap - BUMP.size * value(BUMP.form, {"alpha": at})
    gap = gap - np.polyval(np.polyfit(at, gap, 1, w=np.sqrt(samples)), at)
    inside = np.abs(gap) < 0.5 * (high - low)
    assert np.mean(inside) > 0.9
    assert np.average(np.abs(gap), weights=samples) < 0.05 * BUMP.size
    # A band that held everything would say nothing: it does not hold a model without the form.
    assert np.mean(np.abs(curve) < 0.5 * (high - low)) < 0.4


def test_the_gap_shrinks_on_the_flight_that_chose_nothing(bumped):
    _, smooth = remaining(bumped)
    assert smooth["channel"] == "q_radps"
    assert smooth["test"]["gap"] == "shrank"
    for side in ("train", "test"):
        row = smooth["gap"][side]["channels"]["q_radps"]
        assert row["rms_after"] < 1.05 * row["noise_rms"] < row["rms_before"]
    assert smooth["leaves"] < 1.05 < smooth["channel_on_train"]


def test_its_aircraft_flies_in_jsbsim_and_in_the_batch_engine_and_compares_as_told(
    bumped, tmp_path
):
    _, smooth = remaining(bumped)
    folder = (bumped / smooth["model"]).parent
    assert find_aircraft(folder).name == "espaaro"
    (trajectory,) = fly_many([FlightSpec(folder, find_script("loiter"), 2.0)])
    assert trajectory.status == "ok"
    flight = bumped.parent / "2.parquet"
    main(
        [
            "compare",
            str(folder),
            "--flight",
            str(flight),
            "--out",
            str(tmp_path / "compared"),
            "--no-figures",
        ]
    )
    reports = json.loads((tmp_path / "compared" / "compare.json").read_text(encoding="utf-8"))
    row = smooth["gap"]["test"]["channels"]["q_radps"]
    assert reports["channels"]["q_radps"]["rms"] == pytest.approx(row["rms_after"], rel=0.02)


def test_the_page_draws_it_and_calls_it_no_physics(bumped):
    page = (bumped / "report.html").read_text(encoding="utf-8")
    assert problems(page) == []
    assert "A smooth term, not an effect" in page
    assert (
        "Smooth term without physics: a smooth term of angle of attack in pitching moment" in page
    )
    assert (bumped / "figures" / "unnamed.svg").stat().st_size > 1000


@pytest.mark.parametrize("verdict", ["effects-found", "no-missing-effect"])
def test_where_nothing_is_left_nothing_is_looked_for(tmp_path, monkeypatch, verdict):
    monkeypatch.setattr(run, "find_smooth_term", None)
    stale = tmp_path / "unnamed" / "aircraft" / "espaaro"
    stale.mkdir(parents=True)
    (stale / "espaaro.xml").write_text("of an earlier run", encoding="utf-8")
    options = RefineRequest(aircraft="espaaro", train="a", test="b", out=tmp_path)
    job, document = run.Job(options, find_aircraft("espaaro"), (), ()), refinement(verdict=verdict)
    result = run._smooth_term(job, Refinement.model_validate(document), None, None, None, None)
    assert result == (None, EXPLAINED)
    assert not stale.exists()


@pytest.mark.slow
def test_flights_of_the_model_itself_are_offered_nothing(tmp_path):
    code, out = refined(tmp_path)
    result, smooth = remaining(out)
    assert (code, result["verdict"], smooth) == (0, "no-missing-effect", None)
    assert "smooth term" not in (out / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_kink_is_drawn_where_powers_were_named_and_a_product_where_one_state_is_not_enough(
    tmp_path,
):
    for name, effect, expected in (
        ("kink", Effect("Cn", "kink", 0.05, "maximum(beta-0.05,0)"), ("Cn", "beta", None)),
        (
            "product",
            Effect("CY", "product", 0.3, "tanh((alpha-0.02)/0.012)*beta"),
            ("CY", "alpha", "beta"),
        ),
    ):
        (tmp_path / name).mkdir()
        code, out = refined(tmp_path / name, effect)
        _, smooth = remaining(out)
        assert (code, smooth["coefficient"], smooth["state"], smooth["times"]) == (1, *expected)
        assert smooth["leaves"] < 1.1
        assert smooth["test"]["gap"] == "shrank"


@pytest.mark.parametrize(
    ("coefficient", "term", "times", "same"),
    [
        ("Cm", "alpha^3", None, True),
        ("Cm", "abs(alpha)*alpha", None, True),
        ("Cm", "alpha*CT", None, False),
        ("CZ", "alpha^3", None, False),
        ("Cm", "alpha*CT", "CT", True),
        ("Cm", "alpha^2", "CT", False),
        ("Cm", "CT", "CT", True),
    ],
)
def test_an_effect_is_part_of_the_curve_where_the_curve_can_be_it(coefficient, term, times, same):
    result = {s: np.linspace(0.0, 1.0, 50) for s in STATES}
    assert (
        can_represent(
            coefficient_effect(coefficient, term), smooth_term("Cm", "alpha", times, result)
        )
        is same
    )
