"""JSBSim's own properties, its flight controls in all units, numbers and names as JSBSim reads them."""

from __future__ import annotations

import pytest

from tests.helpers import batch_oracle as oracle
from tests.helpers.batch_systems import judged, random_inputs
from uqharness.batch.translate.frame import (
    HOOKS,
    REQUIRED,
    keeps_value,
    made_by_jsbsim,
    read_only,
    settable,
    writable,
)
from uqharness.simulator import engine

# Levers and surfaces, which any aircraft's XML moves.
FREE = ("fcs/", "gear/gear-", "gear/tailhook")


def plain():
    fdm = oracle.loaded(oracle.model(""), 0.01)
    engine.run_ic(fdm)
    return fdm


def test_all_properties_of_a_bare_aircraft_are_listed():
    names = [
        name
        for name in engine.catalog(plain())
        if not name.startswith(FREE) or name.startswith("fcs/mag-")
    ]
    assert len(names) > 250
    assert [name for name in names if not made_by_jsbsim(name)] == []


def test_writable_ones_take_a_value_in_jsbsim():
    fdm = plain()
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
    present = fdm.get_property_manager().hasNode
    assert [name for name, value in REQUIRED.items() if present(name) and fdm[name] != value] == []
    assert sum(present(name) for name in REQUIRED) > 12


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


@pytest.mark.parametrize("name", [name for name in HOOKS if "feather" not in name])
def test_a_surface_moves_in_all_units(name: str) -> None:
    body = (
        "<channel><pure_gain"
        f' name="{name}"><input>i/a</input><gain>@.3</gain></pure_gain></channel>'
    )
    difference, control = judged(body, random_inputs(300))
    assert difference == {}
    assert (
        len(control) == 3
        if "flap" not in name and "brake" not in name and "spoiler" not in name
        else 2
    )


@pytest.mark.parametrize(
    "name", ["fcs/mag-elevator-pos-rad", "simulation/channel-dt", "fcs/a/saturated"]
)
def test_read_only_properties_take_no_value(name: str) -> None:
    fdm = oracle.load(
        '<channel><actuator name="a"><input>fcs/elevator-cmd-norm</input></actuator></channel>'
    )
    before = fdm[name]
    fdm[name] = 17.0
    assert fdm[name] == before
    assert read_only(name)
    assert not read_only("fcs/elevator-cmd-norm")


def test_levers_are_copied_before_the_channels() -> None:
    body = (
        "<channel><pure_gain"
        ' name="g"><input>fcs/throttle-pos-norm</input><gain>@2</gain></pure_gain></channel>'
    )
    difference, control = judged(
        body, {"fcs/throttle-cmd-norm": random_inputs(300)["i/a"]}, engines=1
    )
    assert difference == {}
    assert set(control) == {"fcs/g"}


def test_feathering_is_a_truth_value() -> None:
    body = (
        '<channel><pure_gain name="fcs/feather-pos-norm"><input>i/a</input><gain>.3</gain>'
        "<clipto><min>0</min><max>9</max></clipto></pure_gain>"
        '<pure_gain name="g"><input>fcs/feather-pos-norm</input><gain>@2</gain></pure_gain>'
        "</channel>"
    )
    difference, control = judged(body, random_inputs(300), engines=1)
    assert difference == {}
    assert "fcs/g" in control
