"""Options that commands share: each is defined once, with one help text and one check.

A check that fails raises BadInputError while the words of a command are parsed, before any work is
done. The module also holds the table of commands, whose modules are loaded when they are named.
"""

from __future__ import annotations

import argparse
import importlib
import math
import shlex
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uqharness.errors import BadInputError

if TYPE_CHECKING:
    from uqharness.simulator import Aircraft

Handler = Callable[[argparse.Namespace], int]
DEFAULT_WORKERS = "one a core, 8 at most"
FLIGHT_FILE = "record (.parquet, .csv) or any log that `log import` reads"


def describe(
    parser: argparse.ArgumentParser,
    handler: Handler,
    text: str,
    examples: str,
    *,
    done: str = "done",
    no: str = "",
) -> None:
    """Set the handler, ``--json`` and the help page of a command.

    Parameters
    ----------
    parser : ArgumentParser
        Of the command.
    handler : callable
        Takes the parsed arguments and returns the exit code.
    text : str
        What the command does, a sentence.
    examples : str
        Command lines, one a line, then an empty line and what they write.
    done, no : str
        Meaning of exit codes 0 and 1; a command without ``no`` never ends with 1.
    """
    parser.description = text
    answers = f"0 {done}, 1 {no}" if no else f"0 {done}"
    example_text = examples.strip("\n")
    parser.epilog = (
        f"examples:\n{example_text}\n\nExit codes: {answers}, 2 bad input, 130 interrupted."
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.set_defaults(handler=handler, parser=parser)


def add_aircraft(parser: argparse.ArgumentParser) -> None:
    """Add the positional argument for the aircraft."""
    parser.add_argument(
        "aircraft",
        metavar="AIRCRAFT",
        help="name under aircraft/ or in JSBSim's collection, or a folder",
    )


def aircraft_with_card(name_or_folder: str) -> Aircraft:
    """Return the aircraft of a name or folder; one without airframe.toml is instrumented for this
    run.

    A note says so. Raises BadInputError where there is none, and for one that does not fly or
    cannot be instrumented.
    """
    from uqharness.plugin import with_card
    from uqharness.simulator import find_aircraft

    aircraft = find_aircraft(name_or_folder)
    if aircraft.has_card:
        return aircraft
    print(
        f"uqharness: note: {aircraft.name} has no airframe.toml; its controls are measured in short"
        f" flights. To see and keep the card: uqharness instrument {name_or_folder} --out DIR",
        file=sys.stderr,
    )
    return with_card(aircraft)


def add_out(parser: argparse.ArgumentParser, required: bool = True) -> None:
    """Add ``--out``, a folder of results."""
    text = "folder for the results, made if need be" + (
        "" if required else " (default: nothing is written)"
    )
    parser.add_argument("--out", type=Path, required=required, metavar="DIR", help=text)


def add_page(parser: argparse.ArgumentParser, content: str, option: str = "--out") -> None:
    """Add an option for a page as a file, by default ``--out``."""
    text = f"write a page with {content} (default: no page)"
    parser.add_argument(option, type=Path, metavar="FILE.html", help=text)


def add_workers(parser: argparse.ArgumentParser, default: str = "one a core") -> None:
    """Add ``--workers``; None where it is not given."""
    parser.add_argument(
        "--workers",
        type=integer("--workers", 1),
        metavar="N",
        help=f"processes (default: {default})",
    )


def add_seed(parser: argparse.ArgumentParser, of: str, default: int = 0) -> None:
    """Add ``--seed`` of what is drawn at random."""
    parser.add_argument(
        "--seed",
        type=integer("--seed", 0),
        default=default,
        metavar="N",
        help=f"seed of {of} (default %(default)s)",
    )


def add_no_figures(parser: argparse.ArgumentParser) -> None:
    """Add ``--no-figures``."""
    parser.add_argument("--no-figures", action="store_true", help="leave out the figures")


def add_flights(
    parser: argparse.ArgumentParser, option: str = "--flight", text: str = "flight"
) -> None:
    """Add an option for files of flights, at least one."""
    parser.add_argument(
        option,
        type=Path,
        nargs="+",
        action="extend",
        required=True,
        metavar="FILE",
        help=f"{text}: {FLIGHT_FILE}; repeatable",
    )


def add_log_options(parser: argparse.ArgumentParser) -> None:
    """Add how flights are read and how commands reach the surfaces.

    These are ``--map``, ``--flight-number``, ``--manoeuvres`` and ``--servos``.
    """
    add_map(parser)
    parser.add_argument(
        "--flight-number",
        type=integer("--flight-number", 1),
        nargs="+",
        action="extend",
        default=[],
        metavar="N",
        help=(
            "flight to read from logs with several boots of the autopilot: one number, or one per"
            " file (default: the longest)"
        ),
    )
    add_manoeuvres(parser)
    parser.add_argument(
        "--servos",
        choices=("auto", "card", "ideal"),
        default="auto",
        help=(
            "card: commands pass the aircraft's actuators; ideal: surfaces and throttle follow"
            " them at once; auto: for a log, the likelier of the two (default %(default)s)"
        ),
    )


def add_map(parser: argparse.ArgumentParser) -> None:
    """Add ``--map``."""
    parser.add_argument(
        "--map",
        type=Path,
        metavar="MAP.toml",
        help="signal map; its lines replace those of the log's format",
    )


def add_manoeuvres(parser: argparse.ArgumentParser) -> None:
    """Add ``--manoeuvres``."""
    text = (
        "table of manoeuvres: columns manoeuvre, start_s, end_s (and flight); or the word found,"
        " for those that `log info` finds in the commands"
    )
    parser.add_argument("--manoeuvres", type=Path, metavar="FILE.csv", help=text)


def add_no_check(parser: argparse.ArgumentParser, text: str) -> None:
    """Add ``--no-check``, which skips what a command does to prove its result."""
    parser.add_argument("--no-check", action="store_true", help=f"skip {text}")


def integer(option: str, minimum: int, maximum: int | None = None) -> Callable[[str], int]:
    """Return a reader of an integer within limits, which raises BadInputError.

    >>> integer("--cases", 1)("6")
    6
    """

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = minimum - 1
        if value < minimum or (maximum is not None and value > maximum):
            raise BadInputError(
                f"{option} {text}: a whole number of {_limits(f'at least {minimum}', maximum)} is"
                " needed"
            )
        return value

    return read


def number(
    option: str,
    quantity: str = "a number",
    *,
    above: float | None = None,
    minimum: float | None = None,
    maximum: float | None = None,
) -> Callable[[str], float]:
    """Return a reader of a finite number within limits, which raises BadInputError.

    Parameters
    ----------
    option : str
        For the message.
    quantity : str
        Quantity and unit, for the message.
    above, minimum, maximum : float, optional
        Exclusive lower, inclusive lower and inclusive upper limit.
    """

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        low = -math.inf if minimum is None else minimum
        fits = low <= value <= (math.inf if maximum is None else maximum) and (
            above is None or value > above
        )
        if not (math.isfinite(value) and fits):
            lower = (
                f"above {above:g}"
                if above is not None
                else f"of at least {minimum:g}"
                if minimum is not None
                else ""
            )
            raise BadInputError(
                f"{option} {text}: {quantity} {_limits(lower, maximum)}".rstrip() + " is needed"
            )
        return value

    return read


def _limits(lower: str, maximum: float | None) -> str:
    """Describe the limits of a number."""
    upper = "" if maximum is None else f"up to {maximum:g}"
    return " and ".join(part for part in (lower, upper) if part)


def command_words(args: argparse.Namespace) -> list[str]:
    """Return the words that repeat a result: file names only, no defaults, no ``--out``,
    ``--page``, ``--json``.
    """
    words = args.parser.prog.split()
    for action in args.parser._actions:
        value = getattr(args, action.dest, None)
        if action.dest in ("out", "page", "json") or value is None or value == action.default:
            continue
        flag, values = (
            action.option_strings[:1],
            value if isinstance(value, list) else [] if value is True else [value],
        )
        texts = [v.name if isinstance(v, Path) else str(v) for v in values]
        # An option with action "append" is repeated before each of its values.
        each = isinstance(value, list) and action.nargs is None
        words += [word for text in texts for word in (*flag, text)] if each else [*flag, *texts]
    return words


def command_as_given(args: argparse.Namespace) -> str:
    """Return the words as one shell line."""
    return shlex.join(command_words(args))


# Commands, whose modules are loaded when they are named: ``uqharness --help`` loads no numerical
# library.


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


Table = Mapping[str, tuple[str, str] | RequestCommand]
"""Command to its request, or to the function that adds its arguments (``module`` or
``module:function``) and its help.
"""


class Command(argparse.ArgumentParser):
    """Parser of a command, to which a module adds the arguments at the first use."""

    place: str | RequestCommand = ""

    def complete(self) -> None:
        """Add the arguments once."""
        place, self.place = self.place, ""
        if isinstance(place, RequestCommand):
            # Imported here: the list of commands loads no pydantic.
            from uqharness.cli.run import add_request_command

            add_request_command(self, place)
        elif place:
            module, _, function = place.partition(":")
            getattr(
                importlib.import_module(f"uqharness.cli.{module}"), function or "add_arguments"
            )(self)

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
        if isinstance(entry, RequestCommand):
            added.add_parser(name, help=entry.help).place = entry
        else:
            added.add_parser(name, help=entry[1]).place = entry[0]


def commands_of(parser: argparse.ArgumentParser) -> dict[str, Command]:
    """Return the commands of a parser by name; nested ones need completed parsers."""
    return {
        n: c
        for a in parser._actions
        if isinstance(a, argparse._SubParsersAction)
        for n, c in a.choices.items()
    }
