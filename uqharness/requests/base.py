"""Requests: what a command, a section of a settings file and a Python function take.

A request is a pydantic model with one field for each option. The field's type, bounds, default and
sentence are written once; this module derives from them the keywords and the documentation of the
Python function (`accepts`), the values of a settings file's section (`read_section`), the command
that repeats a result (`command_words`) and the message about a wrong value, which is the same from
all three. `uqharness.cli.request_command` derives the options of the command line.
"""

from __future__ import annotations

import difflib
import functools
import inspect
import math
import os
import re
import reprlib
import shlex
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from uqharness.errors import BadInputError

R = TypeVar("R")
Model = TypeVar("Model", bound="Request")

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 80
_LIMITS = {"gt": "above", "ge": "of at least", "lt": "below", "le": "up to"}


@dataclass(frozen=True)
class Option:
    """How a field is written on the command line, in a settings file and in Python.

    Attributes
    ----------
    flag : str or None
        Option of the command line; None derives it from the field's name, "" makes the field a
        positional argument.
    metavar : str or None
        Placeholder of the value in the help.
    key : str or None
        Key in a settings file; None takes the field's name.
    needed : str
        What is allowed, for messages, such as "a path"; "" derives it from type and bounds.
    help : str
        Sentence of the command line where it differs, as for an option that sets False.
    kind : str
        Type in the documentation of the Python function; "" derives it.
    many, repeat : bool
        Whether the option takes several values, and whether it may be repeated with one value each.
    positional : bool
        Whether the Python function takes the field without its keyword.
    write : callable or None
        Value to its word on the command line, where `command_words` cannot derive it.
    off : bool
        Whether the option of the command line sets the field to False, as ``--no-check`` does.
    cli, toml, python : bool
        Whether the command line, settings files and Python functions have the field.
    provenance : bool
        Whether the command stored with a result repeats it.
    """

    flag: str | None = None
    metavar: str | None = None
    key: str | None = None
    needed: str = ""
    help: str = ""
    kind: str = ""
    many: bool = False
    repeat: bool = False
    positional: bool = False
    write: Callable[[Any], str] | None = None
    off: bool = False
    cli: bool = True
    toml: bool = True
    python: bool = True
    provenance: bool = True


def option(
    default: Any,
    description: str,
    *,
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
    **how: Any,
) -> Any:
    """Return the definition of a request's field.

    Parameters
    ----------
    default : Any
        Default value; ``...`` for a required field.
    description : str
        One sentence without a full stop: meaning and unit.
    gt, ge, lt, le : float, optional
        Bounds of a number.
    **how
        Attributes of `Option`.
    """
    bounds = {
        name: bound
        for name, bound in (("gt", gt), ("ge", ge), ("lt", lt), ("le", le))
        if bound is not None
    }
    info = Field(default, description=description, **bounds)  # type: ignore[call-overload]
    info.metadata.append(Option(**how))
    return info


# Types of fields. A before-validator accepts what numpy and pathlib give; pydantic checks bounds.


def _real(value: Any) -> Any:
    """Return a real number as float; anything else unchanged, which pydantic refuses."""
    # Booleans are integers in Python; True is no number of a request.
    if isinstance(value, Real) and not isinstance(value, bool):
        return float(value)
    return value


def _integral(value: Any) -> Any:
    """Return a whole number as int; anything else unchanged, which pydantic refuses."""
    if isinstance(value, Integral) and not isinstance(value, bool):
        return int(value)
    return value


def _boolean(value: Any) -> Any:
    """Return numpy's boolean as bool."""
    return bool(value) if type(value).__name__ in ("bool_", "bool") else value


def _path(value: Any) -> Any:
    """Return a non-empty text or path object as Path."""
    return Path(value) if isinstance(value, str | os.PathLike) and os.fspath(value) else value


def split_names(value: Any) -> Any:
    """Return names as a tuple: a text is split at its commas, ``none`` is no name.

    Examples
    --------
    >>> split_names("p, q"), split_names(["p"]), split_names("none")
    (('p', 'q'), ('p',), ())
    """
    if isinstance(value, str):
        names = tuple(part.strip() for part in value.split(",") if part.strip())
        return () if names == ("none",) else names
    return _as_tuple(value)


def _as_tuple(value: Any) -> Any:
    """Return several values as a tuple; mappings, texts and single objects unchanged."""
    several = isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping)
    return tuple(value) if several else value


