"""JSON schemas of what commands print with ``--json``, from the result models.

``python -m uqharness.results.schemas docs/schemas`` writes one file for each command; a test
compares the committed files with the models.
"""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from uqharness.results import DOCUMENTS

_BROKEN = ("properties", "$defs")
_DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schema_of(command: str) -> dict[str, Any]:
    """Return the schema of a command, whose words are joined by "-", such as ``campaign-run``."""
    module, _, name = DOCUMENTS[command].partition(":")
    shape = getattr(importlib.import_module(f"uqharness.results.{module}"), name)
    schema = _shortened(TypeAdapter(shape).json_schema(by_alias=True, mode="validation"))
    words = command.replace("-", " ", 1) if command.startswith(("campaign", "log")) else command
    return {"$schema": _DIALECT, "title": f"uqharness {words} --json", **schema}


def _shortened(schema: Any) -> Any:
    """Leave out what repeats the keys or is the rule, and write a nullable type as one list."""
    if isinstance(schema, list):
        return [_shortened(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    kinds = schema.get("anyOf")
    if isinstance(kinds, list) and all(isinstance(k, dict) and k.keys() == {"type"} for k in kinds):
        schema = {"type": [kind["type"] for kind in kinds], **schema}
        del schema["anyOf"]
    return {
        key: {name: _shortened(item) for name, item in value.items()}
        # Names of properties may be those of keywords, such as title.
        if key in ("properties", "$defs")
        else _shortened(value)
        for key, value in schema.items()
        if key not in ("title", "default") and (key, value) != ("additionalProperties", True)
    }


def text_of(schema: Mapping[str, Any]) -> str:
    """Return a schema with one line for each property, so that a diff shows what changed."""

    def lines(value: Any, depth: int, broken: bool) -> str:
        if not (broken and isinstance(value, dict)):
            return json.dumps(value)
        space = " " * (depth + 1)
        body = ",\n".join(
            # Below the schema and its definitions only their properties are broken up.
            f"{space}{json.dumps(key)}: {lines(item, depth + 1, key in _BROKEN or depth == 1)}"
            if depth < 3
            else f"{space}{json.dumps(key)}: {json.dumps(item)}"
            for key, item in value.items()
        )
        return f"{{\n{body}\n{' ' * depth}}}"

    return lines(schema, 0, True)


def write_schemas(folder: Path) -> list[Path]:
    """Write the schema of every command into a folder; return the files."""
    files = []
    for command in DOCUMENTS:
        files.append(folder / f"{command}.json")
        files[-1].write_text(text_of(schema_of(command)) + "\n", encoding="utf-8")
    return files


if __name__ == "__main__":
    write_schemas(Path(sys.argv[1]))
