"""The architecture: each room imports its own layer or a lower one, no modules import each other in a
circle, what must not spread has one door, and a room is entered by its package's ``__init__``.

A whole module may be taken from a room (``from uqharness.simulator import engine``): each use then
names it.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterable, Mapping

import pytest

from tests.architecture.rooms import (
    BASE,
    LAYERS,
    against_the_layers,
    circles,
    imported_by,
    importers,
    imports,
    modules,
    room,
    scan,
)
from tests.helpers.places import ROOT

# The command's first file, which every worker process reads again, loads the command line when it
# is called.
ENTRY = {("uqharness.__main__", "uqharness.cli")}


def test_every_arrow_goes_down():
    invalid = {
        (name, other)
        for name in modules()
        for other in imports(name)
        if against_the_layers(name, other)
    }
    assert invalid == ENTRY


def test_every_folder_is_a_layer():
    folders = {
        (name.split(".")[0], name.split(".")[1])
        for name, path in modules().items()
        if len(name.split(".")) > 2
    }
    assert folders == {
        (package, layer)
        for package, layers in LAYERS.items()
        for layer in (*layers, *BASE[package])
        if layer
    }


def test_no_circles():
    assert circles({name: imports(name) for name in modules()}) == []


def test_sysid_knows_nothing_of_the_simulator_or_the_harness():
    assert importers("uqharness", "sysid") == set()
    assert importers("jsbsim", "sysid") == set()


def test_a_circle_and_an_arrow_up_are_seen():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]
    assert circles({"a": {"b"}, "b": set()}) == []
    assert against_the_layers("uqharness.flight.fly", "uqharness.campaign.run")
    assert against_the_layers("sysid.record", "uqharness.errors")
    assert not against_the_layers("uqharness.campaign.run", "uqharness.flight.fly")


def test_the_walk_sees_nested_and_partial_imports():
    assert ("matplotlib.pyplot",) in set(
        imported_by("def f():\n    import matplotlib.pyplot as plt\n")
    )
    assert ("jsbsim.FGFDMExec", "jsbsim") in set(imported_by("from jsbsim import FGFDMExec\n"))


# What may be imported where: folders end with a slash. Behind each file that is no door stands why.
DOORS: Mapping[str, tuple[str, ...]] = {
    "jsbsim": (
        "uqharness/simulator/engine.py",
        "uqharness/exchange/fmu_slave.py",  # a program inside an FMU, without this project
    ),
    "llvmlite": ("uqharness/batch/llvm.py", "sysid/vector_rows.py"),
    "numba": ("sysid/linalg.py", "sysid/vector_rows.py"),
    "matplotlib": ("uqharness/report/plots.py",),
    "argparse": ("uqharness/cli/",),
    "distributed": ("uqharness/campaign/dask.py",),
    "tomllib": ("sysid/foreign/regular_files.py",),
    "multiprocessing": (
        "uqharness/parallel.py",
        "uqharness/isolation.py",  # the one process that an aircraft may end
        "uqharness/campaign/processes.py",
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
    "uqharness/differences/ranking.py",
    "uqharness/simulator/own_mission.py",
    # Aircraft are written from templates; without a trim the line hold is an empty system.
    "uqharness/authoring/line_hold.py",
    # The system of an aircraft's host, part of what is staged, below uqharness.xml.
    "uqharness/simulator/host.py",
    # Copies for other programs.
    "uqharness/exchange/",
    # Effects are written as an author would; refinement's inside is to be rewritten.
    "uqharness/refinement/write_xml.py",
    # Messages say what is not supported.
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


XML_TAG = re.compile(r"</?(function|property|system|component|table|value|product|sum|axis)\b")


def outside(files: Iterable[str], doors: tuple[str, ...]) -> set[str]:
    """Files that are none of the doors."""
    return {
        name
        for name in files
        if not any(name == door or (door.endswith("/") and name.startswith(door)) for door in doors)
    }


def has_factor(source: str) -> bool:
    return any(FACTORS.match(repr(value)) for value in scan(source).floats)


def has_xml(source: str) -> bool:
    return any(XML_TAG.search(text) for text in scan(source).texts)


SOURCES = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in modules().values()
}


@pytest.mark.parametrize("library", [*DOORS, *NEVER])
def test_a_library_has_its_door(library):
    """Nothing is read that could run: the libraries of NEVER have none."""
    assert outside(importers(library), DOORS.get(library, ())) == set()


def test_printing_factors_and_xml_have_their_doors():
    assert outside((f for f, text in SOURCES.items() if scan(text).prints), PRINTS) == set()
    assert outside((f for f, text in SOURCES.items() if has_xml(text)), XML_TEXT) == set()
    assert {f for f, text in SOURCES.items() if has_factor(text) and not f.endswith(UNITS)} == set()


def test_the_looks_can_say_no():
    assert outside({"uqharness/flight/fly.py"}, ("uqharness/cli/",)) == {"uqharness/flight/fly.py"}
    assert importers("numpy") != set()
    assert scan("print(1)").prints
    assert has_factor("x = 0.3048")
    assert not has_factor("x = 0.5")
    assert has_xml("x = \"<function name='a'>\"")
    assert not has_xml('"""<function> in a docstring"""')


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
    result = []
    reference = modules()
    for module, names in scan(source).imports:
        if module not in reference or reference[module].name == "__init__.py":
            continue
        package, inner = room(module)
        is_open = inner in ("", *BASE[package]) or f"{package}.{inner}" in INSIDE
        if room(name) == (package, inner) or is_open:
            continue
        # A function named like its module is hidden by the module once that is loaded.
        allowed = {module.rpartition(".")[2], *SEVERAL.get(f"{package}.{inner}", ())}
        result += [f"{module}.{alias}" for alias in names if alias not in allowed]
    return result


def test_rooms_are_entered_by_their_faces():
    result = {
        name: entered_by_the_side(name, path.read_text(encoding="utf-8"))
        for name, path in modules().items()
        if name not in ("sysid", "uqharness")
    }
    assert {name: names for name, names in result.items() if names} == {}
    side, face = (f"from uqharness.flight{inner} import FlightSpec\n" for inner in (".spec", ""))
    assert entered_by_the_side("uqharness.campaign.run", side) == [
        "uqharness.flight.spec.FlightSpec"
    ]
    assert entered_by_the_side("uqharness.flight.fly", side) == []
    assert entered_by_the_side("uqharness.campaign.run", face) == []


@pytest.mark.parametrize("name", FACES)
def test_a_face_holds_what_it_lists(name):
    package = importlib.import_module(name)
    for public in package.__all__:
        assert getattr(package, public) is not None
    with pytest.raises(AttributeError):
        package.nothing_of_that_name  # noqa: B018


def not_asked_for(name: str, listed: set[str], all_items: str) -> set[str]:
    """Names of the list of a room that no line of ``everything`` imports from it, nor takes from
    the room that was imported.
    """
    request = re.findall(rf"from {re.escape(name)} import \(?([^)\n]*(?:\n[^)]*)?)", all_items)
    package, _, inner = name.rpartition(".")
    if re.search(rf"from {re.escape(package)} import {inner}\b", all_items):
        request += re.findall(rf"(?<![\w.]){inner}\.(\w+)", all_items)
    return listed - set(re.findall(r"\w+", " ".join(request)))


def test_a_face_lists_no_more_than_is_used():
    """Names of the inner rooms' lists that no other room, test or campaign asks for."""
    all_items = "\n".join(
        path.read_text(encoding="utf-8")
        for folder in ("sysid", "uqharness", "tests", "campaigns", "docs")
        for path in (ROOT / folder).rglob("*.py")
    )
    for name in FACES:
        if name in ("sysid", "uqharness", *INSIDE):
            continue
        assert (
            not_asked_for(name, set(importlib.import_module(name).__all__), all_items) == set()
        ), name
