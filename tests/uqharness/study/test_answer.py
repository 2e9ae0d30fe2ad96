"""The four lines of a study's answer, on campaigns made up so that the answer is known: yes, no,
inconclusive, and what is next.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.helpers import campaign_fakes as fakes
from tests.helpers.report_folders import refinement
from uqharness.campaign.cases import Mission
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import run_campaign
from uqharness.results.refinement import Refinement
from uqharness.study.answer import answer_of, read_campaigns

pytestmark = pytest.mark.usefixtures("flights_here")

TWO_CORNERS = (
    fakes.CAMPAIGN[: fakes.CAMPAIGN.index("bounds")].replace("duration_s = 150", "duration_s = 900")
    + 'coefficients = ["CX"]\nbounds = { CX = 0.008 }\ninterior = 0\nnominal = false\n'
    + "\n[metrics]\nacceptable_per_h = 2\nexcursion_radius_m = 15\n"
)
EFFECT = refinement()["effects"][0] | {
    "name": "rolling moment due to elevator",
    "value": 0.0003,
    "std": 1e-6,
    "unit": "1/deg",
    "withdrawn": False,
}
GAP = {
    "p_radps": {"rms_before": 0.004, "rms_after": 0.001, "noise_rms": 0.001},
    "V_mps": {"rms_before": None, "noise_rms": 0.5},
}


def find(verdict="effects-found", **changes) -> Refinement:
    gap = {"test": {"channels": GAP, "coefficients": {}}}
    result = refinement(verdict=verdict, effects=[EFFECT | changes], gap=gap)
    return Refinement(**result)


FOUND = find()


def run_quietly(spec):
    result = fakes.steady(spec)
    return replace(result, metrics=result.metrics | {"excursions_15m": 0.0})


def bad_corner(spec):
    """Many excursions at the upper corner, none at the lower."""
    result = run_quietly(spec)
    return replace(
        result,
        metrics=result.metrics | {"excursions_15m": 9.0 if fakes.level_sum(spec) > 2.9 else 0.0},
    )


def everywhere(spec):
    result = run_quietly(spec)
    return replace(result, metrics=result.metrics | {"excursions_15m": 9.0})


def windy(spec):
    return everywhere(spec) if spec.wind_mps > 5.0 else run_quietly(spec)


def ends_early(spec):
    """Flies half of its time and loses control, without an excursion."""
    result = run_quietly(spec)
    return replace(
        result,
        status="diverged",
        reason="the state was no longer finite",
        metrics={},
        flown_s=spec.duration_s / 2.0,
    )


@pytest.fixture(autouse=True)
def _no_check_flight(monkeypatch):
    monkeypatch.setattr("uqharness.campaign.run.validate_model", lambda fly, case: None)


def answered(tmp_path, before, after=None, flights=40, winds="3", no=(), air='"moderate"'):
    text = TWO_CORNERS.replace("flights = 3", f"flights = {flights}").replace(
        "wind_mps = 3", f"wind_mps = {winds}"
    )
    text = text.replace('turbulence = "moderate"', f"turbulence = {air}")
    for name, fly in (("campaign-before", before), ("campaign-after", after)):
        if fly is not None:
            spec = read_campaign(fakes.campaign_file(tmp_path, text))
            mission = Mission(tmp_path / "plane", "a" * 64, tmp_path / "loiter.xml", "b" * 64)
            run_campaign(spec, tmp_path / name, executor=SerialExecutor(), fly=fly, mission=mission)
    return answer_of(
        read_campaigns(tmp_path, after is not None), None if after is None else FOUND, [], no
    )


def test_quiet_flights_are_a_yes_with_the_limit_that_says_so(tmp_path):
    result = answered(tmp_path, run_quietly)
    assert result.level == "good"
    assert result.answer == "Yes in 3 m/s wind with moderate turbulence (95 % confidence)."
    # (1 - m/(D + m))^40 = 0.025 with 40 flights of 0.25 h and D = 2: m = 0.193 a flight.
    assert (
        result.why
        == "Why: excursions beyond 15 m, worst corner: at most 0.773/h in 3 m/s; acceptable 2/h; 20"
        " h a condition, no flights aborted."
    )
    assert (result.lacked, result.next) == ("", "Next: the question is answered.")


def test_answer_is_no_for_a_worse_model(tmp_path):
    result = answered(tmp_path, bad_corner)
    assert (result.level, result.answer[:9]) == ("bad", "No in 3 m")
    assert "worst corner: 36/h (" in result.why
    # The lower corner has none, so a better model may change it.
    assert (
        "a better model may change the no in 3 m/s moderate: the best corner has 0/h."
        in result.next
    )


def test_too_few_hours_are_inconclusive_and_say_how_many_would_do(tmp_path):
    result = answered(tmp_path, run_quietly, flights=4)
    assert (result.level, result.answer[:40]) == (
        "warn",
        "Inconclusive (too few flight hours) in 3",
    )
    assert (
        result.next
        == "Next: fly 4.25 h per corner in 3 m/s moderate ([aleatory] flights); that much without"
        " an excursion is a yes."
    )
    # That many hours are a yes indeed, and a flight less is not.
    assert answered(tmp_path / "enough", run_quietly, flights=17).level == "good"
    assert answered(tmp_path / "less", run_quietly, flights=16).level == "warn"


def test_aborted_flights_are_no_yes(tmp_path):
    result = answered(tmp_path, ends_early)
    assert result.level == "bad"
    assert "80 flights aborted (diverged 80)" in result.why


def test_conditions_are_grouped_by_answer_and_compared_with_those_before(tmp_path):
    result = answered(tmp_path, everywhere, windy, winds="[1, 3, 7]")
    assert result.answer.startswith(
        "Yes in 1 and 3 m/s, no in 7 m/s wind with moderate turbulence (95 % confidence)."
    )
    assert result.level == "warn"
    assert result.answer.endswith(
        " Before refinement: no in 1 and 3 m/s wind with moderate turbulence."
    )
    assert "same answers" not in result.lacked


def test_what_the_model_lacked_and_what_adding_it_bought(tmp_path):
    result = answered(tmp_path, run_quietly, run_quietly)
    assert "Before refinement" not in result.answer
    assert (
        result.lacked
        == "The model lacked rolling moment due to elevator. With it: held-out residual of p from 4"
        " to 1 sigma, cross-track p-box as wide, same answers."
    )


def test_a_refinement_without_effect_and_stages_that_answered_no(tmp_path):
    empty = find("no-missing-effect").model_copy(update={"effects": []})
    assert answer_of({}, empty, []).lacked == "These flights show no effect that the model lacks."
    withdrawn = find("unexplained", withdrawn=True)
    assert "no effect of the catalogue explains" in answer_of({}, withdrawn, []).lacked
    assert (
        "These stages answered no: validate-before"
        in answered(tmp_path, run_quietly, no=["validate-before"]).next
    )


def test_without_a_campaign_there_is_no_rate_and_the_worst_finding_is_why():
    result = answer_of(
        {}, None, [("Fits.", "good"), ("Does not hold.", "bad"), ("Beware.", "warn")]
    )
    assert (result.level, result.answer, result.why) == (
        "warn",
        "No excursion rate: no campaign was run.",
        "Does not hold.",
    )
