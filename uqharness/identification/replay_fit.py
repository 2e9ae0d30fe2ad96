"""Output error on replays: the one fit by which models are identified, compared and refined.

With the parameters it estimates the nuisance parameters of the flights: start states of the
segments, biases of the gyros, and delays, above all those of the controls. The noise of each
channel is its residual. The module also computes equation-error start values and residual
coefficients at measured states.
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
    SegmentStates,
    Speed,
    altitudes,
    force_all,
    nuisance_layout,
    sampling_errors,
    states,
    surface_positions,
)
from uqharness.requests.fields import CHANNELS
from uqharness.text_tables import TabularResult

if TYPE_CHECKING:
    import pandas as pd

MAX_ITERATIONS = 40
TOLERANCE = 0.05
"""Length of a step in standard errors below which the search ends."""


@dataclass(frozen=True)
class Observed:
    """What replays are compared with.

    Attributes
    ----------
    segments : sequence of Segment
        The segments.
    outputs : tuple of str
        Fitted channels.
    data : sequence of ndarray
        (n, m) of the outputs, one per segment; NaN where nothing was logged.
    biases : sequence of str
        Channels with a constant bias in each flight.
    late : Mapping
        Flight to the sensors, or CONTROL_DELAY, whose delay is estimated.
    late_s : Mapping
        Channel to a known further delay [s].
    properties : Mapping
        Properties set in all replays.
    fixed : Mapping
        Parameters that are not estimated, with reasons.
    begin : Mapping
        Start values of biases, delays and shares by their names in the layout; 0 by default.
    """

    segments: Sequence[Segment]
    outputs: tuple[str, ...]
    data: Sequence[FloatArray]
    biases: Sequence[str]
    late: Mapping[str, Sequence[str]]
    late_s: Mapping[str, float] = field(default_factory=dict)
    properties: Mapping[str, float] = field(default_factory=dict)
    fixed: Mapping[str, str] = field(default_factory=dict)
    begin: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ReplayFit:
    """Result of output error.

    Attributes
    ----------
    fit : OutputErrorFit
        Its theta follows the layout.
    layout : Layout
        Names and bounds of theta.
    replay : Replay
        The simulation.
    undetermined : tuple of str
        Parameters that the flights do not determine, fixed at their start values.
    """

    fit: OutputErrorFit
    layout: Layout
    replay: Replay
    undetermined: tuple[str, ...]

    def values(self) -> dict[str, float]:
        """Return all estimates by name."""
        return dict(zip(self.layout.names, self.fit.theta.tolist(), strict=True))

    def starts(self) -> list[FloatArray]:
        """Return the start state (9,) of every segment."""
        return [start for start, *_ in self.replay.starts_at(self.fit.theta)]


def fit_replays(
    model: ReplayModel,
    observed: Observed,
    names: Sequence[str],
    tries: Sequence[FloatArray],
    limits: Sequence[tuple[float, float]],
    pool: Callable[..., Any],
    *,
    errors: bool = True,
    callback: Callable[[int, float], None] | None = None,
) -> ReplayFit:
    """Fit properties of a model and all nuisance parameters.

    Parameters
    ----------
    model : ReplayModel
        The aircraft.
    observed : Observed
        What is fitted.
    names : sequence of str
        Properties to estimate.
    tries : sequence of ndarray
        (k,) start values; the first that can be flown is used. Fixed and undetermined parameters
        keep the last.
    limits : sequence
        Bounds of the parameters.
    pool : callable
        A `map` as `replay_pool` or `batched_pool` returns it.
    errors : bool
        False for estimates without standard errors.
    callback : callable, optional
        Called with the number of each iteration and the length of its step in standard errors.

    Returns
    -------
    ReplayFit
        The estimates.

    Raises
    ------
    BadInputError
        When the model cannot fly the segments.
    """
    jumping = jumping_flights(model, observed.segments, observed.late)
    # theta: the parameters, then biases, delays, shares and start states.
    layout = nuisance_layout(
        names,
        limits,
        observed.segments,
        observed.biases,
        observed.outputs,
        late=observed.late,
        jumping=jumping,
    )
    replay = Replay(
        model,
        observed.segments,
        layout.names,
        observed.outputs,
        uuid.uuid4().hex,
        base=observed.properties,
        late_s=observed.late_s,
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
            map=pool,
            tolerance=TOLERANCE,
            max_iterations=MAX_ITERATIONS,
            differences="secant",
            errors=errors,
            callback=callback,
        )

    def fit_from(theta: FloatArray, free: Sequence[str]) -> OutputErrorFit:
        fit = fit_within(layout.bounds, theta, free)
        kinked = _kinked_delays(model, layout, fit)
        # Where a surface jumps, the rates as functions of the delay have a kink at zero. A descent
        # that crosses it repeatedly does not converge, so each side is searched separately.
        for side in (0.0, -np.inf) if kinked else ():
            places = [k for k in kinked if side == 0.0 or fit.theta[k] == 0.0]
            if not places:
                break
            bounds = list(layout.bounds)
            for k in kinked:
                low, high = layout.bounds[k]
                bounds[k] = (0.0, high) if fit.theta[k] > 0.0 or side == 0.0 else (low, 0.0)
            begin = _with_values(fit.theta, np.zeros(len(fit.theta)), places)
            one_sided = fit_within(bounds, begin, free)
            fit = replace(one_sided, n_simulations=fit.n_simulations + one_sided.n_simulations)
        return fit

    # Start vectors: fixed parameters take the last of the tries, nuisance parameters their start.
    fixed = observed.fixed
    tries = [
        _with_values(values, tries[-1], [list(names).index(n) for n in fixed]) for values in tries
    ]
    free = [n for n in layout.names if n not in fixed]
    nuisance = np.array([observed.begin.get(n, 0.0) for n in layout.names[len(names) :]])
    starts = [np.concatenate([values, nuisance]) for values in tries]
    fit = _fit_first_flyable(lambda theta: fit_from(theta, free), starts)
    fit = replace(
        fit,
        status={**fit.status, **dict.fromkeys(fixed, "not-identified")},
        reason={**fit.reason, **fixed},
    )
    # Parameters that the information matrix cannot resolve.
    undetermined = tuple(n for n in names if fit.status[n] == "not-identified" and n not in fixed)
    if undetermined:
        # Undetermined parameters return to their start values, with which the model will be flown,
        # and the others are estimated again. Estimates that belong to a value at a bound may fit
        # worse than the start values, so the best of all candidates is the new start.
        places = [layout.names.index(n) for n in undetermined]
        options = [_with_values(theta, starts[-1], places) for theta in (fit.theta, *starts)]
        nearest = min(options, key=lambda theta: _neg2_log_likelihood(observed.data, replay(theta)))
        refit = fit_from(nearest, [n for n in free if n not in undetermined])
        status = {**refit.status, **dict.fromkeys((*undetermined, *fixed), "not-identified")}
        reason = {**refit.reason, **{n: fit.reason[n] for n in (*undetermined, *fixed)}}
        warnings = [
            w
            for w in fit.warnings
            if any(w.startswith(f"{n} not identified") for n in undetermined)
        ]
        fit = replace(
            refit,
            status=status,
            reason=reason,
            warnings=warnings + refit.warnings,
            n_simulations=fit.n_simulations + refit.n_simulations,
        )
    return ReplayFit(fit, layout, replay, (*undetermined, *fixed))


def _kinked_delays(model: ReplayModel, layout: Layout, fit: OutputErrorFit) -> list[int]:
    """Find control delays near zero of a fit that did not converge, where surfaces jump."""
    # Only surfaces without a lag make a kink.
    if fit.converged or not model.jumping:
        return []
    return [
        k
        for k, name in enumerate(layout.names)
        if name.startswith("delay/")
        and name.endswith(f"/{CONTROL_DELAY}")
        and abs(fit.theta[k]) < SHORT_STEP_S
    ]


def _neg2_log_likelihood(data: Sequence[FloatArray], outputs: Sequence[FloatArray]) -> float:
    """Return -2 log L of data (n, m) up to a constant, each channel's noise its own residual.

    Infinite where replays fail.
    """
    residual = np.concatenate(data) - np.concatenate(outputs)
    measured = np.isfinite(np.concatenate(data))
    if not np.isfinite(residual[measured]).all():
        return float("inf")
    return float(
        sum(
            logged.sum() * np.log(np.mean(part[logged] ** 2))
            for part, logged in zip(residual.T, measured.T, strict=True)
        )
    )


def _with_values(values: FloatArray, fixed: FloatArray, places: Sequence[int]) -> FloatArray:
    """Return values (k,) with those at some places replaced."""
    out = np.array(values, dtype=float)
    out[list(places)] = np.asarray(fixed)[list(places)]
    return out


def jumping_flights(
    model: ReplayModel, segments: Sequence[Segment], late: Mapping[str, Sequence[str]]
) -> list[str]:
    """Return the flights in which a control jumps with its command and no sensor is late.

    Only in these does a row determine which share of a jump its accelerometers have seen.
    """
    flights = dict.fromkeys(s.flight for s in segments) if model.jumping else {}
    return [f for f in flights if not set(late.get(f, ())) - {CONTROL_DELAY}]


def _fit_first_flyable(
    fit_from: Callable[[FloatArray], OutputErrorFit], tries: Sequence[FloatArray]
) -> OutputErrorFit:
    """Fit from the first start values with which the segments can be flown.

    Raises BadInputError where there are none.
    """
    failure: ValueError | None = None
    for theta in tries:
        try:
            return fit_from(theta)
        except ValueError as error:
            # Any other error would occur with all start values.
            failure = error
            if "fails at theta0" not in str(error):
                raise BadInputError(str(error)) from None
    raise BadInputError(
        f"the model cannot fly these segments: {failure}; use other start values (--start)"
    )


# Start values by equation error: the model evaluated at the measured states.


def equation_error_start(
    model: ReplayModel,
    direct_model: ReplayModel,
    flights: Sequence[Flight],
    segments: Sequence[Segment],
    names: Sequence[str],
    initial: FloatArray,
    *,
    limits: Sequence[tuple[float, float]],
) -> tuple[FloatArray, list[str]]:
    """Find the parameters (k,) at which the model's coefficients at the measured states fit the
    flights.

    Only parameters that are named as coefficient terms move; those, and parameters that the flights
    cannot separate, keep their values. Returns them with notes.
    """
    theta = initial.copy()
    groups: dict[str, list[int]] = {}
    terms: dict[int, str] = {}
    for i, name in enumerate(names):
        parsed = split_name(name)
        if parsed is not None:
            coefficient, terms[i] = parsed
            groups.setdefault(coefficient, []).append(i)
    if not groups:
        return theta, [
            "equation error was skipped: no parameter has the name of a coefficient term"
        ]
    notes: list[str] = []
    demand, predicted, base = [], [], []
    channels_of = [states(flight, piece) for flight in flights for piece in flight.pieces]
    forced_models = forced_at(
        model, direct_model, segments, channels_of, dict(zip(names, initial, strict=True))
    )
    # Demanded and predicted coefficients pass the same filter, and so do the regressors.
    for segment, channels, forced in zip(segments, channels_of, forced_models, strict=True):
        demand.append(demanded_coefficients(channels, forced[0], segment))
        predicted.append(smooth(forced[0].coefficients, segment.dt_s))
        base.append({k: smooth(v, segment.dt_s) for k, v in forced[1].items()})
    # Linear least squares, one coefficient at a time: demanded minus predicted on the term
    # regressors.
    order = ("CX", "CY", "CZ", "Cl", "Cm", "Cn")
    for coefficient, members in groups.items():
        column = order.index(coefficient)
        y = np.concatenate(
            [d[:, column] - s[:, column] for d, s in zip(demand, predicted, strict=True)]
        )
        x = np.column_stack(
            [np.concatenate([regressor(terms[i], b) for b in base]) for i in members]
        )
        # Parameters that the data cannot separate are left at their values.
        gate = assess(x.T @ x, tuple(names[i] for i in members))
        identified = [i for i, ok in zip(members, gate.identified, strict=True) if ok]
        delta = np.linalg.lstsq(x[:, gate.identified], y, rcond=None)[0]
        for i, d in zip(identified, delta, strict=True):
            low, high = limits[i]
            # Slightly inside, so that output error does not start on a bound.
            margin = 1e-6 * (high - low) if np.isfinite(high - low) else 0.0
            theta[i] = float(np.clip(initial[i] + d, low + margin, high - margin))
    return theta, notes


def forced_at(
    model: ReplayModel,
    direct_model: ReplayModel,
    segments: Sequence[Segment],
    channels_of: Sequence[Mapping[str, FloatArray]],
    properties: Mapping[str, float],
) -> list[tuple[ForcedModel, dict[str, FloatArray]]]:
    """Evaluate the model at the measured channels of each segment, and the variables of its
    coefficient terms.
    """
    positions = surface_positions(model, segments, CONTROLS, properties)
    parts = [
        SegmentStates(segment, channels, controls, altitudes(model, segment, channels["h_m"]))
        for segment, channels, controls in zip(segments, channels_of, positions, strict=True)
    ]
    out = []
    for part, forced in zip(parts, force_all(direct_model, parts, properties), strict=True):
        # Variables of the terms: surface positions and motion, made dimensionless by the mass's
        # lengths.
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
    direct_model: ReplayModel,
    segments: Sequence[Segment],
    channels_of: Sequence[Mapping[str, FloatArray]],
    noise_std: Mapping[str, float],
    rng: np.random.Generator,
    *,
    properties: Mapping[str, float] | None = None,
    late_s: float = 0.0,
    half_way: bool = False,
) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Compare demanded and predicted coefficients of each segment.

    Parameters
    ----------
    model, direct_model : ReplayModel
        With actuators, and with controls passed through.
    segments : sequence of Segment
        The segments.
    channels_of : sequence of Mapping
        Measured channels of each.
    noise_std : Mapping
        Standard deviation of each channel's noise.
    rng : Generator
        Draws a second realisation of the noise.
    properties : Mapping, optional
        Properties in force.
    late_s : float
        Delay of the controls [s].
    half_way : bool
        Whether commands are half-way at the row of a jump, which compensates for sampling.

    Returns
    -------
    list of tuple
        (n, 6) each: demanded coefficients; predicted ones including sampling errors; change of
        demanded minus predicted by the second noise.
    """
    # A second realisation of the noise shows its effect on the coefficients.
    noisy = [with_noise(channels, noise_std, rng) for channels in channels_of]
    plain_and_noisy = [*zip(segments, channels_of, strict=True), *zip(segments, noisy, strict=True)]
    forced = forced_at(
        model,
        direct_model,
        [s for s, _ in plain_and_noisy],
        [c for _, c in plain_and_noisy],
        properties or {},
    )
    coefficients = [
        (
            demanded_coefficients(channels, model_at, segment),
            smooth(model_at.coefficients, segment.dt_s),
        )
        for (segment, channels), (model_at, _) in zip(plain_and_noisy, forced, strict=True)
    ]
    positions = surface_positions(model, segments, CONTROLS, properties or {})
    parts = [
        MeasuredSegment(
            segment, channels, controls, altitudes(model, segment, channels["h_m"]), late_s
        )
        for segment, channels, controls in zip(segments, channels_of, positions, strict=True)
    ]
    # Half-way commands are the first-order correction of sampling.
    if half_way:
        sampled = [np.zeros((len(part.positions), 6)) for part in parts]
    else:
        sampled = sampling_errors(model, direct_model, parts, properties or {})
    # The first half belongs to the measured states, the second half to the noisy ones.
    pairs = zip(coefficients[: len(segments)], coefficients[len(segments) :], sampled, strict=True)
    return [
        (demand, predicted + error, (noisy_demand - noisy_predicted) - (demand - predicted))
        for (demand, predicted), (noisy_demand, noisy_predicted), error in pairs
    ]


