"""What the auxiliary model publishes, beside what one-frame tests look at (test_motion)."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.batch_flights import (
    METRICS,
    START,
    aircraft,
    by_batch,
    by_jsbsim,
    compared,
    craft,
    worst,
)
from uqharness.batch.models import auxiliary

RECORDS = (
    *(f"velocities/{a}-aero-fps" for a in "uvw"),
    *(f"velocities/{a}-aero-rad_sec" for a in "pqr"),
    "velocities/machU",
    "aero/qbarUW-psf",
    "aero/qbarUV-psf",
    "aero/alpha-deg",
    "aero/beta-deg",
    "aero/mag-beta-deg",
    "aero/mag-beta-rad",
    "aero/alphadot-deg_sec",
    "aero/betadot-deg_sec",
    "aero/h_b-cg-ft",
    "aero/h_b-mac-ft",
    "flight-path/gamma-deg",
    *(f"accelerations/n-pilot-{a}-norm" for a in "xyz"),
    *(f"velocities/{n}-velocity-mag-fps" for n in ("eci", "ned")),
    *(f"position/from-start-neu-{a}-ft" for a in "neu"),
    *(f"attitude/{n}-rad" for n in ("roll", "pitch", "heading-true")),
    *(f"attitude/{n}-deg" for n in ("phi", "theta", "psi")),
    "position/lat-geod-deg",
    "position/long-gc-deg",
    "position/h-sl-meters",
)
BODY = """<system name='s'><property>i/a</property><channel name='c'><pure_gain name='s/north'>
<input>position/from-start-neu-n-ft</input>
<gain>1</gain></pure_gain><pure_gain name='s/alpha'><input>aero/alpha-rad</input><gain>1</gain></pure_gain></channel></system>
<aerodynamics><axis name='Z'>
<function name='f/z'><sum><p>i/a</p><product><p>aero/alpha-rad</p><v>-30</v></product></sum></function></axis>
<axis name='PITCH'><function name='f/m'><p>i/a</p></function></axis></aerodynamics>"""
DRIVEN = {
    "i/a": np.random.default_rng(2).normal(size=31) * 4.0,
    "atmosphere/wind-north-fps": np.linspace(0.0, 20.0, 31),
}


@pytest.mark.parametrize(
    "start",
    [
        {},
        {"ic/u-fps": -40.0},
        {"ic/u-fps": 0.0, "ic/v-fps": 0.0, "ic/w-fps": 0.0},
        {"ic/lat-geod-rad": -1.2, "ic/theta-rad": -1.4},
    ],
)
def test_as_in_jsbsim(start):
    found = compared(
        aircraft(BODY), (*RECORDS, "s/north", "s/alpha"), DRIVEN, 30, {**START, **start}, floor=0.1
    )
    # A place is a difference of lengths of 2e7 ft.
    places = {
        name: found.pop(name)
        for name in (*RECORDS, "s/north")
        if name in found and ("neu" in name or name == "s/north")
    }
    assert worst(found) < 1e-10
    assert worst(places) < 3e-8


def test_at_rest_incidence_is_nought():
    start = {**START, "ic/u-fps": 0.0, "ic/v-fps": 0.0, "ic/w-fps": 0.0}
    names = (
        "aero/alpha-rad",
        "aero/beta-rad",
        "aero/alphadot-rad_sec",
        "aero/betadot-rad_sec",
        "velocities/vt-fps",
    )
    with craft(aircraft("<aerodynamics/>"), start) as made:
        theirs, ours = by_jsbsim(made.open(), {}, names, 3), by_batch(made, {}, names, 3)
    assert all(ours[name][0] == theirs[name][0] == 0.0 for name in names[:4])
    assert all(ours[name] == pytest.approx(theirs[name], abs=1e-9) for name in names)


def test_the_span_and_the_limit_of_speed_are_noticed(monkeypatch):
    changed = aircraft(BODY, METRICS.replace(">10</wingspan>", ">10.00001</wingspan>"))
    assert worst(compared(aircraft(BODY), RECORDS, DRIVEN, 5, changed=changed)) > 1e-8
    monkeypatch.setattr(auxiliary, "_MIN_SPEED", 1e6)
    assert worst(compared(aircraft(BODY), RECORDS, DRIVEN, 5)) > 1e-3


def test_systems_see_positions_and_incidence_of_the_frame_before():
    """A system that read them in the same frame would be noticed."""
    names = ("position/from-start-neu-n-ft", "s/north", "aero/alpha-rad", "s/alpha")
    with craft(aircraft(BODY)) as made:
        fdm = made.open()
        for name, values in DRIVEN.items():
            fdm[name] = float(values[0])
        ours = by_batch(made, DRIVEN, names, 30)
    assert ours["s/north"][1:] == pytest.approx(ours[names[0]][:-1], abs=1e-9)
    assert ours["s/alpha"][1:] == pytest.approx(ours["aero/alpha-rad"][:-1], abs=1e-12)
    assert np.abs(ours["s/north"] - ours[names[0]]).max() > 0.1
