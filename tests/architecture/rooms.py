"""The project's modules and what they import, for the tests of its architecture."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from tests.helpers.places import ROOT

PACKAGES = ("sysid", "uqharness")
# Lowest first. "" is what lies in the package itself; BASE beside it.
_SYSID = "logs aerodynamics estimation model_form effects"
_UQHARNESS = (
    "simulator xml flight differences batch plugin statistics replay identification exchange"
    " authoring sensitivity campaign next_flight refinement study dossier report commands api cli"
)
LAYERS: Mapping[str, tuple[str, ...]] = {
    "sysid": ("", *_SYSID.split()),
    "uqharness": ("", *_UQHARNESS.split()),
}

BASE = {"sysid": ("foreign",), "uqharness": ("requests", "results")}
"""Folders of the lowest layer."""
FACES = ("sysid", "uqharness")
"""The packages' own ``__init__``: the public face, which stands above all layers and is loaded name
by name.
"""


@cache
def modules() -> Mapping[str, Path]:
    """Every module by its dotted name."""
    result = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            result[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return result


@dataclass(frozen=True)
class Scan:
    """What a source imports, at any depth of nesting, prints, and has in floats and texts.

    ``imports`` has a pair of module and names for each statement; ``import x`` has the module None.
    """

    imports: tuple[tuple[str | None, tuple[str, ...]], ...]
    prints: bool
    floats: frozenset[float]
    texts: tuple[str, ...]


@cache
def scan(source: str) -> Scan:
    """Parse a source once; its texts are the string constants that are no docstrings."""
    imports: list[tuple[str | None, tuple[str, ...]]] = []
    prints, floats, documents, texts = False, set(), set(), []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            module = node.module if isinstance(node, ast.ImportFrom) else None
            imports.append((module, tuple(alias.name for alias in node.names)))
        elif isinstance(node, ast.Call):
            prints |= isinstance(node.func, ast.Name) and node.func.id == "print"
        elif isinstance(node, ast.Constant) and isinstance(node.value, float):
            floats.add(node.value)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            texts += [node.value] if id(node) not in documents else []
        elif isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and node.body:
            # Visited before what it holds.
            documents.add(id(node.body[0].value if isinstance(node.body[0], ast.Expr) else None))
    return Scan(tuple(imports), prints, frozenset(floats), tuple(texts))


def imported_by(source: str) -> list[tuple[str, ...]]:
    """What a source imports: for each name, the dotted names that it may stand for, longest
    first.
    """
    return [
        (f"{module}.{name}", module) if module else (name,)
        for module, names in scan(source).imports
        for name in names
    ]


def imports(name: str) -> set[str]:
    """The project's own modules that a module imports."""
    paths = modules()
    source = paths[name].read_text(encoding="utf-8")
    result = {next((full for full in names if full in paths), "") for names in imported_by(source)}
    return result - {"", name}


def importers(library: str, package: str = "") -> set[str]:
    """Files that import a library or a part of it."""
    result = set()
    for name, path in modules().items():
        if name.split(".")[0] in (package or name):
            names = {
                full for names in imported_by(path.read_text(encoding="utf-8")) for full in names
            }
            if any(full == library or full.startswith(f"{library}.") for full in names):
                result.add(path.relative_to(ROOT).as_posix())
    return result


def room(name: str) -> tuple[str, str]:
    """Package and room of a module: ("uqharness", "campaign") for uqharness.campaign.run, ("sysid",
    "") for sysid.record.
    """
    package, _, remainder = name.partition(".")
    inner, _, _ = remainder.partition(".")
    return package, inner if inner in LAYERS[package] else ""


def against_the_layers(name: str, other: str) -> bool:
    """Whether a module may not import the other: it lies higher, or in a package that knows nothing
    of it.
    """
    (package, part), (target, target_part) = room(name), room(other)
    if name in FACES:
        return False
    if package != target:
        return package == "sysid"
    return LAYERS[package].index(target_part) > LAYERS[package].index(part)


def circles(graph: Mapping[str, set[str]]) -> list[list[str]]:
    """Groups of modules that import each other, directly or through others (Tarjan 1972)."""
    number: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    result = []

    def visit(name: str) -> None:
        number[name] = low[name] = len(number)
        stack.append(name)
        for other in sorted(graph[name]):
            if other not in number:
                visit(other)
            if other in stack:
                low[name] = min(low[name], low[other])
        if low[name] == number[name]:
            group = stack[stack.index(name) :]
            del stack[stack.index(name) :]
            if len(group) > 1:
                result.append(sorted(group))

    for name in graph:
        if name not in number:
            visit(name)
    return result
