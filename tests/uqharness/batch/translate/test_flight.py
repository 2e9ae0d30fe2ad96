"""A frame as a whole: order of the models, inputs, records and settings."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.batch_flights import START, aircraft, compared, craft, translated, worst
from uqharness.errors import BadInputError

LATE = (
    "aero/alpha-rad",
    "aero/qbar-psf",
    "velocities/vt-fps",
    "accelerations/Nz",
    "accelerations/udot-ft_sec2",
    "forces/fbz-total-lbs",
    "moments/m-total-lbsft",
    "velocities/vg-fps",
    "aero/h_b-mac-ft",
    "flight-path/gamma-rad",
    "external_reactions/push/magnitude",
)
NOW = (
    "velocities/u-fps",
    "attitude/theta-rad",
    "position/h-agl-ft",
    "velocities/q-rad_sec",
    "atmosphere/rho-slugs_ft3",
    "atmosphere/total-wind-north-fps",
    "simulation/sim-time-sec",
    "velocities/v-down-fps",
)
GAINS = "".join(
    f"<pure_gain name='seen/n{number}'><input>{name}</input><gain>1</gain></pure_gain>"
    for number, name in enumerate((*LATE, *NOW))
)
BODY = f"""<system name='s'><property value='3'>external_reactions/push/magnitude</property><property value='2'>i/size</property>
<channel name='c'>{GAINS}<summer name='s/size'><input>i/size</input><input>seen/n0</input></summer></channel></system>
<aerodynamics><axis name='Z'>
<function name='f/z'><product><p>aero/alpha-rad</p><p>aero/qbar-psf</p><v>-9</v></product></function></axis>
<axis name='PITCH'>
<function name='f/m'><product><p>external_reactions/push/magnitude</p><v>.1</v></product></function></axis></aerodynamics>
<external_reactions><force name='push' frame='BODY'><location unit='IN'><x>0</x><y>0</y><z>3</z></location>
<direction><x>1</x><y>0</y><z>0</z></direction></force></external_reactions>"""
RECORDS = (
    *(f"seen/n{number}" for number in range(len(LATE) + len(NOW))),
    "s/size",
    "velocities/u-fps",
)
INPUTS = {
    "atmosphere/wind-north-fps": np.linspace(0.0, 9.0, 21),
    "external_reactions/push/magnitude": np.sin(np.arange(21.0)) * 5.0,
}


def test_systems_see_what_jsbsims_see():
    """Motion and air of this frame, forces, incidence and accelerations of the frame before."""
    found = compared(aircraft(BODY), RECORDS, INPUTS, 20, START)
    assert worst(found) < 1e-10


def test_another_order_is_noticed(monkeypatch):
    """Winds behind the systems: they would see the wind of the frame before."""
    from uqharness.batch.models import winds
    from uqharness.batch.translate import flight

    trace = flight.Systems.trace

    def swapped(self, frame, first=False):
        trace(self, frame, first)
        winds.trace_winds(frame)

    monkeypatch.setattr(flight.Systems, "trace", swapped)
    monkeypatch.setattr(flight, "winds", _Without(winds))
    assert worst(compared(aircraft(BODY), RECORDS, INPUTS, 20, START)) > 1e-3


class _Without:
    """The module, but its winds are left out here."""

    def __init__(self, module):
        self._module = module

    def __getattr__(self, name):
        return (lambda frame: None) if name == "trace_winds" else getattr(self._module, name)


def test_inputs_differ_between_lanes_and_constants_are_folded():
    with craft(aircraft(BODY)) as made:
        plain = translated(made, RECORDS)
        varying = translated(made, RECORDS, varying=["i/size", "metrics/bw-ft"])
    assert "i/size" not in plain.frame.slots
    assert "metrics/bw-ft" not in plain.frame.slots
    assert {"i/size", "metrics/bw-ft"} <= set(varying.frame.slots)


def test_what_is_not_computed_cannot_be_recorded():
    with (
        craft(aircraft(BODY)) as made,
        pytest.raises(BadInputError, match="position/vrp-radius-ft is not computed"),
    ):
        translated(made, ["position/vrp-radius-ft"])


@pytest.mark.parametrize(
    ("start", "said"),
    [
        ({"simulation/gravity-model": 0.0}, "simulation/gravity-model = 0"),
        (
            {"simulation/integrator/rate/rotational": 8.0},
            "simulation/integrator/rate/rotational = 8",
        ),
        ({"simulation/gravitational-torque": 1.0}, "simulation/gravitational-torque = 1"),
        ({"forces/hold-down": 1.0}, "forces/hold-down = 1"),
    ],
)
def test_settings_that_are_refused(start, said):
    with (
        craft(aircraft(BODY), {**START, **start}) as made,
        pytest.raises(BadInputError, match=said),
    ):
        translated(made, RECORDS)


def test_gravitational_torque_is_more_than_rounding():
    """So it is refused, not left out."""
    from tests.helpers.batch_flights import by_jsbsim

    names = ["accelerations/pdot-rad_sec2", "accelerations/qdot-rad_sec2"]
    with craft(
        aircraft("<aerodynamics/>"), {**START, "simulation/gravitational-torque": 1.0}
    ) as made:
        one = by_jsbsim(made.open(), {}, names, 2)
    with craft(aircraft("<aerodynamics/>"), START) as made:
        other = by_jsbsim(made.open(), {}, names, 2)
    assert max(abs(one[name][-1] - other[name][-1]) for name in names) > 1e-9
