"""Properties of JSBSim's flight control model that move together, against JSBSim, bit for bit."""

from __future__ import annotations

import pytest

from tests.helpers import batch_oracle as oracle
from tests.helpers.batch_systems import judged, random_inputs
from uqharness.batch.translate.frame import HOOKS, read_only


@pytest.mark.parametrize("name", [name for name in HOOKS if "feather" not in name])
def test_a_surface_moves_in_all_units(name: str) -> None:
    body = (
        "<channel><pure_gain"
        f' name="{name}"><input>i/a</input><gain>@.3</gain></pure_gain></channel>'
    )
    apart, control = judged(body, random_inputs(300))
    assert apart == {}
    assert (
        len(control) == 3
        if "flap" not in name and "brake" not in name and "spoiler" not in name
        else 2
    )


@pytest.mark.parametrize(
    "name", ["fcs/mag-elevator-pos-rad", "simulation/channel-dt", "fcs/a/saturated"]
)
def test_what_takes_no_value(name: str) -> None:
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
    apart, control = judged(body, {"fcs/throttle-cmd-norm": random_inputs(300)["i/a"]}, engines=1)
    assert apart == {}
    assert set(control) == {"fcs/g"}


def test_feathering_is_a_truth_value() -> None:
    body = (
        '<channel><pure_gain name="fcs/feather-pos-norm"><input>i/a</input><gain>.3</gain>'
        "<clipto><min>0</min><max>9</max></clipto></pure_gain>"
        '<pure_gain name="g"><input>fcs/feather-pos-norm</input><gain>@2</gain></pure_gain>'
        "</channel>"
    )
    apart, control = judged(body, random_inputs(300), engines=1)
    assert apart == {}
    assert "fcs/g" in control
