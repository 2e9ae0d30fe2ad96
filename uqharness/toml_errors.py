"""What is wrong with a TOML file, said of the file: section, key, line, what was received, what is allowed."""

from __future__ import annotations

import difflib
import re
from typing import Any

from pydantic import BaseModel


def explain(document: type[BaseModel], text: str, data: dict[str, Any], error: dict[str, Any]) -> tuple[int, str]:
    """(line, sentence) of one of pydantic's errors about ``data``, which was read from ``text`` and validated as ``document``."""
    location = _real_path(data, error["loc"], missing_too=error["type"] == "missing")
    line = line_of(text, location)
    name = " ".join([f"[{location[0]}]", ".".join(map(str, location[1:]))]).strip() if location else "the file"
    if error["type"] == "extra_forbidden":
        known = _known_keys(document, location[:-1])
        near = difflib.get_close_matches(str(location[-1]), known, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]}? " if near else ""
        return line, f"{name}: unknown {'section' if len(location) == 1 else 'key'}; {hint}allowed: {', '.join(known)}"
    if error["type"] == "missing":
        return line, f"{name}: required and not there"
    message = error["msg"].removeprefix("Value error, ").replace("Input should", "must")
    received = error.get("input")
    # A whole table echoed back would bury the sentence, which names the part that matters.
    shown = "" if isinstance(received, dict) else f"; received {as_toml(received)}"
    return line, f"{name}: {message}{shown}"


def _known_keys(document: type[BaseModel], section: tuple[Any, ...]) -> list[str]:
    model: Any = document
    for name in section:
        model = model.model_fields[name].annotation
    return list(model.model_fields)


def _real_path(data: Any, location: tuple[Any, ...], missing_too: bool) -> tuple[Any, ...]:
    """``location`` without pydantic's own marks (names of union members): the part that exists in the file."""
    found: list[Any] = []
    for position, part in enumerate(location):
        in_list = isinstance(data, list) and isinstance(part, int) and part < len(data)
        if in_list or (isinstance(data, dict) and part in data):
            data = data[part]
            found.append(part)
        elif missing_too and position == len(location) - 1:
            found.append(part)
    return tuple(found)


def line_of(text: str, location: tuple[Any, ...]) -> int:
    """Line of a key; of its section's header where the key is missing; 1 where that is missing too."""
    if not location:
        return 1
    section_line, section, best = 1, "", 0
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.strip()
        header = re.match(r"\[+\s*([^\]]+?)\s*\]+", line)
        if header:
            section = re.sub(r"[\"'\s]", "", header.group(1))
            if section == str(location[0]) or section.startswith(f"{location[0]}."):
                section_line = number if section == location[0] or section_line == 1 else section_line
                if len(location) > 1 and section == f"{location[0]}.{location[1]}":
                    return number
            continue
        if section == location[0] and len(location) > 1:
            if re.match(rf"[\"']?{re.escape(str(location[1]))}[\"']?\s*[=.]", line):
                best = number
            # A key within an inline table that spans lines is nearer the mistake than the table's first line.
            if best and len(location) > 2 and re.search(rf"\b{re.escape(str(location[2]))}\s*=", line):
                return number
        elif not section and re.match(rf"[\"']?{re.escape(str(location[0]))}[\"']?\s*[=.]", line):
            return number
    return best or section_line


def as_toml(value: Any) -> str:
    """A value as it would stand in the file."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(map(as_toml, value)) + "]"
    return f'"{value}"' if isinstance(value, str) else str(value)
