"""``uqharness completion``: a shell script that completes commands, options, files and aircraft.

shtab writes the script from the parser of all commands.
"""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import shtab

from uqharness.cli.main import commands_of, complete_parser
from uqharness.files import PROJECT_ROOT
from uqharness.heartbeat import Callback, silent
from uqharness.requests.folders import CompletionRequest
from uqharness.results.base import Outcome
from uqharness.results.folders import CompletionScript

SHELLS = ("bash", "zsh")
_AIRCRAFT: Mapping[str, str] = {
    "bash": '_uqharness_aircraft() {{ compgen -W {names} -- "$1"; compgen -d -- "$1"; }}',
    "zsh": "_uqharness_aircraft() {{ compadd -- {words}; _files -/; }}",
}


def completion(request: CompletionRequest, callback: Callback = silent) -> Outcome[str]:
    """Return the script of a shell."""
    text = script(complete_parser(), request.shell)
    document = CompletionScript(shell=request.shell, script=text)
    return Outcome(text, document, [text], cut=False)


def script(parser: argparse.ArgumentParser, shell: str) -> str:
    """Return the completion script of ``bash`` or ``zsh`` for a parser."""
    for action in _actions(parser):
        completer = _completer(action)
        if completer is not None:
            action.complete = completer  # type: ignore[attr-defined]
    # The script lists the aircraft at the time it is written.
    names = " ".join(shlex.quote(name) for name in known_aircraft())
    preamble = _AIRCRAFT[shell].format(names=shlex.quote(names), words=names)
    preambles: Any = {shell: preamble}  # the library's annotation knows texts alone
    return str(shtab.complete(parser, shell, preamble=preambles)).rstrip("\n")


def known_aircraft() -> list[str]:
    """Return the names of the aircraft under aircraft/."""
    folder = PROJECT_ROOT / "aircraft"
    return sorted(path.name for path in folder.iterdir() if (path / f"{path.name}.xml").is_file())


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield the arguments of a parser and of all its commands."""
    for action in parser._actions:
        if not isinstance(action, argparse._SubParsersAction):
            yield action
    for command in commands_of(parser).values():
        yield from _actions(command)


def _completer(action: argparse.Action) -> Mapping[str, str] | None:
    """Return the completion of an argument by shell; None where its choices are enough."""
    if action.metavar in ("AIRCRAFT", "A", "B"):
        return dict.fromkeys(SHELLS, "_uqharness_aircraft")
    if action.type is not Path and not getattr(action.type, "is_file", False):
        return None
    completion = shtab.DIRECTORY if str(action.metavar).startswith("DIR") else shtab.FILE
    return {shell: str(completion[shell]) for shell in SHELLS}
