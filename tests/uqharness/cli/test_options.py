"""Options that commands share: limits, words that repeat a command, one spelling and one help text
each.
"""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path

import pytest

from uqharness.cli.main import (
    build_parser,
    commands_of,
    complete_parser,
)
from uqharness.cli.request_command import request_of
from uqharness.requests.base import command_words
from uqharness.requests.identification import BoundsRequest


def leaves(parser: argparse.ArgumentParser) -> list[argparse.ArgumentParser]:
    """Parsers of all commands, verbs in place of the command that has them."""
    below = commands_of(parser).values()
    return [leaf for child in below for leaf in leaves(child)] or [parser]


@pytest.fixture(scope="module")
def commands() -> list[argparse.ArgumentParser]:
    return leaves(complete_parser())


def build(*words: str) -> BoundsRequest:
    return request_of(BoundsRequest, build_parser().parse_args(words))


def test_a_repeated_option_is_repeated_and_the_words_are_those_of_the_same_command() -> None:
    inputs = (
        *shlex.split("bounds espaaro --flight x.bin --states CX=V --states Cm=alpha,q --out o"),
    )
    words = command_words(build(*inputs))
    assert words.count("--states") == 2
    repeat = build(*words[1:], "--out", "o")
    assert (repeat.states, repeat.flights) == (
        {"CX": ("V",), "Cm": ("alpha", "q")},
        (Path("x.bin"),),
    )


def test_every_command_has_examples_json_and_exit_codes(
    commands: list[argparse.ArgumentParser],
) -> None:
    assert len(commands) >= 25
    for parser in commands:
        text = str(parser.epilog)
        assert f"\n  {parser.prog} " in text, parser.prog
        assert text.count("Exit codes: 0 ") == 1, parser.prog
        assert text.endswith(", 2 bad input, 130 interrupted."), parser.prog
        assert "--json" in parser.format_help()
        assert parser.get_default("handler") is not None


def test_an_option_means_the_same_in_every_command(commands: list[argparse.ArgumentParser]) -> None:
    shared = (
        *shlex.split(
            "--json --no-figures --map --manoeuvres --servos --biases --delays --hours --samples --yes"
        ),
    )
    reports: dict[str, set[str]] = {}
    for parser in commands:
        for action in parser._actions:
            for name in action.option_strings:
                text = str(action.help).replace("%(default)s", str(action.default))
                reports.setdefault(name, set()).add(text)
    for name in shared:
        assert len(reports[name]) == 1, (name, reports[name])
    assert "--no-check" in reports
    assert "--no-checks" not in reports
    assert len(reports["--seed"]) > 1  # says what it seeds: the comparison sees a difference
