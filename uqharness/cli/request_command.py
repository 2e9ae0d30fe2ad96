"""A command that is defined by its request: its options, its run and what it prints."""

from __future__ import annotations

import argparse
import importlib
import json
import logging
import os
import sys
from typing import Any

from uqharness.cli.arguments import add_request, request_of
from uqharness.heartbeat import QUIET_VARIABLE


def add_request_command(parser: argparse.ArgumentParser, request: str, function: str) -> None:
    """Add the options of a command's request, and what runs it.

    ``request`` and ``function`` are ``module:name`` within uqharness.requests and
    uqharness.commands.
    """
    model = _part("uqharness.requests", request)
    add_request(parser, model)

    def run(args: argparse.Namespace) -> int:
        """Run the command; return its exit code."""
        # The library of progress bars is slow to load, and no help page needs it.
        from uqharness.cli.progress import ProgressView, print_warnings, working

        # Notes are log records, which --quiet leaves out as well.
        logging.getLogger("uqharness").setLevel(logging.WARNING if args.quiet else logging.INFO)
        if args.quiet:
            os.environ[QUIET_VARIABLE] = "1"
        values = request_of(model, args)
        run_request = _part("uqharness.commands", function)
        if model.flies:
            with ProgressView() as view:
                outcome = run_request(values, view.update)
        else:
            with working(model.command, _segments_flown, keep=model.keeps_stages) as callback:
                outcome = run_request(values, callback)
        if not args.quiet:
            print_warnings(outcome.warnings)
        if args.json:
            print(json.dumps(outcome.as_json()))
        elif not args.quiet:
            print(outcome.text())
        return int(outcome.code)

    parser.set_defaults(handler=run, parser=parser, model=model)


def _part(package: str, place: str) -> Any:
    """Return the object that ``module:name`` names within a package, or by its full name."""
    module, _, name = place.partition(":")
    path = module if module.startswith("uqharness.") else f"{package}.{module}"
    return getattr(importlib.import_module(path), name)


def _segments_flown() -> int:
    """Return the number of segments that replays have flown; 0 where none was loaded."""
    replay = sys.modules.get("uqharness.replay.simulation")
    return 0 if replay is None else int(replay.counter["segments"])
