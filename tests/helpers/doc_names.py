"""Files, functions and commands that pages name, looked up."""

from __future__ import annotations

import ast
import importlib
import re
from functools import cache
from pathlib import Path

from tests.helpers.doc_examples import check_options
from tests.helpers.places import ROOT

PLACE = re.compile(
    r"`((?:sysid|uqharness|aircraft|scripts|campaigns|tests|docs)/[\w./-]+\.\w+)(?::([\w.]+))?`"
)
DOTTED = re.compile(r"`((?:sysid|uqharness)(?:\.[A-Za-z_]\w*)+)`")
FOLDER = re.compile(r"`((?:sysid|uqharness|aircraft|scripts|campaigns|tests|docs)/[a-z0-9_/-]*/)`")
COMMAND = re.compile(r"`((?:uqharness|python -m) [^`]+)`")


@cache
def defined(path: Path) -> frozenset[str]:
    """Functions, classes and methods (Class.method) of a Python file."""
    names = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            names |= {
                f"{node.name}.{item.name}"
                for item in node.body
                if isinstance(item, ast.FunctionDef)
            }
    return frozenset(names)


def wrong_places(text: str) -> list[str]:
    """`file` and `file:function` marks of a text that lead nowhere."""
    invalid = []
    for name, function in PLACE.findall(text):
        path = ROOT / name
        if not path.is_file():
            invalid.append(name)
        elif function and function not in defined(path):
            invalid.append(f"{name}:{function}")
    return invalid


def check_commands(text: str, where: str) -> int:
    """Every `command` of a text has the subcommands and options that it names; how many
    there are.
    """
    result = COMMAND.findall(text)
    for command in result:
        check_options(command, command, where)
    return len(result)


def rows(text: str) -> list[list[str]]:
    """Cells of every row of a page's tables, heads left out."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    heads = {index - 1 for index, line in enumerate(lines) if set(line) <= set("|-: ")}
    retained = [line for i, line in enumerate(lines) if i not in heads and i - 1 not in heads]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in retained]


def wrong_names(text: str) -> list[str]:
    """Dotted names of a text, `package.module` or `package.module.name`, that lead nowhere."""
    return [name for name in DOTTED.findall(text) if not leads_somewhere(name)]


def leads_somewhere(name: str) -> bool:
    """Whether a dotted name is a package, a module, or something that a module defines or
    gives on.
    """
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        module, remainder = ROOT.joinpath(*parts[:k]), ".".join(parts[k:])
        file = module / "__init__.py" if module.is_dir() else module.with_suffix(".py")
        if file.is_file():
            return (
                not remainder
                or remainder in defined(file)
                or hasattr(importlib.import_module(".".join(parts[:k])), remainder)
            )
        if module.is_dir() and not remainder:
            return True
    return False


def wrong_folders(text: str) -> list[str]:
    """`folder/` marks of a text that lead nowhere; one with a placeholder in capitals is
    left out.
    """
    return [name for name in FOLDER.findall(text) if not (ROOT / name).is_dir()]
