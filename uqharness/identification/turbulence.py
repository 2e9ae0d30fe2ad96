"""Identification in turbulence by filter error.

One-step predictions of the JSBSim model, linearised along the flights, replace replays. Intensities
of the gusts and noise of the sensors are estimated with the parameters, as in `refine`. The fit
starts from the result of output error.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.arrays import FloatArray
from sysid.effects import (
    CERTAIN_T,
    TurbulenceModel,
    corrected_estimates,
    filter_segments,
    gust_strength_mps2,
)
from sysid.estimation import assess, at_bound, colour, colour_warnings, idle_bound, rms
from sysid.parallel import Processes
from uqharness.errors import BadInputError
from uqharness.identification.linearised.flight_data import (
    FlightData,
    ModelState,
    StagedModels,
    make_flight_data,
    with_card_noise,
    with_estimator_noise,
)
from uqharness.identification.linearised.prediction_error import (
    TurbulentFit,
    aligned_outputs,
    delay_rows,
    gust_refit,
    shift_rows,
)
from uqharness.identification.linearised.replay_fit import point_of
from uqharness.identification.replay_fit import Identification, ReplayFit, by_channel
from uqharness.replay import CONTROL_DELAY, Flight, delayed, shifted_command_warnings
from uqharness.simulator import Aircraft

CONVERGED, ITERATIONS = 2.0, 16
"""Length of the last step, in standard errors of all parameters together, below which the
estimation has converged, and largest number of iterations. The last step is taken too; it may stay
this long where a sensor's delay is near zero, because slopes differ on either side."""
SEVERE_GUSTS_MPS2 = 1.0
"""Strength sigma^2 / L of gusts above which no air is meant: severe turbulence of MIL-F-8785C has
0.5 m/s2 at a height of 10 m (sigma 2.3 m/s, L 10 m), and less above."""
NO_TURBULENCE = (
    "filter error finds no air motion across the flight path, so there is no turbulence: these are"
    " the estimates of output error"
)


@dataclass(frozen=True)
class FilterRequest:
    """Options of filter error.

    Attributes
    ----------
    outputs, delays : sequence of str, optional
        Fitted channels, and channels with a delay; None for the defaults.
    biases : sequence of str
        Channels with a constant bias.
    measured : sequence of str
        Surfaces whose positions the record has.
    ideal : sequence of str
        Controls that are passed through.
    """

    outputs: Sequence[str] | None
    biases: Sequence[str]
    delays: Sequence[str] | None
    measured: Sequence[str]
    ideal: Sequence[str]


def filter_data(
    aircraft: Aircraft, flights: Sequence[Flight], request: FilterRequest, result: Identification
) -> FlightData:
    """Prepare the flights for filter error: as `refine` does, but with the delays of output error.

    ``result`` is that of output error; its residuals bound the uncertainty of channels that an
    estimator computed.
    """
    data = make_flight_data(aircraft, flights, request.measured, request.ideal)
    # Keep the requested channels only.
    if request.outputs is not None:
        columns = [k for k, c in enumerate(data.outputs) if c in request.outputs]
        outputs = tuple(data.outputs[k] for k in columns)
        data = replace(
            data,
            outputs=outputs,
            measured=tuple(z[:, columns] for z in data.measured),
            noise=data.noise[columns],
        )
    # By default the sensors of a log are late relative to its gyros, and so are its controls: the
    # instant at which commands act is determined much better than a delay common to all sensors.
    late = delayed(flights, data.outputs, request.delays)
    timed = tuple(f for f, names in late.items() if CONTROL_DELAY in names)
    sensors = {f: [n for n in names if n != CONTROL_DELAY] for f, names in late.items()}
    data = replace(
        data, timed=timed, delayed_sensors={f: names for f, names in sensors.items() if names}
    )
    data = with_card_noise(
        aircraft, replace(data, biased=tuple(b for b in request.biases if b in data.outputs))
    )
    # Residuals of output error limit the noise of channels that were estimated on board.
    residual_rms = {
        c: rms(r) for c, r in zip(result.outputs, np.concatenate(result.residual).T, strict=True)
    }
    return replace(data, noise=with_estimator_noise(data, residual_rms))


