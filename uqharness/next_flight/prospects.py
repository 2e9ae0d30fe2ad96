"""What a flight would do to every coefficient's interval where a mission flies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.aerodynamics import COEFFICIENTS, Residuals
from sysid.model_form import (
    Design,
    Information,
    ModelForm,
    Width,
    after,
    expected_width,
    for_ever,
    information,
    mean_power,
    speed_power,
    width,
)
from uqharness.next_flight.mission_states import Occupancy
from uqharness.next_flight.trials import Trial


@dataclass(frozen=True)
class Prospect:
    """Mean widths of one coefficient's interval over the mission: now, after the flight, after as many seconds of what was flown
    before, and after endless flying, the scatter being what it is. narrowing, parameter_narrowing: shares of the width, and of its
    parameter part, that go.

    redone: what bounds made again will show. Their scatter is that of other speeds: noise grows as the dynamic pressure falls.
    """

    now: Width
    then: Width
    redone: Width
    naive: Width
    ever: Width

    @property
    def narrowing(self) -> float:
        """Share by which the mean width shrinks at the present scatter."""
        return 1.0 - self.then.total / self.now.total

    @property
    def parameter_narrowing(self) -> float:
        """Share of the parameter part that goes."""
        return 1.0 - self.then.parameter / self.now.parameter

    @property
    def at_most(self) -> float:
        """Narrowing after endless flying."""
        return 1.0 - self.ever.total / self.now.total


def prospects(
    form: ModelForm, mission: Occupancy, flown: Residuals, weight: float, trials: Sequence[Trial]
) -> dict[str, Prospect]:
    """Of every coefficient, from a simulated flight's states. weight: see `sysid.model_form.worth.information`."""
    behind_s = sum(f.seconds for f in form.flights)
    new_s = sum(float(p.time_s[-1] - p.time_s[0]) for p in flown.pieces)
    scatter = scatter_ratios(form, flown, trials)
    out = {}
    for c, bounds in form.coefficients.items():
        states = mission.of(bounds.states)
        told = [information(bounds, flown.states, weight)]
        share = new_s / behind_s if behind_s > 0.0 else math.nan
        same = Information(
            np.asarray(share * np.linalg.inv(bounds.XtX_inv)),
            share * bounds.n,
            bounds.hull.low,
            bounds.hull.high,
        )
        repeated = after(bounds, [same]) if math.isfinite(share) else bounds
        then = after(bounds, told), after(bounds, told, scatter[c]), repeated, for_ever(bounds)
        out[c] = Prospect(
            width(bounds, states, form.outside),
            *(expected_width(bounds, b, states, form.outside) for b in then),
        )
    return out


def scatter_ratios(form: ModelForm, flown: Residuals, trials: Sequence[Trial]) -> dict[str, float]:
    """Coefficient -> residual variance at a flight's speeds over that behind the bounds, by the trend of the model's trials."""
    out = {}
    speeds = np.array([float(np.mean(t.states["V_mps"])) for t in trials])
    counts = np.array([float(len(t.delta)) for t in trials])
    hull = next(
        (
            (b.hull, b.states.index("V_mps"))
            for b in form.coefficients.values()
            if "V_mps" in b.states
        ),
        None,
    )
    for c in form.coefficients:
        k = COEFFICIENTS.index(c)
        power = speed_power(
            speeds, np.array([float(np.mean(t.delta[:, k] ** 2)) for t in trials]), counts
        )
        if hull is None or power == 0.0:
            out[c] = 1.0
            continue
        box, v = hull
        before = mean_power(box.middle[v], float(box.low[v]), float(box.high[v]), power)
        out[c] = float(np.mean(flown.states["V_mps"] ** power)) / before
    return out


def designs_of(form: ModelForm) -> dict[str, Design]:
    """The form's own terms, to fit other flights as it was fitted."""
    return {c: Design(b.states, b.terms) for c, b in form.coefficients.items()}


def widths_over(form: ModelForm, mission: Occupancy) -> dict[str, Width]:
    """Mean widths of a form's intervals where a mission flies."""
    return {c: width(b, mission.of(b.states), form.outside) for c, b in form.coefficients.items()}
