"""Candidate models: where they begin, and numbers that JSBSim reads only once."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sysid.effects.information import Information, normal_equations
from sysid.effects.selection import SelectedEffect, Selection
from tests.helpers.whitened import whitened
from uqharness.identification.linearised import ModelState
from uqharness.refinement.candidate_model import CandidateModel, joint_point, secant_step
from uqharness.replay.replay import STATES

NAMES = ("aero/a", "effect/one", "effect/two")


def information(values: tuple[float, ...]) -> Information:
    """Two segments whose residual contains each column ``values`` times."""
    rng = np.random.default_rng(0)
    segments = []
    for _ in range(2):
        columns = rng.standard_normal((400, 2, len(NAMES)))
        start = rng.standard_normal((8, 1 + len(NAMES)))
        segments.append(whitened(columns @ np.array(values), columns, start))
    return normal_equations(segments, NAMES, [0, 1], {})


def test_parameters_and_start_states_move_with_the_effects():
    reference = information((2.0, 3.0, 0.0))
    starts = (np.zeros(9), np.ones(9))
    point = ModelState({"aero/a": 10.0}, {}, starts)
    plain = ModelState({"aero/a": 1.0, "aero/b": 7.0}, {}, starts)
    about = SimpleNamespace(
        fit=SimpleNamespace(trajectory=SimpleNamespace(point=point)),
        information=reference,
        values={"effect/two": 0.5},
    )
    context = SimpleNamespace(
        data=SimpleNamespace(active=(), carriers={}, nuisance=(), jumping=()),
        baseline_fit=SimpleNamespace(trajectory=SimpleNamespace(point=plain)),
        free=["aero/a"],
        limits={},
    )
    result = joint_point(context, about, ["effect/one"])  # type: ignore[arg-type]
    assert result.values == pytest.approx({"aero/a": 12.0, "aero/b": 7.0}, abs=1e-5)
    V = STATES.index("V_mps")
    for moved, start, w in zip(result.starts, starts, reference.white, strict=True):
        # Two of a and three of one more than was flown, and a half of the other less.
        expected = w.start[0] @ [1.0, 2.0, 3.0, -0.5]
        assert moved[V] - start[V] == pytest.approx(expected, abs=1e-4)
    context.limits["aero/a"] = (0.0, 11.0)
    clipped = joint_point(context, about, ["effect/one"])  # type: ignore[arg-type]
    assert clipped.values["aero/a"] == 11.0


@pytest.mark.parametrize(
    ("flown_s", "distant", "stationary"),
    [(0.0626, False, True), (0.0622, False, False), (0.0454, True, False)],
)
def test_a_number_read_once_is_stationary_within_half_a_standard_error(
    flown_s, distant, stationary
):
    selection = Selection((SelectedEffect("lag", 0.0626, 2e-4, 9.0, 81.0, 1.0, 0.0),))
    model = CandidateModel(
        None,
        None,
        None,
        selection,
        selection,
        0.0,
        None,
        read_once={"lag": flown_s},  # type: ignore
    )
    assert model.not_converged == ({"lag": flown_s} if distant else {})
    assert model.is_stationary is stationary


def test_the_secant_reaches_a_lag_whose_slope_falls_off():
    """The flights have a lag of 0.16 s, and linearisation sees a third of the difference."""
    value, last, steps = 0.04, None, 0
    while abs(0.16 - value) > 1e-3:
        current = (value, (0.16 - value) / 3.0)
        value += secant_step(last, current)
        last, steps = current, steps + 1
    assert steps <= 4
    # Never further than twice the value; no secant of two equal values.
    assert secant_step((1.0, 0.5), (1.1, 0.499)) == pytest.approx(1.1)
    assert secant_step((1.0, 0.5), (1.0, 0.2)) == 0.2
