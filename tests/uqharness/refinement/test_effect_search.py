"""The search for effects, end to end on a linear aircraft of three states with known answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sysid.effects import OVERWHELMING_T
from sysid.effects.catalogue import coefficient_effect, subsystem_effects
from sysid.effects.information import Information
from sysid.effects.selection import RejectedCandidate, SelectedEffect, Selection
from tests.helpers.whitened import information_of
from tests.uqharness.refinement.linear_aircraft import PARAMETERS, LinearFlights
from uqharness.refinement.effect_search import (
    EffectSearch,
    SearchOutcome,
    comparable_candidates,
    delays_among_times,
    simpler_servos,
)
from uqharness.refinement.servos import LikeliestServos

KEYS = ("free", "thrust", "speed", "twin", "other")


def search(flights: LinearFlights, critical_t: float | None = None) -> SearchOutcome:
    context, information = flights.context(critical_t)
    return EffectSearch(context, flights, lambda _: None).run(information)


def flights(**effects: float) -> LinearFlights:
    scaled = {k: v * 1.1 for k, v in PARAMETERS.items()}
    return LinearFlights({**scaled, **{f"effect/Cm/{k}": v for k, v in effects.items()}})


def test_a_missing_effect_is_named_with_its_value_and_the_parameters_are_right():
    truth = flights(**{"alpha^2": 40.0})
    outcome = search(truth)
    (effect,) = outcome.model.selection.chosen
    assert effect.key == "effect/Cm/alpha^2"
    assert abs(effect.value - 40.0) < 3.5 * effect.std
    assert 2.0 < effect.std < 5.0
    assert outcome.model.is_stationary
    values = outcome.model.fit.trajectory.point.values
    assert values["aero/Cm_q"] == pytest.approx(1.1 * PARAMETERS["aero/Cm_q"], rel=0.03)
    assert truth.fitted == [("effect/Cm/alpha^2",)]


def test_nothing_is_named_where_nothing_is_missing():
    truth = flights()
    outcome = search(truth)
    assert outcome.model.keys == set()
    assert truth.fitted == []
    assert outcome.model.criterion == truth.context()[0].baseline_cost


def test_likely_servos_are_fitted_although_no_candidate_alone_is_selected():
    truth = flights()
    context, information = truth.context()
    effects = {"effect/Cm/alpha^2": 4.0, "effect/Cm/de^2": 0.003}
    context = replace(context, servos=LikeliestServos(effects, 500.0))
    outcome = EffectSearch(context, truth, lambda _: None).run(information)
    assert {*truth.fitted[0]} == {*effects}
    # The simulated flights decide.
    assert outcome.model.keys == set()


def test_servos_with_lag_and_rate_limit_are_also_proposed_with_one_of_them():
    elevator, aileron = "effect/actuator.elevator/", "effect/actuator.aileron/"
    keys = [f"{elevator}lag", f"{elevator}rate_limit", f"{aileron}lag"]
    chosen = tuple(SelectedEffect(k, 0.1, 0.01, 10.0, 100.0, 50.0, 0.0) for k in keys)
    simpler = [[*s.values] for s in simpler_servos(Selection(chosen))]
    assert simpler == [[f"{elevator}lag", f"{aileron}lag"], [f"{elevator}rate_limit", keys[2]]]
    assert simpler_servos(Selection(chosen[1:])) == []


def test_two_effects_are_named_with_their_values():
    outcome = search(flights(**{"alpha^2": 40.0, "de^2": 0.03}))
    assert outcome.model.keys == {"effect/Cm/alpha^2", "effect/Cm/de^2"}
    for effect in outcome.model.selection.chosen:
        true = {"effect/Cm/alpha^2": 40.0, "effect/Cm/de^2": 0.03}[effect.key]
        assert abs(effect.value - true) < 3.5 * effect.std


def test_an_overwhelming_effect_flies_before_others_are_proposed():
    truth = flights(**{"alpha^2": 60.0, "de^2": 0.04})
    context, information = truth.context()
    first = context.select(information, context.free)
    assert len(first.chosen) == 1
    assert abs(first.chosen[0].t) > OVERWHELMING_T
    outcome = search(truth)
    assert len(truth.fitted[0]) == 1
    assert outcome.model.keys == {"effect/Cm/alpha^2", "effect/Cm/de^2"}


def test_an_effect_below_the_limit_stays_out_and_the_criterion_decides():
    """At a critical_t above its |t| an effect is not proposed; the model's criterion counts its cost."""
    truth = flights(**{"alpha^2": 20.0})
    listed = search(truth, critical_t=3.5)
    t = abs(listed.model.selection.chosen[0].t)
    assert 3.5 < t < OVERWHELMING_T
    assert search(truth, critical_t=1.05 * t).model.keys == set()
    context, _ = truth.context(3.5)
    assert listed.model.criterion < context.baseline_cost
    assert listed.model.criterion == pytest.approx(
        listed.model.fit.trajectory.cost
        + 0.6 * 3.5**2
        + context.effects["effect/Cm/alpha^2"].penalty
    )


class Unfollowed(LinearFlights):
    """Flights that no estimator follows with some effects in the model."""

    unfollowed: frozenset[str] = frozenset()

    def fit(self, context, proposal, reference, label):
        """Fit, or None."""
        if self.unfollowed & proposal.values.keys():
            self.fitted.append(tuple(proposal.values))
            return None
        return super().fit(context, proposal, reference, label)


