"""What must not spread has one door: outside libraries, processes, printing, XML text, conversion
factors, digests.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Collection, Iterator, Mapping
from functools import cache

import pytest

from tests.architecture.rooms import importers, modules
from tests.helpers.places import ROOT

# What may be imported where: folders end with a slash. Behind each file that is no door stands why.
DOORS: Mapping[str, tuple[str, ...]] = {
    "jsbsim": (
        "uqharness/simulator/engine.py",
        "uqharness/exchange/fmu_slave.py",  # a program inside an FMU, without this project
    ),
    "llvmlite": ("uqharness/batch/llvm.py", "uqharness/batch/object_cache.py"),
    "numba": ("sysid/linalg.py",),
    "matplotlib": ("uqharness/report/plots.py",),
    "argparse": ("uqharness/cli/",),
    "distributed": ("uqharness/campaign/dask.py",),
    "tomllib": ("sysid/foreign/regular_files.py",),
    "multiprocessing": (
        "uqharness/parallel.py",
        "uqharness/isolation.py",  # the one process that an aircraft may end
        "uqharness/campaign/processes.py",
        "uqharness/campaign/worker.py",
        "uqharness/campaign/dask.py",
        "uqharness/files.py",  # a folder that ends with the process, whatever started it
    ),
    "subprocess": (
        "uqharness/child_process.py",
        "sysid/foreign/limited.py",  # the reader of foreign logs, below uqharness
        "uqharness/differences/revisions.py",  # git
        "uqharness/flight/autopilot_process.py",  # the autopilot that a user brings
    ),
    "concurrent": (
        "uqharness/parallel.py",
        "uqharness/study/run.py",  # threads that wait for two stages side by side
        "uqharness/campaign/dask.py",  # Dask's futures end with its errors
    ),
    "hashlib": (
        "sysid/foreign/regular_files.py",
        "sysid/foreign/typed_files.py",  # raw bytes inside a file format
        "uqharness/simulator/staging.py",  # an identity of many files in order
        "uqharness/flight/random_numbers.py",  # a number from a name
        "uqharness/campaign/manifest.py",  # a chain of rows
    ),
}
NEVER = ("pickle", "shelve", "marshal", "dill", "cloudpickle", "joblib")
PRINTS = (
    "uqharness/cli/",
    "uqharness/child_process.py",  # a child's answer to its parent
)
XML_TEXT = (
    "uqharness/xml/",
    "uqharness/plugin/",
    "uqharness/report/",
    # Run scripts, which are XML from their first line to their last.
    "uqharness/next_flight/points.py",
    "uqharness/simulator/own_mission.py",
    # The system of an aircraft's host, part of what is staged, below uqharness.xml.
    "uqharness/simulator/host.py",
    # Copies for other programs.
    "uqharness/exchange/",
    # Effects are written as an author would; refinement's inside is to be rewritten.
    "uqharness/refinement/write_xml.py",
    # Messages say what is not understood.
    "uqharness/batch/translate/",
    "uqharness/commands/",
    # HTML, whose tables have the name of JSBSim's.
    "sysid/display.py",
    # A message shows what to write.
    "uqharness/campaign/engines.py",
    "uqharness/flight/fly.py",
    "uqharness/simulator/engine.py",
    "uqharness/simulator/mission.py",
    "uqharness/simulator/aircraft_checks.py",
)
UNITS = ("units.py", "engine_files.py")
FACTORS = re.compile(
    r"^(0\.3048|3\.28084?|515\.3788\d*|4\.4482216\d*|14\.5939\d*|1\.35581\d*|0\.4535\d*|32\.174\d*|0\.51444\d*|1\.68781?)\d*$"
)


def outside(files: set[str], doors: tuple[str, ...]) -> set[str]:
    """Files that are none of the doors."""
    return {
        name
        for name in files
        if not any(name == door or (door.endswith("/") and name.startswith(door)) for door in doors)
    }


def texts(nodes: Collection[ast.AST]) -> Iterator[str]:
    """String constants of a syntax tree's nodes, docstrings left out."""
    documents = {
        id(node.body[0].value)
        for node in nodes
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef))
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    for node in nodes:
        if (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and id(node) not in documents
        ):
            yield node.value


@cache
def files_with_features() -> Mapping[str, set[str]]:
    """Files that print, have conversion factors, or write XML; each is parsed once."""
    found: dict[str, set[str]] = {"prints": set(), "factors": set(), "xml": set()}
    for path in modules().values():
        name = path.relative_to(ROOT).as_posix()
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        for feature, present in (
            ("prints", any(is_print(node) for node in nodes)),
            ("factors", any(is_factor(node) for node in nodes)),
            ("xml", writes_xml(nodes)),
        ):
            if present:
                found[feature].add(name)
    return found


def is_print(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"
    )


def is_factor(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Constant)
        and isinstance(node.value, float)
        and bool(FACTORS.match(repr(node.value)))
    )


def writes_xml(nodes: Collection[ast.AST]) -> bool:
    return any(
        re.search(r"</?(function|property|system|component|table|value|product|sum|axis)\b", text)
        for text in texts(nodes)
    )


@pytest.mark.parametrize("library", DOORS)
def test_a_library_has_its_door(library):
    assert outside(importers(library), DOORS[library]) == set()


@pytest.mark.parametrize("library", NEVER)
def test_nothing_is_read_that_could_run(library):
    assert importers(library) == set()


def test_only_commands_print():
    assert outside(files_with_features()["prints"], PRINTS) == set()


def test_conversion_factors_have_one_home():
    found = files_with_features()["factors"]
    assert {name for name in found if not name.endswith(UNITS)} == set()


def test_jsbsim_xml_is_written_in_its_rooms():
    assert outside(files_with_features()["xml"], XML_TEXT) == set()


def test_the_looks_can_say_no():
    assert outside({"uqharness/flight/fly.py"}, ("uqharness/cli/",)) == {"uqharness/flight/fly.py"}
    assert importers("numpy") != set()
    assert is_print(ast.parse("print(1)").body[0].value)
    assert is_factor(ast.parse("0.3048").body[0].value)
    assert not is_factor(ast.parse("0.5").body[0].value)
    assert writes_xml(list(ast.walk(ast.parse("x = \"<function name='a'>\""))))
    assert not writes_xml(list(ast.walk(ast.parse('"""<function> in a docstring"""'))))
