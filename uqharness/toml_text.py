"""Plain values as the text of a TOML file; the standard library only reads."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any


def toml_text(data: Mapping[str, Any]) -> str:
    """Tables of strings, numbers, booleans, lists of these and further tables. TypeError for anything else."""
    return "\n".join(_table(data, ())).lstrip("\n") + "\n"


def _table(data: Mapping[str, Any], path: tuple[str, ...]) -> list[str]:
    lines = [f"{_key(name)} = {_value(item)}" for name, item in data.items() if not isinstance(item, Mapping)]
    if path and (lines or not data):
        lines = ["", f"[{'.'.join(map(_key, path))}]", *lines]
    for name, item in data.items():
        if isinstance(item, Mapping):
            lines += _table(item, (*path, name))
    return lines


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)


def _value(item: Any) -> str:
    if isinstance(item, bool):
        return "true" if item else "false"
    if isinstance(item, (int, float)):
        return repr(item)
    if isinstance(item, str):
        # JSON leaves the delete character as it is; TOML does not allow it.
        return json.dumps(item, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(item, (list, tuple)):
        return "[" + ", ".join(map(_value, item)) + "]"
    raise TypeError(f"{item!r}: no value that TOML text is made of here")
