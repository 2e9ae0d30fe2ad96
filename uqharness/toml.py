"""What is wrong with a TOML file, said of the file: section, key, line, what was received, what is
allowed.
"""

from __future__ import annotations

import difflib
import re
import sys
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from sysid.foreign.regular_files import ParseError, parse_toml, read_regular_text
from uqharness.errors import BadInputError


def read_toml(path: Path) -> tuple[dict[str, Any], str]:
    """Content and text of a TOML file. Raises BadInputError with file and line."""
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
    document: type[BaseModel], text: str, data: dict[str, Any], error: dict[str, Any]
) -> tuple[int, str]:
    """(line, sentence) of one of pydantic's errors about ``data``, which was read from ``text`` and
    validated as ``document``.
    """
    location = _real_path(data, error["loc"], missing_too=error["type"] == "missing")
    line = line_of(text, location)
    name = _name(location)
    if error["type"] == "extra_forbidden":
        allowed = _allowed_keys(document, location[:-1])
        matches = difflib.get_close_matches(str(location[-1]), allowed, n=1, cutoff=0.5)
        hint = f"did you mean {matches[0]}? " if matches else ""
        return (
            line,
            (
                f"{name}: unknown {'section' if len(location) == 1 else 'key'}; {hint}allowed:"
                f" {', '.join(allowed)}"
            ),
        )
    if error["type"] == "missing":
        return line, f"{name}: required and not there"
    message = error["msg"].removeprefix("Value error, ").replace("Input should", "must")
    received = error.get("input")
    # A whole table echoed back would bury the sentence, which names the part that matters.
    received_text = "" if isinstance(received, dict) else f"; received {as_toml(received)}"
    return line, f"{name}: {message}{received_text}"


def _name(location: tuple[Any, ...]) -> str:
    """``[aleatory] wind_mps`` or ``[epistemic.parameters] fit``; the file itself for no
    location.
    """
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
    """Parts of a key as TOML writes them."""
    # Imported here and below: every worker of a campaign loads this module, and what it says is
    # said when something is wrong.
    import tomlkit

    return ".".join(tomlkit.key(str(part)).as_string() for part in parts)


# Tables that a file writes as sections of their own, and how many parts their headers have.
_SUBSECTIONS = {("epistemic", "parameters"): 2, ("aleatory", "variables"): 3}
# Sections that a file repeats: [[fly]].
_TABLES = {("fly",), ("logs",)}


def _allowed_keys(document: type[BaseModel], section: tuple[Any, ...]) -> list[str]:
    model: Any = document
    parts = iter(section)
    for name in parts:
        if isinstance(name, int):  # one of the tables of that name
            continue
        annotation = model.model_fields[name].annotation
        model = _model_within(annotation)
        if getattr(annotation, "__origin__", None) is dict:
            next(parts, None)  # a name of the user's choice
    return list(model.model_fields)


def _model_within(annotation: Any) -> Any:
    """The model of an annotation such as ``Model``, ``Model | None`` or ``dict[str, Model]``."""
    if hasattr(annotation, "model_fields"):
        return annotation
    models = [_model_within(part) for part in getattr(annotation, "__args__", ())]
    return next((part for part in models if hasattr(part, "model_fields")), annotation)


def _real_path(data: Any, location: tuple[Any, ...], missing_too: bool) -> tuple[Any, ...]:
    """``location`` without pydantic's own marks (names of union members): the part that exists in
    the file.
    """
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
    """Line of a key; of its section's header where the key is missing; 1 where that is missing too.

    Reads headers with quoted parts, dotted keys and inline tables that span lines; a string over
    several lines is not looked into."""
    target = [str(part) for part in location]
    best_depth, best_line = 0, 1
    section: list[str] = []
    tables: dict[str, int] = {}
    inside: list[str] = []  # the key whose inline table or list may go on over the next lines
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.strip()
        header = re.match(r"\[((?:\"[^\"]*\"|'[^']*'|[^\]\"'\[])+)\]\s*(#.*)?$", line)
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
            key = re.match(
                r"((?:[\w-]+|\"[^\"]*\"|'[^']*')(?:\s*\.\s*(?:[\w-]+|\"[^\"]*\"|'[^']*'))*)\s*=",
                line,
            )
            if key:
                inside = section + _parts(key.group(1))
            depth = _matching_depth(inside, target) if key else 0
            # A key within an inline table that spans lines is nearer the mistake than the table's
            # first line.
            if _matching_depth(inside, target) == len(inside) < len(target) and inside:
                mark = rf"(?:^|[{{,\s])[\"']?{re.escape(target[len(inside)])}[\"']?\s*="
                depth = len(inside) + 1 if re.search(mark, line) else depth
        if depth > best_depth:
            best_depth, best_line = depth, number
    return best_line


def _parts(name: str) -> list[str]:
    """Parts of a dotted key or header, quotes taken off."""
    return ["".join(quoted) for quoted in re.findall(r"\"([^\"]*)\"|'([^']*)'|([^.\s\"']+)", name)]


def _matching_depth(key: list[str], target: list[str]) -> int:
    """Parts that agree, or 0 if ``key`` leads elsewhere."""
    shorter = min(len(key), len(target))
    return shorter if key[:shorter] == target[:shorter] else 0


def as_toml(value: Any) -> str:
    """A value as it would stand in the file; Python's own text of what is no string, number,
    boolean or list.
    """
    import tomlkit

    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(map(as_toml, value)) + "]"
    return (
        tomlkit.item(value).as_string()
        if isinstance(value, (str, bool, int, float))
        else str(value)
    )


# What settings files share: strict sections, numbers, lists.

_LARGEST = sys.float_info.max
Number = Annotated[float, Field(allow_inf_nan=False)]


class Section(BaseModel):
    """A section of the file: unknown keys are refused, types are not bent, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


def as_tuple(value: Any) -> Any:
    """A single value stands for a list of one; TOML's lists become tuples, which strict validation
    wants.
    """
    return tuple(value) if isinstance(value, list) else (value,)


def list_as_tuple(value: Any) -> Any:
    """A TOML array as a tuple; anything else as it is."""
    return tuple(value) if isinstance(value, list) else value


def is_number(value: Any) -> bool:
    """Whether a TOML value is a finite number, true and false excluded."""
    # Compared, not converted: an integer may be larger than any float.
    return (
        isinstance(value, (int, float))
        and not isinstance(value, bool)
        and -_LARGEST <= value <= _LARGEST
    )