def one_or_several(value: Any) -> Any:
    """Return one text, path or object as a tuple of one, several as a tuple."""
    several = _as_tuple(value)
    return several if isinstance(several, tuple) else (several,)


Number = Annotated[float, BeforeValidator(_real), Field(allow_inf_nan=False)]
WholeNumber = Annotated[int, BeforeValidator(_integral)]
Flag = Annotated[bool, BeforeValidator(_boolean)]
FilePath = Annotated[Path, BeforeValidator(_path)]
Names = Annotated[tuple[str, ...], BeforeValidator(split_names)]
Files = Annotated[tuple[FilePath, ...], BeforeValidator(one_or_several), Field(min_length=1)]


class Request(BaseModel):
    """Base of all requests: immutable, without unknown fields and without type conversion.

    Class attributes describe the command: ``command`` its words after ``uqharness``, ``examples``
    command lines and what they write, ``done`` and ``no`` the meaning of exit codes 0 and 1,
    ``keeps_stages`` whether a terminal keeps a line of each finished stage, ``flies`` whether the
    command's callback takes the progress of a campaign instead of the names of stages. The
    docstring is the command's description.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, arbitrary_types_allowed=True, defer_build=True
    )

    command: ClassVar[str] = ""
    examples: ClassVar[str] = ""
    done: ClassVar[str] = "done"
    no: ClassVar[str] = ""
    keeps_stages: ClassVar[bool] = False
    flies: ClassVar[bool] = False

    def expected_s(self) -> Mapping[str, float]:
        """Return the expected duration [s] of each stage, before anything is loaded; empty where
        nobody can say.
        """
        return {}

    @classmethod
    def of(cls, **values: Any) -> Self:
        """Return the request with these values. Raises BadInputError, naming the keyword."""
        return check(cls, values, PYTHON)

    def changed(self, **values: Any) -> Self:
        """Return a copy with other values. Raises BadInputError."""
        current = {name: getattr(self, name) for name in self.model_fields_set}
        return type(self).of(**(current | values))


def options_of(model: type[Request]) -> dict[str, tuple[FieldInfo, Option]]:
    """Return the fields of a request by name, with their options."""
    return {
        name: (info, next((m for m in info.metadata if isinstance(m, Option)), Option()))
        for name, info in model.model_fields.items()
    }


def flag_of(name: str, field_option: Option) -> str:
    """Return the option of the command line, or the metavar of a positional argument."""
    if field_option.flag == "":
        return field_option.metavar or name.upper()
    return field_option.flag or f"--{name.replace('_', '-')}"


# Messages. A place knows how fields are called there.


@dataclass(frozen=True)
class Place:
    """Where values come from, for messages: how a field is called, and its value written.

    Attributes
    ----------
    label : callable
        (field name, Option) to the name that the user knows.
    assignment : callable
        (label, received value) to the beginning of a message.
    has : callable
        Whether the place has a field.
    python : bool
        Whether values are Python objects: ``True``, and paths of several types.
    """

    label: Callable[[str, Option], str]
    assignment: Callable[[str, object], str]
    has: Callable[[Option], bool]
    python: bool = False


def received_text(value: object) -> str:
    """Return a value for a message, abbreviated."""
    return str(value) if isinstance(value, Real) else _SHORT.repr(value)


PYTHON = Place(
    lambda name, _: name,
    lambda label, value: f"{label} = {received_text(value)}",
    lambda field_option: field_option.python,
    python=True,
)


def check(
    model: type[Model],
    values: Mapping[str, Any],
    place: Place,
    received: Mapping[str, Any] | None = None,
) -> Model:
    """Return the validated request; ``received`` are the values as the user wrote them.

    Raises BadInputError with one sentence for each wrong value: the field as the place calls it,
    what was received, and what is allowed.
    """
    try:
        return model.model_validate(dict(values))
    except ValidationError as error:
        lines = [message for _, message in messages(model, error, received or values, place)]
        raise BadInputError(*dict.fromkeys(lines)) from None


def messages(
    model: type[Request], error: ValidationError, values: Mapping[str, Any], place: Place
) -> Iterator[tuple[str, str]]:
    """Yield the field ("" for the whole request) and the message of each of pydantic's errors."""
    options = options_of(model)
    labels = {name: place.label(name, o) for name, (_, o) in options.items()}
    for item in error.errors():
        name = str(item["loc"][0]) if item["loc"] else ""
        if item["type"] == "extra_forbidden":
            yield name, unknown_name(name, options, place)
            continue
        text = item["msg"].removeprefix("Value error, ")
        # Validators name other fields as {field}, which every place calls differently.
        text = re.sub(r"\{(\w+)\}", lambda match: labels.get(match[1], match[1]), text)
        if not name:
            yield "", text
            continue
        info, field_option = options[name]
        beginning = place.assignment(labels[name], values.get(name, item["input"]))
        missing = item["type"] == "missing"
        yield (
            name,
            problem(
                item["type"],
                text,
                info,
                labels[name] if missing else beginning,
                field_option,
                place.python,
            ),
        )


