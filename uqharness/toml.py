"""TOML files: reading, and messages that name section, key, line, and what is allowed.

Settings are validated as pydantic models (`Section`). `explain` translates pydantic's errors into
line numbers and sentences about the file, which are those of requests.
"""

from __future__ import annotations

import re
import sys
import types
import typing
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from sysid.foreign.regular_files import ParseError, parse_toml, read_regular_text
from uqharness.errors import BadInputError
from uqharness.requests.base import problem, unknown_among


def read_toml(path: Path) -> tuple[dict[str, Any], str]:
    """Return content and text of a TOML file. Raises BadInputError with file and line."""
    try:
        text = read_regular_text(path)
    except UnicodeDecodeError:
        raise BadInputError(f"{path}: not a text file in UTF-8") from None
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    try:
        return parse_toml(text), text
    except ParseError as error:
        raise BadInputError(f"{path}:{error.line or 1}: {error}") from None


def explain(
    document: type[BaseModel], text: str, data: dict[str, Any], error: ValidationError
) -> list[tuple[int, str]]:
    """Return lines and sentences for pydantic's errors, in the order of the lines.

    Parameters
    ----------
    document : type of BaseModel
        Model that the data were validated with.
    text : str
        Text of the file.
    data : dict
        Its content.
    error : ValidationError
        What pydantic found.
    """
    problems = [
        (_real_path(data, item["loc"], missing_too=item["type"] == "missing"), item)
        for item in error.errors()
    ]
    # A value of several types has an error for each; those of its parts are the precise ones.
    precise = {location[:k] for location, _ in problems for k in range(len(location))}
    return sorted(
        (line_of(text, location), _sentence(document, location, item))
        for location, item in problems
        if location not in precise
    )


def _sentence(document: type[BaseModel], location: tuple[Any, ...], item: ErrorDetails) -> str:
    """Return the sentence for an error at a location of the file."""
    name = _name(location)
    if item["type"] == "extra_forbidden":
        allowed = list(_definition(document, location[:-1]).annotation.model_fields)
        kind = "section" if len(location) == 1 else "key"
        return f"{name}: {unknown_among(str(location[-1]), allowed, kind)}"
    # An echoed table would hide the sentence, which names the part that matters.
    is_key, silent = item["loc"][-1:] == ("[key]",), isinstance(item["input"], dict)
    if item["type"] != "missing" and not is_key and not silent:
        name += f" = {as_toml(item['input'])}"
    info = _definition(document, location, of_key=is_key)
    return problem(item["type"], item["msg"].removeprefix("Value error, "), info, name)


def _name(location: tuple[Any, ...]) -> str:
    """Return a location as ``[aleatory] wind_mps`` or ``[epistemic.parameters] fit``."""
    if not location:
        return "the file"
    if len(location) >= 2 and isinstance(location[1], int) and (location[0],) in _TABLES:
        return " ".join(
            [f"[[{location[0]}]] number {location[1] + 1}", dotted(location[2:])]
        ).strip()
    if len(location) >= 2 and (location[0], location[1]) in _SUBSECTIONS:
        depth = _SUBSECTIONS[location[0], location[1]]
        return " ".join([f"[{dotted(location[:depth])}]", dotted(location[depth:])]).strip()
    return " ".join([f"[{dotted(location[:1])}]", dotted(location[1:])]).strip()


def dotted(parts: tuple[Any, ...]) -> str:
    """Return the parts of a key as TOML writes them.

    Examples
    --------
    >>> dotted(("uq/scale/Cmq", "initial"))
    '"uq/scale/Cmq".initial'
    """
    # Imported here and below: workers load this module, and only messages need tomlkit.
    import tomlkit

    return ".".join(tomlkit.key(str(part)).as_string() for part in parts)


# Tables written as separate sections: number of parts in their headers.
_SUBSECTIONS = {("epistemic", "parameters"): 2, ("aleatory", "variables"): 3}
# Sections that may be repeated: [[fly]].
_TABLES = {("fly",), ("logs",)}


def _definition(document: type[BaseModel], location: tuple[Any, ...], of_key: bool = False) -> Any:
    """Return the definition of the value at a location, of the first type that it may have; or of
    the key.
    """
    info = FieldInfo.from_annotation(document)
    for k, part in enumerate(location, start=1):
        key = of_key and k == len(location)
        info = next((f for m in _types_of(info) if (f := _inner(m, part, key)) is not None), info)
    return _types_of(info)[0]


def _types_of(info: FieldInfo) -> list[FieldInfo]:
    """Return the types that a value may have, with their bounds."""
    if typing.get_origin(info.annotation) not in (typing.Union, types.UnionType):
        return [info]
    members = []
    for annotation in typing.get_args(info.annotation):
        if annotation is not type(None):
            inner = FieldInfo.from_annotation(annotation)
            inner.metadata = [*inner.metadata, *info.metadata]
            members += _types_of(inner)
    return members


