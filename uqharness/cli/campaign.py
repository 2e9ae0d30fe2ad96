"""``uqharness campaign VERB``: the table of verbs, whose modules are loaded when they are named."""

from __future__ import annotations

import argparse

from uqharness.cli.options import RequestCommand, Table, add_commands

VERBS: Table = {
    verb: RequestCommand(f"campaign:{verb.capitalize()}Request", f"campaign:{verb}", text)
    for verb, text in {
        "check": "cost of a campaign before it is flown",
        "run": "fly a campaign, or resume it",
        "status": "progress of a campaign",
        "report": "write report.html and the figures",
        "merge": "merge shards and write the tables",
        "rerun": "fly one case again with full output and a plot",
        "verify": "check a folder against its digests",
        "salvage": "repair a damaged campaign: keep sound flights, fly the rest again",
        "convergence": "convergence over flights and epistemic samples",
        "area": "area metric of real flights against the p-boxes",
    }.items()
}
_EXAMPLE = """example:
  uqharness campaign run campaigns/demo/campaign.toml --out campaigns/demo/results

uqharness campaign VERB --help gives the options."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verbs of ``campaign``."""
    parser.description = (
        "Fly a campaign over corners of model-form uncertainty, watch it, and report it."
    )
    parser.epilog = _EXAMPLE
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    add_commands(parser, VERBS, "campaign_command", "VERB")
