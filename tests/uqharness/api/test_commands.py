"""Every command of the command line is a Python function with the same options."""

from __future__ import annotations

import argparse
import inspect

import pytest

import uqharness as uq
from uqharness.cli.main import commands_of, complete_parser

FUNCTIONS = {
    "fly": "fly",
    "modes": "find_trim",
    "margins": "margins",
    "diff": "diff",
    "log info": "log_info",
    "log import": "read_flights",
    "log map": "propose_map",
    "log export": "export_log",
    "identify": "identify",
    "compare": "compare",
    "bounds": "fit_model_form",
    "validate-bounds": "validate_bounds",
    "instrument": "instrument",
    "refine": "refine",
    "campaign check": "check_campaign",
    "campaign run": "run_campaign",
    "campaign status": "campaign_status",
    "campaign report": "campaign_report",
    "campaign merge": "merge_campaign",
    "campaign rerun": "rerun_case",
    "campaign surrogate-check": "check_surrogate",
    "campaign verify": "verify",
    "campaign salvage": "salvage_campaign",
    "campaign convergence": "campaign_convergence",
    "campaign area": "campaign_area",
    "sensitivity": "sensitivity",
    "next-flight": "next_flight",
    "study": "study",
    "report": "report",
    "dossier": "dossier",
    "export": "export",
    "author": "author",
    "performance": "performance",
}
RENAMED = {
    "property": "properties",
    "settings": "properties",
    "flight": "flights",
    "params": "parameters",
    "map": "signal_map",
    "no_figures": "figures",
    "no_tracks": "tracks",
    "no_pbox": "pbox",
    "no_check": "check",
}
OF_A_TERMINAL = {"help", "json", "quiet"}
RETURNED = "the function returns what the option writes; the result has write() or to_dataframe()"
IN_RADIANS = "Python has SI units and radians: V_mps, bank_rad, climb_rad, heading_rad"
ONLY_TEXT = "it is of the printed table; find_trim and linearise return numbers"
LEFT_OUT = {
    "modes": {
        **dict.fromkeys(("speed_mps", "bank_deg", "climb_deg", "heading_deg"), IN_RADIANS),
        **dict.fromkeys(("aircraft_class", "category", "speeds"), ONLY_TEXT),
        **dict.fromkeys(("wind_mps", "wind_from_deg"), ONLY_TEXT),
        **dict.fromkeys(("bounds", "model_form"), "mode_intervals takes a linear model"),
        "out": RETURNED,
    },
    "log import": {
        "log": "paths: the function reads several",
        "out": RETURNED,
        "whole": "log_info reads all of a log",
        "from_s": "a part of a record is a slice of it",
        "to_s": "a part of a record is a slice of it",
        **dict.fromkeys(("cache", "use_cache"), "the function always uses the user's cache"),
    },
    "instrument": {
        "undo": "it removes a folder's systems in place, which the function never changes"
    },
    "campaign run": {
        "shard": "merge_campaign makes results of shards",
        "yes": "a call is agreement",
    },
}
"""Options that a function does not have, and why.

Functions of commands that are not here have every option.
"""
MORE = {
    "modes": dict.fromkeys(("V_mps", "bank_rad", "climb_rad", "heading_rad"), IN_RADIANS)
    | {"properties": "JSBSim properties"},
    "log import": {"paths": "several logs"},
    "instrument": {"mass": "the options by name"},
    "refine": {"on_stage": "a callback"},
    "campaign run": {"on_progress": "a callback"},
}
"""Parameters that are not options of the command, with the reason."""


def commands() -> dict[str, argparse.ArgumentParser]:
    every = {}
    for name, parser in commands_of(complete_parser()).items():
        below = commands_of(parser)
        every |= {f"{name} {sub}": one for sub, one in below.items()} if below else {name: parser}
    return every


def test_every_command_is_a_function():
    # A script for a shell is nothing to Python.
    assert commands().keys() - {"completion"} == FUNCTIONS.keys()
    assert all(callable(getattr(uq, function)) for function in FUNCTIONS.values())


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_takes_the_options_of_its_command(name):
    parameters = set(inspect.signature(getattr(uq, FUNCTIONS[name])).parameters)
    options = {action.dest for action in commands()[name]._actions} - OF_A_TERMINAL
    left_out = LEFT_OUT.get(name, {}).keys()
    assert left_out <= options
    renamed = {o if o in parameters else RENAMED.get(o, o) for o in options - left_out}
    assert renamed == parameters - MORE.get(name, {}).keys()


def test_functions_that_packages_are_named_after_can_be_called():
    import uqharness.dossier
    import uqharness.next_flight
    import uqharness.report
    import uqharness.study

    with pytest.raises(uq.BadInputError, match="folder = 5"):
        uq.sensitivity(5)
    assert callable(uq.sensitivity.run_study)
    for name in ("report", "study", "dossier", "next_flight"):
        assert "out" in inspect.signature(getattr(uq, name)).parameters or name == "report"
        with pytest.raises(uq.BadInputError):
            getattr(uq, name)(5, out="out") if name != "report" else uq.report(5)
    assert uqharness.report.write_report is not None