def problem(
    kind: str,
    text: str,
    info: FieldInfo,
    beginning: str,
    field_option: Option | None = None,
    python: bool = False,
) -> str:
    """Return the message of one of pydantic's errors about a field.

    Parameters
    ----------
    kind, text : str
        Type of the error, and what a validator says.
    info : FieldInfo
        The field.
    beginning : str
        The field with the received value; the field alone if the value is missing.
    field_option : Option, optional
        How the field is written.
    python : bool
        As in `Place`.
    """
    needed = requirement(info, field_option or Option(), python)
    if kind == "missing":
        return f"{beginning}: required; {needed} is needed"
    if kind in ("value_error", "assertion_error"):
        return f"{beginning}: {text}"
    allowed = choices_of(info)
    if allowed is not None:
        return f"{beginning}: allowed are {', '.join(map(str, allowed))}"
    return f"{beginning}: {needed} is needed"


def unknown_name(name: str, options: Mapping[str, tuple[FieldInfo, Option]], place: Place) -> str:
    """Return the message about a field that a request does not have."""
    allowed = [place.label(n, o) for n, (_, o) in options.items() if place.has(o)]
    return f"{name}: {unknown_among(name, allowed)}"


def unknown_among(name: str, allowed: Sequence[str], kind: str = "") -> str:
    """Return what a message says of an unknown name: the closest one, and all that are allowed.

    Examples
    --------
    >>> unknown_among("confidnce", ["confidence", "order"])
    'unknown; did you mean confidence? allowed: confidence, order'
    """
    close = difflib.get_close_matches(name, allowed, n=1, cutoff=0.5)
    hint = f"did you mean {close[0]}? " if close else ""
    return f"{f'unknown {kind}'.strip()}; {hint}allowed: {', '.join(allowed)}"


def requirement(info: FieldInfo, field_option: Option, python: bool = False) -> str:
    """Describe what a field takes, such as "a number above 0 and below 1"; ``python`` names the
    values as Python writes them.
    """
    if field_option.needed:
        return field_option.needed
    base = base_type(info.annotation)
    bounds = [
        f"{_LIMITS[attribute]} {bound if isinstance(bound, int) else f'{bound:g}'}"
        for attribute in ("gt", "ge", "lt", "le")
        for item in info.metadata
        if (bound := getattr(item, attribute, None)) is not None
    ]
    pattern = next((m.pattern for m in info.metadata if getattr(m, "pattern", None)), None)
    noun = {
        float: "a finite number" if not bounds else "a number",
        int: "a whole number",
        bool: "True or False" if python else "true or false",
        Path: "a path, as a str or a Path," if python else "a path",
        str: "a text" if pattern is None else f"a text of the form {pattern}",
        dict: "a mapping",
    }.get(base, "another value")
    if base is tuple:
        arguments = typing.get_args(_bare(info.annotation))
        items = "number" if item_type(info.annotation) in (float, int) else "name"
        fixed = arguments and Ellipsis not in arguments
        noun = f"a list of {len(arguments)} {items}s" if fixed else f"a {items} or several"
    elif isinstance(base, type) and issubclass(base, BaseModel):
        noun = "a section"
    return " ".join([noun, " and ".join(bounds)]).strip()


def base_type(annotation: Any) -> Any:
    """Return the type under Annotated and Optional: float, int, bool, Path, str, tuple, dict."""
    annotation = _bare(annotation)
    origin = typing.get_origin(annotation)
    return type(typing.get_args(annotation)[0]) if origin is Literal else origin or annotation


