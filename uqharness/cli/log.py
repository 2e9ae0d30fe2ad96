"""``uqharness log info`` and ``uqharness log import``: sysid's commands under this program's errors."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from sysid.errors import LogError
from uqharness.errors import BadInputError
from uqharness.simulator.aircraft import find_aircraft


def register(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``log info`` and ``log import`` to a parser."""
    parser = commands.add_parser("log", help="flight logs: what is in them, records from them")
    parser.set_defaults(handler=_run)
    parse = parser.parse_known_args

    def parse_completed(args: Any = None, namespace: Any = None) -> Any:
        parser.parse_known_args = parse  # type: ignore[method-assign]
        complete(parser)
        return parse(args, namespace)

    parser.parse_known_args = parse_completed  # type: ignore[method-assign]


def complete(parser: argparse.ArgumentParser) -> None:
    """Give the ``log`` parser its subcommands: at its first use, since pandas and pyarrow take a second."""
    from sysid.logs import commands as log_commands

    log_commands.add_arguments(parser.add_subparsers(dest="log_command", metavar="info|import", required=True))


def _run(args: argparse.Namespace) -> int:
    try:
        if args.aircraft is not None and not Path(args.aircraft).is_file():
            args.aircraft = str(find_aircraft(args.aircraft).folder)
        return int(args.run(args))
    except LogError as error:
        raise BadInputError(str(error)) from None