def demanded_coefficients(
    channels: Mapping[str, FloatArray], forced: ForcedModel, segment: Segment
) -> FloatArray:
    """Return the coefficients (n, 6) that the flight demanded in a piece."""
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


# Fitted channels.

OUTPUTS = tuple(CHANNELS.values())
BIASES = ("p_radps", "q_radps", "r_radps")
"""Channels whose sensors have a constant bias in each flight."""


# Result of an identification.


@dataclass(frozen=True)
class Identification(TabularResult):
    """Estimated parameters, their uncertainty, and the fit to the flights.

    Attributes
    ----------
    aircraft : str
        Name of the model.
    names, initial, theta, std, std_crb, status, reason
        (k,) over the requested parameters (JSBSim properties): start values, estimates, standard
        errors corrected for coloured residuals, Cramer-Rao bounds, "identified" or
        "not-identified", and why not.
    cov : ndarray
        (k, k) of the identified ones, ordered as ``identified``.
    nuisance : Mapping
        Biases, delays and start states by name: (value, std).
    outputs : tuple of str
        Fitted channels.
    segments, measured, modelled, residual
        One per segment, (n, m) arrays; modelled includes biases, residual is measured minus
        modelled, the innovations for filter error.
    whiteness : ndarray
        (m,) p-values of the test for white residuals.
    noise : Mapping
        Standard deviation by channel, in its unit.
    method : str
        "output error" or "filter error".
    converged : bool
        Whether the search ended by its tolerance.
    warnings, notes : tuple of str
        Sentences for the user.
    simulations, seconds, speed
        Replays of all segments, wall time [s], and speed of the replays.
    innovation_std : Mapping
        Of filter error, standard deviation that the filter predicts for the innovations by channel,
        in its unit: sensor noise and what gusts do within one sample. Empty for output error, and
        where the estimated gusts are stronger than turbulence can be.
    labels : Mapping
        Of an ordinary flight, parameter to where its value comes from: "data", "prior and data",
        "prior only" or "start value".
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
    innovation_std: Mapping[str, float] = field(default_factory=dict)
    labels: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        return (
            f"Identification({self.aircraft!r}, {len(self.identified)} of {len(self.names)}"
            f" identified by {self.method})"
        )

    def _facts(self) -> Mapping[str, object]:
        return {"method": self.method, "converged": "yes" if self.converged else "no"}

    @property
    def identified(self) -> tuple[str, ...]:
        """Return the names of the parameters that the data determine."""
        return tuple(n for n in self.names if self.status[n] == "identified")

    def to_dataframe(self) -> pd.DataFrame:
        """Return the table of parameters: start value, estimate, standard error, Cramer-Rao bound,
        status.
        """
        import pandas as pd

        columns = {
            "initial": self.initial,
            "estimate": self.theta,
            "std": self.std,
            "std_crb": self.std_crb,
        }
        verdict_columns = {
            "status": [self.status[n] for n in self.names],
            "reason": [self.reason[n] for n in self.names],
        }
        return pd.DataFrame(
            {**columns, **verdict_columns}, index=pd.Index(self.names, name="parameter")
        )


def by_channel(sentences: Sequence[str], outputs: Sequence[str]) -> list[str]:
    """Replace output numbers in sentences by channel names.

    >>> by_channel(["output 1 is coloured"], ("p_radps", "q_radps"))
    ['q_radps is coloured']
    """
    return [
        re.sub(r"\boutput (\d+)", lambda match: outputs[int(match[1])], text) for text in sentences
    ]
