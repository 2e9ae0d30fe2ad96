"""What test flights say of the effects that train flights chose: each effect without which the gap
is no larger is withdrawn.

Beside something that nothing explains, which goes with many candidates a little, an effect must be
seen on the test flights. Nothing is chosen here. An effect stands or falls alone: the others and
the parameters are estimated again without it, on the train flights, and the test flights are flown
both ways."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from sysid.arrays import FloatArray
from sysid.effects import FAR, Choice, Columns, Evidence, corrected_each, shared, solve
from sysid.parallel import Processes
from uqharness.identification.linearised import (
    FlightData,
    Linearisation,
    ModelState,
    StagedModels,
    Trajectory,
    effect_columns,
    fit_at,
    fly,
    gust_refit,
    in_dynamics,
    in_one_step,
    merged,
    with_jumps,
    with_sensors_of,
)
from uqharness.refinement.evaluation import Shown, left_in, show, with_replays
from uqharness.refinement.round import Side, column_evidence
from uqharness.refinement.rounds import fit_point, fitted_effects, sensors_moved, with_values
from uqharness.refinement.search import Found
from uqharness.results.refinement import Gap
from uqharness.simulator import Aircraft

# Where hold-out flights seem to contradict an effect: what the train flights' own errors make
# of that.
#
# A model that is right is as uncertain as the flights that estimated it, most of all where the
# hold-out flights go and the train flights did not: an effect and its coefficient's constant,
# estimated between 19 and 29 m/s, predict 15 m/s no better than that.


@dataclass(frozen=True)
class Both:
    """Evidence of the train flights and of the hold-out flights, each about parameters of its own
    and no effect.
    """

    found: Found
    train: Evidence
    test: Evidence
    at: tuple[dict[str, float], dict[str, float]]

    def t(self, key: str, beside: Sequence[str]) -> float:
        """t of an effect beside others, everything estimated on all flights, corrected as that of
        the train flights is.
        """
        names = [*self.found.names, *beside]
        sides = [
            shared(e, names, at) for e, at in zip((self.train, self.test), self.at, strict=True)
        ]
        G, h = (np.sum(parts, axis=0) for parts in zip(*sides, strict=True))
        k, unit = names.index(key), np.eye(len(names))
        value, variance = solve(G, h[:, None])[k, 0], solve(G, unit)[k, k]
        choice = next(c for c in self.found.selection.chosen if c.key == key)
        return float(value / np.sqrt(variance) * abs(choice.t) / np.sqrt(choice.gain))

    def variance(self, apart: Sequence[FloatArray], beside: Sequence[str]) -> float:
        """Variance of twice the log likelihood's change by errors of the parameters and of some
        effects, as train flights estimate them; apart [(n, m)]: whitened residuals without the
        effect in question less those with it."""
        names = [*self.found.names, *beside]
        G, _ = shared(self.train, names, self.at[0])
        some = self.test.index(names)
        y = np.zeros(len(names))
        for w, d in zip(self.test.white, apart, strict=True):
            y += np.einsum("nmc,nm->c", self.test.series(w, some), np.nan_to_num(d))
        return max(float(4.0 * y @ solve(G, y[:, None])[:, 0]), 0.0)


def linearised(
    found: Found,
    aircraft: Aircraft,
    side: Side,
    setup: FlightData,
    flown: Trajectory,
    map_: Processes,
) -> tuple[FlightData, Linearisation]:
    """Flights that an aircraft with everything of ``found`` in its XML flew, linearised there, and
    their setup.
    """
    values = {**flown.point.values, **{n: v for n, (v, _) in found.parameters.items()}}
    point = replace(flown.point, values=values, effects=found.selection.values)
    with StagedModels(aircraft, setup) as bench:
        setup = with_jumps(with_sensors_of(setup, aircraft), bench.model)
        if side.air is None:
            fit = fit_at(
                bench.model,
                bench.direct_model,
                setup,
                found.names,
                replace(flown, point=point),
                map_,
            )
            return setup, fit
        fitted = gust_refit(
            bench.model,
            bench.direct_model,
            setup,
            point,
            found.names,
            {},
            map_,
            side.air,
            1,
            fixed_air=True,
        )
        return fitted.setup, fitted.fit


def both_sides(
    found: Found, train: Evidence, aircraft: Aircraft, side: Side, shown: Shown, map_: Processes
) -> Both:
    """train: evidence of the train flights about no effect; aircraft: with every effect of
    ``found``, which flew the hold-out flights as ``shown``."""
    chosen = found.selection.values
    effects = [found.effects[key] for key in chosen]
    setup, fit = linearised(found, aircraft, side, side.setup, shown.flown, map_)
    test = column_evidence(
        setup, fit, effect_columns(setup, fit.probes, fit.trajectory, effects), side.air
    )
    zero = dict.fromkeys(chosen, 0.0)
    before = {n: found.after.trajectory.point.values[n] for n in found.names}
    after = {n: v for n, (v, _) in found.parameters.items()}
    return Both(found, train, test.taken_out(chosen), ({**zero, **before}, {**zero, **after}))


Write = Callable[[Found], Aircraft]
CANNOT_TELL: Gap = "cannot tell"
BLOCK_S = 2.0
"""Residuals this far apart count as independent."""
BEYOND_CHANCE = 1.645
"""Standard errors beyond which a change of the gap is not chance's: noise alone does that once in
twenty times.
"""


@dataclass(frozen=True)
class Verdict:
    """Of one effect on the test flights: by how much minus twice the log likelihood is larger
    without it, and the standard error of that. far: rms of the better model's residuals over noise,
    over that of the train flights; beyond: by how much t^2 of both sides is above the square of the
    limit asked; between: sum of the squares of what lies between the two models' predictions,
    whitened, and that of the model without less that of the model with it."""

    change: float
    std: float
    far: float = 1.0
    beyond: float = np.inf
    between: tuple[float, float] = (0.0, 0.0)

    @property
    def share(self) -> tuple[float, float]:
        """Share of the effect's estimate that fits the test flights best, and its standard error:
        with a and b the residuals without and with it and d = a - b, a.d / d.d = (1 + (a.a - b.b) /
        d.d) / 2. NaN where the models are the same."""
        size, fall = self.between
        return (0.5 + 0.5 * fall / size, 0.5 * self.std / size) if size > 0.0 else (np.nan, np.nan)

    @property
    def seen(self) -> bool:
        """Whether the test flights have more than half of the effect's estimate, and more than
        chance gives them.
        """
        share, std = self.share
        return share > max(0.5, BEYOND_CHANCE * std)

    @property
    def z(self) -> float:
        """Change of the log likelihood over its standard deviation; 0 where there is none."""
        return self.change / self.std if self.std > 0.0 else 0.0

    @property
    def says(self) -> Gap:
        """shrank, grew, cannot tell (a change that chance gives as well), or too far (flights that
        judge neither model).
        """
        if self.far > FAR:
            return "too far"
        # Both sides' evidence together must still be what is asked of an effect.
        against = self.change < 0.0 and self.beyond < 0.0
        return (
            "shrank"
            if self.z > BEYOND_CHANCE
            else "grew"
            if against or self.z < -BEYOND_CHANCE
            else CANNOT_TELL
        )


@dataclass(frozen=True)
class Judged:
    """What stands, estimated without what was withdrawn; the gap on both sides before and after.

    verdicts   of every effect by key: of those that stand, beside the others that stand; of a
    withdrawn one, as it was withdrawn
    sides      train and test as they were flown
    """

    found: Found
    withdrawn: tuple[Choice, ...]
    verdicts: dict[str, Verdict]
    train: tuple[FlightData, Shown, Shown]
    test: tuple[FlightData, Shown, Shown]
    sides: tuple[Side, Side]


def judge(
    found: Found, whole: Aircraft, write: Write, train: Side, test: Side, map_: Processes
) -> Judged:
    """Fly both sides before and after; withdraw effects one by one, the one that harms most first.
    whole: the aircraft with every effect of ``found``; write: one of a model's own."""

    def flown(model: Found, side: Side, near: ModelState | None) -> Shown:
        aircraft, values = flown_as(model, found, whole, write)
        return show(aircraft, side, map_, written_at(model, values, near))

    def shown(model: Found, side: Side, before: Shown) -> Shown:
        if side.air is None:
            return before
        aircraft, values = flown_as(model, found, whole, write)
        return with_replays(before, aircraft, side, map_, written_at(model, values))

    @cache
    def evidence() -> Evidence:
        return evidence_of(found)

    @cache
    def both() -> Both:
        return both_sides(found, evidence(), whole, test, everything, map_)

    own = found.after.trajectory.point
    pair = flown(bare(found), train, found.before.trajectory.point)
    fitted = flown(found, train, own) if found.selection.chosen else pair
    before = flown(bare(found), test, None)
    standing, after = found, flown(found, test, None) if found.selection.chosen else before
    everything = after
    verdicts: dict[str, Verdict] = {}
    gone: list[Choice] = []
    while standing.selection.chosen:
        without: dict[str, tuple[Found, Shown]] = {}
        now: dict[str, Verdict] = {}
        for c in standing.selection.chosen:
            if len(standing.selection.chosen) == 1:
                less = bare(standing), before
            else:
                model = left_out(found, evidence(), [*(g.key for g in gone), c.key])
                less = model, flown(model, test, after.flown.point)
            without[c.key] = less
            now[c.key] = gap_change(less[1], after, test.setup, fitted, c.t**2 - found.limit**2)
        # Two effects may undo each other: then neither alone is in the way.
        together = gap_change(before, after, test.setup, fitted) if len(now) > 1 else None
        if any(v is not None and v.says == "grew" for v in (*now.values(), together)):
            now = {k: surer(v, both(), without[k][1], after, list(now), k) for k, v in now.items()}
            together = together and surer(together, both(), before, after, list(now))
        worst = min(now, key=lambda k: now[k].z)
        if now[worst].says != "grew" and together is not None and together.says == "grew":
            now[worst] = together
        verdicts |= now
        if now[worst].says != "grew":
            unseen = [k for k, v in now.items() if v.says == CANNOT_TELL and not v.seen]
            if not unseen or (found.bent is None and not left_in(train.setup, fitted, found.gusty)):
                break
            worst = min(unseen, key=lambda k: now[k].z)
        gone.append(next(c for c in found.selection.chosen if c.key == worst))
        standing, after = without[worst]
    if gone and standing.selection.chosen:
        fitted_again = refitted(standing, found, whole, map_)
        if fitted_again is not standing:
            standing, after = fitted_again, flown(fitted_again, test, after.flown.point)
    settled = (
        fitted if not gone else flown(standing, train, own) if standing.selection.chosen else pair
    )

    def both_ways(side: Side, plain: Shown, with_: Shown) -> tuple[FlightData, Shown, Shown]:
        first = shown(bare(found), side, plain)
        return side.setup, first, first if with_ is plain else shown(standing, side, with_)

    on_train, on_test = both_ways(train, pair, settled), both_ways(test, before, after)
    return Judged(standing, tuple(gone), verdicts, on_train, on_test, (train, test))