def test_where_no_estimator_follows_the_flights_candidates_that_explain_as_much_are_tried():
    truth = Unfollowed(flights(**{"alpha^3": 900.0}).truth)
    truth.unfollowed = frozenset({"effect/Cm/alpha^3"})
    outcome = search(truth)
    assert truth.fitted[0] == ("effect/Cm/alpha^3",)
    assert "effect/Cm/alpha^3" not in outcome.model.keys
    truth.unfollowed = frozenset(truth.context()[0].effects)
    blocked = search(truth)
    assert blocked.model.keys == set()
    assert any("neither replayed nor filtered" in line for line in blocked.trail)


class WronglyReplayed(LinearFlights):
    """Flights of which the model without effects replays the second wrongly, by ``error``."""

    error: float = 0.0

    def linearise(self, values, names):
        """Return the information."""
        if any(n.startswith("effect/") for n in values):
            return super().linearise(values, names)
        wrong = LinearFlights({**self.truth, "effect/Cm/alpha^2": self.error})
        flights = LinearFlights(self.truth)
        flights.measured[1] = wrong.measured[1]
        return flights.linearise(values, names)


@pytest.mark.parametrize(
    ("size", "error", "keys"),
    [(60.0, -30.0, {"effect/Cm/alpha^2"}), (0.0, 60.0, set())],
)
def test_an_effect_whose_parts_differ_by_a_wrong_replay_is_simulated(size, error, keys):
    truth = WronglyReplayed(flights(**{"alpha^2": size}).truth)
    truth.error = error
    context, information = truth.context()
    selection = context.select(information, context.free)
    assert not selection.chosen
    assert selection.refused is not None
    assert "parts" in selection.refused.reason
    assert search(truth).model.keys == keys


class TwoRefusals(LinearFlights):
    """Flights whose baseline refuses two candidates, of which the first is not there."""

    keys = "effect/Cm/de^2", "effect/Cm/alpha^2"

    def context(self, critical_t=None):
        """Return the context, with a selection of nothing about the model without effects."""
        context, information = super().context(critical_t)
        refusals = tuple(
            RejectedCandidate(k, 8.0, 64.0, "parts", unconfirmed=True) for k in self.keys
        )
        empty = Selection((), refusals)
        select = context.select

        class Context(type(context)):
            """Selects as usual about other models."""

            def select(self, about, free, chosen=()):
                """Return the empty selection about the baseline."""
                return empty if about is information and not chosen else select(about, free, chosen)

        return Context(**vars(context)), information


def test_the_next_refused_candidate_is_simulated_where_the_first_is_not_there():
    truth = TwoRefusals(flights(**{"alpha^2": 60.0}).truth)
    context, information = truth.context()
    outcome = EffectSearch(context, truth, lambda _: None).search(information, "round")
    assert truth.fitted[:2] == [(k,) for k in truth.keys]
    assert outcome.model.keys == {"effect/Cm/alpha^2"}


# Which other candidates compete, from normal equations with known columns.


def information(share: float = 0.3) -> Information:
    """``speed`` is there; ``thrust`` resembles it, ``twin`` is thrust by another name."""
    rng = np.random.default_rng(6)
    free, speed, different, other = rng.standard_normal((4, 400, 2))
    thrust = speed + share * different
    columns = np.stack([free, thrust, speed, -2.0 * thrust, other], axis=2)
    residual = 2.0 * speed + rng.standard_normal((400, 2))
    return information_of(residual, columns, KEYS)


def test_comparable_candidates_explain_nearly_as_much_and_are_something_else():
    close = information()
    assert comparable_candidates(close, ["free"], KEYS[1:], "thrust") == ["speed"]
    assert comparable_candidates(close, ["free"], KEYS[1:], "speed") in (["thrust"], ["twin"])
    assert comparable_candidates(close, ["free"], ["thrust"], "thrust") == []
    # Half of the gain is the least: a column with more of its own than of speed has less.
    distant = information(share=1.3)
    assert comparable_candidates(distant, ["free"], KEYS[1:], "speed") == []


TIMES = {
    e.key: e
    for e in (
        *subsystem_effects(
            ["aileron"], ["p_radps", "alpha_rad"], ["rates", "alpha_rad"], ["p_radps", "phi_rad"]
        ),
        coefficient_effect("Cm", "p_hat^2"),
    )
}


@pytest.mark.parametrize(
    ("keys", "doubtful"),
    [
        (["sensor.p_radps/delay", "actuator.aileron/lag"], True),
        (["sensor.p_radps/delay", "sensor.phi_rad/delay"], True),
        (["sensor.p_radps/delay", "sensor.alpha_rad/delay"], True),
        (["actuator.aileron/deadband", "sensor.phi_rad/delay"], True),
        ([], False),
        (["sensor.p_radps/delay"], False),
        (["sensor.p_radps/delay", "Cm/p_hat^2"], False),
        (["sensor.rates/delay", "actuator.aileron/lag"], False),
        (["sensor.p_radps/scale", "actuator.aileron/lag"], False),
    ],
)
def test_the_delay_of_one_channel_is_doubtful_beside_another_time(keys, doubtful):
    some = [SelectedEffect(f"effect/{k}", 1.0, 0.1, 10.0, 100.0, 30.0, 0.0) for k in keys]
    assert bool(delays_among_times(some, TIMES)) is doubtful
