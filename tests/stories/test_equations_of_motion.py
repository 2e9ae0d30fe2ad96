"""JSBSim's open-loop flight against an independent integration of the same equations, and that each
number matters.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest

from tests.helpers.against_equations import excess, fly, integrate
from tests.helpers.few import few
from tests.helpers.sixdof import TABLE_2_6, Airframe
from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.trim import SteadyCondition, find_trim

V, HEIGHT, DURATION, DT = 22.2, 100.0, 6.0, 0.001
DOUBLETS = {"elevator": 5.0, "aileron": 8.0, "rudder": 8.0}


@functools.cache
def nominal_trim():
    return find_trim(find_aircraft("espaaro"), SteadyCondition(V, altitude_m=HEIGHT))


def fly_doublet(control: str, changes: dict[str, float] | None = None):
    """States and surface positions of a doublet from the nominal trim."""
    size = DOUBLETS[control]
    steps = [(1.0, size), (1.5, -size), (2.0, 0.0)]
    more = (changes or {}).items()
    return fly("espaaro", nominal_trim(), V, HEIGHT, DURATION, DT, control, steps, more)


@functools.cache
def nominal(control: str):
    states, positions = fly_doublet(control)
    return states, integrate(Airframe(), states, positions, DT)


@pytest.mark.parametrize("control", DOUBLETS)
def test_doublet_agrees_to_one_percent(control):
    states, reference = nominal(control)
    ratio = excess(states, reference)
    assert all(value < 1.0 for value in ratio.values()), ratio


def disagrees(changes: dict[str, float]) -> bool:
    # "not below" rather than "above": a change that makes the flight diverge leaves NaN, and that
    # is seen too.
    return any(
        not ratio < 1.0
        for control in DOUBLETS
        for ratio in excess(fly_doublet(control, changes)[0], nominal(control)[1]).values()
    )


@pytest.mark.parametrize("name", few([key for key, value in TABLE_2_6.items() if value != 0.0], 3))
def test_a_flipped_coefficient_is_seen(name):
    assert disagrees({f"aero/{name}": -TABLE_2_6[name]})


def test_a_flipped_product_of_inertia_is_seen():
    states, positions = fly_doublet("aileron")
    invalid = integrate(Airframe(Ixz=-0.25), states, positions, DT)
    assert max(excess(states, invalid).values()) > 1.0


def test_every_term_counts_the_same_on_both_sides():
    # Also the four that Table 2.6 does not print and the model carries at zero.
    rng = np.random.default_rng(26)
    changed = {key: value * rng.uniform(0.8, 1.2) for key, value in TABLE_2_6.items()}
    changed |= {"CZ_q": -4.0, "Cm_dr": 0.0006, "Cl_de": 0.0003, "Cn_de": -0.0002}
    for control in DOUBLETS:
        changes = {f"aero/{key}": value for key, value in changed.items()}
        states, positions = fly_doublet(control, changes)
        reference = integrate(Airframe(coefficients=changed), states, positions, DT)
        ratio = excess(states, reference)
        assert all(value < 1.0 for value in ratio.values()), (control, ratio)