def surer(
    verdict: Verdict,
    both: Both,
    without: Shown,
    after: Shown,
    keys: Sequence[str],
    key: str | None = None,
) -> Verdict:
    """The verdict, of one effect by key or of all, with the errors of what the train flights
    estimated in its standard error and, of one, all flights' t in what both sides say. keys: of the
    effects that ``after`` has."""
    apart = [a - b for a, b in zip(without.white, after.white, strict=True)]
    # The effect's own error is in both terms of the change, and to the first order in neither.
    rest = [k for k in keys if key is not None and k != key]
    std = float(np.hypot(verdict.std, np.sqrt(both.variance(apart, rest))))
    return replace(
        verdict,
        std=std,
        beyond=np.inf if key is None else both.t(key, keys) ** 2 - both.found.limit**2,
    )


def flown_as(
    model: Found, found: Found, whole: Aircraft, write: Write
) -> tuple[Aircraft, dict[str, float]]:
    """The aircraft with every effect of ``found``, and properties with which it flies as ``model``:
    each XML of its own would be compiled anew. One that is written where a number of the model
    stands in the XML alone."""
    values = property_values(model, found)
    return (write(model), {}) if values is None else (whole, values)


def property_values(model: Found, found: Found) -> dict[str, float] | None:
    """Properties with which an aircraft that has the effects of ``found`` flies as ``model`` does,
    which has some of them; None where a number stands in the XML alone."""
    values = {name: value for name, (value, _) in model.parameters.items()}
    own = model.selection.values
    for c in found.selection.chosen:
        if not in_dynamics(found.effects[c.key]):
            continue
        place = found.setup.carriers.get(c.key)
        if place is not None and (c.key in own or place.exact):
            values[place.name] = place.at(own.get(c.key, 0.0))
        elif own.get(c.key) != c.value:
            return None
    return values


