"""The rule that chooses effects: the largest t by chance, causes that physics makes alike, noise
other than taken.
"""

from __future__ import annotations

import numpy as np
import pytest

from sysid.effects.information import Information, normal_equations, score_tests
from sysid.effects.selection import critical_t_of, estimate_selected, select, sidak_critical_t
from tests.helpers.whitened import whitened

SEGMENTS, N, M = 6, 40, 3
CONFIRMING = np.arange(SEGMENTS) % 3 == 1


def evidence(columns: dict[str, np.ndarray], residual: np.ndarray) -> Information:
    """columns: name -> (S, n, m); residual (S, n, m) in units of the noise."""
    names = tuple(columns)
    white = [
        whitened(residual[s], np.stack([columns[c][s] for c in names], axis=2))
        for s in range(SEGMENTS)
    ]
    return normal_equations(white, names, CONFIRMING, {})


def draw(rng: np.random.Generator) -> np.ndarray:
    return rng.standard_normal((SEGMENTS, N, M))


def test_the_limit_is_sidaks_for_candidates_that_have_nothing_in_common():
    rng = np.random.default_rng(1)
    result = evidence({f"c{k}": draw(rng) for k in range(30)}, draw(rng))
    critical_t = critical_t_of(result, [], [f"c{k}" for k in range(30)], 0.05)
    assert critical_t == pytest.approx(sidak_critical_t(30, 0.05), abs=0.06)


def test_the_limit_of_one_candidate_by_thirty_names_is_that_of_one():
    rng = np.random.default_rng(1)
    unique, free = draw(rng), draw(rng)
    result = evidence(
        {"free": free, **{f"c{k}": (1.0 + k) * unique + k * free for k in range(30)}}, draw(rng)
    )
    critical_t = critical_t_of(result, ["free"], [f"c{k}" for k in range(30)], 0.05)
    assert critical_t == pytest.approx(1.96, abs=0.05)
    assert sidak_critical_t(30, 0.05) > 3.0


def test_nothing_is_chosen_from_noise_more_often_than_the_limit_allows():
    rng = np.random.default_rng(2)
    shared = draw(rng)
    columns = {"free": draw(rng), **{f"c{k}": draw(rng) + shared for k in range(20)}}
    candidates = {f"c{k}": 0.0 for k in range(20)}
    critical_t = critical_t_of(evidence(columns, shared), ["free"], list(candidates), 0.05)
    largest = [
        float(np.abs(score_tests(evidence(columns, draw(rng)), ["free"], list(candidates)).t).max())
        for _ in range(300)
    ]
    assert 0.02 < np.mean(np.array(largest) > critical_t) < 0.085


@pytest.mark.parametrize(
    ("single", "entered"),
    [(np.inf, ["large", "small"]), (15.0, ["large"]), (40.0, ["large", "small"])],
)
def test_an_overwhelming_candidate_is_the_last_to_enter(single, entered):
    rng = np.random.default_rng(8)
    columns = {"large": draw(rng), "small": draw(rng)}
    result = evidence(columns, draw(rng) + 1.0 * columns["large"] + 0.35 * columns["small"])
    none = dict.fromkeys(columns, 0.0)
    assert [
        c.key for c in select(result, [], none, critical_t=4.0, decisive_t=single).chosen
    ] == entered
    # One that has flown does not keep others from entering.
    assert [
        c.key
        for c in select(
            result, [], none, chosen=["large"], critical_t=4.0, decisive_t=single
        ).chosen
    ] == [
        "large",
        "small",
    ]


@pytest.fixture
def alike():
    """What is there: ``square``; ``inertia`` is the same but for a share in ``companion``."""
    rng = np.random.default_rng(3)
    square, companion = draw(rng), draw(rng)
    columns = {
        "square": square,
        "inertia": square - 0.6 * companion,
        "companion": companion,
        "other": draw(rng),
    }
    return evidence(columns, 1.0 * square + draw(rng))


TWINS = {("square", "inertia"): ("companion",), ("inertia", "square"): ("companion",)}


@pytest.fixture
def tied(monkeypatch: pytest.MonkeyPatch) -> None:
    """The pair of this test in place of the catalogue's."""
    monkeypatch.setattr("sysid.effects.selection.TWINS", TWINS)


def alternatives(result) -> dict[str, bool]:
    chosen = select(result, [], dict.fromkeys(result.names, 0.0)).chosen
    assert [c.key for c in chosen] == ["square"]
    return {a.key: a.separable for a in chosen[0].alternatives}


@pytest.mark.usefixtures("tied")
def test_twins_stand_together_though_a_companion_tells_them_apart(alike):
    assert alternatives(alike)["inertia"] is False


def test_without_a_tie_the_companion_tells_them_apart(alike):
    assert alternatives(alike).get("inertia", True) is True


