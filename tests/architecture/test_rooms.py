"""Data flows one way, and each outside library that must not spread has one door."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.helpers.places import ROOT


def imported(path: Path) -> set[str]:
    """Full names of all modules that a file imports, at any depth of nesting."""
    return imported_by(path.read_text(encoding="utf-8"))


def imported_by(source: str) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def importers(package: str, library: str) -> set[str]:
    """Files of ``package`` that import ``library``."""
    found = set()
    for path in sorted((ROOT / package).rglob("*.py")):
        if any(name == library or name.startswith(f"{library}.") for name in imported(path)):
            found.add(path.relative_to(ROOT).as_posix())
    return found


def test_sysid_knows_nothing_of_the_simulator_or_the_harness():
    assert importers("sysid", "uqharness") == set()
    assert importers("sysid", "jsbsim") == set()


def test_jsbsim_has_one_door():
    assert importers("uqharness", "jsbsim") == {"uqharness/simulator/engine.py"}


@pytest.mark.parametrize("package", ["sysid", "uqharness"])
def test_matplotlib_lives_in_plotting_files(package):
    assert all(name.endswith("_plot.py") for name in importers(package, "matplotlib"))


@pytest.mark.parametrize("package", ["sysid", "uqharness"])
@pytest.mark.parametrize("library", ["pickle", "shelve", "marshal", "dill", "cloudpickle", "joblib"])
def test_nothing_is_read_that_could_run(package, library):
    assert importers(package, library) == set()
    assert importers("tests", "pickle") != set()


def test_the_walk_sees_nested_and_partial_imports():
    assert "matplotlib.pyplot" in imported_by("def f():\n    import matplotlib.pyplot as plt\n")
    assert "jsbsim" in imported_by("from jsbsim import FGFDMExec\n")
    assert importers("uqharness", "matplotlib") != set()
