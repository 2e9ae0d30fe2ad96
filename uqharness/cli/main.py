"""The command line: builds the parser, turns errors into one line and an exit code.

Exit codes: 0 done, 1 ran but the answer is no, 2 bad input, 130 interrupted (Ctrl-C), 143 ended by a signal (SIGTERM).
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
from collections.abc import Sequence

from sysid.terminal import clean_terminal
from uqharness import __version__
from uqharness.cli import bounds as bounds_command
from uqharness.cli import campaign as campaign_commands
from uqharness.cli import compare as compare_command
from uqharness.cli import fly as fly_command
from uqharness.cli import identify as identify_command
from uqharness.cli import instrument as instrument_command
from uqharness.cli import log as log_command
from uqharness.cli import margins as margins_command
from uqharness.cli import modes as modes_command
from uqharness.cli import next_flight as next_flight_command
from uqharness.cli import refine as refine_command
from uqharness.cli import report as report_command
from uqharness.cli import sensitivity as sensitivity_command
from uqharness.cli import study as chain_command
from uqharness.errors import BadInputError

_EXAMPLE = """examples:
  uqharness modes espaaro --speed-mps 22.2
  uqharness campaign run campaigns/demo/campaign.toml --out results

uqharness COMMAND --help tells the rest."""


def build_parser() -> argparse.ArgumentParser:
    """The parser of the whole command line, every command registered."""
    parser = argparse.ArgumentParser(
        prog="uqharness",
        description="How far can a flight model be trusted, and what does that do to the aircraft's performance?",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"uqharness {__version__}")
    # A study runs other commands in its own process.
    parser.set_defaults(run_words=run_words)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for module in (
        fly_command,
        modes_command,
        margins_command,
        log_command,
        identify_command,
        compare_command,
        bounds_command,
        instrument_command,
        refine_command,
        campaign_commands,
        sensitivity_command,
        next_flight_command,
        chain_command,
        report_command,
    ):
        module.register(commands)
    return parser


def complete_parser() -> argparse.ArgumentParser:
    """The same with the subcommands that are otherwise added at their first use: for documentation and checks."""
    parser = build_parser()
    (commands,) = (action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    log_command.complete(commands.choices["log"])
    return parser


def run_words(words: Sequence[str]) -> int:
    """Run one command in this process, errors left to the caller; its exit code."""
    arguments = build_parser().parse_args(words)
    return int(arguments.handler(arguments))


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; the process's exit code."""
    with clean_terminal():
        return _run(argv)


class _Notes(logging.Handler):
    """What the program has to say of its own accord, a line each on standard error."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print it."""
        print(f"note: {record.getMessage()}", file=sys.stderr)


def _run(argv: Sequence[str] | None) -> int:
    logger = logging.getLogger("uqharness")
    if not any(isinstance(handler, _Notes) for handler in logger.handlers):
        logger.addHandler(_Notes())
        logger.setLevel(logging.INFO)
    arguments = build_parser().parse_args(argv)
    try:
        code = int(arguments.handler(arguments))
        sys.stdout.flush()
        return code
    except BadInputError as error:
        print(f"uqharness: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("uqharness: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # The reader of our output has left (head, less): that is no error, but flushing at exit would complain.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except MemoryError:
        print("uqharness: error: out of memory; free some, or give the command less to do", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"uqharness: error: {error.filename or 'file system'}: {error.strerror or error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
