"""What is told of candidates that were not chosen."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sysid.effects import CERTAIN_T, conditional_interval
from sysid.effects.catalogue import coefficient_effect
from sysid.effects.information import Information
from sysid.effects.selection import SelectedEffect
from uqharness.refinement.baseline import offset_tolerance_s
from uqharness.refinement.document import still_significant
from uqharness.refinement.effect_search import strong_candidates
from uqharness.refinement.search_result import SearchResult, chosen_interval


def evidence(strengths: dict[str, float], likeness: float = 0.0) -> Information:
    """A parameter and candidates of unit information each; a and b as alike as asked; the flights
    ask for ``strengths``.
    """
    names = ("aero/Cm_q", *strengths)
    gram = np.eye(len(names))
    gram[1, 2] = gram[2, 1] = likeness
    score = gram @ np.array([0.0, *strengths.values()])
    return Information(
        names, gram[None], score[None], np.zeros(1, dtype=int), np.zeros(len(names)), ()
    )


def test_every_strong_candidate_beside_the_chosen_is_told_the_strongest_first():
    result = evidence({"effect/a": 30.0, "effect/b": 12.0, "effect/c": -25.0, "effect/d": 9.0})
    keys = ["effect/a", "effect/b", "effect/c", "effect/d"]
    assert [k for k, _ in strong_candidates(result, ["aero/Cm_q"], ["effect/a"], keys)] == [
        "effect/c",
        "effect/b",
    ]
    assert [k for k, _ in strong_candidates(result, ["aero/Cm_q"], [], keys)] == [
        "effect/a",
        "effect/c",
        "effect/b",
    ]
    assert strong_candidates(result, ["aero/Cm_q"], keys, keys) == ()
    assert all(abs(t) > CERTAIN_T for _, t in strong_candidates(result, ["aero/Cm_q"], [], keys))


def test_what_only_resembles_the_chosen_is_not():
    """b is nothing but like a: alone it would stand at |t| 27."""
    result = evidence({"effect/a": 30.0, "effect/b": 0.0}, likeness=0.9)
    assert [
        k for k, _ in strong_candidates(result, ["aero/Cm_q"], [], ["effect/a", "effect/b"])
    ] == [
        "effect/a",
        "effect/b",
    ]
    assert strong_candidates(result, ["aero/Cm_q"], ["effect/a"], ["effect/a", "effect/b"]) == ()


def test_words_name_it_and_its_strength():
    effect = coefficient_effect("Cm", "p_hat^2")
    assert still_significant(effect, -12.34).startswith(
        f"{effect.name} is still significant (|t| 12.3)"
    )


def test_the_interval_knows_that_the_choice_was_made_by_a_narrower_error():
    """|t| 6.2 of 6 asked, by an error of which 1.25 is told: 4.96 of 4.8 in errors told."""
    chosen = SelectedEffect("effect/Cm/de", 0.62, 0.125, 6.2, 38.4, 1.0, 0.0)
    low, high = chosen_interval(chosen, 6.0)
    assert (low, high) == pytest.approx(conditional_interval(0.62, 0.125, 4.8))
    assert low < 0.62 - 2.0 * 0.125
    same = replace(chosen, std=0.1)
    assert chosen_interval(same, 6.0) == pytest.approx(conditional_interval(0.62, 0.1, 6.0))
    assert chosen_interval(replace(chosen, value=0.0, t=0.0), 6.0) == pytest.approx(
        (-0.245, 0.245), abs=1e-3
    )


@pytest.mark.parametrize(("moved_s", "said_s"), [(0.0475, 0.0402), (0.0, 0.0)])
def test_what_a_records_clock_is_off_by_is_the_move_and_what_is_left(moved_s, said_s):
    nuisance = {
        "lateness/one/controls": -0.0070,
        "lateness/two/controls": -0.0076,
        "bias/one/q_radps": 1.0,
    }
    after = SimpleNamespace(trajectory=SimpleNamespace(point=SimpleNamespace(nuisance=nuisance)))
    result = SimpleNamespace(late_s=moved_s, after=after)
    assert SearchResult.controls_late_s.fget(result) == pytest.approx(said_s)


@pytest.mark.parametrize(
    ("command_s", "first", "late_s"),
    [(0.01, True, 0.005), (0.04, True, 0.005), (0.04, False, 0.0012), (0.2, True, 0.006)],
)
def test_controls_as_late_as_an_integrations_step_are_no_slip_of_the_record(
    command_s, first, late_s
):
    """Surfaces that jump and are seen old by the first of four stages act a sixth of a step late:
    .67 ms of 4 ms.
    """
    assert offset_tolerance_s(command_s, first)[0] == pytest.approx(late_s)
