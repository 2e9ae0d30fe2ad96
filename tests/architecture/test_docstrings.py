"""Arguments, fields and names that docstrings mention exist in the code."""

from __future__ import annotations

import ast
import builtins
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
MODULES = {
    path.relative_to(ROOT): ast.parse(path.read_text())
    for package in ("sysid", "uqharness")
    for path in sorted((ROOT / package).rglob("*.py"))
}

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


def bound(tree: ast.AST) -> set[str]:
    """Names that code defines, uses or spells in short strings."""
    names: set[str] = set()
    for node in ast.walk(tree):
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


def unknown_names(tree: ast.Module, project: set[str]) -> Iterator[str]:
    """Documented arguments that a function does not have, and references to nothing."""
    known_here = bound(tree) | project | NAMES_OF_OTHERS | set(dir(builtins))
    for node in ast.walk(tree):
        if not isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Module):
            continue
        docstring = ast.get_docstring(node) or ""
        label = f"{getattr(node, 'lineno', 1)} {getattr(node, 'name', 'module')}"
        for match in REFERENCE.finditer(docstring):
            name = (match[1] or match[2]).split(".")[-1]
            if name not in known_here and not DATA.fullmatch(name):
                yield f"{label}: `{name}`"
        if isinstance(node, ast.Module):
            continue
        has = bound(node)
        entries = [e for s in SECTION.findall(docstring) for e in ENTRY.findall(s)]
        rows = ROW.findall(OUTCOME.sub("", docstring).partition("\n")[2])
        for names in dict.fromkeys(entries + rows):
            for name in names.replace("*", "").split(", "):
                # A class may document a field that it inherits.
                inherited = isinstance(node, ast.ClassDef) and node.bases and name in project
                if name not in has and not inherited:
                    yield f"{label}: argument {name}"


def test_docstrings_name_what_exists() -> None:
    project = {name for path in MODULES for name in (path.stem, *path.parts)}
    for tree in MODULES.values():
        project |= {
            n.name for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.ClassDef)
        } | {
            t.id
            for n in ast.walk(tree)
            if isinstance(n, ast.Assign | ast.AnnAssign)
            for t in (n.targets if isinstance(n, ast.Assign) else [n.target])
            if isinstance(t, ast.Name)
        }
    wrong = [
        f"{path}:{text}" for path, tree in MODULES.items() for text in unknown_names(tree, project)
    ]
    assert not wrong, "\n".join(wrong)


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
    assert list(unknown_names(ast.parse(text), set())) == [
        "2 lift: `wing_of`",
        "2 lift: argument surface",
    ]
