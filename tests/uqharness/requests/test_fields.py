"""Every field of every request refuses a wrong type, NaN, a number out of bounds and an unknown
name, with the same sentence from the command line, a settings file and Python.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from uqharness.cli import main as cli
from uqharness.cli.main import Command, commands_of
from uqharness.cli.request_command import add_request, request_of
from uqharness.errors import BadInputError
from uqharness.requests.base import (
    PYTHON,
    Request,
    base_type,
    check,
    choices_of,
    flag_of,
    kind_of,
    options_of,
    read_section,
    sentence,
)

FILE = Path("settings.toml")


def _models(parser: argparse.ArgumentParser) -> Iterator[tuple[str, type[Request]]]:
    for command in commands_of(parser).values():
        model = command.get_default("model")
        if model is not None:
            yield model.command, model
        yield from _models(command)


MODELS = dict(_models(cli.complete_parser()))
FIELDS = [(words, name) for words, model in MODELS.items() for name in options_of(model)]


def _bound(info: Any, *names: str) -> float | None:
    return next(
        (
            float(getattr(item, name))
            for item in info.metadata
            for name in names
            if getattr(item, name, None) is not None
        ),
        None,
    )


# What the rules between fields and the endings of files require besides.
SOUND: dict[str, dict[str, Any]] = {"diff": {"speed_mps": (22.0,)}, "log import": {"out": "x.csv"}}


def _valid(model: type[Request]) -> dict[str, Any]:
    """Return a value for each required field, a file with an ending that the request takes."""
    # What a rule over several fields needs.
    more: dict[str, dict[str, Any]] = {
        "diff": {"speed_mps": (20.0,)},
        "sensitivity": {"folder": "x"},
    }
    for ending in ("", ".parquet", ".toml", ".html"):
        values = _values(model, f"x{ending}") | more.get(model.command, {})
        try:
            check(model, values, PYTHON)
        except BadInputError:
            continue
        return values
    raise AssertionError(f"no values for {model.__name__}")


def _values(model: type[Request], file: str) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name, (info, _) in options_of(model).items():
        if info.is_required():
            base, allowed = base_type(info.annotation), choices_of(info)
            lowest = _bound(info, "gt", "ge")
            values[name] = (
                allowed[0]
                if allowed
                else (1.0 if lowest is None else lowest + 1.0)
                if base is float
                else int(lowest or 0) + 1
                if base is int
                else (file,)
                if base is tuple
                else file
            )
    return values | SOUND.get(model.command, {})


def _message_of(info: Any) -> list[Any]:
    """Return values that a field must refuse."""
    base = base_type(info.annotation)
    if "Path" in str(info.annotation) and base is not Path:
        # A word of a list, or any file.
        return [3]
    if choices_of(info):
        return ["no-such-choice", 17]
    if base in (float, int):
        low, above = _bound(info, "ge"), _bound(info, "gt")
        high, below = _bound(info, "le"), _bound(info, "lt")
        outside = [
            *([low - 1] if low is not None else []),
            *([above] if above is not None else []),
            *([high + 1] if high is not None else []),
            *([below] if below is not None else []),
        ]
        return ["abc", math.nan, *(int(x) if base is int else x for x in outside)]
    if base is bool:
        return ["yes", 2]
    if base is Path:
        return [3, ""]
    return [3] if base is dict else []


def _python(model: type[Request], name: str, value: Any) -> str:
    with pytest.raises(BadInputError) as raised:
        check(model, {**_valid(model), name: value}, PYTHON)
    return str(raised.value)


def _words(model: type[Request], name: str, value: Any) -> str:
    parser = Command(prog="uqharness x")
    add_request(parser, model)
    words = []
    for field, (info, option) in options_of(model).items():
        if not option.cli or (field != name and not info.is_required()):
            continue
        chosen = value if field == name else _valid(model)[field]
        texts = [str(v) for v in (chosen if isinstance(chosen, tuple) else (chosen,))]
        words += texts if option.flag == "" else [f"{flag_of(field, option)}={texts[0]}"]
    with pytest.raises(BadInputError) as raised:
        request_of(model, parser.parse_args(words))
    return str(raised.value)


def _section(model: type[Request], section: Mapping[str, Any], also: Mapping[str, Any]) -> str:
    with pytest.raises(BadInputError) as raised:
        read_section(model, section, heading="[x]", line=lambda key: (FILE, 7), also=also)
    return str(raised.value)


def _without_python(message: str) -> str:
    """Return a sentence about a Python argument as a settings file has it."""
    return message.replace("True or False", "true or false").replace(", as a str or a Path,", "")


def test_documented_types_and_sentences():
    engine = options_of(MODELS["campaign run"])["engine"]
    assert kind_of(*engine) == '{"auto", "batch", "jsbsim"}, optional'
    assert "repeatable" not in sentence(options_of(MODELS["margins"])["loop"][0])
    parser = Command(prog="uqharness x")
    add_request(parser, MODELS["margins"])
    assert "(default: all); repeatable" in " ".join(parser.format_help().split())


@pytest.mark.parametrize(("words", "name"), FIELDS)
def test_a_wrong_value_gets_one_sentence_from_everywhere(words: str, name: str):
    model = MODELS[words]
    info, option = options_of(model)[name]
    for value in _message_of(info):
        message = _python(model, name, value)
        label, _, allowed = message.partition(": ")
        assert label.startswith(f"{name} = ")
        assert allowed
        if option.toml:
            also = {k: v for k, v in _valid(model).items() if k != name}
            from_file = _section(model, {option.key or name: value}, also)
            assert from_file.startswith(f"{FILE}:7: [x] {option.key or name} = ")
            assert from_file.endswith(f": {_without_python(allowed)}")
        # The command line knows texts alone: any path is one, and a flag has no value.
        is_word = isinstance(value, str | int | float) and base_type(info.annotation) not in (
            bool,
            Path,
            dict,
        )
        is_word = is_word and "Path" not in str(info.annotation)
        if option.cli and is_word:
            from_words = _words(model, name, value)
            assert from_words.startswith(f"{flag_of(name, option)} ")
            assert from_words.endswith(f": {allowed}")


@pytest.mark.parametrize("words", MODELS)
def test_an_unknown_name_is_refused_everywhere_with_the_closest(words: str):
    model = MODELS[words]
    names = [name for name, (_, o) in options_of(model).items() if o.python]
    if names:
        typo = names[-1] + "z"
        with pytest.raises(BadInputError, match=f"^{typo}: unknown; did you mean "):
            check(model, {**_valid(model), typo: 1}, PYTHON)
    message = _section(model, {"no_such_key": 1}, _valid(model))
    assert message.startswith(f"{FILE}:7: [x] no_such_key: unknown; ")


def test_the_command_line_refuses_what_it_does_not_know(capsys: pytest.CaptureFixture[str]):
    words = ["bounds", "espaaro", "--flight", "f.csv", "--confidnce", "0.9"]
    assert cli.main(words) == 2
    assert "--confidnce: unknown; did you mean --confidence?" in capsys.readouterr().err