@pytest.mark.usefixtures("tied")
def test_a_twin_turns_what_stands_in_roll_into_yaw():
    """A second effect in Cl stands; the twin holds the same in Cn, which no parameter has."""
    rng = np.random.default_rng(9)
    square, companion, roll, yaw = draw(rng), draw(rng), draw(rng), draw(rng)
    columns = {
        "square": square,
        "inertia": square - 0.6 * companion + 1.5 * yaw,
        "companion": companion,
        "effect/Cl/de": roll,
        "effect/Cn/de": yaw,
    }
    result = evidence(columns, 1.0 * square + 2.0 * roll + draw(rng))
    chosen = select(result, [], dict.fromkeys(columns, 0.0)).chosen
    assert {c.key for c in chosen} == {"square", "effect/Cl/de"}
    (choice,) = (c for c in chosen if c.key == "square")
    assert {a.key: a.separable for a in choice.alternatives}["inertia"] is False


@pytest.mark.usefixtures("tied")
def test_twins_that_differ_in_more_than_their_companion_are_told_apart():
    rng = np.random.default_rng(4)
    square, companion, unique = draw(rng), draw(rng), draw(rng)
    columns = {
        "square": square,
        "inertia": square - 0.6 * companion + 0.7 * unique,
        "companion": companion,
    }
    result = evidence(columns, 1.0 * square + draw(rng))
    assert alternatives(result)["inertia"] is True


@pytest.mark.parametrize("present", ["square", "modulus"])
def test_a_twin_is_told_before_a_third_form_of_the_same(present, monkeypatch):
    """``modulus`` and ``fourth`` resemble ``square`` more than ``inertia`` does, whose companion is
    a parameter of no other.
    """
    rng = np.random.default_rng(6)
    square, companion = draw(rng), draw(rng)
    columns = {
        "square": square,
        "modulus": square + 0.1 * draw(rng),
        "fourth": square + 0.1 * draw(rng),
        "inertia": square - 0.3 * companion,
        "companion": companion,
    }
    result = evidence(columns, 0.2 * square + 0.8 * (columns[present] - square) + draw(rng))
    open_ = {k: 0.0 for k in columns if k != "companion"}
    (plain,) = select(result, [], open_).chosen
    monkeypatch.setattr("sysid.effects.selection.TWINS", TWINS)
    (choice,) = select(result, [], open_).chosen
    assert choice.key == present
    alike_ = [a.key for a in choice.alternatives if not a.separable]
    assert len(alike_) == 2
    assert {"square", "inertia"} <= {choice.key, *alike_}
    assert "inertia" not in [a.key for a in plain.alternatives]


def test_what_all_candidates_see_a_little_is_none_of_them():
    rng = np.random.default_rng(5)
    misfit = draw(rng)
    columns = {f"c{k}": draw(rng) + rng.uniform(-0.6, 0.6) * misfit for k in range(60)}
    candidates = dict.fromkeys(columns, 0.0)
    result = evidence(columns, 0.3 * misfit + draw(rng))
    plain = select(result, [], candidates)
    careful = select(result, [], candidates, empirical=True)
    assert plain.chosen
    assert not careful.chosen
    assert careful.refused is not None
    assert "spread" in careful.refused.reason
    present = evidence(columns, 0.3 * misfit + draw(rng) + 1.0 * columns["c7"])
    assert [c.key for c in select(present, [], candidates, empirical=True).chosen] == ["c7"]


def test_candidates_that_resemble_an_effect_do_not_hide_it():
    """The effect in question does not count as a spread of the others."""
    rng = np.random.default_rng(7)
    effect = draw(rng)
    columns = {"c0": effect} | {f"c{k}": draw(rng) + 0.6 * effect for k in range(1, 60)}
    result = evidence(columns, 0.4 * effect + draw(rng))
    selection = select(result, [], dict.fromkeys(columns, 0.0), empirical=True)
    assert [c.key for c in selection.chosen] == ["c0"]


def test_a_limit_above_that_of_chance_is_not_multiplied_by_the_spread():
    """|t| of 7.5 beside others that spread by 1.7: chance gives 6.1."""
    rng = np.random.default_rng(8)
    misfit = draw(rng)
    columns = {f"c{k}": draw(rng) + rng.uniform(-0.5, 0.5) * misfit for k in range(60)}
    result = evidence(columns, 0.12 * misfit + draw(rng) + 0.3 * columns["c7"])
    candidates = dict.fromkeys(columns, 0.0)
    (effect,) = select(result, [], candidates, critical_t=6.0, empirical=True).chosen
    assert effect.key == "c7"
    assert 7.0 < effect.t < 9.0
    others = [k for k in columns if k != "c7"]
    spread = np.median(np.abs(score_tests(result, ["c7"], others).t)) / 0.6745
    assert 1.4 < spread < 2.0
    assert effect.t < 6.0 * spread