def written_at(
    found: Found, values: Mapping[str, float] | None = None, near: ModelState | None = None
) -> ModelState:
    """The point of an aircraft that was written as ``found``, but for properties of other
    ``values``: its sensors' effects, and nuisance and start states of another model's point in the
    same flights."""
    nuisance, starts = ({}, ()) if near is None else (near.nuisance, near.starts)
    sensed = {
        k: value for k, value in found.selection.values.items() if not in_dynamics(found.effects[k])
    }
    return ModelState(values or {}, nuisance, starts, sensed)


def bare(found: Found) -> Found:
    """The same without effects, its parameters as they were re-identified without any."""
    parameters = {n: (found.plain[n], found.parameters[n][1]) for n in found.names}
    return replace(found, parameters=parameters, selection=replace(found.selection, chosen=()))


def gap_change(
    without: Shown, with_: Shown, setup: FlightData, fitted: Shown, spare: float = np.inf
) -> Verdict:
    """The rise of minus twice the log likelihood when an effect is left out.

    With a and b the whitened residuals without and with it and d = a - b, the rise is sum(a^2 -
    b^2) = sum(d^2) + 2 sum(b d): what noise makes of it is 2 sum(e d), e being noise, for which the
    residuals of the better model stand. Its variance is that of sums over blocks, so that residuals
    may be coloured within them. Predictions with another damping have another variance, too: what
    it changes the squares by, in d, the rise of the logarithms takes back. fitted: the model with
    its effects on the train flights."""
    better = with_ if with_.surprise <= without.surprise else without
    change = variance = size = fall = 0.0
    wider = 2.0 * (np.array(without.logdet) - np.array(with_.logdet))
    rows = zip(without.white, with_.white, better.white, wider, setup.segments, strict=True)
    for a, b, e, logarithms, segment in rows:
        fall += (own := float(np.nansum(a**2 - b**2)))
        size += float(np.nansum((a - b) ** 2))
        change += own + logarithms
        terms = np.nansum(2.0 * e * (a - b), axis=1) + logarithms / len(a)
        starts = np.arange(0, len(terms), max(1, round(BLOCK_S / segment.dt_s)))
        variance += float(np.sum(np.add.reduceat(terms, starts) ** 2))
    far = _mean_square(better) ** 0.5 / _mean_square(fitted) ** 0.5
    return Verdict(change, float(np.sqrt(variance)), far, change + spare, (size, fall))


