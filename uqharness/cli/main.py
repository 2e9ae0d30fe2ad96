"""The command line: its commands, and errors as one line and an exit code.

Exit codes: 0 done, 1 ran but the answer is no, 2 bad input, 130 interrupted (Ctrl-C), 143 ended by
a signal (SIGTERM). A command's module is loaded when the command is named, so ``uqharness --help``
loads no numerical library.
"""

from __future__ import annotations

import argparse
import gc
import logging
import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sysid.display import clean_terminal, cursor_stream
from sysid.errors import LogError
from uqharness import __version__
from uqharness.errors import BadInputError, EnginesDifferError, TerminatedError
from uqharness.heartbeat import QUIET_VARIABLE, heartbeat

# Commands by name: the list of commands loads no library, a command its request alone.


@dataclass(frozen=True)
class RequestCommand:
    """A command that is defined by its request.

    Attributes
    ----------
    request : str
        ``module:Class`` within uqharness.requests.
    function : str
        ``module:function`` within uqharness.commands, or with its full name; it takes the request
        and a callback, and returns an Outcome.
    help : str
        Line in the list of commands.
    """

    request: str
    function: str
    help: str


@dataclass(frozen=True)
class Verbs:
    """A command with verbs, such as ``uqharness log info``.

    Attributes
    ----------
    table : Mapping
        Verb to its command.
    help : str
        Line in the list of commands.
    description, example : str
        Help page.
    """

    table: Mapping[str, RequestCommand]
    help: str
    description: str
    example: str = ""


Table = Mapping[str, RequestCommand] | Mapping[str, RequestCommand | Verbs]


class Command(argparse.ArgumentParser):
    """Parser of a command, to which its request adds the arguments at the first use."""

    entry: RequestCommand | Verbs | None = None

    def complete(self) -> None:
        """Add the arguments once."""
        entry, self.entry = self.entry, None
        if isinstance(entry, RequestCommand):
            # Imported here: the list of commands loads no pydantic.
            from uqharness.cli.request_command import add_request_command

            add_request_command(self, entry.request, entry.function)
        elif entry is not None:
            self.description, self.epilog = entry.description, entry.example
            self.formatter_class = argparse.RawDescriptionHelpFormatter
            add_commands(self, entry.table, "verb", "VERB")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Check the names of commands; values of options are checked by the request."""
        if isinstance(action, argparse._SubParsersAction) or not hasattr(action.type, "is_file"):
            super()._check_value(action, value)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse as argparse does, after the arguments were added."""
        self.complete()
        return super().parse_known_args(args, namespace)


def add_commands(parser: argparse.ArgumentParser, table: Table, dest: str, metavar: str) -> None:
    """Add the commands of a table to a parser."""
    added = parser.add_subparsers(dest=dest, metavar=metavar, required=True, parser_class=Command)
    for name, entry in table.items():
        added.add_parser(name, help=entry.help).entry = entry


def commands_of(parser: argparse.ArgumentParser) -> dict[str, Command]:
    """Return the commands of a parser by name; nested ones need completed parsers."""
    return {
        n: c
        for a in parser._actions
        if isinstance(a, argparse._SubParsersAction)
        for n, c in a.choices.items()
    }


_EXAMPLE = """examples:
  uqharness modes espaaro --speed-mps 22.2
  uqharness campaign run campaigns/demo/campaign.toml --out results

uqharness COMMAND --help gives the options."""

_GC_THRESHOLDS = 5_000, 10, 10
"""Thresholds of the garbage collector. With Python's 700 a command spends a twentieth of its time
scanning the objects of its libraries, none of which is ever freed."""

