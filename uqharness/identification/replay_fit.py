"""The one fit of a model to flights: output error on replays, by which models are identified, compared and refined.

Beside the parameters it estimates what no model knows: start states of the segments, biases of the gyros, delays, of the
controls above all. The noise of the channels is what the fit leaves of them.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from sysid.estimation import OutputErrorFit
from sysid.estimation.output_error import output_error
from uqharness.errors import BadInputError
from uqharness.replay import (
    CONTROL_DELAY,
    SHORT_STEP_S,
    Layout,
    Replay,
    ReplayModel,
    Segment,
    nuisance_layout,
)

MAX_ITERATIONS = 40
TOLERANCE = 0.05
"""Standard errors: a shorter step ends the search."""


@dataclass(frozen=True)
class Observed:
    """What replays are compared with: segments, and data [(n, m)] of the channels ``outputs`` in them.

    biases  channels with a constant bias, one a flight       late  flight -> sensors, or CONTROL_DELAY, whose delay is estimated
    late_s  channel -> time by which it is known to come late besides
    properties  values of properties in all replays      held  parameters that are not estimated, and why
    begin   values of biases, delays and shares, by their names in the layout, from which they are sought; 0 for the others
    """

    cut: Sequence[Segment]
    outputs: tuple[str, ...]
    data: Sequence[FloatArray]
    biases: Sequence[str]
    late: Mapping[str, Sequence[str]]
    late_s: Mapping[str, float] = field(default_factory=dict)
    properties: Mapping[str, float] = field(default_factory=dict)
    held: Mapping[str, str] = field(default_factory=dict)
    begin: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ReplayFit:
    """Where output error ended; theta of ``found`` is the layout's. lost: parameters that the flights do not determine, held."""

    found: OutputErrorFit
    layout: Layout
    replay: Replay
    lost: tuple[str, ...]

    def values(self) -> dict[str, float]:
        """Estimates of everything by name."""
        return dict(zip(self.layout.names, self.found.theta.tolist(), strict=True))

    def starts(self) -> list[FloatArray]:
        """(9,) start state of every segment."""
        return [start for start, *_ in self.replay.starts_at(self.found.theta)]


def fit_replays(
    model: ReplayModel,
    observed: Observed,
    names: Sequence[str],
    tries: Sequence[FloatArray],
    limits: Sequence[tuple[float, float]],
    map_: Callable[..., Any],
    errors: bool = True,
    told: Callable[[int, float], None] | None = None,
) -> ReplayFit:
    """Fit properties ``names`` of a model, and everything that is estimated beside them.

    tries   values to begin from, the first that can be flown counts; what the flights do not determine stays at the last
    map_    as `replay_pool` or `spread_over` gives it      errors  False for estimates alone, without standard errors
    told    is told each iteration's number and the length of the next step in standard errors
    What ``observed`` holds stays at the last of ``tries``.
    Raises BadInputError when the model cannot fly the segments.
    """
    jumping = jumping_in(model, observed.cut, observed.late)
    layout = nuisance_layout(
        names, limits, observed.cut, observed.biases, observed.outputs, observed.late, jumping
    )
    replay = Replay(
        model,
        observed.cut,
        layout.names,
        observed.outputs,
        uuid.uuid4().hex,
        observed.properties,
        observed.late_s,
    )

    def fit_within(
        bounds: Sequence[tuple[float, float]], theta: FloatArray, free: Sequence[str]
    ) -> OutputErrorFit:
        return output_error(
            replay,
            theta,
            list(observed.data),
            names=layout.names,
            bounds=bounds,
            free=list(free),
            map=map_,
            tolerance=TOLERANCE,
            max_iterations=MAX_ITERATIONS,
            differences="secant",
            errors=errors,
            told=told,
        )

    def fit_from(theta: FloatArray, free: Sequence[str]) -> OutputErrorFit:
        fit = fit_within(layout.bounds, theta, free)
        kinked = _kinked_delays(model, layout, fit)
        # At a row where a surface jumps the rates have a kink: as functions of the delay they have it at zero. A descent that
        # crosses it to and fro settles on neither side, so each side is searched by itself, from and up to zero.
        for side in (0.0, -np.inf) if kinked else ():
            places = [k for k in kinked if side == 0.0 or fit.theta[k] == 0.0]
            if not places:
                break
            bounds = list(layout.bounds)
            for k in kinked:
                low, high = layout.bounds[k]
                bounds[k] = (0.0, high) if fit.theta[k] > 0.0 or side == 0.0 else (low, 0.0)
            begin = _with(fit.theta, np.zeros(len(fit.theta)), places)
            again = fit_within(bounds, begin, free)
            fit = replace(again, n_simulations=fit.n_simulations + again.n_simulations)
        return fit

    held = observed.held
    tries = [_with(values, tries[-1], [list(names).index(n) for n in held]) for values in tries]
    free = [n for n in layout.names if n not in held]
    rest = np.array([observed.begin.get(n, 0.0) for n in layout.names[len(names) :]])
    begun = [np.concatenate([values, rest]) for values in tries]
    fit = _first_that_flies(lambda theta: fit_from(theta, free), begun)
    fit = replace(
        fit,
        status={**fit.status, **dict.fromkeys(held, "not-identified")},
        reason={**fit.reason, **held},
    )
    lost = tuple(n for n in names if fit.status[n] == "not-identified" and n not in held)
    if lost:
        # What the data do not determine goes back to where it was, so that the rest is estimated beside values that will be flown.
        # What was estimated beside a value far from there, at a bound, may fit worse than what the estimate began with.
        places = [layout.names.index(n) for n in lost]
        options = [_with(theta, begun[-1], places) for theta in (fit.theta, *begun)]
        nearest = min(options, key=lambda theta: _misfit(observed.data, replay(theta)))
        again = fit_from(nearest, [n for n in free if n not in lost])
        status = {**again.status, **dict.fromkeys((*lost, *held), "not-identified")}
        reason = {**again.reason, **{n: fit.reason[n] for n in (*lost, *held)}}
        kept = [w for w in fit.warnings if any(w.startswith(f"{n} not identified") for n in lost)]
        fit = replace(
            again,
            status=status,
            reason=reason,
            warnings=kept + again.warnings,
            n_simulations=fit.n_simulations + again.n_simulations,
        )
    return ReplayFit(fit, layout, replay, (*lost, *held))


