"""Streams of a branch: what they drive goes on, the normals behind the split are others."""

from __future__ import annotations

import numpy as np
import pytest

from uqharness.flight.dryden import PAGE_STEPS, DrydenGusts, dryden_parameters
from uqharness.flight.random_numbers import Normals, SplicedSource, Split
from uqharness.flight.spec import COEFFICIENTS, LevelDriver, TransientDriver
from uqharness.flight.stepping import Levels

SPLIT = Split(700, 3, 4, 1, 2)


def normals(seed):
    return Normals(np.random.PCG64(seed))


@pytest.mark.parametrize("calls", [[100], [30, 20, 50], [40, 60], [39, 61]])
def test_numbers_change_at_the_step_however_they_are_cut(calls):
    made = SplicedSource(normals(1), normals(2), 40)
    found = np.concatenate([made.take(n) for n in calls])
    np.testing.assert_array_equal(found[:40], normals(1).take(100)[:40])
    np.testing.assert_array_equal(found[40:], normals(2).take(60))


def test_rows_of_a_page_change_at_one_step():
    found = SplicedSource(normals(1), normals(2), 4, per_step=3).take(30).reshape(3, 10)
    before, behind = (
        normals(seed).take(3 * steps).reshape(3, steps) for seed, steps in ((1, 10), (2, 6))
    )
    np.testing.assert_array_equal(found, np.hstack([before[:, :4], behind]))


def test_gusts_keep_their_filters_and_get_other_noise():
    """At the split no component jumps further than a step of its own; ten seconds later nothing is
    left of the old air.
    """
    parameters = dryden_parameters(22.0, 100.0, 15.4, 3.66)
    step = min(SPLIT.frame, PAGE_STEPS - 100)
    own = DrydenGusts(parameters, 0.01, 5).page()
    other = DrydenGusts(parameters, 0.01, 5, splits=[Split(step, 3, 4, 1, 2)]).page()
    np.testing.assert_array_equal(other[:, :step], own[:, :step])
    assert (other[:, step + 1 :] != own[:, step + 1 :]).all()
    for k in range(4):
        steps = np.abs(np.diff(own[k]))
        assert abs(other[k, step] - other[k, step - 1]) < 1.5 * steps.max()
        assert abs(other[k, step] - own[k, step]) < 3.0 * steps.max()


def test_transient_levels_walk_on_and_epistemic_ones_are_not_touched():
    air = TransientDriver(13, 4, ("CX", "CZ"), (0.5, 0.8))
    own, other = (Levels(air, 0.01, splits=splits).take(900) for splits in ((), (SPLIT,)))
    np.testing.assert_array_equal(own[:701], other[:701])
    moving = [COEFFICIENTS.index(c) for c in air.coefficients]
    assert (own[702:, moving] != other[702:, moving]).all()
    assert (
        np.abs(np.diff(other[:, moving], axis=0)).max()
        < 2.0 * np.abs(np.diff(own[:, moving], axis=0)).max()
    )
    sample = LevelDriver("walk", 11, "e3", ("CX",), (0.03,))
    one, two = (Levels(sample, 0.01, splits=splits).take(900) for splits in ((), (SPLIT,)))
    np.testing.assert_array_equal(one, two)


def test_each_part_of_the_key_makes_another_stream():
    keys = [
        (700, 3, 4, 1, 2),
        (700, 9, 4, 1, 2),
        (700, 3, 9, 1, 2),
        (700, 3, 4, 9, 2),
        (700, 3, 4, 1, 9),
    ]
    streams = [
        Split(*key).stream(kind, number)
        for key in keys
        for kind, number in (("turbulence", 0), ("turbulence", 1), ("transient", 0))
    ]
    first = {int(np.random.PCG64(s).random_raw()) for s in streams}
    assert len(first) == len(streams)
    seeds = {Split(*key).seed(kind) for key in keys for kind in ("noise", "turbulence")}
    assert len(seeds) == 2 * len(keys)
    assert Split(700, 3, 4, 1, 2).seed("noise") == Split(900, 3, 4, 1, 2).seed("noise")
