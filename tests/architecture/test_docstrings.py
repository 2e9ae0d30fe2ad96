"""Arguments, fields and names that docstrings mention exist in the code."""

from __future__ import annotations

import ast
import builtins
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from tests.architecture.rooms import modules
from tests.helpers.places import ROOT

NAMES_OF_OTHERS = {
    *("FGFDMExec", "__pycache__", "execrate", "filename", "model_json_schema", "servo_pwm"),
    *("set_reference_data", "sha256sum", "stats", "strerror"),
}
"""Names of JSBSim, the standard library, pydantic, AVL wheels and ArduPilot."""
DATA = re.compile(r"C[XYZlmn]_\w+|Cen_ctrl|prefix\d|x_np|e\d+|diverged|crashed")
"""Derivatives, columns, ids and statuses."""

SECTION = re.compile(
    r"^(?:Other Parameters|Parameters|Attributes)\n-+\n(.*?)(?=^\S[^\n]*\n-{3,}\n|\Z)",
    re.MULTILINE | re.DOTALL,
)
OUTCOME = re.compile(
    r"^(?:Returns|Yields|Raises|Notes|Examples)\n-+\n.*?(?=^\S[^\n]*\n-{3,}\n|\Z)",
    re.MULTILINE | re.DOTALL,
)
ENTRY = re.compile(r"^(\*{0,2}\w+(?:, \*{0,2}\w+)*)(?: : \S|$)", re.MULTILINE)
ROW = re.compile(r"^(\w+(?:, \w+)*)(?:  +| : )\S", re.MULTILINE)
REFERENCE = re.compile(r"(?<!`)`([A-Za-z_][\w.]*)(?:\(\))?`(?!`)|``([A-Za-z_]\w*)``")


@dataclass
class Names:
    """What a source defines, names in any way, and documents: for each docstring its place, its
    text, the names inside and whether a base class may have more.
    """

    defined: set[str]
    bound: set[str]
    documented: list[tuple[str, str, set[str], bool]]


def names_of(source: str) -> Names:
    """Parse a source; its tree is not kept, which would slow every collection of garbage."""
    nodes = list(ast.walk(ast.parse(source)))
    result = Names(set(), bound(nodes), [])
    for node in nodes:
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Module):
            text = ast.get_docstring(node) or ""
            if isinstance(node, ast.Module):
                result.documented.append(("1 module", text, set(), False))
                continue
            result.defined.add(node.name)
            inside = bound(ast.walk(node)) if documented_names(text) else set()
            inherits = isinstance(node, ast.ClassDef) and bool(node.bases)
            result.documented.append((f"{node.lineno} {node.name}", text, inside, inherits))
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            result.defined.update(t.id for t in targets if isinstance(t, ast.Name))
    return result


def bound(inside: Iterable[ast.AST]) -> set[str]:
    """Names that code defines, uses or spells in short strings."""
    names: set[str] = set()
    for node in inside:
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.arg(arg=name):
                names.add(name)
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                names.add(name)
            case ast.alias(name=name, asname=alias):
                names |= {*name.split("."), alias or name}
            case ast.keyword(arg=str(name)):
                names.add(name)
            case ast.Constant(value=str(text)) if len(text) < 80:
                names |= set(re.findall(r"\w+", text))
    return names


def documented_names(docstring: str) -> list[str]:
    """Arguments and fields in a docstring's sections and rows."""
    entries = [entry for part in SECTION.findall(docstring) for entry in ENTRY.findall(part)]
    rows = ROW.findall(OUTCOME.sub("", docstring).partition("\n")[2])
    listed = ", ".join(dict.fromkeys(entries + rows)).replace("*", "")
    return listed.split(", ") if listed else []


def unknown_names(source: Names, project: set[str]) -> Iterator[str]:
    """Documented arguments that a function does not have, and references to nothing."""
    reference = source.bound | project | NAMES_OF_OTHERS | set(dir(builtins))
    for label, docstring, inside, inherits in source.documented:
        for match in REFERENCE.finditer(docstring):
            name = (match[1] or match[2]).split(".")[-1]
            if name not in reference and not DATA.fullmatch(name):
                yield f"{label}: `{name}`"
        if label == "1 module":
            continue
        for name in documented_names(docstring):
            if name not in inside and not (inherits and name in project):
                yield f"{label}: argument {name}"


def test_docstrings_name_what_exists() -> None:
    sources = {
        path.relative_to(ROOT): names_of(path.read_text(encoding="utf-8"))
        for path in modules().values()
    }
    project = {name for path in sources for name in (path.stem, *path.parts)}
    project = project.union(*(source.defined for source in sources.values()))
    invalid = [
        f"{path}:{text}" for path, s in sources.items() for text in unknown_names(s, project)
    ]
    assert not invalid, "\n".join(invalid)


def test_a_stale_name_is_noticed() -> None:
    text = '''
def lift(alpha, area):
    """Lift of `wing_of`.

    Parameters
    ----------
    alpha, surface : angle and area
    """
    return alpha * area
'''
    assert list(unknown_names(names_of(text), set())) == [
        "2 lift: `wing_of`",
        "2 lift: argument surface",
    ]
