"""Constants of side force, roll and yaw: one property an axis, of aircraft that have scales and
biases.
"""

from __future__ import annotations

from uqharness.identification.excitation import lateral_constants
from uqharness.plugin import with_card
from uqharness.replay import ReplayFolder
from uqharness.simulator import find_aircraft


def test_an_aircraft_with_scales_has_one_for_each_lateral_axis() -> None:
    with ReplayFolder(with_card(find_aircraft("c172p"))) as model:
        assert lateral_constants(model) == ("uq/bias/CYb", "uq/bias/Clb", "uq/bias/Cnb")


def test_an_aircraft_with_coefficient_terms_has_none() -> None:
    with ReplayFolder(find_aircraft("espaaro")) as model:
        assert lateral_constants(model) == ()
