"""The page of a refinement: effects, verdicts, what they were taken for."""

from __future__ import annotations

import pytest
from lxml import html

from tests.helpers import report_folders as folders
from tests.helpers.page_checks import page_of, words_of
from tests.helpers.report_folders import refinement, write_document


@pytest.fixture
def refined(tmp_path):
    return folders.refined(tmp_path / "refined")


def test_a_refinement(refined):
    page = page_of(refined)
    words = words_of(page)
    assert (
        "Pitching moment due to roll rate squared: 2.9963 ± 0.018 (aero/Cm_p2), |t| 164.7." in words
    )
    assert "Pitching moment due to roll rate squared is confounded with: aileron squared." in words
    assert "To separate them: a roll at rest." in words
    assert "changes from 0.407 to 0.195 deg/s (rms); its noise is 0.201 deg/s" in words
    assert "stays at" not in words
    assert "+ <property>aero/Cm_p2</property>" in words
    assert "p 28.6 to 115 deg/s" in words
    assert "aero/Cm_p2 = 0 restores the model without it" in words
    assert (
        "Withdrawn: Yawing moment due to elevator: 2.9963 ± 0.018; contradicted, the hold-out residuals grew"
        in words
    )
    assert "97.0 ± 1.0" in words
    assert "96.0 ± undefined" in words
    assert "Not shown: no loiter here." in words


@pytest.mark.parametrize(
    ("verdict", "level", "text"),
    [
        ("no-missing-effect", "good", "no missing effect"),
        ("unexplained", "bad", "A residual remains that no effect of the catalogue explains"),
    ],
)
def test_verdicts_of_a_refinement(tmp_path, verdict, level, text):
    page = page_without_effects(tmp_path, verdict, None)
    first = html.document_fromstring(page).find(".//section[@class='verdict']//li")
    assert first.get("class") == level
    assert text in first.text_content()


@pytest.mark.parametrize(("flights", "differ"), [("test", True), ("train", False)])
def test_hold_out_flights_of_another_configuration(tmp_path, flights, differ):
    place = {
        "flights": flights,
        "flight": "flown-heavy",
        "manoeuvre": "loiter",
        "channel": "theta_rad",
        "from_s": 2.0,
        "to_s": 9.0,
        "from_Hz": 0.0,
        "to_Hz": 1.5,
        "rms_over_noise": 11.8,
        "share_of_excess": 0.3,
        "p": 0.0,
        "state": None,
        "channel_on_train": 1.0,
        "would_tell": "a climb",
        "candidates": [],
        "reason": None,
    }
    words = words_of(page_without_effects(tmp_path, "no-missing-effect", place))
    assert ("the hold-out flights differ: theta is at 11.8 times its noise" in words) is differ
    assert ("Remaining: nothing beyond the sensors' noise" in words) is not differ


def page_without_effects(tmp_path, verdict, place):
    """Return the page of a refinement without effects."""
    remaining = {
        "unexplained": verdict == "unexplained",
        "where": [],
        "channels_above_noise": {},
        "coloured_channels": [],
        "place": place,
    }
    changes = {
        "verdict": verdict,
        "effects": [],
        "withdrawn": [],
        "disagreement": [],
        "remaining": remaining,
    }
    return page_of(write_document(tmp_path / "refined", "refinement.json", refinement(**changes)))


@pytest.mark.parametrize(
    ("gaps", "levels", "text"),
    [
        (
            ("shrank",),
            ("good", "good"),
            "Effects were found and confirmed on the hold-out flights",
        ),
        (
            ("shrank", "cannot tell"),
            ("good", "good", "warn"),
            "Effects were found and confirmed on the hold-out flights",
        ),
        (
            ("cannot tell",),
            ("warn", "warn"),
            "Effects were found; the hold-out flights are inconclusive",
        ),
    ],
)
def test_what_is_said_of_the_gap_is_what_the_hold_out_flights_said_of_the_effects(
    tmp_path, gaps, levels, text
):
    row = {"change_of_twice_log_likelihood": 12.0, "std": 9.0, "rms_over_that_of_train": 1.0}
    effects = [
        refinement()["effects"][0] | {"withdrawn": False, "test": row | {"gap": gap}}
        for gap in gaps
    ]
    page = page_of(
        write_document(
            tmp_path / "refined",
            "refinement.json",
            refinement(verdict="effects-found", effects=effects),
        )
    )
    output = html.document_fromstring(page).findall(".//section[@class='verdict']//li")
    assert text in output[0].text_content()
    assert tuple(line.get("class") for line in output[: len(levels)]) == levels


def test_errors_of_predictions_stand_under_their_own_name(tmp_path):
    done = refinement()
    assert "one sample ahead" not in words_of(
        page_of(write_document(tmp_path / "calm", "refinement.json", done))
    )
    done["gap"]["test"]["predictions"] = {
        "q_radps": {"rms_before": 0.0041, "rms_after": 0.0037, "noise_rms": 0.0036}
    }
    words = words_of(page_of(write_document(tmp_path / "turbulent", "refinement.json", done)))
    assert "The flights were turbulent." in words
    assert "Errors of predictions one sample ahead on the hold-out flights, rms." in words
    assert "0.235" in words
    assert "0.212" in words
