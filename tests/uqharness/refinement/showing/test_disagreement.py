"""Where model and flights disagree: planted disagreements are found where they were planted, and
nowhere else.
"""

from __future__ import annotations

import re

import numpy as np
import pytest

from uqharness.refinement.residual_location import disagreements

N, DT = 600, 0.02


def flights(seed: int = 0):
    """Two pulls and a roll without disagreement: gap, allowed, states, labels."""
    rng = np.random.default_rng(seed)
    gap = [rng.standard_normal((N, 6)) for _ in range(3)]
    states = [
        {"alpha_rad": rng.uniform(0.0, 0.3, N), "V_mps": rng.uniform(18.0, 24.0, N)}
        for _ in range(3)
    ]
    return gap, [np.ones((N, 6))] * 3, states, ["pull", "roll", "pull"]


def test_what_noise_allows_is_no_disagreement():
    assert disagreements(*flights(), DT) == []


def test_a_planted_disagreement_is_found_where_it_is():
    gap, allowed, states, labels = flights()
    for k in (0, 2):
        gap[k][states[k]["alpha_rad"] > 0.2, 2] += 6.0
    (result,) = disagreements(gap, allowed, states, labels, DT)
    assert (result["coefficient"], result["manoeuvre"]) == ("CZ", "pull")
    assert result["region"] == {"alpha_rad": pytest.approx([0.2, 0.3], abs=0.01)}
    assert result["share_outside_95"] > 0.95
    assert result["size"] == pytest.approx(np.sqrt(37.0), rel=0.03)
    outside_s, total_s = map(
        float, re.search(r" ([\d.]+) s of ([\d.]+) s;", result["words"]).groups()
    )
    assert total_s == pytest.approx(2 * N * DT)
    assert outside_s == pytest.approx(2 * N * DT / 3, rel=0.1)
    assert result["words"].startswith("CZ, pull, alpha_rad 0.2")
    # With as much allowed there is nothing to say, and in half a second too little.
    assert disagreements(gap, [7.0 * a for a in allowed], states, labels, DT) == []
    assert disagreements(gap, allowed, states, labels, DT / 40) == []


def test_the_worst_come_first():
    gap, allowed, states, labels = flights()
    gap[1][:, 3] += 3.0
    gap[1][:, 5] += 9.0
    result = disagreements(gap, allowed, states, labels, DT)
    assert [d["coefficient"] for d in result] == ["Cn", "Cl"]
