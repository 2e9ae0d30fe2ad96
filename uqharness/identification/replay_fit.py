"""The one fit of a model to flights: output error on replays, by which models are identified, compared and refined.

Beside the parameters it estimates what no model knows: start states of the segments, biases of the gyros, delays, of the
controls above all. The noise of the channels is what the fit leaves of them.
"""

from __future__ import annotations

import re
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.aerodynamics import demanded, regressor, smooth, split_name, variables
from sysid.arrays import FloatArray
from sysid.estimation import OutputErrorFit, assess
from sysid.estimation.output_error import output_error
from sysid.model_form import with_noise
from uqharness.errors import BadInputError
from uqharness.replay import (
    CONTROL_DELAY,
    CONTROLS,
    SHORT_STEP_S,
    Flight,
    ForcedModel,
    Layout,
    MeasuredSegment,
    Replay,
    ReplayModel,
    Segment,
    Speed,
    StatesOf,
    altitudes,
    force_all,
    nuisance_layout,
    sampling_errors,
    states,
    surface_positions,
)
from uqharness.text_tables import Tabled

if TYPE_CHECKING:
    import pandas as pd

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


# Where output error starts: equation error at the measured states, with the model forced to
# them.


def equation_error_start(
    model: ReplayModel,
    straight: ReplayModel,
    flights: Sequence[Flight],
    cut: Sequence[Segment],
    names: Sequence[str],
    initial: FloatArray,
    limits: Sequence[tuple[float, float]],
) -> tuple[FloatArray, list[str]]:
    """Parameters (k,) at which the model's forces at the measured states come nearest to those the flight demanded.

    Only parameters that are coefficient terms by name move; the others, and those that the flights do not tell apart, stay.
    """
    theta = initial.copy()
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        parsed = split_name(name)
        if parsed is not None:
            groups.setdefault(parsed[0], []).append(i)
    if not groups:
        return theta, ["equation error was left out: no parameter is a coefficient term by name"]
    notes: list[str] = []
    demand, said, base = [], [], []
    every = [states(flight, piece) for flight in flights for piece in flight.pieces]
    found = forced_at(model, straight, cut, every, dict(zip(names, initial, strict=True)))
    for segment, channels, forced in zip(cut, every, found, strict=True):
        demand.append(demand_of(channels, forced[0], segment))
        said.append(smooth(forced[0].coefficients, segment.dt_s))
        base.append({k: smooth(v, segment.dt_s) for k, v in forced[1].items()})
    order = ("CX", "CY", "CZ", "Cl", "Cm", "Cn")
    for coefficient, members in groups.items():
        column = order.index(coefficient)
        y = np.concatenate([d[:, column] - s[:, column] for d, s in zip(demand, said, strict=True)])
        x = np.column_stack(
            [np.concatenate([regressor(split_name(names[i])[1], b) for b in base]) for i in members]  # type: ignore[index]
        )
        gate = assess(x.T @ x, tuple(names[i] for i in members))
        moved = [i for i, ok in zip(members, gate.identified, strict=True) if ok]
        delta = np.linalg.lstsq(x[:, gate.identified], y, rcond=None)[0]
        for i, d in zip(moved, delta, strict=True):
            low, high = limits[i]
            # A hair inside, so that output error does not start on a bound.
            margin = 1e-6 * (high - low) if np.isfinite(high - low) else 0.0
            theta[i] = float(np.clip(initial[i] + d, low + margin, high - margin))
    return theta, notes


def forced_at(
    model: ReplayModel,
    straight: ReplayModel,
    cut: Sequence[Segment],
    every: Sequence[Mapping[str, FloatArray]],
    properties: Mapping[str, float],
) -> list[tuple[ForcedModel, dict[str, FloatArray]]]:
    """Of each segment the model forced to its measured channels, and the variables of its coefficient terms there."""
    stood = surface_positions(model, cut, CONTROLS, properties)
    parts = [
        StatesOf(segment, channels, controls, altitudes(model, segment, channels["h_m"]))
        for segment, channels, controls in zip(cut, every, stood, strict=True)
    ]
    out = []
    for part, forced in zip(parts, force_all(straight, parts, properties), strict=True):
        de, da, dr = (
            part.controls[:, model.controls.index(c)] for c in ("elevator", "aileron", "rudder")
        )
        V, alpha, beta, p, q, r = (
            part.states[c]
            for c in ("V_mps", "alpha_rad", "beta_rad", "p_radps", "q_radps", "r_radps")
        )
        out.append(
            (
                forced,
                variables(V, alpha, beta, p, q, r, de, da, dr, b=forced.mass.b, c=forced.mass.c),
            )
        )
    return out