def item_type(annotation: Any) -> Any:
    """Return the base type of a tuple's items."""
    return base_type((*typing.get_args(_bare(annotation)), str)[0])


def _bare(annotation: Any) -> Any:
    """Return the type under Annotated and Optional, with its arguments."""
    while (origin := typing.get_origin(annotation)) in (Annotated, typing.Union, types.UnionType):
        arguments = typing.get_args(annotation)
        annotation = (
            arguments[0]
            if origin is Annotated
            else next(a for a in arguments if a is not type(None))
        )
    return annotation


def choices_of(info: FieldInfo) -> tuple[Any, ...] | None:
    """Return the values of a Literal; None for other types."""
    annotation = info.annotation
    if base_type(annotation) is dict:
        return None
    for part in (annotation, *typing.get_args(annotation)):
        if typing.get_origin(part) is Literal:
            return typing.get_args(part)
    return None


# Python functions.


def accepts(model: type[Model]) -> Callable[[Callable[[Model], R]], Callable[..., R]]:
    """Decorate a function of a request to take the request's fields as arguments.

    The signature and the section "Parameters" of the docstring are written from the fields. The
    function also takes a request as its only argument.
    """
    options = {n: (i, o) for n, (i, o) in options_of(model).items() if o.python}
    positional = [name for name, (_, o) in options.items() if o.positional]

    def decorate(function: Callable[[Model], R]) -> Callable[..., R]:
        @functools.wraps(function)
        def call(*arguments: Any, **keywords: Any) -> R:
            if len(arguments) == 1 and isinstance(arguments[0], model) and not keywords:
                return function(arguments[0])
            if len(arguments) > len(positional):
                raise BadInputError(
                    f"{function.__name__}: {len(arguments)} arguments without a keyword; at most"
                    f" {len(positional)} are allowed: {', '.join(positional)}"
                )
            values = dict(zip(positional, arguments, strict=False))
            for name in values.keys() & keywords.keys():
                raise BadInputError(f"{name}: given twice, by place and by keyword")
            unknown = [name for name in keywords if name not in options]
            if unknown:
                raise BadInputError(*(unknown_name(n, options, PYTHON) for n in unknown))
            return function(check(model, values | keywords, PYTHON))

        call.__signature__ = _signature(options, function)  # type: ignore[attr-defined]
        call.__doc__ = _with_parameters(function.__doc__ or "", options)
        return call

    return decorate


def _signature(
    options: Mapping[str, tuple[FieldInfo, Option]], function: Callable[..., Any]
) -> inspect.Signature:
    """Return the signature of a Python function with the fields of a request."""
    keyword, place = inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD
    parameters = [
        inspect.Parameter(
            name,
            place if o.positional else keyword,
            default=inspect.Parameter.empty if info.is_required() else info.get_default(),
            annotation=kind_of(info, o),
        )
        for name, (info, o) in options.items()
    ]
    # Positional arguments come first, required ones before those with a default.
    parameters.sort(key=lambda p: (p.kind, p.default is not inspect.Parameter.empty))
    returned = inspect.signature(function).return_annotation
    return inspect.Signature(parameters, return_annotation=returned)


def kind_of(info: FieldInfo, field_option: Option) -> str:
    """Return a field's type as numpydoc writes it."""
    if field_option.kind:
        return field_option.kind
    allowed = choices_of(info)
    base = base_type(info.annotation)
    names = {Path: "str or Path", tuple: "str or sequence of str", dict: "Mapping"}
    name = str(names.get(base) or getattr(base, "__name__", base))
    if allowed is not None:
        name = "{" + ", ".join(repr(a).replace("'", '"') for a in allowed) + "}"
    default = None if info.is_required() else info.get_default()
    return f"{name}, optional" if default is None and not info.is_required() else name


def _with_parameters(doc: str, options: Mapping[str, tuple[FieldInfo, Option]]) -> str:
    """Insert the section "Parameters" before the docstring's first other section."""
    lines = inspect.cleandoc(doc).split("\n")
    section = ["Parameters", "----------"]
    for name, (info, o) in options.items():
        section += [f"{name} : {kind_of(info, o)}", f"    {sentence(info)}"]
    ends = [k for k, line in enumerate(lines) if k and re.fullmatch("-{3,}", line)]
    place = ends[0] - 1 if ends else len(lines)
    return "\n".join([*lines[:place], *section, "", *lines[place:]]).rstrip()


