"""``uqharness log info | map | import | export``."""

from __future__ import annotations

import argparse

from uqharness.cli.options import RequestCommand, Table, add_commands

VERBS: Table = {
    "info": RequestCommand(
        "logs:LogInfoRequest",
        "logs:log_info",
        "contents and findings of a log, and the purposes it serves",
    ),
    "map": RequestCommand(
        "logs:LogMapRequest", "logs:propose_map", "propose a signal map for a log"
    ),
    "import": RequestCommand(
        "logs:LogImportRequest", "logs:import_record", "turn a log into a flight record"
    ),
    "export": RequestCommand(
        "logs:LogExportRequest", "logs:export_log", "write a flight for FlightGear"
    ),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verbs of ``log``."""
    parser.description = (
        "Check a flight log, convert it to a flight record, or export it to FlightGear."
    )
    add_commands(parser, VERBS, "log_command", "info|map|import|export")
