"""The Levels' edges in the complex plane, against the Levels that `assess` gives to poles on either
side of them.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from uqharness.flight.handling import (
    CATEGORIES,
    CLASSES,
    OSCILLATORY,
    assess,
    cap_limits,
    level_edges,
    root_limits,
)
from uqharness.simulator.linear import Mode

IMAG = np.array([0.05, 0.3, 0.9, 2.0, 7.0])
STEP = 1e-6


def mode(name, real, imag=0.0):
    wn = math.hypot(real, imag)
    return Mode(name, real, imag, wn, -real / wn)


def level_of(name, found, category, aircraft_class):
    """Level of one mode's first criterion, all others well inside Level 1."""
    A = np.zeros((8, 8))
    A[2, 2] = -5.0
    model = SimpleNamespace(A=A, trim=SimpleNamespace(condition=SimpleNamespace(V_mps=20.0)))
    usual = {
        "short_period": mode("short_period", -2.0, 1.0),
        "phugoid": mode("phugoid", -0.1, 0.3),
        "dutch_roll": mode("dutch_roll", -1.0, 3.0),
        "roll": mode("roll", -5.0),
        "spiral": mode("spiral", -0.1),
    } | {name: found}
    return next(
        a.level
        for a in assess(model, list(usual.values()), category, aircraft_class)
        if a.mode == name
    )


@pytest.mark.parametrize("name", OSCILLATORY)
@pytest.mark.parametrize("category", CATEGORIES)
@pytest.mark.parametrize("aircraft_class", CLASSES)
def test_a_pole_left_of_an_edge_has_the_level_and_one_right_of_it_has_not(
    name, category, aircraft_class
):
    edges = level_edges(name, category, aircraft_class, IMAG)
    for number, edge in enumerate(edges, start=1):
        for real, imag in zip(edge, IMAG, strict=True):
            assert level_of(name, mode(name, real - STEP, imag), category, aircraft_class) <= number
            assert level_of(name, mode(name, real + STEP, imag), category, aircraft_class) > number


@pytest.mark.parametrize("name", ["roll", "spiral"])
@pytest.mark.parametrize("category", CATEGORIES)
@pytest.mark.parametrize("aircraft_class", CLASSES)
def test_a_real_root_below_a_limit_has_the_level_and_one_above_has_not(
    name, category, aircraft_class
):
    for number, limit in enumerate(root_limits(name, category, aircraft_class), start=1):
        assert (
            level_of(
                name,
                mode(name, limit * (1.0 - math.copysign(STEP, limit))),
                category,
                aircraft_class,
            )
            <= number
        )
        assert (
            level_of(
                name,
                mode(name, limit * (1.0 + math.copysign(STEP, limit))),
                category,
                aircraft_class,
            )
            > number
        )


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


def test_a_mode_that_has_no_such_edge_is_refused():
    with pytest.raises(ValueError, match="allowed"):
        level_edges("roll", "B", "I", IMAG)
    with pytest.raises(ValueError, match="allowed"):
        root_limits("phugoid", "B", "I")