def sentence(info: FieldInfo) -> str:
    """Return a field's description as a sentence, with its default where there is one."""
    text = info.description or ""
    default = None if info.is_required() else info.get_default()
    if default not in (None, False, True, (), {}, ""):
        text += f" (default {default})"
    return text[:1].upper() + text[1:] + "."


# Settings files.


def read_section(
    model: type[Request],
    section: Mapping[str, Any],
    *,
    heading: str,
    line: Callable[[str], tuple[Path | str, int]],
    also: Mapping[str, Any] | None = None,
    own: Sequence[str] = (),
) -> dict[str, Any]:
    """Return the fields that a section of a settings file sets.

    Parameters
    ----------
    model : type of Request
        What the section describes.
    section : mapping
        Content of the section.
    heading : str
        How messages call it, such as "[bounds]".
    line : callable
        Key to file and line.
    also : mapping, optional
        Values that the file must not hold, such as the folder of the results; for the checks that
        concern several fields.
    own : sequence of str
        Keys of the section that are no field, for messages about unknown keys.

    Raises
    ------
    BadInputError
        With ``file:line: [section] key = value: what is allowed`` for each mistake.
    """
    options = options_of(model)
    also = also or {}
    keys = {o.key or n: n for n, (_, o) in options.items() if o.toml and n not in also}
    place = Place(
        lambda name, o: f"{heading} {o.key or name}",
        lambda label, value: f"{label} = {toml_text(value)}",
        lambda field_option: field_option.toml,
    )
    lines = []
    values = {}
    for key, value in section.items():
        if key in keys:
            values[keys[key]] = value
        else:
            # The name of the section is part of the label of every key.
            lines.append((key, f"{heading} {key}: {unknown_among(key, [*own, *keys])}"))
    try:
        request = model.model_validate({**also, **values})
    except ValidationError as error:
        names = {name: key for key, name in keys.items()}
        for name, message in messages(model, error, {**also, **values}, place):
            lines.append((names.get(name, name), message))
    if lines:
        located = [(*line(key), message) for key, message in lines]
        raise BadInputError(*dict.fromkeys(f"{path}:{number}: {m}" for path, number, m in located))
    return {name: getattr(request, name) for name in values}


def toml_text(value: Any) -> str:
    """Return a value as TOML writes it, abbreviated."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return f'"{value}"' if isinstance(value, str) and len(value) < 80 else received_text(value)


# The command that repeats a result.


def command_words(request: Request, full: bool = False) -> list[str]:
    """Return the command that repeats a request: file names only, no option at its default.

    Folders and pages that are written, and what only says how a command prints, are left out;
    ``full`` writes them and whole paths, for a command that is pasted into a shell.
    """
    positional, flags = [], []
    for name, (info, o) in options_of(type(request)).items():
        value = getattr(request, name)
        default = None if info.is_required() else info.get_default(call_default_factory=True)
        if not (o.cli and (o.provenance or full)) or value is None or value == default:
            continue
        words = [o.write(value)] if o.write else _words(value, full)
        if o.flag == "":
            positional += words
        elif isinstance(value, bool):
            flags.append(flag_of(name, o))
        elif o.repeat:
            # A repeatable option stands before each of its values.
            flags += [word for text in words for word in (flag_of(name, o), text)]
        elif base_type(info.annotation) is tuple and not (o.many or o.write):
            flags += [flag_of(name, o), ",".join(words) or "none"]
        else:
            flags += [flag_of(name, o), *words]
    return ["uqharness", *request.command.split(), *positional, *flags]


def command_line(request: Request, full: bool = False) -> str:
    """Return `command_words` as one shell line."""
    return shlex.join(command_words(request, full))


def _words(value: Any, full: bool) -> list[str]:
    """Return a value as words of the command line."""
    if isinstance(value, Mapping):
        return [f"{key}={','.join(_words(item, full))}" for key, item in value.items()]
    if isinstance(value, tuple | list):
        return [word for item in value for word in _words(item, full)]
    if isinstance(value, Path):
        return [str(value) if full else value.name]
    if isinstance(value, str | Real):
        return [str(value)]
    # Objects of Python have no other words.
    return [str(getattr(value, "name", type(value).__name__))]
