"""Where hold-out flights seem to contradict an effect: what the train flights' own errors make of that.

A model that is right is as uncertain as the flights that estimated it, most of all where the hold-out flights go and the train
flights did not: an effect and its coefficient's constant, estimated between 19 and 29 m/s, predict 15 m/s no better than that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.arrays import FloatArray
from sysid.effects import Evidence, shared, solve
from sysid.parallel import Processes
from uqharness.identification.linearised import (
    Bench,
    Fit,
    Flown,
    Setup,
    effect_columns,
    fit_at,
    gust_refit,
    with_jumps,
    with_sensors_of,
)
from uqharness.refinement.find import Found
from uqharness.refinement.setup import column_evidence
from uqharness.refinement.showing.show import Shown
from uqharness.refinement.types import Side
from uqharness.simulator import Aircraft


@dataclass(frozen=True)
class Both:
    """Evidence of the train flights and of the hold-out flights, each about parameters of its own and no effect."""

    found: Found
    train: Evidence
    test: Evidence
    at: tuple[dict[str, float], dict[str, float]]

    def t(self, key: str, beside: Sequence[str]) -> float:
        """t of an effect beside others, everything estimated on all flights, corrected as that of the train flights is."""
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
        """Variance of twice the log likelihood's change by errors of the parameters and of some effects, as train flights estimate
        them; apart [(n, m)]: whitened residuals without the effect in question less those with it."""
        names = [*self.found.names, *beside]
        G, _ = shared(self.train, names, self.at[0])
        some = self.test.index(names)
        y = np.zeros(len(names))
        for w, d in zip(self.test.white, apart, strict=True):
            y += np.einsum("nmc,nm->c", self.test.series(w, some), np.nan_to_num(d))
        return max(float(4.0 * y @ solve(G, y[:, None])[:, 0]), 0.0)


def linearised(
    found: Found, aircraft: Aircraft, side: Side, setup: Setup, flown: Flown, map_: Processes
) -> tuple[Setup, Fit]:
    """Flights that an aircraft with everything of ``found`` in its XML flew, linearised there, and their setup."""
    values = {**flown.point.values, **{n: v for n, (v, _) in found.parameters.items()}}
    point = replace(flown.point, values=values, effects=found.selection.values)
    with Bench(aircraft, setup) as bench:
        setup = with_jumps(with_sensors_of(setup, aircraft), bench.model)
        if side.air is None:
            fit = fit_at(
                bench.model, bench.straight, setup, found.names, replace(flown, point=point), map_
            )
            return setup, fit
        fitted = gust_refit(
            bench.model,
            bench.straight,
            setup,
            point,
            found.names,
            {},
            map_,
            side.air,
            1,
            known=True,
        )
        return fitted.setup, fitted.fit


def both_sides(
    found: Found, train: Evidence, aircraft: Aircraft, side: Side, shown: Shown, map_: Processes
) -> Both:
    """train: evidence of the train flights about no effect; aircraft: with every effect of ``found``, which flew the hold-out
    flights as ``shown``."""
    chosen = found.selection.values
    effects = [found.effects[key] for key in chosen]
    setup, fit = linearised(found, aircraft, side, side.setup, shown.flown, map_)
    test = column_evidence(
        setup, fit, effect_columns(setup, fit.probes, fit.flown, effects), side.air
    )
    zero = dict.fromkeys(chosen, 0.0)
    before = {n: found.after.flown.point.values[n] for n in found.names}
    after = {n: v for n, (v, _) in found.parameters.items()}
    return Both(found, train, test.taken_out(chosen), ({**zero, **before}, {**zero, **after}))