def coefficient_gaps(
    model: ReplayModel,
    straight: ReplayModel,
    cut: Sequence[Segment],
    every: Sequence[Mapping[str, FloatArray]],
    noise_std: Mapping[str, float],
    rng: np.random.Generator,
    properties: Mapping[str, float] | None = None,
    late_s: float = 0.0,
    half_way: bool = False,
) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Of each segment, (n, 6) each: coefficients demanded, those said at the measured states with what sampling makes of them, and
    how noise added once more changes the first less the second. late_s: by how much the controls act late; half_way: commands
    stand half-way at the row of a jump, which makes up for sampling."""
    noisy = [with_noise(channels, noise_std, rng) for channels in every]
    given = [*zip(cut, every, strict=True), *zip(cut, noisy, strict=True)]
    forced = forced_at(
        model, straight, [s for s, _ in given], [c for _, c in given], properties or {}
    )
    found = [
        (demand_of(channels, said, segment), smooth(said.coefficients, segment.dt_s))
        for (segment, channels), (said, _) in zip(given, forced, strict=True)
    ]
    stood = surface_positions(model, cut, CONTROLS, properties or {})
    parts = [
        MeasuredSegment(
            segment, channels, controls, altitudes(model, segment, channels["h_m"]), late_s
        )
        for segment, channels, controls in zip(cut, every, stood, strict=True)
    ]
    if half_way:
        sampled = [np.zeros((len(part.positions), 6)) for part in parts]
    else:
        sampled = sampling_errors(model, straight, parts, properties or {})
    both = zip(found[: len(cut)], found[len(cut) :], sampled, strict=True)
    return [
        (demand, said + error, (demand_again - said_again) - (demand - said))
        for (demand, said), (demand_again, said_again), error in both
    ]


def demand_of(
    channels: Mapping[str, FloatArray], forced: ForcedModel, segment: Segment
) -> FloatArray:
    """(n, 6) coefficients that the flight demanded in a piece."""
    return demanded(
        np.column_stack([channels[f"a{a}_mps2"] for a in "xyz"]),
        np.column_stack([channels[f"{a}_radps"] for a in "pqr"]),
        forced.qbar,
        forced.mass,
        forced.other_force,
        forced.other_moment,
        dt_s=segment.dt_s,
        arm_m=np.array(segment.arm_m),
    )


# Channels that identification compares, and their names as options give them.

OUTPUTS = (
    "V_mps",
    "alpha_rad",
    "beta_rad",
    "phi_rad",
    "theta_rad",
    "p_radps",
    "q_radps",
    "r_radps",
    "ax_mps2",
    "ay_mps2",
    "az_mps2",
)
"""Channels that are compared. Height and heading follow from the others and drift in real sensors."""
BIASES = ("p_radps", "q_radps", "r_radps")
"""Channels whose sensors have a constant bias in each flight."""


def parse_channels(option: str, text: str | None) -> tuple[str, ...] | None:
    """Channel names of an option; short forms p, alpha, ax stand for p_radps, alpha_rad, ax_mps2; None where it was not given.

    Raises BadInputError.
    """
    from uqharness.replay import CONTROL_DELAY

    if text is None:
        return None
    if text in ("none", ""):
        return ()
    short = {c.split("_")[0]: c for c in OUTPUTS}
    names = [short.get(n.strip(), n.strip()) for n in text.split(",")]
    further = (CONTROL_DELAY,) if option == "--delays" else ()
    unknown = [n for n in names if n not in (*OUTPUTS, *further)]
    if unknown:
        raise BadInputError(
            f"{option} {text}: unknown channel {unknown[0]}; allowed are none, {', '.join((*further, *short))}"
        )
    return tuple(dict.fromkeys(names))


# What an identification found.


@dataclass(frozen=True)
class Identification(Tabled):
    """What was estimated, how, and how well it fits.

    names, initial, theta, std, std_crb, status, reason  over the parameters asked for (JSBSim properties)
    cov (k, k)        of the identified ones, in the order of ``identified``
    nuisance          biases and start states: name -> (value, std)
    outputs, measured, modelled  channels and their [(n, m)] arrays, one a segment; modelled includes biases
    residual          measured minus model of the method used (innovations for filter error), one a segment
    method            "output error" | "filter error"; simulations: replays of all segments, seconds: wall time they took
    """

    aircraft: str
    names: tuple[str, ...]
    initial: FloatArray
    theta: FloatArray
    std: FloatArray
    std_crb: FloatArray
    status: Mapping[str, str]
    reason: Mapping[str, str]
    cov: FloatArray
    nuisance: Mapping[str, tuple[float, float]]
    outputs: tuple[str, ...]
    segments: tuple[Segment, ...]
    measured: list[FloatArray]
    modelled: list[FloatArray]
    residual: list[FloatArray]
    whiteness: FloatArray
    noise: Mapping[str, float]
    method: str
    converged: bool
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    simulations: int
    seconds: float
    speed: Speed | None = None

    def __repr__(self) -> str:
        return f"Identification({self.aircraft!r}, {len(self.identified)} of {len(self.names)} identified by {self.method})"

    def _facts(self) -> Mapping[str, object]:
        return {"method": self.method, "converged": "yes" if self.converged else "no"}

    @property
    def identified(self) -> tuple[str, ...]:
        """Names of the parameters that the data determined."""
        return tuple(n for n in self.names if self.status[n] == "identified")

    def to_dataframe(self) -> pd.DataFrame:
        """The table of parameters: one row a property, with what it began at, estimate, standard error, bound and status."""
        import pandas as pd

        columns = {
            "initial": self.initial,
            "estimate": self.theta,
            "std": self.std,
            "std_crb": self.std_crb,
        }
        told = {
            "status": [self.status[n] for n in self.names],
            "reason": [self.reason[n] for n in self.names],
        }
        return pd.DataFrame({**columns, **told}, index=pd.Index(self.names, name="parameter"))


def by_channel(sentences: Sequence[str], outputs: Sequence[str]) -> list[str]:
    """Sentences that speak of outputs by number, by the channels' names."""
    return [
        re.sub(r"\boutput (\d+)", lambda found: outputs[int(found[1])], text) for text in sentences
    ]