_LOG_VERBS = {
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
_LOG_EXAMPLE = """examples:
  uqharness log info flight1.bin --aircraft aircraft/espaaro
  uqharness log import flight1.bin --aircraft aircraft/espaaro --out flight1.parquet

uqharness log VERB --help gives the options."""
_CAMPAIGN_VERBS = {
    verb: RequestCommand(
        f"campaign:{verb.title().replace('-', '')}Request",
        f"campaign:{verb.replace('-', '_')}",
        text,
    )
    for verb, text in {
        "check": "cost of a campaign, without running it",
        "run": "run a campaign, or resume it",
        "status": "progress of a campaign",
        "report": "write report.html and the figures",
        "merge": "merge shards and write the tables",
        "rerun": "repeat one case with full output and a plot",
        "surrogate-check": "repeat cases with a real autopilot, and correct the p-boxes",
        "verify": "check a folder against its digests",
        "salvage": "repair a damaged campaign: keep undamaged flights, repeat the others",
        "convergence": "convergence over flights and epistemic samples",
        "area": "area metric of real flights against the p-boxes",
    }.items()
}
_CAMPAIGN_EXAMPLE = """example:
  uqharness campaign run campaigns/demo/campaign.toml --out campaigns/demo/results

uqharness campaign VERB --help gives the options."""
GROUPS: Mapping[str, Mapping[str, RequestCommand | Verbs]] = {
    "aircraft and models": {
        "author": RequestCommand(
            "authoring:AuthorRequest",
            "authoring:author",
            "write an aircraft from AVL, VSPAERO, XFLR5 or a table, with prior bounds",
        ),
        "instrument": RequestCommand(
            "simulation:InstrumentRequest",
            "simulation:instrument",
            "add the model-form plugin to any JSBSim aircraft",
        ),
        "modes": RequestCommand(
            "simulation:ModesRequest", "simulation:modes", "trim, eigenvalues, MIL-F-8785C levels"
        ),
        "performance": RequestCommand(
            "authoring:PerformanceRequest",
            "authoring:performance",
            "stall, glide, climb, ceiling and turn, with intervals from the bounds",
        ),
        "margins": RequestCommand(
            "simulation:MarginsRequest",
            "simulation:margins",
            "gain, phase and delay margins of the autopilot",
        ),
        "diff": RequestCommand(
            "simulation:DiffRequest",
            "simulation:diff",
            "compare two models in the same manoeuvres",
        ),
        "export": RequestCommand(
            "authoring:ExportRequest",
            "exchange:export",
            "write the model for ArduPilot, PX4, Gazebo, as an FMU or a table, with the loss",
        ),
    },
    "flights and logs": {
        "fly": RequestCommand("simulation:FlyRequest", "simulation:fly", "simulate a flight"),
        "log": Verbs(
            _LOG_VERBS,
            "flight logs: contents and checks, conversion to records",
            "Check a flight log, convert it to a flight record, or export it to FlightGear.",
            _LOG_EXAMPLE,
        ),
        "compare": RequestCommand(
            "identification:CompareRequest",
            "identification:compare",
            "compare a flight with the model",
        ),
    },
    "from flights to a model with bounds": {
        "identify": RequestCommand(
            "identification:IdentifyRequest", "identification:identify", "parameters from flights"
        ),
        "bounds": RequestCommand(
            "identification:BoundsRequest",
            "identification:bounds",
            "model-form bounds from flights",
        ),
        "validate-bounds": RequestCommand(
            "identification:ValidateBoundsRequest",
            "identification:validate_bounds",
            "coverage of bounds on a new flight",
        ),
        "refine": RequestCommand(
            "refinement:RefineRequest", "refinement:refine", "find, name and add missing effects"
        ),
    },
    "campaigns": {
        "campaign": Verbs(
            _CAMPAIGN_VERBS,
            "nested Monte Carlo campaigns: check, run, status, report and more",
            "Run a campaign over corners of model-form uncertainty, and report it.",
            _CAMPAIGN_EXAMPLE,
        ),
        "sensitivity": RequestCommand(
            "campaign:SensitivityRequest",
            "sensitivity:sensitivity",
            "which uncertainty to reduce first",
        ),
        "next-flight": RequestCommand(
            "next_flight:NextFlightRequest",
            "next_flight:next_flight",
            "plan the test flight that narrows the p-box most",
        ),
        "study": RequestCommand(
            "folders:StudyRequest",
            "study:study",
            "the whole chain: flights to p-boxes, before and after refinement",
        ),
    },
    "results": {
        "report": RequestCommand(
            "folders:ReportRequest", "folders:report", "write report.html of a folder of results"
        ),
        "dossier": RequestCommand(
            "folders:DossierRequest",
            "folders:dossier",
            "the evidence of a folder of results as one printable document",
        ),
    },
    "shell": {
        "completion": RequestCommand(
            "folders:CompletionRequest",
            "uqharness.cli.completion:completion",
            "a script for the completion of bash or zsh",
        ),
    },
}
"""Commands by what they are for, in the order of the help page."""
COMMANDS: Table = {name: entry for group in GROUPS.values() for name, entry in group.items()}


class CommandLine(argparse.ArgumentParser):
    """Parser of the whole command line, whose help page has the commands by group."""

    def format_help(self) -> str:
        """Return the help page; argparse alone prints all commands as one list."""
        formatter = self._get_formatter()
        formatter.add_usage(self.usage, self._actions, self._mutually_exclusive_groups)
        formatter.add_text(self.description)
        (commands,) = (a for a in self._actions if isinstance(a, argparse._SubParsersAction))
        lines = {line.dest: line for line in commands._choices_actions}
        options = [action for action in self._actions if action.option_strings]
        sections = {
            title: [lines[name] for name in table if name in lines]
            for title, table in GROUPS.items()
        }
        for title, actions in {**sections, "options": options}.items():
            formatter.start_section(title)
            formatter.add_arguments(actions)
            formatter.end_section()
        formatter.add_text(self.epilog)
        return formatter.format_help()


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    parser = CommandLine(
        prog="uqharness",
        description="From flight logs and a JSBSim model to p-boxes of the aircraft's performance.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"uqharness {__version__}")
    add_commands(parser, COMMANDS, "command", "COMMAND")
    return parser


def complete_parser() -> argparse.ArgumentParser:
    """Return the parser with the arguments of every command, for documentation and checks."""
    parser = build_parser()
    parsers = list(commands_of(parser).values())
    for command in parsers:  # grows on the way
        command.complete()
        parsers += commands_of(command).values()
    return parser


def load_command(words: Sequence[str]) -> None:
    """Load what the command among the words needs; nothing where they name none."""
    commands = commands_of(build_parser())
    for word in words:
        if word in commands:
            commands[word].complete()
            commands = commands_of(commands[word])


def run_words(words: Sequence[str] | None) -> int:
    """Run one command in this process; return its exit code. Raises BadInputError."""
    try:
        parser = build_parser()
        arguments, unknown = parser.parse_known_args(words)
        if unknown:
            _refuse_unknown(arguments, unknown[0])
        return int(arguments.handler(arguments))
    except LogError as error:
        raise BadInputError(str(error)) from None


def _refuse_unknown(arguments: argparse.Namespace, word: str) -> None:
    """Raise BadInputError for a word that the command does not know, with the closest option."""
    options = [
        option
        for action in arguments.parser._actions
        for option in action.option_strings
        if option.startswith("--")
    ]
    # Imported here: the list of commands loads no pydantic.
    from uqharness.requests.base import unknown_among

    name = word.partition("=")[0]
    raise BadInputError(f"{word}: {unknown_among(name, sorted(options))}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; return the process's exit code."""
    gc.set_threshold(*_GC_THRESHOLDS)
    words = sys.argv[1:] if argv is None else argv
    if "--quiet" in words:
        # Before the first heartbeat; other processes of the command inherit it.
        os.environ[QUIET_VARIABLE] = "1"
    logger, notes = logging.getLogger("uqharness"), _Notes()
    logger.addHandler(notes)
    logger.setLevel(logging.INFO)
    try:
        with clean_terminal(), heartbeat(_command_name(words)):
            return _run(argv)
    finally:
        logger.removeHandler(notes)


def _command_name(words: Sequence[str]) -> str:
    """Return the name of the command among the words, such as ``campaign run``."""
    names = [word for word in words[:2] if word.replace("-", "").isalpha()]
    length = 2 if names and names[0] in ("campaign", "log") else 1
    return " ".join(["uqharness", *names[:length]])


def _resumes(words: str) -> bool:
    """Check whether a command resumes after an interruption; others keep nothing."""
    return words.startswith(
        ("uqharness campaign run ", "uqharness campaign salvage ", "uqharness study ")
    )


def _printable(text: str) -> str:
    """Hide the paths of temporary folders. There are none while nothing has loaded the module that
    makes them, which the help of a command does without.
    """
    files = sys.modules.get("uqharness.files")
    return text if files is None else str(files.hide_scratch_paths(text))


class _Notes(logging.Handler):
    """Prints notes of the program to standard error, one per line."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a note, overwriting a progress line."""
        if sys.stderr.isatty():
            print("\r\x1b[K", end="", file=cursor_stream(sys.stderr))
        print(f"note: {_printable(record.getMessage())}", file=sys.stderr)


def _run(argv: Sequence[str] | None) -> int:
    """Run one command; convert exceptions to a line on standard error and an exit code."""
    try:
        code = run_words(argv)
        sys.stdout.flush()
        return code
    except BadInputError as error:
        print(f"uqharness: error: {_printable(str(error))}", file=sys.stderr)
        return 2
    except EnginesDifferError as error:
        print(f"uqharness: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt as ended:
        print(
            "uqharness:",
            "terminated" if isinstance(ended, TerminatedError) else "interrupted",
            file=sys.stderr,
        )
        words = shlex.join(["uqharness", *(sys.argv[1:] if argv is None else argv)])
        outcome = "resumes" if _resumes(words) else "begins anew"
        print(f"uqharness: this command {outcome}: {words}", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # The reader of the output has closed it (head, less). That is no error, but flushing at
        # exit would raise again, so standard output is redirected.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except MemoryError:
        print(
            "uqharness: error: out of memory; free some, or give the command less to do",
            file=sys.stderr,
        )
        return 2
    except OSError as error:
        print(
            f"uqharness: error: {error.filename or 'file system'}: {error.strerror or error}",
            file=sys.stderr,
        )
        return 2


if __name__ == "__main__":
    sys.exit(main())
