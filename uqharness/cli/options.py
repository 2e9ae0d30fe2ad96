"""Commands by name: the list of commands loads no library, a command its request alone."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


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