def _inner(info: FieldInfo, part: Any, key: bool = False) -> FieldInfo | None:
    """Return the definition of a key's value, of the key, or of an item; None without such a
    part.
    """
    kind, arguments = typing.get_origin(info.annotation), typing.get_args(info.annotation)
    if kind is dict:
        return FieldInfo.from_annotation(arguments[0 if key else 1])
    if kind in (tuple, list) and isinstance(part, int):
        fixed = len(arguments) > part and Ellipsis not in arguments
        return FieldInfo.from_annotation(arguments[part if fixed else 0])
    fields: dict[str, FieldInfo] = getattr(info.annotation, "model_fields", {})
    return fields.get(part)


def _real_path(data: Any, location: tuple[Any, ...], missing_too: bool) -> tuple[Any, ...]:
    """Return the part of a location that exists in the file, without pydantic's union members."""
    path: list[Any] = []
    for position, part in enumerate(location):
        in_list = isinstance(data, list) and isinstance(part, int) and part < len(data)
        if in_list or (isinstance(data, dict) and part in data):
            data = data[part]
            path.append(part)
        elif missing_too and position == len(location) - 1:
            path.append(part)
    return tuple(path)


def line_of(text: str, location: tuple[Any, ...]) -> int:
    """Return the line of a key; of its section's header if the key is missing; else 1.

    Handles quoted headers, dotted keys, and inline tables over several lines; strings over several
    lines are not parsed.
    """
    target = [str(part) for part in location]
    best_depth, best_line = 0, 1
    section: list[str] = []
    tables: dict[str, int] = {}
    inside: list[str] = []  # the key whose inline table or list may go on over the next lines
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.strip()
        # Section header, such as [a."b c"].
        header = re.match(r"\[((?:\"[^\"]*\"|'[^']*'|[^\]\"'\[])+)\]\s*(#.*)?$", line)
        # Repeated section, such as [[fly]].
        table = re.match(r"\[\[\s*([\w-]+)\s*\]\]\s*(#.*)?$", line)
        if table:
            name = table.group(1)
            tables[name] = tables.get(name, -1) + 1
            section, inside = [name, str(tables[name])], []
            depth = _matching_depth(section, target)
        elif header:
            section, inside = _parts(header.group(1)), []
            depth = _matching_depth(section, target)
        else:
            # Key, bare, quoted or dotted.
            key = re.match(
                r"((?:[\w-]+|\"[^\"]*\"|'[^']*')(?:\s*\.\s*(?:[\w-]+|\"[^\"]*\"|'[^']*'))*)\s*=",
                line,
            )
            if key:
                inside = section + _parts(key.group(1))
            depth = _matching_depth(inside, target) if key else 0
            # Inside a multi-line inline table, the key's own line is more precise than the table's.
            if _matching_depth(inside, target) == len(inside) < len(target) and inside:
                mark = rf"(?:^|[{{,\s])[\"']?{re.escape(target[len(inside)])}[\"']?\s*="
                depth = len(inside) + 1 if re.search(mark, line) else depth
        # The first line with the deepest match.
        if depth > best_depth:
            best_depth, best_line = depth, number
    return best_line


def _parts(name: str) -> list[str]:
    """Return the parts of a dotted key or header without quotes."""
    return ["".join(quoted) for quoted in re.findall(r"\"([^\"]*)\"|'([^']*)'|([^.\s\"']+)", name)]


def _matching_depth(key: list[str], target: list[str]) -> int:
    """Return the number of equal leading parts; 0 if the keys diverge."""
    shorter = min(len(key), len(target))
    return shorter if key[:shorter] == target[:shorter] else 0


def as_toml(value: Any) -> str:
    """Return a value as TOML writes it; other objects as their text."""
    import tomlkit

    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(map(as_toml, value)) + "]"
    return (
        tomlkit.item(value).as_string()
        if isinstance(value, (str, bool, int, float))
        else str(value)
    )


# Common parts of settings files.

_LARGEST = sys.float_info.max
Number = Annotated[float, Field(allow_inf_nan=False)]


class Section(BaseModel):
    """A section of a settings file: unknown keys and other types are errors; immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


def as_tuple(value: Any) -> Any:
    """Return a TOML array as a tuple, and a single value as a tuple of one.

    Strict validation requires tuples.
    """
    return tuple(value) if isinstance(value, list) else (value,)


def list_as_tuple(value: Any) -> Any:
    """Return a TOML array as a tuple, and any other value unchanged."""
    return tuple(value) if isinstance(value, list) else value


def is_number(value: Any) -> bool:
    """Return whether a TOML value is a finite number; booleans are not."""
    # Compared instead of converted: an integer may exceed every float.
    return (
        isinstance(value, (int, float))
        and not isinstance(value, bool)
        and -_LARGEST <= value <= _LARGEST
    )
