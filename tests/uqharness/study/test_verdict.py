"""The sentences of a study: right about campaigns and documents made up so that the answer is
known, both ways.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers import campaign_fakes as fakes
from tests.helpers import report_folders
from uqharness.campaign.cases import Mission
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import run_campaign
from uqharness.flight.spec import FlightResult
from uqharness.results.identification import Fit
from uqharness.results.refinement import Refinement
from uqharness.statistics.pbox import Sample
from uqharness.study import answer as chain_performance
from uqharness.study import answer as chain_verdict

pytestmark = pytest.mark.usefixtures("flights_here")

FOUR_CORNERS = (
    fakes.CAMPAIGN[: fakes.CAMPAIGN.index("bounds")]
    + 'coefficients = ["CX", "CY"]\nbounds = { CX = 0.008, CY = 0.010 }\ninterior = 0\nnominal ='
    " false\n"
)
QUIET = {"excursions_15m": 0.0, "excursions_25m": 0.0}


def wide(spec):
    result = fakes.steady(spec)
    return replace(result, metrics=result.metrics | QUIET)


def narrow(spec):
    """Errors that depend on the corner a tenth as much as those of ``wide``, around the same
    middle.
    """
    result = wide(spec)
    much = 1.0 + fakes.level_sum(spec) + spec.wind_mps
    little = 4.0 + 0.1 * (fakes.level_sum(spec) - 3.0) + spec.wind_mps
    return replace(
        result,
        metrics={k: v * little / much if "_median_" in k else v for k, v in result.metrics.items()},
    )


def failing(spec):
    if fakes.level_sum(spec) > 3.5:
        return FlightResult(
            "diverged", "the state was no longer finite at 61.0 s", 61.0, {}, {}, {}
        )
    return wide(spec)


def simulate(tmp_path, before, after=None, winds="3"):
    """The two campaigns of a study, flown by made-up flight functions, judged."""
    text = FOUR_CORNERS.replace("flights = 3", "flights = 8").replace(
        "wind_mps = 3", f"wind_mps = {winds}"
    )
    for name, fly in (("campaign-before", before), ("campaign-after", after)):
        if fly is not None:
            spec = read_campaign(fakes.campaign_file(tmp_path, text))
            mission = Mission(tmp_path / "plane", "a" * 64, tmp_path / "loiter.xml", "b" * 64)
            run_campaign(spec, tmp_path / name, executor=SerialExecutor(), fly=fly, mission=mission)
    return list(
        chain_performance.performance(chain_performance.read_campaigns(tmp_path, after is not None))
    )


@pytest.fixture(autouse=True)
def _no_check_flight(monkeypatch):
    """Made-up flights need no throw-away process to try the model in."""
    monkeypatch.setattr("uqharness.campaign.run.validate_model", lambda fly, case: None)


def about(sentences, words):
    (result,) = [(text, level) for text, level in sentences if words in text]
    return result


def test_a_narrower_p_box_is_called_narrower_and_by_how_much(tmp_path):
    text, level = about(simulate(tmp_path, wide, narrow), "Median cross-track error")
    # A width that was compared is a plain fact: nothing was claimed beforehand and tested.
    assert level == ""
    assert "became narrower by " in text
    assert 60 < float(text.split("narrower by ")[1].split(" %")[0]) < 100


def test_the_same_p_box_and_a_wider_one_are_not(tmp_path):
    text, level = about(simulate(tmp_path / "same", wide, wide), "Median cross-track error")
    assert (level, "did NOT become narrower (" in text) == ("warn", True)
    text, level = about(simulate(tmp_path / "wide", narrow, wide), "Median cross-track error")
    assert (level, "did NOT become narrower, it is " in text, "% wider" in text) == (
        "warn",
        True,
        True,
    )


def test_failed_flights_leave_the_p_box_open(tmp_path):
    result = simulate(tmp_path / "mended", failing, wide)
    text, level = about(result, "Median cross-track error")
    assert level == ""
    assert (
        "became narrower: before, 8 of 32 flights have no such error, which leaves its sides open;"
        " after, none" in text
    )
    text, level = about(result, "Flights: ")
    assert level == "warn"
    assert "32 before (8 failed, control lost in 0), 32 after (0 failed, control lost in 0)" in text
    text, level = about(simulate(tmp_path / "worse", wide, failing), "Median cross-track error")
    assert level == "warn"
    assert "after refinement has no finite width: 8 of 32 flights" in text


def test_area_between_two_corners_is_the_distance_of_their_means():
    """For two samples, one the other moved to the right, the area between their distribution
    functions is the shift.
    """
    x = np.random.default_rng(1).normal(size=50)
    assert chain_performance.area([Sample("0", x), Sample("1", x + 0.7)]) == pytest.approx(0.7)
    assert chain_performance.area([Sample("0", x)]) == 0.0


EFFECT = report_folders.refinement()["effects"][0] | {
    "name": "pitching moment due to roll rate squared",
    "value": 2.98,
    "std": 0.03,
    "unit": "1",
    "property": "aero/Cm_p2",
    "withdrawn": False,
}


def refinement(verdict="effects-found", effects=(EFFECT,), after=1.0, where=()):
    channels = {
        "p_radps": {"rms_before": 4.0, "rms_after": 4.0 * after, "noise_rms": 1.0},
        "V_mps": {"rms_before": 1.0, "rms_after": 1.0, "noise_rms": 1.0},
    }
    remainder = report_folders.refinement()["remaining"] | {"where": list(where)}
    result = report_folders.refinement(
        verdict=verdict,
        effects=list(effects),
        remaining=remainder,
        gap={"test": {"channels": channels, "coefficients": {}}},
        train=["a.parquet"],
        test=["c.parquet"],
    )
    return Refinement(**result)


def test_what_refinement_named_and_what_it_did_on_the_test_flight():
    (listed, first), (gap, second) = chain_verdict._refinement_sentences(refinement(after=0.25))
    assert (
        listed == "Refinement named, from a: pitching moment due to roll rate squared, 2.98 ± 0.03"
        " (aero/Cm_p2)."
    )
    assert gap.startswith(
        "On the hold-out flights (c) rms over noise went, from before to after: p_radps 4.00 to"
        " 1.00"
    )
    assert (first, second) == ("good", "good")
    assert "V_mps" not in gap


def test_refinement_that_helps_too_little_or_explains_nothing_is_said_to():
    *_, (_, level) = chain_verdict._refinement_sentences(refinement(after=0.9))
    assert level == "warn"
    (text, level), *_ = chain_verdict._refinement_sentences(
        refinement("unexplained", (), where=[{"words": "something in Cl"}])
    )
    assert (text, level) == ("Refinement leaves a residual unexplained: something in Cl.", "bad")
    (text, level), *_ = chain_verdict._refinement_sentences(
        refinement("unexplained", [EFFECT | {"withdrawn": True}])
    )
    assert "did not reduce the hold-out residuals and was withdrawn" in text
    assert level == "bad"
    (text, level), *_ = chain_verdict._refinement_sentences(refinement("no-missing-effect", ()))
    assert (text, level) == ("Refinement found no missing effect from a.", "good")


def write_coverage(folder, when, share, width):
    (folder / f"validate-{when}").mkdir(parents=True)
    rows = {
        c: {"0.95": share, "0.68": 0.7, "n_effective": 9.0, "mean_width": width}
        for c in ("CX", "Cl")
    }
    (folder / f"validate-{when}" / "coverage.json").write_text(json.dumps({"coverage": rows}))


def test_verdict_on_coverage_and_widths(tmp_path):
    write_coverage(tmp_path, "before", 0.95, 0.02)
    write_coverage(tmp_path, "after", 0.80, 0.01)
    (before, valid), (after, invalid), (widths, narrower) = chain_verdict._coverage(
        tmp_path, ("c",), True
    )
    assert (valid, invalid, narrower) == ("good", "bad", "")
    assert "those of CX, Cl do not hold" in after
    assert "do not hold" not in before
    assert "CX -50 %, Cl -50 %" in widths
    write_coverage(tmp_path / "x", "before", 0.95, 0.02)
    write_coverage(tmp_path / "x", "after", 0.95, 0.02)
    *_, (widths, level) = chain_verdict._coverage(tmp_path / "x", ("c",), True)
    assert (level, "none is narrower" in widths) == ("warn", True)


def test_identification_that_did_not_converge_is_bad_news():
    identified = {"value": 1.0, "std": 0.1, "std_crb": 0.1, "status": "identified"}
    fit = Fit(
        aircraft="plane",
        parameters={"a": identified, "b": {"value": 1.0, "status": "not-identified"}},
        flights=["x.parquet"],
        method="output error",
        fit={"p_radps": {"rms": 2.0, "noise": 1.0}, "V_mps": {"rms": None, "noise": 1.0}},
    )
    text, level = chain_verdict._identification(fit, 0)
    assert (
        text
        == "1 of 2 parameters were identified from x by output error; the largest residual is 2.00"
        " times the noise (p_radps)."
    )
    assert level == "warn"
    assert chain_verdict._identification(fit, 1)[1] == "bad"