def _kinked_delays(model: ReplayModel, layout: Layout, fit: OutputErrorFit) -> list[int]:
    """Find the controls' delays that a descent may have crossed zero by to and fro: of surfaces that jump, shorter than a run."""
    if fit.converged or not model.jumping:
        return []
    return [
        k
        for k, name in enumerate(layout.names)
        if name.startswith("delay/")
        and name.endswith(f"/{CONTROL_DELAY}")
        and abs(fit.theta[k]) < SHORT_STEP_S
    ]


def _misfit(data: Sequence[FloatArray], flown: Sequence[FloatArray]) -> float:
    """Minus twice the log likelihood of data [(n, m)], but for a constant, each channel's noise what is left of it; infinite where
    replays fail."""
    left = np.concatenate(data) - np.concatenate(flown)
    measured = np.isfinite(np.concatenate(data))
    if not np.isfinite(left[measured]).all():
        return float("inf")
    return float(
        sum(
            known.sum() * np.log(np.mean(part[known] ** 2))
            for part, known in zip(left.T, measured.T, strict=True)
        )
    )


def _with(values: FloatArray, fixed: FloatArray, places: Sequence[int]) -> FloatArray:
    """(k,) values, those of some places as in ``fixed``."""
    out = np.array(values, dtype=float)
    out[list(places)] = np.asarray(fixed)[list(places)]
    return out


def jumping_in(
    model: ReplayModel, cut: Sequence[Segment], late: Mapping[str, Sequence[str]]
) -> list[str]:
    """Flights in which some control jumps with its command and no sensor is late: in them a row says what it has seen of that."""
    flights = dict.fromkeys(s.flight for s in cut) if model.jumping else {}
    return [f for f in flights if not set(late.get(f, ())) - {CONTROL_DELAY}]


def _first_that_flies(
    fit_from: Callable[[FloatArray], OutputErrorFit], tries: Sequence[FloatArray]
) -> OutputErrorFit:
    """The fit from the first of some values at which the segments can be flown."""
    failure: ValueError | None = None
    for theta in tries:
        try:
            return fit_from(theta)
        except ValueError as error:
            failure = error
            if "fails at theta0" not in str(error):
                raise BadInputError(str(error)) from None
    raise BadInputError(
        f"the model cannot fly these segments: {failure}; give other start values (--start)"
    )
