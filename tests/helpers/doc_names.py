"""Files, functions and commands that pages name, looked up."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

from tests.helpers.doc_examples import check_options
from tests.helpers.places import ROOT

PLACE = re.compile(r"`((?:sysid|uqharness|aircraft|scripts|campaigns|tests|docs)/[\w./-]+\.\w+)(?::([\w.]+))?`")
COMMAND = re.compile(r"`((?:uqharness|python -m) [^`]+)`")


@cache
def defined(path: Path) -> frozenset[str]:
    """Functions, classes and methods (Class.method) of a Python file."""
    names = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            names |= {f"{node.name}.{item.name}" for item in node.body if isinstance(item, ast.FunctionDef)}
    return frozenset(names)


def wrong_places(text: str) -> list[str]:
    """`file` and `file:function` marks of a text that lead nowhere."""
    wrong = []
    for name, function in PLACE.findall(text):
        path = ROOT / name
        if not path.is_file():
            wrong.append(name)
        elif function and function not in defined(path):
            wrong.append(f"{name}:{function}")
    return wrong


def check_commands(text: str, where: str) -> int:
    """Every `command` of a text has the subcommands and options that it names; how many there are."""
    found = COMMAND.findall(text)
    for command in found:
        check_options(command, command, where)
    return len(found)


def rows(text: str) -> list[list[str]]:
    """Cells of every row of a page's tables, heads left out."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    heads = {index - 1 for index, line in enumerate(lines) if set(line) <= set("|-: ")}
    kept = [line for i, line in enumerate(lines) if i not in heads and i - 1 not in heads]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in kept]