def test_an_effect_is_found_beside_a_stronger_one_that_its_flights_contradict():
    """``torn`` has the opposite sign in the confirming part: it is refused, and what is steady
    enters all the same.
    """
    rng = np.random.default_rng(6)
    torn, steady = draw(rng), draw(rng)
    sign = np.where(CONFIRMING, -1.0, 1.0)[:, None, None]
    result = evidence(
        {"torn": torn, "steady": steady, "other": draw(rng)},
        sign * torn + 0.4 * steady + draw(rng),
    )
    selection = select(result, [], dict.fromkeys(result.names, 0.0))
    assert [c.key for c in selection.chosen] == ["steady"]
    assert selection.refused is not None
    assert selection.refused.key == "torn"
    assert selection.refused.strong


@pytest.mark.parametrize(
    ("t", "by_chance", "entering"), [(9.0, -0.5, True), (5.0, -0.5, True), (5.0, -4.0, False)]
)
def test_it_is_enough_that_the_parts_do_not_contradict_each_other(t, by_chance, entering):
    """The confirming part knows a tenth of it, and what it knows is by chance half a standard error
    the other way, or four.
    """
    rng = np.random.default_rng(11)
    column = draw(rng) * np.where(CONFIRMING, 0.2, 1.0)[:, None, None]
    noise = draw(rng)
    for part, off in ((CONFIRMING, by_chance), (~CONFIRMING, 0.0)):
        x, unique = column[part], noise[part]
        size = np.sum(x**2)
        unique -= x * np.sum(x * unique) / size  # no noise along the column but what is wanted
        noise[part] = unique + x * (
            off / np.sqrt(size) - (t / np.sqrt(np.sum(column**2)) if off else 0.0)
        )
    result = evidence(
        {"there": column, "other": draw(rng)}, t / np.sqrt(np.sum(column**2)) * column + noise
    )
    selection = select(result, [], dict.fromkeys(result.names, 0.0), critical_t=4.0)
    assert bool(selection.chosen) == entering
    if not entering:
        assert selection.refused is not None
        assert selection.refused.unconfirmed


@pytest.mark.parametrize(("smoothing", "is_off"), [(1, False), (20, False), (1, True)])
def test_parts_of_coloured_flights_differ_by_their_colour(smoothing, is_off):
    """Of 40 drawn flights few say that their parts differ, coloured or not; all where they do."""
    kernel = np.ones(smoothing) / np.sqrt(smoothing)

    def smooth(x: np.ndarray) -> np.ndarray:
        return np.apply_along_axis(lambda s: np.convolve(s, kernel, "same"), 1, x)

    count = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        column = smooth(draw(rng))
        size = 1.0 - is_off * 2.0 * CONFIRMING[:, None, None]
        result = evidence({"there": column}, size * column + smooth(draw(rng)))
        (effect,) = estimate_selected(result, [], ["there"], [])
        count += abs(effect.difference) > 3.0
    assert count == 40 if is_off else count <= 2


def test_beside_an_overwhelming_effect_that_has_flown_a_weak_one_is_asked_no_more_than_alone():
    rng = np.random.default_rng(8)
    strong, weak, unique = draw(rng), draw(rng), draw(rng)
    columns = {"strong": strong, "weak": weak, "own": unique}
    penalty = dict.fromkeys(columns, 0.0)
    pair = evidence(columns, 3.0 * strong + 5.5 / np.sqrt(np.sum(weak**2)) * weak + draw(rng))
    assert [c.key for c in select(pair, [], penalty, decisive_t=15.0).chosen] == ["strong"]
    assert {
        c.key for c in select(pair, [], penalty, chosen=["strong"], decisive_t=15.0).chosen
    } == {
        "strong",
        "weak",
    }
    noise = evidence(columns, 3.0 * strong + draw(rng))
    assert [
        c.key for c in select(noise, [], penalty, chosen=["strong", "weak"], decisive_t=15.0).chosen
    ] == ["strong"]


def test_the_limit_counts_errors_of_coloured_residuals():
    """Slow columns and residuals have few independent samples: |t| by white noise exceeds 4 in a
    third of the draws without an effect.
    """
    kernel = np.ones(20) / np.sqrt(20.0)

    def slow(rng: np.random.Generator) -> np.ndarray:
        return np.apply_along_axis(lambda s: np.convolve(s, kernel, "same"), 1, draw(rng))

    above_by_white_noise, chosen = 0, 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        result = evidence({"absent": slow(rng)}, slow(rng))
        above_by_white_noise += abs(score_tests(result, [], ["absent"]).t[0]) > 4.0
        chosen += bool(select(result, [], {"absent": 0.0}, critical_t=4.0).chosen)
    assert above_by_white_noise >= 5
    assert chosen <= 2