def identify_in_turbulence(
    result: Identification,
    fitted: ReplayFit,
    models: StagedModels,
    data: FlightData,
    limits: Sequence[tuple[float, float]],
    fixed: Mapping[str, str],
    *,
    pool: Processes,
    callback: Callable[[int, float], None] | None = None,
) -> Identification:
    """Replace output error's result by that of filter error, with a note.

    Parameters
    ----------
    result, fitted
        Result and fit of output error, the start.
    models : StagedModels
    data : FlightData
        Flights as `filter_data` prepares them.
    limits : sequence
        Bounds of the parameters.
    fixed : Mapping
        Parameters that stay, with reasons.
    pool : callable
        Parallel `map`.
    callback : callable, optional
        Called with the number of each iteration and the length of its step in standard errors.

    Returns
    -------
    Identification
        That of output error where no transverse air motion is found.

    Raises
    ------
    BadInputError
        Where no filter follows the flights.
    """
    start_s = time.perf_counter()
    free = [n for n in result.names if n not in fixed]
    bounds = dict(zip(result.names, limits, strict=True))

    initial = dict(zip(result.names, result.initial.tolist(), strict=True))

    def fit_from(
        data: FlightData, point: ModelState, turbulence: TurbulenceModel | None = None
    ) -> TurbulentFit:
        try:
            return gust_refit(
                models,
                data,
                point,
                free,
                bounds,
                pool,
                turbulence=turbulence,
                iterations=ITERATIONS,
                tune=True,
                initial={n: initial[n] for n in free},
                callback=callback,
            )
        except np.linalg.LinAlgError as error:
            raise BadInputError(
                f"filter error: no filter follows these flights ({error}); use --method"
                " output-error"
            ) from None

    # Start at the estimates of output error, or at the model's values.
    fit = fit_from(data, point_of(fitted, data, result.names))
    if not fit.turbulence.is_turbulent:
        return replace(result, notes=(*result.notes, NO_TURBULENCE))
    values, cov, crb, reason = _estimates(fit, free, bounds)
    if undetermined := {n: text for n, text in reason.items() if text}:
        # Undetermined parameters return to their start values, and the others are estimated again.
        free = [n for n in free if n not in undetermined]
        point = replace(
            fit.fit.trajectory.point,
            values={**fit.fit.trajectory.point.values, **{n: initial[n] for n in undetermined}},
        )
        fit = fit_from(fit.data, point, fit.turbulence)
        values, cov, crb, reason = _estimates(fit, free, bounds)
    # Assemble the result by the names of the request.
    identified = [n for n in free if not reason[n]]
    where = [free.index(n) for n in identified]
    reason = {**reason, **undetermined, **fixed}
    std, std_crb = (
        _of_names(result.names, identified, np.sqrt(np.diagonal(c)[where])) for c in (cov, crb)
    )
    outputs, modelled = fit.data.outputs, _one_ahead(fit)
    # Innovations: measured minus predicted one sample ahead.
    residual = [z - y for z, y in zip(fit.data.measured, modelled, strict=True)]
    # Standardised innovations must be white if model and noise are right.
    standardised = [np.where(w.is_measured, w.residual, np.nan) for w in fit.fit.information.white]
    residual_colour = colour(standardised)
    warnings = [
        f"{n} not identified: {reason[n]}" for n in result.names if reason[n] and n not in fixed
    ]
    warnings += by_channel(colour_warnings(residual_colour, std, std_crb, "filter error"), outputs)
    warnings += _moment_warnings(fit.turbulence)
    nuisance = _nuisance(fit, cov, len(free))
    warnings = [*shifted_command_warnings(data.flights, data.segments, nuisance), *warnings]
    converged = fit.step_length < CONVERGED
    if not converged:
        warnings.insert(
            0, f"not converged: the last step is {fit.step_length:.2g} standard errors long"
        )
    note = (
        "estimated by filter error, because the residuals of output error showed turbulence"
        f" (twice the log likelihood is {fit.turbulence.gain:.4g} above that of calm air;"
        f" {fit.turbulence.words}); time histories show one-step predictions"
    )
    return replace(
        result,
        theta=np.array(
            [
                values[n] if n in identified else i
                for n, i in zip(result.names, result.initial.tolist(), strict=True)
            ]
        ),
        std=std,
        std_crb=std_crb,
        status={n: "identified" if n in identified else "not-identified" for n in result.names},
        reason={n: reason[n] for n in result.names},
        cov=cov[np.ix_(where, where)],
        nuisance=nuisance,
        outputs=outputs,
        measured=list(fit.data.measured),
        modelled=modelled,
        residual=residual,
        whiteness=residual_colour.p_value,
        noise=dict(zip(outputs, fit.data.noise.tolist(), strict=True)),
        innovation_std=_innovation_std(fit),
        method="filter error",
        converged=converged,
        warnings=tuple(warnings),
        notes=(*result.notes, note),
        seconds=result.seconds + time.perf_counter() - start_s,
    )


