"""A command that is defined by its request: its options, its run and what it prints."""

from __future__ import annotations

import argparse
import importlib
import json
import logging
import os
import sys
from pathlib import Path
from typing import Any, TypeVar

from uqharness.heartbeat import QUIET_VARIABLE, Forecast, forecast_shown
from uqharness.requests.base import (
    Option,
    Place,
    Request,
    base_type,
    check,
    choices_of,
    flag_of,
    item_type,
    options_of,
)

# The command line of a request: argparse's options from its fields, and the request from words.
#
# The words of the command line are converted by the type of their field; what cannot be
# converted is left as it is, and the request's own check explains it.

Model = TypeVar("Model", bound=Request)


def _as_written(label: str, value: object) -> str:
    """Return an option with its words as the user wrote them."""
    several = value if isinstance(value, list | tuple) else [value]
    return " ".join([label, *map(str, several)])


WORDS = Place(flag_of, _as_written, lambda field_option: field_option.cli)


def add_request(parser: argparse.ArgumentParser, model: type[Request]) -> None:
    """Add a request's fields as arguments, and its help page."""
    answers = f"0 {model.done}, 1 {model.no}" if model.no else f"0 {model.done}"
    parser.description = " ".join((model.__doc__ or "").split())
    parser.epilog = (
        f"examples:\n{model.examples.strip(chr(10))}\n\n"
        f"Exit codes: {answers}, 2 bad input, 130 interrupted."
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    for name, (info, field_option) in options_of(model).items():
        if field_option.cli:
            _add_field(parser, name, info, field_option)
    output = parser.add_mutually_exclusive_group()
    output.add_argument("--json", action="store_true", help="print the result as JSON")
    output.add_argument("--quiet", action="store_true", help="print nothing but errors")


def _add_field(parser: argparse.ArgumentParser, name: str, info: Any, field_option: Option) -> None:
    """Add one field as an argument of the parser."""
    base = base_type(info.annotation)
    text = field_option.help or info.description or ""
    # A percent sign is a format in argparse.
    settings: dict[str, Any] = {"help": text.replace("%", "%%")}
    if base is bool:
        settings["action"] = "store_false" if field_option.off else "store_true"
    else:
        settings["metavar"] = field_option.metavar
        allowed = choices_of(info)
        settings["choices"] = None if allowed is None else tuple(map(str, allowed))
        # The completion offers files where the type is a path.
        metavar = field_option.metavar or ""
        settings["type"] = _Text(base is Path or "FILE" in metavar or ".toml" in metavar)
        if field_option.many:
            settings |= {"nargs": "+", "action": "extend"}
        elif field_option.repeat:
            settings["action"] = "append"
            settings["help"] += "; repeatable"
        default = None if info.is_required() else info.get_default(call_default_factory=True)
        if default not in (None, (), {}, ""):
            shown = f"{default:g}" if isinstance(default, float) else str(default)
            settings["help"] += f" (default {shown})"
    if field_option.flag == "":
        positional = {key: settings[key] for key in ("metavar", "help", "choices", "type")}
        if field_option.many:
            positional["nargs"] = "+" if info.is_required() else "*"
        elif not info.is_required():
            positional["nargs"] = "?"
        parser.add_argument(name, default=argparse.SUPPRESS, **positional)
    else:
        parser.add_argument(
            flag_of(name, field_option),
            dest=name,
            default=argparse.SUPPRESS,
            required=info.is_required(),
            **settings,
        )


class _Text:
    """argparse's type of a field: the text as it is; ``is_file`` decides its completion."""

    def __init__(self, is_file: bool) -> None:
        self.is_file = is_file

    def __call__(self, text: str) -> str:
        return text


def request_of(model: type[Model], args: argparse.Namespace) -> Model:
    """Return the request of parsed words. Raises BadInputError, naming the option."""
    texts = {name: getattr(args, name) for name in options_of(model) if hasattr(args, name)}
    values = {name: _value(model, name, text) for name, text in texts.items() if text is not None}
    return check(model, values, WORDS, texts)


def _value(model: type[Request], name: str, text: Any) -> Any:
    """Convert words by the field's type; what cannot be converted is returned as it is."""
    info, _field_option = options_of(model)[name]
    base = base_type(info.annotation)
    if base in (float, int):
        return _number(base, text)
    if base is dict and isinstance(text, list):
        return _mapping(text)
    if not isinstance(text, list):
        return text
    # Repeated options with one value each, or one option with several.
    item = item_type(info.annotation)
    return tuple(_number(item, word) if item in (float, int) else word for word in text)


def _number(base: Any, text: Any) -> Any:
    """Convert a word to a number; one that is none is returned as it is."""
    try:
        return base(text)
    except ValueError:
        return text


def _mapping(pairs: list[str]) -> Any:
    """Convert ``NAME=VALUE`` words to a mapping; a word without = is returned for the message."""
    values: dict[str, Any] = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not equals or not name:
            return pair
        try:
            values[name] = float(value)
        except ValueError:
            values[name] = value
    return values


def add_request_command(parser: argparse.ArgumentParser, request: str, function: str) -> None:
    """Add the options of a command's request, and what runs it.

    ``request`` and ``function`` are ``module:name`` within uqharness.requests and
    uqharness.commands.
    """
    model = _part("uqharness.requests", request)
    add_request(parser, model)

    def run(args: argparse.Namespace) -> int:
        """Run the command; return its exit code."""
        # The library of progress bars is slow to load, and no help page needs it.
        from uqharness.cli.progress import ProgressView, print_warnings, working

        # Notes are log records, which --quiet leaves out as well.
        logging.getLogger("uqharness").setLevel(logging.WARNING if args.quiet else logging.INFO)
        if args.quiet:
            os.environ[QUIET_VARIABLE] = "1"
        values = request_of(model, args)
        # Loading takes seconds: a forecast made here is shown in the first line of progress.
        durations = values.expected_s()
        with forecast_shown(Forecast(durations) if durations else None):
            run_request = _part("uqharness.commands", function)
        if model.flies:
            with ProgressView() as view:
                outcome = run_request(values, view.update)
        else:
            with working(model.command, _segments_flown, keep=model.keeps_stages) as callback:
                outcome = run_request(values, callback)
        if not args.quiet:
            print_warnings(outcome.warnings)
        if args.json:
            print(json.dumps(outcome.as_json()))
        elif not args.quiet:
            print(outcome.text())
        return int(outcome.code)

    parser.set_defaults(handler=run, parser=parser, model=model)


def _part(package: str, place: str) -> Any:
    """Return the object that ``module:name`` names within a package, or by its full name."""
    module, _, name = place.partition(":")
    path = module if module.startswith("uqharness.") else f"{package}.{module}"
    return getattr(importlib.import_module(path), name)


def _segments_flown() -> int:
    """Return the number of segments that replays have flown; 0 where none was loaded."""
    replay = sys.modules.get("uqharness.replay.simulation")
    return 0 if replay is None else int(replay.counter["segments"])