def _mean_square(shown: Shown) -> float:
    """Of the residuals over noise."""
    return shown.cost / sum(int(np.isfinite(w).sum()) for w in shown.white)


def evidence_of(found: Found, also: Sequence[str] = (), more: Sequence[Columns] = ()) -> Evidence:
    """Evidence of the train flights as it is with no effect in the model: columns of parameters,
    nuisance, chosen effects, the candidates ``also``, and ``more``, one set a segment."""
    flown = {e.key for e in found.setup.active}
    keys = dict.fromkeys([*found.selection.values, *also])
    rest = [found.effects[k] for k in keys if k not in flown]
    columns = effect_columns(found.setup, found.after.probes, found.after.trajectory, rest)
    columns = merged(columns, more) if len(more) else columns
    return column_evidence(found.setup, found.after, columns, found.gusts).taken_out(found.flown)


def left_out(found: Found, evidence: Evidence, keys: Sequence[str]) -> Found:
    """Estimate everything on the train flights without the effects ``keys``; bare if none is left.

    The stated estimates come from replays. They move as far as the linear estimates move when the
    effects are left out, and their standard errors change in the same proportion.
    """
    kept = [c for c in found.selection.chosen if c.key not in keys]
    if not kept:
        return bare(found)
    effects = {e.key for e in found.setup.active} | found.selection.values.keys()
    free = [n for n in evidence.names if n not in effects]
    chosen_keys, kept_keys = [c.key for c in found.selection.chosen], [c.key for c in kept]
    with_all = corrected_each(evidence, [*free, *chosen_keys], chosen_keys)
    with_kept = corrected_each(evidence, [*free, *kept_keys], kept_keys)
    chosen = []
    for c in kept:
        value, std = _moved((c.value, c.std), with_all[c.key], with_kept[c.key])
        chosen.append(replace(c, value=value, std=std, t=value / std))
    before, after = (
        in_one_step(evidence, found.names, found.after, names) for names in (chosen_keys, kept_keys)
    )
    parameters = {n: _moved(found.parameters[n], before[n], after[n]) for n in found.names}
    selection = replace(found.selection, chosen=tuple(chosen))
    return replace(found, parameters=parameters, selection=selection)