def _innovation_std(fit: TurbulentFit) -> dict[str, float]:
    """Return the standard deviation that the filter predicts for the innovations by channel.

    Gusts change an acceleration within one sample by far more than its sensor's noise, so that
    innovations are judged by this and not by the noise. Empty where the gusts of any flight are
    stronger than turbulence can be: a wrong model then takes them for its own error.
    """
    strength = max(gust_strength_mps2(values) for values in fit.turbulence.by_flight.values())
    if strength > SEVERE_GUSTS_MPS2:
        return {}
    square = np.mean([w.deviation**2 for w in fit.fit.information.white], axis=0)
    return dict(zip(fit.data.outputs, np.sqrt(square).tolist(), strict=True))


def _moment_warnings(turbulence: TurbulenceModel) -> list[str]:
    """Return a warning for each axis with moments that the model does not explain.

    The filter treats them as process noise.
    """
    gains = zip(("roll", "pitch", "yaw"), turbulence.moments.tolist(), strict=True)
    return [
        f"moments act about the {axis} axis that the model does not explain: including them raises"
        f" twice the log likelihood by {gain:.0f}. A term is missing, or the turbulence exceeds the"
        " range of its model; refine searches for the term"
        for axis, gain in gains
        if gain > CERTAIN_T**2
    ]


def _of_names(names: Sequence[str], identified: Sequence[str], values: FloatArray) -> FloatArray:
    """Return the values (k,) of the identified parameters, NaN of the others."""
    by_name = dict(zip(identified, values.tolist(), strict=True))
    return np.array([by_name.get(n, np.nan) for n in names])


def _estimates(
    fit: TurbulentFit, free: Sequence[str], bounds: Mapping[str, tuple[float, float]]
) -> tuple[dict[str, float], FloatArray, FloatArray, dict[str, str]]:
    """Return values and reasons of the free parameters, covariance (K, K) and Cramer-Rao bound.

    An empty reason means identified. The covariance includes nuisance parameters in the fit's
    order; the last step is applied.
    """
    information, at = fit.fit.information, fit.fit.trajectory.point.values
    names = list(information.names)
    gate = assess(information.total[0], tuple(names))
    steps = corrected_estimates(information, names, names)
    # Scale the covariance by standard errors corrected for coloured residuals; correlations stay.
    wider = [steps[n][1] / steps[n][2] for n in names]
    values, reason = {}, dict.fromkeys(free, "")
    cov = gate.inverse * np.outer(wider, wider)
    # Reasons in order: collinear, at a bound, a bound wider than the data, no effect.
    for n in free:
        k, (low, high) = names.index(n), bounds[n]
        value = float(at[n] + steps[n][0])
        values[n] = float(np.clip(value, low, high))
        reason[n] = gate.reason[k] or (at_bound(value, low, high) if not low < value < high else "")
        reason[n] = reason[n] or idle_bound(float(np.sqrt(cov[k, k])), high - low)
        if not np.isfinite(cov[k, k]):
            reason[n] = reason[n] or "no effect on any output in these data"
    return values, cov, gate.inverse, reason


def _nuisance(fit: TurbulentFit, cov: FloatArray, first: int) -> dict[str, tuple[float, float]]:
    """Return biases, delays and shares with standard errors, by output error's names, from column
    ``first`` on.
    """
    names, point = list(fit.fit.information.names), fit.fit.trajectory.point
    # The last step is taken, as for the parameters.
    step, std = fit.fit.information.step()[0], np.sqrt(np.diagonal(cov))
    return {
        n.replace("lateness/", "delay/"): (point.nuisance[n] + float(step[k]), float(std[k]))
        for k, n in enumerate(names)
        if k >= first
    }


def _one_ahead(fit: TurbulentFit) -> list[FloatArray]:
    """Return the outputs (n, m) predicted one sample ahead from the best start states, by segment.

    Outputs of sensors that are late by whole rows are shifted accordingly.
    """
    data, point, gust_fit = fit.data, fit.fit.trajectory.point, fit.fit
    # Run the filter with the estimated process noise.
    followed = filter_segments(
        gust_fit.steps,
        aligned_outputs(data, point),
        data.output_rows,
        data.noise,
        fit.turbulence.process,
    )
    delta = gust_fit.information.step()[0]
    out = []
    for segment, steps, one, w in zip(
        data.segments, gust_fit.steps, followed, gust_fit.information.white, strict=True
    ):
        # State estimates are linear in the start state and the last step.
        path = one.path_from(w.start[:, 0] + w.start[:, 1:] @ delta)
        predicted = steps.y_ref[:, data.output_rows] + np.einsum(
            "nij,nj->ni", steps.H[:, data.output_rows], path
        )
        late = delay_rows(data, segment, point)
        out.append(
            np.column_stack(
                [shift_rows(predicted[:, k], late[c]) for k, c in enumerate(data.outputs)]
            )
        )
    return out
