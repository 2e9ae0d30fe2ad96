"""Every command of the command line is a Python function with the same options."""

from __future__ import annotations

import argparse
import inspect

import pytest

import uqharness as uq
from uqharness.cli.commands import commands_of
from uqharness.cli.main import complete_parser

FUNCTIONS = {
    "fly": "fly",
    "modes": "find_trim",
    "margins": "margins",
    "diff": "diff",
    "log info": "log_info",
    "log import": "read_flights",
    "identify": "identify",
    "compare": "compare",
    "bounds": "fit_model_form",
    "validate-bounds": "validate_bounds",
    "instrument": "instrument",
    "refine": "refine",
    "campaign check": "check_campaign",
    "campaign run": "run_campaign",
    "campaign verify": "verify",
    "sensitivity": "sensitivity",
    "next-flight": "next_flight",
    "study": "study",
    "report": "report",
    "dossier": "dossier",
}
SAME_OPTIONS = (
    "margins",
    "diff",
    "campaign check",
    "campaign verify",
    "next-flight",
    "study",
    "report",
    "dossier",
)
"""Commands whose function takes every option; the others return objects and take what makes them."""
RENAMED = {"property": "properties", "flight": "flights", "no_figures": "figures"}
OF_A_TERMINAL = {"help", "json"}


def commands() -> dict[str, argparse.ArgumentParser]:
    every = {}
    for name, parser in commands_of(complete_parser()).items():
        below = commands_of(parser)
        every |= {f"{name} {sub}": one for sub, one in below.items()} if below else {name: parser}
    return every


def test_every_command_is_a_function():
    above = {name.partition(" ")[0] for name in FUNCTIONS}
    # A script for a shell is nothing to Python.
    assert {name.partition(" ")[0] for name in commands()} - {"completion"} == above
    for name, function in FUNCTIONS.items():
        assert name in commands()
        assert callable(getattr(uq, function)) or function == "sensitivity"


@pytest.mark.parametrize("name", SAME_OPTIONS)
def test_a_function_takes_the_options_of_its_command(name):
    parameters = set(inspect.signature(getattr(uq, FUNCTIONS[name])).parameters)
    options = {action.dest for action in commands()[name]._actions} - OF_A_TERMINAL
    renamed = {o if o in parameters else RENAMED.get(o, o) for o in options}
    assert renamed == parameters


def test_functions_that_packages_are_named_after_can_be_called():
    import uqharness.dossier
    import uqharness.next_flight
    import uqharness.report
    import uqharness.study

    for name in ("report", "study", "dossier", "next_flight"):
        assert "out" in inspect.signature(getattr(uq, name)).parameters or name == "report"
        with pytest.raises(uq.BadInputError):
            getattr(uq, name)(5, out="out") if name != "report" else uq.report(5)
    assert uqharness.report.write_report is not None


def test_a_command_s_refusal_is_bad_input(tmp_path):
    with pytest.raises(uq.BadInputError, match="nothing to fly: give --speed-mps"):
        uq.diff("espaaro", "espaaro")


def test_campaign_results_say_what_they_are(tmp_path):
    folder = tmp_path / "results"
    manifest = {
        "cases": 12,
        "campaign": {"campaign": {"aircraft": "a/plane"}, "epistemic": {"method": "corners"}},
    }
    from uqharness.api.campaigns import CampaignResult

    text = repr(CampaignResult(folder, manifest))
    assert "12 flights of plane" in text
    assert "corners" in text


def test_a_mission_is_a_script_by_another_name():
    flight = uq.fly("espaaro", mission="trim", duration_s=1)
    assert (flight.name, len(flight)) == ("trim", 51)
