"""Commands whose module is loaded when they are named, so that ``uqharness --help`` waits for no numerical library."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Mapping
from typing import Any

Table = Mapping[str, tuple[str, str]]
"""Name of a command: the function that adds its arguments (``module`` or ``module:function``), and what it is for."""


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
