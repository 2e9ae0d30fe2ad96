"""Options that commands share: each is defined once, with one help text and one check.

A check that fails raises BadInputError while the words of a command are read, before any work is
done."""

from __future__ import annotations

import argparse
import importlib
import math
import shlex
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uqharness.errors import BadInputError

if TYPE_CHECKING:
    from uqharness.flight import AutopilotGains
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
    """Give a command its handler, ``--json`` and its help page.

    Parameters
    ----------
    text
        What the command does, a sentence.
    examples
        Command lines, one a line, and after an empty line what they write.
    done, no
        What exit codes 0 and 1 mean; a command without ``no`` never ends with 1.
    """
    parser.description = text
    answers = f"0 {done}, 1 {no}" if no else f"0 {done}"
    example_text = examples.strip("\n")
    parser.epilog = (
        f"examples:\n{example_text}\n\nExit codes: {answers}, 2 bad input, 130 interrupted."
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--json", action="store_true", help="machine-readable output")
    parser.set_defaults(handler=handler, parser=parser)


def add_aircraft(parser: argparse.ArgumentParser) -> None:
    """The aircraft, first of a command's words."""
    parser.add_argument(
        "aircraft",
        metavar="AIRCRAFT",
        help="name under aircraft/ or in JSBSim's collection, or a folder",
    )


def aircraft_with_card(name_or_folder: str) -> Aircraft:
    """The aircraft of that name or folder; one without airframe.toml is instrumented for this run,
    and a note says so.

    Raises BadInputError where there is none, and for one that does not fly or cannot be
    instrumented."""
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
    """``--out``, a folder of results."""
    text = "folder for the results, made if need be" + (
        "" if required else " (default: nothing is written)"
    )
    parser.add_argument("--out", type=Path, required=required, metavar="DIR", help=text)


def add_page(parser: argparse.ArgumentParser, content: str, option: str = "--out") -> None:
    """A page as a file, by ``--out`` or, where that is the command's result, by another
    ``option``.
    """
    text = f"write a page with {content} (default: no page)"
    parser.add_argument(option, type=Path, metavar="FILE.html", help=text)


def add_workers(parser: argparse.ArgumentParser, default: str = "one a core") -> None:
    """``--workers``; None where it is not given."""
    parser.add_argument(
        "--workers",
        type=integer("--workers", 1),
        metavar="N",
        help=f"processes (default: {default})",
    )


def add_seed(parser: argparse.ArgumentParser, of: str, default: int = 0) -> None:
    """``--seed`` of what is drawn."""
    parser.add_argument(
        "--seed",
        type=integer("--seed", 0),
        default=default,
        metavar="N",
        help=f"seed of {of} (default %(default)s)",
    )


def add_no_figures(parser: argparse.ArgumentParser) -> None:
    """``--no-figures``."""
    parser.add_argument("--no-figures", action="store_true", help="leave out the figures")


def add_flights(
    parser: argparse.ArgumentParser, option: str = "--flight", text: str = "flight"
) -> None:
    """Files of flights, at least one."""
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
    """How flights are read and how commands reach the surfaces: ``--map``, ``--flight-number``,
    ``--manoeuvres``, ``--servos``.
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
            "which flight of logs that hold several boots of the autopilot: one number, or one a"
            " file (default: the longest)"
        ),
    )
    add_manoeuvres(parser)
    parser.add_argument(
        "--servos",
        choices=("auto", "card", "ideal"),
        default="auto",
        help=(
            "commands go through the aircraft's actuators (card), or surfaces and throttle follow"
            " them at once (ideal); auto: of a log, the likelier of the two (default %(default)s)"
        ),
    )


def add_map(parser: argparse.ArgumentParser) -> None:
    """``--map``."""
    parser.add_argument(
        "--map",
        type=Path,
        metavar="MAP.toml",
        help="signal map of your own; its lines replace those of the log's format",
    )


def add_flight_number(parser: argparse.ArgumentParser) -> None:
    """``--flight-number``; None where the longest flight is read."""
    parser.add_argument(
        "--flight-number",
        type=integer("--flight-number", 1),
        metavar="N",
        help=(
            "which flight of a log that holds several boots of the autopilot (default: the longest)"
        ),
    )


def add_manoeuvres(parser: argparse.ArgumentParser) -> None:
    """``--manoeuvres``."""
    text = (
        "table that labels the flights: columns manoeuvre, start_s, end_s (and flight); or the word"
        " found: those that `log info` finds in the commands"
    )
    parser.add_argument("--manoeuvres", type=Path, metavar="FILE.csv", help=text)


def add_replay_options(parser: argparse.ArgumentParser) -> None:
    """What is estimated beside the parameters when a flight is replayed: ``--biases``,
    ``--delays``.
    """
    parser.add_argument(
        "--biases",
        metavar="C,C",
        help="channels whose constant bias is estimated, or none (default p,q,r)",
    )
    parser.add_argument(
        "--delays",
        metavar="C,C",
        help=(
            "signals whose delay is estimated: channels, controls, or none (default: controls; of a"
            " log, all)"
        ),
    )


def add_no_check(parser: argparse.ArgumentParser, text: str) -> None:
    """``--no-check``: leave out what a command does beyond its result to show that it is sound."""
    parser.add_argument("--no-check", action="store_true", help=f"skip {text}")


def integer(option: str, minimum: int, maximum: int | None = None) -> Callable[[str], int]:
    """Reader of a whole number within limits. It raises BadInputError."""

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
    """Reader of a finite number ``above`` or at ``minimum`` one limit and up to ``maximum``. It
    raises BadInputError.

    ``quantity`` names the quantity and its unit.
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
    upper = "" if maximum is None else f"up to {maximum:g}"
    return " and ".join(part for part in (lower, upper) if part)


def results_folder(path: Path) -> Path:
    """The folder of ``--out``, made with those above it. Raises BadInputError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInputError(f"--out {path}: cannot be made: {error.strerror}") from None
    return path


def command_words(args: argparse.Namespace) -> list[str]:
    """The words that make a result again: files by name alone, no option at its default, nor
    ``--out``, ``--page``, ``--json``.
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
        each = isinstance(value, list) and action.nargs is None
        words += [word for text in texts for word in (*flag, text)] if each else [*flag, *texts]
    return words


def command_as_given(args: argparse.Namespace) -> str:
    """The same as one line of a shell."""
    return shlex.join(command_words(args))


# ``--autopilot FILE``: an autopilot's gains from ArduPilot's parameter file, and what was taken
# of it.


def add_autopilot(parser: argparse.ArgumentParser) -> None:
    """``--autopilot``."""
    parser.add_argument(
        "--autopilot",
        type=Path,
        metavar="FILE",
        help=(
            "ArduPlane parameter file (.parm, .param): gains of the autopilot (default: the"
            " aircraft's own)"
        ),
    )


def gains_of(path: Path | None, aircraft: Aircraft, script: Path) -> AutopilotGains | None:
    """Gains in the file for this aircraft; None without a file.

    Raises BadInputError with file and line.
    """
    if path is None:
        return None
    from uqharness.flight import read_gains
    from uqharness.simulator import StagedMission, engine

    with StagedMission(aircraft, script) as mission:
        return read_gains(path, set(engine.catalog(mission.open())))


def print_gains(path: Path | None, gains: AutopilotGains | None) -> None:
    """Print which gains were taken, which not, and why."""
    if gains is not None:
        print("\n  ".join([f"{path}:", *gains.lines()]))


def gains_document(gains: AutopilotGains | None) -> dict[str, Any] | None:
    """The same for --json."""
    return (
        None
        if gains is None
        else {"taken": gains.properties, "ignored": dict(gains.ignored), "others": gains.others}
    )


# Commands whose module is loaded when they are named, so that ``uqharness --help`` waits for no
# numerical library.

Table = Mapping[str, tuple[str, str]]
"""Name of a command: the function that adds its arguments (``module`` or ``module:function``), and
what it is for.
"""


class Command(argparse.ArgumentParser):
    """A command's parser, to which a module adds the arguments at the first use."""

    place = ""

    def complete(self) -> None:
        """Add the arguments, unless they are there."""
        place, self.place = self.place, ""
        if place:
            module, _, function = place.partition(":")
            getattr(
                importlib.import_module(f"uqharness.cli.{module}"), function or "add_arguments"
            )(self)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse does it, once the arguments are there."""
        self.complete()
        return super().parse_known_args(args, namespace)


def add_commands(parser: argparse.ArgumentParser, table: Table, dest: str, metavar: str) -> None:
    """Give a parser the commands of a table."""
    added = parser.add_subparsers(dest=dest, metavar=metavar, required=True, parser_class=Command)
    for name, (place, text) in table.items():
        added.add_parser(name, help=text).place = place


def commands_of(parser: argparse.ArgumentParser) -> dict[str, Command]:
    """The commands that a parser has, by name; completed parsers alone have those below them."""
    return {
        n: c
        for a in parser._actions
        if isinstance(a, argparse._SubParsersAction)
        for n, c in a.choices.items()
    }
