"""The joint confidence set against scipy's chi-square, and its points against the ball's own
geometry.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from uqharness.campaign import sampling


@pytest.mark.parametrize("dof", [1, 2, 3, 5, 6, 12])
@pytest.mark.parametrize("confidence", [0.5, 0.68, 0.95, 0.999])
def test_the_radius_is_chi_squares(dof, confidence):
    wanted = math.sqrt(stats.chi2.ppf(confidence, dof))
    assert sampling.joint_radius(dof, confidence) == pytest.approx(wanted, rel=1e-12)
    assert sampling.joint_radius(dof + 1, confidence) > 1.02 * wanted


def test_six_intervals_of_95_percent():
    assert sampling.joint_radius(6, 0.95) == pytest.approx(3.5485, abs=5e-5)
    assert sampling.marginal_radius(0.95) == pytest.approx(1.95996, abs=5e-6)
    assert sampling.joint_reach(6, 0.95) == pytest.approx(3.5485 / 1.95996, abs=1e-4)
    assert sampling.joint_reach(1, 0.95) == 1.0
    # What it claims: as many of six normals lie within. A corner's own radius, z sqrt(6), holds
    # more.
    drawn = np.linalg.norm(np.random.default_rng(3).standard_normal((200_000, 6)), axis=1)
    assert np.mean(drawn < sampling.joint_radius(6, 0.95)) == pytest.approx(
        0.95, abs=4.0 * math.sqrt(0.95 * 0.05 / 200_000)
    )
    assert np.mean(drawn < math.sqrt(6.0) * sampling.marginal_radius(0.95)) > 0.99


@pytest.mark.parametrize(("dof", "confidence"), [(0, 0.95), (6, 0.0), (6, 1.0)])
def test_impossible_sets_are_refused(dof, confidence):
    with pytest.raises(ValueError, match="at least 1"):
        sampling.joint_radius(dof, confidence)


def test_the_box_becomes_the_ball():
    corner = sampling.box_to_ball([1.0] * 6)
    assert corner == pytest.approx([1.0 / math.sqrt(6.0)] * 6)
    assert sampling.box_to_ball([0.5, 0.0]) == (0.0, -1.0)
    assert sampling.box_to_ball([0.5] * 3) == (0.0, 0.0, 0.0)
    points = np.random.default_rng(1).random((500, 4))
    lengths = np.linalg.norm([sampling.box_to_ball(p) for p in points], axis=1)
    assert lengths == pytest.approx(np.abs(2.0 * points - 1.0).max(axis=1))
    assert sampling.levels_at([1.0, 0.0], 1.8) == (1.4, 0.5)
