"""The hold-out test: the change of the likelihood, its standard error, and which effects are
withdrawn; end to end on a linear aircraft with known answers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from sysid.effects.catalogue import Effect, coefficient_effect
from sysid.effects.selection import SelectedEffect, Selection
from tests.uqharness.refinement.linear_aircraft import (
    NOISE,
    PARAMETERS,
    LinearFlights,
    simulate,
)
from uqharness.identification.linearised import EffectProperty, FlightData, ModelState
from uqharness.refinement.estimators import Dataset
from uqharness.refinement.evaluation import Evaluation
from uqharness.refinement.hold_out import (
    BEYOND_CHANCE,
    HoldOutTest,
    TrainTestInformation,
    Verdict,
    compare,
    property_values,
)
from uqharness.refinement.search_result import SearchResult


def show(white: list[np.ndarray], deviation: float = 1.0) -> SimpleNamespace:
    """Predictions with the same deviation of every sample."""
    logdet = tuple(w.size * float(np.log(deviation)) for w in white)
    cost = float(sum(np.nansum(w**2) for w in white))
    surprise = cost + 2.0 * sum(logdet)
    return SimpleNamespace(
        white=white,
        cost=cost,
        logdet=logdet,
        neg2_log_likelihood=surprise,
        trajectory=SimpleNamespace(point=None),
    )


def change(rng: np.random.Generator, size: float, truth: bool, colour: float = 0.0):
    """compare of an effect of ``size`` standard deviations on one of three channels, in the
    flights or not.
    """
    data = SimpleNamespace(segments=[SimpleNamespace(dt_s=0.02)] * 4)
    reduced, with_ = [], []
    for _ in range(4):
        noise = rng.standard_normal((300, 3))
        for k in range(1, 300 if colour else 0):
            noise[k] = colour * noise[k - 1] + np.sqrt(1.0 - colour**2) * noise[k]
        d = np.zeros((300, 3))
        d[:, 1] = size * np.sin(np.arange(300) / 20.0)
        reduced.append(noise + d if truth else noise)
        with_.append(noise if truth else noise - d)
    return compare(show(reduced), show(with_), data, show([rng.standard_normal((300, 3))]))


def test_standard_error_of_the_change_is_that_of_the_draws():
    """White noise has it in closed form: mean sum(d^2), variance 4 sum(d^2); coloured noise is
    judged by its spread.
    """
    rng = np.random.default_rng(0)
    square = 4.0 * float(np.sum((0.2 * np.sin(np.arange(300) / 20.0)) ** 2))
    for colour in (0.0, 0.8):
        result = [change(rng, 0.2, True, colour) for _ in range(200)]
        scatter = np.std([f.change for f in result])
        assert np.mean([f.change for f in result]) == pytest.approx(
            square, abs=4.0 * scatter / np.sqrt(200.0)
        )
        assert np.sqrt(np.mean([f.std**2 for f in result])) == pytest.approx(scatter, rel=0.3)
        if not colour:
            assert scatter == pytest.approx(2.0 * np.sqrt(square), rel=0.2)


def test_share_of_the_estimate_that_the_flights_have():
    """An effect of which the flights have a part: that part, with its standard error, over
    draws.
    """
    rng = np.random.default_rng(6)
    data = SimpleNamespace(segments=[SimpleNamespace(dt_s=0.02)] * 4)
    d = np.zeros((300, 3))
    d[:, 1] = 0.6 * np.sin(np.arange(300) / 20.0)
    for part in (0.0, 0.4, 1.0, 1.3):
        result = []
        for _ in range(60):
            noise = [rng.standard_normal((300, 3)) for _ in range(4)]
            reduced, with_ = ([e + (part - selected) * d for e in noise] for selected in (0.0, 1.0))
            result.append(compare(show(reduced), show(with_), data, show(noise)).share)
        shares, errors = np.array(result).T
        assert shares.mean() == pytest.approx(part, abs=4.0 * shares.std() / np.sqrt(60.0))
        # What neither model explains is in the error, too: between none and all it is too large,
        # never too small.
        assert np.sqrt(np.mean(errors**2)) > 0.7 * shares.std()
        if part in (0.0, 1.0):
            assert np.sqrt(np.mean(errors**2)) == pytest.approx(shares.std(), rel=0.35)


def test_chance_withdraws_seldom_and_a_contradiction_does():
    rng = np.random.default_rng(1)
    weak = [change(rng, 0.02, True) for _ in range(300)]
    assert np.mean([v.gap == "grew" for v in weak]) < 0.1
    assert np.mean([v.gap == "cannot tell" for v in weak]) > 0.7
    # Of an effect that train flights have at |t| 4.5 of 4 asked and test flights would show at 2.4,
    # what both say together decides: the change is normal with mean 6 or -6 and standard deviation
    # 4.9.
    for truth, share in ((True, 0.02), (False, 0.64)):
        result = [change(rng, 0.1, truth) for _ in range(300)]
        result = [replace(v, excess_t2=v.change + 4.5**2 - 4.0**2) for v in result]
        assert np.mean([v.gap == "grew" for v in result]) == pytest.approx(share, abs=0.08)
    assert all(change(rng, 0.5, True).gap == "shrank" for _ in range(20))
    assert all(change(rng, 0.5, False).gap == "grew" for _ in range(20))


def test_predictions_of_another_damping_are_judged_by_their_likelihood():
    """A model that damps too little takes the air's motion for larger, and its squares over that
    are smaller: no merit of it.
    """
    rng = np.random.default_rng(4)
    data = SimpleNamespace(segments=[SimpleNamespace(dt_s=0.02)] * 4)
    result = []
    for _ in range(100):
        remaining = [rng.standard_normal((300, 3)) for _ in range(4)]
        wide = show([e / 1.1 for e in remaining], 1.1)
        result.append(compare(wide, show(remaining), data, show(remaining)))
        assert wide.cost < show(remaining).cost
    # Kullback and Leibler's distance of the two normal distributions, twice, of 3600 samples.
    expected = 3600.0 * (2.0 * np.log(1.1) + 1.0 / 1.1**2 - 1.0)
    scatter = np.std([v.change for v in result])
    assert np.mean([v.change for v in result]) == pytest.approx(expected, abs=0.4 * scatter)
    assert 0.9 * scatter < np.sqrt(np.mean([v.std**2 for v in result])) < 1.5 * scatter
    assert np.mean([v.gap == "shrank" for v in result]) > 0.9


@pytest.mark.parametrize(
    ("share", "std", "observed"),
    [
        (0.6, 0.14, True),
        (1.0, 0.2, True),
        (0.39, 0.21, False),
        (0.1, 0.04, False),
        (0.8, 0.6, False),
    ],
)
def test_more_than_half_of_an_estimate_is_an_effect_that_is_seen(share, std, observed):
    """Its change, though, is within chance: .6 +- .14 is not surely more than half, of which the
    change is none.
    """
    size = 1e4
    verdict = Verdict(
        size * (2.0 * share - 1.0),
        2.0 * size * std,
        difference_ss=(size, size * (2.0 * share - 1.0)),
    )
    assert verdict.share == pytest.approx((share, std))
    assert verdict.is_visible == observed


def test_what_changes_nothing_is_not_said_to_grow():
    white = [np.ones((50, 2))] * 4
    data = SimpleNamespace(segments=[SimpleNamespace(dt_s=0.02)] * 4)
    verdict = compare(show(white), show(white), data, show(white))
    assert (verdict.change, verdict.std, verdict.gap) == (0.0, 0.0, "cannot tell")
    assert np.isnan(verdict.share).all()
    assert BEYOND_CHANCE > 1.0


def test_flights_far_from_both_models_judge_neither():
    """Six times the noise in every sample: the same difference that grew the gap in sound flights
    tells nothing there.
    """
    rng = np.random.default_rng(2)
    noise, d = rng.standard_normal((400, 2)), np.full((400, 2), 0.8)
    data = SimpleNamespace(segments=[SimpleNamespace(dt_s=0.02)])
    sound = compare(show([noise]), show([noise + d]), data, show([noise]))
    broken = compare(
        show([noise - 6.0 * d / 0.8]), show([noise - 7.0 * d / 0.8]), data, show([noise])
    )
    assert (sound.gap, broken.gap) == ("grew", "too far")
    assert broken.residual_ratio == pytest.approx(6.0, rel=0.1)
    assert broken.z < -BEYOND_CHANCE


def test_properties_fly_what_an_aircraft_of_its_own_would():
    """Excess-out terms are zero; a servo's number that stands in the XML alone needs an aircraft of
    its own once it is left out.
    """
    term, lag = coefficient_effect("Cm", "p_hat^2"), Effect(None, "mass", "cg_x", "", "")
    sensor = Effect(None, "sensor.alpha_rad", "scale", "", "")
    chosen = tuple(
        SelectedEffect(e.key, value, 0.1, 10.0, 100.0, 1.0, 0.0)
        for e, value in ((term, 3.0), (lag, 0.01), (sensor, 0.1))
    )
    data = SimpleNamespace(carriers={term.key: EffectProperty("aero/Cm_p2", 0.0)})
    result = SearchResult(
        data,
        ("aero/Cm_q",),
        None,
        None,
        Selection(chosen),
        {e.key: e for e in (term, lag, sensor)},
        {"aero/Cm_q": (-9.0, 0.1)},
        (),
    )  # type: ignore[arg-type]

    def trajectory(*keys: str) -> dict[str, float] | None:
        retained = tuple(c for c in chosen if c.key in keys)
        model = replace(
            result, selection=Selection(retained), parameters={"aero/Cm_q": (-8.0, 0.1)}
        )
        return property_values(model, result)  # type: ignore[arg-type]

    assert trajectory(term.key, lag.key, sensor.key) == {"aero/Cm_q": -8.0, "aero/Cm_p2": 3.0}
    assert trajectory(lag.key) == {"aero/Cm_q": -8.0, "aero/Cm_p2": 0.0}
    assert trajectory(term.key) is None


def test_a_dropped_effect_has_no_property_in_the_remaining_model():
    """The aircraft is written with the selected effects; the data still have those dropped."""
    term, dropped = coefficient_effect("Cm", "p_hat^2"), coefficient_effect("Cm", "de^2")
    carriers = {
        e.key: EffectProperty(f"aero/Cm_{n}", 0.0) for e, n in ((term, "p2"), (dropped, "de2"))
    }
    data = FlightData(
        *((),) * 5, np.zeros(0), (), {}, active=(term, dropped), carriers=carriers
    ).with_effects([term.key])
    point = ModelState({"aero/Cm_q": -8.0}, {}, (), {term.key: 3.0})
    assert data.properties(point) == {"aero/Cm_q": -8.0, "aero/Cm_p2": 3.0}
    assert [e.key for e in data.active] == [term.key]


# End to end: train and test flights of the linear aircraft.


@dataclass
class LinearHoldOut(HoldOutTest):
    """The hold-out test with models fitted to and evaluated on flights of the linear aircraft."""

    flights: LinearFlights
    test_flights: LinearFlights

    def evaluate(self, model, side, initial):
        flights = self.flights if side is self.train else self.test_flights
        return evaluation(flights, estimates(model))

    def leave_out(self, keys):
        retained = [k for k in self.chosen.selection.values if k not in keys]
        return result_of(self.flights, retained)

    def refit(self, remaining):
        return remaining

    @property
    def train_and_test(self):
        values, effects = estimates(self.chosen), self.chosen.selection.values
        sides = [
            flights.linearise(values, [*values]).without_values(effects)
            for flights in (self.flights, self.test_flights)
        ]
        about = {**values, **dict.fromkeys(effects, 0.0)}
        return TrainTestInformation(self.chosen, *sides, (about, about))


def estimates(model: SearchResult) -> dict[str, float]:
    return {n: v for n, (v, _) in model.parameters.items()} | model.selection.values


def evaluation(flights: LinearFlights, values: Mapping[str, float]) -> Evaluation:
    residual = [
        z - simulate(values, de) for de, z in zip(flights.commands, flights.measured, strict=True)
    ]
    white = [r / NOISE for r in residual]
    cost = float(sum(np.sum(w**2) for w in white))
    point = SimpleNamespace(point=None)
    return Evaluation(point, residual, NOISE, white, cost, (0.0,) * len(white), [], np.ones(6))  # type: ignore[arg-type]


def result_of(flights: LinearFlights, keys: Sequence[str]) -> SearchResult:
    """The model with effects ``keys``, fitted to flights, as the search would give it."""
    model, information = flights.model_fit(keys)
    values = model.fit.trajectory.point.values
    rows = information.without_values({k: values[k] for k in keys})
    chosen = []
    for key in keys:
        column, information_left = rows.index([key])[0], rows.index([*PARAMETERS, *keys])
        std = float(
            np.sqrt(
                np.linalg.inv(rows.total[0][np.ix_(information_left, information_left)])[
                    list(information_left).index(column), list(information_left).index(column)
                ]
            )
        )
        t = values[key] / std
        chosen.append(SelectedEffect(key, values[key], std, t, t * t, 1.0, 0.0))
    parameters = {n: (values[n], 1.0) for n in PARAMETERS}
    plain, _ = flights.estimate(())
    context, _ = flights.context(4.0)
    segments = tuple(SimpleNamespace(dt_s=0.02) for _ in flights.commands)
    data = replace(model.data, segments=segments)
    return SearchResult(
        data,
        tuple(PARAMETERS),
        context.baseline_fit,
        model.fit,
        Selection(tuple(chosen)),
        context.effects,
        parameters,
        (),
        plain,
        critical_t=4.0,
    )


def hold_out(train: Mapping[str, float], test: Mapping[str, float], keys: Sequence[str]):
    """Withdrawn and remaining keys of effects that train flights chose."""
    flights = LinearFlights({**PARAMETERS, **train})
    remaining = LinearFlights({**PARAMETERS, **test}, seeds=(4, 5, 6))
    chosen = result_of(flights, keys)
    sides = [Dataset(chosen.data), Dataset(chosen.data)]
    outcome = LinearHoldOut(chosen, None, None, *sides, None, flights, remaining).run()  # type: ignore[arg-type]
    return (
        [c.key for c in outcome.withdrawn],
        [c.key for c in outcome.result.selection.chosen],
        outcome,
    )


SQUARE, CUBE, ELEVATOR = "effect/Cm/alpha^2", "effect/Cm/alpha^3", "effect/Cm/de^2"


def test_an_effect_that_the_test_flights_have_remains_with_its_share():
    withdrawn, remaining, outcome = hold_out({SQUARE: 40.0}, {SQUARE: 40.0}, [SQUARE])
    assert (withdrawn, remaining) == ([], [SQUARE])
    verdict = outcome.verdicts[SQUARE]
    assert verdict.gap == "shrank"
    assert abs(verdict.share[0] - 1.0) < 3.5 * verdict.share[1]
    assert outcome.test.after.cost < outcome.test.before.cost


def test_an_effect_that_the_test_flights_contradict_is_withdrawn_and_others_remain():
    train = {SQUARE: 40.0, ELEVATOR: 0.03}
    withdrawn, remaining, outcome = hold_out(train, {ELEVATOR: 0.03}, [SQUARE, ELEVATOR])
    assert (withdrawn, remaining) == ([SQUARE], [ELEVATOR])
    assert outcome.verdicts[SQUARE].gap == "grew"
    # What remains is estimated without it.
    (effect,) = outcome.result.selection.chosen
    assert abs(effect.value - 0.03) < 3.5 * effect.std
    single = result_of(LinearFlights({**PARAMETERS, **train}), [ELEVATOR])
    assert effect.value == single.selection.chosen[0].value


def test_nothing_remains_where_the_test_flights_have_nothing():
    withdrawn, remaining, outcome = hold_out({SQUARE: 60.0}, {}, [SQUARE])
    assert (withdrawn, remaining) == ([SQUARE], [])
    assert outcome.test.after is outcome.test.before


def test_a_weak_effect_remains_unless_something_is_unexplained():
    """On test flights without effect, a false one of |t| 1 cannot be told from chance; beside a
    curve that no chosen form describes it must be visible there.
    """
    flights = LinearFlights(PARAMETERS)
    chosen = result_of(flights, [CUBE])
    assert abs(chosen.selection.chosen[0].t) < 3.0
    remaining = LinearFlights(PARAMETERS, seeds=(4, 5, 6))
    for mismatch in (None, SimpleNamespace(replaced=())):
        strong = tuple(replace(c, t=5.0) for c in chosen.selection.chosen)
        selection = replace(chosen.selection, chosen=strong)
        model = replace(chosen, mismatch=mismatch, selection=selection)
        sides = [Dataset(chosen.data), Dataset(chosen.data)]
        outcome = LinearHoldOut(model, None, None, *sides, None, flights, remaining).run()  # type: ignore[arg-type]
        assert bool(outcome.withdrawn) is (mismatch is not None)
