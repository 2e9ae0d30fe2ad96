"""What test flights say of effects: the change of the likelihood, its standard error, and who is
withdrawn first.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sysid.effects.catalogue import Effect, coefficient_effect
from sysid.effects.selection import Choice, Selection
from uqharness.identification.linearised import Carrier
from uqharness.refinement import judge as refine_judge
from uqharness.refinement.judge import BEYOND_CHANCE, Verdict, gap_change
from uqharness.refinement.search import Found


def shown(white: list[np.ndarray], deviation: float = 1.0) -> SimpleNamespace:
    """Predictions with the same deviation of every sample."""
    logdet = tuple(w.size * float(np.log(deviation)) for w in white)
    cost = float(sum(np.nansum(w**2) for w in white))
    surprise = cost + 2.0 * sum(logdet)
    return SimpleNamespace(
        white=white, cost=cost, logdet=logdet, surprise=surprise, flown=SimpleNamespace(point=None)
    )


def change(rng: np.random.Generator, size: float, truth: bool, colour: float = 0.0):
    """gap_change of an effect of ``size`` standard deviations on one of three channels, in the
    flights or not.
    """
    setup = SimpleNamespace(segments=[SimpleNamespace(dt_s=0.02)] * 4)
    without, with_ = [], []
    for _ in range(4):
        noise = rng.standard_normal((300, 3))
        for k in range(1, 300 if colour else 0):
            noise[k] = colour * noise[k - 1] + np.sqrt(1.0 - colour**2) * noise[k]
        d = np.zeros((300, 3))
        d[:, 1] = size * np.sin(np.arange(300) / 20.0)
        without.append(noise + d if truth else noise)
        with_.append(noise if truth else noise - d)
    return gap_change(shown(without), shown(with_), setup, shown([rng.standard_normal((300, 3))]))


def test_standard_error_of_the_change_is_that_of_the_draws():
    """White noise has it in closed form: mean sum(d^2), variance 4 sum(d^2); coloured noise is
    judged by its spread.
    """
    rng = np.random.default_rng(0)
    square = 4.0 * float(np.sum((0.2 * np.sin(np.arange(300) / 20.0)) ** 2))
    for colour in (0.0, 0.8):
        found = [change(rng, 0.2, True, colour) for _ in range(200)]
        spread = np.std([f.change for f in found])
        assert np.mean([f.change for f in found]) == pytest.approx(
            square, abs=4.0 * spread / np.sqrt(200.0)
        )
        assert np.sqrt(np.mean([f.std**2 for f in found])) == pytest.approx(spread, rel=0.3)
        if not colour:
            assert spread == pytest.approx(2.0 * np.sqrt(square), rel=0.2)


def test_share_of_the_estimate_that_the_flights_have():
    """An effect of which the flights have a part: that part, with its standard error, over
    draws.
    """
    rng = np.random.default_rng(6)
    setup = SimpleNamespace(segments=[SimpleNamespace(dt_s=0.02)] * 4)
    d = np.zeros((300, 3))
    d[:, 1] = 0.6 * np.sin(np.arange(300) / 20.0)
    for part in (0.0, 0.4, 1.0, 1.3):
        found = []
        for _ in range(60):
            noise = [rng.standard_normal((300, 3)) for _ in range(4)]
            without, with_ = ([e + (part - taken) * d for e in noise] for taken in (0.0, 1.0))
            found.append(gap_change(shown(without), shown(with_), setup, shown(noise)).share)
        shares, errors = np.array(found).T
        assert shares.mean() == pytest.approx(part, abs=4.0 * shares.std() / np.sqrt(60.0))
        # What neither model explains is in the error, too: between none and all it is too large,
        # never too small.
        assert np.sqrt(np.mean(errors**2)) > 0.7 * shares.std()
        if part in (0.0, 1.0):
            assert np.sqrt(np.mean(errors**2)) == pytest.approx(shares.std(), rel=0.35)


def test_chance_withdraws_seldom_and_a_contradiction_does():
    rng = np.random.default_rng(1)
    weak = [change(rng, 0.02, True) for _ in range(300)]
    assert np.mean([v.says == "grew" for v in weak]) < 0.1
    assert np.mean([v.says == "cannot tell" for v in weak]) > 0.7
    # Of an effect that train flights have at |t| 4.5 of 4 asked and test flights would show at 2.4,
    # what both say together decides: the change is normal with mean 6 or -6 and standard deviation
    # 4.9.
    for truth, share in ((True, 0.02), (False, 0.64)):
        found = [change(rng, 0.1, truth) for _ in range(300)]
        found = [replace(v, beyond=v.change + 4.5**2 - 4.0**2) for v in found]
        assert np.mean([v.says == "grew" for v in found]) == pytest.approx(share, abs=0.08)
    assert all(change(rng, 0.5, True).says == "shrank" for _ in range(20))
    assert all(change(rng, 0.5, False).says == "grew" for _ in range(20))


def test_predictions_of_another_damping_are_judged_by_their_likelihood():
    """A model that damps too little takes the air's motion for larger, and its squares over that
    are smaller: no merit of it.
    """
    rng = np.random.default_rng(4)
    setup = SimpleNamespace(segments=[SimpleNamespace(dt_s=0.02)] * 4)
    found = []
    for _ in range(100):
        left = [rng.standard_normal((300, 3)) for _ in range(4)]
        wide = shown([e / 1.1 for e in left], 1.1)
        found.append(gap_change(wide, shown(left), setup, shown(left)))
        assert wide.cost < shown(left).cost
    # Kullback and Leibler's distance of the two normal distributions, twice, of 3600 samples.
    expected = 3600.0 * (2.0 * np.log(1.1) + 1.0 / 1.1**2 - 1.0)
    spread = np.std([v.change for v in found])
    assert np.mean([v.change for v in found]) == pytest.approx(expected, abs=0.4 * spread)
    assert 0.9 * spread < np.sqrt(np.mean([v.std**2 for v in found])) < 1.5 * spread
    assert np.mean([v.says == "shrank" for v in found]) > 0.9


def judged(
    monkeypatch, harm: dict[str, float], together: float = 0.0, left: bool = False
) -> list[str]:
    """Effects that stand after `judge`, the order of withdrawal before them; an effect of ``harm``
    raises the cost, and so does ``together`` where two or more are in. left: whether the train
    flights are left unexplained."""
    rng = np.random.default_rng(5)
    noise = rng.standard_normal((400, 2))
    wave = [np.sin(np.arange(400) / (9.0 + k)) for k in range(len(harm) + 1)]

    def flown(model, setup, *_) -> SimpleNamespace:
        white = noise.copy()
        for k, (key, size) in enumerate(harm.items()):
            white[:, 0] += (
                size
                if key in model and size > 0.0
                else -size
                if key not in model and size < 0.0
                else 0.0
            ) * wave[k]
        white[:, 1] += (together if len(model) > 1 else 0.0) * wave[-1]
        return shown([white])

    def without(found, keys):
        return replace(
            found,
            selection=replace(
                found.selection,
                chosen=tuple(c for c in found.selection.chosen if c.key not in keys),
            ),
        )

    chosen = tuple(Choice(k, 1.0, 0.1, 10.0, 100.0, 1.0, 0.0) for k in harm)
    effects = {k: Effect("Cm", None, k, k, k) for k in harm}
    fit = SimpleNamespace(trajectory=SimpleNamespace(point=None))
    found = Found(None, (), fit, fit, Selection(chosen), effects, {}, ())  # type: ignore[arg-type]
    monkeypatch.setattr(refine_judge, "show", flown)
    monkeypatch.setattr(refine_judge, "property_values", lambda *_: None)
    monkeypatch.setattr(refine_judge, "evidence_of", lambda *_: None)
    monkeypatch.setattr(refine_judge, "both_sides", lambda *_: None)
    monkeypatch.setattr(refine_judge, "left_in", lambda *_: left)
    monkeypatch.setattr(refine_judge, "surer", lambda verdict, *_: verdict)
    monkeypatch.setattr(refine_judge, "left_out", lambda found, _, keys: without(found, keys))
    monkeypatch.setattr(refine_judge, "bare", lambda found: without(found, list(harm)))
    side = refine_judge.Side(SimpleNamespace(segments=[SimpleNamespace(dt_s=0.02)]))  # type: ignore[arg-type]
    done = refine_judge.judge(
        found, None, lambda f: [c.key for c in f.selection.chosen], side, side, map
    )  # type: ignore
    return [*(c.key for c in done.withdrawn), "|", *(c.key for c in done.found.selection.chosen)]


def test_the_worst_goes_first_and_what_helps_stays(monkeypatch):
    assert judged(monkeypatch, {"alpha": -0.6, "alpha^2": 0.4, "alpha^3": 0.8}) == [
        "alpha^3",
        "alpha^2",
        "|",
        "alpha",
    ]
    assert judged(monkeypatch, {"alpha": -0.6, "beta": -0.5}) == ["|", "alpha", "beta"]


def test_nothing_stands_where_nothing_helps(monkeypatch):
    assert judged(monkeypatch, {"alpha": 0.6}) == ["alpha", "|"]
    assert judged(monkeypatch, {"alpha": 0.3, "beta": 0.9}) == ["beta", "alpha", "|"]


def test_beside_what_nothing_explains_an_effect_must_be_seen_on_the_test_flights(monkeypatch):
    """One that changes nothing there stands where the train flights are explained, and goes where
    they are not.
    """
    unseen = {"alpha": -0.6, "beta": 0.0, "p_hat": -0.5}
    assert judged(monkeypatch, unseen) == ["|", *unseen]
    assert judged(monkeypatch, unseen, left=True) == ["beta", "|", "alpha", "p_hat"]
    assert judged(monkeypatch, {"alpha": -0.6, "beta": -0.5}, left=True) == ["|", "alpha", "beta"]


@pytest.mark.parametrize(
    ("share", "std", "seen"),
    [
        (0.6, 0.14, True),
        (1.0, 0.2, True),
        (0.39, 0.21, False),
        (0.1, 0.04, False),
        (0.8, 0.6, False),
    ],
)
def test_more_than_half_of_an_estimate_is_an_effect_that_is_seen(share, std, seen):
    """Its change, though, is within chance: .6 +- .14 is not surely more than half, of which the
    change is none.
    """
    size = 1e4
    verdict = Verdict(
        size * (2.0 * share - 1.0), 2.0 * size * std, between=(size, size * (2.0 * share - 1.0))
    )
    assert verdict.share == pytest.approx((share, std))
    assert verdict.seen == seen


def test_effects_that_harm_together_alone_do_not_all_stand(monkeypatch):
    """With three, leaving any one out leaves two, which are in each other's way as much: none goes
    for itself.
    """
    assert judged(monkeypatch, {"alpha": 0.0, "beta": 0.0, "p_hat": 0.0}, 0.8).index("|") == 2


def test_what_changes_nothing_is_not_said_to_grow():
    white = [np.ones((50, 2))] * 4
    setup = SimpleNamespace(segments=[SimpleNamespace(dt_s=0.02)] * 4)
    verdict = gap_change(shown(white), shown(white), setup, shown(white))
    assert (verdict.change, verdict.std, verdict.says) == (0.0, 0.0, "cannot tell")
    assert np.isnan(verdict.share).all()
    assert BEYOND_CHANCE > 1.0


def test_flights_far_from_both_models_judge_neither():
    """Six times the noise in every sample: the same difference that grew the gap in sound flights
    tells nothing there.
    """
    rng = np.random.default_rng(2)
    noise, d = rng.standard_normal((400, 2)), np.full((400, 2), 0.8)
    setup = SimpleNamespace(segments=[SimpleNamespace(dt_s=0.02)])
    sound = gap_change(shown([noise]), shown([noise + d]), setup, shown([noise]))
    broken = gap_change(
        shown([noise - 6.0 * d / 0.8]), shown([noise - 7.0 * d / 0.8]), setup, shown([noise])
    )
    assert (sound.says, broken.says) == ("grew", "too far")
    assert broken.far == pytest.approx(6.0, rel=0.1)
    assert broken.z < -BEYOND_CHANCE


def test_properties_fly_what_an_aircraft_of_its_own_would():
    """Left-out terms are zero; a servo's number that stands in the XML alone needs an aircraft of
    its own once it is left out.
    """
    term, lag = coefficient_effect("Cm", "p_hat^2"), Effect(None, "mass", "cg_x", "", "")
    sensor = Effect(None, "sensor.alpha_rad", "scale", "", "")
    chosen = tuple(
        Choice(e.key, value, 0.1, 10.0, 100.0, 1.0, 0.0)
        for e, value in ((term, 3.0), (lag, 0.01), (sensor, 0.1))
    )
    setup = SimpleNamespace(carriers={term.key: Carrier("aero/Cm_p2", 0.0)})
    found = Found(
        setup,
        ("aero/Cm_q",),
        None,
        None,
        Selection(chosen),
        {e.key: e for e in (term, lag, sensor)},
        {"aero/Cm_q": (-9.0, 0.1)},
        (),
    )  # type: ignore[arg-type]

    def flown(*keys: str) -> dict[str, float] | None:
        kept = tuple(c for c in chosen if c.key in keys)
        model = replace(found, selection=Selection(kept), parameters={"aero/Cm_q": (-8.0, 0.1)})
        return refine_judge.property_values(model, found)  # type: ignore[arg-type]

    assert flown(term.key, lag.key, sensor.key) == {"aero/Cm_q": -8.0, "aero/Cm_p2": 3.0}
    assert flown(lag.key) == {"aero/Cm_q": -8.0, "aero/Cm_p2": 0.0}
    assert flown(term.key) is None


def test_a_model_flies_as_the_aircraft_with_every_effect_does_at_its_values(monkeypatch):
    whole = object()
    monkeypatch.setattr(refine_judge, "property_values", lambda model, found: {"aero/Cm_q": -14.0})
    assert refine_judge.flown_as(None, None, whole, None) == (whole, {"aero/Cm_q": -14.0})  # type: ignore[arg-type]
    # A number of the model that stands in the XML alone: it flies by itself.
    monkeypatch.setattr(refine_judge, "property_values", lambda *_: None)
    assert refine_judge.flown_as(None, None, whole, lambda _: "its own") == ("its own", {})  # type: ignore[arg-type]
