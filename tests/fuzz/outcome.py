"""What a target says: a result, or a refusal whose text is judged as a reader would."""

from __future__ import annotations

import contextlib
import io
import re
import sys
import unicodedata
from collections.abc import Callable
from functools import lru_cache
from typing import Any

_MAX_CHARACTERS = 2500
_MAX_LINES = 60
# Overrides of the writing direction: what is printed then reads as something else.
_BIDI = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")


class Refused(Exception):
    """The program's own error; its text is what a user reads."""


def command(words: str, *arguments: str) -> None:
    """Run a command of the command line in this process: its words, and arguments as they are.

    Raises Refused for exit code 2; whatever else it raises is a finding.
    """
    from uqharness.cli import main as cli

    result = _parser()
    cli.build_parser = lambda: result  # made once: a parser costs more than most inputs
    out, err = (
        io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True) for _ in range(2)
    )
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code: Any = cli.main([*words.split(), *arguments])
        except SystemExit as left:  # argparse; a fixed command line cannot be at fault
            code = left.code
    reports, output = (stream.buffer.getvalue().decode("utf-8", "replace") for stream in (out, err))
    if odd := control_characters(reports + output):
        raise AssertionError(f"prints control characters {odd}")
    if code == 2:
        raise Refused(output)
    if code not in (0, 1):
        raise AssertionError(f"exit code {code}")


@lru_cache(maxsize=1)
def _parser() -> Any:
    from uqharness.cli.main import build_parser

    return build_parser()


def call(
    function: Callable[..., Any], *arguments: Any, specific: tuple[type[Exception], ...] = ()
) -> Any:
    """The function's answer. Raises Refused for the errors that its layer promises (``own`` adds
    some).
    """
    from sysid.errors import LogError
    from uqharness.errors import BadInputError

    try:
        return function(*arguments)
    except (LogError, BadInputError, *specific) as error:
        raise Refused(_printed(str(error))) from None


def _printed(text: str) -> str:
    """The text as the command line would print it."""
    from sysid.display import visible

    return visible(text)


# A command that works for more than 5 s says so before it refuses.
_HEARTBEAT = re.compile(r"uqharness [a-z -]+: (\d+:)+\d\d")


def faults(text: str, places: tuple[str, ...]) -> str:
    """What is wrong with the text of a refusal, "" if nothing: it names one of ``places`` and can
    be read.
    """
    lines = [
        line
        for line in text.strip().splitlines()
        if not line.startswith("note: ") and not _HEARTBEAT.match(line)
    ]
    if not lines:
        return "says nothing"
    if odd := control_characters(text):
        return f"control characters {odd}"
    if "Traceback" in text:
        return "a traceback"
    if len(lines) > _MAX_LINES or max(map(len, lines)) > _MAX_CHARACTERS:
        return f"{len(lines)} lines of up to {max(map(len, lines))} characters"
    listed = [any(place in line for place in places) for line in lines]
    if not any(listed):
        return f"names no file: {lines[0][:200]}"
    if len(lines) > 1 and not all(
        listed[:-1] if re.fullmatch(r"and \d+ more", lines[-1]) else listed
    ):
        return f"is more than a sentence: {' | '.join(lines)[:300]}"
    return ""


def control_characters(text: str) -> str:
    """Those in ``text`` that a terminal would act on, as their names; "" for none."""
    odd = {
        c
        for c in text
        if (unicodedata.category(c) in ("Cc", "Cs") and c not in "\n\t") or c in _BIDI
    }
    return ", ".join(sorted(f"U+{ord(c):04X}" for c in odd))


def stop_colour() -> None:
    """No library may take the worker for a terminal."""
    sys.stdin = io.StringIO()


@lru_cache(maxsize=1)
def known_verbs() -> frozenset[str]:
    """Verbs of ``campaign``."""
    from uqharness.cli.main import commands_of

    campaign = commands_of(_parser())["campaign"]
    campaign.complete()
    return frozenset(commands_of(campaign))
