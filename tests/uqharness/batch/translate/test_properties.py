"""JSBSim's own properties: the list is complete, and what is said of them is so."""

from __future__ import annotations

import pytest

from tests.helpers import batch_oracle as oracle
from uqharness.batch.translate.frame import (
    REQUIRED,
    keeps_value,
    made_by_jsbsim,
    settable,
    writable,
)
from uqharness.simulator import engine

# Levers and surfaces, which any aircraft's XML moves.
FREE = ("fcs/", "gear/gear-", "gear/tailhook")
ORDERS = (
    "simulation/do_",
    "simulation/reset",
    "simulation/disperse",
    "simulation/write",
    "simulation/terminate",
    "simulation/force",
)


def bare():
    fdm = oracle.loaded(oracle.model(""), 0.01)
    engine.run_ic(fdm)
    return fdm


def test_every_property_of_a_bare_aircraft_is_known():
    names = [
        name
        for name in engine.catalog(bare())
        if not name.startswith(FREE) or name.startswith("fcs/mag-")
    ]
    assert len(names) > 250
    assert [name for name in names if not made_by_jsbsim(name)] == []


def test_properties_of_authors_are_not_jsbsims():
    assert not any(
        made_by_jsbsim(name)
        for name in (
            "ap/engaged",
            "aero/Cm_q",
            "fcs/x",
            "uq/CZ/delta",
            "systems/flaps",
            "propulsion/my-switch",
        )
    )


def test_writable_ones_take_a_value_in_jsbsim():
    fdm = bare()
    names = [
        name
        for name in engine.catalog(fdm)
        if made_by_jsbsim(name) and writable(name) and name != "atmosphere/psiw-rad"
    ]
    assert {"atmosphere/delta-T", "atmosphere/wind-north-fps", "metrics/aero-rp-x-in"} <= set(names)
    fdm["atmosphere/wind-north-fps"] = 5.0
    for name in names:
        before = fdm[name]
        fdm[name] = before + 1.0
        assert fdm[name] == pytest.approx(before + 1.0), name
        fdm[name] = before


def test_required_values_are_those_of_an_aircraft_that_sets_nothing():
    fdm = oracle.loaded(oracle.model(""), 0.01)
    there = fdm.get_property_manager().hasNode
    assert [name for name, value in REQUIRED.items() if there(name) and fdm[name] != value] == []
    assert sum(there(name) for name in REQUIRED) > 12


@pytest.mark.parametrize(
    "name",
    [
        *REQUIRED,
        "position/h-sl-ft",
        "velocities/u-fps",
        "metrics/Sw-sqft",
        "aero/alpha-max-rad",
        "simulation/frame",
    ],
)
def test_what_does_more_than_keep_a_value_is_not_writable(name):
    assert not writable(name)
    assert settable(name) == (name == "simulation/gravity-model")


def test_fixed_ones_stand_still_in_flight():
    fdm = oracle.loaded(oracle.model(""), 0.01)
    engine.run_ic(fdm)
    before = {name: fdm[name] for name in engine.catalog(fdm) if keeps_value(name)}
    for _ in range(50):
        fdm.run()
    moved = [name for name, value in before.items() if fdm[name] != value]
    assert moved == []
    assert not keeps_value("position/h-sl-ft")
    assert not keeps_value("velocities/vc-kts")
