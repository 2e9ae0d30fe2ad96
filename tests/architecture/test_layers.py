"""Each room imports its own layer or a lower one, and no modules import each other in a circle."""

from __future__ import annotations

from tests.architecture.rooms import (
    BASE,
    LAYERS,
    against_the_layers,
    circles,
    imported_by,
    importers,
    imports,
    modules,
)

# The command's first file, which every worker process reads again, loads the command line when it
# is called.
ENTRY = {("uqharness.__main__", "uqharness.cli")}


def test_every_arrow_goes_down():
    wrong = {
        (name, other)
        for name in modules()
        for other in imports(name)
        if against_the_layers(name, other)
    }
    assert wrong == ENTRY


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