def _moved(
    stated: tuple[float, float], before: Sequence[float], after: Sequence[float]
) -> tuple[float, float]:
    """Return a stated (value, standard error), moved as the linear estimate of it moves."""
    return stated[0] + (after[0] - before[0]), stated[1] * (after[1] / before[1])


def refitted(model: Found, found: Found, whole: Aircraft, pool: Processes) -> Found:
    """Estimate a model from which effects were withdrawn by output error on replays of the train
    flights.

    Parameters
    ----------
    model : what stands, estimated on linearised columns
    found : the model with every effect that the train flights chose
    whole : the aircraft with every effect of ``found``; withdrawn ones fly at zero

    Returns
    -------
    The model with new values and the standard errors it had. In turbulence, where a number stands
    in the XML alone, and where the fit does not converge or fits worse, the model as given.
    """
    if found.gusts is not None or property_values(model, found) is None:
        return model
    values = model.selection.values
    effects = {e.key: values.get(e.key, 0.0) for e in found.setup.active}
    estimates = {n: value for n, (value, _) in model.parameters.items()}
    point = found.after.trajectory.point
    point = replace(point, values={**point.values, **estimates}, effects=effects)
    if sensors_moved(found.setup, point):
        return model
    names = [n for n in found.names if n in point.values]
    bounds = {n: c.bounds for n, c in whole.card.parameters.items() if c.bounds is not None}
    withdrawn = effects.keys() - values.keys()
    with StagedModels(whole, found.setup) as bench:
        linear = fly(bench.model, found.setup, point, pool)
        fit = fit_point(bench.model, found.setup, point, names, bounds, pool, withdrawn)
    if fit is None or fit.cost > linear.cost:
        return model
    kept = fitted_effects(found.setup).keys() & values.keys()
    selection = with_values(model.selection, {key: fit.point.effects[key] for key in kept})
    parameters = {
        n: (fit.point.values[n] if n in names else value, std)
        for n, (value, std) in model.parameters.items()
    }
    return replace(model, parameters=parameters, selection=selection)
