"""What commands say of themselves: the words that repeat them, and the stage they are at."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path

from sysid.terminal import drawing, visible


def command_as_given(args: argparse.Namespace) -> str:
    """The command as given, files by name alone: what a reader needs to make the report again. ``args.parser`` is its parser."""
    words = ["uqharness", args.command]
    for action in args.parser._actions:
        value = getattr(args, action.dest, None)
        if action.dest in ("out", "json") or value is None or value == action.default:
            continue
        words += action.option_strings[:1]
        values = value if isinstance(value, list) else [] if value is True else [value]
        words += [v.name if isinstance(v, Path) else str(v) for v in values]
    return shlex.join(words)


def show_stage(text: str) -> None:
    """The stage on a terminal's last line; nothing in a pipe."""
    if sys.stderr.isatty():
        print(f"{visible(text):<40}", end="\r", file=drawing(sys.stderr), flush=True)
