"""``uqharness campaign VERB``."""

from __future__ import annotations

import argparse

from uqharness.cli.options import Table, add_commands

VERBS: Table = {
    "check": ("campaign.run:add_check", "cost of a campaign before it is flown"),
    "run": ("campaign.run:add_run", "fly a campaign, or resume it"),
    "status": ("campaign.folder:add_status", "progress of a campaign"),
    "report": ("campaign.folder:add_report", "write report.html and the figures"),
    "merge": ("campaign.folder:add_merge", "merge shards and write the tables"),
    "rerun": ("campaign.folder:add_rerun", "fly one case again with full output and a plot"),
    "verify": ("campaign.folder:add_verify", "check a folder against its digests"),
    "salvage": (
        "campaign.folder:add_salvage",
        "repair a damaged campaign: keep sound flights, fly the rest again",
    ),
    "convergence": (
        "campaign.folder:add_convergence",
        "convergence over flights and epistemic samples",
    ),
    "area": ("campaign.folder:add_area", "area metric of real flights against the p-boxes"),
}
_EXAMPLE = """example:
  uqharness campaign run campaigns/demo/campaign.toml --out campaigns/demo/results

uqharness campaign VERB --help gives the options."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Give ``campaign`` its verbs."""
    parser.description = (
        "Fly a campaign over corners of model-form uncertainty, watch it, and report it."
    )
    parser.epilog = _EXAMPLE
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    add_commands(parser, VERBS, "campaign_command", "VERB")
