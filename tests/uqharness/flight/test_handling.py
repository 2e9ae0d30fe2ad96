"""Levels of MIL-F-8785C on either side of their limits; modes over airspeed."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import replace
from itertools import chain
from types import SimpleNamespace

import numpy as np
import pytest

from uqharness.flight.handling import (
    assess,
    cap_limits,
    level_edges,
    locus_point,
    root_limits,
    root_locus,
)
from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.linear import Mode, linearise, modes
from uqharness.simulator.trim import SteadyCondition, find_trim


def test_levels_follow_the_specification():
    aircraft = find_aircraft("espaaro")
    model = linearise(aircraft, find_trim(aircraft, SteadyCondition(22.2)))
    result = modes(model)
    levels = {(a.mode, a.criterion): a.level for a in assess(model, result)}
    # Hand-checked against MIL-F-8785C, category B, class I: CAP 4.7 lies between 3.6 and 10, so
    # Level 2.
    assert levels == {
        ("short_period", "damping"): 1,
        ("short_period", "CAP"): 2,
        ("phugoid", "damping"): 1,
        ("dutch_roll", "damping"): 1,
        ("roll", "time constant"): 1,
        ("spiral", "time to double"): 1,
    }
    unstable = [
        dataclasses.replace(m, real=0.05, zeta=-1.0) if m.name == "spiral" else m for m in result
    ]
    # Doubles in 13.9 s: Level 1 in category C (12 s), Level 2 in category B (20 s).
    assert {a.level for a in assess(model, unstable, "C") if a.mode == "spiral"} == {1}
    assert {a.level for a in assess(model, unstable, "B") if a.mode == "spiral"} == {2}
    with pytest.raises(ValueError, match="allowed"):
        assess(model, result, "D")


def model(z_w=-4.903325, speed=20.0):
    """n/alpha = -Z_w V/g; 10 g/rad unless told."""
    A = np.zeros((8, 8))
    A[2, 2] = z_w
    return SimpleNamespace(A=A, trim=SimpleNamespace(condition=SimpleNamespace(V_mps=speed)))


def pair(name, zeta, wn):
    return Mode(name, -zeta * wn, wn * math.sqrt(1.0 - zeta**2), wn, zeta)


def real(name, value):
    return Mode(name, value, 0.0, abs(value), -math.copysign(1.0, value))


def levels(category="B", aircraft_class="I", **changes):
    result = {
        "short_period": [pair("short_period", 0.7, 2.0)],
        "phugoid": [pair("phugoid", 0.1, 0.5)],
        "dutch_roll": [pair("dutch_roll", 0.2, 3.0)],
        "roll": [real("roll", -5.0)],
        "spiral": [real("spiral", -0.1)],
    } | changes
    return {
        (a.mode, a.criterion): a.level
        for a in assess(model(), list(chain(*result.values())), category, aircraft_class)
    }


@pytest.mark.parametrize(
    ("category", "zeta", "level"),
    [
        ("A", 0.36, 1),
        ("A", 0.34, 2),
        ("B", 0.34, 1),
        ("B", 0.29, 2),
        ("B", 0.19, 3),
        ("B", 0.14, 4),
        ("C", 0.24, 3),
    ],
)
def test_short_period_damping_levels(category, zeta, level):
    assert (
        levels(category, short_period=[pair("short_period", zeta, 2.0)])["short_period", "damping"]
        == level
    )


@pytest.mark.parametrize(
    ("category", "kind", "constant", "level"),
    [
        ("B", "I", 1.3, 1),
        ("A", "I", 1.3, 2),
        ("A", "III", 1.3, 1),
        ("A", "III", 2.9, 2),
        ("B", "I", 9.9, 3),
        ("B", "I", 10.1, 4),
    ],
)
def test_roll_levels(category, kind, constant, level):
    assert (
        levels(category, kind, roll=[real("roll", -1.0 / constant)])["roll", "time constant"]
        == level
    )
    assert levels(roll=[real("roll", 0.1)])["roll", "time constant"] == 4


@pytest.mark.parametrize(("double", "level"), [(6.1, 3), (5.9, 4), (0.8, 4)])
def test_a_longitudinal_divergence(double, level):
    """MIL-F-8785C 3.2.1.1: none at Levels 1 and 2, not below 6 s at Level 3."""
    roots = [real("phugoid", -0.5), real("phugoid", math.log(2.0) / double)]
    result = {key: value for key, value in levels(phugoid=roots).items() if key[0] == "phugoid"}
    assert result == {("phugoid", "divergence, time to double"): level}


@pytest.mark.parametrize(("product", "level"), [(0.51, 1), (0.31, 2), (0.16, 3), (0.14, 4)])
def test_a_coupled_roll_spiral_oscillation(product, level):
    union = {"roll": [], "spiral": [], "other": [pair("other", product, 1.0)]}
    key = ("other", "coupled roll-spiral, zeta wn")
    assert levels(**union)[key] == level
    assert levels("A", **union)[key] == 4


# The Levels' edges in the complex plane, against the Levels that `assess` gives to poles on
# either side of them.


def test_edges_as_the_specification_prints_them():
    """Category B, class I at 1 rad/s: damping 0.3, 0.2, 0.15; T2 of 55 s; a spiral that doubles in
    20 s; CAP 0.085 to 3.6.
    """
    first, second, third = (float(e[0]) for e in level_edges("short_period", "B", "I", np.ones(1)))
    assert [-e / math.hypot(e, 1.0) for e in (first, second, third)] == pytest.approx(
        [0.30, 0.20, 0.15]
    )
    assert level_edges("phugoid", "B", "I", np.ones(1))[2][0] == pytest.approx(0.0126, abs=1e-4)
    assert root_limits("spiral", "B", "I")[0] == pytest.approx(0.03466, abs=1e-5)
    assert cap_limits("B") == ((0.085, 3.6), (0.038, 10.0))


# Modes over airspeed: each point is what the modes at that speed are alone, and a speed without
# a trim has its reason.

CONDITION = SteadyCondition(22.0)


@pytest.fixture(scope="module")
def espaaro():
    return find_aircraft("espaaro")


@pytest.fixture(scope="module")
def first(espaaro):
    return locus_point(linearise(espaaro, find_trim(espaaro, CONDITION)), "B", "I")


def test_points_are_the_modes_at_their_speeds(espaaro, first):
    observed = []
    result = root_locus(
        espaaro,
        CONDITION,
        (18.0, 26.0),
        "B",
        "I",
        first=first,
        callback=lambda done, total: observed.append((done, total)),
    )
    assert [p.V_mps for p in result.points] == [18.0, 22.0, 26.0]
    assert result.refused == ()
    assert observed == [(1, 2), (2, 2)]
    single = modes(linearise(espaaro, find_trim(espaaro, replace(CONDITION, V_mps=18.0))))
    assert [(m.name, m.real, m.imag) for m in result.points[0].modes] == [
        (m.name, m.real, m.imag) for m in single
    ]
    assert result.points[1] is first
    # n/alpha = q S CLalpha / (m g) grows with the square of the airspeed.
    assert result.points[2].n_alpha / result.points[0].n_alpha == pytest.approx(
        (26.0 / 18.0) ** 2, rel=0.02
    )
