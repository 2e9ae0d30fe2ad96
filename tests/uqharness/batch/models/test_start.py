"""The start state against JSBSim's after its initialisation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.helpers.batch_flights import aircraft, compared, craft, worst
from tests.helpers.batch_states import attitude
from uqharness.batch.models.motion import CONDITIONS, round_44_bits, start_state
from uqharness.simulator import engine

RECORDS = (
    *(f"position/eci-{a}-ft" for a in "xyz"),
    *(f"velocities/eci-{a}-fps" for a in "xyz"),
    *(f"velocities/{a}i-rad_sec" for a in "pqr"),
    *(f"velocities/{a}-fps" for a in "uvw"),
    *(f"attitude/{a}-rad" for a in ("phi", "theta", "psi")),
    "position/geod-alt-ft",
    "position/lat-geod-rad",
    "position/long-gc-rad",
    "velocities/vt-fps",
    "aero/alpha-rad",
    "aero/beta-rad",
)


def random_start(seed):
    rng = np.random.default_rng(seed)
    return {
        "ic/lat-geod-deg": rng.uniform(-85.0, 85.0),
        "ic/long-gc-deg": rng.uniform(-180.0, 180.0),
        "ic/h-sl-ft": rng.uniform(0, 3e4),
        "ic/psi-true-deg": rng.uniform(0.0, 360.0),
        "ic/theta-deg": rng.uniform(-80.0, 80.0),
        "ic/phi-deg": rng.uniform(-180.0, 180.0),
        "ic/u-fps": rng.uniform(20.0, 500.0),
        "ic/v-fps": rng.normal() * 20.0,
        "ic/w-fps": rng.normal() * 20.0,
        "ic/p-rad_sec": rng.normal(),
        "ic/q-rad_sec": rng.normal(),
        "ic/r-rad_sec": rng.normal(),
    }


def by_airspeed(seed):
    rng = np.random.default_rng(seed)
    return {
        "ic/h-sl-ft": rng.uniform(0.0, 2e4),
        "ic/psi-true-deg": rng.uniform(0.0, 360.0),
        "ic/vt-fps": rng.uniform(50.0, 200.0),
        "ic/alpha-deg": rng.normal() * 4.0,
        "ic/beta-deg": rng.normal() * 4.0,
        "ic/vw-mag-fps": 20.0,
        "ic/vw-dir-deg": 70.0,
    }


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("made", [random_start, by_airspeed])
def test_jsbsims_state_behind_its_initialisation(made, seed):
    """Conditions are taken to 44 bits, which is 3e-14 of each."""
    wind = made is by_airspeed
    names = [
        name
        for name in RECORDS
        if not (wind and name.startswith("aero/")) and not (wind and name == "velocities/vt-fps")
    ]
    assert (
        worst(compared(aircraft("<aerodynamics/>"), names, frames=0, start=made(seed), floor=1.0))
        < 3e-12
    )


@pytest.mark.parametrize("name", [name for name in CONDITIONS if "fps" in name or "rad" in name])
def test_each_condition_a_little_off_is_noticed(name):
    with craft(aircraft("<aerodynamics/>"), random_start(3)) as made:
        fdm = made.open()
        given = {name: np.array([fdm[name]]) for name in CONDITIONS}
        engine.run_ic(fdm)
        wanted = [fdm[f"position/eci-{a}-ft"] for a in "xyz"] + [
            fdm[f"velocities/eci-{a}-fps"] for a in "xyz"
        ]
        wanted += [fdm[f"velocities/{a}i-rad_sec"] for a in "pqr"]
        turned = attitude(fdm)
    parts = [("position", 3, 2e7), ("velocity", 3, 1e3), ("rates", 3, 1.0), ("attitude", 4, 1.0)]
    sizes = np.concatenate([np.full(count, size) for _, count, size in parts])

    def gap(conditions):
        found = start_state(conditions)
        ours = np.array(
            [found[f"#{part}/{k}"][0] for part, count, _ in parts for k in range(count)]
        )
        sign = np.sign(ours[-4:] @ turned)
        return float(np.max(np.abs(ours - [*wanted, *(sign * turned)]) / sizes))

    assert gap(given) < 1e-12
    assert gap({**given, name: given[name] * (1.0 + 1e-8)}) > 1e-11


def test_lanes_do_not_mix():
    many = {
        name: np.array([one[name] for one in (_conditions(0), _conditions(1), _conditions(2))])
        for name in CONDITIONS
    }
    together = start_state(many)
    for lane in range(3):
        alone = start_state({name: values[lane : lane + 1] for name, values in many.items()})
        assert all(together[name][lane] == alone[name][0] for name in alone)


def _conditions(seed):
    rng = np.random.default_rng(seed)
    return {name: float(rng.normal()) for name in CONDITIONS}


def test_rounded_keeps_44_bits():
    assert round_44_bits(0.1) == round(0.1 * 2**47) / 2**47
    assert round_44_bits(1.0 + 2.0**-43) == 1.0 + 2.0**-43
    assert round_44_bits(1.0 + 2.0**-46) == 1.0
    assert round_44_bits(-3e7) == -3e7
    assert math.isnan(round_44_bits(math.nan))
    assert round_44_bits(math.inf) == math.inf
    # The last places of a sine, which differ between machines.
    assert round_44_bits(math.sin(0.7)) == round_44_bits(math.nextafter(math.sin(0.7), 1.0))
