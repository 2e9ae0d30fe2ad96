"""A room is entered by its package's ``__init__``: what others use of it stands in one list.

A whole module may be taken from a room (``from uqharness.simulator import engine``): each use then
names it."""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Mapping

import pytest

from tests.architecture.rooms import BASE, modules, room
from tests.helpers.places import ROOT

# Names that several modules of a room define, each in its own sense, or that are a module's as
# well; they are imported from their modules.
SEVERAL: Mapping[str, tuple[str, ...]] = {
    "sysid.aerodynamics": ("MassProperties", "OUTPUTS", "STATES"),
    "uqharness.campaign": ("as_json", "table"),
    "uqharness.refinement": ("refine",),
    "uqharness.replay": ("segments",),
    "uqharness.report": ("write_results",),
}
# A public package whose list is for users: the project's own tables and commands ask it for more.
INSIDE = ("uqharness.sensitivity",)
FACES = sorted(
    name
    for name, path in modules().items()
    if path.name == "__init__.py" and path.with_suffix(".pyi").is_file()
)


def entered_by_the_side(name: str, source: str) -> list[str]:
    """Imports of a module that take a name from the inside of another room."""
    found = []
    known = modules()
    for node in ast.walk(ast.parse(source)):
        if (
            not isinstance(node, ast.ImportFrom)
            or node.module not in known
            or known[node.module].name == "__init__.py"
        ):
            continue
        package, inner = room(node.module)
        if (
            room(name) == (package, inner)
            or inner in ("", *BASE[package])
            or f"{package}.{inner}" in INSIDE
        ):
            continue
        # A function named like its module is hidden by the module once that is loaded.
        allowed = {node.module.rpartition(".")[2], *SEVERAL.get(f"{package}.{inner}", ())}
        found += [
            f"{node.module}.{alias.name}" for alias in node.names if alias.name not in allowed
        ]
    return found


def test_rooms_are_entered_by_their_faces():
    found = {
        name: entered_by_the_side(name, path.read_text(encoding="utf-8"))
        for name, path in modules().items()
    }
    assert {
        name: names for name, names in found.items() if names and name not in ("sysid", "uqharness")
    } == {}


def test_an_entry_by_the_side_is_seen():
    source = "from uqharness.flight.spec import FlightSpec\n"
    assert entered_by_the_side("uqharness.campaign.run", source) == [
        "uqharness.flight.spec.FlightSpec"
    ]
    assert entered_by_the_side("uqharness.flight.fly", source) == []
    assert (
        entered_by_the_side("uqharness.campaign.run", "from uqharness.flight import FlightSpec\n")
        == []
    )


@pytest.mark.parametrize("name", FACES)
def test_a_face_holds_what_it_lists(name):
    package = importlib.import_module(name)
    for public in package.__all__:
        assert getattr(package, public) is not None
    with pytest.raises(AttributeError):
        package.nothing_of_that_name  # noqa: B018


def not_asked_for(name: str, listed: set[str], everything: str) -> set[str]:
    """Names of the list of a room that no line of ``everything`` imports from it, nor takes from
    the room that was imported.
    """
    asked = re.findall(rf"from {re.escape(name)} import \(?([^)\n]*(?:\n[^)]*)?)", everything)
    package, _, inner = name.rpartition(".")
    if re.search(rf"from {re.escape(package)} import {inner}\b", everything):
        asked += re.findall(rf"(?<![\w.]){inner}\.(\w+)", everything)
    return listed - set(re.findall(r"\w+", " ".join(asked)))


def test_a_face_lists_no_more_than_is_used():
    """Names of the inner rooms' lists that no other room, test or campaign asks for."""
    everything = "\n".join(
        path.read_text(encoding="utf-8")
        for folder in ("sysid", "uqharness", "tests", "campaigns", "docs")
        for path in (ROOT / folder).rglob("*.py")
    )
    for name in FACES:
        if name in ("sysid", "uqharness", *INSIDE):
            continue
        assert (
            not_asked_for(name, set(importlib.import_module(name).__all__), everything) == set()
        ), name
