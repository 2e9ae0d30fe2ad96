"""Options that commands share: limits, words that repeat a command, one spelling and one help text
each.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from uqharness.cli.main import (
    Command,
    RequestCommand,
    build_parser,
    commands_of,
    complete_parser,
    run_words,
)
from uqharness.cli.request_command import request_of
from uqharness.errors import BadInputError
from uqharness.files import results_folder
from uqharness.requests.base import command_line, command_words
from uqharness.requests.identification import BoundsRequest


def leaves(parser: argparse.ArgumentParser) -> list[argparse.ArgumentParser]:
    """Parsers of all commands, verbs in place of the command that has them."""
    below = commands_of(parser).values()
    return [leaf for child in below for leaf in leaves(child)] or [parser]


@pytest.fixture(scope="module")
def commands() -> list[argparse.ArgumentParser]:
    return leaves(complete_parser())


def made(*words: str) -> BoundsRequest:
    return request_of(BoundsRequest, build_parser().parse_args(words))


def test_the_words_that_repeat_a_command_name_files_and_leave_out_defaults() -> None:
    request = made(
        "bounds",
        "espaaro",
        "--flight",
        "a/x.bin",
        "b/y.bin",
        "--out",
        "here",
        "--json",
        "--order",
        "2",
        "--no-check",
    )
    assert command_line(request) == "uqharness bounds espaaro --flight x.bin y.bin --no-check"


def test_a_repeated_option_is_repeated_and_the_words_are_those_of_the_same_command() -> None:
    given = (
        "bounds",
        "espaaro",
        "--flight",
        "x.bin",
        "--states",
        "CX=V",
        "--states",
        "Cm=alpha,q",
        "--out",
        "o",
    )
    words = command_words(made(*given))
    assert words.count("--states") == 2
    again = made(*words[1:], "--out", "o")
    assert (again.states, again.flights) == ({"CX": ("V",), "Cm": ("alpha", "q")}, (Path("x.bin"),))


def test_a_folder_that_cannot_be_made_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInputError, match="cannot be made"):
        results_folder(tmp_path / "file" / "below")
    assert results_folder(tmp_path / "a" / "b").is_dir()


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
        "--json",
        "--no-figures",
        "--map",
        "--manoeuvres",
        "--servos",
        "--biases",
        "--delays",
        "--hours",
        "--samples",
        "--yes",
    )
    told: dict[str, set[str]] = {}
    for parser in commands:
        for action in parser._actions:
            for name in action.option_strings:
                text = str(action.help).replace("%(default)s", str(action.default))
                told.setdefault(name, set()).add(text)
    for name in shared:
        assert len(told[name]) == 1, (name, told[name])
    assert "--no-check" in told
    assert "--no-checks" not in told
    assert len(told["--seed"]) > 1  # says what it seeds: the comparison sees a difference


@pytest.mark.parametrize(
    "words",
    [
        ("identify", "--flight", "f"),
        ("compare", "--flight", "f"),
        ("study",),
        ("refine", "--train", "a", "--test", "b"),
    ],
)
def test_no_workers_are_refused_wherever_they_are_asked_for(words: tuple[str, ...]) -> None:
    with pytest.raises(BadInputError, match="--workers 0: a whole number of at least 1 is needed"):
        run_words([words[0], "thing", *words[1:], "--out", "o", "--workers", "0"])


def test_a_parser_is_completed_once() -> None:
    parser = Command(prog="uqharness report")
    parser.entry = RequestCommand("folders:ReportRequest", "folders:report", "")
    parser.complete()
    before = len(parser._actions)
    parser.complete()
    assert len(parser._actions) == before
    assert parser.parse_args(["results"]).folder == "results"
